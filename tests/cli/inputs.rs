//! Captures in all their forms, with one sensor or several.

use crate::{Folder, fixture, made, replay, sweepd, sweepd_with_stdin, sweeps};
use serde_json::Value;
use sweepd::wire::position::{Position, Pps};

#[test]
fn every_container_gives_the_same_sweeps_also_from_standard_input() {
    let folder = Folder::new("containers");
    let datagrams = made::vlp16();
    let (pcap, pcapng) = (made::pcap(&datagrams), made::pcapng(&datagrams));
    // All but the summary, which holds the name of the file.
    let sweeps_of = |stdout: String| stdout.rsplit_once("{\"summary\"").unwrap().0.to_owned();
    let options = ["--json", "--no-timing", "--partial"];
    let expected = sweeps_of(replay(&fixture("street_vlp16_losses.pcap"), &options).done());
    assert_eq!(expected.lines().count(), 5);
    for (name, bytes) in [
        ("a.pcap", pcap.clone()),
        ("a.pcapng", pcapng.clone()),
        ("a", made::gzip(&pcapng)),
    ] {
        assert_eq!(
            sweeps_of(replay(&folder.write(name, &bytes), &options).done()),
            expected,
            "{name}"
        );
        let from_stdin =
            sweepd_with_stdin(&[&["replay", "-"], &options[..]].concat(), &bytes).done();
        assert_eq!(sweeps_of(from_stdin), expected, "{name}");
    }
}

#[test]
fn two_sensors_in_one_file_are_replayed_each_as_alone() {
    let folder = Folder::new("two");
    let (vlp16, hdl32e) = (made::vlp16(), made::datagrams("street_hdl32e.pcap.gz"));
    let same_address = made::with_ports(&vlp16, "192.168.1.201:2369", 2369);
    let same_source = made::with_ports(&vlp16, "192.168.1.201:2368", 2369);
    for (name, other, other_name) in [
        ("other", hdl32e, "192.168.1.202:2368"),
        ("address", same_address, "192.168.1.201:2369"),
        ("source", same_source, "192.168.1.201:2368>2369"),
    ] {
        let path = folder.write(
            &format!("{name}.pcap"),
            made::pcap(&made::together(&[&vlp16, &other])),
        );
        let options = ["--json", "--no-timing"];
        let both = sweeps(&replay(&path, &options).done());
        let summary = &both.last().unwrap()["summary"]["sensors"];
        assert_eq!(summary.as_array().unwrap().len(), 2, "{name}");
        assert_eq!(
            (&summary[0]["sensor"], &summary[1]["sensor"]),
            (&"192.168.1.201:2368".into(), &other_name.into())
        );
        // Selected by --sensor, each gives the same lines; alone, it needs no port to tell it from
        // the other.
        let of = |sensor: &str, lines: &[serde_json::Value]| -> Vec<String> {
            lines
                .iter()
                .filter(|line| line["sensor"] == sensor)
                .map(ToString::to_string)
                .collect()
        };
        let selected =
            sweeps(&replay(&path, &[&options[..], &["--sensor", other_name]].concat()).done());
        let heard = selected[0]["sensor"].as_str().unwrap();
        let renamed: Vec<String> = of(other_name, &both)
            .iter()
            .map(|line| line.replace(other_name, heard))
            .collect();
        assert!(
            !renamed.is_empty() && of(heard, &selected) == renamed,
            "{name}"
        );
        let alone = sweeps(&replay(&fixture("street_vlp16_losses.pcap"), &options).done());
        assert_eq!(
            of("192.168.1.201:2368", &both),
            of("192.168.1.201:2368", &alone),
            "{name}"
        );
    }
}

#[test]
fn each_of_several_sensors_has_its_own_files_in_any_order_of_arrival() {
    let folder = Folder::new("folders");
    let one = made::vlp16();
    // The second sensor is heard before the third, and has its first whole sweep after it.
    let mut late = made::with_ports(&one, "192.168.1.9:2368", 2368);
    late.retain(|sent| sent.is_data());
    let pause_ns = 300_000_000;
    late.iter_mut()
        .skip(1)
        .for_each(|sent| sent.arrival_ns += pause_ns);
    let third = made::with_ports(&one, "192.168.1.10:2368", 2368);
    let path = folder.write(
        "three.pcap",
        made::pcap(&made::together(&[&one, &late, &third])),
    );
    let dir = folder.path("csv");
    replay(&path, &["--csv", dir.to_str().unwrap()]).done();
    let names: Vec<String> = folder
        .files("csv")
        .into_iter()
        .map(|(name, _)| name)
        .collect();
    for sensor in ["", "192.168.1.9_2368/", "192.168.1.10_2368/"] {
        assert!(
            names.contains(&format!("{sensor}sweep_000001.csv")),
            "{names:?}"
        );
    }
    assert_eq!(
        names
            .iter()
            .filter(|name| name.starts_with("192.168.1.10_"))
            .count(),
        3,
        "{names:?}"
    );
}

#[test]
fn other_traffic_is_counted_and_passed_over() {
    let folder = Folder::new("others");
    let mut datagrams = made::vlp16();
    let alone = replay(
        &folder.write("alone.pcap", made::pcap(&datagrams)),
        &["--no-timing"],
    )
    .done();
    for (index, len) in [(3, 0), (50, 4), (200, 1206), (201, 1400)] {
        let stranger = made::Sent {
            payload: vec![7; len],
            port: 53,
            ..datagrams[index].clone()
        };
        let source = "10.1.2.3:53".parse().unwrap();
        datagrams.insert(index, made::Sent { source, ..stranger });
    }
    let mixed = replay(
        &folder.write("mixed.pcap", made::pcap(&datagrams)),
        &["--no-timing"],
    )
    .done();
    assert_eq!(
        mixed,
        format!("{alone}\npassed over: 4 records of other traffic\n")
    );
}

/// The returns and the time of each whole turn.
fn turns(stdout: &str) -> Vec<(String, i64)> {
    let mut lines = sweeps(stdout);
    lines.retain(|line| line["partial"] == false);
    let turn = |line: &Value| {
        let time_ns = line["time_ns"].as_i64().unwrap();
        (line["returns"].to_string(), time_ns)
    };
    lines.iter().map(turn).collect()
}

/// The bare packets, with positions before and between them: no damage, nor is their date a warning.
fn bare(datagrams: &[made::Sent]) -> Vec<u8> {
    let mut position = Position {
        stamp_us: 0,
        pps: Pps::Locked,
        nmea: Some("$GPRMC,081802.00,A,5120.0,N,00002.0,E,0.1,,231116,,,A*70"),
        inertial: None,
        board: None,
        thermal: None,
    };
    let mut bare = Vec::new();
    for sent in datagrams.iter().filter(|sent| sent.is_data()) {
        let [.., a, b, c, d, _, _] = sent.payload[..] else {
            panic!("a data packet")
        };
        position.stamp_us = u32::from_le_bytes([a, b, c, d]);
        bare.extend(position.emit());
        bare.extend(&sent.payload);
        position.nmea = None;
    }
    bare
}

/// What people have of a drive, without times or without records, gives the same sweeps, 100 ms
/// apart, and one warning.
#[test]
fn bare_packets_and_times_that_are_none_give_the_same_sweeps() {
    let folder = Folder::new("times");
    let datagrams = made::vlp16();
    let path = folder.write("right.pcap", made::pcap(&datagrams));
    let expected = turns(&replay(&path, &["--json"]).done());
    assert_eq!(expected.len(), 3);
    let mut frozen = datagrams.clone();
    for sent in &mut frozen {
        sent.arrival_ns = datagrams[0].arrival_ns;
    }
    // All commands say so, whatever else is wrong for them.
    let path = folder.write("frozen.pcap", made::pcap(&frozen));
    let (path, out) = (path.to_str().unwrap(), folder.path("out"));
    let out = out.to_str().unwrap();
    for args in [
        &["mask", path, "-o", out][..],
        &["calib", "from-capture", path, "-o", out],
        &["doctor", "--obstacle", "0.25,2", path],
    ] {
        let told = sweepd(args).stderr;
        let says = "frozen.pcap: times of its records stand still";
        assert!(told.contains(says), "{args:?}: {told}");
    }
    for (name, bytes, says) in [
        (
            "frozen.pcap",
            made::pcap(&frozen),
            "frozen.pcap: times of its records stand still",
        ),
        (
            "bare.raw",
            bare(&datagrams),
            "bare.raw: bare packets have no times",
        ),
    ] {
        let ran = replay(&folder.write(name, &bytes), &["--json"]);
        let warnings: Vec<&str> = ran.said().collect();
        assert!(
            warnings.len() == 1 && warnings[0].contains(says),
            "{warnings:?}"
        );
        let found = turns(&ran.stdout);
        assert_eq!((ran.code, found.len()), (0, 3));
        for ((one, other), number) in found.iter().zip(&expected).zip(0..) {
            assert_eq!(one.0, other.0, "{name}");
            let off_ns = one.1 - found[0].1 - number * 100_000_000;
            assert!(off_ns.abs() < 1_000_000, "{name}: {off_ns}");
        }
    }
}

/// Simulators and gateways: without stamps there is no order, and this is said once.
#[test]
fn a_sensor_clock_that_stands_still_is_an_error() {
    let folder = Folder::new("clock");
    let mut datagrams = made::vlp16();
    for sent in datagrams.iter_mut().filter(|sent| sent.is_data()) {
        sent.payload[1200..1204].fill(0);
    }
    let ran = replay(&folder.write("zero.pcap", made::pcap(&datagrams)), &[]);
    ran.says(&[
        "192.168.1.201:2368: the stamps of its packets stand still",
        "gateway",
    ]);
    assert!(ran.stdout.contains("0 packets lost"), "{}", ran.stdout);
}
