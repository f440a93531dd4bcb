//! Reads datagrams from capture files and UDP ports; writes the same format.
//!
//! * [`pcap`]: the records of a pcap or pcapng file, plain or compressed.
//! * [`link`]: the UDP datagram in a frame.
//! * [`Capture`]: both together, with counts of all skipped records; and the packets of ROS bags.
//! * Bare packets, without capture records.
//! * [`db3`]: the program that reads the databases of rosbag2.
//! * [`udp`]: the datagrams of live sensors.
//! * [`pace`]: when to send each datagram of a replay.
//! * [`mod@write`]: captures written.

mod arrivals;
pub(crate) mod bag;
pub mod db3;
pub mod error;
mod frame;
pub mod link;
pub mod pace;
mod payloads;
pub mod pcap;
mod pcapng;
pub(crate) mod source;
mod times;
pub mod udp;
pub mod write;

use std::io::Read;
use std::path::Path;

use arrivals::{Arrivals, RecordTimes};
use bag::{Bag, Step};
pub use error::{CaptureError, Damage, Place, Truncation};
pub use frame::Record;
pub use link::{Decapsulator, LinkType, NoDatagram};
pub use pace::{Pacer, Speed};
use payloads::Payloads;
pub use pcap::CaptureReader;
use source::{Input, Opened};
use sweepd_core::wire::{DATA_PORT, Datagram};
pub(crate) use times::FIRST_NS;
pub use udp::{UdpConfig, UdpError, UdpSource};
pub use write::PcapWriter;

/// Most link types that are reported for a capture.
const MAX_LINK_TYPES: usize = 16;

/// Counts of the records so far. Every record is a datagram or one of the others.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct CaptureCounts {
    /// Records read; of a bag, packets.
    pub records: u64,
    /// Records that gave a datagram, including the last fragment of one.
    pub datagrams: u64,
    /// Records without an IP packet.
    pub not_ip: u64,
    /// Records with another protocol than UDP.
    pub not_udp: u64,
    /// Records with fewer bytes of a datagram than its headers state, and than were on the network:
    /// captured with too small a snap length.
    pub truncated_records: u64,
    /// Fragments, except those that completed a datagram.
    pub fragments: u64,
    /// Records with an unsupported link type.
    pub unsupported_link: u64,
    /// Records with headers that contradict themselves or end inside the whole frame, and messages
    /// of a bag that are no scan.
    pub malformed: u64,
    /// Records without a time (pcapng simple packet blocks), which get that of the record before.
    /// They are also counted above.
    pub untimed: u64,
}

impl CaptureCounts {
    /// Complete records without a UDP datagram.
    pub fn other_traffic(&self) -> u64 {
        self.not_ip + self.not_udp + self.unsupported_link + self.malformed
    }

    fn count(&mut self, reason: NoDatagram) {
        *match reason {
            NoDatagram::NotIp => &mut self.not_ip,
            NoDatagram::NotUdp => &mut self.not_udp,
            NoDatagram::CutShort => &mut self.truncated_records,
            NoDatagram::FragmentWaiting => &mut self.fragments,
            NoDatagram::UnsupportedLink(_) => &mut self.unsupported_link,
            NoDatagram::Malformed => &mut self.malformed,
        } += 1;
    }
}

/// The datagrams of a capture, in its order.
///
/// ```no_run
/// let mut capture = sweepd::input::Capture::open("drive.pcapng.gz")?;
/// while let Some(datagram) = capture.next_datagram()? {
///     println!("{}: {} bytes from {}", datagram.arrival_ns, datagram.payload.len(), datagram.source);
/// }
/// if let Some(truncation) = capture.truncation() {
///     eprintln!("{truncation}");
/// }
/// # Ok::<(), sweepd::input::CaptureError>(())
/// ```
pub struct Capture {
    reader: Reader,
    stats: CaptureStats,
}

enum Reader {
    Frames(Box<Frames>),
    Bag(Box<Bag>),
    Payloads(Box<Payloads>),
}

/// What reads frames.
struct Frames {
    reader: CaptureReader,
    decapsulator: Decapsulator,
    arrivals: Arrivals,
}

/// A datagram with its place in the capture.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Placed<'a> {
    /// Number of the record that it came from, from 0.
    pub record: u64,
    /// Nanoseconds after the first record of the capture; negative where times go back.
    pub since_start_ns: i64,
    /// The topic of a bag that it came from. The source of the datagram then only keeps topics
    /// apart.
    pub topic: Option<&'a str>,
    /// The datagram.
    pub datagram: Datagram<'a>,
}

impl<'a> From<Datagram<'a>> for Placed<'a> {
    /// A datagram that is in no capture.
    fn from(datagram: Datagram<'a>) -> Self {
        Self {
            record: 0,
            since_start_ns: 0,
            topic: None,
            datagram,
        }
    }
}

/// What is remembered of the records read.
#[derive(Default)]
struct CaptureStats {
    counts: CaptureCounts,
    link_types: Vec<LinkType>,
    first_ns: Option<i64>,
    last_ns: Option<i64>,
}

impl CaptureStats {
    /// Notes a record, and gives its time.
    fn note(&mut self, record: &Record<'_>) -> i64 {
        if self.link_types.len() < MAX_LINK_TYPES && !self.link_types.contains(&record.link_type) {
            self.link_types.push(record.link_type);
        }
        self.note_time(record.time_ns)
    }

    fn note_time(&mut self, time_ns: Option<i64>) -> i64 {
        self.counts.records += 1;
        let Some(time_ns) = time_ns else {
            self.counts.untimed += 1;
            return self.last_ns.unwrap_or(0);
        };
        self.first_ns.get_or_insert(time_ns);
        self.last_ns = Some(time_ns);
        time_ns
    }

    /// A datagram of the record that was noted last.
    fn place<'a>(&mut self, datagram: Datagram<'a>, topic: Option<&'a str>) -> Placed<'a> {
        self.counts.datagrams += 1;
        let arrival_ns = datagram.arrival_ns;
        Placed {
            record: self.counts.records - 1,
            since_start_ns: arrival_ns.saturating_sub(self.first_ns.unwrap_or(arrival_ns)),
            topic,
            datagram,
        }
    }
}

impl Capture {
    /// Opens the capture at `path`, a file or the folder of a ROS 2 bag, or standard input for `-`.
    ///
    /// # Errors
    /// [`CaptureError`]: it cannot be opened or read, or is not a capture.
    pub fn open(path: impl AsRef<Path>) -> Result<Self, CaptureError> {
        Self::open_by(path, &db3::Reader::default())
    }

    /// As [`Capture::open`]; databases of rosbag2 are read as `reader` says.
    ///
    /// # Errors
    /// As there.
    pub fn open_by(path: impl AsRef<Path>, reader: &db3::Reader) -> Result<Self, CaptureError> {
        let path = path.as_ref();
        if Self::is_in_place(path) {
            return Bag::open(path, reader).map(Self::of_bag);
        }
        let (name, source) = Input::open(path)?;
        Self::new(&name, source)
    }

    /// Whether [`Capture::open`] alone can read what is at `path`: a folder or a SQLite database is
    /// no stream.
    pub fn is_in_place(path: &Path) -> bool {
        path != Path::new("-") && Bag::is_in_place(path)
    }

    /// Reads a capture from anywhere; `name` is for messages.
    ///
    /// # Errors
    /// [`CaptureError`]: it cannot be read, or is not a capture.
    pub fn new(name: &str, source: Box<dyn Read + Send>) -> Result<Self, CaptureError> {
        let mut opened = Opened::new(name, source)?;
        if Bag::is_magic(&opened.head) {
            return Bag::over(opened).map(Self::of_bag);
        }
        if Payloads::is_in(&mut opened)? {
            return Ok(Self {
                reader: Reader::Payloads(Box::new(Payloads::over(opened))),
                stats: CaptureStats::default(),
            });
        }
        let frames = Frames {
            reader: CaptureReader::over(opened)?,
            decapsulator: Decapsulator::new(),
            arrivals: Arrivals::new(),
        };
        Ok(Self {
            reader: Reader::Frames(Box::new(frames)),
            stats: CaptureStats::default(),
        })
    }

    fn of_bag(bag: Bag) -> Self {
        Self {
            reader: Reader::Bag(Box::new(bag)),
            stats: CaptureStats::default(),
        }
    }

    /// The next datagram; `None` at the end, or where the capture breaks off, for which
    /// [`Capture::truncation`] gives the reason.
    ///
    /// # Errors
    /// [`CaptureError::Read`] when the disk or pipe fails. After that, `None`.
    pub fn next_datagram(&mut self) -> Result<Option<Datagram<'_>>, CaptureError> {
        Ok(self.next_placed()?.map(|placed| placed.datagram))
    }

    /// As [`Capture::next_datagram`], with its place in the capture.
    ///
    /// # Errors
    /// As there.
    pub fn next_placed(&mut self) -> Result<Option<Placed<'_>>, CaptureError> {
        let stats = &mut self.stats;
        match &mut self.reader {
            Reader::Frames(frames) => next_judged(frames, stats),
            Reader::Bag(bag) => next_packet(bag, stats),
            Reader::Payloads(payloads) => next_payload(payloads, stats),
        }
    }

    /// The record that was read last, for messages; a bag and bare packets have none.
    pub fn record(&self) -> Option<Record<'_>> {
        match &self.reader {
            Reader::Frames(frames) => frames.reader.record(),
            Reader::Bag(_) | Reader::Payloads(_) => None,
        }
    }

    /// The format of what has packets without frames, `MCAP` for example; `None` if it has frames.
    pub fn bag_format(&self) -> Option<&'static str> {
        match &self.reader {
            Reader::Frames(_) => None,
            Reader::Bag(bag) => Some(bag.format()),
            Reader::Payloads(_) => Some("bare packets, of an unknown address and hour"),
        }
    }

    /// What people should know of the times so far: which are none, and what
    /// stands for them.
    pub fn remark(&self) -> Option<&'static str> {
        match &self.reader {
            Reader::Frames(frames) => match frames.arrivals.times {
                RecordTimes::Open | RecordTimes::Good => None,
                RecordTimes::Old => Some(times::OLD),
                RecordTimes::Mended => Some(times::MENDED),
            },
            Reader::Bag(bag) => bag.is_restamped().then_some(times::RESTAMPED),
            Reader::Payloads(_) => Some(times::BARE),
        }
    }

    /// Counts of records read and skipped so far.
    pub fn counts(&self) -> CaptureCounts {
        let held = match &self.reader {
            Reader::Frames(frames) => frames.arrivals.counts(),
            _ => None,
        };
        held.unwrap_or(self.stats.counts)
    }

    /// The link types met so far, at most 16.
    pub fn link_types(&self) -> &[LinkType] {
        &self.stats.link_types
    }

    /// Time of the first record that has one, nanoseconds since 1970.
    pub fn first_ns(&self) -> Option<i64> {
        let mended = self.mended().map(|arrivals| arrivals.first_ns);
        mended.or(self.stats.first_ns)
    }

    /// Time of the last record read that has one, nanoseconds since 1970.
    pub fn last_ns(&self) -> Option<i64> {
        let mended = self.mended().map(|arrivals| arrivals.newest_ns);
        mended.or(self.stats.last_ns)
    }

    fn mended(&self) -> Option<&Arrivals> {
        match &self.reader {
            Reader::Frames(frames) if frames.arrivals.times == RecordTimes::Mended => {
                Some(&frames.arrivals)
            }
            _ => None,
        }
    }

    /// Where and why the capture broke off; `None` if it has not.
    pub fn truncation(&self) -> Option<&Truncation> {
        match &self.reader {
            Reader::Frames(frames) => frames.reader.truncation(),
            Reader::Bag(bag) => bag.truncation(),
            Reader::Payloads(payloads) => payloads.truncation(),
        }
    }

    /// The path or name that the capture was opened with.
    pub fn name(&self) -> &str {
        match &self.reader {
            Reader::Frames(frames) => frames.reader.name(),
            Reader::Bag(bag) => bag.name(),
            Reader::Payloads(payloads) => payloads.name(),
        }
    }
}

/// The next datagram of frames, of which the first are held until their times are judged.
fn next_judged<'a>(
    frames: &'a mut Frames,
    stats: &mut CaptureStats,
) -> Result<Option<Placed<'a>>, CaptureError> {
    let Frames {
        reader,
        decapsulator,
        arrivals,
    } = frames;
    while arrivals.is_open() {
        match next_frame(reader, decapsulator, stats) {
            Ok(Some(placed)) => arrivals.hold(&placed, stats.counts),
            Ok(None) => arrivals.end(Ok(())),
            Err(error) => arrivals.end(Err(error)),
        }
    }
    if arrivals.advance() {
        return Ok(arrivals.current());
    }
    if let Some(ended) = arrivals.ended.take() {
        return ended.map(|()| None);
    }
    let placed = next_frame(reader, decapsulator, stats)?;
    Ok(placed.map(|placed| arrivals.follow(placed)))
}

fn next_frame<'a>(
    reader: &'a mut CaptureReader,
    decapsulator: &'a mut Decapsulator,
    stats: &mut CaptureStats,
) -> Result<Option<Placed<'a>>, CaptureError> {
    let (found, arrival_ns) = loop {
        let Some(record) = reader.next()? else {
            return Ok(None);
        };
        let time_ns = stats.note(&record);
        match decapsulator.find(record.link_type, record.bytes, time_ns) {
            Ok(found) => break (found, time_ns),
            // It was whole on the network, and is no datagram.
            Err(NoDatagram::CutShort) if record.bytes.len() >= record.original_len as usize => {
                stats.counts.count(NoDatagram::Malformed);
            }
            Err(reason) => stats.counts.count(reason),
        }
    };
    // Requested again: the borrow of a record from the loop would forbid to read the next one.
    let frame = reader.record().map_or(&[][..], |record| record.bytes);
    let payload = decapsulator.payload(&found, frame);
    let datagram = Datagram {
        arrival_ns,
        source: found.source,
        destination_port: found.destination_port,
        payload,
    };
    Ok(Some(stats.place(datagram, None)))
}

fn next_packet<'a>(
    bag: &'a mut Bag,
    stats: &mut CaptureStats,
) -> Result<Option<Placed<'a>>, CaptureError> {
    loop {
        match bag.advance()? {
            Step::Packet => break,
            Step::End => return Ok(None),
            Step::Malformed => {
                stats.counts.records += 1;
                stats.counts.malformed += 1;
            }
        }
    }
    let Some(packet) = bag.packet() else {
        return Ok(None);
    };
    let datagram = Datagram {
        arrival_ns: stats.note_time(Some(packet.stamp_ns)),
        source: packet.source,
        destination_port: DATA_PORT,
        payload: packet.payload,
    };
    Ok(Some(stats.place(datagram, Some(packet.topic))))
}

fn next_payload<'a>(
    payloads: &'a mut Payloads,
    stats: &mut CaptureStats,
) -> Result<Option<Placed<'a>>, CaptureError> {
    if !payloads.advance()? {
        return Ok(None);
    }
    let datagram = payloads.datagram();
    stats.note_time(Some(datagram.arrival_ns));
    Ok(Some(stats.place(datagram, None)))
}

#[cfg(test)]
mod tests;
#[cfg(test)]
mod testutil;
