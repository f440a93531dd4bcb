//! What exists is replaced only with `--force`, whatever the command.

use std::path::Path;

use crate::{Folder, command, fixture, made, replay, sweepd};

/// Runs a command that writes `path`, where there is another file: refused without `--force`, whole
/// with it.
#[track_caller]
fn replaces_only_when_forced(args: &[&str], path: &Path) {
    std::fs::write(path, "mine").unwrap();
    let refused = sweepd(args);
    refused.says(&[&format!(
        "error: {} exists; --force replaces it",
        path.display()
    )]);
    assert_eq!((refused.code, &refused.stdout[..]), (1, ""));
    assert_eq!(std::fs::read(path).unwrap(), b"mine");
    let forced = sweepd(&[args, &["--force"]].concat());
    assert_eq!(forced.code, 0, "{}", forced.stderr);
    let written = std::fs::read(path).unwrap();
    assert!(written != b"mine" && !written.is_empty());
    assert!(!Path::new(&format!("{}.part", path.display())).exists());
    // The same on a free name.
    std::fs::remove_file(path).unwrap();
    assert_eq!(sweepd(args).code, 0);
    assert!(std::fs::read(path).unwrap() == written, "{args:?}");
    // A folder is never replaced.
    std::fs::remove_file(path).unwrap();
    std::fs::create_dir(path).unwrap();
    let refused = sweepd(&[args, &["--force"]].concat());
    let expected = format!(
        "error: cannot write {}: it is a folder; choose another name\n",
        path.display()
    );
    assert_eq!((refused.code, &refused.stderr[..]), (1, &expected[..]));
    std::fs::remove_dir(path).unwrap();
}

#[test]
fn a_file_that_exists_is_replaced_only_with_force() {
    let folder = Folder::new("existing-files");
    let [pcap, unit, jsonl, label] =
        ["made.pcap", "unit.yaml", "all.jsonl", "labels/cloud.label"].map(|name| folder.path(name));
    let [pcap_to, unit_to, jsonl_to] = [&pcap, &unit, &jsonl].map(|path| path.to_str().unwrap());
    let simulate = [
        "simulate",
        "--model=vlp16",
        "--scene=field",
        "--seconds=0.1",
        "--pcap",
    ];
    replaces_only_when_forced(&[&simulate[..], &[pcap_to]].concat(), &pcap);
    let hdl64e = fixture("street_hdl64e_s3.pcap.gz");
    replaces_only_when_forced(
        &[
            "calib",
            "from-capture",
            hdl64e.to_str().unwrap(),
            "-o",
            unit_to,
        ],
        &unit,
    );
    let losses = fixture("street_vlp16_losses.pcap");
    let losses = losses.to_str().unwrap();
    replaces_only_when_forced(
        &["replay", losses, "--no-timing", "--segments", jsonl_to],
        &jsonl,
    );
    replaces_only_when_forced(&["replay", losses, "--pcap", pcap_to], &pcap);
    let cloud = folder.write(
        "cloud.bin",
        [1.0_f32, 0.5, -0.2, 0.0]
            .map(f32::to_le_bytes)
            .concat()
            .repeat(40),
    );
    std::fs::create_dir(folder.path("labels")).unwrap();
    let out = label.parent().unwrap().to_str().unwrap();
    replaces_only_when_forced(
        &[
            "segment",
            cloud.to_str().unwrap(),
            "--model=vlp16",
            "--out",
            out,
        ],
        &label,
    );
}

/// The newcomer's command a second time, and a shorter run over a longer one: no sweep of the
/// former run is left among the new ones, in the folder of a further sensor neither, and nothing
/// else is touched.
#[test]
fn sweeps_of_a_former_run_are_refused_or_all_replaced() {
    let folder = Folder::new("former");
    let two = made::together(&[&made::vlp16(), &made::datagrams("street_hdl32e.pcap.gz")]);
    let two = folder.write("two.pcap", made::pcap(&two));
    let one = fixture("street_vlp16_losses.pcap");
    let out = folder.path("out");
    let to = out.to_str().unwrap();
    replay(&two, &["--partial", "--png", to, "--csv", to]).done();
    let before = folder.files("out");
    let sensor = |name: &str| name.split_once('/').map(|(folder, _)| folder.to_owned());
    assert!(before.iter().any(|(name, _)| sensor(name).is_some()));
    let second = replay(&one, &["--png", to]);
    second.says(&[&format!(
        "error: {to} holds 11 sweeps of a former run (sweep_000000.png, ...); --force replaces them, or name another folder"
    )]);
    assert_eq!((second.code, &second.stdout[..]), (1, ""));
    assert!(folder.files("out") == before);
    // What has not exactly such a name is another's.
    let kept = [
        "sweep_000000.png.part2",
        "sweep_1.png",
        "my.png",
        "keep/sweep_000009.png",
        "sweep_000001.pcd",
    ];
    std::fs::create_dir(out.join("keep")).unwrap();
    kept.iter()
        .for_each(|name| std::fs::write(out.join(name), "mine").unwrap());
    // A run that cannot begin takes nothing away.
    replay(&folder.path("none.pcap"), &["--png", to, "--force"]).says(&["none.pcap"]);
    assert_eq!(folder.files("out").len(), before.len() + kept.len());
    replay(&one, &["--png", to, "--force"]).done();
    let names: Vec<String> = folder
        .files("out")
        .into_iter()
        .map(|(name, _)| name)
        .collect();
    let mut expected: Vec<String> = before
        .iter()
        .map(|(name, _)| name.clone())
        .filter(|name| name.ends_with(".csv"))
        .collect();
    expected.extend(kept.map(str::to_owned));
    expected.extend((1..4).map(|number| format!("sweep_{number:06}.png")));
    expected.sort();
    assert_eq!(names, expected);
    // Another format in the same folder is no former run of this one.
    std::fs::remove_file(out.join("sweep_000001.pcd")).unwrap();
    replay(&one, &["--pcd", to]).done();
}

#[test]
fn the_truth_of_a_former_run_is_refused_or_all_replaced() {
    let folder = Folder::new("former-truth");
    let [pcap, truth] = ["made.pcap", "truth"].map(|name| folder.path(name));
    let to = [
        "--pcap",
        pcap.to_str().unwrap(),
        "--truth",
        truth.to_str().unwrap(),
    ];
    let fixed = [
        "simulate",
        "--scene=field",
        "--seconds=0.05",
        "--model=vlp16",
    ];
    assert_eq!(
        sweepd(&[&fixed[..], &to, &["--model=hdl32e"]].concat()).code,
        0
    );
    std::fs::remove_file(&pcap).unwrap();
    let again = sweepd(&[&fixed[..], &to].concat());
    again.says(&[&format!(
        "{} holds 3 files of a former run (objects.csv, ...); --force",
        truth.display()
    )]);
    assert!(!pcap.exists(), "nothing was begun");
    assert_eq!(sweepd(&[&fixed[..], &to, &["--force"]].concat()).code, 0);
    let names: Vec<String> = folder
        .files("truth")
        .into_iter()
        .map(|(name, _)| name)
        .collect();
    assert_eq!(names, ["objects.csv", "truth.csv"]);
}

#[test]
fn pipes_and_devices_are_written_to_and_a_failed_run_leaves_the_old_file() {
    let folder = Folder::new("existing-special");
    let losses = fixture("street_vlp16_losses.pcap");
    let hdl64e = fixture("street_hdl64e_s3.pcap.gz");
    for device in ["/dev/null", "/dev/stdout"] {
        let ran = sweepd(&[
            "calib",
            "from-capture",
            hdl64e.to_str().unwrap(),
            "-o",
            device,
        ]);
        assert_eq!((ran.code, &ran.stderr[..]), (0, ""), "{device}");
        assert_eq!(
            ran.stdout.contains("vert_correction"),
            device == "/dev/stdout"
        );
    }
    // The shell has made this file for it.
    let path = folder.path("stdout.yaml");
    let mut command = command(&[
        "calib",
        "from-capture",
        hdl64e.to_str().unwrap(),
        "-o",
        "/dev/stdout",
    ]);
    let status = command
        .stdout(std::fs::File::create(&path).unwrap())
        .status()
        .unwrap();
    assert!(status.success() && std::fs::read(&path).unwrap().len() > 1000);
    let fifo = folder.path("fifo.jsonl");
    assert!(
        std::process::Command::new("mkfifo")
            .arg(&fifo)
            .status()
            .unwrap()
            .success()
    );
    let reader = {
        let fifo = fifo.clone();
        std::thread::spawn(move || std::fs::read_to_string(fifo).unwrap())
    };
    replay(&losses, &["--segments", fifo.to_str().unwrap()]).done();
    assert!(reader.join().unwrap().lines().count() > 10);

    let old = folder.write("old.pcap", "mine");
    let wrong = [
        "simulate",
        "--model=vlp16",
        "--seconds=0.1",
        "--force",
        "--pcap",
        old.to_str().unwrap(),
    ];
    sweepd(&[&wrong[..], &["--truth", "/proc/none"]].concat()).says(&["/proc/none"]);
    assert_eq!(std::fs::read(&old).unwrap(), b"mine");
    assert!(!folder.path("old.pcap.part").exists());
}

#[test]
fn a_bag_is_replaced_only_with_force() {
    let folder = Folder::new("existing-bag");
    let capture = fixture("street_vlp16_losses.pcap");
    let bag = folder.path("deep/drive");
    let bag = ["--bag", bag.to_str().unwrap()];
    let short = replay(&capture, &[&bag[..], &["--layout=xyz"]].concat());
    short.says(&["--layout <LAYOUT>"]);
    replay(&capture, &["--organized"]).says(&["arguments were not provided"]);
    let both = replay(&capture, &[&bag[..], &["--name=a", "--name=a"]].concat());
    both.says(&["--name a is given twice"]);
    assert!(!folder.path("deep").exists());
    let more = replay(
        &capture,
        &[
            "--bag",
            folder.path("x").to_str().unwrap(),
            "--name=a",
            "--name=b",
        ],
    );
    more.says(&["no sensor in it for --name b"]);
    replay(&capture, &bag).done();
    let written = folder.files("deep");
    let names: Vec<&str> = written.iter().map(|(name, _)| &name[..]).collect();
    assert_eq!(names, ["drive/drive_0.mcap", "drive/metadata.yaml"]);
    replay(&capture, &bag).says(&["drive/metadata.yaml exists; --force replaces it"]);
    replay(&capture, &[&bag[..], &["--force"]].concat()).done();
    assert!(folder.files("deep") == written);
}
