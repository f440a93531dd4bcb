//! Consumers of a publisher that keeps to nothing: a refusal that says why, or a sweep of which all
//! can be asked, and never a crash.

use std::fs::File;
use std::os::unix::fs::{FileExt, PermissionsExt};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc;
use std::time::{Duration, Instant};

use iceoryx2::prelude::*;
use sweepd::client::{Client, ClientError, Next, SubscribeError, Sweep};
use sweepd::publish::Preamble;
use sweepd::sweep::SweepRef;
use sweepd::sweep::layout::{Header, LAYOUT_VERSION, LayoutError};
use zerocopy::IntoBytes;

use super::hostile::{
    COLUMNS, Case, Fate, Hostile, SHAPE, cases, honest, node, preamble, schema, service_name,
};
use super::python::{Talk, check, loans, publish};
use super::{folder, objects, of_project};
use sweepd_testkit::{PATIENCE, TempDomain, temp_domain};

const SOON: Duration = PATIENCE;

fn client(own: &TempDomain) -> Client {
    let mut client = Client::within(&own.domain(), "roof").unwrap();
    assert!(client.next(Duration::ZERO).unwrap().received().is_none() && client.is_connected());
    client
}

/// Asks everything of a sweep, whatever stands in it, and gives the number of its returns.
fn ask_all(sweep: &SweepRef<'_>) -> usize {
    let header = sweep.header;
    let _ = (header.time_source(), header.return_mode(), header.has(1));
    for name in [header.name(), header.sensor()] {
        assert!(
            !name.contains(char::is_control),
            "{name:?} is shown on terminals"
        );
    }
    for (row, column) in
        (0..sweep.rows()).flat_map(|row| (0..sweep.columns.len()).map(move |column| (row, column)))
    {
        assert!(sweep.fired_in(row, column) < sweep.columns.len());
        let _ = (
            sweep.azimuth_rad(row, column),
            sweep.time_ns(row, column),
            sweep.point_m(row, column, f32::MAX),
        );
    }
    assert_eq!(sweep.segments.len(), header.segments as usize);
    sweep.returns().count()
}

#[test]
fn rust_accepts_or_refuses_any_bytes() {
    let own = temp_domain();
    let hostile = Hostile::new(&own);
    let mut client = client(&own);
    for Case {
        name,
        bytes,
        preamble,
        fate,
    } in cases()
    {
        hostile.send(&bytes, &preamble);
        match (client.next(SOON), fate) {
            (Ok(Next::Received(sweep)), Fate::Taken) => {
                let view = sweep.view().unwrap();
                assert!(ask_all(&view) <= SHAPE.rows * COLUMNS * 2, "{name}");
            }
            (Err(error @ ClientError::Layout { .. }), Fate::Refused(words)) => {
                let said = error.to_string();
                assert!(
                    said.starts_with("`roof` sent no valid sweep: ") && said.contains(words),
                    "{name}: {said}"
                );
            }
            (other, _) => panic!("{name}: {:?}", other.map(|_| "a sweep or nothing")),
        }
        // And it goes on.
        hostile.send(&honest(9), &honest_preamble());
        assert_eq!(
            client
                .next(SOON)
                .unwrap()
                .received()
                .unwrap()
                .view()
                .unwrap()
                .header
                .sequence,
            9,
            "{name}"
        );
    }
}

fn honest_preamble() -> Preamble {
    preamble(LAYOUT_VERSION, SHAPE.total_bytes() as u64)
}

#[test]
fn a_refusal_of_another_version_names_both_and_the_cure() {
    for version in [LAYOUT_VERSION - 1, LAYOUT_VERSION + 1] {
        let said = LayoutError::Version { found: version }.to_string();
        let both =
            format!("layout version {version}, and this program reads version {LAYOUT_VERSION}");
        assert!(
            said.contains(&both) && said.contains("build it with"),
            "{said}"
        );
    }
}

/// Consumers that are older and newer than the daemon, and what they are told before they read a
/// byte.
#[test]
#[cfg_attr(without_python, ignore = "no SWEEPD_PYTHON")]
fn a_service_of_another_version_is_refused_with_both_and_the_cure_until_this_one_comes() {
    for version in ["2", "4", "100000"] {
        let own = temp_domain();
        let (mut client, mut python) = (
            Client::within(&own.domain(), "roof").unwrap(),
            refusing(&own),
        );
        let node = node(&own);
        let samples = node
            .service_builder(&service_name())
            .publish_subscribe::<[u8]>()
            .user_header::<Preamble>();
        let other = samples.create_with_attributes(&schema(version)).unwrap();
        let event = node
            .service_builder(&service_name())
            .event()
            .create()
            .unwrap();
        let error = client.next(Duration::ZERO).unwrap_err();
        assert!(
            matches!(&error, ClientError::Subscribe(SubscribeError::OtherVersion { found, .. }) if found == version)
        );
        let both =
            |own: &str| format!("layout version {version}, and this program reads version {own}: ");
        let said = error.to_string();
        let cure = "build it with the version of sweepd that runs on this host";
        assert!(said.contains(&both("3")) && said.contains(cure), "{said}");
        {
            let said = python.ask("next");
            let words = said["refused"].as_str().unwrap_or_else(|| panic!("{said}"));
            assert!(
                words.contains(&both("3")) && words.contains(cure),
                "{words}"
            );
        }
        drop((other, event, node));
        // Once the daemon is of this version, the same client goes on.
        comes_back(&own, &mut client);
    }
}

/// A daemon begins, and the client that was refused gets its sweeps.
#[track_caller]
fn comes_back(own: &TempDomain, client: &mut Client) {
    let mut loans = loans(own);
    let begun = Instant::now();
    loop {
        publish(&mut loans, 5);
        match client.next(Duration::from_millis(20)) {
            Ok(Next::Received(sweep)) => {
                return assert_eq!(sweep.view().unwrap().header.sequence, 5);
            }
            other => assert!(begun.elapsed() < SOON, "{:?}", other.map(|_| "nothing")),
        }
    }
}

/// As the header of a service that has the daemon's type name, and another size.
#[derive(Clone, Copy, Debug, Default, ZeroCopySend)]
#[repr(C)]
#[repr(align(128))]
#[type_name("sweepd.Preamble")]
struct Wider {
    _bytes: [u64; 16],
}

/// Has the clients meet the service while it lives.
fn meet_foreign(own: &TempDomain, what: &str) {
    let mut client = Client::within(&own.domain(), "roof").unwrap();
    let error = client.next(Duration::ZERO).unwrap_err();
    assert!(
        matches!(
            error,
            ClientError::Subscribe(SubscribeError::Foreign { .. })
        ),
        "{what}: {error}"
    );
    let said = error.to_string();
    assert!(
        said.contains("not sweepd") && said.contains(what) && said.contains("SWEEPD_ROOT"),
        "{what}: {said}"
    );
    {
        let mut python = refusing(own);
        let said = python.ask("next");
        assert!(
            said["refused"]
                .as_str()
                .is_some_and(|words| words.contains("not sweepd")),
            "{what}: {said}"
        );
    }
}

#[test]
#[cfg_attr(without_python, ignore = "no SWEEPD_PYTHON")]
fn a_foreign_service_of_the_same_name_is_refused() {
    let version = schema(&LAYOUT_VERSION.to_string());
    macro_rules! meet {
        ($what:literal, $attributes:expr, $payload:ty, $($header:tt)*) => {{
            let own = temp_domain();
            let node = node(&own);
            let samples = node.service_builder(&service_name()).publish_subscribe::<$payload>()$($header)*;
            let _service = samples.create_with_attributes($attributes).unwrap();
            let _event = node.service_builder(&service_name()).event().create().unwrap();
            meet_foreign(&own, $what);
        }};
    }
    meet!("u64", &version, u64, .user_header::<Preamble>());
    meet!("u16", &version, [u16], .user_header::<Preamble>());
    meet!("header ()", &version, [u8],);
    meet!("sweepd.Preamble", &version, [u8], .user_header::<Wider>());
}

/// What a tunnel mirrors has no attributes: each sweep says its version.
#[test]
#[cfg_attr(without_python, ignore = "no SWEEPD_PYTHON")]
fn a_mirror_without_attributes_is_read_and_of_another_version_refused() {
    let own = temp_domain();
    let mirror = Hostile::mirror(&own);
    let mut python = refusing(&own);
    assert!(python.ask("look")["sweep"].is_null());
    let mut client = Client::within(&own.domain(), "roof").unwrap();
    assert!(client.next(Duration::ZERO).unwrap().received().is_none());
    assert_eq!((client.is_connected(), client.model()), (true, None));
    let bytes = honest(7);
    mirror.send(&bytes, &preamble(LAYOUT_VERSION, bytes.len() as u64));
    let sweep = client.next(SOON).unwrap().received().unwrap();
    assert_eq!(sweep.view().unwrap().header.sequence, 7);
    drop(sweep);
    let said = python.ask("next");
    assert!(
        said["sweep"].is_number() && said["refused"].is_null(),
        "{said}"
    );
    mirror.send(&bytes, &preamble(LAYOUT_VERSION + 1, bytes.len() as u64));
    let error = client.next(SOON).unwrap_err();
    let found = LAYOUT_VERSION + 1;
    let said = python.ask("next");
    let words = said["refused"].as_str().unwrap_or_default();
    assert!(words.contains(&format!("layout version {found}")), "{said}");
    assert!(
        matches!(error, ClientError::Layout { source: LayoutError::Version { found: other }, .. } if other == found),
        "{error}"
    );
}

/// Has something else stand in the file in which a service says what it is.
fn rewrite(own: &TempDomain, how: impl Fn(&ServiceFile, &ServiceFile) -> Vec<u8>) {
    let folder = std::fs::read_dir(own.root().join("services")).unwrap();
    let read = |path: PathBuf| {
        let content = std::fs::read(&path).unwrap();
        let hash = path
            .file_stem()
            .unwrap()
            .to_str()
            .unwrap()
            .strip_prefix(&own.domain().prefix())
            .unwrap()
            .to_owned();
        ServiceFile {
            path,
            hash,
            content,
        }
    };
    let mut files: Vec<ServiceFile> = folder.map(|entry| read(entry.unwrap().path())).collect();
    // The longer one has the attributes and types of the sweeps.
    files.sort_by_key(|file| file.content.len());
    let [event, sweeps] = &files[..] else {
        panic!("{} files", files.len())
    };
    let content = how(sweeps, event);
    std::fs::remove_file(&sweeps.path).unwrap();
    std::fs::write(&sweeps.path, content).unwrap();
    std::fs::set_permissions(&sweeps.path, std::fs::Permissions::from_mode(0o400)).unwrap();
}

struct ServiceFile {
    path: PathBuf,
    hash: String,
    content: Vec<u8>,
}

fn replaced(bytes: &[u8], from: &[u8], to: &[u8]) -> Vec<u8> {
    assert_eq!(from.len(), to.len());
    let mut bytes = bytes.to_vec();
    let places: Vec<usize> = (0..=bytes.len() - from.len())
        .filter(|&at| bytes[at..].starts_with(from))
        .collect();
    assert!(
        !places.is_empty(),
        "{} is not in the file",
        String::from_utf8_lossy(from)
    );
    places
        .into_iter()
        .for_each(|at| bytes[at..at + to.len()].copy_from_slice(to));
    bytes
}

/// What a service says of itself stands in a file, in which a process of the same user can write
/// anything.
#[test]
#[cfg_attr(without_python, ignore = "no SWEEPD_PYTHON")]
fn a_service_that_lies_about_what_it_is_is_refused_in_plain_text() {
    let own = temp_domain();
    let _hostile = Hostile::new(&own);
    // It is an event, under the name of the sweeps: iceoryx2 panics where it is asked for the types
    // of that.
    rewrite(&own, |sweeps, event| {
        replaced(
            &event.content,
            event.hash.as_bytes(),
            sweeps.hash.as_bytes(),
        )
    });
    meet_foreign(&own, "nothing");

    let own = temp_domain();
    let _hostile = Hostile::new(&own);
    // A type whose name clears a terminal.
    rewrite(&own, |sweeps, _| {
        replaced(&sweeps.content, b"sweepd.Preamble", b"sweepd\\u001B[2J")
    });
    let error = Client::within(&own.domain(), "roof")
        .unwrap()
        .next(Duration::ZERO)
        .unwrap_err();
    assert!(
        matches!(
            error,
            ClientError::Subscribe(SubscribeError::Foreign { .. })
        ),
        "{error}"
    );
    assert!(!error.to_string().contains(char::is_control), "{error:?}");
}

/// A daemon that was built with another iceoryx2.
#[test]
fn a_service_of_another_iceoryx2_is_refused_with_the_cure_until_this_one_comes() {
    let own = temp_domain();
    let hostile = Hostile::new(&own);
    rewrite(&own, |sweeps, _| {
        replaced(&sweeps.content, b"minor = 10\n", b"minor = 99\n")
    });
    let mut client = Client::within(&own.domain(), "roof").unwrap();
    let error = client.next(Duration::ZERO).unwrap_err();
    assert!(
        matches!(
            error,
            ClientError::Subscribe(SubscribeError::OtherIceoryx { .. })
        ),
        "{error:?}"
    );
    let said = error.to_string();
    assert!(
        said.contains("`roof`") && said.contains("build it with the version of sweepd"),
        "{said}"
    );
    drop(hostile);
    comes_back(&own, &mut client);
}

/// iceoryx2 opens a service that is aligned to more than what is asked for; its bytes are as far
/// apart as ever.
#[test]
fn a_service_that_is_aligned_to_more_is_read() {
    let own = temp_domain();
    let hostile = Hostile::aligned(&own, 128);
    let mut client = client(&own);
    hostile.send(&honest(4), &honest_preamble());
    let sweep = client.next(SOON).unwrap().received().unwrap();
    assert_eq!(sweep.bytes(), honest(4));
    assert_eq!(ask_all(&sweep.view().unwrap()), COLUMNS * SHAPE.rows * 2);
}

/// The publisher goes on writing into what it has sent: what was copied and checked once is what
/// counts.
#[test]
fn a_header_that_changes_while_it_is_read_changes_nothing() {
    let own = temp_domain();
    let hostile = Hostile::new(&own);
    let mut client = client(&own);
    let over = AtomicBool::new(false);
    let over = &over;
    let place = hostile.send(&honest(0), &honest_preamble());
    let file = File::options().write(true).open(&place.0).unwrap();
    drop(client.next(SOON).unwrap().received());
    let (mut taken, mut refused, mut changed) = (0, 0, 0);
    std::thread::scope(|scope| {
        let _ends = Ends(over);
        scope.spawn(|| scribble(&file, place.1, over));
        // How often the two threads meet depends on the machine: on until they did often enough.
        for sequence in 1..100_000 {
            if sequence > 400 && refused + changed > 20 && changed > 0 {
                break;
            }
            hostile.send(&honest(sequence), &honest_preamble());
            match client.next(SOON) {
                Ok(sweep) => {
                    changed += usize::from(hold(&sweep.received().unwrap()));
                    taken += 1;
                }
                Err(ClientError::Layout { .. }) => refused += 1,
                Err(other) => panic!("{other}"),
            }
        }
    });
    let is_enough = taken > 20 && refused + changed > 20 && changed > 0;
    assert!(
        is_enough,
        "{taken} taken, {refused} refused, {changed} changed while held"
    );
}

/// Ends the other thread, however this one ends.
struct Ends<'a>(&'a AtomicBool);

impl Drop for Ends<'_> {
    fn drop(&mut self) {
        self.0.store(true, Ordering::Relaxed);
    }
}

/// Writes sound and senseless headers over the places of the samples near a known one, as a process
/// of the same user can.
fn scribble(file: &File, at: u64, over: &AtomicBool) {
    let mut other = Header::new(&SHAPE);
    (other.rows, other.columns, other.columns_capacity) = (u32::MAX, u32::MAX, u32::MAX);
    (other.segments, other.margin_columns, other.flags) = (u32::MAX, u32::MAX, u32::MAX);
    other.offsets = [u64::MAX; 10];
    let sound = honest(1);
    while !over.load(Ordering::Relaxed) {
        for bytes in [other.as_bytes(), &sound[..size_of::<Header>()]] {
            file.write_all_at(bytes, at).unwrap();
            for _ in 0..200 {
                std::hint::spin_loop();
            }
        }
    }
}

/// Asks all of a sweep that is being written over; whether its header was changed meanwhile.
fn hold(sweep: &Sweep) -> bool {
    let mut was_changed = false;
    for _ in 0..3 {
        let view = sweep.view().expect("what was taken stays taken");
        assert_eq!(
            (
                view.header.columns as usize,
                view.columns.len(),
                view.rows()
            ),
            (COLUMNS, COLUMNS, SHAPE.rows)
        );
        assert_eq!(
            (view.range.len(), view.segments.len()),
            (COLUMNS * SHAPE.rows, 1)
        );
        assert_eq!(ask_all(&view), COLUMNS * SHAPE.rows * 2);
        was_changed |= sweep.bytes()[..size_of::<Header>()] != *view.header.as_bytes();
    }
    was_changed
}

/// A client that was refused gets the sweeps of the daemon that comes afterwards.
#[test]
fn a_refused_consumer_continues_when_the_daemon_comes() {
    let own = temp_domain();
    let hostile = Hostile::new(&own);
    let mut client = client(&own);
    hostile.send(b"no sweep at all", &preamble(LAYOUT_VERSION, 15));
    assert!(client.next(SOON).is_err());
    drop(hostile);
    comes_back(&own, &mut client);
}

/// The last rest of a wait may be less than a microsecond, in which a socket is told its timeout:
/// none at all would be for ever.
#[test]
fn a_wait_ends_however_short_it_is() {
    let own = temp_domain();
    let _loans = loans(&own);
    let mut client = client(&own);
    let (ended, is_ended) = mpsc::channel();
    std::thread::spawn(move || {
        for ns in (0..40_000).step_by(100) {
            assert!(
                client
                    .next(Duration::from_nanos(ns))
                    .unwrap()
                    .received()
                    .is_none()
            );
        }
        ended.send(()).unwrap();
    });
    is_ended.recv_timeout(SOON).expect("every wait ends");
}

/// `sweepd watch` with all of its outputs.
#[test]
fn watch_shows_or_refuses_any_bytes() {
    let folder = folder("watch_hostile");
    for Case {
        name,
        bytes,
        preamble,
        fate,
    } in cases()
    {
        // The others are refused before anything is shown; one of them is enough.
        if fate != Fate::Taken && name != "noise" && name != "another mark" {
            continue;
        }
        let own = temp_domain();
        let hostile = Hostile::new(&own);
        let mut watch = Command::new(env!("CARGO_BIN_EXE_sweepd"));
        watch
            .args(["watch", "roof", "--sweeps", "2", "--latency", "--root"])
            .arg(own.root());
        watch
            .arg("--force")
            .arg("--csv")
            .arg(&folder)
            .arg("--png")
            .arg(&folder)
            .arg("--pcd")
            .arg(&folder);
        let mut child = watch
            .stdout(Stdio::null())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        let begun = Instant::now();
        while child.try_wait().unwrap().is_none() {
            hostile.send(&bytes, &preamble);
            std::thread::sleep(Duration::from_millis(5));
            assert!(begun.elapsed() < SOON, "{name}: it does not end");
        }
        let output = child.wait_with_output().unwrap();
        let said = String::from_utf8_lossy(&output.stderr);
        let is_refused =
            output.status.code() == Some(1) && said.lines().any(|line| line.starts_with("error: "));
        assert!(
            output.status.success() || is_refused,
            "{name}: {}: {said}",
            output.status
        );
        assert!(
            !said.chars().any(|one| one.is_control() && one != '\n'),
            "{name}: {said:?}"
        );
    }
}

fn refusing(own: &TempDomain) -> Talk {
    check(&["refuse".as_ref(), "roof".as_ref(), own.root().as_ref()])
}

#[test]
#[cfg_attr(without_python, ignore = "no SWEEPD_PYTHON")]
fn python_accepts_or_refuses_any_bytes() {
    let own = temp_domain();
    let hostile = Hostile::new(&own);
    let mut python = refusing(&own);
    // To be there from the first on.
    assert!(python.ask("look")["sweep"].is_null());
    for Case {
        name,
        bytes,
        preamble,
        fate,
    } in cases()
    {
        let (file, at) = hostile.send(&bytes, &preamble);
        let said = python.ask("next");
        match fate {
            Fate::Taken => {
                assert!(said["sweep"].is_u64(), "{name}: {said}");
                // Whoever published it writes on.
                File::options()
                    .write(true)
                    .open(file)
                    .unwrap()
                    .write_all_at(&[0xA5; 448], at)
                    .unwrap();
                let said = python.ask("use");
                assert_eq!(said["rows"], SHAPE.rows, "{name}: {said}");
            }
            Fate::Refused(words) => {
                let is_told = said["refused"]
                    .as_str()
                    .is_some_and(|said| said.contains(words));
                assert!(is_told && said["layout"] == true, "{name}: {said}");
            }
        }
    }
    assert!(python.end().success());
}

/// The header for C and C++, with every access watched.
#[test]
#[cfg_attr(without_compilers, ignore = "no compilers")]
fn cpp_accepts_or_refuses_any_file() {
    let folder = folder("hostile");
    let program = folder.join("layout");
    let sanitizers = ["-fsanitize=address,undefined", "-fno-sanitize-recover=all"];
    let mut command = Command::new("c++");
    command
        .args(["-x", "c++", "-std=c++11", "-O1", "-g", "-I"])
        .arg(of_project("examples"))
        .arg(of_project("tests/slow/consumers/layout.c"))
        .args(sanitizers);
    let compiled = command.arg("-o").arg(&program).arg("-lm").output().unwrap();
    assert!(
        compiled.status.success(),
        "{}",
        String::from_utf8_lossy(&compiled.stderr)
    );
    for Case {
        name,
        bytes,
        preamble,
        fate,
    } in cases()
    {
        // What stands before the bytes is iceoryx2's, and not in a file.
        if preamble != self::preamble(LAYOUT_VERSION, bytes.len() as u64) {
            continue;
        }
        let file = folder.join("sweep");
        std::fs::write(&file, &bytes).unwrap();
        let (status, said) = run(&program, &["points".as_ref(), &file]);
        let expected = match fate {
            Fate::Taken => Some(0),
            Fate::Refused(_) => Some(3),
        };
        assert_eq!(status, expected, "{name}: {said}");
    }
    for case in objects::cases().iter().filter(|case| case.is_whole()) {
        let file = folder.join("message");
        std::fs::write(&file, &case.bytes).unwrap();
        let (status, said) = run(&program, &["objects".as_ref(), &file]);
        let expected = if case.refusal.is_some() { 3 } else { 0 };
        assert_eq!(status, Some(expected), "{}: {said}", case.name);
    }
}

fn run(program: &Path, args: &[&Path]) -> (Option<i32>, String) {
    let mut command = Command::new(program);
    // It keeps the file to its end.
    command.env("ASAN_OPTIONS", "detect_leaks=0");
    let output = command.args(args).output().unwrap();
    (
        output.status.code(),
        String::from_utf8_lossy(&output.stderr)
            .chars()
            .take(600)
            .collect(),
    )
}
