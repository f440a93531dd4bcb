//! What a replay says at its end, on standard error.

use super::args::Args;
use super::summary::SensorReport;
use crate::admission::DiscoveredSensors;
use crate::cli::sections::Sections;
use crate::cli::{complain, warn_of};
use crate::input::{Capture, CaptureError};
use crate::judge::Finding;
use crate::text::{count_of, utc_text};

/// Shows where the capture is damaged. Returns whether it could be read at all.
pub(super) fn show_damage(capture: &Capture, read: Result<(), CaptureError>) -> bool {
    warn_of(capture, "; everything before was replayed");
    let name = capture.name();
    let cut = capture.counts().truncated_records;
    if cut > 0 {
        let cut = count_of(cut, "record");
        let message = format!("{name}: {cut} cut short; capture with a larger snap length");
        complain("warning", message);
    }
    if let Err(error) = &read {
        complain(
            "error",
            format_args!("{error}; everything before was replayed"),
        );
    }
    read.is_ok()
}

/// Shows what is in doubt or wrong with the mounts.
pub(super) fn show_floor(reports: &[SensorReport<'_>]) {
    for report in reports {
        if let Some(finding) = report.floor.finding().filter(Finding::is_trouble) {
            complain("warning", format_args!("{}: {finding}", report.sensor));
        }
    }
}

/// Shows what was asked for and is not there. Returns whether all is there.
pub(super) fn show_missing(
    args: &Args,
    sections: &Sections,
    capture: &Capture,
    sensors: &DiscoveredSensors,
    reports: &[SensorReport<'_>],
) -> bool {
    let missing = missing(args, sections, capture, sensors, reports);
    for message in &missing {
        complain("error", format_args!("{}: {message}", capture.name()));
    }
    if wants_sweeps(args) && !reports.iter().all(SensorReport::lacks_a_turn) {
        for report in reports.iter().filter(|report| report.lacks_a_turn()) {
            let less = less_than_a_turn(args);
            complain("warning", format_args!("{}: {less}", report.sensor));
        }
    }
    missing.is_empty()
}

/// Whether sweeps are wanted, rather than packets.
fn wants_sweeps(args: &Args) -> bool {
    let wants_packets = args.play.to.is_some() || args.pcap.is_some();
    !wants_packets || args.objects || args.publish.is_wanted() || args.output.is_any()
}

fn less_than_a_turn(args: &Args) -> String {
    let part = args.play.part();
    format!("no whole turn{part}, so there is no sweep: --partial gives the part that is there")
}

fn missing(
    args: &Args,
    sections: &Sections,
    capture: &Capture,
    sensors: &DiscoveredSensors,
    reports: &[SensorReport<'_>],
) -> Vec<String> {
    let mut missing = sections.missing(sensors.senders());
    let part = args.play.part();
    if reports.is_empty() && missing.is_empty() {
        let counts = capture.counts();
        let records = count_of(counts.records, "record");
        let read = match capture.bag_format() {
            Some(_) => count_of(counts.datagrams, "packet"),
            None => format!("{records}, {}", count_of(counts.datagrams, "UDP datagram")),
        };
        missing.push(format!(
            "no Velodyne data packets{part} ({read}); `sweepd inspect` says what is in it"
        ));
    }
    if !reports.is_empty() && reports.iter().all(|report| report.counts.data == 0) {
        let first_ns = capture.first_ns().unwrap_or(0);
        let ns = capture.last_ns().unwrap_or(0).saturating_sub(first_ns);
        let seconds = ns as f64 * 1e-9;
        let begun = utc_text(first_ns);
        missing.push(format!(
            "no data packets{part}; what was read of it spans {seconds:.3} s from {begun} on"
        ));
    }
    if wants_sweeps(args) && !reports.is_empty() && reports.iter().all(SensorReport::lacks_a_turn) {
        missing.push(less_than_a_turn(args));
    }
    let mut unshared: Vec<String> = args
        .publish
        .left_over(reports.len())
        .iter()
        .map(|name| format!("--publish {name}"))
        .collect();
    unshared.extend(args.output.messages.left_over(reports.len()));
    if !reports.is_empty() && !unshared.is_empty() {
        let names = unshared.join(", ");
        missing.push(format!(
            "no sensor in it for {names}; `sweepd inspect` lists those that are there"
        ));
    }
    missing
}
