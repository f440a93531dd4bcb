//! What everybody writes first: breadth-first search over the four neighbours of an image without
//! ground, by the paper's test without its arctangent.

use sweepd::segment::Config;
use sweepd::sweep::SweepRef;
use sweepd::sweep::layout::{LABEL_FIRST_SEGMENT, LABEL_GROUND, LABEL_NONE, is_return};

/// In a component that is too small.
const SMALL: u32 = u32::MAX;

pub struct Plain {
    rows: usize,
    columns: usize,
    range_m: Vec<f32>,
    /// Of each row with the one below and with itself, in the next column: beta > theta where `d2 *
    /// factor > d1`.
    down: Vec<f32>,
    across: Vec<f32>,
    min_points: usize,
    labels: Vec<u32>,
    queue: Vec<usize>,
}

impl Plain {
    /// Of a sweep that is labelled: its ground is taken away.
    pub fn new(sweep: &SweepRef<'_>, config: &Config) -> Self {
        let (rows, columns) = (sweep.rows(), sweep.columns.len());
        let without_ground =
            |(&range, &label): (&f32, &u32)| if label == LABEL_GROUND { 0.0 } else { range };
        let range_m: Vec<f32> = sweep
            .range
            .iter()
            .zip(sweep.label)
            .map(without_ground)
            .take(rows * columns)
            .collect();
        let factor = |alpha_rad: f32| (alpha_rad.sin() / config.theta_rad.tan()) + alpha_rad.cos();
        let elevations: Vec<f32> = sweep.beams.iter().map(|beam| beam.elevation_rad).collect();
        let pitch = std::f32::consts::TAU / columns as f32;
        Self {
            rows,
            columns,
            down: elevations
                .windows(2)
                .map(|pair| factor((pair[0] - pair[1]).abs()))
                .collect(),
            across: elevations
                .iter()
                .map(|elevation| factor(pitch * elevation.cos()))
                .collect(),
            min_points: config.min_points as usize,
            labels: vec![LABEL_NONE; range_m.len()],
            queue: Vec::with_capacity(range_m.len()),
            range_m,
        }
    }

    /// Labels the image, and gives how many segments there are.
    pub fn label(&mut self) -> u32 {
        self.labels.fill(LABEL_NONE);
        let mut next = LABEL_FIRST_SEGMENT;
        for start in 0..self.range_m.len() {
            if self.labels[start] == LABEL_NONE && is_return(self.range_m[start]) {
                self.spread(start, next);
                next += u32::from(self.labels[start] == next);
            }
        }
        self.labels
            .iter_mut()
            .filter(|label| **label == SMALL)
            .for_each(|label| *label = LABEL_NONE);
        next - LABEL_FIRST_SEGMENT
    }

    fn spread(&mut self, start: usize, label: u32) {
        self.queue.clear();
        self.reach(start, label);
        let mut at = 0;
        while let Some(&here) = self.queue.get(at) {
            at += 1;
            let (row, column) = (here % self.rows, here / self.rows);
            let before = (if column == 0 { self.columns } else { column } - 1) * self.rows + row;
            let behind = (if column + 1 == self.columns {
                0
            } else {
                column + 1
            }) * self.rows
                + row;
            let up = (row > 0).then(|| (here - 1, self.down[row - 1]));
            let down = (row + 1 < self.rows).then(|| (here + 1, self.down[row]));
            let beside = [
                Some((before, self.across[row])),
                Some((behind, self.across[row])),
            ];
            for (there, factor) in [up, down].into_iter().chain(beside).flatten() {
                let (a, b) = (self.range_m[here], self.range_m[there]);
                if self.labels[there] == LABEL_NONE && a.min(b) * factor > a.max(b) {
                    self.reach(there, label);
                }
            }
        }
        if self.queue.len() < self.min_points {
            self.queue
                .iter()
                .for_each(|&pixel| self.labels[pixel] = SMALL);
        }
    }

    fn reach(&mut self, pixel: usize, label: u32) {
        self.labels[pixel] = label;
        self.queue.push(pixel);
    }
}
