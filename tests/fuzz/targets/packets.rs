//! What a sensor sends: data packets, position packets with their NMEA sentence, the status of an
//! HDL-64E.

use sweepd::sensor::compare::differences;
use sweepd::sensor::detect::Detector;
use sweepd::sensor::unit::Unit;
use sweepd::sensor::{Model, stream};
use sweepd::wire::DataPacket;
use sweepd::wire::data::{BLOCKS, DATA_PACKET_LEN, RECORDS, ReturnMode};
use sweepd::wire::hdl64::{Clock, Dump, Gps, Live, Series, Status, Warnings, pair};
use sweepd::wire::nmea::Rmc;
use sweepd::wire::position::Position;
use sweepd_lab::simulate::unit::unit;

use super::Numbers;

/// Payloads, one behind the other: each is refused, or written as it was read; and what the first
/// ones say of the model.
pub fn data_packet(input: &[u8]) {
    let mut detectors: Vec<Detector> = [None]
        .into_iter()
        .chain(Model::ALL.map(Some))
        .map(Detector::new)
        .collect();
    let mut unit = Unit::default();
    for payload in input.chunks(DATA_PACKET_LEN) {
        let packet = match DataPacket::parse(payload) {
            Ok(packet) => packet,
            Err(error) => {
                assert!(!error.to_string().is_empty());
                continue;
            }
        };
        assert_eq!(packet.emit(), payload);
        assert!(
            packet
                .blocks
                .iter()
                .take(8)
                .all(|block| block.azimuth_cdeg() < 36_000)
        );
        assert!(packet.returns() <= BLOCKS * RECORDS);
        let _ = (packet.banks(), ReturnMode::from_byte(packet.return_mode));
        let _ = (0..=BLOCKS + 1)
            .filter(|&of| packet.azimuths_in_groups(of, BLOCKS))
            .count();
        unit.hear(packet);
        for detector in &mut detectors {
            let _ = detector
                .observe(packet)
                .map(|result| result.map_err(|error| error.to_string()));
        }
    }
    for detector in &detectors {
        let _ = detector.conclude().map_err(|error| error.to_string());
    }
}

/// A position packet; and the same bytes as a sentence.
pub fn position_packet(input: &[u8]) {
    if let Ok(position) = Position::parse(input) {
        let bytes = position.emit();
        let again = Position::parse(&bytes).expect("what was written is read");
        // A sentence without room for its line end is cut.
        assert!(
            position
                .nmea
                .unwrap_or_default()
                .starts_with(again.nmea.unwrap_or_default())
        );
        assert_eq!(
            Position {
                nmea: position.nmea,
                ..again
            },
            position
        );
        for chip in position.inertial.iter().flatten() {
            assert!(
                [chip.gyro_deg_s(), chip.temperature_c()]
                    .into_iter()
                    .chain(chip.accel_g())
                    .all(f64::is_finite)
            );
        }
        position.nmea.into_iter().for_each(sentence);
    }
    sentence(&String::from_utf8_lossy(input));
}

/// What is read of a sentence is what can be written again.
fn sentence(text: &str) {
    let rmc = match Rmc::parse(text) {
        Ok(rmc) => rmc,
        Err(error) => return assert!(!error.to_string().is_empty()),
    };
    let again = Rmc::parse(&rmc.emit())
        .unwrap_or_else(|error| panic!("{rmc:?} -> {:?}: {error}", rmc.emit()));
    assert!(
        again.valid == rmc.valid && again.utc_ns.abs_diff(rmc.utc_ns) <= 10_000_000,
        "{rmc:?} -> {again:?}"
    );
}

const CLOCK: Clock = Clock {
    hour: 12,
    minute: 30,
    second: 7,
    day: 4,
    month: 5,
    year: 26,
};
/// Most packets of a stream: five dumps.
const MOST_PACKETS: usize = 5 * 4160;

/// The status bytes of packets: any at all, or those of a unit with a few edits.
///
/// ```text
/// 0, then packets of 6 bytes     type, value, stamp
/// series, first packet u16, then edits of 4 bytes   what u8, how many u8, value u16
/// ```
pub fn status_stream(input: &[u8]) {
    let mut numbers = Numbers(input);
    let mut status = Status::new();
    let series = match numbers.u8() % 3 {
        0 => {
            while !numbers.is_empty() {
                status.push(numbers.u8(), numbers.u8(), numbers.u32());
            }
            return told(&status);
        }
        1 => Series::S21,
        _ => Series::S3,
    };
    let records = stream::records(&unit(7)).expect("a unit of the simulator can tell itself");
    let mut dump = Dump::new(series, &records);
    dump.set_warnings(series, Warnings(0b0110_0001));
    let live = Live {
        clock: CLOCK,
        gps: Gps::Both,
        temperature_c: 41,
        firmware: 0x47,
    };
    let (mut index, mut stamp_us, mut pushed) = (usize::from(numbers.u16()), 0_u32, 0);
    let mut send = |status: &mut Status,
                    index: &mut usize,
                    stamp_us: &mut u32,
                    kind_xor: u8,
                    value_xor: u8| {
        let (kind, value) = pair(&dump, series, &live, *index);
        status.push(kind ^ kind_xor, value ^ value_xor, *stamp_us);
        (*index, *stamp_us) = (*index + 1, stamp_us.wrapping_add(288));
        pushed += 1;
        pushed < MOST_PACKETS
    };
    while !numbers.is_empty() {
        let (what, count, value) = (numbers.u8(), usize::from(numbers.u8()), numbers.u16());
        let [low, high] = value.to_le_bytes();
        match what % 6 {
            // Lost ones.
            0 => (index, stamp_us) = (index + count, stamp_us.wrapping_add(count as u32 * 288)),
            // Wrong ones.
            1 => drop((0..count).all(|_| send(&mut status, &mut index, &mut stamp_us, low, high))),
            // A clock that jumps, or stops.
            2 => stamp_us = stamp_us.wrapping_add(u32::from(value) << (count % 17)),
            3 => stamp_us = u32::from(value),
            // Another place of the stream.
            4 => index = index.wrapping_add(usize::from(value)) % (1 << 24),
            _ => drop((0..16 * count).all(|_| send(&mut status, &mut index, &mut stamp_us, 0, 0))),
        }
    }
    while send(&mut status, &mut index, &mut stamp_us, 0, 0) {}
    told(&status);
}

/// All that can be asked of a status.
fn told(status: &Status) {
    let _ = (
        status.dump_state(),
        status.known(),
        status.series(),
        status.gps(),
        status.temperature_c(),
    );
    let _ = (
        status.clock().and_then(|clock| clock.utc_ns()),
        status.firmware(),
        status.rpm(),
        status.fov_cdeg(),
    );
    let _ = (
        status.return_mode(),
        status.power().map(|power| power.is_normalised()),
        status.life_hours(),
    );
    let _ = (status.source(), status.destination(), status.calibrated());
    if let Some(warnings) = status.warnings() {
        let _ = (
            warnings.pps(),
            warnings.gps_time(),
            warnings.faults(Series::S3).count(),
        );
    }
    let Some(dump) = status.dump() else { return };
    let _ = (
        dump.calibrated(),
        dump.return_mode(),
        dump.records().count(),
    );
    match stream::calibration(dump) {
        Ok(calibration) => {
            assert!(differences(&calibration, &calibration).is_empty());
            let _ = stream::records(&calibration);
            let _ = calibration.for_model(Model::Hdl64eS3);
        }
        Err(message) => assert!(!message.is_empty()),
    }
}
