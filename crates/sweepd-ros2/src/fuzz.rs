//! Ways into the program: for a test, and for the fuzzer (tests/fuzz).

use crate::{health, parameters};

/// A way in, and inputs that make sense to it.
struct Target {
    #[cfg_attr(test, allow(dead_code))]
    name: &'static str,
    run: fn(&[u8]),
    seeds: &'static [&'static str],
}

static TARGETS: [Target; 2] = [
    Target {
        name: "parameters",
        run: parameters::fuzz,
        seeds: &[
            include_str!("../../../systemd/ros2.yaml"),
            "/**:\n  ros__parameters:\n    sensors: [roof]\n    roof: {stamp: middle, fields: [ring], scan_heights: [-1, 2.5]}\n",
            "/robot:\n  sweepd:\n    ros__parameters: &all {scan_ring: 7, health: '', clock: yes, base_frame: ''}\n/*:\n  ros__parameters: *all\n",
        ],
    },
    Target {
        name: "health_of_node",
        run: health::fuzz,
        seeds: &[
            r#"{"status": "warning", "root": "/run/sweepd", "reasons": ["roof: losing"], "version": "9", "pid": 7,
            "sensors": [{"name": "roof", "state": "streaming", "is_fault": false, "reason": "3 %", "gps": "locked", "packets": 9,
            "refused": {"too_short": 1, "other": {"deep": 2}}}], "ports": [{"name": "port 2368", "port": 2368, "dropped": 5}]}"#,
        ],
    },
];

/// The target that `SWEEPD_FUZZ_TARGET` names.
#[cfg(fuzzing)]
static TARGET: std::sync::LazyLock<&Target> = std::sync::LazyLock::new(|| {
    let name = std::env::var("SWEEPD_FUZZ_TARGET").expect("SWEEPD_FUZZ_TARGET, a target");
    let target = TARGETS.iter().find(|target| target.name == name);
    target.expect("the name of a target")
});

/// Runs the target.
#[cfg(fuzzing)]
pub fn run(input: &[u8]) {
    (TARGET.run)(input);
}

/// Writes the seeds of the target to the folder `SWEEPD_FUZZ_CORPUS`.
#[cfg(fuzzing)]
pub fn write_seeds() {
    let folder = std::env::var("SWEEPD_FUZZ_CORPUS").expect("SWEEPD_FUZZ_CORPUS, a folder");
    for (number, seed) in TARGET.seeds.iter().enumerate() {
        let path = format!("{folder}/seed-{number:03}");
        std::fs::write(&path, seed).unwrap_or_else(|error| panic!("{path}: {error}"));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use fastrand::Rng;
    use std::panic;
    use sweepd_testkit::mutate::mutated;

    /// Changed inputs for each target.
    const ROUNDS: usize = 500;

    #[test]
    fn whatever_is_read_does_no_harm() {
        let mut rng = Rng::with_seed(1);
        for Target { run, seeds, .. } in &TARGETS {
            seeds.iter().for_each(|seed| run(seed.as_bytes()));
            for _ in 0..ROUNDS {
                let [one, other] = [(); 2].map(|()| seeds[rng.usize(..seeds.len())].as_bytes());
                let input = mutated(&mut rng, one, other);
                let done = panic::catch_unwind(|| run(&input));
                assert!(done.is_ok(), "\"{}\"", input.escape_ascii());
            }
        }
    }
}
