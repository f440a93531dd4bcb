//! The sensors: each model as a table chosen once, and where each of its beams points.
//!
//! * [`model`]: factory bytes, firing order and timing.
//! * `calibration`: the beams, their elevations and offsets, and the rows that follow from them.
//! * `read`: calibration files, in one of two formats, [`db_xml`] and [`ros_yaml`].
//! * [`stream`]: the calibration that an HDL-64E sends; [`mod@unit`]: what else it sends.
//! * [`compare`]: the values in which two calibrations differ.
//! * [`detect`]: which model a stream of packets comes from.

pub(crate) mod calibration;
pub mod compare;
pub mod db_xml;
pub mod detect;
mod fit;
pub mod model;
pub(crate) mod read;
pub mod ros_yaml;
pub mod stream;
mod table;
pub mod unit;

pub use calibration::{Beam, Calibration, CalibrationError, Intensity, Remark, TwoPoint};
pub use model::{Model, ModelExt};
pub use read::MAX_FILE_LEN;
