//! Settings of a sensor: what it should be set to, and what it is set to by its web interface or by
//! its packets. Pure.
//!
//! VLP-16 User Manual 63-9243 Rev. D, chapters 6 (phase lock) and 10 (web interface); VLP-32C User
//! Manual 63-9325, the same chapters.

use std::fmt;
use std::net::Ipv4Addr;
use std::str::FromStr;

use serde::{Serialize, Serializer};
use sweepd_core::sweep::layout::flags;
use sweepd_core::wire::data::ReturnMode;

/// How far an edge of the field of view may be from where it is set, degrees: a packet or two of a
/// fast head.
const EDGE_DEG: i32 = 2;
/// Fields of view of at least this many degrees are whole turns: 0 to 359 leaves nothing out.
const WHOLE_DEG: i32 = 358;

/// Settings of a sensor; `None` where one is unknown, or where any will do.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Settings {
    /// Speed of the head.
    pub rpm: Option<Rpm>,
    /// Which returns it sends.
    pub returns: Option<Returns>,
    /// What it measures of a turn.
    pub fov: Option<FieldOfView>,
    /// Whether its lasers are on.
    pub laser: Option<Switch>,
    /// Where it sends its packets to.
    pub host: Option<Host>,
    /// The port that it sends data packets to.
    pub data_port: Option<Port>,
    /// The port that it sends position packets to.
    pub position_port: Option<Port>,
    /// Where its head is at the pulse per second.
    pub phase_lock: Option<PhaseLock>,
}

/// A setting that is not as it should be.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Difference {
    /// Its name, that of an option of `sweepd sensor`.
    pub name: &'static str,
    /// What it is; `None` if that is unknown.
    pub found: Option<String>,
    /// What it should be.
    pub wanted: String,
}

/// Such as `rpm 600 -> 1200`.
impl fmt::Display for Difference {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let found = self.found.as_deref().unwrap_or("unknown");
        write!(f, "{} {found} -> {}", self.name, self.wanted)
    }
}

impl Settings {
    /// Names and values of all settings, in the order in which they are shown and set.
    pub fn list(&self) -> [(&'static str, Option<String>); 8] {
        [
            ("laser", text(&self.laser)),
            ("returns", text(&self.returns)),
            ("rpm", text(&self.rpm)),
            ("fov", text(&self.fov)),
            ("phase-lock", text(&self.phase_lock)),
            // Last, because packets may come to this host no more.
            ("position-port", text(&self.position_port)),
            ("data-port", text(&self.data_port)),
            ("host", text(&self.host)),
        ]
    }

    /// In what a sensor with these other settings differs from these.
    pub fn differences(&self, found: &Self) -> Vec<Difference> {
        let mut differences = Vec::new();
        for ((name, wanted), (_, found)) in self.list().into_iter().zip(found.list()) {
            if let Some(wanted) = wanted
                && found.as_ref() != Some(&wanted)
            {
                differences.push(Difference {
                    name,
                    found,
                    wanted,
                });
            }
        }
        differences
    }

    /// What packets show to be other than these settings, by name and in words, but for the speed,
    /// which is measured and never exactly as it is set.
    pub fn unlike(
        &self,
        returns: ReturnMode,
        fov: Option<FieldOfView>,
    ) -> Vec<(&'static str, String)> {
        let mut unlike = Vec::new();
        if let Some(wanted) = self.returns.filter(|wanted| wanted.0 != returns) {
            let what = format!("sends returns {returns}, wanted is {wanted}");
            unlike.push(("returns", what));
        }
        if let (Some(wanted), Some(fov)) = (self.fov, fov)
            && !fov.is_like(wanted)
        {
            let what = format!("measures from {fov} degrees, wanted is {wanted}");
            unlike.push(("fov", what));
        }
        unlike
    }

    /// The options of `sweepd sensor ADDR set` for some settings.
    pub fn options(differences: &[Difference]) -> String {
        let options: Vec<String> = differences
            .iter()
            .map(|one| format!("--{} {}", one.name, one.wanted))
            .collect();
        options.join(" ")
    }
}

/// Such as `returns dual, rpm 600`, or `none`.
impl fmt::Display for Settings {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let set: Vec<String> = self
            .list()
            .into_iter()
            .filter_map(|(name, value)| Some(format!("{name} {}", value?)))
            .collect();
        match set.is_empty() {
            true => f.write_str("none"),
            false => f.write_str(&set.join(", ")),
        }
    }
}

fn text(value: &Option<impl ToString>) -> Option<String> {
    value.as_ref().map(ToString::to_string)
}

/// Turns a minute.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct Rpm(pub u16);

impl Rpm {
    /// Speeds that a Velodyne can be set to.
    pub const RANGE: std::ops::RangeInclusive<i64> = 300..=1200;
    /// Speeds of a sensor with a web interface are multiples of this.
    pub const STEP: i64 = 60;
}

impl FromStr for Rpm {
    type Err = &'static str;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let rpm = text.parse::<u16>().ok();
        let rpm = rpm
            .filter(|&rpm| Self::RANGE.contains(&rpm.into()) && i64::from(rpm) % Self::STEP == 0);
        rpm.map(Self)
            .ok_or("expected 300 to 1200 turns a minute, a multiple of 60")
    }
}

/// Which returns are sent.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Returns(pub ReturnMode);

impl FromStr for Returns {
    type Err = &'static str;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        match text {
            "strongest" => Ok(Self(ReturnMode::Strongest)),
            "last" => Ok(Self(ReturnMode::Last)),
            "dual" => Ok(Self(ReturnMode::Dual)),
            _ => Err("expected strongest, last or dual"),
        }
    }
}

/// The azimuths that are measured, from the first clockwise to the last, degrees 0 to 359.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FieldOfView {
    /// The first.
    pub start_deg: u16,
    /// The last.
    pub end_deg: u16,
}

impl FieldOfView {
    /// All of a turn.
    pub const WHOLE: Self = Self {
        start_deg: 0,
        end_deg: 359,
    };

    /// What a sensor measures by [`flags`] of a sweep, and by
    /// [`Status::field_of_view_deg`](sweepd_core::pipeline::Status::field_of_view_deg); `None`
    /// if they do not tell.
    pub fn measured(header_flags: u32, limits_deg: Option<(f64, f64)>) -> Option<Self> {
        if header_flags & flags::CIRCULAR != 0 {
            return Some(Self::WHOLE);
        }
        let (start, end) = limits_deg?;
        Some(Self {
            start_deg: start.round().rem_euclid(360.0) as u16,
            end_deg: end.round().rem_euclid(360.0) as u16,
        })
    }

    /// Whether it is a whole turn; equal start and end mean no limit.
    pub fn is_whole(self) -> bool {
        let width = (i32::from(self.end_deg) - i32::from(self.start_deg)).rem_euclid(360);
        width == 0 || width >= WHOLE_DEG
    }

    /// Whether it is the same within what can be measured.
    pub fn is_like(self, other: Self) -> bool {
        let is_near = |one: u16, other: u16| {
            let way = (i32::from(one) - i32::from(other)).rem_euclid(360);
            way.min(360 - way) <= EDGE_DEG
        };
        match (self.is_whole(), other.is_whole()) {
            (false, false) => {
                is_near(self.start_deg, other.start_deg) && is_near(self.end_deg, other.end_deg)
            }
            (one, other) => one == other,
        }
    }
}

/// Such as `270-90`.
impl FromStr for FieldOfView {
    type Err = &'static str;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let degrees = |text: &str| text.parse().ok().filter(|&deg: &u16| deg < 360);
        let edges = text.split_once('-');
        let edges = edges.and_then(|(start, end)| degrees(start).zip(degrees(end)));
        let (start_deg, end_deg) =
            edges.ok_or("expected START-END, whole degrees 0 to 359, such as 270-90")?;
        Ok(Self { start_deg, end_deg })
    }
}

impl fmt::Display for FieldOfView {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}-{}", self.start_deg, self.end_deg)
    }
}

/// On or off.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Switch(pub bool);

impl FromStr for Switch {
    type Err = &'static str;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        match text {
            "on" => Ok(Self(true)),
            "off" => Ok(Self(false)),
            _ => Err("expected on or off"),
        }
    }
}

impl fmt::Display for Switch {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(if self.0 { "on" } else { "off" })
    }
}

/// The address that packets are sent to: a host's, a broadcast, or a multicast group.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct Host(pub Ipv4Addr);

impl FromStr for Host {
    type Err = &'static str;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let address = text.parse::<Ipv4Addr>().ok();
        let is_host = |to: &Ipv4Addr| !to.is_unspecified() && !to.is_loopback();
        address.filter(is_host).map(Self).ok_or(
            "expected an IPv4 address that the sensor can send to: a host's, such as 192.168.1.100, \
             255.255.255.255, or a multicast group",
        )
    }
}

/// A UDP port.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct Port(pub u16);

impl FromStr for Port {
    type Err = &'static str;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let port = text.parse().ok().filter(|&port| port != 0);
        port.map(Self).ok_or("expected a port, 1 to 65535")
    }
}

/// Where the head is at the pulse per second.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PhaseLock {
    /// Anywhere.
    Off,
    /// At this azimuth, hundredths of a degree below 36000.
    At(u16),
}

/// `off`, or degrees.
impl FromStr for PhaseLock {
    type Err = &'static str;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        if text == "off" {
            return Ok(Self::Off);
        }
        let cdeg = text.parse().ok().map(|deg: f64| (deg * 100.0).round());
        let cdeg = cdeg.filter(|cdeg| (0.0..36_000.0).contains(cdeg));
        cdeg.map(|cdeg| Self::At(cdeg as u16))
            .ok_or("expected off, or an azimuth, 0 to 359.99 degrees")
    }
}

impl fmt::Display for PhaseLock {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Off => f.write_str("off"),
            Self::At(cdeg) => write!(f, "{}", f64::from(*cdeg) / 100.0),
        }
    }
}

macro_rules! shown_as_its_content {
    ($($type:ident)*) => {
        $(impl fmt::Display for $type {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                self.0.fmt(f)
            }
        })*
    };
}

shown_as_its_content!(Rpm Returns Host Port);

macro_rules! serialized_as_shown {
    ($($type:ident)*) => {
        $(impl Serialize for $type {
            fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
                serializer.collect_str(self)
            }
        })*
    };
}

serialized_as_shown!(Returns FieldOfView Switch PhaseLock);

#[cfg(test)]
mod tests {
    use super::*;

    /// Whether each is shown as it is written, and none of the others is taken.
    #[track_caller]
    fn takes<T: FromStr<Err = &'static str> + ToString>(good: &[&str], bad: &[&str]) {
        for text in good {
            let shown = text.parse::<T>().map(|value| value.to_string());
            assert_eq!(shown.as_deref(), Ok(*text));
        }
        for text in bad {
            let error = text.parse::<T>().err();
            assert!(
                error.is_some_and(|why| why.starts_with("expected")),
                "{text}"
            );
        }
    }

    #[test]
    fn values_that_no_sensor_takes_are_refused() {
        takes::<Rpm>(
            &["300", "600", "1200"],
            &["", "0", "240", "610", "1260", "-600", "600.0", "65836"],
        );
        takes::<Returns>(&["strongest", "last", "dual"], &["", "Dual", "both"]);
        takes::<FieldOfView>(
            &["0-359", "270-90", "0-0"],
            &["", "0", "0-360", "-1-90", "1.5-90", "0-90-180"],
        );
        takes::<Switch>(&["on", "off"], &["", "On", "1"]);
        takes::<Host>(
            &["192.168.1.100", "255.255.255.255", "239.1.1.1"],
            &["", "0.0.0.0", "127.0.0.1", "roof", "192.168.1", "::1"],
        );
        takes::<Port>(&["1", "2368", "65535"], &["", "0", "65536", "-1"]);
        takes::<PhaseLock>(
            &["off", "0", "180", "90.25", "359.99"],
            &["", "on", "360", "359.999", "-1", "NaN", "inf"],
        );
    }

    #[test]
    fn what_differs_is_listed_and_what_any_will_do_is_not() {
        let wanted = Settings {
            rpm: Some(Rpm(1200)),
            returns: Some(Returns(ReturnMode::Dual)),
            fov: Some(FieldOfView::WHOLE),
            ..Settings::default()
        };
        let found = Settings {
            rpm: Some(Rpm(600)),
            returns: Some(Returns(ReturnMode::Dual)),
            laser: Some(Switch(false)),
            ..Settings::default()
        };
        let differences = wanted.differences(&found);
        let lines: Vec<String> = differences.iter().map(ToString::to_string).collect();
        assert_eq!(lines, ["rpm 600 -> 1200", "fov unknown -> 0-359"]);
        assert_eq!(Settings::options(&differences), "--rpm 1200 --fov 0-359");
        assert_eq!(wanted.to_string(), "returns dual, rpm 1200, fov 0-359");
        assert_eq!(Settings::default().to_string(), "none");
        assert_eq!(wanted.differences(&wanted), []);
    }

    #[test]
    fn packets_show_the_returns_and_the_field_of_view() {
        let fov: FieldOfView = "270-90".parse().unwrap();
        let wanted = Settings {
            returns: Some(Returns(ReturnMode::Last)),
            fov: Some(fov),
            ..Settings::default()
        };
        let seen = FieldOfView::measured(flags::BLANKED, Some((270.3, 88.6)));
        assert_eq!(wanted.unlike(ReturnMode::Last, seen), []);
        assert_eq!(wanted.unlike(ReturnMode::Last, None), []);
        let whole = FieldOfView::measured(flags::CIRCULAR, None);
        let expected = [
            ("returns", "sends returns dual, wanted is last"),
            ("fov", "measures from 0-359 degrees, wanted is 270-90"),
        ];
        assert_eq!(
            wanted.unlike(ReturnMode::Dual, whole),
            expected.map(|(name, what)| (name, what.to_owned()))
        );
        for (one, other, is_like) in [
            ("0-359", "0-0", true),
            ("180-179", "0-359", true),
            ("359-90", "1-90", true),
            ("270-90", "270-93", false),
            ("270-90", "0-359", false),
        ] {
            let [one, other]: [FieldOfView; 2] = [one, other].map(|text| text.parse().unwrap());
            assert_eq!(one.is_like(other), is_like, "{one} {other}");
        }
        assert_eq!(FieldOfView::measured(0, None), None);
    }
}
