//! A daemon, what its sensors send, and bridges.

use std::net::SocketAddrV4;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::OnceLock;

use sweepd::client::Domain;
use sweepd_testkit::{Daemon, Process, ReservedPort, TempDomain, daemon::run_command};

use sweepd_testkit::{setup::sweepd, temp_domain};

/// What the sensor `roof` of a [`World`] is, as lines of the daemon's configuration.
pub const ROOF_MOUNT: &str = "x_m = 0.5\ny_m = 1.0\nz_m = 1.5\nyaw_deg = 90.0";
/// The same of the sensor `front`.
pub const FRONT_MOUNT: &str = "z_m = 2.0\npitch_deg = 90.0";

/// A sensor's name, its port, and the port of its position packets.
type Sensor = (&'static str, ReservedPort, ReservedPort);

/// A folder with a daemon's configuration.
pub struct World {
    pub own: TempDomain,
    config: PathBuf,
    http: ReservedPort,
    sensors: Vec<Sensor>,
}

impl World {
    /// Sensors of these names and mounts, on ports of their own.
    pub fn new(sensors: &[(&'static str, &str)]) -> Self {
        let own = temp_domain();
        let http = ReservedPort::new().unwrap();
        let mut text = format!(
            "http = \"{}\"\nroot = \"{}\"\n",
            http.address(),
            own.root().display()
        );
        let mut ports = Vec::new();
        for &(name, mount) in sensors {
            let data = ReservedPort::new().unwrap();
            let position = ReservedPort::new().unwrap();
            text += &format!(
                "[[sensor]]\nname = \"{name}\"\naddress = \"127.0.0.1\"\nbind = \"127.0.0.1\"\n\
                 port = {}\nposition_port = {}\n[sensor.mount]\n{mount}\n",
                data.number(),
                position.number()
            );
            ports.push((name, data, position));
        }
        let config = own.path("sweepd.toml");
        std::fs::write(&config, text).unwrap();
        Self {
            own,
            config,
            http,
            sensors: ports,
        }
    }

    pub fn domain(&self) -> Domain {
        self.own.domain()
    }

    pub fn http(&self) -> SocketAddrV4 {
        self.http.address()
    }

    /// Starts the daemon.
    pub fn daemon(&self) -> Daemon {
        let program = Path::new(env!("CARGO_BIN_EXE_sweepd"));
        Daemon::start(&mut run_command(program, &self.config), self.http()).unwrap()
    }

    /// Plays a capture to a sensor's port, again and again.
    pub fn feed(&self, sensor: &str, capture: &Path, speed: &str) -> Process {
        let (_, port, _) = self
            .sensors
            .iter()
            .find(|(name, ..)| *name == sensor)
            .unwrap();
        let mut command = sweepd(&["replay", "--loop", "--speed", speed, "--to"]);
        command
            .arg(port.address().to_string())
            .arg(capture)
            .stdout(Stdio::null());
        Process::start(&mut command).unwrap()
    }

    /// Starts `sweepd-ros2` on a DDS domain. It also publishes where a capture begins again: each
    /// sweep that consumers get.
    pub fn bridge(&self, dds_domain: u32, more: &[&str]) -> Process {
        Process::start(&mut self.bridge_command(dds_domain, more)).unwrap()
    }

    /// The command that starts it.
    pub fn bridge_command(&self, dds_domain: u32, more: &[&str]) -> Command {
        let all = ["--ros-args", "-p", "only_complete:=false", "--"];
        self.command_of_whole_turns(dds_domain, &[&all, more].concat())
    }

    /// The same without the sweeps that are no whole turns.
    pub fn bridge_of_whole_turns(&self, dds_domain: u32, more: &[&str]) -> Process {
        Process::start(&mut self.command_of_whole_turns(dds_domain, more)).unwrap()
    }

    fn command_of_whole_turns(&self, dds_domain: u32, more: &[&str]) -> Command {
        let mut command = Command::new(bridge_program());
        on_domain(&mut command, dds_domain);
        command
            .arg("--root")
            .arg(self.own.root())
            .args(more)
            .stdout(Stdio::null());
        command
    }

    /// Arguments by which a bridge asks this daemon for its health.
    pub fn health(&self) -> [String; 3] {
        ["--ros-args", "-p", &format!("health:={}", self.http())].map(str::to_owned)
    }
}

/// Has a program of ROS see this domain on this host alone, whatever the caller's environment says.
pub fn on_domain(command: &mut Command, dds_domain: u32) {
    for name in [
        "ROS_LOCALHOST_ONLY",
        "ROS_STATIC_PEERS",
        "RMW_IMPLEMENTATION",
        "SWEEPD_ROOT",
        "FASTRTPS_DEFAULT_PROFILES_FILE",
    ] {
        command.env_remove(name);
    }
    command
        .env("ROS_DOMAIN_ID", dds_domain.to_string())
        .env("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST");
}

/// The program `sweepd-ros2`, which `cargo test` builds beside `sweepd`.
fn bridge_program() -> PathBuf {
    let program = Path::new(env!("CARGO_BIN_EXE_sweepd")).with_file_name("sweepd-ros2");
    assert!(
        program.exists(),
        "{} is missing: `cargo build -p sweepd-ros2` builds it",
        program.display()
    );
    program
}

/// Four seconds of a VLP-16 at 10 Hz, in the host's time: 29,000 returns a sweep.
pub fn vlp16() -> &'static Path {
    static CAPTURE: OnceLock<PathBuf> = OnceLock::new();
    CAPTURE.get_or_init(|| simulate("vlp16", "4"))
}

/// Ten seconds of an HDL-64E S2 at 10 Hz, in the host's time: 131,000 returns a sweep, clouds of
/// 3.4 MB.
pub fn hdl64e() -> &'static Path {
    static CAPTURE: OnceLock<PathBuf> = OnceLock::new();
    CAPTURE.get_or_init(|| simulate("hdl64e-s2", "10"))
}

fn simulate(model: &str, seconds: &str) -> PathBuf {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("ros2");
    std::fs::create_dir_all(&folder).unwrap();
    let path = folder.join(format!("{model}.pcap"));
    let made = sweepd(&["simulate", "--model", model, "--seconds", seconds])
        .args(["--gps", "none", "--force", "--pcap"])
        .arg(&path)
        .stderr(Stdio::null())
        .status();
    assert!(made.unwrap().success());
    path
}
