//! The example consumers as programs: what they print, how they end, and what they leave.

use std::ffi::OsStr;
use std::os::unix::process::ExitStatusExt;
use std::path::PathBuf;
use std::process::{Command, Stdio};
use std::time::Duration;

use serde_json::Value;
use sweepd::client::Client;
use sweepd::sweep::SweepRef;

use super::common::{python_with_iceoryx2, temp_domain};
use super::python::{Talk, loans, publish};
use super::sweeps::Source;
use super::{folder, of_project};
use sweepd_lab::testkit::TempDomain;

/// The Rust consumer, built as these tests are, with the same features: `cargo test` has done so
/// before.
fn rust_consumer() -> PathBuf {
    let mut cargo = Command::new(env!("CARGO"));
    cargo
        .args(
            "build --quiet --locked --offline --features slow-tests --example consumer".split(' '),
        )
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
        .join("examples/consumer")
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
        let mut copy =
            sweepd::sweep::Buffers::take(&mut sweepd::sweep::HeapBuffers::default(), bytes.len());
        copy.as_mut().copy_from_slice(&bytes);
        check(&SweepRef::open(copy.as_ref()).unwrap(), &consumer.line());
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
    let program = rust_consumer();
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

fn publish_until_line(loans: &mut sweepd::publish::Loans, consumer: &Talk) {
    let lines = (0..200).filter_map(|sequence| {
        publish(loans, sequence);
        consumer.try_line(Duration::from_millis(100))
    });
    assert!(lines.take(1).count() == 1, "it never got one");
}

#[test]
#[cfg_attr(without_python, ignore = "no SWEEPD_PYTHON")]
fn the_python_consumer_prints_a_line_a_sweep_and_ends_at_once() {
    let python = python_with_iceoryx2();
    let script = of_project("examples/consumer.py");
    let own = temp_domain();
    let args = [
        script.as_os_str(),
        "roof".as_ref(),
        "--root".as_ref(),
        own.root().as_os_str(),
    ];
    let mut consumer = Talk::start(&python, &args);
    play_to(&consumer, &own, check_line);
    interrupt(&consumer);
    assert!(consumer.end().success());

    let own = temp_domain();
    let args = [
        script.as_os_str(),
        "roof".as_ref(),
        "--json".as_ref(),
        "--root".as_ref(),
        own.root().as_os_str(),
    ];
    play_to(&Talk::start(&python, &args), &own, |sweep, line| {
        let said: Value = serde_json::from_str(line).unwrap();
        let numbers = ["seq", "columns", "rows", "returns", "segments"]
            .map(|key| said[key].as_u64().unwrap());
        let (columns, rows, segments) = (
            sweep.columns.len() as u64,
            sweep.rows() as u64,
            sweep.segments.len() as u64,
        );
        assert_eq!(
            numbers,
            [
                sweep.header.sequence,
                columns,
                rows,
                sweep.header.returns.into(),
                segments
            ]
        );
        assert_eq!(
            said["nearest_m"].as_f64().map(|nearest_m| nearest_m as f32),
            nearest(sweep)
        );
        assert_eq!(
            (&said["sensor"], &said["missed"]),
            (&"roof".into(), &0.into())
        );
    });
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
