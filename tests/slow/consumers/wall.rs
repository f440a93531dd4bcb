//! A wall that a moving sensor passes: bent as it is measured, flat once each point is where the
//! sensor was at its shot; the same points in Rust, C, C++ and Python.

use std::path::{Path, PathBuf};
use std::process::Command;
use sweepd_testkit::stream::next_sweep;

use sweepd::buffers::HeapBuffer;
use sweepd::buffers::{HeapBuffers, Memory};
use sweepd::messages::{Cloud, Fields, Layout, MessageHeader, Motion, Stamp};
use sweepd::pipeline::{Config, Pipeline};
use sweepd::sensor::Model;
use sweepd::sweep::layout::is_return;
use sweepd::sweep::{Pose, SweepRef};
use sweepd_lab::simulate::Emitter;

use super::native::{programs, run};
use super::{folder, of_project};
use sweepd_testkit::{
    python_package, python_with_numpy,
    wall::{MOUNT, TURN, VELOCITY, drive, off_the_wall, robot},
};

/// Sweeps beside the wall, measured without noise, and when the robot was at the origin.
fn sweeps(model: Model) -> (Vec<HeapBuffer>, i64) {
    let (up_m, yaw_rad) = MOUNT;
    let (scene, emitter) = drive(model);
    let config = Config {
        calibration: emitter.calibration.clone(),
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

/// The clouds of messages are as the sensor would have seen them at the time of the message.
#[test]
fn a_wall_is_flat_in_a_deskewed_cloud() {
    let cloud = Cloud {
        layout: Layout::Fields(Fields::NONE),
        ..Cloud::default()
    };
    for model in [Model::Vlp16, Model::Hdl64eS3] {
        let (sweeps, start_ns) = sweeps(model);
        let view = SweepRef::open(sweeps[1].as_ref()).unwrap();
        let mount = Pose::of_mount(view.header);
        let pose_at = |time_ns| robot(start_ns, time_ns) * mount;
        let motion = Motion::of(&view, pose_at);
        for stamp in [Stamp::First, Stamp::Middle, Stamp::Last] {
            let sensor = pose_at(stamp.time_ns(&view));
            let flatness = |motion: Option<&Motion>| {
                let header = MessageHeader {
                    frame_id: "roof",
                    stamp,
                };
                let mut message = Vec::new();
                cloud.encode_deskewed(&view, &header, motion, &mut message);
                // Behind the points is `is_dense` alone.
                let bytes = 12 * view.returns().count();
                let points = &message[message.len() - 1 - bytes..message.len() - 1];
                let points = points.as_chunks::<12>().0.iter().map(|point| {
                    let axes = point.as_chunks::<4>().0.iter();
                    let axes: Vec<f64> =
                        axes.map(|axis| f32::from_le_bytes(*axis).into()).collect();
                    sensor.apply([-axes[1], axes[0], axes[2]])
                });
                off_the_wall(points)
            };
            let (before, after) = (flatness(None), flatness(Some(&motion)));
            println!("{model}, {stamp:?}: {before:?} m before, {after:?} after");
            assert!(before.0 > 0.2 && after.0 < 0.005, "{before:?} {after:?}");
            assert!(after.1 > view.range.len() / 10, "{after:?}");
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
    let mut command = Command::new(python_with_numpy());
    command
        .arg(of_project("tests/slow/consumers/check.py"))
        .arg("points_in")
        .arg(file)
        .args(motion(start_ns))
        .envs(python_package());
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
