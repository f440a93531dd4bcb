//! `sweepd config`: checks a configuration, or prints an example.

mod json;

use std::fmt::{Display, Write as _};
use std::io;
use std::path::{Path, PathBuf};
use sweepd_core::sensor::ModelExt;

use self::json::{Checked, Refused};
use super::stream::{print, print_json};
use super::{CliError, complain};
use crate::daemon::config::{
    Config, ConfigError, RecordConfig, SensorConfig, differing, example, memory, read_text,
};
use crate::publish::{SHARED_MEMORY, free_bytes, pool_sweeps};
use crate::text::{count_of, visible};
use sweepd_core::segment::Method;

/// Options of `sweepd config`.
#[derive(Debug, clap::Args)]
pub struct Args {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, clap::Subcommand)]
enum Command {
    /// Print what a configuration means, and every line that is wrong
    #[command(after_help = "\
Example:
  sweepd config check /etc/sweepd/sweepd.toml")]
    Check {
        /// The configuration, TOML
        #[arg(value_name = "FILE")]
        file: PathBuf,
        /// One JSON object on standard output
        #[arg(long)]
        json: bool,
    },
    /// Print an example configuration with every key explained
    #[command(after_help = "\
Example:
  sweepd config example > sweepd.toml")]
    Example,
}

/// Runs the command.
///
/// # Errors
/// [`CliError::Config`]: a file that cannot be read, or an invalid value.
pub fn run(args: &Args) -> Result<(), CliError> {
    match &args.command {
        Command::Example => print(example()),
        Command::Check { file, json } => check(file, *json),
    }
}

fn check(file: &Path, is_json: bool) -> Result<(), CliError> {
    let written = read_text(file)?;
    let config = Config::parse(file, &written);
    if let (Err(ConfigError::Invalid(problems)), true) = (&config, is_json) {
        print_json(&Refused::new(file, problems))?;
    }
    let config = config?;
    let (mut least, mut most) = (0, 0);
    for sensor in &config.sensors {
        let pool = memory::pool_bytes(sensor);
        least += pool.start();
        most += pool.end() + memory::objects_bytes(sensor);
    }
    let free = free_bytes();
    let warnings = warnings(&config, free.as_ref().ok().copied(), most);
    let settings = differing(&written);
    if is_json {
        let free = free.ok();
        let all = [least, most];
        print_json(&Checked::new(
            file, &config, &settings, all, free, &warnings,
        ))?;
    } else {
        let sensors = count_of(config.sensors.len() as u64, "sensor");
        let mut text = format!("{}: {sensors}\n", visible(file.display()));
        for (sensor, settings) in config.sensors.iter().zip(&settings) {
            describe_sensor(&mut text, sensor, settings);
        }
        describe_daemon(&mut text, &config, &mib(least, most), &free);
        print(&text)?;
    }
    for warning in warnings {
        complain("warning", warning);
    }
    Ok(())
}

/// What may be meant, and will hardly do. `most` bytes of shared memory may be needed.
fn warnings(config: &Config, free: Option<u64>, most: u64) -> Vec<String> {
    let mut warnings = config.warnings.clone();
    for sensor in &config.sensors {
        if sensor.pipeline.segment.mount.height_m.is_some() && sensor.pipeline.position_m[2] == 0.0
        {
            warnings.push(format!(
                "{}: `height_m` is set and `z_m` is not: the robot's origin is as high as the sensor; if it is on the floor, set \
                 `z_m` to the same height",
                sensor.name
            ));
        }
    }
    warnings.extend(config.missing_on_this_host());
    if let Some(free) = free.filter(|&free| free < most) {
        let free = mib(free, free);
        let most = mib(most, most);
        warnings.push(format!(
            "{SHARED_MEMORY} has {free} free and {most} may be needed, if no daemon holds that now; enlarge it with \
             `mount -o remount,size=...` (of a container: --shm-size), lower max_consumers, or tell model and returns"
        ));
    }
    warnings
}

/// Adds a row: a name, and the value beside it.
fn row(text: &mut String, name: &str, value: impl Display) {
    let _ = writeln!(text, "  {name:<13}  {value}");
}

fn describe_sensor(text: &mut String, sensor: &SensorConfig, settings: &[(String, &str)]) {
    let SensorConfig { name, address, .. } = sensor;
    let _ = writeln!(text, "\n{name}");
    let source = source(sensor);
    let packets = format_args!("from {source} to port {}", sensor.port.port);
    row(text, "packets", packets);
    let positions = format_args!("from {address} to port {}", sensor.position_port);
    row(text, "positions", positions);
    row(text, "listens", listening(sensor));
    row(text, "thread", thread(sensor));
    row(text, "model", model(sensor));
    row(text, "wanted", &sensor.want);
    let cut = rounded(sensor.pipeline.cut_azimuth_rad.to_degrees());
    row(text, "cut", format_args!("at {cut} degrees"));
    row(text, "mount", mount(sensor));
    row(text, "segments", segments(sensor));
    let consumers = count_of(sensor.max_consumers as u64, "consumer");
    let service = format_args!("sweepd/{name}/sweep, {consumers} at most");
    row(text, "service", service);
    let pool = memory::pool_bytes(sensor);
    let pool = mib(*pool.start(), *pool.end());
    let sweep = memory::sweep_bytes(sensor);
    let sweep = mib(*sweep.start() as u64, *sweep.end() as u64);
    let sweeps = pool_sweeps(sensor.max_consumers);
    let memory = format_args!("{pool}: {sweeps} sweeps of {sweep}");
    row(text, "shared memory", memory);
    let objects = memory::objects_bytes(sensor);
    let objects = format_args!(
        "sweepd/{name}/objects, {} more with the first consumer",
        mib(objects, objects)
    );
    row(text, "objects", objects);
    // All that is not the default, by the names of its keys: what is described above and what is not.
    for (number, (key, value)) in settings.iter().enumerate() {
        let name = if number == 0 { "settings" } else { "" };
        row(text, name, format_args!("{key} = {value}"));
    }
}

/// Where its packets come from.
fn source(sensor: &SensorConfig) -> String {
    let address = sensor.address;
    match sensor.source_port {
        Some(port) => format!("{address}:{port}"),
        None => address.to_string(),
    }
}

fn listening(sensor: &SensorConfig) -> String {
    let port = &sensor.port;
    let mut text = if port.bind.is_unspecified() {
        "on all addresses".to_owned()
    } else {
        format!("on {}", port.bind)
    };
    if let Some(interface) = &port.interface {
        let _ = write!(text, " of {interface}");
    }
    if let Some(group) = port.multicast {
        let _ = write!(text, ", group {group}");
    }
    text
}

fn thread(sensor: &SensorConfig) -> String {
    let core = match sensor.port.cpu {
        Some(cpu) => format!("core {cpu}"),
        None => "any core".to_owned(),
    };
    match sensor.port.realtime_priority {
        Some(priority) => format!("{core}, SCHED_FIFO priority {priority}"),
        None => format!("{core}, the usual scheduler"),
    }
}

fn model(sensor: &SensorConfig) -> String {
    let config = &sensor.pipeline;
    let model = match config.model {
        Some(model) => model.to_string(),
        None => "told by the packets".to_owned(),
    };
    let calibration = match (&config.calibration, config.model) {
        (Some(_), _) => "calibration from its file",
        (None, Some(model)) if model.calibration().is_none() => "calibration told by its packets",
        (None, Some(_)) => "calibration of the model",
        (None, None) => "calibration of the model or told by its packets",
    };
    let returns = match sensor.dual {
        Some(true) => "two returns",
        Some(false) => "one return",
        None => "one return or two",
    };
    let segmented = format!("{:?}", config.return_choice).to_lowercase();
    format!("{model}; {calibration}; {returns}, {segmented} segmented")
}

fn mount(sensor: &SensorConfig) -> String {
    let config = &sensor.pipeline;
    let mount = &config.segment.mount;
    let [x, y, z] = config.position_m;
    let roll = degrees(mount.roll_rad);
    let pitch = degrees(mount.pitch_rad);
    let yaw = degrees(config.yaw_rad);
    let height = match mount.height_m {
        Some(height) => format!("{height} m above ground"),
        None => "height estimated".to_owned(),
    };
    let climb_m = config.segment.climb_m;
    format!(
        "x {x}, y {y}, z {z} m; roll {roll}, pitch {pitch}, yaw {yaw} degrees; {height}; climbs {climb_m} m"
    )
}

fn segments(sensor: &SensorConfig) -> String {
    let config = &sensor.pipeline.segment;
    let mut text = match config.method {
        Method::Slope => "method slope".to_owned(),
        Method::Paper => format!("method paper, theta {} degrees", degrees(config.theta_rad)),
    };
    let points = config.min_points;
    text += &format!(", {points} points at least");
    let min_m = config.min_range_m;
    let max_m = config.max_range_m;
    if max_m.is_finite() {
        text += &format!(", {min_m} to {max_m} m");
    } else if min_m > 0.0 {
        text += &format!(", from {min_m} m on");
    }
    let removal = &sensor.pipeline.removal;
    if removal.out_of_range {
        text += ", the others removed";
    }
    if config.mask.is_some() {
        text += if removal.masked {
            ", removed by a mask"
        } else {
            ", masked"
        };
    }
    for one in &removal.boxes {
        text += &format!(", removed in the box {one}");
    }
    text
}

fn describe_daemon(text: &mut String, config: &Config, pools: &str, free: &io::Result<u64>) {
    *text += "\ndaemon\n";
    match config.daemon.http {
        Some(at) => row(
            text,
            "health",
            format_args!("http://{at}/health and /metrics"),
        ),
        None => row(text, "health", "off"),
    }
    match &config.daemon.root {
        Some(root) => row(text, "root", root.display()),
        None => row(
            text,
            "root",
            "the default: $SWEEPD_ROOT, /run/sweepd/iox2 or /tmp/sweepd/iox2",
        ),
    }
    match &config.record {
        Some(record) => row(text, "recording", recording(record)),
        None => row(text, "recording", "off"),
    }
    let free = match free {
        Ok(free) => format!("{} free in {SHARED_MEMORY}", mib(*free, *free)),
        Err(error) => format!("{SHARED_MEMORY}: {error}"),
    };
    row(text, "shared memory", format_args!("{pools}; {free}"));
}

fn recording(record: &RecordConfig) -> String {
    let path = record.path.display();
    let mut text = format!("{path}, numbered, another file each start");
    if let Some(bytes) = record.rotate_bytes {
        text += &format!(", each {} MB", bytes as f64 / 1e6);
    }
    if let Some(seconds) = record.rotate_seconds {
        text += &format!(", each {} minutes", rounded(seconds as f64 / 60.0));
    }
    text
}

/// A range of bytes, or one number if both ends print the same.
fn mib(least: u64, most: u64) -> String {
    let mib = f64::from(1 << 20);
    let least = format!("{:.1} MiB", least as f64 / mib);
    let most = format!("{:.1} MiB", most as f64 / mib);
    if least == most {
        return least;
    }
    format!("{least} to {most}")
}

fn degrees(rad: f32) -> f64 {
    rounded(f64::from(rad).to_degrees())
}

/// Without the noise of a conversion.
fn rounded(value: f64) -> f64 {
    super::output::rounded(value, 1e4)
}
