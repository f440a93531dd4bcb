//! What single kills cost the others: sweeps, time, room for consumers.

use std::fs;
use std::path::PathBuf;
use std::time::{Duration, Instant};

use sweepd_testkit::setup::{Process, SOON, Setup};

#[test]
fn consumers_go_on_when_the_daemon_is_killed_in_the_middle_of_a_sweep() {
    let _alone = sweepd_testkit::alone();
    let setup = Setup::new("", "");
    let mut daemon = setup.daemon();
    let mut client = setup.client();
    let _sensor = setup.sensor("vlp16", 1200, 60.0);
    let mut slowest = Duration::ZERO;
    let mut run_ns = 0;
    for _ in 0..10 {
        for _ in 0..3 {
            let sweep = client.next(SOON).unwrap().received().expect("a sweep");
            run_ns = sweep.view().unwrap().header.run_ns;
        }
        daemon.signal("-KILL");
        daemon.wait();
        let killed = Instant::now();
        daemon = setup.daemon();
        // What was sent before may still wait.
        let mut next_run_ns = run_ns;
        while next_run_ns == run_ns {
            let sweep = client
                .next(SOON)
                .unwrap()
                .received()
                .unwrap_or_else(|| panic!("no sweep: {}", setup.log()));
            next_run_ns = sweep.view().unwrap().header.run_ns;
            assert!(killed.elapsed() < SOON);
        }
        slowest = slowest.max(killed.elapsed());
    }
    // Detecting the model and the first cut take some tenths of a second of it.
    eprintln!("the longest without a sweep: {slowest:?}");
    assert_eq!(client.reopened(), 0, "the service outlives the daemon");
}

#[test]
fn consumers_killed_while_they_hold_sweeps_cost_the_others_none() {
    let _alone = sweepd_testkit::alone();
    let setup = Setup::new("max_consumers = 2", "");
    let mut daemon = setup.daemon();
    let mut client = setup.client();
    let _sensor = setup.sensor("vlp16", 1200, 60.0);
    let (mut last, mut received, mut missed) = (None, 0, 0);
    let mut receive = |client: &mut sweepd::client::Client| {
        let sweep = client.next(SOON).unwrap().received().expect("a sweep");
        let sequence = sweep.view().unwrap().header.sequence;
        assert!(
            last.is_none_or(|last| sequence > last),
            "{last:?}, then {sequence}"
        );
        // A busy machine may keep this one from fetching its sweep in time, now and then.
        missed += last.map_or(0, |last| sequence - last - 1);
        received += 1;
        assert!(
            missed <= 3 + received,
            "{missed} missed, {received} received"
        );
        last = Some(sequence);
    };
    for _ in 0..10 {
        // There is room for one beside this one: what the dead had must be given back each time.
        let args = [
            &setup.watch_args()[..],
            &["--force", "--png", setup.own.folder().to_str().unwrap()],
        ]
        .concat();
        let mut other = Process::start(&args, &setup.path("watch.log"));
        // It draws, and holds a sweep meanwhile.
        let begun = Instant::now();
        while begun.elapsed() < Duration::from_millis(300) || drawings(&setup).is_empty() {
            receive(&mut client);
            assert!(begun.elapsed() < SOON, "nothing is drawn");
        }
        for drawing in drawings(&setup) {
            fs::remove_file(drawing).unwrap();
        }
        other.signal("-KILL");
        other.wait();
    }
    for _ in 0..10 {
        receive(&mut client);
    }
    assert_eq!(setup.health().unwrap()["unshared_sweeps"], 0);
    let watched = fs::read_to_string(setup.path("watch.log")).unwrap();
    assert!(!watched.contains("error"), "{watched}");
    daemon.ends_when_told().unwrap();
}

/// The PNGs that a consumer has drawn.
fn drawings(setup: &Setup) -> Vec<PathBuf> {
    let files = fs::read_dir(setup.own.folder()).unwrap().flatten();
    files
        .map(|file| file.path())
        .filter(|path| path.extension().is_some_and(|it| it == "png"))
        .collect()
}

#[test]
fn a_consumer_ends_well_while_it_opens_a_service_whose_lists_are_gone() {
    let setup = Setup::new("", "");
    let mut daemon = setup.daemon();
    drop(setup.client());
    daemon.signal("-KILL");
    daemon.wait();
    let is_list = |path: &PathBuf| path.extension().is_some_and(|it| it == "dynamic");
    let lists: Vec<PathBuf> = setup
        .own
        .shared_memory()
        .into_iter()
        .filter(is_list)
        .collect();
    assert!(!lists.is_empty());
    for list in lists {
        fs::remove_file(list).unwrap();
    }
    for attempt in 0..3 {
        let log = setup.path(&format!("watch-{attempt}.log"));
        let mut consumer = Process::start(&setup.watch_args(), &log);
        let begun = Instant::now();
        let waits = "its service is there, but cannot be opened: is the daemon running?; waiting";
        while !fs::read_to_string(&log).is_ok_and(|said| said.contains(waits)) {
            assert!(begun.elapsed() < SOON, "it does not wait");
            std::thread::sleep(Duration::from_millis(20));
        }
        // Most of the time it waits inside the library, which a signal interrupts.
        std::thread::sleep(Duration::from_millis(200 + 70 * attempt));
        consumer
            .ends_when_told()
            .unwrap_or_else(|error| panic!("{error}: {}", fs::read_to_string(&log).unwrap()));
    }
}
