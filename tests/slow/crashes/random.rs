//! SIGKILL at random times.

use std::process::Command;
use std::time::{Duration, Instant};

use crate::crashes::torn::Torn;
use crate::crashes::{LIMIT, Robot, SETTLE, count, files, no_more};
use sweepd_testkit::{
    Stopwatch,
    setup::{Process, SOON, sweepd},
};

/// Environment variable: how many consumers `random_kills` kills; a fifth as many daemons.
const VARIABLE: &str = "SWEEPD_KILLS";
/// Victims alive at a time, at most.
const VICTIMS: usize = 3;
/// A victim dies at most this long after its start.
const LIVES_MS: u64 = 400;

/// A process, and when it is to be killed.
struct Doomed(Process, Instant);

impl Doomed {
    fn is_due(&self) -> bool {
        self.1 <= Instant::now()
    }
}

fn soon(random: &mut fastrand::Rng) -> Instant {
    Instant::now() + Duration::from_millis(random.u64(0..LIVES_MS))
}

/// A consumer that will be killed: in Rust or, where it was compiled, in C.
fn victim(robot: &Robot, torn: Option<&Torn>) -> Command {
    torn.map_or_else(|| sweepd(&robot.setup.watch_args()), Torn::watch)
}

/// Kills consumers and daemons, and prints what the others saw of it. Those in C and a client in Rust
/// compare all sweeps that they get.
fn kill(consumers: usize, daemons: usize) {
    let _alone = sweepd_testkit::alone();
    let mut random = fastrand::Rng::with_seed(1);
    let mut robot = Robot::start();
    let torn = cfg!(not(without_compilers)).then(|| Torn::start(&robot.setup));
    std::thread::sleep(SETTLE);
    let (begun, before) = (Instant::now(), files(&robot.setup));
    let (mut consumers_left, mut daemons_left) = (consumers, daemons);
    let mut victims: Vec<Doomed> = Vec::new();
    let mut restarts = Vec::new();
    // Of the daemon: its start, when it is to be killed, and whether its first sweeps have come.
    let (mut started, mut dies, mut is_up) = (Stopwatch::start(), Some(soon(&mut random)), true);
    while consumers_left + daemons_left + victims.len() > 0 || !is_up {
        if daemons_left > 0 && dies.is_some_and(|dies| dies <= Instant::now()) {
            robot.daemon.signal("-KILL");
            robot.daemon.wait();
            robot.daemon = robot.setup.daemon();
            daemons_left -= 1;
            // Every other one dies at its start; the others are let live until their sweeps come.
            (started, is_up) = (Stopwatch::start(), false);
            dies = (daemons_left % 2 == 1).then(|| soon(&mut random));
        }
        if !is_up && dies.is_none() {
            if robot.steady.sweep(started.begun, 3).is_some() {
                restarts.push(started.elapsed());
                (is_up, dies) = (true, Some(soon(&mut random)));
            }
            assert!(
                started.begun.elapsed() < SOON,
                "no sweeps after {daemons_left} kills to go: {}",
                robot.logs()
            );
        }
        for index in (0..victims.len())
            .rev()
            .filter(|index| victims[*index].is_due())
            .collect::<Vec<_>>()
        {
            let Doomed(mut victim, _) = victims.swap_remove(index);
            assert!(
                victim.0.try_wait().unwrap().is_none(),
                "a consumer ended by itself: {}",
                robot.logs()
            );
            victim.0.kill().unwrap();
            victim.wait();
        }
        if victims.len() < VICTIMS - usize::from(dies.is_some()) && consumers_left > 0 {
            let is_c = consumers_left % 2 == 0;
            let mut command = victim(&robot, torn.as_ref().filter(|_| is_c));
            command.stdout(std::process::Stdio::null());
            victims.push(Doomed(
                Process::spawn(command, &robot.setup.path("watch.log")),
                soon(&mut random),
            ));
            consumers_left -= 1;
        }
        std::thread::sleep(Duration::from_millis(2));
    }
    robot
        .check(Stopwatch::start())
        .unwrap_or_else(|error| panic!("{error}; {}", robot.logs()));
    let after = no_more(&before, &robot.setup).unwrap();
    let compared = torn.map_or(0, Torn::end);
    let times: Vec<Instant> = robot
        .steady
        .times()
        .into_iter()
        .filter(|time| *time >= begun)
        .collect();
    let gap = times.windows(2).map(|two| two[1] - two[0]).max().unwrap();
    restarts.sort();
    let (median, slowest) = (restarts[restarts.len() / 2], restarts[restarts.len() - 1]);
    eprintln!(
        "{consumers} consumers and {daemons} daemons killed in {:.0?}; sweeps of a restarted daemon after {median:.0?} \
         (median), {slowest:.0?} (at most); the steady consumer got {} sweeps, its longest gap is {gap:.0?}; {compared} sweeps \
         are the same in C and Rust; files {} before, {} after",
        begun.elapsed(),
        times.len(),
        count(&before),
        count(&after),
    );
    assert!(
        slowest <= LIMIT,
        "a restart took {slowest:?}: {}",
        robot.logs()
    );
    robot.end().unwrap();
}

#[test]
fn fifty_random_kills_leave_the_others_going_and_nothing_behind() {
    kill(40, 10);
}

#[test]
#[ignore = "takes minutes: 1000 consumers and 200 daemons, or as many as SWEEPD_KILLS says"]
fn random_kills() {
    let consumers = std::env::var(VARIABLE).map_or(1000, |kills| {
        kills.parse().expect("SWEEPD_KILLS is a number")
    });
    kill(consumers, consumers / 5);
}
