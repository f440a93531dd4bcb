//! How a sensor moved while it measured a sweep: points and boxes where it would have seen them at one
//! moment.

use sweepd_sweep::{Pose, SweepRef};

use crate::stamp::Stamp;

/// The poses of a sensor in a frame that stands still: at each firing, and at each [`Stamp`].
///
/// A pose holds for all beams of a firing, which takes some 50 us.
#[derive(Clone, Debug)]
pub struct Motion {
    firings: Vec<Pose>,
    /// At the first shot, halfway, and at the last.
    moments: [Pose; 3],
}

impl Motion {
    /// That of a sweep. As for [`SweepRef::points_in`], `pose_at` gives the pose of the sensor at a
    /// time, nanoseconds since 1970 in the clock of
    /// [`Header::time_source`](sweepd_sweep::Header::time_source).
    pub fn of(sweep: &SweepRef<'_>, pose_at: impl Fn(i64) -> Pose) -> Self {
        let beams = sweep.beams.iter().map(|beam| beam.time_offset_ns);
        let halfway_ns = i64::from(beams.max().unwrap_or(0) / 2);
        let begun_ns = sweep.header.time_ns;
        let firings = sweep
            .columns
            .iter()
            .map(|firing| pose_at(begun_ns.saturating_add(i64::from(firing.time_ns) + halfway_ns)));
        let moments = [Stamp::First, Stamp::Middle, Stamp::Last];
        Self {
            firings: firings.collect(),
            moments: moments.map(|stamp| pose_at(stamp.time_ns(sweep))),
        }
    }

    /// For each firing, the pose of the sensor in the sensor's own frame at a moment: both with x
    /// right, y forward, z up.
    pub(crate) fn to(&self, stamp: Stamp) -> Vec<Pose> {
        let from_world = self.moments[stamp as usize].inverse();
        self.firings.iter().map(|pose| from_world * *pose).collect()
    }
}
