//! Objects while the head turns: what other languages read of the messages that Rust wrote, and what
//! they refuse.

use std::ffi::OsStr;
use std::time::{Duration, SystemTime};

use serde_json::{Value, json};
use sweepd::buffers::{Buffers, HeapBuffers, Memory};
use sweepd::client::{Client, ClientError, Next, ObjectsRef};
use sweepd::pipeline::{Config, Event, Pipeline};
use sweepd::publish::{Loans, Preamble, ServiceSettings, Topic};
use sweepd::sensor::Model;
use sweepd::sweep::layout::{LAYOUT_VERSION, LayoutError, TimeSource};
use sweepd::sweep::objects::{self, MESSAGE_BYTES, Object, ObjectsHeader, Sending, flags, why};
use sweepd::wire::data::ReturnMode;
use sweepd_lab::simulate::{Emitter, EmitterConfig, fixtures};
use zerocopy::{FromBytes, FromZeros, IntoBytes};

use super::folder;
use super::hostile::{Hostile, preamble};
use super::native::{Fault, compare_refusals, programs, run};
use super::python::{Talk, check};
use sweepd_testkit::{PATIENCE, TempDomain, temp_domain};

const SOON: Duration = PATIENCE;

/// Each message about a street, aligned as in shared memory, its header, and what it tells.
pub fn messages() -> Vec<Vec<u64>> {
    let sending = Sending {
        name: "roof",
        run_ns: 5,
        sent_ns: 6,
        sent_monotonic_ns: 7,
        position_m: [1.0, -2.0, 3.0],
        angles_rad: [0.4, -0.2, 0.3],
    };
    let scene = fixtures::scene();
    let sensor = EmitterConfig::new(Model::Vlp16, ReturnMode::Strongest).turns(3.0);
    let mut pipeline = Pipeline::new("192.168.1.201:2368", Config::default()).unwrap();
    pipeline.find_objects(true);
    let mut memory = Memory::new(HeapBuffers::default());
    let mut messages = Vec::new();
    for sent in Emitter::new(sensor, &scene).untold() {
        pipeline.push(&sent.datagram().parse().unwrap());
        pipeline.idle(None);
        while let Some(event) = pipeline.poll(&mut memory) {
            if let Event::Objects(found) = event {
                objects::write(&found, &sending, |message| messages.push(aligned(message)));
            }
        }
    }
    messages
}

/// A message may end in the middle of a word: then a label that is not counted is behind it.
fn aligned(message: &[u8]) -> Vec<u64> {
    let mut words = vec![0; message.len().div_ceil(8)];
    words.as_mut_bytes()[..message.len()].copy_from_slice(message);
    words
}

/// The message in these words, without what is not counted.
pub fn message(words: &[u64]) -> &[u8] {
    let (header, _) = ObjectsHeader::ref_from_prefix(words.as_bytes()).unwrap();
    let counted = 192 + 96 * header.objects as usize + 4 * header.labels as usize;
    &words.as_bytes()[..counted]
}

pub fn view<'a>(message: &'a [u8]) -> ObjectsRef<'a> {
    let (header, _) = ObjectsHeader::ref_from_prefix(message).unwrap();
    ObjectsRef::with_header(header, message).unwrap()
}

/// The boxes of its objects in the frame of the robot.
fn boxes(view: &ObjectsRef<'_>) -> Vec<f64> {
    let mount = view.header.mount();
    let boxes = view.objects.iter();
    let boxes = boxes.map(|object| mount.bounds(object.segment.min_m, object.segment.max_m));
    boxes.flatten().flatten().collect()
}

#[track_caller]
fn assert_close(found: &[f64], expected: &[f64]) {
    assert_eq!(found.len(), expected.len());
    let mut pairs = found.iter().zip(expected);
    assert!(pairs.all(|(found, expected)| (found - expected).abs() < 1e-9));
}

/// The tests below would be worth little without these.
#[test]
fn the_messages_have_all_that_a_consumer_meets() {
    let messages = messages();
    let views: Vec<_> = messages.iter().map(|words| view(message(words))).collect();
    let objects = || views.iter().flat_map(|view| view.objects);
    for of in [why::COMPLETE, why::SWEEP, why::SEAM] {
        assert!(objects().any(|object| object.why == of), "{of}");
    }
    assert!(objects().any(|object| object.first_ns < 0));
    let last = views.iter().filter(|view| !view.labels.is_empty());
    assert!(last.count() >= 2);
    assert!(views.iter().any(|view| view.header.first_ordinal > 0));
}

#[test]
#[cfg_attr(without_compilers, ignore = "no compilers")]
fn c_reads_the_objects_that_rust_wrote() {
    let programs = programs("objects");
    let file = folder("objects_of").join("message");
    for words in messages() {
        let bytes = message(&words);
        std::fs::write(&file, bytes).unwrap();
        for (language, program) in &programs {
            let said = run(program, &["objects".as_ref(), &file]);
            let (read, of_boxes) = said.split_at(bytes.len());
            assert!(read == bytes, "{language}");
            let found = of_boxes.as_chunks().0.iter();
            let found: Vec<f64> = found.map(|bytes| f64::from_le_bytes(*bytes)).collect();
            assert_close(&found, &boxes(&view(bytes)));
        }
    }
}

#[test]
#[cfg_attr(without_compilers, ignore = "no compilers")]
fn c_refuses_of_objects_what_rust_refuses() {
    let words = honest();
    let bytes = words.as_bytes();
    let old = |at: usize| u32::from_le_bytes(bytes[at..at + 4].try_into().unwrap());
    let len = bytes.len();
    let fault = |at, value| Fault {
        at,
        value,
        len,
        shift: 0,
    };
    let mut faults = Vec::new();
    for at in (0..192).step_by(4) {
        let near = [0, 1, 2, 3].map(|more| old(at).wrapping_add(more));
        let far = [0, 1 << 20, 1 << 28, u32::MAX / 96, u32::MAX];
        faults.extend(near.into_iter().chain(far).map(|value| fault(at, value)));
    }
    faults.extend([0, 7, 191, 192, len - 1].map(|len| Fault {
        len,
        ..fault(8, old(8))
    }));
    faults.extend([8, 64].map(|shift| Fault {
        shift,
        ..fault(8, old(8))
    }));
    compare_refusals("check_objects", bytes, &faults, &[0, 1, 2], |bytes| {
        let (header, _) = ObjectsHeader::read_from_prefix(bytes)
            .map_err(|_| LayoutError::Bytes { bytes: bytes.len() })?;
        ObjectsRef::with_header(&header, bytes).map(|_| ())
    });
}

/// The service of a sensor's objects.
pub fn loans(own: &TempDomain) -> Loans {
    let settings = ServiceSettings {
        name: "roof".to_owned(),
        topic: Topic::Objects,
        max_consumers: 2,
        ..ServiceSettings::default()
    };
    let mut loans = Loans::create(&own.domain(), &settings).unwrap();
    loans.reserve(MESSAGE_BYTES).unwrap();
    loans
}

/// Sends a message, and gives the number of its consumers.
pub fn publish(loans: &mut Loans, message: &[u8]) -> usize {
    let mut slot = loans.take(message.len());
    slot.as_mut().copy_from_slice(message);
    slot.publish().unwrap()
}

fn of_roof(command: &str, own: &TempDomain, more: &[&str]) -> Talk {
    let root = own.root().as_os_str();
    let args: [&OsStr; 3] = [command.as_ref(), "roof".as_ref(), root];
    let more: Vec<&OsStr> = more.iter().map(OsStr::new).collect();
    check(&[&args[..], &more].concat())
}

#[test]
#[cfg_attr(without_python, ignore = "no SWEEPD_PYTHON")]
fn python_reads_the_objects_that_rust_wrote() {
    let own = temp_domain();
    let mut loans = loans(&own);
    let mut python = of_roof("objects", &own, &[]);
    assert_eq!(python.json()["ready"], true);
    for words in messages() {
        let bytes = message(&words);
        let view = view(bytes);
        assert_eq!(publish(&mut loans, bytes), 1);
        let said = python.ask("20");
        let hex: String = bytes.iter().map(|byte| format!("{byte:02x}")).collect();
        assert_eq!(said["bytes"], hex);
        let header = view.header;
        let is_last = header.flags & flags::LAST != 0;
        assert_eq!(
            (&said["message"], &said["name"], &said["last"]),
            (&header.sequence.into(), &"roof".into(), &is_last.into())
        );
        let rows = view.objects.iter().map(Object::is_segment);
        assert_eq!(said["rows"], json!(rows.collect::<Vec<_>>()));
        let when = view.objects.iter().map(|object| i64::from(object.last_ns));
        let when: Vec<i64> = when.map(|after_ns| header.time_ns + after_ns).collect();
        assert_eq!(
            (&said["when"], &said["read_only"]),
            (&json!(when), &true.into())
        );
        let expected = boxes(&view);
        assert_close(&flat(&said["boxes"]), &expected);
        let own = view
            .objects
            .iter()
            .flat_map(|it| [it.segment.min_m, it.segment.max_m]);
        let own: Vec<f64> = own.flatten().map(f64::from).collect();
        assert_close(&flat(&said["own"]), &own);
        // Forward is x, right is minus y.
        let turned = |of: &[f64; 6]| [of[1], -of[3], of[2], of[4], -of[0], of[5]];
        let ros: Vec<f64> = expected.as_chunks().0.iter().flat_map(turned).collect();
        assert_close(&flat(&said["ros"]), &ros);
    }
    assert!(python.end().success());
}

/// The numbers of a list of lists.
fn flat(value: &Value) -> Vec<f64> {
    match value {
        Value::Array(values) => values.iter().flat_map(flat).collect(),
        number => vec![number.as_f64().unwrap()],
    }
}

/// A message of now in which nothing is wrong: three objects and their labels. The box of `stop` has
/// a part and an object, and beside it there is another one.
pub fn honest() -> Vec<u64> {
    let now_ns = SystemTime::UNIX_EPOCH.elapsed().unwrap().as_nanos() as i64;
    let object = |ordinal: u32| {
        let mut object = Object::new_zeroed();
        (object.ordinal, object.last_ns) = (ordinal, 1000 * ordinal as i32);
        object.why = [why::WIDE, why::COMPLETE, why::SEAM][ordinal as usize];
        object.segment.points = [21, 20, 22][ordinal as usize];
        object.segment.nearest_m = 2.5 + ordinal as f32;
        // Ahead of the sensor, which looks to the left of the robot.
        let at_m = 2.5 + ordinal as f32;
        (object.segment.min_m, object.segment.max_m) = ([-0.5, at_m, -1.0], [0.5, at_m + 0.5, 0.0]);
        object
    };
    let told = objects::NewObjects {
        sequence: 7,
        time_ns: now_ns,
        time_source: TimeSource::Host as u32,
        flags: flags::LAST,
        height_m: 1.5,
        first_ordinal: 0,
        objects: &[0, 1, 2].map(object),
        labels: &[2, 0, 3, 4],
    };
    let sending = Sending {
        name: "roof",
        run_ns: 5,
        sent_ns: now_ns,
        sent_monotonic_ns: 7,
        position_m: [3.0, 2.0, 1.5],
        angles_rad: [std::f32::consts::FRAC_PI_2, 0.0, 0.0],
    };
    let mut message = Vec::new();
    objects::write(&told, &sending, |bytes| message = aligned(bytes));
    message
}

/// What may come under the name of a sensor's objects, and the words of its refusal; without words
/// it is taken.
pub struct Case {
    pub name: &'static str,
    pub bytes: Vec<u8>,
    preamble: Preamble,
    pub refusal: Option<&'static str>,
}

const VERSION: &str = "this program reads version 1";

pub fn cases() -> Vec<Case> {
    type Change = fn(&mut ObjectsHeader);
    let heads: [(_, _, Change); 13] = [
        ("honest", None, |_| {}),
        ("other magic bytes", Some("magic"), |it| {
            it.magic = *b"sweepd\r\n"
        }),
        ("zeros", Some("magic"), |it| it.as_mut_bytes().fill(0)),
        ("ones", Some("magic"), |it| it.as_mut_bytes().fill(0xFF)),
        ("an older version", Some(VERSION), |it| it.version = 0),
        ("a newer version", Some(VERSION), |it| it.version = 2),
        ("an object more", Some("cannot hold"), |it| it.objects += 1),
        ("a label more", Some("cannot hold"), |it| it.labels += 1),
        ("objects without end", Some("cannot hold"), |it| {
            it.objects = u32::MAX
        }),
        ("labels without end", Some("cannot hold"), |it| {
            it.labels = u32::MAX
        }),
        ("none", None, |it| (it.objects, it.labels) = (0, 0)),
        ("numbers at their ends", None, |it| {
            (it.sequence, it.time_ns, it.sent_ns) = (u64::MAX, i64::MAX, i64::MIN);
            (it.flags, it.first_ordinal, it.first_label) = (u32::MAX, u32::MAX, u32::MAX);
            (it.position_m, it.yaw_rad) = ([f32::NAN; 3], f32::INFINITY);
        }),
        ("a name that is no text", None, |it| it.name = [0x1B; 64]),
    ];
    let all = honest().as_bytes().to_vec();
    let heads = heads.map(|(name, refusal, change)| {
        let mut bytes = all.clone();
        change(ObjectsHeader::mut_from_prefix(&mut bytes).unwrap().0);
        let preamble = preamble(LAYOUT_VERSION, bytes.len() as u64);
        Case {
            name,
            bytes,
            preamble,
            refusal,
        }
    });
    let whole = all.len() as u64;
    let lengths = [
        ("torn", all.len() - 4, LAYOUT_VERSION, whole, "torn"),
        ("a byte", 1, LAYOUT_VERSION, 1, "cannot hold"),
        ("part of a header", 191, LAYOUT_VERSION, 191, "cannot hold"),
        ("a header alone", 192, LAYOUT_VERSION, 192, "cannot hold"),
        (
            "shorter",
            all.len() - 1,
            LAYOUT_VERSION,
            whole - 1,
            "cannot hold",
        ),
        ("none named", all.len(), LAYOUT_VERSION, 0, "cannot hold"),
        ("an older preamble", all.len(), 2, whole, "reads version 3"),
    ];
    let lengths = lengths.map(|(name, len, version, named, refusal)| Case {
        name,
        bytes: all[..len].to_vec(),
        preamble: preamble(version, named),
        refusal: Some(refusal),
    });
    let filled = [0xFF, 0x7F, 0x80].map(|byte| {
        let mut bytes = all.clone();
        bytes[size_of::<ObjectsHeader>()..].fill(byte);
        Case {
            name: "filled",
            bytes,
            preamble: preamble(LAYOUT_VERSION, whole),
            refusal: None,
        }
    });
    heads.into_iter().chain(lengths).chain(filled).collect()
}

impl Case {
    /// Whether a file with its bytes is the same: what stands before them is iceoryx2's.
    pub fn is_whole(&self) -> bool {
        self.preamble == preamble(LAYOUT_VERSION, self.bytes.len() as u64)
    }
}

#[test]
#[cfg_attr(without_python, ignore = "no SWEEPD_PYTHON")]
fn rust_and_python_take_or_refuse_any_objects() {
    let own = temp_domain();
    let hostile = Hostile::of_objects(&own);
    let mut python = of_roof("refuse", &own, &["objects"]);
    let client = Client::within(&own.domain(), "roof").unwrap();
    let mut objects = client.objects().unwrap();
    // To be there from the first on.
    assert!(python.ask("look")["sweep"].is_null());
    assert!(objects.next(Duration::ZERO).unwrap().received().is_none());
    for case in cases() {
        let name = case.name;
        hostile.send(&case.bytes, &case.preamble);
        let said = python.ask("next");
        match (objects.next(SOON), case.refusal) {
            (Ok(Next::Received(message)), None) => {
                let view = message.view().unwrap();
                assert!(!view.header.name().contains(char::is_control));
                assert!(said["sweep"].is_u64(), "{name}: {said}");
                let said = python.ask("use");
                let counts = (view.objects.len(), view.labels.len());
                let counts = (counts.0.into(), counts.1.into());
                assert_eq!((&said["objects"], &said["labels"]), (&counts.0, &counts.1));
            }
            (Err(error @ ClientError::Objects { .. }), Some(words)) => {
                let of_rust = error.to_string();
                assert!(of_rust.contains(words), "{name}: {of_rust}");
                let refused = said["refused"].as_str().unwrap_or_default();
                let is_told = refused.contains(words) && said["layout"] == true;
                assert!(is_told, "{name}: {said}");
            }
            (other, _) => panic!("{name}: {other:?}, {said}"),
        }
    }
    assert!(python.end().success());
}
