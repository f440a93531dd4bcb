//! `simulate --truth`: every return of a replay has its truth, and every truth its return.

use std::collections::BTreeMap;
use std::path::Path;

use crate::simulate::simulate;
use crate::{Folder, replay, sweepd};

/// The lines of a CSV after the first, as fields.
fn csv(path: &Path) -> Vec<Vec<String>> {
    let text =
        std::fs::read_to_string(path).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
    text.lines()
        .skip(1)
        .map(|line| line.split(',').map(str::to_owned).collect())
        .collect()
}

fn number(field: &str) -> f64 {
    field.parse().expect(field)
}

/// What truth and replay join by: packet, block and channel. A block of 16 beams holds two firings,
/// one after the other.
type Joined = BTreeMap<(u64, u64, u64), Vec<Vec<String>>>;

fn joined(rows: Vec<Vec<String>>, channel: impl Fn(&[String]) -> u64, order: usize) -> Joined {
    let mut joined = Joined::new();
    for row in rows {
        let key = (
            number(&row[0]) as u64,
            number(&row[1]) as u64,
            channel(&row),
        );
        joined.entry(key).or_default().push(row);
    }
    joined
        .values_mut()
        .for_each(|rows| rows.sort_by_key(|row| row[order].parse::<u64>().unwrap()));
    joined
}

/// The returns of `--csv`, each with the truth of it; fails unless there is one for every return
/// and none is left over.
fn with_truth(
    folder: &Folder,
    channels: u64,
    options: &[&str],
    replay_options: &[&str],
) -> Vec<[Vec<String>; 2]> {
    let [capture, truth, returns] = ["made.pcap", "truth", "returns"].map(|name| folder.path(name));
    let _ = std::fs::remove_dir_all(&returns);
    let [to, truth_to, csv_to] = [&capture, &truth, &returns].map(|path| path.to_str().unwrap());
    simulate(&[options, &["--pcap", to, "--truth", truth_to]].concat());
    replay(
        &capture,
        &[&["--csv", csv_to, "--partial"], replay_options].concat(),
    )
    .done();
    let found = std::fs::read_dir(&returns)
        .unwrap()
        .flat_map(|entry| csv(&entry.unwrap().path()))
        .collect();
    let mut found = joined(found, |row| number(&row[4]) as u64, 13);
    let truth = joined(
        csv(&truth.join("truth.csv")),
        |row| number(&row[2]) as u64 % channels,
        2,
    );
    let mut both = Vec::new();
    for (key, truths) in truth {
        let returns = found.remove(&key).unwrap_or_default();
        assert_eq!(returns.len(), truths.len(), "{key:?}");
        both.extend(
            returns
                .into_iter()
                .zip(truths)
                .map(|(one, truth)| [one, truth]),
        );
    }
    assert!(found.is_empty(), "{found:?}");
    both
}

#[test]
fn every_return_of_a_replay_has_its_truth() {
    let folder = Folder::new("truth");
    let faults = "--loss=2 --duplicate=3 --reorder=3";
    for (channels, options) in [
        (16, "--model=vlp16 --scene=street"),
        (16, "--model=puck-hires --scene=room --returns=dual"),
        (32, "--model=hdl32e --scene=parking-lot"),
        (32, "--model=hdl32e --scene=street --returns=dual"),
    ] {
        let options: Vec<&str> = options
            .split(' ')
            .chain(faults.split(' '))
            .chain(["--seconds=0.25"])
            .collect();
        let both = with_truth(&folder, channels, &options, &["--gps-without-pps"]);
        let objects: BTreeMap<String, String> = csv(&folder.path("truth/objects.csv"))
            .into_iter()
            .map(|row| (row[0].clone(), row[1].clone()))
            .collect();
        assert!(both.len() > 20_000, "{}", both.len());
        for [found, truth] in both {
            assert!(
                (number(&found[8]) - number(&truth[5])).abs() < 0.07,
                "{found:?} {truth:?}"
            );
            let off_deg = (number(&found[6]) - number(&truth[6])).rem_euclid(360.0);
            assert!(off_deg.min(360.0 - off_deg) < 0.05, "{found:?} {truth:?}");
            // Each shot has its own time; the stamp of its packet is cut to the microsecond.
            let [found_ns, true_ns] =
                [&found[13], &truth[7]].map(|time_ns| time_ns.parse::<i64>().unwrap());
            assert!(
                (-1000..=0).contains(&(found_ns - true_ns)),
                "{found:?} {truth:?}"
            );
            assert_eq!(objects[&truth[3]], truth[4]);
        }
    }
}

#[test]
fn a_calibration_is_simulated_and_undone_by_the_same_one() {
    let folder = Folder::new("calibration");
    let elevations = [
        -15.2, 1.1, -13.2, 3.1, -11.2, 5.2, -9.25, 7.0, -7.25, 9.0, -5.3, 11.0, -3.3, 13.0, -1.3,
        15.0,
    ];
    let mut yaml = "num_lasers: 16\ndistance_resolution: 0.002\nlasers:\n".to_owned();
    for (id, elevation) in elevations.map(f64::to_radians).into_iter().enumerate() {
        yaml += &format!(
            "- {{laser_id: {id}, rot_correction: 0.0, vert_correction: {elevation}, dist_correction: 0.0, \
             vert_offset_correction: 0.02}}\n"
        );
    }
    let file = folder.write("unit.yaml", yaml);
    let file = ["--calibration", file.to_str().unwrap()];
    let options = [
        &["--model=vlp16", "--scene=room", "--seconds=0.2"][..],
        &file,
    ]
    .concat();
    // Metres that the floor, 0.9 m below the sensor, is off at the worst return of a hundred: at
    // the foot of things, a beam that meets both lies between the two.
    let off = |replay_options: &[&str]| {
        let both = with_truth(&folder, 16, &options, replay_options);
        let floor = both.iter().filter(|[_, truth]| truth[4] == "ground");
        let mut off: Vec<f64> = floor
            .map(|[found, _]| (number(&found[11]) + 0.9).abs())
            .collect();
        off.sort_by(f64::total_cmp);
        off[off.len() * 99 / 100]
    };
    let [with, without] = [off(&file), off(&[])];
    assert!(with < 0.015 && without > 0.03, "{with} {without}");

    let ran = sweepd(&[&["simulate", "--model=hdl32e", "--pcap", "-"], &file[..]].concat());
    ran.says(&[
        "--calibration",
        "unit.yaml",
        "does not fit the HDL-32E",
        "16 beams",
    ]);
}

/// By hand: what a sensor with its nose 10 degrees down sees of the floor lies on the plane
/// y sin -10 + z cos -10 = -0.4 of its axes; head down, z is turned over.
#[test]
fn the_floor_lies_below_a_mounted_sensor_as_its_height_and_tilt_say() {
    let folder = Folder::new("mounted");
    let (sin, cos) = (-10_f64).to_radians().sin_cos();
    for (options, up) in [
        (
            "--scene=warehouse --height=0.4 --pitch=-10",
            [0.0, sin, cos],
        ),
        (
            "--scene=corridor --height=0.4 --pitch=-10 --roll=180",
            [0.0, sin, -cos],
        ),
        ("--scene=room --height=0.4 --roll=-10", [-sin, 0.0, cos]),
    ] {
        let options: Vec<&str> = options
            .split(' ')
            .chain(["--model=vlp16", "--seconds=0.2"])
            .collect();
        let both = with_truth(&folder, 16, &options, &[]);
        let floor = both.iter().filter(|[_, truth]| truth[4] == "ground");
        let mut off: Vec<f64> = floor
            .map(|[found, _]| {
                let at = [9, 10, 11].map(|field| number(&found[field]));
                let height_m: f64 = at.iter().zip(up).map(|(at, up)| at * up).sum();
                (height_m + 0.4).abs()
            })
            .collect();
        off.sort_by(f64::total_cmp);
        // The foot of a thing is nearer to the sensor where a beam meets both.
        assert!(
            off.len() > 3_000 && off[off.len() * 98 / 100] < 0.02,
            "{options:?}: {} {:?}",
            off.len(),
            off.last()
        );
    }
}
