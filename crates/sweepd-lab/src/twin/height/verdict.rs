//! The floor among the surfaces of a sweep, and what speaks against it.

use std::collections::{HashMap, HashSet};

use nalgebra::Vector3;
use sweepd_core::sweep::height::HeightDoubt;

use super::plane::Plane;
use super::points::{Column, Pair};
use super::surfaces::{CLOSE, FEW, Found, Surface, share};

const PARALLEL_RAD: f64 = 0.052_36;
/// Fewer columns or directions are few returns; a direction counts with two columns.
const COLUMNS: usize = 30;
const DIRECTIONS: usize = 3;
const ERROR_RAD: f64 = 0.008_727;
const TILTED_RAD: f64 = 0.034_907;
const ALL_AROUND: usize = 7;
const SMALL_M: f64 = 1.5;
const RAMP_RAD: f64 = 0.017_453;
/// Heights that differ by more are not one: a share, and metres.
const OTHER: f64 = 0.05;
const OTHER_M: f64 = 0.03;

/// The floor of one sweep.
#[derive(Clone, Copy)]
pub(super) struct Verdict {
    pub plane: Plane,
    pub doubt: Option<HeightDoubt>,
}

/// All that is known of a sweep.
struct Seen<'a> {
    columns: &'a [Column],
    pairs: &'a [Pair],
    up: &'a Vector3<f64>,
    surfaces: &'a [Surface],
}

pub(super) fn decide(
    columns: &[Column],
    pairs: &[Pair],
    up: &Vector3<f64>,
    found: &Found,
) -> Option<Verdict> {
    let seen = Seen {
        columns,
        pairs,
        up,
        surfaces: &found.surfaces,
    };
    let mut first: Option<&Surface> = None;
    for surface in seen.surfaces.iter().filter(|surface| is_sound(surface)) {
        if first.is_none_or(|first| surface.value() > first.value()) {
            first = Some(surface);
        }
    }
    let (floor, below) = seen.with_something_below(first?);
    let ramp = seen.ramp(floor, found);
    let doubt = below
        .or_else(|| seen.few_returns(floor))
        .or_else(|| tilt_error(floor))
        .or_else(|| seen.around(floor))
        .or_else(|| ramp.map(|(doubt, _)| doubt))
        .or_else(|| seen.tilted(floor))
        .or_else(|| small(floor));
    Some(Verdict {
        plane: ramp.map_or(floor.plane, |(_, plane)| plane),
        doubt,
    })
}

fn tilt_error(floor: &Surface) -> Option<HeightDoubt> {
    let error_ddeg = (10.0 * floor.error_rad.to_degrees()).round() as u16;
    (floor.error_rad > ERROR_RAD).then_some(HeightDoubt::TiltError { error_ddeg })
}

/// Whether few enough columns are below it.
fn is_sound(surface: &Surface) -> bool {
    4 * surface.below <= surface.columns.len()
}

impl Seen<'_> {
    /// Columns that have a return.
    fn count(&self) -> u16 {
        let has_return = |column: &&Column| column.returns.iter().any(Option::is_some);
        self.columns.iter().filter(has_return).count() as u16
    }

    /// The floor, which may be a deeper surface, and the doubt if more than a few columns are below
    /// the first.
    fn with_something_below<'a>(
        &'a self,
        first: &'a Surface,
    ) -> (&'a Surface, Option<HeightDoubt>) {
        if 20 * first.below <= first.columns.len() {
            return (first, None);
        }
        let mut floor = first;
        for other in self.surfaces {
            let is_parallel = other.plane.off_rad(&first.plane.up) <= PARALLEL_RAD;
            let is_seen = 10 * other.columns.len() >= first.columns.len();
            if is_parallel && is_seen && other.plane.height_m > floor.plane.height_m {
                floor = other;
            }
        }
        let doubt = match std::ptr::eq(floor, first) {
            false => HeightDoubt::Lower,
            true => HeightDoubt::SeenBelow {
                columns: first.below as u16,
                seen: self.count(),
            },
        };
        (floor, Some(doubt))
    }

    /// Sixteenths of a turn with two columns of a surface.
    fn directions(&self, surface: &Surface) -> usize {
        let mut counts = HashMap::new();
        for &column in &surface.columns {
            *counts.entry(self.columns[column].direction).or_insert(0) += 1;
        }
        counts.values().filter(|count| **count >= 2).count()
    }

    fn few_returns(&self, floor: &Surface) -> Option<HeightDoubt> {
        let directions = self.directions(floor);
        let is_few = floor.columns.len() < COLUMNS || directions < DIRECTIONS;
        is_few.then(|| HeightDoubt::FewReturns {
            columns: floor.columns.len() as u16,
            seen: self.count(),
            directions: directions as u8,
        })
    }

    /// Columns of a plane whose lowest return does not lie below it.
    fn as_lowest(&self, plane: &Plane, columns: &HashSet<usize>) -> usize {
        let is_lowest = |column: &&usize| plane.is_lowest(&self.columns[**column]);
        columns.iter().filter(is_lowest).count()
    }

    fn around(&self, floor: &Surface) -> Option<HeightDoubt> {
        self.surfaces.iter().find_map(|other| {
            let plane = &other.plane;
            let above_m = floor.plane.height_m - plane.height_m;
            let is_above = above_m > (OTHER * floor.plane.height_m).max(OTHER_M)
                && plane.off_rad(&floor.plane.up) <= PARALLEL_RAD
                && 5 * other.columns.len() >= floor.columns.len()
                && other.columns.len() >= other.below;
            let lowest = self.as_lowest(plane, &other.columns);
            let far_m = far_m(other, 0.9);
            let is_around = is_above && 10 * lowest >= 7 * other.columns.len() && far_m > 1.0;
            is_around.then(|| HeightDoubt::Around {
                depth_cm: (100.0 * plane.height_m).round() as u16,
                far_dm: (10.0 * far_m).round() as u16,
            })
        })
    }

    fn tilted(&self, floor: &Surface) -> Option<HeightDoubt> {
        let tilt_rad = floor.plane.off_rad(self.up);
        let directions = self.directions(floor);
        let is_unchecked =
            !std::ptr::eq(floor, &raw const self.surfaces[0]) && tilt_rad >= RAMP_RAD;
        let is_tilted = tilt_rad > TILTED_RAD && directions < ALL_AROUND || is_unchecked;
        is_tilted.then(|| HeightDoubt::Tilted {
            tilt_ddeg: (10.0 * tilt_rad.to_degrees()).round() as u16,
            directions: directions as u8,
        })
    }

    /// The doubt, and the plane that is taken.
    fn ramp(&self, floor: &Surface, found: &Found) -> Option<(HeightDoubt, Plane)> {
        let tilt_rad = floor.plane.off_rad(self.up);
        if tilt_rad < RAMP_RAD {
            return None;
        }
        let height_m = floor.plane.height_m;
        let plane = self
            .level_instead(found)
            .into_iter()
            .flatten()
            .find(|plane| {
                let columns = self.columns_of(plane);
                let is_other = (plane.height_m - height_m).abs() > (OTHER * height_m).max(OTHER_M);
                is_other
                    && match plane.height_m > height_m {
                        true => {
                            let below = (0..self.columns.len()).filter(|column| {
                                !columns.contains(column)
                                    && plane.sees_below(&self.columns[*column])
                            });
                            4 * below.count() <= columns.len()
                        }
                        false => 10 * self.as_lowest(plane, &columns) >= 7 * columns.len(),
                    }
            })?;
        let cm = |height_m: f64| (100.0 * height_m).round() as u16;
        let doubt = HeightDoubt::Ramp {
            tilted_cm: cm(height_m),
            level_cm: cm(plane.height_m),
            tilt_ddeg: (10.0 * tilt_rad.to_degrees()).round() as u8,
        };
        let is_deeper = plane.height_m > height_m;
        Some((doubt, if is_deeper { plane } else { floor.plane }))
    }

    fn columns_of(&self, plane: &Plane) -> HashSet<usize> {
        let on = self.pairs.iter().filter(|pair| plane.has(pair, CLOSE));
        on.map(|pair| pair.column).collect()
    }

    /// Level planes that say what the first surface says: the deepest that is deeper, and of the
    /// others the one with the most columns.
    fn level_instead(&self, found: &Found) -> [Option<Plane>; 2] {
        let Some(first) = self
            .surfaces
            .first()
            .filter(|first| first.plane.off_rad(self.up) >= RAMP_RAD)
        else {
            return [None; 2];
        };
        let mut deeper: Option<Plane> = None;
        let mut other: Option<Plane> = None;
        for candidate in &found.level {
            if 4 * candidate.backing <= first.columns.len() {
                continue;
            }
            let plane = self.moved(candidate.plane);
            let columns = |plane: &Plane| self.columns_of(plane).len();
            if 2 * columns(&plane) < first.columns.len() || !self.says_it_better(&plane, first) {
                continue;
            }
            if plane.height_m > first.plane.height_m {
                if deeper.is_none_or(|deeper| plane.height_m > deeper.height_m) {
                    deeper = Some(plane);
                }
            } else if other.is_none_or(|other| columns(&plane) > columns(&other)) {
                other = Some(plane);
            }
        }
        [deeper, other]
    }

    /// A level plane in the middle of the pairs on it.
    fn moved(&self, mut plane: Plane) -> Plane {
        for bands in [1.0, CLOSE] {
            let on = self.pairs.iter().filter(|pair| plane.has(pair, bands));
            let mut depths_m: Vec<f64> = on.map(|pair| -pair.middle().dot(self.up)).collect();
            plane.height_m = share(&mut depths_m, 0.5).unwrap_or(plane.height_m);
        }
        plane
    }

    fn says_it_better(&self, plane: &Plane, first: &Surface) -> bool {
        let is_long = |pair: &&Pair| plane.has(pair, CLOSE) && f64::from(pair.apart_m) >= 0.3;
        let long: Vec<&Pair> = self.pairs.iter().filter(is_long).collect();
        let slope = |plane: &Plane| {
            let slope = |pair: &&Pair| {
                let step = pair.far.double() - pair.near.double();
                plane.up.dot(&step).abs() / f64::from(pair.apart_m)
            };
            share(&mut long.iter().map(slope).collect::<Vec<f64>>(), 0.5).unwrap_or(0.0)
        };
        long.len() >= FEW && slope(plane) < 0.7 * slope(&first.plane)
    }
}

fn small(floor: &Surface) -> Option<HeightDoubt> {
    let far_m = far_m(floor, 0.98);
    (far_m < SMALL_M).then(|| HeightDoubt::Small {
        far_dm: (10.0 * far_m).round() as u16,
    })
}

/// Distance along a surface that this share of its pairs is within, from the point below the sensor,
/// metres.
fn far_m(surface: &Surface, of: f64) -> f64 {
    let up = &surface.plane.up;
    let near = surface.pairs.iter().map(|pair| pair.near.double());
    let mut far_m: Vec<f64> = near
        .map(|near| (near - up * up.dot(&near)).norm())
        .collect();
    share(&mut far_m, of).unwrap_or(0.0)
}
