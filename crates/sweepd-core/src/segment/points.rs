//! Where returns lie: in space, and as the ground sees them.
//!
//! All is single precision: at 100 m a point is off by 10 micrometres.

use fearless_simd::{Level, Simd, dispatch, f32x4, f32x8, f32x16, prelude::*, u32x16};

use super::config::Config;
use super::directions::Directions;
use super::mount::{Mount, Stance};
use super::order::{AHEAD, LANES, MAX_ROWS, Order, STRIP, load};
use super::ranges::Ranges;
use super::turn::turn_rad;
use crate::sweep::corrected::Corrected;
use crate::sweep::{BeamRow, SweepRef};

/// The beams of a sweep, and where the head looked.
#[derive(Clone, Debug, Default)]
pub(super) struct Beams {
    pub order: Order,
    rows: Vec<Beam>,
    /// The rows from the lowest up: from the last, or head down, from the first.
    upwards: Vec<usize>,
    directions: Directions,
}

/// What the points of a row are made from.
#[derive(Clone, Copy, Debug)]
pub(super) struct Beam {
    cos_elevation: f32,
    sin_elevation: f32,
    /// What a metre along the beam rises over the sensor, as far as the azimuth does not matter.
    lift: f32,
    /// Height of the beam's origin over the sensor's.
    origin_height_m: f32,
    /// How far the plumb line leans to the right and forward, if it does: sines.
    tilt: Option<[f32; 2]>,
    cos_turn: f32,
    sin_turn: f32,
    time_offset_s: f32,
    vertical_offset_m: f32,
    horizontal_offset_m: f32,
    shift: i32,
    /// Base and slope of the additional offsets for x and y, where the beam is bent.
    bent: Option<[[f32; 2]; 2]>,
}

/// Returns as the ground sees them: distance from the plumb line, and height over the sensor,
/// metres.
#[derive(Clone, Copy)]
pub(super) struct Profile<T> {
    pub away: T,
    pub height: T,
}

/// A return as the segmenter sees it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Placed {
    /// Right, forward, up from the sensor's origin, metres.
    pub point_m: [f32; 3],
    /// As the sweep has it, metres.
    pub range_m: f32,
    /// Distance from the plumb line through the sensor, metres.
    pub away_m: f32,
    /// Over the sensor, metres.
    pub height_m: f32,
}

/// What may be labelled in a sweep, pixel by pixel in the order of its planes; `None` where there
/// is nothing.
///
/// # Panics
/// If the sweep has more than [`MAX_ROWS`] rows.
pub fn placed(sweep: &SweepRef<'_>, config: &Config) -> Vec<Option<Placed>> {
    let rows = sweep.rows();
    let columns = sweep.columns.len();
    assert!(rows <= MAX_ROWS, "more rows than an image has");
    let mut beams = Beams::default();
    let mut ranges = Ranges::default();
    let mut all = vec![None; rows * columns];
    if columns == 0 {
        return all;
    }
    dispatch!(Level::new(), simd => {
        beams.begin(sweep, Some(columns), &config.mount);
        let order = beams.order;
        for position in (0..order.end()).step_by(STRIP) {
            beams.look_up(simd, sweep, position);
            ranges.fill(simd, sweep, config, order, position + AHEAD);
            // The first strip only leads in.
            if position == 0 {
                continue;
            }
            for (row, ahead) in (0..rows).flat_map(|row| (0..STRIP).map(move |ahead| (row, ahead))) {
                let column = order.column(position + ahead).unwrap_or(0);
                if ranges.real[row][1] >> ahead & 1 == 0 || position + ahead >= order.end() {
                    continue;
                }
                let lane = ahead % LANES;
                let at = position + ahead - lane;
                let range = ranges.load(simd, row, ahead - lane);
                let beam = beams.row(row);
                let profile = beams.profile(simd, beam, at, range);
                all[column * rows + row] = Some(Placed {
                    point_m: beams.points(simd, beam, at, range).map(|axis| axis[lane]),
                    range_m: range[lane],
                    away_m: profile.away[lane],
                    height_m: profile.height[lane],
                });
            }
        }
    });
    all
}

impl Beams {
    /// Takes room for any image of this many columns.
    pub fn reserve(&mut self, columns: usize) {
        self.directions.reserve(columns);
    }

    /// Takes the beams of a sweep; this many columns it has, if that is known.
    pub fn begin(&mut self, sweep: &SweepRef<'_>, columns: Option<usize>, mount: &Mount) {
        let up = mount.up().axis();
        // How the head turns when the sweep begins: what it turns faster or slower later is a small
        // rest.
        let rate_rad_s = sweep
            .columns
            .first()
            .map_or(0.0, |column| column.azimuth_rate_rad_s);
        self.order = Order::new(sweep, columns);
        self.rows.clear();
        self.rows.extend(
            sweep
                .beams
                .iter()
                .map(|beam| Beam::new(beam, f64::from(rate_rad_s), up)),
        );
        self.upwards.clear();
        self.upwards.extend(0..sweep.beams.len());
        if mount.stance() != Stance::HeadDown {
            self.upwards.reverse();
        }
        let margin = sweep
            .beams
            .iter()
            .map(|beam| beam.shift.unsigned_abs() as usize)
            .max()
            .unwrap_or(0);
        self.directions.begin(margin, rate_rad_s);
    }

    /// Rows of the image.
    pub fn rows(&self) -> usize {
        self.rows.len()
    }

    /// The rows of the image, from the lowest up.
    pub fn upwards(&self) -> &[usize] {
        &self.upwards
    }

    /// Whether heights depend on where the head looked.
    pub fn is_tilted(&self) -> bool {
        self.rows.first().is_some_and(|beam| beam.tilt.is_some())
    }

    /// Looks up where the head looked at the firings of the strip at a position: what follows is of
    /// its columns.
    #[inline(always)]
    pub fn look_up<S: Simd>(&mut self, simd: S, sweep: &SweepRef<'_>, position: usize) {
        self.directions.look_up(simd, sweep, self.order, position);
    }

    /// The beam of a row.
    #[inline(always)]
    pub fn row(&self, row: usize) -> Beam {
        self.rows[row]
    }

    /// The points of a beam at these ranges, of the columns from a position on: right, forward, up,
    /// from the sensor's origin, metres.
    #[inline(always)]
    pub fn points<S: Simd>(
        &self,
        simd: S,
        beam: Beam,
        position: usize,
        range: f32x16<S>,
    ) -> [f32x16<S>; 3] {
        let [sin, cos] = self.aim(simd, beam, position);
        let flat = range * beam.cos_elevation;
        let straight = [flat * sin, flat * cos, range * beam.sin_elevation];
        let [x, y, z] = match &beam.bent {
            Some(offsets) => beam.bend(simd, offsets, [sin, cos], range, straight),
            None => straight,
        };
        let aside = beam.horizontal_offset_m;
        [x - cos * aside, y + sin * aside, z + beam.vertical_offset_m]
    }

    /// The same as the ground sees them. Beams are taken to be straight here, and to start on the
    /// sensor's axis: the few centimetres that they are bent or lie aside hardly show in heights.
    #[inline(always)]
    pub fn profile<S: Simd, V: SimdFloat<S, Element = f32>>(
        &self,
        simd: S,
        beam: Beam,
        position: usize,
        range: V,
    ) -> Profile<V> {
        let Some([x, y]) = beam.tilt else {
            return Profile {
                away: range * beam.cos_elevation,
                height: range * beam.lift + beam.origin_height_m,
            };
        };
        let [sin, cos]: [V; 2] = self.aim(simd, beam, position);
        let lift = (sin * x + cos * y) * beam.cos_elevation + beam.lift;
        let one = V::splat(simd, 1.0);
        Profile {
            away: range * (one - lift * lift).max(0.0).sqrt(),
            height: range * lift + beam.origin_height_m,
        }
    }

    /// Sines and cosines of where a beam points to in the columns from a position on.
    #[inline(always)]
    fn aim<S: Simd, V: SimdFloat<S, Element = f32>>(
        &self,
        simd: S,
        beam: Beam,
        position: usize,
    ) -> [V; 2] {
        let [head_sin, head_cos, surplus]: [V; 3] = self.directions.at(simd, position, beam.shift);
        let sin = head_sin * beam.cos_turn + head_cos * beam.sin_turn;
        let cos = head_cos * beam.cos_turn - head_sin * beam.sin_turn;
        // What the head turned faster than at first meanwhile is so little that the first order
        // will do.
        let rest = surplus * beam.time_offset_s;
        [sin + rest * cos, cos - rest * sin]
    }
}

impl Beam {
    fn new(beam: &BeamRow, rate_rad_s: f64, [x, y, z]: [f32; 3]) -> Self {
        let (sin_elevation, cos_elevation) = f64::from(beam.elevation_rad).sin_cos();
        let (sin_turn, cos_turn) = turn_rad(beam, rate_rad_s).sin_cos();
        Self {
            cos_elevation: cos_elevation as f32,
            sin_elevation: sin_elevation as f32,
            lift: sin_elevation as f32 * z,
            origin_height_m: beam.vertical_offset_m * z,
            tilt: Some([x, y]).filter(|tilt| *tilt != [0.0; 2]),
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
        let along_x = sin * self.cos_elevation;
        let along_y = cos * self.cos_elevation;
        let slope_x = one - along_x.abs() * near_x[1];
        let slope_y = one - along_y.abs() * near_y[1];
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
        let square = dot(slopes, slopes);
        let linear = dot(slopes, bases);
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

/// The points of a row of the strip at hand: x, y, z and the range of each, column after column, and
/// room for sixteen that are asked for and left out.
#[derive(Clone, Debug)]
pub(super) struct RowPoints(Box<[f32; 4 * (STRIP + LANES)]>);

impl Default for RowPoints {
    fn default() -> Self {
        Self(Box::new([0.0; 4 * (STRIP + LANES)]))
    }
}

impl RowPoints {
    /// Takes the points of the sixteens of columns that hold some of these.
    #[inline(always)]
    pub fn place<S: Simd>(
        &mut self,
        simd: S,
        beams: &Beams,
        ranges: &Ranges,
        row: usize,
        position: usize,
        columns: u64,
    ) {
        let beam = beams.row(row);
        for first in (0..STRIP).step_by(LANES) {
            if columns >> first & 0xFFFF == 0 {
                continue;
            }
            let range = ranges.load(simd, row, first);
            let [x, y, z] = beams.points(simd, beam, position + first, range);
            let (low_xz, high_xz) = x.interleave(z);
            let (low_yr, high_yr) = y.interleave(range);
            let (first_four, second) = low_xz.interleave(low_yr);
            let (third, fourth) = high_xz.interleave(high_yr);
            for (four, points) in [first_four, second, third, fourth].iter().enumerate() {
                let into = 4 * (first + 4 * four);
                points.store_slice(&mut self.0[into..into + LANES]);
            }
        }
    }

    /// The points of four columns.
    #[inline(always)]
    pub fn four<S: Simd>(&self, simd: S, first: usize) -> f32x16<S> {
        load(simd, &self.0[..], 4 * first)
    }
}

/// The fours of sixteen numbers.
#[inline(always)]
pub(super) fn quarters<S: Simd>(lanes: f32x16<S>) -> [f32x4<S>; 4] {
    let (low, high): (f32x8<S>, f32x8<S>) = lanes.split();
    let (first, second) = low.split();
    let (third, fourth) = high.split();
    [first, second, third, fourth]
}
