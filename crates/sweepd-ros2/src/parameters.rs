//! The parameters of the node: YAML in the form of ROS, and `-p NAME:=VALUE` of a launch file.
//!
//! ```yaml
//! /**:
//!   ros__parameters:
//!     stamp: first
//!     roof: {frame_id: lidar_top}
//! ```

mod yaml;

use std::collections::BTreeMap;
use std::io;
use std::net::SocketAddr;
use std::path::{Path, PathBuf};

use serde_saphyr::Spanned;
use sweepd_client::service::{NAME_RULE, is_sensor_name};

use sweepd_messages::rcl::Value;
use sweepd_messages::{Fields, Layout, MessageHeader, Motion, Slice, Stamp, scan};
use sweepd_ros2::args::Args;
use sweepd_sweep::layout::flags;
use sweepd_sweep::{Header, Pose, SweepRef};

use crate::names::NodeName;
use crate::odometry::Source as OdometrySource;
use crate::ros_args::{RosArgs, Source};
use crate::{EX_CONFIG, EX_NOINPUT};
pub use yaml::ParameterError;
use yaml::{
    Tree, choice, find_sections, names, number, optional, place, read_tree, switch, text, texts,
    tree,
};

/// Where the daemon answers unless its configuration says otherwise.
const DAEMON_HTTP: &str = "127.0.0.1:9177";
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
    /// `Some(None)` is no ring, also where one is given for all.
    scan_ring: Option<Option<u16>>,
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
                exit: EX_CONFIG,
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
            slice: match given.scan_ring.flatten() {
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

    /// Sets a parameter of [`Parameters::names`] while the node runs. One that is read at the start may be set
    /// to the value that it has: a file with all parameters is for the running node, too.
    ///
    /// # Errors
    /// A sentence: what a file would be told, or that it is read at the start.
    pub fn set_running(&mut self, name: &str, value: &Value) -> Result<(), String> {
        if Self::is_fixed(name) {
            let mut set = self.clone();
            let is_taken = set.take_one(name, &tree(value)).is_ok();
            return match is_taken && set.value(name) == self.value(name) {
                true => Ok(()),
                false => Err(format!(
                    "`{name}` is read at the start: give it in the parameter file, and start again"
                )),
            };
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
            Err(error) => {
                // As `sweepd` says it. Other faults may pass.
                let (cure, exit) = match error.kind() {
                    io::ErrorKind::NotFound | io::ErrorKind::NotADirectory => {
                        ("; check the path", EX_NOINPUT)
                    }
                    io::ErrorKind::IsADirectory => ("; give a file in it", EX_NOINPUT),
                    io::ErrorKind::PermissionDenied => ("; allow this user to read it", EX_NOINPUT),
                    _ => ("", 1),
                };
                Err(ParameterError {
                    place,
                    what: format!("cannot be read: {error}{cure}"),
                    exit,
                })
            }
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
                        exit: EX_CONFIG,
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
            "scan_ring" => self.scan_ring = Some(ring(value)?),
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
            "scan_ring" => Value::Integer(self.scan_ring.flatten().map_or(-1, i64::from)),
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
        "scan_ring" => "scan is of one beam, numbered from the lowest up, from 0; -1: of the band",
        _ => "",
    }
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

/// A beam, or none: -1, so that the parameter always has a value, which tools of ROS can write to a file and set.
fn ring(value: &Spanned<Tree>) -> Result<Option<u16>, String> {
    match optional(value)?.as_deref() {
        None | Some("-1") => Ok(None),
        Some(_) => number(value).map(Some),
    }
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

/// A parameter file of anyone. A parameter can be set to the value that it has.
#[cfg(any(test, fuzzing))]
pub fn fuzz(input: &[u8]) {
    let Ok(text) = std::str::from_utf8(input) else {
        return;
    };
    let mut parameters = Parameters::default();
    let node = NodeName::new("/robot", "sweepd");
    match parameters
        .parse(text, "fuzz", &node)
        .and_then(|()| parameters.judge())
    {
        Ok(()) => {
            for name in Parameters::names(["roof"].into_iter()) {
                let value = parameters.value(&name);
                let set = parameters.clone().set_running(&name, &value);
                assert_eq!(set, Ok(()), "{name}: {value:?}");
            }
        }
        Err(error) => assert!(!error.place.is_empty() && !error.what.is_empty()),
    }
}

#[cfg(test)]
mod tests;
