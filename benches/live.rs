//! The daemon at work, over loopback: latency by stage, load, and what it costs.
//!
//! ```text
//! cargo bench --bench live                       all of it, about ten minutes
//! cargo bench --bench live -- latency hdl64e     what has these words in its name
//! cargo bench --bench live -- objects            how late objects are, and what they cost
//! ```
//!
//! Each runs `sweepd run` and `sweepd watch` in processes of their own. The packets are simulated
//! beforehand, or those of a real capture where it is at hand, and sent in a loop, with the
//! sensor's clock and head going on, so that the sender costs little. After what the daemon costs
//! stands what the machine takes for less: to wake up three times a turn for nothing, and to take
//! the same packets from the kernel then, as the daemon does, and do nothing with them.

use std::net::{Ipv4Addr, UdpSocket};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use sweepd::client::{Client, Domain};
use sweepd::input::{Capture, UdpConfig, UdpSource};
use sweepd::sensor::model::Spec;
use sweepd::sensor::{Model, ModelExt};
use sweepd::wire::DataPacket;
use sweepd::wire::data::ReturnMode;
use sweepd_lab::simulate::{Emitter, EmitterConfig, fixtures};

/// Sweeps of each latency.
const SWEEPS: u32 = 1000;
/// Data packets for each position packet, of real sensors.
const FOR_EACH_POSITION: u64 = 5;

fn main() {
    let words: Vec<String> = std::env::args()
        .skip(1)
        .filter(|word| !word.starts_with("--"))
        .collect();
    let is_wanted = |name: &str| words.iter().all(|word| name.contains(word.as_str()));
    println!("{}", machine());
    for (name, model, mode) in [
        ("latency vlp16", Model::Vlp16, ReturnMode::Strongest),
        ("latency hdl32e", Model::Hdl32e, ReturnMode::Strongest),
        ("latency hdl64e", Model::Hdl64eS2, ReturnMode::Strongest),
    ] {
        if is_wanted(name) {
            latency(name, &Stream::new(model, mode, 1200.0), &[]);
        }
    }
    for (name, model) in [
        ("latency of objects vlp16", Model::Vlp16),
        ("latency of objects hdl64e", Model::Hdl64eS2),
    ] {
        if is_wanted(name) {
            let stream = Stream::new(model, ReturnMode::Strongest, 600.0);
            latency(name, &stream, &["--objects"]);
        }
    }
    for (name, model) in [
        ("cost of objects vlp16", Model::Vlp16),
        ("cost of objects hdl64e", Model::Hdl64eS2),
    ] {
        if is_wanted(name) {
            let stream = Stream::new(model, ReturnMode::Strongest, 600.0);
            let without = load(name, &stream, 1.0, 20, false);
            let with = load(name, &stream, 1.0, 20, true);
            println!(
                "  with a consumer of objects the daemon takes {:.2} times as much",
                with / without
            );
        }
    }
    for (name, source) in [
        ("cost vlp16", Source::Street(Model::Vlp16)),
        (
            "cost vlp16 einride",
            Source::Capture(Model::Vlp16, "vlp16_einride-a.pcap"),
        ),
        (
            "cost vlp16 mrpt",
            Source::Capture(Model::Vlp16, "vlp16_mrpt-gps.pcap"),
        ),
        (
            "cost vlp16 rlu",
            Source::Capture(Model::Vlp16, "vlp16_rlu-velodyne-example.pcap"),
        ),
        ("cost hdl64e", Source::Street(Model::Hdl64eS2)),
    ] {
        if is_wanted(name) {
            match source.stream() {
                Some(stream) => {
                    let share = load(name, &stream, 1.0, 20, false);
                    least(&stream, 10, share);
                }
                None => println!("\n== {name}: that capture is not at hand (see CONTRIBUTING.md)"),
            }
        }
    }
    let name = "load hdl64e dual, 4 times real time";
    if is_wanted(name) {
        load(
            name,
            &Stream::new(Model::Hdl64eS3, ReturnMode::Dual, 600.0),
            4.0,
            60,
            false,
        );
    }
}

/// The processor, its load, and the kernel.
fn machine() -> String {
    let read = |path| std::fs::read_to_string(path).unwrap_or_default();
    let cpu = read("/proc/cpuinfo");
    let cpu = cpu
        .lines()
        .find_map(|line| line.strip_prefix("model name"))
        .unwrap_or("unknown")
        .trim_start_matches([' ', '\t', ':']);
    let cores = std::thread::available_parallelism().map_or(0, usize::from);
    let load = read("/proc/loadavg");
    let load = load.split(' ').next().unwrap_or_default();
    format!(
        "{cpu}, {cores} cores, load {load} before, Linux {}",
        read("/proc/sys/kernel/osrelease").trim()
    )
}

/// Where packets are from whose cost is measured.
enum Source {
    /// A turn and a half of the simulated street.
    Street(Model),
    /// All data packets of a real capture of a sensor that turns ten times a second.
    Capture(Model, &'static str),
}

impl Source {
    fn stream(&self) -> Option<Stream> {
        match *self {
            Self::Street(model) => Some(Stream::new(model, ReturnMode::Strongest, 600.0)),
            Self::Capture(model, file) => Stream::captured(model, file),
        }
    }
}

/// Packets to be sent for ever: simulated ones, or those of a capture.
struct Stream {
    model: Model,
    mode: ReturnMode,
    packets: Vec<DataPacket>,
    /// What is sent after each fifth of them to another port, by a sensor that sends such.
    position: Option<Vec<u8>>,
    period_ns: u64,
    /// How far clock and head get until the packets begin again.
    us: u32,
    cdeg: f64,
}

impl Stream {
    fn new(model: Model, mode: ReturnMode, rpm: f64) -> Self {
        let scene = fixtures::scene();
        let config = EmitterConfig {
            rpm,
            data_per_position: FOR_EACH_POSITION,
            ..EmitterConfig::new(model, mode)
        };
        let config = config.turns(1.5);
        let spec: &Spec = config.spec;
        let period_ns = u64::from(spec.packet_period_ns(mode));
        let (mut packets, mut position): (Vec<DataPacket>, _) = (Vec::new(), None);
        for one in Emitter::new(config, &scene) {
            match DataPacket::parse(&one.payload) {
                Ok(packet) => packets.push(*packet),
                Err(_) => position = Some(one.payload),
            }
        }
        let us = (packets.len() as f64 * period_ns as f64 / 1000.0).round();
        let cdeg = us * 1e-6 * rpm / 60.0 * 36_000.0;
        Self {
            model,
            mode,
            packets,
            position,
            period_ns,
            us: us as u32,
            cdeg,
        }
    }

    /// The data packets of a capture, if it is there: those of a steady head, one after the other.
    /// Clock and head go on behind the last as they went before.
    fn captured(model: Model, file: &str) -> Option<Self> {
        let beside = || Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/data");
        let data = std::env::var_os("SWEEPD_DATA").map_or_else(beside, PathBuf::from);
        let path = Some(data.join("pcap").join(file)).filter(|path| path.exists())?;
        let mut capture = Capture::open(path).unwrap();
        let mut packets: Vec<DataPacket> = Vec::new();
        while let Some(datagram) = capture.next_datagram().unwrap() {
            packets.extend(DataPacket::parse(datagram.payload).ok().copied());
        }
        let mode = ReturnMode::Strongest;
        let period_ns = u64::from(model.spec().packet_period_ns(mode));
        let azimuths = packets
            .iter()
            .map(|packet| f64::from(packet.blocks[0].azimuth_cdeg()));
        let [first, last] = [&packets[0], &packets[packets.len() - 1]];
        let turned: f64 = azimuths
            .clone()
            .zip(azimuths.skip(1))
            .map(|(from, to)| (to - from).rem_euclid(36_000.0))
            .sum();
        let steps = (packets.len() - 1) as f64;
        let us = last.stamp_us() - first.stamp_us() + (period_ns as f64 / 1000.0).round() as u32;
        let position = Self::new(model, mode, 600.0).position;
        Some(Self {
            model,
            mode,
            position,
            period_ns,
            us,
            cdeg: turned * (1.0 + 1.0 / steps),
            packets,
        })
    }

    /// The packet of this number: stamps and azimuths go on where the first round of them ends.
    fn packet(&self, number: u64) -> DataPacket {
        let (round, index) = (
            number / self.packets.len() as u64,
            (number % self.packets.len() as u64) as usize,
        );
        let mut packet = self.packets[index];
        packet.set_stamp_us(
            ((u64::from(packet.stamp_us()) + round * u64::from(self.us)) % 3_600_000_000) as u32,
        );
        let turned = (round as f64 * self.cdeg).round() as u64;
        for block in &mut packet.blocks {
            block.set_azimuth_cdeg(((u64::from(block.azimuth_cdeg()) + turned) % 36_000) as u16);
        }
        packet
    }

    /// Sends them to a port, and position packets to the other, at this many times their own pace,
    /// until `over`; gives how many of the former.
    fn send(
        &self,
        [port, position_port]: [u16; 2],
        pace: f64,
        mut over: impl FnMut() -> bool,
    ) -> u64 {
        let socket = UdpSocket::bind((Ipv4Addr::LOCALHOST, 0)).unwrap();
        let (begun, mut number) = (Instant::now(), 0);
        while !over() {
            let due = (begun.elapsed().as_nanos() as f64 * pace / self.period_ns as f64) as u64;
            while number < due {
                socket
                    .send_to(self.packet(number).emit(), (Ipv4Addr::LOCALHOST, port))
                    .unwrap();
                number += 1;
                if let Some(position) = self
                    .position
                    .as_ref()
                    .filter(|_| number.is_multiple_of(FOR_EACH_POSITION))
                {
                    socket
                        .send_to(position, (Ipv4Addr::LOCALHOST, position_port))
                        .unwrap();
                }
            }
            thread::sleep(Duration::from_nanos(
                (self.period_ns as f64 / pace) as u64 / 2,
            ));
        }
        number
    }
}

/// The daemon in a folder of its own, ended with this.
struct Daemon {
    child: Child,
    folder: PathBuf,
    /// For data and for position packets.
    ports: [u16; 2],
    http: u16,
}

impl Daemon {
    fn start(model: Model) -> Self {
        let folder = std::env::temp_dir().join(format!("sweepd-live-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        let free = || {
            UdpSocket::bind("127.0.0.1:0")
                .unwrap()
                .local_addr()
                .unwrap()
                .port()
        };
        let (port, position_port, http) = (free(), free(), free());
        let calibration = match EmitterConfig::new(model, ReturnMode::Strongest).beams() {
            beams if model.is_hdl64e() => {
                std::fs::write(
                    folder.join("unit.yaml"),
                    sweepd::sensor::ros_yaml::emit(&beams),
                )
                .unwrap();
                "calibration = \"unit.yaml\"\n"
            }
            _ => "",
        };
        let config = format!(
            "http = \"127.0.0.1:{http}\"\nroot = \"{}\"\n\n[[sensor]]\nname = \"bench\"\naddress = \"127.0.0.1\"\n\
             port = {port}\nposition_port = {position_port}\nbind = \"127.0.0.1\"\n{calibration}",
            folder.join("iox2").display()
        );
        std::fs::write(folder.join("sweepd.toml"), config).unwrap();
        let child = Command::new(env!("CARGO_BIN_EXE_sweepd"))
            .args(["run", "--config"])
            .arg(folder.join("sweepd.toml"))
            .stderr(std::fs::File::create(folder.join("log")).unwrap())
            .spawn()
            .unwrap();
        Self {
            child,
            folder,
            ports: [port, position_port],
            http,
        }
    }

    fn domain(&self) -> Domain {
        Domain::at(self.folder.join("iox2"))
    }

    /// Processor time of its threads so far, seconds; none of them ends before it does.
    fn cpu_seconds(&self) -> f64 {
        let threads = std::fs::read_dir(format!("/proc/{}/task", self.child.id())).unwrap();
        threads
            .map(|thread| worked_ns(&thread.unwrap().path()))
            .sum::<f64>()
            * 1e-9
    }

    /// Resident memory, KiB.
    fn memory_kib(&self) -> u64 {
        let status = std::fs::read_to_string(format!("/proc/{}/status", self.child.id())).unwrap();
        let line = status
            .lines()
            .find_map(|line| line.strip_prefix("VmRSS:"))
            .unwrap();
        line.trim().trim_end_matches(" kB").parse().unwrap()
    }

    /// The metrics that have this in their name.
    fn metrics(&self, words: &[&str]) -> Vec<String> {
        use std::io::{Read, Write};
        let mut socket = std::net::TcpStream::connect((Ipv4Addr::LOCALHOST, self.http)).unwrap();
        socket
            .write_all(b"GET /metrics HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n")
            .unwrap();
        let mut text = String::new();
        socket.read_to_string(&mut text).unwrap();
        let is_wanted =
            |line: &&str| !line.starts_with('#') && words.iter().any(|word| line.contains(word));
        text.lines().filter(is_wanted).map(str::to_owned).collect()
    }
}

impl Drop for Daemon {
    fn drop(&mut self) {
        self.child.kill().unwrap();
        self.child.wait().unwrap();
        let prefix = self.domain().prefix();
        for entry in std::fs::read_dir("/dev/shm").unwrap().flatten() {
            if entry.file_name().to_string_lossy().starts_with(&prefix) {
                let _ = std::fs::remove_file(entry.path());
            }
        }
        let _ = std::fs::remove_dir_all(&self.folder);
    }
}

/// What `watch --latency` shows, with these options more.
fn latency(name: &str, stream: &Stream, options: &[&str]) {
    let rate_hz = stream.cdeg / 36_000.0 / (f64::from(stream.us) * 1e-6);
    println!(
        "\n== {name}: {} at {rate_hz:.0} Hz, {SWEEPS} sweeps",
        stream.model
    );
    let daemon = Daemon::start(stream.model);
    let root = daemon.folder.join("iox2");
    let mut watch = Command::new(env!("CARGO_BIN_EXE_sweepd"))
        .args([
            "watch",
            "bench",
            "--latency",
            "--timeout",
            "20",
            "--sweeps",
            &SWEEPS.to_string(),
            "--root",
        ])
        .arg(root)
        .args(options)
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    stream.send(daemon.ports, 1.0, || watch.try_wait().unwrap().is_some());
    let text = String::from_utf8(watch.wait_with_output().unwrap().stdout).unwrap();
    // The table of the seconds is for who watches.
    println!(
        "{}",
        text.find("\ndecode:")
            .or_else(|| text.find("\nshare:"))
            .map_or(&text[..], |at| &text[at..])
            .trim_end()
    );
}

/// Sends at a multiple of real time, to a consumer of sweeps and, if it is so, one of objects; what
/// the daemon took, percent of a core.
fn load(name: &str, stream: &Stream, pace: f64, seconds: u64, listens: bool) -> f64 {
    let rate = 1e9 / stream.period_ns as f64 * pace;
    let returns = if stream.mode == ReturnMode::Dual {
        "two returns"
    } else {
        "one return"
    };
    println!(
        "\n== {name}: {}, {returns}, {rate:.0} packets/s for {seconds} s",
        stream.model
    );
    let daemon = Daemon::start(stream.model);
    let mut client = Client::within(&daemon.domain(), "bench").unwrap();
    let mut objects = client.objects().unwrap();
    let listener = listens.then(|| {
        thread::spawn(move || {
            let mut messages = 0;
            while objects
                .next(Duration::from_secs(5))
                .unwrap()
                .received()
                .is_some()
            {
                messages += 1;
            }
            messages
        })
    });
    let consumer = thread::spawn(move || {
        let (mut sweeps, mut lost, mut dropped) = (0_u64, 0_u64, 0_u64);
        while let Some(sweep) = client.next(Duration::from_secs(5)).unwrap().received() {
            let header = *sweep.view().unwrap().header;
            sweeps += 1;
            lost += u64::from(header.lost_packets);
            dropped += u64::from(header.dropped_datagrams);
        }
        (sweeps, lost, dropped)
    });
    thread::sleep(Duration::from_secs(1));
    let (begun, mut marks, mut memory) = (Instant::now(), Vec::new(), Vec::new());
    let sent = stream.send(daemon.ports, pace, || {
        let elapsed = begun.elapsed().as_secs();
        // The first seconds are for the pool and the caches.
        if elapsed >= 3 && marks.is_empty() {
            marks.push((Instant::now(), daemon.cpu_seconds()));
        }
        if elapsed >= 3 + 5 * memory.len() as u64 {
            memory.push(daemon.memory_kib());
        }
        elapsed >= seconds
    });
    let (from, cpu) = marks[0];
    let share = (daemon.cpu_seconds() - cpu) / from.elapsed().as_secs_f64() * 100.0;
    thread::sleep(Duration::from_millis(300));
    for line in daemon.metrics(&["packets_total", "dropped", "lost", "rejected"]) {
        println!("  {line}");
    }
    let (sweeps, lost, dropped) = consumer.join().unwrap();
    if let Some(listener) = listener {
        println!("  {} messages with objects", listener.join().unwrap());
    }
    println!(
        "  {sent} packets sent; {sweeps} sweeps received, {lost} packets lost, {dropped} dropped"
    );
    println!("  {share:.2} % of a core; memory every 5 s, KiB: {memory:?}");
    share
}

/// What the machine takes for as many wake-ups and packets, without a daemon, and how much more the
/// daemon took.
fn least(stream: &Stream, seconds: u64, daemon: f64) {
    let receiver = UdpSource::bind(&UdpConfig {
        address: Ipv4Addr::LOCALHOST,
        ..UdpConfig::port(0)
    })
    .unwrap();
    let port = receiver.local_addr().port();
    let idlers = [None, Some(receiver)].map(Idler::start);
    let begun = Instant::now();
    stream.send([port; 2], 1.0, || begun.elapsed().as_secs() >= seconds);
    let [waking, receiving] = idlers.map(|idler| idler.end() * 100.0);
    println!(
        "  to wake up 30 times a second takes {waking:.2} %, and to take the packets then {receiving:.2} %"
    );
    println!(
        "  the daemon takes {:.1} times as much as that",
        daemon / receiving
    );
}

/// A thread that wakes up three times in a turn of 10 Hz, about as often as those of a daemon with
/// one sensor together.
struct Idler {
    over: Arc<AtomicBool>,
    thread: JoinHandle<f64>,
}

impl Idler {
    fn start(mut source: Option<UdpSource>) -> Self {
        let over = Arc::new(AtomicBool::new(false));
        let is_over = Arc::clone(&over);
        let thread = thread::spawn(move || {
            let this = Path::new("/proc/thread-self");
            let (begun, before_ns) = (Instant::now(), worked_ns(this));
            while !is_over.load(Ordering::Relaxed) {
                thread::sleep(Duration::from_micros(33_333));
                let Some(source) = &mut source else { continue };
                while source.receive_counted(Duration::ZERO).unwrap().count() > 0
                    && source.may_hold_more()
                {}
            }
            (worked_ns(this) - before_ns) / begun.elapsed().as_nanos() as f64
        });
        Self { over, thread }
    }

    /// The part of a core that it took.
    fn end(self) -> f64 {
        self.over.store(true, Ordering::Relaxed);
        self.thread.join().unwrap()
    }
}

/// For how long a thread has had a core, nanoseconds, by its folder in /proc.
fn worked_ns(thread: &Path) -> f64 {
    let stat = std::fs::read_to_string(thread.join("schedstat")).unwrap();
    stat.split(' ').next().unwrap().parse().unwrap()
}
