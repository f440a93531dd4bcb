//! Clouds from files.
//!
//! * [`kitti`]: KITTI's `.bin` and nuScenes' `.pcd.bin`, which are f32 without a head.
//! * [`pcd`]: PCL's PCD: ascii, binary and compressed, whose packing [`lzf`] undoes.
//! * [`ply`]: PLY: ascii and binary of either order of bytes.
//!
//! Fields may be of any type and in any order; fields other than `x`, `y`, `z`, `intensity` and
//! `ring` are ignored. Points are not transformed: x forward, y left, z up around the sensor, in
//! metres; the viewpoint of a PCD is ignored. Counts are checked against the length of the file.

mod kitti;
mod lzf;
mod pcd;
mod ply;

use std::path::Path;
use std::str::FromStr;

use super::{Cloud, CloudError};

/// Longest head of a PCD or PLY file, bytes.
const MAX_HEAD_LEN: usize = 64 << 10;

/// The kind of a file with points.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Format {
    /// KITTI `.bin`: x, y, z, remission as little-endian f32.
    Kitti,
    /// nuScenes `.pcd.bin`: x, y, z, intensity, ring as little-endian f32.
    Nuscenes,
    /// PCD of PCL.
    Pcd,
    /// PLY.
    Ply,
}

impl Format {
    /// Told by the end of a file's name.
    pub fn of_name(path: &Path) -> Option<Self> {
        let name = path.file_name()?.to_string_lossy().to_lowercase();
        let ends = [
            (".pcd.bin", Self::Nuscenes),
            (".bin", Self::Kitti),
            (".pcd", Self::Pcd),
            (".ply", Self::Ply),
        ];
        ends.into_iter()
            .find(|(end, _)| name.ends_with(end))
            .map(|(_, format)| format)
    }
}

impl FromStr for Format {
    type Err = String;

    fn from_str(word: &str) -> Result<Self, String> {
        match word {
            "kitti" => Ok(Self::Kitti),
            "nuscenes" => Ok(Self::Nuscenes),
            "pcd" => Ok(Self::Pcd),
            "ply" => Ok(Self::Ply),
            _ => Err("expected kitti, nuscenes, pcd or ply".to_owned()),
        }
    }
}

/// Where in a file something is wrong.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FilePosition {
    /// A line, from 1.
    Line(usize),
    /// A byte, from 0.
    Byte(usize),
}

impl std::fmt::Display for FilePosition {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Line(line) => write!(f, "line {line}"),
            Self::Byte(byte) => write!(f, "byte {byte}"),
        }
    }
}

/// Why a file holds no cloud.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{place}: {message}")]
pub struct ReadError {
    /// Where it goes wrong.
    pub place: FilePosition,
    /// What is there and what was expected.
    pub message: String,
}

impl ReadError {
    fn line(line: usize, message: impl Into<String>) -> Self {
        Self {
            place: FilePosition::Line(line),
            message: message.into(),
        }
    }

    fn byte(byte: usize, message: impl Into<String>) -> Self {
        Self {
            place: FilePosition::Byte(byte),
            message: message.into(),
        }
    }
}

impl Cloud {
    /// The points of a file of this format.
    ///
    /// # Errors
    /// [`CloudError::Length`] and [`CloudError::Read`], with the place.
    pub fn read(bytes: &[u8], format: Format) -> Result<Self, CloudError> {
        match format {
            Format::Kitti => Ok(Self {
                points: super::points(bytes)?,
                rings: None,
            }),
            Format::Nuscenes => Ok(kitti::nuscenes(bytes)?),
            Format::Pcd => Ok(pcd::read(bytes)?),
            Format::Ply => Ok(ply::read(bytes)?),
        }
    }
}

/// How a number is written in a binary file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Scalar {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    I64,
    U64,
    F32,
    F64,
}

impl Scalar {
    fn size(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::I32 | Self::U32 | Self::F32 => 4,
            Self::I64 | Self::U64 | Self::F64 => 8,
        }
    }

    /// The number at the start of these bytes, of which there are at least [`Scalar::size`].
    fn read(self, bytes: &[u8], big_endian: bool) -> f64 {
        fn first<const N: usize>(bytes: &[u8], big_endian: bool) -> [u8; N] {
            let mut first: [u8; N] = bytes[..N].try_into().expect("as many bytes as were taken");
            if big_endian {
                first.reverse();
            }
            first
        }
        match self {
            Self::I8 => f64::from(i8::from_le_bytes(first(bytes, big_endian))),
            Self::U8 => f64::from(bytes[0]),
            Self::I16 => f64::from(i16::from_le_bytes(first(bytes, big_endian))),
            Self::U16 => f64::from(u16::from_le_bytes(first(bytes, big_endian))),
            Self::I32 => f64::from(i32::from_le_bytes(first(bytes, big_endian))),
            Self::U32 => f64::from(u32::from_le_bytes(first(bytes, big_endian))),
            Self::I64 => i64::from_le_bytes(first(bytes, big_endian)) as f64,
            Self::U64 => u64::from_le_bytes(first(bytes, big_endian)) as f64,
            Self::F32 => f64::from(f32::from_le_bytes(first(bytes, big_endian))),
            Self::F64 => f64::from_le_bytes(first(bytes, big_endian)),
        }
    }
}

/// Index of the field for each role.
#[derive(Clone, Copy, Debug)]
struct Roles {
    xyz: [usize; 3],
    intensity: Option<usize>,
    ring: Option<usize>,
}

impl Roles {
    /// Finds the roles by the fields' names; a sentence when a coordinate is missing or stands twice.
    fn of_names<'a>(names: impl Iterator<Item = &'a str>) -> Result<Self, String> {
        let names: Vec<&str> = names.collect();
        Ok(Self {
            xyz: [
                coordinate(&names, "x")?,
                coordinate(&names, "y")?,
                coordinate(&names, "z")?,
            ],
            intensity: field(&names, "intensity")?,
            ring: field(&names, "ring")?,
        })
    }
}

/// Index of a field, if the file has it; a sentence when it stands twice.
fn field(names: &[&str], wanted: &str) -> Result<Option<usize>, String> {
    let first = names.iter().position(|name| *name == wanted);
    if first != names.iter().rposition(|name| *name == wanted) {
        return Err(format!("the field {wanted} stands twice"));
    }
    Ok(first)
}

fn coordinate(names: &[&str], wanted: &str) -> Result<usize, String> {
    field(names, wanted)?.ok_or_else(|| {
        format!(
            "no field {wanted} among \"{}\"; points need x, y and z",
            names.join(" ")
        )
    })
}

/// Collects the points of a file.
struct Collector {
    roles: Roles,
    cloud: Cloud,
}

impl Collector {
    fn new(roles: Roles, points: usize) -> Self {
        let rings = roles.ring.map(|_| Vec::with_capacity(points));
        Self {
            roles,
            cloud: Cloud {
                points: Vec::with_capacity(points),
                rings,
            },
        }
    }

    /// A point whose fields hold these values; a sentence when its ring is none.
    fn push(&mut self, value: impl Fn(usize) -> f64) -> Result<(), String> {
        let [x, y, z] = self.roles.xyz.map(|field| value(field) as f32);
        let intensity = self
            .roles
            .intensity
            .map_or(0.0, |field| value(field) as f32);
        if let (Some(rings), Some(field)) = (&mut self.cloud.rings, self.roles.ring) {
            rings.push(ring(value(field)).ok_or_else(|| {
                let point = self.cloud.points.len();
                let found = value(field);
                format!("point {point} (counted from 0) has ring {found}, expected a whole number from 0 on")
            })?);
        }
        self.cloud.points.push([x, y, z, intensity]);
        Ok(())
    }
}

/// The number of a ring.
fn ring(value: f64) -> Option<u32> {
    let whole = value.fract() == 0.0 && (0.0..=f64::from(u32::MAX)).contains(&value);
    whole.then_some(value as u32)
}

/// Where the values of a field lie in a binary file.
#[derive(Clone, Copy, Debug)]
struct Field {
    scalar: Scalar,
    /// Of the first point, in bytes.
    start: usize,
    /// From point to point.
    step: usize,
}

impl Field {
    /// Where its value of a point begins.
    fn at(&self, point: usize) -> usize {
        self.start + point * self.step
    }
}

/// The points of a binary file, which is long enough for them.
fn binary(
    bytes: &[u8],
    points: usize,
    fields: &[Field],
    roles: Roles,
    big_endian: bool,
) -> Result<Cloud, (usize, String)> {
    let mut collector = Collector::new(roles, points);
    for point in 0..points {
        collector
            .push(|field| {
                let field = fields[field];
                field.scalar.read(&bytes[field.at(point)..], big_endian)
            })
            .map_err(|message| {
                let byte = roles.ring.map_or(0, |ring| fields[ring].at(point));
                (byte, message)
            })?;
    }
    Ok(collector.cloud)
}

/// The points of a text, which begins at this line, and the first line behind them that is not
/// empty.
fn ascii(
    text: &[u8],
    first_line: usize,
    points: usize,
    words: usize,
    roles: Roles,
) -> Result<(Cloud, Option<usize>), ReadError> {
    // A point takes at least a character and a space for each word.
    let room = points.min(text.len() / (2 * words.max(1)) + 1);
    let mut collector = Collector::new(roles, room);
    let mut values = Vec::new();
    let mut lines = text.split(|&byte| byte == b'\n').zip(first_line..);
    while collector.cloud.points.len() < points {
        let Some((line, number)) = lines.next() else {
            let found = collector.cloud.points.len();
            let last = first_line + text.split(|&byte| byte == b'\n').count();
            let message = format!(
                "the file ends after {found} of {points} points; it was cut off, or its head is wrong"
            );
            return Err(ReadError::line(last.saturating_sub(1), message));
        };
        let line = std::str::from_utf8(line)
            .map_err(|_| ReadError::line(number, "no text; the head says that the points are"))?;
        values.clear();
        for word in line.split_ascii_whitespace() {
            values.push(word.parse::<f64>().map_err(|_| {
                ReadError::line(number, format!("\"{}\" is no number", shortened(word)))
            })?);
        }
        match values.len() {
            0 => {}
            found if found == words => collector
                .push(|field| values[field])
                .map_err(|message| ReadError::line(number, message))?,
            found => {
                let message = format!("{found} numbers, expected {words}: one for each field");
                return Err(ReadError::line(number, message));
            }
        }
    }
    let further = lines
        .find(|(line, _)| !line.trim_ascii().is_empty())
        .map(|(_, number)| number);
    Ok((collector.cloud, further))
}

/// A word as a message shows it.
fn shortened(word: &str) -> String {
    word.chars().take(30).collect()
}

/// The lines of a head, each with its number from 1 and the byte behind it.
fn head_lines(bytes: &[u8]) -> impl Iterator<Item = (usize, usize, &[u8])> {
    let head = &bytes[..bytes.len().min(MAX_HEAD_LEN)];
    let mut end = 0;
    head.split_inclusive(|&byte| byte == b'\n')
        .zip(1..)
        .map(move |(line, number)| {
            end += line.len();
            (number, end, line.trim_ascii())
        })
}

/// Where each of some stretches starts that follow one another.
fn starts(lengths: &[usize]) -> Vec<usize> {
    let mut next = 0;
    let mut starts = Vec::with_capacity(lengths.len());
    for length in lengths {
        starts.push(next);
        next += length;
    }
    starts
}

/// A count in a head.
fn count(word: &str) -> Result<usize, String> {
    word.parse()
        .map_err(|_| format!("\"{}\" is no count", shortened(word)))
}
