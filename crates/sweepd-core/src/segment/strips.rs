//! The default method, strip by strip; and at the end the components, their labels and table.
//!
//! ```text
//! begin         beams, height, limits
//! find_ground   the ranges of the next strip and of what is ahead of it, and how deep they lie; its
//!               columns are climbed
//! join          the vote on the strip at hand, its runs, and what these are joined to
//! label         components, small ones to others, segments table, labels
//! ```
//!
//! For a whole turn the first columns are taken once more behind the last: what they hold for the
//! second time is united with what it was the first time, and not counted again.

use fearless_simd::{Level, Simd, dispatch, f32x16, mask32x16, prelude::*};

use super::area::Areas;
use super::climb::{Climb, Kerb};
use super::components::{Components, Small};
use super::config::Config;
use super::joining;
use super::labels::{Found, Labels};
use super::mount::Stance;
use super::near::Limits;
use super::objects::{Objects, Strip};
use super::order::{AHEAD, BEFORE, LANES, Order, STRIP, lane_of, reserve};
use super::points::Beams;
use super::ranges::Ranges;
use super::runs::{Bits, Runs};
use super::vote::vote;
use super::wide::Wide;
use super::windows::Windows;
use crate::sweep::{SweepMut, SweepRef};

/// Labels sweeps by the default method; after the first in buffers of one size it allocates
/// nothing.
#[derive(Clone, Debug)]
pub(super) struct Strips {
    level: Level,
    climb: Climb,
    limits: Limits,
    areas: Areas,
    /// Strips that were at hand, with the one that leads in.
    at: usize,
    /// Columns that are as they will be, while the sweep is not complete.
    ready: Option<usize>,
    beams: Beams,
    /// Angle between columns, radians.
    pitch_rad: f32,
    ranges: Ranges,
    /// Columns of the strip at hand that are no neighbours of those before.
    jumps: u64,
    /// How deep below the sensor the lowest return of each column lies, position by position,
    /// metres; infinite where there is none.
    depths_m: Vec<f32>,
    runs: Runs,
    windows: Windows,
    components: Components,
    /// Pieces of the first columns, row by row: what they hold for the second time is the same.
    first: Vec<[u32; BEFORE]>,
    labels: Labels,
    /// The objects, if they are to be found.
    pub objects: Option<Objects>,
}

impl Strips {
    pub fn new(level: Level) -> Self {
        Self {
            level,
            climb: Climb::default(),
            limits: Limits::default(),
            areas: Areas::default(),
            at: 0,
            ready: None,
            beams: Beams::default(),
            pitch_rad: 0.0,
            ranges: Ranges::default(),
            jumps: 0,
            depths_m: Vec::new(),
            runs: Runs::default(),
            windows: Windows::default(),
            components: Components::default(),
            first: Vec::new(),
            labels: Labels::default(),
            objects: None,
        }
    }

    /// Takes what a sweep says of its beams. While it is not complete, only this many of its
    /// columns are as they will be. Takes room for any sweep that such a buffer can hold; room that
    /// is never touched costs no memory.
    pub fn begin(
        &mut self,
        sweep: &SweepMut<'_>,
        config: &Config,
        height_m: Option<f32>,
        ready: Option<usize>,
    ) {
        let rows = sweep.header.rows as usize;
        let columns = sweep.columns.len();
        // The first columns are there twice.
        let pixels = sweep.range.len() + rows * BEFORE;
        self.climb.height_m = height_m.filter(|_| config.mount.stance() != Stance::OnSide);
        self.climb.kerb = Kerb::new(config.climb_m);
        self.at = 0;
        self.ready = ready;
        reserve(&mut self.depths_m, columns.next_multiple_of(STRIP));
        self.first.resize(rows, [0; BEFORE]);
        self.beams.reserve(columns);
        self.runs.begin(rows, pixels);
        self.windows.begin(rows);
        self.components.reserve(pixels, Small::new(&config.joining));
        self.labels.begin(rows, columns, sweep.segments.len());
        if let Some(objects) = &mut self.objects {
            objects.begin(sweep.header, ready.is_some());
        }
        self.runs.keeps_sums = self.objects.is_some() && ready.is_some();
        let sweep = sweep.as_ref();
        let count = ready.is_none().then_some(sweep.columns.len());
        self.beams.begin(&sweep, count, &config.mount);
    }

    /// More columns are ready, or all (`None`).
    pub fn go_on(&mut self, sweep: &SweepMut<'_>, ready: Option<usize>) {
        self.ready = ready;
        self.runs.keeps_sums &= ready.is_some();
        self.beams.order.columns = ready.is_none().then_some(sweep.header.columns as usize);
    }

    /// Height of the sensor over the ground, as this sweep was begun with, metres; `None` where no
    /// ground is found.
    pub fn height_m(&self) -> Option<f32> {
        self.climb.height_m
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
            // Each step by itself: together they are more than a compiler keeps in view.
            dispatch!(self.level, simd => self.read(simd, &sweep, config));
            dispatch!(self.level, simd => self.climb(simd));
            self.at += 1;
            // The first only leads in.
            if self.at > 1 {
                // The runs of the strip at hand are placed.
                let position = self.position();
                dispatch!(self.level, simd => self.beams.look_up(simd, &sweep, position));
                return true;
            }
        }
        false
    }

    fn has_next(&self) -> bool {
        let order = self.beams.order;
        if self.beams.rows() == 0 {
            return false;
        }
        match (self.ready, order.columns) {
            (Some(ready), _) => self.next_columns() <= ready,
            (None, columns) => {
                columns.is_some_and(|columns| columns > 0) && self.at < order.strips()
            }
        }
    }

    /// Columns that must be final for the next strip to be joined, of a sweep that is not complete.
    pub fn next_columns(&self) -> usize {
        self.beams.order.start + self.at * STRIP + AHEAD
    }

    /// Joins the runs of that strip with each other and with those before.
    pub fn join(&mut self) {
        let jumps = self.jumps;
        let components = &mut self.components;
        dispatch!(self.level, simd => self.runs.advance(simd, jumps, components));
        dispatch!(self.level, simd => self.vote(simd));
        dispatch!(self.level, simd => self.join_neighbours(simd));
        dispatch!(self.level, simd => self.measure(simd));
        dispatch!(self.level, simd => self.join_windows(simd));
        dispatch!(self.level, simd => self.meet(simd));
    }

    /// Gives out the objects that are complete since the strip that was joined.
    pub fn emit(&mut self, sweep: &SweepMut<'_>, config: &Config) {
        if self.ready.is_some() && self.objects.is_some() {
            let sweep = sweep.as_ref();
            dispatch!(self.level, simd => self.emit_with(simd, &sweep, config));
        }
    }

    #[inline(always)]
    fn emit_with<S: Simd>(&mut self, simd: S, sweep: &SweepRef<'_>, config: &Config) {
        let strip = Strip {
            sweep,
            runs: &self.runs,
            order: self.beams.order,
            position: self.position(),
            counted: self.counted(),
            wide: Wide::new(config.max_width_rad, self.pitch_rad),
        };
        if let Some(objects) = &mut self.objects {
            objects.follow(simd, strip, &mut self.components, config.min_points);
        }
    }

    /// Writes labels and segments, and how many there are of each into the header.
    pub fn label(&mut self, sweep: &mut SweepMut<'_>, config: &Config) {
        dispatch!(self.level, simd => self.label_with(simd, sweep, config));
    }

    /// Goes on to the next strip, and reads what was not read of it before, and what is ahead of it.
    #[inline(always)]
    fn read<S: Simd>(&mut self, simd: S, sweep: &SweepRef<'_>, config: &Config) {
        let order = self.beams.order;
        if self.at == 0 {
            self.pitch_rad = joining::pitch_rad(sweep.columns, order);
            self.limits
                .set(sweep.beams, self.pitch_rad, &config.joining);
            self.areas.set(sweep.beams, self.pitch_rad);
        }
        self.jumps = joining::jumps(sweep.columns, order, self.at * STRIP, self.pitch_rad);
        let position = self.at * STRIP + AHEAD;
        if self.beams.is_tilted() {
            self.beams.look_up(simd, sweep, position);
        }
        self.ranges.fill(simd, sweep, config, order, position);
        if config.mount.height_m.is_none() {
            self.note_depths(simd);
        }
    }

    #[inline(always)]
    fn climb<S: Simd>(&mut self, simd: S) {
        let position = self.at * STRIP + AHEAD;
        self.climb.next(simd, &self.beams, &self.ranges, position);
    }

    /// Notes the depths of the columns that were read, of those that count.
    #[inline(always)]
    fn note_depths<S: Simd>(&mut self, simd: S) {
        let position = self.at * STRIP + AHEAD;
        let count = self.beams.order.end().saturating_sub(position).min(STRIP);
        let counted = STRIP.saturating_sub(position);
        for first in (counted..count).step_by(LANES) {
            let mut depths_m = f32x16::splat(simd, f32::INFINITY);
            let mut open = 0xFFFF;
            for &row in self.beams.upwards() {
                let lowest = self.ranges.read[row] >> first & open;
                if lowest != 0 {
                    let range = self.ranges.load(simd, row, AHEAD + first);
                    let profile =
                        self.beams
                            .profile(simd, self.beams.row(row), position + first, range);
                    let is = mask32x16::from_bitmask(simd, lowest);
                    depths_m = is.select(-profile.height, depths_m);
                    open &= !lowest;
                }
                if open == 0 {
                    break;
                }
            }
            let count = (count - first).min(LANES);
            self.depths_m
                .extend_from_slice(&depths_m.as_slice()[..count]);
        }
    }

    /// Position of the strip at hand.
    fn position(&self) -> usize {
        (self.at - 1) * STRIP
    }

    /// Columns of the strip at hand that count; the others are there for the second time.
    fn counted(&self) -> u64 {
        Order::columns_before(self.position(), self.beams.order.end())
    }

    /// The ground of the strip at hand, and what is none.
    #[inline(always)]
    fn vote<S: Simd>(&mut self, simd: S) {
        let counted = self.counted();
        let joined = Order::columns_before(self.position(), self.beams.order.joined_end());
        for row in 0..self.beams.rows() {
            let climbed = self.climb.ground[row];
            let ground = vote(simd, &self.ranges, row, climbed);
            let on = self.ranges.real[row][1] & !ground & joined;
            self.runs.set_row(simd, &self.limits, &self.ranges, row, on);
            if counted != 0 {
                self.labels.found.push(Found {
                    ground: ground & counted,
                    on: on & counted,
                });
            }
        }
    }

    /// Runs, and what is joined to what is directly beside it.
    #[inline(always)]
    fn join_neighbours<S: Simd>(&mut self, simd: S) {
        self.runs.find_edges(simd, &self.limits);
        for row in 0..self.beams.rows() {
            let above = self.limits.above;
            self.runs.join_row(simd, row, above, &mut self.components);
        }
    }

    /// What the runs measure.
    #[inline(always)]
    fn measure<S: Simd>(&mut self, simd: S) {
        let position = self.position();
        let components = &mut self.components;
        let (beams, ranges, areas) = (&self.beams, &self.ranges, &self.areas);
        self.runs
            .measure(simd, beams, ranges, areas, position, components);
        if self.counted() != 0 {
            self.labels.run_ends.push(self.runs.all.len());
        }
    }

    /// What is joined to what lies further away.
    #[inline(always)]
    fn join_windows<S: Simd>(&mut self, simd: S) {
        self.windows.advance(self.beams.order, self.position());
        let components = &mut self.components;
        self.windows
            .join(simd, &self.limits, &mut self.runs, components);
        self.windows.find_small(&self.runs, components);
        self.windows
            .note_small(simd, &self.limits, &self.ranges, &self.runs, components);
    }

    /// Of a whole turn, notes the pieces of the first columns, or unites them with what these hold
    /// for the second time.
    #[inline(always)]
    fn meet<S: Simd>(&mut self, simd: S) {
        let order = self.beams.order;
        let position = self.position();
        let is_inside = position >= STRIP + BEFORE && position + STRIP <= order.end();
        if !order.circular || is_inside {
            return;
        }
        for row in 0..self.first.len() {
            let on = (self.runs.edges[row].on >> STRIP) as u64;
            for column in Bits(on) {
                let at = position + column;
                let piece = self.runs.piece(lane_of(row) + column);
                if at < STRIP + BEFORE {
                    self.first[row][at - STRIP] = piece;
                }
                if let Some(again) = at.checked_sub(order.end()) {
                    self.components.unite(simd, piece, self.first[row][again]);
                }
            }
        }
    }

    #[inline(always)]
    fn label_with<S: Simd>(&mut self, simd: S, sweep: &mut SweepMut<'_>, config: &Config) {
        let order = self.beams.order;
        sweep.header.ground = self.labels.ground();
        let segments = self
            .components
            .finish(simd, config.min_points, sweep.segments);
        sweep.header.segments = segments as u32;
        let pixels = sweep.image_pixels();
        self.labels.write(
            simd,
            order,
            segments,
            &self.runs.all,
            &self.components,
            &mut sweep.label[pixels],
        );
        for (index, segment) in sweep.segments[..segments].iter_mut().enumerate() {
            [segment.column_first, segment.column_last] = self.labels.columns(index, order);
        }
    }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::TAU;

    use fastrand::Rng;

    use super::*;
    use crate::assemble::lanes::levels;
    use crate::buffers::HeapBuffer;
    use crate::buffers::{Buffers, HeapBuffers};
    use crate::segment::{Mount, points};
    use crate::sensor::Beam;
    use crate::sweep::layout::flags;
    use crate::sweep::{Column, Shape};

    const ROWS: usize = 16;

    /// Columns of a turn of 100 or more, in which some pixels hold a return, and some
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
            *beam = Beam::ideal(row, (15.0 - 2.0 * row as f64).to_radians()).row(0);
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
        let is_head_down = config.mount.stance() == Stance::HeadDown;
        let of_column = |column: &[Option<points::Placed>]| {
            let mut real = column.iter().flatten();
            let lowest = if is_head_down {
                real.next()
            } else {
                real.next_back()
            };
            lowest.map_or(f32::INFINITY, |placed| -placed.height_m)
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
            let tilts_rad = [[0.0; 2], [0.1, -0.2], [-0.1, 3.0]];
            let [pitch_rad, roll_rad] = tilts_rad[rng.usize(..3)];
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
