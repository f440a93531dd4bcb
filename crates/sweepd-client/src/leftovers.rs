//! Files that a process left unfinished because it was killed while it made them.
//!
//! iceoryx2 0.10 waits without a limit for a shared-memory file of length 0 to grow, and never
//! removes a node that died before it was complete. So both are removed here, before iceoryx2 meets
//! them.
//!
//! A file counts as abandoned after [`ABANDONED_AFTER`]: a living process finishes one within
//! microseconds. One that was stopped for longer in just that moment finds its file gone, and fails
//! or opens the service again.

use std::fs::{self, DirEntry, Metadata};
use std::os::unix::fs::MetadataExt;
use std::time::{Duration, SystemTime};

use crate::domain::Domain;
use crate::host::own_uid;

/// Age from which an unfinished file has no maker any more.
pub const ABANDONED_AFTER: Duration = Duration::from_secs(1);
const OWNER_READ: u32 = 0o400;

/// Removes abandoned files of shared memory: those of length 0, and those that their owner may not
/// read yet. Returns whether younger unfinished ones are left, which iceoryx2 must not meet.
pub fn remove_unfinished(domain: &Domain) -> bool {
    let mut is_pending = false;
    for entry in domain.shared_memory() {
        // Its maker may just have removed it.
        let Ok(metadata) = entry.metadata() else {
            continue;
        };
        let is_unfinished = metadata.len() == 0 || metadata.mode() & OWNER_READ == 0;
        if is_unfinished && metadata.uid() == own_uid() && metadata.is_file() {
            is_pending |= !remove_if_abandoned(&entry, &metadata);
        }
    }
    is_pending
}

/// Removes a file of which no maker is left. Whether it is gone now.
pub fn remove_if_abandoned(entry: &DirEntry, metadata: &Metadata) -> bool {
    let is_abandoned = is_abandoned(metadata);
    if is_abandoned {
        remove(entry);
    }
    is_abandoned
}

/// Whether an unfinished file has no maker any more: see [`ABANDONED_AFTER`].
pub fn is_abandoned(metadata: &Metadata) -> bool {
    // The status changes with each step of its making. A time to come is that of a clock that was
    // set back since.
    let changed = SystemTime::UNIX_EPOCH + Duration::from_secs(metadata.ctime().max(0) as u64);
    let changed = changed + Duration::from_nanos(metadata.ctime_nsec().max(0) as u64);
    SystemTime::now()
        .duration_since(changed)
        .map_or(true, |age| age >= ABANDONED_AFTER)
}

/// Removes a file or folder, if no other process has.
pub fn remove(entry: &DirEntry) {
    let path = entry.path();
    // A file that another process has removed is fine too.
    let _ = if path.is_dir() {
        fs::remove_dir_all(path)
    } else {
        fs::remove_file(path)
    };
}
