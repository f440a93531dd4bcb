//! Where every return of a strip of columns lies, laid out row after row, so that one instruction
//! treats many columns.
//!
//! A strip is 32 columns (`STRIP`). The buffer holds the strip at hand, the one behind it, and the
//! columns before it that a window can reach back to:
//!
//! ```text
//! lanes of a row   | 16 before | strip at hand (32) | next strip (32) |
//!                              ^ at
//! ```
//!
//! When the strip at hand is done, the next one takes its place; only when the buffer ends are the
//! lanes moved back to its start. So the working memory is some 200 columns, however wide the image
//! is.
//!
//! All is single precision: at 100 m a point is off by 10 micrometres.

use std::array;
use std::ops::{Deref, DerefMut};

use fearless_simd::{Level, Simd, dispatch, f32x16, prelude::*, u32x16};

use super::directions::Directions;
use super::ground::Window;
use super::tiles::turn_over;
use super::turn::turn_rad;
use super::{Config, MAX_ROWS};
use crate::sweep::corrected::Corrected;
use crate::sweep::layout::flags;
use crate::sweep::{BeamRow, SweepRef};

/// Columns that one instruction treats.
pub(super) const LANES: usize = 16;
/// Columns of a strip.
pub(super) const STRIP: usize = 32;
/// Columns before the strip at hand that are kept.
pub(super) const BEFORE: usize = 16;
/// Lanes before the first strip: those that are kept, and room for windows that reach over them.
const MARGIN: usize = 2 * BEFORE;
/// Lanes of a row. Rows are an odd number of cache lines apart, so that they do not fall into the
/// same places of a cache.
const STRIDE: usize = MARGIN + 5 * STRIP + 16;

/// The order in which the columns of an image are taken: a strip that only leads in, all columns,
/// and for a whole turn the first ones once more, so that the end meets the beginning.
///
/// A whole turn is not begun at its first column, but at the first that is sure to be as it is now
/// when the turn is complete: what lies beyond an end is folded to the other then. So it can be
/// taken while the head still turns.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Order {
    /// Columns of the image; `None` while it is not complete.
    pub columns: Option<usize>,
    pub circular: bool,
    /// The column at position [`STRIP`].
    pub start: usize,
}

impl Order {
    fn new(sweep: &SweepRef<'_>, columns: Option<usize>) -> Self {
        let circular = sweep.header.has(flags::CIRCULAR);
        let folded = sweep
            .beams
            .iter()
            .map(|beam| -beam.shift)
            .max()
            .unwrap_or(0)
            .max(0) as usize;
        Self {
            columns,
            circular,
            start: if circular { STRIP + folded } else { 0 },
        }
    }

    /// Position behind the last column that counts.
    pub fn end(self) -> usize {
        self.columns
            .map_or(usize::MAX / 2, |columns| STRIP + columns)
    }

    /// Position behind the last that is joined.
    pub fn joined_end(self) -> usize {
        self.end() + if self.circular { BEFORE } else { 0 }
    }

    /// Strips, with the one that leads in.
    pub fn strips(self) -> usize {
        self.joined_end().div_ceil(STRIP)
    }

    /// The column at a position, if there is one.
    #[inline(always)]
    pub fn column(self, position: usize) -> Option<usize> {
        let mut column = (self.start + position).checked_sub(STRIP)?;
        let Some(columns) = self.columns else {
            return Some(column);
        };
        // Hardly more than once, and faster than a division.
        while self.circular && columns > 0 && column >= columns {
            column -= columns;
        }
        (column < columns).then_some(column)
    }

    /// The columns at as many positions, from one on, as a vector has lanes.
    #[inline(always)]
    fn columns_from(self, position: usize) -> [Option<usize>; LANES] {
        match [0, LANES - 1].map(|ahead| self.column(position + ahead)) {
            [Some(first), Some(last)] if last == first + LANES - 1 => {
                array::from_fn(|ahead| Some(first + ahead))
            }
            _ => array::from_fn(|ahead| self.column(position + ahead)),
        }
    }
}

/// Lanes of all rows that there can be.
const ALL: usize = MAX_ROWS * STRIDE;

/// A number for each lane of each row. Sixteen columns, counted from the first of a strip, are one
/// cache line: a vector across two of them takes twice as long.
#[derive(Clone, Debug)]
pub(super) struct Plane(Box<Lines>);

#[derive(Clone, Debug)]
#[repr(C, align(64))]
struct Lines([f32; ALL]);

impl Default for Plane {
    fn default() -> Self {
        Self(Box::new(Lines([0.0; ALL])))
    }
}

impl Plane {
    /// The lanes from one on.
    #[inline(always)]
    pub fn load<S: Simd>(&self, simd: S, lane: usize) -> f32x16<S> {
        load(simd, &self[..], lane)
    }

    #[inline(always)]
    fn store<S: Simd>(&mut self, lane: usize, numbers: f32x16<S>) {
        numbers.store_slice(&mut self[lane..lane + LANES]);
    }
}

impl Deref for Plane {
    type Target = [f32; ALL];

    #[inline(always)]
    fn deref(&self) -> &[f32; ALL] {
        &self.0.0
    }
}

impl DerefMut for Plane {
    #[inline(always)]
    fn deref_mut(&mut self) -> &mut [f32; ALL] {
        &mut self.0.0
    }
}

/// The points of the strips at hand.
#[derive(Clone, Debug, Default)]
pub(super) struct Points {
    pub order: Order,
    /// Metres: right, forward, up, from the sensor's origin.
    pub x: Plane,
    pub y: Plane,
    pub z: Plane,
    /// Distance from the sensor's origin, metres.
    pub far: Plane,
    /// Range as the sweep has it, metres; 0 where there is no return that may be labelled.
    pub range: Plane,
    beams: Vec<Beam>,
    directions: Directions,
    /// Lane of the strip at hand.
    at: usize,
}

/// A return as the segmenter sees it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Placed {
    /// Right, forward, up from the sensor's origin, metres.
    pub point_m: [f32; 3],
    /// Distance from the sensor's origin, metres.
    pub far_m: f32,
    /// As the sweep has it, metres.
    pub range_m: f32,
}

/// What may be labelled in a sweep, pixel by pixel in the order of its planes; `None` where there
/// is nothing.
///
/// # Panics
/// If the sweep has more than [`MAX_ROWS`] rows.
pub fn placed(sweep: &SweepRef<'_>, config: &Config) -> Vec<Option<Placed>> {
    let mut points = Points::default();
    let (rows, columns) = (sweep.rows(), sweep.columns.len());
    points.reserve(columns);
    let mut words = vec![Window::default(); rows];
    let mut all = vec![None; rows * columns];
    dispatch!(Level::new(), simd => {
        points.begin(sweep, Some(columns));
        for first in (0..columns).step_by(STRIP) {
            points.fill(simd, sweep, config, STRIP + first, &mut words);
            for (ahead, row) in (0..STRIP.min(columns - first)).flat_map(|ahead| (0..rows).map(move |row| (ahead, row))) {
                let lane = points.at(row) + STRIP + ahead;
                let column = points.order.column(STRIP + first + ahead).unwrap_or(0);
                all[column * rows + row] = (words[row][2].real >> ahead & 1 == 1).then(|| Placed {
                    point_m: [points.x[lane], points.y[lane], points.z[lane]],
                    far_m: points.far[lane],
                    range_m: points.range[lane],
                });
            }
        }
    });
    all
}

/// What the points of a row are made from.
#[derive(Clone, Copy, Debug)]
struct Beam {
    cos_elevation: f32,
    sin_elevation: f32,
    cos_turn: f32,
    sin_turn: f32,
    time_offset_s: f32,
    vertical_offset_m: f32,
    horizontal_offset_m: f32,
    shift: i32,
    /// Base and slope of the additional offsets for x and y, where the beam is bent.
    bent: Option<[[f32; 2]; 2]>,
}

impl Points {
    /// Takes room for any image of this many columns.
    pub fn reserve(&mut self, columns: usize) {
        self.directions.reserve(columns);
    }

    /// Takes the beams of a sweep and begins with the strip that leads in; this many columns it
    /// has, if that is known. What an older sweep left does no harm: the words say what is real,
    /// and what lies before the strip that leads in reaches none that counts.
    pub fn begin(&mut self, sweep: &SweepRef<'_>, columns: Option<usize>) {
        // How the head turns when the sweep begins: what it turns faster or slower later is a small
        // rest.
        let rate_rad_s = sweep
            .columns
            .first()
            .map_or(0.0, |column| column.azimuth_rate_rad_s);
        self.order = Order::new(sweep, columns);
        self.beams.clear();
        self.beams.extend(
            sweep
                .beams
                .iter()
                .map(|beam| Beam::new(beam, f64::from(rate_rad_s))),
        );
        let margin = sweep
            .beams
            .iter()
            .map(|beam| beam.shift.unsigned_abs() as usize)
            .max()
            .unwrap_or(0);
        self.directions.clear(margin, rate_rad_s);
        self.at = MARGIN;
    }

    /// Rows of the image.
    pub fn rows(&self) -> usize {
        self.beams.len()
    }

    /// The distance from the sensor beyond which no point of one row is as near as that to one of
    /// another, metres; infinite where the beams do not tell.
    pub fn spread_m(&self, rows: [usize; 2], near_m: f32) -> f32 {
        let [a, b] = rows.map(|row| &self.beams[row]);
        if a.bent.is_some() || b.bent.is_some() {
            return f32::INFINITY;
        }
        let sin = (a.sin_elevation * b.cos_elevation - a.cos_elevation * b.sin_elevation).abs();
        let [a_m, b_m] =
            [a, b].map(|beam| beam.vertical_offset_m.abs() + beam.horizontal_offset_m.abs());
        (near_m + a_m + b_m) / sin + a_m
    }

    /// Where in a plane the strip at hand begins, in a row.
    #[inline(always)]
    pub fn at(&self, row: usize) -> usize {
        row * STRIDE + self.at
    }

    /// Points of some columns, from a lane on.
    #[inline(always)]
    pub fn place<S: Simd>(&self, simd: S, lane: usize) -> [f32x16<S>; 3] {
        [
            self.x.load(simd, lane),
            self.y.load(simd, lane),
            self.z.load(simd, lane),
        ]
    }

    /// Their heights over the sensor along a direction that is up, of length 1, metres.
    #[inline(always)]
    pub fn height<S: Simd>(&self, simd: S, lane: usize, up: [f32; 3]) -> f32x16<S> {
        match up {
            // Upright, as most sensors stand: z bit for bit.
            [0.0, 0.0, 1.0] => self.z.load(simd, lane),
            up => {
                let [x, y, z] = self.place(simd, lane);
                x * up[0] + y * up[1] + z * up[2]
            }
        }
    }

    /// Goes on to the next strip.
    #[inline(always)]
    pub fn advance(&mut self) {
        self.at += STRIP;
        if self.at + 2 * STRIP > STRIDE {
            let kept = self.at - BEFORE..self.at + STRIP;
            for plane in [
                &mut self.x,
                &mut self.y,
                &mut self.z,
                &mut self.far,
                &mut self.range,
            ] {
                for row in plane.chunks_exact_mut(STRIDE).take(self.beams.len()) {
                    row.copy_within(kept.clone(), MARGIN - BEFORE);
                }
            }
            self.at = MARGIN;
        }
    }

    /// Reads the strip behind the one at hand, which begins at this position; writes for each row
    /// which columns hold a return that may be labelled.
    #[inline(always)]
    pub fn fill<S: Simd>(
        &mut self,
        simd: S,
        sweep: &SweepRef<'_>,
        config: &Config,
        position: usize,
        words: &mut [Window],
    ) {
        self.transpose(simd, sweep, config, position);
        self.directions
            .extend(simd, sweep, self.order, position + STRIP);
        for (row, words) in words.iter_mut().enumerate() {
            let real = &mut words[2].real;
            *real = 0;
            for half in 0..STRIP / LANES {
                let lane = self.at(row) + STRIP + half * LANES;
                let range = self.range.load(simd, lane);
                let is = range.simd_gt(0.0)
                    & range.simd_ge(config.min_range_m)
                    & range.simd_le(config.max_range_m);
                let bits = is.to_bitmask() as u32;
                *real |= bits << (half * LANES);
                self.range
                    .store(lane, is.select(range, f32x16::splat(simd, 0.0)));
                if bits != 0 {
                    let at = position + half * LANES;
                    let [x, y, z] = self.beams[row].points(simd, &self.directions, at, range);
                    self.x.store(lane, x);
                    self.y.store(lane, y);
                    self.z.store(lane, z);
                    self.far.store(lane, (x * x + y * y + z * z).sqrt());
                }
            }
        }
    }

    /// Copies the ranges of the next strip, column by column into rows.
    #[inline(always)]
    #[expect(
        clippy::needless_range_loop,
        reason = "iterators over arrays of vectors go through memory"
    )]
    fn transpose<S: Simd>(
        &mut self,
        simd: S,
        sweep: &SweepRef<'_>,
        config: &Config,
        position: usize,
    ) {
        let rows = self.beams.len();
        let squared = rows / LANES * LANES;
        for half in (0..STRIP).step_by(LANES) {
            let columns = self.order.columns_from(position + half);
            for row in (0..squared).step_by(LANES) {
                let mut tile = [u32x16::splat(simd, 0); LANES];
                for ahead in 0..LANES {
                    if let Some(column) = columns[ahead] {
                        tile[ahead] = load(simd, sweep.range, column * rows + row).bitcast();
                    }
                }
                let tile = turn_over(tile);
                for line in 0..LANES {
                    self.range.store(
                        (row + line) * STRIDE + self.at + STRIP + half,
                        tile[line].bitcast(),
                    );
                }
            }
            for row in squared..rows {
                for (ahead, column) in columns.iter().enumerate() {
                    let range = column.map_or(0.0, |column| sweep.range[column * rows + row]);
                    self.range[row * STRIDE + self.at + STRIP + half + ahead] = range;
                }
            }
        }
        let Some(mask) = &config.mask else { return };
        for ahead in 0..STRIP {
            let Some(column) = self.order.column(position + ahead) else {
                continue;
            };
            for row in (0..rows).filter(|&row| mask.hides(row, sweep.azimuth_rad(row, column))) {
                self.range[row * STRIDE + self.at + STRIP + ahead] = 0.0;
            }
        }
    }
}

impl Beam {
    fn new(beam: &BeamRow, rate_rad_s: f64) -> Self {
        let (sin_elevation, cos_elevation) = f64::from(beam.elevation_rad).sin_cos();
        let (sin_turn, cos_turn) = turn_rad(beam, rate_rad_s).sin_cos();
        Self {
            cos_elevation: cos_elevation as f32,
            sin_elevation: sin_elevation as f32,
            cos_turn: cos_turn as f32,
            sin_turn: sin_turn as f32,
            time_offset_s: beam.time_offset_ns as f32 * 1e-9,
            vertical_offset_m: beam.vertical_offset_m,
            horizontal_offset_m: beam.horizontal_offset_m,
            shift: beam.shift,
            bent: Corrected::new(beam)
                .near()
                .map(|axes| axes.map(|offset| [offset.base_m as f32, offset.slope as f32])),
        }
    }

    /// The points at these ranges, of the columns from a position on.
    #[inline(always)]
    fn points<S: Simd>(
        &self,
        simd: S,
        directions: &Directions,
        position: usize,
        range: f32x16<S>,
    ) -> [f32x16<S>; 3] {
        let [sin, cos, surplus] = directions.at(simd, position, self.shift);
        let (sin, cos) = (
            sin * self.cos_turn + cos * self.sin_turn,
            cos * self.cos_turn - sin * self.sin_turn,
        );
        // What the head turned faster than at first meanwhile is so little that the first order
        // will do.
        let rest = surplus * self.time_offset_s;
        let (sin, cos) = (sin + rest * cos, cos - rest * sin);
        let flat = range * self.cos_elevation;
        let straight = [flat * sin, flat * cos, range * self.sin_elevation];
        let [x, y, z] = match &self.bent {
            Some(offsets) => self.bend(simd, offsets, [sin, cos], range, straight),
            None => straight,
        };
        let aside = self.horizontal_offset_m;
        [x - cos * aside, y + sin * aside, z + self.vertical_offset_m]
    }

    /// The points of a bent beam, where the range says that they are within its bend; see
    /// [`crate::sweep::corrected`].
    #[inline(always)]
    fn bend<S: Simd>(
        &self,
        simd: S,
        [near_x, near_y]: &[[f32; 2]; 2],
        [sin, cos]: [f32x16<S>; 2],
        range: f32x16<S>,
        straight: [f32x16<S>; 3],
    ) -> [f32x16<S>; 3] {
        let one = f32x16::splat(simd, 1.0);
        let (along_x, along_y) = (sin * self.cos_elevation, cos * self.cos_elevation);
        let (slope_x, slope_y) = (
            one - along_x.abs() * near_x[1],
            one - along_y.abs() * near_y[1],
        );
        let slopes = [
            along_x * slope_x,
            along_y * slope_y,
            (slope_x + slope_y) * (0.5 * self.sin_elevation),
        ];
        let up = 0.5 * (near_x[0] + near_y[0]) * self.sin_elevation;
        let bases = [
            along_x * near_x[0],
            along_y * near_y[0],
            f32x16::splat(simd, up),
        ];
        let (square, linear) = (dot(slopes, slopes), dot(slopes, bases));
        let rest = dot(bases, bases) - range * range;
        let root = linear * linear - square * rest;
        let is_near = (range.bitcast::<u32x16<S>>() & 1).simd_eq(1);
        let is_bent = is_near & root.simd_ge(0.0) & square.simd_gt(0.0);
        let length = (root.max(0.0).sqrt() - linear) / square;
        let x = is_bent.select(slopes[0] * length + bases[0], straight[0]);
        let y = is_bent.select(slopes[1] * length + bases[1], straight[1]);
        let z = is_bent.select(slopes[2] * length + bases[2], straight[2]);
        [x, y, z]
    }
}

#[inline(always)]
fn dot<S: Simd>(a: [f32x16<S>; 3], b: [f32x16<S>; 3]) -> f32x16<S> {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// The lanes from an index on.
#[inline(always)]
pub(super) fn load<S: Simd>(simd: S, plane: &[f32], at: usize) -> f32x16<S> {
    f32x16::from_slice(simd, &plane[at..at + LANES])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_part_of_a_turn_is_taken_as_it_stands() {
        let order = Order {
            columns: Some(10),
            circular: false,
            start: 0,
        };
        assert_eq!(
            [31, 32, 41, 42].map(|position| order.column(position)),
            [None, Some(0), Some(9), None]
        );
        assert_eq!(
            (order.end(), order.joined_end(), order.strips()),
            (42, 42, 2)
        );
    }

    #[test]
    fn a_whole_turn_is_led_into_and_taken_on_over_its_end() {
        // Two columns are folded.
        let order = Order {
            columns: Some(10),
            circular: true,
            start: STRIP + 2,
        };
        assert_eq!(
            [0, 31, 32, 41, 42].map(|position| order.column(position)),
            [2, 3, 4, 3, 4].map(Some)
        );
        assert_eq!(
            (order.end(), order.joined_end(), order.strips()),
            (42, 58, 2)
        );
        let open = Order {
            columns: None,
            ..order
        };
        assert_eq!(
            [0, 32, 1000].map(|position| open.column(position)),
            [2, 34, 1002].map(Some)
        );
    }
}
