//! The position packets of a simulated sensor: its receiver and its chips.

use fastrand::Rng;

pub use super::clock::{Clock, ClockStep, Reception};
use super::config::EmitterConfig;
use sweepd_core::sensor::Model;
use sweepd_core::wire::nmea::Rmc;
use sweepd_core::wire::position::{Board, Inertial, POSITION_PACKET_LEN, Position, Pps, Thermal};

/// The sentence for the second before is complete this long after the pulse.
const SENTENCE_DELAY_NS: i64 = 250_000_000;

/// The 512 bytes of the position packet that a sensor sends this long after its first shot.
pub fn position_packet(
    config: &EmitterConfig,
    elapsed_ns: i64,
    rng: &mut Rng,
) -> [u8; POSITION_PACKET_LEN] {
    let EmitterConfig {
        model,
        clock,
        start_utc_ns,
        ..
    } = *config;
    let (pulse, place) = clock.received(elapsed_ns);
    let sentence = place.map(|position_deg| {
        let second = (start_utc_ns + elapsed_ns - SENTENCE_DELAY_NS).div_euclid(1_000_000_000);
        // Without satellites it continues by its own clock, with status `V`.
        Rmc {
            utc_ns: second * 1_000_000_000,
            valid: position_deg.is_some(),
            position_deg,
        }
        .emit()
    });
    let inertial = model == Model::Hdl32e;
    // The HDL-32E has no byte for the pulse.
    let pps = if inertial { Pps::Absent } else { pulse };
    Position {
        stamp_us: config.stamp_us(elapsed_ns),
        pps,
        nmea: sentence.as_deref().map(str::trim_end),
        inertial: inertial.then(|| [chip(rng, 0), chip(rng, 819), chip(rng, 819)]),
        board: (!inertial).then_some(BOARD),
        thermal: (!inertial).then_some(Thermal {
            status: 0,
            shutdown_c: 0,
            power_up_c: 24,
        }),
    }
    .emit()
}

/// A chip at rest: noise about zero, 35 degrees, and on its second axis this many counts of gravity
/// (819 = 1 g).
fn chip(rng: &mut Rng, gravity: i16) -> Inertial {
    Inertial {
        gyro: rng.i16(-3..=3),
        temperature: 69,
        accel_x: rng.i16(-2..=2),
        accel_y: gravity + rng.i16(-2..=2),
    }
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

#[cfg(test)]
mod tests {
    use super::*;
    use sweepd_core::wire::data::ReturnMode;

    /// 2026-05-04 09:59:59.5 UTC (`date -u -d 2026-05-04T09:59:59 +%s`).
    const UTC_NS: i64 = 1_777_888_799_500_000_000;
    const GPS: Clock = Clock::Gps {
        position_deg: (50.1, 8.7),
        reception: Reception::ALWAYS,
    };

    fn sensor(model: Model, clock: Clock) -> EmitterConfig {
        EmitterConfig {
            clock,
            start_utc_ns: UTC_NS,
            ..EmitterConfig::new(model, ReturnMode::Strongest)
        }
    }

    #[test]
    fn the_stamp_is_truncated_and_wraps_with_the_hour() {
        assert_eq!(GPS.stamp_us(UTC_NS, 0, 0), 3_599_500_000);
        assert_eq!(GPS.stamp_us(UTC_NS, 1_999, 0), 3_599_500_001);
        assert_eq!(GPS.stamp_us(UTC_NS, 499_999_999, 0), 3_599_999_999);
        assert_eq!(GPS.stamp_us(UTC_NS, 500_000_000, 0), 0);
        assert_eq!(Clock::Free { hour_ns: 5_500 }.stamp_us(UTC_NS, 600, 0), 6);
        assert_eq!(
            Clock::Free { hour_ns: 5_500 }.stamp_us(UTC_NS, 600, -7_000),
            3_599_999_999
        );
    }

    #[test]
    fn the_sentence_of_a_locked_puck_is_two_seconds_old() {
        let at = |elapsed_ns| {
            let bytes = position_packet(
                &sensor(Model::Vlp16, GPS),
                elapsed_ns,
                &mut Rng::with_seed(0),
            );
            let position = Position::parse(&bytes).unwrap();
            assert_eq!((position.pps, position.inertial), (Pps::Locked, None));
            Rmc::parse(position.nmea.unwrap()).unwrap()
        };
        assert_eq!(at(0).utc_ns, 1_777_888_799_000_000_000);
        assert_eq!(
            at(700_000_000).utc_ns,
            1_777_888_799_000_000_000,
            "0.2 s after the pulse: still the old one"
        );
        assert_eq!(at(760_000_000).utc_ns, 1_777_888_800_000_000_000);
        assert!(at(0).valid);
    }

    #[test]
    fn an_hdl32e_has_chips_and_no_pulse() {
        let free = Clock::Free { hour_ns: 0 };
        let bytes = position_packet(&sensor(Model::Hdl32e, free), 0, &mut Rng::with_seed(0));
        let position = Position::parse(&bytes).unwrap();
        assert_eq!(
            (position.pps, position.nmea, position.board),
            (Pps::Absent, None, None)
        );
        let gravity = position.inertial.unwrap()[1].accel_g()[1];
        assert!((gravity - 1.0).abs() < 0.01, "{gravity}");
    }

    #[test]
    fn a_receiver_that_comes_and_goes_is_synchronized_locked_and_absent() {
        const SECOND_NS: i64 = 1_000_000_000;
        let reception = Reception {
            from_ns: 3 * SECOND_NS,
            to_ns: 9 * SECOND_NS,
        };
        let clock = Clock::Gps {
            position_deg: (50.1, 8.7),
            reception,
        };
        let at = |second: i64| {
            let bytes = position_packet(
                &sensor(Model::Vlp16, clock),
                second * SECOND_NS,
                &mut Rng::with_seed(0),
            );
            let position = Position::parse(&bytes).unwrap();
            (
                position.pps,
                position.nmea.map(|text| Rmc::parse(text).unwrap().valid),
                position.stamp_us,
            )
        };
        assert_eq!(at(2), (Pps::Absent, None, 2_000_000));
        assert_eq!(at(4), (Pps::Synchronizing, Some(true), 4_000_000));
        assert_eq!(
            at(5),
            (Pps::Locked, Some(true), 4_500_000),
            "from its own hour to that of UTC, 09:59:59.5 before"
        );
        assert_eq!(
            at(9),
            (Pps::Absent, Some(false), 8_500_000),
            "it goes on from there"
        );
        let too_short = Reception {
            to_ns: 4 * SECOND_NS,
            ..reception
        };
        assert!(!too_short.follows_utc(10 * SECOND_NS));
    }
}
