//! Boxes, sensors and mounts that are drawn at random.

use std::f64::consts::{PI, TAU};
use std::fmt::{self, Display, Formatter};

use fastrand::Rng;
use sweepd_core::sensor::Model;

use super::{Scene, Sector, Sensor, Solid, View};

/// How a box is hard to see.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Kind {
    /// 0.7 m wide or deep and more, and 0.2 m high at most: a column sees a kerb and a pavement.
    DeepAndLow,
    /// As high, and not so deep.
    Low,
    /// Any other.
    Other,
}

/// A box, and the sensor that may see it.
#[derive(Clone, Debug)]
pub struct Drawn {
    /// The sensor at its mount.
    pub sensor: Sensor,
    /// The box.
    pub solid: Solid,
}

impl Drawn {
    /// The sensors that are drawn: one of each set of beams.
    pub const MODELS: [Model; 5] = [
        Model::Vlp16,
        Model::Hdl32e,
        Model::Vlp32c,
        Model::Hdl64eS2,
        Model::Vls128,
    ];

    /// Draws a box by this number: a mount of 0.2 to 2.5 m, tilted by up to 15 degrees, a box 0.15 to
    /// 1.2 m wide and deep, up to 0.5 m high and 10 m away. Noise is 1 cm, and 3 cm with every third
    /// one, which is 0.25 m high and more and not 0.15.
    pub fn new(number: u64) -> Self {
        let rng = &mut Rng::with_seed(number);
        let is_noisy = number / 5 % 3 == 2;
        let model = Self::MODELS[number as usize % 5];
        let mut sensor = Sensor::new(model, within(rng, 0.2, 2.5));
        let tilt_rad = within(rng, 0.0, 15_f64.to_radians());
        let towards_rad = within(rng, 0.0, TAU);
        sensor.pitch_rad = tilt_rad * towards_rad.cos();
        sensor.roll_rad = tilt_rad * towards_rad.sin();
        sensor.noise_m = if is_noisy { 0.03 } else { 0.01 };
        sensor.seed = number;
        let least_m = if is_noisy { 0.25 } else { 0.15 };
        let size_m = [
            within(rng, 0.15, 1.2),
            within(rng, 0.15, 1.2),
            within(rng, least_m, 0.5),
        ];
        let clear_m = size_m[0].hypot(size_m[1]) / 2.0 + 0.3;
        let away_m = within(rng, clear_m.ln(), 10_f64.ln()).exp();
        let azimuth_rad = within(rng, 0.0, TAU);
        let solid = Solid::Cuboid {
            middle_m: [away_m * azimuth_rad.sin(), away_m * azimuth_rad.cos()],
            size_m,
            yaw_rad: within(rng, 0.0, PI),
        };
        Self { sensor, solid }
    }

    /// What the sensor sees of it.
    pub fn look(&mut self) -> View {
        self.sensor
            .look(&Scene::with(vec![self.solid]), &Sector::TURN)
    }

    /// What makes it hard to see.
    pub fn kind(&self) -> Kind {
        match self.solid {
            Solid::Cuboid {
                size_m: [width_m, depth_m, height_m],
                ..
            } if height_m <= 0.2 => match width_m.max(depth_m) >= 0.7 {
                true => Kind::DeepAndLow,
                false => Kind::Low,
            },
            _ => Kind::Other,
        }
    }
}

/// Drawn evenly.
fn within(rng: &mut Rng, least: f64, most: f64) -> f64 {
    least + (most - least) * rng.f64()
}

/// What it takes to draw it again, and to judge it.
impl Display for Drawn {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        let sensor = &self.sensor;
        let [x, y] = self.solid.middle_m();
        write!(
            f,
            "{}: {:?}, {} {:.1} m up, pitch {:.0}, roll {:.0} degrees, noise {} m",
            sensor.seed,
            self.kind(),
            sensor.model,
            sensor.height_m,
            sensor.pitch_rad.to_degrees(),
            sensor.roll_rad.to_degrees(),
            sensor.noise_m
        )?;
        let Solid::Cuboid { size_m, .. } = self.solid else {
            return Ok(());
        };
        let [width_m, depth_m, height_m] = size_m;
        let away_m = x.hypot(y);
        write!(
            f,
            "; {width_m:.2} x {depth_m:.2} x {height_m:.2} m, {away_m:.1} m away"
        )
    }
}
