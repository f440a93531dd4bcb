//! Options that several subcommands share.

use std::ffi::OsStr;
use std::net::Ipv4Addr;
use std::ops::RangeInclusive;
use std::path::PathBuf;
use std::str::FromStr;

use clap::ValueEnum;
use clap::builder::{PossibleValue, TypedValueParser};

use crate::admission::{SensorFilter, SensorFilterError};
use crate::cli::error::read_calibration;
use crate::cli::{CliError, complain};
use crate::files;
use crate::publish::is_sensor_name;
use crate::suggest::nearest;
use sweepd_core::assemble::BodyBox;
use sweepd_core::pipeline;
use sweepd_core::segment::settings::{REMOVED, Removed, Unit};
use sweepd_core::segment::{self, SETTINGS, Setting};
use sweepd_core::sensor::Model;
use sweepd_core::sensor::model::UnknownModel;
use sweepd_core::sweep::layout::ReturnChoice;
use sweepd_core::wire::{DATA_PORT, POSITION_PORT};

/// Reads a model by its flag or its name; help and completions have the flags.
pub fn model() -> impl TypedValueParser<Value = Model> {
    ModelParser
}

#[derive(Clone)]
struct ModelParser;

impl TypedValueParser for ModelParser {
    type Value = Model;

    fn parse_ref(
        &self,
        command: &clap::Command,
        argument: Option<&clap::Arg>,
        value: &OsStr,
    ) -> Result<Model, clap::Error> {
        let read: fn(&str) -> Result<Model, String> = read_model;
        read.parse_ref(command, argument, value)
    }

    fn possible_values(&self) -> Option<Box<dyn Iterator<Item = PossibleValue> + '_>> {
        let values = Model::ALL.map(|model| PossibleValue::new(model.flag()).help(model.name()));
        Some(Box::new(values.into_iter()))
    }
}

fn read_model(text: &str) -> Result<Model, String> {
    text.parse().map_err(|error: UnknownModel| {
        match nearest(
            &text.to_ascii_lowercase(),
            Model::ALL.iter().map(|model| model.flag()),
        ) {
            Some(meant) => format!("{error}; did you mean {meant}?"),
            None => error.to_string(),
        }
    })
}

/// Where to listen.
#[derive(Clone, Debug, clap::Args)]
pub struct Listening {
    /// UDP port to listen on; may be given several times
    #[arg(long = "port", value_name = "PORT", default_values_t = [DATA_PORT, POSITION_PORT])]
    pub ports: Vec<u16>,
    /// Address of this host to listen on; any but 0.0.0.0 misses broadcasts
    #[arg(long, value_name = "IP", default_value_t = Ipv4Addr::UNSPECIFIED)]
    pub bind: Ipv4Addr,
    /// Multicast group that the sensor sends to
    #[arg(long, value_name = "GROUP")]
    pub multicast: Option<Ipv4Addr>,
    /// Network interface to listen on alone, such as eth1
    #[arg(long, value_name = "NAME")]
    pub interface: Option<String>,
}

/// Reads a number within `range`; the error names the range and the unit.
pub fn within(
    range: RangeInclusive<f64>,
    unit: &'static str,
) -> impl Fn(&str) -> Result<f64, String> + Clone + Send + Sync + 'static {
    move |text| match text.parse::<f64>() {
        Ok(number) if range.contains(&number) => Ok(number),
        _ => Err(format!(
            "expected {} to {} {unit}",
            range.start(),
            range.end()
        )),
    }
}

/// The daemon's configuration, and which of its sensors: see [`Sections`](super::sections::Sections).
#[derive(Clone, Debug, clap::Args)]
#[command(next_help_heading = "Sensor")]
pub struct ConfigOptions {
    /// Do as the daemon does with this configuration: its sensors are told by their addresses.
    /// Options beside it override it
    #[arg(long, value_name = "FILE")]
    pub config: Option<PathBuf>,
    /// Only sensors at this address: IP or IP:PORT; of a bag, /TOPIC; with --config, also the name of
    /// a sensor in FILE, whose settings those at a given address get; may be given several times
    #[arg(long = "sensor", value_name = "ADDR|NAME")]
    pub sensors: Vec<SensorChoice>,
}

/// A value of `--sensor`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum SensorChoice {
    /// Who sends.
    Sender(SensorFilter),
    /// A name in the configuration.
    Name(String),
}

impl FromStr for SensorChoice {
    type Err = SensorFilterError;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        match text.parse() {
            Ok(filter) => Ok(Self::Sender(filter)),
            Err(_) if is_sensor_name(text) => Ok(Self::Name(text.to_owned())),
            Err(error) => Err(error),
        }
    }
}

/// What the sensor is and how its packets are read.
#[derive(Clone, Debug, clap::Args)]
#[command(next_help_heading = "Sensor")]
pub struct SensorOptions {
    /// Of which configuration, and which of its sensors.
    #[command(flatten)]
    pub config: ConfigOptions,
    /// Model: vlp16, puck-lite, puck-hires, vlp32c (VLP-32MR too), hdl32e, hdl64e-s2 (S2.1 too),
    /// hdl64e-s3 or vls128 [default: detected from the packets: factory bytes, heads, turn and
    /// period]
    #[arg(long, value_name = "MODEL", value_parser = model(), hide_possible_values = true)]
    pub model: Option<Model>,
    /// Calibration of the unit, db.xml or ROS YAML [default: the model's own table; of an HDL-64E,
    /// the one in its packets]
    #[arg(long, value_name = "FILE")]
    pub calibration: Option<PathBuf>,
    /// Azimuth at which sweeps are cut, degrees clockwise from the sensor's +y [default: 0]
    #[arg(
        long,
        value_name = "DEG",
        value_parser = within(-360.0..=360.0, "degrees"),
        allow_negative_numbers = true
    )]
    pub cut_azimuth: Option<f64>,
    /// Which return is segmented when the sensor sends two [default: nearest]
    #[arg(long = "return", value_name = "WHICH", value_enum)]
    pub which_return: Option<WhichReturn>,
    /// Take UTC from the valid sentence of a GPS receiver though the sensor does not report the
    /// pulse (PPS) as locked: an HDL-32E cannot. Without a pulse wired to it, times may be off by
    /// up to 3 s
    #[arg(long)]
    pub gps_without_pps: bool,
}

/// Values of `--return`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum WhichReturn {
    /// The nearer one: what the beam meets first, be it a drop, a flake or dust
    Nearest,
    /// What the sensor sends as strongest: the second strongest where the last is the strongest
    Strongest,
    /// The last: best in rain, snow and dust
    Last,
}

/// Values of `--method`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum GroundMethod {
    /// Ground by slope, column by column, from the sensor outwards; joins what stands close beside each other
    Slope,
    /// As in the paper: ground by smoothed inclination, from the lowest row; joins by angle alone
    Paper,
}

/// How sweeps are segmented.
#[derive(Clone, Debug, Default, clap::Args)]
#[command(next_help_heading = "Segmentation")]
pub struct SegmentOptions {
    /// How ground is found, and what is joined [default: slope]
    #[arg(long, value_enum)]
    pub method: Option<GroundMethod>,
    #[command(flatten)]
    numbers: Numbers,
    /// The robot's own body: a picture as high as the sensor has rows, azimuth 0 to 360 from left
    /// to right, whose black pixels keep their range and get label 0
    #[arg(long, value_name = "FILE.png")]
    pub mask: Option<PathBuf>,
    /// What has no return at all, in no output: what --mask hides, what --min-range and --max-range
    /// leave out, or both
    #[arg(long, value_name = "WHAT", value_enum, value_delimiter = ',')]
    remove: Vec<Removable>,
    /// A box in which no return is left, such as the robot's own body: x right, y forward and z up of
    /// two opposite corners, metres, in the frame of the robot (where no position of the sensor is
    /// configured, from the sensor, level); may be given several times
    #[arg(
        long = "remove-box",
        value_name = "X,Y,Z,X,Y,Z",
        allow_hyphen_values = true
    )]
    boxes: Vec<BodyBox>,
}

/// Values of `--remove`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Removable {
    /// What the mask hides
    Mask,
    /// What is nearer or further than the range limits
    Range,
}

/// The values of [`SETTINGS`] that were given as options, and what was of [`REMOVED`].
#[derive(Clone, Debug, Default)]
struct Numbers {
    given: Vec<(&'static Setting, f64)>,
    removed: Vec<&'static Removed>,
}

impl clap::Args for Numbers {
    fn augment_args(command: clap::Command) -> clap::Command {
        command
            .args(SETTINGS.iter().map(argument))
            .args(REMOVED.iter().map(removed_argument))
    }

    fn augment_args_for_update(command: clap::Command) -> clap::Command {
        Self::augment_args(command)
    }
}

impl clap::FromArgMatches for Numbers {
    fn from_arg_matches(matches: &clap::ArgMatches) -> Result<Self, clap::Error> {
        let given = given(matches, SETTINGS.iter());
        let is_given = |removed: &&Removed| matches.contains_id(removed.option);
        let removed = REMOVED.iter().filter(is_given).collect();
        Ok(Self { given, removed })
    }

    fn update_from_arg_matches(&mut self, matches: &clap::ArgMatches) -> Result<(), clap::Error> {
        *self = Self::from_arg_matches(matches)?;
        Ok(())
    }
}

/// The values of these settings that were given as options.
fn given(
    matches: &clap::ArgMatches,
    settings: impl Iterator<Item = &'static Setting>,
) -> Vec<(&'static Setting, f64)> {
    let mut given = Vec::new();
    for setting in settings {
        if let Some(&value) = matches.get_one::<f64>(setting.option) {
            given.push((setting, value));
        }
    }
    given
}

/// How a sensor is said to be mounted: the settings of a mount that were given as options.
#[derive(Clone, Debug)]
pub struct MountOptions(Vec<(&'static Setting, f64)>);

impl MountOptions {
    /// Puts what is given over another mount.
    pub fn apply(&self, to: &mut segment::Config) {
        for &(setting, value) in &self.0 {
            setting.set(to, value);
        }
    }

    /// Whether any is given that says which side is up.
    pub fn says_side(&self) -> bool {
        self.0.iter().any(|(setting, _)| setting.option != "height")
    }

    fn settings() -> impl Iterator<Item = &'static Setting> {
        let settings = SETTINGS.iter();
        settings.filter(|setting| setting.is_of_mount())
    }
}

impl clap::Args for MountOptions {
    fn augment_args(command: clap::Command) -> clap::Command {
        command.args(Self::settings().map(argument))
    }

    fn augment_args_for_update(command: clap::Command) -> clap::Command {
        Self::augment_args(command)
    }
}

impl clap::FromArgMatches for MountOptions {
    fn from_arg_matches(matches: &clap::ArgMatches) -> Result<Self, clap::Error> {
        Ok(Self(given(matches, Self::settings())))
    }

    fn update_from_arg_matches(&mut self, matches: &clap::ArgMatches) -> Result<(), clap::Error> {
        *self = Self::from_arg_matches(matches)?;
        Ok(())
    }
}

/// The option of a setting.
fn argument(setting: &'static Setting) -> clap::Arg {
    let value_name = match setting.unit {
        Unit::Count => "N",
        Unit::Degrees => "DEG",
        Unit::Metres => "M",
    };
    let default = match setting.get(&segment::Config::default()) {
        Some(default) => default.to_string(),
        None => setting.absent.to_owned(),
    };
    clap::Arg::new(setting.option)
        .long(setting.option)
        .help(format!("{} [default: {default}]", setting.doc))
        .value_name(value_name)
        .allow_negative_numbers(true)
        .value_parser(move |text: &str| match text.parse::<f64>() {
            Ok(value) if setting.allows(value) => Ok(value),
            _ => Err(format!("expected {}", setting.expected())),
        })
}

/// The option of an earlier version: it takes what it took, and is not shown.
fn removed_argument(removed: &'static Removed) -> clap::Arg {
    clap::Arg::new(removed.option)
        .long(removed.option)
        .hide(true)
        .allow_negative_numbers(true)
}

impl SensorOptions {
    /// Whether any is given.
    pub fn is_given(&self) -> bool {
        self.config.config.is_some()
            || !self.config.sensors.is_empty()
            || self.model.is_some()
            || self.calibration.is_some()
            || self.cut_azimuth.is_some()
            || self.which_return.is_some()
            || self.gps_without_pps
    }

    /// Puts what is given over another configuration.
    ///
    /// # Errors
    /// [`CliError::Calibration`].
    pub fn apply(&self, to: &mut pipeline::Config) -> Result<(), CliError> {
        to.model = self.model.or(to.model);
        if let Some(path) = &self.calibration {
            to.calibration = Some(read_calibration(path)?);
        }
        if let Some(degrees) = self.cut_azimuth {
            to.cut_azimuth_rad = degrees.to_radians();
        }
        if let Some(which) = self.which_return {
            to.return_choice = match which {
                WhichReturn::Nearest => ReturnChoice::Nearest,
                WhichReturn::Strongest => ReturnChoice::Strongest,
                WhichReturn::Last => ReturnChoice::Last,
            };
        }
        to.gps_without_pps |= self.gps_without_pps;
        Ok(())
    }
}

impl SegmentOptions {
    /// Puts what is given over the settings of another segmenter.
    ///
    /// # Errors
    /// [`CliError`]: a mask that cannot be read, an invalid value.
    pub fn apply_to_segmenter(&self, to: &mut segment::Config) -> Result<(), CliError> {
        if let Some(method) = self.method {
            to.method = match method {
                GroundMethod::Slope => segment::Method::Slope,
                GroundMethod::Paper => segment::Method::Paper,
            };
        }
        if let Some(path) = &self.mask {
            to.mask = Some(files::mask(path)?);
        }
        for &(setting, value) in &self.numbers.given {
            setting.set(to, value);
        }
        to.check()
            .map_err(|error| CliError::Usage(error.to_string()))
    }

    /// The same for a whole pipeline, with what is removed. Warns of a mount without ground, and of
    /// theta without the method that it is of.
    ///
    /// # Errors
    /// Those of [`Self::apply_to_segmenter`]; nothing says what is to be removed.
    pub fn apply(&self, to: &mut pipeline::Config) -> Result<(), CliError> {
        self.apply_to_segmenter(&mut to.segment)?;
        // What a configuration has was warned of when it was read.
        let given = &self.numbers.given;
        let is_mounted = given.iter().any(|(one, _)| one.is_of_mount());
        if let Some(warning) = to.segment.mount.warning().filter(|_| is_mounted) {
            complain("warning", warning);
        }
        let is_theta_given = given.iter().any(|(one, _)| one.option == "theta");
        if is_theta_given && to.segment.method != segment::Method::Paper {
            let warning = "`--theta` does nothing: only the method `paper` reads it, and this is `slope`; leave it out, or add --method paper";
            complain("warning", warning);
        }
        self.apply_removal(to)
    }

    fn apply_removal(&self, to: &mut pipeline::Config) -> Result<(), CliError> {
        let pipeline::Config {
            segment, removal, ..
        } = to;
        removal.masked |= self.remove.contains(&Removable::Mask);
        removal.out_of_range |= self.remove.contains(&Removable::Range);
        if !self.boxes.is_empty() {
            removal.boxes.clone_from(&self.boxes);
        }
        let why = if removal.masked && segment.mask.is_none() {
            "--remove mask needs --mask FILE.png"
        } else if removal.out_of_range && !segment.is_range_limited() {
            "--remove range needs --min-range or --max-range"
        } else {
            return Ok(());
        };
        Err(CliError::Usage(why.to_owned()))
    }

    /// Whether returns are to be removed.
    pub fn removes(&self) -> bool {
        !self.remove.is_empty() || !self.boxes.is_empty()
    }

    /// Warns of options that do nothing any more.
    pub fn warn(&self) {
        for removed in &self.numbers.removed {
            complain("warning", removed.warning(&format!("--{}", removed.option)));
        }
    }
}
