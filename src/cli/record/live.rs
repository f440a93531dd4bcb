//! What `sweepd record` shows while it records.

use std::io::{self, IsTerminal, Write};
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressStyle};

use crate::cli::complain;
use crate::daemon::record::protocol::Progress;
use crate::files::sequence::RecoveryWatch;
use crate::text::grouped;

/// Interval at which threads check for the end.
pub const TICK: Duration = Duration::from_millis(50);

/// Tells people what became of the parts of killed recordings, until it is over.
pub fn recovery_watch(over: &Arc<AtomicBool>) -> RecoveryWatch {
    RecoveryWatch {
        over: Arc::clone(over),
        tell: |recovery| complain(recovery.severity(), recovery),
    }
}

/// Says what is recorded and where.
pub fn announce(inputs: &str, file: &Path) {
    let _ = writeln!(
        io::stderr(),
        "recording {inputs} to {}; Ctrl-C ends it",
        file.display()
    );
}

/// The text of the live line.
pub fn describe(begun: Instant, progress: &Progress) -> String {
    format!(
        "{:.0} s: {} datagrams came, {} recorded ({:.1} MB), {} dropped before, {} for want of a faster disk",
        begun.elapsed().as_secs_f64(),
        grouped(progress.received),
        grouped(progress.written),
        progress.bytes as f64 * 1e-6,
        grouped(progress.dropped),
        grouped(progress.unwritten),
    )
}

/// The live line; hidden where standard error is no terminal.
pub fn live_line() -> ProgressBar {
    if !io::stderr().is_terminal() {
        return ProgressBar::hidden();
    }
    let style =
        ProgressStyle::with_template("{msg}").unwrap_or_else(|_| ProgressStyle::default_spinner());
    ProgressBar::new_spinner().with_style(style)
}
