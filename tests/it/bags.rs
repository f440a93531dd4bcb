//! Bags made here: every format, compression and byte order; cut at any byte; with several topics,
//! or none of packets.

use std::io::Cursor;
use std::path::Path;

use sweepd::input::{Capture, CaptureCounts};
use sweepd_testkit::{
    bags::{self, ROS1_SCAN, mcap, ros1, ros1_scan},
    scan::{SCAN, Stamped, cdr},
};

const S: i64 = 1_000_000_000;
const MS: i64 = 1_000_000;

/// A packet as it was read: time, first and last byte of its data, topic.
type Read = (i64, [u8; 2], String);

fn open(file: &[u8]) -> Result<Capture, String> {
    let source = Box::new(Cursor::new(file.to_vec()));
    Capture::new("drive.bag", source).map_err(|error| error.to_string())
}

/// All packets, and where it breaks off.
fn read(mut capture: Capture) -> (Vec<Read>, Option<String>) {
    let mut all = Vec::new();
    while let Some(placed) = capture.next_placed().unwrap() {
        let payload = placed.datagram.payload;
        assert_eq!((payload.len(), placed.record), (1206, all.len() as u64));
        let topic = placed.topic.unwrap().to_owned();
        all.push((
            placed.datagram.arrival_ns,
            [payload[0], payload[1205]],
            topic,
        ));
    }
    assert_eq!(capture.counts().datagrams, all.len() as u64);
    (all, capture.truncation().map(ToString::to_string))
}

/// What these packets are read as, on this topic.
fn expected(packets: &[Stamped], topic: &str) -> Vec<Read> {
    let read = |&(stamp_ns, byte)| (stamp_ns, [byte; 2], topic.to_owned());
    packets.iter().map(read).collect()
}

/// Packets of three messages.
fn three() -> Vec<Vec<Stamped>> {
    vec![
        vec![(1_700_000_000 * S + 1, 1), (1_700_000_000 * S + 2 * MS, 2)],
        vec![(1_700_000_000 * S + 3 * MS, 3)],
        vec![(1_700_000_000 * S + 4 * MS, 4), (1_700_000_001 * S, 5)],
    ]
}

/// The three messages, each in a chunk of its own.
fn mcap_of_three(compression: &str, big_endian: bool) -> Vec<u8> {
    let names = [
        mcap::schema(3, "std_msgs/msg/String"),
        mcap::schema(4, SCAN),
        mcap::channel(1, 3, "/chatter", "cdr"),
        mcap::channel(2, 4, "/velodyne_packets", "cdr"),
    ];
    let mut records = vec![mcap::record(9, &[1; 3000])];
    for (number, packets) in three().iter().enumerate() {
        let names = if number == 0 {
            names.concat()
        } else {
            Vec::new()
        };
        let messages = [
            mcap::message(1, &[9; 5000]),
            mcap::message(2, &cdr(packets, big_endian)),
        ];
        records.push(mcap::chunk(
            compression,
            &[names, messages.concat()].concat(),
        ));
        records.push(mcap::record(7, &[0; 6]));
    }
    mcap::file(&records)
}

fn bag_of_three(compression: &str) -> Vec<u8> {
    let names = [
        ros1::connection(8, "/chatter", "std_msgs/String"),
        ros1::connection(9, "velodyne_packets", ROS1_SCAN),
    ];
    let mut records = Vec::new();
    for (number, packets) in three().iter().enumerate() {
        let names = if number == 0 {
            names.concat()
        } else {
            Vec::new()
        };
        let messages = [
            ros1::message(8, &[9; 5000]),
            ros1::message(9, &ros1_scan(packets)),
        ];
        records.push(ros1::chunk(
            compression,
            &[names, messages.concat()].concat(),
        ));
        records.push(ros1::record(&[("op", &[4])], &[0; 12]));
    }
    ros1::file(true, &records)
}

#[test]
fn a_message_is_read_as_its_specification_says() {
    let le = cdr(&[(5, 0xAB)], false);
    // Encapsulation, stamp, length and text of the frame id, its padding, count, stamp of the packet.
    let head = [
        [0, 1, 0, 0],
        [7, 0, 0, 0],
        [8, 0, 0, 0],
        [6, 0, 0, 0],
        *b"lida",
        *b"r\0\0\0",
        [1, 0, 0, 0],
        [0; 4],
        [5, 0, 0, 0],
    ];
    assert_eq!((&le[..36], le.len()), (head.as_flattened(), 36 + 1206));
    let records = |message: &[u8]| {
        let names = [mcap::schema(1, SCAN), mcap::channel(0, 1, "points", "cdr")].concat();
        mcap::file(&[names, mcap::message(0, message)])
    };
    let padded = [&le[..], &[0; 2]].concat();
    for message in [le.clone(), padded, cdr(&[(5, 0xAB)], true)] {
        let all = read(open(&records(&message)).unwrap());
        assert_eq!(all, (expected(&[(5, 0xAB)], "/points"), None));
    }
    // Before 1970: ROS 2 signs its seconds.
    let early = cdr(&[(-S / 2, 1)], true);
    assert_eq!(read(open(&records(&early)).unwrap()).0[0].0, -S / 2);
    // A byte too many or too few, another encapsulation, a count that is a lie.
    let mut lies = le.clone();
    lies[24..28].copy_from_slice(&u32::MAX.to_le_bytes());
    let mut xml = le.clone();
    xml[1] = 4;
    let long = [&le[..], &[0; 4]].concat();
    for message in [&le[..1000], &le[..10], &long, &lies, &xml, &[]] {
        let mut capture = open(&records(message)).unwrap();
        assert!(capture.next_datagram().unwrap().is_none());
        let counts = CaptureCounts {
            records: 1,
            malformed: 1,
            ..CaptureCounts::default()
        };
        assert_eq!(capture.counts(), counts);
    }
}

#[test]
fn every_format_and_compression_gives_the_same_packets() {
    let all = (expected(&three().concat(), "/velodyne_packets"), None);
    for compression in ["none", "zstd", "lz4"] {
        for big_endian in [false, true] {
            let file = mcap_of_three(compression, big_endian);
            assert_eq!(read(open(&file).unwrap()), all, "{compression}");
            assert_eq!(read(open(&bags::compress("zstd", &file)).unwrap()), all);
        }
    }
    for compression in ["none", "lz4", "bz2"] {
        assert_eq!(
            read(open(&bag_of_three(compression)).unwrap()),
            all,
            "{compression}"
        );
    }
    // An MCAP file of ROS 1 messages, compressed one by one as rosbag2 can.
    let names = [
        mcap::schema(1, ROS1_SCAN),
        mcap::channel(0, 1, "velodyne_packets", "ros1"),
    ];
    let messages = three()
        .into_iter()
        .map(|packets| mcap::message(0, &bags::compress("zstd", &ros1_scan(&packets))));
    let file = mcap::file(&[names.concat(), messages.collect::<Vec<_>>().concat()]);
    assert_eq!(read(open(&file).unwrap()), all);
}

/// Reads each part of a bag from its start: the first packets and no others, and more from a longer
/// part.
fn cut(file: &[u8]) {
    let all = expected(&three().concat(), "/velodyne_packets");
    let mut most = 0;
    for len in (0..=file.len()).step_by(7).chain([file.len()]) {
        match open(&file[..len]) {
            Ok(capture) => {
                let (some, end) = read(capture);
                assert!(some.len() >= most && some[..] == all[..some.len()], "{len}");
                most = most.max(some.len());
                if some.len() < all.len() {
                    let end = end.expect("it is cut");
                    assert!(end.starts_with("the capture breaks off at record"), "{end}");
                }
            }
            Err(error) => {
                assert!(most == 0 && error.contains("drive"), "{len}: {error}");
                let is_told = ["is no capture", "is a bag without", "breaks off"];
                assert!(is_told.iter().any(|part| error.contains(part)), "{error}");
            }
        }
    }
    assert_eq!(most, all.len());
}

#[test]
fn a_bag_that_is_cut_gives_what_it_holds_and_says_where_it_ends() {
    let mut files: Vec<Vec<u8>> = ["none", "zstd", "lz4"]
        .map(|compression| mcap_of_three(compression, false))
        .to_vec();
    files.extend(["none", "lz4", "bz2"].map(bag_of_three));
    for file in files {
        cut(&file);
    }
}

#[test]
fn what_a_stopped_recorder_leaves_is_read() {
    let finished = mcap_of_three("zstd", false);
    // Without the end of the data, the footer and the magic bytes.
    let (all, end) = read(open(&finished[..finished.len() - 13 - 29 - 8]).unwrap());
    assert_eq!(all, expected(&three().concat(), "/velodyne_packets"));
    let says = "the bag is unfinished: its recorder was stopped before it wrote the end";
    assert!(end.unwrap().ends_with(says));

    // roscpp writes the length of a chunk when the chunk is full.
    let open_chunk = [
        ros1::record(
            &[("op", &[5]), ("compression", b"none"), ("size", &[0; 4])],
            &[],
        ),
        ros1::connection(0, "/velodyne_packets", ROS1_SCAN),
        ros1::message(0, &ros1_scan(&[(5, 1), (6, 2)])),
    ];
    let (all, end) = read(open(&ros1::file(false, &open_chunk)).unwrap());
    assert_eq!(all, expected(&[(5, 1), (6, 2)], "/velodyne_packets"));
    assert!(end.unwrap().ends_with(says));
}

#[test]
fn each_topic_is_a_sensor_and_packets_come_in_the_order_of_time() {
    let names = [
        mcap::schema(1, SCAN),
        mcap::channel(0, 1, "/left", "cdr"),
        mcap::channel(1, 1, "/right", "cdr"),
        mcap::channel(2, 1, "/silent", "cdr"),
    ];
    let scan = |channel: u16, start_ms: i64| {
        let packets: Vec<Stamped> = (0..4)
            .map(|n| ((start_ms + 10 * n) * MS, channel as u8))
            .collect();
        mcap::message(channel, &cdr(&packets, false))
    };
    let scans = [
        scan(0, 0),
        scan(1, 5),
        scan(0, 40),
        scan(1, 45),
        scan(0, 80),
    ];
    let mut capture = open(&mcap::file(&[names.concat(), scans.concat()])).unwrap();
    let mut sensors = sweepd::admission::DiscoveredSensors::default();
    let mut times = Vec::new();
    let mut sources = std::collections::HashMap::new();
    while let Some(placed) = capture.next_placed().unwrap() {
        let topic = placed.topic.unwrap().to_owned();
        let source = *sources.entry(topic).or_insert(placed.datagram.source);
        assert_eq!(source, placed.datagram.source);
        let _ = sensors.admit_from(&placed.datagram, placed.topic);
        times.push(placed.datagram.arrival_ns / MS);
    }
    assert_eq!((times.len(), sources.len()), (20, 2));
    // The second topic is not known before its first message: up to there nothing waits for it.
    assert!(times[4..].is_sorted(), "{times:?}");
}

/// The definition of a fork's scan, with one number of eight bytes before the packets.
fn unified(header: &str) -> String {
    let line = "=".repeat(80);
    format!(
        "# A turn.\nuint8 VERSION=2\nstd_msgs/Header header  # when\nuint64 basetime\nFiring[] packets\n{line}\n\
         MSG: std_msgs/Header\n{header}string frame_id\n{line}\nMSG: fork_msgs/Firing\ntime stamp\nuint8[1206] data\n"
    )
}

/// What a fork calls a scan is one by its definition, or by its name where there is none; what says
/// nothing of its encoding is CDR.
#[test]
fn scans_of_other_packages_are_read() {
    let packets = &three()[0];
    let insert = |mut message: Vec<u8>, at: usize, len: usize| {
        message.splice(at..at, vec![9; len]);
        message
    };
    let plain = "std_msgs/Header header";
    for (kind, definition, encoding, message) in [
        (SCAN, plain, "", cdr(packets, true)),
        (
            "sensor_interface/msg/VelodyneScan",
            plain,
            "cdr",
            cdr(packets, false),
        ),
        // Four bytes of padding come before the number.
        (
            "fork_msgs/msg/Turn",
            &unified("time stamp\n"),
            "",
            insert(cdr(packets, false), 24, 12),
        ),
        (
            "fork_msgs/Turn",
            &unified("uint32 seq\ntime stamp\n"),
            "ros1",
            insert(ros1_scan(packets), 21, 8),
        ),
    ] {
        let names = [
            mcap::schema_of(1, kind, definition),
            mcap::channel(0, 1, "/left", encoding),
        ];
        let file = mcap::file(&[names.concat(), mcap::message(0, &message)]);
        assert_eq!(
            read(open(&file).unwrap()),
            (expected(packets, "/left"), None),
            "{kind}"
        );
    }
    // Any list of something else is none, and the message does not say that packets are missing.
    let definition = unified("time stamp\n").replace("1206", "1248");
    let names = [
        mcap::schema_of(1, "fork_msgs/msg/Scan", &definition),
        mcap::channel(0, 1, "/left", "cdr"),
    ];
    let error = open(&mcap::file(&names)).err().unwrap();
    assert!(
        error.contains("/left (fork_msgs/msg/Scan) may hold packets") && !error.contains("Record"),
        "{error}"
    );
}

/// Of these stamps, three in each of three messages, what is read: the packets' times, and whether
/// something is said of them. Message by message, the record time moves on as the packets do.
fn times_of(stamps: [i64; 9], logged_ns: [i64; 3]) -> [(Vec<i64>, bool); 2] {
    let mut messages = [Vec::new(), Vec::new()];
    for (number, stamps) in stamps.chunks(3).enumerate() {
        let packets: Vec<Stamped> = (1..)
            .zip(stamps)
            .map(|(n, &ns)| (ns, n + 3 * number as u8))
            .collect();
        messages[0].push(mcap::message_at(
            0,
            logged_ns[number],
            &cdr(&packets, false),
        ));
        messages[1].push(ros1::message_at(0, logged_ns[number], &ros1_scan(&packets)));
    }
    let names = [mcap::schema(1, SCAN), mcap::channel(0, 1, "/left", "cdr")].concat();
    let files = [
        mcap::file(&[names, messages[0].concat()]),
        ros1::file(
            true,
            &[
                ros1::connection(0, "/left", ROS1_SCAN),
                messages[1].concat(),
            ],
        ),
    ];
    files.map(|file| {
        let mut capture = open(&file).unwrap();
        let mut times = Vec::new();
        while let Some(datagram) = capture.next_datagram().unwrap() {
            times.push(datagram.arrival_ns);
        }
        (times, capture.remark().is_some())
    })
}

/// The same from a bag of either format.
fn both(times: &[i64], is_remarked: bool) -> [(Vec<i64>, bool); 2] {
    [(times.to_vec(), is_remarked), (times.to_vec(), is_remarked)]
}

/// Stamps of a clock that stands still, goes back or was never set: the record time of a message is
/// that of its last packet. A packet of this kit has its byte four times as the sensor's stamp.
#[test]
fn stamps_that_are_no_times_are_replaced_by_record_times() {
    let tick_ns = 0x0101_0101 * 1000;
    let start_ns = 1_700_000_000 * S + 7;
    let whole = 1_600_000_000 * S;
    let logged_ns = [2, 5, 8].map(|tick| start_ns + tick * tick_ns);
    let right = [0, 1, 2, 3, 4, 5, 6, 7, 8].map(|tick| start_ns + tick * tick_ns);
    for stamps in [
        [0; 9],
        [904_000_000 * S + 32_000; 9],
        [5, 6, 7, 8, 9, 10, 11, 12, 13],
        [0, 0, 0, 1, 1, 1, 2, 2, 2].map(|s| whole + s * S),
        [0, 0, 0, 1, 1, 1, 2, 2, 2].map(|message| whole + 7 + message * tick_ns),
        [9, 8, 7, 6, 5, 4, 3, 2, 1].map(|back| whole + back * S + 1),
    ] {
        assert_eq!(times_of(stamps, logged_ns), both(&right, true));
        // A converter may have no record times, either: the first stamp is all there is.
        if stamps[0] >= whole {
            let expected = right.map(|ns| ns - start_ns + stamps[0]);
            for logged_ns in [[0; 3], [stamps[0] + 2 * tick_ns; 3]] {
                let found = times_of(stamps, logged_ns);
                assert_eq!(found, both(&expected, true));
            }
        }
    }
    let good = right.map(|ns| ns - S);
    assert_eq!(times_of(good, logged_ns), both(&good, false));
}

#[test]
fn a_bag_without_packets_says_what_it_has() {
    let names = |count: u16| {
        let mut names = mcap::schema(1, "sensor_msgs/msg/PointCloud2");
        for id in 0..count {
            names.extend(mcap::channel(id, 1, &format!("/points{id}"), "cdr"));
        }
        mcap::file(&[names, mcap::message(0, &[7; 100])])
    };
    let error = open(&names(2)).err().unwrap();
    assert_eq!(
        error,
        "drive.bag is a bag without velodyne_msgs/VelodyneScan, the packets of a sensor: it has \
         /points0 (sensor_msgs/msg/PointCloud2), /points1 (sensor_msgs/msg/PointCloud2). Record the \
         driver's packets too, often /velodyne_packets: points do not become packets again"
    );
    let error = open(&names(500)).err().unwrap();
    assert!(error.contains(", and more. Record"), "{error}");
    let none = open(&ros1::file(true, &[])).err().unwrap();
    assert!(none.contains("it has no topics. Record"), "{none}");
    // A topic that has no message yet is no mistake.
    let names = [mcap::schema(1, SCAN), mcap::channel(0, 1, "/left", "cdr")];
    assert_eq!(read(open(&mcap::file(&names)).unwrap()), (vec![], None));
}

#[test]
fn lengths_that_are_lies_are_refused_or_end_the_reading() {
    let names = [mcap::schema(1, SCAN), mcap::channel(0, 1, "/left", "cdr")].concat();
    let good = mcap::message(0, &cdr(&[(5, 1)], false));
    let lie =
        |opcode: u8, len: u64, body: &[u8]| [&[opcode][..], &len.to_le_bytes(), body].concat();
    let chunk = |compression: &str, len: u64| {
        let name = [
            &(compression.len() as u32).to_le_bytes()[..],
            compression.as_bytes(),
        ]
        .concat();
        let body = [&[0; 28][..], &name, &len.to_le_bytes(), &[1; 9]].concat();
        lie(6, body.len() as u64, &body)
    };
    let beyond = mcap::chunk("none", &lie(5, 5000, &[0; 100]));
    for (record, says) in [
        (
            lie(5, u64::MAX, &[0; 22]),
            "its message claims 18446744073709551593 bytes, more than the 16777216",
        ),
        (lie(5, 10 << 20, &[0; 22]), "the file ends inside it"),
        (lie(5, 3, &[0; 22]), "its message is damaged"),
        (lie(99, u64::MAX, &[]), "the file ends inside it"),
        (lie(3, 3, &[0; 3]), "its schema is damaged"),
        (lie(4, 6, &[0, 0, 1, 0, 9, 9]), "its channel is damaged"),
        (lie(0, 0, &[0; 100]), "its type is damaged"),
        (chunk("", u64::MAX), "its chunk is damaged"),
        (
            chunk("lzma", 9),
            "its chunk is compressed with `lzma`; expected none, lz4, zstd or bz2",
        ),
        (
            chunk(&"x".repeat(99), 9),
            "its compression claims 99 bytes, more than the 64",
        ),
        (chunk("zstd", 9), "the zstd stream is cut or corrupt"),
        (chunk("lz4", 9), "the lz4 stream is cut or corrupt"),
        (chunk("bz2", 9), "the bzip2 stream is cut or corrupt"),
        (beyond, "a record reaches beyond the end of its chunk"),
    ] {
        let offset = 8 + 9 + 16 + names.len() + good.len();
        let file = mcap::file(&[names.clone(), good.clone(), record]);
        let (all, end) = read(open(&file).unwrap());
        let end = end.expect(says);
        assert_eq!(all.len(), 1);
        let place = format!("the capture breaks off at record 1 (byte {offset}): ");
        assert!(
            end.starts_with(&place) && end.contains(says),
            "{end}\n{says}"
        );
    }
    // 1200 bytes hold no field; a header of four gigabytes.
    let head = ros1::connection(0, "/left", ROS1_SCAN);
    let good = ros1::message(0, &ros1_scan(&[(5, 1)]));
    for (record, says) in [
        (
            vec![0xFF; 100],
            "its header claims 4294967295 bytes, more than the 1048576",
        ),
        (
            [0_u32; 2].map(u32::to_le_bytes).concat(),
            "its header is damaged",
        ),
        (
            ros1::record(&[("op", &[7])], &[]),
            "its connection is damaged",
        ),
    ] {
        let file = ros1::file(true, &[head.clone(), good.clone(), record]);
        let (all, end) = read(open(&file).unwrap());
        let end = end.expect(says);
        assert!(all.len() == 1 && end.contains(says), "{end}\n{says}");
    }
}

/// A wrong bit in a chunk with a check sum gives no packet of that chunk, however it is compressed.
#[test]
fn a_chunk_whose_check_sum_is_wrong_ends_the_reading() {
    for compression in ["none", "lz4", "zstd"] {
        let names = [mcap::schema(1, SCAN), mcap::channel(0, 1, "/left", "cdr")].concat();
        let message = |byte: u8| mcap::message(0, &cdr(&[(5, byte)], false));
        let chunk = |records: &[u8], sum: u32| {
            let mut chunk = mcap::chunk(compression, records);
            // Behind the head of the record, both times and the length.
            chunk[9 + 24..9 + 28].copy_from_slice(&sum.to_le_bytes());
            chunk
        };
        let sum = |records: &[u8]| {
            let mut sum = flate2::Crc::new();
            sum.update(records);
            sum.sum()
        };
        let first = chunk(&[names.clone(), message(1)].concat(), 0);
        let (good, bad) = (message(2), message(3));
        let whole = mcap::file(&[first.clone(), chunk(&good, sum(&good))]);
        let (all, end) = read(open(&whole).unwrap());
        assert_eq!((all.len(), end), (2, None));
        let wrong = mcap::file(&[first, chunk(&bad, sum(&good))]);
        let (all, end) = read(open(&wrong).unwrap());
        let end = end.expect("a wrong check sum");
        assert_eq!(all.len(), 1);
        assert!(
            end.ends_with("the check sum of its chunk is wrong"),
            "{end}"
        );
    }
}

#[test]
fn a_folder_is_read_in_the_order_of_its_numbers() {
    let folder = tempfile::tempdir().unwrap();
    let error = |path: &Path| Capture::open(path).err().unwrap().to_string();
    assert!(error(folder.path()).contains("a folder without .mcap, .db3 or .bag files"));
    std::fs::write(
        folder.path().join("metadata.yaml"),
        "rosbag2_bagfile_information:",
    )
    .unwrap();
    let mut all = Vec::new();
    for number in 0..11 {
        let packet = [(i64::from(number), number as u8)];
        all.extend(packet);
        let names = [mcap::schema(1, SCAN), mcap::channel(0, 1, "/left", "cdr")].concat();
        let file = mcap::file(&[names, mcap::message(0, &cdr(&packet, false))]);
        std::fs::write(folder.path().join(format!("drive_{number}.mcap")), file).unwrap();
    }
    let (read_all, end) = read(Capture::open(folder.path()).unwrap());
    assert_eq!((read_all, end), (expected(&all, "/left"), None));
    // The last one is cut.
    let last = folder.path().join("drive_10.mcap");
    let file = std::fs::read(&last).unwrap();
    std::fs::write(&last, &file[..file.len() - 100]).unwrap();
    let (read_all, end) = read(Capture::open(folder.path()).unwrap());
    assert_eq!(read_all, expected(&all[..10], "/left"));
    assert!(
        end.unwrap()
            .contains(" of drive_10.mcap): the file ends inside it")
    );
}
