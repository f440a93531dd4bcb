//! Subscribers on other hosts: they hear again when their link, the bridge, or they themselves were
//! away for a while, and in whichever of the robot's networks they are.

use std::array;
use std::process::{Command, Stdio};
use std::thread::sleep;
use std::time::{Duration, SystemTime};

use serde_json::json;
use sweepd_testkit::{Daemon, PATIENCE, Process, Signal};

use super::network::Network;
use super::peer::Peer;
use super::world::{World, on_domain, vlp16};

/// DDS domain of these tests, each of which has networks of its own.
const DDS_DOMAIN: u32 = 103;
const POINTS: &str = "/sweepd/roof/points";
const MIDDLEWARES: [&str; 2] = ["cyclonedds", "rclpy"];
const QUALITIES: [&str; 2] = ["best_effort", "reliable"];
/// Subscribers of each middleware and quality. They say little, and at times of their own.
const OF_EACH: usize = 2;
/// A subscriber to which no cloud comes for so long does not hear.
const PAUSE_NS: i64 = 2_000_000_000;
/// One that hears at this time after a gap goes on: a lease ends at most 3 s after it, as that is
/// how much shorter than a lease the time between announcements may be.
const SETTLED_NS: i64 = 5_000_000_000;

/// Part that is away for a while.
#[derive(Clone, Copy, Debug)]
enum Away {
    Link,
    Subscribers,
    Bridge,
}

/// A daemon with a sensor, and the bridge, which has a network of its own.
struct Robot {
    bridge: Process,
    network: Network,
    _feed: Process,
    _daemon: Daemon,
    _world: World,
}

impl Robot {
    /// A robot in so many other networks, whose addresses it has in this order.
    fn new(others: &[Network]) -> Self {
        let network = Network::new();
        network.shell("ip link set lo up");
        for (number, other) in others.iter().enumerate() {
            network.shell(&format!(
                "ip link add net{number} type veth peer name robot netns {}\n\
                 ip address add 10.79.{number}.1/24 dev net{number}; ip link set net{number} up",
                other.pid()
            ));
            other.shell(&format!(
                "ip link set lo up; ip address add 10.79.{number}.2/24 dev robot; ip link set robot up"
            ));
        }
        let world = World::new(&[("roof", "")]);
        let daemon = world.daemon();
        let feed = world.feed("roof", vlp16(), "1");
        let bridge = on_subnet(world.bridge_command(DDS_DOMAIN, &["roof"]));
        let bridge = Process::start(network.within(&bridge).stdout(Stdio::null())).unwrap();
        Self {
            bridge,
            network,
            _feed: feed,
            _daemon: daemon,
            _world: world,
        }
    }

    /// Takes something away, or brings it back.
    fn set(&self, away: Away, subscribers: &[Subscriber], is_there: bool) {
        let (state, signal) = match is_there {
            true => ("up", Signal::CONT),
            false => ("down", Signal::STOP),
        };
        match away {
            Away::Link => self.network.shell(&format!("ip link set net0 {state}")),
            Away::Bridge => self.bridge.signal(signal).unwrap(),
            Away::Subscribers => {
                for one in subscribers {
                    one.peer.process.signal(signal).unwrap();
                }
            }
        }
    }
}

/// A peer that hears clouds in one quality.
struct Subscriber {
    name: String,
    peer: Peer,
}

impl Subscriber {
    fn new(network: &Network, middleware: &str, quality: &str) -> Self {
        let wanted = json!({"clouds": [POINTS], "qualities": [quality]});
        let mut command = match middleware {
            "rclpy" => Peer::ros_command("SWEEPD_JAZZY", &wanted),
            _ => Peer::cyclone_command(DDS_DOMAIN, wanted),
        };
        command.env_remove("CYCLONEDDS_URI");
        Self {
            name: format!("{middleware}, {quality}"),
            peer: Peer::start_as_is(network.within(&on_subnet(command))),
        }
    }

    /// Seconds from a time until clouds come that were scanned after it, and go on coming.
    fn hears_after(&mut self, since_ns: i64) -> Option<f64> {
        let (mut first_ns, mut last_ns) = (None, since_ns);
        loop {
            let waited = Duration::from_nanos((now_ns() - since_ns) as u64);
            // Where none of the time is left, what has come is still looked at.
            let said = self.peer.next((3 * PATIENCE).saturating_sub(waited))?.line;
            let Some(stamp_ns) = said["stamp_ns"].as_i64().filter(|&ns| ns > since_ns) else {
                continue;
            };
            let received_ns = said["received_ns"].as_i64().unwrap();
            if first_ns.is_none() || received_ns - last_ns > PAUSE_NS {
                first_ns = Some(received_ns);
            }
            last_ns = received_ns;
            if stamp_ns > since_ns + SETTLED_NS {
                return first_ns.map(|first_ns| (first_ns - since_ns) as f64 * 1e-9);
            }
        }
    }
}

fn now_ns() -> i64 {
    SystemTime::UNIX_EPOCH.elapsed().unwrap().as_nanos() as i64
}

/// The command on the domain of these tests, with other hosts.
fn on_subnet(mut command: Command) -> Command {
    on_domain(&mut command, DDS_DOMAIN);
    command.env("ROS_AUTOMATIC_DISCOVERY_RANGE", "SUBNET");
    command
}

/// Takes something away for so many seconds, again and again: each time all subscribers must get
/// clouds again, within so many seconds of its return.
fn check(away: Away, gaps_s: &[u64], limit_s: f64) {
    let host = [Network::new()];
    let robot = Robot::new(&host);
    let kinds = MIDDLEWARES.into_iter().flat_map(|middleware| {
        QUALITIES
            .into_iter()
            .flat_map(move |quality| [(middleware, quality); OF_EACH])
    });
    let mut subscribers: Vec<_> = kinds
        .map(|(middleware, quality)| Subscriber::new(&host[0], middleware, quality))
        .collect();
    let begun_ns = now_ns();
    for one in &mut subscribers {
        assert!(
            one.hears_after(begun_ns).is_some(),
            "{} hears nothing",
            one.name
        );
    }
    let mut late = vec![];
    for &gap_s in gaps_s {
        robot.set(away, &subscribers, false);
        sleep(Duration::from_secs(gap_s));
        robot.set(away, &subscribers, true);
        let since_ns = now_ns();
        for one in &mut subscribers {
            let after_s = one.hears_after(since_ns);
            let after = after_s.map_or("never".to_owned(), |after_s| format!("{after_s:.1} s"));
            let row = format!(
                "{}: {away:?} away for {gap_s} s, hears after: {after}",
                one.name
            );
            println!("{row}");
            if after_s.is_none_or(|after_s| after_s > limit_s) {
                late.push(row);
            }
        }
    }
    assert!(late.is_empty(), "after more than {limit_s} s: {late:#?}");
}

#[test]
#[cfg_attr(
    any(without_ros, without_root),
    ignore = "not root, or no peers of ROS 2: SWEEPD_JAZZY, SWEEPD_KILTED, SWEEPD_ROS_PYTHON, libfastrtps-dev"
)]
fn clouds_come_again_after_a_link_was_down() {
    // Shorter than all leases, between that of Cyclone DDS (10 s) and our own (20 s), and longer. A
    // machine may be late: here they must come at all.
    check(Away::Link, &[5, 14, 21], f64::INFINITY);
}

/// `cargo test --features slow-tests --test slow ros2::gaps -- --ignored --nocapture --test-threads 1`
#[test]
#[ignore = "takes minutes"]
fn clouds_come_again_in_time_after_a_link_was_down() {
    check(Away::Link, &[3, 5, 8, 12, 14, 17, 21, 40], 15.0);
}

#[test]
#[ignore = "takes minutes"]
fn clouds_come_again_after_subscribers_stopped() {
    check(Away::Subscribers, &[12, 30], 10.0);
}

#[test]
#[ignore = "takes minutes"]
fn clouds_come_again_after_the_bridge_stopped() {
    check(Away::Bridge, &[12, 22, 40], 10.0);
}

#[test]
#[cfg_attr(
    any(without_ros, without_root),
    ignore = "not root, or no peers of ROS 2: SWEEPD_JAZZY, SWEEPD_KILTED, SWEEPD_ROS_PYTHON, libfastrtps-dev"
)]
fn each_of_a_robots_networks_gets_clouds() {
    let hosts: [_; 6] = array::from_fn(|_| Network::new());
    let _robot = Robot::new(&hosts);
    let mut subscribers: Vec<_> = hosts
        .iter()
        .map(|host| Subscriber::new(host, "cyclonedds", "reliable"))
        .collect();
    subscribers.push(Subscriber::new(&hosts[5], "rclpy", "best_effort"));
    let begun_ns = now_ns();
    let heard: Vec<_> = subscribers
        .iter_mut()
        .map(|one| one.hears_after(begun_ns))
        .collect();
    println!("network by network, the first cloud after {heard:.1?} s");
    assert!(heard.iter().all(Option::is_some), "{heard:?}");
}
