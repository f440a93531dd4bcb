//! What a sensor no longer sees, though it sends: bits of [`Header::flags`](crate::Header), in words.

use std::fmt;

use crate::layout::flags;

/// A way in which a sensor no longer sees what it should.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct EyeFault {
    /// Its bit of [`flags`].
    pub flag: u32,
    /// Its name in output.
    pub name: &'static str,
    /// What is seen.
    pub what: &'static str,
    /// The likely cause, and what to do.
    pub cure: &'static str,
    /// Whether what is in the way of a robot may no longer be seen at all.
    pub is_fault: bool,
}

/// What is seen, with its name.
impl fmt::Display for EyeFault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: {}", self.name, self.what)
    }
}

/// All of them, the worst first.
pub const EYE_FAULTS: [EyeFault; 5] = [
    EyeFault {
        flag: flags::BLIND,
        name: "blind",
        what: "hardly a shot returns",
        cure: "take off what covers the window, look whether `sweepd sensor` says that its lasers are on, and restart it; if it \
             stays so, its receiver has failed. A sensor that sees only sky needs `eye_turns = 0`",
        is_fault: true,
    },
    EyeFault {
        flag: flags::COVERED,
        name: "covered",
        what: "all around, nothing is seen but what is right before the window",
        cure: "take off the dust cover, or wipe water, dirt or ice from the window. A robot that is shut in that narrowly needs \
             a smaller `eye_near_m`",
        is_fault: true,
    },
    EyeFault {
        flag: flags::FROZEN,
        name: "frozen",
        what: "ranges or reflectivities are the same, turn after turn",
        cure: "restart the sensor; if it stays so, it has failed. One turn of a capture that is sent again and again looks \
             like this, too",
        is_fault: true,
    },
    EyeFault {
        flag: flags::FADED,
        name: "faded",
        what: "far fewer shots return than before",
        cure: "wipe dirt, water or ice from the window; in smoke, fog or dust wait until it has settled; if it stays so, its \
             lasers have failed. Over water or in the air, `eye_least_percent` must be smaller: 0 for never",
        is_fault: true,
    },
    EyeFault {
        flag: flags::DARK_BELOW,
        name: "dark below the horizon",
        what: "beams or a sector that look down to the ground nearby do not return",
        cure: "clean the window, and look whether a wall or a thing is nearer than it can measure, and whether the ground there \
             is water, a mirror or a drop; if it stays so, lasers or detectors have failed",
        is_fault: false,
    },
];

/// Those of a header's flags.
pub fn eye_faults(bits: u32) -> impl Iterator<Item = EyeFault> {
    EYE_FAULTS
        .into_iter()
        .filter(move |fault| bits & fault.flag != 0)
}

/// The same in a sentence; `None` if there is none.
pub fn eye_sentence(bits: u32) -> Option<String> {
    let mut sentence = String::new();
    for fault in eye_faults(bits) {
        if !sentence.is_empty() {
            sentence += "; ";
        }
        sentence += &format!("{fault}: {}", fault.cure);
    }
    (!sentence.is_empty()).then_some(sentence)
}
