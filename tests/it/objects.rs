//! Objects while the head turns, through whole pipelines: each segment of each sweep once, with the
//! figures of its table.

use std::f32::consts::FRAC_PI_3;
use std::path::{Path, PathBuf};

use sweepd::admission::{DiscoveredSensors, Refused};
use sweepd::buffers::{HeapBuffers, Memory};
use sweepd::input::Capture;
use sweepd::pipeline::{Config, Event, Pipeline};
use sweepd::sensor::Model::{self, Hdl32e, Hdl64eS2, Hdl64eS3, Vlp16, Vlp32c, Vls128};
use sweepd::sweep::objects::why;
use sweepd::wire::Datagram;
use sweepd::wire::data::ReturnMode::Strongest;
use sweepd_lab::simulate::{Emitter, EmitterConfig, Rates, deliver, fixtures};
use sweepd_testkit::{
    data_dir_if_any,
    objects::{Listener, Tally},
    stream::push,
};

/// A pipeline that tells objects, and its listener.
struct Run {
    pipeline: Pipeline,
    memory: Memory<HeapBuffers>,
    listener: Listener,
}

impl Run {
    fn new(config: Config, what: &str) -> Self {
        let mut pipeline = Pipeline::new("test", config).unwrap();
        pipeline.find_objects(true);
        Self {
            pipeline,
            memory: Memory::new(HeapBuffers::default()),
            listener: Listener::new(what),
        }
    }

    /// Takes a datagram; looks for objects after it, or lets them gather.
    fn push(&mut self, datagram: &Datagram<'_>, gathers: bool) {
        push(&mut self.pipeline, datagram);
        if !gathers {
            self.pipeline.idle(None);
        }
        self.take_events();
    }

    fn end(mut self) -> (Tally, usize) {
        self.pipeline.end();
        self.take_events();
        let Listener { tally, sweeps, .. } = self.listener;
        println!("{}: {sweeps} sweeps, {tally:?}", self.listener.what);
        (tally, sweeps)
    }

    fn take_events(&mut self) {
        while self
            .listener
            .poll(&mut self.pipeline, &mut self.memory)
            .is_some()
        {}
    }
}

/// What tells an object, wherever the cut is.
struct Seen {
    why: u32,
    points: u32,
    azimuths_rad: [f32; 2],
    /// Of its last return.
    time_ns: i64,
    bounds_m: [[f32; 3]; 2],
}

impl Seen {
    fn is_like(&self, other: &Self) -> bool {
        let near = |(a, b): (&f32, &f32)| (a - b).abs() < 2e-3;
        let azimuths = self.azimuths_rad.iter().zip(&other.azimuths_rad);
        let mut bounds = self
            .bounds_m
            .as_flattened()
            .iter()
            .zip(other.bounds_m.as_flattened());
        self.points == other.points
            && azimuths.into_iter().all(near)
            && bounds.all(near)
            && self.time_ns.abs_diff(other.time_ns) < 1_000_000
    }
}

/// All that is told of some turns of a street that are cut there, in parts where it is wider.
fn told_with_cut(model: Model, cut_deg: f64, max_width_rad: f32) -> Vec<Seen> {
    let scene = fixtures::scene();
    let sensor = EmitterConfig::new(model, Strongest).turns(5.0);
    let calibration = model.is_hdl64e().then(|| sensor.beams().into_owned());
    let mut config = Config {
        calibration,
        cut_azimuth_rad: cut_deg.to_radians(),
        ..Config::default()
    };
    config.segment.mount.height_m = Some(1.9);
    config.segment.max_width_rad = max_width_rad;
    let mut pipeline = Pipeline::new("test", config).unwrap();
    pipeline.find_objects(true);
    let mut memory = Memory::new(HeapBuffers::default());
    let mut all = Vec::new();
    for sent in Emitter::new(sensor, &scene).untold() {
        push(&mut pipeline, &sent.datagram());
        pipeline.idle(None);
        while let Some(event) = pipeline.poll(&mut memory) {
            let Event::Objects(found) = event else {
                continue;
            };
            all.extend(found.objects.iter().map(|object| Seen {
                why: object.why,
                points: object.segment.points,
                azimuths_rad: [object.azimuth_first_rad, object.azimuth_last_rad],
                time_ns: found.time_ns + i64::from(object.last_ns),
                bounds_m: [object.segment.min_m, object.segment.max_m],
            }));
        }
    }
    all
}

/// Objects around the cut are segments of a table where the turns are cut elsewhere, and all such
/// segments that lie across the cut are told.
#[test]
fn objects_around_the_cut_are_told_whole() {
    let widths_rad = [5_f32.to_radians(), FRAC_PI_3, f32::INFINITY];
    for model in [Vlp16, Hdl32e, Hdl64eS2, Vlp32c, Vls128] {
        let across: usize = widths_rad
            .map(|width| around_cut(model, width))
            .iter()
            .sum();
        assert!(across > 3, "{model}: {across}");
    }
}

/// Compares what is told where turns are cut ahead and behind; gives how many objects lie across
/// the cut.
fn around_cut(model: Model, max_width_rad: f32) -> usize {
    let here = told_with_cut(model, 0.0, max_width_rad);
    let elsewhere = told_with_cut(model, 180.0, max_width_rad);
    let around = here.iter().filter(|seen| seen.why == why::SEAM);
    let around: Vec<&Seen> = around.collect();
    // Of the second turn and the third: the first has none before it.
    let begun_ns = here[0].time_ns;
    let turns_ns = begun_ns + 150_000_000..begun_ns + 350_000_000;
    let (mut across, mut close, mut close_told) = (0, 0, 0);
    for seen in &elsewhere {
        let [first_rad, last_rad] = seen.azimuths_rad;
        if seen.why != why::COMPLETE || !turns_ns.contains(&seen.time_ns) {
            continue;
        }
        let is_told = around.iter().any(|other| other.is_like(seen));
        if first_rad > 5.5 && last_rad < 0.8 {
            across += 1;
            assert!(is_told, "{model}: across the cut, {} points", seen.points);
        }
        // Up to where the strips of a turn begin with every model.
        if first_rad < 0.15 {
            close += 1;
            close_told += usize::from(is_told);
        }
    }
    let has_alike = |seen: &&&Seen| elsewhere.iter().any(|other| seen.is_like(other));
    let alike = around.iter().filter(has_alike).count();
    println!(
        "{model}, {:.0} degrees: {alike} of {} around the cut, {across} across it, {close_told} of {close} behind",
        max_width_rad.to_degrees(),
        around.len()
    );
    // Where rows are shifted, it may be by another column from turn to turn: then other returns
    // stand on each other, and some are ground in one turn alone. Parts are cut otherwise.
    let has_parts = max_width_rad < FRAC_PI_3;
    assert!(
        has_parts || 15 * alike >= 14 * around.len(),
        "{model}: {alike}"
    );
    assert!(
        10 * close_told >= 9 * close,
        "{model}: {close_told} of {close}"
    );
    across
}

fn captures() -> Vec<PathBuf> {
    let folders = [
        Some(Path::new(env!("CARGO_MANIFEST_DIR")).join("pcap_fixtures")),
        data_dir_if_any().map(|data| data.join("pcap")),
    ];
    let mut captures = Vec::new();
    for folder in folders.into_iter().flatten() {
        let files = std::fs::read_dir(folder).unwrap();
        let paths = files.map(|file| file.unwrap().path());
        captures.extend(paths.filter(|path| path.to_string_lossy().contains(".pcap")));
    }
    captures.sort();
    captures
}

#[test]
fn objects_of_captures_are_the_rows_of_their_tables() {
    let mut all = Tally::default();
    for capture in captures() {
        let what = capture.file_name().unwrap().to_string_lossy().into_owned();
        let mut file = Capture::open(&capture).unwrap();
        let mut sensors = DiscoveredSensors::new(Vec::new());
        let mut runs: Vec<(std::net::SocketAddr, Run)> = Vec::new();
        // Some seconds of each sensor are enough.
        for _ in 0..9000 {
            let Ok(Some(datagram)) = file.next_datagram() else {
                break;
            };
            if matches!(sensors.admit(&datagram), Err(Refused { sensor: None, .. })) {
                continue;
            }
            let source = datagram.source;
            let index = match runs.iter().position(|one| one.0.ip() == source.ip()) {
                Some(index) => index,
                None => {
                    runs.push((source, Run::new(Config::default(), &what)));
                    runs.len() - 1
                }
            };
            runs[index].1.push(&datagram, false);
        }
        for (_, run) in runs {
            all += run.end().0;
        }
    }
    // Most captures are short, and of the first turns the height is not known before their end.
    assert!(2 * all.early > all.with_sweep, "{all:?}");
    let has_captures = data_dir_if_any().is_some();
    assert!(!has_captures || all.around_sensor > 30, "{all:?}");
}

/// Every model on a street; with and without losses and late packets, looked at after each packet
/// and after random numbers of them.
#[test]
fn objects_of_all_models_are_the_rows_of_their_tables() {
    let models: [Model; 6] = [Vlp16, Hdl32e, Hdl64eS2, Hdl64eS3, Vlp32c, Vls128];
    let scene = fixtures::scene();
    for model in models {
        let sensor = EmitterConfig::new(model, Strongest).turns(4.0);
        let calibration = model.is_hdl64e().then(|| sensor.beams().into_owned());
        let mut config = Config {
            calibration,
            ..Config::default()
        };
        // From the first sweep on.
        config.segment.mount.height_m = Some(1.9);
        let mut rng = fastrand::Rng::with_seed(model as u64);
        for damage in [false, true] {
            let rates = Rates {
                loss: if damage { 0.01 } else { 0.0 },
                reorder: if damage { 0.003 } else { 0.0 },
                places: 9,
                ..Rates::default()
            };
            let sent = deliver(
                Emitter::new(sensor.clone(), &scene).untold(),
                rates.plan(5, sensor.packets),
            );
            let what = format!("{model}, damaged: {damage}");
            let mut run = Run::new(config.clone(), &what);
            for one in sent {
                run.push(&one.datagram(), damage && rng.u8(..) < 200);
            }
            let (tally, sweeps) = run.end();
            assert!(
                damage || 2 * tally.early > tally.with_sweep,
                "{what}: {tally:?}"
            );
            assert!(sweeps > 1, "{what}");
        }
    }
}
