//! The packets of a sensor that sees the same turn repeatedly, with its status.

use std::net::{Ipv4Addr, SocketAddrV4};

use super::{Echo, FromCloudError, MODE, MODEL, Turn};
use crate::simulate::clock::Clock;
use crate::simulate::config::{EmitterConfig, destination};
use crate::simulate::layout::Layout;
use crate::simulate::scene::Class;
use crate::simulate::status::Status;
use crate::simulate::truth::{PacketTruth, ReturnTruth, SimulatedDatagram};
use sweepd_core::wire::DATA_PORT;
use sweepd_core::wire::data::{BLOCKS, DataPacket, RECORDS, Record};
use sweepd_core::wire::hdl64::CYCLE_LEN;

/// Share of a turn before the first cut, which a receiver needs to detect the model and the speed.
const LEAD: f64 = 0.25;
/// Share of a turn behind the last cut, which closes the sweep.
const TAIL: f64 = 0.1;

/// How packets are sent.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sending {
    /// Duration, seconds; `None` for one turn from cut to cut, with the necessary parts before and
    /// behind it.
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
    config: EmitterConfig,
    status: Status,
    layout: Layout,
    ordinal: u64,
}

impl<'a> Sender<'a> {
    /// A sensor that sees a turn.
    ///
    /// # Errors
    /// [`FromCloudError::Calibration`]: what the status stream cannot carry.
    pub fn new(turn: &'a Turn, sending: Sending) -> Result<Self, FromCloudError> {
        let Sending {
            clock,
            start_utc_ns,
            address,
            ..
        } = sending;
        let config = EmitterConfig {
            calibration: Some(turn.calibration.clone()),
            rpm: turn.rpm(),
            clock,
            start_utc_ns,
            address,
            ..EmitterConfig::new(MODEL, MODE)
        };
        let config = match sending.seconds {
            Some(seconds) => config.seconds(seconds, None),
            None => config.turns(LEAD + 1.0 + TAIL),
        };
        let status = Status::new(&config).map_err(FromCloudError::Calibration)?;
        Ok(Self {
            turn,
            config,
            status,
            layout: Layout::new(turn.spec, MODE),
            ordinal: 0,
        })
    }

    /// Data packets in all.
    pub fn packets(&self) -> u64 {
        self.config.packets
    }

    /// The time of a packet's stamp, nanoseconds after the first shot of all.
    fn stamped_ns(&self, ordinal: u64) -> i64 {
        self.config.first_shot_ns(ordinal) - self.config.spec.first_shot_ns(MODE, 0)
    }

    fn packet(&self, ordinal: u64) -> (DataPacket, Box<PacketTruth>) {
        let Turn { spec, firings, .. } = self.turn;
        let (kind, value) = self.status.pair(
            &self.config,
            ordinal,
            self.stamped_ns(ordinal - ordinal % CYCLE_LEN as u64),
        );
        let stamp_us = self.config.stamp_us(self.stamped_ns(ordinal));
        let mut packet = DataPacket::new(stamp_us, kind, value);
        self.layout.mark(&mut packet);
        let mut truth = Box::new(PacketTruth {
            ordinal,
            returns: [[None; RECORDS]; BLOCKS],
        });
        let per_packet = spec.firings_per_packet(MODE);
        let lead = (*firings as f64 * LEAD) as usize;
        let start = (ordinal % *firings as u64) as usize * per_packet + firings - lead;
        for index in 0..per_packet {
            self.fire((start + index) % firings, index, &mut packet, &mut truth);
        }
        (packet, truth)
    }

    /// Writes the returns of a firing into its blocks.
    fn fire(&self, firing: usize, index: usize, packet: &mut DataPacket, truth: &mut PacketTruth) {
        let Turn { spec, .. } = self.turn;
        let period_ns = i64::from(spec.firing_period_ns(MODE));
        let first_ns = self.config.first_shot_ns(truth.ordinal) + index as i64 * period_ns;
        let azimuth_cdeg = self.turn.azimuth_cdeg(firing);
        packet.blocks[self.layout.blocks(index)]
            .iter_mut()
            .for_each(|block| block.set_azimuth_cdeg(azimuth_cdeg));
        for channel in 0..spec.channels {
            let Some(&Echo {
                point,
                distance,
                reflectivity,
                range_m,
            }) = self.turn.at(firing, channel)
            else {
                continue;
            };
            let (block, record) = self.layout.place(index, channel, 0);
            packet.blocks[block].records[record] = Record {
                distance: distance.into(),
                reflectivity,
            };
            let time_ns = first_ns + i64::from(spec.channel_offset_ns(channel, MODE));
            let azimuth_rad = self.turn.beam_rad(firing, channel);
            truth.returns[block][record] = Some(ReturnTruth {
                object: point,
                class: Class::Unknown,
                range_m,
                azimuth_rad,
                time_ns,
            });
        }
    }
}

impl Iterator for Sender<'_> {
    type Item = SimulatedDatagram;

    fn next(&mut self) -> Option<SimulatedDatagram> {
        let ordinal = self.ordinal;
        if ordinal >= self.config.packets {
            return None;
        }
        self.ordinal += 1;
        let (packet, truth) = self.packet(ordinal);
        let EmitterConfig {
            model,
            address,
            start_utc_ns,
            ..
        } = self.config;
        Some(SimulatedDatagram {
            // 90 us on the way.
            arrival_ns: start_utc_ns + self.config.first_shot_ns(ordinal + 1) + 90_000,
            source: SocketAddrV4::new(address, DATA_PORT),
            destination: SocketAddrV4::new(destination(model, address), DATA_PORT),
            payload: packet.emit().to_vec(),
            truth: Some(truth),
        })
    }
}
