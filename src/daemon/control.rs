//! The control plane, on one thread: signals, log messages about sensors, systemd, and health over
//! HTTP.

use crate::admission::Refusal;
use std::fs::File;
use std::future::pending;
use std::io;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread;
use std::time::{Duration, Instant};

use tokio::net::TcpListener;
use tokio::signal::unix::{Signal, SignalKind, signal};
use tokio::sync::oneshot;
use tokio::time::{Interval, MissedTickBehavior, interval_at, timeout_at};
use tracing::{error, info, warn};

use super::config::{Config, DaemonConfig};
use super::counters::SensorCounters;
use super::health::{self, View};
use super::http::{self, Http};
use super::notify::{Notifier, Pulse, heartbeat_period};
use super::record::protocol::SegmentSettings;
use super::record::server::{ControlServer, Told};
use super::record::{Recordings, socket_path};
use super::runtime::{DaemonError, PortStatus, Runtime, SensorStatus};
use super::sensor::Event;
use super::sharing::Sharing;
use super::silence::Silence;
use super::state::{Condition, Facts, Message, Observation, Running, Watcher};
use crate::cure::{Dialect, explain};
use crate::judge::losses::{SensorAddress, Tally};
use crate::judge::{Finding, Remark};
use sweepd_core::pipeline::{DarkBeam, Notice};

/// How long the configuration may be read at a reload: each of its files has a limit of its own, but
/// there may be many.
const READ_PATIENCE: Duration = Duration::from_secs(30);
/// Interval between attempts to start: the first, and the longest.
const RETRY: (Duration, Duration) = (Duration::from_millis(250), Duration::from_secs(2));

/// How many descriptors tokio opens, rounded up.
const TOKIO_DESCRIPTORS: usize = 6;

/// A configuration that was read again.
#[derive(Clone, Debug)]
pub struct Reload {
    /// The configuration from now on: sensors and ports of the old one, and all values of the new
    /// one that need no restart.
    pub config: Config,
    /// The changes that were applied, a sentence each.
    pub taken: Vec<String>,
    /// What cannot be, likewise.
    pub needs_restart: Vec<String>,
}

/// Reads the configuration again and compares it with the running one; the error says why it cannot
/// be applied. On a thread of its own, since a disk may hang.
pub type Reread = Arc<dyn Fn(&Config) -> Result<Reload, String> + Send + Sync>;

/// Runs the daemon until SIGTERM or SIGINT; SIGHUP reads the configuration again, as does `hangup`,
/// which one may have set before this is called. `root` is the folder in which consumers find it, with
/// its control socket.
///
/// A signal ends it within 200 ms if its threads get a core. The recordings take longer: their data
/// is synced before this returns, however slow the disk is. (systemd allows the TimeoutStopSec of
/// the unit; data not written by then is lost.)
///
/// # Errors
/// [`DaemonError`]: it cannot start, or cannot continue; the process must then end, so that systemd
/// restarts it.
pub fn run<S: Sharing>(
    config: Config,
    sharing: &S,
    root: &Path,
    reread: Reread,
    hangup: &AtomicBool,
) -> Result<(), DaemonError> {
    let begun = Instant::now();
    let tokio = tokio_runtime().map_err(|source| DaemonError::System {
        what: "start the control thread",
        source,
    })?;
    tokio.block_on(async {
        // Before anything is opened, so that no signal interrupts that.
        let mut signals = Signals::new().map_err(|source| DaemonError::System {
            what: "handle signals",
            source,
        })?;
        let is_to_reload = hangup.load(Ordering::Relaxed);
        let http = listen(&config.daemon).await?;
        let mut recordings = Recordings::default();
        let started = await_start(root, http.as_ref(), &mut signals, || {
            Runtime::start(&config, sharing, &mut recordings)
        });
        let Some(runtime) = started.await? else {
            return Ok(());
        };
        let told = Told::default();
        let events = recordings.event_sender();
        let server = ControlServer::start(&socket_path(root), events, Arc::clone(&told));
        // No reason not to run.
        let server = server
            .inspect_err(|error| warn!("`sweepd record --from` is not served: {error}"))
            .ok();
        Control::new(config, runtime, recordings, reread, told, root, begun)
            .serve(sharing, signals, http, server, is_to_reload)
            .await
    })
}

/// The runtime of the control thread. Tokio panics where there are no descriptors for its signals, so
/// these are tried before.
fn tokio_runtime() -> io::Result<tokio::runtime::Runtime> {
    let mut held = Vec::new();
    for _ in 0..TOKIO_DESCRIPTORS {
        held.push(File::open("/dev/null")?);
    }
    drop(held);
    tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build()
}

/// Starts, and retries while the cause may pass: at boot, the network may not be up yet. `None`
/// when it was asked to end. A reload ends it too: systemd then starts it with the new
/// configuration.
async fn await_start(
    root: &Path,
    http: Option<&Http>,
    signals: &mut Signals,
    mut start: impl FnMut() -> Result<Runtime, DaemonError>,
) -> Result<Option<Runtime>, DaemonError> {
    let mut notifier = Notifier::default();
    let mut pause = RETRY.0;
    let mut told = String::new();
    loop {
        let error = match start() {
            Ok(runtime) => return Ok(Some(runtime)),
            Err(error) if error.may_pass() => error,
            Err(error) => return Err(error),
        };
        let why = format!("{error}; it is waited for");
        notifier.waits(&why, 2 * RETRY.1);
        if why != told {
            warn!("{why}");
        }
        let view = Arc::new(Mutex::new(View::waiting(why.clone(), root.to_owned())));
        told = why;
        tokio::select! {
            () = tokio::time::sleep(pause) => {}
            never = serve_health(http, view) => match never {},
            _ = signals.terminate.recv() => return Ok(None),
            _ = signals.interrupt.recv() => return Ok(None),
            _ = signals.reload.recv() => return Err(error),
        }
        pause = (2 * pause).min(RETRY.1);
    }
}

async fn serve_health(http: Option<&Http>, view: Arc<Mutex<View>>) -> std::convert::Infallible {
    match http {
        Some(http) => http::serve(http, view).await,
        None => pending().await,
    }
}

struct Signals {
    terminate: Signal,
    interrupt: Signal,
    reload: Signal,
}

impl Signals {
    fn new() -> io::Result<Self> {
        Ok(Self {
            terminate: signal(SignalKind::terminate())?,
            interrupt: signal(SignalKind::interrupt())?,
            reload: signal(SignalKind::hangup())?,
        })
    }
}

async fn listen(config: &DaemonConfig) -> Result<Option<Http>, DaemonError> {
    let Some(address) = config.http else {
        return Ok(None);
    };
    let bound = TcpListener::bind(address)
        .await
        .and_then(|listener| Ok((listener.local_addr()?, listener)));
    let (address, listener) = bound.map_err(|source| DaemonError::Http { address, source })?;
    info!("health and metrics at http://{address}/health and http://{address}/metrics");
    if !address.ip().is_loopback() {
        warn!("health and metrics are served to every host that reaches {address}");
    }
    Ok(Some(Http {
        listener,
        is_public: config.http_public,
    }))
}

/// All that the control thread holds.
struct Control {
    config: Config,
    runtime: Runtime,
    recordings: Recordings,
    reread: Reread,
    /// The configuration, while it is read again.
    reading: Option<Reading>,
    /// What the control socket tells of the sensors.
    told: Told,
    /// When tokio's clock began.
    begun: Instant,
    watchers: Vec<Watcher>,
    pulse: Pulse,
    /// How often all threads and sensors are checked.
    period: Duration,
    /// Threads that hang, as last logged.
    hanging: Vec<usize>,
    /// Ports whose interfaces are gone, as last logged.
    gone: Vec<usize>,
    /// How often the shared memory of each sensor was made again, as last logged.
    renewed: Vec<u64>,
    /// Why silent sensors are silent.
    silence: Silence,
    /// Ports for which it was logged that position packets reach no sensor.
    ambiguous: Vec<usize>,
    /// Why the configuration on disk is not the one in use.
    refused: Option<Finding>,
    notifier: Notifier,
    view: Arc<Mutex<View>>,
}

impl Control {
    fn new(
        config: Config,
        runtime: Runtime,
        recordings: Recordings,
        reread: Reread,
        told: Told,
        root: &Path,
        begun: Instant,
    ) -> Self {
        let now = begun.elapsed();
        let mut watchers = Vec::new();
        for (status, sensor) in runtime.sensors.iter().zip(&config.sensors) {
            let place = SensorAddress {
                address: status.address.to_string(),
                port: Some(status.port),
                sensors: runtime.sensors_of_port(status.port_index).count(),
            };
            watchers.push(Watcher::new(
                &status.name,
                place,
                sensor.want.clone(),
                sensor.losses,
                now,
            ));
        }
        let watchdog = sd_notify::watchdog_enabled();
        let pulse = Pulse::new(watchdog, runtime.ports.len(), now);
        let view = View::new(
            Arc::clone(&runtime.sensors),
            Arc::clone(&runtime.ports),
            root.to_owned(),
        );
        let view = Arc::new(Mutex::new(view));
        let notifier = Notifier::default();
        let renewed = vec![0; runtime.sensors.len()];
        tell_settings(&told, &config);
        Self {
            config,
            runtime,
            recordings,
            reread,
            reading: None,
            told,
            begun,
            watchers,
            pulse,
            period: heartbeat_period(watchdog),
            hanging: Vec::new(),
            gone: Vec::new(),
            renewed,
            silence: Silence::default(),
            ambiguous: Vec::new(),
            refused: None,
            notifier,
            view,
        }
    }

    async fn serve(
        mut self,
        sharing: &impl Sharing,
        mut signals: Signals,
        http: Option<Http>,
        server: Option<ControlServer>,
        is_to_reload: bool,
    ) -> Result<(), DaemonError> {
        for status in self.runtime.sensors.iter() {
            info!(
                "{}: waiting for packets from {} on port {}",
                status.name, status.address, status.port
            );
        }
        let view = Arc::clone(&self.view);
        let serving = serve_health(http.as_ref(), view);
        let mut ticks = ticks(self.begun, self.period);
        self.notifier.ready();
        if is_to_reload {
            self.reload();
        }
        tokio::pin!(serving);
        let ended = loop {
            tokio::select! {
                _ = signals.terminate.recv() => break Ok("SIGTERM"),
                _ = signals.interrupt.recv() => break Ok("SIGINT"),
                // Those that come meanwhile wait, as one.
                _ = signals.reload.recv(), if self.reading.is_none() => self.reload(),
                read = heard(&mut self.reading) => self.take(read),
                never = &mut serving => match never {},
                event = self.recordings.next_event() => self.recordings.handle(event),
                _ = ticks.tick() => match self.look_around() {
                    Ok(()) => sharing.look(),
                    Err(error) => break Err(error),
                },
            }
        };
        self.notifier.stopping();
        // A client that finds it gone must see in the log that it was asked to end.
        let ended = ended.map(|signal| info!("ends, by {signal}"));
        let stopped = self.runtime.stop();
        self.recordings.finish();
        if let Some(server) = server {
            server.finish().await;
        }
        ended.and(stopped)
    }

    /// Checks every thread and sensor, and logs changes.
    fn look_around(&mut self) -> Result<(), DaemonError> {
        self.runtime.check()?;
        let now = self.begun.elapsed();
        self.hear_events();
        self.recordings.look();
        self.silence.look(now, &self.runtime, &mut self.watchers);
        for (watcher, sensor) in self.watchers.iter_mut().zip(self.runtime.sensors.iter()) {
            let tally = tally(sensor, &self.runtime);
            watcher
                .observe(&Observation {
                    tally,
                    ..observation(&sensor.counters, now)
                })
                .iter()
                .for_each(log);
            let mut dark = sensor.counters.dark_beams();
            dark.retain(DarkBeam::is_warning);
            watcher.observe_beams(dark).iter().for_each(log);
            let eye = sensor.counters.eye();
            watcher.observe_eye(eye).iter().for_each(log);
        }
        let hanging = self.pulse.observe(
            now,
            self.runtime
                .ports
                .iter()
                .map(|port| port.counters.heartbeat.get()),
        );
        for &index in hanging.iter().filter(|index| !self.hanging.contains(index)) {
            error!(
                "the thread of port {} hangs; systemd restarts the daemon, if it watches it",
                self.port(index)
            );
        }
        for &index in self.hanging.iter().filter(|index| !hanging.contains(index)) {
            warn!("the thread of port {} goes on", self.port(index));
        }
        if hanging.is_empty() && self.pulse.is_due(now) {
            self.notifier.feed();
        }
        self.hanging = hanging;
        self.look_at_interfaces();
        self.look_at_sharing();
        self.look_at_positions();
        self.tell();
        Ok(())
    }

    fn look_at_interfaces(&mut self) {
        let ports = self.runtime.ports.iter().enumerate();
        let gone: Vec<usize> = ports
            .filter(|(_, port)| port.counters.is_interface_gone())
            .map(|(at, _)| at)
            .collect();
        for &index in gone.iter().filter(|index| !self.gone.contains(index)) {
            warn!("{}", health::interface_gone(&self.runtime.ports[index]));
        }
        for &index in self.gone.iter().filter(|index| !gone.contains(index)) {
            info!("port {}: its interface is back", self.port(index));
        }
        self.gone = gone;
    }

    fn look_at_sharing(&mut self) {
        for (sensor, told) in self.runtime.sensors.iter().zip(&mut self.renewed) {
            let renewed = sensor.sharing.renewed();
            if std::mem::replace(told, renewed) != renewed {
                let why = sensor.sharing.renewed_because().unwrap_or_default();
                warn!("{}: shared memory was made anew: {why}", sensor.name);
            }
        }
    }

    /// Logs once for a port that its position packets reach no sensor.
    fn look_at_positions(&mut self) {
        for (index, port) in self.runtime.ports.iter().enumerate() {
            if port.counters.refused(Refusal::Ambiguous) > 0 && !self.ambiguous.contains(&index) {
                self.ambiguous.push(index);
                warn!(
                    "port {}: position packets reach no sensor: {} share an address, and nothing tells whose they are; give \
                     each its own `position_port`, or the port that it sends from, as in address = \"192.168.1.201:2368\"",
                    port.name,
                    port.sharing_an_address.join(" and ")
                );
            }
        }
    }

    fn hear_events(&mut self) {
        let events: Vec<_> = self.runtime.events.try_iter().collect();
        for (index, event) in events {
            let sensor = &self.runtime.sensors[index];
            let watcher = &mut self.watchers[index];
            let name = &sensor.name;
            match event {
                Event::Fault(fault) => watcher.refused(explain(&fault, Dialect::Configuration)),
                Event::Notice(Notice::AwaitsCalibration) => watcher.awaits_calibration(),
                Event::Notice(Notice::Calibrated { packets, .. }) => {
                    watcher.unhindered();
                    info!("{name}: calibrated by its own packets, the first {packets} of them");
                }
                Event::Notice(Notice::MistakenUnit { found_m, used_m }) => {
                    watcher.doubts_calibration(Remark::MistakenUnit { found_m, used_m });
                }
                Event::Notice(Notice::OtherCalibration { differences }) => {
                    let is_given = self.config.sensors[index].pipeline.calibration.is_some();
                    let values = differences.len();
                    watcher.doubts_calibration(match is_given {
                        true => Remark::OtherCalibration { values },
                        false => Remark::ExchangedUnit,
                    });
                }
                Event::Notice(other) => warn!("{name}: {other:?}"),
                Event::Reconfigured(Ok(())) => {
                    watcher.reconfigured();
                    info!("{name}: decoded with the new configuration");
                }
                Event::Reconfigured(Err(error)) => warn!("{name}: goes on as before: {error}"),
                Event::NotShared(why) => {
                    warn!(
                        "{name}: sweeps are not shared: {}",
                        sensor.sharing.trouble().unwrap_or(why)
                    );
                }
                Event::Time(source, doubt) => watcher.see_time(source, doubt).iter().for_each(log),
                Event::Floor(seen) => watcher.see_floor(seen).iter().for_each(log),
                Event::SharedAgain => info!("{name}: sweeps are shared again"),
            }
        }
    }

    /// Updates what health and systemd report.
    fn tell(&mut self) {
        let conditions: Vec<Condition> = self.watchers.iter().map(Watcher::condition).collect();
        let named = self.runtime.sensors.iter().zip(&conditions);
        let words: Vec<String> = named
            .map(|(sensor, is)| format!("{} {}", sensor.name, is.state))
            .collect();
        self.notifier.status(&words.join(", "));
        let hanging = self
            .hanging
            .iter()
            .map(|&index| self.port(index).to_owned())
            .collect();
        self.view
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .update(
                conditions,
                hanging,
                self.refused.clone(),
                self.recordings.status(),
            );
    }

    fn port(&self, index: usize) -> &str {
        &self.runtime.ports[index].name
    }

    /// Begins to read the configuration again; everything keeps running, also after an error.
    fn reload(&mut self) {
        self.notifier.reloading();
        let (sender, result) = oneshot::channel();
        let reread = Arc::clone(&self.reread);
        let old = self.config.clone();
        let thread = thread::Builder::new().name("reload".to_owned());
        let read = move || {
            // Who has waited long enough does not hear it.
            let _ = sender.send(reread(&old));
        };
        match thread.spawn(read) {
            Ok(_) => {
                self.reading = Some(Reading {
                    result,
                    deadline: Instant::now() + READ_PATIENCE,
                });
            }
            Err(error) => self.take(Err(format!("cannot start a thread: {error}"))),
        }
    }

    /// Takes the configuration that was read.
    fn take(&mut self, read: Result<Reload, String>) {
        self.reading = None;
        match read {
            Ok(Reload {
                config,
                taken,
                needs_restart,
            }) => {
                info!("the configuration was read");
                self.refused = None;
                config.warnings.iter().for_each(|what| warn!("{what}"));
                taken.iter().for_each(|what| info!("{what}"));
                self.apply(config);
                needs_restart.iter().for_each(|what| warn!("{what}"));
            }
            Err(why) => {
                let refused = health::reload_refused(&why);
                warn!("{refused}");
                self.refused = Some(refused);
            }
        }
        self.notifier.ready();
    }

    fn apply(&mut self, config: Config) {
        let old = std::mem::replace(&mut self.config, config);
        tell_settings(&self.told, &self.config);
        for (index, (new, old)) in self.config.sensors.iter().zip(&old.sensors).enumerate() {
            if new.pipeline != old.pipeline {
                self.runtime.reconfigure(index, new.pipeline.clone());
            }
            if new.want != old.want {
                self.watchers[index].expect(new.want.clone());
            }
            self.watchers[index].limit_losses(new.losses);
        }
        // A failed recording is started again at once: the user reloads when the disk works again.
        if self.config.record.as_ref() != self.recordings.config() || self.recordings.has_failed() {
            self.recordings.configure(self.config.record.as_ref());
        }
    }
}

/// A configuration that another thread reads.
struct Reading {
    result: oneshot::Receiver<Result<Reload, String>>,
    deadline: Instant,
}

/// What was read, or that it takes too long; never, where nothing is.
async fn heard(reading: &mut Option<Reading>) -> Result<Reload, String> {
    let Some(Reading { result, deadline }) = reading else {
        return pending().await;
    };
    match timeout_at((*deadline).into(), result).await {
        Ok(Ok(read)) => read,
        Ok(Err(_)) => Err("the thread that read it has failed".to_owned()),
        Err(_) => Err(format!(
            "it is not read within {} s; check the disks and the network that its files lie on",
            READ_PATIENCE.as_secs()
        )),
    }
}

/// Has the control socket tell what the sensors are segmented with.
fn tell_settings(told: &Told, config: &Config) {
    let mut told = told.lock().unwrap_or_else(PoisonError::into_inner);
    for sensor in &config.sensors {
        let settings = SegmentSettings::of(&sensor.pipeline.segment);
        told.insert(sensor.name.clone(), settings);
    }
}

/// Ticks at once, and then at multiples of a period since tokio's clock began. Its timer wheel
/// turns every 64 ms: a timer that is due at a multiple of that, as with the longest period of
/// [`heartbeat_period`], wakes the thread once, any other one twice.
fn ticks(begun: Instant, period: Duration) -> Interval {
    let mut ticks = interval_at(begun.into(), period);
    ticks.set_missed_tick_behavior(MissedTickBehavior::Skip);
    ticks
}

fn log(message: &Message) {
    if message.is_warning {
        warn!("{}", message.text);
    } else {
        info!("{}", message.text);
    }
}

/// Counts of a sensor's packets, and of its port.
fn tally(sensor: &SensorStatus, runtime: &Runtime) -> Tally {
    let Some(PortStatus { counters: port, .. }) = runtime.ports.get(sensor.port_index) else {
        return sensor.counters.tally();
    };
    let own: u64 = runtime
        .sensors_of_port(sensor.port_index)
        .map(|other| other.counters.refused.get())
        .sum();
    Tally {
        dropped: port.dropped.get(),
        received: port.received.get(),
        strangers: port.all_refused().saturating_sub(own),
        ..sensor.counters.tally()
    }
}

fn observation(counters: &SensorCounters, now: Duration) -> Observation {
    // Loaded in the opposite order of counting, so that no sweep is seen before its packets.
    let steady_sweeps = counters.steady_sweeps.get();
    let model = counters.model();
    let return_mode = counters.return_mode();
    let running = model.zip(return_mode).map(|(model, return_mode)| Running {
        model,
        return_mode,
        rpm: counters.rpm(),
        fov: counters.fov(),
    });
    let data = counters.data.get();
    let position = counters.position.get();
    Observation {
        now,
        data,
        position,
        steady_sweeps,
        running,
        tally: Tally::default(),
        facts: Facts {
            other_product: counters.other_product(),
            restarts: counters.restarts.get(),
            clock_jumps: counters.clock_jumps.get(),
            pulse: counters.pulse(),
            host_ahead_s: counters.host_ahead_s(),
            is_view_limited: counters.is_view_limited(),
        },
    }
}
