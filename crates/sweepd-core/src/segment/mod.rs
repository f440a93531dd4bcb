//! A sweep to labels: ground, and the segments that stand on it.
//!
//! The idea is Bogoslavskyi and Stachniss, "Fast Range Image-Based Segmentation of Sparse 3D Laser
//! Scans for Online Operation" (IROS 2016): take the ground away, then join what is near in the
//! range image by one angle test. There are two methods, and a [`Segmenter`] runs either in the
//! same steps (`emit` only for the default method, and where objects are to be found):
//!
//! ```text
//! begin         what the sweep says of its beams, and how high the sensor is      mask, mount, ../floor
//! find_ground   the ground of the next strip of columns                           ranges, points, climb
//! join          what is no ground there: runs of neighbours, then windows         vote, runs, windows, near, components
//! emit          objects that are complete                                       objects, seam
//! label         components, small ones to others, labels and segments table       components, area, labels, extent, wide
//! ```
//!
//! * [`Method::Slope`], the default, is the files at the right: `ground` by slope from the
//!   sensor's foot up, then runs in rows, and windows over holes and breaks where these begin and
//!   end. It takes columns in strips of 64, a word of each row, so it can begin while the head still
//!   turns: [`Segmenter::begin_early`]. `strips` holds its steps together, `order` says which
//!   column is taken when.
//! * [`Method::Paper`] is the paper's own, in the folder `paper`: all of an image at once, and
//!   only pixels that touch.
//!
//! [`settings`] is the table of numbers that people set. The laboratory's `twin` says the same as the
//! default method without any of the speed, and the tests hold the two against each other.

mod area;
mod climb;
mod components;
mod config;
mod directions;
mod extent;
pub(crate) mod ground;
pub(crate) mod joining;
mod labels;
pub(crate) mod mask;
pub(crate) mod mount;
mod near;
pub mod objects;
mod order;
pub(crate) mod paper;
pub(crate) mod points;
mod ranges;
mod runs;
mod seam;
pub mod settings;
mod strips;
mod turn;
mod turnover;
mod vote;
mod wide;
mod windows;

pub use config::{Config, ConfigError, Method};
pub use joining::Joining;
pub use mask::{Mask, MaskError};
pub use mount::{Mount, Stance};
pub(crate) use order::reserve;
pub use order::{MAX_ROWS, STRIP as STRIP_COLUMNS};
pub use paper::PaperSegmenter;
pub use paper::angles::Angles;
pub use paper::ground::{PaperGround, Window};
pub use points::placed;
pub use settings::{SETTINGS, Setting};
pub(crate) use turn::turn_rad;
pub use turnover::turn_over;

use crate::floor::{FloorFinder, Sight};
use crate::sweep::SweepMut;
use crate::sweep::height::HeightDoubt;
use crate::sweep::layout::flags;
use fearless_simd::Level;
use objects::Objects;
use seam::Seam;
use strips::Strips;

/// The two returns of a dual pixel share a label when they are no further apart than this, metres.
pub const SAME_OBJECT_M: f32 = 0.3;

/// Labels sweeps, one after another; after the first in buffers of one size it allocates nothing,
/// unless it finds objects.
#[derive(Clone, Debug)]
pub struct Segmenter {
    config: Config,
    level: Level,
    /// Whether the height of the sensor is to be estimated.
    estimates_height: bool,
    /// Looks for the floor, also where the height is configured. `None`: headers say the height.
    floor: Option<Box<FloorFinder>>,
    /// Whether the floor was looked for in the sweep that was begun.
    has_looked: bool,
    strips: Strips,
    /// What lies around the cut, if objects are to be found.
    seam: Option<Box<Seam>>,
    paper: PaperSegmenter,
    /// The sweep that was begun early, by its number.
    open: Option<u64>,
    /// The one that was spoilt.
    spoilt: Option<u64>,
}

impl Segmenter {
    /// A segmenter that has seen nothing yet.
    ///
    /// # Errors
    /// [`ConfigError`].
    pub fn new(config: Config) -> Result<Self, ConfigError> {
        Self::with_level(config, Level::new())
    }

    /// A segmenter that uses no more than these instructions of the machine; the labels are the
    /// same on all.
    ///
    /// # Errors
    /// [`ConfigError`].
    pub fn with_level(config: Config, level: Level) -> Result<Self, ConfigError> {
        config.check()?;
        Ok(Self {
            estimates_height: config.estimates_height(),
            floor: Some(Box::new(FloorFinder::with_level(&config, level))),
            has_looked: false,
            config,
            level,
            strips: Strips::new(level),
            seam: None,
            paper: PaperSegmenter::default(),
            open: None,
            spoilt: None,
        })
    }

    /// Takes the height of the sensor from the header of each sweep, where
    /// [`Segmenter::find_height`] of another segmenter with this configuration has written it.
    /// Nothing passes from sweep to sweep then, so several such segmenters can share the work.
    #[must_use]
    pub fn with_heights_in_headers(mut self) -> Self {
        self.floor = None;
        self
    }

    /// The configuration.
    pub fn config(&self) -> &Config {
        &self.config
    }

    /// Labels a sweep: all steps in their order.
    ///
    /// Every pixel of the header's columns gets a label: ground, the segment it belongs to, or none
    /// where there is no return, where it is masked or out of range, or where its component is too
    /// small. The segments table and the header's counts, height and tilt are written. Segments
    /// that the table has no room for are not labelled; a table of `pixels / min_points` rows has
    /// room for all.
    ///
    /// # Panics
    /// If the sweep has more than [`MAX_ROWS`] rows.
    pub fn segment(&mut self, sweep: &mut SweepMut<'_>) {
        self.begin(sweep);
        while self.find_ground(sweep) {
            self.join();
        }
        self.label(sweep);
    }

    /// Takes what a sweep says of its beams and columns, and how high the sensor is. The steps that
    /// follow are to be given the same sweep.
    ///
    /// # Panics
    /// If the sweep has more than [`MAX_ROWS`] rows.
    pub fn begin(&mut self, sweep: &mut SweepMut<'_>) {
        check_rows(sweep);
        sweep.header.pitch_rad = self.config.mount.pitch_rad;
        sweep.header.roll_rad = self.config.mount.roll_rad;
        let configured_m = self.config.mount.height_m;
        match self.config.method {
            Method::Paper => {
                write_height(sweep, configured_m, None);
                self.has_looked = false;
                self.paper.begin(sweep, &self.config);
            }
            Method::Slope => {
                self.spoilt = None;
                if self.open.take() == Some(sweep.header.sequence)
                    && sweep.header.has(flags::CIRCULAR)
                {
                    self.strips.go_on(sweep, None);
                } else {
                    let height_m = self.sound(sweep);
                    self.strips.begin(sweep, &self.config, height_m, None);
                }
                let height_m = configured_m.or(self.strips.height_m());
                self.write_estimate(sweep, height_m);
            }
        }
    }

    /// Takes a sweep that is not complete, with the header of a whole turn, of which the first
    /// `ready` columns are final. Returns whether it can be segmented now: then call
    /// [`Segmenter::find_ground`] and [`Segmenter::join`] until there is no more. When the sweep is
    /// complete, [`Segmenter::begin`] goes on from there.
    ///
    /// Sweeps are told apart by their sequence numbers. Call [`Segmenter::spoil`] if columns that
    /// were final have changed.
    pub fn begin_early(&mut self, sweep: &mut SweepMut<'_>, ready: usize) -> bool {
        let sequence = sweep.header.sequence;
        self.find_floor();
        if self.config.method == Method::Paper
            || ready == 0
            || self.spoilt == Some(sequence)
            || self.estimates_height && self.floor().1 == 0
            || self.estimates_height && self.height_m_of_next().is_none()
        {
            return false;
        }
        self.has_looked = false;
        let height_m = self.height_m_of_next();
        match self.open.replace(sequence) == Some(sequence) {
            true => self.strips.go_on(sweep, Some(ready)),
            false => self
                .strips
                .begin(sweep, &self.config, height_m, Some(ready)),
        }
        true
    }

    /// Columns of the open sweep that must be final before more of it can be done early. Of one that
    /// was not begun, a lower bound.
    pub fn next_columns(&self) -> usize {
        if self.open.is_none() {
            return STRIP_COLUMNS;
        }
        let columns = self.strips.next_columns();
        let around_cut = self.seam.as_ref().and_then(|seam| seam.next_columns());
        around_cut.map_or(columns, |around_cut| around_cut.min(columns))
    }

    /// Columns of a sweep that were segmented early have changed: the whole sweep is segmented
    /// again, but only when it is complete, so that many changes cost no more than one.
    pub fn spoil(&mut self) {
        self.spoilt = self.open.take().or(self.spoilt);
        if let Some(seam) = &mut self.seam {
            seam.spoil();
        }
    }

    /// Forgets the floor: what comes next is from another sensor.
    pub fn forget_floor(&mut self) {
        if let Some(floor) = &mut self.floor {
            **floor = FloorFinder::with_level(&self.config, self.level);
        }
    }

    /// Writes the height of the sensor into the header of a sweep, as [`Segmenter::segment`] would
    /// after the same sweeps; the labels are for a segmenter
    /// [with heights in headers](Segmenter::with_heights_in_headers).
    ///
    /// # Panics
    /// If the sweep has more than [`MAX_ROWS`] rows.
    pub fn find_height(&mut self, sweep: &mut SweepMut<'_>) {
        check_rows(sweep);
        let height_m = match self.config.method {
            Method::Paper => self.config.mount.height_m,
            Method::Slope => self.sound(sweep),
        };
        self.write_estimate(sweep, height_m);
        self.look(sweep);
        self.find_floor();
    }

    /// The floor that the sweeps show, and how many were looked at for it. What was kept of the
    /// newest counts after [`Segmenter::find_floor`].
    pub fn floor(&self) -> (Sight, u64) {
        let floor = self.floor.as_ref();
        floor.map_or_else(Default::default, |floor| (floor.sight(), floor.looks()))
    }

    /// Finds the floor in what was kept of the newest sweep, if that was one to look at. The next
    /// sweep does it else: to do it before saves time there.
    pub fn find_floor(&mut self) {
        if let Some(floor) = &mut self.floor {
            floor.fit();
        }
    }

    /// The height of the sensor for a whole sweep; the first ones are looked at for it.
    fn sound(&mut self, sweep: &SweepMut<'_>) -> Option<f32> {
        self.find_floor();
        self.has_looked = false;
        match &mut self.floor {
            _ if !self.estimates_height => return self.config.mount.height_m,
            None => return Some(sweep.header.height_m).filter(|height_m| *height_m > 0.0),
            Some(floor) if floor.looks() == 0 => {
                floor.look(&sweep.as_ref());
                self.has_looked = true;
            }
            Some(_) => {}
        }
        self.height_m_of_next()
    }

    /// The height of the sensor by the sweeps before, or as configured.
    fn height_m_of_next(&self) -> Option<f32> {
        let seen = self.floor.as_ref().map(|floor| floor.sight());
        let seen_m = seen.and_then(|sight| sight.height_m());
        self.config.mount.height_m.or(seen_m)
    }

    /// Keeps some returns of a whole sweep to look for the floor, if it is one to look at.
    fn look(&mut self, sweep: &SweepMut<'_>) {
        if let Some(floor) = &mut self.floor
            && !self.has_looked
        {
            floor.sample(&sweep.as_ref());
        }
    }

    /// Writes the height that labels take, and if it is estimated, what is in doubt about it.
    fn write_estimate(&self, sweep: &mut SweepMut<'_>, height_m: Option<f32>) {
        match &self.floor {
            _ if !self.estimates_height => write_height(sweep, height_m, None),
            Some(floor) => write_height(sweep, height_m, Some(floor.sight().doubt())),
            // The header has it.
            None => {}
        }
    }

    /// Finds the ground in the next strip of columns (in all columns, as the paper has it). False
    /// when there is none left.
    pub fn find_ground(&mut self, sweep: &SweepMut<'_>) -> bool {
        match self.config.method {
            Method::Paper => self.paper.find_ground(&self.config),
            Method::Slope => self.strips.find_ground(sweep, &self.config),
        }
    }

    /// Joins what is no ground there with each other, and with what was before; once after each
    /// time that [`Segmenter::find_ground`] said that there is some.
    pub fn join(&mut self) {
        match self.config.method {
            Method::Paper => self.paper.join(&self.config),
            Method::Slope => self.strips.join(),
        }
    }

    /// How high the sensor is for the ground of the sweep that was begun, metres.
    pub fn height_m(&self) -> Option<f32> {
        self.strips.height_m()
    }

    /// Finds objects from the next sweep on, or no more.
    pub fn find_objects(&mut self, finds: bool) {
        self.seam = finds.then(|| Box::new(Seam::new(self.level)));
        self.strips.objects = finds.then(Objects::default);
    }

    /// The objects, if they are to be found.
    pub fn objects(&mut self) -> Option<&mut Objects> {
        self.strips.objects.as_mut()
    }

    /// Gives out the objects that became complete; after each [`Segmenter::join`] of a sweep that is
    /// not complete.
    pub fn emit(&mut self, sweep: &SweepMut<'_>) {
        self.strips.emit(sweep, &self.config);
    }

    /// Gives out the objects around the cut that are complete by now, of a sweep that
    /// [`Segmenter::begin_early`] has taken.
    pub fn emit_around_cut(&mut self, sweep: &SweepMut<'_>, ready: usize) {
        let height_m = self.strips.height_m();
        if let (Some(seam), Some(objects)) = (&mut self.seam, &mut self.strips.objects) {
            seam.follow(sweep, ready, &self.config, height_m, objects);
        }
    }

    /// When all strips are joined: writes the labels, the segments table, and the header's counts.
    pub fn label(&mut self, sweep: &mut SweepMut<'_>) {
        match self.config.method {
            Method::Paper => self.paper.label(sweep, &self.config, self.level),
            Method::Slope => {
                self.strips.label(sweep, &self.config);
            }
        }
        self.look(sweep);
        label_other_returns(sweep, &self.config);
        wide::mark(sweep, &self.config);
        let has_height = !self.estimates_height || sweep.header.height_m > 0.0;
        if let Some(objects) = &mut self.strips.objects {
            objects.end(&sweep.as_ref(), has_height);
        }
        if let Some(seam) = &mut self.seam {
            seam.keep(sweep, &self.config);
        }
    }
}

fn check_rows(sweep: &SweepMut<'_>) {
    assert!(
        sweep.header.rows as usize <= MAX_ROWS,
        "more rows than an image has"
    );
}

/// `estimate` is of a height that is to be estimated, and says what is in doubt about it.
fn write_height(
    sweep: &mut SweepMut<'_>,
    height_m: Option<f32>,
    estimate: Option<Option<HeightDoubt>>,
) {
    let header = &mut *sweep.header;
    header.height_m = height_m.unwrap_or(0.0);
    header.height_doubt = estimate.flatten().map_or(0, HeightDoubt::word);
    for (flag, is_set) in [
        (
            flags::HEIGHT_ESTIMATED,
            estimate.is_some() && height_m.is_some(),
        ),
        (flags::HEIGHT_IN_DOUBT, header.height_doubt != 0),
    ] {
        header.flags = header.flags & !flag | if is_set { flag } else { 0 };
    }
}

/// The other return of a pixel gets the label of the segmented one where it lies near it on the
/// beam and within the range limits, else none. Where the pixel is masked, the segmented return has
/// none to give.
fn label_other_returns(sweep: &mut SweepMut<'_>, config: &Config) {
    if sweep.range2.is_empty() {
        return;
    }
    let pixels = sweep.image_pixels();
    let segmented = sweep.range[pixels.clone()]
        .iter()
        .zip(&sweep.label[pixels.clone()]);
    let other = sweep.range2[pixels.clone()]
        .iter()
        .zip(&mut sweep.label2[pixels]);
    for ((&range_m, &label), (&range2_m, label2)) in segmented.zip(other) {
        let same = config.holds(range2_m) && (range2_m - range_m).abs() <= SAME_OBJECT_M;
        *label2 = if same {
            label
        } else {
            crate::sweep::layout::LABEL_NONE
        };
    }
}
