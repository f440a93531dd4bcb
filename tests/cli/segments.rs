//! `--segments` and the times in a PCD, held against the returns in the CSV of the same sweeps.

use std::collections::BTreeMap;
use std::path::Path;

use crate::{Folder, fixture, made, replay};

/// A line of a table, by the names in its header.
type Row = BTreeMap<String, String>;

fn csv(path: &Path) -> Vec<Row> {
    let text = std::fs::read_to_string(path).unwrap();
    let names: Vec<&str> = text.lines().next().unwrap().split(',').collect();
    let row = |line: &str| {
        names
            .iter()
            .map(|name| name.to_string())
            .zip(line.split(',').map(str::to_owned))
            .collect()
    };
    text.lines().skip(1).map(row).collect()
}

fn number(row: &Row, name: &str) -> f64 {
    row[name].parse().unwrap()
}

/// What a binary PCD says: the names of its fields with type and size, and the values of each
/// point.
struct Pcd {
    time_ns: i64,
    names: Vec<String>,
    points: Vec<Vec<f64>>,
}

impl Pcd {
    fn read(path: &Path) -> Self {
        let bytes = std::fs::read(path).unwrap();
        let mark = b"DATA binary\n";
        let end = bytes
            .windows(mark.len())
            .position(|window| window == mark)
            .unwrap()
            + mark.len();
        let head = std::str::from_utf8(&bytes[..end]).unwrap();
        let line = |key: &str| -> Vec<String> {
            let line = head
                .lines()
                .find_map(|line| line.strip_prefix(key))
                .unwrap();
            line.split_whitespace().map(str::to_owned).collect()
        };
        let (names, types, sizes) = (line("FIELDS"), line("TYPE"), line("SIZE"));
        let (mut points, mut at) = (Vec::new(), end);
        while at < bytes.len() {
            let mut point = Vec::new();
            for (kind, size) in types.iter().zip(&sizes) {
                let size: usize = size.parse().unwrap();
                let value = &bytes[at..at + size];
                point.push(match (&kind[..], size) {
                    ("F", 4) => f64::from(f32::from_le_bytes(value.try_into().unwrap())),
                    ("U", 2) => f64::from(u16::from_le_bytes(value.try_into().unwrap())),
                    ("U", 4) => f64::from(u32::from_le_bytes(value.try_into().unwrap())),
                    other => panic!("{other:?}"),
                });
                at += size;
            }
            points.push(point);
        }
        assert_eq!(line("POINTS"), [points.len().to_string()]);
        let [of_time, ..] = &line("# time 0 is")[..] else {
            panic!("no time in {head}")
        };
        Self {
            time_ns: of_time.parse().unwrap(),
            names,
            points,
        }
    }

    fn value(&self, point: &[f64], name: &str) -> f64 {
        point[self.names.iter().position(|found| found == name).unwrap()]
    }
}

/// Each point has the time of its own shot, which the beams of one firing do not share.
#[test]
fn a_pcd_has_the_time_of_each_point() {
    let folder = Folder::new("pcd-times");
    for (name, sweep, beams_at_once) in [
        ("street_vlp16.pcap.gz", 1, 1),
        ("street_hdl32e_dual.pcap.gz", 1, 1),
        ("street_hdl64e_s2.pcap.gz", 0, 4),
    ] {
        let dir = folder.path(name);
        let to = dir.to_str().unwrap();
        let ran = replay(
            &fixture(name),
            &["--partial", "--csv", to, "--pcd", to, "--frame", "ros"],
        );
        assert_eq!(ran.code, 0, "{}", ran.stderr);
        let [rows, pcd] =
            ["csv", "pcd"].map(|ending| dir.join(format!("sweep_{sweep:06}.{ending}")));
        let (mut rows, pcd) = (csv(&rows), Pcd::read(&pcd));
        // A PCD has them as they were measured; of those at once, the higher row first.
        rows.sort_by_key(|row| ["time_ns", "row"].map(|key| row[key].parse::<i64>().unwrap()));
        assert!(
            rows.len() > 5_000 && rows.len() == pcd.points.len(),
            "{name}"
        );
        let mut of_firing: BTreeMap<i64, Vec<i64>> = BTreeMap::new();
        for (row, point) in rows.iter().zip(&pcd.points) {
            let time_ns: i64 = row["time_ns"].parse().unwrap();
            let off_ns = pcd.value(point, "time") * 1e9 - (time_ns - pcd.time_ns) as f64;
            assert!(off_ns.abs() < 15.0, "{name}: {off_ns} ns off, {row:?}");
            for axis in ["x", "y", "z"] {
                assert!(
                    (pcd.value(point, axis) - number(row, &format!("{axis}_m"))).abs() < 1e-4,
                    "{name}"
                );
            }
            assert_eq!(pcd.value(point, "label"), number(row, "label"));
            let block: i64 = row["block"].parse().unwrap();
            of_firing
                .entry(row["packet"].parse::<i64>().unwrap() * 12 + block)
                .or_default()
                .push(time_ns);
        }
        for times in of_firing.values_mut() {
            let shots = times.len();
            times.sort_unstable();
            times.dedup();
            assert!(
                times.len() * beams_at_once >= shots,
                "{name}: {} times of {shots} shots",
                times.len()
            );
        }
    }
}

/// What the points of a label are: how many, least and greatest x, y, z, their sum, the nearest,
/// and where each is.
#[derive(Default)]
struct OfPoints {
    points: u64,
    azimuths_deg: Vec<f64>,
    sum: [f64; 3],
    min: Option<[f64; 3]>,
    max: Option<[f64; 3]>,
    nearest: Option<f64>,
}

/// From the returns of a sweep, by label.
fn of_points(rows: &[Row]) -> BTreeMap<u64, OfPoints> {
    let mut found: BTreeMap<u64, OfPoints> = BTreeMap::new();
    for row in rows {
        let label = row["label"].parse().unwrap();
        if label < 2 {
            continue;
        }
        let of: &mut OfPoints = found.entry(label).or_default();
        let point = ["x_m", "y_m", "z_m"].map(|name| number(row, name));
        of.points += 1;
        of.azimuths_deg.push(number(row, "azimuth_deg"));
        (0..3).for_each(|axis| of.sum[axis] += point[axis]);
        let (mut min, mut max) = (of.min.unwrap_or(point), of.max.unwrap_or(point));
        for axis in 0..3 {
            min[axis] = min[axis].min(point[axis]);
            max[axis] = max[axis].max(point[axis]);
        }
        (of.min, of.max) = (Some(min), Some(max));
        of.nearest = Some(
            of.nearest
                .unwrap_or(f64::INFINITY)
                .min(number(row, "range_m")),
        );
    }
    found
}

#[test]
fn segments_are_what_their_points_are() {
    let folder = Folder::new("segments");
    let two = made::together(&[&made::vlp16(), &made::datagrams("street_hdl32e.pcap.gz")]);
    let two = folder.write("two.pcap", made::pcap(&two));
    for axes in ["sensor", "ros"] {
        let [dir, table] = [folder.path(axes), folder.path(&format!("{axes}.csv"))];
        let options = [
            "--frame",
            axes,
            "--csv",
            dir.to_str().unwrap(),
            "--segments",
            table.to_str().unwrap(),
            "--json",
        ];
        let ran = replay(&two, &options);
        assert_eq!(ran.code, 0, "{}", ran.stderr);
        let json = crate::sweeps(&ran.stdout);
        let mut segments = csv(&table);
        let mut compared = 0;
        for sweep in json.iter().filter(|line| line["seq"].is_u64()) {
            let (sensor, seq) = (
                sweep["sensor"].as_str().unwrap(),
                sweep["seq"].as_u64().unwrap(),
            );
            // The VLP-16 is heard first.
            let below = if sensor.contains(".201") {
                dir.clone()
            } else {
                dir.join(sensor.replace(':', "_"))
            };
            let returns = csv(&below.join(format!("sweep_{seq:06}.csv")));
            let labels = of_points(&returns);
            let is_of = |row: &Row| row["sensor"] == sensor && row["seq"] == seq.to_string();
            let (of_sweep, rest) = segments.into_iter().partition::<Vec<Row>, _>(is_of);
            segments = rest;
            assert_eq!(
                (of_sweep.len() as u64, of_sweep.len()),
                (sweep["segments"].as_u64().unwrap(), labels.len())
            );
            for row in &of_sweep {
                let of = &labels[&row["label"].parse().unwrap()];
                assert_eq!(row["points"], of.points.to_string(), "{row:?}");
                assert_eq!(row["time_ns"], sweep["time_ns"].to_string());
                let close = |name: &str, value: f64| {
                    assert!(
                        (number(row, name) - value).abs() < 2e-4,
                        "{name} is not {value}: {row:?}"
                    );
                    assert_eq!(row[name].split_once('.').unwrap().1.len(), 4, "{row:?}");
                };
                for (axis, name) in ["x", "y", "z"].into_iter().enumerate() {
                    close(&format!("min_{name}_m"), of.min.unwrap()[axis]);
                    close(&format!("max_{name}_m"), of.max.unwrap()[axis]);
                    close(
                        &format!("centroid_{name}_m"),
                        of.sum[axis] / of.points as f64,
                    );
                }
                close("nearest_m", of.nearest.unwrap());
                // All points lie between the two azimuths, but for the turn of the head within a
                // column.
                let [first, last] =
                    ["azimuth_first_deg", "azimuth_last_deg"].map(|name| number(row, name));
                let extent = (last - first).rem_euclid(360.0);
                for azimuth_deg in &of.azimuths_deg {
                    let behind = (azimuth_deg - first + 0.5).rem_euclid(360.0) - 0.5;
                    assert!(
                        (-0.4..=extent + 0.4).contains(&behind),
                        "{behind} of {extent}: {row:?}"
                    );
                }
                compared += 1;
            }
        }
        assert!(
            compared > 300 && segments.is_empty(),
            "{compared} segments, {segments:?} of no sweep"
        );
    }
}

#[test]
fn segments_in_json_are_those_in_csv_and_only_of_sweeps_that_are_written() {
    let folder = Folder::new("segments-json");
    let capture = fixture("street_vlp16_losses.pcap");
    for partial in [&[][..], &["--partial"]] {
        let [table, lines] = ["all.csv", "all.jsonl"].map(|name| folder.path(name));
        replay(
            &capture,
            &[&["--force", "--segments", table.to_str().unwrap()], partial].concat(),
        )
        .done();
        replay(
            &capture,
            &[&["--force", "--segments", lines.to_str().unwrap()], partial].concat(),
        )
        .done();
        let lines = std::fs::read_to_string(&lines).unwrap();
        let rows = csv(&table);
        assert!(rows.len() > 20 && rows.len() == lines.lines().count());
        for (row, line) in rows.iter().zip(lines.lines()) {
            let line: Row = (serde_json::from_str::<serde_json::Map<_, _>>(line)
                .unwrap()
                .iter())
            .map(|(name, value)| {
                (
                    name.clone(),
                    value
                        .as_str()
                        .map_or_else(|| value.to_string(), str::to_owned),
                )
            })
            .collect();
            assert!(row.keys().eq(line.keys()));
            for (name, value) in row {
                assert!(
                    *value == line[name] || number(row, name) == number(&line, name),
                    "{name}: {row:?} {line:?}"
                );
            }
        }
        let sweeps: std::collections::BTreeSet<&String> =
            rows.iter().map(|row| &row["seq"]).collect();
        assert_eq!(sweeps.len(), if partial.is_empty() { 3 } else { 5 });
        // The same on standard output, where nothing else is then.
        let stdout = replay(&capture, &[&["--segments", "-"], partial].concat()).done();
        assert_eq!(stdout, lines);
    }
}

#[test]
fn a_name_that_says_no_format_is_refused() {
    let folder = Folder::new("segments-refused");
    let capture = fixture("street_vlp16_losses.pcap");
    for name in ["segments.txt", "segments", "csv", ".csv", "a.CSV"] {
        let path = folder.path(name);
        let ran = replay(&capture, &["--segments", path.to_str().unwrap()]);
        ran.says(&["--segments", name, "ends in .jsonl or .csv"]);
        assert!(ran.stdout.is_empty() && !path.exists());
    }
    replay(&capture, &["--segments", "-", "--json"])
        .says(&["--segments - and --json", "give --segments a file"]);
    let none = folder.path("none/a.csv");
    replay(&capture, &["--segments", none.to_str().unwrap()]).says(&["cannot write", "none/a.csv"]);
}
