//! PCD, the files of the Point Cloud Library (version 0.7 of the format; older ones say `COLUMNS`
//! for `FIELDS`).
//!
//! ```text
//! VERSION 0.7
//! FIELDS x y z ring
//! SIZE 4 4 4 2            bytes of a value
//! TYPE F F F U            F float, I signed, U unsigned
//! COUNT 1 1 1 1           values of a field; may be left out
//! WIDTH 1000
//! HEIGHT 1
//! POINTS 1000
//! DATA binary             or ascii; binary_compressed: two u32, length packed and unpacked, then field after field
//! ```

use super::super::POINT_BYTES;
use super::{
    Cloud, Field, ReadError, Roles, Scalar, ascii, binary, count, head_lines, lzf, shortened,
    starts,
};

/// Longest points that are read, all together, bytes.
const MAX_BODY_LEN: usize = 1 << 30;

/// Most unpacked bytes of packed points, counting at least [`POINT_BYTES`] for each: four million
/// points. A few bytes can expand to a gigabyte, while a cloud here is one turn.
const MAX_UNPACKED_LEN: usize = 64 << 20;

/// How the points are written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Data {
    Ascii,
    Binary,
    Compressed,
}

/// What the head says.
#[derive(Debug, Default)]
struct Head {
    names: Vec<String>,
    sizes: Vec<usize>,
    types: Vec<String>,
    counts: Vec<usize>,
    size: [Option<usize>; 2],
    points: Option<usize>,
    /// Line of `FIELDS` and of `DATA`.
    lines: [usize; 2],
}

/// The points of a file.
pub(super) fn read(bytes: &[u8]) -> Result<Cloud, ReadError> {
    let mut head = Head::default();
    for (line, end, text) in head_lines(bytes) {
        let text = std::str::from_utf8(text)
            .map_err(|_| ReadError::line(line, "no text where the head should be"))?;
        let mut words = text.split_ascii_whitespace();
        let Some(key) = words.next().filter(|key| !key.starts_with('#')) else {
            continue;
        };
        let words: Vec<&str> = words.collect();
        if key == "DATA" {
            head.lines[1] = line;
            let data = match words[..] {
                ["ascii"] => Data::Ascii,
                ["binary"] => Data::Binary,
                ["binary_compressed"] => Data::Compressed,
                _ => {
                    return Err(ReadError::line(
                        line,
                        "DATA must be ascii, binary or binary_compressed",
                    ));
                }
            };
            return head.body(data, &bytes[end..], end);
        }
        head.take(key, &words, line)
            .map_err(|message| ReadError::line(line, message))?;
    }
    let last = head_lines(bytes).last().map_or(1, |(line, ..)| line);
    Err(ReadError::line(
        last,
        "no line \"DATA ...\" up to here; a PCD file has one at the end of its head",
    ))
}

impl Head {
    fn take(&mut self, key: &str, words: &[&str], line: usize) -> Result<(), String> {
        match key {
            "VERSION" | "VIEWPOINT" => {}
            "FIELDS" | "COLUMNS" => {
                self.names = words.iter().map(|&word| word.to_owned()).collect();
                self.lines[0] = line;
            }
            "SIZE" => self.sizes = counts(words)?,
            "TYPE" => self.types = words.iter().map(|&word| word.to_owned()).collect(),
            "COUNT" => self.counts = counts(words)?,
            "WIDTH" => self.size[0] = Some(one_count(key, words)?),
            "HEIGHT" => self.size[1] = Some(one_count(key, words)?),
            "POINTS" => self.points = Some(one_count(key, words)?),
            _ => {
                let key = shortened(key);
                return Err(format!(
                    "\"{key}\" is no word of a PCD head; is this a PCD file, and its head ended by DATA?"
                ));
            }
        }
        Ok(())
    }

    /// The points behind the head, which ends at byte `first`.
    fn body(&mut self, data: Data, body: &[u8], first: usize) -> Result<Cloud, ReadError> {
        let [fields_line, data_line] = self.lines;
        let points = self
            .check_counts()
            .and_then(|()| self.point_count())
            .map_err(|message| ReadError::line(data_line, message))?;
        let (roles, scalars) = Roles::of_names(self.names.iter().map(String::as_str))
            .and_then(|roles| Ok((roles, self.scalars(roles)?)))
            .map_err(|message| ReadError::line(fields_line, message))?;
        if data == Data::Ascii {
            return self.ascii(body, points, roles);
        }
        let lengths: Vec<usize> = self
            .sizes
            .iter()
            .zip(&self.counts)
            .map(|(size, count)| size * count)
            .collect();
        let record: usize = lengths.iter().sum();
        let expected = points
            .checked_mul(record)
            .filter(|&bytes| bytes <= MAX_BODY_LEN)
            .ok_or_else(|| {
                let message = format!("{points} points of {record} bytes are too many");
                ReadError::line(data_line, message)
            })?;
        let starts = starts(&lengths);
        if data == Data::Binary {
            let fields: Vec<Field> = (0..scalars.len())
                .map(|field| Field {
                    scalar: scalars[field],
                    start: starts[field],
                    step: record,
                })
                .collect();
            return check_length(body, points, record, expected)
                .and_then(|()| binary(body, points, &fields, roles, false))
                .map_err(|(byte, message)| ReadError::byte(first + byte, message));
        }
        if points.saturating_mul(record.max(POINT_BYTES)) > MAX_UNPACKED_LEN {
            return Err(ReadError::line(
                data_line,
                format!(
                    "{points} points of {record} bytes, packed; at most {MAX_UNPACKED_LEN} bytes are unpacked, {POINT_BYTES} a point \
                 or more: write the file as DATA binary, or one turn a file"
                ),
            ));
        }
        let unpacked = unpack(body, expected)
            .map_err(|(byte, message)| ReadError::byte(first + byte, message))?;
        let fields: Vec<Field> = (0..scalars.len())
            .map(|field| Field {
                scalar: scalars[field],
                start: starts[field] * points,
                step: lengths[field],
            })
            .collect();
        // An unpacked byte has no position in the file.
        binary(&unpacked, points, &fields, roles, false)
            .map_err(|(_, message)| ReadError::byte(first + 8, message))
    }

    /// The points of a body in text.
    fn ascii(&self, body: &[u8], points: usize, roles: Roles) -> Result<Cloud, ReadError> {
        let [_, data_line] = self.lines;
        let words = self.counts.iter().sum();
        let word_of = starts(&self.counts);
        let roles = Roles {
            xyz: roles.xyz.map(|field| word_of[field]),
            intensity: roles.intensity.map(|field| word_of[field]),
            ring: roles.ring.map(|field| word_of[field]),
        };
        match ascii(body, data_line + 1, points, words, roles)? {
            (cloud, None) => Ok(cloud),
            (_, Some(line)) => Err(ReadError::line(
                line,
                format!("more lines than the {points} points of the head"),
            )),
        }
    }

    /// There is a size, a type and a count for each field.
    fn check_counts(&mut self) -> Result<(), String> {
        let fields = self.names.len();
        if self.counts.is_empty() {
            self.counts = vec![1; fields];
        }
        for (key, found) in [
            ("SIZE", self.sizes.len()),
            ("TYPE", self.types.len()),
            ("COUNT", self.counts.len()),
        ] {
            if found != fields {
                return Err(format!(
                    "{key} has {found} values, expected {fields}: one for each of FIELDS"
                ));
            }
        }
        let bad_size = self.sizes.iter().find(|size| ![1, 2, 4, 8].contains(*size));
        match (
            bad_size,
            self.counts.iter().find(|&&count| count > MAX_BODY_LEN),
        ) {
            (Some(size), _) => Err(format!("SIZE {size} is none of 1, 2, 4 and 8")),
            (None, Some(count)) => Err(format!("COUNT {count} is too much")),
            (None, None) => Ok(()),
        }
    }

    fn point_count(&self) -> Result<usize, String> {
        let area = match self.size {
            [Some(width), Some(height)] => Some(
                width
                    .checked_mul(height)
                    .ok_or_else(|| format!("WIDTH {width} x HEIGHT {height} is too much"))?,
            ),
            _ => None,
        };
        match (self.points, area) {
            (Some(points), Some(area)) if points != area => Err(format!(
                "POINTS {points}, but WIDTH x HEIGHT is {area}; they must be the same"
            )),
            (Some(points), _) | (None, Some(points)) => Ok(points),
            (None, None) => Err("no POINTS before DATA, nor WIDTH and HEIGHT".to_owned()),
        }
    }

    /// How the values of each field are written; those that mean something to us must be single
    /// ones.
    fn scalars(&self, roles: Roles) -> Result<Vec<Scalar>, String> {
        let used = roles
            .xyz
            .into_iter()
            .chain(roles.intensity)
            .chain(roles.ring);
        if let Some(field) = used.into_iter().find(|&field| self.counts[field] != 1) {
            return Err(format!(
                "the field {} has COUNT {}, expected 1",
                self.names[field], self.counts[field]
            ));
        }
        let mut scalars = Vec::new();
        for (index, size) in self.sizes.iter().enumerate() {
            scalars.push(match (self.types[index].as_str(), size) {
            ("I", 1) => Scalar::I8,
            ("I", 2) => Scalar::I16,
            ("I", 4) => Scalar::I32,
            ("I", 8) => Scalar::I64,
            ("U", 1) => Scalar::U8,
            ("U", 2) => Scalar::U16,
            ("U", 4) => Scalar::U32,
            ("U", 8) => Scalar::U64,
            ("F", 4) => Scalar::F32,
            ("F", 8) => Scalar::F64,
            (kind, size) => {
                let name = shortened(&self.names[index]);
                let kind = shortened(kind);
                return Err(format!(
                    "the field {name} has TYPE {kind} and SIZE {size}; expected I or U of 1 to 8, F of 4 or 8"
                ));
            }
            });
        }
        Ok(scalars)
    }
}

fn counts(words: &[&str]) -> Result<Vec<usize>, String> {
    words.iter().map(|word| count(word)).collect()
}

fn one_count(key: &str, words: &[&str]) -> Result<usize, String> {
    match words {
        [word] => count(word),
        _ => Err(format!("{key} must have one number")),
    }
}

/// The fields of a compressed file, one after the other; where it is none, the byte of the body and
/// a sentence.
fn unpack(body: &[u8], expected: usize) -> Result<Vec<u8>, (usize, String)> {
    let Some((lengths, rest)) = body.split_first_chunk::<8>() else {
        return Err((
            body.len(),
            "the file ends before the two lengths of its packed points; it was cut off".to_owned(),
        ));
    };
    let packed = Scalar::U32.read(&lengths[..4], false) as usize;
    let unpacked = Scalar::U32.read(&lengths[4..], false) as usize;
    if unpacked != expected {
        return Err((
            4,
            format!(
                "{unpacked} bytes of points, the head promises {expected}; one of them is wrong"
            ),
        ));
    }
    let Some(packed_bytes) = rest.get(..packed) else {
        let message = format!(
            "{packed} packed bytes promised, {} follow; the file was cut off",
            rest.len()
        );
        return Err((0, message));
    };
    nothing_behind(body, 8 + packed)?;
    lzf::unpack(packed_bytes, expected).map_err(|(byte, message)| (8 + byte, message))
}

/// A binary body holds the points of the head, and nothing behind them.
fn check_length(
    body: &[u8],
    points: usize,
    record: usize,
    expected: usize,
) -> Result<(), (usize, String)> {
    let found = body.len();
    if found < expected {
        let message = format!(
            "{found} bytes follow the head, {points} points of {record} bytes need {expected}; the file was cut off, or its \
             head is wrong"
        );
        return Err((found, message));
    }
    nothing_behind(body, expected)
}

/// Zeros may follow the points, since writers that map whole pages leave them.
fn nothing_behind(body: &[u8], end: usize) -> Result<(), (usize, String)> {
    match body[end..].iter().position(|&byte| byte != 0) {
        None => Ok(()),
        Some(further) => Err((
            end + further,
            "more bytes than the points of the head take; one is wrong".to_owned(),
        )),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A file with this many points of zeros, packed as tightly as can be.
    fn packed(points: usize, kind: &str, size: usize) -> Vec<u8> {
        let unpacked = 3 * size * points;
        // One zero, then stretches of 264; the rest as it stands.
        let mut body = vec![0, 0];
        body.extend([7 << 5, 0xFF, 0].repeat((unpacked - 1) / 264));
        body.extend([0, 0].repeat((unpacked - 1) % 264));
        let head = format!(
            "FIELDS x y z\nSIZE {size} {size} {size}\nTYPE {kind} {kind} {kind}\nPOINTS {points}\nDATA binary_compressed\n"
        );
        let lengths = [body.len() as u32, unpacked as u32]
            .map(u32::to_le_bytes)
            .concat();
        [head.as_bytes(), &lengths, &body].concat()
    }

    #[test]
    fn few_packed_bytes_cannot_take_all_of_the_memory() {
        for (points, kind, size) in [
            (80_000_000, "F", 4),
            (4_194_305, "F", 4),
            (4_194_305, "I", 1),
            (2_796_203, "F", 8),
        ] {
            let file = packed(points, kind, size);
            assert!(file.len() < 12_000_000, "{} bytes", file.len());
            let error = read(&file).unwrap_err().to_string();
            assert!(
                error.starts_with("line 5: ") && error.contains("at most 67108864 bytes"),
                "{error}"
            );
        }
        // One point less is read.
        assert_eq!(
            read(&packed(4_194_304, "I", 1)).unwrap().points.len(),
            4_194_304
        );
    }
}
