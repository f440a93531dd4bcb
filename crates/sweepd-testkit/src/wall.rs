//! A wall that a moving sensor passes.

use sweepd::sensor::Model;
use sweepd::sweep::Pose;
use sweepd::wire::data::ReturnMode;
use sweepd_lab::simulate::optics::Optics;
use sweepd_lab::simulate::scene::Surface;
use sweepd_lab::simulate::shape::{Shape, Vec3};
use sweepd_lab::simulate::unit::unit;
use sweepd_lab::simulate::{Class, EmitterConfig, Motion, Pose as Start, Scene};

/// The near side of the wall, metres to the right of where the robot starts.
const WALL_M: f64 = 8.0;
/// To the right and ahead, metres a second.
pub const VELOCITY: [f64; 2] = [2.0, 10.0];
/// Clockwise, radians a second.
pub const TURN: f64 = 0.5;
/// How the sensor sits over the robot's origin: metres above it, radians to the left.
pub const MOUNT: (f32, f32) = (1.9, 0.35);

/// The scene, and a sensor in it that measures without noise.
pub fn drive(model: Model) -> (Scene, EmitterConfig) {
    let (up_m, yaw_rad) = MOUNT;
    let mut scene = Scene::new([0.0; 2], 20);
    let wall = Shape::cuboid([WALL_M + 0.5, 0.0, 0.0], [1.0, 400.0, 12.0], 0.0);
    scene.add(Class::Building, Vec3::zeros(), [(wall, Surface::Plain(60))]);
    let mut emitter = EmitterConfig::new(model, ReturnMode::Strongest);
    emitter.calibration = model.is_hdl64e().then(|| unit(1));
    // From 25.04 m on an HDL-64E has other corrections: ranges there may be on either side.
    emitter.optics = Optics::perfect(24.0);
    emitter.encoder.jitter_deg = 0.0;
    emitter.pose = Start {
        heading_rad: -f64::from(yaw_rad),
        ..Start::upright(Vec3::new(0.0, 0.0, up_m.into()))
    };
    emitter.motion = Motion {
        velocity: Vec3::new(VELOCITY[0], VELOCITY[1], 0.0),
        turn_rad_s: TURN,
    };
    (scene, emitter)
}

/// The robot in the scene.
pub fn robot(start_ns: i64, time_ns: i64) -> Pose {
    let seconds = (time_ns - start_ns) as f64 * 1e-9;
    let [x, y] = VELOCITY.map(|each| each * seconds);
    let (sin, cos) = (-TURN * seconds / 2.0).sin_cos();
    Pose::new([x, y, 0.0], [0.0, 0.0, sin, cos])
}

/// How far points of the wall are off it at most, and how many there are.
pub fn off_the_wall(points: impl Iterator<Item = [f64; 3]>) -> (f64, usize) {
    // All else is level ground.
    let of_wall = points.filter(|[_, _, up_m]| *up_m > 0.2);
    of_wall.fold((0.0, 0), |(most, count), [x, _, _]| {
        ((x - WALL_M).abs().max(most), count + 1)
    })
}
