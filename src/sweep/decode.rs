//! Records to pixels: the inner loop.

use std::ops::RangeInclusive;

use super::layout::{BeamRow, ReturnChoice, ReturnKind, is_return};
use crate::sensor::model::Spec;
use crate::sensor::{Calibration, Model};
use crate::wire::data::{Record, ReturnMode};

/// Least range of a record that is not zero, so that no correction can turn a return into none.
const LEAST_RANGE_M: f32 = 0.001;

/// What turns records into pixels, laid out by row; chosen once for a sensor.
#[derive(Clone, Debug)]
pub struct Decoder {
    /// What the model is.
    pub spec: &'static Spec,
    /// The model.
    pub model: Model,
    /// The beams as a sweep carries them.
    pub beams: Vec<BeamRow>,
    rows: Vec<Row>,
    unit_m: f32,
    choice: ReturnChoice,
    /// Ranges that may be labelled: of two returns, one of these goes before one that is not.
    limits_m: RangeInclusive<f32>,
}

#[derive(Clone, Copy, Debug)]
struct Row {
    channel: usize,
    distance_offset_m: f32,
}

/// The pixels of one column of a plane pair.
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
        let rows = calibration
            .rows()
            .iter()
            .map(|&channel| Row { channel, distance_offset_m: calibration.beams()[channel].distance_offset_m as f32 });
        let beams = calibration.rows().iter().map(|&channel| {
            BeamRow::new(&calibration.beams()[channel], spec.channel_offset_ns(channel, ReturnMode::Strongest))
        });
        Self {
            spec,
            model,
            beams: beams.collect(),
            rows: rows.collect(),
            unit_m: calibration.distance_unit_m() as f32,
            choice,
            limits_m,
        }
    }

    /// Rows of the image.
    pub fn rows(&self) -> usize {
        self.rows.len()
    }

    /// Writes a firing into a column; returns how many returns it has.
    #[inline]
    pub fn single(&self, records: &[Record], pixels: Pixels<'_>) -> u32 {
        let mut returns = 0;
        for ((row, range), reflectivity) in self.rows.iter().zip(pixels.range).zip(pixels.reflectivity) {
            let record = &records[row.channel];
            *range = self.range_m(record, row);
            *reflectivity = record.reflectivity;
            returns += u32::from(record.distance.get() != 0);
        }
        returns
    }

    /// Writes a firing with two returns: the chosen one, the other, and which the chosen one is.
    #[inline]
    pub fn dual(
        &self,
        [last, strongest]: [&[Record]; 2],
        chosen: Pixels<'_>,
        other: Pixels<'_>,
        kind: &mut [u8],
    ) -> u32 {
        let mut returns = 0;
        let chosen = chosen.range.iter_mut().zip(chosen.reflectivity);
        let other = other.range.iter_mut().zip(other.reflectivity);
        for (((row, first), second), kind) in self.rows.iter().zip(chosen).zip(other).zip(kind) {
            let pair = [&last[row.channel], &strongest[row.channel]];
            let ranges = pair.map(|record| self.range_m(record, row));
            let is_strongest = self.chooses_strongest(ranges);
            let (one, two) = (usize::from(is_strongest), usize::from(!is_strongest));
            (*first.0, *first.1) = (ranges[one], pair[one].reflectivity);
            (*second.0, *second.1) = (ranges[two], pair[two].reflectivity);
            *kind = if is_strongest { ReturnKind::Strongest } else { ReturnKind::Last } as u8;
            returns += pair.iter().map(|record| u32::from(record.distance.get() != 0)).sum::<u32>();
        }
        returns
    }

    /// Of last and strongest; a return that is there and within the limits goes before one that is not.
    #[inline]
    fn chooses_strongest(&self, [last, strongest]: [f32; 2]) -> bool {
        let worth = |range_m: f32| match is_return(range_m) {
            true => 1 + u8::from(self.limits_m.contains(&range_m)),
            false => 0,
        };
        if worth(last) != worth(strongest) {
            return worth(strongest) > worth(last);
        }
        match self.choice {
            ReturnChoice::Nearest => strongest <= last,
            ReturnChoice::Strongest => true,
            ReturnChoice::Last => false,
        }
    }

    #[inline]
    fn range_m(&self, record: &Record, row: &Row) -> f32 {
        match record.distance.get() {
            0 => 0.0,
            distance => (f32::from(distance) * self.unit_m + row.distance_offset_m).max(LEAST_RANGE_M),
        }
    }
}

#[cfg(test)]
mod tests {
    use zerocopy::little_endian::U16;

    use super::*;
    use crate::wire::data::RECORDS;

    /// The segmented return, the other, and which the first is: metres for last and strongest in the only channel used.
    fn dual(choice: ReturnChoice, limits_m: RangeInclusive<f32>, last_m: f32, strongest_m: f32) -> (f32, f32, u8) {
        let model = Model::Vlp16;
        let decoder = Decoder::new((model, model.spec()), model.calibration().unwrap(), choice, limits_m);
        let firing = |range_m: f32, reflectivity| {
            let mut records = [Record { distance: U16::ZERO, reflectivity: 0 }; RECORDS];
            // Channel 15 looks up highest: row 0. The unit is 2 mm.
            records[15] = Record { distance: U16::new((range_m * 500.0).round() as u16), reflectivity };
            records
        };
        let (last, strongest) = (firing(last_m, 1), firing(strongest_m, 2));
        let (mut range, mut range2) = ([9.0; 16], [9.0; 16]);
        let (mut reflectivity, mut reflectivity2, mut kind) = ([9; 16], [9; 16], [9; 16]);
        let first = Pixels { range: &mut range, reflectivity: &mut reflectivity };
        let second = Pixels { range: &mut range2, reflectivity: &mut reflectivity2 };
        let returns = decoder.dual([&last[..16], &strongest[..16]], first, second, &mut kind);
        assert_eq!(returns, u32::from(last_m > 0.0) + u32::from(strongest_m > 0.0));
        let of_kind = |is_strongest: bool| if is_strongest { 2 } else { 1 };
        let is_strongest = kind[0] == ReturnKind::Strongest as u8;
        assert_eq!((reflectivity[0], reflectivity2[0]), (of_kind(is_strongest), of_kind(!is_strongest)));
        assert!(range[1..].iter().chain(&range2[1..]).all(|&range| !is_return(range)));
        // To the millimetre: the unit is no whole number of anything in binary.
        let [first_m, second_m] = [range[0], range2[0]].map(|range_m| (range_m * 1000.0).round() / 1000.0);
        (first_m, second_m, kind[0])
    }

    const ALL: RangeInclusive<f32> = 0.0..=f32::INFINITY;
    const STRONGEST: u8 = ReturnKind::Strongest as u8;
    const LAST: u8 = ReturnKind::Last as u8;

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
