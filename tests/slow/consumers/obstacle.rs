//! The nearest obstacle in a zone: what C and Python are told is what Rust finds.

use std::ffi::OsStr;
use std::path::Path;

use serde_json::{Value, json};
use sweepd::sweep::{LeastReturns, SweepRef, Zone};

use super::folder;
use super::library::program;
use super::python::{Talk, check};
use super::sweeps::SOURCES;

/// Zones all around, near and far, low and high; and one that is empty.
fn zones() -> Vec<[[f64; 3]; 2]> {
    let mut zones = vec![[[-0.01; 3], [0.01; 3]]];
    for (x, y) in [(-10.0, 0.0), (0.0, 0.0), (0.0, -10.0), (-2.0, -30.0)] {
        for (least_up_m, most_up_m) in [(0.05, 2.0), (-3.0, 0.3)] {
            let most_m = [x + 10.0, y + 10.0, most_up_m];
            zones.push([[x, y, least_up_m], most_m]);
        }
    }
    zones
}

/// What one of the programs is asked.
fn question(ends: &[[f64; 3]; 2], least: LeastReturns) -> String {
    let ends: Vec<String> = ends.iter().flatten().map(f64::to_string).collect();
    let LeastReturns {
        labelled,
        unlabelled,
    } = least;
    format!("{} {labelled} {unlabelled}", ends.join(" "))
}

/// Both programs, that wait for questions about the sweep in a file.
fn programs(file: &Path) -> [(&'static str, Talk); 2] {
    let args = [OsStr::new("obstacle"), file.as_os_str()];
    [
        ("C", Talk::start(program().as_os_str(), &args)),
        ("Python", check(&args)),
    ]
}

#[test]
#[cfg_attr(
    any(without_python, without_compilers),
    ignore = "no SWEEPD_PYTHON, or no compilers"
)]
fn c_and_python_find_the_obstacles_that_rust_finds() {
    let file = folder("obstacle").join("sweep");
    let (mut all, mut labels) = ([0; 2], [0; 2]);
    for source in SOURCES {
        let sweeps = source.sweeps();
        let bytes: &[u8] = sweeps[1].as_ref();
        std::fs::write(&file, bytes).unwrap();
        let view = SweepRef::open(bytes).unwrap();
        let mut programs = programs(&file);
        for zone in zones() {
            for (labelled, unlabelled) in [(3, 4), (1, 16), (1000, 1)] {
                let least = LeastReturns {
                    labelled,
                    unlabelled,
                };
                let box_of = Zone::new(zone[0], zone[1]).unwrap();
                let found = view.obstacle(&box_of, least);
                all[usize::from(found.is_some())] += 1;
                if let Some(found) = found {
                    labels[usize::from(found.label > 0)] += 1;
                }
                for (language, program) in &mut programs {
                    let said: Value = program.ask(&question(&zone, least));
                    let what = format!("{language}, {source:?}, {zone:?}: {said}, not {found:?}");
                    assert_eq!(said["found"], u32::from(found.is_some()), "{what}");
                    if let Some(found) = found {
                        let counts = (&said["returns"], &said["label"]);
                        assert_eq!(
                            counts,
                            (&json!(found.returns), &json!(found.label)),
                            "{what}"
                        );
                        let said_m = said["distance_m"].as_f64().unwrap();
                        assert!((said_m - found.distance_m).abs() < 1e-9, "{what}");
                    }
                }
            }
        }
        // What is wrong with a zone is said.
        for ends in ["0 0 0 1 -1 1", "nan 0 0 1 1 1"] {
            for (language, program) in &mut programs {
                let said = program.ask(&format!("{ends} 3 4"));
                let error = said["error"].as_str().unwrap_or_default();
                assert!(error.contains("is no box"), "{language}: {said}");
            }
        }
        for (_, mut program) in programs {
            assert!(program.end().success());
        }
    }
    assert!(all[0] > 5 && all[1] > 5, "{all:?}");
    assert!(labels[0] > 5 && labels[1] > 5, "{labels:?}");
}
