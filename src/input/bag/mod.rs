//! Packets from ROS bags: the `velodyne_msgs/VelodyneScan` messages of MCAP files, of the databases
//! and folders of rosbag2, and of ROS 1 bags.
//!
//! A bag has no datagrams: the stamp of a packet stands for its arrival, and the topic for the
//! address of its sensor. velodyne_driver stamps a packet as it reads it, with the mean of the times
//! before and after, or, with `gps_time`, by the packet's own clock. It puts no position packets
//! into a bag, so sweeps have the time of the capture.

mod chunks;
mod database;
mod definition;
pub(crate) mod mcap;
mod ros1;
mod scan;
mod stamps;

use std::collections::VecDeque;
use std::fs::File;
use std::io::{self, Cursor};
use std::net::{Ipv6Addr, SocketAddr};
use std::path::{Path, PathBuf};

use super::db3;
use super::error::{CaptureError, Damage, Place, Stop, Truncation};
use super::source::{Input, Opened, SQLITE_MAGIC, ZSTD_MAGIC, read_full};
use definition::{ScanLayout, last_name};
use scan::{Encoding, Scan};
use stamps::Stamps;

/// Most bytes of a message: ten thousand packets, many turns of any model.
pub const MAX_MESSAGE_LEN: u64 = 16 << 20;
/// Scans are read ahead up to here, to put the packets of several topics in order.
const MAX_WAITING: usize = 4 << 20;
/// Most topics with scans.
pub const MAX_TOPICS: usize = 1024;
const MAX_TOPIC_LEN: u64 = 4096;
/// Most topics that a message lists.
const MAX_LISTED: usize = 20;
/// Longest name of a topic or type in a message.
const MAX_NAME_CHARS: usize = 200;

/// The names of the files of a folder end with one of these.
const FILE_ENDS: [&str; 4] = [".mcap", ".mcap.zstd", ".db3", ".bag"];

/// A file of messages.
trait Log: Send {
    /// The next message on a topic with scans; `None` at the end.
    fn next(&mut self, topics: &mut Topics) -> Result<Option<Message>, Stop>;

    /// The place of what was read last.
    fn place(&self) -> Place;
}

/// Whether messages of this type are scans, by its name, of any package: forks keep the type.
pub fn is_scans(kind: &str) -> bool {
    last_name(kind).ends_with("VelodyneScan")
}

/// Whether messages of this type may be packets in another form, by its name.
fn is_like_packets(kind: &str) -> bool {
    let name = last_name(kind);
    name.contains("Packet") || name.contains("Scan") && !name.ends_with("LaserScan")
}

/// As much of a name as is shown.
fn short(name: &str) -> String {
    name.chars().take(MAX_NAME_CHARS).collect()
}

/// A message on a topic with scans.
struct Message {
    /// Index of the topic.
    topic: usize,
    /// `None` if it is not understood.
    encoding: Option<Encoding>,
    /// When it was recorded, nanoseconds since 1970.
    logged_ns: i64,
    bytes: Vec<u8>,
}

impl Message {
    /// The packets in it, also where rosbag2 has compressed each message.
    fn scan(self, layout: Option<&ScanLayout>) -> Option<Scan> {
        let mut bytes = self.bytes;
        if bytes.starts_with(&ZSTD_MAGIC) {
            let compressed = Box::new(Cursor::new(bytes));
            bytes = Input::zstd(compressed).rest(MAX_MESSAGE_LEN).ok()?;
        }
        Scan::new(bytes, self.encoding?, layout)
    }
}

/// The topics of a bag.
#[derive(Default)]
struct Topics {
    scans: Vec<Topic>,
    /// The first others, for a message, and whether there are more.
    others: Vec<String>,
    has_more: bool,
    /// The first of the others that may hold packets.
    like_packets: Option<String>,
}

struct Topic {
    name: String,
    /// By the definition of its type; `None` where there is none.
    layout: Option<ScanLayout>,
    source: SocketAddr,
    waiting: VecDeque<Scan>,
    stamps: Stamps,
    /// Whether a message has come: one that never comes is not waited for.
    is_active: bool,
}

impl Topics {
    /// Notes a topic with messages of this type, with their layout by its definition, if that is of
    /// scans. Its index, if the messages are scans.
    fn add(
        &mut self,
        name: &str,
        kind: &str,
        layout: Option<&ScanLayout>,
    ) -> Result<Option<usize>, Stop> {
        bounded(name.len() as u64, MAX_TOPIC_LEN, "topic")?;
        let name = format!("/{}", name.trim_start_matches('/'));
        if layout.is_none() && !is_scans(kind) {
            self.add_other(&name, kind);
            return Ok(None);
        }
        if let Some(index) = self.scans.iter().position(|topic| topic.name == name) {
            return Ok(Some(index));
        }
        let index = self.scans.len();
        if index == MAX_TOPICS {
            return Err(Damage::TooManyTopics { limit: MAX_TOPICS }.into());
        }
        // Of the block that is for discarding (RFC 6666): it keeps topics apart as addresses do,
        // and is no sensor's.
        let ip = Ipv6Addr::new(0x100, 0, 0, 0, 0, 0, 0, index as u16 + 1);
        self.scans.push(Topic {
            name,
            layout: layout.cloned(),
            source: (ip, 0).into(),
            waiting: VecDeque::new(),
            stamps: Stamps::default(),
            is_active: false,
        });
        Ok(Some(index))
    }

    fn add_other(&mut self, name: &str, kind: &str) {
        let other = format!("{} ({})", short(name), short(kind));
        if self.like_packets.is_none() && is_like_packets(kind) {
            self.like_packets = Some(other.clone());
        }
        if self.others.contains(&other) {
            return;
        }
        if self.others.len() < MAX_LISTED {
            self.others.push(other);
        } else {
            self.has_more = true;
        }
    }

    /// What there is in place of scans.
    fn list_others(&self) -> String {
        if self.others.is_empty() {
            return "it has no topics".to_owned();
        }
        let more = if self.has_more { ", and more" } else { "" };
        format!("it has {}{more}", self.others.join(", "))
    }

    /// The topic whose next packet is the earliest.
    fn earliest(&self) -> Option<usize> {
        let stamps = self.scans.iter().enumerate().filter_map(|(index, topic)| {
            let (stamp_ns, _) = topic.waiting.front()?.packet()?;
            Some((stamp_ns, index))
        });
        stamps.min().map(|(_, index)| index)
    }

    fn waiting_bytes(&self) -> usize {
        let scans = self.scans.iter().flat_map(|topic| &topic.waiting);
        scans.map(Scan::len).sum()
    }
}

/// What comes next in a bag.
pub(super) enum Step {
    /// A packet, which [`Bag::packet`] gives.
    Packet,
    /// A message that is no scan.
    Malformed,
    /// The end, or where the bag breaks off.
    End,
}

/// A packet of a bag.
pub(super) struct BagPacket<'a> {
    pub(super) stamp_ns: i64,
    pub(super) topic: &'a str,
    /// Stands for the address of the sensor.
    pub(super) source: SocketAddr,
    pub(super) payload: &'a [u8],
}

/// A bag, packet by packet.
pub(super) struct Bag {
    name: String,
    log: Box<dyn Log>,
    format: &'static str,
    /// The file that is read, and those that follow; of a folder.
    file: Option<PathBuf>,
    files: VecDeque<PathBuf>,
    reader: db3::Reader,
    topics: Topics,
    /// The topic of the current packet.
    current: Option<usize>,
    malformed: u64,
    /// Whether stamps were no times, and record times stand for them.
    is_restamped: bool,
    /// Why nothing more is read, once that is so.
    end: Option<Result<(), Stop>>,
    steps: u64,
    truncation: Option<Truncation>,
}

impl Bag {
    /// Whether what begins with these bytes is a bag that is read as a stream.
    pub(super) fn is_magic(head: &[u8]) -> bool {
        head.starts_with(mcap::MAGIC) || head.starts_with(ros1::MAGIC)
    }

    /// Whether a bag of this path is opened by its path: a folder, or a database.
    pub(super) fn is_in_place(path: &Path) -> bool {
        path.is_dir() || is_database(path)
    }

    /// Opens a folder or a database.
    pub(super) fn open(path: &Path, reader: &db3::Reader) -> Result<Self, CaptureError> {
        let name = path.display().to_string();
        if !path.is_dir() {
            let opened = open_log(path, reader)?;
            return Self::begin(name, opened, reader, None, VecDeque::new());
        }
        let mut files = files_of(path).map_err(|source| CaptureError::Open {
            name: name.clone(),
            source,
        })?;
        let Some(first) = files.pop_front() else {
            let found = "a folder without .mcap, .db3 or .bag files";
            let source = io::Error::new(io::ErrorKind::IsADirectory, found);
            return Err(CaptureError::Open { name, source });
        };
        let opened = open_log(&first, reader)?;
        Self::begin(name, opened, reader, Some(first), files)
    }

    /// Reads on from the first bytes of a bag.
    pub(super) fn over(opened: Opened) -> Result<Self, CaptureError> {
        let name = opened.name.clone();
        let opened = stream(opened)?;
        Self::begin(name, opened, &db3::Reader::default(), None, VecDeque::new())
    }

    /// Reads up to the first scan: without scans, it is no capture.
    fn begin(
        name: String,
        (log, format): (Box<dyn Log>, &'static str),
        reader: &db3::Reader,
        file: Option<PathBuf>,
        files: VecDeque<PathBuf>,
    ) -> Result<Self, CaptureError> {
        let mut bag = Self {
            name,
            log,
            format,
            file,
            files,
            reader: reader.clone(),
            topics: Topics::default(),
            current: None,
            malformed: 0,
            is_restamped: false,
            end: None,
            steps: 0,
            truncation: None,
        };
        while bag.end.is_none() && bag.malformed == 0 && bag.topics.earliest().is_none() {
            bag.read()?;
        }
        if bag.topics.scans.is_empty() {
            bag.conclude()?;
            let topics = bag.topics.list_others();
            let found = match &bag.truncation {
                Some(truncation) => format!("{topics} as far as it is whole; {truncation}"),
                None => match &bag.topics.like_packets {
                    Some(other) => format!(
                        "{topics}. {other} may hold packets, but in no form that is known: a list of a time and \
                         uint8[1206] each is read where the bag has the definition of its type, and of a database \
                         `ros2 bag convert` makes an MCAP that has it"
                    ),
                    None => format!(
                        "{topics}. Record the driver's packets too, often /velodyne_packets: points do not \
                     become packets again"
                    ),
                },
            };
            let name = bag.name;
            return Err(CaptureError::NoScans { name, found });
        }
        Ok(bag)
    }

    /// Goes on to the next packet.
    pub(super) fn advance(&mut self) -> Result<Step, CaptureError> {
        if let Some(topic) = self.current.take() {
            let waiting = &mut self.topics.scans[topic].waiting;
            if let Some(scan) = waiting.front_mut() {
                scan.advance();
                if scan.left() == 0 {
                    waiting.pop_front();
                }
            }
        }
        while self.end.is_none() && self.malformed == 0 && self.wants_more() {
            self.read()?;
        }
        if self.malformed > 0 {
            self.malformed -= 1;
            self.steps += 1;
            return Ok(Step::Malformed);
        }
        self.current = self.topics.earliest();
        if self.current.is_some() {
            self.steps += 1;
            return Ok(Step::Packet);
        }
        self.conclude()?;
        Ok(Step::End)
    }

    /// The current packet.
    pub(super) fn packet(&self) -> Option<BagPacket<'_>> {
        let topic = &self.topics.scans[self.current?];
        let (stamp_ns, payload) = topic.waiting.front()?.packet()?;
        Some(BagPacket {
            stamp_ns,
            topic: &topic.name,
            source: topic.source,
            payload,
        })
    }

    /// Whether a packet that comes before those that wait may be still to be read.
    fn wants_more(&self) -> bool {
        let mut scans = self.topics.scans.iter();
        let is_empty = scans.any(|topic| topic.is_active && topic.waiting.is_empty());
        self.topics.earliest().is_none() || is_empty && self.topics.waiting_bytes() < MAX_WAITING
    }

    /// Reads a message, or notes the end.
    fn read(&mut self) -> Result<(), CaptureError> {
        match self.log.next(&mut self.topics) {
            Ok(Some(message)) => {
                let topic = &mut self.topics.scans[message.topic];
                topic.is_active = true;
                let logged_ns = message.logged_ns;
                match message.scan(topic.layout.as_ref()) {
                    Some(mut scan) if scan.left() > 0 => {
                        self.is_restamped |= topic.stamps.check(&mut scan, logged_ns);
                        topic.waiting.push_back(scan);
                    }
                    Some(_) => {}
                    None => self.malformed += 1,
                }
            }
            Ok(None) => match self.files.pop_front() {
                Some(file) => {
                    self.log = open_log(&file, &self.reader)?.0;
                    self.file = Some(file);
                }
                None => self.end = Some(Ok(())),
            },
            Err(stop) => self.end = Some(Err(stop)),
        }
        Ok(())
    }

    /// Says how the bag ended, once what was read of it is used up.
    fn conclude(&mut self) -> Result<(), CaptureError> {
        let Some(Err(stop)) = self.end.replace(Ok(())) else {
            return Ok(());
        };
        let mut place = self.log.place();
        if let Some(file) = &self.file {
            let file = file.file_name().unwrap_or_default().to_string_lossy();
            place = Place::InFile(Box::new(place), file.into_owned());
        }
        let record = self.steps;
        match stop {
            Stop::Damaged(reason) => {
                self.truncation = Some(Truncation {
                    record,
                    place,
                    reason,
                });
                Ok(())
            }
            Stop::Read(source) => Err(CaptureError::Read {
                name: self.name.clone(),
                record,
                place,
                source,
            }),
        }
    }

    pub(super) fn truncation(&self) -> Option<&Truncation> {
        self.truncation.as_ref()
    }

    pub(super) fn name(&self) -> &str {
        &self.name
    }

    pub(super) fn is_restamped(&self) -> bool {
        self.is_restamped
    }

    /// Its format, for people.
    pub(super) fn format(&self) -> &'static str {
        self.format
    }
}

/// Opens a file of a folder, or a database.
fn open_log(
    path: &Path,
    reader: &db3::Reader,
) -> Result<(Box<dyn Log>, &'static str), CaptureError> {
    if is_database(path) {
        let database = database::Database::open(path, reader)?;
        return Ok((Box::new(database), "rosbag2 database"));
    }
    let (name, source) = Input::open(path)?;
    stream(Opened::new(&name, source)?)
}

/// A bag that is read as a stream.
fn stream(mut opened: Opened) -> Result<(Box<dyn Log>, &'static str), CaptureError> {
    let head = std::mem::take(&mut opened.head);
    let mut input = opened.input;
    if let Some(rest) = head.strip_prefix(mcap::MAGIC) {
        input.unread(rest);
        return Ok((Box::new(mcap::Mcap::new(input)), "MCAP"));
    }
    if let Some(rest) = head.strip_prefix(ros1::MAGIC) {
        input.unread(rest);
        return Ok((Box::new(ros1::Ros1Bag::new(input)), "ROS 1 bag"));
    }
    Err(Opened {
        head,
        input,
        name: opened.name,
    }
    .refused())
}

/// Whether a file is a SQLite database. Not asked of a pipe, whose bytes would be gone.
fn is_database(path: &Path) -> bool {
    let mut head = [0; SQLITE_MAGIC.len()];
    path.is_file()
        && File::open(path).is_ok_and(|mut file| read_full(&mut file, &mut head).is_ok())
        && head == SQLITE_MAGIC
}

/// The bags of a folder in the order of their numbers: `drive_9.mcap` comes before `drive_10.mcap`.
fn files_of(folder: &Path) -> std::io::Result<VecDeque<PathBuf>> {
    let mut files = Vec::new();
    for entry in std::fs::read_dir(folder)? {
        let path = entry?.path();
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        let is_bag = |end: &&str| name.ends_with(*end);
        if FILE_ENDS.iter().any(is_bag) && path.is_file() {
            files.push((name.len(), name.into_owned(), path));
        }
    }
    files.sort();
    Ok(files.into_iter().map(|(_, _, path)| path).collect())
}

/// A length, if it is no more than what can be there.
fn bounded(found: u64, limit: u64, what: &'static str) -> Result<usize, Stop> {
    if found > limit {
        return Err(Damage::BagLength { what, found, limit }.into());
    }
    Ok(found as usize)
}
