use super::*;
use crate::wire::data::FLAG_BANK_1;
use proptest::prelude::*;

const SINGLE: u8 = 0x37;
const DUAL: u8 = 0x39;
const VLP16_NS: u64 = 1_327_104;
const HDL32E_NS: u64 = 552_960;

/// A packet of a turning head, its azimuths in pairs or not.
fn packet(stamp_us: u32, bytes: (u8, u8), paired: bool) -> DataPacket {
    let mut packet = DataPacket::new(stamp_us, bytes.0, bytes.1);
    for (index, block) in packet.blocks.iter_mut().enumerate() {
        let step = if paired { index / 2 } else { index };
        block.set_azimuth_cdeg(100 + 20 * step as u16);
    }
    packet
}

/// Stamps as a sensor makes them: packets of this many periods after the first, cut to
/// microseconds.
fn stamps(period_ns: u64, packets: &[u64]) -> Vec<u32> {
    packets
        .iter()
        .map(|packet| ((777_000_400 + packet * period_ns) / 1_000) as u32)
        .collect()
}

/// The result and the number of packets until it, 0 for a result at the end of the stream.
fn run(
    forced: Option<Model>,
    bytes: (u8, u8),
    paired: bool,
    stamps: &[u32],
) -> (usize, Result<Detection, DetectError>) {
    let mut detector = Detector::new(forced);
    for (index, &stamp) in stamps.iter().enumerate() {
        if let Some(verdict) = detector.observe(&packet(stamp, bytes, paired)) {
            return (index + 1, verdict);
        }
    }
    (0, detector.conclude())
}

fn found(model: Model, return_mode: ReturnMode, basis: Basis) -> Result<Detection, DetectError> {
    Ok(Detection {
        model,
        return_mode,
        basis,
        spec: model.spec(),
    })
}

#[test]
fn three_packets_in_order_are_enough() {
    use ReturnMode::{Dual, Strongest};
    let cases = [
        (
            (SINGLE, 0x22),
            VLP16_NS,
            Model::Vlp16,
            Strongest,
            Basis::BytesAndPeriod,
        ),
        (
            (SINGLE, 0x24),
            VLP16_NS,
            Model::PuckHiRes,
            Strongest,
            Basis::BytesAndPeriod,
        ),
        (
            (SINGLE, 0x21),
            HDL32E_NS,
            Model::Hdl32e,
            Strongest,
            Basis::BytesAndPeriod,
        ),
        (
            (0x38, 0x21),
            HDL32E_NS,
            Model::Hdl32e,
            ReturnMode::Last,
            Basis::BytesAndPeriod,
        ),
        (
            (DUAL, 0x22),
            VLP16_NS / 2,
            Model::Vlp16,
            Dual,
            Basis::BytesAndPeriod,
        ),
        (
            (DUAL, 0x21),
            HDL32E_NS / 2,
            Model::Hdl32e,
            Dual,
            Basis::BytesAndPeriod,
        ),
        // Early VLP-16 firmware.
        (
            (SINGLE, 0x21),
            VLP16_NS,
            Model::Vlp16,
            Strongest,
            Basis::Period,
        ),
        (
            (DUAL, 0x21),
            VLP16_NS / 2,
            Model::Vlp16,
            Dual,
            Basis::Period,
        ),
        // Blank bytes.
        ((0, 0), VLP16_NS, Model::Vlp16, Strongest, Basis::Period),
        ((0, 0), HDL32E_NS, Model::Hdl32e, Strongest, Basis::Period),
        ((0, 0), VLP16_NS / 2, Model::Vlp16, Dual, Basis::Period),
        ((0, 0), HDL32E_NS / 2, Model::Hdl32e, Dual, Basis::Period),
    ];
    for (bytes, period_ns, model, mode, basis) in cases {
        let verdict = run(None, bytes, mode == Dual, &stamps(period_ns, &[0, 1, 2, 3]));
        assert_eq!(
            verdict,
            (3, found(model, mode, basis)),
            "{bytes:x?} {period_ns}"
        );
    }
}

#[test]
fn loss_duplicates_and_reordering_do_not_mislead() {
    let vlp16 = found(Model::Vlp16, ReturnMode::Strongest, Basis::BytesAndPeriod);
    let hdl32e = found(Model::Hdl32e, ReturnMode::Strongest, Basis::BytesAndPeriod);
    let orders: [(&[u64], usize); 5] = [
        (&[0, 2, 5], 3),
        (&[0, 0, 1, 1, 2], 5),
        (&[0, 2, 1], 3),
        (&[3, 4, 0, 1], 3),
        // Five packets of a VLP-16 take as long as twelve of an HDL-32E: such a gap is ambiguous.
        (&[0, 5, 10, 11, 12, 13], 6),
    ];
    for (order, needed) in orders {
        assert_eq!(
            run(None, (SINGLE, 0x22), false, &stamps(VLP16_NS, order)),
            (needed, vlp16),
            "{order:?}"
        );
    }
    assert_eq!(
        run(
            None,
            (SINGLE, 0x21),
            false,
            &stamps(HDL32E_NS, &[0, 12, 24, 25, 26, 27])
        ),
        (6, hdl32e)
    );
}

#[test]
fn the_hour_may_end_within_the_stream() {
    let stamps = [3_599_998_900, 227, 1_554];
    let verdict = run(None, (SINGLE, 0x22), false, &stamps);
    assert_eq!(
        verdict,
        (
            3,
            found(Model::Vlp16, ReturnMode::Strongest, Basis::BytesAndPeriod)
        )
    );
}

#[test]
fn the_odd_interval_of_a_field_of_view_is_outvoted() {
    let mut times = stamps(VLP16_NS, &[0, 1]);
    let gap = times[1] + 50_311;
    times.extend([gap, gap + 1_327, gap + 2_654]);
    let verdict = run(None, (0, 0), false, &times);
    assert_eq!(
        verdict,
        (4, found(Model::Vlp16, ReturnMode::Strongest, Basis::Period))
    );
}

#[test]
fn the_mode_of_a_head_that_stands_still_follows_from_the_period() {
    for (period_ns, mode) in [
        (HDL32E_NS, ReturnMode::Strongest),
        (HDL32E_NS / 2, ReturnMode::Dual),
    ] {
        let mut detector = Detector::new(None);
        let verdict = stamps(period_ns, &[0, 1, 2])
            .into_iter()
            .find_map(|s| detector.observe(&DataPacket::new(s, 0, 0)));
        assert_eq!(verdict, Some(found(Model::Hdl32e, mode, Basis::Period)));
    }
}

#[test]
fn unsupported_sensors_are_named_at_once() {
    let verdict = run(None, (SINGLE, 0x31), false, &[0]);
    let sensor = "Velarray";
    assert_eq!(verdict, (1, Err(DetectError::Unsupported { sensor })));
    let message = run(None, (SINGLE, 0x23), false, &[0])
        .1
        .unwrap_err()
        .to_string();
    assert_eq!(
        message,
        "this is the stream of another sensor, VLP-32A or VLP-32B"
    );
    let mut s1 = DataPacket::new(0, SINGLE, 0x22);
    s1.blocks
        .iter_mut()
        .skip(2)
        .step_by(4)
        .for_each(|block| block.flag.set(FLAG_BANK_1));
    for forced in [None, Some(Model::Vlp16)] {
        let verdict = Detector::new(forced).observe(&s1);
        assert_eq!(
            verdict,
            Some(Err(DetectError::Unsupported {
                sensor: "HDL-64E S1"
            }))
        );
    }
    let mut mixed = DataPacket::new(0, SINGLE, 0xA1);
    mixed.blocks[1].flag.set(FLAG_BANK_1);
    let verdict = Detector::new(Some(Model::Vlp16)).observe(&mixed);
    let sensor = "one whose lasers are in no known order";
    assert_eq!(verdict, Some(Err(DetectError::Unsupported { sensor })));
    let triple = four_banks(0, TRIPLE, 3);
    let verdict = Detector::new(Some(Model::Vls128)).observe(&triple);
    let sensor = "VLS-128 with three returns (mode 0x3A)";
    assert_eq!(verdict, Some(Err(DetectError::Unsupported { sensor })));
}

/// A packet of four banks, each in this many blocks in turn; one of two has four unused blocks.
fn four_banks(stamp_us: u32, mode: u8, blocks_of_bank: usize) -> DataPacket {
    let mut packet = DataPacket::new(stamp_us, mode, 0);
    for (index, block) in packet.blocks.iter_mut().enumerate() {
        let bank = match blocks_of_bank {
            1 => index % 4,
            count => index / count,
        };
        let flags = [0xEEFF, 0xDDFF, 0xCCFF, 0xBBFF, 0, 0xFFFF];
        block.flag.set(flags[bank]);
    }
    packet
}

/// Periods of models.md: 160.0, 165.82 and 173.4 us with one return, a third of that with two;
/// stamps of the second are a random walk.
#[test]
fn a_vls128_is_told_by_its_flags_and_its_firmware_by_the_mean_interval() {
    let mut rng = fastrand::Rng::with_seed(1);
    for (mode, blocks, third) in [
        (SINGLE, 1, 1.0),
        (0x38, 1, 1.0),
        (DUAL, 2, 3.0),
        (0x3B, 3, 3.0),
    ] {
        for (number, period_us) in [(1, 160.0), (0, 165.82), (2, 173.4)] {
            for _ in 0..50 {
                let mut detector = Detector::new(None);
                let mut clock_us = 5e6 + rng.f64();
                let verdict = (0..MAX_PACKETS).find_map(|_| {
                    let rest = if number == 0 {
                        2.0 * rng.f64() - 1.0
                    } else {
                        0.0
                    };
                    clock_us += period_us / third + rest / f64::sqrt(third);
                    detector.observe(&four_banks(clock_us as u32, mode, blocks))
                });
                let found = verdict.unwrap().unwrap();
                assert_eq!(
                    (found.model, found.basis),
                    (Model::Vls128, Basis::FourBanks)
                );
                let expected = match mode {
                    0x38 => ReturnMode::Last,
                    SINGLE => ReturnMode::Strongest,
                    _ => ReturnMode::Dual,
                };
                assert_eq!(found.return_mode, expected);
                assert_eq!(
                    found.spec,
                    Model::Vls128.specs()[number],
                    "{mode:#x} {period_us}"
                );
            }
        }
    }
    // Neither a factory byte nor the user turns it into another sensor.
    let mut detector = Detector::new(Some(Model::Vlp16));
    detector.observe(&four_banks(0, SINGLE, 1));
    assert_eq!(
        detector.conclude().unwrap_err().to_string(),
        "the given model is VLP-16, but the blocks of its packets have four banks of lasers, as those of the VLS-128 do"
    );
}

/// Packets of a head at 600 rpm: azimuth by azimuth, each this long after the other.
fn turning(azimuth_us: f64, paired: bool, azimuths: &[usize]) -> Vec<DataPacket> {
    let cdeg_us = 0.36;
    azimuths
        .iter()
        .map(|&first| {
            let mut packet = DataPacket::new((9e6 + first as f64 * azimuth_us) as u32, 0, 0);
            for (index, block) in packet.blocks.iter_mut().enumerate() {
                let step = if paired { index / 2 } else { index };
                let turned = (first + step) as f64 * azimuth_us * cdeg_us;
                block.set_azimuth_cdeg((turned.round() % 36_000.0) as u16);
            }
            packet
        })
        .collect()
}

#[test]
fn the_turn_of_the_head_tells_models_of_one_bank_whatever_was_lost() {
    use ReturnMode::{Dual, Strongest};
    for (model, azimuth_us) in [
        (Model::Vlp16, 110.592),
        (Model::Hdl32e, 46.08),
        (Model::Vlp32c, 55.296),
    ] {
        for (paired, mode) in [(false, Strongest), (true, Dual)] {
            let in_packet = if paired { 6 } else { 12 };
            for lost in 0..30 {
                // The second packet, and some more as far apart.
                for count in [2, 4] {
                    let azimuths: Vec<_> = (0..count).map(|n| n * (lost + 1) * in_packet).collect();
                    let mut detector = Detector::new(None);
                    let verdict = turning(azimuth_us, paired, &azimuths)
                        .iter()
                        .find_map(|packet| detector.observe(packet));
                    let found = verdict.unwrap_or_else(|| detector.conclude()).unwrap();
                    assert_eq!(
                        (found.model, found.return_mode),
                        (model, mode),
                        "{lost} lost of each {count}"
                    );
                }
            }
        }
    }
}

#[test]
fn unknown_product_bytes_need_the_user() {
    let times = stamps(VLP16_NS, &[0, 1, 2]);
    assert_eq!(
        run(None, (SINGLE, 0x77), false, &times),
        (1, Err(DetectError::UnknownProduct { product: 0x77 }))
    );
    let verdict = run(Some(Model::PuckLite), (SINGLE, 0x77), false, &times);
    assert_eq!(
        verdict,
        (
            3,
            found(
                Model::PuckLite,
                ReturnMode::Strongest,
                Basis::GivenAgainstBytes
            )
        )
    );
}

#[test]
fn the_user_beats_the_bytes_but_not_the_period() {
    let vlp16 = stamps(VLP16_NS, &[0, 1, 2]);
    let given = |model| found(model, ReturnMode::Strongest, Basis::GivenAgainstBytes);
    assert_eq!(
        run(Some(Model::PuckHiRes), (SINGLE, 0x22), false, &vlp16),
        (3, given(Model::PuckHiRes))
    );
    let hdl32e = stamps(HDL32E_NS, &[0, 1, 2]);
    assert_eq!(
        run(Some(Model::Hdl32e), (SINGLE, 0x22), false, &hdl32e),
        (3, given(Model::Hdl32e))
    );
    let (packets, verdict) = run(Some(Model::Hdl32e), (SINGLE, 0x21), false, &vlp16);
    assert_eq!(packets, 3);
    assert_eq!(
        verdict.unwrap_err().to_string(),
        "the given model is HDL-32E, but packets come 1327 us apart, as those of the VLP-16 do"
    );
}

#[test]
fn the_user_does_not_turn_another_sensor_into_a_vlp16() {
    // A VLP-32C: its period is half that of a VLP-16.
    let times = stamps(VLP16_NS / 2, &(0..12).collect::<Vec<_>>());
    let (_, verdict) = run(Some(Model::Vlp16), (SINGLE, 0x28), false, &times);
    assert_eq!(
        verdict.unwrap_err().to_string(),
        "the given model is VLP-16, but packets come 663 us apart, as those of the VLP-32C do"
    );
    // A VLP-32MR has the same beams and an unknown byte.
    let (_, verdict) = run(Some(Model::Vlp32c), (SINGLE, 0x99), false, &times);
    assert_eq!(
        verdict,
        found(
            Model::Vlp32c,
            ReturnMode::Strongest,
            Basis::GivenAgainstBytes
        )
    );
}

#[test]
fn a_byte_that_contradicts_the_period_is_an_error() {
    for product in [0x22, 0x24] {
        let (packets, verdict) = run(
            None,
            (SINGLE, product),
            false,
            &stamps(HDL32E_NS, &[0, 1, 2]),
        );
        let message = verdict.unwrap_err().to_string();
        assert_eq!(packets, 3);
        assert!(
            message.starts_with("the model by the product byte is "),
            "{message}"
        );
        assert!(
            message.ends_with("553 us apart, as those of the HDL-32E do"),
            "{message}"
        );
    }
}

#[test]
fn a_period_of_no_model_is_an_error_after_the_last_packet() {
    let times = stamps(800_000, &(0..20).collect::<Vec<_>>());
    for forced in [None, Some(Model::Vlp16)] {
        let (packets, verdict) = run(forced, (SINGLE, 0x22), false, &times);
        assert_eq!(packets, MAX_PACKETS);
        let mode = ReturnMode::Strongest;
        assert_eq!(
            verdict,
            Err(DetectError::UnknownPeriod {
                median_us: 800,
                mode,
                banks: Banks::One
            })
        );
        let message = verdict.unwrap_err().to_string();
        assert!(
            message.contains("800 us apart")
                && message.ends_with(
                    "1327.1 us on the VLP-16, 553.0 us on the HDL-32E, 663.6 us on the VLP-32C"
                ),
            "{message}"
        );
    }
}

#[test]
fn a_clock_that_stands_still_or_ticks_coarsely_is_an_error() {
    for (tick_us, period_ns) in [
        (0, VLP16_NS),
        (1_000, VLP16_NS),
        (2_000, VLP16_NS),
        (5_308, VLP16_NS),
        (1_000, HDL32E_NS),
        (10_000, VLP16_NS),
    ] {
        let exact = stamps(period_ns, &[0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11]);
        let mut detector = Detector::new(None);
        let verdicts = exact.iter().enumerate().filter_map(|(number, stamp_us)| {
            let stamp_us = stamp_us
                .checked_div(tick_us)
                .map_or(7, |ticks| ticks * tick_us);
            let mut packet = packet(stamp_us, (SINGLE, 0x22), false);
            packet.blocks[0].set_azimuth_cdeg(100 + 240 * number as u16);
            detector.observe(&packet)
        });
        let verdicts: Vec<_> = verdicts.collect();
        assert_eq!(
            verdicts,
            [Err(DetectError::Clock { tick_us })],
            "{period_ns}"
        );
    }
}

#[test]
fn a_period_of_whole_milliseconds_that_no_model_has_is_no_coarse_clock() {
    let whole = [0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11];
    for packets in [&whole[..], &[0, 1, 2, 4, 5]] {
        let times = stamps(3_000_000, packets);
        let (_, verdict) = run(None, (SINGLE, 0x22), false, &times);
        assert!(
            matches!(
                verdict,
                Err(DetectError::UnknownPeriod {
                    median_us: 3000,
                    ..
                })
            ),
            "{verdict:?}"
        );
    }
}

#[test]
fn streams_too_short_for_a_period_go_by_what_was_said() {
    let strongest = ReturnMode::Strongest;
    for packets in [&[0][..], &[0, 1], &[0, 0, 0, 1]] {
        let times = stamps(VLP16_NS, packets);
        let bytes = found(Model::PuckHiRes, strongest, Basis::BytesAlone);
        assert_eq!(run(None, (SINGLE, 0x24), false, &times), (0, bytes));
        let given = found(Model::Hdl32e, strongest, Basis::GivenAgainstBytes);
        assert_eq!(
            run(Some(Model::Hdl32e), (SINGLE, 0x22), false, &times),
            (0, given)
        );
        let blank = Err(DetectError::TooFewPackets {
            packets: times.len(),
        });
        assert_eq!(run(None, (0, 0), false, &times), (0, blank));
    }
    assert_eq!(
        Detector::new(None).conclude(),
        Err(DetectError::TooFewPackets { packets: 0 })
    );
    let dual = found(Model::Vlp16, ReturnMode::Dual, Basis::Given);
    assert_eq!(run(Some(Model::Vlp16), (0, 0), true, &[0]), (0, dual));
    // Only copies of one packet: there is no period, and detection still ends.
    let bytes = found(Model::Vlp16, strongest, Basis::BytesAlone);
    assert_eq!(
        run(None, (SINGLE, 0x22), false, &[5; 40]),
        (MAX_PACKETS, bytes)
    );
}

#[test]
fn a_change_of_return_mode_starts_the_measurement_again() {
    let mut detector = Detector::new(None);
    let times = stamps(VLP16_NS, &[0, 1]);
    assert_eq!(
        detector.observe(&packet(times[0], (SINGLE, 0x22), false)),
        None
    );
    assert_eq!(
        detector.observe(&packet(times[1], (SINGLE, 0x22), false)),
        None
    );
    let dual = stamps(VLP16_NS / 2, &[40, 41, 42]);
    let verdict = dual
        .into_iter()
        .find_map(|stamp| detector.observe(&packet(stamp, (DUAL, 0x22), true)));
    assert_eq!(
        verdict,
        Some(found(Model::Vlp16, ReturnMode::Dual, Basis::BytesAndPeriod))
    );
}

#[test]
fn no_interval_fits_two_timings() {
    let periods = |banks, mode| {
        let timings = timings(banks).iter();
        timings.map(move |(_, spec)| spec.packet_period_ns(mode))
    };
    for mode in [ReturnMode::Strongest, ReturnMode::Dual] {
        let [vlp16, hdl32e, vlp32c] = periods(Banks::One, mode).collect::<Vec<_>>()[..] else {
            panic!("three timings");
        };
        // Two of a VLP-32C take as long as one of a VLP-16: the turn of the head decides.
        for other in [vlp16, vlp32c] {
            assert!((0..10_000).all(|us| !(fits(us, other) && fits(us, hdl32e))));
        }
    }
    let [fast, slow] = periods(Banks::Alternating, ReturnMode::Strongest).collect::<Vec<_>>()[..]
    else {
        panic!("two timings");
    };
    assert!((0..10_000).all(|us| !(fits(us, fast) && fits(us, slow))));
}

/// A packet of two heads that turn, with status bytes that would name a VLP-16 in dual mode.
fn two_heads(stamp_us: u32, blocks_per_azimuth: usize) -> DataPacket {
    let mut packet = DataPacket::new(stamp_us, DUAL, 0x22);
    for (index, block) in packet.blocks.iter_mut().enumerate() {
        block.flag.set(if index % 2 == 1 {
            FLAG_BANK_1
        } else {
            crate::wire::data::FLAG_BANK_0
        });
        block.set_azimuth_cdeg(100 + 17 * (index / blocks_per_azimuth) as u16);
    }
    packet
}

#[test]
fn an_hdl64e_is_detected_by_its_heads_and_its_timing_by_the_period() {
    use ReturnMode::{Dual, Strongest};
    let run = |forced, period_ns, group, packets: &[u64]| {
        let mut detector = Detector::new(forced);
        let packets = stamps(period_ns, packets)
            .into_iter()
            .map(|stamp| two_heads(stamp, group));
        packets
            .into_iter()
            .find_map(|p| detector.observe(&p))
            .unwrap_or_else(|| detector.conclude())
    };
    let slow = Model::Hdl64eS3.specs()[1];
    for (period_ns, group, mode, model, spec) in [
        (
            288_000,
            2,
            Strongest,
            Model::Hdl64eS2,
            Model::Hdl64eS2.spec(),
        ),
        (345_600, 2, Strongest, Model::Hdl64eS3, slow),
        (172_800, 4, Dual, Model::Hdl64eS3, Model::Hdl64eS2.spec()),
    ] {
        for order in [&[0, 1, 2][..], &[0, 2, 5], &[1, 0, 2], &[0, 0, 3, 4]] {
            let found = run(None, period_ns, group, order).unwrap();
            assert_eq!(
                (found.model, found.return_mode, found.basis),
                (model, mode, Basis::HeadsAndPeriod)
            );
            assert_eq!(
                found.spec.packet_period_ns(mode),
                spec.packet_period_ns(mode),
                "{period_ns} {order:?}"
            );
        }
        let s3 = run(Some(Model::Hdl64eS3), period_ns, group, &[0, 1, 2]).unwrap();
        assert_eq!(
            (s3.model, s3.return_mode, s3.basis),
            (Model::Hdl64eS3, mode, Basis::Given)
        );
    }
    assert_eq!(
        run(None, 288_000, 2, &[0]).unwrap().basis,
        Basis::HeadsAlone
    );
    let message = |forced, period_ns, group| {
        run(Some(forced), period_ns, group, &[0, 1, 2])
            .unwrap_err()
            .to_string()
    };
    assert_eq!(
        message(Model::Hdl64eS2, 172_800, 4),
        "the given model is HDL-64E S2, but packets come 173 us apart, as those of the HDL-64E S3 do"
    );
    assert_eq!(
        message(Model::Vlp16, 288_000, 2),
        "the given model is VLP-16, but the blocks of its packets alternate between two heads, as those of the HDL-64E do"
    );
    let (_, one_head) = self::run(
        Some(Model::Hdl64eS2),
        (SINGLE, 0x22),
        false,
        &stamps(VLP16_NS, &[0, 1, 2]),
    );
    assert!(
        matches!(
            one_head,
            Err(DetectError::Layout {
                banks: Banks::One,
                ..
            })
        ),
        "{one_head:?}"
    );
}

/// A head that starts to turn: azimuths may be equal in pairs by chance.
#[test]
fn an_hdl64e_that_hardly_turns_is_detected_by_its_period() {
    use ReturnMode::{Dual, Strongest};
    for (period_ns, mode, packet_ns) in [
        (288_000, Strongest, 288_000),
        (345_600, Strongest, 345_600),
        (172_800, Dual, 288_000),
    ] {
        let firings = if mode == Dual { 3 } else { 6 };
        for (rpm, start) in [0.0, 0.3, 1.0, 3.0, 10.0]
            .into_iter()
            .flat_map(|rpm| (0..50).map(move |s| (rpm, s)))
        {
            let mut detector = Detector::new(None);
            let sent = (0..12).map(|n: u64| {
                let mut packet = two_heads((n * period_ns / 1000) as u32, 12);
                for (index, block) in packet.blocks.iter_mut().enumerate() {
                    let firing = (index * firings / BLOCKS) as f64 / firings as f64;
                    let seconds = (n as f64 + firing) * period_ns as f64 * 1e-9;
                    block.set_azimuth_cdeg(
                        (f64::from(start) * 0.37 + rpm * 600.0 * seconds).round() as u16,
                    );
                }
                packet
            });
            let found = sent
                .into_iter()
                .find_map(|p| detector.observe(&p))
                .unwrap()
                .unwrap();
            let single_ns = found.spec.packet_period_ns(Strongest);
            assert_eq!(
                (found.return_mode, single_ns),
                (mode, packet_ns),
                "{period_ns} {rpm} {start}"
            );
        }
    }
}

#[test]
fn an_hdl64e_says_its_return_mode_by_azimuths_that_differ() {
    use ReturnMode::{Dual, Strongest};
    let detection = found(Model::Hdl64eS3, Strongest, Basis::HeadsAndPeriod).unwrap();
    for last in [Strongest, Dual] {
        for (blocks, expected) in [(2, Strongest), (4, Dual), (12, last)] {
            let packet = two_heads(0, blocks);
            let mode = detection.mode_of(&packet, packet.banks(), last);
            assert_eq!(mode, expected);
        }
    }
}

proptest! {
    #[test]
    fn any_stream_ends_in_a_verdict(
        packets in proptest::collection::vec((any::<u32>(), any::<u8>(), any::<u8>(), any::<bool>()), MAX_PACKETS),
        forced in 0..=Model::ALL.len(),
    ) {
        let mut detector = Detector::new(Model::ALL.get(forced).copied());
        let _ = detector.conclude();
        let verdict = packets.into_iter().find_map(|(stamp, mode, product, paired)| {
            let _ = detector.conclude();
            detector.observe(&packet(stamp, (mode, product), paired))
        });
        prop_assert!(verdict.is_some());
    }
}

#[test]
fn a_factory_byte_of_other_beams_contradicts_the_given_model() {
    for (given, byte, is_other) in [
        (Model::Vlp16, 0x22, false),
        (Model::Vlp16, 0, false),
        // Early firmware.
        (Model::Vlp16, 0x21, false),
        (Model::Vlp16, 0x24, true),
        (Model::PuckHiRes, 0x22, true),
        (Model::PuckHiRes, 0x24, false),
        (Model::Vlp32c, 0x24, true),
        (Model::Vls128, 0x63, false),
        // Where others have it, an HDL-64E has its status.
        (Model::Hdl64eS3, 0x24, false),
    ] {
        assert_eq!(has_other_beams(given, byte), is_other, "{given} {byte:#x}");
    }
}
