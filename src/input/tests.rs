//! The readers and the writer together, over captures built by hand.

use std::io::{self, Cursor, Read, Write};
use std::net::{SocketAddr, SocketAddrV4};

use flate2::Compression;
use flate2::write::GzEncoder;
use proptest::prelude::*;
use ruzstd::encoding::{CompressionLevel, compress_to_vec};

use super::source::ByteOrder;
use super::testutil::*;
use super::write::Addressed;
use super::*;

const ORDERS: [ByteOrder; 2] = [ByteOrder::Little, ByteOrder::Big];
const MICROSECONDS: u32 = 0xA1B2_C3D4;
const NANOSECONDS: u32 = 0xA1B2_3C4D;

fn gzip(bytes: &[u8]) -> Vec<u8> {
    let mut encoder = GzEncoder::new(Vec::new(), Compression::fast());
    encoder.write_all(bytes).unwrap();
    encoder.finish().unwrap()
}

fn lz4(bytes: &[u8]) -> Vec<u8> {
    let mut encoder = lz4_flex::frame::FrameEncoder::new(Vec::new());
    encoder.write_all(bytes).unwrap();
    encoder.finish().unwrap()
}

fn zstd(bytes: &[u8]) -> Vec<u8> {
    compress_to_vec(bytes, CompressionLevel::Fastest)
}

/// A pcap file of `count` datagrams of different lengths, by our own writer.
fn sample(count: u64) -> Vec<u8> {
    let mut writer = PcapWriter::new(Vec::new()).unwrap();
    for number in 0..count {
        let payload: Vec<u8> = (0..100 + 13 * number)
            .map(|byte| (byte * (number + 7)) as u8)
            .collect();
        let arrival_ns = 1_700_000_000_000_000_001 + number as i64 * 1_327_104;
        let (source, destination) = (
            SocketAddrV4::new(SOURCE.into(), 2368),
            SocketAddrV4::new([255; 4].into(), 2369),
        );
        writer
            .write(&Addressed {
                arrival_ns,
                source,
                destination,
                payload: &payload,
            })
            .unwrap();
    }
    writer.finish().unwrap()
}

/// A pcapng file with two sections, three interfaces, and each kind of packet block.
fn sample_ng(order: ByteOrder) -> Vec<u8> {
    let other = if order == ByteOrder::Little {
        ByteOrder::Big
    } else {
        ByteOrder::Little
    };
    [
        section(order),
        interface(order, 1, 0, &[(9, vec![9])]),
        interface(order, 101, 0, &[(2, b"lo".to_vec())]),
        enhanced(order, 0, 5, &frame(b"one")),
        block(order, 0xBAD, vec![1; 40]),
        enhanced(order, 1, 6, &ipv4(b"two")),
        section(other),
        interface(
            other,
            1,
            0,
            &[(9, vec![0x80 | 20]), (14, other.put64(100).to_vec())],
        ),
        enhanced(other, 0, 3 << 19, &frame(b"three")),
    ]
    .concat()
}

#[test]
fn pcap_in_either_order_and_resolution() {
    for order in ORDERS {
        for (magic, time_ns) in [
            (MICROSECONDS, 3_000_000_007_000_004_000),
            (NANOSECONDS, 3_000_000_007_000_000_004),
        ] {
            let seconds = 3_000_000_007;
            let file = pcap(order, magic, 1, &[(seconds, 4, b"abc"), (seconds, 4, b"")]);
            let expected = vec![(Some(time_ns), b"abc".to_vec()), (Some(time_ns), vec![])];
            assert_eq!(records(&file), (expected, None));
        }
    }
}

#[test]
fn pcap_header_flags_beside_the_link_type_are_passed_over() {
    let file = pcap(
        ByteOrder::Little,
        MICROSECONDS,
        0x5400_0001,
        &[(1, 0, b"abc")],
    );
    assert_eq!(
        reader(&file).next().unwrap().unwrap().link_type,
        LinkType::ETHERNET
    );
}

#[test]
fn records_know_their_place() {
    let file = pcap(
        ByteOrder::Big,
        MICROSECONDS,
        1,
        &[(1, 0, b"abc"), (2, 0, b"de")],
    );
    let mut reader = reader(&file);
    reader.next().unwrap();
    let record = reader.next().unwrap().unwrap();
    assert_eq!(
        (
            record.number,
            record.offset,
            record.original_len,
            record.bytes
        ),
        (1, 43, 2, &b"de"[..])
    );
    assert_eq!(reader.next().unwrap(), None);
    assert_eq!(reader.record(), None);
}

#[test]
fn pcapng_resolutions_and_offsets() {
    for order in ORDERS {
        for (resolution, ticks, time_ns) in [
            (None, 1_700_000_000_000_005, 1_700_000_000_000_005_000),
            (Some(3), 1_700_000_000_005, 1_700_000_000_005_000_000),
            (Some(6), 7, 7_000),
            (
                Some(9),
                1_700_000_000_000_000_005,
                1_700_000_000_000_000_005,
            ),
            (Some(0x80 | 20), 5 << 18, 1_250_000_000),
        ] {
            for offset_s in [0, 1_000, -1_000] {
                let mut options = vec![(14, order.put64(offset_s).to_vec())];
                options.extend(resolution.map(|byte| (9, vec![byte])));
                let file = [
                    section(order),
                    interface(order, 1, 0, &options),
                    enhanced(order, 0, ticks, b"x"),
                ]
                .concat();
                let expected = vec![(Some(time_ns + offset_s * 1_000_000_000), b"x".to_vec())];
                assert_eq!(
                    records(&file),
                    (expected, None),
                    "{order:?} {resolution:?} {offset_s}"
                );
            }
        }
    }
}

#[test]
fn pcapng_with_several_interfaces_and_sections() {
    for order in ORDERS {
        let (all, capture) = datagrams(&sample_ng(order)).unwrap();
        let expected = [
            (5, b"one".to_vec()),
            (6_000, b"two".to_vec()),
            (101_500_000_000, b"three".to_vec()),
        ];
        assert_eq!((&all[..], capture.truncation()), (&expected[..], None));
        assert_eq!(capture.link_types(), [LinkType::ETHERNET, LinkType::RAW]);
        assert_eq!(
            (capture.first_ns(), capture.last_ns()),
            (Some(5), Some(101_500_000_000))
        );
        assert_eq!(
            capture.counts(),
            CaptureCounts {
                records: 3,
                datagrams: 3,
                ..CaptureCounts::default()
            }
        );
    }
}

#[test]
fn a_new_section_forgets_the_interfaces_of_the_last() {
    let order = ByteOrder::Little;
    let file = [
        section(order),
        interface(order, 1, 0, &[]),
        section(order),
        enhanced(order, 0, 0, b"x"),
    ]
    .concat();
    let (all, end) = records(&file);
    assert!(all.is_empty());
    assert_eq!(
        end.unwrap(),
        "the capture breaks off at record 0 (byte 80): it comes from interface 0, but the section describes 0"
    );
}

#[test]
fn simple_and_obsolete_packet_blocks() {
    for order in ORDERS {
        let simple =
            |len: u32, bytes: &[u8]| block(order, 3, [&order.put32(len)[..], bytes].concat());
        let mut obsolete = [order.put16(1), order.put16(0xFFFF)].concat();
        obsolete.extend([0, 9, 2, 2].map(|word| order.put32(word)).as_flattened());
        obsolete.extend(b"old!");
        let file = [
            section(order),
            interface(order, 1, 6, &[]),
            interface(order, 101, 0, &[]),
            simple(5, b"abcde"),
            block(order, 2, obsolete),
            simple(9, b"abcdef"),
        ]
        .concat();
        let expected = vec![
            (None, b"abcde".to_vec()),
            (Some(9_000), b"ol".to_vec()),
            (None, b"abcdef".to_vec()),
        ];
        assert_eq!(records(&file), (expected, None), "{order:?}");
    }
}

#[test]
fn a_record_without_time_takes_that_of_the_one_before() {
    let order = ByteOrder::Little;
    let bytes = frame(b"x");
    let simple = block(
        order,
        3,
        [&order.put32(bytes.len() as u32)[..], &bytes].concat(),
    );
    let file = [
        section(order),
        interface(order, 1, 0, &[]),
        simple.clone(),
        enhanced(order, 0, 9, &bytes),
        simple,
    ]
    .concat();
    let (all, capture) = datagrams(&file).unwrap();
    assert_eq!(
        all.iter().map(|(time_ns, _)| *time_ns).collect::<Vec<_>>(),
        [0, 9_000, 9_000]
    );
    assert_eq!(
        (capture.counts().untimed, capture.first_ns()),
        (2, Some(9_000))
    );
}

#[test]
fn what_the_writer_wrote_comes_back() {
    let (all, capture) = datagrams(&sample(5)).unwrap();
    assert_eq!(
        (all.len(), all[4].1.len(), all[4].0),
        (5, 152, 1_700_000_000_005_308_417)
    );
    assert_eq!(
        capture.counts(),
        CaptureCounts {
            records: 5,
            datagrams: 5,
            ..CaptureCounts::default()
        }
    );
    let file = sample(1);
    let mut capture = Capture::new("test", Box::new(Cursor::new(file.clone()))).unwrap();
    let datagram = capture.next_datagram().unwrap().unwrap();
    assert_eq!(
        datagram.source,
        "192.168.1.201:2368".parse::<SocketAddr>().unwrap()
    );
    assert_eq!(datagram.destination_port, 2369);
    // The checksum holds if the sum over the whole header is all ones (RFC 1071).
    let header = &file[24 + 16 + 14..][..20];
    let sum: u32 = header
        .chunks(2)
        .map(|pair| u32::from(u16::from_be_bytes([pair[0], pair[1]])))
        .sum();
    assert_eq!((sum & 0xFFFF) + (sum >> 16), 0xFFFF);
}

#[test]
fn the_writer_refuses_what_does_not_fit() {
    let mut writer = PcapWriter::new(Vec::new()).unwrap();
    let address = SocketAddrV4::new(SOURCE.into(), 2368);
    let fits = Addressed {
        arrival_ns: 0,
        source: address,
        destination: address,
        payload: &[0; 65_507],
    };
    writer.write(&fits).unwrap();
    for bad in [
        Addressed {
            arrival_ns: -1,
            ..fits
        },
        Addressed {
            arrival_ns: i64::MAX,
            ..fits
        },
        Addressed {
            payload: &[0; 65_508],
            ..fits
        },
    ] {
        assert_eq!(
            writer.write(&bad).unwrap_err().kind(),
            io::ErrorKind::InvalidInput
        );
    }
    assert_eq!(
        datagrams(&writer.finish().unwrap()).unwrap().0[0].1.len(),
        65_507
    );
}

#[test]
fn compressed_captures_of_one_or_several_members() {
    let file = sample(40);
    let plain = datagrams(&file).unwrap().0;
    let (front, back) = file.split_at(1_000);
    let skippable = [&[0x50, 0x2A, 0x4D, 0x18, 3, 0, 0, 0][..], b"abc"].concat();
    for compressed in [
        gzip(&file),
        [gzip(front), gzip(back)].concat(),
        zstd(&file),
        [zstd(front), skippable, zstd(back)].concat(),
        [lz4(front), lz4(back)].concat(),
    ] {
        let (all, capture) = datagrams(&compressed).unwrap();
        assert!(all == plain && capture.truncation().is_none());
    }
}

/// People join the files of a recording with `cat`.
#[test]
fn a_second_file_behind_the_first_is_read_on() {
    let mut files = vec![sample(3), sample_ng(ByteOrder::Little)];
    let times = [(1, 0, &b"abc"[..]), (2, 5, &b""[..])];
    files.extend(ORDERS.map(|order| pcap(order, NANOSECONDS, 101, &times)));
    for (first, second) in files
        .iter()
        .flat_map(|one| files.iter().map(move |two| (one, two)))
    {
        let [(mut expected, _), (more, _)] = [records(first), records(second)];
        expected.extend(more);
        let (all, end) = records(&[&first[..], second].concat());
        assert_eq!((all, end), (expected, None));
    }
}

#[test]
fn a_frame_that_was_sent_short_is_not_cut_short() {
    let (order, frame) = (ByteOrder::Little, frame(b"abc"));
    let short: [(u32, u32, &[u8]); 4] = [
        (1, 0, &frame[..]),
        (1, 1, &[]),
        (1, 2, &[0xFF; 10]),
        (1, 3, &frame[..16]),
    ];
    let mut file = pcap(order, MICROSECONDS, 1, &short);
    let (_, capture) = datagrams(&file).unwrap();
    let counts = capture.counts();
    assert_eq!(
        (
            counts.datagrams,
            counts.truncated_records,
            counts.other_traffic()
        ),
        (1, 0, 3)
    );
    // The last one lost its end when it was captured.
    let original_len = file.len() - 16 - 4;
    file[original_len..][..4].copy_from_slice(&(frame.len() as u32).to_le_bytes());
    let (_, capture) = datagrams(&file).unwrap();
    let counts = capture.counts();
    assert_eq!((counts.truncated_records, counts.other_traffic()), (1, 2));
}

#[test]
fn bare_packets_have_the_clock_of_the_sensor() {
    let packet = |bank: u8, stamp_us: u32| {
        let mut bytes = [1; 1206];
        bytes[..2].copy_from_slice(&[0xFF, bank]);
        bytes[1200..1204].copy_from_slice(&stamp_us.to_le_bytes());
        bytes.to_vec()
    };
    let position = |stamp_us: u32, sentence: &[u8]| {
        let mut bytes = vec![0; 512];
        bytes[0xC6..][..4].copy_from_slice(&stamp_us.to_le_bytes());
        bytes[0xCE..][..sentence.len()].copy_from_slice(sentence);
        bytes
    };
    let file = [
        position(3_599_998_000, b""),
        packet(0xDD, 3_599_999_000),
        position(0, b"$GPRMC,"),
        packet(0xEE, 327),
        packet(0xEE, 200),
    ]
    .concat();
    let (all, capture) = datagrams(&file).unwrap();
    let found: Vec<_> = all.iter().map(|one| (one.0 / 1000, one.1.len())).collect();
    let expected = [
        (3_599_998_000, 512),
        (3_599_999_000, 1206),
        (3_599_999_000, 512),
        (3_600_000_327, 1206),
        (3_600_000_200, 1206),
    ];
    assert_eq!((&found[..], capture.truncation()), (&expected[..], None));
    let (all, capture) = datagrams(&file[512..2512]).unwrap();
    let says = "the capture breaks off at record 2 (byte 1718): the file ends inside it";
    assert_eq!(
        (all.len(), capture.truncation().unwrap().to_string()),
        (2, says.to_owned())
    );
    // Neither text nor a hole of zeros is a packet.
    for other in [&[b'x'; 2000], &[0; 2000]] {
        let (all, capture) = datagrams(&[&file[512..1718], other].concat()).unwrap();
        let says = capture.truncation().unwrap().to_string();
        assert!(
            all.len() == 1 && says.contains("its packet is damaged"),
            "{says}"
        );
    }
    assert!(datagrams(&[0; 4000]).is_none());
}

/// The record time of a packet, microseconds, by its number.
type RecordUs<'a> = &'a dyn Fn(u64) -> u64;

/// Data packets with these stamps of the sensor and record times, microseconds: the times that are
/// read, and what is said of them.
fn times_of(packets: impl Iterator<Item = (u64, u64)>) -> (Vec<u64>, Option<&'static str>) {
    let frames = packets.map(|(sensor_us, record_us)| {
        let mut packet = [1; 1206];
        let stamp_us = (sensor_us % 3_600_000_000) as u32;
        packet[1200..1204].copy_from_slice(&stamp_us.to_le_bytes());
        let seconds = (record_us / 1_000_000) as u32;
        (seconds, (record_us % 1_000_000) as u32, frame(&packet))
    });
    let frames: Vec<_> = frames.collect();
    let frames: Vec<_> = (frames.iter().map(|(s, us, frame)| (*s, *us, &frame[..]))).collect();
    let file = pcap(ByteOrder::Little, MICROSECONDS, 1, &frames);
    let (all, capture) = datagrams(&file).unwrap();
    let (counts, count) = (capture.counts(), frames.len() as u64);
    assert_eq!((counts.records, counts.datagrams), (count, count));
    let times = all.iter().map(|one| (one.0 / 1000) as u64).collect();
    (times, capture.remark())
}

#[test]
fn record_times_that_are_none_give_way_to_the_clock_of_the_sensor() {
    const START_US: u64 = 1_700_000_000_400_000;
    let right = |number: u64| START_US + number * 1000;
    let whole = |us: u64| us / 1_000_000 * 1_000_000;
    let cases: [(&str, u64, RecordUs<'_>); 9] = [
        ("never set", 0, &|_| 0),
        ("stand", START_US, &|_| START_US),
        ("whole seconds", whole(START_US), &|n| whole(right(n))),
        ("go back", START_US, &|n| START_US - n * 40),
        ("ticks of a message", START_US, &|n| right(n / 100 * 100)),
        ("are set back", START_US, &|n| {
            right(n) - if n < 450 { 0 } else { 5_000_000 }
        }),
        ("are set back by days", START_US, &|n| {
            right(n) - if n < 450 { 0 } else { 300_005_000_000 }
        }),
        ("lose their seconds", START_US, &|n| {
            whole(START_US) + right(n) % 1_000_000
        }),
        ("begin with 0", START_US + 1000, &|n| {
            right(n) * u64::from(n > 0)
        }),
    ];
    for (name, first_us, record_us) in cases {
        let expected: Vec<u64> = (0..900).map(|n| first_us + n * 1000).collect();
        let sensor_us = |n| 3_599_950_000 + n * 1000;
        let (times, remark) = times_of((0..900).map(|n| (sensor_us(n), record_us(n))));
        assert_eq!(times, expected, "{name}");
        assert!(
            remark.unwrap().contains("the sensor's clock gives"),
            "{name}"
        );
    }
}

#[test]
fn record_times_that_go_on_stay() {
    const START_US: u64 = 1_700_000_000_400_000;
    let right = |number: u64| START_US + number * 1000;
    let cases: [(&str, RecordUs<'_>); 9] = [
        ("burst", &|n| right(n.max(30))),
        ("ticks of Windows", &|n| right(n) / 15_600 * 15_600),
        ("late ones", &|n| right(n ^ 1)),
        ("a corrupt one", &|n| {
            right(n) + u64::from(n == 300) * 9_000_000_000_000
        }),
        ("a corrupt first one", &|n| {
            right(n) + u64::from(n == 0) * 9_000_000_000_000
        }),
        ("old", &|n| right(n) - START_US + 5),
        // Two recordings are joined in the wrong order.
        ("joined", &|n| right(n) + u64::from(n < 450) * 700_000),
        // So are files of an hour each, or of two sensors that were just switched on.
        ("joined by the hour", &|n| {
            right(n) + u64::from(n < 450) * 2 * 3_600_000_000
        }),
        ("joined after a pause", &|n| {
            right(n) + u64::from(n < 450) * 5_000_000_000
        }),
    ];
    for (name, record_us) in cases {
        let sensor_us = |n| match name {
            "joined" => record_us(n),
            "joined after a pause" => n * 1000 + u64::from(n >= 450) * 3_000_000,
            _ => n * 1000,
        };
        let (times, remark) = times_of((0..900).map(|n| (sensor_us(n), record_us(n))));
        let expected: Vec<u64> = (0..900).map(record_us).collect();
        let differs = times
            .iter()
            .zip(&expected)
            .find(|(one, other)| one != other);
        assert_eq!(differs, None, "{name}");
        let is_old = remark.is_some_and(|remark| remark.contains("lie before 1990: the clock"));
        assert_eq!((is_old, remark.is_some()), (name == "old", name == "old"));
    }
}

#[test]
fn an_archive_is_refused_with_the_command_that_unpacks_it() {
    for (head, says) in [
        (&b"\xFD7zXZ\0\0\x04"[..], "`xz -dc FILE | sweepd replay -`"),
        (
            &b"PK\x03\x04\x14\0"[..],
            "`unzip -p FILE | sweepd replay -`",
        ),
    ] {
        let source = Box::new(Cursor::new(head.to_vec()));
        let error = Capture::new("drive", source).err().unwrap().to_string();
        assert!(error.contains(says), "{error}");
    }
}

#[test]
fn a_cut_capture_gives_what_it_holds_and_says_where_it_ends() {
    let file = sample(3);
    let (all, end) = records(&file[..file.len() - 1]);
    assert_eq!(all.len(), 2);
    assert_eq!(
        end.unwrap(),
        "the capture breaks off at record 2 (byte 353): the file ends inside it"
    );
    let (all, end) = records(&file[..353]);
    assert_eq!((all.len(), end), (2, None));
}

#[test]
fn a_cut_compressed_stream_gives_nearly_all_before_the_cut() {
    let file = sample(400);
    for (format, compressed) in [("gzip", gzip(&file)), ("zstd", zstd(&file))] {
        let (all, end) = records(&compressed[..compressed.len() - 6]);
        // zstd codes blocks of 128 KiB as a whole, and of this file the last is small.
        assert!(all.len() > 300, "{format}: {}", all.len());
        assert!(
            end.as_ref()
                .unwrap()
                .contains(&format!("the {format} stream is cut or corrupt")),
            "{end:?}"
        );
    }
}

#[test]
fn a_corrupt_zstd_checksum_is_reported() {
    let mut compressed = zstd(&sample(3));
    *compressed.last_mut().unwrap() ^= 1;
    let (all, end) = records(&compressed);
    assert_eq!(all.len(), 3);
    assert!(end.unwrap().contains("checksum"));
}

#[test]
fn absurd_lengths_end_the_reading() {
    let mut file = pcap(ByteOrder::Little, MICROSECONDS, 1, &[(1, 0, b"abc")]);
    file.extend([1, 0, u32::MAX, 5].map(u32::to_le_bytes).as_flattened());
    let (all, end) = records(&file);
    assert_eq!(all.len(), 1);
    assert!(
        end.unwrap().contains(
            "record 1 (byte 43): it claims 4294967295 captured bytes, more than the 262144"
        )
    );

    let order = ByteOrder::Little;
    let start = [section(order), interface(order, 1, 0, &[])].concat();
    for (length, says) in [
        (0, "a pcapng block of type 0x00000006 claims 0 bytes"),
        (14, "claims 14 bytes"),
        (16, "claims 16 bytes"),
        (u32::MAX - 3, "the file ends inside it"),
    ] {
        let file = [&start[..], &order.put32(6), &order.put32(length), &[0; 24]].concat();
        let (all, end) = records(&file);
        assert!(
            all.is_empty() && end.as_ref().unwrap().ends_with(says),
            "{length}: {end:?}"
        );
    }
    let mut bad_end = [&start[..], &enhanced(order, 0, 0, b"x")].concat();
    *bad_end.last_mut().unwrap() = 1;
    assert!(
        records(&bad_end)
            .1
            .unwrap()
            .contains("begins with length 40 and ends with length 16777256")
    );
}

#[test]
fn endless_interfaces_are_bounded() {
    let order = ByteOrder::Little;
    let file = [section(order), interface(order, 1, 0, &[]).repeat(1025)].concat();
    assert!(
        records(&file)
            .1
            .unwrap()
            .ends_with("describes more than 1024 interfaces")
    );
}

#[test]
fn what_is_no_capture_is_named() {
    let zero_head = [0; 40];
    let mut wrong_version = section(ByteOrder::Little);
    wrong_version[12] = 2;
    for (bytes, found) in [
        (&b""[..], "nothing, it is empty"),
        (b"\x89PNG\r\n\x1A\n", "a PNG image"),
        (
            b"hello, world\n",
            "text that begins with \"hello, world\\n\"",
        ),
        (&zero_head, "bytes that begin with 00 00 00 00 00 00 00 00"),
        (
            &sample(1)[..23],
            "the start of a capture, cut inside the file header",
        ),
        (&gzip(b"\x89PNG"), "gzip of something else: a PNG image"),
        (
            &gzip(&sample(1))[..12],
            "a file header that is damaged (the gzip stream is cut or corrupt",
        ),
        (
            &wrong_version,
            "a file header that is damaged (a pcapng section begins with byte-order mark 0x4d3c2b1a and",
        ),
    ] {
        let error = Capture::new("drive.pcap", Box::new(Cursor::new(bytes.to_vec())))
            .err()
            .unwrap()
            .to_string();
        assert!(
            error.starts_with(&format!("drive.pcap is no capture: it holds {found}")),
            "{error}"
        );
        assert!(error.contains("expected pcap or pcapng"), "{error}");
    }
    let error = Capture::open("no/such/file.pcap").err().unwrap();
    assert!(
        matches!(error, CaptureError::Open { .. })
            && error.to_string().contains("no/such/file.pcap")
    );
}

/// Gives one byte at a time, with interruptions, and fails at the end.
struct Reluctant(Cursor<Vec<u8>>, bool);

impl Read for Reluctant {
    fn read(&mut self, target: &mut [u8]) -> io::Result<usize> {
        self.1 = !self.1;
        if self.1 {
            return Err(io::ErrorKind::Interrupted.into());
        }
        match self.0.read(&mut target[..1])? {
            0 => Err(io::Error::from_raw_os_error(5)),
            len => Ok(len),
        }
    }
}

fn read_to_error(bytes: Vec<u8>) -> Result<(), CaptureError> {
    let mut reader = CaptureReader::new("pipe", Box::new(Reluctant(Cursor::new(bytes), false)))?;
    loop {
        if let Err(error) = reader.advance() {
            assert!(reader.next().unwrap().is_none() && reader.truncation().is_none());
            return Err(error);
        }
    }
}

#[test]
fn a_failing_disk_is_an_error_and_not_the_end_of_the_capture() {
    let file = sample(3);
    for mut bytes in [file.clone(), gzip(&file), zstd(&file)] {
        bytes.pop();
        let error = read_to_error(bytes).unwrap_err();
        assert!(matches!(error, CaptureError::Read { .. }), "{error}");
    }
}

fn any_sample() -> impl Strategy<Value = Vec<u8>> {
    let plain = prop_oneof![
        Just(sample(6)),
        Just(sample_ng(ByteOrder::Little)),
        Just(sample_ng(ByteOrder::Big))
    ];
    (plain, 0..3).prop_map(|(plain, packing)| match packing {
        0 => plain,
        1 => gzip(&plain),
        _ => zstd(&plain),
    })
}

proptest! {
    #[test]
    fn any_bytes_are_read_or_refused(bytes in proptest::collection::vec(any::<u8>(), 0..400)) {
        datagrams(&bytes);
        for start in [&sample(0), &sample_ng(ByteOrder::Big)] {
            datagrams(&[&start[..], &bytes].concat());
        }
    }

    #[test]
    fn mutated_captures_are_read_or_refused(
        mut file in any_sample(),
        places in proptest::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..8),
    ) {
        for (place, byte) in places {
            let at = place.index(file.len());
            file[at] = byte;
        }
        datagrams(&file);
    }

    #[test]
    fn a_cut_capture_gives_the_first_datagrams(file in any_sample(), at in any::<prop::sample::Index>()) {
        let whole = datagrams(&file).unwrap().0;
        if let Some((all, capture)) = datagrams(&file[..at.index(file.len())]) {
            prop_assert!(whole.starts_with(&all));
            let tally = capture.counts();
            prop_assert_eq!(tally.records, tally.datagrams);
        }
    }
}
