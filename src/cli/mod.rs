//! The command line: one file a subcommand, and what they share.

// The macros panic when the reader has gone away: write what can fail with `write!`, and errors
// with `complain`.
#![deny(clippy::print_stdout, clippy::print_stderr)]

pub mod calib;
pub mod config;
pub mod doctor;
pub mod inspect;
#[cfg(feature = "lab")]
pub mod lab;
pub mod options;
pub mod output;
pub mod play;
pub mod publish;
pub mod record;
pub mod replay;
pub mod run;
pub mod send;
pub mod signals;
pub mod summary;
pub mod tables;
pub mod watch;

use std::ffi::OsString;
use std::fmt::Display;
use std::io::{self, Write};
use std::path::PathBuf;
use std::sync::Arc;

use clap::error::{ContextKind, ContextValue, ErrorKind};
use clap::{Parser, Subcommand};

use crate::capture::{CaptureError, RecordError, UdpError};
use crate::daemon::DaemonError;
use crate::daemon::config::ConfigError;
use crate::daemon::tap::TapError;
use crate::export::WriteError;
use crate::files::CalibrationFileError;
use sweepd_client::client::ClientError;
use sweepd_client::publish::PublishError;

/// Turns the packets of a spinning Velodyne into range images, cut into ground and numbered objects
#[derive(Debug, Parser)]
#[command(name = "sweepd", version = crate::VERSION, about, long_about = None, max_term_width = 100)]
#[command(after_help = "\
Example:
  sweepd replay pcap_fixtures/street_vlp16.pcap.gz --png out")]
pub struct Cli {
    /// What to do.
    #[command(subcommand)]
    pub command: Command,
}

/// The subcommands.
#[derive(Debug, Subcommand)]
pub enum Command {
    /// Run the daemon: live sensors in, sweeps with labels to all programs of this host
    Run(run::Args),
    /// Replay a capture: decode it, segment every sweep, and show or write what comes out
    Replay(Box<replay::Args>),
    /// Record live sensors to a capture, with the kernel's time stamps
    Record(record::Args),
    /// Watch the sweeps that a running daemon shares
    Watch(Box<watch::Args>),
    /// Listen to the sensors and say what is wrong, and how to mend it
    Doctor(doctor::Args),
    /// Say what is in a capture without decoding it all
    Inspect(inspect::Args),
    /// Show and compare calibrations, and read that of an HDL-64E from its packets
    Calib(calib::Args),
    /// Check the daemon's configuration, or print one to begin with
    Config(config::Args),
    /// What needs no sensor.
    #[cfg(feature = "lab")]
    #[command(flatten)]
    Lab(lab::Command),
}

/// The command line of this process. One that is wrong ends the process with an error and exit code
/// 2.
pub fn parse() -> Cli {
    let words: Vec<OsString> = std::env::args_os().collect();
    Cli::try_parse_from(&words).unwrap_or_else(|mut error| {
        if let Some(tip) = tip(&error, &words) {
            error.insert(
                ContextKind::Suggested,
                ContextValue::StyledStrs(vec![tip.into()]),
            );
        }
        error.exit()
    })
}

/// What was meant by a word that clap does not expect.
fn tip(error: &clap::Error, words: &[OsString]) -> Option<String> {
    let word = match (error.kind(), error.get(ContextKind::InvalidArg)?) {
        (ErrorKind::UnknownArgument, ContextValue::String(word)) => word,
        _ => return None,
    };
    let is_times = words
        .windows(2)
        .any(|two| two[0] == "--loop" && two[1] == word[..]);
    is_times.then(|| format!("a number of times needs an equals sign: --loop={word}"))
}

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
    /// The daemon's datagrams cannot be had.
    #[error(transparent)]
    Tap(#[from] TapError),
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
/// that went away (`| head`) is none.
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
fn complain(severity: &str, message: impl Display) {
    let _ = writeln!(io::stderr(), "{severity}: {message}");
}
