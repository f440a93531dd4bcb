//! A sweep to labels: ground, and the segments that stand on it.
//!
//! The method is Bogoslavskyi and Stachniss, "Fast Range Image-Based Segmentation of Sparse 3D Laser Scans for Online
//! Operation" (IROS 2016): take the ground away, then join neighbours in the range image by one angle test. A
//! [`Segmenter`] does it in four steps, each of them a file here:
//!
//! ```text
//! prepare      mask, rays, angles      what may be labelled, where it points, how far neighbours are apart
//! find_ground  mount, ground | paper   ground by slope (default) or as the paper's authors do
//! connect      connect, components     the beta test as bit masks; runs and a union-find over them
//! describe     table                   count, box, centroid, nearest range, extent of each segment
//! ```
//!
//! [`naive`] says the same without any of the speed, and the tests hold the two against each other.

pub mod angles;
pub mod components;
pub mod connect;
pub mod ground;
pub mod mask;
pub mod mount;
pub mod naive;
pub mod paper;
pub mod rays;
pub mod settings;
mod table;

use std::f32::consts::FRAC_PI_2;

pub use angles::Angles;
pub use components::{Components, Limits, Parts};
pub use connect::{Connector, Joins, MAX_ROWS};
pub use ground::SlopeGround;
pub use mask::{Mask, MaskError};
pub use mount::{HeightEstimator, Mount};
pub use paper::{PaperFinder, PaperGround, Window};
pub use settings::Settings;

use crate::sweep::SweepMut;
use crate::sweep::layout::{flags, is_return};
use rays::{Level, Rays};
use table::Table;

/// The two returns of a dual pixel share a label when they are no further apart than this, metres.
pub const SAME_OBJECT_M: f32 = 0.3;

/// How ground is found.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Method {
    /// By slope, from the sensor's foot on: needs the sensor's height, configured or estimated. Until a sweep has shown
    /// the height, no ground is labelled.
    #[default]
    Slope,
    /// As the paper's authors do, by changes of inclination.
    Paper,
}

/// What a [`Segmenter`] is told once.
#[derive(Clone, Debug, PartialEq)]
pub struct Config {
    /// How ground is found.
    pub method: Method,
    /// Two neighbours belong together when the line through them meets the longer beam at more than this angle, radians.
    pub theta_rad: f32,
    /// Ground by [`Method::Slope`].
    pub slope: SlopeGround,
    /// Ground by [`Method::Paper`].
    pub paper: PaperGround,
    /// Returns that a segment has at least; smaller ones are not labelled.
    pub min_points: u32,
    /// How the sensor sits on the robot.
    pub mount: Mount,
    /// Returns nearer than this are not labelled, metres.
    pub min_range_m: f32,
    /// Returns further than this are not labelled, metres.
    pub max_range_m: f32,
    /// Pixels that show the robot itself and are not labelled; for the sensor's number of rows.
    pub mask: Option<Mask>,
}

impl Default for Config {
    fn default() -> Self {
        Self {
            method: Method::Slope,
            theta_rad: Settings::DEFAULT.theta_deg.to_radians() as f32,
            slope: SlopeGround::default(),
            paper: PaperGround::default(),
            min_points: Settings::DEFAULT.min_points,
            mount: Mount::default(),
            min_range_m: 0.0,
            max_range_m: f32::INFINITY,
            mask: None,
        }
    }
}

/// A [`Config`] that no sweep can be segmented with.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum ConfigError {
    /// The angle of the beta test.
    #[error("theta is {found_deg} degrees, expected more than 0 and less than 90")]
    Theta {
        /// Degrees.
        found_deg: f32,
    },
    /// The range limits.
    #[error("the range is limited to {min_m}..{max_m} m, expected 0 or more, and the second greater than the first")]
    Range {
        /// Metres.
        min_m: f32,
        /// Metres.
        max_m: f32,
    },
    /// The mounting height.
    #[error("the sensor is mounted {found_m} m above the ground, expected more than 0")]
    Height {
        /// Metres.
        found_m: f32,
    },
}

impl Config {
    /// Whether the numbers can be meant.
    ///
    /// # Errors
    /// [`ConfigError`] of the first that cannot.
    pub fn check(&self) -> Result<(), ConfigError> {
        let (min_m, max_m) = (self.min_range_m, self.max_range_m);
        if !(self.theta_rad > 0.0 && self.theta_rad < FRAC_PI_2) {
            return Err(ConfigError::Theta { found_deg: self.theta_rad.to_degrees() });
        }
        if !(min_m >= 0.0 && min_m < max_m) {
            return Err(ConfigError::Range { min_m, max_m });
        }
        match self.mount.height_m {
            Some(found_m) if !(found_m > 0.0 && found_m.is_finite()) => Err(ConfigError::Height { found_m }),
            _ => Ok(()),
        }
    }

    /// Whether a range may be labelled.
    #[inline(always)]
    fn holds(&self, range_m: f32) -> bool {
        is_return(range_m) && range_m >= self.min_range_m && range_m <= self.max_range_m
    }
}

/// Labels sweeps, one after another; after the first in buffers of one size it allocates nothing.
#[derive(Clone, Debug)]
pub struct Segmenter {
    config: Config,
    /// Working ranges: only what may be labelled, and after [`Segmenter::find_ground`] only what is no ground.
    range_m: Vec<f32>,
    /// Words of the returns that may be labelled, one a column.
    real: Vec<u128>,
    /// Words of the ground.
    ground: Vec<u128>,
    joins: Vec<Joins>,
    angles: Angles,
    rays: Rays,
    height: HeightEstimator,
    paper: PaperFinder,
    connector: Connector,
    components: Components,
    table: Table,
}

impl Segmenter {
    /// A segmenter that has seen nothing yet.
    ///
    /// # Errors
    /// [`ConfigError`].
    pub fn new(config: Config) -> Result<Self, ConfigError> {
        config.check()?;
        Ok(Self {
            config,
            range_m: Vec::new(),
            real: Vec::new(),
            ground: Vec::new(),
            joins: Vec::new(),
            angles: Angles::default(),
            rays: Rays::default(),
            height: HeightEstimator::default(),
            paper: PaperFinder::default(),
            connector: Connector::default(),
            components: Components::default(),
            table: Table::default(),
        })
    }

    /// What it was told.
    pub fn config(&self) -> &Config {
        &self.config
    }

    /// Labels a sweep: all steps in their order.
    ///
    /// Every pixel of the header's columns gets a label: ground, the segment it belongs to, or none where there is no
    /// return, where it is masked or out of range, or where its component is too small. The segments table and the
    /// header's counts, height and tilt are written. Segments that the table has no room for are not labelled; a table
    /// of `pixels / min_points` rows has room for all.
    ///
    /// # Panics
    /// If the sweep has more than [`MAX_ROWS`] rows.
    pub fn segment(&mut self, sweep: &mut SweepMut<'_>) {
        self.prepare(sweep);
        self.find_ground(sweep);
        self.connect(sweep);
        self.describe(sweep);
    }

    /// Takes what may be labelled, where each pixel points, and the angles between neighbours.
    pub fn prepare(&mut self, sweep: &SweepMut<'_>) {
        self.reserve(sweep);
        let sweep = sweep.as_ref();
        self.angles.measure(&sweep);
        self.rays.measure(&sweep);
        let config = &self.config;
        self.range_m.extend(sweep.range.iter().map(|&range_m| if config.holds(range_m) { range_m } else { 0.0 }));
        let rows = sweep.rows().max(1);
        if let Some(mask) = &config.mask {
            for (column, ranges) in self.range_m.chunks_exact_mut(rows).enumerate() {
                for (row, range_m) in ranges.iter_mut().enumerate() {
                    if mask.hides(row, sweep.azimuth_rad(row, column)) {
                        *range_m = 0.0;
                    }
                }
            }
        }
        self.real.extend(self.range_m.chunks_exact(rows).map(connect::filled));
    }

    /// Takes room for any sweep that such a buffer can hold: later ones are wider by a few columns, and must not
    /// allocate. Room that is never touched costs no memory.
    fn reserve(&mut self, sweep: &SweepMut<'_>) {
        let (pixels, columns) = (sweep.range.len(), sweep.columns.len());
        reserve(&mut self.range_m, pixels);
        reserve(&mut self.real, columns);
        reserve(&mut self.ground, columns);
        reserve(&mut self.joins, columns);
        self.angles.reserve(columns);
        self.rays.reserve(columns);
        self.connector.reserve(columns);
        self.components.reserve(pixels);
        self.table.reserve(sweep.segments.len());
        match self.config.method {
            Method::Slope => self.height.reserve(columns),
            Method::Paper => self.paper.reserve(pixels),
        }
    }

    /// Finds the ground and takes it out of the working ranges; writes the header's ground count, height and tilt.
    pub fn find_ground(&mut self, sweep: &mut SweepMut<'_>) {
        let rows = self.angles.rows().max(1);
        sweep.header.pitch_rad = self.config.mount.pitch_rad;
        sweep.header.roll_rad = self.config.mount.roll_rad;
        match self.config.method {
            Method::Slope => self.find_slope_ground(sweep),
            Method::Paper => {
                write_height(sweep, self.config.mount.height_m, false);
                let elevations_rad = sweep.beams.iter().map(|beam| beam.elevation_rad);
                let (config, range_m) = (&self.config.paper, &mut self.range_m);
                self.paper.find(config, range_m, elevations_rad, &self.angles, &mut self.ground);
            }
        }
        let mut count = 0;
        for ((ranges, &ground), &real) in self.range_m.chunks_exact_mut(rows).zip(&self.ground).zip(&self.real) {
            count += (ground & real).count_ones();
            for (half, ground) in ranges.chunks_mut(64).zip(connect::halves(ground)) {
                for (bit, range_m) in half.iter_mut().enumerate() {
                    *range_m = if ground >> bit & 1 == 1 { 0.0 } else { *range_m };
                }
            }
        }
        sweep.header.ground = count;
    }

    fn find_slope_ground(&mut self, sweep: &mut SweepMut<'_>) {
        let up = self.config.mount.up();
        let told = self.config.mount.height_m;
        let height_m = told.or_else(|| self.height.estimate(&self.range_m, &self.real, &self.rays, up));
        write_height(sweep, height_m, told.is_none());
        let Some(height_m) = height_m else {
            self.ground.resize(self.real.len(), 0);
            return;
        };
        let rows = self.angles.rows().max(1);
        let mut level = [Level::default(); MAX_ROWS];
        for (column, range_m) in self.range_m.chunks_exact(rows).enumerate() {
            self.rays.level_column(column, range_m, up, &mut level);
            self.ground.push(self.config.slope.find(range_m, &level, height_m));
        }
    }

    /// Joins what is left, and writes the labels and the header's segment count.
    pub fn connect(&mut self, sweep: &mut SweepMut<'_>) {
        let theta_rad = f64::from(self.config.theta_rad);
        self.connector.connect(&self.range_m, &self.angles, theta_rad, &mut self.joins);
        let parts = Parts { rows: self.angles.rows(), joins: &self.joins, real: &self.real, ground: &self.ground };
        let limits = Limits { min_points: self.config.min_points, max_segments: sweep.segments.len() };
        let pixels = sweep.image_pixels();
        let labels = &mut sweep.label[pixels];
        sweep.header.segments = self.components.label(&parts, limits, labels) as u32;
        label_other_returns(sweep, &self.config);
    }

    /// Writes the segments table.
    pub fn describe(&mut self, sweep: &mut SweepMut<'_>) {
        self.table.describe(sweep, self.real.iter().zip(&self.ground).map(|(real, ground)| real & !ground), &self.rays);
    }
}

/// Empties a vector and takes room for so many elements.
fn reserve<T>(vec: &mut Vec<T>, count: usize) {
    vec.clear();
    vec.reserve(count);
}

fn write_height(sweep: &mut SweepMut<'_>, height_m: Option<f32>, estimated: bool) {
    sweep.header.height_m = height_m.unwrap_or(0.0);
    sweep.header.flags &= !flags::HEIGHT_ESTIMATED;
    if estimated && height_m.is_some() {
        sweep.header.flags |= flags::HEIGHT_ESTIMATED;
    }
}

/// The other return of a pixel gets the label of the segmented one where it lies near it on the beam and within the range
/// limits, else none. Where the pixel is masked, the segmented return has none to give.
fn label_other_returns(sweep: &mut SweepMut<'_>, config: &Config) {
    if sweep.range2.is_empty() {
        return;
    }
    let pixels = sweep.image_pixels();
    let segmented = sweep.range[pixels.clone()].iter().zip(&sweep.label[pixels.clone()]);
    let other = sweep.range2[pixels.clone()].iter().zip(&mut sweep.label2[pixels]);
    for ((&range_m, &label), (&range2_m, label2)) in segmented.zip(other) {
        let same = config.holds(range2_m) && (range2_m - range_m).abs() <= SAME_OBJECT_M;
        *label2 = if same { label } else { crate::sweep::layout::LABEL_NONE };
    }
}
