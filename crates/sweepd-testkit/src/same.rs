//! What of a sweep must be the same wherever its packets go: all but what the layout names as the
//! host's.

use sweepd::sweep::{Column, SweepRef};
use zerocopy::IntoBytes;

/// The bytes of a sweep with zeros for [`HOST_FIELDS`](sweepd::sweep::layout::HOST_FIELDS);
/// `tests/slow/live/consumer.py` has them in the same order.
pub fn same(sweep: &SweepRef<'_>) -> Vec<u8> {
    let (header, columns) = (
        sweep.header.without_host(),
        sweep.columns.iter().map(Column::without_host),
    );
    let columns: Vec<Column> = columns.collect();
    let SweepRef {
        range,
        label,
        range2,
        label2,
        beams,
        segments,
        ..
    } = *sweep;
    let tables = [
        header.as_bytes(),
        columns.as_bytes(),
        beams.as_bytes(),
        segments.as_bytes(),
    ]
    .concat();
    let words = [
        range.as_bytes(),
        label.as_bytes(),
        range2.as_bytes(),
        label2.as_bytes(),
    ]
    .concat();
    [
        tables,
        words,
        [sweep.reflectivity, sweep.reflectivity2, sweep.kind].concat(),
    ]
    .concat()
}
