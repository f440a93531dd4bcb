//! `sweepd run`: the daemon.

mod journal;

use std::ffi::OsString;
use std::io::IsTerminal;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use signal_hook::consts::SIGHUP;
use signal_hook::flag;
use tracing::{info, warn};
use tracing_subscriber::filter::{LevelFilter, Targets};
use tracing_subscriber::layer::SubscriberExt;
use tracing_subscriber::util::SubscriberInitExt;

use self::journal::Prioritised;
use super::CliError;
use crate::daemon::config::{Config, ConfigError, Effect};
use crate::daemon::control::{self, Reload, Reread};
use crate::publish::{Domain, Keeper};
use crate::text::visible;

/// Variable with what is logged: a level, or levels of modules, as tracing-subscriber's `Targets` reads them.
const LOG: &str = "SWEEPD_LOG";

/// Options of `sweepd run`.
#[derive(Clone, Debug, clap::Args)]
#[command(group(clap::ArgGroup::new("sensors of the daemon").required(true).args(["config", "sensors"])))]
#[command(after_help = "\
SIGTERM or Ctrl-C ends the daemon, SIGHUP makes it reload its configuration. Its log goes to \
standard error. Under systemd, it reports when it is ready, and its state.

Examples:
  sweepd run --sensor 192.168.1.201
  sweepd run --config /etc/sweepd/sweepd.toml
  SWEEPD_LOG=sweepd=debug sweepd run --config sweepd.toml")]
pub struct Args {
    /// Configuration file, TOML
    #[arg(short, long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// Run this sensor without a file, all else at its default: its address, as `address` in a
    /// file, and its model if it is not to be detected from the packets. It is called `sensor`;
    /// several are `sensor-1`, `sensor-2` and so on
    #[arg(long = "sensor", value_name = "ADDRESS[,MODEL]")]
    sensors: Vec<String>,
    /// Folder by which the daemon and its consumers find each other [default: `root` of the
    /// configuration; else $SWEEPD_ROOT; else /run/sweepd/iox2 where there is a /run/sweepd, else
    /// /tmp/sweepd/iox2]
    #[arg(long, value_name = "DIR")]
    root: Option<PathBuf>,
    /// What is logged: error, warn, info, debug or trace [default: the variable SWEEPD_LOG, else
    /// info]
    #[arg(long, value_name = "LEVEL")]
    log: Option<tracing::Level>,
}

/// Keeps SIGHUP from ending the daemon that these words start, until it listens to signals. The flag
/// is set by one that came.
pub fn hold_hangup(words: &[OsString]) -> Arc<AtomicBool> {
    let came = Arc::default();
    if words.get(1).is_some_and(|word| word == "run") {
        // Where the system refuses, such a signal ends it as ever.
        let _ = flag::register(SIGHUP, Arc::clone(&came));
    }
    came
}

/// Runs the command. `hangup` is set by a SIGHUP that came before the daemon listens to signals.
///
/// # Errors
/// [`CliError`]: an invalid configuration, or an error that keeps the daemon from starting or
/// continuing.
pub fn run(args: &Args, hangup: &AtomicBool) -> Result<(), CliError> {
    let config = args.read()?;
    log(args.log)?;
    let sensors: Vec<String> = config
        .sensors
        .iter()
        .map(|one| format!("{} ({})", one.name, one.address))
        .collect();
    let from = args
        .config
        .as_ref()
        .map_or_else(|| "--sensor".to_owned(), |file| visible(file.display()));
    info!(
        "sweepd {} with {from}: {}",
        crate::VERSION,
        sensors.join(", ")
    );
    config.warnings.iter().for_each(|what| warn!("{what}"));
    if args.config.is_none() {
        info!(
            "`sweepd watch {}` shows what comes of it",
            config.sensors[0].name
        );
    }
    let domain = Domain::at_or_default(config.daemon.root.as_deref());
    // The folder is made here, since it also holds the control socket.
    domain
        .prepare()
        .map_err(|error| CliError::Failed(error.to_string()))?;
    Ok(control::run(
        config,
        &Keeper::new(&domain)?,
        domain.root(),
        reread(args.clone()),
        hangup,
    )?)
}

impl Args {
    /// The configuration that the file or the options name.
    fn read(&self) -> Result<Config, ConfigError> {
        let mut config = match &self.config {
            Some(file) => Config::read(file)?,
            None => Config::parse(Path::new("--sensor"), &self.sensors_as_text())?,
        };
        if self.root.is_some() {
            config.daemon.root.clone_from(&self.root);
        }
        Ok(config)
    }

    /// The configuration file that is equivalent to `--sensor`, so that the same checks apply.
    fn sensors_as_text(&self) -> String {
        let mut text = String::new();
        for (index, sensor) in self.sensors.iter().enumerate() {
            let name = if self.sensors.len() == 1 {
                "sensor".to_owned()
            } else {
                format!("sensor-{}", index + 1)
            };
            let (address, model) = match sensor.split_once(',') {
                Some((address, model)) => (address, Some(model)),
                None => (&sensor[..], None),
            };
            text += &format!(
                "[[sensor]]\nname = \"{name}\"\naddress = {}\n",
                toml::Value::from(address)
            );
            if let Some(model) = model {
                text += &format!("model = {}\n", toml::Value::from(model));
            }
        }
        text
    }
}

/// Log lines to standard error, for a terminal or the journal, which adds the time itself.
fn log(level: Option<tracing::Level>) -> Result<(), CliError> {
    let filter = match (level, std::env::var(LOG)) {
        (Some(level), _) => Targets::new().with_default(level),
        (None, Ok(levels)) if !levels.is_empty() => levels.parse().map_err(|_| {
            CliError::Usage(format!(
                "{LOG}={}: expected a level, as in `debug`, or those of parts of the program, as in \
                 `info,sweepd::daemon=debug`",
                visible(&levels)
            ))
        })?,
        (None, _) => Targets::new().with_default(LevelFilter::INFO),
    };
    // Without a reader of the log the daemon continues: an internal error on standard error would
    // panic.
    let lines = tracing_subscriber::fmt()
        .with_max_level(LevelFilter::TRACE)
        .with_writer(std::io::stderr)
        .log_internal_errors(false);
    if journal::hears_stderr() {
        let lines = lines.event_format(Prioritised::default());
        lines.finish().with(filter).init();
    } else {
        let lines = lines.compact().with_target(false);
        // tracing-subscriber obeys NO_COLOR unless `with_ansi` is called.
        let lines = match std::io::stderr().is_terminal() {
            true => lines,
            false => lines.with_ansi(false),
        };
        lines.finish().with(filter).init();
    }
    Ok(())
}

/// Reads the configuration again, for SIGHUP.
fn reread(args: Args) -> Reread {
    Arc::new(move |old: &Config| {
        if args.config.is_none() {
            return Err("it was started with --sensor, so there is no file to read".to_owned());
        }
        let new = args.read().map_err(|error| error.to_string())?;
        let mut taken = Vec::new();
        let mut needs_restart = Vec::new();
        for change in old.changes(&new) {
            match change.effect {
                Effect::Reload => taken.push(change.to_string()),
                Effect::Restart => needs_restart.push(change.to_string()),
            }
        }
        Ok(Reload {
            config: old.reloaded(&new),
            taken,
            needs_restart,
        })
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Parser;

    #[derive(Parser)]
    struct Line {
        #[command(flatten)]
        args: Args,
    }

    fn read(words: &[&str]) -> Result<Config, ConfigError> {
        Line::try_parse_from([&["run"], words].concat())
            .unwrap()
            .args
            .read()
    }

    #[test]
    fn sensors_without_a_file_are_those_of_a_file_that_names_them() {
        let config = read(&[
            "--sensor",
            "10.0.0.7:2000,hdl32e",
            "--sensor",
            "10.0.0.8",
            "--root",
            "/r",
        ])
        .unwrap();
        let file = Config::parse(
            Path::new(""),
            "root = '/r'\n[[sensor]]\nname = 'sensor-1'\naddress = '10.0.0.7:2000'\nmodel = 'hdl32e'\n\
             [[sensor]]\nname = 'sensor-2'\naddress = '10.0.0.8'",
        );
        let file = file.unwrap();
        assert_eq!(
            (file.changes(&config), config.sensors.len()),
            (Vec::new(), 2)
        );
        assert_eq!(
            (&config.daemon, config.sensors[1].address),
            (&file.daemon, file.sensors[1].address)
        );
        assert_eq!(
            read(&["--sensor", "10.0.0.7"]).unwrap().sensors[0].name,
            "sensor"
        );
    }

    #[test]
    fn what_is_wrong_is_shown_in_what_was_given() {
        for (given, part) in [
            ("10.0.0", "10.0.0"),
            ("10.0.0.1,vlp17", "vlp17"),
            ("10.0.0.1,\"\n", "model"),
        ] {
            let error = read(&["--sensor", given]).unwrap_err().to_string();
            assert!(
                error.contains("--sensor:") && error.contains(part),
                "{error}"
            );
        }
        for words in [
            &["run"][..],
            &["run", "--sensor", "10.0.0.1", "--config", "a"],
        ] {
            assert!(Line::try_parse_from(words).is_err(), "{words:?}");
        }
    }
}
