//! A real scan through the packet path: the points of a KITTI cloud as the returns of an HDL-64E.
//!
//! ```text
//! points -> rings -> rows        whose ring it is: elevation by elevation
//!           rings -> fit         elevation and vertical offset of each beam, from its ring
//!           rings -> places      which column of the turn each point is in, and so which firing of its beam
//!           range -> distance    the correction formulas, solved for the raw distance
//!                     Turn -> Sender -> packets, each return with the index of its point
//! ```
//!
//! A cloud does not contain its sensor's rotations, distance offsets and columns. So the packets
//! are those of a unit with a given calibration that sees this scan. Since its elevations are those
//! of another unit, flat ground is bent: [`Options::fit`] fits them to the scan.
//!
//! The columns are those onto which `sweepd segment` projects the scan, and rows are shifted by
//! whole columns as in a sweep. So both paths give the same image, and their results can be
//! compared. The cost: a beam points up to half a column beside its column, and starts beside the
//! axis, so that points return at their range but shifted sideways by that much.

mod error;
mod rows;
mod send;

use std::f64::consts::TAU;

pub use self::error::FromCloudError;
use self::rows::RingPlace;
pub use self::send::{Sender, Sending};
use super::beam::Laser;
use super::shape::Vec3;
use crate::cloud::fit::{self, Prior, Sample};
use crate::cloud::rings::{self, Polar, Ring};
use crate::cloud::{COLUMNS, places};
use sweepd_core::sensor::model::Spec;
use sweepd_core::sensor::{Beam, Calibration, Model, ModelExt};
use sweepd_core::wire::data::ReturnMode;

/// The sensor: the scans are those of an S2.
pub const MODEL: Model = Model::Hdl64eS2;
/// What it reports: one return a shot.
pub const MODE: ReturnMode = ReturnMode::Strongest;
/// Turns a minute that a sensor can make.
const RPM: [f64; 2] = [300.0, 1200.0];
/// Usual speed of a scan, turns a minute.
const DEFAULT_RPM: f64 = 600.0;
/// Spread of vertical offsets between units, metres.
const OFFSET_SPREAD_M: f64 = 0.03;

/// How a cloud is encoded.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Options {
    /// Fit elevation and vertical offset of each beam to the scan.
    pub fit: bool,
    /// Turns a minute; `None` for 600, whose columns are those of `sweepd segment`.
    pub rpm: Option<f64>,
}

/// Counts of the points of a cloud.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Report {
    /// Points of the file.
    pub points: usize,
    /// Rings of the file.
    pub rings: usize,
    /// Firings of the turn.
    pub firings: usize,
    /// Points that have a firing and are in the packets.
    pub encoded: usize,
    /// Those of them that are within half a pitch of the azimuth of their beam.
    pub within: usize,
    /// Points hidden by a nearer one in their column.
    pub hidden: usize,
    /// Points that have a firing, but are nearer or farther than the sensor can report.
    pub out_of_reach: usize,
    /// Points that are not finite, or on the sensor's axis.
    pub void: usize,
}

impl std::fmt::Display for Report {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self {
            points,
            rings,
            firings,
            encoded,
            within,
            hidden,
            out_of_reach,
            void,
        } = self;
        let percent = 100.0 * *encoded as f64 / (*points).max(1) as f64;
        let farther = encoded - within;
        write!(
            f,
            "{points} points in {rings} rings, {firings} firings a turn; {encoded} have a firing ({percent:.1} %), \
             {within} within half a pitch of its beam and {farther} farther; left out: {hidden} that share the firing of \
             a nearer point, {out_of_reach} out of the sensor's reach, {void} void"
        )
    }
}

/// A turn of the sensor: the returns of each firing.
#[derive(Debug)]
pub struct Turn {
    calibration: Calibration,
    spec: &'static Spec,
    firings: usize,
    /// By firing, then channel.
    echoes: Vec<Option<Echo>>,
    report: Report,
}

/// A point as the sensor reports it.
#[derive(Clone, Copy, Debug)]
struct Echo {
    /// Index in the cloud.
    point: u32,
    distance: u16,
    reflectivity: u8,
    /// From the origin of the beam.
    range_m: f64,
}

/// A ring, and the row of its beam.
struct RowRing<'a> {
    row: usize,
    points: &'a [[f32; 4]],
    /// Index of the first of the points.
    first: usize,
}

impl Turn {
    /// Encodes the points of a KITTI cloud: x forward, y left, z up, metres, and remission, 0 to 1;
    /// ring after ring.
    ///
    /// # Errors
    /// [`FromCloudError`]: points in another order, too many rings, or the wrong sensor.
    pub fn new(
        points: &[[f32; 4]],
        calibration: &Calibration,
        options: Options,
    ) -> Result<Self, FromCloudError> {
        let spec = MODEL.spec();
        let calibration = calibration
            .clone()
            .for_model(MODEL)
            .map_err(FromCloudError::Calibration)?;
        let mut beams: Vec<Beam> = calibration
            .rows()
            .iter()
            .map(|&channel| calibration.beams()[channel])
            .collect();
        let unit_m = calibration.distance_unit_m();
        let rings = row_rings(points, &beams)?;
        if options.fit {
            beams = fitted(&rings, &beams, unit_m);
        }
        let calibration =
            Calibration::new(beams.clone(), unit_m).map_err(FromCloudError::Calibration)?;
        let firings = firings_of(spec, options.rpm.unwrap_or(DEFAULT_RPM));
        let report = Report {
            points: points.len(),
            rings: rings.len(),
            firings,
            ..Report::default()
        };
        let echoes = vec![None; firings * spec.channels];
        let mut turn = Self {
            calibration,
            spec,
            firings,
            echoes,
            report,
        };
        rings
            .iter()
            .for_each(|ring| turn.place(ring, &beams[ring.row]));
        Ok(turn)
    }

    /// The calibration to decode the packets with.
    pub fn calibration(&self) -> &Calibration {
        &self.calibration
    }

    /// What became of the points.
    pub fn report(&self) -> &Report {
        &self.report
    }

    /// Turns a minute.
    pub fn rpm(&self) -> f64 {
        60e9 / (self.firings as f64 * f64::from(self.spec.firing_period_ns(MODE)))
    }

    /// Azimuth of the head at the first shot of a firing as the packets have it, hundredths of a
    /// degree. The turn begins half a pitch behind azimuth 0, so that no rounding moves a firing
    /// over the cut.
    fn azimuth_cdeg(&self, firing: usize) -> u16 {
        (36_000.0 * (firing as f64 + 0.5) / self.firings as f64).round() as u16
    }

    /// Shot of a channel after the first of its firing, firings.
    fn shot_offset(&self, channel: usize) -> f64 {
        f64::from(self.spec.channel_offset_ns(channel, MODE))
            / f64::from(self.spec.firing_period_ns(MODE))
    }

    /// Azimuth of the head at a shot, radians.
    fn head_rad(&self, firing: usize, channel: usize) -> f64 {
        let first_rad = (f64::from(self.azimuth_cdeg(firing)) / 100.0).to_radians();
        first_rad + self.shot_offset(channel) / self.firings as f64 * TAU
    }

    /// Azimuth of a beam at its shot, radians from 0 to a whole turn.
    fn beam_rad(&self, firing: usize, channel: usize) -> f64 {
        (self.head_rad(firing, channel) - self.calibration.beams()[channel].rotation_rad)
            .rem_euclid(TAU)
    }

    /// Gives the points of a ring to the firings of its beam.
    fn place(&mut self, ring: &RowRing<'_>, beam: &Beam) {
        let turn = self.firings as f64;
        // Firings by which the beam is turned back from the head.
        let behind = beam.rotation_rad / TAU * turn - self.shot_offset(beam.channel);
        let laser = Laser::new(beam, self.calibration.distance_unit_m());
        let polars: Vec<Option<Polar>> =
            ring.points.iter().map(|&point| Polar::of(point)).collect();
        let shown = places::shown(&polars, self.firings);
        let there = polars.iter().flatten().count();
        self.report.void += polars.len() - there;
        self.report.hidden += there - shown.iter().flatten().count();
        for (column, point) in shown.into_iter().enumerate() {
            let Some((point, polar)) = point.and_then(|point| Some((point, polars[point]?))) else {
                continue;
            };
            let firing =
                (column as i64 + behind.round() as i64).rem_euclid(self.firings as i64) as usize;
            let Some(echo) = self.echo(
                &laser,
                firing,
                beam.channel,
                polar,
                ring.points[point][3],
                ring.first + point,
            ) else {
                self.report.out_of_reach += 1;
                continue;
            };
            let off = (polar.position(self.firings) + behind - firing as f64).rem_euclid(turn);
            self.report.within += usize::from(off.min(turn - off) <= 0.5);
            self.report.encoded += 1;
            self.echoes[firing * self.spec.channels + beam.channel] = Some(echo);
        }
    }

    /// The return of a point in a firing.
    fn echo(
        &self,
        laser: &Laser,
        firing: usize,
        channel: usize,
        polar: Polar,
        remission: f32,
        point: usize,
    ) -> Option<Echo> {
        let aim = laser.aimed(self.head_rad(firing, channel));
        let (sin, cos) = polar.azimuth_rad.sin_cos();
        let range_m =
            (Vec3::new(polar.away_m * sin, polar.away_m * cos, polar.z_m) - aim.origin).norm();
        let distance_m = aim.distance_m(range_m);
        if !aim.is_sayable(distance_m) {
            return None;
        }
        let units = aim.units(distance_m, 0.0).clamp(1.0, f64::from(u16::MAX));
        // A remission that is not a number becomes 0.
        let reflectivity = (f64::from(remission) * 255.0).round().clamp(0.0, 255.0) as u8;
        let reflectivity = aim.intensity_byte(units, reflectivity);
        Some(Echo {
            point: u32::try_from(point).ok()?,
            distance: units as u16,
            reflectivity,
            range_m,
        })
    }

    /// The return of a channel in a firing.
    fn at(&self, firing: usize, channel: usize) -> Option<&Echo> {
        self.echoes[firing * self.spec.channels + channel].as_ref()
    }
}

/// The rings of a cloud, each with its row, from the top.
fn row_rings<'a>(
    points: &'a [[f32; 4]],
    rows: &[Beam],
) -> Result<Vec<RowRing<'a>>, FromCloudError> {
    let mut rings: Vec<Ring> = Vec::new();
    rings::find(points, COLUMNS, &mut rings)?;
    rings.retain(|ring| {
        points[ring.first..ring.end]
            .iter()
            .any(|&point| Polar::of(point).is_some())
    });
    if rings.is_empty() {
        return Err(FromCloudError::Empty);
    }
    let mut scratch = Vec::new();
    for ring in &mut rings {
        ring.measure(points, &mut scratch);
    }
    rings.sort_by(|a, b| b.elevation_rad.total_cmp(&a.elevation_rad));
    let places: Vec<RingPlace> = rings.iter().map(|ring| place(ring, points)).collect();
    let rows = rows::of_rings(&places, rows)?;
    Ok(rings
        .iter()
        .zip(rows)
        .map(|(ring, row)| RowRing {
            row,
            points: &points[ring.first..ring.end],
            first: ring.first,
        })
        .collect())
}

/// Elevation and median distance of a ring, which has points.
fn place(ring: &Ring, points: &[[f32; 4]]) -> RingPlace {
    let polars = points[ring.first..ring.end]
        .iter()
        .filter_map(|&point| Polar::of(point));
    let mut away_m: Vec<f64> = polars.map(|polar| polar.away_m).collect();
    let middle = away_m.len() / 2;
    RingPlace {
        elevation_rad: ring.elevation_rad,
        away_m: *away_m.select_nth_unstable_by(middle, f64::total_cmp).1,
    }
}

/// The beams of all rows, with elevations and vertical offsets fitted to the rings.
fn fitted(rings: &[RowRing<'_>], rows: &[Beam], unit_m: f64) -> Vec<Beam> {
    let mut fits = vec![None; rows.len()];
    for ring in rings {
        let beam = &rows[ring.row];
        let laser = Laser::new(beam, unit_m);
        let samples: Vec<Sample> = ring
            .points
            .iter()
            .filter_map(|&point| sample(beam, &laser, Polar::of(point)?))
            .collect();
        let prior = Prior {
            offset_m: beam.vertical_offset_m,
            spread_m: OFFSET_SPREAD_M,
        };
        fits[ring.row] = fit::fit(prior, &samples).map(|line| Beam {
            elevation_rad: line.slope.atan(),
            vertical_offset_m: line.offset_m,
            ..*beam
        });
    }
    rows::complete(rows, &fits)
}

/// A point in the plane of its beam, as it would be if the beam were straight: the two-point
/// correction moves the horizontal and the vertical part of a point differently, so that a beam
/// rises more steeply than its elevation says.
fn sample(beam: &Beam, laser: &Laser, polar: Polar) -> Option<Sample> {
    let aside_m = beam.horizontal_offset_m;
    let away_m = (polar.away_m.powi(2) - aside_m.powi(2)).max(0.0).sqrt();
    let towards_rad = polar.azimuth_rad + (aside_m / polar.away_m).clamp(-1.0, 1.0).asin();
    let aim = laser.aimed(towards_rad + beam.rotation_rad);

    let (bent, _) = aim.towards_range(away_m.hypot(polar.z_m - beam.vertical_offset_m));
    let steeper = rise(bent) / rise(aim.straight);
    let away_m = if steeper > 0.0 && steeper.is_finite() {
        away_m * steeper
    } else {
        away_m
    };
    (away_m > 0.0).then_some(Sample {
        away_m,
        z_m: polar.z_m,
    })
}

/// How steeply a direction rises.
fn rise(direction: Vec3) -> f64 {
    direction.z / direction.x.hypot(direction.y)
}

/// Firings of a turn.
fn firings_of(spec: &Spec, rpm: f64) -> usize {
    (60e9 / (rpm.clamp(RPM[0], RPM[1]) * f64::from(spec.firing_period_ns(MODE)))).round() as usize
}
