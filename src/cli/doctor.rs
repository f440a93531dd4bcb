//! `sweepd doctor`: prints faults, and how to mend them.

mod obstacle;

use std::fmt::Display;
use std::io::{self, Write};
use std::net::SocketAddr;
use std::path::PathBuf;
use std::time::Duration;

use serde::Serialize;
use serde_json::Value;

use super::options::{ConfigOptions, Listening, SensorChoice, within};
use super::stream::{print_json, printed};
use super::{CliError, complain};
use crate::beams;
use crate::daemon::config::Config;
use crate::doctor::diagnose::sweep_bytes;
use crate::doctor::obstacle::Obstacle;
use crate::doctor::plan::HEALTH;
use crate::doctor::{ExamineError, Finding, Observations, Plan, Severity, diagnose, examine};
use crate::publish::pool_sweeps;

/// Options of `sweepd doctor`.
#[derive(Clone, Debug, clap::Args)]
#[command(
    mut_arg("config", config_argument),
    mut_arg("sensors", sensor_argument)
)]
#[command(after_help = "\
Nothing is changed: ports are listened on, and sensors are asked for their settings. The exit status is 1 when something is wrong.

Examples:
  sweepd doctor
  sweepd doctor --config /etc/sweepd/sweepd.toml
  sweepd doctor --sensor 192.168.1.201 --seconds 10
  sweepd doctor --port 2369 --port 8309 --no-web --json
  sweepd doctor --obstacle 0.25,2 --config /etc/sweepd/sweepd.toml
  sweepd doctor --obstacle 0.25,2,-30 --config sweepd.toml --sensor roof drive.pcap")]
pub struct Args {
    /// With --obstacle: a capture instead of live packets
    #[arg(value_name = "CAPTURE", requires = "obstacle", conflicts_with_all = ["ports", "bind", "multicast", "interface"])]
    capture: Option<PathBuf>,
    /// Whether a box on the floor is an obstacle in 100 sweeps of a running daemon, or of
    /// the packets that come: its height and its distance from the robot's origin, metres; its
    /// azimuth, degrees clockwise from straight ahead [default: 0]; its width, metres [default: 0.4]
    #[arg(
        long,
        value_name = "HEIGHT,DISTANCE[,AZIMUTH[,WIDTH]]",
        allow_negative_numbers = true
    )]
    obstacle: Option<Obstacle>,
    #[command(flatten)]
    config: ConfigOptions,
    /// How long to listen, seconds; with --obstacle, how long to wait for a sweep
    #[arg(long, value_name = "S", default_value = "5", value_parser = within(0.1..=3600.0, "seconds"))]
    seconds: f64,
    #[command(flatten)]
    listening: Listening,
    /// Ask no sensor for its settings
    #[arg(long)]
    no_web: bool,
    /// Address of a running daemon's /health, requested if it holds a port
    #[arg(long, value_name = "IP:PORT", default_value_t = HEALTH)]
    health: SocketAddr,
    /// One JSON object on standard output
    #[arg(long)]
    json: bool,
    /// Port of the sensors' web page
    #[arg(long, value_name = "PORT", default_value_t = 80, hide = true)]
    web_port: u16,
}

fn config_argument(argument: clap::Arg) -> clap::Arg {
    let help =
        "Listen on the ports of this daemon configuration, and compare what comes with its sensors";
    let others = ["ports", "bind", "multicast", "interface", "health"];
    argument.help(help).conflicts_with_all(others)
}

fn sensor_argument(argument: clap::Arg) -> clap::Arg {
    argument.help(
        "Ask the web page of the sensor at this address even if nothing comes from it; may be given several times. With \
         --obstacle, the sensor to try, by its address or its name",
    )
}

impl Args {
    fn plan(&self, config: Option<&Config>) -> Plan {
        match config {
            Some(config) => Plan::of(config),
            None => {
                let listening = &self.listening;
                let interface = listening.interface.as_deref();
                Plan {
                    health: Some(self.health),
                    ..Plan::of_ports(
                        &listening.ports,
                        listening.bind,
                        listening.multicast,
                        interface,
                    )
                }
            }
        }
    }
}

/// What `--json` prints.
#[derive(Serialize)]
struct JsonReport<'a> {
    well: bool,
    seconds: f64,
    sensors: Vec<SensorReport>,
    findings: &'a [Finding],
}

/// A sensor that sends data.
#[derive(Serialize)]
struct SensorReport {
    source: String,
    port: u16,
    model: Option<String>,
    return_mode: Option<&'static str>,
    rpm: Option<f32>,
    packets: u64,
    packets_per_s: f64,
    lost: u64,
    dark_beams: Value,
}

/// Examines and reports.
///
/// # Errors
/// [`CliError`]; [`CliError::Reported`] if there are faults, after they were printed.
pub fn run(args: &Args) -> Result<(), CliError> {
    let config = match (&args.config.config, &args.capture) {
        (Some(file), None) => Some(Config::read(file)?),
        (Some(file), Some(_)) => Some(Config::read_for_any_host(file)?),
        (None, _) => None,
    };
    let mut plan = args.plan(config.as_ref());
    if let Some(obstacle) = args.obstacle {
        return obstacle::run(args, obstacle, &plan);
    }
    for warning in config.iter().flat_map(|config| &config.warnings) {
        complain("warning", warning);
    }
    for sensor in &args.config.sensors {
        let address = match sensor {
            SensorChoice::Sender(filter) => filter.to_string().parse().ok(),
            SensorChoice::Name(_) => None,
        };
        plan.ask.push(address.ok_or_else(|| {
            CliError::Usage(
                "--sensor: expected an IPv4 address; a name needs --obstacle".to_owned(),
            )
        })?);
    }
    let web_port = (!args.no_web).then_some(args.web_port);
    let seen = examine(
        plan,
        Duration::from_secs_f64(args.seconds),
        web_port,
        |ports| print_ports(ports, format_args!("{} s", args.seconds)),
    );
    let seen = seen.map_err(|error| match error {
        ExamineError::Udp(error) => CliError::Udp(error),
        ExamineError::System(source) => CliError::System {
            what: "ask web pages",
            source,
        },
    })?;
    let findings = diagnose(&seen);
    let well = !findings.iter().any(Finding::is_trouble);
    if args.json {
        print_json(&JsonReport {
            well,
            seconds: seen.seconds,
            sensors: sensor_reports(&seen),
            findings: &findings,
        })?;
    } else {
        printed(print(&seen, &findings))?;
    }
    if well {
        Ok(())
    } else {
        Err(CliError::Reported)
    }
}

/// Says where and for how long it listens.
fn print_ports(ports: &[u16], how_long: impl Display) {
    let numbers: Vec<String> = ports.iter().map(u16::to_string).collect();
    // If no port can be opened, there is no wait, and the findings say why.
    if !ports.is_empty() {
        let numbers = numbers.join(", ");
        let _ = writeln!(io::stderr(), "listening on port {numbers} for {how_long}");
    }
}

fn print(seen: &Observations, findings: &[Finding]) -> io::Result<()> {
    let mut stdout = io::stdout().lock();
    for sensor in sensor_reports(seen) {
        let model = sensor.model.as_deref().unwrap_or("unknown model");
        write!(stdout, "{} to port {}: {model}", sensor.source, sensor.port)?;
        if let Some(mode) = sensor.return_mode {
            write!(stdout, ", {mode}")?;
        }
        if let Some(rpm) = sensor.rpm {
            write!(stdout, ", {rpm:.0} rpm")?;
        }
        writeln!(stdout, ", {:.0} packets a second", sensor.packets_per_s)?;
    }
    for expected in &seen.plan.sensors {
        let sweeps = pool_sweeps(expected.max_consumers);
        let bytes = sweep_bytes(expected, seen);
        let mib = (bytes * sweeps as u64) as f64 / f64::from(1 << 20);
        writeln!(
            stdout,
            "{}: takes {mib:.1} MiB of shared memory, {sweeps} sweeps of {bytes} bytes",
            expected.name
        )?;
    }
    print_findings(&mut stdout, findings)?;
    match findings.iter().filter(|one| one.is_trouble()).count() {
        0 => writeln!(stdout, "all well"),
        1 => writeln!(stdout, "1 thing is wrong"),
        count => writeln!(stdout, "{count} things are wrong, the worst first"),
    }
}

fn print_findings(out: &mut impl Write, findings: &[Finding]) -> io::Result<()> {
    for finding in findings {
        let severity = match finding.severity {
            Severity::Error => "error",
            Severity::Warning => "warning",
            Severity::Note => "note",
        };
        writeln!(out, "{severity}: {}", finding.what)?;
        for step in finding.cure.lines() {
            writeln!(out, "    {step}")?;
        }
    }
    Ok(())
}

fn sensor_reports(seen: &Observations) -> Vec<SensorReport> {
    let reports = seen.sensors.iter().map(|sensor| SensorReport {
        source: sensor.source.to_string(),
        port: sensor.port,
        model: sensor.model.map(|model| model.to_string()),
        return_mode: sensor.return_mode.map(|mode| mode.name()),
        rpm: sensor.mean_rpm(),
        packets: sensor.counts.data,
        packets_per_s: (sensor.counts.data as f64 / seen.seconds).round(),
        lost: sensor.counts.lost,
        dark_beams: beams::json(&sensor.dark_beams),
    });
    reports.collect()
}
