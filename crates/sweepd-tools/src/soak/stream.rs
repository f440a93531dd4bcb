//! A sensor's packets for ever: a turn and a half is simulated, and sent again and again while
//! clock and head go on.

use std::time::Duration;

use sweepd_core::sensor::Model;
use sweepd_core::wire::data::ReturnMode;
use sweepd_core::wire::hdl64::DUMP_PACKETS;
use sweepd_core::wire::{DataPacket, HOUR_US};
use sweepd_lab::simulate::{Emitter, EmitterConfig, Scene, fixtures};

/// Turns a minute: ten sweeps a second.
pub const RPM: f64 = 600.0;
/// How far the head turns, hundredths of a degree a nanosecond.
const CDEG_PER_NS: f64 = RPM / 60e9 * TURN_CDEG;
const TURN_CDEG: f64 = 36_000.0;

/// Packets of one return mode, rendered once.
#[derive(Debug)]
struct Clip {
    packets: Vec<DataPacket>,
    period_ns: u64,
}

impl Clip {
    fn new(model: Model, mode: ReturnMode, scene: &Scene) -> Self {
        let config = EmitterConfig {
            rpm: RPM,
            ..EmitterConfig::new(model, mode)
        }
        .turns(1.5);
        Self {
            period_ns: config.spec.packet_period_ns(mode).into(),
            packets: data_packets(config, scene),
        }
    }
}

fn data_packets(config: EmitterConfig, scene: &Scene) -> Vec<DataPacket> {
    Emitter::new(config, scene)
        .untold()
        .filter_map(|sent| DataPacket::parse(&sent.payload).ok().copied())
        .collect()
}

/// The two status bytes of an HDL-64E, packet by packet, for a whole dump.
fn status(model: Model) -> Vec<(u8, u8)> {
    if !model.is_hdl64e() {
        return Vec::new();
    }
    let config = EmitterConfig {
        packets: DUMP_PACKETS as u64,
        ..EmitterConfig::new(model, ReturnMode::Strongest)
    };
    // An empty scene costs little.
    let packets = data_packets(config, &Scene::new([0.0; 2], 0));
    packets
        .iter()
        .map(|packet| (packet.return_mode, packet.product))
        .collect()
}

/// A sensor that never ends.
#[derive(Debug)]
pub struct Stream {
    /// The first mode is that it begins with.
    clips: Vec<Clip>,
    status: Vec<(u8, u8)>,
    mode: usize,
    /// Place in the clip.
    index: usize,
    /// How far the head is ahead of where the clip has it at its first packet, hundredths of a
    /// degree.
    ahead_cdeg: f64,
    /// Data packets so far, those that were skipped included.
    ordinal: u64,
    /// Sensor time of the next packet.
    time_ns: u64,
    /// How long it has measured, however its clock jumped.
    elapsed_ns: u64,
    /// Where the head stands still, if it does.
    frozen_cdeg: Option<u16>,
}

impl Stream {
    /// A sensor that knows these return modes and begins with the first.
    pub fn new(model: Model, modes: &[ReturnMode]) -> Self {
        let scene = fixtures::scene();
        let clips = modes
            .iter()
            .map(|&mode| Clip::new(model, mode, &scene))
            .collect();
        let status = status(model);
        Self {
            clips,
            status,
            mode: 0,
            index: 0,
            ahead_cdeg: 0.0,
            ordinal: 0,
            time_ns: 0,
            elapsed_ns: 0,
            frozen_cdeg: None,
        }
    }

    /// Sensor time, nanoseconds since it was switched on.
    pub fn time_ns(&self) -> u64 {
        self.time_ns
    }

    /// How long it has measured, however its clock jumped.
    pub fn elapsed(&self) -> Duration {
        Duration::from_nanos(self.elapsed_ns)
    }

    /// From one packet to the next, nanoseconds.
    pub fn period_ns(&self) -> u64 {
        self.clip().period_ns
    }

    /// The stamp of the next packet, microseconds of the hour.
    pub fn stamp_us(&self) -> u32 {
        (self.time_ns / 1000 % u64::from(HOUR_US)) as u32
    }

    /// The next packet.
    pub fn next_packet(&mut self) -> DataPacket {
        let mut packet = self.clip().packets[self.index];
        packet.set_stamp_us(self.stamp_us());
        for block in &mut packet.blocks {
            let cdeg = (f64::from(block.azimuth_cdeg()) + self.ahead_cdeg.round())
                .rem_euclid(TURN_CDEG) as u16;
            block.set_azimuth_cdeg(self.frozen_cdeg.unwrap_or(cdeg));
        }
        if !self.status.is_empty() {
            (packet.return_mode, packet.product) =
                self.status[(self.ordinal % self.status.len() as u64) as usize];
        }
        self.skip(1);
        packet
    }

    /// Measures this many packets that nobody gets.
    pub fn skip(&mut self, packets: u64) {
        for _ in 0..packets {
            let len = self.clip().packets.len();
            self.time_ns += self.period_ns();
            self.elapsed_ns += self.period_ns();
            self.ordinal += 1;
            self.index += 1;
            if self.index == len {
                self.index = 0;
                self.ahead_cdeg = (self.ahead_cdeg
                    + (len as u64 * self.period_ns()) as f64 * CDEG_PER_NS)
                    .rem_euclid(TURN_CDEG);
            }
        }
    }

    /// The clock jumps to another time of the hour; the head goes on.
    pub fn jump(&mut self, by_ns: u64) {
        self.time_ns += by_ns;
    }

    /// Stops the head where it is, or lets it go on from there.
    pub fn freeze(&mut self, is_frozen: bool) {
        let now_cdeg = self.now_cdeg();
        if let Some(cdeg) = self.frozen_cdeg.filter(|_| !is_frozen) {
            self.ahead_cdeg += f64::from(cdeg) - now_cdeg;
        }
        self.frozen_cdeg = is_frozen.then_some(now_cdeg as u16);
    }

    /// Another return mode, the next one, where there is one: the head goes on from where it is.
    pub fn switch_mode(&mut self) {
        let now_cdeg = self.now_cdeg();
        self.mode = (self.mode + 1) % self.clips.len();
        self.index = 0;
        self.ahead_cdeg = now_cdeg - f64::from(self.clip().packets[0].blocks[0].azimuth_cdeg());
    }

    /// Whether it knows more than one return mode.
    pub fn has_modes(&self) -> bool {
        self.clips.len() > 1
    }

    /// Where the head is at the next packet.
    fn now_cdeg(&self) -> f64 {
        let azimuth_cdeg = self.clip().packets[self.index].blocks[0].azimuth_cdeg();
        (f64::from(azimuth_cdeg) + self.ahead_cdeg.round()).rem_euclid(TURN_CDEG)
    }

    fn clip(&self) -> &Clip {
        &self.clips[self.mode]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn clock_and_head_continue_where_the_packets_begin_again() {
        let mut stream = Stream::new(Model::Vlp16, &[ReturnMode::Strongest, ReturnMode::Dual]);
        let packets: Vec<DataPacket> = (0..400).map(|_| stream.next_packet()).collect();
        for two in packets.windows(2) {
            let [from, to] = [0, 1].map(|at: usize| f64::from(two[at].blocks[0].azimuth_cdeg()));
            let turned = (to - from).rem_euclid(TURN_CDEG);
            assert!((turned - 1_327_104.0 * CDEG_PER_NS).abs() < 6.0, "{turned}");
            assert!((1_327..=1_328).contains(&(two[1].stamp_us() - two[0].stamp_us())));
        }
        // So do they through another mode and back, and a head that stood still goes on from there.
        let mut before_cdeg = stream.now_cdeg();
        for what in [
            Stream::switch_mode,
            Stream::switch_mode,
            |stream: &mut Stream| {
                stream.freeze(true);
                let stood = stream.next_packet().blocks[11].azimuth_cdeg();
                stream.skip(30);
                stream.freeze(false);
                assert!((stream.now_cdeg() - f64::from(stood)).abs() < 1.5);
            },
        ] {
            what(&mut stream);
            let turned = (stream.now_cdeg() - before_cdeg + 100.0).rem_euclid(TURN_CDEG) - 100.0;
            assert!(turned.abs() < 6.0, "{turned}");
            before_cdeg = stream.now_cdeg();
        }
    }

    #[test]
    fn an_hdl64e_sends_a_whole_dump() {
        let stream = Stream::new(Model::Hdl64eS2, &[ReturnMode::Strongest]);
        assert_eq!(stream.status.len(), DUMP_PACKETS);
    }
}
