//! Dark beams, in words and as JSON.

use serde_json::{Value, json};

use crate::text::{count_of, grouped};
use sweepd_core::pipeline::DarkBeam;

/// Most beams that a sentence names.
const NAMED: usize = 8;

/// What to do about them.
pub const CURE: &str = "clean the window of the sensor, and look whether something stands before it; if it stays so, the laser or its \
     detector has failed";

/// Which beams are dark, and for how long; `None` if none is.
pub fn sentence(dark: &[DarkBeam]) -> Option<String> {
    let [first, others @ ..] = dark else {
        return None;
    };
    let mut text = format!(
        "{} has not returned for {}",
        name(first),
        count_of(first.turns.into(), "turn")
    );
    let named = others.len().min(NAMED - 1);
    for beam in &others[..named] {
        text += &format!(", {} for {}", name(beam), grouped(beam.turns.into()));
    }
    if others.len() > named {
        text += &format!(", and {} more", others.len() - named);
    }
    text += match others {
        [] => ", though the beams next to it have",
        _ => ", though the beams next to them have",
    };
    Some(text)
}

fn name(beam: &DarkBeam) -> String {
    format!("channel {} (row {})", beam.channel, beam.row)
}

/// The same for programs.
pub fn json(dark: &[DarkBeam]) -> Value {
    let mut beams = Vec::new();
    for beam in dark {
        let DarkBeam {
            row,
            channel,
            turns,
        } = beam;
        beams.push(json!({"channel": channel, "row": row, "turns": turns}));
    }
    beams.into()
}

/// Reads [`json`]; leaves out what is no beam.
pub fn from_json(beams: &Value) -> Vec<DarkBeam> {
    let mut dark = Vec::new();
    for beam in beams.as_array().into_iter().flatten() {
        let number = |key: &str| u32::try_from(beam[key].as_u64()?).ok();
        if let (Some(row), Some(channel), Some(turns)) =
            (number("row"), number("channel"), number("turns"))
        {
            dark.push(DarkBeam {
                row,
                channel,
                turns,
            });
        }
    }
    dark
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn by_hand() {
        let dark: Vec<DarkBeam> = (0..10)
            .map(|number| DarkBeam {
                row: number,
                channel: 82 + number,
                turns: 1000 - number,
            })
            .collect();
        assert_eq!(sentence(&[]), None);
        assert_eq!(
            sentence(&dark[..1]).unwrap(),
            "channel 82 (row 0) has not returned for 1,000 turns, though the beams next to it have"
        );
        assert_eq!(
            sentence(&dark[1..3]).unwrap(),
            "channel 83 (row 1) has not returned for 999 turns, channel 84 (row 2) for 998, though the beams next to them have"
        );
        assert!(sentence(&dark).unwrap().ends_with(
            "channel 89 (row 7) for 993, and 2 more, though the beams next to them have"
        ));
        assert_eq!(from_json(&json(&dark)), dark);
        assert_eq!(
            from_json(&json!([{"row": -1, "channel": 2, "turns": 3}, 7])),
            []
        );
    }
}
