//! The program from outside: its errors, its exit codes, its end.

use std::io::{BufRead, BufReader, Read};
use std::process::{Command, Output, Stdio};
use std::time::{Duration, Instant};

use sweepd_testkit::Stopwatch;

/// The program on a ROS domain of its own, on this host alone.
fn program(dds_domain: &str, words: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_sweepd-ros2"));
    command
        .args(words)
        .env_clear()
        .env("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
        .env("ROS_DOMAIN_ID", dds_domain)
        .stdin(Stdio::null());
    command
}

fn said(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

#[test]
fn what_is_wrong_is_one_line_and_an_exit_code() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("ros2.yaml");
    std::fs::write(&file, "/**:\n  ros__parameters:\n    stamp: centre\n").unwrap();
    let file = file.to_str().unwrap();
    for (dds_domain, words, code, part) in [
        (
            "140",
            &["--parameters", file][..],
            78,
            "ros2.yaml:3: `stamp`: expected first or middle or last",
        ),
        (
            "140",
            &["--params-file", "/none.yaml"],
            66,
            "/none.yaml: cannot be read: No such file or directory (os error 2); check the path",
        ),
        (
            "140",
            &["--params-file", "/proc"],
            66,
            "/proc: cannot be read: Is a directory (os error 21); give a file in it",
        ),
        (
            "140",
            &["--ros-args", "-p", "stamp:=centre"],
            78,
            "-p stamp:=centre: `stamp`: expected first or middle or last",
        ),
        (
            "140",
            &["--ros-args", "--parms", "x"],
            2,
            "unknown argument --parms of --ros-args",
        ),
        (
            "140",
            &["--node", "my-node"],
            78,
            "`my-node` is no name of a node",
        ),
        (
            "140",
            &["roof", "--ros-args", "-r", "~/roof/points:=/a-b"],
            2,
            "expected [NODE:]NAME:=NAME with names of ROS, not `~/roof/points:=/a-b`",
        ),
        ("140", &["a/b"], 2, "a sensor's name has letters, digits"),
        ("nine", &[], 78, "ROS_DOMAIN_ID is `nine`"),
    ] {
        let output = program(dds_domain, words).output().unwrap();
        let said = said(&output);
        let errors = said.matches("error: ").count();
        assert!(
            output.status.code() == Some(code) && said.contains(part) && errors == 1,
            "{words:?}: {:?}: {said}",
            output.status
        );
    }
}

#[test]
fn what_the_environment_asks_for_and_cannot_be_is_told() {
    let zenoh = "warning: RMW_IMPLEMENTATION is `rmw_zenoh_cpp`: ";
    let security = "warning: ROS_SECURITY_ENABLE is `true`: ";
    let enforced = "error: ROS_SECURITY_STRATEGY is `Enforce`: ";
    let name = "error: `my-node` is no name of a node";
    for (strategy, expected) in [
        ("Permissive", &[security, zenoh, name][..]),
        ("Enforce", &[enforced]),
    ] {
        // The wrong name ends it.
        let output = program("140", &["--node", "my-node"])
            .env("RMW_IMPLEMENTATION", "rmw_zenoh_cpp")
            .env("ROS_SECURITY_ENABLE", "true")
            .env("ROS_SECURITY_STRATEGY", strategy)
            .output()
            .unwrap();
        let said = said(&output);
        let begins = |(line, begin): (&str, &&str)| line.starts_with(begin);
        assert!(
            output.status.code() == Some(78)
                && said.lines().count() == expected.len()
                && said.lines().zip(expected).all(begins),
            "{:?}: {said}",
            output.status
        );
    }
}

/// Whether SIGTERM and SIGINT no longer kill a process at once.
fn handles_signals(pid: u32) -> bool {
    let status = std::fs::read_to_string(format!("/proc/{pid}/status")).unwrap();
    let mut lines = status.lines();
    let mask = lines.find_map(|line| line.strip_prefix("SigCgt:")).unwrap();
    let both = 1 << 14 | 1 << 1;
    u64::from_str_radix(mask.trim(), 16).unwrap() & both == both
}

#[test]
fn it_waits_for_a_daemon_and_ends_when_told() {
    let folder = tempfile::tempdir().unwrap();
    for signal in ["-TERM", "-INT"] {
        let mut child = program("141", &["roof", "--ros-args", "-r", "__ns:=/robot"])
            .arg("--")
            .arg("--root")
            .arg(folder.path().join("iox2"))
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        let mut stderr = BufReader::new(child.stderr.take().unwrap());
        let mut said = String::new();
        stderr.read_line(&mut said).unwrap();
        let begun = Instant::now();
        while !handles_signals(child.id()) {
            assert!(begun.elapsed() < Duration::from_secs(60), "{said}");
            std::thread::sleep(Duration::from_millis(5));
        }
        std::thread::sleep(Duration::from_millis(300));
        assert!(child.try_wait().unwrap().is_none(), "it waits");
        let begun = Stopwatch::start();
        let pid = child.id().to_string();
        assert!(
            Command::new("kill")
                .args([signal, &pid])
                .status()
                .unwrap()
                .success()
        );
        stderr.read_to_string(&mut said).unwrap();
        assert!(
            child.wait().unwrap().success() && begun.elapsed() < Duration::from_secs(3),
            "{signal}"
        );
        assert!(
            said.starts_with("info: node /robot/sweepd on ROS domain 141"),
            "{said}"
        );
    }
}

#[test]
fn the_page_has_what_help_says() {
    let output = program("140", &["--help"]).output().unwrap();
    let help = String::from_utf8(output.stdout).unwrap();
    let page = std::fs::read_to_string(concat!(env!("CARGO_MANIFEST_DIR"), "/../../docs/ros2.md"));
    let lines: Vec<&str> = help.trim_end().lines().map(str::trim_end).collect();
    assert!(
        page.unwrap().contains(&lines.join("\n")),
        "docs/ros2.md has another help:\n{help}"
    );
}

#[test]
fn a_static_peer_that_is_not_known_is_a_warning() {
    let mut child = program("142", &["roof", "--root", "/none"])
        .env("ROS_STATIC_PEERS", "127.0.0.1;nobody.invalid")
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut lines = BufReader::new(child.stderr.take().unwrap()).lines();
    let mut said = vec![];
    for part in [
        "info: node /sweepd on ROS domain 142",
        "warning: static peer nobody.invalid is not known: ",
    ] {
        while !said.iter().any(|line: &String| line.starts_with(part)) {
            said.push(lines.next().unwrap().unwrap());
        }
    }
    let pid = child.id().to_string();
    let kill = Command::new("kill").args(["-TERM", &pid]).status();
    assert!(
        kill.unwrap().success() && child.wait().unwrap().success(),
        "{said:?}"
    );
}
