//! Sweeps as MCAP, the messages that ROS 2 would record of them: for Foxglove, `ros2 bag play` and
//! their like.
//!
//! A sensor has the topics `/sweepd/NAME/points` and `/sweepd/NAME/markers`, and a transform in
//! `/tf_static`, if its mount was given. A file holds whole chunks one after another, written in the order of the file, and
//! an index at its end. One without its end is still whole up to its last chunk: mended, it has an
//! index, and a reader that reads from the beginning does without.

mod bag;
mod records;
#[cfg(test)]
pub(crate) mod tests;

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::path::Path;

use self::bag::{BagFolder, Contents, TopicContents};
pub(crate) use self::records::RecordWriter;
use self::records::put_bytes;
use crate::VERSION;
use crate::files::WriteError;
use crate::files::output::{Existing, NewFile};
use crate::files::sequence::ending_of;
use crate::input::bag::mcap::MessageHeader as RecordHeader;
use sweepd_core::sweep::{Header, Pose, SweepRef};
use sweepd_messages::message_type::{self, MessageType};
use sweepd_messages::transforms::{self, Transform};
use sweepd_messages::{Cloud, MessageHeader, Stamp, markers, names};

/// How the names of its files end.
pub(crate) const ENDINGS: &[&str] = &[".mcap"];
/// The program, as the header of a file names it.
pub(crate) const LIBRARY: &str = "sweepd";
/// Opcode of a record of our own, before each cloud whose frame does not name its sensor: the name of
/// the sensor in its topics. Other readers pass over it.
pub(crate) const SENSOR: u8 = 0x80;
/// The frame of the robot, in which a sensor sits.
const ROBOT_FRAME: &str = "base_link";

/// Quality of service as rosbag2 writes it since Jazzy, with a depth and a durability to fill in.
macro_rules! offered {
    ($depth:literal, $durability:literal) => {
        concat!(
            "- history: keep_last\n  depth: ",
            $depth,
            "\n  reliability: reliable\n  durability: ",
            $durability,
            "\n  deadline:\n    sec: 9223372036\n    nsec: 854775807\n",
            "  lifespan:\n    sec: 9223372036\n    nsec: 854775807\n",
            "  liveliness: automatic\n",
            "  liveliness_lease_duration:\n    sec: 9223372036\n    nsec: 854775807\n",
            "  avoid_ros_namespace_conventions: false\n"
        )
    };
}

/// Of topics with a message a sweep.
const OFFERED: &str = offered!("5", "volatile");
/// Of topics whose last message stays valid.
const OFFERED_STATIC: &str = offered!("1", "transient_local");

/// A topic of a sensor.
pub struct Topic {
    /// Of its channel and its schema, in a file of one sensor.
    pub(crate) id: u16,
    /// Its name; with `{}` for that of the sensor.
    name: &'static str,
    message_type: &'static MessageType,
    offered: &'static str,
}

/// Where the sensor sits.
pub const TRANSFORMS: Topic = Topic {
    id: 1,
    name: "/tf_static",
    message_type: &message_type::TF_MESSAGE,
    offered: OFFERED_STATIC,
};
/// The points.
pub const POINTS: Topic = Topic {
    id: 2,
    name: "/sweepd/{}/points",
    message_type: &message_type::POINT_CLOUD,
    offered: OFFERED,
};
/// The boxes of the segments.
pub const MARKERS: Topic = Topic {
    id: 3,
    name: "/sweepd/{}/markers",
    message_type: &message_type::MARKER_ARRAY,
    offered: OFFERED,
};

/// All, in the order in which a file of one sensor gets them.
pub(crate) const TOPICS: [Topic; 3] = [TRANSFORMS, POINTS, MARKERS];

impl Topic {
    /// Its name for a sensor with this [`SensorNames::topic`].
    pub fn name(&self, sensor: &str) -> String {
        self.name.replace("{}", sensor)
    }

    /// Its messages.
    pub fn message_type(&self) -> &'static MessageType {
        self.message_type
    }

    /// Adds its channel for the sensor of this name and number in the file, unless there is one; gives
    /// the channel's number.
    pub(crate) fn add<W: Write>(
        &self,
        writer: &mut RecordWriter<W>,
        sensor: &str,
        number: usize,
    ) -> io::Result<u16> {
        let MessageType {
            name,
            hash,
            definition,
        } = self.message_type;
        // Each sensor has its own topics but the first one.
        let of_others = (TOPICS.len() - 1) * number;
        let id = u16::try_from(usize::from(self.id) + of_others);
        let id = id.map_err(|_| io::Error::other("too many sensors"))?;
        let mut schema = self.id.to_le_bytes().to_vec();
        for text in [name, "ros2msg", definition] {
            put_bytes(&mut schema, text.as_bytes());
        }
        let mut metadata = Vec::new();
        for text in [
            "offered_qos_profiles",
            self.offered,
            "topic_type_hash",
            hash,
        ] {
            put_bytes(&mut metadata, text.as_bytes());
        }
        let mut channel = [id, self.id].map(u16::to_le_bytes).concat();
        put_bytes(&mut channel, self.name(sensor).as_bytes());
        put_bytes(&mut channel, b"cdr");
        put_bytes(&mut channel, &metadata);
        let is_added =
            writer.add_schema(self.id, &schema)? && writer.add_channel(id, self.id, &channel)?;
        // A file that is mended may have both.
        is_added.then_some(id).ok_or_else(|| {
            io::Error::other(format!("another schema or channel has its number, {id}"))
        })
    }

    fn contents<W: Write>(
        &self,
        sensor: &str,
        channel: u16,
        writer: &RecordWriter<W>,
    ) -> TopicContents {
        TopicContents {
            name: self.name(sensor),
            message_type: self.message_type.name,
            offered: self.offered,
            messages: writer.messages(channel),
        }
    }
}

/// How the sweeps of a sensor become messages.
#[derive(Clone, Debug, Default)]
pub struct MessageForm {
    /// Name of the sensor in its topics, and of its frame; else that of its sweeps.
    pub name: Option<String>,
    /// Frame of the messages, if it has another name.
    pub frame_id: Option<String>,
    /// The clouds.
    pub cloud: Cloud,
}

/// What a sensor is called in its messages.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SensorNames {
    /// In topics.
    pub topic: String,
    /// Its frame.
    pub frame_id: String,
}

impl MessageForm {
    /// The names of the sensor of a sweep. Without a name it has that of its address.
    pub fn names(&self, header: &Header) -> SensorNames {
        let own = header.sensor_name();
        let name = self.name.as_deref().unwrap_or(own);
        let topic = names::token(name);
        let frame_id = match &self.frame_id {
            Some(frame_id) => frame_id,
            None if name == header.sensor() => &topic,
            None => name,
        };
        let frame_id = frame_id.to_owned();
        SensorNames { topic, frame_id }
    }
}

impl SensorNames {
    /// From the sensor to the robot, if it was given where it sits.
    pub fn mount(&self, header: &Header) -> Option<Transform> {
        let mount = Transform::of_mount(header, ROBOT_FRAME, &self.frame_id);
        Pose::of_mount(header).is_given().then_some(mount)
    }
}

/// The messages of one sweep.
pub struct SweepMessages {
    /// Name of the sensor in its topics.
    sensor: String,
    time_ns: u64,
    /// Where the sensor sits, if that was given.
    mount: Option<Transform>,
    points: Vec<u8>,
    markers: Vec<u8>,
    /// Whether their frame names the sensor.
    is_named: bool,
}

impl SweepMessages {
    /// Makes them.
    pub fn of(sweep: &SweepRef<'_>, form: &MessageForm) -> Self {
        let names = form.names(sweep.header);
        let header = MessageHeader {
            frame_id: &names.frame_id,
            stamp: Stamp::First,
        };
        let mut points = Vec::new();
        form.cloud.encode(sweep, &header, &mut points);
        let mut boxes = Vec::new();
        markers::encode(sweep, &header, &mut boxes);
        Self {
            time_ns: time_ns(sweep.header),
            mount: names.mount(sweep.header),
            points,
            markers: boxes,
            is_named: names::token(&names.frame_id) == names.topic,
            sensor: names.topic,
        }
    }

    /// The time of the sweep, nanoseconds since 1970.
    pub fn time_ns(&self) -> u64 {
        self.time_ns
    }

    /// Their bytes.
    pub fn bytes(&self) -> u64 {
        (self.points.len() + self.markers.len()) as u64
    }
}

/// The time of a sweep's record. A time before 1970 is none.
pub fn time_ns(header: &Header) -> u64 {
    header.time_ns.max(0) as u64
}

/// Writes one file, from its beginning to its end without seeking.
pub struct McapWriter<W: Write> {
    writer: RecordWriter<W>,
    /// By name.
    sensors: BTreeMap<String, SensorChannels>,
    /// Where each sensor sits, as `/tf_static` says.
    mounts: BTreeMap<String, Transform>,
    static_transforms: Option<u16>,
}

/// Numbers of a sensor's channels.
#[derive(Clone, Copy)]
struct SensorChannels {
    points: u16,
    markers: u16,
}

impl<W: Write> McapWriter<W> {
    /// Begins the file.
    ///
    /// # Errors
    /// What the disk says.
    pub fn new(out: W) -> io::Result<Self> {
        Ok(Self {
            writer: begin(out)?,
            sensors: BTreeMap::new(),
            mounts: BTreeMap::new(),
            static_transforms: None,
        })
    }

    /// Writes the messages of a sweep; of a sensor's first one, and after a change, also where the
    /// sensors sit.
    ///
    /// # Errors
    /// What the disk says.
    pub fn write(&mut self, messages: &SweepMessages) -> io::Result<()> {
        if let Some(mount) = &messages.mount
            && self.mounts.get(&messages.sensor) != Some(mount)
        {
            self.write_mount(messages, mount)?;
        }
        let channels = match self.sensors.get(&messages.sensor) {
            Some(channels) => *channels,
            None => self.add_sensor(&messages.sensor)?,
        };
        if !messages.is_named {
            self.writer.add(SENSOR, messages.sensor.as_bytes())?;
        }
        self.write_to(channels.points, messages.time_ns, &messages.points)?;
        self.write_to(channels.markers, messages.time_ns, &messages.markers)
    }

    fn write_to(&mut self, channel: u16, time_ns: u64, message: &[u8]) -> io::Result<()> {
        let header = RecordHeader {
            channel: channel.into(),
            sequence: (self.writer.messages(channel) as u32).into(),
            logged_ns: time_ns.into(),
            published_ns: time_ns.into(),
        };
        self.writer.add_message(&header, message).map(drop)
    }

    /// All transforms so far: a late reader of `/tf_static` gets the last message only.
    fn write_mount(&mut self, messages: &SweepMessages, mount: &Transform) -> io::Result<()> {
        self.mounts.insert(messages.sensor.clone(), mount.clone());
        let mounts: Vec<Transform> = self.mounts.values().cloned().collect();
        let mut message = Vec::new();
        transforms::encode(messages.time_ns as i64, &mounts, &mut message);
        let channel = TRANSFORMS.add(&mut self.writer, "", 0)?;
        self.static_transforms = Some(channel);
        self.write_to(channel, messages.time_ns, &message)
    }

    fn add_sensor(&mut self, sensor: &str) -> io::Result<SensorChannels> {
        let number = self.sensors.len();
        let channels = SensorChannels {
            points: POINTS.add(&mut self.writer, sensor, number)?,
            markers: MARKERS.add(&mut self.writer, sensor, number)?,
        };
        self.sensors.insert(sensor.to_owned(), channels);
        Ok(channels)
    }

    /// What was written so far.
    fn contents(&self) -> Contents {
        let mut topics = Vec::new();
        if let Some(channel) = self.static_transforms {
            topics.push(TRANSFORMS.contents("", channel, &self.writer));
        }
        for (sensor, channels) in &self.sensors {
            topics.push(POINTS.contents(sensor, channels.points, &self.writer));
            topics.push(MARKERS.contents(sensor, channels.markers, &self.writer));
        }
        let (first_ns, last_ns) = self.writer.times_ns();
        Contents {
            topics,
            first_ns,
            last_ns,
        }
    }

    /// Writes the chunk under way, so that the file can be read up to here.
    ///
    /// # Errors
    /// What the disk says.
    pub fn flush(&mut self) -> io::Result<()> {
        self.writer.flush()
    }

    /// Writes the end of the file.
    ///
    /// # Errors
    /// What the disk says.
    pub fn finish(self) -> io::Result<W> {
        self.writer.finish()
    }
}

/// A file under way that is removed unless it is finished.
pub struct McapOutput {
    writer: McapWriter<BufWriter<File>>,
    new: NewFile,
    bag: Option<BagFolder>,
}

impl McapOutput {
    /// Begins the file.
    ///
    /// # Errors
    /// [`WriteError`]: a name without `.mcap`, a file that exists or cannot be written.
    pub fn create(path: &Path, existing: Existing) -> Result<Self, WriteError> {
        ending_of(path, ENDINGS)?;
        let (file, new) = NewFile::create(path, existing)?;
        let writer = McapWriter::new(BufWriter::new(file)).map_err(|cause| new.failed(cause))?;
        Ok(Self {
            writer,
            new,
            bag: None,
        })
    }

    /// Begins a bag of rosbag2: a folder with the file and what it holds.
    ///
    /// # Errors
    /// [`WriteError`]: a bag that exists, or a folder that cannot be made or written.
    pub fn create_bag(folder: &Path, existing: Existing) -> Result<Self, WriteError> {
        let bag = BagFolder::create(folder, existing)?;
        let output = Self::create(&bag.file(), existing)?;
        Ok(Self {
            bag: Some(bag),
            ..output
        })
    }

    /// Writes the messages of a sweep.
    ///
    /// # Errors
    /// [`WriteError`].
    pub fn write(&mut self, messages: &SweepMessages) -> Result<(), WriteError> {
        let written = self.writer.write(messages);
        written.map_err(|cause| self.new.failed(cause))
    }

    /// Writes its end and gives it its name.
    ///
    /// # Errors
    /// [`WriteError`].
    pub fn finish(self) -> Result<(), WriteError> {
        let contents = self.bag.as_ref().map(|_| self.writer.contents());
        let finished = self.writer.finish();
        finished.map_err(|cause| self.new.failed(cause))?;
        self.new.commit()?;
        match self.bag.zip(contents) {
            Some((bag, contents)) => bag.finish(&contents),
            None => Ok(()),
        }
    }
}

/// Begins a file of this program.
pub(crate) fn begin<W: Write>(out: W) -> io::Result<RecordWriter<W>> {
    RecordWriter::new(out, &format!("{LIBRARY} {VERSION}"))
}
