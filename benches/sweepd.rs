//! Decode speed per model, and captures through the whole pipeline:
//!
//! ```text
//! cargo bench --bench sweepd
//! ```
//!
//! What is decoded is simulated, so that anyone can run this; captures are real, where they are at
//! hand (see CONTRIBUTING.md).

use std::path::{Path, PathBuf};
use sweepd_testkit::stream::next_sweep;

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

/// Data packets of a model, three turns of the street, or those of a capture; none where that is not
/// at hand.
fn packets(&Stream(model, mode, capture): &Stream) -> Vec<DataPacket> {
    let mut packets = Vec::new();
    if let Some(name) = capture {
        let Some(data) = data() else { return packets };
        let path = data.join("pcap").join(name).with_extension("pcap");
        let mut capture = Capture::open(&path).unwrap();
        while let Some(datagram) = capture.next_datagram().unwrap() {
            packets.extend(DataPacket::parse(datagram.payload));
        }
    } else {
        let scene = fixtures::scene();
        let emitter = Emitter::new(EmitterConfig::new(model, mode).turns(3.0), &scene);
        packets.extend(emitter.filter_map(|one| DataPacket::parse(&one.payload).ok().copied()));
    }
    packets
}

/// The beams that the simulated sensor of a model has.
fn beams(model: Model) -> Calibration {
    EmitterConfig::new(model, ReturnMode::Strongest)
        .beams()
        .into_owned()
}

/// A stream to decode, named for the table; of a capture, or simulated.
struct Stream(Model, ReturnMode, Option<&'static str>);

impl std::fmt::Display for Stream {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let returns = if self.1 == ReturnMode::Dual {
            "dual"
        } else {
            "single"
        };
        match self.2 {
            Some(capture) => f.write_str(capture),
            None => write!(f, "{} {returns}", self.0),
        }
    }
}

const STREAMS: [Stream; 13] = [
    Stream(Model::Vlp16, ReturnMode::Strongest, Some("vlp16_einride-a")),
    Stream(Model::Vlp16, ReturnMode::Dual, Some("vlp16_timm-dual-a")),
    Stream(
        Model::Hdl32e,
        ReturnMode::Strongest,
        Some("hdl32e_veloview-monterey-a"),
    ),
    Stream(Model::Vlp16, ReturnMode::Strongest, None),
    Stream(Model::Vlp16, ReturnMode::Dual, None),
    Stream(Model::Hdl32e, ReturnMode::Strongest, None),
    Stream(Model::Hdl32e, ReturnMode::Dual, None),
    Stream(Model::Hdl64eS2, ReturnMode::Strongest, None),
    Stream(Model::Hdl64eS3, ReturnMode::Dual, None),
    Stream(Model::Vlp32c, ReturnMode::Strongest, None),
    Stream(Model::Vlp32c, ReturnMode::Dual, None),
    Stream(Model::Vls128, ReturnMode::Strongest, None),
    Stream(Model::Vls128, ReturnMode::Dual, None),
];

/// Datagrams to sweeps, without segmentation: parsed, put in order, the head followed, and decoded;
/// items are returns.
#[divan::bench(args = STREAMS, sample_count = 50)]
fn decode(bencher: Bencher, stream: &Stream) {
    let packets = packets(stream);
    if packets.is_empty() {
        return;
    }
    let &Stream(model, mode, _) = stream;
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
            let Ok(packet) = DataPacket::parse(black_box(packet.emit())) else {
                continue;
            };
            let _ = order.push(packet, mode, number as u64, number as i64 * 1_000_000);
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
