//! Squares of pixels, turned over: an image lies column by column, a strip in rows.

use fearless_simd::{Simd, prelude::*};

/// Pixels of a side of the squares that strips are turned by: each instruction set deals as many.
pub(super) const TILE: usize = 4;

/// Of N lines of N numbers: what was the third of each line becomes the third line. N is a power of
/// two.
#[inline(always)]
pub fn turn_over<S: Simd, V: SimdBase<S>, const N: usize>(mut lines: [V; N]) -> [V; N] {
    const { assert!(N == V::LEN) };
    // The lines of both halves are dealt alternately, once for each bit of N: then each number has
    // gone where its place was.
    let mut dealt = 1;
    while dealt < N {
        let before = lines;
        for line in 0..N / 2 {
            lines[2 * line] = before[line].zip_low(before[N / 2 + line]);
            lines[2 * line + 1] = before[line].zip_high(before[N / 2 + line]);
        }
        dealt *= 2;
    }
    lines
}

#[cfg(test)]
mod tests {
    use fearless_simd::{dispatch, u32x16};

    use super::*;
    use crate::assemble::lanes::levels;

    const LANES: usize = 16;

    #[test]
    fn lines_become_what_stood_across() {
        for level in levels() {
            let turned = dispatch!(level, simd => {
                let mut tile = [u32x16::splat(simd, 0); LANES];
                for (line, lanes) in tile.iter_mut().enumerate() {
                    let numbers: [u32; LANES] = std::array::from_fn(|place| (100 * line + place) as u32);
                    *lanes = u32x16::from_slice(simd, &numbers);
                }
                turn_over(tile).map(|lanes| lanes.to_array())
            });
            for (line, numbers) in turned.iter().enumerate() {
                for (place, number) in numbers.iter().enumerate() {
                    assert_eq!(*number as usize, 100 * place + line, "{level:?}");
                }
            }
        }
    }
}
