//! Records to pixels: the decoder of a sensor, and the choice of the return to segment.

use std::ops::RangeInclusive;

use fearless_simd::prelude::*;
use fearless_simd::{Level, f32x16, i32x16, mask32x16, u16x16};

use super::lanes::{self, BeamGroups, Decoded, Direction, LANES, PerLane, Records};
use super::row_offsets::{GroupPixels, RowOffsets};
use crate::sensor::model::Spec;
use crate::sensor::{Calibration, Model};
use crate::sweep::layout::{BeamRow, ReturnChoice, ReturnKind, SECOND_BLOCKS};
use crate::wire::data::ReturnMode;

/// Turns records into pixels; made once for each sensor.
#[derive(Clone, Debug)]
pub struct Decoder {
    /// What the model is.
    pub spec: &'static Spec,
    /// The model.
    pub model: Model,
    /// The sensor sends corrected reflectivities.
    pub is_normalised: bool,
    /// The beams of a sweep with one return, and of one with two.
    beams: [Vec<BeamRow>; 2],
    lanes: BeamGroups,
    /// Ranges depend on the azimuth.
    bends: bool,
    choice: ReturnChoice,
    /// Ranges that may be labelled: of two returns, one within these limits is preferred.
    limits_m: RangeInclusive<f32>,
    /// The best vector instructions of this machine.
    level: Level,
}

/// Where a firing is written: the pixels that it can reach, from the top of the first column on.
pub struct Pixels<'a> {
    /// Metres.
    pub range: &'a mut [f32],
    /// Calibrated reflectivity.
    pub reflectivity: &'a mut [u8],
}

/// Where a firing with two returns is written.
pub struct DualPixels<'a> {
    /// The returns to segment.
    pub chosen: Pixels<'a>,
    /// The other returns.
    pub other: Pixels<'a>,
    /// [`ReturnKind`] of the chosen ones, and [`SECOND_BLOCKS`].
    pub kind: &'a mut [u8],
}

/// Two returns of each of sixteen beams.
struct Pairs<S: Simd> {
    /// Those to segment.
    chosen: Decoded<S>,
    other: Decoded<S>,
    /// [`ReturnKind`] of the chosen ones, and [`SECOND_BLOCKS`].
    kind: i32x16<S>,
}

impl Decoder {
    /// For a model with these beams, fitted by [`Calibration::for_model`]. `choice` says which of
    /// two returns is segmented if both are within the range limits.
    pub fn new(
        model: Model,
        spec: &'static Spec,
        calibration: &Calibration,
        choice: ReturnChoice,
        limits_m: RangeInclusive<f32>,
    ) -> Self {
        let beams = [
            beam_rows(calibration, spec, ReturnMode::Strongest),
            beam_rows(calibration, spec, ReturnMode::Dual),
        ];
        let lanes = BeamGroups::new(calibration, &beams[0], spec);
        let bends = lanes.bend();
        Self {
            spec,
            model,
            is_normalised: false,
            beams,
            lanes,
            bends,
            choice,
            limits_m,
            level: Level::new(),
        }
    }

    /// Changes to another table of the same model, whose timing with one return differs.
    pub fn take_spec(&mut self, spec: &'static Spec) {
        self.spec = spec;
        for beam in &mut self.beams[0] {
            beam.time_offset_ns =
                spec.channel_offset_ns(beam.channel as usize, ReturnMode::Strongest);
        }
    }

    /// The same decoder with at most these vector instructions; it gives the same bytes.
    pub fn with_level(self, level: Level) -> Self {
        Self { level, ..self }
    }

    /// The same decoder at each level of vector instructions that this machine has, the least
    /// first, with its name; all of them give the same bytes.
    pub fn at_every_level(&self) -> Vec<(String, Self)> {
        lanes::levels()
            .into_iter()
            .map(|level| (format!("{level:?}"), self.clone().with_level(level)))
            .collect()
    }

    /// The vector instructions to use it with.
    pub fn level(&self) -> Level {
        self.level
    }

    /// Rows of the image.
    pub fn rows(&self) -> usize {
        self.beams[0].len()
    }

    /// The beams as a sweep carries them, not shifted yet.
    pub fn beams(&self, mode: ReturnMode) -> &[BeamRow] {
        &self.beams[mode.returns() - 1]
    }

    /// Writes a firing at an azimuth, radians, into its pixels; gives the number of returns. Call
    /// it in a loop that runs at [its level](Self::level): entering the level for each firing takes
    /// as long as writing it.
    #[inline(always)]
    pub fn single<S: Simd>(
        &self,
        simd: S,
        records: Records<'_>,
        azimuth_rad: f32,
        row_offsets: &RowOffsets,
        mut pixels: Pixels<'_>,
    ) -> u32 {
        let direction = self.direction(azimuth_rad);
        let mut returns = 0;
        for group in 0..self.lanes.groups() {
            let side_angles = &row_offsets.side_angles()[group];
            let decoded = self.lanes.decode(
                simd,
                group,
                records,
                direction,
                side_angles,
                self.is_normalised,
            );
            pixels.write(&row_offsets.pixels()[group], &decoded);
            returns += decoded.returns;
        }
        returns
    }

    /// Writes a firing with two returns in the same way.
    #[inline(always)]
    pub fn dual<S: Simd>(
        &self,
        simd: S,
        records: Records<'_>,
        azimuth_rad: f32,
        row_offsets: &RowOffsets,
        mut pixels: DualPixels<'_>,
    ) -> u32 {
        let direction = self.direction(azimuth_rad);
        let places = self.spec.places(ReturnMode::Dual);
        let other = records.behind(places.return_step);
        let mut returns = 0;
        for group in 0..self.lanes.groups() {
            let side_angles = &row_offsets.side_angles()[group];
            let pixel_indices = &row_offsets.pixels()[group];
            let first = self.lanes.decode(
                simd,
                group,
                records,
                direction,
                side_angles,
                self.is_normalised,
            );
            let second = self.lanes.decode(
                simd,
                group,
                other,
                direction,
                side_angles,
                self.is_normalised,
            );
            let pairs = self.choose(simd, first, second);
            pixels.chosen.write(pixel_indices, &pairs.chosen);
            pixels.other.write(pixel_indices, &pairs.other);
            write_bytes(pixels.kind, pixel_indices, pairs.kind);
            returns += first.returns + second.returns;
        }
        returns
    }

    /// Direction of the azimuth; a constant if no beam's range depends on it.
    fn direction(&self, azimuth_rad: f32) -> Direction {
        if !self.bends {
            return [0.0, 1.0];
        }
        lanes::direction(f64::from(azimuth_rad))
    }

    /// Puts the returns to segment first: for each beam, a return before none, one within the
    /// limits before one beyond, else the user's choice.
    ///
    /// A sensor with one head has the last return in the first block (VLP-16 manual, section 6.2).
    /// No manual of the HDL-64E says which block holds which: the farther return is taken as the
    /// last, the brighter as the stronger.
    #[inline(always)]
    fn choose<S: Simd>(&self, simd: S, first: Decoded<S>, second: Decoded<S>) -> Pairs<S> {
        let is_said = mask32x16::splat(simd, self.spec.banks() == 1);
        let first_is_last = is_said | first.range_m.simd_gt(second.range_m);
        let second_is_stronger = is_said | second.reflectivity.simd_gt(first.reflectivity);
        let prefers_second = match self.choice {
            ReturnChoice::Nearest => {
                let is_even = second.range_m.simd_eq(first.range_m);
                second.range_m.simd_lt(first.range_m) | is_even & second_is_stronger
            }
            ReturnChoice::Strongest => second_is_stronger,
            ReturnChoice::Last => !first_is_last,
        };
        let (first_is, first_fits) = self.worth(first.range_m);
        let (second_is, second_fits) = self.worth(second.range_m);
        let first_is_better = first_is & !second_is | first_fits & !second_fits;
        let second_is_better = second_is & !first_is | second_fits & !first_fits;
        let takes_second = second_is_better | !first_is_better & prefers_second;
        let last = i32x16::splat(simd, ReturnKind::Last as i32);
        let kind = (takes_second ^ first_is_last)
            .select(last, i32x16::splat(simd, ReturnKind::Strongest as i32));
        let in_second = i32x16::splat(simd, i32::from(SECOND_BLOCKS));
        Pairs {
            chosen: second.or(first, takes_second),
            other: first.or(second, takes_second),
            kind: kind | takes_second.select(in_second, i32x16::splat(simd, 0)),
        }
    }

    /// Whether there is a return, and whether it is within the limits.
    #[inline(always)]
    fn worth<S: Simd>(&self, range_m: f32x16<S>) -> (mask32x16<S>, mask32x16<S>) {
        // As `is_return` has it.
        let is_return = range_m.simd_gt(0.0);
        let low_m = *self.limits_m.start();
        let high_m = *self.limits_m.end();
        (
            is_return,
            is_return & range_m.simd_ge(low_m) & range_m.simd_le(high_m),
        )
    }
}

/// The beams by row, with their times in this mode.
fn beam_rows(calibration: &Calibration, spec: &Spec, mode: ReturnMode) -> Vec<BeamRow> {
    let beams = calibration.beams();
    (calibration.rows().iter())
        .map(|&channel| &beams[channel])
        .map(|beam| beam.row(spec.channel_offset_ns(beam.channel, mode)))
        .collect()
}

impl Pixels<'_> {
    #[inline(always)]
    fn write<S: Simd>(&mut self, pixels: &GroupPixels, decoded: &Decoded<S>) {
        let Some(halves) = pixels.halves else {
            self.scatter(&pixels.each, decoded);
            return;
        };
        let (first, second) = decoded.range_m.split();
        first.store_slice(half(self.range, halves[0]));
        second.store_slice(half(self.range, halves[1]));
        write_halves(self.reflectivity, halves, decoded.reflectivity);
    }

    #[inline(always)]
    fn scatter<S: Simd>(&mut self, places: &PerLane<u32>, decoded: &Decoded<S>) {
        // Equal lengths, so that one bounds check serves both.
        let count = self.range.len().min(self.reflectivity.len());
        let range = &mut self.range[..count];
        let reflectivity = &mut self.reflectivity[..count];
        let both = decoded
            .range_m
            .as_array()
            .iter()
            .zip(decoded.reflectivity.as_array());
        for (&place, (&range_m, &byte)) in places.iter().zip(both) {
            range[place as usize] = range_m;
            reflectivity[place as usize] = byte as u8;
        }
    }
}

#[inline(always)]
fn write_bytes<S: Simd>(plane: &mut [u8], pixels: &GroupPixels, bytes: i32x16<S>) {
    let Some(halves) = pixels.halves else {
        for (&place, &byte) in pixels.each.iter().zip(bytes.as_array()) {
            plane[place as usize] = byte as u8;
        }
        return;
    };
    write_halves(plane, halves, bytes);
}

#[inline(always)]
fn write_halves<S: Simd>(plane: &mut [u8], halves: [u32; 2], bytes: i32x16<S>) {
    let (first, second) = bytes.split();
    let words: u16x16<S> = first.relaxed_narrow(second).bitcast();
    let (first, second) = words.split();
    let bytes = first.relaxed_narrow(second);
    let (first, second) = bytes.as_slice().split_at(LANES / 2);
    half(plane, halves[0]).copy_from_slice(first);
    half(plane, halves[1]).copy_from_slice(second);
}

/// The pixels of half of the lanes, from the first on.
#[inline(always)]
fn half<T>(plane: &mut [T], first: u32) -> &mut [T] {
    &mut plane[first as usize..][..LANES / 2]
}

#[cfg(test)]
mod tests {
    use crate::sweep::layout::is_return;
    use fearless_simd::dispatch;
    use zerocopy::little_endian::U16;

    use super::*;
    use crate::sensor::ModelExt;
    use crate::wire::DataPacket;
    use crate::wire::data::Record;

    /// The segmented return, the other, and which the first is: metres for last and strongest in
    /// the only channel used.
    fn dual(
        choice: ReturnChoice,
        limits_m: RangeInclusive<f32>,
        last_m: f32,
        strongest_m: f32,
    ) -> (f32, f32, ReturnKind) {
        let model = Model::Vlp16;
        let decoder = Decoder::new(
            model,
            model.spec(),
            model.calibration().unwrap(),
            choice,
            limits_m,
        );
        let mut packet = DataPacket::new(0, 0, 0);
        for (block, range_m, reflectivity) in [(0, last_m, 1), (1, strongest_m, 2)] {
            // Channel 15 looks up highest: row 0. The unit is 2 mm.
            let distance = U16::new((range_m * 500.0).round() as u16);
            packet.blocks[block].records[15] = Record {
                distance,
                reflectivity,
            };
        }
        let mut row_offsets = RowOffsets::default();
        row_offsets.set(
            decoder.beams(ReturnMode::Dual),
            2e-6,
            decoder.spec,
            ReturnMode::Dual,
        );
        let (mut range, mut range2) = ([9.0; 16], [9.0; 16]);
        let (mut reflectivity, mut reflectivity2, mut kind) = ([9; 16], [9; 16], [9; 16]);
        let first = Pixels {
            range: &mut range,
            reflectivity: &mut reflectivity,
        };
        let second = Pixels {
            range: &mut range2,
            reflectivity: &mut reflectivity2,
        };
        let records = Records {
            blocks: &packet.blocks[..2],
            bank_step: 1,
            first: 0,
        };
        let pixels = DualPixels {
            chosen: first,
            other: second,
            kind: &mut kind,
        };
        let returns = dispatch!(decoder.level(), simd => decoder.dual(simd, records, 0.0, &row_offsets, pixels));
        assert_eq!(
            returns,
            u32::from(last_m > 0.0) + u32::from(strongest_m > 0.0)
        );
        let of_kind = |is_strongest: bool| if is_strongest { 2 } else { 1 };
        let is_strongest = ReturnKind::of_byte(kind[0]) == ReturnKind::Strongest;
        assert_eq!(
            kind[0] & SECOND_BLOCKS != 0,
            is_strongest,
            "the strongest is in the odd block"
        );
        assert_eq!(
            (reflectivity[0], reflectivity2[0]),
            (of_kind(is_strongest), of_kind(!is_strongest))
        );
        assert!(
            range[1..]
                .iter()
                .chain(&range2[1..])
                .all(|&range| !is_return(range))
        );
        // To the millimetre: 2 mm has no exact binary form.
        let [first_m, second_m] =
            [range[0], range2[0]].map(|range_m| (range_m * 1000.0).round() / 1000.0);
        (first_m, second_m, ReturnKind::of_byte(kind[0]))
    }

    const ALL: RangeInclusive<f32> = 0.0..=f32::INFINITY;
    const STRONGEST: ReturnKind = ReturnKind::Strongest;
    const LAST: ReturnKind = ReturnKind::Last;

    #[test]
    fn the_choice_is_the_users() {
        // Last at 30 m, strongest at 20 m, and the other way round, which rain and dust do.
        assert_eq!(
            dual(ReturnChoice::Nearest, ALL, 30.0, 20.0),
            (20.0, 30.0, STRONGEST)
        );
        assert_eq!(
            dual(ReturnChoice::Nearest, ALL, 20.0, 30.0),
            (20.0, 30.0, LAST)
        );
        assert_eq!(
            dual(ReturnChoice::Strongest, ALL, 20.0, 30.0),
            (30.0, 20.0, STRONGEST)
        );
        assert_eq!(
            dual(ReturnChoice::Last, ALL, 30.0, 20.0),
            (30.0, 20.0, LAST)
        );
    }

    #[test]
    fn a_return_goes_before_none_and_one_within_the_limits_before_one_that_is_not() {
        for choice in [
            ReturnChoice::Nearest,
            ReturnChoice::Strongest,
            ReturnChoice::Last,
        ] {
            assert_eq!(
                dual(choice, ALL, 30.0, 0.0),
                (30.0, 0.0, LAST),
                "{choice:?}"
            );
            assert_eq!(
                dual(choice, ALL, 0.0, 20.0),
                (20.0, 0.0, STRONGEST),
                "{choice:?}"
            );
            assert_eq!(
                dual(choice, 1.0..=50.0, 30.0, 0.6),
                (30.0, 0.6, LAST),
                "{choice:?}"
            );
            assert_eq!(
                dual(choice, 1.0..=50.0, 60.0, 20.0),
                (20.0, 60.0, STRONGEST),
                "{choice:?}"
            );
            assert_eq!(
                dual(choice, 1.0..=50.0, 0.6, 0.0),
                (0.6, 0.0, LAST),
                "{choice:?}"
            );
        }
    }
}
