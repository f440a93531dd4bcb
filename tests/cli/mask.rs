//! `sweepd mask`, and what `replay` removes.

use std::path::{Path, PathBuf};

use sweepd::sensor::Model;
use sweepd::sweep::layout::Header;
use sweepd::wire::data::ReturnMode;
use sweepd_lab::simulate::scene::Surface;
use sweepd_lab::simulate::shape::{Shape, Vec3};
use sweepd_lab::simulate::{Class, Emitter, EmitterConfig, Scene};
use zerocopy::FromBytes;

use crate::made::{Sent, pcap};
use crate::{Folder, fixture, replay, sweepd, sweeps};

/// A sensor 0.8 m above the floor, on a robot whose mast rises behind it, 20 cm wide, its front 0.5 m
/// away: from 168.7 to 191.3 degrees. A wall stands 3 m ahead.
fn standing(folder: &Folder, has_mast: bool) -> PathBuf {
    let mut scene = Scene::new([0.0; 2], 20);
    let mut add = |base, size| {
        let shape = Shape::cuboid(base, size, 0.0);
        scene.add(
            Class::Furniture,
            Vec3::zeros(),
            [(shape, Surface::Plain(40))],
        );
    };
    add([0.0, 3.0, 0.0], [4.0, 0.2, 3.0]);
    if has_mast {
        add([0.0, -0.6, 0.0], [0.2, 0.2, 1.5]);
    }
    let mut config = EmitterConfig::new(Model::Vlp16, ReturnMode::Strongest).turns(8.0);
    config.pose.origin = Vec3::new(0.0, 0.0, 0.8);
    let sent: Vec<Sent> = Emitter::new(config, &scene)
        .map(|one| Sent {
            arrival_ns: one.arrival_ns,
            source: one.source,
            port: one.destination.port(),
            payload: one.payload,
        })
        .collect();
    folder.write("standing.pcap", pcap(&sent))
}

fn mask(capture: &Path, picture: &Path, options: &[&str]) -> sweepd_testkit::command::Ran {
    let files = [capture.to_str().unwrap(), "-o", picture.to_str().unwrap()];
    sweepd(&[&["mask"], &files[..], options].concat())
}

#[test]
fn a_standing_robot_is_masked_and_removed() {
    let folder = Folder::new("standing");
    let (capture, picture) = (standing(&folder, true), folder.path("body.png"));
    // The mast is in all rows; half a degree wider on each side, and half for what a column shows.
    let said = mask(&capture, &picture, &[]).done();
    let azimuths = said.split_once("azimuths ").unwrap().1;
    let (from, to) = azimuths
        .trim_end_matches(" degrees\n")
        .split_once('-')
        .unwrap();
    let [from, to]: [f64; 2] = [from, to].map(|deg| deg.parse().unwrap());
    assert!(
        (167.5..=168.5).contains(&from) && (191.5..=192.5).contains(&to),
        "{said}"
    );
    assert!(said.contains("rows 0-15"), "{said}");
    let read = sweepd::files::mask(&picture).unwrap();
    for (degrees, is_hidden) in [
        (168.8, true),
        (180.0, true),
        (191.2, true),
        (160.0, false),
        (0.0, false),
    ] {
        assert!(
            (0..16).all(|row| read.hides(row, f64::to_radians(degrees)) == is_hidden),
            "{degrees}"
        );
    }
    let picture = picture.to_str().unwrap();
    let csv = folder.path("csv");
    let removing = [
        "--mask",
        picture,
        "--remove",
        "mask",
        "--json",
        "--csv",
        csv.to_str().unwrap(),
    ];
    let lines = sweeps(&replay(&capture, &removing).done());
    let summary = &lines.last().unwrap()["summary"]["sensors"][0];
    assert!(
        summary["removed_returns"].as_u64().unwrap() > 1_000,
        "{summary}"
    );
    for (name, bytes) in folder.files("csv") {
        for line in String::from_utf8(bytes).unwrap().lines().skip(1) {
            let range_m: f64 = line.split(',').nth(8).unwrap().parse().unwrap();
            assert!(range_m > 1.0, "{name:?}: {line}");
        }
    }
    // It stays as it is, unless that is said.
    mask(&capture, Path::new(picture), &[]).says(&["body.png", "exists"]);
}

#[test]
fn a_mask_of_nothing_is_told_and_the_floor_is_not_the_robot() {
    let folder = Folder::new("no-body");
    let (capture, picture) = (standing(&folder, false), folder.path("body.png"));
    mask(&capture, &picture, &[]).says(&["within 1 m", "does the robot stand"]);
    mask(&fixture("street_vlp16_losses.pcap"), &picture, &[]).says(&["3 whole turns", "5 or more"]);
    // The two lowest rows meet the floor 3 and 3.5 m away: it is not hidden, but the wall ahead is.
    let picture = folder.path("wall.png");
    let ran = mask(&capture, &picture, &["--within", "3.6"]);
    assert_eq!((ran.code, &ran.stderr[..]), (0, ""));
    let read = sweepd::files::mask(&picture).unwrap();
    for row in 14..16 {
        assert!(!read.hides(row, std::f64::consts::PI), "{}", ran.stdout);
    }
    assert!(read.hides(8, 0.0), "{}", ran.stdout);
}

/// The same returns are gone from raw sweeps, tables, clouds and JSON, whoever segments.
#[test]
fn every_output_lacks_what_is_removed() {
    let folder = Folder::new("removed");
    let capture = fixture("street_vlp16_dual.pcap.gz");
    let mut raws = Vec::new();
    for jobs in ["1", "3"] {
        let [raw, csv, pcd] = ["raw", "csv", "pcd"].map(|kind| format!("{kind}{jobs}"));
        let paths = [&raw, &csv, &pcd].map(|name| folder.path(name).to_str().unwrap().to_owned());
        let said = replay(
            &capture,
            &[
                "--remove-box=-6,-8,-3,6,8,3",
                "--remove=range",
                "--max-range=30",
                "--json",
                "--no-timing",
                "--jobs",
                jobs,
                "--raw",
                &paths[0],
                "--csv",
                &paths[1],
                "--pcd",
                &paths[2],
            ],
        );
        let mut lines = sweeps(&said.done());
        let summary = lines.pop().unwrap();
        assert!(
            summary["summary"]["sensors"][0]["removed_returns"]
                .as_u64()
                .unwrap()
                > 1_000
        );
        let raw = std::fs::read(&paths[0]).unwrap();
        let (tables, clouds) = (folder.files(&csv), folder.files(&pcd));
        let mut rest = &raw[..];
        for (number, line) in lines.iter().enumerate() {
            let returns = line["returns"].as_u64().unwrap();
            let (header, _) = Header::read_from_prefix(rest).unwrap();
            assert_eq!(u64::from(header.returns), returns);
            rest = &rest[header.total_bytes as usize..];
            let table = String::from_utf8(tables[number].1.clone()).unwrap();
            assert_eq!(table.lines().count() as u64 - 1, returns);
            for row in table.lines().skip(1) {
                let values: Vec<&str> = row.split(',').collect();
                let [range_m, x, y, z] =
                    [8, 9, 10, 11].map(|at| values[at].parse::<f64>().unwrap());
                let is_in_box = x.abs() < 6.0 && y.abs() < 8.0 && z.abs() < 3.0;
                assert!(range_m <= 30.0 && !is_in_box, "{row}");
            }
            let cloud = String::from_utf8_lossy(&clouds[number].1);
            assert!(cloud.contains(&format!("POINTS {returns}\n")), "{returns}");
        }
        assert!(!lines.is_empty() && rest.is_empty());
        raws.push(raw);
    }
    assert!(raws[0] == raws[1]);
    for (options, parts) in [
        (
            &["--remove", "mask"][..],
            &["--remove mask", "--mask FILE.png"][..],
        ),
        (&["--remove", "range"], &["--remove range", "--max-range"]),
        (
            &["--remove-box", "0,0,0,1,1"],
            &["0,0,0,1,1", "opposite one"],
        ),
    ] {
        replay(&capture, options).says(parts);
    }
}
