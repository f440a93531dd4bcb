//! Databases with a few wrong bytes: whatever is in them, the program comes to its end, and SQLite
//! does not crash it.

use fastrand::Rng;
use sweepd_testkit::{Stopwatch, mutate::mutated};

use super::*;

const ROUNDS: u64 = 300;
const SEED: u64 = 1;

#[test]
fn a_database_with_wrong_bytes_is_read_or_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("seed.db3");
    write_seed(&path);
    let seed = fs::read(&path).unwrap();
    let mut rng = Rng::with_seed(SEED);
    let mut whole = 0;
    for round in 0..ROUNDS {
        let input = mutated(&mut rng, &seed, &seed);
        fs::write(&path, &input).unwrap();
        let begun = Stopwatch::start();
        let outcome = outcome(&path);
        let says = outcome
            .as_ref()
            .map_or_else(Clone::clone, ToString::to_string);
        let is_sound = begun.elapsed() < PATIENCE && !says.contains("before its time");
        whole += u64::from(says == "10");
        if !is_sound {
            let kept = Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("database-{round}.db3"));
            fs::write(&kept, &input).unwrap();
            panic!("round {round}: {says}; the file is {}", kept.display());
        }
    }
    // Many a wrong byte is in a part that nobody reads; not in all.
    assert!((1..ROUNDS / 2).contains(&whole), "{whole} of {ROUNDS}");
}

fn write_seed(path: &Path) {
    let topics = [("/left", SCAN), ("/chatter", "std_msgs/msg/String")];
    let messages = [
        (0, cdr(&[(5, 0xFF); 8], false)),
        (1, vec![1; 6000]),
        (0, cdr(&[(6, 0xFF); 2], true)),
    ];
    database(path, &topics, &messages);
}

/// Not a test: writes the seed to the folder `SWEEPD_FUZZ_CORPUS`, for the coverage-guided run to
/// begin with.
#[test]
#[ignore = "writes a file; tests/fuzz/run calls it"]
fn write_seeds() {
    let folder = std::env::var_os("SWEEPD_FUZZ_CORPUS").expect("SWEEPD_FUZZ_CORPUS, a folder");
    let folder = Path::new(&folder).join("database");
    fs::create_dir_all(&folder).unwrap();
    let path = folder.join("seed");
    let _ = fs::remove_file(&path);
    write_seed(&path);
}

/// The number of packets, or the error.
fn outcome(path: &Path) -> Result<usize, String> {
    let mut capture = open(path).map_err(|error| error.to_string())?;
    let mut packets = 0;
    while let Some(datagram) = capture.next_datagram().map_err(|error| error.to_string())? {
        assert_eq!(datagram.payload.len(), 1206);
        packets += 1;
    }
    match capture.truncation() {
        Some(truncation) => Err(truncation.to_string()),
        None => Ok(packets),
    }
}
