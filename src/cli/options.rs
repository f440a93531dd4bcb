//! Options that several subcommands share.

use std::net::Ipv4Addr;
use std::ops::RangeInclusive;
use std::path::PathBuf;

use clap::ValueEnum;

use crate::admission::SensorFilter;
use crate::cli::{CliError, complain};
use crate::files;
use crate::suggest::nearest;
use sweepd_core::assemble::{BodyBox, Removal};
use sweepd_core::pipeline;
use sweepd_core::segment::settings::{REMOVED, Removed, Table, Unit};
use sweepd_core::segment::{self, SETTINGS, Setting};
use sweepd_core::sensor::model::UnknownModel;
use sweepd_core::sensor::{Calibration, Model};
use sweepd_core::sweep::layout::ReturnChoice;
use sweepd_core::wire::{DATA_PORT, POSITION_PORT};

/// A model, by its flag or its name.
pub fn model(text: &str) -> Result<Model, String> {
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

/// What the sensor is and how its packets are read.
#[derive(Clone, Debug, clap::Args)]
#[command(next_help_heading = "Sensor")]
pub struct SensorOptions {
    /// Model: vlp16, puck-lite, puck-hires, vlp32c (VLP-32MR too), hdl32e, hdl64e-s2 (S2.1 too),
    /// hdl64e-s3 or vls128 [default: detected from the packets: factory bytes, heads, turn and
    /// period]
    #[arg(long, value_name = "MODEL", value_parser = model)]
    pub model: Option<Model>,
    /// Calibration of the unit, db.xml or ROS YAML [default: the model's own table; of an HDL-64E,
    /// the one in its packets]
    #[arg(long, value_name = "FILE")]
    pub calibration: Option<PathBuf>,
    /// Only sensors at this address: IP or IP:PORT; of a bag, /TOPIC; may be given several times
    #[arg(long, value_name = "ADDR")]
    pub sensor: Vec<SensorFilter>,
    /// Azimuth at which sweeps are cut, degrees clockwise from the sensor's +y
    #[arg(
        long,
        value_name = "DEG",
        default_value = "0",
        value_parser = within(-360.0..=360.0, "degrees"),
        allow_negative_numbers = true
    )]
    pub cut_azimuth: f64,
    /// Which return is segmented when the sensor sends two
    #[arg(long = "return", value_name = "WHICH", value_enum, default_value_t = WhichReturn::Nearest)]
    pub which_return: WhichReturn,
    /// Take UTC from the valid sentence of a GPS receiver though the sensor does not report the
    /// pulse (PPS) as locked: an HDL-32E cannot. Without a pulse wired to it, times may be off by
    /// up to 3 s
    #[arg(long)]
    pub gps_without_pps: bool,
}

/// Values of `--return`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum WhichReturn {
    /// The nearer one: safe for obstacles
    Nearest,
    /// What the sensor sends as strongest: the second strongest where the last is the strongest
    Strongest,
    /// The last
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
#[derive(Clone, Debug, clap::Args)]
#[command(next_help_heading = "Segmentation")]
pub struct SegmentOptions {
    /// How ground is found, and what is joined
    #[arg(long, value_enum, default_value_t = GroundMethod::Slope)]
    pub method: GroundMethod,
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
#[derive(Clone, Debug)]
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
        let mut given = Vec::new();
        for setting in SETTINGS {
            if let Some(&value) = matches.get_one::<f64>(setting.option) {
                given.push((setting, value));
            }
        }
        let is_given = |removed: &&Removed| matches.contains_id(removed.option);
        let removed = REMOVED.iter().filter(is_given).collect();
        Ok(Self { given, removed })
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
    /// The calibration file, read.
    ///
    /// # Errors
    /// [`CliError::Calibration`].
    pub fn read_calibration(&self) -> Result<Option<Calibration>, CliError> {
        match &self.calibration {
            Some(path) => Ok(Some(files::calibration(path)?)),
            None => Ok(None),
        }
    }

    fn return_choice(&self) -> ReturnChoice {
        match self.which_return {
            WhichReturn::Nearest => ReturnChoice::Nearest,
            WhichReturn::Strongest => ReturnChoice::Strongest,
            WhichReturn::Last => ReturnChoice::Last,
        }
    }
}

/// The pipeline of these options.
///
/// # Errors
/// [`CliError`]: a file that cannot be read, an invalid value.
pub fn pipeline_config(
    sensor: &SensorOptions,
    segment: &SegmentOptions,
) -> Result<pipeline::Config, CliError> {
    Ok(pipeline::Config {
        model: sensor.model,
        calibration: sensor.read_calibration()?,
        cut_azimuth_rad: sensor.cut_azimuth.to_radians(),
        return_choice: sensor.return_choice(),
        segment: segment.config()?,
        removal: segment.removal()?,
        gps_without_pps: sensor.gps_without_pps,
        ..pipeline::Config::default()
    })
}

impl SegmentOptions {
    /// Which returns are removed.
    ///
    /// # Errors
    /// [`CliError::Usage`]: nothing says what is to be removed.
    pub fn removal(&self) -> Result<Removal, CliError> {
        let removal = Removal {
            masked: self.remove.contains(&Removable::Mask),
            out_of_range: self.remove.contains(&Removable::Range),
            boxes: self.boxes.clone(),
        };
        let has_limit = (self.numbers.given.iter())
            .any(|(setting, _)| setting.table == Table::Segment && setting.unit == Unit::Metres);
        if removal.masked && self.mask.is_none() {
            return Err(CliError::Usage(
                "--remove mask needs --mask FILE.png".to_owned(),
            ));
        }
        if removal.out_of_range && !has_limit {
            return Err(CliError::Usage(
                "--remove range needs --min-range or --max-range".to_owned(),
            ));
        }
        Ok(removal)
    }

    /// The segmenter's configuration.
    ///
    /// # Errors
    /// [`CliError`]: a mask that cannot be read, an invalid value.
    pub fn config(&self) -> Result<segment::Config, CliError> {
        let mask = self.mask.as_deref().map(files::mask).transpose();
        let mask = mask.map_err(|error| CliError::Usage(error.to_string()))?;
        let mut config = segment::Config {
            method: match self.method {
                GroundMethod::Slope => segment::Method::Slope,
                GroundMethod::Paper => segment::Method::Paper,
            },
            mask,
            ..segment::Config::default()
        };
        for &(setting, value) in &self.numbers.given {
            setting.set(&mut config, value);
        }
        for removed in &self.numbers.removed {
            complain("warning", removed.warning(&format!("--{}", removed.option)));
        }
        if let Err(error) = config.check() {
            return Err(CliError::Usage(error.to_string()));
        }
        if let Some(warning) = config.mount.warning() {
            complain("warning", warning);
        }
        Ok(config)
    }
}
