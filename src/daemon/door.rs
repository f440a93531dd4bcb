//! What a port lets in: packets of the right length, with the right markers, of a sensor that is configured.
//!
//! What is a packet says [`Kind`], here as at the [`Gate`](crate::capture::Gate) of who does not know the sensors beforehand.
//! A daemon does: this door remembers nobody, and a sensor that comes back from another port, for the hundredth time in
//! months, is the same sensor.

use std::net::{IpAddr, SocketAddr};

use super::config::SensorConfig;
use super::counters::Reject;
use crate::capture::gate::{Kind, Misfit};
use crate::wire::Datagram;

/// What is let in.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Admitted {
    /// A data packet of this sensor of the port, by its place among them.
    Data(usize),
    /// A position packet of all sensors at its address, on whichever port their data come.
    Position(IpAddr),
}

/// The sensors whose packets are let in.
#[derive(Clone, Debug)]
pub struct Door {
    here: Vec<(IpAddr, Option<u16>)>,
    elsewhere: Vec<IpAddr>,
}

impl Door {
    /// A door of a port for `here`, the sensors whose data come in through it, and the position packets of `all`.
    pub fn new<'a>(
        here: impl IntoIterator<Item = &'a SensorConfig>,
        all: impl IntoIterator<Item = &'a SensorConfig>,
    ) -> Self {
        let here = here.into_iter().map(|sensor| (sensor.address.to_canonical(), sensor.source_port)).collect();
        Self { here, elsewhere: all.into_iter().map(|sensor| sensor.address.to_canonical()).collect() }
    }

    /// Whose packet a datagram is.
    ///
    /// # Errors
    /// Why it is not let in.
    pub fn admit(&self, datagram: &Datagram<'_>) -> Result<Admitted, Reject> {
        let source = SocketAddr::new(datagram.source.ip().to_canonical(), datagram.source.port());
        match Kind::of(datagram.payload) {
            Ok(Kind::Data) => self.data(source),
            Ok(Kind::Position) if self.knows(source.ip()) => Ok(Admitted::Position(source.ip())),
            Ok(Kind::Position) => Err(Reject::Source),
            Err(Misfit::Length) => Err(Reject::Length),
            Err(Misfit::Marker) => Err(Reject::Marker),
            Err(Misfit::Azimuth) => Err(Reject::Azimuth),
        }
    }

    /// The sensor of this port that sends from there, by its place among them.
    pub fn owner(&self, source: SocketAddr) -> Option<usize> {
        let (from, from_port) = (source.ip().to_canonical(), source.port());
        self.here.iter().position(|&(ip, port)| ip == from && port.is_none_or(|port| port == from_port))
    }

    fn data(&self, source: SocketAddr) -> Result<Admitted, Reject> {
        match self.owner(source) {
            Some(index) => Ok(Admitted::Data(index)),
            None if self.here.iter().all(|&(ip, _)| ip != source.ip()) && self.knows(source.ip()) => Err(Reject::Port),
            None => Err(Reject::Source),
        }
    }

    fn knows(&self, ip: IpAddr) -> bool {
        self.elsewhere.contains(&ip)
    }
}

#[cfg(test)]
mod tests {
    use super::super::testing::sensor;
    use super::*;
    use crate::wire::DataPacket;
    use crate::wire::data::DATA_PACKET_LEN;
    use crate::wire::position::POSITION_PACKET_LEN;
    use proptest::prelude::*;

    fn admit(door: &Door, source: &str, payload: &[u8]) -> Result<Admitted, Reject> {
        door.admit(&Datagram { arrival_ns: 5, source: source.parse().unwrap(), destination_port: 2368, payload })
    }

    fn door() -> Door {
        let [mut left, mut right] = ["left", "right"].map(|name| sensor(name, "10.0.0.1", 2368));
        (left.source_port, right.source_port) = (Some(4000), Some(4001));
        let (roof, rear) = (sensor("roof", "10.0.0.2", 2368), sensor("rear", "10.0.0.3", 2369));
        Door::new([&left, &right, &roof], [&left, &right, &roof, &rear])
    }

    #[test]
    fn only_packets_of_configured_sensors_get_in_and_the_others_have_a_reason() {
        let (door, packet) = (door(), DataPacket::new(0, 0x37, 0x22));
        let mut broken = packet;
        broken.blocks[7].flag.set(0x1234);
        let mut beyond = packet;
        beyond.blocks[2].set_azimuth_cdeg(36_001);
        let (data, position) = (packet.emit(), &[0; POSITION_PACKET_LEN]);
        let cases = [
            ("10.0.0.1:4000", data, Ok(Admitted::Data(0))),
            ("10.0.0.1:4001", data, Ok(Admitted::Data(1))),
            ("10.0.0.1:4002", data, Err(Reject::Source)),
            ("10.0.0.2:9", data, Ok(Admitted::Data(2))),
            ("[::ffff:10.0.0.2]:9", data, Ok(Admitted::Data(2))),
            ("10.0.0.3:9", data, Err(Reject::Port)),
            ("10.0.0.4:9", data, Err(Reject::Source)),
            ("10.0.0.2:9", broken.emit(), Err(Reject::Marker)),
            ("10.0.0.4:9", broken.emit(), Err(Reject::Marker)),
            ("10.0.0.2:9", beyond.emit(), Err(Reject::Azimuth)),
            ("10.0.0.2:9", &data[1..], Err(Reject::Length)),
            ("10.0.0.2:9", b"", Err(Reject::Length)),
            ("10.0.0.1:8308", position, Ok(Admitted::Position([10, 0, 0, 1].into()))),
            ("10.0.0.3:8308", position, Ok(Admitted::Position([10, 0, 0, 3].into()))),
            ("10.0.0.4:8308", position, Err(Reject::Source)),
        ];
        for (source, payload, expected) in cases {
            assert_eq!(admit(&door, source, payload), expected, "{source}, {} bytes", payload.len());
        }
    }

    proptest! {
        #[test]
        fn random_data_never_get_in(
            len in prop_oneof![Just(DATA_PACKET_LEN), 0..1300_usize], seed in any::<u64>(), host in 0_u8..6,
        ) {
            prop_assume!(len != POSITION_PACKET_LEN);
            let mut rng = fastrand::Rng::with_seed(seed);
            let payload: Vec<u8> = (0..len).map(|_| rng.u8(..)).collect();
            let source = format!("10.0.0.{host}:4000");
            prop_assert!(admit(&door(), &source, &payload).is_err());
        }
    }
}
