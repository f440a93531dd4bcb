//! Packets in, sweeps out: who gets in, to whom a packet belongs, what is counted, and what a
//! broken thread does.

use std::collections::BTreeMap;
use std::net::{Ipv4Addr, UdpSocket};
use std::sync::Arc;
use std::sync::mpsc::Receiver;
use std::time::{Duration, Instant, SystemTime};
use sweepd::admission::Refusal;
use sweepd_testkit::{PATIENCE, Stopwatch, stream::next_sweep};

use sweepd::buffers::HeapBuffer;
use sweepd::buffers::{HeapBuffers, Memory};
use sweepd::daemon::counters::{Gps, Stage};
use sweepd::daemon::record::Recordings;
use sweepd::daemon::sensor::Event;
use sweepd::daemon::{DaemonError, Runtime};
use sweepd::pipeline::{self, Notice, Pipeline};
use sweepd::sensor::Model;
use sweepd::sweep::SweepRef;
use sweepd::sweep::layout::{TimeSource, flags};
use sweepd::wire::data::ReturnMode;
use sweepd::wire::{DataPacket, Datagram};

use crate::daemon::rig::{
    Fate, Rig, Sending, Sent, config, cool_stream_without_gps, free_port, sensor, stream, until,
};

const SINGLE: ReturnMode = ReturnMode::Strongest;

/// A sender as late as this may have had a sweep closed by the clock, after 500 ms of silence.
const LATE: Duration = Duration::from_millis(300);

/// Runs what says whether its sender was in time, until it was.
#[track_caller]
fn in_time(scenario: fn() -> bool) {
    let begun = Instant::now();
    while !scenario() {
        assert!(begun.elapsed() < PATIENCE, "the sender is late each time");
    }
}

type BySensor = BTreeMap<String, Vec<HeapBuffer>>;

/// The sweeps that came, by sensor.
fn by_sensor(sweeps: &Receiver<(Arc<str>, HeapBuffer)>) -> BySensor {
    let mut by_sensor = BySensor::new();
    for (name, sweep) in sweeps.try_iter() {
        by_sensor.entry(name.to_string()).or_default().push(sweep);
    }
    by_sensor
}

/// The sweeps that come until something is so of them: they are counted before they are sent.
#[track_caller]
fn until_sweeps(
    what: &str,
    sweeps: &Receiver<(Arc<str>, HeapBuffer)>,
    is_so: impl Fn(&BySensor) -> bool,
) -> BySensor {
    let mut all = BySensor::new();
    until(what, || {
        for (name, mut new) in by_sensor(sweeps) {
            all.entry(name).or_default().append(&mut new);
        }
        is_so(&all)
    });
    all
}

/// How many sweeps of a sensor came.
fn count(sweeps: &BySensor, name: &str) -> usize {
    sweeps.get(name).map_or(0, Vec::len)
}

/// The sweeps of a stream in a replay.
fn replayed(sent: &[Sent]) -> Vec<HeapBuffer> {
    let mut pipeline = Pipeline::new("replay", pipeline::Config::default()).unwrap();
    let mut memory = Memory::new(HeapBuffers::default());
    let mut sweeps = Vec::new();
    for sent in sent {
        let arrival_ns = 1_700_000_000_000_000_000 + sent.after.as_nanos() as i64;
        let source = "127.0.0.1:2368".parse().unwrap();
        let datagram = Datagram {
            arrival_ns,
            source,
            destination_port: 2368,
            payload: &sent.payload,
        };
        pipeline.push(&datagram.parse().unwrap());
        sweeps.extend(std::iter::from_fn(|| {
            next_sweep(&mut pipeline, &mut memory)
        }));
    }
    sweeps
}

/// What must be the same in a replay.
fn measured(sweep: &HeapBuffer) -> (i64, Vec<u32>, Vec<u32>, Vec<u8>, usize) {
    let sweep = SweepRef::open(sweep.as_ref()).unwrap();
    let ranges = sweep.range.iter().map(|range| range.to_bits()).collect();
    let (labels, reflectivities) = (sweep.label.to_vec(), sweep.reflectivity.to_vec());
    (
        sweep.header.sensor_time_ns,
        ranges,
        labels,
        reflectivities,
        sweep.segments.len(),
    )
}

#[test]
fn what_a_sensor_sends_comes_out_as_in_a_replay_with_the_times_of_this_host() {
    in_time(comes_out_as_in_a_replay);
}

fn comes_out_as_in_a_replay() -> bool {
    let (rig, sweeps) = Rig::new();
    let begun_ns = SystemTime::UNIX_EPOCH.elapsed().unwrap().as_nanos() as i64;
    let runtime = Runtime::start(
        &config(vec![sensor("roof", 11, (0, 0))]),
        &rig,
        &mut Recordings::default(),
    )
    .unwrap();
    assert_eq!(
        runtime.ports.len(),
        1,
        "the data port is the position port too"
    );
    let port = runtime.ports[0].local.port();
    let sent = stream(Model::Vlp16, SINGLE, 4.5);
    if Sending::start(11, (port, port), sent.clone()).finish() > LATE {
        return false;
    }
    let counters = &runtime.sensors[0].counters;
    let data = sent.iter().filter(|sent| sent.is_data).count() as u64;
    until("all packets are taken", || counters.data.get() == data);
    // What is open when the packets end is closed by the clock.
    let expected = replayed(&sent);
    let got = until_sweeps("the open sweep is closed", &sweeps, |all| {
        count(all, "roof") > expected.len()
    });
    let got = &got["roof"];
    for (live, replay) in got.iter().zip(&expected) {
        assert!(measured(live) == measured(replay));
    }
    assert_eq!(got.len(), expected.len() + 1);
    let mut runs = Vec::new();
    for sweep in got.iter().take(expected.len()) {
        let header = SweepRef::open(sweep.as_ref()).unwrap().header;
        assert_eq!((header.name(), header.sensor()), ("roof", "127.0.0.11"));
        assert_eq!((header.dropped_datagrams, header.lost_packets), (0, 0));
        let took_ns = header.completed_ns - header.arrival_ns;
        assert!((0..2_000_000_000).contains(&took_ns), "{took_ns}");
        assert!(header.completed_monotonic_ns > 0 && header.decode_ns > 0 && header.label_ns > 0);
        runs.push(header.run_ns);
    }
    assert!(
        runs.iter()
            .all(|&run_ns| run_ns == runs[0] && run_ns >= begun_ns)
    );
    assert_eq!(counters.partial_sweeps.get(), 2, "the first and the last");
    assert!(counters.steady_sweeps.get() >= 2);
    assert_eq!(
        (counters.model(), counters.return_mode()),
        (Some(Model::Vlp16), Some(SINGLE))
    );
    assert_eq!(
        (counters.gps(), counters.lost.get(), counters.unshared.get()),
        (Some(Gps::Locked), 0, 0)
    );
    assert!(counters.temperature_c().is_some());
    for stage in Stage::ALL {
        until(stage.name(), || {
            counters.stage(stage).count() == got.len() as u64
        });
    }
    assert_eq!(counters.sweeps.get(), got.len() as u64);
    runtime.stop().unwrap();
    true
}

#[test]
fn two_sensors_on_one_port_are_distinguished_by_their_address() {
    in_time(are_distinguished_by_their_address);
}

fn are_distinguished_by_their_address() -> bool {
    let (rig, sweeps) = Rig::new();
    let both = config(vec![
        sensor("left", 21, (0, 0)),
        sensor("right", 22, (0, 0)),
    ]);
    let runtime = Runtime::start(&both, &rig, &mut Recordings::default()).unwrap();
    let port = runtime.ports[0].local.port();
    let streams = [(Model::Vlp16, 21), (Model::Hdl32e, 22)]
        .map(|(model, host)| (host, stream(model, SINGLE, 3.2)));
    let sending = streams
        .clone()
        .map(|(host, stream)| Sending::start(host, (port, port), stream));
    if sending.map(Sending::finish).iter().any(|late| *late > LATE) {
        return false;
    }
    for (sensor, (_, stream)) in runtime.sensors.iter().zip(&streams) {
        let data = stream.iter().filter(|sent| sent.is_data).count() as u64;
        until("all packets are taken", || {
            sensor.counters.data.get() == data
        });
    }
    let all_expected = streams.each_ref().map(|(_, stream)| replayed(stream));
    let names = ["left", "right"];
    let got = until_sweeps("all sweeps came", &sweeps, |all| {
        let mut both = names.iter().zip(&all_expected);
        both.all(|(name, expected)| count(all, name) >= expected.len())
    });
    for (name, expected) in names.iter().zip(&all_expected) {
        assert!(expected.len() >= 3);
        assert!(
            got[*name]
                .iter()
                .zip(expected)
                .all(|(live, replay)| measured(live) == measured(replay)),
            "{name}"
        );
    }
    runtime.stop().unwrap();
    true
}

#[test]
fn a_steady_stream_of_packets_allocates_nothing_on_the_thread_of_its_port() {
    let (rig, sweeps) = Rig::new();
    let data = free_port();
    let two = config(vec![
        sensor("roof", 25, (data, data)),
        sensor("rear", 26, (free_port(), data)),
    ]);
    let runtime = Runtime::start(&two, &rig, &mut Recordings::default()).unwrap();
    // Buffers come back at once: a consumer's thread might have to wait for a core, and the heap, unlike
    // the shared memory of a service, makes one more then.
    drop(sweeps);
    let [foreign, rear] =
        [27, 26].map(|host| UdpSocket::bind((Ipv4Addr::new(127, 0, 0, host), 0)).unwrap());
    let sending = Sending::start(25, (data, data), stream(Model::Vlp16, SINGLE, 25.5));
    let counters = &runtime.sensors[0].counters;
    until("all sweeps are sent", || {
        // Somebody else sends too, and a sensor of another port its position packets.
        foreign
            .send_to(&[1; 100], (Ipv4Addr::LOCALHOST, data))
            .unwrap();
        rear.send_to(&[0; 512], (Ipv4Addr::LOCALHOST, data))
            .unwrap();
        counters.sweeps.get() >= 25
    });
    sending.finish();
    until("position packets went over", || {
        runtime.sensors[1].counters.position.get() >= 25
    });
    runtime.stop().unwrap();
    let allocated = rig.allocated.lock().unwrap().clone();
    // The height of the sensor is estimated over the first sweeps.
    let between: Vec<u64> = allocated
        .windows(2)
        .map(|pair| pair[1].0 - pair[0].1)
        .skip(10)
        .collect();
    assert!(
        between.len() >= 14 && between.iter().all(|&count| count == 0),
        "{between:?}"
    );
}

#[test]
fn an_hdl64e_streams_after_it_has_sent_its_calibration() {
    let (rig, sweeps) = Rig::new();
    let mut one = sensor("roof", 28, (0, 0));
    one.pipeline.model = Some(Model::Hdl64eS3);
    let runtime = Runtime::start(&config(vec![one]), &rig, &mut Recordings::default()).unwrap();
    let port = runtime.ports[0].local.port();
    let sending = Sending::start(28, (port, port), stream(Model::Hdl64eS3, SINGLE, 16.0));
    let told = runtime.events.recv_timeout(PATIENCE).unwrap();
    assert!(
        matches!(told, (0, Event::Notice(Notice::AwaitsCalibration))),
        "{told:?}"
    );
    let told = runtime.events.recv_timeout(PATIENCE).unwrap();
    assert!(
        matches!(told, (0, Event::Notice(Notice::Calibrated { .. }))),
        "{told:?}"
    );
    let (_, sweep) = sweeps.recv_timeout(PATIENCE).unwrap();
    assert_eq!(SweepRef::open(sweep.as_ref()).unwrap().header.rows, 64);
    sending.finish();
    let counters = &runtime.sensors[0].counters;
    assert_eq!(
        (counters.model(), counters.lost.get()),
        (Some(Model::Hdl64eS3), 0)
    );
    assert!(
        counters.temperature_c().is_some() && counters.gps().is_some(),
        "told among its data"
    );
    assert!(
        counters
            .undecoded()
            .any(|(reason, count)| reason == "not_ready" && count >= 4_000)
    );
    runtime.stop().unwrap();
}

#[test]
fn an_hdl64e_without_a_file_streams_on_over_a_reload() {
    let (rig, sweeps) = Rig::new();
    let one = config(vec![sensor("roof", 30, (0, 0))]);
    let runtime = Runtime::start(&one, &rig, &mut Recordings::default()).unwrap();
    let port = runtime.ports[0].local.port();
    let _sending = Sending::start(30, (port, port), stream(Model::Hdl64eS2, SINGLE, 60.0));
    let counters = &runtime.sensors[0].counters;
    until("it streams", || counters.steady_sweeps.get() >= 2);
    let not_ready = || {
        counters
            .undecoded()
            .find(|(reason, _)| *reason == "not_ready")
            .unwrap()
            .1
    };
    let (waited, partial) = (not_ready(), counters.partial_sweeps.get());
    let mut other = one.sensors[0].pipeline.clone();
    other.segment.theta_rad = 0.2;
    runtime.reconfigure(0, other);
    let sweeps_then = counters.sweeps.get();
    until("it streams again", || {
        counters.sweeps.get() >= sweeps_then + 4
    });
    assert_eq!(not_ready(), waited, "all packets are decoded");
    assert!(
        counters.partial_sweeps.get() - partial <= 1,
        "the first one of the new configuration"
    );
    let headers: Vec<_> = sweeps
        .try_iter()
        .map(|(_, sweep)| *SweepRef::open(sweep.as_ref()).unwrap().header)
        .collect();
    assert!(
        headers[0].run_ns < headers.last().unwrap().run_ns,
        "it was taken"
    );
    // By the sensor's clock: each sweep takes 0.1 s.
    let gaps_ns = headers
        .windows(2)
        .map(|pair| pair[1].sensor_time_ns - pair[0].sensor_time_ns);
    assert!(
        gaps_ns.clone().all(|ns| ns < 250_000_000),
        "{:?}",
        gaps_ns.collect::<Vec<_>>()
    );
    runtime.stop().unwrap();
}

#[test]
fn a_sensor_of_the_wrong_model_may_be_exchanged_for_the_right_one() {
    let (rig, sweeps) = Rig::new();
    let mut one = sensor("roof", 29, (0, 0));
    one.pipeline.model = Some(Model::Vlp16);
    // A core that there is not, and perhaps no right to be urgent, are no reason not to start.
    (one.port.cpu, one.port.realtime_priority) = (Some(1_000), Some(1));
    let runtime = Runtime::start(&config(vec![one]), &rig, &mut Recordings::default()).unwrap();
    let port = runtime.ports[0].local.port();
    Sending::start(29, (port, port), stream(Model::Hdl32e, SINGLE, 1.5)).finish();
    let told = runtime.events.recv_timeout(PATIENCE).unwrap();
    assert!(matches!(told, (0, Event::Fault(_))), "{told:?}");
    assert!(sweeps.try_recv().is_err());
    let _right = Sending::start(29, (port, port), stream(Model::Vlp16, SINGLE, 200.0));
    let (_, sweep) = sweeps.recv_timeout(PATIENCE).unwrap();
    assert_eq!(SweepRef::open(sweep.as_ref()).unwrap().header.rows, 16);
    runtime.stop().unwrap();
}

#[test]
fn three_sensors_on_three_ports_get_their_position_packets_from_a_fourth() {
    let (rig, sweeps) = Rig::new();
    let positions = free_port();
    let hosts = [31, 32, 33];
    let ports = hosts.map(|_| free_port());
    let sensors = hosts
        .iter()
        .zip(ports)
        .map(|(&host, port)| sensor(&format!("s{host}"), host, (port, positions)));
    let runtime =
        Runtime::start(&config(sensors.collect()), &rig, &mut Recordings::default()).unwrap();
    assert_eq!(runtime.ports.len(), 4);
    let sent = stream(Model::Vlp16, SINGLE, 3.2);
    let sending = [0, 1, 2]
        .map(|index| Sending::start(hosts[index], (ports[index], positions), sent.clone()));
    for sending in sending {
        sending.finish();
    }
    let count = |is_data| sent.iter().filter(|sent| sent.is_data == is_data).count() as u64;
    for sensor in runtime.sensors.iter() {
        until("all data are taken", || {
            sensor.counters.data.get() == count(true)
        });
        until("all positions are taken", || {
            sensor.counters.position.get() == count(false)
        });
        assert_eq!(sensor.counters.position_overflows.get(), 0);
        assert_eq!(sensor.counters.gps(), Some(Gps::Locked));
    }
    let last_is_by_gps = |sweeps: &Vec<HeapBuffer>| {
        let last = SweepRef::open(sweeps.last().unwrap().as_ref()).unwrap();
        last.header.time_source() == TimeSource::Gps
    };
    until_sweeps("the newest of each is by GPS", &sweeps, |all| {
        all.len() == 3 && all.values().all(last_is_by_gps)
    });
    runtime.stop().unwrap();
}

/// The sources of time of the whole sweeps of a sensor.
fn time_sources(sweeps: &[HeapBuffer]) -> Vec<TimeSource> {
    let headers = sweeps
        .iter()
        .map(|sweep| SweepRef::open(sweep.as_ref()).unwrap().header);
    headers
        .filter(|header| !header.has(flags::PARTIAL))
        .map(|header| header.time_source())
        .collect()
}

/// Behind one address, as of a router: only one of them has a GPS receiver, and the other is
/// cooler.
#[test]
fn two_sensors_at_one_address_keep_their_gps_and_their_temperature_apart() {
    let (rig, sweeps) = Rig::new();
    let ports = [(); 2].map(|()| (free_port(), free_port()));
    let both = config(vec![
        sensor("left", 34, ports[0]),
        sensor("right", 34, ports[1]),
    ]);
    let runtime = Runtime::start(&both, &rig, &mut Recordings::default()).unwrap();
    let streams = [
        stream(Model::Vlp16, SINGLE, 12.0),
        cool_stream_without_gps(12.0),
    ];
    let [left, right] =
        [0, 1].map(|index| Sending::start(34, ports[index], streams[index].clone()));
    left.finish();
    right.finish();
    let [left, right] = [0, 1].map(|index| &runtime.sensors[index].counters);
    for (counters, stream) in [left, right].into_iter().zip(&streams) {
        let positions = stream.iter().filter(|sent| !sent.is_data).count() as u64;
        until("all positions are taken", || {
            counters.position.get() == positions
        });
    }
    let got = until_sweeps("the sweeps are there", &sweeps, |all| {
        count(all, "left") >= 11 && count(all, "right") >= 11
    });
    assert_eq!(
        (left.gps(), left.temperature_c()),
        (Some(Gps::Locked), Some(43))
    );
    assert_eq!(
        (right.gps(), right.temperature_c()),
        (Some(Gps::Absent), Some(20))
    );
    let [left, right] = ["left", "right"].map(|name| time_sources(&got[name]));
    assert!(
        left.len() >= 10 && left.iter().all(|&source| source == TimeSource::Gps),
        "{left:?}"
    );
    assert!(
        right.len() >= 10 && right.iter().all(|&source| source == TimeSource::Host),
        "{right:?}"
    );
    runtime.stop().unwrap();
}

#[test]
fn foreign_datagrams_change_nothing_but_a_counter() {
    in_time(foreign_datagrams_are_counted);
}

fn foreign_datagrams_are_counted() -> bool {
    const RANDOM: u64 = 100_000;
    let (rig, sweeps) = Rig::new();
    let (data, position) = (free_port(), free_port());
    let two = config(vec![
        sensor("roof", 41, (data, position)),
        sensor("rear", 42, (free_port(), position)),
    ]);
    let runtime = Runtime::start(&two, &rig, &mut Recordings::default()).unwrap();
    let sent = stream(Model::Vlp16, SINGLE, 40.0);
    let sending = Sending::start(41, (data, position), sent.clone());
    let counters = &runtime.ports[0].counters;
    let rejected = || counters.all_refused();

    let [own, other, foreign] =
        [41, 42, 43].map(|host| UdpSocket::bind((Ipv4Addr::new(127, 0, 0, host), 0)).unwrap());
    let packet = DataPacket::new(0, 0x37, 0x22);
    let mut broken = packet;
    broken.blocks[3].flag.set(0);
    for (socket, payload) in [
        (&own, &packet.emit()[1..]),
        (&own, broken.emit()),
        (&foreign, packet.emit()),
        (&foreign, &[0; 512]),
        (&other, packet.emit()),
    ] {
        socket
            .send_to(payload, (Ipv4Addr::LOCALHOST, data))
            .unwrap();
    }
    until("five were refused", || rejected() == 5);
    let by_reason = Refusal::OF_CONFIGURED.map(|reason| counters.refused(reason));
    assert_eq!(by_reason, [1, 1, 0, 2, 1, 0]);

    let mut rng = fastrand::Rng::with_seed(7);
    let mut bytes = [0; 1400];
    let mut from_own = 2;
    for sent in 1..=RANDOM {
        rng.fill(&mut bytes);
        let len = if rng.u8(..) < 64 {
            1206
        } else {
            rng.usize(..bytes.len())
        };
        // 512 bytes of the sensor itself are a position packet, whatever they hold.
        let socket = if len == 512 || rng.bool() {
            &foreign
        } else {
            &own
        };
        from_own += u64::from(std::ptr::eq(socket, &own));
        socket
            .send_to(&bytes[..len], (Ipv4Addr::LOCALHOST, data))
            .unwrap();
        // No more at once than the smallest buffer holds.
        if sent % 50 == 0 {
            until("they were refused", || rejected() == 5 + sent);
        }
    }
    if sending.finish() > LATE {
        return false;
    }
    let roof = &runtime.sensors[0].counters;
    assert_eq!(
        (
            roof.refused.get(),
            runtime.sensors[1].counters.refused.get()
        ),
        (from_own, 0)
    );
    let data = sent.iter().filter(|sent| sent.is_data).count() as u64;
    until("all packets are taken", || roof.data.get() == data);
    assert_eq!((rejected(), counters.dropped.get()), (5 + RANDOM, 0));
    assert_eq!(
        (
            roof.lost.get(),
            roof.undecoded().map(|(_, count)| count).sum::<u64>()
        ),
        (0, 0)
    );
    let expected = replayed(&sent);
    let got = until_sweeps("all sweeps came", &sweeps, |all| {
        count(all, "roof") >= expected.len()
    });
    assert_eq!(got.keys().collect::<Vec<_>>(), ["roof"]);
    assert!(
        got["roof"]
            .iter()
            .zip(&expected)
            .all(|(live, replay)| measured(live) == measured(replay))
    );
    runtime.stop().unwrap();
    true
}

/// A thread that naps learns from the first burst of others how short its naps must be for the next
/// ones: those cost nothing but where other programs have the cores for longer than the buffer holds.
#[test]
fn bursts_of_others_cost_a_sensor_nothing_from_the_second_on() {
    let _alone = sweepd_testkit::alone();
    let (rig, sweeps) = Rig::new();
    let data = free_port();
    let runtime = Runtime::start(
        &config(vec![sensor("roof", 46, (data, data))]),
        &rig,
        &mut Recordings::default(),
    )
    .unwrap();
    let consumer = std::thread::spawn(move || sweeps.iter().for_each(drop));
    let _sending = Sending::start(46, (data, data), stream(Model::Vlp16, SINGLE, 200.0));
    let (port, roof) = (&runtime.ports[0], &runtime.sensors[0].counters);
    until("it streams", || roof.steady_sweeps.get() >= 2);
    let foreign = UdpSocket::bind((Ipv4Addr::new(127, 0, 0, 47), 0)).unwrap();
    // Twice what the buffer holds, within a nap.
    let (count, span) = (2 * port.buffer.packets() as u32, Duration::from_millis(30));
    let (mut bursts, mut lossless) = (0, 0);
    while lossless < 5 {
        let (before, begun) = (port.counters.dropped.get(), Instant::now());
        for number in 0..count {
            std::thread::sleep(
                (begun + span * number / count).saturating_duration_since(Instant::now()),
            );
            foreign
                .send_to(&[1; 1206], (Ipv4Addr::LOCALHOST, data))
                .unwrap();
        }
        // Not in step with the turns.
        std::thread::sleep(Duration::from_millis(237));
        lossless += u32::from(port.counters.dropped.get() == before);
        bursts += 1;
        assert!(bursts <= 10, "{lossless} of 10 bursts cost nothing");
    }
    runtime.stop().unwrap();
    drop(rig);
    consumer.join().unwrap();
}

/// Whether an event is what is told of a sensor that is well: its clock and its floor.
fn is_of_a_well_sensor(event: &Event) -> bool {
    matches!(event, Event::Time(..) | Event::Floor(..))
}

/// The next event that is not.
fn next_event(runtime: &Runtime) -> (usize, Event) {
    loop {
        let told = runtime.events.recv_timeout(PATIENCE).unwrap();
        if !is_of_a_well_sensor(&told.1) {
            return told;
        }
    }
}

/// Whether there was no other event since.
fn is_quiet(runtime: &Runtime) -> bool {
    let mut events = runtime.events.try_iter();
    events.all(|(_, event)| is_of_a_well_sensor(&event))
}

#[test]
fn another_configuration_is_taken_while_the_sensor_streams() {
    let (rig, sweeps) = Rig::new();
    let one = config(vec![sensor("roof", 51, (0, 0))]);
    let runtime = Runtime::start(&one, &rig, &mut Recordings::default()).unwrap();
    let port = runtime.ports[0].local.port();
    let _sending = Sending::start(51, (port, port), stream(Model::Vlp16, SINGLE, 100.0));
    let counters = &runtime.sensors[0].counters;
    until("it streams", || counters.steady_sweeps.get() >= 2);
    let before = (
        by_sensor(&sweeps).remove("roof").unwrap(),
        counters.data.get(),
    );
    let mut other = one.sensors[0].pipeline.clone();
    (other.cut_azimuth_rad, other.position_m) = (1.0, [0.0, 1.5, 2.0]);
    runtime.reconfigure(0, other);
    let told = next_event(&runtime);
    assert!(matches!(told, (0, Event::Reconfigured(Ok(())))), "{told:?}");
    let sweeps_then = counters.sweeps.get();
    until("it streams again", || {
        counters.sweeps.get() >= sweeps_then + 4
    });
    let header = |sweep: &HeapBuffer| *SweepRef::open(sweep.as_ref()).unwrap().header;
    let (old, new) = (
        header(before.0.last().unwrap()),
        header(by_sensor(&sweeps)["roof"].last().unwrap()),
    );
    assert_eq!((old.cut_azimuth_rad, new.cut_azimuth_rad), (0.0, 1.0));
    assert_eq!(new.position_m, [0.0, 1.5, 2.0]);
    assert!(
        new.run_ns > old.run_ns,
        "numbers begin anew, so must the run"
    );
    assert!(counters.data.get() > before.1, "counters go on");

    let mut impossible = one.sensors[0].pipeline.clone();
    impossible.segment.theta_rad = 0.0;
    runtime.reconfigure(0, impossible);
    let told = next_event(&runtime);
    assert!(matches!(told, (0, Event::Reconfigured(Err(_)))), "{told:?}");
    let sweeps_then = counters.sweeps.get();
    until("it streams as before", || {
        counters.sweeps.get() >= sweeps_then + 2
    });
    runtime.stop().unwrap();
}

#[test]
fn a_port_that_is_taken_and_a_sensor_that_cannot_be_shared_are_errors_at_start() {
    let (rig, _) = Rig::new();
    let taken = UdpSocket::bind("127.0.0.1:0").unwrap();
    let port = taken.local_addr().unwrap().port();
    let error = Runtime::start(
        &config(vec![sensor("roof", 61, (port, port))]),
        &rig,
        &mut Recordings::default(),
    )
    .err()
    .unwrap();
    assert!(
        error
            .to_string()
            .contains(&format!("port {port} is held by ")),
        "{error}"
    );
    let error = Runtime::start(
        &config(vec![sensor("unshareable", 61, (0, 0))]),
        &rig,
        &mut Recordings::default(),
    )
    .err()
    .unwrap();
    assert_eq!(error.to_string(), "unshareable: no room in /dev/shm");
}

/// While its memory is being taken, the newest sweep is held; those before it are counted, and no
/// trouble is told.
#[test]
fn a_sweep_that_is_complete_before_its_memory_is_there_is_sent_when_it_is() {
    let (rig, sweeps) = Rig::new();
    let runtime = Runtime::start(
        &config(vec![sensor("roof", 63, (0, 0))]),
        &rig,
        &mut Recordings::default(),
    )
    .unwrap();
    let port = runtime.ports[0].local.port();
    rig.fate(Fate::Waits);
    let _sending = Sending::start(63, (port, port), stream(Model::Vlp16, SINGLE, 100.0));
    let counters = &runtime.sensors[0].counters;
    until("two sweeps were replaced by newer ones", || {
        counters.unshared.get() >= 2
    });
    rig.fate(Fate::Sends);
    let (_, sweep) = sweeps.recv_timeout(PATIENCE).unwrap();
    let lost = counters.unshared.get();
    assert_eq!(
        SweepRef::open(sweep.as_ref()).unwrap().header.sequence,
        lost,
        "the first one has number 0"
    );
    until("the next are sent as they come", || {
        counters.sweeps.get() >= lost + 4
    });
    assert_eq!(counters.unshared.get(), lost);
    assert!(is_quiet(&runtime), "nothing was wrong");
    runtime.stop().unwrap();
}

#[test]
fn sweeps_that_cannot_be_shared_are_reported_once_and_the_sensor_continues() {
    let (rig, sweeps) = Rig::new();
    let runtime = Runtime::start(
        &config(vec![sensor("roof", 62, (0, 0))]),
        &rig,
        &mut Recordings::default(),
    )
    .unwrap();
    let port = runtime.ports[0].local.port();
    rig.fate(Fate::Fails);
    let _sending = Sending::start(62, (port, port), stream(Model::Vlp16, SINGLE, 100.0));
    let counters = &runtime.sensors[0].counters;
    until("three sweeps found no way", || counters.unshared.get() >= 3);
    rig.fate(Fate::Sends);
    assert_eq!(sweeps.recv_timeout(PATIENCE).unwrap().0.as_ref(), "roof");
    let told = [0, 1].map(|_| next_event(&runtime).1);
    assert!(
        matches!(&told[..], [Event::NotShared(_), Event::SharedAgain]),
        "{told:?}"
    );
    assert!(is_quiet(&runtime));
    runtime.stop().unwrap();
}

#[test]
fn a_thread_that_panics_is_found_and_one_that_hangs_is_left_to_its_end() {
    for fate in [Fate::Panics, Fate::Hangs] {
        let (rig, _sweeps) = Rig::new();
        let mut runtime = Runtime::start(
            &config(vec![sensor("roof", 63, (0, 0))]),
            &rig,
            &mut Recordings::default(),
        )
        .unwrap();
        assert!(runtime.check().is_ok());
        let port = runtime.ports[0].local.port();
        rig.fate(fate);
        let _sending = Sending::start(63, (port, port), stream(Model::Vlp16, SINGLE, 5.0));
        let counters = Arc::clone(&runtime.sensors[0].counters);
        until("a sweep is complete", || counters.sweeps.get() > 0);
        if fate == Fate::Panics {
            let mut error = None;
            until("the panic is found", || {
                error = runtime.check().err();
                error.is_some()
            });
            assert!(
                error
                    .unwrap()
                    .to_string()
                    .ends_with("has ended: the consumer's file is gone")
            );
            continue;
        }
        assert!(runtime.check().is_ok());
        let told = Stopwatch::start();
        assert!(matches!(runtime.stop(), Err(DaemonError::Hangs { .. })));
        let took = told.elapsed();
        assert!(took < Duration::from_secs(3), "{took:?}");
    }
}
