//! Recordings as MCAP that a killed recorder or a bad disk left, and their mender.

use std::io::{Cursor, ErrorKind};
use std::sync::atomic::AtomicBool;

use flate2::Crc;
use sweepd::recording::mcap::{Mended, mend};

const MAGIC: &[u8] = b"\x89MCAP0\r\n";

/// A file; or, behind a zero, records, which get a chunk with the right check sum. What is mended
/// has all messages that were found, and nothing more to mend.
pub fn mender(input: &[u8]) {
    let file = match input.split_first() {
        Some((0, records)) => with_chunk(records),
        _ => input.to_vec(),
    };
    let Some((found, mended)) = mend_all(file) else {
        return;
    };
    let (again, _) = mend_all(mended).expect("what was written is read");
    // Behind the last record of a whole file are the bytes that it begins with.
    let whole = Mended {
        messages: found.messages,
        damaged_places: 0,
        cut_bytes: MAGIC.len() as u64,
    };
    assert_eq!(again, whole);
}

fn mend_all(file: Vec<u8>) -> Option<(Mended, Vec<u8>)> {
    match mend(Cursor::new(file), Vec::new(), &AtomicBool::new(false)) {
        Ok(mended) => Some(mended),
        Err(error) => {
            assert_eq!(error.kind(), ErrorKind::InvalidData, "{error}");
            None
        }
    }
}

/// A recording of this program that was cut behind its first chunk.
fn with_chunk(records: &[u8]) -> Vec<u8> {
    let header = [&text("ros2")[..], &text("sweepd")].concat();
    let mut sum = Crc::new();
    sum.update(records);
    let len = (records.len() as u64).to_le_bytes();
    let chunk = [
        &[0; 16][..],
        &len,
        &sum.sum().to_le_bytes(),
        &text(""),
        &len,
        records,
    ];
    [MAGIC, &record(1, &header), &record(6, &chunk.concat())].concat()
}

fn record(opcode: u8, body: &[u8]) -> Vec<u8> {
    [&[opcode][..], &(body.len() as u64).to_le_bytes(), body].concat()
}

fn text(text: &str) -> Vec<u8> {
    [&(text.len() as u32).to_le_bytes()[..], text.as_bytes()].concat()
}
