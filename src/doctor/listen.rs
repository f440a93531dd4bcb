//! What comes to the ports, listened to for a few seconds, through the same admission and pipelines
//! as the daemon's.

use std::net::{IpAddr, SocketAddr};
use std::time::{Duration, Instant};

use super::observe::{Heard, Port, PositionSender, Sensor};
use super::plan::Plan;
use crate::admission::{DiscoveredSensors, Refusal, Route};
use crate::capture::{UdpError, UdpSource};
use crate::cure::{Dialect, explain};
use sweepd_core::pipeline::{Config, Notice, Pipeline};
use sweepd_core::segment::ConfigError;
use sweepd_core::sweep::layout::{TimeSource, flags};
use sweepd_core::sweep::{HeapBuffers, Memory, SweepRef};
use sweepd_core::wire::{Content, Packet};

/// Senders of other datagrams that are remembered by name.
const MAX_OTHERS: usize = 16;
/// Senders of position packets that are remembered.
const MAX_POSITIONS: usize = 64;
/// Longest wait on one port while others may have something.
const TURN: Duration = Duration::from_millis(10);

/// What was heard.
pub struct Listened {
    /// By port of the plan.
    pub ports: Vec<Port>,
    /// Senders of data packets.
    pub sensors: Vec<Sensor>,
    /// Senders of position packets.
    pub positions: Vec<PositionSender>,
}

/// An open port.
struct Ear {
    source: UdpSource,
    admission: DiscoveredSensors,
    others: Vec<(SocketAddr, u64)>,
    /// By number of the sender.
    patients: Vec<Patient>,
}

/// A sensor, and the pipeline that decodes it.
struct Patient {
    seen: Sensor,
    pipeline: Pipeline,
    memory: Memory<HeapBuffers>,
    sweeps: u64,
}

/// Opens all ports of the plan and listens for so long. `opened` is told the ports that could be
/// opened before anything is received.
///
/// # Errors
/// [`UdpError`], when a port fails that could be opened.
pub fn listen(
    plan: &Plan,
    lasting: Duration,
    opened: impl FnOnce(&[u16]),
) -> Result<Listened, UdpError> {
    let mut ears: Vec<Result<Ear, Heard>> = plan
        .ports
        .iter()
        .map(|port| Ear::open(&port.udp()))
        .collect();
    let numbers: Vec<u16> = ears
        .iter()
        .flatten()
        .map(|ear| ear.source.local_addr().port())
        .collect();
    opened(&numbers);
    let mut positions = Vec::new();
    let until = Instant::now() + lasting;
    while !numbers.is_empty() && Instant::now() < until {
        for index in 0..ears.len() {
            let Ok(ear) = &mut ears[index] else { continue };
            let heard = ear.hear(&mut positions)?;
            // GPS time goes to the sensor of the same address, on whichever port its data comes.
            for (address, packet) in heard {
                let patients = ears.iter_mut().flatten().flat_map(|ear| &mut ear.patients);
                patients
                    .filter(|patient| patient.is_at(address))
                    .for_each(|patient| patient.takes(&packet));
            }
        }
    }
    let mut listened = Listened {
        ports: Vec::new(),
        sensors: Vec::new(),
        positions,
    };
    for (plan, ear) in plan.ports.iter().zip(ears) {
        let mut plan = plan.clone();
        let heard = match ear {
            Ok(ear) => {
                // Port 0 took a free one.
                plan.port = ear.source.local_addr().port();
                let (heard, sensors) = ear.conclude();
                listened.sensors.extend(sensors);
                heard
            }
            Err(refused) => refused,
        };
        listened.ports.push(Port { plan, heard });
    }
    Ok(listened)
}

impl Ear {
    fn open(config: &crate::capture::UdpConfig) -> Result<Self, Heard> {
        match UdpSource::bind(config) {
            Ok(source) => Ok(Self {
                source,
                admission: DiscoveredSensors::default(),
                others: Vec::new(),
                patients: Vec::new(),
            }),
            Err(error @ UdpError::PortTaken { .. }) => Err(Heard::Taken(error.to_string())),
            Err(error) => Err(Heard::Refused(error.to_string())),
        }
    }

    /// Takes what is there. Gives the position packets back, with the address of each.
    fn hear(
        &mut self,
        positions: &mut Vec<PositionSender>,
    ) -> Result<Vec<(IpAddr, Packet<'static>)>, UdpError> {
        let mut telemetry = Vec::new();
        for datagram in self.source.receive(TURN)? {
            match self.admission.admit(&datagram) {
                Ok((Route::Data(index), packet)) => {
                    while let Some(sender) = self.admission.senders().get(self.patients.len()) {
                        // Nobody asks for another segmentation than the usual one, which is
                        // possible.
                        let Ok(patient) = Patient::new(sender.source, sender.destination_port)
                        else {
                            break;
                        };
                        self.patients.push(patient);
                    }
                    if let Some(patient) = self.patients.get_mut(index) {
                        patient.takes(&packet);
                    }
                }
                Ok((Route::Position(_), packet)) => {
                    let address = datagram.source.ip();
                    note_position(positions, address, &packet);
                    if let Some(packet) = packet.without_sentence() {
                        telemetry.push((address, packet));
                    }
                }
                // A sensor beyond those that are told apart is none of the others.
                Err(refused) if refused.reason == Refusal::TooMany => {}
                Err(_) => note_other(&mut self.others, datagram.source),
            }
        }
        Ok(telemetry)
    }

    fn conclude(mut self) -> (Heard, Vec<Sensor>) {
        let (received, dropped, buffer) = (
            self.source.received(),
            self.source.dropped(),
            self.source.buffer(),
        );
        let sensors = self.patients.into_iter().map(Patient::conclude).collect();
        (
            Heard::All {
                received,
                dropped,
                others: self.others,
                buffer,
            },
            sensors,
        )
    }
}

impl Patient {
    fn new(source: SocketAddr, port: u16) -> Result<Self, ConfigError> {
        let mut config = Config::default();
        // The labels are not used.
        (config.segment.min_range_m, config.segment.max_range_m) = (0.0, 0.01);
        let pipeline = Pipeline::new("", config)?;
        Ok(Self {
            seen: Sensor {
                source: Some(source),
                port,
                ..Sensor::default()
            },
            pipeline,
            memory: Memory::default(),
            sweeps: 0,
        })
    }

    fn takes(&mut self, packet: &Packet<'_>) {
        if let Err(fault) = self.pipeline.push(packet) {
            self.seen.fault = Some(explain(&fault, Dialect::Configuration));
        }
        while let Some(bytes) = self.pipeline.poll(&mut self.memory) {
            if let Ok(sweep) = SweepRef::open(bytes.as_ref()) {
                self.sees(&sweep);
            }
        }
        for notice in self.pipeline.take_notices() {
            match notice {
                Notice::AwaitsCalibration => self.seen.awaits_calibration = true,
                Notice::Calibrated { .. } => self.seen.awaits_calibration = false,
                Notice::OtherCalibration { .. } => {}
            }
        }
    }

    fn is_at(&self, address: IpAddr) -> bool {
        self.seen
            .source
            .is_some_and(|source| source.ip() == address.to_canonical())
    }

    fn sees(&mut self, sweep: &SweepRef<'_>) {
        let (seen, header) = (&mut self.seen, sweep.header);
        seen.return_mode = Some(header.return_mode());
        if header.time_source() == TimeSource::Gps {
            let end_ns = header.time_ns + header.duration_ns as i64;
            seen.host_ahead_s = Some((header.arrival_ns - end_ns) as f64 * 1e-9);
        }
        self.sweeps += 1;
        // The first one begins anywhere.
        if self.sweeps > 1 {
            seen.flags |= header.flags;
        }
        if !header.has(flags::PARTIAL) {
            let (least, most) = seen.rpm.unwrap_or((header.rpm, header.rpm));
            seen.rpm = Some((least.min(header.rpm), most.max(header.rpm)));
            seen.whole_sweeps += 1;
        }
    }

    fn conclude(mut self) -> Sensor {
        let detection = self.pipeline.detection();
        self.seen.counts = self.pipeline.counts();
        self.seen.model = detection.map(|detection| detection.model);
        self.seen.return_mode = self
            .seen
            .return_mode
            .or(detection.map(|detection| detection.return_mode));
        self.seen
    }
}

fn note_other(others: &mut Vec<(SocketAddr, u64)>, source: SocketAddr) {
    if let Some((_, count)) = others.iter_mut().find(|(known, _)| *known == source) {
        *count += 1;
    } else if others.len() < MAX_OTHERS {
        others.push((source, 1));
    }
}

fn note_position(positions: &mut Vec<PositionSender>, address: IpAddr, packet: &Packet<'_>) {
    let Content::Position(position, rmc) = packet.content else {
        return;
    };
    let fix = position.nmea.map(|_| rmc.is_some_and(|rmc| rmc.valid));
    if let Some(known) = positions.iter_mut().find(|known| known.address == address) {
        (known.packets, known.pps, known.fix) = (known.packets + 1, position.pps, fix);
    } else if positions.len() < MAX_POSITIONS {
        positions.push(PositionSender {
            address,
            packets: 1,
            pps: position.pps,
            fix,
        });
    }
}
