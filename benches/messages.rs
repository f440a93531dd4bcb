//! Sweeps to messages of ROS 2, beside a mere copy of the same bytes:
//!
//! ```text
//! cargo bench --bench messages
//! ```

use divan::counter::{BytesCount, ItemsCount};
use divan::{Bencher, black_box};
use sweepd::buffers::HeapBuffer;
use sweepd::buffers::{HeapBuffers, Memory};
use sweepd::messages::{Cloud, Layout, MessageHeader, Stamp, image, markers};
use sweepd::pipeline::{Config, Pipeline};
use sweepd::sensor::Model;
use sweepd::sweep::SweepRef;
use sweepd::sweep::layout::flags;
use sweepd::wire::data::ReturnMode;
use sweepd_lab::simulate::{Emitter, EmitterConfig, fixtures};
use sweepd_testkit::stream::next_sweep;

fn main() {
    divan::main();
}

const HEADER: MessageHeader<'_> = MessageHeader {
    frame_id: "roof",
    stamp: Stamp::First,
};

/// A sensor, named for the table.
struct Sensor(Model, ReturnMode);

impl std::fmt::Display for Sensor {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let returns = if self.1 == ReturnMode::Dual {
            "dual"
        } else {
            "single"
        };
        write!(f, "{} {returns}", self.0)
    }
}

const SENSORS: [Sensor; 3] = [
    Sensor(Model::Vlp16, ReturnMode::Strongest),
    Sensor(Model::Hdl64eS3, ReturnMode::Strongest),
    Sensor(Model::Hdl64eS3, ReturnMode::Dual),
];

/// A whole sweep of the street.
fn sweep(Sensor(model, mode): &Sensor) -> HeapBuffer {
    let scene = fixtures::scene();
    let config = EmitterConfig::new(*model, *mode).turns(4.0);
    let calibration = config.beams().into_owned();
    let mut pipeline = Pipeline::new(
        "bench",
        Config {
            model: Some(*model),
            calibration: Some(calibration),
            ..Config::default()
        },
    )
    .unwrap();
    let mut memory = Memory::new(HeapBuffers::default());
    for one in Emitter::new(config, &scene) {
        let Ok(packet) = one.datagram().parse() else {
            continue;
        };
        pipeline.push(&packet);
        while let Some(buffer) = next_sweep(&mut pipeline, &mut memory) {
            let header = SweepRef::open(buffer.as_ref()).unwrap().header;
            if !header.has(flags::PARTIAL) {
                return buffer;
            }
        }
    }
    panic!("no whole sweep");
}

/// Encodes a sweep again and again into the memory of the message before; items are pixels with a
/// return.
fn encode(bencher: Bencher, sensor: &Sensor, encoder: impl Fn(&SweepRef<'_>, &mut Vec<u8>)) {
    let buffer = sweep(sensor);
    let sweep = SweepRef::open(buffer.as_ref()).unwrap();
    let mut message = Vec::new();
    encoder(&sweep, &mut message);
    bencher
        .counter(ItemsCount::new(sweep.header.returns))
        .counter(BytesCount::new(message.len()))
        .bench_local(|| {
            message.clear();
            encoder(black_box(&sweep), &mut message);
        });
}

/// A list with all fields.
#[divan::bench(args = SENSORS)]
fn cloud(bencher: Bencher, sensor: &Sensor) {
    encode(bencher, sensor, |sweep, message| {
        Cloud::default().encode(sweep, &HEADER, message);
    });
}

/// The image with all fields.
#[divan::bench(args = SENSORS)]
fn organized(bencher: Bencher, sensor: &Sensor) {
    let cloud = Cloud {
        organized: true,
        ..Cloud::default()
    };
    encode(bencher, sensor, |sweep, message| {
        cloud.encode(sweep, &HEADER, message);
    });
}

/// Autoware's layout.
#[divan::bench(args = SENSORS)]
fn autoware(bencher: Bencher, sensor: &Sensor) {
    let cloud = Cloud {
        layout: Layout::Autoware,
        ..Cloud::default()
    };
    encode(bencher, sensor, |sweep, message| {
        cloud.encode(sweep, &HEADER, message);
    });
}

/// Ranges and labels.
#[divan::bench(args = SENSORS)]
fn images(bencher: Bencher, sensor: &Sensor) {
    encode(bencher, sensor, |sweep, message| {
        image::encode_ranges(sweep, &HEADER, message);
        image::encode_labels(sweep, &HEADER, message);
    });
}

/// Boxes.
#[divan::bench(args = SENSORS)]
fn boxes(bencher: Bencher, sensor: &Sensor) {
    encode(bencher, sensor, |sweep, message| {
        markers::encode(sweep, &HEADER, message);
    });
}

/// A copy of the bytes of the list.
#[divan::bench(args = SENSORS)]
fn copy(bencher: Bencher, sensor: &Sensor) {
    let buffer = sweep(sensor);
    let sweep = SweepRef::open(buffer.as_ref()).unwrap();
    let mut cloud = Vec::new();
    Cloud::default().encode(&sweep, &HEADER, &mut cloud);
    let mut message = Vec::new();
    bencher
        .counter(BytesCount::new(cloud.len()))
        .bench_local(|| {
            message.clear();
            message.extend_from_slice(black_box(&cloud));
        });
}
