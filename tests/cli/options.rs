//! Help, exit codes, and every number that cannot be meant.

use crate::{Folder, Ran, command, fixture, inspect, replay, sweepd, sweeps};

/// A line that is broken by hand at one width and by clap at another leaves a stump: a line that a
/// word of the next would have fitted in. At 80 columns and at 100, no help has one but where a
/// line was meant to end.
#[test]
fn every_help_has_an_example_and_fits_a_terminal() {
    use clap::CommandFactory;

    let mut program = sweepd::cli::Cli::command();
    program.build();
    let mut commands: Vec<clap::Command> = vec![program.clone()];
    for command in program
        .get_subcommands()
        .filter(|command| command.get_name() != "help")
    {
        let inner = command
            .get_subcommands()
            .filter(|command| command.get_name() != "help");
        commands.extend(inner.cloned());
        commands.push(command.clone());
    }
    assert!(commands.len() > 15);
    for command in &commands {
        let name = command.get_name();
        for width in [80, 100] {
            let text = command
                .clone()
                .term_width(width)
                .render_long_help()
                .to_string();
            let longest = text.lines().map(|line| line.chars().count()).max();
            assert!(
                longest <= Some(width),
                "{name}: {longest:?} of {width} columns"
            );
        }
        let Some(after) = command.get_after_help() else {
            assert!(command.has_subcommands(), "{name} has no example");
            continue;
        };
        let after = after.to_string();
        assert!(
            after.contains("Example") && after.contains("\n  sweepd "),
            "{name}"
        );
        // Prose is one line, which clap breaks; what is broken by hand is narrower than any
        // terminal.
        for (line, next) in after.lines().zip(after.lines().skip(1)) {
            let is_table = line.starts_with(' ') || line.ends_with(':') || line.is_empty();
            assert!(
                is_table || next.is_empty(),
                "{name}: prose is broken by hand: {line}"
            );
            assert!(
                !line.starts_with(' ') || line.chars().count() <= 78,
                "{name}: {line}"
            );
        }
    }
    let version = sweepd(&["--version"]).done();
    let commit = if cfg!(debug_assertions) {
        " (debug build)"
    } else {
        " ("
    };
    assert!(
        version.starts_with(&format!("sweepd {}{commit}", env!("CARGO_PKG_VERSION"))),
        "{version}"
    );
    for args in [&[][..], &["play"], &["replay"], &["replay", "a", "--fast"]] {
        assert_eq!(sweepd(args).code, 2, "{args:?}");
    }
}

#[test]
fn the_examples_of_the_help_are_accepted() {
    let text = sweepd(&["replay", "--help"]).done();
    let examples: Vec<&str> = text
        .lines()
        .filter_map(|line| line.strip_prefix("  sweepd replay "))
        .collect();
    assert!(examples.len() >= 3);
    // The folders for the output are made before the capture is opened.
    let folder = Folder::new("examples");
    folder.write("sweepd.toml", sweepd(&["config", "example"]).done());
    for example in examples {
        let words = example.split(" > ").next().unwrap().split(' ').skip(1);
        // A capture that is not there: all options were understood when that is what is wrong.
        let args = [&["replay", "none.pcap"], &words.collect::<Vec<_>>()[..]].concat();
        let ran = Ran::of(
            command(&args)
                .current_dir(folder.path(""))
                .output()
                .unwrap(),
        );
        ran.says(&["cannot open none.pcap"]);
    }
}

#[test]
fn the_examples_of_record_are_understood() {
    let text = sweepd(&["record", "--help"]).done();
    let examples: Vec<&str> = text
        .lines()
        .filter_map(|line| line.strip_prefix("  sweepd record "))
        // Sweeps are waited for.
        .filter(|example| !example.contains("--mcap"))
        .collect();
    assert!(examples.len() >= 3);
    for example in examples {
        // An address that is no host's, from the blocks for documentation.
        let (nowhere, expected) = match example.contains("--from") {
            true => (
                ["--root", "/nonexistent/root"],
                "no daemon listens at /nonexistent/root/control.sock",
            ),
            false => (["--bind", "192.0.2.1"], "has the address 192.0.2.1"),
        };
        let args = [
            &["record"],
            &nowhere[..],
            &example.split(' ').collect::<Vec<_>>()[..],
        ]
        .concat();
        let args: Vec<&str> = args
            .into_iter()
            .map(|word| if word == "eth1" { "lo" } else { word })
            .collect();
        sweepd(&args).says(&[expected]);
    }
    for args in [
        ["--seconds=0", "0.1 to"],
        ["--rotate-mb=-1", "0.01 to"],
        ["--rotate-seconds=nan", "0.1 to"],
    ] {
        let ran = sweepd(&["record", "-o", "x.pcap", args[0]]);
        assert!(
            ran.code == 2 && ran.stderr.contains(args[1]),
            "{}",
            ran.stderr
        );
    }
}

/// Head down is a mount like any other; on its side the sensor finds no ground, and says so once.
#[test]
fn a_sensor_on_its_side_is_warned_of() {
    let capture = fixture("street_vlp16_losses.pcap");
    for roll in ["180", "-180"] {
        replay(&capture, &["--roll", roll]).done();
    }
    let ran = replay(&capture, &["--roll", "90", "--height", "1.8"]);
    assert_eq!(ran.code, 0, "{}", ran.stderr);
    let [warning] = ran.stderr.lines().collect::<Vec<_>>()[..] else {
        panic!("{}", ran.stderr)
    };
    let what = "warning: roll 90.0 and pitch 0.0 degrees tilt the sensor by more than 45 degrees";
    assert!(warning.starts_with(what), "{warning}");
}

/// Scripts of earlier versions go on.
#[test]
fn options_that_are_gone_are_accepted_with_a_warning() {
    for removed in sweepd::segment::settings::REMOVED {
        let option = format!("--{}", removed.option);
        let ran = replay(&fixture("street_vlp16.pcap.gz"), &[&option, "1"]);
        assert_eq!(ran.code, 0, "{}", ran.stderr);
        let warning = format!("warning: {}\n", removed.warning(&option));
        assert!(ran.stderr.contains(&warning), "{}", ran.stderr);
    }
    let help = sweepd(&["replay", "--help"]).stdout;
    assert!(!help.contains("--gap"), "{help}");
}

#[test]
fn theta_without_its_method_is_warned_of() {
    let folder = Folder::new("theta");
    let paper = folder.write(
        "paper.toml",
        "[[sensor]]\nname = \"roof\"\naddress = \"192.168.1.201\"\nsegment = { method = \"paper\" }\n",
    );
    let capture = fixture("street_vlp16_losses.pcap");
    let alone = replay(&capture, &["--theta", "12", "--height", "1.9"]);
    assert_eq!(alone.code, 0, "{}", alone.stderr);
    assert_eq!(
        alone.stderr,
        "warning: `--theta` does nothing: only the method `paper` reads it, and this is `slope`; leave it out, or add --method paper\n"
    );
    let paper = paper.to_str().unwrap();
    for with in [["--method", "paper"], ["--config", paper]] {
        replay(&capture, &[&with[..], &["--theta", "12"]].concat()).done();
    }
}

#[test]
fn absurd_numbers_are_refused_with_what_was_expected() {
    let cases = [
        ("--theta=0", "more than 0 and less than 90"),
        ("--theta=90", "more than 0 and less than 90"),
        ("--theta=-5", "0 to 90 degrees"),
        ("--theta=nan", "0 to 90 degrees"),
        ("--min-points=0", "expected a whole number from 1 on"),
        ("--min-points=-3", "expected a whole number from 1 on"),
        (
            "--min-points=9999999999",
            "expected a whole number from 1 on",
        ),
        ("--height=0", "0.01 to 200 metres"),
        ("--height=-1", "0.01 to 200 metres"),
        ("--height=1e30", "0.01 to 200 metres"),
        ("--pitch=100", "-90 to 90 degrees"),
        ("--roll=-181", "-180 to 180 degrees"),
        ("--cut-azimuth=1e300", "-360 to 360 degrees"),
        ("--min-range=-1", "0 to 1000 metres"),
        ("--max-range=inf", "0 to 1000 metres"),
        ("--max-range=0", "greater"),
        ("--start=-1", "0 to 1000000000 seconds"),
        ("--end=-1", "0 to 1000000000 seconds"),
        ("--end=soon", "0 to 1000000000 seconds"),
        ("--start=1e308", "0 to 1000000000 seconds"),
        ("--end=1e-300", "more than 0 seconds"),
        ("--end=0", "more than 0 seconds"),
        ("--speed=0", "a number from 0.001 to 1000"),
        ("--speed=-2", "a number from 0.001 to 1000"),
        ("--speed=1e-300", "a number from 0.001 to 1000"),
        ("--speed=1e6", "a number from 0.001 to 1000"),
        ("--speed=inf", "a number from 0.001 to 1000"),
        ("--loop=0", "1 or more"),
        ("--loop=-1", "1 or more"),
        ("--to=127.0.0.1:0", "IP:PORT such as 127.0.0.1:2368"),
        ("--to=localhost", "IP:PORT such as 127.0.0.1:2368"),
        ("--sensor=lidar", "expected IP, IP:PORT"),
    ];
    for (option, expected) in cases {
        let ran = replay(&fixture("street_vlp16_losses.pcap"), &[option]);
        let flag = option.split('=').next().unwrap();
        assert_eq!(ran.stdout, "", "{option}");
        assert!(ran.error().contains(expected), "{option}: {}", ran.stderr);
        // Values with a minus need no equals sign.
        let (_, value) = option.split_once('=').unwrap();
        if flag != "--loop" {
            let spaced = replay(&fixture("street_vlp16_losses.pcap"), &[flag, value]);
            assert_eq!(spaced.stderr, ran.stderr, "{option}");
        }
    }
    for pair in [["--start=2", "--end=1"], ["--start=1", "--end=1"]] {
        replay(&fixture("street_vlp16_losses.pcap"), &pair).says(&["--end is not after --start"]);
    }
    replay(
        &fixture("street_vlp16_losses.pcap"),
        &["--min-range=5", "--max-range=3"],
    )
    .says(&["greater"]);
    let turned = replay(
        &fixture("street_vlp16_losses.pcap"),
        &["--cut-azimuth", "-90", "--pitch", "-3", "--roll", "2"],
    );
    assert!(turned.done().contains(" whole"));
}

#[test]
fn what_was_asked_for_and_is_not_there_is_an_error() {
    let capture = fixture("street_vlp16_losses.pcap");
    replay(&capture, &["--sensor", "1.2.3.4"]).says(&["no sensor 1.2.3.4", "inspect"]);
    let one = replay(
        &capture,
        &["--sensor", "192.168.1.201", "--sensor", "192.168.1.201:99"],
    );
    one.says(&["no sensor 192.168.1.201:99"]);
    assert!(one.stdout.contains("3 whole"), "{}", one.stdout);
    replay(&capture, &["--start", "5"]).says(&["no data packets from 5 s", "0.399 s"]);
    replay(&capture, &["--start", "5", "--end", "1e9", "--json"])
        .says(&["no data packets from 5 s"]);
}

#[test]
fn a_loop_goes_round_and_goes_on_counting() {
    let capture = fixture("street_vlp16_losses.pcap");
    let once = sweeps(&replay(&capture, &["--json", "--no-timing", "--start", "0.1"]).done());
    let twice = sweeps(
        &replay(
            &capture,
            &["--json", "--no-timing", "--start", "0.1", "--loop=2"],
        )
        .done(),
    );
    let count = once.len() - 1;
    assert_eq!(twice.len() - 1, 2 * count);
    let mut last = 0;
    for (index, line) in twice[..2 * count].iter().enumerate() {
        let sequence = line["sequence"].as_u64().unwrap();
        assert!(sequence > last, "no number comes twice");
        last = sequence;
        assert_eq!(line["time_ns"], once[index % count]["time_ns"]);
    }
    let (once, twice) = (&once[count]["summary"], &twice[2 * count]["summary"]);
    assert_eq!(twice["capture"], once["capture"]);
    for key in ["packets", "returns", "lost_packets"] {
        assert_eq!(
            twice["sensors"][0][key].as_u64(),
            once["sensors"][0][key].as_u64().map(|number| 2 * number)
        );
    }
}

#[test]
fn standard_error_stays_empty_without_a_terminal() {
    assert_eq!(
        replay(&fixture("street_hdl32e.pcap.gz"), &["--speed", "realtime"]).stderr,
        ""
    );
    assert_eq!(inspect(&fixture("street_hdl32e.pcap.gz")).stderr, "");
}

#[test]
fn a_slip_is_answered_with_what_was_meant() {
    for (args, answer) in [
        (&["replay", "a.pcap", "--loop", "3"][..], "--loop=3"),
        (
            &["replay", "a.pcap", "--model", "vlp-32a"],
            "expected one of vlp16",
        ),
        (
            &["replay", "a.pcap", "--model", "vlp61"],
            "did you mean vlp16?",
        ),
        (&["replay", "a.pcap", "--to", "soon"], "IP:PORT such as"),
        (&["repaly", "a.pcap"], "'replay'"),
    ] {
        let ran = sweepd(args);
        assert!(
            ran.code == 2 && ran.stderr.contains(answer),
            "{args:?}: {}",
            ran.stderr
        );
    }
    assert_eq!(inspect(&fixture("street_vlp16_losses.pcap")).code, 0);
    replay(&fixture("street_vlp16_losses.pcap"), &["--model", "VLP-16"]).done();
}
