//! From what is written to what can be run: every value within its limits, every file read, the
//! sensors told apart.
//!
//! All that is wrong is collected, so that one run of `sweepd config check` shows it.

mod ports;
mod sensor;
mod values;

use std::net::{Ipv4Addr, SocketAddr};
use std::ops::Range;
use std::path::Path;

use toml::Spanned;

use super::error::Problem;
use super::{Config, DaemonConfig, RecordConfig, SensorConfig, file};

/// Where health and metrics are served unless something else is said.
const HTTP: SocketAddr = SocketAddr::new(std::net::IpAddr::V4(Ipv4Addr::LOCALHOST), 9177);
/// Most sensors, more than any robot has: each is compared with all others, and each slip is drawn.
const MAX_SENSORS: usize = 64;
/// Sizes and times that a file of a recording may have.
const ROTATE_MB: std::ops::RangeInclusive<f64> = 1.0..=1e6;
const ROTATE_MINUTES: std::ops::RangeInclusive<f64> = 0.1..=1e5;

/// A check under way.
pub(super) struct Check<'a> {
    /// What relative paths are relative to.
    folder: &'a Path,
    problems: Vec<Problem>,
}

/// A sensor in which nothing is wrong, and how it was written.
struct Checked<'a> {
    written: &'a file::Sensor,
    config: SensorConfig,
}

/// The configuration that is written in a file of this folder, or all that is wrong with it.
pub(super) fn check(reading: file::Reading, folder: &Path) -> Result<Config, Vec<Problem>> {
    let file::Reading {
        file,
        problems,
        replaced,
        warnings,
    } = reading;
    let mut check = Check {
        folder,
        problems: Vec::new(),
    };
    let daemon = DaemonConfig {
        root: check.path("root", &file.root),
        http: check.http(&file),
        http_public: file.http_public,
    };
    let sensors = check.sensors(&file.sensors);
    let record = file.record.as_ref().and_then(|record| check.record(record));
    check
        .problems
        .retain(|problem| !replaced.contains(&problem.at));
    check.problems.extend(problems);
    if check.problems.is_empty() {
        Ok(Config {
            daemon,
            sensors,
            record,
            warnings,
        })
    } else {
        Err(check.problems)
    }
}

impl Check<'_> {
    fn problem(
        &mut self,
        at: Range<usize>,
        title: impl Into<String>,
        expected: impl Into<String>,
    ) -> &mut Problem {
        self.problems.push(Problem::new(at, title, expected));
        let last = self.problems.len() - 1;
        &mut self.problems[last]
    }

    fn http(&mut self, file: &file::File) -> Option<SocketAddr> {
        let Some(given) = &file.http else {
            return Some(HTTP);
        };
        if given.get_ref() == "off" {
            return None;
        }
        let Some(address) = given
            .get_ref()
            .parse()
            .ok()
            .filter(|address: &SocketAddr| address.port() != 0)
        else {
            let title = format!("`http` cannot be {:?}", given.get_ref());
            self.problem(
                given.span(),
                title,
                format!("expected an address and port such as {HTTP}, or \"off\""),
            );
            return None;
        };
        if !address.ip().to_canonical().is_loopback() && !file.http_public {
            let title = format!("`http` would be open to all who reach {address}");
            self.problem(given.span(), title, "not an address of this host alone")
                .cure = Some(format!(
                "serve {HTTP}, or say `http_public = true` if that is meant"
            ));
        }
        Some(address)
    }

    fn sensors(&mut self, written: &[Spanned<file::Sensor>]) -> Vec<SensorConfig> {
        if written.is_empty() {
            self.problem(0..0, "no sensor is configured", "").cure =
                Some("`sweepd config example` prints a whole configuration".to_owned());
        }
        if let Some(beyond) = written.get(MAX_SENSORS) {
            let title = format!("{} sensors are configured", written.len());
            self.problem(
                beyond.span(),
                title,
                format!("expected at most {MAX_SENSORS}; this is one more"),
            );
            return Vec::new();
        }
        self.names_are_unique(written);
        let mut sensors = Vec::new();
        for written in written {
            let before = self.problems.len();
            let config = self.sensor(written.get_ref(), written.span());
            if let Some(config) = config.filter(|_| self.problems.len() == before) {
                sensors.push(Checked {
                    written: written.get_ref(),
                    config,
                });
            }
        }
        self.ports(&mut sensors);
        sensors.into_iter().map(|sensor| sensor.config).collect()
    }

    fn names_are_unique(&mut self, written: &[Spanned<file::Sensor>]) {
        let names: Vec<&Spanned<String>> = written
            .iter()
            .map(|sensor| &sensor.get_ref().name)
            .collect();
        for (number, name) in names.iter().enumerate() {
            if let Some(first) = names[..number]
                .iter()
                .find(|first| first.get_ref() == name.get_ref())
            {
                let title = format!("two sensors are called `{}`", name.get_ref());
                let problem = Problem::new(name.span(), title, "expected another name");
                self.problems
                    .push(problem.with_other(first.span(), "the first of this name"));
            }
        }
    }

    fn record(&mut self, record: &file::Record) -> Option<RecordConfig> {
        let given = record.path.get_ref();
        let is_capture = [".pcap", ".pcap.gz"].iter().any(|end| {
            let name = given.rsplit('/').next().unwrap_or_default();
            name.strip_suffix(end).is_some_and(|stem| !stem.is_empty())
        });
        if !is_capture {
            let title = format!("`path` cannot be {given:?}");
            self.problem(
                record.path.span(),
                title,
                "expected a file called NAME.pcap or NAME.pcap.gz",
            );
        }
        let megabytes = self.number("rotate_mb", &record.rotate_mb, ROTATE_MB, "MB");
        let minutes = self.number(
            "rotate_minutes",
            &record.rotate_minutes,
            ROTATE_MINUTES,
            "minutes",
        );
        Some(RecordConfig {
            path: self.path("path", &Some(record.path.clone()))?,
            rotate_bytes: megabytes.map(|megabytes| (megabytes * 1e6) as u64),
            rotate_seconds: minutes.map(|minutes| (minutes * 60.0).round() as u64),
        })
    }
}
