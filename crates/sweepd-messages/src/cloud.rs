//! The returns of a sweep as `sensor_msgs/PointCloud2`.
//!
//! | field | type | |
//! |---|---|---|
//! | x, y, z | float32 | metres from the sensor's origin, in the axes of ROS |
//! | intensity | float32 | calibrated reflectivity, 0 to 255 |
//! | ring | uint16 | number of the beam, from the lowest up, as in ros-drivers/velodyne |
//! | time | float32 | when the beam fired, seconds since the stamp of the message |
//! | label | uint32 | 0 none, 1 ground, 2.. segment |
//!
//! The first six are ros-drivers' XYZIRT byte for byte, so that what reads that reads this.
//! [`Layout::Autoware`] is Autoware's PointXYZIRCAEDT.
//!
//! A cloud is a list (height 1) of all returns without holes, `is_dense` true, in the order in which
//! they were measured: times never step back, and the last point is the newest. Both returns of a
//! dual pixel are in it. An organized cloud is the image:
//! height is the rows, the top one first, width the columns from left to right as
//! [`crate::image`] has them; a pixel without a return is NaN, `is_dense` is false. There a dual
//! pixel has its segmented return only.

use sweepd_sweep::ReturnMode;
use sweepd_sweep::SweepRef;
use sweepd_sweep::layout::{LABEL_FIRST_SEGMENT, LABEL_GROUND, is_return};
use thiserror::Error;

use crate::cdr::Writer;
use crate::image::column_of;
use crate::motion::Motion;
use crate::rays::{Shot, Shots};
use crate::stamp::{MessageHeader, Stamp};

/// Which cloud is made of a sweep.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Cloud {
    /// Which returns are in it.
    pub points: Points,
    /// What each point has.
    pub layout: Layout,
    /// Whether it is the image, with holes, and not a list.
    pub organized: bool,
}

/// Returns by their label.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Points {
    /// All.
    #[default]
    All,
    /// Those of the ground.
    Ground,
    /// All others: those of segments, and those without a label.
    Nonground,
    /// Those of segments.
    Objects,
}

/// What each point has.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Layout {
    /// x, y and z, and these fields behind them, packed.
    Fields(Fields),
    /// Autoware's PointXYZIRCAEDT, 32 bytes: x y z f32, intensity u8, return_type u8 as nebula
    /// numbers them, channel u16 (the ring), azimuth (0..2 pi, clockwise from straight ahead) and
    /// elevation in radians and distance in metres f32, time_stamp u32 in nanoseconds since the
    /// stamp. As that cannot be negative, the stamp is that of the first shot, whatever
    /// [`MessageHeader::stamp`] says.
    Autoware,
}

/// The fields behind x, y and z, in this order.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Fields {
    /// Reflectivity, float32.
    pub intensity: bool,
    /// Beam, uint16.
    pub ring: bool,
    /// Seconds since the stamp, float32.
    pub time: bool,
    /// Label, uint32.
    pub label: bool,
}

/// A list of fields that cannot be.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
#[non_exhaustive]
pub enum FieldsError {
    /// Not a field.
    #[error("a point has no field {0:?}: fields are x, y, z, intensity, ring, time and label")]
    Unknown(String),
    /// Named again.
    #[error("the field {0:?} is there twice")]
    Twice(String),
}

impl Default for Layout {
    fn default() -> Self {
        Self::Fields(Fields::ALL)
    }
}

impl Fields {
    /// All.
    pub const ALL: Self = Self {
        intensity: true,
        ring: true,
        time: true,
        label: true,
    };
    /// None: x, y and z alone.
    pub const NONE: Self = Self {
        intensity: false,
        ring: false,
        time: false,
        label: false,
    };

    /// The fields of these names, in any order; x, y and z may be among them and are always there.
    ///
    /// # Errors
    /// [`FieldsError`].
    pub fn of_names<'a>(names: impl IntoIterator<Item = &'a str>) -> Result<Self, FieldsError> {
        let mut fields = Self::NONE;
        let mut axes = [false; 3];
        for name in names {
            let field = match name {
                "x" => &mut axes[0],
                "y" => &mut axes[1],
                "z" => &mut axes[2],
                "intensity" => &mut fields.intensity,
                "ring" => &mut fields.ring,
                "time" => &mut fields.time,
                "label" => &mut fields.label,
                _ => return Err(FieldsError::Unknown(name.to_owned())),
            };
            if std::mem::replace(field, true) {
                return Err(FieldsError::Twice(name.to_owned()));
            }
        }
        Ok(fields)
    }
}

impl Points {
    #[inline]
    fn has(self, label: u32) -> bool {
        match self {
            Self::All => true,
            Self::Ground => label == LABEL_GROUND,
            Self::Nonground => label != LABEL_GROUND,
            Self::Objects => label >= LABEL_FIRST_SEGMENT,
        }
    }
}

/// Datatypes of `sensor_msgs/PointField`.
#[derive(Clone, Copy)]
enum Datatype {
    Uint8 = 2,
    Uint16 = 4,
    Uint32 = 6,
    Float32 = 7,
}

impl Datatype {
    fn bytes(self) -> usize {
        match self {
            Self::Uint8 => 1,
            Self::Uint16 => 2,
            Self::Uint32 | Self::Float32 => 4,
        }
    }
}

/// Autoware's layout. It has no gaps either.
const AUTOWARE: [(&str, Datatype); 10] = [
    ("x", Datatype::Float32),
    ("y", Datatype::Float32),
    ("z", Datatype::Float32),
    ("intensity", Datatype::Uint8),
    ("return_type", Datatype::Uint8),
    ("channel", Datatype::Uint16),
    ("azimuth", Datatype::Float32),
    ("elevation", Datatype::Float32),
    ("distance", Datatype::Float32),
    ("time_stamp", Datatype::Uint32),
];

/// Bytes of the largest point.
const MOST_BYTES: usize = 32;

/// Where a point is written.
type Place = [u8; MOST_BYTES];

impl Layout {
    fn fields(self) -> Vec<(&'static str, Datatype)> {
        let Self::Fields(fields) = self else {
            return AUTOWARE.to_vec();
        };
        let mut all = AUTOWARE[..3].to_vec();
        let others = [
            (fields.intensity, ("intensity", Datatype::Float32)),
            (fields.ring, ("ring", Datatype::Uint16)),
            (fields.time, ("time", Datatype::Float32)),
            (fields.label, ("label", Datatype::Uint32)),
        ];
        all.extend(
            others
                .iter()
                .filter(|(is_in, _)| *is_in)
                .map(|(_, field)| field),
        );
        all
    }

    fn write_fields(self, writer: &mut Writer<'_>) {
        let fields = self.fields();
        writer.count(fields.len());
        let mut offset = 0;
        for (name, datatype) in fields {
            writer.text(name);
            writer.count(offset);
            writer.u8(datatype as u8);
            writer.count(1);
            offset += datatype.bytes();
        }
    }

    /// Bytes of a point.
    pub fn point_step(self) -> usize {
        self.fields()
            .iter()
            .map(|(_, datatype)| datatype.bytes())
            .sum()
    }
}

/// A return as the planes have it.
#[derive(Clone, Copy)]
struct Stored {
    range_m: f32,
    reflectivity: u8,
    label: u32,
}

impl Cloud {
    /// Appends the message to the vector, whose memory may be that of a message before.
    ///
    /// The time of the message is that of the header's stamp. [`Fields::time`] counts from there;
    /// from the last shot it is 0 or less.
    pub fn encode(&self, sweep: &SweepRef<'_>, header: &MessageHeader<'_>, message: &mut Vec<u8>) {
        self.encode_deskewed(sweep, header, None, message);
    }

    /// The same of a sensor that moved: x, y and z are where it would have seen the points at the time
    /// of the message. Azimuth, elevation and distance of [`Layout::Autoware`] stay those of the
    /// shot, and times when the beams fired.
    pub fn encode_deskewed(
        &self,
        sweep: &SweepRef<'_>,
        header: &MessageHeader<'_>,
        motion: Option<&Motion>,
        message: &mut Vec<u8>,
    ) {
        let stamp = match self.layout {
            Layout::Fields(_) => header.stamp,
            Layout::Autoware => Stamp::First,
        };
        let stamp_ns = stamp.time_ns(sweep);
        let (rows, columns) = (sweep.rows(), sweep.columns.len());
        let step = self.layout.point_step();
        let mut writer = Writer::new(message);
        writer.header(stamp_ns, header.frame_id);
        writer.count(if self.organized { rows } else { 1 });
        let width = writer.later();
        self.layout.write_fields(&mut writer);
        writer.bool(false);
        writer.count(step);
        let row_step = writer.later();
        let len = writer.later();
        let points = PointWriter {
            cloud: self,
            step,
            sweep,
            shots: Shots::at_moment(sweep, motion, stamp),
            stamp_after_first_ns: stamp_ns.saturating_sub(sweep.header.time_ns),
        };
        // A point is written as if it were of the largest layout; the next one is written over its
        // end.
        let room = rows
            * columns
            * step
            * if self.organized {
                1
            } else {
                points.returns_a_pixel()
            };
        let items = writer.items(room + MOST_BYTES);
        let used = if self.organized {
            points.image(items);
            room
        } else {
            points.list(items)
        };
        writer.drop_last(room + MOST_BYTES - used);
        let in_row = if self.organized { columns } else { used / step };
        writer.fill(width, in_row);
        writer.fill(row_step, in_row * step);
        writer.fill(len, used);
        writer.bool(!self.organized);
    }
}

struct PointWriter<'a> {
    cloud: &'a Cloud,
    step: usize,
    sweep: &'a SweepRef<'a>,
    shots: Shots<'a>,
    stamp_after_first_ns: i64,
}

impl PointWriter<'_> {
    fn returns_a_pixel(&self) -> usize {
        1 + usize::from(!self.sweep.range2.is_empty())
    }

    /// The returns of a pixel: the segmented one and the other.
    #[inline]
    fn returns(&self, index: usize) -> [Option<Stored>; 2] {
        let sweep = self.sweep;
        let first = is_return(sweep.range[index]).then(|| Stored {
            range_m: sweep.range[index],
            reflectivity: sweep.reflectivity[index],
            label: sweep.label[index],
        });
        let second = sweep
            .range2
            .get(index)
            .filter(|&&range_m| is_return(range_m));
        let second = second.map(|&range_m| Stored {
            range_m,
            reflectivity: sweep.reflectivity2[index],
            label: sweep.label2[index],
        });
        [first, second]
    }

    /// Writes the list and gives its bytes.
    fn list(&self, items: &mut [u8]) -> usize {
        let mut at = 0;
        for pixel in self.sweep.pixels_by_time() {
            let both = self.returns(pixel.column * self.sweep.rows() + pixel.row);
            let [first, second] =
                both.map(|stored| stored.filter(|stored| self.cloud.points.has(stored.label)));
            if first.is_none() && second.is_none() {
                continue;
            }
            let shot = self.shots.of_firing(pixel.row, pixel.firing);
            if let Some(first) = first {
                self.point(&shot, first, both[1], point_at(items, at));
                at += self.step;
            }
            if let Some(second) = second {
                self.point(&shot, second, both[0], point_at(items, at));
                at += self.step;
            }
        }
        at
    }

    /// Writes the image.
    fn image(&self, items: &mut [u8]) {
        let columns = self.sweep.columns.len();
        for row in 0..self.sweep.rows() {
            for left in 0..columns {
                let column = column_of(self.sweep, left);
                let [first, second] = self.returns(column * self.sweep.rows() + row);
                let place = point_at(items, (row * columns + left) * self.step);
                match first.filter(|first| self.cloud.points.has(first.label)) {
                    Some(first) => {
                        let firing = self.sweep.fired_in(row, column);
                        let shot = self.shots.of_firing(row, firing);
                        self.point(&shot, first, second, place);
                    }
                    None => {
                        *place = [0; MOST_BYTES];
                        for axis in 0..3 {
                            write(place, axis * 4, f32::NAN.to_le_bytes());
                        }
                    }
                }
            }
        }
    }

    /// Writes a return whose pixel has another one or not.
    #[inline]
    fn point(&self, shot: &Shot<'_>, stored: Stored, other: Option<Stored>, place: &mut Place) {
        let [x, y, z] = shot.point_m(stored.range_m);
        write(place, 0, x.to_le_bytes());
        write(place, 4, y.to_le_bytes());
        write(place, 8, z.to_le_bytes());
        let mut at = 12;
        let Layout::Fields(fields) = self.cloud.layout else {
            return self.autoware(shot, stored, other, place);
        };
        if fields.intensity {
            write(place, at, f32::from(stored.reflectivity).to_le_bytes());
            at += 4;
        }
        if fields.ring {
            write(place, at, shot.ring().to_le_bytes());
            at += 2;
        }
        if fields.time {
            let time_s = (shot.time_ns - self.stamp_after_first_ns) as f64 * 1e-9;
            write(place, at, (time_s as f32).to_le_bytes());
            at += 4;
        }
        if fields.label {
            write(place, at, stored.label.to_le_bytes());
        }
    }

    fn autoware(&self, shot: &Shot<'_>, stored: Stored, other: Option<Stored>, place: &mut Place) {
        let [azimuth_rad, elevation_rad] = shot.direction_rad(stored.range_m);
        let time_ns = u32::try_from(shot.time_ns).unwrap_or(u32::MAX);
        place[12] = stored.reflectivity;
        place[13] = return_type(self.sweep.header.return_mode(), stored, other);
        write(place, 14, shot.ring().to_le_bytes());
        write(place, 16, azimuth_rad.to_le_bytes());
        write(place, 20, elevation_rad.to_le_bytes());
        write(place, 24, stored.range_m.to_le_bytes());
        write(place, 28, time_ns.to_le_bytes());
    }
}

/// The place of a point; there is one behind each point that there is room for.
#[inline]
fn point_at(items: &mut [u8], at: usize) -> &mut Place {
    let (place, _) = items[at..]
        .split_first_chunk_mut()
        .expect("there is room for the largest point behind the last");
    place
}

#[inline]
fn write<const BYTES: usize>(place: &mut Place, at: usize, bytes: [u8; BYTES]) {
    place[at..at + BYTES].copy_from_slice(&bytes);
}

/// nebula's number of a kind of return: 1 last, 3 strongest, 4 first and weaker, 5 last and weaker,
/// 6 the only one of a dual pixel, 9 first and stronger, 10 last and stronger. First is the nearer;
/// of two that are as strong the nearer counts as stronger.
fn return_type(mode: ReturnMode, this: Stored, other: Option<Stored>) -> u8 {
    match (mode, other) {
        (ReturnMode::Strongest, _) => 3,
        (ReturnMode::Last, _) => 1,
        (ReturnMode::Dual, None) => 6,
        (ReturnMode::Dual, Some(other)) => {
            let is_first = this.range_m < other.range_m;
            let is_stronger = match is_first {
                true => this.reflectivity >= other.reflectivity,
                false => this.reflectivity > other.reflectivity,
            };
            match (is_first, is_stronger) {
                (true, false) => 4,
                (false, false) => 5,
                (true, true) => 9,
                (false, true) => 10,
            }
        }
    }
}
