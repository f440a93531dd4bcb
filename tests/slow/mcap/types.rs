//! Messages that no file of ours has, read by rosbags.

use serde_json::{Value, json};
use sweepd::buffers::{Buffers, HeapBuffers};
use sweepd::messages::cdr::Writer;
use sweepd::messages::diagnostics::{self, Level, Status};
use sweepd::messages::graph::{self, GidForm, Node};
use sweepd::messages::message_type::{
    CLOCK, DIAGNOSTIC_ARRAY, IMAGE, MessageType, ODOMETRY, PARTICIPANT_ENTITIES_INFO, TF_MESSAGE,
};
use sweepd::messages::odometry::Located;
use sweepd::messages::transforms::{self, Transform};
use sweepd::messages::{MessageHeader, Stamp, image};
use sweepd::sweep::{Shape, SweepMut, SweepRef};

use crate::mcap::{folder, python};

#[test]
#[cfg_attr(without_rosbags, ignore = "no SWEEPD_ROS_PYTHON")]
fn ros_reads_every_type() {
    let folder = folder("types");
    let mut all = serde_json::Map::new();
    let mut add = |name: &str, kind: &MessageType, message: Vec<u8>, values: Value| {
        std::fs::write(folder.join(name), message).unwrap();
        let (definition, hash) = (kind.definition, kind.hash);
        let one =
            json!({"type": kind.name, "definition": definition, "hash": hash, "values": values});
        all.insert(name.to_owned(), one);
    };

    let shape = Shape {
        rows: 2,
        columns_capacity: 3,
        dual: false,
        segments_capacity: 1,
    };
    let mut buffer = HeapBuffers::default().take(shape.total_bytes());
    let sweep = SweepMut::create(buffer.as_mut(), &shape).unwrap();
    (sweep.header.columns, sweep.header.time_ns) = (3, 1_700_000_000_000_000_005);
    sweep.range.copy_from_slice(&[1.5, 4.0, 2.5, 0.0, 3.5, 6.0]);
    for greatest in [65_535_u32, 65_536] {
        let sweep = SweepMut::open(buffer.as_mut()).unwrap();
        sweep.label.copy_from_slice(&[1, 4, 2, 0, 3, greatest]);
        let sweep = SweepRef::open(buffer.as_ref()).unwrap();
        let header = MessageHeader {
            frame_id: "roof",
            stamp: Stamp::First,
        };
        let (mut ranges, mut labels) = (Vec::new(), Vec::new());
        image::encode_ranges(&sweep, &header, &mut ranges);
        image::encode_labels(&sweep, &header, &mut labels);
        let values = |encoding: &str, step: u32, data: Value| {
            let stamp = json!({"sec": 1_700_000_000, "nanosec": 5});
            json!({"header": {"stamp": stamp, "frame_id": "roof"}, "height": 2, "width": 3, "encoding": encoding,
                   "is_bigendian": 0, "step": step, "data": data})
        };
        let pixels = json!([1.5, 2.5, 3.5, 4.0, "nan", 6.0]);
        add("ranges", &IMAGE, ranges, values("32FC1", 12, pixels));
        let (name, encoding, step) = match greatest {
            65_535 => ("labels", "16UC1", 6),
            _ => ("many labels", "32SC1", 12),
        };
        let pixels = json!([1, 2, 3, 4, 0, greatest]);
        add(name, &IMAGE, labels, values(encoding, step, pixels));
    }

    let status = Status {
        level: Level::Error,
        name: "sweepd: roof".to_owned(),
        message: "silent".to_owned(),
        hardware_id: "192.168.1.201".to_owned(),
        values: vec![
            ("lost".to_owned(), "7".to_owned()),
            ("rpm".to_owned(), String::new()),
        ],
    };
    let mut message = Vec::new();
    diagnostics::encode(-1, &[status], &mut message);
    let values =
        [("lost", "7"), ("rpm", "")].map(|(key, value)| json!({"key": key, "value": value}));
    let status = json!({"level": 2, "name": "sweepd: roof", "message": "silent", "hardware_id": "192.168.1.201",
                        "values": values});
    let stamp = json!({"sec": -1, "nanosec": 999_999_999});
    let values = json!({"header": {"stamp": stamp, "frame_id": ""}, "status": [status]});
    add("diagnostics", &DIAGNOSTIC_ARRAY, message, values);

    let transform = Transform {
        parent: "base_link".to_owned(),
        child: "roof".to_owned(),
        translation_m: [1.0, 2.0, 3.0],
        rotation: [0.5, -0.5, 0.5, 0.5],
    };
    let mut message = Vec::new();
    transforms::encode(1_000_000_002, &[transform], &mut message);
    let values = json!({"transforms": [{
        "header": {"stamp": {"sec": 1, "nanosec": 2}, "frame_id": "base_link"},
        "child_frame_id": "roof",
        "transform": {
            "translation": {"x": 1.0, "y": 2.0, "z": 3.0},
            "rotation": {"x": 0.5, "y": -0.5, "z": 0.5, "w": 0.5},
        },
    }]});
    add("transforms", &TF_MESSAGE, message, values);

    let mut message = Vec::new();
    Writer::new(&mut message).time(3_000_000_004);
    let values = json!({"clock": {"sec": 3, "nanosec": 4}});
    add("clock", &CLOCK, message, values);

    let gid = |byte: u8| json!({"data": vec![byte; 16]});
    let node = Node {
        namespace: "/".to_owned(),
        name: "sweepd".to_owned(),
        readers: vec![[1; 16]],
        writers: vec![[2; 16], [3; 16]],
    };
    let mut message = Vec::new();
    graph::encode(&[9; 16], &[node], GidForm::Bytes16, &mut message);
    let node = json!({"node_namespace": "/", "node_name": "sweepd", "reader_gid_seq": [gid(1)],
                      "writer_gid_seq": [gid(2), gid(3)]});
    let values = json!({"gid": gid(9), "node_entities_info_seq": [node]});
    add("graph", &PARTICIPANT_ENTITIES_INFO, message, values);

    let expected = Value::Object(all);
    std::fs::write(folder.join("expected.json"), expected.to_string()).unwrap();
    assert_eq!(python("messages.py", &[folder.as_os_str()]).trim(), "7");
}

/// What ROS writes is read, of either byte order; what is cut off is refused, and nothing else is read
/// into it.
#[test]
#[cfg_attr(without_rosbags, ignore = "no SWEEPD_ROS_PYTHON")]
fn where_a_robot_is_is_read_as_ros_wrote_it() {
    let folder = folder("located");
    for kind in [&ODOMETRY, &TF_MESSAGE] {
        let (_, name) = kind.name.rsplit_once('/').unwrap();
        std::fs::write(folder.join(name).with_extension("txt"), kind.definition).unwrap();
    }
    let hashes = python("located.py", &[folder.as_os_str()]);
    assert_eq!(hashes.trim(), [ODOMETRY.hash, TF_MESSAGE.hash].join("\n"));
    let expected = Located {
        time_ns: 1_700_000_000_000_000_005,
        parent: "odom",
        child: "base_link",
        position_m: [1.0, 2.0, 3.0],
        rotation: [0.5, -0.5, 0.5, 0.5],
    };
    for order in ["little", "big"] {
        let read = |name: &str| std::fs::read(folder.join(name).with_extension(order)).unwrap();
        let (odometry, transforms) = (read("Odometry"), read("TFMessage"));
        assert_eq!(Located::of_odometry(&odometry), Ok(expected));
        let found = Located::of_transforms(&transforms, "base_link");
        assert_eq!(found, Ok(Some(expected)));
        assert_eq!(Located::of_transforms(&transforms, "roof"), Ok(None));
        for cut in 0..transforms.len() {
            let found = Located::of_transforms(&transforms[..cut], "base_link");
            assert!(found.is_err(), "{cut}");
        }
        // Lengths and counts that are not so.
        for at in 0..transforms.len() {
            let mut wrong = transforms.clone();
            wrong[at] = 0xFF;
            let _ = Located::of_transforms(&wrong, "base_link");
            let _ = Located::of_odometry(&wrong);
        }
    }
}
