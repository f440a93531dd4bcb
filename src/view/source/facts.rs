//! What a sweep says of itself, in short texts for people.

use std::collections::BTreeMap;

use crate::text::{grouped, utc_text};
use sweepd_core::sensor::Model;
use sweepd_core::sweep::Header;
use sweepd_core::sweep::layout::{TimeSource, flags};

/// The facts of a header.
pub(super) fn of(header: &Header) -> BTreeMap<&'static str, String> {
    let model = Model::from_code(header.model).map_or("unknown", |model| model.spec().name);
    let clock = match header.time_source() {
        TimeSource::Gps => "GPS",
        TimeSource::Host => "host",
    };
    let mut facts = BTreeMap::from([
        ("model", model.to_owned()),
        ("returns", header.return_mode().name().to_owned()),
        ("from", header.sensor().to_owned()),
        ("time", utc_text(header.time_ns)),
        ("clock", clock.to_owned()),
        ("rpm", format!("{:.0}", header.rpm)),
        ("image", format!("{} x {}", header.rows, header.columns)),
        ("packets", grouped(header.packets.into())),
        ("packets lost", grouped(header.lost_packets.into())),
        ("columns missing", grouped(header.missing_columns.into())),
        ("dropped", grouped(header.dropped_datagrams.into())),
        ("decode", milliseconds(header.decode_ns)),
        ("ground", milliseconds(header.ground_ns)),
        ("label", milliseconds(header.label_ns)),
    ]);
    if header.height_m > 0.0 {
        let how = match header.has(flags::HEIGHT_ESTIMATED) {
            true => "estimated",
            false => "configured",
        };
        facts.insert("height", format!("{:.2} m, {how}", header.height_m));
    }
    let unusual = [
        (flags::REVERSED, "turns backwards"),
        (flags::BLANKED, "leaves out a sector"),
        (flags::RATE_UNSTABLE, "speed unsteady"),
        (flags::STOPPED, "stands still"),
    ];
    let unusual: Vec<&str> = unusual
        .into_iter()
        .filter(|&(flag, _)| header.has(flag))
        .map(|(_, words)| words)
        .collect();
    if !unusual.is_empty() {
        facts.insert("head", unusual.join(", "));
    }
    facts
}

fn milliseconds(ns: u32) -> String {
    format!("{:.2} ms", f64::from(ns) * 1e-6)
}
