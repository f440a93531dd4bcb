//! Errors of subcommands, and how they are shown.

use std::fmt::Display;
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use crate::daemon::DaemonError;
use crate::daemon::config::ConfigError;
use crate::daemon::record::client::RemoteRecordError;
use crate::files::{self, CalibrationFileError, MaskFileError, WriteError};
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
    /// The picture of a mask cannot be read.
    #[error(transparent)]
    Mask(#[from] MaskFileError),
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
    /// What was to be read is not there.
    #[error("{0}")]
    NoInput(String),
    /// What was asked for cannot be had.
    #[error("{0}")]
    Failed(String),
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

/// Exit codes of all programs; those above 2 are of sysexits.h.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Exit {
    /// Also where the reader of standard output had enough.
    Done = 0,
    /// All that has no code of its own.
    Failed = 1,
    /// clap's.
    Usage = 2,
    /// EX_NOINPUT.
    NoInput = 66,
    /// EX_CONFIG: only another configuration helps, so that a supervisor need not retry.
    Config = 78,
}

impl Exit {
    const ALL: [Self; 5] = [
        Self::Done,
        Self::Failed,
        Self::Usage,
        Self::NoInput,
        Self::Config,
    ];

    /// What it means.
    fn meaning(self) -> &'static str {
        match self {
            Self::Done => "done, or the reader of standard output had enough (`| head`)",
            Self::Failed => "failed, or something is wrong: standard error says what",
            Self::Usage => "wrong options or arguments",
            Self::NoInput => "a file that was given is not there, is a folder, or may not be read",
            Self::Config => "the configuration is invalid: correct it, then start again",
        }
    }

    /// All of them, a line each.
    pub fn table() -> String {
        let lines = Self::ALL.map(|exit| format!("  {:<4}{}", exit as u8, exit.meaning()));
        format!("Exit codes:\n{}", lines.join("\n"))
    }
}

impl CliError {
    /// Exit code of the program.
    pub fn exit(&self) -> Exit {
        match self {
            Self::Stdout(cause) if cause.kind() == io::ErrorKind::BrokenPipe => Exit::Done,
            Self::Usage(_) => Exit::Usage,
            Self::Config(ConfigError::Invalid(_)) => Exit::Config,
            Self::NoInput(_) => Exit::NoInput,
            _ if self.cure().is_some() => Exit::NoInput,
            _ => Exit::Failed,
        }
    }

    /// What to do about a file that was given and is not there, is a folder or may not be read, to follow
    /// the error. Other faults, as a disk that does not answer, may pass: they have no cure here.
    fn cure(&self) -> Option<&'static str> {
        let source = match self {
            Self::Capture(CaptureError::Open { source, .. })
            | Self::Calibration(CalibrationFileError::Io { source, .. })
            | Self::Config(ConfigError::Read { source, .. })
            | Self::Mask(MaskFileError::Io { source, .. })
            | Self::Read { source, .. } => source,
            _ => return None,
        };
        match source.kind() {
            io::ErrorKind::NotFound | io::ErrorKind::NotADirectory => Some("; check the path"),
            io::ErrorKind::IsADirectory => Some("; give a file in it"),
            io::ErrorKind::PermissionDenied => Some("; allow this user to read it"),
            _ => None,
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
        _ if error.exit() == Exit::Done => {}
        _ => complain(
            "error",
            format_args!("{error}{}", error.cure().unwrap_or_default()),
        ),
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

#[cfg(test)]
mod tests {
    use super::*;

    /// A unit of systemd is not started again after 66.
    #[test]
    fn what_may_pass_is_tried_again() {
        let ends = |kind: io::ErrorKind| {
            let source = kind.into();
            CliError::Config(ConfigError::Read {
                path: "a.toml".into(),
                source,
            })
            .exit()
        };
        assert_eq!(ends(io::ErrorKind::NotFound), Exit::NoInput);
        assert_eq!(ends(io::ErrorKind::PermissionDenied), Exit::NoInput);
        for kind in [
            io::ErrorKind::TimedOut,
            io::ErrorKind::Other,
            io::ErrorKind::Interrupted,
        ] {
            assert_eq!(ends(kind), Exit::Failed, "{kind}");
        }
    }
}
