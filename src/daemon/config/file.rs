//! A configuration file as it is written: keys and types, no values checked yet. A key is named
//! once, where it is read.

use std::ops::Range;

use toml::Spanned;
use toml::de::{DeTable, DeValue};

use super::error::Problem;
use super::table::{FormProblems, TableReader};
use sweepd_core::segment::Method;
use sweepd_core::segment::settings::{REMOVED, SETTINGS, Setting, Table, Unit};
use sweepd_core::sweep::layout::ReturnChoice;

/// Most problems of form that are shown.
const MAX_PROBLEMS: usize = 64;

/// A file as far as it could be read.
pub struct Reading {
    /// The file, without what is wrong in form or type.
    pub file: File,
    /// Unknown keys, missing keys and wrong types.
    pub problems: Vec<Problem>,
    /// Where something was passed over or stands for a required key: further problems of these
    /// places are no news.
    pub replaced: Vec<Range<usize>>,
    /// What is accepted and does nothing, for people.
    pub warnings: Vec<String>,
}

/// Reads a file past each unknown key, missing key and wrong type, so that all of them are found at
/// once.
///
/// # Errors
/// The problems, if what is left cannot be read: the first slip in the syntax, or too many
/// problems.
pub fn read(text: &str) -> Result<Reading, Vec<Problem>> {
    let table = DeTable::parse(text).map_err(|error| vec![Problem::of_toml(&error)])?;
    let mut form = FormProblems::new(text);
    let file = File::read(TableReader::of(table, &mut form));
    let FormProblems {
        mut problems,
        mut replaced,
        warnings,
        ..
    } = form;
    if problems.len() >= MAX_PROBLEMS {
        problems.sort_by_key(|problem| problem.at.start);
        problems.truncate(MAX_PROBLEMS);
        return Err(problems);
    }
    // That no sensor could be read says nothing of whether one is configured.
    if file.sensors.is_empty() && !problems.is_empty() {
        replaced.push(0..0);
    }
    Ok(Reading {
        file,
        problems,
        replaced,
        warnings,
    })
}

/// The whole file.
pub struct File {
    pub http: Option<Spanned<String>>,
    pub http_public: bool,
    pub root: Option<Spanned<String>>,
    pub sensors: Vec<Spanned<Sensor>>,
    pub record: Option<Record>,
}

impl File {
    fn read(mut table: TableReader<'_, '_, '_>) -> Self {
        let file = Self {
            http: table.text("http"),
            http_public: table.flag("http_public"),
            root: table.text("root"),
            sensors: Sensor::read_all(&mut table),
            record: table.table("record", Record::read),
        };
        table.finish();
        file
    }
}

/// A `[[sensor]]`.
pub struct Sensor {
    pub name: Spanned<String>,
    pub address: Spanned<String>,
    pub port: Option<Spanned<i64>>,
    pub position_port: Option<Spanned<i64>>,
    pub bind: Option<Spanned<String>>,
    pub multicast: Option<Spanned<String>>,
    pub interface: Option<Spanned<String>>,
    pub cpu: Option<Spanned<i64>>,
    pub realtime_priority: Option<Spanned<i64>>,
    pub model: Option<Spanned<String>>,
    pub calibration: Option<Spanned<String>>,
    /// Whether `returns` is `dual`.
    pub dual: Option<Spanned<bool>>,
    pub return_choice: Option<Spanned<ReturnChoice>>,
    pub cut_azimuth_deg: Option<Spanned<f64>>,
    pub gps_without_pps: bool,
    pub loss_warning_percent: Option<Spanned<f64>>,
    pub loss_fault_percent: Option<Spanned<f64>>,
    pub max_consumers: Option<Spanned<i64>>,
    pub objects_every_ms: Option<Spanned<i64>>,
    pub max_object_deg: Option<Spanned<f64>>,
    pub want: Want,
    pub mount: Mount,
    pub segment: Segment,
}

impl Sensor {
    fn read_all(file: &mut TableReader<'_, '_, '_>) -> Vec<Spanned<Self>> {
        let Some(value) = file.take("sensor") else {
            return Vec::new();
        };
        let DeValue::Array(tables) = value.get_ref() else {
            let expected = "one [[sensor]], in double brackets, for each sensor";
            file.problems().wrong_type(&value, expected);
            return Vec::new();
        };
        let mut sensors = Vec::new();
        for table in tables.iter() {
            if let Some(reader) = TableReader::new(table.clone(), file.problems()) {
                sensors.push(Spanned::new(table.span(), Self::read(reader)));
            }
        }
        sensors
    }

    fn read(mut table: TableReader<'_, '_, '_>) -> Self {
        let returns = [("single", false), ("dual", true)];
        let choices = [
            ("nearest", ReturnChoice::Nearest),
            ("strongest", ReturnChoice::Strongest),
            ("last", ReturnChoice::Last),
        ];
        let sensor = Self {
            name: table.required_text("name"),
            address: table.required_text("address"),
            port: table.whole("port"),
            position_port: table.whole("position_port"),
            bind: table.text("bind"),
            multicast: table.text("multicast"),
            interface: table.text("interface"),
            cpu: table.whole("cpu"),
            realtime_priority: table.whole("realtime_priority"),
            model: table.text("model"),
            calibration: table.text("calibration"),
            dual: table.choice("returns", &returns),
            return_choice: table.choice("return", &choices),
            cut_azimuth_deg: table.number("cut_azimuth_deg"),
            gps_without_pps: table.flag("gps_without_pps"),
            loss_warning_percent: table.number("loss_warning_percent"),
            loss_fault_percent: table.number("loss_fault_percent"),
            max_consumers: table.whole("max_consumers"),
            objects_every_ms: table.whole("objects_every_ms"),
            max_object_deg: table.number("max_object_deg"),
            want: table.table("want", Want::read).unwrap_or_default(),
            mount: table.table("mount", Mount::read).unwrap_or_default(),
            segment: table.table("segment", Segment::read).unwrap_or_default(),
        };
        table.finish();
        sensor
    }
}

/// `[sensor.want]`.
#[derive(Default)]
pub struct Want {
    pub rpm: Option<Spanned<i64>>,
    pub returns: Option<Spanned<String>>,
    pub fov: Option<Spanned<String>>,
    pub laser: Option<Spanned<String>>,
    pub host: Option<Spanned<String>>,
    pub phase_lock: Option<Spanned<String>>,
}

impl Want {
    fn read(mut table: TableReader<'_, '_, '_>) -> Self {
        let want = Self {
            rpm: table.whole("rpm"),
            returns: table.text("returns"),
            fov: table.text("fov"),
            laser: table.text("laser"),
            host: table.text("host"),
            phase_lock: table.text("phase_lock"),
        };
        table.finish();
        want
    }
}

/// `[sensor.mount]`.
#[derive(Default)]
pub struct Mount {
    pub x_m: Option<Spanned<f64>>,
    pub y_m: Option<Spanned<f64>>,
    pub z_m: Option<Spanned<f64>>,
    pub yaw_deg: Option<Spanned<f64>>,
    pub numbers: Numbers,
}

impl Mount {
    fn read(mut table: TableReader<'_, '_, '_>) -> Self {
        let mount = Self {
            x_m: table.number("x_m"),
            y_m: table.number("y_m"),
            z_m: table.number("z_m"),
            yaw_deg: table.number("yaw_deg"),
            numbers: numbers(&mut table, Table::Mount),
        };
        table.finish();
        mount
    }
}

/// `[sensor.segment]`.
#[derive(Default)]
pub struct Segment {
    pub method: Option<Spanned<Method>>,
    pub mask: Option<Spanned<String>>,
    pub numbers: Numbers,
}

impl Segment {
    fn read(mut table: TableReader<'_, '_, '_>) -> Self {
        let methods = [("slope", Method::Slope), ("paper", Method::Paper)];
        for removed in REMOVED {
            table.removed(removed.key, &removed.warning(removed.key));
        }
        let segment = Self {
            method: table.choice("method", &methods),
            mask: table.text("mask"),
            numbers: numbers(&mut table, Table::Segment),
        };
        table.finish();
        segment
    }
}

/// Numbers of [`SETTINGS`] that are written in a table.
pub type Numbers = Vec<(&'static Setting, Spanned<f64>)>;

fn numbers(table: &mut TableReader<'_, '_, '_>, of: Table) -> Numbers {
    let mut numbers = Vec::new();
    for setting in SETTINGS.iter().filter(|setting| setting.table == of) {
        let number = match setting.unit {
            Unit::Count => table
                .whole(setting.key)
                .map(|count| Spanned::new(count.span(), *count.get_ref() as f64)),
            _ => table.number(setting.key),
        };
        numbers.extend(number.map(|number| (setting, number)));
    }
    numbers
}

/// `[record]`.
pub struct Record {
    pub path: Spanned<String>,
    pub rotate_mb: Option<Spanned<f64>>,
    pub rotate_minutes: Option<Spanned<f64>>,
}

impl Record {
    fn read(mut table: TableReader<'_, '_, '_>) -> Self {
        let record = Self {
            path: table.required_text("path"),
            rotate_mb: table.number("rotate_mb"),
            rotate_minutes: table.number("rotate_minutes"),
        };
        table.finish();
        record
    }
}
