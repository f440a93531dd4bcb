//! Every way into the program, given inputs that are nearly right: the same functions that the
//! coverage-guided run calls (`tests/fuzz/README.md`), on stable Rust, with a seed that is told and
//! this many rounds.
//!
//! `SWEEPD_FUZZ_SEED` and `SWEEPD_FUZZ_ROUNDS` change seed and rounds; `SWEEPD_FUZZ_INPUT` runs the
//! file of this name and nothing else. An input that fails is written to `target/tmp/fuzz`.

#[path = "fuzz/hostile.rs"]
mod hostile;
#[path = "fuzz/memory.rs"]
mod memory;
#[path = "fuzz/seeds.rs"]
mod seeds;
#[path = "fuzz/targets/mod.rs"]
mod targets;

use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};
use std::{fs, panic, thread};

use fastrand::Rng;
use sweepd_testkit::mutate::mutated;

/// Longest time for one input: in a debug build, on a machine that does other things too.
const PATIENCE: Duration = Duration::from_secs(60);
/// Memory that each byte of an input may take: LZF unpacks to 88 times as many bytes, and points
/// are more than that.
const MEMORY_PER_BYTE: usize = 400;

/// An input under way.
struct Current {
    round: u64,
    input: Vec<u8>,
    begun: Instant,
}

/// Runs a target over what was found before, what is hostile, its seeds, and this many mutations of
/// them; each may take so much memory.
fn fuzz(name: &'static str, rounds: u64, memory_mib: usize) {
    let run = targets::named(name);
    if let Some(path) = std::env::var_os("SWEEPD_FUZZ_INPUT") {
        return run(&fs::read(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display())));
    }
    let (seed, rounds) = (
        number("SWEEPD_FUZZ_SEED", 1),
        number("SWEEPD_FUZZ_ROUNDS", rounds),
    );
    println!("{name}: seed {seed}, {rounds} rounds");
    let seeds = seeds::of(name, sweepd_testkit::data_dir_if_any().as_deref());
    let first = [found(name), hostile::of(name), seeds.clone()].concat();
    let current = Arc::new(Mutex::new(Current {
        round: 0,
        input: Vec::new(),
        begun: Instant::now(),
    }));
    let shared = Arc::clone(&current);
    let worker = thread::spawn(move || {
        let mut rng = Rng::with_seed(seed);
        (0..first.len() as u64 + rounds).try_for_each(|round| {
            let input = match first.get(round as usize) {
                Some(input) => input.clone(),
                None => {
                    let [one, other] = [(); 2].map(|()| rng.usize(..seeds.len()));
                    mutated(&mut rng, &seeds[one], &seeds[other])
                }
            };
            *lock(&shared) = Current {
                round,
                input: input.clone(),
                begun: Instant::now(),
            };
            one(run, &input, memory_mib << 20)
        })
    });
    while !worker.is_finished() {
        thread::sleep(Duration::from_millis(5));
        let now = lock(&current);
        if now.begun.elapsed() > PATIENCE {
            fail(
                name,
                seed,
                &now,
                &format!("it takes longer than {} s", PATIENCE.as_secs()),
            );
        }
    }
    if let Err(message) = worker.join().expect("a failure is a result") {
        fail(name, seed, &lock(&current), &message);
    }
}

/// One input: what it fails with, if it does.
fn one(run: targets::Run, input: &[u8], memory: usize) -> Result<(), String> {
    let before = memory::begin();
    let result = panic::catch_unwind(|| run(input));
    let taken = memory::peak().saturating_sub(before);
    if let Err(cause) = result {
        let text = cause
            .downcast_ref::<String>()
            .map(String::as_str)
            .or(cause.downcast_ref::<&str>().copied());
        return Err(text.unwrap_or("a panic").chars().take(500).collect());
    }
    let most = memory + MEMORY_PER_BYTE * input.len();
    if taken > most {
        Err(format!(
            "it takes {taken} bytes of memory, expected at most {most}"
        ))
    } else {
        Ok(())
    }
}

fn fail(name: &str, seed: u64, current: &Current, message: &str) -> ! {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("fuzz");
    let path = folder.join(format!("{name}-{seed}-{}.bin", current.round));
    let written = fs::create_dir_all(&folder).and_then(|()| fs::write(&path, &current.input));
    let path = written.map_or_else(
        |error| format!("nowhere ({error})"),
        |()| path.display().to_string(),
    );
    panic!(
        "{name}, seed {seed}, round {}: {message}\nthe input of {} bytes is in {path}\nonce more: SWEEPD_FUZZ_INPUT={path} \
         cargo test --test fuzz {name}",
        current.round,
        current.input.len()
    );
}

/// Inputs that once failed.
fn found(name: &str) -> Vec<Vec<u8>> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/fuzz/found");
    let mut paths: Vec<PathBuf> = fs::read_dir(folder)
        .expect("the inputs that once failed")
        .flatten()
        .map(|e| e.path())
        .collect();
    paths.retain(|path| {
        path.file_name()
            .is_some_and(|file| file.to_string_lossy().starts_with(&format!("{name}-")))
    });
    paths.sort();
    paths
        .iter()
        .map(|path| fs::read(path).expect("a file of the project"))
        .collect()
}

fn number(variable: &str, usual: u64) -> u64 {
    let told = std::env::var(variable).ok();
    told.map_or(usual, |told| {
        told.parse()
            .unwrap_or_else(|_| panic!("{variable}={told} is no whole number"))
    })
}

fn lock(current: &Mutex<Current>) -> MutexGuard<'_, Current> {
    current.lock().unwrap_or_else(PoisonError::into_inner)
}

macro_rules! fuzz {
    ($($name:ident: $rounds:literal rounds, $memory:literal MiB;)*) => {
        $(#[test]
        fn $name() {
            fuzz(stringify!($name), $rounds, $memory);
        })*

        #[test]
        fn every_target_is_run() {
            let run = [$(stringify!($name)),*];
            assert_eq!(targets::ALL.map(|(name, _)| name)[..], run[..]);
        }
    };
}

fuzz! {
    data_packet: 2000 rounds, 8 MiB;
    position_packet: 2000 rounds, 8 MiB;
    status_stream: 2000 rounds, 8 MiB;
    capture: 2000 rounds, 32 MiB;
    bag: 2000 rounds, 32 MiB;
    frames: 2000 rounds, 8 MiB;
    frame: 2000 rounds, 8 MiB;
    mender: 2000 rounds, 32 MiB;
    db_xml: 500 rounds, 8 MiB;
    ros_yaml: 500 rounds, 8 MiB;
    config: 2000 rounds, 8 MiB;
    web_page: 2000 rounds, 8 MiB;
    mask: 2000 rounds, 32 MiB;
    rows: 2000 rounds, 8 MiB;
    cloud: 2000 rounds, 8 MiB;
    labels: 500 rounds, 8 MiB;
    pipeline: 120 rounds, 128 MiB;
    sweep: 2000 rounds, 8 MiB;
    cdr: 2000 rounds, 8 MiB;
    control: 2000 rounds, 8 MiB;
    health: 2000 rounds, 8 MiB;
}

#[test]
fn seeds_of_peers_are_understood() {
    use sweepd::daemon::record::protocol::{Reply, Request, SettingsRequest};
    use sweepd::messages::odometry::Located;
    use sweepd::messages::rcl;
    let [names, list, set, odometry, transform] = seeds::of("cdr", None).try_into().unwrap();
    for (service, seed) in [(0, list), (1, names), (4, set)] {
        rcl::Request::read(service, &seed).unwrap();
    }
    assert_eq!(Located::of_odometry(&odometry).unwrap().position_m[1], -2.0);
    let found = Located::of_transforms(&transform, "base_link").unwrap();
    assert_eq!(found.unwrap().rotation, [0.0, 0.0, 0.0, 1.0]);
    let [record, settings, replies @ ..] = &seeds::of("control", None)[..] else {
        panic!("no seeds");
    };
    Request::parse(record).unwrap();
    serde_json::from_slice::<SettingsRequest>(settings).unwrap();
    for reply in replies {
        serde_json::from_slice::<Reply>(reply).unwrap();
    }
}

/// Not a test: writes the seeds of each target to the folder `SWEEPD_FUZZ_CORPUS`, for the
/// coverage-guided run to begin with.
#[test]
#[ignore = "writes files; tests/fuzz/run calls it"]
fn write_seeds() {
    let folder = PathBuf::from(
        std::env::var_os("SWEEPD_FUZZ_CORPUS").expect("SWEEPD_FUZZ_CORPUS, a folder"),
    );
    for (name, _) in targets::ALL {
        let own = folder.join(name);
        fs::create_dir_all(&own).unwrap_or_else(|error| panic!("{}: {error}", own.display()));
        for (index, seed) in found(name)
            .into_iter()
            .chain(seeds::of(
                name,
                sweepd_testkit::data_dir_if_any().as_deref(),
            ))
            .enumerate()
        {
            fs::write(own.join(format!("seed-{index:03}")), seed)
                .unwrap_or_else(|error| panic!("{}: {error}", own.display()));
        }
    }
}
