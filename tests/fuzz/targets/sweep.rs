//! The bytes of a sweep as a consumer finds them in shared memory, whoever wrote them.

use std::f64::consts::TAU;

use sweepd::buffers::{Buffers, HeapBuffers};
use sweepd::sweep::layout::{Completion, Header, Segment};
use sweepd::sweep::{Shape, SweepMut, SweepRef};

use super::Numbers;

/// Any bytes, or a sweep with a few words of its header and all that follows written over.
///
/// ```text
/// 0, then the bytes
/// 1 (dual: 2), rows u8, columns u8, capacity u8, segments u8, number of words u8, (place u8, value u32)..., then the rest
/// ```
pub fn sweep(input: &[u8]) {
    let mut numbers = Numbers(input);
    let kind = numbers.u8() % 3;
    let mut buffers = HeapBuffers::default();
    if kind == 0 {
        let mut buffer = buffers.take(numbers.0.len());
        let bytes = &mut buffer.as_mut()[..numbers.0.len()];
        bytes.copy_from_slice(numbers.0);
        look_at(bytes);
        assert!(
            bytes.len() < 2 || SweepRef::open(&bytes[1..]).is_err(),
            "an odd address was taken"
        );
        return;
    }
    let [rows, columns, capacity, segments, words] = [(); 5].map(|()| numbers.u8());
    let shape = Shape {
        rows: usize::from(rows % 130),
        columns_capacity: usize::from(capacity),
        dual: kind == 2,
        segments_capacity: usize::from(segments),
    };
    let len = shape.total_bytes();
    let mut buffer = buffers.take(len);
    let bytes = &mut buffer.as_mut()[..len];
    let mut header = Header::new(&shape);
    (header.columns, header.segments) = (u32::from(columns), u32::from(segments));
    zerocopy::IntoBytes::write_to_prefix(&header, bytes).expect("a sweep has room for its header");
    for _ in 0..words % 8 {
        let (place, value) = (
            usize::from(numbers.u8()) % (size_of::<Header>() / 4),
            numbers.u32(),
        );
        bytes[4 * place..][..4].copy_from_slice(&value.to_le_bytes());
    }
    let rest = if numbers.is_empty() {
        &[0xA5]
    } else {
        numbers.0
    };
    bytes[size_of::<Header>()..]
        .iter_mut()
        .zip(rest.iter().cycle())
        .for_each(|(byte, &value)| *byte = value);
    look_at(bytes);
}

/// Everything that a consumer can ask of bytes.
fn look_at(bytes: &mut [u8]) {
    let opened = match SweepRef::open(bytes) {
        Ok(sweep) => {
            ask_all(&sweep);
            true
        }
        Err(error) => {
            assert!(!error.to_string().is_empty());
            false
        }
    };
    // Who fills a sweep reads the same header.
    match SweepMut::open(bytes) {
        Ok(sweep) => {
            assert!(opened);
            ask_all(&sweep.as_ref());
            let (name, at) = ("a name", 5);
            let completion = Completion {
                name,
                run_ns: at,
                completed_ns: at,
                completed_monotonic_ns: at,
                dropped_datagrams: 1,
            };
            sweep.header.complete(&completion);
            assert_eq!(sweep.header.name(), name);
        }
        Err(_) => assert!(!opened),
    }
}

fn ask_all(sweep: &SweepRef<'_>) {
    let (rows, columns) = (sweep.rows(), sweep.columns.len());
    let pixels = rows * columns;
    assert_eq!(
        [
            sweep.range.len(),
            sweep.label.len(),
            sweep.reflectivity.len()
        ],
        [pixels; 3]
    );
    let other = if sweep.kind.is_empty() { 0 } else { pixels };
    assert_eq!(
        [
            sweep.range2.len(),
            sweep.label2.len(),
            sweep.reflectivity2.len()
        ],
        [other; 3]
    );
    let header = sweep.header;
    let _ = (
        header.time_source(),
        header.return_mode(),
        header.sensor(),
        header.name(),
        header.shape(),
    );
    let touched: u32 = sweep
        .segments
        .iter()
        .map(|&Segment { label, points, .. }| label ^ points)
        .fold(0, |a, b| a ^ b);
    std::hint::black_box(touched);
    for (row, column) in (0..columns).flat_map(|column| (0..rows).map(move |row| (row, column))) {
        assert!(sweep.fired_in(row, column) < columns);
        let azimuth_rad = sweep.azimuth_rad(row, column);
        assert!(
            azimuth_rad.is_nan() || (0.0..TAU).contains(&azimuth_rad),
            "{azimuth_rad}"
        );
        let _ = std::hint::black_box((sweep.time_ns(row, column), sweep.point_m(row, column, 2.5)));
    }
    assert!(
        sweep
            .returns()
            .inspect(|one| _ = std::hint::black_box(*one))
            .count()
            <= pixels + other
    );
}
