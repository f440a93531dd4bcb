//! Files of points, and of labels for them.

use sweepd::segment::Config;
use sweepd_lab::cloud::{Cloud, CloudSegmenter, Format, RowTable};
use sweepd_lab::score::{Baseline, ScanScore, Truth};

use super::Numbers;

/// Points that are segmented, at most: the time of the others is that of reading them.
const MOST_POINTS: usize = 4000;

/// A file of points, behind a byte: its format, whether the rows come from a table, how many
/// columns.
pub fn cloud(input: &[u8]) {
    let mut numbers = Numbers(input);
    let how = numbers.u8();
    let format = [Format::Kitti, Format::Nuscenes, Format::Pcd, Format::Ply][usize::from(how & 3)];
    let mut cloud = match Cloud::read(numbers.0, format) {
        Ok(cloud) => cloud,
        Err(error) => return assert!(!error.to_string().is_empty()),
    };
    assert!(
        cloud
            .rings
            .as_ref()
            .is_none_or(|rings| rings.len() == cloud.points.len())
    );
    cloud.points.truncate(MOST_POINTS);
    cloud
        .rings
        .iter_mut()
        .for_each(|rings| rings.truncate(MOST_POINTS));
    let columns = 1 + usize::from(how >> 3) * 16;
    let mut segmenter =
        CloudSegmenter::new(Config::default(), columns).expect("these columns have room");
    if how & 4 != 0 {
        segmenter = segmenter
            .with_rows(RowTable::parse("10\n2.5\n0 0.1\n-3\n-20").expect("a table of five rows"));
    }
    match segmenter.segment_cloud(&cloud) {
        Ok(labels) => assert_eq!(labels.len(), cloud.points.len()),
        Err(error) => assert!(!error.to_string().is_empty()),
    }
}

/// Points with a true label and another one each, scored.
pub fn labels(input: &[u8]) {
    let mut numbers = Numbers(input);
    let (mut points, mut truth, mut labels) = (Vec::new(), Vec::new(), Vec::new());
    while !numbers.is_empty() && points.len() < MOST_POINTS {
        points.push([(); 4].map(|()| f32::from_bits(numbers.u32())));
        truth.push(numbers.u32());
        labels.push(numbers.u32());
    }
    assert!(Truth::new(&points, vec![0; points.len() + 1]).is_err());
    let truth = Truth::new(&points, truth).expect("a label a point");
    for baseline in [
        Baseline::Euclidean { distance_m: 0.5 },
        Baseline::Grid { cell_m: 0.2 },
    ] {
        assert_eq!(baseline.segment(&points, &labels, 3).len(), points.len());
    }
    let score = ScanScore::new(&truth, &labels, &[1, 20]).expect("a label a point");
    for figure in score.figures() {
        assert!(
            figure.value.is_none_or(f64::is_finite),
            "{} {}",
            figure.group.key(),
            figure.name
        );
    }
}
