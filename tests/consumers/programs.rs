//! The example consumers as programs: what they print, how they end, and what they leave.

use std::ffi::OsStr;
use std::os::unix::process::ExitStatusExt;
use std::path::PathBuf;
use std::process::{Command, Stdio};
use std::time::Duration;

use sweepd::client::Client;
use sweepd::publish::Loans;
use sweepd::sweep::objects::{ObjectsHeader, flags};
use sweepd::sweep::{Pose, SweepMut, SweepRef};
use zerocopy::{FromBytes, IntoBytes};

use super::common::{python_with_iceoryx2, temp_domain};
use super::python::{Talk, loans, numbered, publish};
use super::sweeps::Source;
use super::{folder, objects, of_project};
use sweepd_lab::testkit::TempDomain;

/// An example of the client in Rust, built as these tests are, with the same features: `cargo test`
/// has done so before.
pub fn rust_example(name: &str) -> PathBuf {
    let mut cargo = Command::new(env!("CARGO"));
    cargo
        .args("build --quiet --locked --offline --features slow-tests --example".split(' '))
        .arg(name)
        .current_dir(of_project(""));
    if !cfg!(debug_assertions) {
        cargo.arg("--release");
    }
    assert!(
        cargo.status().unwrap().success(),
        "the example is not built"
    );
    // target/debug/deps/consumers-*
    std::env::current_exe()
        .unwrap()
        .ancestors()
        .nth(2)
        .unwrap()
        .join("examples")
        .join(name)
}

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
    Source::StreetVlp16Dual.play(loans, |slot| {
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

fn interrupt(consumer: &Talk) {
    assert!(
        Command::new("kill")
            .args(["-INT", &consumer.id().to_string()])
            .status()
            .unwrap()
            .success()
    );
}

#[test]
fn the_rust_consumer_prints_a_line_a_sweep_and_makes_room_when_it_is_killed() {
    let own = temp_domain();
    let program = rust_example("consumer");
    let args = ["roof".as_ref(), own.root().as_os_str()];
    let mut consumer = Talk::start(program.as_os_str(), &args);
    play_to(&consumer, &own, check_line);
    interrupt(&consumer);
    assert_eq!(consumer.end().signal(), Some(2));
    // There is room for two, and three were killed by now.
    let mut loans = loans(&own);
    for _ in 0..2 {
        let mut consumer = Talk::start(program.as_os_str(), &args);
        publish_until_line(&mut loans, &consumer);
        interrupt(&consumer);
        consumer.end();
    }
    for _ in 0..2 {
        // The keeper gives their places back within a second.
        let mut client = Client::within(&own.domain(), "roof").unwrap();
        client.next(Duration::from_secs(2)).unwrap();
        assert!(client.is_connected());
    }
}

fn publish_until_line(loans: &mut Loans, consumer: &Talk) {
    let lines = (0..200).filter_map(|sequence| {
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
    let mut consumer = Talk::start(&python_with_iceoryx2(), &args);
    play_to(&consumer, &own, |sweep, line| {
        // It does without the rate.
        let (name, rest) = line.split_once(": ").expect(line);
        check_line(sweep, &format!("{name}: 1 Hz, {rest}"));
    });
    interrupt(&consumer);
    assert_eq!(consumer.end().signal(), Some(2));
}

/// The box of `nearest.py`.
const BOX_M: [[f64; 3]; 2] = [[-1.0, 0.5, 0.05], [1.0, 5.0, 2.0]];

#[test]
#[cfg_attr(without_python, ignore = "no SWEEPD_PYTHON")]
fn the_nearest_obstacle_is_in_the_box_and_the_frame_of_the_robot() {
    let own = temp_domain();
    let script = of_project("examples/python/nearest.py");
    let root = format!("SWEEPD_ROOT={}", own.root().display());
    let python = python_with_iceoryx2();
    let args = [root.as_ref(), &*python, script.as_os_str(), "roof".as_ref()];
    let consumer = Talk::start("env".as_ref(), &args);
    let mut loans = loans(&own);
    for _ in 0..1000 {
        if loans.status().consumers() == 1 {
            break;
        }
        publish(&mut loans, 0);
        std::thread::sleep(Duration::from_millis(20));
    }
    let mut lines = 0;
    Source::StreetVlp16Dual.play(loans, |mut slot| {
        let sweep = SweepMut::open(slot.as_mut()).unwrap();
        sweep.header.position_m = [0.5, -8.0, 1.9];
        (sweep.header.yaw_rad, sweep.header.pitch_rad) = (1.0, 0.1);
        let view = sweep.as_ref();
        let mut mount = Pose::of_mount(view.header);
        // Its z is from the floor.
        let floor_m = mount.position_m[2] - f64::from(view.header.height_m);
        mount.position_m[2] -= floor_m.min(0.0);
        let mut nearest = [f64::INFINITY; 3];
        for pixel in 0..view.range.len() {
            let place = (pixel % view.rows(), pixel / view.rows());
            if let [Some(one), _] = view.pixel(place.0, place.1)
                && one.label >= 2
            {
                let point = mount.apply(one.point_m);
                let is_within =
                    (0..3).all(|axis| (BOX_M[0][axis]..BOX_M[1][axis]).contains(&point[axis]));
                if is_within && length(point) < length(nearest) {
                    nearest = point;
                }
            }
        }
        let [x, y, z] = nearest;
        let expected = format!(
            "{}: {x:.2} m right, {y:.2} m ahead, {z:.2} m up",
            view.header.sequence
        );
        slot.publish().unwrap();
        // The first sweep is too short to have anything in the box.
        if x.is_finite() {
            assert_eq!(consumer.line(), expected);
            lines += 1;
        }
    });
    assert!(lines >= 3);
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
    for _ in 0..1000 {
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
    let (rust, python) = (rust_example("consumer"), python_with_iceoryx2());
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
        interrupt(&consumer);
        assert_eq!(consumer.end().signal(), Some(2));
    }
}

#[test]
#[cfg_attr(without_python, ignore = "no SWEEPD_PYTHON")]
fn stop_is_said_of_what_is_in_the_box_and_while_nothing_is_known() {
    const SILENCE: &str = "stop: nothing is heard of roof";
    const UNKNOWN: &str = "stop: the height of roof is not known yet";
    let (rust, python) = (rust_example("stop"), python_with_iceoryx2());
    let script = of_project("examples/python/stop.py");
    let mut unknown = objects::honest();
    let (header, _) = ObjectsHeader::mut_from_prefix(unknown.as_mut_bytes()).unwrap();
    (header.objects, header.labels) = (0, 0);
    header.flags = flags::LAST | flags::NO_HEIGHT;
    for program in [&[rust.as_os_str()][..], &[&python, script.as_os_str()]] {
        let own = temp_domain();
        let mut loans = objects::loans(&own);
        let root = format!("SWEEPD_ROOT={}", own.root().display());
        let args = [&[root.as_ref()], program, &["roof".as_ref()]].concat();
        let mut stop = Talk::start("env".as_ref(), &args);
        publish_until_there(&mut loans, objects::message(&unknown));
        let lines = || std::iter::repeat_with(|| stop.line());
        assert!(lines().find(|line| line != SILENCE).as_deref() == Some(UNKNOWN));
        // Of three objects two are in the box. Where the robot's origin is in the sensor, 1.5 m over
        // the floor, they are too.
        let mut hanging = objects::honest();
        let (header, _) = ObjectsHeader::mut_from_prefix(hanging.as_mut_bytes()).unwrap();
        header.position_m[2] = 0.0;
        for message in [objects::honest(), hanging] {
            objects::publish(&mut loans, objects::message(&message));
            let said = lines().filter(|line| line != SILENCE && line != UNKNOWN);
            for (nearest_m, said) in ["2.50", "3.50"].into_iter().zip(said) {
                let age = said.strip_prefix(&format!("stop: an object at {nearest_m} m, seen "));
                let age = age.and_then(|age| age.strip_suffix(" ms ago"));
                assert!(is_recent(age), "{said}");
            }
        }
        assert_eq!(stop.line(), SILENCE);
        // Where the floor is must be known.
        let mut floor = unknown.clone();
        let (header, _) = ObjectsHeader::mut_from_prefix(floor.as_mut_bytes()).unwrap();
        (header.flags, header.position_m[2]) = (flags::LAST, 0.0);
        header.height_m = 0.0;
        objects::publish(&mut loans, objects::message(&floor));
        let said = lines().find(|line| line != SILENCE);
        assert!(said.is_some_and(|said| said.contains("no z_m")));
        interrupt(&stop);
        assert_eq!(stop.end().signal(), Some(2));
    }
}

/// Sends an empty sweep of a model with these flags, and gives the number of its consumers.
fn publish_flags(loans: &mut Loans, sequence: u64, model: u32, bits: u32) -> usize {
    let mut slot = numbered(loans, sequence);
    let sweep = SweepMut::open(slot.as_mut()).unwrap();
    (sweep.header.model, sweep.header.flags) = (model, bits);
    slot.publish().unwrap()
}

#[test]
#[cfg_attr(without_python, ignore = "no SWEEPD_PYTHON")]
fn stop_is_said_of_a_sensor_that_does_not_see_and_of_another() {
    let (rust, python) = (rust_example("stop"), python_with_iceoryx2());
    let script = of_project("examples/python/stop.py");
    for (program, blind) in [
        (&[rust.as_os_str()][..], "stop: roof: blind: "),
        (&[&python, script.as_os_str()], "flags are 0x100"),
    ] {
        let own = temp_domain();
        let (mut sweeps, mut told) = (loans(&own), objects::loans(&own));
        let root = format!("SWEEPD_ROOT={}", own.root().display());
        let args = [&[root.as_ref()], program, &["roof".as_ref()]].concat();
        let mut stop = Talk::start("env".as_ref(), &args);
        let mut is_there = false;
        for sequence in 0..1000 {
            is_there = publish_flags(&mut sweeps, sequence, 1, 0) == 1;
            objects::publish(&mut told, objects::message(&objects::honest()));
            if is_there {
                break;
            }
            std::thread::sleep(Duration::from_millis(20));
        }
        assert!(is_there);
        for (model, bits, words) in [(1, 0x100, blind), (2, 0, "is of model 2, not 1")] {
            publish_flags(&mut sweeps, 1000, model, bits);
            objects::publish(&mut told, objects::message(&objects::honest()));
            let said = std::iter::repeat_with(|| stop.line());
            assert!(said.take(100).any(|line| line.contains(words)), "{words}");
        }
        // Objects alone are not enough.
        let mut has_said = false;
        for _ in 0..20 {
            objects::publish(&mut told, objects::message(&objects::honest()));
            while let Some(line) = stop.try_line(Duration::from_millis(50)) {
                has_said |= line == "stop: nothing is heard of roof";
            }
        }
        assert!(has_said);
        interrupt(&stop);
        assert_eq!(stop.end().signal(), Some(2));
    }
}

/// What of it needs no iceoryx2 is compiled and run; all of it is compiled where that is installed.
#[test]
#[cfg_attr(without_compilers, ignore = "no compilers")]
fn the_cpp_consumer_compiles_and_reads_a_sweep() {
    let (source, folder) = (of_project("examples/consumer.cpp"), folder("cpp"));
    let program = folder.join("consumer");
    let strict = ["-std=c++14", "-Wall", "-Wextra", "-Wpedantic", "-Werror"];
    let mut command = Command::new("c++");
    // No define: the source finds out for itself that the binding is not there.
    command
        .args(strict)
        .env_remove("CPLUS_INCLUDE_PATH")
        .arg(&source)
        .arg("-o")
        .arg(&program);
    assert!(command.status().unwrap().success());
    let run = |args: &[&OsStr]| {
        let output = Command::new(&program).args(args).output().unwrap();
        let text = |bytes: Vec<u8>| String::from_utf8(bytes).unwrap().trim().to_owned();
        (
            output.status.success(),
            text(output.stdout),
            text(output.stderr),
        )
    };

    let file = folder.join("sweep");
    let sweep = Source::StreetVlp16Dual.sweeps().swap_remove(1);
    std::fs::write(&file, sweep.as_ref()).unwrap();
    let view = SweepRef::open(sweep.as_ref()).unwrap();
    let (done, said, _) = run(&[file.as_os_str()]);
    let obstacles = view
        .returns()
        .filter(|one| one.label >= 2 && one.range_m == nearest(&view).unwrap());
    let [x, y, z] = obstacles.map(|one| one.point_m).next().unwrap();
    let expected = format!(
        "nearest {:.2} m at ({x:.2} {y:.2} {z:.2})",
        nearest(&view).unwrap()
    );
    assert!(done && said.ends_with(&expected), "{said}, not {expected}");
    assert!(
        said.starts_with(&format!("file {}:", view.header.sequence)),
        "{said}"
    );
    std::fs::write(&file, &sweep.as_ref()[..1000]).unwrap();
    let (done, _, error) = run(&[file.as_os_str()]);
    assert!(!done && error.contains("too few bytes"), "{error}");

    let message = objects::honest();
    let message = objects::message(&message);
    std::fs::write(&file, message).unwrap();
    let args = ["--objects".as_ref(), file.as_os_str()];
    let lines: Vec<String> = run(&args).1.lines().map(str::to_owned).collect();
    check_object_lines(&lines, "file");
    std::fs::write(&file, &message[..message.len() - 1]).unwrap();
    let (done, _, error) = run(&args);
    assert!(!done && error.contains("too few bytes"), "{error}");

    let own = temp_domain();
    for root in [own.root(), "/run/sweepd/iox2".as_ref(), "/a".as_ref()] {
        let prefix = sweepd::publish::Domain::at(root).prefix();
        assert_eq!(run(&["--prefix".as_ref(), root.as_os_str()]).1, prefix);
    }
    assert_eq!(
        run(&["--owner".as_ref(), own.root().as_os_str()]).1,
        "not there"
    );
    std::fs::create_dir(own.root()).unwrap();
    assert_eq!(
        run(&["--owner".as_ref(), own.root().as_os_str()]).1,
        "this user's"
    );
    if std::os::unix::fs::chown(own.root(), Some(65_534), None).is_ok() {
        let (done, _, error) = run(&["--owner".as_ref(), own.root().as_os_str()]);
        assert!(!done && error.contains("belongs to user nobody"), "{error}");
    }

    let library = folder.join("library.cpp");
    std::fs::write(&library, "#include \"iox2/iceoryx2.hpp\"\n").unwrap();
    let mut probe = Command::new("c++");
    let probe = probe
        .args(["-std=c++17", "-fsyntax-only"])
        .arg(&library)
        .stderr(Stdio::null())
        .status()
        .unwrap();
    if !probe.success() {
        // No distribution has it and no registry: it is not asked for, not even under CI=true.
        eprintln!(
            "SKIPPED: iceoryx2's C++ headers are not installed (CPLUS_INCLUDE_PATH), consumer.cpp is compiled without"
        );
        return;
    }
    let mut whole = Command::new("c++");
    let whole = whole
        .args(["-std=c++17", "-Wall", "-Wextra", "-fsyntax-only"])
        .arg(&source)
        .output()
        .unwrap();
    assert!(
        whole.status.success(),
        "{}",
        String::from_utf8_lossy(&whole.stderr)
    );
}

/// The commands at the top of examples/CMakeLists.txt, on a machine without the binding: they warn,
/// and the program checks a file.
#[test]
#[cfg_attr(without_compilers, ignore = "no compilers")]
fn cmake_builds_the_cpp_consumer() {
    let folder = folder("cmake");
    let build = folder.join("build");
    let mut configure = Command::new("cmake");
    configure
        .arg("-S")
        .arg(of_project("examples"))
        .arg("-B")
        .arg(&build);
    let configured = configure
        .arg("-DCMAKE_DISABLE_FIND_PACKAGE_iceoryx2-cxx=ON")
        .output()
        .unwrap();
    let warning = String::from_utf8_lossy(&configured.stderr);
    assert!(
        configured.status.success() && warning.contains("iceoryx2-cxx 0.10 was not found"),
        "{warning}"
    );
    let built = Command::new("cmake")
        .arg("--build")
        .arg(&build)
        .output()
        .unwrap();
    assert!(
        built.status.success(),
        "{}",
        String::from_utf8_lossy(&built.stderr)
    );
    let file = folder.join("sweep");
    std::fs::write(
        &file,
        Source::StreetVlp16Dual.sweeps().swap_remove(1).as_ref(),
    )
    .unwrap();
    let said = Command::new(build.join("consumer"))
        .arg(&file)
        .output()
        .unwrap();
    assert!(
        said.status.success() && said.stdout.starts_with(b"file "),
        "{said:?}"
    );
}
