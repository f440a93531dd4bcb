//! Sweeps of real pipelines, of all kinds that a consumer meets.

use sweepd::admission::DiscoveredSensors;
use sweepd::buffers::HeapBuffer;
use sweepd::buffers::{Buffers, HeapBuffers, Memory};
use sweepd::input::Capture;
use sweepd::pipeline::{Config, Pipeline};
use sweepd::sensor::Model;
use sweepd::sweep::SweepRef;
use sweepd::sweep::layout::flags;
use sweepd::wire::data::ReturnMode;
use sweepd_lab::simulate::unit::unit;
use sweepd_testkit::stream::next_sweep;

use super::of_project;
use sweepd_testkit::stream::{Spin, config, datagram};

/// Where packets come from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Source {
    /// A street, with ground and segments, two returns.
    StreetVlp16Dual,
    /// Noise, by a unit whose beams point aside and bend.
    Hdl64e(ReturnMode),
    /// Noise, the last return.
    Vlp16Last,
}

pub const SOURCES: [Source; 4] = [
    Source::StreetVlp16Dual,
    Source::Hdl64e(ReturnMode::Strongest),
    Source::Hdl64e(ReturnMode::Dual),
    Source::Vlp16Last,
];

impl Source {
    /// Decodes it all into these buffers; each sweep is done by `done`.
    pub fn play<B: Buffers>(self, buffers: B, done: impl FnMut(B::Buffer)) {
        let noise = |model, mode| Spin {
            seed: 5,
            ..Spin::new(model, mode, 620.0)
        };
        match self {
            Self::StreetVlp16Dual => play_capture("street_vlp16_dual.pcap.gz", buffers, done),
            Self::Hdl64e(mode) => {
                let config = Config {
                    calibration: Some(unit(1)),
                    ..config()
                };
                play_spin(&noise(Model::Hdl64eS3, mode), config, buffers, done);
            }
            Self::Vlp16Last => play_spin(
                &noise(Model::Vlp16, ReturnMode::Last),
                config(),
                buffers,
                done,
            ),
        }
    }

    pub fn sweeps(self) -> Vec<HeapBuffer> {
        let mut sweeps = Vec::new();
        self.play(HeapBuffers::default(), |sweep| sweeps.push(sweep));
        assert!(sweeps.len() > 2, "{self:?}");
        sweeps
    }
}

fn play_spin<B: Buffers>(spin: &Spin, config: Config, buffers: B, mut done: impl FnMut(B::Buffer)) {
    let mut pipeline = Pipeline::new("192.168.1.201:2368", config).unwrap();
    let mut memory = Memory::new(buffers);
    for one in spin.packets(0.25) {
        pipeline.push(&datagram(one.packet.emit(), one.arrival_ns).parse().unwrap());
        std::iter::from_fn(|| next_sweep(&mut pipeline, &mut memory)).for_each(&mut done);
    }
    pipeline.end();
    std::iter::from_fn(|| next_sweep(&mut pipeline, &mut memory)).for_each(&mut done);
}

fn play_capture<B: Buffers>(file: &str, buffers: B, mut done: impl FnMut(B::Buffer)) {
    let mut pipeline = Pipeline::new("192.168.1.201:2368", Config::default()).unwrap();
    let mut memory = Memory::new(buffers);
    let mut capture = Capture::open(of_project("pcap_fixtures").join(file)).unwrap();
    let mut sensors = DiscoveredSensors::new(Vec::new());
    while let Some(datagram) = capture.next_datagram().unwrap() {
        if let Ok((_, packet)) = sensors.admit(&datagram) {
            pipeline.push(&packet);
        }
        std::iter::from_fn(|| next_sweep(&mut pipeline, &mut memory)).for_each(&mut done);
    }
    pipeline.end();
    std::iter::from_fn(|| next_sweep(&mut pipeline, &mut memory)).for_each(&mut done);
}

/// The tests that use these sweeps would be worth little if they had nothing of what they are to be
/// tested for.
#[test]
fn the_sweeps_have_all_that_a_consumer_meets() {
    let mut seen = [0; 9];
    for source in SOURCES {
        let sweeps = source.sweeps();
        for sweep in sweeps
            .iter()
            .map(|sweep| SweepRef::open(sweep.as_ref()).unwrap())
        {
            let is_bent = |row: usize| {
                sweep.beams[row].distance_offset_x_m != sweep.beams[row].distance_offset_m
            };
            let shifted = sweep.beams.iter().any(|beam| beam.shift != 0);
            let circular = sweep.header.has(flags::CIRCULAR);
            let near = sweep
                .returns()
                .filter(|one| is_bent(one.row))
                .map(|one| one.range_m.to_bits() & 1 == 1);
            let [near, far]: [Vec<bool>; 2] = near.partition(|&near| near).into();
            let is = [
                shifted && circular,
                shifted && !circular,
                sweep.header.margin_columns > 0,
                !near.is_empty() && !far.is_empty(),
                sweep
                    .beams
                    .iter()
                    .any(|beam| beam.vertical_offset_m != 0.0 && beam.horizontal_offset_m != 0.0),
                !sweep.range2.is_empty(),
                !sweep.segments.is_empty(),
                sweep.label.contains(&1) && sweep.label2.contains(&1),
                sweep.columns.iter().any(|column| !column.is_fired()),
            ];
            seen.iter_mut()
                .zip(is)
                .for_each(|(count, is)| *count += usize::from(is));
        }
    }
    assert!(!seen.contains(&0), "{seen:?}");
}
