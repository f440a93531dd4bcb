//! One sensor's datagrams with everything that goes wrong on their way, and what the daemon must
//! count of it.

use std::collections::BTreeMap;
use std::io;
use std::net::{Ipv4Addr, SocketAddrV4, UdpSocket};
use std::time::Duration;

use fastrand::Rng;

use super::stream::Stream;
use sweepd_core::sensor::Model;
use sweepd_core::wire::HOUR_US;
use sweepd_core::wire::data::{DATA_PACKET_LEN, ReturnMode};
use sweepd_lab::simulate::EmitterConfig;
use sweepd_lab::simulate::gps::{self, Clock, Reception};

/// Why the daemon lets a datagram not in, in the order of [`Tally::rejected`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Refusal {
    /// Its length is that of no packet.
    Length,
    /// A block has no marker.
    Marker,
    /// A block has an impossible azimuth.
    Azimuth,
    /// It is of no configured sensor.
    Source,
    /// It is of a sensor on another port.
    Port,
    /// It is a position packet of one of several sensors.
    Ambiguous,
}

impl Refusal {
    /// All of them.
    pub const ALL: [Self; 6] = [
        Self::Length,
        Self::Marker,
        Self::Azimuth,
        Self::Source,
        Self::Port,
        Self::Ambiguous,
    ];

    /// Its name in the daemon's metrics.
    pub fn name(self) -> &'static str {
        match self {
            Self::Length => "length",
            Self::Marker => "marker",
            Self::Azimuth => "azimuth",
            Self::Source => "source",
            Self::Port => "port",
            Self::Ambiguous => "ambiguous",
        }
    }
}

/// From one fault to the next at least this many packets are whole, so that each can be counted.
const BETWEEN: u32 = 10;
/// More packets than any sensor sends in a turn.
pub(super) const WITHIN_A_TURN: u32 = 400;
/// One packet in this many meets a fault, beyond that.
const ONE_IN: u32 = 60;
/// Data packets for each position packet.
const DATA_PER_POSITION: u64 = 14;
/// An hour of the sensor's clock.
const HOUR_NS: u64 = HOUR_US as u64 * 1000;

/// What the daemon must have counted of a sensor and its ports since it began.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Tally {
    /// Datagrams of any kind to the data port of the sensor.
    pub received: u64,
    /// Of those, what is not let in, by [`Refusal`].
    pub rejected: [u64; Refusal::ALL.len()],
    /// Data packets that went to the port of the other sensor.
    pub astray: u64,
    /// Data packets that are let in.
    pub packets: u64,
    /// Position packets.
    pub positions: u64,
    /// Packets missing by the sensor's clock.
    pub lost: u64,
    /// Packets that were overtaken.
    pub reordered: u64,
    /// Copies.
    pub duplicates: u64,
    /// Packets of another time.
    pub unconfirmed: u64,
    /// Packets of another product.
    pub other_product: u64,
}

/// How often each fault was injected.
pub type Injected = BTreeMap<&'static str, u64>;

/// Where a sensor stands, and what it is.
#[derive(Clone, Debug)]
pub struct Place {
    /// Its name in the configuration.
    pub name: &'static str,
    /// The model.
    pub model: Model,
    /// Where it sends from.
    pub from: Ipv4Addr,
    /// Where its data go.
    pub to: SocketAddrV4,
    /// Where its position packets go; an HDL-64E sends none.
    pub position: Option<SocketAddrV4>,
    /// The data port of another sensor.
    pub other: SocketAddrV4,
}

/// A sensor at work.
#[derive(Debug)]
pub struct Feed {
    /// Where it stands.
    pub place: Place,
    /// Its packets.
    pub stream: Stream,
    socket: UdpSocket,
    foreign: UdpSocket,
    rng: Rng,
    /// Packets until the next fault may come.
    whole: u32,
    has_gps: bool,
    /// What must be counted since the daemon began.
    pub tally: Tally,
    /// What was injected, of all time.
    pub injected: Injected,
    /// Datagrams sent, of all time.
    pub sent: u64,
}

/// What happens to a packet, or beside it.
#[derive(Clone, Copy, Debug)]
enum Fault {
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

const FAULTS: [Fault; 12] = [
    Fault::Lost,
    Fault::Twice,
    Fault::Overtaken,
    Fault::Short,
    Fault::Marker,
    Fault::Azimuth,
    Fault::Distance,
    Fault::Stamp,
    Fault::Product,
    Fault::Foreign,
    Fault::WrongPort,
    Fault::Junk,
];

/// What happens to a sensor as a whole, between packets.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Event {
    /// Its clock jumps, far.
    ClockJump,
    /// Its head stands still for a while.
    HeadStall,
    /// It reports another number of returns.
    ModeSwitch,
    /// It is silent, in real time, for so long.
    Silence(Duration),
    /// Its receiver gets or loses satellites.
    Gps,
}

impl Feed {
    /// A sensor that has sent nothing yet. Foreign datagrams come from `foreign`, an address that
    /// nobody configured.
    ///
    /// # Errors
    /// No socket can be had.
    pub fn new(place: Place, foreign: Ipv4Addr, seed: u64) -> io::Result<Self> {
        let modes = [ReturnMode::Strongest, ReturnMode::Dual];
        let modes = if place.model.is_hdl64e() {
            &modes[..1]
        } else {
            &modes
        };
        let (stream, rng) = (Stream::new(place.model, modes), Rng::with_seed(seed));
        let (socket, foreign) = (
            UdpSocket::bind((place.from, 0))?,
            UdpSocket::bind((foreign, 0))?,
        );
        let (tally, injected) = (Tally::default(), Injected::new());
        Ok(Self {
            place,
            stream,
            socket,
            foreign,
            rng,
            whole: 0,
            has_gps: false,
            tally,
            injected,
            sent: 0,
        })
    }

    /// Another daemon counts from zero.
    pub fn begin_anew(&mut self) {
        self.tally = Tally::default();
    }

    /// Sends this many packets whole.
    ///
    /// # Errors
    /// The network refuses.
    pub fn send_whole(&mut self, packets: u32) -> io::Result<()> {
        self.whole = self.whole.max(packets);
        (0..packets).try_for_each(|_| self.step())
    }

    /// The next packet, and what goes wrong with it.
    ///
    /// # Errors
    /// The network refuses.
    pub fn step(&mut self) -> io::Result<()> {
        if self.whole > 0 {
            self.whole -= 1;
        } else if self.rng.u32(..ONE_IN) == 0 {
            self.whole = BETWEEN;
            let fault = FAULTS[self.rng.usize(..FAULTS.len())];
            return self.fault(fault);
        }
        let packet = self.stream.next_packet();
        self.send(packet.emit())
    }

    /// Something that concerns the sensor as a whole. The packets before and after it are whole.
    ///
    /// # Errors
    /// The network refuses.
    pub fn event(&mut self, event: Event) -> io::Result<()> {
        self.send_whole(BETWEEN)?;
        match event {
            Event::ClockJump => {
                // From a minute to the hour less a minute: backwards as well as forwards, since the
                // clock has no date.
                self.stream
                    .jump(self.rng.u64(HOUR_NS / 60..HOUR_NS / 60 * 59));
                self.inject("clock jump", 1);
            }
            Event::HeadStall => {
                self.stream.freeze(true);
                let packets = self.rng.u32(50..=400);
                self.send_whole(packets)?;
                self.stream.freeze(false);
                self.inject("head stall", 1);
                // No motor is at its speed at once: the daemon believes in that again within a turn
                // or so.
                self.send_whole(WITHIN_A_TURN)?;
            }
            Event::ModeSwitch if self.stream.has_modes() => {
                self.stream.switch_mode();
                self.inject("mode switch", 1);
            }
            Event::ModeSwitch => {}
            Event::Silence(real) => {
                let begun = std::time::Instant::now();
                std::thread::sleep(real);
                // What it measured meanwhile, nobody got.
                let packets = begun.elapsed().as_nanos() as u64 / self.stream.period_ns();
                self.stream.skip(packets);
                self.tally.lost += packets;
                self.inject("silence", 1);
            }
            Event::Gps => {
                self.has_gps = !self.has_gps;
                self.inject("GPS gained or lost", 1);
            }
        }
        self.send_whole(2 * BETWEEN)
    }

    fn fault(&mut self, fault: Fault) -> io::Result<()> {
        match fault {
            Fault::Lost => {
                let packets = if self.rng.bool() {
                    1
                } else {
                    self.rng.u64(2..=20)
                };
                self.stream.skip(packets);
                self.tally.lost += packets;
                self.inject("lost", packets);
                return Ok(());
            }
            Fault::Twice => {
                let packet = self.stream.next_packet();
                self.send(packet.emit())?;
                self.send(packet.emit())?;
                self.tally.duplicates += 1;
                self.inject("twice", 1);
            }
            Fault::Overtaken => {
                let late = self.stream.next_packet();
                for _ in 0..self.rng.u32(1..=4) {
                    let packet = self.stream.next_packet();
                    self.send(packet.emit())?;
                }
                self.send(late.emit())?;
                self.tally.reordered += 1;
                self.inject("overtaken", 1);
            }
            Fault::Foreign | Fault::WrongPort | Fault::Junk => self.stray(fault)?,
            _ => self.corrupt(fault)?,
        }
        Ok(())
    }

    /// A packet that is not as it was sent.
    fn corrupt(&mut self, fault: Fault) -> io::Result<()> {
        let mut packet = self.stream.next_packet();
        let block = self.rng.usize(..packet.blocks.len());
        match fault {
            Fault::Short => {
                // A position packet is 512 bytes long.
                let len = self.rng.usize(513..DATA_PACKET_LEN);
                self.reject(Refusal::Length);
                self.socket.send_to(&packet.emit()[..len], self.place.to)?;
            }
            Fault::Marker => {
                packet.blocks[block].flag.set(0x1234);
                self.reject(Refusal::Marker);
                self.socket.send_to(packet.emit(), self.place.to)?;
            }
            Fault::Azimuth => {
                packet.blocks[block].set_azimuth_cdeg(self.rng.u16(36_001..));
                self.reject(Refusal::Azimuth);
                self.socket.send_to(packet.emit(), self.place.to)?;
            }
            Fault::Stamp => {
                let other_us =
                    (u64::from(packet.stamp_us()) + u64::from(HOUR_US / 2)) % u64::from(HOUR_US);
                packet.set_stamp_us(other_us as u32);
                self.tally.unconfirmed += 1;
                self.send(packet.emit())?;
            }
            // The byte is a status on an HDL-64E, where any value may stand.
            Fault::Product if !self.place.model.is_hdl64e() => {
                packet.product ^= 0x40;
                self.tally.other_product += 1;
                self.send(packet.emit())?;
            }
            // Nobody can see that.
            _ => {
                let record = &mut packet.blocks[block].records[self.rng.usize(..32)];
                record
                    .distance
                    .set(record.distance.get() ^ 1 << self.rng.u16(..16));
                self.inject("distance flipped", 1);
                return self.send(packet.emit());
            }
        }
        // It is missing by the sensor's clock.
        self.tally.lost += 1;
        self.inject("corrupt", 1);
        Ok(())
    }

    /// A datagram of somebody else, or that goes astray, behind one that is whole.
    fn stray(&mut self, fault: Fault) -> io::Result<()> {
        let mut packet = self.stream.next_packet();
        self.send(packet.emit())?;
        match fault {
            Fault::Foreign => {
                packet.set_stamp_us(self.rng.u32(..HOUR_US));
                self.reject(Refusal::Source);
                self.foreign.send_to(packet.emit(), self.place.to)?;
                self.inject("foreign", 1);
            }
            Fault::WrongPort => {
                self.sent += 1;
                self.tally.astray += 1;
                self.socket.send_to(packet.emit(), self.place.other)?;
                self.inject("to the wrong port", 1);
            }
            _ => {
                let len = if self.rng.bool() {
                    self.rng.usize(..42)
                } else {
                    self.rng.usize(1300..9000)
                };
                self.reject(Refusal::Length);
                let from = if self.rng.bool() {
                    &self.socket
                } else {
                    &self.foreign
                };
                from.send_to(&vec![0xEE; len], self.place.to)?;
                self.inject("junk", 1);
            }
        }
        Ok(())
    }

    /// A datagram to the sensor's port that will not be let in.
    fn reject(&mut self, reason: Refusal) {
        self.sent += 1;
        self.tally.received += 1;
        self.tally.rejected[reason as usize] += 1;
    }

    /// Sends a packet that is let in, and now and then a position packet.
    fn send(&mut self, payload: &[u8]) -> io::Result<()> {
        self.socket.send_to(payload, self.place.to)?;
        self.sent += 1;
        self.tally.received += 1;
        self.tally.packets += 1;
        match self.place.position {
            Some(to) if self.tally.packets.is_multiple_of(DATA_PER_POSITION) => {
                self.send_position(to)
            }
            _ => Ok(()),
        }
    }

    fn send_position(&mut self, to: SocketAddrV4) -> io::Result<()> {
        let clock = match self.has_gps {
            true => Clock::Gps {
                position_deg: (50.1, 8.7),
                reception: Reception::ALWAYS,
            },
            false => Clock::Free { hour_ns: 0 },
        };
        let elapsed_ns = self.stream.time_ns() as i64;
        let sensor = EmitterConfig::new(self.place.model, ReturnMode::Strongest);
        let payload = gps::position_packet(
            &EmitterConfig {
                clock,
                start_utc_ns: 0,
                ..sensor
            },
            elapsed_ns,
            &mut self.rng,
        );
        self.socket.send_to(&payload, to)?;
        self.sent += 1;
        self.tally.positions += 1;
        Ok(())
    }

    fn inject(&mut self, what: &'static str, times: u64) {
        *self.injected.entry(what).or_default() += times;
    }
}
