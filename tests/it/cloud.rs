//! Clouds from files, with and without rings, against the sweeps that they came from.

use std::collections::HashMap;
use std::fmt::Write;
use std::path::Path;

use sweepd::export::write_pcd;
use sweepd::pipeline;
use sweepd::segment::Config;
use sweepd::sensor::{Model, ModelExt};
use sweepd::sweep::Frame;
use sweepd::sweep::SweepRef;
use sweepd::sweep::layout::{LABEL_GROUND, LABEL_NONE};
use sweepd_lab::cloud::{COLUMNS, Cloud, CloudProjector, CloudSegmenter, Format, RowTable};
use sweepd_testkit::run::Runner;

/// Firings of a VLP-16 in the turn of a fixture, 10 turns a second.
const VLP16_COLUMNS: usize = 1808;

/// A whole turn of the simulated street: as a PCD of our own, and the labels of its points.
fn street() -> (Vec<u8>, Vec<u32>) {
    let mut runner = Runner::new(pipeline::Config::default());
    runner
        .play(Path::new("pcap_fixtures/street_vlp16.pcap.gz"))
        .unwrap();
    let sweep = SweepRef::open(runner.sweeps[2].as_ref()).unwrap();
    let mut file = Vec::new();
    write_pcd(sweep, Frame::Ros, &mut file).unwrap();
    let points = sweep.points_by_time(Frame::Ros);
    (file, points.map(|found| found.label).collect())
}

fn vlp16() -> RowTable {
    RowTable::of_calibration(Model::Vlp16.calibration().unwrap())
}

fn segmenter(columns: usize) -> CloudSegmenter {
    CloudSegmenter::new(Config::default(), columns).unwrap()
}

/// Share of points on which two labellings agree: as to ground, and as to which label is which,
/// each taken for the one that shares most points with it.
fn agreement(a: &[u32], b: &[u32]) -> [f64; 2] {
    assert_eq!(a.len(), b.len());
    let share = |same: usize| same as f64 / a.len() as f64;
    let ground = a
        .iter()
        .zip(b)
        .filter(|(a, b)| (**a == LABEL_GROUND) == (**b == LABEL_GROUND))
        .count();
    let mut shared: HashMap<(u32, u32), usize> = HashMap::new();
    a.iter()
        .zip(b)
        .for_each(|(&a, &b)| *shared.entry((a, b)).or_default() += 1);
    let best_of = |from_a: bool| -> usize {
        let mut best: HashMap<u32, usize> = HashMap::new();
        for (&(a, b), &count) in &shared {
            let most = best.entry(if from_a { a } else { b }).or_default();
            *most = count.max(*most);
        }
        best.values().sum()
    };
    [share(ground), share(best_of(true).min(best_of(false)))]
}

fn check_agreement(what: &str, a: &[u32], b: &[u32], least: f64) {
    let [ground, segments] = agreement(a, b);
    println!(
        "{what}: ground {:.3} %, segments {:.3} %",
        100.0 * ground,
        100.0 * segments
    );
    assert!(
        ground >= least && segments >= least,
        "{what}: {ground} {segments}"
    );
    assert!(
        a.contains(&LABEL_GROUND) && a.iter().max() > Some(&4),
        "{what}: too little to compare"
    );
}

/// An order of this many points, drawn from a seed.
fn shuffled(count: usize) -> Vec<usize> {
    let mut order: Vec<usize> = (0..count).collect();
    fastrand::Rng::with_seed(7).shuffle(&mut order);
    order
}

fn ordered<T: Copy>(values: &[T], order: &[usize]) -> Vec<T> {
    order.iter().map(|&at| values[at]).collect()
}

#[test]
fn labels_of_an_exported_cloud_are_those_of_its_sweep() {
    let (file, of_sweep) = street();
    let cloud = Cloud::read(&file, Format::Pcd).unwrap();
    let by_ring = segmenter(VLP16_COLUMNS)
        .segment_cloud(&cloud)
        .unwrap()
        .to_vec();
    check_agreement("by ring", &of_sweep, &by_ring, 0.97);
    let mut by_beam = segmenter(VLP16_COLUMNS).with_rows(vlp16());
    check_agreement(
        "by beam",
        &of_sweep,
        by_beam.segment_cloud(&cloud).unwrap(),
        0.97,
    );
    // Shuffled, with the ring of each point and without.
    let order = shuffled(cloud.points.len());
    let rings = cloud.rings.as_deref().map(|rings| ordered(rings, &order));
    let mixed = Cloud {
        points: ordered(&cloud.points, &order),
        rings,
    };
    let expected = ordered(&by_ring, &order);
    let in_order = by_beam.segment_cloud(&cloud).unwrap().to_vec();
    check_agreement(
        "mixed, by ring",
        &expected,
        segmenter(VLP16_COLUMNS).segment_cloud(&mixed).unwrap(),
        0.99,
    );
    let bare = Cloud {
        rings: None,
        ..mixed
    };
    check_agreement(
        "mixed, by beam",
        &ordered(&in_order, &order),
        by_beam.segment_cloud(&bare).unwrap(),
        0.99,
    );
    assert!(
        segmenter(VLP16_COLUMNS)
            .segment_cloud(&bare)
            .unwrap_err()
            .to_string()
            .contains("in order, ring after ring")
    );
}

/// Real scans in the order of their rings, and shuffled with the beams that were fitted to them.
#[test]
#[cfg_attr(without_captures, ignore = "no captures")]
fn a_shuffled_scan_has_the_labels_of_the_scan_in_order() {
    let data = sweepd_testkit::data_dir();
    for scan in ["00/000000", "08/000009"] {
        let bytes = std::fs::read(data.join(format!("labelled/semantickitti/{scan}.bin"))).unwrap();
        let cloud = Cloud::read(&bytes, Format::Kitti).unwrap();
        let in_order = segmenter(COLUMNS).segment_cloud(&cloud).unwrap().to_vec();
        let mut projector = CloudProjector::new(COLUMNS).unwrap();
        let mut text = String::new();
        for beam in projector.project(&cloud.points).unwrap().beams.iter() {
            writeln!(
                text,
                "{} {} # fitted",
                beam.elevation_rad.to_degrees(),
                beam.vertical_offset_m
            )
            .unwrap();
        }
        let order = shuffled(cloud.points.len());
        let mixed = Cloud {
            points: ordered(&cloud.points, &order),
            rings: None,
        };
        let mut by_beam = segmenter(COLUMNS).with_rows(RowTable::parse(&text).unwrap());
        let labels = by_beam.segment_cloud(&mixed).unwrap();
        check_agreement(scan, &ordered(&in_order, &order), labels, 0.93);
    }
}

/// nuScenes: an HDL-32E with the ring of each point, whose rows are also told by the model.
#[test]
#[cfg_attr(without_captures, ignore = "no captures")]
fn a_scan_of_nuscenes_is_labelled_by_ring_and_by_model() {
    let data = sweepd_testkit::data_dir();
    let path = data.join("labelled/nuscenes/n015_1532402927647951.pcd.bin");
    assert_eq!(Format::of_name(&path), Some(Format::Nuscenes));
    let cloud = Cloud::read(&std::fs::read(path).unwrap(), Format::Nuscenes).unwrap();
    let mut rings = cloud.rings.clone().unwrap();
    rings.sort_unstable();
    rings.dedup();
    assert_eq!(rings, (0..32).collect::<Vec<_>>());
    let labels = segmenter(1084).segment_cloud(&cloud).unwrap().to_vec();
    let labelled = labels.iter().filter(|&&label| label != LABEL_NONE).count();
    assert!(
        labelled * 10 > labels.len() * 7,
        "{labelled} of {}",
        labels.len()
    );
    let table = RowTable::of_calibration(Model::Hdl32e.calibration().unwrap());
    check_agreement(
        "nuscenes",
        &labels,
        segmenter(1084)
            .with_rows(table)
            .segment_cloud(&cloud)
            .unwrap(),
        0.9,
    );
}

/// The same points in every way to write them.
#[test]
fn every_form_of_a_file_holds_the_same_cloud() {
    let (file, _) = street();
    let cloud = Cloud::read(&file, Format::Pcd).unwrap();
    let rings = cloud.rings.clone().unwrap();
    for (name, file, format) in forms(&cloud) {
        let read = Cloud::read(&file, format).unwrap_or_else(|error| panic!("{name}: {error}"));
        assert!(read.rings.as_ref() == Some(&rings), "{name}: rings");
        let same = read
            .points
            .iter()
            .zip(&cloud.points)
            .all(|(a, b)| a[..3] == b[..3]);
        assert!(
            same && read.points.len() == cloud.points.len(),
            "{name}: points"
        );
    }
}

/// A file that is cut off anywhere is refused, with the place; none makes us panic.
#[test]
fn a_file_that_is_cut_off_is_refused_with_the_place() {
    let points: Vec<[f32; 4]> = (0..9).map(|at| [at as f32 + 0.5, 1.0, -1.0, 3.0]).collect();
    let cloud = Cloud {
        points,
        rings: Some((0..9).collect()),
    };
    for (name, file, format) in forms(&cloud) {
        // Of the texts the last number may lose digits unseen.
        for end in 0..file.len() - 3 {
            let error = Cloud::read(&file[..end], format)
                .expect_err(&format!("{name} up to {end}"))
                .to_string();
            assert!(
                error.starts_with("line ") || error.starts_with("byte "),
                "{name} up to {end}: {error}"
            );
        }
        let mut rng = fastrand::Rng::with_seed(3);
        for _ in 0..2000 {
            let mut broken = file.clone();
            let at = rng.usize(..broken.len());
            broken[at] = rng.u8(..);
            // Another number, or an error: never a panic.
            let _ = Cloud::read(&broken, format);
        }
    }
}

#[test]
fn what_a_head_promises_is_held_against_the_file() {
    let pcd = |head: &str, data: &str| {
        let text = format!("VERSION 0.7\n{head}\nDATA {data}\n1 2 3\n");
        Cloud::read(text.as_bytes(), Format::Pcd)
            .unwrap_err()
            .to_string()
    };
    let three = "FIELDS x y z\nSIZE 4 4 4\nTYPE F F F";
    let cases = [
        (
            format!("{three}\nPOINTS 18446744073709551615"),
            "binary",
            "line 6",
            "too many",
        ),
        (
            format!("{three}\nPOINTS 1000000"),
            "binary",
            "byte 80",
            "need 12000000",
        ),
        (
            format!("{three}\nPOINTS 1000000"),
            "ascii",
            "line 8",
            "ends after 1 of 1000000 points",
        ),
        (
            format!("{three}\nPOINTS 0"),
            "ascii",
            "line 7",
            "more lines than the 0 points",
        ),
        (
            format!("{three}\nPOINTS 2\nWIDTH 3\nHEIGHT 1"),
            "ascii",
            "line 8",
            "WIDTH x HEIGHT is 3",
        ),
        (
            format!("{three}\nPOINTS x"),
            "ascii",
            "line 5",
            "\"x\" is no count",
        ),
        (
            format!("{three}\nCOUNT 1 1 2\nPOINTS 1"),
            "ascii",
            "line 2",
            "z has COUNT 2",
        ),
        (
            "FIELDS x y\nSIZE 4 4\nTYPE F F\nPOINTS 1".to_owned(),
            "ascii",
            "line 2",
            "no field z among \"x y\"",
        ),
        (
            "FIELDS x y z\nSIZE 4 4 2\nTYPE F F F\nPOINTS 1".to_owned(),
            "binary",
            "line 2",
            "TYPE F and SIZE 2",
        ),
        (
            format!("{three}\nPOINTS 1"),
            "base64",
            "line 6",
            "binary_compressed",
        ),
        (
            "FIELDS x y z\nSIZE 4 4\nTYPE F F F\nPOINTS 1".to_owned(),
            "ascii",
            "line 6",
            "SIZE has 2 values",
        ),
    ];
    for (head, data, place, message) in cases {
        let error = pcd(&head, data);
        assert!(
            error.starts_with(place) && error.contains(message),
            "{error}"
        );
    }
    let ply = |text: &str| {
        Cloud::read(text.as_bytes(), Format::Ply)
            .unwrap_err()
            .to_string()
    };
    let vertices =
        "element vertex 1\nproperty float x\nproperty float y\nproperty float z\nend_header\n";
    let cases = [
        ("solid\n".to_owned(), "line 1", "begins with a line \"ply\""),
        (format!("ply\n{vertices}"), "line 6", "no line \"format"),
        (
            format!("ply\nformat ascii 1.0\nelement face 1\n{vertices}"),
            "line 3",
            "face stands before the vertices",
        ),
        (
            format!("ply\nformat ascii 1.0\n{vertices}1 2 three\n"),
            "line 8",
            "\"three\" is no number",
        ),
        (
            format!("ply\nformat ascii 1.0\n{vertices}1 2\n"),
            "line 8",
            "2 numbers, expected 3",
        ),
        (
            format!("ply\nformat binary_big_endian 1.0\n{vertices}short"),
            "byte 117",
            "5 bytes follow the head",
        ),
    ];
    for (text, place, message) in cases {
        let error = ply(&text);
        assert!(
            error.starts_with(place) && error.contains(message),
            "{error}"
        );
    }
}

#[test]
fn a_table_of_rows_is_read_with_its_mistakes() {
    let table = RowTable::parse("# of a toy\n\n 10 \n-1.5 0.2 # lower\n").unwrap();
    let beams: Vec<[f64; 2]> = table
        .beams()
        .iter()
        .map(|beam| [beam.elevation_rad.to_degrees(), beam.vertical_offset_m])
        .collect();
    assert!(
        (beams[0][0] - 10.0).abs() < 1e-12
            && (beams[1][0] + 1.5).abs() < 1e-12
            && beams[1][1] == 0.2
    );
    let cases = [
        ("1\n2\n", "line 2: 2.000 degrees is not below the 1.000"),
        (
            "1\nup\n",
            "line 2: elevation \"up\" is no number from -90 to 90",
        ),
        (
            "1 9\n",
            "line 1: vertical offset \"9\" is no number from -5 to 5",
        ),
        ("1 0 3\n", "line 1: nothing is expected where \"3\" stands"),
        ("# none\n", "0 rows, expected 1 to 128"),
    ];
    for (text, message) in cases {
        let error = RowTable::parse(text).unwrap_err().to_string();
        assert!(error.starts_with(message), "{error}");
    }
}

/// A cloud with rings as PCD and PLY of all kinds: fields in another order, of other types, among
/// foreign ones.
fn forms(cloud: &Cloud) -> Vec<(&'static str, Vec<u8>, Format)> {
    let rings = cloud.rings.as_deref().unwrap();
    let count = cloud.points.len();
    let rows = || cloud.points.iter().zip(rings);
    let pcd = |data: &str| {
        format!(
            "# .PCD v0.7\r\nVERSION 0.7\nFIELDS ring z _ y x\nSIZE 1 8 2 4 4\nTYPE U F I F F\nCOUNT 1 1 3 1 1\nWIDTH \
             {count}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS {count}\nDATA {data}\n"
        )
    };
    let ply = |format: &str| {
        format!(
            "ply\nformat {format} 1.0\ncomment a street\nelement vertex {count}\nproperty double y\nproperty float32 z\n\
             property int8 foreign\nproperty ushort ring\nproperty float x\nelement face 0\nproperty list uchar int \
             vertex_indices\nend_header\n"
        )
    };
    let mut pcd_text = pcd("ascii");
    let mut ply_text = ply("ascii");
    let (mut pcd_binary, mut little, mut big) = (
        pcd("binary").into_bytes(),
        ply("binary_little_endian").into_bytes(),
        ply("binary_big_endian").into_bytes(),
    );
    let mut fields: [Vec<u8>; 5] = Default::default();
    for (&[x, y, z, _], &ring) in rows() {
        writeln!(pcd_text, "{ring} {z} 1 -2 3 {y} {x}").unwrap();
        writeln!(ply_text, "{y} {z} 7 {ring} {x}").unwrap();
        let one = [
            vec![ring as u8],
            f64::from(z).to_le_bytes().to_vec(),
            vec![1, 0, 2, 0, 3, 0],
            y.to_le_bytes().to_vec(),
            x.to_le_bytes().to_vec(),
        ];
        pcd_binary.extend(one.iter().flatten());
        fields
            .iter_mut()
            .zip(one)
            .for_each(|(field, one)| field.extend(one));
        for (file, is_big) in [(&mut little, false), (&mut big, true)] {
            let words = [
                f64::from(y).to_le_bytes().to_vec(),
                z.to_le_bytes().to_vec(),
                vec![7],
            ];
            let words = words.into_iter().chain([
                (ring as u16).to_le_bytes().to_vec(),
                x.to_le_bytes().to_vec(),
            ]);
            for mut word in words {
                if is_big {
                    word.reverse();
                }
                file.extend(word);
            }
        }
    }
    let unpacked = fields.concat();
    let packed = pack(&unpacked);
    let mut compressed = pcd("binary_compressed").into_bytes();
    compressed.extend((packed.len() as u32).to_le_bytes());
    compressed.extend((unpacked.len() as u32).to_le_bytes());
    compressed.extend(packed);
    vec![
        ("ascii PCD", pcd_text.into_bytes(), Format::Pcd),
        ("binary PCD", pcd_binary, Format::Pcd),
        ("compressed PCD", compressed, Format::Pcd),
        ("ascii PLY", ply_text.into_bytes(), Format::Ply),
        ("little-endian PLY", little, Format::Ply),
        ("big-endian PLY", big, Format::Ply),
    ]
}

/// LZF as simple as can be: a byte that goes on is repeated, all others stand as they are.
fn pack(bytes: &[u8]) -> Vec<u8> {
    let mut packed = Vec::new();
    let mut at = 0;
    while at < bytes.len() {
        packed.extend([0, bytes[at]]);
        let same = bytes[at + 1..]
            .iter()
            .take(264)
            .take_while(|&&byte| byte == bytes[at])
            .count();
        at += 1;
        if same >= 9 {
            packed.extend([7 << 5, (same - 9) as u8, 0]);
            at += same;
        } else if same >= 3 {
            packed.extend([((same - 2) as u8) << 5, 0]);
            at += same;
        }
    }
    packed
}
