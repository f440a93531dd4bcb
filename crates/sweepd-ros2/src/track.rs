//! Where the robot was: poses by time, as odometry told them.

use std::collections::VecDeque;

use sweepd_messages::odometry::Located;
use sweepd_sweep::Pose;

/// Poses that are kept: 5 s at 200 Hz.
const KEPT: usize = 1024;
/// Longest time between two poses between which the robot is taken to go evenly: odometry at 10 Hz that
/// loses one message.
pub const LONGEST_STEP_NS: i64 = 250_000_000;
/// Longest time for which the robot is taken to go on evenly after the newest pose: at 3 m/s2 it is 4 mm
/// off by then.
const LONGEST_GUESS_NS: i64 = 50_000_000;
/// Older messages than this belong to a clock that was set back; less old ones are late, and left out.
const LATE_NS: i64 = 1_000_000_000;
/// Poses that are further from a sweep than this are of another clock.
const OTHER_CLOCK_NS: i64 = 5_000_000_000;
/// So are those of a time that has not come: GPS is 18 s ahead of UTC, TAI 37 s.
const AHEAD_NS: i64 = 1_000_000_000;
/// No robot is faster: metres and radians a second.
const FASTEST: [f64; 2] = [100.0, 30.0];
/// None brakes or begins to turn harder: metres and radians a second, each second.
const HARDEST: [f64; 2] = [50.0, 50.0];
/// Metres and radians that odometry may correct at once. What is beyond all this is a jump, over which
/// nothing is interpolated.
const CORRECTED: [f64; 2] = [0.1, 0.05];
/// Positions beyond this are none, metres.
const FARTHEST_M: f64 = 1e9;
/// Frames with longer names are none, bytes.
const LONGEST_NAME: usize = 255;

/// The newest poses of one frame in another, in the order of their times.
#[derive(Debug, Default)]
pub struct Track {
    parent: String,
    child: String,
    poses: VecDeque<Stamped>,
}

/// A pose at a time; the quaternion (x, y, z, w) has length 1.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Stamped {
    time_ns: i64,
    position_m: [f64; 3],
    rotation: [f64; 4],
}

/// The poses around a sweep, at least one.
#[derive(Clone, Debug, PartialEq)]
pub struct Poses(Vec<Stamped>);

/// Why there are no poses for a sweep.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum Missing {
    /// There is nothing.
    #[error("no message of it has a pose")]
    Nothing,
    /// They are not there yet.
    #[error("the newest pose is {:.0} ms older than the sweep's last shot", ms(.0))]
    Late(i64),
    /// They begin later, or were of another place before.
    #[error("poses begin, or jump, {:.0} ms after the sweep's first shot", ms(.0))]
    Early(i64),
    /// There are too few.
    #[error("there is no pose for {:.0} ms of the sweep's time", ms(.0))]
    Gap(i64),
    /// Another clock stamps them.
    #[error("odometry has another clock: its newest pose is {} the sweep's last shot", apart(.0))]
    OtherClock(i64),
}

fn length(of: [f64; 3]) -> f64 {
    of.iter().map(|value| value * value).sum::<f64>().sqrt()
}

fn ms(time_ns: &i64) -> f64 {
    *time_ns as f64 * 1e-6
}

fn apart(late_ns: &i64) -> String {
    let side = if *late_ns > 0 { "before" } else { "after" };
    format!("{:.3} s {side}", ms(late_ns).abs() * 1e-3)
}

impl Track {
    /// The frame whose poses these are.
    pub fn child(&self) -> &str {
        &self.child
    }

    /// Where its poses are told.
    pub fn parent(&self) -> &str {
        &self.parent
    }

    /// Whether it has no pose.
    pub fn is_empty(&self) -> bool {
        self.poses.is_empty()
    }

    /// Takes a pose; `false` where it is none, or comes late.
    pub fn add(&mut self, located: &Located<'_>) -> bool {
        let Some(pose) = Stamped::of(located) else {
            return false;
        };
        if (&self.parent[..], &self.child[..]) != (located.parent, located.child) {
            self.poses.clear();
            (self.parent, self.child) = (located.parent.to_owned(), located.child.to_owned());
        }
        if let Some(newest) = self.poses.back() {
            let since_ns = pose.time_ns.saturating_sub(newest.time_ns);
            if (-LATE_NS..=0).contains(&since_ns) {
                return false;
            }
            let before = self.poses.iter().nth_back(1);
            if since_ns < 0 || newest.jumps_to(&pose, before) {
                self.poses.clear();
            }
        }
        if self.poses.len() == KEPT {
            self.poses.pop_front();
        }
        self.poses.push_back(pose);
        true
    }

    /// The poses around the first and the last shot of a sweep. With `guess` they may end a little before
    /// the last.
    ///
    /// # Errors
    /// [`Missing`].
    pub fn around(&self, [first_ns, last_ns]: [i64; 2], guess: bool) -> Result<Poses, Missing> {
        let (Some(oldest), Some(newest)) = (self.poses.front(), self.poses.back()) else {
            return Err(Missing::Nothing);
        };
        let late_ns = last_ns.saturating_sub(newest.time_ns);
        let early_ns = oldest.time_ns.saturating_sub(first_ns);
        if late_ns.max(early_ns) > OTHER_CLOCK_NS || late_ns < -AHEAD_NS {
            return Err(Missing::OtherClock(late_ns));
        }
        if early_ns > 0 {
            return Err(Missing::Early(early_ns));
        }
        let from = self.poses.partition_point(|pose| pose.time_ns <= first_ns);
        let to = self.poses.partition_point(|pose| pose.time_ns < last_ns);
        // One before the sweep and one behind it; two, so that there is a motion to go on with.
        let to = (to + 1).min(self.poses.len());
        let from = (from - 1).min(to.saturating_sub(2));
        let poses: Vec<Stamped> = self.poses.range(from..to).copied().collect();
        let steps = poses.windows(2);
        let mut steps = steps.map(|two| two[1].time_ns.saturating_sub(two[0].time_ns));
        let longest_ns = steps.clone().max().unwrap_or(0);
        if longest_ns > LONGEST_STEP_NS {
            return Err(Missing::Gap(longest_ns));
        }
        // No further than the step before shows.
        let most_ns = steps.next_back().unwrap_or(0).min(LONGEST_GUESS_NS);
        match late_ns <= 0 || guess && late_ns <= most_ns {
            true => Ok(Poses(poses)),
            false => Err(Missing::Late(late_ns)),
        }
    }
}

impl Stamped {
    /// None where a number is no place or no rotation, or a name is too long.
    fn of(located: &Located<'_>) -> Option<Self> {
        let Located {
            time_ns,
            position_m,
            rotation,
            ..
        } = *located;
        let length = rotation.iter().map(|part| part * part).sum::<f64>().sqrt();
        let [parent, child] = [located.parent, located.child].map(str::len);
        if parent.max(child) > LONGEST_NAME {
            return None;
        }
        let is_place = position_m.iter().all(|value| value.abs() <= FARTHEST_M);
        (is_place && length > 1e-3 && length.is_finite()).then(|| Self {
            time_ns,
            position_m,
            rotation: rotation.map(|part| part / length),
        })
    }

    /// Whether no robot gets from here to a later pose, as it came from the one before, if there is one.
    fn jumps_to(&self, later: &Self, before: Option<&Self>) -> bool {
        let seconds = self.seconds_to(later);
        let (came, shorter_s, change) = match before {
            None => ([[0.0; 3]; 2], seconds, FASTEST),
            Some(before) => {
                let came_s = before.seconds_to(self);
                // Each velocity is that of the middle of its step.
                let between_s = (came_s + seconds) / 2.0;
                let change = HARDEST.map(|hardest| hardest * between_s);
                (before.velocity_to(self), came_s.min(seconds), change)
            }
        };
        let goes = self.velocity_to(later);
        (0..2).any(|kind| {
            let changed = [0, 1, 2].map(|axis| goes[kind][axis] - came[kind][axis]);
            length(changed) * shorter_s > CORRECTED[kind] + change[kind] * shorter_s
        })
    }

    fn seconds_to(&self, later: &Self) -> f64 {
        later.time_ns.saturating_sub(self.time_ns) as f64 * 1e-9
    }

    /// Velocity in the parent frame, and rate of turn about the axes of this pose.
    fn velocity_to(&self, later: &Self) -> [[f64; 3]; 2] {
        let seconds = self.seconds_to(later);
        let way = [0, 1, 2].map(|axis| later.position_m[axis] - self.position_m[axis]);
        let cos = self.cos_half(later);
        let ([x, y, z, w], [later_x, later_y, later_z, later_w]) = (self.rotation, later.rotation);
        // Of the rotation between the two: its axis, as long as the sine of half its angle.
        let axis = [
            w * later_x - later_w * x - y * later_z + z * later_y,
            w * later_y - later_w * y - z * later_x + x * later_z,
            w * later_z - later_w * z - x * later_y + y * later_x,
        ];
        // The shorter way; for small angles the sine is the angle.
        let sin = length(axis).copysign(cos);
        let turn_of_axis = match sin.abs() < 1e-9 {
            true => 2.0_f64.copysign(cos),
            false => 2.0 * length(axis).atan2(cos.abs()) / sin,
        };
        [way, axis.map(|part| part * turn_of_axis)].map(|moved| moved.map(|value| value / seconds))
    }

    /// Cosine of half the angle between two rotations, by sign.
    fn cos_half(&self, other: &Self) -> f64 {
        let pairs = self.rotation.iter().zip(other.rotation);
        pairs.map(|(one, other)| one * other).sum()
    }

    /// The pose at a time: the position goes evenly along a line, the rotation about one axis.
    fn towards(&self, next: &Self, time_ns: i64) -> Pose {
        let step_ns = (next.time_ns - self.time_ns) as f64;
        let part = (time_ns.saturating_sub(self.time_ns)) as f64 / step_ns;
        let between = |from: f64, to: f64| from + (to - from) * part;
        let cos = self.cos_half(next);
        let half_rad = cos.abs().min(1.0).acos();
        // The shorter way; for small angles the arc is its chord.
        let [own, other] = match half_rad < 1e-6 {
            true => [1.0 - part, part],
            false => [1.0 - part, part].map(|part| (part * half_rad).sin() / half_rad.sin()),
        };
        let other = if cos < 0.0 { -other } else { other };
        let axes = [0, 1, 2, 3];
        Pose::new(
            [0, 1, 2].map(|axis| between(self.position_m[axis], next.position_m[axis])),
            axes.map(|axis| own * self.rotation[axis] + other * next.rotation[axis]),
        )
    }
}

impl Poses {
    /// The pose at a time, nanoseconds since 1970; beyond the ends as if the robot went on.
    pub fn at(&self, time_ns: i64) -> Pose {
        let [only] = self.0[..] else {
            let behind = self.0.partition_point(|pose| pose.time_ns <= time_ns);
            let next = behind.clamp(1, self.0.len() - 1);
            return self.0[next - 1].towards(&self.0[next], time_ns);
        };
        Pose::new(only.position_m, only.rotation)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const BEGUN_NS: i64 = 1_700_000_000_000_000_000;

    fn ns(seconds: f64) -> i64 {
        BEGUN_NS + (seconds * 1e9).round() as i64
    }

    /// The robot so far ahead, turned to the left.
    fn located(seconds: f64, x: f64, yaw_rad: f64) -> Located<'static> {
        Located {
            time_ns: ns(seconds),
            parent: "odom",
            child: "base_link",
            position_m: [x, 0.0, 0.0],
            rotation: [0.0, 0.0, (yaw_rad / 2.0).sin(), (yaw_rad / 2.0).cos()],
        }
    }

    /// At 10 m/s and 2 rad/s, poses each 50 ms.
    fn drive(steps: i64) -> Track {
        let mut track = Track::default();
        for step in 0..steps {
            let seconds = 0.05 * step as f64;
            let mut pose = located(seconds, 10.0 * seconds, 2.0 * seconds);
            // A quaternion of any length, and its negative is the same rotation.
            let factor = [2.0, -0.5][step as usize % 2];
            pose.rotation = pose.rotation.map(|part| part * factor);
            assert!(track.add(&pose));
        }
        track
    }

    fn around(track: &Track, first_s: f64, last_s: f64) -> Result<Poses, Missing> {
        track.around([ns(first_s), ns(last_s)], false)
    }

    #[track_caller]
    fn is_on_its_way(poses: &Poses, seconds: f64) {
        let Pose {
            rotation,
            position_m,
        } = poses.at(ns(seconds));
        let (sin, cos) = (2.0 * seconds).sin_cos();
        let off = [
            position_m[0] - 10.0 * seconds,
            rotation[0][0] - cos,
            rotation[1][0] - sin,
            rotation[2][2] - 1.0,
        ];
        assert!(off.iter().all(|off| off.abs() < 1e-6), "{seconds}: {off:?}");
    }

    #[test]
    fn between_poses_the_robot_goes_evenly_and_a_little_further() {
        let track = drive(5);
        let poses = around(&track, 0.06, 0.16).unwrap();
        assert_eq!(poses.0.len(), 4);
        for seconds in [0.06, 0.1, 0.1234, 0.16] {
            is_on_its_way(&poses, seconds);
        }
        assert_eq!(around(&track, 0.15, 0.2).unwrap().0.len(), 2);
        // The newest is of 0.2 s: it goes on for a step.
        let late = Missing::Late(40_000_000);
        assert_eq!(around(&track, 0.14, 0.24), Err(late));
        for first_s in [0.14, 0.21] {
            let guessed = track.around([ns(first_s), ns(0.24)], true).unwrap();
            is_on_its_way(&guessed, 0.24);
        }
        let late = track.around([ns(0.16), ns(0.26)], true);
        assert_eq!(late, Err(Missing::Late(60_000_000)));
    }

    #[test]
    fn where_poses_are_missing_it_is_said_why() {
        assert_eq!(around(&Track::default(), 0.0, 0.1), Err(Missing::Nothing));
        let track = drive(5);
        for (first_s, last_s, why) in [
            (-0.03, 0.07, Missing::Early(30_000_000)),
            (9.9, 10.0, Missing::OtherClock(9_800_000_000)),
            (-37.0, -36.9, Missing::OtherClock(-37_100_000_000)),
        ] {
            assert_eq!(around(&track, first_s, last_s), Err(why));
        }
        let said = Missing::OtherClock(-37_100_000_000).to_string();
        assert!(
            said.ends_with("its newest pose is 37.100 s after the sweep's last shot"),
            "{said}"
        );
        let mut track = drive(5);
        track.add(&located(0.5, 5.0, 1.0));
        assert_eq!(around(&track, 0.2, 0.3), Err(Missing::Gap(300_000_000)));
        assert!(around(&track, 0.05, 0.15).is_ok());
        // One pose is no motion, and stands for its own time alone.
        let mut one = Track::default();
        one.add(&located(0.0, 3.0, 0.0));
        assert_eq!(around(&one, 0.0, 0.1), Err(Missing::Late(100_000_000)));
        assert_eq!(
            around(&one, 0.0, 0.0).unwrap().at(ns(1.0)).position_m[0],
            3.0
        );
    }

    /// A track that is long enough reaches back to the sweep, but its poses are those of 37 s before.
    #[test]
    fn a_clock_that_is_ahead_is_another_one() {
        let track = drive(KEPT as i64);
        let newest_s = 0.05 * (KEPT - 1) as f64;
        for (ahead_s, ahead_ns) in [(37.0, 37_000_000_000), (1.1, 1_100_000_000)] {
            let last_s = newest_s - ahead_s;
            let why = Missing::OtherClock(-ahead_ns);
            assert_eq!(around(&track, last_s - 0.1, last_s), Err(why));
        }
        assert!(around(&track, newest_s - 0.23, newest_s - 0.13).is_ok());
    }

    #[test]
    fn what_is_no_pose_changes_nothing_and_what_jumps_begins_anew() {
        let mut track = drive(5);
        let next = located(0.25, 2.5, 0.5);
        let long = "x".repeat(256);
        let mut wrong = [next; 8];
        wrong[0].rotation = [0.0; 4];
        wrong[1].rotation[3] = f64::NAN;
        wrong[2].rotation[0] = f64::INFINITY;
        wrong[3].position_m[2] = f64::NAN;
        wrong[4].position_m[1] = 1e300;
        // Late, or again.
        wrong[5].time_ns = ns(0.2);
        wrong[6].parent = &long;
        wrong[7].child = &long;
        for wrong in wrong {
            assert!(!track.add(&wrong), "{wrong:?}");
        }
        assert_eq!(track.poses.len(), 5);

        let mut other = next;
        other.child = "base_footprint";
        for (jump, why) in [
            (located(0.25, 12.5, 0.5), "a place"),
            (located(0.25, 2.5, 2.5), "a direction"),
            (located(-0.9, 2.5, 0.5), "its clock"),
            (other, "its frame"),
        ] {
            let mut track = drive(5);
            assert!(track.add(&jump), "{why}");
            assert_eq!((track.poses.len(), track.child()), (1, jump.child), "{why}");
        }
        let mut track = drive(5);
        assert!(track.add(&next) && track.poses.len() == 6);
    }

    /// Whether a track at 50 Hz goes on over all of these places, metres ahead and radians to the left.
    fn goes_on(places: &[[f64; 2]]) -> bool {
        let mut track = Track::default();
        for (step, [x, yaw_rad]) in places.iter().enumerate() {
            assert!(track.add(&located(0.02 * step as f64, *x, *yaw_rad)));
        }
        track.poses.len() == places.len()
    }

    #[test]
    fn a_step_unlike_the_one_before_is_a_jump() {
        // At 10 m/s, 0.2 m a step: a loop that closes moves it by 0.5 m, or turns it by 6 degrees.
        assert!(goes_on(&[[0.0, 0.0], [0.2, 0.0], [0.4, 0.0]]));
        assert!(!goes_on(&[[0.0, 0.0], [0.2, 0.0], [0.9, 0.0]]));
        assert!(!goes_on(&[[0.0, 0.0], [0.2, 0.0], [0.4, 0.105]]));
        // 0.1 m, and 0.02 m for 50 m/s2.
        assert!(goes_on(&[[0.0, 0.0], [0.2, 0.0], [0.515, 0.0]]));
        assert!(!goes_on(&[[0.0, 0.0], [0.2, 0.0], [0.525, 0.0]]));
        // A brake with 12.5 m/s2: 5 mm less each step.
        let brake = [0.0, 0.2, 0.395, 0.585, 0.77, 0.95, 1.125, 1.295];
        assert!(goes_on(&brake.map(|x| [x, 0.0])));
        // From straight on to 3 rad/s at once, over half a turn and the quaternion's change of sign.
        let mut turn = vec![[0.0, 3.0], [0.1, 3.0]];
        turn.extend((1..40).map(|step| [0.1, 3.0 + 0.06 * f64::from(step)]));
        assert!(goes_on(&turn));
        // A crash: from 10 m/s to nothing within a step, 0.2 m less.
        assert!(!goes_on(&[[0.0, 0.0], [0.2, 0.0], [0.2, 0.0]]));
        // Stamps 1 ms apart tell little of a velocity: 5 mm make 5 m/s.
        let mut track = drive(5);
        for (seconds, x) in [(0.201, 2.015), (0.25, 2.5), (0.3, 3.0)] {
            assert!(track.add(&located(seconds, x, 2.0 * seconds)));
        }
        assert_eq!(track.poses.len(), 8);
    }

    /// Times and numbers of any size: no panic, and no more than so many poses.
    #[test]
    fn wild_odometry_takes_no_more_memory() {
        let mut random = fastrand::Rng::with_seed(7);
        let mut track = Track::default();
        let mut time_ns = BEGUN_NS;
        for _ in 0..20_000 {
            let mut pose = located(0.0, random.f64(), random.f64());
            time_ns = time_ns.saturating_add(random.i64(0..3_000_000));
            pose.time_ns = match random.u16(..) {
                0 => i64::MIN,
                1 => i64::MAX,
                2..10 => random.i64(..),
                _ => time_ns,
            };
            pose.position_m[0] *= [1.0, 1.0, 1.0, 1e308][random.usize(0..4)];
            track.add(&pose);
            assert!(track.poses.len() <= KEPT);
            let first_ns = match random.bool() {
                true => time_ns - 50_000_000,
                false => random.i64(..),
            };
            let ends_ns = [
                first_ns,
                first_ns.saturating_add(random.i64(0..100_000_000)),
            ];
            if let Ok(poses) = track.around(ends_ns, random.bool()) {
                let position_m = poses.at(ends_ns[1]).position_m;
                assert!(position_m.iter().all(|value| value.is_finite()));
            }
        }
        assert!(track.poses.capacity() <= 2 * KEPT);
    }
}
