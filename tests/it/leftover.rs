//! A buffer comes back with an old sweep in it: nothing that a header declares valid is left over
//! from it.

use sweepd::buffers::HeapBuffer;
use sweepd::buffers::{Buffers, HeapBuffers, Memory};
use sweepd::pipeline::{Config, Pipeline};
use sweepd::sensor::Model;
use sweepd::sweep::SweepRef;
use sweepd::wire::data::ReturnMode;
use sweepd_testkit::stream::{Run, Sent, Spin, config, datagram, next_sweep, unit};
use zerocopy::IntoBytes;

/// Buffers that are full of one byte.
struct Full(u8);

impl Buffers for Full {
    type Buffer = HeapBuffer;

    fn take(&mut self, bytes: usize) -> HeapBuffer {
        let mut buffer = HeapBuffers::default().take(bytes);
        buffer.as_mut().fill(self.0);
        buffer
    }
}

/// All bytes of all sweeps that their headers declare valid.
fn valid(config: &Config, sent: &[Sent], full_of: u8) -> Vec<Vec<u8>> {
    let mut pipeline = Pipeline::new("test", config.clone()).unwrap();
    let mut memory = Memory::new(Full(full_of));
    let mut sweeps = Vec::new();
    for one in sent {
        pipeline.push(&datagram(one.packet.emit(), one.arrival_ns).parse().unwrap());
        sweeps.extend(std::iter::from_fn(|| {
            next_sweep(&mut pipeline, &mut memory)
        }));
        pipeline.idle(None);
    }
    pipeline.end();
    sweeps.extend(std::iter::from_fn(|| {
        next_sweep(&mut pipeline, &mut memory)
    }));
    sweeps
        .iter()
        .map(|sweep| bytes(&SweepRef::open(sweep.as_ref()).unwrap()))
        .collect()
}

fn bytes(sweep: &SweepRef<'_>) -> Vec<u8> {
    let SweepRef {
        header,
        range,
        label,
        range2,
        label2,
        columns,
        beams,
        segments,
        ..
    } = *sweep;
    let tables = [
        header.as_bytes(),
        columns.as_bytes(),
        beams.as_bytes(),
        segments.as_bytes(),
    ];
    let words = [
        range.as_bytes(),
        label.as_bytes(),
        range2.as_bytes(),
        label2.as_bytes(),
    ];
    [
        tables.concat(),
        words.concat(),
        [sweep.reflectivity, sweep.reflectivity2, sweep.kind].concat(),
    ]
    .concat()
}

#[track_caller]
fn assert_nothing_is_left(sent: &[Sent], model: Model) {
    let calibration = model.is_hdl64e().then(unit);
    // Once with noise that has no segments, once with all of it segmented.
    for config in [config(), Config::default()] {
        let config = Config {
            calibration: calibration.clone(),
            ..config
        };
        let [a, b] = [0xA5, 0x3C].map(|full_of| valid(&config, sent, full_of));
        assert!(a.len() > 1 && a == b, "{model}: {} sweeps", a.len());
    }
}

#[test]
fn no_byte_of_a_sweep_is_left_over() {
    use {Model::*, ReturnMode::*};
    for (seed, (model, mode)) in (0..).zip([
        (Hdl64eS2, Strongest),
        (Hdl64eS3, Dual),
        (Hdl32e, Dual),
        (Vlp16, Strongest),
        (Vlp32c, Strongest),
        (Vls128, Dual),
    ]) {
        for rpm in [-620.0, 1180.0] {
            for fov in [None, Some((27_000.0, 9_100.0))] {
                let mut sent = Spin {
                    seed,
                    fov,
                    ..Spin::new(model, mode, rpm)
                }
                .packets(0.25);
                let lost = sent.len() / 2;
                sent.retain(|one| {
                    one.ordinal % 40 != 7 && !(lost..lost + 30).contains(&one.ordinal)
                });
                sent.swap(20, 23);
                assert_nothing_is_left(&sent, model);
            }
        }
    }
}

/// Each firing points a sixth of a turn and a little beyond the one before: packets follow each
/// other as they should, and a turn has six columns, where rows are shifted by fifty.
#[test]
fn nor_of_a_turn_that_is_shorter_than_the_shifts() {
    let still = Spin {
        jitter_cdeg: 0.0,
        start_cdeg: 100.0,
        ..Spin::new(Model::Hdl64eS2, ReturnMode::Strongest, 600.0)
    };
    let mut sent = still.packets(0.2);
    for one in &mut sent[400..] {
        let first = u32::from(one.packet.blocks[0].azimuth_cdeg());
        for (firing, pair) in (0..).zip(one.packet.blocks.chunks_mut(2)) {
            pair.iter_mut().for_each(|block| {
                block.set_azimuth_cdeg(((first + firing * 6_017) % 36_000) as u16)
            });
        }
    }
    assert_nothing_is_left(&sent, Model::Hdl64eS2);
    // And every return is where its firing says.
    let run = Run::of(config(), &sent);
    for sweep in run.views() {
        assert_eq!(sweep.returns().count(), sweep.header.returns as usize);
        for one in sweep.returns() {
            let block = &sent[one.packet as usize].packet.blocks[usize::from(one.block)];
            let distance_m = f32::from(block.records[one.channel % 32].distance.get()) * 0.002;
            assert!((one.range_m - distance_m).abs() < 1e-3, "{one:?}");
        }
    }
}
