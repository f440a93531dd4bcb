//! Real captures: each is detected as the sensor that made it.

use std::path::{Path, PathBuf};

use sweepd::sensor::detect::{Basis, DetectError, Detection, Detector, MAX_PACKETS};
use sweepd::sensor::{Model, ModelExt};
use sweepd::wire::data::{DATA_PACKET_LEN, DataPacket, ReturnMode};

/// The folder of real captures, if it is there.
fn data_dir() -> PathBuf {
    sweepd_testkit::data_dir().join("pcap")
}

/// The data packets of a classic little-endian capture of Ethernet, IPv4 and UDP without anything
/// special.
fn data_packets(path: &Path) -> Vec<Vec<u8>> {
    const HEADERS: usize = 14 + 20 + 8;
    let file = std::fs::read(path).unwrap();
    assert_eq!(
        file[..4],
        0xA1B2_C3D4_u32.to_le_bytes(),
        "{}",
        path.display()
    );
    assert_eq!(file[20..24], 1_u32.to_le_bytes(), "{}", path.display());
    let mut packets = Vec::new();
    let mut rest = &file[24..];
    while !rest.is_empty() {
        let len = u32::from_le_bytes(rest[8..12].try_into().unwrap()) as usize;
        let (frame, after) = rest[16..].split_at(len);
        if frame.len() == HEADERS + DATA_PACKET_LEN {
            packets.push(frame[HEADERS..].to_vec());
        }
        rest = after;
    }
    packets
}

/// The verdict of a detector that starts with this packet.
fn dump_state(packets: &[Vec<u8>], forced: Option<Model>) -> Result<Detection, DetectError> {
    let mut detector = Detector::new(forced);
    packets
        .iter()
        .find_map(|bytes| detector.observe(DataPacket::parse(bytes).unwrap()))
        .unwrap_or_else(|| detector.conclude())
}

#[test]
#[cfg_attr(without_captures, ignore = "no captures")]
fn every_capture_is_detected_as_its_sensor() {
    let dir = data_dir();
    let is = |model, return_mode, basis| {
        Ok(Detection {
            model,
            return_mode,
            basis,
            spec: model.spec(),
        })
    };
    let (strongest, sure) = (ReturnMode::Strongest, Basis::BytesAndPeriod);
    let expected = [
        ("hdl32e_mrpt-sample", is(Model::Hdl32e, strongest, sure)),
        (
            "hdl32e_veloview-monterey-a",
            is(Model::Hdl32e, strongest, sure),
        ),
        ("vlp16_einride-a", is(Model::Vlp16, strongest, sure)),
        (
            "vlp16_gadomski-position",
            Err(DetectError::TooFewPackets { packets: 0 }),
        ),
        (
            "vlp16_gadomski-single",
            is(Model::Vlp16, strongest, Basis::BytesAlone),
        ),
        ("vlp16_mrpt-gps", is(Model::Vlp16, strongest, sure)),
        (
            "vlp16_rlu-velodyne-example",
            is(Model::Vlp16, strongest, sure),
        ),
        (
            "vlp16_timm-dual-a",
            is(Model::Vlp16, ReturnMode::Dual, sure),
        ),
        (
            "vlp16_veloview-90deg-a",
            is(Model::Vlp16, strongest, Basis::Period),
        ),
        ("vlp32c_nebula-fov180-a", is(Model::Vlp32c, strongest, sure)),
        (
            "vls128_nebula-a",
            is(Model::Vls128, strongest, Basis::FourBanks),
        ),
    ];
    assert_eq!(
        std::fs::read_dir(&dir).unwrap().count(),
        expected.len(),
        "a capture without a row here"
    );
    for (name, expected) in expected {
        let packets = data_packets(&dir.join(name).with_extension("pcap"));
        assert_eq!(dump_state(&packets, None), expected, "{name}");
        // Wherever a stream is joined, the verdict is the same.
        for start in 0..packets.len().saturating_sub(MAX_PACKETS) {
            assert_eq!(
                dump_state(&packets[start..], None),
                expected,
                "{name} from packet {start}"
            );
        }
    }
}

#[test]
#[cfg_attr(without_captures, ignore = "no captures")]
fn captures_with_blank_factory_bytes_are_detected_by_the_period() {
    let dir = data_dir();
    let rows = [
        ("hdl32e_mrpt-sample", Model::Hdl32e, ReturnMode::Strongest),
        ("vlp16_mrpt-gps", Model::Vlp16, ReturnMode::Strongest),
        ("vlp16_timm-dual-a", Model::Vlp16, ReturnMode::Dual),
    ];
    for (name, model, return_mode) in rows {
        let mut packets = data_packets(&dir.join(name).with_extension("pcap"));
        packets.iter_mut().for_each(|bytes| bytes[1204..].fill(0));
        let found = Detection {
            model,
            return_mode,
            basis: Basis::Period,
            spec: model.spec(),
        };
        assert_eq!(dump_state(&packets, None), Ok(found), "{name}");
    }
}

#[test]
#[cfg_attr(without_captures, ignore = "no captures")]
fn the_wrong_model_given_is_refused() {
    let dir = data_dir();
    for (name, model) in [
        ("hdl32e_mrpt-sample", Model::Vlp16),
        ("vlp16_veloview-90deg-a", Model::Hdl32e),
    ] {
        let packets = data_packets(&dir.join(name).with_extension("pcap"));
        let error = dump_state(&packets, Some(model)).unwrap_err();
        assert!(
            matches!(error, DetectError::Contradiction { said, given: true, .. } if said == model),
            "{error}"
        );
    }
}
