//! `replay --pcap`: what it writes gives the sweeps that were replayed.

use std::net::SocketAddr;
use std::path::Path;

use sweepd::input::write::PcapWriter;
use sweepd::sweep::Header;
use sweepd::sweep::layout::{Column, Part};
use sweepd::wire::Datagram;
use zerocopy::FromBytes;

use crate::made::{Sent, datagrams, pcap, pcapng, together, vlp16, with_ports};
use crate::{Folder, fixture, replay, sweeps};
use sweepd_testkit::{bags::mcap, scan};

/// The sweeps of a replay with these options, all of them, in their own bytes; and what it said.
fn raw(folder: &Folder, capture: &Path, options: &[&str]) -> (Vec<u8>, String) {
    let file = folder.path("sweeps.raw");
    let outputs = [
        "--partial",
        "--no-timing",
        "--force",
        "--raw",
        file.to_str().unwrap(),
    ];
    let ran = replay(capture, &[&outputs[..], options].concat());
    assert_eq!(ran.code, 0, "{options:?}: {}", ran.stderr);
    (std::fs::read(file).unwrap(), ran.stdout)
}

/// The same with packets counted from the first one that is in any sweep of the sensor, which
/// docs/layout.md leaves out of what is the same.
fn counted_from_first(mut raw: Vec<u8>) -> Vec<u8> {
    let mut firsts = std::collections::BTreeMap::new();
    let mut at = 0;
    while at < raw.len() {
        let (header, _) = Header::read_from_prefix(&raw[at..]).unwrap();
        let columns = at + header.offsets[Part::Columns as usize] as usize;
        for column in 0..header.columns as usize {
            let number = &mut raw[columns + column * size_of::<Column>()..][..8];
            let packet = u64::from_le_bytes(number.try_into().unwrap());
            if packet != u64::MAX {
                let first = *firsts.entry(header.sensor().to_owned()).or_insert(packet);
                number.copy_from_slice(&(packet - first).to_le_bytes());
            }
        }
        at += header.total_bytes as usize;
    }
    raw
}

/// Replays a part of a capture into a piece, and that: both give the same, and something.
#[track_caller]
fn piece_of(folder: &Folder, capture: &Path, part: &[&str]) -> String {
    let piece = folder.path("piece.pcap");
    let options = [part, &["--pcap", piece.to_str().unwrap()]].concat();
    let (expected, said) = raw(folder, capture, &options);
    let (found, _) = raw(folder, &piece, &[]);
    assert!(!expected.is_empty(), "{part:?}");
    if !part.iter().any(|option| option.starts_with("--start")) {
        assert!(expected == found, "{part:?}");
    }
    let [expected, found] = [expected, found].map(counted_from_first);
    assert!(expected == found, "{part:?}");
    said
}

fn shifted(datagrams: &[Sent], by_ns: impl Fn(usize) -> i64) -> Vec<Sent> {
    let mut shifted = datagrams.to_vec();
    for (number, sent) in shifted.iter_mut().enumerate() {
        sent.arrival_ns += by_ns(number);
    }
    shifted
}

#[test]
fn a_piece_gives_the_sweeps_of_its_part() {
    let folder = Folder::new("piece");
    let mut second = with_ports(
        &datagrams("street_vlp16_dual.pcap.gz"),
        "192.168.1.77:2368",
        2369,
    );
    second.retain(Sent::is_data);
    let both = together(&[&vlp16(), &second]);
    let other = Sent {
        payload: b"of another program".to_vec(),
        port: 5000,
        ..both[7].clone()
    };
    let capture = folder.write(
        "both.pcap",
        pcap(&[&both[..7], &[other], &both[7..]].concat()),
    );
    for part in [
        &["--sensor", "192.168.1.201"][..],
        &["--sensor=192.168.1.77", "--end=0.21"],
        &["--start=0.13", "--end=0.37"],
        &["--start=0.1301", "--sensor", "192.168.1.201"],
    ] {
        let said = piece_of(&folder, &capture, part);
        assert!(
            said.contains("\nwritten: ") && said.contains("piece.pcap\n"),
            "{said}"
        );
    }
    // The hour of the sensor's stamps is from a position packet before the part.
    let sparse: Vec<Sent> = vlp16()
        .into_iter()
        .enumerate()
        .filter(|(number, sent)| sent.is_data() || *number < 20)
        .map(|(_, sent)| sent)
        .collect();
    let capture = folder.write("sparse.pcap", pcap(&sparse));
    piece_of(&folder, &capture, &["--start=0.2"]);
    let lines = replay(&folder.path("piece.pcap"), &["--json"]).done();
    assert_eq!(sweeps(&lines)[0]["time_source"], "gps");
    // Positions before the part are as few as there are addresses.
    assert!(lines.contains("\"position_packets\":1,"), "{lines}");
}

/// One that another sensor's packets show to be silent is closed there, too.
#[test]
fn a_piece_of_a_sensor_that_was_silent_closes_its_sweep() {
    let folder = Folder::new("piece-silence");
    let one = vlp16();
    let half = one.len() / 2;
    let silent = shifted(&one, |number| if number < half { 0 } else { 1_000_000_000 });
    let start_ns = one[0].arrival_ns;
    let mut other = with_ports(&one, "192.168.1.77:2368", 2368);
    other.retain(Sent::is_data);
    for sent in &mut other {
        sent.arrival_ns += 3 * (sent.arrival_ns - start_ns);
    }
    let capture = folder.write("silence.pcap", pcap(&together(&[&silent, &other])));
    let part = ["--sensor", "192.168.1.201"];
    piece_of(&folder, &capture, &part);
    // Without what the others sent, the sweep would not be closed there.
    let alone = folder.write("alone.pcap", pcap(&silent));
    let (with, _) = raw(&folder, &capture, &part);
    assert!(raw(&folder, &alone, &[]).0 != with);
}

/// Frames of all kinds come out as Ethernet.
#[test]
fn a_piece_of_other_frames_and_of_bags_gives_the_same() {
    let folder = Folder::new("piece-frames");
    let all = vlp16();
    let capture = folder.write("x.pcapng", pcapng(&all));
    piece_of(&folder, &capture, &["--start=0.1", "--end=0.3"]);

    let mut tagged = pcap(&[]);
    let mut of_v6 = PcapWriter::new(Vec::new()).unwrap();
    for sent in &all {
        let record = pcap(std::slice::from_ref(sent)).split_off(24);
        let len = (record.len() as u32 - 16 + 4).to_le_bytes();
        let tag = [0x81, 0, 0, 5];
        tagged.extend(
            [
                &record[..8],
                &len,
                &len,
                &record[16..28],
                &tag,
                &record[28..],
            ]
            .concat(),
        );
        of_v6
            .write_datagram(&Datagram {
                arrival_ns: sent.arrival_ns,
                source: SocketAddr::new("fd00::201".parse().unwrap(), sent.source.port()),
                destination_port: sent.port,
                payload: &sent.payload,
            })
            .unwrap();
    }
    for (name, bytes) in [("vlan.pcap", tagged), ("v6.pcap", of_v6.finish().unwrap())] {
        piece_of(&folder, &folder.write(name, bytes), &["--start=0.1"]);
    }
    let (found, _) = raw(&folder, &folder.path("piece.pcap"), &[]);
    let (header, _) = Header::read_from_prefix(&found).unwrap();
    assert_eq!(header.sensor(), "[fd00::201]:2368");

    // The sensors of a bag get addresses in place of their topics.
    let mut records = mcap::schema(1, scan::SCAN);
    for (channel, topic) in [(0, "/left"), (1, "/right")] {
        records.extend(mcap::channel(channel, 1, topic, "cdr"));
        let data: Vec<Sent> = all.iter().filter(|sent| sent.is_data()).cloned().collect();
        for packets in data.chunks(50) {
            records.extend(mcap::message(channel, &cdr(packets)));
        }
    }
    let bag = folder.write("x.mcap", mcap::file(&[records]));
    let piece = folder.path("of-bag.pcap");
    let part = ["--start=0.1", "--pcap", piece.to_str().unwrap()];
    let expected = raw(&folder, &bag, &part).0;
    let found = raw(&folder, &piece, &[]).0;
    let [expected, found] = [
        (expected, ["/left", "/right"]),
        (found, ["192.168.1.201:2368", "192.168.1.202:2368"]),
    ]
    .map(|(raw, names)| without_source(counted_from_first(raw), names));
    assert!(expected == found && !found.is_empty());
}

/// A scan of these packets.
fn cdr(packets: &[Sent]) -> Vec<u8> {
    let stamp = |ns: i64| {
        [(ns / 1_000_000_000) as u32, (ns % 1_000_000_000) as u32]
            .map(u32::to_le_bytes)
            .concat()
    };
    let mut message = [
        &[0, 1, 0, 0][..],
        &stamp(packets[0].arrival_ns),
        &[2, 0, 0, 0],
        b"x\0\0\0",
    ]
    .concat();
    message.extend((packets.len() as u32).to_le_bytes());
    for sent in packets {
        message.extend([&stamp(sent.arrival_ns)[..], &sent.payload, &[0, 0]].concat());
    }
    message
}

/// The same without the source in each header, which is one of these.
fn without_source(mut raw: Vec<u8>, sources: [&str; 2]) -> Vec<u8> {
    let mut at = 0;
    while at < raw.len() {
        let (mut header, _) = Header::read_from_prefix(&raw[at..]).unwrap();
        let number = sources.iter().position(|source| *source == header.sensor());
        header.set_sensor(["first", "second"][number.unwrap()]);
        let bytes = zerocopy::IntoBytes::as_bytes(&header);
        raw[at..at + bytes.len()].copy_from_slice(bytes);
        at += header.total_bytes as usize;
    }
    raw
}

#[test]
fn a_part_is_given_by_seconds_or_by_the_time_of_day() {
    let folder = Folder::new("piece-times");
    let capture = fixture("street_vlp16_losses.pcap");
    let begun_ns = vlp16()[0].arrival_ns;
    let piece = |name: &str, start: &str, end: &str| {
        let piece = folder.path(name);
        let args = [
            "--start",
            start,
            "--end",
            end,
            "--pcap",
            piece.to_str().unwrap(),
        ];
        replay(&capture, &args).done();
        std::fs::read(piece).unwrap()
    };
    let expected = piece("relative.pcap", "0.13", "0.31");
    let since_1970 = |ns: i64| format!("{}.{:09}", ns / 1_000_000_000, ns % 1_000_000_000);
    let [start_ns, end_ns] = [130_000_000, 310_000_000].map(|ns| begun_ns + ns);
    assert!(piece("1970.pcap", &since_1970(start_ns), &since_1970(end_ns)) == expected);
    let rfc3339 = |ns: i64| {
        let seconds = (ns / 1_000_000_000).to_string();
        let date = std::process::Command::new("date")
            .args(["-u", "+%Y-%m-%dT%H:%M:%S", "-d", &format!("@{seconds}")])
            .output();
        let date = String::from_utf8(date.unwrap().stdout).unwrap();
        format!("{}.{:09}Z", date.trim(), ns % 1_000_000_000)
    };
    assert!(piece("day.pcap", &rfc3339(start_ns), &rfc3339(end_ns)) == expected);
    assert!(piece("mixed.pcap", &rfc3339(start_ns), "0.31") == expected);
    let late = replay(&capture, &["--start", "2200-01-01T00:00:00Z"]);
    late.says(&[
        "no data packets from 2200-01-01 00:00:00.000 UTC",
        "spans 0.399 s from 20",
    ]);
    let pair = ["--start=2026-01-01T00:00:00Z", "--end=1700000000"];
    replay(&capture, &pair).says(&["--end is not after --start"]);
    replay(&capture, &["--start=2026-01-01"]).says(&["such as 2026-05-04T10:16:40Z"]);
}

#[test]
fn a_piece_replaces_and_leaves_what_other_outputs_do() {
    let folder = Folder::new("piece-files");
    let bytes = pcap(&vlp16());
    let capture = folder.write("x.pcap", &bytes);
    let same = ["--start=0.2", "--pcap", capture.to_str().unwrap()];
    replay(&capture, &same).says(&["x.pcap exists; --force replaces it"]);
    assert!(std::fs::read(&capture).unwrap() == bytes);
    let expected = raw(&folder, &capture, &["--start=0.2"]).0;
    replay(&capture, &[&same[..], &["--force"]].concat()).done();
    let found = raw(&folder, &capture, &[]).0;
    assert!(counted_from_first(expected) == counted_from_first(found));

    let empty = folder.path("empty.pcap");
    let empty = empty.to_str().unwrap();
    replay(&capture, &["--start=5", "--pcap", empty]).says(&["no data packets from 5 s"]);
    replay(&capture, &["--pcap", "empty.pcapng"]).says(&["ends in .pcap or .pcap.gz, or -"]);
    replay(&capture, &["--loop", "--pcap", empty]).says(&["--loop", "--pcap"]);
    replay(&capture, &["--json", "--pcap=-"]).says(&["give --pcap a file"]);
    let mut piped = crate::command(&[
        "replay",
        capture.to_str().unwrap(),
        "--pcap=-",
        "--height=1.9",
    ]);
    let told = String::from_utf8(piped.output().unwrap().stderr).unwrap();
    assert!(
        told.starts_with("note: written: ") && told.ends_with(" to standard output\n"),
        "{told}"
    );
    assert!(
        folder
            .files("")
            .iter()
            .all(|(name, _)| name == "x.pcap" || name == "sweeps.raw")
    );
}
