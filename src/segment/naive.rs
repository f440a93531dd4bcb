//! The specification twin: the same labels, each written down as directly as it can be said.
//!
//! Arctangents, queues and `Vec`s of pixels; no words, no runs, no tables of sines. Nothing in the program calls it: the
//! tests and benches hold the fast path against it, on real and on random images.

use std::collections::VecDeque;

use super::angles::{Angles, Parallax};
use super::mount::Mount;
use super::{Config, Limits, Method, PaperGround, SlopeGround, Window};
use crate::sweep::SweepRef;
use crate::sweep::layout::{LABEL_FIRST_SEGMENT, LABEL_GROUND, LABEL_NONE, is_return};

/// Labels of a sweep, by pixel. With [`Method::Slope`] the height of the sensor has to be told.
pub fn segment(sweep: &SweepRef<'_>, config: &Config, height_m: Option<f32>) -> Vec<u32> {
    let mut angles = Angles::default();
    angles.measure(sweep);
    let real = working_ranges(sweep, config);
    let mut range_m = real.clone();
    let ground = match (config.method, height_m) {
        (Method::Slope, None) => vec![false; real.len()],
        (Method::Slope, Some(height_m)) => slope_ground(sweep, &real, &config.slope, &config.mount, height_m),
        (Method::Paper, _) => {
            let elevations_rad: Vec<f32> = sweep.beams.iter().map(|beam| beam.elevation_rad).collect();
            paper_ground(&mut range_m, &elevations_rad, &angles, &config.paper)
        }
    };
    for (range_m, _) in range_m.iter_mut().zip(&ground).filter(|(_, ground)| **ground) {
        *range_m = 0.0;
    }
    let limits = Limits { min_points: config.min_points, max_segments: usize::MAX };
    let mut labels = connect(&range_m, &real, &angles, f64::from(config.theta_rad), limits);
    for index in (0..labels.len()).filter(|&index| ground[index] && is_return(real[index])) {
        labels[index] = LABEL_GROUND;
    }
    labels
}

/// The ranges that may be labelled; 0 elsewhere.
fn working_ranges(sweep: &SweepRef<'_>, config: &Config) -> Vec<f32> {
    let mut range_m = vec![0.0; sweep.range.len()];
    for (index, &range) in sweep.range.iter().enumerate() {
        let (row, column) = (index % sweep.rows(), index / sweep.rows());
        let masked = config.mask.as_ref().is_some_and(|mask| mask.hides(row, sweep.azimuth_rad(row, column)));
        if is_return(range) && (config.min_range_m..=config.max_range_m).contains(&range) && !masked {
            range_m[index] = range;
        }
    }
    range_m
}

/// The angle between the longer of two beams and the line through the two measurements (paper, equation 1).
pub fn beta_rad(d1: f32, d2: f32, alpha_rad: f64) -> f64 {
    let (longer, shorter) = (f64::from(d1.max(d2)), f64::from(d1.min(d2)));
    (shorter * alpha_rad.sin()).atan2(longer - shorter * alpha_rad.cos())
}

/// The same for a pixel and the one below it, whose beams start at different places.
fn beta_apart_rad(range_m: &[f32], upper: usize, parallax: &Parallax) -> f64 {
    let ([high, low], across_m) = parallax.apply(f64::from(range_m[upper]), f64::from(range_m[upper + 1]));
    across_m.atan2(high.max(low) - high.min(low) * parallax.cos_alpha)
}

/// Breadth-first search over neighbours whose beta is greater than theta (paper, algorithm 1); then the small components
/// are dropped and the others numbered by their first pixel in memory. Only pixels with a range in `real` count and are
/// labelled.
pub fn connect(range_m: &[f32], real: &[f32], angles: &Angles, theta_rad: f64, limits: Limits) -> Vec<u32> {
    let mut labels = vec![LABEL_NONE; range_m.len()];
    let mut seen = vec![false; range_m.len()];
    let mut next = LABEL_FIRST_SEGMENT;
    for start in 0..range_m.len() {
        if seen[start] || !is_return(range_m[start]) {
            continue;
        }
        seen[start] = true;
        let mut component = vec![start];
        let mut queue = VecDeque::from([start]);
        while let Some(here) = queue.pop_front() {
            for (there, alpha_rad) in neighbours(here, angles) {
                let beta_rad = match angles.parallax().filter(|_| here.abs_diff(there) == 1) {
                    Some(parallax) => {
                        beta_apart_rad(range_m, here.min(there), &parallax[here.min(there) % angles.rows()])
                    }
                    None => beta_rad(range_m[here], range_m[there], alpha_rad),
                };
                let joined = is_return(range_m[there]) && beta_rad > theta_rad;
                if joined && !seen[there] {
                    seen[there] = true;
                    component.push(there);
                    queue.push_back(there);
                }
            }
        }
        component.retain(|&pixel| is_return(real[pixel]));
        let room = ((next - LABEL_FIRST_SEGMENT) as usize) < limits.max_segments;
        if component.len() >= limits.min_points as usize && room {
            component.iter().for_each(|&pixel| labels[pixel] = next);
            next += 1;
        }
    }
    labels
}

/// The up to four neighbours of a pixel and the angles to them.
fn neighbours(pixel: usize, angles: &Angles) -> Vec<(usize, f64)> {
    let (rows, columns) = (angles.rows(), angles.columns());
    let (row, column) = (pixel % rows, pixel / rows);
    let after = (column + 1) % columns;
    let mut found = Vec::new();
    if row > 0 {
        found.push((pixel - 1, angles.down_rad(row - 1)));
    }
    if row + 1 < rows {
        found.push((pixel + 1, angles.down_rad(row)));
    }
    if let Some(alpha_rad) = angles.across_rad(row, column) {
        found.push(((column + columns - 1) % columns * rows + row, alpha_rad));
    }
    if let Some(alpha_rad) = angles.across_rad(row, after) {
        found.push((after * rows + row, alpha_rad));
    }
    found
}

/// Ground by slope: see [`SlopeGround`].
pub fn slope_ground(
    sweep: &SweepRef<'_>,
    range_m: &[f32],
    limits: &SlopeGround,
    mount: &Mount,
    height_m: f32,
) -> Vec<bool> {
    let mut ground = vec![false; range_m.len()];
    let up = mount.up();
    for column in 0..sweep.columns.len() {
        let mut foothold = (0.0, -f64::from(height_m));
        let mut foot = foothold;
        let mut face: Vec<usize> = Vec::new();
        let mut edge: Option<(f64, f64)> = None;
        for row in (0..sweep.rows()).rev() {
            let index = column * sweep.rows() + row;
            if !is_return(range_m[index]) {
                continue;
            }
            let [x, y, z] = straight_point_m(sweep, row, column, range_m[index]);
            let high = up.height_m([x, y, z]);
            let away = (x * x + y * y + z * z - high * high).max(0.0).sqrt();

            if let Some(top) = edge.take()
                && (high - top.1).abs() < f64::from(limits.max_slope) * (away - top.0)
            {
                face.drain(..).for_each(|index| ground[index] = true);
                foothold = top;
            }

            let (run, rise) = (away - foothold.0, high - foothold.1);
            let slope_rise = f64::from(limits.max_slope) * run;
            let noise = f64::from(limits.min_rise_m);
            let highest = slope_rise.min(f64::from(limits.max_rise_m)).max(noise);
            let walkable = rise < highest && -rise < slope_rise.abs().max(noise);

            let (step_run, step_rise) = (away - foot.0, high - foot.1);
            let near = step_run.powi(2) + step_rise.powi(2) < f64::from(limits.step_reach_m).powi(2);
            let steep = near && step_rise > step_run.abs();

            let here = (away, high);
            if walkable && !(steep && step_rise > f64::from(limits.max_step_m)) {
                ground[index] = true;
                foothold = here;
                face.clear();
            } else if rise > 0.0 && rise <= f64::from(limits.max_kerb_m) && run > -f64::from(limits.max_step_m) {
                face.push(index);
                edge = Some(here);
            } else {
                face.clear();
            }
            if !steep {
                foot = here;
            }
        }
    }
    ground
}

/// Where a pixel's return is if its beam is a straight line.
fn straight_point_m(sweep: &SweepRef<'_>, row: usize, column: usize, range_m: f32) -> [f64; 3] {
    let beam = &sweep.beams[row];
    let (azimuth_rad, elevation_rad) = (sweep.azimuth_rad(row, column), f64::from(beam.elevation_rad));
    let (out_m, aside_m) = (f64::from(range_m) * elevation_rad.cos(), f64::from(beam.horizontal_offset_m));
    [
        out_m * azimuth_rad.sin() - aside_m * azimuth_rad.cos(),
        out_m * azimuth_rad.cos() + aside_m * azimuth_rad.sin(),
        f64::from(range_m) * elevation_rad.sin() + f64::from(beam.vertical_offset_m),
    ]
}

/// Ground as the paper's authors find it; repairs the ranges. Holes that the ground reaches are marked as well.
pub fn paper_ground(range_m: &mut [f32], elevations_rad: &[f32], angles: &Angles, limits: &PaperGround) -> Vec<bool> {
    let (rows, columns) = (angles.rows(), angles.columns());
    repair(range_m, rows, limits);
    let inclination_rad = smoothed(&inclinations(range_m, elevations_rad), rows, limits.window);
    let mut ground = vec![false; range_m.len()];
    for column in 0..columns {
        let lowest = (0..rows).rev().find(|row| is_return(range_m[column * rows + row])).unwrap_or(0);
        let start = column * rows + lowest;
        if ground[start] || inclination_rad[start] > limits.start_angle_rad {
            continue;
        }
        ground[start] = true;
        let mut queue = VecDeque::from([start]);
        while let Some(here) = queue.pop_front() {
            if !is_return(range_m[here]) {
                continue;
            }
            for (there, _) in neighbours(here, angles) {
                if !ground[there] && (inclination_rad[here] - inclination_rad[there]).abs() < limits.angle_rad {
                    ground[there] = true;
                    queue.push_back(there);
                }
            }
        }
    }
    ground
}

fn repair(range_m: &mut [f32], rows: usize, limits: &PaperGround) {
    for index in 0..range_m.len() {
        if is_return(range_m[index]) {
            continue;
        }
        let (row, mut sum, mut count) = (index % rows, 0.0, 0);
        for up in 1..=limits.repair_reach {
            for down in 1..=limits.repair_reach {
                if up > row || row + down >= rows {
                    continue;
                }
                let (above, below) = (range_m[index - up], range_m[index + down]);
                if is_return(above) && is_return(below) && (above - below).abs() < limits.repair_jump_m {
                    sum += above + below;
                    count += 2;
                }
            }
        }
        if count > 0 {
            range_m[index] = sum / count as f32;
        }
    }
}

fn inclinations(range_m: &[f32], elevations_rad: &[f32]) -> Vec<f32> {
    let rows = elevations_rad.len();
    let x = |index: usize| range_m[index] * elevations_rad[index % rows].cos();
    let z = |index: usize| range_m[index] * elevations_rad[index % rows].sin();
    let inclination = |index: usize| match index % rows {
        0 => 0.0,
        _ => (z(index) - z(index - 1)).abs().atan2((x(index) - x(index - 1)).abs()),
    };
    (0..range_m.len()).map(inclination).collect()
}

fn smoothed(plane: &[f32], rows: usize, window: Window) -> Vec<f32> {
    let (weights, divisor) = window.weights();
    let last = rows.saturating_sub(1);
    let at = |column: usize, row: isize| {
        // A ball between two walls: the column is mirrored at both ends as often as it takes.
        let turned = row.unsigned_abs() % (2 * last).max(1);
        plane[column * rows + if turned > last { 2 * last - turned } else { turned }]
    };
    let value = |index: usize| {
        let (row, column) = ((index % rows) as isize, index / rows);
        let mut sum = weights[0] / divisor * plane[index];
        for (distance, weight) in (1..).zip(&weights[1..]) {
            sum += weight / divisor * (at(column, row - distance) + at(column, row + distance));
        }
        sum
    };
    (0..plane.len()).map(value).collect()
}
