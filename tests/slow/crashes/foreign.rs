//! Another user was there first: the programs say whose it is and end, and write nothing where that
//! user leads them.

use std::fs::{self, Permissions};
use std::os::unix::fs::{PermissionsExt, chown, lchown, symlink};
use std::path::{Path, PathBuf};

use sweepd::client::Domain;

use sweepd_testkit::{
    domain::shared_memory,
    free_port,
    setup::{Process, SOON, Setup},
    temp_domain,
};

/// The user `nobody`.
const OTHER: u32 = 65_534;
/// The counter of nodes has the same name for every domain, behind the prefix.
const COUNTER: &str = "9204dd183d1c4d8e1ff592a30766ffa6765aa8b5_node.0_10_0.global_mgmt";

fn temporary(name: &str, ending: &str) -> PathBuf {
    std::env::temp_dir().join(format!(
        "sweepd-foreign-{}-{}.{ending}",
        std::process::id(),
        name.replace(' ', "-")
    ))
}

/// Runs `sweepd` until its end, which must come by itself, with exit code 1 and one error
/// with all these parts and a cure; else gives what is wrong.
fn fault(name: &str, args: &[&str], parts: &[&str]) -> Option<String> {
    let log = temporary(name, "log");
    let ended = Process::start(args, &log).ends_within(SOON);
    let said = fs::read_to_string(&log).unwrap();
    let _ = fs::remove_file(&log);
    let Some(status) = ended else {
        return Some(format!("{name}: `sweepd {}` goes on: {said}", args[0]));
    };
    let errors: Vec<&str> = said
        .lines()
        .filter(|line| line.starts_with("error: "))
        .collect();
    let has = |part: &&str| errors.len() == 1 && errors[0].contains(*part);
    let is_told =
        parts.iter().all(has) && ["remove", "--root", "SWEEPD_ROOT", "sudo "].iter().any(has);
    let is_right = status.code() == Some(1) && is_told;
    (!is_right).then(|| {
        format!("{name}: `sweepd {}` ended with {status}, want one error with {parts:?} and a cure: {said}", args[0])
    })
}

/// A file or folder of the other user.
fn gives(path: &Path, mode: u32) {
    fs::set_permissions(path, Permissions::from_mode(mode)).unwrap();
    chown(path, Some(OTHER), Some(OTHER)).unwrap();
}

/// What is wrong with how both sides refuse a folder.
fn faults(name: &str, root: &Path, parts: &[&str]) -> Vec<String> {
    let folder = root.to_str().unwrap();
    let config = temporary(name, "toml");
    let port = free_port();
    let text = format!(
        "http = \"off\"\nroot = \"{folder}\"\n[[sensor]]\nname = \"roof\"\naddress = \"127.0.0.1\"\nbind = \"127.0.0.1\"\n\
         port = {port}\nposition_port = {port}\n"
    );
    fs::write(&config, text).unwrap();
    let sides = [
        vec!["watch", "roof", "--root", folder],
        vec!["run", "--config", config.to_str().unwrap()],
    ];
    let faults = sides
        .iter()
        .filter_map(|args| fault(name, args, parts))
        .collect();
    let _ = fs::remove_file(&config);
    faults
}

#[test]
#[cfg_attr(without_root, ignore = "not root, or no namespaces")]
fn a_folder_behind_a_link_or_below_a_folder_of_another_user_is_refused() {
    let own = temp_domain();
    let [evil, target] = ["evil", "target"].map(|name| own.root().join(name));
    fs::create_dir_all(&evil).unwrap();
    fs::create_dir(&target).unwrap();
    gives(&evil, 0o755);
    // Where it leads belongs to this user: that is the trick.
    let link = evil.join("link");
    symlink(&target, &link).unwrap();
    lchown(&link, Some(OTHER), Some(OTHER)).unwrap();
    let below = evil.join("below");
    fs::create_dir(&below).unwrap();
    let cases: [(&str, PathBuf); 4] = [
        ("a link", link.clone()),
        ("below a link", link.join("iox2")),
        ("below a folder", below.clone()),
        ("two below a folder", below.join("iox2")),
    ];
    let mut found = Vec::new();
    for (name, root) in cases {
        found.extend(faults(name, &root, &[evil.to_str().unwrap(), "nobody"]));
        for folder in [&target, &below] {
            let left: Vec<_> = fs::read_dir(folder)
                .unwrap()
                .flatten()
                .map(|entry| entry.path())
                .collect();
            if !left.is_empty() {
                found.push(format!("{name}: {left:?} was made"));
                left.iter().for_each(|path| {
                    fs::remove_dir_all(path)
                        .or_else(|_| fs::remove_file(path))
                        .unwrap()
                });
            }
        }
        for left in shared_memory(&Domain::at(&root)) {
            fs::remove_file(left).unwrap();
        }
    }
    assert!(found.is_empty(), "{}", found.join("\n"));
}

#[test]
#[cfg_attr(without_root, ignore = "not root, or no namespaces")]
fn shared_memory_of_another_user_under_the_name_of_the_counter_is_refused() {
    // A true one.
    let setup = Setup::new("", "");
    let daemon = setup.daemon();
    drop(setup.client());
    let true_file = setup
        .own
        .shared_memory()
        .into_iter()
        .find(|path| path.to_str().unwrap().ends_with(COUNTER))
        .unwrap();
    let true_bytes = fs::read(true_file).unwrap();
    drop(daemon);
    let random = b"\x9c\x03\xf1\x5e\x77\xa0\x12\xd8\x44\xe9\x0b\x6f\xc5\x31\x8a\x20";
    let mut found = Vec::new();
    for (name, bytes, mode) in [
        ("empty", &[][..], 0o600),
        ("random", random, 0o600),
        ("a copy", &true_bytes, 0o666),
    ] {
        let own = temp_domain();
        fs::create_dir_all(own.root()).unwrap();
        fs::set_permissions(own.root(), Permissions::from_mode(0o750)).unwrap();
        let file = Path::new("/dev/shm").join(format!("{}{COUNTER}", own.domain().prefix()));
        fs::write(&file, bytes).unwrap();
        gives(&file, mode);
        found.extend(faults(
            name,
            own.root(),
            &[file.to_str().unwrap(), "nobody"],
        ));
        if fs::read(&file).ok().as_deref() != Some(bytes) {
            found.push(format!("{name}: it was written to or removed"));
        }
    }
    assert!(found.is_empty(), "{}", found.join("\n"));
}
