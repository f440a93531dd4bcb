//! `sweepd inspect`: describes a capture by headers, stamps and azimuths, and decodes it to find dark beams
//! and the floor.

mod flows;
mod mounted;
mod positions;
mod report;
mod status;
mod turns;

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::net::IpAddr;
use std::path::PathBuf;

use flows::Flows;
use mounted::Mounted;
use positions::Positions;
use report::{CaptureReport, Report, SenderReport, SensorReport, per_s};
use turns::Turns;

use super::options::{ConfigOptions, MountOptions};
use super::output::rounded;
use super::sections::{Section, Sections};
use super::speed::Speed;
use super::stream::{print, print_json};
use super::{CliError, complain};
use crate::admission::{DiscoveredSensors, Refused, Route, Sender};
use crate::beams;
use crate::cure::{Dialect, explain, explain_model};
use crate::input::{Capture, LinkType, Placed};
use crate::streams::{SteadyTime, Stream, Streams};
use crate::text::{count_of, grouped, rate, row, utc_text};
use sweepd_core::assemble::Sector;
use sweepd_core::assemble::{PacketGap, PacketOrder, Rejection};
use sweepd_core::segment::Mount;
use sweepd_core::sensor::Model;
use sweepd_core::sensor::detect::{DetectError, Detection, Detector};
use sweepd_core::wire::data::{Banks, ReturnMode};
use sweepd_core::wire::hdl64::{Series, Status};
use sweepd_core::wire::{Content, DataPacket, Packet};

/// Options of `sweepd inspect`.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Example:
  sweepd inspect pcap_fixtures/street_vlp16_losses.pcap
  sweepd inspect drive.pcap --pitch -10 --height 0.4
  sweepd inspect drive.pcap --config sweepd.toml --sensor roof")]
pub struct Args {
    /// pcap or pcapng, plain or compressed with gzip, zstd, bzip2 or lz4; a ROS bag with VelodyneScan
    /// messages (.mcap, .db3, .bag, or the folder of a ROS 2 bag); or bare packets; - is standard input
    #[arg(value_name = "CAPTURE")]
    pub capture: PathBuf,
    /// One JSON object on standard output
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    config: ConfigOptions,
    /// How the sensors are said to be mounted: the floor is held against it.
    #[command(flatten)]
    mount: MountOptions,
}

/// Runs the command.
///
/// # Errors
/// [`CliError`]: the capture cannot be read, or standard output not written.
pub fn run(args: &Args) -> Result<(), CliError> {
    let sections = Sections::mounted(&args.config, &args.mount)?;
    let mut capture = Capture::open(&args.capture)?;
    let mut streams = Streams::new(sections.filters());
    let mut positions: BTreeMap<IpAddr, Positions> = BTreeMap::new();
    let mut flows = Flows::default();
    let read = loop {
        let placed = match capture.next_placed() {
            Ok(Some(placed)) => placed,
            Ok(None) => break Ok(()),
            Err(error) => break Err(error),
        };
        let datagram = placed.datagram;
        let begin = |_: usize, sender: &Sender| args.begin(sections.of(sender));
        match streams.take(&placed, begin)? {
            Ok((Route::Position(_), packet)) => {
                let ip = datagram.source.ip().to_canonical();
                positions.entry(ip).or_default().add(&packet);
            }
            // Of a bag they are counted.
            Err(Refused { sensor: None, .. }) if placed.topic.is_none() => flows.add(&datagram),
            _ => {}
        }
    };
    let Streams { sensors, all, .. } = &mut streams;
    all.iter_mut().for_each(DataStream::finish);
    if args.json {
        let senders = sensors.senders().iter().zip(all);
        print_json(&Report {
            capture: CaptureReport::new(&capture, sensors),
            sensors: senders
                .map(|(sender, stream)| stream.report(sender, sections.name_of(sender)))
                .collect(),
            positions: positions.iter().map(|(ip, one)| one.report(*ip)).collect(),
            flows: flows.reports(),
        })?;
    } else {
        let mut text = describe(&capture, &sections, sensors, all, &positions);
        text += &describe_others(&capture, sensors, &flows);
        print(&text)?;
    }
    read?;
    args.check(&sections, &capture, &streams)
}

impl Args {
    /// Stream of a sensor of this section.
    fn begin(&self, section: &Section) -> Result<DataStream, CliError> {
        let Mount {
            pitch_rad,
            roll_rad,
            ..
        } = section.configured.mount;
        let is_mounted = [pitch_rad, roll_rad] != [0.0; 2];
        let config = &section.sensor.pipeline;
        Ok(DataStream {
            given: config.model,
            turns: Some(Turns::new(config, is_mounted || self.mount.says_side())?),
            ..DataStream::default()
        })
    }

    /// Says which sensors of the configuration are not in the capture, or cannot be decoded as it
    /// says.
    fn check(
        &self,
        sections: &Sections,
        capture: &Capture,
        streams: &Streams<DataStream>,
    ) -> Result<(), CliError> {
        let senders = streams.sensors.senders();
        let mut wrong = sections.missing(senders);
        for (sender, stream) in senders.iter().zip(&streams.all) {
            let turns = stream
                .turns
                .as_ref()
                .filter(|_| self.config.config.is_some());
            if let Some(fault) = turns.and_then(Turns::fault) {
                let name = sections.name_of(sender);
                wrong.push(format!(
                    "{name}: {}",
                    explain(fault, Dialect::Configuration)
                ));
            }
        }
        for message in &wrong {
            complain("error", format_args!("{}: {message}", capture.name()));
        }
        match wrong.is_empty() {
            true => Ok(()),
            false => Err(CliError::Reported),
        }
    }
}

/// The description of a capture, sensor by sensor.
fn describe(
    capture: &Capture,
    sections: &Sections,
    sensors: &DiscoveredSensors,
    streams: &[DataStream],
    positions: &BTreeMap<IpAddr, Positions>,
) -> String {
    let mut text = describe_capture(capture, sensors);
    // How many sensors each address has.
    let mut addresses: BTreeMap<IpAddr, u32> = BTreeMap::new();
    for sensor in sensors.senders() {
        *addresses.entry(sensor.source.ip()).or_default() += 1;
    }
    for (sensor, stream) in sensors.senders().iter().zip(streams) {
        let source = sensor.source;
        let _ = match sections.name_of(sensor) {
            name if name == sensor.name => writeln!(text, "\n{}", sensor.origin()),
            name => writeln!(text, "\n{name}, {}", sensor.origin()),
        };
        stream.describe(&mut text);
        if let Some(positions) = positions.get(&source.ip()) {
            let whose = match addresses[&source.ip()] {
                1 => "",
                _ => ", of all sensors at this address",
            };
            positions.describe(&mut text, whose);
        }
    }
    for (ip, positions) in positions {
        if !addresses.contains_key(ip) {
            let _ = writeln!(text, "\n{ip}, position packets only");
            positions.describe(&mut text, "");
        }
    }
    text
}

/// Other traffic: all of it if there is no sensor, which the user expected; else the largest part.
fn describe_others(capture: &Capture, sensors: &DiscoveredSensors, flows: &Flows) -> String {
    let mut lines = flows.lines();
    let counts = capture.counts();
    let is_bag = capture.bag_format().is_some();
    if lines.is_empty() && !is_bag && counts.records > 0 && counts.datagrams == 0 {
        lines.push("no record holds a UDP datagram".to_owned());
    }
    if lines.is_empty() {
        return String::new();
    }
    if !sensors.senders().is_empty() {
        lines.truncate(1);
    }
    format!("\nother traffic\n  {}\n", lines.join("\n  "))
}

/// The capture as a whole.
fn describe_capture(capture: &Capture, sensors: &DiscoveredSensors) -> String {
    let counts = capture.counts();
    let mut text = format!("{}\n", capture.name());
    if let (Some(first), Some(last)) = (capture.first_ns(), capture.last_ns()) {
        let seconds = last.saturating_sub(first) as f64 * 1e-9;
        let first = utc_text(first);
        let last = utc_text(last);
        let time = format_args!("{first} to {last}, {seconds:.3} s");
        row(&mut text, "time", time);
    }
    if let Some(format) = capture.bag_format() {
        row(&mut text, "format", format);
        let mut records = count_of(counts.datagrams, "packet");
        if sensors.others() > 0 {
            let others = grouped(sensors.others());
            let _ = write!(records, ", {others} of them not of a Velodyne");
        }
        if counts.malformed > 0 {
            let malformed = count_of(counts.malformed, "message");
            let _ = write!(
                records,
                "; {malformed} on their topics without a VelodyneScan"
            );
        }
        row(&mut text, "records", records);
    } else {
        describe_records(capture, sensors, &mut text);
    }
    if let Some(remark) = capture.remark() {
        row(&mut text, "note", remark);
    }
    if counts.truncated_records > 0 {
        let cut = count_of(counts.truncated_records, "record");
        let cut = format_args!("{cut}: hold less than was sent");
        row(&mut text, "cut short", cut);
    }
    if let Some(truncation) = capture.truncation() {
        row(&mut text, "damaged", truncation);
    }
    if sensors.senders().is_empty() {
        row(&mut text, "sensors", "none sends data packets");
    }
    text
}

/// What the records of a capture of frames are.
fn describe_records(capture: &Capture, sensors: &DiscoveredSensors, text: &mut String) {
    let counts = capture.counts();
    let links: Vec<String> = capture
        .link_types()
        .iter()
        .map(LinkType::to_string)
        .collect();
    row(text, "link type", links.join(", "));
    let records = grouped(counts.records);
    let datagrams = count_of(counts.datagrams, "UDP datagram");
    let others = grouped(counts.other_traffic() + sensors.others());
    let all = format_args!("{records}, with {datagrams}; {others} of other traffic");
    row(text, "records", all);
}

/// The data packets of one sensor.
#[derive(Default)]
struct DataStream {
    packets: u64,
    malformed: u64,
    first_ns: i64,
    last_ns: i64,
    /// The status of an HDL-64E, in the bytes where others have return mode and product.
    status: Option<Status>,
    modes: Vec<ReturnMode>,
    blank_mode: bool,
    model: Option<Result<Detection, DetectError>>,
    /// The model that is configured.
    given: Option<Model>,
    detector: Option<Detector>,
    /// Packets from before the model was known, each with its arrival.
    waiting: Vec<(DataPacket, i64)>,
    last_mode: Option<ReturnMode>,
    order: Option<PacketOrder>,
    motion: MotionStats,
    turns: Option<Turns>,
}

/// Statistics from the order of the packets.
#[derive(Default)]
struct MotionStats {
    lost: u64,
    duplicates: u64,
    late: u64,
    restarts: u64,
    sector: Option<Sector>,
    has_begun: bool,
}

impl Stream for DataStream {
    type Sweep = ();

    /// Position packets are counted by address.
    fn take(&mut self, packet: Option<&Packet<'_>>, placed: &Placed<'_>) {
        let Some(sent) = packet else {
            self.add_arrival(placed.datagram.arrival_ns);
            self.malformed += 1;
            return;
        };
        match (sent.content, &mut self.turns) {
            (Content::Position(position, _), Some(turns)) => turns.hear(&position),
            (Content::Data(packet), turns) => {
                if let Some(turns) = turns {
                    turns.add(sent);
                }
                self.add_arrival(sent.arrival_ns);
                self.add(packet, sent.arrival_ns);
            }
            (Content::Position(..), None) => {}
        }
    }

    fn idle(&mut self, time: SteadyTime) -> bool {
        if let Some(turns) = &mut self.turns {
            turns.idle(time.now_ns);
        }
        false
    }
}

impl DataStream {
    fn add_arrival(&mut self, arrival_ns: i64) {
        if self.packets == 0 {
            self.first_ns = arrival_ns;
        }
        self.last_ns = arrival_ns;
        self.packets += 1;
    }

    /// Adds a data packet.
    fn add(&mut self, packet: &DataPacket, arrival_ns: i64) {
        if packet.banks() == Banks::Alternating {
            let status = self.status.get_or_insert_default();
            status.push(packet.return_mode, packet.product, packet.stamp_us());
        } else if let Some(mode) = ReturnMode::from_byte(packet.return_mode) {
            self.add_mode(mode);
        } else {
            self.blank_mode = true;
        }
        if self.order.is_some() {
            self.put_in_order(packet, arrival_ns);
        } else if self.model.is_none() {
            self.waiting.push((*packet, arrival_ns));
            let given = self.given;
            let detector = self.detector.get_or_insert_with(|| Detector::new(given));
            if let Some(result) = detector.observe(packet) {
                self.decide(result);
            }
        }
    }

    fn add_mode(&mut self, mode: ReturnMode) {
        if !self.modes.contains(&mode) {
            self.modes.push(mode);
        }
    }

    fn decide(&mut self, result: Result<Detection, DetectError>) {
        self.model = Some(result);
        if let Ok(detection) = result {
            self.order = Some(PacketOrder::new(detection.spec));
            for (packet, arrival_ns) in std::mem::take(&mut self.waiting) {
                self.put_in_order(&packet, arrival_ns);
            }
        }
    }

    fn put_in_order(&mut self, packet: &DataPacket, arrival_ns: i64) {
        let (Some(order), Some(Ok(detection))) = (&mut self.order, self.model) else {
            return;
        };
        let banks = packet.banks();
        if !detection.has_layout(banks) {
            self.malformed += 1;
            return;
        }
        let last_mode = self.last_mode.unwrap_or(detection.return_mode);
        let mode = detection.mode_of(packet, banks, last_mode);
        match order.push(packet, mode, self.packets, arrival_ns) {
            Ok(()) => {}
            Err(Rejection::Duplicate) => self.motion.duplicates += 1,
            Err(Rejection::Behind { .. }) => self.motion.late += 1,
            Err(Rejection::Implausible(_)) => self.malformed += 1,
        }
        self.motion.follow(order);
        self.last_mode = Some(mode);
        if detection.model.is_hdl64e() {
            self.add_mode(mode);
        }
    }

    /// The capture ended: takes the packets that still wait.
    fn finish(&mut self) {
        if self.model.is_none()
            && let Some(detector) = &self.detector
        {
            let result = detector.conclude();
            self.decide(result);
        }
        if let Some(order) = &mut self.order {
            order.flush();
            self.motion.follow(order);
        }
        if let Some(turns) = &mut self.turns {
            turns.end();
        }
    }

    fn describe(&self, text: &mut String) {
        row(text, "model", self.model_text());
        let mode = self.mode_text();
        if !mode.is_empty() {
            row(text, "return mode", mode);
        }
        if let Some(status) = &self.status {
            status::describe(status, text);
        }
        let packets = count_of(self.packets, "packet");
        let rate = rate(self.packets, self.first_ns, self.last_ns);
        row(text, "data", packets + &rate);
        let speed = self.turns.as_ref().map(Turns::speed);
        if let Some(speed) = speed.filter(|speed| speed.mean_rpm().is_some()) {
            row(text, "speed", speed);
        }
        if let Some(order) = &self.order {
            self.motion.describe(text, order);
        }
        if let Some(turns) = &self.turns {
            turns.describe(text);
        }
        if self.malformed > 0 {
            row(text, "malformed", count_of(self.malformed, "packet"));
        }
    }

    fn report<'a>(&self, sender: &'a Sender, name: &'a str) -> SensorReport<'a> {
        let (detection, fault) = match &self.model {
            Some(Ok(detection)) => (Some(detection), None),
            Some(Err(error)) => (None, Some(error)),
            None => (None, None),
        };
        let (motion, turns) = (&self.motion, self.turns.as_ref());
        let speed = turns.map(Turns::speed);
        let mounted = turns.and_then(Turns::mounted);
        let side = mounted.as_ref().and_then(Mounted::side);
        let [floor, floor_if_hanging] = mounted.map_or_else(Default::default, |one| one.report());
        let counts = self
            .order
            .as_ref()
            .map(PacketOrder::counts)
            .unwrap_or_default();
        SensorReport {
            sender: SenderReport::new(sender, name),
            model: detection.map(|one| self.told_by_status(one).unwrap_or(one.model).name()),
            model_basis: detection.map(|one| one.basis.to_string()),
            fault: fault.map(|error| explain_model(error, self.dialect())),
            return_modes: self.modes.iter().map(|mode| mode.name()).collect(),
            rpm: speed
                .and_then(Speed::mean_rpm)
                .map(|rpm| rounded(rpm, 1000.0)),
            rpm_range: speed
                .and_then(Speed::bounds_rpm)
                .map(|range| range.map(|rpm| rounded(rpm.into(), 1000.0))),
            counter_clockwise: speed.is_some_and(Speed::is_reversed),
            left_out_deg: motion
                .sector
                .map(|sector| left_out_deg(sector).map(|deg| rounded(deg, 10.0))),
            packets: self.packets,
            packets_per_s: per_s(self.packets, self.first_ns, self.last_ns),
            lost_packets: motion.lost,
            reordered: counts.reordered,
            duplicates: motion.duplicates,
            late: motion.late,
            unconfirmed: counts.unconfirmed,
            malformed: self.malformed,
            restarts: motion.restarts,
            dark_beams: beams::json(&turns.map(Turns::dark_beams).unwrap_or_default()),
            eye: turns.map(Turns::eye).unwrap_or_default(),
            side: side.map(|(side, _)| side.name()),
            side_by: side.map(|(_, by)| by),
            floor,
            floor_if_hanging,
            unit: self.status.as_ref().and_then(status::report),
        }
    }

    /// Where its model is set.
    fn dialect(&self) -> Dialect {
        match self.given {
            Some(_) => Dialect::Configuration,
            None => Dialect::CommandLine,
        }
    }

    fn model_text(&self) -> String {
        let detection = match &self.model {
            Some(Ok(detection)) => detection,
            Some(Err(error)) => {
                let why = explain_model(error, self.dialect());
                return format!("cannot be decoded: {why}");
            }
            None => return "no well-formed packet tells".to_owned(),
        };
        match self.told_by_status(detection) {
            Some(model) => format!("{model}, by its two heads, packet period and status"),
            None => format!("{}, {}", detection.model, detection.basis.words()),
        }
    }

    /// With one return, the packets of both series are the same except for the status.
    fn told_by_status(&self, detection: &Detection) -> Option<Model> {
        let series = self.status.as_ref().and_then(Status::series);
        (detection.model == Model::Hdl64eS2 && series == Some(Series::S3))
            .then_some(Model::Hdl64eS3)
    }

    fn mode_text(&self) -> String {
        let mut modes: Vec<String> = self.modes.iter().map(ReturnMode::to_string).collect();
        if self.blank_mode {
            modes.push("not stated".to_owned());
        }
        let seen = modes.join(", ");
        let Some(stated) = self.status.as_ref().and_then(Status::return_mode) else {
            return seen;
        };
        let stated = stated.to_string();
        if seen.is_empty() || stated == seen {
            format!("{stated}, by its status")
        } else {
            format!("{seen}; its status says {stated}")
        }
    }
}

impl MotionStats {
    fn follow(&mut self, order: &mut PacketOrder) {
        while let Some((_, before)) = order.pop() {
            match before {
                PacketGap::Lost { packets, .. } => self.lost += u64::from(packets),
                PacketGap::Start if self.has_begun => self.restarts += 1,
                PacketGap::Start | PacketGap::None | PacketGap::Blanked => {}
            }
            self.has_begun = true;
        }
        self.sector = order.sector().or(self.sector);
    }

    fn describe(&self, text: &mut String, order: &PacketOrder) {
        if let Some(sector) = self.sector {
            let [from, to] = left_out_deg(sector);
            let sector = format_args!(
                "azimuth {from:.1} to {to:.1} degrees: the sensor's field of view is limited"
            );
            row(text, "left out", sector);
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
        row(text, "losses", losses);
    }
}

/// The first azimuth and the last of a sector, degrees.
fn left_out_deg(sector: Sector) -> [f64; 2] {
    let from = sector.from_cdeg / 100.0;
    [from, (from + sector.width_cdeg / 100.0).rem_euclid(360.0)]
}
