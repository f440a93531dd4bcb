//! `sweepd record`, over loopback: what is sent is in the files, or is counted. A loaded machine may drop datagrams;
//! the accounts must be right all the same.

use std::io::{BufRead, BufReader, Read};
use std::net::{Ipv4Addr, SocketAddr, UdpSocket};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStderr, Command, Stdio};
use std::time::{Duration, Instant};

use sweepd::capture::Capture;
use sweepd::wire::Datagram;

use crate::common::run::Run;
use crate::made::{self, Sent};
use crate::{Folder, Ran, command, sweepd};

/// A recording under way, on a port that the system chose.
struct Recorder {
    child: Child,
    stderr: BufReader<ChildStderr>,
    announced: String,
    to: SocketAddr,
}

impl Recorder {
    fn start(output: &Path, options: &[&str]) -> Self {
        let args = ["record", "-o", output.to_str().unwrap(), "--port", "0", "--bind", "127.0.0.1"];
        let mut command = command(&[&args, options].concat());
        let mut child = command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
        let mut stderr = BufReader::new(child.stderr.take().unwrap());
        let mut announced = String::new();
        // A machine with a small net.core.rmem_max is warned first.
        let to = loop {
            let mut line = String::new();
            assert!(stderr.read_line(&mut line).unwrap() > 0, "{announced}");
            announced += &line;
            let place = line.strip_prefix("recording ").and_then(|rest| rest.split(' ').next());
            if let Some(place) = place {
                break place.parse().unwrap();
            }
        };
        Self { child, stderr, announced, to }
    }

    fn signal(&self, name: &str) {
        let pid = self.child.id().to_string();
        assert!(Command::new("kill").args(["-s", name, &pid]).status().unwrap().success());
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

/// The number before a word of the summary.
#[track_caller]
fn number(ran: &Ran, word: &str) -> u64 {
    let before = ran.stdout.split(word).next().filter(|before| before.len() < ran.stdout.len());
    let before = before.unwrap_or_else(|| panic!("no {word} in {}", ran.stdout));
    before.split_whitespace().next_back().unwrap().replace(',', "").parse().unwrap()
}

/// Fails unless every datagram is in the files or counted as dropped, and says whether all are in the files.
#[track_caller]
fn is_whole(ran: &Ran, sent: usize) -> bool {
    assert_eq!(ran.code, 0, "{}", ran.stderr);
    let lost = number(ran, " by the kernel") + number(ran, " because the disk");
    let refused: u64 = [" wrong length", " wrong marker", " other source"].map(|word| number(ran, word)).iter().sum();
    assert_eq!(number(ran, " datagram") + lost + refused, sent as u64, "{}", ran.stdout);
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
        all.push((one.source, one.destination_port, one.arrival_ns, one.payload.to_vec()));
    }
    assert_eq!(capture.truncation(), None);
    all
}

fn read_payloads(path: &Path) -> Vec<Vec<u8>> {
    read(path).into_iter().map(|(.., payload)| payload).collect()
}

#[test]
fn what_was_recorded_replays_to_the_sweeps_of_what_was_sent() {
    let folder = Folder::new("record");
    for (name, output) in [("street_vlp16.pcap.gz", "plain.pcap"), ("street_hdl32e_dual.pcap.gz", "small.pcap.gz")] {
        let (sent, sensor, path) = (made::datagrams(name), sender(), folder.path(output));
        let recorder = Recorder::start(&path, &[]);
        let to = recorder.to;
        send(&sensor, to, payloads(&sent));
        if !is_whole(&recorder.stop(), sent.len()) {
            continue;
        }
        let recorded = read(&path);
        assert!(recorded.iter().all(|one| (one.0, one.1) == (sensor.local_addr().unwrap(), to.port())));
        assert!(recorded.is_sorted_by_key(|one| one.2), "stamps of the kernel, in order");
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
    let sent: Vec<_> = payloads(&made::vlp16()).into_iter().filter(|payload| payload.len() == 1206).take(100).collect();
    for payload in &sent {
        let to = recorder.to;
        send(&sensor, to, [payload]);
        send(&foreign, to, [&payload[..], &payload[..600], &[0x55; 1206], &[]]);
        std::thread::sleep(Duration::from_millis(1));
    }
    let ran = recorder.stop();
    if is_whole(&ran, 5 * sent.len()) {
        let refused = [" wrong length", " wrong marker", " other source"].map(|word| number(&ran, word));
        assert_eq!(refused, [200, 100, 100]);
        assert_eq!(number(&ran, " data packets"), 100);
        assert!(ran.stdout.contains(&own), "{}", ran.stdout);
        assert!(read_payloads(&path) == sent);
    }
}

/// The files of a rotation, in order.
fn rotated(folder: &Folder) -> Vec<PathBuf> {
    folder.files("").into_iter().map(|(name, _)| folder.path(&name)).collect()
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
    let expected = (0..files.len() + 1).filter(|&number| number != 1).map(|number| format!("drive-{number:03}.pcap"));
    assert!(files.iter().map(|file| file.file_name().unwrap().to_str().unwrap()).eq(expected));
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

#[test]
fn an_hdl64e_with_two_returns_is_recorded_in_real_time() {
    const PERIOD: Duration = Duration::from_nanos(172_800);
    let (folder, sensor) = (Folder::new("record-rate"), sender());
    let packets = payloads(&made::datagrams("street_hdl64e_s3_dual.pcap.gz"));
    let packets: Vec<_> = packets.into_iter().filter(|payload| payload.len() == 1206).collect();
    let recorder = Recorder::start(&folder.path("hdl64e.pcap"), &[]);
    let sent: Vec<_> = packets.iter().cycle().take(5787).collect();
    let begun = Instant::now();
    for (number, payload) in (0..).zip(&sent) {
        std::thread::sleep((PERIOD * number).saturating_sub(begun.elapsed()));
        sensor.send_to(payload, recorder.to).unwrap();
    }
    let ran = recorder.stop();
    if is_whole(&ran, sent.len()) {
        assert!(read_payloads(&folder.path("hdl64e.pcap")).iter().eq(sent));
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
    assert!(ran.stderr.contains("warning: nothing came to port"), "{}", ran.stderr);
    assert_eq!(read(&folder.path("time.pcap")), []);
}

#[test]
fn what_was_recorded_is_on_the_disk_before_the_end() {
    let (folder, sent) = (Folder::new("record-killed"), payloads(&made::vlp16()));
    let path = folder.path("killed.pcap.gz");
    let mut recorder = Recorder::start(&path, &[]);
    send(&sender(), recorder.to, &sent[..20]);
    // It syncs once a second; a slow machine is given some more.
    let readable = || {
        let mut capture = Capture::open(&path).ok()?;
        let mut count = 0;
        while capture.next_datagram().unwrap().is_some() {
            count += 1;
        }
        Some(count)
    };
    let found = (0..100).find_map(|_| {
        std::thread::sleep(Duration::from_millis(100));
        readable().filter(|&count| count > 0)
    });
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
    let ran = sweepd(&["record", "-o", path.to_str().unwrap(), "--bind", "127.0.0.1", "--port", &port]);
    ran.says(&[&format!("port {port} is taken"), "choose another port"]);
    assert!(!path.exists());
}

#[test]
fn files_that_cannot_be_written_are_one_error_with_the_cure() {
    let folder = Folder::new("record-unwritable");
    let mine = folder.write("mine.pcap", b"mine");
    let none = folder.path("none/x.pcap");
    for (path, parts) in [
        (&mine, ["mine.pcap", "overwrites nothing"]),
        (&none, ["none/x.pcap", "make its folder first"]),
        (&PathBuf::from("/proc/x.pcap"), ["/proc/x.pcap", "; "]),
        (&folder.path("x.txt"), ["x.txt", "ends in .pcap or .pcap.gz"]),
        (&PathBuf::from("-"), ["-", "ends in .pcap or .pcap.gz"]),
    ] {
        sweepd(&["record", "-o", path.to_str().unwrap(), "--port", "0", "--bind", "127.0.0.1"]).says(&parts);
    }
    assert_eq!(std::fs::read(mine).unwrap(), b"mine");
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
