//! Returns that are removed, against a robot whose place the simulator knows, and against plain
//! sweeps.

use std::collections::{HashMap, HashSet};

use sweepd::assemble::{BodyBox, Removal};
use sweepd::pipeline::Config;
use sweepd::segment::Mask;
use sweepd::sensor::Model;
use sweepd::sweep::Return;
use sweepd::wire::data::ReturnMode;
use sweepd_lab::simulate::scene::Surface;
use sweepd_lab::simulate::shape::{Shape, Vec3};
use sweepd_lab::simulate::{Class, Emitter, EmitterConfig, Scene, SimulatedDatagram};
use sweepd_testkit::stream;

use sweepd_testkit::run::Run;

/// The sensor in the frame of the robot, which is that of the scene: 0.2 m right, 0.3 m ahead, 1.4 m
/// up, turned clockwise.
const ORIGIN_M: [f64; 3] = [0.2, 0.3, 1.4];
const HEADING_RAD: f64 = 0.6;
/// A part of the robot behind it: 1 m wide, 0.4 m long, from 0.9 m to 1.5 m up.
const LEAST_M: [f64; 3] = [-0.4, -1.3, 0.9];
const MOST_M: [f64; 3] = [0.6, -0.9, 1.5];
/// What noise, the beams' origins beside the axis and the two-point correction may come to, metres.
const SLACK_M: f64 = 0.07;

fn scene() -> Scene {
    let mut scene = Scene::new([0.0; 2], 20);
    for (base, size) in [
        ([0.1, -1.1, 0.9], [1.0, 0.4, 0.6]),
        ([0.0, -1.8, 0.0], [0.4, 0.4, 1.6]),
        ([0.0, 6.0, 0.0], [8.0, 0.3, 3.0]),
    ] {
        let shape = Shape::cuboid(base, size, 0.0);
        scene.add(
            Class::Furniture,
            Vec3::zeros(),
            [(shape, Surface::Plain(40))],
        );
    }
    scene
}

fn sensor(model: Model, mode: ReturnMode) -> EmitterConfig {
    let mut config = EmitterConfig::new(model, mode).turns(2.4);
    config.pose.origin = Vec3::from(ORIGIN_M);
    config.pose.heading_rad = HEADING_RAD;
    config
}

fn config(sensor: &EmitterConfig, removal: Removal) -> Config {
    Config {
        calibration: Some(sensor.beams().into_owned()),
        position_m: ORIGIN_M.map(|metres| metres as f32),
        yaw_rad: -HEADING_RAD as f32,
        removal,
        ..stream::config()
    }
}

/// Sweep, row, column and kind: the place of a return.
type Place = (usize, usize, usize, &'static str);

fn returns(run: &Run) -> HashMap<Place, Return> {
    let mut all = HashMap::new();
    for (number, sweep) in run.views().into_iter().enumerate() {
        assert_eq!(sweep.returns().count(), sweep.header.returns as usize);
        for one in sweep.returns() {
            let place = (number, one.row, one.column, one.kind.name());
            assert!(all.insert(place, one).is_none(), "{place:?}");
        }
    }
    all
}

/// The places that a run lacks of a plain one; what is left is as it was.
fn removed(plain: &HashMap<Place, Return>, run: &Run) -> HashSet<Place> {
    let left = returns(run);
    for (place, one) in &left {
        let before = &plain[place];
        let (range_m, bits) = (before.range_m, one.range_m.to_bits());
        assert_eq!(
            (range_m.to_bits(), before.reflectivity),
            (bits, one.reflectivity),
            "{place:?}"
        );
        assert_eq!(
            (before.packet, before.block),
            (one.packet, one.block),
            "{place:?}"
        );
    }
    let gone: HashSet<Place> = plain
        .keys()
        .filter(|place| !left.contains_key(*place))
        .copied()
        .collect();
    assert_eq!(run.counts.removed, gone.len() as u64);
    gone
}

/// How deep a point is in the box, metres; negative outside.
fn depth_m(point_m: [f64; 3]) -> f64 {
    let mut depth_m = f64::INFINITY;
    for axis in 0..3 {
        let within = (point_m[axis] - LEAST_M[axis]).min(MOST_M[axis] - point_m[axis]);
        depth_m = depth_m.min(within);
    }
    depth_m
}

/// A box takes what the simulator measured in it, and nothing else.
#[test]
fn a_box_takes_what_is_in_it() {
    for (model, mode) in [
        (Model::Vlp16, ReturnMode::Dual),
        (Model::Vls128, ReturnMode::Strongest),
        (Model::Hdl64eS3, ReturnMode::Dual),
    ] {
        let sensor = sensor(model, mode);
        let scene = scene();
        let sent: Vec<SimulatedDatagram> = Emitter::new(sensor.clone(), &scene).collect();
        let [least, most] = [LEAST_M, MOST_M];
        let corners = [most[0], least[1], most[2], least[0], most[1], least[2]];
        let boxes = vec![BodyBox::new(corners).unwrap()];
        let runs = [
            Removal::default(),
            Removal {
                boxes,
                ..Removal::default()
            },
        ]
        .map(|removal| {
            let datagrams = sent.iter().map(SimulatedDatagram::datagram);
            Run::of_datagrams_with(config(&sensor, removal), datagrams)
        });
        let plain = returns(&runs[0]);
        let gone = removed(&plain, &runs[1]);
        let truth: Vec<_> = sent.iter().filter_map(|one| one.truth.as_deref()).collect();
        let calibration = sensor.beams();
        let mut inside = 0;
        for placed in runs[0].returns() {
            let one = &placed.found;
            let records = &truth[one.packet as usize].returns[usize::from(one.block)];
            let true_return = records[placed.record].expect("a return that was sent");
            let beam = &calibration.beams()[one.channel];
            let (sin, cos) = (true_return.azimuth_rad + HEADING_RAD).sin_cos();
            let level_m = true_return.range_m * beam.elevation_rad.cos();
            let up_m = true_return.range_m * beam.elevation_rad.sin() + beam.vertical_offset_m;
            let [x, y, z] = ORIGIN_M;
            let depth_m = depth_m([x + level_m * sin, y + level_m * cos, z + up_m]);
            let place = (placed.sweep, one.row, one.column, one.kind.name());
            if depth_m.abs() > SLACK_M {
                assert_eq!(
                    gone.contains(&place),
                    depth_m > 0.0,
                    "{model}: {depth_m} {one:?}"
                );
            }
            inside += usize::from(depth_m > -SLACK_M);
        }
        assert!(
            gone.len() > 100 && gone.len() <= inside,
            "{model}: {} of {inside}",
            gone.len()
        );
    }
}

/// What a mask hides and what is out of the range limits, pixel by pixel.
#[test]
fn masks_and_limits_remove() {
    let sensor = sensor(Model::Vlp16, ReturnMode::Dual);
    let scene = scene();
    let sent: Vec<SimulatedDatagram> = Emitter::new(sensor.clone(), &scene).collect();
    let mut rng = fastrand::Rng::with_seed(45);
    let hidden: Vec<bool> = (0..90 * 16).map(|_| rng.u8(..4) == 0).collect();
    let mask = Mask::new(90, 16, &hidden).unwrap();
    let removals = [(false, false), (true, false), (false, true)];
    let runs = removals.map(|(masked, out_of_range)| {
        let removal = Removal {
            masked,
            out_of_range,
            boxes: Vec::new(),
        };
        let mut config = config(&sensor, removal);
        config.segment.mask = Some(mask.clone());
        (config.segment.min_range_m, config.segment.max_range_m) = (1.3, 6.0);
        Run::of_datagrams_with(config, sent.iter().map(SimulatedDatagram::datagram))
    });
    let plain = returns(&runs[0]);
    let views = runs[0].views();
    let [by_mask, by_range] = [&runs[1], &runs[2]].map(|run| removed(&plain, run));
    assert!(by_mask.len() > 1_000 && by_range.len() > 1_000);
    for (place, one) in &plain {
        let (sweep, row, column, _) = *place;
        let hides = mask.hides(row, views[sweep].azimuth_rad(row, column));
        assert_eq!(by_mask.contains(place), hides, "{one:?}");
        let is_out = !(1.3..=6.0).contains(&one.range_m);
        assert_eq!(by_range.contains(place), is_out, "{one:?}");
    }
    // What is gone had no label before: nothing changes for what is left.
    for run in &runs[1..] {
        for (sweep, view) in run.views().into_iter().enumerate() {
            assert!(view.label == views[sweep].label, "{sweep}");
        }
    }
}
