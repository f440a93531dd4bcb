//! Single linkage: points nearer to each other than a distance are in one group, transitively.
//!
//! Cells are sorted by place, so that the cells near a cell are a few short runs of the sorted
//! ones, which move on with it: no look-up is needed, and one pass over the cells for each run
//! finds all neighbours.

use std::ops::RangeInclusive;

/// Cells to either side of the origin, by axis; what lies further away is in no cell.
const REACH: f64 = (1 << 20) as f64 - 8.0;
/// Added to a cell's index, so that indices and those of neighbours are never negative.
const BIAS: i64 = 1 << 20;

/// Groups of points by exact single linkage, numbered from 0 in the order of their first points.
///
/// Two points are linked where the distance between them is less than `distance_m`. A point that is
/// not finite, or further from the origin than about 600,000 times that distance, is a group of its
/// own.
pub fn link(points: &[[f32; 3]], distance_m: f64) -> Vec<u32> {
    // A cell's diagonal is slightly shorter than the distance, so that all its points are linked in
    // spite of rounding.
    let side_m = distance_m / 3f64.sqrt() * 0.9999;
    let cells = Cells::new(points, |[x, y, z]| pack(x / side_m, y / side_m, z / side_m));
    let near_m2 = distance_m * distance_m;
    let mut sets = Sets::new(cells.codes.len());
    let mut undecided = Vec::new();
    for ahead in half_of_neighbours() {
        cells.for_each_pair(&ahead, |a, b| {
            match square_m2(cells.of(a)[0], cells.of(b)[0]) < near_m2 {
                true => sets.join(a, b),
                false => undecided.push((a, b)),
            }
        });
    }
    for (a, b) in undecided {
        if sets.root(a) != sets.root(b) && meet(cells.of(a), cells.of(b), near_m2) {
            sets.join(a, b);
        }
    }
    cells.groups(&mut sets, points.len())
}

/// Groups of points by a grid seen from above: occupied cells of `cell_m` by `cell_m` that touch,
/// by a side or a corner, are one. Numbered from 0 in the order of their first points; points in no
/// cell as in [`link`].
pub fn link_grid(points: &[[f32; 3]], cell_m: f64) -> Vec<u32> {
    let cells = Cells::new(points, |[x, y, _]| pack(x / cell_m, y / cell_m, 0.0));
    let mut sets = Sets::new(cells.codes.len());
    for (dx, dy) in [(0, 1), (1, -1), (1, 0), (1, 1)] {
        cells.for_each_pair(&Run::new(dx, dy, 0, 0), |a, b| sets.join(a, b));
    }
    cells.groups(&mut sets, points.len())
}

/// A number for each group: groups of sufficient size get the numbers after `last`, which is
/// advanced; the others get `none`.
pub(super) fn number_groups(
    groups: &[u32],
    kept: RangeInclusive<u32>,
    none: u32,
    last: &mut u32,
) -> Vec<u32> {
    let count = groups.iter().max().map_or(0, |&most| most as usize + 1);
    let mut sizes = vec![0; count];
    for &group in groups {
        sizes[group as usize] += 1;
    }
    let mut numbers = Vec::with_capacity(count);
    for size in &sizes {
        if kept.contains(size) {
            *last += 1;
            numbers.push(*last);
        } else {
            numbers.push(none);
        }
    }
    numbers
}

/// One code for a cell: sorted by code, cells are in the order of x, then y, then z.
fn pack(x: f64, y: f64, z: f64) -> Option<u64> {
    Some(biased(x)? << 42 | biased(y)? << 21 | biased(z)?)
}

/// The index of a cell along one axis, from 0 on; `None` where it is out of reach.
fn biased(at: f64) -> Option<u64> {
    (at.abs() < REACH).then(|| (at.floor() as i64 + BIAS) as u64)
}

/// Cells ahead of a cell that follow each other in the order of codes.
struct Run {
    /// From the cell's code to the first of them.
    first: i64,
    /// To the last of them from the first.
    span: u64,
}

impl Run {
    fn new(dx: i64, dy: i64, from_z: i64, to_z: i64) -> Self {
        Self {
            first: (dx << 42) + (dy << 21) + from_z,
            span: (to_z - from_z) as u64,
        }
    }
}

/// The cells within two of a cell, which may hold points near one of its own; those behind it see
/// it ahead.
fn half_of_neighbours() -> Vec<Run> {
    let beside = (1..=2)
        .map(|dy| (0, dy))
        .chain((1..=2).flat_map(|dx| (-2..=2).map(move |dy| (dx, dy))));
    std::iter::once(Run::new(0, 0, 1, 2))
        .chain(beside.map(|(dx, dy)| Run::new(dx, dy, -2, 2)))
        .collect()
}

/// Points by cell.
struct Cells {
    /// Of the occupied cells, ascending.
    codes: Vec<u64>,
    /// First point of each cell among the sorted; one more at the end.
    start: Vec<u32>,
    /// Index of each sorted point.
    index: Vec<u32>,
    /// The sorted points, metres.
    point: Vec<[f64; 3]>,
}

impl Cells {
    fn new(points: &[[f32; 3]], cell_of: impl Fn([f64; 3]) -> Option<u64>) -> Self {
        let mut placed: Vec<(u64, u32)> = (points.iter().enumerate())
            .filter_map(|(index, point)| Some((cell_of(point.map(f64::from))?, index as u32)))
            .collect();
        placed.sort_unstable();
        let mut cells = Self {
            codes: Vec::new(),
            start: Vec::new(),
            index: Vec::new(),
            point: Vec::new(),
        };
        for (at, &(code, index)) in placed.iter().enumerate() {
            if cells.codes.last() != Some(&code) {
                cells.codes.push(code);
                cells.start.push(at as u32);
            }
            cells.index.push(index);
            cells.point.push(points[index as usize].map(f64::from));
        }
        cells.start.push(placed.len() as u32);
        cells
    }

    /// The points of a cell.
    fn of(&self, cell: u32) -> &[[f64; 3]] {
        let cell = cell as usize;
        &self.point[self.start[cell] as usize..self.start[cell + 1] as usize]
    }

    /// Every cell with every occupied one of its run.
    fn for_each_pair(&self, ahead: &Run, mut pair: impl FnMut(u32, u32)) {
        let mut from = 0;
        for (cell, &code) in self.codes.iter().enumerate() {
            let first = code.wrapping_add_signed(ahead.first);
            while self.codes.get(from).is_some_and(|&code| code < first) {
                from += 1;
            }
            for (other, _) in self.codes[from..]
                .iter()
                .enumerate()
                .take_while(|(_, code)| *code - first <= ahead.span)
            {
                pair(cell as u32, (from + other) as u32);
            }
        }
    }

    /// The group of every point, by the sets of the cells.
    fn groups(&self, sets: &mut Sets, points: usize) -> Vec<u32> {
        const NOWHERE: u32 = u32::MAX;
        let mut set = vec![NOWHERE; points];
        for cell in 0..self.codes.len() as u32 {
            let root = sets.root(cell);
            for &index in &self.index
                [self.start[cell as usize] as usize..self.start[cell as usize + 1] as usize]
            {
                set[index as usize] = root;
            }
        }
        let mut number = vec![NOWHERE; self.codes.len()];
        let mut next = 0;
        for set in &mut set {
            *set = match number.get_mut(*set as usize) {
                Some(&mut known) if known != NOWHERE => known,
                unknown => {
                    // A point in no cell is a group by itself.
                    if let Some(number) = unknown {
                        *number = next;
                    }
                    next += 1;
                    next - 1
                }
            };
        }
        set
    }
}

/// Whether any point of one cell is near any of another. Points that are too far from all of the
/// other cell are left out first: most pairs of cells are decided by that.
fn meet(a: &[[f64; 3]], b: &[[f64; 3]], near_m2: f64) -> bool {
    let (low_a, high_a) = bounds(a);
    let (low_b, high_b) = bounds(b);
    let near_b: Vec<&[f64; 3]> = b
        .iter()
        .filter(|point| square_m2(**point, clamp(**point, low_a, high_a)) < near_m2)
        .collect();
    (a.iter()
        .filter(|point| square_m2(**point, clamp(**point, low_b, high_b)) < near_m2))
    .any(|one| {
        near_b
            .iter()
            .any(|other| square_m2(*one, **other) < near_m2)
    })
}

fn bounds(points: &[[f64; 3]]) -> ([f64; 3], [f64; 3]) {
    let mut low = points[0];
    let mut high = points[0];
    for point in points {
        for axis in 0..3 {
            low[axis] = low[axis].min(point[axis]);
            high[axis] = high[axis].max(point[axis]);
        }
    }
    (low, high)
}

fn clamp(point: [f64; 3], low: [f64; 3], high: [f64; 3]) -> [f64; 3] {
    [0, 1, 2].map(|axis| point[axis].clamp(low[axis], high[axis]))
}

fn square_m2(a: [f64; 3], b: [f64; 3]) -> f64 {
    (0..3)
        .map(|axis| (a[axis] - b[axis]) * (a[axis] - b[axis]))
        .sum()
}

/// Sets that only grow together.
struct Sets {
    parent: Vec<u32>,
}

impl Sets {
    fn new(count: usize) -> Self {
        Self {
            parent: (0..count as u32).collect(),
        }
    }

    fn root(&mut self, mut of: u32) -> u32 {
        while self.parent[of as usize] != of {
            let above = self.parent[self.parent[of as usize] as usize];
            self.parent[of as usize] = above;
            of = above;
        }
        of
    }

    fn join(&mut self, a: u32, b: u32) {
        let a = self.root(a);
        let b = self.root(b);
        self.parent[a.max(b) as usize] = a.min(b);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// All pairs, and labels that spread until nothing changes.
    fn naive(points: &[[f32; 3]], linked: impl Fn([f64; 3], [f64; 3]) -> bool) -> Vec<u32> {
        let mut sets = Sets::new(points.len());
        for a in 0..points.len() {
            for b in 0..a {
                if linked(points[a].map(f64::from), points[b].map(f64::from)) {
                    sets.join(a as u32, b as u32);
                }
            }
        }
        let mut numbers = Vec::new();
        (0..points.len() as u32)
            .map(|point| {
                let root = sets.root(point);
                numbers
                    .iter()
                    .position(|&number| number == root)
                    .unwrap_or_else(|| {
                        numbers.push(root);
                        numbers.len() - 1
                    }) as u32
            })
            .collect()
    }

    /// From all in one group to all apart, about the origin and away from it.
    fn clouds() -> Vec<Vec<[f32; 3]>> {
        let mut random = fastrand::Rng::with_seed(5);
        let sizes = [1.0, 4.0, 6.0, 9.0, 14.0, 40.0];
        let cloud = |index: usize| {
            let size = sizes[index % sizes.len()];
            let shift = if index.is_multiple_of(2) {
                -0.5 * size
            } else {
                30.0
            };
            (0..250)
                .map(|_| [size, size, 0.4 * size].map(|size| shift + size * random.f32()))
                .collect()
        };
        (0..36).map(cloud).collect()
    }

    #[test]
    fn equal_to_all_pairs_on_random_clouds() {
        for (index, points) in clouds().iter().enumerate() {
            for distance_m in [0.3, 1.0, 2.5] {
                let linked = |a, b| square_m2(a, b) < distance_m * distance_m;
                assert!(
                    link(points, distance_m) == naive(points, linked),
                    "cloud {index}, {distance_m} m"
                );
                let touching = |a: [f64; 3], b: [f64; 3]| {
                    (0..2).all(|axis| {
                        ((a[axis] / distance_m).floor() - (b[axis] / distance_m).floor()).abs()
                            <= 1.0
                    })
                };
                assert!(
                    link_grid(points, distance_m) == naive(points, touching),
                    "cloud {index}, {distance_m} m cells"
                );
            }
        }
    }

    /// Links need less than the distance, are transitive, and never include points that are not
    /// finite or too far away.
    #[test]
    fn the_distance_itself_is_too_far() {
        let chain = |step: f32| -> Vec<[f32; 3]> {
            (0..30).map(|at| [0.0, step * at as f32, -1.0]).collect()
        };
        assert_eq!(link(&chain(0.96875), 1.0), [0; 30]);
        assert_eq!(link(&chain(1.0), 1.0), (0..30).collect::<Vec<u32>>()[..]);
        let odd = [
            [1.0, 1.0, 1.0],
            [f32::NAN, 1.0, 1.0],
            [1e30, 0.0, 0.0],
            [1.5, 1.0, 1.0],
            [f32::INFINITY, 1.0, 1.0],
        ];
        assert_eq!(link(&odd, 1.0), [0, 1, 2, 0, 3]);
        assert_eq!(link_grid(&odd[..4], 1.0), [0, 1, 2, 0]);
        assert!(link(&[], 1.0).is_empty());
    }

    /// Cells of many points whose first ones are far apart, and of which one pair alone is near.
    #[test]
    fn one_near_pair_joins_two_crowds() {
        let crowd = |x: f32, reach: f32| {
            (0..200).map(move |at| {
                [
                    x + reach * at as f32 / 199.0,
                    0.05,
                    if at == 199 { 0.25 } else { 0.05 },
                ]
            })
        };
        let points: Vec<[f32; 3]> = crowd(0.05, 0.4).chain(crowd(1.9, -0.3)).collect();
        let gap_m = f64::from(points[399][0]) - f64::from(points[199][0]);
        assert!(link(&points, gap_m + 1e-6).iter().all(|&group| group == 0));
        let apart = link(&points, gap_m);
        assert!(
            apart[..200].iter().all(|&group| group == 0)
                && apart[200..].iter().all(|&group| group == 1)
        );
    }
}
