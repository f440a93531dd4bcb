//! What stands where, and where a ray meets it.

/// A ray: from a point, metres, into a direction of length 1; axes as in [`Scene`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ray {
    /// Where it begins.
    pub from_m: [f64; 3],
    /// Where it goes.
    pub along: [f64; 3],
}

/// What a return lies on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum What {
    /// A piece of the [`Ground`], from 0, the nearest.
    Ground(usize),
    /// A solid, by its place in [`Scene::solids`].
    Solid(usize),
    /// A wall, or the ceiling.
    Wall,
}

/// The ground as it is seen from the side: corners (y, z) ahead of the sensor, metres, with straight
/// pieces between them, the same for all x. It is level before the first corner and behind the
/// last.
#[derive(Clone, Debug, PartialEq)]
pub struct Ground(pub Vec<[f64; 2]>);

/// A solid that stands upright on the ground below its middle; lengths in metres.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Solid {
    /// A box.
    Cuboid {
        /// x and y of its middle.
        middle_m: [f64; 2],
        /// Width, depth and height.
        size_m: [f64; 3],
        /// Turned counter-clockwise from above, radians.
        yaw_rad: f64,
    },
    /// An upright cylinder.
    Cylinder {
        /// x and y of its axis.
        middle_m: [f64; 2],
        /// Its radius.
        radius_m: f64,
        /// Its height.
        height_m: f64,
    },
}

/// What there is to see.
#[derive(Clone, Debug, PartialEq)]
pub struct Scene {
    /// The ground.
    pub ground: Ground,
    /// What stands on it.
    pub solids: Vec<Solid>,
    /// How far the four walls are from the middle, metres; infinite where there are none.
    pub walls_m: f64,
    /// How high the ceiling is, metres; infinite where there is none.
    pub ceiling_m: f64,
}

/// Level ground ends here, metres.
const EDGE_M: f64 = 1e4;

impl Ground {
    /// A floor.
    pub fn level() -> Self {
        Self(vec![[0.0, 0.0]])
    }

    /// Height of the ground at a y, metres.
    fn height_m(&self, y: f64) -> f64 {
        let behind = self.0.partition_point(|corner| corner[0] <= y);
        match (&self.0[..behind], &self.0[behind..]) {
            (&[.., [near, low]], &[[far, high], ..]) => {
                low + (high - low) * (y - near) / (far - near)
            }
            (&[.., [_, z]], []) | ([], &[[_, z], ..]) => z,
            ([], []) => 0.0,
        }
    }

    /// Where a ray first meets it, metres along the ray, and which piece.
    fn meets(&self, ray: &Ray) -> Option<(f64, What)> {
        let (first, last) = (self.0.first()?, self.0.last()?);
        let ends = ([-EDGE_M, first[1]], [EDGE_M, last[1]]);
        let starts = std::iter::once(&ends.0).chain(&self.0);
        let pieces = starts.zip(self.0.iter().chain(std::iter::once(&ends.1)));
        let met = pieces.enumerate().filter_map(|(piece, (start, end))| {
            let along = [end[0] - start[0], end[1] - start[1]];
            // Of length |along|, upwards or towards the sensor.
            let normal = [-along[1], along[0]];
            let towards = normal[0] * ray.along[1] + normal[1] * ray.along[2];
            let off =
                normal[0] * (start[0] - ray.from_m[1]) + normal[1] * (start[1] - ray.from_m[2]);
            let away_m = off / towards;
            let y = ray.from_m[1] + away_m * ray.along[1] - start[0];
            let z = ray.from_m[2] + away_m * ray.along[2] - start[1];
            let way = y * along[0] + z * along[1];
            let is_met = towards < 0.0 && away_m > 0.0 && (0.0..=dot(along, along)).contains(&way);
            is_met.then_some((away_m, What::Ground(piece)))
        });
        met.min_by(|a, b| a.0.total_cmp(&b.0))
    }
}

impl Solid {
    /// Distance along a ray at which it enters the solid, which stands at this height, metres.
    fn meets(&self, ray: &Ray, foot_m: f64) -> Option<f64> {
        let middle_m = self.middle_m();
        let from = [ray.from_m[0] - middle_m[0], ray.from_m[1] - middle_m[1]];
        let along = [ray.along[0], ray.along[1]];
        let (within, height_m) = match *self {
            Self::Cuboid {
                size_m, yaw_rad, ..
            } => {
                let (from, along) = (turned(from, -yaw_rad), turned(along, -yaw_rad));
                let x = between(from[0], along[0], -size_m[0] / 2.0, size_m[0] / 2.0);
                let y = between(from[1], along[1], -size_m[1] / 2.0, size_m[1] / 2.0);
                (common(x, y), size_m[2])
            }
            Self::Cylinder {
                radius_m, height_m, ..
            } => (around(from, along, radius_m), height_m),
        };
        let upright = between(ray.from_m[2], ray.along[2], foot_m, foot_m + height_m);
        let [enters_m, leaves_m] = common(within, upright);
        (enters_m <= leaves_m && enters_m > 0.0).then_some(enters_m)
    }

    /// How far the solid reaches from its middle to the side, metres.
    pub fn reach_m(&self) -> f64 {
        match *self {
            Self::Cuboid { size_m, .. } => size_m[0].hypot(size_m[1]) / 2.0,
            Self::Cylinder { radius_m, .. } => radius_m,
        }
    }

    /// x and y of its middle, metres.
    pub fn middle_m(&self) -> [f64; 2] {
        match *self {
            Self::Cuboid { middle_m, .. } | Self::Cylinder { middle_m, .. } => middle_m,
        }
    }
}

/// The part of a ray between two values of one axis: from, to, along the ray.
fn between(from: f64, along: f64, low: f64, high: f64) -> [f64; 2] {
    let (a, b) = ((low - from) / along, (high - from) / along);
    [a.min(b), a.max(b)]
}

/// The part of a ray within a circle around the origin; none is from infinity on.
fn around(from: [f64; 2], along: [f64; 2], radius: f64) -> [f64; 2] {
    let (a, b) = (dot(along, along), dot(from, along));
    let root = (b * b - a * (dot(from, from) - radius * radius)).sqrt();
    match root.is_nan() {
        true => [f64::INFINITY, f64::NEG_INFINITY],
        false => [(-b - root) / a, (-b + root) / a],
    }
}

fn dot(a: [f64; 2], b: [f64; 2]) -> f64 {
    a[0] * b[0] + a[1] * b[1]
}

/// Turned counter-clockwise.
fn turned(at: [f64; 2], by_rad: f64) -> [f64; 2] {
    let (sin, cos) = by_rad.sin_cos();
    [cos * at[0] - sin * at[1], sin * at[0] + cos * at[1]]
}

/// What two parts of a ray have in common.
fn common(a: [f64; 2], b: [f64; 2]) -> [f64; 2] {
    [a[0].max(b[0]), a[1].min(b[1])]
}

impl Scene {
    /// A floor with these solids, without walls.
    pub fn with(solids: Vec<Solid>) -> Self {
        Self {
            ground: Ground::level(),
            solids,
            walls_m: f64::INFINITY,
            ceiling_m: f64::INFINITY,
        }
    }

    /// Ground of this form, and nothing on it.
    pub fn of_ground(ground: Ground) -> Self {
        Self {
            ground,
            ..Self::with(Vec::new())
        }
    }

    /// What a ray meets first, and how far along it, metres.
    pub fn meets(&self, ray: &Ray) -> Option<(f64, What)> {
        let solids = self.solids.iter().enumerate();
        let solids = solids.filter_map(|(solid, of)| {
            let foot_m = self.ground.height_m(of.middle_m()[1]);
            Some((of.meets(ray, foot_m)?, What::Solid(solid)))
        });
        let walls = [0, 1].map(|axis| {
            let wall_m = self.walls_m.copysign(ray.along[axis]);
            ((wall_m - ray.from_m[axis]) / ray.along[axis], What::Wall)
        });
        let ceiling_m = (self.ceiling_m - ray.from_m[2]) / ray.along[2];
        let around = walls.into_iter().chain([(ceiling_m, What::Wall)]);
        let around = around.filter(|(away_m, _)| away_m.is_finite() && *away_m > 0.0);
        let met = solids.chain(around).chain(self.ground.meets(ray));
        met.min_by(|a, b| a.0.total_cmp(&b.0))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// From 1 m above the origin, ahead and down by these metres.
    fn ray(right: f64, ahead: f64, down: f64) -> Ray {
        let length = (right * right + ahead * ahead + down * down).sqrt();
        Ray {
            from_m: [0.0, 0.0, 1.0],
            along: [right / length, ahead / length, -down / length],
        }
    }

    #[track_caller]
    fn meets(scene: &Scene, ray: Ray, at_m: [f64; 3], what: What) {
        let (away_m, found) = scene.meets(&ray).unwrap();
        assert_eq!(found, what);
        for (axis, at_m) in at_m.into_iter().enumerate() {
            assert!((ray.from_m[axis] + away_m * ray.along[axis] - at_m).abs() < 1e-9);
        }
    }

    #[test]
    fn rays_meet_what_is_nearest() {
        let cuboid = Solid::Cuboid {
            middle_m: [0.0, 3.0],
            size_m: [2.0_f64.sqrt(), 2.0_f64.sqrt(), 0.5],
            yaw_rad: std::f64::consts::FRAC_PI_4,
        };
        let cylinder = Solid::Cylinder {
            middle_m: [0.0, -2.0],
            radius_m: 0.5,
            height_m: 1.5,
        };
        let mut scene = Scene::with(vec![cuboid, cylinder]);
        scene.walls_m = 8.0;
        // A corner, the top, past it, the side of the cylinder, its top from above, past it.
        meets(
            &scene,
            ray(0.0, 2.0, 0.75),
            [0.0, 2.0, 0.25],
            What::Solid(0),
        );
        meets(&scene, ray(0.0, 3.0, 0.5), [0.0, 3.0, 0.5], What::Solid(0));
        meets(&scene, ray(2.0, 3.0, 1.0), [2.0, 3.0, 0.0], What::Ground(1));
        meets(
            &scene,
            ray(0.0, -1.5, 0.0),
            [0.0, -1.5, 1.0],
            What::Solid(1),
        );
        meets(&scene, ray(0.0, -8.0, -4.0), [0.0, -8.0, 5.0], What::Wall);
        meets(&scene, ray(-8.0, 0.0, 0.5), [-8.0, 0.0, 0.5], What::Wall);
        assert_eq!(Scene::with(vec![]).meets(&ray(0.0, 1.0, -0.1)), None);
    }

    #[test]
    fn ground_rises_and_falls_ahead() {
        let corners = vec![[2.0, 0.0], [2.0, 0.2], [4.0, 0.4], [4.0, -0.2]];
        let scene = Scene::of_ground(Ground(corners));
        meets(&scene, ray(0.0, 1.0, 1.0), [0.0, 1.0, 0.0], What::Ground(0));
        meets(&scene, ray(0.0, 2.0, 0.9), [0.0, 2.0, 0.1], What::Ground(1));
        meets(&scene, ray(0.0, 3.0, 0.7), [0.0, 3.0, 0.3], What::Ground(2));
        // Over the edge, whose face cannot be seen from here.
        meets(
            &scene,
            ray(1.0, 10.0, 1.2),
            [1.0, 10.0, -0.2],
            What::Ground(4),
        );
    }

    /// By hand: the ground falls by 0.1 a metre from 2 m on, then by a step to -0.5.
    #[test]
    fn solids_stand_on_the_ground_below_them() {
        let corners = vec![[2.0, 0.0], [4.0, -0.2], [4.0, -0.5]];
        for (y, z) in [
            (0.0, 0.0),
            (2.0, 0.0),
            (3.0, -0.1),
            (3.75, -0.175),
            (4.3, -0.5),
            (9.0, -0.5),
        ] {
            assert!(
                (Ground(corners.clone()).height_m(y) - z).abs() < 1e-9,
                "{y}"
            );
            let mut scene = Scene::of_ground(Ground(corners.clone()));
            scene.solids = vec![Solid::Cylinder {
                middle_m: [0.0, y],
                radius_m: 0.05,
                height_m: 0.25,
            }];
            // Onto its top, steeply.
            let ray = Ray {
                from_m: [0.0, y - 0.1, z + 0.25 + (1.0_f64 - 0.01).sqrt()],
                along: [0.0, 0.1, -(1.0_f64 - 0.01).sqrt()],
            };
            meets(&scene, ray, [0.0, y, z + 0.25], What::Solid(0));
        }
    }
}
