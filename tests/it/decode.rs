//! The decoder against the formulas, record by record, and against itself at every level of vector
//! instructions.

use fearless_simd::dispatch;
use sweepd::assemble::Records;
use sweepd::assemble::RowOffsets;
use sweepd::assemble::{Decoder, DualPixels, Pixels};
use sweepd::files;
use sweepd::sensor::{Calibration, Model, ModelExt};
use sweepd::sweep::corrected::Corrected;
use sweepd::sweep::layout::{BeamRow, ReturnChoice, ReturnKind, SECOND_BLOCKS, is_return};
use sweepd::wire::DataPacket;
use sweepd::wire::data::{DATA_PACKET_LEN, ReturnMode};

/// 600 rpm, hundredths of a degree a nanosecond.
const RATE: f64 = 3.6e-4;
const LIMITS_M: std::ops::RangeInclusive<f32> = 2.0..=60.0;

/// A plane of each kind, with two returns; by pixel, counted as [`RowOffsets::pixels`] does.
#[derive(Clone, PartialEq)]
struct Planes {
    range_m: [Vec<f32>; 2],
    reflectivity: [Vec<u8>; 2],
    kind: Vec<u8>,
    returns: u32,
}

/// xorshift64.
struct Noise(u64);

impl Noise {
    fn next(&mut self) -> u64 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        self.0
    }

    /// A packet of anything, with many records that have no return, lie near the limit of the
    /// two-point correction, or are alike in both returns.
    fn packet(&mut self) -> DataPacket {
        let mut bytes = [0; DATA_PACKET_LEN];
        bytes.fill_with(|| (self.next() >> 32) as u8);
        let mut packet = *DataPacket::parse(&bytes).unwrap_or(&DataPacket::new(0, 0x37, 0x22));
        for block in &mut packet.blocks {
            for record in &mut block.records {
                let any = self.next();
                record.reflectivity = (any >> 8) as u8;
                record.distance = match any % 8 {
                    0 => 0,
                    1 => 1 + (any >> 32) as u16 % 1000,
                    2 => 12_450 + (any >> 32) as u16 % 140,
                    3 => u16::MAX - (any >> 32) as u16 % 3,
                    _ => (any >> 32) as u16,
                }
                .into();
            }
        }
        let (first, second) = packet.blocks.split_at_mut(2);
        for (first, second) in first.iter().zip(second) {
            for (first, second) in first.records.iter().zip(&mut second.records) {
                if self.next().is_multiple_of(4) {
                    *second = *first;
                }
            }
        }
        packet
    }
}

/// Every calibration at hand with a model that it fits.
fn calibrations() -> Vec<(String, Calibration, Model)> {
    let mut all: Vec<_> = Model::ALL
        .into_iter()
        .filter_map(|model| Some((model.to_string(), model.calibration()?.clone(), model)))
        .collect();
    if let Some(dir) = sweepd_testkit::data_dir_if_any() {
        for entry in std::fs::read_dir(dir.join("calib")).unwrap() {
            let path = entry.unwrap().path();
            let read = files::calibration(&path).unwrap();
            let fits = Model::ALL
                .into_iter()
                .find_map(|model| Some((read.clone().for_model(model).ok()?, model)));
            all.extend(
                fits.map(|(calibration, model)| (path.display().to_string(), calibration, model)),
            );
        }
    }
    all
}

fn row_offsets(decoder: &Decoder, mode: ReturnMode) -> RowOffsets {
    let mut offsets = RowOffsets::default();
    offsets.set(decoder.beams(mode), RATE, decoder.spec, mode);
    offsets
}

fn decode(decoder: &Decoder, packet: &DataPacket, azimuth_rad: f32, mode: ReturnMode) -> Planes {
    let offsets = row_offsets(decoder, mode);
    let pixels = (offsets.span() + 1) * decoder.rows();
    let mut planes = Planes {
        range_m: [vec![9.0; pixels], vec![9.0; pixels]],
        reflectivity: [vec![9; pixels], vec![9; pixels]],
        kind: vec![9; pixels],
        returns: 0,
    };
    let places = decoder.spec.places(mode);
    // The second firing of a block, where there is one.
    let records = Records {
        blocks: &packet.blocks[..places.blocks],
        bank_step: places.bank_step,
        first: (decoder.spec.firings_per_azimuth() - 1) * decoder.spec.channels,
    };
    let [range, range2] = &mut planes.range_m;
    let [reflectivity, reflectivity2] = &mut planes.reflectivity;
    let pixels = DualPixels {
        chosen: Pixels {
            range,
            reflectivity,
        },
        other: Pixels {
            range: range2,
            reflectivity: reflectivity2,
        },
        kind: &mut planes.kind,
    };
    planes.returns = dispatch!(decoder.level(), simd => match mode {
        ReturnMode::Dual => decoder.dual(simd, records, azimuth_rad, &offsets, pixels),
        _ => decoder.single(simd, records, azimuth_rad, &offsets, pixels.chosen),
    });
    planes
}

/// The distance that a record has, and its reflectivity.
fn reported(
    decoder: &Decoder,
    packet: &DataPacket,
    mode: ReturnMode,
    channel: usize,
    second: bool,
) -> (u16, u8) {
    let spec = decoder.spec;
    let places = spec.places(mode);
    let block = channel / 32 * places.bank_step + usize::from(second) * places.return_step;
    let record = packet.blocks[block].records
        [channel % 32 + (spec.firings_per_azimuth() - 1) * spec.channels];
    (record.distance.get(), record.reflectivity)
}

#[test]
fn every_level_gives_the_same_bytes() {
    let mut noise = Noise(0x9E37_79B9_7F4A_7C15);
    for (name, calibration, model) in calibrations() {
        for choice in [
            ReturnChoice::Nearest,
            ReturnChoice::Strongest,
            ReturnChoice::Last,
        ] {
            let decoder = Decoder::new(model, model.spec(), &calibration, choice, LIMITS_M);
            let levels = decoder.at_every_level();
            for _ in 0..40 {
                let (packet, azimuth_rad) = (noise.packet(), (noise.next() % 6_283) as f32 * 0.001);
                for mode in [ReturnMode::Strongest, ReturnMode::Dual] {
                    let expected = decode(&levels[0].1, &packet, azimuth_rad, mode);
                    for (level, decoder) in &levels[1..] {
                        let found = decode(decoder, &packet, azimuth_rad, mode);
                        let bits = |planes: &Planes| -> Vec<u32> {
                            planes
                                .range_m
                                .iter()
                                .flatten()
                                .map(|range_m| range_m.to_bits())
                                .collect()
                        };
                        assert!(
                            bits(&found) == bits(&expected) && found == expected,
                            "{name} {mode} at {level}"
                        );
                    }
                }
            }
        }
    }
}

#[test]
fn a_firing_is_what_the_formulas_make_of_its_records() {
    let mut noise = Noise(0x2545_F491_4F6C_DD1D);
    for (name, calibration, model) in calibrations() {
        let decoder = Decoder::new(
            model,
            model.spec(),
            &calibration,
            ReturnChoice::Nearest,
            LIMITS_M,
        );
        for mode in [ReturnMode::Strongest, ReturnMode::Dual] {
            let offsets = row_offsets(&decoder, mode);
            for _ in 0..100 {
                let (packet, azimuth_rad) = (noise.packet(), (noise.next() % 6_283) as f32 * 0.001);
                let planes = decode(&decoder, &packet, azimuth_rad, mode);
                let mut returns = 0;
                for (row, (beam, shift)) in
                    decoder.beams(mode).iter().zip(offsets.shifts()).enumerate()
                {
                    let pixel = (offsets.lead() as i32 - shift) as usize * decoder.rows() + row;
                    for second in [false, true].into_iter().take(mode.returns()) {
                        let swapped =
                            mode == ReturnMode::Dual && planes.kind[pixel] & SECOND_BLOCKS != 0;
                        let plane = usize::from(second != swapped);
                        let found = (
                            planes.range_m[plane][pixel],
                            planes.reflectivity[plane][pixel],
                        );
                        let reported =
                            reported(&decoder, &packet, mode, beam.channel as usize, second);
                        returns += u32::from(reported.0 != 0);
                        check(
                            &format!("{name} {mode} row {row}"),
                            &calibration,
                            beam,
                            azimuth_rad,
                            reported,
                            found,
                        );
                    }
                }
                assert_eq!(planes.returns, returns, "{name}");
            }
        }
    }
}

/// Whether a record became what the formulas make of it.
fn check(
    place: &str,
    calibration: &Calibration,
    beam: &BeamRow,
    azimuth_rad: f32,
    (distance, reported): (u16, u8),
    (range_m, reflectivity): (f32, u8),
) {
    if distance == 0 {
        assert_eq!((range_m, reflectivity), (0.0, reported), "{place}");
        return;
    }
    let turned = RATE * f64::from(beam.time_offset_ns) / 100.0;
    let (sin, cos) =
        (f64::from(azimuth_rad) + turned.to_radians() - f64::from(beam.rotation_rad)).sin_cos();
    let corrected = Corrected::new(beam);
    let expected_m = corrected.range_m(
        f64::from(distance) * calibration.distance_unit_m(),
        sin,
        cos,
        0.001,
    );
    let off_m = (f64::from(range_m) - f64::from(expected_m)).abs();
    assert!(
        off_m < 4e-5,
        "{place}: {range_m} m, by the formula {expected_m} m"
    );
    if !corrected.is_straight() {
        assert_eq!(
            range_m.to_bits() & 1,
            expected_m.to_bits() & 1,
            "{place}: near or far"
        );
    }
    let expected = match calibration.beams()[beam.channel as usize].intensity {
        Some(focus) => {
            let square = |share: f64| 256.0 * (1.0 - share) * (1.0 - share);
            let off = (square(focus.focal_distance_m / 131.0)
                - square(f64::from(distance) / 65_535.0))
            .abs();
            (f64::from(reported) + focus.focal_slope * off).clamp(focus.min, focus.max)
        }
        None => f64::from(reported),
    };
    assert!(
        (f64::from(reflectivity) - expected).abs() < 0.501,
        "{place}: {reflectivity}, by the formula {expected}"
    );
}

/// Which of two returns the rules choose, and what it is; in words in the docs of [`ReturnChoice`]
/// and `Decoder::dual`.
fn chosen(
    one_head: bool,
    choice: ReturnChoice,
    range_m: [f32; 2],
    reflectivity: [u8; 2],
) -> (bool, ReturnKind) {
    let first_is_last = one_head || range_m[0] > range_m[1];
    let second_is_stronger = one_head || reflectivity[1] > reflectivity[0];
    let worth = range_m.map(|range_m| {
        is_return(range_m) as u8 + (is_return(range_m) && LIMITS_M.contains(&range_m)) as u8
    });
    let takes_second = match choice {
        _ if worth[0] != worth[1] => worth[1] > worth[0],
        ReturnChoice::Nearest if range_m[0] == range_m[1] => second_is_stronger,
        ReturnChoice::Nearest => range_m[1] < range_m[0],
        ReturnChoice::Strongest => second_is_stronger,
        ReturnChoice::Last => !first_is_last,
    };
    (
        takes_second,
        if takes_second == first_is_last {
            ReturnKind::Strongest
        } else {
            ReturnKind::Last
        },
    )
}

#[test]
fn of_two_returns_the_rules_choose() {
    let mut noise = Noise(0xD1B5_4A32_D192_ED03);
    for (name, calibration, model) in calibrations() {
        for choice in [
            ReturnChoice::Nearest,
            ReturnChoice::Strongest,
            ReturnChoice::Last,
        ] {
            let decoder = Decoder::new(model, model.spec(), &calibration, choice, LIMITS_M);
            let offsets = row_offsets(&decoder, ReturnMode::Dual);
            for _ in 0..40 {
                let (packet, azimuth_rad) = (noise.packet(), (noise.next() % 6_283) as f32 * 0.001);
                let both = decode(&decoder, &packet, azimuth_rad, ReturnMode::Dual);
                for places in offsets.pixels().iter().flat_map(|group| &group.each) {
                    let at = *places as usize;
                    let takes_second = both.kind[at] & SECOND_BLOCKS != 0;
                    let order = if takes_second { [1, 0] } else { [0, 1] };
                    let range_m = order.map(|one| both.range_m[one][at]);
                    let reflectivity = order.map(|one| both.reflectivity[one][at]);
                    let expected = chosen(model.spec().banks() == 1, choice, range_m, reflectivity);
                    let found = (takes_second, ReturnKind::of_byte(both.kind[at]));
                    assert_eq!(
                        found, expected,
                        "{name} {choice:?}: {range_m:?} {reflectivity:?}"
                    );
                }
            }
        }
    }
}
