//! Every message of every peer is what a consumer of shared memory got.

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::{Duration, Instant};

use serde_json::{Value, json};
use sweepd_testkit::PATIENCE;

use super::alone;
use super::expected::{Consumer, decode_raw};
use super::peer::{Peer, Said, fastdds_peer};
use super::world::{FRONT_MOUNT, ROOF_MOUNT, World, hdl64e, vlp16};

/// DDS domains of this test: one for each version of Fast DDS.
const WITH_JAZZY: u32 = 90;
const WITH_KILTED: u32 = 91;
/// Clouds that each subscription must get.
const CLOUDS: usize = 200;
const TOPICS: [&str; 2] = ["/sweepd/roof/points", "/sweepd/front/points"];
const QUALITIES: [&str; 2] = ["best_effort", "reliable"];

/// As rclpy announces the types.
const HASHES: [(&str, &str); 5] = [
    (
        "sensor_msgs/msg/PointCloud2",
        "RIHS01_9198cabf7da3796ae6fe19c4cb3bdd3525492988c70522628af5daa124bae2b5",
    ),
    (
        "sensor_msgs/msg/LaserScan",
        "RIHS01_64c191398013af96509d518dac71d5164f9382553fce5c1f8cca5be7924bd828",
    ),
    (
        "sensor_msgs/msg/Image",
        "RIHS01_d31d41a9a4c4bc8eae9be757b0beed306564f7526c88ea6a4588fb9582527d47",
    ),
    (
        "diagnostic_msgs/msg/DiagnosticArray",
        "RIHS01_5a8a36efb05fb25070fa0fb3810290c0e6cd4862b54a8fb975a1ee8dc55a333e",
    ),
    (
        "tf2_msgs/msg/TFMessage",
        "RIHS01_e369d0f05a23ae52508854b66f6aa0437f3449d652e8cbf22d5abe85d020f087",
    ),
];

/// What shared memory gave, for each sensor.
struct Truth {
    roof: Consumer,
    front: Consumer,
}

impl Truth {
    /// The consumer and the name of a topic's sensor.
    fn of(&self, topic: &str) -> (&Consumer, &'static str) {
        match topic.starts_with("/sweepd/roof/") {
            true => (&self.roof, "roof"),
            false => (&self.front, "front"),
        }
    }
}

/// What a peer has heard.
struct Heard<'a> {
    who: &'static str,
    truth: &'a Truth,
    /// The numbers of the sweeps whose clouds came, by topic and quality.
    clouds: BTreeMap<(String, String), Vec<u64>>,
    images: BTreeMap<String, usize>,
    markers: usize,
    diagnostics: Option<Value>,
    transforms: Option<Value>,
    /// As rclpy sees the graph.
    graph: Option<Value>,
    /// As a Cyclone reader of before Iron sees it.
    old_graph: Option<Value>,
}

#[test]
#[cfg_attr(
    without_ros,
    ignore = "no peers of ROS 2: SWEEPD_JAZZY, SWEEPD_KILTED, SWEEPD_ROS_PYTHON, libfastrtps-dev"
)]
fn every_peer_gets_every_cloud_as_shared_memory_has_it() {
    let _alone = alone();
    let world = World::new(&[("roof", ROOF_MOUNT), ("front", FRONT_MOUNT)]);
    let (vlp16, hdl64e) = (vlp16(), hdl64e());
    fastdds_peer();
    let daemon = world.daemon();
    let truth = Truth {
        roof: Consumer::start(&world.domain(), "roof"),
        front: Consumer::start(&world.domain(), "front"),
    };
    // At half their pace: four peers and as many consumers share two cores.
    let _feeds = [
        world.feed("roof", vlp16, "0.5"),
        world.feed("front", hdl64e, "0.5"),
    ];
    let health = world.health();
    let health: Vec<&str> = health.iter().map(String::as_str).collect();
    let bridges = [WITH_JAZZY, WITH_KILTED].map(|dds_domain| world.bridge(dds_domain, &health));
    let clouds = json!({"clouds": TOPICS, "data": true});
    let with = |more: Value| {
        let mut wanted = clouds.clone();
        wanted
            .as_object_mut()
            .unwrap()
            .extend(more.as_object().unwrap().clone());
        wanted
    };
    let of_jazzy = with(json!({
        "nodes": true,
        "diagnostics": true,
        "images": ["/sweepd/roof/range_image", "/sweepd/roof/label_image"],
    }));
    let of_cyclone =
        with(json!({"graph": true, "transforms": true, "markers": ["/sweepd/roof/markers"]}));
    let peers = [
        ("Jazzy", Peer::ros("SWEEPD_JAZZY", WITH_JAZZY, &of_jazzy)),
        ("Cyclone DDS", Peer::cyclone(WITH_JAZZY, of_cyclone)),
        (
            "Kilted",
            Peer::ros(
                "SWEEPD_KILTED",
                WITH_KILTED,
                &with(json!({"nodes": true, "diagnostics": true})),
            ),
        ),
        ("Fast DDS 2.9", Peer::fastdds(WITH_KILTED, &TOPICS)),
    ];
    let cold = AtomicUsize::new(peers.len());
    let heard: Vec<(Heard<'_>, Peer)> = std::thread::scope(|scope| {
        let threads = peers.map(|(who, peer)| {
            let heard = Heard::new(who, &truth);
            scope.spawn(|| heard.listen(peer, &cold))
        });
        threads
            .into_iter()
            .map(|thread| thread.join().unwrap())
            .collect()
    });
    for (heard, peer) in &heard {
        let log = peer.process.log();
        // "Failed to parse type hash for topic ..."
        assert!(!log.contains("hash"), "{}: {log}", heard.who);
    }
    let [jazzy, cyclone, kilted, fastdds] =
        heard.iter().map(|(heard, _)| heard).collect::<Vec<_>>()[..]
    else {
        unreachable!("four peers");
    };
    check_lost(&[jazzy, cyclone]);
    check_lost(&[kilted, fastdds]);
    check_graph(jazzy.graph.as_ref().unwrap());
    check_graph(kilted.graph.as_ref().unwrap());
    check_old_graph(cyclone.old_graph.as_ref().unwrap());
    check_diagnostics(jazzy.diagnostics.as_ref().unwrap());
    check_transforms(cyclone.transforms.as_ref().unwrap());
    assert!(cyclone.markers > 50, "{}", cyclone.markers);
    assert_eq!(jazzy.images.len(), 2, "{:?}", jazzy.images);
    assert!(
        jazzy.images.values().all(|&images| images > 100),
        "{:?}",
        jazzy.images
    );
    drop(daemon);
    for mut bridge in bridges {
        bridge.end(PATIENCE).unwrap();
    }
}

impl<'a> Heard<'a> {
    fn new(who: &'static str, truth: &'a Truth) -> Self {
        Self {
            who,
            truth,
            clouds: BTreeMap::new(),
            images: BTreeMap::new(),
            markers: 0,
            diagnostics: None,
            transforms: None,
            graph: None,
            old_graph: None,
        }
    }

    /// Takes what a peer says until it has enough clouds. They count from when all peers have some:
    /// while the others start there is no core for this one.
    fn listen(mut self, mut peer: Peer, cold: &AtomicUsize) -> (Self, Peer) {
        let begun = Instant::now();
        while self.clouds.len() < TOPICS.len() * QUALITIES.len() {
            if let Some(said) = peer.next(Duration::from_millis(100)) {
                self.take(said);
            }
            assert!(
                begun.elapsed() < 2 * PATIENCE,
                "{}: {:?}",
                self.who,
                self.counts()
            );
        }
        cold.fetch_sub(1, Ordering::Relaxed);
        while cold.load(Ordering::Relaxed) > 0 {
            if let Some(said) = peer.next(Duration::from_millis(100)) {
                self.take(said);
            }
            assert!(begun.elapsed() < 3 * PATIENCE, "a peer gets nothing");
        }
        self.clouds.clear();
        while !self.has_enough() {
            if let Some(said) = peer.next(Duration::from_millis(100)) {
                self.take(said);
            }
            assert!(
                begun.elapsed() < 5 * PATIENCE,
                "{}: {:?}",
                self.who,
                self.counts()
            );
        }
        // The counts of the last second come after it.
        let begun = Instant::now();
        while begun.elapsed() < Duration::from_millis(2500) {
            if let Some(said) = peer.next(Duration::from_millis(100))
                && said.line["topic"].is_null()
            {
                self.take(said);
            }
        }
        (self, peer)
    }

    fn counts(&self) -> Vec<(&(String, String), usize)> {
        self.clouds
            .iter()
            .map(|(key, clouds)| (key, clouds.len()))
            .collect()
    }

    fn has_enough(&self) -> bool {
        self.clouds.len() == TOPICS.len() * QUALITIES.len()
            && self.clouds.values().all(|clouds| clouds.len() >= CLOUDS)
    }

    fn take(&mut self, mut said: Said) {
        for (key, place) in [
            ("diagnostics", &mut self.diagnostics),
            ("transforms", &mut self.transforms),
            ("graph", &mut self.graph),
        ] {
            if !said.line[key].is_null() {
                *place = Some(said.line[key].take());
                return;
            }
        }
        if !said.line["participant"].is_null() {
            // Jazzy's own is of the other form, and is not read.
            self.old_graph = Some(said.line);
            return;
        }
        let Some(topic) = said.line["topic"].as_str().map(str::to_owned) else {
            return;
        };
        let (consumer, sensor) = self.truth.of(&topic);
        if said.line["markers"].is_array() {
            self.check_markers(consumer, &said.line["markers"]);
            return;
        }
        if said.line["raw"] == true {
            decode_raw(&mut said);
        }
        let stamp_ns = said.line["stamp_ns"].as_i64().unwrap();
        let expected = consumer.find(stamp_ns);
        let expected = expected.unwrap_or_else(|| {
            panic!(
                "{}: {topic}: no sweep of {stamp_ns}: {}",
                self.who,
                consumer.around(stamp_ns)
            )
        });
        if said.line["encoding"].is_string() {
            let checked = expected.check_image(sensor, &said);
            checked.unwrap_or_else(|wrong| panic!("{}: {topic}: {wrong}", self.who));
            *self.images.entry(topic).or_default() += 1;
            return;
        }
        let checked = expected.check(sensor, &said);
        checked.unwrap_or_else(|wrong| panic!("{}: {topic}: {wrong}", self.who));
        let quality = said.line["quality"].as_str().unwrap().to_owned();
        self.clouds
            .entry((topic, quality))
            .or_default()
            .push(expected.sequence);
    }

    fn check_markers(&mut self, consumer: &Consumer, markers: &Value) {
        let markers = markers.as_array().unwrap();
        assert_eq!(markers[0]["action"], 3, "the markers before are deleted");
        let expected = consumer
            .find(markers[0]["stamp_ns"].as_i64().unwrap())
            .unwrap();
        let segments = expected.view().segments.iter();
        let segments: Vec<_> = segments.filter(|one| one.flags == 0).collect();
        assert_eq!(markers.len(), 1 + segments.len());
        for (marker, segment) in markers[1..].iter().zip(segments) {
            let (label, min_m, max_m) = (segment.label, segment.min_m, segment.max_m);
            let of = |axis: usize| (f64::from(min_m[axis]), f64::from(max_m[axis]));
            let middle = |axis| (of(axis).0 + of(axis).1) / 2.0;
            let length = |axis| of(axis).1 - of(axis).0;
            let near =
                |value: &Value, expected: f64| (value.as_f64().unwrap() - expected).abs() < 0.011;
            assert!(
                marker["id"] == label
                    && marker["type"] == 1
                    && marker["action"] == 0
                    && marker["frame_id"] == "roof"
                    && near(&marker["position"][0], middle(1))
                    && near(&marker["position"][1], -middle(0))
                    && near(&marker["position"][2], middle(2))
                    && near(&marker["scale"][0], length(1))
                    && near(&marker["scale"][1], length(0))
                    && near(&marker["scale"][2], length(2)),
                "{marker} {label} {min_m:?} {max_m:?}"
            );
        }
        self.markers += 1;
    }

    /// Clouds of a topic that are missing, of all subscriptions: from the first one on there must
    /// be one for each sweep.
    fn lost(&self, topic: &str) -> u64 {
        let of_topic = self.clouds.iter().filter(|((of, _), _)| of == topic);
        let gaps = of_topic.flat_map(|(_, sequences)| sequences.windows(2));
        gaps.map(|two| two[1] - two[0] - 1).sum()
    }

    /// A number of a sensor's newest status.
    fn diagnosed(&self, sensor: &str, key: &str) -> u64 {
        let statuses = self.diagnostics.as_ref().unwrap().as_array().unwrap();
        let name = format!("sweepd: {sensor}");
        let status = statuses.iter().find(|one| one["name"] == name).unwrap();
        status["values"][key].as_str().unwrap().parse().unwrap()
    }
}

/// None is lost, unless this machine was too busy: then the bridge says how many it could not
/// deliver for more than 40 ms, and how many sweeps it missed itself.
fn check_lost(heard: &[&Heard<'_>]) {
    let told = heard.iter().find(|one| one.diagnostics.is_some()).unwrap();
    for (topic, sensor) in TOPICS.into_iter().zip(["roof", "front"]) {
        let lost: Vec<(&str, u64)> = heard.iter().map(|one| (one.who, one.lost(topic))).collect();
        let undelivered = told.diagnosed(sensor, "points lost");
        let missed = told.diagnosed(sensor, "missed sweeps");
        let sum: u64 = lost.iter().map(|(_, lost)| lost).sum();
        let subscriptions = (QUALITIES.len() * heard.len()) as u64;
        println!(
            "{topic}: lost {lost:?}; the bridge did not deliver {undelivered}, missed {missed}"
        );
        assert!(
            sum <= undelivered + missed * subscriptions
                && sum <= CLOUDS as u64 * subscriptions / 20,
            "{topic}: lost {lost:?}; the bridge did not deliver {undelivered}, missed {missed}"
        );
    }
}

/// rclpy knows the node, and its publishers by name, type, hash and quality.
fn check_graph(graph: &Value) {
    assert_eq!(graph["nodes"], json!(["/peer", "/sweepd"]));
    let publishers = graph["publishers"].as_object().unwrap();
    let topics = [
        "points",
        "ground",
        "nonground",
        "objects",
        "scan",
        "markers",
        "range_image",
        "label_image",
    ];
    for sensor in ["roof", "front"] {
        for topic in topics {
            let topic = format!("/sweepd/{sensor}/{topic}");
            assert!(publishers.contains_key(&topic), "{topic}: {publishers:?}");
        }
    }
    assert_eq!(publishers.len(), 2 * topics.len() + 4, "{publishers:?}");
    // On these is the peer, too.
    let own = publishers
        .iter()
        .filter(|(topic, _)| !["/rosout", "/parameter_events"].contains(&&topic[..]));
    for (topic, of_topic) in own {
        let [publisher] = &of_topic.as_array().unwrap()[..] else {
            panic!("{topic}: {of_topic}");
        };
        let durability = match &topic[..] {
            "/tf_static" => "TRANSIENT_LOCAL",
            _ => "VOLATILE",
        };
        assert_eq!(publisher["node"], "/sweepd", "{topic}");
        assert_eq!(publisher["reliability"], "RELIABLE", "{topic}");
        assert_eq!(publisher["durability"], durability, "{topic}");
        if let Some((_, hash)) = HASHES.iter().find(|(name, _)| publisher["type"] == *name) {
            assert_eq!(publisher["hash"], *hash, "{topic}");
        } else {
            assert_eq!(
                publisher["type"], "visualization_msgs/msg/MarkerArray",
                "{topic}"
            );
        }
    }
}

/// A reader of before Iron gets numbers of 24 bytes: the 16 of the wire and zeros.
fn check_old_graph(graph: &Value) {
    assert_eq!(graph["nodes"], json!(["/sweepd"]));
    let writers = graph["writers"].as_array().unwrap();
    // Eight topics of each sensor, two of the node, its log, its parameters' events and six services.
    assert_eq!(writers.len(), 26, "{writers:?}");
    let participant = graph["participant"].as_str().unwrap();
    assert!(
        participant.ends_with("000001c10000000000000000"),
        "{participant}"
    );
    for writer in writers {
        let writer = writer.as_str().unwrap();
        assert!(
            writer[..24] == participant[..24] && writer.ends_with("0000000000000000"),
            "{writer}"
        );
    }
}

/// The daemon and both sensors are well, and the counts are those of one subscription each.
fn check_diagnostics(statuses: &Value) {
    let statuses = statuses.as_array().unwrap();
    let names: Vec<&str> = statuses
        .iter()
        .map(|one| one["name"].as_str().unwrap())
        .collect();
    let all = ["sweepd", "sweepd: front", "sweepd: roof", "sweepd: ROS 2"];
    assert_eq!(names, all);
    assert_eq!(statuses[3]["level"], 0, "{}", statuses[3]);
    for status in statuses {
        assert!(
            status["level"].as_u64().is_some_and(|level| level <= 1),
            "{status}"
        );
    }
    let roof = &statuses[2];
    assert_eq!(roof["hardware_id"], "VLP-16 127.0.0.1");
    let values = &roof["values"];
    assert_eq!(
        (&values["model"], &values["state"]),
        (&json!("VLP-16"), &json!("streaming"))
    );
    let number = |key: &str| values[key].as_str().unwrap().parse::<f64>().unwrap();
    assert!((3.5..6.5).contains(&number("sweeps/s")), "{values}");
    assert!(
        number("points computed") > 100.0 && number("points subscribers") == 4.0,
        "{values}"
    );
    assert!(
        number("ground computed") == 0.0 && number("ground subscribers") == 0.0,
        "{values}"
    );
    assert!(number("markers computed") > 50.0, "{values}");
    assert!(
        number("daemon packets") > number("points computed"),
        "{values}"
    );
}

/// Where the configuration has the sensors, in the axes of ROS: by hand.
fn check_transforms(transforms: &Value) {
    let half = std::f64::consts::FRAC_1_SQRT_2;
    for (child, translation, rotation) in [
        // 1 m forward, 0.5 m to the right, turned to the left.
        ("roof", [1.0, -0.5, 1.5], [0.0, 0.0, half, half]),
        // The nose up is a negative rotation about y.
        ("front", [0.0, 0.0, 2.0], [0.0, -half, 0.0, half]),
    ] {
        let transforms = transforms.as_array().unwrap();
        let one = transforms.iter().find(|one| one["child"] == child).unwrap();
        assert_eq!(one["parent"], "base_link");
        for (key, expected) in [("translation", &translation[..]), ("rotation", &rotation)] {
            for (index, expected) in expected.iter().enumerate() {
                let found = one[key][index].as_f64().unwrap();
                assert!((found - expected).abs() < 1e-6, "{child}: {key}: {one}");
            }
        }
    }
}
