//! The robot's own body: pixels that are never labelled.

use std::f64::consts::TAU;

use super::order::MAX_ROWS;

/// Most columns of a mask: finer than the encoder of any sensor.
pub const MAX_WIDTH: usize = 36_000;

/// An image of what the robot itself hides, one row a beam (the highest on top), any number of
/// columns.
///
/// The columns span the azimuth from 0 to 360 degrees, from the sensor's +y axis clockwise.
#[derive(Clone, Debug, PartialEq)]
pub struct Mask {
    rows: usize,
    /// Masked rows by azimuth.
    bins: Vec<u128>,
}

/// Why an image is no mask.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum MaskError {
    /// Its height is that of no sensor, or it is absurdly wide.
    #[error(
        "{width} x {height} pixels, expected 1 to {MAX_WIDTH} in width, for 360 degrees, and 1 to {MAX_ROWS} in height, one row \
         for each beam of the sensor"
    )]
    Size {
        /// Its width.
        width: usize,
        /// Its height.
        height: usize,
    },
    /// It hides every beam at every azimuth.
    #[error("all black: nothing would be labelled; white keeps")]
    AllBlack,
}

impl Mask {
    /// A mask of `height` rows: `hidden` has `width` pixels for each, from the highest row down.
    ///
    /// # Errors
    /// [`MaskError`].
    ///
    /// # Panics
    /// If `hidden` has another number of pixels than `width * height`.
    pub fn new(width: usize, height: usize, hidden: &[bool]) -> Result<Self, MaskError> {
        Self::check_size(width, height)?;
        assert_eq!(hidden.len(), width * height);
        let mut bins = vec![0_u128; width];
        for (row, line) in hidden.chunks_exact(width).enumerate() {
            for (bin, &is_hidden) in bins.iter_mut().zip(line) {
                *bin |= u128::from(is_hidden) << row;
            }
        }
        let all = u128::MAX >> (u128::BITS as usize - height);
        if bins.iter().all(|&bin| bin == all) {
            return Err(MaskError::AllBlack);
        }
        Ok(Self { rows: height, bins })
    }

    /// Whether an image of this size can be a mask, before its pixels are there.
    ///
    /// # Errors
    /// [`MaskError::Size`].
    pub fn check_size(width: usize, height: usize) -> Result<(), MaskError> {
        if (1..=MAX_ROWS).contains(&height) && (1..=MAX_WIDTH).contains(&width) {
            return Ok(());
        }
        Err(MaskError::Size { width, height })
    }

    /// Rows of the sensor that the mask is for.
    pub fn rows(&self) -> usize {
        self.rows
    }

    /// Whether the robot itself hides a beam at an azimuth in radians.
    #[inline]
    pub fn hides(&self, row: usize, azimuth_rad: f64) -> bool {
        self.bins[Self::column(self.bins.len(), azimuth_rad)] >> row & 1 == 1
    }

    /// The column of an azimuth in radians, in an image of this width.
    #[inline]
    pub fn column(width: usize, azimuth_rad: f64) -> usize {
        let column = (azimuth_rad / TAU).rem_euclid(1.0) * width as f64;
        (column as usize).min(width - 1)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two rows of four quarters; the upper one hides the second quarter, the lower one the last.
    #[test]
    fn pixels_hide_their_part_of_the_turn() {
        let hidden = [false, true, false, false, false, false, false, true];
        let mask = Mask::new(4, 2, &hidden).unwrap();
        let quarters = |row| {
            [45_f64, 135.0, 225.0, 315.0].map(|azimuth| mask.hides(row, azimuth.to_radians()))
        };
        assert_eq!(quarters(0), [false, true, false, false]);
        assert_eq!(quarters(1), [false, false, false, true]);
        assert!(mask.hides(1, -0.001) && !mask.hides(1, TAU));
    }

    #[test]
    fn an_image_that_can_be_no_mask_is_refused() {
        for (width, height) in [(0, 16), (16, 0), (36_001, 16), (16, 129)] {
            assert_eq!(
                Mask::new(width, height, &[]),
                Err(MaskError::Size { width, height })
            );
        }
        assert_eq!(Mask::new(3, 128, &[true; 384]), Err(MaskError::AllBlack));
    }
}
