//! `sweepd doctor --obstacle`: whether a box is seen, and what to change if it is not.

use std::convert::Infallible;
use std::io::{self, Write};
use std::path::Path;
use std::time::{Duration, Instant};

use serde::Serialize;

use super::{Args, print_findings, print_ports};
use crate::admission::Sender;
use crate::cli::options::SensorChoice;
use crate::cli::sections::Sections;
use crate::cli::stream::{print_json, printed};
use crate::cli::{CliError, complain, warn_of};
use crate::cure::{Dialect, explain};
use crate::doctor::obstacle::{ENOUGH_PERCENT, Obstacle, Report, SWEEPS, Trial};
use crate::doctor::{Finding, Plan};
use crate::input::{Capture, Placed, UdpSource};
use crate::streams::{SteadyTime, Stream, Streams};
use crate::text::{count_of, row};
use sweepd_client::client::{Client, Domain, LayoutError};
use sweepd_client::host::realtime_ns;
use sweepd_core::buffers::{HeapBuffers, Memory};
use sweepd_core::pipeline::{Arrival, Event, Pipeline};
use sweepd_core::sweep::SweepRef;
use sweepd_core::wire::Packet;

/// Longest wait for a daemon of which shared memory is left.
const DAEMON: Duration = Duration::from_secs(2);
/// Longest wait on one port, and for a sweep while objects may come.
const TURN: Duration = Duration::from_millis(10);

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
/// [`CliError`]; [`CliError::Reported`] if the box is no obstacle, after that was printed.
pub(super) fn run(args: &Args, obstacle: Obstacle, plan: &Plan) -> Result<(), CliError> {
    let (sensor, trial) = try_out(args, obstacle, plan)?;
    let (report, findings) = (trial.report(), trial.findings());
    match args.json {
        true => print_json(&JsonReport {
            well: report.is_well(),
            sensor: &sensor,
            report: &report,
            findings: &findings,
        }),
        false => printed(print(&sensor, &report, &findings)),
    }?;
    match report.is_well() {
        true => Ok(()),
        false => Err(CliError::Reported),
    }
}

/// What is seen of the box, and by which sensor.
fn try_out(args: &Args, obstacle: Obstacle, plan: &Plan) -> Result<(String, Trial), CliError> {
    let config = &args.config;
    // A running daemon knows its sensors by name without a file.
    if let (None, None, [SensorChoice::Name(name)]) =
        (&args.capture, &config.config, &config.sensors[..])
    {
        let trial = Trial::new(obstacle, None);
        let shared = from_daemon(args, Some(name), trial, plan)?;
        return shared.ok_or_else(|| {
            CliError::Failed(format!(
                "no running daemon shares `{name}`: give the sensor's address, or --config FILE"
            ))
        });
    }
    let sections = Sections::configured(config)?;
    if args.capture.is_none() && (config.config.is_some() || config.sensors.is_empty()) {
        let (mut name, mut pipeline) = (None, None);
        if config.config.is_some() {
            let sensor = &sections.only(config)?.sensor;
            (name, pipeline) = (Some(&sensor.name[..]), Some(sensor.pipeline.clone()));
        }
        let trial = Trial::new(obstacle, pipeline);
        if let Some(shared) = from_daemon(args, name, trial, plan)? {
            return Ok(shared);
        }
    }
    from_packets(args, obstacle, &sections, plan)
}

/// What packets show of the box, of a capture or as they come.
fn from_packets(
    args: &Args,
    obstacle: Obstacle,
    sections: &Sections,
    plan: &Plan,
) -> Result<(String, Trial), CliError> {
    let mut streams = Streams::new(sections.filters());
    let is_live = args.capture.is_none();
    let begin = |sender: &Sender| Tried::new(sender, sections, obstacle, is_live);
    match &args.capture {
        Some(path) => read(path, &mut streams, begin)?,
        None => listen(args, plan, &mut streams, begin)?,
    }
    streams.end();
    if is_live && streams.all.is_empty() {
        return Err(CliError::Failed(
            "no sensor sends data packets; `sweepd doctor` without --obstacle says why".to_owned(),
        ));
    }
    let tried = sections.only_one(streams).map_err(CliError::Failed)?;
    match tried.fault {
        Some(fault) => Err(CliError::Failed(format!("{}: {fault}", tried.name))),
        None => Ok((tried.name, tried.trial)),
    }
}

/// Takes the packets of a capture, up to the sweeps that are enough or its end.
fn read(
    path: &Path,
    streams: &mut Streams<Tried>,
    begin: impl Fn(&Sender) -> Result<Tried, CliError>,
) -> Result<(), CliError> {
    let mut capture = Capture::open(path)?;
    while let Some(placed) = capture.next_placed()?
        && !is_over(streams)
    {
        let _ = streams.take(&placed, |_, sender| begin(sender))?;
    }
    warn_of(&capture, "");
    Ok(())
}

/// Takes what comes to the ports, up to the sweeps that are enough, or until no sweep has come for
/// so long as was said.
fn listen(
    args: &Args,
    plan: &Plan,
    streams: &mut Streams<Tried>,
    begin: impl Fn(&Sender) -> Result<Tried, CliError>,
) -> Result<(), CliError> {
    let mut sources = Vec::new();
    for port in &plan.ports {
        sources.push(UdpSource::bind(&port.udp())?);
    }
    let ports: Vec<u16> = sources.iter().map(|one| one.local_addr().port()).collect();
    print_ports(&ports, format_args!("{SWEEPS} sweeps"));
    let (mut last, mut sweeps) = (Instant::now(), 0);
    while last.elapsed().as_secs_f64() < args.seconds && !is_over(streams) {
        for source in &mut sources {
            for datagram in source.receive(TURN)? {
                let placed = Placed::from(datagram);
                let _ = streams.take(&placed, |_, sender| begin(sender))?;
            }
        }
        let now: u32 = streams.all.iter().map(|one| one.trial.sweeps()).sum();
        if now > sweeps {
            (last, sweeps) = (Instant::now(), now);
        }
    }
    Ok(())
}

/// Whether all sensors have enough sweeps.
fn is_over(streams: &Streams<Tried>) -> bool {
    !streams.all.is_empty() && streams.all.iter().all(|one| one.trial.is_over())
}

/// What a running daemon shows of the box, of the sensor with this name or the only one; `None` if
/// none shares it.
fn from_daemon(
    args: &Args,
    name: Option<&str>,
    mut trial: Trial,
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
    let name = match (name, &names[..]) {
        (Some(name), names) if names.iter().any(|one| one == name) => name,
        (Some(_), _) | (None, []) => return Ok(None),
        (None, [name]) => name,
        (None, names) => {
            let names = names.join(", ");
            return Err(CliError::Usage(format!(
                "there are several sensors, name one with --sensor: {names}"
            )));
        }
    };
    let mut client = Client::within(&domain, name)?;
    let mut objects = client.objects()?;
    let begun = Instant::now();
    let (mut last, mut is_there) = (begun, false);
    while !trial.is_over() && last.elapsed().as_secs_f64() < args.seconds {
        if let Some(sweep) = client.next(TURN)?.received() {
            let view = sweep.view().map_err(unreadable)?;
            trial.look(&view, view.header.completed_ns);
            (last, is_there) = (Instant::now(), true);
        }
        while let Some(message) = objects.next(Duration::ZERO)?.received() {
            let view = message.view().map_err(unreadable)?;
            trial.told(&view.new_objects(), view.header.sent_ns);
        }
        if !is_there && begun.elapsed() > DAEMON && !client.is_published() {
            return Ok(None);
        }
    }
    Ok(Some((format!("{name}, by the running daemon"), trial)))
}

fn unreadable(error: LayoutError) -> CliError {
    CliError::Failed(format!("the daemon sent what cannot be read: {error}"))
}

/// A sensor, and the box that it is tried with.
struct Tried {
    name: String,
    trial: Trial,
    /// Why its packets cannot be decoded.
    fault: Option<String>,
    pipeline: Pipeline,
    memory: Memory<HeapBuffers>,
    is_live: bool,
    /// Arrival of the newest datagram.
    newest_ns: i64,
}

impl Tried {
    fn new(
        sender: &Sender,
        sections: &Sections,
        obstacle: Obstacle,
        is_live: bool,
    ) -> Result<Self, CliError> {
        let sensor = &sections.all()[sections.number_of(sender)].sensor;
        let config = sensor.pipeline.clone();
        let mut pipeline = Pipeline::new("", config.clone())
            .map_err(|error| CliError::Failed(error.to_string()))?;
        pipeline.find_objects(true);
        Ok(Self {
            name: sections.name_of(sender).to_owned(),
            trial: Trial::new(obstacle, Some(config)),
            fault: None,
            pipeline,
            memory: Memory::default(),
            is_live,
            newest_ns: 0,
        })
    }

    fn poll(&mut self) {
        while let Some(event) = self.pipeline.poll(&mut self.memory) {
            let known_ns = match self.is_live {
                true => realtime_ns(),
                false => self.newest_ns,
            };
            match event {
                Event::Sweep(bytes) => {
                    if let Ok(sweep) = SweepRef::open(bytes.as_ref()) {
                        self.trial.look(&sweep, known_ns);
                    }
                }
                Event::Objects(new) => self.trial.told(&new, known_ns),
                Event::Fault(fault) => self.fault = Some(explain(&fault, Dialect::Configuration)),
                Event::Notice(_) => {}
            }
        }
    }
}

impl Stream for Tried {
    type Sweep = Infallible;

    fn take(&mut self, packet: Option<&Packet<'_>>, _: &Placed<'_>) {
        match packet {
            Some(packet) => self.pipeline.push(packet),
            None => self.pipeline.push(Arrival::Malformed),
        }
        // So that objects are known behind the packet that completes them.
        self.pipeline.idle(None);
        self.poll();
    }

    fn idle(&mut self, time: SteadyTime) -> bool {
        self.newest_ns = time.newest_ns;
        self.pipeline.idle(Some(time.now_ns));
        self.poll();
        false
    }

    fn end(&mut self) {
        self.pipeline.end();
        self.poll();
    }
}

fn print(sensor: &str, report: &Report, findings: &[Finding]) -> io::Result<()> {
    let mut stdout = io::stdout().lock();
    stdout.write_all(describe(sensor, report).as_bytes())?;
    print_findings(&mut stdout, findings)?;
    let well = if report.is_well() { "well" } else { "not well" };
    writeln!(
        stdout,
        "{well}: the box is an obstacle in {} of {} sweeps, {ENOUGH_PERCENT} % are needed",
        report.as_obstacle, report.sweeps
    )
}

/// What was seen, line by line.
fn describe(sensor: &str, report: &Report) -> String {
    let mut text = format!("{sensor}\n");
    row(&mut text, "box", report.obstacle);
    if let (Some(returns), Some(rows)) = (report.returns, report.rows) {
        let rows = count_of(rows.round() as u64, "row");
        let struck = format_args!("{returns} a sweep strike it, in {rows}");
        row(&mut text, "returns", struck);
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
    if let Some(ms) = report.with_sweep_ms.filter(|_| report.as_obstacle > 0) {
        row(
            &mut text,
            "with sweep",
            format_args!("{ms:.1} ms after its last beam"),
        );
    }
    text
}
