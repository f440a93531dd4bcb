//! What is wrong with a box that is no obstacle, or no object of its own, and what to change.

use super::{ENOUGH_PERCENT, Report, Seen, Trial};
use crate::doctor::{Finding, Severity, Topic};
use crate::floor;
use crate::text::count_of;
use sweepd_core::assemble::Removal;
use sweepd_core::pipeline::Config;
use sweepd_core::sweep::Return;

/// What lies lower than this is the floor, metres.
const FLOOR_M: f64 = 0.05;
/// Objects farther apart are not joined, metres: the widest gap of the segmenter.
const APART_M: f64 = 0.65;

const MORE_ROWS: &str = "at least two rows must strike it, about 5 cm apart in height: use a nearer or higher box, or a lower mount; \
                         the table \"The smallest obstacle\" of docs/segmentation.md says what each model sees";

impl Trial {
    /// Returns what is wrong, and what to change: the mount, then what is most frequent. If the box is
    /// an obstacle, that it is no object of its own is a note.
    pub fn findings(&self) -> Vec<Finding> {
        let report = self.report();
        if report.sweeps == 0 {
            return vec![self.nothing_judged()];
        }
        // What is rare is not why it fails.
        let is_rare = |sweeps: u32| 100 * sweeps < (100 - ENOUGH_PERCENT) * report.sweeps;
        let is_mount = !report.is_well() && !is_rare(self.misplaced);
        let mut findings: Vec<Finding> = self.mount(is_mount).into_iter().collect();
        let first = match &findings[..] {
            [mount] if mount.severity != Severity::Note && !report.is_well() => {
                "set the mount first; then,\n"
            }
            _ => "",
        };
        let mut others: Vec<(Seen, u32)> = report.seen.clone().into_iter().collect();
        others.sort_by_key(|&(_, sweeps)| std::cmp::Reverse(sweeps));
        for (seen, sweeps) in others {
            let missed = self.missed.get(&seen).copied().unwrap_or_default();
            let severity = match report.is_well() || is_rare(missed) {
                true if seen == Seen::Own => continue,
                true => Severity::Note,
                false => Severity::Error,
            };
            if !is_rare(sweeps) {
                let (why, cure) = self.explain(seen, &report);
                let what = format!("in {sweeps} of {} sweeps {why}", report.sweeps);
                let cure = format!("{first}{cure}");
                findings.push(Finding::new(severity, Topic::Obstacle, what, cure));
            }
        }
        findings
    }

    fn nothing_judged(&self) -> Finding {
        let (what, cure) = match self.without_height {
            0 => (
                "no whole sweep came".to_owned(),
                "`sweepd doctor` without --obstacle says why; of a capture, `sweepd inspect`",
            ),
            sweeps => (
                match &self.doubt {
                    Some(doubt) => doubt.what.clone(),
                    None => format!(
                        "the height of the sensor is not known in any of {}",
                        count_of(sweeps.into(), "sweep")
                    ),
                },
                "set `height_m` in `[sensor.mount]`, and pass the file with --config",
            ),
        };
        error(what, cure.to_owned())
    }

    /// The mount, where it is not that of the floor or in doubt; an error if it is why the box is no
    /// obstacle.
    fn mount(&self, is_why: bool) -> Option<Finding> {
        let finder = self.floor.as_ref()?;
        let seen = floor::Seen {
            sight: finder.sight(),
            set: Some(*finder.mount()),
            // The header has the doubt.
            is_estimated: false,
        };
        let told = self.doubt.clone().or_else(|| seen.finding());
        let (trouble, mounted): (Option<Finding>, _) = match told {
            Some(told) if told.what == floor::MOUNTED => (None, Some(told)),
            told => (told, None),
        };
        if !is_why || seen.sight.height_m().is_none() {
            return trouble;
        }
        let (misplaced, sweeps) = (self.misplaced, self.sweeps);
        let mut what = format!(
            "in {misplaced} of {sweeps} sweeps it is an obstacle over the floor that is seen, and none over that of the mount"
        );
        let mut cure = floor::CURE.to_owned();
        if let Some(trouble) = trouble {
            what += &format!(": {}", trouble.what);
            cure = trouble.cure;
        } else if let Some(mounted) = mounted {
            cure += &format!(": {}", mounted.cure);
        }
        Some(Finding::new(Severity::Error, Topic::Mount, what, cure))
    }

    /// Returns why the box is no obstacle, or no object of its own, and what to change.
    fn explain(&self, seen: Seen, report: &Report) -> (String, String) {
        let strike = format!(
            "{} in {}",
            count_of(report.returns.unwrap_or(0.0) as u64, "return"),
            count_of(report.rows.unwrap_or(0.0) as u64, "row")
        );
        match seen {
            Seen::Nothing => self.nothing(),
            Seen::Joined => joined(report),
            Seen::Ground => (
                format!("most of its returns ({strike}) are ground"),
                MORE_ROWS.to_owned(),
            ),
            Seen::Unlabelled => self.unlabelled(&strike),
            Seen::Own => (
                format!("too few of its returns ({strike}) have a label"),
                MORE_ROWS.to_owned(),
            ),
            Seen::Pieces => (
                format!("its returns ({strike}) are in several objects, or partly ground"),
                MORE_ROWS.to_owned(),
            ),
        }
    }

    /// Why the returns on the box have no label.
    fn unlabelled(&self, strike: &str) -> (String, String) {
        let [range_m, returns] =
            [&self.ranges_m, &self.returns].map(|of| super::median(of).unwrap_or_default());
        let Some(Config { segment, .. }) = &self.config else {
            return (
                format!("most of its returns ({strike}) have no label"),
                "`min_range_m`, `max_range_m`, `mask` or `min_points` of `[sensor.segment]` is why: give the daemon's file with \
                 --config to learn which"
                    .to_owned(),
            );
        };
        let range_m = range_m as f32;
        for (key, cuts) in [
            ("min_range_m", range_m < segment.min_range_m),
            ("max_range_m", range_m > segment.max_range_m),
        ] {
            if cuts {
                return (
                    format!("`{key}` of `[sensor.segment]` cuts it off"),
                    format!("change `{key}`, or place the box within the limits"),
                );
            }
        }
        let least = segment.min_points;
        if returns < f64::from(least) {
            return (
                format!("only {strike} strike it, and a segment has {least} at least"),
                format!("set `min_points` of `[sensor.segment]` to {returns} or less\n{MORE_ROWS}"),
            );
        }
        (
            format!("most of its returns ({strike}) have no label"),
            "if the mask of `[sensor.segment]` is black there, make it white, or place the box elsewhere"
                .to_owned(),
        )
    }

    /// Why nothing is there.
    fn nothing(&self) -> (String, String) {
        let beams = self.beams.unwrap_or_default();
        let (through, distance_m) = (beams.through, self.obstacle.distance_m);
        if through == 0 {
            let above = match beams.above_m.is_finite() {
                true => format!(": the lowest passes {:.2} m above the floor", beams.above_m),
                false => String::new(),
            };
            return (
                format!("no beam meets a box of {} m there{above}", self.obstacle.height_m),
                "use a higher box or another distance, or mount the sensor lower or with another pitch or yaw; a limited field of \
                 view may leave the place out"
                    .to_owned(),
            );
        }
        let place = format!("no return is within 0.25 m of its place, {distance_m} m ahead");
        let found = self.nearest_words();
        if 2 * beams.silent > through {
            let config = self.config.as_ref();
            let removes = config.is_none_or(|config| config.removal != Removal::default());
            let removed = match removes {
                true => {
                    "returns there may be removed, by `mask`, `remove_out_of_range` or `remove_boxes` of `[sensor.segment]`\n"
                }
                false => "",
            };
            return (
                format!(
                    "{place}: {} of {through} beams there do not return",
                    beams.silent
                ),
                format!(
                    "{removed}use a box that is neither black nor glossy, and not nearer than the sensor can see\n{found}"
                ),
            );
        }
        let [x_m, y_m, _] = self.position_m;
        (
            format!(
                "{place}: {} of {through} beams there return from elsewhere",
                through - beams.silent
            ),
            format!(
                "put the box there, measured from the robot's origin (by `[sensor.mount]` the sensor is at x_m = {x_m}, y_m = {y_m} \
                 from it)\n{found}"
            ),
        )
    }

    /// Where the nearest return is, from the robot's origin.
    fn nearest_words(&self) -> String {
        let Some(Return {
            point_m: [right_m, ahead_m, _],
            ..
        }) = self.nearest
        else {
            return "no return near it is anything but ground".to_owned();
        };
        let azimuth_deg = self.obstacle.azimuth_deg + right_m.atan2(ahead_m).to_degrees();
        format!(
            "of the returns that are not ground the nearest is {:.2} m away at azimuth {azimuth_deg:.1} degrees",
            right_m.hypot(ahead_m)
        )
    }
}

fn joined(report: &Report) -> (String, String) {
    let Some(with) = &report.joined else {
        return Default::default();
    };
    let (what, cure) = match with.top_m <= FLOOR_M {
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
    let [near_m, far_m] = with.ahead_m;
    let [left, right] = with.right_m.map(aside);
    let what = format!(
        "it is one object with {what}, from {near_m:.2} to {far_m:.2} m ahead, {left} to {right}, up to {:.2} m high",
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
    Finding::new(Severity::Error, Topic::Obstacle, what, cure)
}
