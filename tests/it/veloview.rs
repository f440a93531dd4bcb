//! Points that VeloView's own tests record for two captures (shared/data/README.md): where another
//! driver, by other people, puts the same bytes.

use sweepd_testkit::{
    raw::{self, BLOCKS, RECORDS, RawPacket},
    run::Run,
};

/// Where a return stands: packet, block, record.
type Place = (u64, usize, usize);

/// The pieces from azimuth wrap to azimuth wrap, as VeloView cuts them: before the first block
/// behind a wrap. In each the places of all non-zero returns, in the order of the wire.
fn pieces(packets: &[RawPacket]) -> Vec<Vec<Place>> {
    let mut pieces = vec![Vec::new()];
    let mut before = 0;
    for (number, packet) in (0..).zip(packets) {
        for block in 0..BLOCKS {
            let azimuth = packet.azimuth_cdeg(block);
            if azimuth + 18_000 < before {
                pieces.push(Vec::new());
            }
            before = azimuth;
            let seen = (0..RECORDS).filter(|&record| packet.record(block, record).0 != 0);
            pieces
                .last_mut()
                .unwrap()
                .extend(seen.map(|record| (number, block, record)));
        }
    }
    pieces
}

/// A point of a piece: its number among the non-zero returns, x, y, z in metres, intensity.
struct Point {
    piece: usize,
    number: usize,
    point_m: [f64; 3],
    intensity: u8,
}

const fn point(piece: usize, number: usize, point_m: [f64; 3], intensity: u8) -> Point {
    Point {
        piece,
        number,
        point_m,
        intensity,
    }
}

/// The recorded points lie where ours do: x and y within 1 mm and a hundredth of a degree, z within
/// 1 mm.
fn check(name: &str, totals: &[(usize, usize)], points: &[Point]) {
    let data = sweepd_testkit::data_dir();
    let capture = data.join(format!("pcap/{name}.pcap"));
    let pieces = pieces(&raw::packets(&capture));
    // That the totals are theirs proves that the numbers of the points mean the same here.
    for &(piece, total) in totals {
        assert_eq!(pieces[piece].len(), total, "{name}, piece {piece}");
    }
    let run = Run::of_capture(&capture);
    let (views, returns) = (run.views(), run.returns());
    for expected in points {
        let (packet, block, record) = pieces[expected.piece][expected.number];
        let mut here = returns.iter().filter(|placed| {
            (
                placed.found.packet,
                usize::from(placed.found.block),
                placed.record,
            ) == (packet, block, record)
        });
        let (Some(placed), None) = (here.next(), here.next()) else {
            panic!("{name}: not one return at {packet}")
        };
        let found = &placed.found;
        assert_eq!(found.reflectivity, expected.intensity);
        let across_m = 0.001 + 0.01_f64.to_radians() * f64::from(found.range_m);
        let off_m: Vec<f64> = found
            .point_m
            .iter()
            .zip(expected.point_m)
            .map(|(found, point)| found - point)
            .collect();
        // VeloView lets all beams start at the origin; here each has its height.
        let height_off_m =
            off_m[2] - f64::from(views[placed.sweep].beams[found.row].vertical_offset_m);
        let place = format!(
            "{name}, piece {}, point {}",
            expected.piece, expected.number
        );
        assert!(off_m[0].hypot(off_m[1]) < across_m, "{place}: {off_m:?}");
        assert!(height_off_m.abs() < 0.001, "{place}: {height_off_m}");
        println!(
            "{place}: x {:+.5}, y {:+.5}, z {height_off_m:+.5} m off",
            off_m[0], off_m[1]
        );
    }
}

#[test]
#[cfg_attr(without_captures, ignore = "no captures")]
fn hdl32e_points_are_where_veloview_puts_them() {
    let points = [
        point(8, 1, [0.021_879_3, 7.834_93, -1.287_24], 1),
        point(8, 4_000, [4.361_3, 8.192_06, -1.972_67], 28),
        point(8, 16_000, [77.564, -26.859, 3.827_85], 63),
        point(8, 49_733, [0.005_013_29, 5.744_81, -1.792_61], 1),
    ];
    check(
        "hdl32e_veloview-monterey-a",
        &[(0, 27_649), (2, 49_485), (8, 49_737)],
        &points,
    );
}

#[test]
#[cfg_attr(without_captures, ignore = "no captures")]
fn vlp16_points_are_where_veloview_puts_them() {
    let points = [
        point(16, 0, [0.080_127_2, 6.040_37, -1.618_65], 4),
        point(16, 13_859, [-0.009_435_4, 4.914_62, 1.316_87], 29),
    ];
    check(
        "vlp16_veloview-90deg-a",
        &[(0, 5_736), (2, 13_898), (16, 13_860)],
        &points,
    );
}
