//! Inputs that are nearly right: good ones with a few changes, as a fault or an attacker would make
//! them.

use fastrand::Rng;

/// Longest input that is made.
const MOST_LEN: usize = 96 << 10;
/// Numbers at which lengths, counts and signs go wrong.
const NUMBERS: [u64; 16] = [
    0,
    1,
    2,
    7,
    16,
    0x7F,
    0x80,
    0xFF,
    0x7FFF,
    0x8000,
    0xFFFF,
    0x7FFF_FFFF,
    0x8000_0000,
    0xFFFF_FFFF,
    i64::MAX as u64,
    u64::MAX,
];
/// What texts break on.
const WORDS: [&str; 32] = [
    "-1",
    "nan",
    "inf",
    "-inf",
    "1e999",
    "1e-999",
    "0",
    "65536",
    "4294967296",
    "99999999999999999999",
    "18446744073709551615",
    "[",
    "[[",
    "{",
    "}",
    "\"",
    "'''",
    "<",
    "</",
    "<!--",
    "&a;",
    "*a",
    "&a ",
    "#",
    "\n",
    "\r\n",
    "\t",
    "\u{feff}",
    "é",
    "\0",
    ": ",
    ", ",
];

/// A seed with a few changes, each at random; `other` gives a piece now and then.
pub fn mutated(rng: &mut Rng, seed: &[u8], other: &[u8]) -> Vec<u8> {
    let mut bytes = seed.to_vec();
    for _ in 0..1 + rng.usize(..4) * rng.usize(..3) {
        change(rng, &mut bytes, other);
    }
    bytes.truncate(MOST_LEN);
    bytes
}

fn change(rng: &mut Rng, bytes: &mut Vec<u8>, other: &[u8]) {
    let at = place(rng, bytes.len());
    match rng.u8(..16) {
        0..=2 if !bytes.is_empty() => bytes[at] ^= 1 << rng.u8(..8),
        3 if !bytes.is_empty() => bytes[at] = rng.u8(..),
        4..=6 => number(rng, bytes, at),
        7 => bytes.truncate(at),
        8 => drop(bytes.drain(at..(at + stretch(rng)).min(bytes.len()))),
        // A piece once more, often many times: nesting, tables without end.
        9 => {
            let piece = bytes[at..(at + stretch(rng)).min(bytes.len())].to_vec();
            let times = if rng.u8(..8) == 0 {
                MOST_LEN / (4 * piece.len().max(1))
            } else {
                rng.usize(1..4)
            };
            insert(bytes, at, &piece.repeat(times.min(4096)));
        }
        // A piece of another one.
        10 | 11 => {
            let from = place(rng, other.len());
            let piece = &other[from..(from + stretch(rng)).min(other.len())];
            if rng.bool() {
                insert(bytes, at, piece)
            } else {
                write(bytes, at, piece)
            }
        }
        12 => insert(bytes, at, WORDS[rng.usize(..WORDS.len())].as_bytes()),
        // A word, or a number in digits, in place of another.
        13 | 14 => {
            let end = bytes[at..]
                .iter()
                .position(|byte| !byte.is_ascii_alphanumeric() && !b".-+_".contains(byte));
            bytes.drain(at..end.map_or(bytes.len(), |len| at + len));
            insert(bytes, at, WORDS[rng.usize(..WORDS.len())].as_bytes());
        }
        // Behind the end.
        _ => bytes.extend((0..rng.usize(..40)).map(|_| rng.u8(..))),
    }
}

/// A number at which things go wrong, or one near that which stands there, in any width and order
/// of bytes.
fn number(rng: &mut Rng, bytes: &mut [u8], at: usize) {
    let width = 1 << rng.usize(..4);
    let found = bytes.get(at..at + width).map_or(0, |old| {
        old.iter()
            .rev()
            .fold(0, |n, &byte| n << 8 | u64::from(byte))
    });
    let value = match rng.u8(..4) {
        0 => found.wrapping_add(rng.u64(1..9)),
        1 => found.wrapping_sub(rng.u64(1..9)),
        _ => NUMBERS[rng.usize(..NUMBERS.len())],
    };
    let little = value.to_le_bytes();
    let mut piece = little[..width].to_vec();
    if rng.bool() {
        piece.reverse();
    }
    write(bytes, at, &piece);
}

/// A place up to the end; the first bytes, which say how to read the others, more often.
fn place(rng: &mut Rng, len: usize) -> usize {
    let most = if rng.u8(..3) == 0 { len.min(128) } else { len };
    rng.usize(..most.max(1)).min(len.saturating_sub(1))
}

fn stretch(rng: &mut Rng) -> usize {
    let most = 1 << rng.usize(..11);
    1 + rng.usize(..most)
}

fn insert(bytes: &mut Vec<u8>, at: usize, piece: &[u8]) {
    bytes.splice(at..at, piece.iter().copied());
}

fn write(bytes: &mut [u8], at: usize, piece: &[u8]) {
    bytes[at..]
        .iter_mut()
        .zip(piece)
        .for_each(|(byte, &new)| *byte = new);
}
