//! Sixteen beams at once: from the records of a firing to ranges and reflectivities.
//!
//! All code here works on vectors of [`LANES`] numbers at the level of vector instructions that the
//! caller runs it at; the [decoder](super::decode) uses the best level of the machine. Sensors whose
//! rows are not shifted have an upper row in each odd channel and a lower one in each even, both from
//! the bottom up: their beams are sorted by that, so that halves of a group are written at once. The
//! [row offsets](super::row_offsets) give the pixels in the image.
//!
//! Every level gives the same bytes, because all operations round the same at each: products are
//! never fused with sums, and square roots are correctly rounded. A range is within 4e-5 m of that
//! of [`Corrected`], with the same mark of near or far.

use std::f64::consts::{FRAC_2_PI, FRAC_PI_2};

use fearless_simd::prelude::*;
use fearless_simd::{Level, f32x16, i32x16, mask32x16, u8x16, u8x64};
use zerocopy::IntoBytes;

use crate::sensor::Calibration;
use crate::sensor::calibration::Intensity;
use crate::sensor::model::Spec;
use crate::sweep::corrected::Corrected;
use crate::sweep::layout::BeamRow;
use crate::wire::data::{Block, RECORDS, Record};

/// Beams that are computed at once. It divides the number of beams of every model.
pub const LANES: usize = 16;
/// Least range of a record that is not zero, metres, so that no correction can turn a return into
/// none.
const LEAST_RANGE_M: f32 = 0.001;
/// The greatest distance of 16 bits at 2 mm, metres; focal distances are given as a share of it.
const FULL_SCALE_M: f64 = 131.0;

/// Bytes of a record.
const RECORD: usize = size_of::<Record>();

/// Starts of the four groups of sixteen bytes that each hold four records, the last records first:
/// that group ends with the last one.
const FROM: [usize; 4] = [LANES * RECORD - 16, 8 * RECORD, 4 * RECORD, 0];
/// Byte indices that spread four records to four bytes each, from the last record to the first; the
/// fourth byte is arbitrary.
const SPREAD: [u8; 4 * LANES] = {
    let mut spread = [0; 4 * LANES];
    let mut at = 0;
    while at < spread.len() {
        let quarter = at / 16;
        let record = LANES - 1 - at / 4;
        let byte = at % 4;
        let byte = if byte < RECORD { byte } else { RECORD - 1 };
        spread[at] = (record * RECORD + byte - FROM[quarter]) as u8;
        at += 1;
    }
    spread
};

/// A number for each of the beams.
pub type PerLane<T> = [T; LANES];

/// What the beams of a sensor need.
#[derive(Clone, Debug)]
pub struct BeamGroups {
    /// Metres of one unit of distance.
    unit_m: f32,
    groups: Vec<Group>,
    /// The lanes are in the order of rows; see [`place`].
    by_row: bool,
    /// Distances, in units, that are nearer than where the two-point correction ends.
    near_units: i32,
}

/// What sixteen of them need.
#[derive(Clone, Debug)]
struct Group {
    distance_offset_m: PerLane<f32>,
    bend: Option<Bend>,
    focus: Option<Focus>,
}

/// How the beams leave the straight line; see [`Corrected`].
#[derive(Clone, Debug, Default)]
struct Bend {
    sin_elevation: PerLane<f32>,
    cos_elevation: PerLane<f32>,
    /// Additional offsets along x and y: what they lose each metre, and what they are at the axis'
    /// zero.
    slope: [PerLane<f32>; 2],
    base_m: [PerLane<f32>; 2],
    /// 1 of a beam that is bent: the bit that says so in its range.
    mark: PerLane<i32>,
}

/// Intensity that beams lose outside their focus (HDL-64E S3 manual, appendix F).
#[derive(Clone, Debug, Default)]
struct Focus {
    /// Where it is bright: 256 times the square of the share of the full scale that is left beyond.
    at: PerLane<f32>,
    slope: PerLane<f32>,
    min: PerLane<f32>,
    max: PerLane<f32>,
}

/// How far the beams point to the side of their firing.
#[derive(Clone, Copy, Debug, Default)]
pub struct SideAngles {
    /// Sine of the angle from the firing's azimuth to the beam's.
    pub sin: PerLane<f32>,
    /// Its cosine.
    pub cos: PerLane<f32>,
}

/// One return of each beam: range and reflectivity.
#[derive(Clone, Copy)]
pub struct Decoded<S: Simd> {
    /// Metres.
    pub range_m: f32x16<S>,
    /// Calibrated reflectivity.
    pub reflectivity: i32x16<S>,
    /// How many there are.
    pub returns: u32,
}

/// Where a firing points: sine and cosine of its azimuth.
pub type Direction = [f32; 2];

/// The records of a return of a firing: the blocks from its first on, which of them are its own,
/// and where its records begin in each.
#[derive(Clone, Copy, Debug)]
pub struct Records<'a> {
    /// The blocks, also those of the other return.
    pub blocks: &'a [Block],
    /// Blocks from a bank of 32 channels to the next.
    pub bank_step: usize,
    /// First record of the firing in each.
    pub first: usize,
}

impl BeamGroups {
    /// For these beams of a model, given as a sweep carries them too, row by row.
    pub fn new(calibration: &Calibration, rows: &[BeamRow], spec: &Spec) -> Self {
        let unit_m = calibration.distance_unit_m();
        let mut groups = vec![Group::straight(); rows.len().div_ceil(LANES)];
        for row in rows {
            let (group, lane) = place(row.channel, spec);
            groups[group].take(
                lane,
                row,
                calibration.beams()[row.channel as usize].intensity,
            );
        }
        let near_units = (0..=u32::from(u16::MAX))
            .take_while(|&units| Corrected::is_near(f64::from(units) * unit_m))
            .count() as i32;
        Self {
            unit_m: unit_m as f32,
            groups,
            by_row: !spec.shifted,
            near_units,
        }
    }

    /// Whether ranges depend on the azimuth.
    pub fn bend(&self) -> bool {
        self.groups.iter().any(|group| group.bend.is_some())
    }

    /// Groups of [`LANES`] that the beams make.
    pub fn groups(&self) -> usize {
        self.groups.len()
    }

    /// Decodes a group of records of a firing in this direction, with these angles of the beams to
    /// its side.
    #[inline(always)]
    pub fn decode<S: Simd>(
        &self,
        simd: S,
        index: usize,
        records: Records<'_>,
        direction: Direction,
        aside: &SideAngles,
        is_normalised: bool,
    ) -> Decoded<S> {
        let group = &self.groups[index];
        let records = records.group(simd, index, self.by_row);
        let distance = records & 0xFFFF;
        let reported = (records >> 16) & 0xFF;
        let units: f32x16<S> = distance.to_float();
        let offset_m = load(simd, &group.distance_offset_m);
        let mut range_m = (units * self.unit_m + offset_m).max(LEAST_RANGE_M);
        if let Some(bend) = &group.bend {
            let near_m = bend.ranges_m(simd, range_m, direction, aside);
            range_m = bend.mark(simd, distance.simd_lt(self.near_units), near_m, range_m);
        }
        let is_return = distance.simd_gt(0);
        let reflectivity = match group.focus.as_ref().filter(|_| !is_normalised) {
            Some(focus) => is_return.select(focus.reflectivities(simd, reported, units), reported),
            None => reported,
        };
        let returns = is_return.to_bitmask().count_ones();
        Decoded {
            range_m: is_return.select(range_m, f32x16::splat(simd, 0.0)),
            reflectivity,
            returns,
        }
    }
}

impl<S: Simd> Decoded<S> {
    /// `self` where `is` holds, and `other` elsewhere.
    #[inline(always)]
    pub fn or(self, other: Self, is: mask32x16<S>) -> Self {
        Self {
            range_m: is.select(self.range_m, other.range_m),
            reflectivity: is.select(self.reflectivity, other.reflectivity),
            ..self
        }
    }
}

impl Records<'_> {
    /// Those of the other return, this many blocks behind.
    #[inline(always)]
    pub fn behind(self, blocks: usize) -> Self {
        Self {
            blocks: &self.blocks[blocks..],
            ..self
        }
    }

    /// A group of records in the order of its lanes ([`place`]): distance in the low sixteen bits of
    /// each, then reflectivity, then an arbitrary byte.
    #[inline(always)]
    fn group<S: Simd>(&self, simd: S, group: usize, by_row: bool) -> i32x16<S> {
        const IN_BLOCK: usize = RECORDS / LANES;
        let records = &self.blocks[group / IN_BLOCK * self.bank_step].records
            [self.first + group % IN_BLOCK * LANES..];
        let bytes = records
            .as_bytes()
            .first_chunk()
            .expect("a block is whole groups");
        let first = quarter(simd, bytes, 0).combine(quarter(simd, bytes, 1));
        let second = quarter(simd, bytes, 2).combine(quarter(simd, bytes, 3));
        let packed: u8x64<S> = first.combine(second);
        let downwards: i32x16<S> = packed
            .swizzle_dyn_within_blocks(u8x64::load_array(simd, SPREAD))
            .bitcast();
        if !by_row {
            return downwards;
        }
        let (first, second) = downwards.split();
        let (odd, even) = first.deinterleave(second);
        odd.combine(even)
    }
}

impl Group {
    fn straight() -> Self {
        Self {
            distance_offset_m: [0.0; LANES],
            bend: None,
            focus: None,
        }
    }

    fn take(&mut self, lane: usize, row: &BeamRow, intensity: Option<Intensity>) {
        self.distance_offset_m[lane] = row.distance_offset_m;
        let corrected = Corrected::new(row);
        if let Some(near) = corrected.near() {
            let bend = self.bend.get_or_insert_default();
            [bend.sin_elevation[lane], bend.cos_elevation[lane]] =
                corrected.elevation().map(|one| one as f32);
            for (axis, offset) in near.iter().enumerate() {
                (bend.slope[axis][lane], bend.base_m[axis][lane]) =
                    (offset.slope as f32, offset.base_m as f32);
            }
            bend.mark[lane] = 1;
        }
        if let Some(intensity) = intensity {
            self.focus
                .get_or_insert_with(Focus::none)
                .take(lane, intensity);
        }
    }
}

impl Bend {
    /// Ranges of beams of these lengths within the limit of the two-point correction.
    #[inline(always)]
    fn ranges_m<S: Simd>(
        &self,
        simd: S,
        d: f32x16<S>,
        direction: Direction,
        aside: &SideAngles,
    ) -> f32x16<S> {
        let [sin, cos] = direction;
        let aside_sin = load(simd, &aside.sin);
        let aside_cos = load(simd, &aside.cos);
        let cos_elevation = load(simd, &self.cos_elevation);
        let along_x = (aside_cos * sin + aside_sin * cos) * cos_elevation;
        let along_y = (aside_cos * cos - aside_sin * sin) * cos_elevation;
        let x = d + self.offset_m(simd, 0, along_x.abs() * d);
        let y = d + self.offset_m(simd, 1, along_y.abs() * d);
        let z = (x + y) * 0.5 * load(simd, &self.sin_elevation);
        let x = x * along_x;
        let y = y * along_y;
        (x * x + y * y + z * z).sqrt().max(LEAST_RANGE_M)
    }

    /// The additional offset along an axis, at this coordinate of the beam.
    #[inline(always)]
    fn offset_m<S: Simd>(&self, simd: S, axis: usize, along_m: f32x16<S>) -> f32x16<S> {
        load(simd, &self.base_m[axis]) - load(simd, &self.slope[axis]) * along_m
    }

    /// The range to store, with the bit that says near or far where a beam has one.
    #[inline(always)]
    fn mark<S: Simd>(
        &self,
        simd: S,
        is_near: mask32x16<S>,
        near_m: f32x16<S>,
        far_m: f32x16<S>,
    ) -> f32x16<S> {
        let mark = i32x16::load_array_ref(simd, &self.mark);
        let near = is_near.select(mark, i32x16::splat(simd, 0));
        let range_m: i32x16<S> = near.simd_gt(0).select(near_m, far_m).bitcast();
        (range_m & !mark | near).bitcast()
    }
}

impl Focus {
    /// Beams that report what they measure.
    fn none() -> Self {
        Self {
            max: [255.0; LANES],
            ..Self::default()
        }
    }

    fn take(&mut self, lane: usize, intensity: Intensity) {
        let beyond = 1.0 - intensity.focal_distance_m / FULL_SCALE_M;
        self.at[lane] = (256.0 * beyond * beyond) as f32;
        self.slope[lane] = intensity.focal_slope as f32;
        self.min[lane] = (intensity.min as f32).clamp(0.0, 255.0);
        self.max[lane] = (intensity.max as f32).clamp(0.0, 255.0);
    }

    /// Reflectivities of what the beams measured, from what they report.
    #[inline(always)]
    fn reflectivities<S: Simd>(&self, simd: S, reported: i32x16<S>, units: f32x16<S>) -> i32x16<S> {
        const SHARE: f32 = 1.0 / u16::MAX as f32;
        let beyond = 1.0 - units * SHARE;
        let off = (load(simd, &self.at) - beyond * 256.0 * beyond).abs();
        let bright = reported.to_float::<f32x16<S>>() + load(simd, &self.slope) * off;
        // Rounded to nearest: clamped values fit into a byte.
        (bright.max(load(simd, &self.min)).min(load(simd, &self.max)) + 0.5).to_int()
    }
}

/// Sixteen bytes with four of sixteen records.
#[inline(always)]
fn quarter<S: Simd>(simd: S, records: &[u8; LANES * RECORD], quarter: usize) -> u8x16<S> {
    u8x16::from_slice(simd, &records[FROM[quarter]..][..16])
}

/// A function, not a closure, as everywhere here: a closure may be compiled without the vector
/// instructions of its caller's level.
#[inline(always)]
fn load<S: Simd>(simd: S, lanes: &PerLane<f32>) -> f32x16<S> {
    f32x16::load_array_ref(simd, lanes)
}

/// Ratio of each term to the one before it in the series of a sine, and of a cosine, without the
/// sign; the last term first.
const SIN: [f64; 5] = [1.0 / 110.0, 1.0 / 72.0, 1.0 / 42.0, 1.0 / 20.0, 1.0 / 6.0];
const COS: [f64; 5] = [1.0 / 90.0, 1.0 / 56.0, 1.0 / 30.0, 1.0 / 12.0, 1.0 / 2.0];

/// The series of a sine or cosine, nested: each term from the one before it.
fn horner(square: f64, shares: [f64; 5]) -> f64 {
    shares
        .into_iter()
        .fold(1.0, |rest, share| 1.0 - square * share * rest)
}

/// Sine and cosine of an azimuth, 0..2 pi, to the last bit or two of an f32.
///
/// The result is the same on every machine, which the system's library does not promise.
pub fn direction(azimuth_rad: f64) -> Direction {
    // To the nearest quarter turn, and the rest of at most 45 degrees by the series.
    let quarters = (azimuth_rad * FRAC_2_PI + 0.5) as i32;
    let rest = azimuth_rad - f64::from(quarters) * FRAC_PI_2;
    let square = rest * rest;
    let sin = (rest * horner(square, SIN)) as f32;
    let cos = horner(square, COS) as f32;
    match quarters & 3 {
        0 => [sin, cos],
        1 => [cos, -sin],
        2 => [-sin, -cos],
        _ => [-cos, sin],
    }
}

/// The levels of vector instructions that this machine has, the least first.
pub fn levels() -> Vec<Level> {
    let best = Level::new();
    #[cfg(target_arch = "x86_64")]
    let lower = [
        best.as_sse2().map(Simd::level),
        best.as_sse4_2().map(Simd::level),
        best.as_avx2().map(Simd::level),
        best.as_avx512().map(Simd::level),
    ];
    #[cfg(not(target_arch = "x86_64"))]
    let lower = [Some(best)];
    lower.into_iter().flatten().collect()
}

/// The group of a channel, and its lane there: the last channel comes first, and where rows are not
/// shifted, the odd ones come before the even ones.
pub fn place(channel: u32, spec: &Spec) -> (usize, usize) {
    let group = channel as usize / LANES;
    let downwards = LANES - 1 - channel as usize % LANES;
    match spec.shifted {
        true => (group, downwards),
        false => (group, downwards % 2 * (LANES / 2) + downwards / 2),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sensor::{Model, ModelExt};

    #[test]
    fn a_direction_is_that_of_the_azimuth() {
        for cdeg in 0..3_600_000_u32 {
            let azimuth_rad = (f64::from(cdeg) / 10_000.0).to_radians();
            let (sin, cos) = azimuth_rad.sin_cos();
            let [found_sin, found_cos] = direction(azimuth_rad).map(f64::from);
            assert!(
                (found_sin - sin).abs() < 4e-8 && (found_cos - cos).abs() < 4e-8,
                "{azimuth_rad}"
            );
        }
    }

    #[test]
    fn firings_are_whole_groups() {
        for model in Model::ALL {
            assert_eq!(model.spec().channels % LANES, 0, "{model}");
        }
    }
}
