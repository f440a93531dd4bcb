//! `sweepd inspect`: what is in a capture, told from headers, stamps and azimuths, without decoding
//! a single return.

mod flows;
mod positions;
mod status;

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::io::{self, Write as _};
use std::net::IpAddr;
use std::path::PathBuf;

use flows::Flows;
use positions::Positions;

use super::CliError;
use crate::admission::{DiscoveredSensors, Route};
use crate::capture::Capture;
use crate::cure::{Dialect, explain_model};
use crate::text::{count_of, grouped, utc_text};
use sweepd_core::assemble::motion::TURN;
use sweepd_core::assemble::order::{PacketGap, PacketOrder, Rejection};
use sweepd_core::sensor::Model;
use sweepd_core::sensor::detect::{DetectError, Detection, Detector};
use sweepd_core::wire::data::{Banks, ReturnMode};
use sweepd_core::wire::hdl64::{Series, Status};
use sweepd_core::wire::{Content, DataPacket, Packet};

/// Options of `sweepd inspect`.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Example:
  sweepd inspect pcap_fixtures/street_vlp16_losses.pcap")]
pub struct Args {
    /// pcap or pcapng, plain or compressed with gzip or zstd; - is standard input
    #[arg(value_name = "CAPTURE")]
    pub capture: PathBuf,
}

/// Runs the command.
///
/// # Errors
/// [`CliError`]: the capture cannot be read, or standard output not written.
pub fn run(args: &Args) -> Result<(), CliError> {
    let mut capture = Capture::open(&args.capture)?;
    let mut sensors = DiscoveredSensors::new(Vec::new());
    let mut seen: Vec<Seen> = Vec::new();
    let mut positions: BTreeMap<IpAddr, Positions> = BTreeMap::new();
    let mut flows = Flows::default();
    let read = loop {
        let datagram = match capture.next_datagram() {
            Ok(Some(datagram)) => datagram,
            Ok(None) => break Ok(()),
            Err(error) => break Err(error),
        };
        match sensors.admit(&datagram) {
            Ok((Route::Data(index), packet)) => {
                if index == seen.len() {
                    seen.push(Seen::default());
                }
                seen[index].data(&packet);
            }
            Ok((Route::Position(_), packet)) => {
                positions
                    .entry(datagram.source.ip().to_canonical())
                    .or_default()
                    .add(&packet);
            }
            Err(refused) => match refused.sensor {
                Some(index) => seen[index].malformed(datagram.arrival_ns),
                None => flows.add(&datagram),
            },
        }
    };
    let text =
        describe(&capture, &sensors, &mut seen, &positions) + &others(&capture, &sensors, &flows);
    io::stdout()
        .write_all(text.as_bytes())
        .map_err(CliError::Stdout)?;
    read.map_err(CliError::Capture)
}

/// All that was seen, sensor by sensor.
fn describe(
    capture: &Capture,
    sensors: &DiscoveredSensors,
    seen: &mut [Seen],
    positions: &BTreeMap<IpAddr, Positions>,
) -> String {
    let mut text = head(capture, sensors);
    for (sensor, seen) in sensors.senders().iter().zip(seen) {
        let _ = writeln!(
            text,
            "\n{} to port {}",
            sensor.source, sensor.destination_port
        );
        seen.finish();
        seen.describe(&mut text);
        if let Some(positions) = positions.get(&sensor.source.ip()) {
            let same = sensors
                .senders()
                .iter()
                .filter(|other| other.source.ip() == sensor.source.ip())
                .count();
            positions.describe(
                &mut text,
                if same > 1 {
                    ", of all sensors at this address"
                } else {
                    ""
                },
            );
        }
    }
    for (ip, positions) in positions {
        if !sensors
            .senders()
            .iter()
            .any(|sensor| sensor.source.ip() == *ip)
        {
            let _ = writeln!(text, "\n{ip}, position packets only");
            positions.describe(&mut text, "");
        }
    }
    text
}

/// What else there is: all of it where no sensor is, since that was hoped for; else the largest
/// part.
fn others(capture: &Capture, sensors: &DiscoveredSensors, flows: &Flows) -> String {
    let lines = flows.lines();
    if lines.is_empty() && capture.tally().records > 0 && capture.tally().datagrams == 0 {
        return "\nother traffic\n  no record holds a UDP datagram\n".to_owned();
    }
    if lines.is_empty() {
        return String::new();
    }
    let mut text = "\nother traffic\n".to_owned();
    let shown = if sensors.senders().is_empty() {
        lines.len()
    } else {
        1
    };
    for line in &lines[..shown] {
        let _ = writeln!(text, "  {line}");
    }
    text
}

/// The capture as a whole.
fn head(capture: &Capture, sensors: &DiscoveredSensors) -> String {
    let tally = capture.tally();
    let mut text = format!("{}\n", capture.name());
    if let (Some(first), Some(last)) = (capture.first_ns(), capture.last_ns()) {
        let seconds = last.saturating_sub(first) as f64 * 1e-9;
        row(
            &mut text,
            "time",
            &format!("{} to {}, {seconds:.3} s", utc_text(first), utc_text(last)),
        );
    }
    let links: Vec<String> = capture
        .link_types()
        .iter()
        .map(ToString::to_string)
        .collect();
    row(&mut text, "link type", &links.join(", "));
    let others = tally.other_traffic() + sensors.others();
    let (records, datagrams) = (
        grouped(tally.records),
        count_of(tally.datagrams, "UDP datagram"),
    );
    row(
        &mut text,
        "records",
        &format!(
            "{records}, with {datagrams}; {} of other traffic",
            grouped(others)
        ),
    );
    if tally.truncated_records > 0 {
        row(
            &mut text,
            "cut short",
            &format!(
                "{}: hold less than was sent",
                count_of(tally.truncated_records, "record")
            ),
        );
    }
    if let Some(truncation) = capture.truncation() {
        row(&mut text, "damaged", &truncation.to_string());
    }
    if sensors.senders().is_empty() {
        row(&mut text, "sensors", "none sends data packets");
    }
    text
}

fn row(text: &mut String, name: &str, value: &str) {
    let _ = writeln!(text, "  {name:<13}{value}");
}

/// What was seen of the data packets of one sensor.
#[derive(Default)]
struct Seen {
    packets: u64,
    malformed: u64,
    first_ns: i64,
    last_ns: i64,
    /// That of an HDL-64E, in the bytes where others have return mode and product.
    status: Option<Status>,
    modes: Vec<ReturnMode>,
    blank_mode: bool,
    model: Option<Result<Detection, DetectError>>,
    detector: Option<Detector>,
    waiting: Vec<(DataPacket, i64)>,
    last_mode: Option<ReturnMode>,
    order: Option<PacketOrder>,
    motion: Moved,
}

/// What the order of the packets told.
#[derive(Default)]
struct Moved {
    lost: u64,
    duplicates: u64,
    late: u64,
    restarts: u64,
    sector_deg: Option<(f64, f64)>,
    rpm_sum: f64,
    rpm_count: u64,
    turn: Turn,
    whole_turns: Turns,
}

/// Speeds of whole turns.
#[derive(Default)]
struct Turns {
    count: u32,
    sum_rpm: f64,
    bounds_rpm: Option<(f64, f64)>,
}

impl Turns {
    fn add(&mut self, rpm: f64) {
        let (least, most) = self.bounds_rpm.unwrap_or((rpm, rpm));
        self.bounds_rpm = Some((least.min(rpm), most.max(rpm)));
        self.sum_rpm += rpm;
        self.count += 1;
    }
}

/// A turn under way: single packets carry the encoder's noise.
#[derive(Default)]
struct Turn {
    turned_cdeg: f64,
    rpm_sum: f64,
    packets: u32,
}

impl Turn {
    /// Adds a packet; gives the mean speed when the turn is whole.
    fn add(&mut self, rpm: f64, period_ns: f64) -> Option<f64> {
        self.turned_cdeg += (rpm * TURN / 60e9).abs() * period_ns;
        self.rpm_sum += rpm;
        self.packets += 1;
        (self.turned_cdeg >= TURN).then(|| {
            let turn = std::mem::take(self);
            turn.rpm_sum / f64::from(turn.packets)
        })
    }
}

impl Seen {
    fn arrived(&mut self, arrival_ns: i64) {
        if self.packets == 0 {
            self.first_ns = arrival_ns;
        }
        self.last_ns = arrival_ns;
        self.packets += 1;
    }

    fn malformed(&mut self, arrival_ns: i64) {
        self.arrived(arrival_ns);
        self.malformed += 1;
    }

    fn data(&mut self, packet: &Packet<'_>) {
        let arrival_ns = packet.arrival_ns;
        let Content::Data(packet) = packet.content else {
            return;
        };
        self.arrived(arrival_ns);
        match ReturnMode::from_byte(packet.return_mode) {
            _ if packet.banks() == Banks::Alternating => self.status.get_or_insert_default().push(
                packet.return_mode,
                packet.product,
                packet.stamp_us(),
            ),
            Some(mode) if !self.modes.contains(&mode) => self.modes.push(mode),
            Some(_) => {}
            None => self.blank_mode = true,
        }
        if self.order.is_some() {
            self.place(packet, arrival_ns);
        } else if self.model.is_none() {
            self.waiting.push((*packet, arrival_ns));
            let detector = self.detector.get_or_insert_with(|| Detector::new(None));
            if let Some(result) = detector.observe(packet) {
                self.decide(result);
            }
        }
    }

    fn decide(&mut self, result: Result<Detection, DetectError>) {
        self.model = Some(result);
        if let Ok(detection) = result {
            self.order = Some(PacketOrder::new(detection.spec));
            for (packet, arrival_ns) in std::mem::take(&mut self.waiting) {
                self.place(&packet, arrival_ns);
            }
        }
    }

    fn place(&mut self, packet: &DataPacket, arrival_ns: i64) {
        let (Some(order), Some(Ok(detection))) = (&mut self.order, &self.model) else {
            return;
        };
        if !detection.has_layout(packet) {
            self.malformed += 1;
            return;
        }
        let mode = detection.mode_of(packet, self.last_mode.unwrap_or(detection.return_mode));
        self.last_mode = Some(mode);
        if detection.model.is_hdl64e() && !self.modes.contains(&mode) {
            self.modes.push(mode);
        }
        match order.push(packet, mode, self.packets, arrival_ns) {
            Ok(()) => {}
            Err(Rejection::Duplicate) => self.motion.duplicates += 1,
            Err(Rejection::Behind { .. }) => self.motion.late += 1,
            Err(Rejection::Implausible(_)) => self.malformed += 1,
        }
        self.motion.follow(order, detection);
    }

    /// The capture ended: what was still waiting is looked at.
    fn finish(&mut self) {
        if self.model.is_none()
            && let Some(detector) = &self.detector
        {
            let result = detector.conclude();
            self.decide(result);
        }
        if let (Some(order), Some(Ok(detection))) = (&mut self.order, &self.model) {
            order.flush();
            self.motion.follow(order, detection);
        }
    }

    fn describe(&self, text: &mut String) {
        match &self.model {
            Some(Ok(detection)) => {
                let series = self.status.as_ref().and_then(Status::series);
                let (model, basis) = match (detection.model, series) {
                    // With one return the packets of both series are alike; the status is not.
                    (Model::Hdl64eS2, Some(Series::S3)) => (
                        Model::Hdl64eS3,
                        "by its two heads, packet period and status",
                    ),
                    (model, _) => (model, detection.basis.words()),
                };
                row(text, "model", &format!("{model}, {basis}"));
            }
            Some(Err(error)) => row(
                text,
                "model",
                &format!(
                    "cannot be decoded: {}",
                    explain_model(error, Dialect::CommandLine)
                ),
            ),
            None => row(text, "model", "no well-formed packet tells"),
        }
        let mut modes: Vec<String> = self.modes.iter().map(ToString::to_string).collect();
        if self.blank_mode {
            modes.push("not stated".to_owned());
        }
        let said = self.status.as_ref().and_then(Status::return_mode);
        let seen = modes.join(", ");
        match said.map(|mode| mode.to_string()) {
            Some(said) if seen.is_empty() || said == seen => {
                row(text, "return mode", &format!("{said}, by its status"))
            }
            Some(said) => row(
                text,
                "return mode",
                &format!("{seen}; its status says {said}"),
            ),
            None if seen.is_empty() => {}
            None => row(text, "return mode", &seen),
        }
        if let Some(status) = &self.status {
            status::describe(status, text);
        }
        row(
            text,
            "data",
            &format!(
                "{}{}",
                count_of(self.packets, "packet"),
                rate(self.packets, self.first_ns, self.last_ns)
            ),
        );
        self.motion.describe(text, self.order.as_ref());
        if self.malformed > 0 {
            row(text, "malformed", &count_of(self.malformed, "packet"));
        }
    }
}

impl Moved {
    fn follow(&mut self, order: &mut PacketOrder, detection: &Detection) {
        let spec = detection.spec;
        let mut first = self.rpm_count == 0;
        while let Some((slot, before)) = order.pop() {
            match before {
                PacketGap::Lost { packets, .. } => self.lost += u64::from(packets),
                PacketGap::Start if !first => self.restarts += 1,
                PacketGap::Start | PacketGap::None | PacketGap::Blanked => {}
            }
            first = false;
            let rpm = order.packet(slot).motion.rate_cdeg_ns(spec) * 60e9 / TURN;
            self.rpm_sum += rpm;
            self.rpm_count += 1;
            if let Some(rpm) = self.turn.add(
                rpm,
                f64::from(spec.packet_period_ns(order.packet(slot).mode)),
            ) {
                self.whole_turns.add(rpm);
            }
        }
        let sector = order.sector();
        self.sector_deg = sector
            .map(|sector| (sector.from_cdeg / 100.0, sector.width_cdeg / 100.0))
            .or(self.sector_deg);
    }

    /// Its mean, its bounds over whole turns, and the sense if it is the unusual one.
    fn speed(&self) -> String {
        let (mean, turns) = match self.whole_turns.bounds_rpm {
            Some((a, b)) => (
                self.whole_turns.sum_rpm / f64::from(self.whole_turns.count),
                format!(
                    " ({:.1} to {:.1})",
                    a.abs().min(b.abs()),
                    a.abs().max(b.abs())
                ),
            ),
            None => (self.rpm_sum / self.rpm_count as f64, String::new()),
        };
        let sense = if mean < 0.0 {
            ", counter-clockwise"
        } else {
            ""
        };
        format!("{:.1} rpm{turns}{sense}", mean.abs())
    }

    fn describe(&self, text: &mut String, order: Option<&PacketOrder>) {
        let Some(order) = order else { return };
        if self.rpm_count > 0 {
            row(text, "speed", &self.speed());
        }
        if let Some((from, width)) = self.sector_deg {
            let to = (from + width).rem_euclid(360.0);
            row(
                text,
                "left out",
                &format!(
                    "azimuth {from:.1} to {to:.1} degrees: the sensor's field of view is limited"
                ),
            );
        }
        let counts = order.counts();
        let mut losses = format!("{} lost", count_of(self.lost, "packet"));
        for (count, word) in [
            (counts.reordered, "out of order"),
            (self.duplicates, "received twice"),
            (self.late, "too late"),
            (counts.unconfirmed, "implausible"),
            (
                self.restarts,
                "jumps of the clock or changes of the return mode",
            ),
        ] {
            if count > 0 {
                let _ = write!(losses, ", {count} {word}");
            }
        }
        row(text, "losses", &losses);
    }
}

/// ` (753.5 a second)`, where there is more than one.
fn rate(count: u64, first_ns: i64, last_ns: i64) -> String {
    let seconds = last_ns.saturating_sub(first_ns) as f64 * 1e-9;
    if count < 2 || seconds <= 0.0 {
        return String::new();
    }
    format!(" ({:.1} a second)", (count - 1) as f64 / seconds)
}
