//! Faults of a simulation.

use std::ops::RangeInclusive;

use sweepd::cli::CliError;
use sweepd::cli::options::within;
use sweepd_lab::simulate::{
    ClockStep, EyeFault, EyeKind, FieldOfView, Motor, PacketPart, Rates, SpeedChange,
};

const PERCENT: RangeInclusive<f64> = 0.0..=100.0;
/// Any moment of the longest simulation, seconds.
const DAY_S: RangeInclusive<f64> = 0.0..=86_400.0;
/// Default number of packets lost in a burst.
const BURST_LEN: u64 = 10;

/// Faults, by seed; rates in percent of the data packets. The first and the last packet are always
/// delivered whole.
#[derive(Clone, Debug, clap::Args)]
#[command(next_help_heading = "Faults (rates in percent of the data packets)")]
pub struct FaultOptions {
    /// Lose this many, one by one
    #[arg(
        long, value_name = "PERCENT", default_value = "0", hide_default_value = true,
        value_parser = within(PERCENT, "percent"), allow_negative_numbers = true
    )]
    loss: f64,
    /// With this many a burst begins, in which LEN packets in a row are lost [default LEN: 10]
    #[arg(long, value_name = "PERCENT[xLEN]", value_parser = burst, allow_negative_numbers = true)]
    burst_loss: Option<Burst>,
    /// Deliver this many twice
    #[arg(
        long, value_name = "PERCENT", default_value = "0", hide_default_value = true,
        value_parser = within(PERCENT, "percent"), allow_negative_numbers = true
    )]
    duplicate: f64,
    /// Let this many be overtaken by the packets behind them, by one or by this many PLACES
    #[arg(long, value_name = "PERCENT[xPLACES]", value_parser = places, allow_negative_numbers = true)]
    reorder: Option<Burst>,
    /// Damage this many: one bit of a PART [any (the default), flag, azimuth, distance,
    /// reflectivity, stamp, factory], or the length
    #[arg(long, value_name = "PERCENT[xPART]", value_parser = corrupt, allow_negative_numbers = true)]
    corrupt: Option<Corrupt>,
    /// Before this many, send a datagram that no sensor sends: of 0 to 63, 1205, or 1207 to 8972
    /// bytes
    #[arg(
        long, value_name = "PERCENT", default_value = "0", hide_default_value = true,
        value_parser = within(PERCENT, "percent"), allow_negative_numbers = true
    )]
    stray: f64,
    /// Start at rest and gain speed evenly for this time
    #[arg(
        long, value_name = "SECONDS", default_value = "0", hide_default_value = true,
        value_parser = within(DAY_S, "seconds"), allow_negative_numbers = true
    )]
    spin_up: f64,
    /// Stand still from one second to another, while packets go on
    #[arg(long, value_name = "FROM..TO", value_parser = stall, allow_negative_numbers = true)]
    stall: Option<Interval>,
    /// Change the speed evenly from one second to another; a negative RPM turns the other way
    #[arg(long, value_name = "RPM@FROM..TO", value_parser = new_speed, allow_negative_numbers = true)]
    new_rpm: Option<NewSpeed>,
    /// Measure only from one azimuth clockwise to another, for the whole time or from one second to
    /// another
    #[arg(long, value_name = "DEG..DEG[@FROM..TO]", value_parser = fov, allow_negative_numbers = true)]
    pub fov: Option<FieldOfView>,
    /// Set the sensor's clock ahead by the first number after the second; a negative amount sets it
    /// back
    #[arg(long, value_name = "SECONDS@AT", value_parser = clock_step, allow_negative_numbers = true)]
    pub clock_step: Option<ClockStep>,
    /// Restart after each so many seconds of work: silent for 3 s, then with a clock that begins anew,
    /// without GPS
    #[arg(
        long, value_name = "SECONDS", value_parser = within(1.0..=86_400.0, "seconds"),
        conflicts_with_all = ["gps", "gps_fault", "clock_step"], allow_negative_numbers = true
    )]
    pub restart: Option<f64>,
    /// Exchange the addresses of the first two sensors after this time
    #[arg(long, value_name = "SECONDS", value_parser = within(DAY_S, "seconds"), allow_negative_numbers = true)]
    pub exchange: Option<f64>,
    /// Change from one return to two, or from two to one, after this time
    #[arg(long, value_name = "SECONDS", value_parser = within(DAY_S, "seconds"), allow_negative_numbers = true)]
    pub mode_switch: Option<f64>,
    /// From a second on, spoil what the sensor sees: blind (no return), faded (3 % of them), cover
    /// (all within a metre), dark (none of the lower half of the beams), sector (none to the right),
    /// frozen (each beam always returns the same)
    #[arg(long, value_name = "KIND@AT", value_parser = eye)]
    pub eye: Option<EyeFault>,
}

fn eye(text: &str) -> Result<EyeFault, String> {
    if let Some((name, at)) = text.split_once('@')
        && let Some(kind) = EyeKind::ALL.into_iter().find(|kind| kind.name() == name)
        && let Some(at) = number(at, DAY_S)
    {
        let from_ns = nanoseconds(at);
        return Ok(EyeFault { kind, from_ns });
    }
    let names = EyeKind::ALL.map(EyeKind::name).join(", ");
    Err(format!(
        "expected one of {names}, @, and from which second on, such as blind@2"
    ))
}

/// Values of `--burst-loss` and `--reorder`.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Burst {
    percent: f64,
    /// Packets in a row, or places.
    len: u64,
}

fn burst(text: &str) -> Result<Burst, String> {
    percent_and_len(text, BURST_LEN, 10_000).ok_or_else(|| {
        "expected 0 to 100 percent, then x and 1 to 10000 packets if need be, such as 0.1x20"
            .to_owned()
    })
}

fn places(text: &str) -> Result<Burst, String> {
    percent_and_len(text, 1, 1_000).ok_or_else(|| {
        "expected 0 to 100 percent, then x and 1 to 1000 places if need be, such as 2x3".to_owned()
    })
}

/// `PERCENT`, with the default length, or `PERCENTxLEN` with at most `most`.
fn percent_and_len(text: &str, default: u64, most: u64) -> Option<Burst> {
    let (percent, len) = match text.split_once('x') {
        Some((percent, len)) => (percent, len.parse().ok()?),
        None => (text, default),
    };
    (1..=most).contains(&len).then_some(Burst {
        percent: number(percent, PERCENT)?,
        len,
    })
}

/// Value of `--corrupt`.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Corrupt {
    percent: f64,
    part: PacketPart,
}

fn corrupt(text: &str) -> Result<Corrupt, String> {
    let (percent, name) = text
        .split_once('x')
        .unwrap_or((text, PacketPart::Any.name()));
    let part = PacketPart::ALL.into_iter().find(|part| part.name() == name);
    match (number(percent, PERCENT), part) {
        (Some(percent), Some(part)) => Ok(Corrupt { percent, part }),
        _ => {
            let names = PacketPart::ALL.map(PacketPart::name).join(", ");
            Err(format!(
                "expected 0 to 100 percent, then x and one of {names} if need be, such as 1xstamp"
            ))
        }
    }
}

/// Value of `--new-rpm`.
#[derive(Clone, Copy, Debug, PartialEq)]
struct NewSpeed {
    rpm: f64,
    over: Interval,
}

fn new_speed(text: &str) -> Result<NewSpeed, String> {
    rpm_over_interval(text).ok_or_else(|| {
        "expected -1200 to 1200 turns a minute, @, and FROM..TO in seconds, the second greater, such as 900@2..3"
            .to_owned()
    })
}

/// `RPM@FROM..TO`.
fn rpm_over_interval(text: &str) -> Option<NewSpeed> {
    let (rpm, over) = text.split_once('@')?;
    Some(NewSpeed {
        rpm: number(rpm, -1200.0..=1200.0)?,
        over: interval(over)?,
    })
}

fn fov(text: &str) -> Result<FieldOfView, String> {
    sector(text).ok_or_else(|| {
        "expected two azimuths of 0 to 360 degrees, then @ and FROM..TO in seconds if need be, such as 270..90 or \
         270..90@2..5"
            .to_owned()
    })
}

/// `DEG..DEG`, or `DEG..DEG@FROM..TO`.
fn sector(text: &str) -> Option<FieldOfView> {
    let (sector, set_ns) = match text.split_once('@') {
        Some((sector, over)) => (sector, interval(over)?.nanoseconds()),
        None => (text, [0, i64::MAX]),
    };
    let (from, to) = sector.split_once("..")?;
    let from_deg = number(from, 0.0..=360.0)?;
    let to_deg = number(to, 0.0..=360.0)?;
    (from_deg != to_deg).then_some(FieldOfView {
        from_deg,
        to_deg,
        set_ns,
    })
}

fn clock_step(text: &str) -> Result<ClockStep, String> {
    step_at_time(text)
        .ok_or_else(|| "expected -3600 to 3600 seconds, @, and when, such as 0.5@2".to_owned())
}

/// `SECONDS@TIME`.
fn step_at_time(text: &str) -> Option<ClockStep> {
    let (step, at) = text.split_once('@')?;
    Some(ClockStep {
        at_ns: nanoseconds(number(at, DAY_S)?),
        by_ns: nanoseconds(number(step, -3600.0..=3600.0)?),
    })
}

/// From one second to another.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Interval {
    from: f64,
    to: f64,
}

impl Interval {
    fn nanoseconds(self) -> [i64; 2] {
        [nanoseconds(self.from), nanoseconds(self.to)]
    }
}

fn stall(text: &str) -> Result<Interval, String> {
    interval(text).ok_or_else(|| {
        "expected FROM..TO, seconds from 0 to 86400, the second greater, such as 2..3.5".to_owned()
    })
}

/// `FROM..TO`, the second greater.
fn interval(text: &str) -> Option<Interval> {
    let (from, to) = text.split_once("..")?;
    let from = number(from, DAY_S)?;
    let to = number(to, DAY_S)?;
    (from < to).then_some(Interval { from, to })
}

/// A number within a range; the caller says what was expected.
fn number(text: &str, range: RangeInclusive<f64>) -> Option<f64> {
    within(range, "")(text).ok()
}

fn nanoseconds(seconds: f64) -> i64 {
    (seconds * 1e9) as i64
}

impl FaultOptions {
    /// Refuses faults that would begin after the end.
    ///
    /// # Errors
    /// [`CliError::Usage`].
    pub fn check(&self, sensors: usize, seconds: f64) -> Result<(), CliError> {
        if self.exchange.is_some() && sensors < 2 {
            return Err(CliError::Usage(
                "--exchange needs two sensors: give --model twice".to_owned(),
            ));
        }
        let moments = [
            ("--stall", self.stall.map(|stall| stall.from)),
            ("--mode-switch", self.mode_switch),
            ("--new-rpm", self.new_rpm.map(|change| change.over.from)),
            ("--fov", self.fov.map(|fov| fov.set_ns[0] as f64 * 1e-9)),
            (
                "--clock-step",
                self.clock_step.map(|step| step.at_ns as f64 * 1e-9),
            ),
            ("--exchange", self.exchange),
            ("--restart", self.restart),
            ("--eye", self.eye.map(|eye| eye.from_ns as f64 * 1e-9)),
        ];
        for (flag, moment) in moments {
            if let Some(moment) = moment.filter(|&moment| moment >= seconds) {
                let message = format!(
                    "{flag} at {moment} s comes after the end: give more --seconds than {moment}"
                );
                return Err(CliError::Usage(message));
            }
        }
        Ok(())
    }

    /// Whether the first two sensors have exchanged their addresses, this long after the start.
    pub fn is_exchanged(&self, elapsed_ns: i64) -> bool {
        self.exchange
            .is_some_and(|at| elapsed_ns >= nanoseconds(at))
    }

    /// How long the sensors work before they restart, nanoseconds.
    pub fn restart_ns(&self) -> Option<i64> {
        self.restart.map(nanoseconds)
    }

    /// What the network does.
    pub fn rates(&self) -> Rates {
        let burst = self.burst_loss.unwrap_or(Burst {
            percent: 0.0,
            len: BURST_LEN,
        });
        Rates {
            loss: self.loss / 100.0,
            burst_loss: burst.percent / 100.0,
            burst_len: burst.len,
            duplicate: self.duplicate / 100.0,
            reorder: self.reorder.map_or(0.0, |late| late.percent / 100.0),
            places: self.reorder.map_or(1, |late| late.len),
            corrupt: self.corrupt.map_or(0.0, |corrupt| corrupt.percent / 100.0),
            part: self.corrupt.map_or(PacketPart::Any, |corrupt| corrupt.part),
            stray: self.stray / 100.0,
        }
    }

    /// What the motor of a sensor at this speed does.
    pub fn motor(&self, rpm: f64) -> Motor {
        let change = self.new_rpm.map(|new| {
            let [from_ns, to_ns] = new.over.nanoseconds();
            SpeedChange {
                from_ns,
                lasts_ns: to_ns - from_ns,
                to: new.rpm / rpm,
            }
        });
        Motor {
            change,
            spin_up_ns: nanoseconds(self.spin_up),
            stall_ns: self.stall.map(Interval::nanoseconds),
            ..Motor::default()
        }
    }
}
