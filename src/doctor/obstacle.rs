//! Whether a sensor on its robot sees a box of known size and place as an object of its own: pure.
//!
//! ```text
//! place      sweep -> returns in the box's place, over the floor that is seen around it
//! Trial      sweeps, objects -> what becomes of the box, sweep by sweep
//! findings   Trial -> what to change
//! sources    a capture, ports or a running daemon -> Trial
//! ```

mod findings;
mod place;
pub mod sources;

use std::collections::BTreeMap;
use std::fmt;
use std::str::FromStr;

use serde::Serialize;

use place::{Beams, Floor, Placed, front_m, quantile};
use sweepd_core::segment;
use sweepd_core::sweep::layout::{
    LABEL_FIRST_SEGMENT, LABEL_GROUND, LABEL_NONE, TimeSource, flags,
};
use sweepd_core::sweep::objects::NewObjects;
use sweepd_core::sweep::{Header, Pose, SweepRef};

/// Sweeps that are judged at most.
pub const SWEEPS: u32 = 100;
/// Percent of the sweeps in which the box must be an object of its own.
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
    /// Fewer returns than a segment needs.
    TooFew,
    /// Most of its returns are nearer than `min_range_m`.
    TooNear,
    /// Most of its returns are farther than `max_range_m`.
    TooFar,
    /// The mask hides most of its returns.
    Masked,
    /// Most of its returns have no label, for a reason that is not known here.
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
            Self::TooFew => "too few returns",
            Self::TooNear => "nearer than min_range_m",
            Self::TooFar => "farther than max_range_m",
            Self::Masked => "hidden by the mask",
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
    fn of(returns: &[&Placed], floor: &Floor) -> Self {
        let ends = |of: fn(&Placed) -> f64| {
            let values = returns.iter().map(|one| of(one));
            [
                values.clone().fold(f64::INFINITY, f64::min),
                values.fold(f64::NEG_INFINITY, f64::max),
            ]
        };
        let tops_m = returns.iter().map(|one| one.up_m - floor.at(one.ahead_m));
        Self {
            ahead_m: ends(|one| one.ahead_m),
            right_m: ends(|one| one.right_m),
            top_m: tops_m.fold(f64::NEG_INFINITY, f64::max),
        }
    }
}

/// What is found out of a box, sweep by sweep.
#[derive(Clone, Debug)]
pub struct Trial {
    obstacle: Obstacle,
    /// What the sweeps are segmented with, where it is known.
    settings: Option<segment::Config>,
    /// Sweeps that were judged.
    sweeps: u32,
    /// Sweeps in which the height of the sensor was not known yet.
    without_height: u32,
    seen: BTreeMap<Seen, u32>,
    /// Of each sweep with returns on the box: how many, their rows, the front, and its middle to
    /// the right.
    returns: Vec<f64>,
    rows: Vec<f64>,
    fronts_m: Vec<f64>,
    rights_m: Vec<f64>,
    /// The floor of each sweep that shows it.
    floors_up_m: Vec<f64>,
    floors_rise: Vec<f64>,
    beams: Option<Beams>,
    joined: Option<Extent>,
    nearest: Option<Placed>,
    /// Of the newest sweep that was judged.
    newest: Option<Newest>,
    /// From the last shot on the box until it is known: as an object, and with its sweep.
    told_ns: Vec<f64>,
    with_sweep_ns: Vec<f64>,
    /// The least time by which arrivals are ahead of the sensor's clock, if that is GPS'.
    gps_behind_ns: Option<i64>,
}

#[derive(Clone, Copy, Debug)]
struct Newest {
    header: Header,
    frame: Pose,
    floor: Floor,
}

impl Trial {
    /// Nothing is seen yet. `settings` are those of the segmenter, where they are known.
    pub fn new(obstacle: Obstacle, settings: Option<segment::Config>) -> Self {
        Self {
            obstacle,
            settings,
            sweeps: 0,
            without_height: 0,
            seen: BTreeMap::new(),
            returns: Vec::new(),
            rows: Vec::new(),
            fronts_m: Vec::new(),
            rights_m: Vec::new(),
            floors_up_m: Vec::new(),
            floors_rise: Vec::new(),
            beams: None,
            joined: None,
            nearest: None,
            newest: None,
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
        let Some(frame) = place::frame(header, &self.obstacle) else {
            self.without_height += 1;
            return;
        };
        self.sweeps += 1;
        if header.time_source() == TimeSource::Gps {
            let end_ns = header.time_ns.saturating_add_unsigned(header.duration_ns);
            let behind_ns = header.arrival_ns.saturating_sub(end_ns);
            self.gps_behind_ns = Some(self.gps_behind_ns.map_or(behind_ns, |ns| ns.min(behind_ns)));
        }
        let returns = place::placed(sweep, &frame);
        let seen_floor = self.obstacle.floor(&returns);
        if let Some(floor) = seen_floor {
            self.floors_up_m.push(floor.up_m);
            self.floors_rise.push(floor.rise);
        }
        let floor = seen_floor.unwrap_or_default();
        if self.beams.is_none() {
            self.beams = Some(Beams::of(sweep, &frame, &self.obstacle, &floor));
        }
        self.newest = Some(Newest {
            header: *header,
            frame,
            floor,
        });
        let strikes = self.obstacle.strikes(&returns, &floor);
        if let Some(last_ns) = strikes.iter().map(|one| one.of.time_ns).max() {
            let delay_ns = known_ns.saturating_sub(last_ns);
            self.with_sweep_ns.push(delay_ns as f64);
        }
        let seen = self.judge(&returns, &strikes, &floor);
        *self.seen.entry(seen).or_default() += 1;
    }

    /// What becomes of the box in a sweep, of whose returns these strike it.
    fn judge(&mut self, returns: &[Placed], strikes: &[Placed], floor: &Floor) -> Seen {
        let Some(front_m) = front_m(strikes) else {
            self.nearest = self.obstacle.nearest(returns, floor).or(self.nearest);
            return Seen::Nothing;
        };
        let mut rows: Vec<usize> = strikes.iter().map(|one| one.of.row).collect();
        rows.sort_unstable();
        rows.dedup();
        self.returns.push(strikes.len() as f64);
        self.rows.push(rows.len() as f64);
        self.fronts_m.push(front_m);
        let mut rights_m: Vec<f64> = strikes.iter().map(|one| one.right_m).collect();
        self.rights_m.extend(quantile(&mut rights_m, 0.5));
        let mut labels = BTreeMap::<u32, usize>::new();
        for one in strikes {
            *labels.entry(one.of.label).or_default() += 1;
        }
        let half = strikes.len().div_ceil(2);
        let objects = labels.range(LABEL_FIRST_SEGMENT..);
        if let Some((&label, &own)) = objects.max_by_key(|(_, count)| **count)
            && own >= half
        {
            let is_else = |one: &&Placed| {
                one.of.label == label && !self.obstacle.is_beside(one, front_m, floor)
            };
            let others: Vec<&Placed> = returns.iter().filter(is_else).collect();
            if others.len() <= own / 4 {
                return Seen::Own;
            }
            self.joined = Some(Extent::of(&others, floor));
            return Seen::Joined;
        }
        let count = |label| labels.get(&label).copied().unwrap_or(0);
        if count(LABEL_GROUND) >= half {
            Seen::Ground
        } else if count(LABEL_NONE) >= half {
            self.why_unlabelled(strikes)
        } else {
            Seen::Pieces
        }
    }

    /// Why the returns on the box have no label.
    fn why_unlabelled(&self, strikes: &[Placed]) -> Seen {
        let usual = segment::Config::default();
        let settings = self.settings.as_ref().unwrap_or(&usual);
        let is_most = |is_so: &dyn Fn(&Placed) -> bool| {
            2 * strikes.iter().filter(|one| is_so(one)).count() >= strikes.len()
        };
        if is_most(&|one| one.of.range_m < settings.min_range_m) {
            Seen::TooNear
        } else if is_most(&|one| one.of.range_m > settings.max_range_m) {
            Seen::TooFar
        } else if let Some(mask) = &settings.mask
            && is_most(&|one| mask.hides(one.of.row, one.of.azimuth_rad))
        {
            Seen::Masked
        } else if strikes.len() < settings.min_points as usize {
            Seen::TooFew
        } else {
            Seen::Unlabelled
        }
    }

    /// Notes when the box is told among the objects that are known since this time, nanoseconds
    /// since 1970.
    pub fn told(&mut self, new: &NewObjects<'_>, known_ns: i64) {
        let Some(Newest { frame, floor, .. }) = self.newest else {
            return;
        };
        for object in new.objects {
            let middle = frame.apply(object.segment.centroid_m.map(f64::from));
            let up_m = middle[2] - floor.at(middle[1]);
            if self.obstacle.holds(middle[0], middle[1], up_m) {
                let last_ns = new.time_ns.saturating_add(object.last_ns.into());
                self.told_ns.push(known_ns.saturating_sub(last_ns) as f64);
            }
        }
    }

    /// What came of it.
    pub fn report(&self) -> Report {
        let median = |of: &[f64]| quantile(&mut of.to_vec(), 0.5);
        let behind_ns = self.gps_behind_ns.unwrap_or(0) as f64;
        let ms = |ns: f64| (ns - behind_ns) / 1e6;
        let floor = median(&self.floors_up_m).zip(median(&self.floors_rise));
        Report {
            obstacle: self.obstacle,
            sweeps: self.sweeps,
            own: self.seen.get(&Seen::Own).copied().unwrap_or(0),
            seen: self.seen.clone(),
            returns: median(&self.returns),
            rows: median(&self.rows),
            front_m: median(&self.fronts_m),
            right_m: median(&self.rights_m),
            floor_m: floor.map(|(up_m, rise)| up_m + rise * self.obstacle.distance_m),
            floor_rise_deg: floor.map(|(_, rise)| rise.atan().to_degrees()),
            joined: self.joined,
            told: self.told_ns.len(),
            told_ms: median(&self.told_ns).map(ms),
            told_most_ms: quantile(&mut self.told_ns.clone(), 1.0).map(ms),
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
    /// How high the floor lies there by the mount, metres: 0 if the mount is right.
    pub floor_m: Option<f64>,
    /// How much the floor rises towards it by the mount, degrees: 0 if the mount is right.
    pub floor_rise_deg: Option<f64>,
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
    /// Whether the box is an object of its own often enough.
    pub fn is_well(&self) -> bool {
        self.sweeps > 0 && 100 * self.own >= ENOUGH_PERCENT * self.sweeps
    }
}
