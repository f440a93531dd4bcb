//! Examines this host.

use std::fs;
use std::io;
use std::net::Ipv4Addr;
use std::path::Path;

use getifaddrs::{Address, InterfaceFilter};
use rustix::fs::{Access, access};

use super::observe::{Host, Interface, RootTrouble};
use crate::publish::{self, Domain};

/// Examines this host; `root` is the folder of iceoryx2's files, if not the default. Leaves out
/// what cannot be determined.
pub fn look(root: Option<&Path>) -> Host {
    Host {
        interfaces: interfaces(),
        rmem_max: read("/proc/sys/net/core/rmem_max"),
        shared: publish::memory_bytes().ok(),
        root_trouble: root_trouble(&Domain::at_or_default(root)),
    }
}

/// Those that are up, and those that are down and have a plug.
fn interfaces() -> Vec<Interface> {
    let addresses = addresses().unwrap_or_default();
    let entries = fs::read_dir("/sys/class/net")
        .into_iter()
        .flatten()
        .flatten();
    let names = entries
        .filter_map(|entry| entry.file_name().into_string().ok())
        .filter(|name| name != "lo");
    let mut interfaces: Vec<Interface> = names
        .map(|name| {
            let file =
                |what: &str| fs::read_to_string(format!("/sys/class/net/{name}/{what}")).ok();
            let flags = file("flags")
                .and_then(|text| u32::from_str_radix(text.trim().strip_prefix("0x")?, 16).ok());
            let own = addresses.iter().filter(|(interface, _)| *interface == name);
            Interface {
                up: flags.is_some_and(|flags| flags & 1 != 0),
                // Reading it fails while the interface is down.
                carrier: file("carrier").map(|text| text.trim() == "1"),
                addresses: own.map(|(_, address)| *address).collect(),
                name,
            }
        })
        .filter(|one: &Interface| {
            one.up || Path::new(&format!("/sys/class/net/{}/device", one.name)).exists()
        })
        .collect();
    interfaces.sort_by(|a, b| a.name.cmp(&b.name));
    interfaces
}

/// The IPv4 addresses of this host with their interfaces, and how many bits are those of the net.
fn addresses() -> io::Result<Vec<(String, (Ipv4Addr, u8))>> {
    let mut found = Vec::new();
    for interface in InterfaceFilter::new().v4().get()? {
        if let Address::V4(own) = interface.address
            && let Some(mask) = own.netmask
        {
            let bits = u32::from(mask).count_ones() as u8;
            found.push((interface.name, (own.address, bits)));
        }
    }
    Ok(found)
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

    #[test]
    fn loopback_is_an_address_of_every_host() {
        let found = addresses().unwrap();
        assert!(found.contains(&("lo".to_owned(), (Ipv4Addr::LOCALHOST, 8))));
    }
}
