//! The runs that the window can still reach: row after row, and in a row in the order of their columns, so that one
//! instruction compares a run with sixteen that come after it, in its own row and in those below.
//!
//! Columns are counted from the first that the window could reach back to: the strip at hand begins with [`BEFORE`].

use std::ops::{Range, RangeInclusive};

use fearless_simd::{Simd, i32x16, prelude::*, u32x16};

use super::pieces::{Part, Pieces, Sum, Whereabouts, measure};
use super::points::{BEFORE, LANES, Points, STRIP, load};

/// Most runs within reach in a row: one in every column.
const MOST: usize = BEFORE + STRIP;

/// The runs within reach, and those that were when the strip before was at hand.
#[derive(Clone, Debug, Default)]
pub(super) struct Reach {
    pub now: Entries,
    before: Entries,
}

/// Runs of one strip, and of the columns before it.
#[derive(Clone, Debug, Default)]
pub(super) struct Entries {
    count: usize,
    rows: Vec<Row>,
    pub row: Vec<u16>,
    /// A piece of each one's component: its root, as far as [`Entries::refresh`] and [`Entries::rename`] were told.
    pub piece: Vec<u32>,
    /// First column within reach.
    pub first: Vec<i32>,
    /// Last column.
    pub last: Vec<i32>,
    /// Least distance from the sensor, metres.
    low_m: Vec<f32>,
    /// Greatest distance from the sensor, metres.
    high_m: Vec<f32>,
    /// Least and greatest distance in the strip at hand alone.
    here_m: Vec<[f32; 2]>,
}

/// Which columns of a row of the strip at hand are joined to their neighbours.
#[derive(Clone, Copy, Debug)]
pub(super) struct Joined {
    /// To the column before.
    pub along: u32,
    /// To the row above.
    pub down: u32,
}

/// Where a row's runs stand.
#[derive(Clone, Copy, Debug, Default)]
struct Row {
    from: usize,
    /// The first that has a column in the strip at hand.
    here: usize,
    /// Columns of the strip in which a run begins, or goes on from before.
    starts: u32,
    end: usize,
}

impl Entries {
    fn reserve(&mut self, rows: usize) {
        self.rows.resize(rows, Row::default());
        // A vector may be read beyond the last.
        let most = rows * MOST + LANES;
        self.row.resize(most, 0);
        self.piece.resize(most, 0);
        self.first.resize(most, 0);
        self.last.resize(most, 0);
        self.low_m.resize(most, 0.0);
        self.high_m.resize(most, 0.0);
        self.here_m.resize(most, [0.0; 2]);
    }

    fn clear(&mut self) {
        self.count = 0;
        self.rows.fill(Row::default());
    }

    /// How many there are.
    pub fn len(&self) -> usize {
        self.count
    }

    /// The runs of a row.
    #[inline(always)]
    pub fn of(&self, row: usize) -> Range<usize> {
        self.rows[row].from..self.rows[row].end
    }

    /// Least distance from the sensor of one, metres.
    #[inline(always)]
    pub fn low_m(&self, entry: usize) -> f32 {
        self.low_m[entry]
    }

    /// The one that holds this column of the strip at hand; there has to be one.
    #[inline(always)]
    pub fn holding(&self, row: usize, column: u32) -> usize {
        let row = &self.rows[row];
        row.here + (row.starts << (31 - column)).count_ones() as usize - 1
    }

    /// The runs of a row that have columns in the strip at hand, and which, counted from its first.
    pub fn at_hand(&self, row: usize) -> impl Iterator<Item = (u32, RangeInclusive<usize>)> {
        let of = |column: i32| (column as usize).checked_sub(BEFORE);
        self.of(row).filter_map(move |entry| {
            let last = of(self.last[entry])?;
            Some((self.piece[entry], of(self.first[entry]).unwrap_or(0)..=last))
        })
    }

    /// Asks for the roots of a row's runs.
    #[inline(always)]
    pub fn refresh(&mut self, row: usize, pieces: &mut Pieces) {
        for entry in self.of(row) {
            self.piece[entry] = pieces.root(self.piece[entry]);
        }
    }

    /// One component has become part of another: some entries, and perhaps a few behind them, are told.
    #[inline(always)]
    pub fn rename<S: Simd>(&mut self, simd: S, entries: Range<usize>, from: u32, to: u32) {
        for at in entries.step_by(LANES) {
            let lanes = &mut self.piece[at..at + LANES];
            let piece = u32x16::from_slice(simd, lanes);
            piece.simd_eq(from).select(u32x16::splat(simd, to), piece).store_slice(lanes);
        }
    }

    /// Which of the sixteen entries from one on are of another component than a run, no more columns aside, and no farther
    /// away. One of two has to reach into the strip at hand: else they were compared before.
    #[inline(always)]
    pub fn like<S: Simd>(&self, simd: S, from: usize, run: usize, aside: i32, away_m: f32) -> u64 {
        let (first, last) = (self.first[run], self.last[run]);
        let new = if last < BEFORE as i32 { BEFORE as i32 } else { 0 };
        let [firsts, lasts] = [&self.first, &self.last].map(|table| &table[from..from + LANES]);
        let is_aside = i32x16::from_slice(simd, firsts).simd_le(last + aside)
            & i32x16::from_slice(simd, lasts).simd_ge((first - aside).max(new));
        let is_away = load(simd, &self.low_m, from).simd_le(self.high_m[run] + away_m)
            & load(simd, &self.high_m, from).simd_ge(self.low_m[run] - away_m);
        let piece = u32x16::from_slice(simd, &self.piece[from..from + LANES]);
        (is_aside & is_away & !piece.simd_eq(self.piece[run])).to_bitmask()
    }

    /// Whether no point of one run can be as near to one of another as that, by their distances from the sensor.
    #[inline(always)]
    pub fn are_apart(&self, a: usize, b: usize, away_m: f32) -> bool {
        self.low_m[b] - self.high_m[a] > away_m || self.low_m[a] - self.high_m[b] > away_m
    }

    #[inline(always)]
    fn push(&mut self, row: usize, piece: u32, columns: [i32; 2], distance_m: [f32; 2], here_m: [f32; 2]) {
        let entry = self.count;
        self.count += 1;
        self.row[entry] = row as u16;
        self.piece[entry] = piece;
        [self.first[entry], self.last[entry]] = columns;
        [self.low_m[entry], self.high_m[entry]] = distance_m;
        self.here_m[entry] = here_m;
    }
}

impl Reach {
    /// Takes room for any image of so many rows.
    pub fn reserve(&mut self, rows: usize) {
        self.now.reserve(rows);
        self.before.reserve(rows);
    }

    pub fn clear(&mut self) {
        self.now.clear();
    }

    /// Goes on to the next strip: its rows are then to be begun one after another.
    pub fn advance(&mut self) {
        std::mem::swap(&mut self.now, &mut self.before);
        self.now.clear();
    }

    /// Begins a row with what is still within reach, so many columns aside. True if the last column before the strip holds
    /// a run.
    #[inline(always)]
    pub fn begin_row(&mut self, row: usize, aside: i32) -> bool {
        let Self { now, before } = self;
        let from = now.count;
        let of = before.of(row);
        // They end one after the other: those within reach come last.
        let end_least = (BEFORE + STRIP) as i32 - aside;
        let gone = of.len() - before.last[of.clone()].iter().rev().take_while(|&&last| last >= end_least).count();
        for entry in of.skip(gone) {
            let [first, last] = [before.first[entry], before.last[entry]].map(|column| column - STRIP as i32);
            // All that is left of it was in that strip.
            let here_m = before.here_m[entry];
            now.push(row, before.piece[entry], [first.max(0), last], here_m, here_m);
        }
        now.rows[row] = Row { from, here: now.count, starts: 0, end: now.count };
        now.count > from && now.last[now.count - 1] == BEFORE as i32 - 1
    }

    /// Takes the runs of a row of the strip at hand, of which `on` are the columns: each to the piece of those in the row above
    /// that it is joined to.
    #[inline(always)]
    pub fn take<S: Simd>(
        &mut self,
        simd: S,
        points: &Points,
        (on, joined): (u32, Joined),
        at: Whereabouts,
        pieces: &mut Pieces,
    ) {
        let now = &mut self.now;
        let row = usize::from(at.row);
        let goes_on = joined.along & 1 == 1;
        now.rows[row].starts = on & (!joined.along | 1);
        now.rows[row].here -= usize::from(goes_on);
        let lane = points.at(row);
        let mut left = on;
        while left != 0 {
            let first = left.trailing_zeros();
            let length = 1 + (u64::from(joined.along) >> (first + 1)).trailing_ones();
            let columns = (((1_u64 << length) - 1) << first) as u32;
            left &= !columns;
            let counted = columns & at.counted;
            let (sum, [low_m, high_m]) = measure(simd, points, lane, [columns, counted]);
            let sum = match counted {
                0 => Sum::NONE,
                _ => Sum { first: at.first_pixel(counted), rows: [at.row; 2], ..sum },
            };
            let is_going_on = first == 0 && goes_on;
            let mut root = is_going_on.then(|| pieces.root(now.piece[now.count - 1]));
            let mut above = joined.down & columns;
            while above != 0 {
                let entry = now.holding(row - 1, above.trailing_zeros());
                let other = pieces.root(now.piece[entry]);
                root = Some(root.map_or(other, |root| pieces.unite(root, other)[0]));
                above &= (u32::MAX - 1) << (now.last[entry] as u32 - BEFORE as u32);
            }
            let piece = match root {
                Some(root) => pieces.go_on(root, &sum),
                None => pieces.begin(sum),
            };
            let first = (BEFORE as u32 + first) as i32;
            let last = first + length as i32 - 1;
            if is_going_on {
                let entry = now.count - 1;
                now.piece[entry] = piece;
                now.last[entry] = last;
                now.here_m[entry] = [low_m, high_m];
                now.low_m[entry] = now.low_m[entry].min(low_m);
                now.high_m[entry] = now.high_m[entry].max(high_m);
            } else {
                now.push(row, piece, [first, last], [low_m, high_m], [low_m, high_m]);
            }
            if counted != 0 {
                pieces.parts.push(Part { piece, row: at.row, strip: at.strip, columns: counted });
            }
        }
        now.rows[row].end = now.count;
    }
}
