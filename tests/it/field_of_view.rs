//! A sensor that measures a sector only: its sweeps come out when the sector ends, not when the
//! head is back in it.

use sweepd::buffers::{HeapBuffers, Memory};
use sweepd::pipeline::{Config, Pipeline};
use sweepd::sensor::Model::{self, Hdl32e, Hdl64eS3, Vlp16};
use sweepd::sensor::ModelExt;
use sweepd::sweep::SweepRef;
use sweepd::sweep::layout::flags::{BLANKED, CIRCULAR, PARTIAL};
use sweepd::wire::data::ReturnMode::{self, Dual, Strongest};
use sweepd_testkit::{
    due,
    stream::{Run, Sent, Spin, config, cut_at, datagram, next_sweep, unit},
};

const KINDS: [(Model, ReturnMode); 6] = [
    (Vlp16, Strongest),
    (Vlp16, Dual),
    (Hdl32e, Strongest),
    (Hdl32e, Dual),
    (Hdl64eS3, Strongest),
    (Hdl64eS3, Dual),
];

/// What is measured, and a cut in what is not; hundredths of a degree and degrees.
const VIEWS: [((f64, f64), f64); 4] = [
    ((27_000.0, 9_100.0), 180.0),
    ((4_500.0, 14_500.0), 0.0),
    ((30_000.0, 6_000.0), 60.0),
    ((9_000.0, 36_000.0), 3.0),
];

/// Packets behind which the sensor is silent for more than 5 ms longer than between others.
fn ends(sent: &[Sent]) -> Vec<usize> {
    let is_end = |&at: &usize| sent[at + 1].arrival_ns - sent[at].arrival_ns > 7_000_000;
    (0..sent.len() - 1).filter(is_end).collect()
}

#[test]
fn a_sweep_comes_out_before_the_silence() {
    for (model, mode) in KINDS {
        for rpm in [600.0, 1200.0] {
            for (fov, cut_deg) in VIEWS {
                let sent = Spin {
                    fov: Some(fov),
                    ..Spin::new(model, mode, rpm)
                }
                .packets(7.3 * 60.0 / rpm);
                let run = Run::of(cut_at(cut_deg), &sent);
                run.check_sent(&sent);
                let place = format!("{model} {mode} {rpm} {fov:?} {:?}", run.flags());
                let period_ns = i64::from(model.spec().packet_period_ns(mode));
                // The very first silence may be taken for a clock that jumped, the next two teach
                // where it begins. From then on there is a sweep for each.
                for &end in &ends(&sent)[3..] {
                    let out: Vec<usize> = run
                        .out_after
                        .iter()
                        .copied()
                        .filter(|out| (end - 6..=end + 2).contains(out))
                        .collect();
                    let place = format!(
                        "{place}: silence behind packet {end}, sweeps after {:?}",
                        run.out_after
                    );
                    assert_eq!(out.len(), 1, "{place}");
                    let waited_ns = sent[end].arrival_ns - sent[out[0] - 1].arrival_ns;
                    assert!((0..3 * period_ns + 100_000).contains(&waited_ns), "{place}");
                }
            }
        }
    }
}

/// Behind the silence, packets end at other azimuths than before it.
#[test]
fn the_packet_that_completes_a_sweep_is_expected_no_later_than_it_comes() {
    let views = VIEWS
        .into_iter()
        .chain([((9_000.0, 27_700.0), 180.0), ((9_000.0, 27_000.0), 180.0)]);
    for (model, mode) in KINDS {
        let period_ns = i64::from(model.spec().packet_period_ns(mode));
        for (rpm, (fov, cut_deg)) in [600.0, 607.0, 613.0]
            .into_iter()
            .flat_map(|rpm| views.clone().map(move |view| (rpm, view)))
        {
            let sent = Spin {
                fov: Some(fov),
                ..Spin::new(model, mode, rpm)
            }
            .packets(12.3 * 60.0 / rpm);
            let calibration = (model == Hdl64eS3).then(unit);
            let packets = sent
                .iter()
                .map(|one| (one.packet.emit().to_vec(), one.arrival_ns));
            let late_ns = due::late_ns(
                Config {
                    calibration,
                    ..cut_at(cut_deg)
                },
                packets,
            );
            // In the first turns it is learned where the silence is; later where it begins with the
            // end of a packet, as of an HDL-64E S3 at 607 rpm, since that looks like packets that
            // were lost.
            let late_ns = late_ns[7..].concat();
            assert!(late_ns.len() > 80);
            let worst = [late_ns.iter().min(), late_ns.iter().max()].map(Option::unwrap);
            let expected_ns = -20_000..period_ns + 200_000;
            assert!(
                worst.iter().all(|ns| expected_ns.contains(ns)),
                "{model} {mode} {rpm} {fov:?} {cut_deg}: {worst:?} ns late"
            );
        }
    }
}

/// From cut to cut at the same azimuth, but where the cut moved; every turn is in one sweep.
#[test]
fn all_sweeps_are_a_turn_but_the_one_in_which_the_end_is_learned() {
    for (model, mode) in KINDS {
        for (fov, cut_deg) in VIEWS {
            let sent = Spin {
                fov: Some(fov),
                ..Spin::new(model, mode, 600.0)
            }
            .packets(0.83);
            let run = Run::of(cut_at(cut_deg), &sent);
            let flags = run.flags();
            let partial: Vec<usize> = (0..flags.len())
                .filter(|&at| flags[at] & PARTIAL != 0)
                .collect();
            let place = format!("{model} {mode} {fov:?} {flags:?}");
            assert_eq!(partial.len(), 3, "{place}");
            assert_eq!((partial[0], partial[2]), (0, flags.len() - 1), "{place}");
            assert!((1..=3).contains(&partial[1]), "{place}");
            assert!((8..=11).contains(&flags.len()), "{place}");
            assert!(flags.iter().all(|bits| bits & CIRCULAR == 0), "{place}");
            let views = run.views();
            for sweep in &views[partial[1] + 1..partial[2]] {
                assert_eq!(sweep.header.flags, BLANKED, "{place}");
                let cut = f64::from(sweep.header.cut_azimuth_rad).to_degrees();
                let ahead = (fov.1 / 100.0 - cut).rem_euclid(360.0);
                // A packet of a VLP-16 is 4.8 degrees.
                assert!(ahead > 0.3 && ahead < 7.0, "{place} cut at {cut}");
                let fired: Vec<_> = sweep
                    .columns
                    .iter()
                    .filter(|column| column.is_fired())
                    .collect();
                let [first, last] = [fired[0], fired[fired.len() - 1]]
                    .map(|c| f64::from(c.azimuth_rad).to_degrees());
                let past = |deg: f64| (deg - cut + 180.0).rem_euclid(360.0) - 180.0;
                assert!(
                    (-0.03..0.5).contains(&past(first)),
                    "{place} first {first} cut {cut}"
                );
                assert!(
                    (-0.5..0.03).contains(&past(last)),
                    "{place} last {last} cut {cut}"
                );
            }
        }
    }
}

#[test]
fn a_cut_that_is_measured_and_sent_in_time_stays() {
    for (model, mode) in KINDS {
        for cut_deg in [0.0, 45.0, 280.0, 80.0] {
            let sent = Spin {
                fov: Some((27_000.0, 9_100.0)),
                ..Spin::new(model, mode, 600.0)
            }
            .packets(0.55);
            let run = Run::of(cut_at(cut_deg), &sent);
            for sweep in run.views() {
                assert!(
                    (f64::from(sweep.header.cut_azimuth_rad).to_degrees() - cut_deg).abs() < 1e-3
                );
            }
            let flags = run.flags();
            assert!(
                flags[1..flags.len() - 1]
                    .iter()
                    .all(|&bits| bits == BLANKED),
                "{model} {mode} {flags:?}"
            );
        }
    }
}

/// They are known to a degree or two from the third silence on, and no more once all is measured.
#[test]
fn its_limits_are_measured() {
    for (model, mode) in KINDS {
        for rpm in [600.0, 1200.0] {
            for (fov, cut_deg) in VIEWS {
                let turn_s = 60.0 / rpm;
                let sent = Spin {
                    fov: Some(fov),
                    fov_later: vec![(5.0 * turn_s, None)],
                    ..Spin::new(model, mode, rpm)
                }
                .packets(8.0 * turn_s);
                let calibration = (model == Hdl64eS3).then(unit);
                let config = Config {
                    calibration,
                    ..cut_at(cut_deg)
                };
                let mut pipeline = Pipeline::new("x", config).unwrap();
                let mut memory = Memory::new(HeapBuffers::default());
                let mut known = Vec::new();
                for one in &sent {
                    let emitted = &one.packet.emit();
                    let packet = datagram(emitted, one.arrival_ns).parse().unwrap();
                    pipeline.push(&packet);
                    while next_sweep(&mut pipeline, &mut memory).is_some() {}
                    known.extend(pipeline.status().field_of_view_deg);
                }
                let place = format!("{model} {mode} {rpm} {fov:?}");
                assert!(!known.is_empty(), "{place}");
                for (start, end) in known {
                    let off =
                        |deg: f64, cdeg: f64| ((deg - cdeg / 100.0 + 540.0) % 360.0 - 180.0).abs();
                    assert!(
                        off(start, fov.0) < 2.0 && off(end, fov.1) < 2.0,
                        "{place}: {start} {end}"
                    );
                }
                assert_eq!(pipeline.status().field_of_view_deg, None, "{place}");
            }
        }
    }
}

/// Whoever widens, narrows or turns the field of view loses nothing; sweeps that are no turn say
/// so.
#[test]
fn what_was_learned_is_forgotten_without_a_loss() {
    let settings = [
        [
            Some((27_000.0, 9_100.0)),
            Some((27_000.0, 13_000.0)),
            Some((27_000.0, 7_000.0)),
        ],
        [Some((27_000.0, 9_100.0)), None, Some((27_000.0, 9_100.0))],
        [
            Some((27_000.0, 9_100.0)),
            Some((24_000.0, 9_100.0)),
            Some((30_000.0, 9_100.0)),
        ],
        [
            Some((27_000.0, 9_100.0)),
            Some((9_000.0, 24_000.0)),
            Some((27_000.0, 9_500.0)),
        ],
    ];
    for (model, mode) in KINDS {
        for parts in settings {
            let fov_later = vec![(0.55, parts[1]), (1.1, parts[2])];
            let sent = Spin {
                fov: parts[0],
                fov_later,
                ..Spin::new(model, mode, 600.0)
            }
            .packets(1.65);
            let run = Run::of(cut_at(180.0), &sent);
            run.check_sent(&sent);
            let place = format!("{model} {mode} {parts:?} {:?}", run.flags());
            let refused = run.counts.unconfirmed + run.counts.malformed + run.counts.late;
            assert_eq!(refused, 0, "{place} {:?}", run.counts);
            for sweep in run.views() {
                let turns = sweep.header.duration_ns as f64 * 1e-8;
                assert!(
                    turns < 1.0 || sweep.header.flags & PARTIAL != 0,
                    "{place}: {turns} turns"
                );
                assert!(turns < 1.1, "{place}: {turns} turns");
            }
            assert!(
                run.flags()
                    .iter()
                    .filter(|&&bits| bits & PARTIAL == 0)
                    .count()
                    >= 6,
                "{place}"
            );
        }
    }
}

/// The time is told whenever it pleases the caller, as a daemon does while nothing arrives.
fn with_ticks(config: Config, sent: &[Sent], seed: u64) -> Run {
    let mut rng = fastrand::Rng::with_seed(seed);
    let mut pipeline = Pipeline::new("test", config).unwrap();
    let mut memory = Memory::new(HeapBuffers::default());
    let (mut sweeps, mut out_after) = (Vec::new(), Vec::new());
    for (index, one) in sent.iter().enumerate() {
        pipeline.push(&datagram(one.packet.emit(), one.arrival_ns).parse().unwrap());
        let until_ns = sent
            .get(index + 1)
            .map_or(one.arrival_ns, |next| next.arrival_ns);
        let mut now_ns = one.arrival_ns;
        loop {
            while let Some(event) = pipeline.poll(&mut memory) {
                sweeps.extend(event.sweep());
            }
            out_after.resize(sweeps.len(), index + 1);
            now_ns += rng.i64(1..20_000_000);
            if now_ns >= until_ns {
                break;
            }
            pipeline.idle(Some(now_ns));
        }
    }
    pipeline.end();
    while let Some(event) = pipeline.poll(&mut memory) {
        sweeps.extend(event.sweep());
    }
    out_after.resize(sweeps.len(), sent.len());
    Run {
        sweeps,
        counts: pipeline.status().counts,
        out_after,
    }
}

#[test]
fn ticks_change_nothing() {
    for (model, mode) in KINDS {
        for (seed, (fov, cut_deg)) in (0..).zip(VIEWS) {
            let mut sent = Spin {
                fov: Some(fov),
                seed,
                ..Spin::new(model, mode, 600.0)
            }
            .packets(0.55);
            // Some are lost, and some overtaken.
            let mut rng = fastrand::Rng::with_seed(seed);
            sent.retain(|one| one.ordinal < 20 || rng.u32(..60) != 0);
            (30..sent.len() - 1)
                .step_by(37)
                .for_each(|at| sent.swap(at, at + 1));
            let calibration = (model == Hdl64eS3).then(unit);
            let config = Config {
                calibration,
                ..cut_at(cut_deg)
            };
            let plain = Run::of(config.clone(), &sent);
            let ticked = with_ticks(config, &sent, seed);
            plain.check_sent(&sent);
            assert!(
                plain.content(&sent) == ticked.content(&sent),
                "{model} {mode} {fov:?}"
            );
            assert_eq!(
                (&plain.counts, &plain.out_after),
                (&ticked.counts, &ticked.out_after)
            );
        }
    }
}

/// A head that turns backwards ends its sector at the other side.
#[test]
fn it_works_backwards() {
    let backwards = Spin {
        turns_at: Box::new(|s| -10.0 * s),
        ..Spin::new(Vlp16, Strongest, 600.0)
    };
    let sent = Spin {
        fov: Some((27_000.0, 9_100.0)),
        ..backwards
    }
    .packets(0.8);
    let run = Run::of(cut_at(180.0), &sent);
    run.check_sent(&sent);
    for &end in &ends(&sent)[3..] {
        assert!(
            (0..4).any(|ago| run.out_after.contains(&(end + 1 - ago))),
            "{end} {:?}",
            run.out_after
        );
    }
}

/// The head of a sensor that sees all round tells of no sector, whatever is lost.
#[test]
fn without_a_limit_nothing_moves() {
    for (model, mode) in KINDS {
        let mut sent = Spin::new(model, mode, 600.0).packets(0.55);
        let per_turn = sent.len() * 2 / 11;
        // The same place is lost turn after turn.
        sent.retain(|one| one.ordinal < 20 || one.ordinal % per_turn > per_turn / 12);
        let run = Run::of(config(), &sent);
        let of_no_sector =
            |sweep: SweepRef<'_>| sweep.header.cut_azimuth_rad == 0.0 && !sweep.header.has(BLANKED);
        assert!(run.views().into_iter().all(of_no_sector), "{model} {mode}");
    }
}
