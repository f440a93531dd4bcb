//! What goes wrong in a subcommand, and how it is shown.

use std::fmt::Display;
use std::io::{self, Write};
use std::path::PathBuf;
use std::sync::Arc;

use crate::capture::{CaptureError, RecordError, UdpError};
use crate::daemon::DaemonError;
use crate::daemon::config::ConfigError;
use crate::daemon::record::client::RemoteRecordError;
use crate::export::WriteError;
use crate::files::CalibrationFileError;
use sweepd_client::client::ClientError;
use sweepd_client::publish::PublishError;

/// Why a command did not do all that was asked.
#[derive(Debug, thiserror::Error)]
pub enum CliError {
    /// The capture cannot be read.
    #[error(transparent)]
    Capture(#[from] CaptureError),
    /// The calibration cannot be read.
    #[error(transparent)]
    Calibration(#[from] CalibrationFileError),
    /// The configuration cannot be read or meant.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// An output cannot be written.
    #[error(transparent)]
    Write(#[from] WriteError),
    /// A file cannot be read.
    #[error("cannot read {}: {source}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// What the system says.
        source: io::Error,
    },
    /// A recording cannot be written.
    #[error(transparent)]
    Record(#[from] Arc<RecordError>),
    /// Sweeps cannot be shared.
    #[error(transparent)]
    Publish(#[from] PublishError),
    /// No sweeps can be had from a daemon.
    #[error(transparent)]
    Client(#[from] ClientError),
    /// The daemon does not record.
    #[error(transparent)]
    RemoteRecord(#[from] RemoteRecordError),
    /// A port cannot be listened on.
    #[error(transparent)]
    Udp(#[from] UdpError),
    /// The daemon cannot start, or cannot go on.
    #[error(transparent)]
    Daemon(#[from] DaemonError),
    /// The system refuses what it never should: a signal handler, a thread.
    #[error("cannot {what}: {source}")]
    System {
        /// What was tried.
        what: &'static str,
        /// What the system says.
        source: io::Error,
    },
    /// Options that contradict each other, or a value that cannot be meant.
    #[error("{0}")]
    Usage(String),
    /// The network refuses.
    #[error("cannot send to {to}: {source}")]
    Send {
        /// Where to.
        to: std::net::SocketAddr,
        /// What the system says.
        source: io::Error,
    },
    /// Standard output is gone or full.
    #[error("cannot write to standard output: {0}")]
    Stdout(io::Error),
    /// Something was not done, and a line on standard error has said why.
    #[error("not all was done")]
    Reported,
}

impl From<RecordError> for CliError {
    fn from(error: RecordError) -> Self {
        Self::Record(Arc::new(error))
    }
}

impl CliError {
    /// What the program ends with: 78 (EX_CONFIG of sysexits.h) where only another configuration
    /// would help, so that a supervisor need not try again; else 1.
    pub fn exit_code(&self) -> u8 {
        match self {
            Self::Config(ConfigError::Invalid(_)) => 78,
            _ => 1,
        }
    }
}

/// Shows an error on standard error, with its cause where the message does not hold it. A reader
/// that went away (`| head`) is not an error.
pub fn report(error: &CliError) {
    match error {
        CliError::Reported => {}
        // Its lines begin with their severity themselves.
        CliError::Config(ConfigError::Invalid(problems)) => {
            let _ = writeln!(io::stderr(), "{problems}");
        }
        CliError::Stdout(cause) if cause.kind() == io::ErrorKind::BrokenPipe => {}
        _ => complain("error", error),
    }
}

/// A line on standard error. When even that is gone, the message is lost.
pub(super) fn complain(severity: &str, message: impl Display) {
    let _ = writeln!(io::stderr(), "{severity}: {message}");
}
