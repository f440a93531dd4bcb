//! `--jobs`: side by side, and the output is the same.

use std::path::Path;

use crate::{Folder, fixture, made, replay};

/// Standard output of a replay, and its files by their names: each return, each segment.
fn outputs(capture: &Path, options: &[&str]) -> (String, Vec<(String, Vec<u8>)>) {
    let name = capture.file_name().unwrap().display();
    let folder = Folder::new(&format!("jobs-{name}"));
    let dir = folder.path("out");
    std::fs::create_dir(&dir).unwrap();
    let csv = dir.join("csv").display().to_string();
    let segments = dir.join("segments.jsonl").display().to_string();
    let files = ["--csv", &csv, "--segments", &segments];
    let lines = ["--json", "--no-timing", "--partial"];
    let stdout = replay(capture, &[options, &lines, &files].concat()).done();
    (stdout, folder.files("out"))
}

#[track_caller]
fn compare(capture: &Path, options: &[&str], sweeps: usize) {
    let with = |jobs| outputs(capture, &[options, &["--jobs", jobs]].concat());
    let expected = with("1");
    let lines = expected.0.lines().count();
    assert!(lines > sweeps, "{}: {lines} lines", capture.display());
    for jobs in ["2", "3"] {
        let found = with(jobs);
        assert_eq!(found.0, expected.0, "{}, {jobs} jobs", capture.display());
        assert!(found.1 == expected.1, "{}, {jobs} jobs", capture.display());
    }
}

#[test]
fn a_replay_with_several_jobs_gives_the_bytes_of_one() {
    let folder = Folder::new("jobs");
    let hdl32e = made::datagrams("street_hdl32e_dual.pcap.gz");
    // Two sensors; and one that takes the place of another, at the same address.
    let two = made::together(&[&made::vlp16(), &hdl32e]);
    let two = folder.write("two.pcap", made::pcap(&two));
    let mut exchanged = made::vlp16();
    let last_ns = exchanged.last().unwrap().arrival_ns;
    let mut second = made::with_ports(&hdl32e, "192.168.1.201:2368", 2368);
    let late_ns = last_ns + 1_000_000 - second[0].arrival_ns;
    second
        .iter_mut()
        .for_each(|sent| sent.arrival_ns += late_ns);
    exchanged.extend(second);
    let exchanged = folder.write("exchanged.pcap", made::pcap(&exchanged));
    let hdl64e = fixture("street_hdl64e_s3_dual.pcap.gz");
    let calibration = folder.write("beams.xml", sweepd_testkit::hdl64::calibration_yaml());
    let beams = ["--calibration", calibration.to_str().unwrap()];
    compare(&two, &[], 8);
    compare(&two, &["--height", "1.9", "--loop=2"], 16);
    compare(&exchanged, &[], 8);
    compare(&hdl64e, &beams, 2);
    compare(
        &fixture("street_vlp16_losses.pcap"),
        &["--method", "paper"],
        3,
    );
}

#[test]
#[cfg_attr(without_captures, ignore = "no captures")]
fn real_captures_with_several_jobs_give_the_bytes_of_one() {
    for name in ["hdl32e_veloview-monterey-a", "vlp16_timm-dual-a"] {
        let path = sweepd_testkit::data_dir().join(format!("pcap/{name}.pcap"));
        compare(&path, &[], 3);
    }
}

#[test]
fn a_number_of_jobs_that_cannot_be_meant_is_one_error() {
    let capture = fixture("street_vlp16.pcap.gz");
    for jobs in ["0", "257", "-1", "two", "1.5"] {
        replay(&capture, &[&format!("--jobs={jobs}")]).says(&["--jobs <N>", jobs]);
    }
}

/// Sweeps come out when they are whole, not when others are.
#[test]
fn a_reader_of_a_pipe_has_each_sweep_when_it_is_whole() {
    use std::io::{BufRead, BufReader, Write};
    use std::process::Stdio;
    let bytes = made::pcap(&made::vlp16());
    let mut child = crate::command(&["replay", "-", "--json", "--jobs", "3"])
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    let mut stdin = child.stdin.take().unwrap();
    let mut lines = BufReader::new(child.stdout.take().unwrap()).lines();
    // All but the last packets: the pipe stays open.
    stdin.write_all(&bytes[..bytes.len() - 5000]).unwrap();
    for sweep in 1..3 {
        let line = lines.next().unwrap().unwrap();
        assert!(line.contains(&format!("\"seq\":{sweep},")), "{line}");
    }
    drop(stdin);
    assert!(
        lines
            .map(Result::unwrap)
            .last()
            .unwrap()
            .contains("summary")
    );
    assert!(child.wait().unwrap().success());
}
