//! A scene as the packets of a sensor.

use std::f64::consts::TAU;
use std::time::Duration;
use sweepd_core::sensor::ModelExt;

use fastrand::Rng;
use sweepd_core::sensor::Beam;
use sweepd_core::wire::data::{DataPacket, ReturnMode, TURN_CDEG};

use super::sensor::RATE_RAD_S;
use super::{Scene, Sensor};

/// Reflectivity of everything.
const REFLECTIVITY: u8 = 50;

/// The packets that a VLP-16 or an HDL-32E sends while it turns, without end: each with the time of
/// its first shot after the beginning. Their bytes are those of the sensors' manuals.
pub struct Spin<'a> {
    sensor: &'a Sensor,
    scene: &'a Scene,
    /// By channel.
    beams: Vec<Beam>,
    rng: Rng,
    time_ns: u64,
}

impl<'a> Spin<'a> {
    /// From straight ahead on.
    ///
    /// # Panics
    /// If the sensor sends a firing in several blocks, or its beams point aside.
    pub fn new(sensor: &'a Sensor, scene: &'a Scene) -> Self {
        let spec = sensor.model.spec();
        assert!(!spec.shifted && spec.banks() == 1, "{}", spec.model.name());
        let mut beams = sensor.beams().to_vec();
        beams.sort_by_key(|beam| beam.channel);
        Self {
            sensor,
            scene,
            beams,
            rng: Rng::with_seed(sensor.seed),
            time_ns: 0,
        }
    }

    /// What it meets from the next packet on.
    pub fn look_at(&mut self, scene: &'a Scene) {
        self.scene = scene;
    }
}

impl Iterator for Spin<'_> {
    type Item = (Duration, DataPacket);

    fn next(&mut self) -> Option<Self::Item> {
        let (spec, mode) = (self.sensor.model.spec(), ReturnMode::Strongest);
        let pose = self.sensor.pose();
        let start_ns = self.time_ns;
        let turned_rad = |time_ns: u64| time_ns as f64 * 1e-9 * RATE_RAD_S % TAU;
        let mut packet = DataPacket::new(
            (start_ns / 1000) as u32,
            mode.byte(),
            spec.product.unwrap_or_default(),
        );
        for block in &mut packet.blocks {
            let cdeg = (turned_rad(self.time_ns).to_degrees() * 100.0).round() as u16;
            block.set_azimuth_cdeg(cdeg % TURN_CDEG);
            for records in block.records.chunks_exact_mut(spec.channels) {
                for (record, beam) in records.iter_mut().zip(&self.beams) {
                    let shot_ns =
                        self.time_ns + u64::from(spec.channel_offset_ns(beam.channel, mode));
                    let azimuth_rad = turned_rad(shot_ns);
                    let shot =
                        self.sensor
                            .shoot(self.scene, &pose, beam, azimuth_rad, &mut self.rng);
                    let units = shot.map_or(0.0, |(range_m, ..)| range_m / spec.distance_unit_m);
                    record.distance.set(units.round() as u16);
                    record.reflectivity = REFLECTIVITY;
                }
                self.time_ns += u64::from(spec.firing_period_ns(mode));
            }
        }
        Some((Duration::from_nanos(start_ns), packet))
    }
}
