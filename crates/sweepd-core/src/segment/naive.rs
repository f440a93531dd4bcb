//! The specification twin: the same labels, each written down as directly as it can be said.
//!
//! Arctangents, queues and `Vec`s of pixels; no words, no runs, no tables of sines. Nothing in the program calls it: the
//! tests and benches hold the fast path against it, on real and on random images.

use std::collections::{HashMap, VecDeque};

use super::paper::angles::{Angles, Parallax};
use super::paper::ground::steepness_rad;
use super::points::{self, Placed};
use super::{Config, Limits, Method, PaperGround, SlopeGround, Window};
use crate::sweep::SweepRef;
use crate::sweep::layout::{LABEL_FIRST_SEGMENT, LABEL_GROUND, LABEL_NONE, flags, is_return};

/// Labels of a sweep, by pixel. With [`Method::Slope`] the height of the sensor has to be told.
pub fn segment(sweep: &SweepRef<'_>, config: &Config, height_m: Option<f32>) -> Vec<u32> {
    match config.method {
        Method::Slope => by_slope(sweep, config, height_m),
        Method::Paper => as_the_paper_has_it(sweep, config),
    }
}

fn as_the_paper_has_it(sweep: &SweepRef<'_>, config: &Config) -> Vec<u32> {
    let mut angles = Angles::default();
    angles.measure(sweep);
    let real = working_ranges(sweep, config);
    let mut range_m = real.clone();
    let elevations_rad: Vec<f32> = sweep.beams.iter().map(|beam| beam.elevation_rad).collect();
    let ground = paper_ground(&mut range_m, &elevations_rad, &angles, &config.paper);
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

/// The image of the default method: what may be labelled, and which pixels are how far apart.
struct Image<'a> {
    rows: usize,
    columns: usize,
    circular: bool,
    pixels: &'a [Option<Placed>],
}

impl Image<'_> {
    /// The pixel so many rows below and columns behind another.
    fn beside(&self, pixel: usize, down: i64, on: i64) -> Option<usize> {
        let (row, column) = ((pixel % self.rows) as i64 + down, (pixel / self.rows) as i64 + on);
        let column = if self.circular { column.rem_euclid(self.columns as i64) } else { column };
        let is_there = (0..self.rows as i64).contains(&row) && (0..self.columns as i64).contains(&column);
        is_there.then(|| column as usize * self.rows + row as usize)
    }
}

fn by_slope(sweep: &SweepRef<'_>, config: &Config, height_m: Option<f32>) -> Vec<u32> {
    let pixels = points::placed(sweep, config);
    let circular = sweep.header.has(flags::CIRCULAR);
    let image = Image { rows: sweep.rows(), columns: sweep.columns.len(), circular, pixels: &pixels };
    let climbed = match height_m {
        Some(height_m) => climb(&image, &config.slope, config.mount.up().axis(), height_m),
        None => vec![false; pixels.len()],
    };
    let ground = vote(&image, &climbed, &config.slope);
    let component = components(&image, &ground, config);
    let component = small_to_large(&image, component, config);
    number(&component, &ground, &pixels, config.min_points.max(1))
}

/// Of three neighbours on either side in the row whose range is alike, three that are ground make a pixel ground; one at most
/// of four or more unmakes it.
fn vote(image: &Image<'_>, climbed: &[bool], limits: &SlopeGround) -> Vec<bool> {
    let ballot = |pixel: usize, here: &Placed| {
        let voters = [-3, -2, -1, 1, 2, 3].into_iter().filter_map(|on| image.beside(pixel, 0, on));
        let like = voters.filter(|&other| {
            image.pixels[other].is_some_and(|there| (here.range_m - there.range_m).abs() < limits.agree_m)
        });
        let votes: Vec<bool> = like.map(|other| climbed[other]).collect();
        let ayes = votes.iter().filter(|aye| **aye).count();
        match climbed[pixel] {
            true => ayes >= 2 || votes.len() < 4,
            false => ayes >= 3,
        }
    };
    image.pixels.iter().enumerate().map(|(pixel, here)| here.is_some_and(|here| ballot(pixel, &here))).collect()
}

/// The square of the distance of two points, and whether the angle at the farther one, between its beam and the line to the
/// other, is greater than theta.
fn compare(a: &Placed, b: &Placed, theta_rad: f32) -> (f32, bool) {
    let [x, y, z] = [0, 1, 2].map(|axis| a.point_m[axis] - b.point_m[axis]);
    let apart2 = x * x + y * y + z * z;
    let (longer, shorter) = (a.far_m.max(b.far_m), a.far_m.min(b.far_m));
    let along = (longer - shorter) * (longer + shorter) + apart2;
    let cos2 = theta_rad.cos() * theta_rad.cos();
    (apart2, longer * longer * apart2 * (4.0 * cos2) > along * along)
}

/// The pairs of pixels that the window holds: the second with the square of its distance, and whether the test joins them.
fn window<'a>(
    image: &'a Image<'_>,
    ground: &'a [bool],
    config: &'a Config,
    pixel: usize,
) -> impl Iterator<Item = (usize, f32, bool)> + 'a {
    let (wide, high) = (config.joining.columns as i64, config.joining.rows as i64);
    let gap_m = config.joining.gap_m(image.rows);
    let around = (-wide..=wide).flat_map(move |on| (-high..=high).map(move |down| (down, on)));
    around.filter_map(move |(down, on)| {
        let here = image.pixels[pixel]?;
        let other = image.beside(pixel, down, on).filter(|&other| other != pixel && !ground[other])?;
        let (apart2, passes) = compare(&here, &image.pixels[other]?, config.theta_rad);
        Some((other, apart2, apart2 < gap_m * gap_m && passes))
    })
}

/// Breadth-first search over what the window joins; the first pixel of each pixel's component.
fn components(image: &Image<'_>, ground: &[bool], config: &Config) -> Vec<Option<usize>> {
    let mut component = vec![None; image.pixels.len()];
    for start in (0..image.pixels.len()).filter(|&pixel| image.pixels[pixel].is_some() && !ground[pixel]) {
        if component[start].is_some() {
            continue;
        }
        component[start] = Some(start);
        let mut queue = VecDeque::from([start]);
        while let Some(here) = queue.pop_front() {
            for (there, _, _) in window(image, ground, config, here).filter(|(_, _, joined)| *joined) {
                if component[there].is_none() {
                    component[there] = Some(start);
                    queue.push_back(there);
                }
            }
        }
    }
    component
}

/// Gives each small component to the large one that is nearest, if one is near enough.
fn small_to_large(image: &Image<'_>, component: Vec<Option<usize>>, config: &Config) -> Vec<Option<usize>> {
    let joining = &config.joining;
    if joining.small_points <= 1 {
        return component;
    }
    let mut points: HashMap<usize, u32> = HashMap::new();
    component.iter().flatten().for_each(|first| *points.entry(*first).or_default() += 1);
    let is_small = |first: usize| points[&first] < joining.small_points;
    let near_m = joining.gap_m(image.rows) + joining.small_reach_m;
    let in_none: Vec<bool> = component.iter().map(Option::is_none).collect();
    let mut nearest: HashMap<usize, (f32, usize)> = HashMap::new();
    for (pixel, small) in component.iter().enumerate() {
        let Some(small) = small.filter(|&first| is_small(first)) else { continue };
        for (other, apart2, _) in window(image, &in_none, config, pixel) {
            let Some(large) = component[other].filter(|&first| !is_small(first)) else { continue };
            let best = nearest.entry(small).or_insert((f32::INFINITY, usize::MAX));
            if apart2 < near_m * near_m && (apart2, large) < *best {
                *best = (apart2, large);
            }
        }
    }
    let found =
        |first: usize| nearest.get(&first).filter(|(apart2, _)| apart2.is_finite()).map_or(first, |best| best.1);
    component.into_iter().map(|first| first.map(found)).collect()
}

/// Numbers the components that are large enough by their first pixels in memory.
fn number(component: &[Option<usize>], ground: &[bool], pixels: &[Option<Placed>], min_points: u32) -> Vec<u32> {
    let mut points: HashMap<usize, u32> = HashMap::new();
    component.iter().flatten().for_each(|first| *points.entry(*first).or_default() += 1);
    let mut number: HashMap<usize, u32> = HashMap::new();
    let label = |pixel: usize| match component[pixel] {
        _ if pixels[pixel].is_none() => LABEL_NONE,
        _ if ground[pixel] => LABEL_GROUND,
        Some(first) if points[&first] >= min_points => {
            let next = LABEL_FIRST_SEGMENT + number.len() as u32;
            *number.entry(first).or_insert(next)
        }
        _ => LABEL_NONE,
    };
    (0..component.len()).map(label).collect()
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

/// Ground by the climb of each column: see [`SlopeGround`].
fn climb(image: &Image<'_>, limits: &SlopeGround, up: [f32; 3], height_m: f32) -> Vec<bool> {
    let mut ground = vec![false; image.pixels.len()];
    for column in 0..image.columns {
        let mut foothold = (0.0, -height_m);
        let mut foot = foothold;
        let mut face: Vec<usize> = Vec::new();
        let mut edge: Option<(f32, f32)> = None;
        for row in (0..image.rows).rev() {
            let index = column * image.rows + row;
            let Some(Placed { point_m: [x, y, z], far_m, .. }) = image.pixels[index] else { continue };
            let high = x * up[0] + y * up[1] + z * up[2];
            let away = (far_m * far_m - high * high).max(0.0).sqrt();

            if let Some(top) = edge.take()
                && (high - top.1).abs() < limits.max_slope * (away - top.0)
            {
                face.drain(..).for_each(|index| ground[index] = true);
                foothold = top;
            }

            let (run, rise) = (away - foothold.0, high - foothold.1);
            let slope_rise = run * limits.max_slope;
            let highest = slope_rise.min(limits.max_rise_m(image.rows)).max(limits.min_rise_m);
            let walkable = rise < highest && -rise < slope_rise.abs().max(limits.min_rise_m);

            let (step_run, step_rise) = (away - foot.0, high - foot.1);
            let near = step_run * step_run + step_rise * step_rise < limits.step_reach_m * limits.step_reach_m;
            let steep = near && step_rise > step_run.abs();

            let here = (away, high);
            if walkable && !(steep && step_rise > limits.max_step_m) {
                ground[index] = true;
                foothold = here;
                face.clear();
            } else if rise > 0.0 && rise <= limits.max_kerb_m && run > -limits.max_step_m {
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
        _ => steepness_rad((z(index) - z(index - 1)).abs(), (x(index) - x(index - 1)).abs()),
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
