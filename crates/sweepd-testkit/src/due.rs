//! When the packet that completes a sweep is expected.

use crate::stream::next_sweep;
use sweepd::buffers::{HeapBuffers, Memory};
use sweepd::pipeline::{Config, Pipeline};
use sweepd::wire::Datagram;

/// Of each sweep: by how much the packet that completed it came after it was expected, as was said
/// after each packet before, nanoseconds.
pub fn late_ns(config: Config, packets: impl IntoIterator<Item = (Vec<u8>, i64)>) -> Vec<Vec<i64>> {
    let mut pipeline = Pipeline::new("sensor", config).unwrap();
    let mut memory = Memory::new(HeapBuffers::default());
    let (mut said_ns, mut late_ns) = (Vec::new(), Vec::new());
    for (payload, arrival_ns) in packets {
        let source = ([192, 168, 1, 201], 2368).into();
        pipeline.push(
            &Datagram {
                arrival_ns,
                source,
                destination_port: 2368,
                payload: &payload,
            }
            .parse()
            .unwrap(),
        );
        if std::iter::from_fn(|| next_sweep(&mut pipeline, &mut memory)).count() > 0 {
            late_ns.push(
                said_ns
                    .drain(..)
                    .map(|due_ns: i64| arrival_ns - due_ns)
                    .collect(),
            );
        }
        said_ns.extend(pipeline.next_due_ns(None));
    }
    late_ns
}
