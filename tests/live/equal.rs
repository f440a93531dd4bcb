//! What consumers get live is what a replay of the daemon's own recording gives, byte for byte.

use std::collections::BTreeMap;
use std::path::Path;
use std::time::{Duration, Instant};

use sweepd::capture::Capture;
use sweepd::pipeline::{Config, Pipeline, Untimed};
use sweepd::sweep::layout::TimeSource;
use sweepd::sweep::{HeapBuffers, SweepRef};
use zerocopy::IntoBytes;

use crate::{Process, Setup};

/// What must be the same, by sensor time: all of a sweep but what the layout names as the host's.
type Sweeps = BTreeMap<i64, Vec<u8>>;

fn keep(sweeps: &mut Sweeps, sweep: &SweepRef<'_>) {
    let mut header = *sweep.header;
    (header.sequence, header.run_ns, header.arrival_ns) = (0, 0, 0);
    (header.completed_ns, header.completed_monotonic_ns, header.dropped_datagrams) = (0, 0, 0);
    (header.decode_ns, header.ground_ns, header.label_ns) = (0, 0, 0);
    (header.sensor, header.name) = ([0; 64], [0; 64]);
    if header.time_source() == TimeSource::Host {
        header.time_ns = 0;
    }
    let SweepRef { range, label, range2, label2, columns, beams, segments, .. } = *sweep;
    let tables = [header.as_bytes(), columns.as_bytes(), beams.as_bytes(), segments.as_bytes()].concat();
    let words = [range.as_bytes(), label.as_bytes(), range2.as_bytes(), label2.as_bytes()].concat();
    let bytes = [tables, words, [sweep.reflectivity, sweep.reflectivity2, sweep.kind].concat()].concat();
    assert!(sweeps.insert(header.sensor_time_ns, bytes).is_none(), "two sweeps of one time");
}

fn replayed(capture: &Path) -> Sweeps {
    let mut capture = Capture::open(capture).unwrap();
    let mut pipeline = Pipeline::new("", Config::default(), HeapBuffers::default(), Untimed).unwrap();
    let mut sweeps = Sweeps::new();
    while let Some(datagram) = capture.next_datagram().unwrap() {
        pipeline.push(&datagram).unwrap();
        std::iter::from_fn(|| pipeline.poll()).for_each(|it| keep(&mut sweeps, &SweepRef::open(it.as_ref()).unwrap()));
    }
    pipeline.end().unwrap();
    std::iter::from_fn(|| pipeline.poll()).for_each(|it| keep(&mut sweeps, &SweepRef::open(it.as_ref()).unwrap()));
    sweeps
}

/// Runs the daemon beside what `send` starts, and compares. Gives how many sweeps were received.
fn compare(name: &str, send: impl FnOnce(&Setup) -> Process) -> usize {
    let setup = Setup::new("", "[record]\npath = \"recorded.pcap\"");
    let mut daemon = setup.daemon();
    let mut client = setup.client();
    let mut sensor = send(&setup);
    let (mut live, mut lost, mut dropped, mut sequences) = (Sweeps::new(), 0, 0, Vec::new());
    let mut last = Instant::now();
    loop {
        match client.next(Duration::from_millis(100)).unwrap() {
            Some(sweep) => {
                let sweep = sweep.view().unwrap();
                (lost, dropped) = (lost + sweep.header.lost_packets, dropped + sweep.header.dropped_datagrams);
                sequences.push(sweep.header.sequence);
                keep(&mut live, &sweep);
                last = Instant::now();
            }
            // A sweep that stalled comes half a second later.
            None if last.elapsed() > Duration::from_millis(1500) && sensor.0.try_wait().unwrap().is_some() => break,
            None => assert!(last.elapsed() < Duration::from_secs(60), "{name}: nothing comes"),
        }
    }
    assert!(sensor.wait(), "{name}: the sensor failed");
    daemon.signal("-TERM");
    assert!(daemon.wait(), "{name}: the daemon ended badly");
    assert!(dropped == 0, "{name}: {dropped} dropped, {lost} lost");
    assert!(sequences.windows(2).all(|pair| pair[1] == pair[0] + 1), "{name}: {sequences:?}");
    let replayed = replayed(&setup.path("recorded.pcap"));
    let missing = live.keys().filter(|time| !replayed.contains_key(time)).count();
    let other = live.iter().filter(|(time, bytes)| replayed.get(time).is_some_and(|it| it != *bytes)).count();
    assert_eq!((missing, other), (0, 0), "{name}: of {} live and {} replayed", live.len(), replayed.len());
    // The first may have come before the consumer did.
    assert!(live.len() + 2 >= replayed.len(), "{name}: {} live, {} replayed", live.len(), replayed.len());
    live.len()
}

#[test]
fn simulated_sensors_live_and_replayed() {
    for (model, rpm, seconds, sweeps) in [
        ("vlp16", 600, 1.5, 14),
        ("vlp16", 1200, 1.5, 28),
        ("hdl32e", 600, 1.5, 14),
        ("hdl32e", 1200, 1.5, 28),
        // The first 1.2 s tell the calibration.
        ("hdl64e-s2", 600, 2.7, 13),
        ("hdl64e-s2", 1200, 2.7, 26),
    ] {
        let name = format!("{model} at {rpm} rpm");
        let received = compare(&name, |setup| setup.sensor(model, rpm, seconds));
        assert!(received >= sweeps, "{name}: {received}");
    }
}

#[test]
fn real_captures_live_and_replayed() {
    let Some(data) = crate::common::data_dir() else { return };
    for capture in [
        "hdl32e_mrpt-sample.pcap",
        "hdl32e_veloview-monterey-a.pcap",
        "vlp16_einride-a.pcap",
        "vlp16_mrpt-gps.pcap",
        "vlp16_timm-dual-a.pcap",
        "vlp16_veloview-90deg-a.pcap",
    ] {
        let path = data.join("pcap").join(capture);
        let received = compare(capture, |setup| {
            let to = format!("127.0.0.1:{}", setup.port);
            Process::start(&["replay", path.to_str().unwrap(), "--to-udp", &to], &setup.path("sensor.log"))
        });
        assert!(received > 3, "{capture}: {received}");
    }
}
