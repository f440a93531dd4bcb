//! The paper's own method (Bogoslavskyi and Stachniss, IROS 2016, section III), on a whole image at
//! a time, one plain step after another:
//!
//! 1. The ground, as the authors' journal paper (PFG 2017) and their program have it: holes of the
//!    columns are filled, the inclinations from each pixel to the one above are smoothed along the
//!    column ([`ground`]), and the ground spreads breadth first from the lowest pixel of each
//!    column to what is inclined alike.
//! 2. The segments (algorithm 1): what is left is searched breadth first, and goes on to those of
//!    the four neighbours that pass the test of beta, on the true [`angles`].
//! 3. `table`: what each segment measures. This is not the paper's.
//!
//! The golden images of the authors' own program hold these steps to what they published. A plane
//! has a number for each pixel, column after column from the top row down, as those of a sweep do.

pub(super) mod angles;
pub(super) mod ground;
mod table;

use fearless_simd::Level;

use super::config::Config;
use super::mount::Stance;
use super::order::reserve;
use crate::sweep::SweepMut;
use crate::sweep::layout::{LABEL_FIRST_SEGMENT, LABEL_GROUND, LABEL_NONE, is_return};
use angles::{Angles, Pair};
use ground::{Inclinations, PaperGround};
use table::Table;

/// Labels sweeps as the paper does; after the first in buffers of one size it allocates nothing.
#[derive(Clone, Debug, Default)]
pub struct PaperSegmenter {
    /// Ranges that may be labelled, and what fills their holes, metres; 0 elsewhere.
    pub range_m: Vec<f32>,
    /// The inclination of each pixel.
    pub inclinations: Inclinations,
    /// How the neighbours lie to each other.
    pub angles: Angles,
    /// By pixel; [`LABEL_NONE`] where no search has come to.
    pub labels: Vec<u32>,
    /// Pixels whose label counts: they are no filled holes, and of no component that is too small.
    counts: Vec<bool>,
    /// Pixels that the last search came to, in the order of finding.
    found: Vec<u32>,
    stance: Stance,
    is_ground_found: bool,
    segments: usize,
    max_segments: usize,
    table: Table,
}

impl PaperSegmenter {
    /// Takes what may be labelled in a sweep, and the angles between neighbours.
    pub fn begin(&mut self, sweep: &SweepMut<'_>, config: &Config) {
        self.reserve(sweep);
        self.stance = config.mount.stance();
        self.is_ground_found = false;
        self.max_segments = sweep.segments.len();
        let sweep = sweep.as_ref();
        self.angles.measure(&sweep);
        self.inclinations.begin(sweep.beams);
        if self.stance == Stance::HeadDown {
            self.inclinations.turn_over();
        }
        self.labels.resize(sweep.range.len(), LABEL_NONE);
        self.range_m.extend_from_slice(sweep.range);
        for (pixel, range_m) in self.range_m.iter_mut().enumerate() {
            let is_masked = config.mask.as_ref().is_some_and(|mask| {
                let row = pixel % sweep.rows();
                mask.hides(row, sweep.azimuth_rad(row, pixel / sweep.rows()))
            });
            if is_masked || !config.holds(*range_m) {
                *range_m = 0.0;
            }
        }
        self.counts
            .extend(self.range_m.iter().map(|&range_m| is_return(range_m)));
    }

    /// Takes room for any sweep that such a buffer can hold: later ones are wider by a few columns,
    /// and must not allocate. Room that is never touched costs no memory.
    fn reserve(&mut self, sweep: &SweepMut<'_>) {
        let pixels = sweep.range.len();
        reserve(&mut self.range_m, pixels);
        reserve(&mut self.inclinations.plane_rad, pixels);
        reserve(&mut self.labels, pixels);
        reserve(&mut self.counts, pixels);
        reserve(&mut self.found, pixels);
        reserve(&mut self.angles.gaps_rad, sweep.columns.len());
        reserve(&mut self.angles.sin2_half_gap, sweep.columns.len());
        reserve(&mut self.table.measured, sweep.segments.len());
        self.table.beams.reserve(sweep.columns.len());
    }

    /// Labels the ground. False when that is done already.
    pub fn find_ground(&mut self, config: &Config) -> bool {
        if std::mem::replace(&mut self.is_ground_found, true) {
            return false;
        }
        self.incline(&config.paper);
        if self.stance != Stance::OnSide {
            self.label_ground(&config.paper);
        }
        true
    }

    /// Fills the holes, and takes the inclinations: from the highest pixel of each column down.
    pub fn incline(&mut self, limits: &PaperGround) {
        let is_head_down = self.stance == Stance::HeadDown;
        for column in self.range_m.chunks_exact_mut(self.angles.rows().max(1)) {
            if is_head_down {
                column.reverse();
            }
            let from = self.inclinations.plane_rad.len();
            ground::repair(column, limits);
            self.inclinations.add(column, limits.window);
            if is_head_down {
                column.reverse();
                self.inclinations.plane_rad[from..].reverse();
            }
        }
    }

    /// Labels the ground: from the lowest pixel of each column with a range, where it is flat
    /// enough, to all neighbours whose inclination differs by less than the angle.
    pub fn label_ground(&mut self, limits: &PaperGround) {
        let rows = self.angles.rows();
        for first in (0..self.range_m.len()).step_by(rows.max(1)) {
            let column = &self.range_m[first..first + rows];
            let is_real = |range_m: &f32| is_return(*range_m);
            let lowest = match self.stance {
                Stance::HeadDown => column.iter().position(is_real),
                _ => column.iter().rposition(is_real),
            };
            let start = first + lowest.unwrap_or(0);
            if self.is_free(start) && self.inclinations.plane_rad[start] <= limits.start_angle_rad {
                self.spread(start, LABEL_GROUND, |paper, _, here, there| {
                    let inclination_rad = &paper.inclinations.plane_rad;
                    (inclination_rad[here] - inclination_rad[there]).abs() < limits.angle_rad
                });
            }
        }
    }

    /// Labels what is no ground, segment by segment as their first pixels come: neighbours whose
    /// beta is greater than theta belong together.
    pub fn join(&mut self, config: &Config) {
        let tan2_theta = f64::from(config.theta_rad).tan().powi(2);
        self.segments = 0;
        for start in 0..self.range_m.len() {
            if !self.is_free(start) || !is_return(self.range_m[start]) {
                continue;
            }
            let label = LABEL_FIRST_SEGMENT + self.segments as u32;
            self.spread(start, label, |paper, pair, high, low| {
                pair.joins(paper.range_m[high], paper.range_m[low], tan2_theta)
            });
            let found = self.found.iter().map(|&pixel| pixel as usize);
            let points = found.clone().filter(|&pixel| self.counts[pixel]).count();
            if points >= config.min_points.max(1) as usize && self.segments < self.max_segments {
                self.segments += 1;
            } else {
                // It keeps a label, so that no search comes to it again; the next one has the same.
                found.for_each(|pixel| self.counts[pixel] = false);
            }
        }
    }

    /// Searches breadth first (algorithm 1): labels a pixel, and those without label that it is joined to,
    /// directly or through others. A hole is reached, but nothing from there.
    ///
    /// Neighbours are joined that pass a test: of how their beams lie to each other, the upper
    /// pixel and the lower one, or two of a row.
    #[inline(always)]
    fn spread(
        &mut self,
        start: usize,
        label: u32,
        joins: impl Fn(&Self, &Pair, usize, usize) -> bool,
    ) {
        let rows = self.angles.rows();
        let columns = self.range_m.len() / rows;
        self.found.clear();
        self.reach(start, label);
        let mut next = 0;
        while let Some(&here) = self.found.get(next) {
            next += 1;
            let column = (here / rows as u32) as usize;
            let row = (here % rows as u32) as usize;
            let here = here as usize;
            if !is_return(self.range_m[here]) {
                continue;
            }
            if row > 0
                && self.is_free(here - 1)
                && joins(self, self.angles.below(row - 1), here - 1, here)
            {
                self.reach(here - 1, label);
            }
            if row + 1 < rows
                && self.is_free(here + 1)
                && joins(self, self.angles.below(row), here, here + 1)
            {
                self.reach(here + 1, label);
            }
            let before = if column == 0 { columns - 1 } else { column - 1 };
            let after = if column + 1 == columns { 0 } else { column + 1 };
            for (beside, later) in [(before, column), (after, after)] {
                let there = beside * rows + row;
                if self.is_free(there)
                    && let Some(pair) = self.angles.before(later, row)
                    && joins(self, &pair, here, there)
                {
                    self.reach(there, label);
                }
            }
        }
    }

    fn is_free(&self, pixel: usize) -> bool {
        self.labels[pixel] == LABEL_NONE
    }

    fn reach(&mut self, pixel: usize, label: u32) {
        self.labels[pixel] = label;
        self.found.push(pixel as u32);
    }

    /// Writes the labels, the segments table and the header's counts.
    pub fn label(&mut self, sweep: &mut SweepMut<'_>, config: &Config, level: Level) {
        let pixels = sweep.image_pixels();
        sweep.header.segments = self.segments as u32;
        sweep.header.ground = 0;
        let found = self.labels.iter().zip(&self.counts);
        for (label, (&found, &counts)) in sweep.label[pixels].iter_mut().zip(found) {
            *label = if counts { found } else { LABEL_NONE };
            sweep.header.ground += u32::from(*label == LABEL_GROUND);
        }
        self.table.describe(sweep, config, level);
    }
}

#[cfg(test)]
mod tests {
    use std::f32::consts::{FRAC_PI_2, PI};

    use super::*;
    use crate::buffers::{Buffers, HeapBuffers};
    use crate::sensor::Beam;
    use crate::sweep::Shape;

    /// Labels of the first columns of an image whose neighbours are a degree apart, the rest of it
    /// being empty, at theta 10 degrees: 10 m and 10.1 m belong together, 10 m and 12 m do not. A
    /// negative range only connects.
    fn label(rows: usize, first_m: &[f32], min_points: u32, max_segments: usize) -> Vec<u32> {
        let pixels = 360 * rows;
        let config = Config {
            theta_rad: 10_f32.to_radians(),
            min_points,
            ..Config::default()
        };
        let mut range_m: Vec<f32> = first_m.iter().map(|range_m| range_m.abs()).collect();
        range_m.resize(pixels, 0.0);
        let mut paper = PaperSegmenter {
            range_m,
            angles: Angles::even(&vec![1_f64.to_radians(); rows - 1], 360),
            max_segments,
            ..PaperSegmenter::default()
        };
        // Twice, so that nothing of the first time is left.
        for _ in 0..2 {
            paper.labels = vec![LABEL_NONE; pixels];
            paper.counts = (0..pixels)
                .map(|pixel| first_m.get(pixel).is_some_and(|&range_m| range_m > 0.0))
                .collect();
            paper.join(&config);
        }
        let labelled = paper.labels.iter().zip(&paper.counts);
        let mut labels: Vec<u32> = labelled
            .map(|(&label, &counts)| if counts { label } else { LABEL_NONE })
            .collect();
        let most = labels.iter().max().map_or(0, |most| most.saturating_sub(1));
        assert_eq!(paper.segments, most as usize);
        labels.truncate(first_m.len());
        labels
    }

    #[test]
    fn beta_parts_a_step() {
        assert_eq!(
            label(3, &[10.0, 10.1, 12.1, 10.0, 0.0, 12.0, 0.0, 0.0, 0.0], 1, 9),
            [2, 2, 3, 2, 0, 3, 0, 0, 0]
        );
    }

    /// A "U" lying on its side: two arms that only the third column joins.
    #[test]
    fn arms_that_meet_late_are_one_segment() {
        let arms = [[10.0, 0.0, 10.0], [10.0, 0.0, 10.0], [10.0; 3]].concat();
        assert_eq!(label(3, &arms, 7, 9), [2, 0, 2, 2, 0, 2, 2, 2, 2]);
        assert_eq!(label(3, &arms, 8, 9), [0; 9]);
    }

    #[test]
    fn the_seam_joins_the_ends() {
        let mut turn_m = [0.0; 360];
        for column in [0, 2, 359] {
            turn_m[column] = 10.0;
        }
        let labels = label(1, &turn_m, 1, 9);
        assert_eq!([labels[0], labels[2], labels[359]], [2, 3, 2]);
    }

    #[test]
    fn what_does_not_count_connects() {
        assert_eq!(label(3, &[10.0, -10.0, 10.0], 2, 9), [2, 0, 2]);
        assert_eq!(label(3, &[10.0, -10.0, 10.0], 3, 9), [0; 3]);
        assert_eq!(
            label(3, &[-10.0, 0.0, 20.0], 0, 9),
            [0, 0, 2],
            "a segment has a point that counts"
        );
    }

    #[test]
    fn the_last_have_no_label_where_the_table_is_full() {
        assert_eq!(
            label(5, &[10.0, 0.0, 10.0, 0.0, 10.0], 1, 2),
            [2, 0, 3, 0, 0]
        );
    }

    /// An image turned over, of a sensor head down, has the same ground; of one on its side, none.
    #[test]
    fn head_down_the_ground_begins_at_the_first_row() {
        const ROWS: usize = 24;
        let mut rng = fastrand::Rng::with_seed(1);
        let mut range_m = Vec::new();
        for _ in 0..50 * ROWS {
            let row = range_m.len() % ROWS;
            // A floor 1.8 m below the lower rows, with steps and holes.
            let away_m = 1.8 / (0.02 * (row as f32 + 1.0)).sin();
            range_m.push([away_m, 0.98 * away_m, 0.0, 9.0][[0, 0, 0, 1, 2, 3][rng.usize(..6)]]);
        }
        let ground = |roll_rad: f32, is_turned: bool| {
            let shape = Shape {
                rows: ROWS,
                columns_capacity: 50,
                dual: false,
                segments_capacity: 9,
            };
            let mut buffer = HeapBuffers::default().take(shape.total_bytes());
            let sweep = SweepMut::create(buffer.as_mut(), &shape).unwrap();
            sweep.header.columns = 50;
            for (row, beam) in sweep.beams.iter_mut().enumerate() {
                let down = if is_turned { ROWS - 1 - row } else { row };
                let elevation_rad = -0.02 * (down as f64 + 1.0);
                let side = if is_turned { -1.0 } else { 1.0 };
                *beam = Beam::ideal(row, side * elevation_rad).row(0);
            }
            sweep.range.copy_from_slice(&range_m);
            if is_turned {
                sweep
                    .range
                    .chunks_exact_mut(ROWS)
                    .for_each(<[f32]>::reverse);
            }
            let mut config = Config::default();
            config.mount.roll_rad = roll_rad;
            let mut paper = PaperSegmenter::default();
            paper.begin(&sweep, &config);
            paper.find_ground(&config);
            if is_turned {
                paper
                    .labels
                    .chunks_exact_mut(ROWS)
                    .for_each(<[u32]>::reverse);
            }
            paper.labels
        };
        let upright = ground(0.0, false);
        let is_ground = upright.iter().filter(|&&label| label == LABEL_GROUND);
        assert!((200..1100).contains(&is_ground.count()));
        assert_eq!(ground(PI, true), upright);
        assert_ne!(ground(0.0, true), upright);
        assert_eq!(ground(FRAC_PI_2, false), [LABEL_NONE; 50 * ROWS]);
    }

    /// Three columns of four rows: the ground starts at the foot of the first, goes up, over the
    /// seam to the last column and down there to a hole, which it marks and does not leave. What is
    /// steeper by 0.2 stays, as does a steep foot.
    #[test]
    fn the_ground_floods_level_neighbours() {
        let range_m = [
            [0.0, 9.0, 9.0, 9.0],
            [9.0, 9.0, 9.0, 9.0],
            [9.0, 9.0, 0.0, 9.0],
        ]
        .concat();
        let inclination_rad = [
            [0.3, 0.1, 0.1, 0.1],
            [0.9, 0.9, 0.9, 0.9],
            [0.3, 0.1, 0.1, 0.8],
        ]
        .concat();
        let mut paper = PaperSegmenter {
            range_m,
            angles: Angles::even(&[0.02; 3], 3),
            labels: vec![LABEL_NONE; 12],
            ..PaperSegmenter::default()
        };
        paper.inclinations.plane_rad = inclination_rad;
        paper.label_ground(&PaperGround::default());
        let ground = paper.labels;
        assert_eq!(ground, [[0, 1, 1, 1], [0; 4], [0, 1, 1, 0]].concat());
    }
}
