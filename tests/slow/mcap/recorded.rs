//! `sweepd record --mcap` beside a consumer of the same daemon.

use std::collections::BTreeMap;
use std::fs::{self, File};
use std::path::Path;
use std::process::Command;
use std::time::{Duration, Instant};

use mcap::MessageStream;
use mcap::io::MessageReader;
use mcap::sans_io::LinearReaderOptions;
use sweepd::messages::{Cloud, MessageHeader, Stamp, markers};

use sweepd_testkit::setup::{Process, SOON, Setup, sweepd};

/// The messages of the topics of `roof` by topic and time.
type Read = BTreeMap<(String, u64), Vec<u8>>;

/// What a reader of whole files finds, the transforms left out.
fn read(path: &Path) -> Read {
    let bytes = fs::read(path).unwrap();
    let messages = MessageStream::new(&bytes).unwrap().map(Result::unwrap);
    let mut found = Read::new();
    for one in messages.filter(|one| one.channel.topic != "/tf_static") {
        let key = (one.channel.topic.clone(), one.log_time);
        assert!(found.insert(key, one.data.into_owned()).is_none());
    }
    found
}

fn record(setup: &Setup, file: &Path, more: &[&str]) -> Process {
    let (file, root) = (file.to_str().unwrap(), setup.own.root().to_str().unwrap());
    let args = ["record", "--from", "roof", "--mcap", file, "--root", root];
    Process::spawn(sweepd(&[&args, more].concat()), &setup.path("record.log"))
}

fn said(setup: &Setup) -> String {
    fs::read_to_string(setup.path("record.log")).unwrap_or_default()
}

fn until(what: &str, setup: &Setup, is_so: impl Fn() -> bool) {
    let begun = Instant::now();
    while !is_so() {
        assert!(begun.elapsed() < SOON, "{what}: {}", said(setup));
        std::thread::sleep(Duration::from_millis(20));
    }
}

/// What is in the files is what a consumer got at the same time, encoded by the consumer.
#[test]
fn a_recording_has_the_sweeps_that_consumers_get() {
    let mount = "mount = { x_m = 1, y_m = 2, z_m = 3, yaw_deg = 90 }";
    let setup = Setup::new(mount, "");
    let _daemon = setup.daemon();
    let mut client = setup.client();
    let file = setup.path("roof.mcap");
    let mut recording = record(&setup, &file, &["--rotate-seconds", "2"]);
    let first = setup.path("roof-000.mcap.part");
    until("it begins", &setup, || first.exists());
    let mut sensor = setup.sensor("vlp16", 600, 5.0);
    let header = MessageHeader {
        frame_id: "roof",
        stamp: Stamp::First,
    };
    let mut expected = Read::new();
    // All that is sent takes 5 s.
    let wait = |is_first| {
        if is_first {
            SOON
        } else {
            Duration::from_secs(3)
        }
    };
    while let Some(sweep) = client.next(wait(expected.is_empty())).unwrap().received() {
        let sweep = sweep.view().unwrap();
        let (mut points, mut boxes) = (Vec::new(), Vec::new());
        Cloud::default().encode(&sweep, &header, &mut points);
        markers::encode(&sweep, &header, &mut boxes);
        for (topic, message) in [("points", points), ("markers", boxes)] {
            let key = (format!("/sweepd/roof/{topic}"), sweep.header.time_ns as u64);
            expected.insert(key, message);
        }
    }
    assert!(sensor.wait());
    recording.ends_when_told().unwrap();
    let mut found = Read::new();
    let mut files = 0;
    for number in 0..9 {
        let file = setup.path(&format!("roof-{number:03}.mcap"));
        if file.exists() {
            found.extend(read(&file));
            files += 1;
        }
    }
    assert!(files >= 2, "{files} files");
    // Each may have missed some on a busy machine.
    let common = expected.iter().filter(|(key, _)| found.contains_key(*key));
    let common: Vec<_> = common.collect();
    assert!(common.len() >= 20, "{} of {}", common.len(), expected.len());
    for (key, message) in common {
        assert!(found[key] == *message, "{key:?}");
    }
}

/// A recording that is killed has all but its last second, and the next one mends it.
#[test]
fn a_killed_recording_is_mended() {
    let setup = Setup::new("", "");
    let _daemon = setup.daemon();
    let _ = setup.client();
    let (file, part) = (setup.path("roof.mcap"), setup.path("roof.mcap.part"));
    let mut recording = record(&setup, &file, &[]);
    until("it begins", &setup, || part.exists());
    let mut sensor = setup.sensor("vlp16", 600, 30.0);
    until("there are some megabytes", &setup, || {
        part.metadata().is_ok_and(|part| part.len() > 4_000_000)
    });
    // A second recording does not take the first one's file.
    let mut second = record(&setup, &file, &[]);
    assert!(!second.wait());
    assert!(
        said(&setup).contains("another process writes"),
        "{}",
        said(&setup)
    );

    recording.signal("-KILL");
    assert!(!recording.wait());
    let options = LinearReaderOptions::default().with_skip_end_magic(true);
    let streamed = MessageReader::new_with_options(File::open(&part).unwrap(), options)
        .map_while(Result::ok)
        .filter(|one| one.channel.topic != "/tf_static")
        .count();
    assert!(streamed >= 10, "{streamed} messages");

    // It mends the file, and records.
    let mut next = record(&setup, &file, &["--seconds", "2"]);
    assert!(next.wait());
    let said = said(&setup);
    assert!(said.contains("roof-recovered.mcap: mended"), "{said}");
    assert_eq!(read(&setup.path("roof-recovered.mcap")).len(), streamed);
    assert!(!part.exists() && !read(&file).is_empty());
    sensor.signal("-KILL");
    sensor.wait();
}

/// Records to a disk of the test's own, in a namespace of its own: how it ended, and what it said.
/// The script runs meanwhile, with the name of the file as `$FILE` and its folder as `$DISK`; then
/// its folder is listed, and the file copied, if there is one.
fn record_to_disk(
    setup: &Setup,
    options: &str,
    seconds: u32,
    meanwhile: &str,
) -> (String, String, Vec<String>) {
    let disk = setup.path("disk");
    fs::create_dir(&disk).unwrap();
    let script = format!(
        "mount -t tmpfs -o {options} none $DISK\n\
         $PROGRAM record --from roof --root $ROOT --mcap $FILE --seconds {seconds} &\n\
         {meanwhile}\n\
         wait $! && exit 9\n\
         ls $DISK\n\
         cp $FILE $COPY 2>/dev/null || true\n"
    );
    let file = disk.join("roof.mcap");
    let ran = Command::new("unshare")
        .args(["-m", "sh", "-c", &script])
        .env("PROGRAM", sweepd(&[]).get_program())
        .env("ROOT", setup.own.root())
        .env("DISK", &disk)
        .env("FILE", &file)
        .env("COPY", setup.path("copy.mcap"))
        .output()
        .unwrap();
    let said = String::from_utf8_lossy(&ran.stderr).into_owned();
    assert!(ran.status.success(), "{said}");
    let left = String::from_utf8_lossy(&ran.stdout);
    let left = left.lines().map(str::to_owned).collect();
    (file.to_str().unwrap().to_owned(), said, left)
}

/// A disk of 4 MB is full within two seconds.
#[test]
#[cfg_attr(without_root, ignore = "not root, or no namespaces")]
fn a_full_disk_leaves_a_file_that_is_read_at_once() {
    let setup = Setup::new("", "");
    let _daemon = setup.daemon();
    let _ = setup.client();
    let _sensor = setup.sensor("vlp16", 600, 30.0);
    let (file, said, left) = record_to_disk(&setup, "size=4m", 60, "");
    assert_eq!(left, ["roof.mcap"]);
    let expected = format!("error: cannot write {file}: No space left on device");
    assert!(said.contains(&expected), "{said}");
    let clouds = read(&setup.path("copy.mcap")).len() / 2;
    assert!(clouds >= 3, "{clouds} clouds");
}

/// One that is read-only, and one that is taken away while it is written to.
#[test]
#[cfg_attr(without_root, ignore = "not root, or no namespaces")]
fn a_disk_that_takes_nothing_is_one_error() {
    let setup = Setup::new("", "");
    let _daemon = setup.daemon();
    let _ = setup.client();
    let _sensor = setup.sensor("vlp16", 600, 60.0);
    let gone =
        "for _ in $(seq 600); do test -s $FILE.part && break; sleep 0.1; done\numount -l $DISK";
    for (options, meanwhile, why) in [
        ("ro", "", "Read-only file system"),
        (
            "size=64m",
            gone,
            "was removed or replaced while it was written",
        ),
    ] {
        let (file, said, left) = record_to_disk(&setup, options, 10, meanwhile);
        let errors: Vec<&str> = said.lines().filter(|line| line.contains("error")).collect();
        assert!(
            errors.len() == 1 && errors[0].contains(&file) && errors[0].contains(why),
            "{said}"
        );
        assert!(left.is_empty(), "{left:?}");
        fs::remove_dir(setup.path("disk")).unwrap();
    }
}
