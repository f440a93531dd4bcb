//! A plane below the sensor, what lies on it, and the plane that pairs say.

use nalgebra::{Matrix3, Vector3};

use super::points::{Column, Pair, Point};

/// Bounds of a depth, metres.
pub(super) const DEPTHS_M: [f64; 2] = [0.1, 8.0];
/// Cosine of the greatest angle to the mount, 20 degrees.
const TILT: f64 = 0.939_693;
/// Sine of the steepest rise of a pair on a plane, 8 degrees.
pub(super) const LEVEL: f64 = 0.139_173;
/// Reach within which returns below are looked for, metres.
const BELOW_M: f32 = 40.0;
/// Bands below a plane that are below it.
const BELOW: f64 = 3.0;
/// Standard deviations: of the mount, radians, and of an end of a pair, metres.
const MOUNT_RAD: f64 = 0.052_36;
const END_M: f64 = 0.02;
/// Ends of pairs that count as one.
const ALIKE: f64 = 8.0;

/// A plane `height_m` below the sensor along `up` and square to it.
#[derive(Clone, Copy)]
pub(super) struct Plane {
    pub up: Vector3<f64>,
    pub height_m: f64,
}

impl Plane {
    fn up_single(&self) -> Point {
        single(&self.up)
    }

    /// Height of a point over it, metres.
    pub fn over_m(&self, point: Point) -> f32 {
        point.dot(self.up_single()) + self.height_m as f32
    }

    /// Width of so many bands at this distance, metres.
    fn bands_m(&self, bands: f64, far_m: f32) -> f32 {
        let near_m = (bands * (0.05 * self.height_m).clamp(0.03, 0.06)) as f32;
        let most_m = (bands * (0.25 * self.height_m)) as f32;
        (far_m * (bands * 0.01) as f32 + near_m).min(most_m)
    }

    /// Whether a pair is on it, within so many bands.
    pub fn has(&self, pair: &Pair, bands: f64) -> bool {
        let is_within = |end: Point| self.over_m(end).abs() <= self.bands_m(bands, end.far_m());
        let rise_m = match bands <= 0.8 {
            true => pair.apart_m * 0.03 + 0.02,
            false => pair.apart_m * (LEVEL * bands.max(1.0)) as f32,
        };
        is_within(pair.near)
            && is_within(pair.far)
            && (self.over_m(pair.far) - self.over_m(pair.near)).abs() <= rise_m
            && pair.near.far_m() <= (15.0 * self.height_m + 1.0) as f32
    }

    /// Whether a column sees something below it.
    pub fn sees_below(&self, column: &Column) -> bool {
        column.returns.iter().flatten().any(|point| {
            let far_m = point.far_m();
            far_m <= BELOW_M && self.over_m(*point) < -self.bands_m(BELOW, far_m)
        })
    }

    /// Whether the lowest return of a column is not below it, however far.
    pub fn is_lowest(&self, column: &Column) -> bool {
        let lowest = column.returns.iter().flatten().next();
        lowest.is_some_and(|lowest| {
            let over_m = self.up.dot(&lowest.double()) + self.height_m;
            let near_m = (0.05 * self.height_m).clamp(0.03, 0.06);
            let band_m = near_m + 0.01 * f64::from(lowest.far_m());
            over_m > -BELOW * band_m.min(0.25 * self.height_m)
        })
    }

    pub fn is_in_bounds(&self, up: &Vector3<f64>) -> bool {
        (DEPTHS_M[0]..DEPTHS_M[1]).contains(&self.height_m) && self.up.dot(up) >= TILT
    }

    /// The angle to a direction, radians.
    pub fn off_rad(&self, up: &Vector3<f64>) -> f64 {
        self.up.dot(up).clamp(-1.0, 1.0).acos()
    }

    /// Two directions along it, square to each other.
    fn along(&self) -> [Vector3<f64>; 2] {
        let axis = match self.up.x.abs() >= 0.7 {
            true => Vector3::y(),
            false => Vector3::x(),
        };
        let a = self.up.cross(&axis).normalize();
        [a, self.up.cross(&a)]
    }
}

pub(super) fn single(direction: &Vector3<f64>) -> Point {
    Point([direction.x, direction.y, direction.z].map(|axis| axis as f32))
}

/// A plane by least squares over pairs.
pub(super) struct Fit {
    pub plane: Plane,
    /// Standard error of its tilt, radians.
    pub error_rad: f64,
}

/// The plane through those pairs that are on this one within so many bands, each of which stands for
/// `step` pairs. `None` if these are fewer than 10.
pub(super) fn fit(
    plane: &Plane,
    pairs: &[Pair],
    bands: f64,
    step: usize,
    mount_up: &Vector3<f64>,
) -> Option<Fit> {
    let along = plane.along();
    let [a, b] = along.map(|direction| single(&direction));
    // Of each of the 16 parts: sums of products of the two sides and 1, and of these with the height
    // over the plane.
    let mut parts = [[[0.0_f32; 4]; 3]; 16];
    let mut count = 0;
    for (number, pair) in pairs.iter().enumerate() {
        if !plane.has(pair, bands) {
            continue;
        }
        count += step;
        for end in [pair.near, pair.far] {
            let over_m = plane.over_m(end);
            let off = over_m / (plane.bands_m(bands, end.far_m()) * 1.05);
            let near = (1.0 - off * off).max(0.0);
            let weight = near * near;
            let row = [end.dot(a), end.dot(b), 1.0];
            for i in 0..3 {
                for j in i..3 {
                    parts[number % 16][i][j] += weight * row[i] * row[j];
                }
                parts[number % 16][i][3] += weight * row[i] * over_m;
            }
        }
    }
    if count < 10 {
        return None;
    }
    let sum = |i: usize, j: usize| parts.iter().map(|part| f64::from(part[i][j])).sum::<f64>();
    let weight = step as f64 / (END_M * END_M * ALIKE);
    let seen = Matrix3::from_fn(|i, j| sum(i.min(j), i.max(j))) * weight;
    let over = Vector3::from_fn(|i, _| sum(i, 3)) * weight;
    let mut both = seen;
    let mut wanted = -over;
    for (i, direction) in along.iter().enumerate() {
        both[(i, i)] += MOUNT_RAD.powi(-2);
        wanted[i] += direction.dot(mount_up) / plane.up.dot(mount_up) / MOUNT_RAD.powi(2);
    }
    let least = Matrix3::from_diagonal(&Vector3::new(1e-3, 1e-3, 1e-6));
    let change = both.try_inverse()? * wanted;
    let up = plane.up + along[0] * change[0] + along[1] * change[1];
    let errors = (seen + least).try_inverse()?;
    Some(Fit {
        plane: Plane {
            up: up.normalize(),
            height_m: (plane.height_m + change[2]) / up.norm(),
        },
        error_rad: errors[(0, 0)].max(errors[(1, 1)]).sqrt(),
    })
}
