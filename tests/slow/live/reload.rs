//! SIGHUP: segmentation changes with the next sweep, and what cannot change is named alone.

use std::process::Command;
use std::time::Instant;

use sweepd_testkit::setup::{SOON, Setup, sweepd};

/// Points of each segment of the next sweeps, as `watch --segments` writes them.
fn points(setup: &Setup) -> Vec<u32> {
    let file = setup.path("segments.csv");
    let mut watch: Command = sweepd(&setup.watch_args());
    watch
        .args(["--sweeps", "6", "--timeout", "60", "--force", "--segments"])
        .arg(&file);
    assert!(watch.output().unwrap().status.success(), "{}", setup.log());
    let text = std::fs::read_to_string(&file).unwrap();
    let mut lines = text.lines().map(|line| line.split(',').collect::<Vec<_>>());
    let names = lines.next().unwrap();
    let column = |name: &str| names.iter().position(|one| *one == name).unwrap();
    let rows: Vec<_> = lines.collect();
    let mut sweeps: Vec<_> = rows.iter().map(|row| row[column("time_ns")]).collect();
    sweeps.dedup();
    // A consumer that comes gets the sweep before, and up to two waited while it had no core.
    let newest = &sweeps[sweeps.len() - 3..];
    rows.iter()
        .filter(|row| newest.contains(&row[column("time_ns")]))
        .map(|row| row[column("points")].parse().unwrap())
        .collect()
}

#[test]
fn segmentation_settings_take_effect_with_the_next_sweep() {
    let setup = Setup::new("segment = { min_points = 10 }", "");
    let daemon = setup.daemon();
    let _sensor = setup.sensor("vlp16", 600, 120.0);
    let least = |setup: &Setup| *points(setup).iter().min().unwrap();
    assert!((10..40).contains(&least(&setup)));
    let file = setup.daemon_args()[2].to_owned();
    let first = std::fs::read_to_string(&file).unwrap();
    for (turn, segment) in [
        "min_points = 3, theta_deg = 12",
        "min_points = 40, theta_deg = 12",
    ]
    .iter()
    .enumerate()
    {
        // Another consumer limit can only be had by a restart.
        let text = first.replace(
            "segment = { min_points = 10 }",
            &format!("max_consumers = 3\nsegment = {{ {segment} }}"),
        );
        std::fs::write(&file, text).unwrap();
        daemon.signal("-HUP");
        let begun = Instant::now();
        while setup
            .log()
            .matches("decoded with the new configuration")
            .count()
            <= turn
        {
            assert!(begun.elapsed() < SOON, "it is not taken");
            std::thread::sleep(std::time::Duration::from_millis(10));
        }
        let least = least(&setup);
        assert!(
            if turn == 0 {
                (3..10).contains(&least)
            } else {
                least >= 40
            },
            "{segment}: {least} points"
        );
    }
    let log = setup.log();
    for line in [
        "INFO sensor roof: min_points 10 -> 3",
        "INFO sensor roof: theta_deg 10 -> 12",
        "INFO sensor roof: min_points 3 -> 40",
        "WARN sensor roof: max_consumers 4 -> 3 needs a restart",
    ] {
        assert!(log.contains(line), "no {line:?}");
    }
    assert_eq!(
        log.matches("needs a restart").count(),
        2,
        "each time, and alone"
    );
}
