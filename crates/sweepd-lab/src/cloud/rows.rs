//! Clouds that are not in the order of their rings: which row each point belongs to.

use super::CloudError;
use super::polar::Polars;
use super::rings::Ring;
use sweepd_core::segment::MAX_ROWS;
use sweepd_core::sensor::Calibration;

/// Farthest that a beam of a table may start above or below the sensor's origin, metres.
const MAX_OFFSET_M: f64 = 5.0;

/// The beams of a sensor, from the top, one for each row, for points in any order.
#[derive(Clone, Debug, PartialEq)]
pub struct RowTable {
    beams: Vec<RowBeam>,
}

/// A beam of a [`RowTable`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RowBeam {
    /// Angle above the horizon, radians.
    pub elevation_rad: f64,
    /// Height of its start above the sensor's origin, metres.
    pub vertical_offset_m: f64,
}

/// Why a text is not a table of rows.
#[derive(Debug, thiserror::Error)]
pub enum RowTableError {
    /// A line cannot be meant.
    #[error(
        "line {line}: {message}; expected a line a row, from the top: the elevation in degrees, and if need be the \
         vertical offset in metres behind it"
    )]
    Line {
        /// Line, from 1.
        line: usize,
        /// What is wrong with it.
        message: String,
    },
    /// An impossible number of rows.
    #[error(
        "{found} rows, expected 1 to {MAX_ROWS}: a line with an elevation in degrees for each, from the top"
    )]
    Rows {
        /// Rows of the table.
        found: usize,
    },
}

impl RowTable {
    /// Reads a text with a line for each row, from the top: the elevation in degrees and, for
    /// sensors whose beams do not start at the origin, the vertical offset in metres. `#` begins a
    /// comment.
    ///
    /// # Errors
    /// [`RowTableError`], with the line.
    pub fn parse(text: &str) -> Result<Self, RowTableError> {
        let mut beams: Vec<RowBeam> = Vec::new();
        for (index, row) in text.lines().enumerate() {
            let line = index + 1;
            let values = row.split('#').next().unwrap_or_default();
            if values.trim().is_empty() {
                continue;
            }
            let beam =
                RowBeam::parse(values).map_err(|message| RowTableError::Line { line, message })?;
            if let Some(above) = beams
                .last()
                .filter(|above| above.elevation_rad <= beam.elevation_rad)
            {
                let above = above.elevation_rad.to_degrees();
                let found = beam.elevation_rad.to_degrees();
                let message = format!(
                    "{found:.3} degrees is not below the {above:.3} degrees of the row above"
                );
                return Err(RowTableError::Line { line, message });
            }
            beams.push(beam);
        }
        match beams.len() {
            1..=MAX_ROWS => Ok(Self { beams }),
            found => Err(RowTableError::Rows { found }),
        }
    }

    /// The rows of a calibration.
    pub fn of_calibration(calibration: &Calibration) -> Self {
        let beams = calibration.rows().iter().map(|&channel| {
            let beam = &calibration.beams()[channel];
            RowBeam {
                elevation_rad: beam.elevation_rad,
                vertical_offset_m: beam.vertical_offset_m,
            }
        });
        Self {
            beams: beams.collect(),
        }
    }

    /// The beams, from the top.
    pub fn beams(&self) -> &[RowBeam] {
        &self.beams
    }
}

impl RowBeam {
    fn parse(values: &str) -> Result<Self, String> {
        let mut words = values.split_whitespace();
        let elevation_rad = number(words.next(), "elevation", 90.0)?.to_radians();
        let vertical_offset_m = number(words.next(), "vertical offset", MAX_OFFSET_M)?;
        match words.next() {
            None => Ok(Self {
                elevation_rad,
                vertical_offset_m,
            }),
            Some(word) => Err(format!("nothing is expected where \"{word}\" stands")),
        }
    }
}

/// The number of a word, at most `most` from 0; 0 where there is no word.
fn number(word: Option<&str>, name: &str, most: f64) -> Result<f64, String> {
    let Some(word) = word else {
        return Ok(0.0);
    };
    match word.parse::<f64>() {
        Ok(number) if number.abs() <= most => Ok(number),
        _ => Err(format!(
            "{name} \"{word}\" is no number from -{most} to {most}"
        )),
    }
}

/// The points of each row, as one stretch after the other; the memory is kept from cloud to cloud.
#[derive(Clone, Debug, Default)]
pub(super) struct Groups {
    /// Row of each point.
    rows: Vec<u8>,
    /// The points, row after row; empty where they are in that order already.
    pub order: Vec<u32>,
    /// Room to put the points in that order.
    pub polars: Polars,
    /// Distinct ring numbers, in order.
    numbers: Vec<u32>,
    /// Sine and cosine of each beam's elevation, and how far it passes the origin.
    beams: Vec<[f32; 3]>,
}

impl Groups {
    /// Points with one ring number belong together; how many numbers there are.
    pub fn by_number(&mut self, rings: &[u32]) -> Result<usize, CloudError> {
        let Self { numbers, rows, .. } = self;
        numbers.clear();
        for (point, &ring) in rings.iter().enumerate() {
            if let Err(place) = numbers.binary_search(&ring) {
                if numbers.len() == MAX_ROWS {
                    return Err(CloudError::RingNumbers { point, ring });
                }
                numbers.insert(place, ring);
            }
        }
        rows.clear();
        rows.extend(
            rings
                .iter()
                .map(|ring| numbers.binary_search(ring).unwrap_or_default() as u8),
        );
        Ok(numbers.len())
    }

    /// Points belong to the beam that passes them nearest.
    pub fn by_beam(&mut self, points: &Polars, table: &RowTable) {
        let beams = table.beams.iter().map(|beam| {
            let (sin, cos) = beam.elevation_rad.sin_cos();
            [
                sin as f32,
                cos as f32,
                (beam.vertical_offset_m * cos) as f32,
            ]
        });
        self.beams.clear();
        self.beams.extend(beams);
        self.rows.clear();
        for (&away_m, &z_m) in points.away_m.iter().zip(&points.z_m) {
            let mut nearest_m = f32::INFINITY;
            let mut row = 0;
            for (index, [sin, cos, offset]) in self.beams.iter().enumerate() {
                let apart_m = (z_m * cos - away_m * sin - offset).abs();
                if apart_m < nearest_m {
                    nearest_m = apart_m;
                    row = index;
                }
            }
            self.rows.push(row as u8);
        }
    }

    /// Sorts the points into this many rings.
    pub fn sort(&mut self, rows: usize, rings: &mut Vec<Ring>) {
        let mut ends = [0_usize; MAX_ROWS];
        self.rows
            .iter()
            .for_each(|&row| ends[usize::from(row)] += 1);
        rings.clear();
        let mut first = 0;
        for end in &mut ends[..rows] {
            let ring = Ring::new(first, first + *end);
            (*end, first) = (first, ring.end);
            rings.push(ring);
        }
        self.order.clear();
        self.order.resize(self.rows.len(), 0);
        for (point, &row) in self.rows.iter().enumerate() {
            let place = &mut ends[usize::from(row)];
            self.order[*place] = point as u32;
            *place += 1;
        }
    }
}
