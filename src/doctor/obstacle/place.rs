//! Where the box should stand: the returns there, the floor around it, and the beams that pass.

use super::Obstacle;
use sweepd_core::sweep::layout::LABEL_GROUND;
use sweepd_core::sweep::{Header, Pose, Return, SweepRef};

/// How far the front may be from where it should be, metres.
const OFF_M: f64 = 0.25;
/// Returns lower than this over the floor may be the floor, metres.
pub(super) const LEAST_UP_M: f64 = 0.03;
/// Returns on the box lie this much above its top at most, metres.
const OVER_M: f64 = 0.05;
/// Fewest returns that are taken for a box.
const MIN_STRIKES: usize = 3;
/// What is in one object with the box may be so far beside, before, behind and above it, metres.
const BESIDE_M: f64 = 0.3;
const BEHIND_M: f64 = 0.5;

/// A return in the frame of the box: right of its direction, ahead along it, both from the robot's
/// origin, and up from the floor.
#[derive(Clone, Copy, Debug)]
pub(super) struct Placed {
    pub right_m: f64,
    pub ahead_m: f64,
    pub up_m: f64,
    pub of: Return,
}

/// The floor on the way to the box: its height above that of the mount at the robot's origin, and
/// its rise per metre ahead.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Floor {
    pub up_m: f64,
    pub rise: f64,
}

impl Floor {
    /// Its height this far ahead, metres.
    pub fn at(&self, ahead_m: f64) -> f64 {
        self.up_m + self.rise * ahead_m
    }
}

/// The way from the sensor's frame to that of the box; `None` while the height of the sensor is
/// unknown.
pub(super) fn frame(header: &Header, obstacle: &Obstacle) -> Option<Pose> {
    let height_m = f64::from(header.height_m);
    let mut mount = Pose::of_mount(header);
    mount.position_m[2] = height_m;
    let turn = Pose::mounted(
        [0.0; 3],
        [obstacle.azimuth_deg.to_radians() as f32, 0.0, 0.0],
    );
    (height_m > 0.0).then(|| turn * mount)
}

/// All returns of a sweep in the frame of the box.
pub(super) fn placed(sweep: &SweepRef<'_>, frame: &Pose) -> Vec<Placed> {
    let place = |of: Return| {
        let [right_m, ahead_m, up_m] = frame.apply(of.point_m);
        Placed {
            right_m,
            ahead_m,
            up_m,
            of,
        }
    };
    sweep.returns().map(place).collect()
}

impl Obstacle {
    /// How far the front may be from where it should be, metres.
    fn off_m(&self) -> f64 {
        OFF_M.min(self.distance_m / 2.0)
    }

    /// Whether something there may be the box: as wide and as deep as it is wide, with some play.
    pub(super) fn holds(&self, right_m: f64, ahead_m: f64, up_m: f64) -> bool {
        let off_m = self.off_m();
        right_m.abs() <= self.width_m / 2.0
            && (-off_m..=off_m + self.width_m).contains(&(ahead_m - self.distance_m))
            && (LEAST_UP_M..=self.height_m + OVER_M).contains(&up_m)
    }

    /// The floor as it is seen on the way to the box and behind it: the lower quarter of the returns
    /// in each piece of the way, and the median line through these. `None` where too little of it
    /// is seen, or it is no plane.
    pub(super) fn floor(&self, returns: &[Placed]) -> Option<Floor> {
        const PIECE_M: f64 = 0.25;
        const FIRST_M: f64 = 0.3;
        let (half_m, reach_m) = (
            self.width_m / 2.0 + 0.5,
            (2.0 * self.distance_m).max(self.distance_m + 3.0),
        );
        let mut pieces = vec![Vec::new(); (reach_m / PIECE_M) as usize];
        for one in returns {
            let is_box = one.right_m.abs() <= self.width_m / 2.0 + 0.1
                && (-0.35..=0.35 + self.width_m).contains(&(one.ahead_m - self.distance_m));
            // A floor that is told wrong by 20 degrees and 0.3 m.
            let is_low = one.up_m.abs() <= 0.3 + 0.36 * one.ahead_m;
            if one.right_m.abs() <= half_m && one.ahead_m >= FIRST_M && is_low && !is_box {
                let piece = pieces.get_mut((one.ahead_m / PIECE_M) as usize);
                piece
                    .into_iter()
                    .for_each(|piece| piece.push((one.ahead_m, one.up_m)));
            }
        }
        let mut points = Vec::new();
        for mut piece in pieces {
            if piece.len() >= MIN_STRIKES {
                piece.sort_unstable_by(|a, b| a.1.total_cmp(&b.1));
                points.push(piece[piece.len() / 4]);
            }
        }
        line(&points)
    }

    /// The returns on the box, of those of a sweep over a floor.
    pub(super) fn strikes(&self, returns: &[Placed], floor: &Floor) -> Vec<Placed> {
        let up_m = |one: &Placed| one.up_m - floor.at(one.ahead_m);
        let is_held = |one: &&Placed| self.holds(one.right_m, one.ahead_m, up_m(one));
        let mut strikes: Vec<Placed> = returns.iter().filter(is_held).copied().collect();
        let front_m = front_m(&strikes);
        // What is seen farther back stands behind the place.
        if front_m.is_none_or(|front_m| front_m > self.distance_m + self.off_m()) {
            return Vec::new();
        }
        strikes.retain(|one| front_m.is_some_and(|front_m| one.ahead_m <= front_m + self.width_m));
        if strikes.len() < MIN_STRIKES {
            strikes.clear();
        }
        strikes
    }

    /// Whether a return is so near a box with this front that it may be part of it.
    pub(super) fn is_beside(&self, one: &Placed, front_m: f64, floor: &Floor) -> bool {
        one.right_m.abs() <= self.width_m / 2.0 + BESIDE_M
            && (-BESIDE_M..=self.width_m + BEHIND_M).contains(&(one.ahead_m - front_m))
            && one.up_m - floor.at(one.ahead_m) <= self.height_m + BESIDE_M
    }

    /// The return nearest to the front of the box that is no ground and about as high as it is.
    pub(super) fn nearest(&self, returns: &[Placed], floor: &Floor) -> Option<Placed> {
        let is_candidate = |one: &&Placed| {
            let up_m = one.up_m - floor.at(one.ahead_m);
            one.of.label != LABEL_GROUND && (OVER_M..=self.height_m + BESIDE_M).contains(&up_m)
        };
        let away_m = |one: &Placed| one.right_m.hypot(one.ahead_m - self.distance_m);
        let candidates = returns.iter().filter(is_candidate);
        let nearest = candidates.min_by(|a, b| away_m(a).total_cmp(&away_m(b)));
        nearest.copied()
    }
}

/// How far ahead the front of something is: the nearest tenth of its returns is before it.
pub(super) fn front_m(returns: &[Placed]) -> Option<f64> {
    let mut ahead_m: Vec<f64> = returns.iter().map(|one| one.ahead_m).collect();
    quantile(&mut ahead_m, 0.1)
}

/// The value that a share of all is below; `None` where there is none.
pub(super) fn quantile(values: &mut [f64], share: f64) -> Option<f64> {
    let at = (values.len() as f64 * share) as usize;
    let at = at.min(values.len().checked_sub(1)?);
    Some(*values.select_nth_unstable_by(at, f64::total_cmp).1)
}

/// The line through points by the medians of the slopes between them and of their heights over it
/// (Theil and Sen): three in ten may be anywhere.
fn line(points: &[(f64, f64)]) -> Option<Floor> {
    const MIN_POINTS: usize = 4;
    /// Of the points about the line, metres.
    const SPREAD_M: f64 = 0.03;
    if points.len() < MIN_POINTS {
        return None;
    }
    let mut slopes = Vec::new();
    for (index, a) in points.iter().enumerate() {
        for b in &points[index + 1..] {
            slopes.push((b.1 - a.1) / (b.0 - a.0));
        }
    }
    let rise = quantile(&mut slopes, 0.5)?;
    let over = |point: &(f64, f64)| point.1 - rise * point.0;
    let mut heights_m: Vec<f64> = points.iter().map(over).collect();
    let up_m = quantile(&mut heights_m, 0.5)?;
    let mut off_m: Vec<f64> = heights_m.iter().map(|one| (one - up_m).abs()).collect();
    let is_plane = quantile(&mut off_m, 0.5)? <= SPREAD_M && rise.is_finite();
    is_plane.then_some(Floor { up_m, rise })
}

/// The beams of a sweep that pass where the front of the box should be.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Beams {
    /// Beams through the front.
    pub through: usize,
    /// Those of them that return from farther away.
    pub beyond: usize,
    /// Those of them that do not return.
    pub silent: usize,
    /// How high over the floor the lowest of the others passes above the top, metres; infinite where
    /// none does.
    pub above_m: f64,
}

impl Beams {
    pub fn of(sweep: &SweepRef<'_>, frame: &Pose, obstacle: &Obstacle, floor: &Floor) -> Self {
        let mut beams = Self {
            above_m: f64::INFINITY,
            ..Self::default()
        };
        let floor_m = floor.at(obstacle.distance_m);
        for column in 0..sweep.columns.len() {
            for row in 0..sweep.rows() {
                // A beam is straight, to a few centimetres.
                let [near, far] = [1.0, 2.0].map(|m| frame.apply(sweep.point_m(row, column, m)));
                let along_m = (obstacle.distance_m - near[1]) / (far[1] - near[1]);
                let at = [0, 2].map(|axis| near[axis] + along_m * (far[axis] - near[axis]));
                let is_ahead = far[1] > near[1] && at[0].abs() <= obstacle.width_m / 2.0;
                let up_m = at[1] - floor_m;
                if !is_ahead || up_m < LEAST_UP_M {
                    continue;
                }
                if up_m > obstacle.height_m {
                    beams.above_m = beams.above_m.min(up_m);
                    continue;
                }
                beams.through += 1;
                match sweep.pixel(row, column)[0] {
                    None => beams.silent += 1,
                    Some(one) => {
                        let ahead_m = frame.apply(one.point_m)[1];
                        let back_m = obstacle.distance_m + obstacle.off_m();
                        beams.beyond += usize::from(ahead_m > back_m);
                    }
                }
            }
        }
        beams
    }
}
