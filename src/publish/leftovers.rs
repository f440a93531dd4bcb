//! What processes that died left in a domain: services and nodes that were never completed, files of
//! ports that are gone, lists of services that do not exist.
//!
//! iceoryx2 0.10 never removes a node that died before it was complete. For the one process that
//! looks after the domain; what every process removes is in [`sweepd_client::leftovers`].

use std::fs::{self, DirEntry, Metadata};
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};

use iceoryx2::prelude::*;
use sweepd_client::domain::{Domain, entries, name_of};
use sweepd_client::leftovers::{is_abandoned, remove, remove_if_abandoned};
use sweepd_client::service::Ipc;

const OWNER_READ: u32 = 0o400;
const OWNER_WRITE: u32 = 0o200;

/// Removes the files of services and nodes that were never completed, and of ports that are gone.
/// For the one process that looks after the domain.
pub(super) fn remove_remains(domain: &Domain) {
    // A service's file is written, and then closed to writing.
    for entry in entries(&domain.services()) {
        if let Ok(metadata) = entry.metadata()
            && is_half_written(&metadata)
        {
            remove_if_abandoned(&entry, &metadata);
        }
    }
    remove_files_of_ports(domain);
    remove_nodes(domain);
}

/// Whether the file of a service is not complete: its maker closes it to writing at last.
pub(super) fn is_half_written(metadata: &Metadata) -> bool {
    metadata.mode() & OWNER_WRITE != 0
}

/// A listener has a file of shared memory and a socket; a publisher and a subscriber share a
/// connection. A port has a tag of its number, which is made before these files and removed after
/// them. iceoryx2 leaves them where a process died before its service knew of the listener, or
/// before the connection knew of its port.
fn remove_files_of_ports(domain: &Domain) {
    let mut files = Vec::new();
    for entry in domain.shared_memory().chain(entries(domain.root())) {
        if let Some(ports) = ports_of(&name_of(&entry)) {
            files.push((entry, ports));
        }
    }
    // Looked for later than the files: a port without a tag is then gone, not new.
    let nodes = entries(&domain.nodes()).map(|entry| entry.path());
    let tags: Vec<String> = nodes
        .flat_map(|node| entries(&node))
        .map(|entry| name_of(&entry))
        .collect();
    for (entry, ports) in files {
        let has_tag = |port: &String| tags.iter().any(|name| name.ends_with(port));
        if !ports.iter().all(has_tag)
            && let Ok(metadata) = entry.metadata()
        {
            remove_if_abandoned(&entry, &metadata);
        }
    }
}

/// How the names of the tags end of the ports that a file belongs to; `None` for other files.
fn ports_of(name: &str) -> Option<Vec<String>> {
    let (name, kind) = name.split_once('.')?;
    let ports = match kind {
        "event" | "event_mgmt" => 1,
        "connection" => 2,
        _ => return None,
    };
    let numbers = name.rsplit('_').take(ports);
    Some(numbers.map(|port| format!("_{port}.port_tag")).collect())
}

/// Removes lists of participants whose service does not exist: it is made after its list, and its
/// maker died in between. Those of `known` services stay, and so does one that was no orphan at the
/// last look: a living publisher puts the file of its service back within a second. Call when
/// nothing unfinished is pending.
pub(super) fn remove_lists(domain: &Domain, known: &[&Path], orphans: &mut Vec<PathBuf>) {
    let mut lists = Vec::new();
    for entry in domain.shared_memory() {
        let (name, path) = (name_of(&entry), entry.path());
        let number = name
            .strip_suffix(".dynamic")
            .and_then(|name| name.rsplit_once('_'))
            .and_then(|(_, number)| number.parse::<u128>().ok());
        if let (Some(number), Ok(metadata)) = (number, entry.metadata())
            && is_abandoned(&metadata)
            && !known.contains(&path.as_path())
        {
            lists.push((number, path));
        }
    }
    let before = std::mem::take(orphans);
    if lists.is_empty() {
        return;
    }
    let files = entries(&domain.services()).count();
    let mut services = Vec::new();
    let listed = <Ipc as iceoryx2::service::Service>::list(&domain.config(), |details| {
        services.push(details.static_details.unique_service_id().value());
        CallbackProgression::Continue
    });
    // One that could not be read may be the service of any of them.
    if listed.is_err() || services.len() < files {
        return;
    }
    for (number, path) in lists {
        if services.contains(&number) {
            continue;
        }
        if before.contains(&path) {
            let _ = fs::remove_file(path);
        } else {
            orphans.push(path);
        }
    }
}

/// A node is made in this order: its folder with its details, then the three files of its monitor,
/// of which the context is opened to reading last. It is removed in the same order. One without
/// details or without a finished context is therefore half made or half removed, and iceoryx2 does
/// not look at it.
fn remove_nodes(domain: &Domain) {
    use std::collections::BTreeMap;

    /// The files of one node.
    #[derive(Default)]
    struct NodeFiles {
        files: Vec<DirEntry>,
        has_details: bool,
        has_context: bool,
    }

    let prefix = domain.prefix();
    let mut nodes: BTreeMap<String, NodeFiles> = BTreeMap::new();
    for entry in entries(&domain.nodes()) {
        let (name, Ok(metadata)) = (name_of(&entry), entry.metadata()) else {
            continue;
        };
        if metadata.is_dir() {
            let node = nodes.entry(name).or_default();
            node.has_details =
                entries(&entry.path()).any(|file| name_of(&file).ends_with(".details"));
            node.files.push(entry);
        } else if let Some((id, kind)) = name
            .strip_prefix(&prefix)
            .and_then(|name| name.split_once('.'))
        {
            let node = nodes.entry(id.to_owned()).or_default();
            node.has_context |= kind.ends_with("_context") && metadata.mode() & OWNER_READ != 0;
            node.files.push(entry);
        }
    }
    for node in nodes
        .values()
        .filter(|node| !node.has_details || !node.has_context)
    {
        if node.files.iter().all(|file| {
            file.metadata()
                .is_ok_and(|metadata| is_abandoned(&metadata))
        }) {
            node.files.iter().for_each(remove);
        }
    }
}
