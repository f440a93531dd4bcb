//! Files read back by the library, cut, mended, rotated.

use std::fs;
use std::io::Cursor;
use std::ops::Range;
use std::path::Path;
use std::sync::LazyLock;

use mcap::MessageStream;
use mcap::io::MessageReader;
use mcap::sans_io::LinearReaderOptions;

use super::*;
use crate::capture::bag::mcap::MAGIC;
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
    let header = 60;
    let cuts = (header..bytes.len()).step_by(bytes.len() / 150).chain(near);
    for cut in cuts {
        let whole = ends.iter().filter(|&&end| end <= cut).count();
        let (found, mended) = mend_all(&bytes[..cut]);
        assert_eq!(mended.damaged_places, 0, "cut at {cut} of {}", bytes.len());
        assert!(found.len() == 2 * whole, "cut at {cut} of {}", bytes.len());
        assert!(expected.starts_with(&found));
        // A reader without an index may give messages of a chunk that is not whole, too.
        let options = LinearReaderOptions::default().with_skip_end_magic(true);
        let streamed = MessageReader::new_with_options(Cursor::new(&bytes[..cut]), options)
            .map_while(Result::ok)
            .filter(|one| one.channel.topic != "/tf_static");
        assert!(streamed.count() >= 2 * whole);
    }
    for foreign in [&b""[..], b"\0\0\0", &[0x89; 4000], b"Dear Sir,\n"] {
        let refused = mend(Cursor::new(foreign), Vec::new()).err().unwrap();
        assert_eq!(refused.kind(), io::ErrorKind::InvalidData);
    }
}

/// The messages of a mended file, which has an index.
fn mend_all(damaged: &[u8]) -> (Read, Mended) {
    let (mended, out) = mend(Cursor::new(damaged), Vec::new()).unwrap();
    let summary = mcap::Summary::read(&out).unwrap().unwrap();
    assert_eq!(summary.stats.unwrap().message_count, mended.messages);
    (read(&out), mended)
}

/// A recording of one sensor: its messages, its bytes, and where each chunk with two of them lies.
fn small_recording() -> (Read, Vec<u8>, Vec<Range<usize>>) {
    let messages: Vec<SweepMessages> = (0..8_i64)
        .map(|number| {
            let mut scene = Scene::street(16, 100, false);
            scene.fill(|sweep| {
                sweep.header.time_ns += number * 100_000_000;
                sweep.header.set_name("roof");
            });
            SweepMessages::of(&scene.sweep())
        })
        .collect();
    let bytes = file(&messages);
    let summary = mcap::Summary::read(&bytes).unwrap().unwrap();
    let mut chunks: Vec<Range<usize>> = summary
        .chunk_indexes
        .iter()
        .map(|chunk| chunk.chunk_start_offset as usize..)
        .zip(&summary.chunk_indexes)
        .map(|(from, chunk)| from.start..from.start + chunk.chunk_length as usize)
        .collect();
    chunks.sort_by_key(|chunk| chunk.start);
    (expected(&messages), bytes, chunks)
}

/// Fails unless the mended file has each message of each chunk that lies outside of the damage, in
/// order, nothing that was not recorded, and says so where something is missing.
fn check_mended(damaged: &[u8], damage: Range<usize>, what: &str) {
    static RECORDING: LazyLock<(Read, Vec<u8>, Vec<Range<usize>>)> = LazyLock::new(small_recording);
    let (expected, _, chunks) = &*RECORDING;
    let (found, mended) = mend_all(damaged);
    let mut rest = &found[..];
    for (chunk, messages) in chunks.iter().zip(expected.chunks(2)) {
        if rest.starts_with(messages) {
            rest = &rest[2..];
            continue;
        }
        let is_hit = chunk.start < damage.end && damage.start < chunk.end;
        assert!(is_hit, "{what}: the chunk at {chunk:?} is missing");
        assert!(mended.damaged_places > 0, "{what}: nothing is said");
    }
    assert!(rest.is_empty(), "{what}: {} messages too many", rest.len());
}

/// 20 to 25 % of the bits are in the first chunk, which describes the channels of all others.
#[test]
fn one_wrong_bit_costs_one_chunk_at_most() {
    let (_, bytes, chunks) = small_recording();
    let mut random = fastrand::Rng::with_seed(1);
    // The first 64 bits are the magic: without it the file is refused.
    let bits = (64..4096).chain((0..500).map(|_| random.usize(64..8 * bytes.len())));
    let mut in_first = 0;
    for bit in bits {
        let mut damaged = bytes.clone();
        damaged[bit / 8] ^= 1 << (bit % 8);
        in_first += usize::from(chunks[0].contains(&(bit / 8)));
        check_mended(&damaged, bit / 8..bit / 8 + 1, &format!("bit {bit}"));
    }
    assert!(in_first > 1000, "{in_first}");
    for bit in 0..64 {
        let mut damaged = bytes.clone();
        damaged[bit / 8] ^= 1 << (bit % 8);
        assert!(mend(Cursor::new(damaged), Vec::new()).is_err());
    }
}

#[test]
fn noise_and_lengths_that_are_lies_cost_what_they_hit() {
    let (_, bytes, chunks) = small_recording();
    let mut random = fastrand::Rng::with_seed(2);
    let noise: Vec<u8> = std::iter::repeat_with(|| random.u8(..))
        .take(4096)
        .collect();
    let behind = bytes.len()..bytes.len() + 1;
    let unfinished = &bytes[..chunks[7].end];
    check_mended(
        &[&bytes, &noise[..]].concat(),
        behind.clone(),
        "noise behind",
    );
    check_mended(
        &[unfinished, &noise].concat(),
        behind.clone(),
        "noise behind chunks",
    );
    check_mended(&[unfinished, &[0; 4096]].concat(), behind, "zeros behind");
    for at in (8..bytes.len() - 4096).step_by(997) {
        let mut damaged = bytes.clone();
        damaged[at..at + 4096].copy_from_slice(&noise);
        check_mended(&damaged, at..at + 4096, &format!("noise at {at}"));
    }
    for bits in [0, 3, 10, 20, 31, 32, 35, 40, 62, 63] {
        let len = (1_u64 << bits).to_le_bytes();
        for chunk in &chunks {
            // The length of the record, of its records uncompressed, and of them compressed.
            for field in [1, 9 + 16, 9 + 28 + 4 + 3] {
                let at = chunk.start + field;
                let mut damaged = bytes.clone();
                damaged[at..at + 8].copy_from_slice(&len);
                check_mended(&damaged, at..at + 8, &format!("2^{bits} at {at}"));
            }
        }
        let behind = [unfinished, &[6], &len, &[b'x'; 50]].concat();
        check_mended(
            &behind,
            bytes.len()..bytes.len() + 1,
            &format!("2^{bits} behind"),
        );
    }
}

/// Whatever a killed recording left: the next one records, and the bytes of what was not only cut
/// are still there.
#[test]
fn a_damaged_part_is_kept_and_stops_no_recording() {
    let (_, bytes, chunks) = small_recording();
    let cut = &bytes[..chunks[7].end];
    let mut wrong = cut.to_vec();
    wrong[chunks[0].start + 60] ^= 4;
    let new = &messages(1)[0];
    for (left, recovered) in [
        (cut.to_vec(), Some(16)),
        (wrong, Some(14)),
        ([cut, &[0x99; 4096]].concat(), Some(16)),
        (b"Dear Sir,\n".repeat(20), None),
        (bytes[..chunks[0].end - 1].to_vec(), Some(0)),
        (bytes[..7].to_vec(), None),
        (MAGIC.iter().chain(&[0x77; 9000]).copied().collect(), None),
    ] {
        for rotation in [
            Rotation::default(),
            Rotation {
                bytes: None,
                ns: Some(1),
            },
        ] {
            for existing in [Existing::Keep, Existing::Replace] {
                if rotation.is_wanted() && existing == Existing::Replace {
                    continue;
                }
                let folder = tempfile::tempdir().unwrap();
                let file = folder.path().join("roof.mcap");
                let name = if rotation.is_wanted() {
                    "roof-000.mcap"
                } else {
                    "roof.mcap"
                };
                let part = folder.path().join(format!("{name}.part"));
                fs::write(&part, &left).unwrap();
                let mut files = McapFiles::create(&file, rotation, existing, |_| {}).unwrap();
                files.write(new).unwrap();
                let written = files.finish().unwrap();
                assert_eq!(read(&fs::read(&written.last).unwrap()).len(), 2);
                let all: Vec<Vec<u8>> = names(folder.path())
                    .iter()
                    .map(|name| fs::read(folder.path().join(name)).unwrap())
                    .collect();
                let is_only_cut = left.len() <= cut.len() && bytes.starts_with(&left);
                let stays = left.len() < 8 || !is_only_cut;
                assert_eq!(all.contains(&left), stays, "{:?}", names(folder.path()));
                let name = if rotation.is_wanted() {
                    name
                } else {
                    "roof-recovered.mcap"
                };
                match recovered {
                    Some(count) => {
                        let mended = fs::read(folder.path().join(name)).unwrap();
                        assert_eq!(read(&mended).len(), count);
                        assert!(!part.exists());
                    }
                    None => assert!(part.exists()),
                }
            }
        }
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
