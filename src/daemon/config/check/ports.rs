//! Sensors among each other: told apart on the ports that they share, and at one about these.

use super::Check;
use crate::daemon::config::SensorConfig;
use crate::daemon::config::error::Problem;
use crate::daemon::config::file::Written;
use crate::daemon::config::key::Key;
use crate::daemon::config::keys::SENSOR;

/// Keys of a port: of its socket and its thread.
const OF_THE_PORT: [&str; 5] = ["bind", "multicast", "interface", "cpu", "realtime_priority"];

type Sensors<'a, 't> = &'a mut [Written<'t, SensorConfig>];

impl Check<'_> {
    /// Sensors on one port share its socket and its thread: what one of them says of these holds
    /// for all, and no two may say different things.
    pub(super) fn ports(&mut self, sensors: Sensors<'_, '_>) {
        self.sources_differ(sensors);
        for key in SENSOR.keys {
            if OF_THE_PORT.contains(&key.name) {
                self.agree(sensors, key);
            }
        }
    }

    fn sources_differ(&mut self, sensors: Sensors<'_, '_>) {
        for (number, sensor) in sensors.iter().enumerate() {
            let config = &sensor.config;
            let is_same = |other: &&Written<'_, SensorConfig>| {
                let ports = (config.source_port, other.config.source_port);
                other.config.port.port == config.port.port
                    && other.config.address == config.address
                    && (ports.0 == ports.1 || ports.0.is_none() || ports.1.is_none())
            };
            if let Some(other) = sensors[..number].iter().find(is_same) {
                let name = &other.config.name;
                let port = config.port.port;
                let title = format!(
                    "`{}` cannot be told from `{name}`: the same address and port {port}",
                    config.name
                );
                let problem = Problem::new(sensor.place("address"), title, "expected another address")
                    .with_other(other.place("address"), format!("the address of `{name}`"))
                    .with_cure("give each sensor a destination port of its own, or name their source ports, IP:PORT");
                self.problems.push(problem);
            }
        }
    }

    fn agree(&mut self, sensors: Sensors<'_, '_>, key: &Key<SensorConfig>) {
        for number in 0..sensors.len() {
            let port = sensors[number].config.port.port;
            let says = |other: &Written<'_, SensorConfig>| {
                other.config.port.port == port && other.given("", key.name).is_some()
            };
            let Some(first) = sensors.iter().position(says) else {
                continue;
            };
            let Ok([sensor, first]) = sensors.get_disjoint_mut([number, first]) else {
                continue;
            };
            let says_nothing = sensor.given("", key.name).is_none();
            for rule in key.rules {
                if says_nothing {
                    (rule.take)(&mut sensor.config, &first.config);
                } else if !(rule.is_same)(&sensor.config, &first.config) {
                    let title = format!("sensors on port {port} do not agree about `{}`", key.name);
                    let problem = Problem::new(
                        sensor.place(key.name),
                        title,
                        "a port has one socket and one thread: leave this out",
                    );
                    let who = format!("`{}` says this", first.config.name);
                    self.problems
                        .push(problem.with_other(first.place(key.name), who));
                }
            }
        }
    }
}
