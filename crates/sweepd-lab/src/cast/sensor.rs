//! A sensor of the product at some mount, and what it makes of a scene.

use std::f64::consts::{PI, TAU};

use fastrand::Rng;
use sweepd_core::buffers::{Buffers, HeapBuffer, HeapBuffers};
use sweepd_core::segment::{Config, Mount, Segmenter};
use sweepd_core::sensor::{Beam, Model, ModelExt};
use sweepd_core::sweep::layout::flags;
use sweepd_core::sweep::{Column, Pose, Shape, SweepMut};
use sweepd_core::wire::data::ReturnMode;

use super::{Found, Ray, Scene, Solid, View, What};

/// Turning rate, radians a second: 600 rpm.
pub(super) const RATE_RAD_S: f64 = 10.0 * TAU;

/// A sensor that turns at 600 rpm and sends one return a shot.
#[derive(Clone, Debug)]
pub struct Sensor {
    /// What it is.
    pub model: Model,
    /// Its height above the floor, metres.
    pub height_m: f64,
    /// Nose up, radians.
    pub pitch_rad: f64,
    /// Right side down, radians.
    pub roll_rad: f64,
    /// Height of a step that the wheels climb, metres.
    pub climb_m: f64,
    /// How much more its pitch is told to be, radians.
    pub pitch_error_rad: f64,
    /// Standard deviation of its ranges, metres.
    pub noise_m: f64,
    /// Of the noise.
    pub seed: u64,
    beams: Vec<Beam>,
    buffers: HeapBuffers,
    segmenter: Option<Segmenter>,
}

/// Part of a turn, radians.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sector {
    /// Azimuth of its middle, clockwise from straight ahead.
    pub middle_rad: f64,
    /// How far it reaches to either side.
    pub half_rad: f64,
    /// How far its first column stands behind its beginning, 0 to 1, in columns.
    pub phase: f64,
}

impl Sector {
    /// A whole turn.
    pub const TURN: Self = Self {
        middle_rad: PI,
        half_rad: PI,
        phase: 0.0,
    };
    /// What is seen beside a solid, radians.
    const BESIDE_RAD: f64 = 0.35;

    /// The part of a turn in which an upright sensor sees these solids, and some floor beside them.
    pub fn around(solids: &[Solid]) -> Self {
        let middles_m = solids.iter().map(Solid::middle_m);
        let [x, y] = middles_m.fold([0.0; 2], |sum, m| [sum[0] + m[0], sum[1] + m[1]]);
        let middle_rad = x.atan2(y);
        let half_rad = solids.iter().map(|solid| {
            let [x, y] = solid.middle_m();
            let aside_rad = (x.atan2(y) - middle_rad + PI).rem_euclid(TAU) - PI;
            let half_rad = (solid.reach_m() / x.hypot(y)).min(1.0).asin();
            aside_rad.abs() + half_rad + Self::BESIDE_RAD
        });
        Self {
            middle_rad,
            half_rad: half_rad.fold(0.0, f64::max).min(PI),
            phase: 0.0,
        }
    }
}

/// Beams from the highest down. All of a column point the same way, as the rows of an image do once
/// they are shifted. Each HDL-64E has a calibration of its own: this one is as the maker draws it.
fn beams(model: Model) -> Vec<Beam> {
    let Some(calibration) = model.calibration() else {
        let rows = 0..model.spec().channels;
        return rows
            .map(|row| Beam::ideal(row, elevation_rad(row)))
            .collect();
    };
    let mut beams = calibration.beams().to_vec();
    beams.sort_by(|a, b| b.elevation_rad.total_cmp(&a.elevation_rad));
    for beam in &mut beams {
        (beam.rotation_rad, beam.horizontal_offset_m) = (0.0, 0.0);
    }
    beams
}

/// Of a row of an HDL-64E: the upper head's beams are a third of a degree apart, the lower's half.
fn elevation_rad(row: usize) -> f64 {
    let elevation_deg = match row {
        0..32 => 2.0 - row as f64 / 3.0,
        _ => -8.83 - (row - 32) as f64 / 2.0,
    };
    elevation_deg.to_radians()
}

impl Sensor {
    /// An upright sensor with noise of 1 cm, at this height above the floor, metres.
    pub fn new(model: Model, height_m: f64) -> Self {
        Self {
            model,
            height_m,
            pitch_rad: 0.0,
            roll_rad: 0.0,
            climb_m: f64::from(Config::default().climb_m),
            pitch_error_rad: 0.0,
            noise_m: 0.01,
            seed: 1,
            beams: beams(model),
            buffers: HeapBuffers::default(),
            segmenter: None,
        }
    }

    /// How far columns are apart, radians.
    pub fn pitch_of_columns_rad(&self) -> f64 {
        let period_ns = self.model.spec().firing_period_ns(ReturnMode::Strongest);
        RATE_RAD_S * f64::from(period_ns) * 1e-9
    }

    /// The sensor in the frame of the robot.
    pub(super) fn pose(&self) -> Pose {
        let angles_rad = [0.0, self.pitch_rad, self.roll_rad];
        Pose::mounted(
            [0.0, 0.0, self.height_m as f32],
            angles_rad.map(|angle| angle as f32),
        )
    }

    /// The beams, from the highest down.
    pub(super) fn beams(&self) -> &[Beam] {
        &self.beams
    }

    /// What a beam measures at an azimuth, metres, what it met, and at which height over the floor.
    /// Whole units of the sensor, as in its packets. The pose is the sensor's.
    pub(super) fn shoot(
        &self,
        scene: &Scene,
        pose: &Pose,
        beam: &Beam,
        azimuth_rad: f64,
        rng: &mut Rng,
    ) -> Option<(f64, What, f64)> {
        let (sin_a, cos_a) = azimuth_rad.sin_cos();
        let (sin_e, cos_e) = beam.elevation_rad.sin_cos();
        let along = [cos_e * sin_a, cos_e * cos_a, sin_e];
        // Origins differ in height alone.
        let from_m = pose.apply([0.0, 0.0, beam.vertical_offset_m]);
        let to_m = pose.apply([along[0], along[1], along[2] + beam.vertical_offset_m]);
        let ray = Ray {
            from_m,
            along: [0, 1, 2].map(|axis| to_m[axis] - from_m[axis]),
        };
        let (away_m, what) = scene.meets(&ray)?;
        let unit_m = self.model.spec().distance_unit_m;
        let units = ((away_m + self.noise_m * normal(rng)) / unit_m).round();
        let is_measured = (1.0..=f64::from(u16::MAX)).contains(&units);
        is_measured.then(|| (units * unit_m, what, from_m[2] + away_m * ray.along[2]))
    }

    /// What it sees of a scene in a sector, as the segmenter labels it with this mount.
    pub fn look(&mut self, scene: &Scene, sector: &Sector) -> View {
        let (mut buffer, mut found) = self.scan(scene, sector);
        let mut sweep = SweepMut::open(buffer.as_mut()).expect("made just now");
        self.segmenter().segment(&mut sweep);
        let rows = self.beams.len();
        for one in &mut found {
            one.label = sweep.label[one.column * rows + one.row];
        }
        View(found)
    }

    /// What it sees of a scene in a sector, without labels, and what each return lies on.
    pub fn scan(&mut self, scene: &Scene, sector: &Sector) -> (HeapBuffer, Vec<Found>) {
        let (step_rad, rows) = (self.pitch_of_columns_rad(), self.beams.len());
        let columns = (2.0 * sector.half_rad / step_rad) as usize;
        let shape = Shape {
            rows,
            columns_capacity: columns,
            dual: false,
            segments_capacity: rows * columns,
        };
        let mut buffer = self.buffers.take(shape.total_bytes());
        let sweep = SweepMut::create(buffer.as_mut(), &shape).expect("taken for this shape");
        sweep.header.columns = columns as u32;
        sweep.header.flags = match sector.half_rad >= PI {
            true => flags::CIRCULAR,
            false => 0,
        };
        for (row, beam) in sweep.beams.iter_mut().zip(&self.beams) {
            *row = beam.row(0);
        }
        let (pose, mut rng) = (self.pose(), Rng::with_seed(self.seed));
        let mut found = Vec::new();
        for column in 0..columns {
            let start_rad = sector.middle_rad - sector.half_rad;
            let azimuth_rad =
                (start_rad + (column as f64 + sector.phase) * step_rad).rem_euclid(TAU);
            sweep.columns[column] =
                Column::measured(0, 0, azimuth_rad as f32, RATE_RAD_S as f32, 0);
            for (row, beam) in self.beams.iter().enumerate() {
                let shot = self.shoot(scene, &pose, beam, azimuth_rad, &mut rng);
                sweep.range[column * rows + row] = shot.map_or(0.0, |(range_m, ..)| range_m as f32);
                found.extend(shot.map(|(range_m, what, height_m)| Found {
                    row,
                    column,
                    range_m,
                    height_m,
                    what,
                    label: 0,
                }));
            }
        }
        (buffer, found)
    }

    /// The product's, with nothing set but the mount and what wheels climb. It keeps its memory from look to look, and
    /// nothing else.
    fn segmenter(&mut self) -> &mut Segmenter {
        let mount = Mount {
            height_m: Some(self.height_m as f32),
            pitch_rad: (self.pitch_rad + self.pitch_error_rad) as f32,
            roll_rad: self.roll_rad as f32,
        };
        let config = Config {
            mount,
            climb_m: self.climb_m as f32,
            ..Config::default()
        };
        let kept = self.segmenter.take();
        let segmenter = match kept.filter(|kept| *kept.config() == config) {
            Some(kept) => kept,
            None => Segmenter::new(config).expect("the default with a mount"),
        };
        self.segmenter.insert(segmenter)
    }
}

/// A number of the normal distribution, by the method of Box and Muller.
fn normal(rng: &mut Rng) -> f64 {
    (-2.0 * (1.0 - rng.f64()).ln()).sqrt() * (TAU * rng.f64()).cos()
}
