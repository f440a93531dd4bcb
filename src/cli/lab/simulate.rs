//! `sweepd simulate`: simulated sensors in a simulated scene.

mod cloud;
mod faults;
mod progress;
mod truth;

use std::io::{self, Write};
use std::iter::Peekable;
use std::net::{Ipv4Addr, SocketAddr};
use std::path::PathBuf;
use std::time::{Instant, SystemTime};

use clap::ValueEnum;

use self::cloud::CloudOptions;
use self::faults::FaultOptions;
use self::progress::Progress;
use self::truth::{TruthFile, former, write_objects};
use super::sink::CaptureFile;
use crate::capture::write::Addressed;
use crate::capture::{Pacer, Speed};
use crate::cli::CliError;
use crate::cli::options::{model, within};
use crate::cli::output::ForceOptions;
use crate::cli::play::destination;
use crate::cli::send::Sender;
use crate::export::Existing;
use crate::files;
use crate::files::output::{Former, sensor_folder};
use sweepd_core::sensor::model::Spec;
use sweepd_core::sensor::{Calibration, Model};
use sweepd_core::wire::data::{DATA_PACKET_LEN, ReturnMode};
use sweepd_core::wire::{DATA_PORT, POSITION_PORT};
use sweepd_lab::simulate::clock::{Clock, Reception};
use sweepd_lab::simulate::delivery::Delivery;
use sweepd_lab::simulate::{
    Emitter, EmitterConfig, Faults, Motor, Scene, Setting, SimulatedDatagram, deliver,
};

/// Options of `sweepd simulate`.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
The truth (--truth DIR), for scoring a segmentation:
  objects.csv  object,class; classes are ground, building, car, lorry,
               person, cyclist, pole, sign, tree and furniture
  truth.csv    packet,block,record,object,class,range_m,azimuth_deg,time_ns:
               a line per return that was delivered, before noise and
               rounding. Packets and blocks are counted as in the files of
               replay --csv; record modulo the number of beams is the
               channel (odd blocks of an HDL-64E: 32 more); azimuth is where
               the beam pointed; time is UTC since 1970

With --from-cloud, object is the index of the point in the cloud, from 0, by which its labels are \
found; class is unknown, range_m is from the origin of the beam, and there is no objects.csv.

Examples:
  sweepd simulate --model vlp16 --pcap street.pcap.gz
  sweepd simulate --model hdl32e --scene room --pcap - | sweepd replay -
  sweepd simulate --model hdl64e-s3 --returns dual --pcap hdl64e.pcap.gz
  sweepd simulate --model vlp16 --model hdl32e --to 127.0.0.1:2368
  sweepd simulate --model vlp16 --loss 1 --pcap lossy.pcap --truth truth
  sweepd simulate --from-cloud 0.bin --calibration unit.xml --pcap real.pcap")]
pub struct Args {
    /// Model: vlp16, puck-lite, puck-hires, hdl32e, hdl64e-s2 (S2.1 too) or hdl64e-s3; several
    /// times for several sensors in one scene, with the addresses 192.168.1.201, 192.168.1.202, ...
    #[arg(long = "model", value_name = "MODEL", required_unless_present = "from_cloud", value_parser = model)]
    models: Vec<Model>,
    /// Scene: street, parking-lot, field or room
    #[arg(long, default_value = "street", value_parser = setting)]
    scene: Setting,
    /// Seed of all chance: of the scene, the noise and the faults
    #[arg(long, value_name = "N", default_value = "1", value_parser = seed, allow_negative_numbers = true)]
    seed: u64,
    /// Turns a minute [default: 600]
    #[arg(
        long,
        value_parser = within(300.0..=1200.0, "turns a minute"),
        allow_negative_numbers = true
    )]
    rpm: Option<f64>,
    /// One return a shot, the strongest, or two; an hdl64e-s2 has one
    #[arg(long, alias = "return", value_name = "WHICH", value_enum, default_value_t = Returns::Single)]
    returns: Returns,
    /// Simulate this unit: db.xml or ROS YAML [default: the model's own table; of an HDL-64E, a
    /// unit that is made up, another one for each seed]
    #[arg(long, value_name = "FILE")]
    calibration: Option<PathBuf>,
    /// From one firing of an hdl64e-s3 with one return to the next: 48 or 57.6; sources contradict
    /// each other [default: 48]
    #[arg(long, value_name = "MICROSECONDS", value_parser = firing_period, allow_negative_numbers = true)]
    firing_period: Option<u32>,
    /// The GPS receiver: locked, none, or the seconds FROM..TO in which it hears satellites, either
    /// left out if need be, such as 2..; the clock follows two seconds after FROM
    #[arg(long, value_name = "WHEN", default_value = "locked", value_parser = gps, allow_negative_numbers = true)]
    gps: GpsReceiver,
    /// By how much the speed of the motor drifts up and down, percent
    #[arg(
        long, value_name = "PERCENT", default_value = "0.03",
        value_parser = within(0.0..=20.0, "percent"), allow_negative_numbers = true
    )]
    rpm_drift: f64,
    /// For how long [default: 10]
    #[arg(
        long,
        value_name = "SECONDS",
        value_parser = within(0.01..=86_400.0, "seconds"),
        allow_negative_numbers = true
    )]
    seconds: Option<f64>,
    #[command(flatten)]
    target: Target,
    /// Write there what every return really was: truth.csv and objects.csv; the truth.csv of each
    /// sensor but the first is in a folder of its own
    #[arg(long, value_name = "DIR")]
    truth: Option<PathBuf>,
    #[command(flatten)]
    force: ForceOptions,
    #[command(flatten)]
    cloud: CloudOptions,
    #[command(flatten)]
    faults: FaultOptions,
}

/// Where the datagrams go.
#[derive(Clone, Debug, clap::Args)]
#[group(required = true, multiple = false)]
struct Target {
    /// Write a capture, as fast as possible: NAME.pcap or NAME.pcap.gz; - is standard output
    #[arg(long, value_name = "FILE")]
    pcap: Option<PathBuf>,
    /// Send as a sensor does, in real time: data and position packets to one port, each sensor from
    /// a port of its own
    #[arg(long, value_name = "ADDR:PORT", value_parser = destination)]
    to: Option<SocketAddr>,
}

/// Values of `--returns`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Returns {
    /// The strongest
    Single,
    /// The last, and the strongest or second strongest
    Dual,
}

/// A scene, by its name.
fn setting(text: &str) -> Result<Setting, String> {
    Setting::ALL
        .into_iter()
        .find(|setting| setting.name() == text)
        .ok_or_else(|| {
            let names = Setting::ALL.map(Setting::name).join(", ");
            format!("no scene; expected one of {names}")
        })
}

/// Value of `--gps`: none, or when it hears satellites.
#[derive(Clone, Copy, Debug)]
struct GpsReceiver(Option<Reception>);

impl GpsReceiver {
    /// What the sensor's clock follows.
    fn clock(self) -> Clock {
        match self.0 {
            // In Frankfurt, as the captures in `pcap_fixtures/` are.
            Some(reception) => Clock::Gps {
                position_deg: (50.110_6, 8.682_1),
                reception,
            },
            None => Clock::Free { hour_ns: 0 },
        }
    }
}

fn gps(text: &str) -> Result<GpsReceiver, String> {
    match text {
        "none" => Ok(GpsReceiver(None)),
        "locked" => Ok(GpsReceiver(Some(Reception::ALWAYS))),
        _ => reception(text)
            .map(|reception| GpsReceiver(Some(reception)))
            .ok_or_else(|| {
                "expected locked, none, or FROM..TO in seconds from 0 to 86400, such as 2.., ..5 or 2..5"
                    .to_owned()
            }),
    }
}

/// `FROM..TO`, `FROM..` or `..TO`, in seconds.
fn reception(text: &str) -> Option<Reception> {
    let (from, to) = text.split_once("..")?;
    let mut reception = Reception::ALWAYS;
    if !from.is_empty() {
        reception.from_ns = gps_second(from)?;
    }
    if !to.is_empty() {
        reception.to_ns = gps_second(to)?;
    }
    (reception.from_ns < reception.to_ns).then_some(reception)
}

fn gps_second(text: &str) -> Option<i64> {
    let seconds = within(0.0..=86_400.0, "seconds")(text).ok()?;
    Some((seconds * 1e9) as i64)
}

/// Microseconds as nanoseconds.
fn firing_period(text: &str) -> Result<u32, String> {
    match text.parse::<f64>() {
        Ok(48.0) => Ok(48_000),
        Ok(57.6) => Ok(57_600),
        _ => Err("expected 48 or 57.6 microseconds".to_owned()),
    }
}

fn seed(text: &str) -> Result<u64, String> {
    text.parse()
        .map_err(|_| format!("expected a whole number from 0 to {}", u64::MAX))
}

/// Most sensors: their addresses are 192.168.1.201 to .254.
const MAX_SENSORS: usize = 54;
/// Default speed, turns a minute.
const RPM: f64 = 600.0;
/// Default duration, seconds.
const SECONDS: f64 = 10.0;
/// First shot in a capture: 2026-05-04 10:17:23 UTC, so that the same command gives the same bytes.
const START_UTC_NS: i64 = 1_777_889_843_000_000_000;

/// Runs the command.
///
/// # Errors
/// [`CliError`]: an invalid value, a file that cannot be read or written, an error of the network.
pub fn run(args: &Args) -> Result<(), CliError> {
    args.check()?;
    if let Some(file) = &args.cloud.from_cloud {
        return cloud::run(args, file);
    }
    let configs = args.configs()?;
    let existing = args.force.existing();
    let former = args.former_truth()?;
    let scene = args.scene.build(args.seed);
    let mut sensors = configs
        .iter()
        .map(|config| Simulated::new(args, config, &scene))
        .collect::<Result<Vec<_>, _>>()?;
    let mut output = Output::open(&args.target, existing)?;
    let mut progress = Progress::new(Some(args.seconds.unwrap_or(SECONDS)));
    while let Some((mut index, mut datagram)) = next(&mut sensors) {
        let elapsed_ns = datagram.arrival_ns - configs[index].start_utc_ns;
        if index < 2 && args.faults.is_exchanged(elapsed_ns) {
            index = 1 - index;
            datagram.source.set_ip(configs[index].address);
        }
        output.send(index, &datagram)?;
        progress.note(datagram.arrival_ns);
        sensors[index].note(&datagram)?;
    }
    progress.finish();
    output.finish()?;
    former.remove()?;
    if let Some(folder) = &args.truth {
        write_objects(folder, existing, &scene)?;
    }
    sensors.into_iter().try_for_each(Simulated::finish)
}

/// The next datagram of all sensors by time of arrival, and the number of its sensor.
fn next(sensors: &mut [Simulated<'_>]) -> Option<(usize, SimulatedDatagram)> {
    let mut first: Option<(i64, usize)> = None;
    for (index, sensor) in sensors.iter_mut().enumerate() {
        if let Some(datagram) = sensor.datagrams.peek()
            && first.is_none_or(|(arrival_ns, _)| datagram.arrival_ns < arrival_ns)
        {
            first = Some((datagram.arrival_ns, index));
        }
    }
    let (_, index) = first?;
    Some((index, sensors[index].datagrams.next()?))
}

impl Args {
    fn check(&self) -> Result<(), CliError> {
        if self.models.len() > MAX_SENSORS {
            let count = self.models.len();
            return Err(CliError::Usage(format!(
                "--model is given {count} times; expected at most {MAX_SENSORS}"
            )));
        }
        self.cloud.check()?;
        self.faults
            .check(self.models.len(), self.seconds.unwrap_or(SECONDS))
    }

    /// Files of a former run in the folder of the truth.
    fn former_truth(&self) -> Result<Former, CliError> {
        self.truth.as_ref().map_or(Ok(Former::default()), |folder| {
            former(folder, self.force.existing())
        })
    }

    /// The timing of a model.
    fn spec(&self, model: Model) -> Result<&'static Spec, CliError> {
        let Some(period_ns) = self.firing_period else {
            return Ok(model.spec());
        };
        if let [only] = model.specs() {
            let us = f64::from(only.firing_period_ns(ReturnMode::Strongest)) / 1e3;
            let message = format!(
                "--firing-period: the {model} always fires every {us} us; only the {} may differ",
                Model::Hdl64eS3
            );
            return Err(CliError::Usage(message));
        }
        let found = model
            .specs()
            .iter()
            .find(|spec| spec.firing_period_ns(ReturnMode::Strongest) == period_ns);
        found.copied().ok_or_else(|| {
            CliError::Usage(format!(
                "--firing-period: the {model} never fires every {} us",
                f64::from(period_ns) / 1e3
            ))
        })
    }

    /// An HDL-64E S2 has one return.
    fn check_returns(&self, model: Model) -> Result<(), CliError> {
        let flag = match (self.returns, self.faults.mode_switch) {
            (Returns::Dual, _) => "--returns dual",
            (Returns::Single, Some(_)) => "--mode-switch",
            (Returns::Single, None) => return Ok(()),
        };
        if model != Model::Hdl64eS2 {
            return Ok(());
        }
        let other = Model::Hdl64eS3.spec().flag;
        Err(CliError::Usage(format!(
            "{flag}: an {model} has one return; one that has two is --model {other}"
        )))
    }

    /// The calibration, fitted to a model.
    fn calibration(&self, model: Model) -> Result<Option<Calibration>, CliError> {
        let Some(path) = &self.calibration else {
            return Ok(None);
        };
        let fitted = files::calibration(path)?.for_model(model);
        fitted.map(Some).map_err(|error| {
            CliError::Usage(format!(
                "--calibration {} does not fit the {model}: {error}",
                path.display()
            ))
        })
    }

    /// First shot.
    fn start_utc_ns(&self) -> i64 {
        match self.target.to {
            Some(_) => SystemTime::UNIX_EPOCH
                .elapsed()
                .map_or(START_UTC_NS, |since| since.as_nanos() as i64),
            None => START_UTC_NS,
        }
    }

    /// The sensors to simulate.
    fn configs(&self) -> Result<Vec<EmitterConfig>, CliError> {
        let start_utc_ns = self.start_utc_ns();
        let mode = if self.returns == Returns::Dual {
            ReturnMode::Dual
        } else {
            ReturnMode::Strongest
        };
        let mut configs = Vec::with_capacity(self.models.len());
        for (number, &model) in self.models.iter().enumerate() {
            self.check_returns(model)?;
            let mut config = EmitterConfig::new(model, mode);
            config.spec = self.spec(model)?;
            config.rpm = self.rpm.unwrap_or(RPM);
            config.calibration = self.calibration(model)?;
            config.motor = Motor {
                drift: self.rpm_drift / 100.0,
                ..self.faults.motor(config.rpm)
            };
            config.fov = self.faults.fov;
            config.clock_step = self.faults.clock_step;
            config.pose = self.scene.pose(number);
            config.clock = self.gps.clock();
            config.start_utc_ns = start_utc_ns;
            config.address = Ipv4Addr::new(192, 168, 1, 201 + number as u8);
            config.seed = self.seed.wrapping_add((number as u64) << 32);
            let config = config.seconds(self.seconds.unwrap_or(SECONDS), self.faults.mode_switch);
            config
                .check()
                .map_err(|error| match &self.calibration {
                    Some(path) => format!("--calibration {}: {error}", path.display()),
                    None => error,
                })
                .map_err(CliError::Usage)?;
            configs.push(config);
        }
        Ok(configs)
    }
}

/// A sensor at work.
struct Simulated<'a> {
    config: EmitterConfig,
    faults: Faults,
    datagrams: Peekable<Delivery<Emitter<'a>>>,
    truth: Option<TruthFile>,
    data: u64,
    position: u64,
}

impl<'a> Simulated<'a> {
    fn new(args: &Args, config: &EmitterConfig, scene: &'a Scene) -> Result<Self, CliError> {
        let faults = args.faults.rates().plan(config.seed, config.sent_packets());
        let folder = args
            .truth
            .as_ref()
            .map(|folder| match config.address.octets() {
                [.., 201] => folder.clone(),
                _ => folder.join(sensor_folder(&format!("{}:{DATA_PORT}", config.address))),
            });
        let emitter = Emitter::new(config.clone(), scene);
        let emitter = if folder.is_some() {
            emitter
        } else {
            emitter.untold()
        };
        Ok(Self {
            truth: folder
                .map(|folder| {
                    TruthFile::create(&folder, args.force.existing(), config.start_utc_ns)
                })
                .transpose()?,
            datagrams: deliver(emitter, faults.clone()).peekable(),
            config: config.clone(),
            faults,
            data: 0,
            position: 0,
        })
    }

    fn note(&mut self, sent: &SimulatedDatagram) -> Result<(), CliError> {
        let Some(truth) = &sent.truth else {
            self.position += u64::from(sent.destination.port() == POSITION_PORT);
            return Ok(());
        };
        self.data += 1;
        // A packet of another length is not counted, as in a replay.
        match &mut self.truth {
            Some(file) if sent.payload.len() == DATA_PACKET_LEN => file.packet(truth),
            _ => Ok(()),
        }
    }

    /// Finishes the truth, and prints on standard error what was sent, and its faults.
    fn finish(self) -> Result<(), CliError> {
        self.truth.map_or(Ok(()), TruthFile::finish)?;
        let config = &self.config;
        let switched = match config.mode_switch {
            Some(at) => format!(", {} from data packet {at}", config.mode_of(at)),
            None => String::new(),
        };
        // If standard error is closed, the message is lost.
        let _ = writeln!(
            io::stderr(),
            "{} ({}): data packets {}, position packets {}; injected: {}{switched}",
            config.address,
            config.model,
            self.data,
            self.position,
            self.faults.summary()
        );
        Ok(())
    }
}

/// Where the datagrams go, open.
enum Output {
    File(CaptureFile),
    Network {
        sender: Sender,
        pacer: Pacer,
        start: Instant,
    },
}

impl Output {
    fn open(target: &Target, existing: Existing) -> Result<Self, CliError> {
        match (&target.pcap, target.to) {
            (Some(path), _) => Ok(Self::File(CaptureFile::create(path, existing)?)),
            (None, Some(to)) => Ok(Self::Network {
                sender: Sender::new(to),
                pacer: Pacer::new(Speed::REALTIME),
                start: Instant::now(),
            }),
            (None, None) => Err(CliError::Usage(
                "expected --pcap FILE or --to ADDR:PORT".to_owned(),
            )),
        }
    }

    fn send(&mut self, sensor: usize, sent: &SimulatedDatagram) -> Result<(), CliError> {
        match self {
            Self::File(file) => file.write(&Addressed {
                arrival_ns: sent.arrival_ns,
                source: sent.source,
                destination: sent.destination,
                payload: &sent.payload,
            }),
            Self::Network {
                sender,
                pacer,
                start,
            } => {
                let wait = pacer.wait(sent.arrival_ns, start.elapsed().as_nanos() as u64);
                if !wait.is_zero() {
                    std::thread::sleep(wait);
                }
                let ip = (*sent.source.ip()).into();
                match sent.destination.port() {
                    DATA_PORT => sender.data(sensor, ip, &sent.payload),
                    _ => sender.position(ip, &sent.payload),
                }
            }
        }
    }

    fn finish(self) -> Result<(), CliError> {
        match self {
            Self::File(file) => file.finish(),
            Self::Network { .. } => Ok(()),
        }
    }
}
