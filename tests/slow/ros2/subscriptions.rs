//! Messages of real peers, as a node of the library takes them: of both qualities, in one datagram and in
//! fragments, by a subscription that comes late, and over a restart of the publisher.

use std::thread;
use std::time::{Duration, Instant};

use serde_json::{Value, json};
use sweepd_messages::message_type::POINT_CLOUD;
use sweepd_ros2::{DiscoveryRange, Environment, Node, Quality, Subscription};
use sweepd_testkit::PATIENCE;

use super::hurry;
use super::peer::Peer;

/// Messages that each subscription gets.
const MESSAGES: usize = 40;

/// Topic, the quality that the publisher offers, and bytes of its messages: one datagram, and more than any.
const PUBLISHED: [(&str, &str, usize); 4] = [
    ("/small/all", "reliable", 500),
    ("/large/all", "reliable", 200_000),
    ("/small/some", "best_effort", 500),
    ("/large/some", "best_effort", 200_000),
];

/// What is subscribed to: topic, quality, and bytes.
fn subscriptions(node: &Node) -> Vec<(Subscription, Quality, usize)> {
    let mut all = vec![];
    for (topic, offered, bytes) in PUBLISHED {
        let mut qualities = vec![Quality::BestEffort];
        if offered == "reliable" {
            qualities.push(Quality::Reliable);
        }
        for quality in qualities {
            let one = node.subscription(topic, &POINT_CLOUD, quality, 20).unwrap();
            all.push((one, quality, bytes));
        }
    }
    all
}

/// The number of a message, which has that many bytes of it.
fn number(message: &[u8], bytes: usize) -> u32 {
    let number = u32::from_le_bytes(message[4..8].try_into().unwrap());
    let same = message.iter().filter(|byte| **byte == number as u8);
    assert!(same.count() >= bytes && message.len() < bytes + 200);
    number
}

/// The numbers of messages, once so many have come of each subscription.
fn numbers(all: &[(Subscription, Quality, usize)], messages: usize) -> Vec<Vec<u32>> {
    let mut numbers = vec![vec![]; all.len()];
    let begun = Instant::now();
    while numbers.iter().any(|of| of.len() < messages) {
        let counts: Vec<usize> = numbers.iter().map(Vec::len).collect();
        assert!(begun.elapsed() < PATIENCE, "{counts:?}");
        for ((one, _, bytes), numbers) in all.iter().zip(&mut numbers) {
            while let Some(message) = one.take() {
                numbers.push(number(&message, *bytes));
            }
        }
        thread::sleep(Duration::from_millis(5));
    }
    numbers
}

fn node(dds_domain: u32) -> Node {
    let environment = Environment {
        domain: dds_domain as u16,
        range: DiscoveryRange::Localhost,
        static_peers: vec![],
    };
    Node::new(&environment, "/", "sweepd").unwrap()
}

/// Holds a kind of publishers to what they send.
fn hears(dds_domain: u32, start: impl Fn() -> Peer) {
    hurry("-10");
    let publisher = start().ready();
    thread::sleep(Duration::from_secs(1));
    let node = node(dds_domain);
    let all = subscriptions(&node);
    let demanding = node
        .subscription("/small/some", &POINT_CLOUD, Quality::Reliable, 5)
        .unwrap();
    let begun = Instant::now();
    let heard = numbers(&all, MESSAGES);
    println!("{MESSAGES} of each: {:.1} s", begun.elapsed().as_secs_f64());
    for ((one, quality, _), numbers) in all.iter().zip(&heard) {
        let follows = |pair: &[u32]| match quality {
            Quality::BestEffort => pair[0] < pair[1],
            _ => pair[0] + 1 == pair[1],
        };
        let in_order = numbers.windows(2).all(follows);
        assert!(in_order, "{} {quality:?}: {numbers:?}", one.topic());
        assert_eq!(one.publishers(), 1);
    }
    assert_eq!((demanding.publishers(), demanding.take()), (0, None));

    // It dies without a word, and another one comes.
    drop(publisher);
    thread::sleep(Duration::from_millis(500));
    while all.iter().any(|(one, ..)| one.take().is_some()) {}
    let _publisher = start().ready();
    numbers(&all, 3);
}

/// What a peer of rclpy or Cyclone DDS is to do.
fn wanted() -> Value {
    json!({"publish": PUBLISHED, "qualities": ["best_effort", "reliable"]})
}

#[test]
#[cfg_attr(
    without_ros,
    ignore = "no peers of ROS 2: SWEEPD_JAZZY, SWEEPD_KILTED, SWEEPD_ROS_PYTHON, libfastrtps-dev"
)]
fn messages_of_jazzy_arrive() {
    hears(97, || Peer::ros("SWEEPD_JAZZY", 97, &wanted()));
}

#[test]
#[cfg_attr(
    without_ros,
    ignore = "no peers of ROS 2: SWEEPD_JAZZY, SWEEPD_KILTED, SWEEPD_ROS_PYTHON, libfastrtps-dev"
)]
fn messages_of_kilted_arrive() {
    hears(98, || Peer::ros("SWEEPD_KILTED", 98, &wanted()));
}

#[test]
#[cfg_attr(
    without_ros,
    ignore = "no peers of ROS 2: SWEEPD_JAZZY, SWEEPD_KILTED, SWEEPD_ROS_PYTHON, libfastrtps-dev"
)]
fn messages_of_cyclone_arrive() {
    hears(99, || Peer::cyclone(99, wanted()));
}

#[test]
#[cfg_attr(
    without_ros,
    ignore = "no peers of ROS 2: SWEEPD_JAZZY, SWEEPD_KILTED, SWEEPD_ROS_PYTHON, libfastrtps-dev"
)]
fn messages_of_debian_s_fast_dds_arrive() {
    let sizes = PUBLISHED.map(|(.., bytes)| bytes.to_string());
    let mut words = vec!["publish"];
    for ((topic, quality, _), bytes) in PUBLISHED.iter().zip(&sizes) {
        words.extend([*topic, *quality, bytes.as_str()]);
    }
    hears(100, || Peer::fastdds(100, &words));
}

#[test]
#[cfg_attr(
    without_ros,
    ignore = "no peers of ROS 2: SWEEPD_JAZZY, SWEEPD_KILTED, SWEEPD_ROS_PYTHON, libfastrtps-dev"
)]
fn a_late_subscription_gets_what_is_kept_and_is_in_the_graph() {
    let wanted = json!({"publish": [("/kept", "transient_local", 100)], "nodes": true});
    let mut peer = Peer::ros("SWEEPD_JAZZY", 101, &wanted).ready();
    let node = node(101);
    let kept = node.subscription("kept", &POINT_CLOUD, Quality::TransientLocal, 5);
    let kept = kept.unwrap();
    let begun = Instant::now();
    let message = loop {
        assert!(begun.elapsed() < PATIENCE);
        match kept.take() {
            Some(message) => break message,
            None => thread::sleep(Duration::from_millis(5)),
        }
    };
    assert_eq!(number(&message, 100), 1);
    peer.wait_for("the subscription is in the graph", |said| {
        said.line["graph"]["subscriptions"] == json!({"/kept": ["sensor_msgs/msg/PointCloud2"]})
    });
    drop(kept);
    peer.wait_for("it has gone", |said| {
        said.line["graph"]["nodes"] == json!(["/peer", "/sweepd"])
            && said.line["graph"]["subscriptions"] == json!({})
    });
}
