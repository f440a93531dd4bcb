//! Where sweeps and objects come from: a capture, the ports of this host, or a running daemon.

use std::convert::Infallible;
use std::path::Path;
use std::time::{Duration, Instant};

use super::{Obstacle, Trial};
use crate::admission::{Sender, SensorFilter};
use crate::cure::{Dialect, explain};
use crate::doctor::plan::ExaminedPort;
use crate::input::{Capture, CaptureError, Placed, UdpError, UdpSource};
use crate::streams::{SteadyTime, Stream, Streams};
use sweepd_client::client::{Client, ClientError, LayoutError};
use sweepd_client::host::realtime_ns;
use sweepd_core::buffers::{HeapBuffers, Memory};
use sweepd_core::pipeline::{Arrival, Config, Event, Pipeline};
use sweepd_core::segment::ConfigError;
use sweepd_core::segment::objects::MAX_WIDTH_RAD;
use sweepd_core::sweep::SweepRef;
use sweepd_core::wire::Packet;

/// Longest wait for a daemon of which shared memory is left.
const DAEMON: Duration = Duration::from_secs(2);
/// Longest wait on one port, and for a sweep while objects may come.
const TURN: Duration = Duration::from_millis(10);

/// How a box is tried.
#[derive(Clone, Debug)]
pub struct Setup {
    /// The box.
    pub obstacle: Obstacle,
    /// How packets are decoded and sweeps segmented.
    pub pipeline: Config,
    /// Wider objects come in parts, radians.
    pub max_width_rad: f32,
    /// Other sensors than these are not looked at; all are, if there is none.
    pub only: Vec<SensorFilter>,
    /// Of several sensors it is this one.
    pub likely: Option<SensorFilter>,
}

impl Setup {
    /// A sensor of which nothing is known.
    pub fn new(obstacle: Obstacle) -> Self {
        Self {
            obstacle,
            pipeline: Config::default(),
            max_width_rad: MAX_WIDTH_RAD,
            only: Vec::new(),
            likely: None,
        }
    }

    fn begin(&self, sender: &Sender, is_live: bool) -> Result<Tried, ConfigError> {
        let mut pipeline = Pipeline::new("", self.pipeline.clone())?;
        pipeline.find_objects(Some(self.max_width_rad));
        Ok(Tried {
            sender: sender.clone(),
            trial: Trial::new(self.obstacle, Some(self.pipeline.segment.clone())),
            fault: None,
            pipeline,
            memory: Memory::default(),
            is_live,
            newest_ns: 0,
        })
    }

    /// The sensor that is meant.
    fn choose(&self, mut all: Vec<Tried>) -> Result<Tried, TryError> {
        let is_meant = |one: &Tried| {
            let likely = self.likely.as_ref();
            likely.is_some_and(|likely| one.sender.is_selected_by(likely))
        };
        if let Some(index) = all.iter().position(is_meant) {
            return Ok(all.swap_remove(index));
        }
        match all.len() {
            0 => Err(TryError::NoSensor),
            1 => Ok(all.remove(0)),
            _ => {
                let names: Vec<&str> = all.iter().map(|one| &one.sender.name[..]).collect();
                Err(TryError::Several(names.join(", ")))
            }
        }
    }
}

/// Why a box cannot be tried.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum TryError {
    /// The capture cannot be read.
    #[error(transparent)]
    Capture(#[from] CaptureError),
    /// A port cannot be listened on.
    #[error(transparent)]
    Udp(#[from] UdpError),
    /// The daemon's sweeps cannot be received.
    #[error(transparent)]
    Client(#[from] ClientError),
    /// What the daemon sent is no sweep, or no message of objects.
    #[error("the daemon sent what cannot be read: {0}")]
    Layout(#[from] LayoutError),
    /// The segmenter's settings cannot be meant.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// No data packets came.
    #[error(
        "no sensor sends data packets; `sweepd doctor` without --obstacle says why, of a capture `sweepd inspect`"
    )]
    NoSensor,
    /// It is not said which sensor is meant.
    #[error("there are several sensors, name one with --sensor: {0}")]
    Several(String),
}

/// A sensor, and the box that it is tried with.
pub struct Tried {
    /// Where its packets come from.
    pub sender: Sender,
    /// What was seen of the box.
    pub trial: Trial,
    /// Why its packets cannot be decoded.
    pub fault: Option<String>,
    pipeline: Pipeline,
    memory: Memory<HeapBuffers>,
    is_live: bool,
    /// Arrival of the newest datagram.
    newest_ns: i64,
}

impl Tried {
    fn poll(&mut self) {
        while let Some(event) = self.pipeline.poll(&mut self.memory) {
            let known_ns = match self.is_live {
                true => realtime_ns(),
                false => self.newest_ns,
            };
            match event {
                Event::Sweep(bytes) => {
                    if let Ok(sweep) = SweepRef::open(bytes.as_ref()) {
                        self.trial.look(&sweep, known_ns);
                    }
                }
                Event::Objects(new) => self.trial.told(&new, known_ns),
                Event::Fault(fault) => {
                    self.fault = Some(explain(&fault, Dialect::Configuration));
                }
                Event::Notice(_) => {}
            }
        }
    }
}

impl Stream for Tried {
    type Sweep = Infallible;

    fn take(&mut self, packet: Option<&Packet<'_>>, _: &Placed<'_>) {
        match packet {
            Some(packet) => self.pipeline.push(packet),
            None => self.pipeline.push(Arrival::Malformed),
        }
        // So that objects are known behind the packet that completes them.
        self.pipeline.idle(None);
        self.poll();
    }

    fn idle(&mut self, time: SteadyTime) -> bool {
        self.newest_ns = time.newest_ns;
        self.pipeline.idle(Some(time.now_ns));
        self.poll();
        false
    }

    fn end(&mut self) {
        self.pipeline.end();
        self.poll();
    }
}

/// Tries the box with a capture, up to the sweeps that are enough or its end.
///
/// # Errors
/// [`TryError`].
pub fn from_capture(path: &Path, setup: &Setup) -> Result<Tried, TryError> {
    let mut capture = Capture::open(path)?;
    let mut streams = Streams::new(setup.only.clone());
    while let Some(placed) = capture.next_placed()? {
        streams
            .take(&placed, |_, sender| setup.begin(sender, false))?
            .ok();
        if is_over(&streams) {
            break;
        }
    }
    streams.end();
    setup.choose(streams.all)
}

/// Tries the box with what comes to ports, up to the sweeps that are enough, or until no sweep has
/// come for so long. `opened` gets the open ports.
///
/// # Errors
/// [`TryError`].
pub fn from_ports(
    ports: &[ExaminedPort],
    setup: &Setup,
    patience: Duration,
    opened: impl FnOnce(&[u16]),
) -> Result<Tried, TryError> {
    let mut sources = Vec::new();
    for port in ports {
        sources.push(UdpSource::bind(&port.udp())?);
    }
    let numbers: Vec<u16> = sources.iter().map(|one| one.local_addr().port()).collect();
    opened(&numbers);
    let mut streams: Streams<Tried> = Streams::new(setup.only.clone());
    let (mut last, mut sweeps) = (Instant::now(), 0);
    while last.elapsed() < patience && !is_over(&streams) {
        for source in &mut sources {
            for datagram in source.receive(TURN)? {
                let placed = Placed::from(datagram);
                streams
                    .take(&placed, |_, sender| setup.begin(sender, true))?
                    .ok();
            }
        }
        let now: u32 = streams.all.iter().map(|one| one.trial.sweeps()).sum();
        if now > sweeps {
            (last, sweeps) = (Instant::now(), now);
        }
    }
    setup.choose(streams.all)
}

/// Whether all sensors have enough sweeps.
fn is_over(streams: &Streams<Tried>) -> bool {
    !streams.all.is_empty() && streams.all.iter().all(|one| one.trial.is_over())
}

/// Tries the box with the sweeps and objects that a daemon shares, up to the sweeps that are
/// enough, or until no sweep has come for so long; `false` if no daemon shares this sensor any more.
///
/// # Errors
/// [`TryError`].
pub fn from_daemon(
    client: &mut Client,
    trial: &mut Trial,
    patience: Duration,
) -> Result<bool, TryError> {
    let mut objects = client.objects()?;
    let begun = Instant::now();
    let (mut last, mut is_there) = (begun, false);
    while !trial.is_over() && last.elapsed() < patience {
        if let Some(sweep) = client.next(TURN)?.received() {
            let view = sweep.view()?;
            trial.look(&view, view.header.completed_ns);
            (last, is_there) = (Instant::now(), true);
        }
        while let Some(message) = objects.next(Duration::ZERO)?.received() {
            let view = message.view()?;
            trial.told(&view.new_objects(), view.header.sent_ns);
        }
        if !is_there && begun.elapsed() > DAEMON && !client.is_published() {
            return Ok(false);
        }
    }
    Ok(true)
}
