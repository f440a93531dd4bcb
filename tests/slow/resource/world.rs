//! A daemon in namespaces of its own, and what can be done to it there.

use std::fs;
use std::path::Path;
use std::process::{Child, Command, ExitStatus, Stdio};
use std::time::{Duration, Instant};

use sweepd_testkit::{PATIENCE, TempDomain, free_port, temp_domain};

/// A daemon's folder, ports, and the daemon.
pub struct World {
    own: TempDomain,
    pub port: u16,
    pub http: u16,
    daemon: Option<Child>,
    others: Vec<Child>,
}

impl World {
    pub fn new() -> Self {
        Self {
            own: temp_domain(),
            port: free_port(),
            http: free_port(),
            daemon: None,
            others: Vec::new(),
        }
    }

    pub fn folder(&self) -> &Path {
        self.own.folder()
    }

    /// Writes the configuration: a VLP-16 at 127.0.0.1, with more lines of the sensor and of the
    /// whole.
    pub fn configure(&self, sensor: &str, whole: &str) {
        let Self { port, http, .. } = self;
        let root = self.root().display();
        let bind = if sensor.contains("bind =") {
            ""
        } else {
            "bind = \"127.0.0.1\"\n"
        };
        let address = if sensor.contains("address =") {
            ""
        } else {
            "address = \"127.0.0.1\"\n"
        };
        let root = if sensor.contains("root =") || whole.contains("root =") {
            String::new()
        } else {
            format!("root = \"{root}\"\n")
        };
        let (before, after) = whole.split_once("---").unwrap_or(("", whole));
        let text = format!(
            "http = \"127.0.0.1:{http}\"\n{root}{before}\n[[sensor]]\nname = \"roof\"\nport = {port}\nposition_port = {port}\n\
             {address}{bind}{sensor}\n{after}\n"
        );
        fs::write(self.own.path("sweepd.toml"), text).unwrap();
    }

    /// Starts the daemon after a script, in mount and network namespaces as said: `-m`, `-n`.
    pub fn start(&mut self, unshare: &[&str], script: &str) {
        let log = fs::File::create(self.own.path("log")).unwrap();
        self.start_with_log(unshare, script, log.into());
    }

    /// The same, with its log somewhere else.
    pub fn start_with_log(&mut self, unshare: &[&str], script: &str, log: Stdio) {
        let run = format!(
            "{script}\nexec $PREFIX {} run --config {}/sweepd.toml",
            binary(),
            self.folder().display()
        );
        let mut command = Command::new("unshare");
        command
            .args(unshare)
            .args(["sh", "-ec", &run])
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(log);
        self.daemon = Some(command.spawn().unwrap());
    }

    /// A shell script in the daemon's namespaces.
    #[track_caller]
    pub fn inside(&self, script: &str) {
        let done = self.enter(&["sh", "-ec", script]).status().unwrap();
        assert!(done.success(), "{script}: {done}; {}", self.log());
    }

    fn enter(&self, command: &[&str]) -> Command {
        let mut enter = Command::new("nsenter");
        enter
            .args(["-t", &self.pid().to_string(), "-m", "-n"])
            .args(command);
        enter
    }

    /// A simulated VLP-16 that sends for so long in the daemon's namespaces, in the background.
    pub fn simulate(&mut self, seconds: f64) {
        self.simulate_model("vlp16", seconds);
    }

    /// The same of another model.
    pub fn simulate_model(&mut self, model: &str, seconds: f64) {
        let to = format!("127.0.0.1:{}", self.port);
        let seconds = seconds.to_string();
        let mut command = self.enter(&[
            &binary(),
            "simulate",
            "--model",
            model,
            "--seconds",
            &seconds,
            "--to",
            &to,
        ]);
        self.others.push(
            command
                .stdout(Stdio::null())
                .stderr(Stdio::null())
                .spawn()
                .unwrap(),
        );
    }

    /// Another program that ends with this.
    pub fn background(&mut self, mut command: Command) -> u32 {
        let child = command
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .unwrap();
        self.others.push(child);
        self.others.last().unwrap().id()
    }

    /// Waits until one of those has a network of its own.
    #[track_caller]
    pub fn until_own_network(&self, id: u32) {
        let network = |of: &str| fs::read_link(format!("/proc/{of}/ns/net")).unwrap();
        let begun = Instant::now();
        while network(&id.to_string()) == network("self") {
            assert!(begun.elapsed() < PATIENCE, "no new network");
            std::thread::sleep(Duration::from_millis(10));
        }
    }

    /// Ends one of those.
    pub fn stop(&mut self, id: u32) {
        let child = self
            .others
            .iter_mut()
            .find(|child| child.id() == id)
            .unwrap();
        child.kill().unwrap();
        child.wait().unwrap();
    }

    /// The folder of its shared memory, unless the configuration names another.
    pub fn root(&self) -> &std::path::Path {
        self.own.root()
    }

    pub fn pid(&self) -> u32 {
        self.daemon.as_ref().unwrap().id()
    }

    pub fn signal(&self, name: &str) {
        assert!(
            Command::new("kill")
                .args([name, &self.pid().to_string()])
                .status()
                .unwrap()
                .success()
        );
    }

    pub fn log(&self) -> String {
        fs::read_to_string(self.own.path("log")).unwrap_or_default()
    }

    /// How often the log says something.
    pub fn says(&self, text: &str) -> usize {
        self.log().matches(text).count()
    }

    #[track_caller]
    pub fn until_it_says(&mut self, text: &str) {
        self.until_it_says_again(text, 1);
    }

    /// Waits until the log has said something so often.
    #[track_caller]
    pub fn until_it_says_again(&mut self, text: &str, times: usize) {
        let begun = Instant::now();
        while self.says(text) < times {
            let ended = self.daemon.as_mut().unwrap().try_wait().unwrap();
            assert!(
                ended.is_none(),
                "ended with {ended:?}, and did not say `{text}`: {}",
                self.log()
            );
            assert!(
                begun.elapsed() < PATIENCE,
                "does not say `{text}`: {}",
                self.log()
            );
            std::thread::sleep(Duration::from_millis(10));
        }
    }

    /// Status and body of a GET, from within its namespaces; status 0 where there is no answer.
    pub fn ask(&self, path: &str) -> (u16, String) {
        let script = format!(
            "exec 3<>/dev/tcp/127.0.0.1/{}; printf 'GET {path} HTTP/1.1\\r\\nHost: localhost\\r\\n\\r\\n' >&3; timeout 20 cat <&3",
            self.http
        );
        let answer = self
            .enter(&["bash", "-c", &script])
            .stderr(Stdio::null())
            .output()
            .unwrap();
        let text = String::from_utf8_lossy(&answer.stdout).into_owned();
        let Some((head, body)) = text.split_once("\r\n\r\n") else {
            return (0, text);
        };
        (
            head.split(' ')
                .nth(1)
                .and_then(|status| status.parse().ok())
                .unwrap_or(0),
            body.to_owned(),
        )
    }

    /// Waits until the health page has this status and text.
    #[track_caller]
    pub fn until_health(&self, status: u16, text: &str) {
        let begun = Instant::now();
        loop {
            let (found, body) = self.ask("/health");
            if found == status && body.contains(text) {
                return;
            }
            assert!(
                begun.elapsed() < PATIENCE,
                "health is {found}, not {status} with `{text}`: {body}"
            );
            std::thread::sleep(Duration::from_millis(50));
        }
    }

    /// A sample of the metrics; 0 where there is none.
    pub fn metric(&self, name: &str) -> u64 {
        let (_, body) = self.ask("/metrics");
        let sample = body
            .lines()
            .find_map(|line| line.strip_prefix(name))
            .unwrap_or(" 0");
        sample.trim().parse::<f64>().unwrap() as u64
    }

    /// Waits until a sample of the metrics is so great.
    #[track_caller]
    pub fn until_metric(&self, name: &str, least: u64) {
        let begun = Instant::now();
        while self.metric(name) < least {
            assert!(
                begun.elapsed() < PATIENCE,
                "{name} stays under {least}: {}",
                self.log()
            );
            std::thread::sleep(Duration::from_millis(50));
        }
    }

    /// Waits for its end.
    #[track_caller]
    pub fn end(&mut self) -> ExitStatus {
        let begun = Instant::now();
        loop {
            if let Some(status) = self.daemon.as_mut().unwrap().try_wait().unwrap() {
                return status;
            }
            assert!(
                begun.elapsed() < PATIENCE,
                "it does not end: {}",
                self.log()
            );
            std::thread::sleep(Duration::from_millis(5));
        }
    }
}

impl Drop for World {
    fn drop(&mut self) {
        for child in self.others.iter_mut().chain(&mut self.daemon) {
            let _ = child.kill();
            let _ = child.wait();
        }
    }
}

pub fn binary() -> String {
    env!("CARGO_BIN_EXE_sweepd").to_owned()
}
