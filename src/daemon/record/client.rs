//! The end of `sweepd record --from`, and of `sweepd view`, which asks for settings.

use std::io;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use tokio::net::UnixStream;
use tokio::runtime;
use tokio::time::timeout;

use super::protocol::{Connection, Reply, Request, SegmentSettings, SettingsRequest, VERSION};
use sweepd_client::host::{own_uid, user_name};

/// A daemon that sends nothing for longer does not answer.
const SILENCE: Duration = Duration::from_secs(5);

/// Why a daemon does not record.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum RemoteRecordError {
    /// No daemon is there.
    #[error(
        "no daemon listens at {} ({source}): is `sweepd run` running, and with the same --root? Where no daemon runs, leave \
         out --from",
        path.display()
    )]
    NoDaemon {
        /// The socket.
        path: PathBuf,
        /// What the system says.
        source: io::Error,
    },
    /// The daemon is of another user.
    #[error(
        "the daemon at {} runs as user {daemon} and this program as user {own}: it records for its own user alone. Run this \
         as {daemon} (`sudo -u {daemon} sweepd record ...`)",
        path.display()
    )]
    OtherUser {
        /// The socket.
        path: PathBuf,
        /// Whose the daemon is.
        daemon: String,
        /// Whose this program is.
        own: String,
    },
    /// The daemon refuses, or its recording has failed; it says why.
    #[error("{0}")]
    Daemon(String),
    /// What answers is no daemon, or a broken one.
    #[error("what listens at {} is no sweepd daemon: {what}", path.display())]
    Format {
        /// The socket.
        path: PathBuf,
        /// What is wrong with what came.
        what: String,
    },
    /// The daemon has gone without a word, or says nothing any more.
    #[error("the daemon at {} does not answer ({source}): has it been killed? What came before is kept", path.display())]
    Gone {
        /// The socket.
        path: PathBuf,
        /// What the system says.
        source: io::Error,
    },
}

/// What the daemon that listens at `socket` segments a sensor with. Waits for a second at most; for a
/// thread that runs no tasks.
///
/// # Errors
/// What the system says; `PermissionDenied` where the daemon is of another user, `InvalidData` where
/// it does not say it.
pub fn segment_settings(socket: &Path, sensor: &str) -> io::Result<SegmentSettings> {
    let runtime = runtime::Builder::new_current_thread()
        .enable_all()
        .build()?;
    runtime
        .block_on(async { timeout(Duration::from_secs(1), ask_settings(socket, sensor)).await })?
}

async fn ask_settings(socket: &Path, sensor: &str) -> io::Result<SegmentSettings> {
    let stream = UnixStream::connect(socket).await?;
    if stream.peer_cred()?.uid() != own_uid() {
        return Err(io::ErrorKind::PermissionDenied.into());
    }
    let mut connection = Connection::new(stream);
    let request = SettingsRequest {
        version: VERSION,
        settings_of: sensor.to_owned(),
    };
    connection.send(&request).await?;
    let line = connection.receive().await?;
    match serde_json::from_slice(&line.unwrap_or_default())? {
        Reply::Settings(settings) => Ok(settings),
        _ => Err(io::ErrorKind::InvalidData.into()),
    }
}

/// A connection to a daemon that records for this program. When it is dropped, the recording ends.
#[derive(Debug)]
pub struct RemoteRecording {
    socket: PathBuf,
    connection: Connection,
    /// When the daemon said something last.
    heard: Instant,
}

impl RemoteRecording {
    /// Has the daemon that listens at `socket` begin a recording; gives its first file. What the
    /// sensor sends from now on is recorded.
    ///
    /// # Errors
    /// [`RemoteRecordError`]: no daemon, one of another user, or one that refuses.
    pub async fn begin(
        socket: &Path,
        request: &Request,
    ) -> Result<(Self, PathBuf), RemoteRecordError> {
        let stream = UnixStream::connect(socket)
            .await
            .map_err(|source| no_answer(socket, source))?;
        let gone = |source| gone(socket, source);
        let own = own_uid();
        let daemon = stream.peer_cred().map_err(gone)?.uid();
        if own != daemon {
            return Err(other_user(socket, daemon));
        }
        let mut recording = Self {
            socket: socket.to_owned(),
            connection: Connection::new(stream),
            heard: Instant::now(),
        };
        // A daemon that refuses at once may have closed its end before it took the request; its
        // answer is there nevertheless, and where it is not, `next` fails.
        let _ = timeout(SILENCE, recording.connection.send(request)).await;
        match recording.next(SILENCE).await? {
            Some(Reply::Begun(path)) => Ok((recording, path)),
            Some(Reply::Refused(why)) => Err(RemoteRecordError::Daemon(why)),
            Some(_) => Err(recording.unexpected()),
            None => Err(gone(io::ErrorKind::TimedOut.into())),
        }
    }

    /// What the daemon says next, if it does so in this time.
    ///
    /// # Errors
    /// [`RemoteRecordError::Gone`] and [`RemoteRecordError::Format`].
    pub async fn next(&mut self, patience: Duration) -> Result<Option<Reply>, RemoteRecordError> {
        let received = match timeout(patience, self.connection.receive()).await {
            Err(_) if self.heard.elapsed() > SILENCE => Err(io::ErrorKind::TimedOut.into()),
            Err(_) => return Ok(None),
            Ok(Ok(None)) => Err(io::ErrorKind::UnexpectedEof.into()),
            Ok(Ok(Some(line))) => Ok(line),
            Ok(Err(error)) => Err(error),
        };
        let line = received.map_err(|source| gone(&self.socket, source))?;
        self.heard = Instant::now();
        serde_json::from_slice(&line)
            .map(Some)
            .map_err(|error| self.format(&error.to_string()))
    }

    /// Asks for the end; what came before is written, and [`Reply::Ended`] says what is there.
    pub async fn end(&mut self) {
        // Where the daemon is gone, `next` says so.
        let _ = timeout(SILENCE, self.connection.send(&"end")).await;
    }

    /// The error of a daemon that says something out of turn.
    pub fn unexpected(&self) -> RemoteRecordError {
        self.format("it answers out of turn")
    }

    fn format(&self, what: &str) -> RemoteRecordError {
        RemoteRecordError::Format {
            path: self.socket.clone(),
            what: what.to_owned(),
        }
    }
}

fn gone(path: &Path, source: io::Error) -> RemoteRecordError {
    RemoteRecordError::Gone {
        path: path.to_owned(),
        source,
    }
}

/// Why there is no answer: no daemon, or one of another user, who alone may open its socket.
fn no_answer(path: &Path, source: io::Error) -> RemoteRecordError {
    // Of a folder that is closed to this user, its owner.
    let owner = path
        .ancestors()
        .find_map(|path| path.metadata().ok())
        .map(|found| found.uid());
    match owner {
        Some(owner) if source.kind() == io::ErrorKind::PermissionDenied && owner != own_uid() => {
            other_user(path, owner)
        }
        _ => RemoteRecordError::NoDaemon {
            path: path.to_owned(),
            source,
        },
    }
}

fn other_user(path: &Path, daemon: u32) -> RemoteRecordError {
    RemoteRecordError::OtherUser {
        path: path.to_owned(),
        daemon: user_name(daemon),
        own: user_name(own_uid()),
    }
}
