//! The datagrams of one sensor, what goes wrong with them, and what the daemon must count of it.

use std::collections::BTreeMap;
use std::io;
use std::net::{Ipv4Addr, SocketAddrV4, UdpSocket};
use std::thread;
use std::time::{Duration, Instant};

use fastrand::Rng;

use super::stream::Stream;
use sweepd_core::sensor::Model;
use sweepd_core::wire::data::{BLOCKS, DATA_PACKET_LEN, RECORDS, ReturnMode};
use sweepd_core::wire::{DataPacket, HOUR_US};
use sweepd_lab::simulate::EmitterConfig;
use sweepd_lab::simulate::gps::{self, Clock, Reception};

/// Between two faults at least this many packets are whole, so that each fault can be counted.
const BETWEEN: u32 = 10;
/// More packets than any sensor sends in a turn.
pub const WITHIN_A_TURN: u32 = 400;
/// One packet in this many meets a fault, beyond that.
const ONE_IN: u32 = 60;
/// Data packets for each position packet.
const DATA_PER_POSITION: u64 = 14;
/// An hour of the sensor's clock.
const HOUR_NS: u64 = HOUR_US as u64 * 1000;

/// What the daemon must have counted of a sensor since the daemon began.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct ExpectedCounts {
    /// Datagrams of any kind to the sensor's data port.
    pub received: u64,
    /// The rejected ones among them, by reason.
    pub rejected: BTreeMap<&'static str, u64>,
    /// Data packets to the other sensor's data port.
    pub to_other_port: u64,
    /// Data packets that are admitted.
    pub packets: u64,
    /// The ones among them that are not decoded, by reason.
    pub undecoded: BTreeMap<&'static str, u64>,
    /// Position packets.
    pub positions: u64,
    /// Packets missing by the sensor's clock.
    pub lost: u64,
    /// Packets that were overtaken.
    pub reordered: u64,
}

/// How often each fault was injected.
pub type Injected = BTreeMap<&'static str, u64>;

/// What a sensor is, and the addresses of its datagrams.
#[derive(Clone, Debug)]
pub struct FeedConfig {
    /// The model.
    pub model: Model,
    /// The sensor's address.
    pub from: Ipv4Addr,
    /// An address that is not configured.
    pub foreign: Ipv4Addr,
    /// Where its data packets go.
    pub data: SocketAddrV4,
    /// Where its position packets go; an HDL-64E sends none.
    pub position: Option<SocketAddrV4>,
    /// The data port of the other sensor.
    pub other: SocketAddrV4,
}

/// A sensor that sends.
#[derive(Debug)]
pub struct Feed {
    config: FeedConfig,
    /// Its packets.
    pub stream: Stream,
    socket: UdpSocket,
    foreign: UdpSocket,
    rng: Rng,
    /// Packets until the next fault may come.
    whole: u32,
    has_gps: bool,
    /// What must be counted since the daemon began.
    pub expected: ExpectedCounts,
    /// What was injected in the whole run.
    pub injected: Injected,
    /// Datagrams sent in the whole run.
    pub sent: u64,
}

/// What happens to a packet, or beside it.
#[derive(Clone, Copy, Debug)]
enum PacketFault {
    Lost,
    Twice,
    Overtaken,
    Short,
    Marker,
    Azimuth,
    Distance,
    Stamp,
    Product,
    Foreign,
    WrongPort,
    Junk,
}

const PACKET_FAULTS: [PacketFault; 12] = [
    PacketFault::Lost,
    PacketFault::Twice,
    PacketFault::Overtaken,
    PacketFault::Short,
    PacketFault::Marker,
    PacketFault::Azimuth,
    PacketFault::Distance,
    PacketFault::Stamp,
    PacketFault::Product,
    PacketFault::Foreign,
    PacketFault::WrongPort,
    PacketFault::Junk,
];

/// What happens to a sensor as a whole, between packets.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SensorFault {
    /// Its clock jumps, far.
    ClockJump,
    /// Its head stands still for a while.
    HeadStall,
    /// It changes to another return mode.
    ModeSwitch,
    /// It is silent for this long, in real time.
    Silence(Duration),
    /// Its receiver gets or loses satellites.
    Gps,
}

impl Feed {
    /// A sensor that has sent nothing yet.
    ///
    /// # Errors
    /// A socket cannot be bound.
    pub fn new(config: FeedConfig, seed: u64) -> io::Result<Self> {
        let modes: &[ReturnMode] = if config.model.is_hdl64e() {
            &[ReturnMode::Strongest]
        } else {
            &[ReturnMode::Strongest, ReturnMode::Dual]
        };
        Ok(Self {
            stream: Stream::new(config.model, modes),
            socket: UdpSocket::bind((config.from, 0))?,
            foreign: UdpSocket::bind((config.foreign, 0))?,
            config,
            rng: Rng::with_seed(seed),
            whole: 0,
            has_gps: false,
            expected: ExpectedCounts::default(),
            injected: Injected::new(),
            sent: 0,
        })
    }

    /// Sends this many packets whole.
    ///
    /// # Errors
    /// The network refuses.
    pub fn send_whole(&mut self, packets: u32) -> io::Result<()> {
        self.whole = self.whole.max(packets);
        (0..packets).try_for_each(|_| self.step())
    }

    /// Sends the next packet, or what a fault makes of it.
    ///
    /// # Errors
    /// The network refuses.
    pub fn step(&mut self) -> io::Result<()> {
        if self.whole > 0 {
            self.whole -= 1;
        } else if self.rng.u32(..ONE_IN) == 0 {
            self.whole = BETWEEN;
            let fault = PACKET_FAULTS[self.rng.usize(..PACKET_FAULTS.len())];
            return self.inject(fault);
        }
        self.send_next().map(drop)
    }

    /// Injects a fault of the sensor as a whole. The packets before and after it are whole.
    ///
    /// # Errors
    /// The network refuses.
    pub fn inject_into_sensor(&mut self, fault: SensorFault) -> io::Result<()> {
        self.send_whole(BETWEEN)?;
        match fault {
            SensorFault::ClockJump => {
                // From a minute to the hour less a minute: backwards as well as forwards, since the
                // clock has no date.
                let jump_ns = self.rng.u64(HOUR_NS / 60..HOUR_NS / 60 * 59);
                self.stream.jump(jump_ns);
                self.count("clock jump", 1);
            }
            SensorFault::HeadStall => {
                self.stream.freeze(true);
                let packets = self.rng.u32(50..=400);
                self.send_whole(packets)?;
                self.stream.freeze(false);
                self.count("head stall", 1);
                // No motor is at its speed at once: the daemon believes in that again within a turn
                // or so.
                self.send_whole(WITHIN_A_TURN)?;
            }
            SensorFault::ModeSwitch => {
                if self.stream.has_modes() {
                    self.stream.switch_mode();
                    self.count("mode switch", 1);
                }
            }
            SensorFault::Silence(real) => {
                let begun = Instant::now();
                thread::sleep(real);
                // What it measured meanwhile is lost.
                let packets = begun.elapsed().as_nanos() as u64 / self.stream.period_ns();
                self.lose("silence", packets);
            }
            SensorFault::Gps => {
                self.has_gps = !self.has_gps;
                self.count("GPS gained or lost", 1);
            }
        }
        self.send_whole(2 * BETWEEN)
    }

    fn inject(&mut self, fault: PacketFault) -> io::Result<()> {
        match fault {
            PacketFault::Lost => {
                let several = self.rng.bool();
                let packets = if several { self.rng.u64(2..=20) } else { 1 };
                self.lose("lost", packets);
            }
            PacketFault::Twice => {
                let packet = self.send_next()?;
                self.send(&packet)?;
                *self.expected.undecoded.entry("duplicate").or_default() += 1;
                self.count("twice", 1);
            }
            PacketFault::Overtaken => {
                let late = self.stream.next_packet();
                for _ in 0..self.rng.u32(1..=4) {
                    self.send_next()?;
                }
                self.send(&late)?;
                self.expected.reordered += 1;
                self.count("overtaken", 1);
            }
            PacketFault::Foreign => {
                let mut packet = self.send_next()?;
                packet.set_stamp_us(self.rng.u32(..HOUR_US));
                self.foreign.send_to(packet.emit(), self.config.data)?;
                self.expect_rejected("source");
                self.count("foreign", 1);
            }
            PacketFault::WrongPort => {
                let packet = self.send_next()?;
                self.socket.send_to(packet.emit(), self.config.other)?;
                self.sent += 1;
                self.expected.to_other_port += 1;
                self.count("to the wrong port", 1);
            }
            PacketFault::Junk => {
                self.send_next()?;
                let is_short = self.rng.bool();
                let len = self.rng.usize(if is_short { 0..42 } else { 1300..9000 });
                let is_foreign = self.rng.bool();
                let from = if is_foreign {
                    &self.foreign
                } else {
                    &self.socket
                };
                from.send_to(&vec![0xEE; len], self.config.data)?;
                self.expect_rejected("length");
                self.count("junk", 1);
            }
            // The byte is a status on an HDL-64E, where any value may stand.
            PacketFault::Product if self.config.model.is_hdl64e() => self.flip_distance()?,
            PacketFault::Distance => self.flip_distance()?,
            PacketFault::Short | PacketFault::Marker | PacketFault::Azimuth => {
                self.send_rejected(fault)?;
            }
            PacketFault::Stamp | PacketFault::Product => self.send_undecodable(fault)?,
        }
        Ok(())
    }

    /// Sends a packet that the daemon must reject, and then misses by the sensor's clock.
    fn send_rejected(&mut self, fault: PacketFault) -> io::Result<()> {
        let mut packet = self.stream.next_packet();
        let mut len = DATA_PACKET_LEN;
        let block = &mut packet.blocks[self.rng.usize(..BLOCKS)];
        let reason = match fault {
            PacketFault::Marker => {
                block.flag.set(0x1234);
                "marker"
            }
            PacketFault::Azimuth => {
                block.set_azimuth_cdeg(self.rng.u16(36_001..));
                "azimuth"
            }
            _ => {
                // A position packet is 512 bytes long.
                len = self.rng.usize(513..DATA_PACKET_LEN);
                "length"
            }
        };
        self.socket
            .send_to(&packet.emit()[..len], self.config.data)?;
        self.expect_rejected(reason);
        self.expected.lost += 1;
        self.count("corrupt", 1);
        Ok(())
    }

    /// Sends a packet that the daemon must admit and not decode, and then misses by the sensor's
    /// clock.
    fn send_undecodable(&mut self, fault: PacketFault) -> io::Result<()> {
        let mut packet = self.stream.next_packet();
        let reason = match fault {
            PacketFault::Stamp => {
                // The sum may be more than 32 bits hold.
                let half_hour_off = u64::from(packet.stamp_us()) + u64::from(HOUR_US / 2);
                packet.set_stamp_us((half_hour_off % u64::from(HOUR_US)) as u32);
                "unconfirmed"
            }
            _ => {
                packet.product ^= 0x40;
                "other_product"
            }
        };
        self.send(&packet)?;
        *self.expected.undecoded.entry(reason).or_default() += 1;
        self.expected.lost += 1;
        self.count("corrupt", 1);
        Ok(())
    }

    /// Sends a packet with a bit of a distance flipped, which nothing can notice.
    fn flip_distance(&mut self) -> io::Result<()> {
        let mut packet = self.stream.next_packet();
        let block = &mut packet.blocks[self.rng.usize(..BLOCKS)];
        let distance = &mut block.records[self.rng.usize(..RECORDS)].distance;
        distance.set(distance.get() ^ 1 << self.rng.u16(..16));
        self.count("distance flipped", 1);
        self.send(&packet)
    }

    /// The sensor measures this many packets that are never sent.
    fn lose(&mut self, fault: &'static str, packets: u64) {
        self.stream.skip(packets);
        self.expected.lost += packets;
        self.count(fault, packets);
    }

    /// Counts a datagram to the data port that must be rejected.
    fn expect_rejected(&mut self, reason: &'static str) {
        self.sent += 1;
        self.expected.received += 1;
        *self.expected.rejected.entry(reason).or_default() += 1;
    }

    /// Sends the next packet as it is, and returns it.
    fn send_next(&mut self) -> io::Result<DataPacket> {
        let packet = self.stream.next_packet();
        self.send(&packet)?;
        Ok(packet)
    }

    /// Sends a packet that must be admitted, and now and then a position packet.
    fn send(&mut self, packet: &DataPacket) -> io::Result<()> {
        self.socket.send_to(packet.emit(), self.config.data)?;
        self.sent += 1;
        self.expected.received += 1;
        self.expected.packets += 1;
        match self.config.position {
            Some(to) if self.expected.packets.is_multiple_of(DATA_PER_POSITION) => {
                self.send_position(to)
            }
            _ => Ok(()),
        }
    }

    fn send_position(&mut self, to: SocketAddrV4) -> io::Result<()> {
        let clock = if self.has_gps {
            Clock::Gps {
                position_deg: (50.1, 8.7),
                reception: Reception::ALWAYS,
            }
        } else {
            Clock::Free { hour_ns: 0 }
        };
        let config = EmitterConfig {
            clock,
            start_utc_ns: 0,
            ..EmitterConfig::new(self.config.model, ReturnMode::Strongest)
        };
        let payload = gps::position_packet(&config, self.stream.time_ns() as i64, &mut self.rng);
        self.socket.send_to(&payload, to)?;
        self.sent += 1;
        self.expected.positions += 1;
        Ok(())
    }

    fn count(&mut self, fault: &'static str, times: u64) {
        *self.injected.entry(fault).or_default() += times;
    }
}
