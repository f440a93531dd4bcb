//! `sweepd score`: by hand on a small made scene, against an evaluator by others on real scans, and
//! over methods.

use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use serde_json::Value;
use sweepd::segment::Config;
use sweepd_lab::cloud::{COLUMNS, CloudSegmenter};
use sweepd_lab::score::{Baseline, Group, InstanceCounts, ScanScore, Summary, Truth};
use tempfile::{Builder, TempDir};

/// A folder that goes with the test.
struct Folder(TempDir);

impl Folder {
    fn new(test: &str) -> Self {
        let prefix = format!("sweepd-score-{test}-");
        let folder = Builder::new().prefix(&prefix).tempdir();
        Self(folder.unwrap())
    }

    fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    /// Writes a file, in a folder of it that need not be there.
    fn write(&self, name: &str, bytes: impl AsRef<[u8]>) {
        let path = self.path(name);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(path, bytes).unwrap();
    }

    /// Writes a cloud and its true labels.
    fn scan(&self, name: &str, points: &[[f32; 4]], truth: &[u32]) {
        self.write(&format!("scans/{name}.bin"), cloud_bytes(points));
        self.write(&format!("scans/{name}.label"), label_bytes(truth));
    }

    /// Runs `sweepd score --scans SCANS` with more options.
    fn run(&self, options: &[&str]) -> Output {
        let mut command = Command::new(env!("CARGO_BIN_EXE_sweepd-lab"));
        command
            .current_dir(self.0.path())
            .args(["score", "--scans", "scans"])
            .args(options)
            .output()
            .unwrap()
    }

    /// The JSON of a run that did all that it should.
    #[track_caller]
    fn json(&self, options: &[&str]) -> Value {
        let output = self.run(&[options, &["--json"]].concat());
        assert_eq!(String::from_utf8_lossy(&output.stderr), "");
        serde_json::from_slice(&output.stdout).unwrap()
    }

    /// Fails unless a run fails with one error that holds all of `parts`.
    #[track_caller]
    fn refuses(&self, options: &[&str], parts: &[&str]) {
        self.ends_with(1, options, parts);
    }

    /// The same, with another exit code.
    fn ends_with(&self, code: i32, options: &[&str], parts: &[&str]) {
        let output = self.run(options);
        let said = String::from_utf8(output.stderr).unwrap();
        assert_eq!(
            (output.status.code(), said.lines().count()),
            (Some(code), 1),
            "{said}"
        );
        let lacking: Vec<_> = parts.iter().filter(|part| !said.contains(**part)).collect();
        assert!(
            said.starts_with("error: ") && lacking.is_empty(),
            "{said}lacks {lacking:?}"
        );
    }
}

fn cloud_bytes(points: &[[f32; 4]]) -> Vec<u8> {
    points
        .iter()
        .flatten()
        .flat_map(|value| value.to_le_bytes())
        .collect()
}

fn label_bytes(labels: &[u32]) -> Vec<u8> {
    labels
        .iter()
        .flat_map(|label| label.to_le_bytes())
        .collect()
}

fn thing(class: u32, instance: u32) -> u32 {
    instance << 16 | class
}

/// Heaps of points far apart from each other: of each its true label, and how many points have
/// which label.
fn heaps(heaps: &[(u32, &[(usize, u32)])]) -> (Vec<[f32; 4]>, Vec<u32>, Vec<u32>) {
    let (mut points, mut truth, mut labels) = (Vec::new(), Vec::new(), Vec::new());
    for (at, (class, parts)) in heaps.iter().enumerate() {
        for &(count, label) in *parts {
            labels.extend(std::iter::repeat_n(label, count));
        }
        for index in 0..labels.len() - truth.len() {
            points.push([10.0 * at as f32, 0.02 * index as f32, 0.5, 0.0]);
        }
        truth.resize(labels.len(), *class);
    }
    (points, truth, labels)
}

/// Two things found, each mixed with something else; 215 points.
fn good() -> (Vec<[f32; 4]>, Vec<u32>, Vec<u32>) {
    heaps(&[
        (40, &[(50, 1), (6, 2), (4, 0)]),
        (thing(10, 1), &[(30, 2), (10, 3)]),
        (thing(30, 2), &[(25, 4)]),
        (50, &[(20, 4), (10, 0)]),
        (72, &[(15, 1), (5, 3)]),
        (70, &[(4, 1), (8, 5)]),
        (0, &[(3, 1), (5, 0)]),
        (1, &[(2, 1), (3, 5)]),
        (252, &[(15, 6)]),
    ])
}

/// Three things missed: two in one segment with a wall, one by half of its points.
fn bad() -> (Vec<[f32; 4]>, Vec<u32>, Vec<u32>) {
    heaps(&[
        (thing(10, 1), &[(24, 2)]),
        (thing(10, 2), &[(20, 2)]),
        (50, &[(60, 2)]),
        (thing(18, 3), &[(11, 9), (11, 0)]),
    ])
}

fn score(
    (points, truth, labels): &(Vec<[f32; 4]>, Vec<u32>, Vec<u32>),
    min_points: &[u32],
) -> ScanScore {
    ScanScore::new(
        &Truth::new(points, truth.clone()).unwrap(),
        labels,
        min_points,
    )
    .unwrap()
}

#[track_caller]
fn near(name: &str, found: impl Into<Option<f64>>, expected: impl Into<Option<f64>>) {
    let (found, expected) = (found.into(), expected.into());
    let same = match (found, expected) {
        (Some(found), Some(expected)) => (found - expected).abs() < 1e-9,
        (found, expected) => found == expected,
    };
    assert!(same, "{name}: {found:?}, expected {expected:?}");
}

/// Entropy of a heap of which a share is one thing, and the rest another.
fn entropy(share: f64) -> f64 {
    -share * share.ln() - (1.0 - share) * (1.0 - share).ln()
}

#[test]
fn ground_by_hand() {
    let score = score(&good(), &[]);
    // 80 points are ground, of which 65 were taken for it, and so were 6 of the 127 others that
    // have a class.
    let of = [65.0 / 71.0, 65.0 / 80.0, 130.0 / 151.0, 186.0 / 207.0];
    // Without 12 of vegetation and 5 outliers, among them all 6.
    let no_vegetation = [1.0, 65.0 / 80.0, 130.0 / 145.0, 175.0 / 190.0];
    // Without 20 of terrain, 15 found.
    let paved = [1.0, 50.0 / 60.0, 100.0 / 110.0, 160.0 / 170.0];
    for (found, expected) in [
        (score.ground, of),
        (score.ground_no_vegetation, no_vegetation),
        (score.ground_paved, paved),
    ] {
        near("precision", found.precision, expected[0]);
        near("recall", found.recall, expected[1]);
        near("f1", found.f1, expected[2]);
        near("accuracy", found.accuracy, expected[3]);
    }
}

#[test]
fn entropies_by_hand() {
    let found = score(&good(), &[]).entropy;
    // Five objects: the road and the terrain are ground, eight points have no class, five outliers
    // are too few.
    let scattered = [
        (40.0, entropy(0.25)),
        (25.0, 0.0),
        (30.0, entropy(1.0 / 3.0)),
        (12.0, entropy(1.0 / 3.0)),
        (15.0, 0.0),
    ];
    let sum: f64 = scattered.iter().map(|(_, entropy)| entropy).sum();
    near("ose", found.ose, sum);
    near("ose per object", found.ose_per_object, sum / 5.0);
    near(
        "ose per point",
        found.ose_per_point,
        scattered.iter().map(|(n, e)| n * e).sum::<f64>() / 122.0,
    );
    near("cover", found.cover, 108.0 / 122.0);
    // Segments 2 to 6: with 6 of 36 on the road, 5 of 15 on terrain, 20 of 45 of a building, 3 of
    // 11 outliers.
    let mixed = [
        (36.0, entropy(1.0 / 6.0)),
        (15.0, entropy(1.0 / 3.0)),
        (45.0, entropy(4.0 / 9.0)),
        (11.0, entropy(3.0 / 11.0)),
    ];
    let sum: f64 = mixed.iter().map(|(_, entropy)| entropy).sum();
    near("use", found.use_, sum);
    near("use per segment", found.use_per_segment, sum / 5.0);
    near(
        "use per point",
        found.use_per_point,
        mixed.iter().map(|(n, e)| n * e).sum::<f64>() / 122.0,
    );
    assert_eq!((found.objects, found.segments), (5, 5));
}

#[test]
fn instances_by_hand() {
    let score = score(&good(), &[10, 20, 30]);
    let [ten, twenty, thirty] = &score.instances[..] else {
        panic!("three sizes")
    };
    // The best segment of the car has 30 points of 40 and 6 others; that of the person all 25 and
    // 20 others.
    let (car, person) = (30.0 / 46.0, 25.0 / 45.0);
    let found = InstanceCounts {
        min_points: 20,
        count: 2,
        found_50: 2,
        over: 1,
        iou_sum: car + person,
        found_iou_sum: car + person,
        association_sum: twenty.association_sum,
        ..InstanceCounts::default()
    };
    assert_eq!(*twenty, found);
    near(
        "association",
        twenty.association_sum,
        0.75 * car + 0.25 * 10.0 / 45.0 + person,
    );
    near("rq", twenty.recognition_quality(), 1.0);
    near("pq", twenty.panoptic_quality(), (car + person) / 2.0);
    // Segment 3 has 15 points, 10 of the car. Segment 6 is of things that nobody told apart.
    assert_eq!(
        *ten,
        InstanceCounts {
            min_points: 10,
            false_positives: 1,
            ..found
        }
    );
    near("rq", ten.recognition_quality(), 2.0 / 2.5);
    // The person is too small to count; the segment on it is no false positive for that.
    assert_eq!(
        (thirty.count, thirty.found_50, thirty.false_positives),
        (1, 1, 0)
    );
}

#[test]
fn merged_and_missed_by_hand() {
    let bad = score(&bad(), &[20, 21, 200]);
    let [all, two, none] = &bad.instances[..] else {
        panic!("three sizes")
    };
    assert_eq!((all.count, all.found_50, all.under, all.over), (3, 0, 2, 0));
    // Half of the points in no segment is missed; an IoU of a half is not found.
    assert_eq!(
        (all.missed, all.merged_background, all.false_positives),
        (1, 2, 0)
    );
    near("mean iou", all.iou_sum, 24.0 / 104.0 + 20.0 / 104.0 + 0.5);
    near(
        "association",
        all.association_sum,
        24.0 / 104.0 + 20.0 / 104.0 + 0.25,
    );
    near("pq", all.panoptic_quality(), 0.0);
    near("sq", all.segmentation_quality(), None);
    // Without the smaller car nothing is merged with another one that counts.
    assert_eq!((two.count, two.under, two.merged_background), (2, 0, 1));
    assert_eq!((none.count, none.panoptic_quality()), (0, None));
    near("ground precision", bad.ground.precision, None);
    near("ground accuracy", bad.ground.accuracy, 1.0);
}

/// What is nearer than a metre is one object, if the label is the same; at a metre it is two; nine
/// points are none.
#[test]
fn objects_by_hand() {
    let heap = |x: f32, count: usize| (0..count).map(move |at| [x, 0.0625 * at as f32, 0.0, 0.0]);
    let points: Vec<[f32; 4]> = [(0.0, 12), (0.96875, 12), (1.96875, 12), (2.5, 12), (9.0, 9)]
        .iter()
        .flat_map(|&(x, count)| heap(x, count))
        .collect();
    let labels = |each: [u32; 5]| -> Vec<u32> {
        each.iter()
            .zip([12, 12, 12, 12, 9])
            .flat_map(|(&label, count)| std::iter::repeat_n(label, count))
            .collect()
    };
    let objects = |each| -> Vec<u32> {
        let truth = Truth::new(&points, labels(each)).unwrap();
        [0, 12, 24, 36, 48]
            .map(|first| truth.objects()[first])
            .to_vec()
    };
    assert_eq!(objects([50; 5]), [1, 1, 2, 2, 0]);
    assert_eq!(objects([50, 51, 51, 51, 51]), [1, 2, 3, 3, 0]);
    assert_eq!(
        objects([thing(10, 2), thing(10, 1), 40, 0, 50]),
        [2, 1, 0, 0, 0]
    );
}

/// Frame 1 of sequence a again, and a bad one of sequence b.
#[test]
fn means_by_hand() {
    let folder = Folder::new("means");
    for (name, (points, truth, labels)) in [("a/0", good()), ("a/1", good()), ("b/0", bad())] {
        folder.scan(name, &points, &truth);
        folder.write(&format!("pred/{name}.label"), label_bytes(&labels));
    }
    let report = folder.json(&["--pred", "pred", "--min-points", "20", "--per-scan"]);
    assert_eq!(
        (&report["scans"], &report["sequences"]),
        (&Value::from(3), &Value::from(2))
    );
    let row = |name: &str| &report["figures"]["instances_20"][name];
    near("mean", row("found_50")["mean"].as_f64(), 2.0 / 3.0);
    near("std", row("found_50")["std"].as_f64(), (2f64 / 9.0).sqrt());
    near("sequences", row("found_50")["sequence_mean"].as_f64(), 0.5);
    near("pooled", row("found_50")["pooled"].as_f64(), 4.0 / 7.0);
    near("count", row("count")["pooled"].as_f64(), 7.0);
    // Four found, three not.
    let (car, person) = (30.0 / 46.0, 25.0 / 45.0);
    near("rq", row("rq")["pooled"].as_f64(), 4.0 / 5.5);
    near(
        "pq",
        row("pq")["pooled"].as_f64(),
        4.0 / 5.5 * (car + person) / 2.0,
    );
    // There is none of what was not found.
    near(
        "sq",
        row("sq")["sequence_mean"].as_f64(),
        (car + person) / 2.0,
    );
    near("std", row("sq")["std"].as_f64(), 0.0);
    let scans: Vec<&str> = report["per_scan"]
        .as_array()
        .unwrap()
        .iter()
        .map(|scan| scan["scan"].as_str().unwrap())
        .collect();
    assert_eq!(scans, ["a/0", "a/1", "b/0"]);
    assert!(report["per_scan"][2]["figures"]["instances_20"]["sq"].is_null());

    let table = String::from_utf8(folder.run(&["--pred", "pred", "--per-scan"]).stdout).unwrap();
    assert!(table.starts_with("3 scans of 2 sequences\n"), "{table}");
    for line in [
        "  found 50                     0.6667   0.4714     0.5000   0.5714\n",
        "  sq                                -        -          -        -\n",
    ] {
        assert!(table.contains(line), "{line}{table}");
    }
    let scan = table
        .lines()
        .last()
        .unwrap()
        .split_whitespace()
        .collect::<Vec<_>>()
        .join(" ");
    assert!(
        scan.starts_with("b/0 - ") && scan.ends_with(" 3 0.000 0.000 0 - -"),
        "{scan}"
    );
}

/// Clouds in velodyne, true labels in labels, another suffix, some sequences alone.
#[test]
fn the_folders_of_semantickitti_are_known() {
    let folder = Folder::new("layout");
    let (points, truth, labels) = good();
    for sequence in ["00", "01"] {
        folder.write(
            &format!("scans/sequences/{sequence}/velodyne/000003.bin"),
            cloud_bytes(&points),
        );
        folder.write(
            &format!("scans/sequences/{sequence}/labels/000003.label"),
            label_bytes(&truth),
        );
        folder.write(
            &format!("scans/sequences/{sequence}/velodyne/000004.bin"),
            cloud_bytes(&points),
        );
    }
    folder.write("pred/sequences/01/000003.seg", label_bytes(&labels));
    let output = folder.run(&[
        "--pred",
        "pred",
        "--ext",
        ".seg",
        "--only",
        "01",
        "--json",
        "--per-scan",
    ]);
    let warning = "warning: 1 cloud without true labels (NAME.label beside NAME.bin) left out\n";
    assert_eq!(String::from_utf8_lossy(&output.stderr), warning);
    let report: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(report["per_scan"][0]["scan"], "sequences/01/000003");
    near(
        "f1",
        report["figures"]["ground"]["f1"]["mean"].as_f64(),
        130.0 / 151.0,
    );
}

#[test]
fn what_cannot_be_scored_is_named_with_its_cure() {
    let folder = Folder::new("errors");
    let (points, truth, labels) = good();
    folder.scan("00/000000", &points, &truth);
    let pred = &["--pred", "pred"][..];
    folder.refuses(
        pred,
        &[
            "pred/00/000000.label: no labels",
            "sweepd segment scans/00/000000.bin --out pred/00",
            "--only",
        ],
    );
    folder.write("pred/00/000000.label", label_bytes(&labels[1..]));
    folder.refuses(
        pred,
        &[
            "pred/00/000000.label: 214 labels for 215 points of scans/00/000000.bin",
            "make them again",
        ],
    );
    folder.write("pred/00/000000.label", [0; 7]);
    folder.refuses(pred, &["pred/00/000000.label: 7 bytes", "multiple of 4"]);
    folder.refuses(
        &["--pred", "scans"],
        &["scans/00/000000.label: these are the true labels", "--pred"],
    );
    folder.refuses(
        &["--pred", "pred", "--only", "00,07"],
        &["no scan is named by --only 07"],
    );
    folder.refuses(
        &["--pred", "pred", "--only", "0"],
        &["no scan is named by --only 0;"],
    );
    folder.write("pred/00/000000.label", label_bytes(&labels));
    folder.json(pred);
    folder.scan("00/000000", &points, &truth[1..]);
    folder.refuses(
        pred,
        &[
            "scans/00/000000.label: 214 true labels for 215 points of scans/00/000000.bin",
            "release",
        ],
    );
    folder.write("scans/00/000000.bin", [0; 17]);
    folder.refuses(pred, &["scans/00/000000.bin: 17 bytes", "multiple of 16"]);
    std::fs::remove_dir_all(folder.path("scans/00")).unwrap();
    folder.refuses(pred, &["scans: no scans", "NAME.bin"]);
    std::fs::remove_dir_all(folder.path("scans")).unwrap();
    folder.ends_with(66, pred, &["cannot read scans"]);
    folder.scan("00/000000", &points, &truth);
    folder.refuses(&["--methods", "--theta", "0"], &["theta is 0 degrees"]);
    folder.refuses(
        &["--methods", "--columns", "0"],
        &["0 columns, expected 1 to"],
    );
    folder.refuses(
        &["--methods", "--plot", "nowhere/precision.csv"],
        &["nowhere/precision.csv"],
    );
    for wrong in [
        &[][..],
        &["--pred", "pred", "--plot", "precision.csv"],
        &["--methods", "--plot", "precision.png"],
        &["--pred", "pred", "--methods"],
        &["--pred", "pred", "--theta", "5"],
        &["--methods", "--per-scan"],
        &["--methods", "--ext", ".seg"],
    ] {
        assert_eq!(folder.run(wrong).status.code(), Some(2), "{wrong:?}");
    }
}

/// Seven cylinders on a plane, 10 m from the sensor and 7.6 m or more apart, with a true label for
/// every point.
fn cylinders() -> (Vec<[f32; 4]>, Vec<u32>) {
    let (mut points, mut truth) = (Vec::new(), Vec::new());
    for ring in 0..32 {
        let elevation = (2.0 - 0.8 * f64::from(ring)).to_radians();
        for firing in 0..720 {
            // Azimuth grows counter-clockwise from behind, as in KITTI's files.
            let azimuth = (-180.0 + 0.5 * (f64::from(firing) + 0.5)).to_radians();
            let near = (0..7).find_map(|number| {
                let aside = azimuth - (f64::from(number) - 3.0) * std::f64::consts::TAU / 8.0;
                let reach = 0.64 - (10.0 * aside.sin()).powi(2);
                (aside.cos() > 0.0 && reach > 0.0)
                    .then(|| (10.0 * aside.cos() - reach.sqrt(), number))
            });
            let ground_m = -1.73 / elevation.tan();
            let (level_m, label) = match near {
                Some((level_m, number)) if elevation >= 0.0 || level_m < ground_m => {
                    (level_m, thing(10, number + 1))
                }
                _ if elevation < 0.0 && ground_m < 60.0 => (ground_m, 40),
                _ => continue,
            };
            points.push(
                [
                    level_m * azimuth.cos(),
                    level_m * azimuth.sin(),
                    level_m * elevation.tan(),
                    0.0,
                ]
                .map(|v| v as f32),
            );
            truth.push(label);
        }
    }
    (points, truth)
}

/// Every method finds what stands apart with a parameter that suits it, and nothing with one that
/// does not.
#[test]
fn methods_are_compared_over_their_parameters() {
    let folder = Folder::new("methods");
    let (points, truth) = cylinders();
    folder.scan("a/0", &points, &truth);
    folder.scan("b/0", &points, &truth);
    let options = [
        "--methods",
        "--columns",
        "720",
        "--theta",
        "10,89",
        "--distance",
        "0.5,9",
        "--cell",
        "0.5,9",
    ];
    let plotted = [&options[..], &["--plot", "precision.csv"]].concat();
    let report = folder.json(&plotted);
    // Seven cylinders in each of two scans.
    let plot = "\
method,parameter,unit,value,min_points,instances,precision
slope,theta,degrees,10,20,14,1
slope,theta,degrees,89,20,14,1
paper,theta,degrees,10,20,14,1
paper,theta,degrees,89,20,14,0
euclidean,distance,m,0.5,20,14,1
euclidean,distance,m,9,20,14,0
grid,cell,m,0.5,20,14,1
grid,cell,m,9,20,14,0
";
    let read = || std::fs::read_to_string(folder.path("precision.csv")).unwrap();
    assert_eq!(read(), plot);
    folder.refuses(&plotted, &["precision.csv exists; --force replaces it"]);
    assert_eq!(read(), plot);
    assert_eq!(
        (&report["scans"], &report["sequences"]),
        (&Value::from(2), &Value::from(2))
    );
    let found: Vec<(String, f64)> = (report["methods"].as_array().unwrap().iter())
        .map(|line| {
            assert!(line["ms"].as_f64().unwrap() > 0.0);
            let name = format!(
                "{} {} {}",
                line["method"].as_str().unwrap(),
                line["parameter"].as_str().unwrap(),
                line["value"]
            );
            (
                name,
                line["figures"]["instances_20"]["found_50"]["pooled"]
                    .as_f64()
                    .unwrap(),
            )
        })
        .collect();
    let expected = [
        ("slope theta 10.0", 1.0),
        // The default has no theta.
        ("slope theta 89.0", 1.0),
        ("paper theta 10.0", 1.0),
        ("paper theta 89.0", 0.0),
        ("euclidean distance 0.5", 1.0),
        ("euclidean distance 9.0", 0.0),
        ("grid cell 0.5", 1.0),
        ("grid cell 9.0", 0.0),
    ];
    assert_eq!(
        found,
        expected.map(|(name, share)| (name.to_owned(), share))
    );

    let table = String::from_utf8(folder.run(&options).stdout).unwrap();
    let lines: Vec<Vec<&str>> = table
        .lines()
        .map(|line| line.split_whitespace().collect())
        .collect();
    assert!(
        lines
            .iter()
            .any(|line| line.starts_with(&["euclidean", "0.5", "1.000"])),
        "{table}"
    );
    assert!(
        lines
            .iter()
            .any(|line| line.starts_with(&["grid", "9", "0.000"])),
        "{table}"
    );
}

#[test]
fn baselines_by_hand() {
    let at = |x: f32, y: f32| [x, y, 0.0, 0.0];
    let points = [
        at(0.1, 0.1),
        at(0.6, 0.1),
        at(5.0, 5.0),
        at(0.9, 0.5),
        at(2.6, 0.1),
        at(1.3, 1.4),
    ];
    let ground = [0, 7, 1, 0, 0, 0];
    let segment = |baseline: Baseline, min_points| baseline.segment(&points, &ground, min_points);
    let euclidean = Baseline::Euclidean { distance_m: 0.6 };
    assert_eq!(segment(euclidean, 1), [2, 2, 1, 2, 3, 4]);
    assert_eq!(segment(euclidean, 2), [2, 2, 1, 2, 0, 0]);
    // Cells (0, 0), (0, 0), (0, 0), (2, 0), (1, 1): the last one touches all others. Then (0, 0),
    // (1, 0), (2, 1), (6, 0) and (3, 3).
    assert_eq!(
        segment(Baseline::Grid { cell_m: 1.0 }, 1),
        [2, 2, 1, 2, 2, 2]
    );
    assert_eq!(
        segment(Baseline::Grid { cell_m: 0.4 }, 1),
        [2, 2, 1, 2, 3, 4]
    );
}

/// The shared scans of SemanticKITTI, linked into a folder, and the evaluator.
fn real(folder: &Folder) -> (std::ffi::OsString, PathBuf) {
    let data = sweepd_testkit::data_dir();
    let python = sweepd_testkit::python_with_numpy();
    let evaluator = data.join("../tools/segquality.py");
    std::os::unix::fs::symlink(
        data.join("labelled/semantickitti").canonicalize().unwrap(),
        folder.path("scans"),
    )
    .unwrap();
    (python, evaluator)
}

/// Sequences and frames among the shared scans.
fn frames(folder: &Folder) -> Vec<String> {
    let names = |path: &Path| -> Vec<String> {
        let entries = std::fs::read_dir(path).unwrap();
        let mut names: Vec<_> = entries
            .map(|entry| entry.unwrap().file_name().into_string().unwrap())
            .collect();
        names.sort();
        names
    };
    let scans = folder.path("scans");
    let sequences = names(&scans)
        .into_iter()
        .filter(|name| scans.join(name).is_dir());
    sequences
        .flat_map(|sequence| {
            let frames = names(&scans.join(&sequence)).into_iter();
            frames
                .filter_map(move |name| Some(format!("{sequence}/{}", name.strip_suffix(".bin")?)))
        })
        .collect()
}

/// Writes labels of our segmenter, changed by `change`.
fn predict(folder: &Folder, pred: &str, frames: &[String], mut change: impl FnMut(&mut [u32])) {
    for sequence in frames.chunk_by(|one, next| one[..2] == next[..2]) {
        let mut segmenter = CloudSegmenter::new(Config::default(), COLUMNS).unwrap();
        for name in sequence {
            let bytes = std::fs::read(folder.path(&format!("scans/{name}.bin"))).unwrap();
            let mut labels = segmenter.segment(&bytes).unwrap();
            change(&mut labels);
            folder.write(&format!("{pred}/{name}.label"), label_bytes(&labels));
        }
    }
}

/// Splits segments at random, joins others, swaps ground, and leaves points out.
fn perturb(random: &mut fastrand::Rng, labels: &mut [u32]) {
    let most = labels.iter().max().map_or(2, |&most| most.max(2));
    let new: Vec<[u32; 2]> = (0..=most)
        .map(|label| match (label, random.u32(..10)) {
            (0 | 1, _) | (_, 0..=3) => [label; 2],
            (_, 4..=6) => [label, label + most],
            (_, 7) => [random.u32(2..=most); 2],
            (_, 8) => [random.u32(..2), label],
            _ => [1_000_000_000 + label; 2],
        })
        .collect();
    for label in labels {
        *label = if random.u32(..50) == 0 {
            random.u32(..2)
        } else {
            new[*label as usize][random.usize(..2)]
        };
    }
}

/// Their names for our figures.
fn their_name(group: &str, name: &str) -> String {
    let prefix = match group {
        "ground" => "g_".to_owned(),
        "ground_no_vegetation" => "gv_".to_owned(),
        "ground_paved" => "gt_".to_owned(),
        "objects" => String::new(),
        _ => group.replace("instances_", "i") + "_",
    };
    let name = match name {
        "precision" => "p",
        "recall" => "r",
        "accuracy" => "acc",
        "use_per_segment" => "use_n",
        "use_per_point" => "use_h",
        "ose_per_object" => "ose_n",
        "ose_per_point" => "ose_h",
        "count" => "n",
        "found_50" => "foundI50",
        "found_70" => "foundI70",
        "merged_background" => "merged_bg",
        "mean_iou" => "meanIoU",
        "false_positives" => "fp",
        same => same,
    };
    prefix + name
}

/// Holds each of our figures against theirs; gives how many there were.
fn compare(ours: &Value, theirs: impl Fn(&str) -> Value, what: &str) -> usize {
    let mut compared = 0;
    for (group, figures) in ours.as_object().unwrap() {
        for (name, value) in figures.as_object().unwrap() {
            let their_name = their_name(group, name);
            let theirs = theirs(&their_name);
            let parts: Vec<(&str, &Value, &Value)> = match value {
                Value::Object(row) => row
                    .iter()
                    .map(|(part, value)| (&part[..], value, &theirs[part]))
                    .collect(),
                value => vec![("value", value, &theirs)],
            };
            // They count false positives over all scans only.
            for (part, ours, theirs) in parts
                .into_iter()
                .filter(|(part, ..)| name != "false_positives" || *part == "pooled")
            {
                let same = match (ours.as_f64(), theirs.as_f64()) {
                    (Some(ours), Some(theirs)) => {
                        (ours - theirs).abs() < 1e-9 * theirs.abs().max(1.0)
                    }
                    _ => ours.is_null() && theirs.is_null() && ours == theirs,
                };
                assert!(
                    same,
                    "{what}: {part} of {group} {name} is {ours}, {their_name} is {theirs}"
                );
                compared += 1;
            }
        }
    }
    compared
}

/// Scores with both; all figures of all scans, and all sums of them, are the same.
fn equal(
    folder: &Folder,
    python: &std::ffi::OsStr,
    evaluator: &Path,
    pred: &str,
    only: &[&str],
) -> usize {
    let theirs = folder.path("theirs.json");
    let output = Command::new(python)
        .arg(evaluator)
        .args([&folder.path("scans/"), &folder.path(pred)])
        .args(["--ext", ".label", "--gt-cache"])
        .arg(folder.path("cache"))
        .args(only)
        .arg("--json")
        .arg(&theirs)
        .output()
        .unwrap();
    assert!(
        output.status.success(),
        "{}",
        String::from_utf8_lossy(&output.stderr)
    );
    let theirs = std::fs::read_to_string(theirs)
        .unwrap()
        .replace("NaN", "null");
    let theirs: Value = serde_json::from_str(&theirs).unwrap();
    let ours = folder.json(&[&["--pred", pred, "--per-scan"], only].concat());
    let row = |name: &str| {
        let column = |column: &str| theirs[column].get(name).cloned().unwrap_or(Value::Null);
        let columns = [
            ("mean", "mean"),
            ("std", "std"),
            ("sequence_mean", "seq_mean"),
            ("pooled", "pooled"),
        ];
        Value::Object(
            columns
                .iter()
                .map(|(ours, theirs)| ((*ours).to_owned(), column(theirs)))
                .collect(),
        )
    };
    let mut compared = compare(&ours["figures"], row, pred);
    let scans = ours["per_scan"].as_array().unwrap();
    assert_eq!(scans.len(), theirs["scans"].as_array().unwrap().len());
    for (index, scan) in scans.iter().enumerate() {
        assert_eq!(scan["scan"], theirs["scans"][index]);
        let of_scan = |name: &str| theirs["per_scan"][index][name].clone();
        compared += compare(&scan["figures"], of_scan, scan["scan"].as_str().unwrap());
    }
    compared
}

#[test]
#[cfg_attr(
    any(without_captures, without_python),
    ignore = "no captures or no SWEEPD_PYTHON"
)]
fn equal_to_segquality_on_real_scans() {
    let folder = Folder::new("segquality");
    let (python, evaluator) = real(&folder);
    let frames = frames(&folder);
    assert!(frames.len() >= 18, "{} scans", frames.len());
    predict(&folder, "pred", &frames, |_| {});
    let figures = 12 + 9 + 2 * 13;
    // Of each scan all but two, of all scans four each, with pooled ones of instances.
    let expected = frames.len() * (figures - 2) + 3 * (figures - 2) + 2 * 13;
    assert_eq!(equal(&folder, &python, &evaluator, "pred", &[]), expected);
    for (seed, only) in [(1, &[][..]), (2, &["--only", "02,08/000004,10"])] {
        let mut random = fastrand::Rng::with_seed(seed);
        let pred = format!("perturbed-{seed}");
        predict(&folder, &pred, &frames, |labels| {
            perturb(&mut random, labels)
        });
        assert!(equal(&folder, &python, &evaluator, &pred, only) > figures * 5);
    }
    predict(&folder, "empty", &frames, |labels| labels.fill(0));
    assert!(
        equal(
            &folder,
            &python,
            &evaluator,
            "empty",
            &["--min-points", "1,50,100000"]
        ) > figures * 18
    );
}

/// What methods are said to reach is what their labels get when they are scored from files.
#[test]
#[cfg_attr(
    any(without_captures, without_python),
    ignore = "no captures or no SWEEPD_PYTHON"
)]
fn methods_are_scored_as_their_files_are() {
    let folder = Folder::new("files");
    real(&folder);
    let frames: Vec<String> = frames(&folder)
        .into_iter()
        .filter(|name| name < &"04".to_owned())
        .collect();
    predict(&folder, "pred", &frames, |_| {});
    let only = ["--only", "00,02"];
    let files = folder.json(&[&["--pred", "pred"][..], &only].concat());
    let options = [
        "--methods",
        "--theta",
        "10",
        "--distance",
        "0.5",
        "--cell",
        "0.3",
    ];
    let methods = folder.json(&[&options[..], &only].concat());
    assert_eq!(methods["methods"].as_array().unwrap().len(), 4);
    assert!(
        methods["methods"][0]["figures"] == files["figures"],
        "slope differs"
    );
    for plain in 2..4 {
        let line = &methods["methods"][plain];
        assert_eq!(
            line["figures"]["ground"], files["figures"]["ground"],
            "{}",
            line["method"]
        );
        assert!(
            line["figures"]["instances_20"]["pq"]["pooled"].as_f64() > Some(0.3),
            "{}",
            line["method"]
        );
    }
}

#[test]
fn a_summary_of_nothing_is_empty() {
    let summary = Summary::new(&[]);
    assert_eq!(
        (summary.scans, summary.sequences, summary.rows.len()),
        (0, 0, 0)
    );
    assert!(summary.row(Group::Objects, "use").is_none());
    let error = Truth::new(&[[0.0; 4]], Vec::new()).unwrap_err();
    assert_eq!(error.to_string(), "0 true labels for 1 points");
}
