//! Where sweeps come from: a thread that shows them by [channels](super::channels).

mod index;
mod live;
mod player;
pub(crate) mod reader;
pub(crate) mod simulation;

use std::collections::BTreeMap;
use std::io;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::{self, JoinHandle};

use self::live::Live;
use self::player::Player;
use self::reader::Origin;
use self::reader::Reader;
use super::Source;
use super::channels::{Channels, Description, Kind, State, channels};
use serde_json::Value;
use sweepd::cli::CliError;
use sweepd_core::segment;

/// A source at work; it ends when it is dropped.
pub(super) struct Running {
    over: Arc<AtomicBool>,
    threads: Vec<JoinHandle<()>>,
}

impl Drop for Running {
    fn drop(&mut self) {
        self.over.store(true, Ordering::Relaxed);
        for thread in self.threads.drain(..) {
            // A panic has been reported.
            let _ = thread.join();
        }
    }
}

/// Starts a source; the channels are for the server.
///
/// # Errors
/// [`CliError`]: it cannot be opened, or the system has no thread.
pub(super) fn start(source: Source) -> Result<(Running, Channels), CliError> {
    let (segment, configured) = match &source {
        Source::Capture { source_config, .. } => source_config.segment(0),
        Source::Sensor { options, .. } => {
            let mut segment = segment::Config::default();
            options.warn();
            options.apply_to_segmenter(&mut segment)?;
            (segment, segment::Config::default())
        }
    };
    let over = Arc::new(AtomicBool::new(false));
    let (kind, name) = source.kind();
    let description = Description {
        kind,
        name,
        sensors: Vec::new(),
        chosen: None,
        sweeps: (!matches!(kind, Kind::Sensor | Kind::Choice)).then_some(0),
        marks: Vec::new(),
        told: false,
        masked: false,
        floor: Value::Null,
        segment,
        configured,
    };
    let state = State {
        words: "begins".to_owned(),
        ok: true,
        playing: false,
        speed: 1.0,
        facts: BTreeMap::new(),
    };
    let (publisher, channels) = channels(description, state, Arc::clone(&over));
    let mut running = Running {
        over: Arc::clone(&over),
        threads: Vec::new(),
    };
    match source {
        Source::Sensor {
            domain,
            name,
            options,
        } => {
            let live = Live::new(publisher, domain, name, *options);
            running.spawn("live", move || live.run())?;
        }
        Source::Capture {
            source_config,
            is_endless,
        } => {
            // What is no capture is an error at once.
            Reader::open(&source_config)?;
            if let Origin::Simulation(simulation) = &source_config.origin {
                let simulation = Arc::clone(simulation);
                let over = Arc::clone(&over);
                running.spawn("simulation", move || {
                    simulation.make(|| over.load(Ordering::Relaxed));
                })?;
            }
            let describer = publisher.describer();
            let player = Player::new(publisher, source_config.clone(), is_endless)
                .map_err(|error| CliError::Failed(error.to_string()))?;
            let chosen = player.chosen();
            running.spawn("player", move || player.run())?;
            running.spawn("index", move || {
                index::make(&source_config, &chosen, &describer, || {
                    over.load(Ordering::Relaxed)
                });
            })?;
        }
    }
    Ok((running, channels))
}

impl Running {
    fn spawn(&mut self, name: &str, work: impl FnOnce() + Send + 'static) -> Result<(), CliError> {
        let thread = thread::Builder::new().name(name.to_owned()).spawn(work);
        self.threads.push(thread.map_err(no_thread)?);
        Ok(())
    }
}

fn no_thread(source: io::Error) -> CliError {
    CliError::System {
        what: "start a thread",
        source,
    }
}
