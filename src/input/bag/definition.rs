//! Scans by the definition of their type, whatever its name: a bag may have the definition.
//!
//! ```text
//! FIELDS | ==== | MSG: package/Type | FIELDS | ==== | ...
//! FIELD  | type name # comment |
//! ```
//!
//! A scan has one list, of packets: each a time and `uint8[1206]`. Other fields may stand before
//! and behind it. Layout: the text form of ros1msg and ros2msg in the registry of mcap.dev.

use sweepd_core::wire::data::DATA_PACKET_LEN;

/// Most numbers and texts before the packets: a definition may ask for any number.
const MAX_PARTS: usize = 64;
/// Deepest type within a type.
const MAX_DEPTH: usize = 8;

/// What stands before the packets of a scan, and whether something may follow them.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct ScanLayout {
    pub(super) before: Vec<Part>,
    pub(super) has_more: bool,
}

/// A part of a message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Part {
    /// Of this length, bytes.
    Number(usize),
    /// A length u32, and so many bytes.
    Text,
}

impl ScanLayout {
    /// The layout by the definition of a type; `None` if that is no scan.
    pub(super) fn of(definition: &str) -> Option<Self> {
        let blocks = Blocks::of(definition);
        let mut before = Vec::new();
        let mut fields = fields(blocks.first);
        while let Some(kind) = fields.next() {
            if let Some(element) = kind.strip_suffix("[]") {
                return blocks.is_packet(element).then(|| Self {
                    before,
                    has_more: fields.next().is_some(),
                });
            }
            blocks.add(kind, &mut before, 0)?;
        }
        None
    }
}

/// A definition, and those of the types in it, by their names.
struct Blocks<'a> {
    first: &'a str,
    others: Vec<(&'a str, &'a str)>,
}

impl<'a> Blocks<'a> {
    fn of(definition: &'a str) -> Self {
        let mut blocks = definition.split("\n====");
        let first = blocks.next().unwrap_or_default();
        let mut others = Vec::new();
        for block in blocks {
            let named = block.split_once("MSG:");
            if let Some((name, fields)) = named.and_then(|(_, text)| text.split_once('\n')) {
                others.push((last_name(name.trim()), fields));
            }
        }
        Self { first, others }
    }

    /// The fields of a type.
    fn find(&self, kind: &str) -> Option<&'a str> {
        let name = last_name(kind);
        let mut others = self.others.iter();
        others
            .find(|(other, _)| *other == name)
            .map(|found| found.1)
    }

    /// Whether a type is a time and the bytes of a packet.
    fn is_packet(&self, kind: &str) -> bool {
        let Some(block) = self.find(kind) else {
            return false;
        };
        let mut fields = fields(block);
        let (Some(time), Some(bytes), None) = (fields.next(), fields.next(), fields.next()) else {
            return false;
        };
        let mut stamp = Vec::new();
        let is_time = self.add(time, &mut stamp, 0).is_some() && stamp == [Part::Number(4); 2];
        let len = bytes
            .strip_prefix("uint8[")
            .and_then(|rest| rest.strip_suffix(']'));
        is_time && len.and_then(|len| len.parse().ok()) == Some(DATA_PACKET_LEN)
    }

    /// Adds the parts of a type; `None` where its length is not known.
    fn add(&self, kind: &str, parts: &mut Vec<Part>, depth: usize) -> Option<()> {
        if parts.len() >= MAX_PARTS || depth > MAX_DEPTH {
            return None;
        }
        let part = match kind {
            "bool" | "byte" | "char" | "int8" | "uint8" => Part::Number(1),
            "int16" | "uint16" => Part::Number(2),
            "int32" | "uint32" | "float32" => Part::Number(4),
            "int64" | "uint64" | "float64" => Part::Number(8),
            "string" => Part::Text,
            "time" | "duration" | "builtin_interfaces/Time" | "builtin_interfaces/msg/Time" => {
                parts.push(Part::Number(4));
                Part::Number(4)
            }
            _ => {
                let len = parts.len();
                for field in fields(self.find(kind)?) {
                    self.add(field, parts, depth + 1)?;
                }
                // A type without fields adds nothing: any number of them would cost only time.
                return (parts.len() > len).then_some(());
            }
        };
        parts.push(part);
        Some(())
    }
}

/// The types of the fields, without constants.
fn fields(block: &str) -> impl Iterator<Item = &str> {
    block.lines().filter_map(|line| {
        let line = line.split('#').next().unwrap_or_default();
        let mut words = line.split_whitespace();
        let (kind, name) = (words.next()?, words.next()?);
        let is_constant =
            name.contains('=') || words.next().is_some_and(|word| word.starts_with('='));
        (!is_constant).then_some(kind)
    })
}

/// The name of a type without its package, also as DDS writes it.
pub(super) fn last_name(kind: &str) -> &str {
    let name = kind.rsplit(['/', ':']).next().unwrap_or(kind);
    name.trim_end_matches('_')
}
