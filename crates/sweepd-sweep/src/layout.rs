//! A sweep as bytes: header, planes and tables in one aligned slice. Files, tests and shared memory
//! hold the same bytes.
//!
//! ```text
//! | Header | range | reflectivity | label | (dual: range 2 | reflectivity 2 | label 2 | kind) | columns | beams | segments |
//! ```
//!
//! Every part starts at a multiple of 64 bytes; the header gives the offsets. Planes are stored
//! column after column: `index = (margin_columns + column) * rows + row`, row 0 being the highest
//! beam; so are the columns themselves. In a sweep of a dual-return sensor, the planes without a
//! number hold the return that is segmented, the planes "2" the other one, and `kind` tells which
//! is which.
//!
//! The beams of an HDL-64E point up to ten degrees to the side, those of a VLS-128 up to six, those
//! of a VLP-32C up to four. Their rows are shifted by whole
//! columns, so that neighbours in the image are neighbours in space: the return in a row of column
//! `c` was fired in column `c + shift`, whose azimuth and time are its own ([`BeamRow::shift`]). In
//! a circular sweep columns are counted around the turn (what is beyond the last is at the first
//! again); another one is wider by the shifts, with columns that hold no firing at its ends and
//! where a sector was left out ([`ColumnStatus::Unfired`]).
//!
//! The builder of a sweep writes every pixel of every column that the header counts, so that
//! nothing valid is left over from an earlier sweep in the same buffer. All numbers are
//! little-endian, as the host's must be.

mod header;
mod shape;

use zerocopy::{FromBytes, FromZeros, Immutable, IntoBytes, KnownLayout};

pub use self::header::{Completion, HOST_FIELDS};
pub(crate) use self::header::{padded, text};
pub(crate) use self::shape::checked_shape;
pub use self::shape::{LayoutError, Shape};

#[cfg(not(target_endian = "little"))]
compile_error!("the layout of a sweep is little-endian, and so must be the host");

/// First bytes of a sweep.
pub const MAGIC: [u8; 8] = *b"sweepd\r\n";
/// Version of this layout.
pub const LAYOUT_VERSION: u32 = 3;
/// Alignment of a sweep and of its parts, bytes.
pub const ALIGN: usize = 64;
/// Columns that a sweep has room for: an HDL-32E at 240 rpm has 5425, an HDL-64E 5209 and up to 145
/// on each side.
pub const COLUMNS_CAPACITY: usize = 5632;

/// Whether a range in a plane is a return. Only this function defines how "no return" is stored.
#[inline(always)]
pub fn is_return(range_m: f32) -> bool {
    range_m > 0.0
}

/// Label of a pixel without segment: no return, masked, or part of a speck.
pub const LABEL_NONE: u32 = 0;
/// Label of a ground pixel.
pub const LABEL_GROUND: u32 = 1;
/// Label of the first segment; entry `label - 2` of the table of segments is the pixel's.
pub const LABEL_FIRST_SEGMENT: u32 = 2;

/// Properties of a sweep, as bits of [`Header::flags`].
pub mod flags {
    /// Not from cut to cut: the first or last sweep of a run, or interrupted.
    pub const PARTIAL: u32 = 1 << 0;
    /// A whole turn without a blanked sector: the last column and the first are neighbours.
    pub const CIRCULAR: u32 = 1 << 1;
    /// The head turns counter-clockwise seen from above.
    pub const REVERSED: u32 = 1 << 2;
    /// The sensor is set to leave out a sector.
    pub const BLANKED: u32 = 1 << 3;
    /// Turning slower than 240 rpm, faster than 1320, or more than a tenth off the sweep before.
    pub const RATE_UNSTABLE: u32 = 1 << 4;
    /// The head stands still.
    pub const STOPPED: u32 = 1 << 5;
    /// The mounting height was estimated from the sweeps and not configured.
    pub const HEIGHT_ESTIMATED: u32 = 1 << 6;
    /// [`Header::lost_packets`](super::Header::lost_packets) is an estimate: the packets of a
    /// VLS-128 have no steady period, and too many are missing to count them by their stamps.
    pub const LOSS_ESTIMATED: u32 = 1 << 7;
    /// Hardly a shot has returned for `eye_turns` turns.
    pub const BLIND: u32 = 1 << 8;
    /// Nearly all returns are within `eye_near_m`, all around.
    pub const COVERED: u32 = 1 << 9;
    /// Ranges or reflectivities are the same, turn after turn.
    pub const FROZEN: u32 = 1 << 10;
    /// Less than `eye_least_percent` of the returns of before are left, also of those from near ground.
    pub const FADED: u32 = 1 << 11;
    /// Beams or a sector that look down to near ground do not return.
    pub const DARK_BELOW: u32 = 1 << 12;
    /// The mounting height was to be estimated, and is in doubt or unknown:
    /// [`Header::height_doubt`](super::Header::height_doubt) says why.
    pub const HEIGHT_IN_DOUBT: u32 = 1 << 13;
    /// All bits that say that the sensor does not see what it should.
    pub const NOT_SEEING: u32 = 0x1F00;
}

/// Properties of a segment, as bits of [`Segment::flags`].
pub mod segment_flags {
    /// Wider than `max_object_deg` (60 degrees by default), or with the sensor inside its box: the
    /// box says nothing of what is inside it.
    pub const WIDE: u16 = 1 << 0;
}

/// Which clock [`Header::time_ns`] is in.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u32)]
pub enum TimeSource {
    /// The clock of the host or the capture: sensor time plus the least delay seen.
    Host = 0,
    /// UTC from GPS: the pulse per second was locked and the sentence valid, or the sentence alone
    /// with `gps_without_pps`.
    Gps = 1,
}

/// Which of two returns is segmented.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u32)]
pub enum ReturnChoice {
    /// The nearer: what the beam meets first, be it a drop, a flake or dust.
    Nearest = 0,
    /// The strongest.
    Strongest = 1,
    /// The last: best in rain, snow and dust.
    Last = 2,
}

/// The parts of a sweep behind its header.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(usize)]
pub enum Part {
    /// f32 a pixel, metres; greater than 0 is a return, all else is none.
    ///
    /// See [`is_return`], and [`crate::corrected`] for the last bit on an HDL-64E.
    Range = 0,
    /// u8 a pixel, calibrated.
    Reflectivity = 1,
    /// u32 a pixel: 0 none, 1 ground, 2.. segment.
    Label = 2,
    /// f32 a pixel, dual only: range of the other return.
    Range2 = 3,
    /// u8 a pixel, dual only: reflectivity of the other return.
    Reflectivity2 = 4,
    /// u32 a pixel, dual only: label of the other return.
    Label2 = 5,
    /// u8 a pixel, dual only: [`ReturnKind`] of the segmented return, and [`SECOND_BLOCKS`].
    Kind = 6,
    /// [`Column`] a column.
    Columns = 7,
    /// [`BeamRow`] a row.
    Beams = 8,
    /// [`Segment`] a segment.
    Segments = 9,
}

/// Number of parts.
pub const PARTS: usize = 10;

/// Which of a pair of dual returns a plane holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum ReturnKind {
    /// The strongest, or the second strongest where the last is the strongest; the other is the
    /// last.
    Strongest = 1,
    /// The last; the other is the strongest. An HDL-64E does not say which is which: the farther is
    /// the last.
    Last = 2,
}

/// Bit of [`Part::Kind`]: the segmented return is in the second blocks of its firing, the other in
/// the first.
pub const SECOND_BLOCKS: u8 = 4;

impl ReturnKind {
    /// The kind in a byte of [`Part::Kind`].
    pub fn of_byte(byte: u8) -> Self {
        if byte & !SECOND_BLOCKS == Self::Last as u8 {
            Self::Last
        } else {
            Self::Strongest
        }
    }

    /// The other of a pair.
    pub fn other(self) -> Self {
        match self {
            Self::Strongest => Self::Last,
            Self::Last => Self::Strongest,
        }
    }

    /// The word for it in output.
    pub fn name(self) -> &'static str {
        match self {
            Self::Strongest => "strongest",
            Self::Last => "last",
        }
    }
}

/// The header of a sweep. Counts and offsets first, then what was measured.
///
/// The same packets give the same sweep, byte for byte, except for [`HOST_FIELDS`], which depend on
/// the receiving host.
#[derive(Clone, Copy, Debug, FromBytes, IntoBytes, KnownLayout, Immutable)]
#[repr(C)]
pub struct Header {
    /// [`MAGIC`].
    pub magic: [u8; 8],
    /// [`LAYOUT_VERSION`].
    pub version: u32,
    /// Bytes of this header.
    pub header_bytes: u32,
    /// Bytes of the whole sweep, capacity included.
    pub total_bytes: u64,
    /// Where each part begins, bytes from the start, 0 = absent; indexed by [`Part`].
    pub offsets: [u64; PARTS],
    /// Rows of the image.
    pub rows: u32,
    /// Columns of the image.
    pub columns: u32,
    /// Columns that the planes have room for.
    pub columns_capacity: u32,
    /// Segments in the table.
    pub segments: u32,
    /// Segments that the table has room for.
    pub segments_capacity: u32,
    /// Code of the [`Model`](crate::Model).
    pub model: u32,
    /// Byte of the [`ReturnMode`](crate::ReturnMode).
    pub return_mode: u32,
    /// Which of two returns is segmented: a [`ReturnChoice`].
    pub return_choice: u32,
    /// Bits of [`flags`].
    pub flags: u32,
    /// Which clock `time_ns` is in: a [`TimeSource`].
    pub time_source: u32,
    /// Sweeps of this pipeline before this one, partial ones included.
    pub sequence: u64,
    /// Time of the first column's first shot, nanoseconds since 1970 in the clock of `time_source`.
    pub time_ns: i64,
    /// From the first column's first shot to the last column's, nanoseconds.
    pub duration_ns: u64,
    /// Sensor clock at the first column's first shot, nanoseconds since the top of the hour at
    /// which this run began.
    pub sensor_time_ns: i64,
    /// Arrival of the newest packet up to the one that completed the sweep, with the first firing
    /// past the cut; nanoseconds since 1970.
    pub arrival_ns: i64,
    /// Speed over this sweep, turns a minute; not negative.
    pub rpm: f32,
    /// Azimuth at which sweeps are cut, radians: the configured one, or one ahead of it if a
    /// limited field of view would make the packets at the configured cut late.
    pub cut_azimuth_rad: f32,
    /// Height of the sensor above the ground used for the ground labels, metres; 0 = unknown.
    pub height_m: f32,
    /// Rotation of the sensor about its x axis (nose up), radians.
    pub pitch_rad: f32,
    /// Rotation of the sensor about its y axis (right side down), radians.
    pub roll_rad: f32,
    /// Columns marked missing.
    pub missing_columns: u32,
    /// Packets missing by the sensor clock.
    pub lost_packets: u32,
    /// Packets decoded into this sweep, in whole or in part.
    pub packets: u32,
    /// Non-zero returns, of both planes.
    pub returns: u32,
    /// Pixels labelled ground.
    pub ground: u32,
    /// Time spent on decoding, nanoseconds; 0 where no clock was given.
    pub decode_ns: u32,
    /// Time spent on ground removal, nanoseconds.
    pub ground_ns: u32,
    /// Time spent on labelling and the segments table, nanoseconds.
    pub label_ns: u32,
    /// Columns before the image's first in every plane and in the table of columns.
    pub margin_columns: u32,
    /// Columns of the image that hold no firing, because the rows are shifted.
    pub unfired_columns: u32,
    /// Datagrams that the kernel dropped on the sensor's port since the sweep before, because they
    /// were not fetched in time.
    pub dropped_datagrams: u32,
    /// Rotation of the sensor about the vertical in the frame of the robot, counter-clockwise from
    /// above, radians. Its position is [`Header::position_m`], the other two angles are
    /// [`Header::pitch_rad`] and [`Header::roll_rad`].
    pub yaw_rad: f32,
    /// Doubt about the estimated height: a [`HeightDoubt`](crate::height::HeightDoubt) as a word;
    /// 0 where it is not, or was configured.
    pub height_doubt: u32,
    /// Position of the sensor in the frame of the robot as configured, metres: x right, y forward,
    /// z up.
    pub position_m: [f32; 3],
    _reserved_too: u32,
    /// CLOCK_REALTIME when labels and segments were complete, nanoseconds since 1970; 0 where no
    /// clock was given.
    pub completed_ns: i64,
    /// CLOCK_MONOTONIC at the same moment, nanoseconds.
    pub completed_monotonic_ns: i64,
    /// CLOCK_REALTIME when this run of the sensor's pipeline began, nanoseconds since 1970: with
    /// [`Header::sequence`] it identifies the sweep permanently. A reload that changes the sensor
    /// begins another run, in which `sequence` counts from 0 again. 0 where nothing is published.
    pub run_ns: i64,
    /// Source of the sensor's packets, UTF-8, zero padded.
    pub sensor: [u8; 64],
    /// Configured name of the sensor, which is also that of its service; UTF-8, zero padded, empty
    /// if there is none.
    pub name: [u8; 64],
    _reserved_bytes: [u8; 24],
}

/// One column: a firing.
#[derive(Clone, Copy, Debug, PartialEq, FromBytes, IntoBytes, KnownLayout, Immutable)]
#[repr(C)]
pub struct Column {
    /// Ordinal of the data packet among this sensor's, from 0; 2^64 - 1 where it is missing.
    pub packet: u64,
    /// Azimuth at the firing's first shot, radians, 0 to 2 pi.
    pub azimuth_rad: f32,
    /// Turning rate during the firing, radians a second; negative when reversed.
    pub azimuth_rate_rad_s: f32,
    /// Its first shot, nanoseconds after the sweep's first shot.
    pub time_ns: u32,
    /// First block of the firing in its packet.
    pub block: u8,
    /// A [`ColumnStatus`].
    pub status: u8,
    _reserved: [u8; 2],
}

/// The [`Column::status`]: what a column holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum ColumnStatus {
    /// A firing that arrived.
    Measured = 1,
    /// A firing whose packet was lost; azimuth and time are interpolated, all its pixels are "no
    /// return".
    Missing = 2,
    /// No firing: only beams to the side of firings in other columns. The azimuth continues that of
    /// these.
    Unfired = 3,
}

impl Column {
    /// The column of a firing that arrived.
    pub fn measured(
        packet: u64,
        block: u8,
        azimuth_rad: f32,
        azimuth_rate_rad_s: f32,
        time_ns: u32,
    ) -> Self {
        Self {
            packet,
            block,
            status: ColumnStatus::Measured as u8,
            ..Self::missing(azimuth_rad, azimuth_rate_rad_s, time_ns)
        }
    }

    /// The column of a firing whose packet was lost.
    pub fn missing(azimuth_rad: f32, azimuth_rate_rad_s: f32, time_ns: u32) -> Self {
        Self {
            packet: u64::MAX,
            azimuth_rad,
            azimuth_rate_rad_s,
            time_ns,
            block: 0,
            status: ColumnStatus::Missing as u8,
            _reserved: [0; 2],
        }
    }

    /// A column without a firing.
    pub fn unfired(azimuth_rad: f32, azimuth_rate_rad_s: f32, time_ns: u32) -> Self {
        Self {
            status: ColumnStatus::Unfired as u8,
            ..Self::missing(azimuth_rad, azimuth_rate_rad_s, time_ns)
        }
    }

    /// Whether there is a firing, that arrived or was lost.
    pub fn is_fired(&self) -> bool {
        self.status != ColumnStatus::Unfired as u8
    }

    /// Whether it is a firing that arrived.
    pub fn is_measured(&self) -> bool {
        self.status == ColumnStatus::Measured as u8
    }

    /// Whether the packet of this firing was lost.
    pub fn is_missing(&self) -> bool {
        self.status == ColumnStatus::Missing as u8
    }
}

/// One row: the properties of a beam that a consumer needs for x, y, z and time.
#[derive(Clone, Copy, Debug, PartialEq, FromBytes, IntoBytes, KnownLayout, Immutable)]
#[repr(C)]
pub struct BeamRow {
    /// Index of the beam's record within a firing.
    pub channel: u32,
    /// Angle above the horizon, radians.
    pub elevation_rad: f32,
    /// Subtracted from the azimuth, radians.
    pub rotation_rad: f32,
    /// Its shot, nanoseconds after the firing's first shot.
    pub time_offset_ns: u32,
    /// Height of the beam's origin, metres.
    pub vertical_offset_m: f32,
    /// Sideways shift of the beam's origin, metres.
    pub horizontal_offset_m: f32,
    /// Columns from a pixel of this row to the firing that it belongs to.
    pub shift: i32,
    /// Added to the measured distance (it is already part of the range), metres.
    pub distance_offset_m: f32,
    /// The same for x at the near end of the two-point correction; equal where there is none.
    pub distance_offset_x_m: f32,
    /// The same for y.
    pub distance_offset_y_m: f32,
    _reserved: [u32; 2],
}

impl BeamRow {
    /// The row of an ideal beam: all offsets are 0.
    pub fn ideal(channel: u32, elevation_rad: f32, time_offset_ns: u32) -> Self {
        Self {
            channel,
            elevation_rad,
            time_offset_ns,
            ..Self::new_zeroed()
        }
    }
}

/// One segment: a connected set of non-ground pixels. Lengths in metres, axes of the sensor (x
/// right, y forward, z up).
#[derive(Clone, Copy, Debug, PartialEq, FromBytes, IntoBytes, KnownLayout, Immutable)]
#[repr(C)]
pub struct Segment {
    /// Label of its pixels, from [`LABEL_FIRST_SEGMENT`].
    pub label: u32,
    /// Pixels with a return in the segmented plane.
    pub points: u32,
    /// Least x, y, z.
    pub min_m: [f32; 3],
    /// Greatest x, y, z.
    pub max_m: [f32; 3],
    /// Mean x, y, z.
    pub centroid_m: [f32; 3],
    /// Range of its nearest pixel.
    pub nearest_m: f32,
    /// Highest row.
    pub row_first: u16,
    /// Lowest row.
    pub row_last: u16,
    /// First column in the sense of rotation; greater than the last where the segment lies across
    /// the seam.
    pub column_first: u32,
    /// Last column.
    pub column_last: u32,
    /// Bits of [`segment_flags`].
    pub flags: u16,
    _reserved: u16,
}

impl Segment {
    /// Whether its box says nothing of what is inside it.
    pub fn is_wide(&self) -> bool {
        self.flags & segment_flags::WIDE != 0
    }
}

const _: () = assert!(size_of::<Header>() == 448 && size_of::<Column>() == 24);
const _: () = assert!(size_of::<BeamRow>() == 48 && size_of::<Segment>() == 64);
