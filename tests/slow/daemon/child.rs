//! A daemon as a process of its own: this test binary once more, which runs the one test that is
//! ignored otherwise.

use std::collections::BTreeMap;
use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::os::unix::net::UnixDatagram;
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdin, Command, ExitStatus, Stdio};
use std::sync::atomic::AtomicBool;
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use sweepd::daemon::config::Config;
use sweepd::daemon::control::{self, Reload};
use sweepd::sensor_settings::Rpm;
use sweepd_testkit::PATIENCE;

use crate::daemon::rig::{Fate, Rig, config, sensor, until};

/// `host data-port position-port http-port`, for each sensor; and the file that is read again.
const SENSORS: &str = "SWEEPD_TEST_SENSORS";
const RELOADED: &str = "SWEEPD_TEST_RELOADED";

/// Not a test but what the tests run: the daemon, told by its standard input what is to go wrong.
#[test]
#[ignore = "run by other tests, as a process of its own"]
fn runs_a_daemon() {
    let Ok(sensors) = std::env::var(SENSORS) else {
        return;
    };
    tracing_subscriber::fmt()
        .with_writer(std::io::stderr)
        .with_ansi(false)
        .init();
    let numbers: Vec<u16> = sensors
        .split(' ')
        .map(|number| number.parse().unwrap())
        .collect();
    let of = |numbers: &[u16]| {
        sensor(
            &format!("s{}", numbers[0]),
            numbers[0] as u8,
            (numbers[1], numbers[2]),
        )
    };
    let mut config = config(numbers.chunks_exact(4).map(of).collect());
    for index in 1..config.sensors.len() {
        let (before, [sensor, ..]) = config.sensors.split_at_mut(index) else {
            unreachable!()
        };
        if before.iter().any(|other| other.address == sensor.address) {
            sensor.name = format!("{}-{}", sensor.name, index + 1);
        }
    }
    config.daemon.http = Some(([127, 0, 0, 1], numbers[3]).into());
    let (rig, sweeps) = Rig::new();
    let rig = Arc::new(rig);
    std::thread::spawn(move || sweeps.iter().for_each(drop));
    let told = Arc::clone(&rig);
    std::thread::spawn(move || {
        for line in std::io::stdin().lines().map_while(Result::ok) {
            told.fate(match &line[..] {
                "hang" => Fate::Hangs,
                "panic" => Fate::Panics,
                "fail" => Fate::Fails,
                _ => Fate::Sends,
            });
        }
    });
    let reread = |old: &Config| {
        let text = std::fs::read_to_string(std::env::var(RELOADED).unwrap())
            .map_err(|error| error.to_string())?;
        let rpm = text
            .trim()
            .parse::<Rpm>()
            .map_err(|error| format!("{text}: {error}"))?;
        let mut new = old.clone();
        new.sensors[0].want.rpm = Some(rpm);
        new.sensors[0].pipeline.cut_azimuth_rad = 1.0;
        Ok(Reload {
            config: new,
            taken: Vec::new(),
            needs_restart: vec!["http needs a restart".to_owned()],
        })
    };
    let root = PathBuf::from(std::env::var(RELOADED).unwrap()).with_file_name("root");
    if let Err(error) = control::run(
        config,
        &*rig,
        &root,
        Arc::new(reread),
        &AtomicBool::new(false),
    ) {
        eprintln!("error: {error}");
        std::process::exit(1);
    }
}

/// A daemon that runs, and what it says.
pub struct Daemon {
    child: Child,
    stdin: ChildStdin,
    log: Arc<Mutex<String>>,
    notifications: Arc<Mutex<Vec<(Instant, String)>>>,
    folder: PathBuf,
    http: u16,
}

impl Daemon {
    /// Starts one with a watchdog of so long.
    pub fn start(sensors: &[[u16; 3]], http: u16, watchdog: Duration) -> Self {
        let folder =
            std::env::temp_dir().join(format!("sweepd-daemon-{}-{http}", std::process::id()));
        let _ = std::fs::remove_dir_all(&folder);
        std::fs::create_dir_all(folder.join("root")).unwrap();
        let socket = UnixDatagram::bind(folder.join("notify")).unwrap();
        let numbers =
            |[host, data, position]: &[u16; 3]| format!("{host} {data} {position} {http}");
        let mut child = Command::new(std::env::current_exe().unwrap())
            .args([
                "--exact",
                "daemon::child::runs_a_daemon",
                "--ignored",
                "--nocapture",
            ])
            .env(
                SENSORS,
                sensors.iter().map(numbers).collect::<Vec<_>>().join(" "),
            )
            .env(RELOADED, folder.join("reloaded"))
            .env("NOTIFY_SOCKET", folder.join("notify"))
            .env("WATCHDOG_USEC", watchdog.as_micros().to_string())
            .env_remove("WATCHDOG_PID")
            .stdin(Stdio::piped())
            .stdout(Stdio::null())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        let stdin = child.stdin.take().unwrap();
        let (log, notifications) = (
            Arc::<Mutex<String>>::default(),
            Arc::<Mutex<Vec<_>>>::default(),
        );
        let (stderr, lines) = (child.stderr.take().unwrap(), Arc::clone(&log));
        std::thread::spawn(move || {
            for line in BufReader::new(stderr).lines().map_while(Result::ok) {
                *lines.lock().unwrap() += &(line + "\n");
            }
        });
        let heard = Arc::clone(&notifications);
        std::thread::spawn(move || {
            let mut buffer = [0; 1024];
            while let Ok(len) = socket.recv(&mut buffer) {
                let text = String::from_utf8_lossy(&buffer[..len]).into_owned();
                heard.lock().unwrap().push((Instant::now(), text));
            }
        });
        Self {
            child,
            stdin,
            log,
            notifications,
            folder,
            http,
        }
    }

    pub fn log(&self) -> String {
        self.log.lock().unwrap().clone()
    }

    /// The notifications that hold a text, since a time.
    pub fn notified(&self, text: &str, since: Option<Instant>) -> Vec<String> {
        let all = self.notifications.lock().unwrap();
        let of = |(at, said): &(Instant, String)| {
            since.is_none_or(|since| *at >= since) && said.contains(text)
        };
        all.iter()
            .filter(|one| of(one))
            .map(|(_, said)| said.clone())
            .collect()
    }

    #[track_caller]
    pub fn until_ready(&self) {
        until("the daemon is ready", || {
            !self.notified("READY=1", None).is_empty()
        });
    }

    pub fn tell(&mut self, what: &str) {
        writeln!(self.stdin, "{what}").unwrap();
    }

    pub fn signal(&self, name: &str) {
        let done = Command::new("kill")
            .args([name, &self.child.id().to_string()])
            .status()
            .unwrap();
        assert!(done.success());
    }

    pub fn reloaded_file(&self) -> PathBuf {
        self.folder.join("reloaded")
    }

    /// Waits for its end.
    #[track_caller]
    pub fn end(&mut self) -> ExitStatus {
        let mut status = None;
        until("the daemon has ended", || {
            status = self.child.try_wait().unwrap();
            status.is_some()
        });
        status.unwrap()
    }

    pub fn pid(&self) -> u32 {
        self.child.id()
    }

    pub fn http_port(&self) -> u16 {
        self.http
    }

    /// Status and body of an answer.
    #[track_caller]
    pub fn ask(&self, request: &str) -> (u16, String) {
        self.try_ask(request).expect("an answer")
    }

    /// The same, where it may be refused.
    pub fn try_ask(&self, request: &str) -> Option<(u16, String)> {
        let mut stream = TcpStream::connect(("127.0.0.1", self.http)).ok()?;
        stream.set_read_timeout(Some(PATIENCE)).unwrap();
        write!(stream, "{request} HTTP/1.1\r\nHost: localhost\r\n\r\n").ok()?;
        let mut answer = String::new();
        stream.read_to_string(&mut answer).ok()?;
        let (head, body) = answer.split_once("\r\n\r\n")?;
        Some((head.split(' ').nth(1)?.parse().ok()?, body.to_owned()))
    }

    pub fn health(&self) -> (u16, serde_json::Value) {
        let (status, body) = self.ask("GET /health");
        (status, serde_json::from_str(&body).unwrap())
    }

    /// The samples of /metrics, by name and labels.
    pub fn metrics(&self) -> BTreeMap<String, f64> {
        let (status, body) = self.ask("GET /metrics");
        assert_eq!(status, 200);
        assert!(body.ends_with("# EOF\n"), "{body}");
        let samples = body.lines().filter(|line| !line.starts_with('#'));
        let sample = |line: &str| {
            let (name, value) = line.rsplit_once(' ').unwrap();
            (
                name.to_owned(),
                value
                    .parse()
                    .unwrap_or_else(|error| panic!("{line}: {error}")),
            )
        };
        let parsed: Vec<(String, f64)> = samples.map(sample).collect();
        let count = parsed.len();
        let by_name: BTreeMap<_, _> = parsed.into_iter().collect();
        assert_eq!(by_name.len(), count, "no sample stands there twice");
        by_name
    }
}

impl Drop for Daemon {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
        let _ = std::fs::remove_dir_all(&self.folder);
    }
}

/// Whether nobody listens on a UDP port.
pub fn is_free(port: u16) -> bool {
    std::net::UdpSocket::bind(("127.0.0.1", port)).is_ok()
}

pub fn write(path: &Path, text: &str) {
    std::fs::write(path, text).unwrap();
}
