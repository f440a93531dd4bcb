//! The sensors of a run.

use std::net::Ipv4Addr;

use sweepd_core::sensor::Model;

/// A sensor of the run.
pub struct Sensor {
    /// Its name in the configuration.
    pub name: &'static str,
    /// Its model.
    pub model: Model,
    /// Where it sends from.
    pub address: Ipv4Addr,
}

/// The sensors.
pub const SENSORS: [Sensor; 2] = [
    Sensor {
        name: "vlp",
        model: Model::Vlp16,
        address: Ipv4Addr::new(127, 0, 0, 2),
    },
    Sensor {
        name: "hdl",
        model: Model::Hdl64eS2,
        address: Ipv4Addr::new(127, 0, 0, 3),
    },
];
