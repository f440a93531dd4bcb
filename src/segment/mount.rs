//! How the sensor sits on the robot: its height above the ground and its tilt.

use nalgebra::{Rotation3, Vector3};

use super::Config;
use crate::sweep::SweepRef;

/// Pose of the sensor over the ground it stands on.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Mount {
    /// Height of the sensor's origin above the ground, metres; None to have it estimated from the sweeps.
    pub height_m: Option<f32>,
    /// Rotation about the sensor's x axis, nose up, radians.
    pub pitch_rad: f32,
    /// Rotation about the sensor's y axis, right side down, radians.
    pub roll_rad: f32,
}

impl Mount {
    /// The plumb line, upwards, in the axes of the sensor: it is rolled about its own y axis, then pitched about x.
    pub fn up(&self) -> Up {
        let pitch = Rotation3::from_axis_angle(&Vector3::x_axis(), f64::from(self.pitch_rad));
        let roll = Rotation3::from_axis_angle(&Vector3::y_axis(), f64::from(self.roll_rad));
        Up((pitch * roll).inverse() * Vector3::z())
    }
}

/// The direction away from the ground in the axes of the sensor, of length 1.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Up(Vector3<f64>);

impl Up {
    /// Whether the sensor stands upright.
    pub fn is_sensor_z(self) -> bool {
        self.0.x == 0.0 && self.0.y == 0.0 && self.0.z > 0.0
    }

    /// Its coordinates: right, forward, up.
    pub(super) fn axis(self) -> [f32; 3] {
        [self.0.x as f32, self.0.y as f32, self.0.z as f32]
    }

    /// Height of a point over the sensor's origin, metres.
    #[inline]
    pub fn height_m(self, point_m: [f64; 3]) -> f64 {
        self.0.dot(&Vector3::from(point_m))
    }
}

/// Sweeps that an estimate is the median of.
const SWEEPS: usize = 15;
/// Heights that are looked at, metres below the sensor: 0.1 to 6.
const BINS: usize = 60;
const BIN_M: f64 = 0.1;
/// Share of the columns whose lowest return must agree before it is taken for the ground.
const MIN_SHARE: f64 = 0.1;
/// Columns with a return below which nothing is estimated.
const MIN_COLUMNS: usize = 64;

/// Estimates the height of the sensor when nobody has told it.
///
/// The lowest return of most columns lies on the ground, the others on what stands near: their heights make a
/// histogram, in which the lowest strong mode is the ground (the robot's own roof, or a wall, is higher). Its estimate
/// is the median near that mode, and over the last sweeps, so that it does not jump; a sweep counts by its columns, since
/// a part of a turn may see little ground.
#[derive(Clone, Debug, Default)]
pub struct HeightEstimator {
    /// Sines of the beams' elevations.
    rise: Vec<f32>,
    lowest_m: Vec<f64>,
    /// Heights by the last sweeps, and columns that each is from.
    recent: [(f32, usize); SWEEPS],
    seen: usize,
}

impl HeightEstimator {
    /// Takes one more sweep.
    pub fn observe(&mut self, sweep: &SweepRef<'_>, config: &Config) {
        self.collect(sweep, config);
        let columns = self.lowest_m.len();
        if let Some(height_m) = self.one_sweep() {
            self.recent[self.seen % SWEEPS] = (height_m as f32, columns);
            self.seen += 1;
        }
    }

    /// The height of the sensor above the ground by the last sweeps, metres; None until one showed it.
    pub fn height_m(&self) -> Option<f32> {
        let mut recent = self.recent;
        let recent = &mut recent[..self.seen.min(SWEEPS)];
        recent.sort_unstable_by(|a, b| a.0.total_cmp(&b.0));
        let half = recent.iter().map(|(_, columns)| columns).sum::<usize>() / 2;
        let mut below = 0;
        let middle = recent.iter().find(|(_, columns)| {
            below += columns;
            below > half
        });
        middle.map(|(height_m, _)| *height_m)
    }

    /// Depths below the sensor of the lowest return of each column.
    fn collect(&mut self, sweep: &SweepRef<'_>, config: &Config) {
        let (rows, up) = (sweep.rows(), config.mount.up());
        let shows = |row: usize, column: usize, range_m: f32| {
            config.holds(range_m)
                && config.mask.as_ref().is_none_or(|mask| !mask.hides(row, sweep.azimuth_rad(row, column)))
        };
        super::reserve(&mut self.rise, rows);
        self.rise.extend(sweep.beams.iter().map(|beam| beam.elevation_rad.sin()));
        super::reserve(&mut self.lowest_m, sweep.columns.len());
        self.lowest_m.extend(sweep.range.chunks_exact(rows.max(1)).enumerate().filter_map(|(column, range_m)| {
            let row = (0..rows).rev().find(|&row| shows(row, column, range_m[row]))?;
            Some(match up.is_sensor_z() {
                // Without the azimuth, which most sensors need not ask for.
                true => -f64::from(range_m[row] * self.rise[row] + sweep.beams[row].vertical_offset_m),
                false => -up.height_m(sweep.point_m(row, column, range_m[row])),
            })
        }));
    }

    fn one_sweep(&mut self) -> Option<f64> {
        let columns = self.lowest_m.len();
        if columns < MIN_COLUMNS {
            return None;
        }
        let mut counts = [0_usize; BINS];
        for depth_m in &self.lowest_m {
            // Negative numbers become bin 0, which no ground is in.
            if let Some(count) = counts.get_mut((depth_m / BIN_M) as usize) {
                *count += 1;
            }
        }
        let strength = |bin: usize| counts[bin - 1] + counts[bin] + counts[(bin + 1).min(BINS - 1)];
        let strong = |bin: &usize| strength(*bin) as f64 >= MIN_SHARE * columns as f64;
        let lowest = (2..BINS).rev().find(strong)?;
        // From the first strong bin on to the top of its hill.
        let mode = (2..=lowest).rev().take_while(strong).max_by_key(|&bin| strength(bin)).unwrap_or(lowest);
        let middle_m = (mode as f64 + 0.5) * BIN_M;
        self.lowest_m.retain(|depth_m| (depth_m - middle_m).abs() < 1.5 * BIN_M);
        let half = self.lowest_m.len() / 2;
        Some(*self.lowest_m.select_nth_unstable_by(half, f64::total_cmp).1)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// By hand: a nose 10 degrees up sees a point straight ahead above its origin; a right side 10 degrees down sees a
    /// point to the right below it.
    #[test]
    fn tilt_is_nose_up_and_right_side_down() {
        let tilt = 10_f32.to_radians();
        let pitched = Mount { pitch_rad: tilt, ..Mount::default() }.up();
        assert!((pitched.height_m([0.0, 10.0, 0.0]) - 10.0 * f64::from(tilt).sin()).abs() < 1e-9);
        assert!(pitched.height_m([10.0, 0.0, 0.0]).abs() < 1e-9);
        let rolled = Mount { roll_rad: tilt, ..Mount::default() }.up();
        assert!((rolled.height_m([10.0, 0.0, 0.0]) + 10.0 * f64::from(tilt).sin()).abs() < 1e-9);
        assert!(Mount::default().up().is_sensor_z() && !rolled.is_sensor_z());
    }

    #[test]
    fn the_lowest_strong_mode_is_the_ground() {
        let sweep = |depths: &[(f64, usize)]| {
            let lowest_m = depths.iter().flat_map(|&(depth, count)| std::iter::repeat_n(depth, count)).collect();
            HeightEstimator { lowest_m, ..HeightEstimator::default() }.one_sweep()
        };
        // A roof seen often, the ground seen less, a few reflections from below it.
        assert_eq!(sweep(&[(0.55, 500), (1.73, 300), (3.1, 20)]), Some(1.73));
        assert_eq!(sweep(&[(0.55, 10), (1.73, 30)]), None, "too few columns");
        assert_eq!(sweep(&[(-1.0, 500)]), None, "nothing below the sensor");
    }
}
