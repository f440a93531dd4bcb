//! Offsets and sizes of the parts of a sweep, and the check of a header that others wrote.

use super::{
    ALIGN, BeamRow, COLUMNS_CAPACITY, Column, Header, LAYOUT_VERSION, MAGIC, PARTS, Segment,
};
use crate::objects::OBJECTS_VERSION;

/// Capacities of a sweep.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Shape {
    /// Rows.
    pub rows: usize,
    /// Columns at most.
    pub columns_capacity: usize,
    /// Two returns a pixel.
    pub dual: bool,
    /// Segments at most.
    pub segments_capacity: usize,
}

impl Shape {
    /// The shape of all sweeps of a sensor with this many rows. Segments have at least `min_points`
    /// pixels, so that the table has room for all that can occur.
    pub fn of(rows: usize, dual: bool, min_points: usize) -> Self {
        let segments_capacity = rows * COLUMNS_CAPACITY / min_points.max(1);
        Self {
            rows,
            columns_capacity: COLUMNS_CAPACITY,
            dual,
            segments_capacity,
        }
    }

    /// Where each part begins (0 = absent), and the bytes of the whole.
    pub fn offsets(&self) -> ([u64; PARTS], usize) {
        let mut offsets = [0; PARTS];
        let mut end = size_of::<Header>();
        for (offset, bytes) in offsets.iter_mut().zip(self.part_bytes()) {
            if bytes > 0 {
                *offset = end as u64;
                end = (end + bytes).next_multiple_of(ALIGN);
            }
        }
        (offsets, end)
    }

    /// Bytes of the whole sweep.
    pub fn total_bytes(&self) -> usize {
        self.offsets().1
    }

    pub(crate) fn part_bytes(&self) -> [usize; PARTS] {
        let pixels = self.rows * self.columns_capacity;
        let other = if self.dual { pixels } else { 0 };
        [
            pixels * size_of::<f32>(),
            pixels,
            pixels * size_of::<u32>(),
            other * size_of::<f32>(),
            other,
            other * size_of::<u32>(),
            other,
            self.columns_capacity * size_of::<Column>(),
            self.rows * size_of::<BeamRow>(),
            self.segments_capacity * size_of::<Segment>(),
        ]
    }
}

/// Why bytes are not a sweep, or not a message of objects.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum LayoutError {
    /// Too short, or not aligned to 8 bytes.
    #[error("{bytes} bytes cannot hold all parts, or are not aligned to 8 bytes")]
    Bytes {
        /// Bytes that there are.
        bytes: usize,
    },
    /// Other first bytes.
    #[error("not data of sweepd: the magic bytes at its beginning are missing")]
    Foreign,
    /// Another version.
    #[error(
        "a sweep of layout version {found}, and this program reads version {LAYOUT_VERSION}; build it with the version of \
         sweepd that made the sweep, or use a sweep of the version that it was built with"
    )]
    Version {
        /// Version that the header names.
        found: u32,
    },
    /// Another version of objects.
    #[error(
        "objects of version {found}, and this program reads version {OBJECTS_VERSION}; build it with the version of sweepd that \
         runs on this host"
    )]
    ObjectsVersion {
        /// Version that the header names.
        found: u32,
    },
    /// Fewer bytes than the header says.
    #[error("torn: it should have {promised} bytes, and has {bytes}")]
    Torn {
        /// Bytes that are named.
        promised: u64,
        /// Bytes that there are.
        bytes: usize,
    },
    /// Counts and offsets that contradict each other.
    #[error("the header's counts and offsets contradict each other")]
    Inconsistent,
}

/// The shape of a header that others wrote, if all its values are possible in `bytes` bytes.
pub(crate) fn checked_shape(header: &Header, bytes: usize) -> Result<Shape, LayoutError> {
    if header.magic != MAGIC {
        return Err(LayoutError::Foreign);
    }
    if header.version != LAYOUT_VERSION {
        return Err(LayoutError::Version {
            found: header.version,
        });
    }
    let shape = header.shape();
    let bounded = shape.rows <= 256
        && shape.columns_capacity <= 1 << 20
        && shape.segments_capacity <= 1 << 28;
    let columns = u64::from(header.margin_columns) + u64::from(header.columns);
    if !bounded
        || columns > u64::from(header.columns_capacity)
        || header.segments > header.segments_capacity
    {
        return Err(LayoutError::Inconsistent);
    }
    let (offsets, total_bytes) = shape.offsets();
    if offsets != header.offsets || total_bytes as u64 != header.total_bytes {
        return Err(LayoutError::Inconsistent);
    }
    if total_bytes > bytes {
        return Err(LayoutError::Bytes { bytes });
    }
    Ok(shape)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parts_are_aligned_and_do_not_overlap() {
        for dual in [false, true] {
            let shape = Shape {
                rows: 3,
                columns_capacity: 5,
                dual,
                segments_capacity: 2,
            };
            let (offsets, total) = shape.offsets();
            let mut end = size_of::<Header>();
            for (offset, bytes) in offsets
                .into_iter()
                .zip(shape.part_bytes())
                .filter(|&(_, bytes)| bytes > 0)
            {
                assert!(offset as usize >= end && (offset as usize).is_multiple_of(ALIGN));
                end = offset as usize + bytes;
            }
            assert!(end <= total);
        }
    }
}
