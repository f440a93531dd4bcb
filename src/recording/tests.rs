use std::cell::Cell;
use std::time::Instant;

use super::*;
use crate::input::Capture;
use sweepd_testkit::Stopwatch;

const SECOND_NS: i64 = 1_000_000_000;

fn addressed(arrival_ns: i64, port: u16, payload: &[u8]) -> Addressed<'_> {
    let source = "192.168.1.201:2368".parse().unwrap();
    Addressed {
        arrival_ns,
        source,
        destination: (std::net::SocketAddrV4::new([239, 1, 2, 3].into(), port)),
        payload,
    }
}

fn read(path: &Path) -> Vec<(i64, u16, Vec<u8>)> {
    let mut capture = Capture::open(path).unwrap();
    let mut all = Vec::new();
    while let Some(one) = capture.next_datagram().unwrap() {
        all.push((one.arrival_ns, one.destination_port, one.payload.to_vec()));
    }
    assert_eq!(capture.truncation(), None);
    all
}

fn wait_until(mut done: impl FnMut() -> bool) {
    let begun = Instant::now();
    while !done() {
        assert!(begun.elapsed() < Duration::from_secs(60));
        thread::sleep(Duration::from_millis(2));
    }
}

#[test]
fn feeds_are_merged_by_arrival() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("merged.pcap");
    let recorder = Recorder::start(RecorderConfig::new(&path)).unwrap();
    let (mut data, mut position) = (recorder.feed(), recorder.feed());
    // The thread of positions reaches each hundred sometimes before that of data, sometimes after
    // it.
    for hundred in 0..20_i64 {
        let times = hundred * 100..(hundred + 1) * 100;
        let put = |feed: &mut Feed, port, step| {
            times
                .clone()
                .filter(|time| (time % 10 == 5) == (step == 10))
                .for_each(|time| {
                    assert!(feed.put(&addressed(SECOND_NS + time, port, &time.to_le_bytes())));
                });
        };
        if hundred % 2 == 0 {
            put(&mut position, 8308, 10);
            put(&mut data, 2368, 1);
        } else {
            put(&mut data, 2368, 1);
            put(&mut position, 8308, 10);
        }
        thread::sleep(Duration::from_millis(3));
    }
    // A feed that was closed is written to its end, and one more can come.
    drop((data, position));
    let mut late = recorder.feed();
    assert!(late.put(&addressed(SECOND_NS + 2000, 1, &2000_i64.to_le_bytes())));
    let (written, ended) = recorder.finish();
    ended.unwrap();
    let all = read(&path);
    assert_eq!(written.records, 2001);
    // On a busy machine, datagrams that are late by more than a period are out of order, but not
    // lost.
    let mut times: Vec<i64> = all
        .iter()
        .map(|one| i64::from_le_bytes(one.2[..].try_into().unwrap()))
        .collect();
    let misplaced = times.windows(2).filter(|pair| pair[0] > pair[1]).count();
    assert!(misplaced <= 2, "{misplaced}");
    times.sort_unstable();
    assert!(times.into_iter().eq(0..=2000));
    assert!(all.iter().all(|(arrival_ns, port, payload)| {
        let time = i64::from_le_bytes(payload[..].try_into().unwrap());
        let expected = if time == 2000 {
            1
        } else {
            [2368, 8308][usize::from(time % 10 == 5)]
        };
        *arrival_ns == SECOND_NS + time && *port == expected
    }));
}

#[test]
fn stamps_that_go_back_are_written_all_the_same() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("back.pcap.gz");
    let recorder = Recorder::start(RecorderConfig::new(&path)).unwrap();
    let mut feeds = [recorder.feed(), recorder.feed()];
    let times = [5, 4, 9, 1, 1, 0];
    for (number, time) in times.into_iter().enumerate() {
        assert!(feeds[number % 2].put(&addressed(time * SECOND_NS, 2368, b"x")));
        wait_until(|| recorder.counts().written.load(Ordering::Relaxed) == number as u64 + 1);
    }
    recorder.finish().1.unwrap();
    assert!(
        read(&path)
            .into_iter()
            .map(|one| one.0)
            .eq(times.map(|time| time * SECOND_NS))
    );
}

#[test]
fn unwritten_datagrams_are_counted_and_a_failure_is_reported() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("full.pcap");
    std::os::unix::fs::symlink("/dev/full", &path).unwrap();
    let recorder = Recorder::start(RecorderConfig::new(&path)).unwrap();
    let mut feed = recorder.feed();
    let mut taken = 0;
    wait_until(|| {
        taken += u64::from(feed.put(&addressed(SECOND_NS, 2368, &[7; 1206])));
        recorder.error().is_some()
    });
    assert!(!feed.put(&addressed(SECOND_NS, 2368, &[7; 1206])));
    let [offered, refused] = [&recorder.counts().offered, &recorder.counts().refused];
    assert_eq!(
        offered.load(Ordering::Relaxed) - refused.load(Ordering::Relaxed),
        taken
    );
    let (written, ended) = recorder.finish();
    let error = ended.unwrap_err().to_string();
    assert!(
        error.contains("full.pcap") && error.contains("free space there"),
        "{error}"
    );
    assert_eq!(written.records, 0);
}

#[test]
fn a_feed_without_room_refuses_and_goes_on_later() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("room.pcap");
    let recorder = Recorder::start(RecorderConfig::new(&path)).unwrap();
    let mut feed = recorder.feed();
    let payload = vec![7; 60_000];
    // As many as would fill it twice, faster than any disk.
    let taken = (0..2 * FEED_BYTES / payload.len())
        .filter(|_| feed.put(&addressed(SECOND_NS, 1, &payload)))
        .count();
    let written = || recorder.counts().written.load(Ordering::Relaxed) as usize;
    wait_until(|| written() == taken);
    assert!(feed.put(&addressed(SECOND_NS, 1, &payload)));
    let offered = recorder.counts().offered.load(Ordering::Relaxed) as usize;
    let refused = recorder.counts().refused.load(Ordering::Relaxed) as usize;
    assert_eq!(offered - refused, taken + 1);
    recorder.finish().1.unwrap();
    assert_eq!(read(&path).len(), taken + 1);
}

#[test]
fn one_that_is_dropped_has_written_all() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("dropped.pcap.gz");
    let recorder = Recorder::start(RecorderConfig {
        rotation: Rotation {
            bytes: Some(2000),
            ns: None,
        },
        ..RecorderConfig::new(&path)
    })
    .unwrap();
    let mut feed = recorder.feed();
    assert!((0..100).all(|number| feed.put(&addressed(SECOND_NS + number, 1, &[9; 500]))));
    drop(recorder);
    assert!(!feed.put(&addressed(SECOND_NS, 1, b"late")));
    let all: Vec<_> = (0..34)
        .flat_map(|number| read(&folder.path().join(format!("dropped-{number:03}.pcap.gz"))))
        .collect();
    assert!(
        all.into_iter()
            .map(|one| one.0)
            .eq((0..100).map(|number| SECOND_NS + number))
    );
}

fn replacing(path: &Path) -> RecorderConfig<'_> {
    RecorderConfig {
        existing: Existing::Replace,
        ..RecorderConfig::new(path)
    }
}

fn record_one(recorder: &Recorder) {
    let mut feed = recorder.feed();
    assert!(feed.put(&addressed(SECOND_NS, 2368, b"kept")));
}

#[test]
fn a_second_recording_never_takes_the_file_of_the_first() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("x.pcap");
    let other_name = folder.path().join("same").join("x.pcap");
    std::os::unix::fs::symlink(folder.path(), folder.path().join("same")).unwrap();
    // A part that is no recording's is not in use, and stays.
    let other = folder.path().join("x.pcap.part");
    std::fs::write(&other, "left behind").unwrap();
    let first = Recorder::start(replacing(&path)).unwrap();
    record_one(&first);
    for name in [&path, &other_name] {
        let error = Recorder::start(replacing(name)).unwrap_err();
        assert!(matches!(error, WriteError::Busy { .. }), "{error}");
    }
    let (_, ended) = first.finish();
    assert!(ended.is_ok() && read(&path).len() == 1);
    assert_eq!(std::fs::read(&other).unwrap(), b"left behind");
    // A file that has its name from the beginning is not replaced before it ends either.
    let plain = folder.path().join("plain.pcap");
    let first = Recorder::start(RecorderConfig::new(&plain)).unwrap();
    let error = Recorder::start(replacing(&plain)).unwrap_err();
    assert!(matches!(error, WriteError::Busy { .. }), "{error}");
    drop(first);
    let second = Recorder::start(replacing(&plain)).unwrap();
    record_one(&second);
    assert!(second.finish().1.is_ok() && read(&plain).len() == 1);
}

#[test]
fn a_file_that_another_recording_has_begun_meanwhile_is_not_replaced() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("x.pcap");
    let first = Recorder::start(replacing(&path)).unwrap();
    let second = Recorder::start(RecorderConfig::new(&path)).unwrap();
    record_one(&first);
    record_one(&second);
    let (written, ended) = first.finish();
    assert!(matches!(*ended.unwrap_err(), WriteError::Busy { .. }));
    assert_eq!(written.last, folder.path().join("x.pcap.part"));
    assert_eq!(read(&written.last).len(), 1);
    assert!(second.finish().1.is_ok() && read(&path).len() == 1);
}

/// The end wakes the writer, which waits for more.
#[test]
fn the_end_is_not_a_period_late() {
    // No disk, whose time would count.
    let folder = tempfile::tempdir_in("/dev/shm").unwrap();
    let ends = (0..10).map(|number| {
        let path = folder.path().join(format!("{number}.pcap"));
        let recorder = Recorder::start(RecorderConfig::new(&path)).unwrap();
        record_one(&recorder);
        thread::sleep(PERIOD / 4);
        let asked = Stopwatch::start();
        assert!(recorder.finish().1.is_ok() && read(&path).len() == 1);
        asked.elapsed()
    });
    // The cores may be busy, but not each time.
    let fastest = ends.min().unwrap();
    assert!(fastest < PERIOD / 2, "{fastest:?}");
}

#[test]
fn a_part_that_was_replaced_replaces_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("x.pcap");
    std::fs::write(&path, "good").unwrap();
    let recorder = Recorder::start(replacing(&path)).unwrap();
    let part = folder.path().join("x.pcap.part");
    std::fs::remove_file(&part).unwrap();
    std::fs::write(&part, "of another program").unwrap();
    let (_, ended) = recorder.finish();
    assert!(matches!(*ended.unwrap_err(), WriteError::Lost { .. }));
    assert_eq!(std::fs::read(&path).unwrap(), b"good");
    assert_eq!(std::fs::read(&part).unwrap(), b"of another program");
}

#[test]
fn a_folder_is_not_replaced() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("x.pcap");
    std::fs::create_dir(&path).unwrap();
    let error = Recorder::start(replacing(&path)).unwrap_err().to_string();
    assert!(error.contains("choose another name"), "{error}");
    assert!(!folder.path().join("x.pcap.part").exists());
}

/// Whatever a killed recording left, its bytes stay, and the next one records.
#[test]
fn a_part_that_was_left_is_kept_and_stops_no_recording() {
    for ending in [".pcap", ".pcap.gz"] {
        let good = capture(ending);
        let mut random = fastrand::Rng::with_seed(4);
        let noise: Vec<u8> = std::iter::repeat_with(|| random.u8(..))
            .take(4096)
            .collect();
        for bit in (0..4096).chain((0..500).map(|_| random.usize(0..8 * good.len()))) {
            let mut left = good.clone();
            left[bit / 8] ^= 1 << (bit % 8);
            record_beside(ending, &left);
        }
        for cut in [1, 3, 10, 23, 24, 25, 300, good.len() / 2, good.len() - 1] {
            record_beside(ending, &good[..cut]);
        }
        let half = good.len() / 2;
        record_beside(ending, &[&good[..half], &noise, &good[half..]].concat());
        record_beside(ending, &[&good, &noise[..]].concat());
        record_beside(ending, b"Dear Sir,");
        // The length of the first record, behind the head of the file and two words of time.
        for bits in 0..32 {
            let mut left = good.clone();
            left[32..36].copy_from_slice(&(1_u32 << bits).to_le_bytes());
            record_beside(ending, &left);
        }
    }
}

#[test]
fn names_that_say_no_format_are_refused() {
    for name in [
        "-",
        "",
        "/",
        "drive",
        "drive.pcapng",
        "drive.gz",
        "drive.PCAP",
        ".pcap",
    ] {
        let error = Recorder::start(RecorderConfig::new(name.as_ref())).unwrap_err();
        assert!(matches!(error, WriteError::Name { .. }), "{name}: {error}");
        let expected = format!("{name}: expected a name that ends in .pcap or .pcap.gz");
        assert_eq!(error.to_string(), expected);
    }
}

/// A sequence leaves out what is there, and what a recording that replaces a file has left.
#[test]
fn numbers_of_files_folders_and_parts_are_left_out() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("x-000.pcap"), "a file").unwrap();
    std::fs::create_dir(folder.path().join("x-001.pcap")).unwrap();
    std::fs::write(folder.path().join("x-002.pcap.part-2"), "a part").unwrap();
    let path = folder.path().join("x.pcap");
    let recorder = Recorder::start(RecorderConfig {
        rotation: Rotation {
            bytes: None,
            ns: Some(1),
        },
        ..RecorderConfig::new(&path)
    });
    let recorder = recorder.unwrap();
    record_one(&recorder);
    let (written, ended) = recorder.finish();
    ended.unwrap();
    assert_eq!(written.last, folder.path().join("x-003.pcap"));
    assert_eq!(
        std::fs::read(folder.path().join("x-002.pcap.part-2")).unwrap(),
        b"a part"
    );
}

/// A recording of some datagrams.
fn capture(ending: &str) -> Vec<u8> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join(format!("x{ending}"));
    let recorder = Recorder::start(RecorderConfig::new(&path)).unwrap();
    let mut feed = recorder.feed();
    let mut random = fastrand::Rng::with_seed(3);
    for number in 0..20 {
        let payload: Vec<u8> = std::iter::repeat_with(|| random.u8(..))
            .take(1206)
            .collect();
        assert!(feed.put(&addressed(SECOND_NS + number, 2368, &payload)));
    }
    recorder.finish().1.unwrap();
    std::fs::read(&path).unwrap()
}

/// Leaves these bytes as the part of a killed recording, records, and looks for them.
fn record_beside(ending: &str, left: &[u8]) {
    let folder = tempfile::tempdir_in("/dev/shm").unwrap();
    let path = folder.path().join(format!("x{ending}"));
    std::fs::write(folder.path().join(format!("x{ending}.part")), left).unwrap();
    thread_local!(static TOLD: Cell<u32> = const { Cell::new(0) });
    let mut config = replacing(&path);
    config.watch.tell = |_| TOLD.set(TOLD.get() + 1);
    TOLD.set(0);
    let recorder = Recorder::start(config).unwrap();
    assert_eq!(TOLD.get(), 1);
    record_one(&recorder);
    assert!(recorder.finish().1.is_ok() && read(&path).len() == 1);
    let files = std::fs::read_dir(folder.path()).unwrap();
    let mut files = files.map(|file| std::fs::read(file.unwrap().path()).unwrap());
    assert!(files.any(|bytes| bytes == left));
}
