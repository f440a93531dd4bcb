//! Lines for people, on standard error.

use std::fmt::{Arguments, Display};
use std::io::{self, Write};

/// Something that happened, to the node or to the sensor that the message begins with.
pub fn info(message: Arguments<'_>) {
    line("info", message);
}

/// Something that should not be.
pub fn warn(message: Arguments<'_>) {
    line("warning", message);
}

/// Why the program ends.
pub fn error(message: impl Display) {
    line("error", format_args!("{message}"));
}

/// Without a reader of the log the program goes on.
fn line(severity: &str, message: Arguments<'_>) {
    let _ = writeln!(io::stderr(), "{severity}: {message}");
}
