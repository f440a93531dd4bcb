//! A wall that a moving sensor passes: bent as it is measured, flat once each point is where the
//! sensor was at its shot; the same points in Rust, C, C++ and Python.

use std::path::{Path, PathBuf};
use std::process::Command;
use sweepd_lab::testkit::stream::next_sweep;

use sweepd::buffers::HeapBuffer;
use sweepd::buffers::{HeapBuffers, Memory};
use sweepd::pipeline::{Config, Pipeline};
use sweepd::sensor::Model;
use sweepd::sweep::layout::is_return;
use sweepd::sweep::{Pose, SweepRef};
use sweepd::wire::data::ReturnMode;
use sweepd_lab::simulate::optics::Optics;
use sweepd_lab::simulate::scene::Surface;
use sweepd_lab::simulate::shape::{Shape, Vec3};
use sweepd_lab::simulate::unit::unit;
use sweepd_lab::simulate::{Class, Emitter, EmitterConfig, Motion, Pose as Start, Scene};

use super::common::{PYTHON_PACKAGE, python_with_iceoryx2};
use super::native::{programs, run};
use super::{folder, of_project};

/// The near side of the wall, metres to the right of where the robot starts.
const WALL_M: f64 = 8.0;
/// To the right and ahead, metres a second.
const VELOCITY: [f64; 2] = [2.0, 10.0];
/// Clockwise, radians a second.
const TURN: f64 = 0.5;
/// How the sensor sits over the robot's origin: metres above it, radians to the left.
const MOUNT: (f32, f32) = (1.9, 0.35);

/// Sweeps beside the wall, measured without noise, and when the robot was at the origin.
fn sweeps(model: Model) -> (Vec<HeapBuffer>, i64) {
    let (up_m, yaw_rad) = MOUNT;
    let mut scene = Scene::new([0.0; 2], 20);
    let wall = Shape::cuboid([WALL_M + 0.5, 0.0, 0.0], [1.0, 400.0, 12.0], 0.0);
    scene.add(Class::Building, Vec3::zeros(), [(wall, Surface::Plain(60))]);
    let mut emitter = EmitterConfig::new(model, ReturnMode::Strongest);
    let calibration = model.is_hdl64e().then(|| unit(1));
    emitter.calibration.clone_from(&calibration);
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
    let config = Config {
        calibration,
        position_m: [0.0, 0.0, up_m],
        yaw_rad,
        ..Config::default()
    };
    let start_ns = emitter.start_utc_ns;
    let mut pipeline = Pipeline::new("192.168.1.201:2368", config).unwrap();
    let mut memory = Memory::new(HeapBuffers::default());
    let mut sweeps = Vec::new();
    for sent in Emitter::new(emitter.turns(4.2), &scene) {
        if let Ok(packet) = sent.datagram().parse() {
            pipeline.push(&packet);
        }
        sweeps.extend(std::iter::from_fn(|| {
            next_sweep(&mut pipeline, &mut memory)
        }));
    }
    assert!(sweeps.len() > 2);
    (sweeps, start_ns)
}

/// The robot in the scene.
fn robot(start_ns: i64, time_ns: i64) -> Pose {
    let seconds = (time_ns - start_ns) as f64 * 1e-9;
    let [x, y] = VELOCITY.map(|each| each * seconds);
    let (sin, cos) = (-TURN * seconds / 2.0).sin_cos();
    Pose::new([x, y, 0.0], [0.0, 0.0, sin, cos])
}

/// How far points of the wall are off it at most, and how many there are.
fn off_the_wall(points: impl Iterator<Item = [f64; 3]>) -> (f64, usize) {
    // All else is level ground.
    let of_wall = points.filter(|[_, _, up_m]| *up_m > 0.2);
    of_wall.fold((0.0, 0), |(most, count), [x, _, _]| {
        ((x - WALL_M).abs().max(most), count + 1)
    })
}

#[test]
#[cfg_attr(
    any(without_compilers, without_python),
    ignore = "no compilers, or no SWEEPD_PYTHON"
)]
fn a_wall_is_flat_where_each_point_is_moved_by_the_pose_at_its_shot() {
    let file = folder("wall_sweep").join("sweep");
    let programs = programs("wall");
    for model in [Model::Vlp16, Model::Hdl64eS3] {
        let (sweeps, start_ns) = sweeps(model);
        for sweep in &sweeps[1..] {
            let view = SweepRef::open(sweep.as_ref()).unwrap();
            let mount = Pose::of_mount(view.header);
            let begun = robot(start_ns, view.header.time_ns) * mount;
            let before = view.points_in(|_| begun).map(|one| one.point_m);
            let before = off_the_wall(before);
            let moved = view.points_in(|time_ns| robot(start_ns, time_ns) * mount);
            let moved: Vec<_> = moved.map(|one| one.point_m).collect();
            let after = off_the_wall(moved.iter().copied());
            println!("{model}: {before:?} m before, {after:?} after");
            assert!(before.0 > 0.3 && after.0 < 0.02, "{before:?} {after:?}");
            assert!(after.1 > view.range.len() / 10, "{after:?}");

            std::fs::write(&file, sweep.as_ref()).unwrap();
            for (language, program) in &programs {
                compare(
                    &view,
                    &moved,
                    &program_points(program, &file, start_ns),
                    language,
                );
            }
            compare(&view, &moved, &python_points(&file, start_ns), "Python");
        }
    }
}

/// The arguments of the other programs.
fn motion(start_ns: i64) -> [String; 4] {
    let [x, y] = VELOCITY;
    [
        start_ns.to_string(),
        x.to_string(),
        y.to_string(),
        TURN.to_string(),
    ]
}

fn program_points(program: &Path, file: &Path, start_ns: i64) -> Vec<u8> {
    let motion = motion(start_ns).map(PathBuf::from);
    let motion = motion.iter().map(PathBuf::as_path);
    let args: Vec<&Path> = ["points_in".as_ref(), file]
        .into_iter()
        .chain(motion)
        .collect();
    run(program, &args)
}

fn python_points(file: &Path, start_ns: i64) -> Vec<u8> {
    let mut command = Command::new(python_with_iceoryx2());
    command
        .arg(of_project("tests/consumers/check.py"))
        .arg("points_in")
        .arg(file)
        .args(motion(start_ns))
        .env("PYTHONPATH", PYTHON_PACKAGE);
    let output = command.output().unwrap();
    assert!(
        output.status.success(),
        "{}",
        String::from_utf8_lossy(&output.stderr)
    );
    output.stdout
}

/// Points of all pixels as another language has them, against those of Rust's returns.
#[track_caller]
fn compare(view: &SweepRef<'_>, moved: &[[f64; 3]], said: &[u8], language: &str) {
    let (points, rest) = said.as_chunks::<24>();
    assert!(
        rest.is_empty() && points.len() == view.range.len(),
        "{language}"
    );
    let mut moved = moved.iter();
    for (pixel, (bytes, &range_m)) in points.iter().zip(view.range).enumerate() {
        for (axis, bytes) in bytes.as_chunks().0.iter().enumerate() {
            let said = f64::from_le_bytes(*bytes);
            let is_same = match is_return(range_m) {
                true => (said - moved.as_slice()[0][axis]).abs() < 1e-9,
                false => said.is_nan(),
            };
            assert!(is_same, "{language}, pixel {pixel}, axis {axis}: {said}");
        }
        if is_return(range_m) {
            moved.next();
        }
    }
}
