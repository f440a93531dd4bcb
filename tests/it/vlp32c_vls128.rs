//! Real captures of a VLP-32C and of a VLS-128, against counts, sums and points that were worked
//! out by hand and by a decoder of other code.

use std::ops::RangeInclusive;
use sweepd::sensor::{Model, ModelExt};
use sweepd::sweep::layout::flags::LOSS_ESTIMATED;
use sweepd::wire::data::ReturnMode;
use sweepd_lab::simulate::gps::Clock;
use sweepd_lab::simulate::{
    ClockStep, Emitter, EmitterConfig, Faults, FieldOfView, SimulatedDatagram, deliver, fixtures,
};
use sweepd_testkit::{
    raw,
    run::{Placed, Run},
    same::same,
};

const VLP32C: &str = "vlp32c_nebula-fov180-a";
const VLS128: &str = "vls128_nebula-a";

/// A revolution, which ends where azimuths drop by more than half a turn: firings, returns, sum of
/// raw distances, sum of reflectivities.
type Revolution = [u64; 4];

/// A point of the second revolution: its number there, where it stood on the wire, its row, and
/// what the sensor said.
struct Point {
    number: usize,
    place: (u64, u8, usize),
    row: usize,
    raw: f64,
    azimuth_deg: f64,
    point_m: [f64; 3],
}

const fn point(
    number: usize,
    place: (u64, u8, usize),
    row: usize,
    raw: f64,
    azimuth_deg: f64,
    point_m: [f64; 3],
) -> Point {
    Point {
        number,
        place,
        row,
        raw,
        azimuth_deg,
        point_m,
    }
}

fn run(name: &str) -> Run {
    Run::of_capture(&sweepd_testkit::data_dir().join(format!("pcap/{name}.pcap")))
}

/// The returns in the order of the wire, with the number of their revolution.
fn in_order(
    name: &str,
    run: &Run,
    blocks_of_firing: usize,
) -> (Vec<Revolution>, Vec<(usize, Placed)>) {
    let packets = raw::packets(&sweepd_testkit::data_dir().join(format!("pcap/{name}.pcap")));
    let mut revolutions = vec![Revolution::default()];
    let mut of_firing = Vec::new();
    let mut before = 0;
    for packet in &packets {
        for block in (0..raw::BLOCKS).step_by(blocks_of_firing) {
            let azimuth = packet.azimuth_cdeg(block) % 36_000;
            if before > azimuth + 18_000 {
                revolutions.push(Revolution::default());
            }
            before = azimuth;
            revolutions.last_mut().unwrap()[0] += 1;
            of_firing.push(revolutions.len() - 1);
        }
    }
    let firings = raw::BLOCKS / blocks_of_firing;
    let mut returns: Vec<_> = run
        .returns()
        .into_iter()
        .map(|placed| {
            let firing = placed.found.block as usize / blocks_of_firing;
            let index = placed.found.packet as usize * firings + firing;
            (of_firing[index], placed)
        })
        .collect();
    returns.sort_by_key(|(_, placed)| {
        (
            placed.found.packet,
            placed.found.block,
            placed.found.channel,
        )
    });
    for (index, placed) in &returns {
        let found = &placed.found;
        let raw = (f64::from(found.range_m) / 0.004).round() as u64;
        let sums = revolutions[*index][1..].iter_mut();
        for (sum, one) in sums.zip([1, raw, found.reflectivity.into()]) {
            *sum += one;
        }
    }
    // Every return of the wire is in one pixel: none twice.
    for pair in returns.windows(2) {
        let place = |placed: &Placed| {
            (
                placed.found.packet,
                placed.found.block,
                placed.found.channel,
            )
        };
        assert!(place(&pair[0].1) < place(&pair[1].1));
    }
    (revolutions, returns)
}

fn check(
    name: &str,
    blocks_of_firing: usize,
    expected: [Revolution; 3],
    rows: &[(usize, &[usize])],
    points: &[Point],
) {
    let run = run(name);
    let counts = run.counts;
    assert_eq!(
        (counts.lost, counts.malformed, counts.foreign, counts.late),
        (0, 0, 0, 0),
        "{name}"
    );
    assert_eq!(run.detection.return_mode, ReturnMode::Strongest);
    let (revolutions, returns) = in_order(name, &run, blocks_of_firing);
    assert_eq!(revolutions, expected, "{name}");
    let second: Vec<_> = returns
        .iter()
        .filter(|(index, _)| *index == 1)
        .map(|(_, placed)| &placed.found)
        .collect();
    for &(first, of_rows) in rows {
        for (row, &expected) in (first..).zip(of_rows) {
            let found = second.iter().filter(|one| one.row == row).count();
            assert_eq!(found, expected, "{name}, row {row}");
        }
    }
    for expected in points {
        let found = second[expected.number];
        let place = (found.packet, found.block, found.channel % 32);
        assert_eq!((place, found.row), (expected.place, expected.row), "{name}");
        let range_m = expected.raw * 0.004;
        assert!(
            (f64::from(found.range_m) - range_m).abs() < 1e-4,
            "{found:?}"
        );
        let off_deg = found.azimuth_rad.to_degrees() - expected.azimuth_deg;
        assert!(
            off_deg.abs() < 0.01,
            "{name}: {off_deg} degrees off: {found:?}"
        );
        for axis in 0..3 {
            let slack_m = if axis == 2 {
                0.001
            } else {
                2e-4 * range_m + 0.0005
            };
            let off_m = found.point_m[axis] - expected.point_m[axis];
            // The numbers are rounded to centimetres far out.
            let rounded_m = if range_m > 100.0 { 0.005 } else { 0.0005 };
            assert!(
                off_m.abs() < slack_m + rounded_m,
                "{name}: {off_m} m: {found:?}"
            );
        }
    }
}

#[test]
#[cfg_attr(without_captures, ignore = "no captures")]
fn a_real_vlp32c_is_decoded_to_known_counts_sums_and_points() {
    let rows = [
        864, 856, 841, 839, 815, 801, 809, 795, 790, 772, 799, 784, 759, 768, 789, 778, 780, 746,
        800, 773, 794, 816, 835, 811, 831, 834, 845, 873, 900, 909, 909, 909,
    ];
    check(
        VLP32C,
        1,
        [
            [451, 13_974, 17_654_666, 675_094],
            [909, 26_224, 30_501_433, 1_204_427],
            [464, 12_463, 13_013_947, 540_460],
        ],
        &[(0, &rows)],
        &[
            point(0, (37, 7, 0), 31, 187.0, 1.510, [0.018, 0.678, -0.296]),
            point(1, (37, 7, 3), 30, 279.0, 358.718, [-0.024, 1.074, -0.289]),
            point(6556, (57, 8, 29), 0, 2213.0, 46.796, [6.233, 5.854, 2.280]),
            point(
                13_112,
                (77, 11, 25),
                2,
                678.0,
                274.239,
                [-2.684, 0.199, 0.325],
            ),
            point(
                26_223,
                (113, 3, 31),
                15,
                2104.0,
                358.603,
                [-0.205, 8.411, -0.195],
            ),
        ],
    );
}

#[test]
#[cfg_attr(without_captures, ignore = "no captures")]
fn a_real_vls128_is_decoded_to_known_counts_sums_and_points() {
    let top = [1042, 940, 1220, 1290, 1375, 1430, 1425, 1455];
    // The laser of row 105 is dead.
    let bottom = [
        1799, 1805, 1803, 1802, 1804, 0, 1803, 1801, 1799, 1801, 1719, 1727, 1796, 1773, 1783,
        1798, 1777, 1787, 1756, 1798, 1797, 1796, 1791, 1795, 1726, 1739, 1723, 1663,
    ];
    check(
        VLS128,
        4,
        [
            [1147, 135_541, 926_972_101, 2_587_358],
            [1810, 210_030, 1_785_730_932, 3_649_063],
            [1, 123, 523_417, 3_217],
        ],
        &[(0, &top), (100, &bottom)],
        &[
            point(0, (382, 4, 0), 123, 2202.0, 6.414, [0.963, 8.570, -1.780]),
            point(1, (382, 4, 1), 74, 3904.0, 4.608, [1.254, 15.556, -0.540]),
            point(
                52_507,
                (532, 3, 8),
                35,
                36_253.0,
                95.836,
                [144.14, -14.73, 5.817],
            ),
            point(
                105_015,
                (699, 5, 31),
                68,
                7705.0,
                182.943,
                [-1.582, -30.771, -0.714],
            ),
            point(
                210_029,
                (985, 7, 31),
                52,
                3360.0,
                353.790,
                [-1.454, 13.361, 0.100],
            ),
        ],
    );
}

/// A pole 13.3 m away, in 87 rows: in the image that consumers get, its middle stays about a
/// straight line, though its rows are fired up to 64 columns apart.
#[test]
#[cfg_attr(without_captures, ignore = "no captures")]
fn a_pole_stands_in_the_image_of_a_vls128() {
    let run = run(VLS128);
    let returns: Vec<_> = (run.returns().into_iter())
        .filter(|placed| placed.sweep == 1)
        .collect();
    let mut middles = Vec::new();
    for row in 0..Model::Vls128.spec().channels {
        let columns: Vec<f64> = returns
            .iter()
            .map(|placed| &placed.found)
            .filter(|one| one.row == row && (13.0..13.6).contains(&one.range_m))
            .filter(|one| (one.azimuth_rad.to_degrees() - 287.6).abs() < 0.6)
            .map(|one| one.column as f64)
            .collect();
        if !columns.is_empty() {
            middles.push((
                row as f64,
                columns.iter().sum::<f64>() / columns.len() as f64,
            ));
        }
    }
    assert!(middles.len() >= 80, "{} rows", middles.len());
    let count = middles.len() as f64;
    let mean = |of: fn(&(f64, f64)) -> f64| middles.iter().map(of).sum::<f64>() / count;
    let (row, column) = (mean(|one| one.0), mean(|one| one.1));
    let slope = mean(|one| one.0 * one.1) - row * column;
    let slope = slope / (mean(|one| one.0 * one.0) - row * row);
    let off = middles
        .iter()
        .map(|(at, middle)| middle - column - slope * (at - row));
    let rms = (off.clone().map(|off| off * off).sum::<f64>() / count).sqrt();
    let worst = off.map(f64::abs).fold(0.0, f64::max);
    println!("{count} rows, {rms:.2} columns rms, {worst:.2} at most");
    assert!(rms < 0.5 && worst < 1.5, "{rms} rms, {worst} at most");
}

#[test]
fn confidence_is_passed_over() {
    let config = EmitterConfig::new(Model::Vls128, ReturnMode::Dual).turns(1.3);
    let mut sent: Vec<_> = Emitter::new(config, &fixtures::scene()).collect();
    let without = Run::of_datagrams(sent.iter().map(|one| one.datagram()));
    for data in sent.iter_mut().filter(|one| one.truth.is_some()) {
        raw::add_confidence(&mut data.payload);
    }
    let with = Run::of_datagrams(sent.iter().map(|one| one.datagram()));
    assert_eq!(with.detection.return_mode, ReturnMode::Dual);
    let [with, without] = [with, without].map(|run| run.views().iter().map(same).collect());
    let (with, without): (Vec<_>, Vec<_>) = (with, without);
    assert!(with.len() >= 2 && with == without);
}

/// A simulated VLS-128, which rests for a random time after each firing, and what a network lost.
fn vls128_that_lost(config: EmitterConfig, lost: &[RangeInclusive<u64>]) -> Run {
    let scene = fixtures::scene();
    let faults = Faults {
        lost: lost.to_vec(),
        ..Faults::default()
    };
    let sent: Vec<_> = deliver(Emitter::new(config, &scene).untold(), faults).collect();
    Run::of_datagrams(sent.iter().map(|one| one.datagram()))
}

#[test]
fn losses_are_counted_though_packets_have_no_steady_period() {
    for mode in [ReturnMode::Strongest, ReturnMode::Dual] {
        let config = EmitterConfig::new(Model::Vls128, mode).turns(2.3);
        let short = [
            90..=90,
            150..=152,
            300..=314,
            700..=700,
            702..=703,
            1200..=1215,
        ];
        let run = vls128_that_lost(config.clone(), &short);
        assert_eq!(run.counts.lost, 38, "{mode}");
        let is_flagged = |run: &Run| {
            run.views()
                .iter()
                .any(|view| view.header.has(LOSS_ESTIMATED))
        };
        assert!(!is_flagged(&run), "{mode}");
        // A third of a turn may as well be a sector that was left out.
        let third = 33_000_000 / u64::from(config.spec.packet_period_ns(mode));
        let run = vls128_that_lost(config, &[600..=599 + third]);
        assert_eq!(run.counts.lost, third, "{mode}");
        assert!(is_flagged(&run), "{mode}");
    }
}

/// The silence of the first turn may be loss, and is flagged; when it comes again it is none.
#[test]
fn a_sector_that_is_left_out_is_no_loss_from_the_second_turn_on() {
    for mode in [ReturnMode::Strongest, ReturnMode::Dual] {
        let mut config = EmitterConfig::new(Model::Vls128, mode).turns(6.3);
        config.fov = Some(FieldOfView {
            from_deg: 90.0,
            to_deg: 270.0,
            set_ns: [0, i64::MAX],
        });
        let run = vls128_that_lost(config, &[]);
        let views = run.views();
        assert!(views.len() >= 6, "{mode}: {}", views.len());
        for (number, view) in views.iter().enumerate() {
            let lost = view.header.lost_packets;
            // A sweep may hold either end of the silence.
            assert!(
                lost == 0 || number < 2,
                "{mode}, sweep {number}: {lost} lost"
            );
            assert_eq!(
                lost > 0,
                view.header.has(LOSS_ESTIMATED),
                "{mode}, sweep {number}"
            );
        }
    }
}

/// A packet with two returns has one azimuth: how fast the head turns is known from those before,
/// also when the clock was set in between.
#[test]
fn a_clock_that_is_set_does_not_make_azimuths_of_a_vls128_noisy() {
    let scene = fixtures::scene();
    for at_ms in 40..44 {
        let mut config = EmitterConfig::new(Model::Vls128, ReturnMode::Dual).turns(0.75);
        config.optics.noise_m = 0.0;
        config.clock = Clock::Free {
            hour_ns: 1_000_000_000_000,
        };
        config.clock_step = Some(ClockStep {
            at_ns: at_ms * 1_000_000,
            by_ns: -400_000_000,
        });
        let noise_deg = config.encoder.jitter_deg;
        let sent: Vec<_> = Emitter::new(config, &scene).collect();
        let truth: Vec<_> = sent.iter().filter_map(|one| one.truth.as_ref()).collect();
        let run = Run::of_datagrams(sent.iter().map(SimulatedDatagram::datagram));
        let mut most_deg = 0.0_f64;
        run.each_return(|placed| {
            let found = &placed.found;
            let returns = &truth[found.packet as usize].returns;
            let truth = returns[usize::from(found.block)][placed.record].as_ref();
            let off_rad = found.azimuth_rad - truth.expect("it was sent").azimuth_rad;
            let off_deg = (off_rad.to_degrees() + 180.0).rem_euclid(360.0) - 180.0;
            most_deg = most_deg.max(off_deg.abs());
        });
        assert!(
            most_deg < noise_deg + 0.01,
            "set after {at_ms} ms: {most_deg} degrees off"
        );
    }
}
