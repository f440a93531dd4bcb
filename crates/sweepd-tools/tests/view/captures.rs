//! Captures and simulations: what is shown, and how it is played.

use std::path::Path;
use std::time::{Duration, Instant};
use sweepd_testkit::stream::next_sweep;

use serde_json::json;
use sweepd::buffers::{HeapBuffers, Memory};
use sweepd::input::Capture;
use sweepd::pipeline::{Config, Pipeline};
use sweepd::sensor::ros_yaml;
use sweepd::sweep::SweepRef;
use sweepd::sweep::layout::flags;
use sweepd_lab::simulate::unit::unit;
use zerocopy::IntoBytes;

use crate::page::View;
use sweepd_testkit::root;

type Buffer = <HeapBuffers as sweepd::buffers::Buffers>::Buffer;

pub fn fixture(name: &str) -> String {
    let path = root().join("pcap_fixtures").join(name);
    path.display().to_string()
}

/// The sweeps of a capture of one sensor, as the library gives them, without the partial ones.
pub fn sweeps(path: &str, config: &Config) -> Vec<Buffer> {
    let mut capture = Capture::open(Path::new(path)).unwrap();
    let mut pipeline: Option<Pipeline> = None;
    let mut memory = Memory::new(HeapBuffers::default());
    let mut all = Vec::new();
    let mut sensors = sweepd::admission::DiscoveredSensors::new(Vec::new());
    while let Some(placed) = capture.next_placed().unwrap() {
        let Ok((_, packet)) = sensors.admit_from(&placed.datagram, placed.topic) else {
            continue;
        };
        let Some(sender) = sensors.senders().first() else {
            continue;
        };
        let pipeline =
            pipeline.get_or_insert_with(|| Pipeline::new(&sender.name, config.clone()).unwrap());
        pipeline.push(&packet);
        all.extend(std::iter::from_fn(|| next_sweep(pipeline, &mut memory)));
    }
    let mut pipeline = pipeline.unwrap();
    pipeline.end();
    all.extend(std::iter::from_fn(|| {
        next_sweep(&mut pipeline, &mut memory)
    }));
    all.retain(|buffer| {
        !SweepRef::open(buffer.as_ref())
            .unwrap()
            .header
            .has(flags::PARTIAL)
    });
    all
}

/// Fails unless two sweeps have the same bytes, but for how long their stages took and the room that
/// they leave unused.
#[track_caller]
pub fn assert_same(one: &SweepRef<'_>, other: &SweepRef<'_>) {
    let told = |sweep: &SweepRef<'_>| {
        let mut header = *sweep.header;
        (header.decode_ns, header.ground_ns, header.label_ns) = (0, 0, 0);
        (header.total_bytes, header.offsets, header.margin_columns) = (0, [0; _], 0);
        (header.columns_capacity, header.segments_capacity) = (0, 0);
        header
    };
    assert!(told(one).as_bytes() == told(other).as_bytes());
    assert!(one.range.as_bytes() == other.range.as_bytes());
    assert!(one.reflectivity == other.reflectivity);
    assert!(one.label == other.label);
    assert!(one.range2.as_bytes() == other.range2.as_bytes());
    assert!(one.reflectivity2 == other.reflectivity2);
    assert!(one.label2 == other.label2);
    assert!(one.kind == other.kind);
    assert!(one.columns.as_bytes() == other.columns.as_bytes());
    assert!(one.beams.as_bytes() == other.beams.as_bytes());
    assert!(one.segments.as_bytes() == other.segments.as_bytes());
}

/// A configuration with the calibration of an HDL-64E, and the file that it is in.
pub fn calibrated() -> (Config, tempfile::NamedTempFile) {
    let file = tempfile::Builder::new().suffix(".yaml").tempfile().unwrap();
    std::fs::write(file.path(), ros_yaml::emit(&unit(3))).unwrap();
    let config = Config {
        calibration: Some(sweepd::files::calibration(file.path()).unwrap()),
        ..Config::default()
    };
    (config, file)
}

#[test]
fn sweeps_are_those_of_the_library_forwards_and_backwards() {
    for name in [
        "street_vlp16_losses.pcap",
        "street_hdl32e.pcap.gz",
        "street_hdl64e_s3_dual.pcap.gz",
    ] {
        let path = fixture(name);
        let (mut config, file) = calibrated();
        let mut args = vec![&path[..]];
        match name.contains("hdl64e") {
            true => args.extend(["--calibration", file.path().to_str().unwrap()]),
            false => config = Config::default(),
        }
        let expected = sweeps(&path, &config);
        assert!(expected.len() >= 2, "{name}");
        let view = View::start(&args);
        let mut page = view.page();
        page.pause();
        let forwards = 0..expected.len();
        for index in forwards.clone().chain(forwards.rev()) {
            let shown = page.seek(index as u64);
            let same = SweepRef::open(expected[index].as_ref()).unwrap();
            assert_same(&shown.sweep(), &same);
            assert_eq!(shown.about["sequence"], same.header.sequence);
            assert!(shown.sweep().header.decode_ns > 0);
        }
    }
}

#[test]
fn the_time_line_has_the_sweeps_and_the_losses() {
    let path = fixture("street_vlp16_losses.pcap");
    let expected = sweeps(&path, &Config::default());
    let mut losses = Vec::new();
    for (index, buffer) in expected.iter().enumerate() {
        let lost = SweepRef::open(buffer.as_ref()).unwrap().header.lost_packets;
        if lost > 0 {
            losses.push((index as u64, format!("{lost} packet")));
        }
    }
    let view = View::start(&[&path]);
    let mut page = view.page();
    let source = page.until(|message| message["sweeps"] == expected.len());
    assert_eq!(
        (&source["type"], &source["kind"], &source["name"]),
        (&"source".into(), &"capture".into(), &path.into())
    );
    assert_eq!(source["sensors"], json!(["192.168.1.201:2368"]));
    let marks = source["marks"].as_array().unwrap();
    assert_eq!(marks.len(), losses.len());
    for (mark, (index, text)) in marks.iter().zip(&losses) {
        assert_eq!(
            (&mark["sweep"], &mark["what"]),
            (&json!(index), &"loss".into())
        );
        assert!(mark["text"].as_str().unwrap().starts_with(text), "{mark}");
    }
    let settings = source["settings"].as_array().unwrap();
    assert_eq!(settings.len(), sweepd::segment::SETTINGS.len());
    assert_eq!(settings[0]["key"], "theta_deg");
    assert_eq!(
        (&settings[0]["now"], &settings[0]["default"]),
        (&json!(10.0), &json!(10.0))
    );
}

#[test]
fn a_short_capture_is_played_again_and_again_paused_and_stepped_through() {
    let path = fixture("street_vlp16.pcap.gz");
    let count = sweeps(&path, &Config::default()).len() as u64;
    let view = View::start(&[&path]);
    let mut page = view.page();
    // It began with the page, and not before.
    let mut begun = Instant::now();
    for index in 0..count {
        begun = Instant::now();
        let shown = page.sweep();
        assert_eq!((shown.index(), shown.missed()), (index, 0));
        page.drawn();
    }
    assert_eq!(page.draw_until(|_| true).index(), 0);
    assert!(
        begun.elapsed() > Duration::from_millis(450),
        "the last is seen"
    );
    page.ask(json!({ "do": "seek", "index": u64::MAX }));
    page.draw_until(|shown| shown.index() == count - 1);
    let state = page.words("the end");
    assert_eq!(
        (&state["ok"], &state["playing"]),
        (&true.into(), &false.into())
    );
    // The last may have been shown twice: as it played, and as it was sought.
    page.drawn();
    page.ask(json!({ "do": "step", "by": -1 }));
    page.draw_until(|shown| shown.index() == count - 2);
    page.words("paused");
    page.ask(json!({ "do": "step", "by": 1 }));
    assert_eq!(page.draw_until(|_| true).index(), count - 1);
    // There is no sweep before the first, and none behind the last: it is the last.
    page.seek(0);
    page.ask(json!({ "do": "step", "by": -1 }));
    assert_eq!(page.draw_until(|_| true).index(), 0);
    page.ask(json!({ "do": "seek", "index": u64::MAX }));
    assert_eq!(page.draw_until(|_| true).index(), count - 1);
    // At the end, to play is to begin again; slowly it takes its time.
    page.ask(json!({ "do": "speed", "factor": 0.1 }));
    let begun = Instant::now();
    page.ask(json!({ "do": "play" }));
    assert_eq!(page.draw_until(|_| true).index(), 0);
    assert_eq!(page.draw_until(|_| true).index(), 1);
    assert!(begun.elapsed() > Duration::from_millis(900));
    page.ask(json!({ "do": "speed", "factor": 16 }));
    page.draw_until(|shown| shown.index() == count - 1);
    page.ask(json!({ "do": "speed", "factor": 17 }));
    let refused = page.next("refused");
    assert_eq!(refused["text"], "speed: expected 0.1 to 16");
}

#[test]
fn all_pages_see_one_sweep() {
    let view = View::start(&[&fixture("street_vlp16.pcap.gz")]);
    let (mut one, mut other) = (view.page(), view.page());
    one.pause();
    one.seek(2);
    let shown = other.draw_until(|shown| shown.index() == 2);
    assert_eq!(shown.index(), 2);
    // One that comes later too.
    assert_eq!(view.page().sweep().index(), 2);
}

#[test]
fn far_back_is_the_same_as_at_first() {
    let view = View::start(&["--simulate", "vlp16"]);
    let mut page = view.page();
    page.pause();
    let first = page.seek(2);
    page.seek(40);
    let again = page.seek(2);
    assert_same(&first.sweep(), &again.sweep());
    let source = view.page().next("source");
    assert_eq!(source["kind"], "simulation");
}

/// It is sent nothing until it has drawn, then the newest, and the number of those that it missed.
#[test]
fn a_slow_page_gets_the_newest() {
    let view = View::start(&["--simulate", "vlp16"]);
    let mut page = view.page();
    let first = page.sweep();
    assert_eq!(first.missed(), 0);
    let mut fast = view.page();
    let seen = fast.draw_until(|shown| shown.index() >= first.index() + 5);
    assert!(page.sweep_within(Duration::from_millis(100)).is_none());
    page.drawn();
    let newest = page.sweep();
    assert!(newest.index() >= seen.index());
    assert_eq!(newest.missed(), newest.index() - first.index() - 1);
}

#[test]
fn a_broken_capture_says_so_and_shows_what_came_before() {
    let whole = std::fs::read(fixture("street_vlp16_losses.pcap")).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("cut.pcap");
    std::fs::write(&path, &whole[..whole.len() * 3 / 4]).unwrap();
    let path = path.to_str().unwrap();
    let expected = sweeps(path, &Config::default());
    assert!(!expected.is_empty());
    let view = View::start(&[path]);
    let mut page = view.page();
    page.draw_until(|shown| shown.index() + 1 == expected.len() as u64);
    let state = page.words("the capture breaks off at record");
    assert_eq!(
        (&state["ok"], &state["playing"]),
        (&false.into(), &false.into())
    );
    let shown = page.seek(0);
    assert_same(
        &shown.sweep(),
        &SweepRef::open(expected[0].as_ref()).unwrap(),
    );
}

#[test]
fn a_capture_of_less_than_a_turn_names_what_gives_the_part() {
    let whole = std::fs::read(fixture("street_vlp16_losses.pcap")).unwrap();
    // The file header, and twenty records.
    let mut end = 24;
    for _ in 0..20 {
        let len = u32::from_le_bytes(*whole[end + 8..].first_chunk().unwrap());
        end += 16 + len as usize;
    }
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("short.pcap");
    std::fs::write(&path, &whole[..end]).unwrap();
    let view = View::start(&[path.to_str().unwrap()]);
    let state = view.page().words("there is no whole turn in it");
    assert!(state["words"].as_str().unwrap().contains("--partial"));
}
