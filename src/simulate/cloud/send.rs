//! The packets of a sensor that sees the same turn again and again, with its status beside.

use std::net::{Ipv4Addr, SocketAddrV4};

use super::{Echo, FromCloudError, MODE, Turn};
use crate::sensor::stream;
use crate::simulate::gps::Clock;
use crate::simulate::scene::Class;
use crate::simulate::truth::{PacketTruth, ReturnTruth, SimulatedDatagram};
use crate::wire::DATA_PORT;
use crate::wire::data::{BLOCKS, DataPacket, FLAG_BANK_1, RECORDS, Record};
use crate::wire::hdl64::{self, Dump, Gps, Live, Series, pair};
use crate::wire::nmea::civil_from_days;

/// The status is that of an S2.1: an S2 before it has none.
const SERIES: Series = Series::S21;
/// Share of a turn before the first cut: what a receiver needs to tell the model and the pitch.
const LEAD: f64 = 0.25;
/// Share of a turn behind the last cut, which closes the sweep.
const TAIL: f64 = 0.1;
const DAY_NS: i64 = 86_400_000_000_000;
const SECOND_NS: i64 = 1_000_000_000;

/// How packets are sent.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sending {
    /// For how long, seconds; `None` for one turn from cut to cut, and what must be before and behind it.
    pub seconds: Option<f64>,
    /// What the sensor's clock follows.
    pub clock: Clock,
    /// UTC of the first shot, nanoseconds since 1970.
    pub start_utc_ns: i64,
    /// The sensor's address.
    pub address: Ipv4Addr,
}

/// The datagrams of a turn, in the order in which they leave the sensor.
#[derive(Debug)]
pub struct Sender<'a> {
    turn: &'a Turn,
    sending: Sending,
    dump: Box<Dump>,
    packets: u64,
    ordinal: u64,
}

impl<'a> Sender<'a> {
    /// A sensor that sees a turn.
    ///
    /// # Errors
    /// [`FromCloudError::Calibration`]: what the status stream cannot carry.
    pub fn new(turn: &'a Turn, sending: Sending) -> Result<Self, FromCloudError> {
        let records = stream::records(&turn.calibration).map_err(FromCloudError::Calibration)?;
        let mut dump = Box::new(Dump::new(SERIES, &records));
        dump.rpm.set(turn.rpm().round() as i16);
        dump.set_return_mode(MODE);
        (dump.source, dump.destination) = (sending.address.octets(), Ipv4Addr::BROADCAST.octets());
        let packet_s = f64::from(turn.spec.packet_period_ns(MODE)) * 1e-9;
        let per_packet = turn.spec.firings_per_packet(MODE) as f64;
        let packets = match sending.seconds {
            Some(seconds) => seconds / packet_s,
            None => turn.firings as f64 * (LEAD + 1.0 + TAIL) / per_packet,
        };
        Ok(Self { turn, sending, dump, packets: packets.ceil() as u64, ordinal: 0 })
    }

    /// Data packets in all.
    pub fn packets(&self) -> u64 {
        self.packets
    }

    /// First shot of a packet, nanoseconds after the first of all.
    fn first_shot_ns(&self, ordinal: u64) -> i64 {
        ordinal as i64 * i64::from(self.turn.spec.packet_period_ns(MODE))
    }

    fn packet(&self, ordinal: u64) -> (DataPacket, Box<PacketTruth>) {
        let Turn { spec, firings, .. } = self.turn;
        let first_ns = self.first_shot_ns(ordinal);
        let stamped_ns = first_ns - spec.first_shot_ns(MODE, 0);
        let (kind, value) =
            pair(&self.dump, SERIES, &self.live(stamped_ns), (ordinal % hdl64::DUMP_PACKETS as u64) as usize);
        let stamp_us = self.sending.clock.stamp_us(self.sending.start_utc_ns, stamped_ns);
        let mut packet = DataPacket::new(stamp_us, kind, value);
        let mut truth = Box::new(PacketTruth { ordinal, returns: [[None; RECORDS]; BLOCKS] });
        let per_packet = spec.firings_per_packet(MODE);
        let lead = (*firings as f64 * LEAD) as usize;
        let start = (ordinal % *firings as u64) as usize * per_packet + firings - lead;
        for index in 0..per_packet {
            let time_ns = first_ns + index as i64 * i64::from(spec.firing_period_ns(MODE));
            self.fire((start + index) % firings, index, time_ns, &mut packet, &mut truth);
        }
        (packet, truth)
    }

    /// Writes what a firing of the turn reports into its blocks.
    fn fire(&self, firing: usize, index: usize, time_ns: i64, packet: &mut DataPacket, truth: &mut PacketTruth) {
        let turn = self.turn;
        let banks = turn.spec.banks();
        for bank in 0..banks {
            let block = index * banks + bank;
            packet.blocks[block].set_azimuth_cdeg(turn.azimuth_cdeg(firing));
            if bank == 1 {
                packet.blocks[block].flag.set(FLAG_BANK_1);
            }
            for record in 0..RECORDS {
                let channel = bank * RECORDS + record;
                let Some(&Echo { point, distance, reflectivity, range_m }) = turn.at(firing, channel) else { continue };
                packet.blocks[block].records[record] = Record { distance: distance.into(), reflectivity };
                let time_ns = time_ns + i64::from(turn.spec.channel_offset_ns(channel, MODE));
                let azimuth_rad = turn.head_rad(firing, channel).rem_euclid(std::f64::consts::TAU);
                truth.returns[block][record] =
                    Some(ReturnTruth { object: point, class: Class::Unknown, range_m, azimuth_rad, time_ns });
            }
        }
    }

    /// What the status says of the moment.
    fn live(&self, elapsed_ns: i64) -> Live {
        let utc_ns = self.sending.start_utc_ns + elapsed_ns;
        let (year, month, day) = civil_from_days(utc_ns.div_euclid(DAY_NS));
        let second = utc_ns.rem_euclid(DAY_NS) / SECOND_NS;
        let clock = hdl64::Clock {
            hour: (second / 3600) as u8,
            minute: (second / 60 % 60) as u8,
            second: (second % 60) as u8,
            day: day as u8,
            month: month as u8,
            year: (year - 2000).clamp(0, 255) as u8,
        };
        let gps = if matches!(self.sending.clock, Clock::Gps { .. }) { Gps::Both } else { Gps::None };
        Live { clock, gps, temperature_c: 41, firmware: 0x47 }
    }
}

impl Iterator for Sender<'_> {
    type Item = SimulatedDatagram;

    fn next(&mut self) -> Option<SimulatedDatagram> {
        let ordinal = self.ordinal;
        if ordinal >= self.packets {
            return None;
        }
        self.ordinal += 1;
        let (packet, truth) = self.packet(ordinal);
        Some(SimulatedDatagram {
            // 90 us on the way.
            arrival_ns: self.sending.start_utc_ns + self.first_shot_ns(ordinal + 1) + 90_000,
            source: SocketAddrV4::new(self.sending.address, DATA_PORT),
            destination: SocketAddrV4::new(Ipv4Addr::BROADCAST, DATA_PORT),
            payload: packet.emit().to_vec(),
            truth: Some(truth),
        })
    }
}
