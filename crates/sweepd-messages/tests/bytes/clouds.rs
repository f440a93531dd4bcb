//! Clouds.

use sweepd_core::sensor::Beam;
use sweepd_messages::cloud::FieldsError;
use sweepd_messages::{
    Cloud, Fields, Layout, MessageHeader, Motion, Points, Slice, Stamp, markers, scan,
};
use sweepd_sweep::layout::{ReturnKind, flags};
use sweepd_sweep::{Column, Pose, Return, SweepRef};

use super::reader::Reader;
use super::scene::Scene;

const FIRST: MessageHeader<'_> = MessageHeader {
    frame_id: "velodyne",
    stamp: Stamp::First,
};
const LAST: MessageHeader<'_> = MessageHeader {
    frame_id: "velodyne",
    stamp: Stamp::Last,
};

const KINDS: [Points; 4] = [
    Points::All,
    Points::Ground,
    Points::Nonground,
    Points::Objects,
];

fn encode(cloud: Cloud, sweep: &SweepRef<'_>, header: &MessageHeader<'_>) -> Vec<u8> {
    let mut message = Vec::new();
    cloud.encode(sweep, header, &mut message);
    message
}

/// A PointCloud2 that was read.
struct Read<'a> {
    time_ns: i64,
    height: u32,
    width: u32,
    fields: Vec<(&'a str, u32, u8)>,
    step: usize,
    data: &'a [u8],
    is_dense: bool,
}

impl<'a> Read<'a> {
    fn new(message: &'a [u8]) -> Self {
        let mut reader = Reader::new(message);
        let (time_ns, frame_id) = reader.header();
        assert_eq!(frame_id, "velodyne");
        let (height, width, count) = (reader.u32(), reader.u32(), reader.u32());
        let mut fields = Vec::new();
        for _ in 0..count {
            fields.push((reader.text(), reader.u32(), reader.u8()));
            assert_eq!(reader.u32(), 1);
        }
        assert_eq!(reader.u8(), 0, "little-endian");
        let (step, row_step, data) = (reader.u32(), reader.u32(), reader.bytes());
        assert_eq!(row_step, step * width);
        assert_eq!(data.len(), (row_step * height) as usize);
        let is_dense = reader.u8() == 1;
        reader.end();
        Self {
            time_ns,
            height,
            width,
            fields,
            step: step as usize,
            data,
            is_dense,
        }
    }

    /// A field of each point as a number; none if the cloud does not have the field.
    fn column(&self, name: &str) -> Option<Vec<f64>> {
        let (_, offset, datatype) = self.fields.iter().find(|field| field.0 == name)?;
        let number = |point: &[u8]| {
            let at = &point[*offset as usize..];
            match datatype {
                2 => f64::from(at[0]),
                4 => f64::from(u16::from_le_bytes(at[..2].try_into().unwrap())),
                6 => f64::from(u32::from_le_bytes(at[..4].try_into().unwrap())),
                7 => f64::from(f32::from_le_bytes(at[..4].try_into().unwrap())),
                other => panic!("datatype {other}"),
            }
        };
        Some(self.data.chunks_exact(self.step).map(number).collect())
    }
}

/// The same bytes that ROS 2 writes for this cloud, but for the coordinates, whose last bits the
/// sweep's single precision decides: x, y, z of (1, 2, 3) and (-1, -2, -3).
#[test]
fn a_cloud_is_byte_for_byte_that_of_ros() {
    let mut scene = Scene::new(64, 2, false);
    scene.fill(|sweep| {
        let up = 3_f64.atan2(5_f64.sqrt());
        sweep.beams[63] = Beam::ideal(63, up).row(0);
        sweep.beams[0] = Beam::ideal(0, -up).row(0);
        // ROS' (1, 2) is 1 forward and 2 left.
        let azimuth_rad = (-2_f64).atan2(1.0).rem_euclid(std::f64::consts::TAU);
        let opposite_rad = azimuth_rad - std::f64::consts::PI;
        sweep.columns[0] = Column::measured(0, 0, azimuth_rad as f32, 0.0, 0);
        sweep.columns[1] = Column::measured(1, 0, opposite_rad as f32, 0.0, 500_000_000);
        for (index, reflectivity, label) in [(63, 7, 1), (64, 100, 2)] {
            sweep.range[index] = 14_f32.sqrt();
            (sweep.reflectivity[index], sweep.label[index]) = (reflectivity, label);
        }
    });
    let message = encode(Cloud::default(), &scene.sweep(), &FIRST);
    let mut expected = Vec::new();
    expected.extend(*b"\x00\x01\x00\x00\x00\xf1\x53\x65\x15\xcd\x5b\x07\x09\x00\x00\x00");
    expected.extend(*b"velodyne\0\0\0\0\x01\x00\x00\x00\x02\x00\x00\x00\x07\x00\x00\x00");
    for (name, offset, datatype) in [
        (*b"\x02\x00\x00\x00x\0\0\0", 0, 7),
        (*b"\x02\x00\x00\x00y\0\0\0", 4, 7),
        (*b"\x02\x00\x00\x00z\0\0\0", 8, 7),
    ] {
        expected.extend(name);
        expected.extend([offset, 0, 0, 0, datatype, 0, 0, 0, 1, 0, 0, 0]);
    }
    expected.extend(*b"\x0a\x00\x00\x00intensity\0\0\0\x0c\0\0\0\x07\0\0\0\x01\0\0\0");
    expected.extend(*b"\x05\x00\x00\x00ring\0\0\0\0\x10\0\0\0\x04\0\0\0\x01\0\0\0");
    expected.extend(*b"\x05\x00\x00\x00time\0\0\0\0\x12\0\0\0\x07\0\0\0\x01\0\0\0");
    expected.extend(*b"\x06\x00\x00\x00label\0\0\0\x16\0\0\0\x06\0\0\0\x01\0\0\0");
    expected.extend(*b"\0\0\0\0\x1a\x00\x00\x00\x34\x00\x00\x00\x34\x00\x00\x00");
    assert_eq!(expected.len(), 0xd8);
    assert_eq!(message[..0xd8], expected);
    let [first, second] = [&message[0xd8..0xf2], &message[0xf2..0x10c]];
    assert_eq!(first[12..], *b"\0\0\xe0\x40\0\0\0\0\0\0\x01\0\0\0");
    assert_eq!(second[12..], *b"\0\0\xc8\x42\x3f\0\0\0\0\x3f\x02\0\0\0");
    assert_eq!(message[0x10c..], [1]);
    for (point, sign) in [(first, 1.0), (second, -1.0)] {
        for (axis, bytes) in point[..12].chunks_exact(4).enumerate() {
            let length = f32::from_le_bytes(bytes.try_into().unwrap());
            let expected = sign * (axis as f32 + 1.0);
            assert!((length - expected).abs() < 1e-6, "{length} {expected}");
        }
    }
}

/// Whether two coordinates are the same but for the rounding to single precision.
fn is_near(found: f64, expected: f64) -> bool {
    (found - expected).abs() <= 1e-7 * expected.abs().max(1.0)
}

fn check_point(read: &Read<'_>, index: usize, expected: &Return, sweep: &SweepRef<'_>) {
    let value = |name: &str| read.column(name).map(|column| column[index]);
    let [right, forward, up] = expected.point_m;
    for (name, length) in [("x", forward), ("y", -right), ("z", up)] {
        assert!(is_near(value(name).unwrap(), length), "{name}");
    }
    let ring = (sweep.rows() - 1 - expected.row) as f64;
    let after_ns = expected.time_ns - read.time_ns;
    let exact = [
        ("intensity", f64::from(expected.reflectivity)),
        ("ring", ring),
        ("time", f64::from((after_ns as f64 * 1e-9) as f32)),
        ("label", expected.label.into()),
        ("channel", ring),
        ("distance", expected.range_m.into()),
        ("time_stamp", after_ns as f64),
    ];
    for (name, number) in exact {
        assert!(value(name).is_none_or(|found| found == number), "{name}");
    }
    for (name, angle) in [
        ("azimuth", expected.azimuth_rad),
        ("elevation", expected.elevation_rad),
    ] {
        assert!(
            value(name).is_none_or(|found| is_near(found, angle)),
            "{name}"
        );
    }
}

#[test]
fn clouds_of_any_sweep_hold_its_returns() {
    let mut message = Vec::new();
    for seed in 0..300 {
        let scene = Scene::random(seed);
        let sweep = scene.sweep();
        let mut random = fastrand::Rng::with_seed(seed);
        let fields = Fields {
            intensity: random.bool(),
            ring: random.bool(),
            time: random.bool(),
            label: random.bool(),
        };
        let cloud = Cloud {
            points: KINDS[random.usize(0..KINDS.len())],
            layout: [Layout::Fields(fields), Layout::Autoware][random.usize(0..2)],
            organized: random.bool(),
        };
        let header = [FIRST, LAST][random.usize(0..2)];
        // The memory of the message before is used again.
        message.clear();
        cloud.encode(&sweep, &header, &mut message);
        let read = Read::new(&message);
        let stamp = match cloud.layout {
            Layout::Autoware => Stamp::First,
            Layout::Fields(_) => header.stamp,
        };
        assert_eq!(read.time_ns, stamp.time_ns(&sweep));
        assert_eq!(
            (read.step, read.is_dense),
            (cloud.layout.point_step(), !cloud.organized)
        );
        let is_in = |found: &Return| match cloud.points {
            Points::All => true,
            Points::Ground => found.label == 1,
            Points::Nonground => found.label != 1,
            Points::Objects => found.label >= 2,
        };
        if !cloud.organized {
            let mut expected: Vec<Return> = sweep.returns().filter(is_in).collect();
            // Of what fired at once, the earlier firing and the higher row come first.
            let order = |one: &Return| (one.time_ns, sweep.fired_in(one.row, one.column), one.row);
            expected.sort_by_key(order);
            assert_eq!(
                (read.height, read.width as usize),
                (1, expected.len()),
                "seed {seed}"
            );
            for (index, expected) in expected.iter().enumerate() {
                check_point(&read, index, expected, &sweep);
            }
            continue;
        }
        let columns = sweep.columns.len();
        assert_eq!(
            (read.height as usize, read.width as usize),
            (sweep.rows(), columns)
        );
        for index in 0..sweep.rows() * columns {
            let (row, left) = (index / columns, index % columns);
            let column = match sweep.header.has(flags::REVERSED) {
                true => columns - 1 - left,
                false => left,
            };
            match sweep.pixel(row, column)[0].filter(is_in) {
                Some(expected) => check_point(&read, index, &expected, &sweep),
                None => {
                    let values = |name| read.column(name).unwrap()[index];
                    assert!(
                        ["x", "y", "z"]
                            .map(values)
                            .iter()
                            .all(|value| value.is_nan())
                    );
                }
            }
        }
    }
}

/// By hand: nearer and stronger, farther and weaker; nearer and weaker, farther and stronger; as
/// strong; one alone. See nebula's `ReturnType`.
#[test]
fn kinds_of_returns_are_those_of_nebula() {
    let mut scene = Scene::new(1, 4, true);
    scene.fill(|sweep| {
        sweep.kind.fill(ReturnKind::Last as u8);
        sweep.range.copy_from_slice(&[3.0, 4.0, 5.0, 6.0]);
        sweep.range2.copy_from_slice(&[7.0, 2.0, 8.0, 0.0]);
        sweep.reflectivity.copy_from_slice(&[20, 20, 20, 20]);
        sweep.reflectivity2.copy_from_slice(&[10, 10, 20, 0]);
    });
    let cloud = Cloud {
        layout: Layout::Autoware,
        ..Cloud::default()
    };
    let kinds = |scene: &Scene| {
        let message = encode(cloud, &scene.sweep(), &FIRST);
        Read::new(&message).column("return_type").unwrap()
    };
    assert_eq!(kinds(&scene), [9.0, 5.0, 10.0, 4.0, 9.0, 5.0, 6.0]);
    let mut single = Scene::new(1, 1, false);
    for (byte, kind) in [(0x37, 3.0), (0x38, 1.0)] {
        single.fill(|sweep| {
            sweep.range[0] = 1.0;
            sweep.header.return_mode = byte;
        });
        assert_eq!(kinds(&single), [kind]);
    }
}

#[test]
fn fields_are_named_once_and_known() {
    assert_eq!(Fields::of_names([]), Ok(Fields::NONE));
    assert_eq!(
        Fields::of_names(["label", "x", "time", "ring", "intensity"]),
        Ok(Fields::ALL)
    );
    let twice = Fields::of_names(["x", "ring", "x"]).unwrap_err();
    assert_eq!(twice, FieldsError::Twice("x".to_owned()));
    let unknown = Fields::of_names(["rings"]).unwrap_err().to_string();
    assert!(
        unknown.contains("rings") && unknown.contains("label"),
        "{unknown}"
    );
}

/// A sweep with an arbitrary header and no columns: no panic, an empty cloud.
#[test]
fn an_empty_sweep_is_an_empty_cloud() {
    let scene = Scene::new(16, 0, true);
    for organized in [false, true] {
        let cloud = Cloud {
            organized,
            ..Cloud::default()
        };
        let message = encode(cloud, &scene.sweep(), &LAST);
        let read = Read::new(&message);
        assert_eq!((read.width, read.data.len()), (0, 0));
    }
}

/// By hand: a sensor goes 1 m ahead, or turns a quarter to the left, before it has seen the same thing, 10 m
/// ahead at first, three times.
#[test]
fn a_deskewed_cloud_is_what_is_seen_at_its_stamp() {
    let turned = std::f32::consts::FRAC_PI_2;
    for (ranges_m, turns_rad, way_m, seen) in [
        (
            [10.0, 9.5, 9.0],
            [0.0; 3],
            1.0,
            [[10.0, 0.0], [9.5, 0.0], [9.0, 0.0]],
        ),
        (
            [10.0; 3],
            [0.0, turned / 2.0, turned],
            0.0,
            [[10.0, 0.0], [50_f64.sqrt(), -(50_f64.sqrt())], [0.0, -10.0]],
        ),
    ] {
        let mut scene = Scene::new(1, 3, false);
        scene.fill(|sweep| {
            sweep.beams[0] = Beam::ideal(0, 0.0).row(0);
            for (number, (column, turn_rad)) in sweep.columns.iter_mut().zip(turns_rad).enumerate()
            {
                let time_ns = 50_000_000 * number as u32;
                *column = Column::measured(0, 0, turn_rad, 0.0, time_ns);
            }
            sweep.range.copy_from_slice(&ranges_m);
            sweep.label.fill(2);
            sweep.header.segments = 1;
            sweep.segments[0].label = 2;
        });
        let sweep = scene.sweep();
        let pose_at = |time_ns: i64| {
            let part = (time_ns - sweep.header.time_ns) as f64 * 1e-8;
            let (sin, cos) = (part * f64::from(turns_rad[2]) / 2.0).sin_cos();
            Pose::new([7.0, part * way_m, 0.0], [0.0, 0.0, sin, cos])
        };
        let motion = Motion::of(&sweep, pose_at);
        for (stamp, [x, y]) in [Stamp::First, Stamp::Middle, Stamp::Last]
            .into_iter()
            .zip(seen)
        {
            let header = MessageHeader { stamp, ..FIRST };
            let mut message = Vec::new();
            Cloud::default().encode_deskewed(&sweep, &header, Some(&motion), &mut message);
            let read = Read::new(&message);
            assert_eq!(read.time_ns, stamp.time_ns(&sweep));
            for (name, expected) in [("x", x), ("y", y), ("z", 0.0)] {
                let found = read.column(name).unwrap();
                let is_near = |value: &f64| (value - expected).abs() < 1e-5;
                assert!(found.iter().all(is_near), "{stamp:?} {name}: {found:?}");
            }

            message.clear();
            markers::encode_deskewed(&sweep, &header, Some(&motion), &mut message);
            let mut reader = Reader::new(&message);
            assert_eq!(reader.u32(), 2);
            let [_, extent] = [(); 2].map(|()| marker(&mut reader));
            let expected = [x, y, 0.0, 0.01, 0.01, 0.01];
            let differs = extent
                .iter()
                .zip(expected)
                .any(|(a, b)| (a - b).abs() > 1e-5);
            assert!(!differs, "{stamp:?}: {extent:?}");

            message.clear();
            let heights = Slice::Heights([-1.0, 1.0]);
            scan::encode(&sweep, heights, None, Some(&motion), &header, &mut message);
            let mut reader = Reader::new(&message);
            reader.header();
            let _ = [(); 7].map(|()| reader.f32());
            let ranges: Vec<f32> = (0..reader.u32()).map(|_| reader.f32()).collect();
            let seen: Vec<&f32> = ranges.iter().filter(|range| !range.is_nan()).collect();
            let is_near = |range: &&f32| (f64::from(**range) - x.hypot(y)).abs() < 1e-4;
            assert!(
                (1..=2).contains(&seen.len()) && seen.iter().all(is_near),
                "{seen:?}"
            );
        }
    }
}

/// Centre and size of a marker.
fn marker(reader: &mut Reader<'_>) -> [f64; 6] {
    reader.header();
    reader.text();
    let _ = [(); 3].map(|()| reader.u32());
    let center_m = [(); 3].map(|()| reader.f64());
    let _ = [(); 4].map(|()| reader.f64());
    let size_m = [(); 3].map(|()| reader.f64());
    let _ = [(); 4].map(|()| reader.f32());
    // Lifetime, frame_locked, points, colours, texture.
    let _ = (
        reader.u32(),
        reader.u32(),
        reader.u8(),
        reader.u32(),
        reader.u32(),
    );
    let _ = (
        reader.text(),
        reader.header(),
        reader.text(),
        reader.u32(),
        reader.u32(),
    );
    // Text, mesh.
    let _ = (
        reader.text(),
        reader.text(),
        reader.text(),
        reader.u32(),
        reader.u8(),
    );
    [center_m, size_m].concat().try_into().unwrap()
}
