//! What is doubtful about the time of a GPS receiver, in words, and what to do about it.

use sweepd_core::assemble::GpsDoubt;
use sweepd_core::wire::nmea::NmeaError;

use crate::input::FIRST_NS;
use crate::judge::{Finding, Severity, Topic};
use crate::text::utc_text;

/// This program is no older, nanoseconds since 1970: 2026-11-25. An earlier clock of a host is not
/// set. Raised with a release.
pub const RELEASED_NS: i64 = 1_795_564_800_000_000_000;

fn sentence(doubt: &GpsDoubt) -> String {
    match *doubt {
        GpsDoubt::Frozen { said_ns } => format!(
            "the GPS receiver repeats {} while the sensor's clock goes on: its time is not used",
            utc_text(said_ns)
        ),
        GpsDoubt::Unset { said_ns } => format!(
            "the GPS receiver counts from 2000-01-01 and says {}: its time is not used",
            utc_text(said_ns)
        ),
        GpsDoubt::Weeks { said_ns, weeks } => format!(
            "the GPS receiver says {}, {weeks} weeks too early (roll-over of the GPS week): they are added",
            utc_text(said_ns)
        ),
        GpsDoubt::Far { said_ns, host_ns } => format!(
            "the GPS receiver says {}, and packets arrive at {}: the time of the receiver is used",
            utc_text(said_ns),
            utc_text(host_ns)
        ),
        GpsDoubt::Step { said_ns, by_ns } => format!(
            "the time of the GPS receiver steps by {:+} s to {}: it is not used until it has lasted",
            by_ns / 1_000_000_000,
            utc_text(said_ns)
        ),
    }
}

fn cure(doubt: &GpsDoubt) -> &'static str {
    match doubt {
        GpsDoubt::Frozen { .. } => "look at the wire of its sentences, or switch it off and on",
        GpsDoubt::Unset { .. } => "give its antenna a view of the sky",
        GpsDoubt::Weeks { .. } => "update its firmware, or exchange it",
        GpsDoubt::Far { host_ns, .. } if *host_ns < RELEASED_NS => {
            "the clock of the host that received them may not have been set: set it by NTP or PTP"
        }
        GpsDoubt::Far { .. } => "one of the two is wrong: compare both with another clock",
        GpsDoubt::Step { .. } => "look at its reception",
    }
}

/// What is doubtful, and what to do about it.
pub fn finding(doubt: &GpsDoubt) -> Finding {
    Finding::new(
        Severity::Warning,
        Topic::Clock,
        sentence(doubt),
        cure(doubt),
    )
}

/// As [`finding`], of a capture: where its times are none, [`remark`](crate::input::Capture::remark)
/// says so, and not that the receiver's are far from them.
pub fn capture_finding(doubt: &GpsDoubt) -> Option<Finding> {
    match doubt {
        GpsDoubt::Far { host_ns, .. } if *host_ns < FIRST_NS => None,
        _ => Some(finding(doubt)),
    }
}

/// What to do about a sentence that cannot be read.
pub fn cure_sentence(error: NmeaError) -> &'static str {
    match error {
        NmeaError::NotRmc => {
            "set the receiver to send $GPRMC each second: no other sentence has the date"
        }
        _ => "look at the wire of its sentences, its level and polarity",
    }
}
