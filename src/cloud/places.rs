//! Which column each point of a ring goes to, and which point each column shows.
//!
//! Firings are even; the points of a real scan are not: the encoder steps unevenly, a correction for motion crowds them,
//! and a beam that starts beside the axis sees near and far things shifted. Most points lie within half a pitch of a
//! column, but a point in twelve shares that one with another. So points keep their order and make room: as many as
//! possible have a column of their own no more than two pitches away, and among these ways the one is taken that moves
//! them least. A point that finds none is in the column where it lies, where the nearer of two hides the other.

use std::ops::RangeInclusive;

use super::rings::Polar;

/// A point may be so far from its column, pitches.
const REACH: f64 = 2.0;
/// Worth of a point that has a column, in squared pitches: more than all moves of a ring can cost.
const WORTH: f64 = 1e6;
/// Columns in question at a point: one that is out of reach, then up to five within.
const WINDOW: usize = 6;

/// The points of a ring in the columns of a turn.
#[derive(Debug)]
pub(crate) struct Placed {
    /// The column that each point is in; `None` for what is no point.
    pub columns: Vec<Option<usize>>,
    /// The point that each column shows.
    pub shown: Vec<Option<usize>>,
}

/// Places the points of a ring; `None` is no point.
pub(crate) fn of_ring(points: &[Option<Polar>], columns: usize) -> Placed {
    let position = |polar: &Option<Polar>| polar.map_or(f64::NAN, |polar| polar.position(columns));
    let positions: Vec<f64> = points.iter().map(position).collect();
    let mut placed = Placed { columns: alone(&positions, columns), shown: vec![None; columns] };
    for (point, column) in placed.columns.iter().enumerate() {
        if let Some(column) = column {
            placed.shown[*column] = Some(point);
        }
    }
    let away_m = |point: usize| points[point].map_or(f64::INFINITY, |polar| polar.away_m);
    for (point, position) in positions.iter().enumerate().filter(|(_, position)| position.is_finite()) {
        if placed.columns[point].is_none() {
            let column = position.round() as usize % columns;
            placed.columns[point] = Some(column);
            if placed.shown[column].is_none_or(|other| away_m(point) < away_m(other)) {
                placed.shown[column] = Some(point);
            }
        }
    }
    placed
}

/// How the best choice up to a point and a column came about.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Step {
    /// The column stays empty.
    Empty,
    /// The point goes without.
    Without,
    /// The point has the column.
    Match,
}

/// The best choices up to a point: for each column of its window, with no column behind that one.
struct Window {
    /// The first column.
    base: i64,
    worth: [f64; WINDOW],
    steps: [Step; WINDOW],
}

impl Window {
    /// Where a column stands in the window. Behind it nothing was added.
    fn at(&self, column: i64) -> usize {
        (column - self.base).clamp(0, WINDOW as i64 - 1) as usize
    }
}

/// The column that each point has for itself, 0 to `columns` - 1; `None` where all in reach have other points.
///
/// `positions` are those of the points, in columns after the first, within one turn.
fn alone(positions: &[f64], columns: usize) -> Vec<Option<usize>> {
    let turn = columns as f64;
    let mut order: Vec<usize> = (0..positions.len()).filter(|&point| positions[point].is_finite()).collect();
    order.sort_by(|&a, &b| positions[a].total_cmp(&positions[b]));
    let Some((start, gap)) = widest_gap(&order, positions, turn) else { return vec![None; positions.len()] };
    let unrolled = order[start..].iter().map(|&point| positions[point]);
    let unrolled: Vec<f64> = unrolled.chain(order[..start].iter().map(|&point| positions[point] + turn)).collect();
    order.rotate_left(start);
    let mut found = vec![None; positions.len()];
    for (point, column) in order.into_iter().zip(matches(&unrolled, gap, columns)) {
        found[point] = column.map(|column| column.rem_euclid(columns as i64) as usize);
    }
    found
}

/// The widest gap, and the point behind it as an index into the sorted points: there the ring is cut open.
fn widest_gap(order: &[usize], positions: &[f64], turn: f64) -> Option<(usize, f64)> {
    let gap = |index: usize| match index {
        0 => positions[order[0]] + turn - positions[order[order.len() - 1]],
        _ => positions[order[index]] - positions[order[index - 1]],
    };
    (0..order.len()).map(|index| (index, gap(index))).max_by(|a, b| a.1.total_cmp(&b.1))
}

/// The column of each of these points, which are in order and begin behind a gap.
fn matches(positions: &[f64], gap: f64, columns: usize) -> Vec<Option<i64>> {
    let Some(&start) = positions.first() else { return Vec::new() };
    // So many columns are all different when they are brought into one turn. In a full ring the first point keeps its
    // column, or all would have to move for the last one.
    let first = if gap > 2.0 * REACH + 1.0 { lowest(start) } else { start.round() as i64 };
    let last = first + columns as i64 - 1;
    let mut windows: Vec<Window> = Vec::with_capacity(positions.len());
    for &position in positions {
        let window = extend(windows.last(), position, first..=last);
        windows.push(window);
    }
    let mut found = vec![None; positions.len()];
    let mut column = last;
    for index in (0..positions.len()).rev() {
        let window = &windows[index];
        let mut at = window.at(column);
        while at > 0 && window.steps[at] == Step::Empty {
            at -= 1;
        }
        column = column.min(window.base + at as i64);
        if window.steps[at] == Step::Match {
            found[index] = Some(column);
            column -= 1;
        }
    }
    found
}

/// The first column that is in reach.
fn lowest(position: f64) -> i64 {
    (position - REACH).ceil() as i64
}

/// The choices up to the next point.
fn extend(before: Option<&Window>, position: f64, allowed: RangeInclusive<i64>) -> Window {
    let base = lowest(position) - 1;
    let worth_before = |column: i64| before.map_or(0.0, |before| before.worth[before.at(column)]);
    let mut window = Window { base, worth: [0.0; WINDOW], steps: [Step::Without; WINDOW] };
    for at in 0..WINDOW {
        let column = base + at as i64;
        let mut best = (worth_before(column), Step::Without);
        let moved = (position - column as f64).abs();
        if at > 0 && moved <= REACH && allowed.contains(&column) {
            let worth = worth_before(column - 1) + WORTH - moved * moved;
            if worth > best.0 {
                best = (worth, Step::Match);
            }
        }
        if at > 0 && window.worth[at - 1] >= best.0 {
            best = (window.worth[at - 1], Step::Empty);
        }
        (window.worth[at], window.steps[at]) = best;
    }
    window
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

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
        let placed = of_ring(&points, 100);
        let shown = placed.shown.iter().flatten();
        assert_eq!(shown.clone().count(), 4);
        assert!(shown.clone().any(|&point| point == 6), "the nearest of all: {placed:?}");
        assert_eq!(placed.columns.iter().filter(|column| column.is_none()).count(), 1);
    }

    /// The most points that can have a column, by trying all ways.
    fn most(positions: &[f64], columns: usize, taken: u32) -> usize {
        let Some((&first, rest)) = positions.split_first() else { return 0 };
        let within = |column: usize| {
            let off = (first - column as f64).rem_euclid(columns as f64);
            off.min(columns as f64 - off) <= REACH && taken & 1 << column == 0
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
                prop_assert!(off.min(8.0 - off) <= REACH + 1e-9);
            }
            // Where the ring is cut open, on either side of the cut a point may find no room.
            prop_assert!(count + 2 >= most(&positions, 8, 0), "{:?}", found);
        }
    }
}
