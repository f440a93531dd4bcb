//! Assigns the points of a ring to columns.
//!
//! Columns are evenly spaced; the points of a real scan are not: the encoder steps unevenly, the
//! correction for motion crowds points, and a beam with an offset from the axis shifts near points
//! against far ones. Most points are within half a pitch of a column, but one in twelve shares it
//! with another. So points make room: neighbours move by a column, in order, up to the nearest free
//! one; of two free ones at about the same distance, the one with the smaller sum of moves. No
//! point may be more than two pitches from its column. A point without room stays in its own
//! column, where the nearer of two hides the other.

use std::f64::consts::TAU;

use fearless_simd::{Level, Simd, dispatch, f32x16, i32x16, prelude::*, u32x16};

use super::rings::Polar;

/// Greatest distance of a point from its column, pitches.
const REACH: f32 = 2.0;
/// Greatest distance to a free column, columns.
const FARTHEST: usize = 48;
/// A free column on the other side may be this much farther, if points move less.
const FARTHER: usize = 2;
/// Stands for no column, and for no point.
pub(crate) const NONE: u32 = u32::MAX;
/// Points or columns that one instruction treats.
const LANES: usize = 16;
/// Columns that are searched together for a free one: more than [`FARTHEST`] and [`FARTHER`]
/// together.
const WINDOW: usize = 4 * LANES;

/// Places the points of rings, one ring after the other, in the same memory.
#[derive(Clone, Debug, Default)]
pub(crate) struct Placer {
    /// How far each point lies behind its column, pitches.
    off: Vec<f32>,
    /// The same of the point that has a column; NaN where it is free.
    held: Vec<f32>,
    /// The column of each point; [`NONE`] for an invalid point.
    pub columns: Vec<u32>,
    /// The point that has each column for itself; [`NONE`] where it is free.
    pub points: Vec<u32>,
    /// Points without a column of their own.
    pub crowded: Vec<u32>,
    /// Points whose column was taken when they came.
    late: Vec<u32>,
}

/// A way to free a column for a point: the points from there to the next free column move by one,
/// up or down.
#[derive(Clone, Copy)]
struct ColumnShift {
    column: usize,
    /// How far the new point would lie behind it, pitches.
    off: f32,
    up: bool,
    /// Points that move; [`WINDOW`] where there are too many, or one has come as far as it may.
    moved: usize,
}

impl Placer {
    /// Places points with these azimuths, in turns; NaN is no point.
    pub fn place(&mut self, level: Level, turns: &[f32], columns: usize) {
        dispatch!(level, simd => self.place_with(simd, turns, columns));
    }

    #[inline(always)]
    fn place_with<S: Simd>(&mut self, simd: S, turns: &[f32], columns: usize) {
        self.lie(simd, turns, columns);
        self.hold(columns);
        self.crowded.clear();
        for at in 0..self.late.len() {
            let point = self.late[at];
            if !self.squeeze(simd, point) {
                self.crowded.push(point);
            }
        }
    }

    /// Finds the column that each point lies in, and how far behind its middle.
    #[inline(always)]
    fn lie<S: Simd>(&mut self, simd: S, turns: &[f32], columns: usize) {
        let lanes = turns.len().next_multiple_of(LANES);
        self.off.resize(lanes, 0.0);
        self.columns.resize(lanes, NONE);
        let (whole, rest) = turns.as_chunks();
        let mut last = [f32::NAN; LANES];
        last[..rest.len()].copy_from_slice(rest);
        let places = self
            .off
            .as_chunks_mut()
            .0
            .iter_mut()
            .zip(self.columns.as_chunks_mut().0);
        for (turns, (off, column_of)) in whole.iter().chain([&last]).zip(places) {
            (*off, *column_of) = lie(simd, turns, columns);
        }
        self.columns.truncate(turns.len());
    }

    /// Gives each column to the first point that lies in it; the others are late.
    #[inline(always)]
    fn hold(&mut self, columns: usize) {
        self.held.clear();
        self.held.resize(columns, f32::NAN);
        self.points.clear();
        self.points.resize(columns, NONE);
        self.late.resize(self.columns.len(), NONE);
        let held = &mut self.held[..columns];
        let points = &mut self.points[..columns];
        // In descending order, so that no value is read that was just written.
        for (point, (&column, &off)) in self.columns.iter().zip(&self.off).enumerate().rev() {
            // What is no point has none.
            let Some(holder) = points.get_mut(column as usize) else {
                continue;
            };
            *holder = point as u32;
            held[column as usize] = off;
        }
        let late = &mut self.late[..];
        let mut count = 0;
        for (point, &column) in self.columns.iter().enumerate() {
            // Written unconditionally: a branch would be mispredicted.
            late[count] = point as u32;
            count += usize::from(
                points
                    .get(column as usize)
                    .is_some_and(|&holder| holder != point as u32),
            );
        }
        self.late.truncate(count);
    }

    /// Finds a column for a point by moving its neighbours; returns whether there was one.
    #[inline(always)]
    fn squeeze<S: Simd>(&mut self, simd: S, point: u32) -> bool {
        let columns = self.points.len();
        let mut column = self.columns[point as usize] as usize;
        let mut off = self.off[point as usize];
        // The first column whose point lies behind this one, or that is free. Where columns are
        // taken, points are in order, and none is farther than REACH from its column: both loops
        // soon end.
        while self.held[column] <= off {
            column = next(column, true, columns);
            off -= 1.0;
        }
        let mut before = next(column, false, columns);
        while self.held[before] > off + 1.0 {
            column = before;
            off += 1.0;
            before = next(column, false, columns);
        }
        // It gets that column, and the points from there on move up; or the one before it, and the
        // others move down.
        let up = self.shift_from(simd, column, off, true);
        let down = self.shift_from(simd, before, off + 1.0, false);
        let (nearer, farther) = if up.moved <= down.moved {
            (up, down)
        } else {
            (down, up)
        };
        if nearer.moved >= FARTHEST.min(columns) {
            return false;
        }
        let is_as_good =
            farther.moved <= nearer.moved + FARTHER && self.cost(farther) < self.cost(nearer);
        self.insert(point, if is_as_good { farther } else { nearer });
        true
    }

    /// The shift that frees a column; `off` is the distance of the new point behind it.
    #[inline(always)]
    fn shift_from<S: Simd>(&self, simd: S, column: usize, off: f32, up: bool) -> ColumnShift {
        let columns = self.held.len();
        // The window begins at the column, or ends with it.
        let first = match (column + 1).checked_sub(WINDOW) {
            _ if up => column,
            Some(first) => first,
            None => (column + 1 + WINDOW * (columns - 1)) % columns,
        };
        let around;
        let window = match self.held[first..].first_chunk() {
            Some(window) => window,
            None => {
                around = std::array::from_fn(|by| self.held[(first + by) % columns]);
                &around
            }
        };
        let ends = ends(simd, window, up);
        let moved = if up {
            ends.trailing_zeros()
        } else {
            ends.leading_zeros()
        } as usize;
        let end = if up {
            window.get(moved)
        } else {
            window.iter().nth_back(moved)
        };
        let is_open = off.abs() <= REACH && end.is_some_and(|held| held.is_nan());
        ColumnShift {
            column,
            off,
            up,
            moved: if is_open { moved } else { WINDOW },
        }
    }

    /// Increase of the sum of squared distances by a shift, including the new point's.
    #[inline(always)]
    fn cost(&self, shift: ColumnShift) -> f32 {
        let mut cost = shift.off * shift.off;
        let mut column = shift.column;
        for _ in 0..shift.moved {
            let held = self.held[column];
            cost += 1.0 + 2.0 * if shift.up { -held } else { held };
            column = next(column, shift.up, self.held.len());
        }
        cost
    }

    /// Gives a point a column, and moves the points from there to the next free one.
    #[inline(always)]
    fn insert(&mut self, mut point: u32, shift: ColumnShift) {
        let mut at = shift.column;
        let mut off = shift.off;
        let held = &mut self.held[..];
        let points = &mut self.points[..];
        let columns = &mut self.columns[..];
        while point != NONE {
            columns[point as usize] = at as u32;
            point = std::mem::replace(&mut points[at], point);
            off = std::mem::replace(&mut held[at], off) + if shift.up { -1.0 } else { 1.0 };
            at = next(at, shift.up, points.len());
        }
    }
}

/// Mask of columns at which a shift ends, because they are free or their point cannot move.
#[inline(always)]
fn ends<S: Simd>(simd: S, held: &[f32; WINDOW], up: bool) -> u64 {
    let mut movable = 0;
    for (index, held) in held.as_chunks().0.iter().enumerate() {
        let held = f32x16::load_array_ref(simd, held);
        let is_movable = if up {
            held.simd_ge(1.0 - REACH)
        } else {
            held.simd_le(REACH - 1.0)
        };
        movable |= is_movable.to_bitmask() << (index * LANES);
    }
    !movable
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

/// How far points with these azimuths lie behind the middle of their columns, and the columns.
#[inline(always)]
fn lie<S: Simd>(simd: S, turns: &[f32; LANES], columns: usize) -> ([f32; LANES], [u32; LANES]) {
    let turns = f32x16::load_array_ref(simd, turns);
    let along = turns * columns as f32;
    let column = along.to_int::<i32x16<S>>().min(columns as i32 - 1);
    let off = along - column.to_float::<f32x16<S>>() - 0.5;
    let is_point = turns.simd_eq(turns);
    (
        off.to_array(),
        is_point
            .select(column.bitcast(), u32x16::splat(simd, NONE))
            .to_array(),
    )
}

/// The point that each column shows, of a ring; `None` in the ring is no point.
pub(crate) fn shown(points: &[Option<Polar>], columns: usize) -> Vec<Option<usize>> {
    let turns: Vec<f32> = points
        .iter()
        .map(|polar| polar.map_or(f32::NAN, |polar| (polar.azimuth_rad / TAU) as f32))
        .collect();
    let mut placer = Placer::default();
    placer.place(Level::new(), &turns, columns);
    let mut shown = vec![None; columns];

    for (point, &column) in placer
        .columns
        .iter()
        .enumerate()
        .filter(|(_, column)| **column != NONE)
    {
        let shown = &mut shown[column as usize];
        if shown.is_none_or(|other| away_m(points[point]) < away_m(points[other])) {
            *shown = Some(point);
        }
    }
    shown
}

fn away_m(polar: Option<Polar>) -> f64 {
    polar.map_or(f64::INFINITY, |polar| polar.away_m)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use sweepd_core::assemble::levels;

    /// The column that each point has for itself; positions in columns after the first.
    fn alone(positions: &[f64], columns: usize) -> Vec<Option<usize>> {
        let turn = |&position: &f64| ((position + 0.5) / columns as f64).rem_euclid(1.0) as f32;
        let turns: Vec<f32> = positions.iter().map(turn).collect();
        let mut placer = Placer::default();
        placer.place(Level::new(), &turns, columns);
        let column = |(point, &column): (usize, &u32)| {
            let own = placer
                .points
                .get(column as usize)
                .is_some_and(|&holder| holder == point as u32);
            assert_eq!(
                !own && column != NONE,
                placer.crowded.contains(&(point as u32))
            );
            own.then_some(column as usize)
        };
        placer.columns.iter().enumerate().map(column).collect()
    }

    #[test]
    fn points_at_columns_have_these() {
        let even: Vec<f64> = (0..10).map(f64::from).collect();
        assert_eq!(alone(&even, 10), (0..10).map(Some).collect::<Vec<_>>());
        assert_eq!(
            alone(&[9.6, 0.2, 4.4], 10),
            [Some(9), Some(0), Some(4)],
            "each has the nearest but one"
        );
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
        let polar = |away_m: f64| {
            Some(Polar {
                azimuth_rad: 3.0,
                away_m,
                z_m: 0.0,
            })
        };
        let mut points: Vec<Option<Polar>> =
            (0..5).map(|index| polar(10.0 + f64::from(index))).collect();
        points.extend([None, polar(4.0)]);
        let shown: Vec<usize> = shown(&points, 100).into_iter().flatten().collect();
        assert_eq!(shown.len(), 4);
        assert!(shown.contains(&6), "the nearest of all: {shown:?}");
    }

    /// The columns of points and the points of columns, one step after the other.
    fn naive(turns: &[f32], columns: usize) -> [Vec<u32>; 2] {
        let mut placer = Placer {
            held: vec![f32::NAN; columns],
            points: vec![NONE; columns],
            ..Placer::default()
        };
        let mut late = Vec::new();
        for (point, turn) in turns.iter().enumerate() {
            let along = turn * columns as f32;
            let column = (along as usize).min(columns - 1);
            placer.off.push(along - column as f32 - 0.5);
            placer
                .columns
                .push(if turn.is_nan() { NONE } else { column as u32 });
            if turn.is_nan() {
                continue;
            }
            if placer.points[column] == NONE {
                (placer.points[column], placer.held[column]) = (point as u32, placer.off[point]);
            } else {
                late.push(point);
            }
        }
        for point in late {
            let (mut at, mut off) = (placer.columns[point] as usize, placer.off[point]);
            while placer.held[at] <= off {
                (at, off) = (next(at, true, columns), off - 1.0);
            }
            while placer.held[next(at, false, columns)] > off + 1.0 {
                (at, off) = (next(at, false, columns), off + 1.0);
            }
            let starts = [
                (at, off, true),
                (next(at, false, columns), off + 1.0, false),
            ];
            let costs = starts.map(|(at, off, up)| naive_cost(&placer.held, at, off, up));
            // Both go on side by side; who arrives first waits for the other a little.
            let Some(first) = costs.iter().flatten().map(|&(steps, _)| steps).min() else {
                continue;
            };
            let cost = |way: usize| {
                costs[way]
                    .filter(|&(steps, _)| steps <= first + FARTHER)
                    .map(|(_, cost)| cost)
            };
            let up = match (cost(0), cost(1)) {
                _ if first >= FARTHEST.min(columns) => continue,
                (Some(up), Some(down)) if costs[0].is_some_and(|(steps, _)| steps == first) => {
                    up <= down
                }
                (Some(up), Some(down)) => up < down,
                (up, _) => up.is_some(),
            };
            let (column, off, up) = starts[usize::from(!up)];
            placer.insert(
                point as u32,
                ColumnShift {
                    column,
                    off,
                    up,
                    moved: 0,
                },
            );
        }
        [placer.columns, placer.points]
    }

    /// Steps to the next free column and what they cost, if all points on the way may move.
    fn naive_cost(held: &[f32], mut at: usize, off: f32, up: bool) -> Option<(usize, f32)> {
        let mut cost = off * off;
        for steps in 0..held.len() {
            if held[at].is_nan() {
                return (off.abs() <= REACH).then_some((steps, cost));
            }
            let towards = if up { -held[at] } else { held[at] };
            cost += 1.0 + 2.0 * towards;
            if towards > REACH - 1.0 {
                break;
            }
            at = next(at, up, held.len());
        }
        None
    }

    /// The most points that can have a column, by trying all ways.
    fn most(positions: &[f64], columns: usize, taken: u32) -> usize {
        let Some((&first, rest)) = positions.split_first() else {
            return 0;
        };
        let within = |column: usize| {
            let off = (first - column as f64).rem_euclid(columns as f64);
            off.min(columns as f64 - off) <= f64::from(REACH) && taken & 1 << column == 0
        };
        let with = (0..columns)
            .filter(|&column| within(column))
            .map(|column| 1 + most(rest, columns, taken | 1 << column));
        with.max().unwrap_or(0).max(most(rest, columns, taken))
    }

    proptest! {
        #[test]
        fn every_level_places_points_as_one_step_after_the_other_does(
            columns in 1_usize..300,
            steps in proptest::collection::vec(prop_oneof![0.2..1.5_f32, -0.5..3.0_f32, Just(f32::NAN)], 0..300),
        ) {
            let mut along = 0.0;
            let turn = |step: f32| {
                along += if step.is_nan() { 0.0 } else { step };
                if step.is_nan() { step } else { (along / columns as f32).rem_euclid(1.0) }
            };
            let turns: Vec<f32> = steps.into_iter().map(turn).collect();
            let expected = naive(&turns, columns);
            for level in levels() {
                let mut placer = Placer::default();
                placer.place(level, &turns, columns);
                prop_assert_eq!(&[placer.columns, placer.points], &expected, "{:?}", level);
            }
        }

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
