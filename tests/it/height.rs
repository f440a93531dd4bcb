//! The height that sweeps show, and what is in doubt about it: the naive twin says the same.

use std::collections::BTreeMap;
use std::f64::consts::{PI, TAU};
use std::path::{Path, PathBuf};

use fastrand::Rng;
use sweepd::assemble::levels;
use sweepd::buffers::HeapBuffer;
use sweepd::pipeline;
use sweepd::segment::{Config, Mount, Segmenter};
use sweepd::sensor::Model;
use sweepd::sweep::SweepMut;
use sweepd::sweep::height::HeightDoubt;
use sweepd::sweep::layout::Header;
use sweepd::sweep::layout::flags::{HEIGHT_ESTIMATED, HEIGHT_IN_DOUBT};
use sweepd_core::floor::{FloorFinder, Sight};
use sweepd_lab::cast::{Drawn, Ground, Scene, Sector, Sensor, Solid};
use sweepd_lab::cloud::{COLUMNS, CloudProjector, points};
use sweepd_lab::simulate::Setting;
use sweepd_lab::twin;

use sweepd_testkit::{cases, data_dir, data_dir_if_any, run::Runner, simulated::Simulated};

/// Height, if one is said, and doubt.
type Said = (Option<f32>, u32);

/// Whether there is time for more cases.
const IS_SLOW: bool = cfg!(feature = "slow-tests");

/// What a header says.
fn said(header: &Header) -> Said {
    let height_m = Some(header.height_m).filter(|height_m| *height_m > 0.0);
    assert_eq!(header.has(HEIGHT_ESTIMATED), height_m.is_some());
    assert_eq!(header.has(HEIGHT_IN_DOUBT), header.height_doubt != 0);
    (height_m, header.height_doubt)
}

/// The twin, and segmenters with all levels of vector instructions.
struct Held {
    twin: twin::Height,
    segmenters: Vec<Segmenter>,
}

impl Held {
    fn new(config: &Config) -> Self {
        let of_level = |level| Segmenter::with_level(config.clone(), level).unwrap();
        Self {
            twin: twin::Height::new(config),
            segmenters: levels().into_iter().map(of_level).collect(),
        }
    }

    /// What all say of the next sweep; the newest level labels it, too.
    #[track_caller]
    fn next(&mut self, sweep: &mut SweepMut<'_>, place: &str) -> Said {
        let naive = self.twin.labels_take(&sweep.as_ref());
        let (last, others) = self.segmenters.split_last_mut().unwrap();
        for segmenter in others {
            segmenter.find_height(sweep);
            assert_eq!(said(sweep.header), naive, "{place}");
        }
        last.segment(sweep);
        assert_eq!(said(sweep.header), naive, "{place}");
        naive
    }
}

/// A sensor over a floor, a deck, a step or a ramp, boxes around it, and what is said of its mount.
fn drawn(seed: u64) -> (Scene, Sensor, Mount) {
    let mut rng = Rng::with_seed(seed);
    let between = |rng: &mut Rng, from: f64, to: f64| from + (to - from) * rng.f64();
    let height_m = between(&mut rng, 0.15, 2.5);
    let ground = match rng.u32(..4) {
        0 => {
            let foot_m = between(&mut rng, 0.3, 3.0);
            vec![[foot_m, 0.0], [8.0, between(&mut rng, -1.0, 1.5)]]
        }
        1 => {
            let edge_m = between(&mut rng, 0.3, 4.0);
            vec![[edge_m, 0.0], [edge_m + 0.01, between(&mut rng, -0.5, 0.5)]]
        }
        2 => {
            let slope = between(&mut rng, -0.15, 0.15);
            let ends_m = [between(&mut rng, -20.0, -0.5), between(&mut rng, 0.5, 20.0)];
            ends_m.map(|y| [y, slope * y]).to_vec()
        }
        _ => vec![[0.0, 0.0]],
    };
    let mut scene = Scene::of_ground(Ground(ground));
    scene.walls_m = [1.0, 3.0, 10.0, f64::INFINITY][rng.usize(..4)] * between(&mut rng, 1.0, 2.0);
    scene.ceiling_m = height_m + [0.5, 2.0, f64::INFINITY][rng.usize(..3)];
    for _ in 0..rng.u32(..10) {
        let away_m = between(&mut rng, 0.6, 6.0);
        let azimuth_rad = between(&mut rng, 0.0, TAU);
        scene.solids.push(Solid::Cuboid {
            middle_m: [azimuth_rad.sin() * away_m, azimuth_rad.cos() * away_m],
            size_m: [0, 1, 2].map(|_| between(&mut rng, 0.05, 2.0)),
            yaw_rad: rng.f64(),
        });
    }
    if rng.u32(..3) == 0 {
        let wide_m = between(&mut rng, 0.4, 5.0);
        scene.solids.push(Solid::Cuboid {
            middle_m: [0, 1].map(|_| between(&mut rng, -0.3, 0.3) * wide_m),
            size_m: [
                wide_m,
                between(&mut rng, 0.6, 1.0) * wide_m,
                between(&mut rng, 0.05, 0.9) * height_m,
            ],
            yaw_rad: 0.0,
        });
    }
    // Small images more often.
    let model = Drawn::MODELS[rng.usize(..7).saturating_sub(2)];
    let mut sensor = Sensor::new(model, height_m);
    sensor.noise_m = [0.003, 0.01, 0.03][rng.usize(..3)];
    let mut said = Mount::default();
    if rng.bool() {
        sensor.pitch_rad = between(&mut rng, -0.25, 0.25);
        sensor.roll_rad = between(&mut rng, -0.25, 0.25);
        if rng.bool() {
            said.pitch_rad = sensor.pitch_rad as f32;
            said.roll_rad = sensor.roll_rad as f32;
        }
    }
    if rng.u32(..4) == 0 {
        sensor.roll_rad += PI;
        said.roll_rad += PI as f32;
    }
    (scene, sensor, said)
}

/// Each case is one place, then another one; of every fifth, a sector is seen.
#[test]
fn drawn_scenes() {
    let mut kinds: BTreeMap<u32, usize> = BTreeMap::new();
    let cases = if IS_SLOW { 1500 } else { 480 };
    for case in cases::chosen().take_while(|case| *case < cases) {
        let case = case as u64;
        let (scene, mut sensor, said) = drawn(case);
        let config = Config {
            mount: said,
            ..Config::default()
        };
        let mut held = Held::new(&config);
        let sector = Sector {
            half_rad: if case.is_multiple_of(5) { 1.0 } else { PI },
            ..Sector::TURN
        };
        for seed in 1..=3 {
            sensor.seed = seed;
            let (mut bytes, _) = sensor.scan(&scene, &sector);
            let mut sweep = SweepMut::open(bytes.as_mut()).unwrap();
            let place = format!("case {case}, {}, sweep {seed}", sensor.model);
            let (_, doubt) = held.next(&mut sweep, &place);
            *kinds.entry(doubt & 15).or_default() += 1;
        }
    }
    // All doubts that one place can show; decks alone, and what is seen below a floor, are rare.
    let is_shown = |kind: &u32| kinds.contains_key(kind);
    assert!(kinds.len() > 4, "{kinds:?}");
    assert!(
        !cases::are_all() || (1..10).all(|kind| is_shown(&kind)),
        "{kinds:?}"
    );
}

/// A sensor that is lifted, lowered or carried elsewhere now and then, for longer than looks are
/// remembered.
#[test]
fn sensors_that_do_not_stay() {
    let mut kinds: BTreeMap<u32, usize> = BTreeMap::new();
    let cases = if IS_SLOW { 60 } else { 8 };
    for case in cases::chosen().take_while(|case| *case < cases) {
        let case = case as u64;
        let mut rng = Rng::with_seed(case);
        let (mut scene, mut sensor, said) = drawn(1_000 + case);
        let config = Config {
            mount: said,
            ..Config::default()
        };
        let mut held = Held::new(&config);
        let (mut bytes, _) = sensor.scan(&scene, &Sector::TURN);
        for number in 0..250 {
            // The others are not looked at.
            if number < 5 || number % 10 == 0 {
                match rng.u32(..5) {
                    0 => sensor.height_m = (sensor.height_m + rng.f64() - 0.5).clamp(0.15, 3.0),
                    1 => scene = drawn(rng.u64(..1_000)).0,
                    _ => {}
                }
                sensor.seed = number;
                (bytes, _) = sensor.scan(&scene, &Sector::TURN);
            }
            let mut sweep = SweepMut::open(bytes.as_mut()).unwrap();
            let (_, doubt) = held.next(&mut sweep, &format!("case {case}, sweep {number}"));
            *kinds.entry(doubt & 15).or_default() += 1;
        }
    }
    let is_shown = |kind: &u32| kinds.contains_key(kind);
    assert!(
        !cases::are_all() || [0, 10, 11].iter().all(is_shown),
        "{kinds:?}"
    );
}

/// What a pipeline wrote, which begins turns before they are complete, is what all say.
#[track_caller]
fn check(sweeps: &mut [HeapBuffer], config: &Config, place: &str) {
    let mut held = Held::new(config);
    for (number, buffer) in sweeps.iter_mut().enumerate() {
        let mut sweep = SweepMut::open(buffer.as_mut()).unwrap();
        let place = format!("{place}, sweep {number}");
        let live = said(sweep.header);
        assert_eq!(live, held.next(&mut sweep, &place), "{place}, live");
    }
}

/// Upright and head down, as it is said and a little tilted.
#[test]
fn simulated_sensors() {
    let models = [
        Model::Vlp16,
        Model::Hdl32e,
        Model::Vlp32c,
        Model::Hdl64eS2,
        Model::Hdl64eS3,
        Model::Vls128,
    ];
    for (number, setting) in Setting::ALL.into_iter().enumerate() {
        for (other, model) in models.into_iter().enumerate() {
            for (way, roll_rad) in [0.0, PI as f32].into_iter().enumerate() {
                for (height, height_m) in [None, Some(0.8), Some(2.4)].into_iter().enumerate() {
                    let case = number + other + 3 * way + height;
                    // Of each model and each setting two.
                    let is_chosen = if IS_SLOW {
                        cases::has(number + other + 6 * (way + 2 * height))
                    } else {
                        number == other && case % 3 == 0
                    };
                    if !is_chosen {
                        continue;
                    }
                    let said = Mount {
                        roll_rad,
                        ..Mount::default()
                    };
                    let tilt_rad = [0.0, 0.04, -0.1][case % 3];
                    let mount = Mount {
                        height_m,
                        pitch_rad: tilt_rad,
                        roll_rad: roll_rad + tilt_rad / 2.0,
                    };
                    let scene = setting.build(1);
                    if setting.mounted(&scene, 0, &mount).is_err() {
                        continue;
                    }
                    let config = Config {
                        mount: said,
                        ..Config::default()
                    };
                    let turns = if IS_SLOW { 4.3 } else { 1.3 };
                    let mut run = Simulated::mounted(model, setting, 1, turns, &mount).run(&config);
                    check(
                        &mut run.sweeps,
                        &config,
                        &format!("{model}, {}, {mount:?}", setting.name()),
                    );
                }
            }
        }
    }
}

/// How many heights by one turn are right, by doubt, and which are neither right nor in doubt.
#[derive(Default)]
struct Found {
    of: usize,
    right: usize,
    sure: usize,
    wrong: Vec<String>,
}

/// The simulator knows the height. Right is within 5 % or 3 cm.
#[test]
fn heights_of_simulated_scenes_are_right_or_in_doubt() {
    let models = [
        Model::Vlp16,
        Model::PuckHiRes,
        Model::Vlp32c,
        Model::Hdl32e,
        Model::Hdl64eS2,
        Model::Vls128,
    ];
    let mut found = [Found::default(), Found::default()];
    for setting in Setting::ALL {
        for model in &models[..if cases::are_all() { models.len() } else { 2 }] {
            for height_m in [0.3, 0.8, 1.2, 2.0] {
                for (found, roll_rad) in found.iter_mut().zip([0.0, PI as f32]) {
                    let mount = Mount {
                        height_m: Some(height_m),
                        pitch_rad: 0.0,
                        roll_rad,
                    };
                    // Most are wrong where walls are near.
                    let is_corridor = setting.name() == "corridor";
                    let is_possible = setting.mounted(&setting.build(2), 0, &mount).is_ok();
                    if is_possible && (cases::are_all() || is_corridor) {
                        let said = Mount {
                            height_m: None,
                            ..mount
                        };
                        let place = format!("{model}, {}, {height_m} m", setting.name());
                        found.add(&one_turn(*model, setting, &mount, said), height_m, place);
                    }
                }
            }
        }
    }
    for (found, way) in found.iter().zip(["upright", "head down"]) {
        let Found {
            of,
            right,
            sure,
            wrong,
        } = found;
        println!("{way}: {right} of {of} right, {sure} of these sure; wrong and sure: {wrong:?}");
    }
    // From 2 m up between walls, some see no floor.
    let least_percent = if cases::are_all() { [95, 83] } else { [75, 60] };
    for (found, least_percent) in found.iter().zip(least_percent) {
        assert!(100 * found.right >= least_percent * found.of);
        assert!(100 * found.sure >= (least_percent - 2) * found.of);
    }
    // The street is bent.
    let [upright, head_down] = found.map(|found| found.wrong);
    assert!(upright.is_empty() && head_down.iter().all(|place| place.contains("street")));
    assert!(head_down.len() <= 1);
}

/// The floor by the first whole turn.
fn one_turn(model: Model, setting: Setting, mount: &Mount, said: Mount) -> Sight {
    let config = Config {
        mount: said,
        ..Config::default()
    };
    let run = Simulated::mounted(model, setting, 2, 1.3, mount).run(&config);
    let mut finder = FloorFinder::new(&config);
    for sweep in run.views() {
        finder.look(&sweep);
    }
    assert_eq!(finder.looks(), 1, "a whole turn");
    finder.sight()
}

impl Found {
    fn add(&mut self, sight: &Sight, height_m: f32, place: String) {
        let found_m = sight.height_m().unwrap_or(0.0);
        let is_right = (found_m - height_m).abs() <= (0.05 * height_m).max(0.03);
        // One turn is one.
        let is_sure = matches!(sight.doubt(), Some(HeightDoubt::FewSweeps { .. }));
        self.of += 1;
        self.right += usize::from(is_right);
        self.sure += usize::from(is_right && is_sure);
        if !is_right && is_sure {
            self.wrong.push(format!("{place}: {found_m}"));
        }
    }
}

/// Fixtures and, where there are some, captures of real sensors.
#[test]
fn captures() {
    let fixtures = Path::new(env!("CARGO_MANIFEST_DIR")).join("pcap_fixtures");
    let mut files: Vec<PathBuf> = [
        "street_vlp16_losses.pcap",
        "street_hdl64e_s3_switch.pcap.gz",
    ]
    .map(|name| fixtures.join(name))
    .to_vec();
    if let Some(data) = data_dir_if_any() {
        files.extend(
            ["vlp16_timm-dual-a", "hdl32e_veloview-monterey-a"]
                .map(|name| data.join(format!("pcap/{name}.pcap"))),
        );
    }
    if IS_SLOW {
        let folders = [
            Some(fixtures),
            data_dir_if_any().map(|data| data.join("pcap")),
        ];
        let entries = folders
            .into_iter()
            .flatten()
            .flat_map(|folder| folder.read_dir().unwrap());
        let paths = entries.map(|entry| entry.unwrap().path());
        files = paths
            .filter(|path| path.to_string_lossy().contains(".pcap"))
            .collect();
    }
    for file in &files {
        let mut runner = Runner::new(pipeline::Config::default());
        let place = file.display().to_string();
        if let Err(fault) = runner.play(file) {
            // These end before their calibration is there.
            let ends_early = ["_s3_switch", "_s3_dual"]
                .iter()
                .any(|name| place.contains(name));
            assert!(ends_early, "{place}: {fault}");
        }
        check(&mut runner.sweeps, &Config::default(), &place);
        let has_none = ["_s3_switch", "_s3_dual", "_gadomski"]
            .iter()
            .any(|name| place.contains(name));
        assert!(has_none || !runner.sweeps.is_empty(), "{place}");
    }
}

#[test]
#[cfg_attr(without_captures, ignore = "no captures")]
fn labelled_scans() {
    let sequences = ["04", "00", "02", "06", "08", "10"];
    for sequence in &sequences[..if IS_SLOW { 6 } else { 1 }] {
        let mut projector = CloudProjector::new(COLUMNS).unwrap();
        let mut held = Held::new(&Config::default());
        for frame in ["000000", "000004", "000009"] {
            let scan = format!("labelled/semantickitti/{sequence}/{frame}.bin");
            let bytes = std::fs::read(data_dir().join(&scan)).unwrap();
            let mut sweep = projector.project(&points(&bytes).unwrap()).unwrap();
            held.next(&mut sweep, &scan);
        }
    }
}
