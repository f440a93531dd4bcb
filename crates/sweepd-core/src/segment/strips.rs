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

use fearless_simd::{Level, Simd, dispatch};

use super::area::Areas;
use super::climb::{Climb, Kerb};
use super::components::{Components, Small};
use super::config::Config;
use super::joining;
use super::labels::{Found, Labels};
use super::mount::Stance;
use super::near::Limits;
use super::objects::{Objects, Strip};
use super::order::{AHEAD, BEFORE, Order, STRIP, lane_of};
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
    }

    #[inline(always)]
    fn climb<S: Simd>(&mut self, simd: S) {
        let position = self.at * STRIP + AHEAD;
        self.climb.next(simd, &self.beams, &self.ranges, position);
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
