//! The floor that a sensor sees, in words: as the lines of a mount, and against the mount that is set.

use serde_json::{Value, json};

use sweepd_core::floor::{Floor, Sight};
use sweepd_core::segment::settings::SETTINGS;
use sweepd_core::segment::{Config, Mount};

/// Where no floor is seen, and what to do about it.
pub const NOT_SEEN: &str = "no floor is seen within 45 degrees of the mount that is set; if the sensor hangs head down, set \
     roll_deg = 180";

/// What the lines of a mount are.
pub const MOUNTED: &str = "by the floor, it is mounted like this";

/// What to do where the mount that is set is another one.
pub const CURE: &str =
    "set the mount by the floor, unless the robot stands on a slope or the sensor has come loose";

/// The lines of the daemon's configuration that give this mount, and the spread as a comment.
pub fn lines(floor: &Floor) -> String {
    let keys = keys(floor).join("\n");
    format!("[sensor.mount]\n{keys}\n# {}\n", spread(floor))
}

/// The same in one line.
pub fn line(floor: &Floor) -> String {
    format!(
        "mount = {{ {} }}  # {}",
        keys(floor).join(", "),
        spread(floor)
    )
}

fn keys(floor: &Floor) -> [String; 3] {
    let [height_m, pitch_deg, roll_deg] = numbers(floor);
    [
        format!("height_m = {height_m:.3}"),
        format!("pitch_deg = {pitch_deg:.1}"),
        format!("roll_deg = {roll_deg:.1}"),
    ]
}

/// Height, pitch and roll.
fn numbers(floor: &Floor) -> [f64; 3] {
    let [pitch_deg, mut roll_deg] = [floor.pitch_rad, floor.roll_rad].map(f32::to_degrees);
    // Half a turn has one name.
    if roll_deg < -179.95 {
        roll_deg += 360.0;
    }
    [
        rounded(floor.height_m, 1e3),
        rounded(pitch_deg, 10.0),
        rounded(roll_deg, 10.0),
    ]
}

/// How sure it is.
fn spread(floor: &Floor) -> String {
    let seen = match (floor.sweeps, floor.looks) {
        (1, 1) => return "by one sweep".to_owned(),
        (sweeps, looks) => format!("in {sweeps} of {looks} sweeps"),
    };
    let [pitch_deg, roll_deg] =
        [floor.pitch_spread_rad, floor.roll_spread_rad].map(f32::to_degrees);
    format!(
        "spread {:.3} m, {pitch_deg:.2} and {roll_deg:.2} degrees, {seen}",
        floor.height_spread_m
    )
}

/// With no minus before a 0.
fn rounded(number: f32, per_unit: f64) -> f64 {
    (f64::from(number) * per_unit).round() / per_unit + 0.0
}

/// What is wrong with the mount that is set; `None` if it is that of the floor, within 2 degrees and a
/// tenth of the height.
pub fn difference(floor: &Floor, set: &Mount) -> Option<String> {
    if !floor.differs_from(set) {
        return None;
    }
    let config = Config {
        mount: *set,
        ..Config::default()
    };
    let mut said = Vec::new();
    for setting in SETTINGS.iter().filter(|one| one.is_of_mount()) {
        if let Some(value) = setting.get(&config) {
            said.push(format!("{} = {value}", setting.key));
        }
    }
    Some(format!(
        "the mount is set to {}, and the floor says {}",
        said.join(", "),
        keys(floor).join(", ")
    ))
}

/// The same for programs.
pub fn json(sight: &Sight, set: &Mount) -> Value {
    match sight {
        Sight::Unknown => Value::Null,
        Sight::NoFloor => json!({ "lines": null, "trouble": NOT_SEEN }),
        Sight::Floor(floor) => {
            let [height_m, pitch_deg, roll_deg] = numbers(floor);
            json!({
                "height_m": height_m,
                "pitch_deg": pitch_deg,
                "roll_deg": roll_deg,
                "lines": lines(floor),
                "trouble": difference(floor, set),
            })
        }
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;
    use crate::daemon::config as daemon;

    fn floor() -> Floor {
        Floor {
            height_m: 0.4119,
            pitch_rad: (-10.04_f32).to_radians(),
            roll_rad: (-0.02_f32).to_radians(),
            height_spread_m: 0.0021,
            pitch_spread_rad: 0.05_f32.to_radians(),
            roll_spread_rad: 0.04_f32.to_radians(),
            sweeps: 14,
            looks: 15,
            doubt: None,
        }
    }

    #[test]
    fn the_lines_are_those_of_a_configuration() {
        let expected = "[sensor.mount]\nheight_m = 0.412\npitch_deg = -10.0\nroll_deg = 0.0\n\
                        # spread 0.002 m, 0.05 and 0.04 degrees, in 14 of 15 sweeps\n";
        assert_eq!(lines(&floor()), expected);
        let one = Floor {
            sweeps: 1,
            looks: 1,
            ..floor()
        };
        assert!(lines(&one).ends_with("\n# by one sweep\n"));
        let sensor = "[[sensor]]\nname = \"roof\"\naddress = \"192.168.1.201\"\n";
        for mount in [expected, &line(&floor())] {
            let text = format!("{sensor}{mount}\n");
            let config = daemon::Config::parse(Path::new("sweepd.toml"), &text).unwrap();
            let mount = config.sensors[0].pipeline.segment.mount;
            assert!(mount.height_m == Some(0.412) && !floor().differs_from(&mount));
        }
    }

    #[test]
    fn a_mount_that_is_off_is_told_beside_the_floor() {
        assert_eq!(difference(&floor(), &floor().mount()), None);
        assert_eq!(
            difference(&floor(), &Mount::default()).unwrap(),
            "the mount is set to pitch_deg = 0, roll_deg = 0, and the floor says height_m = 0.412, pitch_deg = -10.0, \
             roll_deg = 0.0"
        );
    }
}
