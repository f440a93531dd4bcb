//! An empty field: gently sloping ground, a distant fence on one side, a few bushes and trees, and
//! a pedestrian. The difficulty is how few objects there are.

use std::f64::consts::TAU;

use super::builder::Builder;
use super::props::{self, GroundPose};
use super::scene::Surface::Plain;
use super::scene::{Class, Scene};
use super::shape::{Shape, Vec3};

/// Nothing stands nearer to the sensor than this.
const EMPTY_M: f64 = 11.0;

/// A field like any other; each seed gives another one.
pub fn field(seed: u64) -> Scene {
    let mut field = Builder::new(Scene::new([0.0; 2], 28), seed);
    field.scene.slope = [field.between(-0.015, 0.015), field.between(-0.02, 0.02)];
    fence(&mut field);
    for _ in 0..3 {
        let place = somewhere(&mut field, 28.0, 60.0);
        let size = field.between(0.9, 1.7);
        field.put(props::tree(place, size));
    }
    for _ in 0..5 {
        let place = somewhere(&mut field, 15.0, 45.0);
        let length_m = field.between(1.2, 3.5);
        field.put(props::hedge(place, length_m));
    }
    let place = somewhere(&mut field, EMPTY_M, 20.0);
    field.walker(place);
    field.scene
}

/// A place in a ring around the sensor, on this side of the fence.
fn somewhere(field: &mut Builder, near_m: f64, far_m: f64) -> GroundPose {
    let distance_m = field.between(near_m, far_m);
    let heading_rad = field.between(0.0, TAU);
    // Azimuths from 110 to 340 degrees: the fence is to the right ahead.
    let azimuth_rad = field.between(110.0, 340.0).to_radians();
    GroundPose::new(
        distance_m * azimuth_rad.sin(),
        distance_m * azimuth_rad.cos(),
        heading_rad,
    )
}

/// Posts and two rails along the right-hand side, at an angle.
fn fence(field: &mut Builder) {
    let distance_m = field.between(14.0, 20.0);
    let azimuth_rad = field.between(40.0, 80.0).to_radians();
    let posts = (-11..=11).map(|post| {
        let foot = along_fence(distance_m, azimuth_rad, f64::from(post) * 2.5, 0.0);
        (Shape::cylinder(foot, 0.07, 1.3), Plain(30))
    });
    // A rail's length lies along the fence: a quarter turn from the way out to it.
    let heading_rad = azimuth_rad + TAU / 4.0;
    let rails = [0.5, 1.05].map(|up| {
        let base = along_fence(distance_m, azimuth_rad, 0.0, up);
        (
            Shape::cuboid(base, [0.05, 55.0, 0.12], heading_rad),
            Plain(38),
        )
    });
    let solids = posts.chain(rails);
    field.scene.add(Class::Furniture, Vec3::zeros(), solids);
}

/// A place on a line that is at its nearest at a distance and an azimuth.
fn along_fence(distance_m: f64, azimuth_rad: f64, along_m: f64, up: f64) -> [f64; 3] {
    let (sin, cos) = azimuth_rad.sin_cos();
    [
        distance_m * sin + along_m * cos,
        distance_m * cos - along_m * sin,
        up,
    ]
}
