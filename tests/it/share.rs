//! Sweeps through shared memory: without a copy, whatever the consumers do.

use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{self, RecvTimeoutError, Sender};
use std::time::{Duration, Instant};

use sweepd::buffers::HeapBuffer;
use sweepd::buffers::{Buffers, HeapBuffers, Memory};
use sweepd::client::{Client, ClientError, JoinError, Sweep};
use sweepd::pipeline::{Config, Event, Pipeline};
use sweepd::publish::{Domain, Loans, PublishError, ServiceSettings, Slot, Topic, pool_sweeps};
use sweepd::sensor::Model;
use sweepd::sweep::objects::{self, MESSAGE_BYTES, Object, Sending, flags};
use sweepd::sweep::{Shape, SweepMut, SweepRef};
use sweepd::wire::data::ReturnMode;
use sweepd_lab::simulate::{Emitter, EmitterConfig, fixtures};
use sweepd_testkit::{
    PATIENCE, TempDomain,
    stream::{Sent, Spin, config, datagram, next_sweep, unit},
    temp_domain,
};

/// Longest wait for what comes at once where this process has a core.
const SOON: Duration = PATIENCE;

fn settings(max_consumers: usize) -> ServiceSettings {
    let (model, address) = ("VLP-16".to_owned(), "192.168.1.201".to_owned());
    ServiceSettings {
        name: "roof".to_owned(),
        max_consumers,
        model,
        address,
        ..ServiceSettings::default()
    }
}

fn loans(own: &TempDomain, max_consumers: usize) -> Loans {
    Loans::create(&own.domain(), &settings(max_consumers)).unwrap()
}

/// Bytes of a sweep for whose pool /dev/shm has too little; the more consumers, the smaller.
fn too_many_bytes(loans: &mut Loans, max_consumers: usize) -> usize {
    let JoinError::Memory { free, .. } = joining(loans.reserve(1 << 40).unwrap_err()) else {
        panic!("a pool of terabytes")
    };
    // Other tests give some of theirs back meanwhile.
    2 * free as usize / pool_sweeps(max_consumers)
}

fn joining(error: PublishError) -> JoinError {
    let PublishError::Join(error) = error else {
        panic!("{error}")
    };
    error
}

fn client(own: &TempDomain) -> Client {
    let mut client = Client::within(&own.domain(), "roof").unwrap();
    // To be there from the first sweep on.
    assert!(client.next(Duration::ZERO).unwrap().received().is_none() && client.is_connected());
    client
}

/// Two turns and a half of a VLP-16.
fn sent() -> Vec<Sent> {
    Spin::new(Model::Vlp16, ReturnMode::Strongest, 600.0).packets(0.27)
}

/// Has the sweeps of some packets done by `done`.
fn play<B: Buffers>(buffers: B, config: Config, sent: &[Sent], mut done: impl FnMut(B::Buffer)) {
    let mut pipeline = Pipeline::new("192.168.1.201:2368", config).unwrap();
    let mut memory = Memory::new(buffers);
    for one in sent {
        pipeline.push(&datagram(one.packet.emit(), one.arrival_ns).parse().unwrap());
        std::iter::from_fn(|| next_sweep(&mut pipeline, &mut memory)).for_each(&mut done);
    }
    pipeline.end();
    std::iter::from_fn(|| next_sweep(&mut pipeline, &mut memory)).for_each(&mut done);
}

/// The file that is mapped where `bytes` are, and where in it they are.
fn mapped(bytes: &[u8]) -> (PathBuf, u64) {
    let at = bytes.as_ptr() as u64;
    let maps = std::fs::read_to_string("/proc/self/maps").unwrap();
    let line = |line: &str| {
        let fields: Vec<&str> = line.split_whitespace().collect();
        let (first, last) = fields[0].split_once('-').unwrap();
        let [first, last, offset] =
            [first, last, fields[2]].map(|hex| u64::from_str_radix(hex, 16).unwrap());
        let is_here = (first..last).contains(&at) && at + bytes.len() as u64 <= last;
        is_here.then(|| {
            (
                PathBuf::from(fields.get(5).copied().unwrap_or_default()),
                offset + at - first,
            )
        })
    };
    maps.lines().find_map(line).expect("mapped in one piece")
}

/// Gives out what another gives out, full of one byte, and remembers where it was.
struct Watched<B> {
    buffers: B,
    full_of: u8,
    given: Sender<(PathBuf, u64)>,
}

impl Buffers for Watched<Loans> {
    type Buffer = Slot;

    fn take(&mut self, bytes: usize) -> Slot {
        let mut slot = self.buffers.take(bytes);
        slot.as_mut().fill(self.full_of);
        self.given.send(mapped(slot.as_ref())).unwrap();
        slot
    }
}

#[test]
fn the_consumer_reads_the_bytes_that_the_decoder_wrote() {
    let own = temp_domain();
    let (sender, given) = mpsc::channel();
    let watched = Watched {
        buffers: loans(&own, 2),
        full_of: 0,
        given: sender,
    };
    let mut client = client(&own);
    let mut sweeps = 0;
    play(watched, config(), &sent(), |slot| {
        let (file, offset) = given.recv().unwrap();
        assert!(
            file.starts_with("/dev/shm") && own.shared_memory().contains(&file),
            "{}",
            file.display()
        );
        let written = SweepRef::open(slot.as_ref()).unwrap();
        let written_to = mapped(written.range_bytes());
        assert!(written_to.0 == file && written_to.1 >= offset);
        assert_eq!(slot.publish().unwrap(), 1);
        let sweep = client.next(SOON).unwrap().received().unwrap();
        assert_eq!(
            mapped(sweep.bytes()),
            (file, offset),
            "the same place of the same file"
        );
        assert_eq!(mapped(sweep.view().unwrap().range_bytes()), written_to);
        sweeps += 1;
    });
    assert!(sweeps >= 3);
}

trait RangeBytes {
    fn range_bytes(&self) -> &[u8];
}

impl RangeBytes for SweepRef<'_> {
    fn range_bytes(&self) -> &[u8] {
        zerocopy::IntoBytes::as_bytes(self.range)
    }
}

fn valid(sweep: &SweepRef<'_>) -> Vec<u8> {
    use zerocopy::IntoBytes;
    let SweepRef {
        header,
        range,
        label,
        range2,
        label2,
        columns,
        beams,
        segments,
        ..
    } = *sweep;
    let tables = [
        header.as_bytes(),
        columns.as_bytes(),
        beams.as_bytes(),
        segments.as_bytes(),
    ];
    let words = [
        range.as_bytes(),
        label.as_bytes(),
        range2.as_bytes(),
        label2.as_bytes(),
    ];
    [
        tables.concat(),
        words.concat(),
        [sweep.reflectivity, sweep.reflectivity2, sweep.kind].concat(),
    ]
    .concat()
}

#[test]
fn shared_sweeps_equal_those_of_the_heap_for_any_earlier_content_of_the_pool() {
    for (model, mode) in [
        (Model::Vlp16, ReturnMode::Strongest),
        (Model::Hdl64eS3, ReturnMode::Dual),
    ] {
        let sent = Spin {
            seed: 3,
            ..Spin::new(model, mode, 620.0)
        }
        .packets(0.25);
        let config = || Config {
            calibration: model.is_hdl64e().then(unit),
            ..config()
        };
        let mut expected = Vec::new();
        play(
            HeapBuffers::default(),
            config(),
            &sent,
            |buffer: HeapBuffer| {
                expected.push(valid(&SweepRef::open(buffer.as_ref()).unwrap()));
            },
        );
        for full_of in [0xA5, 0x3C] {
            let own = temp_domain();
            let (sender, _given) = mpsc::channel();
            let watched = Watched {
                buffers: loans(&own, 1),
                full_of,
                given: sender,
            };
            let mut client = client(&own);
            let mut sweeps = Vec::new();
            play(watched, config(), &sent, |slot| {
                slot.publish().unwrap();
                let sweep = client.next(SOON).unwrap().received().unwrap();
                sweeps.push(valid(&sweep.view().unwrap()));
            });
            assert!(
                sweeps.len() > 1 && sweeps == expected,
                "{model}: {} sweeps",
                sweeps.len()
            );
        }
    }
}

/// A sweep with this number, nothing else in it.
fn numbered(loans: &mut Loans, sequence: u64, columns_capacity: usize) -> Slot {
    let shape = Shape {
        rows: 16,
        columns_capacity,
        dual: false,
        segments_capacity: 10,
    };
    let mut slot = loans.take(shape.total_bytes());
    SweepMut::create(slot.as_mut(), &shape)
        .unwrap()
        .header
        .sequence = sequence;
    slot
}

fn publish(loans: &mut Loans, sequence: u64) -> usize {
    let slot = numbered(loans, sequence, 1000);
    let trouble = loans.status().trouble();
    slot.publish()
        .unwrap_or_else(|error| panic!("{error}: {trouble:?}"))
}

fn number(sweep: &Sweep) -> u64 {
    sweep.view().unwrap().header.sequence
}

#[test]
fn slow_stuck_and_greedy_consumers_delay_no_one() {
    let own = temp_domain();
    let mut loans = loans(&own, 4);
    let [mut good, mut slow, mut greedy, stuck] = [(); 4].map(|()| client(&own));
    let mut held = Vec::new();
    let mut took = Vec::new();
    for sequence in 0..500 {
        let begun = Instant::now();
        assert_eq!(publish(&mut loans, sequence), 4);
        took.push(begun.elapsed());
        assert_eq!(
            number(&good.next(SOON).unwrap().received().unwrap()),
            sequence
        );
        match greedy.next(Duration::ZERO) {
            Ok(sweep) => held.extend(sweep.received()),
            Err(ClientError::Subscribe(error)) => {
                assert!(error.to_string().contains("holds 2 sweeps"), "{error}")
            }
            Err(error) => panic!("{error}"),
        }
        if sequence % 50 == 49 {
            // The newest two, and not what is long gone.
            let got: Vec<u64> =
                std::iter::from_fn(|| slow.next(Duration::ZERO).unwrap().received())
                    .map(|sweep| number(&sweep))
                    .collect();
            assert_eq!(got, [sequence - 1, sequence]);
        }
    }
    // Of ten times 50 the newest two came; those before the first that came are not counted.
    assert_eq!([good.missed(), slow.missed()], [0, 9 * 48]);
    // What is held stays as it was.
    assert_eq!(held.iter().map(number).collect::<Vec<_>>(), [0, 1]);
    held.clear();
    assert_eq!(number(&greedy.next(SOON).unwrap().received().unwrap()), 498);
    // The longest of all tells how long this process had no core.
    took.sort_unstable();
    assert!(took[took.len() / 2] < Duration::from_millis(20), "{took:?}");
    assert_eq!(
        (loans.status().consumers(), loans.status().unshared()),
        (4, 0)
    );
    drop(stuck);
    // Places of consumers that died are given back within a second: it takes longer to tell that
    // all are taken.
    let error = [client(&own), Client::within(&own.domain(), "roof").unwrap()][1]
        .next(SOON)
        .unwrap_err();
    assert!(error.to_string().contains("max_consumers"), "{error}");
}

#[test]
fn a_late_consumer_gets_the_last_sweep() {
    let own = temp_domain();
    let mut loans = loans(&own, 4);
    for sequence in 0..3 {
        publish(&mut loans, sequence);
    }
    let mut late = client(&own);
    publish(&mut loans, 3);
    let got: Vec<u64> = std::iter::from_fn(|| late.next(Duration::ZERO).unwrap().received())
        .map(|sweep| number(&sweep))
        .collect();
    assert_eq!(got, [2, 3]);
}

#[test]
fn a_sensor_has_one_publisher_and_its_consumers_outlive_it() {
    let own = temp_domain();
    let mut first = loans(&own, 2);
    let mut consumer = client(&own);
    let taken = Loans::create(&own.domain(), &settings(2)).unwrap_err();
    assert!(matches!(taken, PublishError::Taken { .. }), "{taken}");
    publish(&mut first, 1);
    let kept = consumer.next(SOON).unwrap().received().unwrap();
    drop(first);
    assert!(
        consumer
            .next(Duration::from_millis(300))
            .unwrap()
            .received()
            .is_none()
            && !consumer.is_published()
    );
    let mut second = loans(&own, 2);
    publish(&mut second, 7);
    assert_eq!(number(&consumer.next(SOON).unwrap().received().unwrap()), 7);
    assert_eq!((number(&kept), consumer.reopened()), (1, 0));
    assert_eq!(consumer.model().as_deref(), Some("VLP-16"));
    assert_eq!(Client::sensors(&own.domain()).unwrap(), ["roof"]);
}

#[test]
fn a_consumer_waits_for_the_daemon() {
    let own = temp_domain();
    let mut early = Client::within(&own.domain(), "roof").unwrap();
    assert!(
        early
            .next(Duration::from_millis(120))
            .unwrap()
            .received()
            .is_none()
            && !early.is_connected()
    );
    let mut loans = loans(&own, 2);
    publish(&mut loans, 1);
    let (stop, stopped) = mpsc::channel::<()>();
    let publisher = std::thread::spawn(move || {
        let mut sequence = 1;
        while stopped.recv_timeout(Duration::from_millis(10)) == Err(RecvTimeoutError::Timeout) {
            sequence += 1;
            publish(&mut loans, sequence);
        }
    });
    assert!(early.next(SOON).unwrap().received().is_some());
    drop(stop);
    publisher.join().unwrap();
}

/// Everything under the root is deleted while both sides live: the daemon makes its service again,
/// and the consumer, who is told nothing, finds it.
/// The umask of a process, which all its threads have.
fn umask(process: u32) -> String {
    let status = std::fs::read_to_string(format!("/proc/{process}/status")).unwrap();
    let line = status.lines().find(|line| line.starts_with("Umask:"));
    line.unwrap().to_owned()
}

#[test]
fn consumers_that_come_at_once_leave_the_umask_as_it_was() {
    let own = temp_domain();
    let _loans = loans(&own, 8);
    std::thread::scope(|scope| {
        for _ in 0..4 {
            scope.spawn(|| {
                for _ in 0..50 {
                    let mut client = Client::within(&own.domain(), "roof").unwrap();
                    // It may have to wait for a file that another one is making.
                    let _ = client.next(Duration::from_millis(1));
                }
            });
        }
    });
    // It is another one while a consumer of another test comes.
    let asked = Instant::now();
    while umask(std::process::id()) != umask(std::os::unix::process::parent_id()) {
        assert!(asked.elapsed() < SOON, "{}", umask(std::process::id()));
        std::thread::sleep(Duration::from_millis(1));
    }
}

#[test]
fn files_that_vanish_are_made_again_and_found_again() {
    let own = temp_domain();
    let mut loans = loans(&own, 2);
    let mut consumer = client(&own);
    let status = loans.status();
    let (stop, stopped) = mpsc::channel::<()>();
    let begun_so_far = Arc::new(AtomicU64::new(0));
    let told = Arc::clone(&begun_so_far);
    let publisher = std::thread::spawn(move || {
        let mut sequence = 0;
        while stopped.recv_timeout(Duration::from_millis(20)) == Err(RecvTimeoutError::Timeout) {
            sequence += 1;
            told.store(sequence, Ordering::SeqCst);
            publish(&mut loans, sequence);
        }
    });
    for round in 1..=3 {
        assert!(consumer.next(SOON).unwrap().received().is_some());
        std::fs::remove_dir_all(own.root()).unwrap();
        let begun = Instant::now();
        while status.renewed() < round || consumer.reopened() < round {
            assert!(
                begun.elapsed() < SOON,
                "{} {}",
                status.renewed(),
                consumer.reopened()
            );
            consumer.next(Duration::from_millis(50)).unwrap();
        }
        // And then it is as before, for good.
        let mut last = number(&consumer.next(SOON).unwrap().received().unwrap());
        for _ in 0..100 {
            let sequence = number(&consumer.next(SOON).unwrap().received().unwrap());
            // A sweep is passed over where two newer ones came before it was taken, and never else.
            let is_explained =
                sequence == last + 1 || sequence < begun_so_far.load(Ordering::SeqCst);
            assert!(sequence > last && is_explained, "{last}, then {sequence}");
            last = sequence;
        }
        assert_eq!((status.renewed(), consumer.reopened()), (round, round));
        // Another finds it too.
        assert!(
            Client::within(&own.domain(), "roof")
                .unwrap()
                .next(SOON)
                .unwrap()
                .received()
                .is_some()
        );
    }
    drop(stop);
    publisher.join().unwrap();
}

#[test]
fn too_little_shared_memory_is_an_error_that_says_how_much() {
    let own = temp_domain();
    let mut loans = loans(&own, 100);
    let error = loans.reserve(1 << 40).unwrap_err();
    let JoinError::Memory { wanted, free } = joining(error) else {
        panic!()
    };
    assert!(wanted > free, "{wanted} {free}");
    // And where it shows only later, the sensor goes on by itself.
    let bytes = too_many_bytes(&mut loans, 100);
    let slot = loans.take(bytes);
    assert!(!slot.is_shared());
    assert!(loans.status().trouble().unwrap().contains("/dev/shm"));
    assert!(slot.publish().is_err() && loans.status().unshared() == 1);
}

#[test]
fn nothing_is_left_in_shared_memory() {
    let own = temp_domain();
    let mut loans = loans(&own, 2);
    let mut consumer = client(&own);
    loans.reserve(100_000).unwrap();
    publish(&mut loans, 1);
    let sweep = consumer.next(SOON).unwrap().received();
    assert!(sweep.is_some() && !own.shared_memory().is_empty());
    drop((loans, consumer, sweep));
    // Some hundred bytes of iceoryx2's own, by which it numbers the nodes of a domain, stay.
    let left = own.shared_memory();
    let bytes: u64 = left.iter().map(|file| file.metadata().unwrap().len()).sum();
    assert!(left.len() <= 1 && bytes < 4096, "{left:?}: {bytes} bytes");
}

#[test]
fn a_pool_grows_when_the_sensor_begins_to_send_two_returns() {
    let own = temp_domain();
    let mut loans = loans(&own, 1);
    let mut consumer = client(&own);
    publish(&mut loans, 1);
    let before = loans.status().reserved_bytes();
    assert_eq!(number(&consumer.next(SOON).unwrap().received().unwrap()), 1);
    // The one is still out when the larger one is taken, as at a cut.
    let first = numbered(&mut loans, 2, 1000);
    let second = numbered(&mut loans, 3, 5000);
    assert!(loans.status().reserved_bytes() > before && second.is_shared());
    for (slot, sequence) in [(first, 2), (second, 3)] {
        slot.publish().unwrap();
        assert_eq!(
            number(&consumer.next(SOON).unwrap().received().unwrap()),
            sequence
        );
    }
    publish(&mut loans, 4);
    assert_eq!(number(&consumer.next(SOON).unwrap().received().unwrap()), 4);
}

/// What a pool was made for is given back when another has taken its place, but not while a sweep
/// of it is out.
#[test]
fn a_pool_that_was_outgrown_is_given_back() {
    let own = temp_domain();
    let mut loans = loans(&own, 1);
    publish(&mut loans, 1);
    let pools = || {
        own.shared_memory()
            .iter()
            .filter(|file| file.to_string_lossy().ends_with(".data"))
            .count()
    };
    let out = numbered(&mut loans, 2, 1000);
    numbered(&mut loans, 3, 5000).publish().unwrap();
    let both = loans.status().reserved_bytes();
    // Longer than the keeper needs to look around.
    std::thread::sleep(Duration::from_millis(1500));
    assert_eq!((pools(), loans.status().reserved_bytes()), (2, both));
    out.publish().unwrap();
    let begun = Instant::now();
    while pools() > 1 || loans.status().reserved_bytes() == both {
        std::thread::sleep(Duration::from_millis(50));
        assert!(begun.elapsed() < SOON);
    }
    numbered(&mut loans, 4, 5000).publish().unwrap();
    assert_eq!(loans.status().unshared(), 0);
}

/// The thread of a sensor gets memory of its own while the pool is made, and its sweep reaches the
/// consumer all the same.
#[test]
fn a_sweep_that_was_begun_before_its_pool_is_there_is_shared_when_it_is_complete() {
    let own = temp_domain();
    let mut loans = loans(&own, 2).without_waiting();
    let mut consumer = client(&own);
    // Tens of megabytes, whose pages take a while.
    let slot = numbered(&mut loans, 7, 50_000);
    assert!(!slot.is_shared());
    let begun = Instant::now();
    while slot.is_early() {
        std::thread::sleep(Duration::from_millis(5));
        assert!(begun.elapsed() < SOON);
    }
    assert_eq!(slot.publish().unwrap(), 1);
    assert_eq!(number(&consumer.next(SOON).unwrap().received().unwrap()), 7);
    assert!(numbered(&mut loans, 8, 50_000).is_shared());
    assert_eq!(
        (loans.status().unshared(), loans.status().trouble()),
        (0, None)
    );
}

/// A pool that is too large is not asked for again with each sweep; what was shared before is
/// shared again at once.
#[test]
fn a_pool_that_cannot_be_made_is_reported_and_tried_again() {
    let own = temp_domain();
    let mut loans = loans(&own, 100);
    publish(&mut loans, 1);
    let status = loans.status();
    let bytes = too_many_bytes(&mut loans, 100);
    for unshared in 1..=5 {
        assert!(!loans.take(bytes).publish_is_ok());
        assert_eq!(status.unshared(), unshared);
        assert!(
            status.trouble().unwrap().contains("/dev/shm has"),
            "{:?}",
            status.trouble()
        );
    }
    assert_eq!(
        status.reserved_bytes(),
        0,
        "nothing is held for sweeps that do not fit"
    );
    let begun = Instant::now();
    while !numbered(&mut loans, 2, 1000).publish_is_ok() {
        std::thread::sleep(Duration::from_millis(20));
        assert!(begun.elapsed() < SOON);
    }
    assert_eq!(status.trouble(), None);
}

trait IsOk {
    fn publish_is_ok(self) -> bool;
}

impl IsOk for Slot {
    fn publish_is_ok(self) -> bool {
        self.publish().is_ok()
    }
}

#[test]
fn of_several_that_begin_at_once_one_publishes() {
    let own = temp_domain();
    let barrier = std::sync::Barrier::new(4);
    let begin = || {
        barrier.wait();
        let loans = Loans::create(&own.domain(), &settings(2));
        // Held until all have tried.
        barrier.wait();
        loans.map(drop)
    };
    for _ in 0..5 {
        let ended: Vec<_> = std::thread::scope(|scope| {
            let started: Vec<_> = (0..4).map(|_| scope.spawn(begin)).collect();
            started.into_iter().map(|one| one.join().unwrap()).collect()
        });
        let taken = ended
            .iter()
            .filter(|one| matches!(one, Err(PublishError::Taken { .. })))
            .count();
        assert_eq!(taken, 3, "{ended:?}");
    }
}

/// The daemon comes back with another `max_consumers` and another sensor, while a consumer of the
/// one before lives.
#[test]
fn a_service_that_no_longer_fits_is_made_again() {
    let own = temp_domain();
    let mut first = loans(&own, 1);
    let mut consumer = client(&own);
    publish(&mut first, 1);
    assert_eq!(number(&consumer.next(SOON).unwrap().received().unwrap()), 1);
    for (round, max_consumers, address) in [
        (1, 3, "192.168.1.201"),
        (2, 2, "192.168.1.201"),
        (3, 2, "192.168.1.202"),
    ] {
        drop(first);
        let changed = ServiceSettings {
            address: address.to_owned(),
            ..settings(max_consumers)
        };
        first = Loans::create(&own.domain(), &changed).unwrap();
        let begun = Instant::now();
        while consumer.reopened() < round {
            consumer.next(Duration::from_millis(50)).unwrap();
            assert!(begun.elapsed() < SOON);
        }
        // The consumer took a file along on its way, which is put back within a second.
        let mut others: Vec<Client> = (1..max_consumers)
            .map(|_| Client::within(&own.domain(), "roof").unwrap())
            .collect();
        while publish(&mut first, round) < max_consumers {
            for one in others.iter_mut().chain([&mut consumer]) {
                one.next(Duration::from_millis(20)).unwrap();
            }
            assert!(begun.elapsed() < SOON);
        }
        publish(&mut first, 10 + round);
        let mut numbers = std::iter::from_fn(|| consumer.next(Duration::ZERO).unwrap().received())
            .map(|sweep| number(&sweep));
        assert!(numbers.any(|number| number == 10 + round));
        assert_eq!(consumer.address().as_deref(), Some(address));
        drop(others);
    }
    // And the same again changes nothing.
    drop(first);
    let mut last = Loans::create(
        &own.domain(),
        &ServiceSettings {
            address: "192.168.1.202".to_owned(),
            ..settings(2)
        },
    )
    .unwrap();
    publish(&mut last, 20);
    assert_eq!(
        (
            number(&consumer.next(SOON).unwrap().received().unwrap()),
            consumer.reopened()
        ),
        (20, 3)
    );
}

#[test]
fn a_sweep_outlives_its_client_and_its_daemon() {
    let own = temp_domain();
    let mut loans = loans(&own, 1);
    let mut consumer = client(&own);
    publish(&mut loans, 1);
    let sweep = consumer.next(SOON).unwrap().received().unwrap();
    let bytes = sweep.bytes().to_vec();
    drop(consumer);
    for sequence in 2..40 {
        publish(&mut loans, sequence);
    }
    drop(loans);
    assert!(sweep.bytes() == bytes && number(&sweep) == 1);
    drop(sweep);
    // What it held is free again.
    let mut again = self::loans(&own, 1);
    let mut consumer = client(&own);
    publish(&mut again, 50);
    assert_eq!(
        number(&consumer.next(SOON).unwrap().received().unwrap()),
        50
    );
}

#[test]
#[cfg_attr(without_root, ignore = "not root, or no namespaces")]
fn a_folder_of_another_user_names_both() {
    let folder = temp_domain();
    std::fs::create_dir(folder.root()).unwrap();
    std::os::unix::fs::chown(folder.root(), Some(65_534), None).unwrap();
    for error in [
        Loans::create(&folder.domain(), &settings(1))
            .unwrap_err()
            .to_string(),
        Client::within(&folder.domain(), "roof")
            .unwrap()
            .next(Duration::ZERO)
            .unwrap_err()
            .to_string(),
        Client::sensors(&Domain::at(folder.root()))
            .unwrap_err()
            .to_string(),
    ] {
        assert!(
            error.contains("user nobody") && error.contains("runs as root"),
            "{error}"
        );
    }
}

/// Objects of a simulated street go to a consumer while sweeps go to another, message by message.
#[test]
fn objects_come_as_they_were_told() {
    let own = temp_domain();
    let settings = ServiceSettings {
        topic: Topic::Objects,
        ..settings(2)
    };
    let mut loans = Loans::create(&own.domain(), &settings).unwrap();
    loans.reserve(MESSAGE_BYTES).unwrap();
    let client = Client::within(&own.domain(), "roof").unwrap();
    let mut consumer = client.objects().unwrap();
    assert!(consumer.next(Duration::ZERO).unwrap().received().is_none());
    let sending = Sending {
        name: "roof",
        run_ns: 5,
        sent_ns: 6,
        sent_monotonic_ns: 7,
        position_m: [1.0, 2.0, 3.0],
        angles_rad: [0.1, 0.2, 0.3],
    };

    let scene = fixtures::scene();
    let sensor = EmitterConfig::new(Model::Vlp16, ReturnMode::Strongest).turns(5.0);
    let mut pipeline = Pipeline::new("192.168.1.201:2368", Config::default()).unwrap();
    pipeline.find_objects(true);
    let mut memory = Memory::new(HeapBuffers::default());
    let (mut told, mut received): (Vec<Object>, Vec<Object>) = (Vec::new(), Vec::new());
    let (mut sweeps, mut messages) = (0, 0);
    for sent in Emitter::new(sensor, &scene).untold() {
        pipeline.push(&sent.datagram().parse().unwrap());
        pipeline.idle(None);
        while let Some(event) = pipeline.poll(&mut memory) {
            let Event::Objects(these) = event else {
                continue;
            };
            told.extend_from_slice(these.objects);
            objects::write(&these, &sending, |message| {
                let mut slot = loans.take(message.len());
                slot.as_mut().copy_from_slice(message);
                assert_eq!(slot.publish().unwrap(), 1, "one consumer");
            });
            while let Some(message) = consumer.next(Duration::ZERO).unwrap().received() {
                messages += 1;
                let view = message.view().unwrap();
                let header = view.header;
                assert_eq!(header.sequence, these.sequence);
                assert_eq!((header.name(), header.run_ns), ("roof", 5));
                assert_eq!((header.position_m, header.roll_rad), ([1.0, 2.0, 3.0], 0.3));
                assert_eq!(header.first_ordinal as usize, received.len());
                received.extend_from_slice(view.objects);
                if header.flags & flags::LAST != 0 {
                    assert_eq!(view.labels, these.labels);
                    assert_eq!(received, told);
                    sweeps += 1;
                    (told, received) = (Vec::new(), Vec::new());
                }
            }
        }
    }
    assert!(sweeps >= 2 && messages > 10 * sweeps, "{messages} messages");
}
