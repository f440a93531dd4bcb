//! `sweepd watch` of what `sweepd replay --publish` shares, each in a process of its own.

use std::fs::Permissions;
use std::io::{BufRead, BufReader};
use std::os::unix::fs::PermissionsExt;
use std::os::unix::process::CommandExt;
use std::process::{Child, Command, Output, Stdio};
use std::time::{Duration, Instant};

use crate::{Folder, Ran, command, fixture, replay, sweepd, sweeps};
use sweepd_testkit::{PATIENCE, TempDomain, copy_program, temp_domain};

/// The binary in a domain of the test's own.
fn within(own: &TempDomain, args: &[&str]) -> Command {
    let mut command = command(args);
    command
        .env("SWEEPD_ROOT", own.root())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped());
    command
}

fn output(mut child: Child) -> Output {
    let begun = Instant::now();
    while child.try_wait().unwrap().is_none() {
        if begun.elapsed() > PATIENCE {
            child.kill().unwrap();
            panic!("it does not end");
        }
        std::thread::sleep(Duration::from_millis(10));
    }
    child.wait_with_output().unwrap()
}

#[test]
fn what_is_watched_is_what_is_replayed() {
    let own = temp_domain();
    let folder = Folder::new("watched");
    for name in ["street_vlp16_dual.pcap.gz", "street_hdl32e.pcap.gz"] {
        let capture = fixture(name);
        let path = capture.to_str().unwrap();
        let options = [
            "--json",
            "--no-timing",
            "--partial",
            "--force",
            "--csv",
            folder.path("replayed").to_str().unwrap(),
        ]
        .map(str::to_owned);
        let mut expected =
            sweeps(&replay(&capture, &options.each_ref().map(String::as_str)).done());
        expected.pop();
        let count = expected.len().to_string();
        let csv = folder.path("watched");
        let csv = csv.to_str().unwrap();
        // Started first, it waits.
        let args = [
            "watch",
            "--sweeps",
            &count,
            "--timeout",
            "60",
            "--json",
            "--no-timing",
            "--force",
            "--csv",
            csv,
        ];
        let watch = within(&own, &args).spawn().unwrap();
        // Slowly, since a process takes a while to begin.
        let shared = within(
            &own,
            &["replay", path, "--publish", "roof", "--speed", "0.1"],
        )
        .spawn()
        .unwrap();
        let watched = Ran::of(output(watch));
        let shared = Ran::of(output(shared));
        let address = expected[0]["sensor"].as_str().unwrap();
        assert_eq!(
            (shared.code, shared.stderr),
            (0, format!("note: {address} is shared as roof\n"))
        );
        assert_eq!(watched.code, 0, "{}", watched.stderr);
        assert!(
            watched
                .stderr
                .lines()
                .all(|line| line.starts_with("note: ")),
            "{}",
            watched.stderr
        );
        let watched = sweeps(&watched.stdout);
        for line in &mut expected {
            line["sensor"] = "roof".into();
        }
        assert!(watched.len() > 3 && watched == expected, "{name}");
        assert!(
            folder.files("watched") == folder.files("replayed"),
            "{name}"
        );
    }
}

#[test]
fn several_sensors_are_listed_and_none_are_waited_for() {
    let own = temp_domain();
    within(&own, &["watch", "--timeout", "0.3"])
        .output()
        .map(Ran::of)
        .unwrap()
        .says(&["no sensor is published in"]);
    let capture = fixture("street_vlp16.pcap.gz");
    let publishing = |name| {
        within(
            &own,
            &[
                "replay",
                capture.to_str().unwrap(),
                "--publish",
                name,
                "--loop=200",
            ],
        )
        .spawn()
        .unwrap()
    };
    let mut children = [publishing("roof"), publishing("rear")];
    for name in ["roof", "rear"] {
        let watched = within(&own, &["watch", name, "--sweeps", "1", "--timeout", "60"])
            .output()
            .map(Ran::of)
            .unwrap();
        assert_eq!(watched.code, 0, "{}", watched.stderr);
        // The part of a second that one sweep is has its line, below the head.
        let [model, head, line] = watched.stdout.lines().collect::<Vec<_>>()[..] else {
            panic!("{}", watched.stdout)
        };
        assert!(model.starts_with(&format!("{name}: VLP-16")), "{model}");
        assert_eq!(head.split_whitespace().next(), Some("sweeps/s"));
        assert_eq!(line.split_whitespace().nth(1), Some("600"), "{line}");
    }
    within(&own, &["watch"])
        .output()
        .map(Ran::of)
        .unwrap()
        .says(&["several sensors", "rear, roof"]);
    let mistyped = within(&own, &["watch", "rof", "--timeout", "0.3"])
        .output()
        .map(Ran::of)
        .unwrap();
    mistyped.says(&["rof: not published", "did you mean `roof`?", "rear, roof"]);
    let strange = within(&own, &["watch", "camera", "--timeout", "0.3"])
        .output()
        .map(Ran::of)
        .unwrap();
    strange.says(&["camera: not published", "; published in", "rear, roof"]);
    let taken = within(
        &own,
        &["replay", capture.to_str().unwrap(), "--publish", "roof"],
    )
    .output()
    .map(Ran::of)
    .unwrap();
    taken.says(&["`roof` is published by another program"]);
    for child in &mut children {
        child.kill().unwrap();
        child.wait().unwrap();
    }
}

#[test]
fn another_user_gets_an_error_that_names_the_owner() {
    let own = temp_domain();
    let capture = fixture("street_vlp16.pcap.gz");
    let mut child = within(
        &own,
        &[
            "replay",
            capture.to_str().unwrap(),
            "--publish",
            "roof",
            "--loop=200",
        ],
    )
    .spawn()
    .unwrap();
    let watch = ["watch", "roof", "--sweeps", "1", "--timeout", "60"];
    assert_eq!(within(&own, &watch).output().map(Ran::of).unwrap().code, 0);
    if sweepd_testkit::is_root() {
        // The binary is where nobody may look; a copy is not.
        let folder = Folder::new("nobody");
        let copy = folder.path("sweepd");
        copy_program(&copy);
        for open in [folder.0.path(), own.folder()] {
            std::fs::set_permissions(open, Permissions::from_mode(0o755)).unwrap();
        }
        let nobody = |program: &str, args: &[&str]| {
            let mut command = Command::new(program);
            command
                .args(args)
                .env("SWEEPD_ROOT", own.root())
                .current_dir("/")
                .uid(65_534)
                .gid(65_534);
            Ran::of(command.output().unwrap())
        };
        nobody(copy.to_str().unwrap(), &watch).says(&["belongs to user root", "runs as nobody"]);
        let shared = own.shared_memory();
        assert!(
            shared
                .iter()
                .any(|file| file.to_string_lossy().ends_with(".data")),
            "{shared:?}"
        );
        for file in &shared {
            let file = file.to_str().unwrap();
            assert_ne!(
                nobody("/usr/bin/head", &["-c", "1", file]).code,
                0,
                "{file} can be read"
            );
            // One that is gone by now is not made.
            let write = [
                "if=/dev/null",
                &format!("of={file}"),
                "conv=nocreat,notrunc",
            ];
            assert_ne!(nobody("/bin/dd", &write).code, 0, "{file} can be written");
        }
        assert_ne!(nobody("/bin/ls", &[own.root().to_str().unwrap()]).code, 0);
    }
    child.kill().unwrap();
    child.wait().unwrap();
}

/// As of the service's folder: the cure is its user, whether or not a daemon runs.
#[test]
fn who_may_not_look_into_the_folder_is_told_whose_it_is() {
    if !sweepd_testkit::is_root() {
        return;
    }
    let folder = Folder::new("closed");
    let [copy, run] = ["sweepd", "run"].map(|name| folder.path(name));
    copy_program(&copy);
    std::fs::create_dir(&run).unwrap();
    std::fs::set_permissions(folder.0.path(), Permissions::from_mode(0o755)).unwrap();
    std::fs::set_permissions(&run, Permissions::from_mode(0o750)).unwrap();
    std::os::unix::fs::chown(&run, Some(1), Some(1)).unwrap();
    for args in [&["watch", "roof"][..], &["run", "--sensor", "127.0.0.1"]] {
        let mut command = Command::new(&copy);
        let command = command.args(args).env("SWEEPD_ROOT", run.join("iox2"));
        let ran = command.current_dir("/").uid(65_534).gid(65_534).output();
        Ran::of(ran.unwrap()).says(&[
            "belongs to user daemon",
            "runs as nobody",
            "`sudo -u daemon",
        ]);
    }
}

/// Ctrl-C, in the middle of waiting: that is no error, and what was asked for at the end is shown.
#[test]
fn ctrl_c_ends_it_well() {
    let own = temp_domain();
    let capture = fixture("street_vlp16.pcap.gz");
    let mut shared = within(
        &own,
        &[
            "replay",
            capture.to_str().unwrap(),
            "--publish",
            "roof",
            "--loop=200",
        ],
    )
    .spawn()
    .unwrap();
    let folder = Folder::new("watch-signals");
    for signal in ["-INT", "-TERM"] {
        let segments = folder.path(&format!("all{signal}.csv"));
        let args = [
            "watch",
            "roof",
            "--json",
            "--latency",
            "--segments",
            segments.to_str().unwrap(),
        ];
        let mut watch = within(&own, &args).spawn().unwrap();
        let mut lines = BufReader::new(watch.stdout.take().unwrap()).lines();
        assert!(lines.next().unwrap().unwrap().contains("\"seq\""));
        assert!(
            Command::new("kill")
                .args([signal, &watch.id().to_string()])
                .status()
                .unwrap()
                .success()
        );
        // All of them: a reader that goes away in the middle is told by the exit code.
        let rest: Vec<String> = lines.map(Result::unwrap).collect();
        assert!(
            rest.iter().any(|line| line.starts_with("chain: ")),
            "no histograms"
        );
        let watched = Ran::of(output(watch));
        let told = format!("to {}\n", segments.display());
        assert!(
            watched.code == 0
                && watched.stderr.contains("note: written: ")
                && watched.stderr.ends_with(&told),
            "{signal}: {}",
            watched.stderr
        );
        let segments = std::fs::read_to_string(segments).unwrap();
        assert!(
            segments.lines().count() > 10 && segments.ends_with('\n'),
            "{signal}: {segments}"
        );
    }
    shared.kill().unwrap();
    shared.wait().unwrap();
}

#[test]
fn names_that_are_none_are_refused() {
    let own = temp_domain();
    let long = "x".repeat(300);
    for name in ["", "a/b", &long] {
        let ran = sweepd(&["watch", name, "--root", own.root().to_str().unwrap()]);
        ran.says(&["cannot be the name of a sensor"]);
    }
}
