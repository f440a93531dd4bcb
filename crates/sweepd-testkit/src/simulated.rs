//! Sweeps of a simulated sensor, scored by what the simulator knows of every return.

use sweepd::pipeline::Config;
use sweepd::segment::{self, Mount};
use sweepd::sensor::Model;
use sweepd::sweep::layout::flags;
use sweepd::wire::data::ReturnMode;
use sweepd_lab::score::{ScanScore, Truth};
use sweepd_lab::simulate::{
    Class, Emitter, EmitterConfig, PacketTruth, ReturnTruth, Setting, SimulatedDatagram,
};

use super::run::{Placed, Run};

/// Where the head points at the first shot: a sixth of a turn before the cut.
const START_DEG: f64 = 300.0;

/// What a sensor sends from a scene.
pub struct Simulated {
    config: EmitterConfig,
    sent: Vec<SimulatedDatagram>,
}

impl Simulated {
    /// Of a scene that stands around the sensor: only what moves in it differs from turn to turn.
    pub fn new(model: Model, setting: Setting, seed: u64, turns: f64) -> Self {
        Self::mounted(model, setting, seed, turns, &Mount::default())
    }

    /// The same of a sensor that is mounted like this.
    pub fn mounted(model: Model, setting: Setting, seed: u64, turns: f64, mount: &Mount) -> Self {
        let mut config = EmitterConfig::new(model, ReturnMode::Strongest).turns(turns);
        let scene = setting.build(seed);
        config.pose = setting
            .mounted(&scene, 0, mount)
            .expect("a sensor in the open");
        config.seed = seed;
        // So that no jitter decides whether the first sweep is whole.
        config.encoder.start_deg = START_DEG;
        let sent = Emitter::new(config.clone(), &scene).collect();
        Self { config, sent }
    }

    /// The sweeps, labelled from the first packet on by one configuration.
    pub fn run(&self, segment: &segment::Config) -> Run {
        let calibration = self
            .config
            .model
            .is_hdl64e()
            .then(|| self.config.beams().into_owned());
        let config = Config {
            calibration,
            segment: segment.clone(),
            ..Config::default()
        };
        Run::of_datagrams_with(config, self.sent.iter().map(SimulatedDatagram::datagram))
    }

    /// The truth of the data packets.
    fn truth(&self) -> Vec<&PacketTruth> {
        let truths = self.sent.iter().map(|sent| sent.truth.as_deref());
        truths.flatten().collect()
    }

    /// The returns of a run, each with the truth of it.
    pub fn seen(&self, run: &Run) -> Vec<(Placed, ReturnTruth)> {
        let truth = self.truth();
        let with_truth = |placed: Placed| {
            let truth = *truth_of(&truth, &placed);
            (placed, truth)
        };
        run.returns().into_iter().map(with_truth).collect()
    }

    /// Scores of the whole sweeps, labelled from the first packet on by one configuration.
    pub fn score(&self, segment: &segment::Config, min_points: u32) -> Vec<ScanScore> {
        let (run, truth) = (self.run(segment), self.truth());
        let (views, returns) = (run.views(), run.returns());
        let whole = |sweep: &&[Placed]| !views[sweep[0].sweep].header.has(flags::PARTIAL);
        let score = |sweep: &[Placed]| score_sweep(sweep, &truth, min_points);
        returns
            .chunk_by(|a, b| a.sweep == b.sweep)
            .filter(whole)
            .map(score)
            .collect()
    }
}

/// What a return really was.
fn truth_of<'a>(truth: &[&'a PacketTruth], placed: &Placed) -> &'a ReturnTruth {
    let records = &truth[placed.found.packet as usize].returns[usize::from(placed.found.block)];
    records[placed.record]
        .as_ref()
        .expect("a return that was sent")
}

fn score_sweep(sweep: &[Placed], truth: &[&PacketTruth], min_points: u32) -> ScanScore {
    let point = |placed: &Placed| {
        let [x, y, z] = placed.found.point_m.map(|length| length as f32);
        [x, y, z, 0.0]
    };
    let points: Vec<[f32; 4]> = sweep.iter().map(point).collect();
    let labels: Vec<u32> = sweep.iter().map(|placed| placed.found.label).collect();
    let known = |placed: &Placed| true_label(truth_of(truth, placed));
    let truth =
        Truth::new(&points, sweep.iter().map(known).collect()).expect("a true label a point");
    ScanScore::new(&truth, &labels, &[min_points]).expect("a label a point")
}

/// The true label in the manner of SemanticKITTI: class, and number of the instance. A post, a
/// sign, a table are things of their own here, of the class of what is none of the others (20).
fn true_label(truth: &ReturnTruth) -> u32 {
    let (class, is_thing) = match truth.class {
        Class::Unknown => (0, false),
        Class::Ground => (40, false),
        Class::Building => (50, false),
        Class::Tree => (70, false),
        Class::Car => (10, true),
        Class::Lorry => (18, true),
        Class::Person => (30, true),
        Class::Cyclist => (31, true),
        Class::Pole | Class::Sign | Class::Furniture | Class::Pallet => (20, true),
    };
    if is_thing {
        truth.object << 16 | class
    } else {
        class
    }
}
