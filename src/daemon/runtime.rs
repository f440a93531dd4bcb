//! Opens the ports of a configuration, and runs their threads.

use std::any::Any;
use std::net::{self, IpAddr, SocketAddr, SocketAddrV4};
use std::os::unix::net::UnixStream;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{self, Receiver, Sender, SyncSender};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use tracing::{info, warn};

use super::config::{Config, PortConfig};
use super::counters::{PortCounters, SensorCounters};
use super::notify::heartbeat_period;
use super::plan::{self, PortName, PortPlan};
use super::port::{
    Newest, POSITION_QUEUE_LEN, Port, PortSensor, PortState, PositionQueue, Shutdown,
};
use super::record::{PortLink, Recordings};
use super::sensor::{Event, Identity, Sensor};
use super::sharing::{Outgoing, Sharing, SharingError, SharingStatus};
use super::sys;
use crate::input::udp::ReceiveBuffer;
use crate::input::{UdpError, UdpSource};
use sweepd_core::buffers::Buffers;
use sweepd_core::pipeline;
use sweepd_core::segment::ConfigError;
use sweepd_core::sensor::Model;
use sweepd_core::wire::Packet;

/// Time limit for the threads to end; hanging ones end with the process. They take some
/// milliseconds, on an overloaded machine as long as they wait for a core.
const PATIENCE: Duration = Duration::from_secs(1);

/// Why the daemon cannot run, or cannot go on.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
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
    /// The configuration of a sensor's segmentation is invalid.
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
    /// A system call failed that should not.
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
        /// The message of a panic, or of the socket.
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
    /// Whether the cause may pass: an address or an interface that the network has not set up yet,
    /// as at boot. (Not a port that is taken: whoever starts a second daemon must see the error.)
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

/// State of a sensor, for other threads.
pub struct SensorStatus {
    /// Its name and that of its service.
    pub name: String,
    /// Where its packets come from.
    pub address: IpAddr,
    /// The port of its data packets.
    pub port: u16,
    /// Its place among [`Runtime::ports`].
    pub port_index: usize,
    /// The port of its position packets.
    pub position_port: u16,
    /// The counts of its packets and sweeps.
    pub counters: Arc<SensorCounters>,
    /// How it is shared.
    pub sharing: Arc<dyn SharingStatus>,
}

/// State of a port, for other threads.
pub struct PortStatus {
    /// Its name in output.
    pub name: String,
    /// Where it listens.
    pub local: SocketAddrV4,
    /// The only interface that it listens on.
    pub interface: Option<String>,
    /// Names of the sensors whose position packets it may receive and that share an address.
    pub sharing_an_address: Vec<String>,
    /// The receive buffer that the kernel granted.
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
    /// Events of sensors, by index.
    pub events: Receiver<(usize, Event)>,
    /// Where sensors take another configuration.
    reconfigurations: Vec<Sender<pipeline::Config>>,
    over: Arc<AtomicBool>,
    /// Shut down when they are to end, for those that wait on a socket.
    end: UnixStream,
    threads: Vec<(String, JoinHandle<Result<(), UdpError>>)>,
}

impl Runtime {
    /// Opens everything, begins the recording, then starts the threads: when this returns, all
    /// sockets are bound, all services are open, and every thread has made its first round.
    ///
    /// # Errors
    /// [`DaemonError`]; then nothing is left running.
    pub fn start<S: Sharing>(
        config: &Config,
        sharing: &S,
        recordings: &mut Recordings,
    ) -> Result<Self, DaemonError> {
        // Ports first, so that a taken port is reported before memory is reserved.
        let mut sockets = Vec::new();
        for plan in plan::ports(config) {
            sockets.push((UdpSource::bind(&plan.udp())?, plan));
        }
        let (to_events, events) = mpsc::channel();
        let mut startup = Startup::new(config);
        for index in 0..config.sensors.len() {
            startup.open_sensor(index, &sockets, sharing, &to_events)?;
        }
        // Only now, so that a daemon that repeatedly fails to start creates no files.
        recordings.start(config.record.as_ref());
        let over = Arc::new(AtomicBool::new(false));
        let (end, ended) = UnixStream::pair().map_err(no_socket_pair)?;
        let mut ports = Vec::new();
        for (source, plan) in sockets {
            let shutdown = Shutdown {
                over: Arc::clone(&over),
                ended: ended.try_clone().map_err(no_socket_pair)?,
            };
            ports.push((startup.port(source, &plan, shutdown), plan.config));
        }
        // Before any thread runs, so that nothing is missed.
        let names = config.sensors.iter().map(|sensor| sensor.name.clone());
        recordings.connect(names.collect(), startup.links);
        let mut runtime = Self {
            sensors: startup.sensors.into(),
            ports: startup.ports.into(),
            events,
            reconfigurations: startup.reconfigurations,
            over,
            end,
            threads: Vec::new(),
        };
        for (index, (port, config)) in ports.into_iter().enumerate() {
            let name = runtime.ports[index].name.clone();
            // On an early return, dropping the runtime ends the running threads.
            let thread = spawn(port, &name, &config)?;
            runtime.threads.push((name, thread));
        }
        runtime.await_first_round()?;
        Ok(runtime)
    }

    /// Gives a sensor another configuration; an event reports whether it was valid.
    pub fn reconfigure(&self, sensor: usize, config: pipeline::Config) {
        // `check` finds a thread that has ended.
        let _ = self.reconfigurations[sensor].send(config);
    }

    /// The sensors whose data come through a port.
    pub fn sensors_of_port(&self, port_index: usize) -> impl Iterator<Item = &SensorStatus> {
        self.sensors
            .iter()
            .filter(move |sensor| sensor.port_index == port_index)
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
    /// [`DaemonError::Hangs`]: one does not end in time. [`DaemonError::Ended`]: one had failed
    /// before.
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

    /// Signals all threads to end, and wakes those that sleep.
    fn end(&self) {
        self.over.store(true, Ordering::Relaxed);
        // Once more does no harm.
        let _ = self.end.shutdown(net::Shutdown::Both);
        for (_, thread) in &self.threads {
            thread.thread().unpark();
        }
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

fn no_socket_pair(source: std::io::Error) -> DaemonError {
    DaemonError::System {
        what: "make a pair of sockets",
        source,
    }
}

/// Resources that are opened before the threads of the ports run.
struct Startup<'a, B: Buffers> {
    config: &'a Config,
    sensors: Vec<SensorStatus>,
    reconfigurations: Vec<Sender<pipeline::Config>>,
    /// The sensors, until their ports take them.
    ready: Vec<Option<PortSensor<B>>>,
    /// Queues for position packets from other ports.
    queues: Vec<SyncSender<Packet<'static>>>,
    ports: Vec<PortStatus>,
    links: Vec<PortLink>,
}

impl<'a, B: Buffers<Buffer: Outgoing>> Startup<'a, B> {
    fn new(config: &'a Config) -> Self {
        Self {
            config,
            sensors: Vec::new(),
            reconfigurations: Vec::new(),
            ready: Vec::new(),
            queues: Vec::new(),
            ports: Vec::new(),
            links: Vec::new(),
        }
    }

    /// Opens the service of a sensor, and makes the state that its port's thread needs.
    fn open_sensor<S: Sharing<Buffers = B>>(
        &mut self,
        index: usize,
        sockets: &[(UdpSource, PortPlan)],
        sharing: &S,
        events: &Sender<(usize, Event)>,
    ) -> Result<(), DaemonError> {
        let config = &self.config.sensors[index];
        let mut plans = sockets.iter();
        // Each sensor has a port: `plan::ports` makes it.
        let port_index = plans
            .position(|(_, plan)| plan.sensors.contains(&index))
            .unwrap_or(0);
        let shared = sharing
            .open(config)
            .map_err(|source| DaemonError::Sharing {
                sensor: config.name.clone(),
                source,
            })?;
        let counters = Arc::new(SensorCounters::default());
        let address = config.address.to_canonical();
        let identity = Identity {
            index,
            name: config.name.clone(),
            address: address.to_string(),
            counters: Arc::clone(&counters),
            events: events.clone(),
        };
        let sensor = Sensor::new(identity, config.pipeline.clone(), shared.buffers);
        let sensor = sensor.map_err(|source| DaemonError::Segmenting {
            sensor: config.name.clone(),
            source,
        })?;
        let sensor = sensor.with_objects(config.objects_every_ns, shared.objects);
        let (queue, positions) = mpsc::sync_channel(POSITION_QUEUE_LEN);
        let (reconfigure, reconfigurations) = mpsc::channel();
        self.queues.push(queue);
        self.reconfigurations.push(reconfigure);
        self.sensors.push(SensorStatus {
            name: config.name.clone(),
            address,
            port: sockets[port_index].0.local_addr().port(),
            port_index,
            position_port: config.position_port,
            counters,
            sharing: shared.status,
        });
        self.ready.push(Some(PortSensor {
            sensor,
            positions,
            reconfigurations,
            newest: Newest::default(),
        }));
        Ok(())
    }

    /// A port with its sensors.
    fn port(&mut self, source: UdpSource, plan: &PortPlan, shutdown: Shutdown) -> Port<B> {
        let status = PortStatus::new(&source, self.config, plan);
        let sensors = plan.sensors.iter();
        let sensors = sensors.filter_map(|&index| self.ready[index].take());
        let others = plan.others(self.config).map(|index| PositionQueue {
            sender: self.queues[index].clone(),
            counters: Arc::clone(&self.sensors[index].counters),
        });
        let state = PortState {
            admission: plan.admission(self.config),
            sensors: sensors.collect(),
            others: others.collect(),
            recordings: Vec::new(),
            counters: Arc::clone(&status.counters),
        };
        let (to_port, changes) = mpsc::channel();
        let here = plan.sensors.iter().copied();
        self.links.push(PortLink {
            sensors: here.chain(plan.others(self.config)).collect(),
            counters: Arc::clone(&status.counters),
            changes: to_port,
        });
        self.ports.push(status);
        let heartbeat_period = heartbeat_period(sd_notify::watchdog_enabled());
        Port::new(source, state, changes, shutdown, heartbeat_period)
    }
}

impl PortStatus {
    fn new(source: &UdpSource, config: &Config, plan: &PortPlan) -> Self {
        let local = source.local_addr();
        let buffer = source.buffer();
        let name = PortName(&plan.config, local.port()).to_string();
        let sensors = plan.sensors.iter();
        let models: Vec<Option<Model>> = sensors
            .map(|&index| config.sensors[index].pipeline.model)
            .collect();
        // Position packets are few.
        let warning = buffer.warning_for(local.port(), &models);
        if let Some(warning) = warning.filter(|_| !models.is_empty()) {
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

fn spawn<B>(
    port: Port<B>,
    name: &str,
    config: &PortConfig,
) -> Result<JoinHandle<Result<(), UdpError>>, DaemonError>
where
    B: Buffers<Buffer: Outgoing> + Send + 'static,
{
    let cpu = config.cpu;
    let priority = config.realtime_priority;
    let name = name.to_owned();
    let number = port.number();
    // The system shows 15 bytes of a thread's name.
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

/// Sets the core and the priority of the thread, if the system permits it.
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
            thread::sleep(Duration::from_millis(100));
            Ok(())
        });
        let runtime = Runtime {
            sensors: Arc::new([]),
            ports: Arc::new([]),
            events: mpsc::channel().1,
            reconfigurations: Vec::new(),
            over: Arc::default(),
            end: UnixStream::pair().unwrap().0,
            threads: vec![("127.0.0.1:2368".to_owned(), slow)],
        };
        runtime.stop().unwrap();
    }
}
