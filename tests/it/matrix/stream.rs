//! What is sent: clean streams with truth, and the same with faults.

use sweepd::sensor::Model::{
    self, Hdl32e, Hdl64eS2, Hdl64eS3, PuckHiRes, PuckLite, Vlp16, Vlp32c, Vls128,
};
use sweepd::wire::data::ReturnMode::{self, Dual, Strongest};
use sweepd_lab::simulate::{
    Emitter, EmitterConfig, Faults, FieldOfView, Motor, Rates, Scene, SimulatedDatagram,
    SpeedChange, deliver, fixtures,
};

pub const MS: i64 = 1_000_000;
/// How long a stream is, turns at 600 a minute; when faults begin, and the latest time at which
/// they end.
pub const TURNS: f64 = 10.0;
pub const TURN_NS: i64 = 100 * MS;
pub const FAULT_NS: [i64; 2] = [260 * MS, 640 * MS];

/// A model and what it reports.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Kind {
    pub model: Model,
    pub mode: ReturnMode,
}

impl From<(Model, ReturnMode)> for Kind {
    fn from((model, mode): (Model, ReturnMode)) -> Self {
        Self { model, mode }
    }
}

const fn kind(model: Model, mode: ReturnMode) -> Kind {
    Kind { model, mode }
}

/// All that there are.
pub const KINDS: [Kind; 15] = [
    kind(Vlp16, Strongest),
    kind(Vlp16, Dual),
    kind(PuckLite, Strongest),
    kind(PuckLite, Dual),
    kind(PuckHiRes, Strongest),
    kind(PuckHiRes, Dual),
    kind(Hdl32e, Strongest),
    kind(Hdl32e, Dual),
    kind(Hdl64eS2, Strongest),
    kind(Hdl64eS3, Strongest),
    kind(Hdl64eS3, Dual),
    kind(Vlp32c, Strongest),
    kind(Vlp32c, Dual),
    kind(Vls128, Strongest),
    kind(Vls128, Dual),
];

/// A sensor's clean stream, from which most others are made.
pub struct Stock {
    pub kind: Kind,
    pub config: EmitterConfig,
    scene: Scene,
    clean: Vec<SimulatedDatagram>,
}

/// A stream to be checked, and what is known of it.
pub struct Made {
    /// The datagrams as they arrive.
    pub sent: Vec<SimulatedDatagram>,
    /// The sensor, or the first of two.
    pub config: EmitterConfig,
    /// How much was injected of what the row is about.
    pub injected: u64,
    /// What happened on the way.
    pub faults: Faults,
    /// When it began and when it was over, nanoseconds after the first shot.
    pub fault_ns: [i64; 2],
    /// A turn after it, nanoseconds.
    pub turn_ns: i64,
    /// What must hold beside what always must.
    pub promise: Promise,
}

/// What a row promises.
#[derive(Clone, Debug)]
pub struct Promise {
    /// What the counters say.
    pub counts: Told,
    /// Flags of which each must be seen while the fault lasts, and that nothing has afterwards.
    pub flags: u32,
    /// Ranges are off by less than this beyond rounding, millimetres.
    pub range_mm: f64,
    /// Azimuths are off by at most this, degrees.
    pub azimuth_deg: f64,
    /// Times are off by less than this beyond random rests, nanoseconds; `None` where the sensor's clock is set.
    pub time_ns: Option<i64>,
    /// Sweeps are whole again at the latest this many revolutions after the fault.
    pub recovery_turns: f64,
    /// Packets after the fault that may be refused until it is understood.
    pub given_up: u64,
    /// Packets that were never sent and may be taken for lost: before a field of view is known to
    /// be limited, silence that lasts a whole number of packets is nothing else.
    pub silent: u64,
    /// The calibration comes with the packets.
    pub learns: bool,
    /// It is known to be whole: without a checksum it may be wrong until the next one contradicts,
    /// which a notice tells.
    pub has_checksum: bool,
}

/// What the counters must say.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Told {
    /// Exactly what was injected on the way, each fault in its counter, and nothing else.
    Exactly,
    /// Of the packets that were damaged, those that were refused are counted as such and, but for
    /// those at the ends, as lost; nothing else.
    Refused,
    /// The stream was interrupted once: nothing is lost, and few packets are refused.
    Interrupted,
    /// Two sensors at once: every packet is decoded or counted.
    Mixed,
}

impl Promise {
    pub const NONE: Self = Self {
        counts: Told::Exactly,
        flags: 0,
        range_mm: 0.0,
        azimuth_deg: 0.035,
        time_ns: Some(1_000),
        recovery_turns: 1.06,
        given_up: 0,
        silent: 0,
        learns: false,
        has_checksum: true,
    };
}

impl Stock {
    pub fn new(kind: Kind) -> Self {
        let scene = fixtures::scene();
        let config = config(kind);
        let clean = Emitter::new(config.clone(), &scene).collect();
        Self {
            kind,
            config,
            scene,
            clean,
        }
    }

    /// The stream of a sensor that is otherwise set.
    pub fn other(
        &self,
        set: impl FnOnce(&mut EmitterConfig),
    ) -> (EmitterConfig, Vec<SimulatedDatagram>) {
        let mut config = config(self.kind);
        set(&mut config);
        let sent = Emitter::new(config.clone(), &self.scene).collect();
        (config, sent)
    }

    /// A sensor that does something else for a while.
    pub fn set(
        &self,
        fault_ns: [i64; 2],
        promise: Promise,
        set: impl FnOnce(&mut EmitterConfig),
    ) -> Made {
        let (config, sent) = self.other(set);
        let turn_ns =
            (60e9 / config.rpm / config.motor.change.map_or(1.0, |change| change.to.abs())) as i64;
        Made {
            sent,
            config,
            injected: 1,
            faults: Faults::default(),
            fault_ns,
            turn_ns,
            promise,
        }
    }

    /// A motor that does something else.
    pub fn motor(&self, fault_ns: [i64; 2], promise: Promise, motor: Motor) -> Made {
        self.set(fault_ns, promise, |config| config.motor = motor)
    }

    /// A change of speed while faults last.
    pub fn change(&self, promise: Promise, to: f64) -> Made {
        let [from_ns, to_ns] = FAULT_NS;
        let change = Some(SpeedChange {
            from_ns,
            lasts_ns: to_ns - from_ns,
            to,
        });
        self.motor(
            FAULT_NS,
            promise,
            Motor {
                change,
                ..Motor::default()
            },
        )
    }

    /// A field of view that is limited while faults last.
    pub fn fov(&self, promise: Promise, from_deg: f64, to_deg: f64) -> Made {
        // At most a turn when it is set, and one when it is lifted.
        let promise = Promise {
            silent: (2 * TURN_NS / self.packet_ns()) as u64,
            ..promise
        };
        self.set(FAULT_NS, promise, |config| {
            config.fov = Some(FieldOfView {
                from_deg,
                to_deg,
                set_ns: FAULT_NS,
            })
        })
    }

    /// Random faults while faults last.
    pub fn network(&self, rates: Rates, promise: Promise) -> Made {
        let mut faults = rates.plan(7, self.config.packets);
        let inside = |ordinal: u64| {
            let at_ns = ordinal as i64 * self.packet_ns();
            at_ns >= FAULT_NS[0] && at_ns < FAULT_NS[1]
        };
        faults
            .lost
            .retain(|range| inside(*range.start()) && inside(*range.end()));
        faults.duplicated.retain(|&one| inside(one));
        faults.swapped.retain(|&one| inside(one));
        faults.corrupted.retain(|&(one, _)| inside(one));
        faults.strays.retain(|&(one, _)| inside(one));
        self.faulty(faults, promise)
    }

    /// These faults.
    pub fn faulty(&self, faults: Faults, promise: Promise) -> Made {
        let struck = [
            faults.duplicated.len(),
            faults.swapped.len(),
            faults.corrupted.len(),
            faults.strays.len(),
        ];
        let ends = [
            faults.lost.iter().map(|range| range.end()).max(),
            faults.duplicated.iter().max(),
            faults.swapped.iter().max(),
            faults.corrupted.iter().map(|(one, _)| one).max(),
            faults.strays.iter().map(|(one, _)| one).max(),
        ];
        let end = ends
            .into_iter()
            .flatten()
            .max()
            .map_or(0, |&end| end + 1 + faults.places);
        let injected = faults.lost_packets() + struck.iter().sum::<usize>() as u64;
        let sent = deliver(self.clean.iter().cloned(), faults.clone()).collect();
        let fault_ns = [FAULT_NS[0], end as i64 * self.packet_ns()];
        Made {
            sent,
            config: self.config.clone(),
            injected,
            faults,
            fault_ns,
            turn_ns: TURN_NS,
            promise,
        }
    }

    /// Packets from a time on that so long a time takes, lost.
    pub fn lost(&self, lasts_ns: i64, promise: Promise) -> Made {
        let first = (FAULT_NS[0] / self.packet_ns()) as u64;
        let count = (lasts_ns / self.packet_ns()) as u64 + 1;
        self.faulty(
            Faults {
                lost: vec![first..=first + count - 1],
                ..Faults::default()
            },
            promise,
        )
    }

    /// Another sensor in its place from a time on, or beside it until then.
    pub fn exchanged(
        &self,
        by: (EmitterConfig, Vec<SimulatedDatagram>),
        beside: bool,
        promise: Promise,
    ) -> Made {
        let at_ns = FAULT_NS[1];
        let (other, others) = by;
        let since = |one: &SimulatedDatagram| one.arrival_ns - self.config.start_utc_ns;
        let first = self.clean.iter().filter(|one| beside || since(one) < at_ns);
        let is_there = |since_ns: i64| {
            if beside {
                (FAULT_NS[0]..at_ns).contains(&since_ns)
            } else {
                since_ns >= at_ns
            }
        };
        let second = others.into_iter().filter(|one| is_there(since(one)));
        let mut sent: Vec<_> = first.cloned().chain(second).collect();
        sent.sort_by_key(|one| one.arrival_ns);
        for one in &mut sent {
            one.source.set_ip(self.config.address);
        }
        let injected = if beside { other.packets } else { 1 };
        let config = self.config.clone();
        let fault_ns = [if beside { FAULT_NS[0] } else { at_ns }, at_ns];
        Made {
            sent,
            config,
            injected,
            faults: Faults::default(),
            fault_ns,
            turn_ns: TURN_NS,
            promise,
        }
    }

    fn packet_ns(&self) -> i64 {
        i64::from(self.config.spec.packet_period_ns(self.kind.mode))
    }
}

/// The sensor of a kind: 0.02 degrees of jitter in its encoder, and ranges that only rounding
/// changes.
fn config(kind: Kind) -> EmitterConfig {
    let mut config = EmitterConfig::new(kind.model, kind.mode);
    config.optics.noise_m = 0.0;
    config.encoder.start_deg = 300.0;
    config.clock = sweepd_lab::simulate::gps::Clock::Free {
        hour_ns: 1_000_000 * MS,
    };
    config.turns(TURNS)
}
