//! Decode speed per model, and segmentation beside its naive twin in the same run:
//!
//! ```text
//! cargo bench
//! ```
//!
//! The sweeps are simulated, so that anyone can run this. Where the real captures and clouds are at hand (see the README),
//! they are measured as well.

use std::path::{Path, PathBuf};

use divan::counter::ItemsCount;
use divan::{Bencher, black_box};
use sweepd::capture::{Capture, Route, Sensors};
use sweepd::cloud::{self, CloudProjector};
use sweepd::pipeline::{Config, Pipeline, Untimed};
use sweepd::segment::{self, Method, Segmenter};
use sweepd::sensor::{Calibration, Model};
use sweepd::simulate::{Emitter, EmitterConfig, fixtures};
use sweepd::sweep::buffers::HeapBuffer;
use sweepd::sweep::builder::{Builder, Settings};
use sweepd::sweep::decode::Decoder;
use sweepd::sweep::layout::{ReturnChoice, flags};
use sweepd::sweep::order::Order;
use sweepd::sweep::{HeapBuffers, SweepMut, SweepRef};
use sweepd::wire::DataPacket;
use sweepd::wire::data::ReturnMode;

fn main() {
    divan::main();
}

/// The folder with real data, if it is there.
fn data() -> Option<PathBuf> {
    let beside = || Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/data");
    Some(std::env::var_os("SWEEPD_DATA").map_or_else(beside, PathBuf::from)).filter(|dir| dir.join("pcap").is_dir())
}

/// Data packets of a model, some turns of the street.
fn packets(model: Model, mode: ReturnMode, turns: f64) -> Vec<DataPacket> {
    let scene = fixtures::scene();
    let emitter = Emitter::new(EmitterConfig::new(model, mode).turns(turns), &scene);
    emitter.filter_map(|one| DataPacket::parse(&one.payload).ok().copied()).collect()
}

/// The beams that the simulated sensor of a model has.
fn beams(model: Model) -> Calibration {
    EmitterConfig::new(model, ReturnMode::Strongest).beams().into_owned()
}

/// A stream to decode, named for the table.
struct Stream(Model, ReturnMode);

impl std::fmt::Display for Stream {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let returns = if self.1 == ReturnMode::Dual { "dual" } else { "single" };
        write!(f, "{} {returns}", self.0)
    }
}

const STREAMS: [Stream; 6] = [
    Stream(Model::Vlp16, ReturnMode::Strongest),
    Stream(Model::Vlp16, ReturnMode::Dual),
    Stream(Model::Hdl32e, ReturnMode::Strongest),
    Stream(Model::Hdl32e, ReturnMode::Dual),
    Stream(Model::Hdl64eS2, ReturnMode::Strongest),
    Stream(Model::Hdl64eS3, ReturnMode::Dual),
];

/// Packets to sweeps, without segmentation; items are returns.
#[divan::bench(args = STREAMS, sample_count = 50)]
fn decode(bencher: Bencher, &Stream(model, mode): &Stream) {
    let packets = packets(model, mode, 3.0);
    let returns: usize = packets.iter().map(DataPacket::returns).sum();
    let buffers = HeapBuffers::default();
    let settings = Settings {
        cut_cdeg: 0.0,
        return_choice: ReturnChoice::Nearest,
        min_points: 10,
        sensor: format!("{model} {mode}"),
    };
    bencher.counter(ItemsCount::new(returns)).bench_local(|| {
        let limits_m = 0.0..=f32::INFINITY;
        let decoder = Decoder::new((model, model.spec()), &beams(model), ReturnChoice::Nearest, limits_m);
        let mut order = Order::new(decoder.spec);
        let mut builder = Builder::new(buffers.clone(), decoder, settings.clone());
        for (number, packet) in packets.iter().enumerate() {
            let _ = order.push(black_box(packet), mode, number as u64, number as i64 * 1_000_000);
            while let Some((slot, before)) = order.pop() {
                builder.begin(slot, order.packet(slot), before);
                while let Some(sweep) = builder.advance(order.packet(slot), order.clock()) {
                    black_box(&sweep);
                }
            }
        }
    });
}

/// The images that segmentation is measured on.
const IMAGES: [&str; 4] = ["16x1808 street", "32x2170 street", "64x2083 street", "64x2083 KITTI"];

/// A whole sweep to segment; `None` where it needs real data that is not there.
fn image(name: &str) -> Option<HeapBuffer> {
    match name {
        "16x1808 street" => Some(whole_sweep(Model::Vlp16)),
        "32x2170 street" => Some(whole_sweep(Model::Hdl32e)),
        "64x2083 street" => Some(whole_sweep(Model::Hdl64eS2)),
        _ => {
            let bytes = std::fs::read(data()?.join("labelled/semantickitti/00/000000.bin")).ok()?;
            Some(projected(&cloud::points(&bytes).ok()?))
        }
    }
}

/// The first whole sweep of a simulated street.
fn whole_sweep(model: Model) -> HeapBuffer {
    let scene = fixtures::scene();
    let emitter = Emitter::new(EmitterConfig::new(model, ReturnMode::Strongest).turns(2.5), &scene);
    let config = Config { calibration: Some(beams(model)), ..Config::default() };
    let mut pipeline = Pipeline::new("bench", config, HeapBuffers::default(), Untimed).unwrap();
    for one in emitter {
        pipeline.push(&one.datagram()).unwrap();
        while let Some(buffer) = pipeline.poll() {
            if !SweepRef::open(buffer.as_ref()).unwrap().header.has(flags::PARTIAL) {
                return buffer;
            }
        }
    }
    unreachable!("two and a half turns hold a whole one")
}

fn projected(points: &[[f32; 4]]) -> HeapBuffer {
    let mut projector = CloudProjector::new(cloud::COLUMNS).unwrap();
    projector.project(points).unwrap();
    projector.into_buffer().unwrap()
}

fn config(method: Method) -> segment::Config {
    segment::Config { method, ..segment::Config::default() }
}

/// Ground, joining, labels and segments table; items are pixels.
fn fast(bencher: Bencher, name: &str, method: Method) {
    let Some(mut buffer) = image(name) else { return };
    let mut sweep = SweepMut::open(buffer.as_mut()).unwrap();
    let pixels = sweep.image_pixels().len();
    let mut segmenter = Segmenter::new(config(method)).unwrap();
    bencher.counter(ItemsCount::new(pixels)).bench_local(|| segmenter.segment(black_box(&mut sweep)));
}

/// Ground and labels by the specification twin; items are pixels.
fn naive(bencher: Bencher, name: &str, method: Method) {
    let Some(mut buffer) = image(name) else { return };
    let mut sweep = SweepMut::open(buffer.as_mut()).unwrap();
    Segmenter::new(config(method)).unwrap().segment(&mut sweep);
    let height_m = Some(sweep.header.height_m).filter(|&height| height > 0.0);
    let sweep = sweep.as_ref();
    let pixels = sweep.range.len();
    let config = config(method);
    let label = || segment::naive::segment(black_box(&sweep), &config, height_m);
    bencher.counter(ItemsCount::new(pixels)).bench_local(label);
}

#[divan::bench(args = IMAGES, sample_count = 100)]
fn segment_slope(bencher: Bencher, name: &str) {
    fast(bencher, name, Method::Slope);
}

#[divan::bench(args = IMAGES, sample_count = 10)]
fn segment_slope_naive(bencher: Bencher, name: &str) {
    naive(bencher, name, Method::Slope);
}

#[divan::bench(args = IMAGES, sample_count = 100)]
fn segment_paper(bencher: Bencher, name: &str) {
    fast(bencher, name, Method::Paper);
}

#[divan::bench(args = IMAGES, sample_count = 10)]
fn segment_paper_naive(bencher: Bencher, name: &str) {
    naive(bencher, name, Method::Paper);
}

/// A real capture through the whole pipeline, segmentation included; items are returns.
#[divan::bench(args = ["vlp16_einride-a", "vlp16_timm-dual-a", "hdl32e_veloview-monterey-a"], sample_count = 10)]
fn replay(bencher: Bencher, name: &str) {
    let Some(data) = data() else { return };
    let path = data.join("pcap").join(name).with_extension("pcap");
    let returns = |visit: &mut dyn FnMut(u32)| {
        let mut capture = Capture::open(&path).unwrap();
        let mut sensors = Sensors::new(Vec::new());
        let mut pipeline = Pipeline::new("bench", Config::default(), HeapBuffers::default(), Untimed).unwrap();
        while let Some(datagram) = capture.next_datagram().unwrap() {
            if matches!(sensors.route(&datagram), Route::Data(_)) {
                pipeline.push(&datagram).unwrap();
            }
            while let Some(buffer) = pipeline.poll() {
                visit(SweepRef::open(buffer.as_ref()).unwrap().header.returns);
            }
        }
    };
    let mut total = 0;
    returns(&mut |count| total += count as usize);
    bencher.counter(ItemsCount::new(total)).bench_local(|| {
        returns(&mut |count| {
            black_box(count);
        })
    });
}
