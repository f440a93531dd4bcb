//! From what is written to what can be run: what depends on several keys, on other files or on the
//! machine, and the sensors told apart.
//!
//! All that is wrong is collected, so that one run of `sweepd config check` shows it.

mod ports;
mod sensor;

use std::ops::Range;
use std::path::Path;

use super::error::Problem;
use super::file::{File, MAX_SENSORS, Written};
use super::key::{Wrong, path};
use super::keys::RECORD;
use super::table::FileProblems;
use super::{Config, DaemonConfig, HTTP, RecordConfig, SensorConfig};

/// A check under way.
pub(super) struct Check<'a> {
    /// What relative paths are relative to.
    folder: &'a Path,
    /// Whether it is for this host.
    is_of_this_host: bool,
    problems: Vec<Problem>,
    /// What is accepted, and hardly meant.
    warnings: Vec<String>,
}

/// The configuration that is written in a file, or all that is wrong with it.
pub(super) fn check(
    file: File<'_>,
    found: FileProblems<'_>,
    is_of_this_host: bool,
) -> Result<Config, Vec<Problem>> {
    let mut check = Check {
        folder: found.folder,
        is_of_this_host,
        problems: Vec::new(),
        warnings: found.warnings,
    };
    check.http(&file.daemon);
    let sensors = check.sensors(file.sensors);
    // Problems of one place are shown in this order: a value by itself comes last, but for the path.
    check.problems.extend(found.values);
    let record = file.record.map(|record| check.record(record));
    check
        .problems
        .retain(|problem| !found.replaced.contains(&problem.at));
    check.problems.extend(found.problems);
    if check.problems.is_empty() {
        Ok(Config {
            daemon: file.daemon.config,
            sensors,
            record,
            warnings: check.warnings,
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

    fn http(&mut self, daemon: &Written<'_, DaemonConfig>) {
        if let Some(given) = daemon.given("", "http")
            && let Some(address) = daemon.config.http
            && !address.ip().to_canonical().is_loopback()
            && !daemon.config.http_public
        {
            let title = format!("`http` would be open to all who reach {address}");
            self.problem(given.span(), title, "not an address of this host alone")
                .cure = Some(format!(
                "serve {HTTP}, or say `http_public = true` if that is meant"
            ));
        }
    }

    fn sensors(&mut self, mut written: Vec<Written<'_, SensorConfig>>) -> Vec<SensorConfig> {
        if written.is_empty() {
            self.problem(0..0, "no sensor is configured", "").cure =
                Some("`sweepd config example` prints a whole configuration".to_owned());
        }
        if let Some(beyond) = written.get(MAX_SENSORS) {
            let title = format!("{} sensors are configured", written.len());
            self.problem(
                beyond.at.clone(),
                title,
                format!("expected at most {MAX_SENSORS}; this is one more"),
            );
            return Vec::new();
        }
        self.names_are_unique(&written);
        for sensor in &mut written {
            let before = self.problems.len();
            self.sensor(sensor);
            sensor.is_good &= self.problems.len() == before;
        }
        written.retain(|sensor| sensor.is_good);
        self.ports(&mut written);
        written.into_iter().map(|sensor| sensor.config).collect()
    }

    fn names_are_unique(&mut self, written: &[Written<'_, SensorConfig>]) {
        let name_of = |sensor: &Written<'_, _>| sensor.place("name");
        for (number, sensor) in written.iter().enumerate() {
            let name = &sensor.config.name;
            if let Some(first) = written[..number]
                .iter()
                .find(|first| first.config.name == *name)
            {
                let title = format!("two sensors are called `{name}`");
                let problem = Problem::new(name_of(sensor), title, "expected another name");
                self.problems
                    .push(problem.with_other(name_of(first), "the first of this name"));
            }
        }
    }

    /// Brings the path to the folder of the configuration.
    fn record(&mut self, mut record: Written<'_, RecordConfig>) -> RecordConfig {
        if let Some(given) = record.given(RECORD.name, "path") {
            let at = given.span();
            match path(given.get_ref(), self.folder) {
                Ok(path) => record.config.path = path,
                Err(Wrong::Value(shown, refusal)) => {
                    self.problems.push(refusal.problem(at, "path", &shown));
                }
                // It was read as a text.
                Err(_) => {}
            }
        }
        record.config
    }
}
