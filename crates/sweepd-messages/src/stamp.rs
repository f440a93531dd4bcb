//! What stands in the header of each message of a sweep.

use sweepd_sweep::SweepRef;

/// Which shot of a sweep its stamp is the time of.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Stamp {
    /// The first, so that times of points are 0 or more: what odometry with a motion correction
    /// expects.
    #[default]
    First,
    /// None: the moment halfway between the first shot and the last.
    Middle,
    /// The last, so that times of points are 0 or less.
    Last,
}

impl Stamp {
    /// The time, nanoseconds since 1970 in the clock of
    /// [`Header::time_source`](sweepd_sweep::Header::time_source).
    pub fn time_ns(self, sweep: &SweepRef<'_>) -> i64 {
        let first_ns = sweep.header.time_ns;
        if self == Self::First {
            return first_ns;
        }
        let fired = sweep.columns.iter().filter(|column| column.is_fired());
        let column_ns = fired.map(|column| column.time_ns).max().unwrap_or(0);
        let beam_ns = sweep.beams.iter().map(|beam| beam.time_offset_ns).max();
        let lasts_ns = i64::from(column_ns) + i64::from(beam_ns.unwrap_or(0));
        first_ns.saturating_add(match self {
            Self::Middle => lasts_ns / 2,
            _ => lasts_ns,
        })
    }
}

/// The header of each message of a sweep.
#[derive(Clone, Copy, Debug)]
pub struct MessageHeader<'a> {
    /// The frame of the sensor.
    pub frame_id: &'a str,
    /// Which shot the stamp is of.
    pub stamp: Stamp,
}
