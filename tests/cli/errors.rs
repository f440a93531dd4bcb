//! Bad input: one clear error that names the place and the cure, and an exit code.

use std::process::{Command, Stdio};

use crate::{Folder, Ran, command, fixture, inspect, made, replay, sweepd, sweepd_with_stdin};
use sweepd_testkit::{bags::mcap, scan};

#[test]
fn what_is_no_capture_is_named_by_both_commands() {
    let folder = Folder::new("no-capture");
    let cases = [
        (
            folder.write("picture.pcap", made::png(4, 4)),
            "is no capture: it holds a PNG image",
        ),
        (folder.write("empty.pcap", ""), "empty"),
        (folder.write("text.pcap", "[package]"), "it holds text"),
        (folder.write("garbage.pcap", [0x91; 5000]), "is no capture"),
        (
            folder.write("zipped.pcap.gz", made::gzip(b"hello")),
            "gzip of something else",
        ),
        (
            folder.path(""),
            "a folder without .mcap, .db3 or .bag files",
        ),
        (folder.path("missing.pcap"), "No such file"),
    ];
    for (path, why) in cases {
        for ran in [
            replay(&path, &[]),
            inspect(&path),
            replay(&path, &["--json"]),
        ] {
            let is_file = path.is_file();
            assert_eq!(
                (ran.code, &ran.stdout[..]),
                (if is_file { 1 } else { 66 }, "")
            );
            ran.says(&[path.to_str().unwrap().trim_end_matches('/'), why]);
        }
    }
}

#[test]
fn a_bag_without_packets_of_a_sensor_says_what_it_holds_instead() {
    let folder = Folder::new("no-scan");
    let channel = |kind: &str| [mcap::schema(1, kind), mcap::channel(0, 1, "/top", "cdr")].concat();
    let clouds = mcap::file(&[channel("sensor_msgs/msg/PointCloud2")]);
    let path = folder.write("clouds.mcap", clouds);
    for ran in [replay(&path, &["--json"]), inspect(&path)] {
        assert_eq!((ran.code, &ran.stdout[..]), (1, ""));
        ran.says(&[
            "clouds.mcap is a bag without",
            "/top (sensor_msgs/msg/PointCloud2)",
        ]);
    }
    let messages = [
        mcap::message(0, &scan::cdr(&[(5, 9); 3], false)),
        mcap::message(0, b"no scan"),
    ];
    let bag = mcap::file(&[channel(scan::SCAN), messages.concat()]);
    let path = folder.write("others.mcap", bag);
    replay(&path, &[]).says(&["others.mcap: no Velodyne data packets (3 packets);"]);
    let text = inspect(&path).done();
    let records =
        "3 packets, 3 of them not of a Velodyne; 1 message on their topics without a VelodyneScan";
    assert!(text.contains("MCAP") && text.contains(records), "{text}");
}

/// A folder with `sweepd` alone in it, which looks beside itself for the program that reads
/// databases; and a folder with a bag.
fn sweepd_alone(test: &str) -> (Folder, Folder) {
    let programs = tempfile::tempdir_in(env!("CARGO_TARGET_TMPDIR")).unwrap();
    let program = programs.path().join("sweepd");
    std::fs::hard_link(env!("CARGO_BIN_EXE_sweepd"), &program).unwrap();
    let bag = Folder::new(test);
    bag.write("drive_0.db3", [b"SQLite format 3\0", &[0; 84][..]].concat());
    (Folder(programs), bag)
}

/// `sweepd` of a folder with these words, and no folder of programs.
fn run_alone(programs: &Folder, words: &[&str]) -> Ran {
    let mut command = Command::new(programs.path("sweepd"));
    command.args(words).env("PATH", "").stdin(Stdio::null());
    Ran::of(command.output().unwrap())
}

#[test]
fn a_database_without_the_program_that_reads_it_names_the_package() {
    let (programs, bag) = sweepd_alone("no-reader");
    let file = bag.path("drive_0.db3");
    let release = if cfg!(debug_assertions) {
        ""
    } else {
        "--release "
    };
    for path in [&file, &bag.path("")] {
        for command in ["replay", "inspect"] {
            let ran = run_alone(&programs, &[command, path.to_str().unwrap()]);
            assert_eq!((ran.code, &ran.stdout[..]), (1, ""));
            let says = format!(
                "error: {}: a database of rosbag2 is read by sweepd-db3, which is not beside sweepd or on PATH: \
                 install the package sweepd-tools (cargo install sweepd-tools; in a checkout, cargo build {release}-p \
                 sweepd-tools), or `ros2 bag convert` turns it into MCAP\n",
                file.display()
            );
            assert_eq!(ran.stderr, says);
        }
    }
}

#[test]
fn a_program_that_sends_no_frames_of_a_database_is_refused() {
    let (programs, bag) = sweepd_alone("no-frames");
    // The shell writes it: a file that this process has open could not be run.
    let script =
        "printf '#!/bin/sh\\necho hello, this is another program\\n' > \"$0\" && chmod +x \"$0\"";
    let written = Command::new("sh")
        .args(["-c", script])
        .arg(programs.path("sweepd-db3"))
        .status();
    assert!(written.unwrap().success());
    let file = bag.path("drive_0.db3");
    let ran = run_alone(&programs, &["replay", file.to_str().unwrap()]);
    assert_eq!((ran.code, &ran.stdout[..]), (1, ""));
    ran.says(&[
        &format!(
            "cannot read {} beyond record 0 (message 1): ",
            file.display()
        ),
        &format!(
            "{} sends `hello, this i`; is it sweepd-db3 of sweepd {}?",
            programs.path("sweepd-db3").display(),
            env!("CARGO_PKG_VERSION")
        ),
    ]);
}

#[test]
fn a_capture_without_sensors_says_what_it_holds_instead() {
    let folder = Folder::new("no-sensor");
    let mut others = made::vlp16();
    others.truncate(10);
    others
        .iter_mut()
        .for_each(|sent| sent.payload.truncate(100));
    let path = folder.write("others.pcap", made::pcap(&others));
    replay(&path, &[]).says(&[
        "others.pcap: no Velodyne data packets (10 records, 10 UDP datagrams)",
        "inspect",
    ]);
    let text = inspect(&path).done();
    assert!(
        text.contains("10, with 10 UDP datagrams; 10 of other traffic")
            && text.contains("none sends data"),
        "{text}"
    );
    let flow = text
        .lines()
        .skip_while(|line| *line != "other traffic")
        .nth(1)
        .unwrap_or_default();
    assert!(
        flow.contains("to port 2368: 9 datagrams of 100 bytes ("),
        "{text}"
    );
    replay(&folder.write("none.pcap", made::pcap(&[])), &[])
        .says(&["none.pcap: no Velodyne data packets (0 records"]);
}

#[test]
fn a_capture_that_was_cut_is_replayed_up_to_there() {
    let folder = Folder::new("cut");
    let whole = made::pcap(&made::vlp16());
    for (name, bytes) in [
        ("cut.pcap", whole[..whole.len() - 100].to_vec()),
        ("cut.pcap.gz", made::gzip(&whole)[..120_000].to_vec()),
    ] {
        let path = folder.write(name, bytes);
        let ran = replay(&path, &["--json"]);
        assert_eq!(ran.code, 0, "{}", ran.stderr);
        let lines: Vec<&str> = ran.said().collect();
        assert_eq!(lines.len(), 1, "{lines:?}");
        assert!(
            lines[0].starts_with("warning: ") && lines[0].contains("breaks off at record"),
            "{}",
            lines[0]
        );
        let lines = crate::sweeps(&ran.stdout);
        assert!(
            lines.len() > 1
                && lines.last().unwrap()["summary"]["capture"]["breaks_off"].is_string()
        );
        assert!(inspect(&path).done().contains("damaged"));
    }
}

#[test]
fn a_sensor_that_is_not_supported_is_one_error_and_never_decoded() {
    let folder = Folder::new("unsupported");
    let cases = [
        ("vlp32c", made::with_product(made::vlp16(), 0x28), "VLP-32C"),
        ("vls128", made::with_product(made::vlp16(), 0xA1), "VLS-128"),
        ("hdl64e-s1", made::hdl64e_s1(), "HDL-64E S1"),
        ("unknown", made::with_product(made::vlp16(), 0x77), "0x77"),
    ];
    for (name, datagrams, model) in cases {
        let path = folder.write(&format!("{name}.pcap"), made::pcap(&datagrams));
        let ran = replay(&path, &["--no-timing"]);
        assert_eq!(
            (ran.code, ran.stderr.lines().count()),
            (1, 1),
            "{}",
            ran.stderr
        );
        ran.says(&[
            &format!("{name}.pcap"),
            "192.168.1.201:2368: ",
            model,
            "vlp16",
        ]);
        assert!(ran.stdout.contains("286 not decoded"), "{}", ran.stdout);
        let ran = replay(&path, &["--json", "--loop=3"]);
        ran.says(&[model]);
        let lines = crate::sweeps(&ran.stdout);
        assert_eq!(lines.len(), 1);
        assert!(
            lines[0]["summary"]["sensors"][0]["fault"]
                .as_str()
                .unwrap()
                .contains(model)
        );
        assert!(inspect(&path).done().contains("cannot be decoded: "));
    }
}

#[test]
fn one_of_two_sensors_that_is_not_supported_does_not_stop_the_other() {
    let folder = Folder::new("one-of-two");
    let other = made::with_ports(
        &made::with_product(made::vlp16(), 0x28),
        "192.168.1.9:2368",
        2368,
    );
    let path = folder.write(
        "two.pcap",
        made::pcap(&made::together(&[&other, &made::vlp16()])),
    );
    let ran = replay(&path, &["--no-timing"]);
    ran.says(&["192.168.1.9:2368: ", "VLP-32C"]);
    assert!(ran.stdout.contains("3 whole"), "{}", ran.stdout);
}

#[test]
fn what_was_decoded_before_another_sensor_took_the_place_is_kept() {
    let folder = Folder::new("exchanged");
    let mut datagrams = made::vlp16();
    let other = made::with_product(datagrams.split_off(200), 0x28);
    datagrams.extend(other);
    let path = folder.write("exchanged.pcap", made::pcap(&datagrams));
    let ran = replay(&path, &["--no-timing"]);
    ran.says(&["exchanged.pcap, record 2", "VLP-32C"]);
    for part in [
        "model        VLP-16",
        "not decoded  the error says why",
        "1 whole",
        " rpm",
    ] {
        assert!(ran.stdout.contains(part), "{}", ran.stdout);
    }
}

#[test]
fn a_wrong_model_is_a_contradiction() {
    let ran = replay(&fixture("street_vlp16_losses.pcap"), &["--model", "hdl32e"]);
    ran.says(&["the given model is HDL-32E", "1327 us", "give vlp16"]);
    let ran = replay(&fixture("street_hdl32e.pcap.gz"), &["--model", "vlp16"]);
    ran.says(&["the given model is VLP-16", "give hdl32e"]);
    let ran = replay(&fixture("street_vlp16_losses.pcap"), &["--model", "vls128"]);
    ran.says(&[
        "the given model is VLS-128",
        "one bank of lasers",
        "leave --model away",
    ]);
    let ran = replay(&fixture("street_vlp16_losses.pcap"), &["--model", "vlp32a"]);
    ran.says(&["'vlp32a'", "vlp16, puck-lite, puck-hires, hdl32e"]);
    assert_eq!(ran.code, 2);
}

#[test]
fn a_calibration_that_does_not_fit_is_refused() {
    let folder = Folder::new("calibration");
    let capture = fixture("street_vlp16_losses.pcap");
    let with =
        |path: std::path::PathBuf| replay(&capture, &["--calibration", path.to_str().unwrap()]);
    with(folder.write("db.xml", made::db_xml_without_a_beam())).says(&["db.xml", "7"]);
    with(folder.path("none.xml")).says(&[
        "cannot read the calibration",
        "none.xml",
        "No such file",
    ]);
    with(folder.write("notes.txt", "hello"))
        .says(&["notes.txt", "expected a db.xml, or a ROS YAML"]);
    with(folder.path("")).says(&["irectory"]);
}

#[test]
#[cfg_attr(without_captures, ignore = "no captures")]
fn real_calibrations_of_other_sensors_are_refused_and_a_wrong_unit_is_told() {
    let data = sweepd_testkit::data_dir();
    let path = data.join("pcap/vls128_nebula-a.pcap");
    let file = data.join("calib/rosdrivers_VLS128.yaml");
    let ran = replay(&path, &["--calibration", file.to_str().unwrap()]);
    assert_eq!(ran.code, 0, "{}", ran.stderr);
    assert!(
        ran.stderr
            .contains("a unit of distance is 7 mm: 4 mm is used"),
        "{}",
        ran.stderr
    );
    let path = data.join("pcap/vlp16_einride-a.pcap");
    replay(&path, &["--model", "hdl32e"]).says(&["the given model is HDL-32E", "VLP-16"]);
    for (file, beams) in [
        ("hdl32e_32db.xml", "32 beams"),
        ("veloview_HDL-64.xml", "64 beams"),
    ] {
        let file = data.join("calib").join(file);
        replay(&path, &["--calibration", file.to_str().unwrap()]).says(&[
            "does not fit",
            beams,
            "the VLP-16 has 16",
        ]);
    }
}

#[test]
fn a_mask_must_be_a_picture_with_a_row_a_beam() {
    let folder = Folder::new("mask");
    let capture = fixture("street_vlp16_losses.pcap");
    let with = |path: std::path::PathBuf| {
        replay(&capture, &["--mask", path.to_str().unwrap(), "--no-timing"])
    };
    with(folder.write("low.png", made::png(8, 3))).says(&["low.png", "3 pixels high", "16 rows"]);
    with(folder.write("high.png", made::png(8, 300))).says(&["high.png", "8 x 300 pixels"]);
    with(folder.write("text.png", "hello")).says(&["text.png", "expected a PNG picture"]);
    with(folder.path("none.png")).says(&["cannot read", "none.png"]);
    with(folder.write("black.png", made::grey_png(8, 16, 0))).says(&[
        "black.png",
        "all black",
        "white keeps",
    ]);
    let unmasked = replay(&capture, &["--no-timing"]).done();
    assert_eq!(
        with(folder.write("white.png", made::png(8, 16))).done(),
        unmasked
    );
}

#[test]
fn an_output_that_cannot_be_written_is_known_before_the_work() {
    let folder = Folder::new("unwritable");
    let file = folder.write("file", "");
    for option in ["--csv", "--pcd", "--png"] {
        for dir in [file.clone(), file.join("below")] {
            let ran = replay(
                &fixture("street_vlp16_losses.pcap"),
                &[option, dir.to_str().unwrap(), "--json"],
            );
            assert_eq!(ran.stdout, "");
            ran.says(&["cannot create the directory", dir.to_str().unwrap()]);
        }
    }
    // The directory is there, and a folder is where the second file goes.
    std::fs::create_dir_all(folder.path("csv/sweep_000001.csv/in_the_way")).unwrap();
    let ran = replay(
        &fixture("street_vlp16_losses.pcap"),
        &["--csv", folder.path("csv").to_str().unwrap()],
    );
    ran.says(&["cannot write", "sweep_000001.csv"]);
}

#[test]
fn a_reader_that_goes_away_is_no_error() {
    for args in [
        &["replay", "--json"][..],
        &["replay"],
        &["inspect"],
        &["replay", "--partial", "--loop=9", "--json"],
    ] {
        let mut args = args.to_vec();
        args.extend(["--height=1.9", "pcap_fixtures/street_vlp16_losses.pcap"]);
        let (reader, writer) = std::io::pipe().unwrap();
        drop(reader);
        let ran = Ran::of(
            command(&args)
                .stdout(writer)
                .stderr(Stdio::piped())
                .output()
                .unwrap(),
        );
        assert_eq!((ran.code, &ran.stderr[..]), (0, ""), "{args:?}");
    }
    // Even when nobody reads the errors.
    for (args, code) in [
        (&["replay", "none.pcap"][..], 66),
        (
            &[
                "replay",
                "pcap_fixtures/street_vlp16.pcap.gz",
                "--model",
                "hdl32e",
            ],
            1,
        ),
    ] {
        let (reader, writer) = std::io::pipe().unwrap();
        drop(reader);
        assert_eq!(
            command(args)
                .stdout(Stdio::null())
                .stderr(writer)
                .status()
                .unwrap()
                .code(),
            Some(code)
        );
    }
}

#[cfg(target_os = "linux")]
#[test]
fn a_full_disk_behind_standard_output_is_an_error() {
    for args in [&["replay", "--json"][..], &["replay"], &["inspect"]] {
        let mut args = args.to_vec();
        args.push("pcap_fixtures/street_vlp16_losses.pcap");
        let full = std::fs::OpenOptions::new()
            .write(true)
            .open("/dev/full")
            .unwrap();
        let ran = Ran::of(
            command(&args)
                .stdout(full)
                .stderr(Stdio::piped())
                .output()
                .unwrap(),
        );
        ran.says(&["cannot write to standard output", "No space left"]);
    }
}

#[test]
fn nothing_on_standard_input_is_said() {
    sweepd_with_stdin(&["replay", "-"], b"").says(&["standard input", "empty"]);
    sweepd(&["replay", "-", "--loop"]).says(&["standard input", "--loop needs a file"]);
}

#[test]
fn garbage_anywhere_in_a_capture_is_survived() {
    let folder = Folder::new("garbage");
    let good = made::pcap(&made::vlp16());
    let mut random = 0x2545_F491_4F6C_DD1D_u64;
    for round in 0..12 {
        let mut bytes = good.clone();
        for _ in 0..1 << round {
            random = random
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1_442_695_040_888_963_407);
            let at = 24 + (random >> 33) as usize % (bytes.len() - 24);
            bytes[at] ^= (random >> 20) as u8;
        }
        let path = folder.write("garbage.pcap", bytes);
        for ran in [replay(&path, &["--json", "--partial"]), inspect(&path)] {
            assert!(
                ran.code == 0 || ran.code == 1,
                "round {round}: {}",
                ran.stderr
            );
        }
    }
}

#[test]
fn one_corrupt_time_in_a_capture_interrupts_nothing() {
    let folder = Folder::new("time");
    let mut capture = std::fs::read("pcap_fixtures/street_vlp16_losses.pcap").unwrap();
    let sound = replay(
        &folder.write("sound.pcap", &capture),
        &["--json", "--no-timing"],
    )
    .done();
    // The seconds of the record in the middle: each has 16 bytes of header, and its length at byte
    // 8.
    let (mut at, mut records) = (24, 0);
    while records < 150 {
        at += 16 + u32::from_le_bytes(capture[at + 8..at + 12].try_into().unwrap()) as usize;
        records += 1;
    }
    capture[at + 3] ^= 0x10;
    let broken = folder.write("broken.pcap", &capture);
    let sweeps = |text: &str| -> Vec<String> {
        let lines = text.lines().filter(|line| line.contains("\"seq\""));
        lines
            .map(|line| line.split("\"rpm\"").next().unwrap().to_owned())
            .collect()
    };
    assert!(sweeps(&sound).len() >= 3);
    assert_eq!(
        sweeps(&replay(&broken, &["--json", "--no-timing"]).done()),
        sweeps(&sound)
    );
    // Where the time decides, the packet is left out; what follows is not.
    let cut = sweeps(&replay(&broken, &["--json", "--no-timing", "--end", "10"]).done());
    assert_eq!(
        (cut.len(), cut.last()),
        (sweeps(&sound).len(), sweeps(&sound).last())
    );
}
