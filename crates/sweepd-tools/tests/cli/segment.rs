//! `sweepd segment`: what it refuses, and jobs side by side.

use crate::from_cloud::cloud_of_rows;
use crate::{Folder, Ran, command, sweepd};

#[test]
fn clouds_with_several_jobs_have_the_labels_of_one() {
    let folder = Folder::new("jobs-clouds");
    let clouds: Vec<String> = (2..9)
        .map(|rows| {
            let cloud = cloud_of_rows(0..rows * 8 - 1);
            let path = folder.write(&format!("{rows}.bin"), cloud);
            path.display().to_string()
        })
        .collect();
    let clouds: Vec<&str> = clouds.iter().map(String::as_str).collect();
    let with = |jobs: &str, clouds: &[&str]| {
        let out = folder.path("out");
        let options = ["--out", out.to_str().unwrap(), "--force", "--jobs", jobs];
        sweepd(&[&["segment"], clouds, &options].concat())
    };
    let expected = with("1", &clouds).done();
    let labels = folder.files("out");
    assert_eq!(labels.len(), clouds.len());
    for jobs in ["2", "3", "256"] {
        assert_eq!(with(jobs, &clouds).done(), expected, "{jobs} jobs");
        assert!(folder.files("out") == labels, "{jobs} jobs");
    }
    // One that cannot be read is the one error, and no cloud behind it is segmented.
    let bad = folder.write("bad.bin", [0; 17]).display().to_string();
    let with_bad = [&clouds[..3], &[&bad], &clouds[3..]].concat();
    for jobs in ["1", "3"] {
        std::fs::remove_dir_all(folder.path("out")).unwrap();
        let ran = with(jobs, &with_bad);
        ran.says(&["bad.bin", "17 bytes"]);
        assert!(expected.starts_with(&ran.stdout), "{jobs} jobs");
        assert_eq!(folder.files("out").len(), 3, "{jobs} jobs");
    }
}

/// The expected labels are those of the options that say the same.
#[test]
fn a_configuration_gives_the_settings_of_its_sensor() {
    let folder = Folder::new("configured-clouds");
    let cloud = folder.write("8.bin", cloud_of_rows(0..63));
    let cloud = cloud.to_str().unwrap();
    let config = "[[sensor]]\nname = 'roof'\naddress = '10.0.0.7'\nsegment = { method = 'paper', min_points = 2 }\n\
                  [[sensor]]\nname = 'rear'\naddress = '10.0.0.8'\n";
    let config = folder.write("robot.toml", config).display().to_string();
    let labels = |options: &[&str]| {
        let out = folder.path("out").display().to_string();
        let all = ["segment", cloud, "--force", "--out", &out];
        sweepd(&[&all, options].concat()).done();
        folder.files("out")
    };
    let configured = labels(&["--config", &config, "--sensor", "roof"]);
    assert!(configured == labels(&["--method", "paper", "--min-points", "2"]));
    assert!(configured != labels(&[]));
    let over = [
        "--config",
        &config,
        "--sensor",
        "roof",
        "--min-points",
        "10",
        "--method",
        "slope",
    ];
    assert!(labels(&over) == labels(&[]));
    sweepd(&["segment", cloud, "--out", "out", "--config", &config]).says(&[
        "several sensors",
        "--sensor NAME",
        "roof (10.0.0.7), rear (10.0.0.8)",
    ]);
}

#[test]
fn a_number_of_jobs_that_cannot_be_meant_is_one_error() {
    for jobs in ["0", "257", "-1", "two", "1.5"] {
        let given = format!("--jobs={jobs}");
        sweepd(&["segment", "a.bin", "--out", "out", &given]).says(&["--jobs <N>", jobs]);
    }
}

#[test]
fn clouds_that_cannot_be_meant_are_refused_before_they_are_segmented() {
    let folder = Folder::new("clouds");
    let out = folder.path("labels");
    let segment = |args: &[&str]| {
        let args = [
            &["segment", "--force", "--out", out.to_str().unwrap()],
            args,
        ]
        .concat();
        Ran::of(command(&args).output().unwrap())
    };
    let empty = folder.write("empty.bin", "");
    for method in ["slope", "paper"] {
        segment(&[empty.to_str().unwrap(), "--method", method]).done();
        assert_eq!(std::fs::read(out.join("empty.label")).unwrap(), [0_u8; 0]);
    }
    let odd = folder.write("odd.bin", [0_u8; 17]);
    segment(&[odd.to_str().unwrap()]).says(&["odd.bin", "17 bytes", "multiple of 16"]);
    std::fs::create_dir_all(folder.path("seq")).unwrap();
    let twin = folder.write("seq/empty.bin", "");
    segment(&[empty.to_str().unwrap(), twin.to_str().unwrap()]).says(&[
        "empty.label",
        "both be written",
        "--out",
    ]);
    segment(&[folder.path("none.bin").to_str().unwrap()]).says(&["cannot read", "none.bin"]);
    let left_and_right = [1.0_f32, 0.1, 0.0, 0.0, 1.0, -0.1, 0.0, 0.0]
        .map(f32::to_le_bytes)
        .concat()
        .repeat(200);
    let mixed = folder.write("mixed.bin", left_and_right);
    let mixed = mixed.to_str().unwrap();
    segment(&[mixed]).says(&[
        "mixed.bin",
        "ring after ring",
        "--model MODEL",
        "--rows-table FILE",
    ]);
    segment(&[mixed, "--model", "vlp16"]).done();
    assert_eq!(
        std::fs::read(out.join("mixed.label")).unwrap().len(),
        4 * 400
    );
    segment(&[mixed, "--model", "hdl64e-s2"]).says(&[
        "each unit has beams of its own",
        "--calibration",
        "--rows-table",
    ]);
    let rows = folder.write("rows.txt", "2\n3 # wrong\n");
    segment(&[mixed, "--rows-table", rows.to_str().unwrap()]).says(&[
        "rows.txt",
        "line 2",
        "not below",
    ]);
    let cut = folder.write("cut.ply", "ply\nformat ascii 1.0\n");
    segment(&[cut.to_str().unwrap()]).says(&["cut.ply", "line 2", "end_header"]);
    // What may be the truth is not written over.
    let truth = folder.write("seq/empty.label", "true");
    let beside = [
        "segment",
        twin.to_str().unwrap(),
        "--out",
        truth.parent().unwrap().to_str().unwrap(),
    ];
    Ran::of(command(&beside).output().unwrap()).says(&["empty.label", "true labels", "--out"]);
    assert_eq!(std::fs::read(&truth).unwrap(), b"true");
    let odd = folder.write("cloud.xyz", "1 2 3\n");
    segment(&[odd.to_str().unwrap()]).says(&["cloud.xyz", "--format"]);
}
