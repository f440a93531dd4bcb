//! A simulated sensor in a simulated scene: its datagrams, which are made once and kept, so that a
//! step back does not simulate anew.

use std::sync::{Arc, Condvar, Mutex, PoisonError};
use std::time::Duration;

use sweepd_core::segment::Mount;
use sweepd_core::sensor::Model;
use sweepd_core::wire::data::ReturnMode;
use sweepd_lab::simulate::clock::{Clock, Reception};
use sweepd_lab::simulate::{Emitter, EmitterConfig, Scene, Setting, SimulatedDatagram};

/// How long it is, seconds. The scene stands still: more would show no more.
const SECONDS: f64 = 10.0;
/// Interval at which a reader that waits looks whether all is over.
const LOOK_EVERY: Duration = Duration::from_millis(100);

/// The datagrams so far.
pub(crate) struct Simulation {
    config: EmitterConfig,
    setting: Setting,
    scene: Scene,
    made: Mutex<Made>,
    more: Condvar,
}

#[derive(Default)]
struct Made {
    datagrams: Vec<Arc<SimulatedDatagram>>,
    is_complete: bool,
}

impl Simulation {
    /// A sensor of this model in a scene, mounted like this.
    ///
    /// # Errors
    /// A message: it cannot be there.
    pub(crate) fn new(model: Model, setting: Setting, mount: &Mount) -> Result<Self, String> {
        let mut config = EmitterConfig::new(model, ReturnMode::Strongest);
        let scene = setting.build(config.seed);
        config.pose = setting.mounted(&scene, 0, mount)?;
        config.clock = Clock::Gps {
            position_deg: (50.110_6, 8.682_1),
            reception: Reception::ALWAYS,
        };
        Ok(Self {
            config: config.seconds(SECONDS, None),
            setting,
            scene,
            made: Mutex::default(),
            more: Condvar::new(),
        })
    }

    /// The model and the scene.
    pub(crate) fn name(&self) -> String {
        let model = self.config.model.name();
        format!("{model}, simulated: {}", self.setting.name())
    }

    /// Makes all datagrams; ends early when `is_over` says so.
    pub(super) fn make(&self, is_over: impl Fn() -> bool) {
        for datagram in Emitter::new(self.config.clone(), &self.scene).untold() {
            if is_over() {
                break;
            }
            let mut made = self.made.lock().unwrap_or_else(PoisonError::into_inner);
            made.datagrams.push(Arc::new(datagram));
            self.more.notify_all();
        }
        let mut made = self.made.lock().unwrap_or_else(PoisonError::into_inner);
        made.is_complete = true;
        self.more.notify_all();
    }

    /// A datagram by number, as soon as it is made; `None` behind the last.
    pub(super) fn datagram(&self, number: usize) -> Option<Arc<SimulatedDatagram>> {
        let mut made = self.made.lock().unwrap_or_else(PoisonError::into_inner);
        loop {
            if let Some(datagram) = made.datagrams.get(number) {
                return Some(Arc::clone(datagram));
            }
            if made.is_complete {
                return None;
            }
            (made, _) = self
                .more
                .wait_timeout(made, LOOK_EVERY)
                .unwrap_or_else(PoisonError::into_inner);
        }
    }
}
