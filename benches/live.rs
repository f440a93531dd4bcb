//! The daemon at work, over loopback: what it costs, as a ratio to a bare receiver of the same packets
//! in the same run, latency by stage, and load.
//!
//! ```text
//! cargo bench --bench live                       all of it, about fourteen minutes
//! cargo bench --bench live -- latency hdl64e     what has these words in its name
//! SWEEPD_BENCH_OTHER=/path/to/sweepd cargo bench --bench live -- paired
//!                                                against another program, and against itself (A/A)
//! ```
//!
//! `sweepd run` and `sweepd watch` run in processes of their own. The packets are simulated
//! beforehand, or those of a real capture where it is at hand, and sent in a loop, with the
//! sensor's clock and head going on, so that the sender costs little. The bare receiver takes them
//! from the kernel thirty times a second, and does nothing with them.
//!
//! All run at real-time priority where the machine allows it, so that other work only takes caches.
//! A core that sleeps between packets takes longer to wake up, and runs at a lower clock; so the
//! ratio is given with both cores kept busy by other work, too.

use std::net::{Ipv4Addr, UdpSocket};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, mpsc};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use sweepd::client::{Client, Domain, Objects};
use sweepd::host::realtime_ns;
use sweepd::input::{Capture, UdpConfig, UdpSource};
use sweepd::sensor::model::Spec;
use sweepd::sensor::{Model, ModelExt};
use sweepd::sweep::objects::why;
use sweepd::wire::DataPacket;
use sweepd::wire::data::ReturnMode;
use sweepd_lab::simulate::{Emitter, EmitterConfig, fixtures};

/// Sweeps of each latency.
const SWEEPS: u32 = 1000;
/// Data packets for each position packet, of real sensors.
const FOR_EACH_POSITION: u64 = 5;
/// The first seconds are for the pool, the caches and the height of the sensor.
const BEFORE: Duration = Duration::from_secs(3);
/// How long a consumer waits before it looks whether the run is over.
const WAIT: Duration = Duration::from_millis(500);
/// Runs of each program of a pair.
const ALTERNATIONS: usize = 7;
/// The program that is measured.
const THIS: &str = env!("CARGO_BIN_EXE_sweepd");

fn main() {
    let words: Vec<String> = std::env::args()
        .skip(1)
        .filter(|word| !word.starts_with("--"))
        .collect();
    let is_wanted = |name: &str| words.iter().all(|word| name.contains(word.as_str()));
    println!("{}, {}", machine(), real_time());
    let (vlp16, hdl64e) = (Model::Vlp16, Model::Hdl64eS2);
    for (name, model, capture) in [
        ("cost vlp16", vlp16, ""),
        ("cost vlp16 einride", vlp16, "vlp16_einride-a.pcap"),
        ("cost vlp16 mrpt", vlp16, "vlp16_mrpt-gps.pcap"),
        ("cost vlp16 rlu", vlp16, "vlp16_rlu-velodyne-example.pcap"),
        ("cost hdl64e", hdl64e, ""),
    ] {
        if is_wanted(name) {
            let stream = match capture {
                "" => Some(Stream::new(model, ReturnMode::Strongest, 600.0)),
                file => Stream::captured(model, file),
            };
            match stream {
                Some(stream) => cost(name, &stream),
                None => println!("\n== {name}: that capture is not at hand (see CONTRIBUTING.md)"),
            }
        }
    }
    for (name, model, rpm, options) in [
        ("latency vlp16", vlp16, 1200.0, ""),
        ("latency hdl32e", Model::Hdl32e, 1200.0, ""),
        ("latency hdl64e", hdl64e, 1200.0, ""),
        ("latency of objects vlp16", vlp16, 600.0, " --objects"),
        ("latency of objects hdl64e", hdl64e, 600.0, " --objects"),
    ] {
        if is_wanted(name) {
            let stream = Stream::new(model, ReturnMode::Strongest, rpm);
            latency(name, &stream, options);
        }
    }
    let name = "load hdl64e dual, 4 times real time";
    if is_wanted(name) {
        println!("\n== {name}");
        let stream = Stream::new(Model::Hdl64eS3, ReturnMode::Dual, 600.0);
        load(THIS.as_ref(), &stream, 4.0, 60, false).print();
    }
    if let Some(other) = std::env::var_os("SWEEPD_BENCH_OTHER") {
        for (name, model) in [("paired vlp16", vlp16), ("paired hdl64e", hdl64e)] {
            if is_wanted(name) {
                let stream = Stream::new(model, ReturnMode::Strongest, 600.0);
                paired(name, &stream, other.as_ref());
            }
        }
    }
}

/// Gives this process, and those that it starts, real-time priority; how that went.
fn real_time() -> &'static str {
    let mut chrt = Command::new("chrt");
    chrt.args(["--fifo", "--pid", "20", &std::process::id().to_string()]);
    match chrt.stderr(Stdio::null()).status() {
        Ok(status) if status.success() => "at real-time priority",
        _ => "without real-time priority: `chrt` is not allowed to give it",
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

/// Packets to be sent for ever: simulated ones, or those of a capture.
struct Stream {
    model: Model,
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

    /// Sends them to pairs of ports, for data and position packets, at this many times their own
    /// pace, until `over`; gives how many data packets.
    fn send(&self, to: &[[u16; 2]], pace: f64, mut over: impl FnMut() -> bool) -> u64 {
        let socket = UdpSocket::bind((Ipv4Addr::LOCALHOST, 0)).unwrap();
        let send = |bytes: &[u8], port| socket.send_to(bytes, (Ipv4Addr::LOCALHOST, port)).unwrap();
        let (begun, mut number) = (Instant::now(), 0);
        while !over() {
            number += 1;
            let due = Duration::from_nanos(number * self.period_ns).div_f64(pace);
            thread::sleep(due.saturating_sub(begun.elapsed()));
            let packet = self.packet(number);
            let position = self
                .position
                .as_ref()
                .filter(|_| number.is_multiple_of(FOR_EACH_POSITION));
            for [port, position_port] in to {
                send(packet.emit(), *port);
                if let Some(position) = position {
                    send(position, *position_port);
                }
            }
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
    fn start(program: &Path, model: Model) -> Self {
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
        let child = Command::new(program)
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

    /// Processor time of its threads so far, nanoseconds; none of them ends before it does.
    fn worked_ns(&self) -> f64 {
        let threads = std::fs::read_dir(format!("/proc/{}/task", self.child.id())).unwrap();
        threads
            .map(|thread| worked_ns(&thread.unwrap().path()))
            .sum()
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
fn latency(name: &str, stream: &Stream, options: &str) {
    let rate_hz = stream.cdeg / 36_000.0 / (f64::from(stream.us) * 1e-6);
    println!(
        "\n== {name}: {} at {rate_hz:.0} Hz, {SWEEPS} sweeps",
        stream.model
    );
    let daemon = Daemon::start(THIS.as_ref(), stream.model);
    let watch = format!("watch bench --latency --timeout 20 --sweeps {SWEEPS}{options} --root");
    let mut watch = Command::new(THIS)
        .args(watch.split(' '))
        .arg(daemon.folder.join("iox2"))
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    stream.send(&[daemon.ports], 1.0, || watch.try_wait().unwrap().is_some());
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

/// What the daemon costs, without and with a consumer of objects, on busy cores and on those of the
/// machine as it is.
fn cost(name: &str, stream: &Stream) {
    println!("\n== {name}: {}", stream.model);
    for listens in [false, true] {
        for is_busy in [true, false] {
            let _work = is_busy.then(OtherWork::start);
            println!(
                " with {}, {}:",
                if listens { "objects" } else { "sweeps alone" },
                if is_busy {
                    "busy cores"
                } else {
                    "the machine as it is"
                },
            );
            load(THIS.as_ref(), stream, 1.0, 20, listens).print();
        }
    }
}

/// What two programs cost, in turn, with the same packets, and what this one costs twice.
fn paired(name: &str, stream: &Stream, other: &Path) {
    println!("\n== {name}: this program / {}", other.display());
    let _work = OtherWork::start();
    for listens in [false, true] {
        let mut runs: [Vec<Load>; 3] = Default::default();
        for turn in 0..ALTERNATIONS {
            for place in 0..3 {
                // Forwards and backwards, since what comes later may meet another machine.
                let program = if turn % 2 == 0 { place } else { 2 - place };
                let path = if program == 0 { other } else { THIS.as_ref() };
                runs[program].push(load(path, stream, 1.0, 7, listens));
            }
        }
        println!(
            " with {}:",
            if listens { "objects" } else { "sweeps alone" }
        );
        let [other, this, again] = &runs;
        for (what, from, to) in [("this / other", other, this), ("A/A", this, again)] {
            let ratios = from
                .iter()
                .zip(to)
                .map(|(from, to)| to.daemon / from.daemon);
            let ratios = sorted(ratios);
            let [least, most] = [ratios[0], ratios[ratios.len() - 1]];
            println!(
                "  {what}: {:.3} ({least:.3} to {most:.3})",
                at(&ratios, 0.5)
            );
        }
        for (what, runs) in [("other", other), ("this", this), ("this again", again)] {
            let ratio = sorted(runs.iter().map(|run| run.daemon / run.receiver));
            let share = sorted(runs.iter().map(|run| run.daemon));
            let delays = sorted(runs.iter().flat_map(|run| run.delays_ms.iter().copied()));
            println!(
                "  {what}: {:.2} times the bare receiver, {:.2} % of a core",
                at(&ratio, 0.5),
                at(&share, 0.5)
            );
            print_delays(&delays);
        }
    }
}

/// Delays of objects, milliseconds, if there are any.
fn print_delays(sorted: &[f64]) {
    if !sorted.is_empty() {
        let [half, most] = [0.5, 0.99].map(|part| at(sorted, part));
        println!("  objects after their last return: p50 {half:.2}, p99 {most:.2} ms");
    }
}

fn sorted(values: impl Iterator<Item = f64>) -> Vec<f64> {
    let mut values: Vec<f64> = values.collect();
    values.sort_by(f64::total_cmp);
    values
}

/// The value below which this part of them is.
fn at(sorted: &[f64], part: f64) -> f64 {
    let last = sorted.len().saturating_sub(1);
    sorted
        .get((last as f64 * part).round() as usize)
        .copied()
        .unwrap_or(f64::NAN)
}

/// Other work on each core, which gives way to everything else; ended with this.
struct OtherWork(Vec<Child>);

impl OtherWork {
    fn start() -> Self {
        let cores = thread::available_parallelism().map_or(0, usize::from);
        let mut chrt = Command::new("chrt");
        chrt.args(["--idle", "0", "sh", "-c", "while :; do :; done"]);
        let mut work = Self(Vec::new());
        for _ in 0..cores {
            work.0.push(chrt.spawn().expect("chrt, of util-linux"));
        }
        work
    }
}

impl Drop for OtherWork {
    fn drop(&mut self) {
        for child in &mut self.0 {
            child.kill().unwrap();
            child.wait().unwrap();
        }
    }
}

/// What a run took.
struct Load {
    /// Percent of a core that the daemon took.
    daemon: f64,
    /// The same of the bare receiver.
    receiver: f64,
    /// From the shot of the last return of a complete object to its consumer, milliseconds.
    delays_ms: Vec<f64>,
    /// What else is known.
    notes: Vec<String>,
}

impl Load {
    fn print(self) {
        println!(
            "  {:.2} times a bare receiver of the same packets: {:.2} and {:.2} % of a core",
            self.daemon / self.receiver,
            self.daemon,
            self.receiver
        );
        print_delays(&sorted(self.delays_ms.into_iter()));
        for note in self.notes {
            println!("  {note}");
        }
    }
}

/// Sends at a multiple of real time, to the daemon, with a consumer of sweeps and, if it is so, one
/// of objects, and to a bare receiver.
fn load(program: &Path, stream: &Stream, pace: f64, seconds: u64, listens: bool) -> Load {
    let daemon = Daemon::start(program, stream.model);
    let mut client = Client::within(&daemon.domain(), "bench").unwrap();
    let objects = client.objects().unwrap();
    let over = Arc::new(AtomicBool::new(false));
    let [is_over, is_over_too] = [&over, &over].map(Arc::clone);
    let listener = listens.then(|| thread::spawn(move || delays_ms(objects, &is_over_too)));
    let consumer = thread::spawn(move || {
        let (mut sweeps, mut lost, mut dropped) = (0_u64, 0_u64, 0_u64);
        while !is_over.load(Ordering::Relaxed) {
            let Some(sweep) = client.next(WAIT).unwrap().received() else {
                continue;
            };
            let header = *sweep.view().unwrap().header;
            sweeps += 1;
            lost += u64::from(header.lost_packets);
            dropped += u64::from(header.dropped_datagrams);
        }
        format!("{sweeps} sweeps received, {lost} packets lost, {dropped} dropped")
    });
    let receiver = Receiver::start();
    thread::sleep(Duration::from_millis(500));
    let (begun, mut mark, mut memory) = (Instant::now(), None, Vec::new());
    let sent = stream.send(&[daemon.ports, [receiver.port; 2]], pace, || {
        let elapsed = begun.elapsed();
        if elapsed >= BEFORE {
            mark.get_or_insert_with(|| {
                (
                    Instant::now(),
                    daemon.worked_ns(),
                    worked_ns(&receiver.folder),
                )
            });
        }
        if elapsed >= BEFORE + Duration::from_secs(5) * memory.len() as u32 {
            memory.push(daemon.memory_kib());
        }
        elapsed.as_secs() >= seconds
    });
    let (from, daemon_ns, receiver_ns) = mark.unwrap();
    let percent = 100.0 / from.elapsed().as_nanos() as f64;
    let daemon_share = (daemon.worked_ns() - daemon_ns) * percent;
    let receiver_share = (worked_ns(&receiver.folder) - receiver_ns) * percent;
    receiver.end();
    thread::sleep(Duration::from_millis(300));
    over.store(true, Ordering::Relaxed);
    let mut notes = daemon.metrics(&["packets_total", "dropped", "lost", "rejected"]);
    notes.push(format!("{sent} packets sent; {}", consumer.join().unwrap()));
    notes.push(format!("memory every 5 s, KiB: {memory:?}"));
    Load {
        daemon: daemon_share,
        receiver: receiver_share,
        delays_ms: listener.map_or_else(Vec::new, |listener| listener.join().unwrap()),
        notes,
    }
}

/// From the shot of the last return of each object that is complete before its sweep to here,
/// milliseconds, after the first seconds.
fn delays_ms(mut objects: Objects, over: &AtomicBool) -> Vec<f64> {
    let (begun, mut delays_ms) = (Instant::now(), Vec::new());
    while !over.load(Ordering::Relaxed) {
        let Some(message) = objects.next(WAIT).unwrap().received() else {
            continue;
        };
        let now_ns = realtime_ns();
        let view = message.view().unwrap();
        for object in view.objects {
            let last_ns = view.header.time_ns + i64::from(object.last_ns);
            if object.why == why::COMPLETE && begun.elapsed() > BEFORE {
                delays_ms.push((now_ns - last_ns) as f64 * 1e-6);
            }
        }
    }
    delays_ms
}

/// A thread that takes packets from the kernel three times in a turn of 10 Hz, about as often as the
/// threads of a daemon with one sensor wake up together, and does nothing with them.
struct Receiver {
    port: u16,
    over: Arc<AtomicBool>,
    thread: JoinHandle<()>,
    /// Its folder in /proc.
    folder: PathBuf,
}

impl Receiver {
    fn start() -> Self {
        let config = UdpConfig {
            address: Ipv4Addr::LOCALHOST,
            ..UdpConfig::port(0)
        };
        let mut source = UdpSource::bind(&config).unwrap();
        let port = source.local_addr().port();
        let over = Arc::new(AtomicBool::new(false));
        let is_over = Arc::clone(&over);
        let (sender, folder) = mpsc::channel();
        let thread = thread::spawn(move || {
            let this = std::fs::read_link("/proc/thread-self").unwrap();
            sender.send(Path::new("/proc").join(this)).unwrap();
            while !is_over.load(Ordering::Relaxed) {
                thread::sleep(Duration::from_micros(33_333));
                while source.receive_counted(Duration::ZERO).unwrap().count() > 0
                    && source.may_hold_more()
                {}
            }
        });
        Self {
            port,
            over,
            thread,
            folder: folder.recv().unwrap(),
        }
    }

    fn end(self) {
        self.over.store(true, Ordering::Relaxed);
        self.thread.join().unwrap();
    }
}

/// For how long a thread has had a core, nanoseconds, by its folder in /proc.
fn worked_ns(thread: &Path) -> f64 {
    let stat = std::fs::read_to_string(thread.join("schedstat")).unwrap();
    stat.split(' ').next().unwrap().parse().unwrap()
}
