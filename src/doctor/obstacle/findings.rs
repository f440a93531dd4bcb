//! What is wrong with a box that is no object of its own, and what to change.

use super::place::{Floor, Placed, quantile};
use super::{ENOUGH_PERCENT, Newest, Report, Seen, Trial};
use crate::doctor::{Finding, Severity, Topic};
use crate::text::count_of;
use sweepd_core::segment;

/// A mount that is off by more is told: the tilt, degrees, and the floor at the box, metres.
const TILT_DEG: f64 = 2.0;
const FLOOR_M: f64 = 0.05;
/// Objects farther apart are not joined, metres: the widest gap of the segmenter.
const APART_M: f64 = 0.65;

impl Trial {
    /// What is wrong, and what to change: the worst first. No errors where the box is seen.
    pub fn findings(&self) -> Vec<Finding> {
        let report = self.report();
        if report.sweeps == 0 {
            return vec![self.nothing_judged()];
        }
        let is_well = report.is_well();
        let mut findings = Vec::new();
        findings.extend(self.mount(&report, is_well));
        let mut others: Vec<(Seen, u32)> =
            report.seen.iter().map(|(&seen, &n)| (seen, n)).collect();
        others.sort_by_key(|&(_, sweeps)| std::cmp::Reverse(sweeps));
        for (seen, sweeps) in others {
            // What is rare is not why it fails.
            let is_rare = 100 * sweeps < (100 - ENOUGH_PERCENT) * report.sweeps;
            if seen != Seen::Own && !is_well && !is_rare {
                findings.push(self.explain(seen, sweeps, &report));
            }
        }
        findings
    }

    fn nothing_judged(&self) -> Finding {
        if self.without_height > 0 {
            return error(
                format!(
                    "the height of the sensor is not known in any of {}",
                    count_of(self.without_height.into(), "sweep")
                ),
                "give `height_m` in `[sensor.mount]`, and pass the file with --config".to_owned(),
            );
        }
        error(
            "no whole sweep came".to_owned(),
            "`sweepd doctor` without --obstacle says why; of a capture, `sweepd inspect`"
                .to_owned(),
        )
    }

    /// The mount, where the floor is not where it says.
    fn mount(&self, report: &Report, is_well: bool) -> Option<Finding> {
        let (floor_m, rise_deg) = (report.floor_m?, report.floor_rise_deg?);
        if report.is_mount_right()? {
            return None;
        }
        let median = |of: &[f64]| quantile(&mut of.to_vec(), 0.5);
        let floor = Floor {
            up_m: median(&self.floors_up_m)?,
            rise: median(&self.floors_rise)?,
        };
        let direction = if rise_deg < 0.0 { "falls" } else { "rises" };
        let side = if floor_m < 0.0 { "below" } else { "above" };
        Some(Finding {
            severity: if is_well {
                Severity::Warning
            } else {
                Severity::Error
            },
            topic: Topic::Obstacle,
            what: format!(
                "the mount is not right: by it the floor {direction} by {:.1} degrees towards the box, and lies {:.2} m {side} 0 there",
                rise_deg.abs(),
                floor_m.abs()
            ),
            cure: self.newest.as_ref()?.mount_for(&floor),
        })
    }

    fn explain(&self, seen: Seen, sweeps: u32, report: &Report) -> Finding {
        let returns = report.returns.unwrap_or(0.0) as u64;
        let strike = format!(
            "{} in {}",
            count_of(returns, "return"),
            count_of(report.rows.unwrap_or(0.0) as u64, "row")
        );
        let (why, cure) = match seen {
            Seen::Nothing => self.nothing(),
            Seen::Joined => joined(report),
            Seen::Ground => (
                format!("most of its returns ({strike}) are ground"),
                format!("{}{MORE_ROWS}", first_mount(report)),
            ),
            Seen::Pieces => (
                format!("its returns ({strike}) are in several objects, or partly ground"),
                format!("{}{MORE_ROWS}", first_mount(report)),
            ),
            Seen::TooFew => {
                let least = self.settings.as_ref().map(|settings| settings.min_points);
                let least = least.unwrap_or(segment::Config::default().min_points);
                (
                    format!("only {strike} strike it, and a segment has {least} at least"),
                    format!("`min_points` of `[sensor.segment]` at {} or less\n{MORE_ROWS}", returns.max(1)),
                )
            }
            Seen::TooNear | Seen::TooFar => {
                let key = if seen == Seen::TooNear { "min_range_m" } else { "max_range_m" };
                (
                    format!("`{key}` of `[sensor.segment]` cuts it off"),
                    format!("another `{key}`, or a box within the limits"),
                )
            }
            Seen::Masked => (
                "the mask of `[sensor.segment]` hides it".to_owned(),
                "a mask that is white there, or a box elsewhere".to_owned(),
            ),
            _ => (
                format!("most of its returns ({strike}) have no label"),
                "range limits, a mask or `min_points` of `[sensor.segment]`: with --config FILE of the daemon, it is said which"
                    .to_owned(),
            ),
        };
        error(
            format!("in {sweeps} of {} sweeps {why}", report.sweeps),
            cure,
        )
    }

    /// Why nothing is there.
    fn nothing(&self) -> (String, String) {
        let obstacle = &self.obstacle;
        let beams = self.beams.unwrap_or_default();
        let found = self.nearest.as_ref().map(|one| self.nearest_words(one));
        let found = found.unwrap_or_else(|| "there is none near it".to_owned());
        let place = format!(
            "no return is within 0.25 m of its place, {} m ahead",
            obstacle.distance_m
        );
        if beams.through == 0 {
            let above = match beams.above_m.is_finite() {
                true => format!(": the lowest passes {:.2} m above the floor", beams.above_m),
                false => String::new(),
            };
            return (
                format!("no beam meets a box of {} m there{above}", obstacle.height_m),
                "a lower mount, another pitch or yaw, a field of view that is not limited, a higher box, or another distance"
                    .to_owned(),
            );
        }
        if 2 * beams.silent > beams.through {
            return (
                format!(
                    "{place}: {} of {} beams there do not return",
                    beams.silent, beams.through
                ),
                format!(
                    "a box that is neither black nor glossy, and not nearer than the sensor can see; of the returns that are not \
                     ground {found}"
                ),
            );
        }
        (
            format!(
                "{place}: {} of {} beams there return from farther away",
                beams.beyond, beams.through
            ),
            format!(
                "put the box there, measured from the robot's origin ({}); of the returns that are not ground {found}",
                self.origin()
            ),
        )
    }

    /// Where a return is, from the robot's origin.
    fn nearest_words(&self, one: &Placed) -> String {
        let away_m = one.right_m.hypot(one.ahead_m);
        let azimuth_deg = self.obstacle.azimuth_deg + one.right_m.atan2(one.ahead_m).to_degrees();
        format!("the nearest is {away_m:.2} m away at azimuth {azimuth_deg:.1} degrees")
    }

    /// Where the sensor is, from the robot's origin.
    fn origin(&self) -> String {
        let [x, y, _] = self
            .newest
            .map_or([0.0; 3], |newest| newest.header.position_m);
        format!("by `[sensor.mount]` the sensor is at x_m = {x}, y_m = {y} from it")
    }
}

const MORE_ROWS: &str = "two rows at least must strike it, some 5 cm apart in height: a nearer or higher box, or a lower mount; the table \
                         \"The smallest obstacle\" of docs/segmentation.md has what a model sees";

/// What to do first about a box that is taken for ground.
fn first_mount(report: &Report) -> &'static str {
    match report.is_mount_right() {
        Some(true) => "",
        Some(false) => "mend the mount first; then,\n",
        None => "the floor around it is not seen: check `[sensor.mount]`; then,\n",
    }
}

fn joined(report: &Report) -> (String, String) {
    let Some(with) = &report.joined else {
        return (String::new(), String::new());
    };
    let is_floor = with.top_m <= FLOOR_M;
    let [near_m, far_m] = with.ahead_m;
    let [left_m, right_m] = with.right_m;
    let (what, cure) = match is_floor {
        true => (
            "the floor",
            "the floor is taken for an object: check `[sensor.mount]`".to_owned(),
        ),
        false => (
            "something else",
            format!(
                "leave {APART_M} m between the two; if all of it is the box, give its width: HEIGHT,DISTANCE,AZIMUTH,WIDTH"
            ),
        ),
    };
    let what = format!(
        "it is one object with {what}, from {near_m:.2} to {far_m:.2} m ahead, {} to {}, up to {:.2} m high",
        aside(left_m),
        aside(right_m),
        with.top_m
    );
    (what, cure)
}

/// How far to the right something is.
fn aside(right_m: f64) -> String {
    let side = if right_m < 0.0 { "left" } else { "right" };
    format!("{:.2} m {side}", right_m.abs())
}

fn error(what: String, cure: String) -> Finding {
    Finding {
        severity: Severity::Error,
        topic: Topic::Obstacle,
        what,
        cure,
    }
}

impl Report {
    /// Whether the floor is where the mount says; `None` where it is not seen.
    fn is_mount_right(&self) -> Option<bool> {
        let (floor_m, rise_deg) = (self.floor_m?, self.floor_rise_deg?);
        Some(floor_m.abs() <= FLOOR_M && rise_deg.abs() <= TILT_DEG)
    }
}

impl Newest {
    /// The lines of `[sensor.mount]` by which this floor is level at 0, if it is level across.
    fn mount_for(&self, floor: &Floor) -> String {
        let steepness = floor.rise.hypot(1.0);
        // Away from the floor, in the frame of the box and then in that of the sensor.
        let up = [0.0, -floor.rise / steepness, 1.0 / steepness];
        let [x, y, z] = [0, 1, 2].map(|axis| {
            let parts = self.frame.rotation.iter().zip(up);
            parts.map(|(row, up)| row[axis] * up).sum::<f64>()
        });
        let [_, ahead_m, up_m] = self.frame.position_m;
        let degrees = |rad: f64| (rad.to_degrees() * 10.0).round() / 10.0 + 0.0;
        let header = &self.header;
        format!(
            "on a level floor `[sensor.mount]` is about: pitch_deg = {:.1}, roll_deg = {:.1}, height_m = {:.2}\nit is: pitch_deg = \
             {:.1}, roll_deg = {:.1}, height_m = {:.2}",
            degrees(y.asin()),
            degrees((-x).atan2(z)),
            (up_m - floor.at(ahead_m)) / steepness,
            degrees(header.pitch_rad.into()),
            degrees(header.roll_rad.into()),
            header.height_m
        )
    }
}
