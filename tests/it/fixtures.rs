//! The captures in `pcap_fixtures/` are what the simulator makes, byte by byte, and their README
//! counts them right.

use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};

use flate2::read::GzDecoder;
use sweepd_lab::simulate::fixtures::{self, Counts};

fn folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("pcap_fixtures")
}

fn bytes_of(name: &str) -> Vec<u8> {
    let path = folder().join(name);
    let file = File::open(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
    let mut reader: Box<dyn Read> = if name.ends_with(".gz") {
        Box::new(GzDecoder::new(file))
    } else {
        Box::new(file)
    };
    let mut bytes = Vec::new();
    reader.read_to_end(&mut bytes).unwrap();
    bytes
}

/// A frame of a capture: arrival, nanoseconds since 1970, IP addresses and UDP ports as they stand,
/// payload.
type Frame<'a> = (i64, [u8; 8], [u8; 4], &'a [u8]);

/// Takes a classic little-endian nanosecond capture apart, trusting nothing but the format.
fn frames(capture: &[u8]) -> Vec<Frame<'_>> {
    let u32_at = |at: usize| u32::from_le_bytes(capture[at..at + 4].try_into().unwrap());
    assert_eq!(
        (u32_at(0), u32_at(20)),
        (0xA1B2_3C4D, 1),
        "nanoseconds, Ethernet"
    );
    let mut frames = Vec::new();
    let mut at = 24;
    while at < capture.len() {
        let arrival_ns = i64::from(u32_at(at)) * 1_000_000_000 + i64::from(u32_at(at + 4));
        let len = u32_at(at + 8) as usize;
        let frame = &capture[at + 16..][..len];
        assert_eq!(
            (&frame[12..15], frame[23]),
            (&[8, 0, 0x45][..], 17),
            "IPv4 without options, UDP"
        );
        frames.push((
            arrival_ns,
            frame[26..34].try_into().unwrap(),
            frame[34..38].try_into().unwrap(),
            &frame[42..],
        ));
        at += 16 + len;
    }
    frames
}

#[test]
fn the_shipped_captures_are_what_the_simulator_makes_and_the_readme_counts_them() {
    let readme = std::fs::read_to_string(folder().join("README.md")).unwrap();
    let scene = fixtures::scene();
    for fixture in fixtures::all() {
        let shipped = bytes_of(fixture.file);
        let mut frames = frames(&shipped).into_iter();
        let mut counts = Counts::default();
        let mut whole_turns = 0;
        for (index, made) in fixture.datagrams(&scene).enumerate() {
            counts.add(&made);
            let (arrival_ns, addresses, ports, payload) =
                frames.next().expect("as many frames as datagrams");
            let place = format!("{}, frame {index}", fixture.file);
            assert_eq!(arrival_ns, made.arrival_ns, "{place}");
            assert_eq!(
                addresses,
                *[made.source.ip().octets(), made.destination.ip().octets()].as_flattened(),
                "{place}"
            );
            let expected = [
                made.source.port().to_be_bytes(),
                made.destination.port().to_be_bytes(),
            ];
            assert_eq!(ports, *expected.as_flattened(), "{place}");
            if made.truth.is_some() {
                let says_36000 = |block: &[u8]| block[2..4] == 36_000_u16.to_le_bytes();
                whole_turns += payload[..1200]
                    .chunks_exact(100)
                    .filter(|block| says_36000(block))
                    .count();
            }
            assert!(
                payload == made.payload,
                "{place}: other bytes; make the fixtures anew if that is meant"
            );
        }
        assert!(
            frames.next().is_none(),
            "{}: more frames than datagrams",
            fixture.file
        );
        assert!(whole_turns > 0, "{}: no block says 36000", fixture.file);
        let counts = counts.with(&fixture.faults);
        let row = fixture.readme_row(&counts);
        assert!(readme.contains(&row), "pcap_fixtures/README.md lacks {row}");
        if counts.lost > 0 {
            let faults = fixture.faults.to_string();
            assert!(
                readme.contains(&faults),
                "pcap_fixtures/README.md lacks {faults}"
            );
        }
    }
}

#[test]
fn the_readme_names_every_file_and_they_are_small() {
    let mut total = 0;
    for entry in std::fs::read_dir(folder()).unwrap() {
        let entry = entry.unwrap();
        let name = entry.file_name().into_string().unwrap();
        let known =
            name == "README.md" || fixtures::all().iter().any(|fixture| fixture.file == name);
        assert!(known, "{name} is no fixture");
        total += entry.metadata().unwrap().len();
    }
    assert!(total < 30_000_000, "{total} bytes");
}
