//! ROS bags written byte by byte, as their formats are specified.

use std::io::Write;

use crate::scan::Stamped;

/// The type of the messages, as ROS 1 names it.
pub const ROS1_SCAN: &str = "velodyne_msgs/VelodyneScan";

/// A VelodyneScan as ROS 1 serialises it.
pub fn ros1_scan(packets: &[Stamped]) -> Vec<u8> {
    let mut message = [1, 7, 8, 5].map(u32::to_le_bytes).concat();
    message.extend(b"lidar");
    message.extend((packets.len() as u32).to_le_bytes());
    for &(stamp_ns, byte) in packets {
        let seconds = (stamp_ns / 1_000_000_000) as u32;
        let nanoseconds = (stamp_ns % 1_000_000_000) as u32;
        message.extend([seconds, nanoseconds].map(u32::to_le_bytes).as_flattened());
        message.extend([byte; 1206]);
    }
    message
}

fn text(text: &str) -> Vec<u8> {
    [&(text.len() as u32).to_le_bytes()[..], text.as_bytes()].concat()
}

/// Compresses as `none`, `zstd`, `lz4` or `bz2`.
pub fn compress(compression: &str, bytes: &[u8]) -> Vec<u8> {
    match compression {
        "none" => bytes.to_vec(),
        "zstd" => {
            ruzstd::encoding::compress_to_vec(bytes, ruzstd::encoding::CompressionLevel::Fastest)
        }
        "lz4" => {
            let mut encoder = lz4_flex::frame::FrameEncoder::new(Vec::new());
            encoder.write_all(bytes).unwrap();
            encoder.finish().unwrap()
        }
        "bz2" => {
            let level = bzip2::Compression::fast();
            let mut encoder = bzip2::write::BzEncoder::new(Vec::new(), level);
            encoder.write_all(bytes).unwrap();
            encoder.finish().unwrap()
        }
        other => panic!("{other} is no compression"),
    }
}

pub mod mcap {
    use super::text;

    pub const MAGIC: &[u8] = b"\x89MCAP0\r\n";

    pub fn record(opcode: u8, body: &[u8]) -> Vec<u8> {
        [&[opcode][..], &(body.len() as u64).to_le_bytes(), body].concat()
    }

    pub fn schema(id: u16, name: &str) -> Vec<u8> {
        schema_of(id, name, "std_msgs/Header header")
    }

    pub fn schema_of(id: u16, name: &str, definition: &str) -> Vec<u8> {
        let definition = [text("ros2msg"), text(definition)].concat();
        record(
            3,
            &[&id.to_le_bytes()[..], &text(name), &definition].concat(),
        )
    }

    pub fn channel(id: u16, schema: u16, topic: &str, encoding: &str) -> Vec<u8> {
        let ids = [id, schema].map(u16::to_le_bytes).concat();
        record(4, &[ids, text(topic), text(encoding), vec![0; 4]].concat())
    }

    pub fn message(channel: u16, data: &[u8]) -> Vec<u8> {
        message_at(channel, 0, data)
    }

    /// A message that was recorded at a time in nanoseconds.
    pub fn message_at(channel: u16, logged_ns: i64, data: &[u8]) -> Vec<u8> {
        let head = [
            &channel.to_le_bytes()[..],
            &[0; 4],
            &logged_ns.to_le_bytes(),
            &[0; 8],
        ];
        record(5, &[&head.concat()[..], data].concat())
    }

    pub fn chunk(compression: &str, records: &[u8]) -> Vec<u8> {
        let name = if compression == "none" {
            ""
        } else {
            compression
        };
        let compressed = super::compress(compression, records);
        let mut body = vec![0; 16];
        body.extend((records.len() as u64).to_le_bytes());
        body.extend([0; 4]);
        body.extend(text(name));
        body.extend((compressed.len() as u64).to_le_bytes());
        body.extend(compressed);
        record(6, &body)
    }

    /// A whole file with these records, and the end of the data.
    pub fn file(records: &[Vec<u8>]) -> Vec<u8> {
        let header = record(1, &[text("ros2"), text("test")].concat());
        let end = [record(15, &[0; 4]), record(2, &[0; 20]), MAGIC.to_vec()].concat();
        [MAGIC, &header, &records.concat(), &end].concat()
    }
}

pub mod ros1 {
    pub const MAGIC: &[u8] = b"#ROSBAG V2.0\n";

    fn fields(fields: &[(&str, &[u8])]) -> Vec<u8> {
        let mut all = Vec::new();
        for (name, value) in fields {
            all.extend((name.len() as u32 + 1 + value.len() as u32).to_le_bytes());
            all.extend([name.as_bytes(), b"=", value].concat());
        }
        all
    }

    pub fn record(head: &[(&str, &[u8])], data: &[u8]) -> Vec<u8> {
        let head = fields(head);
        let lens = [head.len(), data.len()].map(|len| (len as u32).to_le_bytes());
        [&lens[0][..], &head, &lens[1], data].concat()
    }

    pub fn connection(number: u32, topic: &str, kind: &str) -> Vec<u8> {
        let data = fields(&[("topic", topic.as_bytes()), ("type", kind.as_bytes())]);
        let number = number.to_le_bytes();
        record(
            &[("op", &[7]), ("conn", &number), ("topic", topic.as_bytes())],
            &data,
        )
    }

    pub fn message(connection: u32, data: &[u8]) -> Vec<u8> {
        message_at(connection, 0, data)
    }

    /// A message that was recorded at a time in nanoseconds.
    pub fn message_at(connection: u32, logged_ns: i64, data: &[u8]) -> Vec<u8> {
        let number = connection.to_le_bytes();
        let [seconds, nanoseconds] = [logged_ns / 1_000_000_000, logged_ns % 1_000_000_000];
        let time = [seconds as u32, nanoseconds as u32].map(u32::to_le_bytes);
        let head: [(&str, &[u8]); 3] = [
            ("op", &[2]),
            ("conn", &number),
            ("time", time.as_flattened()),
        ];
        record(&head, data)
    }

    pub fn chunk(compression: &str, records: &[u8]) -> Vec<u8> {
        let size = (records.len() as u32).to_le_bytes();
        record(
            &[
                ("op", &[5]),
                ("compression", compression.as_bytes()),
                ("size", &size),
            ],
            &super::compress(compression, records),
        )
    }

    /// A bag with these records. Its header says where the index would begin, if it is finished.
    pub fn file(is_finished: bool, records: &[Vec<u8>]) -> Vec<u8> {
        let header = |index: u64| {
            let index = index.to_le_bytes();
            [
                MAGIC,
                &record(&[("op", &[3]), ("index_pos", &index)], &[b' '; 50]),
            ]
            .concat()
        };
        let end = header(0).len() + records.concat().len();
        let index = if is_finished { end as u64 } else { 0 };
        [header(index), records.concat()].concat()
    }
}
