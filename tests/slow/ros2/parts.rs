//! `ground` and `nonground` are the cloud, `scan` is `nonground` from above; what is no whole turn is
//! left out.

use std::collections::{BTreeMap, BTreeSet};
use std::time::Instant;

use serde_json::json;
use sweepd::sweep::layout::flags;
use sweepd_testkit::PATIENCE;

use super::events::{number, values};
use super::expected::{Consumer, STEP};
use super::hurry;
use super::peer::Peer;
use super::world::{ROOF_MOUNT, World, vlp16};

/// DDS domains of this test: one for each version of Fast DDS.
const WITH_JAZZY: u32 = 95;
const WITH_KILTED: u32 = 96;
const TOPICS: [&str; 4] = ["points", "ground", "nonground", "objects"];
/// Sweeps that a peer must have all clouds of. The capture begins again after 40.
const SWEEPS: usize = 100;

/// The points of a sweep, by topic.
type Clouds = BTreeMap<String, Vec<u8>>;

#[test]
#[cfg_attr(
    without_ros,
    ignore = "no peers of ROS 2: SWEEPD_JAZZY, SWEEPD_KILTED, SWEEPD_ROS_PYTHON, libfastrtps-dev"
)]
fn parts_add_up_and_are_of_whole_turns() {
    hurry("-10");
    let world = World::new(&[("roof", ROOF_MOUNT)]);
    let vlp16 = vlp16();
    let _daemon = world.daemon();
    let consumer = Consumer::start(&world.domain(), "roof");
    let health = world.health();
    let health: Vec<&str> = health.iter().map(String::as_str).collect();
    let _bridges =
        [WITH_JAZZY, WITH_KILTED].map(|domain| world.bridge_of_whole_turns(domain, &health));
    let wanted = json!({
        "clouds": TOPICS.map(|topic| format!("/sweepd/roof/{topic}")),
        "scans": ["/sweepd/roof/scan"],
        "data": true,
        "qualities": ["reliable"],
        "diagnostics": true,
    });
    let peers = [("SWEEPD_JAZZY", WITH_JAZZY), ("SWEEPD_KILTED", WITH_KILTED)];
    let peers = peers.map(|(variable, domain)| Peer::ros(variable, domain, &wanted).ready());
    let _roof = world.feed("roof", vlp16, "1");
    std::thread::scope(|scope| {
        for peer in peers {
            scope.spawn(|| listen(peer, &consumer));
        }
    });
}

/// Takes clouds until there are enough, and the bridge has said what it left out.
fn listen(mut peer: Peer, consumer: &Consumer) {
    let (mut sweeps, mut added_up) = (BTreeMap::<i64, Clouds>::new(), BTreeSet::new());
    let (begun, mut left_out) = (Instant::now(), 0);
    while added_up.len() < SWEEPS || left_out < 2 {
        assert!(
            begun.elapsed() < 4 * PATIENCE,
            "{} sweeps, {left_out} left out",
            added_up.len()
        );
        let Some(said) = peer.next(PATIENCE) else {
            continue;
        };
        if let Some(values) = values(&said.line, "roof") {
            left_out = number(values, "incomplete sweeps");
            let known = number(values, "points computed") + left_out;
            // A number is read while the others go on.
            assert!(known <= number(values, "sweeps") + 1, "{values}");
            continue;
        }
        let (Some(topic), Some(stamp_ns)) =
            (said.line["topic"].as_str(), said.line["stamp_ns"].as_i64())
        else {
            continue;
        };
        let clouds = sweeps.entry(stamp_ns).or_default();
        clouds.insert(
            topic.trim_start_matches("/sweepd/roof/").to_owned(),
            said.data,
        );
        if topic.ends_with("scan") {
            assert_eq!(said.line["frame_id"], "base_link");
            assert_eq!(said.line["intensities"], DIRECTIONS);
        }
        if clouds.len() == TOPICS.len() + 1 {
            check(clouds);
            check_scan(clouds);
            let sweep = consumer.find(stamp_ns).expect("the sweep of a cloud");
            assert!(!sweep.view().header.has(flags::PARTIAL));
            added_up.insert(stamp_ns);
            sweeps.remove(&stamp_ns);
        }
    }
    println!("{} sweeps, {left_out} left out", added_up.len());
}

/// The points of a topic, each once.
fn points<'a>(clouds: &'a Clouds, topic: &str) -> Vec<&'a [u8]> {
    clouds[topic].chunks_exact(STEP).collect()
}

fn check(clouds: &Clouds) {
    let [all, ground, nonground, objects] = TOPICS.map(|topic| points(clouds, topic));
    let time_s = |point: &&[u8]| f32::from_le_bytes(point[18..22].try_into().unwrap());
    for part in [&all, &ground, &nonground, &objects] {
        assert!(part.is_sorted_by_key(time_s), "a time steps back");
    }
    // A beam of a VLP-16 fires alone: merged by time, the parts are the cloud.
    let mut both = [&ground[..], &nonground].concat();
    both.sort_by(|one, other| time_s(one).total_cmp(&time_s(other)));
    assert!(both == all, "ground and nonground are not the cloud");
    let of_nonground: BTreeSet<&[u8]> = nonground.iter().copied().collect();
    assert!(objects.iter().all(|point| of_nonground.contains(point)));
    assert!(objects.len() < nonground.len() && !ground.is_empty());
}

/// Directions of a scan.
const DIRECTIONS: usize = 720;

/// A scan is made of the points of the same sweep, seen in the robot's frame.
fn check_scan(clouds: &Clouds) {
    let mut expected = [f32::NAN; DIRECTIONS];
    let mut see = |point: &[u8], is_nonground: bool| {
        let axis = |at: usize| f32::from_le_bytes(point[at..at + 4].try_into().unwrap());
        // ROOF_MOUNT by hand: turned by a quarter to the left, 1 m ahead, 0.5 m to the right, 1.5 m up.
        let [x, y, z] = [1.0 - axis(4), axis(0) - 0.5, axis(8) + 1.5];
        let direction = (y.atan2(x).to_degrees() + 180.0) * 2.0;
        let nearest = &mut expected[(direction as usize).min(DIRECTIONS - 1)];
        let is_in = (-0.5..=2.0).contains(&z);
        // Where the beam leaves the band, as a part of its way.
        let part = if is_in {
            1.0
        } else {
            (if z > 2.0 { 0.5 } else { -2.0 }) / (z - 1.5)
        };
        let reach = (1.0 + part * (x - 1.0)).hypot(-0.5 + part * (y + 0.5));
        // The least of a number and NaN is the number.
        if is_in && is_nonground {
            *nearest = nearest.min(x.hypot(y));
        } else if reach >= 10.0 {
            *nearest = nearest.min(f32::INFINITY);
        }
    };
    for topic in ["ground", "nonground"] {
        for point in points(clouds, topic) {
            see(point, topic == "nonground");
        }
    }
    let ranges = clouds["scan"].chunks_exact(4);
    let ranges: Vec<f32> = ranges
        .map(|range| f32::from_le_bytes(range.try_into().unwrap()))
        .collect();
    assert_eq!(ranges.len(), DIRECTIONS);
    let differs = |(range, expected): &(&f32, &f32)| {
        let is_same = range == expected || range.is_nan() && expected.is_nan();
        let is_near = (*range - *expected).abs() < 1e-3;
        !is_same && !is_near
    };
    // A point between two directions, or at the end of the band, may be rounded either way.
    let differ = ranges.iter().zip(&expected).filter(differs).count();
    assert!(differ < 4, "{differ} directions differ");
    assert!(ranges.iter().filter(|range| range.is_finite()).count() > 100);
}
