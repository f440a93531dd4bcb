//! Inputs that are made to take all the time or all the memory there is.

use sweepd_testkit::{
    bags::{compress, mcap, ros1},
    scan::{SCAN, cdr},
};

/// What might bring the target of this name to its knees; as long as the files may be that are
/// read.
pub fn of(name: &str) -> Vec<Vec<u8>> {
    match name {
        "db_xml" => xml(),
        "ros_yaml" => yaml(),
        "config" => toml(),
        "web_page" => [("[", "]"), ("{\"config\":", "}")]
            .map(|(open, close)| nested(open, "1", close, 400 << 10))
            .to_vec(),
        "capture" => captures(),
        "bag" => bags(),
        "frames" => frames(),
        "cloud" => clouds(),
        "mask" => vec![
            png(36_000, 128),
            png(u32::MAX >> 1, 1),
            png(1, u32::MAX >> 1),
        ],
        "labels" => labels(),
        "control" => vec![nested("[", "1", "]", 64 << 10)],
        "health" => vec![
            nested("{\"sensors\":[", "1", "]}", 1 << 20),
            // Counts that no sum can hold.
            format!(
                "{{\"sensors\": [{{\"undecoded\": {{\"a\": {0}, \"b\": {0}}}}}]}}",
                u64::MAX
            )
            .into_bytes(),
        ],
        _ => Vec::new(),
    }
}

/// So many bytes of what opens and what closes.
fn nested(open: &str, inside: &str, close: &str, bytes: usize) -> Vec<u8> {
    let depth = bytes / (open.len() + close.len());
    [&open.repeat(depth), inside, &close.repeat(depth)]
        .concat()
        .into_bytes()
}

const XML_BYTES: usize = 250 << 10;

fn xml() -> Vec<Vec<u8>> {
    let lasers = "<item><px><id_>1</id_></px></item>".repeat(XML_BYTES / 34);
    let attributes: String = (0..XML_BYTES / 10)
        .map(|n| format!(" a{n:05}=''"))
        .collect();
    let spaces: String = (0..XML_BYTES / 20)
        .map(|n| format!("<a xmlns:b{n:05}=''>"))
        .collect();
    let whole = |points: &str| {
        format!("<r><DB><distLSB_>0.2</distLSB_><points_>{points}</points_></DB></r>").into_bytes()
    };
    vec![
        nested("<a>", "", "</a>", XML_BYTES),
        "<a>".repeat(XML_BYTES / 3).into_bytes(),
        format!("<r{attributes}/>").into_bytes(),
        spaces.into_bytes(),
        whole(&lasers),
        whole(&"\n<item/>".repeat(XML_BYTES / 8)),
        whole(&"&#120;".repeat(XML_BYTES / 6)),
        b"<!DOCTYPE r [<!ENTITY a 'aaaaaaaaaa'><!ENTITY b '&a;&a;&a;&a;&a;&a;&a;&a;&a;'>]><r>&b;&b;&b;</r>".to_vec(),
        format!("<!DOCTYPE r {}><r/>", "[".repeat(XML_BYTES)).into_bytes(),
        format!("<r><!--{}", "-".repeat(XML_BYTES)).into_bytes(),
    ]
}

fn yaml() -> Vec<Vec<u8>> {
    let laughs: String = (1..30)
        .map(|n| {
            format!(
                "a{n}: &a{n} [*a{m}, *a{m}, *a{m}, *a{m}, *a{m}]\n",
                m = n - 1
            )
        })
        .collect();
    let laughs_inside: String = (1..30)
        .map(|n| {
            format!(
                "- &b{n} {{laser_id: *b{m}, vert_correction: *b{m}}}\n",
                m = n - 1
            )
        })
        .collect();
    vec![
        nested("[", "", "]", 250 << 10),
        nested("{a: ", "1", "}", 250 << 10),
        nested("- ", "", "", 250 << 10),
        format!("a0: &a0 lol\n{laughs}lasers: *a29\n").into_bytes(),
        format!("lasers:\n- &b0 lol\n{laughs_inside}").into_bytes(),
        format!("lasers: &x [{}]", "*x, ".repeat(60_000)).into_bytes(),
        format!("lasers:\n{}", "- {laser_id: 1}\n".repeat(15_000)).into_bytes(),
        format!("? {}", "? ".repeat(120_000)).into_bytes(),
        format!("lasers: '{}", "\n".repeat(250_000)).into_bytes(),
        format!("lasers: \"{}", "\\x41".repeat(60_000)).into_bytes(),
        (0..250 << 10).map(|n| b"&a *a\n"[n % 6]).collect(),
        " \n".repeat(120_000).into_bytes(),
    ]
}

fn toml() -> Vec<Vec<u8>> {
    const BYTES: usize = 1 << 20;
    let sensor = |n: usize| {
        format!(
            "[[sensor]]\nname = \"s{n}\"\naddress = \"10.0.{}.{}\"\n",
            n / 256 % 256,
            n % 256
        )
    };
    let sensors: String = (0..BYTES / 50).map(sensor).collect();
    let keys: String = (0..BYTES / 14)
        .map(|n| format!("key{n:06} = 1\n"))
        .collect();
    vec![
        nested("[", "1", "]", BYTES / 4),
        [b"a = ", &nested("[", "1", "]", BYTES / 4)[..]].concat(),
        [b"a = ", &nested("{a = ", "1", "}", BYTES / 4)[..]].concat(),
        format!("{}a = 1", "a.".repeat(BYTES / 4)).into_bytes(),
        format!("[{}a]", "a.".repeat(BYTES / 4)).into_bytes(),
        sensors.into_bytes(),
        // Wrong in each of its places, and each is drawn.
        "[[sensor]]\nname = \"\"\naddress = \"\"\nwant = { rpm = -1 }\nport = 0\n"
            .repeat(BYTES / 52)
            .into_bytes(),
        keys.into_bytes(),
        format!("http = \"{}\"", "é".repeat(BYTES / 3)).into_bytes(),
        format!("{}http = 1", " ".repeat(BYTES / 2)).into_bytes(),
        format!("http = \"{}", "\n".repeat(BYTES / 2)).into_bytes(),
    ]
}

fn captures() -> Vec<Vec<u8>> {
    let words = |words: &[u32]| {
        words
            .iter()
            .flat_map(|word| word.to_le_bytes())
            .collect::<Vec<u8>>()
    };
    let head = words(&[0xA1B2_C3D4, 0x0004_0002, 0, 0, 0xFFFF_FFFF, 1]);
    let section = words(&[0x0A0D_0D0A, 28, 0x1A2B_3C4D, 1, u32::MAX, u32::MAX, 28]);
    // A record, a block and a section of four gigabytes; interfaces without end; a zstd frame with
    // the largest window there is.
    vec![
        [&head[..], &words(&[0, 0, u32::MAX, u32::MAX])].concat(),
        [&head[..], &words(&[0, 0, 256 << 10, u32::MAX])].concat(),
        [&section[..], &words(&[6, 0xFFFF_FFFC, 0, 0, 0, 0, 0])].concat(),
        [&section[..], &words(&[1, 0xFFFF_FFFC, 0])].concat(),
        [&section[..], &words(&[5, 0xFFFF_FFFC, 0])].concat(),
        words(&[0x0A0D_0D0A, 0xFFFF_FFFC, 0x1A2B_3C4D, 1, u32::MAX, u32::MAX]),
        [&section[..], &words(&[1, 20, 1, 0, 20]).repeat(4000)].concat(),
        [
            &section[..],
            &words(&[1, 20, 1, 0, 20]),
            &words(&[6, 32, 0, 0, 0, 0, 0, 32]).repeat(3000),
        ]
        .concat(),
        vec![0x28, 0xB5, 0x2F, 0xFD, 0x00, 0xFF, 1, 0, 0],
        vec![
            0x28, 0xB5, 0x2F, 0xFD, 0xE0, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0x7F, 0x03, 0,
            0,
        ],
        // 128 KiB of one byte, said with four, over and over, in a window of 8 MiB.
        [
            &[0x28, 0xB5, 0x2F, 0xFD, 0x00, 0x68][..],
            &[0x02, 0x00, 0x10, 0].repeat(200),
            &[1, 0, 0],
        ]
        .concat(),
        // A gzip name without end.
        [&[0x1F, 0x8B, 8, 8, 0, 0, 0, 0, 0, 3][..], &[b'a'; 90 << 10]].concat(),
        // Nothing, over and over.
        [
            0x1F, 0x8B, 8, 0, 0, 0, 0, 0, 0, 3, 3, 0, 0, 0, 0, 0, 0, 0, 0, 0,
        ]
        .repeat(4000),
    ]
}

/// Frames that claim the longest text or message, or more, and have none.
fn frames() -> Vec<Vec<u8>> {
    let message = [&b"M"[..], &[0; 12]].concat();
    let mut all = Vec::new();
    for len in [16 << 20, (16 << 20) + 1, u32::MAX] {
        for head in [&b"T"[..], &message, &[b'E', 0, 0, 0, 0, 0, 0, 0, 0, 0]] {
            all.push([head, &len.to_le_bytes()].concat());
        }
    }
    all
}

fn bags() -> Vec<Vec<u8>> {
    let names = [mcap::schema(1, SCAN), mcap::channel(0, 1, "/left", "cdr")].concat();
    let lie = |opcode: u8, len: u64| [&[opcode][..], &len.to_le_bytes(), &[0; 30]].concat();
    let zeros = vec![0; 40 << 20];
    let channels = |count: u32, kind: &str, topic: &str| {
        let schema = mcap::schema(1, kind);
        let channels =
            (0..count).flat_map(|id| mcap::channel(id as u16, 1, &format!("/{id}{topic}"), "cdr"));
        mcap::file(&[schema, channels.collect()])
    };
    let scans = |count: usize| mcap::message(0, &cdr(&[], false)).repeat(count);
    vec![
        mcap::file(&[names.clone(), lie(5, 16 << 20)]),
        mcap::file(&[names.clone(), lie(5, u64::MAX)]),
        mcap::file(&[lie(3, u64::MAX)]),
        mcap::file(&[mcap::chunk("zstd", &zeros)]),
        mcap::file(&[mcap::chunk("bz2", &zeros)]),
        // A message of 40 MiB, then one of 15, in a few kilobytes.
        mcap::file(&[
            names.clone(),
            mcap::chunk("zstd", &mcap::message(0, &zeros)),
        ]),
        mcap::file(&[
            names.clone(),
            mcap::chunk("zstd", &mcap::message(0, &zeros[..15 << 20])),
        ]),
        mcap::file(&[names.clone(), mcap::message(0, &compress("zstd", &zeros))]),
        // Topics without end, with packets and without; scans without packets.
        channels(3000, SCAN, ""),
        channels(3000, "sensor_msgs/msg/PointCloud2", &"x".repeat(100)),
        mcap::file(&[names, scans(3000)]),
        ros1::file(true, &[vec![0xFF; 100]]),
        ros1::file(true, &[ros1::chunk("lz4", &zeros)]),
    ]
}

fn clouds() -> Vec<Vec<u8>> {
    let most = usize::MAX;
    let pcd = |size: &str, count: &str, points: usize, data: &str, body: &[u8]| {
        let head = format!(
            "FIELDS x y z pad\nSIZE {size}\nTYPE F F F U\nCOUNT {count}\nWIDTH {points}\nHEIGHT 1\nPOINTS {points}\nDATA {data}\n"
        );
        [&[2], head.as_bytes(), body].concat()
    };
    let ply = |points: usize, format: &str| {
        let xyz = ["x", "y", "z"]
            .map(|name| format!("property float {name}\n"))
            .concat();
        format!("\u{3}ply\nformat {format} 1.0\nelement vertex {points}\n{xyz}end_header\n")
            .into_bytes()
    };
    let lengths = |packed: u32, unpacked: u32| [packed, unpacked].map(u32::to_le_bytes).concat();
    let ones = "1 1 1 1".to_owned();
    let points = 60_000_000;
    let bomb: Vec<u8> = [
        &lengths(3000, 3000 * 88)[..],
        &[0, 7],
        &[7 << 5, 0xFF, 0].repeat(999),
        &[0],
    ]
    .concat();
    vec![
        pcd("4 4 4 1", &ones, most, "binary", &[]),
        pcd("4 4 4 1", &ones, most, "ascii", b"1 2 3 4\n"),
        pcd(
            "4 4 4 1",
            "1 1 1 0",
            points,
            "binary_compressed",
            &lengths(8, 720_000_000),
        ),
        pcd(
            "4 4 4 1",
            &format!("1 1 1 {}", 1 << 30),
            1,
            "ascii",
            b"1 2 3\n",
        ),
        pcd(
            "4 4 4 8",
            &format!("1 1 1 {}", 1 << 27),
            1,
            "binary_compressed",
            &lengths(0, 1 << 30),
        ),
        pcd("4 4 4 1", &ones, 3000 * 88 / 13, "binary_compressed", &bomb),
        [&[2][..], b"FIELDS ", &b"x ".repeat(30_000)].concat(),
        [&[2][..], &b"#\n".repeat(40_000)].concat(),
        ply(most, "ascii"),
        ply(most, "binary_little_endian"),
        [ply(1, "ascii"), b"\n".repeat(300_000)].concat(),
        // All points in one place, all of them far away, none at all.
        [&[0][..], &[0; 64_000]].concat(),
        [&[31 << 3][..], &f32::MAX.to_le_bytes().repeat(16_000)].concat(),
        [&[31 << 3 | 4][..], &f32::NAN.to_le_bytes().repeat(16_000)].concat(),
    ]
}

/// The head of a picture of this size, and nothing in it.
fn png(width: u32, height: u32) -> Vec<u8> {
    let mut bytes = Vec::new();
    let mut encoder = png::Encoder::new(&mut bytes, 1, 1);
    encoder.set_color(png::ColorType::Rgba);
    encoder.set_depth(png::BitDepth::Sixteen);
    encoder
        .write_header()
        .and_then(|mut writer| writer.write_image_data(&[0; 8]))
        .expect("a picture");
    bytes[16..24].copy_from_slice(&[width.to_be_bytes(), height.to_be_bytes()].concat());
    let mut crc = flate2::Crc::new();
    crc.update(&bytes[12..29]);
    bytes[29..33].copy_from_slice(&crc.sum().to_be_bytes());
    bytes
}

/// Points of one label in two dense clouds, just too far from each other to touch.
fn labels() -> Vec<Vec<u8>> {
    let point = |n: usize| {
        let x = if n.is_multiple_of(2) { 0.0 } else { 1.2 } + (n / 2) as f32 * 1e-5;
        let mut bytes: Vec<u8> = [x, 0.0, 0.0, 0.0]
            .iter()
            .flat_map(|value: &f32| value.to_le_bytes())
            .collect();
        bytes.extend([10, 2_u32].map(u32::to_le_bytes).concat());
        bytes
    };
    vec![(0..4000).flat_map(point).collect()]
}
