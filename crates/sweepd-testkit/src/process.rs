//! A child process, and the end of its log.

use std::collections::VecDeque;
use std::io::{self, BufRead, BufReader};
use std::process::{Child, ChildStderr, Command, ExitStatus, Stdio};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread;
use std::time::{Duration, Instant};

use rustix::process::{Pid, Signal, kill_process};

use super::{Failure, cannot, pool};

/// Time limit, longer than a healthy program needs on a busy machine to start, to answer, or to
/// end.
pub const PATIENCE: Duration = Duration::from_secs(60);
/// Time limit for a process that closed its sockets to end and complete its log.
const DYING: Duration = Duration::from_millis(500);
/// Lines of the log that are kept.
const KEPT_LINES: usize = 1_000;
/// Lines of the log in a [`Failure`].
const SHOWN_LINES: usize = 40;
const POLL: Duration = Duration::from_millis(2);

/// A child process with its standard error as a log. It is killed when it is dropped.
#[derive(Debug)]
pub struct Process {
    /// The process. Its standard output is there if the command asked for it.
    pub child: Child,
    log: Arc<Mutex<Log>>,
}

/// The last lines of a log.
#[derive(Debug, Default)]
struct Log {
    lines: VecDeque<String>,
    /// Lines before those.
    forgotten: usize,
    is_complete: bool,
}

impl Process {
    /// Starts a program without standard input.
    ///
    /// # Errors
    /// The system refuses.
    pub fn start(command: &mut Command) -> io::Result<Self> {
        pool::share();
        let mut child = command
            .stdin(Stdio::null())
            .stderr(Stdio::piped())
            .spawn()?;
        let log = Arc::<Mutex<Log>>::default();
        if let Some(stderr) = child.stderr.take() {
            let log = Arc::clone(&log);
            thread::spawn(move || read_log(stderr, &log));
        }
        Ok(Self { child, log })
    }

    /// Sends it a signal.
    ///
    /// # Errors
    /// The system refuses.
    pub fn signal(&self, signal: Signal) -> io::Result<()> {
        // The child has not been waited for, so its number still belongs to it.
        Ok(kill_process(Pid::from_child(&self.child), signal)?)
    }

    /// Waits until `is_so`.
    ///
    /// # Errors
    /// It ended before, or `limit` passed; `what` says what was awaited.
    pub fn until(
        &mut self,
        limit: Duration,
        what: &str,
        mut is_so: impl FnMut(&Self) -> bool,
    ) -> Result<(), Failure> {
        let begun = Instant::now();
        while !is_so(self) {
            if let Ok(Some(status)) = self.child.try_wait() {
                return Err(self.failure(format!("it ended ({status}) before {what}")));
            }
            if begun.elapsed() > limit {
                return Err(self.failure(format!("{limit:?} passed before {what}")));
            }
            thread::sleep(POLL);
        }
        Ok(())
    }

    /// Waits for its end.
    ///
    /// # Errors
    /// It does not end within `limit`.
    pub fn wait(&mut self, limit: Duration) -> Result<ExitStatus, Failure> {
        let begun = Instant::now();
        loop {
            match self
                .child
                .try_wait()
                .map_err(cannot("wait for a process"))?
            {
                Some(status) => return Ok(status),
                None if begun.elapsed() < limit => thread::sleep(POLL),
                None => return Err(self.failure(format!("it does not end within {limit:?}"))),
            }
        }
    }

    /// Ends it with SIGTERM.
    ///
    /// # Errors
    /// It does not end within `limit`, or not with exit code 0.
    pub fn end(&mut self, limit: Duration) -> Result<(), Failure> {
        self.signal(Signal::TERM)
            .map_err(cannot("signal a process"))?;
        let status = self.wait(limit)?;
        if status.success() {
            Ok(())
        } else {
            Err(self.failure(format!("it was asked to end, and did so with {status}")))
        }
    }

    /// The last lines of its log.
    pub fn log(&self) -> String {
        self.lines()
            .lines
            .iter()
            .map(|line| line.clone() + "\n")
            .collect()
    }

    /// How many lines the log has by now.
    pub fn log_lines(&self) -> usize {
        let log = self.lines();
        log.forgotten + log.lines.len()
    }

    /// How many lines with `text` the log has after its first `lines` lines.
    pub fn logged_after(&self, lines: usize, text: &str) -> usize {
        let log = self.lines();
        let after = lines.saturating_sub(log.forgotten);
        let new = log.lines.iter().skip(after);
        new.filter(|line| line.contains(text)).count()
    }

    /// `what`, whether the process has ended, and the end of its log.
    pub fn failure(&mut self, mut what: String) -> Failure {
        // A process that dies closes its sockets some time before it can be waited for.
        let begun = Instant::now();
        while !self.lines().is_complete && begun.elapsed() < DYING {
            thread::sleep(POLL);
        }
        if let Ok(Some(status)) = self.child.try_wait() {
            what += &format!(" (it has ended, {status})");
        }
        let log = self.log();
        let first_shown = log.lines().count().saturating_sub(SHOWN_LINES);
        if !log.is_empty() {
            what += "; it said last:";
        }
        for line in log.lines().skip(first_shown) {
            what += &format!("\n{line}");
        }
        Failure(what)
    }

    fn lines(&self) -> MutexGuard<'_, Log> {
        self.log.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

fn read_log(stderr: ChildStderr, log: &Mutex<Log>) {
    for line in BufReader::new(stderr).lines().map_while(Result::ok) {
        let mut log = log.lock().unwrap_or_else(PoisonError::into_inner);
        log.lines.push_back(line);
        if log.lines.len() > KEPT_LINES {
            log.lines.pop_front();
            log.forgotten += 1;
        }
    }
    log.lock()
        .unwrap_or_else(PoisonError::into_inner)
        .is_complete = true;
}

#[cfg(test)]
mod tests {
    use super::*;

    fn shell(script: &str) -> Process {
        Process::start(Command::new("sh").args(["-c", script])).unwrap()
    }

    #[test]
    fn lines_are_counted_after_a_position_and_shown_with_a_failure() {
        let mut process = shell("echo first >&2; echo second >&2; exec sleep 60");
        process
            .until(PATIENCE, "it has said both", |one| one.log_lines() == 2)
            .unwrap();
        assert_eq!(process.logged_after(0, "first"), 1);
        assert_eq!(process.logged_after(1, "first"), 0);
        let failure = process.end(PATIENCE).unwrap_err().to_string();
        assert!(
            failure.ends_with("(it has ended, signal: 15 (SIGTERM)); it said last:\nfirst\nsecond"),
            "{failure}"
        );
    }

    #[test]
    fn only_the_last_lines_are_kept() {
        let mut process = shell("seq 1 3000 >&2");
        assert!(process.wait(PATIENCE).unwrap().success());
        let begun = Instant::now();
        while process.log_lines() < 3000 && begun.elapsed() < PATIENCE {
            thread::sleep(POLL);
        }
        let failure = process.failure("numbers".to_owned()).to_string();
        assert!(failure.ends_with("\n2999\n3000"), "{failure}");
        assert_eq!(process.log_lines(), 3000);
        assert_eq!(process.log().lines().count(), KEPT_LINES);
        assert_eq!(process.logged_after(2998, "000"), 1);
    }
}
