//! A point cloud that PCL, Open3D and CloudCompare open: binary PCD version 0.7.

use std::io::{self, Write};

use sweepd_core::sweep::{Frame, Return, SweepRef};

/// Bytes of a point: x, y, z, intensity as f32, ring as u16, label as u32, time as f32, without
/// padding.
pub const POINT_BYTES: usize = 26;

/// Writes a point per return, in the order in which they were measured: `time` never steps back.
///
/// `intensity` is the calibrated reflectivity. `ring` counts from the lowest beam up, as ROS
/// drivers do: it is `rows - 1 - row`. `label` is 0 none, 1 ground, 2.. segment. `time` is when the
/// beam fired, seconds since the first shot of the sweep, whose time is in a comment of the header,
/// in nanoseconds since 1970; within 0.2 s it is exact to 8 ns.
///
/// # Errors
/// Those of `out`.
pub fn write_pcd(sweep: SweepRef<'_>, frame: Frame, out: &mut impl Write) -> io::Result<()> {
    let mut points = Vec::with_capacity(sweep.range.len() * POINT_BYTES);
    for found in sweep.points_by_time(frame) {
        points.extend_from_slice(&point(&found, &sweep));
    }
    let count = points.len() / POINT_BYTES;
    let time_ns = sweep.header.time_ns;
    write!(
        out,
        "# .PCD v0.7 - Point Cloud Data file format\n\
         # time 0 is {time_ns} ns since 1970\n\
         VERSION 0.7\n\
         FIELDS x y z intensity ring label time\n\
         SIZE 4 4 4 4 2 4 4\n\
         TYPE F F F F U U F\n\
         COUNT 1 1 1 1 1 1 1\n\
         WIDTH {count}\n\
         HEIGHT 1\n\
         VIEWPOINT 0 0 0 1 0 0 0\n\
         POINTS {count}\n\
         DATA binary\n"
    )?;
    out.write_all(&points)
}

fn point(found: &Return, sweep: &SweepRef<'_>) -> [u8; POINT_BYTES] {
    let [x, y, z] = found.point_m;
    let ring = (sweep.rows() - 1 - found.row) as u16;
    let time_s = found.time_ns.saturating_sub(sweep.header.time_ns) as f64 * 1e-9;
    let mut bytes = [0; POINT_BYTES];
    for (place, value) in
        bytes
            .chunks_exact_mut(4)
            .zip([x as f32, y as f32, z as f32, f32::from(found.reflectivity)])
    {
        place.copy_from_slice(&value.to_le_bytes());
    }
    bytes[16..18].copy_from_slice(&ring.to_le_bytes());
    bytes[18..22].copy_from_slice(&found.label.to_le_bytes());
    bytes[22..26].copy_from_slice(&(time_s as f32).to_le_bytes());
    bytes
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::export::test_scene::{Scene, two_beams};

    /// Splits a file into its header's words by key, and its body.
    fn split(file: &[u8]) -> (Vec<(String, String)>, &[u8]) {
        let mark = b"DATA binary\n";
        let end = file
            .windows(mark.len())
            .position(|window| window == mark)
            .unwrap()
            + mark.len();
        let header = std::str::from_utf8(&file[..end]).unwrap();
        let lines = header.lines().filter_map(|line| line.split_once(' '));
        (
            lines
                .map(|(key, value)| (key.to_owned(), value.to_owned()))
                .collect(),
            &file[end..],
        )
    }

    #[test]
    fn header_and_body_agree() {
        let scene = Scene::small();
        let mut file = Vec::new();
        write_pcd(scene.sweep(), Frame::Sensor, &mut file).unwrap();
        let (header, body) = split(&file);
        let value = |key: &str| {
            header
                .iter()
                .find(|(found, _)| found == key)
                .unwrap()
                .1
                .as_str()
        };
        let sizes: Vec<usize> = value("SIZE")
            .split(' ')
            .map(|size| size.parse().unwrap())
            .collect();
        let returns = scene
            .sweep()
            .range
            .iter()
            .filter(|&&range| range > 0.0)
            .count();
        assert_eq!(body.len(), returns * sizes.iter().sum::<usize>());
        assert_eq!(
            (value("WIDTH"), value("POINTS")),
            (returns.to_string().as_str(), returns.to_string().as_str())
        );
        for key in ["FIELDS", "SIZE", "TYPE", "COUNT"] {
            assert_eq!(value(key).split(' ').count(), 7, "{key}");
        }
    }

    /// By hand; see the CSV of the same sweep. Row 0 of two is ring 1.
    #[test]
    fn points_by_hand() {
        let mut file = Vec::new();
        write_pcd(two_beams().sweep(), Frame::Ros, &mut file).unwrap();
        assert!(file.starts_with(
            b"# .PCD v0.7 - Point Cloud Data file format\n# time 0 is 1700000000000000000 ns since 1970\n"
        ));
        let (_, body) = split(&file);
        assert_eq!(body.len(), 78);
        let float = |at: usize| f32::from_le_bytes(body[at..at + 4].try_into().unwrap());
        assert!(
            float(0).abs() < 1e-6
                && (float(4) + 1.732_050_8).abs() < 1e-6
                && (float(8) - 1.0).abs() < 1e-6
        );
        assert_eq!(
            (float(12), &body[16..22], float(22)),
            (200.0, &[1, 0, 2, 0, 0, 0][..], 500e-9)
        );
        assert!((float(52) - 10.0).abs() < 1e-6);
        assert_eq!(
            (float(64), &body[68..74], float(74)),
            (3.0, &[0, 0, 1, 0, 0, 0][..], 55_296e-9)
        );
    }
}
