//! Where the box should stand: the returns there, and the beams that pass.
//!
//! In the frame of the box, x is to the right of its direction, y ahead along it, both from the
//! robot's origin, and z up from the floor.

use super::Obstacle;
use sweepd_core::floor::Sight;
use sweepd_core::sweep::layout::LABEL_GROUND;
use sweepd_core::sweep::{Header, Pose, Return, SweepRef, Zone};

/// How far the front may be from where it should be, and what stops a robot above the top, metres.
const OFF_M: f64 = 0.25;
/// Returns lower than this over the floor may be the floor, metres.
const LEAST_UP_M: f64 = 0.03;
/// From this height over the floor on, `stop` looks, metres.
const STOP_UP_M: f64 = 0.05;
/// Returns on the box lie this much above its top at most, metres.
const OVER_M: f64 = 0.05;
/// Fewest returns that are taken for a box.
const MIN_STRIKES: usize = 3;
/// What is in one object with the box may be so far beside, before, behind and above it, metres.
const BESIDE_M: f64 = 0.3;
const BEHIND_M: f64 = 0.5;

/// The way from the sensor's frame to that of the box: over the floor that is seen, or that of the
/// mount.
pub(super) fn frame(header: &Header, sight: Sight, obstacle: &Obstacle) -> Pose {
    let (height_m, pitch_rad, roll_rad) = match sight {
        Sight::Floor(floor) => (floor.height_m, floor.pitch_rad, floor.roll_rad),
        _ => (header.height_m, header.pitch_rad, header.roll_rad),
    };
    let [x_m, y_m, _] = header.position_m;
    let sensor = Pose::mounted([x_m, y_m, height_m], [header.yaw_rad, pitch_rad, roll_rad]);
    obstacle.turned(sensor)
}

impl Obstacle {
    /// How far the front may be from where it should be, metres.
    fn off_m(&self) -> f64 {
        OFF_M.min(self.distance_m / 2.0)
    }

    /// Turns the frame that a pose is in, so that the box is straight ahead.
    pub(super) fn turned(&self, pose: Pose) -> Pose {
        let azimuth_rad = self.azimuth_deg.to_radians() as f32;
        Pose::mounted([0.0; 3], [azimuth_rad, 0.0, 0.0]) * pose
    }

    /// Returns the part of the way of `stop` in which the front of the box should be: what is farther
    /// back stands behind it. Its z counts from the floor.
    pub(super) fn zone(&self) -> Zone {
        let (half_m, off_m) = (self.width_m / 2.0, self.off_m());
        let least_m = [-half_m, self.distance_m - off_m, STOP_UP_M];
        let most_m = [half_m, self.distance_m + off_m, self.height_m + OFF_M];
        Zone::new(least_m, most_m).expect("sizes are at least 0")
    }

    /// Whether something there may be the box: as wide and as deep as it is wide, with some play.
    pub(super) fn holds(&self, [right_m, ahead_m, up_m]: [f64; 3]) -> bool {
        let off_m = self.off_m();
        right_m.abs() <= self.width_m / 2.0
            && (-off_m..=off_m + self.width_m).contains(&(ahead_m - self.distance_m))
            && (LEAST_UP_M..=self.height_m + OVER_M).contains(&up_m)
    }

    /// The returns on the box, of those of a sweep; none where they are too few for a box.
    pub(super) fn strikes(&self, returns: &[Return]) -> Vec<Return> {
        let is_held = |one: &&Return| self.holds(one.point_m);
        let mut strikes: Vec<Return> = returns.iter().filter(is_held).copied().collect();
        let front_m = front_m(&strikes).unwrap_or_default();
        // What is seen farther back stands behind the place.
        let most_m = match front_m <= self.distance_m + self.off_m() {
            true => front_m + self.width_m,
            false => 0.0,
        };
        strikes.retain(|one| one.point_m[1] <= most_m);
        if strikes.len() < MIN_STRIKES {
            strikes.clear();
        }
        strikes
    }

    /// Whether a return is so near a box with this front that it may be part of it.
    pub(super) fn is_beside(&self, one: &Return, front_m: f64) -> bool {
        let [right_m, ahead_m, up_m] = one.point_m;
        right_m.abs() <= self.width_m / 2.0 + BESIDE_M
            && (-BESIDE_M..=self.width_m + BEHIND_M).contains(&(ahead_m - front_m))
            && up_m <= self.height_m + BESIDE_M
    }

    /// The return nearest to the front of the box that is no ground and about as high as it is.
    pub(super) fn nearest(&self, returns: &[Return]) -> Option<Return> {
        let is_candidate = |one: &&Return| {
            one.label != LABEL_GROUND
                && (OVER_M..=self.height_m + BESIDE_M).contains(&one.point_m[2])
        };
        let away_m = |one: &Return| one.point_m[0].hypot(one.point_m[1] - self.distance_m);
        let candidates = returns.iter().filter(is_candidate);
        let nearest = candidates.min_by(|a, b| away_m(a).total_cmp(&away_m(b)));
        nearest.copied()
    }
}

/// How far ahead the front of something is: the nearest tenth of its returns is before it.
pub(super) fn front_m(returns: &[Return]) -> Option<f64> {
    let ahead_m: Vec<f64> = returns.iter().map(|one| one.point_m[1]).collect();
    quantile(&ahead_m, 0.1)
}

pub(super) fn median(values: &[f64]) -> Option<f64> {
    quantile(values, 0.5)
}

/// The value that a share of all is below; `None` where there is none.
pub(super) fn quantile(values: &[f64], share: f64) -> Option<f64> {
    let mut values = values.to_vec();
    let at = (values.len() as f64 * share) as usize;
    let at = at.min(values.len().checked_sub(1)?);
    Some(*values.select_nth_unstable_by(at, f64::total_cmp).1)
}

/// The beams of a sweep that pass where the front of the box should be.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Beams {
    /// Beams through the front.
    pub through: usize,
    /// Those of them that do not return.
    pub silent: usize,
    /// How high over the floor the lowest of the others passes above the top, metres; infinite where
    /// none does.
    pub above_m: f64,
}

impl Beams {
    pub fn of(sweep: &SweepRef<'_>, frame: &Pose, obstacle: &Obstacle) -> Self {
        let mut beams = Self {
            above_m: f64::INFINITY,
            ..Self::default()
        };
        for column in 0..sweep.columns.len() {
            for row in 0..sweep.rows() {
                // A beam is straight, to a few centimetres.
                let [near, far] = [1.0, 2.0].map(|m| frame.apply(sweep.point_m(row, column, m)));
                let along = (obstacle.distance_m - near[1]) / (far[1] - near[1]);
                let [right_m, up_m] =
                    [0, 2].map(|axis| near[axis] + along * (far[axis] - near[axis]));
                let is_ahead = far[1] > near[1] && right_m.abs() <= obstacle.width_m / 2.0;
                if !is_ahead || up_m < LEAST_UP_M {
                    continue;
                }
                if up_m > obstacle.height_m {
                    beams.above_m = beams.above_m.min(up_m);
                } else {
                    beams.through += 1;
                    beams.silent += usize::from(sweep.pixel(row, column)[0].is_none());
                }
            }
        }
        beams
    }
}
