//! The status of a simulated HDL-64E in bytes 1204 and 1205 of its packets.

use zerocopy::little_endian::{I16, U16};

use super::clock::Clock;
use super::config::{EmitterConfig, destination};
use super::gps::said_ns;
use sweepd_core::sensor::{Model, stream};
use sweepd_core::wire::data::ReturnMode;
use sweepd_core::wire::hdl64::{
    self, CYCLE_LEN, CalibrationTime, DUMP_PACKETS, Dump, Gps, Live, Series, Warnings,
};
use sweepd_core::wire::nmea::civil_from_days;
use sweepd_core::wire::position::Pps;

/// 2000-01-01 00:00 UTC, when the clock of a unit without GPS starts, nanoseconds since 1970.
const START_OF_UNIT_NS: i64 = 946_684_800_000_000_000;
/// Bits of the warnings: a pulse per second arrives; times arrive.
const PPS_PRESENT: u8 = 1 << 5;
const GPS_TIME_PRESENT: u8 = 1 << 6;

/// The status of a unit.
#[derive(Clone, Debug)]
pub struct Status {
    series: Series,
    dump: Dump,
}

/// The dump of a sensor as it is configured, without warnings.
///
/// # Errors
/// A sentence: its calibration does not fit into the stream.
pub fn dump(config: &EmitterConfig) -> Result<Dump, String> {
    let mut dump = Dump::new(series(config.model), &stream::records(&config.beams())?);
    dump.noise = [16, 14];
    dump.calibration_time = CalibrationTime {
        year: 25,
        month: 11,
        day: 4,
        hour: 9,
        minute: 41,
        second: 12,
    };
    dump.humidity = 38;
    dump.rpm = I16::new(config.rpm.round() as i16);
    dump.life_hours = U16::new(1_234);
    dump.source = config.address.octets();
    dump.destination = destination(config.model, config.address).octets();
    Ok(dump)
}

fn series(model: Model) -> Series {
    if model == Model::Hdl64eS2 {
        Series::S21
    } else {
        Series::S3
    }
}

impl EmitterConfig {
    /// Whether there can be such a sensor.
    ///
    /// # Errors
    /// A sentence with the contradiction.
    pub fn check(&self) -> Result<(), String> {
        let found = self.beams().beams().len();
        let expected = self.spec.channels;
        if found != expected {
            return Err(format!(
                "a calibration of {found} beams, the {} has {expected}",
                self.model
            ));
        }
        if self.model == Model::Hdl64eS2
            && (self.return_mode == ReturnMode::Dual || self.mode_switch.is_some())
        {
            return Err(format!(
                "an {} reports one return; an {} reports two",
                self.model,
                Model::Hdl64eS3
            ));
        }
        if self.model.is_hdl64e() {
            dump(self).map(drop)
        } else {
            Ok(())
        }
    }
}

impl Status {
    /// The status of a sensor.
    ///
    /// # Errors
    /// A sentence: its calibration does not fit into the stream.
    pub fn new(config: &EmitterConfig) -> Result<Self, String> {
        Ok(Self {
            series: series(config.model),
            dump: dump(config)?,
        })
    }

    /// Type and value in a data packet. All packets of a cycle give the same time: that of the
    /// first one's stamp, this many nanoseconds after the first shot of all.
    pub fn pair(&self, config: &EmitterConfig, ordinal: u64, elapsed_ns: i64) -> (u8, u8) {
        let begun = ordinal - ordinal % CYCLE_LEN as u64;
        let (pps, sentence) = config.clock.received(elapsed_ns);
        let (gps, warnings) = match (pps, sentence.is_some()) {
            (Pps::Locked, _) => (Gps::Both, PPS_PRESENT | GPS_TIME_PRESENT),
            (_, true) => (Gps::Sentence, GPS_TIME_PRESENT),
            (_, false) => (Gps::None, 0),
        };
        let mut dump = self.dump;
        dump.set_return_mode(config.mode_of(begun));
        dump.set_warnings(self.series, Warnings(warnings));
        // 4.07 (S2.1), and what an S3 was seen with.
        let firmware = if self.series == Series::S21 {
            0x47
        } else {
            227
        };
        let live = Live {
            clock: clock(config, elapsed_ns),
            gps,
            temperature_c: 41,
            firmware,
        };
        hdl64::pair(
            &dump,
            self.series,
            &live,
            (ordinal % DUMP_PACKETS as u64) as usize,
        )
    }
}

/// The unit's own UTC.
fn clock(config: &EmitterConfig, elapsed_ns: i64) -> hdl64::Clock {
    let utc_ns = match config.clock {
        Clock::Gps { reception, .. } if reception.follows_utc(elapsed_ns) => {
            said_ns(config, elapsed_ns, 0)
        }
        Clock::Gps { .. } => START_OF_UNIT_NS + elapsed_ns,
        Clock::Free { hour_ns } => START_OF_UNIT_NS + hour_ns + elapsed_ns,
    };
    let seconds = utc_ns.div_euclid(1_000_000_000);
    let second = seconds.rem_euclid(86_400);
    let (year, month, day) = civil_from_days(seconds.div_euclid(86_400));
    hdl64::Clock {
        hour: (second / 3_600) as u8,
        minute: (second / 60 % 60) as u8,
        second: (second % 60) as u8,
        day: day as u8,
        month: month as u8,
        year: year.rem_euclid(100) as u8,
    }
}
