//! GPS state and health of a sensor, from position packets.

use std::net::IpAddr;

use super::report::{PositionReport, per_s};
use crate::cli::output::rounded;
use crate::gps;
use crate::text::{count_of, rate, row, utc_text};
use sweepd_core::assemble::{GpsDoubt, GpsTime, Heard};
use sweepd_core::wire::nmea::Rmc;
use sweepd_core::wire::position::Pps;
use sweepd_core::wire::{Content, Packet};

/// Statistics of the position packets from one address.
#[derive(Default)]
pub(super) struct Positions {
    packets: u64,
    first_ns: i64,
    last_ns: i64,
    locked: u64,
    pps: Option<Pps>,
    sentence: Option<String>,
    /// By valid sentences alone, with or without a pulse.
    time: GpsTime,
    /// The newest.
    doubt: Option<GpsDoubt>,
    chips_c: Option<f64>,
    board_c: Option<(i8, i8)>,
}

impl Positions {
    /// Adds a position packet; ignores a data packet.
    pub(super) fn add(&mut self, packet: &Packet<'_>) {
        let Content::Position(position, sentence) = packet.content else {
            return;
        };
        if let Some(Ok(rmc)) = sentence
            && rmc.valid
        {
            let heard = Heard::Utc(rmc.utc_ns);
            self.time.hear(heard, position.stamp_us, packet.arrival_ns);
            self.doubt = self.time.doubt().or(self.doubt);
        }
        if self.packets == 0 {
            self.first_ns = packet.arrival_ns;
        }
        self.packets += 1;
        self.last_ns = packet.arrival_ns;
        self.locked += u64::from(position.pps == Pps::Locked);
        self.pps = Some(position.pps);
        if let Some(sentence) = position.nmea {
            self.sentence = Some(sentence.to_owned());
        }
        if let Some(chips) = position.inertial {
            self.chips_c = Some(chips[0].temperature_c());
        }
        if let Some(board) = position.board {
            self.board_c = Some((board.top_c, board.bottom_c));
        }
    }

    /// What they say, for programs.
    pub(super) fn report(&self, address: IpAddr) -> PositionReport {
        let sentence = self.sentence.as_deref();
        let rmc = sentence.and_then(|sentence| Rmc::parse(sentence).ok());
        let position_deg = rmc.as_ref().and_then(|rmc| rmc.position_deg);
        let doubt = self.doubt.as_ref().and_then(gps::capture_finding);
        PositionReport {
            address,
            position_packets: self.packets,
            packets_per_s: per_s(self.packets, self.first_ns, self.last_ns),
            pps: self.pps.map(|pps| pps.to_string()),
            pps_locked_packets: self.locked,
            sentence: self.sentence.clone(),
            sentence_valid: rmc.as_ref().map(|rmc| rmc.valid),
            utc_ns: rmc.as_ref().map(|rmc| rmc.utc_ns),
            position_deg: position_deg
                .map(|deg| <[f64; 2]>::from(deg).map(|deg| rounded(deg, 1e7))),
            time_doubt: doubt.map(|doubt| doubt.to_string()),
            boards_c: self.board_c.map(<[i8; 2]>::from),
            inertial_c: self.chips_c.map(|celsius| rounded(celsius, 10.0)),
        }
    }

    /// Its rows of the text; `whose` says it when several sensors share the address.
    pub(super) fn describe(&self, text: &mut String, whose: &str) {
        let packets = count_of(self.packets, "packet");
        let rate = rate(self.packets, self.first_ns, self.last_ns);
        row(text, "position", format_args!("{packets}{rate}{whose}"));
        row(text, "GPS", self.gps());
        if let Some(finding) = self.doubt.as_ref().and_then(gps::capture_finding) {
            row(text, "GPS time", finding);
        }
        if let Some((top, bottom)) = self.board_c {
            row(
                text,
                "boards",
                format_args!("top {top} C, bottom {bottom} C"),
            );
        }
        if let Some(celsius) = self.chips_c {
            let chips = format_args!("three gyros and accelerometers, {celsius:.0} C");
            row(text, "inertial", chips);
        }
    }

    fn gps(&self) -> String {
        let pulse = match self.pps {
            Some(Pps::Locked) if self.locked < self.packets => {
                format!("PPS locked in {} of {} packets", self.locked, self.packets)
            }
            // The HDL-32E, the only model that sends the inertial chips, leaves the byte 0 in any
            // case.
            Some(Pps::Absent) if self.chips_c.is_some() => {
                "PPS not reported by this model".to_owned()
            }
            Some(pps) => format!("PPS {pps}"),
            None => "PPS unknown".to_owned(),
        };
        let Some(sentence) = &self.sentence else {
            return format!("{pulse}, no sentence");
        };
        match Rmc::parse(sentence) {
            Ok(rmc) => {
                let valid = if rmc.valid { "valid" } else { "not valid" };
                let place = rmc.position_deg.map_or(String::new(), |(lat, lon)| {
                    format!(" at {lat:.5}, {lon:.5}")
                });
                format!("{pulse}, RMC {valid}: {}{place}", utc_text(rmc.utc_ns))
            }
            Err(error) => format!(
                "{pulse}, sentence `{}`: {error}; {}",
                sentence.escape_default(),
                gps::cure_sentence(error)
            ),
        }
    }
}
