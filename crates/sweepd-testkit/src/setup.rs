//! A daemon on loopback, its sensor and its consumers, each in a process of its own.

use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use sweepd::client::{Client, Domain};

use crate::{PATIENCE, TempDomain, free_port, pool, temp_domain};

/// Longer than anything takes on a busy machine.
pub const SOON: Duration = PATIENCE;

/// A child process that ends with the test.
pub struct Process(pub Child);

impl Process {
    /// Starts `sweepd` with these arguments.
    pub fn start(args: &[&str], log: &Path) -> Self {
        let mut command = sweepd(args);
        command.stdout(Stdio::null());
        Self::spawn(command, log)
    }

    /// Starts a program; its standard error goes to the end of the log.
    pub fn spawn(mut command: Command, log: &Path) -> Self {
        pool::share();
        let log = std::fs::File::options()
            .create(true)
            .append(true)
            .open(log)
            .unwrap();
        Self(
            command
                .stdin(Stdio::null())
                .stderr(log)
                .spawn()
                .expect("the program runs"),
        )
    }

    pub fn signal(&self, name: &str) {
        assert!(
            Command::new("kill")
                .args([name, &self.0.id().to_string()])
                .status()
                .unwrap()
                .success()
        );
    }

    /// Waits for its end; gives whether it did what it should.
    pub fn wait(&mut self) -> bool {
        self.ends_within(SOON).expect("it does not end").success()
    }

    /// Its end, if it comes within this time.
    pub fn ends_within(&mut self, limit: Duration) -> Option<ExitStatus> {
        let begun = Instant::now();
        loop {
            let ended = self.0.try_wait().unwrap();
            if ended.is_some() || begun.elapsed() >= limit {
                return ended;
            }
            std::thread::sleep(Duration::from_millis(2));
        }
    }

    /// Sends SIGTERM, which must end it with exit code 0.
    ///
    /// # Errors
    /// A sentence, if it does not.
    pub fn ends_when_told(&mut self) -> Result<(), String> {
        self.signal("-TERM");
        match self.ends_within(SOON) {
            Some(status) if status.success() => Ok(()),
            Some(status) => Err(format!("ends with {status} after SIGTERM")),
            None => Err(format!("still runs {SOON:?} after SIGTERM")),
        }
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

pub use crate::sweepd;

/// A daemon's folder, ports and configuration.
pub struct Setup {
    pub own: TempDomain,
    pub port: u16,
    http: u16,
    config: PathBuf,
}

impl Setup {
    /// One sensor, `roof`, on loopback, with more lines of its own and of the whole.
    pub fn new(sensor: &str, more: &str) -> Self {
        let own = temp_domain();
        let port = free_port();
        let position_port = free_port();
        let http = free_port();
        let text = format!(
            "http = \"127.0.0.1:{http}\"\nroot = \"{}\"\n\n[[sensor]]\nname = \"roof\"\naddress = \"127.0.0.1\"\nport = {port}\n\
             position_port = {position_port}\nbind = \"127.0.0.1\"\n{sensor}\n{more}\n",
            own.root().display()
        );
        let config = own.path("sweepd.toml");
        std::fs::write(&config, text).unwrap();
        Self {
            own,
            port,
            http,
            config,
        }
    }

    pub fn domain(&self) -> Domain {
        self.own.domain()
    }

    pub fn path(&self, name: &str) -> PathBuf {
        self.own.path(name)
    }

    /// The arguments with which the daemon starts.
    pub fn daemon_args(&self) -> [&str; 3] {
        ["run", "--config", self.config.to_str().unwrap()]
    }

    /// The arguments with which a consumer starts.
    pub fn watch_args(&self) -> [&str; 4] {
        ["watch", "roof", "--root", self.own.root().to_str().unwrap()]
    }

    pub fn daemon(&self) -> Process {
        Process::start(&self.daemon_args(), &self.path("daemon.log"))
    }

    pub fn log(&self) -> String {
        std::fs::read_to_string(self.path("daemon.log")).unwrap_or_default()
    }

    /// A simulated sensor that sends for this many seconds.
    pub fn sensor(&self, model: &str, rpm: u32, seconds: f64) -> Process {
        let to = format!("127.0.0.1:{}", self.port);
        let (rpm, seconds) = (rpm.to_string(), seconds.to_string());
        let args = [
            "simulate",
            "--model",
            model,
            "--rpm",
            &rpm,
            "--seconds",
            &seconds,
            "--to",
            &to,
        ];
        Process::start(&args, &self.path("sensor.log"))
    }

    /// A consumer that found the daemon.
    pub fn client(&self) -> Client {
        let mut client = Client::within(&self.domain(), "roof").unwrap();
        let begun = Instant::now();
        while !client.is_connected() {
            let _ = client.next(Duration::from_millis(20)).unwrap();
            assert!(begun.elapsed() < SOON, "no daemon: {}", self.log());
        }
        client
    }

    /// What the health page says of the sensor; `None` where there is no answer.
    pub fn health(&self) -> Option<serde_json::Value> {
        let mut stream = TcpStream::connect(("127.0.0.1", self.http)).ok()?;
        stream.set_read_timeout(Some(SOON)).unwrap();
        write!(
            stream,
            "GET /health HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n"
        )
        .ok()?;
        let mut answer = String::new();
        stream.read_to_string(&mut answer).ok()?;
        let (_, body) = answer.split_once("\r\n\r\n")?;
        let mut health: serde_json::Value = serde_json::from_str(body).ok()?;
        Some(health["sensors"][0].take())
    }
}

impl Drop for Setup {
    fn drop(&mut self) {
        if std::thread::panicking() {
            eprintln!("the daemon said:\n{}", self.log());
        }
    }
}

/// `sweepd watch`, and when it printed its sweeps.
pub struct Watch {
    pub process: Process,
    printed: Arc<Mutex<Vec<Instant>>>,
}

impl Watch {
    pub fn start(setup: &Setup) -> Self {
        let mut command = sweepd(&setup.watch_args());
        command.arg("--json").stdout(Stdio::piped());
        let mut process = Process::spawn(command, &setup.path("watch.log"));
        let printed = Arc::<Mutex<Vec<Instant>>>::default();
        let (lines, times) = (
            BufReader::new(process.0.stdout.take().unwrap()).lines(),
            Arc::clone(&printed),
        );
        std::thread::spawn(move || {
            for _ in lines.map_while(Result::ok) {
                times.lock().unwrap().push(Instant::now());
            }
        });
        Self { process, printed }
    }

    /// When each sweep came.
    pub fn times(&self) -> Vec<Instant> {
        self.printed.lock().unwrap().clone()
    }

    /// When the sweep of this number after a moment came, counted from 1 on.
    pub fn sweep(&self, moment: Instant, number: usize) -> Option<Instant> {
        let times = self.printed.lock().unwrap();
        let first = times.partition_point(|time| *time <= moment);
        times.get(first + number - 1).copied()
    }

    /// Waits until this number of sweeps came after a moment; whether that is so at most `limit`
    /// after it.
    pub fn gets(&self, sweeps: usize, moment: Instant, limit: Duration) -> bool {
        while self.sweep(moment, sweeps).is_none() && moment.elapsed() < limit {
            std::thread::sleep(Duration::from_millis(2));
        }
        self.sweep(moment, sweeps)
            .is_some_and(|time| time <= moment + limit)
    }
}
