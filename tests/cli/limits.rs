//! What could stop the program, or take all of the machine: files that block, signals at the wrong
//! moment, limits of the process, captures that promise much, names that hide something.

use std::io::{Read, Write};
use std::net::SocketAddrV4;
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use sweepd::input::PcapWriter;
use sweepd::input::write::Addressed;
use sweepd::sensor::Model;
use sweepd::wire::data::ReturnMode;
use sweepd_lab::simulate::{Emitter, EmitterConfig, street};

use sweepd_testkit::{
    bags::mcap,
    command::*,
    setup::{Process, SOON, Setup},
};

#[test]
fn a_pipe_in_place_of_a_file_is_refused_and_not_waited_for() {
    let folder = Folder::new("pipe");
    let pipe = folder.path("pipe");
    assert!(
        Command::new("mkfifo")
            .arg(&pipe)
            .status()
            .unwrap()
            .success()
    );
    for key in ["calibration", "segment.mask"] {
        let text =
            format!("[[sensor]]\nname = \"roof\"\naddress = \"10.0.0.1\"\n{key} = \"pipe\"\n");
        let config = folder.write("sweepd.toml", text);
        for command in [&["config", "check"][..], &["run", "--config"]] {
            let ran = sweepd(&[command, &[config.to_str().unwrap()]].concat());
            assert!(
                ran.code == 78 && ran.stderr.contains("it is a pipe"),
                "{}",
                ran.stderr
            );
        }
    }
    let pipe = pipe.to_str().unwrap();
    sweepd(&["config", "check", pipe]).says(&["cannot read the configuration", "it is a pipe"]);
    replay(&fixture("street_vlp16.pcap.gz"), &["--calibration", pipe]).says(&["it is a pipe"]);
}

/// The first line of its log waits for room in a pipe that is full.
#[test]
fn a_reload_that_is_asked_for_at_the_start_is_done_then() {
    let setup = Setup::new("", "");
    let (mut log, mut full) = std::io::pipe().unwrap();
    full.write_all(&[b'\n'; 1 << 16]).unwrap();
    let mut command = sweepd_testkit::sweepd(&setup.daemon_args());
    command
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(full);
    let mut daemon = Process(command.spawn().unwrap());
    // The parent's end of the pipe is in the command.
    drop(command);
    let begun = Instant::now();
    while !handles_hangup(daemon.0.id()) {
        assert!(begun.elapsed() < SOON, "it does not handle SIGHUP");
        std::thread::sleep(Duration::from_millis(5));
    }
    daemon.signal("-HUP");
    assert_eq!(daemon.ends_within(Duration::from_millis(200)), None);
    let (mut text, mut bytes) = (String::new(), [0; 4096]);
    while !text.contains("the configuration was read") {
        let len = log.read(&mut bytes).unwrap();
        assert!(len > 0 && begun.elapsed() < SOON, "{text}");
        text += &String::from_utf8_lossy(&bytes[..len]);
    }
    daemon.ends_when_told().unwrap();
}

fn handles_hangup(pid: u32) -> bool {
    let status = std::fs::read_to_string(format!("/proc/{pid}/status")).unwrap_or_default();
    let caught = status.lines().find_map(|line| line.strip_prefix("SigCgt:"));
    caught.is_some_and(|mask| u64::from_str_radix(mask.trim(), 16).unwrap() & 1 != 0)
}

#[test]
fn a_limit_of_the_process_is_named_with_what_is_needed() {
    for (limit, says) in [
        (
            "ulimit -n 24",
            [
                "this process may open 24 files and",
                "each sensor takes 40: raise the limit (ulimit -n",
            ],
        ),
        (
            "ulimit -v 150000",
            ["this process may have 146 MiB of addresses", "ulimit -v"],
        ),
    ] {
        let setup = Setup::new("model = \"hdl64e-s3\"\nreturns = \"dual\"", "");
        let program = sweepd_testkit::sweepd(&setup.daemon_args());
        let script = format!("{limit}; exec \"$@\"");
        let mut command = Command::new("sh");
        command
            .args(["-c", &script, "sh"])
            .arg(program.get_program())
            .args(program.get_args());
        let mut daemon = Process::spawn(command, &setup.path("daemon.log"));
        let ended = daemon.ends_within(SOON);
        let log = setup.log();
        let last = log.lines().last().unwrap_or_default();
        assert!(
            ended.is_some_and(|status| status.code() == Some(1)),
            "{limit}: {log}"
        );
        assert!(last.starts_with("error: roof: "), "{limit}: {log}");
        assert!(
            says.iter().all(|text| last.contains(text)),
            "{limit}: {log}"
        );
    }
}

#[test]
fn what_a_name_hides_is_shown() {
    let says = &["scan\\u{202e}pacp.\\n.exe"];
    let name = "scan\u{202e}pacp.\n.exe";
    for args in [
        &["replay", name][..],
        &["inspect", name],
        &["config", "check", name],
        &["calib", "show", name],
    ] {
        let ran = sweepd(args);
        assert_ne!(ran.code, 0);
        assert!(!ran.stderr.contains('\u{202e}'), "{args:?}: {}", ran.stderr);
    }
    replay(Path::new(name), &[]).says(says);
}

/// The most memory that a run with these arguments had until shortly before its end, MiB.
fn peak_mib(args: &[&str]) -> u64 {
    let mut child = command(args)
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    let path = format!("/proc/{}/status", child.id());
    let mut peak_kib = 0;
    while child.try_wait().unwrap().is_none() {
        let status = std::fs::read_to_string(&path).unwrap_or_default();
        let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"));
        if let Some(kib) = line.and_then(|line| line.split_whitespace().next()) {
            peak_kib = kib.parse().unwrap();
        }
        std::thread::sleep(Duration::from_millis(1));
    }
    peak_kib / 1024
}

/// 64 sensors that send 20 packets each, 1.6 MB. What there is memory for, but not in use, is free.
#[test]
fn many_sensors_with_few_packets_take_little_memory() {
    let config = EmitterConfig::new(Model::Vls128, ReturnMode::Dual).turns(0.02);
    let scene = street(1);
    let sent = Emitter::new(config, &scene).untold();
    let mut capture = PcapWriter::new(Vec::new()).unwrap();
    for packet in sent.filter(|sent| sent.payload.len() == 1206).take(20) {
        for host in 1..=64 {
            let packet = Addressed {
                arrival_ns: packet.arrival_ns,
                source: SocketAddrV4::new([10, 0, 0, host].into(), 2368),
                destination: packet.destination,
                payload: &packet.payload,
            };
            capture.write(&packet).unwrap();
        }
    }
    let folder = Folder::new("many");
    let path = folder.write("many.pcap", capture.finish().unwrap());
    let path = path.to_str().unwrap();
    for args in [
        &["inspect", path][..],
        &["replay", path],
        &["replay", path, "--partial"],
    ] {
        let peak = peak_mib(args);
        assert!(peak < 150, "{args:?}: {peak} MiB");
    }
}

#[test]
fn a_small_bag_of_many_types_takes_little_memory() {
    let name = "a".repeat(4000);
    let mut schemas: Vec<u8> = (0..=u16::MAX)
        .flat_map(|id| mcap::schema(id, &name))
        .collect();
    schemas.extend(mcap::channel(1, 1, "/points", "cdr"));
    let folder = Folder::new("types");
    let bag = folder.write("types.mcap", mcap::file(&[mcap::chunk("lz4", &schemas)]));
    let peak = peak_mib(&["inspect", bag.to_str().unwrap()]);
    assert!(peak < 100, "{peak} MiB");
}
