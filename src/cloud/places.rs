//! Which column each point of a ring goes to, and which points share one.
//!
//! Firings are even; the points of a real scan are not: the encoder steps unevenly, a correction for motion crowds them,
//! and a beam that starts beside the axis sees near and far things shifted. Most points lie within half a pitch of a
//! column, but a point in twelve shares that one with another. So points make room: those next to it move up by a
//! column, in order, to the nearest free one; of two about as near, to that for which all together move less; none lies more
//! than two pitches from its column. A point that finds no room is in the column where it lies, where the nearer of two hides
//! the other.

use std::f64::consts::TAU;

use fearless_simd::{Level, dispatch};

use super::rings::Polar;

/// A point may be so far from its column, pitches.
const REACH: f32 = 2.0;
/// The nearest free column may be so far away.
const FARTHEST: usize = 48;
/// One that is so much farther on the other side is as good, if points move less.
const FARTHER: usize = 2;
/// Stands for no column, and for no point.
pub(crate) const NONE: u32 = u32::MAX;

/// Places the points of rings, one ring after the other, in the same memory.
#[derive(Clone, Debug, Default)]
pub(crate) struct Placer {
    /// How far each point lies behind its column, pitches.
    off: Vec<f32>,
    /// The same of the point that has a column; NaN where it is free.
    held: Vec<f32>,
    /// The column that each point is in; [`NONE`] for what is no point.
    pub columns: Vec<u32>,
    /// The point that has each column for itself; [`NONE`] where it is free.
    pub points: Vec<u32>,
    /// Points without a column of their own.
    pub crowded: Vec<u32>,
    /// Points whose column was taken when they came.
    late: Vec<u32>,
}

/// On the way from the column that a point could get to the next free one.
struct Walk {
    at: usize,
    up: bool,
    /// Whether all points up to here may move so far.
    open: bool,
    /// What that adds to the squares of all moves, and the new point's own.
    cost: f32,
}

impl Placer {
    /// Places points with these azimuths, in turns; NaN is no point.
    pub fn place(&mut self, level: Level, turns: &[f32], columns: usize) {
        self.off.resize(turns.len(), 0.0);
        self.columns.resize(turns.len(), NONE);
        let Self { off, columns: column_of, .. } = self;
        dispatch!(level, _simd => lie(turns, columns, off, column_of));
        self.held.clear();
        self.held.resize(columns, f32::NAN);
        self.points.clear();
        self.points.resize(columns, NONE);
        self.crowded.clear();
        self.late.clear();
        for (point, &column) in self.columns.iter().enumerate() {
            // What is no point has none.
            let Some(holder) = self.points.get_mut(column as usize) else { continue };
            if *holder == NONE {
                *holder = point as u32;
                self.held[column as usize] = self.off[point];
            } else {
                self.late.push(point as u32);
            }
        }
        for at in 0..self.late.len() {
            let point = self.late[at];
            if !self.squeeze(point) {
                self.crowded.push(point);
            }
        }
    }

    /// Finds a column for a point among those that have the columns around it; whether there was one.
    fn squeeze(&mut self, point: u32) -> bool {
        let columns = self.points.len();
        let mut column = self.columns[point as usize] as usize;
        let mut off = self.off[point as usize];
        // The first column whose point lies behind this one, or that is free. Where columns are taken, points are in
        // order, and none is farther than REACH from its column: both loops soon end.
        while self.held[column] <= off {
            (column, off) = (next(column, true, columns), off - 1.0);
        }
        let mut before = next(column, false, columns);
        while self.held[before] > off + 1.0 {
            (column, off) = (before, off + 1.0);
            before = next(column, false, columns);
        }
        // It gets that column, and the points from there on move up; or the one before it, and the others move down.
        let mut up = Walk::new(column, off, true);
        let mut down = Walk::new(before, off + 1.0, false);
        for _ in 0..FARTHEST.min(columns) {
            if up.is_at_free(&self.held) {
                let is_less = down.arrives(&self.held) && down.cost < up.cost;
                self.insert(point, if is_less { (before, off + 1.0) } else { (column, off) }, !is_less);
                return true;
            }
            if down.is_at_free(&self.held) {
                let is_less = up.arrives(&self.held) && up.cost < down.cost;
                self.insert(point, if is_less { (column, off) } else { (before, off + 1.0) }, is_less);
                return true;
            }
            up.go_on(&self.held);
            down.go_on(&self.held);
            if !up.open && !down.open {
                return false;
            }
        }
        false
    }

    /// Gives a point a column, so far behind it, and moves the points from there to the next free one.
    fn insert(&mut self, mut point: u32, (mut at, mut off): (usize, f32), up: bool) {
        while point != NONE {
            self.columns[point as usize] = at as u32;
            point = std::mem::replace(&mut self.points[at], point);
            off = std::mem::replace(&mut self.held[at], off) + if up { -1.0 } else { 1.0 };
            at = next(at, up, self.points.len());
        }
    }
}

impl Walk {
    fn new(column: usize, off: f32, up: bool) -> Self {
        Self { at: column, up, open: off.abs() <= REACH, cost: off * off }
    }

    fn is_at_free(&self, held: &[f32]) -> bool {
        self.open && held[self.at].is_nan()
    }

    /// Whether a free column is at most [`FARTHER`] on; it is gone to.
    fn arrives(&mut self, held: &[f32]) -> bool {
        for _ in 0..FARTHER {
            if !self.open || held[self.at].is_nan() {
                break;
            }
            self.go_on(held);
        }
        self.is_at_free(held)
    }

    /// Past a point that has to move.
    fn go_on(&mut self, held: &[f32]) {
        let towards = if self.up { -held[self.at] } else { held[self.at] };
        self.open &= towards <= REACH - 1.0;
        self.cost += 1.0 + 2.0 * towards;
        self.at = next(self.at, self.up, held.len());
    }
}

/// The column next to one.
fn next(column: usize, up: bool, columns: usize) -> usize {
    match up {
        true if column + 1 == columns => 0,
        true => column + 1,
        false if column == 0 => columns - 1,
        false => column - 1,
    }
}

/// The column that each point lies in, and how far behind its middle.
#[inline(always)]
fn lie(turns: &[f32], columns: usize, off: &mut [f32], column_of: &mut [u32]) {
    let (scale, last) = (columns as f32, columns as i32 - 1);
    for ((turn, off), column_of) in turns.iter().zip(off).zip(column_of) {
        let along = turn * scale;
        let column = (along as i32).min(last);
        *off = along - column as f32 - 0.5;
        *column_of = if turn.is_nan() { NONE } else { column as u32 };
    }
}

/// The point that each column shows, of a ring; `None` in the ring is no point.
pub(crate) fn shown(points: &[Option<Polar>], columns: usize) -> Vec<Option<usize>> {
    let turn = |polar: &Option<Polar>| polar.map_or(f32::NAN, |polar| (polar.azimuth_rad / TAU) as f32);
    let turns: Vec<f32> = points.iter().map(turn).collect();
    let mut placer = Placer::default();
    placer.place(Level::new(), &turns, columns);
    let mut shown = vec![None; columns];
    let away_m = |point: usize| points[point].map_or(f64::INFINITY, |polar| polar.away_m);
    for (point, &column) in placer.columns.iter().enumerate().filter(|(_, column)| **column != NONE) {
        let shown = &mut shown[column as usize];
        if shown.is_none_or(|other| away_m(point) < away_m(other)) {
            *shown = Some(point);
        }
    }
    shown
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// The column that each point has for itself; positions in columns after the first.
    fn alone(positions: &[f64], columns: usize) -> Vec<Option<usize>> {
        let turn = |&position: &f64| ((position + 0.5) / columns as f64).rem_euclid(1.0) as f32;
        let turns: Vec<f32> = positions.iter().map(turn).collect();
        let mut placer = Placer::default();
        placer.place(Level::new(), &turns, columns);
        let column = |(point, &column): (usize, &u32)| {
            let own = placer.points.get(column as usize).is_some_and(|&holder| holder == point as u32);
            assert_eq!(!own && column != NONE, placer.crowded.contains(&(point as u32)));
            own.then_some(column as usize)
        };
        placer.columns.iter().enumerate().map(column).collect()
    }

    #[test]
    fn points_at_columns_have_these() {
        let even: Vec<f64> = (0..10).map(f64::from).collect();
        assert_eq!(alone(&even, 10), (0..10).map(Some).collect::<Vec<_>>());
        assert_eq!(alone(&[9.6, 0.2, 4.4], 10), [Some(9), Some(0), Some(4)], "each has the nearest but one");
        assert_eq!(alone(&[], 10), []);
        assert_eq!(alone(&[f64::NAN, 3.0], 10), [None, Some(3)]);
    }

    #[test]
    fn points_make_room_and_the_rest_goes_without() {
        assert_eq!(alone(&[5.1, 4.9], 10), [Some(5), Some(4)]);
        assert_eq!(alone(&[5.1, 5.2, 5.3], 10), [Some(4), Some(5), Some(6)]);
        assert_eq!(alone(&[5.0; 6], 10).iter().flatten().count(), 5);
        let crowd: Vec<f64> = (0..25).map(|index| f64::from(index) * 0.4).collect();
        let found = alone(&crowd, 10);
        assert_eq!(found.iter().flatten().count(), 10);
    }

    #[test]
    fn the_nearer_of_two_is_shown_where_there_is_no_room() {
        let polar = |away_m: f64| Some(Polar { azimuth_rad: 3.0, away_m, z_m: 0.0 });
        let mut points: Vec<Option<Polar>> = (0..5).map(|index| polar(10.0 + f64::from(index))).collect();
        points.extend([None, polar(4.0)]);
        let shown: Vec<usize> = shown(&points, 100).into_iter().flatten().collect();
        assert_eq!(shown.len(), 4);
        assert!(shown.contains(&6), "the nearest of all: {shown:?}");
    }

    /// The most points that can have a column, by trying all ways.
    fn most(positions: &[f64], columns: usize, taken: u32) -> usize {
        let Some((&first, rest)) = positions.split_first() else { return 0 };
        let within = |column: usize| {
            let off = (first - column as f64).rem_euclid(columns as f64);
            off.min(columns as f64 - off) <= f64::from(REACH) && taken & 1 << column == 0
        };
        let with =
            (0..columns).filter(|&column| within(column)).map(|column| 1 + most(rest, columns, taken | 1 << column));
        with.max().unwrap_or(0).max(most(rest, columns, taken))
    }

    proptest! {
        #[test]
        fn no_column_is_used_twice_and_nearly_as_many_as_can_have_one(
            positions in proptest::collection::vec(0.0..8.0, 0..7),
        ) {
            let found = alone(&positions, 8);
            let mut taken: Vec<usize> = found.iter().flatten().copied().collect();
            taken.sort_unstable();
            let count = taken.len();
            taken.dedup();
            prop_assert_eq!(taken.len(), count);
            for (position, column) in positions.iter().zip(&found) {
                let off = column.map_or(0.0, |column| (position - column as f64).rem_euclid(8.0));
                prop_assert!(off.min(8.0 - off) <= f64::from(REACH) + 1e-5);
            }
            // Where the ring is cut open, on either side of the cut a point may find no room.
            prop_assert!(count + 2 >= most(&positions, 8, 0), "{:?}", found);
        }
    }
}
