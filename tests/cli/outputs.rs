//! What comes out of a replay: JSON, tables, files.

use std::fs;
use std::ops::Range;
use std::path::Path;

use sweepd::admission::DiscoveredSensors;
use sweepd::buffers::{Buffers, HeapBuffers, Memory};
use sweepd::input::Capture;
use sweepd::pipeline::{Config, Pipeline};
use sweepd::sweep::layout::flags;
use sweepd::sweep::{Header, SweepRef};
use sweepd_testkit::stream::next_sweep;
use zerocopy::{FromBytes, IntoBytes};

use crate::{Folder, fixture, made, replay, sweepd, sweeps};
use sweepd_testkit::same::same;

const KEYS: [&str; 18] = [
    "sensor",
    "source",
    "model",
    "return_mode",
    "sequence",
    "seq",
    "partial",
    "rows",
    "columns",
    "missing_columns",
    "returns",
    "ground",
    "segments",
    "rpm",
    "lost_packets",
    "time_ns",
    "time_source",
    "stage_us",
];

/// The keys of a flat JSON object, in their order.
fn keys(line: &str) -> Vec<&str> {
    let (flat, nested) = line
        .split_once(":{")
        .map_or((line, None), |(flat, nested)| (flat, Some(nested)));
    let mut keys: Vec<&str> = flat
        .split(",\"")
        .filter_map(|pair| pair.trim_start_matches("{\"").split_once("\":"))
        .map(|(key, _)| key)
        .collect();
    if nested.is_some() {
        keys.push(flat.rsplit(",\"").next().unwrap().trim_end_matches('"'));
    }
    keys
}

#[test]
fn a_sweep_in_json_has_exactly_its_keys() {
    let capture = fixture("street_vlp16_losses.pcap");
    let stdout = replay(&capture, &["--json", "--partial"]).done();
    let lines: Vec<&str> = stdout.lines().collect();
    assert_eq!(lines.len(), 6);
    for line in &lines[..5] {
        assert_eq!(keys(line), KEYS);
        let stages = &serde_json::from_str::<serde_json::Value>(line).unwrap()["stage_us"];
        let names: Vec<&String> = stages.as_object().unwrap().keys().collect();
        assert_eq!(names, ["decode", "ground", "label"]);
    }
    assert!(lines[5].starts_with("{\"summary\":{"));
    let stdout = replay(&capture, &["--json", "--no-timing"]).done();
    let lines: Vec<&str> = stdout.lines().collect();
    assert_eq!((lines.len(), keys(lines[0])), (4, KEYS[..17].to_vec()));
    assert!(!stdout.contains("stage_us"));
    let sweep = &sweeps(&stdout)[1];
    for (key, value) in [
        ("sensor", "192.168.1.201:2368"),
        ("model", "VLP-16"),
        ("return_mode", "strongest"),
    ] {
        assert_eq!(sweep[key], value);
    }
    assert_eq!(
        (&sweep["seq"], &sweep["partial"], &sweep["rows"]),
        (&2.into(), &false.into(), &16.into())
    );
    assert_eq!(sweep["time_source"], "gps");
}

/// Less than a turn is no success, and leaves nothing behind; what there is, is written where it says.
#[test]
fn less_than_a_turn_names_the_option_that_gives_it() {
    let folder = Folder::new("less");
    let capture = fixture("street_vlp16.pcap.gz");
    let [pictures, mcap, segments, raw] =
        ["a/b", "drive.mcap", "all.csv", "all.raw"].map(|name| folder.path(name));
    let [pictures, mcap, segments, raw] =
        [&pictures, &mcap, &segments, &raw].map(|path| path.to_str().unwrap());
    let options = [
        "--end=0.05",
        "--png",
        pictures,
        "--mcap",
        mcap,
        "--segments",
        segments,
        "--raw",
        raw,
    ];
    replay(&capture, &options).says(&["no whole turn to 0.05 s", "--partial"]);
    for path in [
        Path::new(pictures).parent().unwrap(),
        mcap.as_ref(),
        segments.as_ref(),
        raw.as_ref(),
    ] {
        assert!(!path.exists(), "{}", path.display());
    }
    replay(&capture, &["--end=0.05", "--json"]).says(&["--partial"]);
    let bag = folder.path("deep/er/bag");
    let bag = ["--bag", bag.to_str().unwrap()];
    replay(&capture, &[&["--end=0.05"], &bag[..]].concat()).says(&["--partial"]);
    assert!(!folder.path("deep").exists());
    // Nor does what is no capture leave a folder.
    let no_capture = folder.path("no.pcap");
    fs::write(&no_capture, "hello").unwrap();
    for option in [["--png", pictures], bag] {
        replay(&no_capture, &option).says(&["no.pcap is no capture"]);
    }
    assert!(!Path::new(pictures).parent().unwrap().exists() && !folder.path("deep").exists());
    let said = replay(&capture, &[&options[..], &["--partial"]].concat()).done();
    let places = [pictures, mcap, segments, raw].join(", ");
    assert!(
        said.ends_with(&format!("\nwritten: 1 sweep to {places}\n")),
        "{said}"
    );
    // Where standard output is for lines, people are told on the other one.
    let lines = ["--json", "--partial", "--force", "--height=1.9"];
    let ran = replay(&capture, &[&options[..], &lines].concat());
    let told = format!("note: written: 1 sweep to {places}\n");
    assert_eq!((ran.code, ran.stderr), (0, told));
}

/// The number in a header is the one number: of files, of lines, of objects, and whether or not
/// partial sweeps are left out.
#[test]
fn a_sweep_has_one_number_everywhere() {
    let folder = Folder::new("numbers");
    let capture = fixture("street_vlp16_losses.pcap");
    let mut by_time = std::collections::BTreeMap::new();
    for partial in [&[][..], &["--partial"]] {
        let dir = folder.path(&format!("out{}", partial.len()));
        let raw = folder.path(&format!("{}.raw", partial.len()));
        let outputs = [
            "--json",
            "--csv",
            dir.to_str().unwrap(),
            "--raw",
            raw.to_str().unwrap(),
        ];
        let lines = sweeps(&replay(&capture, &[&outputs[..], partial].concat()).done());
        let lines = &lines[..lines.len() - 1];
        let segments = replay(&capture, &[&["--segments=-"], partial].concat()).done();
        let bytes = std::fs::read(&raw).unwrap();
        let mut at = 0;
        let mut names = Vec::new();
        for line in lines {
            let (header, _) = Header::read_from_prefix(&bytes[at..]).unwrap();
            at += header.total_bytes as usize;
            assert_eq!(
                (&line["sequence"], &line["seq"]),
                (&header.sequence.into(), &header.sequence.into())
            );
            assert_eq!(line["time_ns"], header.time_ns);
            let number = by_time.entry(header.time_ns).or_insert(header.sequence);
            assert_eq!(*number, header.sequence);
            let of_sweep = format!(
                "\"seq\":{},\"time_ns\":{},",
                header.sequence, header.time_ns
            );
            assert!(segments.contains(&of_sweep), "{of_sweep}");
            names.push(format!("sweep_{:06}.csv", header.sequence));
        }
        let files: Vec<String> = folder
            .files(&format!("out{}", partial.len()))
            .into_iter()
            .map(|(name, _)| name)
            .collect();
        assert_eq!(files, names);
    }
    let told = sweeps(&replay(&capture, &["--objects"]).stdout);
    let last = told.iter().filter(|line| line["last"] == true);
    let numbers: Vec<u64> = last
        .map(|line| line["sequence"].as_u64().unwrap())
        .collect();
    assert_eq!(numbers, by_time.into_values().collect::<Vec<_>>());
}

#[test]
fn raw_has_every_sweep_in_its_bytes() {
    let folder = Folder::new("raw");
    let capture = fixture("street_vlp16_dual.pcap.gz");
    let mut files = Vec::new();
    for jobs in ["1", "3"] {
        let path = folder.path(jobs);
        let stdout = replay(
            &capture,
            &[
                "--raw",
                path.to_str().unwrap(),
                "--jobs",
                jobs,
                "--no-timing",
            ],
        );
        assert!(stdout.done().contains("sweeps"));
        files.push(std::fs::read(path).unwrap());
    }
    assert!(files[0] == files[1], "the same with any number of jobs");
    // Those of the library, without the room that it leaves.
    let mut pipeline = Pipeline::new("192.168.1.201:2368", Config::default()).unwrap();
    let mut memory = Memory::new(HeapBuffers::default());
    let mut sensors = DiscoveredSensors::new(Vec::new());
    let mut datagrams = Capture::open(&capture).unwrap();
    let mut aligned = HeapBuffers::default().take(files[0].len());
    aligned.as_mut()[..files[0].len()].copy_from_slice(&files[0]);
    let mut rest: &[u8] = &aligned.as_ref()[..files[0].len()];
    while let Some(datagram) = datagrams.next_datagram().unwrap() {
        if let Ok((_, packet)) = sensors.admit(&datagram) {
            pipeline.push(&packet);
        }
        while let Some(sweep) = next_sweep(&mut pipeline, &mut memory) {
            let made = SweepRef::open(sweep.as_ref()).unwrap();
            if made.header.has(flags::PARTIAL) {
                continue;
            }
            let read = SweepRef::open(rest).unwrap();
            assert_eq!(read.header.sensor(), "192.168.1.201:2368");
            assert_eq!(read.header.sequence, made.header.sequence);
            let [read, made] = [read, made].map(|sweep| same_but_for_the_room(&sweep));
            assert!(read == made);
            let (header, _) = Header::read_from_prefix(rest).unwrap();
            rest = &rest[header.total_bytes as usize..];
        }
    }
    assert!(rest.is_empty());
    for others in [&["--json"][..], &["--segments=-"]] {
        let ran = replay(&capture, &[&["--raw=-"], others].concat());
        ran.says(&["both write to standard output", "a file"]);
    }
}

fn same_but_for_the_room(sweep: &SweepRef<'_>) -> Vec<u8> {
    let mut header = sweep.header.without_host();
    (header.offsets, header.total_bytes) = ([0; 10], 0);
    (header.columns_capacity, header.segments_capacity) = (0, 0);
    header.margin_columns = 0;
    let rest = same(sweep);
    [header.as_bytes(), &rest[size_of::<Header>()..]].concat()
}

/// The simulated one has a receiver with a fix and, as a real one, no byte for the pulse.
#[test]
fn an_hdl32e_gives_utc_if_its_sentence_is_enough() {
    let folder = Folder::new("hdl32e-gps");
    let capture = folder.path("gps.pcap");
    let made = [
        "simulate",
        "--model=hdl32e",
        "--gps=locked",
        "--seconds=0.4",
        "--pcap",
        capture.to_str().unwrap(),
    ];
    assert_eq!(sweepd(&made).code, 0);
    let of = |options: &[&str], source: &str| -> Vec<i64> {
        let mut sweeps =
            sweeps(&replay(&capture, &[&["--json", "--no-timing"], options].concat()).done());
        assert!(sweeps.pop().is_some_and(|last| last["summary"].is_object()));
        assert!(
            !sweeps.is_empty() && sweeps.iter().all(|sweep| sweep["time_source"] == source),
            "{source}"
        );
        sweeps
            .iter()
            .map(|sweep| sweep["time_ns"].as_i64().unwrap())
            .collect()
    };
    // The clock of the simulated host is right: the two are apart by what packets take on the way.
    for (host_ns, gps_ns) in of(&[], "host")
        .into_iter()
        .zip(of(&["--gps-without-pps"], "gps"))
    {
        assert!((host_ns - gps_ns).abs() < 5_000_000, "{host_ns} {gps_ns}");
    }
}

#[test]
fn no_return_is_lost_between_the_capture_and_the_files() {
    let folder = Folder::new("returns");
    for (name, in_capture) in [
        ("street_vlp16.pcap.gz", 152_821),
        ("street_hdl32e_dual.pcap.gz", 323_988),
    ] {
        let dir = folder.path(name);
        let options = ["--json", "--partial", "--csv", dir.to_str().unwrap()];
        let lines = sweeps(&replay(&fixture(name), &options).done());
        let sum: u64 = lines
            .iter()
            .filter_map(|line| line["returns"].as_u64())
            .sum();
        let rows: usize = folder
            .files(name)
            .iter()
            .map(|(_, bytes)| bytes.iter().filter(|&&b| b == b'\n').count() - 1)
            .sum();
        assert_eq!((sum, rows), (in_capture, in_capture as usize), "{name}");
    }
}

#[test]
fn two_runs_without_timing_are_the_same_byte_by_byte() {
    let folder = Folder::new("twice");
    let two = made::together(&[&made::vlp16(), &made::datagrams("street_hdl32e.pcap.gz")]);
    let path = folder.write("two.pcap", made::pcap(&two));
    let run = |dir: &str, json: &[&str]| {
        let dirs = ["csv", "pcd", "png"]
            .map(|kind| folder.path(&format!("{dir}/{kind}")).display().to_string());
        let options = [
            "--no-timing",
            "--partial",
            "--force",
            "--csv",
            &dirs[0],
            "--pcd",
            &dirs[1],
            "--png",
            &dirs[2],
        ];
        replay(&path, &[&options[..], json].concat()).done()
    };
    assert_eq!(
        run("a", &["--json", "--jobs=2"]),
        run("b", &["--json", "--jobs=1"])
    );
    let files = folder.files("a");
    // 5 sweeps of the one and 6 of the other, three files each.
    assert_eq!(files.len(), 3 * (5 + 6));
    assert!(files == folder.files("b"));
    // All but the line that says where they are.
    let table = |dir| run(dir, &[]).split("written: ").next().map(str::to_owned);
    assert_eq!(table("a"), table("b"));
    assert!(files == folder.files("a"));
}

#[test]
fn csv_has_its_header_and_counts_packets_of_the_whole_capture() {
    let folder = Folder::new("csv");
    let csv = |name: &str, options: &[&str]| -> String {
        let dir = folder.path(name);
        replay(
            &fixture("street_vlp16.pcap.gz"),
            &[&["--csv", dir.to_str().unwrap()], options].concat(),
        )
        .done();
        folder
            .files(name)
            .into_iter()
            .map(|(_, bytes)| String::from_utf8(bytes).unwrap())
            .collect()
    };
    let all = csv("all", &["--partial"]);
    let header = "packet,block,row,column,channel,return,azimuth_deg,elevation_deg,range_m,x_m,y_m,z_m,reflectivity,time_ns,label";
    assert_eq!(all.lines().next(), Some(header));
    // What tells a return: packet, block, channel, return. Columns and labels depend on the sweep.
    let key = |line: &str| -> Option<[u32; 4]> {
        let fields: Vec<&str> = line.split(',').collect();
        Some([
            fields[0].parse().ok()?,
            fields[1].parse().ok()?,
            fields[4].parse().ok()?,
            fields[8].replace('.', "").parse().ok()?,
        ])
    };
    let all: std::collections::BTreeSet<_> = all.lines().filter_map(key).collect();
    assert_eq!(all.iter().next().unwrap()[0], 0);
    for options in [
        &["--start", "0.2", "--partial"][..],
        &["--start", "0.15", "--end", "0.4", "--partial"],
    ] {
        let part: Vec<_> = csv(options[1], options).lines().filter_map(key).collect();
        assert!(part.len() > 30_000 && part[0][0] >= 110, "{:?}", part[0]);
        assert!(part.iter().all(|one| all.contains(one)), "{options:?}");
    }
}

/// Lengths of a line of `--csv`, `--segments` or `--objects`: points, three at a time.
type Lengths = Vec<f64>;

/// What replay writes in a frame: the points of the first sweep, each segment's mean, least and
/// greatest end, the same of each object, and what it said.
fn in_frame(folder: &Folder, name: &str, options: &[&str]) -> ([Vec<Lengths>; 3], String) {
    let [dir, table] = [folder.path(name), folder.path(&format!("{name}.csv"))];
    let capture = fixture("street_vlp16_losses.pcap");
    let files = [
        "--csv",
        dir.to_str().unwrap(),
        "--segments",
        table.to_str().unwrap(),
    ];
    let ran = replay(
        &capture,
        &[&["--end", "0.25"], &files[..], options].concat(),
    );
    assert_eq!(ran.code, 0, "{}", ran.stderr);
    let lengths = |path: &Path, fields: Range<usize>| -> Vec<Lengths> {
        let text = std::fs::read_to_string(path).unwrap();
        let lines = text.lines().skip(1);
        let fields = lines.map(|line| line.split(',').take(fields.end).skip(fields.start));
        fields
            .map(|line| line.map(|field| field.parse().unwrap()).collect())
            .collect()
    };
    let points = lengths(&dir.join("sweep_000001.csv"), 9..12);
    let segments = lengths(&table, 5..14);
    let told = replay(
        &capture,
        &[&["--end", "0.25", "--objects"], options].concat(),
    );
    assert_eq!((told.code, &told.stderr), (0, &ran.stderr));
    let objects = sweeps(&told.stdout);
    let objects = objects
        .iter()
        .filter(|line| line["points"].is_u64())
        .map(|line| {
            let of =
                ["centroid_m", "min_m", "max_m"].map(|name| line[name].as_array().unwrap().clone());
            of.concat()
                .iter()
                .map(|length| length.as_f64().unwrap())
                .collect()
        });
    ([points, segments, objects.collect()], ran.said().collect())
}

/// The sensor's x, y, z where its right side is 20 degrees down and its nose 10 degrees up.
fn tilted([x, y, z]: [f64; 3]) -> [f64; 3] {
    let [(sr, cr), (sp, cp)] = [20_f64, 10.0].map(|degrees| degrees.to_radians().sin_cos());
    let [x, z] = [x * cr + z * sr, z * cr - x * sr];
    [x, y * cp - z * sp, y * sp + z * cp]
}

/// A point, or a mean with the box around a box, that is moved.
fn moved(lengths: &Lengths, to: fn([f64; 3]) -> [f64; 3]) -> Lengths {
    let ends = lengths.as_chunks().0;
    let mut found = to(ends[0]).to_vec();
    if let [_, least, most] = ends {
        let corner = |bits: usize| to([0, 1, 2].map(|axis| [least, most][bits >> axis & 1][axis]));
        let corners = || (0..8).map(corner);
        for fold in [f64::min, f64::max] {
            found.extend((0..3).map(|axis| corners().map(|at| at[axis]).reduce(fold).unwrap()));
        }
    }
    found
}

#[track_caller]
fn assert_moved(from: &[Vec<Lengths>; 3], to: &[Vec<Lengths>; 3], by: fn([f64; 3]) -> [f64; 3]) {
    for (from, to) in from.iter().zip(to) {
        assert!(from.len() == to.len() && from.len() > 20);
        for (from, to) in from.iter().zip(to) {
            let expected = moved(from, by);
            let mut pairs = expected.iter().zip(to);
            // Both were rounded.
            assert!(
                pairs.all(|(one, other)| (one - other).abs() < 2.5e-4),
                "{expected:?} {to:?}"
            );
        }
    }
}

#[test]
fn a_frame_is_the_same_in_every_output() {
    let folder = Folder::new("frames");
    let mount = ["--pitch", "10", "--roll", "20", "--height", "1.9"];
    let run = |name: &str, options: &[&str]| in_frame(&folder, name, &[options, &mount].concat());
    let (sensor, said) = run("sensor", &[]);
    assert_eq!(said, "");
    let (robot, said) = run("robot", &["--frame", "robot"]);
    assert_eq!(said, "");
    assert_moved(&sensor, &robot, tilted);
    let (ros, said) = run("ros", &["--frame", "ros"]);
    assert_eq!(said, "");
    assert_moved(&robot, &ros, |[x, y, z]| [y, -x, z]);
}

#[test]
fn where_no_mount_is_known_a_frame_by_it_is_the_sensor_s_and_that_is_said() {
    let folder = Folder::new("unmounted");
    let (sensor, said) = in_frame(&folder, "sensor", &[]);
    assert_eq!(said, "");
    let (ros, said) = in_frame(&folder, "ros", &["--frame", "ros"]);
    let note = "note: 192.168.1.201:2368: its mount is not known";
    assert!(
        said.starts_with(note) && said.lines().count() == 1,
        "{said}"
    );
    assert_moved(&sensor, &ros, |[x, y, z]| [y, -x, z]);
}

#[test]
fn the_table_says_all_that_was_promised() {
    let table = replay(&fixture("street_vlp16_losses.pcap"), &[]).done();
    for row in [
        "model",
        "return mode",
        "speed",
        "sweeps",
        "returns",
        "ground",
        "segments",
        "losses",
        "time",
    ] {
        assert!(
            table
                .lines()
                .any(|line| line.starts_with(&format!("  {row:<13}"))),
            "{row} in\n{table}"
        );
    }
    assert!(
        table.contains("18 packets lost") && table.contains(" 96,1") && table.contains(" rpm"),
        "{table}"
    );
    assert!(
        !replay(&fixture("street_vlp16_losses.pcap"), &["--no-timing"])
            .done()
            .contains("\n  time ")
    );
}
