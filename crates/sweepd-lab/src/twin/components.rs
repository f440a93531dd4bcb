//! What is joined makes components. Small ones become part of others, and what is large enough then
//! is numbered.
//!
//! A component is known by its first pixel.

use std::collections::VecDeque;

use sweepd_core::segment::Config;
use sweepd_core::sweep::layout::LABEL_FIRST_SEGMENT;
use sweepd_core::sweep::{BeamRow, SweepRef};

use super::nearness::Nearness;
use super::steps;
use super::windows::Windows;

/// Parts of a rad²: the solid angle of a pixel is a whole number of them.
const SOLID_ANGLE: f64 = 16_777_216.0;

/// The label of each pixel that is part of a segment.
pub(super) fn number(
    nearness: &Nearness<'_>,
    sweep: &SweepRef<'_>,
    config: &Config,
) -> Vec<Option<u32>> {
    let windows = Windows::new(nearness);
    let mut component = components(nearness, &joined(nearness, &windows));
    join_small(nearness, &windows, sweep, config, &mut component);
    let points = points(&component);
    let mut labels = vec![None; component.len()];
    let mut label_of = vec![None; component.len()];
    let mut next = LABEL_FIRST_SEGMENT;
    for pixel in 0..component.len() {
        let Some(first) = component[pixel] else {
            continue;
        };
        if points[first] < config.min_points.max(1) {
            continue;
        }
        if label_of[first].is_none() {
            label_of[first] = Some(next);
            next += 1;
        }
        labels[pixel] = label_of[first];
    }
    labels
}

/// What each pixel is joined to, both ways.
fn joined(nearness: &Nearness<'_>, windows: &Windows<'_>) -> Vec<Vec<usize>> {
    let mut joined = vec![Vec::new(); nearness.is_on.len()];
    for pixel in 0..joined.len() {
        let mut places = windows.of(pixel);
        places.push([0, -1]);
        for &rows in nearness.above {
            places.push([-rows, 0]);
        }
        for [down, right] in places {
            if let Some(other) = nearness.joins(pixel, down, right) {
                joined[pixel].push(other);
                joined[other].push(pixel);
            }
        }
    }
    joined
}

/// Breadth-first search over what is joined: the component of each pixel that is no ground.
fn components(nearness: &Nearness<'_>, joined: &[Vec<usize>]) -> Vec<Option<usize>> {
    let mut component = vec![None; joined.len()];
    for first in 0..joined.len() {
        if !nearness.is_on[first] || component[first].is_some() {
            continue;
        }
        component[first] = Some(first);
        let mut queue = VecDeque::from([first]);
        while let Some(here) = queue.pop_front() {
            for &there in &joined[here] {
                if component[there].is_none() {
                    component[there] = Some(first);
                    queue.push_back(there);
                }
            }
        }
    }
    component
}

/// Makes each small component part of the nearest that is not, if one is near enough to where its
/// runs begin and end.
fn join_small(
    nearness: &Nearness<'_>,
    windows: &Windows<'_>,
    sweep: &SweepRef<'_>,
    config: &Config,
    component: &mut [Option<usize>],
) {
    let is_small = small(nearness, sweep, config, component);
    // By component: how far apart, squared, and which.
    let mut nearest = vec![(f32::INFINITY, usize::MAX); component.len()];
    for pixel in 0..component.len() {
        let Some(first) = component[pixel].filter(|&first| is_small[first]) else {
            continue;
        };
        for [down, right] in windows.of(pixel) {
            let reach_m = config.joining.small_reach_m;
            let Some(other) = nearness.near(pixel, down, right, reach_m) else {
                continue;
            };
            let Some(large) = component[other].filter(|&large| !is_small[large]) else {
                continue;
            };
            let found = (nearness.apart2(pixel, other, right), large);
            // Of two that are as near, the one whose first pixel comes first.
            if found < nearest[first] {
                nearest[first] = found;
            }
        }
    }
    for first in component.iter_mut().flatten() {
        let (_, large) = nearest[*first];
        if large != usize::MAX {
            *first = large;
        }
    }
}

/// Which components are small, by their first pixels.
fn small(
    nearness: &Nearness<'_>,
    sweep: &SweepRef<'_>,
    config: &Config,
    component: &[Option<usize>],
) -> Vec<bool> {
    let points = points(component);
    let solid_angles = solid_angles(sweep.beams, nearness.pitch_rad);
    let mut areas = vec![0; component.len()];
    for (pixel, first) in component.iter().enumerate() {
        if let (Some(first), Some(found)) = (first, nearness.image.returns[pixel]) {
            let range = steps::range(found.range_m) as u128;
            areas[*first] += range * range * solid_angles[nearness.image.row(pixel)];
        }
    }
    let square_metre = f64::from(steps::DISTANCE * steps::DISTANCE) * SOLID_ANGLE;
    let least = (f64::from(config.joining.small_area_m2) * square_metre) as u128;
    let mut is_small = Vec::new();
    for first in 0..component.len() {
        is_small.push(points[first] < config.joining.small_points || areas[first] < least);
    }
    is_small
}

/// How many points each component has.
fn points(component: &[Option<usize>]) -> Vec<u32> {
    let mut points = vec![0; component.len()];
    for first in component.iter().flatten() {
        points[*first] += 1;
    }
    points
}

/// The angle between columns times that between rows, row by row: half way to the row above and to
/// the one below.
fn solid_angles(beams: &[BeamRow], pitch_rad: f32) -> Vec<u128> {
    let mut solid_angles = Vec::new();
    for row in 0..beams.len() {
        // The first and the last row have but one beside them.
        let above = row.saturating_sub(1);
        let below = (row + 1).min(beams.len() - 1);
        let rows = (below - above).max(1);
        let apart_rad =
            f64::from(beams[above].elevation_rad) - f64::from(beams[below].elevation_rad);
        let height_rad = apart_rad.abs() / rows as f64;
        solid_angles.push((height_rad * f64::from(pitch_rad) * SOLID_ANGLE) as u128);
    }
    solid_angles
}
