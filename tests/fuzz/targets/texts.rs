//! Files that people write and programs send: calibrations, the daemon's configuration, tables of
//! rows, masks, web pages.

use std::path::Path;

use sweepd::daemon::config::{Config, ConfigError, memory};
use sweepd::segment::MAX_ROWS;
use sweepd::sensor::MAX_FILE_LEN;
use sweepd::sensor::{Calibration, CalibrationError, Model, db_xml, ros_yaml, stream};
use sweepd::web_interface::Page;
use sweepd_lab::cloud::RowTable;

/// A db.xml.
pub fn db_xml(input: &[u8]) {
    calibration(input, db_xml::parse);
}

/// A calibration in YAML.
pub fn ros_yaml(input: &[u8]) {
    calibration(input, ros_yaml::parse);
}

type Parse = fn(&str, &str) -> Result<Calibration, CalibrationError>;

/// What is read can be written, and is then read as the same.
fn calibration(input: &[u8], parse: Parse) {
    let Ok(text) = str::from_utf8(&input[..input.len().min(MAX_FILE_LEN)]) else {
        return;
    };
    let calibration = match parse(text, "fuzz") {
        Ok(calibration) => calibration,
        Err(error) => {
            let message = error.to_string();
            return assert!(
                message.starts_with("fuzz") && message.len() < 2000,
                "{message:.300}"
            );
        }
    };
    let again =
        ros_yaml::parse(&ros_yaml::emit(&calibration), "again").expect("what was written is read");
    assert_eq!(again, calibration);
    for model in Model::ALL {
        if let Err(message) = calibration.clone().for_model(model) {
            assert!(!message.is_empty());
        }
    }
    let _ = stream::records(&calibration);
}

/// The configuration of a daemon. All files that it names are missing.
pub fn config(input: &[u8]) {
    let Ok(text) = str::from_utf8(input) else {
        return;
    };
    // Only paths from the root can be there; what stands in them is not what is tested here.
    if text.contains("/dev") || text.contains("/proc") {
        return;
    }
    match Config::parse(Path::new("/nonexistent/fuzz.toml"), text) {
        Ok(config) => {
            assert!(!config.sensors.is_empty() && config.changes(&config).is_empty());
            let bytes: u64 = config
                .sensors
                .iter()
                .map(|sensor| *memory::pool_bytes(sensor).end())
                .sum();
            assert!(bytes > 0 && config.reloaded(&config).changes(&config).is_empty());
        }
        Err(ConfigError::Invalid(problems)) => {
            assert_eq!(problems.lines().len(), problems.len());
            let lines = text.split('\n').count();
            assert!(
                problems
                    .lines()
                    .iter()
                    .all(|&line| (1..=lines + 1).contains(&line))
            );
            let drawn = problems.to_string();
            assert!(
                !problems.is_empty() && drawn.len() < 4000 * problems.len() + 8 * text.len(),
                "{}",
                drawn.len()
            );
        }
        Err(other) => panic!("no file is read here: {other}"),
    }
}

/// The web page of a sensor, the same bytes for both of its parts.
pub fn web_page(input: &[u8]) {
    let Ok(page) = serde_json::from_slice(input) else {
        return;
    };
    let told = Page::of(&page, &page);
    assert!(told.measured_rpm.is_none_or(f64::is_finite));
    let values = told.settings.list().map(|(_, value)| value);
    let texts = values.iter().chain([&told.pps]).flatten();
    assert!(
        texts
            .clone()
            .all(|text| !text.contains(char::is_control) && text.chars().count() <= 64)
    );
}

/// A PNG that hides a part of what the sensor sees.
pub fn mask(input: &[u8]) {
    match sweepd::files::decode_mask(input, "fuzz") {
        Ok(mask) => {
            assert!((1..=MAX_ROWS).contains(&mask.rows()));
            let _ = (mask.hides(0, -1e300), mask.hides(mask.rows() - 1, f64::NAN));
        }
        Err(error) => assert!(!error.to_string().is_empty()),
    }
}

/// A table of rows.
pub fn rows(input: &[u8]) {
    let Ok(text) = str::from_utf8(input) else {
        return;
    };
    match RowTable::parse(text) {
        Ok(table) => {
            assert!((1..=MAX_ROWS).contains(&table.beams().len()));
            assert!(
                table
                    .beams()
                    .windows(2)
                    .all(|pair| pair[0].elevation_rad > pair[1].elevation_rad)
            );
        }
        Err(error) => assert!(!error.to_string().is_empty()),
    }
}
