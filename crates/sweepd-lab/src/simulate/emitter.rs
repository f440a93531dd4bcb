//! From time to packets: when each beam fires, its direction, and the bytes on the wire.
//!
//! Everything derives from one continuous clock. A shot has a time; the time gives the azimuth of
//! the head, which turns while the beams fire; the direction gives the returns. The wire holds
//! less: the stamp is truncated to microseconds, the azimuth is the rounded one of the first shot
//! in the block, and the range is noisy and in units. The [`PacketTruth`] keeps the exact values.

use std::f64::consts::TAU;
use std::net::SocketAddrV4;

use fastrand::Rng;

use super::beam::{Aim, Laser};
use super::config::{EmitterConfig, destination};
use super::damage::Sight;
use super::gps;
use super::head::Pose;
use super::layout::Layout;
use super::optics::{self, Return, Shot};
use super::scene::{Hit, Scene};
use super::schedule::{Schedule, Times};
use super::shape::Vec3;
use super::status::Status;
use super::truth::{PacketTruth, ReturnTruth, SimulatedDatagram};
use super::view::View;
use sweepd_core::sensor::Calibration;
use sweepd_core::wire::data::{BLOCKS, DataPacket, RECORDS, Record, ReturnMode};
use sweepd_core::wire::hdl64::CYCLE_LEN;
use sweepd_core::wire::{DATA_PORT, POSITION_PORT};

/// Duration of a view, in which moving objects are indexed, nanoseconds.
const VIEW_NS: i64 = 10_000_000;
/// Time by which a view is valid beyond its end, for a packet that begins shortly before it,
/// nanoseconds.
const VIEW_SLACK_NS: i64 = 1_800_000;

/// The datagrams of a sensor, in the order in which they leave it.
pub struct Emitter<'a> {
    config: EmitterConfig,
    lasers: Vec<Laser>,
    /// Whether each of them is in the lower half.
    is_low: Vec<bool>,
    /// The status for bytes 1204 and 1205, if these are not mode and product.
    status: Option<Status>,
    scene: &'a Scene,
    /// The scene around a time, and the number of that time.
    view: (i64, View<'a>),
    schedule: Schedule,
    /// Stamp of the first packet of the status cycle, nanoseconds after the first shot of all.
    cycle_ns: i64,
    position: Option<SimulatedDatagram>,
    /// Arrival of the last datagram, nanoseconds since 1970.
    arrived_ns: i64,
    /// Whether to keep the truth of each return.
    tells: bool,
}

/// A data packet while it is filled.
struct Draft {
    packet: DataPacket,
    truth: Box<PacketTruth>,
    layout: Layout,
    mode: ReturnMode,
    times: Times,
    /// Last distance of each channel in this packet, metres.
    met_m: [f64; MAX_CHANNELS],
}

/// Most beams of a model.
const MAX_CHANNELS: usize = 128;

impl<'a> Emitter<'a> {
    /// A sensor in a scene.
    ///
    /// # Panics
    /// If [`EmitterConfig::check`] fails.
    pub fn new(config: EmitterConfig, scene: &'a Scene) -> Self {
        config.check().expect("a sensor that can be");
        let beams = config.beams();
        let lasers = beams
            .beams()
            .iter()
            .map(|beam| Laser::new(beam, config.spec.distance_unit_m))
            .collect();
        let mut elevations = Vec::new();
        for beam in beams.beams() {
            elevations.push(beam.elevation_rad);
        }
        elevations.sort_by(f64::total_cmp);
        let middle_rad = elevations[elevations.len() / 2];
        let mut is_low = Vec::new();
        for beam in beams.beams() {
            is_low.push(beam.elevation_rad < middle_rad);
        }
        let view = (0, view(scene, &config, 0));
        let status = config
            .model
            .is_hdl64e()
            .then(|| Status::new(&config).expect("checked"));
        Self {
            scene,
            lasers,
            is_low,
            status,
            view,
            schedule: Schedule::default(),
            cycle_ns: 0,
            position: None,
            arrived_ns: i64::MIN,
            tells: true,
            config,
        }
    }

    /// The same with only the packet's number as truth, which is faster.
    pub fn untold(mut self) -> Self {
        self.tells = false;
        self
    }

    fn data_packet(&mut self, times: Times, rng: &mut Rng) -> (DataPacket, Box<PacketTruth>) {
        let spec = self.config.spec;
        let ordinal = times.ordinal;
        let mode = self.config.mode_of(ordinal);
        let stamped_ns = times.stamped_ns(&self.config);
        if ordinal.is_multiple_of(CYCLE_LEN as u64) {
            self.cycle_ns = stamped_ns;
        }
        let (first, second) = match &self.status {
            Some(status) => status.pair(&self.config, ordinal, self.cycle_ns),
            None => (mode.byte(), spec.product.unwrap_or_default()),
        };
        let stamp_us = self.config.stamp_us(stamped_ns);
        let mut draft = Draft {
            packet: DataPacket::new(stamp_us, first, second),
            truth: Box::new(PacketTruth {
                ordinal,
                returns: [[None; RECORDS]; BLOCKS],
            }),
            layout: Layout::new(spec, mode),
            mode,
            times,
            met_m: [self.config.optics.max_range_m; MAX_CHANNELS],
        };
        draft.layout.mark(&mut draft.packet);
        for firing in 0..spec.firings_per_packet(mode) {
            self.look_around(times.firing_ns(firing, &self.config), firing == 0);
            self.fire(firing, &mut draft, rng);
        }
        (draft.packet, draft.truth)
    }

    /// Updates the view to a time: that of a packet's first shot, or of a later one after a
    /// silence.
    fn look_around(&mut self, time_ns: i64, is_first: bool) {
        let stretch = time_ns / VIEW_NS;
        let is_due = is_first || time_ns > (self.view.0 + 1) * VIEW_NS + VIEW_SLACK_NS;
        if is_due && self.view.0 != stretch {
            self.view.0 = stretch;
            if self.config.motion.is_any() {
                self.view.1 = view(self.scene, &self.config, stretch);
            } else {
                let (time_s, half_s) = stretch_s(stretch);
                self.view.1.turn_to(time_s, half_s);
            }
        }
    }

    /// Fires all beams once and writes the returns into the blocks of this firing.
    fn fire(&self, firing: usize, draft: &mut Draft, rng: &mut Rng) {
        let Self { config, .. } = self;
        let time_ns = draft.times.firing_ns(firing, config);
        if draft.layout.begins_blocks(firing) {
            let azimuth = config
                .encoder
                .azimuth_cdeg(config.azimuth_rad(time_ns), rng);
            let blocks = draft.layout.blocks(firing);
            draft.packet.blocks[blocks]
                .iter_mut()
                .for_each(|block| block.set_azimuth_cdeg(azimuth));
        }
        // Lasers that fire together look along one direction of the head.
        let mut shot_ns = i64::MIN;
        let mut head_rad = 0.0;
        let mut pose = config.pose;
        for (channel, laser) in self.lasers.iter().enumerate() {
            let time_ns = time_ns + i64::from(config.spec.channel_offset_ns(channel, draft.mode));
            if time_ns != shot_ns {
                shot_ns = time_ns;
                head_rad = config.azimuth_rad(time_ns);
                pose = config.pose_at(time_ns as f64 * 1e-9);
            }
            if let Some(fault) = config.eye {
                let laser = (channel, self.is_low[channel]);
                match fault.sight(time_ns, laser, head_rad, rng) {
                    Sight::Scene => {}
                    Sight::Nothing => continue,
                    Sight::Spoilt(distance_m, reflectivity) => {
                        self.spoil(draft, [firing, channel], distance_m, reflectivity);
                        continue;
                    }
                }
            }
            let aim = laser.aimed(head_rad);
            let guess_m = draft.met_m[channel];
            let shot = Shot {
                aim,
                pose: &pose,
                time_s: time_ns as f64 * 1e-9,
                guess_m,
            };
            let returns = optics::shoot(&config.optics, &self.view.1, &shot, draft.mode, rng);
            draft.met_m[channel] =
                returns[0].map_or(config.optics.max_range_m, |one| one.distance_m);
            let mut written = None;
            for (number, one) in returns.iter().enumerate() {
                let Some(one) = one else { continue };
                // The same return twice has the same noise: the sensor measured it once.
                let bytes = match written {
                    Some((before, bytes)) if before == *one => bytes,
                    _ => optics::record(&config.optics, one, &aim, rng),
                };
                written = Some((*one, bytes));
                let (block, record) = draft.layout.place(firing, channel, number);
                draft.packet.blocks[block].records[record] = bytes;
                if self.tells {
                    draft.truth.returns[block][record] = Some(truth(one, &aim, time_ns));
                }
            }
        }
    }

    /// Writes a return that is not of the scene, as a firing's shot of a channel; it has no truth.
    fn spoil(&self, draft: &mut Draft, shot: [usize; 2], distance_m: f64, reflectivity: u8) {
        let units = distance_m / self.config.spec.distance_unit_m;
        let bytes = Record {
            distance: (units as u16).into(),
            reflectivity,
        };
        let reported = if draft.mode == ReturnMode::Dual { 2 } else { 1 };
        for number in 0..reported {
            let (block, record) = draft.layout.place(shot[0], shot[1], number);
            draft.packet.blocks[block].records[record] = bytes;
        }
    }

    fn send(
        &self,
        arrival_ns: i64,
        port: u16,
        payload: Vec<u8>,
        truth: Option<Box<PacketTruth>>,
    ) -> SimulatedDatagram {
        let EmitterConfig { model, address, .. } = self.config;
        let source = SocketAddrV4::new(address, port);
        let destination = SocketAddrV4::new(destination(model, address), port);
        SimulatedDatagram {
            arrival_ns,
            source,
            destination,
            payload,
            truth,
        }
    }
}

fn truth(one: &Return, aim: &Aim<'_>, time_ns: i64) -> ReturnTruth {
    let azimuth_rad = within_turn(aim.azimuth_of(one.distance_m));
    let Hit {
        object,
        class,
        distance_m,
        ..
    } = one.hit;
    ReturnTruth {
        object,
        class,
        range_m: distance_m,
        azimuth_rad,
        time_ns,
    }
}

/// An azimuth from 0 to a whole turn; avoids the division for those that already are.
fn within_turn(azimuth_rad: f64) -> f64 {
    if (0.0..TAU).contains(&azimuth_rad) {
        azimuth_rad
    } else {
        azimuth_rad.rem_euclid(TAU)
    }
}

/// The scene as the sensor sees it during a stretch of time.
fn view<'a>(scene: &'a Scene, config: &EmitterConfig, stretch: i64) -> View<'a> {
    let (time_s, half_s) = stretch_s(stretch);
    let (eye, around_m) = eye(&config.pose_at(time_s), &config.beams());
    let way_m = config.motion.velocity.norm() * half_s;
    View::new(scene, eye, around_m + way_m, time_s, half_s)
}

/// The origins of a sensor's beams: their middle, and the distance of the farthest from it, metres.
fn eye(pose: &Pose, beams: &Calibration) -> (Vec3, f64) {
    let heights = beams.beams().iter().map(|beam| beam.vertical_offset_m);
    let [low, high] = [
        heights.clone().fold(f64::INFINITY, f64::min),
        heights.fold(f64::NEG_INFINITY, f64::max),
    ];
    let aside_m = beams
        .beams()
        .iter()
        .map(|beam| beam.horizontal_offset_m.abs())
        .fold(0.0, f64::max);
    (
        pose.origin + pose.turned(Vec3::z() * ((low + high) / 2.0)),
        f64::hypot((high - low) / 2.0, aside_m) + 0.01,
    )
}

/// The middle of a stretch of time and half of how long it is, seconds.
fn stretch_s(stretch: i64) -> (f64, f64) {
    let half_s = VIEW_NS as f64 * 0.5e-9;
    // A packet that begins in the stretch may end a little after it.
    ((2 * stretch + 1) as f64 * half_s, half_s + 0.002)
}

impl Iterator for Emitter<'_> {
    type Item = SimulatedDatagram;

    fn next(&mut self) -> Option<SimulatedDatagram> {
        if let Some(position) = self.position.take() {
            return Some(position);
        }
        let mut times = self.schedule.next(&self.config)?;
        while [times.firing_ns(0, &self.config), times.end_ns]
            .iter()
            .any(|&at_ns| self.config.is_restarting(at_ns))
        {
            times = self.schedule.next(&self.config)?;
        }
        // Each packet has its own random generator, so that it does not depend on earlier ones.
        let mut rng =
            Rng::with_seed(self.config.seed ^ times.ordinal.wrapping_mul(0x9E37_79B9_7F4A_7C15));
        let (packet, truth) = self.data_packet(times, &mut rng);
        let sent_ns = times.end_ns;
        // A delay of 90 us, and sometimes a busy host.
        let delay_ns = 90_000
            + rng.i64(0..20_000)
            + if rng.f64() < 0.05 {
                rng.i64(0..120_000)
            } else {
                0
            };
        let arrival_ns = self.config.start_utc_ns + self.config.host_ahead_ns + sent_ns + delay_ns;
        // A VLS-128 sends more often than that: what waits for a busy host stays in order.
        let arrival_ns = arrival_ns.max(self.arrived_ns.saturating_add(1_000));
        self.arrived_ns = arrival_ns;
        // An HDL-64E has no position packets: its status has the same content.
        if self.status.is_none()
            && (times.ordinal + 1).is_multiple_of(self.config.data_per_position)
        {
            let payload = gps::position_packet(&self.config, sent_ns + 10_000, &mut rng);
            self.arrived_ns += 12_000;
            self.position = Some(self.send(self.arrived_ns, POSITION_PORT, payload.to_vec(), None));
        }
        Some(self.send(arrival_ns, DATA_PORT, packet.emit().to_vec(), Some(truth)))
    }
}

#[cfg(test)]
mod tests;
