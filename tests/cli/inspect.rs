//! What `sweepd inspect` tells.

use std::time::Duration;

use serde_json::{Value, json};

use crate::{Folder, fixture, inspect, made, sweepd};
use sweepd::segment::Mount;
use sweepd::sensor::Model;
use sweepd::wire::data::ReturnMode;
use sweepd_lab::cast::{Scene, Sensor, Spin, small_box};
use sweepd_lab::simulate::{Emitter, EmitterConfig, Setting};
use sweepd_testkit::{data_dir, stream};

/// The value of a row of the text.
fn row<'a>(text: &'a str, name: &str) -> &'a str {
    let line = text
        .lines()
        .find_map(|line| line.strip_prefix("  ")?.strip_prefix(name));
    line.unwrap_or_else(|| panic!("no {name} in\n{text}"))
        .trim()
}

/// The encoder's noise is some tenths of a turn a minute.
fn is_about_600(speed: &str) -> bool {
    speed.starts_with("600.") || speed.starts_with("599.")
}

#[test]
fn a_capture_is_described_in_full() {
    let text = inspect(&fixture("street_vlp16_losses.pcap")).done();
    assert_eq!(
        row(&text, "time"),
        "2026-05-04 10:17:23.004 UTC to 2026-05-04 10:17:23.404 UTC, 0.399 s"
    );
    assert_eq!(row(&text, "link type"), "Ethernet");
    assert_eq!(
        row(&text, "model"),
        "VLP-16, by its factory bytes and packet period"
    );
    assert_eq!(row(&text, "return mode"), "strongest");
    assert!(row(&text, "data").starts_with("286 packets (71"), "{text}");
    assert!(
        is_about_600(row(&text, "speed")) && row(&text, "speed").contains(" rpm ("),
        "{text}"
    );
    assert_eq!(
        row(&text, "losses"),
        "18 packets lost, 2 out of order, 2 received twice"
    );
    assert!(
        row(&text, "GPS").starts_with("PPS locked, RMC valid: 2026-05-04 10:17:23"),
        "{text}"
    );
    let text = inspect(&fixture("street_hdl32e_dual.pcap.gz")).done();
    assert_eq!(
        (row(&text, "return mode"), row(&text, "GPS")),
        ("dual", "PPS not reported by this model, no sentence")
    );
}

/// The last object that a command prints of a capture.
fn last_json(command: &str, file: &str) -> Value {
    let file = fixture(file);
    let told = sweepd(&[command, file.to_str().unwrap(), "--json"]).done();
    let values = serde_json::Deserializer::from_str(&told).into_iter();
    values.last().unwrap().unwrap()
}

/// The numbers of the text.
#[test]
fn programs_get_the_same() {
    let told = last_json("inspect", "street_vlp16_losses.pcap");
    let sensor = &told["sensors"][0];
    for (key, value) in [
        ("sensor", json!("192.168.1.201:2368")),
        ("source", json!("192.168.1.201:2368")),
        ("port", json!(2368)),
        ("model", json!("VLP-16")),
        ("return_modes", json!(["strongest"])),
        ("packets", json!(286)),
        ("lost_packets", json!(18)),
        ("reordered", json!(2)),
        ("duplicates", json!(2)),
        ("malformed", json!(0)),
        ("fault", Value::Null),
        ("left_out_deg", Value::Null),
        ("dark_beams", json!([])),
        ("unit", Value::Null),
    ] {
        assert_eq!(sensor[key], value, "{key}");
    }
    let rpm = sensor["rpm"].as_f64().unwrap();
    assert!((rpm - 600.0).abs() < 1.0, "{rpm}");
    let height_m = sensor["floor"]["height_m"].as_f64().unwrap();
    assert!((1.0..2.5).contains(&height_m), "{sensor}");
    let position = &told["positions"][0];
    assert_eq!(
        (
            &position["address"],
            &position["pps"],
            &position["sentence_valid"]
        ),
        (&json!("192.168.1.201"), &json!("locked"), &json!(true))
    );
    // 2026-05-04 10:17:23 UTC, by date(1).
    assert_eq!(position["utc_ns"], json!(1_777_889_843_000_000_000_i64));
    let told = last_json("inspect", "street_hdl64e_s3.pcap.gz");
    let unit = &told["sensors"][0]["unit"];
    assert_eq!(unit["series"], json!("S3"), "{unit}");
}

#[test]
fn what_inspect_and_replay_count_has_the_same_names() {
    let told = last_json("inspect", "street_vlp16_losses.pcap");
    let replayed = last_json("replay", "street_vlp16_losses.pcap");
    let summary = &replayed["summary"];
    for key in [
        "model",
        "model_basis",
        "lost_packets",
        "reordered",
        "duplicates",
        "return_modes",
        "rpm",
    ] {
        assert_eq!(told["sensors"][0][key], summary["sensors"][0][key], "{key}");
    }
    for key in [
        "name",
        "records",
        "datagrams",
        "other_traffic",
        "breaks_off",
    ] {
        assert_eq!(told["capture"][key], summary["capture"][key], "{key}");
    }
}

#[test]
fn a_head_that_turns_the_other_way_is_reported() {
    let folder = Folder::new("reversed");
    let path = folder.write("reversed.pcap", made::pcap(&made::reversed(made::vlp16())));
    let text = inspect(&path).done();
    let speed = row(&text, "speed");
    assert!(
        is_about_600(speed) && speed.ends_with("counter-clockwise") && !speed.contains("-6"),
        "{speed}"
    );
    let table = crate::replay(&path, &["--no-timing"]).done();
    assert!(
        row(&table, "speed").ends_with("rpm (600.0 to 600.0), counter-clockwise"),
        "{table}"
    );
}

#[test]
fn a_change_of_return_mode_and_shared_addresses_are_reported() {
    let folder = Folder::new("modes");
    let mut changed = made::datagrams("street_vlp16.pcap.gz");
    let dual = made::datagrams("street_vlp16_dual.pcap.gz");
    let later_ns = changed.last().unwrap().arrival_ns - dual[0].arrival_ns + 1_000_000_000;
    changed.extend(dual.into_iter().map(|sent| made::Sent {
        arrival_ns: sent.arrival_ns + later_ns,
        ..sent
    }));
    let text = inspect(&folder.write("changed.pcap", made::pcap(&changed))).done();
    assert_eq!(row(&text, "return mode"), "strongest, dual");

    let other = made::with_ports(&made::vlp16(), "192.168.1.201:2369", 2369);
    let both = made::together(&[&made::vlp16(), &other]);
    let text = inspect(&folder.write("both.pcap", made::pcap(&both))).done();
    assert!(
        text.contains("\n192.168.1.201:2368 to port 2368\n"),
        "{text}"
    );
    assert!(
        text.contains("\n192.168.1.201:2369 to port 2369\n"),
        "{text}"
    );
    assert!(
        row(&text, "position").ends_with("of all sensors at this address"),
        "{text}"
    );
}

#[test]
fn a_beam_that_never_returns_is_told() {
    let folder = Folder::new("dark");
    let mut sent = made::vlp16();
    let whole = inspect(&folder.write("whole.pcap", made::pcap(&sent))).done();
    assert!(!whole.contains("dark beams"), "{whole}");
    for one in sent.iter_mut().filter(|one| one.is_data()) {
        stream::blank(&mut one.payload, 16, 11);
    }
    let text = inspect(&folder.write("dark.pcap", made::pcap(&sent))).done();
    assert_eq!(
        row(&text, "dark beams"),
        "channel 11 (row 2) has not returned for 3 turns, though the beams next to it have"
    );
}

/// The laser of channel 82 of this VLS-128 is dead, and that of channel 11 of this HDL-32E.
#[test]
#[cfg_attr(without_captures, ignore = "no captures")]
fn the_dark_beams_of_real_captures_are_named_and_no_others() {
    let mut named = Vec::new();
    let pcaps = std::fs::read_dir(data_dir().join("pcap")).unwrap();
    for path in pcaps.map(|entry| entry.unwrap().path()) {
        let text = inspect(&path).stdout;
        if text.contains("dark beams") {
            let name = path.file_name().unwrap().to_str().unwrap().to_owned();
            named.push((name, row(&text, "dark beams").to_owned()));
        }
    }
    named.sort();
    let told = |beam, turns| {
        format!("{beam} has not returned for {turns}, though the beams next to it have")
    };
    let expected = [
        (
            "hdl32e_mrpt-sample.pcap",
            told("channel 11 (row 10)", "2 turns"),
        ),
        (
            "vls128_nebula-a.pcap",
            told("channel 82 (row 105)", "1 turn"),
        ),
    ];
    assert_eq!(named, expected.map(|(name, told)| (name.to_owned(), told)));
}

/// A VLP-16 at 0.4 m, nose 10 degrees down, in a hall with a box: what is printed is pasted into a
/// configuration, and held against what the mount is said to be.
#[test]
fn the_floor_says_how_the_sensor_is_mounted() {
    let mut sensor = Sensor::new(Model::Vlp16, 0.4);
    sensor.pitch_rad = (-10_f64).to_radians();
    let mut scene = Scene::with(vec![small_box(0.3, 2.0, 0.4)]);
    scene.walls_m = 6.0;
    let mut sent = Vec::new();
    for (time, packet) in Spin::new(&sensor, &scene) {
        if time > Duration::from_millis(450) {
            break;
        }
        sent.push(made::Sent {
            arrival_ns: 1_700_000_000_000_000_000 + time.as_nanos() as i64,
            source: "192.168.1.201:2368".parse().unwrap(),
            port: 2368,
            payload: packet.emit().to_vec(),
        });
    }
    let folder = Folder::new("floor");
    let path = folder.write("floor.pcap", made::pcap(&sent));
    let text = inspect(&path).done();
    assert!((key(&text, "height_m") - 0.4).abs() <= 0.008, "{text}");
    assert!((key(&text, "pitch_deg") + 10.0).abs() <= 0.5, "{text}");
    assert!(key(&text, "roll_deg").abs() <= 0.5, "{text}");
    assert!(
        text.contains("[sensor.mount]") && !text.contains("warning"),
        "{text}"
    );
    let path = path.to_str().unwrap();
    for (said, is_off) in [
        (["--pitch=-10", "--height=0.4"], false),
        (["--pitch=-8.5", "--roll=1"], false),
        (["--pitch=0", "--roll=0"], true),
        (["--pitch=-10", "--height=0.5"], true),
    ] {
        let text = sweepd(&["inspect", path, said[0], said[1]]).done();
        assert_eq!(text.contains("warning"), is_off, "{said:?}:\n{text}");
    }
    // Head down, the floor would be on the other side.
    let text = sweepd(&["inspect", path, "--roll=180"]).done();
    assert!(
        row(&text, "floor").starts_with("no floor is seen"),
        "{text}"
    );
}

/// What a sensor sends for six and a half turns in a warehouse, 1.5 m up and rolled by so much.
fn in_a_warehouse(model: Model, roll_deg: f32) -> Vec<made::Sent> {
    let scene = Setting::Warehouse.build(1);
    let mount = Mount {
        height_m: Some(1.5),
        roll_rad: roll_deg.to_radians(),
        ..Mount::default()
    };
    let mut config = EmitterConfig::new(model, ReturnMode::Strongest).turns(6.5);
    config.pose = Setting::Warehouse.mounted(&scene, 0, &mount).unwrap();
    Emitter::new(config, &scene)
        .map(|sent| made::Sent {
            arrival_ns: sent.arrival_ns,
            source: sent.source,
            port: sent.destination.port(),
            payload: sent.payload,
        })
        .collect()
}

/// The value of a key among the lines to copy.
fn key(text: &str, key: &str) -> f64 {
    let mut lines = text.lines().map(str::trim);
    let value = lines.find_map(|line| line.strip_prefix(key)?.strip_prefix(" = "));
    let value = value.unwrap_or_else(|| panic!("no {key} in\n{text}"));
    value.parse().unwrap()
}

fn json_of(path: &std::path::Path, options: &[&str]) -> Value {
    let mut args = vec!["inspect", path.to_str().unwrap(), "--json"];
    args.extend(options);
    serde_json::from_str(&sweepd(&args).done()).unwrap()
}

#[test]
fn an_hdl32e_says_itself_which_side_is_up() {
    let folder = Folder::new("chips");
    for (roll_deg, name) in [(0.0, "upright"), (180.0, "head_down")] {
        let sent = in_a_warehouse(Model::Hdl32e, roll_deg);
        let path = folder.write(&format!("{name}.pcap"), made::pcap(&sent));
        let text = inspect(&path).done();
        assert!((key(&text, "height_m") - 1.5).abs() < 0.03, "{text}");
        assert!(
            (key(&text, "roll_deg").abs() - f64::from(roll_deg)).abs() < 0.5,
            "{text}"
        );
        assert!(
            row(&text, "floor").starts_with("its accelerometers say"),
            "{text}"
        );
        assert!(text.matches("[sensor.mount]").count() == 1, "{text}");
        let sensor = &json_of(&path, &[])["sensors"][0];
        assert_eq!(sensor["side"], name);
        assert_eq!(sensor["side_by"], "accelerometers");
        assert_eq!(sensor["floor_if_hanging"], Value::Null);
        // What is set counts before what is felt.
        let told = &json_of(&path, &["--roll", "0"])["sensors"][0];
        assert_eq!(
            (&told["side"], &told["side_by"]),
            (&json!("upright"), &json!("mount"))
        );
        // And is told where it is another one.
        let trouble = told["floor"]["trouble"].as_str().unwrap_or_default();
        let is_other = trouble.contains("its accelerometers say that it hangs head down");
        assert_eq!(is_other, name == "head_down", "{trouble}");
    }
}

/// Without the position packets, and as another model.
#[test]
fn a_ceiling_is_never_the_floor_without_the_words() {
    let folder = Folder::new("ceiling");
    for model in [Model::Hdl32e, Model::Vlp16] {
        for roll_deg in [0.0, 180.0] {
            let mut sent = in_a_warehouse(model, roll_deg);
            sent.retain(made::Sent::is_data);
            let path = folder.write("capture.pcap", made::pcap(&sent));
            let text = inspect(&path).done();
            let place = format!("{model} {roll_deg}:\n{text}");
            let sensor = &json_of(&path, &[])["sensors"][0];
            if roll_deg != 0.0 {
                assert!(text.contains("if the sensor hangs"), "{place}");
                assert_ne!(sensor["side"], "upright", "{place}");
            }
            // What is seen is one of the two, and the true one is among them.
            let heights = ["floor", "floor_if_hanging"].map(|key| sensor[key]["height_m"].as_f64());
            let is_right = |height_m: &f64| (height_m - 1.5).abs() < 0.075;
            let is_there = heights[usize::from(roll_deg != 0.0)]
                .as_ref()
                .is_some_and(is_right);
            assert!(is_there, "{heights:?} {place}");
            // With the side that is set, nothing is said of another, and no cure is what is set.
            let roll = format!("{roll_deg}");
            let told = sweepd(&["inspect", path.to_str().unwrap(), "--roll", &roll]).done();
            assert!(
                !told.contains("hangs") && !told.contains("roll_deg = 180;"),
                "{told}"
            );
            assert!((key(&told, "height_m") - 1.5).abs() < 0.075, "{told}");
        }
    }
}

#[test]
fn the_mount_of_a_configuration_is_held_against_the_floor() {
    let folder = Folder::new("configured-mount");
    let capture = folder.write("capture.pcap", made::pcap(&made::vlp16()));
    let config = folder.write(
        "sweepd.toml",
        "[[sensor]]\nname = \"roof\"\naddress = \"192.168.1.201\"\nmount = { height_m = 2.5, roll_deg = 1 }\n\
         [[sensor]]\nname = \"rear\"\naddress = \"192.168.1.9\"\n",
    );
    let [capture, config] = [&capture, &config].map(|path| path.to_str().unwrap());
    let args = ["inspect", capture, "--config", config, "--sensor", "roof"];
    let text = sweepd(&args).done();
    assert!(
        text.contains("\nroof, 192.168.1.201:2368 to port 2368\n"),
        "{text}"
    );
    assert!(
        row(&text, "warning").starts_with("the mount is set to height_m = 2.5"),
        "{text}"
    );
    // Options beside it count more.
    let text = sweepd(&[&args[..], &["--height", "1.9"]].concat()).done();
    assert!(!text.contains("warning"), "{text}");
    let gone = sweepd(&["inspect", capture, "--config", config, "--sensor", "rear"]);
    gone.says(&["no sensor rear (192.168.1.9) in it"]);
    sweepd(&["inspect", capture, "--config", config, "--sensor", "front"])
        .says(&["has no sensor called `front`", "roof (192.168.1.201)"]);
    sweepd(&["inspect", capture, "--sensor", "roof"]).says(&["--config"]);
    // A mask of 64 rows, and a sensor of 16.
    folder.write("mask.png", made::png(720, 64));
    let masked = folder.write(
        "masked.toml",
        "[[sensor]]\nname = \"roof\"\naddress = \"192.168.1.201\"\nsegment = { mask = \"mask.png\" }\n",
    );
    sweepd(&["inspect", capture, "--config", masked.to_str().unwrap()])
        .says(&["roof: ", "64 pixels high"]);
}

#[test]
fn less_than_a_turn_has_no_floor() {
    let folder = Folder::new("less");
    let sent: Vec<made::Sent> = made::vlp16().into_iter().take(40).collect();
    let path = folder.write("less.pcap", made::pcap(&sent));
    let text = inspect(&path).done();
    assert_eq!(row(&text, "floor"), "none: the capture has no whole turn");
    assert!(is_about_600(row(&text, "speed")), "{text}");
    let floor = &json_of(&path, &[])["sensors"][0]["floor"];
    assert_eq!(floor["trouble"], "none: the capture has no whole turn");
    assert_eq!(floor["lines"], Value::Null);
}

/// One place measures it.
#[test]
#[cfg_attr(without_captures, ignore = "no captures")]
fn a_real_sensor_has_one_speed() {
    let path = data_dir().join("pcap/hdl32e_veloview-monterey-a.pcap");
    let told = json_of(&path, &[]);
    let replayed = sweepd(&["replay", path.to_str().unwrap(), "--json"]).done();
    let summary: Value = serde_json::from_str(replayed.lines().last().unwrap()).unwrap();
    let rpm = &told["sensors"][0]["rpm"];
    assert_eq!(rpm, &summary["summary"]["sensors"][0]["rpm"]);
    assert!((700.0..710.0).contains(&rpm.as_f64().unwrap()), "{rpm}");
}

const MEASURED: &str = "docs/measured.md";
const TABLE: &str = "## What the floor says on real captures\n";
const TABLE_CURE: &str = "SWEEPD_WRITE_PAGES=1 cargo test -p sweepd --test cli what_the_floor_says";

/// A row for a floor: its height, pitch, roll, spread or doubt, sweeps.
fn floor_row(name: &str, floor: &Value) -> String {
    let number = |key: &str, digits: usize| match floor[key].as_f64() {
        Some(number) => format!("{number:.digits$}"),
        None => String::new(),
    };
    let spread = floor["spread"]["height_m"].as_f64();
    let said = match (&floor["doubt"], &floor["trouble"], spread) {
        (Value::String(doubt), ..) => doubt.clone(),
        (_, _, Some(spread_m)) => format!("{spread_m:.3}"),
        (_, Value::String(trouble), None) => trouble.clone(),
        _ => "not decoded".to_owned(),
    };
    let sweeps = match (&floor["sweeps"], &floor["looks"]) {
        (Value::Number(sweeps), Value::Number(looks)) => format!("{sweeps} of {looks}"),
        _ => String::new(),
    };
    let [height, pitch, roll] = [("height_m", 3), ("pitch_deg", 1), ("roll_deg", 1)]
        .map(|(key, digits)| number(key, digits));
    format!("| {name} | {height} | {pitch} | {roll} | {said} | {sweeps} |\n")
}

/// The table of the page is what `inspect` says.
#[test]
#[cfg_attr(without_captures, ignore = "no captures")]
fn what_the_floor_says_on_real_captures_is_in_the_page() {
    let pcaps = std::fs::read_dir(data_dir().join("pcap")).unwrap();
    let mut paths: Vec<_> = pcaps.map(|entry| entry.unwrap().path()).collect();
    paths.sort();
    let mut table =
        "| capture | height, m | pitch, degrees | roll, degrees | spread, m, or doubt | sweeps |\n\
                     |---|---|---|---|---|---|\n"
            .to_owned();
    for path in paths {
        let name = path.file_stem().unwrap().to_str().unwrap();
        let sensor = &json_of(&path, &[])["sensors"][0];
        let above = &sensor["floor_if_hanging"];
        if above.is_null() || !sensor["floor"].is_null() {
            table += &floor_row(name, &sensor["floor"]);
        }
        if !above.is_null() {
            table += &floor_row(&format!("{name}, if it hangs"), above);
        }
    }
    let path = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join(MEASURED);
    let page = std::fs::read_to_string(&path).unwrap();
    let (before, section) = page.split_once(TABLE).unwrap();
    let from = section.find("\n|").unwrap() + 1;
    let to = from + section[from..].find("\n\n").unwrap() + 1;
    let made = [before, TABLE, &section[..from], &table, &section[to..]].concat();
    if std::env::var_os("SWEEPD_WRITE_PAGES").is_some() {
        std::fs::write(&path, &made).unwrap();
    }
    assert!(
        made == std::fs::read_to_string(&path).unwrap(),
        "{MEASURED} differs: {TABLE_CURE}"
    );
}
