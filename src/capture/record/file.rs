//! Writes one capture, plain or compressed; after a sync it can be read up to that point.

use std::fs::File;
use std::io::{self, BufWriter, Stdout, Write};
use std::path::Path;

use flate2::write::GzEncoder;
use flate2::{Compression, GzBuilder};

use crate::capture::write::{Addressed, PcapWriter};
use crate::files::output::is_special;
use crate::files::parts::is_being_written;

/// The format of a capture, by the end of its name.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Format {
    /// `.pcap`
    Plain,
    /// `.pcap.gz`
    Gzip,
}

impl Format {
    /// The format of a name, if it has one.
    pub fn of(path: &Path) -> Option<Self> {
        let name = path.file_name()?.to_string_lossy();
        let endings = [(".pcap", Self::Plain), (".pcap.gz", Self::Gzip)];
        endings
            .into_iter()
            .find(|(ending, _)| name.ends_with(ending))
            .map(|(_, format)| format)
    }

    /// `.pcap` or `.pcap.gz`.
    pub fn ending(self) -> &'static str {
        match self {
            Self::Plain => ".pcap",
            Self::Gzip => ".pcap.gz",
        }
    }
}

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
    /// Creates a capture; an existing file is the error `AlreadyExists`. A pipe or a device is
    /// written directly. A file stays locked while it is written (`is_being_written`).
    ///
    /// # Errors
    /// The error of the system; `ResourceBusy` if another recording has taken the file.
    pub fn create_new(path: &Path, format: Format) -> io::Result<Self> {
        if is_special(path) {
            return Self::over(File::options().write(true).open(path)?, format);
        }
        let file = File::create_new(path)?;
        if is_being_written(&file) {
            return Err(io::ErrorKind::ResourceBusy.into());
        }
        Self::over(file, format)
    }

    /// Writes a plain capture to standard output.
    ///
    /// # Errors
    /// What the system says.
    pub fn stdout() -> io::Result<Self> {
        Ok(Self {
            writer: PcapWriter::new(Sink::Stdout(BufWriter::new(io::stdout())))?,
        })
    }

    /// Writes a capture into an empty file.
    ///
    /// # Errors
    /// What the system says.
    pub fn over(file: File, format: Format) -> io::Result<Self> {
        let sink = match format {
            Format::Plain => Sink::Plain(BufWriter::new(file)),
            // No creation time in the header, so that the same datagrams give the same file.
            Format::Gzip => Sink::Gzip(BufWriter::new(
                GzBuilder::new()
                    .mtime(0)
                    .write(file, Compression::default()),
            )),
        };
        Ok(Self {
            writer: PcapWriter::new(sink)?,
        })
    }

    /// Writes a record.
    ///
    /// # Errors
    /// As [`PcapWriter::write`].
    pub fn write(&mut self, datagram: &Addressed<'_>) -> io::Result<()> {
        self.writer.write(datagram)
    }

    /// Syncs all that was written to the disk, as a capture that can be read up to here.
    ///
    /// # Errors
    /// What the disk says.
    pub fn sync(&mut self) -> io::Result<()> {
        let sink = self.writer.sink_mut();
        sink.flush()?;
        match sink {
            Sink::Plain(file) => synced(file.get_ref()),
            Sink::Gzip(file) => synced(file.get_ref().get_ref()),
            Sink::Stdout(_) => Ok(()),
        }
    }

    /// Writes what is left in buffers, including the end of a gzip stream.
    ///
    /// # Errors
    /// The error of the disk or the reader.
    pub fn finish(self) -> io::Result<()> {
        self.close().map(drop)
    }

    /// As [`CaptureFile::finish`], and syncs it to the disk. Gives the file, which is locked until
    /// it is dropped; `None` for standard output.
    ///
    /// # Errors
    /// What the disk says.
    pub fn finish_and_sync(self) -> io::Result<Option<File>> {
        let file = self.close()?;
        if let Some(file) = &file {
            synced(file)?;
        }
        Ok(file)
    }

    fn close(self) -> io::Result<Option<File>> {
        match self.writer.finish()? {
            Sink::Plain(file) => file
                .into_inner()
                .map_err(io::IntoInnerError::into_error)
                .map(Some),
            Sink::Gzip(file) => file
                .into_inner()
                .map_err(io::IntoInnerError::into_error)?
                .finish()
                .map(Some),
            Sink::Stdout(_) => Ok(None),
        }
    }
}

/// A pipe or a device has nothing to sync (fsync(2), EINVAL).
fn synced(file: &File) -> io::Result<()> {
    match file.sync_data() {
        Err(error) if error.kind() == io::ErrorKind::InvalidInput => Ok(()),
        other => other,
    }
}
