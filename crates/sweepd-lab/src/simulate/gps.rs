//! The position packets of a simulated sensor: its receiver and its chips.

use fastrand::Rng;

pub use super::clock::{Clock, ClockStep, Reception};
use super::config::EmitterConfig;
use sweepd_core::sensor::Model;
use sweepd_core::wire::nmea::Rmc;
use sweepd_core::wire::position::{Board, Inertial, POSITION_PACKET_LEN, Position, Pps, Thermal};

/// The sentence for the second before is complete this long after the pulse.
const SENTENCE_DELAY_NS: i64 = 250_000_000;

/// Nanoseconds in a week.
const WEEK_NS: i64 = 7 * 86_400_000_000_000;
/// 2000-01-01, where a receiver begins that has had no satellite yet, nanoseconds since 1970.
const UNSET_NS: i64 = 946_684_800_000_000_000;

/// What is wrong with the time that a receiver gives, though it says that it is valid.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ReceiverFault {
    /// Its date is 1024 weeks too early: it counts weeks with ten bits.
    Week,
    /// It repeats the sentence with which the fault began.
    Frozen,
    /// It counts from 2000-01-01: it has had no satellite since it was switched on.
    Unset,
    /// It is so many nanoseconds ahead.
    Ahead(i64),
    /// The check sum of each second sentence is wrong.
    Garbled,
    /// It sends GGA, a sentence without a date.
    Gga,
}

impl ReceiverFault {
    /// The second of UTC that the receiver gives for this one, both in nanoseconds since 1970;
    /// `begun_ns` is the one in which the fault began.
    fn said_ns(self, utc_ns: i64, begun_ns: i64) -> i64 {
        match self {
            Self::Week => utc_ns - 1024 * WEEK_NS,
            Self::Frozen => begun_ns,
            Self::Unset => utc_ns - begun_ns + UNSET_NS,
            Self::Ahead(by_ns) => utc_ns + by_ns,
            Self::Garbled | Self::Gga => utc_ns,
        }
    }
}

/// What is wrong with the receiver at this time.
fn fault(config: &EmitterConfig, elapsed_ns: i64) -> Option<(ReceiverFault, Reception)> {
    let (_, span) = config.receiver_fault?;
    let has_begun = (span.from_ns..span.to_ns).contains(&elapsed_ns);
    config.receiver_fault.filter(|_| has_begun)
}

/// The second that the receiver gives as UTC this long after the first shot, if its sentences take
/// so long; nanoseconds since 1970.
pub(super) fn said_ns(config: &EmitterConfig, elapsed_ns: i64, delay_ns: i64) -> i64 {
    let second_at = |elapsed_ns: i64| {
        let utc_ns = config.start_utc_ns + elapsed_ns - delay_ns;
        utc_ns - utc_ns.rem_euclid(1_000_000_000)
    };
    let utc_ns = second_at(elapsed_ns);
    match fault(config, elapsed_ns) {
        Some((fault, span)) => fault.said_ns(utc_ns, second_at(span.from_ns.max(0))),
        None => utc_ns,
    }
}

/// The sentence that is complete this long after the first shot. Without a place it continues by
/// its own clock, with status `V`.
fn sentence(config: &EmitterConfig, elapsed_ns: i64, position_deg: Option<(f64, f64)>) -> String {
    let utc_ns = said_ns(config, elapsed_ns, SENTENCE_DELAY_NS);
    let text = Rmc {
        utc_ns,
        valid: position_deg.is_some(),
        position_deg,
    }
    .emit();
    match fault(config, elapsed_ns) {
        Some((ReceiverFault::Garbled, _)) if utc_ns / 1_000_000_000 % 2 == 0 => {
            text.replace("GPRMC", "GNRMC")
        }
        Some((ReceiverFault::Gga, _)) => gga(&text),
        _ => text,
    }
}

/// The GGA of an RMC: of eight satellites, 100 m above the sea.
fn gga(rmc: &str) -> String {
    let fields: Vec<&str> = rmc.split(',').collect();
    let (time, place) = (fields[1], fields[3..7].join(","));
    let body = format!("GPGGA,{time},{place},1,08,1.0,100.0,M,46.9,M,,");
    let checksum = body.bytes().fold(0, |sum, byte| sum ^ byte);
    format!("${body}*{checksum:02X}")
}

/// The 512 bytes of the position packet that a sensor sends this long after its first shot.
pub fn position_packet(
    config: &EmitterConfig,
    elapsed_ns: i64,
    rng: &mut Rng,
) -> [u8; POSITION_PACKET_LEN] {
    let EmitterConfig { model, clock, .. } = *config;
    let (pulse, place) = clock.received(elapsed_ns);
    let sentence = place.map(|position_deg| sentence(config, elapsed_ns, position_deg));
    let inertial = model == Model::Hdl32e;
    // The HDL-32E has no byte for the pulse.
    let pps = if inertial { Pps::Absent } else { pulse };
    Position {
        stamp_us: config.stamp_us(elapsed_ns),
        pps,
        nmea: sentence.as_deref().map(str::trim_end),
        inertial: inertial.then(|| chips(config, elapsed_ns, rng)),
        board: (!inertial).then_some(BOARD),
        thermal: (!inertial).then_some(Thermal {
            status: 0,
            shutdown_c: 0,
            power_up_c: 24,
        }),
    }
    .emit()
}

/// Counts of an accelerometer for 1 g.
const G_COUNTS: f64 = 819.0;

/// The chips of a sensor that turns and is not driven faster or slower: noise about zero, 35 degrees,
/// and what holds it against gravity. Real captures say that the first axes of the first two are the
/// sensor's z, and that the second ones of the last two agree; of the two axes across, the manual says
/// too little to tell which is ahead.
fn chips(config: &EmitterConfig, elapsed_ns: i64, rng: &mut Rng) -> [Inertial; 3] {
    let [right, ahead, up] = config.pose_at(elapsed_ns as f64 * 1e-9).up().into();
    [[up, ahead], [up, right], [ahead, right]].map(|axes: [f64; 2]| {
        let [accel_x, accel_y] = axes.map(|g| (g * G_COUNTS).round() as i16);
        Inertial {
            gyro: rng.i16(-3..=3),
            temperature: 69,
            accel_x: accel_x + rng.i16(-2..=2),
            accel_y: accel_y + rng.i16(-2..=2),
        }
    })
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
    use crate::simulate::head::Pose;
    use crate::simulate::shape::Vec3;
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
    }

    /// By hand: nose up by 30 degrees, a half of gravity pulls back, and head down, z feels -1 g.
    #[test]
    fn the_chips_of_an_hdl32e_feel_how_it_is_mounted() {
        let mut config = sensor(Model::Hdl32e, Clock::Free { hour_ns: 0 });
        for (pitch_deg, roll_deg, [right, ahead, up]) in [
            (0.0_f64, 0.0_f64, [0.0, 0.0, 1.0]),
            (30.0, 0.0, [0.0, 0.5, 0.866]),
            (0.0, 30.0, [-0.5, 0.0, 0.866]),
            (0.0, 180.0, [0.0, 0.0, -1.0]),
        ] {
            config.pose =
                Pose::upright(Vec3::zeros()).tilted(pitch_deg.to_radians(), roll_deg.to_radians());
            config.pose.heading_rad = 1.0;
            let bytes = position_packet(&config, 0, &mut Rng::with_seed(0));
            let chips = Position::parse(&bytes).unwrap().inertial.unwrap();
            for (chip, expected) in chips.iter().zip([[up, ahead], [up, right], [ahead, right]]) {
                for (g, expected) in chip.accel_g().into_iter().zip(expected) {
                    assert!(
                        (g - expected).abs() < 0.005,
                        "{pitch_deg} {roll_deg}: {chips:?}"
                    );
                }
            }
        }
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
