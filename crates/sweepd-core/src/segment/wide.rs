//! Which segments are wide: their boxes say nothing of what is inside.

use super::config::Config;
use super::joining;
use super::order::Order;
use crate::sweep::layout::segment_flags;
use crate::sweep::{Segment, SweepMut};

/// Tells which segments of a sweep are wide.
#[derive(Clone, Copy, Debug)]
pub(super) struct Wide {
    /// Most columns that a segment spans without being wide.
    most_columns: usize,
}

impl Wide {
    /// Limit for a sweep whose columns are this far apart, radians.
    pub fn new(max_width_rad: f32, pitch_rad: f32) -> Self {
        // The pitch of a single column is 0.
        let most_columns = (max_width_rad / pitch_rad.max(1e-6)) as usize;
        Self { most_columns }
    }

    /// True if this many columns are more than an object may have in one part.
    pub fn spans(self, columns: usize) -> bool {
        columns > self.most_columns
    }

    /// Flags of a segment that spans this many columns.
    pub fn flags(self, segment: &Segment, columns: usize) -> u16 {
        let [min_m, max_m] = [segment.min_m, segment.max_m];
        let holds_sensor = (0..3).all(|axis| min_m[axis] <= 0.0 && max_m[axis] >= 0.0);
        match self.spans(columns) || holds_sensor {
            true => segment_flags::WIDE,
            false => 0,
        }
    }
}

/// Writes the flags of all segments of a sweep.
pub(super) fn mark(sweep: &mut SweepMut<'_>, config: &Config) {
    let image = sweep.as_ref();
    let columns = image.columns.len();
    let pitch_rad = joining::pitch_rad(image.columns, Order::new(&image, None));
    let wide = Wide::new(config.max_width_rad, pitch_rad);
    let segments = sweep.header.segments as usize;
    for segment in &mut sweep.segments[..segments] {
        let [first, last] =
            [segment.column_first, segment.column_last].map(|column| column as usize);
        let across_seam = if first > last { columns } else { 0 };
        segment.flags = wide.flags(segment, last + across_seam - first + 1);
    }
}
