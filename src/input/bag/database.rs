//! The databases of rosbag2, as the program of [`crate::input::db3`] sends them. It is killed when
//! it is silent for too long, and when its database is no longer read.

use std::io::{BufReader, ErrorKind, Read};
use std::os::fd::OwnedFd;
use std::os::unix::net::UnixStream;
use std::path::Path;
use std::process::{Child, Command, ExitStatus, Stdio};
use std::time::{Duration, Instant};
use std::{io, thread};

use super::scan::Encoding;
use super::{Log, MAX_TOPICS, Message, Topics};
use crate::input::db3::{End, Frame, HEAD, PROGRAM, Reader, no_frame};
use crate::input::error::{CaptureError, Damage, Place, Stop};
use crate::tool;

/// Most topics that are sent: those with scans, and as many others.
const MAX_SENT_TOPICS: usize = 2 * MAX_TOPICS;
/// What is read of the program's complaint.
const MAX_COMPLAINT_LEN: u64 = 4096;
/// How long a program that has closed its output may take to end.
const DYING: Duration = Duration::from_secs(1);
const POLL: Duration = Duration::from_millis(2);
/// Longest text of the program in a message.
const MAX_TEXT_CHARS: usize = 500;

/// A database that a program reads.
pub(super) struct Database {
    frames: Frames<BufReader<UnixStream>>,
    process: Process,
    patience: Duration,
}

impl Database {
    /// Starts the program that reads it.
    pub(super) fn open(path: &Path, reader: &Reader) -> Result<Self, CaptureError> {
        let name = path.display().to_string();
        let program = reader.program.clone().or_else(|| tool::find(PROGRAM));
        let Some(program) = program else {
            let missing = tool::missing(PROGRAM);
            return Err(CaptureError::NoReader { name, missing });
        };
        let started = Process::start(&program, path, reader.patience);
        let (process, output) = started.map_err(|error| CaptureError::Open {
            name,
            source: io::Error::other(format!("cannot start {}: {error}", program.display())),
        })?;
        Ok(Self {
            frames: Frames::new(BufReader::with_capacity(64 << 10, output)),
            process,
            patience: reader.patience,
        })
    }

    /// Says what an error of the program's output means.
    fn explain(&mut self, error: io::Error) -> io::Error {
        let what = match error.kind() {
            ErrorKind::WouldBlock | ErrorKind::TimedOut => {
                self.process.kill();
                format!(
                    "{PROGRAM} gave nothing for {} s and was ended; if the file is sound, `ros2 bag convert` turns it into MCAP",
                    self.patience.as_secs_f64()
                )
            }
            ErrorKind::UnexpectedEof => match self.process.ended() {
                Some((status, complaint)) => {
                    format!("{PROGRAM} ended before its time ({status}){complaint}")
                }
                None => format!("{PROGRAM} ended before its time"),
            },
            ErrorKind::InvalidData => {
                self.process.kill();
                format!(
                    "{} sends {error}; is it {PROGRAM} of sweepd {}?",
                    self.process.program,
                    env!("CARGO_PKG_VERSION")
                )
            }
            _ => return error,
        };
        io::Error::other(what)
    }
}

impl Log for Database {
    fn next(&mut self, topics: &mut Topics) -> Result<Option<Message>, Stop> {
        match self.frames.next(topics) {
            Err(Stop::Read(error)) => Err(Stop::Read(self.explain(error))),
            other => other,
        }
    }

    fn place(&self) -> Place {
        Place::Message(self.frames.place)
    }
}

/// The program, killed and waited for when it is dropped.
struct Process {
    child: Child,
    program: String,
    /// Its standard error.
    complaint: UnixStream,
}

impl Process {
    /// Starts it, and gives its output, of which a read fails after `patience`. Sockets in place of
    /// pipes can do that.
    fn start(program: &Path, path: &Path, patience: Duration) -> io::Result<(Self, UnixStream)> {
        let (output, its_output) = UnixStream::pair()?;
        let (complaint, its_complaint) = UnixStream::pair()?;
        output.set_read_timeout(Some(patience))?;
        complaint.set_nonblocking(true)?;
        let child = Command::new(program)
            .arg("--")
            .arg(path)
            .stdin(Stdio::null())
            .stdout(OwnedFd::from(its_output))
            .stderr(OwnedFd::from(its_complaint))
            .spawn()?;
        let process = Self {
            child,
            program: program.display().to_string(),
            complaint,
        };
        Ok((process, output))
    }

    /// Gives how it ended, and the first line of its complaint. What has closed its output and does
    /// not end is killed.
    fn ended(&mut self) -> Option<(ExitStatus, String)> {
        let begun = Instant::now();
        while begun.elapsed() < DYING && matches!(self.child.try_wait(), Ok(None)) {
            thread::sleep(POLL);
        }
        self.kill();
        // Asked again, it gives the same.
        let status = self.child.wait().ok()?;
        let mut complaint = Vec::new();
        // It ends with an error where a process that was left behind holds the other end.
        let _ = (&self.complaint)
            .take(MAX_COMPLAINT_LEN)
            .read_to_end(&mut complaint);
        let complaint = String::from_utf8_lossy(&complaint);
        let line = complaint.lines().find(|line| !line.trim().is_empty());
        let line = line.map_or_else(String::new, |line| format!(": {}", shown(line)));
        Some((status, line))
    }

    /// Kills it, and waits for it.
    fn kill(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        self.kill();
    }
}

/// A text of the program as it may be shown: short, and without control characters.
fn shown(text: &str) -> String {
    text.chars()
        .take(MAX_TEXT_CHARS)
        .map(|one| if one.is_control() { ' ' } else { one })
        .collect()
}

/// The frames of a database, of which any may be a lie.
struct Frames<S> {
    source: S,
    has_begun: bool,
    /// The index and encoding of each topic that was sent; `None` if it has no scans.
    topics: Vec<Option<(usize, Option<Encoding>)>>,
    /// Numbers of the last message and the last progress.
    last: Option<i64>,
    passed: Option<i64>,
    place: i64,
}

impl<S: Read> Frames<S> {
    fn new(source: S) -> Self {
        Self {
            source,
            has_begun: false,
            topics: Vec::new(),
            last: None,
            passed: None,
            place: 1,
        }
    }

    fn next(&mut self, topics: &mut Topics) -> Result<Option<Message>, Stop> {
        self.begin().map_err(Stop::Read)?;
        loop {
            match Frame::read(&mut self.source).map_err(Stop::Read)? {
                Frame::Topic { name, kind, format } => {
                    if self.topics.len() == MAX_SENT_TOPICS || self.last.is_some() {
                        return refused("a topic too many");
                    }
                    let index = topics.add(&name, &kind, None)?;
                    let topic = index.map(|index| (index, Encoding::named(&format)));
                    self.topics.push(topic);
                }
                Frame::Message {
                    topic,
                    number,
                    logged_ns,
                    bytes,
                } => {
                    let topic = self.topics.get(topic as usize).copied().flatten();
                    let Some((topic, encoding)) = topic else {
                        return refused("a message of no topic");
                    };
                    if self.last.replace(number) >= Some(number) {
                        return refused("messages in disorder");
                    }
                    self.place = number.saturating_add(1).max(1);
                    return Ok(Some(Message {
                        topic,
                        encoding,
                        logged_ns,
                        bytes: bytes.into_owned(),
                    }));
                }
                Frame::Progress { number } => {
                    if self.passed.replace(number) >= Some(number) {
                        return refused("progress in disorder");
                    }
                }
                Frame::End { end, number } => {
                    self.place = number;
                    return match end {
                        End::Whole => Ok(None),
                        End::Cut => Err(Damage::Cut.into()),
                        End::Damaged(message) => Err(Damage::Database {
                            message: shown(&message),
                        }
                        .into()),
                        End::Refused(message) => Err(Damage::Refused {
                            message: shown(&message),
                        }
                        .into()),
                        End::Failed(message) => Err(Stop::Read(io::Error::other(shown(&message)))),
                    };
                }
            }
        }
    }

    /// Reads the first bytes, once.
    fn begin(&mut self) -> io::Result<()> {
        if self.has_begun {
            return Ok(());
        }
        self.has_begun = true;
        let mut head = [0; HEAD.len()];
        self.source.read_exact(&mut head)?;
        if head != *HEAD {
            let found = String::from_utf8_lossy(&head);
            return Err(no_frame(format!("`{}`", shown(&found))));
        }
        Ok(())
    }
}

/// The error for frames that contradict each other.
fn refused<T>(found: &str) -> Result<T, Stop> {
    Err(Stop::Read(no_frame(found.to_owned())))
}

#[cfg(test)]
mod tests {
    use std::fs;
    use std::path::PathBuf;

    use proptest::prelude::*;
    use tempfile::TempDir;

    use super::*;
    use crate::input::db3::MAX_MESSAGE_LEN;

    const SCAN: &str = "velodyne_msgs/msg/VelodyneScan";

    fn topic(name: &str, kind: &str) -> Frame<'static> {
        Frame::Topic {
            name: name.to_owned().into(),
            kind: kind.to_owned().into(),
            format: "cdr".into(),
        }
    }

    fn message(topic: u32, number: i64, len: usize) -> Frame<'static> {
        Frame::Message {
            topic,
            number,
            logged_ns: 0,
            bytes: vec![7; len].into(),
        }
    }

    fn end(end: End, number: i64) -> Frame<'static> {
        Frame::End { end, number }
    }

    fn stream(frames: &[Frame<'_>]) -> Vec<u8> {
        let mut bytes = HEAD.to_vec();
        for frame in frames {
            frame.write(&mut bytes).unwrap();
        }
        bytes
    }

    /// The lengths of all messages, how they ended, and the place.
    fn all(source: &[u8]) -> (Vec<usize>, Result<(), String>, i64) {
        let mut frames = Frames::new(source);
        let mut topics = Topics::default();
        let mut lens = Vec::new();
        let end = loop {
            match frames.next(&mut topics) {
                Ok(Some(message)) => {
                    assert!(message.topic < topics.scans.len());
                    lens.push(message.bytes.len());
                }
                Ok(None) => break Ok(()),
                Err(Stop::Damaged(damage)) => break Err(damage.to_string()),
                Err(Stop::Read(error)) => break Err(error.to_string()),
            }
        };
        (lens, end, frames.place)
    }

    #[test]
    fn messages_of_topics_with_scans_are_given_up_to_the_end() {
        let frames = |last: End| {
            stream(&[
                topic("/chatter", "std_msgs/msg/String"),
                topic("/left", SCAN),
                topic("/right", SCAN),
                message(1, 4, 100),
                Frame::Progress { number: 2000 },
                message(2, 5000, 0),
                end(last, 5001),
            ])
        };
        for (last, says) in [
            (End::Whole, Ok(())),
            (End::Cut, Err("the file ends inside it")),
            (End::Damaged("no".to_owned()), Err("SQLite says: no")),
            (End::Refused("a\nb\x1b[1m".to_owned()), Err("a b [1m")),
            (End::Failed("full".to_owned()), Err("full")),
        ] {
            let says = says.map_err(str::to_owned);
            assert_eq!(all(&frames(last)), (vec![100, 0], says, 5001));
        }
        // Where there is no end, the place is behind what was read.
        let whole = frames(End::Whole);
        let (lens, end, place) = all(&whole[..whole.len() - 1]);
        assert_eq!((lens, end.is_err(), place), (vec![100, 0], true, 5001));
    }

    #[test]
    fn what_contradicts_itself_is_refused() {
        let scans = topic("/left", SCAN);
        let others: Vec<_> = (0..=MAX_SENT_TOPICS)
            .map(|n| topic(&format!("/{n}"), "other"))
            .collect();
        let longest = MAX_MESSAGE_LEN as u32;
        for (bytes, says) in [
            (stream(&others), "a topic too many"),
            (
                stream(&[scans.clone(), message(0, 1, 1), scans.clone()]),
                "a topic too many",
            ),
            (
                stream(&[scans.clone(), message(1, 1, 1)]),
                "a message of no topic",
            ),
            (
                stream(&[topic("/left", "other"), message(0, 1, 1)]),
                "a message of no topic",
            ),
            (
                stream(&[scans.clone(), message(0, 2, 1), message(0, 2, 1)]),
                "messages in disorder",
            ),
            (
                stream(&[Frame::Progress { number: 2 }, Frame::Progress { number: 1 }]),
                "progress in disorder",
            ),
            (b"sweepd-db3 1\n".to_vec(), "`sweepd-db3 1 `"),
            ([&stream(&[])[..], b"X"].concat(), "a frame of kind 0x58"),
            (
                [&stream(&[])[..], b"T\xFF\xFF\xFF\xFF"].concat(),
                "a length of 4294967295 bytes",
            ),
            (
                [&stream(&[])[..], b"T", &(longest + 1).to_le_bytes()].concat(),
                "a length of 16777217 bytes",
            ),
            (
                [&stream(&[])[..], b"T\x01\0\0\0\xFF"].concat(),
                "a text that is not UTF-8",
            ),
            (
                [&stream(&[])[..], b"E\x09", &[0; 12]].concat(),
                "an end of kind 9",
            ),
        ] {
            assert_eq!(all(&bytes).1, Err(says.to_owned()));
        }
        let scans: Vec<_> = (0..=MAX_TOPICS)
            .map(|n| topic(&format!("/{n}"), SCAN))
            .collect();
        let says = "it has more than 1024 topics with packets";
        assert_eq!(all(&stream(&scans)).1, Err(says.to_owned()));
    }

    /// A message as long as may be is read; one that is longer is not written.
    #[test]
    fn the_longest_message_fits() {
        let frames = |len: usize| [topic("/left", SCAN), message(0, 1, len), end(End::Whole, 2)];
        let longest = MAX_MESSAGE_LEN as usize;
        assert_eq!(all(&stream(&frames(longest))), (vec![longest], Ok(()), 2));
        let [_, longer, _] = frames(longest + 1);
        let error = longer.write(&mut io::sink()).unwrap_err();
        assert_eq!(error.kind(), ErrorKind::InvalidInput);
    }

    proptest! {
        /// Any bytes end in an error or at an end, after no more than is in them.
        #[test]
        fn any_bytes_come_to_an_end(
            pieces in prop::collection::vec((0_usize..7, any::<[u8; 12]>()), 0..30),
        ) {
            let mut bytes = stream(&[topic("/left", SCAN)]);
            for (kind, random) in pieces {
                match kind {
                    0 => bytes.extend(&random[..usize::from(random[0] % 12)]),
                    1 => bytes.extend([b"T", &random[..]].concat()),
                    2 => bytes.extend([b"E", &random[..]].concat()),
                    3 => Frame::Progress { number: random[0].into() }.write(&mut bytes).unwrap(),
                    _ => message(u32::from(random[0] % 2), random[1].into(), random[2].into())
                        .write(&mut bytes)
                        .unwrap(),
                }
            }
            let (lens, _, _) = all(&bytes);
            prop_assert!(lens.iter().sum::<usize>() <= bytes.len());
        }
    }

    /// A file that `cat` sends as a program would its frames.
    fn sent(bytes: &[u8]) -> (TempDir, PathBuf) {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("frames");
        fs::write(&path, bytes).unwrap();
        (folder, path)
    }

    fn open(program: &str, path: &Path, patience: Duration) -> Database {
        let reader = Reader {
            program: Some(program.into()),
            patience,
        };
        Database::open(path, &reader).unwrap()
    }

    /// All messages, and why no more come.
    fn read(database: &mut Database) -> (usize, String) {
        let mut topics = Topics::default();
        let mut messages = 0;
        loop {
            match database.next(&mut topics) {
                Ok(Some(_)) => messages += 1,
                Ok(None) => return (messages, String::new()),
                Err(Stop::Damaged(damage)) => return (messages, damage.to_string()),
                Err(Stop::Read(error)) => return (messages, error.to_string()),
            }
        }
    }

    const PATIENT: Duration = Duration::from_secs(60);

    #[test]
    fn a_program_that_ends_early_or_sends_something_else_is_named() {
        let whole = stream(&[topic("/left", SCAN), message(0, 1, 5)]);
        let (_folder, path) = sent(&whole);
        let mut database = open("cat", &path, PATIENT);
        let ended = "sweepd-db3 ended before its time (exit status: 0)".to_owned();
        assert_eq!(read(&mut database), (1, ended));
        assert_eq!(database.place(), Place::Message(2));
        // It complains.
        let (messages, says) = read(&mut open("cat", Path::new("/no/such/file"), PATIENT));
        let complaint = "sweepd-db3 ended before its time (exit status: 1): cat: /no/such/file: ";
        assert!(
            messages == 0 && says.starts_with(complaint) && !says.contains('\n'),
            "{says}"
        );
        // It sends something else.
        let (_folder, path) = sent(b"[package]\nname = \"sweepd\"\n");
        let (_, says) = read(&mut open("cat", &path, PATIENT));
        let version = env!("CARGO_PKG_VERSION");
        assert_eq!(
            says,
            format!("cat sends `[package] nam`; is it sweepd-db3 of sweepd {version}?")
        );
        // It is no program.
        let reader = Reader {
            program: Some(path.clone()),
            patience: PATIENT,
        };
        let error = Database::open(&path, &reader).err().unwrap().to_string();
        assert!(error.contains(": cannot start /"), "{error}");
    }

    #[test]
    fn a_program_that_is_silent_is_killed_but_not_while_nobody_reads() {
        let patience = Duration::from_secs(1);
        // More than a socket holds, so that it waits for its reader.
        let frames: Vec<_> = (1..3).map(|number| message(0, number, 1 << 20)).collect();
        let all = [&[topic("/left", SCAN)], &frames[..], &[end(End::Whole, 3)]].concat();
        let (_folder, path) = sent(&stream(&all));
        let mut database = open("cat", &path, patience);
        let mut topics = Topics::default();
        for _ in 1..3 {
            assert!(database.next(&mut topics).unwrap().is_some());
            thread::sleep(patience + patience / 2);
        }
        assert!(database.next(&mut topics).unwrap().is_none());

        // A pipe that nobody writes.
        let fifo = path.with_file_name("fifo");
        let made = Command::new("mkfifo").arg(&fifo).status().unwrap();
        assert!(made.success());
        let mut database = open("cat", &fifo, patience);
        let says = "sweepd-db3 gave nothing for 1 s and was ended; if the file is sound, `ros2 bag convert` turns it into MCAP".to_owned();
        assert_eq!(read(&mut database), (0, says));
        assert!(database.process.child.try_wait().unwrap().is_some());
        assert_eq!(database.place(), Place::Message(1));
    }
}
