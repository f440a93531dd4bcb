//! Examines this host.

use std::fs;
use std::path::Path;

use rustix::fs::{Access, access};

use super::observe::{Host, RootTrouble};
use crate::network;
use crate::publish::{self, Domain};

/// Examines this host; `root` is the folder of iceoryx2's files, if not the default. Leaves out
/// what cannot be determined.
pub fn look(root: Option<&Path>) -> Host {
    Host {
        interfaces: network::interfaces(),
        drops: None,
        rmem_max: read("/proc/sys/net/core/rmem_max"),
        shared: publish::memory_bytes().ok(),
        root_trouble: root_trouble(&Domain::at_or_default(root)),
    }
}

fn root_trouble(domain: &Domain) -> Option<RootTrouble> {
    let exists = match domain
        .exists()
        .and_then(|exists| domain.check_occupied().map(|()| exists))
    {
        Ok(exists) => exists,
        Err(error) => return Some(RootTrouble::Unusable(error.to_string())),
    };
    // If it does not exist yet, the nearest existing parent counts.
    let folder = domain
        .root()
        .ancestors()
        .skip(usize::from(!exists))
        .find(|folder| folder.exists())?;
    let may_make_files = access(folder, Access::WRITE_OK | Access::EXEC_OK).is_ok();
    (!may_make_files).then(|| RootTrouble::NotWritable {
        folder: folder.to_owned(),
    })
}

fn read(path: &str) -> Option<u64> {
    fs::read_to_string(path).ok()?.trim().parse().ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn this_host_can_be_looked_at() {
        let folder =
            std::env::temp_dir().join(format!("sweepd-doctor-host-{}", std::process::id()));
        let host = look(Some(&folder.join("deep/root")));
        assert!(host.rmem_max.is_some_and(|bytes| bytes > 1000));
        assert!(host.shared.is_some_and(|(all, free)| all >= free));
        assert_eq!(host.root_trouble, None);
        assert!(!folder.exists(), "nothing is made");
        std::fs::write(&folder, "a file").unwrap();
        let trouble = look(Some(&folder)).root_trouble;
        std::fs::remove_file(&folder).unwrap();
        assert!(
            matches!(trouble, Some(RootTrouble::Unusable(_))),
            "{trouble:?}"
        );
    }
}
