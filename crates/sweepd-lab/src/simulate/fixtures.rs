//! The captures that the project ships in `pcap_fixtures/`, and how each is made.

use super::gps::{Clock, Reception};
use super::{Emitter, EmitterConfig, Faults, Scene, SimulatedDatagram, deliver, street};
use sweepd_core::sensor::Model;
use sweepd_core::wire::data::ReturnMode;

/// A capture of the simulated street.
#[derive(Clone, Debug)]
pub struct Fixture {
    /// Name of the file in `pcap_fixtures/`; `.gz` at its end means compressed.
    pub file: &'static str,
    /// The sensor.
    pub config: EmitterConfig,
    /// What the network did.
    pub faults: Faults,
}

/// What a capture holds.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counts {
    /// Data packets in the file, duplicates with them.
    pub data: u64,
    /// Position packets in the file.
    pub position: u64,
    /// Data packets that are missing.
    pub lost: u64,
    /// Data packets that are there twice.
    pub duplicated: u64,
    /// Data packets that come after the one that followed them.
    pub swapped: u64,
    /// Records with a distance.
    pub returns: u64,
}

impl Fixture {
    /// The datagrams, in the order of the file, with their truth.
    pub fn datagrams<'a>(
        &self,
        scene: &'a Scene,
    ) -> impl Iterator<Item = SimulatedDatagram> + use<'a> {
        deliver(
            Emitter::new(self.config.clone(), scene),
            self.faults.clone(),
        )
    }

    /// Its line in the table of `pcap_fixtures/README.md`.
    pub fn readme_row(&self, counts: &Counts) -> String {
        let EmitterConfig {
            model, return_mode, ..
        } = self.config;
        let Counts {
            data,
            position,
            lost,
            duplicated,
            swapped,
            returns,
        } = counts;
        let file = self.file;
        format!(
            "| {file} | {model} | {return_mode} | {data} | {position} | {lost} | {duplicated} | {swapped} | {returns} |"
        )
    }
}

impl Counts {
    /// Counts a datagram of a fixture.
    pub fn add(&mut self, one: &SimulatedDatagram) {
        match &one.truth {
            Some(truth) => {
                self.data += 1;
                self.returns += truth.returns.iter().flatten().flatten().count() as u64;
            }
            None => self.position += 1,
        }
    }

    /// Adds what the faults of a fixture did.
    pub fn with(self, faults: &Faults) -> Self {
        Self {
            lost: faults.lost_packets(),
            duplicated: faults.duplicated.len() as u64,
            swapped: faults.swapped.len() as u64,
            ..self
        }
    }
}

/// The street of all fixtures.
pub fn scene() -> Scene {
    street(2)
}

/// A VLP-16 in the old town of Frankfurt.
fn puck(return_mode: ReturnMode, turns: f64, start_deg: f64) -> EmitterConfig {
    let config = EmitterConfig::new(Model::Vlp16, return_mode).turns(turns);
    in_the_old_town(config, start_deg, 5)
}

/// A sensor whose receiver has a fix, on a host whose clock is 3.2 ms ahead. Every model sends about
/// 150 position packets a second.
fn in_the_old_town(
    mut config: EmitterConfig,
    start_deg: f64,
    data_per_position: u64,
) -> EmitterConfig {
    config.clock = Clock::Gps {
        position_deg: (50.110_6, 8.682_1),
        reception: Reception::ALWAYS,
    };
    // 2026-05-04 10:17:23 UTC.
    config.start_utc_ns = 1_777_889_843_000_000_000;
    config.host_ahead_ns = 3_200_000;
    config.data_per_position = data_per_position;
    config.encoder.start_deg = start_deg;
    config
}

/// An HDL-32E without a receiver, its clock about to pass its own hour.
fn hdl32e(return_mode: ReturnMode, turns: f64) -> EmitterConfig {
    let mut config = EmitterConfig::new(Model::Hdl32e, return_mode).turns(turns);
    config.clock = Clock::Free {
        hour_ns: 3_599_850_000_417,
    };
    config.encoder.start_deg = 222.68;
    config
}

/// An HDL-64E S2 whose receiver is locked, with a motor that drifts.
fn hdl64e_s2(seconds: f64, start_deg: f64) -> EmitterConfig {
    let mut config = EmitterConfig::new(Model::Hdl64eS2, ReturnMode::Strongest);
    config.motor.drift = 0.0003;
    hdl64e(config, i64::MIN, start_deg).seconds(seconds, None)
}

/// An HDL-64E S3 whose receiver is heard late, so that it is never locked.
fn hdl64e_s3(return_mode: ReturnMode, start_deg: f64) -> EmitterConfig {
    hdl64e(
        EmitterConfig::new(Model::Hdl64eS3, return_mode),
        200_000_000,
        start_deg,
    )
}

fn hdl64e(mut config: EmitterConfig, from_ns: i64, start_deg: f64) -> EmitterConfig {
    let reception = Reception {
        from_ns,
        to_ns: i64::MAX,
    };
    config.clock = Clock::Gps {
        position_deg: (50.110_6, 8.682_1),
        reception,
    };
    config.start_utc_ns = 1_777_889_843_000_000_000;
    config.encoder.start_deg = start_deg;
    // With less noise ranges compress better: a whole status takes 4160 packets.
    config.optics.noise_m = 0.004;
    config
}

/// A fixture that lost nothing.
fn clean(file: &'static str, config: EmitterConfig) -> Fixture {
    Fixture {
        file,
        config,
        faults: Faults::default(),
    }
}

/// All fixtures. Each begins and ends in the middle of a turn, as a capture does; the start is
/// chosen so that a block of each says 36000 at one of its wraps.
pub fn all() -> Vec<Fixture> {
    let losses = Faults {
        lost: vec![31..=31, 64..=66, 97..=97, 120..=129, 181..=181, 205..=206],
        duplicated: vec![45, 150],
        swapped: vec![80, 170],
        ..Faults::default()
    };
    vec![
        clean(
            "street_vlp16.pcap.gz",
            puck(ReturnMode::Strongest, 6.0, 118.98),
        ),
        clean("street_hdl32e.pcap.gz", hdl32e(ReturnMode::Strongest, 4.5)),
        clean(
            "street_vlp16_dual.pcap.gz",
            puck(ReturnMode::Dual, 4.0, 118.89),
        ),
        clean("street_hdl32e_dual.pcap.gz", hdl32e(ReturnMode::Dual, 2.5)),
        Fixture {
            file: "street_vlp16_losses.pcap",
            config: puck(ReturnMode::Strongest, 4.0, 118.98),
            faults: losses,
        },
        clean("street_hdl64e_s2.pcap.gz", hdl64e_s2(1.25, 48.939)),
        clean(
            "street_hdl64e_s3.pcap.gz",
            hdl64e_s3(ReturnMode::Strongest, 48.958).seconds(1.25, None),
        ),
        clean(
            "street_hdl64e_s3_dual.pcap.gz",
            hdl64e_s3(ReturnMode::Dual, 235.59).seconds(0.25, None),
        ),
        clean(
            "street_hdl64e_s3_switch.pcap.gz",
            hdl64e_s3(ReturnMode::Strongest, 152.646).seconds(0.4, Some(0.2)),
        ),
        clean(
            "street_vlp32c.pcap.gz",
            in_the_old_town(
                EmitterConfig::new(Model::Vlp32c, ReturnMode::Strongest).turns(3.8),
                119.002,
                10,
            ),
        ),
        clean(
            "street_vls128_dual.pcap.gz",
            in_the_old_town(
                EmitterConfig::new(Model::Vls128, ReturnMode::Dual).turns(2.8),
                119.024,
                120,
            ),
        ),
    ]
}
