//! Layout of a data packet: blocks and records of firings, channels and returns.
//!
//! ```text
//! blocks of one azimuth     one return     two returns
//! VLP-16, HDL-32E           any            last, strong
//! HDL-64E                   upper, lower   upper and lower of strong, upper and lower of last
//! VLS-128                   four banks     strong and last of each of four banks
//! ```
//!
//! (VLP-16 User Manual, section 9.3; HDL-64E S3 manual, 63-HDL64ES3, pp. 20 and 47. The manual does
//! not define which pair of an HDL-64E holds which return: this follows VeloView and
//! velodyne_decoder. For the VLS-128 sources contradict each other, too: this follows UniBwTAS/velodyne,
//! whose authors have one.)

use std::ops::Range;

use sweepd_core::sensor::model::Spec;
use sweepd_core::wire::data::{DataPacket, RECORDS, ReturnMode};

/// The places of a packet.
#[derive(Clone, Copy, Debug)]
pub struct Layout {
    spec: &'static Spec,
    mode: ReturnMode,
}

impl Layout {
    /// That of a model in a mode.
    pub fn new(spec: &'static Spec, mode: ReturnMode) -> Self {
        Self { spec, mode }
    }

    /// Sets the bank marker of each block.
    pub fn mark(&self, packet: &mut DataPacket) {
        self.spec.mark_banks(packet, self.mode);
    }

    /// Whether a firing is the first of its blocks, and so the one whose azimuth they say.
    pub fn begins_blocks(&self, firing: usize) -> bool {
        firing.is_multiple_of(self.spec.firings_per_azimuth())
    }

    /// The blocks that a firing is in.
    pub fn blocks(&self, firing: usize) -> Range<usize> {
        let blocks = self.spec.places(self.mode).blocks;
        let first = firing / self.spec.firings_per_azimuth() * blocks;
        first..first + blocks
    }

    /// Block and record of a return: number 0 is the only or the last one, 1 the strongest or
    /// second strongest.
    pub fn place(&self, firing: usize, channel: usize, number: usize) -> (usize, usize) {
        let places = self.spec.places(self.mode);
        let swaps = self.spec.banks() > 1 && self.mode == ReturnMode::Dual;
        let number = if swaps { 1 - number } else { number };
        let block = self.blocks(firing).start
            + number * places.return_step
            + channel / RECORDS * places.bank_step;
        (
            block,
            firing % self.spec.firings_per_azimuth() * self.spec.channels + channel % RECORDS,
        )
    }
}
