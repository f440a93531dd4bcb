//! The default method, strip by strip: points, ground, runs, joins; and at the end the components,
//! their labels and table.
//!
//! ```text
//! begin         beams, how far they spread, height, the test
//! find_ground   the points of the next strip, and how deep they lie; its columns are climbed, and compared with those before
//! join          the vote on the strip at hand, its runs, their pieces, and what within reach these are joined to
//! label         components, small ones to others, labels, segments table
//! ```
//!
//! For a whole turn the first columns are taken once more behind the last: what they hold for the
//! second time is united with what it was the first time, and not counted again.

use fearless_simd::{Level, Simd, dispatch, f32x16, mask32x16, prelude::*, u32x16};

use super::crowd::Crowd;
use super::extent::Extent;
use super::fan::Fan;
use super::ground::{SlopeGround, Stand, Window as Words};
use super::pieces::{Pieces, Whereabouts};
use super::points::{BEFORE, LANES, Points, STRIP};
use super::reach::{Joined, Reach};
use super::tiles::write_columns;
use super::window::{Miss, Test};
use super::{Config, reserve};
use crate::sweep::layout::{LABEL_FIRST_SEGMENT, LABEL_GROUND, LABEL_NONE, Segment};
use crate::sweep::{SweepMut, SweepRef};

/// Labels sweeps by the default method; after the first in buffers of one size it allocates
/// nothing.
#[derive(Clone, Debug)]
pub(super) struct Strips {
    level: Level,
    stand: Stand,
    test: Test,
    /// Strips that were read, with the one that leads in.
    at: usize,
    /// Columns that are as they will be, while the sweep is not complete.
    ready: Option<usize>,
    points: Points,
    fan: Fan,
    words: Vec<Words>,
    /// How deep below the sensor the lowest return of each column lies, position by position,
    /// metres; infinite where there is none.
    depths_m: Vec<f32>,
    reach: Reach,
    crowd: Crowd,
    /// What is no ground in the strip at hand, row by row.
    on: Vec<u32>,
    pieces: Pieces,
    misses: Vec<Miss>,
    /// Ground of the strips that count, row by row.
    ground: Vec<u32>,
    /// Pieces of the first columns: what they hold for the second time is the same.
    first: Vec<[u32; BEFORE]>,
    finish: Finish,
}

/// Workspace of the end.
#[derive(Clone, Debug, Default)]
struct Finish {
    /// Roots of the components.
    roots: Vec<u32>,
    /// For each small component the nearest that is not: the square of the distance, its first
    /// pixel, and its root.
    nearest: Vec<(f32, u32, u32)>,
    /// First pixel and root of the components that become segments.
    order: Vec<(u32, u32)>,
    /// Label of each component, at its root; of a small one too.
    label: Vec<u32>,
    extents: Vec<Extent>,
    tile: Vec<u32>,
}

impl Strips {
    pub fn new(level: Level) -> Self {
        Self {
            level,
            stand: Stand::default(),
            test: Test::default(),
            at: 0,
            ready: None,
            points: Points::default(),
            fan: Fan::default(),
            words: Vec::new(),
            depths_m: Vec::new(),
            reach: Reach::default(),
            crowd: Crowd::default(),
            on: Vec::new(),
            pieces: Pieces::default(),
            misses: Vec::new(),
            ground: Vec::new(),
            first: Vec::new(),
            finish: Finish::default(),
        }
    }

    /// Takes room for any sweep that such a buffer can hold. Room that is never touched costs no
    /// memory.
    fn reserve(&mut self, sweep: &SweepMut<'_>) {
        let (rows, columns, pixels) = (
            sweep.header.rows as usize,
            sweep.columns.len(),
            sweep.range.len(),
        );
        self.points.reserve(columns);
        self.fan.reserve(rows);
        self.words.resize(rows, Words::default());
        reserve(&mut self.depths_m, columns.next_multiple_of(STRIP));
        self.crowd.reserve(rows);
        self.on.resize(rows, 0);
        self.first.resize(rows, [0; BEFORE]);
        // The first columns are there twice.
        let most_pieces = pixels + rows * BEFORE;
        self.pieces.reserve(most_pieces);
        reserve(&mut self.misses, pixels);
        reserve(&mut self.ground, rows * columns.div_ceil(STRIP));
        reserve(&mut self.finish.roots, most_pieces);
        reserve(&mut self.finish.nearest, most_pieces);
        reserve(&mut self.finish.order, most_pieces);
        reserve(&mut self.finish.label, most_pieces);
        reserve(&mut self.finish.extents, sweep.segments.len());
        reserve(&mut self.finish.tile, rows * STRIP);
    }

    /// Takes what a sweep says of its beams. While it is not complete, only this many of its
    /// columns are as they will be.
    pub fn begin(
        &mut self,
        sweep: &SweepMut<'_>,
        config: &Config,
        height_m: Option<f32>,
        ready: Option<usize>,
    ) {
        self.reserve(sweep);
        self.stand = Stand {
            up: config.mount.up().axis(),
            height_m,
        };
        self.test = Test::new(&config.joining, config.theta_rad, self.words.len());
        self.words.fill(Words::default());
        self.reach.clear();
        self.at = 0;
        self.ready = ready;
        let sweep = sweep.as_ref();
        self.points
            .begin(&sweep, ready.is_none().then_some(sweep.columns.len()));
        self.fan
            .measure(&self.points, config.joining.rows, self.test.near_m());
    }

    /// More columns are ready, or all (`None`).
    pub fn go_on(&mut self, sweep: &SweepMut<'_>, ready: Option<usize>) {
        self.ready = ready;
        self.points.order.columns = ready.is_none().then_some(sweep.header.columns as usize);
    }

    /// Height of the sensor over the ground, as this sweep was begun with, metres.
    pub fn height_m(&self) -> Option<f32> {
        self.stand.height_m
    }

    /// How deep below the sensor the lowest return of each column lies, metres; infinite where
    /// there is none. Of a sweep that was segmented.
    pub fn depths_m(&self) -> &[f32] {
        &self.depths_m
    }

    /// The same of a sweep that is not, of which all columns are there.
    pub fn sound(&mut self, sweep: &SweepMut<'_>, config: &Config) -> &[f32] {
        self.begin(sweep, config, None, None);
        let sweep = sweep.as_ref();
        while self.has_next() {
            dispatch!(self.level, simd => self.read(simd, &sweep, config));
            self.at += 1;
        }
        self.depths_m()
    }

    /// Finds the ground of the next strip. False when there is none, or none yet.
    pub fn find_ground(&mut self, sweep: &SweepMut<'_>, config: &Config) -> bool {
        while self.has_next() {
            let sweep = sweep.as_ref();
            dispatch!(self.level, simd => self.next(simd, &sweep, config));
            // The strip at hand is the one before the last that was read, and the first only leads
            // in.
            if self.at > 2 {
                return true;
            }
        }
        false
    }

    fn has_next(&self) -> bool {
        let order = self.points.order;
        if self.points.rows() == 0 {
            return false;
        }
        match (self.ready, order.columns) {
            (Some(ready), _) => order.start + self.at * STRIP <= ready,
            (None, columns) => {
                columns.is_some_and(|columns| columns > 0) && self.at <= order.strips()
            }
        }
    }

    /// Joins the runs of that strip with each other and with those before.
    pub fn join(&mut self) {
        dispatch!(self.level, simd => self.take(simd));
    }

    /// Writes labels and segments, and how many there are of each into the header.
    pub fn label(&mut self, sweep: &mut SweepMut<'_>, config: &Config) {
        dispatch!(self.level, simd => self.finish_with(simd, sweep, config));
    }

    /// Goes on to the next strip, and reads the points behind it: the vote looks ahead.
    #[inline(always)]
    fn next<S: Simd>(&mut self, simd: S, sweep: &SweepRef<'_>, config: &Config) {
        self.read(simd, sweep, config);
        config
            .slope
            .climb(simd, &self.points, &self.stand, &mut self.words);
        config.slope.compare(simd, &self.points, &mut self.words);
        self.at += 1;
    }

    #[inline(always)]
    fn read<S: Simd>(&mut self, simd: S, sweep: &SweepRef<'_>, config: &Config) {
        if self.at > 0 {
            self.points.advance();
            self.words
                .iter_mut()
                .for_each(|words| words.copy_within(1.., 0));
        }
        self.points
            .fill(simd, sweep, config, self.at * STRIP, &mut self.words);
        if config.mount.height_m.is_none() {
            self.note_depths(simd);
        }
    }

    /// Notes the depths of the strip that was read, of the columns that count.
    #[inline(always)]
    fn note_depths<S: Simd>(&mut self, simd: S) {
        let position = self.at * STRIP;
        let count = self.points.order.end().saturating_sub(position).min(STRIP);
        if self.at == 0 || count == 0 {
            return;
        }
        let mut depths_m = [f32x16::splat(simd, f32::INFINITY); STRIP / LANES];
        // From the top: what lies lowest is noted last.
        for (row, words) in self.words.iter().enumerate() {
            for (half, depth_m) in depths_m.iter_mut().enumerate() {
                let real = mask32x16::from_bitmask(
                    simd,
                    u64::from(words[2].real >> (half * LANES)) & 0xFFFF,
                );
                let lane = self.points.at(row) + STRIP + half * LANES;
                *depth_m = real.select(-self.points.height(simd, lane, self.stand.up), *depth_m);
            }
        }
        depths_m
            .iter()
            .for_each(|depth_m| self.depths_m.extend_from_slice(depth_m.as_slice()));
        self.depths_m
            .truncate(self.depths_m.len() - (STRIP - count));
    }

    /// The ground and the runs of the strip at hand, and what they are joined to.
    #[inline(always)]
    fn take<S: Simd>(&mut self, simd: S) {
        let order = self.points.order;
        let (rows, test) = (self.points.rows(), self.test);
        let position = (self.at - 2) * STRIP;
        let columns_before = |end: usize| columns_below(end.saturating_sub(position));
        let counted = columns_before(order.end());
        let joined_here = columns_before(order.joined_end());
        let strip = Whereabouts::of_strip(order, position, rows, counted);
        self.reach.advance();
        for row in 0..rows {
            let words = &self.words[row];
            let ground = SlopeGround::vote(words);
            if counted != 0 {
                self.ground.push(ground & counted);
            }
            let on = words[1].real & !ground & joined_here;
            self.on[row] = on;
            let before = u64::from(self.reach.begin_row(row, test.columns()));
            if on == 0 {
                continue;
            }
            let above = row.checked_sub(1).map_or(0, |above| self.on[above]);
            let joined = Joined {
                along: test.along(simd, &self.points, row, u64::from(on) << 1 | before),
                down: test.down(simd, &self.points, row, above & on),
            };
            self.reach.take(
                simd,
                &self.points,
                (on, joined),
                strip.of_row(row),
                &mut self.pieces,
            );
        }
        let Self {
            points,
            fan,
            reach,
            crowd,
            pieces,
            misses,
            ..
        } = self;
        match Crowd::is_in(&reach.now, rows) {
            true => crowd.join(simd, &test, points, &reach.now, pieces, misses),
            false => test.join(simd, points, fan, &mut reach.now, pieces, misses),
        }
        if order.circular {
            self.meet(position);
        }
    }

    /// Notes the pieces of the first columns, or unites them with what these hold for the second
    /// time.
    fn meet(&mut self, position: usize) {
        let order = self.points.order;
        if position >= STRIP + BEFORE && position + STRIP <= order.end() {
            return;
        }
        for (row, first) in self.first.iter_mut().enumerate() {
            for (piece, columns) in self.reach.now.at_hand(row) {
                for position in columns.map(|column| position + column) {
                    if position < STRIP + BEFORE {
                        first[position - STRIP] = piece;
                    }
                    if let Some(again) = position.checked_sub(order.end()) {
                        self.pieces.unite(piece, first[again]);
                    }
                }
            }
        }
    }
}

/// So many columns of a strip, from its first on.
fn columns_below(count: usize) -> u32 {
    if count >= STRIP {
        u32::MAX
    } else {
        (1 << count) - 1
    }
}

impl Strips {
    #[inline(always)]
    fn finish_with<S: Simd>(&mut self, simd: S, sweep: &mut SweepMut<'_>, config: &Config) {
        sweep.header.ground = self.ground.iter().map(|word| word.count_ones()).sum();
        self.components();
        self.small_to_large(config.joining.small_points);
        sweep.header.segments = self.number(config, sweep.segments) as u32;
        self.write_labels(simd, sweep);
        for (segment, extent) in sweep.segments.iter_mut().zip(&self.finish.extents) {
            [segment.column_first, segment.column_last] = extent.columns(self.points.order);
        }
    }

    /// Lets each piece know its component, and lists the roots of these.
    fn components(&mut self) {
        self.pieces.flatten();
        let roots = &mut self.finish.roots;
        roots.clear();
        roots.extend(
            (0..)
                .zip(&self.pieces.parent)
                .filter_map(|(piece, &root)| (piece == root).then_some(piece)),
        );
    }

    /// Gives the small components to the nearest that is not: its root is the parent of theirs.
    fn small_to_large(&mut self, small_points: u32) {
        if small_points <= 1 || self.misses.is_empty() {
            return;
        }
        self.find_nearest(small_points);
        let Pieces { parent, sums, .. } = &mut self.pieces;
        for &root in &self.finish.roots {
            let (_, _, large) = self.finish.nearest[root as usize];
            if large != u32::MAX {
                let sum = sums[root as usize];
                sums[large as usize].add(&sum);
                parent[root as usize] = large;
            }
        }
    }

    /// Finds for the root of each small component the nearest that is not small, if one is near
    /// enough.
    fn find_nearest(&mut self, small_points: u32) {
        let nearest = &mut self.finish.nearest;
        let Pieces { parent, sums, .. } = &self.pieces;
        nearest.clear();
        nearest.resize(parent.len(), (f32::INFINITY, u32::MAX, u32::MAX));
        let is_small = |root: u32| sums[root as usize].points < small_points;
        for miss in &self.misses {
            let [a, b] = miss.pieces.map(|piece| parent[piece as usize]);
            let (small, large) = match [is_small(a), is_small(b)] {
                [true, false] => (a, b),
                [false, true] => (b, a),
                _ => continue,
            };
            let place = &mut nearest[small as usize];
            let found = (miss.apart2, sums[large as usize].first, large);
            if found < *place {
                *place = found;
            }
        }
    }

    /// Numbers the components that are large enough by their first pixels, and writes what is known
    /// of them.
    fn number(&mut self, config: &Config, segments: &mut [Segment]) -> usize {
        let Finish {
            roots,
            order,
            label,
            extents,
            ..
        } = &mut self.finish;
        let Pieces { parent, sums, .. } = &self.pieces;
        order.clear();
        for &root in &*roots {
            let sum = &sums[root as usize];
            if parent[root as usize] == root && sum.points >= config.min_points.max(1) {
                order.push((sum.first, root));
            }
        }
        order.sort_unstable();
        order.truncate(segments.len());
        label.clear();
        label.resize(parent.len(), LABEL_NONE);
        for ((&(_, root), number), segment) in order.iter().zip(LABEL_FIRST_SEGMENT..).zip(segments)
        {
            label[root as usize] = number;
            *segment = sums[root as usize].segment(number);
        }
        // A small one has the label of the one that it became part of.
        for &root in &*roots {
            label[root as usize] = label[parent[root as usize] as usize];
        }
        extents.clear();
        extents.resize(order.len(), Extent::default());
        order.len()
    }

    /// Writes the labels: a strip in rows first, where runs lie, then in columns, as the image has
    /// them.
    #[inline(always)]
    fn write_labels<S: Simd>(&mut self, simd: S, sweep: &mut SweepMut<'_>) {
        let rows = self.words.len().max(1);
        let pixels = sweep.image_pixels();
        let labels = &mut sweep.label[pixels];
        let Finish {
            label,
            extents,
            tile,
            ..
        } = &mut self.finish;
        tile.resize(rows * STRIP, 0);
        let Pieces { parent, parts, .. } = &self.pieces;
        let mut parts = parts.iter().peekable();
        let order = self.points.order;
        for (strip, ground) in self.ground.chunks_exact(rows).enumerate() {
            let position = (strip + 1) * STRIP;
            tile.fill(LABEL_NONE);
            for (row, ground) in tile.chunks_exact_mut(STRIP).zip(ground) {
                fill(simd, row, *ground, LABEL_GROUND);
            }
            while let Some(part) = parts.next_if(|part| usize::from(part.strip) == strip) {
                let number = label[parent[part.piece as usize] as usize];
                if let Some(place) = number.checked_sub(LABEL_FIRST_SEGMENT) {
                    fill(
                        simd,
                        &mut tile[usize::from(part.row) * STRIP..][..STRIP],
                        part.columns,
                        number,
                    );
                    extents[place as usize].add(position, part.columns, order);
                }
            }
            let count = STRIP.min(order.end() - position);
            write_columns(
                simd,
                tile,
                labels,
                rows,
                (position..position + count).filter_map(|at| order.column(at)),
            );
        }
    }
}

/// Writes a label into some columns of a row.
#[inline(always)]
fn fill<S: Simd>(simd: S, row: &mut [u32], columns: u32, label: u32) {
    let label = u32x16::splat(simd, label);
    for (half, lanes) in row.chunks_exact_mut(LANES).enumerate() {
        let columns = columns >> (half * LANES) & 0xFFFF;
        if columns != 0 {
            let is = mask32x16::from_bitmask(simd, u64::from(columns));
            is.select(label, u32x16::from_slice(simd, lanes))
                .store_slice(lanes);
        }
    }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::TAU;

    use fastrand::Rng;

    use super::*;
    use crate::assemble::lanes::levels;
    use crate::segment::{Mount, points};
    use crate::sensor::Beam;
    use crate::sweep::buffers::HeapBuffer;
    use crate::sweep::layout::flags;
    use crate::sweep::{BeamRow, Buffers, Column, HeapBuffers, Shape};

    const ROWS: usize = 16;

    /// So many columns of a turn of 100 or more, in which some pixels hold a return, and some
    /// columns none.
    fn noise(rng: &mut Rng, columns: usize, circular: bool) -> HeapBuffer {
        let shape = Shape {
            rows: ROWS,
            columns_capacity: columns,
            dual: false,
            segments_capacity: 8,
        };
        let mut buffer = HeapBuffers::default().take(shape.total_bytes());
        let sweep = SweepMut::create(buffer.as_mut(), &shape).unwrap();
        (sweep.header.columns, sweep.header.flags) =
            (columns as u32, if circular { flags::CIRCULAR } else { 0 });
        for (index, column) in sweep.columns.iter_mut().enumerate() {
            let azimuth_rad = index as f64 / columns.max(100) as f64 * TAU;
            *column = Column::measured(0, 0, azimuth_rad as f32, (10.0 * TAU) as f32, 0);
        }
        for (row, beam) in sweep.beams.iter_mut().enumerate() {
            *beam = BeamRow::new(&Beam::ideal(row, (15.0 - 2.0 * row as f64).to_radians()), 0);
        }
        for ranges in sweep.range.chunks_exact_mut(ROWS) {
            let share = rng.f32() - 0.3;
            ranges.fill_with(|| {
                if rng.f32() < share {
                    1.0 + 30.0 * rng.f32()
                } else {
                    0.0
                }
            });
        }
        buffer
    }

    /// Column by column, from the points one by one.
    fn depths_m(sweep: &SweepRef<'_>, config: &Config) -> Vec<f32> {
        let [x, y, z] = config.mount.up().axis();
        let of_column = |column: &[Option<points::Placed>]| {
            let lowest = column.iter().rev().flatten().next();
            lowest.map_or(f32::INFINITY, |placed| {
                let [right_m, forward_m, up_m] = placed.point_m;
                -(x * right_m + y * forward_m + z * up_m)
            })
        };
        points::placed(sweep, config)
            .chunks_exact(ROWS)
            .map(of_column)
            .collect()
    }

    #[test]
    fn each_column_tells_how_deep_its_lowest_return_lies_once() {
        let mut rng = Rng::with_seed(1);
        for round in 0..300 {
            let (columns, circular) = (rng.usize(1..260), rng.bool());
            let mut buffer = noise(&mut rng, columns, circular);
            let sweep = SweepMut::open(buffer.as_mut()).unwrap();
            let [pitch_rad, roll_rad] = if rng.bool() { [0.0; 2] } else { [0.1, -0.2] };
            let mount = Mount {
                height_m: None,
                pitch_rad,
                roll_rad,
            };
            let config = Config {
                mount,
                max_range_m: 25.0,
                ..Config::default()
            };
            let mut expected = depths_m(&sweep.as_ref(), &config);
            expected.sort_by(f32::total_cmp);
            for level in levels() {
                let mut strips = Strips::new(level);
                let check = |depths_m: &[f32], what: &str| {
                    let mut found = depths_m.to_vec();
                    found.sort_by(f32::total_cmp);
                    let same = |(a, b): (&f32, &f32)| a == b || (a - b).abs() < 1e-4;
                    assert!(
                        found.len() == expected.len() && found.iter().zip(&expected).all(same),
                        "round {round}, {what}, {columns} columns, circular {circular}, {level:?}"
                    );
                };
                check(strips.sound(&sweep, &config), "sounded");
                strips.begin(&sweep, &config, Some(1.0), None);
                while strips.find_ground(&sweep, &config) {}
                check(strips.depths_m(), "as a whole");
                if circular {
                    strips.begin(&sweep, &config, Some(1.0), Some(columns / 3));
                    for ready in [Some(columns / 3), Some(columns / 2), None] {
                        strips.go_on(&sweep, ready);
                        while strips.find_ground(&sweep, &config) {}
                    }
                    check(strips.depths_m(), "early");
                }
            }
        }
    }
}
