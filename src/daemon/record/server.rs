//! The control socket: `sweepd record --from` asks for recordings here, `sweepd view` for settings. Only the daemon's own user
//! may open it. It is served on the control thread, which waits for no client: at most
//! [`MAX_ON_DEMAND`] at a time, messages of bounded length, and what a client does not take is left
//! out.

use std::collections::BTreeMap;
use std::fs;
use std::io;
use std::os::unix::fs::{FileTypeExt, MetadataExt, PermissionsExt};
use std::os::unix::net;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use tokio::net::{UnixListener, UnixStream};
use tokio::sync::Semaphore;
use tokio::sync::mpsc::UnboundedSender;
use tokio::task::JoinHandle;
use tokio::time::{MissedTickBehavior, interval, sleep, timeout};

use super::protocol::{Connection, Reply, Request, SegmentSettings, SettingsRequest};
use super::recording::Client;
use super::{Event, MAX_ON_DEMAND, too_many};
use sweepd_client::host::{own_uid, user_name};

/// How long a client may take to say what it wants, and to read what its recording came to.
const PATIENCE: Duration = Duration::from_secs(2);
/// How often a client is told how far its recording is.
const PROGRESS_EVERY: Duration = Duration::from_millis(250);
/// How long clients are waited for at the end of the daemon, which itself must end soon.
const FAREWELL_TIME: Duration = Duration::from_millis(50);
/// How often to look whether the socket was deleted, and to try again to accept a client.
const LOOK_EVERY: Duration = Duration::from_secs(1);

/// Why the daemon cannot be asked for recordings.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum SocketError {
    /// Another daemon listens there.
    #[error("another daemon listens at {}; stop it, or give this one a --root of its own", path.display())]
    Taken {
        /// The socket.
        path: PathBuf,
    },
    /// The socket cannot be made.
    #[error("cannot listen at {}: {source}; the folder must be this daemon's own, and its path short", path.display())]
    Listen {
        /// The socket.
        path: PathBuf,
        /// What the system says.
        source: io::Error,
    },
}

/// What each sensor is segmented with, by its name.
pub type Told = Arc<Mutex<BTreeMap<String, SegmentSettings>>>;

/// The server of the control socket.
#[derive(Debug)]
pub struct ControlServer {
    task: JoinHandle<()>,
    /// Of the clients that may be served at a time, those that may still come.
    places: Arc<Semaphore>,
}

impl ControlServer {
    /// Listens, and serves clients from a task of the running tokio runtime; what they ask for
    /// comes as events. A socket that a daemon left behind is replaced.
    ///
    /// # Errors
    /// [`SocketError`].
    pub fn start(
        path: &Path,
        events: UnboundedSender<Event>,
        told: Told,
    ) -> Result<Self, SocketError> {
        let mut socket = Socket::listen(path)?;
        let places = Arc::new(Semaphore::new(MAX_ON_DEMAND));
        let free = Arc::clone(&places);
        let task = tokio::spawn(async move {
            loop {
                match timeout(LOOK_EVERY, socket.listener.accept()).await {
                    Ok(Ok((stream, _))) => admit(stream, &free, &events, &told),
                    // Out of file descriptors, most likely: they come back.
                    Ok(Err(_)) => sleep(LOOK_EVERY).await,
                    Err(_) => socket.restore(),
                }
            }
        });
        Ok(Self { task, places })
    }

    /// Accepts no more clients, and waits until all know what their recordings came to; not for
    /// long.
    pub async fn finish(self) {
        self.task.abort();
        let all = self.places.acquire_many(MAX_ON_DEMAND as u32);
        let _ = timeout(FAREWELL_TIME, all).await;
    }
}

/// Has a client served, if it may be.
fn admit(
    stream: UnixStream,
    places: &Arc<Semaphore>,
    events: &UnboundedSender<Event>,
    told: &Told,
) {
    let own = own_uid();
    let is_own = stream.peer_cred().is_ok_and(|peer| peer.uid() == own);
    let refusal = match Arc::clone(places).try_acquire_owned() {
        _ if !is_own => format!(
            "the daemon records for its own user alone: {}",
            user_name(own)
        ),
        Err(_) => too_many(),
        Ok(place) => {
            let (events, told) = (events.clone(), Arc::clone(told));
            tokio::spawn(async move {
                // A client that breaks off is no news: its recording has ended.
                let _ = converse(Connection::new(stream), &events, &told).await;
                drop(place);
            });
            return;
        }
    };
    let _ = Connection::new(stream).send_if_ready(&Reply::Refused(refusal));
}

/// The socket in the file system.
#[derive(Debug)]
struct Socket {
    path: PathBuf,
    listener: UnixListener,
    inode: u64,
}

impl Socket {
    fn listen(path: &Path) -> Result<Self, SocketError> {
        if net::UnixStream::connect(path).is_ok() {
            return Err(SocketError::Taken {
                path: path.to_owned(),
            });
        }
        let (listener, inode) = bind(path).map_err(|source| SocketError::Listen {
            path: path.to_owned(),
            source,
        })?;
        Ok(Self {
            path: path.to_owned(),
            listener,
            inode,
        })
    }

    /// Listens again if the socket was deleted.
    fn restore(&mut self) {
        let found = self.path.symlink_metadata();
        // Where the folder is gone too it is tried again later.
        if found.is_err_and(|error| error.kind() == io::ErrorKind::NotFound)
            && let Ok((listener, inode)) = bind(&self.path)
        {
            self.listener = listener;
            self.inode = inode;
        }
    }
}

impl Drop for Socket {
    fn drop(&mut self) {
        let found = self.path.symlink_metadata();
        // Another daemon may have put its own there.
        if found.is_ok_and(|found| found.ino() == self.inode) {
            let _ = fs::remove_file(&self.path);
        }
    }
}

/// Listens, on a socket that only this user may open from the first moment on: it gets its name
/// when it is ready, and replaces one that was left behind.
fn bind(path: &Path) -> io::Result<(UnixListener, u64)> {
    let found = path.symlink_metadata();
    if found.is_ok_and(|found| !found.file_type().is_socket()) {
        return Err(io::Error::new(
            io::ErrorKind::AlreadyExists,
            "something else is there",
        ));
    }
    // Always the same name: a daemon that was killed here may have left it.
    let unready = path.with_extension("unready");
    let _ = fs::remove_file(&unready);
    let listener = net::UnixListener::bind(&unready)?;
    let prepared = prepare(listener, &unready);
    let named = prepared.and_then(|ready| fs::rename(&unready, path).map(|()| ready));
    if named.is_err() {
        let _ = fs::remove_file(&unready);
    }
    named
}

fn prepare(listener: net::UnixListener, path: &Path) -> io::Result<(UnixListener, u64)> {
    fs::set_permissions(path, fs::Permissions::from_mode(0o600))?;
    listener.set_nonblocking(true)?;
    let inode = path.symlink_metadata()?.ino();
    Ok((UnixListener::from_std(listener)?, inode))
}

/// The settings of a sensor.
fn settings_reply(sensor: &str, told: &Told) -> Reply {
    let told = told.lock().unwrap_or_else(PoisonError::into_inner);
    match told.get(sensor) {
        Some(settings) => Reply::Settings(settings.clone()),
        None => Reply::Refused(format!("no sensor is called {sensor}")),
    }
}

/// Serves one client: its request, the progress of its recording, and the end.
async fn converse(
    mut connection: Connection,
    events: &UnboundedSender<Event>,
    told: &Told,
) -> io::Result<()> {
    let line = match timeout(PATIENCE, connection.receive()).await {
        Ok(Ok(Some(line))) => line,
        _ => return Ok(()),
    };
    if let Ok(SettingsRequest { settings_of, .. }) = serde_json::from_slice(&line) {
        return connection.send_if_ready(&settings_reply(&settings_of, told));
    }
    let (client, answer, mut ended) = Client::new();
    let answer = match Request::parse(&line) {
        Ok(request) => {
            // Without a receiver the daemon ends, and `answer` fails.
            let _ = events.send(Event::OnDemand { request, client });
            tokio::select! {
                // First: what has begun has to be ended.
                biased;
                answer = answer => answer.unwrap_or(Err("the daemon ends".to_owned())),
                // The client goes, or asks for the end, before the beginning: without a receiver,
                // what is being begun is discarded.
                _ = connection.receive() => return Ok(()),
            }
        }
        Err(why) => Err(why),
    };
    let view = match answer {
        Ok(view) => view,
        Err(why) => return connection.send_if_ready(&Reply::Refused(why)),
    };
    let path = view.path.clone();
    let mut is_gone = connection.send_if_ready(&Reply::Begun(path)).is_err();
    if is_gone {
        let _ = events.send(Event::Abandoned { id: view.id });
    }
    let mut ticks = interval(PROGRESS_EVERY);
    ticks.set_missed_tick_behavior(MissedTickBehavior::Skip);
    let ended = loop {
        tokio::select! {
            ended = &mut ended => break ended,
            // Whatever a client says now means the end, and so does its own end.
            _ = connection.receive(), if !is_gone => {
                is_gone = true;
                let _ = events.send(Event::Abandoned { id: view.id });
            }
            _ = ticks.tick() => {
                let _ = connection.send_if_ready(&Reply::Progress(view.progress()));
            }
        }
    };
    match ended {
        Ok(ended) => timeout(PATIENCE, connection.send(&Reply::Ended(ended)))
            .await
            .unwrap_or(Ok(())),
        // It was logged why.
        Err(_) => Ok(()),
    }
}
