//! The range image at the width of the page.

use sweepd_core::sweep::SweepRef;
use sweepd_core::sweep::layout::is_return;

/// Content of a cell of the raster.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Cell {
    /// Columns whose packet was lost.
    Missing,
    /// No return.
    Empty,
    /// The pixel with this index in the planes.
    Pixel(usize),
}

/// The image, scaled along x: columns are repeated, or the nearest return of several is shown, so
/// that nothing small and near disappears.
pub struct Raster {
    /// Columns of the raster.
    pub width: usize,
    /// Rows, those of the sweep.
    pub rows: usize,
    cells: Vec<Cell>,
}

impl Raster {
    /// The image of a sweep, this many cells wide.
    pub fn new(sweep: SweepRef<'_>, width: usize) -> Self {
        let rows = sweep.rows();
        let columns = sweep.columns.len();
        let mut cells = Vec::with_capacity(width * rows);
        for x in 0..width {
            let first = x * columns / width;
            let end = ((x + 1) * columns / width).clamp((first + 1).min(columns), columns);
            let lost = first < end
                && sweep.columns[first..end]
                    .iter()
                    .all(|column| column.is_missing());
            let nothing = if lost { Cell::Missing } else { Cell::Empty };
            cells.extend(
                (0..rows).map(|row| nearest(sweep, row, first..end).map_or(nothing, Cell::Pixel)),
            );
        }
        Self { width, rows, cells }
    }

    /// What is at a place.
    #[inline]
    pub fn cell(&self, x: usize, row: usize) -> Cell {
        self.cells[x * self.rows + row]
    }

    /// Where a column of a sweep of this many columns begins.
    pub fn x_of(&self, column: usize, columns: usize) -> usize {
        (column * self.width).div_ceil(columns.max(1))
    }
}

/// Index of the nearest return of a row in some columns.
fn nearest(sweep: SweepRef<'_>, row: usize, columns: std::ops::Range<usize>) -> Option<usize> {
    columns
        .map(|column| column * sweep.rows() + row)
        .filter(|&index| is_return(sweep.range[index]))
        .min_by(|&a, &b| sweep.range[a].total_cmp(&sweep.range[b]))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::export::test_scene::Scene;

    fn raster(ranges: &[f32], width: usize) -> Vec<Cell> {
        let mut scene = Scene::new(&[0.0], ranges.len(), false);
        scene.fill(|sweep| sweep.range[..ranges.len()].copy_from_slice(ranges));
        let raster = Raster::new(scene.sweep(), width);
        (0..width).map(|x| raster.cell(x, 0)).collect()
    }

    #[test]
    fn the_nearest_of_several_columns_is_shown_and_few_columns_are_repeated() {
        use Cell::{Empty, Pixel};
        assert_eq!(
            raster(&[5.0, 3.0, 0.0, 0.0, 0.0, 9.0], 3),
            [Pixel(1), Empty, Pixel(5)]
        );
        assert_eq!(
            raster(&[5.0, 3.0], 5),
            [Pixel(0), Pixel(0), Pixel(0), Pixel(1), Pixel(1)]
        );
        assert_eq!(raster(&[], 2), [Empty, Empty]);
    }
}
