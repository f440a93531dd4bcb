//! Beams that no longer return, though those next to them do: a laser or its detector has failed,
//! or dirt covers a part of the window.
//!
//! A beam that looks into the sky has no returns either. But what stands on the ground and is seen
//! by the beam above is seen by the beams below, too. So a turn counts against a beam only if it,
//! alone or with one beam next to it, had no return between two beams that had. The highest and the
//! lowest beam are never dark: nothing tells a fault from the sky, or from the robot itself.

use crate::segment::MAX_ROWS;
use crate::sweep::SweepRef;
use crate::sweep::layout::{flags, is_return};

/// Columns after which a look may be over, since all beams have returned: usually the first ones do.
const GLANCE_COLUMNS: usize = 16;

/// A beam that has not returned, though those next to it have.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct DarkBeam {
    /// Row of the image, 0 the highest.
    pub row: u32,
    /// Index of its record within a firing.
    pub channel: u32,
    /// Whole turns since its last return, or since the first packet, in which the beams next to it
    /// returned.
    pub turns: u32,
}

impl DarkBeam {
    /// A beam that has returned before is called dark from this many turns on: a second at 600 turns a
    /// minute. One that never has is from the first.
    pub const LEAST_TURNS: u32 = 10;
    /// From this many turns on it is a warning: 100 s at 600 turns a minute. A robot that stands still
    /// may see nothing along one beam for a while.
    pub const WARNING_TURNS: u32 = 1000;

    /// Whether it has been dark for so long that people are to be warned.
    pub fn is_warning(&self) -> bool {
        self.turns >= Self::WARNING_TURNS
    }
}

/// Counts for each beam of a sensor how long it has been dark.
pub struct DarkBeams {
    /// By row; those of a beam that has just returned have no turns.
    beams: [DarkBeam; MAX_ROWS],
    /// Rows, a bit each, that have ever returned.
    returned: u128,
}

impl Default for DarkBeams {
    fn default() -> Self {
        Self {
            beams: [DarkBeam::default(); MAX_ROWS],
            returned: 0,
        }
    }
}

impl DarkBeams {
    /// Looks at a sweep; one that is no whole turn tells nothing. Beams of `removed_rows`, a bit
    /// each, had returns that were removed.
    pub(super) fn look(&mut self, sweep: &SweepRef<'_>, removed_rows: u128) {
        let rows = sweep.rows();
        if sweep.header.has(flags::PARTIAL | flags::STOPPED) || !(1..=MAX_ROWS).contains(&rows) {
            return;
        }
        let returned = rows_with_returns(sweep) | removed_rows;
        self.returned |= returned;
        let [above, below] = [returned << 1, returned >> 1];
        let witnessed = above & below | above & (below >> 1) | (above << 1) & below;
        for (row, beam) in self.beams[..rows].iter_mut().enumerate() {
            beam.row = row as u32;
            beam.channel = sweep.beams[row].channel;
            if returned >> row & 1 == 1 {
                beam.turns = 0;
            } else if witnessed >> row & 1 == 1 {
                beam.turns = beam.turns.saturating_add(1);
            }
        }
    }

    /// The dark beams, from the highest down.
    pub fn iter(&self) -> impl Iterator<Item = DarkBeam> {
        let beams = self.beams.iter().copied();
        beams.filter(|beam| {
            let has_returned = self.returned >> beam.row & 1 == 1;
            beam.turns
                >= if has_returned {
                    DarkBeam::LEAST_TURNS
                } else {
                    1
                }
        })
    }
}

/// The rows of a sweep, a bit each, that have any return. Of two returns the first plane holds one
/// wherever there is any.
fn rows_with_returns(sweep: &SweepRef<'_>) -> u128 {
    let rows = sweep.rows();
    let mut farthest_m = [0.0_f32; MAX_ROWS];
    for columns in sweep.range.chunks(GLANCE_COLUMNS * rows) {
        for column in columns.chunks_exact(rows) {
            for (farthest_m, &range_m) in farthest_m.iter_mut().zip(column) {
                *farthest_m = farthest_m.max(range_m);
            }
        }
        if farthest_m[..rows].iter().all(|&range_m| is_return(range_m)) {
            break;
        }
    }
    let mut returned = 0;
    for (row, &range_m) in farthest_m.iter().enumerate() {
        returned |= u128::from(is_return(range_m)) << row;
    }
    returned
}
