//! The paper's method on real scans: the same at every SIMD level, and a table that says what its
//! pixels say.

use fearless_simd::Level;
use sweepd::buffers::{Buffers, HeapBuffers};
use sweepd::segment::{Config, Method, Segmenter};
use sweepd::sweep::layout::LABEL_FIRST_SEGMENT;
use sweepd::sweep::{Segment, Shape, SweepMut, SweepRef};
use sweepd_lab::cloud::{COLUMNS, CloudProjector, points};
use zerocopy::IntoBytes;

const SCANS: [&str; 2] = ["00/000000", "08/000009"];

/// Calls with real scans, as sweeps.
fn with_scans(look: impl Fn(&str, &mut SweepMut<'_>)) {
    let data = sweepd_testkit::data_dir();
    for scan in SCANS {
        let bytes = std::fs::read(data.join(format!("labelled/semantickitti/{scan}.bin"))).unwrap();
        let mut projector = CloudProjector::new(COLUMNS).unwrap();
        look(
            scan,
            &mut projector.project(&points(&bytes).unwrap()).unwrap(),
        );
    }
}

fn segment(sweep: &mut SweepMut<'_>, level: Level) {
    let config = Config {
        method: Method::Paper,
        ..Config::default()
    };
    Segmenter::with_level(config, level).unwrap().segment(sweep);
}

fn table<'a>(sweep: &SweepRef<'a>) -> &'a [Segment] {
    &sweep.segments[..sweep.header.segments as usize]
}

#[test]
#[cfg_attr(without_captures, ignore = "no captures")]
fn every_level_gives_the_same() {
    with_scans(|scan, sweep| {
        segment(sweep, Level::new());
        let (label, segments) = (
            sweep.label.to_vec(),
            table(&sweep.as_ref()).as_bytes().to_vec(),
        );
        segment(sweep, Level::baseline());
        assert!(label == sweep.label, "{scan}: labels");
        assert!(
            segments == table(&sweep.as_ref()).as_bytes(),
            "{scan}: segments"
        );
    });
}

#[test]
fn a_sweep_without_columns_has_no_labels() {
    let mut buffer = HeapBuffers::default().take(1 << 16);
    let shape = Shape {
        rows: 16,
        columns_capacity: 40,
        dual: true,
        segments_capacity: 1,
    };
    let mut sweep = SweepMut::create(buffer.as_mut(), &shape).unwrap();
    segment(&mut sweep, Level::new());
    assert_eq!((sweep.header.segments, sweep.header.ground), (0, 0));
}

#[test]
fn a_sweep_without_rows_has_no_labels() {
    let mut buffer = HeapBuffers::default().take(1 << 16);
    let shape = Shape {
        rows: 0,
        columns_capacity: 40,
        dual: false,
        segments_capacity: 1,
    };
    let mut sweep = SweepMut::create(buffer.as_mut(), &shape).unwrap();
    sweep.header.columns = 40;
    segment(&mut sweep, Level::new());
    assert_eq!((sweep.header.segments, sweep.header.ground), (0, 0));
}

#[test]
#[cfg_attr(without_captures, ignore = "no captures")]
fn the_table_is_what_the_pixels_say() {
    with_scans(|scan, sweep| {
        segment(sweep, Level::new());
        let sweep = sweep.as_ref();
        let segments = table(&sweep);
        assert!(segments.len() > 100, "{scan}: {} segments", segments.len());
        let mut pixels = vec![Vec::new(); segments.len()];
        for found in sweep
            .returns()
            .filter(|found| found.label >= LABEL_FIRST_SEGMENT)
        {
            pixels[(found.label - LABEL_FIRST_SEGMENT) as usize].push((
                found.row,
                found.range_m,
                found.point_m,
            ));
        }
        for (segment, pixels) in segments.iter().zip(&pixels) {
            let what = format!("{scan}: segment {}", segment.label);
            assert_eq!(segment.points as usize, pixels.len(), "{what}");
            let nearest_m = pixels
                .iter()
                .map(|pixel| pixel.1)
                .fold(f32::INFINITY, f32::min);
            assert_eq!(segment.nearest_m, nearest_m, "{what}");
            let rows = pixels.iter().map(|pixel| pixel.0 as u16);
            assert_eq!(
                [rows.clone().min(), rows.max()],
                [segment.row_first, segment.row_last].map(Some),
                "{what}"
            );
            for axis in 0..3 {
                let values = pixels.iter().map(|pixel| pixel.2[axis]);
                let least = values.clone().fold(f64::INFINITY, f64::min);
                let most = values.clone().fold(f64::NEG_INFINITY, f64::max);
                let mean = values.sum::<f64>() / pixels.len() as f64;
                let ours = [
                    segment.min_m[axis],
                    segment.max_m[axis],
                    segment.centroid_m[axis],
                ];
                for (ours, theirs) in ours.into_iter().zip([least, most, mean]) {
                    assert!(
                        (f64::from(ours) - theirs).abs() < 1e-4,
                        "{what} axis {axis}: {ours}, {theirs}"
                    );
                }
            }
        }
    });
}
