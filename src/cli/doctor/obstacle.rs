//! `sweepd doctor --obstacle`: whether a box is seen, and what to change if it is not.

use std::io::{self, Write};
use std::time::Duration;

use serde::Serialize;

use super::{Args, print_findings, write_json};
use crate::cli::{CliError, complain};
use crate::daemon::config::{Config, SensorConfig};
use crate::doctor::obstacle::sources::{Setup, TryError, from_capture, from_daemon, from_ports};
use crate::doctor::obstacle::{ENOUGH_PERCENT, Obstacle, Report, SWEEPS, Seen, Trial};
use crate::doctor::{Finding, Plan};
use crate::text::row;
use sweepd_client::client::{Client, Domain};

/// What `--json` prints.
#[derive(Serialize)]
struct JsonReport<'a> {
    well: bool,
    sensor: &'a str,
    #[serde(flatten)]
    report: &'a Report,
    findings: &'a [Finding],
}

/// Tries the box, with the sweeps of a capture, of a running daemon, or of packets that come.
///
/// # Errors
/// [`CliError`]; [`CliError::Reported`] if the box is no object of its own, after that was printed.
pub(super) fn run(
    args: &Args,
    obstacle: Obstacle,
    config: Option<&Config>,
    plan: &Plan,
) -> Result<(), CliError> {
    let name = match &args.sensors[..] {
        [] => None,
        [name] => Some(&name[..]),
        _ => return Err(usage("--obstacle is for one sensor: give one --sensor")),
    };
    let sensor = match config {
        Some(config) => Some(configured(config, name)?),
        None => None,
    };
    let setup = setup(obstacle, sensor, name);
    let shared = match args.capture {
        Some(_) => None,
        None => shared(args, &setup, sensor, name, plan)?,
    };
    let (sensor, trial) = match (shared, name) {
        (Some(shared), _) => shared,
        (None, Some(name)) if sensor.is_none() && setup.only.is_empty() => {
            return Err(usage(format!(
                "no running daemon shares `{name}`: give the sensor's address, or --config FILE"
            )));
        }
        _ => from_packets(args, &setup, plan)?,
    };
    let (report, findings) = (trial.report(), trial.findings());
    let printed = match args.json {
        true => write_json(&JsonReport {
            well: report.is_well(),
            sensor: &sensor,
            report: &report,
            findings: &findings,
        }),
        false => print(&sensor, &report, &findings),
    };
    printed.map_err(CliError::Stdout)?;
    match report.is_well() {
        true => Ok(()),
        false => Err(CliError::Reported),
    }
}

/// What packets show of the box, of a capture or as they come, with the name of their sensor.
fn from_packets(args: &Args, setup: &Setup, plan: &Plan) -> Result<(String, Trial), CliError> {
    let tried = match &args.capture {
        Some(capture) => from_capture(capture, setup),
        None => {
            let patience = Duration::from_secs_f64(args.seconds);
            from_ports(&plan.ports, setup, patience, announce)
        }
    };
    let tried = tried.map_err(cli_error)?;
    match tried.fault {
        Some(fault) => Err(usage(format!("{}: {fault}", tried.sender.name))),
        None => Ok((tried.sender.name, tried.trial)),
    }
}

fn announce(ports: &[u16]) {
    let ports: Vec<String> = ports.iter().map(u16::to_string).collect();
    let ports = ports.join(", ");
    let _ = writeln!(
        io::stderr(),
        "listening on port {ports} for {SWEEPS} sweeps"
    );
}

/// The sensor of a configuration: by its name or address, or the only one.
fn configured<'a>(config: &'a Config, name: Option<&str>) -> Result<&'a SensorConfig, CliError> {
    let is_meant = |one: &&SensorConfig| match name {
        Some(name) => one.name == name || one.address.to_string() == name,
        None => config.sensors.len() == 1,
    };
    config.sensors.iter().find(is_meant).ok_or_else(|| {
        let names: Vec<&str> = config.sensors.iter().map(|one| &one.name[..]).collect();
        usage(format!(
            "name the sensor with --sensor; the configuration has {}",
            names.join(", ")
        ))
    })
}

/// How the box is tried: with the sensor of a configuration, or that of an address.
fn setup(obstacle: Obstacle, sensor: Option<&SensorConfig>, name: Option<&str>) -> Setup {
    let mut setup = Setup::new(obstacle);
    if let Some(sensor) = sensor {
        let source = match sensor.source_port {
            Some(port) => format!("{}:{port}", sensor.address),
            None => sensor.address.to_string(),
        };
        setup.pipeline = sensor.pipeline.clone();
        setup.max_width_rad = sensor.objects.max_width_rad;
        setup.likely = source.parse().ok();
    } else if let Some(filter) = name.and_then(|name| name.parse().ok()) {
        setup.only.push(filter);
    }
    setup
}

/// What a running daemon shows of the box; `None` if none shares this sensor.
fn shared(
    args: &Args,
    setup: &Setup,
    sensor: Option<&SensorConfig>,
    name: Option<&str>,
    plan: &Plan,
) -> Result<Option<(String, Trial)>, CliError> {
    let domain = Domain::at_or_default(plan.root.as_deref());
    let names = match Client::sensors(&domain) {
        Ok(names) => names,
        Err(error) => {
            complain("note", error);
            return Ok(None);
        }
    };
    let meant = sensor.map(|sensor| &sensor.name[..]).or(name);
    let name = match (meant, &names[..]) {
        (_, []) => return Ok(None),
        (Some(meant), names) if names.iter().any(|name| name == meant) => meant,
        (Some(_), _) => return Ok(None),
        (None, [name]) => name,
        (None, names) => {
            let names = names.join(", ");
            return Err(usage(format!(
                "there are several sensors, name one with --sensor: {names}"
            )));
        }
    };
    let mut client = Client::within(&domain, name)?;
    // Without the file, it is not known what the daemon segments with.
    let settings = sensor.map(|_| setup.pipeline.segment.clone());
    let mut trial = Trial::new(setup.obstacle, settings);
    let patience = Duration::from_secs_f64(args.seconds);
    let is_there = from_daemon(&mut client, &mut trial, patience).map_err(cli_error)?;
    Ok(is_there.then(|| (format!("{name}, by the running daemon"), trial)))
}

fn cli_error(error: TryError) -> CliError {
    match error {
        TryError::Capture(error) => CliError::Capture(error),
        TryError::Udp(error) => CliError::Udp(error),
        TryError::Client(error) => CliError::Client(error),
        other => usage(other.to_string()),
    }
}

fn usage(message: impl Into<String>) -> CliError {
    CliError::Usage(message.into())
}

fn print(sensor: &str, report: &Report, findings: &[Finding]) -> io::Result<()> {
    let mut stdout = io::stdout().lock();
    stdout.write_all(describe(sensor, report).as_bytes())?;
    print_findings(&mut stdout, findings)?;
    let (own, sweeps) = (report.own, report.sweeps);
    let needed = format!("{own} of {sweeps} sweeps, {ENOUGH_PERCENT} % are needed");
    match report.is_well() {
        true => writeln!(stdout, "well: the box is an object of its own in {needed}"),
        false => writeln!(
            stdout,
            "not well: the box is an object of its own in {needed}"
        ),
    }
}

/// What was seen, line by line.
fn describe(sensor: &str, report: &Report) -> String {
    let mut text = format!("{sensor}\n");
    row(&mut text, "box", report.obstacle);
    if let (Some(returns), Some(rows)) = (report.returns, report.rows) {
        row(
            &mut text,
            "returns",
            format_args!("{returns} a sweep strike it, in {rows} rows"),
        );
    }
    if let (Some(front_m), Some(right_m)) = (report.front_m, report.right_m) {
        let side = if right_m < 0.0 { "left" } else { "right" };
        let right_m = right_m.abs();
        row(
            &mut text,
            "front",
            format_args!("{front_m:.2} m ahead, its middle {right_m:.2} m to the {side}"),
        );
    }
    for (seen, sweeps) in &report.seen {
        let of = format_args!("{sweeps} of {}: {}", report.sweeps, seen.words());
        row(&mut text, "sweeps", of);
    }
    if let (Some(told_ms), Some(most_ms)) = (report.told_ms, report.told_most_ms) {
        let told = format_args!("{told_ms:.1} ms after its last beam, at most {most_ms:.1} ms");
        row(&mut text, "as object", told);
    }
    if let Some(ms) = report
        .with_sweep_ms
        .filter(|_| report.seen.contains_key(&Seen::Own))
    {
        row(
            &mut text,
            "with sweep",
            format_args!("{ms:.1} ms after its last beam"),
        );
    }
    text
}
