//! `simulate`: what it sends comes back from `replay` as it was, and what it says it broke is what
//! is counted.

use std::collections::BTreeMap;
use std::net::Ipv4Addr;
use std::path::Path;
use std::time::{Duration, Instant};

use serde_json::Value;
use sweepd::input::udp::{UdpConfig, UdpSource};

use crate::{Folder, Ran, command, replay, sweepd, sweeps};

/// What a simulation says at its end of one sensor.
#[derive(Debug, PartialEq)]
pub struct Said {
    data: u64,
    position: u64,
    lost: u64,
    duplicated: u64,
    reordered: u64,
    corrupted: u64,
}

/// Runs a simulation that must work.
#[track_caller]
pub fn simulate(options: &[&str]) -> Vec<Said> {
    let ran = sweepd(&[&["simulate", "--force"], options].concat());
    assert_eq!((ran.code, &ran.stdout[..]), (0, ""), "{}", ran.stderr);
    said(&ran.stderr)
}

fn said(stderr: &str) -> Vec<Said> {
    let line = |line: &str| {
        let after = |word: &str| {
            let (_, rest) = line.split_once(&format!("{word} ")).expect(line);
            rest.split(|c: char| !c.is_ascii_digit())
                .next()
                .unwrap()
                .parse()
                .expect(line)
        };
        Said {
            data: after("data packets"),
            position: after("position packets"),
            lost: after("lost"),
            duplicated: after("duplicated"),
            reordered: after("reordered"),
            corrupted: after("corrupted"),
        }
    };
    stderr.lines().map(line).collect()
}

/// The sweeps of a replay, and the summary of its sensors.
#[track_caller]
fn replayed(capture: &Path, options: &[&str]) -> (Vec<Value>, Vec<Value>) {
    let mut lines =
        sweeps(&replay(capture, &[&["--json", "--no-timing"], options].concat()).done());
    let summary = lines.pop().unwrap();
    (
        lines,
        summary["summary"]["sensors"].as_array().unwrap().clone(),
    )
}

const SCENES: [&str; 6] = [
    "street",
    "parking-lot",
    "field",
    "room",
    "corridor",
    "warehouse",
];

/// Every scene, return mode and both ends of the range of speeds.
#[track_caller]
fn comes_back(flag: &str, name: &str) {
    let folder = Folder::new(&format!("round-trip-{flag}"));
    let path = folder.path("made.pcap");
    for scene in SCENES {
        for (returns, mode) in [("single", "strongest"), ("dual", "dual")] {
            for (rpm, seconds) in [("300", "0.41"), ("1200", "0.11")] {
                let options = [
                    "--model",
                    flag,
                    "--scene",
                    scene,
                    "--returns",
                    returns,
                    "--rpm",
                    rpm,
                    "--seconds",
                    seconds,
                ];
                let said = simulate(&[&options[..], &["--pcap", path.to_str().unwrap()]].concat());
                let (sweeps, sensors) = replayed(&path, &[]);
                let what = format!("{options:?}: {sensors:?}");
                assert!(
                    !sweeps.is_empty() && said.len() == 1 && sensors.len() == 1,
                    "{what}"
                );
                for sweep in sweeps {
                    assert_eq!(
                        (&sweep["model"], &sweep["return_mode"]),
                        (&name.into(), &mode.into()),
                        "{what}"
                    );
                    let off = sweep["rpm"].as_f64().unwrap() / rpm.parse::<f64>().unwrap() - 1.0;
                    assert!(
                        off.abs() < 0.001 && sweep["returns"].as_u64() > Some(5_000),
                        "{sweep}"
                    );
                }
                assert_eq!(sensors[0]["packets"], said[0].data);
                assert_eq!(sensors[0]["position_packets"], said[0].position);
                for count in [
                    "lost_packets",
                    "missing_columns",
                    "duplicates",
                    "reordered",
                    "late",
                    "malformed",
                    "unconfirmed",
                    "foreign",
                    "undecoded",
                ] {
                    assert_eq!(sensors[0][count], 0, "{count} {what}");
                }
            }
        }
    }
}

#[test]
fn a_vlp16_comes_back() {
    comes_back("vlp16", "VLP-16");
}

#[test]
fn a_puck_lite_comes_back_as_the_vlp16_that_it_looks_like() {
    comes_back("puck-lite", "VLP-16");
}

#[test]
fn a_puck_hires_comes_back() {
    comes_back("puck-hires", "Puck Hi-Res");
}

#[test]
fn an_hdl32e_comes_back() {
    comes_back("hdl32e", "HDL-32E");
}

#[test]
fn the_network_faults_that_were_injected_are_those_that_are_counted() {
    let folder = Folder::new("injected");
    let path = folder.path("faulty.pcap");
    let faults = [
        "--loss=1",
        "--burst-loss=0.2x12",
        "--duplicate=1.5",
        "--reorder=2",
    ];
    for (seed, model, returns) in [
        ("1", "vlp16", "single"),
        ("2", "vlp16", "dual"),
        ("3", "hdl32e", "single"),
        ("4", "puck-hires", "single"),
    ] {
        let options = [
            "--model",
            model,
            "--returns",
            returns,
            "--seed",
            seed,
            "--seconds=1",
            "--scene=field",
        ];
        let said = simulate(&[&options[..], &faults, &["--pcap", path.to_str().unwrap()]].concat());
        let (_, sensors) = replayed(&path, &[]);
        let Said {
            data,
            lost,
            duplicated,
            reordered,
            corrupted,
            ..
        } = said[0];
        assert!(
            lost > 10 && duplicated > 3 && reordered > 3 && corrupted == 0,
            "{said:?}"
        );
        let counted = ["packets", "lost_packets", "duplicates", "reordered"]
            .map(|key| sensors[0][key].as_u64().unwrap());
        assert_eq!(counted, [data, lost, duplicated, reordered], "{options:?}");
        assert_eq!(sensors[0]["late"], 0);
    }
}

#[test]
fn a_corrupt_packet_has_one_bit_flipped() {
    let folder = Folder::new("corrupt");
    let (clean, corrupt) = (folder.path("clean.pcap"), folder.path("corrupt.pcap"));
    let options = ["--model=vlp16", "--scene=field", "--seconds=0.5", "--pcap"];
    simulate(&[&options[..], &[clean.to_str().unwrap()]].concat());
    let said = simulate(&[&options[..], &[corrupt.to_str().unwrap(), "--corrupt=5"]].concat());
    let [clean, broken] = [&clean, &corrupt].map(|path| std::fs::read(path).unwrap());
    let bits: u32 = clean
        .iter()
        .zip(&broken)
        .map(|(a, b)| (a ^ b).count_ones())
        .sum();
    assert!(bits > 5 && clean.len() == broken.len());
    assert_eq!(u64::from(bits), said[0].corrupted);
    replayed(&corrupt, &[]);
}

#[test]
fn what_is_late_by_places_damaged_or_stray_is_what_is_counted() {
    let folder = Folder::new("places");
    let path = folder.path("faulty.pcap");
    for (faults, counts) in [
        ("--reorder=2x3", |said: &Said| {
            [("reordered", said.reordered), ("lost_packets", 0)]
        }),
        ("--corrupt=2xlength", |said| {
            [("malformed", 0), ("lost_packets", said.corrupted)]
        }),
        ("--corrupt=2xflag", |said| {
            [
                ("malformed", said.corrupted),
                ("lost_packets", said.corrupted),
            ]
        }),
        ("--stray=5", |_| {
            [("malformed", 0), ("lost_packets", 0)] as [(&str, u64); 2]
        }),
    ] as [(&str, fn(&Said) -> [(&'static str, u64); 2]); 4]
    {
        let said = simulate(&[
            "--model=vlp16",
            "--scene=field",
            "--seconds=1",
            faults,
            "--pcap",
            path.to_str().unwrap(),
        ]);
        let (_, sensors) = replayed(&path, &[]);
        for (name, count) in counts(&said[0]) {
            assert_eq!(
                sensors[0][name], count,
                "{faults}: {name} of {said:?}, {}",
                sensors[0]
            );
        }
        let sum = said[0].reordered + said[0].corrupted;
        assert!(
            sum > 5 || faults.starts_with("--stray"),
            "{faults}: {said:?}"
        );
    }
}

#[test]
fn two_sensors_may_exchange_their_addresses() {
    let folder = Folder::new("exchange");
    let path = folder.path("two.pcap");
    let options = [
        "--model=vlp16",
        "--model=hdl32e",
        "--scene=field",
        "--seconds=1",
        "--exchange=0.5",
    ];
    simulate(&[&options[..], &["--pcap", path.to_str().unwrap()]].concat());
    let (sweeps, sensors) = replayed(&path, &["--partial"]);
    assert_eq!(sensors.len(), 2);
    for sensor in &sensors {
        let of = sweeps
            .iter()
            .filter(|sweep| sweep["sensor"] == sensor["sensor"]);
        let mut models: Vec<&str> = of.map(|sweep| sweep["model"].as_str().unwrap()).collect();
        models.dedup();
        models.sort_unstable();
        assert_eq!(models, ["HDL-32E", "VLP-16"], "{sensor}");
    }
}

#[test]
fn the_same_command_gives_the_same_bytes_and_another_seed_others() {
    let folder = Folder::new("same");
    let options = "--model vlp16 --model puck-hires --scene room --seconds 0.15 --loss 2 --corrupt 2 --reorder 2";
    let make = |seed: &str, name: &str| {
        let (file, truth) = (folder.path(name), folder.path(&format!("truth-{name}")));
        let mut args: Vec<&str> = options.split(' ').collect();
        args.extend([
            "--seed",
            seed,
            "--pcap",
            file.to_str().unwrap(),
            "--truth",
            truth.to_str().unwrap(),
        ]);
        simulate(&args);
        (
            std::fs::read(&file).unwrap(),
            folder.files(&format!("truth-{name}")),
        )
    };
    let [first, again, other] =
        [("7", "a.pcap"), ("7", "b.pcap"), ("8", "c.pcap")].map(|(seed, name)| make(seed, name));
    assert!(first == again && first.0 != other.0 && first.1 != other.1);
    let names: Vec<&str> = first.1.iter().map(|(name, _)| &name[..]).collect();
    assert_eq!(
        names,
        ["192.168.1.202_2368/truth.csv", "objects.csv", "truth.csv"]
    );

    // Compressed, and to standard output, it is the same capture.
    let (zipped, zipped_again) = (make("7", "d.pcap.gz"), make("7", "e.pcap.gz"));
    assert!(zipped == zipped_again && zipped.0.len() < first.0.len());
    let mut unzipped = Vec::new();
    std::io::Read::read_to_end(
        &mut flate2::read::GzDecoder::new(&zipped.0[..]),
        &mut unzipped,
    )
    .unwrap();
    assert!(unzipped == first.0);
    let args: Vec<&str> = ["simulate", "--seed", "7", "--pcap", "-"]
        .into_iter()
        .chain(options.split(' '))
        .collect();
    assert!(command(&args).output().unwrap().stdout == first.0);
}

#[test]
fn several_sensors_stand_in_one_scene() {
    let folder = Folder::new("several");
    let path = folder.path("three.pcap");
    let models = ["--model=vlp16", "--model=hdl32e", "--model=puck-hires"];
    let said = simulate(
        &[
            &models[..],
            &["--seconds=0.25", "--pcap", path.to_str().unwrap()],
        ]
        .concat(),
    );
    let (_, mut sensors) = replayed(&path, &[]);
    sensors.sort_by_key(|sensor| sensor["sensor"].to_string());
    let found: Vec<_> = sensors
        .iter()
        .map(|one| {
            (
                one["sensor"].as_str().unwrap(),
                one["model"].as_str().unwrap(),
            )
        })
        .collect();
    let expected = [
        ("192.168.1.201:2368", "VLP-16"),
        ("192.168.1.202:2368", "HDL-32E"),
        ("192.168.1.203:2368", "Puck Hi-Res"),
    ];
    assert_eq!(found, expected);
    for (sensor, said) in sensors.iter().zip(&said) {
        assert_eq!(
            (&sensor["packets"], &sensor["lost_packets"]),
            (&said.data.into(), &0.into())
        );
    }
}

#[test]
fn motor_and_mode_follow_the_options() {
    let folder = Folder::new("motor");
    let path = folder.path("made.pcap");
    let made = |options: &[&str]| {
        let fixed = [
            "--model=vlp16",
            "--scene=field",
            "--seconds=1",
            "--pcap",
            path.to_str().unwrap(),
        ];
        simulate(&[&fixed[..], options].concat());
        replayed(&path, &["--partial"])
    };
    let whole = |sweeps: &[Value]| {
        sweeps
            .iter()
            .filter(|sweep| sweep["partial"] == false)
            .count()
    };
    let (steady, _) = made(&[]);
    let (sweeps, sensors) = made(&["--stall=0.35..0.75"]);
    assert_eq!(
        (whole(&steady), whole(&sweeps)),
        (9, whole(&steady) - 5),
        "{sensors:?}"
    );
    let (sweeps, _) = made(&["--spin-up=0.6"]);
    let rpm = |sweep: &Value| sweep["rpm"].as_f64().unwrap();
    let last_whole = sweeps
        .iter()
        .rfind(|sweep| sweep["partial"] == false)
        .unwrap();
    assert!(
        rpm(&sweeps[0]) < 500.0 && (rpm(last_whole) - 600.0).abs() < 0.6,
        "{sweeps:?}"
    );
    let (sweeps, _) = made(&["--new-rpm=1200@0.2..0.4"]);
    let last_whole = sweeps
        .iter()
        .rfind(|sweep| sweep["partial"] == false)
        .unwrap();
    assert!((rpm(last_whole) - 1200.0).abs() < 1.2, "{last_whole}");
    let (sweeps, sensors) = made(&["--fov=270..90@0.35..0.75"]);
    let is_half = |sweep: &&Value| (850..960).contains(&sweep["columns"].as_u64().unwrap());
    let blanked = sweeps.iter().filter(is_half).count();
    assert!(
        (3..=4).contains(&blanked) && sensors[0]["lost_packets"] == 0,
        "{blanked}: {sensors:?}"
    );
    let (sweeps, sensors) = made(&["--gps=none", "--clock-step=600@0.5"]);
    assert_eq!(
        (sweeps.len() - whole(&sweeps), &sensors[0]["lost_packets"]),
        (4, &0.into()),
        "{sensors:?}"
    );
    for (options, modes) in [
        (&["--mode-switch=0.45"][..], ["strongest", "dual"]),
        (
            &["--mode-switch=0.45", "--returns=dual"],
            ["dual", "strongest"],
        ),
    ] {
        let (_, sensors) = made(options);
        assert_eq!(sensors[0]["return_modes"], serde_json::json!(modes));
        assert_eq!(
            (&sensors[0]["lost_packets"], &sensors[0]["sweeps"]),
            (&0.into(), &8.into())
        );
    }
}

/// The wall ahead in the room comes nearer, and is seen more and more askew.
#[test]
fn a_sensor_moves_and_turns_as_told() {
    let folder = Folder::new("moving");
    let [capture, truth] = ["moving.pcap", "truth"].map(|name| folder.path(name));
    simulate(&[
        "--model=vlp16",
        "--scene=room",
        "--seconds=0.35",
        "--velocity=0.5,3",
        "--turn-rate=20",
        "--pcap",
        capture.to_str().unwrap(),
        "--truth",
        truth.to_str().unwrap(),
    ]);
    let text = std::fs::read_to_string(truth.join("truth.csv")).unwrap();
    let mut seen = Vec::new();
    for line in text.lines().skip(1) {
        let fields: Vec<&str> = line.split(',').collect();
        let number = |at: usize| fields[at].parse::<f64>().unwrap();
        let azimuth_deg = (number(6) + 180.0).rem_euclid(360.0) - 180.0;
        // The beam that is next to level.
        if number(2) % 16.0 == 1.0 && azimuth_deg.abs() < 0.2 {
            let seconds = fields[7].parse::<i64>().unwrap() - 1_777_889_843_000_000_000;
            assert_eq!(fields[4], "building", "{line}");
            seen.push((seconds as f64 * 1e-9, azimuth_deg, number(5)));
        }
    }
    assert!(seen.len() >= 6, "{seen:?}");
    for (seconds, azimuth_deg, range_m) in &seen {
        let ahead_m = seen[0].2 - 3.0 * seconds;
        let expected_m = ahead_m / (20.0 * seconds + azimuth_deg).to_radians().cos();
        assert!((range_m - expected_m).abs() < 0.001, "{seen:?}");
    }
    for velocity in ["3", "0,x", "0,101", "1,2,3"] {
        let ran = sweepd(&[
            "simulate",
            "--model=vlp16",
            "--velocity",
            velocity,
            "--pcap=-",
        ]);
        ran.says(&["--velocity", "expected"]);
    }
}

/// The data packets of a plain capture that the simulator wrote.
fn payloads(capture: &Path) -> Vec<Vec<u8>> {
    let bytes = std::fs::read(capture).unwrap();
    let mut payloads = Vec::new();
    let mut at = 24;
    while at < bytes.len() {
        let len = u32::from_le_bytes(bytes[at + 8..at + 12].try_into().unwrap()) as usize;
        // Behind the headers of the record, Ethernet, IP and UDP.
        payloads.push(bytes[at + 16 + 42..at + 16 + len].to_vec());
        at += 16 + len;
    }
    payloads
        .into_iter()
        .filter(|payload| payload.len() == 1206)
        .collect()
}

#[test]
fn an_hdl64e_sends_its_calibration_and_fires_at_the_configured_period() {
    let folder = Folder::new("hdl64e");
    let path = folder.path("made.pcap");
    let (unit, again) = (folder.path("unit.yaml"), folder.path("again.yaml"));
    let [to, unit_to, again_to] = [&path, &unit, &again].map(|path| path.to_str().unwrap());
    let fixed = ["--scene=field", "--pcap", to];
    let step_us = |payloads: &[Vec<u8>]| {
        let stamp = |payload: &[u8]| u32::from_le_bytes(payload[1200..1204].try_into().unwrap());
        f64::from(stamp(&payloads[500]) - stamp(&payloads[0])) / 500.0
    };
    for (options, period_us) in [
        (&["--model=hdl64e-s2"][..], 288.0),
        (&["--model=hdl64e-s3"], 288.0),
        (&["--model=hdl64e-s3", "--firing-period=57.6"], 345.6),
        (&["--model=hdl64e-s3", "--returns=dual"], 172.8),
    ] {
        let said = simulate(&[options, &fixed, &["--seconds=1.6"]].concat());
        let payloads = payloads(&path);
        assert_eq!((said[0].data, said[0].position), (payloads.len() as u64, 0));
        assert!(
            (step_us(&payloads) - period_us).abs() < 0.01,
            "{options:?}: {}",
            step_us(&payloads)
        );
        assert!(
            payloads
                .iter()
                .all(|payload| payload[..2] == [0xFF, 0xEE] && payload[100..102] == [0xFF, 0xDD])
        );
        // What it says of itself is what it is: another one with that calibration is the same.
        let ran = sweepd(&["calib", "from-capture", to, "--force", "-o", unit_to]);
        assert_eq!(ran.code, 0, "{options:?}: {}", ran.stderr);
        simulate(
            &[
                options,
                &fixed,
                &["--seconds=1.6", "--calibration", unit_to],
            ]
            .concat(),
        );
        assert!(self::payloads(&path) == payloads, "{options:?}");
        let ran = sweepd(&["calib", "from-capture", to, "--force", "-o", again_to]);
        assert_eq!(ran.code, 0, "{options:?}: {}", ran.stderr);
        assert_eq!(
            std::fs::read(&unit).unwrap(),
            std::fs::read(&again).unwrap()
        );
    }
}

#[test]
fn the_gps_receiver_has_satellites_when_configured() {
    let folder = Folder::new("gps");
    let path = folder.path("made.pcap");
    let hour_us = |options: &[&str]| {
        let fixed = [
            "--model=hdl64e-s3",
            "--scene=field",
            "--seconds=0.01",
            "--pcap",
            path.to_str().unwrap(),
        ];
        simulate(&[&fixed[..], options].concat());
        u32::from_le_bytes(payloads(&path)[0][1200..1204].try_into().unwrap())
    };
    // 17 minutes and 23 seconds past the hour, and the first packet's 288 us.
    assert_eq!(hour_us(&[]), 1_043_000_288);
    assert_eq!(hour_us(&["--gps=none"]), 288);
    assert_eq!(hour_us(&["--gps=0.."]), 288, "two seconds later it would");
    assert_eq!(hour_us(&["--gps=..0.005"]), 1_043_000_288);
}

/// The datagrams that a simulation sends to a socket, by the port that each sensor sends from.
fn received(options: &[&str]) -> (BTreeMap<u16, Vec<Vec<u8>>>, Vec<Said>, Duration) {
    let here = UdpConfig {
        address: Ipv4Addr::LOCALHOST,
        ..UdpConfig::port(0)
    };
    let mut socket = UdpSource::bind(&here).unwrap();
    let to = socket.local_addr().to_string();
    let begun = Instant::now();
    let mut child = command(&[&["simulate", "--to", &to], options].concat())
        .stderr(std::process::Stdio::piped())
        .spawn()
        .expect("the binary runs");
    let mut ports = BTreeMap::<u16, Vec<Vec<u8>>>::new();
    let mut took = None;
    loop {
        let (wait, before) = (Duration::from_millis(100), socket.received());
        for one in socket.receive(wait).unwrap() {
            let of_port = ports.entry(one.source.port()).or_default();
            of_port.push(one.payload.to_vec());
        }
        // Silent, and it was over before: all is here.
        if took.is_some() && socket.received() == before {
            break;
        }
        if took.is_none() && child.try_wait().unwrap().is_some() {
            took = Some(begun.elapsed());
        }
    }
    let ran = Ran::of(child.wait_with_output().unwrap());
    assert_eq!((ran.code, &ran.stdout[..]), (0, ""), "{}", ran.stderr);
    // A progress line is for terminals: no colours, no carriage returns, no line but the summary of
    // each sensor.
    assert!(
        !ran.stderr.contains(['\r', '\x1b']) && !ran.stderr.contains("Ctrl-C"),
        "{:?}",
        ran.stderr
    );
    (ports, said(&ran.stderr), took.unwrap())
}

#[test]
fn a_socket_gets_every_datagram_in_order_and_not_too_soon() {
    let stamp_us =
        |payload: &Vec<u8>| u64::from(u32::from_le_bytes(payload[1200..1204].try_into().unwrap()));
    let options = [
        "--model=vlp16",
        "--model=hdl32e",
        "--scene=field",
        "--seconds=0.3",
    ];
    let (ports, said, took) = received(&options);
    assert!(took >= Duration::from_millis(295), "{took:?}");
    assert_eq!((ports.len(), said.len()), (2, 2));
    let mut counts = Vec::new();
    for payloads in ports.into_values() {
        let data: Vec<u64> = payloads
            .iter()
            .filter(|payload| payload.len() == 1206)
            .map(stamp_us)
            .collect();
        let step_us = |two: &[u64]| (two[1] + 3_600_000_000 - two[0]) % 3_600_000_000;
        let steps: Vec<u64> = data.windows(2).map(step_us).collect();
        let period_us = steps[0] + 1;
        assert!(
            steps.iter().all(|step| step.abs_diff(period_us) <= 2),
            "{steps:?}"
        );
        counts.push((data.len() as u64, (payloads.len() - data.len()) as u64));
    }
    let mut expected: Vec<(u64, u64)> =
        said.iter().map(|said| (said.data, said.position)).collect();
    counts.sort();
    expected.sort();
    assert_eq!(counts, expected);
}

#[test]
fn what_cannot_be_simulated_is_one_error_with_its_flag_and_the_cure() {
    let folder = Folder::new("not-simulated");
    let file = folder.path("made.pcap");
    let file = file.to_str().unwrap();
    let cases = [
        (
            "--model=vlp32a",
            "vlp16, puck-lite, puck-hires, hdl32e, hdl64e-s2, hdl64e-s3, vlp32c, vls128",
        ),
        (
            "--scene=moon",
            "street, parking-lot, field, room, corridor, warehouse",
        ),
        ("--height=0", "0.01 to 200 metres"),
        ("--pitch=91", "-90 to 90 degrees"),
        ("--roll=nan", "-180 to 180 degrees"),
        ("--rpm=299", "300 to 1200 turns a minute"),
        ("--rpm=nan", "300 to 1200 turns a minute"),
        ("--returns=last", "single, dual"),
        ("--seed=-1", "a whole number from 0"),
        ("--seconds=0", "0.01 to 86400 seconds"),
        ("--seconds=1e9", "0.01 to 86400 seconds"),
        ("--calibration=none.yaml", "none.yaml"),
        ("--gps=5..2", "locked, none, or FROM..TO"),
        ("--gps=never", "locked, none, or FROM..TO"),
        ("--rpm-drift=21", "0 to 20 percent"),
        ("--firing-period=never", "microseconds, such as 48"),
        ("--firing-period=48", "the VLP-16 fires every 55.3 us"),
        ("--loss=101", "0 to 100 percent"),
        ("--loss=-1", "0 to 100 percent"),
        ("--burst-loss=1x0", "such as 0.1x20"),
        ("--burst-loss=1x", "such as 0.1x20"),
        ("--burst-loss=x5", "such as 0.1x20"),
        ("--duplicate=2%", "0 to 100 percent"),
        ("--reorder=inf", "0 to 100 percent"),
        ("--corrupt=many", "0 to 100 percent"),
        ("--spin-up=-1", "0 to 86400 seconds"),
        ("--stall=3", "such as 2..3.5"),
        ("--stall=3..3", "such as 2..3.5"),
        ("--stall=10..11", "more --seconds than 10"),
        ("--mode-switch=10", "more --seconds than 10"),
    ];
    for (option, cure) in cases {
        let flag = option.split('=').next().unwrap();
        let ran = sweepd(&["simulate", "--model=vlp16", "--pcap", file, option]);
        let flag = if flag == "--calibration" {
            "calibration"
        } else {
            flag
        };
        ran.says(&[flag]);
        assert!(
            ran.error().contains(cure) || ran.stderr.contains(cure),
            "{option}: {}",
            ran.stderr
        );
        assert!(!Path::new(file).exists(), "{option}");
    }
    let args = [
        "simulate",
        "--model=vlp16",
        "--scene=room",
        "--height=5",
        "--pcap",
        file,
    ];
    sweepd(&args).says(&["sensor 1 would be 5.00 m above", "(building)", "--height"]);
    for option in ["--returns=dual", "--mode-switch=1"] {
        let flag = option.replace('=', " ");
        let flag = if flag.contains("switch") {
            "--mode-switch"
        } else {
            &flag
        };
        let args = ["simulate", "--model=hdl64e-s2", "--pcap", file, option];
        sweepd(&args).says(&[flag, "an HDL-64E S2 has one return", "--model hdl64e-s3"]);
    }
    let args = [
        "simulate",
        "--model=hdl64e-s2",
        "--pcap",
        file,
        "--firing-period=57.6",
    ];
    sweepd(&args).says(&["--firing-period", "the HDL-64E S2 fires every 48 us"]);
    let args = [
        "simulate",
        "--model=hdl64e-s3",
        "--pcap",
        file,
        "--calibration=calib/vlp16.yaml",
    ];
    sweepd(&args).says(&[
        "--calibration calib/vlp16.yaml",
        "16 beams",
        "calibration of the VLP-16",
    ]);
    sweepd(&["simulate", "--model=vlp16", "--to", "localhost"])
        .says(&["--to", "IP:PORT such as 127.0.0.1:2368"]);
    sweepd(&["simulate", "--model=vlp16", "--pcap", "a.txt"])
        .says(&["--pcap a.txt", ".pcap or .pcap.gz"]);
    sweepd(&["simulate", "--model=vlp16", "--pcap", "none/a.pcap"])
        .says(&["none/a.pcap", "No such file"]);
    let truth = folder.write("file", "");
    sweepd(&[
        "simulate",
        "--model=vlp16",
        "--pcap",
        "-",
        "--truth",
        truth.to_str().unwrap(),
    ])
    .says(&["file: "]);
    for args in [
        &["--pcap", "-"][..],
        &["--model=vlp16"],
        &["--model=vlp16", "--pcap", "-", "--to", "127.0.0.1:9"],
    ] {
        let ran = sweepd(&[&["simulate"], args].concat());
        assert_eq!(ran.code, 2, "{}", ran.stderr);
    }
    let many = ["--model=vlp16"; 55];
    sweepd(&[&["simulate", "--pcap", "-"], &many[..]].concat())
        .says(&["--model is given 55 times", "at most 54"]);
}
