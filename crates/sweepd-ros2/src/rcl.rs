//! Command lines and parameter files, held against rclpy: `tests/rcl.txt` has the rows.

use std::env;
use std::ffi::OsString;
use std::fs;
use std::io::Write;
use std::process::{Command, Stdio};

use clap::Parser;
use serde_json::{Value, json};
use sweepd_messages::{Layout, Stamp};
use sweepd_ros2::args::Args;
use tempfile::NamedTempFile;

use crate::names::NodeName;
use crate::parameters::Parameters;
use crate::ros_args::RosArgs;

const TABLE: &str = include_str!("../tests/rcl.txt");
const TOPICS: [&str; 3] = ["~/roof/points", "/tf_static", "/diagnostics"];

/// What this program makes of a row, in the form of `tests/rcl.py`.
fn taken(row: &str) -> Result<Value, String> {
    let (words, text) = match row.split_once(" <<< ") {
        Some((words, text)) => (words, Some(text)),
        None => (row, None),
    };
    let mut words: Vec<OsString> = words.split_whitespace().map(OsString::from).collect();
    let file = NamedTempFile::new().unwrap();
    if let Some(text) = text {
        fs::write(file.path(), text.replace("\\n", "\n")).unwrap();
        words.extend(["--params-file".into(), file.path().into()]);
    }
    let (ros, others) = RosArgs::split(words.into_iter())?;
    let others = ["sweepd-ros2".into()].into_iter().chain(others);
    let args = Args::try_parse_from(others).map_err(|error| error.to_string())?;
    let node = NodeName::remapped(&args.namespace, &args.node, &ros.remaps);
    let parameters = Parameters::of_command_line(&args, &ros, &node);
    let parameters = parameters.map_err(|error| error.to_string())?;
    let roof = parameters.of("roof");
    Ok(json!({
        "node": node.full(),
        "topics": TOPICS.map(|topic| node.remapped_topic(topic, &ros.remaps)),
        "sensors": parameters.sensors,
        "root": parameters.root.unwrap_or_default(),
        "health": parameters.health.map_or_else(String::new, |address| address.to_string()),
        "base_frame": parameters.base_frame,
        "clock": parameters.clock,
        "frame_id": roof.frame_id,
        "stamp": if roof.stamp == Stamp::Last { "last" } else { "first" },
        "organized": roof.organized,
        "layout": if roof.layout == Layout::Autoware { "autoware" } else { "xyzirt" },
    }))
}

#[test]
fn rclpy_and_this_program_take_the_same() {
    let rows: Vec<&str> = TABLE
        .lines()
        .filter(|line| !line.is_empty() && !line.starts_with('#'))
        .collect();
    let Some(python) = env::var_os("SWEEPD_JAZZY") else {
        assert!(env::var_os("CI").is_none(), "SWEEPD_JAZZY is not set");
        println!("not run: SWEEPD_JAZZY is not set");
        return;
    };
    let mut input = NamedTempFile::new().unwrap();
    for row in &rows {
        writeln!(input, "{}", row.trim_start_matches("+ ")).unwrap();
    }
    let output = Command::new(python)
        .arg(concat!(env!("CARGO_MANIFEST_DIR"), "/tests/rcl.py"))
        // The nodes of all rows need not find each other.
        .env("ROS_AUTOMATIC_DISCOVERY_RANGE", "OFF")
        .stdin(input.reopen().unwrap())
        .stderr(Stdio::null())
        .output()
        .unwrap();
    let output = String::from_utf8(output.stdout).unwrap();
    assert_eq!(output.lines().count(), rows.len());
    let mut differ = Vec::new();
    for (row, said) in rows.iter().zip(output.lines()) {
        let rcl: Value = serde_json::from_str(said).unwrap();
        let own = taken(row.trim_start_matches("+ "));
        let agrees = match &own {
            Ok(_) if row.starts_with("+ ") => rcl["refused"].is_string(),
            Ok(own) => *own == rcl,
            Err(_) => rcl["refused"].is_string() && !row.starts_with("+ "),
        };
        if !agrees {
            differ.push(format!("{row}\n  {own:?}\n  {rcl}"));
        }
    }
    assert!(differ.is_empty(), "{}", differ.join("\n"));
}
