//! Lines for people: on standard error, and, where somebody takes them, on `/rosout`.

use std::collections::VecDeque;
use std::fmt::{Arguments, Display};
use std::io::{self, Write};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::thread::{self, Thread};

use sweepd_client::host::realtime_ns;

/// Lines that wait to be taken: the newest. The network is told of no line at once, as it is told within
/// the stack that sends it.
const WAITING: usize = 100;
/// With who takes them.
static LINES: Mutex<(VecDeque<Line>, Option<Thread>)> = Mutex::new((VecDeque::new(), None));

/// A line.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Line {
    /// When: nanoseconds since 1970.
    pub stamp_ns: i64,
    /// Its severity, as in `rcl_interfaces/msg/Log`.
    pub level: u8,
    /// What it says.
    pub text: String,
}

/// Something that happened, to the node or to the sensor that the message begins with.
pub fn info(message: Arguments<'_>) {
    line("info", 20, message);
}

/// Something that should not be.
pub fn warn(message: Arguments<'_>) {
    line("warning", 30, message);
}

/// Why the program ends.
pub fn error(message: impl Display) {
    line("error", 40, format_args!("{message}"));
}

/// Takes the lines since they were taken last, up to the newest 100. The thread is unparked when the next
/// one comes.
pub fn take() -> VecDeque<Line> {
    let (lines, taker) = &mut *lines();
    *taker = Some(thread::current());
    std::mem::take(lines)
}

fn lines() -> MutexGuard<'static, (VecDeque<Line>, Option<Thread>)> {
    LINES.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Without a reader of the log the program goes on.
fn line(severity: &str, level: u8, message: Arguments<'_>) {
    let _ = writeln!(io::stderr(), "{severity}: {message}");
    let (lines, taker) = &mut *lines();
    if lines.len() == WAITING {
        lines.pop_front();
    }
    lines.push_back(Line {
        stamp_ns: realtime_ns(),
        level,
        text: message.to_string(),
    });
    if let Some(taker) = taker.take() {
        taker.unpark();
    }
}
