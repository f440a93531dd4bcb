//! The rows of a sweep's table of beams.

use zerocopy::FromZeros;

use crate::sensor::Beam;
use crate::sweep::BeamRow;

impl Beam {
    /// The row of this beam, which fires this long after the first shot of its firing.
    pub fn row(&self, time_offset_ns: u32) -> BeamRow {
        let [near_x_m, near_y_m] = self.near_distance_offsets_m();
        let mut row = BeamRow::new_zeroed();
        row.channel = self.channel as u32;
        row.elevation_rad = self.elevation_rad as f32;
        row.rotation_rad = self.rotation_rad as f32;
        row.time_offset_ns = time_offset_ns;
        row.vertical_offset_m = self.vertical_offset_m as f32;
        row.horizontal_offset_m = self.horizontal_offset_m as f32;
        row.distance_offset_m = self.distance_offset_m as f32;
        row.distance_offset_x_m = near_x_m as f32;
        row.distance_offset_y_m = near_y_m as f32;
        row
    }
}
