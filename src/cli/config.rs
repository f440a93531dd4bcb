//! `sweepd config`: a configuration checked, and one to begin with.

use std::fmt::Write as _;
use std::io::{self, Write as _};
use std::ops::RangeInclusive;
use std::path::{Path, PathBuf};

use super::{CliError, complain};
use crate::daemon::config::{Config, RecordConfig, SensorConfig, memory};
use crate::text::count_of;
use sweepd_client::publish::{SHARED_MEMORY, free_bytes, pool_sweeps};
use sweepd_core::segment::Method;

/// The configuration that systemd/ ships.
const EXAMPLE: &str = include_str!("../../systemd/sweepd.toml");

/// Options of `sweepd config`.
#[derive(Debug, clap::Args)]
pub struct Args {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, clap::Subcommand)]
enum Command {
    /// Say what a configuration comes to, and every line that is wrong
    #[command(after_help = "\
Example:
  sweepd config check /etc/sweepd/sweepd.toml")]
    Check {
        /// The configuration, TOML
        #[arg(value_name = "FILE")]
        file: PathBuf,
    },
    /// Print a configuration to begin with: every key, explained
    #[command(after_help = "\
Example:
  sweepd config example > sweepd.toml")]
    Example,
}

/// Runs the command.
///
/// # Errors
/// [`CliError::Config`]: what cannot be read or meant.
pub fn run(args: &Args) -> Result<(), CliError> {
    match &args.command {
        Command::Example => print(EXAMPLE),
        Command::Check { file } => check(file),
    }
}

fn print(text: &str) -> Result<(), CliError> {
    io::stdout()
        .write_all(text.as_bytes())
        .map_err(CliError::Stdout)
}

fn check(file: &Path) -> Result<(), CliError> {
    let config = Config::read(file)?;
    let mut text = format!(
        "{}: {}\n",
        file.display(),
        count_of(config.sensors.len() as u64, "sensor")
    );
    for sensor in &config.sensors {
        text += &told(&sensor.name, &sensor_lines(sensor));
    }
    let free = free_bytes();
    text += &told("daemon", &daemon_lines(&config, &free));
    print(&text)?;
    for missing in config.missing_on_this_host() {
        complain("warning", missing);
    }
    let most: u64 = config
        .sensors
        .iter()
        .map(|sensor| *memory::pool_bytes(sensor).end())
        .sum();
    if let Ok(free) = free
        && free < most
    {
        let (most, free) = (mib(most), mib(free));
        complain(
            "warning",
            format_args!(
                "{} has {free} free and {most} may be needed, if no daemon holds that now; enlarge it with \
                 `mount -o remount,size=...` (of a container: --shm-size), lower max_consumers, or tell model and returns",
                SHARED_MEMORY
            ),
        );
    }
    Ok(())
}

/// Lines of a heading: what, and what about it.
type Lines = Vec<(&'static str, String)>;

fn told(heading: &str, lines: &Lines) -> String {
    let mut text = format!("\n{heading}\n");
    for (what, value) in lines {
        let _ = writeln!(text, "  {what:<13}  {value}");
    }
    text
}

fn sensor_lines(sensor: &SensorConfig) -> Lines {
    let source = sensor
        .source_port
        .map_or_else(String::new, |port| format!(":{port}"));
    let sweeps = memory::sweep_bytes(sensor);
    let sweep = mib(*sweeps.start() as u64)..=mib(*sweeps.end() as u64);
    let samples = pool_sweeps(sensor.max_consumers);
    let consumers = count_of(sensor.max_consumers as u64, "consumer");
    vec![
        (
            "packets",
            format!(
                "from {}{source} to port {}",
                sensor.address, sensor.port.port
            ),
        ),
        (
            "positions",
            format!("from {} to port {}", sensor.address, sensor.position_port),
        ),
        ("listens", listening(sensor)),
        ("thread", thread(sensor)),
        ("model", model(sensor)),
        (
            "speed",
            sensor
                .rpm
                .map_or_else(|| "any".to_owned(), |rpm| format!("{rpm} rpm")),
        ),
        (
            "cut",
            format!(
                "at {} degrees",
                rounded(sensor.pipeline.cut_azimuth_rad.to_degrees())
            ),
        ),
        ("mount", mount(sensor)),
        ("segments", segments(sensor)),
        (
            "service",
            format!("sweepd/{}/sweep, {consumers} at most", sensor.name),
        ),
        (
            "shared memory",
            format!(
                "{}: {samples} sweeps of {}",
                pool(sensor),
                one_or_range(&sweep)
            ),
        ),
    ]
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
    let core = sensor
        .port
        .cpu
        .map_or_else(|| "any core".to_owned(), |cpu| format!("core {cpu}"));
    match sensor.port.realtime_priority {
        Some(priority) => format!("{core}, SCHED_FIFO priority {priority}"),
        None => format!("{core}, the usual scheduler"),
    }
}

fn model(sensor: &SensorConfig) -> String {
    let config = &sensor.pipeline;
    let model = config.model.map_or_else(
        || "told by the packets".to_owned(),
        |model| model.to_string(),
    );
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
    format!(
        "{model}; {calibration}; {returns}, {} segmented",
        format!("{:?}", config.return_choice).to_lowercase()
    )
}

fn mount(sensor: &SensorConfig) -> String {
    let (config, mount) = (&sensor.pipeline, &sensor.pipeline.segment.mount);
    let [x, y, z] = config.position_m;
    let [roll, pitch, yaw] = [mount.roll_rad, mount.pitch_rad, config.yaw_rad]
        .map(|rad| rounded(f64::from(rad).to_degrees()));
    let height = mount.height_m.map_or_else(
        || "height estimated".to_owned(),
        |height| format!("{height} m above ground"),
    );
    format!("x {x}, y {y}, z {z} m; roll {roll}, pitch {pitch}, yaw {yaw} degrees; {height}")
}

fn segments(sensor: &SensorConfig) -> String {
    let config = &sensor.pipeline.segment;
    let method = match config.method {
        Method::Slope => "slope",
        Method::Paper => "paper",
    };
    let theta = rounded(f64::from(config.theta_rad).to_degrees());
    let mut text = format!(
        "ground by {method}, theta {theta} degrees, {} points at least",
        config.min_points
    );
    let (min_m, max_m) = (config.min_range_m, config.max_range_m);
    let _ = match (min_m > 0.0, max_m.is_finite()) {
        (_, true) => write!(text, ", {min_m} to {max_m} m"),
        (true, false) => write!(text, ", from {min_m} m on"),
        (false, false) => Ok(()),
    };
    if config.mask.is_some() {
        text += ", masked";
    }
    text
}

fn daemon_lines(config: &Config, free: &io::Result<u64>) -> Lines {
    let http = config.daemon.http.map_or_else(
        || "off".to_owned(),
        |at| format!("http://{at}/health and /metrics"),
    );
    let by_default = "the default: $SWEEPD_ROOT, /run/sweepd/iox2 or /tmp/sweepd/iox2";
    let root = config
        .daemon
        .root
        .as_ref()
        .map_or_else(|| by_default.to_owned(), |root| root.display().to_string());
    let pools = config.sensors.iter().map(memory::pool_bytes);
    let (least, most) = pools.fold((0, 0), |sum, pool| {
        (sum.0 + pool.start(), sum.1 + pool.end())
    });
    let free = match free {
        Ok(free) => format!("{} free in {}", mib(*free), SHARED_MEMORY),
        Err(error) => format!("{}: {error}", SHARED_MEMORY),
    };
    vec![
        ("health", http),
        ("root", root),
        (
            "recording",
            config
                .record
                .as_ref()
                .map_or_else(|| "off".to_owned(), recording),
        ),
        (
            "shared memory",
            format!("{}; {free}", one_or_range(&(mib(least)..=mib(most)))),
        ),
    ]
}

fn recording(record: &RecordConfig) -> String {
    let mut text = format!(
        "{}, numbered, another file each start",
        record.path.display()
    );
    if let Some(bytes) = record.rotate_bytes {
        let _ = write!(text, ", each {} MB", bytes as f64 / 1e6);
    }
    if let Some(seconds) = record.rotate_seconds {
        let _ = write!(text, ", each {} minutes", rounded(seconds as f64 / 60.0));
    }
    text
}

fn pool(sensor: &SensorConfig) -> String {
    let bytes = memory::pool_bytes(sensor);
    one_or_range(&(mib(*bytes.start())..=mib(*bytes.end())))
}

fn mib(bytes: u64) -> String {
    format!("{:.1} MiB", bytes as f64 / f64::from(1 << 20))
}

fn one_or_range(texts: &RangeInclusive<String>) -> String {
    if texts.start() == texts.end() {
        texts.start().clone()
    } else {
        format!("{} to {}", texts.start(), texts.end())
    }
}

/// Without the noise of a conversion.
fn rounded(value: f64) -> f64 {
    super::output::rounded(value, 1e4)
}
