//! The table that people read.

use std::fmt::Write;

use super::stream::{KINDS, Kind};

/// One cell of the matrix.
#[derive(Clone, Debug)]
pub struct Row {
    pub fault: &'static str,
    pub rate: String,
    pub kind: Kind,
    /// Faults injected, and what the counters say of them.
    pub injected: u64,
    pub counted: Option<u64>,
    /// Returns that were held against the truth, and the largest errors.
    pub returns: u64,
    pub range_mm: f64,
    pub azimuth_deg: f64,
    pub sweeps: usize,
    pub partial: usize,
    /// Objects that were told while the head turned, and segments that were told with their sweep:
    /// each segment once, and none of another sweep.
    pub objects: usize,
    pub with_sweep: usize,
    /// From the end of the fault to the first sweep that is whole, turns.
    pub recovery: Option<f64>,
    /// What does not hold.
    pub red: Vec<String>,
}

impl Default for Row {
    fn default() -> Self {
        Self {
            fault: "",
            rate: String::new(),
            kind: KINDS[0],
            injected: 0,
            counted: None,
            returns: 0,
            range_mm: 0.0,
            azimuth_deg: 0.0,
            sweeps: 0,
            partial: 0,
            objects: 0,
            with_sweep: 0,
            recovery: None,
            red: Vec::new(),
        }
    }
}

/// A line for each row; below a red one, what does not hold.
pub fn print(rows: &[Row]) -> String {
    let mut text = format!(
        "\n{:<25}{:<17}{:<13}{:<10}{:>9}{:>9}{:>10}{:>7}{:>8}{:>7}{:>8}{:>8}{:>7}{:>9}\n",
        "fault",
        "rate",
        "model",
        "mode",
        "injected",
        "counted",
        "returns",
        "mm",
        "deg",
        "sweeps",
        "partial",
        "objects",
        "later",
        "recovery"
    );
    for row in rows {
        let _ = writeln!(text, "{}", line(row));
    }
    text
}

/// A row, and what does not hold.
pub fn line(row: &Row) -> String {
    let Row {
        fault,
        rate,
        kind,
        injected,
        counted,
        returns,
        range_mm,
        azimuth_deg,
        sweeps,
        partial,
        objects,
        with_sweep,
        ..
    } = row;
    let (model, mode) = (kind.model.to_string(), kind.mode.to_string());
    let counted = counted.map_or("-".to_owned(), |count| count.to_string());
    let recovery = row
        .recovery
        .map_or("-".to_owned(), |turns| format!("{turns:.2}"));
    let verdict = if row.red.is_empty() { "green" } else { "RED" };
    let mut text = format!(
        "{fault:<25}{rate:<17}{model:<13}{mode:<10}{injected:>9}{counted:>9}{returns:>10}{range_mm:>7.2}{azimuth_deg:>8.3}\
         {sweeps:>7}{partial:>8}{objects:>8}{with_sweep:>7}{recovery:>9}  {verdict}"
    );
    for why in &row.red {
        let _ = write!(text, "\n    {why}");
    }
    text
}
