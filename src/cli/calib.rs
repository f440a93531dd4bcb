//! `sweepd calib`: shows and compares calibrations, and extracts that of an HDL-64E from its
//! packets.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use serde::Serialize;

use super::error::read_calibration;
use super::output::{ForceOptions, rounded};
use super::stream::{print, print_json};
use super::{CliError, complain, warn_of};
use crate::admission::{Sender, SensorFilter};
use crate::files::output;
use crate::input::{Capture, Placed};
use crate::streams::{Stream, Streams};
use crate::text::{count_of, grouped};
use sweepd_core::sensor::compare::{ANGLE_TOLERANCE_DEG, LENGTH_TOLERANCE_M, differences};
use sweepd_core::sensor::{Beam, Calibration, Model, ros_yaml, stream};
use sweepd_core::wire::data::Banks;
use sweepd_core::wire::hdl64::{DUMP_LEN, DUMP_PACKETS, DumpState, Series, Status};
use sweepd_core::wire::{Content, Packet};

/// Options of `sweepd calib`.
#[derive(Debug, clap::Args)]
pub struct Args {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, clap::Subcommand)]
enum Command {
    /// Print a calibration as a table, a beam a line from the highest down
    #[command(after_help = "\
Example:
  sweepd calib show calib/hdl32e.yaml")]
    Show {
        /// A db.xml or ROS YAML
        #[arg(value_name = "FILE")]
        file: PathBuf,
        /// One JSON object on standard output
        #[arg(long)]
        json: bool,
    },
    /// Name the beams that differ by more than 0.02 degrees or 2 mm; exit code 1 if there are any
    #[command(after_help = "\
Example:
  sweepd calib diff db.xml unit.yaml")]
    Diff {
        /// A db.xml or ROS YAML
        #[arg(value_name = "A")]
        a: PathBuf,
        /// Another
        #[arg(value_name = "B")]
        b: PathBuf,
        /// One JSON object on standard output
        #[arg(long)]
        json: bool,
    },
    /// Write the calibration that an HDL-64E S2.1 or S3 sends with its packets as a ROS YAML
    #[command(after_help = "\
The factory's db.xml has more digits (the sensor sends hundredths of a degree and millimetres): use it if there is one.

Example:
  sweepd calib from-capture hdl64e.pcap -o unit.yaml")]
    FromCapture(FromCapture),
}

#[derive(Debug, clap::Args)]
struct FromCapture {
    /// pcap or pcapng, plain or compressed with gzip, zstd, bzip2 or lz4; a ROS bag with VelodyneScan
    /// messages (.mcap, .db3, .bag, or the folder of a ROS 2 bag); or bare packets; - is standard input
    #[arg(value_name = "CAPTURE")]
    capture: PathBuf,
    /// The file to write
    #[arg(short, long, value_name = "FILE.yaml")]
    out: PathBuf,
    #[command(flatten)]
    force: ForceOptions,
    /// Only the sensor at this address: IP or IP:PORT; of a bag, /TOPIC
    #[arg(long, value_name = "ADDR")]
    sensor: Option<SensorFilter>,
    /// One JSON object on standard output
    #[arg(long)]
    json: bool,
}

/// What `from-capture --json` prints.
#[derive(Serialize)]
struct Extracted<'a> {
    file: &'a Path,
    sensor: &'a str,
    series: String,
    /// When, by the factory's clock.
    calibrated: Option<String>,
    /// Whether a checksum said that it came whole: an S2.1 sends none.
    checked: bool,
}

/// Runs the command.
///
/// # Errors
/// [`CliError`]: a file that cannot be read or written, a capture without a whole calibration; and
/// [`CliError::Reported`] for calibrations that differ.
pub fn run(args: &Args) -> Result<(), CliError> {
    match &args.command {
        Command::Show { file, json: false } => print(show(file, &read_calibration(file)?)),
        Command::Show { file, json: true } => {
            print_json(&Shown::new(file, &read_calibration(file)?))
        }
        Command::Diff { a, b, json } => diff(a, b, *json),
        Command::FromCapture(args) => from_capture(args),
    }
}

/// What `show --json` prints. Lengths are in metres, angles in degrees.
#[derive(Serialize)]
struct Shown {
    file: PathBuf,
    distance_unit_m: f64,
    models: Vec<&'static str>,
    beams: Vec<ShownBeam>,
}

/// A beam, the highest first.
#[derive(Serialize)]
struct ShownBeam {
    row: usize,
    channel: usize,
    elevation_deg: f64,
    rotation_deg: f64,
    distance_offset_m: f64,
    near_distance_offsets_m: Option<[f64; 2]>,
    vertical_offset_m: f64,
    horizontal_offset_m: f64,
    focal_distance_m: Option<f64>,
    focal_slope: Option<f64>,
    intensity: Option<[f64; 2]>,
}

impl Shown {
    fn new(file: &Path, calibration: &Calibration) -> Self {
        let mut beams = Vec::new();
        for (row, &channel) in calibration.rows().iter().enumerate() {
            let beam = &calibration.beams()[channel];
            let intensity = beam.intensity.as_ref();
            beams.push(ShownBeam {
                row,
                channel,
                elevation_deg: readable(beam.elevation_rad.to_degrees()),
                rotation_deg: readable(beam.rotation_rad.to_degrees()),
                distance_offset_m: beam.distance_offset_m,
                near_distance_offsets_m: beam.two_point.map(|_| beam.near_distance_offsets_m()),
                vertical_offset_m: beam.vertical_offset_m,
                horizontal_offset_m: beam.horizontal_offset_m,
                focal_distance_m: intensity.map(|one| one.focal_distance_m),
                focal_slope: intensity.map(|one| one.focal_slope),
                intensity: intensity.map(|one| [one.min, one.max]),
            });
        }
        Self {
            file: file.to_owned(),
            distance_unit_m: calibration.distance_unit_m(),
            models: fitting_models(calibration),
            beams,
        }
    }
}

/// Without the noise of a conversion.
fn readable(value: f64) -> f64 {
    rounded(value, 1e9)
}

/// What `diff` prints.
#[derive(Serialize)]
struct Compared {
    files: [PathBuf; 2],
    distance_unit_m: [f64; 2],
    beams: [usize; 2],
    differences: Vec<ComparedBeam>,
}

/// A value of a beam that differs.
#[derive(Serialize)]
struct ComparedBeam {
    channel: usize,
    quantity: &'static str,
    unit: &'static str,
    values: [f64; 2],
}

impl Compared {
    /// # Errors
    /// [`CliError`]: a file that cannot be read.
    fn read(files: [&Path; 2]) -> Result<Self, CliError> {
        let [a, b] = files;
        let calibrations = [read_calibration(a)?, read_calibration(b)?];
        let [a, b] = &calibrations;
        let mut found = Vec::new();
        for difference in differences(a, b) {
            found.push(ComparedBeam {
                channel: difference.channel,
                quantity: difference.quantity.name(),
                unit: difference.quantity.unit(),
                values: difference.values.map(readable),
            });
        }
        Ok(Self {
            files: files.map(Path::to_owned),
            distance_unit_m: calibrations.each_ref().map(Calibration::distance_unit_m),
            beams: calibrations.each_ref().map(|one| one.beams().len()),
            differences: found,
        })
    }

    /// Whether they are the same, within what [`differences`] bears.
    fn is_same(&self) -> bool {
        self.differences.is_empty()
            && self.distance_unit_m[0] == self.distance_unit_m[1]
            && self.beams[0] == self.beams[1]
    }

    fn text(&self) -> String {
        let [name_a, name_b] = self.files.each_ref().map(|file| file.display());
        if self.is_same() {
            let length_mm = LENGTH_TOLERANCE_M * 1e3;
            return format!(
                "no beam differs by more than {ANGLE_TOLERANCE_DEG} degrees or {length_mm:.0} mm\n"
            );
        }
        let mut text = String::new();
        let [beams_a, beams_b] = self.beams;
        if beams_a != beams_b {
            let _ = writeln!(text, "{name_a} has {beams_a} beams, {name_b} {beams_b}");
        }
        let [unit_a, unit_b] = self.distance_unit_m;
        if unit_a != unit_b {
            let _ = writeln!(
                text,
                "{name_a} has distances in units of {unit_a} m, {name_b} of {unit_b} m"
            );
        }
        if !self.differences.is_empty() {
            text += "channel                              A          B      B - A\n";
        }
        for one in &self.differences {
            let [a, b] = one.values;
            let more = b - a;
            let _ = writeln!(
                text,
                "{:7}  {:<18}  {a:9.4}  {b:9.4}  {more:9.4} {}",
                one.channel, one.quantity, one.unit
            );
        }
        text
    }
}

fn show(file: &Path, calibration: &Calibration) -> String {
    let beams = calibration.beams();
    let count = count_of(beams.len() as u64, "beam");
    let unit_mm = calibration.distance_unit_m() * 1e3;
    let models = match &fitting_models(calibration)[..] {
        [] => "no supported model".to_owned(),
        models => models.join(", "),
    };
    let mut text = format!(
        "{}: {count}, distances in units of {unit_mm:.0} mm; fits {models}\n\n",
        file.display(),
    );
    text += "row  channel  elevation  rotation  distance    near x    near y  vertical  horizontal  focal  slope  \
             intensity\n";
    text += "                degrees   degrees         m         m         m         m           m      m\n";
    for (row, &channel) in calibration.rows().iter().enumerate() {
        let _ = writeln!(text, "{row:3}  {}", line(&beams[channel]));
    }
    text
}

/// A line of the table; a dash for a missing correction.
fn line(beam: &Beam) -> String {
    let elevation = beam.elevation_rad.to_degrees();
    let rotation = beam.rotation_rad.to_degrees();
    let mut near_x = "-".to_owned();
    let mut near_y = "-".to_owned();
    if let Some(near) = beam.two_point {
        near_x = format!("{:.4}", near.distance_offset_x_m);
        near_y = format!("{:.4}", near.distance_offset_y_m);
    }
    let mut focal = "-".to_owned();
    let mut slope = "-".to_owned();
    let mut intensity = "-".to_owned();
    if let Some(correction) = beam.intensity {
        focal = format!("{:.2}", correction.focal_distance_m);
        slope = format!("{:.2}", correction.focal_slope);
        intensity = format!("{}-{}", correction.min, correction.max);
    }
    format!(
        "{:7}  {elevation:9.4}  {rotation:8.4}  {:8.4}  {near_x:>8}  {near_y:>8}  {:8.4}  {:10.4}  \
         {focal:>5}  {slope:>5}  {intensity:>9}",
        beam.channel, beam.distance_offset_m, beam.vertical_offset_m, beam.horizontal_offset_m
    )
}

/// The models that a calibration may belong to.
fn fitting_models(calibration: &Calibration) -> Vec<&'static str> {
    let mut models = Vec::new();
    for model in Model::ALL {
        if calibration.clone().for_model(model).is_ok() {
            models.push(model.name());
        }
    }
    models
}

fn diff(a: &Path, b: &Path, json: bool) -> Result<(), CliError> {
    let compared = Compared::read([a, b])?;
    match json {
        true => print_json(&compared)?,
        false => print(compared.text())?,
    }
    match compared.is_same() {
        true => Ok(()),
        false => Err(CliError::Reported),
    }
}

/// The status that one HDL-64E of a capture sent.
struct Unit {
    name: String,
    /// Those that have the blocks of an HDL-64E.
    packets: u64,
    status: Status,
}

fn from_capture(args: &FromCapture) -> Result<(), CliError> {
    let existing = args.force.existing();
    output::check(&args.out, existing)?;
    let mut capture = Capture::open(&args.capture)?;
    let units = read_units(&mut capture, args.sensor.clone())?;
    warn_of(&capture, "");
    let unit = only_unit(&units).map_err(|message| args.refused(&message))?;
    let name = &unit.name;
    let (Some(dump), Some(series)) = (unit.status.dump(), unit.status.series()) else {
        return Err(args.refused(&incomplete(unit)));
    };
    let calibration =
        stream::calibration(dump).map_err(|message| args.refused(&format!("{name}: {message}")))?;
    let calibrated = dump.calibrated().map(|time| time.to_string());
    let said = match &calibrated {
        Some(time) => format!("calibrated {time}"),
        None => {
            let message = format_args!("{name} says that it was never calibrated");
            complain("warning", message);
            "never calibrated".to_owned()
        }
    };
    let source = format!("HDL-64E {series} at {name}, {said}, from its own packets");
    let text = format!("# {source}\n{}", ros_yaml::emit(&calibration));
    output::write(&args.out, text.as_bytes(), existing)?;
    if args.json {
        return print_json(&Extracted {
            file: &args.out,
            sensor: name,
            series: series.to_string(),
            calibrated,
            checked: series == Series::S3,
        });
    }
    print(describe(&args.out, &source, series))
}

impl FromCapture {
    fn refused(&self, message: &str) -> CliError {
        CliError::Failed(format!("{}: {message}", self.capture.display()))
    }
}

fn only_unit(units: &[Unit]) -> Result<&Unit, String> {
    match units {
        [unit] => Ok(unit),
        [] => Err(
            "no packets of an HDL-64E, the only model that sends its calibration with them"
                .to_owned(),
        ),
        several => {
            let names: Vec<&str> = several.iter().map(|unit| &unit.name[..]).collect();
            let names = names.join(", ");
            Err(format!(
                "several HDL-64E: choose one with --sensor: {names}"
            ))
        }
    }
}

/// All HDL-64E of a capture, with their status.
fn read_units(capture: &mut Capture, filter: Option<SensorFilter>) -> Result<Vec<Unit>, CliError> {
    let mut streams = Streams::new(filter.into_iter().collect());
    while let Some(placed) = capture.next_placed()? {
        let _ = streams.take(&placed, Unit::new)?;
    }
    streams.all.retain(|unit: &Unit| unit.packets > 0);
    Ok(streams.all)
}

impl Unit {
    fn new(_: usize, sender: &Sender) -> Result<Self, CliError> {
        Ok(Self {
            name: sender.name.clone(),
            packets: 0,
            status: Status::new(),
        })
    }
}

impl Stream for Unit {
    type Sweep = ();

    fn take(&mut self, packet: Option<&Packet<'_>>, _: &Placed<'_>) {
        // Decided by the blocks, since the last two bytes may look like those of any model.
        if let Some(Content::Data(packet)) = packet.map(|packet| packet.content)
            && packet.banks() == Banks::Alternating
        {
            self.packets += 1;
            self.status
                .push(packet.return_mode, packet.product, packet.stamp_us());
        }
    }
}

/// How much of the calibration was received, and what to do.
fn incomplete(unit: &Unit) -> String {
    let name = &unit.name;
    let known = unit.status.known();
    let packets = count_of(unit.packets, "packet");
    let period = grouped(DUMP_PACKETS as u64);
    let longer = format!("the sensor sends it every {period} packets, about once a second");
    match unit.status.dump_state() {
        DumpState::Contradictory(error) => {
            format!(
                "the calibration of {name} is damaged: {error}; {longer}: give a longer capture"
            )
        }
        _ if known == 0 && unit.packets >= DUMP_PACKETS as u64 => format!(
            "no calibration in {packets} of {name}: units before the S2.1 send none; use the db.xml that came with it"
        ),
        _ => format!(
            "the calibration of {name} is incomplete: {} of {} bytes in {packets}; {longer}: give a longer capture, \
             two seconds or more",
            grouped(known as u64),
            grouped(DUMP_LEN as u64)
        ),
    }
}

fn describe(out: &Path, source: &str, series: Series) -> String {
    let checked = match series {
        Series::S3 => "its checksum is right",
        Series::S21 => "complete; this series sends no checksum",
    };
    format!("{}: {source}; {checked}\n", out.display())
}
