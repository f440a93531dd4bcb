//! Mount of a sensor, by the floor: with the side up that is set, or that its accelerometers
//! say, or with either.

use serde_json::{Value, json};

use crate::cli::output::rounded;
use crate::floor::{self, Seen};
use crate::text::row;
use sweepd_core::floor::Sight;
use sweepd_core::floor::sides::{Answer, Sides};
use sweepd_core::segment::{Mount, Stance};
use sweepd_core::wire::position::Side;

const NO_TURN: &str = "none: the capture has no whole turn";
const NOT_SEEN: &str =
    "none: it is not looked for, as the mount says that the sensor lies on its side";
/// Words for the side that is up.
const STANDS: &str = "if the sensor stands upright, `roll_deg = 0`";
const HANGS: &str = "if the sensor hangs, `roll_deg = 180`";
const FEELS_UPRIGHT: &str = "its accelerometers say that it stands upright";
const FEELS_HEAD_DOWN: &str = "its accelerometers say that it hangs head down, `roll_deg = 180`";
const CEILING: &str = "if the sensor hangs, this is the ceiling";

/// The floor, and how it is known which side is up.
pub struct Mounted<'a> {
    /// The mount that is set.
    pub set: Mount,
    /// The floor that labels take.
    pub seen: Sight,
    /// Side that is up by its accelerometers.
    pub felt: Option<Side>,
    /// Source that says which side is up.
    pub basis: Basis<'a>,
}

/// Source that says which side of a sensor is up.
pub enum Basis<'a> {
    /// The mount says it.
    Mount,
    /// Accelerometers of the sensor say it.
    Accelerometers(Side, &'a Sides),
    /// Nothing says it: both are tried.
    Sides(&'a Sides),
    /// Nothing was looked at.
    NoTurn,
}

/// View with one side up.
struct View {
    /// Words before the floor, and after it.
    before: String,
    after: &'static str,
    /// Whether it lies above, and is the floor if the sensor hangs.
    is_above: bool,
    sight: Sight,
}

impl View {
    /// One that is known to be below.
    fn new(before: &str, sight: Sight) -> Self {
        Self {
            before: before.to_owned(),
            after: "",
            is_above: false,
            sight,
        }
    }
}

impl Mounted<'_> {
    /// The side that is known to be up, and by what.
    pub fn side(&self) -> Option<(Side, &'static str)> {
        match self.basis {
            Basis::Mount => match self.set.stance() {
                Stance::Upright => Some((Side::Upright, "mount")),
                Stance::HeadDown => Some((Side::HeadDown, "mount")),
                Stance::OnSide => None,
            },
            Basis::Accelerometers(side, _) => Some((side, "accelerometers")),
            Basis::Sides(sides) => match sides.answer() {
                Answer::Up(side) => Some((side, "what stands on the floor")),
                Answer::Only(_) | Answer::Both | Answer::None => None,
            },
            Basis::NoTurn => None,
        }
    }

    fn views(&self) -> Vec<View> {
        let (chips, sides) = match self.basis {
            Basis::NoTurn => return Vec::new(),
            Basis::Mount => return vec![View::new("", self.seen)],
            Basis::Accelerometers(side, sides) => (Some(side), sides),
            Basis::Sides(sides) => (None, sides),
        };
        let [upright, head_down] = [Side::Upright, Side::HeadDown].map(|side| sides.sight(side));
        let if_hanging = |what: &str| View {
            is_above: true,
            ..View::new(what, head_down)
        };
        let height_m = head_down.height_m();
        let above = format!(
            "a level surface {:.2} m above; {HANGS}",
            height_m.unwrap_or(0.0)
        );
        match (chips, sides.answer(), upright.height_m(), height_m) {
            (Some(Side::Upright), ..) => vec![View::new(FEELS_UPRIGHT, upright)],
            (Some(Side::HeadDown), ..) => vec![View::new(FEELS_HEAD_DOWN, head_down)],
            (None, Answer::Up(Side::Upright), ..) => vec![View::new("", upright)],
            (None, _, None, None) => {
                vec![View::new("", sides.leaning().map_or(upright, Sight::Floor))]
            }
            (None, Answer::Up(Side::HeadDown), ..) => {
                vec![if_hanging(&format!("things stand on {above}"))]
            }
            (None, Answer::Only(Side::Upright), ..) | (None, _, Some(_), None) => vec![View {
                after: CEILING,
                ..View::new("", upright)
            }],
            (None, _, None, Some(_)) => vec![if_hanging(&above)],
            (None, _, Some(_), Some(_)) => vec![View::new(STANDS, upright), if_hanging(&above)],
        }
    }

    /// Floor that is seen with one side up, to be held against the mount where one is set.
    fn seen(&self, view: &View) -> Seen {
        let is_set = matches!(self.basis, Basis::Mount) || self.set.height_m.is_some();
        Seen {
            sight: view.sight,
            set: Some(self.set).filter(|_| is_set && !view.is_above),
            is_estimated: self.set.height_m.is_none(),
        }
    }

    /// Words for accelerometers that say another side than the mount that is set.
    fn felt_otherwise(&self) -> Option<String> {
        let felt = match (&self.basis, self.felt, self.set.stance()) {
            (Basis::Mount, Some(Side::HeadDown), Stance::Upright) => FEELS_HEAD_DOWN,
            (Basis::Mount, Some(Side::Upright), Stance::HeadDown) => FEELS_UPRIGHT,
            _ => return None,
        };
        Some(format!("{felt}, and the mount that is set says otherwise"))
    }

    /// Adds rows: the height that labels take, and the mount to be copied into a configuration.
    pub fn describe(&self, text: &mut String) {
        if let Basis::NoTurn = self.basis {
            return row(text, "floor", NO_TURN);
        }
        if let Some(warning) = self.felt_otherwise() {
            row(text, "warning", warning);
        }
        let views = self.views();
        // What labels take is told where it may be true.
        let is_below = match self.basis {
            Basis::Accelerometers(side, _) => side == Side::Upright,
            _ => views.len() == 1 && !views[0].is_above,
        };
        if is_below && self.seen.height_m().is_some() {
            row(text, "height", floor::height(&self.seen, &self.set));
        }
        for view in views {
            let finding = self.seen(&view).finding();
            let lines = match &view.sight {
                Sight::Floor(floor) => floor::lines(floor),
                Sight::Unknown | Sight::NoFloor { .. } => None,
            };
            let is_sure = matches!(view.sight, Sight::Floor(floor) if floor.doubt.is_none());
            let what = match &finding {
                _ if is_sure => floor::MOUNTED.to_owned(),
                Some(finding) => finding.to_string(),
                None => NOT_SEEN.to_owned(),
            };
            let colon = if lines.is_some() { ":" } else { "" };
            let said = [&view.before[..], &what, view.after];
            let said = said.into_iter().filter(|said| !said.is_empty());
            let said = said.collect::<Vec<_>>().join("; ");
            row(text, "floor", said + colon);
            for line in lines.iter().flat_map(|lines| lines.lines()) {
                row(text, "", line);
            }
            if let Some(warning) = finding.filter(|one| is_sure && one.is_trouble()) {
                row(
                    text,
                    "warning",
                    format_args!("{}: {}", warning.what, floor::CURE),
                );
            }
        }
    }

    /// Values for programs: the floor, and the one if the sensor hangs.
    pub fn report(&self) -> [Value; 2] {
        let mut values = [Value::Null, Value::Null];
        if let Basis::NoTurn = self.basis {
            values[0] = json!({ "lines": null, "trouble": NO_TURN });
        }
        for view in self.views() {
            values[usize::from(view.is_above)] = self.value(&view);
        }
        values
    }

    fn value(&self, view: &View) -> Value {
        let mut value = self.seen(view).json();
        if let Some(trouble) = self.felt_otherwise() {
            value["trouble"] = json!(trouble);
        }
        let Sight::Floor(floor) = view.sight else {
            return value;
        };
        let degrees = |rad: f32| rounded(f64::from(rad.to_degrees()), 100.0);
        value["spread"] = json!({
            "height_m": rounded(f64::from(floor.height_spread_m), 1000.0),
            "pitch_deg": degrees(floor.pitch_spread_rad),
            "roll_deg": degrees(floor.roll_spread_rad),
        });
        value["sweeps"] = json!(floor.sweeps);
        value["looks"] = json!(floor.looks);
        value
    }
}
