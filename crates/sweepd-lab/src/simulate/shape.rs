//! Convex solids and the rays that meet them, in double precision.
//!
//! The scene's frame is the sensor's: x to the right, y ahead, z up, metres; headings and azimuths
//! run clockwise from +y as seen from above.

use nalgebra::Vector3;

/// A point or a direction.
pub type Vec3 = Vector3<f64>;

/// A half-line with a direction of length 1.
#[derive(Clone, Copy, Debug)]
pub struct Ray {
    /// Where it starts.
    pub origin: Vec3,
    /// Where it goes, length 1.
    pub direction: Vec3,
    /// The direction's azimuth, clockwise from +y, radians.
    pub azimuth_rad: f64,
}

impl Ray {
    /// The ray from a point towards an azimuth and an elevation, radians.
    pub fn new(origin: Vec3, azimuth_rad: f64, elevation_rad: f64) -> Self {
        let (sin_a, cos_a) = azimuth_rad.sin_cos();
        let (sin_w, cos_w) = elevation_rad.sin_cos();
        Self {
            origin,
            direction: Vec3::new(cos_w * sin_a, cos_w * cos_a, sin_w),
            azimuth_rad,
        }
    }

    /// The point this far along.
    pub fn at(&self, distance_m: f64) -> Vec3 {
        self.origin + self.direction * distance_m
    }
}

/// A convex solid.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Shape {
    /// A cuboid, upright, turned about the vertical.
    Cuboid(Cuboid),
    /// An upright cylinder with flat ends.
    Cylinder(Cylinder),
    /// An ellipsoid whose axes are those of the frame; a sphere when they are equal.
    Ellipsoid(Ellipsoid),
}

/// See [`Shape::Cuboid`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cuboid {
    centre: Vec3,
    /// Half its width (across), length (along) and height.
    half: Vec3,
    /// Sine and cosine of the heading of its length.
    heading: (f64, f64),
}

/// See [`Shape::Cylinder`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cylinder {
    /// Centre of its lower end.
    foot: Vec3,
    radius_m: f64,
    height_m: f64,
}

/// See [`Shape::Ellipsoid`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ellipsoid {
    centre: Vec3,
    /// Its semi-axes.
    semi: Vec3,
}

/// The stretch of a ray inside a solid.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Span {
    /// Distance at which the ray enters.
    pub enter_m: f64,
    /// Distance at which it leaves.
    pub leave_m: f64,
    /// Cosine of the angle between the ray and the surface's normal where it enters, 0 to 1.
    pub cos_incidence: f64,
    /// The ray enters through an upright flat face.
    pub wall: bool,
}

/// Intersections of a ray with a solid, and with the same solid enlarged and shrunk by a rim.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Brim {
    /// Distance at which the ray enters the larger one.
    pub outer_m: f64,
    /// Distance at which it enters the smaller one, if it does.
    pub core_m: Option<f64>,
    /// The stretch inside the solid itself.
    pub span: Option<Span>,
}

/// An upright prism that holds a shape: a turned rectangle between two heights.
#[derive(Clone, Copy, Debug)]
pub struct Bounds {
    /// Centre of the rectangle.
    pub centre: [f64; 2],
    /// Half its width and length.
    pub half: [f64; 2],
    /// Sine and cosine of the heading of its length.
    pub heading: (f64, f64),
    /// Lowest and highest point.
    pub z: [f64; 2],
}

impl Shape {
    /// A cuboid on a base centre: width across, length along the heading, height upwards.
    pub fn cuboid(base: [f64; 3], size: [f64; 3], heading_rad: f64) -> Self {
        let half = Vec3::from(size) / 2.0;
        Self::Cuboid(Cuboid {
            centre: Vec3::from(base) + Vec3::z() * half.z,
            half,
            heading: heading_rad.sin_cos(),
        })
    }

    /// An upright cylinder on the centre of its foot.
    pub fn cylinder(foot: [f64; 3], radius_m: f64, height_m: f64) -> Self {
        Self::Cylinder(Cylinder {
            foot: Vec3::from(foot),
            radius_m,
            height_m,
        })
    }

    /// An ellipsoid about its centre.
    pub fn ellipsoid(centre: [f64; 3], semi: [f64; 3]) -> Self {
        Self::Ellipsoid(Ellipsoid {
            centre: Vec3::from(centre),
            semi: Vec3::from(semi),
        })
    }

    /// Where a ray from outside passes through, if it does.
    pub fn span(&self, ray: &Ray) -> Option<Span> {
        match self {
            Self::Cuboid(cuboid) => cuboid.span(ray),
            Self::Cylinder(cylinder) => cylinder.span(ray),
            Self::Ellipsoid(ellipsoid) => ellipsoid.span(ray),
        }
    }

    /// Intersections of a ray with the solid and its rim, if it comes within `rim_m` of it.
    pub fn brim(&self, ray: &Ray, rim_m: f64) -> Option<Brim> {
        if let Self::Cuboid(cuboid) = self {
            return cuboid.brim(ray, rim_m);
        }
        let outer_m = self.grown(rim_m)?.span(ray)?.enter_m;
        let core = self.grown(-rim_m).and_then(|core| core.span(ray));
        Some(Brim {
            outer_m,
            core_m: core.map(|span| span.enter_m),
            span: self.span(ray),
        })
    }

    /// The same solid, larger by a margin to all sides, or smaller if negative; `None` if nothing
    /// is left.
    pub fn grown(&self, margin_m: f64) -> Option<Self> {
        let mut grown = *self;
        let least_m = match &mut grown {
            Self::Cuboid(cuboid) => {
                cuboid.half = cuboid.half.add_scalar(margin_m);
                cuboid.half.min()
            }
            Self::Cylinder(cylinder) => {
                cylinder.foot -= Vec3::z() * margin_m;
                cylinder.radius_m += margin_m;
                cylinder.height_m += 2.0 * margin_m;
                cylinder.radius_m.min(cylinder.height_m)
            }
            Self::Ellipsoid(ellipsoid) => {
                ellipsoid.semi = ellipsoid.semi.add_scalar(margin_m);
                ellipsoid.semi.min()
            }
        };
        (least_m > 0.0).then_some(grown)
    }

    /// A prism around it.
    pub fn bounds(&self) -> Bounds {
        match *self {
            Self::Cuboid(Cuboid {
                centre: c,
                half: h,
                heading,
            }) => Bounds {
                centre: [c.x, c.y],
                half: [h.x, h.y],
                heading,
                z: [c.z - h.z, c.z + h.z],
            },
            Self::Cylinder(Cylinder {
                foot: f,
                radius_m: r,
                height_m,
            }) => Bounds {
                centre: [f.x, f.y],
                half: [r, r],
                heading: (0.0, 1.0),
                z: [f.z, f.z + height_m],
            },
            Self::Ellipsoid(Ellipsoid { centre: c, semi: s }) => Bounds {
                centre: [c.x, c.y],
                half: [s.x, s.y],
                heading: (0.0, 1.0),
                z: [c.z - s.z, c.z + s.z],
            },
        }
    }
}

/// A horizontal vector in the frame of a heading, given by its sine and cosine: across (to the
/// right) and along.
pub fn turned(x: f64, y: f64, heading: (f64, f64)) -> [f64; 2] {
    let (sin, cos) = heading;
    [x * cos - y * sin, x * sin + y * cos]
}

/// The lesser of two numbers, neither of which is NaN: one instruction, where `f64::min` takes
/// several.
fn lesser(a: f64, b: f64) -> f64 {
    if a < b { a } else { b }
}

/// The greater of two numbers, neither of which is NaN.
fn greater(a: f64, b: f64) -> f64 {
    if a > b { a } else { b }
}

/// The number rounded down, if it fits into a 64-bit integer: a few instructions, whereas
/// `f64::floor` is a call without SSE4.1.
pub fn floor(x: f64) -> f64 {
    let whole = x as i64 as f64;
    if whole > x { whole - 1.0 } else { whole }
}

/// The number rounded as by `f64::round`, if it fits into a 64-bit integer.
pub fn rounded(x: f64) -> f64 {
    let whole = x as i64 as f64;
    let rest = x - whole;
    whole + f64::from(u8::from(rest >= 0.5)) - f64::from(u8::from(rest <= -0.5))
}

/// Distances at which a line enters and leaves the slab -half..half.
fn slab(origin: f64, direction: f64, half: f64) -> Option<[f64; 2]> {
    if direction == 0.0 {
        return (origin.abs() <= half).then_some([f64::NEG_INFINITY, f64::INFINITY]);
    }
    let a = (-half - origin) / direction;
    let b = (half - origin) / direction;
    Some([lesser(a, b), greater(a, b)])
}

/// Where a ray passes through a cuboid that it crosses the three slabs of; the ray's direction in
/// the cuboid's frame.
fn slabs_span(slabs: &[[f64; 2]; 3], direction: &[f64; 3]) -> Option<Span> {
    let leave_m = lesser(lesser(slabs[0][1], slabs[1][1]), slabs[2][1]);
    let mut face = 0;
    for other in [1, 2] {
        if slabs[other][0] > slabs[face][0] {
            face = other;
        }
    }
    let enter_m = slabs[face][0];
    (enter_m < leave_m && enter_m > 0.0).then_some(Span {
        enter_m,
        leave_m,
        cos_incidence: direction[face].abs(),
        wall: face < 2,
    })
}

/// Where a ray enters the cuboid enlarged by a margin to all sides, if it does. `steps_m` are the
/// distances along the ray between the faces of both.
fn grown_enter_m(slabs: &[[f64; 2]; 3], steps_m: [f64; 3]) -> Option<f64> {
    let [x, y, z] = slabs;
    let [step_x, step_y, step_z] = steps_m;
    let enter_m = greater(greater(x[0] - step_x, y[0] - step_y), z[0] - step_z);
    let leave_m = lesser(lesser(x[1] + step_x, y[1] + step_y), z[1] + step_z);
    (enter_m < leave_m && enter_m > 0.0).then_some(enter_m)
}

impl Cuboid {
    /// Where a ray starts and goes in the frame of the cuboid: across, along and up.
    fn in_frame(&self, ray: &Ray) -> [[f64; 3]; 2] {
        let from = ray.origin - self.centre;
        let [ox, oy] = turned(from.x, from.y, self.heading);
        let [dx, dy] = turned(ray.direction.x, ray.direction.y, self.heading);
        [[ox, oy, from.z], [dx, dy, ray.direction.z]]
    }

    fn slabs(&self, origin: &[f64; 3], direction: &[f64; 3]) -> Option<[[f64; 2]; 3]> {
        Some([
            slab(origin[0], direction[0], self.half.x)?,
            slab(origin[1], direction[1], self.half.y)?,
            slab(origin[2], direction[2], self.half.z)?,
        ])
    }

    fn span(&self, ray: &Ray) -> Option<Span> {
        let [origin, direction] = self.in_frame(ray);
        slabs_span(&self.slabs(&origin, &direction)?, &direction)
    }

    /// See [`Shape::brim`]: all three from the same six divisions.
    fn brim(&self, ray: &Ray, rim_m: f64) -> Option<Brim> {
        let [origin, direction] = self.in_frame(ray);
        // Parallel to a face the step would be infinite, so that a small slope is used.
        let direction = direction.map(|d| if d == 0.0 { 1e-300 } else { d });
        let slabs = self.slabs(&origin, &direction)?;
        let steps_m = direction.map(|d| rim_m / d.abs());
        let outer_m = grown_enter_m(&slabs, steps_m)?;
        let has_core = lesser(lesser(self.half.x, self.half.y), self.half.z) > rim_m;
        let core_m = if has_core {
            grown_enter_m(&slabs, steps_m.map(|step_m| -step_m))
        } else {
            None
        };
        Some(Brim {
            outer_m,
            core_m,
            span: slabs_span(&slabs, &direction),
        })
    }
}

impl Cylinder {
    fn span(&self, ray: &Ray) -> Option<Span> {
        let Self {
            foot,
            radius_m,
            height_m,
        } = *self;
        let from = ray.origin - foot;
        let d = ray.direction;
        let a = d.x * d.x + d.y * d.y;
        let b = from.x * d.x + from.y * d.y;
        let c = from.x * from.x + from.y * from.y - radius_m * radius_m;
        let root = greater(b * b - a * c, 0.0).sqrt();
        if root == 0.0 {
            return None;
        }
        let side = [(-b - root) / a, (-b + root) / a];
        let ends = slab(from.z - height_m / 2.0, d.z, height_m / 2.0)?;
        let leave_m = lesser(side[1], ends[1]);
        let (enter_m, cos_incidence) = if side[0] >= ends[0] {
            let normal_x = (from.x + d.x * side[0]) / radius_m;
            let normal_y = (from.y + d.y * side[0]) / radius_m;
            (side[0], (normal_x * d.x + normal_y * d.y).abs())
        } else {
            (ends[0], d.z.abs())
        };
        (enter_m < leave_m && enter_m > 0.0).then_some(Span {
            enter_m,
            leave_m,
            cos_incidence,
            wall: false,
        })
    }
}

impl Ellipsoid {
    fn span(&self, ray: &Ray) -> Option<Span> {
        // Scaled by its axes the ellipsoid is the unit sphere, and distances along the ray stay
        // what they are.
        let from = (ray.origin - self.centre).component_div(&self.semi);
        let d = ray.direction.component_div(&self.semi);
        let a = d.norm_squared();
        let b = from.dot(&d);
        let c = from.norm_squared() - 1.0;
        let square = b * b - a * c;
        if square <= 0.0 {
            return None;
        }
        let enter_m = (-b - square.sqrt()) / a;
        let leave_m = (-b + square.sqrt()) / a;
        let normal = (from + d * enter_m).component_div(&self.semi).normalize();
        (enter_m > 0.0).then_some(Span {
            enter_m,
            leave_m,
            cos_incidence: normal.dot(&ray.direction).abs(),
            wall: false,
        })
    }
}

impl Bounds {
    /// The same prism, larger by a margin to all sides.
    pub fn grown(mut self, margin_m: f64) -> Self {
        self.half = self.half.map(|half| half + margin_m);
        self.z = [self.z[0] - margin_m, self.z[1] + margin_m];
        self
    }

    /// Horizontal distances from a point to the nearest and the farthest point of the prism; the
    /// nearest is 0 inside.
    pub fn reach(&self, eye: Vec3) -> [f64; 2] {
        let [x, y] = turned(eye.x - self.centre[0], eye.y - self.centre[1], self.heading);
        let x = x.abs();
        let y = y.abs();
        let near = f64::hypot((x - self.half[0]).max(0.0), (y - self.half[1]).max(0.0));
        [near, f64::hypot(x + self.half[0], y + self.half[1])]
    }

    /// The same for the part of the prism between two azimuths a few degrees apart, radians, as
    /// seen from a point outside; `None` if there is no such part. The nearest is a lower bound.
    pub fn reach_between(&self, eye: Vec3, edges: [f64; 2]) -> Option<[f64; 2]> {
        let [x, y] = turned(eye.x - self.centre[0], eye.y - self.centre[1], self.heading);
        let ways = edges.map(|edge_rad| {
            let (sin, cos) = edge_rad.sin_cos();
            turned(sin, cos, self.heading)
        });
        // The corners of that part: those of the prism, and the intersections with the edges.
        let [first, last] = ways;
        let corners = [(1.0, 1.0), (1.0, -1.0), (-1.0, 1.0), (-1.0, -1.0)]
            .map(|(across, along)| (across * self.half[0] - x, along * self.half[1] - y));
        let inside = corners.into_iter().filter(|(u, v)| {
            let ahead = u * first[0] + v * first[1] > 0.0;
            ahead && u * first[1] - v * first[0] >= 0.0 && u * last[1] - v * last[0] <= 0.0
        });
        let crossings = ways.into_iter().filter_map(|way| {
            let across = slab(x, way[0], self.half[0])?;
            let along = slab(y, way[1], self.half[1])?;
            let [from, to] = [greater(across[0], along[0]), lesser(across[1], along[1])];
            (from <= to && to > 0.0).then_some([greater(from, 0.0), to])
        });
        let places = inside
            .map(|(u, v)| f64::hypot(u, v))
            .chain(crossings.flatten());
        let [near, far] = places.fold([f64::INFINITY, 0.0], |[near, far], at| {
            [lesser(near, at), greater(far, at)]
        });
        // A side may be nearer than both of its corners, by at most its chord.
        (far > 0.0).then_some([near * (edges[1] - edges[0]).cos(), far])
    }

    /// Azimuth of the centre from a point outside, and the angles from there to the prism's two
    /// edges, radians.
    pub fn azimuths(&self, eye: Vec3) -> (f64, [f64; 2]) {
        let (sin, cos) = self.heading;
        let x = self.centre[0] - eye.x;
        let y = self.centre[1] - eye.y;
        let mut edges = [0.0_f64; 2];
        for (across, along) in [(1.0, 1.0), (1.0, -1.0), (-1.0, 1.0), (-1.0, -1.0)] {
            let u = across * self.half[0];
            let v = along * self.half[1];
            let cx = x + u * cos + v * sin;
            let cy = y - u * sin + v * cos;
            // Clockwise from the centre; it cannot wrap, as a footprint seen from outside spans
            // less than half a turn.
            let angle = f64::atan2(cx * y - cy * x, cx * x + cy * y);
            edges = [edges[0].min(angle), edges[1].max(angle)];
        }
        (f64::atan2(x, y), edges)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::{FRAC_1_SQRT_2, FRAC_PI_2, FRAC_PI_4, PI, SQRT_2};

    fn ray(azimuth_rad: f64, elevation_rad: f64) -> Ray {
        Ray::new(Vec3::new(0.0, 0.0, 2.0), azimuth_rad, elevation_rad)
    }

    fn near(a: f64, b: f64) -> bool {
        (a - b).abs() < 1e-12
    }

    #[test]
    fn azimuth_0_is_ahead_and_90_degrees_to_the_right() {
        assert!((ray(0.0, 0.0).direction - Vec3::y()).norm() < 1e-15);
        assert!((ray(FRAC_PI_2, 0.0).direction - Vec3::x()).norm() < 1e-15);
        assert!((ray(1.0, FRAC_PI_2).direction - Vec3::z()).norm() < 1e-15);
    }

    #[test]
    fn a_cuboid_is_met_on_its_near_face() {
        // Front face at y = 8, back face at y = 12.
        let cuboid = Shape::cuboid([0.0, 10.0, 0.0], [3.0, 4.0, 3.0], 0.0);
        let straight = cuboid.span(&ray(0.0, 0.0)).unwrap();
        assert!(
            near(straight.enter_m, 8.0)
                && near(straight.leave_m, 12.0)
                && near(straight.cos_incidence, 1.0)
        );
        let oblique = cuboid.span(&ray(0.1, 0.0)).unwrap();
        assert!(
            near(oblique.enter_m, 8.0 / 0.1_f64.cos())
                && near(oblique.cos_incidence, 0.1_f64.cos())
        );
        assert_eq!(
            cuboid.span(&ray(0.2, 0.0)),
            None,
            "8 m * tan 0.2 = 1.62 m, beside the face"
        );
        assert_eq!(cuboid.span(&ray(PI, 0.0)), None, "behind");
        assert_eq!(cuboid.span(&ray(0.0, 0.2)), None, "over the top");
    }

    #[test]
    fn a_cuboid_from_above_is_met_on_its_top() {
        let cuboid = Shape::cuboid([0.0, 3.0, 0.0], [2.0, 4.0, 1.0], 0.0);
        let span = cuboid.span(&ray(0.0, -FRAC_PI_4)).unwrap();
        assert!(
            near(span.enter_m, SQRT_2) && near(span.cos_incidence, FRAC_1_SQRT_2) && !span.wall
        );
    }

    #[test]
    fn a_turned_cuboid_is_met_at_its_corner() {
        // A square of side 2, turned by 45 degrees: its near corner lies at 10 - sqrt 2.
        let cuboid = Shape::cuboid([0.0, 10.0, 0.0], [2.0, 2.0, 4.0], FRAC_PI_4);
        let span = cuboid.span(&ray(1e-9, 0.0)).unwrap();
        assert!(
            (span.enter_m - (10.0 - SQRT_2)).abs() < 1e-7
                && (span.cos_incidence - FRAC_1_SQRT_2).abs() < 1e-8
        );
        // The heading is clockwise: a long box at 45 degrees reaches to the far right.
        let long = Shape::cuboid([0.0, 0.0, 0.0], [1.0, 20.0, 1.0], FRAC_PI_4);
        let down = Ray::new(Vec3::new(6.0, 6.0, 5.0), 0.0, -FRAC_PI_2);
        assert!(near(long.span(&down).unwrap().enter_m, 4.0));
        assert_eq!(
            long.span(&Ray::new(Vec3::new(-6.0, 6.0, 5.0), 0.0, -FRAC_PI_2)),
            None
        );
    }

    #[test]
    fn a_cylinder_is_met_on_its_side_and_on_its_top() {
        let cylinder = Shape::cylinder([0.0, 5.0, 0.0], 0.5, 3.0);
        let side = cylinder.span(&ray(0.0, 0.0)).unwrap();
        assert!(
            near(side.enter_m, 4.5) && near(side.leave_m, 5.5) && near(side.cos_incidence, 1.0)
        );
        // 0.3 m beside the axis: the chord begins sqrt(0.25 - 0.09) = 0.4 m before the axis, at
        // cosine 0.4 / 0.5.
        let beside = Ray::new(Vec3::new(0.3, 0.0, 2.0), 0.0, 0.0);
        let span = cylinder.span(&beside).unwrap();
        assert!(near(span.enter_m, 4.6) && near(span.cos_incidence, 0.8));
        let above = Ray::new(Vec3::new(0.0, 3.0, 5.0), 0.0, -FRAC_PI_4);
        assert!(near(cylinder.span(&above).unwrap().enter_m, 2.0 * SQRT_2));
        assert_eq!(
            cylinder.span(&Ray::new(Vec3::new(0.6, 0.0, 2.0), 0.0, 0.0)),
            None
        );
        assert_eq!(
            cylinder.span(&Ray::new(Vec3::new(0.0, 0.0, 3.1), 0.0, 0.0)),
            None
        );
    }

    #[test]
    fn a_sphere_and_an_ellipsoid_are_met_where_the_formula_says() {
        let sphere = Shape::ellipsoid([0.0, 10.0, 2.0], [2.0; 3]);
        let span = sphere.span(&ray(0.0, 0.0)).unwrap();
        assert!(
            near(span.enter_m, 8.0) && near(span.leave_m, 12.0) && near(span.cos_incidence, 1.0)
        );
        // 1.2 m beside the centre: sqrt(4 - 1.44) = 1.6 m before it, at cosine 1.6 / 2.
        let beside = Ray::new(Vec3::new(1.2, 0.0, 2.0), 0.0, 0.0);
        let span = sphere.span(&beside).unwrap();
        assert!(near(span.enter_m, 8.4) && near(span.cos_incidence, 0.8));
        let flat = Shape::ellipsoid([0.0, 10.0, 2.0], [3.0, 1.0, 0.5]);
        assert!(near(flat.span(&ray(0.0, 0.0)).unwrap().enter_m, 9.0));
        assert_eq!(
            flat.span(&Ray::new(Vec3::new(0.0, 0.0, 2.6), 0.0, 0.0)),
            None
        );
    }

    #[test]
    fn numbers_are_rounded_as_the_library_does() {
        for x in [
            0.0,
            0.499_999_999_999_999_94,
            0.5,
            1.5,
            2.499,
            2.5,
            65_535.4,
            1e15 + 0.5,
            250_199.999_999,
        ] {
            for x in [x, -x] {
                assert_eq!((rounded(x), floor(x)), (x.round(), x.floor()), "{x}");
            }
        }
    }

    #[test]
    fn the_brim_of_a_cuboid_is_between_a_larger_and_a_smaller_one() {
        let mut rng = fastrand::Rng::with_seed(2);
        let mut met = [0; 3];
        for _ in 0..20_000 {
            let shape = Shape::cuboid(
                [0.0, 9.0, 0.0],
                [3.0, 0.1 + rng.f64(), 4.0],
                rng.f64() * 7.0,
            );
            let ray = if rng.bool() {
                ray(0.0, 0.0)
            } else {
                ray(rng.f64() - 0.5, rng.f64() * 0.6 - 0.3)
            };
            let rim_m = rng.f64() * 0.3;
            let enter_m = |grown: Option<Shape>| Some(grown?.span(&ray)?.enter_m);
            let outer_m = enter_m(shape.grown(rim_m));
            let brim = shape.brim(&ray, rim_m);
            assert_eq!(brim.is_some(), outer_m.is_some());
            let Some(brim) = brim else { continue };
            let is_near =
                |a: Option<f64>, b: Option<f64>| a == b || (a.unwrap() - b.unwrap()).abs() < 1e-9;
            assert!(
                is_near(Some(brim.outer_m), outer_m)
                    && is_near(brim.core_m, enter_m(shape.grown(-rim_m)))
            );
            assert_eq!(brim.span, shape.span(&ray));
            met[usize::from(brim.span.is_some()) + usize::from(brim.core_m.is_some())] += 1;
        }
        assert!(met.iter().all(|&n| n > 100), "{met:?}");
    }

    #[test]
    fn every_ray_that_meets_a_shape_lies_within_its_bounds() {
        let eye = Vec3::new(0.0, 0.0, 2.0);
        let mut rng = fastrand::Rng::with_seed(1);
        for _ in 0..20_000 {
            let place = [
                rng.f64() * 40.0 - 20.0,
                rng.f64() * 40.0 - 20.0,
                rng.f64() * 3.0,
            ];
            let size = [
                0.1 + rng.f64() * 5.0,
                0.1 + rng.f64() * 9.0,
                0.1 + rng.f64() * 4.0,
            ];
            let shape = match rng.u8(0..3) {
                0 => Shape::cuboid(place, size, rng.f64() * 7.0),
                1 => Shape::cylinder(place, size[0], size[2]),
                _ => Shape::ellipsoid(place, size),
            };
            let bounds = shape.bounds();
            let [near, far] = bounds.reach(eye);
            if near == 0.0 {
                continue;
            }
            let (centre, edges) = bounds.azimuths(eye);
            let ray = ray(centre + (rng.f64() - 0.5) * 2.0, (rng.f64() - 0.5) * 0.8);
            let Some(span) = shape.span(&ray) else {
                continue;
            };
            let off = (ray.azimuth_rad - centre)
                .sin()
                .atan2((ray.azimuth_rad - centre).cos());
            assert!(
                edges[0] - 1e-9 <= off && off <= edges[1] + 1e-9,
                "{shape:?}: {off} not in {edges:?}"
            );
            let across = (ray.at(span.enter_m) - eye).xy().norm();
            assert!(
                near - 1e-9 <= across && across <= far + 1e-9,
                "{shape:?}: {across} not in {near}..{far}"
            );
            let edges = [ray.azimuth_rad - 0.004, ray.azimuth_rad + 0.003];
            let [near, far] = bounds
                .reach_between(eye, edges)
                .expect("the ray is between the edges");
            assert!(
                near - 1e-9 <= across && across <= far + 1e-9,
                "{shape:?}: {across} not in {near}..{far}"
            );
        }
    }
}
