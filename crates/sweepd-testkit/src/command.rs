//! The binary with its arguments, what a run of it came to, and files that it reads and writes.

use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};

use tempfile::{Builder, TempDir};

/// What a run of the binary came to.
pub struct Ran {
    pub code: i32,
    pub stdout: String,
    pub stderr: String,
}

impl Ran {
    pub fn of(output: Output) -> Self {
        let text = |bytes| String::from_utf8(bytes).expect("output in UTF-8");
        let code = output.status.code().expect("an exit code, not a signal");
        let ran = Self {
            code,
            stdout: text(output.stdout),
            stderr: text(output.stderr),
        };
        assert!(!ran.stderr.contains("panicked"), "{}", ran.stderr);
        ran
    }

    /// The lines of its standard error, but for how a capture is mounted, which no test but those of it is about.
    pub fn said(&self) -> impl Iterator<Item = &str> {
        let is_other = |line: &&str| !(line.starts_with("warning: ") && line.contains("height_m"));
        self.stderr.lines().filter(is_other)
    }

    /// The output of a run that did all that it should, and said at most what it wrote.
    #[track_caller]
    pub fn done(self) -> String {
        let is_other = |line: &&str| !line.starts_with("note: written: ");
        assert_eq!(self.said().find(is_other), None);
        assert_eq!(self.code, 0);
        self.stdout
    }

    /// The one error of a run that failed with it.
    #[track_caller]
    pub fn error(&self) -> &str {
        assert_ne!(self.code, 0, "{}", self.stdout);
        let errors: Vec<&str> = self
            .stderr
            .lines()
            .filter(|line| line.starts_with("error: "))
            .collect();
        assert_eq!(errors.len(), 1, "{}", self.stderr);
        errors[0]
    }

    /// Fails unless the one error holds all of `parts`.
    #[track_caller]
    pub fn says(&self, parts: &[&str]) {
        let error = self.error();
        assert!(
            parts.iter().all(|part| error.contains(part)),
            "{error}\nlacks one of {parts:?}"
        );
    }
}

pub fn command(args: &[&str]) -> Command {
    let mut command = super::sweepd(args);
    command.stdin(Stdio::null());
    command
}

/// Runs the binary with these arguments.
pub fn sweepd(args: &[&str]) -> Ran {
    Ran::of(command(args).output().expect("the binary runs"))
}

/// `sweepd replay` of a capture, with options.
pub fn replay(capture: &Path, options: &[&str]) -> Ran {
    sweepd(&[&["replay", capture.to_str().unwrap()], options].concat())
}

pub fn inspect(capture: &Path) -> Ran {
    sweepd(&["inspect", capture.to_str().unwrap()])
}

/// Runs the binary with `bytes` on its standard input.
pub fn sweepd_with_stdin(args: &[&str], bytes: &[u8]) -> Ran {
    let mut child = command(args)
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .expect("the binary runs");
    let mut stdin = child.stdin.take().unwrap();
    let bytes = bytes.to_vec();
    let writer = std::thread::spawn(move || {
        // A child that has seen enough closes the pipe.
        let _ = stdin.write_all(&bytes);
    });
    let output = child.wait_with_output().unwrap();
    writer.join().unwrap();
    Ran::of(output)
}

pub fn fixture(name: &str) -> PathBuf {
    Path::new("pcap_fixtures").join(name)
}

/// The lines of `--json --no-timing`, parsed.
pub fn sweeps(stdout: &str) -> Vec<serde_json::Value> {
    stdout
        .lines()
        .map(|line| serde_json::from_str(line).expect(line))
        .collect()
}

/// A folder of one test, removed with it.
pub struct Folder(pub TempDir);

impl Folder {
    pub fn new(test: &str) -> Self {
        let prefix = format!("sweepd-cli-{test}-");
        let folder = Builder::new().prefix(&prefix).tempdir();
        Self(folder.unwrap())
    }

    pub fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    pub fn write(&self, name: &str, bytes: impl AsRef<[u8]>) -> PathBuf {
        let path = self.path(name);
        std::fs::write(&path, bytes).unwrap();
        path
    }

    /// Every file below a subfolder with its bytes, by path.
    pub fn files(&self, below: &str) -> Vec<(String, Vec<u8>)> {
        let (mut files, mut folders) = (Vec::new(), vec![self.path(below)]);
        while let Some(folder) = folders.pop() {
            for entry in std::fs::read_dir(&folder).unwrap() {
                let path = entry.unwrap().path();
                if path.is_dir() {
                    folders.push(path);
                } else {
                    let name = path
                        .strip_prefix(self.path(below))
                        .unwrap()
                        .to_str()
                        .unwrap()
                        .to_owned();
                    files.push((name, std::fs::read(&path).unwrap()));
                }
            }
        }
        files.sort();
        files
    }
}
