//! The capture that a simulation writes: plain, compressed, or standard output.

use std::fs::File;
use std::io::{self, BufWriter, StdoutLock, Write};
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
    Stdout(BufWriter<StdoutLock<'static>>),
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
        let sink = open(path)?;
        let writer = PcapWriter::new(sink).map_err(|source| failed(path, source))?;
        Ok(Self { path: path.to_owned(), writer })
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

fn open(path: &Path) -> Result<Sink, CliError> {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    let create = || File::create(path).map_err(|source| failed(path, source));
    if path.as_os_str() == "-" {
        Ok(Sink::Stdout(BufWriter::new(io::stdout().lock())))
    } else if name.ends_with(".pcap") {
        Ok(Sink::Plain(BufWriter::new(create()?)))
    } else if name.ends_with(".pcap.gz") {
        // No time of making in the header: the same command gives the same file.
        Ok(Sink::Gzip(BufWriter::new(GzBuilder::new().mtime(0).write(create()?, Compression::default()))))
    } else {
        let message = format!("--pcap {}: expected a name that ends in .pcap or .pcap.gz, or -", path.display());
        Err(CliError::Usage(message))
    }
}

fn failed(path: &Path, source: io::Error) -> CliError {
    if path.as_os_str() == "-" { CliError::Stdout(source) } else { CliError::Write { path: path.to_owned(), source } }
}
