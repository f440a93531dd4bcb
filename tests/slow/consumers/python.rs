//! The Python package in a process of its own, against a publisher here.

use std::ffi::OsStr;
use std::io::{BufRead, BufReader, Write};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdin, Command, Stdio};
use std::sync::mpsc::{self, Receiver};
use std::time::{Duration, Instant};

use serde_json::Value;
use sweepd::buffers::Buffers;
use sweepd::client::Client;
use sweepd::publish::{Loans, ServiceSettings, Slot};
use sweepd::sweep::layout::is_return;
use sweepd::sweep::{Shape, SweepMut, SweepRef};
use zerocopy::IntoBytes;

use super::sweeps::SOURCES;
use super::{folder, of_project};
use sweepd_testkit::{PATIENCE, TempDomain, python_package, python_with_numpy, temp_domain};

/// Longer than anything here takes on a busy machine.
pub const LIMIT: Duration = PATIENCE;

/// A program that says JSON, line by line; it ends with this.
pub struct Talk {
    child: Child,
    input: Option<ChildStdin>,
    lines: Receiver<String>,
}

impl Talk {
    pub fn start(program: &OsStr, args: &[&OsStr]) -> Self {
        // A test that runs in the background of a shell ignores SIGINT, and so would its children.
        let mut command = Command::new("env");
        command
            .arg("--default-signal=INT")
            .arg(program)
            .args(args)
            .envs(python_package())
            .stdin(Stdio::piped())
            .stdout(Stdio::piped());
        let mut child = command.spawn().unwrap();
        let (sender, lines) = mpsc::channel();
        let output = BufReader::new(child.stdout.take().unwrap());
        std::thread::spawn(move || {
            output
                .lines()
                .map_while(Result::ok)
                .try_for_each(|line| sender.send(line))
        });
        Self {
            input: child.stdin.take(),
            child,
            lines,
        }
    }

    #[track_caller]
    pub fn line(&self) -> String {
        self.lines.recv_timeout(LIMIT).expect("a line in time")
    }

    /// A line that comes within this time.
    pub fn try_line(&self, within: Duration) -> Option<String> {
        self.lines.recv_timeout(within).ok()
    }

    pub fn id(&self) -> u32 {
        self.child.id()
    }

    #[track_caller]
    pub fn json(&self) -> Value {
        let line = self.line();
        serde_json::from_str(&line).unwrap_or_else(|error| panic!("{error}: {line}"))
    }

    #[track_caller]
    pub fn ask(&mut self, what: &str) -> Value {
        writeln!(self.input.as_mut().unwrap(), "{what}").unwrap();
        self.json()
    }

    #[track_caller]
    pub fn signal(&self, name: &str) {
        let id = self.id().to_string();
        assert!(
            Command::new("kill")
                .args([name, &id])
                .status()
                .unwrap()
                .success()
        );
    }

    /// As Ctrl-Z and `fg` of a shell do; it waits before and after.
    pub fn stop_and_continue(&self) {
        for name in ["-STOP", "-CONT"] {
            std::thread::sleep(Duration::from_millis(20));
            self.signal(name);
        }
        std::thread::sleep(Duration::from_millis(20));
    }

    /// Waits for its end.
    #[track_caller]
    pub fn end(&mut self) -> std::process::ExitStatus {
        self.input = None;
        let begun = Instant::now();
        loop {
            if let Some(status) = self.child.try_wait().unwrap() {
                return status;
            }
            assert!(begun.elapsed() < LIMIT, "it does not end");
            std::thread::sleep(Duration::from_millis(10));
        }
    }
}

impl Drop for Talk {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

pub fn check(args: &[&OsStr]) -> Talk {
    let python = python_with_numpy();
    let script = of_project("tests/slow/consumers/check.py");
    Talk::start(&python, &[&[script.as_os_str()], args].concat())
}

fn follow(own: &TempDomain, points_to: &Path) -> Talk {
    check(&[
        "follow".as_ref(),
        "roof".as_ref(),
        own.root().as_ref(),
        points_to.as_ref(),
    ])
}

pub fn loans(own: &TempDomain) -> Loans {
    let (model, address) = ("VLP-16".to_owned(), "192.168.1.201".to_owned());
    Loans::create(
        &own.domain(),
        &ServiceSettings {
            name: "roof".to_owned(),
            max_consumers: 2,
            model,
            address,
            ..ServiceSettings::default()
        },
    )
    .unwrap()
}

/// A sweep with this number, nothing else in it.
pub fn numbered(loans: &mut Loans, sequence: u64) -> Slot {
    let shape = Shape {
        rows: 16,
        columns_capacity: 100,
        dual: false,
        segments_capacity: 10,
    };
    let mut slot = loans.take(shape.total_bytes());
    let sweep = SweepMut::create(slot.as_mut(), &shape).unwrap();
    sweep.beams.as_mut_bytes().fill(sequence as u8);
    (sweep.header.sequence, sweep.header.columns) = (sequence, 0);
    slot
}

pub fn publish(loans: &mut Loans, sequence: u64) {
    let slot = numbered(loans, sequence);
    let trouble = loans.status().trouble();
    slot.publish()
        .unwrap_or_else(|error| panic!("{error}: {trouble:?}"));
}

/// The file that is mapped where `bytes` are, and where in it they are.
pub fn mapped(bytes: &[u8]) -> (String, u64) {
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
                fields.get(5).copied().unwrap_or_default().to_owned(),
                offset + at - first,
            )
        })
    };
    maps.lines().find_map(line).expect("mapped in one piece")
}

/// SHA-256 of some bytes, by the same library in the other process.
fn parts<'a>(sweep: &SweepRef<'a>) -> Vec<(&'static str, &'a [u8])> {
    let SweepRef {
        range,
        label,
        range2,
        label2,
        columns,
        beams,
        segments,
        ..
    } = *sweep;
    let single = [
        ("range", range.as_bytes()),
        ("reflectivity", sweep.reflectivity),
        ("label", label.as_bytes()),
        ("columns", columns.as_bytes()),
        ("beams", beams.as_bytes()),
        ("segments", segments.as_bytes()),
    ];
    let other = [
        ("range2", range2.as_bytes()),
        ("reflectivity2", sweep.reflectivity2),
        ("label2", label2.as_bytes()),
        ("kind", sweep.kind),
    ];
    single
        .into_iter()
        .chain(other.into_iter().filter(|(_, bytes)| !bytes.is_empty()))
        .collect()
}

fn values<const N: usize>(file: PathBuf) -> Vec<[f64; N]> {
    let bytes = std::fs::read(file).unwrap();
    let numbers: Vec<f64> = bytes
        .as_chunks()
        .0
        .iter()
        .map(|bytes| f64::from_le_bytes(*bytes))
        .collect();
    numbers.as_chunks().0.to_vec()
}

/// Points, azimuths and times of a sweep as NumPy computed them, against those of Rust.
#[track_caller]
fn compare_points(sweep: &SweepRef<'_>, folder: &Path) {
    let points = [
        values::<3>(folder.join("points")),
        if sweep.range2.is_empty() {
            Vec::new()
        } else {
            values(folder.join("points2"))
        },
    ];
    let azimuths = values::<1>(folder.join("azimuth"));
    let times = std::fs::read(folder.join("times")).unwrap();
    let times: Vec<i64> = times
        .as_chunks()
        .0
        .iter()
        .map(|bytes| i64::from_le_bytes(*bytes))
        .collect();
    let pixels = sweep.range.len();
    assert_eq!(
        (points[0].len(), azimuths.len(), times.len()),
        (pixels, pixels, pixels)
    );
    for index in 0..pixels {
        let (row, column) = (index % sweep.rows(), index / sweep.rows());
        assert_eq!(
            times[index],
            sweep.time_ns(row, column),
            "row {row}, column {column}"
        );
        assert!(
            (azimuths[index][0] - sweep.azimuth_rad(row, column)).abs() < 1e-12,
            "row {row}, column {column}"
        );
        for (plane, range) in [(&points[0], sweep.range), (&points[1], sweep.range2)] {
            let Some(&range_m) = range.get(index) else {
                continue;
            };
            let point = plane[index];
            if is_return(range_m) {
                let off = point
                    .iter()
                    .zip(sweep.point_m(row, column, range_m))
                    .map(|(one, other)| (one - other).abs());
                assert!(
                    off.fold(0.0, f64::max) < 1e-9,
                    "row {row}, column {column}: {point:?}"
                );
            } else {
                assert!(
                    point.iter().all(|axis| axis.is_nan()),
                    "row {row}, column {column}: {point:?}"
                );
            }
        }
    }
}

#[test]
#[cfg_attr(without_python, ignore = "no SWEEPD_PYTHON")]
fn python_reads_the_bytes_that_the_decoder_wrote_and_the_same_points() {
    for source in SOURCES {
        let (own, points_to) = (temp_domain(), folder("python"));
        let mut hashes = Vec::new();
        let loans = loans(&own);
        let mut python = follow(&own, &points_to);
        assert_eq!(python.json()["ready"], true);
        source.play(loans, |slot| {
            let bytes = slot.as_ref().to_vec();
            let written = SweepRef::open(slot.as_ref()).unwrap();
            let (file, offset) = mapped(written.range.as_bytes());
            slot.publish().unwrap();
            let said = python.ask("5");
            let mut copy = sweepd::buffers::HeapBuffers::default().take(bytes.len());
            copy.as_mut().copy_from_slice(&bytes);
            let sweep = SweepRef::open(copy.as_ref()).unwrap();
            assert_eq!(said["sweep"], sweep.header.sequence, "{said}");
            assert_eq!(
                said["shape"],
                serde_json::json!([sweep.columns.len(), sweep.rows()])
            );
            let mapping = &said["mapping"];
            assert!(file.starts_with("/dev/shm/"), "{file}");
            assert_eq!(
                (&mapping["file"], &mapping["offset"]),
                (&file.into(), &offset.into()),
                "the same place of it"
            );
            assert_eq!(
                (&mapping["access"], &said["read_only"]),
                (&"r--s".into(), &true.into())
            );
            assert_eq!(
                (&said["schema"], &said["model"]),
                (&"3".into(), &"VLP-16".into())
            );
            compare_points(&sweep, &points_to);
            for (name, bytes) in parts(&sweep) {
                hashes.push((
                    bytes.to_vec(),
                    said["sha256"][name].as_str().unwrap().to_owned(),
                ));
            }
        });
        assert!(hashes.len() >= 18, "three sweeps of six parts");
        compare_hashes(&hashes);
        assert!(python.end().success());
    }
}

/// SHA-256 comes from sha256sum, which is neither Rust nor Python.
fn compare_hashes(hashes: &[(Vec<u8>, String)]) {
    let folder = folder("hashes");
    let mut expected = String::new();
    for (number, (bytes, hash)) in hashes.iter().enumerate() {
        std::fs::write(folder.join(number.to_string()), bytes).unwrap();
        expected += &format!("{hash}  {number}\n");
    }
    std::fs::write(folder.join("sums"), expected).unwrap();
    let output = Command::new("sha256sum")
        .args(["--check", "--quiet", "sums"])
        .current_dir(&folder)
        .output()
        .unwrap();
    assert!(
        output.status.success(),
        "{}",
        String::from_utf8_lossy(&output.stdout)
    );
}

#[test]
#[cfg_attr(without_python, ignore = "no SWEEPD_PYTHON")]
fn python_goes_on_when_the_daemon_was_restarted_and_when_files_were_deleted() {
    let own = temp_domain();
    // It is there first.
    let mut python = follow(&own, Path::new(""));
    assert_eq!(python.json()["ready"], false);
    assert_eq!(python.ask("0.2")["sweep"], Value::Null);
    let mut first = loans(&own);
    // Sends until the other has got something new, having found the service again so often.
    let mut sequence = 0;
    let mut send_until_seen = |loans: &mut Loans, python: &mut Talk, reopened: u64| {
        let (begun, before) = (Instant::now(), sequence);
        loop {
            sequence += 1;
            publish(loans, sequence);
            let said = python.ask("0.1");
            let is_new = said["sweep"].as_u64().is_some_and(|sweep| sweep > before);
            if is_new && said["reopened"].as_u64() >= Some(reopened) {
                return said["reopened"].as_u64().unwrap();
            }
            assert!(begun.elapsed() < LIMIT, "{said}");
        }
    };
    assert_eq!(send_until_seen(&mut first, &mut python, 0), 0);
    drop(first);
    // What was on its way still comes, and then no more.
    let rest: Vec<Value> = (0..4).map(|_| python.ask("0.1")).collect();
    assert_eq!(
        (&rest[3]["sweep"], &rest[3]["published"]),
        (&Value::Null, &false.into())
    );
    let mut second = loans(&own);
    assert_eq!(
        send_until_seen(&mut second, &mut python, 0),
        0,
        "a restart is not even noticed"
    );
    for round in 1..=2 {
        std::fs::remove_dir_all(own.root()).unwrap();
        // Between the two it may open the new one, whose file the old one took along when it went.
        assert!((round..=2 * round).contains(&send_until_seen(&mut second, &mut python, round)));
    }
    assert_eq!(second.status().renewed(), 2);
    assert!(python.end().success());
}

#[test]
#[cfg_attr(without_python, ignore = "no SWEEPD_PYTHON")]
fn what_python_holds_stays_and_costs_nobody_and_more_than_two_are_refused() {
    let own = temp_domain();
    let mut loans = loans(&own);
    let mut python = check(&["hold".as_ref(), "roof".as_ref(), own.root().as_ref()]);
    assert_eq!(python.json()["ready"], true);
    let mut other = Client::within(&own.domain(), "roof").unwrap();
    assert!(other.next(Duration::ZERO).unwrap().received().is_none() && other.is_connected());
    // Another consumer gets all, whatever the first holds.
    let mut publish_to_other = |sequence| {
        publish(&mut loans, sequence);
        let sweep = other.next(LIMIT).unwrap().received().expect("a sweep");
        assert_eq!(sweep.view().unwrap().header.sequence, sequence);
    };
    (1..3).for_each(&mut publish_to_other);
    assert_eq!(python.json()["holds"], serde_json::json!([2]));
    (3..100).for_each(&mut publish_to_other);
    let said = python.ask("");
    assert!(
        said["greedy"]
            .as_str()
            .is_some_and(|error| error.contains("holds 2 sweeps")),
        "{said}"
    );
    assert_eq!(
        (&said["same"], &said["newest"], &said["then"]),
        (&true.into(), &99.into(), &true.into()),
        "{said}"
    );
    assert!(python.end().success());
}

#[test]
#[cfg_attr(without_python, ignore = "no SWEEPD_PYTHON")]
fn python_refuses_a_full_service() {
    let own = temp_domain();
    let _loans = loans(&own);
    let mut others: Vec<Talk> = (0..2).map(|_| follow(&own, Path::new(""))).collect();
    assert!(others.iter().all(|talk| talk.json()["ready"] == true));
    let mut third = follow(&own, Path::new(""));
    assert_eq!(third.json()["ready"], false);
    // Places of consumers that died are given back within a second: it takes two to tell that there
    // is none.
    let full = third.ask("5");
    assert!(
        full["error"]
            .as_str()
            .is_some_and(|error| error.contains("max_consumers")),
        "{full}"
    );
    others
        .iter_mut()
        .for_each(|talk| assert!(talk.end().success()));
}

#[test]
#[cfg_attr(
    any(without_python, without_root),
    ignore = "no SWEEPD_PYTHON, not root, or no namespaces"
)]
fn a_folder_of_another_user_is_named() {
    let folder = temp_domain();
    std::fs::create_dir(folder.root()).unwrap();
    std::os::unix::fs::chown(folder.root(), Some(65_534), None).unwrap();
    let said = follow(&folder, Path::new("")).json();
    let error = said["error"].as_str().unwrap();
    assert!(
        error.contains("user nobody") && error.contains("runs as root"),
        "{error}"
    );
}
