//! The table of segments, a line each.

use std::io::{self, Write};
use std::path::Path;

use super::csv::{push_decimal, push_integer, push_signed};
use sweepd_core::sweep::{Frame, Pose, Segment, SweepRef};

/// First line of a table as CSV; also the keys of a line of JSON, in their order.
pub const HEADER: &str = "sensor,seq,time_ns,label,points,centroid_x_m,centroid_y_m,centroid_z_m,min_x_m,min_y_m,min_z_m,\
                          max_x_m,max_y_m,max_z_m,nearest_m,azimuth_first_deg,azimuth_last_deg,row_first,row_last,\
                          column_first,column_last,wide\n";

/// How a table is written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TableFormat {
    /// [`HEADER`], then a line of numbers a segment.
    Csv,
    /// A JSON object a segment, without a header.
    Jsonl,
}

impl TableFormat {
    /// The format of a file, by the ending of its name.
    pub fn of(path: &Path) -> Option<Self> {
        match path.extension()?.to_str()? {
            "csv" => Some(Self::Csv),
            "jsonl" => Some(Self::Jsonl),
            _ => None,
        }
    }

    /// What stands before the first line.
    pub fn header(self) -> &'static str {
        match self {
            Self::Csv => HEADER,
            Self::Jsonl => "",
        }
    }
}

/// A value of a line.
enum Value<'a> {
    Text(&'a str),
    Count(u64),
    Time(i64),
    Decimal(f64),
    Flag(bool),
}

/// Writes a line for each segment of a sweep, in the order of their labels. `sensor` is its name, or
/// the source of its packets where it has none; `seq` is the number of the sweep.
///
/// Lengths are metres in the frame, angles degrees, both with four decimals; `time_ns` is that of the
/// sweep's first shot. `points` counts the pixels with a return in the segmented plane, `nearest_m`
/// is the range of the nearest of them. The azimuths are those of the first and the last column in
/// the sense of rotation, at their first shots; where the segment lies across the seam, the first
/// is the greater.
///
/// # Errors
/// Those of `out`.
pub fn write_segments(
    sweep: SweepRef<'_>,
    frame: Frame,
    format: TableFormat,
    out: &mut impl Write,
) -> io::Result<()> {
    let mut text = Vec::new();
    let pose = frame.pose(Pose::of_mount(sweep.header));
    for segment in sweep.segments {
        push_line(&mut text, &values(&sweep, segment, pose.as_ref()), format);
    }
    out.write_all(&text)
}

/// In the order of [`HEADER`].
fn values<'a>(sweep: &SweepRef<'a>, segment: &Segment, pose: Option<&Pose>) -> [Value<'a>; 22] {
    let centroid = segment.centroid_in(pose);
    let [least, greatest] = segment.box_in(pose);
    [
        Value::Text(sweep.header.sensor_name()),
        Value::Count(sweep.header.sequence),
        Value::Time(sweep.header.time_ns),
        Value::Count(segment.label.into()),
        Value::Count(segment.points.into()),
        Value::Decimal(centroid[0]),
        Value::Decimal(centroid[1]),
        Value::Decimal(centroid[2]),
        Value::Decimal(least[0]),
        Value::Decimal(least[1]),
        Value::Decimal(least[2]),
        Value::Decimal(greatest[0]),
        Value::Decimal(greatest[1]),
        Value::Decimal(greatest[2]),
        Value::Decimal(segment.nearest_m.into()),
        Value::Decimal(azimuth_deg(sweep, segment.column_first)),
        Value::Decimal(azimuth_deg(sweep, segment.column_last)),
        Value::Count(segment.row_first.into()),
        Value::Count(segment.row_last.into()),
        Value::Count(segment.column_first.into()),
        Value::Count(segment.column_last.into()),
        Value::Flag(segment.is_wide()),
    ]
}

/// The azimuth of a column to four decimals, 0 if it rounds to 360; NaN if the sweep has no such
/// column.
fn azimuth_deg(sweep: &SweepRef<'_>, column: u32) -> f64 {
    let Some(column) = sweep.columns.get(column as usize) else {
        return f64::NAN;
    };
    let degrees = f64::from(column.azimuth_rad).to_degrees();
    (degrees * 1e4).round().rem_euclid(360e4) / 1e4
}

fn push_line(text: &mut Vec<u8>, values: &[Value<'_>], format: TableFormat) {
    let is_json = format == TableFormat::Jsonl;
    if is_json {
        text.push(b'{');
    }
    for (key, value) in HEADER.trim_end().split(',').zip(values) {
        if is_json {
            text.extend_from_slice(format!("\"{key}\":").as_bytes());
        }
        match *value {
            Value::Text(word) if is_json => {
                text.extend_from_slice(serde_json::Value::from(word).to_string().as_bytes());
                text.push(b',');
            }
            Value::Text(word) => {
                text.extend_from_slice(word.as_bytes());
                text.push(b',');
            }
            Value::Count(count) => push_integer(text, count),
            Value::Time(time_ns) => push_signed(text, time_ns),
            // JSON has no such numbers.
            Value::Decimal(number) if is_json && !number.is_finite() => {
                text.extend_from_slice(b"null,")
            }
            Value::Decimal(number) => push_decimal(text, number),
            Value::Flag(flag) => text.extend_from_slice(format!("{flag},").as_bytes()),
        }
    }
    // Removes the comma after the last value.
    text.pop();
    text.extend_from_slice(if is_json { b"}\n" } else { b"\n" });
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::export::test_scene::{Scene, two_beams};
    use sweepd_core::sweep::layout::segment_flags;

    fn written(sweep: SweepRef<'_>, frame: Frame, format: TableFormat) -> String {
        let mut out = Vec::new();
        write_segments(sweep, frame, format, &mut out).unwrap();
        String::from_utf8(out).unwrap()
    }

    /// A box before the sensor and to its left, across the seam.
    fn scene() -> Scene {
        let mut scene = two_beams();
        scene.fill(|sweep| {
            (sweep.header.segments, sweep.header.sequence) = (1, 7);
            let segment = &mut sweep.segments[0];
            (segment.label, segment.points, segment.nearest_m) = (2, 31, 5.25);
            segment.flags = segment_flags::WIDE;
            (segment.min_m, segment.max_m) = ([-1.0, 5.0, -0.5], [-0.25, 6.0, 1.5]);
            segment.centroid_m = [-0.5, 5.5, 0.000_04];
            (
                segment.row_first,
                segment.row_last,
                segment.column_first,
                segment.column_last,
            ) = (0, 1, 1, 0);
        });
        scene
    }

    /// By hand. Turned to the axes of ROS, forward is x and left y.
    #[test]
    fn lines_by_hand() {
        let scene = scene();
        let csv = written(scene.sweep(), Frame::Sensor, TableFormat::Csv);
        assert_eq!(
            csv,
            "192.168.1.201:2368,7,1700000000000000000,2,31,-0.5000,5.5000,0.0000,-1.0000,5.0000,-0.5000,-0.2500,6.0000,\
             1.5000,5.2500,0.0000,90.0000,0,1,1,0,true\n"
        );
        let json = written(scene.sweep(), Frame::Ros, TableFormat::Jsonl);
        assert_eq!(
            json,
            "{\"sensor\":\"192.168.1.201:2368\",\"seq\":7,\"time_ns\":1700000000000000000,\"label\":2,\"points\":31,\
             \"centroid_x_m\":5.5000,\"centroid_y_m\":0.5000,\"centroid_z_m\":0.0000,\"min_x_m\":5.0000,\
             \"min_y_m\":0.2500,\"min_z_m\":-0.5000,\"max_x_m\":6.0000,\"max_y_m\":1.0000,\"max_z_m\":1.5000,\
             \"nearest_m\":5.2500,\"azimuth_first_deg\":0.0000,\"azimuth_last_deg\":90.0000,\"row_first\":0,\
             \"row_last\":1,\"column_first\":1,\"column_last\":0,\"wide\":true}\n"
        );
    }

    /// By hand. The nose up: y 0.8660 y - 0.5 z, from 3.5801 to 5.4462, and z 0.5 y + 0.8660 z, from
    /// 2.0670 to 4.2990. To the left: x is -y, and y is x. Then the place.
    #[test]
    fn the_box_is_around_its_corners_where_the_mount_is() {
        let mut scene = scene();
        scene.mount();
        let told = |frame| {
            let csv = written(scene.sweep(), frame, TableFormat::Csv);
            csv.splitn(6, ',').nth(5).unwrap().to_owned()
        };
        let robot = "-4.2631,0.5000,4.2500,-4.9462,0.0000,3.5670,-3.0801,0.7500,5.7990,";
        assert!(
            told(Frame::Robot).starts_with(robot),
            "{}",
            told(Frame::Robot)
        );
        let ros = "0.5000,4.2631,4.2500,0.0000,3.0801,3.5670,0.7500,4.9462,5.7990,";
        assert!(told(Frame::Ros).starts_with(ros), "{}", told(Frame::Ros));
        let boxes: Vec<_> = scene.sweep().boxes(Frame::Ros).collect();
        let expected = [[0.0, 3.080_127, 3.566_987], [0.75, 4.946_152, 5.799_038]];
        let pairs = boxes[0].as_flattened().iter().zip(expected.as_flattened());
        assert!(
            boxes.len() == 1
                && pairs
                    .into_iter()
                    .all(|(one, other)| (one - other).abs() < 1e-6)
        );
    }

    /// A sweep from shared memory may hold anything.
    #[test]
    fn lines_of_any_table_can_be_read() {
        for seed in 0..20 {
            let scene = Scene::random(3, 5, true, seed);
            let segments = scene.sweep().segments.len();
            let json = written(scene.sweep(), Frame::Ros, TableFormat::Jsonl);
            assert!(
                json.lines()
                    .all(|line| serde_json::from_str::<serde_json::Value>(line).is_ok()),
                "{json}"
            );
            let csv = written(scene.sweep(), Frame::Sensor, TableFormat::Csv);
            assert!(
                csv.lines()
                    .all(|line| line.split(',').count() == HEADER.split(',').count()),
                "{csv}"
            );
            assert_eq!(
                (json.lines().count(), csv.lines().count()),
                (segments, segments)
            );
        }
    }
}
