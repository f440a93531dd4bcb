//! What a source shows and all browsers see: its description, its state, and the newest sweep.
//!
//! A source is a thread; browsers are tasks. Each value here is the newest one, which a slow browser
//! reads when it gets to it: it never holds up the source.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};

use hyper::body::Bytes;
use serde::Serialize;
use serde_json::Value;
use sweepd::floor;
use sweepd_core::buffers::HeapBuffer;
use sweepd_core::buffers::{Buffers, HeapBuffers};
use sweepd_core::floor::FloorFinder;
use sweepd_core::segment;
use sweepd_core::sweep::SweepRef;
use sweepd_core::sweep::layout::{LayoutError, flags};
use tokio::sync::watch;

/// Commands that wait at most; more are refused.
const COMMANDS: usize = 64;

/// Buffers are as long as a multiple of this many bytes.
const BUFFER_STEP: usize = 1 << 18;

/// The kind of a source.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub(super) enum Kind {
    Capture,
    Simulation,
    Sensor,
    /// None of several sensors is chosen yet.
    Choice,
}

/// What is shown.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(super) struct Description {
    pub kind: Kind,
    /// Path, model or sensor.
    pub name: String,
    /// Sensors that can be chosen.
    pub sensors: Vec<String>,
    /// The one that is shown, if it is known.
    pub chosen: Option<String>,
    /// Sweeps known so far; `None` for a sensor.
    pub sweeps: Option<u64>,
    /// Moments worth a look.
    pub marks: Vec<Mark>,
    /// Of a sensor: whether the daemon has told what it segments with, and whether it has a mask that
    /// this view has not.
    pub told: bool,
    pub masked: bool,
    /// Floor that the sweeps show: the lines of a mount, and what is in doubt or wrong with the
    /// one that is set, each `null` where there is none.
    pub floor: Value,
    /// What the sweeps are segmented with, as far as it is known.
    #[serde(skip)]
    pub segment: segment::Config,
    /// What the configuration has of it; the defaults, where there is none.
    #[serde(skip)]
    pub configured: segment::Config,
}

/// A moment worth a look.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub(super) struct Mark {
    /// Place of the sweep.
    pub sweep: u64,
    /// `loss`, `gap`, `stop` or `restart`.
    pub what: &'static str,
    pub text: String,
}

/// How the source is.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(super) struct State {
    pub words: String,
    pub ok: bool,
    pub playing: bool,
    pub speed: f64,
    /// What is counted since the view began, and the like: short texts by name.
    pub facts: BTreeMap<&'static str, String>,
}

/// A sweep that is shown.
#[derive(Debug)]
pub(super) struct Frame {
    /// Its place among the whole sweeps of the capture, from 0; `None` for a sensor.
    pub index: Option<u64>,
    /// Number among all that could have been shown since the start: it grows by more than 1 where
    /// this program missed some.
    pub ordinal: u64,
    /// The number of its sensor: it grows where another one is chosen.
    pub sensor: u64,
    /// The bytes that docs/layout.md defines.
    pub bytes: Bytes,
}

/// What a browser asks of the source.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Command {
    Play,
    Pause,
    Step(i64),
    Speed(f64),
    /// To this place.
    Seek(u64),
    /// To the sweep of this number.
    Find(u64),
    Choose(String),
}

/// The side of the browsers.
#[derive(Clone)]
pub(super) struct Channels {
    pub description: watch::Receiver<Description>,
    pub state: watch::Receiver<State>,
    pub frame: watch::Receiver<Option<Arc<Frame>>>,
    pub commands: SyncSender<Command>,
}

/// The side of the source.
pub(super) struct Publisher {
    description: watch::Sender<Description>,
    state: watch::Sender<State>,
    frame: watch::Sender<Option<Arc<Frame>>>,
    pub(super) commands: Receiver<Command>,
    over: Arc<AtomicBool>,
    ordinal: u64,
    sensor: u64,
    floor: FloorFinder,
}

/// The two sides of the channels, without a sweep. The source ends when `over` is set.
pub(super) fn channels(
    description: Description,
    state: State,
    over: Arc<AtomicBool>,
) -> (Publisher, Channels) {
    let (description, of_description) = watch::channel(description);
    let (state, of_state) = watch::channel(state);
    let (frame, of_frame) = watch::channel(None);
    let (commands, for_commands) = sync_channel(COMMANDS);
    let publisher = Publisher {
        description,
        state,
        frame,
        commands: for_commands,
        over,
        ordinal: 0,
        sensor: 0,
        floor: FloorFinder::new(&segment::Config::default()),
    };
    let channels = Channels {
        description: of_description,
        state: of_state,
        frame: of_frame,
        commands,
    };
    (publisher, channels)
}

impl Publisher {
    pub(super) fn is_over(&self) -> bool {
        self.over.load(Ordering::Relaxed)
    }

    /// A handle to describe from another thread.
    pub(super) fn describer(&self) -> watch::Sender<Description> {
        self.description.clone()
    }

    /// Whether any page is open: each has its channels, and so has the server.
    pub(super) fn is_watched(&self) -> bool {
        self.frame.receiver_count() > 1
    }

    /// Changes the description; browsers hear of it if it is another one.
    pub(super) fn describe(&self, change: impl FnOnce(&mut Description)) {
        describe(&self.description, change);
    }

    pub(super) fn description(&self) -> Description {
        self.description.borrow().clone()
    }

    /// Changes the state.
    pub(super) fn tell(&self, state: State) {
        self.state.send_if_modified(|now| {
            let is_new = *now != state;
            *now = state;
            is_new
        });
    }

    /// Shows a sweep; `missed` is how many this program did not get before it.
    pub(super) fn show(&mut self, index: Option<u64>, missed: u64, bytes: Bytes) {
        self.ordinal = self.ordinal.saturating_add(missed).saturating_add(1);
        if let Ok(sweep) = SweepRef::open(&bytes) {
            self.look_at_floor(&sweep);
        }
        let frame = Frame {
            index,
            ordinal: self.ordinal,
            sensor: self.sensor,
            bytes,
        };
        self.frame.send_replace(Some(Arc::new(frame)));
    }

    /// Looks for the floor in a sweep, below a sensor that is mounted as its header says.
    fn look_at_floor(&mut self, sweep: &SweepRef<'_>) {
        let header = sweep.header;
        let set = floor::mount_of(header);
        if *self.floor.mount() != set {
            let configured = self.description.borrow().configured.clone();
            self.floor = FloorFinder::new(&segment::Config {
                mount: set,
                ..configured
            });
        }
        if self.floor.look(sweep) {
            let seen = floor::Seen {
                sight: self.floor.sight(),
                set: Some(set),
                is_estimated: header.has(flags::HEIGHT_ESTIMATED | flags::HEIGHT_IN_DOUBT),
            };
            self.describe(|now| now.floor = seen.json());
        }
    }

    /// What comes next is of another sensor, which sits elsewhere.
    pub(super) fn change_sensor(&mut self) {
        self.sensor += 1;
        self.floor = FloorFinder::new(&segment::Config::default());
        self.describe(|now| now.floor = Value::Null);
    }

    /// Shows nothing.
    pub(super) fn clear(&mut self) {
        self.change_sensor();
        self.frame.send_replace(None);
    }
}

/// Changes a description; browsers hear of it if it is another one.
pub(super) fn describe(to: &watch::Sender<Description>, change: impl FnOnce(&mut Description)) {
    to.send_if_modified(|now| {
        let before = now.clone();
        change(now);
        *now != before
    });
}

/// A copy of a sweep without the room that it leaves unused, but with room for this many segments.
///
/// # Errors
/// [`LayoutError`]: it has more segments.
pub(super) fn packed(
    buffers: &mut HeapBuffers,
    sweep: &SweepRef<'_>,
    segments: usize,
) -> Result<HeapBuffer, LayoutError> {
    let shape = sweep.packed_shape(segments);
    // Sweeps differ a little in size, and their buffers are used again.
    let mut buffer = buffers.take(shape.total_bytes().next_multiple_of(BUFFER_STEP));
    sweep.pack(&shape, buffer.as_mut())?;
    Ok(buffer)
}

/// The bytes of a sweep in a buffer that may be longer; `None` if they are no sweep.
pub(super) fn sweep_bytes(buffer: HeapBuffer) -> Option<Bytes> {
    let header = SweepRef::open(buffer.as_ref()).ok()?.header;
    let total = usize::try_from(header.total_bytes).ok()?;
    let bytes = Bytes::from_owner(buffer);
    (total <= bytes.len()).then(|| bytes.slice(..total))
}
