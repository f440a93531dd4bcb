//! Images, boxes, transforms, diagnostics and the graph.

use nalgebra::{Quaternion, Rotation3, UnitQuaternion, Vector3};
use sweepd_core::segment::Mount;
use sweepd_core::sensor::Beam;
use sweepd_messages::diagnostics::{Level, Status};
use sweepd_messages::graph::{GidForm, Node};
use sweepd_messages::transforms::Transform;
use sweepd_messages::{
    MessageHeader, Slice, Stamp, diagnostics, graph, image, markers, palette, scan, transforms,
};
use sweepd_sweep::layout::flags;
use sweepd_sweep::{Column, Pose};

use super::reader::Reader;
use super::scene::Scene;

const HEADER: MessageHeader<'_> = MessageHeader {
    frame_id: "roof",
    stamp: Stamp::First,
};

/// Height, width, encoding and the values of the pixels, `BYTES` each.
fn read_image<const BYTES: usize>(message: &[u8]) -> (u32, u32, &str, Vec<[u8; BYTES]>) {
    let mut reader = Reader::new(message);
    assert_eq!(reader.header(), (1_700_000_000_123_456_789, "roof"));
    let (height, width, encoding) = (reader.u32(), reader.u32(), reader.text());
    assert_eq!(reader.u8(), 0, "little-endian");
    let (step, data) = (reader.u32(), reader.bytes());
    assert_eq!(step, width * BYTES as u32);
    assert_eq!(data.len(), (step * height) as usize);
    reader.end();
    let pixels = data
        .chunks_exact(BYTES)
        .map(|pixel| pixel.try_into().unwrap());
    (height, width, encoding, pixels.collect())
}

/// The distances of a scan, and the frame.
fn scan_of(scene: &Scene, slice: Slice, pose: Option<&Pose>) -> Vec<f32> {
    let mut message = Vec::new();
    scan::encode(&scene.sweep(), slice, pose, None, &HEADER, &mut message);
    let mut reader = Reader::new(&message);
    assert_eq!(reader.header(), (1_700_000_000_123_456_789, "roof"));
    let angles = [reader.f32(), reader.f32(), reader.f32()].map(f32::to_degrees);
    let expected = [-179.75, 179.75, 0.5];
    assert!(
        angles
            .iter()
            .zip(expected)
            .all(|(angle, expected)| (angle - expected).abs() < 1e-4)
    );
    // No order of time; how long the sweep took; the least and the greatest range.
    let times_and_limits = [(); 4].map(|()| reader.f32());
    assert_eq!(times_and_limits, [0.0, 0.1, 0.0, 300.0]);
    let [ranges, intensities] = [(); 2].map(|()| {
        let count = reader.u32() as usize;
        (0..count).map(|_| reader.f32()).collect::<Vec<f32>>()
    });
    reader.end();
    let is_point = |(range, intensity): (&f32, &f32)| range.is_finite() == (*intensity == 7.0);
    assert!(ranges.iter().zip(&intensities).all(is_point));
    ranges
}

/// By hand: three beams, level and 0.1 rad above and below it, look ahead, to the right, back and to the
/// left.
#[test]
fn a_scan_is_the_nearest_of_a_band_and_free_where_a_beam_proves_it() {
    let mut scene = Scene::new(3, 4, false);
    scene.fill(|sweep| {
        sweep.header.duration_ns = 100_000_000;
        for (row, (beam, elevation_rad)) in sweep.beams.iter_mut().zip([0.1, 0.0, -0.1]).enumerate()
        {
            *beam = Beam::ideal(row, elevation_rad).row(0);
        }
        for (quarter, column) in sweep.columns.iter_mut().enumerate() {
            let azimuth_rad = quarter as f32 * std::f32::consts::FRAC_PI_2 + 0.001;
            *column = Column::measured(quarter as u64, 0, azimuth_rad, 0.0, 0);
        }
        // Ahead: a wall, and a sign above the band. Right: ground far away. Back: ground nearby. Left: a post
        // without a label before a wall.
        sweep
            .range
            .copy_from_slice(&[4.0, 12.0, 0.0, 0.0, 0.0, 11.0, 0.0, 0.0, 5.0, 0.0, 8.0, 3.0]);
        sweep
            .label
            .copy_from_slice(&[2, 2, 0, 0, 0, 1, 0, 0, 1, 0, 3, 0]);
        sweep.reflectivity.fill(7);
    });
    // Directions of half a degree from straight back on, against the clock.
    let [ahead, right, back, left] = [359, 179, 719, 539];
    let of_band = scan_of(&scene, Slice::Heights([-1.2, 0.2]), None);
    assert_eq!(of_band[ahead], 12.0);
    assert_eq!(of_band[right], f32::INFINITY);
    assert!(of_band[back].is_nan(), "free for 5 m alone");
    assert!((of_band[left] - 3.0 * 0.1_f32.cos()).abs() < 1e-6);
    assert_eq!(of_band.iter().filter(|range| range.is_nan()).count(), 717);
    // The same beam is below the band from 9 m on.
    let of_band = scan_of(&scene, Slice::Heights([-0.9, 0.2]), None);
    assert!(of_band[right].is_nan());

    // The sensor is above the band: the beam may have passed over what is near.
    let of_band = scan_of(&scene, Slice::Heights([-2.0, -0.5]), None);
    assert!(of_band[right].is_nan());

    let of_beam = scan_of(&scene, Slice::Ring(1), None);
    assert_eq!([of_beam[ahead], of_beam[left]], [12.0, 8.0]);
    assert!(of_beam[right].is_nan(), "another beam returned");

    // A metre ahead of the robot's middle and a metre up, turned to the left by a quarter.
    let pose = Pose::mounted([0.0, 1.0, 1.0], [std::f32::consts::FRAC_PI_2, 0.0, 0.0]);
    let of_robot = scan_of(&scene, Slice::Heights([0.5, 1.1]), Some(&pose));
    let nearest = of_robot.iter().filter(|range| range.is_finite()).count();
    assert_eq!(
        nearest, 2,
        "the wall, which is on the left now, and the post behind"
    );
    let to_post = of_robot.iter().copied().fold(f32::INFINITY, f32::min);
    assert!(
        (to_post - (3.0 * 0.1_f32.cos() - 1.0)).abs() < 1e-2,
        "{to_post}"
    );

    scene.fill(|sweep| sweep.header.flags = flags::BLIND);
    let blind = scan_of(&scene, Slice::Ring(1), None);
    assert!(blind.iter().all(|range| range.is_nan()));
}

/// By hand: two rows, three columns; the sweep is stored column after column.
#[test]
fn images_are_rows_from_the_top_from_left_to_right() {
    let mut scene = Scene::new(2, 3, false);
    scene.fill(|sweep| {
        sweep.range.copy_from_slice(&[1.0, 4.0, 2.0, 0.0, 3.0, 6.0]);
        sweep.label.copy_from_slice(&[1, 4, 2, 0, 3, 65_535]);
    });
    let images = |scene: &Scene| {
        let (mut ranges, mut labels) = (Vec::new(), Vec::new());
        image::encode_ranges(&scene.sweep(), &HEADER, &mut ranges);
        image::encode_labels(&scene.sweep(), &HEADER, &mut labels);
        (ranges, labels)
    };
    let (ranges, labels) = images(&scene);
    let (height, width, encoding, pixels) = read_image::<4>(&ranges);
    assert_eq!((height, width, encoding), (2, 3, "32FC1"));
    let pixels: Vec<f32> = pixels.into_iter().map(f32::from_le_bytes).collect();
    assert_eq!(pixels[..4], [1.0, 2.0, 3.0, 4.0]);
    assert!(pixels[4].is_nan() && pixels[5] == 6.0);
    let (_, _, encoding, pixels) = read_image::<2>(&labels);
    let pixels: Vec<u16> = pixels.into_iter().map(u16::from_le_bytes).collect();
    assert_eq!(
        (encoding, &pixels[..]),
        ("16UC1", &[1, 2, 3, 4, 0, 65_535][..])
    );

    scene.fill(|sweep| {
        sweep.header.flags = flags::REVERSED;
        sweep.label[5] = 65_536;
    });
    let (ranges, labels) = images(&scene);
    let (_, _, _, pixels) = read_image::<4>(&ranges);
    assert_eq!(pixels[..3], [3_f32, 2.0, 1.0].map(f32::to_le_bytes));
    let (_, _, encoding, pixels) = read_image::<4>(&labels);
    let pixels: Vec<i32> = pixels.into_iter().map(i32::from_le_bytes).collect();
    assert_eq!(
        (encoding, &pixels[..]),
        ("32SC1", &[3, 2, 1, 65_536, 0, 4][..])
    );
}

#[test]
fn boxes_are_the_extents_of_segments() {
    let mut scene = Scene::new(1, 1, false);
    scene.fill(|sweep| {
        sweep.header.segments = 3;
        // Wide ones have none; of the other flags nothing is known.
        for (segment, flags) in sweep.segments.iter_mut().zip([1, 0xFFFE, 0xFFFF]) {
            (segment.label, segment.flags) = (2, flags);
            (segment.min_m, segment.max_m) = ([1.0, 10.0, -1.0], [3.0, 11.0, -1.0]);
        }
    });
    let mut message = Vec::new();
    markers::encode(&scene.sweep(), &HEADER, &mut message);
    let mut reader = Reader::new(&message);
    assert_eq!(reader.u32(), 2);
    for (action, id, pose_and_scale) in [
        (3, 0, [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]),
        // 10.5 forward, 2 to the right; 1 long, 2 wide, flat.
        (0, 2, [10.5, -2.0, -1.0, 0.0, 0.0, 0.0, 1.0, 1.0, 2.0, 0.01]),
    ] {
        assert_eq!(reader.header(), (1_700_000_000_123_456_789, "roof"));
        assert_eq!(reader.text(), "segments");
        assert_eq!([reader.u32(), reader.u32(), reader.u32()], [id, 1, action]);
        assert_eq!([(); 10].map(|()| reader.f64()), pose_and_scale);
        let colour = palette::label(id).map(|channel| f32::from(channel) / 255.0);
        assert_eq!([(); 3].map(|()| reader.f32()), colour);
        assert_eq!(reader.f32(), 0.5);
        // Lifetime, frame_locked, points, colours, texture.
        assert_eq!([reader.u32(), reader.u32(), reader.u8().into()], [0; 3]);
        assert_eq!([reader.u32(), reader.u32()], [0; 2]);
        assert_eq!(
            (reader.text(), reader.header(), reader.text()),
            ("", (0, ""), "")
        );
        assert_eq!([reader.u32(), reader.u32()], [0; 2]);
        // Text, mesh.
        assert_eq!([reader.text(), reader.text(), reader.text()], [""; 3]);
        assert_eq!([reader.u32(), reader.u8().into()], [0; 2]);
    }
    reader.end();
}

/// Against rotations about single axes in the sensor's own axes, and against the plumb line that
/// the ground is found by.
#[test]
fn the_mount_brings_points_into_the_frame_of_the_robot() {
    let mut random = fastrand::Rng::with_seed(5);
    let ros = |[x, y, z]: [f64; 3]| Vector3::new(y, -x, z);
    for _ in 0..100 {
        let mut scene = Scene::new(1, 1, false);
        scene.fill(|sweep| {
            sweep.header.pitch_rad = random.f32() * 3.0 - 1.5;
            sweep.header.roll_rad = random.f32() * 6.0 - 3.0;
            sweep.header.yaw_rad = random.f32() * 6.0 - 3.0;
            sweep.header.position_m = [(); 3].map(|()| random.f32() * 4.0);
        });
        let sweep = scene.sweep();
        let header = sweep.header;
        let about = |axis, angle_rad: f32| Rotation3::from_axis_angle(&axis, angle_rad.into());
        let mounted = about(Vector3::z_axis(), header.yaw_rad)
            * about(Vector3::x_axis(), header.pitch_rad)
            * about(Vector3::y_axis(), header.roll_rad);
        let mount = Mount {
            height_m: None,
            pitch_rad: header.pitch_rad,
            roll_rad: header.roll_rad,
        };
        let point_m = [(); 3].map(|()| random.f64() * 20.0 - 10.0);
        let in_robot = mounted * Vector3::from(point_m);

        let mut message = Vec::new();
        let transform = Transform::of_mount(header, "base_link", "roof");
        transforms::encode(7, &[transform], &mut message);
        let mut reader = Reader::new(&message);
        assert_eq!((reader.u32(), reader.header()), (1, (7, "base_link")));
        assert_eq!(reader.text(), "roof");
        let translation = Vector3::from([(); 3].map(|()| reader.f64()));
        let [x, y, z, w] = [(); 4].map(|()| reader.f64());
        reader.end();
        let quaternion = Quaternion::new(w, x, y, z);
        assert!((quaternion.norm() - 1.0).abs() < 1e-12);
        let moved = UnitQuaternion::new_unchecked(quaternion) * ros(point_m) + translation;
        let expected = ros(in_robot.into()) + ros(header.position_m.map(f64::from));
        assert!((moved - expected).norm() < 1e-9, "{moved} {expected}");
        let pose = Pose::ROS * Pose::of_mount(header);
        assert!((Vector3::from(pose.apply(point_m)) - moved).norm() < 1e-9);
        let height_m = moved.z - f64::from(header.position_m[2]);
        assert!((mount.up().height_m(point_m) - height_m).abs() < 1e-9);
    }
}

/// By hand.
#[test]
fn diagnostics_have_levels_and_values() {
    let status = Status {
        level: Level::Stale,
        name: "sweepd: roof".to_owned(),
        message: "no packets".to_owned(),
        hardware_id: "192.168.1.201".to_owned(),
        values: vec![("rpm".to_owned(), "600".to_owned())],
    };
    let mut message = Vec::new();
    diagnostics::encode(1_000_000_002, &[status], &mut message);
    let mut reader = Reader::new(&message);
    assert_eq!((reader.header(), reader.u32()), ((1_000_000_002, ""), 1));
    assert_eq!((reader.u8(), reader.text()), (3, "sweepd: roof"));
    assert_eq!(
        (reader.text(), reader.text()),
        ("no packets", "192.168.1.201")
    );
    assert_eq!(
        (reader.u32(), reader.text(), reader.text()),
        (1, "rpm", "600")
    );
    reader.end();
}

/// By hand, section 5.4 of the DDS mapping of ROS 2: identifiers have no alignment.
#[test]
fn the_graph_has_both_forms() {
    let node = Node {
        namespace: "/".to_owned(),
        name: "a".to_owned(),
        readers: Vec::new(),
        writers: vec![[2; 16], [3; 16]],
    };
    for (form, zeros) in [(GidForm::Bytes16, 0), (GidForm::Bytes24, 8)] {
        let mut message = Vec::new();
        graph::encode(&[1; 16], std::slice::from_ref(&node), form, &mut message);
        let gid = |byte: u8| [vec![byte; 16], vec![0; zeros]].concat();
        let expected = [
            vec![0, 1, 0, 0],
            gid(1),
            vec![1, 0, 0, 0],
            b"\x02\0\0\0/\0\0\0\x02\0\0\0a\0\0\0".to_vec(),
            vec![0, 0, 0, 0, 2, 0, 0, 0],
            gid(2),
            gid(3),
        ];
        assert_eq!(message, expected.concat());
    }
}
