//! Listens to the ports for a few seconds, with the same admission and pipelines as the daemon.

use std::net::IpAddr;
use std::time::{Duration, Instant};

use super::observe::{ObservedPort, ObservedSensor, PortResult, PositionSender};
use super::plan::{ExpectedSensor, Plan};
use crate::admission::{Refusal, Route, Sender};
use crate::cure::{Dialect, explain};
use crate::floor::Seen;
use crate::input::{Placed, UdpConfig, UdpError, UdpSource};
use crate::sensor_settings::FieldOfView;
use crate::strangers::Strangers;
use crate::streams::{Stream, Streams};
use sweepd_core::assemble::GpsTime;
use sweepd_core::buffers::{HeapBuffers, Memory};
use sweepd_core::floor::Sight;
use sweepd_core::pipeline::{Config, Event, Labels, Notice, Options, Pipeline};
use sweepd_core::segment::ConfigError;
use sweepd_core::sweep::SweepRef;
use sweepd_core::sweep::layout::{TimeSource, flags};
use sweepd_core::wire::{Content, Packet};

/// Senders of position packets that are remembered.
const MAX_POSITIONS: usize = 64;
/// Longest wait on one port while others may have something.
const TURN: Duration = Duration::from_millis(10);

/// What was received.
pub struct Received {
    /// By port of the plan.
    pub ports: Vec<ObservedPort>,
    /// Senders of data packets.
    pub sensors: Vec<ObservedSensor>,
    /// Senders of position packets.
    pub positions: Vec<PositionSender>,
}

impl Received {
    /// Whether no packet came.
    pub fn is_empty(&self) -> bool {
        self.sensors.is_empty() && self.positions.is_empty()
    }
}

/// An open port.
struct Listener {
    source: UdpSource,
    streams: Streams<DecodedSensor>,
    /// Senders of datagrams that are not packets.
    others: Strangers,
}

/// A sensor, and the pipeline that decodes it.
struct DecodedSensor {
    observed: ObservedSensor,
    pipeline: Pipeline,
    memory: Memory<HeapBuffers>,
    sweeps: u64,
}

/// Opens all ports of the plan and listens for a time. `opened` gets the ports that could be opened
/// before anything is received.
///
/// # Errors
/// [`UdpError`], when an open port fails.
pub fn listen(
    plan: &Plan,
    lasting: Duration,
    opened: impl FnOnce(&[u16]),
) -> Result<Received, UdpError> {
    let mut listeners: Vec<Result<Listener, PortResult>> = plan
        .ports
        .iter()
        .map(|port| Listener::open(&port.udp()))
        .collect();
    let ports: Vec<u16> = listeners.iter().flatten().map(Listener::port).collect();
    opened(&ports);
    let mut positions = Vec::new();
    let until = Instant::now() + lasting;
    while !ports.is_empty() && Instant::now() < until {
        for index in 0..listeners.len() {
            let Ok(listener) = &mut listeners[index] else {
                continue;
            };
            let port = listener.port();
            // GPS time goes to the sensor of the same address, on any port of its data.
            for (address, packet) in listener.receive(&plan.sensors, &mut positions)? {
                for sensor in listeners
                    .iter_mut()
                    .flatten()
                    .flat_map(|one| &mut one.streams.all)
                {
                    let observed = &sensor.observed;
                    if observed.source.ip() == address.to_canonical() && observed.port != port {
                        sensor.push(&packet);
                    }
                }
            }
        }
    }
    let mut received = Received {
        ports: Vec::new(),
        sensors: Vec::new(),
        positions,
    };
    for (plan, listener) in plan.ports.iter().zip(listeners) {
        let mut plan = plan.clone();
        let result = match listener {
            Ok(mut listener) => {
                // Port 0 took a free one.
                plan.port = listener.port();
                let result = PortResult::Open {
                    received: listener.source.received(),
                    dropped: listener.source.dropped(),
                    others: listener.others.all(),
                    buffer: listener.source.buffer(),
                };
                let sensors = listener.streams.all.into_iter();
                let sensors = sensors.map(DecodedSensor::finish);
                received.sensors.extend(sensors);
                result
            }
            Err(refused) => refused,
        };
        received.ports.push(ObservedPort { plan, result });
    }
    Ok(received)
}

impl Listener {
    fn open(config: &UdpConfig) -> Result<Self, PortResult> {
        match UdpSource::bind(config) {
            Ok(source) => Ok(Self {
                source,
                streams: Streams::new(Vec::new()),
                others: Strangers::default(),
            }),
            Err(error @ UdpError::PortTaken { .. }) => Err(PortResult::Taken(error.to_string())),
            Err(error) => Err(PortResult::Refused(error.to_string())),
        }
    }

    fn port(&self) -> u16 {
        self.source.local_addr().port()
    }

    /// Takes waiting datagrams. Returns the position packets, with the address of each, for the
    /// sensors of other ports.
    fn receive(
        &mut self,
        sensors: &[ExpectedSensor],
        positions: &mut Vec<PositionSender>,
    ) -> Result<Vec<(IpAddr, Packet<'static>)>, UdpError> {
        let mut for_sensors = Vec::new();
        for datagram in self.source.receive(TURN)? {
            let placed = Placed::from(datagram);
            // The usual segmentation, which a sensor asks for, is possible.
            let begin = |_, sender: &Sender| DecodedSensor::new(sender, sensors);
            match self.streams.take(&placed, begin) {
                Ok(Ok((Route::Position(_), packet))) => {
                    let address = datagram.source.ip();
                    note_position(positions, address, &packet);
                    if let Some(packet) = packet.without_text() {
                        for_sensors.push((address, packet));
                    }
                }
                // A sensor beyond the most that are distinguished does not count as another sender.
                Ok(Err(refused)) if refused.reason != Refusal::TooMany => {
                    self.others.add(&datagram);
                }
                _ => {}
            }
        }
        Ok(for_sensors)
    }
}

impl Stream for DecodedSensor {
    type Sweep = ();

    fn take(&mut self, packet: Option<&Packet<'_>>, _: &Placed<'_>) {
        if let Some(packet) = packet {
            self.push(packet);
        }
    }
}

impl DecodedSensor {
    /// A sensor that has sent nothing yet, mounted as the one of these that it is taken for.
    fn new(sender: &Sender, sensors: &[ExpectedSensor]) -> Result<Self, ConfigError> {
        let mut observed = ObservedSensor::new(sender.source, sender.destination_port);
        let expected = sensors.iter().find(|one| observed.matches(one));
        let segment = expected.map_or_else(Default::default, |one| one.segment.clone());
        observed.floor = Seen {
            set: expected.map(|one| one.segment.mount),
            ..Seen::new(Sight::Unknown, &segment)
        };
        let config = Config {
            segment,
            ..Config::default()
        };
        let options = Options {
            // None are needed.
            labels: Labels::Elsewhere,
            ..Options::default()
        };
        Ok(Self {
            observed,
            pipeline: Pipeline::with_options("", config, options)?,
            memory: Memory::default(),
            sweeps: 0,
        })
    }

    fn push(&mut self, packet: &Packet<'_>) {
        self.pipeline.push(packet);
        while let Some(event) = self.pipeline.poll(&mut self.memory) {
            match event {
                Event::Sweep(bytes) => {
                    if let Ok(sweep) = SweepRef::open(bytes.as_ref()) {
                        self.observe(&sweep);
                    }
                }
                Event::Fault(fault) => {
                    self.observed.fault = Some(explain(&fault, Dialect::Configuration));
                }
                Event::Notice(Notice::AwaitsCalibration) => self.observed.awaits_calibration = true,
                Event::Notice(Notice::Calibrated { .. }) => {
                    self.observed.awaits_calibration = false;
                }
                Event::Notice(_) | Event::Objects(_) => {}
            }
        }
    }

    fn observe(&mut self, sweep: &SweepRef<'_>) {
        let observed = &mut self.observed;
        let header = sweep.header;
        observed.return_mode = Some(header.return_mode());
        if header.time_source() == TimeSource::Gps {
            let end_ns = header.time_ns + header.duration_ns as i64;
            observed.host_ahead_s = Some((header.arrival_ns - end_ns) as f64 * 1e-9);
        }
        let doubt = self.pipeline.status().gps.and_then(GpsTime::doubt);
        let observed = &mut self.observed;
        observed.gps_doubt = doubt.or(observed.gps_doubt);
        self.sweeps += 1;
        // The first one begins anywhere.
        if self.sweeps > 1 {
            observed.flags |= header.flags;
        }
        if !header.has(flags::PARTIAL) {
            let (least, most) = observed.rpm.unwrap_or((header.rpm, header.rpm));
            observed.rpm = Some((least.min(header.rpm), most.max(header.rpm)));
            observed.whole_sweeps += 1;
            let limits_deg = self.pipeline.status().field_of_view_deg;
            observed.fov = FieldOfView::measured(header.flags, limits_deg).or(observed.fov);
        }
    }

    fn finish(mut self) -> ObservedSensor {
        let status = self.pipeline.status();
        self.observed.counts = status.counts;
        self.observed.dark_beams = status.dark_beams.iter().collect();
        self.observed.floor.sight = status.floor;
        if let Some(detection) = status.detection {
            self.observed.model = Some(detection.model);
            self.observed
                .return_mode
                .get_or_insert(detection.return_mode);
        }
        self.observed
    }
}

fn note_position(positions: &mut Vec<PositionSender>, address: IpAddr, packet: &Packet<'_>) {
    let Content::Position(position, sentence) = packet.content else {
        return;
    };
    let fix = sentence.map(|read| read.map(|rmc| rmc.valid));
    if let Some(known) = positions.iter_mut().find(|known| known.address == address) {
        known.packets += 1;
        known.pps = position.pps;
        known.fix = fix;
    } else if positions.len() < MAX_POSITIONS {
        positions.push(PositionSender {
            address,
            packets: 1,
            pps: position.pps,
            fix,
        });
    }
}
