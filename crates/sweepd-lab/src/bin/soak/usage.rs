//! The daemon as a process of its own, as systemd runs it: started, asked, told to reload, ended,
//! killed.

use std::collections::{BTreeMap, VecDeque};
use std::fs;
use std::io::{self, BufRead, BufReader, Read, Write};
use std::net::{Ipv4Addr, SocketAddrV4, TcpStream};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStderr, Command, ExitStatus, Stdio};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread;
use std::time::{Duration, Instant};

use super::SoakError;
use super::sys::{Signal, inherit_nothing, signal};

/// How long the daemon may take for anything: to be there, to answer, to end.
pub const PATIENCE: Duration = Duration::from_secs(20);
/// What it says of its recording.
const RECORDINGS: [&str; 2] = ["recording to ", "recorded "];
/// Lines of its log that are kept, to be shown when something is wrong.
const LINES: usize = 40;

/// What the daemon has said.
#[derive(Debug, Default)]
struct Log {
    last: VecDeque<String>,
    /// Lines that tell of a new configuration in use.
    reconfigured: u64,
    /// Lines that tell that a configuration was refused.
    refused: u64,
    /// Lines that tell that a recording began or ended, by their first words.
    recordings: [u64; RECORDINGS.len()],
}

/// A daemon that runs.
#[derive(Debug)]
pub struct Daemon {
    child: Child,
    log: Arc<Mutex<Log>>,
    http: SocketAddrV4,
}

/// What the system says of a process.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Usage {
    /// Memory of its own, KiB.
    pub own_kib: u64,
    /// All resident memory, that shared with consumers included, KiB.
    pub resident_kib: u64,
    /// Threads.
    pub threads: u64,
    /// Open descriptors.
    pub descriptors: u64,
}

impl Daemon {
    /// Starts `program` with a configuration whose `http` is this, and waits until it answers.
    ///
    /// # Errors
    /// [`SoakError`]: it does not run, or does not answer.
    pub fn start(program: &Path, config: &Path, http: SocketAddrV4) -> Result<Self, SoakError> {
        let mut command = Command::new(program);
        command
            .args(["run", "--config"])
            .arg(config)
            .env_remove("SWEEPD_LOG")
            .env_remove("NOTIFY_SOCKET");
        command
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(Stdio::piped());
        inherit_nothing(&mut command);
        let mut child = command.spawn().map_err(|source| SoakError::System {
            what: "start the daemon",
            source,
        })?;
        let log = Arc::<Mutex<Log>>::default();
        if let Some(stderr) = child.stderr.take() {
            let log = Arc::clone(&log);
            thread::spawn(move || listen(stderr, &log));
        }
        let mut daemon = Self { child, log, http };
        daemon.until("it answers on its HTTP port", |daemon| {
            Ok(daemon.ask("/health").is_ok())
        })?;
        Ok(daemon)
    }

    /// The body of an answer.
    ///
    /// # Errors
    /// It does not answer.
    pub fn ask(&self, path: &str) -> io::Result<String> {
        let mut stream = TcpStream::connect_timeout(&self.http.into(), PATIENCE)?;
        stream.set_read_timeout(Some(PATIENCE))?;
        write!(
            stream,
            "GET {path} HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n"
        )?;
        let mut answer = String::new();
        stream.read_to_string(&mut answer)?;
        answer
            .split_once("\r\n\r\n")
            .map(|(_, body)| body.to_owned())
            .ok_or(io::ErrorKind::InvalidData.into())
    }

    /// Its metrics, by name and labels.
    ///
    /// # Errors
    /// [`SoakError`]: it does not answer.
    pub fn metrics(&mut self) -> Result<BTreeMap<String, f64>, SoakError> {
        let text = self
            .ask("/metrics")
            .map_err(|source| self.wrong(format!("/metrics: {source}")))?;
        let sample = |line: &str| {
            let (name, value) = line.rsplit_once(' ')?;
            Some((name.to_owned(), value.parse().ok()?))
        };
        Ok(text
            .lines()
            .filter(|line| !line.starts_with('#'))
            .filter_map(sample)
            .collect())
    }

    /// Waits until something is so.
    ///
    /// # Errors
    /// [`SoakError`]: it is not within [`PATIENCE`], or the daemon has ended.
    pub fn until(
        &mut self,
        what: &str,
        mut is_so: impl FnMut(&Self) -> Result<bool, SoakError>,
    ) -> Result<(), SoakError> {
        let begun = Instant::now();
        while !is_so(self)? {
            if let Ok(Some(status)) = self.child.try_wait() {
                return Err(self.wrong(format!("the daemon has ended ({status}) before {what}")));
            }
            if begun.elapsed() > PATIENCE {
                return Err(self.wrong(format!("{} s passed before {what}", PATIENCE.as_secs())));
            }
            thread::sleep(Duration::from_millis(2));
        }
        Ok(())
    }

    /// Has it read its configuration again, and waits until this many sensors are decoded by the
    /// new one.
    ///
    /// # Errors
    /// [`SoakError`].
    pub fn reload(&mut self, sensors: u64) -> Result<(), SoakError> {
        let before = self.log().reconfigured;
        self.tell(Signal::Reload)?;
        self.until("it has taken the new configuration", |daemon| {
            Ok(daemon.log().reconfigured >= before + sensors)
        })
    }

    /// Has it read a configuration that it cannot take, and waits until it says so.
    ///
    /// # Errors
    /// [`SoakError`].
    pub fn reload_in_vain(&mut self) -> Result<(), SoakError> {
        let before = self.log().refused;
        self.tell(Signal::Reload)?;
        self.until("it has refused the configuration", |daemon| {
            Ok(daemon.log().refused > before)
        })
    }

    /// Has it read a configuration in which the recording alone is another, and waits until that
    /// has begun or ended.
    ///
    /// # Errors
    /// [`SoakError`].
    pub fn reload_recording(&mut self, begins: bool) -> Result<(), SoakError> {
        let index = usize::from(!begins);
        let before = self.log().recordings[index];
        self.tell(Signal::Reload)?;
        self.until("the recording has begun or ended", |daemon| {
            Ok(daemon.log().recordings[index] > before)
        })
    }

    /// Asks it to end, and waits for that.
    ///
    /// # Errors
    /// [`SoakError`]: it does not, or not well.
    pub fn end(mut self) -> Result<(), SoakError> {
        self.tell(Signal::End)?;
        match self.wait()? {
            status if status.success() => Ok(()),
            status => Err(self.wrong(format!(
                "the daemon was asked to end, and did so with {status}"
            ))),
        }
    }

    /// Kills it.
    ///
    /// # Errors
    /// [`SoakError`].
    pub fn kill(mut self) -> Result<(), SoakError> {
        self.child.kill().map_err(|source| SoakError::System {
            what: "kill the daemon",
            source,
        })?;
        self.wait().map(drop)
    }

    /// What it takes of the system.
    pub fn usage(&self) -> Usage {
        usage(self.child.id())
    }

    /// An error about this daemon, with the end of its log.
    pub fn wrong(&mut self, mut what: String) -> SoakError {
        // A process that dies closes its sockets some time before it can be waited for.
        for _ in 0..50 {
            if let Ok(Some(status)) = self.child.try_wait() {
                what += &format!(" (the daemon has ended, {status})");
                break;
            }
            thread::sleep(Duration::from_millis(10));
        }
        let log: Vec<String> = self.log().last.iter().cloned().collect();
        SoakError::Wrong {
            what,
            log: log.join("\n"),
        }
    }

    fn tell(&self, what: Signal) -> Result<(), SoakError> {
        signal(&self.child, what).map_err(|source| SoakError::System {
            what: "send the daemon a signal",
            source,
        })
    }

    fn wait(&mut self) -> Result<ExitStatus, SoakError> {
        let begun = Instant::now();
        loop {
            match self.child.try_wait() {
                Ok(Some(status)) => return Ok(status),
                Ok(None) if begun.elapsed() < PATIENCE => thread::sleep(Duration::from_millis(2)),
                Ok(None) => {
                    return Err(
                        self.wrong(format!("it does not end within {} s", PATIENCE.as_secs()))
                    );
                }
                Err(source) => {
                    return Err(SoakError::System {
                        what: "wait for the daemon",
                        source,
                    });
                }
            }
        }
    }

    fn log(&self) -> MutexGuard<'_, Log> {
        self.log.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Drop for Daemon {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

fn listen(stderr: ChildStderr, log: &Mutex<Log>) {
    for line in BufReader::new(stderr).lines().map_while(Result::ok) {
        let mut log = log.lock().unwrap_or_else(PoisonError::into_inner);
        log.reconfigured += u64::from(line.contains("decoded with the new configuration"));
        log.refused += u64::from(line.contains("the configuration is not taken"));
        for (count, words) in log.recordings.iter_mut().zip(RECORDINGS) {
            *count += u64::from(line.contains(words));
        }
        log.last.push_back(line);
        if log.last.len() > LINES {
            log.last.pop_front();
        }
    }
}

/// What a process takes; zeroes once it has ended.
pub fn usage(pid: u32) -> Usage {
    let status = fs::read_to_string(format!("/proc/{pid}/status")).unwrap_or_default();
    let number = |key: &str| {
        let line = status
            .lines()
            .find_map(|line| line.strip_prefix(key))
            .unwrap_or_default();
        line.split_whitespace()
            .next()
            .and_then(|number| number.parse().ok())
            .unwrap_or(0)
    };
    let descriptors = fs::read_dir(format!("/proc/{pid}/fd")).map_or(0, |all| all.count() as u64);
    Usage {
        own_kib: number("RssAnon:"),
        resident_kib: number("VmRSS:"),
        threads: number("Threads:"),
        descriptors,
    }
}

/// What waits in the sockets of some UDP ports, bytes as the kernel charges them, and what these
/// have dropped.
///
/// # Errors
/// /proc cannot be read.
pub fn waiting(ports: &[u16]) -> io::Result<(u64, u64)> {
    let table = fs::read_to_string("/proc/net/udp")?;
    let socket = |line: &str| {
        let fields: Vec<&str> = line.split_ascii_whitespace().collect();
        let port = u16::from_str_radix(fields.get(1)?.rsplit_once(':')?.1, 16).ok()?;
        let bytes = u64::from_str_radix(fields.get(4)?.split_once(':')?.1, 16).ok()?;
        ports
            .contains(&port)
            .then_some((bytes, fields.last()?.parse().ok()?))
    };
    let sockets = table.lines().skip(1).filter_map(socket);
    Ok(
        sockets.fold((0, 0), |(bytes, drops), (more, dropped): (u64, u64)| {
            (bytes.max(more), drops + dropped)
        }),
    )
}

/// Ports of the loopback interface that are free, most likely for a while.
///
/// # Errors
/// There is none.
pub fn free_ports() -> io::Result<([u16; 3], u16)> {
    // All at once, so that they differ.
    let udp = [0; 3].map(|_| std::net::UdpSocket::bind((Ipv4Addr::LOCALHOST, 0)));
    let tcp = std::net::TcpListener::bind((Ipv4Addr::LOCALHOST, 0))?;
    let mut ports = [0; 3];
    for (port, socket) in ports.iter_mut().zip(udp) {
        *port = socket?.local_addr()?.port();
    }
    Ok((ports, tcp.local_addr()?.port()))
}

/// Bytes of shared memory that a domain's files really take, and how many these are; with those of
/// its folder.
pub fn files(root: &Path, prefix: &str) -> (u64, u64) {
    fn within(folder: &Path) -> u64 {
        let entries = fs::read_dir(folder).into_iter().flatten().flatten();
        entries
            .map(|entry| {
                if entry.path().is_dir() {
                    within(&entry.path())
                } else {
                    1
                }
            })
            .sum()
    }
    let shared = shared_memory(prefix);
    let bytes = shared.iter().filter_map(|path| path.metadata().ok());
    let bytes = bytes
        .map(|file| std::os::unix::fs::MetadataExt::blocks(&file) * 512)
        .sum();
    (shared.len() as u64 + within(root), bytes)
}

/// The files of a domain in shared memory.
pub fn shared_memory(prefix: &str) -> Vec<PathBuf> {
    let entries = fs::read_dir(sweepd_client::publish::SHARED_MEMORY)
        .into_iter()
        .flatten()
        .flatten();
    entries
        .filter(|entry| entry.file_name().to_string_lossy().starts_with(prefix))
        .map(|entry| entry.path())
        .collect()
}
