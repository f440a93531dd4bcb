//! What a network, a sensor and its users do to a stream, and what must hold all the same.

use std::collections::BTreeSet;
use sweepd::sensor::ModelExt;
use sweepd_testkit::{
    cases::{self, Cases},
    stream,
};

use proptest::prelude::*;
use sweepd::buffers::{HeapBuffers, Memory};
use sweepd::pipeline::{Counts, Pipeline};
use sweepd::sensor::Model::{self, Hdl32e, Hdl64eS3, Vlp16, Vlp32c};
use sweepd::sweep::layout::flags::{BLANKED, CIRCULAR, PARTIAL, RATE_UNSTABLE, REVERSED, STOPPED};
use sweepd::wire::data::DataPacket;
use sweepd::wire::data::ReturnMode::{self, Dual, Last, Strongest};
use sweepd_testkit::stream::{Content, Run, Sent, Spin, config, cut_at, next_sweep};

const KINDS: [(Model, ReturnMode); 8] = [
    (Vlp16, Strongest),
    (Vlp16, Dual),
    (Hdl32e, Strongest),
    (Hdl32e, Dual),
    (Hdl64eS3, Strongest),
    (Hdl64eS3, Dual),
    (Vlp32c, Strongest),
    (Vlp32c, Dual),
];

/// Nothing is wrong but what `expected` says.
#[track_caller]
fn assert_counts(run: &Run, expected: Counts) {
    assert_eq!(
        run.counts,
        Counts {
            data: run.counts.data,
            ..expected
        }
    );
}

/// First and last sweep partial, the others whole and alike.
#[track_caller]
fn assert_whole(run: &Run, whole: u32) {
    let flags = run.flags();
    assert!(flags.len() > 2, "{flags:?}");
    assert_eq!(
        (flags[0] & PARTIAL, flags[flags.len() - 1] & PARTIAL),
        (PARTIAL, PARTIAL)
    );
    assert!(
        flags[1..flags.len() - 1].iter().all(|&f| f == whole),
        "{flags:?}"
    );
}

fn without(sent: &[Sent], lost: impl Fn(usize) -> bool) -> Vec<Sent> {
    sent.iter()
        .filter(|one| !lost(one.ordinal))
        .cloned()
        .collect()
}

#[test]
fn a_clean_stream_is_cut_once_a_turn_as_soon_as_the_cut_is_crossed() {
    for (model, mode) in KINDS {
        for (rpm, cut_deg) in [
            (300.0, 0.0),
            (600.0, 359.997),
            (1200.0, 180.005),
            (542.3, 123.45),
        ] {
            let sent = Spin::new(model, mode, rpm).packets(3.4 * 60.0 / rpm);
            let run = Run::of(cut_at(cut_deg), &sent);
            run.check_sent(&sent);
            assert_counts(&run, Counts::default());
            assert_whole(&run, CIRCULAR);
            let turns: Vec<f64> = sent
                .iter()
                .map(|one| one.firings.last().unwrap().1)
                .collect();
            let phase = |cdeg: f64| (cdeg - cut_deg * 100.0).rem_euclid(36_000.0);
            let crossings = (1..sent.len())
                .filter(|&i| phase(turns[i]) < phase(turns[i - 1]))
                .map(|i| i + 1);
            let mut expected: Vec<usize> = crossings.collect();
            expected.push(sent.len());
            let late = run
                .out_after
                .iter()
                .zip(&expected)
                .all(|(&out, &due)| out.abs_diff(due) <= 1);
            assert!(
                late && run.out_after.len() == expected.len(),
                "{:?} {expected:?}",
                run.out_after
            );
            for sweep in &run.views()[1..run.sweeps.len() - 1] {
                assert!(
                    (f64::from(sweep.header.rpm) / rpm - 1.0).abs() < 2e-3,
                    "{}",
                    sweep.header.rpm
                );
                let nominal = 60e9 / rpm / f64::from(model.spec().firing_period_ns(mode));
                assert!((f64::from(sweep.header.columns) - nominal).abs() < 3.0);
            }
        }
    }
}

#[test]
fn jitter_at_the_cut_and_azimuth_36000_make_no_extra_sweep() {
    for cut_cdeg in [0.0, 1.0, 35_999.0, 9_000.5, 17_999.99] {
        for seed in 0..8 {
            let spin = Spin {
                jitter_cdeg: 30.0,
                seed,
                ..Spin::new(Vlp16, Strongest, 600.0)
            };
            let mut sent = spin.packets(0.45);
            for block in sent.iter_mut().flat_map(|one| &mut one.packet.blocks) {
                if block.azimuth_cdeg() == 0 {
                    block.set_azimuth_cdeg(36_000);
                }
            }
            let run = Run::of(cut_at(cut_cdeg / 100.0), &sent);
            run.check_sent(&sent);
            // From 123.45 degrees on four and a half turns.
            let cuts = if (12_345.0..12_345.0 + 18_000.0).contains(&cut_cdeg) {
                5
            } else {
                4
            };
            assert_eq!(
                (run.sweeps.len(), run.counts.lost),
                (cuts + 1, 0),
                "{cut_cdeg}"
            );
        }
    }
}

#[test]
fn losses_are_counted_exactly_and_leave_columns_where_the_head_was() {
    let mut cases = Cases::default();
    for (model, mode) in KINDS {
        for rpm in [300.0, 1200.0] {
            let turn_s = 60.0 / rpm;
            let spin = Spin::new(model, mode, rpm);
            let sent = spin.packets(3.3 * turn_s);
            let per_turn = turn_s * 1e9 / f64::from(model.spec().packet_period_ns(mode));
            for (first, share) in [
                (20, 0.0),
                (41, 0.02),
                (60, 0.05),
                (30, 0.25),
                (25, 0.5),
                (37, 0.9),
            ] {
                if !cases.takes() {
                    continue;
                }
                let burst = first..first + 1 + (share * per_turn) as usize;
                let arrived = without(&sent, |n| burst.contains(&n));
                let run = Run::of(config(), &arrived);
                run.check_sent(&arrived);
                let lost = burst.len() as u64;
                assert_counts(
                    &run,
                    Counts {
                        lost,
                        ..Counts::default()
                    },
                );
                assert_eq!(run.lost_in_sweeps(), lost);
                assert_whole(&run, CIRCULAR);
                let firings = model.spec().firings_per_packet(mode);
                let missing: u32 = run
                    .views()
                    .iter()
                    .map(|sweep| sweep.header.missing_columns)
                    .sum();
                assert_eq!(missing as usize, burst.len() * firings);
                assert_positions(&run, &sent, 40.0, 3_000);
            }
        }
    }
}

/// Every column stands in the order, at the time and about where the head was.
#[track_caller]
fn assert_positions(run: &Run, sent: &[Sent], slack_cdeg: f64, slack_ns: i64) {
    let truth: Vec<(i64, f64)> = sent
        .iter()
        .flat_map(|one| one.firings.iter().copied())
        .collect();
    let views = run.views();
    let start_ns = views[0].header.sensor_time_ns - truth[0].0;
    let columns = views
        .iter()
        .flat_map(|s| s.columns.iter().map(|c| (s.header.sensor_time_ns, c)));
    let columns: Vec<_> = columns.filter(|(_, column)| column.is_fired()).collect();
    for (index, &(first_ns, column)) in columns.iter().enumerate() {
        let (time_ns, cdeg) = truth[index];
        let off_ns = first_ns + i64::from(column.time_ns) - start_ns - time_ns;
        // Where a sector was left out within a gap, its edge is known to a column or two.
        assert!(
            off_ns.abs() < slack_ns || column.is_missing() && slack_ns > 3_000,
            "column {index} is {off_ns} ns off"
        );
        let off = (f64::from(column.azimuth_rad).to_degrees() * 100.0 - cdeg + 18_000.0)
            .rem_euclid(36_000.0)
            - 18_000.0;
        assert!(
            off.abs() < slack_cdeg || column.is_missing() && slack_ns > 3_000,
            "column {index} is {off} off"
        );
    }
    assert_eq!(columns.len(), truth.len());
}

#[test]
fn a_turn_and_more_lost_interrupts_the_sweep_and_is_counted_all_the_same() {
    for (model, mode) in KINDS {
        let sent = Spin::new(model, mode, 1200.0).packets(0.5);
        let per_turn = (5e7 / f64::from(model.spec().packet_period_ns(mode))) as usize;
        for turns in [1.0, 1.1, 2.5, 5.0] {
            let burst = 100..100 + (turns * per_turn as f64) as usize + 1;
            let arrived = without(&sent, |n| burst.contains(&n));
            let run = Run::of(config(), &arrived);
            run.check_sent(&arrived);
            assert_counts(
                &run,
                Counts {
                    lost: burst.len() as u64,
                    ..Counts::default()
                },
            );
            assert_eq!(run.lost_in_sweeps(), burst.len() as u64);
            assert!(
                run.views()
                    .iter()
                    .all(|sweep| sweep.header.missing_columns == 0)
            );
        }
        // The host's clock denies it: then the sensor's jumped, and nothing is lost.
        let mut arrived = without(&sent, |n| (100..100 + 3 * per_turn).contains(&n));
        arrived
            .iter_mut()
            .skip(100)
            .for_each(|one| one.arrival_ns -= 150_000_000);
        let run = Run::of(config(), &arrived);
        run.check_sent(&arrived);
        assert_counts(&run, Counts::default());
    }
}

#[test]
fn packets_out_of_order_are_put_back() {
    for (model, mode) in KINDS {
        let sent = Spin::new(model, mode, 600.0).packets(0.25);
        let clean = Run::of(config(), &sent).content(&sent);
        for places in 1..=4 {
            let mut arrived = sent.clone();
            let late: Vec<usize> = (20..arrived.len() - 10).step_by(13).collect();
            late.iter()
                .for_each(|&at| arrived[at..=at + places].rotate_left(1));
            let run = Run::of(config(), &arrived);
            run.check_sent(&arrived);
            assert_counts(
                &run,
                Counts {
                    reordered: late.len() as u64,
                    ..Counts::default()
                },
            );
            assert!(run.content(&arrived) == clean, "{model} {mode} {places}");
        }
    }
}

#[test]
fn a_packet_that_comes_later_still_fills_its_columns_in_the_open_sweep() {
    for (model, mode) in KINDS {
        let spin = Spin {
            start_cdeg: 10.0,
            ..Spin::new(model, mode, 600.0)
        };
        let sent = spin.packets(0.25);
        let clean = Run::of(config(), &sent).content(&sent);
        let mut arrived = sent.clone();
        arrived[20..=27].rotate_left(1);
        let run = Run::of(config(), &arrived);
        run.check_sent(&arrived);
        assert_counts(
            &run,
            Counts {
                reordered: 1,
                ..Counts::default()
            },
        );
        // Of such a packet the turning rate is its own, not the mean over those before.
        let about = |content: Vec<Content>| {
            content
                .into_iter()
                .map(Content::without_rates)
                .collect::<Vec<_>>()
        };
        assert!(about(run.content(&arrived)) == about(clean));
        assert_eq!(run.lost_in_sweeps(), 0);
        // Its copy is a duplicate; after the sweep is gone it is late.
        let copy = arrived[27].clone();
        arrived.insert(29, copy);
        let run = Run::of(config(), &arrived);
        assert_counts(
            &run,
            Counts {
                reordered: 1,
                duplicates: 1,
                ..Counts::default()
            },
        );
        let mut arrived = sent.clone();
        let way = (1.05e8 / f64::from(model.spec().packet_period_ns(mode))) as usize;
        arrived[20..=20 + way].rotate_left(1);
        let run = Run::of(config(), &arrived);
        run.check_sent(&arrived);
        assert_counts(
            &run,
            Counts {
                late: 1,
                lost: 1,
                ..Counts::default()
            },
        );
    }
}

#[test]
fn a_gap_is_held_open_for_four_packets_and_no_more() {
    let sent = Spin::new(Vlp16, Strongest, 600.0).packets(0.25);
    let cut = Run::of(config(), &sent).out_after[0] - 1;
    for gap in 1..=8 {
        // The cut is crossed in the packet after the gap that is this many packets long, or in one
        // after that.
        for behind in 0..6 {
            let arrived = without(&sent, |n| (cut - behind - gap..cut - behind).contains(&n));
            let run = Run::of(config(), &arrived);
            run.check_sent(&arrived);
            let out = arrived[run.out_after[0] - 1].ordinal;
            assert_eq!(out, cut.max(cut - behind + 4), "{gap} {behind}");
        }
    }
}

/// Its first firings belong to a sweep that is gone, so the packet as a whole is late.
#[test]
fn a_late_packet_across_a_cut_is_refused_as_a_whole() {
    for (model, mode) in KINDS {
        let sent = Spin::new(model, mode, 600.0).packets(0.25);
        let cut = Run::of(config(), &sent).out_after[0] - 1;
        let mut arrived = sent.clone();
        arrived[cut..=cut + 9].rotate_left(1);
        let run = Run::of(config(), &arrived);
        run.check_sent(&arrived);
        assert_counts(
            &run,
            Counts {
                late: 1,
                lost: 1,
                ..Counts::default()
            },
        );
        assert_eq!(run.lost_in_sweeps(), 1);
        assert_positions(&run, &sent, 40.0, 3_000);
    }
}

#[test]
fn the_field_of_view_may_be_changed_at_any_time() {
    for (model, mode) in KINDS {
        let mut sent: Vec<Sent> = Vec::new();
        for (part, fov) in (0..).zip([
            None,
            Some((27_000.0, 9_100.0)),
            Some((4_500.0, 14_500.0)),
            None,
        ]) {
            let start_cdeg = 1_000.0 + f64::from(part) * 18_000.0;
            let spin = Spin {
                clock_ns: i64::from(part) * 350_000_000,
                fov,
                ..Spin::new(model, mode, 600.0)
            };
            let from = sent.len();
            sent.extend(
                Spin { start_cdeg, ..spin }
                    .packets(0.35)
                    .into_iter()
                    .map(|mut one| {
                        one.arrival_ns += i64::from(part) * 350_000_000;
                        one.ordinal += from;
                        one
                    }),
            );
        }
        let run = Run::of(config(), &sent);
        run.check_sent(&sent);
        // Where one setting ends and the next begins there may be a gap of any kind.
        assert_eq!(
            run.counts.unconfirmed + run.counts.malformed + run.counts.late,
            0,
            "{:?}",
            run.counts
        );
        let flags = run.flags();
        assert_eq!(flags[1], CIRCULAR);
        assert_eq!(
            flags[flags.len() - 2] & BLANKED,
            0,
            "{model} {mode} {flags:?}"
        );
        assert!(
            flags.iter().filter(|&&f| f == BLANKED).count() >= 4,
            "{model} {mode} {flags:?}"
        );
        assert!((13..=20).contains(&flags.len()), "{model} {mode} {flags:?}");
    }
}

#[test]
fn a_corrupt_first_packet_does_not_set_the_tone() {
    let mut cases = Cases::default();
    for (model, mode) in KINDS {
        let sent = Spin {
            clock_ns: 1_800_000_000_000,
            ..Spin::new(model, mode, 1200.0)
        }
        .packets(0.14);
        for (what, corrupt) in corruptions() {
            // The flags alone tell sensors that are not supported.
            if matches!(what, "bank" | "product") {
                continue;
            }
            for at in [0, 1, 2, 5] {
                if !cases.takes() {
                    continue;
                }
                let mut arrived = sent.clone();
                corrupt(&mut arrived[at].packet, at as u64 + 1);
                let run = Run::of(config(), &arrived);
                run.check_sent(&arrived);
                let place = format!("{model} {mode} {what} at {at}: {:?}", run.counts);
                assert!(run.decoded().len() + 16 > sent.len(), "{place}");
                assert!(
                    run.flags()[1..].contains(&CIRCULAR),
                    "{place} {:?}",
                    run.flags()
                );
            }
        }
    }
}

#[test]
fn speed_is_measured_while_it_changes() {
    // From 300 to 900 rpm in a second.
    let spin = Spin {
        turns_at: Box::new(|s| 5.0 * s + 5.0 * s * s),
        ..Spin::new(Vlp16, Strongest, 600.0)
    };
    let sent = spin.packets(1.0);
    let arrived = without(&sent, |n| n % 200 > 180);
    let run = Run::of(config(), &arrived);
    run.check_sent(&arrived);
    assert_counts(
        &run,
        Counts {
            lost: (sent.len() - arrived.len()) as u64,
            ..Counts::default()
        },
    );
    let views = run.views();
    for sweep in &views {
        let middle_s = (sweep.header.sensor_time_ns + sweep.header.duration_ns as i64 / 2) as f64
            * 1e-9
            - 1.234_567;
        let rpm = 60.0 * (5.0 + 10.0 * middle_s);
        assert!(
            (f64::from(sweep.header.rpm) - rpm).abs() < 0.01 * rpm,
            "{} {rpm}",
            sweep.header.rpm
        );
    }
    assert!(
        run.flags()[1..views.len() - 1]
            .iter()
            .all(|&f| f & PARTIAL == 0)
    );
}

#[test]
fn copies_are_refused() {
    for (model, mode) in KINDS {
        let sent = Spin::new(model, mode, 600.0).packets(0.25);
        let clean = Run::of(config(), &sent).content(&sent);
        for distance in [1, 2, 7, 20] {
            let mut arrived = sent.clone();
            let copied: Vec<usize> = (20..sent.len() - 30).step_by(31).collect();
            for &at in copied.iter().rev() {
                arrived.insert(at + distance, sent[at].clone());
            }
            let run = Run::of(config(), &arrived);
            run.check_sent(&arrived);
            assert_counts(
                &run,
                Counts {
                    duplicates: copied.len() as u64,
                    ..Counts::default()
                },
            );
            assert!(run.content(&arrived) == clean);
        }
        // A mirrored port: everything twice.
        let arrived: Vec<Sent> = sent
            .iter()
            .flat_map(|one| [one.clone(), one.clone()])
            .collect();
        let run = Run::of(config(), &arrived);
        assert_counts(
            &run,
            Counts {
                duplicates: sent.len() as u64,
                ..Counts::default()
            },
        );
        assert!(run.content(&arrived) == clean);
    }
}

#[test]
fn a_limited_field_of_view_is_no_loss() {
    let mut cases = Cases::default();
    for (model, mode) in KINDS {
        for (fov, rpm) in [
            ((27_000.0, 9_100.0), 600.0),
            ((4_500.0, 14_500.0), 600.0),
            ((30_000.0, 6_000.0), 1200.0),
            ((9_000.0, 36_000.0), 300.0),
        ] {
            for cut_deg in [0.0, 100.0, 200.0, 91.0, 45.0] {
                if !cases.takes() {
                    continue;
                }
                let jitter_cdeg = if cut_deg < 100.0 { 0.0 } else { 2.0 };
                let spin = Spin {
                    fov: Some(fov),
                    jitter_cdeg,
                    ..Spin::new(model, mode, rpm)
                };
                let sent = spin.packets(4.2 * 60.0 / rpm);
                let run = Run::of(cut_at(cut_deg), &sent);
                run.check_sent(&sent);
                let place = format!("{model} {mode} {fov:?} {cut_deg}");
                assert_eq!(
                    run.counts,
                    Counts {
                        data: run.counts.data,
                        ..Counts::default()
                    },
                    "{place}"
                );
                let flags = run.flags();
                // The cut may be moved out of what is not sent in time, once: see
                // tests/it/field_of_view.rs.
                let moved = flags[1..flags.len() - 1]
                    .iter()
                    .filter(|&&f| f == BLANKED | PARTIAL)
                    .count();
                let whole = flags[1..flags.len() - 1]
                    .iter()
                    .filter(|&&f| f == BLANKED)
                    .count();
                assert!(
                    moved <= 1 && 1 + moved + whole + 1 == flags.len(),
                    "{place} {flags:?}"
                );
                assert!((4..=6).contains(&flags.len()), "{place} {}", flags.len());
                // With the encoder's noise the silence inside a packet may be taken for a block
                // more or less.
                assert_positions(
                    &run,
                    &sent,
                    10.0,
                    if jitter_cdeg == 0.0 { 3_000 } else { 112_000 },
                );
                for sweep in &run.views()[1..run.sweeps.len() - 1] {
                    assert!(
                        (f64::from(sweep.header.rpm) / rpm - 1.0).abs() < 5e-3,
                        "{}",
                        sweep.header.rpm
                    );
                }
            }
        }
    }
}

/// The rows of an HDL-64E are apart by more than such a sector is wide.
#[test]
fn a_sector_narrower_than_the_shifts_may_be_left_out() {
    for width_cdeg in [300.0, 600.0, 1_000.0] {
        let fov = Some((27_000.0, 27_000.0 - width_cdeg));
        let mut sent = Spin {
            fov,
            ..Spin::new(Hdl64eS3, Dual, 600.0)
        }
        .packets(0.35);
        Run::of(config(), &sent).check_sent(&sent);
        // A packet that comes late finds its place behind the sector too.
        let late = sent.remove(830);
        sent.insert(860, late);
        let run = Run::of(config(), &sent);
        run.check_sent(&sent);
        assert_eq!(
            run.counts,
            Counts {
                data: run.counts.data,
                reordered: 1,
                ..Counts::default()
            },
            "{width_cdeg}"
        );
    }
}

#[test]
fn losses_in_a_limited_field_of_view_are_counted() {
    for (model, mode) in KINDS {
        let spin = Spin {
            fov: Some((27_000.0, 9_100.0)),
            ..Spin::new(model, mode, 600.0)
        };
        let sent = spin.packets(0.65);
        let leaps = |one: &Sent| {
            one.firings
                .windows(2)
                .any(|two| two[1].0 - two[0].0 > 20_000_000)
        };
        let leap = sent
            .iter()
            .filter(|one| leaps(one))
            .nth(2)
            .map_or(sent.len() / 2, |one| one.ordinal);
        for (first, count) in [
            (leap - 10, 1),
            (leap, 1),
            (leap - 3, 7),
            (leap - 1, 2),
            (leap + 1, 1),
            (leap + 5, 12),
        ] {
            let arrived = without(&sent, |n| (first..first + count).contains(&n));
            let run = Run::of(config(), &arrived);
            run.check_sent(&arrived);
            let place = format!("{model} {mode} {first}+{count}, leap {leap}");
            assert_eq!(run.counts.lost, count as u64, "{place} {:?}", run.counts);
            assert_eq!(run.counts.unconfirmed, 0, "{place}");
            assert_eq!(run.lost_in_sweeps(), count as u64);
            let flags = run.flags();
            assert!(
                flags[1..flags.len() - 1].iter().all(|&f| f == BLANKED),
                "{place} {flags:?}"
            );
            assert_positions(&run, &sent, 40.0, 120_000);
        }
    }
}

#[test]
fn the_stamp_wraps_after_an_hour_or_a_little_later() {
    for (model, mode) in KINDS {
        let spin = |clock_ns| Spin {
            clock_ns,
            ..Spin::new(model, mode, 600.0)
        };
        let before = spin(1_000_000_000).packets(0.35);
        let clean = Run::of(config(), &before);
        let sent = spin(3_599_800_000_000).packets(0.35);
        let run = Run::of(config(), &sent);
        run.check_sent(&sent);
        assert_counts(&run, Counts::default());
        let columns = |run: &Run| {
            run.views()
                .iter()
                .map(|s| s.columns.len())
                .collect::<Vec<_>>()
        };
        assert_eq!(columns(&run), columns(&clean));
        let mut beyond = sent;
        for one in &mut beyond {
            let stamp = one.packet.stamp_us();
            if stamp < 60_000 {
                one.packet.set_stamp_us(stamp + 3_600_000_000);
            }
        }
        let run = Run::of(config(), &beyond);
        run.check_sent(&beyond);
        assert_counts(&run, Counts::default());
        assert_eq!(columns(&run), columns(&clean));
    }
}

/// Steps of the sensor's clock in the middle of a stream interrupt the sweep and cost few packets
/// or none.
#[test]
fn a_clock_that_steps_interrupts_one_sweep() {
    for (model, mode) in KINDS {
        let sent = Spin {
            clock_ns: 1_800_000_000_000,
            ..Spin::new(model, mode, 1200.0)
        }
        .packets(0.22);
        for step_us in [
            600_000_000_i64,
            -600_000_000,
            1_799_000_000,
            61_234_567,
            300_000,
            50_000,
            5_000,
            900,
            -1_500_000,
            -400_000,
            -30_000,
        ] {
            let mut arrived = sent.clone();
            let from = arrived.len() / 2;
            for one in &mut arrived[from..] {
                let stamp = (i64::from(one.packet.stamp_us()) + step_us).rem_euclid(3_600_000_000);
                one.packet.set_stamp_us(stamp as u32);
            }
            let run = Run::of(config(), &arrived);
            run.check_sent(&arrived);
            let place = format!("{model} {mode} {step_us} {:?}", run.counts);
            let looked_back = if (-1_000_000..0).contains(&step_us) {
                15
            } else {
                0
            };
            assert_eq!(
                (run.counts.late, run.counts.lost, run.counts.unconfirmed),
                (looked_back, 0, 0),
                "{place}"
            );
            let partial = run.flags().iter().filter(|&&f| f & PARTIAL != 0).count();
            assert_eq!(partial, 4, "{place}");
            // Each sweep has the host time of its own first shot.
            for sweep in run.views() {
                let sent = &arrived[sweep
                    .columns
                    .iter()
                    .find(|column| column.is_fired())
                    .unwrap()
                    .packet as usize];
                let off = sweep.header.time_ns - stream::START_NS - sent.firings[0].0;
                assert!((0..3_000_000).contains(&off), "{place}: {off}");
            }
        }
    }
}

#[test]
fn a_change_of_return_mode_interrupts_one_sweep() {
    for model in [Vlp16, Hdl32e] {
        let mut sent = Vec::new();
        for (part, mode) in (0..).zip([Strongest, Dual, Last, Strongest, Dual]) {
            let spin = Spin {
                clock_ns: part * 250_000_000,
                ..Spin::new(model, mode, 600.0)
            };
            sent.extend(spin.packets(0.24).into_iter().map(|mut one| {
                one.arrival_ns += part * 250_000_000;
                one
            }));
        }
        let run = Run::of(config(), &sent);
        run.check_sent(&sent);
        assert_counts(&run, Counts::default());
        let modes: Vec<_> = run
            .views()
            .iter()
            .map(|sweep| sweep.header.return_mode())
            .collect();
        let mut pieces = modes.clone();
        pieces.dedup();
        assert_eq!(pieces, [Strongest, Dual, Last, Strongest, Dual]);
        assert_eq!(
            run.flags().iter().filter(|&&f| f & PARTIAL != 0).count(),
            10
        );
        assert!(
            run.flags()
                .iter()
                .all(|&f| f & PARTIAL != 0 || f == CIRCULAR)
        );
    }
}

/// Its name, and what it does to a packet, in as many ways as there are numbers.
type Corruption = (&'static str, fn(&mut DataPacket, u64));

/// What can be wrong with one packet.
fn corruptions() -> Vec<Corruption> {
    vec![
        ("stamp, far ahead", |p, n| {
            p.set_stamp_us(p.stamp_us() + 20_000_000 + 977 * n as u32)
        }),
        ("stamp, a bit ahead", |p, n| {
            p.set_stamp_us(p.stamp_us() + 1_000 + 433 * n as u32)
        }),
        ("stamp, far back", |p, n| {
            p.set_stamp_us(p.stamp_us() - 900_000_000 - 977 * n as u32)
        }),
        ("stamp, a bit back", |p, n| {
            p.set_stamp_us(p.stamp_us() - 1_300 - 433 * n as u32)
        }),
        ("stamp, a bit flips", |p, n| {
            p.set_stamp_us(p.stamp_us() ^ 1 << (9 + n % 22))
        }),
        ("azimuth of a block", |p, n| {
            let block = &mut p.blocks[n as usize % 12];
            block.set_azimuth_cdeg(
                ((u64::from(block.azimuth_cdeg()) + 777 + 2_345 * n) % 36_000) as u16,
            );
        }),
        ("azimuth beyond a turn", |p, n| {
            p.blocks[n as usize % 12].set_azimuth_cdeg(40_000)
        }),
        ("all azimuths", |p, _| {
            p.blocks
                .iter_mut()
                .for_each(|b| b.set_azimuth_cdeg((b.azimuth_cdeg() + 9_000) % 36_000));
        }),
        ("return mode, unknown", |p, n| p.return_mode = n as u8),
        ("return mode, another", |p, _| {
            p.return_mode = if p.return_mode == 0x38 { 0x37 } else { 0x38 }
        }),
        ("return mode, dual or not", |p, _| {
            p.return_mode = if p.return_mode == 0x39 { 0x37 } else { 0x39 }
        }),
        ("product", |p, n| p.product = 0x40 + n as u8),
        ("flag", |p, n| {
            p.blocks[n as usize % 12].flag = 0x1234.into()
        }),
        ("bank", |p, n| {
            p.blocks[n as usize % 12].flag = 0xDDFF.into()
        }),
    ]
}

#[test]
fn one_corrupt_packet_costs_at_most_itself() {
    let mut cases = Cases::default();
    for (model, mode) in KINDS {
        let sent = Spin {
            clock_ns: 1_800_000_000_000,
            ..Spin::new(model, mode, 1200.0)
        }
        .packets(0.14);
        let clean = Run::of(config(), &sent);
        let step = if (model, mode) == KINDS[0] { 1 } else { 3 };
        // The packet that holds the first cut.
        let cut = clean.out_after[0] - 1;
        for (what, corrupt) in corruptions() {
            for n in (0..12).step_by(step) {
                if !cases.takes() {
                    continue;
                }
                let at = if n < 6 { cut + n - 3 } else { cut + 2 * n };
                let mut arrived = sent.clone();
                corrupt(&mut arrived[at].packet, n as u64);
                let run = Run::of(config(), &arrived);
                run.check_sent(&arrived);
                let place = format!(
                    "{model} {mode}, {what} ({n}) at {at}: {:?} {:?}",
                    run.counts,
                    run.flags()
                );
                let mut whole = BTreeSet::from_iter(0..sent.len());
                whole.remove(&at);
                let decoded = run.decoded();
                assert!(
                    whole.is_subset(&decoded),
                    "{place} {:?}",
                    whole.difference(&decoded).collect::<Vec<_>>()
                );
                assert_eq!(
                    run.counts.lost,
                    u64::from(!decoded.contains(&at)),
                    "{place}"
                );
                assert_eq!(run.flags(), clean.flags(), "{place}");
                let columns = |run: &Run| {
                    run.views()
                        .iter()
                        .map(|s| s.columns.len())
                        .collect::<Vec<_>>()
                };
                let off = columns(&run)
                    .iter()
                    .zip(columns(&clean))
                    .any(|(a, b)| a.abs_diff(b) > 2);
                assert!(!off, "{place}");
            }
        }
    }
}

#[test]
fn two_corrupt_packets_in_a_row_and_a_corrupt_end_cost_no_more() {
    let sent = Spin {
        clock_ns: 1_800_000_000_000,
        ..Spin::new(Vlp16, Strongest, 600.0)
    }
    .packets(0.32);
    let clean = Run::of(config(), &sent);
    for (what, corrupt) in corruptions() {
        for (n, at) in [
            (1, 60),
            (5, 90),
            (8, clean.out_after[0] - 2),
            (3, sent.len() - 1),
        ] {
            let mut arrived = sent.clone();
            corrupt(&mut arrived[at].packet, n);
            if at + 1 < sent.len() {
                corrupt(&mut arrived[at + 1].packet, n + 2);
            }
            let run = Run::of(config(), &arrived);
            run.check_sent(&arrived);
            let place = format!("{what} ({n}) at {at}: {:?} {:?}", run.counts, run.flags());
            assert!(run.decoded().len() + 2 >= sent.len(), "{place}");
            assert!(run.counts.lost <= 2, "{place}");
            // Two that agree with each other are a change of mode, or of place.
            if !matches!(
                what,
                "return mode, another" | "return mode, dual or not" | "all azimuths"
            ) {
                assert_eq!(run.sweeps.len(), clean.sweeps.len(), "{place}");
            }
        }
    }
}

#[test]
fn a_head_may_turn_the_other_way() {
    for (model, mode) in KINDS {
        let sent = Spin::new(model, mode, -600.0).packets(0.55);
        let arrived = without(&sent, |n| {
            (100..110).contains(&n) || (150..190).contains(&n)
        });
        let run = Run::of(cut_at(12.3), &arrived);
        run.check_sent(&arrived);
        assert_counts(
            &run,
            Counts {
                lost: 50,
                ..Counts::default()
            },
        );
        let flags = run.flags();
        assert!(flags.iter().all(|&f| f & REVERSED != 0));
        assert!(
            flags[2..flags.len() - 1]
                .iter()
                .all(|&f| f == CIRCULAR | REVERSED),
            "{flags:?}"
        );
        assert_positions(&run, &sent, 40.0, 3_000);
    }
}

#[test]
fn a_head_that_stops_gives_small_partial_sweeps() {
    for jitter_cdeg in [0.0, 2.0, 11.0] {
        // Turns for 0.3 s, brakes for 0.2 s, stands for a second, starts again.
        let turns_at = |s: f64| match s {
            s if s < 0.3 => 10.0 * s,
            s if s < 0.5 => 3.0 + 10.0 * (s - 0.3) - 25.0 * (s - 0.3) * (s - 0.3),
            s if s < 1.5 => 4.0,
            s if s < 1.7 => 4.0 + 25.0 * (s - 1.5) * (s - 1.5),
            s => 5.0 + 10.0 * (s - 1.7),
        };
        let spin = Spin {
            turns_at: Box::new(turns_at),
            jitter_cdeg,
            ..Spin::new(Vlp16, Strongest, 600.0)
        };
        let sent = spin.packets(2.2);
        let arrived = without(&sent, |n| (600..605).contains(&n));
        let run = Run::of(config(), &arrived);
        run.check_sent(&arrived);
        assert_eq!(
            (run.counts.unconfirmed, run.counts.malformed),
            (0, 0),
            "{:?}",
            run.counts
        );
        let standing = run
            .views()
            .iter()
            .filter(|s| s.header.flags & STOPPED != 0)
            .count();
        assert!((3..=6).contains(&standing), "{standing} {:?}", run.flags());
        let unstable = STOPPED | PARTIAL | RATE_UNSTABLE;
        assert!(
            run.flags()
                .iter()
                .all(|f| f & STOPPED == 0 || *f == unstable),
            "{:?}",
            run.flags()
        );
        assert!(
            run.views()
                .iter()
                .all(|s| s.header.duration_ns < 320_000_000 && s.header.sensor_time_ns > 0)
        );
        assert_eq!(run.flags()[1] & (PARTIAL | CIRCULAR | STOPPED), CIRCULAR);
        assert_eq!(
            run.flags()[run.sweeps.len() - 2],
            CIRCULAR,
            "{:?}",
            run.flags()
        );
        assert!(run.sweeps.len() < 20);
    }
}

#[test]
fn another_model_on_the_same_address_is_detected_again() {
    let mut arrived = Spin::new(Vlp16, Strongest, 600.0).packets(0.25);
    let own = arrived.len();
    arrived.extend(
        Spin::new(Hdl32e, Dual, 600.0)
            .packets(0.25)
            .into_iter()
            .map(|mut one| {
                one.arrival_ns += 250_000_000;
                one
            }),
    );
    let run = Run::of(config(), &arrived);
    assert_counts(
        &run,
        Counts {
            foreign: 8,
            ..Counts::default()
        },
    );
    let rows: Vec<usize> = run.views().iter().map(|sweep| sweep.rows()).collect();
    assert_eq!(rows, [16, 16, 16, 32, 32, 32]);
    // One run, whose sweeps are counted through.
    assert_eq!(
        run.views()
            .iter()
            .map(|sweep| sweep.header.sequence)
            .collect::<Vec<_>>(),
        [0, 1, 2, 3, 4, 5]
    );
    assert_eq!(run.decoded().len(), arrived.len() - 8);
    assert!(run.decoded().contains(&(own - 1)));
}

#[test]
fn silence_closes_the_sweep_once() {
    let sent = Spin::new(Vlp16, Strongest, 600.0).packets(1.2);
    let mut pipeline = Pipeline::new("test", config()).unwrap();
    let mut memory = Memory::new(HeapBuffers::default());
    let push = |pipeline: &mut Pipeline, memory: &mut Memory<HeapBuffers>, one: &Sent| {
        pipeline.push(
            &stream::datagram(one.packet.emit(), one.arrival_ns)
                .parse()
                .unwrap(),
        );
        std::iter::from_fn(|| next_sweep(pipeline, memory)).count()
    };
    // Packet 18 is missing, so that 19 is held when the silence begins.
    let before: usize = sent[..18]
        .iter()
        .chain(&sent[19..20])
        .map(|one| push(&mut pipeline, &mut memory, one))
        .sum();
    assert_eq!(before, 0);
    let newest_ns = sent[19].arrival_ns;
    pipeline.idle(Some(newest_ns + 400_000_000));
    assert!(next_sweep(&mut pipeline, &mut memory).is_none());
    pipeline.idle(Some(newest_ns + 600_000_000));
    assert!(next_sweep(&mut pipeline, &mut memory).is_some());
    assert!(next_sweep(&mut pipeline, &mut memory).is_none());
    assert_eq!(pipeline.status().counts.lost, 1);
    pipeline.idle(Some(newest_ns + 900_000_000));
    assert!(next_sweep(&mut pipeline, &mut memory).is_none());
    let after: usize = sent[500..600]
        .iter()
        .map(|one| push(&mut pipeline, &mut memory, one))
        .sum();
    assert_eq!((after, pipeline.status().counts.lost), (2, 480 + 1));
    pipeline.end();
    assert!(
        next_sweep(&mut pipeline, &mut memory).is_some()
            && next_sweep(&mut pipeline, &mut memory).is_none()
    );
}

#[test]
fn arrival_changes_nothing_but_arrival() {
    for (model, mode) in KINDS {
        let sent = Spin::new(model, mode, 600.0).packets(0.35);
        let mut arrived = without(&sent, |n| n % 37 == 30 || (60..90).contains(&n));
        let clean = Run::of(config(), &arrived);
        let mut rng = fastrand::Rng::with_seed(3);
        for one in &mut arrived {
            one.arrival_ns += rng.i64(0..15_000_000);
        }
        let run = Run::of(config(), &arrived);
        assert_eq!(run.counts, clean.counts);
        assert!(run.content(&arrived) == clean.content(&arrived));
    }
}

/// Detected as what it is, then exposed to anything.
fn exposed(head: &[Sent], then: Vec<DataPacket>, config: sweepd::pipeline::Config) -> Run {
    let arrived: Vec<DataPacket> = head.iter().map(|one| one.packet).chain(then).collect();
    let payloads: Vec<_> = (0..)
        .zip(&arrived)
        .map(|(n, p): (i64, _)| (p.emit().to_vec(), stream::START_NS + n * 700_000))
        .collect();
    let run = Run::of_payloads(config, &payloads);
    run.check(&arrived);
    run
}

proptest! {
    #![proptest_config(ProptestConfig { cases: if cases::are_all() { 24 } else { 6 }, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn any_sequence_of_real_packets_keeps_the_promises(
        kind in 0..4_usize,
        seed in any::<u64>(),
        picks in proptest::collection::vec((0..4_u8, 0..400_usize), 300),
    ) {
        let (model, mode) = KINDS[kind];
        let spin = Spin { seed, fov: (seed % 3 == 0).then_some((27_000.0, 9_100.0)), ..Spin::new(model, mode, 1200.0) };
        let sent = spin.packets(0.6);
        let mut at = 20;
        let mut then = Vec::new();
        for (what, far) in picks {
            at = match what {
                0 | 1 => at + 1,
                2 => at + far % 9,
                _ => (at + far).saturating_sub(200),
            } % sent.len();
            then.push(sent[at].packet);
        }
        exposed(&sent[..20], then, cut_at((seed % 36_000) as f64 / 100.0));
    }

    #[test]
    fn mutated_packets_keep_the_promises(
        kind in 0..4_usize,
        seed in any::<u64>(),
        hits in proptest::collection::vec((0..250_usize, 0..1206_usize, any::<u8>()), 0..60),
    ) {
        let (model, mode) = KINDS[kind];
        let sent = Spin { seed, ..Spin::new(model, mode, 1200.0) }.packets(0.35);
        let mut then: Vec<[u8; 1206]> = sent[20..].iter().map(|one| one.packet.emit().try_into().unwrap()).collect();
        for (at, byte, mask) in hits {
            let at = at % then.len();
            // Half of the hits go where it hurts.
            let byte = if mask & 1 == 0 { [2, 3, 1102, 1103, 1200, 1201, 1202, 1203, 1204, 1205][byte % 10] } else { byte };
            then[at][byte] ^= mask;
        }
        let then = then.iter().map(|bytes| *zerocopy::transmute_ref!(bytes)).collect();
        let run = exposed(&sent[..20], then, config());
        // Another product byte refuses a packet; whatever else happened, most of the stream is
        // there.
        prop_assert!(run.decoded().len() > sent.len() / 3, "{:?}", run.counts);
    }

    #[test]
    fn random_bytes_keep_the_promises(kind in 0..4_usize, seed in any::<u64>(), tame in any::<bool>()) {
        let (model, mode) = KINDS[kind];
        let sent = Spin::new(model, mode, 600.0).packets(0.04);
        let mut rng = fastrand::Rng::with_seed(seed);
        let mut stamp = sent[19].packet.stamp_us();
        let then = (0..300).map(|_| {
            let mut packet = sent[rng.usize(..sent.len())].packet;
            stamp = if tame { stamp + rng.u32(0..3_000) } else { rng.u32(..) };
            packet.set_stamp_us(stamp);
            let (first, step) = (rng.u16(..36_000), rng.u16(..600));
            for (n, block) in (0..).zip(&mut packet.blocks) {
                let jump = if rng.u8(..) < 20 { rng.u16(..36_000) } else { 0 };
                block.set_azimuth_cdeg(((u32::from(first) + u32::from(step) * n + u32::from(jump)) % 36_000) as u16);
            }
            if rng.u8(..) < 8 {
                packet.return_mode = rng.u8(0x36..0x3B);
            }
            packet
        });
        exposed(&sent[..20], then.collect(), config());
    }
}
