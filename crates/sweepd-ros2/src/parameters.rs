//! The parameters of the node: YAML in the form of ROS, and `-p NAME:=VALUE` of a launch file.
//!
//! ```yaml
//! /**:
//!   ros__parameters:
//!     stamp: first
//!     roof: {frame_id: lidar_top}
//! ```

use std::collections::BTreeMap;
use std::fmt;
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::str::FromStr;

use serde::Deserialize;
use serde::de::{Deserializer, MapAccess, SeqAccess, Visitor};
use serde_saphyr::options::{DuplicateKeyPolicy, NonFiniteFloatPolicy};
use serde_saphyr::{Location, Spanned, UserMessageFormatter};
use sweepd_client::service::{NAME_RULE, is_sensor_name};

use sweepd_messages::rcl::Value;
use sweepd_messages::{Fields, Layout, MessageHeader, Motion, Slice, Stamp, scan};
use sweepd_ros2::args::Args;
use sweepd_sweep::layout::flags;
use sweepd_sweep::{Header, Pose, SweepRef};

use crate::names::NodeName;
use crate::odometry::Source as OdometrySource;
use crate::ros_args::{RosArgs, Source};

/// Where the daemon answers unless its configuration says otherwise.
const DAEMON_HTTP: &str = "127.0.0.1:9177";
/// The key above the parameters of a node.
const SECTION: &str = "ros__parameters";
/// Parameters of the node.
const OF_NODE: [&str; 7] = [
    "sensors",
    "root",
    "health",
    "base_frame",
    "deskew",
    "odometry",
    "clock",
];
/// Parameters of a sensor; given for the node, they hold for all sensors.
const OF_SENSOR: [&str; 9] = [
    "frame_id",
    "stamp",
    "organized",
    "layout",
    "fields",
    "only_complete",
    "min_columns",
    "scan_heights",
    "scan_ring",
];
/// Heights of the band of a scan, metres: from below the robot's frame, which may be that of its axles,
/// to above its head.
pub const SCAN_HEIGHTS_M: [f32; 2] = [-0.5, 2.0];

/// What the node does.
#[derive(Clone, Debug, PartialEq)]
pub struct Parameters {
    /// Sensors that are published; empty: all of the domain.
    pub sensors: Vec<String>,
    /// Folder by which the daemon is found, if it is not the default one.
    pub root: Option<PathBuf>,
    /// Where the daemon is asked for its health, if it is.
    pub health: Option<SocketAddr>,
    /// Frame of the robot, the parent of the sensors' frames; empty: no transforms.
    pub base_frame: String,
    /// What tells where the robot is, so that sweeps are deskewed.
    pub deskew: Option<OdometrySource>,
    /// Topic of [`OdometrySource::Odometry`].
    pub odometry: String,
    /// Whether the sweeps are a replay's, whose time `/clock` is to tell.
    pub clock: bool,
    /// Sentences about what was given and means nothing here.
    pub ignored: Vec<String>,
    /// Wrong values by the name before them: of a sensor, or of something of another node.
    wrong: Vec<(String, ParameterError)>,
    of_all: Given,
    of_each: BTreeMap<String, Given>,
}

/// How a sensor is published.
#[derive(Clone, Debug, PartialEq)]
pub struct SensorParameters {
    /// Frame of its messages.
    pub frame_id: String,
    /// Whose time is the time of a cloud.
    pub stamp: Stamp,
    /// Whether a cloud has rows and columns, with NaN where there is no return.
    pub organized: bool,
    /// What a point holds.
    pub layout: Layout,
    /// Whether sweeps that are no whole turn are left out.
    pub only_complete: bool,
    /// Sweeps with fewer measured columns are left out.
    pub min_columns: u32,
    /// What is in a scan.
    pub slice: Slice,
    /// Frame of the robot; empty where there is none.
    base_frame: String,
}

/// What a point holds, as it is written in a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum LayoutName {
    /// `fields` says which.
    Xyzirt,
    Autoware,
}

/// The parameters of a sensor, as far as they were given.
#[derive(Clone, Debug, Default, PartialEq)]
struct Given {
    frame_id: Option<String>,
    stamp: Option<Stamp>,
    organized: Option<bool>,
    layout: Option<LayoutName>,
    fields: Option<Fields>,
    only_complete: Option<bool>,
    min_columns: Option<u32>,
    scan_heights: Option<[f32; 2]>,
    scan_ring: Option<u16>,
}

/// Parameters that cannot be.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{place}: {what}")]
pub struct ParameterError {
    /// The file and the line, or the argument.
    place: String,
    what: String,
}

/// A value of YAML. Scalars are text: each parameter knows what it may be.
#[derive(Clone, Debug)]
enum Tree {
    Scalar(String),
    List(Vec<Spanned<Tree>>),
    Map(Vec<(Spanned<String>, Spanned<Tree>)>),
}

impl Default for Parameters {
    fn default() -> Self {
        Self {
            sensors: Vec::new(),
            root: None,
            health: DAEMON_HTTP.parse().ok(),
            base_frame: "base_link".to_owned(),
            deskew: None,
            odometry: "odom".to_owned(),
            clock: false,
            ignored: Vec::new(),
            wrong: Vec::new(),
            of_all: Given::default(),
            of_each: BTreeMap::new(),
        }
    }
}

impl Parameters {
    /// What a command line says for the node, and the files that it names: the last counts.
    ///
    /// # Errors
    /// [`ParameterError`].
    pub fn of_command_line(
        args: &Args,
        ros: &RosArgs,
        node: &NodeName,
    ) -> Result<Self, ParameterError> {
        let mut parameters = Self::default();
        let file = args.parameters.clone().map(Source::File);
        for source in file.iter().chain(&ros.parameters) {
            match source {
                Source::File(path) => parameters.read(path, node)?,
                Source::One {
                    node: Some(other), ..
                } if *other != node.name => {}
                Source::One { name, value, .. } => parameters.set(name, value)?,
            }
        }
        if !args.sensors.is_empty() {
            parameters.sensors.clone_from(&args.sensors);
        }
        if args.root.is_some() {
            parameters.root.clone_from(&args.root);
        }
        parameters.judge()?;
        Ok(parameters)
    }

    /// A wrong value of a sensor that is named ends the node. Else it may be of another node, as in a file
    /// for many: it is told. What cannot work together ends it, too.
    fn judge(&mut self) -> Result<(), ParameterError> {
        for (sensor, error) in std::mem::take(&mut self.wrong) {
            if self.sensors.contains(&sensor) {
                return Err(error);
            }
            self.ignored.push(error.to_string());
        }
        if self.deskew == Some(OdometrySource::Transforms) && self.base_frame.is_empty() {
            return Err(ParameterError {
                place: "`deskew: tf` with an empty `base_frame`".to_owned(),
                what: "it needs the name of the robot's frame in /tf, as `base_link`".to_owned(),
            });
        }
        Ok(())
    }

    /// The parameters of a sensor.
    pub fn of(&self, sensor: &str) -> SensorParameters {
        let given = self.given(sensor);
        let fields = given.fields.unwrap_or(Fields::ALL);
        SensorParameters {
            frame_id: given.frame_id.unwrap_or_else(|| sensor.to_owned()),
            stamp: given.stamp.unwrap_or(Stamp::First),
            organized: given.organized.unwrap_or(false),
            layout: match given.layout {
                Some(LayoutName::Autoware) => Layout::Autoware,
                Some(LayoutName::Xyzirt) | None => Layout::Fields(fields),
            },
            only_complete: given.only_complete.unwrap_or(true),
            min_columns: given.min_columns.unwrap_or(0),
            slice: match given.scan_ring {
                Some(ring) => Slice::Ring(ring),
                None => Slice::Heights(given.scan_heights.unwrap_or(SCAN_HEIGHTS_M)),
            },
            base_frame: self.base_frame.clone(),
        }
    }

    /// What was given for a sensor, or for all.
    fn given(&self, sensor: &str) -> Given {
        let all = &self.of_all;
        let own = self.of_each.get(sensor).unwrap_or(all);
        Given {
            frame_id: own.frame_id.clone().or_else(|| all.frame_id.clone()),
            stamp: own.stamp.or(all.stamp),
            organized: own.organized.or(all.organized),
            layout: own.layout.or(all.layout),
            fields: own.fields.or(all.fields),
            only_complete: own.only_complete.or(all.only_complete),
            min_columns: own.min_columns.or(all.min_columns),
            scan_heights: own.scan_heights.or(all.scan_heights),
            scan_ring: own.scan_ring.or(all.scan_ring),
        }
    }

    /// The names of all parameters, with those of these sensors.
    pub fn names<'a>(sensors: impl Iterator<Item = &'a str>) -> Vec<String> {
        let mut names: Vec<String> = OF_NODE
            .iter()
            .chain(&OF_SENSOR)
            .map(|name| (*name).into())
            .collect();
        for sensor in sensors {
            names.extend(OF_SENSOR.iter().map(|own| format!("{sensor}.{own}")));
        }
        names
    }

    /// The value of a parameter, its default where it was not given.
    pub fn value(&self, name: &str) -> Value {
        let text = |value: Option<String>| Value::Text(value.unwrap_or_default());
        match name {
            "sensors" => Value::Texts(self.sensors.clone()),
            "root" => text(self.root.as_ref().map(|root| root.display().to_string())),
            "health" => text(self.health.map(|address| address.to_string())),
            "base_frame" => Value::Text(self.base_frame.clone()),
            "deskew" => text(self.deskew.map(|source| source.name().to_owned())),
            "odometry" => Value::Text(self.odometry.clone()),
            "clock" => Value::Bool(self.clock),
            _ => match name.rsplit_once('.') {
                Some((sensor, "frame_id")) => Value::Text(self.of(sensor).frame_id),
                Some((sensor, own)) => self.given(sensor).value(own),
                None => self.of_all.value(name),
            },
        }
    }

    /// Whether a parameter is read at the start alone.
    pub fn is_fixed(name: &str) -> bool {
        // Frames are in /tf_static, which others keep.
        OF_NODE.contains(&name) || own_name(name) == "frame_id"
    }

    /// Sets a parameter of [`Parameters::names`] while the node runs.
    ///
    /// # Errors
    /// A sentence: what a file would be told, or that it is read at the start.
    pub fn set_running(&mut self, name: &str, value: &Value) -> Result<(), String> {
        if Self::is_fixed(name) {
            return Err(format!(
                "`{name}` is read at the start: give it in the parameter file, and start again"
            ));
        }
        match self.take_one(name, &tree(value)) {
            Ok(_) => Ok(()),
            Err(what) => Err(format!("`{name}`: {what}")),
        }
    }

    /// Takes what a file says for the node.
    ///
    /// # Errors
    /// [`ParameterError`]: it cannot be read, or is wrong.
    fn read(&mut self, file: &Path, node: &NodeName) -> Result<(), ParameterError> {
        let place = file.display().to_string();
        match std::fs::read_to_string(file) {
            Ok(text) => self.parse(&text, &place, node),
            Err(error) => Err(ParameterError {
                place,
                what: format!("cannot be read: {error}"),
            }),
        }
    }

    /// Takes what the text of a file says for the node.
    fn parse(&mut self, text: &str, file: &str, node: &NodeName) -> Result<(), ParameterError> {
        let tree = read_tree(text, file)?;
        let mut sections = Vec::new();
        find_sections(&tree, "", file, &mut sections)?;
        let full = node.full();
        let (meant, others): (Vec<_>, Vec<_>) = sections
            .into_iter()
            .partition(|(name, _)| names(name, &full));
        if meant.is_empty() {
            let others: Vec<String> = others.iter().map(|(name, _)| format!("`{name}`")).collect();
            self.ignored.push(match others.is_empty() {
                true => format!("{file}: no parameters"),
                false => format!(
                    "{file}: nothing for the node {full}, only for {}",
                    others.join(", ")
                ),
            });
        }
        // Else all of it is comments.
        let filled = meant
            .iter()
            .filter(|(_, section)| matches!(section.value, Tree::Map(_)));
        for (_, section) in filled {
            self.take("", section, file)?;
        }
        Ok(())
    }

    /// Takes one parameter: its name, with dots within, and its value as YAML.
    ///
    /// # Errors
    /// [`ParameterError`].
    fn set(&mut self, name: &str, value: &str) -> Result<(), ParameterError> {
        let place = format!("-p {name}:={value}");
        let tree = read_tree(value, &place)?;
        self.take(name, &tree, &place)
    }

    /// Takes a parameter, or all below a name: `{roof: {stamp: last}}` is `roof.stamp`.
    fn take(
        &mut self,
        name: &str,
        value: &Spanned<Tree>,
        file: &str,
    ) -> Result<(), ParameterError> {
        let Tree::Map(pairs) = &value.value else {
            return match self.take_one(name, value) {
                Ok(true) => Ok(()),
                Ok(false) => {
                    self.ignore(name, &place(file, value.referenced));
                    Ok(())
                }
                Err(what) => {
                    let error = ParameterError {
                        place: place(file, value.referenced),
                        what: format!("`{name}`: {what}"),
                    };
                    let Some((sensor, _)) = name.rsplit_once('.') else {
                        return Err(error);
                    };
                    self.wrong.push((sensor.to_owned(), error));
                    Ok(())
                }
            };
        };
        for (key, value) in pairs {
            let name = match name {
                "" => key.value.clone(),
                above => format!("{above}.{}", key.value),
            };
            self.take(&name, value, file)?;
        }
        Ok(())
    }

    /// Takes a parameter, if it is known.
    fn take_one(&mut self, name: &str, value: &Spanned<Tree>) -> Result<bool, String> {
        match name {
            "sensors" => self.sensors = sensors(value)?,
            "root" => self.root = optional(value)?.map(PathBuf::from),
            "health" => self.health = health(value)?,
            "base_frame" => self.base_frame = text(value)?,
            "deskew" => self.deskew = deskew(value)?,
            "odometry" => self.odometry = text(value)?,
            "clock" => self.clock = switch(value)?,
            // Launch files set it for all nodes. A live sensor has no simulated clock.
            "use_sim_time" => drop(switch(value)?),
            _ => match name.rsplit_once('.') {
                Some((sensor, own)) if OF_SENSOR.contains(&own) => {
                    let of_one = self.of_each.entry(sensor.to_owned()).or_default();
                    of_one.take(own, value)?;
                }
                None if OF_SENSOR.contains(&name) => self.of_all.take(name, value)?,
                _ => return Ok(false),
            },
        }
        Ok(true)
    }

    /// Notes a parameter that means nothing here: in ROS, files and launch files are for many nodes.
    fn ignore(&mut self, name: &str, place: &str) {
        let what = match name.split_once('.') {
            Some(("qos_overrides", _)) => "the qualities of publishers are fixed".to_owned(),
            Some(_) => format!("of a sensor are known {}", OF_SENSOR.join(", ")),
            None => format!("known are {}, {}", OF_NODE.join(", "), OF_SENSOR.join(", ")),
        };
        self.ignored
            .push(format!("{place}: unknown parameter `{name}`: {what}"));
    }
}

impl SensorParameters {
    /// Whether a sweep with this header is published.
    pub fn takes(&self, header: &Header) -> bool {
        let is_complete = !header.has(flags::PARTIAL);
        let not_measured = header
            .missing_columns
            .saturating_add(header.unfired_columns);
        let measured = header.columns.saturating_sub(not_measured);
        (is_complete || !self.only_complete) && measured >= self.min_columns
    }

    /// Whether a scan is in the frame of the robot: a band of heights, where the daemon says where the sensor
    /// sits. Else it is in the sensor's.
    pub fn scans_for_robot(&self, header: &Header) -> bool {
        matches!(self.slice, Slice::Heights(_))
            && Pose::of_mount(header).is_given()
            && !self.base_frame.is_empty()
    }

    /// Appends the scan of a sweep, deskewed by a motion.
    pub fn scan(&self, sweep: &SweepRef<'_>, motion: Option<&Motion>, message: &mut Vec<u8>) {
        let mount = Pose::of_mount(sweep.header);
        let (pose, frame_id) = match self.scans_for_robot(sweep.header) {
            true => (Some(&mount), &self.base_frame),
            false => (None, &self.frame_id),
        };
        let stamp = self.stamp;
        let header = MessageHeader { frame_id, stamp };
        scan::encode(sweep, self.slice, pose, motion, &header, message);
    }
}

impl Given {
    /// Takes one of [`OF_SENSOR`].
    fn take(&mut self, name: &str, value: &Spanned<Tree>) -> Result<(), String> {
        match name {
            "frame_id" => self.frame_id = optional(value)?,
            "stamp" => {
                let stamps = [
                    ("first", Stamp::First),
                    ("middle", Stamp::Middle),
                    ("last", Stamp::Last),
                ];
                self.stamp = Some(choice(value, &stamps)?);
            }
            "organized" => self.organized = Some(switch(value)?),
            "layout" => {
                let layouts = [
                    ("xyzirt", LayoutName::Xyzirt),
                    ("autoware", LayoutName::Autoware),
                ];
                self.layout = Some(choice(value, &layouts)?);
            }
            "fields" => self.fields = Some(fields(value)?),
            "only_complete" => self.only_complete = Some(switch(value)?),
            "min_columns" => self.min_columns = Some(number(value)?),
            "scan_heights" => self.scan_heights = Some(heights(value)?),
            "scan_ring" => {
                let is_given = optional(value)?.is_some();
                self.scan_ring = is_given.then(|| number(value)).transpose()?;
            }
            _ => unreachable!("{name} is none of {OF_SENSOR:?}"),
        }
        Ok(())
    }

    /// The value of one of [`OF_SENSOR`], its default where it was not given.
    fn value(&self, name: &str) -> Value {
        match name {
            "frame_id" => Value::Text(self.frame_id.clone().unwrap_or_default()),
            "stamp" => Value::Text(match self.stamp {
                Some(Stamp::Last) => "last".to_owned(),
                Some(Stamp::Middle) => "middle".to_owned(),
                Some(Stamp::First) | None => "first".to_owned(),
            }),
            "organized" => Value::Bool(self.organized.unwrap_or(false)),
            "layout" => Value::Text(match self.layout {
                Some(LayoutName::Autoware) => "autoware".to_owned(),
                Some(LayoutName::Xyzirt) | None => "xyzirt".to_owned(),
            }),
            "fields" => {
                let fields = self.fields.unwrap_or(Fields::ALL);
                let all = [
                    ("x", true),
                    ("y", true),
                    ("z", true),
                    ("intensity", fields.intensity),
                    ("ring", fields.ring),
                    ("time", fields.time),
                    ("label", fields.label),
                ];
                let there = all.iter().filter(|(_, is_there)| *is_there);
                Value::Texts(there.map(|(name, _)| (*name).to_owned()).collect())
            }
            "only_complete" => Value::Bool(self.only_complete.unwrap_or(true)),
            "min_columns" => Value::Integer(self.min_columns.unwrap_or(0).into()),
            "scan_heights" => {
                let heights_m = self.scan_heights.unwrap_or(SCAN_HEIGHTS_M);
                // As they were written.
                let written = heights_m
                    .iter()
                    .flat_map(|height| height.to_string().parse());
                Value::Doubles(written.collect())
            }
            "scan_ring" => {
                (self.scan_ring).map_or(Value::NotSet, |ring| Value::Integer(ring.into()))
            }
            _ => Value::NotSet,
        }
    }
}

/// The name of a sensor's parameter without the sensor.
fn own_name(name: &str) -> &str {
    name.rsplit_once('.').map_or(name, |(_, own)| own)
}

/// What a parameter is, for people.
pub fn description(name: &str) -> &'static str {
    match own_name(name) {
        "sensors" => "names of the sensors to publish; empty: all",
        "root" => "folder by which the daemon is found; empty: the usual one",
        "health" => "where the daemon's /health is; empty: nowhere",
        "base_frame" => "parent in /tf_static; empty: no transforms",
        "deskew" => "what tells where the robot is, for deskewed topics: odom, tf; empty: nothing",
        "odometry" => "topic that deskew: odom reads",
        "clock" => "/clock tells the time of the sweeps, as of a replay",
        "frame_id" => "frame of the sensor's messages",
        "stamp" => "time of a message in its sweep: first, middle, last",
        "organized" => "rows and columns, NaN where there is no return",
        "layout" => "what a point holds: xyzirt, autoware",
        "fields" => "fields of xyzirt; x, y and z are always there",
        "only_complete" => "leave out sweeps that are no whole turn",
        "min_columns" => "leave out sweeps with fewer measured columns",
        "scan_heights" => "the band of scan, metres, the lower one first",
        "scan_ring" => "scan is of one beam, numbered from the lowest up, from 0",
        _ => "",
    }
}

/// A value as it would stand in a file.
fn tree(value: &Value) -> Spanned<Tree> {
    fn scalar(value: impl ToString) -> Spanned<Tree> {
        spanned(Tree::Scalar(value.to_string()))
    }
    fn spanned(tree: Tree) -> Spanned<Tree> {
        Spanned::new(tree, Location::UNKNOWN, Location::UNKNOWN)
    }
    fn list(values: &[impl ToString]) -> Spanned<Tree> {
        spanned(Tree::List(
            values
                .iter()
                .map(|value| scalar(value.to_string()))
                .collect(),
        ))
    }
    match value {
        Value::NotSet => scalar(""),
        Value::Bool(value) => scalar(value),
        Value::Integer(value) => scalar(value),
        Value::Double(value) => scalar(value),
        Value::Text(value) => scalar(value),
        Value::Bytes(values) => list(values),
        Value::Bools(values) => list(values),
        Value::Integers(values) => list(values),
        Value::Doubles(values) => list(values),
        Value::Texts(values) => list(values),
    }
}

/// A line of a file, or an argument, which is one line.
fn place(file: &str, location: Location) -> String {
    match file.starts_with("-p ") {
        true => file.to_owned(),
        false => format!("{file}:{}", location.line().max(1)),
    }
}

fn text(value: &Spanned<Tree>) -> Result<String, String> {
    match &value.value {
        Tree::Scalar(text) => Ok(text.clone()),
        _ => Err("expected one value".to_owned()),
    }
}

/// A text; nothing where it is empty.
fn optional(value: &Spanned<Tree>) -> Result<Option<String>, String> {
    Ok(Some(text(value)?).filter(|text| !text.is_empty()))
}

fn texts(value: &Spanned<Tree>) -> Result<Vec<String>, String> {
    match &value.value {
        Tree::List(values) => values.iter().map(text).collect(),
        _ => Err("expected a list, `[a, b]`".to_owned()),
    }
}

/// The words are those of YAML 1.1, as in ROS.
fn switch(value: &Spanned<Tree>) -> Result<bool, String> {
    match &text(value)?.to_ascii_lowercase()[..] {
        "true" | "yes" | "y" | "on" => Ok(true),
        "false" | "no" | "n" | "off" => Ok(false),
        other => Err(format!("expected true or false, not `{other}`")),
    }
}

fn number<T: FromStr>(value: &Spanned<Tree>) -> Result<T, String> {
    let text = text(value)?;
    let number = text.parse();
    number.map_err(|_| format!("expected a whole number from 0 on, not `{text}`"))
}

/// Two heights, metres, the lower one first.
fn heights(value: &Spanned<Tree>) -> Result<[f32; 2], String> {
    let texts = texts(value)?;
    let numbers: Vec<f32> = texts.iter().flat_map(|text| text.parse()).collect();
    match numbers[..] {
        [low_m, high_m] if texts.len() == 2 && low_m < high_m => Ok([low_m, high_m]),
        _ => Err("expected two heights in metres, the lower one first: [-0.5, 2.0]".to_owned()),
    }
}

fn choice<T: Copy>(value: &Spanned<Tree>, choices: &[(&str, T)]) -> Result<T, String> {
    let text = text(value)?;
    if let Some((_, choice)) = choices.iter().find(|(name, _)| *name == text) {
        return Ok(*choice);
    }
    let names: Vec<&str> = choices.iter().map(|(name, _)| *name).collect();
    Err(format!("expected {}, not `{text}`", names.join(" or ")))
}

fn sensors(value: &Spanned<Tree>) -> Result<Vec<String>, String> {
    let sensors = texts(value)?;
    match sensors.iter().find(|one| !is_sensor_name(one)) {
        Some(odd) => Err(format!("`{odd}` is no name of a sensor: {NAME_RULE}")),
        None => Ok(sensors),
    }
}

fn health(value: &Spanned<Tree>) -> Result<Option<SocketAddr>, String> {
    let Some(address) = optional(value)? else {
        return Ok(None);
    };
    let wrong = |_| format!("expected IP:PORT such as {DAEMON_HTTP}, or nothing");
    address.parse().map(Some).map_err(wrong)
}

fn deskew(value: &Spanned<Tree>) -> Result<Option<OdometrySource>, String> {
    let sources = [OdometrySource::Odometry, OdometrySource::Transforms];
    let sources = sources.map(|source| (source.name(), source));
    let is_given = optional(value)?.is_some();
    is_given.then(|| choice(value, &sources)).transpose()
}

fn fields(value: &Spanned<Tree>) -> Result<Fields, String> {
    let names = texts(value)?;
    Fields::of_names(names.iter().map(String::as_str)).map_err(|error| error.to_string())
}

/// Finds the sections with parameters, and the names of the nodes that they are for.
fn find_sections<'a>(
    tree: &'a Spanned<Tree>,
    name: &str,
    file: &str,
    found: &mut Vec<(String, &'a Spanned<Tree>)>,
) -> Result<(), ParameterError> {
    let wrong = |location, what| {
        let place = place(file, location);
        Err(ParameterError { place, what })
    };
    let Tree::Map(pairs) = &tree.value else {
        return match &tree.value {
            // All of the file is comments.
            Tree::Scalar(text) if text.is_empty() && name.is_empty() => Ok(()),
            _ => wrong(
                tree.referenced,
                format!("no `{SECTION}`: a file begins with `/**:`, and below it `{SECTION}:`"),
            ),
        };
    };
    for (key, value) in pairs {
        let below = format!("{name}/{}", key.value.trim_start_matches('/'));
        match (&key.value[..], &value.value) {
            (SECTION, Tree::Map(_)) => found.push((name.to_owned(), value)),
            (SECTION, Tree::Scalar(text)) if text.is_empty() => {
                found.push((name.to_owned(), value))
            }
            (SECTION, _) => {
                return wrong(
                    value.referenced,
                    "expected parameters, `name: value`".to_owned(),
                );
            }
            _ => find_sections(value, &below, file, found)?,
        }
    }
    Ok(())
}

/// Whether a section's name means the node: `*` is one token, `**` any number of them.
fn names(section: &str, node: &str) -> bool {
    fn fit(section: &[&str], node: &[&str]) -> bool {
        match (section, node) {
            (["**", rest @ ..], _) => (0..=node.len()).any(|skipped| fit(rest, &node[skipped..])),
            ([token, rest @ ..], [own, others @ ..]) => {
                (*token == "*" || token == own) && fit(rest, others)
            }
            (rest, others) => rest.is_empty() && others.is_empty(),
        }
    }
    let tokens = |name| str::split(name, '/').filter(|token: &&str| !token.is_empty());
    let (section, node): (Vec<&str>, Vec<&str>) =
        (tokens(section).collect(), tokens(node).collect());
    fit(&section, &node)
}

fn read_tree(text: &str, file: &str) -> Result<Spanned<Tree>, ParameterError> {
    let options = serde_saphyr::options! {
        // Or the field `y` would be read as yes.
        strict_booleans: true,
        // As in ROS, where files have parameters of other nodes, too.
        duplicate_keys: DuplicateKeyPolicy::LastWins,
        non_finite_float_policy: NonFiniteFloatPolicy::PassThrough,
    };
    serde_saphyr::from_str_with_options(text, options).map_err(|error: serde_saphyr::Error| {
        let message = error
            .without_snippet()
            .render_with_formatter(&UserMessageFormatter);
        let message = message.lines().next().unwrap_or_default();
        let what = message
            .rsplit_once(" at line ")
            .map_or(message, |(what, _)| what);
        ParameterError {
            place: place(file, error.location().unwrap_or(Location::UNKNOWN)),
            what: what.to_owned(),
        }
    })
}

impl<'de> Deserialize<'de> for Tree {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct AnyTree;

        impl<'de> Visitor<'de> for AnyTree {
            type Value = Tree;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("a value, a list or a map")
            }

            fn visit_unit<E>(self) -> Result<Tree, E> {
                Ok(Tree::Scalar(String::new()))
            }

            fn visit_bool<E>(self, value: bool) -> Result<Tree, E> {
                Ok(Tree::Scalar(value.to_string()))
            }

            fn visit_i64<E>(self, value: i64) -> Result<Tree, E> {
                Ok(Tree::Scalar(value.to_string()))
            }

            fn visit_u64<E>(self, value: u64) -> Result<Tree, E> {
                Ok(Tree::Scalar(value.to_string()))
            }

            fn visit_f64<E>(self, value: f64) -> Result<Tree, E> {
                Ok(Tree::Scalar(value.to_string()))
            }

            fn visit_str<E>(self, value: &str) -> Result<Tree, E> {
                Ok(Tree::Scalar(value.to_owned()))
            }

            fn visit_seq<A: SeqAccess<'de>>(self, mut seq: A) -> Result<Tree, A::Error> {
                let mut values = Vec::new();
                while let Some(value) = seq.next_element()? {
                    values.push(value);
                }
                Ok(Tree::List(values))
            }

            fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Tree, A::Error> {
                let mut pairs = Vec::new();
                while let Some(key) = map.next_key()? {
                    pairs.push((key, map.next_value()?));
                }
                Ok(Tree::Map(pairs))
            }
        }

        deserializer.deserialize_any(AnyTree)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use sweepd_sweep::Shape;

    fn node() -> NodeName {
        NodeName::new("/robot", "sweepd")
    }

    fn parse(text: &str) -> Result<Parameters, String> {
        let mut parameters = Parameters::default();
        let parsed = parameters.parse(text, "ros2.yaml", &node());
        parsed
            .and_then(|()| parameters.judge())
            .map_err(|error| error.to_string())
            .map(|()| parameters)
    }

    #[test]
    fn what_is_not_given_has_its_default() {
        let parameters = parse("/**:\n  ros__parameters: {}\n").unwrap();
        assert_eq!(parameters, Parameters::default());
        assert_eq!(parameters.health, Some("127.0.0.1:9177".parse().unwrap()));
        let expected = SensorParameters {
            frame_id: "roof".to_owned(),
            stamp: Stamp::First,
            organized: false,
            layout: Layout::Fields(Fields::ALL),
            only_complete: true,
            min_columns: 0,
            slice: Slice::Heights([-0.5, 2.0]),
            base_frame: "base_link".to_owned(),
        };
        assert_eq!(parameters.of("roof"), expected);
    }

    #[test]
    fn the_example_has_the_defaults_and_every_name() {
        let example = include_str!("../../../systemd/ros2.yaml");
        assert_eq!(parse(example).unwrap(), Parameters::default());
        for name in OF_NODE.iter().chain(&OF_SENSOR) {
            assert!(
                example.contains(&format!(" {name}: ")) || example.contains(&format!("#{name}: "))
            );
        }
        // Prose has one space behind its #.
        let is_prose = |line: &&str| {
            let prose = line.trim_start().strip_prefix("# ");
            prose.is_some_and(|prose| !prose.starts_with(' '))
        };
        let lines = example.lines().filter(|line| !is_prose(line));
        let lines: Vec<String> = lines.map(|line| line.replacen('#', "", 1)).collect();
        let parameters = parse(&lines.join("\n")).unwrap();
        assert_eq!(parameters.of("roof"), Parameters::default().of("roof"));
        assert_eq!(parameters.sensors, ["roof"]);
        let expected = Parameters::default();
        assert_eq!(
            (parameters.health, parameters.base_frame),
            (expected.health, expected.base_frame)
        );
    }

    #[test]
    fn a_sensor_has_its_own_and_what_holds_for_all() {
        let text = "
/robot/sweepd:
  ros__parameters:
    sensors: [roof, front-left]
    root: /run/x
    health: ''
    base_frame: base
    deskew: odom
    odometry: /wheels
    use_sim_time: true
    stamp: last
    fields: [x, y, z]
    roof:
      frame_id: lidar_top
      organized: true
      layout: autoware
      min_columns: 1600
    front-left.stamp: first
";
        let parameters = parse(text).unwrap();
        assert_eq!(parameters.sensors, ["roof", "front-left"]);
        assert_eq!(parameters.root, Some(PathBuf::from("/run/x")));
        assert_eq!(
            (parameters.health, &parameters.base_frame[..]),
            (None, "base")
        );
        assert_eq!(
            (parameters.deskew, &parameters.odometry[..]),
            (Some(OdometrySource::Odometry), "/wheels")
        );
        let (roof, front) = (parameters.of("roof"), parameters.of("front-left"));
        assert_eq!((roof.stamp, front.stamp), (Stamp::Last, Stamp::First));
        assert_eq!((roof.organized, front.organized), (true, false));
        assert_eq!((roof.min_columns, front.min_columns), (1600, 0));
        let layouts = (Layout::Autoware, Layout::Fields(Fields::NONE));
        assert_eq!((roof.layout, front.layout), layouts);
        assert_eq!(
            (&roof.frame_id[..], &front.frame_id[..]),
            ("lidar_top", "front-left")
        );
    }

    #[test]
    fn sweeps_are_taken_by_their_turn_and_their_measured_columns() {
        let mut header = Header::new(&Shape {
            rows: 16,
            columns_capacity: 100,
            dual: false,
            segments_capacity: 0,
        });
        (
            header.columns,
            header.missing_columns,
            header.unfired_columns,
        ) = (100, 20, 10);
        for (parameters, whole, part) in [
            ("stamp: first", true, false),
            ("only_complete: false", true, true),
            ("min_columns: 70", true, false),
            ("min_columns: 71", false, false),
            ("{only_complete: false, min_columns: 70}", true, true),
        ] {
            let parameters = parse(&format!("/**:\n  ros__parameters:\n    {parameters}\n"));
            let roof = parameters.unwrap().of("roof");
            for (bits, is_taken) in [(flags::CIRCULAR, whole), (flags::PARTIAL, part)] {
                header.flags = bits;
                assert_eq!(roof.takes(&header), is_taken, "{roof:?}");
            }
        }
    }

    #[test]
    fn sections_mean_nodes_as_in_ros() {
        for (section, is_meant) in [
            ("/**", true),
            ("/**/sweepd", true),
            ("/*/sweepd", true),
            ("/robot/*", true),
            ("/robot/sweepd", true),
            ("robot/sweepd", true),
            ("/robot/**/sweepd", true),
            ("/*", false),
            ("sweepd", false),
            ("/robot/sweepd/x", false),
            ("/other/sweepd", false),
        ] {
            assert_eq!(names(section, "/robot/sweepd"), is_meant, "{section}");
        }
        let nested = "/robot:\n  sweepd:\n    ros__parameters: {stamp: last}\n  camera:\n    ros__parameters: {rate: 3}\n";
        assert_eq!(parse(nested).unwrap().of("roof").stamp, Stamp::Last);
    }

    #[test]
    fn what_is_wrong_is_named_with_its_line_and_what_is_known() {
        for (parameters, line, part) in [
            (
                "stamp: centre",
                3,
                "`stamp`: expected first or middle or last, not `centre`",
            ),
            ("stamp: [last]", 3, "`stamp`: expected one value"),
            ("organized: 1", 3, "expected true or false, not `1`"),
            ("sensors: roof", 3, "expected a list"),
            ("sensors: [a/b]", 3, "`a/b` is no name of a sensor: letters"),
            ("health: nine", 3, "expected IP:PORT such as 127.0.0.1:9177"),
            (
                "fields: [x, colour]",
                3,
                "a point has no field \"colour\": fields are x, y, z, intensity, ring, time and label",
            ),
            ("layout: xyz", 3, "expected xyzirt or autoware"),
            ("scan_heights: [1, 0]", 3, "the lower one first"),
            ("scan_heights: [0, 1, x]", 3, "expected two heights"),
            ("scan_ring: top", 3, "expected a whole number"),
            (
                "min_columns: -1",
                3,
                "expected a whole number from 0 on, not `-1`",
            ),
            (
                "{sensors: [roof], roof: {stamp: x}}",
                3,
                "expected first or middle or last",
            ),
            ("deskew: imu", 3, "`deskew`: expected odom or tf, not `imu`"),
            ("stamp: {", 3, "unclosed bracket"),
        ] {
            let error =
                parse(&format!("/**:\n  ros__parameters:\n    {parameters}\n")).unwrap_err();
            assert!(
                error.starts_with(&format!("ros2.yaml:{line}: ")) && error.contains(part),
                "{error}"
            );
        }
        for (text, part) in [
            ("stamp: last", "ros2.yaml:1: no `ros__parameters`"),
            ("/**:\n  ros__parameters: 3", "expected parameters"),
            (
                "/**:\n  ros__parameters: {deskew: tf, base_frame: ''}",
                "`deskew: tf` with an empty `base_frame`: it needs the name",
            ),
        ] {
            assert!(
                parse(text).unwrap_err().contains(part),
                "{text}: {:?}",
                parse(text)
            );
        }
        let missing = Parameters::default().read(Path::new("/none.yaml"), &node());
        assert!(
            missing
                .unwrap_err()
                .to_string()
                .starts_with("/none.yaml: cannot be read: ")
        );
    }

    #[test]
    fn what_means_nothing_here_is_told_and_ends_nothing() {
        for (text, line, part) in [
            (
                "/**:\n  ros__parameters: {stmap: last}",
                "2",
                "unknown parameter `stmap`: known are sensors, root, health, base_frame, deskew, odometry, clock, frame_id, stamp",
            ),
            (
                "/**:\n  ros__parameters:\n    roof:\n      frame_id: a\n      rate: 3",
                "5",
                "unknown parameter `roof.rate`: of a sensor are known frame_id",
            ),
            (
                "/**:\n  ros__parameters: {qos_overrides: {/sweepd/roof/points: {publisher: {depth: 3}}}}",
                "2",
                "the qualities of publishers are fixed",
            ),
            (
                "/camera:\n  ros__parameters: {}",
                "",
                " nothing for the node /robot/sweepd, only for `/camera`",
            ),
            ("", "", " no parameters"),
            (
                "/**:\n  ros__parameters: {camera: {layout: rgb}}",
                "2",
                "`camera.layout`: expected xyzirt or autoware",
            ),
        ] {
            let ignored = parse(text).unwrap().ignored;
            let begin = format!("ros2.yaml:{line}");
            let is_told = ignored[0].starts_with(&begin) && ignored[0].contains(part);
            assert!(is_told && ignored.len() == 1, "{ignored:?}");
        }
    }

    #[test]
    fn what_a_client_gets_it_can_set() {
        let text = "
/robot/sweepd:
  ros__parameters:
    stamp: last
    fields: [x, y, z, ring]
    scan_heights: [0.1, 1]
    roof: {organized: true, layout: autoware, scan_ring: 3}
";
        let mut parameters = parse(text).unwrap();
        let before = parameters.of("roof");
        for name in Parameters::names(["roof"].into_iter()) {
            let value = parameters.value(&name);
            let set = parameters.set_running(&name, &value);
            assert_eq!(set.is_err(), Parameters::is_fixed(&name), "{name}: {set:?}");
            assert_eq!(parameters.value(&name), value);
            assert!(!description(&name).is_empty(), "{name}");
        }
        assert_eq!(parameters.of("roof"), before);
        let heights_m = Value::Doubles(vec![0.1, 1.0]);
        assert_eq!(parameters.value("roof.scan_heights"), heights_m);
        // As in a file, a list of whole numbers will do.
        let heights_m = Value::Integers(vec![0, 2]);
        assert_eq!(parameters.set_running("scan_heights", &heights_m), Ok(()));
        let wrong = parameters.set_running("roof.stamp", &Value::Bool(true));
        let words = "`roof.stamp`: expected first or middle or last, not `true`";
        assert_eq!(wrong, Err(words.to_owned()));
    }

    #[test]
    fn arguments_are_parameters_too() {
        let mut parameters = Parameters::default();
        for (name, value) in [
            ("stamp", "last"),
            ("roof.frame_id", "top"),
            ("sensors", "[roof]"),
            ("health", ""),
        ] {
            parameters.set(name, value).unwrap();
        }
        let roof = parameters.of("roof");
        assert_eq!((&roof.frame_id[..], roof.stamp), ("top", Stamp::Last));
        assert_eq!((parameters.sensors.len(), parameters.health), (1, None));
        for (name, value) in [("stamp", "x"), ("stamp", "[")] {
            let error = parameters.set(name, value).unwrap_err().to_string();
            assert!(
                error.starts_with(&format!("-p {name}:={value}: ")),
                "{error}"
            );
        }
    }
}
