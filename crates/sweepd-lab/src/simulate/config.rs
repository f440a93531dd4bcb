//! A sensor as it is configured: model, unit, mode, speed, place, and what it is connected to.

use std::borrow::Cow;
use std::f64::consts::TAU;
use std::net::Ipv4Addr;

use super::gps::{self, Clock, ClockStep};
use super::head::{Encoder, FieldOfView, Motor, Pose};
use super::optics::Optics;
use super::schedule::Schedule;
use super::shape::{Vec3, floor};
use super::{status, street, unit};
use sweepd_core::sensor::model::Spec;
use sweepd_core::sensor::{Calibration, Model};
use sweepd_core::wire::data::ReturnMode;

/// A sensor and what it is connected to.
#[derive(Clone, Debug)]
pub struct EmitterConfig {
    /// The model.
    pub model: Model,
    /// Its timing: one of [`Model::specs`].
    pub spec: &'static Spec,
    /// Which returns it reports.
    pub return_mode: ReturnMode,
    /// The beams of this unit; `None` for those of the model or, of an HDL-64E, for those of a unit
    /// that was made up, [`unit::unit`].
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
    /// Data packets to send: fewer where the field of view is limited, which leaves out a part of
    /// the time that this many take.
    pub packets: u64,
    /// Where it stands.
    pub pose: Pose,
    /// How it reports where it points.
    pub encoder: Encoder,
    /// How well it sees.
    pub optics: Optics,
    /// What its clock follows.
    pub clock: Clock,
    /// When its clock is set to another time.
    pub clock_step: Option<ClockStep>,
    /// UTC of the first shot, nanoseconds since 1970.
    pub start_utc_ns: i64,
    /// How far the receiving host's clock is ahead of UTC, nanoseconds.
    pub host_ahead_ns: i64,
    /// Data packets for each position packet; real sensors have been seen with 5 and with 14. An
    /// HDL-64E sends none.
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
            pose: Pose {
                origin: Vec3::new(street::LANE_M, 0.0, 1.9),
                heading_rad: 0.0,
            },
            encoder: Encoder {
                start_deg: 0.0,
                jitter_deg: 0.02,
                sends_36000: true,
            },
            optics: Optics::of(model),
            clock: Clock::Free { hour_ns: 0 },
            clock_step: None,
            // 2026-05-04 10:00:00 UTC.
            start_utc_ns: 1_777_888_800_000_000_000,
            host_ahead_ns: 0,
            data_per_position: 14,
            address: gps::address(model),
            seed: 1,
        }
        .turns(1.0)
    }

    /// The same for as many packets as these turns take.
    pub fn turns(mut self, turns: f64) -> Self {
        let packet_s = f64::from(self.spec.packet_period_ns(self.return_mode)) * 1e-9;
        self.packets = (turns * 60.0 / self.rpm / packet_s).ceil() as u64;
        self
    }

    /// The same for as many packets as begin within these seconds, with the mode switch after so
    /// many if there is one.
    pub fn seconds(mut self, seconds: f64, mode_switch: Option<f64>) -> Self {
        let packets = |mode, seconds: f64| {
            let packet_s = f64::from(self.spec.packet_period_ns(mode)) * 1e-9;
            ((seconds / packet_s).ceil() as u64, packet_s)
        };
        let (all, packet_s) = packets(self.return_mode, seconds);
        self.mode_switch = mode_switch
            .map(|at| packets(self.return_mode, at).0)
            .filter(|&at| at < all);
        self.packets = match self.mode_switch {
            Some(at) => {
                at + packets(other_mode(self.return_mode), seconds - at as f64 * packet_s).0
            }
            None => all,
        };
        self
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
        let periods_ns =
            |mode, count: u64| count as i64 * i64::from(self.spec.packet_period_ns(mode));
        let before = self.mode_switch.map_or(ordinal, |at| ordinal.min(at));
        periods_ns(self.return_mode, before)
            + periods_ns(other_mode(self.return_mode), ordinal - before)
    }

    /// The sensor clock as packets carry it, so long after the first shot of all.
    pub(super) fn stamp_us(&self, elapsed_ns: i64) -> u32 {
        let step = self.clock_step.filter(|step| elapsed_ns >= step.at_ns);
        self.clock.stamp_us(
            self.start_utc_ns,
            elapsed_ns,
            step.map_or(0, |step| step.by_ns),
        )
    }

    /// Where the head points, radians from 0 to a whole turn.
    pub(super) fn azimuth_rad(&self, time_ns: i64) -> f64 {
        let turns =
            self.encoder.start_deg / 360.0 + self.rpm / 60.0 * self.motor.steady_ns(time_ns) * 1e-9;
        (turns - floor(turns)) * TAU
    }

    /// Data packets that it really sends.
    pub fn sent_packets(&self) -> u64 {
        if self.fov.is_none() {
            return self.packets;
        }
        let mut schedule = Schedule::default();
        std::iter::from_fn(|| schedule.next(self)).count() as u64
    }

    /// The beams that it has.
    pub fn beams(&self) -> Cow<'_, Calibration> {
        let own = self
            .calibration
            .as_ref()
            .or_else(|| self.model.calibration());
        own.map_or_else(|| Cow::Owned(unit::unit(self.seed)), Cow::Borrowed)
    }

    /// Whether there can be such a sensor.
    ///
    /// # Errors
    /// A sentence: what speaks against it.
    pub fn check(&self) -> Result<(), String> {
        let beams = self.beams();
        let (found, expected) = (beams.beams().len(), self.spec.channels);
        if found != expected {
            return Err(format!(
                "a calibration of {found} beams, the {} has {expected}",
                self.model
            ));
        }
        if self.model == Model::Hdl64eS2
            && (self.return_mode == ReturnMode::Dual || self.mode_switch.is_some())
        {
            return Err(format!(
                "an {} reports one return; an {} reports two",
                self.model,
                Model::Hdl64eS3
            ));
        }
        if self.model.is_hdl64e() {
            status::dump(self).map(drop)
        } else {
            Ok(())
        }
    }
}

/// What a sensor is switched to from a mode.
fn other_mode(mode: ReturnMode) -> ReturnMode {
    match mode {
        ReturnMode::Dual => ReturnMode::Strongest,
        ReturnMode::Strongest | ReturnMode::Last => ReturnMode::Dual,
    }
}
