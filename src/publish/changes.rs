//! Whether anything has changed in the folders where iceoryx2 keeps its files, by inotify(7): one
//! system call a look, where a look at all files takes hundreds.
//!
//! A process that dies is a change, too: the kernel closes the files that its node has open for
//! writing. Only the context tells this: iceoryx2 also opens the others for writing, to see whether
//! a process lives.

use std::mem::MaybeUninit;
use std::os::fd::OwnedFd;

use rustix::fs::inotify::{self, CreateFlags, ReadFlags, Reader, WatchFlags};
use rustix::io::Errno;
use sweepd_client::domain::{Domain, SHARED_MEMORY};

/// What happens to a file that is made, removed, or left by its process.
const WATCHED: WatchFlags = WatchFlags::CREATE
    .union(WatchFlags::CLOSE_WRITE)
    .union(WatchFlags::DELETE)
    .union(WatchFlags::MOVE)
    .union(WatchFlags::DELETE_SELF)
    .union(WatchFlags::MOVE_SELF)
    .union(WatchFlags::ONLYDIR);
/// How the name of a node's context ends.
const CONTEXT: &[u8] = b"_context";
/// Room for the events of one call; one with the longest name takes 272 bytes.
const EVENT_BYTES: usize = 4096;
/// Most events that are read at a look: other users may cause any number in /dev/shm.
const MOST_EVENTS: usize = 2048;

/// The watched folders of a domain.
#[derive(Debug)]
pub(super) struct Changes {
    domain: Domain,
    /// `None` until the first watch, and where the system gives none.
    inotify: Option<OwnedFd>,
    /// `None` unless all folders are watched.
    watches: Option<Watches>,
}

/// Numbers of the watches of two of the folders.
#[derive(Clone, Copy, Debug)]
struct Watches {
    nodes: i32,
    shared_memory: i32,
}

impl Changes {
    /// Watches nothing yet.
    pub(super) fn new(domain: Domain) -> Self {
        Self {
            domain,
            inotify: None,
            watches: None,
        }
    }

    /// Whether anything may have changed since the last call: true where that is not known.
    pub(super) fn any(&mut self) -> bool {
        let Some(inotify) = &self.inotify else {
            return true;
        };
        let prefix = self.domain.prefix();
        let mut buffer = [MaybeUninit::uninit(); EVENT_BYTES];
        let mut events = Reader::new(inotify, &mut buffer);
        let Some(watches) = self.watches else {
            return true;
        };
        let mut is_changed = false;
        for _ in 0..MOST_EVENTS {
            let event = match events.next() {
                Ok(event) => event,
                Err(Errno::AGAIN) => return is_changed,
                Err(_) => return true,
            };
            let name = event.file_name().map_or(&b""[..], |name| name.to_bytes());
            // Other programs have files in /dev/shm, too. Without a name, an event is of a folder.
            let is_foreign = event.wd() == watches.shared_memory
                && !(name.is_empty() || name.starts_with(prefix.as_bytes()));
            let is_look = event.wd() == watches.nodes
                && event.events() == ReadFlags::CLOSE_WRITE
                && !name.ends_with(CONTEXT);
            is_changed |= !is_foreign && !is_look;
        }
        true
    }

    /// Watches the folders that are there now: one that was made again is another.
    pub(super) fn renew(&mut self) {
        self.watches = self.watch().ok();
    }

    fn watch(&mut self) -> rustix::io::Result<Watches> {
        let inotify = match &self.inotify {
            Some(inotify) => inotify,
            None => self
                .inotify
                .insert(inotify::init(CreateFlags::NONBLOCK | CreateFlags::CLOEXEC)?),
        };
        for folder in [self.domain.root(), &self.domain.services()] {
            inotify::add_watch(inotify, folder, WATCHED)?;
        }
        Ok(Watches {
            nodes: inotify::add_watch(inotify, self.domain.nodes(), WATCHED)?,
            shared_memory: inotify::add_watch(inotify, SHARED_MEMORY, WATCHED)?,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs;
    use std::path::Path;
    use sweepd_client::join::node;
    use sweepd_client::leftovers::remove;

    #[test]
    fn what_comes_goes_or_dies_in_a_domain_is_a_change_and_nothing_else() {
        let root = std::env::temp_dir().join(format!("sweepd-changes-{}", std::process::id()));
        let domain = Domain::at(&root);
        domain.prepare().unwrap();
        let mut changes = Changes::new(domain.clone());
        changes.renew();
        assert!(changes.any(), "there are no folders yet");
        fs::create_dir_all(domain.services()).unwrap();
        let held = node(&domain, 0).unwrap();
        changes.renew();
        assert!(changes.any() && !changes.any());

        let foreign = Path::new(SHARED_MEMORY).join(format!("changes-{}", std::process::id()));
        fs::write(&foreign, "").unwrap();
        fs::remove_file(foreign).unwrap();
        assert!(!changes.any(), "of another program");
        let [lock, context] = ["1.node_monitor", "1.node_monitor_context"]
            .map(|name| fs::File::create(domain.nodes().join(name)).unwrap());
        assert!(changes.any() && !changes.any());
        drop(lock);
        assert!(!changes.any(), "a look at a node");
        drop(context);
        assert!(changes.any() && !changes.any(), "a process died");
        drop(held);
        assert!(changes.any(), "a node has gone");
        fs::write(domain.services().join("1.service"), "").unwrap();
        assert!(changes.any() && !changes.any(), "overwritten");
        fs::remove_dir_all(&root).unwrap();
        assert!(changes.any() && !changes.any());
        changes.renew();
        assert!(changes.any(), "the folders are gone");
        for file in domain.shared_memory() {
            remove(&file);
        }
    }
}
