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
    /// From the first of a firing to the last: how many columns before the firing its pixel is.
    rows: Vec<(usize, i64)>,
    is_circular: bool,
    /// From the first shot of a firing to its last.
    lasts_ns: u64,
    /// By firing: the least time of it and those behind it.
    earliest_ns: Vec<u32>,
    next_firing: usize,
    /// The firing whose pixels are given, which ends before the next one begins; none where
    /// firings overlap.
    alone: Option<usize>,
    /// The pixels of firings that overlap, which end before the next firing begins.
    pixels: Vec<FiredPixel>,
    /// How many of these, or rows of the other, were given.
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
            rows: rows
                .into_iter()
                .map(|row| (row, i64::from(sweep.beams[row].shift)))
                .collect(),
            is_circular: sweep.header.has(flags::CIRCULAR),
            lasts_ns: u64::from(last_ns.saturating_sub(first_ns)),
            earliest_ns,
            next_firing: 0,
            alone: None,
            pixels: Vec::new(),
            given: 0,
        }
    }

    /// Takes the next firing, and those that it overlaps; false where there is none.
    fn take_firings(&mut self) -> bool {
        let first = self.next_firing;
        self.pixels.clear();
        (self.given, self.alone) = (0, None);
        let mut latest_ns = 0;
        while let Some(column) = self.sweep.columns.get(self.next_firing) {
            self.next_firing += 1;
            latest_ns = latest_ns.max(u64::from(column.time_ns) + self.lasts_ns);
            let behind_ns = self.earliest_ns.get(self.next_firing);
            if behind_ns.is_none_or(|&ns| u64::from(ns) >= latest_ns) {
                break;
            }
        }
        if self.next_firing - first == 1 {
            self.alone = Some(first);
        } else {
            self.sort(first);
        }
        self.next_firing > first
    }

    /// Sorts the pixels of the firings from one on that are taken.
    fn sort(&mut self, first: usize) {
        let SweepRef { columns, beams, .. } = self.sweep;
        for firing in first..self.next_firing {
            for nth in 0..self.rows.len() {
                if let Some(pixel) = self.pixel(nth, firing) {
                    self.pixels.push(pixel);
                }
            }
        }
        let shot_ns = |pixel: &FiredPixel| {
            let [firing_ns, offset_ns] = [
                columns[pixel.firing].time_ns,
                beams[pixel.row].time_offset_ns,
            ];
            u64::from(firing_ns) + u64::from(offset_ns)
        };
        self.pixels.sort_by_cached_key(shot_ns);
    }

    /// The nth pixel of a firing, unless it is outside of the image.
    #[inline]
    fn pixel(&self, nth: usize, firing: usize) -> Option<FiredPixel> {
        let (row, shift) = self.rows[nth];
        let columns = self.sweep.columns.len();
        let column = turned_to(firing as i64 - shift, columns, self.is_circular)?;
        Some(FiredPixel {
            row,
            column,
            firing,
        })
    }
}

impl Iterator for PixelsByTime<'_> {
    type Item = FiredPixel;

    #[inline]
    fn next(&mut self) -> Option<FiredPixel> {
        loop {
            if let Some(pixel) = self.pixels.get(self.given) {
                self.given += 1;
                return Some(*pixel);
            }
            if let Some(firing) = self.alone {
                while self.given < self.rows.len() {
                    self.given += 1;
                    if let Some(pixel) = self.pixel(self.given - 1, firing) {
                        return Some(pixel);
                    }
                }
            }
            if !self.take_firings() {
                return None;
            }
        }
    }
}
