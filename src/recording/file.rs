//! Writes one capture, plain or compressed.

use std::fs::File;
use std::io::{self, BufWriter, Stdout, Write};
use std::path::Path;
use std::sync::atomic::AtomicBool;

use flate2::write::GzEncoder;
use flate2::{Compression, GzBuilder};

use crate::files::parts::{self, Recovery};
use crate::files::sequence::Contents;
use crate::input::CaptureReader;
use crate::input::write::{Addressed, FILE_HEADER_LEN, PcapWriter, record_len};
use sweepd_core::wire::Datagram;

/// The ending of a compressed capture.
const GZIP: &str = ".pcap.gz";

/// A capture under way.
pub struct CaptureFile {
    writer: PcapWriter<Sink>,
}

enum Sink {
    Plain(BufWriter<File>),
    // Small writes go through the buffer, not one by one through the compressor.
    Gzip(BufWriter<GzEncoder<File>>),
    Stdout(BufWriter<Stdout>),
}

impl Write for Sink {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        match self {
            Self::Plain(file) => file.write(bytes),
            Self::Gzip(file) => file.write(bytes),
            Self::Stdout(out) => out.write(bytes),
        }
    }

    fn flush(&mut self) -> io::Result<()> {
        match self {
            Self::Plain(file) => file.flush(),
            Self::Gzip(file) => file.flush(),
            Self::Stdout(out) => out.flush(),
        }
    }
}

impl CaptureFile {
    /// Writes a plain capture to standard output.
    ///
    /// # Errors
    /// What the system says.
    pub fn stdout() -> io::Result<Self> {
        let sink = Sink::Stdout(BufWriter::new(io::stdout()));
        let writer = PcapWriter::new(sink)?;
        Ok(Self { writer })
    }

    /// Writes a datagram whose destination is known by its port alone.
    ///
    /// # Errors
    /// What the disk says.
    pub fn write_datagram(&mut self, datagram: &Datagram<'_>) -> io::Result<()> {
        self.writer.write_datagram(datagram)
    }
}

impl Contents for CaptureFile {
    type Record<'a> = Addressed<'a>;
    const ENDINGS: &'static [&'static str] = &[".pcap", GZIP];
    const HEADER_LEN: u64 = FILE_HEADER_LEN;
    const NEEDS_END: bool = false;

    fn begin(file: File, ending: &str) -> io::Result<Self> {
        let sink = match ending {
            // No creation time in the header, so that the same datagrams give the same file.
            GZIP => Sink::Gzip(BufWriter::new(
                GzBuilder::new()
                    .mtime(0)
                    .write(file, Compression::default()),
            )),
            _ => Sink::Plain(BufWriter::new(file)),
        };
        let writer = PcapWriter::new(sink)?;
        Ok(Self { writer })
    }

    fn time_ns(datagram: &Addressed<'_>) -> i64 {
        datagram.arrival_ns
    }

    fn len(datagram: &Addressed<'_>) -> u64 {
        record_len(datagram.payload.len())
    }

    fn write(&mut self, datagram: &Addressed<'_>) -> io::Result<()> {
        self.writer.write(datagram)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.writer.sink_mut().flush()
    }

    /// With the end of a gzip stream.
    fn finish(self) -> io::Result<()> {
        if let Sink::Gzip(file) = self.writer.finish()? {
            let file = file.into_inner().map_err(io::IntoInnerError::into_error)?;
            file.finish()?;
        }
        Ok(())
    }

    /// One that is cut can be read.
    fn recover(
        file: File,
        part: &Path,
        stem: &Path,
        ending: &str,
        _over: &AtomicBool,
    ) -> io::Result<Recovery> {
        let name = part.display().to_string();
        // A copy keeps the lock.
        if CaptureReader::new(&name, Box::new(file.try_clone()?)).is_err() {
            return Err(io::Error::other("it is no capture"));
        }
        let path = parts::give_free_name(part, stem, ending)?;
        Ok(Recovery::Named { path })
    }
}
