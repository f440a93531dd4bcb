//! What depends on several keys of one `[[sensor]]`, on files or on the machine.

use toml::Spanned;

use super::Check;
use crate::daemon::config::SensorConfig;
use crate::daemon::config::file::Written;
use crate::daemon::config::key::{Form, number, path};
use crate::daemon::config::keys::{LOSS_PERCENT, SENSOR_TABLES};
use crate::sensor_settings::Rpm;
use sweepd_core::segment::ConfigError;
use sweepd_core::sensor::Model;

type Sensor<'t> = Written<'t, SensorConfig>;

impl Check<'_> {
    /// Checks a sensor.
    pub(super) fn sensor(&mut self, sensor: &mut Sensor<'_>) {
        self.cpu(sensor);
        self.losses(sensor);
        self.returns_are_of_the_model(sensor);
        self.want(sensor);
        self.files(sensor);
        self.segment(sensor);
    }

    /// A core that this machine has, where the system tells which it has.
    fn cpu(&mut self, sensor: &Sensor<'_>) {
        let online = std::fs::read_to_string("/sys/devices/system/cpu/online").unwrap_or_default();
        if let Some(cpu) = sensor.config.port.cpu
            && self.is_of_this_host
            && !online.is_empty()
            && !lists(&online, cpu)
        {
            self.problem(
                sensor.place("cpu"),
                format!("`cpu` cannot be {cpu}"),
                format!("the cores of this machine are {}", online.trim()),
            );
        }
    }

    /// Where one limit of two is given, the default of the other gives way.
    fn losses(&mut self, sensor: &mut Sensor<'_>) {
        let percent = |key| {
            let given = number(sensor.given("", key)?.get_ref());
            given.filter(|percent| LOSS_PERCENT.contains(percent))
        };
        let warning = percent("loss_warning_percent");
        let fault = percent("loss_fault_percent");
        let limits = &mut sensor.config.losses;
        match (warning, fault) {
            (Some(warning), Some(fault)) if warning > fault => {
                self.problem(
                    sensor.place("loss_warning_percent"),
                    format!("`loss_warning_percent` cannot be {warning}"),
                    format!("expected at most `loss_fault_percent`, which is {fault}"),
                );
            }
            (Some(_), None) => limits.fault = limits.fault.max(limits.warning),
            (None, Some(_)) => limits.warning = limits.warning.min(limits.fault),
            _ => {}
        }
    }

    fn returns_are_of_the_model(&mut self, sensor: &Sensor<'_>) {
        let config = &sensor.config;
        if config.dual == Some(true) && config.pipeline.model == Some(Model::Hdl64eS2) {
            self.problem(
                sensor.place("returns"),
                "an HDL-64E S2 sends one return",
                "expected \"single\"",
            )
            .cure = Some("one that sends two is an HDL-64E S3: `model = \"hdl64e-s3\"`".to_owned());
        }
    }

    /// What it should be set to.
    fn want(&mut self, sensor: &Sensor<'_>) {
        let is_hdl64e = sensor.config.pipeline.model.is_some_and(Model::is_hdl64e);
        let given = |key| sensor.given("want", key);
        if let (Some(given), Some(rpm)) = (given("rpm"), sensor.config.want.rpm)
            && i64::from(rpm.0) % Rpm::STEP != 0
            && !is_hdl64e
        {
            let title = format!("`rpm` cannot be {rpm}");
            self.problem(given.span(), title, "expected a multiple of 60");
        }
        for key in ["laser", "host", "phase_lock"] {
            if let Some(given) = given(key).filter(|_| is_hdl64e) {
                let title = format!("`{key}` of an HDL-64E cannot be read");
                self.problem(given.span(), title, "it has no web interface");
            }
        }
    }

    /// Reads the files that are named, which must fit the model.
    fn files(&mut self, sensor: &mut Sensor<'_>) {
        for table in SENSOR_TABLES {
            for key in table.keys {
                if let Form::File(read) | Form::Image(read, _) = key.form
                    && let Some(given) = sensor.given(table.name, key.name)
                    && let Ok(path) = path(given.get_ref(), self.folder)
                {
                    let at = given.span();
                    if let Err(why) = read(&mut sensor.config, &path) {
                        self.problem(at, why, format!("the {} that is named here", key.name));
                    }
                }
            }
        }
    }

    fn segment(&mut self, sensor: &Sensor<'_>) {
        let SensorConfig { name, pipeline, .. } = &sensor.config;
        let config = &pipeline.segment;
        if pipeline.removal.out_of_range
            && let Some(given) = sensor.given("segment", "remove_out_of_range")
            && !config.is_range_limited()
        {
            let title = "`remove_out_of_range` removes nothing";
            self.problem(
                given.span(),
                title,
                "expected `min_range_m` or `max_range_m` beside it",
            );
        }
        let Err(error) = config.check() else {
            let warning = config.mount.warning();
            self.warnings
                .extend(warning.map(|warning| format!("{name}: {warning}")));
            return;
        };
        let (table, key) = match error {
            ConfigError::Theta { .. } => ("segment", "theta_deg"),
            ConfigError::Range { .. } if config.max_range_m.is_infinite() => {
                ("segment", "min_range_m")
            }
            ConfigError::Range { .. } => ("segment", "max_range_m"),
            ConfigError::Height { .. } => ("mount", "height_m"),
            // No key of a file sets it, as the gap.
            _ => ("", ""),
        };
        let to_blame = sensor.given(table, key);
        let at = to_blame.map_or(sensor.at.clone(), Spanned::span);
        self.problem(at, error.to_string(), "");
    }
}

/// Whether a list of the kernel, such as `0-3,6`, has a number.
fn lists(list: &str, number: usize) -> bool {
    list.trim().split(',').any(|part| {
        let (first, last) = part.split_once('-').unwrap_or((part, part));
        matches!((first.parse::<usize>(), last.parse::<usize>()), (Ok(first), Ok(last)) if (first..=last).contains(&number))
    })
}
