//! A room seen by a sensor that stands upright, hangs head down, or lies on its side. The rays are
//! cast in the frame of the robot, and know nothing of the segmenter.

use sweepd::buffers::{HeapBuffer, HeapBuffers, Memory};
use sweepd::pipeline::{Config, Pipeline};
use sweepd::sensor::Model;
use sweepd::sweep::layout::{LABEL_GROUND, LABEL_NONE, flags};
use sweepd::sweep::{Pose, SweepRef};
use sweepd::wire::Datagram;
use sweepd_lab::cast::{Scene, Sensor, Solid, Spin};
use sweepd_testkit::stream::next_sweep;

/// How high the sensor is mounted, metres.
const HEIGHT_M: f64 = 1.5;
/// Half of a second, packet by packet.
const PACKETS: usize = 380;

/// Walls 8 m away, and a box of 0.6 by 0.6 by 1 m, which begins 1.7 m to the right and 2.7 m ahead.
fn room() -> Scene {
    let mut scene = Scene::with(vec![Solid::Cuboid {
        middle_m: [2.0, 3.0],
        size_m: [0.6, 0.6, 1.0],
        yaw_rad: 0.0,
    }]);
    scene.walls_m = 8.0;
    scene
}

/// The last whole turn of a VLP-16 in the room, pitched and rolled by these degrees. Its height is
/// not configured.
fn seen(pitch_deg: f64, roll_deg: f64) -> HeapBuffer {
    let mut sensor = Sensor::new(Model::Vlp16, HEIGHT_M);
    (sensor.pitch_rad, sensor.roll_rad) = (pitch_deg.to_radians(), roll_deg.to_radians());
    let mut config = Config {
        position_m: [0.0, 0.0, HEIGHT_M as f32],
        ..Config::default()
    };
    config.segment.mount.pitch_rad = sensor.pitch_rad as f32;
    config.segment.mount.roll_rad = sensor.roll_rad as f32;
    let mut pipeline = Pipeline::new("test", config).unwrap();
    let mut memory = Memory::new(HeapBuffers::default());
    let mut last = None;
    for (due, packet) in Spin::new(&sensor, &room()).take(PACKETS) {
        let datagram = Datagram {
            arrival_ns: 1_777_888_800_000_000_000 + due.as_nanos() as i64,
            source: ([192, 168, 1, 201], 2368).into(),
            destination_port: 2368,
            payload: packet.emit(),
        };
        pipeline.push(&datagram.parse().unwrap());
        while let Some(sweep) = next_sweep(&mut pipeline, &mut memory) {
            let view = SweepRef::open(sweep.as_ref()).unwrap();
            if view.header.has(flags::CIRCULAR) {
                last = Some(sweep);
            }
        }
    }
    last.expect("a whole turn")
}

/// Fails unless the floor is ground and the rest is not, and the height is seen.
#[track_caller]
fn floor_is_ground(sweep: &SweepRef<'_>) {
    let header = sweep.header;
    assert!(
        (f64::from(header.height_m) - HEIGHT_M).abs() < 0.02,
        "{} m",
        header.height_m
    );
    assert!(header.has(flags::HEIGHT_ESTIMATED));
    let pose = Pose::of_mount(header);
    let (mut floor, mut missed, mut wrong) = (0, 0, 0);
    for found in sweep.returns() {
        let up_m = pose.apply(found.point_m)[2];
        assert!(up_m > -0.06, "{up_m} m");
        let is_ground = found.label == LABEL_GROUND;
        if up_m < 0.05 {
            floor += 1;
            missed += usize::from(!is_ground);
        } else if up_m > 0.3 {
            wrong += usize::from(is_ground);
        }
    }
    assert!(
        floor > 3000 && missed * 50 < floor && wrong == 0,
        "{floor} {missed} {wrong}"
    );
}

/// The box around the segment that ends nearest to the middle of the box of the room, in the frame of
/// the robot.
fn box_of_room(sweep: &SweepRef<'_>) -> [[f64; 3]; 2] {
    let pose = Pose::of_mount(sweep.header);
    let all = sweep.segments.iter();
    let all = all.map(|segment| pose.bounds(segment.min_m, segment.max_m));
    let off_m = |[min_m, max_m]: &[[f64; 3]; 2]| {
        let middle_m = [0, 1].map(|axis| (min_m[axis] + max_m[axis]) / 2.0);
        (middle_m[0] - 2.0).hypot(middle_m[1] - 3.0)
    };
    all.min_by(|a, b| off_m(a).total_cmp(&off_m(b))).unwrap()
}

#[test]
fn head_down_the_ground_the_height_and_the_boxes_are_those_of_an_upright_sensor() {
    let upright = seen(0.0, 0.0);
    let upright = SweepRef::open(upright.as_ref()).unwrap();
    floor_is_ground(&upright);
    for roll_deg in [180.0, -180.0] {
        let head_down = seen(0.0, roll_deg);
        let head_down = SweepRef::open(head_down.as_ref()).unwrap();
        floor_is_ground(&head_down);
        let [one, other] = [&upright, &head_down].map(|sweep| f64::from(sweep.header.ground));
        assert!((one - other).abs() < 0.01 * one, "{one} {other}");
        assert_eq!(head_down.header.segments, upright.header.segments);
        // It sees the near sides up to the top. The lowest row, 15 degrees down, strikes their far
        // end 3.71 m away, 0.51 m up.
        for sweep in [&upright, &head_down] {
            let [min_m, max_m] = box_of_room(sweep);
            for (found_m, expected_m, within_m) in [
                (min_m[0], 1.7, 0.05),
                (min_m[1], 2.7, 0.05),
                (min_m[2], 0.51, 0.03),
                (max_m[0], 2.3, 0.05),
                (max_m[1], 3.3, 0.05),
                (max_m[2], 1.0, 0.05),
            ] {
                assert!(
                    (found_m - expected_m).abs() < within_m,
                    "{min_m:?} {max_m:?}"
                );
            }
        }
    }
}

#[test]
fn a_tilted_sensor_finds_the_floor_upright_and_head_down() {
    for (pitch_deg, roll_deg) in [(-20.0, 8.0), (-20.0, 172.0), (10.0, -165.0), (30.0, 180.0)] {
        floor_is_ground(&SweepRef::open(seen(pitch_deg, roll_deg).as_ref()).unwrap());
    }
}

#[test]
fn on_its_side_a_sensor_has_segments_and_no_ground() {
    for (pitch_deg, roll_deg) in [(0.0, 90.0), (60.0, 0.0), (40.0, 140.0)] {
        let sweep = seen(pitch_deg, roll_deg);
        let sweep = SweepRef::open(sweep.as_ref()).unwrap();
        let header = sweep.header;
        assert_eq!((header.ground, header.height_m), (0, 0.0));
        assert!(!header.has(flags::HEIGHT_ESTIMATED) && header.segments > 0);
        let labelled = sweep.returns().filter(|found| found.label != LABEL_NONE);
        assert!(labelled.count() * 10 > 9 * header.returns as usize);
    }
}
