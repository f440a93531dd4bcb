//! `sweepd-db3`: reads a database of rosbag2 for `sweepd`, which starts it. SQLite is in C, and a
//! file may come from anybody: here it can neither crash the driver nor take its memory.

#![forbid(unsafe_code)]

mod database;

use std::io::{self, BufWriter, IsTerminal, Write};
use std::path::PathBuf;
use std::process::ExitCode;
use std::thread;

use clap::Parser;
use rustix::event::{PollFd, PollFlags, poll};
use rustix::process::{Resource, getrlimit, setrlimit};
use sweepd::cli::Exit;
use sweepd::input::db3::End;

/// The most address space that this process may take, bytes.
const MAX_MEMORY: u64 = 512 << 20;

/// Reads a database of rosbag2 (.db3) for sweepd, and writes its scans to standard output
///
/// A database of rosbag2 is a file of SQLite. This program reads it in a process of its own, so
/// that a damaged or hostile file harms nothing else: it takes at most 512 MB of memory, and
/// changes no file. You need not call it: `sweepd replay FILE.db3` and each other command that
/// reads a capture start it.
#[derive(Parser)]
#[command(name = "sweepd-db3", version = sweepd::VERSION, max_term_width = 100)]
struct Args {
    /// The database
    file: PathBuf,
}

fn main() -> ExitCode {
    let args = Args::parse();
    let file = args.file.display();
    if io::stdout().is_terminal() {
        complain(format_args!(
            "its output is not text, and is not written to a terminal; `sweepd inspect {file}` says what is in the file"
        ));
        return ExitCode::from(2);
    }
    if let Err(error) = limit_memory() {
        complain(format_args!("cannot limit its memory: {error}"));
        return ExitCode::FAILURE;
    }
    thread::spawn(leave_with_reader);
    let mut out = BufWriter::new(io::stdout().lock());
    match database::send(&args.file, &mut out) {
        Ok(End::Whole) => ExitCode::SUCCESS,
        Ok(End::Cut) => failed(format_args!("{file} is cut short")),
        Ok(End::Damaged(why)) => failed(format_args!("{file}: SQLite says: {why}")),
        Ok(End::Refused(why) | End::Failed(why)) => {
            let code = failed(format_args!("{file}: {why}"));
            match args.file.is_file() {
                true => code,
                false => ExitCode::from(Exit::NoInput as u8),
            }
        }
        // The reader has gone.
        Err(error) if error.kind() == io::ErrorKind::BrokenPipe => ExitCode::SUCCESS,
        Err(error) => failed(format_args!("cannot write to standard output: {error}")),
    }
}

fn failed(what: std::fmt::Arguments<'_>) -> ExitCode {
    complain(what);
    ExitCode::FAILURE
}

/// Prints a line on standard error. If that is closed, the message is lost.
fn complain(what: std::fmt::Arguments<'_>) {
    let _ = writeln!(io::stderr(), "sweepd-db3: {what}");
}

/// Lowers the limit of this process: what SQLite asks for beyond it, it does not get.
fn limit_memory() -> io::Result<()> {
    let mut limit = getrlimit(Resource::As);
    let lower = |old: Option<u64>| Some(old.map_or(MAX_MEMORY, |old| old.min(MAX_MEMORY)));
    limit.current = lower(limit.current);
    limit.maximum = lower(limit.maximum);
    Ok(setrlimit(Resource::As, limit)?)
}

/// Ends this process when the other end of its output is closed, also while SQLite computes.
fn leave_with_reader() {
    let out = io::stdout();
    loop {
        let mut ends = [PollFd::new(&out, PollFlags::empty())];
        // Nothing is asked for but what is always told: that the other end has gone.
        if poll(&mut ends, None).is_ok() && !ends[0].revents().is_empty() {
            std::process::exit(0);
        }
    }
}
