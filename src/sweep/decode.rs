//! Records to pixels: the inner loop.

use std::ops::RangeInclusive;

use super::corrected::Corrected;
use super::layout::{BeamRow, ReturnChoice, ReturnKind, SECOND_BLOCKS, is_return};
use super::turns::Turns;
use crate::sensor::calibration::Intensity;
use crate::sensor::model::Spec;
use crate::sensor::{Beam, Calibration, Model};
use crate::wire::data::{Block, RECORDS, Record, ReturnMode};

/// Least range of a record that is not zero, so that no correction can turn a return into none.
const LEAST_RANGE_M: f32 = 0.001;
/// The distance that 16 bits of 2 mm reach, metres: what the focal distance of a beam is a share of.
const FULL_SCALE_M: f64 = 131.0;

/// What turns records into pixels, laid out by row; chosen once for a sensor.
#[derive(Clone, Debug)]
pub struct Decoder {
    /// What the model is.
    pub spec: &'static Spec,
    /// The model.
    pub model: Model,
    /// The sensor sends reflectivities that need no correction any more.
    pub is_normalised: bool,
    /// The beams as a sweep of one return carries them, and as one of two does.
    beams: [Vec<BeamRow>; 2],
    rows: Vec<Row>,
    /// Rows whose range or reflectivity takes more than an offset.
    corrected: Vec<CorrectedRow>,
    unit_m: f64,
    choice: ReturnChoice,
    /// Ranges that may be labelled: of two returns, one of these goes before one that is not.
    limits_m: RangeInclusive<f32>,
}

#[derive(Clone, Copy, Debug)]
struct Row {
    /// Block among those of one return of the firing, and record of the first firing in it.
    bank: usize,
    record: usize,
    distance_offset_m: f32,
}

#[derive(Clone, Copy, Debug)]
struct CorrectedRow {
    row: usize,
    range: Corrected,
    focus: Option<Focus>,
}

/// How much less a beam reports of what is not in its focus (HDL-64E S3 manual, appendix F).
#[derive(Clone, Copy, Debug)]
struct Focus {
    /// Where it is bright: 256 times the square of the share of the full scale that is left beyond.
    at: f32,
    slope: f32,
    min: f32,
    max: f32,
}

/// The two returns of a pixel, by blocks.
struct Pair {
    kinds: [ReturnKind; 2],
    second_is_stronger: bool,
}

/// What one return of a firing brought, or both: the blocks from its first on, and where in each its records begin.
#[derive(Clone, Copy, Debug)]
pub struct Records<'a> {
    /// The blocks.
    pub blocks: &'a [Block],
    /// First record of the firing in each.
    pub first: usize,
    /// Azimuth of the firing, radians.
    pub azimuth_rad: f64,
}

/// The pixels of one firing in a plane pair, by row.
pub struct Pixels<'a> {
    /// Metres.
    pub range: &'a mut [f32],
    /// Calibrated reflectivity.
    pub reflectivity: &'a mut [u8],
}

impl Decoder {
    /// For a model with these beams, as [`Calibration::for_model`] fitted them. Of two returns, `choice` says which is
    /// segmented, where both are within the range limits.
    pub fn new(
        (model, spec): (Model, &'static Spec),
        calibration: &Calibration,
        choice: ReturnChoice,
        limits_m: RangeInclusive<f32>,
    ) -> Self {
        let unit_m = calibration.distance_unit_m();
        let beams = || calibration.rows().iter().map(|&channel| &calibration.beams()[channel]);
        let beam_rows = |mode| -> Vec<BeamRow> {
            beams().map(|beam| BeamRow::new(beam, spec.channel_offset_ns(beam.channel, mode))).collect()
        };
        let single = beam_rows(ReturnMode::Strongest);
        let corrected = beams().zip(&single).enumerate().filter_map(|(row, (beam, of_sweep))| {
            let range = Corrected::new(of_sweep);
            (!range.is_straight() || beam.intensity.is_some()).then_some(CorrectedRow {
                row,
                range,
                focus: beam.intensity.map(Focus::new),
            })
        });
        Self {
            spec,
            model,
            is_normalised: false,
            corrected: corrected.collect(),
            beams: [beam_rows(ReturnMode::Strongest), beam_rows(ReturnMode::Dual)],
            rows: beams().map(Row::new).collect(),
            unit_m,
            choice,
            limits_m,
        }
    }

    /// Takes another table of the same model, whose timing with one return differs.
    pub fn take_spec(&mut self, spec: &'static Spec) {
        self.spec = spec;
        for beam in &mut self.beams[0] {
            beam.time_offset_ns = spec.channel_offset_ns(beam.channel as usize, ReturnMode::Strongest);
        }
    }

    /// Rows of the image.
    pub fn rows(&self) -> usize {
        self.rows.len()
    }

    /// The beams as a sweep carries them, not shifted yet.
    pub fn beams(&self, mode: ReturnMode) -> &[BeamRow] {
        &self.beams[mode.returns() - 1]
    }

    /// Writes a firing into its pixels; returns how many returns it has.
    #[inline]
    pub fn single(&self, records: Records<'_>, turns: &Turns, pixels: Pixels<'_>) -> u32 {
        let mut returns = 0;
        for ((row, range), reflectivity) in self.rows.iter().zip(&mut *pixels.range).zip(&mut *pixels.reflectivity) {
            let record = row.of(records);
            *range = self.plain_range_m(record, row);
            *reflectivity = record.reflectivity;
            returns += u32::from(record.distance.get() != 0);
        }
        if !self.corrected.is_empty() {
            self.correct(records, turns, pixels);
        }
        returns
    }

    /// Writes a firing with two returns: the chosen one, the other, and which the chosen one is.
    #[inline]
    pub fn dual(
        &self,
        records: Records<'_>,
        turns: &Turns,
        chosen: Pixels<'_>,
        other: Pixels<'_>,
        kind: &mut [u8],
    ) -> u32 {
        let (first_blocks, second_blocks) = records.blocks.split_at(self.spec.banks());
        let [first, second] = [first_blocks, second_blocks].map(|blocks| Records { blocks, ..records });
        let mut returns = self.single(first, turns, Pixels { range: chosen.range, reflectivity: chosen.reflectivity });
        returns += self.single(second, turns, Pixels { range: other.range, reflectivity: other.reflectivity });
        let chosen = chosen.range.iter_mut().zip(chosen.reflectivity);
        let other = other.range.iter_mut().zip(other.reflectivity);
        for ((first, second), kind) in chosen.zip(other).zip(kind) {
            let pair = self.pair([(*first.0, *first.1), (*second.0, *second.1)]);
            *kind = pair.kinds[0] as u8;
            if self.chooses_second([*first.0, *second.0], &pair) {
                std::mem::swap(first.0, second.0);
                std::mem::swap(first.1, second.1);
                *kind = pair.kinds[1] as u8 | SECOND_BLOCKS;
            }
        }
        returns
    }

    /// Corrects what takes more than an offset.
    fn correct(&self, records: Records<'_>, turns: &Turns, pixels: Pixels<'_>) {
        let (sin, cos) = records.azimuth_rad.sin_cos();
        for one in &self.corrected {
            let record = self.rows[one.row].of(records);
            let distance = record.distance.get();
            if distance == 0 {
                continue;
            }
            if !one.range.is_straight() {
                let turn = &turns.rows()[one.row];
                let direction = [sin * turn.cos + cos * turn.sin, cos * turn.cos - sin * turn.sin];
                pixels.range[one.row] = one.range.range_m(f64::from(distance) * self.unit_m, direction, LEAST_RANGE_M);
            }
            if let Some(focus) = one.focus.filter(|_| !self.is_normalised) {
                pixels.reflectivity[one.row] = focus.reflectivity(record.reflectivity, distance);
            }
        }
    }

    /// What the returns of the first and the second blocks are. A sensor with one head puts the last first (VLP-16 manual,
    /// section 6.2). Of an HDL-64E no manual says it: the farther is the last, the brighter the stronger.
    #[inline]
    fn pair(&self, [first, second]: [(f32, u8); 2]) -> Pair {
        const LAST_FIRST: [ReturnKind; 2] = [ReturnKind::Last, ReturnKind::Strongest];
        const LAST_SECOND: [ReturnKind; 2] = [ReturnKind::Strongest, ReturnKind::Last];
        if self.spec.banks() == 1 {
            return Pair { kinds: LAST_FIRST, second_is_stronger: true };
        }
        let kinds = if first.0 > second.0 { LAST_FIRST } else { LAST_SECOND };
        Pair { kinds, second_is_stronger: second.1 > first.1 }
    }

    /// Whether the return of the second blocks is segmented; one that is there and within the limits goes before one that
    /// is not.
    #[inline]
    fn chooses_second(&self, ranges_m: [f32; 2], pair: &Pair) -> bool {
        let worth = |range_m: f32| match is_return(range_m) {
            true => 1 + u8::from(self.limits_m.contains(&range_m)),
            false => 0,
        };
        let [first, second] = ranges_m.map(worth);
        if first != second {
            return second > first;
        }
        match self.choice {
            ReturnChoice::Nearest if ranges_m[0] == ranges_m[1] => pair.second_is_stronger,
            ReturnChoice::Nearest => ranges_m[1] < ranges_m[0],
            ReturnChoice::Strongest => pair.second_is_stronger,
            ReturnChoice::Last => pair.kinds[1] == ReturnKind::Last,
        }
    }

    #[inline]
    fn plain_range_m(&self, record: &Record, row: &Row) -> f32 {
        match record.distance.get() {
            0 => 0.0,
            distance => (f32::from(distance) * self.unit_m as f32 + row.distance_offset_m).max(LEAST_RANGE_M),
        }
    }
}

impl Row {
    fn new(beam: &Beam) -> Self {
        let (bank, record) = (beam.channel / RECORDS, beam.channel % RECORDS);
        Self { bank, record, distance_offset_m: beam.distance_offset_m as f32 }
    }

    #[inline]
    fn of<'a>(&self, records: Records<'a>) -> &'a Record {
        &records.blocks[self.bank].records[records.first + self.record]
    }
}

impl Focus {
    fn new(intensity: Intensity) -> Self {
        let beyond = 1.0 - intensity.focal_distance_m / FULL_SCALE_M;
        let [slope, min, max] = [intensity.focal_slope, intensity.min, intensity.max].map(|value| value as f32);
        Self { at: (256.0 * beyond * beyond) as f32, slope, min, max }
    }

    /// Reflectivity of what a beam measured, from what it reports.
    #[inline]
    fn reflectivity(&self, reported: u8, distance: u16) -> u8 {
        const UNITS: f32 = 1.0 / u16::MAX as f32;
        let beyond = 1.0 - f32::from(distance) * UNITS;
        let off = (self.at - 256.0 * beyond * beyond).abs();
        // To the nearest: what is clamped is never negative.
        (((f32::from(reported) + self.slope * off).clamp(self.min, self.max)) + 0.5) as u8
    }
}

#[cfg(test)]
mod tests {
    use zerocopy::little_endian::U16;

    use super::*;
    use crate::wire::DataPacket;

    /// The segmented return, the other, and which the first is: metres for last and strongest in the only channel used.
    fn dual(
        choice: ReturnChoice,
        limits_m: RangeInclusive<f32>,
        last_m: f32,
        strongest_m: f32,
    ) -> (f32, f32, ReturnKind) {
        let model = Model::Vlp16;
        let decoder = Decoder::new((model, model.spec()), model.calibration().unwrap(), choice, limits_m);
        let mut packet = DataPacket::new(0, 0, 0);
        for (block, range_m, reflectivity) in [(0, last_m, 1), (1, strongest_m, 2)] {
            // Channel 15 looks up highest: row 0. The unit is 2 mm.
            let distance = U16::new((range_m * 500.0).round() as u16);
            packet.blocks[block].records[15] = Record { distance, reflectivity };
        }
        let (mut range, mut range2) = ([9.0; 16], [9.0; 16]);
        let (mut reflectivity, mut reflectivity2, mut kind) = ([9; 16], [9; 16], [9; 16]);
        let first = Pixels { range: &mut range, reflectivity: &mut reflectivity };
        let second = Pixels { range: &mut range2, reflectivity: &mut reflectivity2 };
        let records = Records { blocks: &packet.blocks[..2], first: 0, azimuth_rad: 0.0 };
        let returns = decoder.dual(records, &Turns::default(), first, second, &mut kind);
        assert_eq!(returns, u32::from(last_m > 0.0) + u32::from(strongest_m > 0.0));
        let of_kind = |is_strongest: bool| if is_strongest { 2 } else { 1 };
        let is_strongest = ReturnKind::of_byte(kind[0]) == ReturnKind::Strongest;
        assert_eq!(kind[0] & SECOND_BLOCKS != 0, is_strongest, "the strongest is in the odd block");
        assert_eq!((reflectivity[0], reflectivity2[0]), (of_kind(is_strongest), of_kind(!is_strongest)));
        assert!(range[1..].iter().chain(&range2[1..]).all(|&range| !is_return(range)));
        // To the millimetre: the unit is no whole number of anything in binary.
        let [first_m, second_m] = [range[0], range2[0]].map(|range_m| (range_m * 1000.0).round() / 1000.0);
        (first_m, second_m, ReturnKind::of_byte(kind[0]))
    }

    const ALL: RangeInclusive<f32> = 0.0..=f32::INFINITY;
    const STRONGEST: ReturnKind = ReturnKind::Strongest;
    const LAST: ReturnKind = ReturnKind::Last;

    #[test]
    fn the_choice_is_the_users() {
        // Last at 30 m, strongest at 20 m, and the other way round, which rain and dust do.
        assert_eq!(dual(ReturnChoice::Nearest, ALL, 30.0, 20.0), (20.0, 30.0, STRONGEST));
        assert_eq!(dual(ReturnChoice::Nearest, ALL, 20.0, 30.0), (20.0, 30.0, LAST));
        assert_eq!(dual(ReturnChoice::Strongest, ALL, 20.0, 30.0), (30.0, 20.0, STRONGEST));
        assert_eq!(dual(ReturnChoice::Last, ALL, 30.0, 20.0), (30.0, 20.0, LAST));
    }

    #[test]
    fn a_return_goes_before_none_and_one_within_the_limits_before_one_that_is_not() {
        for choice in [ReturnChoice::Nearest, ReturnChoice::Strongest, ReturnChoice::Last] {
            assert_eq!(dual(choice, ALL, 30.0, 0.0), (30.0, 0.0, LAST), "{choice:?}");
            assert_eq!(dual(choice, ALL, 0.0, 20.0), (20.0, 0.0, STRONGEST), "{choice:?}");
            assert_eq!(dual(choice, 1.0..=50.0, 30.0, 0.6), (30.0, 0.6, LAST), "{choice:?}");
            assert_eq!(dual(choice, 1.0..=50.0, 60.0, 20.0), (20.0, 60.0, STRONGEST), "{choice:?}");
            assert_eq!(dual(choice, 1.0..=50.0, 0.6, 0.0), (0.6, 0.0, LAST), "{choice:?}");
        }
    }
}
