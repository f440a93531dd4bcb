//! Cases of a long test that run: an eighth of them, another one each day that something lands, or all.

use std::iter::StepBy;
use std::ops::RangeFrom;

/// Environment variable: `all`, or which of each eight cases, from 0 to 7; the first where it is not set.
pub const VARIABLE: &str = "SWEEPD_EIGHTH";
const STRIDE: usize = 8;

/// Numbers of the cases, without an end.
///
/// # Panics
/// The variable has another value.
pub fn chosen() -> StepBy<RangeFrom<usize>> {
    let chosen = std::env::var(VARIABLE).unwrap_or_else(|_| "0".to_owned());
    if chosen == "all" {
        return (0..).step_by(1);
    }
    let first = chosen.parse().ok().filter(|first| *first < STRIDE);
    let first = first.unwrap_or_else(|| panic!("{VARIABLE} is `all`, or a number below {STRIDE}"));
    (first..).step_by(STRIDE)
}

/// True if all cases run.
pub fn are_all() -> bool {
    chosen().nth(1) == Some(1)
}

/// True if this case runs.
pub fn has(case: usize) -> bool {
    chosen().find(|chosen| *chosen >= case) == Some(case)
}

/// Counter of the cases of a test that nests loops.
#[derive(Default)]
pub struct Cases(usize);

impl Cases {
    /// Counts the next case. True if it runs.
    pub fn takes(&mut self) -> bool {
        let case = self.0;
        self.0 += 1;
        has(case)
    }
}
