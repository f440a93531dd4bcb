//! Records to pixels: the inner loop.

use std::ops::RangeInclusive;

use super::layout::{BeamRow, ReturnChoice, ReturnKind, is_return};
use crate::sensor::model::Spec;
use crate::sensor::{Calibration, Model};
use crate::wire::data::Record;

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
    pub fn new(model: Model, calibration: &Calibration, choice: ReturnChoice, limits_m: RangeInclusive<f32>) -> Self {
        let spec = model.spec();
        let rows = calibration
            .rows()
            .iter()
            .map(|&channel| Row { channel, distance_offset_m: calibration.beams()[channel].distance_offset_m as f32 });
        let beams = calibration
            .rows()
            .iter()
            .map(|&channel| BeamRow::new(&calibration.beams()[channel], spec.channel_offset_ns(channel)));
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
