//! After the first turns the way from socket to datagram, from there to labelled sweep, and on to
//! the consumers, allocates nothing (but for what iceoryx2 counts a loan by).

mod cloud;

use sweepd_testkit::{
    counting::{self, ALLOCATIONS, Counting},
    stream::{self, next_sweep},
};

use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use stream::Spin;
use sweepd::admission::DiscoveredSensors;
use sweepd::buffers::{Buffers, HeapBuffers, Memory};
use sweepd::client::Client;
use sweepd::input::{UdpConfig, UdpSource};
use sweepd::pipeline::{Config, Pipeline};
use sweepd::publish::{Loans, ServiceSettings};
use sweepd::recording::{Recorder, RecorderConfig};
use sweepd::segment::Method;
use sweepd::sensor::{Model, ModelExt};
use sweepd::sweep::{LeastReturns, Shape, SweepMut, SweepRef, Zone};
use sweepd::wire::DataPacket;
use sweepd::wire::data::ReturnMode;
use sweepd_lab::simulate::{Emitter, EmitterConfig, street};
use sweepd_testkit::temp_domain;

#[global_allocator]
static COUNTING: Counting = Counting;

/// What is asked of each sweep: whether anything stands within 20 m.
const ZONE: [[f64; 3]; 2] = [[-20.0, -20.0, 0.05], [20.0, 20.0, 2.0]];

/// Allocations during each sweep: from the first of its datagrams to the moment it is labelled, looked
/// at and let go.
fn per_sweep(config: Config, datagrams: &[(Vec<u8>, i64)]) -> Vec<u64> {
    let mut pipeline = Pipeline::new("test", config).unwrap();
    let mut memory = Memory::new(HeapBuffers::default());
    let (mut counts, mut obstacles) = (Vec::with_capacity(100), 0);
    let mut before = ALLOCATIONS.load(Ordering::Relaxed);
    for (payload, arrival_ns) in datagrams {
        pipeline.push(&stream::datagram(payload, *arrival_ns).parse().unwrap());
        pipeline.idle(Some(*arrival_ns));
        while let Some(sweep) = next_sweep(&mut pipeline, &mut memory) {
            let view = SweepRef::open(sweep.as_ref()).unwrap();
            let zone = Zone::new(ZONE[0], ZONE[1]).unwrap();
            let found = view.obstacle(&zone, LeastReturns::default());
            obstacles += usize::from(found.is_some());
            drop(sweep);
            let now = ALLOCATIONS.load(Ordering::Relaxed);
            counts.push(now - before);
            before = now;
        }
    }
    assert!(
        obstacles > counts.len() / 2,
        "{obstacles} of {}",
        counts.len()
    );
    counts
}

/// Allocations while packets are received, are admitted, and go to a recording, after the first
/// batch. The packets wait in the socket: their sender is not counted. The thread that writes is.
fn receiving() -> u64 {
    let mut source = UdpSource::bind(&UdpConfig {
        address: [127, 0, 0, 1].into(),
        ..UdpConfig::port(0)
    })
    .unwrap();
    let temporary = tempfile::tempdir().unwrap();
    let folder = temporary.path();
    let recorder = Recorder::start(RecorderConfig::new(&folder.join("all.pcap"))).unwrap();
    let mut feed = recorder.feed();
    let (sender, mut admission) = (
        std::net::UdpSocket::bind("127.0.0.1:0").unwrap(),
        DiscoveredSensors::default(),
    );
    let packets = [
        DataPacket::new(0, 0x37, 0x22).emit().to_vec(),
        vec![0; 512],
        vec![9; 1206],
        vec![9; 100],
    ];
    let mut admitted = 0;
    let mut receive = |count: u64| {
        for number in 0..count as usize {
            sender
                .send_to(&packets[number % 4], source.local_addr())
                .unwrap();
        }
        let (before, end) = (
            ALLOCATIONS.load(Ordering::Relaxed),
            source.received() + count,
        );
        while source.received() < end {
            for one in source.receive_addressed(Duration::from_secs(5)).unwrap() {
                if admission.admit(&one.datagram()).is_ok() {
                    admitted += 1;
                    assert!(feed.put(&one));
                }
            }
        }
        while recorder.counts().written.load(Ordering::Relaxed) < admitted {
            std::thread::sleep(Duration::from_millis(1));
        }
        ALLOCATIONS.load(Ordering::Relaxed) - before
    };
    receive(4);
    let counts: u64 = (0..10).map(|_| receive(100)).sum();
    assert_eq!(admitted, 502);
    recorder.finish().1.unwrap();
    counts
}

/// Allocations by the publisher's thread for each of many sweeps, which one consumer reads and
/// another does not. In 2.5 seconds the keeper looks after the service two or three times.
fn sharing() -> Vec<u64> {
    let own = temp_domain();
    let settings = ServiceSettings {
        name: "roof".to_owned(),
        max_consumers: 2,
        ..ServiceSettings::default()
    };
    let mut loans = Loans::create(&own.domain(), &settings).unwrap();
    let shape = Shape {
        rows: 16,
        columns_capacity: 1000,
        dual: false,
        segments_capacity: 10,
    };
    let [mut client, mut stuck] =
        ["roof"; 2].map(|name| Client::within(&own.domain(), name).unwrap());
    for one in [&mut client, &mut stuck] {
        assert!(one.next(Duration::ZERO).unwrap().received().is_none() && one.is_connected());
    }
    let mut publish = |sequence| {
        let before = counting::of_this_thread();
        let mut slot = loans.take(shape.total_bytes());
        SweepMut::create(slot.as_mut(), &shape)
            .unwrap()
            .header
            .sequence = sequence;
        assert_eq!(slot.publish().unwrap(), 2);
        let count = counting::of_this_thread() - before;
        assert_eq!(
            client
                .next(Duration::from_secs(5))
                .unwrap()
                .received()
                .unwrap()
                .view()
                .unwrap()
                .header
                .sequence,
            sequence
        );
        count
    };
    // The first one makes the pool and its ways to the consumers.
    publish(0);
    let begun = Instant::now();
    (1..)
        .take_while(|_| begun.elapsed() < Duration::from_millis(2500))
        .map(publish)
        .collect()
}

/// One test, since the count is of the whole process.
#[test]
fn the_steady_state_allocates_nothing() {
    cloud::projecting_allocates_nothing();
    assert_eq!(receiving(), 0);
    let shared = sharing();
    // iceoryx2 counts who holds a loan: an allocation a sweep that is not ours.
    let allocating = shared.iter().filter(|&&count| count > 1).count();
    assert!(
        shared.len() > 100 && allocating == 0,
        "{allocating} of {} sweeps allocated",
        shared.len()
    );
    let scene = street(1);
    for model in [Model::Vlp16, Model::Hdl32e, Model::Hdl64eS3, Model::Vls128] {
        for mode in [ReturnMode::Strongest, ReturnMode::Dual] {
            let config = EmitterConfig::new(model, mode).turns(1.1);
            let turn: Vec<_> = Emitter::new(config, &scene).collect();
            let mut street = Vec::new();
            // The same turn again and again, with stamps that go on: what it shows is as large each
            // time.
            let sent = Spin {
                jitter_cdeg: 2.0,
                start_cdeg: 0.0,
                ..Spin::new(model, mode, 600.0)
            }
            .packets(1.2);
            let per_turn = (1e8 / f64::from(model.spec().packet_period_ns(mode))) as usize;
            let shown: Vec<_> = turn.iter().filter(|one| one.truth.is_some()).collect();
            for one in sent.iter().filter(|one| one.ordinal % 50 != 40) {
                let mut bytes = one.packet.emit().to_vec();
                let like = &shown[one.ordinal % per_turn].payload;
                (0..12).for_each(|block| {
                    let records = block * 100 + 4..block * 100 + 100;
                    bytes[records.clone()].copy_from_slice(&like[records]);
                });
                street.push((bytes, one.arrival_ns));
                street.extend(
                    turn.iter()
                        .find(|one| one.truth.is_none())
                        .map(|position| (position.payload.clone(), one.arrival_ns + 10)),
                );
            }
            for method in [Method::Slope, Method::Paper] {
                let unit = model.is_hdl64e().then(stream::unit);
                let mut config = Config {
                    calibration: unit,
                    ..Config::default()
                };
                config.segment.method = method;
                // The second time all that it needs room for was there before.
                let again = street
                    .iter()
                    .map(|(bytes, arrival_ns)| (bytes.clone(), arrival_ns + 1_300_000_000));
                let counts = per_sweep(
                    config,
                    &street.iter().cloned().chain(again).collect::<Vec<_>>(),
                );
                assert!(counts.len() >= 20, "{counts:?}");
                let steady = &counts[counts.len() / 2 + 1..];
                assert!(
                    steady.iter().all(|&count| count == 0),
                    "{model} {mode} {method:?}: {counts:?}"
                );
            }
        }
    }
}
