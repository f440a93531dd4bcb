//! `sweepd record`, over loopback: what is sent is in the files, or is counted. A loaded machine
//! may drop datagrams; the accounts must be right all the same.

use std::io::{BufRead, BufReader, Read};
use std::net::{Ipv4Addr, SocketAddr, UdpSocket};
use std::os::unix::fs::PermissionsExt;
use std::os::unix::net::UnixListener;
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStderr, Command, Stdio};
use std::time::{Duration, Instant, SystemTime};

use sweepd::input::{Capture, CaptureReader};
use sweepd::wire::Datagram;
use sweepd_testkit::PATIENCE;

use crate::made::{self, Sent};
use crate::{Folder, Ran, command, sweepd};
use sweepd_testkit::run::Run;

/// A recording under way, on a port that the system chose.
struct Recorder {
    child: Child,
    stderr: BufReader<ChildStderr>,
    announced: String,
    to: SocketAddr,
}

impl Recorder {
    fn start(output: &Path, options: &[&str]) -> Self {
        Self::of(
            output,
            &[&["--port", "0", "--bind", "127.0.0.1"], options].concat(),
        )
    }

    fn of(output: &Path, options: &[&str]) -> Self {
        let mut command = command(&[&["record", "-o", output.to_str().unwrap()], options].concat());
        let mut child = command
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        let mut stderr = BufReader::new(child.stderr.take().unwrap());
        let mut announced = String::new();
        // A machine with a small net.core.rmem_max is warned first.
        let place = loop {
            let mut line = String::new();
            assert!(stderr.read_line(&mut line).unwrap() > 0, "{announced}");
            announced += &line;
            if let Some(rest) = line.strip_prefix("recording ") {
                break rest.split(" to ").next().unwrap().to_owned();
            }
        };
        let to = place.parse().unwrap();
        Self {
            child,
            stderr,
            announced,
            to,
        }
    }

    fn signal(&self, name: &str) {
        signal(&self.child, name);
    }

    /// Waits for the end.
    fn wait(mut self) -> Ran {
        let mut stderr = self.announced;
        self.stderr.read_to_string(&mut stderr).unwrap();
        let mut output = self.child.wait_with_output().unwrap();
        output.stderr = stderr.into_bytes();
        Ran::of(output)
    }

    /// Ends it as systemd does.
    fn stop(self) -> Ran {
        self.signal("TERM");
        self.wait()
    }
}

fn signal(child: &Child, name: &str) {
    let pid = child.id().to_string();
    let kill = Command::new("kill").args(["-s", name, &pid]).status();
    assert!(kill.unwrap().success());
}

/// The number before a word of the summary.
#[track_caller]
fn number(ran: &Ran, word: &str) -> u64 {
    let before = ran
        .stdout
        .split(word)
        .next()
        .filter(|before| before.len() < ran.stdout.len());
    let before = before.unwrap_or_else(|| panic!("no {word} in {}", ran.stdout));
    before
        .split_whitespace()
        .next_back()
        .unwrap()
        .replace(',', "")
        .parse()
        .unwrap()
}

/// Fails unless every datagram is in the files or counted as dropped, and says whether all are in
/// the files.
#[track_caller]
fn is_whole(ran: &Ran, sent: usize) -> bool {
    assert_eq!(ran.code, 0, "{}", ran.stderr);
    let lost = number(ran, " by the kernel") + number(ran, " because the disk");
    let refused: u64 = [
        " wrong length",
        " wrong marker",
        " wrong azimuth",
        " other source",
    ]
    .map(|word| number(ran, word))
    .iter()
    .sum();
    assert_eq!(
        number(ran, " datagram") + lost + refused,
        sent as u64,
        "{}",
        ran.stdout
    );
    assert_eq!(lost > 0, ran.stderr.contains("warning: "), "{}", ran.stderr);
    if lost > 0 {
        eprintln!("this machine was too busy: {}", ran.stdout);
    }
    lost == 0
}

/// Sends as fast as a small receive buffer can be emptied.
fn send(socket: &UdpSocket, to: SocketAddr, payloads: impl IntoIterator<Item = impl AsRef<[u8]>>) {
    for (number, payload) in payloads.into_iter().enumerate() {
        socket.send_to(payload.as_ref(), to).unwrap();
        if number % 32 == 31 {
            std::thread::sleep(Duration::from_millis(1));
        }
    }
}

fn sender() -> UdpSocket {
    UdpSocket::bind("127.0.0.1:0").unwrap()
}

fn payloads(sent: &[Sent]) -> Vec<Vec<u8>> {
    sent.iter().map(|sent| sent.payload.clone()).collect()
}

/// Sources, ports, stamps and payloads of a capture that is whole.
fn read(path: &Path) -> Vec<(SocketAddr, u16, i64, Vec<u8>)> {
    let mut capture = Capture::open(path).unwrap();
    let mut all = Vec::new();
    while let Some(one) = capture.next_datagram().unwrap() {
        all.push((
            one.source,
            one.destination_port,
            one.arrival_ns,
            one.payload.to_vec(),
        ));
    }
    assert_eq!(capture.truncation(), None);
    all
}

/// The addresses that the datagrams of a recording were sent to.
fn destinations(path: &Path) -> Vec<Ipv4Addr> {
    let mut reader = CaptureReader::open(path).unwrap();
    let mut all = Vec::new();
    while let Some(record) = reader.next().unwrap() {
        let ip: [u8; 4] = record.bytes[30..34].try_into().unwrap();
        all.push(ip.into());
    }
    all
}

fn read_payloads(path: &Path) -> Vec<Vec<u8>> {
    read(path)
        .into_iter()
        .map(|(.., payload)| payload)
        .collect()
}

#[test]
fn what_was_recorded_replays_to_the_sweeps_of_what_was_sent() {
    let folder = Folder::new("record");
    for (name, output) in [
        ("street_vlp16.pcap.gz", "plain.pcap"),
        ("street_hdl32e_dual.pcap.gz", "small.pcap.gz"),
    ] {
        let (sent, sensor, path) = (made::datagrams(name), sender(), folder.path(output));
        let recorder = Recorder::start(&path, &[]);
        let to = recorder.to;
        send(&sensor, to, payloads(&sent));
        if !is_whole(&recorder.stop(), sent.len()) {
            continue;
        }
        let recorded = read(&path);
        assert!(
            recorded
                .iter()
                .all(|one| (one.0, one.1) == (sensor.local_addr().unwrap(), to.port()))
        );
        assert!(
            recorded.is_sorted_by_key(|one| one.2),
            "stamps of the kernel, in order"
        );
        let source = SocketAddr::from((Ipv4Addr::LOCALHOST, 2368));
        let datagram = |sent: &Sent| (sent.arrival_ns, sent.port, sent.payload.clone());
        let sent: Vec<_> = sent.iter().map(datagram).collect();
        let direct = Run::of_datagrams(sent.iter().map(|(arrival_ns, port, payload)| Datagram {
            arrival_ns: *arrival_ns,
            source,
            destination_port: *port,
            payload,
        }));
        let replayed = Run::of_capture(&path);
        let (direct, replayed) = (direct.views(), replayed.views());
        assert!(direct.len() >= 4);
        assert_eq!(direct.len(), replayed.len());
        for (direct, replayed) in direct.iter().zip(&replayed) {
            assert!(direct.range == replayed.range && direct.label == replayed.label);
            assert_eq!(direct.segments.len(), replayed.segments.len());
        }
    }
}

#[test]
fn others_on_the_port_change_nothing_but_a_counter() {
    let (folder, sensor, foreign) = (Folder::new("record-others"), sender(), sender());
    let path = folder.path("own.pcap");
    let own = sensor.local_addr().unwrap().to_string();
    let recorder = Recorder::start(&path, &["--sensor", &own]);
    let sent: Vec<_> = payloads(&made::vlp16())
        .into_iter()
        .filter(|payload| payload.len() == 1206)
        .take(100)
        .collect();
    for payload in &sent {
        let to = recorder.to;
        send(&sensor, to, [payload]);
        send(
            &foreign,
            to,
            [&payload[..], &payload[..600], &[0x55; 1206], &[]],
        );
        std::thread::sleep(Duration::from_millis(1));
    }
    let ran = recorder.stop();
    if is_whole(&ran, 5 * sent.len()) {
        let refused =
            [" wrong length", " wrong marker", " other source"].map(|word| number(&ran, word));
        assert_eq!(refused, [200, 100, 100]);
        assert_eq!(number(&ran, " data packets"), 100);
        assert!(ran.stdout.contains(&own), "{}", ran.stdout);
        assert!(read_payloads(&path) == sent);
    }
}

/// The files of a rotation, in order.
fn rotated(folder: &Folder) -> Vec<PathBuf> {
    folder
        .files("")
        .into_iter()
        .map(|(name, _)| folder.path(&name))
        .collect()
}

#[test]
fn rotation_by_size_loses_nothing_and_overwrites_nothing() {
    let (folder, sent) = (Folder::new("record-size"), payloads(&made::vlp16()));
    folder.write("drive-001.pcap", b"mine");
    let recorder = Recorder::start(&folder.path("drive.pcap"), &["--rotate-mb", "0.1"]);
    send(&sender(), recorder.to, &sent);
    let ran = recorder.stop();
    let files = rotated(&folder);
    assert_eq!(std::fs::read(files[1].as_path()).unwrap(), b"mine");
    let files: Vec<_> = [&files[..1], &files[2..]].concat();
    let expected = (0..files.len() + 1)
        .filter(|&number| number != 1)
        .map(|number| format!("drive-{number:03}.pcap"));
    assert!(
        files
            .iter()
            .map(|file| file.file_name().unwrap().to_str().unwrap())
            .eq(expected)
    );
    let bytes = |file: &PathBuf| file.metadata().unwrap().len();
    assert!(files.iter().all(|file| bytes(file) <= 100_000));
    assert_eq!(number(&ran, " bytes"), files.iter().map(bytes).sum::<u64>());
    if is_whole(&ran, sent.len()) {
        assert!(files.len() >= 4);
        assert!(files.iter().flat_map(|file| read_payloads(file)).eq(sent));
    }
}

#[test]
fn rotation_by_time_loses_nothing() {
    let (folder, sent) = (Folder::new("record-time"), payloads(&made::vlp16()));
    let recorder = Recorder::start(&folder.path("drive.pcap.gz"), &["--rotate-seconds", "0.1"]);
    let sensor = sender();
    for part in sent.chunks(sent.len().div_ceil(5)) {
        send(&sensor, recorder.to, part);
        std::thread::sleep(Duration::from_millis(150));
    }
    let ran = recorder.stop();
    if is_whole(&ran, sent.len()) {
        let files = rotated(&folder);
        assert!(files.len() >= 5);
        assert!(files.iter().flat_map(|file| read_payloads(file)).eq(sent));
    }
}

/// Two seconds of an HDL-64E S3 with two returns, 5787 packets a second.
fn hdl64e_dual() -> Vec<Vec<u8>> {
    let packets = payloads(&made::datagrams("street_hdl64e_s3_dual.pcap.gz"));
    let packets: Vec<_> = packets
        .into_iter()
        .filter(|payload| payload.len() == 1206)
        .collect();
    packets.iter().cycle().take(2 * 5787).cloned().collect()
}

/// Does something for each at the rate of that sensor.
fn paced<T>(all: &[T], mut each: impl FnMut(usize, &T)) {
    const PERIOD: Duration = Duration::from_nanos(172_800);
    let begun = Instant::now();
    for (number, one) in all.iter().enumerate() {
        std::thread::sleep((PERIOD * number as u32).saturating_sub(begun.elapsed()));
        each(number, one);
    }
}

/// Rotated several times a second, each time synced.
const FAST_ROTATION: [&str; 4] = ["--rotate-mb", "1", "--rotate-seconds", "0.5"];

#[test]
fn an_hdl64e_with_two_returns_is_recorded_whole_while_files_rotate() {
    let _alone = sweepd_testkit::alone();
    let (folder, sensor, sent) = (Folder::new("record-rate"), sender(), hdl64e_dual());
    let recorder = Recorder::start(&folder.path("hdl64e.pcap"), &FAST_ROTATION);
    let has_small_buffer = recorder.announced.contains("net.core.rmem_max");
    paced(&sent, |_, payload| {
        assert_eq!(sensor.send_to(payload, recorder.to).unwrap(), 1206)
    });
    let ran = recorder.stop();
    let files = rotated(&folder);
    // A buffer of a few packets overflows on a busy machine, which is then told.
    if is_whole(&ran, sent.len()) || !has_small_buffer {
        assert!(files.len() >= 14, "{}", files.len());
        assert!(files.iter().flat_map(|file| read_payloads(file)).eq(sent));
    }
}

#[test]
fn a_daemon_that_is_not_there_is_one_error_that_says_so() {
    let root = Folder::new("record-no-daemon");
    let path = root.path("x.pcap");
    sweepd(&[
        "record",
        "-o",
        path.to_str().unwrap(),
        "--from",
        "roof",
        "--root",
        root.0.path().to_str().unwrap(),
    ])
    .says(&[
        "no daemon listens at",
        "control.sock",
        "sweepd run",
        "--root",
    ]);
    assert!(!path.exists());
}

#[test]
#[cfg_attr(without_root, ignore = "not root, or no namespaces")]
fn the_daemon_of_another_user_is_one_error_that_names_both() {
    const NOBODY: u32 = 65_534;
    let root = Folder::new("record-user");
    let socket = root.path("control.sock");
    let _listener = UnixListener::bind(&socket).unwrap();
    std::fs::set_permissions(&socket, std::fs::Permissions::from_mode(0o600)).unwrap();
    let mut command = command(&[
        "record",
        "-o",
        "x.pcap",
        "--from",
        "roof",
        "--root",
        root.0.path().to_str().unwrap(),
    ]);
    let output = command.uid(NOBODY).output().unwrap();
    Ran::of(output).says(&["user root", "user nobody", "sudo -u root"]);
}

#[test]
fn stamps_are_of_the_kernel_in_nanoseconds_and_destinations_the_true_ones() {
    let now_ns = || SystemTime::UNIX_EPOCH.elapsed().unwrap().as_nanos() as i64;
    let (folder, sent) = (Folder::new("record-stamps"), payloads(&made::vlp16()));
    let path = folder.path("stamps.pcap");
    let recorder = Recorder::of(&path, &["--port", "0"]);
    let to = SocketAddr::from(([127, 0, 0, 77], recorder.to.port()));
    // While the recorder sleeps, the kernel does not.
    recorder.signal("STOP");
    let begun_ns = now_ns();
    send(&sender(), to, &sent[..100]);
    std::thread::sleep(Duration::from_millis(100));
    let ended_ns = now_ns();
    std::thread::sleep(Duration::from_millis(300));
    // What came before the end is recorded, although the end is heard of first.
    recorder.signal("TERM");
    recorder.signal("CONT");
    if is_whole(&recorder.wait(), 100) {
        let stamps: Vec<i64> = read(&path).into_iter().map(|one| one.2).collect();
        assert!(
            stamps
                .iter()
                .all(|stamp_ns| (begun_ns..=ended_ns).contains(stamp_ns))
        );
        assert!(
            stamps
                .iter()
                .filter(|&stamp_ns| stamp_ns % 1000 != 0)
                .count()
                > 50,
            "no microseconds"
        );
        assert!(
            destinations(&path)
                .into_iter()
                .all(|ip| ip == Ipv4Addr::new(127, 0, 0, 77))
        );
    }
}

#[test]
fn each_signal_ends_it_cleanly_and_so_does_the_time() {
    let (folder, sent) = (Folder::new("record-signals"), payloads(&made::vlp16()));
    for signal in ["TERM", "INT", "HUP"] {
        let path = folder.path(&format!("{signal}.pcap.gz"));
        let recorder = Recorder::start(&path, &[]);
        send(&sender(), recorder.to, &sent[..50]);
        recorder.signal(signal);
        let ran = recorder.wait();
        if is_whole(&ran, 50) {
            assert!(read_payloads(&path) == sent[..50]);
        }
    }
    let begun = Instant::now();
    let ran = Recorder::start(&folder.path("time.pcap"), &["--seconds", "0.3"]).wait();
    assert!(begun.elapsed() >= Duration::from_millis(300));
    assert_eq!(ran.code, 0);
    assert!(
        ran.stderr.contains("warning: nothing came from port"),
        "{}",
        ran.stderr
    );
    assert_eq!(read(&folder.path("time.pcap")), []);
}

#[test]
fn what_was_recorded_is_on_the_disk_before_the_end() {
    let (folder, sent) = (Folder::new("record-killed"), payloads(&made::vlp16()));
    let path = folder.path("killed.pcap.gz");
    let mut recorder = Recorder::start(&path, &[]);
    send(&sender(), recorder.to, &sent[..20]);
    // It syncs once a second.
    let readable = || {
        let mut capture = Capture::open(&path).ok()?;
        let mut count = 0;
        while capture.next_datagram().unwrap().is_some() {
            count += 1;
        }
        Some(count)
    };
    let (begun, mut found) = (Instant::now(), None);
    while found != Some(20) && begun.elapsed() < PATIENCE {
        std::thread::sleep(Duration::from_millis(100));
        found = readable();
    }
    recorder.child.kill().unwrap();
    recorder.child.wait().unwrap();
    assert_eq!(found, Some(20));
    assert_eq!(readable(), Some(20));
}

#[test]
fn a_port_that_is_taken_is_one_error_that_names_it() {
    let folder = Folder::new("record-taken");
    let taken = sender();
    let port = taken.local_addr().unwrap().port().to_string();
    let path = folder.path("x.pcap");
    let ran = sweepd(&[
        "record",
        "-o",
        path.to_str().unwrap(),
        "--bind",
        "127.0.0.1",
        "--port",
        &port,
    ]);
    let holder = format!("pid {}, user ", std::process::id());
    ran.says(&[
        &format!("port {port} is held by "),
        &holder,
        "choose another port",
    ]);
    assert!(!path.exists());
    // Of the daemon, or of another recording.
    let recorder = Recorder::start(&folder.path("first.pcap"), &[]);
    let port = recorder.to.port().to_string();
    let ran = sweepd(&["record", "-o", path.to_str().unwrap(), "--port", &port]);
    ran.says(&[
        &format!("port {port} is held by sweepd (pid {}", recorder.child.id()),
        "--from NAME",
    ]);
    recorder.stop();
}

#[test]
fn files_that_cannot_be_written_are_one_error_with_the_cure() {
    let folder = Folder::new("record-unwritable");
    let mine = folder.write("mine.pcap", b"mine");
    let none = folder.path("none/x.pcap");
    for (path, parts) in [
        (&mine, ["mine.pcap exists", "--force replaces it"]),
        (&none, ["none/x.pcap", "make its folder first"]),
        (&PathBuf::from("/proc/x.pcap"), ["/proc/x.pcap", "; "]),
        (
            &folder.path("x.txt"),
            ["x.txt", "ends in .pcap or .pcap.gz"],
        ),
        (&PathBuf::from("-"), ["-", "ends in .pcap or .pcap.gz"]),
    ] {
        sweepd(&[
            "record",
            "-o",
            path.to_str().unwrap(),
            "--port",
            "0",
            "--bind",
            "127.0.0.1",
        ])
        .says(&parts);
    }
    assert_eq!(std::fs::read(mine).unwrap(), b"mine");
}

/// The old one stays until the new one is whole, and for good where the recorder is killed.
#[test]
fn a_recording_is_replaced_only_with_force_and_when_the_new_one_is_whole() {
    let folder = Folder::new("record-force");
    let path = folder.write("drive.pcap", b"mine");
    let part = folder.path("drive.pcap.part");
    let payloads = payloads(&made::vlp16());
    for is_killed in [true, false] {
        let mut recorder = Recorder::start(&path, &["--force"]);
        send(&sender(), recorder.to, &payloads[..20]);
        if is_killed {
            let (begun, sent): (_, usize) =
                (Instant::now(), payloads[..20].iter().map(Vec::len).sum());
            while std::fs::metadata(&part).map_or(0, |part| part.len()) < sent as u64 {
                assert!(begun.elapsed() < PATIENCE, "nothing is on the disk");
                std::thread::sleep(Duration::from_millis(10));
            }
            recorder.child.kill().unwrap();
            recorder.child.wait().unwrap();
            assert_eq!(
                (std::fs::read(&path).unwrap(), read(&part).len()),
                (b"mine".to_vec(), 20)
            );
        } else {
            let ran = recorder.stop();
            assert!(
                ran.code == 0 && ran.stdout.starts_with(path.to_str().unwrap()),
                "{}",
                ran.stdout
            );
            assert_eq!(read(&path).len(), 20);
            assert!(
                !part.exists() && !ran.stdout.contains(".part"),
                "{}",
                ran.stdout
            );
        }
    }
    let rotated = sweepd(&[
        "record",
        "-o",
        path.to_str().unwrap(),
        "--force",
        "--rotate-mb",
        "1",
    ]);
    assert!(
        rotated.code == 2 && rotated.stderr.contains("--force"),
        "{}",
        rotated.stderr
    );
}

#[test]
fn a_pipe_that_no_program_reads_yet_is_waited_for_with_a_word() {
    let folder = Folder::new("record-pipe");
    let path = folder.path("pipe.pcap");
    let mkfifo = Command::new("mkfifo").arg(&path).status();
    assert!(mkfifo.unwrap().success());
    let options = ["--port", "0", "--bind", "127.0.0.1"];
    let waiting = || {
        let output = ["record", "-o", path.to_str().unwrap()];
        let mut child = command(&[&output[..], &options].concat())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        let mut stderr = BufReader::new(child.stderr.take().unwrap());
        let mut line = String::new();
        while !line.starts_with("note: waiting for a program that reads ") {
            line.clear();
            assert!(stderr.read_line(&mut line).unwrap() > 0);
        }
        (child, stderr)
    };
    let (mut child, mut stderr) = waiting();
    signal(&child, "INT");
    let mut rest = String::new();
    stderr.read_to_string(&mut rest).unwrap();
    assert!(rest.contains("no program reads it"), "{rest}");
    assert!(!child.wait().unwrap().success());
    let (mut child, mut stderr) = waiting();
    let mut reader = std::fs::File::open(&path).unwrap();
    let mut line = String::new();
    stderr.read_line(&mut line).unwrap();
    assert!(line.starts_with("recording "), "{line}");
    signal(&child, "INT");
    let mut bytes = Vec::new();
    reader.read_to_end(&mut bytes).unwrap();
    // The header of a capture without a record.
    assert_eq!(bytes.len(), 24);
    assert!(child.wait().unwrap().success());
}

#[test]
fn a_full_disk_ends_it_with_one_error() {
    let folder = Folder::new("record-full");
    let path = folder.path("full.pcap");
    std::os::unix::fs::symlink("/dev/full", &path).unwrap();
    let recorder = Recorder::start(&path, &[]);
    let sensor = sender();
    let sent = payloads(&made::vlp16());
    send(&sensor, recorder.to, &sent);
    // Ends by itself, well before a minute is over.
    let ran = recorder.wait();
    ran.says(&["full.pcap", "No space left on device", "free space there"]);
    // What the buffers held is not called recorded.
    assert_eq!(number(&ran, " datagram"), 0);
    assert!(number(&ran, " because the disk was too slow or failed") > 0);
}

/// Like every consumer it may begin before the daemon. What it has to write is given once.
#[test]
fn a_recording_of_sweeps_waits_for_the_daemon() {
    let folder = Folder::new("record-mcap");
    let (file, root) = (folder.path("roof.mcap"), folder.path("root"));
    let (file, root) = (file.to_str().unwrap(), root.to_str().unwrap());
    let args = ["record", "--from", "roof", "--mcap", file, "--root", root];
    let ran = sweepd(&[&args[..], &["--seconds", "3.5"]].concat());
    assert_eq!(ran.code, 0, "{}", ran.stderr);
    assert!(
        ran.stderr.contains("not shared: is the daemon running") && ran.stdout.contains("0 sweeps"),
        "{}",
        ran.stderr
    );
    sweepd(&args).says(&["roof.mcap exists; --force replaces it"]);
    for wrong in [
        &["record", "--mcap", file][..],
        &["record", "--from", "roof"],
        &[&args[..], &["-o", "x.pcap"]].concat(),
        &[&args[..], &["--sensor", "192.168.1.201"]].concat(),
    ] {
        assert_eq!(sweepd(wrong).code, 2, "{wrong:?}");
    }
    let text = folder.path("roof.pcap");
    let args = ["record", "--from", "roof", "--mcap", text.to_str().unwrap()];
    sweepd(&args).says(&["roof.pcap: expected a name that ends in .mcap"]);
}
