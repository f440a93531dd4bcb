//! `sweepd sensor`: shows and sets what a sensor is set to, through its web interface.

use std::fmt::Write as _;

use serde::Serialize;

use super::CliError;
use super::error::complain;
use super::stream::{print, print_json};
use crate::sensor_settings::{
    Difference, FieldOfView, Host, PhaseLock, Port, Returns, Rpm, Settings, Switch,
};
use crate::web_interface::{CommandError, Page, PageAddress, WebInterface};

/// Options of `sweepd sensor`.
#[derive(Clone, Debug, clap::Args)]
#[command(after_help = "\
VLP-16, Puck LITE and Hi-Res, VLP-32C, VLS-128 and newer HDL-32E have a web interface. An HDL-64E has none: it is set over its serial port.

Examples:
  sweepd sensor 192.168.1.201 show
  sweepd sensor 192.168.1.201 set --rpm 1200 --returns dual")]
pub struct Args {
    /// Address of the sensor, with the port of its web page behind a port forwarder
    #[arg(value_name = "ADDR")]
    at: PageAddress,
    #[command(subcommand)]
    action: Action,
}

/// What to do.
#[derive(Clone, Debug, clap::Subcommand)]
enum Action {
    /// Show what the sensor is set to
    #[command(after_help = "\
Example:
  sweepd sensor 192.168.1.201 show
  sweepd sensor 192.168.1.201 show --json")]
    Show {
        /// One JSON object on standard output
        #[arg(long)]
        json: bool,
    },
    /// Show what would be changed; with --yes change it, one setting a second, and read it back
    Set(SetArgs),
}

/// Options of `sweepd sensor ADDR set`.
#[derive(Clone, Debug, clap::Args)]
#[command(after_help = "\
The exit status is 0 only if all is as asked for.

Examples:
  sweepd sensor 192.168.1.201 set --rpm 1200 --returns dual
  sweepd sensor 192.168.1.201 set --rpm 1200 --returns dual --save --yes
  sweepd sensor 192.168.1.201 set --fov 270-90 --yes
  sweepd sensor 192.168.1.201 set --rpm 600 --yes --json")]
struct SetArgs {
    /// Turns a minute, 300 to 1200 in steps of 60
    #[arg(long)]
    rpm: Option<Rpm>,
    /// Returns: strongest, last or dual
    #[arg(long, value_name = "MODE")]
    returns: Option<Returns>,
    /// Azimuths to measure, clockwise, whole degrees; 0-359 is all of a turn
    #[arg(long, value_name = "START-END")]
    fov: Option<FieldOfView>,
    /// Lasers: on or off
    #[arg(long, value_name = "STATE")]
    laser: Option<Switch>,
    /// Where packets are sent to: an address of a host, 255.255.255.255, or a multicast group
    #[arg(long, value_name = "IP")]
    host: Option<Host>,
    /// Port that data packets are sent to
    #[arg(long, value_name = "PORT")]
    data_port: Option<Port>,
    /// Port that position packets are sent to
    #[arg(long, value_name = "PORT")]
    position_port: Option<Port>,
    /// Azimuth of the head at the pulse per second, degrees, or off
    #[arg(long, value_name = "DEG")]
    phase_lock: Option<PhaseLock>,
    /// Also store all present settings of the sensor, so that they survive a loss of power
    #[arg(long)]
    save: bool,
    /// Make the changes; without it they are only shown
    #[arg(long)]
    yes: bool,
    /// One JSON object on standard output, at the end
    #[arg(long)]
    json: bool,
}

impl SetArgs {
    fn wanted(&self) -> Settings {
        Settings {
            rpm: self.rpm,
            returns: self.returns,
            fov: self.fov,
            laser: self.laser,
            host: self.host,
            data_port: self.data_port,
            position_port: self.position_port,
            phase_lock: self.phase_lock,
        }
    }
}

/// Shows or sets.
///
/// # Errors
/// [`CliError::Sensor`] if the sensor does not answer or does not do it, and says how far it came.
pub fn run(args: &Args) -> Result<(), CliError> {
    let interface = WebInterface::new(args.at).map_err(|source| CliError::System {
        what: "ask the sensor",
        source,
    })?;
    let command = Command {
        at: args.at,
        interface,
    };
    match &args.action {
        Action::Show { json: true } => command.show_json(),
        Action::Show { json: false } => command.show(),
        Action::Set(set) => command.set(set),
    }
}

/// What `show --json` prints.
#[derive(Serialize)]
struct ShowReport {
    address: String,
    identity: Option<String>,
    #[serde(flatten)]
    settings: Settings,
    measured_rpm: Option<f64>,
    pps: Option<String>,
}

/// What `set --json` prints.
#[derive(Serialize)]
struct SetReport {
    address: String,
    /// Whether it is set as wanted.
    done: bool,
    saved: bool,
    /// What it was set to before.
    found: Settings,
    wanted: Settings,
}

/// A command to one sensor.
struct Command {
    at: PageAddress,
    interface: WebInterface,
}

impl Command {
    fn show(&self) -> Result<(), CliError> {
        let page = self.read()?;
        let mut shown = String::new();
        if let Some(identity) = self.interface.identity() {
            let _ = writeln!(shown, "{identity}");
        }
        for (name, value) in page.settings.list() {
            let value = value.as_deref().unwrap_or("not told");
            let _ = writeln!(shown, "{name:<15}{value}");
        }
        if let Some(rpm) = page.measured_rpm {
            let _ = writeln!(shown, "{:<15}{rpm:.0} rpm", "turns at");
        }
        if let Some(pps) = page.pps {
            let _ = writeln!(shown, "{:<15}{pps}", "pulse (PPS)");
        }
        print(&shown)
    }

    fn show_json(&self) -> Result<(), CliError> {
        let page = self.read()?;
        print_json(&ShowReport {
            address: self.at.to_string(),
            identity: self.interface.identity(),
            settings: page.settings,
            measured_rpm: page.measured_rpm,
            pps: page.pps,
        })
    }

    fn set(&self, args: &SetArgs) -> Result<(), CliError> {
        let wanted = args.wanted();
        if wanted == Settings::default() && !args.save {
            let what = "nothing to set: give a setting, such as --rpm 600, or --save";
            return Err(CliError::Usage(what.to_owned()));
        }
        let page = self.read()?;
        if let Some(PhaseLock::At(_)) = wanted.phase_lock
            && page.pps.as_deref().is_some_and(|pps| pps != "Locked")
        {
            let pps = page.pps.as_deref().unwrap_or_default();
            let why = "the phase is locked to the pulse per second";
            complain("warning", format_args!("{why}, which is {pps}"));
        }
        let differences = wanted.differences(&page.settings);
        let is_work = !differences.is_empty() || args.save;
        if !args.json {
            print(planned(&differences, is_work && !args.yes))?;
        }
        let does = is_work && args.yes;
        if does {
            self.change(&wanted, &differences)?;
            if args.save {
                self.save()?;
            }
        }
        if args.json {
            return print_json(&SetReport {
                address: self.at.to_string(),
                done: does || differences.is_empty(),
                saved: does && args.save,
                found: page.settings,
                wanted,
            });
        }
        match (does, args.save) {
            (false, _) => Ok(()),
            (true, true) => print("saved: it starts like this\n"),
            (true, false) => print("done, until it loses power: --save keeps it\n"),
        }
    }

    /// Sets one after the other, and reads them back.
    fn change(&self, wanted: &Settings, differences: &[Difference]) -> Result<(), CliError> {
        for (index, difference) in differences.iter().enumerate() {
            if let Err(error) = self.interface.set(difference.name, wanted) {
                return Err(self.stopped(error, wanted, differences, index));
            }
        }
        if differences.is_empty() {
            return Ok(());
        }
        let found = self.interface.read_back(wanted).map_err(|why| {
            let all = names(differences);
            self.error(format_args!(
                "it took {all}, and cannot be read back: {why}; `show` says what it is set to once it answers"
            ))
        })?;
        let left = wanted.differences(&found);
        if left.is_empty() {
            return Ok(());
        }
        let left: Vec<String> = left.iter().map(ToString::to_string).collect();
        Err(self.error(format_args!(
            "it took all, and is not set so when it is read back: {}; its firmware may not know this: try its web page",
            left.join(", ")
        )))
    }

    /// How far it came.
    fn stopped(
        &self,
        error: CommandError,
        wanted: &Settings,
        differences: &[Difference],
        at: usize,
    ) -> CliError {
        let (done, rest) = differences.split_at(at);
        let mut parts = vec![error.to_string()];
        if !done.is_empty() {
            parts.push(format!("was set: {}", names(done)));
        }
        let (failed, rest) = rest.split_at(rest.len().min(1));
        match error {
            CommandError::Unknown(_) => parts.push(format!("may be set: {}", names(failed))),
            _ => parts.push(format!("was not set: {}", names(failed))),
        }
        if !rest.is_empty() {
            parts.push(format!("was not tried: {}", names(rest)));
        }
        match self.interface.read() {
            Ok(page) => {
                let left = wanted.differences(&page.settings);
                parts.push(match left.is_empty() {
                    true => "it says that all is set".to_owned(),
                    false => format!("it says that this is left: {}", names(&left)),
                });
            }
            Err(_) => parts.push("`show` says what it is set to, once it answers".to_owned()),
        }
        self.error(parts.join("; "))
    }

    fn save(&self) -> Result<(), CliError> {
        self.interface.save().map_err(|error| {
            let sure = match error {
                CommandError::Unknown(_) => "may not have saved it",
                _ => "did not save it",
            };
            self.error(format_args!(
                "it is set as wanted, and {sure}: {error}; run this again"
            ))
        })
    }

    fn read(&self) -> Result<Page, CliError> {
        self.interface.read().map_err(|why| {
            self.error(format_args!(
                "no settings can be read: {why}; is it powered and on this network? `sweepd doctor` looks. An HDL-64E has no web \
                 interface: it is set over its serial port"
            ))
        })
    }

    fn error(&self, what: impl std::fmt::Display) -> CliError {
        CliError::Sensor(format!("{}: {what}", self.at))
    }
}

/// What is to be changed, a line each.
fn planned(differences: &[Difference], is_only_planned: bool) -> String {
    let mut text = String::new();
    for difference in differences {
        let _ = writeln!(text, "{difference}");
    }
    if differences.is_empty() {
        text += "it is set so already\n";
    }
    if is_only_planned {
        text += "nothing was changed: --yes does it\n";
    }
    text
}

fn names(differences: &[Difference]) -> String {
    let names: Vec<&str> = differences.iter().map(|one| one.name).collect();
    names.join(", ")
}
