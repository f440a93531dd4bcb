//! Whatever dies, the others go on.

use std::os::unix::fs::MetadataExt;
use std::path::Path;
use std::time::{Duration, Instant};

use crate::{Process, SOON, Setup};

#[test]
fn consumers_go_on_when_the_daemon_is_killed_in_the_middle_of_a_sweep() {
    let setup = Setup::new("", "");
    let mut daemon = setup.daemon();
    let mut client = setup.client();
    let _sensor = setup.sensor("vlp16", 1200, 60.0);
    let mut slowest = Duration::ZERO;
    let mut run_ns = 0;
    for _ in 0..10 {
        for _ in 0..3 {
            let sweep = client.next(SOON).unwrap().expect("a sweep");
            run_ns = sweep.view().unwrap().header.run_ns;
        }
        daemon.signal("-KILL");
        daemon.wait();
        let killed = Instant::now();
        daemon = setup.daemon();
        // What was sent before may still wait.
        let mut next_run_ns = run_ns;
        while next_run_ns == run_ns {
            let sweep = client.next(SOON).unwrap().unwrap_or_else(|| panic!("no sweep: {}", setup.log()));
            next_run_ns = sweep.view().unwrap().header.run_ns;
            assert!(killed.elapsed() < SOON);
        }
        slowest = slowest.max(killed.elapsed());
    }
    // Detecting the model and the first cut take some tenths of a second of it.
    eprintln!("the longest without a sweep: {slowest:?}");
    assert_eq!(client.reopened(), 0, "the service outlives the daemon");
}

/// Files of a domain: in its folder, and in shared memory.
fn files(setup: &Setup) -> usize {
    fn within(folder: &Path) -> usize {
        let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
        entries.map(|entry| if entry.path().is_dir() { within(&entry.path()) } else { 1 }).sum()
    }
    within(setup.own.root()) + setup.own.shared_memory().len()
}

/// Bytes of shared memory that are really taken.
fn bytes(setup: &Setup) -> u64 {
    let files = setup.own.shared_memory();
    files.iter().filter_map(|file| file.metadata().ok()).map(|file| file.blocks() * 512).sum()
}

#[test]
fn crashes_leave_nothing_that_adds_up() {
    let setup = Setup::new("", "");
    let root = setup.own.root().to_str().unwrap().to_owned();
    let _sensor = setup.sensor("vlp16", 1200, 60.0);
    let mut counts = Vec::new();
    for _ in 0..10 {
        let mut daemon = setup.daemon();
        let mut watch = Process::start(&["watch", "roof", "--root", &root], &setup.path("watch.log"));
        let mut client = setup.client();
        for _ in 0..5 {
            assert!(client.next(SOON).unwrap().is_some(), "{}", setup.log());
        }
        counts.push((files(&setup), bytes(&setup)));
        // Both at once, and nobody left to clean up after them but those that come next.
        for one in [&mut daemon, &mut watch] {
            one.signal("-KILL");
            one.wait();
        }
    }
    let [(files, bytes), last @ ..] = &counts[1..] else { unreachable!() };
    // One more or less is the consumer that had not yet begun, or ended.
    let grown = last.iter().any(|(more_files, more)| *more_files > files + 12 || *more > bytes * 5 / 4);
    assert!(!grown, "files and bytes: {counts:?}");
    eprintln!("files and bytes while it runs, crash after crash: {counts:?}");
}

#[test]
fn nobody_notices_consumers_that_are_killed_with_sweeps_in_their_hands() {
    let setup = Setup::new("max_consumers = 2", "");
    let mut daemon = setup.daemon();
    let mut client = setup.client();
    let _sensor = setup.sensor("vlp16", 1200, 60.0);
    let root = setup.own.root().to_str().unwrap().to_owned();
    let (mut last, mut received, mut missed) = (None, 0, 0);
    let mut receive = |client: &mut sweepd::client::Client| {
        let sweep = client.next(SOON).unwrap().expect("a sweep");
        let sequence = sweep.view().unwrap().header.sequence;
        assert!(last.is_none_or(|last| sequence > last), "{last:?}, then {sequence}");
        // A busy machine may keep this one from fetching its sweep in time, now and then.
        missed += last.map_or(0, |last| sequence - last - 1);
        received += 1;
        assert!(missed <= 3 + received / 4, "{missed} missed, {received} received");
        last = Some(sequence);
    };
    for _ in 0..10 {
        // There is room for one beside this one: what the dead had must be given back each time.
        let args = ["watch", "roof", "--root", &root, "--png", setup.folder.to_str().unwrap()];
        let mut other = Process::start(&args, &setup.path("watch.log"));
        // Long enough for it to draw, holding a sweep.
        let begun = Instant::now();
        while begun.elapsed() < Duration::from_millis(500) {
            receive(&mut client);
        }
        other.signal("-KILL");
        other.wait();
    }
    for _ in 0..10 {
        receive(&mut client);
    }
    let watched = std::fs::read_to_string(setup.path("watch.log")).unwrap();
    assert!(!watched.contains("error"), "{watched}");
    assert!(setup.folder.read_dir().unwrap().flatten().any(|it| it.path().extension().is_some_and(|it| it == "png")));
    daemon.signal("-TERM");
    let begun = Instant::now();
    assert!(daemon.wait() && begun.elapsed() < Duration::from_secs(1), "{:?}", begun.elapsed());
}

#[test]
fn consumers_find_the_daemon_again_when_all_its_files_are_deleted() {
    let setup = Setup::new("", "");
    let _daemon = setup.daemon();
    let mut client = setup.client();
    let _sensor = setup.sensor("vlp16", 1200, 60.0);
    for round in 1..=3 {
        assert!(client.next(SOON).unwrap().is_some());
        std::fs::remove_dir_all(setup.own.root()).unwrap();
        let begun = Instant::now();
        while client.reopened() < round {
            client.next(Duration::from_millis(100)).unwrap();
            assert!(begun.elapsed() < SOON);
        }
        // And one that starts only now finds it too.
        let mut late = setup.client();
        for client in [&mut client, &mut late] {
            for _ in 0..10 {
                assert!(client.next(SOON).unwrap().is_some());
            }
        }
    }
}
