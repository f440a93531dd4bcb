//! Errors of subcommands, and how they are shown.

use std::fmt::Display;
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use crate::daemon::DaemonError;
use crate::daemon::config::ConfigError;
use crate::daemon::record::client::RemoteRecordError;
use crate::files::{self, CalibrationFileError, WriteError};
use crate::input::{Capture, CaptureError, UdpError};
use crate::publish::PublishError;
use crate::text::visible;
use sweepd_client::client::ClientError;
use sweepd_core::sensor::Calibration;

/// Why a command did not complete.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum CliError {
    /// The capture cannot be read.
    #[error(transparent)]
    Capture(#[from] CaptureError),
    /// The calibration cannot be read.
    #[error(transparent)]
    Calibration(#[from] CalibrationFileError),
    /// The configuration cannot be read or is invalid.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// An output cannot be written.
    #[error(transparent)]
    Write(#[from] Arc<WriteError>),
    /// A file cannot be read.
    #[error("cannot read {}: {source}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// What the system says.
        source: io::Error,
    },
    /// Sweeps cannot be shared.
    #[error(transparent)]
    Publish(#[from] PublishError),
    /// Sweeps cannot be received from a daemon.
    #[error(transparent)]
    Client(#[from] ClientError),
    /// The daemon does not record.
    #[error(transparent)]
    RemoteRecord(#[from] RemoteRecordError),
    /// A port cannot be listened on.
    #[error(transparent)]
    Udp(#[from] UdpError),
    /// The daemon cannot start or continue.
    #[error(transparent)]
    Daemon(#[from] DaemonError),
    /// A system call failed that should not: a signal handler, a thread.
    #[error("cannot {what}: {source}")]
    System {
        /// What was tried.
        what: &'static str,
        /// What the system says.
        source: io::Error,
    },
    /// Options that contradict each other, or an invalid value.
    #[error("{0}")]
    Usage(String),
    /// A sensor's web interface does not answer, or does not do what it is asked.
    #[error("{0}")]
    Sensor(String),
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
    /// The command did not complete, and a line on standard error has said why.
    #[error("not all was done")]
    Reported,
}

impl From<WriteError> for CliError {
    fn from(error: WriteError) -> Self {
        Self::Write(Arc::new(error))
    }
}

impl CliError {
    /// Exit code of the program: 78 (EX_CONFIG of sysexits.h) if only another configuration would
    /// help, so that a supervisor need not retry; else 1.
    pub fn exit_code(&self) -> u8 {
        match self {
            Self::Config(ConfigError::Invalid(_)) => 78,
            _ => 1,
        }
    }
}

/// Prints an error on standard error, with its cause if the message does not contain it. A closed
/// pipe (`| head`) is not an error.
pub(super) fn report(error: &CliError) {
    match error {
        CliError::Reported => {}
        // Its lines already begin with their severity.
        CliError::Config(ConfigError::Invalid(problems)) => {
            let _ = writeln!(io::stderr(), "{problems}");
        }
        CliError::Stdout(cause) if cause.kind() == io::ErrorKind::BrokenPipe => {}
        _ => complain("error", error),
    }
}

/// Prints a line on standard error, with all that is hidden in it [visible]. If that is closed, the
/// message is lost.
pub fn complain(severity: &str, message: impl Display) {
    let _ = writeln!(io::stderr(), "{severity}: {}", visible(message));
}

/// Warns of times of a capture that are none.
pub fn warn_of_times(capture: &Capture) {
    if let Some(remark) = capture.remark() {
        complain("warning", format_args!("{}: {remark}", capture.name()));
    }
}

/// Warns of all that is wrong with a capture that was read; `and` is what came of a damaged one.
pub fn warn_of(capture: &Capture, and: &str) {
    if let Some(truncation) = capture.truncation() {
        let name = capture.name();
        complain("warning", format_args!("{name}: {truncation}{and}"));
    }
    warn_of_times(capture);
}

/// Reads a calibration, and shows what there is to know of it.
///
/// # Errors
/// [`CalibrationFileError`].
pub fn read_calibration(path: &Path) -> Result<Calibration, CalibrationFileError> {
    let calibration = files::calibration(path)?;
    for remark in calibration.remarks() {
        let severity = if remark.is_warning { "warning" } else { "note" };
        complain(severity, &remark.text);
    }
    Ok(calibration)
}
