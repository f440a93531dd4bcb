//! The segmenter, and how long it takes for a sweep.

use crate::floor::Sight;
use crate::segment::Segmenter;
use crate::segment::objects::Objects;
use crate::sweep::SweepMut;

/// A segmenter that writes into the header of each sweep how long it took.
pub struct TimedSegmenter {
    segmenter: Segmenter,
    /// Nanoseconds since any fixed moment.
    clock: fn() -> i64,
    /// What was spent on the sweep that was begun early.
    spent: SegmentTime,
}

/// Time spent on the segmentation of a sweep.
#[derive(Default)]
struct SegmentTime {
    sequence: u64,
    ground_ns: i64,
    label_ns: i64,
}

impl TimedSegmenter {
    /// A segmenter, timed by this clock.
    pub fn new(segmenter: Segmenter, clock: fn() -> i64) -> Self {
        Self {
            segmenter,
            clock,
            spent: SegmentTime::default(),
        }
    }

    /// What was done early of the open sweep no longer holds.
    pub(super) fn spoil(&mut self) {
        self.segmenter.spoil();
    }

    /// Finds objects, or no more.
    pub(super) fn find_objects(&mut self, finds: bool) {
        self.segmenter.find_objects(finds);
    }

    /// Columns of the open sweep that must be final before more of it can be done early.
    pub(super) fn next_columns(&self) -> usize {
        self.segmenter.next_columns()
    }

    /// The objects, if they are to be found.
    pub(super) fn objects(&mut self) -> Option<&mut Objects> {
        self.segmenter.objects()
    }

    /// How high the sensor is for the ground of the open sweep, metres.
    pub(super) fn height_m(&self) -> Option<f32> {
        self.segmenter.height_m()
    }

    /// The next sensor may sit elsewhere.
    pub(super) fn forget_floor(&mut self) {
        self.segmenter.forget_floor();
    }

    /// The floor that the sweeps show, and how many were looked at for it.
    pub(super) fn floor(&self) -> (Sight, u64) {
        self.segmenter.floor()
    }

    /// Looks for the floor in the newest sweep, if it is one to look at.
    pub(super) fn find_floor(&mut self) {
        self.segmenter.find_floor();
    }

    /// Writes the height of the sensor into a whole sweep that another segmenter labels. The time
    /// counts as that of the ground.
    pub(super) fn find_height(&mut self, sweep: &mut SweepMut<'_>) {
        let begun_ns = (self.clock)();
        self.segmenter.find_height(sweep);
        let height_ns = (self.clock)() - begun_ns;
        sweep.header.ground_ns = u32::try_from(height_ns).unwrap_or(u32::MAX);
    }

    /// Ground and joins of the open sweep, of which the first `ready` columns will stay as they
    /// are.
    pub(super) fn segment_early(&mut self, sweep: &mut SweepMut<'_>, ready: usize) {
        self.take_time(sweep.header.sequence);
        if self.segmenter.begin_early(sweep, ready) {
            self.segmenter.emit_around_cut(sweep, ready);
            self.segment_strips(sweep);
        }
    }

    /// The paper's two steps, on a whole sweep and in place: take the ground away, join what is
    /// left. What was done early is not done again.
    pub fn segment(&mut self, sweep: &mut SweepMut<'_>) {
        self.take_time(sweep.header.sequence);
        let begun_ns = (self.clock)();
        self.segmenter.begin(sweep);
        // What finding the height took, if that was done apart.
        self.spent.ground_ns += i64::from(sweep.header.ground_ns);
        self.spent.ground_ns += (self.clock)() - begun_ns;
        self.segment_strips(sweep);
        let joined_ns = (self.clock)();
        self.segmenter.label(sweep);
        self.spent.label_ns += (self.clock)() - joined_ns;
        let spent = std::mem::take(&mut self.spent);
        sweep.header.ground_ns = u32::try_from(spent.ground_ns).unwrap_or(u32::MAX);
        sweep.header.label_ns = u32::try_from(spent.label_ns).unwrap_or(u32::MAX);
    }

    /// Strip by strip: takes the ground away, joins what is left.
    fn segment_strips(&mut self, sweep: &SweepMut<'_>) {
        let mut begun_ns = (self.clock)();
        while self.segmenter.find_ground(sweep) {
            let without_ground_ns = (self.clock)();
            self.segmenter.join();
            let joined_ns = (self.clock)();
            self.spent.ground_ns += without_ground_ns - begun_ns;
            self.spent.label_ns += joined_ns - without_ground_ns;
            self.segmenter.emit(sweep);
            begun_ns = joined_ns;
        }
    }

    /// Begins to count, unless this sweep was begun early.
    fn take_time(&mut self, sequence: u64) {
        if self.spent.sequence != sequence {
            self.spent = SegmentTime {
                sequence,
                ..SegmentTime::default()
            };
        }
    }
}
