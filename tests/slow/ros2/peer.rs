//! A peer: a program that tells on its standard output what it hears.

use std::ffi::{OsStr, OsString};
use std::io::{BufRead, BufReader, Read};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::OnceLock;
use std::sync::mpsc::{Receiver, RecvTimeoutError, channel};
use std::thread;
use std::time::{Duration, Instant};

use serde_json::{Value, json};
use sweepd_testkit::{PATIENCE, Process};

use super::world::on_domain;

/// No multicast, loopback alone.
const CYCLONE: &str = "<CycloneDDS><Domain><General><Interfaces><NetworkInterface address='127.0.0.1'/></Interfaces>\
<AllowMulticast>false</AllowMulticast></General><Discovery><ParticipantIndex>auto</ParticipantIndex>\
<MaxAutoParticipantIndex>32</MaxAutoParticipantIndex><Peers><Peer address='127.0.0.1'/></Peers></Discovery>\
</Domain></CycloneDDS>";

/// A program that tells what it hears. It is killed when it is dropped.
pub struct Peer {
    pub process: Process,
    said: Receiver<Said>,
}

/// A line that a peer said, and the bytes behind it.
pub struct Said {
    pub line: Value,
    pub data: Vec<u8>,
}

impl Peer {
    /// rclpy of the distribution whose interpreter a variable names.
    pub fn ros(variable: &str, dds_domain: u32, wanted: &Value) -> Self {
        Self::start(Self::ros_command(variable, wanted), dds_domain)
    }

    /// The command that starts it.
    pub fn ros_command(variable: &str, wanted: &Value) -> Command {
        let mut command = Command::new(interpreter(variable));
        command.arg(script("ros_peer.py")).arg(wanted.to_string());
        if variable != "SWEEPD_JAZZY" {
            // Two versions of Fast DDS break each other's files in shared memory.
            command.env("FASTDDS_BUILTIN_TRANSPORTS", "UDPv4");
        }
        command
    }

    /// rclpy of Jazzy that tells where a robot is: `odometry.py` says what of it.
    pub fn robot(dds_domain: u32, moves: &Value) -> Self {
        let mut command = Command::new(interpreter("SWEEPD_JAZZY"));
        command.arg(script("odometry.py")).arg(moves.to_string());
        Self::start(command, dds_domain)
    }

    /// Cyclone DDS.
    pub fn cyclone(dds_domain: u32, wanted: Value) -> Self {
        Self::start(Self::cyclone_command(dds_domain, wanted), dds_domain)
    }

    /// The command that starts it.
    pub fn cyclone_command(dds_domain: u32, wanted: Value) -> Command {
        Self::cyclone_script("dds_peer.py", dds_domain, wanted)
    }

    /// Cyclone DDS that tells where a robot is on `/tf`.
    pub fn transforms(dds_domain: u32, moves: Value) -> Self {
        let command = Self::cyclone_script("transforms.py", dds_domain, moves);
        Self::start(command, dds_domain)
    }

    /// Clients of rmw_cyclonedds that get and set parameters, again and again.
    pub fn requests(dds_domain: u32) -> Self {
        let command = Self::cyclone_script("requests.py", dds_domain, json!({}));
        Self::start(command, dds_domain)
    }

    fn cyclone_script(name: &str, dds_domain: u32, mut wanted: Value) -> Command {
        wanted["domain"] = dds_domain.into();
        let mut command = Command::new(interpreter("SWEEPD_ROS_PYTHON"));
        command
            .arg(script(name))
            .arg(wanted.to_string())
            .env("CYCLONEDDS_URI", CYCLONE);
        command
    }

    /// Debian's Fast DDS.
    pub fn fastdds(dds_domain: u32, words: &[&str]) -> Self {
        let mut command = Command::new(fastdds_peer());
        command.arg(dds_domain.to_string()).args(words);
        Self::start(command, dds_domain)
    }

    /// What a command starts, on a domain of this host alone.
    pub fn start(mut command: Command, dds_domain: u32) -> Self {
        on_domain(&mut command, dds_domain);
        Self::start_as_is(command)
    }

    /// What a command starts, with the environment that it has.
    pub fn start_as_is(mut command: Command) -> Self {
        let mut process = Process::start(command.stdout(Stdio::piped())).unwrap();
        let stdout = process.child.stdout.take().unwrap();
        let (sender, said) = channel();
        thread::spawn(move || {
            let mut stdout = BufReader::with_capacity(1 << 20, stdout);
            let mut line = String::new();
            while stdout.read_line(&mut line).is_ok_and(|bytes| bytes > 0) {
                let value: Value = serde_json::from_str(&line).expect("a peer speaks JSON");
                let bytes = value["bytes"].as_u64().unwrap_or(0);
                let mut data = vec![0; bytes as usize];
                if stdout.read_exact(&mut data).is_err()
                    || sender.send(Said { line: value, data }).is_err()
                {
                    return;
                }
                line.clear();
            }
        });
        Self { process, said }
    }

    /// Waits until it listens.
    pub fn ready(self) -> Self {
        let mut peer = self;
        peer.wait_for("it is ready", |said| said.line["ready"] == true);
        peer
    }

    /// What it says next, if it says something within a time.
    pub fn next(&mut self, within: Duration) -> Option<Said> {
        match self.said.recv_timeout(within) {
            Ok(said) => Some(said),
            Err(RecvTimeoutError::Timeout) => None,
            Err(RecvTimeoutError::Disconnected) => {
                panic!("{}", self.process.failure("a peer ended".to_owned()))
            }
        }
    }

    /// What it says first that `is_it`; what it says before is lost.
    pub fn wait_for(&mut self, what: &str, is_it: impl Fn(&Said) -> bool) -> Said {
        let begun = Instant::now();
        while begun.elapsed() < 3 * PATIENCE {
            if let Some(said) = self.next(Duration::from_millis(100))
                && is_it(&said)
            {
                return said;
            }
        }
        panic!(
            "{}",
            self.process
                .failure(format!("{:?} passed before {what}", 3 * PATIENCE))
        );
    }

    /// Forgets what it has said so far.
    pub fn forget(&mut self) {
        self.said.try_iter().for_each(drop);
    }
}

/// The Python interpreter that a variable names.
pub fn interpreter(variable: &str) -> OsString {
    std::env::var_os(variable)
        .unwrap_or_else(|| panic!("{variable} names no interpreter: .ci/run makes one"))
}

pub fn script(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("tests/slow/ros2")
        .join(name)
}

/// The peer with Debian's Fast DDS, compiled once.
pub fn fastdds_peer() -> &'static OsStr {
    static PEER: OnceLock<PathBuf> = OnceLock::new();
    let peer = PEER.get_or_init(|| {
        let program = Path::new(env!("CARGO_TARGET_TMPDIR")).join("fastdds_peer");
        let compiled = Command::new("c++")
            .args(["-std=c++17", "-O1"])
            .arg(script("fastdds_peer.cpp"))
            .arg("-o")
            .arg(&program)
            .args(["-lfastrtps", "-lfastcdr"])
            .status();
        assert!(compiled.unwrap().success(), "needs libfastrtps-dev");
        program
    });
    peer.as_os_str()
}
