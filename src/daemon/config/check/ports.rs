//! Sensors among each other: told apart on the ports that they share, and at one about these.

use std::fmt::Debug;
use std::ops::Range;

use toml::Spanned;

use super::{Check, Checked};
use crate::daemon::config::error::Problem;
use crate::daemon::config::{PortConfig, file};

/// Where a setting stands, if it does.
type SpanOf = fn(&file::Sensor) -> Option<Range<usize>>;

fn place<T>(given: &Option<Spanned<T>>) -> Option<Range<usize>> {
    given.as_ref().map(Spanned::span)
}

impl Check<'_> {
    /// Sensors on one port share its socket and its thread: what one of them says of these holds
    /// for all, and no two may say different things.
    pub(super) fn ports(&mut self, sensors: &mut [Checked<'_>]) {
        self.sources_differ(sensors);
        self.agree(
            sensors,
            "bind",
            |sensor| place(&sensor.bind),
            |port| &mut port.bind,
        );
        self.agree(
            sensors,
            "multicast",
            |sensor| place(&sensor.multicast),
            |port| &mut port.multicast,
        );
        self.agree(
            sensors,
            "interface",
            |sensor| place(&sensor.interface),
            |port| &mut port.interface,
        );
        self.agree(
            sensors,
            "cpu",
            |sensor| place(&sensor.cpu),
            |port| &mut port.cpu,
        );
        let priority: SpanOf = |sensor| place(&sensor.realtime_priority);
        self.agree(sensors, "realtime_priority", priority, |port| {
            &mut port.realtime_priority
        });
    }

    fn sources_differ(&mut self, sensors: &[Checked<'_>]) {
        for (number, Checked { written, config }) in sensors.iter().enumerate() {
            let is_same = |other: &&Checked<'_>| {
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
                let problem = Problem::new(written.address.span(), title, "expected another address")
                    .with_other(other.written.address.span(), format!("the address of `{name}`"))
                    .with_cure("give each sensor a destination port of its own, or name their source ports, IP:PORT");
                self.problems.push(problem);
            }
        }
    }

    fn agree<T: PartialEq + Clone + Debug>(
        &mut self,
        sensors: &mut [Checked<'_>],
        key: &str,
        place: SpanOf,
        setting: fn(&mut PortConfig) -> &mut T,
    ) {
        for number in 0..sensors.len() {
            let port = sensors[number].config.port.port;
            let says = |other: &Checked<'_>| {
                other.config.port.port == port && place(other.written).is_some()
            };
            let Some(first) = sensors.iter().position(says) else {
                continue;
            };
            let held = setting(&mut sensors[first].config.port).clone();
            let own = place(sensors[number].written);
            let Checked { config, .. } = &mut sensors[number];
            let value = setting(&mut config.port);
            match own {
                Some(at) if *value != held => {
                    let title = format!("sensors on port {port} do not agree about `{key}`");
                    let first = &sensors[first];
                    let problem = Problem::new(
                        at,
                        title,
                        "a port has one socket and one thread: leave this out",
                    )
                    .with_other(
                        place(first.written).unwrap_or(0..0),
                        format!("`{}` says this", first.config.name),
                    );
                    self.problems.push(problem);
                }
                _ => *value = held,
            }
        }
    }
}
