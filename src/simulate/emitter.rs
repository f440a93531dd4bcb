//! The turning head: when each beam fires, where it points then, and the packets that follow.
//!
//! Everything starts from one continuous clock. A shot has a time; the time gives the azimuth of the head, which turns
//! while the beams fire; the direction gives the returns. What reaches the wire is then less than what was known: the
//! stamp is truncated to microseconds, the azimuth is that of the first shot in the block, rounded, and the range is
//! noisy and counted in units. The [`PacketTruth`] keeps what was lost.

use std::net::{Ipv4Addr, SocketAddrV4};

use fastrand::Rng;

use super::gps::{self, Clock};
use super::optics::{self, Optics, Shot};
use super::scene::{Class, Hit, Scene, View};
use super::shape::Vec3;
use super::street;
use crate::sensor::model::Spec;
use crate::sensor::{Calibration, Model};
use crate::wire::data::{BLOCKS, DataPacket, RECORDS, ReturnMode, TURN_CDEG};
use crate::wire::{DATA_PORT, Datagram, POSITION_PORT};

/// Where the sensor stands in the scene.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pose {
    /// The sensor's origin: to the right, ahead, and above the origin of the scene, metres.
    pub origin: Vec3,
    /// Which way the sensor's azimuth 0 points, clockwise from ahead, radians.
    pub heading_rad: f64,
}

/// How the encoder reports the head.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Encoder {
    /// Azimuth of the head at the first shot, degrees.
    pub start_deg: f64,
    /// The reported azimuth is off by at most this, degrees.
    pub jitter_deg: f64,
    /// Sends 36000 where rounding gives that, as real sensors do now and then, and not 0.
    pub sends_36000: bool,
}

/// What the motor does beside turning steadily.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Motor {
    /// The head starts at rest and gains speed evenly for so long, nanoseconds.
    pub spin_up_ns: i64,
    /// It stands still, while the lasers fire on, from one time to another; nanoseconds after the first shot.
    pub stall_ns: Option<[i64; 2]>,
}

impl Motor {
    /// For how long it would have had to turn steadily to be where it is at a time, nanoseconds.
    fn steady_ns(&self, time_ns: i64) -> f64 {
        let turning_ns = match self.stall_ns {
            Some([from, to]) if time_ns > from => time_ns.min(from) + (time_ns - to).max(0),
            _ => time_ns,
        } as f64;
        let spin_up_ns = self.spin_up_ns as f64;
        if turning_ns < spin_up_ns { turning_ns.powi(2) / (2.0 * spin_up_ns) } else { turning_ns - spin_up_ns / 2.0 }
    }
}

/// A sensor and what it is connected to.
#[derive(Clone, Debug)]
pub struct EmitterConfig {
    /// The model.
    pub model: Model,
    /// Which returns it reports.
    pub return_mode: ReturnMode,
    /// The beams of this unit; `None` for those of the model. Elevations and vertical offsets count.
    pub calibration: Option<Calibration>,
    /// Turns a minute.
    pub rpm: f64,
    /// When the head does not turn at that speed.
    pub motor: Motor,
    /// From this data packet on it reports the strongest return instead of both, or both instead of one.
    pub mode_switch: Option<u64>,
    /// Data packets to send.
    pub packets: u64,
    /// Where it stands.
    pub pose: Pose,
    /// How it reports where it points.
    pub encoder: Encoder,
    /// How well it sees.
    pub optics: Optics,
    /// What its clock follows.
    pub clock: Clock,
    /// UTC of the first shot, nanoseconds since 1970.
    pub start_utc_ns: i64,
    /// How far the receiving host's clock is ahead of UTC, nanoseconds.
    pub host_ahead_ns: i64,
    /// Data packets for each position packet; real sensors have been seen with 5 and with 14.
    pub data_per_position: u64,
    /// Its address.
    pub address: Ipv4Addr,
    /// Seed of all chance.
    pub seed: u64,
}

impl EmitterConfig {
    /// A sensor as it leaves the factory, 1.9 m above the right-hand lane, without GPS, for one turn at 600 rpm.
    pub fn new(model: Model, return_mode: ReturnMode) -> Self {
        let max_range_m = if model == Model::Hdl32e { 80.0 } else { 100.0 };
        Self {
            model,
            return_mode,
            calibration: None,
            rpm: 600.0,
            motor: Motor::default(),
            mode_switch: None,
            packets: 0,
            pose: Pose { origin: Vec3::new(street::LANE_M, 0.0, 1.9), heading_rad: 0.0 },
            encoder: Encoder { start_deg: 0.0, jitter_deg: 0.02, sends_36000: true },
            optics: Optics { min_range_m: 0.4, max_range_m, noise_m: 0.01, dropout: 0.004, spread_rad: 0.0015 },
            clock: Clock::Free { hour_ns: 0 },
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
        let packet_s = f64::from(self.model.spec().packet_period_ns(self.return_mode)) * 1e-9;
        self.packets = (turns * 60.0 / self.rpm / packet_s).ceil() as u64;
        self
    }

    /// The same for as many packets as begin within these seconds, with the mode switch after so many if there is one.
    pub fn seconds(mut self, seconds: f64, mode_switch: Option<f64>) -> Self {
        let packets = |mode, seconds: f64| {
            let packet_s = f64::from(self.model.spec().packet_period_ns(mode)) * 1e-9;
            ((seconds / packet_s).ceil() as u64, packet_s)
        };
        let (all, packet_s) = packets(self.return_mode, seconds);
        self.mode_switch = mode_switch.map(|at| packets(self.return_mode, at).0).filter(|&at| at < all);
        self.packets = match self.mode_switch {
            Some(at) => at + packets(other_mode(self.return_mode), seconds - at as f64 * packet_s).0,
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
}

/// What a sensor is switched to from a mode.
fn other_mode(mode: ReturnMode) -> ReturnMode {
    match mode {
        ReturnMode::Dual => ReturnMode::Strongest,
        ReturnMode::Strongest | ReturnMode::Last => ReturnMode::Dual,
    }
}

/// A datagram, and what the simulator knows about it.
#[derive(Clone, Debug)]
pub struct SimulatedDatagram {
    /// Arrival at the host by the host's clock, nanoseconds since 1970.
    pub arrival_ns: i64,
    /// The sensor.
    pub source: SocketAddrV4,
    /// Broadcast, to the port of data or of position packets.
    pub destination: SocketAddrV4,
    /// The UDP payload.
    pub payload: Vec<u8>,
    /// What a data packet measured; `None` for a position packet.
    pub truth: Option<Box<PacketTruth>>,
}

impl SimulatedDatagram {
    /// The datagram as a receiver sees it.
    pub fn datagram(&self) -> Datagram<'_> {
        Datagram {
            arrival_ns: self.arrival_ns,
            source: self.source.into(),
            destination_port: self.destination.port(),
            payload: &self.payload,
        }
    }
}

/// What a data packet measured.
#[derive(Clone, Debug, PartialEq)]
pub struct PacketTruth {
    /// Number of the data packet, from 0.
    pub ordinal: u64,
    /// By block and record; `None` where the record says "no return".
    pub returns: [[Option<ReturnTruth>; RECORDS]; BLOCKS],
}

/// What one return measured, before noise and rounding.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ReturnTruth {
    /// Object number in the scene, [`super::scene::GROUND`] and up.
    pub object: u32,
    /// What that object is.
    pub class: Class,
    /// Along the beam, metres.
    pub range_m: f64,
    /// Azimuth of the head at the shot, 0 to a whole turn, radians.
    pub azimuth_rad: f64,
    /// Time of the shot, nanoseconds after the first of all.
    pub time_ns: i64,
}

impl ReturnTruth {
    fn of(hit: &Hit, azimuth_rad: f64, time_ns: i64) -> Self {
        Self { object: hit.object, class: hit.class, range_m: hit.distance_m, azimuth_rad, time_ns }
    }
}

/// Moving things are looked up for so long at a time.
const VIEW_NS: i64 = 10_000_000;

/// The datagrams of a sensor, in the order in which they leave it.
pub struct Emitter<'a> {
    config: EmitterConfig,
    spec: &'static Spec,
    scene: &'a Scene,
    /// The scene around a time, and the number of that time.
    view: (i64, View<'a>),
    ordinal: u64,
    position: Option<SimulatedDatagram>,
}

impl<'a> Emitter<'a> {
    /// A sensor in a scene.
    pub fn new(config: EmitterConfig, scene: &'a Scene) -> Self {
        let view = (0, view(scene, &config, 0));
        Self { spec: config.model.spec(), config, scene, view, ordinal: 0, position: None }
    }

    /// First shot of a packet, nanoseconds after the first of all.
    fn first_shot_ns(&self, ordinal: u64) -> i64 {
        let periods_ns = |mode, count: u64| count as i64 * i64::from(self.spec.packet_period_ns(mode));
        let before = self.config.mode_switch.map_or(ordinal, |at| ordinal.min(at));
        let behind = periods_ns(other_mode(self.config.return_mode), ordinal - before);
        periods_ns(self.config.return_mode, before) + behind
    }

    /// Where the head points, radians from 0 to a whole turn.
    fn azimuth_rad(&self, time_ns: i64) -> f64 {
        let steady_ns = self.config.motor.steady_ns(time_ns);
        let turns = self.config.encoder.start_deg / 360.0 + self.config.rpm / 60.0 * steady_ns * 1e-9;
        turns.rem_euclid(1.0) * std::f64::consts::TAU
    }

    /// What the encoder says at a time, hundredths of a degree.
    fn azimuth_cdeg(&self, time_ns: i64, rng: &mut Rng) -> u16 {
        let Encoder { jitter_deg, sends_36000, .. } = self.config.encoder;
        let off_deg = jitter_deg * (2.0 * rng.f64() - 1.0);
        let turn = f64::from(TURN_CDEG);
        let cdeg = ((self.azimuth_rad(time_ns).to_degrees() + off_deg) * 100.0).rem_euclid(turn).round();
        if cdeg == turn && !sends_36000 { 0 } else { cdeg as u16 }
    }

    fn data_packet(&mut self, ordinal: u64, rng: &mut Rng) -> (DataPacket, Box<PacketTruth>) {
        let first_ns = self.first_shot_ns(ordinal);
        if self.view.0 != first_ns / VIEW_NS {
            self.view = (first_ns / VIEW_NS, view(self.scene, &self.config, first_ns / VIEW_NS));
        }
        let mode = self.config.mode_of(ordinal);
        let stamp_us = self.config.clock.stamp_us(self.config.start_utc_ns, first_ns);
        let mut packet = DataPacket::new(stamp_us, mode.byte(), self.spec.product.unwrap_or_default());
        let mut truth = Box::new(PacketTruth { ordinal, returns: [[None; RECORDS]; BLOCKS] });
        for firing in 0..self.spec.firings_per_packet(mode) {
            let time_ns = first_ns + i64::from(self.spec.firing_period_ns(mode)) * firing as i64;
            self.fire(firing, time_ns, &mut packet, &mut truth, rng);
        }
        (packet, truth)
    }

    /// Fires all beams once and writes what they see into the block, or the two blocks, of this firing.
    fn fire(&self, firing: usize, time_ns: i64, packet: &mut DataPacket, truth: &mut PacketTruth, rng: &mut Rng) {
        let Self { config, spec, .. } = self;
        let mode = config.mode_of(truth.ordinal);
        let copies = spec.blocks_per_azimuth(mode);
        let first_block = firing / spec.firings_per_azimuth() * copies;
        let first_record = firing % spec.firings_per_azimuth() * spec.channels;
        if first_record == 0 {
            let azimuth = self.azimuth_cdeg(time_ns, rng);
            packet.blocks[first_block..][..copies].iter_mut().for_each(|block| block.set_azimuth_cdeg(azimuth));
        }
        for channel in 0..spec.channels {
            let time_ns = time_ns + i64::from(spec.channel_offset_ns(channel, mode));
            let azimuth_rad = self.azimuth_rad(time_ns);
            let shot = self.shot(channel, azimuth_rad, time_ns);
            let returns = optics::shoot(&config.optics, &self.view.1, &shot, mode, rng);
            let record = first_record + channel;
            let mut written = None;
            for (block, one) in (first_block..).zip(returns.into_iter().take(copies)) {
                let Some(optics::Return { hit, .. }) = one else { continue };
                // The same return twice has the same noise: the sensor measured it once.
                let bytes = match written {
                    Some((before, bytes)) if before == hit => bytes,
                    _ => optics::record(&config.optics, &hit, spec.distance_unit_m, rng),
                };
                written = Some((hit, bytes));
                packet.blocks[block].records[record] = bytes;
                truth.returns[block][record] = Some(ReturnTruth::of(&hit, azimuth_rad, time_ns));
            }
        }
    }

    fn shot(&self, channel: usize, azimuth_rad: f64, time_ns: i64) -> Shot {
        let calibration = self
            .config
            .calibration
            .as_ref()
            .or_else(|| self.config.model.calibration())
            .expect("an HDL-64E is given a calibration");
        let beam = &calibration.beams()[channel];
        let pose = &self.config.pose;
        Shot {
            origin: pose.origin + Vec3::z() * beam.vertical_offset_m,
            azimuth_rad: azimuth_rad + pose.heading_rad,
            elevation_rad: beam.elevation_rad,
            time_s: time_ns as f64 * 1e-9,
        }
    }

    fn send(&self, arrival_ns: i64, port: u16, payload: Vec<u8>, truth: Option<Box<PacketTruth>>) -> SimulatedDatagram {
        let source = SocketAddrV4::new(self.config.address, port);
        let destination = SocketAddrV4::new(Ipv4Addr::BROADCAST, port);
        SimulatedDatagram { arrival_ns, source, destination, payload, truth }
    }
}

/// The scene within a stretch of time.
fn view<'a>(scene: &'a Scene, config: &EmitterConfig, stretch: i64) -> View<'a> {
    let half_s = VIEW_NS as f64 * 0.5e-9;
    // A packet that begins in the stretch may end a little after it; beams start up to 2 cm from the origin.
    View::new(scene, config.pose.origin, 0.03, (2 * stretch + 1) as f64 * half_s, half_s + 0.002)
}

impl Iterator for Emitter<'_> {
    type Item = SimulatedDatagram;

    fn next(&mut self) -> Option<SimulatedDatagram> {
        if let Some(position) = self.position.take() {
            return Some(position);
        }
        let ordinal = self.ordinal;
        if ordinal >= self.config.packets {
            return None;
        }
        self.ordinal += 1;
        // Each packet has dice of its own, so that it is the same whatever was sent before.
        let mut rng = Rng::with_seed(self.config.seed ^ ordinal.wrapping_mul(0x9E37_79B9_7F4A_7C15));
        let (packet, truth) = self.data_packet(ordinal, &mut rng);
        let sent_ns = self.first_shot_ns(ordinal + 1);
        // 90 us on the way, and now and then a busy host; less than a packet's period, so nothing overtakes.
        let delay_ns = 90_000 + rng.i64(0..20_000) + if rng.f64() < 0.05 { rng.i64(0..120_000) } else { 0 };
        let arrival_ns = self.config.start_utc_ns + self.config.host_ahead_ns + sent_ns + delay_ns;
        if self.ordinal.is_multiple_of(self.config.data_per_position) {
            let EmitterConfig { model, clock, start_utc_ns, .. } = self.config;
            let payload = gps::position_packet(model, &clock, start_utc_ns, sent_ns + 10_000, &mut rng);
            self.position = Some(self.send(arrival_ns + 12_000, POSITION_PORT, payload.to_vec(), None));
        }
        Some(self.send(arrival_ns, DATA_PORT, packet.emit().to_vec(), Some(truth)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::simulate::scene::Surface;
    use crate::simulate::shape::Shape;
    use crate::simulate::street::street;
    use crate::wire::position::Position;

    fn data(config: EmitterConfig, scene: &Scene) -> Vec<(DataPacket, PacketTruth)> {
        Emitter::new(config, scene)
            .filter_map(|sent| Some((*DataPacket::parse(&sent.payload).ok()?, *sent.truth?)))
            .collect()
    }

    /// Bare ground, an encoder without jitter and a flawless instrument.
    fn exact(model: Model, return_mode: ReturnMode) -> EmitterConfig {
        let mut config = EmitterConfig::new(model, return_mode);
        config.pose.origin = Vec3::new(0.0, 0.0, 1.9);
        config.encoder.jitter_deg = 0.0;
        config.optics = Optics::perfect(100.0);
        config
    }

    #[test]
    fn stamps_advance_by_the_truncated_period() {
        for (model, mode, steps) in [
            (Model::Vlp16, ReturnMode::Strongest, [1327, 1328]),
            (Model::Vlp16, ReturnMode::Dual, [663, 664]),
            (Model::Hdl32e, ReturnMode::Strongest, [552, 553]),
            (Model::Hdl32e, ReturnMode::Dual, [276, 277]),
        ] {
            let mut config = exact(model, mode);
            config.clock = Clock::Free { hour_ns: 77_123_456_789 };
            config.packets = 126;
            let packets = data(config, &Scene::new([0.0; 2], 20));
            let stamps: Vec<u32> = packets.iter().map(|(packet, _)| packet.stamp_us()).collect();
            assert!(stamps.windows(2).all(|two| steps.contains(&(two[1] - two[0]))), "{model} {mode}");
            // 125 periods are a whole number of microseconds on every model.
            let whole = u64::from(model.spec().packet_period_ns(mode)) * 125 / 1000;
            assert_eq!(u64::from(stamps[125] - stamps[0]), whole);
            for (n, (packet, truth)) in (0..).zip(&packets) {
                assert_eq!(truth.ordinal, n);
                assert_eq!((packet.return_mode, packet.product), (mode.byte(), model.spec().product.unwrap()));
            }
        }
    }

    #[test]
    fn a_wall_stands_where_plain_trigonometry_puts_it() {
        // A wall whose face is y = 12 and another whose face is x = 15, in a frame seen from 1.9 m above level ground.
        for (model, channel_us, firing_us, per_block) in
            [(Model::Vlp16, 2.304, 55.296, 2), (Model::Hdl32e, 1.152, 46.08, 1)]
        {
            let mut scene = Scene::new([0.0; 2], 20);
            let walls = [
                (Shape::cuboid([0.0, 12.5, 0.0], [80.0, 1.0, 40.0], 0.0), Surface::Plain(50)),
                (Shape::cuboid([15.5, 0.0, 0.0], [1.0, 80.0, 40.0], 0.0), Surface::Plain(50)),
            ];
            scene.add(Class::Building, Vec3::zeros(), walls);
            let mut config = exact(model, ReturnMode::Strongest);
            config.rpm = 540.0;
            let deg_per_us = 540.0 / 60.0 * 360.0 * 1e-6;
            let mut checked = 0;
            for (packet, _) in data(config, &scene) {
                for block in &packet.blocks {
                    for (k, record) in block.records.iter().enumerate() {
                        let (sequence, channel) = (k / (32 / per_block), k % (32 / per_block));
                        let lag_us = firing_us * sequence as f64 + channel_us * channel as f64;
                        let a = (f64::from(block.azimuth_cdeg()) / 100.0 + deg_per_us * lag_us).to_radians();
                        let w = model.calibration().unwrap().beams()[channel].elevation_rad;
                        let to_walls = (12.0 / a.cos()).min(15.0 / a.sin()) / w.cos();
                        let height = 1.9 + model.calibration().unwrap().beams()[channel].vertical_offset_m;
                        if !(0.1..1.4).contains(&a)
                            || w.sin() * to_walls + height < 0.3
                            || (a.tan() - 1.25).abs() < 0.01
                        {
                            continue;
                        }
                        let range_m = f64::from(record.distance.get()) * 0.002;
                        // Half a hundredth of a degree on the wire, half a unit of distance.
                        assert!((range_m - to_walls).abs() < 0.012, "{model} {a} {w}: {range_m} {to_walls}");
                        checked += 1;
                    }
                }
            }
            assert!(checked > 2_000, "{checked}");
        }
    }

    #[test]
    fn the_truth_is_what_the_bytes_say_less_the_noise() {
        let scene = street(3);
        for (model, mode) in
            [(Model::Vlp16, ReturnMode::Strongest), (Model::Vlp16, ReturnMode::Dual), (Model::Hdl32e, ReturnMode::Dual)]
        {
            let mut config = EmitterConfig::new(model, mode);
            config.packets = 60;
            let mut returns = 0;
            for (packet, truth) in data(config, &scene) {
                for (block, truths) in packet.blocks.iter().zip(&truth.returns) {
                    for (record, truth) in block.records.iter().zip(truths) {
                        assert_eq!(record.distance.get() != 0, truth.is_some());
                        let Some(truth) = truth else { continue };
                        let range_m = f64::from(record.distance.get()) * 0.002;
                        assert!((range_m - truth.range_m).abs() < 0.07, "{range_m} {}", truth.range_m);
                        assert!(truth.object >= 1 && truth.object as usize <= scene.objects().len());
                        assert_eq!(scene.objects()[truth.object as usize - 1].class, truth.class);
                        returns += 1;
                    }
                }
            }
            assert!(returns > 10_000, "{returns}");
        }
    }

    #[test]
    fn dual_blocks_come_in_pairs_and_the_even_one_is_never_nearer_than_the_last() {
        let mut config = EmitterConfig::new(Model::Vlp16, ReturnMode::Dual);
        config.optics.noise_m = 0.0;
        let (mut differ, mut nearer, mut equal) = (0, 0, 0);
        for (packet, _) in data(config, &street(3)) {
            assert!(packet.azimuths_in_groups(2));
            for pair in packet.blocks.chunks_exact(2) {
                for (last, strong) in pair[0].records.iter().zip(&pair[1].records) {
                    // Zero in one is zero in both.
                    assert_eq!(last.distance.get() == 0, strong.distance.get() == 0);
                    differ += usize::from(last != strong);
                    nearer += usize::from(last.distance.get() < strong.distance.get());
                    equal += usize::from(last == strong && last.distance.get() != 0);
                }
            }
        }
        assert!(nearer == 0 && differ > 300 && equal > 10 * differ, "{differ} {nearer} {equal}");
    }

    #[test]
    fn the_head_turns_as_fast_as_it_is_told() {
        let packets = data(exact(Model::Hdl32e, ReturnMode::Strongest), &Scene::new([0.0; 2], 20));
        // 600 rpm: 46.08 us a block are 0.165 888 degrees.
        for (n, block) in packets.iter().flat_map(|(packet, _)| &packet.blocks).enumerate() {
            let expected = (n as f64 * 16.588_8).rem_euclid(36_000.0).round() as u16 % 36_000;
            assert_eq!(block.azimuth_cdeg(), expected);
        }
    }

    #[test]
    fn the_motor_gains_speed_and_stands_still_when_it_is_told_to() {
        let second = 1_000_000_000;
        let motor = Motor { spin_up_ns: 2 * second, stall_ns: Some([5 * second, 8 * second]) };
        // Half the way of a steady motor while it gains speed: t * t / (2 * 2 s), then t - 1 s.
        for (at_s, steady_s) in [(0, 0.0), (1, 0.25), (2, 1.0), (5, 4.0), (6, 4.0), (8, 4.0), (9, 5.0)] {
            assert!((motor.steady_ns(at_s * second) * 1e-9 - steady_s).abs() < 1e-12, "{at_s}");
        }
        assert_eq!(Motor::default().steady_ns(7), 7.0);
    }

    #[test]
    fn a_mode_switch_changes_mode_and_period_and_not_the_length() {
        for (mode, other, periods_ns) in [
            (ReturnMode::Strongest, ReturnMode::Dual, [1_327_104, 663_552]),
            (ReturnMode::Dual, ReturnMode::Strongest, [663_552, 1_327_104]),
        ] {
            let config = exact(Model::Vlp16, mode).seconds(0.1, Some(0.04));
            let at = config.mode_switch.unwrap();
            let (packets, scene) = (config.packets, Scene::new([0.0; 2], 20));
            let stamps: Vec<_> =
                data(config, &scene).iter().map(|(packet, _)| (packet.return_mode, packet.stamp_us())).collect();
            assert_eq!(stamps.len() as u64, packets);
            for (ordinal, &(byte, stamp_us)) in (0..).zip(&stamps) {
                assert_eq!(byte, if ordinal < at { mode } else { other }.byte());
                let exact_ns = periods_ns[0] * ordinal.min(at) + periods_ns[1] * ordinal.saturating_sub(at);
                assert_eq!(u64::from(stamp_us), exact_ns / 1000);
            }
            let [switch_s, last_s] = [at as usize, stamps.len() - 1].map(|index| f64::from(stamps[index].1) * 1e-6);
            assert!((0.04..0.042).contains(&switch_s) && (0.098..0.1).contains(&last_s), "{switch_s} {last_s}");
        }
    }

    #[test]
    fn a_calibration_is_that_of_the_unit() {
        let mut beams = Model::Vlp16.calibration().unwrap().beams().to_vec();
        for beam in &mut beams {
            beam.elevation_rad -= 0.005;
            beam.vertical_offset_m += 0.1;
        }
        let mut config = exact(Model::Vlp16, ReturnMode::Strongest);
        config.calibration = Some(Calibration::new(beams.clone(), 0.002).unwrap());
        config.packets = 1;
        let (packet, _) = &data(config, &Scene::new([0.0; 2], 20))[0];
        for (record, beam) in packet.blocks[0].records.iter().zip(&beams).filter(|(_, beam)| beam.elevation_rad < -0.03)
        {
            let range_m = (1.9 + beam.vertical_offset_m) / -beam.elevation_rad.sin();
            assert!((f64::from(record.distance.get()) * 0.002 - range_m).abs() < 0.0011, "{range_m}");
        }
    }

    #[test]
    fn a_whole_turn_may_be_36000_on_the_wire() {
        let mut config = exact(Model::Vlp16, ReturnMode::Strongest);
        config.encoder.start_deg = 359.997;
        config.packets = 1;
        for (sends_36000, expected) in [(true, 36_000_u16), (false, 0)] {
            config.encoder.sends_36000 = sends_36000;
            let sent = Emitter::new(config.clone(), &Scene::new([0.0; 2], 20)).next().unwrap();
            assert_eq!(sent.payload[2..4], expected.to_le_bytes());
        }
    }

    #[test]
    fn position_packets_come_at_their_rate_and_nothing_overtakes() {
        let mut config = exact(Model::Hdl32e, ReturnMode::Dual);
        config.packets = 100;
        config.data_per_position = 5;
        let sent: Vec<_> = Emitter::new(config, &Scene::new([0.0; 2], 20)).collect();
        assert_eq!(sent.iter().filter(|one| one.truth.is_none()).count(), 20);
        assert!(sent.windows(2).all(|two| two[0].arrival_ns < two[1].arrival_ns));
        for one in &sent {
            let datagram = one.datagram();
            assert_eq!(datagram.destination_port == POSITION_PORT, Position::parse(datagram.payload).is_ok());
        }
    }

    #[test]
    fn the_same_configuration_gives_the_same_bytes() {
        let bytes = |seed, packets| -> Vec<Vec<u8>> {
            let mut config = EmitterConfig::new(Model::Vlp16, ReturnMode::Dual);
            (config.seed, config.packets) = (seed, packets);
            Emitter::new(config, &street(3)).map(|sent| sent.payload).collect()
        };
        assert_eq!(bytes(1, 20), bytes(1, 20));
        assert_eq!(bytes(1, 20)[..10], bytes(1, 10)[..10]);
        assert_ne!(bytes(1, 20), bytes(2, 20));
    }
}
