//! The end of a tap that records.

use std::io::{self, Write};
use std::net::Shutdown;
use std::os::unix::fs::MetadataExt;
use std::os::unix::net::UnixStream;
use std::path::{Path, PathBuf};
use std::time::Duration;

use super::wire::{self, Answer, Frame, Frames, Status, VERSION};
use super::{TapError, sys};
use crate::capture::write::Addressed;
use sweepd_client::host::{own_uid, user_name};

/// How long a daemon may take to answer: it does so at once, where its thread gets a core.
const ANSWER_TIME: Duration = Duration::from_secs(5);

/// The datagrams of a sensor of a running daemon.
#[derive(Debug)]
pub struct TapStream {
    path: PathBuf,
    stream: UnixStream,
    frames: Frames,
    /// What the daemon told at the end.
    lost: Option<u64>,
}

impl TapStream {
    /// Asks the daemon that listens at `path` for the datagrams of a sensor. Those that it receives
    /// from now on will come.
    ///
    /// # Errors
    /// [`TapError`]: no daemon, one of another user or release, no such sensor.
    pub fn connect(path: &Path, sensor: &str) -> Result<Self, TapError> {
        let mut stream = UnixStream::connect(path).map_err(|source| unreachable(path, source))?;
        let gone = |source| gone(path, source);
        let (own, daemon) = (own_uid(), sys::peer_uid(&stream).map_err(gone)?);
        if own != daemon {
            return Err(other_user(path, user_name(daemon)));
        }
        stream.set_read_timeout(Some(ANSWER_TIME)).map_err(gone)?;
        stream.set_write_timeout(Some(ANSWER_TIME)).map_err(gone)?;
        // A daemon that refuses may have hung up before; its answer says more than this error.
        let _ = stream.write_all(&wire::hello(sensor));
        let answer = Answer::read(&mut stream).map_err(gone)?;
        let answer = answer.map_err(|error| TapError::Format {
            path: path.to_owned(),
            what: error.to_string(),
        })?;
        match answer.status {
            Status::Granted if answer.version == VERSION => {}
            Status::Granted | Status::OtherVersion => {
                return Err(TapError::Version {
                    daemon: answer.version,
                    own: VERSION,
                });
            }
            Status::UnknownSensor => {
                let names = Some(answer.text)
                    .filter(|names| !names.is_empty())
                    .unwrap_or("none".to_owned());
                return Err(TapError::UnknownSensor {
                    name: sensor.to_owned(),
                    names,
                });
            }
            Status::Busy => return Err(TapError::Busy),
            Status::OtherUser => return Err(other_user(path, answer.text)),
        }
        Ok(Self {
            path: path.to_owned(),
            stream,
            frames: Frames::new(),
            lost: None,
        })
    }

    /// Waits for datagrams, at most `timeout` (at least a millisecond), and hands `each` of those
    /// that are there on, those of one port in order. Gives how many there were; none after the
    /// timeout, after a signal, and after [the end](Self::lost).
    ///
    /// # Errors
    /// [`TapError::Gone`] and [`TapError::Format`]; what came before has been handed on.
    pub fn receive(
        &mut self,
        timeout: Duration,
        mut each: impl FnMut(&Addressed<'_>),
    ) -> Result<u64, TapError> {
        if self.lost.is_some() {
            return Ok(0);
        }
        let gone = |source| gone(&self.path, source);
        self.stream
            .set_read_timeout(Some(timeout.max(Duration::from_millis(1))))
            .map_err(gone)?;
        match self.frames.read(&mut self.stream) {
            Ok(0) => return Err(gone(io::ErrorKind::UnexpectedEof.into())),
            Ok(_) => {}
            Err(error) if is_nothing(&error) => return Ok(0),
            Err(error) => return Err(gone(error)),
        }
        let mut count = 0;
        loop {
            match self.frames.next() {
                Ok(Some(Frame::Datagram(datagram))) => {
                    each(&datagram);
                    count += 1;
                }
                Ok(Some(Frame::End { lost })) => {
                    self.lost = Some(lost);
                    return Ok(count);
                }
                Ok(None) => return Ok(count),
                Err(error) => {
                    return Err(TapError::Format {
                        path: self.path.clone(),
                        what: error.to_string(),
                    });
                }
            }
        }
    }

    /// Asks for the end: what the daemon has received before will still come, and then [the
    /// end](Self::lost).
    pub fn stop(&self) {
        // Who is gone need not be asked, and `receive` tells.
        let _ = self.stream.shutdown(Shutdown::Write);
    }

    /// The error of a daemon that was asked for the end and does not come to it.
    pub fn silent(&self) -> TapError {
        gone(&self.path, io::ErrorKind::TimedOut.into())
    }

    /// How many datagrams found no room on the way, once the end has come: asked for, or because
    /// the daemon ends.
    pub fn lost(&self) -> Option<u64> {
        self.lost
    }
}

/// A daemon that hung up, or that says nothing for too long.
fn gone(path: &Path, source: io::Error) -> TapError {
    let source = if is_nothing(&source) {
        io::ErrorKind::TimedOut.into()
    } else {
        source
    };
    TapError::Gone {
        path: path.to_owned(),
        source,
    }
}

fn is_nothing(error: &io::Error) -> bool {
    matches!(
        error.kind(),
        io::ErrorKind::WouldBlock | io::ErrorKind::TimedOut | io::ErrorKind::Interrupted
    )
}

/// Why there is no answer: no daemon, or one of another user, who alone may open its socket.
fn unreachable(path: &Path, source: io::Error) -> TapError {
    // Of a folder that is closed to this user, its owner.
    let owner = path
        .ancestors()
        .find_map(|path| path.metadata().ok())
        .map(|found| found.uid());
    match owner {
        Some(owner) if source.kind() == io::ErrorKind::PermissionDenied && owner != own_uid() => {
            other_user(path, user_name(owner))
        }
        _ => TapError::NoDaemon {
            path: path.to_owned(),
            source,
        },
    }
}

fn other_user(path: &Path, daemon: String) -> TapError {
    TapError::OtherUser {
        path: path.to_owned(),
        daemon,
        own: user_name(own_uid()),
    }
}
