//! What an HDL-64E says about itself, in rows.

use super::row;
use crate::text::grouped;
use sweepd_core::wire::hdl64::{DUMP_LEN, DumpState, Status};

/// Adds the rows; none for a unit that sends no status (S1, early S2).
pub fn describe(status: &Status, text: &mut String) {
    if status.known() == 0 {
        return;
    }
    let series = status.series();
    row(text, "unit", &unit(status));
    if let Some(clock) = status.clock() {
        let gps = status
            .gps()
            .map_or("unknown".to_owned(), |gps| gps.to_string());
        row(text, "unit clock", &format!("{clock} UTC, GPS: {gps}"));
    }
    if let (Some(series), Some(warnings)) = (series, status.warnings()) {
        let faults: Vec<&str> = warnings.faults(series).collect();
        row(
            text,
            "warnings",
            &if faults.is_empty() {
                "none".to_owned()
            } else {
                faults.join(", ")
            },
        );
    }
    if let Some([start, end]) = status.fov_cdeg() {
        let degrees = [start, end].map(|cdeg| f64::from(cdeg) / 100.0);
        row(
            text,
            "set view",
            &format!("{:.2} to {:.2} degrees", degrees[0], degrees[1]),
        );
    }
    row(text, "calibration", &calibration(status));
}

/// Which unit it is, and how it is.
fn unit(status: &Status) -> String {
    let mut unit: Vec<String> = Vec::new();
    unit.extend(status.series().map(|series| format!("series {series}")));
    unit.extend(
        status
            .firmware()
            .map(|firmware| format!("firmware {firmware:#04x}")),
    );
    unit.extend(
        status
            .temperature_c()
            .map(|degrees| format!("{degrees} degrees Celsius")),
    );
    unit.extend(status.rpm().map(|rpm| format!("{rpm} rpm")));
    unit.extend(status.power().map(|power| format!("power {power}")));
    unit.extend(
        status
            .life_hours()
            .map(|hours| format!("{} hours of use", grouped(hours.into()))),
    );
    unit.join(", ")
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
