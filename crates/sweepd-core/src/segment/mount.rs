//! How the sensor sits on the robot: its height above the ground and its tilt.

use std::f32::consts::FRAC_1_SQRT_2;

use nalgebra::{Rotation3, Vector3};

/// Pose of the sensor over the ground it stands on.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Mount {
    /// Height of the sensor's origin above the ground, metres; None to have it estimated from the
    /// sweeps.
    pub height_m: Option<f32>,
    /// Rotation about the sensor's x axis, nose up, radians.
    pub pitch_rad: f32,
    /// Rotation about the sensor's y axis, right side down, radians.
    pub roll_rad: f32,
}

impl Mount {
    /// The plumb line, upwards, in the axes of the sensor: it is rolled about its own y axis, then
    /// pitched about x.
    pub fn up(&self) -> Up {
        let pitch = Rotation3::from_axis_angle(&Vector3::x_axis(), f64::from(self.pitch_rad));
        let roll = Rotation3::from_axis_angle(&Vector3::y_axis(), f64::from(self.roll_rad));
        Up((pitch * roll).inverse() * Vector3::z())
    }

    /// Which side of the sensor is up.
    pub fn stance(&self) -> Stance {
        let [_, _, up] = self.up().axis();
        if up >= COS_MAX_TILT {
            Stance::Upright
        } else if up <= -COS_MAX_TILT {
            Stance::HeadDown
        } else {
            Stance::OnSide
        }
    }

    /// What people are to be told of this mount, if anything.
    pub fn warning(&self) -> Option<String> {
        if self.stance() != Stance::OnSide {
            return None;
        }
        let [roll, pitch] = [self.roll_rad, self.pitch_rad].map(f32::to_degrees);
        Some(format!(
            "roll {roll:.1} and pitch {pitch:.1} degrees tilt the sensor by more than 45 degrees from both upright and head \
             down: no return is labelled ground, and what stands on a floor is joined by it"
        ))
    }
}

/// Cosine of the largest tilt at which ground is found, 45 degrees.
const COS_MAX_TILT: f32 = FRAC_1_SQRT_2;

/// Which side of the sensor is up.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Stance {
    /// Its top, within 45 degrees.
    #[default]
    Upright,
    /// Its foot, within 45 degrees.
    HeadDown,
    /// Neither: the rows of a column do not lie above each other, and no return is ground.
    OnSide,
}

/// The direction away from the ground in the axes of the sensor, of length 1.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Up(Vector3<f64>);

impl Up {
    /// Its coordinates: right, forward, up.
    pub(crate) fn axis(self) -> [f32; 3] {
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
const BIN_M: f32 = 0.1;
/// Share of the columns whose lowest return must agree before it is taken for the ground.
const MIN_SHARE: f64 = 0.1;
/// Columns with a return below which nothing is estimated.
const MIN_COLUMNS: usize = 64;

/// Estimates the height of the sensor when it is not configured.
///
/// The lowest return of most columns lies on the ground, the others on what stands near: their
/// heights make a histogram, in which the lowest strong mode is the ground (the robot's own roof,
/// or a wall, is higher). Its estimate is the median near that mode, and over the last sweeps, so
/// that it does not jump; a sweep counts by its columns, since a part of a turn may see little
/// ground.
#[derive(Clone, Debug, Default)]
pub struct HeightEstimator {
    /// Depths near that of the ground.
    near_m: Vec<f32>,
    /// Heights by the last sweeps, and columns that each is from.
    recent: [(f32, usize); SWEEPS],
    seen: usize,
}

impl HeightEstimator {
    /// Takes room for sweeps of up to this many columns.
    pub fn reserve(&mut self, columns: usize) {
        super::order::reserve(&mut self.near_m, columns);
    }

    /// Takes one more sweep: how deep below the sensor the lowest return of each column lies,
    /// metres; infinite where there is none.
    pub fn observe(&mut self, depths_m: &[f32]) {
        let columns = depths_m
            .iter()
            .filter(|depth_m| depth_m.is_finite())
            .count();
        if let Some(height_m) = self.one_sweep(depths_m, columns) {
            self.recent[self.seen % SWEEPS] = (height_m, columns);
            self.seen += 1;
        }
    }

    /// The height of the sensor above the ground by the last sweeps, metres; None until one showed
    /// it.
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

    /// The height by one sweep, of which this many columns have a return.
    fn one_sweep(&mut self, depths_m: &[f32], columns: usize) -> Option<f32> {
        if columns < MIN_COLUMNS {
            return None;
        }
        // By way of 32 bits, which takes less time: what is no number, or hardly negative, becomes
        // bin 0, which no ground is in; what is more negative becomes none that there is.
        let bin_of = |depth_m: f32| (depth_m / BIN_M) as i32 as usize;
        let mut counts = [0_usize; BINS];
        for &depth_m in depths_m {
            if let Some(count) = counts.get_mut(bin_of(depth_m)) {
                *count += 1;
            }
        }
        let strength = |bin: usize| counts[bin - 1] + counts[bin] + counts[(bin + 1).min(BINS - 1)];
        let strong = |bin: &usize| strength(*bin) as f64 >= MIN_SHARE * columns as f64;
        let lowest = (2..BINS).rev().find(strong)?;
        // From the first strong bin on to the top of its hill.
        let mode = (2..=lowest)
            .rev()
            .take_while(strong)
            .max_by_key(|&bin| strength(bin))
            .unwrap_or(lowest);
        self.near_m.clear();
        // By bins, as they were counted: so there are some.
        self.near_m.extend(
            depths_m
                .iter()
                .filter(|depth_m| bin_of(**depth_m).abs_diff(mode) <= 1),
        );
        let half = self.near_m.len() / 2;
        Some(*self.near_m.select_nth_unstable_by(half, f32::total_cmp).1)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// By hand: a nose 10 degrees up sees a point straight ahead above its origin; a right side 10
    /// degrees down sees a point to the right below it.
    #[test]
    fn tilt_is_nose_up_and_right_side_down() {
        let tilt = 10_f32.to_radians();
        let pitched = Mount {
            pitch_rad: tilt,
            ..Mount::default()
        }
        .up();
        assert!((pitched.height_m([0.0, 10.0, 0.0]) - 10.0 * f64::from(tilt).sin()).abs() < 1e-9);
        assert!(pitched.height_m([10.0, 0.0, 0.0]).abs() < 1e-9);
        let rolled = Mount {
            roll_rad: tilt,
            ..Mount::default()
        }
        .up();
        assert!((rolled.height_m([10.0, 0.0, 0.0]) + 10.0 * f64::from(tilt).sin()).abs() < 1e-9);
        assert_eq!(Mount::default().up().axis(), [0.0, 0.0, 1.0]);
    }

    #[test]
    fn a_sensor_stands_up_to_45_degrees_on_its_foot_and_on_its_head() {
        let of = |pitch_deg: f64, roll_deg: f64| {
            let mount = Mount {
                pitch_rad: pitch_deg.to_radians() as f32,
                roll_rad: roll_deg.to_radians() as f32,
                ..Mount::default()
            };
            let stance = mount.stance();
            assert_eq!(mount.warning().is_some(), stance == Stance::OnSide);
            stance
        };
        for tilt_deg in [0.0, 20.0, 45.0, -45.0] {
            assert_eq!(of(tilt_deg, 0.0), Stance::Upright);
            assert_eq!(of(0.0, tilt_deg), Stance::Upright);
            for roll_deg in [180.0, -180.0] {
                assert_eq!(of(tilt_deg, roll_deg), Stance::HeadDown);
            }
            assert_eq!(of(0.0, 180.0 - tilt_deg), Stance::HeadDown);
        }
        // 40 degrees twice are 54 in all.
        for (pitch_deg, roll_deg) in [(45.1, 0.0), (90.0, 0.0), (0.0, -90.0), (40.0, 40.0)] {
            assert_eq!(of(pitch_deg, roll_deg), Stance::OnSide);
            assert_eq!(of(pitch_deg, roll_deg + 180.0), Stance::OnSide);
        }
        assert_eq!(of(f64::NAN, 0.0), Stance::OnSide);
    }

    #[test]
    fn the_lowest_strong_mode_is_the_ground() {
        let sweep = |depths: &[(f32, usize)]| {
            let depths_m: Vec<f32> = depths
                .iter()
                .flat_map(|&(depth, count)| std::iter::repeat_n(depth, count))
                .collect();
            let mut estimator = HeightEstimator::default();
            estimator.observe(&depths_m);
            estimator.height_m()
        };
        // A roof seen often, the ground seen less, a few reflections from below it.
        assert_eq!(sweep(&[(0.55, 500), (1.73, 300), (3.1, 20)]), Some(1.73));
        assert_eq!(sweep(&[(0.55, 10), (1.73, 30)]), None, "too few columns");
        assert_eq!(
            sweep(&[(1.73, 63), (f32::INFINITY, 1_000)]),
            None,
            "a column without a return is none"
        );
        assert_eq!(sweep(&[(-1.0, 500)]), None, "nothing below the sensor");
        assert_eq!(sweep(&[(f32::NAN, 500), (-0.0, 500)]), None);
    }

    #[test]
    fn depths_on_the_edges_of_bins_are_told_like_any_others() {
        for edge in 1..=BINS + 1 {
            let depth_m = edge as f32 * BIN_M;
            for depth_m in [depth_m.next_down(), depth_m, depth_m.next_up()] {
                let mut estimator = HeightEstimator::default();
                estimator.observe(&[depth_m; 500]);
                // Beyond the last bin nothing is looked for, nor in the first.
                let is_seen = (0.11..5.99).contains(&depth_m);
                assert!(
                    !is_seen || estimator.height_m() == Some(depth_m),
                    "{depth_m}: {:?}",
                    estimator.height_m()
                );
                assert!(
                    estimator
                        .height_m()
                        .is_none_or(|height_m| height_m == depth_m),
                    "{depth_m}"
                );
            }
        }
    }
}
