//! `replay --objects`, held against `--segments` of the same capture.

use std::collections::BTreeMap;

use serde_json::Value;

use crate::{fixture, replay, sweeps};

fn lines(options: &[&str]) -> Vec<Value> {
    let out = replay(&fixture("street_hdl32e.pcap.gz"), options);
    assert!(out.code == 0);
    sweeps(&out.stdout)
}

#[test]
fn each_segment_is_told_once_and_most_before_their_sweep() {
    let mut told: BTreeMap<u64, Vec<Value>> = BTreeMap::new();
    let mut labels: BTreeMap<u64, Value> = BTreeMap::new();
    let (mut known_ns, mut early) = (0, 0);
    for line in lines(&["--objects", "--partial"]) {
        let now_ns = line["known_ns"].as_i64().unwrap();
        assert!(now_ns >= known_ns, "in the order in which they are known");
        known_ns = now_ns;
        let sequence = line["sequence"].as_u64().unwrap();
        if line["last"] == true {
            assert!(labels.insert(sequence, line).is_none(), "one last line");
            continue;
        }
        assert!(!labels.contains_key(&sequence), "nothing behind the last");
        if line["why"] == "complete" {
            early += 1;
            let delay_ns = now_ns - line["time_ns"][1].as_i64().unwrap();
            assert!(
                (0..20_000_000).contains(&delay_ns),
                "known {delay_ns} ns after its last shot"
            );
        }
        told.entry(sequence).or_default().push(line);
    }
    let segments = lines(&["--segments", "-", "--partial"]);
    let mut found = 0;
    for segment in &segments {
        let sequence = segment["seq"].as_u64().unwrap();
        let last = &labels[&sequence];
        if last["no_height"] == true {
            continue;
        }
        let label = &segment["label"];
        let whole: Vec<&Value> = told[&sequence]
            .iter()
            .zip(last["labels"].as_array().unwrap())
            .filter(|(line, its)| *its == label && line["why"] != "wide" && line["why"] != "seam")
            .map(|(line, _)| line)
            .collect();
        assert_eq!(whole.len(), 1, "sweep {sequence}, segment {label}");
        let columns = [&segment["column_first"], &segment["column_last"]];
        assert_eq!(whole[0]["points"], segment["points"]);
        assert_eq!(whole[0]["wide"], segment["wide"]);
        assert_eq!([&whole[0]["columns"][0], &whole[0]["columns"][1]], columns);
        for (index, axis) in ["x", "y", "z"].into_iter().enumerate() {
            for (name, key) in [
                ("centroid_m", "centroid"),
                ("min_m", "min"),
                ("max_m", "max"),
            ] {
                let one = whole[0][name][index].as_f64().unwrap();
                let other = segment[format!("{key}_{axis}_m")].as_f64().unwrap();
                assert!((one - other).abs() < 1.5e-4, "{name} {axis}");
            }
        }
        found += 1;
    }
    assert!(2 * early > found && found > 50, "{early} early of {found}");
}
