//! Bare packets: the payloads of a sensor one after another, without capture records, as
//! `tshark` and "Follow UDP Stream" of Wireshark save them.
//!
//! ```text
//! file | data packet, 1206 bytes | data packet | position packet, 512 bytes | data packet | ...
//! ```
//!
//! The address of the sensor and the time of arrival are lost. The clock of the sensor gives the
//! time since the top of an unknown hour, which stands for the first of 1970.

use std::net::{Ipv4Addr, SocketAddr};

use super::error::{CaptureError, Damage, Place, Stop, Truncation};
use super::source::Opened;
use super::times::{SensorClock, sensor_us};
use sweepd_core::wire::data::{DATA_PACKET_LEN, FLAGS};
use sweepd_core::wire::position::{POSITION_PACKET_LEN, Position};
use sweepd_core::wire::{DATA_PORT, Datagram, HOUR_US, POSITION_PORT};

/// A position packet begins with so many zeros.
const ZEROS: [u8; 14] = [0; 14];

/// A file of bare packets, packet by packet.
pub(super) struct Payloads {
    opened: Opened,
    packet: [u8; DATA_PACKET_LEN],
    /// Bytes of the current packet; 0 if there is none.
    len: usize,
    packets: u64,
    /// At the last data packet.
    clock: Option<SensorClock>,
    time_ns: i64,
    ended: bool,
    truncation: Option<Truncation>,
}

impl Payloads {
    /// Whether what was opened begins with a packet. What begins with zeros is read up to the end of
    /// a position packet.
    ///
    /// # Errors
    /// [`CaptureError`]: it cannot be read.
    pub(super) fn is_in(opened: &mut Opened) -> Result<bool, CaptureError> {
        if opened.head.starts_with(&ZEROS) {
            opened.read_on(POSITION_PACKET_LEN)?;
        }
        Ok(is_data(&opened.head) || is_position(&opened.head))
    }

    /// Reads on from the first bytes.
    pub(super) fn over(mut opened: Opened) -> Self {
        opened.input.unread(&opened.head);
        Self {
            opened,
            packet: [0; DATA_PACKET_LEN],
            len: 0,
            packets: 0,
            clock: None,
            time_ns: 0,
            ended: false,
            truncation: None,
        }
    }

    /// Goes on to the next packet. `false` at the end.
    ///
    /// # Errors
    /// [`CaptureError::Read`]. After that, `false`.
    pub(super) fn advance(&mut self) -> Result<bool, CaptureError> {
        self.len = 0;
        if self.ended {
            return Ok(false);
        }
        let place = Place::Byte(self.opened.input.offset());
        match self.read() {
            Ok(len) if len > 0 => {
                self.len = len;
                self.packets += 1;
                return Ok(true);
            }
            Ok(_) => {}
            Err(Stop::Damaged(reason)) => {
                self.truncation = Some(Truncation {
                    record: self.packets,
                    place,
                    reason,
                });
            }
            Err(Stop::Read(source)) => {
                self.ended = true;
                return Err(CaptureError::Read {
                    name: self.opened.name.clone(),
                    record: self.packets,
                    place,
                    source,
                });
            }
        }
        self.ended = true;
        Ok(false)
    }

    /// Reads a packet, and gives its length; 0 at the end.
    fn read(&mut self) -> Result<usize, Stop> {
        let (position, rest) = self.packet.split_at_mut(POSITION_PACKET_LEN);
        if !self.opened.input.begin(position)? {
            return Ok(0);
        }
        if !is_data(position) {
            if !is_position(position) {
                return Err(Damage::BagRecord { what: "packet" }.into());
            }
            // The first data packet begins the clock.
            if let (None, Ok(position)) = (self.clock, Position::parse(position)) {
                self.time_ns = i64::from(position.stamp_us) * 1000;
            }
            return Ok(POSITION_PACKET_LEN);
        }
        self.opened.input.fill_whole(rest)?;
        if let Some(stamp_us) = sensor_us(&self.packet) {
            let begun = SensorClock::new(i64::from(stamp_us) * 1000, stamp_us);
            self.time_ns = self.clock.get_or_insert(begun).advance(stamp_us);
        }
        Ok(DATA_PACKET_LEN)
    }

    /// The current packet, as a datagram of no address.
    pub(super) fn datagram(&self) -> Datagram<'_> {
        let port = match self.len {
            POSITION_PACKET_LEN => POSITION_PORT,
            _ => DATA_PORT,
        };
        Datagram {
            arrival_ns: self.time_ns,
            source: SocketAddr::from((Ipv4Addr::UNSPECIFIED, port)),
            destination_port: port,
            payload: &self.packet[..self.len],
        }
    }

    pub(super) fn truncation(&self) -> Option<&Truncation> {
        self.truncation.as_ref()
    }

    pub(super) fn name(&self) -> &str {
        &self.opened.name
    }
}

/// Whether a data packet begins so.
fn is_data(bytes: &[u8]) -> bool {
    let flag = bytes.first_chunk().map(|flag| u16::from_le_bytes(*flag));
    flag.is_some_and(|flag| FLAGS.contains(&flag))
}

/// Whether this is a position packet: it has the sentence of a receiver, or at least a stamp. Stamps begin
/// anew a little after the hour.
fn is_position(bytes: &[u8]) -> bool {
    Position::parse(bytes).is_ok_and(|position| {
        let has_sentence = position.nmea.is_some_and(|text| text.starts_with('$'));
        has_sentence
            || bytes.starts_with(&ZEROS) && (1..HOUR_US + 1_000_000).contains(&position.stamp_us)
    })
}
