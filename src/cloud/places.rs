//! Which firing of a turn each point of a ring goes to: which column, and of the simulator which shot.
//!
//! Firings are even; the points of a real scan are not: the encoder steps unevenly, a correction for motion crowds them,
//! and a beam that starts beside the axis sees near and far things shifted. Each point has a firing within half a pitch,
//! but a point in twelve shares it with another. So points keep their order and make room: as many as possible have a
//! firing of their own no more than a pitch away, and among these ways the one is taken that moves them least.

use std::ops::RangeInclusive;

/// A point may be so far from its firing, pitches.
const REACH: f64 = 1.0;
/// Worth of a point that has a firing, in squared pitches: more than all moves of a ring can cost.
const WORTH: f64 = 1e6;
/// Firings in question at a point: one that is out of reach, then up to three within.
const WINDOW: usize = 4;

/// How the best choice up to a point and a firing came about.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Step {
    /// The firing stays empty.
    Empty,
    /// The point goes without.
    Without,
    /// The point has the firing.
    Match,
}

/// The best choices up to a point: for each firing of its window, with no firing behind that one.
struct Window {
    /// The first firing.
    base: i64,
    worth: [f64; WINDOW],
    steps: [Step; WINDOW],
}

impl Window {
    /// Where a firing stands in the window. Behind it nothing was added.
    fn at(&self, firing: i64) -> usize {
        (firing - self.base).clamp(0, WINDOW as i64 - 1) as usize
    }
}

/// The firing of each point, 0 to `firings` - 1; `None` where all in reach have other points.
///
/// `positions` are those of the points, in firings after the first, within one turn.
pub(crate) fn of_ring(positions: &[f64], firings: usize) -> Vec<Option<usize>> {
    let turn = firings as f64;
    let mut order: Vec<usize> = (0..positions.len()).filter(|&point| positions[point].is_finite()).collect();
    order.sort_by(|&a, &b| positions[a].total_cmp(&positions[b]));
    let Some((start, gap)) = widest_gap(&order, positions, turn) else { return vec![None; positions.len()] };
    let unrolled = order[start..].iter().map(|&point| positions[point]);
    let unrolled: Vec<f64> = unrolled.chain(order[..start].iter().map(|&point| positions[point] + turn)).collect();
    order.rotate_left(start);
    let mut found = vec![None; positions.len()];
    for (point, firing) in order.into_iter().zip(matches(&unrolled, gap, firings)) {
        found[point] = firing.map(|firing| firing.rem_euclid(firings as i64) as usize);
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

/// The firing of each of these points, which are in order and begin behind a gap.
fn matches(positions: &[f64], gap: f64, firings: usize) -> Vec<Option<i64>> {
    let Some(&start) = positions.first() else { return Vec::new() };
    // So many firings are all different when they are brought into one turn. In a full ring the first point keeps its
    // firing, or all would have to move for the last one.
    let first = if gap > 2.0 * REACH + 1.0 { lowest(start) } else { start.round() as i64 };
    let last = first + firings as i64 - 1;
    let mut windows: Vec<Window> = Vec::with_capacity(positions.len());
    for &position in positions {
        let window = extend(windows.last(), position, first..=last);
        windows.push(window);
    }
    let mut found = vec![None; positions.len()];
    let mut firing = last;
    for index in (0..positions.len()).rev() {
        let window = &windows[index];
        let mut at = window.at(firing);
        while at > 0 && window.steps[at] == Step::Empty {
            at -= 1;
        }
        firing = firing.min(window.base + at as i64);
        if window.steps[at] == Step::Match {
            found[index] = Some(firing);
            firing -= 1;
        }
    }
    found
}

/// The first firing that is in reach.
fn lowest(position: f64) -> i64 {
    (position - REACH).ceil() as i64
}

/// The choices up to the next point.
fn extend(before: Option<&Window>, position: f64, allowed: RangeInclusive<i64>) -> Window {
    let base = lowest(position) - 1;
    let worth_before = |firing: i64| before.map_or(0.0, |before| before.worth[before.at(firing)]);
    let mut window = Window { base, worth: [0.0; WINDOW], steps: [Step::Without; WINDOW] };
    for at in 0..WINDOW {
        let firing = base + at as i64;
        let mut best = (worth_before(firing), Step::Without);
        let moved = (position - firing as f64).abs();
        if at > 0 && moved <= REACH && allowed.contains(&firing) {
            let worth = worth_before(firing - 1) + WORTH - moved * moved;
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
    fn points_at_firings_have_these() {
        let even: Vec<f64> = (0..10).map(f64::from).collect();
        assert_eq!(of_ring(&even, 10), (0..10).map(Some).collect::<Vec<_>>());
        assert_eq!(of_ring(&[9.6, 0.2, 4.4], 10), [Some(9), Some(0), Some(4)], "each has the nearest but one");
        assert_eq!(of_ring(&[], 10), []);
        assert_eq!(of_ring(&[f64::NAN, 3.0], 10), [None, Some(3)]);
    }

    #[test]
    fn points_make_room_and_the_rest_goes_without() {
        assert_eq!(of_ring(&[5.1, 4.9], 10), [Some(5), Some(4)]);
        assert_eq!(of_ring(&[5.1, 5.2, 5.3], 10), [Some(5), None, Some(6)]);
        assert_eq!(of_ring(&[5.0, 5.0, 5.0, 5.0], 10).iter().flatten().count(), 3);
        let crowd: Vec<f64> = (0..25).map(|index| f64::from(index) * 0.4).collect();
        let found = of_ring(&crowd, 10);
        assert_eq!(found.iter().flatten().count(), 10);
    }

    /// The most points that can have a firing, by trying all ways.
    fn most(positions: &[f64], firings: usize, taken: u32) -> usize {
        let Some((&first, rest)) = positions.split_first() else { return 0 };
        let within = |firing: usize| {
            let off = (first - firing as f64).rem_euclid(firings as f64);
            off.min(firings as f64 - off) <= REACH && taken & 1 << firing == 0
        };
        let with =
            (0..firings).filter(|&firing| within(firing)).map(|firing| 1 + most(rest, firings, taken | 1 << firing));
        with.max().unwrap_or(0).max(most(rest, firings, taken))
    }

    proptest! {
        #[test]
        fn no_firing_is_used_twice_and_nearly_as_many_as_can_have_one(
            positions in proptest::collection::vec(0.0..8.0, 0..7),
        ) {
            let found = of_ring(&positions, 8);
            let mut taken: Vec<usize> = found.iter().flatten().copied().collect();
            taken.sort_unstable();
            let count = taken.len();
            taken.dedup();
            prop_assert_eq!(taken.len(), count);
            for (position, firing) in positions.iter().zip(&found) {
                let off = firing.map_or(0.0, |firing| (position - firing as f64).rem_euclid(8.0));
                prop_assert!(off.min(8.0 - off) <= REACH + 1e-9);
            }
            // The cut of the ring can cost one.
            prop_assert!(count + 1 >= most(&positions, 8, 0), "{:?}", found);
        }
    }
}
