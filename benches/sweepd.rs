//! Decode speed per model, and captures through the whole pipeline:
//!
//! ```text
//! cargo bench --bench sweepd
//! ```
//!
//! What is decoded is simulated, so that anyone can run this; captures are real, where they are at
//! hand (see CONTRIBUTING.md).

use std::path::{Path, PathBuf};
use sweepd_lab::testkit::stream::next_sweep;

use divan::counter::ItemsCount;
use divan::{Bencher, black_box};
use sweepd::admission::{DiscoveredSensors, Route};
use sweepd::assemble::Decoder;
use sweepd::assemble::PacketOrder;
use sweepd::assemble::{Builder, BuilderConfig};
use sweepd::buffers::OpenBuffer;
use sweepd::buffers::{HeapBuffers, Memory};
use sweepd::input::Capture;
use sweepd::pipeline::{Config, Pipeline};
use sweepd::sensor::{Calibration, Model, ModelExt};
use sweepd::sweep::SweepRef;
use sweepd::sweep::layout::ReturnChoice;
use sweepd::wire::DataPacket;
use sweepd::wire::data::ReturnMode;
use sweepd_lab::simulate::{Emitter, EmitterConfig, fixtures};

fn main() {
    divan::main();
}

/// The folder with real data, if it is there.
fn data() -> Option<PathBuf> {
    let beside = || Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/data");
    Some(std::env::var_os("SWEEPD_DATA").map_or_else(beside, PathBuf::from))
        .filter(|dir| dir.join("pcap").is_dir())
}

/// Data packets of a model, some turns of the street.
fn packets(model: Model, mode: ReturnMode, turns: f64) -> Vec<DataPacket> {
    let scene = fixtures::scene();
    let emitter = Emitter::new(EmitterConfig::new(model, mode).turns(turns), &scene);
    emitter
        .filter_map(|one| DataPacket::parse(&one.payload).ok().copied())
        .collect()
}

/// The beams that the simulated sensor of a model has.
fn beams(model: Model) -> Calibration {
    EmitterConfig::new(model, ReturnMode::Strongest)
        .beams()
        .into_owned()
}

/// A stream to decode, named for the table.
struct Stream(Model, ReturnMode);

impl std::fmt::Display for Stream {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let returns = if self.1 == ReturnMode::Dual {
            "dual"
        } else {
            "single"
        };
        write!(f, "{} {returns}", self.0)
    }
}

const STREAMS: [Stream; 10] = [
    Stream(Model::Vlp16, ReturnMode::Strongest),
    Stream(Model::Vlp16, ReturnMode::Dual),
    Stream(Model::Hdl32e, ReturnMode::Strongest),
    Stream(Model::Hdl32e, ReturnMode::Dual),
    Stream(Model::Hdl64eS2, ReturnMode::Strongest),
    Stream(Model::Hdl64eS3, ReturnMode::Dual),
    Stream(Model::Vlp32c, ReturnMode::Strongest),
    Stream(Model::Vlp32c, ReturnMode::Dual),
    Stream(Model::Vls128, ReturnMode::Strongest),
    Stream(Model::Vls128, ReturnMode::Dual),
];

/// Packets to sweeps, without segmentation; items are returns.
#[divan::bench(args = STREAMS, sample_count = 50)]
fn decode(bencher: Bencher, &Stream(model, mode): &Stream) {
    let packets = packets(model, mode, 3.0);
    let returns: usize = packets.iter().map(DataPacket::returns).sum();
    let buffers = HeapBuffers::default();
    let settings = BuilderConfig {
        cut_cdeg: 0.0,
        return_choice: ReturnChoice::Nearest,
        min_points: 10,
        sensor: format!("{model} {mode}"),
    };
    bencher.counter(ItemsCount::new(returns)).bench_local(|| {
        let limits_m = 0.0..=f32::INFINITY;
        let decoder = Decoder::new(
            model,
            model.spec(),
            &beams(model),
            ReturnChoice::Nearest,
            limits_m,
        );
        let mut order = PacketOrder::new(decoder.spec);
        let mut builder = Builder::new(decoder, settings.clone());
        let mut buffer = Memory::new(buffers.clone());
        for (number, packet) in packets.iter().enumerate() {
            let _ = order.push(
                black_box(packet),
                mode,
                number as u64,
                number as i64 * 1_000_000,
            );
            while let Some((index, before)) = order.pop() {
                builder.begin(index, order.packet(index), before);
                while builder.advance(order.packet(index), order.clock(), &mut buffer) {
                    black_box(buffer.bytes());
                }
            }
        }
    });
}

/// A real capture through the whole pipeline, segmentation included; items are returns.
#[divan::bench(args = ["vlp16_einride-a", "vlp16_timm-dual-a", "hdl32e_veloview-monterey-a"], sample_count = 10)]
fn replay(bencher: Bencher, name: &str) {
    let Some(data) = data() else { return };
    let path = data.join("pcap").join(name).with_extension("pcap");
    let returns = |visit: &mut dyn FnMut(u32)| {
        let mut capture = Capture::open(&path).unwrap();
        let mut sensors = DiscoveredSensors::new(Vec::new());
        let mut pipeline = Pipeline::new("bench", Config::default()).unwrap();
        let mut memory = Memory::new(HeapBuffers::default());
        while let Some(datagram) = capture.next_datagram().unwrap() {
            if let Ok((Route::Data(_), packet)) = sensors.admit(&datagram) {
                pipeline.push(&packet);
            }
            while let Some(buffer) = next_sweep(&mut pipeline, &mut memory) {
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
