//! LZF, the packing of compressed PCD files (Marc Lehmann, liblzf 3.6, `lzf_d.c`).
//!
//! A byte below 32 says that this many and one bytes follow as they are. Any other has in its upper
//! three bits the length of a stretch to repeat, less 2 (7: the next byte is added), and in its
//! lower five with the next byte how far back it begins, less 1.

/// Most bytes that come out of one: three say 264.
const MOST_FOLD: usize = 88;

const CUT_OFF: &str = "the packed bytes end in the middle of a stretch";

/// Unpacks as many bytes as are expected; where they are no such packing, the byte and a sentence.
pub(super) fn unpack(packed: &[u8], expected: usize) -> Result<Vec<u8>, (usize, String)> {
    if expected > packed.len().saturating_mul(MOST_FOLD) {
        let message = format!(
            "{} packed bytes cannot hold the {expected} that the head promises",
            packed.len()
        );
        return Err((0, message));
    }
    let mut out: Vec<u8> = Vec::with_capacity(expected);
    let mut at = 0;
    while at < packed.len() {
        let begin = at;
        let control = next(packed, &mut at).ok_or_else(|| damaged(begin, CUT_OFF))?;
        if control < 32 {
            let literal = packed.get(begin + 1..begin + 2 + control);
            out.extend_from_slice(literal.ok_or_else(|| damaged(begin, CUT_OFF))?);
            at += control + 1;
        } else {
            let mut length = (control >> 5) + 2;
            if control >> 5 == 7 {
                length += next(packed, &mut at).ok_or_else(|| damaged(begin, CUT_OFF))?;
            }
            let low = next(packed, &mut at).ok_or_else(|| damaged(begin, CUT_OFF))?;
            let back = ((control & 31) << 8) + low + 1;
            let from = out
                .len()
                .checked_sub(back)
                .ok_or_else(|| damaged(begin, "a stretch repeats what is before the start"))?;
            for byte in from..from + length {
                out.push(out[byte]);
            }
        }
        if out.len() > expected {
            let message = format!("more than the {expected} bytes that the head promises");
            return Err(damaged(begin, &message));
        }
    }
    match out.len() {
        found if found == expected => Ok(out),
        found => Err((
            packed.len(),
            format!("{found} bytes unpacked, the head promises {expected}; the file is damaged"),
        )),
    }
}

/// The byte at `at`, which moves to the next one.
fn next(packed: &[u8], at: &mut usize) -> Option<usize> {
    let byte = packed.get(*at)?;
    *at += 1;
    Some(usize::from(*byte))
}

fn damaged(byte: usize, message: &str) -> (usize, String) {
    (byte, format!("{message}; the file is damaged"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn stretches_by_hand() {
        assert_eq!(unpack(&[2, 7, 8, 9], 3).unwrap(), [7, 8, 9]);
        // Three bytes, then 1 + 2 of them again.
        assert_eq!(
            unpack(&[2, 7, 8, 9, 1 << 5, 2], 6).unwrap(),
            [7, 8, 9, 7, 8, 9]
        );
        // One byte over and over: it repeats what it just wrote. 7 + 3 + 2.
        assert_eq!(unpack(&[0, 5, 7 << 5, 3, 0], 13).unwrap(), [5; 13]);
        assert!(unpack(&[], 0).unwrap().is_empty());
    }

    #[test]
    fn what_is_no_packing_is_refused() {
        let error = |packed: &[u8], expected: usize| unpack(packed, expected).unwrap_err();
        assert_eq!(error(&[2, 7, 8], 3).0, 0);
        assert_eq!(error(&[0, 7, 1 << 5], 4).0, 2);
        assert!(error(&[0, 7, 1 << 5, 1], 4).1.contains("before the start"));
        assert!(error(&[2, 7, 8, 9], 2).1.contains("more than the 2 bytes"));
        assert!(error(&[2, 7, 8, 9], 4).1.contains("3 bytes unpacked"));
        assert!(error(&[2, 7, 8, 9], usize::MAX).1.contains("cannot hold"));
    }

    proptest! {
        #[test]
        fn anything_ends(packed in proptest::collection::vec(any::<u8>(), 0..300), expected in 0..3000_usize) {
            if let Ok(bytes) = unpack(&packed, expected) {
                prop_assert_eq!(bytes.len(), expected);
            }
        }
    }
}
