//! Finds faults of a sensor, its network and this host, with cures.
//!
//! ```text
//! plan      what should be there: ports and sensors, from a configuration or from options
//! listen    what comes: a few seconds of every port, through the same admission and pipelines as the daemon's
//! host      this host: interfaces, buffers, shared memory, permissions
//! web       what sensors say of their own settings, read only
//! health    what a daemon says that holds a port
//!               all of it Observations
//! diagnose  Observations -> findings, worst first; pure
//! obstacle  whether a box of known size and place is an obstacle
//! ```

pub mod diagnose;
pub mod health;
pub mod host;
pub mod listen;
pub mod observe;
pub mod obstacle;
pub mod plan;
pub mod web;

use std::io;
use std::net::Ipv4Addr;
use std::time::Duration;

use crate::input::UdpError;
use crate::network::Drops;
use observe::PortResult;

pub use crate::judge::{Finding, Severity, Topic};
pub use diagnose::diagnose;
pub use observe::Observations;
pub use plan::Plan;
use plan::ipv4;

/// Most web pages that are requested.
const MAX_ASKED: usize = 16;
/// Factory address of a sensor.
const FACTORY: Ipv4Addr = Ipv4Addr::new(192, 168, 1, 201);

/// Why nothing can be found out.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ExamineError {
    /// An open port fails.
    #[error(transparent)]
    Udp(#[from] UdpError),
    /// A system call failed that should not.
    #[error("cannot ask web pages: {0}")]
    System(#[from] io::Error),
}

/// Listens for a time, examines this host, and requests the sensors' web pages at a port, unless it
/// is `None`. `opened` is called with the open ports.
///
/// # Errors
/// [`ExamineError`]; faults of sensors, network and host are observations, not errors.
pub fn examine(
    plan: Plan,
    lasting: Duration,
    web_port: Option<u16>,
    opened: impl FnOnce(&[u16]),
) -> Result<Observations, ExamineError> {
    let before = Drops::read();
    let received = listen::listen(&plan, lasting, opened)?;
    let after = Drops::read();
    let is_taken = (received.ports.iter()).any(|port| matches!(port.result, PortResult::Taken(_)));
    let daemon = match plan.health {
        Some(address) if is_taken => Some(health::ask(address)),
        None if is_taken => Some(Err("its configuration has no `http`".to_owned())),
        // A daemon may have other ports than the usual ones. Without a daemon, silence is the
        // finding.
        Some(address) if plan.is_usual() && received.is_empty() => {
            health::ask(address).ok().map(Ok)
        }
        _ => None,
    };
    let mut host = host::look(plan.root.as_deref());
    host.drops = before
        .zip(after)
        .map(|(before, after)| after.since(&before));
    let mut seen = Observations {
        plan,
        seconds: lasting.as_secs_f64(),
        ports: received.ports,
        sensors: received.sensors,
        positions: received.positions,
        host,
        web: Vec::new(),
        daemon,
    };
    if let Some(port) = web_port {
        seen.web = web::ask(&addresses_to_ask(&seen), port)?;
    }
    Ok(seen)
}

/// Addresses that may have a web page: senders of packets, named sensors, or the factory address;
/// not those of an HDL-64E.
fn addresses_to_ask(seen: &Observations) -> Vec<Ipv4Addr> {
    let senders = (seen.sensors.iter())
        .filter(|sensor| !sensor.model.is_some_and(|model| model.is_hdl64e()))
        .map(|sensor| sensor.source.ip());
    let position_senders = seen.positions.iter().map(|sender| sender.address);
    let mut addresses = seen.plan.ask.clone();
    addresses.extend(ipv4(senders.chain(position_senders)));
    addresses.sort_unstable();
    addresses.dedup();
    addresses.truncate(MAX_ASKED);
    let reaches_factory = seen.host.interfaces.iter().any(|one| one.reaches(FACTORY));
    if addresses.is_empty() && seen.daemon.is_none() && reaches_factory {
        addresses.push(FACTORY);
    }
    addresses
}
