//! What `sweepd inspect --json` prints, by the names that `replay --json` has.

use std::net::{IpAddr, SocketAddr};

use serde::Serialize;
use serde_json::Value;

use crate::admission::{DiscoveredSensors, Sender};
use crate::cli::output::rounded;
use crate::input::{Capture, LinkType};
use crate::text::rate_per_s;

/// A rate, a second, that can be read.
pub fn per_s(count: u64, first_ns: i64, last_ns: i64) -> Option<f64> {
    rate_per_s(count, first_ns, last_ns).map(|rate| rounded(rate, 10.0))
}

/// All of it.
#[derive(Serialize)]
pub struct Report<'a> {
    pub capture: CaptureReport<'a>,
    pub sensors: Vec<SensorReport<'a>>,
    /// By address: sensors may share one.
    pub positions: Vec<PositionReport>,
    /// Other traffic, the largest part first.
    pub flows: Vec<FlowReport>,
}

/// The capture as a whole.
#[derive(Serialize)]
pub struct CaptureReport<'a> {
    name: &'a str,
    /// Of a bag.
    format: Option<&'static str>,
    link_types: Vec<String>,
    first_ns: Option<i64>,
    last_ns: Option<i64>,
    records: u64,
    datagrams: u64,
    other_traffic: u64,
    truncated_records: u64,
    breaks_off: Option<String>,
    /// What is to be said of its times.
    note: Option<&'static str>,
}

impl<'a> CaptureReport<'a> {
    pub fn new(capture: &'a Capture, sensors: &DiscoveredSensors) -> Self {
        let counts = capture.counts();
        let links = capture.link_types().iter();
        Self {
            name: capture.name(),
            format: capture.bag_format(),
            link_types: links.map(LinkType::to_string).collect(),
            first_ns: capture.first_ns(),
            last_ns: capture.last_ns(),
            records: counts.records,
            datagrams: counts.datagrams,
            other_traffic: counts.other_traffic() + sensors.others(),
            truncated_records: counts.truncated_records,
            breaks_off: capture.truncation().map(ToString::to_string),
            note: capture.remark(),
        }
    }
}

/// A sensor.
#[derive(Serialize)]
pub struct SensorReport<'a> {
    #[serde(flatten)]
    pub sender: SenderReport<'a>,
    pub model: Option<&'static str>,
    pub model_basis: Option<String>,
    /// Why it cannot be decoded.
    pub fault: Option<String>,
    pub return_modes: Vec<&'static str>,
    /// Mean of whole turns.
    pub rpm: Option<f64>,
    pub rpm_range: Option<[f64; 2]>,
    pub counter_clockwise: bool,
    /// Azimuths that the sensor leaves out, first and last.
    pub left_out_deg: Option<[f64; 2]>,
    pub packets: u64,
    pub packets_per_s: Option<f64>,
    pub lost_packets: u64,
    pub reordered: u64,
    pub duplicates: u64,
    pub late: u64,
    pub unconfirmed: u64,
    pub malformed: u64,
    /// Jumps of the clock, or changes of the return mode.
    pub restarts: u64,
    pub dark_beams: Value,
    /// Names of what keeps it from seeing.
    pub eye: Vec<&'static str>,
    /// Which one is up, where that is known, and by what.
    pub side: Option<&'static str>,
    pub side_by: Option<&'static str>,
    pub floor: Value,
    /// Level surface above, where nothing says for sure which side is up.
    pub floor_if_hanging: Value,
    /// What an HDL-64E says of itself.
    pub unit: Option<UnitReport>,
}

/// Who sends.
#[derive(Serialize)]
pub struct SenderReport<'a> {
    sensor: &'a str,
    source: SocketAddr,
    port: u16,
}

impl<'a> SenderReport<'a> {
    /// A sender, and what it is called.
    pub fn new(sender: &'a Sender, sensor: &'a str) -> Self {
        Self {
            sensor,
            source: sender.source,
            port: sender.destination_port,
        }
    }
}

/// The status of an HDL-64E.
#[derive(Serialize)]
pub struct UnitReport {
    pub series: Option<String>,
    pub firmware: Option<u8>,
    pub temperature_c: Option<i8>,
    pub rpm: Option<i16>,
    pub fov_deg: Option<[f64; 2]>,
    pub return_mode: Option<&'static str>,
    pub life_hours: Option<u16>,
    pub warnings: Vec<&'static str>,
    pub calibration: String,
}

/// The position packets of an address.
#[derive(Serialize)]
pub struct PositionReport {
    pub address: IpAddr,
    pub position_packets: u64,
    pub packets_per_s: Option<f64>,
    pub pps: Option<String>,
    pub pps_locked_packets: u64,
    /// The newest sentence of the receiver.
    pub sentence: Option<String>,
    pub sentence_valid: Option<bool>,
    pub utc_ns: Option<i64>,
    /// Latitude and longitude.
    pub position_deg: Option<[f64; 2]>,
    /// Why the time of the receiver is doubtful.
    pub time_doubt: Option<String>,
    /// The boards at the top and at the bottom.
    pub boards_c: Option<[i8; 2]>,
    pub inertial_c: Option<f64>,
}

/// Datagrams of one sender to one port that are of no sensor.
#[derive(Serialize)]
pub struct FlowReport {
    pub source: SocketAddr,
    pub port: u16,
    pub datagrams: u64,
    pub datagrams_per_s: Option<f64>,
    /// What they are like, such as their length.
    pub form: String,
    /// The LiDAR of another maker that they look like.
    pub lidar: Option<&'static str>,
}
