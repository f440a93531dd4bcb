//! What can be wrong with a cloud.

use crate::cloud::CloudError;

/// Why a cloud cannot be encoded.
#[derive(Debug, thiserror::Error)]
pub enum FromCloudError {
    /// The cloud is not in the order of its rings.
    #[error(transparent)]
    Cloud(#[from] CloudError),
    /// Nothing to encode.
    #[error("no points")]
    Empty,
    /// More rings than beams.
    #[error("{found} rings, the HDL-64E has {beams} beams")]
    Rings {
        /// Rings of the cloud.
        found: usize,
        /// Beams of the sensor.
        beams: usize,
    },
    /// A ring is too far from its beam.
    #[error(
        "a ring at {ring_deg:.2} degrees would be that of the beam at {beam_deg:.2}; the cloud is of another sensor, or \
         the calibration is"
    )]
    Apart {
        /// Median elevation of the ring, degrees.
        ring_deg: f64,
        /// Elevation of the beam by the calibration, degrees.
        beam_deg: f64,
    },
    /// A calibration that is not one of an HDL-64E, or that its status stream cannot carry.
    #[error("the calibration: {0}")]
    Calibration(String),
}
