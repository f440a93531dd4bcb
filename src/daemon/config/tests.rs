use std::path::Path;

use proptest::prelude::*;

use super::key::Form;
use super::keys::{DAEMON, SENSOR_TABLES};
use super::*;
use sweepd_core::segment::settings::REMOVED;
use sweepd_core::segment::{Method, SETTINGS};
use sweepd_core::sensor::{Model, ModelExt};
use sweepd_core::sweep::layout::ReturnChoice;

const EXAMPLE: &str = include_str!("../../../systemd/sweepd.toml");
/// What stands before the example in its page.
const PAGE_HEAD: &str = "# Configuration

Every key of the daemon's file: what `sweepd config example` prints, and the packages install as `/etc/sweepd/sweepd.toml`.
`sweepd config check FILE` checks a file, and prints what it means ([config](usage.md#config)).
`SWEEPD_WRITE_PAGES=1 cargo test -p sweepd --lib systemd_ships` writes this page.
";
/// That of version 0.2.0, with all numbers of the segmenter set.
const OLD_EXAMPLE: &str = include_str!("sweepd-0.2.0.toml");

fn parse(text: &str) -> Result<Config, ConfigError> {
    Config::parse(Path::new("/nowhere/robot.toml"), text)
}

fn good(text: &str) -> Config {
    parse(text).unwrap_or_else(|error| panic!("{error}"))
}

/// The lines that are to blame, and the whole message.
fn bad(text: &str) -> (Vec<usize>, String) {
    match parse(text).expect_err(text) {
        ConfigError::Invalid(problems) => (problems.lines(), problems.to_string()),
        error @ ConfigError::Read { .. } => panic!("{error}"),
    }
}

/// A sensor with these lines after its name and address.
fn roof(more: &str) -> String {
    format!("[[sensor]]\nname = \"roof\"\naddress = \"192.168.1.201\"\n{more}")
}

/// An upgrade leaves no robot without its sensor.
#[test]
fn a_configuration_of_an_earlier_version_is_read_with_a_warning_for_each_key_that_is_gone() {
    let config = good(OLD_EXAMPLE);
    assert_eq!(config.warnings.len(), REMOVED.len() + 1);
    let theta = config.warnings.iter().find(|one| one.contains("theta_deg"));
    assert!(theta.is_some_and(|one| one.starts_with("line 89: ")));
    for removed in REMOVED {
        let is_key = |line: &&str| line.starts_with(&format!("{} = ", removed.key));
        let line = OLD_EXAMPLE.lines().position(|line| is_key(&line)).unwrap() + 1;
        let said = format!("line {line}: {}", removed.warning(removed.key));
        assert!(
            config.warnings.contains(&said),
            "no {said:?} in {:?}",
            config.warnings
        );
        // No key is both, and what a key of this version was set to is taken.
        assert!(SETTINGS.iter().all(|setting| setting.key != removed.key));
    }
    assert_eq!(config.sensors[0].pipeline.segment.max_range_m, 100.0);
    // It is still a key that is not known elsewhere.
    let (lines, _) = bad(&roof("gap_m = 0.6"));
    assert_eq!(lines, [4]);
}

#[test]
fn each_key_of_an_earlier_version_is_known() {
    let mut keys = 0;
    for line in OLD_EXAMPLE.lines() {
        let Some(key) = line.strip_prefix('#') else {
            continue;
        };
        if key.starts_with([' ', '[']) {
            continue;
        }
        let is_record = ["path", "rotate"]
            .iter()
            .any(|start| key.starts_with(start));
        let mut text = OLD_EXAMPLE.replacen(&format!("\n{line}\n"), &format!("\n{key}\n"), 1);
        if is_record {
            text = text.replace("\n#[record]\n", "\n[record]\n");
        }
        // What is wrong with its value, such as a file that is not there, is another matter.
        if let Err(error) = parse(&text) {
            let said = error.to_string();
            assert!(
                !said.contains("unknown") && !said.contains("wrong type"),
                "{key}: {said}"
            );
        }
        keys += 1;
    }
    assert_eq!(keys, 35);
}

#[test]
fn two_lines_are_enough_for_a_sensor() {
    let config = good(&roof(""));
    assert_eq!(
        config.daemon,
        DaemonConfig {
            root: None,
            http: Some("127.0.0.1:9177".parse().unwrap()),
            http_public: false
        }
    );
    let [sensor] = &config.sensors[..] else {
        panic!()
    };
    assert_eq!(
        (&sensor.name[..], sensor.address),
        ("roof", [192, 168, 1, 201].into())
    );
    let (bind, multicast, interface) = ([0, 0, 0, 0].into(), None, None);
    let port = PortConfig {
        bind,
        port: 2368,
        multicast,
        interface,
        cpu: None,
        realtime_priority: None,
    };
    assert_eq!(
        (&sensor.port, sensor.position_port, sensor.source_port),
        (&port, 8308, None)
    );
    assert_eq!(
        (sensor.max_consumers, sensor.dual, &sensor.want),
        (4, None, &Settings::default())
    );
    // Whatever the command line takes by default, the file does.
    assert_eq!(
        sensor.pipeline.segment,
        sweepd_core::segment::Config::default()
    );
    assert_eq!(
        (sensor.pipeline.model, sensor.pipeline.cut_azimuth_rad),
        (None, 0.0)
    );
    assert!(config.record.is_none());
}

/// Each is compared with all others, and each slip drawn: twenty thousand took more than 10 s.
#[test]
fn a_file_of_thousands_of_sensors_is_refused_at_once() {
    let sensors = |count: usize| {
        (0..count).map(|n| format!("[[sensor]]\nname = \"s{n}\"\naddress = \"10.0.0.{n}\"\n"))
    };
    assert_eq!(good(&sensors(64).collect::<String>()).sensors.len(), 64);
    let (lines, message) = bad(&sensors(5000).collect::<String>());
    assert_eq!(lines, [64 * 3 + 1]);
    assert!(
        message.contains("5000 sensors are configured") && message.contains("at most 64"),
        "{message:.300}"
    );
}

#[test]
fn every_key_arrives_where_it_belongs() {
    let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/calib/robot.toml");
    let text = r#"
        http = "0.0.0.0:9000"
        http_public = true
        root = "iox2"
        [[sensor]]
        name = "roof"
        address = "192.168.1.201:2368"
        port = 2370
        position_port = 8309
        bind = "127.0.0.1"
        multicast = "239.1.1.1"
        interface = "lo"
        cpu = 0
        realtime_priority = 50
        model = "vlp16"
        calibration = "vlp16.yaml"
        returns = "dual"
        return = "last"
        cut_azimuth_deg = 180
        want = { rpm = 600, returns = "dual", fov = "270-90", laser = "on", host = "192.168.1.100", phase_lock = "180" }
        loss_warning_percent = 1.5
        loss_fault_percent = 12
        max_consumers = 2
        mount = { x_m = 1, y_m = 2.5, z_m = -3, roll_deg = 90, pitch_deg = -90, yaw_deg = 180, height_m = 1.5 }
        segment = { method = "paper", theta_deg = 45, min_points = 3, min_range_m = 0.5, max_range_m = 80 }
        [record]
        path = "/data/drive.pcap.gz"
        rotate_mb = 1.5
        rotate_minutes = 10
    "#;
    let config = Config::parse(Path::new(folder), text).unwrap_or_else(|error| panic!("{error}"));
    let root = Path::new(folder).with_file_name("iox2");
    assert_eq!(
        config.daemon,
        DaemonConfig {
            root: Some(root),
            http: Some("0.0.0.0:9000".parse().unwrap()),
            http_public: true
        }
    );
    let sensor = &config.sensors[0];
    assert_eq!(sensor.source_port, Some(2368));
    let (bind, multicast) = ([127, 0, 0, 1].into(), Some([239, 1, 1, 1].into()));
    let (interface, cpu, realtime_priority) = (Some("lo".to_owned()), Some(0), Some(50));
    assert_eq!(
        sensor.port,
        PortConfig {
            bind,
            port: 2370,
            multicast,
            interface,
            cpu,
            realtime_priority
        }
    );
    assert_eq!((sensor.position_port, sensor.max_consumers), (8309, 2));
    assert_eq!(sensor.dual, Some(true));
    assert_eq!(
        sensor.want.to_string(),
        "laser on, returns dual, rpm 600, fov 270-90, phase-lock 180, host 192.168.1.100"
    );
    assert_eq!(
        sensor.losses,
        Limits {
            warning: 0.015,
            fault: 0.12
        }
    );
    let pipeline = &sensor.pipeline;
    assert_eq!(pipeline.model, Some(Model::Vlp16));
    assert_eq!(pipeline.calibration.as_ref(), Model::Vlp16.calibration());
    assert_eq!(pipeline.return_choice, ReturnChoice::Last);
    let half = std::f64::consts::PI;
    assert_eq!(
        (pipeline.cut_azimuth_rad, pipeline.yaw_rad),
        (half, half as f32)
    );
    assert_eq!(pipeline.position_m, [1.0, 2.5, -3.0]);
    let segment = &pipeline.segment;
    assert_eq!((segment.method, segment.min_points), (Method::Paper, 3));
    assert_eq!(
        (segment.theta_rad, segment.min_range_m, segment.max_range_m),
        ((half / 4.0) as f32, 0.5, 80.0)
    );
    let quarter = (half / 2.0) as f32;
    let mount = segment.mount;
    assert_eq!(
        (mount.height_m, mount.pitch_rad, mount.roll_rad),
        (Some(1.5), -quarter, quarter)
    );
    let (rotate_bytes, rotate_seconds) = (Some(1_500_000), Some(600));
    assert_eq!(
        config.record,
        Some(RecordConfig {
            path: "/data/drive.pcap.gz".into(),
            rotate_bytes,
            rotate_seconds
        })
    );
}

/// One line that cannot be meant, the words that say so, and (of several lines) which one is to
/// blame.
#[test]
fn what_cannot_be_meant_is_shown_with_its_line_and_a_cure() {
    for (line, parts) in [
        (
            "prot = 2369",
            &["unknown key `prot`", "did you mean `port`?"][..],
        ),
        (
            "segment = { theta = 12 }",
            &["unknown key `theta`", "did you mean `theta_deg`?"],
        ),
        (
            "port = \"2369\"",
            &["wrong type: string \"2369\"", "expected a whole number"],
        ),
        ("port = 0", &["`port` cannot be 0", "expected 1 to 65535"]),
        (
            "port = 23.5",
            &["wrong type: floating point", "expected a whole number"],
        ),
        ("port = 99999999999999999999", &["4:8"]),
        (
            "position_port = 70000",
            &["`position_port` cannot be 70000"],
        ),
        (
            "bind = \"eth0\"",
            &["`bind` cannot be \"eth0\"", "0.0.0.0 for all"],
        ),
        ("bind = \"::1\"", &["`bind` cannot be \"::1\""]),
        (
            "multicast = \"192.168.1.1\"",
            &["224.0.0.0 to 239.255.255.255"],
        ),
        ("interface = \"\"", &["such as eth1"]),
        ("interface = \"a-name-far-too-long\"", &["such as eth1"]),
        ("cpu = -1", &["`cpu` cannot be -1"]),
        ("cpu = 99999", &["the cores of this machine are "]),
        ("realtime_priority = 100", &["expected 1 to 99"]),
        (
            "model = \"vlp61\"",
            &[
                "no supported model is called \"vlp61\"",
                "did you mean `vlp16`?",
            ],
        ),
        ("model = \"os1\"", &["expected one of `vlp16`"]),
        (
            "returns = \"duel\"",
            &["unknown value `duel`", "did you mean `dual`?"],
        ),
        (
            "return = \"first\"",
            &["unknown value `first`", "expected one of `nearest`"],
        ),
        (
            "model = \"hdl64e-s2\"\nreturns = \"dual\"",
            &["5:11", "an HDL-64E S2 sends one return", "hdl64e-s3"],
        ),
        (
            "cut_azimuth_deg = nan",
            &["`cut_azimuth_deg` cannot be NaN", "-360 to 360 degrees"],
        ),
        (
            "want.rpm = 299",
            &["`rpm` cannot be 299", "expected 300 to 1200"],
        ),
        (
            "want.rpm = 610",
            &["`rpm` cannot be 610", "expected a multiple of 60"],
        ),
        (
            "want.returns = \"both\"",
            &["expected strongest, last or dual"],
        ),
        (
            "want.fov = \"0-360\"",
            &["`fov` cannot be \"0-360\"", "0 to 359"],
        ),
        ("want.laser = true", &["wrong type", "expected a string"]),
        (
            "want.host = \"127.0.0.1\"",
            &["that the sensor can send to"],
        ),
        ("want.phase_lock = \"on\"", &["expected off, or an azimuth"]),
        (
            "want.rmp = 600",
            &["unknown key `rmp`", "did you mean `rpm`?"],
        ),
        (
            "model = \"hdl64e-s3\"\nwant.laser = \"on\"",
            &[
                "`laser` of an HDL-64E cannot be read",
                "it has no web interface",
            ],
        ),
        ("loss_warning_percent = 0", &["expected 0.1 to 100 percent"]),
        (
            "loss_fault_percent = 5\nloss_warning_percent = 6",
            &[
                "5:24",
                "`loss_warning_percent` cannot be 6",
                "at most `loss_fault_percent`, which is 5",
            ],
        ),
        ("max_consumers = 17", &["expected 1 to 16"]),
        ("max_consumers = 0", &["expected 1 to 16"]),
        ("objects_every_ms = 0", &["expected 1 to 100"]),
        ("max_object_deg = 4.9", &["expected 5 to 360 degrees"]),
        (
            "mount = { x_m = 1e9 }",
            &["`x_m` cannot be 1000000000", "metres"],
        ),
        ("mount = { pitch_deg = 91 }", &["-90 to 90 degrees"]),
        ("mount = { height_m = 0 }", &["`height_m` cannot be 0"]),
        (
            "segment = { theta_deg = 0 }",
            &["4:25", "more than 0 and less than 90"],
        ),
        (
            "segment = { theta_deg = 91 }",
            &["expected 0 to 90 degrees"],
        ),
        (
            "segment = { min_points = 0 }",
            &["`min_points` cannot be 0"],
        ),
        (
            "segment = { min_range_m = 5, max_range_m = 4 }",
            &["4:44", "limited to 5..4 m"],
        ),
        (
            "segment = { method = \"slop\" }",
            &["did you mean `slope`?"],
        ),
        (
            "segment = { mask = \"body.png\" }",
            &["cannot read /nowhere/body.png"],
        ),
        ("segment = { mask = \"\" }", &["expected a path"]),
        (
            "segment = { mask = { image = \"body.png\", remove = true } }",
            &["4:30", "cannot read /nowhere/body.png"],
        ),
        (
            "segment = { mask = { remove = true } }",
            &["4:20", "missing key `image`"],
        ),
        (
            "segment = { remove_out_of_range = true }",
            &["removes nothing", "`min_range_m` or `max_range_m`"],
        ),
        (
            "segment = { remove_boxes = [1, 2, 3, 4, 5, 6] }",
            &["wrong type", "each a list of six numbers"],
        ),
        (
            "segment = { remove_boxes = [[1, 2, 3, 4, 5]] }",
            &["wrong type", "each a list of six numbers"],
        ),
        (
            "segment = { remove_boxes = [[0, 0, 0, 1, 1, 1], [0, 0, 0, 1, 0, 1]] }",
            &["cannot be [0.0, 0.0, 0.0, 1.0, 0.0, 1.0]", "opposite one"],
        ),
        (
            "segment = { remove_boxes = [[0, 0, 0, 1, inf, 1]] }",
            &["within 100 of the origin"],
        ),
        (
            "calibration = \"unit.xml\"",
            &["cannot read the calibration /nowhere/unit.xml"],
        ),
        ("[sensor.mount\nx_m = 1", &["unclosed table"]),
        ("name = \"roof\"", &["duplicate key"]),
        (
            "[record]\npath = \"drive.txt\"",
            &["5:8", "NAME.pcap or NAME.pcap.gz"],
        ),
        (
            "[record]\npath = \".pcap\"",
            &["5:8", "NAME.pcap or NAME.pcap.gz"],
        ),
        (
            "[record]\npath = \"a.pcap\"\nrotate_mb = 0",
            &["6:13", "expected 1 to 1000000 MB"],
        ),
        ("[record]\nrotate_mb = 10", &["4:1", "missing key `path`"]),
    ] {
        let (lines, message) = bad(&roof(line));
        assert!(lines.len() == 1 && lines[0] >= 4, "{line}: {lines:?}");
        assert!(message.contains("--> /nowhere/robot.toml:"), "{message}");
        for part in parts {
            assert!(message.contains(part), "{line} lacks {part:?}:\n{message}");
        }
    }
}

#[test]
fn names_and_addresses_that_cannot_be_are_refused() {
    let longest = "a".repeat(63);
    for name in ["roof", "Front-left_2.b", "2", &longest] {
        assert_eq!(good(&roof("").replace("roof", name)).sensors[0].name, name);
    }
    for name in [
        "",
        "ro of",
        "roof/left",
        "..",
        "-roof",
        "dach\u{fc}",
        "a\\u0000",
        &format!("{longest}a"),
    ] {
        let (lines, message) = bad(&roof("").replace("roof", name));
        assert!(
            lines == [2] && message.contains("a letter or digit first"),
            "{message}"
        );
    }
    for address in [
        "0.0.0.0",
        "239.1.1.1",
        "255.255.255.255",
        "fe80::1",
        "roof.local",
        "10.0.0.1:0",
        "10.0.0.1>2368",
        "",
    ] {
        let (lines, message) = bad(&roof("").replace("192.168.1.201", address));
        assert!(
            lines == [3] && message.contains("expected the sensor's own IPv4 address"),
            "{message}"
        );
    }
}

#[test]
fn health_is_for_this_host_alone_unless_it_is_said() {
    let of = |http: &str| format!("{http}\n{}", roof(""));
    assert_eq!(good(&of("http = \"off\"")).daemon.http, None);
    assert_eq!(
        good(&of("http = \"[::1]:80\"")).daemon.http,
        Some("[::1]:80".parse().unwrap())
    );
    for open in [
        "0.0.0.0:80",
        "[::]:80",
        "192.168.1.100:80",
        "[::ffff:10.0.0.1]:80",
    ] {
        let (lines, message) = bad(&of(&format!("http = {open:?}")));
        assert!(
            lines == [1] && message.contains("http_public = true"),
            "{message}"
        );
        good(&of(&format!("http = {open:?}\nhttp_public = true")));
    }
    for none in ["on", "127.0.0.1", "127.0.0.1:0", "9177", ""] {
        assert!(
            bad(&of(&format!("http = {none:?}")))
                .1
                .contains("or \"off\"")
        );
    }
}

#[test]
fn all_that_is_wrong_is_said_at_once_in_the_order_of_the_lines() {
    let text = format!(
        "{}[record]\npath = \"x\"\n",
        roof("port = 0\nwant.rpm = 1\n[[sensor]]\nname = \"roof\"\naddress = \"x\"\n")
    );
    let (lines, message) = bad(&format!("http = \"x\"\n{text}"));
    assert_eq!(lines, [1, 5, 6, 8, 9, 11], "{message}");
    assert_eq!(message.matches("error: ").count(), 6);
    assert_eq!(bad("").0, [1]);
    assert!(bad("# nothing\n").1.contains("sweepd config example"));
    assert!(
        bad("[sensor]\nname = \"roof\"")
            .1
            .contains("one [[sensor]], in double brackets")
    );
    assert!(
        bad("[[sensor]]\nname = \"roof\"")
            .1
            .contains("missing key `address`")
    );
}

/// Ten slips of four kinds (unknown keys, wrong types, missing keys, values) and two that follow
/// from others, which are none.
#[test]
fn keys_types_and_values_are_all_shown_at_once() {
    let text = "colour = 1\nhttp = 9177\n[[sensor]]\nname = 7\naddress = \"10.0.0.1\"\nprot = 1\nport = \"a\"\nwant.rpm = 1\n\
                [sensor.segment]\ntheta = 1\nmin_points = 0\n[[sensor]]\nname = \"b\"\n[[sensor]]\naddress = \"x\"\n\
                returns = \"triple\"\n";
    let (lines, message) = bad(text);
    assert_eq!(
        lines,
        [1, 2, 4, 6, 7, 8, 10, 11, 12, 14, 15, 16],
        "{message}"
    );
    for part in [
        "unknown key `colour`",
        "wrong type: integer `9177`",
        "wrong type: integer `7`",
        "did you mean `port`?",
        "expected a whole number",
        "expected 300 to 1200",
        "did you mean `theta_deg`?",
        "`min_points` cannot be 0",
        "missing key `address`",
        "missing key `name`",
        "`address` cannot be \"x\"",
        "unknown value `triple`",
    ] {
        assert!(message.contains(part), "no {part:?} in\n{message}");
    }
    let (_, message) = bad("[segment]\nmin_points = 3\n");
    assert!(
        message.contains("help: write `[sensor.segment]`, below the [[sensor]]"),
        "{message}"
    );
    let (lines, message) = bad("[[sensor]]\nport = \n");
    assert!(
        lines == [2] && message.contains("a value is missing"),
        "{message}"
    );
    // Hundreds end soon, and say so of as many as are read.
    let many: String = (0..500).map(|number| format!("k{number} = 1\n")).collect();
    assert_eq!(bad(&(many + &roof(""))).0.len(), 64);
}

/// Three sensors: two on a port, another beside them.
fn three(roof: &str, left: &str, right: &str) -> String {
    format!(
        "[[sensor]]\nname = \"roof\"\naddress = \"10.0.0.1\"\n{roof}\n[[sensor]]\nname = \"left\"\naddress = \"10.0.0.2\"\n{left}\n\
         [[sensor]]\nname = \"right\"\naddress = \"10.0.0.3\"\nport = 2369\n{right}\n"
    )
}

#[test]
fn sensors_on_a_port_agree_about_it() {
    let config = good(&three(
        "",
        "cpu = 0\nbind = \"127.0.0.1\"",
        "bind = \"127.0.0.2\"",
    ));
    assert_eq!(
        config.sensors[0].port, config.sensors[1].port,
        "what one says holds for both"
    );
    assert_eq!(
        (config.sensors[0].port.cpu, config.sensors[2].port.cpu),
        (Some(0), None)
    );
    for (key, one, other) in [
        ("bind", "\"127.0.0.1\"", "\"127.0.0.2\""),
        ("multicast", "\"239.0.0.1\"", "\"239.0.0.2\""),
        ("interface", "\"lo\"", "\"eth1\""),
        ("realtime_priority", "1", "2"),
    ] {
        let (one, other) = (format!("{key} = {one}"), format!("{key} = {other}"));
        good(&three(&one, &one, &other));
        let (lines, message) = bad(&three(&one, &other, ""));
        assert!(
            lines == [8] && message.contains(&format!("do not agree about `{key}`")),
            "{message}"
        );
        assert!(message.contains("`roof` says this"), "{message}");
    }
}

#[test]
fn sensors_that_cannot_be_told_apart_are_refused() {
    let of = |left: &str, right: &str, port: u16| {
        format!(
            "[[sensor]]\nname = \"a\"\naddress = \"{left}\"\n[[sensor]]\nname = \"b\"\naddress = \"{right}\"\nport = {port}\n"
        )
    };
    good(&of("10.0.0.1", "10.0.0.1", 2369));
    good(&of("10.0.0.1:2368", "10.0.0.1:2369", 2368));
    for (left, right) in [
        ("10.0.0.1", "10.0.0.1"),
        ("10.0.0.1:1", "10.0.0.1:1"),
        ("10.0.0.1", "10.0.0.1:1"),
    ] {
        let (lines, message) = bad(&of(left, right, 2368));
        assert!(
            lines == [6] && message.contains("`b` cannot be told from `a`"),
            "{message}"
        );
    }
    let (lines, message) = bad(&of("10.0.0.1", "10.0.0.2", 2368).replace("\"b\"", "\"a\""));
    assert!(
        lines == [5] && message.contains("the first of this name"),
        "{message}"
    );
    // The position packets of one may come where the data of another do.
    good(&of("10.0.0.1", "10.0.0.2", 8308));
}

#[test]
fn files_of_another_model_are_refused() {
    let folder = std::env::temp_dir().join(format!("sweepd-config-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    let mut bytes = Vec::new();
    let mut encoder = png::Encoder::new(&mut bytes, 4, 32);
    encoder.set_color(png::ColorType::Grayscale);
    encoder
        .write_header()
        .unwrap()
        .write_image_data(&[255; 4 * 32])
        .unwrap();
    std::fs::write(folder.join("32.png"), bytes).unwrap();
    std::fs::copy(
        concat!(env!("CARGO_MANIFEST_DIR"), "/calib/hdl32e.yaml"),
        folder.join("32.yaml"),
    )
    .unwrap();
    let parse = |more: &str| {
        Config::parse(&folder.join("robot.toml"), &roof(more)).map_err(|error| error.to_string())
    };
    let mask = "[sensor.segment]\nmask = \"32.png\"";
    let calibration = "calibration = \"32.yaml\"";
    for fitting in [
        mask,
        calibration,
        &format!("model = \"hdl32e\"\n{calibration}\n{mask}"),
    ] {
        let config = parse(fitting).unwrap_or_else(|error| panic!("{error}"));
        let pipeline = &config.sensors[0].pipeline;
        assert_eq!(pipeline.segment.mask.is_some(), fitting.contains("mask"));
        assert_eq!(
            pipeline.calibration.is_some(),
            fitting.contains("calibration")
        );
    }
    let removing = mask.replace("\"32.png\"", "{ image = \"32.png\", remove = true }");
    let [old, new] = [mask, &removing].map(|text| parse(text).unwrap());
    let pipeline = &old.reloaded(&new).sensors[0].pipeline;
    assert!(pipeline.segment.mask.is_some() && pipeline.removal.masked);
    assert_eq!(
        old.changes(&new)[0].to_string(),
        "sensor roof: removal by the mask false -> true"
    );
    for (wrong, said) in [
        ("remov = true", "did you mean `remove`?"),
        ("remove = 1", "expected a boolean"),
    ] {
        let message = parse(&removing.replace("remove = true", wrong)).unwrap_err();
        assert!(message.contains(said), "{message}");
    }
    let message = parse(&format!("model = \"vlp16\"\n{mask}")).unwrap_err();
    assert!(
        message.contains("32.png has 32 rows, not the VLP-16")
            && message.contains("robot.toml:6:8"),
        "{message}"
    );
    let message = parse(&format!("model = \"vlp16\"\n{calibration}")).unwrap_err();
    assert!(
        message.contains("this is the calibration of the HDL-32E")
            && message.contains("robot.toml:5:15"),
        "{message}"
    );
    std::fs::remove_dir_all(&folder).unwrap();
}

#[test]
fn a_reload_says_what_it_takes_over_and_what_waits() {
    let old = good(&three("", "", ""));
    let said = |new: &str| -> Vec<String> {
        old.changes(&good(new))
            .iter()
            .map(ToString::to_string)
            .collect()
    };
    assert!(said(&three("", "", "")).is_empty());
    assert_eq!(
        said(&three("port = 2370", "", "")),
        ["sensor roof: port 2368 -> 2370 needs a restart"]
    );
    assert_eq!(
        said(&three("segment = { theta_deg = 12.5 }", "", "")),
        ["sensor roof: theta_deg 10 -> 12.5"]
    );
    assert_eq!(
        said(&three(
            "segment = { theta_deg = 12.5, min_points = 5 }",
            "want.rpm = 600",
            ""
        )),
        [
            "sensor roof: theta_deg 10 -> 12.5",
            "sensor roof: min_points 10 -> 5",
            "sensor left: want none -> rpm 600"
        ]
    );
    assert_eq!(
        said(&three(
            "segment = { remove_boxes = [[1, 0.5, -2, 0, 0, 0]], remove_out_of_range = true, max_range_m = 9 }",
            "",
            ""
        )),
        [
            "sensor roof: remove_out_of_range false -> true",
            "sensor roof: remove_boxes none -> 0,0,-2,1,0.5,0",
            "sensor roof: max_range_m no limit -> 9"
        ]
    );
    assert_eq!(
        said(&three(
            "port = 2370\nmax_consumers = 3\nwant.rpm = 600",
            "",
            ""
        )),
        [
            "sensor roof: port 2368 -> 2370 needs a restart",
            "sensor roof: max_consumers 4 -> 3 needs a restart",
            "sensor roof: want none -> rpm 600",
        ]
    );
    assert_eq!(
        said(&format!("http = \"off\"\n{}", three("", "", ""))),
        ["http 127.0.0.1:9177 -> off needs a restart"]
    );
    assert_eq!(
        said(&three("", "", "[record]\npath = \"/a.pcap\"")),
        ["record off -> /a.pcap"]
    );
    assert_eq!(
        said(&three("", "", "").replace("left", "back")),
        [
            "sensor left: is no longer there, which needs a restart",
            "sensor back: is new, which needs a restart"
        ]
    );
}

/// Each line changes a setting of its own: none of them is overlooked, and a reload does what it
/// says.
#[test]
fn no_setting_changes_without_a_word() {
    let settings = [
        "port = 2371",
        "position_port = 8310",
        "bind = \"127.0.0.1\"",
        "multicast = \"239.0.0.1\"",
        "interface = \"lo\"",
        "cpu = 0",
        "realtime_priority = 1",
        "model = \"hdl32e\"",
        "calibration = \"vlp16.yaml\"",
        "returns = \"dual\"",
        "return = \"strongest\"",
        "cut_azimuth_deg = 1",
        "want = { rpm = 1200 }",
        "want = { fov = \"270-90\" }",
        "gps_without_pps = true",
        "loss_warning_percent = 5",
        "loss_fault_percent = 50",
        "eye_turns = 20",
        "eye_near_m = 0.5",
        "eye_least_percent = 5",
        "max_consumers = 5",
        "objects_every_ms = 10",
        "max_object_deg = 90",
        "mount = { x_m = 1 }",
        "mount = { yaw_deg = 1 }",
        "mount = { pitch_deg = 1 }",
        "mount = { roll_deg = 1 }",
        "mount = { height_m = 1 }",
        "mount = { climb_m = 0.1 }",
        "segment = { method = \"paper\" }",
        "segment = { theta_deg = 11 }",
        "segment = { min_points = 11 }",
        "segment = { min_range_m = 1 }",
        "segment = { max_range_m = 1 }",
        "segment = { remove_boxes = [[0, 0, 0, 1, 1, 1]] }",
    ];
    let parse = |more: &str| {
        let path = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/calib/robot.toml"));
        Config::parse(path, &roof(more)).unwrap_or_else(|error| panic!("{error}"))
    };
    let old = parse("");
    for line in settings {
        let new = parse(line);
        let [change] = &old.changes(&new)[..] else {
            panic!("{line}: {:?}", old.changes(&new))
        };
        let (back, running) = (new.changes(&old), old.reloaded(&new));
        assert_eq!((back.len(), back[0].effect), (1, change.effect), "{line}");
        let left = running.changes(&new).len();
        assert_eq!(
            left,
            usize::from(change.effect == Effect::Restart),
            "{line}"
        );
        assert_eq!(old.changes(&running).len(), 1 - left, "{line}");
    }
    // A calibration is that of the new model, so it waits with it; the rest does not.
    let other = parse("model = \"hdl32e\"\ncalibration = \"hdl32e.yaml\"\nwant.rpm = 600");
    let waits: Vec<bool> = old
        .changes(&other)
        .iter()
        .map(|change| change.effect == Effect::Restart)
        .collect();
    let running = old.reloaded(&other);
    assert_eq!(
        (waits, running.changes(&other).len()),
        (vec![true, true, false], 2)
    );
    assert_eq!(
        (
            running.sensors[0].want.to_string().as_str(),
            &running.sensors[0].pipeline.calibration
        ),
        ("rpm 600", &None)
    );
    // A setting that is added to the configuration must be added to those that are compared: this
    // stops compiling.
    let SensorConfig {
        name: _,
        address: _,
        source_port: _,
        port: _,
        position_port: _,
        max_consumers: _,
        objects_every_ns: _,
        dual: _,
        want: _,
        losses: _,
        pipeline,
    } = old.sensors[0].clone();
    let pipeline::Config {
        model: _,
        calibration: _,
        cut_azimuth_rad: _,
        return_choice: _,
        segment: _,
        eye: _,
        removal: _,
        gps_without_pps: _,
        position_m: _,
        yaw_rad: _,
    } = pipeline;
}

#[test]
fn memory_follows_from_the_model() {
    let of = |more: &str| good(&roof(more)).sensors.remove(0);
    let exact = of("model = \"vlp16\"\nreturns = \"single\"\nmax_consumers = 1");
    let sweep = sweepd_core::sweep::layout::Shape::of(16, false, 10).total_bytes();
    assert_eq!(
        (crate::publish::pool_sweeps(1), memory::sweep_bytes(&exact)),
        (7, sweep..=sweep)
    );
    assert_eq!(
        memory::pool_bytes(&exact),
        7 * sweep as u64..=7 * sweep as u64
    );
    let unknown = memory::sweep_bytes(&of(""));
    assert_eq!(
        unknown,
        sweep..=*memory::sweep_bytes(&of("model = \"vls128\"\nreturns = \"dual\"")).end()
    );
    let s2 = memory::sweep_bytes(&of("model = \"hdl64e-s2\""));
    assert_eq!(s2.start(), s2.end(), "one return, always");
}

/// Whether a text is a configuration, or an error that names a line of it; a panic is neither.
fn is_answered(text: &str) -> Result<(), TestCaseError> {
    if let Err(error) = parse(text) {
        let ConfigError::Invalid(problems) = &error else {
            return Err(TestCaseError::fail("no file is read"));
        };
        let lines = text.split('\n').count();
        prop_assert!(!problems.is_empty());
        prop_assert!(
            problems
                .lines()
                .iter()
                .all(|line| (1..=lines).contains(line)),
            "{error}"
        );
        prop_assert_eq!(
            error
                .to_string()
                .matches("--> /nowhere/robot.toml:")
                .count(),
            problems.len(),
            "{}",
            error
        );
    }
    Ok(())
}

/// The example with its optional lines switched on, as it may be edited.
fn example_switched_on() -> String {
    let on = |line: &str| match line.strip_prefix('#') {
        Some(rest) if rest.starts_with(|c: char| c.is_ascii_lowercase() || c == '[') => {
            rest.to_owned()
        }
        _ => line.to_owned(),
    };
    EXAMPLE.lines().map(|line| on(line) + "\n").collect()
}

#[test]
fn the_example_that_systemd_ships_and_its_page_are_what_the_rows_say() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let page = format!("{PAGE_HEAD}\n```toml\n{}```\n", example());
    for (file, text) in [
        ("systemd/sweepd.toml", example()),
        ("docs/configuration.md", page),
    ] {
        let path = root.join(file);
        if std::env::var_os("SWEEPD_WRITE_PAGES").is_some() {
            std::fs::write(&path, &text).unwrap();
        }
        assert_eq!(
            std::fs::read_to_string(path).unwrap_or_default(),
            text,
            "{file}: SWEEPD_WRITE_PAGES=1 cargo test -p sweepd --lib systemd_ships writes it"
        );
    }
}

#[test]
fn the_example_names_every_key_with_a_value_that_can_be() {
    good(EXAMPLE);
    for setting in SETTINGS {
        if let Some(default) = setting.get(&sweepd_core::segment::Config::default()) {
            let line = format!("#{} = {default}", setting.key);
            assert!(EXAMPLE.lines().any(|one| one == line), "no `{line}`");
        }
    }
    let all = example_switched_on();
    // Two name files that are not there, and the example of a core may be one that this machine has
    // not.
    let all = all
        .replace("calibration = ", "#")
        .replace("mask = ", "#")
        .replace("cpu = 1", "cpu = 0");
    good(&all);
    let (_, message) = bad(&roof("x = 1"));
    let (_, mount) = bad(&roof("mount = { x = 1 }"));
    let (_, segment) = bad(&roof("segment = { x = 1 }"));
    let (_, record) = bad(&roof("[record]\nx = 1"));
    let (_, daemon) = bad("x = 1");
    let mut keys = 0;
    for key in [message, mount, segment, record, daemon]
        .iter()
        .flat_map(|text| text.split('`').skip(3).step_by(2))
    {
        let is_there = |line: &str| {
            line.starts_with(key)
                || line.contains(&format!("[{key}"))
                || line.contains(&format!(".{key}]"))
        };
        assert!(
            EXAMPLE
                .lines()
                .any(|line| is_there(line.trim_start_matches('#'))),
            "no {key} in the example"
        );
        keys += 1;
    }
    assert!(keys > 30, "{keys}");
}

proptest! {
    #[test]
    fn any_text_is_answered(text in "(\\PC|[\\n\\r\\t\\[\\]=\"#.,{}]){0,200}") {
        is_answered(&text)?;
    }

    #[test]
    fn any_edit_of_the_example_is_answered(
        edits in prop::collection::vec((any::<prop::sample::Index>(), 0..12_usize, "(\\PC|[\\n\\[\\]=\"#0-9-]){0,6}"), 1..4),
    ) {
        let mut text: Vec<char> = example_switched_on().chars().collect();
        for (at, removed, added) in edits {
            let at = at.index(text.len());
            let end = (at + removed).min(text.len());
            text.splice(at..end, added.chars());
        }
        is_answered(&text.into_iter().collect::<String>())?;
    }

    #[test]
    fn any_value_of_a_key_is_answered(
        line in any::<prop::sample::Index>(),
        value in prop_oneof![
            any::<i64>().prop_map(|value| value.to_string()),
            any::<f64>().prop_map(|value| format!("{value:e}")),
            "\\PC{0,80}".prop_map(|value| format!("{value:?}")),
            Just("[]".to_owned()), Just("{}".to_owned()), Just("true".to_owned()), Just("1979-05-27".to_owned()),
        ],
    ) {
        let text = example_switched_on();
        let keys: Vec<&str> = text.lines().filter(|line| line.contains(" = ") && !line.starts_with('#')).collect();
        let line = keys[line.index(keys.len())];
        let (key, _) = line.split_once(" = ").unwrap();
        is_answered(&text.replace(line, &format!("{key} = {value}")))?;
    }
}

/// A key that no reload compares would change without a word.
#[test]
fn a_reload_compares_every_key() {
    let mut without = Vec::new();
    for key in SENSOR_TABLES.iter().flat_map(|table| table.keys) {
        if key.rules.is_empty() && !matches!(key.form, Form::Segmenter) {
            without.push(key.name);
        }
    }
    for key in DAEMON.keys.iter().filter(|key| key.rules.is_empty()) {
        without.push(key.name);
    }
    // The name says which sensors are the same. What a sensor is to be set to has one rule, that of
    // `rpm`, and its position one, that of `x_m`.
    let of_rpm = ["returns", "fov", "laser", "host", "phase_lock"];
    assert_eq!(without, [&["name"][..], &of_rpm, &["y_m", "z_m"]].concat());
}
