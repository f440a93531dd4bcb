//! A configuration file as it is written: each key set by its row, and all that is wrong with the
//! file and with single values.

use std::ops::Range;
use std::path::Path;

use toml::Spanned;
use toml::de::{DeTable, DeValue};

use super::error::Problem;
use super::key::{Form, Table, Wrong, number, whole};
use super::keys::{DAEMON, RECORD, SENSOR, SENSOR_TABLES};
use super::table::{FileProblems, TableReader};
use super::{DaemonConfig, RecordConfig, SensorConfig};
use sweepd_core::segment::Method;
use sweepd_core::segment::settings::{self, REMOVED, SETTINGS, Unit};

/// Most problems of form that are shown.
const MAX_PROBLEMS: usize = 64;
/// Most sensors, more than any robot has: each is compared with all others, and each slip is drawn.
pub const MAX_SENSORS: usize = 64;

/// The whole file.
pub struct File<'t> {
    pub daemon: Written<'t, DaemonConfig>,
    pub sensors: Vec<Written<'t, SensorConfig>>,
    pub record: Option<Written<'t, RecordConfig>>,
}

/// What is written of a `C`.
pub struct Written<'t, C> {
    /// The default, with every value that can be.
    pub config: C,
    /// Where its table stands.
    pub at: Range<usize>,
    /// Whether nothing is missing, and every value of the right type can be.
    pub is_good: bool,
    /// The values of the right type; an empty text stands for a required one that is not there.
    given: Vec<(KeyPath, Spanned<DeValue<'t>>)>,
}

/// The name of a table, and that of a key in it.
type KeyPath = (&'static str, &'static str);

/// Reads a file past each unknown key, missing key and wrong value, so that all of them are found at
/// once.
///
/// # Errors
/// The problems, if what is left cannot be read: the first slip in the syntax, or too many
/// problems.
pub fn read<'t>(
    text: &'t str,
    folder: &'t Path,
) -> Result<(File<'t>, FileProblems<'t>), Vec<Problem>> {
    let table = DeTable::parse(text).map_err(|error| vec![Problem::of_toml(&error)])?;
    let mut found = FileProblems::new(text, folder);
    let file = File::read(TableReader::of(table, &mut found));
    if found.problems.len() >= MAX_PROBLEMS {
        found.problems.sort_by_key(|problem| problem.at.start);
        found.problems.truncate(MAX_PROBLEMS);
        return Err(found.problems);
    }
    // That no sensor could be read says nothing of whether one is configured.
    if file.sensors.is_empty() && !found.problems.is_empty() {
        found.replaced.push(0..0);
    }
    Ok((file, found))
}

impl<'t> File<'t> {
    fn read(mut reader: TableReader<'_, '_, 't>) -> Self {
        let mut daemon = Written::new(&reader);
        daemon.read(&mut reader, &DAEMON);
        let sensors = read_sensors(&mut reader);
        let record = reader.table(RECORD.name).map(|mut reader| {
            let mut record = Written::new(&reader);
            record.read(&mut reader, &RECORD);
            reader.finish();
            record
        });
        reader.finish();
        Self {
            daemon,
            sensors,
            record,
        }
    }
}

fn read_sensors<'t>(file: &mut TableReader<'_, '_, 't>) -> Vec<Written<'t, SensorConfig>> {
    let Some(value) = file.take("sensor") else {
        return Vec::new();
    };
    let DeValue::Array(tables) = value.get_ref() else {
        let expected = "one [[sensor]], in double brackets, for each sensor";
        file.problems().wrong_type(&value, expected);
        return Vec::new();
    };
    let before = file.problems().values.len();
    let mut sensors = Vec::new();
    for table in tables.iter() {
        if let Some(reader) = TableReader::new(table.clone(), file.problems()) {
            sensors.push(Written::read_sensor(reader));
        }
    }
    // That there are too many is enough.
    if sensors.len() > MAX_SENSORS {
        file.problems().values.truncate(before);
    }
    sensors
}

impl<'t> Written<'t, SensorConfig> {
    fn read_sensor(mut reader: TableReader<'_, '_, 't>) -> Self {
        let mut sensor = Self::new(&reader);
        sensor.read(&mut reader, &SENSOR);
        for table in &SENSOR_TABLES[1..] {
            let Some(mut reader) = reader.table(table.name) else {
                continue;
            };
            sensor.read(&mut reader, table);
            match table.name {
                "mount" => sensor.read_numbers(&mut reader, table.name, settings::Table::Mount),
                "segment" => {
                    for removed in REMOVED {
                        reader.removed(removed.key, &removed.warning(removed.key));
                    }
                    sensor.read_numbers(&mut reader, table.name, settings::Table::Segment);
                    sensor.warn_of_theta(&mut reader);
                }
                _ => {}
            }
            reader.finish();
        }
        reader.finish();
        sensor
    }

    /// Up to 0.2 it was of both methods.
    fn warn_of_theta(&self, reader: &mut TableReader<'_, '_, 't>) {
        if let Some(given) = self.given("segment", "theta_deg")
            && self.config.pipeline.segment.method != Method::Paper
        {
            let warning = "`theta_deg` does nothing, leave it out: it is of the method `paper`, and this is `slope`";
            reader.problems().warn(given.span().start, warning);
        }
    }

    /// Names and values of what is set to something else than the default, as `text`, the file, has them.
    pub fn differing<'a>(&self, text: &'a str) -> Vec<(String, &'a str)> {
        let default = SensorConfig::default();
        let mut settings = Vec::new();
        for ((table, name), value) in &self.given {
            let mut alone = default.clone();
            let is_default = match form(table, name) {
                Some(Form::Required(_)) | None => true,
                // What is in it is another matter.
                Some(Form::File(_)) => false,
                Some(Form::Segmenter) => {
                    let setting = SETTINGS.iter().find(|setting| setting.key == *name);
                    let value = number(value.get_ref());
                    setting.zip(value).is_none_or(|(setting, value)| {
                        setting.set(&mut alone.pipeline.segment, value);
                        setting.is_same(&default.pipeline.segment, &alone.pipeline.segment)
                    })
                }
                Some(form) => {
                    let is_set = form.set(&mut alone, value.get_ref(), Path::new(""));
                    is_set.is_err() || is_same(&default, &alone)
                }
            };
            if !is_default {
                let dot = if table.is_empty() { "" } else { "." };
                let value = text.get(value.span()).unwrap_or_default();
                settings.push((format!("{table}{dot}{name}"), value));
            }
        }
        settings
    }

    /// Numbers of [`SETTINGS`].
    fn read_numbers(
        &mut self,
        reader: &mut TableReader<'_, '_, 't>,
        table: &'static str,
        of: settings::Table,
    ) {
        for setting in SETTINGS.iter().filter(|setting| setting.table == of) {
            let Some(value) = reader.take(setting.key) else {
                continue;
            };
            let found = match setting.unit {
                Unit::Count => whole(value.get_ref())
                    .map(|count| count as f64)
                    .ok_or(Wrong::Type("a whole number")),
                _ => number(value.get_ref()).ok_or(Wrong::Type("a number")),
            };
            let found = found.and_then(|number| {
                if setting.allows(number) {
                    setting.set(&mut self.config.pipeline.segment, number);
                    return Ok(());
                }
                let expected = format!("expected {}", setting.expected());
                Err(Wrong::Value(number.to_string(), expected.into()))
            });
            self.take((table, setting.key), value, found, reader);
        }
    }
}

/// The form of a key of a sensor.
fn form(table: &str, name: &str) -> Option<&'static Form<SensorConfig>> {
    let table = SENSOR_TABLES.iter().find(|one| one.name == table)?;
    let key = table.keys.iter().find(|key| key.name == name)?;
    Some(&key.form)
}

/// Whether two sensors have the same, but for the segmenter's numbers.
fn is_same(one: &SensorConfig, other: &SensorConfig) -> bool {
    let keys = SENSOR_TABLES.iter().flat_map(|table| table.keys);
    let mut rules = keys.flat_map(|key| key.rules);
    rules.all(|rule| (rule.is_same)(one, other))
}

impl<'t, C: Default> Written<'t, C> {
    pub(super) fn new(reader: &TableReader<'_, '_, 't>) -> Self {
        Self {
            config: C::default(),
            at: reader.span(),
            is_good: true,
            given: Vec::new(),
        }
    }

    /// Sets what the keys of a table say.
    pub(super) fn read(&mut self, reader: &mut TableReader<'_, '_, 't>, table: &Table<C>) {
        for key in table.keys {
            if matches!(key.form, Form::Segmenter) {
                continue;
            }
            let is_required = matches!(key.form, Form::Required(_));
            let Some(mut value) = reader.take(key.name) else {
                if is_required {
                    reader.missing(key.name);
                    self.stand_in((table.name, key.name), self.at.clone());
                }
                continue;
            };
            if let Form::Image(_, removes) = key.form
                && value.get_ref().is_table()
            {
                match self.image(value, removes, reader) {
                    Some(image) => value = image,
                    None => continue,
                }
            }
            let folder = reader.problems().folder;
            let set = key.form.set(&mut self.config, value.get_ref(), folder);
            if is_required && matches!(set, Err(Wrong::Type(_))) {
                self.stand_in((table.name, key.name), value.span());
            }
            self.take((table.name, key.name), value, set, reader);
        }
    }

    /// The path in `{ image = PATH, remove = true }`.
    fn image(
        &mut self,
        value: Spanned<DeValue<'t>>,
        removes: fn(&mut C, bool),
        reader: &mut TableReader<'_, '_, 't>,
    ) -> Option<Spanned<DeValue<'t>>> {
        let mut table = TableReader::new(value, reader.problems())?;
        if let Some(value) = table.take("remove") {
            match value.get_ref().as_bool() {
                Some(flag) => removes(&mut self.config, flag),
                None => table.problems().wrong_type(&value, "a boolean"),
            }
        }
        let image = table.take("image");
        if image.is_none() {
            table.missing("image");
        }
        table.finish();
        image
    }

    /// An empty text for a required one that is not there.
    fn stand_in(&mut self, key: KeyPath, at: Range<usize>) {
        self.is_good = false;
        let empty = DeValue::String("".into());
        self.given.push((key, Spanned::new(at, empty)));
    }

    /// Keeps a value of the right type, and notes what is wrong with one.
    fn take(
        &mut self,
        key: KeyPath,
        value: Spanned<DeValue<'t>>,
        set: Result<(), Wrong>,
        reader: &mut TableReader<'_, '_, 't>,
    ) {
        if let Err(wrong) = set {
            let is_type = !matches!(wrong, Wrong::Value(..));
            reader.problems().wrong(key.1, &value, wrong);
            if is_type {
                return;
            }
            self.is_good = false;
        }
        self.given.push((key, value));
    }
}

impl<'t, C> Written<'t, C> {
    /// What is given for a key of a table, if it has the right type.
    pub fn given(&self, table: &str, name: &str) -> Option<&Spanned<DeValue<'t>>> {
        let found = self.given.iter().find(|(key, _)| *key == (table, name));
        found.map(|(_, value)| value)
    }

    /// Where a key of the table itself is given; where the table stands if it is not.
    pub fn place(&self, name: &str) -> Range<usize> {
        self.given("", name).map_or(self.at.clone(), Spanned::span)
    }
}
