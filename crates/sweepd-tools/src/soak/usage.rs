//! What processes, sockets and a domain take of the system.

use std::fs;
use std::io;
use std::os::unix::fs::MetadataExt;
use std::path::Path;

use sweepd_testkit::TempDomain;

/// What a process takes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ProcessUsage {
    /// Memory of its own, KiB.
    pub own_kib: u64,
    /// All resident memory, that shared with consumers included, KiB.
    pub resident_kib: u64,
    /// Threads.
    pub threads: u64,
    /// Open descriptors.
    pub descriptors: u64,
}

impl ProcessUsage {
    /// Of this process; zeroes once it has ended.
    pub fn of(pid: u32) -> Self {
        let status = fs::read_to_string(format!("/proc/{pid}/status")).unwrap_or_default();
        let descriptors = fs::read_dir(format!("/proc/{pid}/fd"));
        Self {
            own_kib: field(&status, "RssAnon:"),
            resident_kib: field(&status, "VmRSS:"),
            threads: field(&status, "Threads:"),
            descriptors: descriptors.map_or(0, |all| all.count() as u64),
        }
    }
}

/// A number in /proc/PID/status; 0 where it is missing.
fn field(status: &str, key: &str) -> u64 {
    let value = status.lines().find_map(|line| line.strip_prefix(key));
    value
        .and_then(|value| value.split_whitespace().next()?.parse().ok())
        .unwrap_or(0)
}

/// What a domain takes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct DomainUsage {
    /// Files in its folder and in shared memory.
    pub files: u64,
    /// Shared memory in use, bytes; untouched pages do not count.
    pub shared_bytes: u64,
}

impl DomainUsage {
    /// Of this domain.
    pub fn of(domain: &TempDomain) -> Self {
        let shared = domain.shared_memory();
        let in_use = shared.iter().filter_map(|path| path.metadata().ok());
        Self {
            files: shared.len() as u64 + count_files(domain.domain().root()),
            shared_bytes: in_use.map(|file| file.blocks() * 512).sum(),
        }
    }
}

fn count_files(folder: &Path) -> u64 {
    let mut count = 0;
    for entry in fs::read_dir(folder).into_iter().flatten().flatten() {
        let path = entry.path();
        count += if path.is_dir() { count_files(&path) } else { 1 };
    }
    count
}

/// The bytes that wait in the fullest socket of some UDP ports, as the kernel charges them.
///
/// # Errors
/// /proc cannot be read.
pub fn waiting_bytes(ports: &[u16]) -> io::Result<u64> {
    let table = fs::read_to_string("/proc/net/udp")?;
    let waiting = table.lines().skip(1).filter_map(|line| {
        let fields: Vec<&str> = line.split_ascii_whitespace().collect();
        let (_, port) = fields.get(1)?.rsplit_once(':')?;
        let (_, bytes) = fields.get(4)?.split_once(':')?;
        let port = u16::from_str_radix(port, 16).ok()?;
        let bytes = u64::from_str_radix(bytes, 16).ok()?;
        ports.contains(&port).then_some(bytes)
    });
    Ok(waiting.max().unwrap_or(0))
}
