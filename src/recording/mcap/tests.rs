//! Files cut, mended, rotated, and read back by the library.

use std::fs;
use std::io::{Cursor, Write};
use std::ops::Range;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use mcap::io::MessageReader;
use mcap::sans_io::LinearReaderOptions;

use super::*;
use crate::export::mcap::tests::{Read, expected, file, messages, read};
use crate::export::mcap::{McapOutput, MessageForm};
use crate::export::test_scene::Scene;
use crate::files::WriteError;
use crate::files::output::Existing;
use crate::files::sequence::{RecoveryWatch, Rotation, Written};
use crate::input::bag::mcap::MAGIC;

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
        let over = AtomicBool::new(false);
        let refused = mend(Cursor::new(foreign), Vec::new(), &over).err().unwrap();
        assert_eq!(refused.kind(), io::ErrorKind::InvalidData);
    }
}

/// Messages, bytes, and what was found.
fn mend_all(damaged: &[u8]) -> (Read, Mended) {
    let over = AtomicBool::new(false);
    let (mended, out) = mend(Cursor::new(damaged), Vec::new(), &over).unwrap();
    let summary = mcap::Summary::read(&out).unwrap().unwrap();
    assert_eq!(summary.stats.unwrap().message_count, mended.messages);
    (read(&out), mended)
}

fn begin(path: &Path, rotation: Rotation, existing: Existing) -> Result<McapFiles, WriteError> {
    let watch = RecoveryWatch {
        over: Arc::default(),
        tell: |_| {},
    };
    McapFiles::create(path, rotation, existing, watch)
}

fn finish(files: McapFiles) -> Written {
    let (written, ended) = files.finish(Ok(()));
    ended.unwrap();
    written
}

/// A recording of one sensor: its messages, its bytes, and where each chunk with two of them lies.
struct Recording {
    messages: Read,
    bytes: Vec<u8>,
    chunks: Vec<Range<usize>>,
}

impl Recording {
    fn small() -> Self {
        let mut messages = Vec::new();
        let form = MessageForm {
            frame_id: Some("lidar_top".to_owned()),
            ..MessageForm::default()
        };
        for number in 0..8 {
            let mut scene = Scene::street(16, 100, false);
            scene.fill(|sweep| {
                sweep.header.time_ns += number * 100_000_000;
                sweep.header.set_name("roof");
            });
            messages.push(SweepMessages::of(&scene.sweep(), &form));
        }
        let bytes = file(&messages);
        let mut chunks = Vec::new();
        let summary = mcap::Summary::read(&bytes).unwrap().unwrap();
        for chunk in &summary.chunk_indexes {
            let start = chunk.chunk_start_offset as usize;
            chunks.push(start..start + chunk.chunk_length as usize);
        }
        chunks.sort_by_key(|chunk| chunk.start);
        Self {
            messages: expected(&messages),
            bytes,
            chunks,
        }
    }

    /// As a kill leaves it: no byte behind the last chunk.
    fn unfinished(&self) -> &[u8] {
        &self.bytes[..self.chunks[7].end]
    }

    /// Leaves these bytes as the part of a killed recording and records. Fails unless that gives a
    /// file, the bytes are still there, and the mended file has each message of each chunk that lies
    /// outside of the damage, in order, and none that was not recorded.
    fn check(&self, left: &[u8], damage: Range<usize>, what: &str) {
        let folder = tempfile::tempdir_in("/dev/shm").unwrap();
        let file = folder.path().join("roof.mcap");
        fs::write(folder.path().join("roof.mcap.part"), left).unwrap();
        let mut files = begin(&file, Rotation::default(), Existing::Keep).unwrap();
        files.write(&messages(1)[0]).unwrap();
        finish(files);
        assert_eq!(read(&fs::read(&file).unwrap()).len(), 2, "{what}");

        let mended = fs::read(folder.path().join("roof-recovered.mcap")).expect(what);
        let found = read(&mended);
        let mut rest = &found[..];
        let mut is_missing = false;
        for (chunk, messages) in self.chunks.iter().zip(self.messages.chunks(2)) {
            if rest.starts_with(messages) {
                rest = &rest[2..];
                continue;
            }
            let is_hit = chunk.start < damage.end && damage.start < chunk.end;
            assert!(is_hit, "{what}: the chunk at {chunk:?} is missing");
            is_missing = true;
        }
        assert!(rest.is_empty(), "{what}: {} messages too many", rest.len());
        let damaged = folder.path().join("roof-recovered.mcap.damaged");
        let is_kept = fs::read(damaged).is_ok_and(|bytes| bytes == left);
        assert!(is_kept || !is_missing, "{what}: the damaged file is gone");
    }
}

/// A tenth of the bits is in the first chunk, which describes the channels of all others.
#[test]
fn one_wrong_bit_costs_one_chunk_at_most() {
    let recording = Recording::small();
    let bytes = &recording.bytes;
    let mut random = fastrand::Rng::with_seed(1);
    // The first 64 bits are the magic: without it the file is no recording.
    let bits = (64..4096).chain((0..500).map(|_| random.usize(64..8 * bytes.len())));
    let mut in_first = 0;
    for bit in bits {
        let mut damaged = bytes.clone();
        damaged[bit / 8] ^= 1 << (bit % 8);
        in_first += usize::from(recording.chunks[0].contains(&(bit / 8)));
        recording.check(&damaged, bit / 8..bit / 8 + 1, &format!("bit {bit}"));
    }
    assert!(in_first > 1000, "{in_first}");
}

#[test]
fn noise_and_lengths_that_are_lies_cost_what_they_hit() {
    let recording = Recording::small();
    let (bytes, unfinished) = (&recording.bytes, recording.unfinished());
    let mut random = fastrand::Rng::with_seed(2);
    let noise: Vec<u8> = std::iter::repeat_with(|| random.u8(..))
        .take(4096)
        .collect();
    let behind = || bytes.len()..bytes.len() + 1;
    recording.check(&[bytes, &noise[..]].concat(), behind(), "noise behind");
    recording.check(
        &[unfinished, &noise].concat(),
        behind(),
        "noise behind chunks",
    );
    recording.check(&[unfinished, &[0; 4096]].concat(), behind(), "zeros behind");
    for at in (8..bytes.len() - 4096).step_by(997) {
        let mut damaged = bytes.clone();
        damaged[at..at + 4096].copy_from_slice(&noise);
        recording.check(&damaged, at..at + 4096, &format!("noise at {at}"));
    }
    for len in [0, 3, 10, 20, 31, 32, 35, 40, 62, 63].map(|bits| 1_u64 << bits) {
        for len in [len, !len] {
            for chunk in &recording.chunks {
                // The length of the record, of its records uncompressed, and of them compressed.
                for field in [1, 9 + 16, 9 + 28 + 4 + 3] {
                    let at = chunk.start + field;
                    let mut damaged = bytes.clone();
                    damaged[at..at + 8].copy_from_slice(&len.to_le_bytes());
                    recording.check(&damaged, at..at + 8, &format!("{len} at {at}"));
                }
            }
            // Of the header of the file, and of a chunk behind it.
            let mut damaged = bytes.clone();
            damaged[9..17].copy_from_slice(&len.to_le_bytes());
            recording.check(&damaged, 9..17, &format!("{len} in the header"));
            let chunk = [unfinished, &[6], &len.to_le_bytes(), &[b'x'; 50]].concat();
            recording.check(&chunk, behind(), &format!("{len} behind"));
        }
    }
}

/// A description that contradicts another one costs its own chunk.
#[test]
fn channels_of_a_lost_schema_cost_no_other_chunk() {
    // The first chunk describes one sensor, the second another one with the same schemas.
    let messages = messages(6);
    let bytes = file(&messages);
    let summary = mcap::Summary::read(&bytes).unwrap().unwrap();
    let starts = summary
        .chunk_indexes
        .iter()
        .map(|one| one.chunk_start_offset);
    let mut damaged = bytes;
    damaged[starts.min().unwrap() as usize + 80] ^= 1;
    let (found, mended) = mend_all(&damaged);
    // What is left of the first sensor has known channels, and names it.
    let kept: Read = expected(&messages)[2..]
        .iter()
        .filter(|(topic, ..)| topic.contains("roof"))
        .cloned()
        .collect();
    assert!(found.len() >= kept.len() && mended.damaged_places > 0);
    assert!(kept.iter().all(|message| found.contains(message)));
}

/// Whatever a killed recording left: the next one records, and what is no recording, or has no whole
/// chunk, stays.
#[test]
fn a_part_stops_no_recording_and_stays_where_nothing_of_it_is_whole() {
    let recording = Recording::small();
    let unfinished = recording.unfinished();
    let first = &recording.chunks[0];
    let mut without_magic = unfinished.to_vec();
    without_magic[3] ^= 1;
    let parts = [
        (unfinished.to_vec(), Some(16)),
        (recording.bytes[..first.start].to_vec(), Some(0)),
        (recording.bytes[..first.end - 1].to_vec(), None),
        (recording.bytes[..7].to_vec(), None),
        (without_magic, None),
        (b"Dear Sir,\n".repeat(20), None),
        ([MAGIC, &[0x77; 9000]].concat(), None),
    ];
    let sequence = Rotation {
        bytes: None,
        ns: Some(1),
    };
    for (left, mended) in parts {
        for (rotation, existing, name, recovered) in [
            (
                Rotation::default(),
                Existing::Keep,
                "roof.mcap",
                "roof-recovered.mcap",
            ),
            (
                Rotation::default(),
                Existing::Replace,
                "roof.mcap",
                "roof-recovered.mcap",
            ),
            (sequence, Existing::Keep, "roof-000.mcap", "roof-000.mcap"),
        ] {
            let folder = tempfile::tempdir().unwrap();
            let part = folder.path().join(format!("{name}.part"));
            fs::write(&part, &left).unwrap();
            let file = folder.path().join("roof.mcap");
            let mut files = begin(&file, rotation, existing).unwrap();
            files.write(&messages(1)[0]).unwrap();
            let written = finish(files);
            assert_eq!(read(&fs::read(&written.last).unwrap()).len(), 2);
            if let Some(count) = mended {
                let mended = fs::read(folder.path().join(recovered)).unwrap();
                assert_eq!(read(&mended).len(), count);
                assert_eq!(names(folder.path()).len(), 2);
            } else {
                assert_eq!(fs::read(&part).unwrap(), left);
            }
        }
    }
}

/// The first part of a number may be gone, and others not.
#[test]
fn a_number_of_which_any_part_remains_is_not_taken() {
    let recording = Recording::small();
    let sequence = Rotation {
        bytes: None,
        ns: Some(1),
    };
    for (left, is_mended) in [(&b"Dear Sir,"[..], false), (recording.unfinished(), true)] {
        let folder = tempfile::tempdir().unwrap();
        let part = folder.path().join("roof-000.mcap.part-2");
        fs::write(&part, left).unwrap();
        let files = begin(&folder.path().join("roof.mcap"), sequence, Existing::Keep);
        assert_eq!(
            finish(files.unwrap()).last,
            folder.path().join("roof-001.mcap")
        );
        if is_mended {
            let mended = fs::read(folder.path().join("roof-000.mcap")).unwrap();
            assert_eq!((names(folder.path()).len(), read(&mended).len()), (2, 16));
        } else {
            assert_eq!(
                names(folder.path()),
                ["roof-000.mcap.part-2", "roof-001.mcap"]
            );
            assert_eq!(fs::read(&part).unwrap(), left);
        }
    }
}

/// Each of many kills leaves a part, and each of them gets a name.
#[test]
fn as_many_recordings_may_be_killed_as_they_like() {
    let recording = Recording::small();
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("roof.mcap");
    fs::write(folder.path().join("roof.mcap.part"), "a letter").unwrap();
    for number in 1..=30 {
        fs::write(
            folder.path().join("roof.mcap.part-2"),
            recording.unfinished(),
        )
        .unwrap();
        drop(begin(&file, Rotation::default(), Existing::Keep).unwrap());
        // What the dropped one leaves has no message.
        let left = names(folder.path());
        assert!(left.contains(&"roof.mcap.part".to_owned()));
        assert!(left.len() > number + 1, "{left:?}");
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

    let mut files = begin(&path, rotation, Existing::Keep).unwrap();
    let mended = folder.path().join("roof-001.mcap");
    assert!(read(&fs::read(&mended).unwrap()) == expected(&messages[..2]));
    // A file under way is nobody else's.
    let busy = begin(
        &folder.path().join("roof-002.mcap"),
        Rotation::default(),
        Existing::Keep,
    );
    assert!(matches!(busy.err(), Some(WriteError::Busy { .. })));
    for one in &messages {
        files.write(one).unwrap();
    }
    let written = finish(files);
    assert_eq!((written.records, written.files), (5, 3));
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
    let create = |existing| begin(&path, Rotation::default(), existing);
    fs::write(&path, "old").unwrap();
    assert!(matches!(
        create(Existing::Keep).err(),
        Some(WriteError::Exists { .. })
    ));
    // It is replaced when the new one is whole.
    let mut files = create(Existing::Replace).unwrap();
    files.write(&messages(1)[0]).unwrap();
    assert_eq!(fs::read(&path).unwrap(), b"old");
    finish(files);
    assert_eq!(read(&fs::read(&path).unwrap()).len(), 2);
    for name in ["roof", "roof.pcap", ".mcap", "-"] {
        let path = name.as_ref();
        let exported = McapOutput::create(path, Existing::Keep).err();
        let recorded = begin(path, Rotation::default(), Existing::Keep).err();
        for error in [exported.unwrap(), recorded.unwrap()] {
            let text = error.to_string();
            assert!(text.ends_with("a name that ends in .mcap"), "{text}");
        }
    }
}

/// Where the disk takes no more, wherever that is in a chunk or in the end of the file, what is whole
/// can be read at once.
#[test]
fn a_file_that_the_disk_cut_anywhere_is_ended_behind_its_last_chunk() {
    let recording = Recording::small();
    let (bytes, chunks) = (&recording.bytes, &recording.chunks);
    let last = &chunks[7];
    let near = [
        last.start,
        last.end - 1,
        last.end,
        last.end + 5,
        bytes.len(),
    ];
    let cuts = (chunks[4].start..bytes.len()).step_by(bytes.len() / 60);
    for cut in cuts.chain(near) {
        // Known to be whole: nothing, or the header and all chunks.
        let whole = chunks.iter().filter(|chunk| chunk.end <= cut).count();
        for safe_len in [0, chunks[0].start, chunks[whole - 1].end] {
            let mut file = tempfile::NamedTempFile::new_in("/dev/shm").unwrap();
            file.write_all(&bytes[..cut]).unwrap();
            mend::end_early(file.reopen().unwrap(), safe_len as u64).unwrap();
            let found = fs::read(file.path()).unwrap();
            assert!(
                read(&found) == recording.messages[..2 * whole],
                "cut at {cut}"
            );
            // The library knows that there is no index.
            assert!(mcap::Summary::read(&found).unwrap().is_none());
        }
    }
    for cut in [0, 7, chunks[0].start, chunks[0].end - 1] {
        let mut file = tempfile::NamedTempFile::new_in("/dev/shm").unwrap();
        file.write_all(&bytes[..cut]).unwrap();
        assert!(mend::end_early(file.reopen().unwrap(), 0).is_err());
        assert_eq!(fs::read(file.path()).unwrap(), &bytes[..cut]);
    }
}

/// It has its name, unless it was to replace a file.
#[test]
fn what_was_written_before_the_disk_failed_is_a_file() {
    let all = messages(3);
    for existing in [Existing::Keep, Existing::Replace] {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("roof.mcap");
        let mut files = begin(&file, Rotation::default(), existing).unwrap();
        for one in &all {
            files.write(one).unwrap();
        }
        let full = WriteError::file(&file, io::ErrorKind::StorageFull.into());
        let (written, ended) = files.finish(Err(full));
        let error = ended.unwrap_err().to_string();
        let place = match existing {
            Existing::Keep => file,
            Existing::Replace => folder.path().join("roof.mcap.part"),
        };
        let begin = format!("cannot write {}: no storage space; ", place.display());
        assert!(error.starts_with(&begin), "{error}");
        assert_eq!((names(folder.path()).len(), &written.last), (1, &place));
        assert!(read(&fs::read(place).unwrap()) == expected(&all));
    }
}

/// Another program has taken it away, or put something in its place: that stays.
#[test]
fn a_part_that_is_gone_gets_no_end() {
    for other in [None, Some("of another program")] {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("roof.mcap");
        let part = folder.path().join("roof.mcap.part");
        let mut files = begin(&file, Rotation::default(), Existing::Keep).unwrap();
        files.write(&messages(1)[0]).unwrap();
        fs::remove_file(&part).unwrap();
        if let Some(other) = other {
            fs::write(&part, other).unwrap();
        }
        let failed = WriteError::file(&file, io::Error::other("the disk is gone"));
        let (_, ended) = files.finish(Err(failed));
        let error = ended.unwrap_err().to_string();
        assert!(
            error.contains("roof.mcap.part: the disk is gone"),
            "{error}"
        );
        assert_eq!(names(folder.path()).len(), usize::from(other.is_some()));
        assert_eq!(fs::read_to_string(&part).ok().as_deref(), other);
    }
}

/// What was recorded before the disk was full stays, and a file that could not begin is gone.
#[cfg(target_os = "linux")]
#[test]
fn a_full_disk_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("roof.mcap");
    std::os::unix::fs::symlink("/dev/full", &path).unwrap();
    let error = begin(&path, Rotation::default(), Existing::Keep)
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
