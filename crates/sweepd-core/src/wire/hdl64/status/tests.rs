use proptest::prelude::*;
use zerocopy::little_endian::{I16, U16};
use zerocopy::{FromZeros, IntoBytes};

use super::super::{BEAMS, DUMP_PACKETS, Live, emit, pair};
use super::*;
use crate::wire::HOUR_US;

/// A unit with random bytes from the seed.
fn unit(seed: u64, series: Series) -> (Dump, Live) {
    let mut random = fastrand::Rng::with_seed(seed);
    let records = std::array::from_fn::<_, BEAMS, _>(|id| {
        let mut record = BeamRecord::new_zeroed();
        random.fill(record.as_mut_bytes());
        BeamRecord {
            id: id as u8,
            ..record
        }
    });
    let mut dump = Dump::new(series, &records);
    dump.noise = [24, 25];
    dump.calibration_time = CalibrationTime {
        year: 16,
        month: 11,
        day: 15,
        hour: 12,
        minute: 47,
        second: 47,
    };
    dump.humidity = 25;
    dump.rpm = I16::new(random.i16(300..1200));
    dump.fov_cdeg = [
        U16::new(random.u16(..36_000)),
        U16::new(random.u16(..36_000)),
    ];
    dump.life_hours = U16::new(random.u16(..));
    (dump.source, dump.destination) = ([192, 168, 3, 43], [192, 168, 3, 255]);
    dump.set_return_mode(ReturnMode::Dual);
    dump.set_warnings(series, Warnings(0b0110_0001));
    let clock = Clock {
        hour: 23,
        minute: 59,
        second: 58,
        day: 31,
        month: 12,
        year: 26,
    };
    (
        dump,
        Live {
            clock,
            gps: Gps::Both,
            temperature_c: -7,
            firmware: 0x47,
        },
    )
}

/// The packets from `start` on that `keep` keeps, 288 us apart.
fn push(
    status: &mut Status,
    (dump, live): &(Dump, Live),
    series: Series,
    packets: Range<usize>,
    mut keep: impl FnMut() -> bool,
) {
    for index in packets {
        let (kind, value) = pair(dump, series, live, index);
        if keep() {
            status.push(
                kind,
                value,
                (index as u64 * 288 % u64::from(HOUR_US)) as u32,
            );
        }
    }
}

const SERIES: [Series; 2] = [Series::S21, Series::S3];

#[test]
fn crc_is_the_published_one() {
    // CRC-16/BUYPASS of the usual check string.
    assert_eq!(super::super::crc16(0, b"123456789"), 0xFEE8);
}

#[test]
fn packets_are_those_of_the_manual() {
    let (mut dump, live) = unit(1, Series::S3);
    dump.entries[0].record.elevation_cdeg = I16::new(0x0102);
    dump.rpm = I16::new(600);
    let packets: Vec<(u8, u8)> = emit(&dump, Series::S3, &live).collect();
    let text = |range: Range<usize>| {
        packets[range]
            .iter()
            .map(|pair| pair.0 as char)
            .collect::<String>()
    };
    assert_eq!(
        (packets.len(), text(0..14)),
        (4160, "HMSDNYGTV12345".to_owned())
    );
    assert_eq!(
        packets[9..14].iter().map(|pair| pair.1).collect::<Vec<_>>(),
        b"UNIT#"
    );
    assert_eq!(packets[14..16], [(0xF7, 24), (0xF6, 25)]);
    assert_eq!(packets[16 + 9..16 + 12], [(b'1', 0), (b'2', 2), (b'3', 1)]);
    assert_eq!(packets[4 * 16 + 9], (b'W', 0b0110_0001));
    assert_eq!(packets[5 * 16 + 9], (b'1', 1));
    assert_eq!(
        packets[257 * 16 + 9..257 * 16 + 11],
        [(0xFE, 0x58), (0xFF, 0x02)]
    );
    assert_eq!(
        (packets[259 * 16 + 11], packets[259 * 16 + 13].0),
        ((0xF9, 2), 0xF8)
    );
    assert!(emit(&dump, Series::S21, &live).all(|(kind, _)| kind != b'W'));
}

#[test]
fn every_value_of_a_dump_can_be_read() {
    for series in SERIES {
        let unit = unit(2, series);
        let (dump, live) = &unit;
        let mut status = Status::new();
        push(&mut status, &unit, series, 0..DUMP_PACKETS, || true);
        assert_eq!(
            (status.dump_state(), status.known(), status.series()),
            (DumpState::Verified, DUMP_LEN, Some(series))
        );
        assert_eq!(status.dump(), Some(dump));
        assert_eq!(
            (status.clock(), status.gps()),
            (Some(live.clock), Some(live.gps))
        );
        assert_eq!(
            (status.temperature_c(), status.firmware()),
            (Some(-7), Some(0x47))
        );
        assert_eq!(
            (status.rpm(), status.life_hours()),
            (Some(dump.rpm.get()), Some(dump.life_hours.get()))
        );
        assert_eq!(status.fov_cdeg(), Some(dump.fov_cdeg.map(U16::get)));
        assert_eq!(
            (status.source(), status.destination()),
            (Some(dump.source), Some(dump.destination))
        );
        assert_eq!(
            (status.return_mode(), status.power()),
            (Some(ReturnMode::Dual), Some(Power(0xA0)))
        );
        assert_eq!(status.calibrated(), dump.calibrated());
        let warnings = status.warnings().unwrap();
        assert!(warnings.pps() && warnings.gps_time());
        assert_eq!(
            warnings.faults(series).collect::<Vec<_>>(),
            ["lens contaminated"]
        );
    }
}

#[test]
fn one_percent_loss_is_made_good_within_three_dumps() {
    for series in SERIES {
        let mut complete = 0;
        for seed in 0..100 {
            let unit = unit(seed, series);
            let mut random = fastrand::Rng::with_seed(1000 + seed);
            let start = random.usize(..DUMP_PACKETS);
            let mut status = Status::new();
            push(
                &mut status,
                &unit,
                series,
                start..start + 3 * DUMP_PACKETS,
                || random.u8(..100) > 0,
            );
            if status.dump_state() == DumpState::Verified {
                assert_eq!(status.dump(), Some(&unit.0), "seed {seed}");
                complete += 1;
            }
        }
        assert!(complete >= 99, "{series}: {complete} of 100");
    }
}

#[test]
fn bursts_and_other_return_modes_do_not_lose_the_place() {
    let unit = unit(5, Series::S3);
    let (dump, live) = &unit;
    let mut status = Status::new();
    let mut stamp_us = HOUR_US - 1_000_000;
    for index in 0..4 * DUMP_PACKETS {
        // 100 of every 1500 packets are lost; in the middle, the unit is switched from single to
        // dual return.
        stamp_us = (stamp_us + if index < 6000 { 288 } else { 173 }) % HOUR_US;
        if index % 1500 < 1400 {
            let (kind, value) = pair(dump, Series::S3, live, index);
            status.push(kind, value, stamp_us);
        }
    }
    assert_eq!(
        (status.dump_state(), status.dump()),
        (DumpState::Verified, Some(dump))
    );
}

#[test]
fn copies_and_late_packets_do_no_harm() {
    let unit = unit(6, Series::S3);
    let (dump, live) = &unit;
    let mut order: Vec<usize> = (0..DUMP_PACKETS).collect();
    for index in (100..DUMP_PACKETS - 1).step_by(97) {
        order.swap(index, index + 1);
        order[index - 50] = order[index - 51];
    }
    let mut status = Status::new();
    for round in 0..2 {
        for &index in &order {
            let (kind, value) = pair(dump, Series::S3, live, index);
            status.push(kind, value, ((index + round * DUMP_PACKETS) * 288) as u32);
        }
    }
    // Packets overwritten by a copy are lost.
    let lost = (100..DUMP_PACKETS - 1)
        .step_by(97)
        .filter(|index| (index - 50) % CYCLE_LEN >= FIXED.len())
        .count();
    assert_eq!(status.known(), DUMP_LEN - lost);
    push(
        &mut status,
        &unit,
        Series::S3,
        2 * DUMP_PACKETS..3 * DUMP_PACKETS,
        || true,
    );
    assert_eq!(
        (status.dump_state(), status.dump()),
        (DumpState::Verified, Some(dump))
    );
}

#[test]
fn a_clock_that_is_set_and_a_long_silence_cost_no_wrong_byte() {
    let unit = unit(7, Series::S3);
    let (dump, live) = &unit;
    for jump_us in [3, 4_700, 16 * 288, 300_000, 900_000, 2_000_000_000] {
        let mut status = Status::new();
        for index in 0..3 * DUMP_PACKETS {
            let (kind, value) = pair(dump, Series::S3, live, index);
            let jumped = if index < 2000 { 0 } else { jump_us };
            status.push(kind, value, index as u32 * 288 + jumped);
        }
        assert_eq!(
            (status.dump_state(), status.dump()),
            (DumpState::Verified, Some(dump)),
            "{jump_us} us"
        );
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]

    #[test]
    fn reading_gives_back_what_was_written(seed in any::<u64>(), start in 0..DUMP_PACKETS, s3 in any::<bool>()) {
        let series = SERIES[usize::from(s3)];
        let unit = unit(seed, series);
        let mut status = Status::new();
        push(&mut status, &unit, series, start..start + DUMP_PACKETS, || true);
        prop_assert_eq!(status.dump_state(), DumpState::Verified);
        prop_assert_eq!(status.dump(), Some(&unit.0));
        prop_assert_eq!(status.series(), Some(series));
    }

    #[test]
    fn a_corrupt_beam_is_caught_and_made_good(seed in any::<u64>(), beam in 0..BEAMS, byte in 1..21_usize, flip in 1..=255_u8) {
        let unit = unit(seed, Series::S3);
        let (dump, live) = &unit;
        let place = offset_of!(Dump, entries) + beam * size_of::<BeamEntry>() + byte;
        let corrupt = place / PAYLOAD_LEN * CYCLE_LEN + FIXED.len() + place % PAYLOAD_LEN;
        let mut status = Status::new();
        for index in 0..2 * DUMP_PACKETS {
            let (kind, value) = pair(dump, Series::S3, live, index);
            let flip = if index == corrupt { flip } else { 0 };
            status.push(kind, value ^ flip, index as u32 * 288);
            if index + 1 == DUMP_PACKETS {
                let caught = matches!(status.dump_state(), DumpState::Contradictory(DumpError::Checksum { .. }));
                prop_assert!(caught);
            }
        }
        prop_assert_eq!(status.dump_state(), DumpState::Verified);
        prop_assert_eq!(status.dump(), Some(dump));
    }

    #[test]
    fn any_packets_are_taken(
        noise in proptest::collection::vec((any::<u8>(), any::<u8>(), any::<u32>()), 0..400),
        near in proptest::collection::vec((proptest::sample::select(b"HMSDNYGTVW1234567\xF6\xF7\xF8\xF9\xFA\xFE".to_vec()),
            any::<u8>(), 0..2000_u32), 0..4000),
    ) {
        let mut status = Status::new();
        for (kind, value, stamp_us) in noise {
            status.push(kind, value, stamp_us);
        }
        let mut stamp_us = 0_u32;
        for (kind, value, delta_us) in near {
            stamp_us = stamp_us.wrapping_add(delta_us);
            status.push(kind, value, stamp_us);
        }
        prop_assert!(status.known() < DUMP_LEN && status.dump().is_none());
        let unit = unit(3, Series::S3);
        push(&mut status, &unit, Series::S3, 0..4 * DUMP_PACKETS, || true);
        prop_assert_eq!(status.dump(), Some(&unit.0));
    }
}
