//! The fault matrix: every fault that the simulator can inject, at several rates, for every model,
//! and what must hold.
//!
//! ```text
//! cargo test --release --test it matrix -- --ignored --nocapture
//! ```
//!
//! prints all rows; with `SWEEPD_MATRIX=WORD` in the environment, those with the word in the name
//! of the fault or of the model. Each row is one stream with truth, through admission and the
//! pipeline. In every row: no panic; every return that is published lies where it really was; a
//! decoded packet is decoded whole, and every other one is counted; a whole sweep has no hole that
//! it does not tell; the counters are what was injected; every segment of every sweep is told once,
//! with its sweep or before, and interrupted sweeps are told as such; and one revolution after the
//! fault ends, sweeps are whole again.

mod cases;
mod check;
mod stream;
mod table;

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Instant;

use self::cases::{Case, cases};
use self::stream::{KINDS, Kind, Stock};
use self::table::Row;
use sweepd::sensor::Model::{Hdl32e, Hdl64eS2, Hdl64eS3, Vlp16, Vlp32c, Vls128};
use sweepd::wire::data::ReturnMode::{Dual, Strongest};

/// One cell: its row, red if something does not hold.
fn cell(case: &Case, kind: Kind, stock: &Stock) -> Row {
    let row = Row {
        fault: case.fault,
        rate: case.rate.clone(),
        kind,
        ..Row::default()
    };
    let run = || {
        let made = (case.make)(stock);
        check::check(&made, row.clone())
    };
    catch_unwind(AssertUnwindSafe(run)).unwrap_or_else(|panic| {
        let said = panic
            .downcast_ref::<String>()
            .map(String::as_str)
            .or(panic.downcast_ref::<&str>().copied());
        Row {
            red: vec![format!("panic: {}", said.unwrap_or("?"))],
            ..row.clone()
        }
    })
}

/// All cells of these kinds that are wanted, on two threads, in the order of the cases.
fn rows(kinds: &[Kind], is_wanted: impl Fn(&Case, Kind) -> bool + Sync) -> Vec<Row> {
    let (next, rows) = (AtomicUsize::new(0), Mutex::new(Vec::new()));
    let work = || {
        while let Some(&kind) = kinds.get(next.fetch_add(1, Ordering::Relaxed)) {
            let stock = Stock::new(kind);
            for (index, case) in cases().iter().enumerate() {
                if (case.fits)(kind) && is_wanted(case, kind) {
                    let row = cell(case, kind, &stock);
                    // What is wrong is seen at once, and once more in the table.
                    if !row.red.is_empty() {
                        eprintln!("{}", table::line(&row));
                    }
                    rows.lock().unwrap().push((
                        index,
                        KINDS.iter().position(|&one| one == kind),
                        row,
                    ));
                }
            }
        }
    };
    std::thread::scope(|scope| (0..2).for_each(|_| drop(scope.spawn(work))));
    let mut rows = rows.into_inner().unwrap();
    rows.sort_by_key(|&(case, kind, _)| (case, kind));
    rows.into_iter().map(|(.., row)| row).collect()
}

/// Prints the rows, and fails if one is red.
fn judge(rows: &[Row], begun: Instant) {
    println!("{}", table::print(rows));
    let red = rows.iter().filter(|row| !row.red.is_empty()).count();
    println!(
        "{} rows, {red} red, {:.1} s",
        rows.len(),
        begun.elapsed().as_secs_f64()
    );
    assert!(red == 0, "{red} of {} rows are red", rows.len());
}

/// The short form: every fault at one rate on the lightest sensor, and on each of the heavier ones
/// every fifteenth.
#[test]
fn every_fault_at_one_rate() {
    let begun = Instant::now();
    let kinds = [
        (Vlp16, Strongest),
        (Hdl32e, Strongest),
        (Hdl64eS2, Strongest),
        (Hdl64eS3, Dual),
        (Vlp32c, Strongest),
        (Vls128, Strongest),
    ]
    .map(Kind::from);
    let mut faults: Vec<&str> = cases().iter().map(|case| case.fault).collect();
    faults.dedup();
    let is_wanted = |case: &Case, kind: Kind| {
        let fault = faults.iter().position(|&fault| fault == case.fault);
        let only = if (case.fits)(kinds[0]) {
            kinds[1 + fault.unwrap_or(0) / 3 % 5]
        } else {
            kinds[2]
        };
        let takes_turn = fault.is_some_and(|fault| fault % 3 == 0) || !(case.fits)(kinds[0]);
        case.is_short && (kind == kinds[0] || takes_turn && kind == only)
    };
    judge(&rows(&kinds, is_wanted), begun);
}

#[test]
#[ignore = "the whole matrix takes minutes; run it in release with --ignored --nocapture"]
fn matrix() {
    let begun = Instant::now();
    let word = std::env::var("SWEEPD_MATRIX").unwrap_or_default();
    let has = |case: &Case, kind: Kind| {
        case.fault.contains(&word) || kind.model.to_string().contains(&word)
    };
    judge(&rows(&KINDS, has), begun);
}
