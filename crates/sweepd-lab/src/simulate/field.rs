//! An empty field: gently sloping ground, a fence far off on one side, a few bushes and trees, and
//! somebody with a way to go. What is hard here is how little there is.

use std::f64::consts::TAU;

use super::builder::Builder;
use super::props::{self, GroundPose};
use super::scene::Surface::Plain;
use super::scene::{Class, Scene};
use super::shape::Shape;

/// Nothing stands nearer to the sensor than this.
const EMPTY_M: f64 = 11.0;

/// A field like any other; each seed gives another one.
pub fn field(seed: u64) -> Scene {
    let mut field = Builder::new(Scene::new([0.0; 2], 28), seed);
    field.scene.slope = [field.between(-0.015, 0.015), field.between(-0.02, 0.02)];
    fence(&mut field);
    for _ in 0..3 {
        let (place, size) = (somewhere(&mut field, 28.0, 60.0), field.between(0.9, 1.7));
        field.put(Class::Tree, props::tree(place, size));
    }
    for _ in 0..5 {
        let (place, length_m) = (somewhere(&mut field, 15.0, 45.0), field.between(1.2, 3.5));
        field.put(Class::Tree, props::hedge(place, length_m));
    }
    let place = somewhere(&mut field, EMPTY_M, 20.0);
    field.walker(place);
    field.scene
}

/// A place in a ring around the sensor, on this side of the fence.
fn somewhere(field: &mut Builder, near_m: f64, far_m: f64) -> GroundPose {
    let (distance_m, heading_rad) = (field.between(near_m, far_m), field.between(0.0, TAU));
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
    let (distance_m, azimuth_rad) = (
        field.between(14.0, 20.0),
        field.between(40.0, 80.0).to_radians(),
    );
    let (sin, cos) = azimuth_rad.sin_cos();
    let at = |along_m: f64, up: f64| {
        [
            distance_m * sin + along_m * cos,
            distance_m * cos - along_m * sin,
            up,
        ]
    };
    let posts = (-11..=11).map(|post| {
        (
            Shape::cylinder(at(f64::from(post) * 2.5, 0.0), 0.07, 1.3),
            Plain(30),
        )
    });
    // A rail's length lies along the fence: a quarter turn from the way out to it.
    let heading_rad = azimuth_rad + TAU / 4.0;
    let rails = [0.5, 1.05].map(|up| {
        (
            Shape::cuboid(at(0.0, up), [0.05, 55.0, 0.12], heading_rad),
            Plain(38),
        )
    });
    field.put(Class::Furniture, posts.chain(rails).collect());
}
