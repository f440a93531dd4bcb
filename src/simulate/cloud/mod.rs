//! A real scan through the packet path: the points of a KITTI cloud as the returns of an HDL-64E.
//!
//! ```text
//! points -> rings -> rows        whose ring it is: elevation by elevation
//!           rings -> fit         elevation and vertical offset of each beam, from its ring
//!           rings -> places      which firing of the turn each point goes to
//!           range -> distance    the correction formulas, solved for the raw distance
//!                     Turn -> Sender -> packets, each return with the index of its point
//! ```
//!
//! A cloud has lost what its sensor was: rotations, distance offsets and the columns. So the unit is one whose
//! calibration is given, and the scan is what that unit would have seen. Its elevations are another unit's, and bend
//! flat ground: [`Options::fit`] takes those of the scan.

mod distance;
mod fit;
mod rows;
mod send;

use std::f64::consts::TAU;

use self::distance::{raw_distance, steepness};
use self::fit::Sample;
use self::rows::RingPlace;
pub use self::send::{Sender, Sending};
use crate::cloud::rings::{self, Polar, Ring};
use crate::cloud::{COLUMNS, CloudError, places};
use crate::sensor::model::Spec;
use crate::sensor::{Beam, Calibration, Model};
use crate::wire::data::ReturnMode;

/// The sensor: the scans are those of an S2.
pub const MODEL: Model = Model::Hdl64eS2;
/// What it reports: one return a shot.
pub const MODE: ReturnMode = ReturnMode::Strongest;
/// Turns a minute that a sensor can make.
const RPM: [f64; 2] = [300.0, 1200.0];

/// Why a cloud cannot be encoded.
#[derive(Debug, thiserror::Error)]
pub enum FromCloudError {
    /// No cloud in the order of its rings.
    #[error(transparent)]
    Cloud(#[from] CloudError),
    /// Nothing to encode.
    #[error("no points")]
    Empty,
    /// More rings than beams.
    #[error("{found} rings, the HDL-64E has {beams} beams")]
    Rings {
        /// Rings of the cloud.
        found: usize,
        /// Beams of the sensor.
        beams: usize,
    },
    /// A ring is nowhere near the beam that it would have to be of.
    #[error(
        "a ring at {ring_deg:.2} degrees would be that of the beam at {beam_deg:.2}; the cloud is of another sensor, or \
         the calibration is"
    )]
    Apart {
        /// Median elevation of the ring, degrees.
        ring_deg: f64,
        /// Elevation of the beam by the calibration, degrees.
        beam_deg: f64,
    },
    /// A calibration that is not one of an HDL-64E, or that its status stream cannot carry.
    #[error("the calibration: {0}")]
    Calibration(String),
}

/// How a cloud is encoded.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Options {
    /// Fit elevation and vertical offset of each beam to the scan.
    pub fit: bool,
    /// Turns a minute; `None` for those of the scan, of which the points of its fullest ring tell.
    pub rpm: Option<f64>,
}

/// What became of the points of a cloud.
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
    /// Those of them that are more than half a pitch from their firing, since another point has the nearest one.
    pub moved: usize,
    /// Points all of whose firings within a pitch have other points.
    pub taken: usize,
    /// Points that have a firing, but are nearer or farther than the sensor can report.
    pub out_of_reach: usize,
    /// Points that are not finite, or on the sensor's axis.
    pub void: usize,
}

impl std::fmt::Display for Report {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { points, rings, firings, encoded, moved, taken, out_of_reach, void } = self;
        let percent = 100.0 * *encoded as f64 / (*points).max(1) as f64;
        write!(
            f,
            "{points} points in {rings} rings, {firings} firings a turn; encoded {encoded} ({percent:.1} %), {moved} of \
             them in the firing beside their own; not encoded: {taken} whose firings have other points, {out_of_reach} \
             out of the sensor's reach, {void} void"
        )
    }
}

/// A turn of the sensor: what each of its firings reports.
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
    /// Encodes the points of a KITTI cloud: x forward, y left, z up, metres, and remission, 0 to 1; ring after ring.
    ///
    /// # Errors
    /// [`FromCloudError`]: points in another order, too many rings, or the wrong sensor.
    pub fn new(points: &[[f32; 4]], calibration: &Calibration, options: Options) -> Result<Self, FromCloudError> {
        let spec = MODEL.spec();
        let calibration = calibration.clone().for_model(MODEL).map_err(FromCloudError::Calibration)?;
        let mut beams: Vec<Beam> = calibration.rows().iter().map(|&channel| calibration.beams()[channel]).collect();
        let rings = row_rings(points, &beams)?;
        if options.fit {
            beams = fitted(&rings, &beams);
        }
        let unit_m = calibration.distance_unit_m();
        let calibration = Calibration::new(beams.clone(), unit_m).map_err(FromCloudError::Calibration)?;
        let fullest = rings.iter().map(|ring| ring.points.len()).max().unwrap_or(0);
        let firings = firings_of(spec, fullest, options.rpm);
        let report = Report { points: points.len(), rings: rings.len(), firings, ..Report::default() };
        let echoes = vec![None; firings * spec.channels];
        let mut turn = Self { calibration, spec, firings, echoes, report };
        rings.iter().for_each(|ring| turn.place(ring, &beams[ring.row]));
        Ok(turn)
    }

    /// The calibration that the packets are to be decoded with.
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

    /// Azimuth of the head at the first shot of a firing as the packets have it, hundredths of a degree. The turn begins
    /// half a pitch behind azimuth 0, so that no rounding moves a firing over the cut.
    fn azimuth_cdeg(&self, firing: usize) -> u16 {
        (36_000.0 * (firing as f64 + 0.5) / self.firings as f64).round() as u16
    }

    /// Shot of a channel after the first of its firing, firings.
    fn shot_offset(&self, channel: usize) -> f64 {
        f64::from(self.spec.channel_offset_ns(channel, MODE)) / f64::from(self.spec.firing_period_ns(MODE))
    }

    /// Azimuth of the head at a shot, radians.
    fn head_rad(&self, firing: usize, channel: usize) -> f64 {
        let first_rad = (f64::from(self.azimuth_cdeg(firing)) / 100.0).to_radians();
        first_rad + self.shot_offset(channel) / self.firings as f64 * TAU
    }

    /// Gives the points of a ring to the firings of its beam.
    fn place(&mut self, ring: &RowRing<'_>, beam: &Beam) {
        let (firings, offset) = (self.firings as f64, self.shot_offset(beam.channel));
        let position = |polar: Polar| {
            let turns = (beam_azimuth_rad(beam, polar) + beam.rotation_rad) / TAU;
            (turns * firings - offset - 0.5).rem_euclid(firings)
        };
        let polars: Vec<Option<Polar>> = ring.points.iter().map(|&point| Polar::of(point)).collect();
        let positions: Vec<f64> = polars.iter().map(|polar| polar.map_or(f64::NAN, position)).collect();
        let places = places::of_ring(&positions, self.firings);
        for (index, (polar, firing)) in polars.into_iter().zip(places).enumerate() {
            let (Some(polar), Some(firing)) = (polar, firing) else {
                let lost = if polar.is_some() { &mut self.report.taken } else { &mut self.report.void };
                *lost += 1;
                continue;
            };
            let Some(echo) = self.echo(beam, firing, polar, ring.points[index][3], ring.first + index) else {
                self.report.out_of_reach += 1;
                continue;
            };
            let off = (positions[index] - firing as f64).rem_euclid(firings);
            self.report.moved += usize::from(off.min(firings - off) > 0.5);
            self.report.encoded += 1;
            self.echoes[firing * self.spec.channels + beam.channel] = Some(echo);
        }
    }

    /// What a beam reports of a point.
    fn echo(&self, beam: &Beam, firing: usize, polar: Polar, remission: f32, point: usize) -> Option<Echo> {
        let azimuth_rad = self.head_rad(firing, beam.channel) - beam.rotation_rad;
        let (sin, cos) = azimuth_rad.sin_cos();
        let (x, y) = (polar.away_m * polar.azimuth_rad.sin(), polar.away_m * polar.azimuth_rad.cos());
        let beside_m = beam.horizontal_offset_m;
        let level_m = (x + beside_m * cos).hypot(y - beside_m * sin);
        let range_m = level_m.hypot(polar.z_m - beam.vertical_offset_m);
        let distance = raw_distance(beam, self.calibration.distance_unit_m(), azimuth_rad, range_m)?;
        // A remission that is none is 0.
        let reflectivity = (f64::from(remission) * 255.0).round().clamp(0.0, 255.0) as u8;
        Some(Echo { point: u32::try_from(point).ok()?, distance, reflectivity, range_m })
    }

    /// What a channel reports in a firing.
    fn at(&self, firing: usize, channel: usize) -> Option<&Echo> {
        self.echoes[firing * self.spec.channels + channel].as_ref()
    }
}

/// Where a beam must point to hit what is there, radians: it starts beside the axis.
fn beam_azimuth_rad(beam: &Beam, polar: Polar) -> f64 {
    polar.azimuth_rad + (beam.horizontal_offset_m / polar.away_m).clamp(-1.0, 1.0).asin()
}

/// The rings of a cloud, each with its row, from the top.
fn row_rings<'a>(points: &'a [[f32; 4]], rows: &[Beam]) -> Result<Vec<RowRing<'a>>, FromCloudError> {
    let (mut rings, mut scratch) = (Vec::<Ring>::new(), Vec::new());
    rings::find(points, COLUMNS, &mut rings)?;
    rings.retain(|ring| points[ring.first..ring.end].iter().any(|&point| Polar::of(point).is_some()));
    if rings.is_empty() {
        return Err(FromCloudError::Empty);
    }
    rings.iter_mut().for_each(|ring| ring.measure(points, &mut scratch));
    rings.sort_by(|a, b| b.elevation_rad.total_cmp(&a.elevation_rad));
    let place = |ring: &Ring| {
        let polars = points[ring.first..ring.end].iter().filter_map(|&point| Polar::of(point));
        let mut away_m: Vec<f64> = polars.map(|polar| polar.away_m).collect();
        let middle = away_m.len() / 2;
        RingPlace {
            elevation_rad: ring.elevation_rad,
            away_m: *away_m.select_nth_unstable_by(middle, f64::total_cmp).1,
        }
    };
    let places: Vec<RingPlace> = rings.iter().map(place).collect();
    let rows = rows::of_rings(&places, rows)?;
    let ring = |(ring, row): (&Ring, usize)| RowRing { row, points: &points[ring.first..ring.end], first: ring.first };
    Ok(rings.iter().zip(rows).map(ring).collect())
}

/// The beams of all rows, with elevations and vertical offsets as the rings have them.
fn fitted(rings: &[RowRing<'_>], rows: &[Beam]) -> Vec<Beam> {
    let mut fits = vec![None; rows.len()];
    for ring in rings {
        let beam = &rows[ring.row];
        let sample = |polar: Polar| {
            let away_m = (polar.away_m.powi(2) - beam.horizontal_offset_m.powi(2)).max(0.0).sqrt();
            let range_m = away_m.hypot(polar.z_m - beam.vertical_offset_m);
            let away_m = away_m * steepness(beam, beam_azimuth_rad(beam, polar), range_m);
            (away_m > 0.0).then_some(Sample { away_m, z_m: polar.z_m })
        };
        let samples: Vec<Sample> = ring.points.iter().filter_map(|&point| sample(Polar::of(point)?)).collect();
        fits[ring.row] = fit::fit(beam, &samples);
    }
    fit::complete(rows, &fits)
}

/// Firings of a turn: as many as the fullest ring of the scan has points, if that says anything; a scan of which no ring
/// is full comes from a sensor at 10 turns a second.
fn firings_of(spec: &Spec, fullest: usize, rpm: Option<f64>) -> usize {
    let at = |rpm: f64| 60e9 / (rpm * f64::from(spec.firing_period_ns(MODE)));
    let firings = rpm.map_or(fullest.max(COLUMNS) as f64, at);
    firings.clamp(at(RPM[1]), at(RPM[0])).round() as usize
}
