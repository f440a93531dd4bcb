//! Point clouds without a range image, from KITTI, PCD and PLY files, to sweeps: the projection of
//! the paper's section III.
//!
//! If a file has the ring of each point, or the beams of the sensor are given, the rows come from
//! there. A cloud of a spinning sensor that lists ring after ring still tells which beam each point
//! came from: a new ring begins where the azimuth starts over. Where each beam starts and points is
//! fitted to its points, which lie on a cone whose tip is up to a hand's breadth above the sensor's
//! origin. The columns are even in azimuth, and each shows one point.

pub(crate) mod fit;
pub(crate) mod places;
mod polar;
mod project;
mod read;
pub(crate) mod rings;
mod rows;

use zerocopy::FromBytes;

pub use self::project::CloudProjector;
pub use self::read::{FilePosition, Format, ReadError};
pub use self::rows::{RowBeam, RowTable, RowTableError};
use sweepd_core::assemble::{Removal, Remover};
use sweepd_core::segment::{Config, ConfigError, MAX_ROWS, Segmenter};
use sweepd_core::sweep::layout::{COLUMNS_CAPACITY, LayoutError};

/// Columns of an HDL-64E at 10 turns a second: its firings of a turn.
pub const COLUMNS: usize = 2083;
/// Bytes of a point: x forward, y left, z up in metres, and remission; f32, little-endian.
pub const POINT_BYTES: usize = 16;

/// Points as they were measured.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Cloud {
    /// x forward, y left, z up in metres, and intensity.
    pub points: Vec<[f32; 4]>,
    /// Ring number of each point, if the file has it; equal numbers mean the same ring, without an
    /// order.
    pub rings: Option<Vec<u32>>,
}

/// Why bytes are not a cloud of a spinning sensor.
#[derive(Debug, thiserror::Error)]
pub enum CloudError {
    /// No whole number of points.
    #[error("{bytes} bytes, expected a multiple of {POINT_BYTES}: x, y, z and remission as f32")]
    Length {
        /// Bytes that there are.
        bytes: usize,
    },
    /// More rings than any supported image has rows: mostly a cloud that is not in the order of its
    /// rings.
    #[error(
        "point {point} begins ring {MAX_ROWS} (counted from 0); the points must be in order, ring after ring"
    )]
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
    /// More ring numbers than any supported image has rows.
    #[error("point {point} has ring {ring}, the {}th number (counted from 1); expected at most {MAX_ROWS}", MAX_ROWS + 1)]
    RingNumbers {
        /// Index of the point.
        point: usize,
        /// Its ring.
        ring: u32,
    },
    /// Not one ring number a point.
    #[error("{rings} ring numbers for {points} points, expected one each")]
    RingCount {
        /// Points of the cloud.
        points: usize,
        /// Ring numbers.
        rings: usize,
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
    /// A file that is not what it says it is.
    #[error(transparent)]
    Read(#[from] ReadError),
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
    remover: Option<Remover>,
    table: Option<RowTable>,
}

impl CloudSegmenter {
    /// For clouds of sensors with about this many firings a turn; [`COLUMNS`] for KITTI.
    ///
    /// # Errors
    /// [`CloudError::Config`] and [`CloudError::Columns`].
    pub fn new(config: Config, columns: usize) -> Result<Self, CloudError> {
        Ok(Self {
            projector: CloudProjector::new(columns)?,
            segmenter: Segmenter::new(config)?,
            remover: None,
            table: None,
        })
    }

    /// Takes returns out of the images: their points get no label.
    #[must_use]
    pub fn with_removal(self, removal: &Removal) -> Self {
        let remover = Remover::new(removal, self.segmenter.config(), [0.0; 3], 0.0);
        Self { remover, ..self }
    }

    /// For clouds in any order: the elevation of a point determines its beam.
    #[must_use]
    pub fn with_rows(self, table: RowTable) -> Self {
        Self {
            table: Some(table),
            ..self
        }
    }

    /// Labels of the points of a KITTI `.bin` file, in their order: 0 none, 1 ground, 2.. segment.
    ///
    /// # Errors
    /// [`CloudError`].
    pub fn segment(&mut self, bytes: &[u8]) -> Result<Vec<u32>, CloudError> {
        let cloud = Cloud {
            points: points(bytes)?,
            rings: None,
        };
        Ok(self.segment_cloud(&cloud)?.to_vec())
    }

    /// Labels of the points of a cloud, in their order.
    ///
    /// # Errors
    /// [`CloudError`].
    pub fn segment_cloud(&mut self, cloud: &Cloud) -> Result<&[u32], CloudError> {
        let mut sweep = self.projector.project_cloud(cloud, self.table.as_ref())?;
        let rings = sweep.beams.len();
        if let Some(mask) = self
            .segmenter
            .config()
            .mask
            .as_ref()
            .filter(|mask| rings > 0 && mask.rows() != rings)
        {
            return Err(CloudError::Mask {
                found: mask.rows(),
                rings,
            });
        }
        if let Some(remover) = &mut self.remover {
            let firings = sweep.image_columns();
            sweep.header.returns -= remover.remove(&mut sweep, firings);
        }
        // Each cloud by itself: the one before may be of another sensor.
        self.segmenter.forget_floor();
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
    Ok(chunks
        .iter()
        .map(|chunk| <[f32; 4]>::read_from_bytes(chunk).expect("as many bytes as four f32"))
        .collect())
}

#[cfg(test)]
mod tests {
    use std::f64::consts::TAU;

    use super::*;
    use sweepd_core::segment::Mount;
    use sweepd_core::sweep::layout::{LABEL_FIRST_SEGMENT, LABEL_GROUND, LABEL_NONE};

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
                let to_wall = if cos > 0.0 && (8.0 * sin / cos).abs() < 1.0 {
                    8.0 / cos
                } else {
                    f64::INFINITY
                };
                let away = to_ground.min(to_wall);
                let height = away * elevation_rad(beam).tan();
                points.push([away * cos, away * sin, height, 0.5].map(|value| value as f32));
            }
        }
        points
    }

    fn bytes(points: &[[f32; 4]]) -> Vec<u8> {
        points
            .iter()
            .flatten()
            .flat_map(|value| value.to_le_bytes())
            .collect()
    }

    fn config() -> Config {
        Config {
            mount: Mount {
                height_m: Some(HEIGHT_M as f32),
                ..Mount::default()
            },
            ..Config::default()
        }
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
            assert!(
                label
                    == if on_ground {
                        LABEL_GROUND
                    } else {
                        LABEL_FIRST_SEGMENT
                    }
                    || low,
                "{point:?} {label}"
            );
        }
    }

    #[test]
    fn beams_are_measured_and_points_come_back() {
        let points = street();
        let mut projector = CloudProjector::new(FIRINGS).unwrap();
        let sweep = projector.project(&points).unwrap();
        let sweep = sweep.as_ref();
        assert_eq!(
            (sweep.rows(), sweep.header.returns as usize),
            (BEAMS, points.len())
        );
        for (row, beam) in sweep.beams.iter().enumerate() {
            assert!(
                (f64::from(beam.elevation_rad) - elevation_rad(row)).abs() < 1e-6,
                "{row}"
            );
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

    /// Two points at one azimuth have two columns; of seven, at least two share the pixels of
    /// others.
    #[test]
    fn points_make_room_for_each_other() {
        let crowd = |count: usize| -> Vec<[f32; 4]> {
            (0..count)
                .map(|i| [5.0 + i as f32, -1.0, -0.5, 0.0])
                .collect()
        };
        let mut projector = CloudProjector::new(FIRINGS).unwrap();
        assert_eq!(projector.project(&crowd(2)).unwrap().header.returns, 2);
        let same_azimuth: Vec<[f32; 4]> = (0..7).map(|i| [1.0 + i as f32, 0.0, 0.0, 0.0]).collect();
        let returns = projector.project(&same_azimuth).unwrap().header.returns;
        assert!((4..=5).contains(&returns), "{returns}");
        projector.project(&same_azimuth).unwrap().label.fill(7);
        assert_eq!(projector.labels().unwrap(), [7; 7]);
    }

    /// Four points a pixel: all are labelled, and as the twin scene in which each has a pixel of
    /// its own.
    #[test]
    fn points_that_share_a_pixel_are_all_labelled() {
        let bytes = bytes(&street());
        let own = segmenter().segment(&bytes).unwrap();
        let shared = CloudSegmenter::new(config(), FIRINGS / 4)
            .unwrap()
            .segment(&bytes)
            .unwrap();
        assert!(shared.iter().all(|&label| label != LABEL_NONE));
        let same = own
            .iter()
            .zip(&shared)
            .filter(|(own, shared)| own == shared)
            .count();
        assert!(same * 100 > own.len() * 97, "{same} of {}", own.len());
    }

    /// The same points in the sense of the clock, and from the lowest ring up: the labels are the
    /// same, point by point.
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
            let same = (0..labels.len())
                .filter(|&at| labels[at] == own[order(at)])
                .count();
            assert!(
                same * 100 > own.len() * 99,
                "order {index}: {same} of {}",
                own.len()
            );
        }
    }

    /// Near points, whose azimuth jumps about, begin no ring; a ring of many turns is none.
    #[test]
    fn noise_near_the_sensor_begins_no_ring_and_disorder_is_named() {
        let mut noisy = street();
        for (index, point) in noisy
            .iter_mut()
            .enumerate()
            .filter(|(index, _)| index % 50 == 7)
        {
            *point = if index % 100 == 7 {
                [0.02, 0.01, 0.0, 0.0]
            } else {
                [0.02, -0.01, 0.0, 0.0]
            };
        }
        let mut projector = CloudProjector::new(FIRINGS).unwrap();
        assert_eq!(projector.project(&noisy).unwrap().beams.len(), BEAMS);
        let heap: Vec<[f32; 4]> = (0..10 * FIRINGS)
            .map(|i| [5.0, 0.01 + 1e-4 * i as f32, 0.0, 0.0])
            .collect();
        let error = segmenter().segment(&bytes(&heap)).unwrap_err().to_string();
        assert!(
            error.contains("has 7200 points, a turn has about 720"),
            "{error}"
        );
    }

    #[test]
    fn what_is_no_cloud_is_refused_in_words() {
        let error = |bytes: &[u8]| segmenter().segment(bytes).unwrap_err().to_string();
        assert_eq!(
            error(&[0; 17]),
            "17 bytes, expected a multiple of 16: x, y, z and remission as f32"
        );
        let shuffled: Vec<[f32; 4]> = (0..400)
            .map(|i| {
                if i % 2 == 0 {
                    [1.0, 0.1, 0.0, 0.0]
                } else {
                    [1.0, -0.1, 0.0, 0.0]
                }
            })
            .collect();
        assert!(error(&bytes(&shuffled)).contains("ring after ring"));
        let columns = CloudProjector::new(0).unwrap_err().to_string();
        assert_eq!(
            columns,
            format!("0 columns, expected 1 to {COLUMNS_CAPACITY}")
        );
        let theta = Config {
            theta_rad: 0.0,
            ..Config::default()
        };
        assert!(
            CloudSegmenter::new(theta, COLUMNS)
                .unwrap_err()
                .to_string()
                .starts_with("theta is 0 degrees")
        );
    }
}
