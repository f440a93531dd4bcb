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
use sweepd_core::wire::data::{DATA_PACKET_LEN, FLAG_BANK_0, FLAGS};
use sweepd_core::wire::position::POSITION_PACKET_LEN;
use sweepd_core::wire::{DATA_PORT, Datagram, POSITION_PORT};

/// Where the sentence of the receiver stands in a position packet (VLP-16 User Manual, section 9.3).
const SENTENCE_AT: usize = 206;

/// A file of bare packets, packet by packet.
pub(super) struct Payloads {
    opened: Opened,
    packet: [u8; DATA_PACKET_LEN],
    /// Bytes of the current packet; 0 if there is none.
    len: usize,
    packets: u64,
    /// At the last data packet.
    clock: Option<SensorClock>,
    ended: bool,
    truncation: Option<Truncation>,
}

impl Payloads {
    /// Whether bare packets begin with these bytes.
    pub(super) fn is_magic(head: &[u8]) -> bool {
        head.starts_with(&FLAG_BANK_0.to_le_bytes())
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
        let flag = u16::from_le_bytes([position[0], position[1]]);
        if !FLAGS.contains(&flag) {
            if !position[SENTENCE_AT..].starts_with(b"$") && position[0] != 0 {
                return Err(Damage::BagRecord { what: "packet" }.into());
            }
            return Ok(POSITION_PACKET_LEN);
        }
        self.opened.input.fill_whole(rest)?;
        if let Some(stamp_us) = sensor_us(&self.packet) {
            let begun = SensorClock::new(i64::from(stamp_us) * 1000, stamp_us);
            self.clock.get_or_insert(begun).advance(stamp_us);
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
            arrival_ns: self.clock.map_or(0, |clock| clock.time_ns),
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
