//! `diagnostic_msgs/DiagnosticArray`: what the caller knows of its health.

use sweepd_sweep::{Header, Model};

use crate::cdr::Writer;

/// How well something is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
#[repr(u8)]
pub enum Level {
    /// As it should be.
    Ok = 0,
    /// Not as it should be, but it works.
    Warn = 1,
    /// It does not work.
    Error = 2,
    /// Not heard of for some time.
    Stale = 3,
}

/// The health of one thing.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Status {
    /// How well it is.
    pub level: Level,
    /// Its name, as `sweepd: roof`.
    pub name: String,
    /// The state in words.
    pub message: String,
    /// Which piece of hardware it is, as the address of a sensor.
    pub hardware_id: String,
    /// Keys and values.
    pub values: Vec<(String, String)>,
}

/// Name of the daemon's status; [`name_of`] has that of a sensor.
pub const DAEMON: &str = "sweepd";

/// Name of a sensor's status.
pub fn name_of(sensor: &str) -> String {
    format!("{DAEMON}: {sensor}")
}

/// Name of the model in a header.
pub fn model_of(header: &Header) -> String {
    match Model::from_code(header.model) {
        Some(model) => model.to_string(),
        None => format!("model {}", header.model),
    }
}

/// What the header of a sensor's newest sweep says: its `hardware_id`, keys and values.
pub fn of_header(header: &Header) -> (String, Vec<(String, String)>) {
    let model = model_of(header);
    let hardware_id = format!("{model} {}", header.sensor());
    let values = [
        ("model", model),
        ("address", header.sensor().to_owned()),
        ("rpm", format!("{:.1}", header.rpm)),
        ("returns", header.returns.to_string()),
        ("segments", header.segments.to_string()),
    ];
    let values = values.map(|(key, value)| (key.to_owned(), value));
    (hardware_id, values.into())
}

/// Appends the message: what is so at a time, nanoseconds since 1970.
pub fn encode(time_ns: i64, statuses: &[Status], message: &mut Vec<u8>) {
    let mut writer = Writer::new(message);
    writer.header(time_ns, "");
    writer.count(statuses.len());
    for status in statuses {
        writer.u8(status.level as u8);
        writer.text(&status.name);
        writer.text(&status.message);
        writer.text(&status.hardware_id);
        writer.count(status.values.len());
        for (key, value) in &status.values {
            writer.text(key);
            writer.text(value);
        }
    }
}
