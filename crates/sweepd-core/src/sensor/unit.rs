//! The status of an HDL-64E, for the decoder: its calibration, clock and power.

use super::compare::{Difference, differences};
use super::{Calibration, stream};
use crate::assemble::gps::Heard;
use crate::wire::DataPacket;
use crate::wire::data::ReturnMode;
use crate::wire::hdl64::{
    CYCLE_LEN, CalibrationTime, DUMP_LEN, DUMP_PACKETS, Dump, Gps, Series, Status,
};

/// One unit: the part of its status that has been received.
#[derive(Clone, Debug, Default)]
pub struct Unit {
    status: Status,
    heard: usize,
    /// The dump that was compared, or will be compared, with the calibration in use.
    compared: Option<Dump>,
    /// The packet count at which its beams changed; `None` once they have settled.
    changed: Option<usize>,
}

/// The part of the status that decoding depends on; see [`Unit::hear`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct UnitUpdate {
    /// Its series, once that is known.
    pub series: Option<Series>,
    /// What it says of UTC, to the second: a GPS receiver must give both pulse and sentence.
    pub heard: Heard,
}

impl Unit {
    /// Takes a packet of this unit. Once in each cycle of the status it gives the present state.
    pub fn hear(&mut self, packet: &DataPacket) -> Option<UnitUpdate> {
        self.status
            .push(packet.return_mode, packet.product, packet.stamp_us());
        self.heard += 1;
        self.heard.is_multiple_of(CYCLE_LEN).then(|| self.said())
    }

    fn said(&self) -> UnitUpdate {
        let clock = self.status.clock().and_then(|clock| clock.utc_ns());
        let heard = match (self.status.gps(), clock) {
            (Some(Gps::Both), Some(utc_ns)) => Heard::Utc(utc_ns),
            (Some(Gps::Both), None) => Heard::Nothing,
            _ => Heard::Lost,
        };
        UnitUpdate {
            series: self.status.series(),
            heard,
        }
    }

    /// Whether it is known to send corrected reflectivities. One packet of each dump says so.
    pub fn is_normalised(&self) -> bool {
        self.status
            .power()
            .is_some_and(|power| power.is_normalised())
    }

    /// Bytes of the calibration that are known, and how many there are.
    pub fn known(&self) -> (usize, usize) {
        (self.status.known(), DUMP_LEN)
    }

    /// The calibration, when it is complete and verified.
    ///
    /// # Errors
    /// A sentence: a value of a beam is impossible.
    pub fn calibration(&self) -> Option<Result<Calibration, String>> {
        self.status.dump().map(stream::calibration)
    }

    /// Its series, once that is known.
    pub fn series(&self) -> Option<Series> {
        self.status.series()
    }

    /// The return mode that it is set to, once known.
    pub fn return_mode(&self) -> Option<ReturnMode> {
        self.status.return_mode()
    }

    /// Its temperature, degrees Celsius, once known.
    pub fn temperature_c(&self) -> Option<i8> {
        self.status.temperature_c()
    }

    /// The signals that it receives from a GPS receiver, once known.
    pub fn gps(&self) -> Option<Gps> {
        self.status.gps()
    }

    /// When it was calibrated, as it reports.
    pub fn calibrated(&self) -> Option<CalibrationTime> {
        self.status.calibrated()
    }

    /// Whether its whole status can be of one unit. `false` for a while after another unit seems to
    /// have replaced it.
    pub fn is_settled(&self) -> bool {
        self.changed.is_none()
    }

    /// Forgets the comparison with the calibration in use, because another may be used from now on.
    pub fn forget_comparison(&mut self) {
        self.compared = None;
    }

    /// Differences of the calibration in use from the unit's own, given once for each that it
    /// sends. When another unit replaces it, the beams change one after the other, and on an S2.1
    /// nothing marks the change: so the comparison waits until they have stayed the same for a
    /// whole dump.
    pub fn differences(&mut self, used: &Calibration) -> Option<Vec<Difference>> {
        let dump = self.status.dump()?;
        let is_same = self
            .compared
            .is_some_and(|before| before.records().eq(dump.records()));
        if !is_same {
            if self.compared.replace(*dump).is_some() {
                self.changed = Some(self.heard);
                return None;
            }
        } else {
            self.changed
                .take_if(|changed| self.heard - *changed >= DUMP_PACKETS)?;
        }
        Some(differences(used, &stream::calibration(dump).ok()?))
    }
}
