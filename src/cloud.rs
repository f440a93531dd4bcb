//! Point clouds without a range image, as KITTI has them, to sweeps: the projection of the paper's section III.
//!
//! A cloud of a spinning sensor that lists ring after ring still tells which beam each point came from: a new ring
//! begins where the azimuth starts over. Where each beam starts and points is fitted to its points, which lie on a cone
//! whose tip is up to a hand's breadth above the sensor's origin. The columns are even in azimuth, and each shows one
//! point.

pub(crate) mod fit;
pub(crate) mod places;
pub(crate) mod rings;

use std::f64::consts::TAU;

use zerocopy::FromBytes;

use self::rings::{Polar, Ring};
use crate::segment::{Config, ConfigError, MAX_ROWS, SAME_OBJECT_M, Segmenter};
use crate::sensor::Beam;
use crate::sweep::buffers::HeapBuffer;
use crate::sweep::layout::{COLUMNS_CAPACITY, LABEL_NONE, LayoutError, flags, is_return};
use crate::sweep::{BeamRow, Buffers, Column, HeapBuffers, Shape, SweepMut};

/// Columns of an HDL-64E at 10 turns a second: its firings of a turn.
pub const COLUMNS: usize = 2083;
/// Bytes of a point: x forward, y left, z up in metres, and remission; f32, little-endian.
pub const POINT_BYTES: usize = 16;
/// Turns a second that the columns' times stand for; a cloud has none.
const TURNS_A_SECOND: f64 = 10.0;
/// Columns that a point without a pixel of its own looks to either side for one that it resembles.
const REACH: usize = 8;

/// Why bytes are not a cloud of a spinning sensor.
#[derive(Debug, thiserror::Error)]
pub enum CloudError {
    /// No whole number of points.
    #[error("{bytes} bytes, expected a multiple of {POINT_BYTES}: x, y, z and remission as f32")]
    Length {
        /// Bytes that there are.
        bytes: usize,
    },
    /// More rings than any supported image has rows: mostly a cloud that is not in the order of its rings.
    #[error("point {point} begins ring {MAX_ROWS} (counted from 0); the points must be in order, ring after ring")]
    Rings {
        /// Index of the point.
        point: usize,
    },
    /// A ring with more points than a turn can have: the points are in another order.
    #[error(
        "the ring that begins with point {point} has {points} points, a turn has about {columns}; the points must be in \
         order, ring after ring"
    )]
    Order {
        /// Index of its first point.
        point: usize,
        /// How many it has.
        points: usize,
        /// Columns of the image.
        columns: usize,
    },
    /// A mask with other rows than the cloud has rings.
    #[error("the mask is {found} pixels high, the cloud has {rings} rings; make it one row a ring")]
    Mask {
        /// Rows of the mask.
        found: usize,
        /// Rings of the cloud.
        rings: usize,
    },
    /// A number of columns that no sweep has room for.
    #[error("{found} columns, expected 1 to {COLUMNS_CAPACITY}")]
    Columns {
        /// What was asked for.
        found: usize,
    },
    /// A configuration that cannot be meant.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// The sweep could not be laid out.
    #[error(transparent)]
    Layout(#[from] LayoutError),
}

/// Labels clouds: projects each, segments the image and gives every point the label of its pixel.
#[derive(Debug)]
pub struct CloudSegmenter {
    projector: CloudProjector,
    segmenter: Segmenter,
}

impl CloudSegmenter {
    /// For clouds of sensors with about so many firings a turn; [`COLUMNS`] for KITTI.
    ///
    /// # Errors
    /// [`CloudError::Config`] and [`CloudError::Columns`].
    pub fn new(config: Config, columns: usize) -> Result<Self, CloudError> {
        Ok(Self { projector: CloudProjector::new(columns)?, segmenter: Segmenter::new(config)? })
    }

    /// Labels of the points of a KITTI `.bin` file, in their order: 0 none, 1 ground, 2.. segment.
    ///
    /// # Errors
    /// [`CloudError`].
    pub fn segment(&mut self, bytes: &[u8]) -> Result<Vec<u32>, CloudError> {
        let points = points(bytes)?;
        let mut sweep = self.projector.project(&points)?;
        let rings = sweep.beams.len();
        if let Some(mask) = self.segmenter.config().mask.as_ref().filter(|mask| rings > 0 && mask.rows() != rings) {
            return Err(CloudError::Mask { found: mask.rows(), rings });
        }
        self.segmenter.segment(&mut sweep);
        self.projector.labels()
    }
}

/// The points of a KITTI `.bin` file.
///
/// # Errors
/// [`CloudError::Length`].
pub fn points(bytes: &[u8]) -> Result<Vec<[f32; 4]>, CloudError> {
    let (chunks, rest) = bytes.as_chunks::<POINT_BYTES>();
    if !rest.is_empty() {
        return Err(CloudError::Length { bytes: bytes.len() });
    }
    let point = |chunk: &[u8; POINT_BYTES]| <[f32; 4]>::read_from_bytes(chunk).expect("as many bytes as four f32");
    Ok(chunks.iter().map(point).collect())
}

/// Projects clouds to sweeps.
#[derive(Debug)]
pub struct CloudProjector {
    columns: usize,
    buffers: HeapBuffers,
    buffer: Option<HeapBuffer>,
    rings: Vec<Ring>,
    elevations_rad: Vec<f64>,
    /// Pixel of each point; None where the point is not finite, at the origin, or behind another in its pixel.
    pixel: Vec<Option<u32>>,
}

impl CloudProjector {
    /// Onto images of so many columns.
    ///
    /// # Errors
    /// [`CloudError::Columns`].
    pub fn new(columns: usize) -> Result<Self, CloudError> {
        if !(1..=COLUMNS_CAPACITY).contains(&columns) {
            return Err(CloudError::Columns { found: columns });
        }
        Ok(Self {
            columns,
            buffers: HeapBuffers::default(),
            buffer: None,
            rings: Vec::new(),
            elevations_rad: Vec::new(),
            pixel: Vec::new(),
        })
    }

    /// A sweep of the points, which lie x forward, y left, z up; ready to be segmented.
    ///
    /// # Errors
    /// [`CloudError::Rings`].
    pub fn project(&mut self, points: &[[f32; 4]]) -> Result<SweepMut<'_>, CloudError> {
        rings::find(points, self.columns, &mut self.rings)?;
        for ring in &mut self.rings {
            ring.measure(points, &mut self.elevations_rad);
            ring.fit(points);
        }
        // Calibrated beams of the lower block can lie above those of the upper one in the order of the file.
        self.rings.sort_by(|a, b| b.elevation_rad.total_cmp(&a.elevation_rad));

        let pixels = self.rings.len() * self.columns;
        let shape =
            Shape { rows: self.rings.len(), columns_capacity: self.columns, dual: false, segments_capacity: pixels };
        let buffer = self.buffer.insert(self.buffers.take(shape.total_bytes()));
        let mut sweep = SweepMut::create(buffer.as_mut(), &shape)?;
        fill_tables(&mut sweep, &self.rings, self.columns);
        self.pixel.clear();
        self.pixel.resize(points.len(), None);
        for (row, ring) in self.rings.iter().enumerate() {
            place_ring(&mut sweep, row, ring, points, &mut self.pixel);
        }
        sweep.header.returns = sweep.range.iter().filter(|range_m| is_return(**range_m)).count() as u32;
        Ok(sweep)
    }

    /// Labels of the points of the last cloud, once its sweep is segmented.
    ///
    /// # Errors
    /// [`CloudError::Layout`], if the sweep's header was spoilt.
    pub fn labels(&mut self) -> Result<Vec<u32>, CloudError> {
        let Some(buffer) = &mut self.buffer else { return Ok(Vec::new()) };
        let sweep = SweepMut::open(buffer.as_mut())?;
        Ok(self.pixel.iter().map(|pixel| pixel.map_or(LABEL_NONE, |index| sweep.label[index as usize])).collect())
    }

    /// The bytes of the last cloud's sweep.
    pub fn into_buffer(self) -> Option<HeapBuffer> {
        self.buffer
    }
}

/// Puts the points of a ring into the pixels of a row, and notes the pixel of each.
///
/// Points were fired one after the other, each in a column of its own, which [`places`] finds. Where a column is wanted
/// by more points than have room around it, points share a pixel: the nearer is segmented, and the other takes the label
/// of the pixel that it resembles.
fn place_ring(sweep: &mut SweepMut<'_>, row: usize, ring: &Ring, points: &[[f32; 4]], pixel: &mut [Option<u32>]) {
    let (rows, columns) = (sweep.beams.len(), sweep.columns.len());
    let polars: Vec<Option<Polar>> = points[ring.first..ring.end].iter().map(|&point| Polar::of(point)).collect();
    let placed = places::of_ring(&polars, columns);
    let range_m = |polar: Polar| polar.range_m(ring.vertical_offset_m);
    for (column, point) in placed.shown.into_iter().enumerate() {
        sweep.range[column * rows + row] = point.and_then(|point| polars[point]).map_or(0.0, range_m);
    }
    for ((pixel, polar), column) in pixel[ring.first..ring.end].iter_mut().zip(polars).zip(placed.columns) {
        if let (Some(polar), Some(column)) = (polar, column) {
            *pixel = Some(resembling(sweep, (column * rows + row) as u32, range_m(polar)));
        }
    }
}

/// The pixel whose label a point takes: its own, unless another point holds that one and is more than
/// [`SAME_OBJECT_M`] nearer. Then the pixel of the row whose range is most like the point's, no more than
/// [`REACH`] columns off; its own all the same, where none is like it.
fn resembling(sweep: &SweepMut<'_>, own: u32, range_m: f32) -> u32 {
    let apart = |index: u32| (sweep.range[index as usize] - range_m).abs();
    if apart(own) <= SAME_OBJECT_M {
        return own;
    }
    let (rows, columns) = (sweep.beams.len() as i64, sweep.columns.len() as i64);
    let (row, column) = (i64::from(own) % rows, i64::from(own) / rows);
    let reach = REACH as i64;
    let around = (-reach..=reach).map(|by| ((column + by).rem_euclid(columns) * rows + row) as u32);
    let most_like = around.min_by(|&a, &b| apart(a).total_cmp(&apart(b)));
    most_like.filter(|&index| apart(index) <= SAME_OBJECT_M).unwrap_or(own)
}

/// Writes what the sweep says of itself: a whole turn of even columns.
fn fill_tables(sweep: &mut SweepMut<'_>, rings: &[Ring], columns: usize) {
    sweep.header.columns = columns as u32;
    sweep.header.flags = flags::CIRCULAR;
    sweep.header.rpm = (60.0 * TURNS_A_SECOND) as f32;
    sweep.header.duration_ns = (1e9 / TURNS_A_SECOND) as u64;
    let pixels = columns * rings.len();
    sweep.range[..pixels].fill(0.0);
    sweep.reflectivity[..pixels].fill(0);
    sweep.label[..pixels].fill(LABEL_NONE);
    let rate_rad_s = (TAU * TURNS_A_SECOND) as f32;
    for (index, column) in sweep.columns.iter_mut().enumerate() {
        let turn = (index as f64 + 0.5) / columns as f64;
        let time_ns = index as f64 / columns as f64 / TURNS_A_SECOND * 1e9;
        *column = Column::measured(0, 0, (turn * TAU) as f32, rate_rad_s, time_ns as u32);
    }
    for (row, (beam, ring)) in sweep.beams.iter_mut().zip(rings).enumerate() {
        let fitted = Beam { vertical_offset_m: ring.vertical_offset_m, ..Beam::ideal(row, ring.elevation_rad) };
        *beam = BeamRow::new(&fitted, 0);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::segment::Mount;
    use crate::sweep::layout::{LABEL_FIRST_SEGMENT, LABEL_GROUND};

    const BEAMS: usize = 32;
    const FIRINGS: usize = 720;
    const HEIGHT_M: f64 = 1.8;

    fn elevation_rad(beam: usize) -> f64 {
        (-1.0 - 0.6 * beam as f64).to_radians()
    }

    /// A beam meets flat ground, or a wall 8 m ahead, 2 m wide and without end.
    fn street() -> Vec<[f32; 4]> {
        let mut points = Vec::new();
        for beam in 0..BEAMS {
            for firing in 0..FIRINGS {
                let (sin, cos) = ((firing as f64 + 0.5) / FIRINGS as f64 * TAU).sin_cos();
                let to_ground = -HEIGHT_M / elevation_rad(beam).tan();
                let to_wall = if cos > 0.0 && (8.0 * sin / cos).abs() < 1.0 { 8.0 / cos } else { f64::INFINITY };
                let away = to_ground.min(to_wall);
                let height = away * elevation_rad(beam).tan();
                points.push([away * cos, away * sin, height, 0.5].map(|value| value as f32));
            }
        }
        points
    }

    fn bytes(points: &[[f32; 4]]) -> Vec<u8> {
        points.iter().flatten().flat_map(|value| value.to_le_bytes()).collect()
    }

    fn config() -> Config {
        Config { mount: Mount { height_m: Some(HEIGHT_M as f32), ..Mount::default() }, ..Config::default() }
    }

    fn segmenter() -> CloudSegmenter {
        CloudSegmenter::new(config(), FIRINGS).unwrap()
    }

    #[test]
    fn a_street_is_ground_and_a_wall() {
        let points = street();
        let labels = segmenter().segment(&bytes(&points)).unwrap();
        assert_eq!(labels.len(), points.len());
        for (point, label) in points.iter().zip(labels) {
            let on_ground = f64::from(point[2]) < -HEIGHT_M + 1e-3;
            // The lowest return on the wall may be at the height of a kerb.
            let low = f64::from(point[2]) < -HEIGHT_M + 0.2;
            assert!(label == if on_ground { LABEL_GROUND } else { LABEL_FIRST_SEGMENT } || low, "{point:?} {label}");
        }
    }

    #[test]
    fn beams_are_measured_and_points_come_back() {
        let points = street();
        let mut projector = CloudProjector::new(FIRINGS).unwrap();
        let sweep = projector.project(&points).unwrap();
        let sweep = sweep.as_ref();
        assert_eq!((sweep.rows(), sweep.header.returns as usize), (BEAMS, points.len()));
        for (row, beam) in sweep.beams.iter().enumerate() {
            assert!((f64::from(beam.elevation_rad) - elevation_rad(row)).abs() < 1e-6, "{row}");
        }
        // x right is left turned round, y forward.
        for found in sweep.returns() {
            let [x, y, z] = found.point_m;
            let near = |point: &[f32; 4]| {
                let [forward, left, up, _] = point.map(f64::from);
                (x + left).abs() < 0.4 && (y - forward).abs() < 0.4 && (z - up).abs() < 1e-3
            };
            let ring = &points[found.row * FIRINGS..][..FIRINGS];
            assert!(ring.iter().any(near), "{found:?}");
        }
    }

    #[test]
    fn points_that_are_none_get_no_label() {
        let mut points = street();
        points[5][1] = f32::NAN;
        points[6] = [0.0; 4];
        points[7][2] = f32::INFINITY;
        let labels = segmenter().segment(&bytes(&points)).unwrap();
        assert_eq!(labels[5..8], [LABEL_NONE; 3]);
        assert!(labels[8] != LABEL_NONE);
        assert!(segmenter().segment(&[]).unwrap().is_empty());
    }

    /// Two points at one azimuth have two columns; of seven, at least two share the pixels of others.
    #[test]
    fn points_make_room_for_each_other() {
        let crowd = |count: usize| -> Vec<[f32; 4]> { (0..count).map(|i| [5.0 + i as f32, -1.0, -0.5, 0.0]).collect() };
        let mut projector = CloudProjector::new(FIRINGS).unwrap();
        assert_eq!(projector.project(&crowd(2)).unwrap().header.returns, 2);
        assert!(projector.pixel.iter().all(Option::is_some));
        let same_azimuth: Vec<[f32; 4]> = (0..7).map(|i| [1.0 + i as f32, 0.0, 0.0, 0.0]).collect();
        let returns = projector.project(&same_azimuth).unwrap().header.returns;
        assert!((4..=5).contains(&returns), "{returns}");
        assert_eq!(projector.pixel.iter().flatten().count(), 7);
    }

    /// Four points a pixel: all are labelled, and as the twin scene in which each has a pixel of its own.
    #[test]
    fn points_that_share_a_pixel_are_all_labelled() {
        let bytes = bytes(&street());
        let own = segmenter().segment(&bytes).unwrap();
        let shared = CloudSegmenter::new(config(), FIRINGS / 4).unwrap().segment(&bytes).unwrap();
        assert!(shared.iter().all(|&label| label != LABEL_NONE));
        let same = own.iter().zip(&shared).filter(|(own, shared)| own == shared).count();
        assert!(same * 100 > own.len() * 98, "{same} of {}", own.len());
    }

    /// The same points in the sense of the clock, and from the lowest ring up: the labels are the same, point by point.
    #[test]
    fn the_sense_and_the_order_of_the_rings_do_not_matter() {
        let street = street();
        let own = segmenter().segment(&bytes(&street)).unwrap();
        let turned = |at: usize| at / FIRINGS * FIRINGS + (FIRINGS - 1 - at % FIRINGS);
        let lowest_first = |at: usize| (BEAMS - 1 - at / FIRINGS) * FIRINGS + at % FIRINGS;
        let backwards = |at: usize| street.len() - 1 - at;
        let orders: [&dyn Fn(usize) -> usize; 3] = [&turned, &lowest_first, &backwards];
        for (index, order) in orders.into_iter().enumerate() {
            let moved: Vec<[f32; 4]> = (0..street.len()).map(|at| street[order(at)]).collect();
            let labels = segmenter().segment(&bytes(&moved)).unwrap();
            let same = (0..labels.len()).filter(|&at| labels[at] == own[order(at)]).count();
            assert!(same * 100 > own.len() * 99, "order {index}: {same} of {}", own.len());
        }
    }

    /// Near points, whose azimuth jumps about, begin no ring; a ring of many turns is none.
    #[test]
    fn noise_near_the_sensor_begins_no_ring_and_disorder_is_named() {
        let mut noisy = street();
        for (index, point) in noisy.iter_mut().enumerate().filter(|(index, _)| index % 50 == 7) {
            *point = if index % 100 == 7 { [0.02, 0.01, 0.0, 0.0] } else { [0.02, -0.01, 0.0, 0.0] };
        }
        let mut projector = CloudProjector::new(FIRINGS).unwrap();
        assert_eq!(projector.project(&noisy).unwrap().beams.len(), BEAMS);
        let heap: Vec<[f32; 4]> = (0..10 * FIRINGS).map(|i| [5.0, 0.01 + 1e-4 * i as f32, 0.0, 0.0]).collect();
        let error = segmenter().segment(&bytes(&heap)).unwrap_err().to_string();
        assert!(error.contains("has 7200 points, a turn has about 720"), "{error}");
    }

    #[test]
    fn what_is_no_cloud_is_refused_in_words() {
        let error = |bytes: &[u8]| segmenter().segment(bytes).unwrap_err().to_string();
        assert_eq!(error(&[0; 17]), "17 bytes, expected a multiple of 16: x, y, z and remission as f32");
        let shuffled: Vec<[f32; 4]> =
            (0..400).map(|i| if i % 2 == 0 { [1.0, 0.1, 0.0, 0.0] } else { [1.0, -0.1, 0.0, 0.0] }).collect();
        assert!(error(&bytes(&shuffled)).contains("ring after ring"));
        let columns = CloudProjector::new(0).unwrap_err().to_string();
        assert_eq!(columns, format!("0 columns, expected 1 to {COLUMNS_CAPACITY}"));
        let theta = Config { theta_rad: 0.0, ..Config::default() };
        assert!(CloudSegmenter::new(theta, COLUMNS).unwrap_err().to_string().starts_with("theta is 0 degrees"));
    }
}
