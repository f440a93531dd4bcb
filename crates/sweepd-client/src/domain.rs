//! The folder in which daemon and consumers find each other, and its owner.

use std::fs::{self, DirEntry};
use std::io;
use std::os::unix::fs::{DirBuilderExt, MetadataExt, PermissionsExt};
use std::path::{Component, Path, PathBuf};

use iceoryx2::config::Config;
use iceoryx2::prelude::*;
use iceoryx2::service::service_hash::ServiceHash;

use crate::host::{own_uid, user_name};
use crate::service::Ipc;

/// Where the system keeps shared memory, shm_open(3).
pub const SHARED_MEMORY: &str = "/dev/shm";

/// Environment variable that names the folder.
const VARIABLE: &str = "SWEEPD_ROOT";
/// The daemon's folder under systemd, and iceoryx2's in it.
const RUN: (&str, &str) = ("/run/sweepd", "/run/sweepd/iox2");
/// Where there is no such folder.
const FALLBACK: &str = "/tmp/sweepd/iox2";
/// Prefix of the names of all files, in the folder and in /dev/shm.
const PREFIX: &str = "sweepd_";
/// Most links on the path to the folder: as many as Linux follows.
const MAX_LINKS: usize = 40;

/// A folder of iceoryx2's files. Daemons and consumers find each other if they use the same folder,
/// which must belong to their user: only the owner has access to the shared memory.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Domain {
    root: PathBuf,
}

/// Why a domain cannot be used.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum DomainError {
    /// It belongs to another user. Root could open it, and would silently get nothing.
    #[error(
        "{root} belongs to user {owner}, this program runs as {own}: sweeps are shared within one user alone. If a daemon of {owner} \
         runs, run it as {owner} (`sudo -u {owner} ...`, or `User={owner}` in its systemd unit); if none does, an earlier one left \
         the folder: `sudo rm -r {left}` removes it, or name another with --root or the variable SWEEPD_ROOT, the same for the \
         daemon and its consumers",
        root = root.display(),
        left = made_for(root).display()
    )]
    OtherUser {
        /// The folder.
        root: PathBuf,
        /// Whose it is.
        owner: String,
        /// Whose this program is.
        own: String,
    },
    /// The folder above it belongs to another user, and is closed.
    #[error(
        "{on_the_way} belongs to user {owner}, this program runs as {own}: sweeps are shared within one user alone. Run it as {owner} \
         (`sudo -u {owner} ...`, or `User={owner}` in its systemd unit), or name a folder of {own} with --root or the variable \
         SWEEPD_ROOT, the same for the daemon and its consumers",
        on_the_way = on_the_way.display()
    )]
    Closed {
        /// The folder on the path.
        on_the_way: PathBuf,
        /// Whose it is.
        owner: String,
        /// Whose this program is.
        own: String,
    },
    /// Another user could replace it at any time.
    #[error(
        "{root} leads through {on_the_way}, which {why}: another user could lead it elsewhere. Name a folder whose parents belong \
         to this user or to root, with --root or the variable SWEEPD_ROOT, the same for the daemon and its consumers",
        root = root.display(),
        on_the_way = on_the_way.display()
    )]
    Unsafe {
        /// The folder.
        root: PathBuf,
        /// The link or folder on the path.
        on_the_way: PathBuf,
        /// What is wrong with it.
        why: String,
    },
    /// Another user has made a file that must be this user's, and /dev/shm lets no one but its
    /// owner and root remove it.
    #[error(
        "{file} belongs to user {owner} and stands where a file of user {own} must be: have {owner} or root remove it \
         (`sudo rm {file}`), or name another folder with --root or the variable SWEEPD_ROOT, the same for the daemon and its \
         consumers",
        file = file.display()
    )]
    Occupied {
        /// The file.
        file: PathBuf,
        /// Whose it is.
        owner: String,
        /// Whose this program is.
        own: String,
    },
    /// It cannot be made or examined.
    #[error(
        "cannot use {root} for shared memory: {source}; name a folder of this user with --root or the variable SWEEPD_ROOT, \
         the same for the daemon and its consumers",
        root = root.display()
    )]
    Unusable {
        /// The folder.
        root: PathBuf,
        /// What the system says.
        source: io::Error,
    },
}

/// What a daemon makes where the folder is the usual one of a host without systemd: its parent, too.
fn made_for(root: &Path) -> &Path {
    match root.parent() {
        Some(parent) if root == Path::new(FALLBACK) => parent,
        _ => root,
    }
}

impl Default for Domain {
    /// `$SWEEPD_ROOT`; else /run/sweepd/iox2 where there is a /run/sweepd; else /tmp/sweepd/iox2.
    /// It is the same for all users of a host, so that a program of the wrong user gets an error
    /// instead of waiting forever.
    fn default() -> Self {
        let named = std::env::var_os(VARIABLE)
            .filter(|value| !value.is_empty())
            .map(PathBuf::from);
        Self::at(named.unwrap_or_else(|| match Path::new(RUN.0).is_dir() {
            true => PathBuf::from(RUN.1),
            false => PathBuf::from(FALLBACK),
        }))
    }
}

impl Domain {
    /// The domain in a folder; a relative path is one of the current folder.
    pub fn at(root: impl Into<PathBuf>) -> Self {
        let root = root.into();
        // Other names derive from this one, so that it must be unique: `/x/` becomes `/x`.
        Self {
            root: std::path::absolute(&root)
                .unwrap_or(root)
                .components()
                .collect(),
        }
    }

    /// The domain in a folder, or the default one.
    pub fn at_or_default(root: Option<&Path>) -> Self {
        root.map_or_else(Self::default, Self::at)
    }

    /// The folder.
    pub fn root(&self) -> &Path {
        &self.root
    }

    /// Prefix of its files in /dev/shm: different for each root, so that two daemons never conflict
    /// there.
    pub fn prefix(&self) -> String {
        let is_usual = [RUN.1, FALLBACK]
            .iter()
            .any(|usual| self.root == Path::new(usual));
        if is_usual {
            return PREFIX.to_owned();
        }
        // FNV-1a: the same in every language and version.
        let mut hash: u64 = 0xcbf2_9ce4_8422_2325;
        for &byte in self.root.as_os_str().as_encoded_bytes() {
            hash = (hash ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3);
        }
        format!("{PREFIX}{hash:016x}_")
    }

    /// Makes the folder and checks its owner; for programs that write there.
    ///
    /// # Errors
    /// [`DomainError`].
    pub fn prepare(&self) -> Result<(), DomainError> {
        self.exists()?;
        fs::DirBuilder::new()
            .recursive(true)
            .mode(0o750)
            .create(&self.root)
            .map_err(|source| self.unusable(source))?;
        self.exists().map(|_| ())
    }

    /// Whether it exists. Checks its owner, and that no other user could replace it.
    ///
    /// # Errors
    /// [`DomainError`].
    pub fn exists(&self) -> Result<bool, DomainError> {
        let own = own_uid();
        let mut links = 0;
        let mut way = PathBuf::new();
        let mut ahead: Vec<PathBuf> = steps(&self.root);
        while let Some(step) = ahead.pop() {
            way.push(step);
            let metadata = match fs::symlink_metadata(&way) {
                Ok(metadata) => metadata,
                Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(false),
                Err(error) => return Err(self.unusable(error)),
            };
            let is_last = ahead.is_empty();
            let owner = metadata.uid();
            let is_trusted = owner == own || owner == 0 && !(is_last && metadata.is_dir());
            if !is_trusted {
                return Err(self.not_ours(way, owner));
            }
            if metadata.is_symlink() {
                links += 1;
                let target = fs::read_link(&way).map_err(|source| self.unusable(source))?;
                if links > MAX_LINKS {
                    return Err(self.unusable(io::Error::from_raw_os_error(libc::ELOOP)));
                }
                way.pop();
                ahead.extend(steps(&target));
            } else if !metadata.is_dir() {
                return Err(self.unusable(io::ErrorKind::NotADirectory.into()));
            } else if !is_last && metadata.mode() & (OTHERS_WRITE | STICKY) == OTHERS_WRITE {
                let why = "every user may write to, without the sticky bit".to_owned();
                return Err(DomainError::Unsafe {
                    root: self.root.clone(),
                    on_the_way: way,
                    why,
                });
            }
        }
        Ok(true)
    }

    /// The error of a folder that the system does not let us use.
    pub fn unusable(&self, source: io::Error) -> DomainError {
        DomainError::Unusable {
            root: self.root.clone(),
            source,
        }
    }

    /// The error of a link or folder on the path that belongs neither to this user nor to root. If
    /// the domain itself belongs to that user too, the program runs as the wrong user.
    fn not_ours(&self, on_the_way: PathBuf, owner: u32) -> DomainError {
        let root = self.root.clone();
        let is_link = fs::symlink_metadata(&on_the_way).is_ok_and(|metadata| metadata.is_symlink());
        let own = user_name(own_uid());
        match fs::metadata(&root) {
            Ok(metadata) if !is_link && metadata.uid() == owner => {
                let owner = user_name(owner);
                return DomainError::OtherUser { root, owner, own };
            }
            // As /run/sweepd is.
            Err(error) if !is_link && error.kind() == io::ErrorKind::PermissionDenied => {
                let owner = user_name(owner);
                return DomainError::Closed {
                    on_the_way,
                    owner,
                    own,
                };
            }
            _ => {}
        }
        let what = if is_link {
            "is a link of"
        } else {
            "belongs to"
        };
        DomainError::Unsafe {
            root,
            on_the_way,
            why: format!("{what} user {}", user_name(owner)),
        }
    }

    /// Whether another user has made the one file of shared memory with a predictable name.
    ///
    /// # Errors
    /// [`DomainError::Occupied`].
    pub fn check_occupied(&self) -> Result<(), DomainError> {
        for entry in self.shared_memory() {
            if !is_counter(&entry) {
                continue;
            }
            let owner = entry
                .metadata()
                .map_or(own_uid(), |metadata| metadata.uid());
            if owner != own_uid() {
                let owner = user_name(owner);
                let own = user_name(own_uid());
                return Err(DomainError::Occupied {
                    file: entry.path(),
                    owner,
                    own,
                });
            }
        }
        Ok(())
    }

    /// Settings of iceoryx2; its configuration files are not used.
    pub fn config(&self) -> Config {
        let mut config = Config::default();
        // With a path that is too long or contains a zero, creating the node fails, which is an
        // error there.
        if let Ok(root) = iceoryx2::prelude::Path::new(self.root.as_os_str().as_encoded_bytes()) {
            config.global.set_root_path(&root);
        }
        if let Ok(prefix) = FileName::new(self.prefix().as_bytes()) {
            config.global.prefix = prefix;
        }
        // The keeper of a publisher does this: it may block for long, which neither a sensor nor a
        // consumer may.
        config.global.node.cleanup_dead_nodes_on_creation = false;
        config.global.node.cleanup_dead_nodes_on_destruction = false;
        config.global.service.cleanup_dead_nodes_on_open = false;
        config
    }

    /// Its files in shared memory.
    pub fn shared_memory(&self) -> impl Iterator<Item = DirEntry> + use<> {
        let prefix = self.prefix();
        entries(Path::new(SHARED_MEMORY)).filter(move |entry| is_named(&name_of(entry), &prefix))
    }

    /// Removes access by other users to the counter by which iceoryx2 numbers nodes, which iceoryx2
    /// leaves open to all; only programs of the domain need it.
    pub fn close_to_others(&self) {
        for entry in self.shared_memory().filter(is_counter) {
            let _ = fs::set_permissions(entry.path(), fs::Permissions::from_mode(0o600));
        }
    }

    /// The folder of the service files.
    pub fn services(&self) -> PathBuf {
        self.root
            .join(Config::default().global.service.directory.to_string())
    }

    /// The folder of the nodes.
    pub fn nodes(&self) -> PathBuf {
        self.root
            .join(Config::default().global.node.directory.to_string())
    }

    /// The file of a service.
    pub fn service_file(&self, name: &ServiceName, pattern: MessagingPattern) -> PathBuf {
        let service = Config::default().global.service;
        let hash = service_hash(name, pattern);
        self.services().join(format!(
            "{}{}{}",
            self.prefix(),
            hash.as_str(),
            service.static_config_storage_suffix
        ))
    }

    /// The file that the publisher of a service holds locked.
    pub fn claim_file(&self, name: &ServiceName) -> PathBuf {
        let hash = service_hash(name, MessagingPattern::PublishSubscribe);
        self.root
            .join(format!("{}{}.claim", self.prefix(), hash.as_str()))
    }

    /// The socket by which a listener is woken.
    pub fn event_socket(&self, listener: u128) -> PathBuf {
        let ending = Config::default().global.service.event_connection_suffix;
        self.root
            .join(format!("{}{listener}{ending}", self.prefix()))
    }

    /// The folder of a node, there as long as others can find it.
    pub fn node_folder(&self, node: &iceoryx2::identifiers::UniqueNodeId) -> PathBuf {
        self.nodes().join(node.value().to_string())
    }
}

/// Every user may write to a folder.
const OTHERS_WRITE: u32 = 0o002;
/// Only the owner of a file in a folder, and root, may remove or rename it.
const STICKY: u32 = 0o1000;

/// The components of a path, the last one first. An absolute path begins at the root of the file
/// system.
fn steps(path: &Path) -> Vec<PathBuf> {
    let mut steps: Vec<PathBuf> = path
        .components()
        .filter(|step| *step != Component::CurDir)
        .map(|step| PathBuf::from(step.as_os_str()))
        .collect();
    steps.reverse();
    steps
}

/// Whether a file has a name of the domain with this prefix: the prefix, the 40 digits by which
/// iceoryx2 names the type, and the rest. (The prefix of the usual folders is the beginning of all
/// others.)
fn is_named(name: &str, prefix: &str) -> bool {
    let digits = name
        .strip_prefix(prefix)
        .and_then(|name| name.split_once('_'));
    digits.is_some_and(|(digits, _)| {
        digits.len() == 40 && digits.bytes().all(|byte| byte.is_ascii_hexdigit())
    })
}

/// The entries of a folder; none if it cannot be read.
pub fn entries(folder: &Path) -> impl Iterator<Item = DirEntry> + use<> {
    fs::read_dir(folder).into_iter().flatten().flatten()
}

/// The name of an entry; what of it is no text is replaced.
pub fn name_of(entry: &DirEntry) -> String {
    entry.file_name().to_string_lossy().into_owned()
}

fn service_hash(name: &ServiceName, pattern: MessagingPattern) -> ServiceHash {
    ServiceHash::new::<<Ipc as iceoryx2::service::Service>::ServiceNameHasher>(name, pattern)
}

/// Whether a file is the counter by which iceoryx2 numbers nodes.
fn is_counter(entry: &DirEntry) -> bool {
    let ending = Config::default().global.node.global_mgmt_suffix.to_string();
    entry.file_name().to_string_lossy().ends_with(&ending)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn domains_in_different_folders_share_no_name() {
        assert_eq!(Domain::at("/run/sweepd/iox2").prefix(), "sweepd_");
        // FNV-1a of "/a" by hand: (((basis ^ 0x2f) * prime) ^ 0x61) * prime.
        assert_eq!(Domain::at("/a").prefix(), "sweepd_07d66707b49cd92d_");
        assert_ne!(Domain::at("/a").prefix(), Domain::at("/b").prefix());
        assert_eq!(Domain::at("/a//./").prefix(), Domain::at("/a").prefix());
    }

    #[test]
    fn who_is_not_the_owner_is_told_how_to_remove_what_an_ended_daemon_left() {
        let error = |root: &str| {
            let root = root.into();
            let (owner, own) = ("root".to_owned(), "ada".to_owned());
            DomainError::OtherUser { root, owner, own }.to_string()
        };
        assert!(error(FALLBACK).contains("`sudo rm -r /tmp/sweepd`"));
        assert!(error("/var/lib/robot").contains("`sudo rm -r /var/lib/robot`"));
    }

    #[test]
    fn a_domain_knows_its_own_files() {
        let hash = "9204dd183d1c4d8e1ff592a30766ffa6765aa8b5";
        let (usual, other) = ("sweepd_", "sweepd_07d66707b49cd92d_");
        assert!(is_named(
            &format!("{usual}{hash}_node.0_10_0.global_mgmt"),
            usual
        ));
        assert!(is_named(&format!("{other}{hash}_1_2.connection"), other));
        assert!(!is_named(&format!("{other}{hash}_1_2.connection"), usual));
        assert!(!is_named("sweepd_x", usual) && !is_named(&format!("{usual}{hash}"), usual));
    }

    #[test]
    fn a_link_of_ones_own_is_followed_and_a_folder_open_to_all_is_not_safe() {
        let folder = std::env::temp_dir().join(format!("sweepd-way-{}", std::process::id()));
        fs::create_dir_all(folder.join("open/iox2")).unwrap();
        let open = |mode| {
            fs::set_permissions(folder.join("open"), fs::Permissions::from_mode(mode)).unwrap()
        };
        std::os::unix::fs::symlink("open/../open", folder.join("link")).unwrap();
        std::os::unix::fs::symlink("round", folder.join("round")).unwrap();
        open(0o777);
        let error = Domain::at(folder.join("link/iox2"))
            .exists()
            .unwrap_err()
            .to_string();
        assert!(
            error.contains("/open, which every user may write to"),
            "{error}"
        );
        for mode in [0o1777, 0o755] {
            open(mode);
            assert!(Domain::at(folder.join("link/iox2")).exists().unwrap());
            assert!(!Domain::at(folder.join("link/other")).exists().unwrap());
        }
        assert!(matches!(
            Domain::at(folder.join("round/iox2")).exists(),
            Err(DomainError::Unusable { .. })
        ));
        fs::remove_dir_all(folder).unwrap();
    }

    #[test]
    fn a_folder_of_another_user_is_refused_with_both_names() {
        // Whoever runs this is not the owner of both: /proc/1 is root's, nobody's are rare.
        let own = own_uid();
        let other = if own == 0 { None } else { Some("/proc/1") };
        if let Some(root) = other {
            let error = Domain::at(root).exists().unwrap_err().to_string();
            assert!(
                error.contains("user root") && error.contains(&user_name(own)),
                "{error}"
            );
        }
    }
}
