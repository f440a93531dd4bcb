//! The same packets give the same sweeps, byte for byte: on every machine, whenever they arrive,
//! however often the pipeline is asked, and whoever else is there. What may differ is on one list,
//! [`HOST_FIELDS`], by which the bytes are masked. Live through the daemon, and replayed at any
//! speed: `tests/slow/live/equal.rs`.

use std::sync::LazyLock;
use sweepd_testkit::stream::next_sweep;

use sweepd::assemble::levels;
use sweepd::buffers::{HeapBuffers, Memory};
use sweepd::pipeline::{Config, Labels, Options, Pipeline, TimedSegmenter};
use sweepd::segment::Segmenter;
use sweepd::sensor::Model::{Hdl32e, Hdl64eS2, Hdl64eS3, Vlp16, Vlp32c, Vls128};
use sweepd::sweep::layout::flags::HEIGHT_ESTIMATED;
use sweepd::sweep::{SweepMut, SweepRef};
use sweepd::wire::data::ReturnMode::{Dual, Strongest};
use sweepd_lab::simulate::gps::{Clock, Reception};
use sweepd_lab::simulate::{Emitter, EmitterConfig, Rates, SimulatedDatagram, deliver, fixtures};
use sweepd_testkit::same::same;

/// What a sensor sent, with losses, copies and packets out of order, and the sweeps that it gave.
struct Stream {
    name: String,
    config: Config,
    sent: Vec<SimulatedDatagram>,
    sweeps: Vec<Vec<u8>>,
}

/// A sensor of each kind on a street, one of them with GPS.
static STREAMS: LazyLock<Vec<Stream>> = LazyLock::new(|| {
    let scene = fixtures::scene();
    let kinds = [
        (Vlp16, Dual),
        (Hdl32e, Strongest),
        (Hdl64eS2, Strongest),
        (Hdl64eS3, Dual),
        (Vlp32c, Strongest),
        (Vls128, Dual),
    ];
    let streams = kinds.into_iter().map(|(model, mode)| {
        let mut sensor =
            EmitterConfig::new(model, mode).turns(if model == Vls128 { 4.0 } else { 5.0 });
        if model == Vlp16 {
            sensor.clock = Clock::Gps {
                position_deg: (50.1, 8.7),
                reception: Reception::ALWAYS,
            };
        }
        let rates = Rates {
            loss: 0.01,
            burst_loss: 0.002,
            burst_len: 20,
            duplicate: 0.01,
            reorder: 0.02,
            places: 3,
            ..Rates::default()
        };
        // More than is held back: some come late, and columns that were already segmented change.
        let later = Rates {
            reorder: 0.003,
            places: 9,
            ..Rates::default()
        };
        let sent = deliver(
            Emitter::new(sensor.clone(), &scene).untold(),
            rates.plan(5, sensor.packets),
        );
        let (mut sent, late) = (
            sent.collect::<Vec<_>>(),
            later.plan(6, sensor.packets).swapped,
        );
        let latest = sent.len() - 9;
        for at in late
            .into_iter()
            .map(|at| at as usize)
            .filter(|&at| at < latest)
        {
            let times: Vec<i64> = sent[at..=at + 9].iter().map(|one| one.arrival_ns).collect();
            sent[at..=at + 9].rotate_left(1);
            sent[at..=at + 9]
                .iter_mut()
                .zip(times)
                .for_each(|(one, time)| one.arrival_ns = time);
        }
        let calibration = model.is_hdl64e().then(|| sensor.beams().into_owned());
        let config = Config {
            calibration,
            ..Config::default()
        };
        let mut stream = Stream {
            name: format!("{model} {mode}"),
            config,
            sent,
            sweeps: Vec::new(),
        };
        stream.sweeps = stream.run(stream.pipeline(), &stream.sent, |_, _, _| {});
        stream
    });
    streams.collect()
});

/// Takes what is complete.
fn take(pipeline: &mut Pipeline, memory: &mut Memory<HeapBuffers>, sweeps: &mut Vec<Vec<u8>>) {
    while let Some(sweep) = next_sweep(pipeline, memory) {
        sweeps.push(same(&SweepRef::open(sweep.as_ref()).unwrap()));
    }
}

impl Stream {
    fn pipeline(&self) -> Pipeline {
        Pipeline::new(&self.name, self.config.clone()).unwrap()
    }

    /// The sweeps of datagrams; `between` is called after each.
    fn run(
        &self,
        mut pipeline: Pipeline,
        sent: &[SimulatedDatagram],
        mut between: impl FnMut(&mut Pipeline, &mut Memory<HeapBuffers>, i64),
    ) -> Vec<Vec<u8>> {
        let mut memory = Memory::new(HeapBuffers::default());
        let mut sweeps = Vec::new();
        for one in sent {
            pipeline.push(&one.datagram().parse().unwrap());
            take(&mut pipeline, &mut memory, &mut sweeps);
            between(&mut pipeline, &mut memory, one.arrival_ns);
        }
        pipeline.end();
        take(&mut pipeline, &mut memory, &mut sweeps);
        sweeps
    }

    #[track_caller]
    fn compare(&self, what: &str, sweeps: &[Vec<u8>]) {
        assert_eq!(
            sweeps.len(),
            self.sweeps.len(),
            "{}, {what}: sweeps",
            self.name
        );
        for (number, (found, expected)) in sweeps.iter().zip(&self.sweeps).enumerate() {
            let differs = found.iter().zip(expected).position(|(a, b)| a != b);
            let place = format!("{}, {what}: sweep {number}", self.name);
            assert_eq!(
                (found.len(), differs),
                (expected.len(), None),
                "{place}: the first byte that differs"
            );
        }
    }
}

#[test]
fn the_streams_show_what_they_are_for() {
    for Stream {
        name, config, sent, ..
    } in &*STREAMS
    {
        let mut pipeline = Pipeline::new(name, config.clone()).unwrap();
        let mut memory = Memory::new(HeapBuffers::default());
        let (mut segments, mut estimated) = (0, false);
        for one in sent {
            pipeline.push(&one.datagram().parse().unwrap());
            while let Some(sweep) = next_sweep(&mut pipeline, &mut memory) {
                let sweep = SweepRef::open(sweep.as_ref()).unwrap();
                segments += sweep.segments.len();
                estimated |= sweep.header.has(HEIGHT_ESTIMATED) && sweep.header.sequence > 1;
            }
        }
        let counts = pipeline.status().counts;
        assert!(
            counts.lost > 3 && counts.duplicates > 1 && counts.reordered > 5,
            "{name}: {counts:?}"
        );
        assert!(segments > 40 && estimated, "{name}: {segments} segments");
    }
}

#[test]
fn on_every_level_of_instructions() {
    for stream in &*STREAMS {
        for level in levels() {
            let (name, config) = (&stream.name, stream.config.clone());
            let options = Options {
                level,
                ..Options::default()
            };
            let pipeline = Pipeline::with_options(name, config, options).unwrap();
            stream.compare(
                &format!("{level:?}"),
                &stream.run(pipeline, &stream.sent, |_, _, _| {}),
            );
        }
    }
}

/// Decoded in order, and labelled in another order by several segmenters.
#[test]
fn labelled_side_by_side() {
    for stream in &*STREAMS {
        let options = Options {
            labels: Labels::Elsewhere,
            ..Options::default()
        };
        let (name, config) = (&stream.name, stream.config.clone());
        let mut pipeline = Pipeline::with_options(name, config, options).unwrap();
        let mut memory = Memory::new(HeapBuffers::default());
        let mut decoded = Vec::new();
        for one in &stream.sent {
            pipeline.push(&one.datagram().parse().unwrap());
            decoded.extend(std::iter::from_fn(|| {
                next_sweep(&mut pipeline, &mut memory)
            }));
        }
        pipeline.end();
        decoded.extend(std::iter::from_fn(|| {
            next_sweep(&mut pipeline, &mut memory)
        }));
        let segmenter = Segmenter::new(stream.config.segment.clone()).unwrap();
        let segmenter = segmenter.with_heights_in_headers();
        let mut segmenters: [_; 3] =
            std::array::from_fn(|_| TimedSegmenter::new(segmenter.clone(), || 0));
        for (index, buffer) in decoded.iter_mut().enumerate().rev() {
            let mut sweep = SweepMut::open(buffer.as_mut()).unwrap();
            segmenters[index % 3].segment(&mut sweep);
        }
        let sweeps: Vec<Vec<u8>> = decoded
            .iter()
            .map(|buffer| same(&SweepRef::open(buffer.as_ref()).unwrap()))
            .collect();
        stream.compare("labelled side by side", &sweeps);
    }
}

#[test]
fn independent_of_how_often_the_pipeline_is_polled() {
    for stream in &*STREAMS {
        let mut rng = fastrand::Rng::with_seed(1);
        let mut extra = 0;
        let asked = stream.run(
            stream.pipeline(),
            &stream.sent,
            |pipeline, memory, now_ns| {
                for _ in 0..rng.u8(..4) {
                    // Less than the silence after which a sweep is closed.
                    pipeline.idle(Some(now_ns + rng.i64(0..450_000_000)));
                    extra += usize::from(next_sweep(pipeline, memory).is_some());
                }
            },
        );
        assert_eq!(
            extra, 0,
            "{}: a sweep was complete before its last packet",
            stream.name
        );
        stream.compare("asked often", &asked);
    }
}

#[test]
fn independent_of_arrival_times_and_the_hosts_clock() {
    for stream in &*STREAMS {
        for (seed, ahead_ns) in [
            (2, 0),
            (3, 86_400_000_000_000),
            (4, -1_700_000_000_000_000_000),
        ] {
            let mut rng = fastrand::Rng::with_seed(seed);
            let mut sent = stream.sent.clone();
            let mut newest_ns = i64::MIN;
            for one in &mut sent {
                // Up to 15 ms late, and never before what came before.
                newest_ns = newest_ns.max(one.arrival_ns + ahead_ns + rng.i64(0..15_000_000));
                one.arrival_ns = newest_ns;
            }
            let moved = stream.run(stream.pipeline(), &sent, |_, _, _| {});
            stream.compare(&format!("{ahead_ns} ns ahead"), &moved);
        }
    }
}

#[test]
fn alone_or_among_others_in_any_order_and_in_the_buffers_of_others() {
    for seed in 0..3 {
        let mut rng = fastrand::Rng::with_seed(seed);
        let buffers = HeapBuffers::default();
        let mut under_way: Vec<_> = STREAMS
            .iter()
            .map(|stream| {
                let memory = Memory::new(buffers.clone());
                (
                    stream,
                    stream.pipeline(),
                    memory,
                    stream.sent.iter(),
                    Vec::new(),
                )
            })
            .collect();
        while !under_way.is_empty() {
            let index = rng.usize(..under_way.len());
            let (_, pipeline, memory, sent, sweeps) = &mut under_way[index];
            // A batch, as the kernel hands them out.
            for one in sent.by_ref().take(rng.usize(1..60)) {
                pipeline.push(&one.datagram().parse().unwrap());
                take(pipeline, memory, sweeps);
            }
            if sent.as_slice().is_empty() {
                pipeline.end();
                take(pipeline, memory, sweeps);
                let (stream, .., sweeps) = under_way.swap_remove(index);
                stream.compare(&format!("among others, seed {seed}"), &sweeps);
            }
        }
    }
}
