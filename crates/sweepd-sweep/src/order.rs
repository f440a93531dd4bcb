//! The order in which the beams of a sweep fired.

use super::image::{SweepRef, turned_to};
use super::layout::flags;

/// A pixel of a sweep, and the firing that it belongs to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FiredPixel {
    /// Row, 0 the highest.
    pub row: usize,
    /// Column of the image.
    pub column: usize,
    /// Column of the firing; see [`SweepRef::fired_in`].
    pub firing: usize,
}

/// The pixels of a sweep in the order in which their beams fired; of those that fired at once, the
/// earlier firing and the higher row first. See [`SweepRef::pixels_by_time`].
///
/// The beams of a firing have the same order in all firings. Most firings end before the next one
/// begins: only the shots of those that overlap are sorted.
pub struct PixelsByTime<'a> {
    sweep: SweepRef<'a>,
    /// From the first of a firing to the last.
    rows: Vec<usize>,
    /// From the first shot of a firing to its last.
    lasts_ns: u64,
    /// By firing: the least time of it and those behind it.
    earliest_ns: Vec<u32>,
    next_firing: usize,
    /// The pixels of some firings, which end before the next firing begins.
    pixels: Vec<FiredPixel>,
    /// How many of them were given.
    given: usize,
}

impl<'a> PixelsByTime<'a> {
    pub(crate) fn of(sweep: SweepRef<'a>) -> Self {
        let offset_ns = |&row: &usize| sweep.beams[row].time_offset_ns;
        let mut rows: Vec<usize> = (0..sweep.rows()).collect();
        // Sorting reads each time once: a hostile publisher may write to them meanwhile.
        rows.sort_by_cached_key(offset_ns);
        let [first_ns, last_ns] = [rows.first(), rows.last()].map(|row| row.map_or(0, offset_ns));
        let mut earliest_ns: Vec<u32> = sweep.columns.iter().map(|one| one.time_ns).collect();
        let mut least_ns = u32::MAX;
        for time_ns in earliest_ns.iter_mut().rev() {
            least_ns = least_ns.min(*time_ns);
            *time_ns = least_ns;
        }
        Self {
            sweep,
            rows,
            lasts_ns: u64::from(last_ns.saturating_sub(first_ns)),
            earliest_ns,
            next_firing: 0,
            pixels: Vec::new(),
            given: 0,
        }
    }

    /// Takes the next firing, and those that it overlaps.
    fn take_firings(&mut self) {
        self.pixels.clear();
        self.given = 0;
        let first = self.next_firing;
        let mut latest_ns = 0;
        while let Some(column) = self.sweep.columns.get(self.next_firing) {
            self.take_firing(self.next_firing);
            self.next_firing += 1;
            latest_ns = latest_ns.max(u64::from(column.time_ns) + self.lasts_ns);
            let behind_ns = self.earliest_ns.get(self.next_firing);
            if behind_ns.is_none_or(|&ns| u64::from(ns) >= latest_ns) {
                break;
            }
        }
        if self.next_firing - first > 1 {
            let SweepRef { columns, beams, .. } = self.sweep;
            let shot_ns = |pixel: &FiredPixel| {
                let [firing_ns, offset_ns] = [
                    columns[pixel.firing].time_ns,
                    beams[pixel.row].time_offset_ns,
                ];
                u64::from(firing_ns) + u64::from(offset_ns)
            };
            self.pixels.sort_by_cached_key(shot_ns);
        }
    }

    #[inline]
    fn take_firing(&mut self, firing: usize) {
        let SweepRef { columns, beams, .. } = self.sweep;
        let is_circular = self.sweep.header.has(flags::CIRCULAR);
        for &row in &self.rows {
            let at = firing as i64 - i64::from(beams[row].shift);
            if let Some(column) = turned_to(at, columns.len(), is_circular) {
                self.pixels.push(FiredPixel {
                    row,
                    column,
                    firing,
                });
            }
        }
    }
}

impl Iterator for PixelsByTime<'_> {
    type Item = FiredPixel;

    #[inline]
    fn next(&mut self) -> Option<FiredPixel> {
        while self.given == self.pixels.len() {
            if self.next_firing == self.sweep.columns.len() {
                return None;
            }
            self.take_firings();
        }
        self.given += 1;
        Some(self.pixels[self.given - 1])
    }
}
