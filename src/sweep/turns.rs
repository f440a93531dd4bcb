//! How far each row of a sweep points to the side of its firing: in whole columns, and as an angle.

use super::layout::BeamRow;
use super::motion::TURN;
use crate::sensor::model::Spec;
use crate::wire::data::ReturnMode;

/// A head that turns more slowly, turns a minute, would shift the rows by more columns than there is room for.
const SLOWEST_RPM: f64 = 240.0;

/// The turn of each row at the speed that the head had when a sweep began.
#[derive(Clone, Debug, Default)]
pub struct Turns {
    rows: Vec<Turn>,
    lead: usize,
    trail: usize,
    rate_rad_s: f64,
}

/// The turn of a row.
#[derive(Clone, Copy, Debug, Default)]
pub struct Turn {
    /// Columns from a pixel to its firing; see [`BeamRow::shift`].
    pub shift: i32,
    /// Sine of the angle from the firing's azimuth to the beam's.
    pub sin: f64,
    /// Its cosine.
    pub cos: f64,
}

impl Turns {
    /// Takes the turns at a speed, hundredths of a degree a nanosecond, negative when the head turns backwards.
    ///
    /// A beam points by its rotation to one side, and its shot comes a little after the first of its firing. Both together
    /// are rounded to whole columns, so that no return is further from the azimuth of its column than half of one.
    pub fn set(&mut self, beams: &[BeamRow], rate_cdeg_ns: f64, spec: &Spec, mode: ReturnMode) {
        let slowest = SLOWEST_RPM / 60.0 * TURN * 1e-9;
        let rate_rad_ns = (rate_cdeg_ns.abs().max(slowest).copysign(rate_cdeg_ns) / 100.0).to_radians();
        let pitch_rad = rate_rad_ns * f64::from(spec.firing_period_ns(mode));
        self.rate_rad_s = (rate_cdeg_ns / 100.0).to_radians() * 1e9;
        self.rows.clear();
        self.rows.extend(beams.iter().map(|beam| {
            let turn_rad = rate_rad_ns * f64::from(beam.time_offset_ns) - f64::from(beam.rotation_rad);
            let shift = if spec.shifted { (-turn_rad / pitch_rad).round() as i32 } else { 0 };
            Turn { shift, sin: turn_rad.sin(), cos: turn_rad.cos() }
        }));
        let shifts = || self.rows.iter().map(|row| row.shift);
        self.lead = shifts().max().unwrap_or(0).max(0) as usize;
        self.trail = shifts().min().unwrap_or(0).min(0).unsigned_abs() as usize;
    }

    /// By row.
    pub fn rows(&self) -> &[Turn] {
        &self.rows
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
