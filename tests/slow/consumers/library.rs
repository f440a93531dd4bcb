//! libsweepd in a program in C, against the client in Rust: the same bytes in the same place, the
//! same counts, the same words.

use std::ffi::OsStr;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::OnceLock;
use std::time::Duration;

use serde_json::{Value, json};
use sweepd::client::{Client, Next};
use sweepd::publish::Preamble;
use sweepd::sweep::layout::LAYOUT_VERSION;

use super::hostile::{Case, Fate, Hostile, cases, node, schema, service_name};
use super::python::{Talk, loans, mapped, publish};
use super::sweeps::Source;
use super::{folder, objects};
use sweepd_testkit::{
    PATIENCE, TempDomain,
    library::{c_program, compile},
    temp_domain,
};

const SOON: Duration = PATIENCE;
const SOON_MS: u64 = SOON.as_millis() as u64;
const RECEIVED: i64 = 0;
const TIMEOUT: i64 = 1;
const UNPUBLISHED: i64 = 2;
const INVALID: i64 = 4;
const FAILED: i64 = 5;

pub fn program() -> &'static Path {
    static PROGRAM: OnceLock<PathBuf> = OnceLock::new();
    PROGRAM.get_or_init(|| c_program(&folder("library")))
}

/// The program, which writes bytes into this folder.
fn talk(own: &TempDomain, name: &str, folder: &Path, more: &[&OsStr]) -> Talk {
    let args = [
        OsStr::new("talk"),
        name.as_ref(),
        own.root().as_os_str(),
        folder.as_os_str(),
    ];
    Talk::start(program().as_os_str(), &[&args, more].concat())
}

fn next(c: &mut Talk, limit_ms: u64) -> Value {
    c.ask(&format!("next {limit_ms}"))
}

#[test]
#[cfg_attr(without_compilers, ignore = "no compilers")]
fn c_gets_the_bytes_where_the_decoder_wrote_them_and_counts_as_rust_does() {
    let (own, folder) = (temp_domain(), folder("library_bytes"));
    let mut c = talk(&own, "roof", &folder, &[]);
    let mut client = Client::within(&own.domain(), "roof").unwrap();
    assert_eq!(next(&mut c, 0)["next"], UNPUBLISHED);
    let mut loans = loans(&own);
    let mut said = next(&mut c, 0);
    // The memory is there with the first sweep.
    assert_eq!(
        (&said["next"], &said["connected"], &said["model"]),
        (&json!(UNPUBLISHED), &json!(1), &json!("VLP-16"))
    );
    assert!(client.next(Duration::ZERO).unwrap().received().is_none());
    // Of seven that come at once, both get two.
    (1..8).for_each(|sequence| publish(&mut loans, sequence));
    for missed in [0, 0] {
        said = next(&mut c, SOON_MS);
        client.next(SOON).unwrap().received().unwrap();
        assert_eq!(
            (&said["next"], &said["missed"]),
            (&json!(RECEIVED), &json!(missed))
        );
    }
    (8..15).for_each(|sequence| publish(&mut loans, sequence));
    said = next(&mut c, SOON_MS);
    client.next(SOON).unwrap().received().unwrap();
    assert_eq!((&said["missed"], &said["waits"]), (&json!(5), &json!(1)));
    assert_eq!(client.missed(), 5);
    assert_eq!(next(&mut c, SOON_MS)["waits"], 0);
    assert_eq!(next(&mut c, 1)["next"], TIMEOUT);
    client.next(SOON).unwrap().received().unwrap();
    let mut sweeps = 0;
    Source::StreetVlp16Dual.play(loans, |slot| {
        let written = slot.as_ref().to_vec();
        let (file, offset) = mapped(slot.as_ref());
        slot.publish().unwrap();
        let said = next(&mut c, SOON_MS);
        let sweep = client.next(SOON).unwrap().received().unwrap();
        assert_eq!(said["next"], RECEIVED, "{said}");
        assert!(file.starts_with("/dev/shm/"), "{file}");
        let place = (&said["file"], &said["offset"], &said["access"]);
        assert_eq!(
            place,
            (&json!(file), &json!(offset), &json!("r--s")),
            "not a copy"
        );
        let read = std::fs::read(folder.join("bytes")).unwrap();
        assert!(read == written && read == sweep.bytes());
        sweeps += 1;
    });
    assert!(sweeps >= 3);
    assert_eq!(c.ask("sensors"), json!({"length": 4, "sensors": "roof"}));
    assert!(c.end().success());
}

#[test]
#[cfg_attr(without_compilers, ignore = "no compilers")]
fn c_gets_objects() {
    let (own, folder) = (temp_domain(), folder("library_objects"));
    let mut c = talk(&own, "roof", &folder, &["objects".as_ref()]);
    let mut loans = objects::loans(&own);
    assert_eq!(next(&mut c, 0)["next"], TIMEOUT);
    for words in objects::messages() {
        let message = objects::message(&words);
        assert_eq!(objects::publish(&mut loans, message), 1);
        let said = next(&mut c, SOON_MS);
        assert_eq!(
            (&said["next"], &said["missed"]),
            (&json!(RECEIVED), &json!(0))
        );
        assert!(std::fs::read(folder.join("bytes")).unwrap() == message);
    }
    assert!(c.end().success());
}

/// As Python's collector of garbage does: a sweep goes after its client, on another thread.
#[test]
#[cfg_attr(without_compilers, ignore = "no compilers")]
fn what_c_holds_stays_when_its_client_is_gone_and_is_released_on_any_thread() {
    let (own, folder) = (temp_domain(), folder("library_held"));
    let mut loans = loans(&own);
    for _ in 0..4 {
        let mut c = talk(&own, "roof", &folder, &[]);
        // With its client, the place of a consumer is free again within a second.
        while next(&mut c, 20)["connected"] != 1 {}
        let mut client = Client::within(&own.domain(), "roof").unwrap();
        while !client.is_connected() {
            client.next(Duration::from_millis(20)).unwrap();
        }
        let mut rust = Vec::new();
        for sequence in 1..3 {
            publish(&mut loans, sequence);
            assert_eq!(c.ask(&format!("hold {SOON_MS}"))["next"], RECEIVED);
            rust.push(client.next(SOON).unwrap().received().unwrap());
        }
        publish(&mut loans, 3);
        let said = c.ask("hold 0");
        let error = client.next(Duration::ZERO).unwrap_err().to_string();
        assert_eq!(
            (&said["next"], &said["error"]),
            (&json!(FAILED), &json!(error))
        );
        assert!(error.contains("holds 2 sweeps"), "{error}");
        (4..40).for_each(|sequence| publish(&mut loans, sequence));
        assert_eq!(c.ask("leave"), json!({"held": 2, "same": 1}));
        assert!(c.end().success());
    }
}

#[test]
#[cfg_attr(without_compilers, ignore = "no compilers")]
fn a_child_after_fork_leaves_its_parent_what_that_holds() {
    let (own, folder) = (temp_domain(), folder("library_fork"));
    let mut loans = loans(&own);
    let mut c = talk(&own, "roof", &folder, &[]);
    while next(&mut c, 20)["connected"] != 1 {}
    for sequence in 1..3 {
        publish(&mut loans, sequence);
        assert_eq!(c.ask(&format!("hold {SOON_MS}"))["next"], RECEIVED);
    }
    // A child's own client waits; enough sweeps to reuse whatever a child gave back.
    assert_eq!(c.ask("fork")["next"], TIMEOUT);
    (3..60).for_each(|sequence| publish(&mut loans, sequence));
    assert_eq!(c.json(), json!({"failed": 0, "held": 2, "same": 1}));
    assert_eq!(next(&mut c, SOON_MS)["next"], RECEIVED);
    assert!(c.end().success());
}

#[test]
#[cfg_attr(without_compilers, ignore = "no compilers")]
fn c_refuses_any_bytes_in_the_words_of_rust() {
    let (own, folder) = (temp_domain(), folder("library_hostile"));
    let hostile = Hostile::new(&own);
    let mut c = talk(&own, "roof", &folder, &[]);
    let mut client = Client::within(&own.domain(), "roof").unwrap();
    assert_eq!(next(&mut c, 0)["connected"], 1);
    assert!(client.next(Duration::ZERO).unwrap().received().is_none());
    for Case {
        name,
        bytes,
        preamble,
        fate,
    } in cases()
    {
        hostile.send(&bytes, &preamble);
        let said = next(&mut c, SOON_MS);
        match (client.next(SOON), fate) {
            (Ok(Next::Received(sweep)), Fate::Taken) => {
                assert_eq!(said["next"], RECEIVED, "{name}: {said}");
                assert!(std::fs::read(folder.join("bytes")).unwrap() == sweep.bytes());
            }
            (Err(error), Fate::Refused(_)) => {
                let expected = (&json!(INVALID), &json!(error.to_string()));
                assert_eq!((&said["next"], &said["error"]), expected, "{name}");
            }
            (other, _) => panic!("{name}: {:?}", other.map(|_| "a sweep or nothing")),
        }
    }
    assert!(c.end().success());
}

/// Then the loop is entered again. Stopped and continued, it goes on.
#[test]
#[cfg_attr(without_compilers, ignore = "no compilers")]
fn a_loop_in_cpp_ends_with_invalid_bytes_alone() {
    let (own, program) = (temp_domain(), folder("library_loop").join("loop"));
    let source = super::of_project("tests/slow/consumers/loop.cpp");
    compile("c++", &["-std=c++17"], &source, &program);
    let hostile = Hostile::new(&own);
    let c = Talk::start(program.as_os_str(), &[own.root().as_os_str()]);
    assert_eq!(c.line(), "there");
    let mut client = Client::within(&own.domain(), "roof").unwrap();
    assert!(client.next(Duration::ZERO).unwrap().received().is_none());
    for case in cases() {
        hostile.send(&case.bytes, &case.preamble);
        let expected = match client.next(SOON) {
            Ok(_) => "taken".to_owned(),
            Err(error) => error.to_string(),
        };
        c.stop_and_continue();
        assert_eq!(c.line(), expected, "{}", case.name);
    }
}

#[test]
#[cfg_attr(without_compilers, ignore = "no compilers")]
fn c_fails_in_the_words_of_rust() {
    let (own, folder) = (temp_domain(), folder("library_words"));
    for name in ["", &"x".repeat(300)] {
        let said = talk(&own, name, &folder, &[]).json();
        let error = Client::within(&own.domain(), name).unwrap_err().to_string();
        assert_eq!((&said["next"], &said["error"]), (&json!(-1), &json!(error)));
    }
    let node = node(&own);
    let samples = node.service_builder(&service_name());
    let samples = samples
        .publish_subscribe::<[u8]>()
        .user_header::<Preamble>();
    let version = (LAYOUT_VERSION + 1).to_string();
    let _other = samples.create_with_attributes(&schema(&version)).unwrap();
    let _event = node.service_builder(&service_name()).event().create();
    let said = next(&mut talk(&own, "roof", &folder, &[]), 0);
    let mut client = Client::within(&own.domain(), "roof").unwrap();
    let error = client.next(Duration::ZERO).unwrap_err().to_string();
    assert!(
        error.contains(&format!("layout version {version}")),
        "{error}"
    );
    assert_eq!(
        (&said["next"], &said["error"]),
        (&json!(FAILED), &json!(error))
    );
}

#[test]
#[cfg_attr(without_compilers, ignore = "no compilers")]
fn c_may_make_mistakes() {
    let output = Command::new(program()).arg("wrong").output().unwrap();
    assert!(output.status.success(), "{output:?}");
}

/// The number in the name for the loader is that of the header.
#[test]
#[cfg_attr(without_compilers, ignore = "no compilers")]
fn the_loader_asks_for_the_abi_version_of_the_header() {
    let mut readelf = Command::new("readelf");
    let library = sweepd_testkit::library::library().join("libsweepd.so");
    let output = readelf.arg("-d").arg(library).output().unwrap();
    let said = String::from_utf8(output.stdout).unwrap();
    let header = std::fs::read_to_string(super::of_project("examples/sweepd.h")).unwrap();
    let (_, version) = header.split_once("#define SWEEPD_ABI_VERSION ").unwrap();
    let (version, _) = version.split_once('u').unwrap();
    assert!(
        said.contains(&format!("[libsweepd.so.{version}]")),
        "{said}"
    );
}

/// The symbols of the library are the functions of the header, and no others: two libraries with
/// iceoryx2 in one program do not meet.
#[test]
#[cfg_attr(without_compilers, ignore = "no compilers")]
fn the_library_has_the_functions_of_the_header_alone() {
    let library = sweepd_testkit::library::library().join("libsweepd.so");
    let mut nm = Command::new("nm");
    let output = nm.args(["-D", "--defined-only"]).arg(library).output();
    let said = String::from_utf8(output.unwrap().stdout).unwrap();
    let mut symbols: Vec<&str> = said
        .lines()
        .filter_map(|line| line.rsplit(' ').next())
        .collect();
    symbols.sort_unstable();
    let header = std::fs::read_to_string(super::of_project("examples/sweepd.h")).unwrap();
    let (_, receiving) = header.split_once("---- Receiving").unwrap();
    let declared = receiving.lines().filter(|line| line.ends_with(");"));
    let mut declared: Vec<&str> = declared
        .filter_map(|line| line.split_once('(')?.0.rsplit([' ', '*']).next())
        .collect();
    declared.sort_unstable();
    assert_eq!(symbols, declared);
}
