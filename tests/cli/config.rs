//! `sweepd config`: what a configuration comes to, and what is wrong with one.

use serde_json::{Value, json};

use super::{Folder, Ran, command, sweepd};

const TWO: &str = r#"
http = "off"
[[sensor]]
name = "roof"
address = "192.168.1.201"
model = "hdl64e-s3"
returns = "dual"
max_consumers = 2
segment = { max_range_m = 80 }
[[sensor]]
name = "rear"
address = "192.168.1.202:2368"
port = 2369
model = "vlp16"
returns = "single"
cut_azimuth_deg = 90
mount = { z_m = 1.5, pitch_deg = -3, height_m = 1.2, climb_m = 0.05 }
[record]
path = "drive.pcap"
rotate_mb = 500
"#;

#[test]
fn check_warns_of_a_sensor_on_its_side() {
    let folder = Folder::new("config-side");
    let file = folder.write(
        "robot.toml",
        TWO.replace("pitch_deg = -3", "roll_deg = -90"),
    );
    let told = sweepd(&["config", "check", file.to_str().unwrap()]);
    assert_eq!(told.code, 0, "{}", told.stderr);
    let warning = "warning: rear: roll -90.0 and pitch 0.0 degrees tilt the sensor by more than 45";
    assert!(told.stderr.starts_with(warning), "{}", told.stderr);
}

#[test]
fn check_says_what_will_run_and_what_memory_it_takes() {
    let folder = Folder::new("config-check");
    let file = folder.write("robot.toml", TWO);
    let told = sweepd(&["config", "check", file.to_str().unwrap()]).done();
    let recording = format!(
        "recording      {}, numbered, another file each start, each 500 MB",
        folder.path("drive.pcap").display()
    );
    for line in [
        "robot.toml: 2 sensors",
        "packets        from 192.168.1.201 to port 2368",
        "positions      from 192.168.1.201 to port 8308",
        "packets        from 192.168.1.202:2368 to port 2369",
        "model          HDL-64E S3; calibration told by its packets; two returns, nearest segmented",
        "model          VLP-16; calibration of the model; one return, nearest segmented",
        "cut            at 90 degrees",
        "mount          x 0, y 0, z 1.5 m; roll 0, pitch -3, yaw 0 degrees; 1.2 m above ground; climbs 0.05 m",
        "segments       method slope, 10 points at least, 0 to 80 m",
        "service        sweepd/rear/sweep, 4 consumers at most",
        "settings       model = \"hdl64e-s3\"\n                 returns = \"dual\"\n                 max_consumers = 2\n                 \
         segment.max_range_m = 80\n",
        "settings       port = 2369\n",
        "                 cut_azimuth_deg = 90\n                 mount.z_m = 1.5\n                 mount.height_m = 1.2\n                 \
         mount.pitch_deg = -3\n                 mount.climb_m = 0.05\n",
        "health         off",
        &recording,
    ] {
        assert!(told.contains(line), "{told}\nlacks {line}");
    }
    // Two consumers hold and await two sweeps each, one is history, two are being filled: 11. Of
    // four, 19.
    let pools: Vec<(f64, f64)> = told.lines().filter_map(pool).collect();
    let [(roof, of_roof), (rear, of_rear)] = pools[..] else {
        panic!("{told}")
    };
    assert!(
        (roof - 11.0 * of_roof).abs() < 1.0 && (rear - 19.0 * of_rear).abs() < 1.0,
        "{pools:?}"
    );
    // A pixel of two returns takes 19 bytes, of one 9; beside them a column takes 24, and a tenth
    // of the pixels may be segments of 64 bytes.
    let expected =
        |rows: f64, bytes: f64| 5632.0 * (rows * (bytes + 6.4) + 24.0) / f64::from(1 << 20);
    assert!(
        (of_roof - expected(64.0, 19.0)).abs() < 0.1 && (of_rear - expected(16.0, 9.0)).abs() < 0.1,
        "{pools:?}"
    );
    // Where somebody listens for objects, 8 KiB for each of 66 messages a consumer, and for three.
    let objects = f64::from(2 * 66 + 3 + 4 * 66 + 3) / 128.0;
    let least = roof + rear;
    let both = format!("shared memory  {least:.1} MiB to ");
    let (_, most) = told.split_once(&both).expect(&told);
    let (most, rest) = most.split_once(" MiB; ").expect(&told);
    let most: f64 = most.parse().unwrap();
    assert!((most - least - objects).abs() < 0.15, "{told}");
    assert!(rest.contains(" free in /dev/shm"), "{told}");
}

#[test]
fn check_says_the_same_to_programs() {
    let folder = Folder::new("config-json");
    let file = folder.write("robot.toml", TWO);
    let told = sweepd(&["config", "check", "--json", file.to_str().unwrap()]).done();
    let told: Value = serde_json::from_str(&told).unwrap();
    let [roof, rear] = &told["sensors"].as_array().unwrap()[..] else {
        panic!("{told}")
    };
    assert_eq!(
        (
            &told["http"],
            &told["warnings"],
            &told["record"]["rotate_mb"]
        ),
        (&Value::Null, &json!([]), &json!(500.0))
    );
    assert_eq!(
        roof["settings"],
        json!({"model": "hdl64e-s3", "returns": "dual", "max_consumers": 2, "segment.max_range_m": 80})
    );
    for (key, value) in [
        ("name", json!("rear")),
        ("address", json!("192.168.1.202:2368")),
        ("port", json!(2369)),
        ("position_port", json!(8308)),
        ("model", json!("VLP-16")),
        ("returns", json!("single")),
        ("cut_azimuth_deg", json!(90.0)),
        ("service", json!("sweepd/rear/sweep")),
        (
            "mount",
            json!({"x_m": 0.0, "y_m": 0.0, "z_m": 1.5, "roll_deg": 0.0, "pitch_deg": -3.0, "yaw_deg": 0.0, "height_m": 1.2, "climb_m": 0.05}),
        ),
    ] {
        assert_eq!(rear[key], value, "{key}");
    }
    // 19 sweeps of a VLP-16, as in the text.
    let bytes = 19.0 * 5632.0 * (16.0 * (9.0 + 6.4) + 24.0);
    let pool = rear["shared_memory_bytes"][1].as_f64().unwrap();
    assert!((pool / bytes - 1.0).abs() < 0.1, "{rear}");

    let file = folder.write("robot.toml", TWO.replace("port = 2369", "port = 0"));
    let ran = sweepd(&["config", "check", "--json", file.to_str().unwrap()]);
    assert_eq!(ran.code, 78);
    let told: Value = serde_json::from_str(&ran.stdout).unwrap();
    assert_eq!(
        told["problems"],
        json!([{"line": 13, "column": 8, "what": "`port` cannot be 0", "expected": "expected 1 to 65535", "cure": null}])
    );
}

#[test]
fn programs_get_methods_and_ports_as_the_file_has_them() {
    let folder = Folder::new("config-settings");
    let mut file = String::new();
    for (number, settings) in [
        "bind = \"127.0.0.1\"\nsegment = { method = \"slope\" }",
        "multicast = \"239.1.1.1\"\ninterface = \"lo\"\nsegment = { method = \"paper\", theta_deg = 12.5 }",
    ]
    .iter()
    .enumerate()
    {
        file += &format!(
            "[[sensor]]\nname = \"s{number}\"\naddress = \"10.0.0.1\"\nport = {}\n{settings}\n",
            3000 + number
        );
    }
    let file = folder.write("robot.toml", file);
    let told = sweepd(&["config", "check", "--json", file.to_str().unwrap()]).done();
    let told: Value = serde_json::from_str(&told).unwrap();
    assert_eq!(
        told["sensors"][0]["settings"],
        json!({"port": 3000, "bind": "127.0.0.1"})
    );
    assert_eq!(
        told["sensors"][1]["settings"],
        json!({"port": 3001, "multicast": "239.1.1.1", "interface": "lo", "segment.method": "paper", "segment.theta_deg": 12.5})
    );
}

/// Of a line such as `shared memory 97.9 MiB: 11 sweeps of 8.9 MiB`, the first and the last number.
fn pool(line: &str) -> Option<(f64, f64)> {
    let (pool, sweep) = line
        .trim()
        .strip_prefix("shared memory")?
        .split_once(" sweeps of ")?;
    Some((
        pool.split_whitespace().next()?.parse().ok()?,
        sweep.split_whitespace().next()?.parse().ok()?,
    ))
}

#[test]
fn check_shows_every_fault_at_its_line_and_fails() {
    let folder = Folder::new("config-faults");
    let file = folder.write(
        "robot.toml",
        TWO.replace("port = 2369", "port = 0")
            .replace("\"vlp16\"", "\"vlp61\""),
    );
    let ran = sweepd(&["config", "check", file.to_str().unwrap()]);
    assert_eq!(
        (ran.code, &ran.stdout[..]),
        (78, ""),
        "EX_CONFIG: trying again would not help"
    );
    let (file, text) = (file.display(), &ran.stderr);
    for part in [
        &format!(
            "error: `port` cannot be 0\n  --> {file}:13:8\n   |\n13 | port = 0\n   |        ^ expected 1 to 65535\n"
        )[..],
        &format!("error: no supported model is called \"vlp61\"\n  --> {file}:14:9\n"),
        "help: did you mean `vlp16`?",
    ] {
        assert!(text.contains(part), "{text}\nlacks {part}");
    }
    assert_eq!(text.matches("error: ").count(), 2, "{text}");
}

#[test]
fn too_little_shared_memory_is_a_warning_with_a_cure() {
    let folder = Folder::new("config-memory");
    // As many as there may be, each of which takes 2 GiB at most: more than this host has, or any
    // but the largest.
    let sensor = |number: usize| {
        format!(
            "[[sensor]]\nname = \"s{number}\"\naddress = \"10.0.0.1:{number}\"\nmax_consumers = 16\nsegment = {{ min_points = 1 }}\n"
        )
    };
    let file = folder.write("robot.toml", (1..=64).map(sensor).collect::<String>());
    let ran = sweepd(&["config", "check", file.to_str().unwrap()]);
    assert!(
        ran.code == 0 && ran.stdout.contains("64 sensors"),
        "{}",
        ran.stderr
    );
    let is_warned = ran.stderr.starts_with("warning: /dev/shm has ")
        && ran.stderr.contains("lower max_consumers");
    assert!(
        is_warned && ran.stderr.lines().count() == 1,
        "{}",
        ran.stderr
    );
}

#[test]
fn a_file_that_is_no_configuration_is_named() {
    let folder = Folder::new("config-none");
    let check = |path: &std::path::Path| sweepd(&["config", "check", path.to_str().unwrap()]);
    check(&folder.path("none.toml")).says(&[
        "cannot read the configuration",
        "none.toml",
        "No such file",
    ]);
    check(folder.0.path()).says(&["cannot read the configuration", "Is a directory"]);
    check(&folder.write("picture.toml", b"http = \"\xff\xfe\"")).says(&["this is no text"]);
    check(&folder.write("long.toml", vec![b'#'; (1 << 20) + 1])).says(&["more than 1 MiB"]);
}

#[test]
fn a_folder_that_cannot_be_had_is_named_by_its_key() {
    let folder = Folder::new("config-root");
    let file = folder.write("robot.toml", format!("root = \"/proc/none\"\n{TWO}"));
    let ran = sweepd(&["run", "--config", file.to_str().unwrap()]);
    let error = ran
        .stderr
        .lines()
        .find(|line| line.starts_with("error: "))
        .expect(&ran.stderr);
    assert!(ran.code == 1 && error.contains("/proc/none"), "{error}");
}

#[test]
fn a_level_of_the_log_that_is_none_is_named() {
    let mut run = command(&["run", "--sensor", "192.168.1.201"]);
    run.env("SWEEPD_LOG", "info,sweepd::daemon=loud");
    Ran::of(run.output().unwrap())
        .says(&["SWEEPD_LOG=info,sweepd::daemon=loud", "expected a level"]);
}

#[test]
fn what_this_host_does_not_have_is_a_warning() {
    let folder = Folder::new("config-host");
    let sensor = "[[sensor]]\nname = \"roof\"\naddress = \"192.168.1.201\"\nbind = \"192.0.2.7\"\ninterface = \"eth99\"\n";
    let file = folder.write(
        "robot.toml",
        format!("{sensor}[record]\npath = \"none/drive.pcap\"\n"),
    );
    let ran = sweepd(&["config", "check", file.to_str().unwrap()]);
    assert_eq!(ran.code, 0, "{}", ran.stderr);
    for part in [
        "warning: sensor roof: `bind` 192.0.2.7 is no address of this host; `ip -4 address` lists them",
        "warning: sensor roof: `interface` eth99 is not on this host, which has",
        &format!(
            "warning: record: `path` is in {}/none, which is no folder",
            folder.0.path().display()
        ),
    ] {
        assert!(ran.stderr.contains(part), "{part}:\n{}", ran.stderr);
    }
    assert!(ran.stderr.contains("lo"), "{}", ran.stderr);
}

#[test]
fn the_example_is_printed_as_it_is_and_passes() {
    let folder = Folder::new("config-example");
    let example = sweepd(&["config", "example"]).done();
    let file = folder.write("sweepd.toml", &example);
    let told = sweepd(&["config", "check", file.to_str().unwrap()]).done();
    assert!(
        told.contains("sweepd.toml: 1 sensor\n")
            && told.contains("health         http://127.0.0.1:9177/health")
    );
}
