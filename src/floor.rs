//! The floor that a sensor sees, in words: as the lines of a mount, and against the mount that is set.

use serde_json::{Value, json};

use crate::judge::{Finding, Severity, Topic};
use sweepd_core::floor::{Floor, Sight};
use sweepd_core::segment::settings::SETTINGS;
use sweepd_core::segment::{Config, Mount};
use sweepd_core::sweep::Header;
use sweepd_core::sweep::height::{HEIGHT_CURE, HeightDoubt};
use sweepd_core::sweep::layout::flags;

/// What the lines of a mount are.
pub const MOUNTED: &str = "by the floor, it is mounted like this";

/// What to do where the mount that is set is another one.
pub const CURE: &str =
    "set the mount by the floor, unless the robot stands on a slope or the sensor has come loose";

/// A mount whose height spreads by so much between sweeps is not proposed, metres.
const SPREAD_M: f32 = 0.1;

/// What is seen of the floor, and what is set.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Seen {
    /// What is seen.
    pub sight: Sight,
    /// The mount that is set; `None` where nobody has said anything of it.
    pub set: Option<Mount>,
    /// Whether labels take the height of the floor that is seen.
    pub is_estimated: bool,
}

impl Seen {
    /// What is seen of the floor below a sensor with this configuration.
    pub fn new(sight: Sight, config: &Config) -> Self {
        Self {
            sight,
            set: Some(config.mount),
            is_estimated: config.estimates_height(),
        }
    }

    /// What is to be told: a doubt about the height that labels take, a mount that is not that of the
    /// floor or cannot be held against it, or as a note the mount that the floor gives.
    pub fn finding(&self) -> Option<Finding> {
        let note = |what, cure| Some(Finding::new(Severity::Note, Topic::Mount, what, cure));
        match (self.sight, self.sight.doubt()) {
            (Sight::Floor(floor), None) => {
                let line = line(&floor);
                match self.set.and_then(|set| difference(&floor, &set)) {
                    Some(what) => {
                        let cure = line.map_or(CURE.to_owned(), |line| format!("{CURE}: {line}"));
                        let warning = Finding::new(Severity::Warning, Topic::Mount, what, cure);
                        Some(warning)
                    }
                    None => note(MOUNTED.to_owned(), line?),
                }
            }
            (sight, Some(doubt)) if self.is_estimated => {
                Some(in_doubt(doubt, sight.height_m().unwrap_or_default()))
            }
            (_, Some(doubt)) => note(
                format!("the mount that is set cannot be checked by the floor: {doubt}"),
                String::new(),
            ),
            (_, None) => None,
        }
    }

    /// The doubt about the height that labels take, in a sentence.
    pub fn doubt(&self) -> Option<String> {
        let finding = self.finding()?;
        (self.is_estimated && self.sight.doubt().is_some()).then_some(finding.what)
    }

    /// The same for programs.
    pub fn json(&self) -> Value {
        let floor = match &self.sight {
            Sight::Unknown => return Value::Null,
            Sight::NoFloor { .. } => None,
            Sight::Floor(floor) => Some(floor),
        };
        let [height_m, pitch_deg, roll_deg] =
            floor.map(numbers).map_or([None; 3], |all| all.map(Some));
        let trouble = self.finding().map(|finding| finding.what);
        json!({
            "height_m": height_m,
            "pitch_deg": pitch_deg,
            "roll_deg": roll_deg,
            "lines": floor.and_then(lines),
            "trouble": trouble.filter(|what| what != MOUNTED),
            "doubt": self.doubt(),
        })
    }
}

/// The mount that is set, by the header of a sweep.
pub fn mount_of(header: &Header) -> Mount {
    let is_set = header.height_m > 0.0 && !header.has(flags::HEIGHT_ESTIMATED);
    Mount {
        height_m: is_set.then_some(header.height_m),
        pitch_rad: header.pitch_rad,
        roll_rad: header.roll_rad,
    }
}

/// What is in doubt about the height that the labels of a sweep took.
pub fn of_header(header: &Header) -> Option<Finding> {
    HeightDoubt::of(header).map(|doubt| in_doubt(doubt, header.height_m))
}

fn in_doubt(doubt: HeightDoubt, height_m: f32) -> Finding {
    Finding::new(
        Severity::Warning,
        Topic::Mount,
        doubt.finding(height_m),
        HEIGHT_CURE,
    )
}

/// The height that labels take, how that comes, and the floor that is seen, in one line.
pub fn height(sight: &Sight, set: &Mount) -> String {
    let taken = match (set.height_m, sight) {
        (Some(height_m), _) => format!("{height_m:.2} m, as set"),
        (None, Sight::Unknown) => return "not known: no whole turn was looked at".to_owned(),
        (None, Sight::NoFloor { .. }) => {
            return sight
                .doubt()
                .map_or_else(String::new, |doubt| doubt.finding(0.0));
        }
        (None, Sight::Floor(floor)) => {
            let doubt = floor.doubt.map_or("", |_| ", in doubt");
            let [pitch_deg, roll_deg] = [set.pitch_rad, set.roll_rad].map(degrees);
            let tilt = match pitch_deg == 0.0 && roll_deg == 0.0 {
                true => "level".to_owned(),
                false => format!("with pitch {pitch_deg} and roll {roll_deg}"),
            };
            format!("{:.2} m{doubt}, taken {tilt}", floor.height_m)
        }
    };
    match sight {
        Sight::Unknown => taken,
        Sight::NoFloor { .. } => format!("{taken}; no floor is seen"),
        Sight::Floor(floor) => {
            let [height_m, pitch_deg, roll_deg] = numbers(floor);
            format!(
                "{taken}; by the floor {height_m:.3} m, pitch {pitch_deg:.1}, roll {roll_deg:.1}"
            )
        }
    }
}

/// The lines of the daemon's configuration that give this mount, and how sure it is as a comment;
/// `None` where sweeps differ so much that it is not to be copied.
pub fn lines(floor: &Floor) -> Option<String> {
    let keys = keys(floor)?.join("\n");
    Some(format!("[sensor.mount]\n{keys}\n# {}\n", certainty(floor)))
}

/// The same in one line.
fn line(floor: &Floor) -> Option<String> {
    let keys = keys(floor)?.join(", ");
    Some(format!("mount = {{ {keys} }}  # {}", certainty(floor)))
}

fn keys(floor: &Floor) -> Option<[String; 3]> {
    (floor.height_spread_m < SPREAD_M).then(|| values(floor))
}

fn values(floor: &Floor) -> [String; 3] {
    let [height_m, pitch_deg, roll_deg] = numbers(floor);
    [
        format!("height_m = {height_m:.3}"),
        format!("pitch_deg = {pitch_deg:.1}"),
        format!("roll_deg = {roll_deg:.1}"),
    ]
}

/// Height, pitch and roll.
fn numbers(floor: &Floor) -> [f64; 3] {
    let mut roll_deg = degrees(floor.roll_rad);
    // Half a turn has one name.
    if roll_deg == -180.0 {
        roll_deg = 180.0;
    }
    [
        rounded(floor.height_m, 1e3),
        degrees(floor.pitch_rad),
        roll_deg,
    ]
}

/// An angle in degrees, to a tenth.
fn degrees(angle_rad: f32) -> f64 {
    rounded(angle_rad.to_degrees(), 10.0)
}

/// How sure it is.
fn certainty(floor: &Floor) -> String {
    let doubt = match floor.doubt {
        Some(doubt) => format!("in doubt: {doubt}; "),
        None => String::new(),
    };
    let seen = match (floor.sweeps, floor.looks) {
        (0, _) => return format!("{doubt}by less than a turn"),
        (1, 1) => return format!("{doubt}by one sweep"),
        (sweeps, looks) => format!("in {sweeps} of {looks} sweeps"),
    };
    let [pitch_deg, roll_deg] =
        [floor.pitch_spread_rad, floor.roll_spread_rad].map(f32::to_degrees);
    format!(
        "{doubt}spread {:.3} m, {pitch_deg:.2} and {roll_deg:.2} degrees, {seen}",
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
        values(floor).join(", ")
    ))
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;
    use crate::daemon::config as daemon;
    use sweepd_core::segment::Method;

    const NONE: Sight = Sight::NoFloor {
        is_contradicted: false,
    };

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
        assert_eq!(lines(&floor()).unwrap(), expected);
        let one = Floor {
            sweeps: 1,
            looks: 1,
            ..floor()
        };
        assert!(lines(&one).unwrap().ends_with("\n# by one sweep\n"));
        let sensor = "[[sensor]]\nname = \"roof\"\naddress = \"192.168.1.201\"\n";
        for mount in [expected, &line(&floor()).unwrap()] {
            let text = format!("{sensor}{mount}\n");
            let config = daemon::Config::parse(Path::new("sweepd.toml"), &text).unwrap();
            let mount = config.sensors[0].pipeline.segment.mount;
            assert!(mount.height_m == Some(0.412) && !floor().differs_from(&mount));
        }
    }

    const FEW: HeightDoubt = HeightDoubt::FewReturns {
        columns: 13,
        seen: 512,
        directions: 2,
    };

    fn seen(doubt: Option<HeightDoubt>, set: Mount) -> Seen {
        let config = Config {
            mount: set,
            ..Config::default()
        };
        let floor = Floor { doubt, ..floor() };
        Seen::new(Sight::Floor(floor), &config)
    }

    /// What is told, and whether it is a warning.
    fn told(seen: &Seen) -> (String, bool) {
        let finding = seen.finding().unwrap();
        (finding.to_string(), finding.is_trouble())
    }

    #[test]
    fn a_mount_that_is_off_is_told_beside_the_floor() {
        let is_mounted = seen(None, floor().mount());
        let (what, is_warning) = told(&is_mounted);
        assert_eq!(what, format!("{MOUNTED}: {}", line(&floor()).unwrap()));
        assert!(!is_warning && is_mounted.json()["trouble"].is_null());
        let off = seen(None, Mount::default());
        let difference = "the mount is set to pitch_deg = 0, roll_deg = 0, and the floor says height_m = 0.412, \
                          pitch_deg = -10.0, roll_deg = 0.0";
        let expected = format!("{difference}: {CURE}: {}", line(&floor()).unwrap());
        assert_eq!(told(&off), (expected, true));
        let json = off.json();
        assert!(json["trouble"] == difference && json["doubt"].is_null());
        assert_eq!(json["lines"], lines(&floor()).unwrap());
        // Nobody has said what it should be.
        let unsaid = Seen { set: None, ..off };
        assert_eq!(told(&unsaid), told(&is_mounted));
    }

    #[test]
    fn a_height_in_doubt_is_a_warning_where_it_is_taken_and_beside_the_lines() {
        let doubted = seen(Some(FEW), Mount::default());
        let words = "the height is a guess: 0.41 m; few returns show it: 13 of 512 columns, 2 of 16 directions";
        assert_eq!(told(&doubted), (format!("{words}: set height_m"), true));
        let json = doubted.json();
        assert!(json["doubt"] == words && json["trouble"] == words);
        let lines = json["lines"].as_str().unwrap();
        assert!(lines.contains(&format!("\n# in doubt: {FEW}; spread 0.002 m")));
        assert_eq!(json["height_m"], 0.412);
        let set = Mount {
            height_m: Some(2.0),
            ..Mount::default()
        };
        let unchecked = seen(Some(FEW), set);
        let (what, is_warning) = told(&unchecked);
        assert!(what.ends_with(&FEW.to_string()) && !what.contains("set height_m") && !is_warning);
        assert!(unchecked.json()["doubt"].is_null());
        for seen in [doubted, unchecked] {
            let none = Seen {
                sight: NONE,
                ..seen
            };
            let what = match seen.is_estimated {
                true => {
                    "no floor is seen: everything is an obstacle; no level surface is in sight: set height_m"
                }
                false => {
                    "the mount that is set cannot be checked by the floor: no level surface is in sight"
                }
            };
            assert_eq!(told(&none), (what.to_owned(), seen.is_estimated));
        }
        // A spread of decimetres.
        let wide = Floor {
            height_spread_m: 0.1,
            ..floor()
        };
        let sight = Sight::Floor(wide);
        assert!(Seen { sight, ..doubted }.json()["lines"].is_null());
        assert_eq!(told(&Seen { sight, ..doubted }).0.lines().count(), 1);
        assert!(told(&Seen { sight, ..doubted }).0.ends_with(CURE));
        assert_eq!(
            Seen {
                sight,
                set: None,
                ..doubted
            }
            .finding(),
            None
        );
    }

    #[test]
    fn what_takes_no_height_from_the_floor_has_no_doubt_about_it() {
        for config in [
            Config {
                method: Method::Paper,
                ..Config::default()
            },
            Config {
                mount: Mount {
                    roll_rad: 1.5,
                    ..Mount::default()
                },
                ..Config::default()
            },
        ] {
            let seen = Seen::new(NONE, &config);
            assert!(!told(&seen).1 && seen.doubt().is_none());
        }
    }

    #[test]
    fn the_height_is_told_as_it_is_taken_and_by_the_floor() {
        let level = Mount::default();
        let tilted = Mount {
            height_m: None,
            ..floor().mount()
        };
        let set = Mount {
            height_m: Some(1.5),
            ..level
        };
        let by_floor = "by the floor 0.412 m, pitch -10.0, roll 0.0";
        let sure = Sight::Floor(floor());
        let doubted = Sight::Floor(Floor {
            doubt: Some(FEW),
            ..floor()
        });
        for (sight, set, words) in [
            (sure, level, format!("0.41 m, taken level; {by_floor}")),
            (
                sure,
                tilted,
                format!("0.41 m, taken with pitch -10 and roll 0; {by_floor}"),
            ),
            (
                doubted,
                level,
                format!("0.41 m, in doubt, taken level; {by_floor}"),
            ),
            (sure, set, format!("1.50 m, as set; {by_floor}")),
            (NONE, set, "1.50 m, as set; no floor is seen".to_owned()),
            (
                NONE,
                level,
                "no floor is seen: everything is an obstacle; no level surface is in sight"
                    .to_owned(),
            ),
            (Sight::Unknown, set, "1.50 m, as set".to_owned()),
        ] {
            assert_eq!(height(&sight, &set), words);
        }
    }
}
