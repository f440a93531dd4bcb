//! What gets in: packets of sensors, and of nobody else.

use std::net::SocketAddr;

use super::sensors::SensorFilter;
use sweepd_core::wire::data::DATA_PACKET_LEN;
use sweepd_core::wire::position::POSITION_PACKET_LEN;
use sweepd_core::wire::{DataPacket, Datagram, PacketError};

/// Most senders that a [`Gate`] knows by name.
pub const MAX_SENDERS: usize = 64;

/// What a datagram is, by its length and markers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// A data packet.
    Data,
    /// As long as a position packet, which has no marker.
    Position,
}

/// Why a datagram is no packet.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Misfit {
    /// Neither as long as a data packet nor as a position packet.
    Length,
    /// As long as a data packet, but a block begins with no marker.
    Marker,
    /// A data packet with an azimuth beyond the turn.
    Azimuth,
}

impl Kind {
    /// What a payload is.
    ///
    /// # Errors
    /// [`Misfit`]: why it is no packet.
    pub fn of(payload: &[u8]) -> Result<Self, Misfit> {
        match payload.len() {
            DATA_PACKET_LEN => match DataPacket::parse(payload) {
                Ok(_) => Ok(Self::Data),
                Err(PacketError::Azimuth { .. }) => Err(Misfit::Azimuth),
                Err(PacketError::Flag { .. } | PacketError::Length { .. }) => Err(Misfit::Marker),
            },
            POSITION_PACKET_LEN => Ok(Self::Position),
            _ => Err(Misfit::Length),
        }
    }
}

/// Stands between a socket and who does not know its sensors beforehand, such as `sweepd record`:
/// packets get in, of all senders or of those that were selected, and the others change nothing but
/// a counter. (The daemon knows its sensors, and has a [door](crate::daemon::door) that asks no
/// less of a packet.)
///
/// However many senders there are, all get in; the first [`MAX_SENDERS`] are known by name.
#[derive(Debug, Default)]
pub struct Gate {
    filters: Vec<SensorFilter>,
    senders: Vec<Sender>,
    others: u64,
    positions: u64,
    refused: Refused,
}

/// A sender of data packets.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Sender {
    /// Where it sends from; an IPv4 address in IPv6 clothes is undressed.
    pub source: SocketAddr,
    /// The port that it sends data to.
    pub destination_port: u16,
    /// Data packets of it that were let in.
    pub packets: u64,
}

/// What was let in.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Entry {
    /// A data packet of this sender, by its place in [`Gate::senders`]; of one of the many others,
    /// if there is none.
    Data(Option<usize>),
    /// A position packet.
    Position,
}

/// How many datagrams were not let in.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Refused {
    /// [`Misfit::Length`].
    pub length: u64,
    /// [`Misfit::Marker`].
    pub marker: u64,
    /// [`Misfit::Azimuth`].
    pub azimuth: u64,
    /// Packets from who was not selected.
    pub source: u64,
}

impl Refused {
    /// All of them.
    pub fn total(&self) -> u64 {
        self.length + self.marker + self.azimuth + self.source
    }
}

impl std::ops::AddAssign for Refused {
    fn add_assign(&mut self, more: Self) {
        self.length += more.length;
        self.marker += more.marker;
        self.azimuth += more.azimuth;
        self.source += more.source;
    }
}

impl Gate {
    /// A gate for the sensors that match one of `filters`; for all, if there are none.
    pub fn new(filters: Vec<SensorFilter>) -> Self {
        Self {
            filters,
            ..Self::default()
        }
    }

    /// What of whom a datagram is; `None` if it is not let in.
    pub fn admit(&mut self, datagram: &Datagram<'_>) -> Option<Entry> {
        let source = SocketAddr::new(datagram.source.ip().to_canonical(), datagram.source.port());
        let kind = Kind::of(datagram.payload);
        let is_selected = |filter: &SensorFilter| match kind {
            Ok(Kind::Data) => filter.matches(source, datagram.destination_port),
            // They come from a port of their own.
            _ => filter.matches_ip(source.ip()),
        };
        match kind {
            Err(Misfit::Length) => self.refused.length += 1,
            Err(Misfit::Marker) => self.refused.marker += 1,
            Err(Misfit::Azimuth) => self.refused.azimuth += 1,
            Ok(_) if !self.filters.is_empty() && !self.filters.iter().any(is_selected) => {
                self.refused.source += 1
            }
            Ok(Kind::Data) => {
                return Some(Entry::Data(self.note(source, datagram.destination_port)));
            }
            Ok(Kind::Position) => {
                self.positions += 1;
                return Some(Entry::Position);
            }
        }
        None
    }

    /// The senders of data packets in the order in which they were first heard, at most
    /// [`MAX_SENDERS`].
    pub fn senders(&self) -> &[Sender] {
        &self.senders
    }

    /// Data packets of all other senders that were let in.
    pub fn others(&self) -> u64 {
        self.others
    }

    /// Position packets that were let in.
    pub fn positions(&self) -> u64 {
        self.positions
    }

    /// Datagrams that were not let in, by reason.
    pub fn refused(&self) -> Refused {
        self.refused
    }

    fn note(&mut self, source: SocketAddr, destination_port: u16) -> Option<usize> {
        let is_it = |sender: &Sender| {
            sender.source == source && sender.destination_port == destination_port
        };
        let known = self.senders.iter().position(is_it);
        let index = known.or_else(|| {
            let is_new = self.senders.len() < MAX_SENDERS;
            is_new.then(|| {
                self.senders.push(Sender {
                    source,
                    destination_port,
                    packets: 0,
                });
                self.senders.len() - 1
            })
        });
        match index {
            Some(index) => self.senders[index].packets += 1,
            None => self.others += 1,
        }
        index
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const OWN: &str = "192.168.1.201:2368";

    fn admit(gate: &mut Gate, source: &str, payload: &[u8]) -> Option<Entry> {
        gate.admit(&Datagram {
            arrival_ns: 5,
            source: source.parse().unwrap(),
            destination_port: 2368,
            payload,
        })
    }

    #[test]
    fn only_packets_of_the_sensor_get_in_and_the_others_are_counted_by_reason() {
        let mut gate = Gate::new(vec!["192.168.1.201".parse().unwrap()]);
        let packet = DataPacket::new(0, 0x37, 0x22);
        let [mut broken, mut beyond] = [packet; 2];
        broken.blocks[7].flag.set(0x1234);
        beyond.blocks[2].set_azimuth_cdeg(36_001);
        assert_eq!(
            admit(&mut gate, OWN, packet.emit()),
            Some(Entry::Data(Some(0)))
        );
        assert_eq!(
            admit(&mut gate, "[::ffff:192.168.1.201]:2368", packet.emit()),
            Some(Entry::Data(Some(0)))
        );
        assert_eq!(
            admit(&mut gate, "192.168.1.201:8308", &[0; POSITION_PACKET_LEN]),
            Some(Entry::Position)
        );
        let position = [0; POSITION_PACKET_LEN];
        let refused: [(&str, &[u8]); 8] = [
            (OWN, broken.emit()),
            (OWN, beyond.emit()),
            (OWN, &packet.emit()[1..]),
            (OWN, b""),
            ("192.168.1.202:2368", packet.emit()),
            ("192.168.1.202:8308", &position),
            ("192.168.1.202:2368", broken.emit()),
            ("192.168.1.202:2368", beyond.emit()),
        ];
        for (source, payload) in refused {
            assert_eq!(
                admit(&mut gate, source, payload),
                None,
                "{source}, {} bytes",
                payload.len()
            );
        }
        assert_eq!(
            gate.refused(),
            Refused {
                length: 2,
                marker: 2,
                azimuth: 2,
                source: 2
            }
        );
        assert_eq!(
            (gate.positions(), gate.others(), gate.refused().total()),
            (1, 0, 8)
        );
        let [sender] = gate.senders() else {
            panic!("{:?}", gate.senders())
        };
        assert_eq!((sender.source, sender.packets), (OWN.parse().unwrap(), 2));
    }

    #[test]
    fn a_sensor_gets_in_however_many_sent_before_it() {
        let (mut gate, packet) = (Gate::default(), DataPacket::new(0, 0x37, 0x22));
        for port in 0..1000 {
            assert!(admit(&mut gate, &format!("10.0.0.1:{port}"), packet.emit()).is_some());
        }
        assert_eq!(
            admit(&mut gate, OWN, packet.emit()),
            Some(Entry::Data(None))
        );
        assert_eq!(
            (gate.senders().len(), gate.others()),
            (MAX_SENDERS, 1001 - MAX_SENDERS as u64)
        );
        assert_eq!(
            admit(&mut gate, "10.0.0.1:63", packet.emit()),
            Some(Entry::Data(Some(63)))
        );
    }

    proptest! {
        #[test]
        fn random_datagrams_change_nothing_but_a_counter(
            len in prop_oneof![Just(DATA_PACKET_LEN), 0..1300_usize], seed in any::<u64>(), port in any::<u16>(),
        ) {
            let mut gate = Gate::new(vec!["192.168.1.201".parse().unwrap()]);
            prop_assert!(admit(&mut gate, OWN, DataPacket::new(0, 0x37, 0x22).emit()).is_some());
            let mut rng = fastrand::Rng::with_seed(seed);
            let payload: Vec<u8> = (0..len).map(|_| rng.u8(..)).collect();
            let source = format!("192.168.1.77:{port}");
            prop_assert_eq!(admit(&mut gate, &source, &payload), None);
            prop_assert_eq!((gate.refused().total(), gate.senders().len(), gate.senders()[0].packets), (1, 1, 1));
        }
    }
}
