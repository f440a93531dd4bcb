//! Beams that no longer return, in streams whose records are blanked, against a naive twin.

use std::collections::BTreeSet;

use sweepd::assemble::Removal;
use sweepd::buffers::{HeapBuffers, Memory};
use sweepd::pipeline::{Config, DarkBeam, Pipeline};
use sweepd::segment::Mask;
use sweepd::sensor::{Model, ModelExt};
use sweepd::sweep::SweepRef;
use sweepd::sweep::layout::flags;
use sweepd::wire::data::{DataPacket, ReturnMode};
use sweepd_lab::simulate::{Emitter, EmitterConfig, SimulatedDatagram, fixtures};
use sweepd_testkit::stream::{self, Sent, Spin, next_sweep};

use sweepd_testkit::{data_dir, raw, run::Run};

/// A sensor of which these channels are dark for a part of its turns: from, to.
fn silenced(spin: &Spin, turns: f64, dark: &[(usize, f64, f64)]) -> Vec<Sent> {
    let mut sent = spin.packets(turns / 10.0);
    let channels = spin.model.spec().channels;
    for one in &mut sent {
        let turn = (one.arrival_ns - stream::START_NS) as f64 * 1e-8;
        for &(channel, from, to) in dark {
            if (from..to).contains(&turn) {
                let mut bytes = one.packet.emit().to_vec();
                stream::blank(&mut bytes, channels, channel);
                one.packet = *DataPacket::parse(&bytes).unwrap();
            }
        }
    }
    sent
}

/// The rule, pixel by pixel.
#[derive(Default)]
struct Naive(Vec<Beam>);

/// One of a row.
#[derive(Clone, Default)]
struct Beam {
    channel: u32,
    turns: u32,
    has_returned: bool,
}

impl Naive {
    fn look(&mut self, sweep: &SweepRef<'_>) {
        if sweep.header.has(flags::PARTIAL) || sweep.header.has(flags::STOPPED) {
            return;
        }
        let rows = sweep.rows();
        let mut returned = vec![false; rows];
        for plane in [sweep.range, sweep.range2] {
            for (pixel, &range_m) in plane.iter().enumerate() {
                returned[pixel % rows] |= range_m > 0.0;
            }
        }
        self.0.resize(rows, Beam::default());
        for (row, beam) in self.0.iter_mut().enumerate() {
            beam.channel = sweep.beams[row].channel;
            if returned[row] {
                (beam.turns, beam.has_returned) = (0, true);
                continue;
            }
            let above = returned[..row].iter().rposition(|&one| one);
            let below = returned[row..].iter().position(|&one| one);
            if let (Some(above), Some(below)) = (above, below) {
                let dark_rows = row + below - above - 1;
                beam.turns += u32::from(dark_rows <= 2);
            }
        }
    }

    fn dark(&self) -> Vec<DarkBeam> {
        let mut dark = Vec::new();
        for (row, beam) in self.0.iter().enumerate() {
            if beam.turns >= 10 || beam.turns > 0 && !beam.has_returned {
                dark.push(DarkBeam {
                    row: row as u32,
                    channel: beam.channel,
                    turns: beam.turns,
                });
            }
        }
        dark
    }
}

/// What becomes of packets: whole turns, and the dark beams at the end. They are those of the naive
/// twin after each sweep.
#[track_caller]
fn run(model: Model, sent: &[Sent]) -> (u32, Vec<DarkBeam>) {
    let config = Config {
        calibration: model.is_hdl64e().then(stream::unit),
        ..stream::config()
    };
    let mut pipeline = Pipeline::new("test", config).unwrap();
    let mut memory = Memory::<HeapBuffers>::default();
    let mut naive = Naive::default();
    let mut turns = 0;
    for one in sent {
        let bytes = one.packet.emit();
        stream::push(&mut pipeline, &stream::datagram(bytes, one.arrival_ns));
        while let Some(bytes) = next_sweep(&mut pipeline, &mut memory) {
            let sweep = SweepRef::open(bytes.as_ref()).unwrap();
            turns += u32::from(!sweep.header.has(flags::PARTIAL));
            naive.look(&sweep);
            let found: Vec<DarkBeam> = pipeline.status().dark_beams.iter().collect();
            assert_eq!(found, naive.dark(), "{model}, {turns} turns");
        }
    }
    (turns, pipeline.status().dark_beams.iter().collect())
}

#[test]
fn dark_beams_are_those_of_the_naive_twin() {
    let mut rng = fastrand::Rng::with_seed(82);
    let mut found = 0;
    for (model, mode, fov) in [
        (Model::Vlp16, ReturnMode::Strongest, None),
        (Model::Vlp16, ReturnMode::Dual, None),
        (
            Model::Vlp16,
            ReturnMode::Strongest,
            Some((3_000.0, 21_000.0)),
        ),
        (
            Model::PuckHiRes,
            ReturnMode::Strongest,
            Some((27_000.0, 9_000.0)),
        ),
        (Model::Hdl32e, ReturnMode::Dual, None),
        (Model::Hdl64eS3, ReturnMode::Strongest, None),
        (Model::Hdl64eS3, ReturnMode::Dual, None),
        (Model::Vlp32c, ReturnMode::Dual, None),
        (Model::Vls128, ReturnMode::Strongest, None),
        (Model::Vls128, ReturnMode::Dual, None),
    ] {
        let spin = Spin {
            fov,
            ..Spin::new(model, mode, 600.0)
        };
        for share in [8, 2] {
            let mut dark = Vec::new();
            for channel in 0..model.spec().channels {
                if rng.usize(..share) == 0 {
                    let from = rng.f64() * 8.0;
                    dark.push((channel, from, from + rng.f64() * 30.0));
                }
            }
            let (turns, beams) = run(model, &silenced(&spin, 25.0, &dark));
            assert!(turns > 20, "{model} {mode}: {turns} turns");
            found += beams.len();
        }
    }
    assert!(found > 30, "{found}");
}

/// Channels of a VLP-16 alternate between the lower and the upper half; rows 0, 1 and 2 are channels
/// 15, 13 and 11, rows 13, 14 and 15 are 4, 2 and 0.
#[test]
fn by_hand() {
    let spin = Spin::new(Model::Vlp16, ReturnMode::Strongest, 600.0);
    let rows = |channels: &[usize], from: f64, to: f64| {
        let dark: Vec<_> = channels.iter().map(|&one| (one, from, to)).collect();
        let (turns, found) = run(Model::Vlp16, &silenced(&spin, 20.0, &dark));
        assert!((18..=20).contains(&turns), "{turns}");
        assert!(
            found.iter().all(|beam| beam.turns == turns || from > 0.0),
            "{found:?}"
        );
        let rows: Vec<(u32, u32)> = found.iter().map(|one| (one.row, one.channel)).collect();
        rows
    };
    assert_eq!(rows(&[], 0.0, 99.0), []);
    assert_eq!(rows(&[11], 0.0, 99.0), [(2, 11)]);
    assert_eq!(rows(&[13, 2], 0.0, 99.0), [(1, 13), (14, 2)]);
    // Two side by side may both have failed; three may look through a gap.
    assert_eq!(rows(&[11, 13], 0.0, 99.0), [(1, 13), (2, 11)]);
    assert_eq!(rows(&[9, 11, 13], 0.0, 99.0), []);
    // The sky, and what stands before the lowest beams.
    assert_eq!(rows(&[15], 0.0, 99.0), []);
    assert_eq!(rows(&[15, 13, 11, 9, 7], 0.0, 99.0), []);
    assert_eq!(rows(&[4, 2, 0], 0.0, 99.0), []);
    // It fails later: long enough before the end, or not.
    assert_eq!(rows(&[11], 5.0, 99.0), [(2, 11)]);
    assert_eq!(rows(&[11], 13.0, 99.0), []);
    // It returns again.
    assert_eq!(rows(&[11], 0.0, 17.0), []);
}

/// A mask hides pixels from the segmentation, or removes their returns: the beam has returned.
#[test]
fn a_masked_row_is_not_dark() {
    for masked in [false, true] {
        is_not_dark(Removal {
            masked,
            ..Removal::default()
        });
    }
}

fn is_not_dark(removal: Removal) {
    let (width, height) = (1800, 16);
    let hidden: Vec<bool> = (0..width * height).map(|at| at / width == 2).collect();
    let mut config = Config {
        removal,
        ..Config::default()
    };
    config.segment.mask = Some(Mask::new(width, height, &hidden).unwrap());
    let mut pipeline = Pipeline::new("test", config).unwrap();
    let mut memory = Memory::<HeapBuffers>::default();
    let mut turns = 0;
    for one in &Spin::new(Model::Vlp16, ReturnMode::Strongest, 600.0).packets(0.5) {
        let bytes = one.packet.emit();
        stream::push(&mut pipeline, &stream::datagram(bytes, one.arrival_ns));
        while next_sweep(&mut pipeline, &mut memory).is_some() {
            turns += 1;
            assert_eq!(pipeline.status().dark_beams.iter().next(), None);
        }
    }
    assert!(turns > 3, "{turns}");
}

/// The rows of the next sensor are others, and have their own counts.
#[test]
fn counts_begin_anew_with_another_sensor() {
    let first = Spin::new(Model::Vlp16, ReturnMode::Strongest, 600.0);
    let next = Spin::new(Model::Hdl32e, ReturnMode::Strongest, 600.0);
    let mut sent = silenced(&first, 15.0, &[(11, 0.0, 99.0)]);
    assert_eq!(run(Model::Vlp16, &sent).1.len(), 1);
    let mut later = silenced(&next, 15.0, &[(9, 0.0, 99.0)]);
    for one in &mut later {
        one.arrival_ns += 1_600_000_000;
    }
    let mut pipeline = Pipeline::new("test", stream::config()).unwrap();
    let mut memory = Memory::<HeapBuffers>::default();
    let mut seen = BTreeSet::new();
    sent.extend(later);
    for one in &sent {
        let bytes = one.packet.emit();
        stream::push(&mut pipeline, &stream::datagram(bytes, one.arrival_ns));
        while next_sweep(&mut pipeline, &mut memory).is_some() {}
        let model = pipeline.status().detection.map(|detection| detection.model);
        for beam in pipeline.status().dark_beams.iter() {
            assert!(beam.turns <= 15, "{beam:?}");
            seen.insert((model.map(|model| model.to_string()), beam.channel));
        }
    }
    let both = [("HDL-32E", 9), ("VLP-16", 11)];
    let both = both.map(|(model, channel)| (Some(model.to_owned()), channel));
    assert_eq!(seen.into_iter().collect::<Vec<_>>(), both);
}

/// What a real or a simulated sensor sees is dark to no beam that works, not even in a single turn.
#[test]
fn no_beam_of_a_simulated_street_is_dark() {
    let scene = fixtures::scene();
    for model in [Model::Vlp16, Model::Hdl32e, Model::Hdl64eS2] {
        let sensor = EmitterConfig::new(model, ReturnMode::Strongest).turns(2.5);
        let config = Config {
            calibration: Some(sensor.beams().into_owned()),
            ..stream::config()
        };
        let sent: Vec<_> = Emitter::new(sensor, &scene).collect();
        let sent = sent.iter().map(SimulatedDatagram::datagram);
        let run = Run::of_datagrams_with(config, sent);
        assert_eq!(at_the_end(&run), [], "{model}");
    }
}

fn at_the_end(run: &Run) -> Vec<DarkBeam> {
    let mut naive = Naive::default();
    let mut turns = 0;
    for sweep in run.views() {
        naive.look(&sweep);
        turns += u32::from(!sweep.header.has(flags::PARTIAL));
    }
    assert!(turns > 0);
    naive.dark()
}

/// Channel 11 of an HDL-32E and channel 82 of a VLS-128 have no return in any of their packets. The two
/// lowest beams of another unit see the vehicle alone.
#[test]
#[cfg_attr(without_captures, ignore = "no captures")]
fn one_beam_of_two_real_captures_is_dark() {
    let of = |name: &str| data_dir().join("pcap").join(name).with_extension("pcap");
    for (name, expected) in [
        ("hdl32e_mrpt-sample", &[(10, 11, 2)][..]),
        ("hdl32e_veloview-monterey-a", &[]),
        ("vlp16_einride-a", &[]),
        ("vlp16_mrpt-gps", &[]),
        ("vlp16_timm-dual-a", &[]),
        ("vlp16_veloview-90deg-a", &[]),
        ("vlp32c_nebula-fov180-a", &[]),
        ("vls128_nebula-a", &[(105, 82, 1)]),
    ] {
        let found = at_the_end(&Run::of_capture_with(stream::config(), &of(name)));
        let found: Vec<_> = found
            .iter()
            .map(|one| (one.row, one.channel, one.turns))
            .collect();
        assert_eq!(found, expected, "{name}");
    }
    let mut returns = [0; 32];
    for packet in raw::packets(&of("hdl32e_mrpt-sample")) {
        for block in 0..12 {
            for (record, count) in returns.iter_mut().enumerate() {
                *count += u32::from(packet.record(block, record).0 > 0);
            }
        }
    }
    assert_eq!(returns[11], 0);
    assert_eq!(returns.iter().filter(|&&count| count == 0).count(), 1);
}
