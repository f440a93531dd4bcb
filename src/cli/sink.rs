//! The capture that a simulation or a recording writes: plain, compressed, or standard output.

use std::fs::File;
use std::io::{self, BufWriter, Stdout, Write};
use std::path::{Path, PathBuf};

use flate2::write::GzEncoder;
use flate2::{Compression, GzBuilder};

use crate::capture::write::{Outgoing, PcapWriter};
use crate::cli::CliError;

/// A capture under way.
pub struct CaptureFile {
    path: PathBuf,
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
    /// Opens what `--pcap` names and writes the header.
    ///
    /// # Errors
    /// [`CliError`]: a name that says no format, a file that cannot be written.
    pub fn create(path: &Path) -> Result<Self, CliError> {
        let stdout = path.as_os_str() == "-";
        let sink = if stdout {
            Sink::Stdout(BufWriter::new(io::stdout()))
        } else {
            file(path, "--pcap", || File::create(path))?
        };
        Self::over(path, sink)
    }

    /// As [`CaptureFile::create`], but overwrites no file: that is the error `AlreadyExists`. What is no file, such as a
    /// named pipe, is written to.
    ///
    /// # Errors
    /// As there.
    pub fn create_new(path: &Path) -> Result<Self, CliError> {
        let special = path.metadata().is_ok_and(|found| !found.is_file() && !found.is_dir());
        let open = || if special { File::options().write(true).open(path) } else { File::create_new(path) };
        Self::over(path, file(path, "-o", open)?)
    }

    fn over(path: &Path, sink: Sink) -> Result<Self, CliError> {
        let writer = PcapWriter::new(sink).map_err(|source| failed(path, source))?;
        Ok(Self { path: path.to_owned(), writer })
    }

    /// The path that it was opened with.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Has everything so far on the disk, as a capture that can be read up to here.
    ///
    /// # Errors
    /// [`CliError`]: what the disk says.
    pub fn sync(&mut self) -> Result<(), CliError> {
        let sink = self.writer.sink_mut();
        let synced = sink.flush().and_then(|()| match sink {
            Sink::Plain(file) => file.get_ref().sync_data(),
            Sink::Gzip(file) => file.get_ref().get_ref().sync_data(),
            Sink::Stdout(_) => Ok(()),
        });
        match synced {
            // A pipe or device has nothing to sync (fsync(2), EINVAL).
            Err(error) if error.kind() == io::ErrorKind::InvalidInput => Ok(()),
            other => other.map_err(|source| failed(&self.path, source)),
        }
    }

    /// Writes a record.
    ///
    /// # Errors
    /// [`CliError`]: what the disk or the reader says.
    pub fn write(&mut self, datagram: &Outgoing<'_>) -> Result<(), CliError> {
        self.writer.write(datagram).map_err(|source| failed(&self.path, source))
    }

    /// Writes out what is left.
    ///
    /// # Errors
    /// [`CliError`]: what the disk or the reader says.
    pub fn finish(self) -> Result<(), CliError> {
        let close = |sink| match sink {
            Sink::Gzip(file) => file.into_inner().map_err(io::IntoInnerError::into_error)?.finish().map(drop),
            Sink::Plain(_) | Sink::Stdout(_) => Ok(()),
        };
        self.writer.finish().and_then(close).map_err(|source| failed(&self.path, source))
    }
}

fn file(path: &Path, option: &str, open: impl FnOnce() -> io::Result<File>) -> Result<Sink, CliError> {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    let open = || open().map_err(|source| failed(path, source));
    if name.ends_with(".pcap") {
        Ok(Sink::Plain(BufWriter::new(open()?)))
    } else if name.ends_with(".pcap.gz") {
        // No time of making in the header: the same command gives the same file.
        Ok(Sink::Gzip(BufWriter::new(GzBuilder::new().mtime(0).write(open()?, Compression::default()))))
    } else {
        // A recording is to be synced, which standard output cannot be.
        let or_stdout = if option == "--pcap" { ", or -" } else { "" };
        let message = format!("{option} {}: expected a name that ends in .pcap or .pcap.gz{or_stdout}", path.display());
        Err(CliError::Usage(message))
    }
}

fn failed(path: &Path, source: io::Error) -> CliError {
    if path.as_os_str() == "-" { CliError::Stdout(source) } else { CliError::Write { path: path.to_owned(), source } }
}
