//! The packets that are replayed, as a capture of their own: for a report of a fault.
//!
//! It gives the same sweeps, in the same order. So it begins with the position packets that were the
//! latest at `--start`, which have the hour of the sensor's stamps, and with a data packet of each
//! sensor, in the order in which the whole capture has the sensors. Where the time went on by
//! datagrams of others while the sensors were silent, an empty datagram has that time: it closes a
//! sweep.

use std::collections::BTreeMap;
use std::net::{IpAddr, Ipv4Addr};
use std::path::PathBuf;

use super::args::Args;
use crate::admission::{Admitted, MAX_SENSORS, Refused, Route};
use crate::cli::CliError;
use crate::cli::capture::CaptureOutput;
use crate::cli::play::When;
use crate::cli::stream::is_stdout;
use crate::input::Placed;
use crate::text::count_of;
use sweepd_core::wire::{DATA_PORT, Datagram};

/// Most packets of the opening, though times stand still.
const MAX_OPENING: usize = 16_384;
/// A sensor that is silent for less closes no sweep, nanoseconds.
const SILENCE_NS: i64 = 100_000_000;
/// Address of the first sensor of a bag, which has none: that of a new Velodyne. Others follow.
const FIRST_OF_BAG: Ipv4Addr = Ipv4Addr::new(192, 168, 1, 201);

/// The capture under way.
pub(super) struct Piece {
    path: PathBuf,
    out: CaptureOutput,
    /// From before the part, the latest of each address; the oldest first.
    positions: Vec<Kept>,
    /// The packets of the first [`SILENCE_NS`], with the number of the sensor where they are data.
    opening: Vec<(Option<usize>, Kept)>,
    /// Arrival of the last packet that was written.
    written_ns: Option<i64>,
    /// Arrival of the last datagram, if it is not written.
    other_ns: Option<i64>,
    data: u64,
    position: u64,
}

/// A packet.
struct Kept {
    datagram: Datagram<'static>,
    payload: Vec<u8>,
}

impl Kept {
    fn new(datagram: &Datagram<'_>) -> Self {
        Self {
            payload: datagram.payload.to_vec(),
            datagram: Datagram {
                payload: &[],
                ..*datagram
            },
        }
    }

    fn ip(&self) -> IpAddr {
        self.datagram.source.ip().to_canonical()
    }

    fn datagram(&self) -> Datagram<'_> {
        Datagram {
            payload: &self.payload,
            ..self.datagram
        }
    }
}

impl Piece {
    /// Begins it, if it is wanted.
    ///
    /// # Errors
    /// [`CliError`]: a file that exists or cannot be written.
    pub(super) fn create(args: &Args) -> Result<Option<Self>, CliError> {
        let Some(path) = &args.pcap else {
            return Ok(None);
        };
        Ok(Some(Self {
            path: path.clone(),
            out: CaptureOutput::create(path, args.output.existing())?,
            positions: Vec::new(),
            opening: Vec::new(),
            written_ns: None,
            other_ns: None,
            data: 0,
            position: 0,
        }))
    }

    /// Takes a datagram up to the end of the part.
    ///
    /// # Errors
    /// [`CliError`].
    pub(super) fn take(
        &mut self,
        placed: &Placed<'_>,
        when: When,
        admitted: &Admitted<'_>,
    ) -> Result<(), CliError> {
        let mut datagram = placed.datagram;
        match admitted {
            Ok((Route::Position(_), _)) if when == When::Before => self.keep(Kept::new(&datagram)),
            _ if when == When::Before => {}
            Ok((Route::Position(_), _)) => {
                self.position += 1;
                self.add(&datagram, None)?;
            }
            Ok((Route::Data(sensor), _))
            | Err(Refused {
                sensor: Some(sensor),
                ..
            }) => {
                if placed.topic.is_some() {
                    let ip = Ipv4Addr::from_bits(FIRST_OF_BAG.to_bits() + *sensor as u32);
                    datagram.source = (ip, DATA_PORT).into();
                }
                self.data += 1;
                self.add(&datagram, admitted.is_ok().then_some(*sensor))?;
            }
            Err(_) => self.other_ns = Some(datagram.arrival_ns),
        }
        Ok(())
    }

    fn keep(&mut self, position: Kept) {
        let ip = position.ip();
        self.positions.retain(|kept| kept.ip() != ip);
        if self.positions.len() == MAX_SENSORS {
            self.positions.remove(0);
        }
        self.positions.push(position);
    }

    /// Adds a packet of the part; of data, with the number of its sensor.
    fn add(&mut self, datagram: &Datagram<'_>, sensor: Option<usize>) -> Result<(), CliError> {
        let begun_ns = match self.opening.first() {
            Some((_, first)) => first.datagram.arrival_ns,
            None => datagram.arrival_ns,
        };
        let is_opening = self.written_ns.is_none()
            && self.opening.len() < MAX_OPENING
            && datagram.arrival_ns.abs_diff(begun_ns) < SILENCE_NS as u64;
        if is_opening {
            self.opening.push((sensor, Kept::new(datagram)));
            return Ok(());
        }
        self.open()?;
        self.write(datagram)
    }

    /// Writes what is held back: positions, the first data packet of each sensor, all others.
    fn open(&mut self) -> Result<(), CliError> {
        self.position += self.positions.len() as u64;
        let mut packets = std::mem::take(&mut self.positions);
        let mut firsts = BTreeMap::new();
        let mut others = Vec::new();
        for (sensor, packet) in std::mem::take(&mut self.opening) {
            self.written_ns = Some(packet.datagram.arrival_ns);
            match sensor.filter(|sensor| !firsts.contains_key(sensor)) {
                Some(sensor) => drop(firsts.insert(sensor, packet)),
                None => others.push(packet),
            }
        }
        packets.extend(firsts.into_values().chain(others));
        for packet in packets {
            self.out.write_datagram(&packet.datagram())?;
        }
        Ok(())
    }

    /// Writes a packet, behind the time of others where it was long in coming.
    fn write(&mut self, datagram: &Datagram<'_>) -> Result<(), CliError> {
        let written_ns = self.written_ns.replace(datagram.arrival_ns);
        if let Some((other_ns, written_ns)) = self.other_ns.take().zip(written_ns)
            && other_ns.saturating_sub(written_ns) > SILENCE_NS
        {
            self.out.write_datagram(&Datagram {
                arrival_ns: other_ns,
                payload: &[],
                ..*datagram
            })?;
        }
        self.out.write_datagram(datagram)
    }

    /// Completes it, and says what is in it; one without data packets is removed.
    ///
    /// # Errors
    /// [`CliError`].
    pub(super) fn finish(mut self) -> Result<Option<String>, CliError> {
        if self.data == 0 && !is_stdout(&self.path) {
            return Ok(None);
        }
        self.open()?;
        self.out.finish()?;
        let data = count_of(self.data, "data packet");
        let position = count_of(self.position, "position packet");
        let place = match is_stdout(&self.path) {
            true => "standard output".into(),
            false => self.path.display().to_string(),
        };
        Ok(Some(format!("{data}, {position} to {place}")))
    }
}
