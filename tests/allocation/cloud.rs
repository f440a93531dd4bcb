//! After the first clouds, projecting one and labelling its points allocates nothing.

use std::f64::consts::TAU;

use sweepd_lab::cloud::{Cloud, CloudProjector, RowTable};
use sweepd_testkit::counting::of_this_thread;

const FIRINGS: usize = 720;

/// Rings on a cone each, with points that crowd.
fn cloud() -> Cloud {
    let mut cloud = Cloud {
        points: Vec::new(),
        rings: Some(Vec::new()),
    };
    for ring in 0..16 {
        let elevation = (8.0 - f64::from(ring)).to_radians();
        for firing in 0..FIRINGS {
            let azimuth =
                (firing as f64 + if firing % 12 == 0 { 0.9 } else { 0.0 }) / FIRINGS as f64 * TAU;
            let away = 5.0 + (firing % 97) as f64 * 0.3;
            let point = [
                away * azimuth.cos(),
                -away * azimuth.sin(),
                away * elevation.tan(),
                0.0,
            ];
            cloud.points.push(point.map(|value| value as f32));
            cloud.rings.as_mut().unwrap().push(ring);
        }
    }
    cloud
}

pub fn projecting_allocates_nothing() {
    let by_number = cloud();
    let in_order = Cloud {
        rings: None,
        ..by_number.clone()
    };
    let table = RowTable::parse(
        &(0..16)
            .map(|row| format!("{}\n", 8 - row))
            .collect::<String>(),
    )
    .unwrap();
    for (cloud, table) in [
        (&in_order, None),
        (&by_number, None),
        (&in_order, Some(&table)),
    ] {
        let mut projector = CloudProjector::new(FIRINGS).unwrap();
        let mut run = || {
            let before = of_this_thread();
            assert_eq!(
                projector.project_cloud(cloud, table).unwrap().beams.len(),
                16
            );
            assert_eq!(projector.labels().unwrap().len(), cloud.points.len());
            of_this_thread() - before
        };
        let counts = [run(), run(), run(), run()];
        assert!(counts[0] > 0 && counts[2..] == [0, 0], "{counts:?}");
    }
}
