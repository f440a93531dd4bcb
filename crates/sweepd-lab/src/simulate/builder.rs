//! Builder for scenes: a scene, a random generator, and common props.

use fastrand::Rng;

use super::props::{self, GroundPose, Prop};
use super::scene::{Class, Scene, Surface};
use super::shape::{Shape, Vec3};

/// A builder at work.
pub(super) struct Builder {
    pub scene: Scene,
    pub rng: Rng,
}

impl Builder {
    pub fn new(scene: Scene, seed: u64) -> Self {
        Self {
            scene,
            rng: Rng::with_seed(seed),
        }
    }

    pub fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.rng.f64()
    }

    pub fn chance(&mut self, probability: f64) -> bool {
        self.rng.f64() < probability
    }

    /// Adds a prop that stands still.
    pub fn put(&mut self, prop: Prop) {
        self.scene.add(prop.class, Vec3::zeros(), prop.solids);
    }

    /// Puts in one upright block.
    pub fn block(&mut self, class: Class, base: [f64; 3], size: [f64; 3], reflectivity: u8) {
        let shape = Shape::cuboid(base, size, 0.0);
        self.scene.add(
            class,
            Vec3::zeros(),
            [(shape, Surface::Plain(reflectivity))],
        );
    }

    /// Puts in one upright block from one to another coordinate of each axis.
    pub fn fill(&mut self, class: Class, [x, y, z]: [[f64; 2]; 3], reflectivity: u8) {
        let base = [(x[0] + x[1]) / 2.0, (y[0] + y[1]) / 2.0, z[0]];
        let extent = [x[1] - x[0], y[1] - y[0], z[1] - z[0]];
        self.block(class, base, extent, reflectivity);
    }

    /// Adds a prop that moves in the direction it faces.
    pub fn send(&mut self, speed_m_s: f64, prop: Prop) {
        let (sin, cos) = prop.place.heading_rad.sin_cos();
        let velocity = Vec3::new(sin, cos, 0.0) * speed_m_s;
        self.scene.add(prop.class, velocity, prop.solids);
    }

    pub fn paint(&mut self) -> u8 {
        *self
            .rng
            .choice(&[7, 12, 18, 25, 38, 52, 68, 80])
            .expect("there are colours")
    }

    /// A pedestrian, walking or standing.
    pub fn walker(&mut self, place: GroundPose) {
        let height_m = self.between(1.52, 1.92);
        let clothes = self.rng.u8(10..70);
        let speed_m_s = if self.chance(0.2) {
            0.0
        } else {
            self.between(0.9, 1.6)
        };
        self.send(speed_m_s, props::person(place, height_m, clothes));
    }
}
