//! Why no packets come from a sensor, as far as this host knows: who sends in its place, what the
//! kernel drops, and which interface has no carrier.

use std::net::IpAddr;
use std::time::Duration;

use super::runtime::{Runtime, SensorStatus};
use super::state::{PATIENCE, Watcher};
use crate::network::{Drops, Interface, interfaces, wiring};
use crate::strangers::{Cause, Sought, Stranger};
use sweepd_client::host::realtime_ns;

/// The shortest time over which drops are counted.
const SPAN: Duration = Duration::from_secs(1);

/// What this host's network was, as last looked at, while a sensor is silent.
#[derive(Debug, Default)]
pub struct Silence {
    /// The drops so far, and when they were read.
    earlier: Option<(Duration, Drops)>,
    /// The newest ones, and within how many seconds.
    recent: Option<(f64, Drops)>,
    interfaces: Vec<Interface>,
}

impl Silence {
    /// Tells the watchers of silent sensors why nothing comes. Reads nothing while all send.
    pub fn look(&mut self, now: Duration, runtime: &Runtime, watchers: &mut [Watcher]) {
        // Earlier than it is told, so that it is known by then.
        if watchers.iter().all(|one| one.quiet_for(now) < PATIENCE / 2) {
            *self = Self::default();
            return;
        }
        self.look_at_network(now);
        let now_ns = realtime_ns();
        let mut strangers = Vec::new();
        for port in runtime.ports.iter() {
            let of_port = port.counters.strangers(now_ns).into_iter();
            strangers.extend(of_port.map(|one| (port.local.port(), one)));
        }
        let known: Vec<IpAddr> = runtime.sensors.iter().map(|one| one.address).collect();
        for (watcher, sensor) in watchers.iter_mut().zip(runtime.sensors.iter()) {
            let is_silent = watcher.quiet_for(now) >= PATIENCE;
            let cause = is_silent
                .then(|| self.cause(sensor, &strangers, &known, runtime))
                .flatten();
            watcher.explain_silence(cause);
        }
    }

    fn look_at_network(&mut self, now: Duration) {
        if self.earlier.is_some_and(|(at, _)| now - at < SPAN) {
            return;
        }
        self.interfaces = interfaces();
        let Some(counted) = Drops::read() else {
            return;
        };
        if let Some((at, earlier)) = self.earlier {
            self.recent = Some(((now - at).as_secs_f64(), counted.since(&earlier)));
        }
        self.earlier = Some((now, counted));
    }

    /// The likeliest cause.
    fn cause(
        &self,
        sensor: &SensorStatus,
        strangers: &[(u16, Stranger)],
        known: &[IpAddr],
        runtime: &Runtime,
    ) -> Option<Cause> {
        let sought = Sought {
            address: sensor.address,
            port: sensor.port,
        };
        if let Some(cause) = sought.instead(strangers, known) {
            return Some(cause);
        }
        let address = match sensor.address {
            IpAddr::V4(address) if !address.is_loopback() => address,
            _ => return None,
        };
        let alone = runtime.ports[sensor.port_index].interface.as_deref();
        let wire = wiring(&self.interfaces, Some(address), alone)
            .into_iter()
            .next();
        // What the kernel drops may be another's; an interface that the packets must take is not.
        let is_certain = alone.is_some() || self.interfaces.iter().any(|one| one.reaches(address));
        let dropped = (self.recent)
            .filter(|_| wire.is_none() || !is_certain)
            .and_then(|(seconds, drops)| drops.cause(seconds, Some(address)));
        dropped.or(wire)
    }
}
