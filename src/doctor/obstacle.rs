//! Whether a sensor on its robot sees a box of known size and place as an obstacle: pure.
//!
//! ```text
//! place      sweep, floor -> returns and beams in the box's place
//! Trial      sweeps, objects -> whether the box is an obstacle, and what becomes of it, sweep by sweep
//! findings   Trial -> what to change
//! ```

mod findings;
mod place;

use std::collections::{BTreeMap, BTreeSet};
use std::fmt;
use std::str::FromStr;

use serde::Serialize;

use crate::floor;
use crate::judge::Finding;
use place::{Beams, front_m, median, quantile};
use sweepd_core::floor::FloorFinder;
use sweepd_core::pipeline::Config;
use sweepd_core::segment::{self, Mount};
use sweepd_core::sweep::layout::{
    LABEL_FIRST_SEGMENT, LABEL_GROUND, LABEL_NONE, TimeSource, flags,
};
use sweepd_core::sweep::objects::NewObjects;
use sweepd_core::sweep::{Header, LeastReturns, Pose, Return, SweepRef, Zone};

/// Sweeps that are judged at most.
pub const SWEEPS: u32 = 100;
/// Percent of the sweeps in which the box must be an obstacle.
pub const ENOUGH_PERCENT: u32 = 95;

/// A box that stands on the floor.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Obstacle {
    /// Its height, metres.
    pub height_m: f64,
    /// From the robot's origin to its front, along the floor, metres.
    pub distance_m: f64,
    /// Where it stands, clockwise from straight ahead of the robot, degrees.
    pub azimuth_deg: f64,
    /// Its width, metres.
    pub width_m: f64,
}

impl FromStr for Obstacle {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let mut numbers = text.split(',');
        let mut next = |name: &str, unit: &str, least: f64, most: f64, absent: Option<f64>| {
            let Some(word) = numbers.next() else {
                return absent.ok_or(format!("the {name} is missing: expected HEIGHT,DISTANCE"));
            };
            match word.trim().parse::<f64>() {
                Ok(number) if (least..=most).contains(&number) => Ok(number),
                _ => Err(format!(
                    "the {name} is `{word}`, expected {least} to {most} {unit}"
                )),
            }
        };
        let obstacle = Self {
            height_m: next("height", "metres", 0.05, 5.0, None)?,
            distance_m: next("distance", "metres", 0.1, 100.0, None)?,
            azimuth_deg: next("azimuth", "degrees", -360.0, 360.0, Some(0.0))?,
            width_m: next("width", "metres", 0.05, 5.0, Some(0.4))?,
        };
        match numbers.next() {
            None => Ok(obstacle),
            Some(more) => Err(format!(
                "`{more}` is too much: expected HEIGHT,DISTANCE,AZIMUTH,WIDTH"
            )),
        }
    }
}

impl fmt::Display for Obstacle {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (height_m, width_m) = (self.height_m, self.width_m);
        write!(
            f,
            "{height_m} m high, {width_m} m wide, {} m ahead",
            self.distance_m
        )?;
        if self.azimuth_deg != 0.0 {
            write!(f, " at azimuth {} degrees", self.azimuth_deg)?;
        }
        Ok(())
    }
}

/// What becomes of the box in a sweep.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Seen {
    /// At least half of its returns are an object that has little else.
    Own,
    /// It is in one object with something else.
    Joined,
    /// Most of its returns are ground.
    Ground,
    /// Its returns are in several objects, or partly ground.
    Pieces,
    /// Most of its returns have no label.
    Unlabelled,
    /// No return is where it should be.
    Nothing,
}

impl Seen {
    /// In words, after a number of sweeps.
    pub fn words(self) -> &'static str {
        match self {
            Self::Own => "an object of its own",
            Self::Joined => "joined with something else",
            Self::Ground => "ground",
            Self::Pieces => "in pieces",
            Self::Unlabelled => "without a label",
            Self::Nothing => "no return there",
        }
    }
}

/// What is in one object with the box: least and greatest, metres.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Extent {
    /// Along the direction of the box.
    pub ahead_m: [f64; 2],
    /// To the right of it.
    pub right_m: [f64; 2],
    /// Its top, over the floor.
    pub top_m: f64,
}

impl Extent {
    fn of(returns: &[&Return]) -> Self {
        let [mut least, mut most] = [[f64::INFINITY; 3], [f64::NEG_INFINITY; 3]];
        for one in returns {
            for axis in 0..3 {
                least[axis] = least[axis].min(one.point_m[axis]);
                most[axis] = most[axis].max(one.point_m[axis]);
            }
        }
        Self {
            ahead_m: [least[1], most[1]],
            right_m: [least[0], most[0]],
            top_m: most[2],
        }
    }
}

/// What is found out of a box, sweep by sweep.
#[derive(Clone, Debug)]
pub struct Trial {
    obstacle: Obstacle,
    /// How sweeps are made, where that is known.
    config: Option<Config>,
    /// What the sweeps show of the floor.
    floor: Option<FloorFinder>,
    /// What the newest header says of the height that labels took, if that is in doubt.
    doubt: Option<Finding>,
    /// Sweeps that were judged.
    sweeps: u32,
    /// Sweeps in which the height of the sensor was not known yet.
    without_height: u32,
    seen: BTreeMap<Seen, u32>,
    /// Sweeps in which the box is no obstacle, by what becomes of it.
    missed: BTreeMap<Seen, u32>,
    /// Sweeps in which it is one over the floor that is seen, and not over that of the mount.
    misplaced: u32,
    /// Of each sweep with returns on the box: how many, their rows, the front, its middle to the
    /// right, and its range from the sensor.
    returns: Vec<f64>,
    rows: Vec<f64>,
    fronts_m: Vec<f64>,
    rights_m: Vec<f64>,
    ranges_m: Vec<f64>,
    beams: Option<Beams>,
    joined: Option<Extent>,
    nearest: Option<Return>,
    /// Of the newest sweep that was judged: the way to the frame of the box, and where the sensor
    /// is from the robot's origin, metres.
    frame: Option<Pose>,
    position_m: [f32; 3],
    /// From the last shot on the box until it is known: as an object, and with its sweep.
    told_ns: Vec<f64>,
    with_sweep_ns: Vec<f64>,
    /// The least time by which arrivals are ahead of the sensor's clock, if that is GPS'.
    gps_behind_ns: Option<i64>,
}

impl Trial {
    /// Nothing is seen yet. `config` is what makes the sweeps, where it is known.
    pub fn new(obstacle: Obstacle, config: Option<Config>) -> Self {
        Self {
            obstacle,
            config,
            floor: None,
            doubt: None,
            sweeps: 0,
            without_height: 0,
            seen: BTreeMap::new(),
            missed: BTreeMap::new(),
            misplaced: 0,
            returns: Vec::new(),
            rows: Vec::new(),
            fronts_m: Vec::new(),
            rights_m: Vec::new(),
            ranges_m: Vec::new(),
            beams: None,
            joined: None,
            nearest: None,
            frame: None,
            position_m: [0.0; 3],
            told_ns: Vec::new(),
            with_sweep_ns: Vec::new(),
            gps_behind_ns: None,
        }
    }

    /// Whether enough sweeps are judged.
    pub fn is_over(&self) -> bool {
        self.sweeps >= SWEEPS
    }

    /// Sweeps that were judged so far.
    pub fn sweeps(&self) -> u32 {
        self.sweeps
    }

    /// Judges a labelled sweep that is known since this time, nanoseconds since 1970. Parts of a
    /// turn do not count, nor do sweeps before the sensor's height is known.
    pub fn look(&mut self, sweep: &SweepRef<'_>, known_ns: i64) {
        let header = sweep.header;
        if header.has(flags::PARTIAL) || self.is_over() {
            return;
        }
        self.doubt = floor::of_header(header);
        if header.height_m <= 0.0 {
            self.without_height += 1;
            return;
        }
        self.sweeps += 1;
        if header.time_source() == TimeSource::Gps {
            let end_ns = header.time_ns.saturating_add_unsigned(header.duration_ns);
            let behind_ns = header.arrival_ns.saturating_sub(end_ns);
            self.gps_behind_ns = Some(self.gps_behind_ns.map_or(behind_ns, |ns| ns.min(behind_ns)));
        }
        let mount = self.mount_of(header);
        let floor = self.floor.get_or_insert_with(|| {
            let set = self.config.as_ref().map(|config| config.segment.clone());
            FloorFinder::new(&segment::Config {
                mount,
                ..set.unwrap_or_default()
            })
        });
        floor.look(sweep);
        let frame = place::frame(header, floor.sight(), &self.obstacle);
        self.frame = Some(frame);
        self.position_m = header.position_m;
        if self.beams.is_none() {
            self.beams = Some(Beams::of(sweep, &frame, &self.obstacle));
        }
        let mut returns: Vec<Return> = sweep.returns().collect();
        for one in &mut returns {
            one.point_m = frame.apply(one.point_m);
        }
        let strikes = self.obstacle.strikes(&returns);
        if let Some(last_ns) = strikes.iter().map(|one| one.time_ns).max() {
            self.with_sweep_ns
                .push(known_ns.saturating_sub(last_ns) as f64);
        }
        let seen = self.judge(&returns, &strikes);
        *self.seen.entry(seen).or_default() += 1;
        let zone = self.obstacle.zone();
        // What `stop` asks, which knows the mount alone.
        let mount = self.obstacle.turned(Pose::of_mount(header));
        let on_floor = zone.on_floor(header.floor_m());
        let is_in = |pose: &Pose, zone: &Zone| {
            let found = sweep.obstacle_in(pose, zone, LeastReturns::default());
            found.is_some()
        };
        if is_in(&mount, &on_floor) {
            return;
        }
        match is_in(&frame, &zone) {
            true => self.misplaced += 1,
            false => *self.missed.entry(seen).or_default() += 1,
        }
    }

    /// The mount that is set.
    fn mount_of(&self, header: &Header) -> Mount {
        match &self.config {
            Some(config) => config.segment.mount,
            None => floor::mount_of(header),
        }
    }

    /// What becomes of the box in a sweep, of whose returns these strike it.
    fn judge(&mut self, returns: &[Return], strikes: &[Return]) -> Seen {
        let Some(front_m) = front_m(strikes) else {
            self.nearest = self.obstacle.nearest(returns).or(self.nearest);
            return Seen::Nothing;
        };
        let rows: BTreeSet<usize> = strikes.iter().map(|one| one.row).collect();
        let rights_m: Vec<f64> = strikes.iter().map(|one| one.point_m[0]).collect();
        let ranges_m: Vec<f64> = strikes.iter().map(|one| one.range_m.into()).collect();
        self.returns.push(strikes.len() as f64);
        self.rows.push(rows.len() as f64);
        self.fronts_m.push(front_m);
        self.rights_m.extend(median(&rights_m));
        self.ranges_m.extend(median(&ranges_m));
        let mut labels = BTreeMap::<u32, usize>::new();
        for one in strikes {
            *labels.entry(one.label).or_default() += 1;
        }
        let half = strikes.len().div_ceil(2);
        let objects = labels.range(LABEL_FIRST_SEGMENT..);
        if let Some((&label, &own)) = objects.max_by_key(|(_, count)| **count)
            && own >= half
        {
            let is_else =
                |one: &&Return| one.label == label && !self.obstacle.is_beside(one, front_m);
            let others: Vec<&Return> = returns.iter().filter(is_else).collect();
            if others.len() <= own / 4 {
                return Seen::Own;
            }
            self.joined = Some(Extent::of(&others));
            return Seen::Joined;
        }
        let count = |label| labels.get(&label).copied().unwrap_or(0);
        if count(LABEL_GROUND) >= half {
            Seen::Ground
        } else if count(LABEL_NONE) >= half {
            Seen::Unlabelled
        } else {
            Seen::Pieces
        }
    }

    /// Notes when the box is told among the objects that are known since this time, nanoseconds
    /// since 1970.
    pub fn told(&mut self, new: &NewObjects<'_>, known_ns: i64) {
        for object in new.objects {
            let middle_m = object.segment.centroid_in(self.frame.as_ref());
            if self.frame.is_some() && self.obstacle.holds(middle_m) {
                let last_ns = new.time_ns.saturating_add(object.last_ns.into());
                self.told_ns.push(known_ns.saturating_sub(last_ns) as f64);
            }
        }
    }

    /// What came of it.
    pub fn report(&self) -> Report {
        let behind_ns = self.gps_behind_ns.unwrap_or(0) as f64;
        let ms = |ns: f64| (ns - behind_ns) / 1e6;
        Report {
            obstacle: self.obstacle,
            sweeps: self.sweeps,
            as_obstacle: self.sweeps - self.misplaced - self.missed.values().sum::<u32>(),
            own: self.seen.get(&Seen::Own).copied().unwrap_or(0),
            seen: self.seen.clone(),
            returns: median(&self.returns),
            rows: median(&self.rows),
            front_m: median(&self.fronts_m),
            right_m: median(&self.rights_m),
            joined: self.joined,
            told: self.told_ns.len(),
            told_ms: median(&self.told_ns).map(ms),
            told_most_ms: quantile(&self.told_ns, 1.0).map(ms),
            with_sweep_ms: median(&self.with_sweep_ns).map(ms),
        }
    }
}

/// What came of a trial; medians of the sweeps where nothing else is said, `None` where there is
/// nothing to tell.
#[derive(Clone, Debug, Serialize)]
pub struct Report {
    /// The box.
    pub obstacle: Obstacle,
    /// Sweeps that were judged.
    pub sweeps: u32,
    /// Sweeps in which the box is an obstacle: what stops a robot.
    pub as_obstacle: u32,
    /// Sweeps in which the box is an object of its own.
    pub own: u32,
    /// Sweeps by what becomes of the box.
    pub seen: BTreeMap<Seen, u32>,
    /// Returns on it.
    pub returns: Option<f64>,
    /// Rows that strike it.
    pub rows: Option<f64>,
    /// From the robot's origin to its front, metres.
    pub front_m: Option<f64>,
    /// Its middle to the right of where it should be, metres.
    pub right_m: Option<f64>,
    /// What else is in its object, in the newest sweep where something is.
    pub joined: Option<Extent>,
    /// How often it was told as an object: twice a turn where it stands across the cut.
    pub told: usize,
    /// From its last beam until it is known as an object, milliseconds.
    pub told_ms: Option<f64>,
    /// The same, longest.
    pub told_most_ms: Option<f64>,
    /// From its last beam until its sweep is known, milliseconds.
    pub with_sweep_ms: Option<f64>,
}

impl Report {
    /// Whether the box is an obstacle often enough.
    pub fn is_well(&self) -> bool {
        self.sweeps > 0 && 100 * self.as_obstacle >= ENOUGH_PERCENT * self.sweeps
    }
}
