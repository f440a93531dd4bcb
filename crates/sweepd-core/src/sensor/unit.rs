//! What an HDL-64E says of itself along with its packets, for the decoder: its
//! calibration, its clock, its power.

use super::compare::{Difference, differences};
use super::{Calibration, stream};
use crate::wire::DataPacket;
use crate::wire::data::ReturnMode;
use crate::wire::hdl64::{
    CYCLE_LEN, CalibrationTime, DUMP_LEN, DUMP_PACKETS, Dump, Gps, Series, Status,
};

/// One unit, as far as it has been heard.
#[derive(Clone, Debug, Default)]
pub struct Unit {
    status: Status,
    heard: usize,
    /// The dump that was compared with the calibration in use, or that is to be.
    compared: Option<Dump>,
    /// Since when its beams are others than they were before, in packets heard; `None` once they
    /// have settled.
    changed: Option<usize>,
}

/// What a unit says that decoding depends on; see [`Unit::hear`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct UnitUpdate {
    /// Its series, once that is known.
    pub series: Option<Series>,
    /// UTC to the second, nanoseconds since 1970, while a GPS receiver gives both pulse and
    /// sentence.
    pub utc_ns: Option<i64>,
}

impl Unit {
    /// Takes a packet of this unit. Once a cycle of the status it gives what the unit says by then.
    pub fn hear(&mut self, packet: &DataPacket) -> Option<UnitUpdate> {
        self.status
            .push(packet.return_mode, packet.product, packet.stamp_us());
        self.heard += 1;
        self.heard.is_multiple_of(CYCLE_LEN).then(|| self.said())
    }

    fn said(&self) -> UnitUpdate {
        let utc_ns = self
            .status
            .clock()
            .filter(|_| self.status.gps() == Some(Gps::Both))
            .and_then(|c| c.utc_ns());
        UnitUpdate {
            series: self.status.series(),
            utc_ns,
        }
    }

    /// Whether it is known to send reflectivities that are corrected already. It says so in one
    /// packet of each dump.
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
    /// A sentence: a beam cannot be as it says.
    pub fn calibration(&self) -> Option<Result<Calibration, String>> {
        self.status.dump().map(stream::calibration)
    }

    /// Its series, once that is known.
    pub fn series(&self) -> Option<Series> {
        self.status.series()
    }

    /// The return mode that it is set to, once that is known.
    pub fn return_mode(&self) -> Option<ReturnMode> {
        self.status.return_mode()
    }

    /// Its temperature, degrees Celsius, once that is known.
    pub fn temperature_c(&self) -> Option<i8> {
        self.status.temperature_c()
    }

    /// What it receives from a GPS receiver, once that is known.
    pub fn gps(&self) -> Option<Gps> {
        self.status.gps()
    }

    /// When it was calibrated, by its own account.
    pub fn calibrated(&self) -> Option<CalibrationTime> {
        self.status.calibrated()
    }

    /// Whether all that it said can be of one unit: no other seems to have taken its place a short
    /// while ago.
    pub fn is_settled(&self) -> bool {
        self.changed.is_none()
    }

    /// Forgets that its calibration was compared with one, since another may be in use from now on.
    pub fn forget_comparison(&mut self) {
        self.compared = None;
    }

    /// In what the calibration in use differs from the unit's own; once for each that it sends.
    /// When another unit takes its place, the beams change one after the other, and nothing may
    /// tell (S2.1) that they are of two units: then it is asked once they have stayed the same for
    /// a whole dump.
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
