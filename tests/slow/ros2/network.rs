//! A network of its own, in which programs run.

use std::process::Command;
use std::time::{Duration, Instant};

use sweepd_testkit::{PATIENCE, Process};

/// A network namespace, which ends with this.
pub struct Network(Process);

impl Network {
    /// A network of which nothing is up yet.
    pub fn new() -> Self {
        let mut holder = Command::new("unshare");
        let network = Self(Process::start(holder.args(["-n", "sleep", "600"])).unwrap());
        let of = |pid: &str| std::fs::read_link(format!("/proc/{pid}/ns/net")).unwrap();
        let begun = Instant::now();
        while of(&network.pid()) == of("self") {
            assert!(begun.elapsed() < PATIENCE, "no new network");
            std::thread::sleep(Duration::from_millis(10));
        }
        network
    }

    /// The process that holds it.
    pub fn pid(&self) -> String {
        self.0.child.id().to_string()
    }

    /// Command that does the same in this network.
    pub fn within(&self, command: &Command) -> Command {
        let mut inside = Command::new("nsenter");
        inside.args(["-t", &self.pid(), "-n"]);
        inside.arg(command.get_program()).args(command.get_args());
        for (name, value) in command.get_envs() {
            match value {
                Some(value) => inside.env(name, value),
                None => inside.env_remove(name),
            };
        }
        inside
    }

    /// Runs a script of the shell in this network.
    pub fn shell(&self, script: &str) {
        let mut shell = Command::new("sh");
        let output = self.within(shell.args(["-ec", script])).output().unwrap();
        assert!(output.status.success(), "{script}: {output:?}");
    }
}
