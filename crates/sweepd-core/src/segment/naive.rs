//! The specification twin of the default method: the same labels, each written down as directly as
//! it can be said.
//!
//! Queues and `Vec`s of pixels; no words, no runs, no vectors. Nothing in the program calls it: the
//! tests and benches hold the fast path against it, on real and on random images.

use std::collections::{HashMap, VecDeque};

use super::points::{self, Placed};
use super::{Config, SlopeGround};
use crate::sweep::SweepRef;
use crate::sweep::layout::{LABEL_FIRST_SEGMENT, LABEL_GROUND, LABEL_NONE, flags};

/// Labels of a sweep, by pixel, at this height of the sensor.
pub fn segment(sweep: &SweepRef<'_>, config: &Config, height_m: Option<f32>) -> Vec<u32> {
    let pixels = points::placed(sweep, config);
    let circular = sweep.header.has(flags::CIRCULAR);
    let image = Image {
        rows: sweep.rows(),
        columns: sweep.columns.len(),
        circular,
        pixels: &pixels,
    };
    let climbed = match height_m {
        Some(height_m) => climb(&image, &config.slope, config.mount.up().axis(), height_m),
        None => vec![false; pixels.len()],
    };
    let ground = vote(&image, &climbed, &config.slope);
    let component = components(&image, &ground, config);
    let component = small_to_large(&image, component, config);
    number(&component, &ground, &pixels, config.min_points.max(1))
}

/// The image: what may be labelled, and which pixels are how far apart.
struct Image<'a> {
    rows: usize,
    columns: usize,
    circular: bool,
    pixels: &'a [Option<Placed>],
}

impl Image<'_> {
    /// The pixel this many rows below and columns behind another.
    fn beside(&self, pixel: usize, down: i64, on: i64) -> Option<usize> {
        let (row, column) = (
            (pixel % self.rows) as i64 + down,
            (pixel / self.rows) as i64 + on,
        );
        let column = if self.circular {
            column.rem_euclid(self.columns as i64)
        } else {
            column
        };
        let is_there =
            (0..self.rows as i64).contains(&row) && (0..self.columns as i64).contains(&column);
        is_there.then(|| column as usize * self.rows + row as usize)
    }
}

/// Of three neighbours on either side in the row whose range is alike, three that are ground make a
/// pixel ground; one at most of four or more unmakes it.
fn vote(image: &Image<'_>, climbed: &[bool], limits: &SlopeGround) -> Vec<bool> {
    let ballot = |pixel: usize, here: &Placed| {
        let voters = [-3, -2, -1, 1, 2, 3]
            .into_iter()
            .filter_map(|on| image.beside(pixel, 0, on));
        let like = voters.filter(|&other| {
            image.pixels[other]
                .is_some_and(|there| (here.range_m - there.range_m).abs() < limits.agree_m)
        });
        let votes: Vec<bool> = like.map(|other| climbed[other]).collect();
        let ayes = votes.iter().filter(|aye| **aye).count();
        match climbed[pixel] {
            true => ayes >= 2 || votes.len() < 4,
            false => ayes >= 3,
        }
    };
    image
        .pixels
        .iter()
        .enumerate()
        .map(|(pixel, here)| here.is_some_and(|here| ballot(pixel, &here)))
        .collect()
}

/// The square of the distance of two points, and whether the angle at the farther one, between its
/// beam and the line to the other, is greater than theta.
fn compare(a: &Placed, b: &Placed, theta_rad: f32) -> (f32, bool) {
    let [x, y, z] = [0, 1, 2].map(|axis| a.point_m[axis] - b.point_m[axis]);
    let apart2 = x * x + y * y + z * z;
    let (longer, shorter) = (a.far_m.max(b.far_m), a.far_m.min(b.far_m));
    let along = (longer - shorter) * (longer + shorter) + apart2;
    let cos2 = theta_rad.cos() * theta_rad.cos();
    (
        apart2,
        longer * longer * apart2 * (4.0 * cos2) > along * along,
    )
}

/// The pairs of pixels that the window holds: the second with the square of its distance, and
/// whether the test joins them.
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
        let other = image
            .beside(pixel, down, on)
            .filter(|&other| other != pixel && !ground[other])?;
        let (apart2, passes) = compare(&here, &image.pixels[other]?, config.theta_rad);
        Some((other, apart2, apart2 < gap_m * gap_m && passes))
    })
}

/// Breadth-first search over what the window joins; the first pixel of each pixel's component.
fn components(image: &Image<'_>, ground: &[bool], config: &Config) -> Vec<Option<usize>> {
    let mut component = vec![None; image.pixels.len()];
    for start in
        (0..image.pixels.len()).filter(|&pixel| image.pixels[pixel].is_some() && !ground[pixel])
    {
        if component[start].is_some() {
            continue;
        }
        component[start] = Some(start);
        let mut queue = VecDeque::from([start]);
        while let Some(here) = queue.pop_front() {
            for (there, _, _) in
                window(image, ground, config, here).filter(|(_, _, joined)| *joined)
            {
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
fn small_to_large(
    image: &Image<'_>,
    component: Vec<Option<usize>>,
    config: &Config,
) -> Vec<Option<usize>> {
    let joining = &config.joining;
    if joining.small_points <= 1 {
        return component;
    }
    let mut points: HashMap<usize, u32> = HashMap::new();
    component
        .iter()
        .flatten()
        .for_each(|first| *points.entry(*first).or_default() += 1);
    let is_small = |first: usize| points[&first] < joining.small_points;
    let near_m = joining.gap_m(image.rows) + joining.small_reach_m;
    let in_none: Vec<bool> = component.iter().map(Option::is_none).collect();
    let mut nearest: HashMap<usize, (f32, usize)> = HashMap::new();
    for (pixel, small) in component.iter().enumerate() {
        let Some(small) = small.filter(|&first| is_small(first)) else {
            continue;
        };
        for (other, apart2, _) in window(image, &in_none, config, pixel) {
            let Some(large) = component[other].filter(|&first| !is_small(first)) else {
                continue;
            };
            let best = nearest.entry(small).or_insert((f32::INFINITY, usize::MAX));
            if apart2 < near_m * near_m && (apart2, large) < *best {
                *best = (apart2, large);
            }
        }
    }
    let found = |first: usize| {
        nearest
            .get(&first)
            .filter(|(apart2, _)| apart2.is_finite())
            .map_or(first, |best| best.1)
    };
    component
        .into_iter()
        .map(|first| first.map(found))
        .collect()
}

/// Numbers the components that are large enough by their first pixels in memory.
fn number(
    component: &[Option<usize>],
    ground: &[bool],
    pixels: &[Option<Placed>],
    min_points: u32,
) -> Vec<u32> {
    let mut points: HashMap<usize, u32> = HashMap::new();
    component
        .iter()
        .flatten()
        .for_each(|first| *points.entry(*first).or_default() += 1);
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
            let Some(Placed {
                point_m: [x, y, z],
                far_m,
                ..
            }) = image.pixels[index]
            else {
                continue;
            };
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
            let highest = slope_rise
                .min(limits.max_rise_m(image.rows))
                .max(limits.min_rise_m);
            let walkable = rise < highest && -rise < slope_rise.abs().max(limits.min_rise_m);

            let (step_run, step_rise) = (away - foot.0, high - foot.1);
            let near = step_run * step_run + step_rise * step_rise
                < limits.step_reach_m * limits.step_reach_m;
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
