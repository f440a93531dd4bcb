//! Doubts about the estimated height of a sensor, and the words for them.
//!
//! A height that is too small hides obstacles, and one that is too great stops the robot. So in doubt
//! the labels take the greater one, and the header says why it is in doubt.

use std::fmt;

use crate::layout::Header;

/// Reasons why an estimated height is in doubt.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum HeightDoubt {
    /// No surface is seen that may be the floor: nothing is labelled ground.
    NoFloor {
        /// Whether there are level surfaces, all with returns below them.
        is_contradicted: bool,
    },
    /// Few returns lie on it.
    FewReturns {
        /// Columns that see it.
        columns: u16,
        /// Columns that were looked at and have a return.
        seen: u16,
        /// Sixteenths of a turn that see it.
        directions: u8,
    },
    /// The returns do not tell how it is tilted.
    TiltError {
        /// Standard error of the tilt, tenths of a degree.
        error_ddeg: u16,
    },
    /// More than a few columns see something below it.
    SeenBelow {
        /// Columns that do.
        columns: u16,
        /// Columns that were looked at and have a return.
        seen: u16,
    },
    /// A level surface above it shows more: it may be the floor, and this one a pit.
    Lower,
    /// Another level surface above it lies around the sensor: a dock, or a large deck.
    Around {
        /// Depth of that surface below the sensor, centimetres.
        depth_cm: u16,
        /// Reach of it, decimetres.
        far_dm: u16,
    },
    /// Tilt against the mount of a floor that is not seen all around: it may be a ramp.
    Tilted {
        /// The angle between the two, tenths of a degree.
        tilt_ddeg: u16,
        /// Sixteenths of a turn that see it.
        directions: u8,
    },
    /// Level, it may lie at another depth, with a ramp ahead.
    Ramp {
        /// Depth as it is tilted, centimetres.
        tilted_cm: u16,
        /// Depth if it is level, centimetres.
        level_cm: u16,
        /// Tilt, tenths of a degree.
        tilt_ddeg: u8,
    },
    /// Nearby all around it ends: it may be the deck of the robot, or a table.
    Small {
        /// Reach of it, decimetres.
        far_dm: u16,
    },
    /// Few sweeps were looked at so far.
    FewSweeps {
        /// Whole turns, less than three.
        sweeps: u8,
    },
    /// The last sweeps do not agree.
    Unsteady {
        /// Least depth by them, centimetres.
        least_cm: u16,
        /// Greatest depth by them, centimetres.
        most_cm: u16,
    },
    /// Too few of the last sweeps show it.
    Lost,
    /// A doubt that this version does not know.
    Unknown,
}

/// Cure of every doubt.
pub const HEIGHT_CURE: &str = "set height_m";

/// Bits of a word: the kind, then three numbers.
const KIND_BITS: u32 = 4;
const NUMBER_BITS: [u32; 3] = [10, 10, 8];

impl HeightDoubt {
    /// The doubt in a header; `None` where the height is sure, or was configured.
    pub fn of(header: &Header) -> Option<Self> {
        Self::of_word(header.height_doubt)
    }

    /// The doubt in a word; `None` for 0.
    pub fn of_word(word: u32) -> Option<Self> {
        let mut rest = word >> KIND_BITS;
        let [a, b, c] = NUMBER_BITS.map(|bits| {
            let number = rest & ((1 << bits) - 1);
            rest = rest.checked_shr(bits).unwrap_or(0);
            number as u16
        });
        let low = c as u8;
        Some(match word & ((1 << KIND_BITS) - 1) {
            0 => return None,
            1 => Self::NoFloor {
                is_contradicted: a == 1,
            },
            2 => Self::FewReturns {
                columns: a,
                seen: b,
                directions: low,
            },
            3 => Self::SeenBelow {
                columns: a,
                seen: b,
            },
            4 => Self::Lower,
            5 => Self::Around {
                depth_cm: a,
                far_dm: b,
            },
            6 => Self::Tilted {
                tilt_ddeg: a,
                directions: low,
            },
            7 => Self::Ramp {
                tilted_cm: a,
                level_cm: b,
                tilt_ddeg: low,
            },
            8 => Self::Small { far_dm: a },
            9 => Self::FewSweeps { sweeps: low },
            10 => Self::Unsteady {
                least_cm: a,
                most_cm: b,
            },
            11 => Self::Lost,
            12 => Self::TiltError { error_ddeg: a },
            _ => Self::Unknown,
        })
    }

    /// The doubt as a word, never 0: the kind in its lowest 4 bits, then numbers of 10, 10 and 8
    /// bits, each as far as it goes.
    pub fn word(self) -> u32 {
        let (kind, numbers): (u32, [u16; 3]) = match self {
            Self::NoFloor { is_contradicted } => (1, [is_contradicted.into(), 0, 0]),
            Self::FewReturns {
                columns,
                seen,
                directions,
            } => (2, [columns, seen, directions.into()]),
            Self::SeenBelow { columns, seen } => (3, [columns, seen, 0]),
            Self::Lower => (4, [0; 3]),
            Self::Around { depth_cm, far_dm } => (5, [depth_cm, far_dm, 0]),
            Self::Tilted {
                tilt_ddeg,
                directions,
            } => (6, [tilt_ddeg, 0, directions.into()]),
            Self::Ramp {
                tilted_cm,
                level_cm,
                tilt_ddeg,
            } => (7, [tilted_cm, level_cm, tilt_ddeg.into()]),
            Self::Small { far_dm } => (8, [far_dm, 0, 0]),
            Self::FewSweeps { sweeps } => (9, [0, 0, sweeps.into()]),
            Self::Unsteady { least_cm, most_cm } => (10, [least_cm, most_cm, 0]),
            Self::Lost => (11, [0; 3]),
            Self::TiltError { error_ddeg } => (12, [error_ddeg, 0, 0]),
            Self::Unknown => (15, [0; 3]),
        };
        let mut word = kind;
        let mut at = KIND_BITS;
        for (number, bits) in numbers.into_iter().zip(NUMBER_BITS) {
            word |= u32::from(number).min((1 << bits) - 1) << at;
            at += bits;
        }
        word
    }

    /// The finding, and what to do about it.
    pub fn sentence(self, height_m: f32) -> String {
        format!("{}: {HEIGHT_CURE}", self.finding(height_m))
    }

    /// The finding at every output, for the height that labels take, metres; [`HEIGHT_CURE`] says
    /// what to do.
    pub fn finding(self, height_m: f32) -> String {
        match self {
            Self::NoFloor { .. } => format!("no floor is seen: everything is an obstacle; {self}"),
            _ => format!("the height is a guess: {height_m:.2} m; {self}"),
        }
    }
}

/// The reason.
impl fmt::Display for HeightDoubt {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let m = |cm: u16| f64::from(cm) / 100.0;
        let tenth = |tenths: u16| f64::from(tenths) / 10.0;
        match *self {
            Self::NoFloor { is_contradicted } => f.write_str(match is_contradicted {
                true => "returns lie below every level surface",
                false => "no level surface is in sight",
            }),
            Self::FewReturns {
                columns,
                seen,
                directions,
            } => write!(
                f,
                "few returns show it: {columns} of {seen} columns, {directions} of 16 directions"
            ),
            Self::SeenBelow { columns, seen } => {
                write!(f, "{columns} of {seen} columns see something below it")
            }
            Self::Lower => f.write_str("a level surface above it shows more"),
            Self::Around { depth_cm, far_dm } => write!(
                f,
                "a level surface {:.2} m below the sensor lies around it, {:.1} m far",
                m(depth_cm),
                tenth(far_dm)
            ),
            Self::Tilted {
                tilt_ddeg,
                directions,
            } => write!(
                f,
                "it is tilted by {:.1} degrees against the mount, and seen in {directions} of 16 directions alone",
                tenth(tilt_ddeg)
            ),
            Self::Ramp {
                tilted_cm,
                level_cm,
                tilt_ddeg,
            } => write!(
                f,
                "tilted by {:.1} degrees it is {:.2} m below, level {:.2} m; the greater is taken",
                tenth(tilt_ddeg.into()),
                m(tilted_cm),
                m(level_cm)
            ),
            Self::Small { far_dm } => write!(
                f,
                "it ends {:.1} m from the sensor: it may be the robot's deck, or a table",
                tenth(far_dm)
            ),
            Self::TiltError { error_ddeg } => write!(
                f,
                "its tilt is certain to {:.1} degrees alone",
                tenth(error_ddeg)
            ),
            of_sweeps => of_sweeps.fmt_sweeps(f),
        }
    }
}

impl HeightDoubt {
    /// Reasons that are of several sweeps.
    fn fmt_sweeps(self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let m = |cm: u16| f64::from(cm) / 100.0;
        match self {
            Self::FewSweeps { sweeps: 0 } => f.write_str("no whole turn shows it"),
            Self::FewSweeps { sweeps: 1 } => f.write_str("one sweep alone shows it"),
            Self::FewSweeps { sweeps } => write!(f, "{sweeps} sweeps alone show it"),
            Self::Unsteady { least_cm, most_cm } => write!(
                f,
                "the last sweeps say {:.2} to {:.2} m",
                m(least_cm),
                m(most_cm)
            ),
            Self::Lost => f.write_str("not all of the last sweeps show it"),
            _ => f.write_str("this version does not know the reason"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// By hand: kind 2, then 13 << 4, 512 << 14, 2 << 24.
    #[test]
    fn a_doubt_is_a_kind_and_three_numbers() {
        let doubt = HeightDoubt::FewReturns {
            columns: 13,
            seen: 512,
            directions: 2,
        };
        assert_eq!(doubt.word(), 2 + (13 << 4) + (512 << 14) + (2 << 24));
        assert_eq!(
            doubt.finding(1.2),
            "the height is a guess: 1.20 m; few returns show it: 13 of 512 columns, 2 of 16 directions"
        );
        // What is too large is as far as it goes.
        let far = HeightDoubt::Small { far_dm: 5000 };
        let most = HeightDoubt::Small { far_dm: 1023 };
        assert_eq!(HeightDoubt::of_word(far.word()), Some(most));
    }

    #[test]
    fn every_word_is_a_doubt_that_gives_words_again() {
        assert_eq!(HeightDoubt::of_word(0), None);
        for kind in 1..16_u32 {
            let doubt = HeightDoubt::of_word(kind + (85 << 4) + (54 << 14) + (13 << 24)).unwrap();
            assert_eq!(HeightDoubt::of_word(doubt.word()), Some(doubt));
            assert!(!doubt.finding(0.85).is_empty());
        }
        assert_eq!(HeightDoubt::of_word(14), Some(HeightDoubt::Unknown));
    }
}
