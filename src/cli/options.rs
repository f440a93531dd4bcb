//! Options that several subcommands share.

use std::net::Ipv4Addr;
use std::ops::RangeInclusive;
use std::path::PathBuf;

use clap::ValueEnum;

use crate::admission::SensorFilter;
use crate::cli::CliError;
use crate::files;
use crate::suggest::nearest;
use sweepd_core::pipeline;
use sweepd_core::segment::{self, Settings};
use sweepd_core::sensor::model::UnknownModel;
use sweepd_core::sensor::{Calibration, Model};
use sweepd_core::sweep::layout::ReturnChoice;
use sweepd_core::wire::{DATA_PORT, POSITION_PORT};

/// Velodynes whose packets are recognised and refused.
const NOT_YET: [&str; 4] = ["vlp32", "vls128", "ultrapuck", "alphaprime"];

/// A model, by its flag or its name.
pub(super) fn model(text: &str) -> Result<Model, String> {
    text.parse().map_err(|error: UnknownModel| {
        let word: String = text.chars().filter(char::is_ascii_alphanumeric).collect();
        if NOT_YET
            .iter()
            .any(|name| word.to_ascii_lowercase().starts_with(name))
        {
            return format!("sweepd does not read the {text} yet: {error}");
        }
        match nearest(
            &text.to_ascii_lowercase(),
            Model::ALL.iter().map(|model| model.spec().flag),
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
pub(super) fn within(
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
    /// Model: vlp16, puck-lite, puck-hires, hdl32e, hdl64e-s2 (S2.1 too) or hdl64e-s3 [default:
    /// told by the packets: factory bytes, heads and period]
    #[arg(long, value_name = "MODEL", value_parser = model)]
    pub model: Option<Model>,
    /// Calibration of the unit, db.xml or ROS YAML [default: the model's own table; of an HDL-64E,
    /// the one in its packets]
    #[arg(long, value_name = "FILE")]
    pub calibration: Option<PathBuf>,
    /// Only sensors at this address: IP or IP:PORT; may be given several times
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
    /// Ground by slope, column by column, from the sensor's foot up
    Slope,
    /// Ground as in the paper: inclination, smoothed, flooded from the lowest row
    Paper,
}

/// How sweeps are segmented.
#[derive(Clone, Debug, clap::Args)]
#[command(next_help_heading = "Segmentation")]
pub struct SegmentOptions {
    /// How ground is found
    #[arg(long, value_enum, default_value_t = GroundMethod::Slope)]
    pub method: GroundMethod,
    /// Two neighbouring returns belong to one segment when the line through them meets the beam at
    /// more than this angle (beta of the paper), degrees
    #[arg(
        long,
        value_name = "DEG",
        default_value_t = Settings::DEFAULT.theta_deg,
        value_parser = within(Settings::THETA_DEG, "degrees"),
        allow_negative_numbers = true
    )]
    pub theta: f64,
    /// Fewest returns of a segment
    #[arg(
        long,
        value_name = "N",
        default_value_t = Settings::DEFAULT.min_points,
        value_parser = clap::value_parser!(u32).range(1..),
        allow_negative_numbers = true
    )]
    pub min_points: u32,
    /// Two returns of a segment are no further apart than this, metres [default: 0.6 from 48 rows
    /// on, else 0.8]
    #[arg(long, value_name = "M", value_parser = within(Settings::GAP_M, "metres"), allow_negative_numbers = true)]
    pub gap: Option<f64>,
    /// Columns to either side in which a return looks for others of its segment
    #[arg(
        long,
        value_name = "N",
        default_value_t = Settings::DEFAULT.window_columns,
        value_parser = clap::value_parser!(u32).range(Settings::WINDOW_COLUMNS),
        allow_negative_numbers = true
    )]
    pub window_columns: u32,
    /// Rows up and down in which it looks
    #[arg(
        long,
        value_name = "N",
        default_value_t = Settings::DEFAULT.window_rows,
        value_parser = clap::value_parser!(u32).range(Settings::WINDOW_ROWS),
        allow_negative_numbers = true
    )]
    pub window_rows: u32,
    /// What has fewer returns becomes part of a larger segment near by; 0 leaves all alone
    #[arg(
        long,
        value_name = "N",
        default_value_t = Settings::DEFAULT.small_points,
        value_parser = clap::value_parser!(u32),
        allow_negative_numbers = true
    )]
    pub small_points: u32,
    /// How much further than the gap that may be, metres
    #[arg(
        long,
        value_name = "M",
        default_value_t = Settings::DEFAULT.small_reach_m,
        value_parser = within(Settings::SMALL_REACH_M, "metres"),
        allow_negative_numbers = true
    )]
    pub small_reach: f64,
    /// Steepest ground (of --method slope), metres a metre
    #[arg(
        long,
        value_name = "SLOPE",
        default_value_t = Settings::DEFAULT.max_slope,
        value_parser = within(Settings::SLOPE, "metres a metre"),
        allow_negative_numbers = true
    )]
    pub max_slope: f64,
    /// Highest kerb that is ground where the way goes on level behind it (of --method slope),
    /// metres
    #[arg(
        long,
        value_name = "M",
        default_value_t = Settings::DEFAULT.max_kerb_m,
        value_parser = within(Settings::KERB_M, "metres"),
        allow_negative_numbers = true
    )]
    pub max_kerb: f64,
    /// Height of the sensor above the ground, metres [default: estimated from the lowest returns]
    #[arg(long, value_name = "M", value_parser = within(Settings::HEIGHT_M, "metres"), allow_negative_numbers = true)]
    pub height: Option<f64>,
    /// Pitch of the sensor, nose up, degrees
    #[arg(
        long,
        value_name = "DEG",
        default_value_t = Settings::DEFAULT.pitch_deg,
        value_parser = within(Settings::TILT_DEG, "degrees"),
        allow_negative_numbers = true
    )]
    pub pitch: f64,
    /// Roll of the sensor, right side down, degrees
    #[arg(
        long,
        value_name = "DEG",
        default_value_t = Settings::DEFAULT.roll_deg,
        value_parser = within(Settings::TILT_DEG, "degrees"),
        allow_negative_numbers = true
    )]
    pub roll: f64,
    /// Returns nearer than this keep their range and get label 0, metres
    #[arg(
        long,
        value_name = "M",
        default_value_t = Settings::DEFAULT.min_range_m,
        value_parser = within(Settings::RANGE_M, "metres"),
        allow_negative_numbers = true
    )]
    pub min_range: f64,
    /// Returns further than this keep their range and get label 0, metres [default: none are]
    #[arg(
        long,
        value_name = "M",
        value_parser = within(Settings::RANGE_M, "metres"),
        allow_negative_numbers = true
    )]
    pub max_range: Option<f64>,
    /// The robot's own body: a picture as high as the sensor has rows, azimuth 0 to 360 from left
    /// to right, whose black pixels keep their range and get label 0
    #[arg(long, value_name = "FILE.png")]
    pub mask: Option<PathBuf>,
}

impl SensorOptions {
    /// The calibration file, read.
    ///
    /// # Errors
    /// [`CliError::Calibration`].
    pub fn read_calibration(&self) -> Result<Option<Calibration>, CliError> {
        Ok(self
            .calibration
            .as_deref()
            .map(files::calibration)
            .transpose()?)
    }

    fn return_choice(&self) -> ReturnChoice {
        match self.which_return {
            WhichReturn::Nearest => ReturnChoice::Nearest,
            WhichReturn::Strongest => ReturnChoice::Strongest,
            WhichReturn::Last => ReturnChoice::Last,
        }
    }
}

/// The pipeline that these options ask for.
///
/// # Errors
/// [`CliError`]: a file that cannot be read, a value that cannot be meant.
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
        gps_without_pps: sensor.gps_without_pps,
        ..pipeline::Config::default()
    })
}

impl SegmentOptions {
    /// What the segmenter is told.
    ///
    /// # Errors
    /// [`CliError`]: a mask that cannot be read, a value that cannot be meant.
    pub fn config(&self) -> Result<segment::Config, CliError> {
        let usage = |error: &dyn std::error::Error| CliError::Usage(error.to_string());
        let mask = self
            .mask
            .as_deref()
            .map(files::mask)
            .transpose()
            .map_err(|error| usage(&error))?;
        let settings = Settings {
            method: match self.method {
                GroundMethod::Slope => segment::Method::Slope,
                GroundMethod::Paper => segment::Method::Paper,
            },
            theta_deg: self.theta,
            min_points: self.min_points,
            gap_m: self.gap,
            window_columns: self.window_columns,
            window_rows: self.window_rows,
            small_points: self.small_points,
            small_reach_m: self.small_reach,
            max_slope: self.max_slope,
            max_kerb_m: self.max_kerb,
            height_m: self.height,
            pitch_deg: self.pitch,
            roll_deg: self.roll,
            min_range_m: self.min_range,
            max_range_m: self.max_range,
        };
        settings.config(mask).map_err(|error| usage(&error))
    }
}
