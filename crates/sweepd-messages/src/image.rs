//! Planes of a sweep as `sensor_msgs/Image`: rows from the top down, columns from left to right as
//! a person at the sensor sees them.
//!
//! That is clockwise from where sweeps are cut, and the order in which columns are measured; where
//! the head turns the other way (`REVERSED`) it is the opposite order. A dual pixel has its
//! segmented return.

use sweepd_sweep::SweepRef;
use sweepd_sweep::layout::{flags, is_return};

use crate::cdr::Writer;
use crate::stamp::MessageHeader;

/// Appends the ranges: `32FC1`, metres, NaN where there is no return (REP 117, REP 118).
pub fn encode_ranges(sweep: &SweepRef<'_>, header: &MessageHeader<'_>, message: &mut Vec<u8>) {
    encode(sweep, header, "32FC1", message, |index| {
        let range_m = sweep.range[index];
        if is_return(range_m) {
            range_m
        } else {
            f32::NAN
        }
        .to_le_bytes()
    });
}

/// Appends the labels: 0 none, 1 ground, 2.. segment; `16UC1` where all fit, else `32SC1`.
pub fn encode_labels(sweep: &SweepRef<'_>, header: &MessageHeader<'_>, message: &mut Vec<u8>) {
    let greatest = sweep.label.iter().copied().max().unwrap_or(0);
    if greatest <= u16::MAX.into() {
        encode(sweep, header, "16UC1", message, |index| {
            (sweep.label[index] as u16).to_le_bytes()
        });
    } else {
        encode(sweep, header, "32SC1", message, |index| {
            sweep.label[index].to_le_bytes()
        });
    }
}

/// The column of a sweep that is this many from the left.
#[inline]
pub(crate) fn column_of(sweep: &SweepRef<'_>, left: usize) -> usize {
    if sweep.header.has(flags::REVERSED) {
        sweep.columns.len() - 1 - left
    } else {
        left
    }
}

fn encode<const BYTES: usize>(
    sweep: &SweepRef<'_>,
    header: &MessageHeader<'_>,
    encoding: &str,
    message: &mut Vec<u8>,
    value: impl Fn(usize) -> [u8; BYTES],
) {
    let (rows, columns) = (sweep.rows(), sweep.columns.len());
    let mut writer = Writer::new(message);
    writer.header(header.stamp.time_ns(sweep), header.frame_id);
    writer.count(rows);
    writer.count(columns);
    writer.text(encoding);
    writer.bool(false);
    writer.count(columns * BYTES);
    writer.count(rows * columns * BYTES);
    let pixels = writer.items(rows * columns * BYTES);
    for (row, line) in pixels
        .chunks_exact_mut((columns * BYTES).max(1))
        .enumerate()
    {
        for (left, pixel) in line.chunks_exact_mut(BYTES).enumerate() {
            pixel.copy_from_slice(&value(column_of(sweep, left) * rows + row));
        }
    }
}
