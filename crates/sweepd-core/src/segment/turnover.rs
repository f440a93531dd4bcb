//! Squares of sixteen by sixteen pixels, turned over: an image lies column by column, runs lie in
//! rows.

use fearless_simd::{Simd, prelude::*};

use super::order::LANES;

/// Of sixteen lines of sixteen: what was the third of each line becomes the third line.
#[inline(always)]
pub fn turn_over<S: Simd, V: SimdBase<S>>(tile: [V; LANES]) -> [V; LANES] {
    deal(deal(deal(deal(tile))))
}

/// Deals the lines of both halves alternately: after four times, each number has gone where its
/// place was.
#[inline(always)]
fn deal<S: Simd, V: SimdBase<S>>(lines: [V; LANES]) -> [V; LANES] {
    let [a, b, c, d, e, f, g, h, i, j, k, l, m, n, o, p] = lines;
    [
        a.zip_low(i),
        a.zip_high(i),
        b.zip_low(j),
        b.zip_high(j),
        c.zip_low(k),
        c.zip_high(k),
        d.zip_low(l),
        d.zip_high(l),
        e.zip_low(m),
        e.zip_high(m),
        f.zip_low(n),
        f.zip_high(n),
        g.zip_low(o),
        g.zip_high(o),
        h.zip_low(p),
        h.zip_high(p),
    ]
}

#[cfg(test)]
mod tests {
    use fearless_simd::{dispatch, u32x16};

    use super::*;
    use crate::assemble::lanes::levels;

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
