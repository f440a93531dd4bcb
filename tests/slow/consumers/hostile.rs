//! A publisher under the name of a daemon's service that keeps to nothing, and what a consumer must
//! make of it.

use iceoryx2::port::notifier::Notifier;
use iceoryx2::port::publisher::Publisher;
use iceoryx2::prelude::*;
use iceoryx2::service::port_factory::publish_subscribe::PortFactory;
use sweepd::buffers::{Buffers, HeapBuffers};
use sweepd::publish::Preamble;
use sweepd::sweep::layout::{Header, LAYOUT_VERSION, Part};
use sweepd::sweep::{Shape, SweepMut};
use zerocopy::{FromBytes, IntoBytes};

use super::python::mapped;
use sweepd_testkit::TempDomain;

type Ipc = iceoryx2::service::ipc_threadsafe::Service;

/// What the shape of an honest sweep is.
pub const SHAPE: Shape = Shape {
    rows: 16,
    columns_capacity: 100,
    dual: true,
    segments_capacity: 10,
};
/// Columns of an honest sweep.
pub const COLUMNS: usize = 80;

pub fn node(own: &TempDomain) -> Node<Ipc> {
    let mut config = Config::default();
    config.global.set_root_path(
        &iceoryx2::prelude::Path::new(own.root().as_os_str().as_encoded_bytes()).unwrap(),
    );
    config.global.prefix = FileName::new(own.domain().prefix().as_bytes()).unwrap();
    std::fs::create_dir_all(own.root()).unwrap();
    let builder = NodeBuilder::new()
        .config(&config)
        .signal_handling_mode(SignalHandlingMode::Disabled);
    builder.create().unwrap()
}

pub fn service_name() -> ServiceName {
    "sweepd/roof/sweep".try_into().unwrap()
}

fn objects_name() -> ServiceName {
    "sweepd/roof/objects".try_into().unwrap()
}

/// The attributes of a service whose layout has this version.
pub fn schema(version: &str) -> AttributeSpecifier {
    AttributeSpecifier::new()
        .define(&"schema".try_into().unwrap(), &version.try_into().unwrap())
        .unwrap()
}

/// Sends whatever it is given. Dropped in this order.
pub struct Hostile {
    publisher: Publisher<Ipc, [u8], Preamble>,
    notifier: Notifier<Ipc>,
    _service: PortFactory<Ipc, [u8], Preamble>,
    _node: Node<Ipc>,
}

impl Hostile {
    pub fn new(own: &TempDomain) -> Self {
        Self::aligned(own, 1)
    }

    /// One whose payload is aligned to this many bytes.
    pub fn aligned(own: &TempDomain, bytes: usize) -> Self {
        let attributes = schema(&LAYOUT_VERSION.to_string());
        Self::with(own, &service_name(), bytes, &attributes)
    }

    /// One that tells objects.
    pub fn of_objects(own: &TempDomain) -> Self {
        let attributes = schema(&LAYOUT_VERSION.to_string());
        Self::with(own, &objects_name(), 1, &attributes)
    }

    /// One without attributes, as a tunnel mirrors a service from another host.
    pub fn mirror(own: &TempDomain) -> Self {
        Self::with(own, &service_name(), 1, &AttributeSpecifier::new())
    }

    fn with(
        own: &TempDomain,
        name: &ServiceName,
        bytes: usize,
        attributes: &AttributeSpecifier,
    ) -> Self {
        let node = node(own);
        let samples = node
            .service_builder(name)
            .publish_subscribe::<[u8]>()
            .user_header::<Preamble>();
        let samples = samples
            .max_subscribers(4)
            .history_size(1)
            .subscriber_max_buffer_size(2);
        let samples = samples.payload_alignment(Alignment::new(bytes).unwrap());
        let service = samples.create_with_attributes(attributes).unwrap();
        let event = node.service_builder(name).event().create().unwrap();
        let notifier = event.notifier_builder().create().unwrap();
        let publisher = service
            .publisher_builder()
            .initial_max_slice_len(1 << 16)
            .create()
            .unwrap();
        Self {
            publisher,
            notifier,
            _service: service,
            _node: node,
        }
    }

    /// Sends these bytes behind this preamble; says where in which file they are.
    pub fn send(&self, bytes: &[u8], preamble: &Preamble) -> (String, u64) {
        let mut sample = self.publisher.loan_slice(bytes.len()).unwrap();
        sample.payload_mut().copy_from_slice(bytes);
        *sample.user_header_mut() = *preamble;
        let place = mapped(sample.payload());
        sample.send().unwrap();
        self.notifier.notify().unwrap();
        place
    }
}

/// A preamble that says this; its reserved bytes are zero.
pub fn preamble(layout_version: u32, sweep_bytes: u64) -> Preamble {
    let mut preamble = Preamble::default();
    (preamble.layout_version, preamble.sweep_bytes) = (layout_version, sweep_bytes);
    preamble
}

/// A sweep in which nothing is wrong, full of returns.
pub fn honest(sequence: u64) -> Vec<u8> {
    let mut buffer = HeapBuffers::default().take(SHAPE.total_bytes());
    let sweep = SweepMut::create(buffer.as_mut(), &SHAPE).unwrap();
    sweep.range.fill(5.0);
    sweep.range2.fill(6.0);
    for part in [
        sweep.columns.as_mut_bytes(),
        sweep.beams.as_mut_bytes(),
        sweep.segments.as_mut_bytes(),
    ] {
        part.fill(0);
    }
    [sweep.reflectivity, sweep.reflectivity2, sweep.kind]
        .into_iter()
        .for_each(|plane| plane.fill(1));
    [sweep.label, sweep.label2]
        .into_iter()
        .for_each(|plane| plane.fill(2));
    (
        sweep.header.columns,
        sweep.header.segments,
        sweep.header.model,
    ) = (COLUMNS as u32, 1, 1);
    (sweep.header.sequence, sweep.header.margin_columns) = (sequence, 3);
    buffer.as_ref().to_vec()
}

/// What becomes of a sweep.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fate {
    /// It is refused, in these words.
    Refused(&'static str),
    /// It is a sweep, whatever stands in it, and all can be asked.
    Taken,
}

pub struct Case {
    pub name: &'static str,
    pub bytes: Vec<u8>,
    pub preamble: Preamble,
    pub fate: Fate,
}

const VERSION: &str = "this program reads version 3";
const SHAPELESS: &str = "contradict";

/// Whatever a publisher may send.
pub fn cases() -> Vec<Case> {
    let heads = headers().into_iter().map(|(name, fate, change)| {
        let mut bytes = honest(7);
        let (header, _) = Header::mut_from_prefix(&mut bytes).unwrap();
        change(header);
        let preamble = preamble(LAYOUT_VERSION, bytes.len() as u64);
        Case {
            name,
            bytes,
            preamble,
            fate,
        }
    });
    heads.chain(lengths()).chain(contents()).collect()
}

type Change = fn(&mut Header);

fn headers() -> Vec<(&'static str, Fate, Change)> {
    use Fate::{Refused, Taken};
    vec![
        ("honest", Taken, |_| {}),
        ("other magic bytes", Refused("magic"), |header| {
            header.magic = *b"SWEEPD\r\n"
        }),
        ("zeros", Refused("magic"), |header| {
            header.as_mut_bytes().fill(0)
        }),
        ("ones", Refused("magic"), |header| {
            header.as_mut_bytes().fill(0xFF)
        }),
        ("an older version", Refused(VERSION), |header| {
            header.version = LAYOUT_VERSION - 1
        }),
        ("a newer version", Refused(VERSION), |header| {
            header.version = LAYOUT_VERSION + 1
        }),
        ("another model", Taken, |header| header.model = 0xDEAD_BEEF),
        ("words that are none", Taken, |header| {
            (header.return_mode, header.return_choice, header.time_source) =
                (u32::MAX, u32::MAX, u32::MAX);
            header.flags = u32::MAX;
        }),
        ("numbers at their ends", Taken, |header| {
            (header.sequence, header.time_ns, header.duration_ns) = (u64::MAX, i64::MAX, u64::MAX);
            (header.arrival_ns, header.sensor_time_ns) = (i64::MIN, i64::MIN);
            (
                header.completed_ns,
                header.completed_monotonic_ns,
                header.run_ns,
            ) = (i64::MIN, i64::MIN, i64::MAX);
            (header.rpm, header.height_m, header.position_m) =
                (f32::NAN, f32::INFINITY, [f32::NEG_INFINITY; 3]);
        }),
        ("names that are no text", Taken, |header| {
            (header.sensor, header.name) = ([0xFF; 64], [0x1B; 64]);
        }),
        ("a plane far outside", Refused(SHAPELESS), |header| {
            header.offsets[Part::Range as usize] = u64::MAX - 63
        }),
        ("a table just outside", Refused(SHAPELESS), |header| {
            header.offsets[Part::Segments as usize] = header.total_bytes;
        }),
        ("a plane over the header", Refused(SHAPELESS), |header| {
            header.offsets[Part::Label as usize] = 0
        }),
        ("planes over each other", Refused(SHAPELESS), |header| {
            header.offsets[Part::Label as usize] = header.offsets[Part::Range as usize];
        }),
        ("a plane at an odd place", Refused(SHAPELESS), |header| {
            header.offsets[Part::Range as usize] += 1
        }),
        ("one plane of a pair", Refused(SHAPELESS), |header| {
            header.offsets[Part::Range2 as usize] = 0
        }),
        ("rows without end", Refused(SHAPELESS), |header| {
            header.rows = u32::MAX
        }),
        ("rows x columns over 2^64", Refused(SHAPELESS), |header| {
            (header.rows, header.columns_capacity, header.columns) = (u32::MAX, u32::MAX, u32::MAX);
        }),
        ("rows x columns over 2^32", Refused(SHAPELESS), |header| {
            (header.rows, header.columns_capacity) = (1 << 16, 1 << 16);
        }),
        ("more columns than room", Refused(SHAPELESS), |header| {
            header.columns = 101
        }),
        ("margin + columns over 2^32", Refused(SHAPELESS), |header| {
            (header.margin_columns, header.columns) = (u32::MAX, 1);
        }),
        ("more segments than room", Refused(SHAPELESS), |header| {
            header.segments = 11
        }),
        ("segments without end", Refused(SHAPELESS), |header| {
            (header.segments, header.segments_capacity) = (u32::MAX, u32::MAX);
        }),
        ("a whole that is too long", Refused(SHAPELESS), |header| {
            header.total_bytes = u64::MAX
        }),
        (
            "consistent and longer than what is there",
            Refused("cannot hold"),
            |header| {
                let longer = Header::new(&Shape {
                    columns_capacity: 101,
                    ..SHAPE
                });
                (header.offsets, header.total_bytes) = (longer.offsets, longer.total_bytes);
                header.columns_capacity = 101;
            },
        ),
        ("no columns", Taken, |header| {
            (header.columns, header.margin_columns) = (0, 0)
        }),
        ("no segments", Taken, |header| header.segments = 0),
    ]
}

/// Fewer bytes than are named, in the header or before it.
fn lengths() -> Vec<Case> {
    let all = honest(7);
    let case = |name, len: usize, promised: u64, fate| {
        let preamble = preamble(LAYOUT_VERSION, promised);
        Case {
            name,
            bytes: all[..len].to_vec(),
            preamble,
            fate,
        }
    };
    let whole = all.len() as u64;
    let other = |name, layout_version| {
        let preamble = preamble(layout_version, whole);
        Case {
            name,
            bytes: honest(7),
            preamble,
            fate: Fate::Refused(VERSION),
        }
    };
    vec![
        case(
            "torn in the segments",
            all.len() - 64,
            whole,
            Fate::Refused("torn"),
        ),
        case("torn in the header", 100, whole, Fate::Refused("torn")),
        case("a byte", 1, 1, Fate::Refused("cannot hold")),
        case("part of a header", 447, 447, Fate::Refused("cannot hold")),
        case("a header alone", 448, 448, Fate::Refused("cannot hold")),
        case(
            "shorter than its header says",
            all.len() - 1,
            whole - 1,
            Fate::Refused("cannot hold"),
        ),
        case("none named", all.len(), 0, Fate::Refused("cannot hold")),
        case(
            "more named than there can be",
            all.len(),
            u64::MAX,
            Fate::Refused("torn"),
        ),
        other("an older preamble", LAYOUT_VERSION - 1),
        other("a newer preamble", u32::MAX),
    ]
}

/// Planes and tables of a sound header that are full of anything.
fn contents() -> Vec<Case> {
    let case = |name, fill: &dyn Fn(usize) -> u8| {
        let mut bytes = honest(7);
        bytes
            .iter_mut()
            .enumerate()
            .skip(size_of::<Header>())
            .for_each(|(at, byte)| *byte = fill(at));
        let preamble = preamble(LAYOUT_VERSION, bytes.len() as u64);
        Case {
            name,
            bytes,
            preamble,
            fate: Fate::Taken,
        }
    };
    // As f32, little-endian: infinity is 0000807f, a number that is none 0000c07f.
    let repeated = |word: [u8; 4]| move |at: usize| word[at % 4];
    let noise = |at: usize| {
        (at as u64)
            .wrapping_mul(0x9E37_79B9_7F4A_7C15)
            .to_le_bytes()[6]
    };
    vec![
        case("infinite", &repeated(f32::INFINITY.to_le_bytes())),
        case("no numbers", &repeated(f32::NAN.to_le_bytes())),
        case("the greatest", &repeated(f32::MAX.to_le_bytes())),
        case("the least", &repeated(f32::MIN.to_le_bytes())),
        case("all ones", &|_| 0xFF),
        case("shifts of 2^31", &repeated(i32::MIN.to_le_bytes())),
        case("noise", &noise),
    ]
}
