//! A daemon whose sweeps the test gets, and sensors that are not there.

use std::net::{Ipv4Addr, SocketAddr, UdpSocket};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{self, Receiver, Sender};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use sweepd::buffers::HeapBuffer;
use sweepd::buffers::{Buffers, HeapBuffers};
use sweepd::daemon::config::{Config, DaemonConfig, PortConfig, SensorConfig};
use sweepd::daemon::sharing::{Outgoing, SharedOutput, Sharing, SharingError, SharingStatus};
use sweepd::host::realtime_ns;
use sweepd::sensor::Model;
use sweepd::wire::data::ReturnMode;
use sweepd_lab::simulate::gps::{Clock, Reception};
use sweepd_lab::simulate::{Emitter, EmitterConfig, street};
pub use sweepd_testkit::free_port;
use sweepd_testkit::{PATIENCE, counting::of_this_thread};

/// What happens to a thread that sends a sweep.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fate {
    /// It sends the sweep.
    Sends,
    /// It never comes back.
    Hangs,
    /// It panics.
    Panics,
    /// It is told that no consumer can be had.
    Fails,
    /// It gets the sweep back: the memory to send it by is still being taken.
    Waits,
}

/// Sharing by a channel; everything that is sent arrives there, by the name of its sensor.
#[derive(Clone)]
pub struct Rig {
    sender: Sender<(Arc<str>, HeapBuffer)>,
    fate: Arc<Mutex<Fate>>,
    /// What the thread of the sensor had allocated, in calls, after each sweep was sent and before
    /// the next was.
    pub allocated: Arc<Mutex<Vec<(u64, u64)>>>,
}

pub struct RigBuffers {
    heap: HeapBuffers,
    name: Arc<str>,
    rig: Rig,
}

pub struct Sweep {
    bytes: HeapBuffer,
    name: Arc<str>,
    rig: Rig,
}

struct OneConsumer(Arc<Mutex<Fate>>);

impl SharingStatus for OneConsumer {
    fn consumers(&self) -> u64 {
        1
    }

    fn reserved_bytes(&self) -> u64 {
        4096
    }

    fn trouble(&self) -> Option<String> {
        (*self.0.lock().unwrap() == Fate::Fails).then(|| "the memory is full".to_owned())
    }
}

impl Rig {
    pub fn new() -> (Self, Receiver<(Arc<str>, HeapBuffer)>) {
        let (sender, sweeps) = mpsc::channel();
        let allocated = Arc::new(Mutex::new(Vec::with_capacity(1_000)));
        (
            Self {
                sender,
                fate: Arc::new(Mutex::new(Fate::Sends)),
                allocated,
            },
            sweeps,
        )
    }

    /// From now on.
    pub fn fate(&self, fate: Fate) {
        *self.fate.lock().unwrap() = fate;
    }
}

impl Sharing for Rig {
    type Buffers = RigBuffers;

    fn open(&self, sensor: &SensorConfig) -> Result<SharedOutput<RigBuffers>, SharingError> {
        if sensor.name == "unshareable" {
            return Err("no room in /dev/shm".into());
        }
        let (name, rig) = (sensor.name.as_str().into(), self.clone());
        let buffers = RigBuffers {
            heap: HeapBuffers::default(),
            name,
            rig,
        };
        Ok(SharedOutput {
            objects: None,
            buffers,
            status: Arc::new(OneConsumer(Arc::clone(&self.fate))),
        })
    }
}

impl Buffers for RigBuffers {
    type Buffer = Sweep;

    fn take(&mut self, bytes: usize) -> Sweep {
        Sweep {
            bytes: self.heap.take(bytes),
            name: Arc::clone(&self.name),
            rig: self.rig.clone(),
        }
    }
}

impl AsRef<[u8]> for Sweep {
    fn as_ref(&self) -> &[u8] {
        self.bytes.as_ref()
    }
}

impl AsMut<[u8]> for Sweep {
    fn as_mut(&mut self) -> &mut [u8] {
        self.bytes.as_mut()
    }
}

impl Outgoing for Sweep {
    fn publish(self) -> Result<Option<Self>, SharingError> {
        let (fate, before) = (*self.rig.fate.lock().unwrap(), of_this_thread());
        match fate {
            Fate::Sends => {
                let _ = self.rig.sender.send((self.name, self.bytes));
                self.rig
                    .allocated
                    .lock()
                    .unwrap()
                    .push((before, of_this_thread()));
                Ok(None)
            }
            Fate::Hangs => loop {
                std::thread::park();
            },
            Fate::Panics => panic!("the consumer's file is gone"),
            Fate::Fails => Err("no consumer can be had".into()),
            Fate::Waits => Ok(Some(self)),
        }
    }
}

/// A sensor at 127.0.0.`host` whose packets come to ports of 127.0.0.1.
pub fn sensor(name: &str, host: u8, (data, position): (u16, u16)) -> SensorConfig {
    SensorConfig {
        name: name.to_owned(),
        address: Ipv4Addr::new(127, 0, 0, host).into(),
        port: PortConfig {
            bind: Ipv4Addr::LOCALHOST,
            port: data,
            ..PortConfig::default()
        },
        position_port: position,
        ..SensorConfig::default()
    }
}

pub fn config(sensors: Vec<SensorConfig>) -> Config {
    Config {
        daemon: DaemonConfig {
            root: None,
            http: None,
            http_public: false,
        },
        sensors,
        record: None,
        warnings: Vec::new(),
    }
}

/// A datagram of a sensor: when after the first it leaves, whether it is a data packet, and its
/// bytes.
#[derive(Clone)]
pub struct Sent {
    pub after: Duration,
    pub is_data: bool,
    pub payload: Vec<u8>,
}

/// What a sensor with GPS sends, for this many turns.
pub fn stream(model: Model, mode: ReturnMode, turns: f64) -> Vec<Sent> {
    stream_by(
        model,
        mode,
        turns,
        Clock::Gps {
            position_deg: (50.1, 8.7),
            reception: Reception::ALWAYS,
        },
    )
}

/// The same without a GPS receiver: what arrives later than it was made is no clock that is off.
pub fn stream_without_gps(model: Model, mode: ReturnMode, turns: f64) -> Vec<Sent> {
    let hour_ns = 7_000_000_000;
    stream_by(model, mode, turns, Clock::Free { hour_ns })
}

/// What a VLP-16 without a GPS receiver sends, whose boards have 20 degrees Celsius, for so many
/// turns.
pub fn cool_stream_without_gps(turns: f64) -> Vec<Sent> {
    let mut stream = stream_without_gps(Model::Vlp16, ReturnMode::Strongest, turns);
    for sent in stream.iter_mut().filter(|sent| !sent.is_data) {
        // Where the packet tells the temperatures of its boards.
        sent.payload[0x0BB..0x0BD].fill(20);
    }
    stream
}

fn stream_by(model: Model, mode: ReturnMode, turns: f64, clock: Clock) -> Vec<Sent> {
    let mut config = EmitterConfig::new(model, mode).turns(turns);
    config.clock = clock;
    // As of this hour: a receiver of another day would be told. Stamps begin with it in any case.
    let now_ns = realtime_ns();
    config.start_utc_ns = now_ns - now_ns % 3_600_000_000_000;
    let scene = street(1);
    let sent: Vec<_> = Emitter::new(config, &scene).untold().collect();
    let first_ns = sent[0].arrival_ns;
    let of = |one: sweepd_lab::simulate::SimulatedDatagram| Sent {
        after: Duration::from_nanos((one.arrival_ns - first_ns).max(0) as u64),
        is_data: one.truth.is_some() || one.payload.len() == 1206,
        payload: one.payload,
    };
    sent.into_iter().map(of).collect()
}

/// A sensor that sends in real time from 127.0.0.`host`, its data and position packets to a port
/// each.
pub struct Sending(Arc<AtomicBool>, Option<JoinHandle<Duration>>);

impl Sending {
    pub fn start(host: u8, ports: (u16, u16), stream: Vec<Sent>) -> Self {
        Self::start_from((Ipv4Addr::new(127, 0, 0, host), 0), ports, stream)
    }

    /// The same, from a port of its own.
    pub fn start_from(
        from: (Ipv4Addr, u16),
        (data, position): (u16, u16),
        stream: Vec<Sent>,
    ) -> Self {
        let over = Arc::new(AtomicBool::new(false));
        let ended = Arc::clone(&over);
        let socket = UdpSocket::bind(from).unwrap();
        let thread = std::thread::spawn(move || {
            let (begun, mut latest) = (Instant::now(), Duration::ZERO);
            for sent in stream {
                std::thread::sleep((begun + sent.after).saturating_duration_since(Instant::now()));
                if ended.load(Ordering::Relaxed) {
                    break;
                }
                latest = latest.max(begun.elapsed().saturating_sub(sent.after));
                let port = if sent.is_data { data } else { position };
                socket
                    .send_to(&sent.payload, SocketAddr::from((Ipv4Addr::LOCALHOST, port)))
                    .unwrap();
            }
            latest
        });
        Self(over, Some(thread))
    }

    /// Waits until all is sent, and gives how late the latest datagram was.
    pub fn finish(mut self) -> Duration {
        self.1.take().unwrap().join().unwrap()
    }
}

impl Drop for Sending {
    fn drop(&mut self) {
        self.0.store(true, Ordering::Relaxed);
        if let Some(thread) = self.1.take() {
            let _ = thread.join();
        }
    }
}

/// Waits until something is so.
#[track_caller]
pub fn until(what: &str, mut is_so: impl FnMut() -> bool) {
    let begun = Instant::now();
    while !is_so() {
        assert!(begun.elapsed() < PATIENCE, "waited in vain until {what}");
        std::thread::sleep(Duration::from_millis(2));
    }
}
