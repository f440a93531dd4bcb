//! A replay's clock, before a node of rclpy with `use_sim_time`.

use std::process::Stdio;
use std::thread::sleep;
use std::time::{Duration, Instant};

use serde_json::json;
use sweepd_testkit::{PATIENCE, Process};

use super::alone;
use super::peer::Peer;
use super::world::{World, vlp16};
use sweepd_testkit::setup::sweepd;

/// DDS domain of this test.
const DOMAIN: u32 = 87;
/// A turn at 10 Hz, nanoseconds.
const TURN_NS: i64 = 100_000_000;
/// Begins of the replay that are waited for. The capture has four seconds.
const LOOPS: usize = 3;

/// Its timers run, its clock agrees with the stamps to within a turn, and it learns that time goes
/// back.
#[test]
#[cfg_attr(
    without_ros,
    ignore = "no peers of ROS 2: SWEEPD_JAZZY, SWEEPD_KILTED, SWEEPD_ROS_PYTHON, libfastrtps-dev"
)]
fn a_node_with_use_sim_time_lives_in_a_replay() {
    let _alone = alone();
    let world = World::new(&[]);
    let words = ["--ros-args", "-p", "clock:=true", "-p", "health:=''"];
    let bridge = world.bridge_of_whole_turns(DOMAIN, &words);
    let wanted = json!({
        "clouds": ["/sweepd/roof/points"],
        "qualities": ["reliable"],
        "sim_time": true,
    });
    let mut peer = Peer::ros("SWEEPD_JAZZY", DOMAIN, &wanted).ready();
    let mut replay = sweepd(&[
        "replay",
        "--loop",
        "--speed",
        "1",
        "--publish",
        "roof",
        "--root",
    ]);
    replay.arg(world.own.root()).arg(vlp16());
    let _replay = Process::start(replay.stdout(Stdio::null())).unwrap();

    let (mut ticks, mut back_s, mut off_ns, mut last_ns) = (0, Vec::new(), Vec::new(), i64::MIN);
    let begun = Instant::now();
    while back_s.len() < LOOPS {
        assert!(
            begun.elapsed() < 3 * PATIENCE,
            "{ticks} {back_s:?} {off_ns:?}"
        );
        let Some(said) = peer.next(PATIENCE) else {
            continue;
        };
        let line = said.line;
        if let Some(jump_ns) = line["jump_ns"].as_i64() {
            back_s.push(jump_ns as f64 * -1e-9);
            last_ns = i64::MIN;
        } else if let Some(clock_ns) = line["tick_ns"].as_i64() {
            // As fast as the replay, and monotone.
            assert!(clock_ns > last_ns, "{clock_ns} after {last_ns}");
            (ticks, last_ns) = (ticks + 1, clock_ns);
        } else if let (Some(stamp_ns), Some(clock_ns)) =
            (line["stamp_ns"].as_i64(), line["clock_ns"].as_i64())
        {
            off_ns.push(clock_ns - (stamp_ns + TURN_NS));
        }
    }
    // From the first turn of four seconds to the last.
    assert!(
        back_s.iter().all(|back_s| (3.4..4.2).contains(back_s)),
        "{back_s:?}"
    );
    assert!(ticks >= 25 * LOOPS, "{ticks}");
    // What comes around a jump, or on a machine that is late, may be further off.
    let within = off_ns
        .iter()
        .filter(|off_ns| off_ns.abs() <= TURN_NS)
        .count();
    assert!(within * 10 >= off_ns.len() * 9 && within > 60, "{off_ns:?}");
    // The peer may be quicker than who reads the log.
    let told = || bridge.log().matches("/clock goes back by").count();
    let begun = Instant::now();
    while told() < LOOPS && begun.elapsed() < PATIENCE {
        sleep(Duration::from_millis(20));
    }
    assert!((LOOPS..=LOOPS + 1).contains(&told()), "{}", bridge.log());
}
