//! The rows: which faults there are, at which rates, and what each promises.

use sweepd::sensor::Model::{self, Hdl32e, Hdl64eS2, Vlp16, Vls128};
use sweepd::sweep::layout::flags::{BLANKED, RATE_UNSTABLE, REVERSED, STOPPED};
use sweepd::wire::data::ReturnMode::{Dual, Strongest};
use sweepd_lab::simulate::gps::{Clock, Reception};
use sweepd_lab::simulate::{ClockStep, EmitterConfig, Motor, PacketPart, Rates};

use super::stream::{FAULT_NS, Kind, MS, Made, Promise, Stock, Told};

/// A row for each kind of sensor that it fits.
pub struct Case {
    pub fault: &'static str,
    pub rate: String,
    /// It is in the short form.
    pub is_short: bool,
    pub fits: fn(Kind) -> bool,
    pub make: Box<dyn Fn(&Stock) -> Made + Sync>,
}

/// Collects cases: of each fault the first is in the short form.
struct Cases(Vec<Case>);

impl Cases {
    fn add(
        &mut self,
        fault: &'static str,
        rate: impl ToString,
        make: impl Fn(&Stock) -> Made + Sync + 'static,
    ) {
        self.add_for(|_| true, fault, rate, make);
    }

    fn add_for(
        &mut self,
        fits: fn(Kind) -> bool,
        fault: &'static str,
        rate: impl ToString,
        make: impl Fn(&Stock) -> Made + Sync + 'static,
    ) {
        let is_short = self.0.last().is_none_or(|last| last.fault != fault);
        self.0.push(Case {
            fault,
            rate: rate.to_string(),
            is_short,
            fits,
            make: Box::new(make),
        });
    }
}

const NONE: Promise = Promise::NONE;
/// The sensor's clock is set: the sweep is interrupted, and what links it to other clocks begins
/// again.
const SET: Promise = Promise {
    counts: Told::Interrupted,
    time_ns: None,
    given_up: 15,
    ..NONE
};
/// The head is braked or driven: within a block, its azimuth is that of a mean speed.
/// The two-point correction of an HDL-64E depends on the azimuth.
const DRIVEN: Promise = Promise {
    azimuth_deg: 0.06,
    range_mm: 0.4,
    ..NONE
};

/// All rows.
pub fn cases() -> Vec<Case> {
    let mut all = Cases(Vec::new());
    network(&mut all);
    damaged(&mut all);
    clocks(&mut all);
    motor(&mut all);
    sensors(&mut all);
    all.0
}

fn network(all: &mut Cases) {
    for rpm in [600.0, 300.0, 1200.0] {
        all.add("none", format!("{rpm} rpm"), move |stock| {
            let made = stock.set([0, 0], NONE, |config| {
                (config.rpm, config.encoder.start_deg) = (rpm, 10.0)
            });
            Made {
                injected: 0,
                ..made
            }
        });
    }
    for loss in [0.01, 0.001, 0.1, 0.3] {
        all.add("loss", percent(loss), move |stock| {
            stock.network(
                Rates {
                    loss,
                    ..Rates::default()
                },
                NONE,
            )
        });
    }
    for (burst_loss, burst_len) in [(0.01, 10), (0.002, 40)] {
        all.add(
            "loss in bursts",
            format!("{} x {burst_len}", percent(burst_loss)),
            move |stock| {
                stock.network(
                    Rates {
                        burst_loss,
                        burst_len,
                        ..Rates::default()
                    },
                    NONE,
                )
            },
        );
    }
    for (name, ms) in [("1 turn", 101), ("2.3 turns", 230)] {
        all.add("loss of whole turns", name, move |stock| {
            stock.lost(ms * MS, NONE)
        });
    }
    all.add("loss of half a second", "0.5 s", |stock| {
        stock.lost(500 * MS, NONE)
    });
    for duplicate in [0.05, 0.002, 1.0] {
        all.add("duplicates", percent(duplicate), move |stock| {
            stock.network(
                Rates {
                    duplicate,
                    ..Rates::default()
                },
                NONE,
            )
        });
    }
    for (reorder, places) in [(0.02, 1), (0.2, 1), (0.02, 2), (0.02, 3), (0.02, 4)] {
        all.add(
            "reordering",
            format!("{} by {places}", percent(reorder)),
            move |stock| {
                stock.network(
                    Rates {
                        reorder,
                        places,
                        ..Rates::default()
                    },
                    NONE,
                )
            },
        );
    }
    for share in [0.01, 0.05] {
        all.add("all of these", percent(share), move |stock| {
            let rates = Rates {
                loss: share,
                duplicate: share,
                reorder: share,
                stray: share,
                ..Rates::default()
            };
            stock.network(rates, NONE)
        });
    }
    for stray in [0.02, 0.5] {
        all.add("tiny and jumbo datagrams", percent(stray), move |stock| {
            stock.network(
                Rates {
                    stray,
                    ..Rates::default()
                },
                NONE,
            )
        });
    }
}

fn damaged(all: &mut Cases) {
    for (fault, part) in [
        ("damaged length", PacketPart::Length),
        ("damaged flag", PacketPart::Flag),
        ("damaged azimuth", PacketPart::Azimuth),
        ("damaged stamp", PacketPart::Stamp),
        ("damaged mode or product", PacketPart::Factory),
        ("damaged distance", PacketPart::Distance),
        ("damaged reflectivity", PacketPart::Reflectivity),
        ("damaged anywhere", PacketPart::Any),
    ] {
        // Of two in a row that agree with each other nobody can tell that they are wrong: stamps
        // are struck less often.
        let rates = if matches!(part, PacketPart::Stamp | PacketPart::Any) {
            [0.02, 0.005]
        } else {
            [0.1, 0.01]
        };
        for corrupt in rates {
            let promise = Promise {
                counts: Told::Refused,
                ..NONE
            };
            let promise = match part {
                // So near to the truth that the encoder's noise hides it.
                PacketPart::Azimuth | PacketPart::Any => Promise {
                    azimuth_deg: 0.36,
                    time_ns: Some(100_000),
                    ..promise
                },
                // So near to it that the sensor's clock may be that far off.
                PacketPart::Stamp => Promise {
                    time_ns: Some(100_000),
                    ..promise
                },
                _ => promise,
            };
            all.add(fault, percent(corrupt), move |stock| {
                stock.network(
                    Rates {
                        corrupt,
                        part,
                        ..Rates::default()
                    },
                    promise.clone(),
                )
            });
        }
    }
    for corrupt in [0.0005, 0.01] {
        all.add_for(
            |kind| kind.model.is_hdl64e(),
            "damaged status stream",
            percent(corrupt),
            move |stock| status(stock, corrupt),
        );
    }
}

/// The calibration comes with the packets, and some of those that bring it are damaged.
fn status(stock: &Stock, corrupt: f64) -> Made {
    let (config, sent) = stock.other(|config| *config = config.clone().seconds(2.6, None));
    let mut faults = Rates {
        corrupt,
        part: PacketPart::Factory,
        ..Rates::default()
    }
    .plan(3, 4_000);
    faults.corrupted.retain(|&(one, _)| one > 50);
    let injected = faults.corrupted.len() as u64;
    let sent = sweepd_lab::simulate::deliver(sent.into_iter(), faults.clone()).collect();
    let period_ns = i64::from(config.spec.packet_period_ns(config.return_mode));
    // At the latest the next dump is whole.
    let fault_ns = [0, 2 * 4_160 * period_ns];
    let has_checksum = stock.kind.model != Hdl64eS2;
    let promise = Promise {
        counts: Told::Mixed,
        learns: true,
        has_checksum,
        ..NONE
    };
    Made {
        sent,
        config,
        injected,
        faults,
        fault_ns,
        turn_ns: 100 * MS,
        promise,
    }
}

fn clocks(all: &mut Cases) {
    for (name, by_ms) in [
        ("+0.3 s", 300_i64),
        ("+2 ms", 2),
        ("+61 s", 61_234),
        ("+600 s", 600_000),
        ("+1799 s", 1_799_000),
    ] {
        all.add("clock jumps ahead", name, move |stock| step(stock, by_ms));
    }
    for (name, by_ms) in [
        ("-1.5 s", -1_500_i64),
        ("-30 ms", -30),
        ("-0.4 s", -400),
        ("-600 s", -600_000),
    ] {
        all.add("clock jumps back", name, move |stock| step(stock, by_ms));
    }
    all.add("top of the hour", "once", |stock| {
        stock.set(FAULT_NS, NONE, |config| {
            config.clock = Clock::Free {
                hour_ns: 3_599_600 * MS,
            }
        })
    });
    // Two seconds after it hears satellites, the clock follows.
    all.add("GPS gained", "once", |stock| {
        received(stock, -1_550 * MS, i64::MAX)
    });
    all.add("GPS lost", "once", |stock| {
        let made = received(stock, i64::MIN, 450 * MS);
        Made {
            promise: NONE,
            ..made
        }
    });
}

fn step(stock: &Stock, by_ms: i64) -> Made {
    let at_ns = 450 * MS;
    stock.set([at_ns; 2], SET, |config| {
        config.clock_step = Some(ClockStep {
            at_ns,
            by_ns: by_ms * MS,
        })
    })
}

fn received(stock: &Stock, from_ns: i64, to_ns: i64) -> Made {
    stock.set([450 * MS; 2], SET, |config| {
        config.clock = Clock::Gps {
            position_deg: (50.1, 8.7),
            reception: Reception { from_ns, to_ns },
        };
        config.start_utc_ns += 1_000_123 * MS;
    })
}

fn motor(all: &mut Cases) {
    for (name, to) in [
        ("600 to 1200 rpm", 2.0),
        ("600 to 300 rpm", 0.5),
        ("600 to 640 rpm", 1.066),
    ] {
        let flags = if to == 1.066 { 0 } else { RATE_UNSTABLE };
        all.add("speed changes", name, move |stock| {
            stock.change(Promise { flags, ..DRIVEN }, to)
        });
    }
    for (name, ms) in [("in 0.3 s", 300), ("in 0.6 s", 600)] {
        all.add("spin-up", name, move |stock| {
            // At rest no speed is known, and one packet may seem to be out of place.
            let flags = RATE_UNSTABLE;
            let promise = Promise {
                counts: Told::Interrupted,
                given_up: 1,
                silent: 1,
                flags,
                ..DRIVEN
            };
            stock.motor(
                [0, ms * MS],
                promise,
                Motor {
                    spin_up_ns: ms * MS,
                    ..Motor::default()
                },
            )
        });
    }
    for (name, ms) in [("0.3 s", 300), ("20 ms", 20)] {
        all.add("stall", name, move |stock| {
            // It stands within no time, and what the packet of that moment says is between.
            let promise = Promise {
                azimuth_deg: 0.8,
                range_mm: 1.9,
                flags: if ms > 100 { STOPPED } else { 0 },
                ..NONE
            };
            let stall_ns = [FAULT_NS[0], FAULT_NS[0] + ms * MS];
            stock.motor(
                stall_ns,
                promise,
                Motor {
                    stall_ns: Some(stall_ns),
                    ..Motor::default()
                },
            )
        });
    }
    all.add("reversal", "600 to -600 rpm", |stock| {
        stock.change(
            Promise {
                flags: REVERSED,
                ..DRIVEN
            },
            -1.0,
        )
    });
    for (name, from_deg, to_deg) in [
        ("270..90", 270.0, 90.0),
        ("45..145", 45.0, 145.0),
        ("300..60", 300.0, 60.0),
        ("90..360", 90.0, 360.0),
    ] {
        all.add("field of view set, lifted", name, move |stock| {
            stock.fov(
                Promise {
                    counts: Told::Interrupted,
                    flags: BLANKED,
                    time_ns: None,
                    ..NONE
                },
                from_deg,
                to_deg,
            )
        });
    }
}

fn sensors(all: &mut Cases) {
    let has_two = |kind: Kind| kind.model != Hdl64eS2;
    all.add_for(has_two, "return mode switched", "once", |stock| {
        let at_ns = 450 * MS;
        let promise = Promise {
            counts: Told::Interrupted,
            given_up: 1,
            ..NONE
        };
        stock.set([at_ns; 2], promise, |config| {
            *config = config.clone().seconds(1.0, Some(0.45))
        })
    });
    let anew = Promise {
        counts: Told::Interrupted,
        given_up: 40,
        time_ns: None,
        recovery_turns: 1.15,
        ..NONE
    };
    all.add_for(
        |kind| !kind.model.is_hdl64e(),
        "another model",
        "once",
        move |stock| {
            stock.exchanged(
                stock.other(|config| *config = another(config)),
                false,
                anew.clone(),
            )
        },
    );
    all.add("two sensors swapped", "once", |stock| {
        stock.exchanged(stock.other(|config| *config = sibling(config)), false, SET)
    });
    // Each packet begins a sweep. All of them are kept until the end, and those of a VLS-128 do not
    // fit into memory.
    let fits_memory = |kind: Kind| kind.model != Vls128;
    all.add_for(fits_memory, "two sensors at once", "0.38 s", |stock| {
        // Their speeds are one mean.
        let promise = Promise {
            counts: Told::Mixed,
            azimuth_deg: 0.05,
            ..SET
        };
        stock.exchanged(
            stock.other(|config| *config = sibling(config)),
            true,
            promise,
        )
    });
}

/// A sensor of the next model, in its place.
fn another(config: &EmitterConfig) -> EmitterConfig {
    let (model, mode): (Model, _) = if config.model == Hdl32e {
        (Vlp16, Strongest)
    } else {
        (Hdl32e, Dual)
    };
    let mut other = EmitterConfig::new(model, mode);
    (other.optics.noise_m, other.encoder.start_deg) = (0.0, 77.0);
    other.turns(10.0)
}

/// A sensor of the same model, that points elsewhere and was switched on at another time.
fn sibling(config: &EmitterConfig) -> EmitterConfig {
    let clock = Clock::Free {
        hour_ns: 2_345_678 * MS,
    };
    let mut other = EmitterConfig {
        clock,
        seed: config.seed,
        ..config.clone()
    };
    other.encoder.start_deg = 123.0;
    other
}

fn percent(share: f64) -> String {
    format!("{} %", (share * 1e4).round() / 100.0)
}
