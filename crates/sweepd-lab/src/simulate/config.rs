//! Configuration of a sensor: model, unit, mode, speed, pose, and connections.

use std::borrow::Cow;
use std::f64::consts::TAU;
use std::net::Ipv4Addr;

use super::clock::{Clock, ClockStep, Reception};
use super::damage::EyeFault;
use super::gps::ReceiverFault;
use super::head::{Encoder, FieldOfView, Motion, Motor, Pose};
use super::optics::Optics;
use super::shape::{Vec3, floor};
use super::{street, unit};
use sweepd_core::sensor::model::Spec;
use sweepd_core::sensor::{Calibration, Model, ModelExt};
use sweepd_core::wire::data::ReturnMode;

/// How long a restart takes, nanoseconds.
const STARTING_NS: i64 = 3_000_000_000;

/// A sensor and what it is connected to.
#[derive(Clone, Debug)]
pub struct EmitterConfig {
    /// The model.
    pub model: Model,
    /// Its timing: one of [`Model::specs`].
    pub spec: &'static Spec,
    /// Which returns it reports.
    pub return_mode: ReturnMode,
    /// The beams of this unit; `None` for those of the model or, for an HDL-64E, of the generated
    /// [`unit::unit`].
    pub calibration: Option<Calibration>,
    /// Turns a minute.
    pub rpm: f64,
    /// When the head does not turn at that speed.
    pub motor: Motor,
    /// The sector that it measures; `None` for the whole turn.
    pub fov: Option<FieldOfView>,
    /// From this data packet on it reports the strongest return instead of both, or both instead of
    /// one.
    pub mode_switch: Option<u64>,
    /// Duration in data packets of a whole field of view; with a limited one, fewer are sent in
    /// that time.
    pub packets: u64,
    /// Where it stands at its first shot.
    pub pose: Pose,
    /// How it goes on from there.
    pub motion: Motion,
    /// How it reports where it points.
    pub encoder: Encoder,
    /// How well it sees.
    pub optics: Optics,
    /// What is wrong with its eye.
    pub eye: Option<EyeFault>,
    /// What its clock follows.
    pub clock: Clock,
    /// A step of its clock.
    pub clock_step: Option<ClockStep>,
    /// For how long it works before it restarts, again and again, nanoseconds.
    pub restart_ns: Option<i64>,
    /// What is wrong with the time of its receiver, and when.
    pub receiver_fault: Option<(ReceiverFault, Reception)>,
    /// UTC of the first shot, nanoseconds since 1970.
    pub start_utc_ns: i64,
    /// How far the receiving host's clock is ahead of UTC, nanoseconds.
    pub host_ahead_ns: i64,
    /// Data packets for each position packet; 5 and 14 were observed on real sensors. An HDL-64E
    /// sends none.
    pub data_per_position: u64,
    /// Its address.
    pub address: Ipv4Addr,
    /// Seed of all chance.
    pub seed: u64,
}

impl EmitterConfig {
    /// A sensor as it leaves the factory, 1.9 m above the right-hand lane, without GPS, for one
    /// turn at 600 rpm.
    pub fn new(model: Model, return_mode: ReturnMode) -> Self {
        Self {
            model,
            spec: model.spec(),
            return_mode,
            calibration: None,
            rpm: 600.0,
            motor: Motor::default(),
            fov: None,
            mode_switch: None,
            packets: 0,
            pose: Pose::upright(Vec3::new(street::LANE_M, 0.0, 1.9)),
            motion: Motion::default(),
            encoder: Encoder {
                start_deg: 0.0,
                jitter_deg: 0.02,
                sends_36000: true,
            },
            optics: Optics::of(model),
            eye: None,
            clock: Clock::Free { hour_ns: 0 },
            clock_step: None,
            restart_ns: None,
            receiver_fault: None,
            // 2026-05-04 10:00:00 UTC.
            start_utc_ns: 1_777_888_800_000_000_000,
            host_ahead_ns: 0,
            data_per_position: 14,
            address: address(model),
            seed: 1,
        }
        .turns(1.0)
    }

    /// The same for as many packets as these turns take.
    pub fn turns(mut self, turns: f64) -> Self {
        self.packets = self.packets_within(self.return_mode, turns * 60.0 / self.rpm);
        self
    }

    /// The same for as many packets as begin within these seconds, with the mode switch after
    /// `mode_switch` seconds if there is one.
    pub fn seconds(mut self, seconds: f64, mode_switch: Option<f64>) -> Self {
        let first = self.return_mode;
        let all = self.packets_within(first, seconds);
        self.mode_switch = mode_switch
            .map(|at| self.packets_within(first, at))
            .filter(|&at| at < all);
        self.packets = match self.mode_switch {
            Some(at) => {
                let rest_s = seconds - at as f64 * self.packet_s(first);
                at + self.packets_within(other_mode(first), rest_s)
            }
            None => all,
        };
        self
    }

    /// From one data packet to the next, seconds.
    fn packet_s(&self, mode: ReturnMode) -> f64 {
        f64::from(self.spec.packet_period_ns(mode)) * 1e-9
    }

    /// Data packets that begin within these seconds.
    fn packets_within(&self, mode: ReturnMode, seconds: f64) -> u64 {
        (seconds / self.packet_s(mode)).ceil() as u64
    }

    /// What a data packet reports.
    pub fn mode_of(&self, ordinal: u64) -> ReturnMode {
        match self.mode_switch {
            Some(at) if ordinal >= at => other_mode(self.return_mode),
            _ => self.return_mode,
        }
    }

    /// First shot of a packet, nanoseconds after the first of all.
    pub(super) fn first_shot_ns(&self, ordinal: u64) -> i64 {
        let before = self.mode_switch.map_or(ordinal, |at| ordinal.min(at));
        let period_ns = i64::from(self.spec.packet_period_ns(self.return_mode));
        let other_period_ns = i64::from(self.spec.packet_period_ns(other_mode(self.return_mode)));
        before as i64 * period_ns + (ordinal - before) as i64 * other_period_ns
    }

    /// The sensor clock in packets, this long after the first shot of all.
    pub(super) fn stamp_us(&self, elapsed_ns: i64) -> u32 {
        let step = self.clock_step.filter(|step| elapsed_ns >= step.at_ns);
        self.clock.stamp_us(
            self.start_utc_ns,
            self.since_start_ns(elapsed_ns),
            step.map_or(0, |step| step.by_ns),
        )
    }

    /// The same since its newest start.
    fn since_start_ns(&self, elapsed_ns: i64) -> i64 {
        match self.restart_ns {
            Some(works_ns) => elapsed_ns.rem_euclid(works_ns + STARTING_NS),
            None => elapsed_ns,
        }
    }

    /// Whether it restarts, and sends nothing, this long after the first shot of all.
    pub(super) fn is_restarting(&self, elapsed_ns: i64) -> bool {
        (self.restart_ns).is_some_and(|works_ns| self.since_start_ns(elapsed_ns) >= works_ns)
    }

    /// Where it is this long after its first shot, seconds.
    pub fn pose_at(&self, time_s: f64) -> Pose {
        self.motion.pose(&self.pose, time_s)
    }

    /// Where the head points, radians from 0 to a whole turn.
    pub(super) fn azimuth_rad(&self, time_ns: i64) -> f64 {
        let turns =
            self.encoder.start_deg / 360.0 + self.rpm / 60.0 * self.motor.steady_ns(time_ns) * 1e-9;
        (turns - floor(turns)) * TAU
    }

    /// The beams that it has.
    pub fn beams(&self) -> Cow<'_, Calibration> {
        let own = self
            .calibration
            .as_ref()
            .or_else(|| self.model.calibration());
        own.map_or_else(|| Cow::Owned(unit::unit(self.seed)), Cow::Borrowed)
    }
}

/// The factory address of a model; of the HDL-64E, its manuals' section on Ethernet.
pub fn address(model: Model) -> Ipv4Addr {
    match model {
        Model::Hdl64eS2 | Model::Hdl64eS3 => Ipv4Addr::new(192, 168, 3, 43),
        Model::Hdl32e => Ipv4Addr::new(192, 168, 1, 202),
        Model::Vlp16 | Model::PuckLite | Model::PuckHiRes | Model::Vlp32c | Model::Vls128 => {
            Ipv4Addr::new(192, 168, 1, 201)
        }
    }
}

/// Destination of a sensor's packets: broadcast, for an HDL-64E only within its own network.
pub fn destination(model: Model, address: Ipv4Addr) -> Ipv4Addr {
    let [a, b, c, _] = address.octets();
    if model.is_hdl64e() {
        Ipv4Addr::new(a, b, c, 255)
    } else {
        Ipv4Addr::BROADCAST
    }
}

/// What a sensor is switched to from a mode.
fn other_mode(mode: ReturnMode) -> ReturnMode {
    match mode {
        ReturnMode::Dual => ReturnMode::Strongest,
        ReturnMode::Strongest | ReturnMode::Last => ReturnMode::Dual,
    }
}
