//! How `sweepd record --from NAME` gets the datagrams of a running daemon.
//!
//! ```text
//! port thread -> Tap --ring--> thread of the taps --socket--> TapStream of sweepd record
//! ```
//!
//! A daemon listens on a socket in its folder, [`socket_path`], that its own user alone may open;
//! both ends check that the other is of the same user. Without a client, [`Tap::put`] costs one
//! relaxed load. While somebody does, it copies the datagram into a ring: it never waits, never
//! allocates, and takes no lock. One more thread carries the datagrams from there to at most
//! [`MAX_CLIENTS`] clients. What finds no room, in the ring or with a client that is slow or stuck,
//! is counted and told to the client at the end; the sensor never notices.
//!
//! The file is written by the client, with its own rights. The format is in [`wire`].

mod client;
mod error;
mod server;
mod sys;
pub mod wire;

use std::io::{self, Write};
use std::os::unix::net::UnixStream;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::{self, JoinHandle};

pub use self::client::TapStream;
pub use self::error::TapError;
use self::server::{Server, Socket};
use crate::capture::record::ring::{Consumer, Producer, ring};
use crate::capture::write::Addressed;

/// Most clients at a time.
pub const MAX_CLIENTS: usize = 4;
/// What may wait for the thread of the taps, bytes a sensor: more than a second of the fastest
/// model. The system gives the memory when it is first used.
const RING_BYTES: usize = 8 << 20;

/// Where the daemon of a root folder listens: in that folder, beside those of iceoryx2.
pub fn socket_path(root: &Path) -> PathBuf {
    root.join("tap.sock")
}

/// The taps of a daemon. Without a client, their thread sleeps. When they are dropped, clients
/// get what was put in before, and are told the end.
///
/// ```
/// use std::time::Duration;
/// use sweepd::capture::write::Addressed;
/// use sweepd::daemon::tap::{TapStream, Taps, socket_path};
///
/// # let folder = std::env::temp_dir().join(format!("sweepd-tap-doc-{}", std::process::id()));
/// # std::fs::create_dir_all(&folder)?;
/// let taps = Taps::listen(&socket_path(&folder))?;
/// let mut roof = taps.sensor("roof");
///
/// let mut client = TapStream::connect(&socket_path(&folder), "roof")?;
/// let (source, destination) = ("192.168.1.201:2368".parse()?, "255.255.255.255:2368".parse()?);
/// roof.put(&Addressed { arrival_ns: 5, source, destination, payload: b"hello" });
/// let mut payloads = Vec::new();
/// while payloads.is_empty() {
///     client.receive(Duration::from_secs(1), |datagram| payloads.push(datagram.payload.to_vec()))?;
/// }
/// assert_eq!(payloads, [b"hello"]);
/// # std::fs::remove_dir_all(&folder)?;
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug)]
pub struct Taps {
    path: PathBuf,
    shared: Arc<Shared>,
    /// Wakes the thread: rung, it looks after its socket; dropped, it ends.
    bell: Option<UnixStream>,
    /// `None` when it was joined.
    server: Option<JoinHandle<()>>,
}

/// What the threads share.
#[derive(Debug, Default)]
struct Shared {
    over: AtomicBool,
    /// Sensors that the thread of the taps has not seen yet.
    new_sensors: Mutex<Vec<Tapped>>,
}

impl Shared {
    fn new_sensors(&self) -> MutexGuard<'_, Vec<Tapped>> {
        self.new_sensors
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
    }
}

/// The other end of a [`Tap`].
#[derive(Debug)]
struct Tapped {
    name: String,
    consumer: Consumer,
    /// Where that ended at the last look.
    end: u64,
    valve: Arc<Valve>,
    /// Of [`Valve::refused`], how many are known.
    refused: u64,
}

/// What both ends of a tap share beside the ring.
#[derive(Debug, Default)]
struct Valve {
    is_open: AtomicBool,
    /// Datagrams that found no room in the ring.
    refused: AtomicU64,
}

impl Taps {
    /// Listens. A socket that a daemon left behind is replaced.
    ///
    /// # Errors
    /// [`TapError`]: another daemon listens there, or the socket cannot be made.
    pub fn listen(path: &Path) -> Result<Self, TapError> {
        let socket = Socket::listen(path)?;
        let shared = Arc::new(Shared::default());
        let bells = UnixStream::pair().and_then(|(bell, rung)| {
            bell.set_nonblocking(true)?;
            rung.set_nonblocking(true)?;
            Ok((bell, rung))
        });
        let (bell, rung) = bells.map_err(|source| TapError::Listen {
            path: path.to_owned(),
            source,
        })?;
        let server = Server::new(Arc::clone(&shared), rung, socket);
        let thread = thread::Builder::new()
            .name("sweepd-tap".to_owned())
            .spawn(|| server.run());
        let server = Some(thread.map_err(|source| TapError::Thread { source })?);
        Ok(Self {
            path: path.to_owned(),
            shared,
            bell: Some(bell),
            server,
        })
    }

    /// Looks whether the socket was deleted, and has it made again; to be called now and then.
    pub fn look_after(&self) {
        if is_gone(&self.path)
            && let Some(mut bell) = self.bell.as_ref()
        {
            // What cannot be rung once more was rung often enough.
            let _ = bell.write(&[0]);
        }
    }

    /// A tap for the datagrams of a sensor. Each thread that receives such needs one of its own.
    /// Takes memory and a lock: not for the hot path.
    pub fn sensor(&self, name: &str) -> Tap {
        let (producer, consumer) = ring(RING_BYTES);
        let valve = Arc::new(Valve::default());
        let (name, of_tap) = (name.to_owned(), Arc::clone(&valve));
        self.shared.new_sensors().push(Tapped {
            name,
            consumer,
            end: 0,
            valve,
            refused: 0,
        });
        Tap {
            producer,
            valve: of_tap,
        }
    }
}

/// Whether nothing is there, not even the folder.
fn is_gone(path: &Path) -> bool {
    path.symlink_metadata()
        .is_err_and(|error| error.kind() == io::ErrorKind::NotFound)
}

impl Drop for Taps {
    fn drop(&mut self) {
        self.shared.over.store(true, Ordering::Release);
        self.bell = None;
        if let Some(server) = self.server.take() {
            // A panic there was told when it happened, and is no reason for another one here.
            let _ = server.join();
        }
    }
}

/// Where a receiving thread puts the datagrams of a sensor.
#[derive(Debug)]
pub struct Tap {
    producer: Producer,
    valve: Arc<Valve>,
}

impl Tap {
    /// Whether somebody listens: one relaxed load.
    pub fn is_open(&self) -> bool {
        self.valve.is_open.load(Ordering::Relaxed)
    }

    /// Passes a datagram on to who listens. Never waits, never allocates.
    pub fn put(&mut self, datagram: &Addressed<'_>) {
        if self.is_open() && !self.producer.put(datagram) {
            self.valve.refused.fetch_add(1, Ordering::Relaxed);
        }
    }
}

#[cfg(test)]
mod tests;
