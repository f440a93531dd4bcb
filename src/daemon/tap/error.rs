//! Why the datagrams of a daemon cannot be had, each with what to do about it.

use std::io;
use std::path::PathBuf;

/// Why a daemon cannot offer its datagrams, or a client cannot have them.
#[derive(Debug, thiserror::Error)]
pub enum TapError {
    /// Another daemon listens there.
    #[error("another daemon listens at {}; stop it, or give this one a --root of its own", path.display())]
    Taken {
        /// The socket.
        path: PathBuf,
    },
    /// The socket cannot be made.
    #[error("cannot listen at {}: {source}; the folder must be this daemon's own, and its path short", path.display())]
    Listen {
        /// The socket.
        path: PathBuf,
        /// What the system says.
        source: io::Error,
    },
    /// The system gives no thread.
    #[error(
        "cannot start the thread of the taps: {source}; the limit of threads is reached (ulimit -u, TasksMax=)"
    )]
    Thread {
        /// What the system says.
        source: io::Error,
    },
    /// No daemon is there.
    #[error(
        "no daemon listens at {} ({source}): is `sweepd run` running, and with the same --root? Where no daemon runs, leave \
         out --from",
        path.display()
    )]
    NoDaemon {
        /// The socket.
        path: PathBuf,
        /// What the system says.
        source: io::Error,
    },
    /// The daemon is of another user.
    #[error(
        "the daemon at {} runs as user {daemon} and this program as user {own}: it gives its datagrams to its own user alone. \
         Run this as {daemon} (`sudo -u {daemon} sweepd record ...`)",
        path.display()
    )]
    OtherUser {
        /// The socket.
        path: PathBuf,
        /// Whose the daemon is.
        daemon: String,
        /// Whose this program is.
        own: String,
    },
    /// The daemon has no such sensor.
    #[error("the daemon has no sensor {name}; it has {names}")]
    UnknownSensor {
        /// What was asked for.
        name: String,
        /// What there is.
        names: String,
    },
    /// Too many ask.
    #[error("the daemon has as many recordings under way as it allows; stop one")]
    Busy,
    /// The daemon is of another release.
    #[error(
        "the daemon speaks version {daemon} and this program version {own}: use the same release of sweepd"
    )]
    Version {
        /// Of the daemon.
        daemon: u16,
        /// Of this program.
        own: u16,
    },
    /// Who answers is no daemon, or a broken one.
    #[error("who listens at {} is no sweepd daemon: it sent {what}", path.display())]
    Format {
        /// The socket.
        path: PathBuf,
        /// What came.
        what: String,
    },
    /// The daemon has gone without a word, or says nothing any more.
    #[error("the daemon at {} does not answer ({source}): has it been killed? What came before is kept", path.display())]
    Gone {
        /// The socket.
        path: PathBuf,
        /// What the system says.
        source: io::Error,
    },
}
