//! A generated unit of the HDL-64E, with the calibration of its beams.
//!
//! Its values are similar to those of real units, and exactly representable in the status, so that
//! a receiver that reads the calibration from there has it exactly.

use std::ops::RangeInclusive;

use fastrand::Rng;
use zerocopy::FromZeros;
use zerocopy::little_endian::I16;

use sweepd_core::sensor::{Calibration, stream};
use sweepd_core::wire::hdl64::{BEAMS, BeamRecord, Dump, Series};

/// The lasers of a head from the highest down; those of the lower head are these plus 32.
const TOP_DOWN: [usize; HEAD] = [
    29, 28, 25, 24, 3, 2, 31, 30, 27, 26, 21, 20, 17, 16, 13, 12, 23, 22, 19, 18, 15, 14, 9, 8, 5,
    4, 1, 0, 11, 10, 7, 6,
];
/// Lasers of a head.
const HEAD: usize = BEAMS / 2;

/// The calibration of a unit; each seed makes another one.
pub fn unit(seed: u64) -> Calibration {
    let mut rng = Rng::with_seed(seed ^ 0x64E);
    let mut records = [BeamRecord::new_zeroed(); BEAMS];
    for (place, laser) in TOP_DOWN.into_iter().enumerate() {
        records[laser] = record(laser, 200 - 34 * place as i16, 193..=217, &mut rng);
        records[laser + HEAD] = record(laser + HEAD, -890 - 51 * place as i16, 105..=163, &mut rng);
    }
    stream::calibration(&Dump::new(Series::S3, &records))
        .expect("tested for every series of numbers")
}

/// A laser at about this elevation, hundredths of a degree, at a height within these limits,
/// millimetres.
fn record(
    id: usize,
    elevation_cdeg: i16,
    height_mm: RangeInclusive<i16>,
    rng: &mut Rng,
) -> BeamRecord {
    // Four columns of lasers to each side of the head's middle, odd ones to the right.
    let column = (id / 2 % 4) as i16;
    let is_odd = id % 2 == 1;
    let rotation_cdeg = if is_odd {
        250 + 230 * column
    } else {
        -200 - 200 * column
    };
    let distance_mm = rng.i16(1_120..=1_580);
    let aside_mm = if is_odd { 26 } else { -26 };
    BeamRecord {
        id: id as u8,
        elevation_cdeg: I16::new(elevation_cdeg + rng.i16(-8..=8)),
        rotation_cdeg: I16::new(rotation_cdeg + rng.i16(-40..=40)),
        distance_mm: I16::new(distance_mm),
        distance_x_mm: I16::new(distance_mm + rng.i16(-100..=100)),
        distance_y_mm: I16::new(distance_mm + rng.i16(-100..=100)),
        vertical_offset_mm: I16::new(rng.i16(height_mm)),
        horizontal_offset_mm: I16::new(aside_mm),
        focal_distance_mm: I16::new(rng.i16(4_000..=24_000)),
        focal_slope_tenths: I16::new(rng.i16(9..=20)),
        min_intensity: rng.u8(0..=30),
        max_intensity: 255,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_unit_is_one_that_could_be_and_its_stream_says_it_all() {
        for seed in 0..200 {
            let calibration = unit(seed);
            let records = stream::records(&calibration).unwrap();
            let again = stream::calibration(&Dump::new(Series::S21, &records)).unwrap();
            assert_eq!(again, calibration);
            let degrees = |radians: f64| radians.to_degrees();
            let (beams, rows) = (calibration.beams(), calibration.rows());
            let elevations: Vec<f64> = rows
                .iter()
                .map(|&row| degrees(beams[row].elevation_rad))
                .collect();
            assert!(
                elevations
                    .windows(2)
                    .all(|two| (0.1..0.8).contains(&(two[0] - two[1]))),
                "{elevations:?}"
            );
            assert!(
                (1.9..=2.1).contains(&elevations[0]) && (-24.9..-24.5).contains(&elevations[63])
            );
            assert!(rows[..32].iter().all(|&row| row < 32));
            let rotations = beams.iter().map(|beam| degrees(beam.rotation_rad));
            let [least, most] = [
                rotations.clone().fold(0.0, f64::min),
                rotations.fold(0.0, f64::max),
            ];
            assert!(
                (-8.8..-7.5).contains(&least) && (9.0..10.0).contains(&most),
                "{least} {most}"
            );
            assert!(beams.iter().all(
                |beam| (1.1..1.6).contains(&beam.distance_offset_m) && beam.intensity.is_some()
            ));
        }
        assert_ne!(unit(1), unit(2));
    }
}
