//! PLY, the Stanford triangle format: its vertices are the points.
//!
//! ```text
//! ply
//! format ascii 1.0        or binary_little_endian, binary_big_endian
//! element vertex 1000
//! property float x
//! ...
//! end_header
//! ```
//!
//! The vertices must be the first element; later ones are ignored.

use super::{
    Cloud, Field, ReadError, Roles, Scalar, ascii, binary, count, head_lines, shortened, starts,
};

/// How the points are written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Data {
    Ascii,
    Binary { big_endian: bool },
}

/// What the head says.
#[derive(Debug, Default)]
struct Head {
    data: Option<Data>,
    /// How many vertices there are, and the line that says so.
    vertices: Option<(usize, usize)>,
    /// Another element has begun.
    is_past_vertices: bool,
    names: Vec<String>,
    scalars: Vec<Scalar>,
}

/// The points of a file.
pub(super) fn read(bytes: &[u8]) -> Result<Cloud, ReadError> {
    let mut head = Head::default();
    for (line, end, text) in head_lines(bytes) {
        let text = std::str::from_utf8(text)
            .map_err(|_| ReadError::line(line, "no text where the head should be"))?;
        let words: Vec<&str> = text.split_ascii_whitespace().collect();
        match (line, &words[..]) {
            (1, ["ply"]) | (2.., [] | ["comment" | "obj_info", ..]) => {}
            (1, _) => {
                return Err(ReadError::line(
                    line,
                    "a PLY file begins with a line \"ply\"; this is none",
                ));
            }
            (_, ["end_header"]) => return head.body(&bytes[end..], end, line),
            _ => head
                .take(&words, line)
                .map_err(|message| ReadError::line(line, message))?,
        }
    }
    let last = head_lines(bytes).last().map_or(1, |(line, ..)| line);
    Err(ReadError::line(
        last,
        "no line \"end_header\" up to here; a PLY file has one at the end of its head",
    ))
}

impl Head {
    fn take(&mut self, words: &[&str], line: usize) -> Result<(), String> {
        match words {
            ["format", format, "1.0"] => {
                self.data = Some(match *format {
                    "ascii" => Data::Ascii,
                    "binary_little_endian" => Data::Binary { big_endian: false },
                    "binary_big_endian" => Data::Binary { big_endian: true },
                    _ => {
                        let format = shortened(format);
                        return Err(format!(
                            "format \"{format}\", expected ascii, binary_little_endian or binary_big_endian"
                        ));
                    }
                });
            }
            ["element", "vertex", vertices] if self.vertices.is_none() => {
                self.vertices = Some((count(vertices)?, line));
            }
            ["element", name, _] if self.vertices.is_none() => {
                let name = shortened(name);
                return Err(format!(
                    "the element {name} stands before the vertices; write the file with these first"
                ));
            }
            ["element", ..] => self.is_past_vertices = true,
            ["property", ..] if self.is_past_vertices => {}
            ["property", "list", ..] => {
                return Err(
                    "a vertex with a list is no point; write the file without it".to_owned(),
                );
            }
            ["property", kind, name] if self.vertices.is_some() => {
                let scalar = scalar(kind)
                    .ok_or_else(|| format!("\"{}\" is no type of a property", shortened(kind)))?;
                self.scalars.push(scalar);
                self.names.push((*name).to_owned());
            }
            _ => {
                let word = shortened(words.first().copied().unwrap_or_default());
                return Err(format!(
                    "a line \"{word} ...\" like this has no place in a PLY head"
                ));
            }
        }
        Ok(())
    }

    /// The points behind the head, which ends at byte `first`, in this line.
    fn body(&self, body: &[u8], first: usize, line: usize) -> Result<Cloud, ReadError> {
        let Some((points, vertex_line)) = self.vertices else {
            return Err(ReadError::line(
                line,
                "no line \"element vertex ...\" in the head; there are no points",
            ));
        };
        let data = self
            .data
            .ok_or_else(|| ReadError::line(line, "no line \"format ... 1.0\" in the head"))?;
        let roles = Roles::of_names(self.names.iter().map(String::as_str));
        let roles = roles.map_err(|message| ReadError::line(vertex_line, message))?;
        let big_endian = match data {
            Data::Ascii => return Ok(ascii(body, line + 1, points, self.names.len(), roles)?.0),
            Data::Binary { big_endian } => big_endian,
        };
        let lengths: Vec<usize> = self.scalars.iter().map(|scalar| scalar.size()).collect();
        let step: usize = lengths.iter().sum();
        if points
            .checked_mul(step)
            .is_none_or(|expected| body.len() < expected)
        {
            let found = body.len();
            let message = format!(
                "{found} bytes follow the head, not enough for {points} points of {step} bytes; the file was cut off, or \
                 its head is wrong"
            );
            return Err(ReadError::byte(first + found, message));
        }
        let fields: Vec<Field> = (self.scalars.iter().zip(starts(&lengths)))
            .map(|(&scalar, start)| Field {
                scalar,
                start,
                step,
            })
            .collect();
        binary(body, points, &fields, roles, big_endian)
            .map_err(|(byte, message)| ReadError::byte(first + byte, message))
    }
}

/// A type of PLY, by either of its names.
fn scalar(name: &str) -> Option<Scalar> {
    Some(match name {
        "char" | "int8" => Scalar::I8,
        "uchar" | "uint8" => Scalar::U8,
        "short" | "int16" => Scalar::I16,
        "ushort" | "uint16" => Scalar::U16,
        "int" | "int32" => Scalar::I32,
        "uint" | "uint32" => Scalar::U32,
        "float" | "float32" => Scalar::F32,
        "double" | "float64" => Scalar::F64,
        _ => return None,
    })
}
