//! SIGKILL at calls by which a program makes, fills, names or removes a file, with strace(1): at every
//! eighth, or at all.

use std::collections::HashMap;
use std::os::unix::process::ExitStatusExt;
use std::process::{Command, ExitStatus};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::{Duration, Instant};
use std::{fmt, fs};

use crate::crashes::{Files, LIMIT, Robot, SETTLE, files, no_more};
use sweepd_testkit::{
    Stopwatch, cases,
    domain::clear,
    setup::{Process, SOON, Setup, Watch, sweepd},
};

/// The calls; not every machine has those with a question mark.
const CALLS: &str = "openat,ftruncate,fchmod,?fchmodat,?chmod,write,?rename,?renameat,renameat2,bind,?unlink,unlinkat,\
                     fallocate,?mkdir,mkdirat";
/// Kills after which the files are counted for the first time.
const FEW: usize = 5;
/// After this many faults the rest would only take time.
const FAULTS: usize = 3;

#[derive(Clone, Copy, Debug, PartialEq)]
enum Victim {
    Consumer,
    /// A daemon that finds what the one before and its consumer left.
    Daemon,
    /// A daemon that finds nothing, as after boot.
    FirstDaemon,
}

impl Victim {
    fn args(self, setup: &Setup) -> Vec<&str> {
        match self {
            Self::Consumer => [&setup.watch_args()[..], &["--json"]].concat(),
            Self::Daemon | Self::FirstDaemon => setup.daemon_args().to_vec(),
        }
    }

    /// How long it runs at least until it is told to end.
    fn lives(self) -> Duration {
        Duration::from_millis(if self == Self::Consumer { 500 } else { 1000 })
    }

    /// What it says when it has done all that it does at its start.
    fn says(self) -> &'static str {
        match self {
            Self::Consumer => "\"sequence\"",
            Self::Daemon | Self::FirstDaemon => ": streaming,",
        }
    }
}

/// A call of a victim.
#[derive(Debug)]
struct Point {
    /// What the name of its thread begins with; `None` for the first thread.
    thread: Option<String>,
    call: String,
    /// How many such calls of this thread it is, from 1 on.
    number: usize,
    /// Ending of the name of its file, for messages.
    kind: String,
}

impl fmt::Display for Point {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self {
            thread,
            call,
            number,
            kind,
        } = self;
        let thread = thread.as_deref().unwrap_or("the first thread");
        write!(f, "{call} number {number} of {thread}, on a file .{kind}")
    }
}

/// Starts a program that says all to a log of its own.
fn start(setup: &Setup, mut command: Command) -> Process {
    let log = setup.path("victim.log");
    command.stdout(fs::File::create(&log).unwrap());
    Process::spawn(command, &log)
}

/// `sweepd` as the child of this process, with strace beside it.
fn traced(setup: &Setup, victim: Victim, strace: &[&str]) -> Process {
    let mut command = Command::new("strace");
    command
        .args([
            "-D",
            "-f",
            "-Y",
            "-y",
            "-o",
            setup.path("strace").to_str().unwrap(),
        ])
        .args(strace);
    command
        .arg(env!("CARGO_BIN_EXE_sweepd"))
        .args(victim.args(setup));
    start(setup, command)
}

/// Lets a victim live; its end, if it comes before its time.
fn live(setup: &Setup, victim: Victim, process: &mut Process) -> Option<ExitStatus> {
    let begun = Instant::now();
    let is_up = || {
        let log = fs::read_to_string(setup.path("victim.log"));
        log.is_ok_and(|log| log.contains(victim.says()))
    };
    let mut ended = process.ends_within(victim.lives());
    while ended.is_none() && !is_up() && begun.elapsed() < SOON {
        ended = process.ends_within(Duration::from_millis(20));
    }
    ended
}

/// Waits until a program handles SIGTERM, or has ended: before, the signal would kill it.
fn until_it_can_be_told(process: &mut Process) {
    let path = format!("/proc/{}/status", process.0.id());
    let (begun, is_sigterm) = (Instant::now(), 1_u64 << 14);
    while process.0.try_wait().unwrap().is_none() && begun.elapsed() < SOON {
        let status = fs::read_to_string(&path).unwrap_or_default();
        let of = |name| status.lines().find_map(|line| line.strip_prefix(name));
        let handled = of("SigCgt:").and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok());
        // Until it becomes the program it is strace.
        let is_itself = of("Name:").is_some_and(|name| name.trim() == "sweepd");
        if is_itself && handled.is_some_and(|mask| mask & is_sigterm != 0) {
            return;
        }
        std::thread::sleep(Duration::from_millis(5));
    }
}

/// All calls of a victim from its start to its end, in their order.
fn points(robot: &Robot, victim: Victim) -> Vec<Point> {
    let mut process = traced(&robot.setup, victim, &["-e", &format!("trace={CALLS}")]);
    let first = process.0.id().to_string();
    live(&robot.setup, victim, &mut process);
    until_it_can_be_told(&mut process);
    process.ends_when_told().unwrap();
    // strace writes until a moment later.
    let (own, begun) = (format!("{first}<"), Instant::now());
    let text = loop {
        let text = fs::read_to_string(robot.setup.path("strace")).unwrap();
        let is_end = |line: &str| line.starts_with(&own) && line.contains("+++ exited");
        if text.lines().any(is_end) {
            break text;
        }
        assert!(begun.elapsed() < SOON, "strace does not end: {text}");
        std::thread::sleep(Duration::from_millis(10));
    };
    let (mut numbers, mut points) = (HashMap::<(&str, &str), usize>::new(), Vec::new());
    for line in text.lines() {
        // PID<NAME OF THE THREAD> CALL(...
        let Some((of, call)) = line.split_once("> ") else {
            continue;
        };
        let Some((pid, thread)) = of.split_once('<') else {
            continue;
        };
        let Some((name, arguments)) = call.split_once('(') else {
            continue;
        };
        if !name.bytes().all(|byte| byte.is_ascii_alphanumeric()) {
            continue;
        }
        let number = numbers.entry((pid, name)).or_default();
        *number += 1;
        // What is opened without being made, and what is printed, leaves nothing behind.
        let is_harmless = name == "openat" && !arguments.contains("O_CREAT")
            || name == "write" && (arguments.starts_with("1<") || arguments.starts_with("2<"));
        if !is_harmless {
            // Behind the space stands the number of a port.
            let thread = (pid != first).then(|| thread.split(' ').next().unwrap().to_owned());
            // A descriptor has its path behind it, in brackets; else the path is the first text.
            let is_descriptor = arguments.starts_with(|first: char| first.is_ascii_digit());
            let path = if is_descriptor {
                arguments.split(['<', '>']).nth(1)
            } else {
                arguments.split('"').nth(1)
            };
            let kind = path
                .and_then(|path| path.rsplit(['.', '/']).next())
                .unwrap_or_default()
                .to_owned();
            points.push(Point {
                thread,
                call: name.to_owned(),
                number: *number,
                kind,
            });
        }
    }
    points
}

/// Stops the process $1 as soon as a thread whose name begins with $2 is there, and lets strace,
/// with the rest of the arguments, see all that this thread does. strace counts the calls of each
/// thread alone.
const CATCH: &str = "pid=$1 name=$2; shift 2
    while [ -d /proc/$pid/task ]; do
        for task in /proc/$pid/task/*; do
            read -r found < $task/comm || continue
            case $found in \"$name\"*) ;; *) continue ;; esac
            kill -STOP $pid
            strace -p ${task##*/} \"$@\" &
            until grep -q 'TracerPid:.*[1-9]' $task/status; do :; done
            kill -CONT $pid
            wait
            exit
        done
    done";

/// Starts a victim that is killed when it comes to a point; gives whether it was.
fn strike(setup: &Setup, victim: Victim, point: &Point) -> Result<bool, String> {
    let Point {
        thread,
        call,
        number,
        ..
    } = point;
    let trace = [
        "-e",
        &format!("trace={call}"),
        "-e",
        &format!("inject={call}:signal=SIGKILL:when={number}"),
    ];
    let mut _catcher = None;
    let mut process = match thread {
        None => traced(setup, victim, &trace),
        Some(name) => {
            let process = start(setup, sweepd(&victim.args(setup)));
            let mut command = Command::new("sh");
            command
                .args([
                    "-c",
                    CATCH,
                    "catch",
                    &process.0.id().to_string(),
                    name,
                    "-o",
                    "/dev/null",
                ])
                .args(trace);
            _catcher = Some(Process::spawn(command, &setup.path("catch.log")));
            process
        }
    };
    let ended = live(setup, victim, &mut process).or_else(|| {
        until_it_can_be_told(&mut process);
        process.signal("-TERM");
        let told = Stopwatch::start();
        process.ends_within(SOON).filter(|_| told.elapsed() < LIMIT)
    });
    let Some(status) = ended else {
        return Err(format!("it still runs {LIMIT:?} after SIGTERM"));
    };
    match status.signal() {
        Some(9) => Ok(true),
        None if status.success() => Ok(false),
        _ => Err(format!("it ended with {status}")),
    }
}

/// Ends those of whom the victim takes the place.
fn make_room(robot: &mut Robot, victim: Victim) -> Result<(), String> {
    if victim != Victim::Consumer {
        robot
            .daemon
            .ends_when_told()
            .map_err(|error| format!("the daemon before it {error}"))?;
    }
    if victim == Victim::FirstDaemon {
        robot
            .steady
            .process
            .ends_when_told()
            .map_err(|error| format!("the consumer before it {error}"))?;
        clear(&robot.setup.domain());
    }
    Ok(())
}

/// The kills of one daemon, its consumer and their files.
struct Round {
    robot: Robot,
    kills: usize,
    files_after_few: Option<Files>,
}

impl Round {
    fn start() -> Self {
        Self {
            robot: Robot::start(),
            kills: 0,
            files_after_few: None,
        }
    }

    fn kill(&mut self, victim: Victim, point: &Point) -> Result<(), String> {
        let robot = &mut self.robot;
        make_room(robot, victim)?;
        self.kills += usize::from(strike(&robot.setup, victim, point)?);
        let since = Stopwatch::start();
        if victim != Victim::Consumer {
            robot.daemon = robot.setup.daemon();
        }
        if victim == Victim::FirstDaemon {
            robot.steady = Watch::start(&robot.setup);
            robot.check_with(since, 1)?;
        } else {
            robot.check(since)?;
        }
        if self.kills >= FEW && self.files_after_few.is_none() {
            std::thread::sleep(SETTLE);
            self.files_after_few = Some(files(&robot.setup));
        }
        Ok(())
    }

    fn end(self) -> Result<(), String> {
        if let Some(few) = self.files_after_few {
            no_more(&few, &self.robot.setup)?;
        }
        self.robot.end()
    }
}

/// Kills a victim at its calls: at all in this many rounds side by side, at an eighth in one.
fn kill_everywhere(victim: Victim, rounds: usize) {
    // With fewer kills each, their files would not be compared.
    let rounds = if cases::are_all() { rounds } else { 1 };
    let points: Vec<Point> = {
        let mut robot = Robot::start();
        make_room(&mut robot, victim).unwrap();
        let all = points(&robot, victim);
        assert!(all.len() > 30, "only {all:?}");
        let numbered = (0..).zip(all);
        numbered
            .filter(|(number, _)| cases::has(*number))
            .map(|(_, point)| point)
            .collect()
    };
    assert!(points.len() > FEW, "files are compared: {points:?}");
    let killed = AtomicUsize::new(0);
    let faults = std::thread::scope(|scope| {
        let (points, killed) = (&points, &killed);
        let of_round = |number| {
            let mut faults = Vec::new();
            let mut round = Round::start();
            for point in points.iter().skip(number).step_by(rounds) {
                if let Err(error) = round.kill(victim, point) {
                    faults.push(format!(
                        "{victim:?} killed before {point}: {error}\n{}",
                        round.robot.logs()
                    ));
                    killed.fetch_add(round.kills, Ordering::Relaxed);
                    round = Round::start();
                }
                if faults.len() == FAULTS {
                    return faults;
                }
            }
            killed.fetch_add(round.kills, Ordering::Relaxed);
            faults.extend(round.end().err());
            faults
        };
        let threads: Vec<_> = (0..rounds)
            .map(|number| scope.spawn(move || of_round(number)))
            .collect();
        threads
            .into_iter()
            .flat_map(|thread| thread.join().unwrap())
            .collect::<Vec<_>>()
    });
    let killed = killed.into_inner();
    eprintln!("{victim:?}: {killed} kills, at {} calls", points.len());
    assert!(faults.is_empty(), "{}", faults.join("\n\n"));
    // The number of some calls depends on time: a few of the last are not reached again.
    assert!(
        (killed + 1) * 10 >= points.len() * 8,
        "only {killed} of {} kills took place",
        points.len()
    );
}

#[test]
fn a_consumer_killed_at_any_call_leaves_the_others_going() {
    kill_everywhere(Victim::Consumer, 2);
}

#[test]
fn a_first_daemon_killed_at_any_call_is_replaced_by_the_next_within_two_seconds() {
    kill_everywhere(Victim::FirstDaemon, 3);
}

#[test]
fn a_daemon_killed_at_any_call_is_replaced_by_the_next_within_two_seconds() {
    kill_everywhere(Victim::Daemon, 3);
}
