//! Files that somebody deletes while sweeps are shared: an administrator, or logind's RemoveIPC.

use std::fs;
use std::path::{Path, PathBuf};
use std::time::Duration;

use sweepd_testkit::Stopwatch;

use crate::crashes::{Robot, in_time};
use sweepd_testkit::setup::{SOON, Setup};

/// Until then the health page tells of it.
const TOLD: Duration = Duration::from_millis(1500);
/// As long after that the consumer that was connected gets sweeps again.
const AGAIN: Duration = Duration::from_secs(1);

/// Which files are deleted.
struct Kind {
    name: &'static str,
    /// Part of their paths; of several such files, the one of this number alone.
    holds: &'static str,
    number: Option<usize>,
    /// Whether no consumer can connect without them, so that the service must be made again.
    is_vital: bool,
}

const fn kind(
    name: &'static str,
    holds: &'static str,
    number: Option<usize>,
    is_vital: bool,
) -> Kind {
    Kind {
        name,
        holds,
        number,
        is_vital,
    }
}

const KINDS: [Kind; 16] = [
    kind("the pool", ".data", None, true),
    kind("a list of ports", ".dynamic", Some(0), true),
    kind("the second list of ports", ".dynamic", Some(1), true),
    kind("the third list of ports", ".dynamic", Some(2), true),
    kind("the fourth list of ports", ".dynamic", Some(3), true),
    kind("the connections", ".connection", None, false),
    kind("the counters of events", ".event_mgmt", None, false),
    kind("the counter of nodes", ".global_mgmt", None, false),
    kind("all shared memory", "/dev/shm/", None, true),
    kind("a service", ".service", Some(0), false),
    kind("the other service", ".service", Some(1), false),
    kind("all services", "/services", None, false),
    kind("all nodes", "/nodes", None, false),
    kind("the sockets of events", ".event", None, false),
    kind("the claim", ".claim", None, false),
    kind("everything", "/", None, true),
];

/// All files of a domain and the folders in its folder.
fn entries(setup: &Setup) -> Vec<PathBuf> {
    let of = |folder: &Path| {
        fs::read_dir(folder)
            .into_iter()
            .flatten()
            .flatten()
            .map(|entry| entry.path())
            .collect()
    };
    let root = setup.own.root();
    let mut entries: Vec<PathBuf> = [
        of(root),
        of(&root.join("services")),
        setup.own.shared_memory(),
    ]
    .concat();
    entries.sort();
    entries
}

fn delete(setup: &Setup, kind: &Kind) {
    let is_meant = |path: &PathBuf| {
        let path = path.to_str().unwrap();
        if kind.holds.starts_with('.') {
            path.ends_with(kind.holds)
        } else {
            path.contains(kind.holds)
        }
    };
    let meant: Vec<PathBuf> = entries(setup).into_iter().filter(is_meant).collect();
    assert!(
        !meant.is_empty(),
        "{}: there are none among {:?}",
        kind.name,
        entries(setup)
    );
    for path in meant
        .iter()
        .enumerate()
        .filter(|(index, _)| kind.number.is_none_or(|number| number == *index))
    {
        // What is in a folder that is gone is gone.
        let _ = if path.1.is_dir() {
            fs::remove_dir_all(path.1)
        } else {
            fs::remove_file(path.1)
        };
    }
    if kind.holds == "/" {
        let _ = fs::remove_dir_all(setup.own.root());
    }
}

/// How often the service was made again, and why for the last time.
fn renewed(setup: &Setup) -> Option<(u64, String)> {
    let sensor = setup.health()?;
    Some((
        sensor["renewed"].as_u64()?,
        sensor["renewed_because"]
            .as_str()
            .unwrap_or_default()
            .to_owned(),
    ))
}

fn try_kind(robot: &Robot, kind: &Kind) -> Result<(), String> {
    let setup = &robot.setup;
    let (before, _) = renewed(setup).unwrap_or_default();
    delete(setup, kind);
    let (since, mut told) = (Stopwatch::start(), None);
    // Of what is no fault, nothing need come.
    let limit = if kind.is_vital { SOON } else { TOLD };
    while since.begun.elapsed() < limit && told.is_none() {
        std::thread::sleep(Duration::from_millis(20));
        told = renewed(setup).filter(|(count, _)| *count > before);
    }
    let took = since.elapsed();
    match told {
        None if kind.is_vital => {
            return Err(format!("/health does not tell of it within {SOON:?}"));
        }
        Some(_) if kind.is_vital && took > TOLD => {
            return Err(format!("/health tells of it after {took:.1?} only"));
        }
        Some((_, because)) if because.is_empty() => {
            return Err("/health does not say why".to_owned());
        }
        _ => {}
    }
    // The consumer that is there may go on for a moment with what it has mapped: what counts is
    // what comes later.
    std::thread::sleep(TOLD.saturating_sub(since.begun.elapsed()));
    in_time(
        "the consumer that was connected",
        &robot.steady,
        5,
        Stopwatch::start(),
        AGAIN,
    )?;
    robot.check(Stopwatch::start())
}

/// Deletes each of these kinds; a fault gets a new daemon for the next kind.
fn try_kinds(kinds: &[Kind]) -> Vec<String> {
    let mut faults = Vec::new();
    let mut robot = Robot::start();
    for kind in kinds {
        if let Err(error) = try_kind(&robot, kind) {
            faults.push(format!("{} deleted: {error}\n{}", kind.name, robot.logs()));
            robot = Robot::start();
        }
    }
    faults.extend(robot.end().err());
    faults
}

#[test]
fn deleted_files_are_made_again_and_reported_and_all_consumers_continue() {
    let faults = std::thread::scope(|scope| {
        let (left, right) = KINDS.split_at(KINDS.len() / 2);
        let left = scope.spawn(|| try_kinds(left));
        [try_kinds(right), left.join().unwrap()].concat()
    });
    assert!(faults.is_empty(), "{}", faults.join("\n\n"));
}
