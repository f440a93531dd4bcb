//! Rows for the status of an HDL-64E.

use super::report::UnitReport;
use crate::text::{grouped, row};
use sweepd_core::wire::hdl64::{DUMP_LEN, DumpState, Status};

/// Adds the rows; none for a unit that sends no status (S1, early S2).
pub fn describe(status: &Status, text: &mut String) {
    if status.known() == 0 {
        return;
    }
    row(text, "unit", unit(status));
    if let Some(clock) = status.clock() {
        let gps = status.gps();
        let gps = gps.map_or("unknown".to_owned(), |gps| gps.to_string());
        row(text, "unit clock", format_args!("{clock} UTC, GPS: {gps}"));
    }
    if let (Some(series), Some(warnings)) = (status.series(), status.warnings()) {
        let faults: Vec<&str> = warnings.faults(series).collect();
        let faults = match faults.is_empty() {
            true => "none".to_owned(),
            false => faults.join(", "),
        };
        row(text, "warnings", faults);
    }
    if let Some([start, end]) = status.fov_cdeg() {
        let start = f64::from(start) / 100.0;
        let end = f64::from(end) / 100.0;
        row(
            text,
            "set view",
            format_args!("{start:.2} to {end:.2} degrees"),
        );
    }
    row(text, "calibration", calibration(status));
}

/// The same for programs.
pub fn report(status: &Status) -> Option<UnitReport> {
    if status.known() == 0 {
        return None;
    }
    let warnings = status.series().zip(status.warnings());
    Some(UnitReport {
        series: status.series().map(|series| series.to_string()),
        firmware: status.firmware(),
        temperature_c: status.temperature_c(),
        rpm: status.rpm(),
        fov_deg: status
            .fov_cdeg()
            .map(|edges| edges.map(|cdeg| f64::from(cdeg) / 100.0)),
        return_mode: status.return_mode().map(|mode| mode.name()),
        life_hours: status.life_hours(),
        warnings: warnings.map_or(Vec::new(), |(series, warnings)| {
            warnings.faults(series).collect()
        }),
        calibration: calibration(status),
    })
}

/// Identity and health of the unit.
fn unit(status: &Status) -> String {
    let facts = [
        status.series().map(|series| format!("series {series}")),
        status
            .firmware()
            .map(|byte| format!("firmware {byte:#04x}")),
        status
            .temperature_c()
            .map(|degrees| format!("{degrees} degrees Celsius")),
        status.rpm().map(|rpm| format!("{rpm} rpm")),
        status.power().map(|power| format!("power {power}")),
        status
            .life_hours()
            .map(|hours| format!("{} hours of use", grouped(hours.into()))),
    ];
    facts.into_iter().flatten().collect::<Vec<_>>().join(", ")
}

/// How far its calibration is known.
fn calibration(status: &Status) -> String {
    match status.dump_state() {
        DumpState::Verified => match status.calibrated() {
            Some(time) => {
                format!("complete, of {time}; sweepd calib from-capture writes it to a file")
            }
            None => "complete, but never calibrated by its own account".to_owned(),
        },
        DumpState::Contradictory(error) => format!("damaged: {error}"),
        DumpState::Incomplete => format!(
            "incomplete: {} of {} bytes",
            grouped(status.known() as u64),
            grouped(DUMP_LEN as u64)
        ),
    }
}
