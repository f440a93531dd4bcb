//! A simulated sensor whose eye fails is told by the bits of the header; one that sees is not. A table shows
//! how near captures and scenes come to each limit.

use std::path::Path;

use sweepd::admission::DiscoveredSensors;
use sweepd::buffers::{HeapBuffers, Memory};
use sweepd::input::Capture;
use sweepd::pipeline::{Config, Event, EyeMeasures, Pipeline};
use sweepd::sensor::Model;
use sweepd::sweep::SweepRef;
use sweepd::sweep::layout::flags;
use sweepd::wire::data::ReturnMode;
use sweepd_lab::simulate::{Emitter, EmitterConfig, EyeFault, EyeKind, Scene, Setting};
use sweepd_lab::testkit::stream;

/// Bits of the header, as docs/layout.md has them.
const BLIND: u32 = 0x100;
const COVERED: u32 = 0x200;
const FROZEN: u32 = 0x400;
const FADED: u32 = 0x800;
const DARK_BELOW: u32 = 0x1000;
const ALL: u32 = 0x1F00;

/// A sensor of 600 turns a minute that stands in a scene.
fn sensor(setting: Setting, model: Model, seconds: f64) -> (Scene, EmitterConfig) {
    let scene = setting.build(1);
    let mut config = EmitterConfig::new(model, ReturnMode::Strongest).seconds(seconds, None);
    config.pose = setting.pose(0);
    (scene, config)
}

/// The bits of each of its whole turns.
fn turns(scene: &Scene, emitter: EmitterConfig, config: Config) -> Vec<u32> {
    let mut pipeline = Pipeline::new("test", config).unwrap();
    let mut memory = Memory::<HeapBuffers>::default();
    let mut bits = Vec::new();
    for sent in Emitter::new(emitter, scene).untold() {
        stream::push(
            &mut pipeline,
            &stream::datagram(&sent.payload, sent.arrival_ns),
        );
        while let Some(event) = pipeline.poll(&mut memory) {
            if let Event::Sweep(bytes) = event {
                let sweep = SweepRef::open(bytes.as_ref()).unwrap();
                if !sweep.header.has(flags::PARTIAL) {
                    bits.push(sweep.header.flags & ALL);
                }
            }
        }
    }
    bits
}

#[test]
fn what_is_wrong_with_the_eye_is_told_within_two_seconds() {
    for (kind, bit) in [
        (EyeKind::Blind, BLIND),
        (EyeKind::Cover, COVERED),
        (EyeKind::Frozen, FROZEN),
        (EyeKind::Faded, FADED),
        (EyeKind::Dark, DARK_BELOW),
        (EyeKind::Sector, DARK_BELOW),
    ] {
        let (scene, mut emitter) = sensor(Setting::ParkingLot, Model::Vlp16, 6.0);
        let from_ns = 4_000_000_000;
        emitter.eye = Some(EyeFault { kind, from_ns });
        let bits = turns(&scene, emitter, Config::default());
        let first = bits.iter().position(|&bits| bits & bit != 0);
        let first = first.unwrap_or_else(|| panic!("{kind:?} is not told: {bits:x?}"));
        assert!((40..60).contains(&first), "{kind:?}: turn {first}");
        assert!(bits[..40].iter().all(|&bits| bits == 0), "{kind:?}");
    }
}

#[test]
fn what_is_wrong_from_the_start_is_told_too() {
    for (kind, bit) in [
        (EyeKind::Blind, BLIND),
        (EyeKind::Cover, COVERED),
        (EyeKind::Frozen, FROZEN),
        (EyeKind::Dark, DARK_BELOW),
    ] {
        let (scene, mut emitter) = sensor(Setting::Street, Model::Vlp16, 2.0);
        emitter.eye = Some(EyeFault { kind, from_ns: 0 });
        let bits = turns(&scene, emitter, Config::default());
        assert!(bits.last().is_some_and(|bits| bits & bit != 0), "{kind:?}");
    }
}

#[test]
fn returns_that_are_removed_are_not_missing() {
    let (scene, mut emitter) = sensor(Setting::Room, Model::Vlp16, 2.0);
    emitter.eye = None;
    let mut config = Config::default();
    config.removal.out_of_range = true;
    config.segment.min_range_m = 99.0;
    let bits = turns(&scene, emitter, config);
    assert!(
        bits.len() > 15 && bits.iter().all(|&bits| bits == 0),
        "{bits:x?}"
    );
}

#[test]
fn no_scene_is_called_a_fault() {
    for setting in Setting::ALL {
        let (scene, emitter) = sensor(setting, Model::Vlp16, 4.0);
        let bits = turns(&scene, emitter, Config::default());
        let are_clear = bits.iter().all(|&bits| bits == 0);
        assert!(
            bits.len() > 35 && are_clear,
            "{}: {bits:x?}",
            setting.name()
        );
    }
}

/// The nearest that turns came to each rule.
struct Nearest {
    pipeline: Pipeline,
    memory: Memory<HeapBuffers>,
    turns: u32,
    bits: u32,
    nearest: EyeMeasures,
}

impl Nearest {
    fn new() -> Self {
        Self {
            pipeline: Pipeline::new("test", Config::default()).unwrap(),
            memory: Memory::default(),
            turns: 0,
            bits: 0,
            nearest: EyeMeasures {
                returned: 1.0,
                near: 0.0,
                alike: 0.0,
                of_best: 1.0,
                below: 1.0,
            },
        }
    }

    fn poll(&mut self) {
        while let Some(event) = self.pipeline.poll(&mut self.memory) {
            let Event::Sweep(bytes) = event else { continue };
            let sweep = SweepRef::open(bytes.as_ref()).unwrap();
            self.bits |= sweep.header.flags & ALL;
            if sweep.header.has(flags::PARTIAL | flags::STOPPED) {
                continue;
            }
            self.turns += 1;
            if let Some(seen) = self.pipeline.status().eye {
                let nearest = &mut self.nearest;
                nearest.returned = nearest.returned.min(seen.returned);
                nearest.near = nearest.near.max(seen.near);
                nearest.alike = nearest.alike.max(seen.alike);
                nearest.of_best = nearest.of_best.min(seen.of_best);
                nearest.below = nearest.below.min(seen.below);
            }
        }
    }

    /// Prints the row of the table, and says whether nothing was told.
    fn row(mut self, name: &str) -> bool {
        self.pipeline.end();
        self.poll();
        let EyeMeasures {
            returned,
            near,
            alike,
            of_best,
            below,
        } = self.nearest;
        let turns = self.turns;
        let told = if self.bits == 0 { "-" } else { "FAULT" };
        println!(
            "| {name} | {turns} | {returned:.3} | {near:.2} | {alike:.2} | {of_best:.2} | {below:.2} | {told} |"
        );
        self.bits == 0
    }
}

/// All captures of a folder, by name.
fn captures(folder: &Path) -> Vec<std::path::PathBuf> {
    let mut paths = Vec::new();
    for entry in folder.read_dir().into_iter().flatten().flatten() {
        let name = entry.file_name().to_string_lossy().into_owned();
        if name.contains(".pcap") {
            paths.push(entry.path());
        }
    }
    paths.sort();
    paths
}

#[test]
#[ignore = "prints a table, and takes a while"]
fn no_capture_and_no_scene_is_called_a_fault() {
    let own = Path::new("pcap_fixtures").to_owned();
    let data = std::env::var_os("SWEEPD_DATA").unwrap_or_else(|| "../shared/data".into());
    let mut is_clear = true;
    for path in [own, Path::new(&data).join("pcap")]
        .iter()
        .flat_map(|one| captures(one))
    {
        let mut nearest = Nearest::new();
        let mut capture = Capture::open(&path).unwrap();
        let mut sensors = DiscoveredSensors::default();
        while let Some(datagram) = capture.next_datagram().unwrap() {
            if sensors.admit(&datagram).is_ok() {
                stream::push(&mut nearest.pipeline, &datagram);
                nearest.poll();
            }
        }
        is_clear &= nearest.row(&path.file_name().unwrap().to_string_lossy());
    }
    for setting in Setting::ALL {
        for model in [Model::Vlp16, Model::PuckHiRes, Model::Hdl32e, Model::Vlp32c] {
            let (scene, mut emitter) = sensor(setting, model, 6.0);
            emitter.motion.velocity.y = 2.0;
            let mut nearest = Nearest::new();
            for sent in Emitter::new(emitter, &scene).untold() {
                let datagram = stream::datagram(&sent.payload, sent.arrival_ns);
                stream::push(&mut nearest.pipeline, &datagram);
                nearest.poll();
            }
            is_clear &= nearest.row(&format!("{}, {model}, 2 m/s", setting.name()));
        }
    }
    assert!(is_clear);
}
