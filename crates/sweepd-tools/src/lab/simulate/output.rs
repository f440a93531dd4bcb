//! Where simulated datagrams go.

use std::time::Instant;

use super::args::Target;
use sweepd::cli::CliError;
use sweepd::cli::capture::CaptureOutput;
use sweepd::cli::send::Sender;
use sweepd::export::Existing;
use sweepd::input::write::Addressed;
use sweepd::input::{Pacer, Speed};
use sweepd_core::wire::DATA_PORT;
use sweepd_lab::simulate::SimulatedDatagram;

/// Where the datagrams go, open.
pub enum Output {
    File(CaptureOutput),
    Network {
        sender: Sender,
        pacer: Pacer,
        start: Instant,
    },
}

impl Output {
    pub fn open(target: &Target, existing: Existing) -> Result<Self, CliError> {
        match (&target.pcap, target.to) {
            (Some(path), _) => Ok(Self::File(CaptureOutput::create(path, existing)?)),
            (None, Some(to)) => Ok(Self::Network {
                sender: Sender::new(to),
                pacer: Pacer::new(Speed::REALTIME),
                start: Instant::now(),
            }),
            (None, None) => Err(CliError::Usage(
                "expected --pcap FILE or --to ADDR:PORT".to_owned(),
            )),
        }
    }

    pub fn send(&mut self, sensor: usize, sent: &SimulatedDatagram) -> Result<(), CliError> {
        match self {
            Self::File(file) => file.write(&Addressed {
                arrival_ns: sent.arrival_ns,
                source: sent.source,
                destination: sent.destination,
                payload: &sent.payload,
            }),
            Self::Network {
                sender,
                pacer,
                start,
            } => {
                let wait = pacer.wait(sent.arrival_ns, start.elapsed().as_nanos() as u64);
                if !wait.is_zero() {
                    std::thread::sleep(wait);
                }
                let ip = (*sent.source.ip()).into();
                match sent.destination.port() {
                    DATA_PORT => sender.data(sensor, ip, &sent.payload),
                    _ => sender.position(ip, &sent.payload),
                }
            }
        }
    }

    pub fn finish(self) -> Result<(), CliError> {
        match self {
            Self::File(file) => file.finish(),
            Self::Network { .. } => Ok(()),
        }
    }
}
