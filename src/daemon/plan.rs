//! Plans the ports and the sensors of each, before anything is opened.

use std::fmt;

use super::config::{Config, PortConfig, SensorConfig};
use crate::admission::{ConfiguredSensor, ConfiguredSensors, Likelihood};
use crate::input::udp::{UdpConfig, ample_buffer_bytes};
use sweepd_core::sensor::Model;

/// A port to open, and the thread that serves it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PortPlan {
    /// Where it listens, and the core and priority of its thread.
    pub config: PortConfig,
    /// The sensors whose data come through it, as indices of [`Config::sensors`]; none if it only
    /// takes position packets.
    pub sensors: Vec<usize>,
    /// The sensors that are configured to send their position packets to it.
    pub positions: Vec<usize>,
}

impl PortPlan {
    /// The sensors whose data come through other ports and whose position packets this one may
    /// receive. The same address on another interface is another sensor.
    pub fn others<'a>(&'a self, config: &'a Config) -> impl Iterator<Item = usize> + 'a {
        (0..config.sensors.len()).filter(move |index| {
            config.sensors[*index].port.interface == self.config.interface
                && !self.sensors.contains(index)
        })
    }

    /// The admission of the port: its sensors, and after them [`PortPlan::others`] for position
    /// packets.
    pub fn admission(&self, config: &Config) -> ConfiguredSensors {
        let here = self.sensors.iter().map(|&index| {
            let positions_here = if self.positions.contains(&index) {
                Likelihood::Configured
            } else {
                Likelihood::BesideData
            };
            configured(&config.sensors[index], positions_here)
        });
        let others = self.others(config).map(|index| {
            let positions_here = if self.positions.contains(&index) {
                Likelihood::Configured
            } else {
                Likelihood::Unexpected
            };
            configured(&config.sensors[index], positions_here)
        });
        ConfiguredSensors::new(here.collect(), others.collect())
    }

    /// The sensors whose position packets this port may receive and that share their address with
    /// another of these.
    pub fn sharing_an_address<'a>(
        &'a self,
        config: &'a Config,
    ) -> impl Iterator<Item = &'a SensorConfig> {
        self.heard(config).filter(move |one| {
            let at_its_address = self.heard(config).filter(|two| two.address == one.address);
            at_its_address.count() > 1
        })
    }

    /// The sensors whose data or position packets may come through it.
    fn heard<'a>(&'a self, config: &'a Config) -> impl Iterator<Item = &'a SensorConfig> {
        let indexes = self.sensors.iter().copied().chain(self.others(config));
        indexes.map(|index| &config.sensors[index])
    }

    /// Settings of the socket.
    pub fn udp(&self) -> UdpConfig {
        let PortConfig {
            bind: address,
            port,
            multicast,
            ..
        } = self.config;
        let interface = self.config.interface.clone();
        UdpConfig {
            address,
            port,
            multicast,
            interface,
            buffer_bytes: ample_buffer_bytes(),
        }
    }
}

/// The name of a port in output: `2368`, or `10.0.0.5:2368%eth1` if it does not listen on all
/// addresses and interfaces.
pub struct PortName<'a>(pub &'a PortConfig, pub u16);

impl fmt::Display for PortName<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if !self.0.bind.is_unspecified() {
            write!(f, "{}:", self.0.bind)?;
        }
        write!(f, "{}", self.1)?;
        self.0
            .interface
            .as_ref()
            .map_or(Ok(()), |interface| write!(f, "%{interface}"))
    }
}

/// The ports of all sensors: first those for data, then those for position packets alone. Sensors
/// with the same address, port, group and interface share a port; a position port that is also a
/// data port is the same port.
pub fn ports(config: &Config) -> Vec<PortPlan> {
    let mut plans: Vec<PortPlan> = Vec::new();
    for (index, sensor) in config.sensors.iter().enumerate() {
        let plan = find_or_open(&mut plans, &sensor.port);
        plan.sensors.push(index);
        plan.config.cpu = plan.config.cpu.or(sensor.port.cpu);
        plan.config.realtime_priority = plan
            .config
            .realtime_priority
            .max(sensor.port.realtime_priority);
    }
    for (index, sensor) in config
        .sensors
        .iter()
        .enumerate()
        .filter(|(_, sensor)| sends_positions(sensor))
    {
        // Its few packets are not urgent.
        let cpu = None;
        let realtime_priority = None;
        let port = PortConfig {
            port: sensor.position_port,
            cpu,
            realtime_priority,
            ..sensor.port.clone()
        };
        find_or_open(&mut plans, &port).positions.push(index);
    }
    plans
}

fn find_or_open<'a>(plans: &'a mut Vec<PortPlan>, port: &PortConfig) -> &'a mut PortPlan {
    let index = plans
        .iter()
        .position(|plan| is_one_socket(&plan.config, port))
        .unwrap_or_else(|| {
            plans.push(PortPlan {
                config: port.clone(),
                sensors: Vec::new(),
                positions: Vec::new(),
            });
            plans.len() - 1
        });
    &mut plans[index]
}

fn is_one_socket(one: &PortConfig, other: &PortConfig) -> bool {
    one.bind == other.bind
        && one.port == other.port
        && one.multicast == other.multicast
        && one.interface == other.interface
}

fn configured(sensor: &SensorConfig, positions_here: Likelihood) -> ConfiguredSensor {
    ConfiguredSensor {
        ip: sensor.address.to_canonical(),
        source_port: sensor.source_port,
        sends_positions: sends_positions(sensor),
        positions_here,
    }
}

/// An HDL-64E sends its GPS state in its data packets.
pub fn sends_positions(sensor: &SensorConfig) -> bool {
    !sensor.pipeline.model.is_some_and(Model::is_hdl64e)
}

#[cfg(test)]
mod tests {
    use super::super::testing::{config_of, sensor};
    use super::*;

    fn planned(sensors: Vec<SensorConfig>) -> Vec<(String, Vec<usize>)> {
        let config = config_of(sensors);
        let named = |plan: PortPlan| {
            (
                PortName(&plan.config, plan.config.port).to_string(),
                plan.sensors,
            )
        };
        ports(&config).into_iter().map(named).collect()
    }

    fn at(address: &str, port: u16) -> SensorConfig {
        let mut sensor = sensor("x", address, port);
        (sensor.port.bind, sensor.position_port) = ([0, 0, 0, 0].into(), 8308);
        sensor
    }

    #[test]
    fn sensors_share_ports_and_all_share_the_position_port() {
        let sensors = vec![
            at("10.0.0.1", 2368),
            at("10.0.0.2", 2369),
            at("10.0.0.3", 2368),
        ];
        let expected = [("2368", vec![0, 2]), ("2369", vec![1]), ("8308", vec![])];
        assert_eq!(
            planned(sensors),
            expected.map(|(name, sensors)| (name.to_owned(), sensors))
        );
    }

    #[test]
    fn a_data_port_may_be_the_position_port_too() {
        let (mut one, mut other) = (at("10.0.0.1", 2368), at("10.0.0.2", 8308));
        one.position_port = 2368;
        other.pipeline.model = Some(Model::Vlp16);
        assert_eq!(
            planned(vec![one, other]),
            [("2368".to_owned(), vec![0]), ("8308".to_owned(), vec![1])]
        );
    }

    #[test]
    fn the_same_port_on_two_interfaces_is_two_ports_and_an_hdl64e_needs_no_position_port() {
        let [mut one, mut other] = [at("10.0.0.1", 2368), at("10.0.0.1", 2368)];
        one.port.interface = Some("eth1".to_owned());
        other.port.bind = [10, 0, 0, 9].into();
        (one.pipeline.model, other.pipeline.model) = (Some(Model::Hdl64eS3), Some(Model::Hdl64eS2));
        let expected = [("2368%eth1", vec![0]), ("10.0.0.9:2368", vec![1])];
        assert_eq!(
            planned(vec![one, other]),
            expected.map(|(name, sensors)| (name.to_owned(), sensors))
        );
    }

    #[test]
    fn the_most_urgent_sensor_of_a_port_says_how_it_is_served() {
        let [mut one, mut other] = [at("10.0.0.1", 2368), at("10.0.0.2", 2368)];
        (one.port.realtime_priority, other.port.realtime_priority) = (Some(10), Some(50));
        other.port.cpu = Some(1);
        let plans = ports(&config_of(vec![one, other]));
        assert_eq!(
            (plans[0].config.cpu, plans[0].config.realtime_priority),
            (Some(1), Some(50))
        );
        assert_eq!(
            (plans[1].config.cpu, plans[1].config.realtime_priority),
            (None, None)
        );
    }
}
