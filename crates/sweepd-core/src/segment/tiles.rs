//! Squares of sixteen by sixteen pixels, turned over: an image lies column by column, runs lie in
//! rows.

use fearless_simd::{Simd, prelude::*, u32x16};

use super::points::{LANES, STRIP};

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

/// Copies the first columns of a strip that lies in rows to these columns of an image.
#[inline(always)]
pub(super) fn write_columns<S: Simd>(
    simd: S,
    strip: &[u32],
    image: &mut [u32],
    rows: usize,
    mut columns: impl Iterator<Item = usize>,
) {
    let squared = rows / LANES * LANES;
    for half in (0..STRIP).step_by(LANES) {
        let (mut there, mut count) = ([0; LANES], 0);
        while count < LANES
            && let Some(column) = columns.next()
        {
            there[count] = column;
            count += 1;
        }
        for row in (0..squared).step_by(LANES) {
            let mut tile = [u32x16::splat(simd, 0); LANES];
            for line in 0..LANES {
                tile[line] =
                    u32x16::from_slice(simd, &strip[(row + line) * STRIP + half..][..LANES]);
            }
            let tile = turn_over(tile);
            for ahead in 0..count {
                tile[ahead].store_slice(&mut image[there[ahead] * rows + row..][..LANES]);
            }
        }
        for row in squared..rows {
            for (ahead, column) in there[..count].iter().enumerate() {
                image[column * rows + row] = strip[row * STRIP + half + ahead];
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use fearless_simd::dispatch;

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
