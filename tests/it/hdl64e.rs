//! HDL-64E units, each with beams of its own: what is flat is flat, what is upright stands in one
//! column, and the beams are known as soon as the unit has told them.

use std::collections::{BTreeMap, BTreeSet};

use sweepd::cure;
use sweepd::files;
use sweepd::pipeline::{Config, Fault, Notice};
use sweepd::sensor::{Calibration, Model, ModelExt};
use sweepd::sweep::SweepRef;
use sweepd::sweep::layout::flags;
use sweepd::wire::data::ReturnMode;
use sweepd_lab::simulate::optics::Optics;
use sweepd_lab::simulate::scene::Surface;
use sweepd_lab::simulate::shape::{Shape, Vec3};
use sweepd_lab::simulate::{Class, Emitter, EmitterConfig, Scene, SimulatedDatagram};
use sweepd_testkit::run::{Run, Runner};

/// The real units, if they are there, with the name of each.
fn units() -> Vec<(&'static str, Calibration)> {
    let folder = sweepd_testkit::data_dir().join("calib");
    sweepd_testkit::HDL64E_UNITS
        .map(|name| (name, files::calibration(&folder.join(name)).unwrap()))
        .into()
}

/// A flawless sensor of this unit, so high above the ground, from a third of a turn before azimuth
/// 0 on.
fn exact(calibration: &Calibration, height_m: f64) -> EmitterConfig {
    let mut config = EmitterConfig::new(Model::Hdl64eS2, ReturnMode::Strongest);
    config.calibration = Some(calibration.clone());
    config.pose.origin = Vec3::new(0.0, 0.0, height_m);
    (config.encoder.start_deg, config.encoder.jitter_deg) = (240.0, 0.0);
    config.optics = Optics::perfect(120.0);
    config.turns(1.4)
}

fn run(config: EmitterConfig, scene: &Scene) -> Run {
    let given = Config {
        calibration: config.calibration.clone(),
        ..Config::default()
    };
    let sent: Vec<SimulatedDatagram> = Emitter::new(config, scene).collect();
    Run::of_datagrams_with(given, sent.iter().map(SimulatedDatagram::datagram))
}

/// The sweep from cut to cut.
fn whole(run: &Run) -> SweepRef<'_> {
    run.views()
        .into_iter()
        .find(|view| view.header.has(flags::CIRCULAR))
        .expect("a whole turn")
}

/// A wall 10 m ahead and flat ground: all beams agree where they are.
#[test]
#[cfg_attr(without_captures, ignore = "no captures")]
fn walls_and_ground_are_flat() {
    let units = units();
    for (name, calibration) in units {
        let mut scene = Scene::new([0.0; 2], 20);
        let wall = Shape::cuboid([0.0, 10.5, 0.0], [30.0, 1.0, 40.0], 0.0);
        scene.add(Class::Building, Vec3::zeros(), [(wall, Surface::Plain(50))]);
        let run = run(exact(&calibration, 1.9), &scene);
        let (mut wall_m, mut ground_m) = (0.0_f64, 0.0_f64);
        let (mut on_wall, mut on_ground) = (BTreeSet::new(), BTreeSet::new());
        for found in whole(&run).returns() {
            let [x, y, z] = found.point_m;
            // Not where wall and ground meet.
            if (9.0..11.0).contains(&y) && z > -1.85 && x.abs() < 10.0 {
                wall_m = wall_m.max((y - 10.0).abs());
                on_wall.insert(found.channel);
            } else if y < 9.5 && z < -1.5 && x.hypot(y) < 30.0 {
                ground_m = ground_m.max((z + 1.9).abs());
                on_ground.insert(found.channel);
            }
        }
        println!(
            "{name}: wall {wall_m:.5} m off with {} beams, ground {ground_m:.5} m",
            on_wall.len()
        );
        assert!(
            wall_m < 0.005 && ground_m < 0.005,
            "{name}: {wall_m} {ground_m}"
        );
        // The steepest beams meet the ground before the wall, the flattest never.
        assert!(
            on_wall.len() >= 30 && on_wall.union(&on_ground).count() == 64,
            "{name}"
        );
    }
}

/// A pole one pitch wide at 40 m, from far below the sensor to far above: all rows see it in the
/// same columns, though beams that are neighbours in elevation are up to 18 degrees apart when they
/// fire.
#[test]
#[cfg_attr(without_captures, ignore = "no captures")]
fn a_pole_stands_in_one_column() {
    let units = units();
    for (name, calibration) in units {
        // 40 m away, at an azimuth that no fold of the image is near.
        let (away_m, azimuth_rad) = (40.0_f64, 1.2_f64);
        let pitch_rad = (600.0_f64 * 6.0).to_radians() * 48e-6;
        let place = [away_m * azimuth_rad.sin(), away_m * azimuth_rad.cos(), 0.0];
        let mut scene = Scene::new([0.0; 2], 20);
        let pole = Shape::cylinder(place, away_m * pitch_rad / 2.0, 60.0);
        scene.add(Class::Pole, Vec3::zeros(), [(pole, Surface::Plain(50))]);
        let config = exact(&calibration, 30.0);
        let run = run(config, &scene);
        let sweep = whole(&run);
        let (mut columns, mut firings, mut rows) =
            (BTreeSet::new(), BTreeSet::new(), BTreeSet::new());
        for found in sweep.returns().filter(|found| found.point_m[2] > -25.0) {
            let [x, y, _] = found.point_m;
            assert!(
                (x - place[0]).hypot(y - place[1]) < 0.1,
                "{name}: {found:?}"
            );
            columns.insert(found.column);
            firings.insert(sweep.fired_in(found.row, found.column));
            rows.insert(found.row);
            // Half a column by the rounding of the shift, half by the width of the pole, and the
            // beam's own way aside.
            let aside_rad = f64::from(sweep.beams[found.row].horizontal_offset_m).abs() / away_m;
            let off_rad = f64::from(sweep.columns[found.column].azimuth_rad) - azimuth_rad;
            assert!(
                off_rad.abs() < pitch_rad * 1.02 + aside_rad,
                "{name}: {off_rad} {found:?}"
            );
        }
        let width = |set: &BTreeSet<usize>| set.last().unwrap() - set.first().unwrap() + 1;
        println!(
            "{name}: {} columns, fired in {}",
            width(&columns),
            width(&firings)
        );
        assert!(
            rows.len() == 64 && width(&columns) <= 3,
            "{name}: {columns:?}"
        );
        assert!(
            width(&firings) > 100,
            "{name}: without the shift {firings:?}"
        );
    }
}

/// A unit that was made up, from its first packet on.
fn made_up(model: Model, packets: u64) -> (EmitterConfig, Vec<SimulatedDatagram>) {
    let mut config = EmitterConfig::new(model, ReturnMode::Strongest);
    config.packets = packets;
    let sent = Emitter::new(config.clone(), &Scene::new([0.0; 2], 20)).collect();
    (config, sent)
}

#[test]
fn decoding_begins_when_the_unit_has_sent_its_calibration() {
    for model in [Model::Hdl64eS2, Model::Hdl64eS3] {
        let (config, sent) = made_up(model, 4_160 + 700);
        let mut runner = Runner::new(Config::default());
        let mut notices = Vec::new();
        for (index, one) in sent.iter().enumerate() {
            runner.push(&one.datagram()).unwrap();
            notices.extend(runner.notices().into_iter().map(|notice| (index, notice)));
            assert!(runner.sweeps.is_empty() || index >= 4_160, "{index}");
        }
        runner.end().unwrap();
        // Which series it is, the status tells in the course of the calibration.
        assert_eq!(notices[0].1, Notice::AwaitsCalibration);
        assert!(
            matches!(
                notices[1],
                (4_159, Notice::Calibrated { packets: 4_160, .. })
            ),
            "{notices:?}"
        );
        assert_eq!(notices.len(), 2);
        // The same as with the calibration that it has.
        let given = Config {
            calibration: config.calibration.or(Some(config_beams(model))),
            ..Config::default()
        };
        let run = Run::of_datagrams_with(given, sent.iter().map(SimulatedDatagram::datagram));
        let own = runner.finish();
        assert!(
            own.views()
                .iter()
                .all(|view| view.header.model == model.code())
        );
        let [own_points, points] = [&own, &run].map(points_by_place);
        assert!(own_points.len() > 700 * 6 * 40, "{}", own_points.len());
        for (place, point) in own_points {
            let apart = (0..3)
                .map(|axis| (point[axis] - points[&place][axis]).abs())
                .fold(0.0, f64::max);
            assert!(apart < 0.002, "{place:?}");
        }
        assert_eq!(own.counts.undecoded, 4_160);
    }
}

/// Points by packet, block and channel.
fn points_by_place(run: &Run) -> BTreeMap<(u64, u8, usize), [f64; 3]> {
    let views = run.views();
    let returns = views.iter().flat_map(|view| view.returns());
    returns
        .map(|found| ((found.packet, found.block, found.channel), found.point_m))
        .collect()
}

fn config_beams(model: Model) -> Calibration {
    EmitterConfig::new(model, ReturnMode::Strongest)
        .beams()
        .into_owned()
}

/// A unit that begins with two returns, 57.6 us a firing, and goes on with one: at 48 us or at
/// 57.6, which sources disagree about.
#[test]
fn the_timing_of_one_return_is_measured_after_a_switch_too() {
    let scene = Scene::new([0.0; 2], 20);
    for (spec, columns) in Model::Hdl64eS3.specs().iter().zip([2083, 1736]) {
        let mut config = EmitterConfig::new(Model::Hdl64eS3, ReturnMode::Dual);
        (config.spec, config.rpm) = (spec, 600.0);
        let config = config.seconds(0.5, Some(0.13));
        let given = Config {
            calibration: Some(config.beams().into_owned()),
            ..Config::default()
        };
        let sent: Vec<SimulatedDatagram> = Emitter::new(config, &scene).collect();
        let run = Run::of_datagrams_with(given, sent.iter().map(SimulatedDatagram::datagram));
        assert_eq!(
            (run.counts.lost, run.counts.unconfirmed, run.counts.late),
            (0, 0, 0)
        );
        let views = run.views();
        let whole: Vec<_> = views
            .iter()
            .filter(|view| view.header.has(flags::CIRCULAR))
            .collect();
        assert!(whole.len() >= 3, "{}", whole.len());
        for sweep in &whole[1..] {
            assert!(
                sweep.header.columns.abs_diff(columns) <= 2,
                "{}",
                sweep.header.columns
            );
            assert!(
                (sweep.header.rpm - 600.0).abs() < 1.0,
                "{}",
                sweep.header.rpm
            );
        }
    }
}

/// Byte of a data packet that says the type of its status, and the one after it, the value.
const STATUS_TYPE: usize = 1204;
/// Type of the packet that says the power of the lasers, and where in a dump it comes.
const POWER: (u8, usize) = (0xF8, 259 * 16 + 13);

/// A unit whose reflectivities are corrected already, as the power byte 0xA8 says.
fn normalised(packets: u64) -> (Calibration, Vec<SimulatedDatagram>) {
    let (config, mut sent) = made_up(Model::Hdl64eS2, packets);
    for one in sent
        .iter_mut()
        .filter(|one| one.payload[STATUS_TYPE] == POWER.0)
    {
        one.payload[STATUS_TYPE + 1] = 0xA8;
    }
    (config.beams().into_owned(), sent)
}

/// Returns whose reflectivity is not the byte that was sent, by packet.
fn corrected(run: &Run, sent: &[SimulatedDatagram]) -> Vec<u64> {
    let views = run.views();
    let returns = views.iter().flat_map(|view| view.returns());
    let is_other = |found: &sweepd::sweep::Return| {
        let record = usize::from(found.block) * 100 + 4 + found.channel % 32 * 3;
        found.reflectivity != sent[found.packet as usize].payload[record + 2]
    };
    returns.filter(is_other).map(|found| found.packet).collect()
}

#[test]
fn a_normalised_unit_is_not_corrected_from_the_packet_on_that_says_so() {
    let (file, sent) = normalised(4_160 + 700);
    let own = Run::of_datagrams(sent.iter().map(SimulatedDatagram::datagram));
    assert!(points_by_place(&own).len() > 700 * 6 * 40);
    assert_eq!(
        corrected(&own, &sent),
        [0; 0],
        "its power was told before its calibration was complete"
    );
    let given = Config {
        calibration: Some(file),
        ..Config::default()
    };
    let with_file = corrected(
        &Run::of_datagrams_with(given, sent.iter().map(SimulatedDatagram::datagram)),
        &sent,
    );
    // Until then nothing can tell it; the packets that wait for their order come with it.
    let (first, last) = (
        with_file.iter().min().copied(),
        with_file.iter().max().copied(),
    );
    assert!(
        first < Some(10) && last < Some(POWER.1 as u64) && last > Some(POWER.1 as u64 - 10),
        "{first:?} {last:?}"
    );
}

#[test]
fn what_a_unit_has_said_stays_known_over_a_reload() {
    let (file, sent) = normalised(4_160 + 1_400);
    let (before, after) = sent.split_at(4_160 + 700);
    for calibration in [None, Some(file)] {
        let config = Config {
            calibration,
            ..Config::default()
        };
        let mut runner = Runner::new(config.clone());
        before
            .iter()
            .for_each(|one| runner.push(&one.datagram()).unwrap());
        let mut runner = runner.reloaded(config);
        after
            .iter()
            .for_each(|one| runner.push(&one.datagram()).unwrap());
        assert_eq!(runner.notices(), []);
        runner.end().unwrap();
        let run = runner.finish();
        assert_eq!(
            (run.counts.data, run.counts.undecoded),
            (700, 0),
            "none waits for a dump"
        );
        assert!(points_by_place(&run).len() > 690 * 6 * 40);
        assert_eq!(corrected(&run, after), [0; 0]);
        // Points are those of one that never knew of a reload.
        let whole = Run::of_datagrams_with(
            Config::default(),
            sent.iter().map(SimulatedDatagram::datagram),
        );
        let whole = points_by_place(&whole);
        for ((packet, block, channel), point) in points_by_place(&run) {
            let apart = (0..3)
                .map(|axis| (point[axis] - whole[&(packet + 4_860, block, channel)][axis]).abs());
            assert!(
                apart.fold(0.0, f64::max) < 0.002,
                "packet {packet}, block {block}, channel {channel}"
            );
        }
    }
}

/// At a reload one unit is known, and another one sends from then on.
#[test]
fn a_unit_that_is_exchanged_at_a_reload_is_noticed() {
    let (_, sent) = made_up(Model::Hdl64eS2, 4_160 + 300);
    let known = || {
        let mut runner = Runner::new(Config::default());
        sent.iter()
            .for_each(|one| runner.push(&one.datagram()).unwrap());
        runner.reloaded(Config::default())
    };
    let mut config = EmitterConfig::new(Model::Hdl64eS2, ReturnMode::Strongest);
    (config.packets, config.seed) = (3 * 4_160, config.seed + 1);
    let scene = Scene::new([0.0; 2], 20);
    let own = config.beams().into_owned();
    let exchanged: Vec<_> = Emitter::new(config, &scene).collect();
    let mut runner = known();
    exchanged
        .iter()
        .for_each(|one| runner.push(&one.datagram()).unwrap());
    let notices = runner.notices();
    let [Notice::OtherCalibration { differences }] = &notices[..] else {
        panic!("{} notices", notices.len())
    };
    let channels: BTreeSet<usize> = differences.iter().map(|one| one.channel).collect();
    assert_eq!(channels.len(), 64, "all beams, each told once");
    // At the next reload the one that is there by now is known.
    let mut runner = runner.reloaded(Config::default());
    exchanged[..400]
        .iter()
        .for_each(|one| runner.push(&one.datagram()).unwrap());
    runner.end().unwrap();
    let given = Config {
        calibration: Some(own),
        ..Config::default()
    };
    let expected = Run::of_datagrams_with(
        given,
        exchanged[..400].iter().map(SimulatedDatagram::datagram),
    );
    let expected = points_by_place(&expected);
    let run = runner.finish();
    assert_eq!(run.counts.undecoded, 0);
    for (place, point) in points_by_place(&run) {
        let apart = (0..3)
            .map(|axis| (point[axis] - expected[&place][axis]).abs())
            .fold(0.0, f64::max);
        assert!(apart < 0.002, "{place:?}");
    }
    // While beams change, what was said may be of both: at a reload then, the calibration is
    // awaited.
    let mut runner = known();
    exchanged[..3_000]
        .iter()
        .for_each(|one| runner.push(&one.datagram()).unwrap());
    let mut runner = runner.reloaded(Config::default());
    exchanged[..100]
        .iter()
        .for_each(|one| runner.push(&one.datagram()).unwrap());
    assert_eq!(runner.notices(), [Notice::AwaitsCalibration]);
    // What was told of the one before is of no account for another model.
    let mut config = EmitterConfig::new(Model::Vlp16, ReturnMode::Strongest).turns(2.5);
    config.encoder.start_deg = 300.0;
    let mut runner = known();
    Emitter::new(config, &scene).for_each(|one| runner.push(&one.datagram()).unwrap());
    let run = runner.finish();
    assert!(
        run.views().len() >= 2
            && run
                .views()
                .iter()
                .all(|view| view.header.model == Model::Vlp16.code())
    );
}

/// A file that is given at a reload is used, and held against what the unit had said before.
#[test]
fn a_file_that_comes_with_a_reload_takes_the_place_of_what_the_unit_said() {
    let (config, sent) = made_up(Model::Hdl64eS2, 4_160 + 300);
    let mut beams = config.beams().beams().to_vec();
    beams[17].rotation_rad += 0.05_f64.to_radians();
    let other = Calibration::new(beams, 0.002).unwrap();
    let (before, after) = sent.split_at(4_160 + 100);
    let mut runner = Runner::new(Config::default());
    before
        .iter()
        .for_each(|one| runner.push(&one.datagram()).unwrap());
    let mut runner = runner.reloaded(Config {
        calibration: Some(other.clone()),
        ..Config::default()
    });
    after
        .iter()
        .for_each(|one| runner.push(&one.datagram()).unwrap());
    let [Notice::OtherCalibration { differences }] = &runner.notices()[..] else {
        panic!("the file is compared")
    };
    assert_eq!(
        differences
            .iter()
            .map(|one| one.channel)
            .collect::<BTreeSet<_>>(),
        BTreeSet::from([17])
    );
    runner.end().unwrap();
    let given = Config {
        calibration: Some(other),
        ..Config::default()
    };
    let expected = Run::of_datagrams_with(given, after.iter().map(SimulatedDatagram::datagram));
    assert_eq!(
        points_by_place(&runner.finish()),
        points_by_place(&expected)
    );
}

#[test]
#[cfg_attr(without_captures, ignore = "no captures")]
fn an_incomplete_calibration_is_an_error_that_says_how_many_bytes_came() {
    let (_, sent) = made_up(Model::Hdl64eS2, 4_000);
    let mut runner = Runner::new(Config::default());
    sent.iter()
        .for_each(|one| runner.push(&one.datagram()).unwrap());
    let fault = runner.end().unwrap_err();
    assert!(
        matches!(
            fault,
            Fault::Uncalibrated {
                known: 1_750,
                of: 1_820
            }
        ),
        "{fault}"
    );
    let explained = cure::explain(&fault, cure::Dialect::CommandLine);
    assert!(
        explained.ends_with("give the file of this unit with --calibration"),
        "{explained}"
    );
}

#[test]
fn the_file_of_another_unit_is_noticed_and_its_beams_are_named() {
    let (_, sent) = made_up(Model::Hdl64eS3, 4_300);
    let mut beams = config_beams(Model::Hdl64eS3).beams().to_vec();
    beams[17].rotation_rad += 0.05_f64.to_radians();
    beams[40].distance_offset_m += 0.004;
    let other = Calibration::new(beams, 0.002).unwrap();
    let mut runner = Runner::new(Config {
        calibration: Some(other),
        ..Config::default()
    });
    let mut notices = Vec::new();
    for one in &sent {
        runner.push(&one.datagram()).unwrap();
        notices.extend(runner.notices());
    }
    let [Notice::OtherCalibration { differences }] = &notices[..] else {
        panic!("{notices:?}")
    };
    assert_eq!(
        differences
            .iter()
            .map(|one| one.channel)
            .collect::<BTreeSet<_>>(),
        BTreeSet::from([17, 40])
    );
}
