//! The detected model of a stream.

use crate::sensor::model::Spec;
use crate::sensor::{Model, ModelExt};
use crate::wire::data::{BLOCKS, Banks, DataPacket, ReturnMode};

/// The model of a stream, the evidence for it, and the content of its packets.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Detection {
    /// The model.
    pub model: Model,
    /// Returns in a packet. If the sensor does not report it, strongest (its default) or dual.
    pub return_mode: ReturnMode,
    /// The evidence for the model.
    pub basis: Basis,
    /// The table of the model that has the measured packet period.
    pub spec: &'static Spec,
}

/// Only the azimuths of an HDL-64E packet show that it holds two returns. They count only if they
/// are this far apart, hundredths of a degree, because those of a slow head are equal too.
const TELLING_STEP_CDEG: i32 = 4;

/// Whether a packet of an HDL-64E holds two returns; `None` if its azimuths do not show it.
pub(super) fn says_two_returns(packet: &DataPacket) -> Option<bool> {
    const BLOCKS_OF_TWO: usize = 4;
    if !packet.azimuths_in_groups(BLOCKS_OF_TWO, BLOCKS / BLOCKS_OF_TWO) {
        return Some(false);
    }
    let first = i32::from(packet.blocks[0].azimuth_cdeg());
    let second = i32::from(packet.blocks[BLOCKS_OF_TWO].azimuth_cdeg());
    ((first - second).abs() >= TELLING_STEP_CDEG).then_some(true)
}

/// The mode of a packet that holds one return, by its byte.
pub(super) fn of_one_return(byte: u8) -> ReturnMode {
    match ReturnMode::from_byte(byte) {
        Some(ReturnMode::Last) => ReturnMode::Last,
        _ => ReturnMode::Strongest,
    }
}

impl Detection {
    /// The return mode of a packet with these banks; `last` is that of the packet before. An HDL-64E
    /// shows it by its azimuths, and keeps the last mode while the head stands still; a VLS-128 by its
    /// blocks. Other models have a byte for it; if that is blank, the detected mode applies.
    pub fn mode_of(&self, packet: &DataPacket, banks: Banks, last: ReturnMode) -> ReturnMode {
        match banks {
            Banks::FourTwice => return ReturnMode::Dual,
            Banks::Four => return of_one_return(packet.return_mode),
            _ => {}
        }
        if !self.model.is_hdl64e() {
            return ReturnMode::from_byte(packet.return_mode).unwrap_or(self.return_mode);
        }
        match says_two_returns(packet) {
            Some(true) => ReturnMode::Dual,
            Some(false) if last == ReturnMode::Dual => ReturnMode::Strongest,
            Some(false) | None => last,
        }
    }

    /// Whether packets with these banks have the layout of this sensor's.
    pub fn has_layout(&self, banks: Banks) -> bool {
        banks != Banks::FourThrice && banks.count() == Some(self.model.spec().banks())
    }
}

/// The evidence for the model.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Basis {
    /// The user; neither product byte nor packet period contradicts.
    Given,
    /// The user, against the product byte; the packet period does not contradict.
    GivenAgainstBytes,
    /// The product byte, and the packet period agrees.
    BytesAndPeriod,
    /// The packet period: the product byte is blank, or it is the wrong one that early VLP-16
    /// firmware sends.
    Period,
    /// The product byte: there were too few packets to measure their period.
    BytesAlone,
    /// The time that the head takes from one azimuth to the next: too many packets were lost, or
    /// too few came, to measure their period.
    Turn,
    /// The four banks of lasers of a VLS-128.
    FourBanks,
    /// The two heads, whose blocks alternate, and the packet period.
    HeadsAndPeriod,
    /// The two heads: there were too few packets to measure their period.
    HeadsAlone,
}

impl Basis {
    /// The words for it in output.
    pub fn words(self) -> &'static str {
        match self {
            Self::Given => "as given",
            Self::GivenAgainstBytes => "as given, although its factory bytes say otherwise",
            Self::BytesAndPeriod => "by its factory bytes and packet period",
            Self::Period => {
                "by its packet period, since its factory bytes are blank or those of early firmware"
            }
            Self::BytesAlone => "by its factory bytes alone, too few packets to check their period",
            Self::Turn => {
                "by the turn of its head, since its factory bytes are blank or those of early firmware"
            }
            Self::FourBanks => "by its four banks of lasers",
            Self::HeadsAndPeriod => "by its two heads and packet period",
            Self::HeadsAlone => "by its two heads alone, too few packets to check their period",
        }
    }
}

impl std::fmt::Display for Basis {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.words())
    }
}
