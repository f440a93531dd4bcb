//! `sweepd view`: sweeps on a page in a browser.
//!
//! ```text
//! source (a thread)                   channels          server (tasks)
//! capture, simulation, sensor  ──────>  newest  ──┬──>  http, socket, tuning  ──────> pages
//!                              <──────  commands <┼───
//!                                                 └──>  http, foxglove  ───────────> viewers
//! ```
//!
//! A consumer like any other, in a process of its own: the daemon serves no page, and a browser
//! holds up nothing but its own socket.

mod channels;
mod command;
mod foxglove;
#[cfg(any(test, fuzzing))]
pub mod fuzz;
mod http;
mod page;
mod socket;
pub(crate) mod source;
mod tuning;

pub use command::{Args, run};

use std::net::{SocketAddr, TcpListener};

use self::channels::Kind;
use self::http::Server;
use self::source::reader::{Origin, SourceConfig};
use sweepd::cli::CliError;
use sweepd::cli::options::SegmentOptions;
use sweepd_client::client::Domain;

/// What is looked at.
pub(crate) enum Source {
    /// A capture or a simulation.
    Capture {
        source_config: SourceConfig,
        /// Begins again at the end.
        is_endless: bool,
    },
    /// A sensor of the running daemon: of this name, or the only one.
    Sensor {
        domain: Domain,
        name: Option<String>,
        /// What is to hold in place of the daemon's settings.
        options: Box<SegmentOptions>,
    },
}

impl Source {
    /// Its kind and its name.
    fn kind(&self) -> (Kind, String) {
        match self {
            Self::Capture { source_config, .. } => match &source_config.origin {
                Origin::Capture(path) => (Kind::Capture, path.display().to_string()),
                Origin::Simulation(simulation) => (Kind::Simulation, simulation.name()),
            },
            Self::Sensor {
                name: Some(name), ..
            } => (Kind::Sensor, name.clone()),
            Self::Sensor { name: None, .. } => (Kind::Choice, String::new()),
        }
    }
}

/// Shows a source on the page until the program is to end.
///
/// # Errors
/// [`CliError`]: the source cannot be opened, or the system refuses. `ready` is called when the page
/// can be opened. Web pages of these `origins` may read.
pub(crate) fn serve(
    source: Source,
    listener: TcpListener,
    address: SocketAddr,
    origins: Vec<String>,
    ready: impl FnOnce() -> Result<(), CliError>,
) -> Result<(), CliError> {
    let (running, channels) = source::start(source)?;
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .max_blocking_threads(2)
        .build()
        .map_err(system)?;
    let served = runtime.block_on(async {
        listener.set_nonblocking(true).map_err(system)?;
        let listener = tokio::net::TcpListener::from_std(listener).map_err(system)?;
        let server = Server::new(listener, address, channels, origins);
        let ended = end()?;
        ready()?;
        tokio::select! {
            never = server.serve() => match never {},
            () = ended => Ok(()),
        }
    });
    // What is being segmented for a page is not awaited.
    runtime.shutdown_background();
    drop(running);
    served
}

/// Comes with the signal that ends the program.
fn end() -> Result<impl Future<Output = ()>, CliError> {
    use tokio::signal::unix::{SignalKind, signal};
    let mut interrupt = signal(SignalKind::interrupt()).map_err(system)?;
    let mut terminate = signal(SignalKind::terminate()).map_err(system)?;
    let mut hangup = signal(SignalKind::hangup()).map_err(system)?;
    Ok(async move {
        tokio::select! {
            _ = interrupt.recv() => {}
            _ = terminate.recv() => {}
            _ = hangup.recv() => {}
        }
    })
}

fn system(source: std::io::Error) -> CliError {
    CliError::System {
        what: "serve the page",
        source,
    }
}
