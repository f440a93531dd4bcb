//! MCAP as the contents of a sequence of files: [`mcap`](crate::export::mcap) writes each, and
//! [`mend()`] gives one that a killed recording left its end.

mod mend;
#[cfg(test)]
mod tests;

use std::fs::File;
use std::io::{self, BufWriter};
use std::path::Path;
use std::sync::atomic::AtomicBool;

use crate::export::mcap::{ENDINGS, McapWriter, SweepMessages};
use crate::files::parts::Recovery;
use crate::files::sequence::{Contents, Sequence};

pub use mend::{Mended, mend};

/// The files of a recording.
pub type McapFiles = Sequence<McapWriter<BufWriter<File>>>;

impl Contents for McapWriter<BufWriter<File>> {
    type Record<'a> = SweepMessages;
    const ENDINGS: &'static [&'static str] = ENDINGS;
    /// Only messages are counted.
    const HEADER_LEN: u64 = 0;
    const NEEDS_END: bool = true;

    fn begin(file: File, _ending: &str) -> io::Result<Self> {
        let mut writer = Self::new(BufWriter::new(file))?;
        // So that a full device is known at once.
        writer.flush()?;
        Ok(writer)
    }

    fn time_ns(messages: &SweepMessages) -> i64 {
        messages.time_ns() as i64
    }

    fn len(messages: &SweepMessages) -> u64 {
        messages.bytes()
    }

    fn write(&mut self, messages: &SweepMessages) -> io::Result<()> {
        McapWriter::write(self, messages)
    }

    fn flush(&mut self) -> io::Result<()> {
        McapWriter::flush(self)
    }

    fn finish(self) -> io::Result<()> {
        McapWriter::finish(self).map(drop)
    }

    fn end_early(part: File, safe_len: u64) -> io::Result<()> {
        mend::end_early(part, safe_len)
    }

    fn recover(
        file: File,
        part: &Path,
        stem: &Path,
        ending: &str,
        over: &AtomicBool,
    ) -> io::Result<Recovery> {
        mend::mend_part(file, part, stem, ending, over)
    }
}
