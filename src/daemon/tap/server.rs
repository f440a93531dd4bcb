//! The thread of the taps: it accepts clients and carries datagrams from the rings to them, without
//! waiting for any.

use std::collections::VecDeque;
use std::fs;
use std::io::{self, Read, Write};
use std::os::unix::fs::{FileTypeExt, MetadataExt, PermissionsExt};
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::thread;
use std::time::{Duration, Instant};

use super::wire::{Answer, END_LEN, Frame, Hello, MAX_NAME_LEN, Status, WireError};
use super::{MAX_CLIENTS, Shared, TapError, Tapped, is_gone, sys};
use crate::capture::write::Addressed;
use crate::daemon::sys::wait_for_either;
use sweepd_client::host::{own_uid, user_name};

/// How often it looks while something waits for a client, and while there are clients.
const BUSY_PERIOD: Duration = Duration::from_millis(1);
const PERIOD: Duration = Duration::from_millis(10);
/// After so long it tries again to let in who could not be.
const NEXT_TRY: Duration = Duration::from_secs(1);
/// For how long a client may keep silent before it has said what it wants, and may take nothing
/// although there is something for it.
const GREETING_TIME: Duration = Duration::from_secs(2);
const STUCK_TIME: Duration = Duration::from_secs(30);
/// How long clients are waited for at the end of the daemon, which itself must end soon.
const FAREWELL_TIME: Duration = Duration::from_millis(50);
/// What may wait for a client, bytes: more than a second of the fastest model.
const WAITING_BYTES: usize = 8 << 20;

/// The socket in the file system.
#[derive(Debug)]
pub(super) struct Socket {
    path: PathBuf,
    listener: UnixListener,
    inode: u64,
}

impl Socket {
    pub(super) fn listen(path: &Path) -> Result<Self, TapError> {
        if UnixStream::connect(path).is_ok() {
            return Err(TapError::Taken {
                path: path.to_owned(),
            });
        }
        let failed = |source| TapError::Listen {
            path: path.to_owned(),
            source,
        };
        let (listener, inode) = bind(path).map_err(failed)?;
        Ok(Self {
            path: path.to_owned(),
            listener,
            inode,
        })
    }

    /// Listens again if the socket was deleted.
    fn look_after(&mut self) {
        // Where the folder is gone too it is tried again when the bell is rung again.
        if is_gone(&self.path)
            && let Ok((listener, inode)) = bind(&self.path)
        {
            (self.listener, self.inode) = (listener, inode);
        }
    }
}

impl Drop for Socket {
    fn drop(&mut self) {
        // Another daemon may have put its own there.
        if self
            .path
            .symlink_metadata()
            .is_ok_and(|found| found.ino() == self.inode)
        {
            let _ = fs::remove_file(&self.path);
        }
    }
}

/// Listens, on a socket that only this user may open from the first moment on: it gets its name
/// when it is ready, and replaces one that was left behind.
fn bind(path: &Path) -> io::Result<(UnixListener, u64)> {
    if path
        .symlink_metadata()
        .is_ok_and(|found| !found.file_type().is_socket())
    {
        return Err(io::Error::new(
            io::ErrorKind::AlreadyExists,
            "something else is there",
        ));
    }
    let unready = path.with_extension(std::process::id().to_string());
    let _ = fs::remove_file(&unready);
    let listener = UnixListener::bind(&unready)?;
    match prepare(&listener, &unready).and_then(|inode| fs::rename(&unready, path).map(|()| inode))
    {
        Ok(inode) => Ok((listener, inode)),
        Err(error) => {
            let _ = fs::remove_file(&unready);
            Err(error)
        }
    }
}

fn prepare(listener: &UnixListener, path: &Path) -> io::Result<u64> {
    listener.set_nonblocking(true)?;
    fs::set_permissions(path, fs::Permissions::from_mode(0o600))?;
    Ok(path.symlink_metadata()?.ino())
}

/// All that the thread has.
pub(super) struct Server {
    shared: Arc<Shared>,
    /// Its other end rings when the socket is to be looked after, and is dropped when the thread is
    /// to end.
    bell: UnixStream,
    socket: Socket,
    sensors: Vec<Tapped>,
    clients: Vec<Client>,
}

impl Server {
    pub(super) fn new(shared: Arc<Shared>, bell: UnixStream, socket: Socket) -> Self {
        Self {
            shared,
            bell,
            socket,
            sensors: Vec::new(),
            clients: Vec::new(),
        }
    }

    pub(super) fn run(mut self) {
        while !self.shared.over.load(Ordering::Acquire) {
            if self.was_rung() {
                self.socket.look_after();
            }
            let accepted = self.accept();
            self.round();
            match accepted {
                Ok(()) => wait_for_either(&self.bell, &self.socket.listener, self.period()),
                // Who could not be accepted (no file is left) still knocks: the bell alone, else
                // this would never rest.
                Err(_) => wait_for_either(
                    &self.bell,
                    &self.bell,
                    self.period().clamp(PERIOD, NEXT_TRY),
                ),
            }
        }
        self.clients.iter_mut().for_each(Client::end);
        let begun = Instant::now();
        while !self.clients.is_empty() && begun.elapsed() < FAREWELL_TIME {
            self.round();
            thread::sleep(BUSY_PERIOD);
        }
    }

    fn was_rung(&self) -> bool {
        // It may have been rung more than once.
        matches!((&self.bell).read(&mut [0; 64]), Ok(1..))
    }

    fn period(&self) -> Duration {
        match &self.clients[..] {
            // The last one has gone: the valves are to be shut.
            [] if self
                .sensors
                .iter()
                .any(|sensor| sensor.valve.is_open.load(Ordering::Relaxed)) =>
            {
                PERIOD
            }
            // Who knocks or rings wakes it.
            [] => Duration::MAX,
            // A stuck one among them is no reason to hurry.
            clients if clients.iter().any(|client| client.is_taking()) => BUSY_PERIOD,
            _ => PERIOD,
        }
    }

    /// Lets in who knocks.
    fn accept(&mut self) -> io::Result<()> {
        // No more than a few a round: who connects again and again must not keep it from the
        // others.
        for _ in 0..MAX_CLIENTS {
            let stream = match self.socket.listener.accept() {
                Ok((stream, _)) => stream,
                Err(error) if error.kind() == io::ErrorKind::WouldBlock => break,
                Err(error) => return Err(error),
            };
            let own = own_uid();
            let refusal = if !sys::peer_uid(&stream).is_ok_and(|uid| uid == own) {
                Answer::new(Status::OtherUser, &user_name(own))
            } else if self.clients.len() >= MAX_CLIENTS {
                Answer::new(Status::Busy, "")
            } else {
                self.clients.extend(Client::new(stream));
                continue;
            };
            // An answer fits into any socket's buffer; who does not read it is not missed.
            let _ = stream
                .set_nonblocking(true)
                .and_then(|()| (&stream).write_all(&refusal.bytes()));
        }
        Ok(())
    }

    /// Carries what has come, hears the clients, and parts from who has got all or is gone.
    fn round(&mut self) {
        self.sensors.extend(self.shared.new_sensors().drain(..));
        // What was before a client came is not for it, and what was before it went is.
        self.carry();
        self.clients
            .iter_mut()
            .for_each(|client| client.hear(&self.sensors));
        // Before a client is told that it will get them.
        for sensor in &self.sensors {
            let is_wanted = self.clients.iter().any(|client| client.wants(&sensor.name));
            sensor.valve.is_open.store(is_wanted, Ordering::Relaxed);
        }
        self.carry();
        self.clients.iter_mut().for_each(Client::send);
        self.clients
            .retain(|client| !matches!(client.stage, Stage::Gone));
    }

    fn carry(&mut self) {
        carry(&mut self.sensors, &mut self.clients);
        self.sensors.retain(|sensor| !sensor.is_done());
    }
}

/// Carries all that is there in the order of arrival: the packets of one sensor may come through
/// several threads. A thread that naps may put in earlier ones later: by less than a nap, they are
/// then out of order (by a quarter of a second at most, of position packets when a client has just
/// come; else by a tenth). Those of one port keep their order.
fn carry(sensors: &mut [Tapped], clients: &mut [Client]) {
    sensors.iter_mut().for_each(|sensor| sensor.look(clients));
    loop {
        let next = sensors
            .iter_mut()
            .filter_map(|sensor| Some((sensor.next_ns()?, sensor)));
        let Some((_, earliest)) = next.min_by_key(|(next_ns, _)| *next_ns) else {
            return;
        };
        earliest.carry_next(clients);
    }
}

impl Tapped {
    /// Looks how far it has come, and counts what it had no room for.
    fn look(&mut self, clients: &mut [Client]) {
        let before = self.refused;
        self.end = self.consumer.end();
        self.refused = self.valve.refused.load(Ordering::Relaxed);
        for client in clients.iter_mut().filter(|client| client.wants(&self.name)) {
            client.lost += self.refused - before;
        }
    }

    /// Arrival of the next datagram that was there at the last look.
    fn next_ns(&self) -> Option<i64> {
        self.consumer.next_ns(self.end)
    }

    fn carry_next(&mut self, clients: &mut [Client]) {
        let Self {
            name,
            consumer,
            end,
            ..
        } = self;
        if let Some(datagram) = consumer.take(*end) {
            clients
                .iter_mut()
                .filter(|client| client.wants(name))
                .for_each(|client| client.put(&datagram));
        }
    }

    /// Whether its [`Tap`](super::Tap) was dropped, and all is taken.
    fn is_done(&self) -> bool {
        self.consumer.is_closed() && self.consumer.is_at(self.consumer.end())
    }
}

/// A client.
#[derive(Debug)]
struct Client {
    stream: UnixStream,
    stage: Stage,
    /// What it has not taken yet.
    waiting: VecDeque<u8>,
    /// Datagrams that found no room on the way to it.
    lost: u64,
    /// When it last took something, or there was nothing for it.
    moved: Instant,
}

#[derive(Debug, PartialEq, Eq)]
enum Stage {
    /// It has said so much.
    Greeting(Vec<u8>),
    /// It gets the datagrams of this sensor.
    Streaming(String),
    /// It gets what was put in before, and is told the end.
    Ending(String),
    /// It gets what waits for it.
    Leaving,
    /// It went away, or broke the rules.
    Gone,
}

impl Client {
    fn new(stream: UnixStream) -> Option<Self> {
        stream.set_nonblocking(true).ok()?;
        let (stage, waiting) = (Stage::Greeting(Vec::new()), VecDeque::new());
        Some(Self {
            stream,
            stage,
            waiting,
            lost: 0,
            moved: Instant::now(),
        })
    }

    fn wants(&self, sensor: &str) -> bool {
        matches!(&self.stage, Stage::Streaming(name) | Stage::Ending(name) if name == sensor)
    }

    /// Reads what it says.
    fn hear(&mut self, sensors: &[Tapped]) {
        // One byte more than there may be shows that there is more.
        let mut bytes = [0; MAX_NAME_LEN + 64];
        let count = match self.stream.read(&mut bytes) {
            Ok(count) => Some(count),
            Err(error) if is_later(&error) => None,
            Err(_) => return self.stage = Stage::Gone,
        };
        match (&mut self.stage, count) {
            (Stage::Greeting(_), None) if self.moved.elapsed() > GREETING_TIME => {
                self.stage = Stage::Gone
            }
            (Stage::Greeting(said), Some(count)) if count > 0 => {
                said.extend(&bytes[..count]);
                let said = Hello::parse(said);
                self.answer(said, sensors);
            }
            (Stage::Streaming(_), Some(0)) => self.end(),
            // What leaves has said all that matters.
            (Stage::Leaving | Stage::Ending(_) | Stage::Gone, _) | (_, None) => {}
            (_, Some(_)) => self.stage = Stage::Gone,
        }
    }

    fn answer(&mut self, said: Result<Hello, WireError>, sensors: &[Tapped]) {
        let (answer, next) = match said {
            Ok(Hello::Incomplete) => return,
            Err(_) => return self.stage = Stage::Gone,
            Ok(Hello::OtherVersion) => (Answer::new(Status::OtherVersion, ""), Stage::Leaving),
            Ok(Hello::Sensor(name)) if sensors.iter().any(|sensor| sensor.name == name) => {
                self.waiting.reserve_exact(WAITING_BYTES);
                (Answer::new(Status::Granted, ""), Stage::Streaming(name))
            }
            Ok(Hello::Sensor(_)) => {
                let mut names: Vec<&str> = sensors.iter().map(|sensor| &sensor.name[..]).collect();
                names.sort_unstable();
                names.dedup();
                (
                    Answer::new(Status::UnknownSensor, &names.join(", ")),
                    Stage::Leaving,
                )
            }
        };
        self.waiting.extend(answer.bytes());
        self.stage = next;
    }

    fn put(&mut self, datagram: &Addressed<'_>) {
        match Frame::parts(datagram) {
            Some((head, payload)) if self.has_room_for(head.len() + payload.len()) => {
                self.waiting.extend(head);
                self.waiting.extend(payload);
            }
            _ => self.lost += 1,
        }
    }

    /// Whether something waits for it, and it took some of that just now.
    fn is_taking(&self) -> bool {
        !self.waiting.is_empty() && self.moved.elapsed() < PERIOD
    }

    /// The end always finds room.
    fn has_room_for(&self, len: usize) -> bool {
        self.waiting.len() + len + END_LEN <= WAITING_BYTES
    }

    /// Nothing more is for it than what was put in before.
    fn end(&mut self) {
        self.stage = match std::mem::replace(&mut self.stage, Stage::Gone) {
            Stage::Streaming(sensor) => Stage::Ending(sensor),
            Stage::Greeting(_) => Stage::Gone,
            other => other,
        };
    }

    /// Sends as much as it takes at once.
    fn send(&mut self) {
        if let Stage::Ending(_) = self.stage {
            self.waiting.extend(Frame::end(self.lost));
            self.stage = Stage::Leaving;
        }
        while !self.waiting.is_empty() && self.stage != Stage::Gone {
            match self.stream.write(self.waiting.as_slices().0) {
                Ok(0) => self.stage = Stage::Gone,
                Ok(count) => {
                    self.waiting.drain(..count);
                    self.moved = Instant::now();
                }
                Err(error) if is_later(&error) => break,
                Err(_) => self.stage = Stage::Gone,
            }
        }
        if self.waiting.is_empty() {
            // From the beginning again: else it would go through all of its memory in time, which
            // the system gives when it is first used, though little waits.
            self.waiting.clear();
        }
        match self.stage {
            Stage::Leaving if self.waiting.is_empty() => self.stage = Stage::Gone,
            Stage::Streaming(_) if self.waiting.is_empty() => self.moved = Instant::now(),
            Stage::Streaming(_) | Stage::Leaving if self.moved.elapsed() > STUCK_TIME => {
                self.stage = Stage::Gone
            }
            _ => {}
        }
    }
}

fn is_later(error: &io::Error) -> bool {
    matches!(
        error.kind(),
        io::ErrorKind::WouldBlock | io::ErrorKind::Interrupted
    )
}

#[cfg(test)]
mod tests;
