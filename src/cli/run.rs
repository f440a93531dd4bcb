//! `sweepd run`: the daemon.

mod journal;

use std::io::IsTerminal;
use std::path::{Path, PathBuf};

use tracing::info;
use tracing_subscriber::EnvFilter;

use self::journal::Prioritised;
use super::CliError;
use crate::daemon::config::{Change, Config, Effect};
use crate::daemon::control::{self, Reload, Reread};
use sweepd_client::publish::{Domain, DomainError, Keeper};

/// Variable that says what is logged, in the directives of tracing-subscriber.
const LOG: &str = "SWEEPD_LOG";

/// Options of `sweepd run`.
#[derive(Clone, Debug, clap::Args)]
#[command(after_help = "\
SIGTERM or Ctrl-C ends it, SIGHUP reads the configuration anew. Its log goes to standard error;
systemd, if it runs it, hears when it is ready and how it is.

Examples:
  sweepd run --config /etc/sweepd/sweepd.toml
  SWEEPD_LOG=sweepd=debug sweepd run --config sweepd.toml")]
pub struct Args {
    /// What is to run, TOML
    #[arg(short, long, value_name = "FILE")]
    config: PathBuf,
    /// What is logged: error, warn, info, debug or trace [default: the variable SWEEPD_LOG, else info]
    #[arg(long, value_name = "LEVEL")]
    log: Option<tracing::Level>,
}

/// Runs the command.
///
/// # Errors
/// [`CliError`]: a configuration that cannot be meant, and whatever keeps the daemon from starting or going on.
pub fn run(args: &Args) -> Result<(), CliError> {
    let config = Config::read(&args.config)?;
    log(args.log)?;
    let sensors: Vec<String> = config.sensors.iter().map(|one| format!("{} ({})", one.name, one.address)).collect();
    info!("sweepd {} with {}: {}", env!("CARGO_PKG_VERSION"), args.config.display(), sensors.join(", "));
    let domain = Domain::at_or_default(config.daemon.root.as_deref());
    // Its folder is made here, since the taps' socket is there too.
    domain.prepare().map_err(in_words_of_the_file)?;
    Ok(control::run(config, &Keeper::new(&domain)?, domain.root(), reread(&args.config))?)
}

/// Others name the folder by an option; this command has a configuration with a key of that name.
fn in_words_of_the_file(error: DomainError) -> CliError {
    CliError::Usage(error.to_string().replace("--root", "`root` in the configuration"))
}

/// Log lines to standard error, for a person or the journal, which knows the time itself.
fn log(level: Option<tracing::Level>) -> Result<(), CliError> {
    let wrong = |error| CliError::Usage(format!("{LOG}: {error}"));
    let filter = match (level, std::env::var(LOG)) {
        (Some(level), _) => EnvFilter::new(level.as_str()),
        (None, Ok(directives)) => EnvFilter::try_new(directives).map_err(wrong)?,
        (None, Err(_)) => EnvFilter::new("info"),
    };
    // When nobody reads the log any more, the sensors go on: complaining of that on standard error would panic.
    let lines =
        tracing_subscriber::fmt().with_env_filter(filter).with_writer(std::io::stderr).log_internal_errors(false);
    if journal::hears_stderr() {
        lines.event_format(Prioritised::default()).init();
    } else {
        lines.compact().with_target(false).with_ansi(std::io::stderr().is_terminal()).init();
    }
    Ok(())
}

/// The configuration anew, for SIGHUP.
fn reread(path: &Path) -> Reread {
    let path = path.to_owned();
    Box::new(move |old: &Config| {
        let new = Config::read(&path).map_err(|error| error.to_string())?;
        let needs_restart = |change: &Change| change.effect == Effect::Restart;
        let needs_restart = old.changes(&new).iter().filter(|it| needs_restart(it)).map(ToString::to_string).collect();
        Ok(Reload { config: old.reloaded(&new), needs_restart })
    })
}
