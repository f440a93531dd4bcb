//! Subscribers on other hosts that are not there: they delay none that is.
//!
//! Bridge and honest subscribers are in a network of their own, which a cable joins to that of the
//! attacker. There are 256 addresses that the attacker sends from, and at which nothing answers.

use std::process::{Command, Stdio};

use serde_json::json;
use sweepd_testkit::Process;

use super::alone;
use super::crowd::{listen, lost_of_each};
use super::expected::Consumer;
use super::network::Network;
use super::peer::{Peer, interpreter, script};
use super::world::{World, hdl64e};

/// DDS domain of this test.
const DDS_DOMAIN: u32 = 98;
const POINTS: &str = "/sweepd/front/points";
/// Clouds of which each reader must get all but two, at 10 Hz.
const CLOUDS: usize = 60;
const MAY_LOSE: u64 = 2;
/// Runs in which another program may have the cores.
const RUNS: usize = 3;

/// Joins the networks. What is sent to an address of 10.79.1.0/24 finds nobody, as nothing answers
/// who has it; who is in the second may send from all of them.
fn join(here: &Network, there: &Network) {
    here.shell(&format!(
        "ip link set lo up; ip link set lo multicast on\n\
         ip link add near0 address 02:00:0a:4f:00:01 type veth peer name far0 netns {}\n\
         ip address add 10.79.0.1/23 dev near0; ip link set near0 up",
        there.pid()
    ));
    there.shell(
        "ip link set lo up; ip link set far0 arp off; ip link set far0 up; ip address add 10.79.0.2/24 dev far0\n\
         ip neighbour add 10.79.0.1 lladdr 02:00:0a:4f:00:01 dev far0\n\
         ip route add local 10.79.1.0/24 dev lo",
    );
}

/// 256 participants that are nowhere, with so many readers of clouds each.
fn spoof(there: &Network, readers: usize, confirmed: &str) -> Peer {
    let mut command = Command::new(interpreter("SWEEPD_ROS_PYTHON"));
    command.arg(script("spoofer.py")).args([
        &(7400 + 250 * DDS_DOMAIN).to_string(),
        "10.79.0.2",
        "10.79.1.",
        &readers.to_string(),
        &format!("rt{POINTS}"),
        confirmed,
    ]);
    Peer::start(there.within(&command), DDS_DOMAIN).ready()
}

/// Readers of the clouds that get something, or would.
fn readers(watcher: &mut Peer) -> usize {
    watcher.forget();
    let said = watcher.wait_for("diagnostics", |said| !said.line["diagnostics"].is_null());
    let statuses = said.line["diagnostics"].as_array().unwrap();
    let sensor = statuses.iter().find(|one| one["name"] == "sweepd: front");
    let readers = &sensor.expect("a status of the sensor")["values"]["points subscribers"];
    readers.as_str().unwrap().parse().unwrap()
}

#[test]
#[cfg_attr(
    any(without_ros, without_root),
    ignore = "not root, or no peers of ROS 2: SWEEPD_JAZZY, SWEEPD_KILTED, SWEEPD_ROS_PYTHON, libfastrtps-dev"
)]
fn readers_that_are_nowhere_delay_none_that_is_here() {
    let _alone = alone();
    let world = World::new(&[("front", "")]);
    let hdl64e = hdl64e();
    let _daemon = world.daemon();
    let consumer = Consumer::start(&world.domain(), "front");
    let _feed = world.feed("front", hdl64e, "1");
    let (here, there) = (Network::new(), Network::new());
    join(&here, &there);
    let mut bridge = here.within(&world.bridge_command(DDS_DOMAIN, &["front"]));
    bridge.env("ROS_AUTOMATIC_DISCOVERY_RANGE", "SUBNET");
    let _bridge = Process::start(bridge.stdout(Stdio::null())).unwrap();
    let clouds = Peer::cyclone_command(DDS_DOMAIN, json!({"clouds": [POINTS]}));
    let mut peer = Peer::start(here.within(&clouds), DDS_DOMAIN);
    let watcher = Peer::ros_command("SWEEPD_JAZZY", &json!({"diagnostics": true}));
    let mut watcher = Peer::start(here.within(&watcher), DDS_DOMAIN);
    peer.wait_for("a cloud came", |said| said.line["topic"] == POINTS);
    for (readers_of_each, confirmed) in [(1, "no"), (1, "yes"), (16, "yes")] {
        let _spoofer = spoof(&there, readers_of_each, confirmed);
        let known = readers(&mut watcher);
        assert_eq!(known > 250, confirmed == "yes", "{known}");
        for run in 1.. {
            let got = listen(&consumer, &mut peer, CLOUDS);
            let lost = lost_of_each(&[got]);
            println!(
                "{readers_of_each} each, acknowledging: {confirmed}, {known} known: run {run}: lost {lost:?} of {CLOUDS}"
            );
            if lost.iter().all(|&lost| lost <= MAY_LOSE) {
                break;
            }
            assert!(run < RUNS, "each of {RUNS} runs lost some");
        }
    }
}
