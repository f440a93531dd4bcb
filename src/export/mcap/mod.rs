//! Sweeps as MCAP, the messages that ROS 2 would record of them: for Foxglove, `ros2 bag play` and
//! their like.
//!
//! A sensor has the topics `/sweepd/NAME/points` and `/sweepd/NAME/markers`, and a transform in
//! `/tf_static`, if its mount was given. A file holds whole chunks one after another, written in the order of the file, and
//! an index at its end. One without its end is still whole up to its last chunk: mended, it has an
//! index, and a reader that reads from the beginning does without.

mod bag;
#[cfg(test)]
pub(crate) mod tests;

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::path::Path;

use mcap::records::MessageHeader as RecordHeader;
use mcap::write::{NoSeek, PrivateRecordOptions};
use mcap::{Compression, McapError, WriteOptions};

use self::bag::{BagFolder, Contents, TopicContents};
use crate::VERSION;
use crate::files::WriteError;
use crate::files::output::{Existing, NewFile};
use crate::files::sequence::ending_of;
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
        writer: &mut mcap::Writer<NoSeek<W>>,
        sensor: &str,
        number: usize,
    ) -> Result<u16, McapError> {
        let MessageType {
            name,
            hash,
            definition,
        } = self.message_type;
        let schema = writer.add_schema_with_id(self.id, name, "ros2msg", definition.as_bytes())?;
        let metadata = [
            ("offered_qos_profiles", self.offered),
            ("topic_type_hash", hash),
        ];
        let metadata = metadata.map(|(key, value)| (key.to_owned(), value.to_owned()));
        // Each sensor has its own topics but the first one.
        let of_others = (TOPICS.len() - 1) * number;
        let id = u16::try_from(usize::from(self.id) + of_others);
        let id = id.map_err(|_| McapError::TooManyChannels)?;
        writer.add_channel_with_id(id, schema, &self.name(sensor), "cdr", &metadata.into())
    }

    fn contents(&self, sensor: &str, channel: &Channel) -> TopicContents {
        TopicContents {
            name: self.name(sensor),
            message_type: self.message_type.name,
            offered: self.offered,
            messages: channel.messages,
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
    writer: mcap::Writer<NoSeek<W>>,
    /// By name.
    sensors: BTreeMap<String, SensorChannels>,
    /// Where each sensor sits, as `/tf_static` says.
    mounts: BTreeMap<String, Transform>,
    static_transforms: Option<Channel>,
    /// The first and the last time of a message.
    times_ns: Option<(u64, u64)>,
}

/// A topic, and the messages in it.
struct Channel {
    id: u16,
    messages: u32,
}

struct SensorChannels {
    points: Channel,
    markers: Channel,
}

impl<W: Write> McapWriter<W> {
    /// Begins the file.
    ///
    /// # Errors
    /// What the disk says.
    pub fn new(out: W) -> io::Result<Self> {
        Ok(Self {
            writer: options().create(NoSeek::new(out)).map_err(io_error)?,
            sensors: BTreeMap::new(),
            mounts: BTreeMap::new(),
            static_transforms: None,
            times_ns: None,
        })
    }

    /// Writes the messages of a sweep; of a sensor's first one, and after a change, also where the
    /// sensors sit.
    ///
    /// # Errors
    /// What the disk says.
    pub fn write(&mut self, messages: &SweepMessages) -> io::Result<()> {
        self.try_write(messages).map_err(io_error)
    }

    fn try_write(&mut self, messages: &SweepMessages) -> Result<(), McapError> {
        if let Some(mount) = &messages.mount
            && self.mounts.get(&messages.sensor) != Some(mount)
        {
            self.write_mount(messages, mount)?;
        }
        if !self.sensors.contains_key(&messages.sensor) {
            let channels = self.add_sensor(&messages.sensor)?;
            self.sensors.insert(messages.sensor.clone(), channels);
        }
        let Some(channels) = self.sensors.get_mut(&messages.sensor) else {
            return Ok(());
        };
        if !messages.is_named {
            let name = messages.sensor.as_bytes();
            let options = PrivateRecordOptions::IncludeInChunks.into();
            self.writer.write_private_record(SENSOR, name, options)?;
        }
        let time_ns = messages.time_ns;
        let (first_ns, last_ns) = self.times_ns.unwrap_or((time_ns, time_ns));
        self.times_ns = Some((first_ns.min(time_ns), last_ns.max(time_ns)));
        channels
            .points
            .write(&mut self.writer, time_ns, &messages.points)?;
        channels
            .markers
            .write(&mut self.writer, time_ns, &messages.markers)
    }

    /// All transforms so far: a late reader of `/tf_static` gets the last message only.
    fn write_mount(
        &mut self,
        messages: &SweepMessages,
        mount: &Transform,
    ) -> Result<(), McapError> {
        self.mounts.insert(messages.sensor.clone(), mount.clone());
        let mounts: Vec<Transform> = self.mounts.values().cloned().collect();
        let mut message = Vec::new();
        transforms::encode(messages.time_ns as i64, &mounts, &mut message);
        let channel = match &mut self.static_transforms {
            Some(channel) => channel,
            none => none.insert(Channel::new(TRANSFORMS.add(&mut self.writer, "", 0)?)),
        };
        channel.write(&mut self.writer, messages.time_ns, &message)
    }

    fn add_sensor(&mut self, sensor: &str) -> Result<SensorChannels, McapError> {
        let number = self.sensors.len();
        Ok(SensorChannels {
            points: Channel::new(POINTS.add(&mut self.writer, sensor, number)?),
            markers: Channel::new(MARKERS.add(&mut self.writer, sensor, number)?),
        })
    }

    /// What was written so far.
    fn contents(&self) -> Contents {
        let mut topics = Vec::new();
        if let Some(channel) = &self.static_transforms {
            topics.push(TRANSFORMS.contents("", channel));
        }
        for (sensor, channels) in &self.sensors {
            topics.push(POINTS.contents(sensor, &channels.points));
            topics.push(MARKERS.contents(sensor, &channels.markers));
        }
        let (first_ns, last_ns) = self.times_ns.unwrap_or_default();
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
        self.writer.flush().map_err(io_error)
    }

    /// Writes the end of the file.
    ///
    /// # Errors
    /// What the disk says.
    pub fn finish(mut self) -> io::Result<W> {
        self.writer.finish().map_err(io_error)?;
        let mut out = self.writer.into_inner().into_inner();
        out.flush()?;
        Ok(out)
    }
}

impl Channel {
    fn new(id: u16) -> Self {
        Self { id, messages: 0 }
    }

    fn write<W: Write>(
        &mut self,
        writer: &mut mcap::Writer<NoSeek<W>>,
        time_ns: u64,
        message: &[u8],
    ) -> Result<(), McapError> {
        let header = RecordHeader {
            channel_id: self.id,
            sequence: self.messages,
            log_time: time_ns,
            publish_time: time_ns,
        };
        self.messages = self.messages.wrapping_add(1);
        writer.write_to_known_channel(&header, message)
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

/// How files are written.
pub(crate) fn options() -> WriteOptions {
    WriteOptions::new()
        .profile("ros2")
        .library(format!("{LIBRARY} {VERSION}"))
        // Files of three quarters the size. With zstd they have 0.58 of it, and take twice the time.
        .compression(Some(Compression::Lz4))
        .disable_seeking(true)
}

/// An error of the writer as one of the system, which is what it is.
pub(crate) fn io_error(error: McapError) -> io::Error {
    match error {
        McapError::Io(cause) => cause,
        other => io::Error::other(other),
    }
}
