//! A simulated sensor whose eye fails is told by the bits of the header; one that sees is not. A table shows
//! how near captures and scenes come to each limit.

use std::path::PathBuf;

use sweepd::admission::DiscoveredSensors;
use sweepd::buffers::{HeapBuffers, Memory};
use sweepd::input::Capture;
use sweepd::pipeline::{Config, Event, EyeMeasures, Pipeline};
use sweepd::segment::Mount;
use sweepd::sensor::Model;
use sweepd::sweep::SweepRef;
use sweepd::sweep::layout::flags;
use sweepd::wire::data::ReturnMode;
use sweepd_lab::simulate::{Emitter, EmitterConfig, EyeFault, EyeKind, Scene, Setting};
use sweepd_testkit::{cases::Cases, data_dir_if_any, root, stream};

/// Bits of the header, as docs/layout.md has them.
const BLIND: u32 = 0x100;
const COVERED: u32 = 0x200;
const FROZEN: u32 = 0x400;
const FADED: u32 = 0x800;
const DARK_BELOW: u32 = 0x1000;
const ALL: u32 = 0x1F00;

/// Length of a data packet, and where its stamp is: microseconds of the hour.
const DATA_LEN: usize = 1206;
const STAMP: std::ops::Range<usize> = 1200..1204;
const HOUR_US: i64 = 3_600_000_000;

/// Data packets and when they arrived.
type Stream = Vec<(Vec<u8>, i64)>;

/// A sensor of 600 turns a minute that stands in a scene.
fn sensor(setting: Setting, model: Model, turns: f64) -> (Scene, EmitterConfig) {
    let scene = setting.build(1);
    let mut config = EmitterConfig::new(model, ReturnMode::Strongest).turns(turns);
    config.pose = setting.pose(0);
    (scene, config)
}

fn simulated((scene, emitter): (Scene, EmitterConfig)) -> Stream {
    let mut stream = Stream::new();
    for sent in Emitter::new(emitter, &scene).untold() {
        if sent.payload.len() == DATA_LEN {
            stream.push((sent.payload.to_vec(), sent.arrival_ns));
        }
    }
    stream
}

/// Plays streams one after the other, as if one sensor had sent them: stamps go on.
struct Player {
    pipeline: Pipeline,
    memory: Memory<HeapBuffers>,
    /// Time of the next stream.
    elapsed_us: i64,
    /// The bits of each whole turn.
    bits: Vec<u32>,
    /// The nearest that turns came to each rule.
    nearest: EyeMeasures,
}

impl Player {
    fn new(config: Config) -> Self {
        Self {
            pipeline: Pipeline::new("test", config).unwrap(),
            memory: Memory::default(),
            elapsed_us: 0,
            bits: Vec::new(),
            nearest: EyeMeasures {
                returned: 1.0,
                near: 0.0,
                alike: 0.0,
                of_best: 1.0,
                below: 1.0,
            },
        }
    }

    fn play(&mut self, stream: &Stream) {
        let stamp = |payload: &[u8]| u32::from_le_bytes(payload[STAMP].try_into().unwrap());
        let first = (stamp(&stream[0].0), stream[0].1);
        let mut since_us = 0;
        for (payload, arrival_ns) in stream {
            since_us = (i64::from(stamp(payload)) - i64::from(first.0)).rem_euclid(HOUR_US);
            let mut payload = payload.clone();
            let stamp_us = (self.elapsed_us + since_us) % HOUR_US;
            payload[STAMP].copy_from_slice(&(stamp_us as u32).to_le_bytes());
            let arrival_ns = stream::START_NS + self.elapsed_us * 1000 + arrival_ns - first.1;
            stream::push(&mut self.pipeline, &stream::datagram(&payload, arrival_ns));
            self.poll();
        }
        // The next stream follows a packet later.
        self.elapsed_us += since_us + since_us / (stream.len() as i64 - 1);
    }

    fn poll(&mut self) {
        while let Some(event) = self.pipeline.poll(&mut self.memory) {
            let Event::Sweep(bytes) = event else { continue };
            let sweep = SweepRef::open(bytes.as_ref()).unwrap();
            if sweep.header.has(flags::PARTIAL | flags::STOPPED) {
                continue;
            }
            self.bits.push(sweep.header.flags & ALL);
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

    fn told(&self) -> u32 {
        self.bits.iter().fold(0, |all, bits| all | bits)
    }

    /// Prints its row of the table, and says whether nothing was told.
    fn row(&self, name: &str) -> bool {
        let EyeMeasures {
            returned,
            near,
            alike,
            of_best,
            below,
        } = self.nearest;
        let turns = self.bits.len();
        let told = match self.told() {
            0 => "",
            _ => " FAULT",
        };
        println!(
            "| {name} | {turns} | {returned:.2} | {near:.2} | {alike:.2} | {of_best:.2} | {below:.2} |{told}"
        );
        self.told() == 0
    }
}

/// The bits of each of its whole turns.
fn turns(sensor: (Scene, EmitterConfig), config: Config) -> Vec<u32> {
    let mut player = Player::new(config);
    player.play(&simulated(sensor));
    player.bits
}

#[test]
fn what_is_wrong_with_the_eye_is_told_within_ten_turns_and_a_few() {
    for (kind, bit, rpm) in [
        (EyeKind::Blind, BLIND, 600.0),
        (EyeKind::Cover, COVERED, 600.0),
        (EyeKind::Frozen, FROZEN, 600.0),
        (EyeKind::Faded, FADED, 300.0),
        (EyeKind::Faded, FADED, 1200.0),
        (EyeKind::Dark, DARK_BELOW, 300.0),
        (EyeKind::Sector, DARK_BELOW, 1200.0),
    ] {
        let (scene, mut emitter) = sensor(Setting::ParkingLot, Model::Vlp16, 1.0);
        emitter.rpm = rpm;
        let from_ns = (40.0 * 60e9 / rpm) as i64;
        emitter.eye = Some(EyeFault { kind, from_ns });
        let bits = turns((scene, emitter.turns(60.0)), Config::default());
        let first = bits.iter().position(|&bits| bits & bit != 0);
        let first = first.unwrap_or_else(|| panic!("{kind:?} is not told: {bits:x?}"));
        // At 5 turns a second 14 are less than 3 s.
        assert!((48..54).contains(&first), "{kind:?}: turn {first}");
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
        let (scene, mut emitter) = sensor(Setting::Street, Model::Vlp16, 20.0);
        emitter.eye = Some(EyeFault { kind, from_ns: 0 });
        let bits = turns((scene, emitter), Config::default());
        assert!(bits.last().is_some_and(|bits| bits & bit != 0), "{kind:?}");
    }
}

#[test]
fn returns_that_are_removed_are_not_missing() {
    let room = sensor(Setting::Room, Model::Vlp16, 20.0);
    let mut config = Config::default();
    config.removal.out_of_range = true;
    config.segment.min_range_m = 99.0;
    let bits = turns(room, config);
    assert!(
        bits.len() > 15 && bits.iter().all(|&bits| bits == 0),
        "{bits:x?}"
    );
}

#[test]
fn a_loop_of_two_turns_is_not_frozen_and_one_of_a_single_turn_is() {
    for (turns, told) in [(1, FROZEN), (2, 0)] {
        let (scene, mut emitter) = sensor(Setting::Street, Model::Vlp16, 1.0);
        // A turn is 75 packets of 24 firings, so that a loop has no seam.
        emitter.rpm = 60.0 / (75.0 * 24.0 * 55.296e-6);
        emitter.packets = 75 * turns;
        let stream = simulated((scene, emitter));
        let mut player = Player::new(Config::default());
        for _ in 0..30 / turns {
            player.play(&stream);
        }
        assert!(player.bits.len() > 20, "{turns}: {}", player.bits.len());
        assert_eq!(player.told(), told, "{turns} turns");
    }
}

#[test]
fn who_drives_out_of_a_hall_into_a_field_does_not_fade() {
    let config = || {
        let mut config = Config::default();
        config.eye.least_share = 0.8;
        config
    };
    let mut player = Player::new(config());
    player.play(&simulated(sensor(Setting::Corridor, Model::Vlp16, 40.0)));
    player.play(&simulated(sensor(Setting::Field, Model::Vlp16, 40.0)));
    assert_eq!((player.bits.len() > 75, player.told()), (true, 0));
}

#[test]
fn a_wall_nearer_than_can_be_measured_is_told_as_dark_and_one_beside_is_not() {
    let start = simulated(sensor(Setting::Corridor, Model::Vlp16, 20.0));
    for (away_m, told) in [(0.6, 0), (0.25, DARK_BELOW)] {
        let mut player = Player::new(Config::default());
        player.play(&start);
        player.play(&simulated(beside_wall(Model::Vlp16, away_m, 20.0)));
        assert_eq!(player.told(), told, "{away_m} m");
    }
}

/// A sensor in a corridor, this far from its wall.
fn beside_wall(model: Model, away_m: f64, turns: f64) -> (Scene, EmitterConfig) {
    let (scene, mut emitter) = sensor(Setting::Corridor, model, turns);
    let in_wall = (1..99)
        .step_by(2)
        .find(|&number| (Setting::Corridor.mounted(&scene, number, &Mount::default())).is_err());
    emitter.pose = Setting::Corridor.pose(in_wall.unwrap());
    emitter.pose.origin.x -= away_m;
    (scene, emitter)
}

/// All captures here and of others, by name.
fn captures() -> Vec<PathBuf> {
    let mut paths = Vec::new();
    let data = data_dir_if_any().map(|data| data.join("pcap"));
    for folder in [Some(root().join("pcap_fixtures")), data]
        .into_iter()
        .flatten()
    {
        for entry in folder.read_dir().unwrap() {
            let path = entry.unwrap().path();
            if path.to_string_lossy().contains(".pcap") {
                paths.push(path);
            }
        }
    }
    paths.sort();
    paths
}

fn captured(path: &PathBuf) -> Stream {
    let mut capture = Capture::open(path).unwrap();
    let mut sensors = DiscoveredSensors::default();
    let mut stream = Stream::new();
    while let Some(datagram) = capture.next_datagram().unwrap() {
        if sensors.admit(&datagram).is_ok() && datagram.payload.len() == DATA_LEN {
            stream.push((datagram.payload.to_vec(), datagram.arrival_ns));
        }
    }
    stream
}

/// In a loop, so that each rule has its turns; a capture of less than a turn tells nothing.
#[test]
#[cfg_attr(not(feature = "slow-tests"), ignore = "slow, and prints a table")]
fn no_capture_is_called_a_fault() {
    let mut is_clear = true;
    for path in captures() {
        let stream = captured(&path);
        if stream.len() < 50 {
            continue;
        }
        let mut player = Player::new(Config::default());
        for _ in 0..200 {
            if player.bits.len() >= 60 {
                break;
            }
            player.play(&stream);
        }
        if !player.bits.is_empty() {
            is_clear &= player.row(&path.file_name().unwrap().to_string_lossy());
        }
    }
    assert!(is_clear);
}

#[test]
#[cfg_attr(not(feature = "slow-tests"), ignore = "slow, and prints a table")]
fn no_scene_is_called_a_fault() {
    let (mut is_clear, mut cases) = (true, Cases::default());
    for setting in Setting::ALL {
        for model in [Model::Vlp16, Model::Hdl32e] {
            if !cases.takes() {
                continue;
            }
            let (scene, mut emitter) = sensor(setting, model, 45.0);
            emitter.motion.velocity.y = 0.3;
            let mut player = Player::new(Config::default());
            player.play(&simulated((scene, emitter)));
            is_clear &= player.row(&format!("{}, {model}", setting.name()));
        }
    }
    for away_m in [0.6, 0.45, 0.25] {
        if !cases.takes() {
            continue;
        }
        let mut player = Player::new(Config::default());
        player.play(&simulated(beside_wall(Model::Vlp16, away_m, 45.0)));
        is_clear &= player.row(&format!("corridor, VLP-16, {away_m} m from the wall"));
    }
    for height_m in [0.3, 4.0, 12.0] {
        if !cases.takes() {
            continue;
        }
        let (scene, mut emitter) = sensor(Setting::Field, Model::Vlp16, 45.0);
        emitter.pose.origin.z = height_m;
        let mut player = Player::new(Config::default());
        player.play(&simulated((scene, emitter)));
        is_clear &= player.row(&format!("field, VLP-16, {height_m} m high"));
    }
    let mut player = Player::new(Config::default());
    for setting in [
        Setting::Corridor,
        Setting::Warehouse,
        Setting::Field,
        Setting::Room,
    ] {
        player.play(&simulated(sensor(setting, Model::Vlp16, 40.0)));
    }
    is_clear &= player.row("corridor, warehouse, field and room, VLP-16, one after the other");
    assert!(is_clear);
}
