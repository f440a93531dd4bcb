//! Good inputs of each target: the project's own files, real ones in place, and a few made by code.

use std::io::Write;
use std::path::Path;

use sweepd::buffers::{Buffers, HeapBuffer, HeapBuffers};
use sweepd::export::mcap::{McapWriter, MessageForm, SweepMessages};
use sweepd::input::db3::{End, Frame};
use sweepd::input::write::Addressed;
use sweepd::input::{Capture, PcapWriter};
use sweepd::sensor::{Model, ModelExt, ros_yaml};
use sweepd::sweep::layout::Column;
use sweepd::sweep::{Shape, SweepMut};
use sweepd::wire::data::{DATA_PACKET_LEN, DataPacket};
use sweepd::wire::position::POSITION_PACKET_LEN;
use sweepd_lab::simulate::unit::unit;
use sweepd_messages::{Cloud, MessageHeader, Stamp};

use sweepd_testkit::{
    bags::{self, mcap, ros1},
    scan,
};

type Inputs = Vec<Vec<u8>>;

/// The seeds of the target of this name. `data` is the folder of real captures and calibrations,
/// where there is one.
pub fn of(name: &str, data: Option<&Path>) -> Inputs {
    match name {
        "data_packet" => captures(data)
            .iter()
            .map(|payloads| concat(payloads, DATA_PACKET_LEN, 8))
            .collect(),
        "position_packet" => positions(data),
        "status_stream" => status_streams(),
        "capture" => capture_files(data),
        "bag" => bag_files(),
        "frames" => frames_of_databases(),
        "frame" => frames(),
        "mender" => recordings(),
        "db_xml" => [vec![db_xml()], files(data, "calib", &["xml"], 128 << 10)].concat(),
        "ros_yaml" => yamls(data),
        "config" => configs(),
        "web_page" => [WEB_PAGE, r#"["", 1e300, null, {"config": []}]"#]
            .map(|page| page.as_bytes().to_vec())
            .to_vec(),
        "mask" => masks(),
        "rows" => ["# a head\n15\n-1 0.02\n-15 -4.5 # low\n", "2\n"]
            .map(|text| text.as_bytes().to_vec())
            .to_vec(),
        "cloud" => clouds(data),
        "labels" => labels(),
        "pipeline" => pipelines(),
        "sweep" => sweeps(),
        "cdr" => messages(),
        "control" => CONTROL.map(|line| line.as_bytes().to_vec()).to_vec(),
        "health" => vec![HEALTH.as_bytes().to_vec()],
        _ => panic!("no seeds for {name}"),
    }
}

/// Files of a folder with one of these extensions, by name.
fn files(root: Option<&Path>, folder: &str, extensions: &[&str], most_bytes: u64) -> Inputs {
    let Some(root) = root else { return Vec::new() };
    let entries =
        std::fs::read_dir(root.join(folder)).unwrap_or_else(|error| panic!("{folder}: {error}"));
    let mut paths: Vec<_> = entries
        .map(|entry| entry.expect("a folder that can be listed").path())
        .collect();
    paths.retain(|path| {
        path.extension()
            .is_some_and(|own| extensions.iter().any(|one| own == *one))
    });
    paths.retain(|path| path.metadata().is_ok_and(|file| file.len() <= most_bytes));
    paths.sort();
    paths
        .iter()
        .map(|path| {
            std::fs::read(path).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
        })
        .collect()
}

fn project() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

/// The first payloads of each capture.
fn captures(data: Option<&Path>) -> Vec<Inputs> {
    let folders = [
        Some(project().join("pcap_fixtures")),
        data.map(|data| data.join("pcap")),
    ];
    let mut captures = Vec::new();
    for folder in folders.into_iter().flatten() {
        let mut paths: Vec<_> = std::fs::read_dir(folder)
            .expect("a folder of captures")
            .flatten()
            .collect();
        paths.sort_by_key(std::fs::DirEntry::path);
        for path in paths
            .iter()
            .map(std::fs::DirEntry::path)
            .filter(|path| !path.ends_with("README.md"))
        {
            let mut capture = Capture::open(&path).unwrap_or_else(|error| panic!("{error}"));
            let mut payloads = Vec::new();
            while let Ok(Some(datagram)) = capture.next_datagram()
                && payloads.len() < 40
            {
                payloads.push(datagram.payload.to_vec());
            }
            captures.push(payloads);
        }
    }
    captures
}

/// The first payloads of this length, one behind the other.
fn concat(payloads: &Inputs, len: usize, most: usize) -> Vec<u8> {
    payloads
        .iter()
        .filter(|payload| payload.len() == len)
        .take(most)
        .flatten()
        .copied()
        .collect()
}

fn positions(data: Option<&Path>) -> Inputs {
    let mut seeds: Inputs = captures(data)
        .iter()
        .map(|payloads| concat(payloads, POSITION_PACKET_LEN, 1))
        .collect();
    seeds.retain(|seed| !seed.is_empty());
    let texts = [
        "$GPRMC,123519,A,4807.038,N,01131.000,E,022.4,084.4,230394,003.1,W*6A",
        "$GNRMC,215959.99,V,,,,,,,311299,,*2A\r\n",
    ];
    seeds.extend(texts.map(|text| text.as_bytes().to_vec()));
    seeds
}

fn status_streams() -> Inputs {
    let raw = (0..40_u32).flat_map(|n| {
        [b"HMSDNYGTV1234567"[n as usize % 16], n as u8]
            .into_iter()
            .chain((n * 288).to_le_bytes())
    });
    let edits: [&[u8]; 5] = [
        &[],
        &[0, 3, 0, 0, 5, 200, 0, 0, 0, 90, 0, 0],
        &[1, 40, 0, 1, 5, 255, 0, 0, 1, 3, 7, 0, 5, 99, 0, 0],
        &[5, 100, 0, 0, 2, 16, 255, 255, 5, 100, 0, 0, 3, 0, 9, 9],
        &[4, 0, 0, 16, 5, 50, 0, 0, 4, 0, 1, 2, 5, 50, 0, 0],
    ];
    let mut seeds = vec![[0].into_iter().chain(raw).collect()];
    seeds.extend(
        edits
            .iter()
            .zip([1, 2, 2, 1, 2])
            .map(|(edits, series)| [&[series, 9, 0], *edits].concat()),
    );
    seeds
}

/// A capture of these payloads, sent by one sensor.
fn pcap(payloads: &[Vec<u8>], step_ns: i64) -> Vec<u8> {
    let mut writer = PcapWriter::new(Vec::new()).expect("memory");
    let (source, destination) = (
        "192.168.1.201:2368".parse().unwrap(),
        "255.255.255.255:2368".parse().unwrap(),
    );
    for (payload, index) in payloads.iter().zip(0..) {
        let arrival_ns = 1_700_000_000_000_000_000 + index * step_ns;
        writer
            .write(&Addressed {
                arrival_ns,
                source,
                destination,
                payload,
            })
            .expect("memory");
    }
    writer.finish().expect("memory")
}

fn gzip(bytes: &[u8]) -> Vec<u8> {
    let mut encoder = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
    encoder.write_all(bytes).expect("memory");
    encoder.finish().expect("memory")
}

fn zstd(bytes: &[u8]) -> Vec<u8> {
    ruzstd::encoding::compress_to_vec(bytes, ruzstd::encoding::CompressionLevel::Fastest)
}

fn capture_files(data: Option<&Path>) -> Inputs {
    let payloads = [
        vec![1; 40],
        vec![0xFF; DATA_PACKET_LEN],
        vec![2; POSITION_PACKET_LEN],
        Vec::new(),
    ];
    let small = pcap(&payloads, 1_327_000);
    let ng = pcapng(&small[40..40 + 42 + 40]);
    let mut seeds = vec![
        gzip(&small),
        zstd(&small),
        gzip(&ng),
        zstd(&ng),
        gzip(&vec![0; 300 << 10]),
        bags::compress("bz2", &small),
        bags::compress("lz4", &ng),
        // Joined with `cat`.
        [&small[..], &ng, &small].concat(),
        small,
        ng,
        // Record times that stand still, and packets without records.
        pcap(&data_packets(), 0),
        data_packets().concat(),
    ];
    // Whole records, and a cut one at the end.
    seeds.extend(
        files(data, "pcap", &["pcap"], u64::MAX)
            .into_iter()
            .map(|mut file| {
                file.truncate(6 << 10);
                file
            }),
    );
    seeds
}

/// Data packets 20 ms apart, and a position packet.
fn data_packets() -> Inputs {
    let packet = |number: u32| DataPacket::new(number * 20_000, 0x37, 0x22).emit().to_vec();
    let mut packets: Inputs = (0..4).map(packet).collect();
    packets.insert(2, positions(None)[0].clone());
    packets
}

/// MCAP files and ROS 1 bags, plain and in compressed chunks, with two topics.
fn bag_files() -> Inputs {
    let scan = [
        (1_700_000_000_000_000_000, 0xFF),
        (1_700_000_000_001_000_000, 0xEE),
    ];
    let records = [
        mcap::schema(1, scan::SCAN),
        mcap::schema(2, "std_msgs/msg/String"),
        mcap::channel(1, 1, "/left", "cdr"),
        mcap::channel(2, 1, "/right", "ros1"),
        mcap::channel(3, 2, "/chatter", "cdr"),
        mcap::message(1, &scan::cdr(&scan, false)),
        mcap::message(2, &bags::ros1_scan(&scan)),
        mcap::message(3, b"hello"),
        mcap::message(1, &scan::cdr(&scan, true)),
        mcap::message(2, &bags::compress("zstd", &scan::cdr(&scan, true))),
    ]
    .concat();
    let mut seeds: Inputs = ["none", "zstd", "lz4", "bz2"]
        .map(|compression| mcap::file(&[mcap::chunk(compression, &records)]))
        .to_vec();
    seeds.push(mcap::file(&[records]));
    // Stamps that stand still.
    let names = [
        mcap::schema(1, scan::SCAN),
        mcap::channel(1, 1, "/left", ""),
    ];
    let scan_ns = 1_700_000_000_000_000_000;
    let still = scan::cdr(&[(0, 1), (0, 2), (0, 3)], false);
    let messages = [scan_ns, scan_ns, 0].map(|ns| mcap::message_at(1, ns, &still));
    seeds.push(mcap::file(&[names.concat(), messages.concat()]));
    let records = [
        ros1::connection(1, "/left", bags::ROS1_SCAN),
        ros1::connection(2, "/chatter", "std_msgs/String"),
        ros1::message(1, &bags::ros1_scan(&scan)),
        ros1::message(2, b"hello"),
        ros1::message(1, &bags::ros1_scan(&scan)),
    ]
    .concat();
    for compression in ["none", "lz4", "bz2"] {
        seeds.push(ros1::file(true, &[ros1::chunk(compression, &records)]));
    }
    seeds.push(gzip(&ros1::file(false, &[records])));
    seeds
}

/// What the program that reads databases sends of one.
fn frames_of_databases() -> Inputs {
    let topic = |name: &str, kind: &str| Frame::Topic {
        name: name.to_owned().into(),
        kind: kind.to_owned().into(),
        format: "cdr".into(),
    };
    let message = |number: i64, big_endian: bool| Frame::Message {
        topic: 0,
        number,
        logged_ns: 0,
        bytes: scan::cdr(&[(5, 0xFF); 2], big_endian).into(),
    };
    let ends = [
        End::Whole,
        End::Cut,
        End::Damaged("database disk image is malformed".to_owned()),
    ];
    let mut seeds = Vec::new();
    for end in ends {
        let frames = [
            topic("/left", scan::SCAN),
            topic("/chatter", "std_msgs/msg/String"),
            message(1, false),
            Frame::Progress { number: 7 },
            message(9, true),
            Frame::End { end, number: 10 },
        ];
        let mut seed = Vec::new();
        for frame in frames {
            frame.write(&mut seed).expect("memory");
        }
        seeds.push(seed);
    }
    seeds
}

/// Two sections with interfaces of all kinds of time, and every kind of packet block.
fn pcapng(frame: &[u8]) -> Vec<u8> {
    let block = |kind: u32, body: &[u8]| {
        let padded = [body, &[0; 3][..(4 - body.len() % 4) % 4]].concat();
        let len = (padded.len() as u32 + 12).to_le_bytes();
        [&kind.to_le_bytes()[..], &len, &padded, &len].concat()
    };
    let words = |words: &[u32]| {
        words
            .iter()
            .flat_map(|word| word.to_le_bytes())
            .collect::<Vec<u8>>()
    };
    let section = block(0x0A0D_0D0A, &words(&[0x1A2B_3C4D, 1, u32::MAX, u32::MAX]));
    let interface = |options: &[u8]| block(1, &[&words(&[1, 0])[..], options].concat());
    let len = frame.len() as u32;
    let packet = |interface: u32| {
        block(
            6,
            &[&words(&[interface, 0x0006_0A3B, 7, len, len])[..], frame].concat(),
        )
    };
    let simple = block(3, &[&words(&[len])[..], frame].concat());
    let obsolete = block(2, &[&words(&[0, 1, 2, len, len])[..], frame].concat());
    let binary = interface(&[9, 0, 1, 0, 0x94, 0, 0, 0, 0, 0, 0, 0]);
    let offset = interface(&[9, 0, 1, 0, 9, 0, 0, 0, 14, 0, 8, 0, 1, 0, 0, 0, 0, 0, 0, 0]);
    let first = [
        section.clone(),
        interface(&[]),
        binary,
        packet(0),
        packet(1),
        block(5, &[1; 13]),
    ]
    .concat();
    [first, section, offset, packet(0), simple, obsolete].concat()
}

/// Frames over every link, whole and in fragments.
fn frames() -> Inputs {
    let whole = pcap(&[vec![7; 48]], 0);
    let ethernet = &whole[40..];
    let ip = &ethernet[14..];
    let mut fragments = [ip[..20 + 24].to_vec(), [&ip[..20], &ip[20 + 24..]].concat()];
    for (fragment, offset) in fragments.iter_mut().zip([0x2000_u16, 3]) {
        let len = (fragment.len() as u16).to_be_bytes();
        fragment[2..4].copy_from_slice(&len);
        fragment[6..8].copy_from_slice(&offset.to_be_bytes());
    }
    let tagged = [&ethernet[..12], &[0x81, 0, 0, 5], &ethernet[12..]].concat();
    let cooked = [&[0; 14][..], &[8, 0], ip].concat();
    let cooked2 = [&[8, 0][..], &[0; 18], ip].concat();
    let mut ip6 = vec![0x60, 0, 0, 0, 0, 56, 17, 64];
    ip6.extend([1; 32].iter().chain(&ip[20..]));
    let loopback = [&[2, 0, 0, 0], ip].concat();
    let one = |link: u8, frame: &[u8]| {
        [&(frame.len() as u16).to_le_bytes()[..], &[link, 1], frame].concat()
    };
    let [first, second] = fragments.map(|fragment| one(4, &fragment));
    let all = [
        one(1, ethernet),
        one(1, &tagged),
        one(7, &cooked),
        one(9, &cooked2),
        one(8, &ip6),
        one(0, &loopback),
    ];
    vec![
        all.concat(),
        [&second[..], &first].concat(),
        [&first[..], &second, &first].concat(),
    ]
}

/// A db.xml of sixteen lasers, as its form is.
fn db_xml() -> Vec<u8> {
    let item = |id: usize| {
        let angle = id as f64 * 2.0 - 15.0;
        format!(
            "<item><px><id_>{id}</id_><rotCorrection_>0.5</rotCorrection_><vertCorrection_>{angle}</vertCorrection_>\
             <distCorrection_>0</distCorrection_><distCorrectionX_>0</distCorrectionX_><distCorrectionY_>0</distCorrectionY_>\
             <vertOffsetCorrection_>0</vertOffsetCorrection_><horizOffsetCorrection_>0</horizOffsetCorrection_></px></item>\n"
        )
    };
    let items: String = (0..16).map(item).collect();
    let enabled = "<item>1</item>".repeat(16);
    format!(
        "<?xml version=\"1.0\"?>\n<!DOCTYPE boost_serialization>\n<boost_serialization><DB><distLSB_>0.2</distLSB_>\n\
         <enabled_><count>16</count>{enabled}</enabled_>\n<points_><count>16</count>{items}</points_></DB></boost_serialization>"
    )
    .into_bytes()
}

fn yamls(data: Option<&Path>) -> Inputs {
    let own = ros_yaml::emit(&unit(3)).into_bytes();
    let odd =
        b"lasers:\n- &a {laser_id: 0, vert_correction: !!float '0.1'}\nnum_lasers: 1\ndistance_resolution: 2e-3\n"
            .to_vec();
    let ours = files(Some(project()), "calib", &["yaml"], 64 << 10);
    [
        vec![own, odd],
        ours,
        files(data, "calib", &["yaml", "yml"], 64 << 10),
    ]
    .concat()
}

fn configs() -> Inputs {
    let all = "http = \"0.0.0.0:9000\"\nhttp_public = true\nroot = \"iox2\"\n[[sensor]]\nname = \"roof\"\n\
        address = \"192.168.1.201:2368\"\nport = 2370\nposition_port = 8309\nbind = \"192.168.1.100\"\n\
        multicast = \"239.0.0.1\"\ncpu = 2\nrealtime_priority = 50\nmodel = \"vlp16\"\nreturns = \"dual\"\nreturn = \"last\"\n\
        cut_azimuth_deg = 90\nmax_consumers = 3\n[sensor.want]\nrpm = 600\nfov = \"270-90\"\n[sensor.mount]\nx_m = 0.1\nroll_deg = 1\nheight_m = 1.7\n\
        [sensor.segment]\nmethod = \"paper\"\ntheta_deg = 10.0\nmin_points = 5\nmin_range_m = 0.5\nmax_range_m = 80\n\
        [[sensor]]\nname = \"rear\"\naddress = \"fe80::1\"\nmodel = \"hdl64e-s3\"\nposition_port = 8308\n\
        [record]\npath = \"drive.pcap\"\nrotate_mb = 100\nrotate_minutes = 1.5\n";
    let own = ["systemd/sweepd.toml", "examples/loopback.toml"]
        .map(|file| std::fs::read(project().join(file)).unwrap());
    let folder = data_example();
    [own.to_vec(), vec![all.as_bytes().to_vec(), folder]].concat()
}

/// Slips in many places, each of which is to be drawn.
fn data_example() -> Vec<u8> {
    let sensor = "[[sensor]]\nname = \"a\"\naddress = \"10.0.0.1\"\nport = 2368\nwant.rpm = 1e9\ncut_azimuth_deg = -400\n";
    sensor.repeat(3).into_bytes()
}

const WEB_PAGE: &str = r#"{"config": {"rpm": "600", "returns": "Dual", "laser": "On", "fov": {"start": "270", "end": 91},
    "host": {"addr": "255.255.255.255", "dport": "2368", "tport": 8308}}, "motor": {"rpm": 599, "state": "On"},
    "laser": {"state": "off"}, "gps": {"pps_state": "Absent"}}"#;

fn masks() -> Inputs {
    use png::{BitDepth, ColorType};
    let kinds = [
        (ColorType::Grayscale, BitDepth::One, 8),
        (ColorType::Rgba, BitDepth::Sixteen, 1),
        (ColorType::Indexed, BitDepth::Four, 2),
    ];
    kinds
        .map(|(color, depth, pixels_per_step)| {
            let mut bytes = Vec::new();
            let mut encoder = png::Encoder::new(&mut bytes, 16, 16);
            encoder.set_color(color);
            encoder.set_depth(depth);
            if color == ColorType::Indexed {
                encoder.set_palette([7; 48].to_vec());
            }
            let step = if color == ColorType::Rgba { 8 } else { 1 };
            let data: Vec<u8> = (0..16 * 16 / pixels_per_step * step)
                .map(|n| n as u8)
                .collect();
            encoder
                .write_header()
                .and_then(|mut writer| writer.write_image_data(&data))
                .expect("a picture");
            bytes
        })
        .to_vec()
}

/// Rings of points around the sensor.
fn points() -> Vec<[f32; 5]> {
    let point = |index: usize| {
        let (ring, azimuth) = (index / 60, (index % 60) as f32 * 0.1047);
        let range_m = 4.0 + ring as f32 + (index % 7) as f32 * 0.01;
        [
            range_m * azimuth.cos(),
            range_m * azimuth.sin(),
            0.4 - 0.4 * ring as f32,
            index as f32,
            ring as f32,
        ]
    };
    (0..300).map(point).collect()
}

fn clouds(data: Option<&Path>) -> Inputs {
    let points = points();
    let bytes = |fields: usize, from: fn(f32) -> [u8; 4]| -> Vec<u8> {
        points
            .iter()
            .flat_map(|point| point[..fields].to_vec())
            .flat_map(from)
            .collect()
    };
    let (kitti, nuscenes) = (bytes(4, f32::to_le_bytes), bytes(5, f32::to_le_bytes));
    let line = |[x, y, z, i, ring]: &[f32; 5]| format!("{x} {y} {z} {i} {ring}\n");
    let lines: String = points.iter().map(line).collect();
    let pcd = |data: &str| {
        format!(
            "# .PCD\nVERSION 0.7\nFIELDS x y z intensity ring\nSIZE 4 4 4 4 4\nTYPE F F F F F\nCOUNT 1 1 1 1 1\nWIDTH 300\n\
             HEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS 300\nDATA {data}\n"
        )
    };
    let ply = |format: &str| {
        let properties = ["x", "y", "z", "intensity", "ring"]
            .map(|name| format!("property float {name}\n"))
            .concat();
        format!(
            "ply\nformat {format} 1.0\ncomment a\nelement vertex 300\n{properties}element face 0\nend_header\n"
        )
    };
    let all = [
        (0, kitti),
        (1 | 4, nuscenes.clone()),
        (2, [pcd("ascii").as_bytes(), lines.as_bytes()].concat()),
        (2, [pcd("binary").as_bytes(), &nuscenes].concat()),
        (
            2,
            [pcd("binary_compressed").as_bytes(), &packed(&points)].concat(),
        ),
        (3, [ply("ascii").as_bytes(), lines.as_bytes()].concat()),
        (
            3 | 4,
            [ply("binary_little_endian").as_bytes(), &nuscenes].concat(),
        ),
        (
            3,
            [
                ply("binary_big_endian").as_bytes(),
                &bytes(5, f32::to_be_bytes),
            ]
            .concat(),
        ),
    ];
    let mut seeds: Inputs = all
        .into_iter()
        .map(|(how, bytes)| [&[how | 4 << 3][..], &bytes].concat())
        .collect();
    seeds.extend(
        files(data, "reference", &["pcd"], 1 << 20)
            .into_iter()
            .map(|mut file| {
                file.truncate(4 << 10);
                [&[2 | 16 << 3][..], &file].concat()
            }),
    );
    seeds
}

/// The points field by field, packed as PCL packs them: bytes as they are, and one long stretch.
fn packed(points: &[[f32; 5]]) -> Vec<u8> {
    let fields = (0..4).flat_map(|field| {
        points
            .iter()
            .flat_map(move |point| point[field].to_le_bytes())
    });
    let literal: Vec<u8> = fields.collect();
    let mut packed: Vec<u8> = literal
        .chunks(32)
        .flat_map(|piece| [&[piece.len() as u8 - 1], piece].concat())
        .collect();
    // All rings are those of the first: 1200 zeros.
    packed.extend([0, 0]);
    packed.extend([7 << 5, 255, 0].repeat(4));
    packed.extend([7 << 5, (1200 - 1 - 4 * 264 - 9) as u8, 0]);
    let lengths = [packed.len() as u32, 300 * 20]
        .map(u32::to_le_bytes)
        .concat();
    [lengths, packed].concat()
}

fn labels() -> Inputs {
    let one = |(index, [x, y, z, i, _]): (usize, [f32; 5])| {
        let truth = [0, 10, 40, 50, 30][index / 60] | (index as u32 / 30) << 16;
        let mut bytes = [x, y, z, i].map(f32::to_le_bytes).concat();
        bytes.extend([truth, index as u32 / 45].map(u32::to_le_bytes).concat());
        bytes
    };
    let far = [
        [f32::MAX, f32::MIN, 0.0, 0.0, 0.0],
        [f32::NAN, 1.0, 1e-38, 0.0, 0.0],
        [1e9, -1e9, 1e9, 0.0, 0.0],
    ];
    [points(), far.to_vec()]
        .map(|points| points.into_iter().enumerate().flat_map(one).collect())
        .to_vec()
}

/// Every model in every return mode, two turns of it, and a thing or two that go wrong.
fn pipelines() -> Inputs {
    let wrong: [&[u8]; 8] = [
        &[
            4, 20, 0, 100, 5, 6, 3, 7, 3, 2, 0, 9, 200, 4, 1, 100, 0, 8, 0, 50,
        ],
        &[
            8, 0, 128, 20, 0, 60, 9, 0, 64, 40, 0, 60, 11, 1, 0, 40, 0, 30,
        ],
        &[14, 0, 128, 0, 90, 14, 0, 0, 0, 40, 14, 112, 1, 0, 90],
        &[16, 2, 0, 90, 16, 0, 0, 90, 17, 3, 0, 120, 17, 0, 0, 99],
        &[
            10, 255, 255, 255, 255, 255, 255, 255, 127, 0, 9, 10, 0, 0, 0, 0, 0, 0, 0, 128, 0, 9,
            11, 1, 0, 0,
        ],
        &[
            12, 4, 0xFF, 0xEE, 0xFF, 12, 6, 1, 13, 1, 2, 3, 4, 5, 0, 40, 19, 0, 0, 40, 19, 1, 0, 4,
        ],
        &[
            18, 1, 1, 1, 2, 1, 3, 1, 4, 1, 5, 1, 6, 1, 7, 1, 8, 1, 9, 1, 10, 1, 11, 1, 0, 40, 15,
            9, 9, 0, 40,
        ],
        &[],
    ];
    let seeds = (0..18_u8).map(|kind| {
        let head = [(4 * (kind % 3)) | (kind & 1), kind, 10, kind, 104, 1];
        [
            &head[..],
            &[0, 200, 0, 60],
            wrong[usize::from(kind) % 8],
            &[0, 250],
        ]
        .concat()
    });
    seeds
        .chain([vec![0x80, 0, 0, 0, 104, 1, 0, 255, 0, 90]])
        .collect()
}

/// A recording of two sweeps: whole, cut, without the chunk that names its topics; and records of a
/// chunk.
fn recordings() -> Inputs {
    let shape = small_shape(false);
    let mut buffer = small_sweep(&shape);
    let sweep = SweepMut::open(&mut buffer.as_mut()[..shape.total_bytes()]).expect("a sweep");
    let messages = SweepMessages::of(&sweep.as_ref(), &MessageForm::default());
    let mut writer = McapWriter::new(Vec::new()).expect("memory");
    for _ in 0..2 {
        writer.write(&messages).expect("memory");
        writer.flush().expect("memory");
    }
    let whole = writer.finish().expect("memory");
    let cut = whole[..whole.len() / 2].to_vec();
    let mut damaged = whole.clone();
    damaged[200] ^= 1;
    let records = [
        mcap::schema(1, scan::SCAN),
        mcap::channel(2, 1, "/left", "cdr"),
        mcap::message(2, &scan::cdr(&[(5, 0xFF)], false)),
    ];
    let header = MessageHeader {
        frame_id: "left",
        stamp: Stamp::First,
    };
    let mut cloud = Vec::new();
    Cloud::default().encode(&sweep.as_ref(), &header, &mut cloud);
    let message = mcap::message(2, &cloud);
    vec![
        whole,
        cut,
        damaged,
        [&[0][..], &records.concat()].concat(),
        [&[0][..], &message].concat(),
    ]
}

fn small_shape(dual: bool) -> Shape {
    Shape {
        rows: 2,
        columns_capacity: 6,
        dual,
        segments_capacity: 2,
    }
}

/// A sweep of the first bytes of a buffer.
fn small_sweep(shape: &Shape) -> HeapBuffer {
    let mut buffer = HeapBuffers::default().take(shape.total_bytes());
    let sweep = SweepMut::create(&mut buffer.as_mut()[..shape.total_bytes()], shape);
    let sweep = sweep.expect("room for a sweep");
    (
        sweep.header.columns,
        sweep.header.margin_columns,
        sweep.header.segments,
    ) = (4, 1, 1);
    sweep.range.fill(2.5);
    sweep.columns.fill(Column::measured(9, 4, 1.5, 60.0, 11));
    let beams = Model::Vlp16.calibration().expect("its table").beams();
    sweep
        .beams
        .iter_mut()
        .zip(beams)
        .for_each(|(row, beam)| *row = beam.row(2304));
    buffer
}

fn sweeps() -> Inputs {
    let mut seeds: Inputs = vec![
        vec![1, 3, 4, 5, 2, 0, 0x3F, 0x80, 0x3F],
        vec![
            2, 64, 20, 40, 9, 2, 21, 1, 0, 0, 0, 30, 0xFF, 0xFF, 0xFF, 0x7F, 0x40, 0x40, 0x40, 0x41,
        ],
    ];
    for dual in [false, true] {
        let shape = small_shape(dual);
        let buffer = small_sweep(&shape);
        seeds.push([&[0], &buffer.as_ref()[..shape.total_bytes()]].concat());
    }
    seeds
}

/// Requests for parameters, odometry and a transform, little-endian.
fn messages() -> Inputs {
    let text = |text: &str| {
        let len = text.len() as u32 + 1;
        let padding = (len as usize).next_multiple_of(4) - text.len();
        [&len.to_le_bytes()[..], text.as_bytes(), &[0; 4][..padding]].concat()
    };
    let head = |count: u32| [&[0, 1, 0, 0][..], &count.to_le_bytes()].concat();
    let names = [head(2), text("clock"), text("roof.stamp")].concat();
    let list = [&names[..], &7_u64.to_le_bytes()].concat();
    let value = [&[4, 0][..], &[0; 2 + 16], &text("last"), &[0; 5 * 4]].concat();
    let set = [head(1), text("roof.stamp"), value].concat();
    let pose = [1.0, -2.0, 0.5, 0.0, 0.0, 0.0, 1.0].map(f64::to_le_bytes);
    let located = [
        &7_i32.to_le_bytes()[..],
        &9_u32.to_le_bytes(),
        &text("odom"),
        &text("base_link"),
    ]
    .concat();
    let odometry = [&[0, 1, 0, 0][..], &located, &[0; 4], pose.as_flattened()].concat();
    let transform = [&head(1)[..], &located, pose.as_flattened()].concat();
    vec![names, list, set, odometry, transform]
}

const CONTROL: [&str; 5] = [
    r#"{"version": 3, "sensor": "roof", "senders": ["192.168.1.201"], "path": "/tmp/a.pcap", "replaces": false,
        "rotation": {"bytes": 100000000, "ns": null}, "duration": {"secs": 60, "nanos": 0}}"#,
    r#"{"version": 3, "settings_of": "roof"}"#,
    r#"{"Settings": {"method": "slope", "settings": {"height_m": 1.7, "max_range_m": null}, "masked": false}}"#,
    r#"{"Progress": {"received": 9, "dropped": 0, "unwritten": 1, "written": 8, "bytes": 9999}}"#,
    r#"{"Refused": "no sensor is called so"}"#,
];

const HEALTH: &str = r#"{"status": "warning", "version": "9", "root": "/run/sweepd", "reasons": ["roof: losing: 3 %"],
    "findings": [{"severity": "warning", "topic": "loss", "what": "roof: 3 % of the packets are lost", "cure": "look at\nthe switch",
        "sensor": "roof", "asks": true}],
    "sensors": [{"name": "roof", "state": "streaming", "model": "vlp16", "is_fault": false, "reason": "3 %", "rpm": 600.1,
        "packets": 3770, "lost": 3, "late": 2, "refused": {"too_short": 1, "other": 2}, "losses": {"percent": 0.3, "what": "few", "cure": ""},
        "dark_beams": [{"row": 3, "channel": 7, "turns": 20}]}],
    "ports": [{"name": "port 2368", "port": 2368, "received": 3770, "dropped": 5}]}"#;
