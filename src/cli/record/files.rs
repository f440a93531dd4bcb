//! The files of a recording: one, or one after the other.

use std::fs::File;
use std::io;
use std::net::{Ipv4Addr, SocketAddrV4};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use crate::capture::write::{FILE_HEADER_LEN, Outgoing, record_len};
use crate::cli::CliError;
use crate::cli::sink::CaptureFile;
use crate::wire::Datagram;

/// The longest that what was written may be lost by a power failure.
const SYNC_EVERY: Duration = Duration::from_secs(1);

/// When to begin another file.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Rotation {
    /// Before a file would get longer than this, bytes (uncompressed).
    pub bytes: Option<u64>,
    /// When a file holds so many nanoseconds.
    pub ns: Option<u64>,
}

impl Rotation {
    fn is_wanted(self) -> bool {
        self.bytes.is_some() || self.ns.is_some()
    }
}

/// What was written.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Written {
    /// Datagrams.
    pub datagrams: u64,
    /// Bytes, uncompressed.
    pub bytes: u64,
    /// The first file, and the last if it is another.
    pub first: PathBuf,
    /// The last file.
    pub last: PathBuf,
    /// How many.
    pub files: u64,
}

/// A recording under way.
pub struct Files {
    path: PathBuf,
    rotation: Rotation,
    /// Told as the address that the sensors send to.
    destination: Ipv4Addr,
    file: CaptureFile,
    /// Of the file: its length and the arrival of its first datagram.
    len: u64,
    begun_ns: Option<i64>,
    next_number: u32,
    synced: Instant,
    written: Written,
    /// Datagrams and bytes that are on the disk for sure.
    safe: (u64, u64),
}

impl Files {
    /// Begins the first file.
    ///
    /// # Errors
    /// [`CliError`]: a file that is there already, a folder that is not or that must not be written to.
    pub fn create(path: &Path, rotation: Rotation, destination: Ipv4Addr) -> Result<Self, CliError> {
        let mut next_number = 0;
        let file = open(path, rotation, &mut next_number)?;
        let (first, last) = (file.path().to_owned(), file.path().to_owned());
        let written = Written { first, last, files: 1, bytes: FILE_HEADER_LEN, datagrams: 0 };
        let (path, synced) = (path.to_owned(), Instant::now());
        let (len, begun_ns) = (FILE_HEADER_LEN, None);
        Ok(Self { path, rotation, destination, file, len, begun_ns, next_number, synced, written, safe: (0, 0) })
    }

    /// Writes a datagram, in another file if it is time for one.
    ///
    /// # Errors
    /// [`CliError::Recording`]: what the disk says.
    pub fn write(&mut self, source: SocketAddrV4, datagram: &Datagram<'_>) -> Result<(), CliError> {
        let (arrival_ns, payload) = (datagram.arrival_ns, datagram.payload);
        let more = record_len(payload.len());
        if self.is_full(arrival_ns, more) {
            self.rotate()?;
        }
        let destination = SocketAddrV4::new(self.destination, datagram.destination_port);
        let outgoing = Outgoing { arrival_ns, source, destination, payload };
        self.file.write(&outgoing).map_err(with_cure)?;
        self.begun_ns.get_or_insert(arrival_ns);
        self.len += more;
        self.written.datagrams += 1;
        self.written.bytes += more;
        Ok(())
    }

    /// Has what was written on the disk, if it is time again.
    ///
    /// # Errors
    /// [`CliError::Recording`]: what the disk says.
    pub fn sync_now_and_then(&mut self) -> Result<(), CliError> {
        if self.synced.elapsed() >= SYNC_EVERY {
            self.file.sync().map_err(with_cure)?;
            self.synced = Instant::now();
            self.safe = (self.written.datagrams, self.written.bytes);
        }
        Ok(())
    }

    /// What was written so far, to the disk or to a buffer.
    pub fn written(&self) -> &Written {
        &self.written
    }

    /// Has everything on the disk and closes the last file, unless the disk failed before. Gives what is there: after a
    /// failure, what is there for sure.
    ///
    /// # Errors
    /// [`CliError::Recording`]: what the disk says, or said.
    pub fn finish(self, ended: Result<(), CliError>) -> (Written, Result<(), CliError>) {
        let ended = ended.and_then(|()| close(self.file));
        let mut written = self.written;
        if ended.is_err() {
            (written.datagrams, written.bytes) = self.safe;
        }
        (written, ended)
    }

    fn is_full(&self, arrival_ns: i64, more: u64) -> bool {
        // A file holds at least one datagram. A clock that was set back makes a new file as well.
        self.begun_ns.is_some_and(|begun_ns| {
            self.rotation.bytes.is_some_and(|limit| self.len + more > limit)
                || self.rotation.ns.is_some_and(|limit| arrival_ns.abs_diff(begun_ns) >= limit)
        })
    }

    fn rotate(&mut self) -> Result<(), CliError> {
        let next = open(&self.path, self.rotation, &mut self.next_number)?;
        close(std::mem::replace(&mut self.file, next))?;
        self.safe = (self.written.datagrams, self.written.bytes);
        self.written.last = self.file.path().to_owned();
        self.written.files += 1;
        self.written.bytes += FILE_HEADER_LEN;
        (self.len, self.begun_ns) = (FILE_HEADER_LEN, None);
        Ok(())
    }
}

/// A gzip stream gets its end before it is synced.
fn close(mut file: CaptureFile) -> Result<(), CliError> {
    file.sync().map_err(with_cure)?;
    let path = file.path().to_owned();
    file.finish().map_err(with_cure)?;
    sync_ends(&path);
    Ok(())
}

/// The end of a gzip stream, and the name in the folder. Not every system can sync a folder, and what was recorded is
/// safe already.
fn sync_ends(path: &Path) {
    let folder = path.parent().filter(|parent| !parent.as_os_str().is_empty()).unwrap_or(Path::new("."));
    if path.is_file() {
        let _ = File::open(path).and_then(|file| file.sync_all());
        let _ = File::open(folder).and_then(|folder| folder.sync_all());
    }
}

/// The next file; of several, the next whose number is free.
fn open(path: &Path, rotation: Rotation, next_number: &mut u32) -> Result<CaptureFile, CliError> {
    if !rotation.is_wanted() {
        return CaptureFile::create_new(path).map_err(with_cure);
    }
    loop {
        let numbered = numbered(path, *next_number);
        *next_number += 1;
        match CaptureFile::create_new(&numbered) {
            Err(CliError::Write { source, .. }) if source.kind() == io::ErrorKind::AlreadyExists => {}
            other => return other.map_err(with_cure),
        }
    }
}

/// `drive-007.pcap.gz` for `drive.pcap.gz`.
fn numbered(path: &Path, number: u32) -> PathBuf {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    let end = [".pcap.gz", ".pcap"].into_iter().find(|end| name.ends_with(end)).unwrap_or_default();
    let stem = name.strip_suffix(end).unwrap_or(&name);
    path.with_file_name(format!("{stem}-{number:03}{end}"))
}

/// What to do about an error of the disk.
fn with_cure(error: CliError) -> CliError {
    let CliError::Write { path, source } = error else { return error };
    let cure = match source.kind() {
        io::ErrorKind::AlreadyExists => "a recording overwrites nothing: choose another name, or move that file away",
        io::ErrorKind::NotFound => "make its folder first",
        io::ErrorKind::PermissionDenied | io::ErrorKind::ReadOnlyFilesystem => {
            "choose a folder that this user may write to"
        }
        io::ErrorKind::StorageFull | io::ErrorKind::QuotaExceeded => "free space there, or record to another disk",
        _ => "check the disk, or record to another one",
    };
    CliError::Recording { path, source, cure }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_numbered_before_their_ending() {
        let numbered = |path, number| numbered(Path::new(path), number).display().to_string();
        assert_eq!(numbered("a/drive.pcap", 0), "a/drive-000.pcap");
        assert_eq!(numbered("drive.x.pcap.gz", 12), "drive.x-012.pcap.gz");
        assert_eq!(numbered("/drive.pcap", 1234), "/drive-1234.pcap");
    }
}
