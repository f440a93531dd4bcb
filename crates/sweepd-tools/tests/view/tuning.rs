//! A sweep that is segmented anew with the options of a page.

use std::path::Path;
use std::time::Duration;

use serde_json::{Value, json};
use sweepd::daemon::config::Config as DaemonConfig;
use sweepd::pipeline::Config;
use sweepd::segment::Method;
use sweepd::sweep::SweepRef;
use sweepd_testkit::PATIENCE;

use crate::captures::{calibrated, fixture, sweeps};
use crate::page::{Page, Shown, View};

fn tune(page: &mut Page, settings: Value) -> Shown {
    page.ask(json!({ "do": "tune", "method": "slope", "settings": settings }));
    let shown = page.sweep();
    assert!(shown.is_tuned());
    shown
}

/// The expected labels are those of a pipeline that was configured so from the start.
#[test]
fn a_tuned_sweep_is_that_of_a_sensor_configured_so() {
    let path = fixture("street_hdl32e.pcap.gz");
    let mut config = Config::default();
    config.segment.min_points = 3;
    config.segment.theta_rad = 20_f64.to_radians() as f32;
    let expected = sweeps(&path, &config);
    let view = View::start(&[&path]);
    let mut page = view.page();
    page.pause();
    let untuned = page.seek(1);
    let request = json!({ "theta_deg": 20, "min_points": 3 });
    let tuned = tune(&mut page, request.clone());
    assert_eq!(tuned.index(), 1);
    let expected_sweep = SweepRef::open(expected[1].as_ref()).unwrap();
    assert!(tuned.sweep().label == expected_sweep.label);
    assert_eq!(tuned.sweep().segments, expected_sweep.segments);
    assert!(tuned.sweep().label != untuned.sweep().label);
    // As it was, by its own numbers.
    let same = tune(&mut page, json!({ "theta_deg": 10, "min_points": 10 }));
    assert!(same.sweep().label == untuned.sweep().label);
    assert_eq!(same.sweep().segments, untuned.sweep().segments);

    // From now on each comes twice.
    tune(&mut page, request);
    page.ask(json!({ "do": "seek", "index": 0 }));
    let pair = [page.sweep(), page.sweep()];
    assert_eq!([0, 1].map(|one| pair[one].index()), [0, 0]);
    assert_eq!([0, 1].map(|one| pair[one].is_tuned()), [false, true]);
    assert_eq!(pair[0].about["paired"], true);
    let expected_sweep = SweepRef::open(expected[0].as_ref()).unwrap();
    assert!(pair[1].sweep().label == expected_sweep.label);
    page.drawn();
    page.ask(json!({ "do": "configuration" }));
    let lines = page.next("configuration");
    assert_eq!(
        lines["text"],
        "[sensor.segment]\ntheta_deg = 20\nmin_points = 3\n"
    );

    page.ask(json!({ "do": "tune", "settings": null }));
    page.ask(json!({ "do": "seek", "index": 1 }));
    assert!(!page.draw_until(|shown| shown.index() == 1).is_tuned());
    assert!(page.sweep_within(Duration::from_millis(500)).is_none());
}

/// What was estimated of an upright sensor says nothing of one that hangs head down.
#[test]
fn a_height_is_estimated_anew_where_the_sensor_is_tilted() {
    let path = fixture("street_vlp16.pcap.gz");
    let mut config = Config::default();
    config.segment.mount.pitch_rad = 5_f32.to_radians();
    let expected = sweeps(&path, &config);
    let expected_m = SweepRef::open(expected[0].as_ref())
        .unwrap()
        .header
        .height_m;
    let view = View::start(&[&path]);
    let mut page = view.page();
    page.pause();
    page.seek(0);
    let tuned = tune(&mut page, json!({ "pitch_deg": 5 }));
    let after_m = tuned.sweep().header.height_m;
    // The pipeline has seen one sweep more.
    assert!(
        (after_m - expected_m).abs() < 0.05,
        "{after_m} {expected_m}"
    );
    // Head down, no street is below it.
    let turned = tune(&mut page, json!({ "roll_deg": 180 }));
    assert_eq!(turned.sweep().header.height_m, 0.0);
}

#[test]
fn of_many_changes_the_newest_is_shown_at_last() {
    let (_, file) = calibrated();
    let calibration = file.path().to_str().unwrap();
    let view = View::start(&[
        &fixture("street_hdl64e_s3.pcap.gz"),
        "--calibration",
        calibration,
    ]);
    let mut page = view.page();
    page.pause();
    page.seek(0);
    for points in 1..=200 {
        page.ask(json!({ "do": "tune", "settings": { "min_points": points } }));
    }
    let mut shown = 0;
    let mut fewest = 0;
    // Behind the newest there is none.
    let behind = Duration::from_secs(1);
    let patience = |fewest| if fewest < 200 { PATIENCE } else { behind };
    while let Some(tuned) = page.sweep_within(patience(fewest)) {
        shown += 1;
        let points = tuned.sweep().segments.iter().map(|segment| segment.points);
        fewest = points.min().unwrap();
    }
    assert!(fewest >= 200, "{fewest}");
    assert!((1..200).contains(&shown), "{shown}");
}

#[test]
fn what_no_sensor_could_be_set_to_is_refused() {
    let view = View::start(&[&fixture("street_vlp16.pcap.gz")]);
    let mut page = view.page();
    page.pause();
    for (request, why) in [
        (
            json!({ "settings": { "theta_deg": 90.5 } }),
            "theta_deg: expected 0 to 90 degrees",
        ),
        (
            json!({ "settings": { "theta_deg": 90 } }),
            "theta is 90 degrees, expected more than 0 and less than 90",
        ),
        (
            json!({ "settings": { "theta_deg": null } }),
            "theta_deg: expected 0 to 90 degrees",
        ),
        (
            json!({ "settings": { "min_points": 1.5 } }),
            "min_points: expected a whole number from 1 on",
        ),
        (
            json!({ "settings": { "min_range_m": 5, "max_range_m": 4 } }),
            "the range is limited to 5..4 m",
        ),
        (
            json!({ "settings": { "theta": 10 } }),
            "there is no such setting",
        ),
        (
            json!({ "settings": {}, "method": "magic" }),
            "the method is slope or paper",
        ),
    ] {
        let mut request = request;
        request["do"] = "tune".into();
        page.ask(request);
        let refused = page.next("refused");
        let text = refused["text"].as_str().unwrap();
        assert!(text.starts_with(why), "{text}");
    }
    assert!(page.sweep_within(Duration::from_millis(300)).is_none());
    // It holds nothing, so that no sweep waits for a tuned copy.
    assert_eq!(page.seek(1).about["paired"], false);
}

/// The lines are read by the daemon itself.
#[test]
fn the_lines_for_the_configuration_say_what_the_page_says() {
    let view = View::start(&[&fixture("street_vlp16.pcap.gz"), "--height", "1.8"]);
    let mut page = view.page();
    let source = page.next("source");
    let height = source["settings"]
        .as_array()
        .unwrap()
        .iter()
        .find(|row| row["key"] == "height_m");
    assert_eq!(height.unwrap()["now"], 1.8);
    page.ask(json!({ "do": "tune", "method": "paper", "settings": { "min_points": 7, "pitch_deg": -2.5, "max_range_m": 80 } }));
    page.ask(json!({ "do": "configuration" }));
    let lines = page.next("configuration");
    let text = format!(
        "[[sensor]]\nname = 'roof'\naddress = '10.0.0.7'\n{}",
        lines["text"].as_str().unwrap()
    );
    let config = DaemonConfig::parse(Path::new(""), &text).unwrap();
    let segment = &config.sensors[0].pipeline.segment;
    assert_eq!(segment.method, Method::Paper);
    assert_eq!((segment.min_points, segment.max_range_m), (7, 80.0));
    assert_eq!(segment.mount.height_m, Some(1.8));
    assert!((segment.mount.pitch_rad.to_degrees() + 2.5).abs() < 1e-4);
    page.ask(json!({ "do": "tune", "method": "slope", "settings": { "height_m": null } }));
    page.ask(json!({ "do": "configuration" }));
    let lines = page.next("configuration");
    assert_eq!(lines["text"], "# nothing differs from the defaults\n");
}
