//! How long a cloud of an HDL-64E takes to a node's callback, beside a plain publisher; what the
//! bridge takes of a core, and of memory.

use std::collections::BTreeMap;
use std::process::Command;
use std::time::{Duration, Instant};

use serde_json::json;
use sweepd_testkit::Process;

use super::alone;
use super::expected::Consumer;
use super::peer::{Peer, interpreter, script};
use super::world::{World, hdl64e, on_domain};

/// DDS domain of the measurement.
const DDS_DOMAIN: u32 = 94;
const OURS: &str = "/sweepd/front/points";
const PLAIN: &str = "/plain/points";

/// `SWEEPD_SECONDS=600 cargo test --release --features slow-tests --test slow ros2::measure -- --ignored
/// --nocapture`
#[test]
#[ignore = "a measurement: prints figures"]
fn measure_latency_and_memory() {
    let _alone = alone();
    let seconds = std::env::var("SWEEPD_SECONDS").map_or(60, |text| text.parse().unwrap());
    let world = World::new(&[("front", "")]);
    let hdl64e = hdl64e();
    let _daemon = world.daemon();
    let consumer = Consumer::start(&world.domain(), "front");
    let _feed = world.feed("front", hdl64e, "1");
    let bridge = world.bridge(DDS_DOMAIN, &["front"]);
    let mut command = Command::new(interpreter("SWEEPD_JAZZY"));
    command.arg(script("publisher.py")).args([PLAIN, "3294200"]);
    on_domain(&mut command, DDS_DOMAIN);
    let plain = Process::start(&mut command).unwrap();
    let wanted = json!({"clouds": [OURS, PLAIN], "qualities": ["best_effort"]});
    let mut peer = Peer::ros("SWEEPD_JAZZY", DDS_DOMAIN, &wanted);
    for topic in [OURS, PLAIN] {
        peer.wait_for("a cloud came", |said| said.line["topic"] == topic);
    }
    // What is allocated once is allocated by then.
    listen(&mut peer, &consumer, Duration::from_secs(10));
    let before = [&bridge, &plain].map(Usage::of);
    let begun = Instant::now();
    let heard = listen(&mut peer, &consumer, Duration::from_secs(seconds));
    let took_s = begun.elapsed().as_secs_f64();
    let after = [&bridge, &plain].map(Usage::of);
    for (index, topic) in [OURS, PLAIN].into_iter().enumerate() {
        let mut ms = heard[topic].clone();
        ms.sort_by(f64::total_cmp);
        println!(
            "{topic}: {} clouds in {took_s:.1} s, {:.2} ms median, {:.2} ms p99; {:.1} % of a core; {} kB, later {} kB",
            ms.len(),
            ms[ms.len() / 2],
            ms[ms.len() * 99 / 100],
            100.0 * (after[index].cpu_s - before[index].cpu_s) / took_s,
            before[index].rss_kb,
            after[index].rss_kb
        );
    }
}

/// Milliseconds to the callback, by topic: from the completion of the sweep in shared memory, or
/// from before the message was sent.
fn listen(peer: &mut Peer, consumer: &Consumer, span: Duration) -> BTreeMap<String, Vec<f64>> {
    let begun = Instant::now();
    let mut heard = BTreeMap::<String, Vec<f64>>::new();
    peer.forget();
    while begun.elapsed() < span {
        let Some(said) = peer.next(Duration::from_millis(100)) else {
            continue;
        };
        let line = said.line;
        let (Some(topic), Some(stamp_ns)) = (line["topic"].as_str(), line["stamp_ns"].as_i64())
        else {
            continue;
        };
        let ready_ns = match topic {
            OURS => match consumer.find(stamp_ns) {
                Some(sweep) => sweep.view().header.completed_ns,
                None => continue,
            },
            _ => stamp_ns,
        };
        let latency_ns = line["received_ns"].as_i64().unwrap() - ready_ns;
        heard
            .entry(topic.to_owned())
            .or_default()
            .push(latency_ns as f64 * 1e-6);
    }
    heard
}

/// What a process used so far.
struct Usage {
    cpu_s: f64,
    rss_kb: u64,
}

impl Usage {
    fn of(process: &Process) -> Self {
        let read = |name: &str| {
            std::fs::read_to_string(format!("/proc/{}/{name}", process.child.id())).unwrap()
        };
        let stat = read("stat");
        let (_, after_name) = stat.rsplit_once(") ").unwrap();
        let fields: Vec<&str> = after_name.split(' ').collect();
        // utime and stime, in hundredths of a second.
        let ticks = |index: usize| fields[index].parse::<u64>().unwrap();
        let status = read("status");
        let rss = status
            .lines()
            .find(|line| line.starts_with("VmRSS:"))
            .unwrap();
        Self {
            cpu_s: (ticks(11) + ticks(12)) as f64 / 100.0,
            rss_kb: rss.split_whitespace().nth(1).unwrap().parse().unwrap(),
        }
    }
}
