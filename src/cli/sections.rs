//! How each sensor of a capture is decoded and segmented: by the options alone, or as the daemon does
//! with a configuration, with the options over it.

use std::path::Path;

use super::options::{ConfigOptions, MountOptions, SegmentOptions, SensorChoice, SensorOptions};
use super::{CliError, complain};
use crate::admission::{Sender, SensorFilter, SensorFilterError};
use crate::daemon::config::{Config, SensorConfig};
use crate::streams::{Stream, Streams};
use sweepd_core::segment;

/// The sensors that are wanted.
#[derive(Clone, Debug)]
pub struct Sections {
    /// At least one.
    list: Vec<Section>,
    /// Whose packets are taken; all, if there are none.
    filters: Vec<SensorFilter>,
    /// Whether none of them was asked for by itself: those of a whole configuration.
    is_any_enough: bool,
}

/// What holds for a sensor.
#[derive(Clone, Debug)]
pub struct Section {
    /// Its settings, with the options over them. Without a configuration, its name is empty.
    pub sensor: SensorConfig,
    /// The segmenter's settings without the options.
    pub configured: segment::Config,
    /// The senders that it is for; `None` where it is for all that are taken.
    filter: Option<SensorFilter>,
}

/// What `--config` and `--sensor` choose.
struct Chosen {
    sections: Vec<(SensorConfig, Option<SensorFilter>)>,
    filters: Vec<SensorFilter>,
    is_any_enough: bool,
}

impl Sections {
    /// The sensors of these options.
    ///
    /// # Errors
    /// [`CliError`]: a file that cannot be read, an invalid value, a sensor that is not there.
    pub fn read(sensor: &SensorOptions, segment: &SegmentOptions) -> Result<Self, CliError> {
        let mut sections = Self::configured(&sensor.config)?;
        segment.warn();
        for section in &mut sections.list {
            sensor.apply(&mut section.sensor.pipeline)?;
            segment.apply(&mut section.sensor.pipeline)?;
        }
        Ok(sections)
    }

    /// The same with options of the mount alone.
    ///
    /// # Errors
    /// Those of [`Self::configured`].
    pub fn mounted(options: &ConfigOptions, mount: &MountOptions) -> Result<Self, CliError> {
        let mut sections = Self::configured(options)?;
        for section in &mut sections.list {
            mount.apply(&mut section.sensor.pipeline.segment);
        }
        Ok(sections)
    }

    /// The same without other options.
    ///
    /// # Errors
    /// [`CliError`]: a file that cannot be read, a sensor that is not there.
    pub fn configured(options: &ConfigOptions) -> Result<Self, CliError> {
        let chosen = options.choose()?;
        let mut list = Vec::new();
        for (sensor, filter) in chosen.sections {
            list.push(Section {
                configured: sensor.pipeline.segment.clone(),
                sensor,
                filter,
            });
        }
        Ok(Self {
            list,
            filters: chosen.filters,
            is_any_enough: chosen.is_any_enough,
        })
    }

    /// The only section.
    ///
    /// # Errors
    /// [`CliError`]: these are several.
    pub fn only(&self, options: &ConfigOptions) -> Result<&Section, CliError> {
        match &self.list[..] {
            [only] => Ok(only),
            list => {
                let sensors: Vec<SensorConfig> =
                    list.iter().map(|one| one.sensor.clone()).collect();
                Err(several(options, &sensors))
            }
        }
    }

    /// The only stream of those of a capture.
    ///
    /// # Errors
    /// In words: there are none, or several.
    pub fn only_one<S: Stream>(&self, mut streams: Streams<S>) -> Result<S, String> {
        let senders = streams.sensors.senders();
        if streams.all.len() > 1 {
            let names: Vec<&str> = senders.iter().map(|sender| self.name_of(sender)).collect();
            return Err(format!(
                "several sensors: choose one with --sensor: {}",
                names.join(", ")
            ));
        }
        streams.all.pop().ok_or_else(|| {
            let missing = self.missing(streams.sensors.senders());
            let missing = missing.into_iter().next();
            missing.unwrap_or_else(|| "no sensor sends data packets".to_owned())
        })
    }

    /// The same for a single sensor, wherever its packets come from.
    ///
    /// # Errors
    /// [`CliError`]: these are several.
    pub fn for_any_sender(mut self, options: &ConfigOptions) -> Result<Self, CliError> {
        self.only(options)?;
        self.list[0].filter = None;
        self.filters.clear();
        self.is_any_enough = false;
        Ok(self)
    }

    /// Whose packets are taken; all, if there are none.
    pub fn filters(&self) -> Vec<SensorFilter> {
        self.filters.clone()
    }

    /// All sections, by number; at least one.
    pub fn all(&self) -> &[Section] {
        &self.list
    }

    /// The section of a sender whose packets are taken.
    pub fn of(&self, sender: &Sender) -> &Section {
        &self.list[self.number_of(sender)]
    }

    /// The number of the section of a sender whose packets are taken.
    pub fn number_of(&self, sender: &Sender) -> usize {
        let of_sender = |section: &Section| {
            let filter = section.filter.as_ref();
            filter.is_none_or(|filter| sender.is_selected_by(filter))
        };
        self.list.iter().position(of_sender).unwrap_or_default()
    }

    /// What a sender is called: its name in the configuration, or its address.
    pub fn name_of<'a>(&'a self, sender: &'a Sender) -> &'a str {
        match &self.of(sender).sensor.name[..] {
            "" => &sender.name,
            name => name,
        }
    }

    /// Sensors that were asked for and are not among these senders: a line each.
    pub fn missing(&self, senders: &[Sender]) -> Vec<String> {
        let mut silent: Vec<String> = Vec::new();
        for filter in &self.filters {
            if !senders.iter().any(|sender| sender.is_selected_by(filter)) {
                silent.push(self.described(filter));
            }
        }
        if self.is_any_enough {
            if silent.len() < self.filters.len() {
                return Vec::new();
            }
            silent = vec![silent.join(", ")];
        }
        let cure = match self.list[0].filter {
            Some(_) => {
                "; `--sensor NAME --sensor ADDR` reads what ADDR sends with the settings of NAME"
            }
            None => "",
        };
        let line = |what: &String| {
            format!("no sensor {what} in it; `sweepd inspect` lists those that are there{cure}")
        };
        silent.iter().map(line).collect()
    }

    /// A filter, with the name of its sensor if it has one.
    fn described(&self, filter: &SensorFilter) -> String {
        let section = self
            .list
            .iter()
            .find(|section| section.filter.as_ref() == Some(filter));
        match section {
            Some(section) => format!("{} ({filter})", section.sensor.name),
            None => filter.to_string(),
        }
    }
}

impl ConfigOptions {
    /// The one sensor of the configuration that is chosen; `None` without a configuration.
    ///
    /// # Errors
    /// [`CliError`]: a file that cannot be read, a sensor that is not there, or several.
    pub fn one(&self) -> Result<Option<SensorConfig>, CliError> {
        let chosen = self.choose()?;
        let mut sections = chosen.sections.into_iter().map(|(sensor, _)| sensor);
        match (sections.next(), sections.next()) {
            _ if self.config.is_none() => Ok(None),
            (Some(first), Some(second)) => {
                let all: Vec<SensorConfig> = [first, second].into_iter().chain(sections).collect();
                Err(several(self, &all))
            }
            (only, _) => Ok(only),
        }
    }

    fn choose(&self) -> Result<Chosen, CliError> {
        let (mut names, mut filters) = (Vec::new(), Vec::new());
        for choice in &self.sensors {
            match choice {
                SensorChoice::Name(name) => names.push(name),
                SensorChoice::Sender(filter) => filters.push(filter.clone()),
            }
        }
        let Some(file) = &self.config else {
            if let Some(name) = names.first() {
                let error = SensorFilterError::new(name);
                return Err(CliError::Usage(format!(
                    "{error}; a name needs --config, the file that has it"
                )));
            }
            return Ok(Chosen {
                sections: vec![(SensorConfig::default(), None)],
                filters,
                is_any_enough: false,
            });
        };
        let config = Config::read_for_any_host(file)?;
        for warning in &config.warnings {
            complain("warning", warning);
        }
        choose_from(file, &config, &names, filters)
    }
}

/// The sections of a configuration with one of these names, all if there are none; and of these,
/// those at the addresses. A single name holds for all addresses.
fn choose_from(
    file: &Path,
    config: &Config,
    names: &[&String],
    filters: Vec<SensorFilter>,
) -> Result<Chosen, CliError> {
    let (in_file, there) = (file.display(), list(&config.sensors));
    if let Some(name) = names.iter().find(|name| config.sensor(name).is_none()) {
        let message = format!("{in_file} has no sensor called `{name}`; it has {there}");
        return Err(CliError::Usage(message));
    }
    let mut sensors = config.sensors.clone();
    sensors.retain(|sensor| names.is_empty() || names.contains(&&sensor.name));
    let is_any_enough = names.is_empty() && filters.is_empty();
    if names.len() == 1 && !filters.is_empty() {
        return Ok(Chosen {
            sections: sensors.into_iter().map(|sensor| (sensor, None)).collect(),
            filters,
            is_any_enough,
        });
    }
    let mut sections = Vec::new();
    let mut strangers = filters.clone();
    for sensor in sensors {
        let own = filter_of(config, &sensor);
        strangers.retain(|stranger| own.and(stranger).is_none());
        let own: Vec<SensorFilter> = match filters.is_empty() {
            true => vec![own],
            false => filters
                .iter()
                .filter_map(|filter| own.and(filter))
                .collect(),
        };
        sections.extend(own.into_iter().map(|filter| (sensor.clone(), Some(filter))));
    }
    if let Some(stranger) = strangers.first() {
        return Err(CliError::Usage(format!(
            "{in_file} has no sensor at {stranger}; it has {there}. To use the settings of one of them, name that one alone \
             beside it: --sensor {stranger} --sensor NAME"
        )));
    }
    Ok(Chosen {
        filters: sections
            .iter()
            .filter_map(|(_, filter)| filter.clone())
            .collect(),
        sections,
        is_any_enough,
    })
}

/// The senders that the daemon takes for a sensor. Only where sensors share an address, the port
/// that they send to tells them apart.
fn filter_of(config: &Config, sensor: &SensorConfig) -> SensorFilter {
    let at = config
        .sensors
        .iter()
        .filter(|other| other.address == sensor.address);
    let port = (at.count() > 1).then_some(sensor.port.port);
    SensorFilter::new(sensor.address, sensor.source_port, port)
}

/// `roof (192.168.1.201), rear (192.168.1.202:2368)`.
fn list(sensors: &[SensorConfig]) -> String {
    let one = |sensor: &SensorConfig| {
        let at = SensorFilter::new(sensor.address, sensor.source_port, None);
        format!("{} ({at})", sensor.name)
    };
    sensors.iter().map(one).collect::<Vec<_>>().join(", ")
}

/// The error of several sensors where one is meant.
fn several(options: &ConfigOptions, sensors: &[SensorConfig]) -> CliError {
    let file = options.config.as_deref().unwrap_or(Path::new("")).display();
    let there = list(sensors);
    CliError::Usage(format!(
        "{file} has several sensors: choose one with --sensor NAME, of {there}"
    ))
}
