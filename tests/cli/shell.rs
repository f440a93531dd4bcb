//! The commands in a shell: pipes that are closed, exit codes, colours.

use std::process::{Command, Stdio};

use crate::{Folder, Ran, sweepd};

const CAPTURE: &str = "pcap_fixtures/street_vlp16.pcap.gz";

/// A script of bash, for which `sweepd` is this one.
fn bash(script: &str) -> Ran {
    let sweepd = sweepd_testkit::program();
    let script = format!(
        "set -o pipefail; sweepd() {{ '{}' \"$@\"; }}; {script}",
        sweepd.display()
    );
    let mut bash = Command::new("bash");
    bash.args(["-c", &script]).stdin(Stdio::null());
    Ran::of(bash.current_dir(sweepd_testkit::root()).output().unwrap())
}

#[test]
fn a_reader_that_had_enough_is_success_without_a_word() {
    for command in [
        "--help",
        "config example",
        "config check examples/loopback.toml",
        "config check examples/loopback.toml --json",
        "calib show calib/hdl32e.yaml",
        "calib show calib/hdl32e.yaml --json",
        &format!("inspect {CAPTURE}"),
        &format!("inspect {CAPTURE} --json"),
        &format!("replay {CAPTURE}"),
        &format!("replay {CAPTURE} --json"),
        &format!("replay {CAPTURE} --objects"),
        &format!("replay {CAPTURE} --loop --segments -"),
        &format!("replay {CAPTURE} --raw -"),
        &format!("replay {CAPTURE} --pcap -"),
        "completions bash",
    ] {
        let ran = bash(&format!("sweepd {command} | head -c 1 > /dev/null"));
        let said: Vec<&str> = ran
            .stderr
            .lines()
            .filter(|line| !line.starts_with("warning: "))
            .collect();
        assert_eq!(
            (ran.code, &said[..]),
            (0, &[][..]),
            "{command}: {}",
            ran.stderr
        );
    }
    // What it found is its answer all the same.
    let ran = bash("sweepd calib diff calib/vlp16.yaml calib/puck-hires.yaml | true");
    assert_eq!((ran.code, &ran.stderr[..]), (1, ""));
}

#[test]
fn what_goes_elsewhere_beside_a_pipe_that_is_closed_is_said_to_be_cut() {
    let folder = Folder::new("cut-short");
    let out = folder.path("out").display().to_string();
    let root = folder.path("iox2").display().to_string();
    for (options, place) in [
        (format!("--png '{out}'"), &out[..]),
        (
            format!("--publish roof --root '{root}'"),
            "consumers of roof",
        ),
        ("--to 127.0.0.1:9".to_owned(), "127.0.0.1:9"),
    ] {
        let command = format!("sweepd replay {CAPTURE} --loop --json --speed max {options}");
        let ran = bash(&format!("{command} | head -c 1"));
        assert_eq!(ran.code, 1, "{options}: {}", ran.stderr);
        ran.says(&["standard output was closed", place, "not complete"]);
    }
}

/// The codes of the table in `sweepd --help`.
fn table() -> Vec<i32> {
    let help = sweepd(&["--help"]).done();
    let (_, table) = help.split_once("Exit codes:\n").expect(&help);
    let lines = table.lines().take_while(|line| !line.is_empty());
    lines
        .map(|line| line.split_whitespace().next().unwrap().parse().unwrap())
        .collect()
}

#[test]
fn each_exit_code_is_in_the_table_and_errors_are_one_line() {
    assert_eq!(table(), [0, 1, 2, 66, 78]);
    let folder = Folder::new("exit-codes");
    let text = folder.write("text.pcap", "no capture");
    let wrong = folder.write("wrong.toml", "port = 1\n");
    for (code, words) in [
        (0, &["inspect", CAPTURE][..]),
        (1, &["inspect", text.to_str().unwrap()]),
        (2, &["inspect", "--no-such-option"]),
        (2, &["replay", CAPTURE, "--json", "--segments", "-"]),
        (78, &["config", "check", wrong.to_str().unwrap()]),
        (78, &["run", "--config", wrong.to_str().unwrap()]),
    ] {
        assert_eq!(sweepd(words).code, code, "{words:?}");
    }
    let paths = [folder.path(""), folder.path("none")];
    let [folder, missing] = paths.each_ref().map(|path| path.to_str().unwrap());
    let picture = format!("{missing}.png");
    for words in [
        &["replay"][..],
        &["inspect"],
        &["calib", "show"],
        &["calib", "from-capture", "-o", "unit.yaml"],
        &["mask", "-o", &picture],
        &["config", "check"],
        &["run", "--config"],
        &["doctor", "--config"],
        &["replay", CAPTURE, "--config"],
        &["replay", CAPTURE, "--calibration"],
        &["replay", CAPTURE, "--mask"],
    ] {
        for (file, cure) in [
            (folder, "; give a file in it"),
            (missing, "; check the path"),
        ] {
            let ran = sweepd(&[words, &[file]].concat());
            assert_eq!(
                (ran.code, &ran.stdout[..]),
                (66, ""),
                "{words:?}: {}",
                ran.stderr
            );
            ran.says(&[file.trim_end_matches('/'), cure]);
            assert_eq!(ran.stderr.lines().count(), 1, "{words:?}: {}", ran.stderr);
        }
    }
}

/// What a command shows on a terminal, which `script` makes.
fn shown(command: &str, no_color: &str) -> String {
    let mut script = Command::new("script");
    let program = sweepd_testkit::program();
    script
        .args([
            "--quiet",
            "--command",
            &format!("'{}' {command}", program.display()),
            "/dev/null",
        ])
        .env("TERM", "xterm")
        .env("NO_COLOR", no_color)
        .stdin(Stdio::null())
        .current_dir(sweepd_testkit::root());
    String::from_utf8(script.output().unwrap().stdout).unwrap()
}

/// Whether a text sets colours or weights: ESC, `[`, numbers, `m`.
fn is_coloured(text: &str) -> bool {
    let sequences = text.split("\x1b[").skip(1);
    let mut ends = sequences.map(|sequence| {
        sequence.trim_start_matches(|one: char| one.is_ascii_digit() || one == ';')
    });
    ends.any(|end| end.starts_with('m'))
}

#[test]
fn no_color_is_obeyed_by_every_stream_on_a_terminal() {
    // The log comes before the error of a root that cannot be.
    let log = "run --sensor 127.0.0.1 --root /proc/none";
    for (command, part) in [
        (log, "with --sensor"),
        ("--help", "Usage:"),
        ("inspect --no-such-option", "error:"),
    ] {
        let [with, without] = ["", "1"].map(|no_color| shown(command, no_color));
        assert!(
            with.contains(part) && without.contains(part),
            "{command}: {with}{without}"
        );
        assert_eq!(
            (is_coloured(&with), is_coloured(&without)),
            (true, false),
            "{command}: {with}{without}"
        );
    }
}
