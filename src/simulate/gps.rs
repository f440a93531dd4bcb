//! The position packets of a simulated sensor: its clock, its receiver, its chips.

use std::net::Ipv4Addr;

use fastrand::Rng;

use crate::sensor::Model;
use crate::wire::HOUR_US;
use crate::wire::nmea::Rmc;
use crate::wire::position::{Board, Inertial, POSITION_PACKET_LEN, Position, Pps, Thermal};

/// Nanoseconds in an hour.
const HOUR_NS: i64 = HOUR_US as i64 * 1000;

/// What the sensor clock follows.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Clock {
    /// Nothing: it counts from wherever it was at the first shot, nanoseconds after the top of its own hour.
    Free {
        /// The clock at the first shot.
        hour_ns: i64,
    },
    /// A receiver with a pulse per second: it counts from the top of the hour of UTC.
    Gps {
        /// Where the receiver is: latitude and longitude, degrees.
        position_deg: (f64, f64),
    },
}

impl Clock {
    /// The sensor clock as packets carry it: whole microseconds since the top of the hour, truncated.
    pub fn stamp_us(&self, start_utc_ns: i64, elapsed_ns: i64) -> u32 {
        let start_ns = match self {
            Self::Free { hour_ns } => *hour_ns,
            Self::Gps { .. } => start_utc_ns,
        };
        ((start_ns + elapsed_ns).rem_euclid(HOUR_NS) / 1000) as u32
    }
}

/// The sentence for the second before is complete this long after the pulse.
const SENTENCE_DELAY_NS: i64 = 250_000_000;

/// The 512 bytes of a position packet.
pub fn position_packet(
    model: Model,
    clock: &Clock,
    start_utc_ns: i64,
    elapsed_ns: i64,
    rng: &mut Rng,
) -> [u8; POSITION_PACKET_LEN] {
    let sentence = match *clock {
        Clock::Free { .. } => None,
        Clock::Gps { position_deg } => {
            let second = (start_utc_ns + elapsed_ns - SENTENCE_DELAY_NS).div_euclid(1_000_000_000);
            let rmc = Rmc { utc_ns: second * 1_000_000_000, valid: true, position_deg: Some(position_deg) };
            Some(rmc.emit())
        }
    };
    let inertial = model == Model::Hdl32e;
    // The HDL-32E has no byte for the pulse.
    let pps = if sentence.is_some() && !inertial { Pps::Locked } else { Pps::Absent };
    Position {
        stamp_us: clock.stamp_us(start_utc_ns, elapsed_ns),
        pps,
        nmea: sentence.as_deref().map(str::trim_end),
        inertial: inertial.then(|| [chip(rng, 0), chip(rng, 819), chip(rng, 819)]),
        board: (!inertial).then_some(BOARD),
        thermal: (!inertial).then_some(Thermal { status: 0, shutdown_c: 0, power_up_c: 24 }),
    }
    .emit()
}

/// A chip at rest: noise about zero, 35 degrees, and on its second axis so many counts of gravity (819 = 1 g).
fn chip(rng: &mut Rng, gravity: i16) -> Inertial {
    Inertial { gyro: rng.i16(-3..=3), temperature: 69, accel_x: rng.i16(-2..=2), accel_y: gravity + rng.i16(-2..=2) }
}

/// A warm sensor that calibrated its converter at power-up.
const BOARD: Board = Board {
    top_c: 43,
    bottom_c: 41,
    adc_calibration_c: 24,
    adc_change_c: 19,
    adc_age_s: 1860,
    adc_reason: 1,
    adc_status: 0,
};

/// The factory address of a model.
pub fn address(model: Model) -> Ipv4Addr {
    let last = if model == Model::Hdl32e { 202 } else { 201 };
    Ipv4Addr::new(192, 168, 1, last)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// 2026-05-04 09:59:59.5 UTC (`date -u -d 2026-05-04T09:59:59 +%s`).
    const UTC_NS: i64 = 1_777_888_799_500_000_000;
    const GPS: Clock = Clock::Gps { position_deg: (50.1, 8.7) };

    #[test]
    fn the_stamp_is_truncated_and_wraps_with_the_hour() {
        assert_eq!(GPS.stamp_us(UTC_NS, 0), 3_599_500_000);
        assert_eq!(GPS.stamp_us(UTC_NS, 1_999), 3_599_500_001);
        assert_eq!(GPS.stamp_us(UTC_NS, 499_999_999), 3_599_999_999);
        assert_eq!(GPS.stamp_us(UTC_NS, 500_000_000), 0);
        assert_eq!(Clock::Free { hour_ns: 5_500 }.stamp_us(UTC_NS, 600), 6);
    }

    #[test]
    fn a_locked_puck_tells_the_second_before_last() {
        let at = |elapsed_ns| {
            let bytes = position_packet(Model::Vlp16, &GPS, UTC_NS, elapsed_ns, &mut Rng::with_seed(0));
            let position = Position::parse(&bytes).unwrap();
            assert_eq!((position.pps, position.inertial), (Pps::Locked, None));
            Rmc::parse(position.nmea.unwrap()).unwrap()
        };
        assert_eq!(at(0).utc_ns, 1_777_888_799_000_000_000);
        assert_eq!(at(700_000_000).utc_ns, 1_777_888_799_000_000_000, "0.2 s after the pulse: still the old one");
        assert_eq!(at(760_000_000).utc_ns, 1_777_888_800_000_000_000);
        assert!(at(0).valid);
    }

    #[test]
    fn an_hdl32e_has_chips_and_no_pulse() {
        let free = Clock::Free { hour_ns: 0 };
        let bytes = position_packet(Model::Hdl32e, &free, UTC_NS, 0, &mut Rng::with_seed(0));
        let position = Position::parse(&bytes).unwrap();
        assert_eq!((position.pps, position.nmea, position.board), (Pps::Absent, None, None));
        let gravity = position.inertial.unwrap()[1].accel_g()[1];
        assert!((gravity - 1.0).abs() < 0.01, "{gravity}");
    }
}
