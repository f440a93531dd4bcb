//! What was told of a sweep, held against its table and its label image.

use std::cmp::Reverse;

use sweepd::buffers::{HeapBuffer, HeapBuffers, Memory};
use sweepd::pipeline::{Event, Fault, Pipeline};
use sweepd::sweep::layout::{flags, segment_flags};
use sweepd::sweep::objects::{self, NewObjects, Object, why};
use sweepd::sweep::{Segment, SweepRef};

/// How much of what was told was what.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Tally {
    /// Told while the head turned.
    pub early: usize,
    /// Told with the sweep.
    pub with_sweep: usize,
    pub parts: usize,
    /// Told around the cut.
    pub around_cut: usize,
    /// Objects that a late packet has changed.
    pub void: usize,
    /// Segments of the table with the sensor inside their boxes.
    pub around_sensor: usize,
}

impl std::ops::AddAssign for Tally {
    fn add_assign(&mut self, other: Self) {
        self.early += other.early;
        self.with_sweep += other.with_sweep;
        self.parts += other.parts;
        self.around_cut += other.around_cut;
        self.void += other.void;
        self.around_sensor += other.around_sensor;
    }
}

/// What a pipeline tells, message by message: that of the open sweep so far, and the tally of those
/// before.
#[derive(Default)]
pub struct Listener {
    told: Vec<Object>,
    /// A sweep whose last objects come next.
    complete: Option<HeapBuffer>,
    pub tally: Tally,
    /// Sweeps of which something was told.
    pub sweeps: usize,
    pub what: String,
}

impl Listener {
    /// One that has heard nothing; this names the stream.
    pub fn new(what: &str) -> Self {
        Self {
            what: what.to_owned(),
            ..Self::default()
        }
    }

    /// Polls until a sweep is complete, and its last objects have come, or until a fault; `None` when
    /// there is no more.
    pub fn poll(
        &mut self,
        pipeline: &mut Pipeline,
        memory: &mut Memory<HeapBuffers>,
    ) -> Option<Result<HeapBuffer, Fault>> {
        loop {
            let reordered = pipeline.status().counts.reordered;
            let event = pipeline.poll(memory);
            if let Some(buffer) = self.complete.take() {
                let Some(Event::Objects(told)) = event else {
                    panic!("{}: the last message comes behind its sweep", self.what);
                };
                self.with_sweep(&told, reordered, &SweepRef::open(buffer.as_ref()).unwrap());
                return Some(Ok(buffer));
            }
            match event? {
                Event::Sweep(buffer) => self.complete = Some(buffer),
                Event::Objects(told) => self.early(&told),
                Event::Fault(fault) => return Some(Err(fault)),
                Event::Notice(_) => {}
            }
        }
    }

    /// After the open sweep was segmented early.
    fn early(&mut self, told: &NewObjects<'_>) {
        assert_eq!(told.flags, 0, "{}", self.what);
        assert_eq!(told.first_ordinal, self.told.len(), "{}", self.what);
        self.told.extend_from_slice(told.objects);
    }

    /// With a sweep: all of it has been told, and nothing of another one.
    fn with_sweep(&mut self, told: &NewObjects<'_>, reordered: u64, sweep: &SweepRef<'_>) {
        assert_eq!(told.sequence, sweep.header.sequence, "{}", self.what);
        assert_eq!(told.time_ns, sweep.header.time_ns, "{}", self.what);
        assert_eq!(told.first_ordinal, self.told.len(), "{}", self.what);
        self.told.extend_from_slice(told.objects);
        let is_partial = sweep.header.has(flags::PARTIAL);
        assert_eq!(told.flags & objects::flags::PARTIAL != 0, is_partial);
        assert!(told.flags & objects::flags::LAST != 0);
        let has_height = sweep.header.height_m > 0.0;
        assert_eq!(told.flags & objects::flags::NO_HEIGHT == 0, has_height);
        if has_height {
            let may_change = !sweep.header.has(flags::CIRCULAR) || reordered > 0;
            self.tally += check(sweep, &self.told, told.labels, may_change, &self.what);
            self.sweeps += 1;
        } else {
            assert!(self.told.is_empty(), "{}: without a height", self.what);
        }
        self.told.clear();
    }
}

/// What a segment's pixels say: the first of them, and shots as (nanoseconds, row, azimuth).
struct Seen {
    pixel: usize,
    first: (i64, usize, f64),
    last: (i64, usize, f64),
}

/// Every segment of the table is told exactly once with the same figures; parts lie in segments,
/// unless the sweep was begun anew and what was told before has changed.
pub fn check(
    sweep: &SweepRef<'_>,
    told: &[Object],
    labels: &[u32],
    may_change: bool,
    what: &str,
) -> Tally {
    assert_eq!(told.len(), labels.len(), "{what}: a label for each object");
    let mut tally = Tally::default();
    let seen = look(sweep);
    let mut times = vec![0; sweep.segments.len()];
    let mut points_in_parts = vec![0; sweep.segments.len()];
    for segment in sweep.segments.iter().filter(|one| holds_sensor(one)) {
        assert!(is_wide(segment), "{what}: {segment:?}");
        tally.around_sensor += 1;
    }
    for (ordinal, (object, &label)) in told.iter().zip(labels).enumerate() {
        assert_eq!(object.ordinal as usize, ordinal, "{what}");
        let holds_sensor = holds_sensor(&object.segment);
        // A part is never wide by its width.
        let says_so =
            is_wide(&object.segment) == holds_sensor || !holds_sensor && object.why != why::WIDE;
        assert!(says_so, "{what}: {object:?}");
        // Measured in part in the turn before.
        if object.why == why::SEAM {
            tally.around_cut += 1;
            // A turn takes at most a fifth of a second.
            let [first_ns, last_ns] = [object.first_ns, object.last_ns];
            assert!(
                -200_000_000 < first_ns && first_ns <= last_ns && last_ns < 200_000_000,
                "{what}: from {first_ns} to {last_ns} ns"
            );
            // The image of a turn that breaks off is counted otherwise.
            let is_turn = sweep.header.has(flags::CIRCULAR);
            let pixel = sweep.label.get(object.first_pixel as usize);
            assert!(
                !is_turn || label == 0 || pixel == Some(&label),
                "{what}: {label}"
            );
            continue;
        }
        if label == 0 {
            tally.void += 1;
            continue;
        }
        let index = label as usize - 2;
        let segment = &sweep.segments[index];
        let Seen { pixel, first, last } = &seen[index];
        if !object.is_segment() {
            tally.parts += 1;
            if may_change {
                continue;
            }
            points_in_parts[index] += object.segment.points;
            for axis in 0..3 {
                assert!(
                    object.segment.min_m[axis] >= segment.min_m[axis]
                        && object.segment.max_m[axis] <= segment.max_m[axis],
                    "{what}: a part of {label} lies within it"
                );
            }
            continue;
        }
        times[index] += 1;
        match object.why {
            why::COMPLETE => tally.early += 1,
            why::SWEEP => tally.with_sweep += 1,
            other => panic!("{what}: told because of {other}"),
        }
        if !sweep.header.has(flags::CIRCULAR) && object.why == why::COMPLETE {
            // It was measured in another order.
            assert_eq!(object.segment.points, segment.points, "{what}: {label}");
            continue;
        }
        let mut row = object.segment;
        row.label = label;
        assert_eq!(row, *segment, "{what}: the row of {label}");
        let named = (object.first_pixel as usize, object.first_ns, object.last_ns);
        let base_ns = sweep.header.time_ns;
        let expected = (
            *pixel,
            (first.0 - base_ns) as i32,
            (last.0 - base_ns) as i32,
        );
        assert_eq!(named, expected, "{what}: pixel and times of {label}");
        let azimuths_rad = [object.azimuth_first_rad, object.azimuth_last_rad];
        let expected = [first.2 as f32, last.2 as f32];
        assert_eq!(azimuths_rad, expected, "{what}: azimuths of {label}");
    }
    assert!(
        times.iter().all(|&times| times == 1),
        "{what}: each segment once, found {times:?}"
    );
    assert!(may_change || tally.void == 0, "{what}: {tally:?}");
    for (segment, points) in sweep.segments.iter().zip(points_in_parts) {
        assert!(
            points <= segment.points,
            "{what}: parts of {}",
            segment.label
        );
    }
    tally
}

/// Whether the sensor is inside its box.
fn holds_sensor(segment: &Segment) -> bool {
    let [x, y, z] = [0, 1, 2].map(|axis| segment.min_m[axis]..=segment.max_m[axis]);
    x.contains(&0.0) && y.contains(&0.0) && z.contains(&0.0)
}

/// Whether it says that its box says nothing of what is inside.
pub fn is_wide(segment: &Segment) -> bool {
    segment.flags == segment_flags::WIDE
}

fn look(sweep: &SweepRef<'_>) -> Vec<Seen> {
    let rows = sweep.rows();
    let mut all: Vec<Option<Seen>> = (0..sweep.segments.len()).map(|_| None).collect();
    for (pixel, &label) in sweep
        .label
        .iter()
        .enumerate()
        .filter(|(_, label)| **label > 1)
    {
        let (row, column) = (pixel % rows, pixel / rows);
        let shot = (
            sweep.time_ns(row, column),
            row,
            sweep.azimuth_rad(row, column),
        );
        let seen = all[label as usize - 2].get_or_insert(Seen {
            pixel,
            first: shot,
            last: shot,
        });
        if (shot.0, row) < (seen.first.0, seen.first.1) {
            seen.first = shot;
        }
        if (shot.0, Reverse(row)) > (seen.last.0, Reverse(seen.last.1)) {
            seen.last = shot;
        }
    }
    all.into_iter()
        .map(|seen| seen.expect("a segment has pixels"))
        .collect()
}
