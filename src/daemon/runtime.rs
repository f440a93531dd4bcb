//! The ports of a configuration opened, and their threads.

use std::any::Any;
use std::collections::HashMap;
use std::net::{IpAddr, Shutdown, SocketAddr, SocketAddrV4};
use std::os::unix::net::UnixStream;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{self, Receiver, Sender, SyncSender};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use tracing::{info, warn};

use super::config::{Config, PortConfig, SensorConfig};
use super::counters::{PortCounters, SensorCounters};
use super::notify::beat;
use super::plan::{self, PortName, PortPlan};
use super::port::{End, MAILS, Mailbox, Newest, Port, Room, Served};
use super::record::{PortLink, Recordings};
use super::sensor::{Event, Identity, Sensor};
use super::sharing::{Sharing, SharingError, SharingStatus};
use super::sys;
use crate::capture::udp::ReceiveBuffer;
use crate::capture::{UdpError, UdpSource};
use sweepd_core::pipeline;
use sweepd_core::segment::ConfigError;
use sweepd_core::sweep::Buffers;
use sweepd_core::wire::Packet;

/// How long the threads have to end; those that hang end with the process. They take some
/// milliseconds, and on a machine that is overloaded as long as they wait for a core.
const PATIENCE: Duration = Duration::from_secs(1);

/// Why the daemon cannot run, or cannot go on.
#[derive(Debug, thiserror::Error)]
pub enum DaemonError {
    /// A port cannot be listened on.
    #[error(transparent)]
    Udp(#[from] UdpError),
    /// A sensor cannot be shared.
    #[error("{sensor}: {source}")]
    Sharing {
        /// Its name.
        sensor: String,
        /// Why not.
        source: SharingError,
    },
    /// No sweep of a sensor can be segmented like that.
    #[error("{sensor}: {source}")]
    Segmenting {
        /// Its name.
        sensor: String,
        /// Why not.
        source: ConfigError,
    },
    /// The address for health and metrics cannot be had.
    #[error(
        "cannot serve health and metrics on http://{address}: {source}; if no other daemon runs already, choose another \
         address with `http` in the configuration, or \"off\""
    )]
    Http {
        /// The address.
        address: SocketAddr,
        /// What the system says.
        source: std::io::Error,
    },
    /// The system refuses what it never should.
    #[error("cannot {what}: {source}")]
    System {
        /// What was tried.
        what: &'static str,
        /// What the system says.
        source: std::io::Error,
    },
    /// A thread ended that must not.
    #[error("the thread of port {port} has ended: {why}")]
    Ended {
        /// The port.
        port: String,
        /// A panic's message, or what the socket says.
        why: String,
    },
    /// A thread does not end.
    #[error("the thread of port {port} hangs and is left to its end")]
    Hangs {
        /// The port.
        port: String,
    },
}

impl DaemonError {
    /// Whether time may mend it: an address or an interface that the network has not set up yet, as
    /// at boot. (A port that is taken is not among them: somebody who starts a second daemon is to
    /// know.)
    pub fn may_pass(&self) -> bool {
        match self {
            Self::Udp(UdpError::NoSuchAddress { .. }) => true,
            Self::Udp(UdpError::Interface { source, .. } | UdpError::Join { source, .. }) => {
                source.raw_os_error().is_some_and(|code| {
                    [libc::ENODEV, libc::ENXIO, libc::EADDRNOTAVAIL].contains(&code)
                })
            }
            _ => false,
        }
    }
}

/// What is known of a sensor, for other threads.
pub struct SensorStatus {
    /// Its name and that of its service.
    pub name: String,
    /// Where its packets come from.
    pub address: IpAddr,
    /// The port that its data come to.
    pub port: u16,
    /// Its place among [`Runtime::ports`].
    pub port_index: usize,
    /// The port that its position packets come to.
    pub position_port: u16,
    /// What became of its packets and sweeps.
    pub counters: Arc<SensorCounters>,
    /// How it is shared.
    pub sharing: Arc<dyn SharingStatus>,
}

/// What is known of a port, for other threads.
pub struct PortStatus {
    /// Its name in output.
    pub name: String,
    /// Where it listens.
    pub local: SocketAddrV4,
    /// The interface that it listens on alone.
    pub interface: Option<String>,
    /// Names of the sensors whose position packets it may hear and that share an address.
    pub sharing_an_address: Vec<String>,
    /// What the kernel gave to hold waiting packets.
    pub buffer: ReceiveBuffer,
    /// What came.
    pub counters: Arc<PortCounters>,
}

/// The threads of all ports, at work.
pub struct Runtime {
    /// The sensors, in the order of the configuration.
    pub sensors: Arc<[SensorStatus]>,
    /// The ports.
    pub ports: Arc<[PortStatus]>,
    /// What happens to sensors, by their places.
    pub events: Receiver<(usize, Event)>,
    /// Ways to give sensors another configuration.
    orders: Vec<Sender<pipeline::Config>>,
    over: Arc<AtomicBool>,
    /// Shut down when they are to end, for those that wait on a socket.
    bell: UnixStream,
    threads: Vec<(String, JoinHandle<Result<(), UdpError>>)>,
}

impl Runtime {
    /// Opens everything, begins the recording, then starts the threads: when this returns, all
    /// sockets are bound, all sensors have their way out, and every thread has made its first
    /// round.
    ///
    /// # Errors
    /// [`DaemonError`]; then nothing is left running.
    pub fn start<S: Sharing>(
        config: &Config,
        sharing: &S,
        recordings: &mut Recordings,
    ) -> Result<Self, DaemonError> {
        // Ports first: who holds them already is told before anything is reserved.
        let mut sockets = Vec::new();
        for plan in plan::ports(config) {
            sockets.push((UdpSource::bind(&plan.udp())?, plan));
        }
        let (told, events) = mpsc::channel();
        let mut hall = Hall {
            statuses: Vec::new(),
            mailboxes: Vec::new(),
            orders: Vec::new(),
        };
        let mut ready = HashMap::new();
        for (index, sensor) in config.sensors.iter().enumerate() {
            let bound = |plan: &PortPlan| plan.sensors.contains(&index);
            let port_index = sockets
                .iter()
                .position(|(_, plan)| bound(plan))
                .unwrap_or(0);
            let port = sockets
                .get(port_index)
                .map_or(0, |(source, _)| source.local_addr().port());
            ready.insert(
                index,
                hall.enter(index, sensor, (port_index, port), sharing, &told)?,
            );
        }
        // Now that it may run: a daemon that cannot, again and again, begins no files.
        recordings.start(config.record.as_ref());
        let over = Arc::new(AtomicBool::new(false));
        let failed = |source| DaemonError::System {
            what: "make a pair of sockets",
            source,
        };
        let (bell, rung) = UnixStream::pair().map_err(failed)?;
        let sensors = hall.statuses.into();
        let (ports, threads) = (Arc::new([]), Vec::new());
        let mut runtime = Self {
            sensors,
            ports,
            events,
            orders: hall.orders,
            over,
            bell,
            threads,
        };
        let mut links = Vec::new();
        let (mut statuses, beat) = (Vec::new(), beat(sd_notify::watchdog_enabled()));
        for (source, plan) in sockets {
            let status = PortStatus::new(&source, config, &plan);
            let served = plan
                .sensors
                .iter()
                .filter_map(|index| ready.remove(index))
                .collect();
            let others = others(config, &plan, &hall.mailboxes);
            let admission = plan.admission(config);
            let counters = Arc::clone(&status.counters);
            let end = End {
                over: Arc::clone(&runtime.over),
                bell: rung.try_clone().map_err(failed)?,
            };
            let (order, changes) = mpsc::channel();
            links.push(PortLink {
                sensors: plan
                    .sensors
                    .iter()
                    .copied()
                    .chain(plan.others(config))
                    .collect(),
                counters: Arc::clone(&counters),
                changes: order,
            });
            let room = Room {
                admission,
                sensors: served,
                others,
                recordings: Vec::new(),
                counters,
            };
            let port = Port::new(source, room, changes, end, beat);
            // On an early return, dropping the runtime ends those that run already.
            runtime.threads.push((
                status.name.clone(),
                spawn(port, &status.name, &plan.config)?,
            ));
            statuses.push(status);
        }
        runtime.ports = statuses.into();
        let names = config.sensors.iter().map(|sensor| sensor.name.clone());
        recordings.connect(names.collect(), links);
        runtime.await_first_round()?;
        Ok(runtime)
    }

    /// Gives a sensor another configuration; whether it could be used is told by an event.
    pub fn reconfigure(&self, sensor: usize, config: pipeline::Config) {
        // A thread that has ended is found by `check`.
        let _ = self.orders[sensor].send(config);
    }

    /// Looks after the threads.
    ///
    /// # Errors
    /// [`DaemonError::Ended`]: one has ended, and the daemon must not go on without it.
    pub fn check(&mut self) -> Result<(), DaemonError> {
        match self
            .threads
            .iter()
            .position(|(_, thread)| thread.is_finished())
        {
            Some(index) => {
                let (port, thread) = self.threads.swap_remove(index);
                Err(DaemonError::Ended {
                    port,
                    why: ended(thread),
                })
            }
            None => Ok(()),
        }
    }

    /// Ends the threads.
    ///
    /// # Errors
    /// [`DaemonError::Hangs`]: one does not end in time. [`DaemonError::Ended`]: one had come to
    /// another end before.
    pub fn stop(mut self) -> Result<(), DaemonError> {
        self.end();
        let begun = Instant::now();
        for (port, thread) in std::mem::take(&mut self.threads) {
            while !thread.is_finished() {
                if begun.elapsed() > PATIENCE {
                    return Err(DaemonError::Hangs { port });
                }
                thread::sleep(Duration::from_millis(1));
            }
            if !matches!(thread.join(), Ok(Ok(()))) {
                return Err(DaemonError::Ended {
                    port,
                    why: "it had failed before".to_owned(),
                });
            }
        }
        Ok(())
    }

    /// Tells all threads to end, and wakes those that sleep.
    fn end(&self) {
        self.over.store(true, Ordering::Relaxed);
        // Once more does no harm.
        let _ = self.bell.shutdown(Shutdown::Both);
        self.wake();
    }

    /// Ends the naps of all threads.
    fn wake(&self) {
        self.threads
            .iter()
            .for_each(|(_, thread)| thread.thread().unpark());
    }

    fn await_first_round(&mut self) -> Result<(), DaemonError> {
        while self
            .ports
            .iter()
            .any(|port| port.counters.heartbeat.get() == 0)
        {
            self.check()?;
            thread::sleep(Duration::from_millis(1));
        }
        Ok(())
    }
}

impl Drop for Runtime {
    fn drop(&mut self) {
        self.end();
    }
}

/// The sensors on their way to the threads of their ports.
struct Hall {
    statuses: Vec<SensorStatus>,
    mailboxes: Vec<(SyncSender<Packet<'static>>, Arc<SensorCounters>)>,
    orders: Vec<Sender<pipeline::Config>>,
}

impl Hall {
    fn enter<S: Sharing>(
        &mut self,
        index: usize,
        sensor: &SensorConfig,
        (port_index, port): (usize, u16),
        sharing: &S,
        events: &Sender<(usize, Event)>,
    ) -> Result<Served<S::Buffers>, DaemonError> {
        let name = || sensor.name.clone();
        let way = sharing.open(sensor);
        let way = way.map_err(|source| DaemonError::Sharing {
            sensor: name(),
            source,
        })?;
        let counters = Arc::new(SensorCounters::default());
        let address = sensor.address.to_canonical();
        let identity = Identity {
            index,
            name: name(),
            address: address.to_string(),
            counters: Arc::clone(&counters),
            events: events.clone(),
        };
        let at_work = Sensor::new(identity, sensor.pipeline.clone(), way.buffers);
        let at_work = at_work.map_err(|source| DaemonError::Segmenting {
            sensor: name(),
            source,
        })?;
        let (sender, mail) = mpsc::sync_channel(MAILS);
        let (order, orders) = mpsc::channel();
        self.mailboxes.push((sender, Arc::clone(&counters)));
        self.orders.push(order);
        let (position_port, sharing) = (sensor.position_port, way.status);
        self.statuses.push(SensorStatus {
            name: name(),
            address,
            port,
            port_index,
            position_port,
            counters,
            sharing,
        });
        Ok(Served {
            sensor: at_work,
            mail,
            orders,
            newest: Newest::default(),
        })
    }
}

impl PortStatus {
    fn new(source: &UdpSource, config: &Config, plan: &PortPlan) -> Self {
        let (local, buffer) = (source.local_addr(), source.buffer());
        let name = PortName(&plan.config, local.port()).to_string();
        if let Some(warning) = buffer.warning(local.port()) {
            warn!("{warning}");
        }
        info!("listening on port {name}");
        let sharing_an_address = plan
            .sharing_an_address(config)
            .map(|sensor| sensor.name.clone())
            .collect();
        let interface = plan.config.interface.clone();
        Self {
            name,
            local,
            interface,
            sharing_an_address,
            buffer,
            counters: Arc::default(),
        }
    }
}

/// Mailboxes of the sensors that a port hears and does not serve.
fn others(
    config: &Config,
    plan: &PortPlan,
    mailboxes: &[(SyncSender<Packet<'static>>, Arc<SensorCounters>)],
) -> Vec<Mailbox> {
    let mailbox = |index: usize| {
        let (sender, counters) = mailboxes[index].clone();
        Mailbox { sender, counters }
    };
    plan.others(config).map(mailbox).collect()
}

fn spawn<B>(
    port: Port<B>,
    name: &str,
    config: &PortConfig,
) -> Result<JoinHandle<Result<(), UdpError>>, DaemonError>
where
    B: Buffers<Buffer: super::sharing::Outgoing> + Send + 'static,
{
    let (cpu, priority, name) = (config.cpu, config.realtime_priority, name.to_owned());
    let number = port.number();
    // What the system shows of a thread is 15 bytes long.
    let thread = thread::Builder::new()
        .name(format!("port {number}"))
        .spawn(move || {
            settle(&name, cpu, priority);
            port.serve()
        });
    thread.map_err(|source| DaemonError::System {
        what: "start a thread",
        source,
    })
}

/// Gives the thread its core and its priority, as far as the system lets it.
fn settle(port: &str, cpu: Option<usize>, priority: Option<u8>) {
    if let Some(core) = cpu
        && let Err(error) = sys::pin_to_core(core)
    {
        let cores = thread::available_parallelism().map_or(1, usize::from);
        warn!(
            "port {port}: not pinned to core {core}: {error}; this process may use {cores} cores, counted from 0"
        );
    }
    if let Some(priority) = priority
        && let Err(error) = sys::set_realtime_priority(priority)
    {
        warn!(
            "port {port}: no real-time priority {priority}: {error}; allow it with LimitRTPRIO={priority} in the unit, \
             or by CAP_SYS_NICE"
        );
    }
}

/// Why a thread has ended.
fn ended(thread: JoinHandle<Result<(), UdpError>>) -> String {
    match thread.join() {
        Ok(Ok(())) => "nobody asked it to".to_owned(),
        Ok(Err(error)) => error.to_string(),
        Err(panic) => panic_message(&*panic).to_owned(),
    }
}

fn panic_message(panic: &(dyn Any + Send)) -> &str {
    let text = panic.downcast_ref::<&str>().copied();
    text.or_else(|| panic.downcast_ref::<String>().map(String::as_str))
        .unwrap_or("a panic without a message")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_thread_that_waits_for_a_core_is_waited_for_and_has_ended_well() {
        let slow = thread::spawn(|| {
            thread::sleep(Duration::from_millis(400));
            Ok(())
        });
        let (threads, over) = (vec![("127.0.0.1:2368".to_owned(), slow)], Arc::default());
        let bell = UnixStream::pair().unwrap().0;
        let (sensors, ports, events) = (Arc::new([]), Arc::new([]), mpsc::channel().1);
        let runtime = Runtime {
            sensors,
            ports,
            events,
            orders: Vec::new(),
            over,
            bell,
            threads,
        };
        runtime.stop().unwrap();
    }
}
