//! A simulated sensor whose eye fails is told to, by the bits of the header; one that sees is not. Few
//! rules know the simulator, and no test here knows the rules.

use sweepd::buffers::{HeapBuffers, Memory};
use sweepd::pipeline::{Config, Event, Pipeline};
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
        stream::push(&mut pipeline, &stream::datagram(&sent.payload, sent.arrival_ns));
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
#[ignore = "a sensor that does not see is not told yet"]
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
#[ignore = "a sensor that does not see is not told yet"]
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
    assert!(bits.len() > 15 && bits.iter().all(|&bits| bits == 0), "{bits:x?}");
}

#[test]
fn no_scene_is_called_a_fault() {
    for setting in Setting::ALL {
        let (scene, emitter) = sensor(setting, Model::Vlp16, 4.0);
        let bits = turns(&scene, emitter, Config::default());
        let are_clear = bits.iter().all(|&bits| bits == 0);
        assert!(bits.len() > 35 && are_clear, "{}: {bits:x?}", setting.name());
    }
}
