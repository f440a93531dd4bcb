//! A line per return with all its properties, to compare with other drivers and for spreadsheets.

use std::io::{self, Write};

use sweepd_core::sweep::{Frame, Return, SweepRef};

/// First line of every file.
pub const HEADER: &str = "packet,block,row,column,channel,return,azimuth_deg,elevation_deg,range_m,\
                          x_m,y_m,z_m,reflectivity,time_ns,label\n";

/// Bytes collected before they are written out.
const CHUNK: usize = 1 << 16;

/// Writes [`HEADER`] and a line per return, in the order of [`SweepRef::returns`].
///
/// x, y and z are those of the frame. Angles and lengths have four decimals; the azimuth is in `0.0000..=359.9999`, and `-0.0000` does
/// not occur.
///
/// # Errors
/// Those of `out`.
pub fn write_csv(sweep: SweepRef<'_>, frame: Frame, out: &mut impl Write) -> io::Result<()> {
    let mut text = Vec::with_capacity(CHUNK + 1024);
    text.extend_from_slice(HEADER.as_bytes());
    for found in sweep.points(frame) {
        push_line(&mut text, &found);
        if text.len() >= CHUNK {
            out.write_all(&text)?;
            text.clear();
        }
    }
    out.write_all(&text)
}

fn push_line(text: &mut Vec<u8>, found: &Return) {
    push_integer(text, found.packet);
    push_integer(text, u64::from(found.block));
    for index in [found.row, found.column, found.channel] {
        push_integer(text, index as u64);
    }
    text.extend_from_slice(found.kind.name().as_bytes());
    text.push(b',');
    push_azimuth(text, found.azimuth_rad.to_degrees());
    push_decimal(text, found.elevation_rad.to_degrees());
    push_decimal(text, f64::from(found.range_m));
    for length in found.point_m {
        push_decimal(text, length);
    }
    push_integer(text, u64::from(found.reflectivity));
    push_signed(text, found.time_ns);
    push_integer(text, u64::from(found.label));
    // Removes the comma after the last field.
    text.pop();
    text.push(b'\n');
}

/// Four decimals of an angle in 0..360; 0 if it rounds to 360.
fn push_azimuth(text: &mut Vec<u8>, degrees: f64) {
    push_ten_thousandths(text, (degrees * 1e4).round().rem_euclid(360e4) as i64);
}

/// Four decimals and a comma. `write!` takes ten times as long, which would be most of the time of
/// an export.
pub(super) fn push_decimal(text: &mut Vec<u8>, value: f64) {
    if value.abs() < 1e12 {
        push_ten_thousandths(text, (value * 1e4).round() as i64);
    } else {
        // No sensor measures such values, but they must not break the file.
        text.extend_from_slice(format!("{value:.4},").as_bytes());
    }
}

fn push_ten_thousandths(text: &mut Vec<u8>, value: i64) {
    if value < 0 {
        text.push(b'-');
    }
    let magnitude = value.unsigned_abs();
    push_digits(text, magnitude / 10_000, 1);
    text.push(b'.');
    push_digits(text, magnitude % 10_000, 4);
    text.push(b',');
}

pub(super) fn push_signed(text: &mut Vec<u8>, value: i64) {
    if value < 0 {
        text.push(b'-');
    }
    push_integer(text, value.unsigned_abs());
}

pub(super) fn push_integer(text: &mut Vec<u8>, value: u64) {
    push_digits(text, value, 1);
    text.push(b',');
}

/// Decimal digits, at least `least` of them.
fn push_digits(text: &mut Vec<u8>, mut value: u64, least: usize) {
    let mut digits = [b'0'; 20];
    let mut start = digits.len();
    while value > 0 {
        start -= 1;
        digits[start] = b'0' + (value % 10) as u8;
        value /= 10;
    }
    text.extend_from_slice(&digits[start.min(digits.len() - least)..]);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::export::test_scene::{Scene, two_beams};
    use proptest::prelude::*;

    fn csv(sweep: SweepRef<'_>, frame: Frame) -> String {
        let mut out = Vec::new();
        write_csv(sweep, frame, &mut out).unwrap();
        String::from_utf8(out).unwrap()
    }

    /// By hand. Azimuth 90, elevation 30, range 2: 2 cos 30 = 1.7321 right, 2 sin 30 = 1 up.
    /// Azimuth 359.99999 rounds to the whole turn and x to nothing. In dual mode the odd block
    /// holds the strongest return.
    #[test]
    fn lines_by_hand() {
        let scene = two_beams();
        assert_eq!(
            csv(scene.sweep(), Frame::Sensor),
            "packet,block,row,column,channel,return,azimuth_deg,elevation_deg,range_m,x_m,y_m,z_m,reflectivity,\
             time_ns,label\n\
             7,4,0,0,1,last,90.0000,30.0000,2.0000,1.7321,0.0000,1.0000,200,1700000000000000500,2\n\
             7,5,0,0,1,strongest,90.0000,30.0000,1.5000,1.2990,0.0000,0.7500,100,1700000000000000500,0\n\
             7,6,1,1,0,last,0.0000,0.0000,10.0000,0.0000,10.0000,0.0000,3,1700000000000055296,1\n"
        );
        let ros = csv(scene.sweep(), Frame::Ros);
        assert!(ros.contains(",2.0000,0.0000,-1.7321,1.0000,200,"), "{ros}");
        assert!(ros.contains(",10.0000,10.0000,0.0000,0.0000,3,"), "{ros}");
    }

    /// By hand: the nose lifts (0, 10, 0) to (0, 8.6603, 5), the turn makes of it (-8.6603, 0, 5), and
    /// the place (-8.1603, 1, 6.5).
    #[test]
    fn the_mount_is_applied() {
        let mut scene = two_beams();
        scene.mount();
        let [sensor, robot, ros] = Frame::ALL.map(|frame| csv(scene.sweep(), frame));
        assert_eq!(sensor, csv(two_beams().sweep(), Frame::Sensor));
        assert!(
            robot.contains(",2.0000,1.0000,2.7321,2.3660,200,"),
            "{robot}"
        );
        assert!(
            robot.contains(",10.0000,-8.1603,1.0000,6.5000,3,"),
            "{robot}"
        );
        assert!(ros.contains(",2.0000,2.7321,-1.0000,2.3660,200,"), "{ros}");
        assert!(ros.contains(",10.0000,1.0000,8.1603,6.5000,3,"), "{ros}");
    }

    #[test]
    fn every_return_of_a_scene_is_a_line_that_says_the_same() {
        let scene = Scene::small();
        let text = csv(scene.sweep(), Frame::Sensor);
        let mut lines = text.lines().skip(1);
        for column in 0..scene.sweep().columns.len() {
            for row in 0..scene.sweep().rows() {
                let index = column * scene.sweep().rows() + row;
                let range = f64::from(scene.sweep().range[index]);
                if range == 0.0 {
                    continue;
                }
                let fields: Vec<&str> = lines.next().unwrap().split(',').collect();
                let number = |field: usize| fields[field].parse::<f64>().unwrap();
                assert_eq!(
                    (fields[2], fields[3]),
                    (row.to_string().as_str(), column.to_string().as_str())
                );
                assert_eq!(fields[14], scene.sweep().label[index].to_string());
                // The columns are a turn apart by their number; beams shoot without delay here.
                let azimuth = column as f64 * 0.9;
                assert!((number(6) - azimuth).abs() < 1e-3 && (number(8) - range).abs() < 1e-4);
                let (elevation, azimuth) = (number(7).to_radians(), azimuth.to_radians());
                assert!((number(9) - range * elevation.cos() * azimuth.sin()).abs() < 1e-3);
                assert!((number(10) - range * elevation.cos() * azimuth.cos()).abs() < 1e-3);
                assert!((number(11) - range * elevation.sin()).abs() < 1e-3);
            }
        }
        assert_eq!(lines.next(), None);
    }

    proptest! {
        #[test]
        fn decimals_are_the_nearest_four(value in prop_oneof![-1e6_f64..1e6, -2e-4_f64..2e-4]) {
            let mut text = Vec::new();
            push_decimal(&mut text, value);
            let text = String::from_utf8(text).unwrap();
            let text = text.strip_suffix(',').unwrap();
            prop_assert!((text.parse::<f64>().unwrap() - value).abs() < 0.500_1e-4);
            prop_assert_eq!(text.split_once('.').unwrap().1.len(), 4);
            prop_assert_ne!(text, "-0.0000");
        }

        #[test]
        fn an_azimuth_is_never_a_whole_turn(degrees in 0.0..=360.0_f64) {
            let mut text = Vec::new();
            push_azimuth(&mut text, degrees);
            let text = String::from_utf8(text).unwrap();
            let read: f64 = text.trim_end_matches(',').parse().unwrap();
            prop_assert!(read < 360.0 && !text.starts_with('-'));
            prop_assert!(((read - degrees + 180.0).rem_euclid(360.0) - 180.0).abs() < 1e-4);
        }
    }
}
