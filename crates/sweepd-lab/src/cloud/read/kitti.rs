//! Clouds without a head: f32 after f32, little-endian.

use super::{Cloud, Field, ReadError, Roles, Scalar, binary};

/// x, y, z, intensity, ring.
const FIELDS: usize = 5;

/// The points of nuScenes' `.pcd.bin`.
pub(super) fn nuscenes(bytes: &[u8]) -> Result<Cloud, ReadError> {
    let step = FIELDS * Scalar::F32.size();
    if !bytes.len().is_multiple_of(step) {
        let message = format!(
            "{} bytes, expected a multiple of {step}: x, y, z, intensity and ring as f32; if it is a KITTI cloud, say so",
            bytes.len()
        );
        return Err(ReadError::byte(bytes.len() - bytes.len() % step, message));
    }
    let fields: [Field; FIELDS] = std::array::from_fn(|field| Field {
        scalar: Scalar::F32,
        start: field * Scalar::F32.size(),
        step,
    });
    let roles = Roles {
        xyz: [0, 1, 2],
        intensity: Some(3),
        ring: Some(4),
    };
    binary(bytes, bytes.len() / step, &fields, roles, false)
        .map_err(|(byte, message)| ReadError::byte(byte, message))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_and_rings_by_hand() {
        let bytes: Vec<u8> = [1.0, 2.0, 3.0, 4.0, 31.0, -1.0, 0.5, 0.25, 0.0, 7.0_f32]
            .iter()
            .flat_map(|value| value.to_le_bytes())
            .collect();
        let cloud = nuscenes(&bytes).unwrap();
        assert_eq!(cloud.points, [[1.0, 2.0, 3.0, 4.0], [-1.0, 0.5, 0.25, 0.0]]);
        assert_eq!(cloud.rings.unwrap(), [31, 7]);
        let error = nuscenes(&bytes[..39]).unwrap_err().to_string();
        assert!(
            error.starts_with("byte 20: 39 bytes, expected a multiple of 20"),
            "{error}"
        );
        let mut broken = bytes;
        broken[16..20].copy_from_slice(&0.5_f32.to_le_bytes());
        let error = nuscenes(&broken).unwrap_err().to_string();
        assert!(
            error.starts_with("byte 16: point 0 (counted from 0) has ring 0.5"),
            "{error}"
        );
    }
}
