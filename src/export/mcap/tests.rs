//! Files read back by the library.

use std::io::Cursor;

use mcap::io::MessageReader;
use mcap::sans_io::LinearReaderOptions;

use super::*;
use crate::export::test_scene::Scene;

/// The messages of sweeps of two sensors, a tenth of a second apart.
pub(crate) fn messages(sweeps: u64) -> Vec<SweepMessages> {
    let mut all = Vec::new();
    for number in 0..sweeps {
        let mut scene = Scene::street(16, 300, number % 3 == 0);
        scene.fill(|sweep| {
            sweep.header.time_ns += number as i64 * 100_000_000;
            sweep
                .header
                .set_name(["roof", "front-left"][number as usize % 2]);
            sweep.header.position_m = [0.5, 1.0, 2.0];
        });
        all.push(SweepMessages::of(&scene.sweep(), &MessageForm::default()));
    }
    all
}

/// Chunks of one sweep each.
pub(crate) fn file(messages: &[SweepMessages]) -> Vec<u8> {
    let mut writer = McapWriter::new(Vec::new()).unwrap();
    for one in messages {
        writer.write(one).unwrap();
        writer.flush().unwrap();
    }
    writer.finish().unwrap()
}

/// Topic, time and bytes of each message.
pub(crate) type Read = Vec<(String, u64, Vec<u8>)>;

pub(crate) fn expected(messages: &[SweepMessages]) -> Read {
    let mut read = Read::new();
    for one in messages {
        for (topic, bytes) in [("points", &one.points), ("markers", &one.markers)] {
            let topic = format!("/sweepd/{}/{topic}", one.sensor);
            read.push((topic, one.time_ns, bytes.clone()));
        }
    }
    read
}

/// What a reader of whole files makes of it, which checks all sums, without the transforms.
pub(crate) fn read(bytes: &[u8]) -> Read {
    let options = LinearReaderOptions::default()
        .with_validate_chunk_crcs(true)
        .with_validate_data_section_crc(true)
        .with_validate_summary_section_crc(true);
    let stream = MessageReader::new_with_options(Cursor::new(bytes), options);
    let found = stream.map(Result::unwrap).map(|one| {
        (
            one.channel.topic.clone(),
            one.log_time,
            one.data.into_owned(),
        )
    });
    found.filter(|(topic, ..)| topic != "/tf_static").collect()
}

/// What a reader finds by the index of messages, in order of time, without the transforms.
fn sought(bytes: &[u8]) -> Read {
    let summary = mcap::Summary::read(bytes).unwrap().unwrap();
    let mut found = Read::new();
    for chunk in &summary.chunk_indexes {
        let channels = summary.read_message_indexes(bytes, chunk).unwrap();
        for (channel, entries) in channels {
            for entry in entries {
                let message = summary.seek_message(bytes, chunk, &entry).unwrap();
                assert_eq!(
                    (&message.channel.topic, message.log_time),
                    (&channel.topic, entry.log_time)
                );
                found.push((
                    channel.topic.clone(),
                    entry.log_time,
                    message.data.into_owned(),
                ));
            }
        }
    }
    found.retain(|(topic, ..)| topic != "/tf_static");
    // Of a sweep, points come before markers.
    found.sort_by(|a, b| (a.1, &b.0).cmp(&(b.1, &a.0)));
    found
}

/// Chunks end at their length, too.
#[test]
fn what_is_not_flushed_is_read_and_indexed() {
    let messages = messages(12);
    let mut writer = McapWriter::new(Vec::new()).unwrap();
    for one in &messages {
        writer.write(one).unwrap();
    }
    let bytes = writer.finish().unwrap();
    let chunks = mcap::Summary::read(&bytes).unwrap().unwrap().chunk_indexes;
    assert!((2..12).contains(&chunks.len()), "{}", chunks.len());
    assert!(read(&bytes) == expected(&messages));
    assert!(sought(&bytes) == expected(&messages));
}

#[test]
fn what_is_written_is_read_and_indexed() {
    let messages = messages(6);
    let bytes = file(&messages);
    assert!(read(&bytes) == expected(&messages));
    let summary = mcap::Summary::read(&bytes).unwrap().unwrap();
    let stats = summary.stats.unwrap();
    // Of each of two sensors: its transform, and two messages for each of three sweeps.
    assert_eq!((stats.message_count, stats.channel_count), (14, 5));
    assert_eq!(
        (stats.message_start_time, stats.message_end_time),
        (1_700_000_000_000_000_000, 1_700_000_000_500_000_000)
    );
    assert_eq!(summary.chunk_indexes.len(), 6);
    assert!(sought(&bytes) == expected(&messages));
    for channel in summary.channels.values() {
        let schema = channel.schema.as_ref().unwrap();
        assert_eq!(
            (&*schema.encoding, &*channel.message_encoding),
            ("ros2msg", "cdr")
        );
        let offered = &channel.metadata["offered_qos_profiles"];
        let is_static = channel.topic == "/tf_static";
        assert_eq!(offered.contains("durability: transient_local"), is_static);
    }
}
