//! What a client and the daemon say to each other on the control socket: a JSON document a line.
//!
//! ```text
//! client -> daemon   a Request; then anything, or the end of the connection, ends the recording
//! daemon -> client   Reply::Refused, or Reply::Settings where that was asked for, or Reply::Begun, Reply::Progress four times a second, and Reply::Ended
//! ```

use std::collections::BTreeMap;
use std::io;
use std::path::PathBuf;
use std::sync::atomic::Ordering;
use std::time::Duration;

use serde::{Deserialize, Serialize};
use tokio::net::UnixStream;

use crate::admission::{DiscoveredSensors, Refusal, RefusalCounts, Sender};
use crate::files::sequence::{Rotation, Written};
use crate::recording::RecordCounts;
use sweepd_core::segment::{self, SETTINGS, Setting};

/// Increased whenever a message changes.
pub const VERSION: u32 = 3;
/// Longest message, bytes: the summary of 64 senders takes 10 KB, a path at most 4 KB.
const MAX_LEN: usize = 64 << 10;

/// What a client wants to be recorded.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Request {
    /// [`VERSION`].
    pub version: u32,
    /// The sensor, by its name in the configuration.
    pub sensor: String,
    /// Only what these senders send, as [`SensorFilter`](crate::admission::SensorFilter) prints
    /// them; all if there are none.
    pub senders: Vec<String>,
    /// The file; absolute.
    pub path: PathBuf,
    /// Whether it takes the place of a file of this name.
    pub replaces: bool,
    /// When to begin another file.
    pub rotation: Rotation,
    /// When it ends where the client does not ask for the end; never, if there is none.
    pub duration: Option<Duration>,
}

impl Request {
    /// Reads a request.
    ///
    /// # Errors
    /// Why it is none, as a sentence.
    pub fn parse(line: &[u8]) -> Result<Self, String> {
        #[derive(Deserialize)]
        struct Versioned {
            version: u32,
        }
        match serde_json::from_slice(line) {
            Ok(Versioned { version: VERSION }) => {}
            Ok(Versioned { version }) => {
                return Err(format!(
                    "the daemon speaks version {VERSION} and this program version {version}: use the same release of sweepd"
                ));
            }
            Err(error) => return Err(format!("the daemon does not understand this: {error}")),
        }
        serde_json::from_slice(line)
            .map_err(|error| format!("the daemon does not understand this: {error}"))
    }
}

/// Asks what a sensor is segmented with; a document of its own, instead of a [`Request`].
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct SettingsRequest {
    /// [`VERSION`].
    pub version: u32,
    /// The sensor, by its name in the configuration.
    pub settings_of: String,
}

/// What a sensor is segmented with.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SegmentSettings {
    /// How ground is found: `slope` or `paper`.
    pub method: String,
    /// The numbers of [`SETTINGS`] by their keys, in the units of people; `None` where one is not set.
    pub settings: BTreeMap<String, Option<f64>>,
    /// `max_object_deg`; `None` from a daemon of before 0.4.
    #[serde(default)]
    pub max_object_deg: Option<f64>,
    /// Whether there is a mask, which is not told.
    pub masked: bool,
}

impl SegmentSettings {
    /// Those of a configuration.
    pub fn of(config: &segment::Config) -> Self {
        let number = |setting: &Setting| (setting.key.to_owned(), setting.get(config));
        Self {
            method: format!("{:?}", config.method).to_lowercase(),
            settings: SETTINGS.iter().map(number).collect(),
            max_object_deg: Some(f64::from(config.max_width_rad).to_degrees()),
            masked: config.mask.is_some(),
        }
    }
}

/// What the daemon answers.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum Reply {
    /// What a sensor is segmented with.
    Settings(SegmentSettings),
    /// Nothing is recorded: why, and what to do about it.
    Refused(String),
    /// What the sensor sends from now on is recorded, to this file first.
    Begun(PathBuf),
    /// How far it is.
    Progress(Progress),
    /// The recording has ended, and is on the disk.
    Ended(Ended),
}

/// How far a recording is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Progress {
    /// Datagrams that came.
    pub received: u64,
    /// Datagrams that the kernel dropped before.
    pub dropped: u64,
    /// Datagrams that found no room, since the disk was too slow or failed.
    pub unwritten: u64,
    /// Datagrams that were written.
    pub written: u64,
    /// Bytes of the files, uncompressed.
    pub bytes: u64,
}

impl Progress {
    /// What a recorder has counted. Nothing was dropped.
    pub fn of(counts: &RecordCounts) -> Self {
        Self {
            received: counts.offered.load(Ordering::Relaxed),
            dropped: 0,
            unwritten: counts.refused.load(Ordering::Relaxed),
            written: counts.written.load(Ordering::Relaxed),
            bytes: counts.bytes.load(Ordering::Relaxed),
        }
    }
}

/// What a recording came to.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Ended {
    /// What is in the files.
    pub written: Written,
    /// What came.
    pub received: Received,
    /// What ended it before its time, if that was no end of the daemon.
    pub error: Option<String>,
}

/// What came to a recording.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Received {
    /// Datagrams, of any kind.
    pub datagrams: u64,
    /// Datagrams that the kernel dropped before.
    pub dropped: u64,
    /// Where the data packets came from.
    pub senders: Vec<Sender>,
    /// Position packets.
    pub positions: u64,
    /// Datagrams that admission refused. Data packets of more senders than can be told apart are in
    /// the files all the same.
    pub refusals: RefusalCounts,
}

impl Received {
    /// What admission has counted of so many datagrams, of which others were dropped before.
    pub fn new(datagrams: u64, dropped: u64, admission: &DiscoveredSensors) -> Self {
        Self {
            datagrams,
            dropped,
            senders: admission.senders().to_vec(),
            positions: admission.positions(),
            refusals: admission.refusals(),
        }
    }

    /// Data packets of more senders than can be told apart.
    pub fn others(&self) -> u64 {
        self.refusals.get(Refusal::TooMany)
    }

    /// Datagrams that are not in the files since they were not wanted.
    pub fn refused(&self) -> u64 {
        self.refusals.total() - self.others()
    }
}

/// One end of a connection. What was received in part is kept, so that each wait can be given up.
#[derive(Debug)]
pub struct Connection {
    stream: UnixStream,
    received: Vec<u8>,
    unsent: Vec<u8>,
}

impl Connection {
    /// A connection of which nothing was read.
    pub fn new(stream: UnixStream) -> Self {
        Self {
            stream,
            received: Vec::new(),
            unsent: Vec::new(),
        }
    }

    /// Waits for a message; `None` at the end of the connection.
    ///
    /// # Errors
    /// What the system says; `InvalidData` where a message is longer than any.
    pub async fn receive(&mut self) -> io::Result<Option<Vec<u8>>> {
        loop {
            if let Some(end) = self.received.iter().position(|&byte| byte == b'\n') {
                let rest = self.received.split_off(end + 1);
                return Ok(Some(std::mem::replace(&mut self.received, rest)));
            }
            if self.received.len() > MAX_LEN {
                return Err(io::ErrorKind::InvalidData.into());
            }
            self.stream.readable().await?;
            let mut bytes = [0; 4096];
            match self.stream.try_read(&mut bytes) {
                Ok(0) => return Ok(None),
                Ok(count) => self.received.extend_from_slice(&bytes[..count]),
                Err(error) if error.kind() == io::ErrorKind::WouldBlock => {}
                Err(error) => return Err(error),
            }
        }
    }

    /// Sends a message, and waits until the other end's socket has room for it.
    ///
    /// # Errors
    /// What the system says.
    pub async fn send(&mut self, message: &impl Serialize) -> io::Result<()> {
        self.queue(message)?;
        while !self.unsent.is_empty() {
            self.stream.writable().await?;
            self.flush()?;
        }
        Ok(())
    }

    /// Sends a message if the other end takes it at once, or leaves it out.
    ///
    /// # Errors
    /// What the system says.
    pub fn send_if_ready(&mut self, message: &impl Serialize) -> io::Result<()> {
        if self.unsent.is_empty() {
            self.queue(message)?;
        }
        self.flush()
    }

    fn queue(&mut self, message: &impl Serialize) -> io::Result<()> {
        serde_json::to_writer(&mut self.unsent, message)?;
        self.unsent.push(b'\n');
        Ok(())
    }

    fn flush(&mut self) -> io::Result<()> {
        match self.stream.try_write(&self.unsent) {
            Ok(count) => {
                self.unsent.drain(..count);
                Ok(())
            }
            Err(error) if error.kind() == io::ErrorKind::WouldBlock => Ok(()),
            Err(error) => Err(error),
        }
    }
}
