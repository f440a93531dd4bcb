//! Objects as lines of JSON, as they become known.

use std::io::{self, BufWriter, Stdout, Write};

use serde::Serialize;

use super::CliError;
use super::output::rounded;
use sweepd_core::sweep::objects::{NewObjects, Object, flags, why};
use sweepd_core::sweep::{Frame, Pose};

/// An object, when it became known.
#[derive(Debug, Serialize)]
struct ObjectLine<'a> {
    sensor: &'a str,
    sequence: u64,
    known_ns: i64,
    object: u32,
    why: &'a str,
    points: u32,
    centroid_m: [f64; 3],
    min_m: [f64; 3],
    max_m: [f64; 3],
    nearest_m: f64,
    rows: [u16; 2],
    columns: [u32; 2],
    first_pixel: u32,
    azimuth_deg: [f64; 2],
    time_ns: [i64; 2],
    wide: bool,
}

/// All objects of a sweep are known.
#[derive(Debug, Serialize)]
struct LastLine<'a> {
    sensor: &'a str,
    sequence: u64,
    known_ns: i64,
    last: bool,
    partial: bool,
    no_height: bool,
    labels: &'a [u32],
}

/// Prints objects on standard output.
pub struct ObjectLines {
    out: BufWriter<Stdout>,
    frame: Frame,
}

impl ObjectLines {
    /// Prints lengths in this frame.
    pub fn new(frame: Frame) -> Self {
        let out = BufWriter::new(io::stdout());
        Self { out, frame }
    }

    /// Prints what became known of the objects of a sensor, which is mounted like this, at a time,
    /// nanoseconds since 1970.
    ///
    /// # Errors
    /// [`CliError::Stdout`].
    pub fn print(
        &mut self,
        sensor: &str,
        mount: Pose,
        new: &NewObjects<'_>,
        known_ns: i64,
    ) -> Result<(), CliError> {
        let pose = self.frame.pose(mount);
        for object in new.objects {
            self.line(&ObjectLine::new(
                sensor,
                new,
                object,
                pose.as_ref(),
                known_ns,
            ))?;
        }
        if new.flags & flags::LAST != 0 {
            self.line(&LastLine {
                sensor,
                sequence: new.sequence,
                known_ns,
                last: true,
                partial: new.flags & flags::PARTIAL != 0,
                no_height: new.flags & flags::NO_HEIGHT != 0,
                labels: new.labels,
            })?;
        }
        self.out.flush().map_err(CliError::Stdout)
    }

    fn line(&mut self, line: &impl Serialize) -> Result<(), CliError> {
        serde_json::to_writer(&mut self.out, line)
            .map_err(|error| CliError::Stdout(error.into()))?;
        self.out.write_all(b"\n").map_err(CliError::Stdout)
    }
}

impl<'a> ObjectLine<'a> {
    fn new(
        sensor: &'a str,
        new: &NewObjects<'_>,
        object: &Object,
        pose: Option<&Pose>,
        known_ns: i64,
    ) -> Self {
        let segment = &object.segment;
        let metres = |lengths: [f64; 3]| lengths.map(|length| rounded(length, 1e4));
        let [min_m, max_m] = segment.box_in(pose).map(metres);
        let degrees = |rad: f32| rounded(f64::from(rad).to_degrees(), 1e4);
        let time_ns = |after_ns: i32| new.time_ns.saturating_add(after_ns.into());
        Self {
            sensor,
            sequence: new.sequence,
            known_ns,
            object: object.ordinal,
            why: match object.why {
                why::COMPLETE => "complete",
                why::SWEEP => "sweep",
                why::WIDE => "wide",
                _ => "seam",
            },
            points: segment.points,
            centroid_m: metres(segment.centroid_in(pose)),
            min_m,
            max_m,
            nearest_m: rounded(segment.nearest_m.into(), 1e4),
            rows: [segment.row_first, segment.row_last],
            columns: [segment.column_first, segment.column_last],
            first_pixel: object.first_pixel,
            azimuth_deg: [object.azimuth_first_rad, object.azimuth_last_rad].map(degrees),
            time_ns: [object.first_ns, object.last_ns].map(time_ns),
            wide: segment.is_wide(),
        }
    }
}
