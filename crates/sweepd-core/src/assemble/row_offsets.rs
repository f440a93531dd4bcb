//! How far each row of a sweep points to the side of its firing: in whole columns, and as an angle.

use super::lanes::{self, LANES, PerLane, SideAngles};
use super::motion::TURN;
use crate::sensor::model::Spec;
use crate::sweep::layout::BeamRow;
use crate::wire::data::ReturnMode;

/// Least speed for which offsets are computed, turns a minute: a slower head would shift rows by
/// more columns than there is room for.
const SLOWEST_RPM: f64 = 240.0;

/// Offset of each row at the speed that the head had when a sweep began.
#[derive(Clone, Debug, Default)]
pub struct RowOffsets {
    /// Columns from a pixel to its firing, by row; see [`BeamRow::shift`].
    shifts: Vec<i32>,
    /// In groups.
    side_angles: Vec<SideAngles>,
    /// In groups.
    pixels: Vec<GroupPixels>,
    lead: usize,
    trail: usize,
    rate_rad_s: f64,
}

/// The pixels of a group of beams, as indices from the first pixel that a firing can have on.
#[derive(Clone, Copy, Debug, Default)]
pub struct GroupPixels {
    /// By lane.
    pub each: PerLane<u32>,
    /// The first pixel of each half of the lanes, if a half has eight pixels in a row.
    pub halves: Option<[u32; 2]>,
}

impl GroupPixels {
    fn find_halves(&mut self) {
        const HALF: usize = LANES / 2;
        let first = [self.each[0], self.each[HALF]];
        let mut places = self.each.iter().enumerate();
        let is_so = places.all(|(lane, &pixel)| pixel == first[lane / HALF] + (lane % HALF) as u32);
        self.halves = is_so.then_some(first);
    }
}

impl RowOffsets {
    /// Computes the offsets at a speed, hundredths of a degree a nanosecond, negative when the head
    /// turns backwards.
    ///
    /// A beam points to one side by its rotation, and fires a little after the first shot of its
    /// firing. The sum of both is rounded to whole columns, so that each return is within half a
    /// column of its column's azimuth.
    pub fn set(&mut self, beams: &[BeamRow], rate_cdeg_ns: f64, spec: &Spec, mode: ReturnMode) {
        let slowest = SLOWEST_RPM / 60.0 * TURN * 1e-9;
        let rate_rad_ns =
            (rate_cdeg_ns.abs().max(slowest).copysign(rate_cdeg_ns) / 100.0).to_radians();
        let pitch_rad = rate_rad_ns * f64::from(spec.firing_period_ns(mode));
        self.rate_rad_s = (rate_cdeg_ns / 100.0).to_radians() * 1e9;
        self.shifts.clear();
        self.shifts
            .extend(beams.iter().map(|beam| match spec.shifted {
                true => (-side_angle_rad(beam, rate_rad_ns) / pitch_rad).round() as i32,
                false => 0,
            }));
        let most = self.shifts.iter().copied().fold(0, i32::max);
        let least = self.shifts.iter().copied().fold(0, i32::min);
        self.lead = most as usize;
        self.trail = least.unsigned_abs() as usize;
        self.side_angles
            .resize(beams.len().div_ceil(LANES), SideAngles::default());
        self.pixels
            .resize(beams.len().div_ceil(LANES), GroupPixels::default());
        for (row, beam) in beams.iter().enumerate() {
            let (group, lane) = lanes::place(beam.channel, spec);
            let (sin, cos) = side_angle_rad(beam, rate_rad_ns).sin_cos();
            self.side_angles[group].sin[lane] = sin as f32;
            self.side_angles[group].cos[lane] = cos as f32;
            let column = self.lead as i32 - self.shifts[row];
            self.pixels[group].each[lane] = column as u32 * beams.len() as u32 + row as u32;
        }
        self.pixels.iter_mut().for_each(GroupPixels::find_halves);
    }

    /// Columns from a pixel to its firing, by row.
    pub fn shifts(&self) -> &[i32] {
        &self.shifts
    }

    /// Angles of the beams to the side of their firing, in groups.
    pub fn side_angles(&self) -> &[SideAngles] {
        &self.side_angles
    }

    /// Indices of the pixels of a firing, in groups, counted from the top of the column that is
    /// [`RowOffsets::lead`] before its own.
    pub fn pixels(&self) -> &[GroupPixels] {
        &self.pixels
    }

    /// Columns that lie before that of a firing and can hold a pixel of it.
    pub fn lead(&self) -> usize {
        self.lead
    }

    /// Columns that lie behind that of a firing and can hold a pixel of it.
    pub fn trail(&self) -> usize {
        self.trail
    }

    /// The speed, radians a second.
    pub fn rate_rad_s(&self) -> f64 {
        self.rate_rad_s
    }

    /// Columns between two firings that share none.
    pub fn span(&self) -> usize {
        self.lead + self.trail
    }
}

/// How far a beam points to the side of its firing when it fires, clockwise from above.
fn side_angle_rad(beam: &BeamRow, rate_rad_ns: f64) -> f64 {
    rate_rad_ns * f64::from(beam.time_offset_ns) - f64::from(beam.rotation_rad)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::assemble::Decoder;
    use crate::sensor::{Model, ModelExt};
    use crate::sweep::layout::ReturnChoice;

    #[test]
    fn rows_that_are_not_shifted_are_halves() {
        for model in Model::ALL {
            let (spec, mode) = (model.spec(), ReturnMode::Strongest);
            let Some(calibration) = model.calibration() else {
                continue;
            };
            let limits_m = 0.0..=100.0;
            let decoder = Decoder::new(model, spec, calibration, ReturnChoice::Nearest, limits_m);
            let mut offsets = RowOffsets::default();
            offsets.set(decoder.beams(mode), 3.6e-4, spec, mode);
            for group in offsets.pixels() {
                assert!(spec.shifted || group.halves.is_some(), "{model}");
            }
        }
    }
}
