//! Large clouds, often, to many readers, one of which stops.

use std::collections::BTreeMap;
use std::time::{Duration, Instant};

use serde_json::json;
use sweepd_testkit::{PATIENCE, Signal};

use super::alone;
use super::expected::Consumer;
use super::peer::Peer;
use super::world::{World, hdl64e};

/// DDS domain of this test.
const DDS_DOMAIN: u32 = 93;
const POINTS: &str = "/sweepd/front/points";
/// Clouds that each reader must get, at 20 Hz.
const CLOUDS: usize = 200;
/// How long the slow reader stops.
const STOPPED: Duration = Duration::from_secs(4);
/// Runs in which another program may have the cores.
const RUNS: usize = 3;

/// The numbers of the sweeps that the readers of a peer got, by quality.
pub type Got = BTreeMap<String, Vec<u64>>;

#[test]
#[cfg_attr(
    without_ros,
    ignore = "no peers of ROS 2: SWEEPD_JAZZY, SWEEPD_KILTED, SWEEPD_ROS_PYTHON, libfastrtps-dev"
)]
fn a_reader_that_stops_costs_four_others_nothing() {
    let _alone = alone();
    let world = World::new(&[("front", "")]);
    let hdl64e = hdl64e();
    let _daemon = world.daemon();
    let consumer = Consumer::start(&world.domain(), "front");
    // Twice as fast as it was recorded: 3.4 MB at 20 Hz.
    let _feed = world.feed("front", hdl64e, "2");
    let _bridge = world.bridge(DDS_DOMAIN, &["front"]);
    let wanted = json!({"clouds": [POINTS]});
    let mut peers = [
        Peer::ros("SWEEPD_JAZZY", DDS_DOMAIN, &wanted),
        Peer::cyclone(DDS_DOMAIN, wanted.clone()),
    ];
    let mut slow = Peer::cyclone(DDS_DOMAIN, wanted);
    for peer in peers.iter_mut().chain([&mut slow]) {
        peer.wait_for("a cloud came", |said| said.line["topic"] == POINTS);
    }
    for run in 1.. {
        let lost = lost(&consumer, &mut peers, &mut slow);
        println!("run {run}: lost {lost:?}");
        if lost.iter().all(|&lost| lost == 0) {
            break;
        }
        assert!(run < RUNS, "each of {RUNS} runs lost some");
    }
}

/// Clouds that each of four readers lost while another one stopped.
fn lost(consumer: &Consumer, peers: &mut [Peer; 2], slow: &mut Peer) -> Vec<u64> {
    let got: Vec<Got> = std::thread::scope(|scope| {
        let threads: Vec<_> = peers
            .iter_mut()
            .map(|peer| scope.spawn(|| listen(consumer, peer, CLOUDS)))
            .collect();
        std::thread::sleep(Duration::from_secs(1));
        slow.process.signal(Signal::STOP).unwrap();
        std::thread::sleep(STOPPED);
        slow.process.signal(Signal::CONT).unwrap();
        slow.forget();
        let newest = consumer.newest().unwrap();
        slow.wait_for("the reader that stopped gets clouds again", |said| {
            let stamp_ns = said.line["stamp_ns"].as_i64();
            stamp_ns.is_some_and(|ns| consumer.find(ns).is_some_and(|one| one.sequence > newest))
        });
        threads
            .into_iter()
            .map(|thread| thread.join().unwrap())
            .collect()
    });
    lost_of_each(&got)
}

/// Clouds that each reader lost.
pub fn lost_of_each(got: &[Got]) -> Vec<u64> {
    let of_each = got.iter().flat_map(Got::values);
    let gaps = of_each.map(|got| got.windows(2).map(|two| two[1] - two[0] - 1).sum());
    gaps.collect()
}

/// Takes clouds until both readers of a peer have so many.
pub fn listen(consumer: &Consumer, peer: &mut Peer, clouds: usize) -> Got {
    peer.forget();
    let (begun, mut got, mut large) = (Instant::now(), Got::new(), 0);
    while got.len() < 2 || got.values().any(|got| got.len() < clouds) {
        if begun.elapsed() > 3 * PATIENCE {
            panic!("{}", peer.process.failure(format!("{got:?}")));
        }
        let Some(said) = peer.next(Duration::from_millis(100)) else {
            continue;
        };
        let (Some(stamp_ns), Some(quality)) = (
            said.line["stamp_ns"].as_i64(),
            said.line["quality"].as_str(),
        ) else {
            continue;
        };
        // A sweep that this program itself missed counts as lost: there is another run.
        let Some(expected) = consumer.find(stamp_ns) else {
            continue;
        };
        large += usize::from(said.line["length"].as_u64().unwrap() > 3_200_000);
        got.entry(quality.to_owned())
            .or_default()
            .push(expected.sequence);
    }
    // Where the capture begins again, a sweep is in parts.
    assert!(large > 19 * clouds / 10, "{large}");
    got
}
