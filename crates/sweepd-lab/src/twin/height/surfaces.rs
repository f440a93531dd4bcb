//! Planes that many pairs lie on, the best first.

use std::collections::HashSet;

use nalgebra::Vector3;

use super::plane::{DEPTHS_M, Fit, LEVEL, Plane, fit};
use super::points::{Column, Pair, Point};

/// Candidates, and surfaces, need so many pairs or columns.
pub(super) const FEW: usize = 10;
const SURFACES: usize = 3;
/// Bins of depths, each so many times as deep as the one before.
const BINS: usize = 76;
const DEEPER: f64 = 1.06;
/// Planes that are drawn.
const DRAWN: usize = 200;
/// Least area between a pair and an end of another, m².
const AREA_M2: f64 = 0.05;
/// About so many pairs are tried.
const TRIED: usize = 1024;
/// Planes that are refined, and the bands for it.
const REFINED: usize = 6;
const BANDS: [f64; 5] = [1.5, 1.2, 1.0, 0.8, 0.65];
pub(super) const CLOSE: f64 = 0.5;
const REMOVED: f64 = 2.0;
/// Greatest standard error of a tilt, radians.
const ERROR_RAD: f64 = 0.017_453;
/// Planes that differ by less are one: a share of the height, and radians.
const SAME: f64 = 0.01;
const SAME_RAD: f64 = 0.005;

/// A plane that may be a surface.
#[derive(Clone, Copy)]
pub(super) struct Candidate {
    pub plane: Plane,
    pub is_level: bool,
    /// Pairs that lie on it, as far as they are tried, by the columns that have one.
    pub backing: usize,
}

/// A plane, and the columns that see it.
pub(super) struct Surface {
    pub plane: Plane,
    pub error_rad: f64,
    /// Columns of the grid with a pair on it.
    pub columns: HashSet<usize>,
    /// Others that see something below it.
    pub below: usize,
    /// Pairs on it.
    pub pairs: Vec<Pair>,
}

impl Surface {
    /// Surface on a plane, if enough of it is seen.
    pub fn of(columns: &[Column], pairs: &[Pair], fit: &Fit) -> Option<Self> {
        let plane = fit.plane;
        let on: Vec<Pair> = pairs
            .iter()
            .filter(|pair| plane.has(pair, CLOSE))
            .copied()
            .collect();
        let own: HashSet<usize> = on.iter().map(|pair| pair.column).collect();
        let below = (0..columns.len())
            .filter(|column| !own.contains(column) && plane.sees_below(&columns[*column]));
        (own.len() >= FEW).then_some(Self {
            plane,
            error_rad: fit.error_rad,
            below: below.count(),
            columns: own,
            pairs: on,
        })
    }

    pub fn value(&self) -> i64 {
        self.columns.len() as i64 - 2 * self.below as i64
    }
}

/// Surfaces that a sweep shows.
pub(super) struct Found {
    /// The best first.
    pub surfaces: Vec<Surface>,
    /// Level candidates that were left for the first of them.
    pub level: Vec<Candidate>,
}

pub(super) fn find(columns: &[Column], pairs: &[Pair], up: &Vector3<f64>) -> Found {
    let mut pairs = pairs.to_vec();
    let mut candidates = level(&pairs, up);
    candidates.extend(drawn(&pairs, up));
    let mut found = Found {
        surfaces: Vec::new(),
        level: Vec::new(),
    };
    while found.surfaces.len() < SURFACES {
        back(&mut candidates, &pairs);
        if found.surfaces.is_empty() {
            found.level = candidates
                .iter()
                .filter(|one| one.is_level)
                .copied()
                .collect();
        }
        let Some(surface) = best(&candidates, columns, &pairs, up) else {
            break;
        };
        pairs.retain(|pair| !surface.plane.has(pair, REMOVED));
        found.surfaces.push(surface);
    }
    found
}

/// The number that has this share of the others before it.
pub(super) fn share(values: &mut [f64], share: f64) -> Option<f64> {
    values.sort_by(f64::total_cmp);
    let last = values.len().checked_sub(1)?;
    Some(values[(share * last as f64) as usize])
}

/// Level planes where many pairs are about as deep.
fn level(pairs: &[Pair], up: &Vector3<f64>) -> Vec<Candidate> {
    let mut bins: Vec<Vec<f64>> = vec![Vec::new(); BINS];
    for pair in pairs {
        let rise_m = (pair.far.double() - pair.near.double()).dot(up);
        let depth_m = -pair.middle().dot(up);
        let is_level = rise_m.abs() <= LEVEL * f64::from(pair.apart_m);
        if is_level && (DEPTHS_M[0]..DEPTHS_M[1]).contains(&depth_m) {
            let (mut bin, mut end_m) = (0, DEPTHS_M[0] * DEEPER);
            while depth_m >= end_m {
                bin += 1;
                end_m *= DEEPER;
            }
            bins[bin].push(depth_m);
        }
    }
    let three = |bin: usize| bins[bin.saturating_sub(1)..(bin + 2).min(BINS)].concat();
    let mut planes = Vec::new();
    for bin in 0..BINS {
        let mut depths_m = three(bin);
        let beside = [bin.saturating_sub(1), (bin + 1).min(BINS - 1)];
        let is_most = beside.iter().all(|bin| three(*bin).len() <= depths_m.len());
        if depths_m.len() < FEW || !is_most {
            continue;
        }
        depths_m.sort_by(f64::total_cmp);
        planes.push(Candidate {
            plane: Plane {
                up: *up,
                height_m: depths_m[depths_m.len() / 2],
            },
            is_level: true,
            backing: 0,
        });
    }
    planes
}

/// Planes through pairs that are drawn.
fn drawn(pairs: &[Pair], up: &Vector3<f64>) -> Vec<Candidate> {
    let mut state = 0_u64;
    let mut draw = |from: usize| {
        state = state
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        (state >> 33) as usize % from
    };
    let mut planes = Vec::new();
    if pairs.is_empty() {
        return planes;
    }
    for _ in 0..DRAWN {
        let [one, other] = [draw(pairs.len()), draw(pairs.len())].map(|number| pairs[number]);
        let end = [other.near, other.far][draw(2)];
        let [a, b, c] = [one.near, one.far, end].map(Point::double);
        let square = (b - a).cross(&(c - a));
        if square.norm() <= AREA_M2 {
            continue;
        }
        let mut normal = square.normalize();
        if normal.dot(up) < 0.0 {
            normal = -normal;
        }
        let plane = Plane {
            up: normal,
            height_m: -normal.dot(&a),
        };
        if plane.is_in_bounds(up) {
            planes.push(Candidate {
                plane,
                is_level: false,
                backing: 0,
            });
        }
    }
    planes
}

fn step(pairs: &[Pair]) -> usize {
    (pairs.len() / TRIED).max(1)
}

fn tried(pairs: &[Pair]) -> Vec<Pair> {
    pairs.iter().step_by(step(pairs)).copied().collect()
}

/// Counts who backs the candidates, and drops those that few do.
fn back(candidates: &mut Vec<Candidate>, pairs: &[Pair]) {
    let tried = tried(pairs);
    for candidate in &mut *candidates {
        let on = tried.iter().filter(|pair| candidate.plane.has(pair, 1.0));
        let columns: HashSet<usize> = on.map(|pair| pair.column).collect();
        candidate.backing = columns.len() * step(pairs);
    }
    candidates.retain(|candidate| candidate.backing >= FEW);
}

/// The best surface by the best candidates.
fn best(
    candidates: &[Candidate],
    columns: &[Column],
    pairs: &[Pair],
    up: &Vector3<f64>,
) -> Option<Surface> {
    let mut refined: Vec<Plane> = Vec::new();
    let mut best: Option<Surface> = None;
    for plane in promising(candidates, columns) {
        let Some(plane) = refine(plane, &tried(pairs), step(pairs), up) else {
            continue;
        };
        let is_same = |other: &Plane| {
            (plane.height_m - other.height_m).abs() <= SAME * other.height_m
                && plane.off_rad(&other.up) <= SAME_RAD
        };
        if refined.iter().any(is_same) {
            continue;
        }
        refined.push(plane);
        let surface = finish(&plane, pairs, up).and_then(|fit| Surface::of(columns, pairs, &fit));
        if let Some(surface) = surface
            && best
                .as_ref()
                .is_none_or(|best| surface.value() > best.value())
        {
            best = Some(surface);
        }
    }
    best
}

/// The best candidates, one of each sixth of an octave.
fn promising(candidates: &[Candidate], columns: &[Column]) -> Vec<Plane> {
    let sixth = |one: &Candidate| (6.0 * (one.plane.height_m / DEPTHS_M[0]).log2()).floor() as i64;
    let mut valued = Vec::new();
    for octave in 0..64 {
        let mut most: Option<&Candidate> = None;
        for one in candidates.iter().filter(|one| sixth(one) == octave) {
            if most.is_none_or(|most| one.backing > most.backing) {
                most = Some(one);
            }
        }
        if let Some(one) = most {
            let below = columns
                .iter()
                .step_by(4)
                .filter(|column| one.plane.sees_below(column));
            let value = one.backing as i64 - 2 * 4 * below.count() as i64;
            valued.push((value, one.plane));
        }
    }
    valued.sort_by_key(|&(value, _)| -value);
    valued
        .into_iter()
        .take(REFINED)
        .map(|(_, plane)| plane)
        .collect()
}

fn refine(mut plane: Plane, tried: &[Pair], step: usize, up: &Vector3<f64>) -> Option<Plane> {
    for bands in BANDS {
        plane = fit(&plane, tried, bands, step, up)?.plane;
    }
    plane.is_in_bounds(up).then_some(plane)
}

/// The last fit, by all pairs; and then not too much lies below it.
fn finish(plane: &Plane, pairs: &[Pair], up: &Vector3<f64>) -> Option<Fit> {
    let mut fit = fit(plane, pairs, CLOSE, 1, up)?;
    if fit.error_rad > ERROR_RAD || !fit.plane.is_in_bounds(up) {
        return None;
    }
    let plane = &mut fit.plane;
    let mut over_m: Vec<f64> = pairs
        .iter()
        .filter(|pair| plane.has(pair, 1.0))
        .filter(|pair| f64::from(pair.near.far_m()) <= 8.0 * plane.height_m)
        .map(|pair| plane.up.dot(&pair.middle()) + plane.height_m)
        .collect();
    if over_m.len() >= FEW {
        plane.height_m -= share(&mut over_m, 0.4).map_or(0.0, |over_m| over_m.min(0.0));
    }
    Some(fit)
}
