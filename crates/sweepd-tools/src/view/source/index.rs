//! The time line of a capture: how many sweeps each sensor has, and where something is wrong with
//! them. Made once in the background, by decoding all of it.

use std::collections::HashMap;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::{Duration, Instant};

use tokio::sync::watch;

use super::reader::{Reader, SourceConfig, Step};
use crate::view::channels::{Description, Mark, describe};
use sweepd::cli::complain;
use sweepd::text::count_of;
use sweepd_core::sweep::layout::flags;
use sweepd_core::sweep::{Header, SweepRef};

/// Interval at which browsers hear how far it is.
const TELL_EVERY: Duration = Duration::from_millis(300);
/// Most marks of a sensor: more can neither be seen nor sent to a page.
const MARKS: usize = 1000;

/// What is said of a capture in which no head turns once.
pub(super) const NO_TURN: &str =
    "there is no whole turn in it; `sweepd replay --partial` gives the part that is there";

/// What was found of a sensor.
#[derive(Default)]
struct Found {
    sweeps: u64,
    marks: Vec<Mark>,
    /// Model of the sweep before.
    model: u32,
}

/// Makes the index until `is_over`, and describes the sensor that is chosen; when it is complete,
/// follows the choice.
pub(super) fn make(
    source_config: &SourceConfig,
    chosen: &AtomicUsize,
    to: &watch::Sender<Description>,
    is_over: impl Fn() -> bool,
) {
    // The player says why it cannot be opened.
    let Ok(mut reader) = Reader::open(source_config) else {
        return;
    };
    let mut found: HashMap<usize, Found> = HashMap::new();
    let mut told = Instant::now();
    let mut is_complete = false;
    while !is_over() {
        if !is_complete {
            match reader.step() {
                Step::Sweep(decoded) => {
                    if let Ok(sweep) = SweepRef::open(decoded.buffer.as_ref()) {
                        found
                            .entry(decoded.sensor)
                            .or_default()
                            .add(decoded.index, sweep.header);
                    }
                }
                Step::More => {}
                Step::End => {
                    is_complete = true;
                    reader.warn_of_times();
                    if found.is_empty() && reader.sensors().next().is_some() {
                        complain("warning", NO_TURN);
                    }
                }
            }
        }
        if is_complete {
            std::thread::sleep(TELL_EVERY / 3);
        } else if told.elapsed() < TELL_EVERY {
            continue;
        }
        told = Instant::now();
        let sensors: Vec<String> = reader.sensors().map(str::to_owned).collect();
        let chosen = chosen.load(Ordering::Relaxed);
        let of_chosen = found.get(&chosen);
        describe(to, |now| {
            now.chosen = sensors.get(chosen).cloned();
            now.sensors = sensors;
            if let Some(found) = of_chosen {
                now.sweeps = Some(found.sweeps);
                now.marks.clone_from(&found.marks);
            }
        });
    }
}

impl Found {
    fn add(&mut self, index: u64, header: &Header) {
        self.sweeps = index + 1;
        let model = std::mem::replace(&mut self.model, header.model);
        let (what, text) = if model != 0 && model != header.model {
            ("restart", "another sensor".to_owned())
        } else if header.lost_packets > 0 {
            (
                "loss",
                format!("{} lost", count_of(header.lost_packets.into(), "packet")),
            )
        } else if header.missing_columns > 0 {
            (
                "gap",
                format!(
                    "{} missing",
                    count_of(header.missing_columns.into(), "column")
                ),
            )
        } else if header.has(flags::STOPPED) {
            ("stop", "the head stands still".to_owned())
        } else {
            return;
        };
        let (what, text) = match self.marks.len() {
            ..MARKS => (what, text),
            MARKS => (
                "stop",
                format!("more than {MARKS} faults: none is marked from here on"),
            ),
            _ => return,
        };
        self.marks.push(Mark {
            sweep: index,
            what,
            text,
        });
    }
}
