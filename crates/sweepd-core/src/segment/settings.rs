//! The numbers of a [`Config`] as people write them: one table, from which come the options of the
//! command line, the keys of the configuration file, their checks, and what a reload compares.

use std::ops::RangeInclusive;

use super::config::{CLIMB_M, Config};
use super::mount::Mount;

/// Angles that a beta test can have, degrees; the ends are none.
pub const THETA_DEG: RangeInclusive<f64> = 0.0..=90.0;
/// Limits that a range may have, metres: no sensor sees half as far.
const RANGE_M: RangeInclusive<f64> = 0.0..=1000.0;
const ANY_COUNT: f64 = u32::MAX as f64;

/// A number that people set.
#[derive(Debug)]
pub struct Setting {
    /// Key in the configuration file.
    pub key: &'static str,
    /// Table of a sensor in the configuration file that has the key.
    pub table: Table,
    /// Option of the command line, without its dashes.
    pub option: &'static str,
    /// What it means.
    pub doc: &'static str,
    /// What it is counted in.
    pub unit: Unit,
    /// Values that it can have.
    pub range: RangeInclusive<f64>,
    /// What holds where it is not set, if that is no number.
    pub absent: &'static str,
    field: fn(&mut Config) -> Field<'_>,
}

/// A table of a sensor in the configuration file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Table {
    /// `[sensor.mount]`
    Mount,
    /// `[sensor.segment]`
    Segment,
}

/// What a number is counted in.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Unit {
    /// Whole things.
    Count,
    /// Degrees.
    Degrees,
    /// Metres.
    Metres,
}

impl Unit {
    /// Its name in messages; empty for a count.
    pub fn name(self) -> &'static str {
        match self {
            Self::Count => "",
            Self::Degrees => "degrees",
            Self::Metres => "metres",
        }
    }
}

/// The place of a number in a [`Config`].
#[derive(PartialEq)]
enum Field<'a> {
    /// Radians; people write degrees.
    Angle(&'a mut f32),
    Number(&'a mut f32),
    Optional(&'a mut Option<f32>),
    /// Infinite where it is not set.
    Limit(&'a mut f32),
    Count(&'a mut u32),
}

/// All numbers that people set, in the order in which they are shown.
pub const SETTINGS: &[Setting] = &[
    Setting {
        key: "theta_deg",
        table: Table::Segment,
        option: "theta",
        doc: "Two neighbouring returns are joined only if the line through them meets the beam at more than this angle (beta \
              of the paper; method paper), degrees",
        unit: Unit::Degrees,
        range: THETA_DEG,
        absent: "",
        field: |config| Field::Angle(&mut config.theta_rad),
    },
    Setting {
        key: "min_points",
        table: Table::Segment,
        option: "min-points",
        doc: "Fewest returns of a segment",
        unit: Unit::Count,
        range: 1.0..=ANY_COUNT,
        absent: "",
        field: |config| Field::Count(&mut config.min_points),
    },
    Setting {
        key: "height_m",
        table: Table::Mount,
        option: "height",
        doc: "Height of the sensor above the ground, metres",
        unit: Unit::Metres,
        range: 0.01..=200.0,
        absent: "estimated from the floor that is seen",
        field: |config| Field::Optional(&mut config.mount.height_m),
    },
    Setting {
        key: "pitch_deg",
        table: Table::Mount,
        option: "pitch",
        doc: "Pitch of the sensor, nose up, degrees",
        unit: Unit::Degrees,
        range: -90.0..=90.0,
        absent: "",
        field: |config| Field::Angle(&mut config.mount.pitch_rad),
    },
    Setting {
        key: "roll_deg",
        table: Table::Mount,
        option: "roll",
        doc: "Roll of the sensor, right side down, degrees; 180 is head down",
        unit: Unit::Degrees,
        range: -180.0..=180.0,
        absent: "",
        field: |config| Field::Angle(&mut config.mount.roll_rad),
    },
    Setting {
        key: "climb_m",
        table: Table::Mount,
        option: "climb",
        doc: "Height of a step that the robot's wheels climb, metres; a higher one that rows strike is an object, if it is over 5 cm high",
        unit: Unit::Metres,
        range: CLIMB_M,
        absent: "",
        field: |config| Field::Number(&mut config.climb_m),
    },
    Setting {
        key: "min_range_m",
        table: Table::Segment,
        option: "min-range",
        doc: "Returns nearer than this keep their range and get label 0, metres",
        unit: Unit::Metres,
        range: RANGE_M,
        absent: "",
        field: |config| Field::Number(&mut config.min_range_m),
    },
    Setting {
        key: "max_range_m",
        table: Table::Segment,
        option: "max-range",
        doc: "Returns further than this keep their range and get label 0, metres",
        unit: Unit::Metres,
        range: RANGE_M,
        absent: "no limit",
        field: |config| Field::Limit(&mut config.max_range_m),
    },
];

/// A number of an earlier version that nothing reads any more. It is accepted with a warning, so
/// that an upgrade leaves no robot without its sensor.
#[derive(Debug)]
pub struct Removed {
    /// Key in `[sensor.segment]` of the configuration file.
    pub key: &'static str,
    /// Option of the command line, without its dashes.
    pub option: &'static str,
    /// What to do instead, or why it is not needed.
    pub instead: &'static str,
}

/// All of them.
pub const REMOVED: &[Removed] = &[
    Removed::new("gap_m", "gap", GAP),
    Removed::new("window_columns", "window-columns", WINDOW),
    Removed::new("window_rows", "window-rows", WINDOW),
    Removed::new("small_points", "small-points", SMALL),
    Removed::new("small_reach_m", "small-reach", SMALL),
    Removed::new("max_slope", "max-slope", GROUND),
    Removed::new("max_kerb_m", "max-kerb", KERB),
];

const GAP: &str = "the gap is what 2 degrees span, 0.25 m at least and 0.65 m at most";
const WINDOW: &str = "the window is chosen by the rows of the sensor";
const SMALL: &str = "what is small is told by the area that it shows to the sensor";
const KERB: &str = "`climb_m` of `[sensor.mount]`, or --climb, says what the wheels climb";
const GROUND: &str =
    "the ground is told by what lies behind a rise; only `[sensor.mount]` must be right";

impl Removed {
    const fn new(key: &'static str, option: &'static str, instead: &'static str) -> Self {
        Self {
            key,
            option,
            instead,
        }
    }

    /// The warning, where it is called by this name.
    pub fn warning(&self, name: &str) -> String {
        format!(
            "`{name}` does nothing any more, leave it out: {}",
            self.instead
        )
    }
}

impl Setting {
    /// What a configuration has, in the units of people; `None` where it is not set.
    pub fn get(&self, config: &Config) -> Option<f64> {
        let mut config = config.clone();
        match (self.field)(&mut config) {
            Field::Angle(angle) => Some((f64::from(*angle).to_degrees() * 1e4).round() / 1e4),
            Field::Number(number) => Some(as_written(*number)),
            Field::Optional(number) => number.map(as_written),
            Field::Limit(limit) => limit.is_finite().then(|| as_written(*limit)),
            Field::Count(count) => Some(f64::from(*count)),
        }
    }

    /// Sets it; the value is within [`Setting::range`], and whole where it is a count.
    pub fn set(&self, config: &mut Config, value: f64) {
        match (self.field)(config) {
            Field::Angle(angle) => *angle = value.to_radians() as f32,
            Field::Number(number) | Field::Limit(number) => *number = value as f32,
            Field::Optional(number) => *number = Some(value as f32),
            Field::Count(count) => *count = value as u32,
        }
    }

    /// True if the setting says how the sensor sits on the robot: it is of [`Mount`].
    pub fn is_of_mount(&self) -> bool {
        let mut config = Config::default();
        self.set(&mut config, *self.range.start());
        config.mount != Mount::default()
    }

    /// Whether two configurations have the same.
    pub fn is_same(&self, one: &Config, other: &Config) -> bool {
        (self.field)(&mut one.clone()) == (self.field)(&mut other.clone())
    }

    /// Sets it to what another configuration has.
    pub fn take(&self, to: &mut Config, from: &Config) {
        match ((self.field)(to), (self.field)(&mut from.clone())) {
            (Field::Angle(to), Field::Angle(from))
            | (Field::Number(to), Field::Number(from))
            | (Field::Limit(to), Field::Limit(from)) => *to = *from,
            (Field::Optional(to), Field::Optional(from)) => *to = *from,
            (Field::Count(to), Field::Count(from)) => *to = *from,
            // A setting has one kind of field.
            _ => {}
        }
    }

    /// Whether a value can be set.
    pub fn allows(&self, value: f64) -> bool {
        self.range.contains(&value) && (self.unit != Unit::Count || value.fract() == 0.0)
    }

    /// The values that can be set, for a message: `0 to 90 degrees`.
    pub fn expected(&self) -> String {
        let (least, most) = (self.range.start(), self.range.end());
        if self.unit == Unit::Count && *most == ANY_COUNT {
            return format!("a whole number from {least} on");
        }
        format!("{least} to {most} {}", self.unit.name())
            .trim_end()
            .to_owned()
    }
}

/// The shortest decimal number that is this one.
fn as_written(number: f32) -> f64 {
    number.to_string().parse().unwrap_or(number.into())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_setting_has_a_field_of_its_own_and_its_default_can_be() {
        let default = Config::default();
        for setting in SETTINGS {
            let value = setting.get(&default);
            assert_eq!(
                value.is_none(),
                !setting.absent.is_empty(),
                "{}",
                setting.key
            );
            let is_mount = ["height_m", "pitch_deg", "roll_deg"].contains(&setting.key);
            assert_eq!(setting.is_of_mount(), is_mount, "{}", setting.key);
            assert!(
                value.is_none_or(|value| setting.allows(value)),
                "{}",
                setting.key
            );
            let middle = (setting.range.start() + setting.range.end().min(100.0)) / 2.0;
            let other = if setting.unit == Unit::Count {
                middle.floor()
            } else {
                ((middle + 0.01) * 1e3).round() / 1e3
            };
            let mut changed = default.clone();
            setting.set(&mut changed, other);
            assert_eq!(setting.get(&changed), Some(other), "{}", setting.key);
            for one in SETTINGS {
                assert_eq!(one.is_same(&default, &changed), one.key != setting.key);
            }
            let mut taken = default.clone();
            setting.take(&mut taken, &changed);
            assert_eq!(taken, changed);
        }
    }
}
