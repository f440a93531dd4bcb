//! The sensors: what each model is, as a table chosen once, and where each of its beams points.
//!
//! * [`model`]: names, factory bytes, firing order and timing.
//! * [`calibration`]: the beams, their elevations and offsets, and the rows that follow from them.
//! * [`db_xml`], [`ros_yaml`]: the two forms in which people have calibrations; [`stream`]: that in
//!   which an HDL-64E sends its own; [`mod@unit`]: what else that says.
//! * [`compare`]: in what two calibrations differ.
//! * [`detect`]: which model a stream of packets comes from.

pub mod calibration;
pub mod compare;
pub mod db_xml;
pub mod detect;
pub mod model;
pub mod ros_yaml;
pub mod stream;
mod table;
pub mod unit;

pub use calibration::{Beam, Calibration, CalibrationError};
pub use model::Model;
