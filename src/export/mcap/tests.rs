//! Files read back by the library, cut, mended, rotated.

use std::fs;
use std::io::Cursor;
use std::path::Path;

use mcap::MessageStream;
use mcap::io::MessageReader;
use mcap::sans_io::LinearReaderOptions;

use super::*;
use crate::capture::record::Rotation;
use crate::export::test_scene::Scene;

/// The messages of sweeps of two sensors, a tenth of a second apart.
fn messages(sweeps: u64) -> Vec<SweepMessages> {
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
        all.push(SweepMessages::of(&scene.sweep()));
    }
    all
}

/// Chunks of one sweep each.
fn file(messages: &[SweepMessages]) -> Vec<u8> {
    let mut writer = McapWriter::new(Vec::new()).unwrap();
    for one in messages {
        writer.write(one).unwrap();
        writer.flush().unwrap();
    }
    writer.finish().unwrap()
}

/// Topic, time and bytes of each message.
type Read = Vec<(String, u64, Vec<u8>)>;

fn expected(messages: &[SweepMessages]) -> Read {
    let mut read = Read::new();
    for one in messages {
        for (topic, bytes) in [("points", &one.points), ("markers", &one.markers)] {
            let topic = format!("/sweepd/{}/{topic}", one.sensor);
            read.push((topic, one.time_ns, bytes.clone()));
        }
    }
    read
}

/// What a reader of whole files makes of it, without the transforms.
fn read(bytes: &[u8]) -> Read {
    let stream = MessageStream::new(bytes).unwrap().map(Result::unwrap);
    let found = stream.map(|one| {
        (
            one.channel.topic.clone(),
            one.log_time,
            one.data.into_owned(),
        )
    });
    found.filter(|(topic, ..)| topic != "/tf_static").collect()
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

/// A file that is cut anywhere gives what is in whole chunks, by the streaming reader and mended.
#[test]
fn a_file_cut_anywhere_is_mended_up_to_its_last_chunk() {
    let messages = messages(4);
    let bytes = file(&messages);
    let expected = expected(&messages);
    let summary = mcap::Summary::read(&bytes).unwrap().unwrap();
    let mut ends: Vec<usize> = summary
        .chunk_indexes
        .iter()
        .map(|chunk| (chunk.chunk_start_offset + chunk.chunk_length) as usize)
        .collect();
    ends.sort_unstable();
    let near = ends.iter().flat_map(|&end| end - 3..end + 4);
    let cuts = (0..bytes.len()).step_by(bytes.len() / 150).chain(near);
    for cut in cuts {
        let whole = ends.iter().filter(|&&end| end <= cut).count();
        let (_, mended) = mend(&bytes[..cut], Vec::new()).unwrap();
        let found = read(&mended);
        // More only where all of a chunk is there but the last bytes of its compression.
        assert!(found.len() >= 2 * whole, "cut at {cut} of {}", bytes.len());
        assert!(
            expected.starts_with(&found),
            "cut at {cut} of {}",
            bytes.len()
        );
        // A reader without an index may give messages of a chunk that is not whole, too.
        let options = LinearReaderOptions::default().with_skip_end_magic(true);
        let streamed = MessageReader::new_with_options(Cursor::new(&bytes[..cut]), options)
            .map_while(Result::ok)
            .filter(|one| one.channel.topic != "/tf_static");
        assert!(streamed.count() >= 2 * whole);
        let summary = mcap::Summary::read(&mended).unwrap().unwrap();
        assert!(summary.stats.unwrap().message_count >= found.len() as u64);
    }
    // Neither empty nor foreign files are a fault.
    for damaged in [&b""[..], b"\0\0\0", &[0x89; 4000]] {
        assert_eq!(mend(damaged, Vec::new()).unwrap().0, 0);
    }
}

fn names(folder: &Path) -> Vec<String> {
    let entries = fs::read_dir(folder).unwrap();
    let mut names: Vec<String> = entries
        .map(|entry| entry.unwrap().file_name().into_string().unwrap())
        .collect();
    names.sort();
    names
}

#[test]
fn a_recording_begins_new_files_and_mends_what_another_left() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("roof.mcap");
    let messages = messages(5);
    let rotation = Rotation {
        bytes: None,
        ns: Some(200_000_000),
    };
    // As a kill would leave it: two sweeps on the disk, and half a chunk.
    let whole = file(&messages[..3]);
    let summary = mcap::Summary::read(&whole).unwrap().unwrap();
    let last = summary
        .chunk_indexes
        .iter()
        .map(|chunk| chunk.chunk_start_offset);
    let cut = last.max().unwrap() as usize + 1000;
    fs::write(folder.path().join("roof-001.mcap.part"), &whole[..cut]).unwrap();
    fs::write(folder.path().join("roof-000.mcap"), "somebody's").unwrap();

    let mut files = McapFiles::create(&path, rotation, Existing::Keep, |_| {}).unwrap();
    let mended = folder.path().join("roof-001.mcap");
    assert!(read(&fs::read(&mended).unwrap()) == expected(&messages[..2]));
    // A file under way is nobody else's.
    let busy = McapFiles::create(
        &folder.path().join("roof-002.mcap"),
        Rotation::default(),
        Existing::Keep,
        |_| {},
    );
    assert!(matches!(busy.err(), Some(WriteError::Busy { .. })));
    for one in &messages {
        files.write(one).unwrap();
    }
    let written = files.finish().unwrap();
    assert_eq!((written.sweeps, written.files), (5, 3));
    assert_eq!(
        names(folder.path()),
        [
            "roof-000.mcap",
            "roof-001.mcap",
            "roof-002.mcap",
            "roof-003.mcap",
            "roof-004.mcap"
        ]
    );
    let mut all = Read::new();
    for number in 2..5 {
        let bytes = fs::read(folder.path().join(format!("roof-00{number}.mcap"))).unwrap();
        // Each file says itself where the sensors sit.
        let summary = mcap::Summary::read(&bytes).unwrap().unwrap();
        assert!(
            summary
                .channels
                .values()
                .any(|one| one.topic == "/tf_static")
        );
        all.extend(read(&bytes));
    }
    assert!(all == expected(&messages));
}

#[test]
fn existing_files_and_other_names_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("roof.mcap");
    let create = |existing| McapFiles::create(&path, Rotation::default(), existing, |_| {});
    fs::write(&path, "old").unwrap();
    assert!(matches!(
        create(Existing::Keep).err(),
        Some(WriteError::Exists { .. })
    ));
    // It is replaced when the new one is whole.
    let mut files = create(Existing::Replace).unwrap();
    files.write(&messages(1)[0]).unwrap();
    assert_eq!(fs::read(&path).unwrap(), b"old");
    files.finish().unwrap();
    assert_eq!(read(&fs::read(&path).unwrap()).len(), 2);
    for name in ["roof", "roof.pcap", ".mcap", "-"] {
        let error = McapOutput::create(name.as_ref(), Existing::Keep)
            .err()
            .unwrap();
        assert!(
            error.to_string().ends_with("a name that ends in .mcap"),
            "{error}"
        );
    }
}

/// What was recorded before the disk was full stays, and a file that could not begin is gone.
#[cfg(target_os = "linux")]
#[test]
fn a_full_disk_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("roof.mcap");
    std::os::unix::fs::symlink("/dev/full", &path).unwrap();
    let error = McapFiles::create(&path, Rotation::default(), Existing::Keep, |_| {})
        .err()
        .unwrap();
    assert!(
        error.to_string().contains("No space left on device"),
        "{error}"
    );
    let error = McapOutput::create(&path, Existing::Keep).and_then(|mut output| {
        output.write(&messages(1)[0])?;
        output.finish()
    });
    assert!(
        error
            .unwrap_err()
            .to_string()
            .contains("No space left on device")
    );
}
