//! What the daemon records: the `[record]` of its configuration, and what clients of its control
//! socket ask for (`sweepd record --from NAME`).
//!
//! ```text
//! port threads -> a Feed each -> writing thread of each recording -> files
//! client -> server -> Event -> Recordings (on the control thread)
//! ```
//!
//! A port thread copies each datagram into the feeds that want it, and never waits. A recording
//! that cannot be begun or fails stops no sensor. That of the configuration is begun again by
//! itself, after a second at first and after a minute at most; `/health` and the metrics say so
//! until it is well. One that a client asked for ends, and the client learns why. Threads of their
//! own wait for the disk. The control thread, which has a watchdog to feed, waits for them at most a
//! second at the start, so that nothing is missed, and at the end, until all is on the disk.

pub mod client;
pub mod protocol;
mod recording;
pub mod server;

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::sync::mpsc::Sender;
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use tokio::sync::mpsc::{UnboundedReceiver, UnboundedSender, unbounded_channel};
use tracing::warn;

use self::protocol::Request;
pub use self::recording::{Client, ClientView, RecordingStatus};
use self::recording::{Drops, Origin, Recording, Target, explain, finish_failed};
use super::config::RecordConfig;
use super::counters::PortCounters;
use crate::files::WriteError;
use crate::input::write::Addressed;
use crate::recording::{Feed, RecordCounts, Recorder};

/// Most clients that are served at a time.
pub const MAX_ON_DEMAND: usize = 4;
/// In this time each port thread drops its feed of a recording that ends: it rests for half a
/// second at most.
const RELEASE_TIME: Duration = Duration::from_secs(2);
/// How long the start of the daemon waits for the disk.
const START_TIME: Duration = Duration::from_secs(1);
/// How often it is looked whether a wait is over.
const POLL_TIME: Duration = Duration::from_millis(5);

/// Where the daemon of a root folder is asked for recordings: in that folder, beside the files of
/// iceoryx2.
pub fn socket_path(root: &Path) -> PathBuf {
    root.join("control.sock")
}

/// What a port thread puts into one recording.
#[derive(Debug)]
pub struct PortRecording {
    id: u64,
    /// The one sensor that is recorded, by its number at admission; all if there is none.
    sensor: Option<usize>,
    feed: Feed,
}

impl PortRecording {
    /// Has a datagram recorded that admission gave to a sensor, or to none.
    pub fn put(&mut self, sensor: Option<usize>, datagram: &Addressed<'_>) {
        if self.sensor.is_none() || self.sensor == sensor {
            // What finds no room is counted there.
            self.feed.put(datagram);
        }
    }
}

/// What changes in the recordings of a port, between two of its batches.
#[derive(Debug)]
pub struct PortChange {
    remove: Option<u64>,
    add: Option<PortRecording>,
}

impl PortChange {
    /// Whether it ends one of these recordings.
    pub fn ends_one_of(&self, recordings: &[PortRecording]) -> bool {
        let mut ids = recordings.iter().map(|recording| recording.id);
        ids.any(|id| Some(id) == self.remove)
    }

    /// Makes the change.
    pub fn apply(self, recordings: &mut Vec<PortRecording>) {
        recordings.retain(|recording| Some(recording.id) != self.remove);
        recordings.extend(self.add);
    }
}

/// The way to the thread of a port.
#[derive(Debug)]
pub struct PortLink {
    /// The sensors whose packets may come through it, by their places in the configuration, in the
    /// order of their numbers at admission.
    pub sensors: Vec<usize>,
    /// What it counts.
    pub counters: Arc<PortCounters>,
    /// Where it takes changes.
    pub changes: Sender<PortChange>,
}

impl PortLink {
    /// The number of a sensor at this port's admission.
    fn number_of(&self, sensor: usize) -> Option<usize> {
        self.sensors.iter().position(|&one| one == sensor)
    }

    /// Whether packets of this sensor may come through it; of any, if there is none.
    fn carries(&self, sensor: Option<usize>) -> bool {
        sensor.is_none_or(|sensor| self.sensors.contains(&sensor))
    }
}

/// What happens to recordings.
#[derive(Debug)]
pub enum Event {
    /// A client asks for one.
    OnDemand {
        /// What it wants.
        request: Request,
        /// Where it learns what came of it.
        client: Client,
    },
    /// The file of one was opened, or could not be.
    Opened {
        /// Its number.
        id: u64,
        /// What writes it.
        result: Result<Recorder, WriteError>,
    },
    /// Its client has asked for the end, or has gone.
    Abandoned {
        /// Its number.
        id: u64,
    },
}

impl Event {
    /// Drops an event that is not handled any more.
    fn discard(self) {
        if let Self::Opened {
            result: Ok(recorder),
            ..
        } = self
        {
            recorder.discard();
        }
    }
}

/// Why one client more is refused.
fn too_many() -> String {
    format!("the daemon has {MAX_ON_DEMAND} recordings under way, as many as it allows; stop one")
}

/// How all recordings are, for other threads.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct RecordingsStatus {
    /// That of the configuration, if there is to be one.
    pub configured: Option<RecordingStatus>,
    /// Those that clients asked for.
    pub on_demand: Vec<RecordingStatus>,
    /// Datagrams that were written for clients, since the start.
    pub on_demand_datagrams: u64,
    /// Datagrams that were not, since the disk was too slow or failed.
    pub on_demand_refused: u64,
}

/// All recordings.
#[derive(Debug)]
pub struct Recordings {
    list: Vec<Recording>,
    /// The last configuration that came while the recording of another was being begun.
    waiting: Option<WaitingConfig>,
    /// Names of the sensors.
    sensors: Vec<String>,
    ports: Vec<PortLink>,
    last_id: u64,
    ending: Vec<EndingRecording>,
    /// Datagrams of clients' recordings that have ended.
    ended_datagrams: u64,
    ended_refused: u64,
    to_events: UnboundedSender<Event>,
    events: UnboundedReceiver<Event>,
}

/// A configuration that waits until the recording of the one before has begun.
#[derive(Debug)]
struct WaitingConfig {
    record: Option<RecordConfig>,
}

/// A recording whose thread waits for the ports and the disk.
#[derive(Debug)]
struct EndingRecording {
    thread: JoinHandle<()>,
    /// Of one that a client asked for.
    counts: Option<Arc<RecordCounts>>,
}

impl Default for Recordings {
    fn default() -> Self {
        let (to_events, events) = unbounded_channel();
        Self {
            list: Vec::new(),
            waiting: None,
            sensors: Vec::new(),
            ports: Vec::new(),
            last_id: 0,
            ending: Vec::new(),
            ended_datagrams: 0,
            ended_refused: 0,
            to_events,
            events,
        }
    }
}

impl Recordings {
    /// Begins the recording of the configuration, if there is one. The ports wait for it, so that
    /// nothing is missed, but for at most a second. A failure is logged; the daemon runs all the
    /// same.
    pub fn start(&mut self, record: Option<&RecordConfig>) {
        self.configure(record);
        let started = Instant::now();
        while self.is_configured_beginning() && started.elapsed() < START_TIME {
            match self.events.try_recv() {
                Ok(event) => self.handle(event),
                Err(_) => thread::sleep(POLL_TIME),
            }
        }
        for recording in &mut self.list {
            recording.note_slow_start();
        }
    }

    /// Takes the names of the sensors and the ways to their ports; what has begun is recorded from
    /// here on.
    pub fn connect(&mut self, sensors: Vec<String>, ports: Vec<PortLink>) {
        self.sensors = sensors;
        self.ports = ports;
        for recording in &self.list {
            if let Some(recorder) = recording.recorder() {
                feed(&self.ports, None, recording, recorder);
            }
        }
    }

    /// Where events go.
    pub fn event_sender(&self) -> UnboundedSender<Event> {
        self.to_events.clone()
    }

    /// Waits for the next event; to be handed to [`Recordings::handle`].
    pub async fn next_event(&mut self) -> Event {
        match self.events.recv().await {
            Some(event) => event,
            // There is always a sender, this one's own.
            None => std::future::pending().await,
        }
    }

    /// Takes an event.
    pub fn handle(&mut self, event: Event) {
        match event {
            Event::OnDemand { request, client } => self.ask(request, client),
            Event::Opened { id, result } => self.opened(id, result),
            Event::Abandoned { id } => self.end(id),
        }
    }

    /// Has the configuration record something else, or nothing. What it recorded before goes on
    /// until that is begun, and where it cannot be begun.
    pub fn configure(&mut self, record: Option<&RecordConfig>) {
        if self.is_configured_beginning() {
            self.waiting = Some(WaitingConfig {
                record: record.cloned(),
            });
            return;
        }
        match record {
            Some(config) => {
                let target = Target::configured(config);
                let id = self.add(target, Origin::Configuration(config.clone())).id;
                self.begin(id);
            }
            None => {
                let ids: Vec<u64> = self.configured().map(|one| one.id).collect();
                ids.into_iter().for_each(|id| self.end(id));
            }
        }
    }

    /// What the configuration has recorded, or is to.
    pub fn config(&self) -> Option<&RecordConfig> {
        match &self.waiting {
            Some(waiting) => waiting.record.as_ref(),
            None => self.configured().filter_map(Recording::config).last(),
        }
    }

    /// Whether nothing is recorded for the configuration, though it should be.
    pub fn has_failed(&self) -> bool {
        self.configured().any(Recording::has_failed)
    }

    /// Logs what happened to the recordings, begins again what is due, and ends what has failed.
    pub fn look(&mut self) {
        let now = Instant::now();
        for ended in self.ending.extract_if(.., |one| one.thread.is_finished()) {
            if let Some(counts) = ended.counts {
                self.ended_datagrams += counts.written.load(Ordering::Relaxed);
                self.ended_refused += counts.refused.load(Ordering::Relaxed);
            }
        }
        let mut due = Vec::new();
        let mut over = Vec::new();
        let is_replaced = self.is_configured_beginning();
        for recording in &mut self.list {
            recording.look();
            if !is_replaced && recording.is_due(now) {
                recording.is_beginning = true;
                due.push(recording.id);
            } else if !recording.is_configured()
                && (recording.has_failed() || recording.is_overdue())
            {
                over.push(recording.id);
            }
        }
        due.into_iter().for_each(|id| self.begin(id));
        over.into_iter().for_each(|id| self.end(id));
    }

    /// How all are.
    pub fn status(&self) -> RecordingsStatus {
        let mut status = RecordingsStatus {
            configured: None,
            on_demand: Vec::new(),
            on_demand_datagrams: self.ended_datagrams,
            on_demand_refused: self.ended_refused,
        };
        let mut counts: Vec<&RecordCounts> = Vec::new();
        for ending in &self.ending {
            counts.extend(ending.counts.as_deref());
        }
        for recording in &self.list {
            if !recording.is_configured() {
                counts.push(&recording.counts);
            }
            // While another is being begun, the one before goes on.
            if !recording.was_tried() {
                continue;
            }
            let one = recording.status(&self.sensors);
            if !recording.is_configured() {
                status.on_demand.push(one);
            } else if status.configured.is_none() {
                status.configured = Some(one);
            }
        }
        for count in counts {
            status.on_demand_datagrams += count.written.load(Ordering::Relaxed);
            status.on_demand_refused += count.refused.load(Ordering::Relaxed);
        }
        status
    }

    /// Ends all. When this returns, what was put in is on the disk; how long that takes is up to
    /// the disk.
    pub fn finish(&mut self) {
        // One that is being begun has nothing yet, and must replace nothing. After this, the thread
        // that opens it finds no receiver, and discards it.
        self.events.close();
        while let Ok(event) = self.events.try_recv() {
            event.discard();
        }
        let ids: Vec<u64> = self.list.iter().map(|one| one.id).collect();
        ids.into_iter().for_each(|id| self.end(id));
        for ending in self.ending.drain(..) {
            // A panic there was logged when it happened.
            let _ = ending.thread.join();
        }
    }

    fn configured(&self) -> impl Iterator<Item = &Recording> {
        self.list.iter().filter(|one| one.is_configured())
    }

    fn is_configured_beginning(&self) -> bool {
        self.configured().any(|one| one.is_beginning)
    }

    fn add(&mut self, target: Target, origin: Origin) -> &Recording {
        self.last_id += 1;
        self.list.push(Recording::new(self.last_id, target, origin));
        &self.list[self.list.len() - 1]
    }

    fn ask(&mut self, request: Request, client: Client) {
        let sensor = self.sensors.iter().position(|one| *one == request.sensor);
        let target = match sensor {
            Some(sensor) => Target::on_demand(sensor, request),
            None => {
                let mut names = self.sensors.clone();
                names.sort_unstable();
                Err(format!(
                    "the daemon has no sensor {}; it has {}",
                    request.sensor,
                    names.join(", ")
                ))
            }
        };
        // Those whose clients have gone count as long as the disk keeps them from beginning.
        let on_demand = self.list.iter().filter(|one| !one.is_configured()).count();
        match target {
            Ok(_) if on_demand >= MAX_ON_DEMAND => client.refuse(too_many()),
            Ok(target) if self.list.iter().any(|one| one.target.path == target.path) => {
                let path = target.path.display();
                client.refuse(format!(
                    "the daemon records to {path} already; choose another name"
                ));
            }
            Ok(target) => {
                let id = self.add(target, Origin::Client(client)).id;
                self.begin(id);
            }
            Err(why) => client.refuse(why),
        }
    }

    /// Has a thread begin a recording that is in the list: the disk may keep it waiting.
    fn begin(&mut self, id: u64) {
        let Some(recording) = self.list.iter().find(|one| one.id == id) else {
            return;
        };
        let target = recording.target.clone();
        let counts = Arc::clone(&recording.counts);
        let events = self.to_events.clone();
        let thread = thread::Builder::new()
            .name("sweepd-record".to_owned())
            .spawn(move || {
                let result = target.start(counts);
                if let Err(unsent) = events.send(Event::Opened { id, result }) {
                    unsent.0.discard();
                }
            });
        if let Err(cause) = thread {
            self.opened(id, Err(WriteError::Thread { cause }));
        }
    }

    /// The file of a recording was opened, for the first time or once more, or could not be.
    fn opened(&mut self, id: u64, result: Result<Recorder, WriteError>) {
        let Some(index) = self.list.iter().position(|one| one.id == id) else {
            // It was ended meanwhile, and has recorded nothing.
            if let Ok(recorder) = result {
                self.wait_aside(None, || recorder.discard());
            }
            return;
        };
        if self.list[index].is_abandoned() {
            self.list.remove(index);
            if let Ok(recorder) = result {
                self.wait_aside(None, || recorder.discard());
            }
            return;
        }
        let recording = &mut self.list[index];
        recording.is_beginning = false;
        if recording.is_configured()
            && let Some(waiting) = self.waiting.take()
        {
            if recording.recorder().is_none() {
                self.list.remove(index);
            }
            if let Ok(recorder) = result {
                self.wait_aside(None, || finish_failed(recorder));
            }
            self.configure(waiting.record.as_ref());
            return;
        }
        match result {
            Ok(recorder) => self.write_with(index, recorder),
            Err(error) => self.could_not_open(index, &error),
        }
    }

    fn write_with(&mut self, index: usize, recorder: Recorder) {
        let recording = &self.list[index];
        let id = recording.id;
        let is_first = recording.recorder().is_none();
        // In one step: each datagram is in one or the other.
        let before = self.other_configured(index).filter(|_| is_first);
        feed(
            &self.ports,
            Some(before.unwrap_or(id)),
            recording,
            &recorder,
        );
        let mut counters = Vec::new();
        for port in &self.ports {
            if port.carries(recording.target.sensor) {
                counters.push(Arc::clone(&port.counters));
            }
        }
        let failed = self.list[index].write_with(recorder, Drops::since_now(counters));
        if let Some(failed) = failed {
            self.wait_aside(None, move || {
                await_release(&failed);
                finish_failed(failed);
            });
        }
        if let Some(before) = before {
            self.end(before);
        }
    }

    fn could_not_open(&mut self, index: usize, error: &WriteError) {
        let other = self.other_configured(index);
        let mut list = self.list.iter();
        let goes_on = list.any(|one| Some(one.id) == other && !one.has_failed());
        if !self.list[index].is_configured() {
            self.list.remove(index).refuse(explain(error));
        } else if goes_on {
            warn!("the recording stays as it was: {error}");
            self.list.remove(index);
        } else {
            self.list[index].failed(error);
            if let Some(other) = other {
                self.end(other);
            }
        }
    }

    /// The recording of the configuration beside this one of it, which is to replace that.
    fn other_configured(&self, index: usize) -> Option<u64> {
        let this = &self.list[index];
        let mut others = self.configured().filter(|one| one.id != this.id);
        others
            .next()
            .map(|one| one.id)
            .filter(|_| this.is_configured())
    }

    /// Ends a recording.
    fn end(&mut self, id: u64) {
        let Some(index) = self.list.iter().position(|one| one.id == id) else {
            return;
        };
        let recording = self.list.remove(index);
        for port in &self.ports {
            // A thread that has ended has dropped its feeds.
            let _ = port.changes.send(PortChange {
                remove: Some(id),
                add: None,
            });
        }
        let counts = (!recording.is_configured()).then(|| Arc::clone(&recording.counts));
        // What the ports drop while the disk keeps this waiting comes after the end.
        let dropped = recording.dropped();
        self.wait_aside(counts, move || {
            recording.recorder().into_iter().for_each(await_release);
            recording.finish(dropped);
        });
    }

    /// Waits in a thread in place of the control thread.
    fn wait_aside(
        &mut self,
        counts: Option<Arc<RecordCounts>>,
        wait: impl FnOnce() + Send + 'static,
    ) {
        let thread = thread::Builder::new().name("sweepd-record".to_owned());
        match thread.spawn(wait) {
            Ok(thread) => self.ending.push(EndingRecording { thread, counts }),
            // The recorder was dropped, and has waited here.
            Err(error) => warn!("a recording has ended without a report: {error}"),
        }
    }
}

impl Drop for Recordings {
    fn drop(&mut self) {
        self.finish();
    }
}

/// Gives each port whose packets are recorded a feed, in place of that of another recording.
fn feed(ports: &[PortLink], remove: Option<u64>, recording: &Recording, recorder: &Recorder) {
    let sensor = recording.target.sensor;
    for port in ports.iter().filter(|port| port.carries(sensor)) {
        let add = PortRecording {
            id: recording.id,
            sensor: sensor.and_then(|index| port.number_of(index)),
            feed: recorder.feed(),
        };
        // A thread that has ended is found by `Runtime::check`.
        let _ = port.changes.send(PortChange {
            remove,
            add: Some(add),
        });
    }
}

/// Waits until all port threads have turned away.
fn await_release(recorder: &Recorder) {
    let started = Instant::now();
    while recorder.has_feeds() && started.elapsed() < RELEASE_TIME {
        thread::sleep(POLL_TIME);
    }
}

#[cfg(test)]
mod tests;
