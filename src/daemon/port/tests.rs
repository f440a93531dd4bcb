//! Tests a port without its socket, with simulated clocks: the one that stamps packets is set, the
//! other never.

use std::sync::mpsc::{self, Sender};

use super::super::config::SensorConfig;
use super::super::counters::Gps;
use super::super::plan;
use super::super::sensor::Identity;
use super::super::sharing::SharingError;
use super::super::testing::{config_of, sensor};
use super::*;
use sweepd_core::buffers::HeapBuffer;
use sweepd_core::buffers::HeapBuffers;
use sweepd_core::sensor::Model;
use sweepd_core::sweep::SweepRef;
use sweepd_core::sweep::layout::flags::PARTIAL;
use sweepd_core::wire::data::ReturnMode;
use sweepd_core::wire::position::Pps;
use sweepd_core::wire::{Content, Packet, Position};
use sweepd_lab::simulate::{Emitter, EmitterConfig, SimulatedDatagram, fixtures};

const SECOND_NS: i64 = 1_000_000_000;
const HOUR_NS: i64 = 3_600 * SECOND_NS;
/// How long the sensors send, and when the clock is set.
const TURNS: f64 = 9.0;
const SET_NS: i64 = 430_000_000;

/// The fields of a sweep that no clock of the host may change.
#[derive(Clone, Debug, PartialEq)]
struct Sweep {
    sensor: usize,
    sensor_time_ns: i64,
    returns: u32,
    missing_columns: u32,
    is_partial: bool,
}

/// Buffers whose sweeps come here.
struct Shared {
    heap: HeapBuffers,
    sensor: usize,
    sweeps: Sender<Sweep>,
}

struct Open {
    bytes: HeapBuffer,
    sensor: usize,
    sweeps: Sender<Sweep>,
}

impl Buffers for Shared {
    type Buffer = Open;

    fn take(&mut self, bytes: usize) -> Open {
        Open {
            bytes: self.heap.take(bytes),
            sensor: self.sensor,
            sweeps: self.sweeps.clone(),
        }
    }
}

impl AsRef<[u8]> for Open {
    fn as_ref(&self) -> &[u8] {
        self.bytes.as_ref()
    }
}

impl AsMut<[u8]> for Open {
    fn as_mut(&mut self) -> &mut [u8] {
        self.bytes.as_mut()
    }
}

impl Outgoing for Open {
    fn publish(self) -> Result<Option<Self>, SharingError> {
        let header = SweepRef::open(self.bytes.as_ref())?.header;
        let sweep = Sweep {
            sensor: self.sensor,
            sensor_time_ns: header.sensor_time_ns,
            returns: header.returns,
            missing_columns: header.missing_columns,
            is_partial: header.has(PARTIAL),
        };
        self.sweeps.send(sweep)?;
        Ok(None)
    }
}

/// A sensor of this configuration, with its counters and its queue of position packets.
fn served(
    index: usize,
    config: &SensorConfig,
    counters: Arc<SensorCounters>,
    positions: Receiver<Packet<'static>>,
    sweeps: &Sender<Sweep>,
) -> PortSensor<Shared> {
    let buffers = Shared {
        heap: HeapBuffers::default(),
        sensor: index,
        sweeps: sweeps.clone(),
    };
    let (name, address) = (config.name.clone(), config.address.to_string());
    let identity = Identity {
        index,
        name,
        address,
        counters,
        events: mpsc::channel().0,
    };
    let sensor = Sensor::new(identity, config.pipeline.clone(), buffers).unwrap();
    PortSensor {
        sensor,
        positions,
        reconfigurations: mpsc::channel().1,
        newest: Newest::default(),
    }
}

/// A port with two sensors, at 127.0.0.1 and 127.0.0.2.
fn state(sweeps: &Sender<Sweep>) -> PortState<Shared> {
    let configs = [1, 2].map(|host| sensor(&format!("s{host}"), &format!("127.0.0.{host}"), 2368));
    let sensors = (0..2).map(|index| {
        served(
            index,
            &configs[index],
            Arc::default(),
            mpsc::channel().1,
            sweeps,
        )
    });
    let sensors = sensors.collect();
    let config = config_of(configs.to_vec());
    let admission = plan::ports(&config)[0].admission(&config);
    PortState {
        admission,
        sensors,
        others: Vec::new(),
        recordings: Vec::new(),
        counters: Arc::default(),
    }
}

/// The packets of both sensors, in the order of arrival.
fn sent() -> Vec<(usize, SimulatedDatagram)> {
    let scene = fixtures::scene();
    let of = |index: usize| {
        let mut config = EmitterConfig::new(Model::Vlp16, ReturnMode::Strongest).turns(TURNS);
        config.encoder.start_deg = 170.0 * index as f64;
        Emitter::new(config, &scene)
            .untold()
            .map(move |one| (index, one))
            .collect::<Vec<_>>()
    };
    let mut sent = [of(0), of(1)].concat();
    sent.sort_by_key(|(index, one)| (one.arrival_ns, *index));
    sent
}

/// The sweeps of both, each with the time until it came out. The clock that stamps packets has this
/// error after this time. Each packet is a batch; a second of silence follows.
fn run(sent: &[(usize, SimulatedDatagram)], off_ns: impl Fn(i64) -> i64) -> Vec<(i64, Sweep)> {
    let (told, sweeps) = mpsc::channel();
    let mut state = state(&told);
    let (first_ns, begun) = (sent[0].1.arrival_ns, Instant::now());
    let mut came = Vec::new();
    let mut catch_up = |state: &mut PortState<Shared>, after_ns: i64| {
        state.catch_up(begun + Duration::from_nanos(after_ns as u64), 0);
        came.extend(sweeps.try_iter().map(|sweep| (after_ns, sweep)));
    };
    let mut after_ns = 0;
    for (index, one) in sent {
        after_ns = one.arrival_ns - first_ns;
        let source = format!("127.0.0.{}:2368", index + 1).parse().unwrap();
        let destination = "127.0.0.1:2368".parse().unwrap();
        let arrival_ns = one.arrival_ns + off_ns(after_ns);
        state.take(
            &Addressed {
                arrival_ns,
                source,
                destination,
                payload: &one.payload,
            },
            0,
        );
        catch_up(&mut state, after_ns);
    }
    (1..=200).for_each(|tick| catch_up(&mut state, after_ns + tick * 5_000_000));
    came
}

/// The real process cannot be tested like this, because the machine's clock stamps its packets.
#[test]
fn a_clock_that_is_set_closes_no_sweep_and_holds_none() {
    let sent = sent();
    let expected = run(&sent, |_| 0);
    // The first and the last of each are partial.
    assert_eq!(
        expected
            .iter()
            .filter(|(_, sweep)| sweep.is_partial)
            .count(),
        4
    );
    assert!(expected.len() > 16, "{}", expected.len());
    for by_ns in [
        HOUR_NS,
        -HOUR_NS,
        2 * SECOND_NS,
        -2 * SECOND_NS,
        SECOND_NS / 5,
        -SECOND_NS / 5,
    ] {
        let once = run(&sent, |after_ns| if after_ns < SET_NS { 0 } else { by_ns });
        assert!(
            once == expected,
            "set once by {by_ns} ns: {} sweeps, expected {}",
            once.len(),
            expected.len()
        );
        let to_and_fro = run(&sent, |after_ns| by_ns * (after_ns / 7_000_000 % 2));
        assert!(
            to_and_fro == expected,
            "set to and fro by {by_ns} ns: {} sweeps",
            to_and_fro.len()
        );
    }
}

/// A sensor falls silent when the clock is set, or soon after it.
#[test]
fn silence_is_reported_when_the_clock_is_set_during_it() {
    let all = sent();
    let first_ns = all[0].1.arrival_ns;
    for more_ns in [0, 10_000_000] {
        let silent_ns = SET_NS + more_ns;
        let is_sent = |(index, one): &&(usize, SimulatedDatagram)| {
            *index == 0 || one.arrival_ns - first_ns < silent_ns
        };
        let sent: Vec<_> = all.iter().filter(is_sent).cloned().collect();
        for by_ns in [0, HOUR_NS, -HOUR_NS, -2 * SECOND_NS] {
            let came = run(&sent, |after_ns| if after_ns < SET_NS { 0 } else { by_ns });
            let (at_ns, last) = came.iter().rfind(|(_, sweep)| sweep.sensor == 1).unwrap();
            let waited_ms = (at_ns - silent_ns) / 1_000_000;
            assert!(last.is_partial, "set by {by_ns} ns");
            assert!(
                (495..515).contains(&waited_ms),
                "set by {by_ns} ns: closed after {waited_ms} ms"
            );
            assert_eq!(
                came.iter()
                    .filter(|(_, sweep)| sweep.sensor == 1 && sweep.is_partial)
                    .count(),
                2
            );
        }
    }
}

#[test]
fn the_time_of_a_silent_sensor_goes_on_from_its_own_newest_packet() {
    let begun = Instant::now();
    let after = |ms| begun + Duration::from_millis(ms);
    let mut newest = Newest::default();
    assert_eq!(newest.stamp_of(begun), None);
    newest.stamp(4_000_000_000);
    newest.stamp(5_000_000_000);
    assert_eq!(newest.stamp_of(begun), Some(5_000_000_000));
    // Half a second passed, whatever CLOCK_REALTIME is now.
    assert_eq!(newest.stamp_of(after(500)), Some(5_500_000_000));
    // The first packet after the clock was set back by an hour shows its present value.
    newest.stamp(5_600_000_000 - HOUR_NS);
    assert_eq!(newest.stamp_of(after(600)), Some(5_600_000_000 - HOUR_NS));
    assert_eq!(newest.stamp_of(after(601)), Some(5_601_000_000 - HOUR_NS));
}

#[test]
fn of_position_packets_that_waited_all_are_counted_and_the_newest_counts() {
    let (sender, positions) = mpsc::sync_channel(POSITION_QUEUE_LEN);
    let counters = Arc::new(SensorCounters::default());
    let config = sensor("s", "127.0.0.1", 2368);
    let mut served = served(0, &config, counters.clone(), positions, &mpsc::channel().0);
    let put = |pps| {
        let position = Position {
            stamp_us: 0,
            pps,
            nmea: None,
            inertial: None,
            board: None,
            thermal: None,
        };
        let content = Content::Position(position, None);
        let packet = Packet {
            arrival_ns: 0,
            content,
        };
        sender.try_send(packet).unwrap();
    };
    let batches = [
        (&[Pps::Locked][..], Gps::Incomplete),
        (&[Pps::Locked, Pps::Locked, Pps::Absent], Gps::Absent),
    ];
    for (waited, expected) in batches {
        waited.iter().for_each(|&pps| put(pps));
        served.catch_up(Instant::now(), 0);
        assert_eq!(counters.gps(), Some(expected), "{waited:?}");
    }
    served.catch_up(Instant::now(), 0);
    assert_eq!(counters.position.get(), 4);
}
