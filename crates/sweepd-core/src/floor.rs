//! The floor that a sensor sees, and so how it is mounted: its height, pitch and roll.
//!
//! ```text
//! sample    about a thousand returns of a sweep, evenly by row and column
//! search    planes through three of them each; the one that holds the most, with the least below it
//! refine    least squares over what lies near it, ever nearer
//! median    over the last sweeps, and the spread between these
//! ```
//!
//! Planes are drawn in the same order each time: the same sweeps give the same floor.

mod plane;
mod samples;

use crate::segment::Mount;
use crate::sweep::SweepRef;
use crate::sweep::layout::flags;
use plane::Plane;
use samples::Samples;

/// Sweeps that a floor is the median of.
pub const LOOKS: usize = 15;
/// After these, one sweep in so many is looked at: at 600 turns a minute, one in 10 s.
const EVERY: u64 = 100;
/// A mount that is further off the floor is wrong: the angle between the two, radians, and the share
/// of the height.
const TILT_OFF_RAD: f64 = 2.0 * std::f64::consts::PI / 180.0;
const HEIGHT_OFF: f32 = 0.1;

/// How a sensor sits over the floor that it sees. A spread is the standard deviation between sweeps,
/// by their median deviation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Floor {
    /// Height of the sensor's origin above the floor, metres.
    pub height_m: f32,
    /// Nose up, radians, as [`Mount::pitch_rad`].
    pub pitch_rad: f32,
    /// Right side down, radians, as [`Mount::roll_rad`].
    pub roll_rad: f32,
    /// Spread of the height, metres.
    pub height_spread_m: f32,
    /// Spread of the pitch, radians.
    pub pitch_spread_rad: f32,
    /// Spread of the roll, radians.
    pub roll_spread_rad: f32,
    /// Sweeps that show it.
    pub sweeps: usize,
    /// Sweeps that were looked at.
    pub looks: usize,
}

/// What is known of the floor.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Sight {
    /// No sweep was looked at.
    #[default]
    Unknown,
    /// Most sweeps show none.
    NoFloor,
    /// Most sweeps show it.
    Floor(Floor),
}

/// Finds the floor in sweeps, one after another. After it was made it allocates nothing.
#[derive(Clone, Debug)]
pub struct FloorFinder {
    mount: Mount,
    samples: Samples,
    /// Sweeps that came.
    sweeps: u64,
    /// What the last sweeps that were looked at show.
    recent: [Option<Plane>; LOOKS],
    looks: usize,
}

impl Sight {
    /// Whether people want to know of it who know of another: the first, a floor where there was
    /// none, or one that lies elsewhere.
    pub fn is_news_after(&self, known: &Self) -> bool {
        match (self, known) {
            (Self::Unknown, _) | (Self::NoFloor, Self::NoFloor | Self::Floor(_)) => false,
            (_, Self::Unknown) | (Self::Floor(_), Self::NoFloor) => true,
            (Self::Floor(now), Self::Floor(known)) => now.differs_from(&known.mount()),
        }
    }
}

impl Floor {
    /// The mount that it gives.
    pub fn mount(&self) -> Mount {
        Mount {
            height_m: Some(self.height_m),
            pitch_rad: self.pitch_rad,
            roll_rad: self.roll_rad,
        }
    }

    /// Whether a mount is off this floor by more than 2 degrees or, where it says a height, by more
    /// than a tenth of that of the floor.
    pub fn differs_from(&self, mount: &Mount) -> bool {
        let is_higher = mount
            .height_m
            .is_some_and(|height_m| (height_m - self.height_m).abs() > HEIGHT_OFF * self.height_m);
        is_higher || self.off_rad(mount) > TILT_OFF_RAD
    }

    /// The angle between the vertical of a mount and that of this floor, radians.
    pub fn off_rad(&self, mount: &Mount) -> f64 {
        let [one, other] = [mount.up(), self.mount().up()].map(|up| up.axis().map(f64::from));
        let cos: f64 = one.iter().zip(other).map(|(a, b)| a * b).sum();
        cos.clamp(-1.0, 1.0).acos()
    }
}

impl FloorFinder {
    /// Looks for a floor below a sensor that is mounted about like this: the vertical may be off by
    /// 45 degrees, the height by anything.
    pub fn new(mount: Mount) -> Self {
        Self {
            mount,
            samples: Samples::default(),
            sweeps: 0,
            recent: [None; LOOKS],
            looks: 0,
        }
    }

    /// The mount that it was made for.
    pub fn mount(&self) -> &Mount {
        &self.mount
    }

    /// Takes a sweep, of which it looks at the first [`LOOKS`] and then at one in a hundred. Returns
    /// whether it looked.
    pub fn look(&mut self, sweep: &SweepRef<'_>) -> bool {
        let is_due = self.sample(sweep);
        if is_due {
            self.fit();
        }
        is_due
    }

    /// The first half of [`FloorFinder::look`]: copies some returns of the sweep, if it is one to
    /// look at. Returns whether it did; then call [`FloorFinder::fit`]. Parts of a turn do not count.
    pub fn sample(&mut self, sweep: &SweepRef<'_>) -> bool {
        if sweep.header.has(flags::STOPPED | flags::PARTIAL) {
            return false;
        }
        let is_due = self.sweeps < LOOKS as u64 || self.sweeps.is_multiple_of(EVERY);
        self.sweeps += 1;
        if is_due {
            self.samples.take(sweep);
        }
        is_due
    }

    /// The other half: finds the floor in the returns that were copied.
    pub fn fit(&mut self) {
        let up = self.mount.up().axis().map(f64::from);
        self.recent[self.looks % LOOKS] = self.samples.floor(up.into());
        self.looks += 1;
    }

    /// Whether as many sweeps were looked at as a floor is the median of.
    pub fn is_settled(&self) -> bool {
        self.looks >= LOOKS
    }

    /// What the last sweeps show.
    pub fn sight(&self) -> Sight {
        let recent = &self.recent[..self.looks.min(LOOKS)];
        let seen = recent.iter().flatten().count();
        let Some(first) = recent.iter().flatten().next() else {
            return match self.looks {
                0 => Sight::Unknown,
                _ => Sight::NoFloor,
            };
        };
        if 2 * seen <= recent.len() {
            return Sight::NoFloor;
        }
        // Of a sensor head down, rolls lie on both sides of half a turn.
        let first_roll_rad = first.roll_rad();
        let mut values = [[0.0; LOOKS]; 3];
        for (index, plane) in recent.iter().flatten().enumerate() {
            values[0][index] = plane.height_m;
            values[1][index] = plane.pitch_rad();
            values[2][index] = wrapped(plane.roll_rad() - first_roll_rad);
        }
        let [height, pitch, roll] = values.map(|mut values| spread(&mut values[..seen]));
        Sight::Floor(Floor {
            height_m: height.0 as f32,
            pitch_rad: pitch.0 as f32,
            roll_rad: wrapped(roll.0 + first_roll_rad) as f32,
            height_spread_m: height.1 as f32,
            pitch_spread_rad: pitch.1 as f32,
            roll_spread_rad: roll.1 as f32,
            sweeps: seen,
            looks: recent.len(),
        })
    }
}

/// The median, and the standard deviation by the median deviation from it.
fn spread(values: &mut [f64]) -> (f64, f64) {
    let middle = median(values);
    for value in &mut *values {
        *value = (*value - middle).abs();
    }
    (middle, DEVIATIONS * median(values))
}

/// The standard deviation of the normal distribution in median deviations.
const DEVIATIONS: f64 = 1.4826;

/// The median; 0 of nothing.
fn median(values: &mut [f64]) -> f64 {
    let middle = values.len() / 2;
    if values.is_empty() {
        return 0.0;
    }
    *values.select_nth_unstable_by(middle, f64::total_cmp).1
}

/// An angle in the half turn to either side of 0, radians.
fn wrapped(angle_rad: f64) -> f64 {
    use std::f64::consts::{PI, TAU};
    (angle_rad + PI).rem_euclid(TAU) - PI
}

#[cfg(test)]
mod tests {
    use super::*;

    fn floor(height_m: f32, pitch_deg: f32, roll_deg: f32) -> Floor {
        Floor {
            height_m,
            pitch_rad: pitch_deg.to_radians(),
            roll_rad: roll_deg.to_radians(),
            height_spread_m: 0.0,
            pitch_spread_rad: 0.0,
            roll_spread_rad: 0.0,
            sweeps: 1,
            looks: 1,
        }
    }

    #[test]
    fn a_mount_differs_by_two_degrees_or_a_tenth_of_the_height() {
        let seen = floor(1.0, -10.0, 0.0);
        for (height_m, pitch_deg, roll_deg, differs) in [
            (Some(1.09), -8.1, 0.0, false),
            (Some(1.11), -10.0, 0.0, true),
            (Some(0.89), -10.0, 0.0, true),
            (None, -10.0, 1.9, false),
            (None, -10.0, 2.2, true),
            (None, -7.9, 0.0, true),
            (None, 0.0, 0.0, true),
        ] {
            let mount = Mount {
                height_m,
                ..floor(1.0, pitch_deg, roll_deg).mount()
            };
            assert_eq!(seen.differs_from(&mount), differs, "{mount:?}");
        }
        // Half a turn to either side is the same.
        assert!(!floor(1.0, 0.0, 179.5).differs_from(&floor(1.0, 0.0, -179.5).mount()));
    }

    /// By hand: the median of 1, 2, 4, 8, 100 is 4, the deviations from it are 0, 2, 3, 4, 96.
    #[test]
    fn one_sweep_far_off_does_not_count() {
        let (middle, deviation) = spread(&mut [100.0, 4.0, 1.0, 8.0, 2.0]);
        assert!((middle - 4.0).abs() < 1e-9 && (deviation - 4.4478).abs() < 1e-9);
    }
}
