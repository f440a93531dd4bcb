//! Captures of an HDL-64E that sees nothing and tells its status.

use std::fmt::Write as _;
use std::fs::File;
use std::io::BufWriter;
use std::path::Path;

use sweepd::input::PcapWriter;
use sweepd::input::write::Addressed;
use sweepd::sensor::{Calibration, stream};
use sweepd::wire::DataPacket;
use sweepd::wire::data::FLAG_BANK_1;
use sweepd::wire::hdl64::{CalibrationTime, Clock, Dump, Gps, Live, Series, Warnings, pair};
use zerocopy::little_endian::I16;

pub const LIVE: Live = Live {
    clock: Clock {
        hour: 12,
        minute: 30,
        second: 7,
        day: 4,
        month: 5,
        year: 26,
    },
    gps: Gps::Both,
    temperature_c: 41,
    firmware: 0x47,
};

/// The dump of a unit with this calibration.
pub fn dump(calibration: &Calibration, series: Series) -> Dump {
    let mut dump = Dump::new(series, &stream::records(calibration).unwrap());
    dump.calibration_time = CalibrationTime {
        year: 16,
        month: 11,
        day: 15,
        hour: 12,
        minute: 47,
        second: 47,
    };
    dump.rpm = I16::new(600);
    (dump.source, dump.destination) = ([192, 168, 3, 43], [192, 168, 3, 255]);
    dump.set_warnings(series, Warnings(0b0110_0001));
    dump
}

/// A capture of the packets that `keep` keeps, of as many as there are from `start` on.
pub fn write_capture(
    path: &Path,
    (dump, series): (&Dump, Series),
    packets: std::ops::Range<usize>,
    keep: impl Fn(usize) -> bool,
) {
    let mut writer = PcapWriter::new(BufWriter::new(File::create(path).unwrap())).unwrap();
    let (source, destination) = (
        "192.168.3.43:2368".parse().unwrap(),
        "192.168.3.255:2368".parse().unwrap(),
    );
    for index in packets.filter(|&index| keep(index)) {
        let (kind, value) = pair(dump, series, &LIVE, index);
        let mut packet = DataPacket::new(index as u32 * 288, kind, value);
        for (number, block) in packet.blocks.iter_mut().enumerate() {
            if number % 2 == 1 {
                block.flag.set(FLAG_BANK_1);
            }
            block.set_azimuth_cdeg(((index * 6 + number / 2) * 17 % 36_000) as u16);
        }
        let arrival_ns = 1_770_000_000_000_000_000 + index as i64 * 288_000;
        writer
            .write(&Addressed {
                arrival_ns,
                source,
                destination,
                payload: packet.emit(),
            })
            .unwrap();
    }
    writer.finish().unwrap();
}

/// Elevations of the unit that made the scan, degrees, and of the one whose calibration there is.
pub fn elevation_deg(row: usize, of_scan: bool) -> f64 {
    2.0 - 0.42 * row as f64 + if of_scan { 0.3 } else { 0.0 }
}

/// The calibration of a unit.
pub fn calibration_yaml() -> String {
    let mut yaml = "num_lasers: 64\ndistance_resolution: 0.002\nlasers:\n".to_owned();
    for row in 0..64 {
        let (elevation, rotation) = (
            elevation_deg(row, false).to_radians(),
            0.05 * (row % 4) as f64 - 0.07,
        );
        let _ = writeln!(
            yaml,
            "- {{laser_id: {row}, vert_correction: {elevation}, rot_correction: {rotation}, dist_correction: 1.3, \
             vert_offset_correction: 0.2}}"
        );
    }
    yaml
}
