//! A configuration file as it is written: keys and types, nothing checked yet.

use std::fmt;
use std::marker::PhantomData;
use std::ops::Range;

use serde::de::{Deserialize, DeserializeSeed, Deserializer, Error, MapAccess, SeqAccess, Visitor};
use toml::Spanned;
use toml::de::{DeTable, DeValue};

use super::error::Problem;
use sweepd_core::segment::settings::{SETTINGS, Setting, Table, Unit};

/// Most problems of a file that are looked for: each costs another reading.
const MAX_PROBLEMS: usize = 64;
/// Keys without which a table cannot be read.
const REQUIRED: [&str; 3] = ["name", "address", "path"];

/// A file as far as it could be read.
pub struct Reading {
    /// The file, without what is wrong in form or type.
    pub file: File,
    /// Unknown keys, missing keys and wrong types.
    pub problems: Vec<Problem>,
    /// Where something was left out or stands for a required key: further problems of these places
    /// are no news.
    pub replaced: Vec<Range<usize>>,
}

/// Reads a file past each unknown key, missing key and wrong type, so that all of them are found at
/// once.
///
/// # Errors
/// The problems, if what is left cannot be read: the first slip in the syntax, or too many
/// problems.
pub fn read(text: &str) -> Result<Reading, Vec<Problem>> {
    let mut table = DeTable::parse(text).map_err(|error| vec![Problem::of_toml(&error, text)])?;
    let (mut problems, mut replaced) = (Vec::new(), Vec::new());
    loop {
        match File::deserialize(toml::Deserializer::from(table.clone())) {
            Ok(file) => {
                return Ok(Reading {
                    file,
                    problems,
                    replaced,
                });
            }
            Err(error) => {
                problems.push(Problem::of_toml(&error, text));
                let place = error.span().filter(|_| problems.len() < MAX_PROBLEMS);
                let Some(place) =
                    place.filter(|place| pass_over(&mut table, place, error.message()))
                else {
                    return Err(problems);
                };
                let is_sensors = table.get_ref().get("sensor").is_none();
                replaced.push(if is_sensors { 0..0 } else { place });
            }
        }
    }
}

/// Changes the table where an error is, so that it can be read past that. Whether the place was
/// found.
fn pass_over(table: &mut Spanned<DeTable<'_>>, place: &Range<usize>, message: &str) -> bool {
    let span = table.span();
    let missing = message
        .strip_prefix("missing field `")
        .and_then(|rest| rest.strip_suffix('`'));
    if let Some(key) = missing.filter(|_| span == *place) {
        let placeholder = Spanned::new(span.clone(), DeValue::String(String::new().into()));
        table
            .get_mut()
            .insert(Spanned::new(span, key.to_owned().into()), placeholder);
        return true;
    }
    let is_here = |key: &Range<usize>, value: &Range<usize>| {
        key == place || (missing.is_none() && value == place)
    };
    let entry = table
        .get_ref()
        .iter()
        .find(|(key, value)| is_here(&key.span(), &value.span()));
    if let Some(key) = entry.map(|(key, _)| key.clone()) {
        let is_required = REQUIRED.contains(&&key.get_ref()[..]) && key.span() != *place;
        match table.get_mut().get_mut(&key).filter(|_| is_required) {
            Some(value) => *value.get_mut() = DeValue::String(String::new().into()),
            None => drop(table.get_mut().remove(&key)),
        }
        return true;
    }
    table
        .get_mut()
        .iter_mut()
        .any(|(_, value)| pass_over_within(value, place, message))
}

fn pass_over_within(value: &mut Spanned<DeValue<'_>>, place: &Range<usize>, message: &str) -> bool {
    let span = value.span();
    match value.get_mut() {
        DeValue::Table(inner) => {
            let mut table = Spanned::new(span, std::mem::take(inner));
            let found = pass_over(&mut table, place, message);
            *inner = table.into_inner();
            found
        }
        DeValue::Array(values) => values
            .iter_mut()
            .any(|value| pass_over_within(value, place, message)),
        _ => false,
    }
}

/// The whole file.
#[derive(serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct File {
    pub http: Option<Spanned<String>>,
    #[serde(default)]
    pub http_public: bool,
    pub root: Option<Spanned<String>>,
    #[serde(default)]
    pub sensor: Sensors,
    pub record: Option<Record>,
}

/// A `[[sensor]]`.
#[derive(serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Sensor {
    pub name: Spanned<String>,
    pub address: Spanned<String>,
    pub port: Option<Spanned<Whole>>,
    pub position_port: Option<Spanned<Whole>>,
    pub bind: Option<Spanned<String>>,
    pub multicast: Option<Spanned<String>>,
    pub interface: Option<Spanned<String>>,
    pub cpu: Option<Spanned<Whole>>,
    pub realtime_priority: Option<Spanned<Whole>>,
    pub model: Option<Spanned<String>>,
    pub calibration: Option<Spanned<String>>,
    pub returns: Option<Spanned<Returns>>,
    #[serde(rename = "return")]
    pub which_return: Option<WhichReturn>,
    pub cut_azimuth_deg: Option<Spanned<Number>>,
    pub rpm: Option<Spanned<Number>>,
    #[serde(default)]
    pub gps_without_pps: bool,
    pub loss_warning_percent: Option<Spanned<Number>>,
    pub loss_fault_percent: Option<Spanned<Number>>,
    pub max_consumers: Option<Spanned<Whole>>,
    #[serde(default)]
    pub mount: Mount,
    #[serde(default)]
    pub segment: Segment,
}

/// `[sensor.mount]`.
#[derive(Default)]
pub struct Mount {
    pub x_m: Option<Spanned<Number>>,
    pub y_m: Option<Spanned<Number>>,
    pub z_m: Option<Spanned<Number>>,
    pub yaw_deg: Option<Spanned<Number>>,
    pub numbers: Numbers,
}

/// `[sensor.segment]`.
#[derive(Default)]
pub struct Segment {
    pub method: Option<Method>,
    pub mask: Option<Spanned<String>>,
    pub numbers: Numbers,
}

/// Numbers of [`SETTINGS`] that are written in a table.
pub type Numbers = Vec<(&'static Setting, Spanned<f64>)>;

/// A table whose keys are its own and those of [`SETTINGS`].
trait Keyed: Default {
    const TABLE: Table;
    /// Its own keys.
    const KEYS: &'static [&'static str];

    /// Reads the value of one of its own keys.
    fn read<'de, A: MapAccess<'de>>(&mut self, key: &str, map: &mut A) -> Result<(), A::Error>;

    fn numbers(&mut self) -> &mut Numbers;
}

impl Keyed for Mount {
    const TABLE: Table = Table::Mount;
    const KEYS: &'static [&'static str] = &["x_m", "y_m", "z_m", "yaw_deg"];

    fn read<'de, A: MapAccess<'de>>(&mut self, key: &str, map: &mut A) -> Result<(), A::Error> {
        let field = match key {
            "x_m" => &mut self.x_m,
            "y_m" => &mut self.y_m,
            "z_m" => &mut self.z_m,
            _ => &mut self.yaw_deg,
        };
        *field = Some(map.next_value()?);
        Ok(())
    }

    fn numbers(&mut self) -> &mut Numbers {
        &mut self.numbers
    }
}

impl Keyed for Segment {
    const TABLE: Table = Table::Segment;
    const KEYS: &'static [&'static str] = &["method", "mask"];

    fn read<'de, A: MapAccess<'de>>(&mut self, key: &str, map: &mut A) -> Result<(), A::Error> {
        match key {
            "method" => self.method = Some(map.next_value()?),
            _ => self.mask = Some(map.next_value()?),
        }
        Ok(())
    }

    fn numbers(&mut self) -> &mut Numbers {
        &mut self.numbers
    }
}

/// A key of a [`Keyed`] table.
enum Key {
    Own(&'static str),
    Number(&'static Setting),
}

/// Reads a key of `T`; another one is an error at its place.
struct KeyReader<T>(PhantomData<T>);

impl<'de, T: Keyed> DeserializeSeed<'de> for KeyReader<T> {
    type Value = Key;

    fn deserialize<D: Deserializer<'de>>(self, deserializer: D) -> Result<Key, D::Error> {
        deserializer.deserialize_identifier(self)
    }
}

impl<T: Keyed> Visitor<'_> for KeyReader<T> {
    type Value = Key;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a key")
    }

    fn visit_str<E: Error>(self, text: &str) -> Result<Key, E> {
        let numbers = || SETTINGS.iter().filter(|setting| setting.table == T::TABLE);
        if let Some(key) = T::KEYS.iter().find(|key| **key == text) {
            return Ok(Key::Own(key));
        }
        if let Some(setting) = numbers().find(|setting| setting.key == text) {
            return Ok(Key::Number(setting));
        }
        let keys = T::KEYS.iter().copied().chain(numbers().map(|one| one.key));
        let keys: Vec<String> = keys.map(|key| format!("`{key}`")).collect();
        // The words of serde, which `Problem` knows.
        Err(E::custom(format_args!(
            "unknown field `{text}`, expected one of {}",
            keys.join(", ")
        )))
    }
}

struct TableReader<T>(PhantomData<T>);

impl<'de, T: Keyed> Visitor<'de> for TableReader<T> {
    type Value = T;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a table")
    }

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<T, A::Error> {
        let mut table = T::default();
        while let Some(key) = map.next_key_seed(KeyReader::<T>(PhantomData))? {
            match key {
                Key::Own(key) => table.read(key, &mut map)?,
                Key::Number(setting) => {
                    let (span, value) = if setting.unit == Unit::Count {
                        let written = map.next_value::<Spanned<Whole>>()?;
                        (written.span(), written.get_ref().0 as f64)
                    } else {
                        let written = map.next_value::<Spanned<Number>>()?;
                        (written.span(), written.get_ref().0)
                    };
                    table.numbers().push((setting, Spanned::new(span, value)));
                }
            }
        }
        Ok(table)
    }
}

impl<'de> Deserialize<'de> for Mount {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_map(TableReader(PhantomData))
    }
}

impl<'de> Deserialize<'de> for Segment {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_map(TableReader(PhantomData))
    }
}

/// `[record]`.
#[derive(serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Record {
    pub path: Spanned<String>,
    pub rotate_mb: Option<Spanned<Number>>,
    pub rotate_minutes: Option<Spanned<Number>>,
}

/// Values of `returns`.
#[derive(Clone, Copy, PartialEq, Eq, serde::Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Returns {
    Single,
    Dual,
}

/// Values of `return`.
#[derive(Clone, Copy, serde::Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum WhichReturn {
    Nearest,
    Strongest,
    Last,
}

/// Values of `method`.
#[derive(Clone, Copy, serde::Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Method {
    Slope,
    Paper,
}

/// A whole number; an error calls it that, and not by the name of a type.
#[derive(Clone, Copy)]
pub struct Whole(pub i64);

impl<'de> Deserialize<'de> for Whole {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Reader;
        impl Visitor<'_> for Reader {
            type Value = Whole;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("a whole number")
            }

            fn visit_i64<E: Error>(self, value: i64) -> Result<Whole, E> {
                Ok(Whole(value))
            }
        }
        deserializer.deserialize_i64(Reader)
    }
}

/// A number with a fraction or without.
#[derive(Clone, Copy)]
pub struct Number(pub f64);

impl<'de> Deserialize<'de> for Number {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Reader;
        impl Visitor<'_> for Reader {
            type Value = Number;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("a number")
            }

            fn visit_f64<E: Error>(self, value: f64) -> Result<Number, E> {
                Ok(Number(value))
            }

            fn visit_i64<E: Error>(self, value: i64) -> Result<Number, E> {
                Ok(Number(value as f64))
            }
        }
        deserializer.deserialize_f64(Reader)
    }
}

/// All `[[sensor]]`; an error says that these take two brackets.
#[derive(Default)]
pub struct Sensors(pub Vec<Spanned<Sensor>>);

impl<'de> Deserialize<'de> for Sensors {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Reader;
        impl<'de> Visitor<'de> for Reader {
            type Value = Sensors;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("one [[sensor]], in double brackets, for each sensor")
            }

            fn visit_seq<A: SeqAccess<'de>>(self, mut tables: A) -> Result<Sensors, A::Error> {
                let mut sensors = Vec::new();
                while let Some(sensor) = tables.next_element()? {
                    sensors.push(sensor);
                }
                Ok(Sensors(sensors))
            }
        }
        deserializer.deserialize_seq(Reader)
    }
}
