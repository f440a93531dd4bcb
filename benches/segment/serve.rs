//! Segments an image for each line that comes, and answers with the time it took: so programs of
//! two commits can label the same images in alternate turns.
//!
//! A line is the height of the sensor, metres (0: unknown), and the path of a file with the bytes of
//! a sweep. The answer is two numbers: nanoseconds of all of it, and from the last column to the
//! table. The image is segmented three times: first for the caches and the branch predictor, which
//! belonged to the other program, then for each number.

use std::error::Error;
use std::io::BufRead;
use std::time::Instant;

use sweepd::buffers::{Buffers, HeapBuffers};
use sweepd::segment::{Config, Segmenter};
use sweepd::sweep::SweepMut;

/// Nanoseconds of a whole segmentation, and of what remains of it when the last column comes.
fn measure(
    segmenter: &mut Segmenter,
    sweep: &mut SweepMut<'_>,
) -> Result<[u128; 2], Box<dyn Error>> {
    segmenter.segment(sweep);
    let begun = Instant::now();
    segmenter.segment(sweep);
    let all_ns = begun.elapsed().as_nanos();
    segmenter.begin(sweep);
    let mut last = Instant::now();
    loop {
        let begun = Instant::now();
        if !segmenter.find_ground(sweep) {
            break;
        }
        segmenter.join();
        last = begun;
    }
    segmenter.label(sweep);
    Ok([all_ns, last.elapsed().as_nanos()])
}

/// Answers lines until there are no more.
pub fn main() -> Result<(), Box<dyn Error>> {
    let mut at_hand = String::new();
    let mut buffer = HeapBuffers::default().take(0);
    let mut segmenter = Segmenter::new(Config::default())?;
    for line in std::io::stdin().lock().lines() {
        let line = line?;
        if line != at_hand {
            let (height_m, path) = line.split_once(' ').ok_or("no height")?;
            let bytes = std::fs::read(path)?;
            buffer = HeapBuffers::default().take(bytes.len());
            buffer.as_mut()[..bytes.len()].copy_from_slice(&bytes);
            let mut config = Config::default();
            config.mount.height_m = Some(height_m.parse()?).filter(|height_m| *height_m > 0.0);
            segmenter = Segmenter::new(config)?;
            at_hand = line;
        }
        let [all_ns, tail_ns] = measure(&mut segmenter, &mut SweepMut::open(buffer.as_mut())?)?;
        println!("{all_ns} {tail_ns}");
    }
    Ok(())
}
