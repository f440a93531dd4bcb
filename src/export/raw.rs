//! A sweep in its own bytes, as `docs/layout.md` defines them.

use sweepd_core::buffers::HeapBuffer;
use sweepd_core::buffers::{Buffers, HeapBuffers};
use sweepd_core::sweep::{Shape, SweepMut, SweepRef};

/// The same sweep without unused room, so that each of its bytes is defined; without `has_times`
/// the time spent on it is 0. `None` for a header whose counts contradict the planes.
pub fn trimmed(sweep: &SweepRef<'_>, has_times: bool) -> Option<HeapBuffer> {
    let shape = Shape {
        rows: sweep.rows(),
        columns_capacity: sweep.columns.len(),
        dual: !sweep.range2.is_empty(),
        segments_capacity: sweep.segments.len(),
    };
    // Of new buffers, whose bytes between the parts are 0.
    let mut buffer = HeapBuffers::default().take(shape.total_bytes());
    let out = SweepMut::create(buffer.as_mut(), &shape).ok()?;
    let made = *out.header;
    *out.header = *sweep.header;
    out.header.offsets = made.offsets;
    out.header.total_bytes = made.total_bytes;
    out.header.columns_capacity = made.columns_capacity;
    out.header.segments_capacity = made.segments_capacity;
    out.header.margin_columns = 0;
    if !has_times {
        (
            out.header.decode_ns,
            out.header.ground_ns,
            out.header.label_ns,
        ) = (0, 0, 0);
    }
    out.range.copy_from_slice(sweep.range);
    out.reflectivity.copy_from_slice(sweep.reflectivity);
    out.label.copy_from_slice(sweep.label);
    out.range2.copy_from_slice(sweep.range2);
    out.reflectivity2.copy_from_slice(sweep.reflectivity2);
    out.label2.copy_from_slice(sweep.label2);
    out.kind.copy_from_slice(sweep.kind);
    out.columns.copy_from_slice(sweep.columns);
    out.beams.copy_from_slice(sweep.beams);
    out.segments.copy_from_slice(sweep.segments);
    Some(buffer)
}
