//! Where runs are short and many, as in dust, spray or a hedge: points are compared, and not runs.
//! Sixteen columns of a row at once, with the sixteen that lie this many rows and columns from
//! them, for each place of the window.
//!
//! It is the same test of the same pairs as [`super::window`]'s, so the labels are the same. Its
//! time hardly depends on how many runs there are: most places are settled by two loads and two
//! comparisons, since what lies there is of the same component by then.

use fearless_simd::{Simd, prelude::*, u32x16};

use super::pieces::Pieces;
use super::points::{BEFORE, LANES, Points, STRIP};
use super::reach::Entries;
use super::window::{MOST_COLUMNS, MOST_ROWS, Miss, Point, Test};
use super::work;

/// Lanes of a row: the columns within reach.
const STRIDE: usize = BEFORE + STRIP;
/// Where there is nothing to join.
const NOTHING: u32 = u32::MAX;
/// Beside the root of a component that is not small any more.
const LARGE: u32 = 1 << 31;
/// More runs than this within reach of a row, on average, are a crowd: there this is the faster
/// way.
const MANY: usize = 16;

/// The points of the columns within reach, by their components.
#[derive(Clone, Debug, Default)]
pub(super) struct Crowd {
    /// Root of each point's component as it was last looked up, and whether it was [`LARGE`].
    root: Vec<u32>,
    /// Points of the row at hand that are near others, and not joined.
    near: Vec<[Lanes; 2]>,
}

/// Sixteen columns of a row, counted from the first of the strip.
#[derive(Clone, Copy, Debug)]
struct Lanes {
    row: usize,
    column: isize,
}

impl Lanes {
    /// Their first in the table of roots.
    #[inline(always)]
    fn place(self) -> usize {
        self.row * STRIDE + BEFORE.wrapping_add_signed(self.column)
    }

    /// Their points.
    #[inline(always)]
    fn points<S: Simd>(self, simd: S, points: &Points) -> Point<S> {
        Point::load(
            simd,
            points,
            points.at(self.row).wrapping_add_signed(self.column),
        )
    }
}

impl Crowd {
    /// Takes room for this many rows.
    pub fn reserve(&mut self, rows: usize) {
        self.root.resize(rows * STRIDE, NOTHING);
        super::reserve(
            &mut self.near,
            (2 * MOST_ROWS + 1) * (MOST_COLUMNS + 1) * STRIP / LANES,
        );
    }

    /// Whether runs are so many that this is the faster way.
    pub fn is_in(entries: &Entries, rows: usize) -> bool {
        entries.len() > MANY * rows
    }

    /// Joins the runs of the strip at hand with each other and with those before.
    #[inline(always)]
    pub fn join<S: Simd>(
        &mut self,
        simd: S,
        test: &Test,
        points: &Points,
        entries: &Entries,
        pieces: &mut Pieces,
        misses: &mut Vec<Miss>,
    ) {
        let rows = points.rows();
        for entering in 0..rows + test.rows() {
            if entering < rows {
                self.enter(test, entries, entering, pieces);
            }
            let Some(row) = entering.checked_sub(test.rows()) else {
                continue;
            };
            for column in (0..STRIP as isize).step_by(LANES) {
                let here = Lanes { row, column };
                self.compare(simd, test, points, (here, row, 1), pieces);
                for below in row + 1..rows.min(entering + 1) {
                    self.compare(simd, test, points, (here, below, 0), pieces);
                    self.compare(
                        simd,
                        test,
                        points,
                        (Lanes { row: below, column }, row, 1),
                        pieces,
                    );
                }
            }
            self.note(simd, test, points, pieces, misses);
        }
    }

    /// Writes down of which component each point of a row is.
    #[inline(always)]
    fn enter(&mut self, test: &Test, entries: &Entries, row: usize, pieces: &mut Pieces) {
        let roots = &mut self.root[row * STRIDE..][..STRIDE];
        roots.fill(NOTHING);
        for entry in entries.of(row) {
            let root = known(test, pieces.root(entries.piece[entry]), pieces);
            roots[entries.first[entry] as usize..=entries.last[entry] as usize].fill(root);
        }
    }

    /// Compares sixteen points of a row with those of a row that lie columns before them, from so
    /// many columns on to as many as the window has, and joins them.
    #[inline(always)]
    fn compare<S: Simd>(
        &mut self,
        simd: S,
        test: &Test,
        points: &Points,
        (here, other, from): (Lanes, usize, isize),
        pieces: &mut Pieces,
    ) {
        let mut root = self.roots(simd, here);
        let is = !root.simd_eq(NOTHING);
        if !is.any_true() {
            return;
        }
        let one = here.points(simd, points);
        for aside in from..=test.columns() as isize {
            work::count(1);
            let before = Lanes {
                row: other,
                column: here.column - aside,
            };
            let there = self.roots(simd, before);
            let of_two = is & !there.simd_eq(NOTHING) & !there.simd_eq(root);
            if !of_two.any_true() {
                continue;
            }
            let two = before.points(simd, points);
            let apart2 = one.apart2(&two);
            let joined = of_two & test.joins(&one, &two, apart2);
            if (of_two & !joined & test.nears(apart2) & (root & there).simd_lt(LARGE)).any_true() {
                self.near.push([here, before]);
            }
            if joined.any_true() {
                self.unite(test, [here, before], joined.to_bitmask(), pieces);
                root = self.roots(simd, here);
            }
        }
    }

    /// Notes which points of a row are near others, and of a component that is still small, or near
    /// such a one: what is joined to the row is known by now.
    #[inline(always)]
    fn note<S: Simd>(
        &mut self,
        simd: S,
        test: &Test,
        points: &Points,
        pieces: &mut Pieces,
        misses: &mut Vec<Miss>,
    ) {
        while let Some([here, before]) = self.near.pop() {
            let (root, there) = (self.roots(simd, here), self.roots(simd, before));
            let is = !root.simd_eq(NOTHING) & !there.simd_eq(NOTHING) & !there.simd_eq(root);
            let is_one_small = (root & there).simd_lt(LARGE);
            work::count(1);
            let apart2 = here
                .points(simd, points)
                .apart2(&before.points(simd, points));
            let mut left = (is & is_one_small & test.nears(apart2)).to_bitmask();
            if left == 0 {
                continue;
            }
            let apart2 = apart2.to_array();
            while left != 0 {
                let lane = left.trailing_zeros() as usize;
                left &= left - 1;
                work::count(1);
                let roots = self.look_up(
                    test,
                    [here, before].map(|lanes| lanes.place() + lane),
                    pieces,
                );
                if roots[0] != roots[1] && roots.iter().any(|&root| test.is_small(root, pieces)) {
                    misses.push(Miss {
                        pieces: roots,
                        apart2: apart2[lane],
                    });
                }
            }
        }
    }

    #[inline(always)]
    fn roots<S: Simd>(&self, simd: S, lanes: Lanes) -> u32x16<S> {
        u32x16::from_slice(simd, &self.root[lanes.place()..][..LANES])
    }

    /// Makes one of the components of some lanes.
    #[inline(always)]
    fn unite(&mut self, test: &Test, pair: [Lanes; 2], mut lanes: u64, pieces: &mut Pieces) {
        while lanes != 0 {
            let places = pair.map(|one| one.place() + lanes.trailing_zeros() as usize);
            lanes &= lanes - 1;
            work::count(1);
            let [a, b] = places.map(|place| self.root[place] & !LARGE);
            let [root, _] = pieces.unite(a, b);
            for place in places {
                self.root[place] = known(test, root, pieces);
            }
        }
    }

    /// The roots of two points, which are then known.
    #[inline(always)]
    fn look_up(&mut self, test: &Test, places: [usize; 2], pieces: &mut Pieces) -> [u32; 2] {
        places.map(|place| {
            let root = pieces.root(self.root[place] & !LARGE);
            self.root[place] = known(test, root, pieces);
            root
        })
    }
}

/// What is known of a component, by its root.
fn known(test: &Test, root: u32, pieces: &Pieces) -> u32 {
    if test.is_small(root, pieces) {
        root
    } else {
        root | LARGE
    }
}
