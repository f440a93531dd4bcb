//! Reads and writes the fields of a header.

use zerocopy::{FromBytes, FromZeros};

use super::{Column, Header, LAYOUT_VERSION, LayoutError, MAGIC, Part, Shape, TimeSource};
use crate::ReturnMode;

impl Header {
    /// A header of an empty sweep of this shape.
    pub fn new(shape: &Shape) -> Self {
        let (offsets, total_bytes) = shape.offsets();
        Self {
            magic: MAGIC,
            version: LAYOUT_VERSION,
            header_bytes: size_of::<Self>() as u32,
            total_bytes: total_bytes as u64,
            offsets,
            rows: shape.rows as u32,
            columns_capacity: shape.columns_capacity as u32,
            segments_capacity: shape.segments_capacity as u32,
            return_mode: u32::from(ReturnMode::Strongest.byte()),
            ..Self::new_zeroed()
        }
    }

    /// Returns a copy of the header of some bytes, not checked: for
    /// [`SweepRef::with_header`](crate::SweepRef::with_header).
    ///
    /// # Errors
    /// [`LayoutError::Bytes`] when they are too few.
    pub fn copied(bytes: &[u8]) -> Result<Self, LayoutError> {
        let too_short = LayoutError::Bytes { bytes: bytes.len() };
        let (header, _) = Self::read_from_prefix(bytes).map_err(|_| too_short)?;
        Ok(header)
    }

    /// The shape that the counts and offsets describe.
    pub fn shape(&self) -> Shape {
        Shape {
            rows: self.rows as usize,
            columns_capacity: self.columns_capacity as usize,
            dual: self.offsets[Part::Range2 as usize] != 0,
            segments_capacity: self.segments_capacity as usize,
        }
    }

    /// Whether a bit of [`flags`](super::flags) is set.
    pub fn has(&self, flag: u32) -> bool {
        self.flags & flag != 0
    }

    /// The clock of [`Header::time_ns`].
    pub fn time_source(&self) -> TimeSource {
        if self.time_source == TimeSource::Gps as u32 {
            TimeSource::Gps
        } else {
            TimeSource::Host
        }
    }

    /// The sensor's return mode.
    pub fn return_mode(&self) -> ReturnMode {
        u8::try_from(self.return_mode)
            .ok()
            .and_then(ReturnMode::from_byte)
            .unwrap_or(ReturnMode::Strongest)
    }

    /// Source of the sensor's packets; empty if the field is not text.
    pub fn sensor(&self) -> &str {
        text(&self.sensor)
    }

    /// Sets the source, cut to 64 bytes.
    pub fn set_sensor(&mut self, source: &str) {
        self.sensor = padded(source);
    }

    /// Name of the sensor and of its service; empty if the field is not text.
    pub fn name(&self) -> &str {
        text(&self.name)
    }

    /// What output calls the sensor: its name; where it has none, as in a capture, the source of its
    /// packets.
    pub fn sensor_name(&self) -> &str {
        match self.name() {
            "" => self.sensor(),
            name => name,
        }
    }

    /// Sets the name of the sensor, cut to 64 bytes.
    pub fn set_name(&mut self, name: &str) {
        self.name = padded(name);
    }
}

/// The properties of a sweep that are known only when it is shared: name and times.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Completion<'a> {
    /// Name of the sensor and of its service.
    pub name: &'a str,
    /// See [`Header::run_ns`].
    pub run_ns: i64,
    /// See [`Header::completed_ns`].
    pub completed_ns: i64,
    /// See [`Header::completed_monotonic_ns`].
    pub completed_monotonic_ns: i64,
    /// See [`Header::dropped_datagrams`].
    pub dropped_datagrams: u32,
}

/// The fields that depend on the receiving host, not only on the packets: of [`Header`], and the
/// last one of [`Column`]. [`Header::time_ns`] depends on it if it is in the host's clock.
pub const HOST_FIELDS: [&str; 13] = [
    "sequence",
    "run_ns",
    "name",
    "sensor",
    "arrival_ns",
    "completed_ns",
    "completed_monotonic_ns",
    "time_ns",
    "decode_ns",
    "ground_ns",
    "label_ns",
    "dropped_datagrams",
    "packet",
];

impl Header {
    /// The same with zeros where it depends on the host: see [`HOST_FIELDS`].
    pub fn without_host(&self) -> Self {
        let mut header = *self;
        (
            header.sequence,
            header.run_ns,
            header.arrival_ns,
            header.dropped_datagrams,
        ) = (0, 0, 0, 0);
        (header.completed_ns, header.completed_monotonic_ns) = (0, 0);
        (header.decode_ns, header.ground_ns, header.label_ns) = (0, 0, 0);
        (header.name, header.sensor) = ([0; 64], [0; 64]);
        if self.time_source() == TimeSource::Host {
            header.time_ns = 0;
        }
        header
    }
}

impl Column {
    /// The same with zeros where it depends on the host: see [`HOST_FIELDS`].
    pub fn without_host(&self) -> Self {
        Self { packet: 0, ..*self }
    }
}

impl Header {
    /// Sets the fields that are known when the sweep is complete.
    pub fn complete(&mut self, completion: &Completion<'_>) {
        self.set_name(completion.name);
        self.run_ns = completion.run_ns;
        self.completed_ns = completion.completed_ns;
        self.completed_monotonic_ns = completion.completed_monotonic_ns;
        self.dropped_datagrams = completion.dropped_datagrams;
    }
}

/// A zero padded text; empty if it is none, or not one to be shown.
pub(crate) fn text(padded: &[u8; 64]) -> &str {
    let end = padded
        .iter()
        .position(|&byte| byte == 0)
        .unwrap_or(padded.len());
    let text = std::str::from_utf8(&padded[..end]).unwrap_or_default();
    // Names are shown on terminals, which execute control characters.
    if text.contains(char::is_control) {
        ""
    } else {
        text
    }
}

/// A text, cut to 64 bytes.
pub(crate) fn padded(text: &str) -> [u8; 64] {
    let mut padded = [0; 64];
    let len = text.floor_char_boundary(padded.len());
    padded[..len].copy_from_slice(&text.as_bytes()[..len]);
    padded
}
