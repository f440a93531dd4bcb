//! The daemon as robots run it: `sweepd run`, sensors and consumers, each in a process of its own, over loopback.

#[path = "../common/mod.rs"]
mod common;
mod crashes;
#[path = "../common/domain.rs"]
mod domain;
mod equal;
#[path = "../common/same.rs"]
mod same;

use std::net::UdpSocket;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::{Duration, Instant};

use domain::Own;
use sweepd::client::{Client, Domain};

const SOON: Duration = Duration::from_secs(10);

/// A child process that ends with the test.
struct Process(Child);

impl Process {
    fn start(args: &[&str], log: &Path) -> Self {
        let log = std::fs::File::options().create(true).append(true).open(log).unwrap();
        let mut command = Command::new(env!("CARGO_BIN_EXE_sweepd"));
        command.args(args).current_dir(env!("CARGO_MANIFEST_DIR"));
        command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(log);
        Self(command.spawn().expect("the binary runs"))
    }

    fn signal(&self, name: &str) {
        assert!(Command::new("kill").args([name, &self.0.id().to_string()]).status().unwrap().success());
    }

    /// Waits for its end; gives whether it did what it should.
    fn wait(&mut self) -> bool {
        let begun = Instant::now();
        loop {
            if let Some(status) = self.0.try_wait().unwrap() {
                return status.success();
            }
            assert!(begun.elapsed() < Duration::from_secs(60), "it does not end");
            std::thread::sleep(Duration::from_millis(5));
        }
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// A daemon's folder, ports and configuration.
struct Setup {
    own: Own,
    folder: PathBuf,
    port: u16,
    config: PathBuf,
}

impl Setup {
    /// One sensor, `roof`, on loopback, with more lines of its own and of the whole.
    fn new(sensor: &str, more: &str) -> Self {
        static NEXT: AtomicU32 = AtomicU32::new(0);
        let number = NEXT.fetch_add(1, Ordering::Relaxed);
        let folder = std::env::temp_dir().join(format!("sweepd-live-{}-{number}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        let free = || UdpSocket::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
        let (own, port, position_port) = (Own::new(), free(), free());
        let text = format!(
            "http = \"off\"\nroot = \"{}\"\n\n[[sensor]]\nname = \"roof\"\naddress = \"127.0.0.1\"\nport = {port}\n\
             position_port = {position_port}\nbind = \"127.0.0.1\"\n{sensor}\n{more}\n",
            own.root().display()
        );
        let config = folder.join("sweepd.toml");
        std::fs::write(&config, text).unwrap();
        Self { own, folder, port, config }
    }

    fn domain(&self) -> Domain {
        self.own.domain()
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.join(name)
    }

    fn daemon(&self) -> Process {
        Process::start(&["run", "--config", self.config.to_str().unwrap()], &self.path("daemon.log"))
    }

    fn log(&self) -> String {
        std::fs::read_to_string(self.path("daemon.log")).unwrap_or_default()
    }

    /// A simulated sensor that sends for so long.
    fn sensor(&self, model: &str, rpm: u32, seconds: f64) -> Process {
        let to = format!("127.0.0.1:{}", self.port);
        let (rpm, seconds) = (rpm.to_string(), seconds.to_string());
        let args = ["simulate", "--model", model, "--rpm", &rpm, "--seconds", &seconds, "--to", &to];
        Process::start(&args, &self.path("sensor.log"))
    }

    /// A consumer that found the daemon.
    fn client(&self) -> Client {
        let mut client = Client::within(&self.domain(), "roof").unwrap();
        let begun = Instant::now();
        while !client.is_connected() {
            let _ = client.next(Duration::from_millis(20)).unwrap();
            assert!(begun.elapsed() < SOON, "no daemon: {}", self.log());
        }
        client
    }
}

impl Drop for Setup {
    fn drop(&mut self) {
        if std::thread::panicking() {
            eprintln!("the daemon said:\n{}", self.log());
        }
        let _ = std::fs::remove_dir_all(&self.folder);
    }
}
