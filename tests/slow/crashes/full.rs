//! /dev/shm without room, in a namespace of the test's own: an error that says what is missing, and
//! no signal.

use std::fs;

use crate::resource::world::{World, binary};
use sweepd_testkit::{python_package, python_with_numpy};

/// Room that is left, KiB.
const LEFT_KIB: [u32; 5] = [0, 4, 8, 16, 64];
/// What an error about memory holds.
const PARTS: [&str; 4] = ["/dev/shm has", "bytes free", "needed", " more"];

/// A script that fills /dev/shm but for this room; again, if what an ended program held was given
/// back meanwhile.
fn fill(left_kib: u32) -> String {
    format!(
        "free() {{ df --output=avail -k /dev/shm | tail -1; }}\n\
         for attempt in $(seq 100); do\n\
         dd if=/dev/zero of=/dev/shm/other bs=4k 2>/dev/null || true\n\
         truncate -s -{left_kib}K /dev/shm/other\n\
         sleep 0.2\n\
         if [ $(free) = {left_kib} ]; then break; fi\n\
         done\n\
         test $(free) = {left_kib}\n"
    )
}

/// A script that runs a program with this room and writes its exit code and words to the test's
/// folder.
fn run_full(world: &World, program: &str, left_kib: u32) -> String {
    let folder = world.folder().display();
    format!(
        "{}code=0\ntimeout 60 {program} >/dev/null 2>{folder}/said || code=$?\necho $code > {folder}/code\nrm /dev/shm/other\n",
        fill(left_kib)
    )
}

/// The exit code and the words of the program that ran without room.
fn outcome(world: &World) -> (i32, String) {
    let read = |name| fs::read_to_string(world.folder().join(name)).unwrap_or_default();
    (read("code").trim().parse().unwrap_or(-1), read("said"))
}

fn says_what_is_missing(said: &str) -> bool {
    said.lines()
        .last()
        .is_some_and(|line| PARTS.iter().all(|part| line.contains(part)))
}

#[test]
#[cfg_attr(without_root, ignore = "not root, or no namespaces")]
fn a_daemon_without_shared_memory_says_so_and_starts_when_there_is_some() {
    let mut faults = Vec::new();
    for left_kib in LEFT_KIB {
        let mut world = World::new();
        world.configure("model = \"vlp16\"", "");
        let run = format!(
            "{} run --config {}/sweepd.toml",
            binary(),
            world.folder().display()
        );
        let script = format!(
            "mount -t tmpfs -o size=64m none /dev/shm\n{}",
            run_full(&world, &run, left_kib)
        );
        // The daemon of the world starts after it, with room again.
        world.start(&["-m"], &script);
        let mut until = 0;
        while world.says("waiting for packets") == 0 && until < 600 {
            std::thread::sleep(std::time::Duration::from_millis(100));
            until += 1;
        }
        let (code, said) = outcome(&world);
        if code != 1 || !says_what_is_missing(&said) {
            faults.push(format!("{left_kib} KiB free: exit code {code}: {said}"));
        }
        if world.says("waiting for packets") == 0 {
            faults.push(format!(
                "{left_kib} KiB free before: no start with 64 MiB: {}",
                world.log()
            ));
        }
    }
    assert!(faults.is_empty(), "{}", faults.join("\n"));
}

/// Runs a consumer, which ends after a sweep, beside a daemon, without room and then with room.
fn consume(name: &str, program: impl Fn(&World) -> String) {
    let mut world = World::new();
    world.configure("model = \"vlp16\"", "");
    world.start(&["-m"], "mount -t tmpfs -o size=64m none /dev/shm");
    world.until_it_says("waiting for packets");
    world.simulate(120.0);
    world.until_health(200, "streaming");
    let program = program(&world);
    let mut faults = Vec::new();
    for left_kib in LEFT_KIB {
        world.inside(&run_full(&world, &program, left_kib));
        let (code, said) = outcome(&world);
        let is_told = code == 1 && says_what_is_missing(&said);
        if !is_told && (code != 0 || left_kib == 0) {
            faults.push(format!(
                "{name}, {left_kib} KiB free: exit code {code}: {said}"
            ));
        }
        world.inside(&format!("timeout 60 {program} >/dev/null"));
    }
    world.until_health(200, "streaming");
    world.signal("-TERM");
    assert_eq!(world.end().code(), Some(0), "{}", world.log());
    assert!(faults.is_empty(), "{}", faults.join("\n"));
}

#[test]
#[cfg_attr(without_root, ignore = "not root, or no namespaces")]
fn a_rust_consumer_without_shared_memory_says_so() {
    consume("sweepd watch", |world| {
        format!(
            "{} watch roof --root {} --sweeps 1 --timeout 50",
            binary(),
            world.root().display()
        )
    });
}

#[test]
#[cfg_attr(
    any(without_python, without_root),
    ignore = "no SWEEPD_PYTHON, not root, or no namespaces"
)]
fn a_python_consumer_without_shared_memory_says_so() {
    let python = python_with_numpy();
    let python = python.to_str().unwrap();
    let [(path, package), (variable, library)] = python_package();
    let (package, library) = (package.display(), library.display());
    consume("the Python package", |world| {
        format!(
            "env {path}={package} {variable}={library} {python} -c 'import sweepd; next(sweepd.Client(\"roof\", \"{}\"))'",
            world.root().display()
        )
    });
}
