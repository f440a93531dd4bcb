//! How far a capture was read, on standard error.

use std::fs::{self, File};
use std::io::{self, IsTerminal, Read};

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};

use super::args::Args;
use crate::input::{Capture, CaptureError};

/// A progress bar; silent where standard error is no terminal, and where output for programs comes out beside it.
pub(super) fn bar(args: &Args) -> ProgressBar {
    if args.is_piped() && io::stdout().is_terminal() {
        return ProgressBar::hidden();
    }
    let template = "{wide_bar} {percent:>3} %  {binary_bytes} of {binary_total_bytes}, {eta} to go";
    let bar = ProgressBar::with_draw_target(None, ProgressDrawTarget::stderr());
    with_template(bar, template)
}

fn with_template(bar: ProgressBar, template: &str) -> ProgressBar {
    match ProgressStyle::with_template(template) {
        Ok(style) => bar.with_style(style),
        Err(_) => bar,
    }
}

/// Opens the capture, reading from it through the bar.
pub(super) fn open(args: &Args, bar: &ProgressBar) -> Result<Capture, CaptureError> {
    let path = &args.capture;
    if path.as_os_str() == "-" {
        let bar = with_template(bar.clone(), "{binary_bytes} read, {elapsed} gone");
        return Capture::new("standard input", Box::new(bar.wrap_read(io::stdin())));
    }
    let metadata = fs::metadata(path).ok().filter(fs::Metadata::is_file);
    let Some(file) = metadata.filter(|_| !Capture::is_in_place(path)) else {
        return Capture::open(path);
    };
    bar.set_length(file.len());
    bar.reset();
    let name = path.display().to_string();
    let source: Box<dyn Read + Send> = match File::open(path) {
        Ok(file) => Box::new(bar.wrap_read(file)),
        Err(source) => return Err(CaptureError::Open { name, source }),
    };
    Capture::new(&name, source)
}
