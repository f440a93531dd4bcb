//! The example consumers as programs: what they print, how they end, and what they leave.

use std::ffi::{OsStr, OsString};
use std::os::unix::process::ExitStatusExt;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::OnceLock;
use std::time::{Duration, Instant};

use sweepd::client::Client;
use sweepd::publish::Loans;
use sweepd::sweep::layout::{flags, is_return};
use sweepd::sweep::objects::ObjectsHeader;
use sweepd::sweep::{BeamRow, Column, Header, Pose, SweepMut, SweepRef};
use zerocopy::{FromBytes, FromZeros, IntoBytes};

use super::pallet::{commands, start};
use super::python::{LIMIT, Talk, loans, numbered, publish};
use super::sweeps::Source;
use super::{folder, objects, of_project};
use sweepd_testkit::{
    TempDomain,
    library::{compile, library, rust_example},
    python_package, python_with_numpy, temp_domain,
};

fn nearest(sweep: &SweepRef<'_>) -> Option<f32> {
    sweep
        .segments
        .iter()
        .map(|segment| segment.nearest_m)
        .min_by(f32::total_cmp)
}

/// Plays a street to a consumer, whose every line must be about the sweep that was sent.
fn play_to(consumer: &Talk, own: &TempDomain, mut check: impl FnMut(&SweepRef<'_>, &str)) {
    let mut loans = loans(own);
    // It is there when it has printed something.
    loop {
        publish(&mut loans, u64::MAX);
        match consumer.try_line(Duration::from_millis(100)) {
            Some(line) if line.contains(&u64::MAX.to_string()) => break,
            other => assert_eq!(other, None),
        }
    }
    while consumer.try_line(Duration::from_millis(300)).is_some() {}
    let mut sweeps = 0;
    Source::StreetVlp16Dual.play(loans, |mut slot| {
        let sweep = SweepMut::open(slot.as_mut()).unwrap();
        (sweep.header.yaw_rad, sweep.header.pitch_rad) = (1.0, 0.1);
        sweep.header.position_m = [0.5, -8.0, 1.9];
        let bytes = slot.as_ref().to_vec();
        slot.publish().unwrap();
        let mut copy = sweepd::buffers::Buffers::take(
            &mut sweepd::buffers::HeapBuffers::default(),
            bytes.len(),
        );
        copy.as_mut().copy_from_slice(&bytes);
        let mut line = consumer.line();
        while line.contains(&u64::MAX.to_string()) {
            line = consumer.line();
        }
        check(&SweepRef::open(copy.as_ref()).unwrap(), &line);
        sweeps += 1;
    });
    assert!(sweeps >= 3);
}

/// `roof 3: 10.0 Hz, 1.9 ms, 87 segments, nearest 1.23 m`
fn check_line(sweep: &SweepRef<'_>, line: &str) {
    let parts: Vec<&str> = line.split([':', ',']).map(str::trim).collect();
    let [name, rate, latency, segments, nearest_m] = parts[..] else {
        panic!("{line}")
    };
    assert_eq!(name, format!("roof {}", sweep.header.sequence));
    assert_eq!(segments, format!("{} segments", sweep.segments.len()));
    let expected = nearest(sweep).map_or_else(
        || "none".to_owned(),
        |nearest_m| format!("{nearest_m:.2} m"),
    );
    assert_eq!(nearest_m, format!("nearest {expected}"));
    assert!(
        rate.strip_suffix(" Hz").unwrap().parse::<f64>().unwrap() > 0.0,
        "{line}"
    );
    // The capture is older than this run, and its clock is not this host's.
    assert!(
        latency.strip_suffix(" ms").unwrap().parse::<f64>().is_ok(),
        "{line}"
    );
}

fn interrupt(consumer: &mut Talk) {
    consumer.signal("-INT");
    // Python ends by itself, the others by the signal.
    let end = consumer.end();
    assert!(end.success() || end.signal() == Some(2), "{end}");
}

#[test]
fn the_rust_consumer_prints_a_line_a_sweep_and_makes_room_when_it_is_killed() {
    let own = temp_domain();
    let program = rust_example("consumer");
    let args = ["roof".as_ref(), own.root().as_os_str()];
    let mut consumer = Talk::start(program.as_os_str(), &args);
    play_to(&consumer, &own, check_line);
    interrupt(&mut consumer);
    // There is room for two, and three were killed by now.
    let mut loans = loans(&own);
    for _ in 0..2 {
        let mut consumer = Talk::start(program.as_os_str(), &args);
        publish_until_line(&mut loans, &consumer);
        interrupt(&mut consumer);
    }
    for _ in 0..2 {
        // The keeper gives their places back within a second; until then there may be none.
        let mut client = Client::within(&own.domain(), "roof").unwrap();
        let begun = Instant::now();
        while !client.is_connected() {
            let _ = client.next(Duration::from_millis(100));
            assert!(begun.elapsed() < LIMIT, "no place is given back");
        }
    }
}

fn publish_until_line(loans: &mut Loans, consumer: &Talk) {
    let lines = (0..600).filter_map(|sequence| {
        publish(loans, sequence);
        consumer.try_line(Duration::from_millis(100))
    });
    assert!(lines.take(1).count() == 1, "it never got one");
}

#[test]
#[cfg_attr(without_python, ignore = "no SWEEPD_PYTHON")]
fn the_python_consumer_prints_a_line_a_sweep_and_ends_at_once() {
    let own = temp_domain();
    let script = of_project("examples/consumer.py");
    let args = [script.as_os_str(), "roof".as_ref(), own.root().as_os_str()];
    let mut consumer = Talk::start(&python_with_numpy(), &args);
    play_to(&consumer, &own, |sweep, line| {
        // It does without the rate.
        let (name, rest) = line.split_once(": ").expect(line);
        check_line(sweep, &format!("{name}: 1 Hz, {rest}"));
    });
    interrupt(&mut consumer);
}

fn length(point: [f64; 3]) -> f64 {
    point.iter().map(|axis| axis * axis).sum::<f64>().sqrt()
}

/// What a consumer prints of the message of which nothing is wrong.
#[track_caller]
fn check_object_lines(lines: &[String], name: &str) {
    let expected = [
        ("part 0", "21 points, nearest 2.50 m"),
        ("object 1", "20 points, nearest 3.50 m"),
        ("object 2", "22 points, nearest 4.50 m"),
    ];
    assert_eq!(lines.len(), expected.len());
    for (line, (what, size)) in lines.iter().zip(expected) {
        let rest = line.strip_prefix(&format!("{name} 7: {what}, "));
        let age = rest.and_then(|rest| rest.strip_suffix(&format!(", {size}")));
        assert!(
            is_recent(age.and_then(|age| age.strip_suffix(" ms"))),
            "{line}"
        );
    }
}

/// Whether an age in milliseconds is that of what was made in this test.
fn is_recent(age_ms: Option<&str>) -> bool {
    age_ms.is_some_and(|age| (-1.0..60_000.0).contains(&age.parse().unwrap()))
}

/// Sends a message until a consumer has got it.
fn publish_until_there(loans: &mut Loans, message: &[u8]) {
    for _ in 0..3000 {
        if objects::publish(loans, message) == 1 {
            return;
        }
        std::thread::sleep(Duration::from_millis(20));
    }
    panic!("it never was there");
}

#[test]
#[cfg_attr(without_python, ignore = "no SWEEPD_PYTHON")]
fn consumers_print_a_line_an_object() {
    let (rust, python) = (rust_example("consumer"), python_with_numpy());
    let script = of_project("examples/consumer.py");
    for program in [&[rust.as_os_str()][..], &[&python, script.as_os_str()]] {
        let own = temp_domain();
        let mut loans = objects::loans(&own);
        let args = [
            "--objects".as_ref(),
            "roof".as_ref(),
            own.root().as_os_str(),
        ];
        let args = [&program[1..], &args].concat();
        let mut consumer = Talk::start(program[0], &args);
        publish_until_there(&mut loans, objects::message(&objects::honest()));
        let lines: Vec<String> = (0..3).map(|_| consumer.line()).collect();
        check_object_lines(&lines, "roof");
        interrupt(&mut consumer);
    }
}

/// Sends a sweep, in which the sensor is 1.5 m over the floor and the robot's origin 0.5 m under it: of a
/// model and with these flags, and with so many returns of a segment 2.5 m straight ahead. Gives the
/// number of its consumers.
fn publish_returns(loans: &mut Loans, header: &Header, returns: usize) -> usize {
    let mut slot = numbered(loans, header.sequence);
    let sweep = SweepMut::open(slot.as_mut()).unwrap();
    (sweep.header.model, sweep.header.flags) = (header.model, header.flags);
    (sweep.header.height_m, sweep.header.position_m[2]) = (header.height_m, 1.0);
    sweep.header.columns = returns as u32;
    sweep.beams.fill(BeamRow::ideal(0, 0.0, 0));
    sweep.columns.fill(Column::measured(0, 0, 0.0, 0.0, 0));
    sweep.range.fill(0.0);
    for column in 0..returns {
        (sweep.range[16 * column], sweep.label[16 * column]) = (2.5, 2);
    }
    slot.publish().unwrap()
}

/// The header of a sweep of which nothing is said.
fn quiet() -> Header {
    let mut header = Header::new_zeroed();
    (header.model, header.height_m) = (1, 1.5);
    header
}

pub const SILENCE: &str = "stop: no whole turn of roof came for 0.3 s";

#[test]
#[cfg_attr(
    any(without_python, without_compilers),
    ignore = "no SWEEPD_PYTHON, or no compilers"
)]
fn stop_is_said_of_what_is_in_the_way_and_while_nothing_is_known() {
    for (command, blind) in commands("stop")
        .into_iter()
        .zip(["roof: blind: ", "0x100", "0x100"])
    {
        let own = temp_domain();
        let mut loans = loans(&own);
        let mut stop = start(&command, own.root().as_os_str(), &["1", "3"]);
        assert_eq!(stop.line(), SILENCE);
        let mut header = quiet();
        while publish_returns(&mut loans, &header, 0) == 0 {
            std::thread::sleep(Duration::from_millis(20));
        }
        // One after the other, however long the machine was silent in between.
        for (change, returns, words) in [
            ((1, 0, 1.5), 3, "stop: an obstacle at 2.50 m, sweep 1"),
            (
                (1, 0, 0.0),
                3,
                "stop: the height of roof is not known: set `height_m`",
            ),
            ((1, 0x100, 1.5), 0, blind),
            ((2, 0, 1.5), 2, "stop: roof is of model 2, not 1"),
            ((1, 0, 1.5), 4, "stop: an obstacle at 2.50 m, sweep 5"),
        ] {
            header.sequence += 1;
            (header.model, header.flags, header.height_m) = change;
            publish_returns(&mut loans, &header, returns);
            let mut said = std::iter::repeat_with(|| stop.line());
            let said = said.find(|line| line != SILENCE).unwrap();
            assert!(said.contains(words), "{said}, not {words}");
        }
        // Two returns are none.
        header = quiet();
        publish_returns(&mut loans, &header, 2);
        while let Some(line) = stop.try_line(Duration::from_millis(100)) {
            assert_eq!(line, SILENCE);
        }
        assert_eq!(stop.line(), SILENCE, "of a sensor that is off");
        // A part of a turn, and a head that stands still: asked, but no look at the whole way.
        for flag in [flags::PARTIAL, flags::STOPPED] {
            (header.flags, header.sequence) = (flag, 7);
            publish_returns(&mut loans, &header, 3);
            while stop.line() != "stop: an obstacle at 2.50 m, sweep 7" {}
            let begun = Instant::now();
            let mut said = std::iter::repeat_with(|| {
                assert!(begun.elapsed() < LIMIT, "such sweeps are enough");
                publish_returns(&mut loans, &header, 0);
                stop.try_line(Duration::from_millis(50))
            });
            while said.next().flatten().as_deref() != Some(SILENCE) {}
        }
        interrupt(&mut stop);
    }
}

/// Objects are a hint, and do not make up for sweeps that stay away.
#[test]
#[cfg_attr(
    any(without_python, without_compilers),
    ignore = "no SWEEPD_PYTHON, or no compilers"
)]
fn objects_in_the_way_are_told_as_not_confirmed() {
    for command in commands("stop") {
        let own = temp_domain();
        let mut loans = objects::loans(&own);
        let mut stop = start(&command, own.root().as_os_str(), &[]);
        publish_until_there(&mut loans, objects::message(&objects::honest()));
        // Of three objects two are in the way. Where the robot's origin is in the sensor, 1.5 m over
        // the floor, they are too, and so they are if nobody knows how high anything is.
        for place in [None, Some((0.0, 1.5)), Some((-50.0, 0.0))] {
            if let Some((z_m, height_m)) = place {
                let mut moved = objects::honest();
                let (header, _) = ObjectsHeader::mut_from_prefix(moved.as_mut_bytes()).unwrap();
                (header.position_m[2], header.height_m) = (z_m, height_m);
                objects::publish(&mut loans, objects::message(&moved));
            }
            let said = std::iter::repeat_with(|| stop.line()).filter(|line| line != SILENCE);
            for (nearest_m, said) in ["2.50", "3.50"].into_iter().zip(said) {
                let begins =
                    format!("object ahead, not confirmed: {nearest_m} m from the sensor, seen ");
                let age = said.strip_prefix(&begins);
                let age = age.and_then(|age| age.strip_suffix(" ms ago"));
                assert!(is_recent(age), "{said}");
            }
        }
        let (begun, mut is_told) = (Instant::now(), false);
        while !is_told {
            objects::publish(&mut loans, objects::message(&objects::honest()));
            std::thread::sleep(Duration::from_millis(50));
            while let Some(line) = stop.try_line(Duration::ZERO) {
                is_told |= line == SILENCE;
            }
            assert!(begun.elapsed() < LIMIT, "objects alone are enough");
        }
        interrupt(&mut stop);
    }
}

/// Without a height nobody knows what is ground, and a part of a turn has not looked everywhere.
#[test]
#[cfg_attr(
    any(without_python, without_compilers),
    ignore = "no SWEEPD_PYTHON, or no compilers"
)]
fn zones_are_asked_without_a_height_and_empty_after_whole_turns() {
    for command in commands("zones") {
        let own = temp_domain();
        let mut loans = loans(&own);
        let mut zones = start(&command, own.root().as_os_str(), &[]);
        let mut header = quiet();
        (header.height_m, header.flags) = (0.0, flags::PARTIAL);
        let mut said = None;
        while said.is_none() {
            publish_returns(&mut loans, &header, 3);
            said = zones.try_line(Duration::from_millis(20));
        }
        assert_eq!(said.as_deref(), Some("ahead: occupied"));
        for _ in 0..5 {
            publish_returns(&mut loans, &header, 0);
            assert_eq!(zones.try_line(Duration::from_millis(50)), None);
        }
        header.flags = 0;
        for _ in 0..2 {
            publish_returns(&mut loans, &header, 0);
            assert_eq!(zones.try_line(Duration::from_millis(50)), None);
        }
        // It may have missed some while it had no core.
        let begun = Instant::now();
        let mut said = std::iter::repeat_with(|| {
            assert!(begun.elapsed() < LIMIT, "three turns are not enough");
            publish_returns(&mut loans, &header, 0);
            zones.try_line(Duration::from_millis(50))
        });
        assert_eq!(said.find_map(|line| line).unwrap(), "ahead: empty");
        interrupt(&mut zones);
    }
}

/// Each language says the same of arguments that cannot be meant.
#[test]
#[cfg_attr(
    any(without_python, without_compilers),
    ignore = "no SWEEPD_PYTHON, or no compilers"
)]
fn stop_refuses_a_way_that_is_none() {
    let stop = "SENSOR [WIDTH [LENGTH [MODEL]]]: WIDTH is at least 0 and LENGTH 0.5, metres; MODEL is a number of docs/layout.md";
    let record = "SENSOR [SECONDS]: SECONDS is 0.1 to 1e9";
    for (example, sentence, args) in [
        ("stop", stop, &["-1"][..]),
        ("stop", stop, &["nan"]),
        ("stop", stop, &["x"]),
        ("stop", stop, &[""]),
        ("stop", stop, &["2", "0.4"]),
        ("stop", stop, &["2", ""]),
        ("stop", stop, &["2", "5", "VLP-16"]),
        ("stop", stop, &["2", "5", "-5"]),
        ("stop", stop, &["2", "5", "2.5"]),
        ("stop", stop, &["2", "5", ""]),
        ("stop", stop, &["2", "5", "4294967296"]),
        ("stop", stop, &["2", "5", "1", "1"]),
        ("record_event", record, &["ten"]),
        ("record_event", record, &[""]),
        ("record_event", record, &["0"]),
        ("record_event", record, &["nan"]),
        ("record_event", record, &["10", "--mcap"]),
    ] {
        for command in commands(example) {
            let mut refused = Command::new(&command[0]);
            refused.args(&command[1..]).arg("roof").args(args);
            let output = refused.envs(python_package()).output().unwrap();
            let said = String::from_utf8_lossy(&output.stderr);
            let is_clear = said.contains(sentence) && said.lines().count() == 1;
            assert!(!output.status.success() && is_clear, "{args:?}: {said}");
        }
    }
    for command in commands("record_event") {
        let mut refused = Command::new(&command[0]);
        let output = refused.args(&command[1..]).envs(python_package()).output();
        let output = output.unwrap();
        let said = String::from_utf8_lossy(&output.stderr);
        assert!(
            !output.status.success() && said.contains("[SECONDS]"),
            "{said}"
        );
    }
}

/// The programs in C++, built once as the line at the top of examples/CMakeLists.txt does, in a folder
/// as cargo leaves it.
pub fn cpp_examples() -> &'static Path {
    static BUILD: OnceLock<PathBuf> = OnceLock::new();
    BUILD.get_or_init(|| {
        let (build, library) = (folder("cpp").join("build"), library());
        let mut prefix = OsString::from("-DCMAKE_PREFIX_PATH=");
        // As it is written there: from the folder of the project, wherever a shell says that it is.
        prefix.push(library.strip_prefix(of_project("")).unwrap_or(library));
        let made: [&[&OsStr]; 2] = [
            &["-S", "examples", "-B"].map(OsStr::new),
            &["--build"].map(OsStr::new),
        ];
        for (args, more) in made.into_iter().zip([Some(&prefix), None]) {
            let mut cmake = Command::new("cmake");
            cmake.args(args).arg(&build).args(more);
            let output = cmake.current_dir(of_project("")).env("PWD", "/");
            let output = output.output().unwrap();
            let said = String::from_utf8_lossy(&output.stderr);
            assert!(output.status.success() && said.is_empty(), "{said}");
        }
        build
    })
}

/// Also where the host has one installed: only an empty root is searched.
#[test]
#[cfg_attr(without_compilers, ignore = "no compilers")]
fn cmake_says_where_cpp_gets_the_library_that_is_not_there() {
    let folder = folder("cpp_none");
    let mut cmake = Command::new("cmake");
    cmake.args("-DCMAKE_PREFIX_PATH=none -DCMAKE_FIND_ROOT_PATH_MODE_LIBRARY=ONLY".split(' '));
    cmake.arg(format!("-DCMAKE_FIND_ROOT_PATH={}", folder.display()));
    cmake.arg("-S").arg(of_project("examples"));
    let output = cmake.arg("-B").arg(folder.join("build")).output().unwrap();
    let said = String::from_utf8(output.stderr).unwrap();
    assert!(!output.status.success());
    for words in ["libsweepd-dev", "cargo build", "CMAKE_PREFIX_PATH"] {
        assert!(said.contains(words), "{said}");
    }
}

#[test]
#[cfg_attr(without_compilers, ignore = "no compilers")]
fn the_cpp_consumer_prints_a_line_a_sweep_and_ends_when_nothing_comes() {
    let own = temp_domain();
    let program = cpp_examples().join("consumer");
    let args = ["roof", own.root().to_str().unwrap(), "--timeout", "4"].map(OsStr::new);
    let mut consumer = Talk::start(program.as_os_str(), &args);
    play_to(&consumer, &own, |sweep, line| {
        let (line, point) = line.split_once(" at (").unwrap_or((line, ""));
        // It does without the rate.
        let (name, rest) = line.split_once(": ").expect(line);
        let nearest = nearest(sweep);
        let none = if nearest.is_none() {
            ", nearest none"
        } else {
            ""
        };
        check_line(sweep, &format!("{name}: 1 Hz, {rest}{none}"));
        let obstacles = sweep.returns().filter(|one| one.label >= 2);
        let expected = obstacles.filter(|one| Some(one.range_m) == nearest);
        let expected = expected
            .map(|one| one.point_m)
            .map(|[x, y, z]| format!("{x:.2} {y:.2} {z:.2})"));
        assert!(nearest.is_none() || expected.collect::<Vec<_>>().contains(&point.to_owned()));
    });
    assert_eq!(consumer.end().code(), Some(1), "nothing comes any more");
    let own = temp_domain();
    let mut loans = loans(&own);
    let output = Command::new(&program)
        .args(["typo", own.root().to_str().unwrap(), "--timeout", "0.1"])
        .output()
        .unwrap();
    let said = String::from_utf8_lossy(&output.stderr);
    let expected =
        "consumer: for 0.1 s nothing came of typo, which nobody publishes; there is: roof\n";
    assert_eq!((output.status.code(), &*said), (Some(1), expected));
    let mut consumer = Talk::start(program.as_os_str(), &["roof".as_ref(), own.root().as_ref()]);
    assert_eq!(consumer.try_line(Duration::from_millis(200)), None);
    consumer.stop_and_continue();
    publish_until_line(&mut loans, &consumer);
    interrupt(&mut consumer);
}

#[test]
#[cfg_attr(without_compilers, ignore = "no compilers")]
fn the_cpp_consumer_prints_a_line_an_object() {
    let own = temp_domain();
    let program = cpp_examples().join("consumer");
    let mut loans = objects::loans(&own);
    let args = ["--objects", "roof", own.root().to_str().unwrap()].map(OsStr::new);
    let consumer = Talk::start(program.as_os_str(), &args);
    publish_until_there(&mut loans, objects::message(&objects::honest()));
    let lines: Vec<String> = (0..3).map(|_| consumer.line()).collect();
    check_object_lines(&lines, "roof");
}

/// Compiles an example in C++, with the headers of another library.
fn cpp_example(name: &str, include: &Path) -> PathBuf {
    let program = folder(name).join(name);
    let source = of_project("examples").join(name).with_extension("cpp");
    let include = format!("-isystem{}", include.display());
    compile("c++", &["-std=c++17", &include], &source, &program);
    program
}

/// A line that says how many points there are, and which is the nearest.
#[track_caller]
fn check_points(line: &str, begins: &str, points: impl Iterator<Item = [f64; 3]>) {
    let rest = line.strip_prefix(begins);
    let rest = rest.unwrap_or_else(|| panic!("{line}, not {begins}"));
    let Some(nearest) = points.min_by(|one, other| length(*one).total_cmp(&length(*other))) else {
        return assert_eq!(rest, "");
    };
    let said = rest
        .strip_prefix(", nearest at")
        .unwrap()
        .split_whitespace();
    let said: Vec<f64> = said.map(|axis| axis.parse().unwrap()).collect();
    let off = nearest
        .iter()
        .zip(&said)
        .map(|(axis, said)| (axis - said).abs());
    assert!(
        said.len() == 3 && off.fold(0.0, f64::max) < 1e-3,
        "{line}, not {nearest:?}"
    );
}

#[test]
#[cfg_attr(
    any(without_compilers, without_eigen),
    ignore = "no compilers, or no Eigen"
)]
fn eigen_has_the_image_and_the_obstacles_in_the_frame_of_the_robot() {
    let eigen = cpp_example("eigen", Path::new("/usr/include/eigen3"));
    let own = temp_domain();
    let consumer = Talk::start(eigen.as_os_str(), &["roof".as_ref(), own.root().as_ref()]);
    play_to(&consumer, &own, |sweep, line| {
        let pixels = sweep
            .range
            .iter()
            .filter(|&&range_m| is_return(range_m))
            .count();
        let mount = Pose::of_mount(sweep.header);
        let obstacles = sweep.returns().filter(|one| one.label >= 2);
        let points: Vec<[f64; 3]> = obstacles.map(|one| mount.apply(one.point_m)).collect();
        let (sequence, count) = (sweep.header.sequence, points.len());
        let begins = format!("{sequence}: {pixels} pixels, {count} of obstacles");
        check_points(line, &begins, points.into_iter());
    });
}

/// Against a stub of PCL's interface.
#[test]
#[cfg_attr(without_compilers, ignore = "no compilers")]
fn pcl_has_a_point_a_pixel_in_the_axes_of_ros() {
    let pcl = cpp_example("pcl", &of_project("tests/slow/consumers/pcl_stub"));
    let own = temp_domain();
    let consumer = Talk::start(pcl.as_os_str(), &["roof".as_ref(), own.root().as_ref()]);
    play_to(&consumer, &own, |sweep, line| {
        let (rows, columns) = (sweep.rows(), sweep.columns.len());
        let pose = Pose::ROS * Pose::of_mount(sweep.header);
        let pixels = sweep.range.iter().enumerate();
        let returns = pixels.filter(|(_, range_m)| is_return(**range_m));
        let points = returns.map(|(at, &range_m)| sweep.point_m(at % rows, at / rows, range_m));
        let points: Vec<[f64; 3]> = points.map(|point| pose.apply(point)).collect();
        let (sequence, count) = (sweep.header.sequence, points.len());
        let begins = format!("{sequence}: {columns} x {rows}, {count} points");
        check_points(line, &begins, points.into_iter());
    });
}
