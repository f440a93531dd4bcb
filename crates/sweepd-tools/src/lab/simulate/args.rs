//! The options of `sweepd simulate`, and the sensors that they ask for.

use std::net::{Ipv4Addr, SocketAddr};
use std::path::PathBuf;
use std::time::SystemTime;

use clap::ValueEnum;

use super::faults::FaultOptions;
use super::truth::former;
use crate::scene::scene;
use sweepd::cli::CliError;
use sweepd::cli::options::{model, within};
use sweepd::cli::output::ForceOptions;
use sweepd::cli::play::destination;
use sweepd::files;
use sweepd::files::output::Former;
use sweepd_core::segment::Mount;
use sweepd_core::sensor::model::Spec;
use sweepd_core::sensor::{Calibration, Model, ModelExt};
use sweepd_core::wire::data::ReturnMode;
use sweepd_lab::simulate::gps::{Clock, ReceiverFault, Reception};
use sweepd_lab::simulate::shape::Vec3;
use sweepd_lab::simulate::{EmitterConfig, Motion, Motor, Scene, Setting};

/// Most sensors: their addresses are 192.168.1.201 to .254.
const MAX_SENSORS: usize = 54;
/// Default speed, turns a minute.
const RPM: f64 = 600.0;
/// Default duration, seconds.
pub const SECONDS: f64 = 10.0;
/// First shot in a capture: 2026-05-04 10:17:23 UTC, so that the same command gives the same bytes.
const START_UTC_NS: i64 = 1_777_889_843_000_000_000;

/// Options of `sweepd simulate`.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
The truth (--truth DIR), for scoring a segmentation:
  objects.csv  object,class; classes are ground, building, car, lorry,
               person, cyclist, pole, sign, tree, furniture and pallet
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
  sweepd simulate --model vlp16 --scene warehouse --height 0.4 --pitch -10 --pcap robot.pcap
  sweepd simulate --model hdl64e-s3 --returns dual --pcap hdl64e.pcap.gz
  sweepd simulate --model vlp16 --model hdl32e --to 127.0.0.1:2368
  sweepd simulate --model vlp16 --loss 1 --pcap lossy.pcap --truth truth
  sweepd simulate --from-cloud 0.bin --calibration unit.xml --pcap real.pcap")]
pub struct Args {
    /// Model: vlp16, puck-lite, puck-hires, vlp32c, hdl32e, hdl64e-s2 (S2.1 too), hdl64e-s3 or
    /// vls128; several times for several sensors in one scene, with the addresses 192.168.1.201,
    /// 192.168.1.202, ...
    #[arg(long = "model", value_name = "MODEL", required_unless_present = "from_cloud", value_parser = model(), hide_possible_values = true)]
    pub(super) models: Vec<Model>,
    /// Scene; all sensors stand in the same one
    #[arg(long, default_value = "street", value_parser = scene())]
    pub(super) scene: Setting,
    #[command(flatten)]
    pub(super) mount: MountOptions,
    /// Seed of all chance: of the scene, the noise and the faults
    #[arg(long, value_name = "N", default_value = "1", value_parser = seed, allow_negative_numbers = true)]
    pub(super) seed: u64,
    /// Turns a minute [default: 600]
    #[arg(
        long,
        value_parser = within(300.0..=1200.0, "turns a minute"),
        allow_negative_numbers = true
    )]
    pub(super) rpm: Option<f64>,
    /// One return a shot, the strongest, or two; an hdl64e-s2 has one
    #[arg(long, value_name = "WHICH", value_enum, default_value_t = Returns::Single)]
    pub(super) returns: Returns,
    /// Simulate this unit: db.xml or ROS YAML [default: the model's own table; of an HDL-64E, an
    /// invented unit, which depends on --seed]
    #[arg(long, value_name = "FILE")]
    pub(super) calibration: Option<PathBuf>,
    /// From one firing to the next: 48 or 57.6 of an hdl64e-s3 with one return, of which sources
    /// contradict each other; 53.3, 55.3 or 57.8 of a vls128, by its firmware [default: 48, 55.3]
    #[arg(long, value_name = "MICROSECONDS", value_parser = firing_period, allow_negative_numbers = true)]
    pub(super) firing_period: Option<f64>,
    /// The GPS receiver: locked, none, or the seconds FROM..TO in which it has satellites; either
    /// may be left out, such as 2..; the clock follows two seconds after FROM
    #[arg(long, value_name = "WHEN", default_value = "locked", value_parser = gps, allow_negative_numbers = true)]
    pub(super) gps: GpsReceiver,
    /// What is wrong with the receiver's time, though it says that it is valid: week (1024 weeks too
    /// early), frozen (one sentence again and again), unset (it counts from 2000-01-01), garbled (each
    /// second check sum), gga (GGA alone, which has no date), or the seconds that it is ahead; with
    /// @FROM..TO only then, such as 3600@5..10
    #[arg(long, value_name = "WHAT", value_parser = receiver_fault, allow_negative_numbers = true)]
    pub(super) gps_fault: Option<(ReceiverFault, Reception)>,
    /// By how much the speed of the motor drifts up and down, percent
    #[arg(
        long, value_name = "PERCENT", default_value = "0.03",
        value_parser = within(0.0..=20.0, "percent"), allow_negative_numbers = true
    )]
    pub(super) rpm_drift: f64,
    /// The sensors move: to the right and ahead in the scene, metres a second
    #[arg(long, value_name = "RIGHT,AHEAD", default_value = "0,0", value_parser = velocity, allow_hyphen_values = true)]
    pub(super) velocity: Vec3,
    /// The sensors turn, clockwise seen from above, degrees a second
    #[arg(
        long, value_name = "DEG", default_value = "0",
        value_parser = within(-360.0..=360.0, "degrees a second"), allow_negative_numbers = true
    )]
    pub(super) turn_rate: f64,
    /// For how long [default: 10]
    #[arg(
        long,
        value_name = "SECONDS",
        value_parser = within(0.01..=86_400.0, "seconds"),
        allow_negative_numbers = true
    )]
    pub(super) seconds: Option<f64>,
    #[command(flatten)]
    pub(super) target: Target,
    /// Write the true values of every return there: truth.csv and objects.csv; the truth.csv of
    /// each sensor but the first is in its own folder
    #[arg(long, value_name = "DIR")]
    pub(super) truth: Option<PathBuf>,
    #[command(flatten)]
    pub(super) force: ForceOptions,
    #[command(flatten)]
    pub(super) cloud: CloudOptions,
    #[command(flatten)]
    pub(super) faults: FaultOptions,
}

/// How the sensors are mounted.
#[derive(Clone, Copy, Debug, clap::Args)]
pub struct MountOptions {
    /// Height of the sensors above the ground, metres [default: 1.9; room 0.9, corridor and
    /// warehouse 0.4]
    #[arg(long, value_name = "M", value_parser = within(0.01..=200.0, "metres"), allow_negative_numbers = true)]
    height: Option<f64>,
    /// Pitch of the sensors, nose up, degrees from plumb
    #[arg(
        long, value_name = "DEG", default_value = "0",
        value_parser = within(-90.0..=90.0, "degrees"), allow_negative_numbers = true
    )]
    pitch: f64,
    /// Roll of the sensors, right side down, degrees from plumb; 180 is head down
    #[arg(
        long, value_name = "DEG", default_value = "0",
        value_parser = within(-180.0..=180.0, "degrees"), allow_negative_numbers = true
    )]
    roll: f64,
}

impl MountOptions {
    fn mount(self) -> Mount {
        Mount {
            height_m: self.height.map(|height_m| height_m as f32),
            pitch_rad: self.pitch.to_radians() as f32,
            roll_rad: self.roll.to_radians() as f32,
        }
    }
}

/// Where the datagrams go.
#[derive(Clone, Debug, clap::Args)]
#[group(required = true, multiple = false)]
pub struct Target {
    /// Write a capture, as fast as possible: NAME.pcap or NAME.pcap.gz; - is standard output
    #[arg(long, value_name = "FILE")]
    pub(super) pcap: Option<PathBuf>,
    /// Send as a sensor does, in real time: data and position packets to one port, each sensor from
    /// its own port
    #[arg(long, value_name = "ADDR:PORT", value_parser = destination)]
    pub(super) to: Option<SocketAddr>,
}

/// Values of `--returns`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Returns {
    /// The strongest
    Single,
    /// The last, and the strongest or second strongest
    Dual,
}

/// Value of `--gps`: none, or when it has satellites.
#[derive(Clone, Copy, Debug)]
pub struct GpsReceiver(Option<Reception>);

impl GpsReceiver {
    /// What the sensor's clock follows.
    pub(super) fn clock(self) -> Clock {
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

fn receiver_fault(text: &str) -> Result<(ReceiverFault, Reception), String> {
    let (what, when) = text.split_once('@').unwrap_or((text, ".."));
    let fault = match what {
        "week" => Some(ReceiverFault::Week),
        "frozen" => Some(ReceiverFault::Frozen),
        "unset" => Some(ReceiverFault::Unset),
        "garbled" => Some(ReceiverFault::Garbled),
        "gga" => Some(ReceiverFault::Gga),
        _ => within(-86_400_000.0..=86_400_000.0, "seconds")(what)
            .ok()
            .map(|seconds| ReceiverFault::Ahead((seconds * 1e9) as i64)),
    };
    fault.zip(reception(when)).ok_or_else(|| {
        "expected week, frozen, unset, garbled, gga or the seconds ahead, and then perhaps @FROM..TO in seconds, such as 3600@5..10"
            .to_owned()
    })
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

/// `RIGHT,AHEAD`, metres a second.
fn velocity(text: &str) -> Result<Vec3, String> {
    let parse = within(-100.0..=100.0, "metres a second");
    let (right, ahead) = text
        .split_once(',')
        .ok_or_else(|| "expected RIGHT,AHEAD in metres a second, such as 0,15".to_owned())?;
    Ok(Vec3::new(parse(right)?, parse(ahead)?, 0.0))
}

/// Microseconds.
fn firing_period(text: &str) -> Result<f64, String> {
    text.parse()
        .ok()
        .filter(|us| (1.0..1e3).contains(us))
        .ok_or_else(|| "expected microseconds, such as 48".to_owned())
}

/// From one firing to the next with one return, microseconds to one decimal.
fn firing_us(spec: &Spec) -> f64 {
    (f64::from(spec.firing_period_ns(ReturnMode::Strongest)) / 100.0).round() / 10.0
}

fn seed(text: &str) -> Result<u64, String> {
    text.parse()
        .map_err(|_| format!("expected a whole number from 0 to {}", u64::MAX))
}

/// Options of a simulation from a cloud.
#[derive(Clone, Debug, clap::Args)]
#[command(next_help_heading = "A real scan instead of a scene")]
pub struct CloudOptions {
    /// Encode this KITTI cloud (x forward, y left, z up, remission as f32, ring after ring) as the
    /// packets of an HDL-64E S2 with the given --calibration, at 600 turns a minute unless --rpm is
    /// given: one turn, with a part of a turn before and after it; with --seconds, the same turn
    /// repeated. Each point goes to the firing of its column in the image of `sweepd segment`, so
    /// that its range is kept, and its azimuth to about a column; where two points find no room,
    /// the nearer one is sent
    #[arg(
        long,
        value_name = "FILE.bin",
        conflicts_with_all = ["models", "scene", "height", "pitch", "roll", "returns", "velocity", "turn_rate", "spin_up", "stall", "mode_switch", "new_rpm", "fov", "clock_step", "restart", "exchange"]
    )]
    pub(super) from_cloud: Option<PathBuf>,
    /// Fit each beam's elevation and vertical offset to the scan, and write that calibration for
    /// the replay: with the elevations of another unit, flat ground is bent
    #[arg(long)]
    pub(super) fit_elevations: bool,
    /// Where to write the fitted calibration, ROS YAML [default: NAME.yaml beside the NAME.pcap]
    #[arg(long, value_name = "FILE.yaml")]
    pub(super) fitted: Option<PathBuf>,
}

impl CloudOptions {
    /// Refuses options without those that they need. (The parser accepts them if an option is given
    /// that excludes the others.)
    ///
    /// # Errors
    /// [`CliError::Usage`].
    pub(super) fn check(&self) -> Result<(), CliError> {
        if self.fit_elevations && self.from_cloud.is_none() {
            let message = "--fit-elevations needs --from-cloud FILE.bin, the scan to fit to";
            return Err(CliError::Usage(message.to_owned()));
        }
        if self.fitted.is_some() && !self.fit_elevations {
            let message = "--fitted needs --fit-elevations: without it the packets are those of the given --calibration";
            return Err(CliError::Usage(message.to_owned()));
        }
        Ok(())
    }
}

impl Args {
    pub(super) fn check(&self) -> Result<(), CliError> {
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
    pub(super) fn former_truth(&self) -> Result<Former, CliError> {
        self.truth.as_ref().map_or(Ok(Former::default()), |folder| {
            former(folder, self.force.existing())
        })
    }

    /// The timing of a model.
    fn spec(&self, model: Model) -> Result<&'static Spec, CliError> {
        let Some(period_us) = self.firing_period else {
            return Ok(model.spec());
        };
        let specs = model.specs();
        let found = specs.iter().find(|spec| firing_us(spec) == period_us);
        found.copied().ok_or_else(|| {
            let known: Vec<_> = specs
                .iter()
                .map(|spec| firing_us(spec).to_string())
                .collect();
            CliError::Usage(format!(
                "--firing-period: the {model} fires every {} us",
                known.join(" or ")
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
        let other = Model::Hdl64eS3.flag();
        Err(CliError::Usage(format!(
            "{flag}: an {model} has one return; one that has two is --model {other}"
        )))
    }

    /// The calibration, fitted to a model.
    pub(super) fn calibration(&self, model: Model) -> Result<Option<Calibration>, CliError> {
        let Some(path) = &self.calibration else {
            return Ok(None);
        };
        let fitted = files::calibration(path)?.for_model(model);
        fitted.map(Some).map_err(|error| {
            CliError::Failed(format!(
                "--calibration {} does not fit the {model}: {error}",
                path.display()
            ))
        })
    }

    /// First shot.
    pub(super) fn start_utc_ns(&self) -> i64 {
        match self.target.to {
            Some(_) => SystemTime::UNIX_EPOCH
                .elapsed()
                .map_or(START_UTC_NS, |since| since.as_nanos() as i64),
            None => START_UTC_NS,
        }
    }

    /// The sensors to simulate in a scene.
    pub(super) fn configs(&self, scene: &Scene) -> Result<Vec<EmitterConfig>, CliError> {
        let start_utc_ns = self.start_utc_ns();
        let mode = if self.returns == Returns::Dual {
            ReturnMode::Dual
        } else {
            ReturnMode::Strongest
        };
        let mount = self.mount.mount();
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
            config.eye = self.faults.eye;
            let pose = self.scene.mounted(scene, number, &mount);
            config.pose = pose.map_err(|error| {
                CliError::Failed(format!(
                    "{error}; give another --height, --scene or --seed, or fewer sensors"
                ))
            })?;
            config.motion = Motion {
                velocity: self.velocity,
                turn_rad_s: self.turn_rate.to_radians(),
            };
            config.restart_ns = self.faults.restart_ns();
            config.clock = match config.restart_ns {
                Some(_) => Clock::Free { hour_ns: 0 },
                None => self.gps.clock(),
            };
            config.receiver_fault = self.gps_fault;
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
                .map_err(CliError::Failed)?;
            configs.push(config);
        }
        Ok(configs)
    }
}
