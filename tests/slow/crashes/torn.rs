//! Whether a sweep is ever torn: a program in C, through libsweepd, against a client in Rust.

use std::collections::HashMap;
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::Duration;

use sweepd::client::Client;

use sweepd_testkit::{
    library::c_program,
    setup::{Process, Setup},
};

/// The hash of each sweep, by its run and its number.
type Hashes = HashMap<(i64, u64), u64>;

/// Both follow the sensor as long as this lives.
pub struct Torn {
    program: PathBuf,
    root: PathBuf,
    c: Process,
    lines: JoinHandle<Hashes>,
    rust: JoinHandle<Hashes>,
    over: Arc<AtomicBool>,
}

impl Torn {
    pub fn start(setup: &Setup) -> Self {
        let (program, root) = (c_program(&setup.path("")), setup.own.root().to_owned());
        let mut command = watch(&program, &root);
        command.stdout(Stdio::piped());
        let mut c = Process::spawn(command, &setup.path("watch.log"));
        let output = BufReader::new(c.0.stdout.take().unwrap());
        let over = Arc::new(AtomicBool::new(false));
        let (client, is_over) = (setup.client(), Arc::clone(&over));
        Self {
            program,
            root,
            c,
            lines: std::thread::spawn(move || of_lines(output)),
            rust: std::thread::spawn(move || of_client(client, &is_over)),
            over,
        }
    }

    /// One more in C.
    pub fn watch(&self) -> Command {
        watch(&self.program, &self.root)
    }

    /// Ends both, and gives the number of sweeps that both had: all of them were the same.
    pub fn end(mut self) -> usize {
        self.over.store(true, Ordering::Relaxed);
        let is_well = self.c.0.try_wait().unwrap().is_none();
        self.c.0.kill().unwrap();
        let (c, rust) = (self.lines.join().unwrap(), self.rust.join().unwrap());
        assert!(is_well, "the program in C has ended");
        let both = rust.iter().filter(|(of, _)| c.contains_key(of));
        let both: Vec<_> = both.map(|(of, hash)| (of, hash, c[of])).collect();
        for (of, hash, other) in &both {
            assert_eq!(**hash, *other, "{of:?}: not the same bytes");
        }
        assert!(
            both.len() > 20,
            "{} and {}, {} of both",
            c.len(),
            rust.len(),
            both.len()
        );
        both.len()
    }
}

fn watch(program: &Path, root: &Path) -> Command {
    let mut command = Command::new(program);
    command.args(["watch", "roof"]).arg(root);
    command
}

/// What the program says of each sweep: its hash as it came, and a while later.
fn of_lines(output: impl BufRead) -> Hashes {
    let mut hashes = Hashes::new();
    for line in output.lines().map_while(Result::ok) {
        let parts: Vec<&str> = line.split(' ').collect();
        // Killed, it may not have said all.
        let [run, number, first, later] = parts[..] else {
            continue;
        };
        assert_eq!(first, later, "{line}: it changed while it was held");
        let of = (run.parse().unwrap(), number.parse().unwrap());
        hashes.insert(of, first.parse().unwrap());
    }
    hashes
}

fn of_client(mut client: Client, over: &AtomicBool) -> Hashes {
    let mut hashes = Hashes::new();
    while !over.load(Ordering::Relaxed) {
        let next = client.next(Duration::from_millis(100)).unwrap();
        let Some(sweep) = next.received() else {
            continue;
        };
        let header = *sweep.view().unwrap().header;
        hashes.insert((header.run_ns, header.sequence), fnv_1a(sweep.bytes()));
    }
    hashes
}

fn fnv_1a(bytes: &[u8]) -> u64 {
    let mut hash = 0xcbf2_9ce4_8422_2325_u64;
    for &byte in bytes {
        hash = (hash ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3);
    }
    hash
}
