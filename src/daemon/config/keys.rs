//! All keys of the daemon's file, a row each, in the order of the example:
//!
//! ```text
//! /// its comment in the example
//! name = its example, its form and limits (what it sets), what a change takes and how it is shown;
//! ```
//!
//! From a row come reading, checks, what a reload says and does, and the example. What depends on
//! several keys is in `check`.

use std::fmt::Debug;
use std::net::{Ipv4Addr, SocketAddr, SocketAddrV4};
use std::ops::RangeInclusive;
use std::path::{Path, PathBuf};
use std::str::FromStr;

use super::key::{Form, Key, Refusal, ReloadRule, Table, Takes};
use super::{DaemonConfig, HTTP, RecordConfig, SensorConfig, possible_models};
use crate::files;
use crate::publish::{NAME_RULE, is_sensor_name};
use crate::sensor_settings::{FieldOfView, Host, PhaseLock, Returns, Rpm, Switch};
use crate::suggest::suggestion;
use crate::text::visible;
use sweepd_core::assemble::BodyBox;
use sweepd_core::segment::Method;
use sweepd_core::sensor::{Model, ModelExt};
use sweepd_core::sweep::layout::ReturnChoice;

const PORTS: RangeInclusive<i64> = 1..=u16::MAX as i64;
/// Shares of packets that may be missing, percent.
pub const LOSS_PERCENT: RangeInclusive<f64> = 0.1..=100.0;
/// Where a cover is seen, metres, and the share of returns that is few, percent.
const EYE_NEAR_M: RangeInclusive<f64> = 0.0..=10.0;
const EYE_PERCENT: RangeInclusive<f64> = 0.0..=90.0;
/// Distances from the origin of a robot, metres, and turns, degrees.
const POSITION_M: RangeInclusive<f64> = -100.0..=100.0;
const TURN_DEG: RangeInclusive<f64> = -360.0..=360.0;

/// A form, as a row has it.
macro_rules! form {
    (Flag() [$($place:tt)+]) => { Form::Flag(|to, flag| to.$($place)+ = flag) };
    (Whole($range:expr; $type:ty) [$($place:tt)+]) => {
        Form::Whole($range, |to, number| to.$($place)+ = (number as $type).into())
    };
    (Whole($range:expr, $convert:expr) [$($place:tt)+]) => {
        Form::Whole($range, |to, number| to.$($place)+ = $convert(number).into())
    };
    (Number($range:expr, $unit:literal, $convert:expr) [$($place:tt)+]) => {
        Form::Number($range, $unit, |to, number| to.$($place)+ = $convert(number))
    };
    (Words($($word:literal => $value:expr),+) $place:tt) => {
        Form::Words(&[$(($word, form!(Word($value) $place))),+])
    };
    (Word($value:expr) [$($place:tt)+]) => { |to| to.$($place)+ = $value.into() };
    (Text($convert:expr) [$($place:tt)+]) => {
        Form::Text(|to, text| {
            to.$($place)+ = $convert(text)?.into();
            Ok(())
        })
    };
    (Path() [$($place:tt)+]) => { Form::Path(|to, path| to.$($place)+ = Some(path)) };
    (Segmenter() []) => { Form::Segmenter };
    (Boxes() [$($place:tt)+]) => { Form::Boxes(|to, boxes| to.$($place)+ = boxes) };
    (Image($set:expr, [$($removes:tt)+]) $place:tt) => {
        Form::Image($set, |to, removes| to.$($removes)+ = removes)
    };
    ($form:ident($set:expr) $place:tt) => { Form::$form($set) };
}

/// What a reload compares: by default, what the key sets, called by its name.
macro_rules! rule {
    ($takes:ident $name:expr, $place:tt, ($other:literal $other_place:tt) $show:ident $none:tt) => {
        rule!($takes $other, $other_place, () $show $none)
    };
    ($takes:ident $name:expr, [$($place:tt)+], () $show:ident ($($none:literal)?)) => {
        ReloadRule {
            name: $name,
            takes: Takes::$takes,
            show: |of| $show($($none,)? &of.$($place)+),
            is_same: |a, b| a.$($place)+ == b.$($place)+,
            take: |to, from| to.$($place)+.clone_from(&from.$($place)+),
        }
    };
}

macro_rules! table {
    (
        $(#[doc = $head:literal])*
        $table:ident: $config:ty, $table_name:literal $header:literal
        $(
            $(#[doc = $doc:literal])*
            $name:ident = $example:tt, $form:ident $limits:tt $place:tt
            $(, $takes:ident $(<$other:literal $other_place:tt>)? $show:ident $($none:literal)?)*;
        )+
    ) => {
        pub static $table: Table<$config> = Table {
            name: $table_name,
            doc: &[$($head),*],
            header: $header,
            keys: &[$(Key {
                name: stringify!($name),
                doc: &[$($doc),*],
                example: stringify!($example),
                form: form!($form $limits $place),
                rules: &[$(rule!($takes stringify!($name), $place, ($($other $other_place)?) $show ($($none)?))),*],
            }),+],
        };
    };
}

table! {
    /// Configuration of sweepd: `sweepd config check FILE` prints what it means, `systemctl reload sweepd` applies the changes that
    /// need no restart. Every key is here; keys behind `#` are optional, shown with their default or an example.
    /// Paths are relative to the folder of this file.
    DAEMON: DaemonConfig, "" ""

    ///
    /// Health and metrics: /health and /metrics on this address, or "off". Any address but a loopback one also needs
    /// `http_public = true`: then all who reach it can read them, and requests may name any host. Without it, only requests to an IP
    /// address or to localhost are answered.
    http = "127.0.0.1:9177", Text(http) [http], Restart or "off";
    http_public = false, Flag() [http_public], Restart text;
    ///
    /// Folder by which consumers find the daemon. By default $SWEEPD_ROOT; else /run/sweepd/iox2 where there is a /run/sweepd;
    /// else /tmp/sweepd/iox2. A consumer needs the same.
    root = "/run/sweepd/iox2", Path() [root], Restart root;
}

table! {
    ///
    /// One for each sensor, 64 at most.
    SENSOR: SensorConfig, "" "[[sensor]]"

    /// Its service is sweepd/<name>/sweep.
    name = "roof", Required(name) [];
    /// The sensor's own address. Where several share one: with the port that they send from, "192.168.1.201:2368".
    address = "192.168.1.201", Required(source) [address], Restart text, Restart<"source port" [source_port]> or "any";
    ///
    /// The port of this host that it sends to. Sensors may share one; settings of the socket and its thread, down to
    /// realtime_priority, then hold for all of them.
    port = 2368, Whole(PORTS; u16) [port.port], Restart text;
    /// Sensors that share an address each need a position_port of their own; otherwise their GPS state and temperature are lost.
    position_port = 8308, Whole(PORTS; u16) [position_port], Restart text;
    /// Address of this host to listen on; 0.0.0.0 also hears broadcasts. Multicast group to join, interface to listen on alone.
    bind = "0.0.0.0", Text(bind) [port.bind], Restart text;
    multicast = "239.1.1.1", Text(multicast) [port.multicast], Restart or "none";
    interface = "eth1", Text(interface) [port.interface], Restart or "any";
    /// Core that the thread is pinned to, and its priority under SCHED_FIFO, 1 to 99; by default neither.
    cpu = 1, Whole(0..=u32::MAX as i64; usize) [port.cpu], Restart or "any";
    realtime_priority = 50, Whole(1..=99; u8) [port.realtime_priority], Restart or "none";
    ///
    /// vlp16, puck-lite, puck-hires, vlp32c, hdl32e, hdl64e-s2 (S2.1 too), hdl64e-s3 or vls128; by default told by the packets.
    model = "vlp16", Text(model) [pipeline.model], OtherSensor or "told by the packets";
    /// Calibration of the unit, db.xml or ROS YAML; by default the model's own, and of an HDL-64E the one in its packets.
    calibration = "unit.xml", File(calibration) [pipeline.calibration], WithSensor presence "the sensor's own";
    /// Whether it sends one return or two; by default told by the packets. To say so saves memory.
    returns = "single", Words("single" => false, "dual" => true) [dual], OtherSensor returns;
    /// Which of two is segmented: nearest, strongest, or last, which is best in rain, snow and dust.
    return = "nearest", Words("nearest" => ReturnChoice::Nearest, "strongest" => ReturnChoice::Strongest, "last" => ReturnChoice::Last) [pipeline.return_choice], Reload word;
    /// Azimuth at which sweeps are cut, degrees clockwise from the sensor's +y.
    cut_azimuth_deg = 0, Number(TURN_DEG, "degrees", f64::to_radians) [pipeline.cut_azimuth_rad], Reload degrees;
    /// Whether the valid sentence of its GPS receiver is enough for UTC, though it does not report the pulse (PPS) as locked: an
    /// HDL-32E cannot. Without a pulse wired to it, times may be off by up to 3 s.
    gps_without_pps = false, Flag() [pipeline.gps_without_pps], Reload text;
    /// Packets that are lost or unusable, percent of those of the last 5 s: from the first limit on, the log and /health report it;
    /// from the second on, /health answers 503.
    loss_warning_percent = 3, Number(LOSS_PERCENT, "percent", share) [losses.warning], Reload percent;
    loss_fault_percent = 20, Number(LOSS_PERCENT, "percent", share) [losses.fault], Reload percent;
    /// Turns in a row (0: never) after which a sensor that sends is said not to see: no return, all around nothing beyond eye_near_m, the
    /// same turn after turn, dark where it looks down to near ground, or less than eye_least_percent of the returns of before.
    eye_turns = 10, Whole(0..=1_000_000; u32) [pipeline.eye.turns], Reload text;
    eye_near_m = 1, Number(EYE_NEAR_M, "metres", metres) [pipeline.eye.near_m], Reload text;
    eye_least_percent = 10, Number(EYE_PERCENT, "percent", share) [pipeline.eye.least_share], Reload percent;
    /// Consumers at most, 1 to 16. Each takes memory for four sweeps more.
    max_consumers = 4, Whole(1..=16; usize) [max_consumers], Restart text;
    /// Objects while the head turns, if a consumer of them is connected: how long complete objects may wait for more, 1 to 100 ms
    /// (new ones come about every 3 ms; a longer wait saves processor time); and the width, degrees, above which they come in parts
    /// and segments are flagged wide.
    objects_every_ms = 5, Whole(1..=100, nanoseconds) [objects_every_ns], Restart milliseconds;
    max_object_deg = 60, Number(5.0..=360.0, "degrees", radians) [pipeline.segment.max_width_rad], Restart degrees;
}

table! {
    ///
    /// The sensor's own settings as they should be. The daemon changes none: it reports in the log and in /health where packets show
    /// another value. `sweepd doctor --config FILE` also asks the sensor, and `sweepd sensor ADDR set` changes it.
    WANT: SensorConfig, "want" "[sensor.want]"

    /// Turns a minute, 300 to 1200 in steps of 60 (an HDL-64E: any).
    rpm = 600, Whole(Rpm::RANGE, rpm) [want.rpm], Reload<"want" [want]> text;
    /// strongest, last or dual.
    returns = "strongest", Text(wanted::<Returns>) [want.returns];
    /// Azimuths that it measures, clockwise from the first to the last, whole degrees; all of a turn is 0-359.
    fov = "0-359", Text(wanted::<FieldOfView>) [want.fov];
    /// Lasers on or off; where it sends to; azimuth of the head at the pulse per second, degrees, or off. Not of an HDL-64E, which
    /// has no web interface.
    laser = "on", Text(wanted::<Switch>) [want.laser];
    host = "192.168.1.100", Text(wanted::<Host>) [want.host];
    phase_lock = "off", Text(wanted::<PhaseLock>) [want.phase_lock];
}

table! {
    ///
    /// How it sits on the robot: from the robot's origin, x right, y forward, z up; roll right side down (180 is head
    /// down), pitch nose up, yaw counter-clockwise from above; height above the ground, by default that of the floor that is
    /// seen. climb_m is the height of a step that the wheels climb, 0.02 to 0.2: a higher one that rows strike is an object, if it is
    /// over 5 cm high.
    MOUNT: SensorConfig, "mount" "[sensor.mount]"

    x_m = 0, Number(POSITION_M, "metres", metres) [pipeline.position_m[0]], Reload<"x_m, y_m, z_m" [pipeline.position_m]> position;
    y_m = 0, Number(POSITION_M, "metres", metres) [pipeline.position_m[1]];
    z_m = 0, Number(POSITION_M, "metres", metres) [pipeline.position_m[2]];
    roll_deg = 0, Segmenter() [];
    pitch_deg = 0, Segmenter() [];
    yaw_deg = 0, Number(TURN_DEG, "degrees", radians) [pipeline.yaw_rad], Reload degrees;
    height_m = 1.9, Segmenter() [];
    climb_m = 0.2, Segmenter() [];
}

table! {
    ///
    SEGMENT: SensorConfig, "segment" "[sensor.segment]"

    /// How ground is found and what is joined: slope, or paper for the method as published.
    method = "slope", Words("slope" => Method::Slope, "paper" => Method::Paper) [pipeline.segment.method], Reload word;
    /// Two neighbouring returns are joined only if the line through them meets the beam at more than this, degrees (method paper).
    theta_deg = 10, Segmenter() [];
    /// Fewest returns of a segment.
    min_points = 10, Segmenter() [];
    /// Returns nearer or further than this keep their range and get label 0; by default there is no upper limit.
    min_range_m = 0, Segmenter() [];
    max_range_m = 100, Segmenter() [];
    /// Whether they are removed instead: no output has a return there.
    remove_out_of_range = false, Flag() [pipeline.removal.out_of_range], Reload text;
    /// The robot's own body: a PNG picture as high as the sensor has rows, black where the robot is (`sweepd mask` makes one from a
    /// capture). Returns there keep their range and get label 0; with { image = "body.png", remove = true } they are removed.
    mask = "body.png", Image(mask, [pipeline.removal.masked]) [pipeline.segment.mask], WithSensor presence "none", WithSensor<"removal by the mask" [pipeline.removal.masked]> text;
    /// Boxes in which returns are removed, such as the robot's body, a fork, a trailer: x, y, z of two opposite corners, metres from the
    /// robot's origin, axes as in [sensor.mount].
    remove_boxes = [[-0.4, -0.6, 0, 0.4, 0.5, 1.2]], Boxes() [pipeline.removal.boxes], Reload boxes;
}

table! {
    ///
    /// Record all packets of these sensors, to NAME-000.pcap, NAME-001.pcap, ...: a new file at each start, and at the size or age
    /// below if given. A full or failing disk stops only the recording; /health says so. The daemon tries again within a minute, a
    /// reload at once.
    RECORD: RecordConfig, "record" "#[record]"

    path = "/var/lib/sweepd/drive.pcap", Required(capture) [];
    rotate_mb = 1000, Number(1.0..=1e6, "MB", bytes) [rotate_bytes];
    rotate_minutes = 10, Number(0.1..=1e5, "minutes", seconds) [rotate_seconds];
}

/// The tables of a sensor, its own first.
pub static SENSOR_TABLES: [&Table<SensorConfig>; 4] = [&SENSOR, &WANT, &MOUNT, &SEGMENT];

/// A whole configuration with every key explained: what systemd/sweepd.toml is.
pub fn example() -> String {
    let sensor: String = SENSOR_TABLES.map(Table::example).concat();
    DAEMON.example() + &sensor + &RECORD.example()
}

/// A name stands in that of a service and in those of files.
fn name(sensor: &mut SensorConfig, text: &str) -> Result<(), Refusal> {
    text.clone_into(&mut sensor.name);
    if is_sensor_name(text) {
        return Ok(());
    }
    Err(Refusal {
        title: Some(format!("a sensor cannot be called {text:?}")),
        ..format!("expected {NAME_RULE}").into()
    })
}

/// Where packets come from: IP or IP:PORT.
fn source(sensor: &mut SensorConfig, text: &str) -> Result<(), Refusal> {
    let with_port = text
        .parse()
        .map(|at: SocketAddrV4| (*at.ip(), Some(at.port())));
    let source = text.parse().map(|ip| (ip, None)).or(with_port).ok();
    let is_host = |&(ip, port): &(Ipv4Addr, _)| {
        !ip.is_unspecified() && !ip.is_multicast() && !ip.is_broadcast() && port != Some(0)
    };
    let Some((ip, port)) = source.filter(is_host) else {
        return Err(Refusal {
            cure: Some("`sweepd inspect` of a recording names the senders".to_owned()),
            .."expected the sensor's own IPv4 address, such as 192.168.1.201, or with its port, 192.168.1.201:2368".into()
        });
    };
    (sensor.address, sensor.source_port) = (ip.into(), port);
    Ok(())
}

/// A recording's name; `check` brings it to the folder of the configuration.
fn capture(record: &mut RecordConfig, text: &str) -> Result<(), Refusal> {
    record.path = text.into();
    let name = text.rsplit('/').next().unwrap_or_default();
    let stem = name
        .strip_suffix(".gz")
        .unwrap_or(name)
        .strip_suffix(".pcap");
    match stem {
        None | Some("") => Err("expected a file called NAME.pcap or NAME.pcap.gz".into()),
        Some(_) => Ok(()),
    }
}

fn http(text: &str) -> Result<Option<SocketAddr>, Refusal> {
    if text == "off" {
        return Ok(None);
    }
    match text.parse::<SocketAddr>() {
        Ok(address) if address.port() != 0 => Ok(Some(address)),
        _ => Err(format!("expected an address and port such as {HTTP}, or \"off\"").into()),
    }
}

fn bind(text: &str) -> Result<Ipv4Addr, Refusal> {
    let address: Option<Ipv4Addr> = text.parse().ok();
    let address = address.filter(|ip| !ip.is_multicast() && !ip.is_broadcast());
    address.ok_or(
        "expected an IPv4 address of this host, such as 192.168.1.100, or 0.0.0.0 for all".into(),
    )
}

fn multicast(text: &str) -> Result<Ipv4Addr, Refusal> {
    let group = text.parse().ok().filter(Ipv4Addr::is_multicast);
    group.ok_or("expected a multicast group, 224.0.0.0 to 239.255.255.255".into())
}

fn interface(text: &str) -> Result<String, Refusal> {
    // Linux: IFNAMSIZ less the zero at the end.
    if (1..=15).contains(&text.len()) && !text.contains([' ', '/', '\0']) {
        return Ok(text.to_owned());
    }
    Err("expected a network interface such as eth1".into())
}

fn model(text: &str) -> Result<Model, Refusal> {
    text.parse().map_err(|_| {
        let flags = Model::ALL
            .map(|model| format!("`{}`", model.flag()))
            .join(", ");
        Refusal {
            title: Some(format!("no supported model is called {text:?}")),
            cure: suggestion(text, &flags).map(|flag| format!("did you mean `{flag}`?")),
            ..format!("expected one of {flags}").into()
        }
    })
}

/// A setting of the sensor's own, in the words of the command line.
fn wanted<T: FromStr<Err = &'static str>>(text: &str) -> Result<T, Refusal> {
    Ok(text.parse::<T>()?)
}

fn calibration(sensor: &mut SensorConfig, path: &Path) -> Result<(), String> {
    let calibration = files::calibration(path).map_err(|error| error.to_string())?;
    let fits = match sensor.pipeline.model {
        Some(model) => calibration.clone().for_model(model).map(drop),
        None if possible_models(None, Some(&calibration)).next().is_some() => Ok(()),
        None => Err(format!(
            "{} beams that are those of no supported model",
            calibration.beams().len()
        )),
    };
    fits.map_err(|why| format!("calibration {}: {why}", visible(path.display())))?;
    sensor.pipeline.calibration = Some(calibration);
    Ok(())
}

fn mask(sensor: &mut SensorConfig, path: &Path) -> Result<(), String> {
    let mask = files::mask(path).map_err(|error| error.to_string())?;
    let (model, calibration) = (sensor.pipeline.model, &sensor.pipeline.calibration);
    let rows = mask.rows();
    if !possible_models(model, calibration.as_ref()).any(|model| model.spec().channels == rows) {
        let sensor = model.map_or_else(
            || "no model that this may be".to_owned(),
            |model| format!("not the {model}"),
        );
        let name = visible(path.display());
        return Err(format!("mask {name} has {rows} rows, {sensor}"));
    }
    sensor.pipeline.segment.mask = Some(mask);
    Ok(())
}

fn share(percent: f64) -> f64 {
    percent / 100.0
}

fn radians(degrees: f64) -> f32 {
    degrees.to_radians() as f32
}

fn metres(metres: f64) -> f32 {
    metres as f32
}

fn nanoseconds(milliseconds: i64) -> i64 {
    milliseconds * 1_000_000
}

fn rpm(rpm: i64) -> Rpm {
    Rpm(rpm as u16)
}

fn bytes(megabytes: f64) -> Option<u64> {
    Some((megabytes * 1e6) as u64)
}

fn seconds(minutes: f64) -> Option<u64> {
    Some((minutes * 60.0).round() as u64)
}

fn text(value: &impl ToString) -> String {
    value.to_string()
}

fn word(value: &impl Debug) -> String {
    format!("{value:?}").to_lowercase()
}

fn or(none: &str, value: &Option<impl ToString>) -> String {
    value
        .as_ref()
        .map_or_else(|| none.to_owned(), ToString::to_string)
}

fn root(root: &Option<PathBuf>) -> String {
    or("the default", &root.as_ref().map(|root| root.display()))
}

fn returns(dual: &Option<bool>) -> String {
    or(
        "told by the packets",
        &dual.map(|dual| if dual { "dual" } else { "single" }),
    )
}

fn presence<T>(none: &str, value: &Option<T>) -> String {
    if value.is_some() { "from a file" } else { none }.to_owned()
}

fn position([x, y, z]: &[f32; 3]) -> String {
    format!("{x}, {y}, {z}")
}

fn boxes(boxes: &[BodyBox]) -> String {
    match boxes {
        [] => "none".to_owned(),
        boxes => boxes.iter().map(text).collect::<Vec<_>>().join(" and "),
    }
}

/// As it was written: the noise of the conversion is far below.
fn degrees(angle_rad: &(impl Copy + Into<f64>)) -> String {
    let angle_rad: f64 = (*angle_rad).into();
    ((angle_rad.to_degrees() * 1e4).round() / 1e4).to_string()
}

/// The same of a share.
fn percent(share: &f64) -> String {
    ((share * 1e6).round() / 1e4).to_string()
}

fn milliseconds(nanoseconds: &i64) -> String {
    (nanoseconds / 1_000_000).to_string()
}

#[cfg(test)]
mod tests {
    use toml::de::DeTable;

    use super::super::changes::{Effect, compare};
    use super::super::error::Problems;
    use super::super::file::Written;
    use super::super::table::{FileProblems, TableReader};
    use super::*;

    #[derive(Default)]
    pub struct Scratches {
        min_gap_m: f32,
    }

    table! {
        /// How scratches are found.
        SCRATCHES: Scratches, "scratches" "[scratches]"

        /// Distance below which returns are scratched together, metres.
        scratch_m = 0.25, Number(0.0..=0.5, "metres", metres) [min_gap_m], Reload text;
    }

    /// What is written, and all that is wrong with it.
    fn read(text: &str) -> (Scratches, String) {
        let mut found = FileProblems::new(text, Path::new(""));
        let mut reader = TableReader::of(DeTable::parse(text).unwrap(), &mut found);
        let mut written = Written::new(&reader);
        written.read(&mut reader, &SCRATCHES);
        reader.finish();
        let problems = [found.problems, found.values].concat();
        let problems = Problems::new("sweepd.toml".to_owned(), text, problems);
        (written.config, problems.to_string())
    }

    #[test]
    fn a_row_is_enough_for_example_file_checks_and_reload() {
        let example = "# How scratches are found.\n[scratches]\n\
                       # Distance below which returns are scratched together, metres.\n#scratch_m = 0.25\n";
        assert_eq!(SCRATCHES.example(), example);
        for (line, words) in [
            (
                "scratch_m = 0.6",
                ["`scratch_m` cannot be 0.6", "expected 0 to 0.5 metres"],
            ),
            (
                "scratch_m = true",
                ["wrong type: boolean `true`", "expected a number"],
            ),
            (
                "scrath_m = 0.3",
                ["unknown key `scrath_m`", "did you mean `scratch_m`?"],
            ),
        ] {
            let (_, said) = read(line);
            for part in words.into_iter().chain(["sweepd.toml:1:"]) {
                assert!(said.contains(part), "no {part:?} in\n{said}");
            }
        }
        let (mut old, _) = read("scratch_m = 0.25");
        let (new, _) = read("scratch_m = 0.3");
        let [(rule, Effect::Reload)] = &compare(&[&SCRATCHES], &old, &new)[..] else {
            panic!("one change")
        };
        assert_eq!(rule.change(&old, &new), "scratch_m 0.25 -> 0.3");
        (rule.take)(&mut old, &new);
        assert_eq!(old.min_gap_m, 0.3);
    }
}
