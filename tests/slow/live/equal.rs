//! What consumers get live, in Rust and in Python, is what a replay of the daemon's own recording
//! gives, byte for byte.

use std::collections::{BTreeMap, BTreeSet};
use std::ffi::OsStr;
use std::io::Read;
use std::path::Path;
use std::process::{Command, Stdio};
use std::sync::mpsc::{self, Receiver};
use std::time::{Duration, Instant};
use sweepd_testkit::stream::next_sweep;

use sweepd::buffers::{HeapBuffers, Memory};
use sweepd::client::Client;
use sweepd::input::Capture;
use sweepd::pipeline::{Config, Pipeline};
use sweepd::sweep::SweepRef;

use sweepd_testkit::{
    same::same,
    setup::{Process, SOON, Setup},
};

/// What must be the same, by sensor time: all of a sweep but what the layout names as the host's.
type Sweeps = BTreeMap<i64, Vec<u8>>;

fn keep(sweeps: &mut Sweeps, sweep: &SweepRef<'_>) {
    assert!(
        sweeps
            .insert(sweep.header.sensor_time_ns, same(sweep))
            .is_none(),
        "two sweeps of one time"
    );
}

fn replayed(capture: &Path) -> Sweeps {
    let mut capture = Capture::open(capture).unwrap();
    let mut pipeline = Pipeline::new("", Config::default()).unwrap();
    let mut memory = Memory::new(HeapBuffers::default());
    let mut sweeps = Sweeps::new();
    while let Some(datagram) = capture.next_datagram().unwrap() {
        pipeline.push(&datagram.parse().unwrap());
        std::iter::from_fn(|| next_sweep(&mut pipeline, &mut memory))
            .for_each(|it| keep(&mut sweeps, &SweepRef::open(it.as_ref()).unwrap()));
    }
    pipeline.end();
    std::iter::from_fn(|| next_sweep(&mut pipeline, &mut memory))
        .for_each(|it| keep(&mut sweeps, &SweepRef::open(it.as_ref()).unwrap()));
    sweeps
}

/// The Python package in a process of its own, and what it received.
struct Python {
    child: Process,
    received: Receiver<(i64, Vec<u8>)>,
    sweeps: Sweeps,
}

impl Python {
    /// Starts it and waits until it has found the daemon.
    fn start(python: &OsStr, setup: &Setup) -> Self {
        let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/slow/live/consumer.py");
        let mut command = Command::new(python);
        command
            .arg(script)
            .arg(setup.own.root())
            .envs(sweepd_testkit::python_package())
            .stdin(Stdio::null())
            .stdout(Stdio::piped());
        let mut child = command.spawn().unwrap();
        let mut output = child.stdout.take().unwrap();
        let (sender, received) = mpsc::channel();
        std::thread::spawn(move || {
            let mut next = move || -> Option<(i64, Vec<u8>)> {
                let [mut time, mut len] = [[0; 8]; 2];
                output
                    .read_exact(&mut time)
                    .and_then(|()| output.read_exact(&mut len))
                    .ok()?;
                let mut bytes = vec![0; usize::try_from(u64::from_le_bytes(len)).unwrap()];
                output.read_exact(&mut bytes).ok()?;
                Some((i64::from_le_bytes(time), bytes))
            };
            while next().is_some_and(|one| sender.send(one).is_ok()) {}
        });
        let (_, first) = received
            .recv_timeout(SOON)
            .expect("Python finds the daemon");
        assert!(first.is_empty());
        Self {
            child: Process(child),
            received,
            sweeps: Sweeps::new(),
        }
    }

    /// All that it received, once the last one is among it.
    fn up_to(mut self, last_time_ns: i64) -> Sweeps {
        while !self.sweeps.contains_key(&last_time_ns) {
            let (time_ns, bytes) = self
                .received
                .recv_timeout(SOON)
                .expect("Python has the last sweep");
            assert!(
                self.sweeps.insert(time_ns, bytes).is_none(),
                "two sweeps of one time"
            );
        }
        self.child.signal("-KILL");
        self.sweeps
    }
}

/// Runs the daemon beside what `send` starts, and compares. Gives how many sweeps were received.
fn compare(name: &str, python: Option<&OsStr>, send: impl FnOnce(&Setup) -> Process) -> usize {
    let setup = Setup::new("", "[record]\npath = \"recorded.pcap\"");
    let mut daemon = setup.daemon();
    let mut client = setup.client();
    let python = python.map(|python| Python::start(python, &setup));
    let mut sensor = send(&setup);
    let (mut live, mut lost, mut dropped, mut sequences) = (Sweeps::new(), 0, 0, Vec::new());
    let mut last = Instant::now();
    loop {
        match client.next(Duration::from_millis(100)).unwrap().received() {
            Some(sweep) => {
                let sweep = sweep.view().unwrap();
                (lost, dropped) = (
                    lost + sweep.header.lost_packets,
                    dropped + sweep.header.dropped_datagrams,
                );
                sequences.push(sweep.header.sequence);
                keep(&mut live, &sweep);
                last = Instant::now();
            }
            // A sweep that stalled comes half a second later.
            None if last.elapsed() > Duration::from_millis(1500)
                && sensor.0.try_wait().unwrap().is_some() =>
            {
                break;
            }
            None => assert!(last.elapsed() < SOON, "{name}: nothing comes"),
        }
    }
    assert!(sensor.wait(), "{name}: the sensor failed");
    let in_python = python.map(|python| python.up_to(*live.last_key_value().expect("a sweep").0));
    daemon.signal("-TERM");
    assert!(daemon.wait(), "{name}: the daemon ended badly");
    assert!(dropped == 0, "{name}: {dropped} dropped, {lost} lost");
    assert!(
        sequences.is_sorted_by(|before, after| before < after),
        "{name}: {sequences:?}"
    );
    let replayed = replayed(&setup.path("recorded-000.pcap"));
    for (language, received) in [("Rust", Some(&live)), ("Python", in_python.as_ref())] {
        let Some(received) = received else { continue };
        let other = received
            .iter()
            .filter(|(time, bytes)| replayed.get(time) != Some(bytes))
            .count();
        assert_eq!(
            other,
            0,
            "{name}: of {} in {language}, {} replayed",
            received.len(),
            replayed.len()
        );
        // The first may have come before the consumer did, and a busy machine may let it miss
        // others: two wait for it, no more.
        assert!(
            received.len() * 2 + 8 >= replayed.len(),
            "{name}: {} in {language}",
            received.len()
        );
    }
    live.len()
}

#[test]
#[cfg_attr(without_python, ignore = "no SWEEPD_PYTHON")]
fn simulated_sensors_live_and_replayed() {
    let python = sweepd_testkit::python_with_numpy();
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
        let received = compare(&name, Some(&python), |setup| {
            setup.sensor(model, rpm, seconds)
        });
        assert!(received * 2 >= sweeps, "{name}: {received}");
    }
}

/// Losses, copies and packets out of order, on the wire as in the file.
#[test]
fn a_faulty_sensor_live_and_replayed() {
    for (model, faults) in [("vlp16", "--returns=dual"), ("hdl32e", "--seed=2")] {
        let received = compare(model, None, |setup| {
            let to = format!("127.0.0.1:{}", setup.port);
            let fixed = [
                "simulate",
                "--model",
                model,
                "--seconds",
                "1.2",
                "--to",
                &to,
                "--loss=1",
                "--duplicate=1",
            ];
            let args = [
                &fixed[..],
                &["--reorder=2x3", "--burst-loss=0.1x20", faults],
            ]
            .concat();
            Process::start(&args, &setup.path("sensor.log"))
        });
        assert!(received > 4, "{model}: {received}");
    }
}

/// Through shared memory at the speed of the sensor, three times as fast, and as fast as can be:
/// what a consumer gets is the same, though it may miss some.
#[test]
fn captures_replayed_at_any_speed() {
    for (capture, sweeps) in [
        ("street_vlp16_losses.pcap", 5),
        ("street_hdl32e_dual.pcap.gz", 3),
    ] {
        let path = Path::new(env!("CARGO_MANIFEST_DIR"))
            .join("pcap_fixtures")
            .join(capture);
        let expected = replayed(&path);
        for speed in ["realtime", "3", "max"] {
            let setup = Setup::new("", "");
            let mut client = Client::within(&setup.domain(), "roof").unwrap();
            let args = [
                "replay",
                path.to_str().unwrap(),
                "--partial",
                "--publish=roof",
                "--speed",
                speed,
                "--loop=4000",
                "--root",
            ];
            let root = setup.own.root().to_str().unwrap().to_owned();
            let mut player =
                Process::start(&[&args[..], &[&root]].concat(), &setup.path("player.log"));
            let (mut met, begun) = (BTreeSet::new(), Instant::now());
            while met.len() < sweeps {
                assert!(
                    begun.elapsed() < SOON,
                    "{capture} at {speed}: {} sweeps",
                    met.len()
                );
                let Some(sweep) = client.next(Duration::from_millis(100)).unwrap().received()
                else {
                    continue;
                };
                let sweep = sweep.view().unwrap();
                let time_ns = sweep.header.sensor_time_ns;
                assert!(
                    expected.get(&time_ns) == Some(&same(&sweep)),
                    "{capture} at {speed}: the sweep at {time_ns}"
                );
                met.insert(time_ns);
            }
            let _ = player.0.kill();
            let _ = player.0.wait();
        }
    }
}

#[test]
#[cfg_attr(
    any(without_captures, without_python),
    ignore = "no captures or no SWEEPD_PYTHON"
)]
fn real_captures_live_and_replayed() {
    let data = sweepd_testkit::data_dir();
    let python = sweepd_testkit::python_with_numpy();
    for capture in [
        "hdl32e_mrpt-sample.pcap",
        "hdl32e_veloview-monterey-a.pcap",
        "vlp16_einride-a.pcap",
        "vlp16_mrpt-gps.pcap",
        "vlp16_timm-dual-a.pcap",
        "vlp16_veloview-90deg-a.pcap",
    ] {
        let path = data.join("pcap").join(capture);
        let received = compare(capture, Some(&python), |setup| {
            let to = format!("127.0.0.1:{}", setup.port);
            Process::start(
                &["replay", path.to_str().unwrap(), "--to", &to],
                &setup.path("sensor.log"),
            )
        });
        assert!(received > 3, "{capture}: {received}");
    }
}
