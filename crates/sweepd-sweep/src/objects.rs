//! Objects as bytes: segments that are published while the head still turns.
//!
//! A message is an [`ObjectsHeader`], its objects, and in the last messages of a sweep the labels of
//! its objects.

use zerocopy::{FromBytes, FromZeros, Immutable, IntoBytes, KnownLayout};

use super::layout::{LayoutError, Segment, padded, text};
use super::pose::{Frame, Pose};

/// Version of a message of objects.
pub const OBJECTS_VERSION: u32 = 1;

/// First bytes of a message of objects.
pub const OBJECTS_MAGIC: [u8; 8] = *b"objects\n";

/// Most bytes of a message: a longer one is split.
pub const MESSAGE_BYTES: usize = 8 * 1024;

/// Why an object is emitted.
pub mod why {
    /// A whole segment that no later column of this turn can join.
    pub const COMPLETE: u32 = 1;
    /// A whole segment that is published with its complete sweep.
    pub const SWEEP: u32 = 2;
    /// A part of an object wider than `max_object_deg`, published while the object grows; that is 60
    /// degrees by default.
    pub const WIDE: u32 = 3;
    /// An object across the cut or close behind it, with its returns of the previous turn; in parts
    /// if it is wider than `max_object_deg`. The table of its sweep has the segment there as it is at
    /// the end of the turn.
    pub const SEAM: u32 = 4;
}

/// Properties of a message of objects, as bits of [`ObjectsHeader::flags`].
pub mod flags {
    /// The last message of the sweep: all its objects and their labels have been sent.
    pub const LAST: u32 = 1;
    /// The height of the sensor is not known yet: this sweep has no objects.
    pub const NO_HEIGHT: u32 = 2;
    /// The sweep does not go from cut to cut.
    pub const PARTIAL: u32 = 4;
}

/// An object, or a part of one: 96 bytes.
#[derive(Clone, Copy, Debug, PartialEq, FromBytes, IntoBytes, KnownLayout, Immutable)]
#[repr(C)]
pub struct Object {
    /// Its entry of the segments table; the label is 0 unless `why` is [`why::SWEEP`]. An object
    /// that is not in the table has its own figures here; a first column greater than the last one
    /// is then one of the previous turn.
    pub segment: Segment,
    /// Its first pixel in the image of its sweep, `column * rows + row`.
    pub first_pixel: u32,
    /// Number of the object within its sweep, from 0.
    pub ordinal: u32,
    /// One of [`why`].
    pub why: u32,
    /// Azimuth of its first return, radians, 0 to 2 pi.
    pub azimuth_first_rad: f32,
    /// Azimuth of its last return.
    pub azimuth_last_rad: f32,
    /// Shot of its first return, nanoseconds after the sweep's first shot; less than 0 in the turn
    /// before.
    pub first_ns: i32,
    /// Shot of its last return.
    pub last_ns: i32,
    /// 0.
    pub reserved: u32,
}

impl Object {
    /// Whether it is a segment of the sweep's table, and whole.
    pub fn is_segment(&self) -> bool {
        matches!(self.why, why::COMPLETE | why::SWEEP)
    }
}

/// Objects of one sweep that became known together.
#[derive(Clone, Copy, Debug)]
pub struct NewObjects<'a> {
    /// Number of the sweep.
    pub sequence: u64,
    /// Time of the sweep's first shot, nanoseconds since 1970: as far as it is known by now, and
    /// with the last objects that of the sweep.
    pub time_ns: i64,
    /// Code of the [`TimeSource`](super::layout::TimeSource).
    pub time_source: u32,
    /// Bits of [`flags`].
    pub flags: u32,
    /// Height of the sensor above the ground, metres; 0 = unknown.
    pub height_m: f32,
    /// Objects of the sweep that became known before.
    pub first_ordinal: usize,
    /// What became known.
    pub objects: &'a [Object],
    /// With the last ones, the label of each object of the sweep; 0 where a late packet has
    /// changed it.
    pub labels: &'a [u32],
}

/// What stands before the objects: 192 bytes.
#[derive(Clone, Copy, Debug, PartialEq, FromBytes, IntoBytes, KnownLayout, Immutable)]
#[repr(C)]
pub struct ObjectsHeader {
    /// [`OBJECTS_MAGIC`].
    pub magic: [u8; 8],
    /// [`OBJECTS_VERSION`].
    pub version: u32,
    /// Bytes of this header.
    pub header_bytes: u32,
    /// Number of the sweep.
    pub sequence: u64,
    /// When this run of the sensor's pipeline began, as in the header of the sweep.
    pub run_ns: i64,
    /// Time of the sweep's first shot, nanoseconds since 1970: as far as it is known by now, in the
    /// last message that of the sweep.
    pub time_ns: i64,
    /// CLOCK_REALTIME when the message was sent.
    pub sent_ns: i64,
    /// CLOCK_MONOTONIC at the same moment.
    pub sent_monotonic_ns: i64,
    /// Which clock `time_ns` is in: a [`TimeSource`](super::layout::TimeSource).
    pub time_source: u32,
    /// Bits of [`flags`].
    pub flags: u32,
    /// Objects in this message.
    pub objects: u32,
    /// Objects of the sweep before these.
    pub first_ordinal: u32,
    /// Labels in this message.
    pub labels: u32,
    /// The ordinal of the object that the first label is for.
    pub first_label: u32,
    /// Position of the sensor in the frame of the robot, as configured, metres.
    pub position_m: [f32; 3],
    /// Rotation about the vertical in the frame of the robot, counter-clockwise from above, radians.
    pub yaw_rad: f32,
    /// Nose up, radians.
    pub pitch_rad: f32,
    /// Right side down, radians.
    pub roll_rad: f32,
    /// Height of the sensor above the ground, metres; 0 = unknown, or of an earlier daemon.
    pub height_m: f32,
    /// 0.
    pub reserved: [u8; 20],
    /// Name of the sensor, UTF-8, zero padded.
    pub name: [u8; 64],
}

impl ObjectsHeader {
    /// Name of the sensor; empty if the field is not text.
    pub fn name(&self) -> &str {
        text(&self.name)
    }

    /// The sensor in the frame of the robot, as configured: see [`Pose::mounted`].
    pub fn mount(&self) -> Pose {
        Pose::mounted(
            self.position_m,
            [self.yaw_rad, self.pitch_rad, self.roll_rad],
        )
    }
}

/// What was sent when, and by whom.
#[derive(Clone, Copy, Debug)]
pub struct Sending<'a> {
    /// Name of the sensor.
    pub name: &'a str,
    /// When this run of the sensor's pipeline began, nanoseconds since 1970.
    pub run_ns: i64,
    /// CLOCK_REALTIME now.
    pub sent_ns: i64,
    /// CLOCK_MONOTONIC now.
    pub sent_monotonic_ns: i64,
    /// Position of the sensor, metres.
    pub position_m: [f32; 3],
    /// Yaw, pitch and roll of the sensor, radians.
    pub angles_rad: [f32; 3],
}

/// Calls with the bytes of each message that says this, one after another.
pub fn write(new: &NewObjects<'_>, sending: &Sending<'_>, mut send: impl FnMut(&[u8])) {
    let [yaw_rad, pitch_rad, roll_rad] = sending.angles_rad;
    let mut header = ObjectsHeader {
        magic: OBJECTS_MAGIC,
        version: OBJECTS_VERSION,
        header_bytes: size_of::<ObjectsHeader>() as u32,
        sequence: new.sequence,
        run_ns: sending.run_ns,
        time_ns: new.time_ns,
        sent_ns: sending.sent_ns,
        sent_monotonic_ns: sending.sent_monotonic_ns,
        time_source: new.time_source,
        position_m: sending.position_m,
        yaw_rad,
        pitch_rad,
        roll_rad,
        height_m: new.height_m,
        first_ordinal: new.first_ordinal as u32,
        name: padded(sending.name),
        ..ObjectsHeader::new_zeroed()
    };
    let room = MESSAGE_BYTES - size_of::<ObjectsHeader>();
    let (mut objects, mut labels) = (new.objects, new.labels);
    let mut bytes = Vec::with_capacity(MESSAGE_BYTES);
    loop {
        let these;
        (these, objects) = objects.split_at(objects.len().min(room / size_of::<Object>()));
        // Labels come behind all objects.
        let left = match objects {
            [] => (room - size_of_val(these)) / size_of::<u32>(),
            _ => 0,
        };
        let these_labels;
        (these_labels, labels) = labels.split_at(labels.len().min(left));
        let is_over = objects.is_empty() && labels.is_empty();
        header.objects = these.len() as u32;
        header.labels = these_labels.len() as u32;
        header.flags = new.flags & !if is_over { 0 } else { flags::LAST };
        bytes.clear();
        bytes.extend_from_slice(header.as_bytes());
        bytes.extend_from_slice(these.as_bytes());
        bytes.extend_from_slice(these_labels.as_bytes());
        send(&bytes);
        header.first_ordinal += header.objects;
        header.first_label += header.labels;
        if is_over {
            return;
        }
    }
}

/// A message.
#[derive(Clone, Copy, Debug)]
pub struct ObjectsRef<'a> {
    /// Its header.
    pub header: &'a ObjectsHeader,
    /// The objects that became known.
    pub objects: &'a [Object],
    /// The labels of objects of the sweep, from [`ObjectsHeader::first_label`] on.
    pub labels: &'a [u32],
}

impl<'a> ObjectsRef<'a> {
    /// Reads a message whose header was copied from its bytes before.
    ///
    /// # Errors
    /// [`LayoutError`]: it is none, is of another version, or is cut off.
    pub fn with_header(header: &'a ObjectsHeader, bytes: &'a [u8]) -> Result<Self, LayoutError> {
        if header.magic != OBJECTS_MAGIC {
            return Err(LayoutError::Foreign);
        }
        if header.version != OBJECTS_VERSION {
            return Err(LayoutError::ObjectsVersion {
                found: header.version,
            });
        }
        let torn = LayoutError::Bytes { bytes: bytes.len() };
        let rest = bytes.get(size_of::<ObjectsHeader>()..).ok_or(torn)?;
        let torn = |_| LayoutError::Bytes { bytes: bytes.len() };
        let (objects, rest) = <[Object]>::ref_from_prefix_with_elems(rest, header.objects as usize)
            .map_err(|_| torn(()))?;
        let (labels, _) = <[u32]>::ref_from_prefix_with_elems(rest, header.labels as usize)
            .map_err(|_| torn(()))?;
        Ok(Self {
            header,
            objects,
            labels,
        })
    }

    /// The box of each object in a frame: see [`SweepRef::boxes`](super::SweepRef::boxes).
    pub fn boxes(&self, frame: Frame) -> impl Iterator<Item = [[f64; 3]; 2]> {
        let pose = frame.pose(self.header.mount());
        let objects = self.objects.iter();
        objects.map(move |object| object.segment.box_in(pose.as_ref()))
    }

    /// What became known, without who sent it.
    pub fn new_objects(&self) -> NewObjects<'a> {
        NewObjects {
            sequence: self.header.sequence,
            time_ns: self.header.time_ns,
            time_source: self.header.time_source,
            flags: self.header.flags,
            height_m: self.header.height_m,
            first_ordinal: self.header.first_ordinal as usize,
            objects: self.objects,
            labels: self.labels,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A name is shown on terminals, and the publisher may be any program.
    #[test]
    fn a_name_that_is_not_to_be_shown_is_empty() {
        let mut header = ObjectsHeader::new_zeroed();
        for (name, shown) in [("roof", "roof"), ("\x1b[2J", ""), ("", "")] {
            header.name = padded(name);
            assert_eq!(header.name(), shown);
        }
        header.name = [0xFF; 64];
        assert_eq!(header.name(), "");
    }

    #[test]
    fn another_version_is_refused_with_both() {
        let mut header = ObjectsHeader::new_zeroed();
        (header.magic, header.version) = (OBJECTS_MAGIC, OBJECTS_VERSION + 1);
        let error = ObjectsRef::with_header(&header, header.as_bytes()).unwrap_err();
        let said = error.to_string();
        let both = "objects of version 2, and this program reads version 1";
        assert!(said.contains(both), "{said}");
    }

    /// However many there are, all come, in messages of limited length of which the last says so.
    #[test]
    fn what_is_more_than_a_message_is_split() {
        for (objects, labels) in [(0, 0), (1, 1), (83, 3), (84, 0), (700, 9000), (0, 5000)] {
            let numbered = |ordinal| Object {
                ordinal,
                ..Object::new_zeroed()
            };
            let all: Vec<Object> = (0..objects).map(numbered).collect();
            let all_labels: Vec<u32> = (0..labels).collect();
            let new = NewObjects {
                sequence: 3,
                time_ns: 4,
                time_source: 1,
                flags: flags::LAST | flags::PARTIAL,
                height_m: 1.5,
                first_ordinal: 10,
                objects: &all,
                labels: &all_labels,
            };
            let sending = Sending {
                name: "roof",
                run_ns: 1,
                sent_ns: 2,
                sent_monotonic_ns: 3,
                position_m: [0.0; 3],
                angles_rad: [0.0; 3],
            };
            let (mut found, mut found_labels, mut lasts) = (Vec::new(), Vec::new(), Vec::new());
            write(&new, &sending, |message| {
                assert!(message.len() <= MESSAGE_BYTES);
                let (header, _) = ObjectsHeader::read_from_prefix(message).unwrap();
                let cut = &message[..message.len() - usize::from(message.len() > 192)];
                let is_cut = ObjectsRef::with_header(&header, cut).is_err();
                assert_eq!(is_cut, cut.len() < message.len());
                let view = ObjectsRef::with_header(&header, message).unwrap();
                assert_eq!(header.first_ordinal as usize, 10 + found.len());
                assert_eq!(header.first_label as usize, found_labels.len());
                assert_eq!(header.height_m, 1.5);
                assert_eq!(header.name(), "roof");
                found.extend_from_slice(view.objects);
                found_labels.extend_from_slice(view.labels);
                lasts.push(header.flags & flags::LAST != 0);
            });
            assert_eq!((found, found_labels), (all, all_labels));
            assert_eq!(lasts.iter().position(|last| *last), Some(lasts.len() - 1));
        }
    }
}
