//! What a header says of its sensor: the model, and how many returns it reports.

/// Blocks of a data packet.
pub const BLOCKS: usize = 12;
/// Records of a block, one a laser.
pub const RECORDS: usize = 32;

/// A supported sensor model.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Model {
    /// VLP-16 "Puck": 16 beams, 2 degrees apart.
    Vlp16,
    /// Puck LITE: a lighter VLP-16 with the same beams, timing and product byte.
    PuckLite,
    /// Puck Hi-Res: 16 beams, 1.33 degrees apart.
    PuckHiRes,
    /// HDL-32E: 32 beams, 1.33 degrees apart.
    Hdl32e,
    /// HDL-64E S2 and S2.1: two heads of 32 beams, each unit with a calibration of its own.
    Hdl64eS2,
    /// HDL-64E S3: the same, optionally with two returns, and with a checksum over its status.
    Hdl64eS3,
    /// VLP-32C "Ultra Puck", and VLP-32MR, which has the same beams: 32 beams, the closest 0.33
    /// degrees apart.
    Vlp32c,
    /// VLS-128 "Alpha Prime": 128 beams, most of them 0.11 degrees apart.
    Vls128,
}

impl Model {
    /// All supported models.
    pub const ALL: [Self; 8] = [
        Self::Vlp16,
        Self::PuckLite,
        Self::PuckHiRes,
        Self::Hdl32e,
        Self::Hdl64eS2,
        Self::Hdl64eS3,
        Self::Vlp32c,
        Self::Vls128,
    ];

    /// Its name in output, as the maker writes it.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Vlp16 => "VLP-16",
            Self::PuckLite => "Puck LITE",
            Self::PuckHiRes => "Puck Hi-Res",
            Self::Hdl32e => "HDL-32E",
            Self::Hdl64eS2 => "HDL-64E S2",
            Self::Hdl64eS3 => "HDL-64E S3",
            Self::Vlp32c => "VLP-32C",
            Self::Vls128 => "VLS-128",
        }
    }

    /// Its name as the value of `--model`.
    pub const fn flag(self) -> &'static str {
        match self {
            Self::Vlp16 => "vlp16",
            Self::PuckLite => "puck-lite",
            Self::PuckHiRes => "puck-hires",
            Self::Hdl32e => "hdl32e",
            Self::Hdl64eS2 => "hdl64e-s2",
            Self::Hdl64eS3 => "hdl64e-s3",
            Self::Vlp32c => "vlp32c",
            Self::Vls128 => "vls128",
        }
    }

    /// The number of this model in the header of a sweep, from 1; its meaning never changes.
    pub const fn code(self) -> u32 {
        self as u32 + 1
    }

    /// The model of a code.
    pub fn from_code(code: u32) -> Option<Self> {
        Self::ALL.get((code as usize).checked_sub(1)?).copied()
    }

    /// Whether it is an HDL-64E of any series.
    pub const fn is_hdl64e(self) -> bool {
        matches!(self, Self::Hdl64eS2 | Self::Hdl64eS3)
    }

    /// Number of beams, of records in a firing and of rows in the image.
    pub const fn channels(self) -> usize {
        match self {
            Self::Vlp16 | Self::PuckLite | Self::PuckHiRes => 16,
            Self::Hdl32e | Self::Vlp32c => 32,
            Self::Hdl64eS2 | Self::Hdl64eS3 => 64,
            Self::Vls128 => 128,
        }
    }

    /// Where the returns of one azimuth are in a packet.
    pub const fn places(self, mode: ReturnMode) -> Places {
        let banks = self.channels().div_ceil(RECORDS);
        let returns = mode.returns();
        let blocks = banks * returns;
        // A block of a VLS-128 is followed by that of its other return, those of others by that of
        // the next bank.
        let [bank_step, return_step] = match self {
            Self::Vls128 => [returns, 1],
            _ => [1, banks],
        };
        Places {
            blocks,
            azimuths: BLOCKS / blocks,
            bank_step,
            return_step,
        }
    }
}

/// A text that names no model.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct UnknownModel;

impl std::fmt::Display for UnknownModel {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let flags = Model::ALL.map(Model::flag).join(", ");
        write!(f, "no supported model; expected one of {flags}")
    }
}

impl std::error::Error for UnknownModel {}

/// By [`Model::flag`] or [`Model::name`], in any case and with any hyphens, points and blanks:
/// `VLP-16`, `hdl64e s2.1`.
impl std::str::FromStr for Model {
    type Err = UnknownModel;

    fn from_str(text: &str) -> Result<Self, UnknownModel> {
        let word = letters_and_digits(text);
        match &word[..] {
            "puck" => Ok(Self::Vlp16),
            "hdl64es21" => Ok(Self::Hdl64eS2),
            "ultrapuck" => Ok(Self::Vlp32c),
            "alphaprime" => Ok(Self::Vls128),
            _ => Self::ALL
                .into_iter()
                .find(|model| {
                    letters_and_digits(model.flag()) == word
                        || letters_and_digits(model.name()) == word
                })
                .ok_or(UnknownModel),
        }
    }
}

fn letters_and_digits(text: &str) -> String {
    text.chars()
        .filter(char::is_ascii_alphanumeric)
        .map(|one| one.to_ascii_lowercase())
        .collect()
}

impl std::fmt::Display for Model {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.name())
    }
}

/// The return mode.
///
/// Byte 1204 of a packet; sent by a VLP-16 since firmware 3.0.29, by an HDL-32E since 2.2.20.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ReturnMode {
    /// The strongest return of each shot.
    Strongest = 0x37,
    /// The last return of each shot.
    Last = 0x38,
    /// Two returns of each shot.
    ///
    /// Blocks come in pairs of equal azimuth, even = last, odd = strongest; where the last is the
    /// strongest, the odd one holds the second strongest, and both are equal where there is one
    /// return (VLP-16 manual, section 6).
    Dual = 0x39,
}

impl ReturnMode {
    /// The mode of a factory byte; `None` for a blank or unknown one.
    pub fn from_byte(byte: u8) -> Option<Self> {
        let modes = [Self::Strongest, Self::Last, Self::Dual];
        modes.into_iter().find(|mode| mode.byte() == byte)
    }

    /// The factory byte of this mode.
    pub fn byte(self) -> u8 {
        self as u8
    }

    /// Its name in output: `strongest`, `last` or `dual`.
    pub fn name(self) -> &'static str {
        match self {
            Self::Strongest => "strongest",
            Self::Last => "last",
            Self::Dual => "dual",
        }
    }

    /// Returns reported for each shot: 2 in dual mode, else 1.
    pub const fn returns(self) -> usize {
        match self {
            Self::Dual => 2,
            Self::Strongest | Self::Last => 1,
        }
    }
}

impl std::fmt::Display for ReturnMode {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.name())
    }
}

/// Where the returns of one azimuth are in a packet: all of them in neighbouring blocks.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Places {
    /// Blocks that share one azimuth. The first azimuth begins with block 0.
    pub blocks: usize,
    /// Azimuths of a packet. Blocks behind the last one are not used.
    pub azimuths: usize,
    /// Blocks from a bank of 32 channels to the next bank, of the same return.
    pub bank_step: usize,
    /// Blocks from a return to the other one, of the same bank.
    pub return_step: usize,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn models_are_known_by_their_usual_spellings() {
        for (text, model) in [
            ("vlp16", Model::Vlp16),
            ("VLP-16", Model::Vlp16),
            ("Puck", Model::Vlp16),
            ("Puck LITE", Model::PuckLite),
            ("puck_hi-res", Model::PuckHiRes),
            ("HDL-32E", Model::Hdl32e),
            ("HDL-64E S2", Model::Hdl64eS2),
            ("hdl64e-s2.1", Model::Hdl64eS2),
            ("HDL64E_S3", Model::Hdl64eS3),
            ("Ultra Puck", Model::Vlp32c),
            ("VLP-32C", Model::Vlp32c),
            ("Alpha Prime", Model::Vls128),
            ("vls-128", Model::Vls128),
        ] {
            assert_eq!(text.parse::<Model>().ok(), Some(model), "{text}");
        }
        for text in [
            "", "-", "vlp", "vlp-32a", "hdl64e", "hdl64", "os1", "vlp16x",
        ] {
            assert!(text.parse::<Model>().is_err(), "{text}");
        }
    }
}
