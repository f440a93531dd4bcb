//! Distinguishes unknown sensors by their packets, and numbers them.
//!
//! A sensor is a sender of data packets: its address and port, and the port that it sends to. The
//! length of a datagram decides what it is, 1206 bytes for data or 512 for position, since bridges
//! and port forwards mix the ports. In a bag a topic is a sender.

use std::net::SocketAddr;

use serde::{Deserialize, Serialize};

use super::{Admitted, Refusal, RefusalCounts, Refused, Route, SensorFilter, SensorSet, canonical};
use sweepd_core::wire::data::{FLAG_BANK_0, FLAG_BANK_1};
use sweepd_core::wire::{Content, DataPacket, Datagram, Packet};

/// Most sensors that are distinguished: more are a mistake or an attack.
pub const MAX_SENSORS: usize = 64;

/// A sender of data packets.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Sender {
    /// Where it sends from; an IPv4 address mapped into IPv6 is given as IPv4.
    pub source: SocketAddr,
    /// The port that it sends data to.
    pub destination_port: u16,
    /// Its name in output: `192.168.1.201:2368`, and `192.168.1.201:2368>2369` for a later one from
    /// the same port. Of a bag, the topic: `/velodyne_packets`.
    pub name: String,
    /// Data packets of it.
    pub packets: u64,
    /// Its datagrams of the length of a data packet that are not one.
    pub malformed: u64,
}

impl Sender {
    /// Whether a filter selects it.
    pub fn is_selected_by(&self, filter: &SensorFilter) -> bool {
        filter.matches(self.source, self.destination_port) || filter.matches_topic(&self.name)
    }

    /// Where its packets come from, for people.
    pub fn origin(&self) -> String {
        if self.name.starts_with('/') {
            return self.name.clone();
        }
        format!("{} to port {}", self.source, self.destination_port)
    }
}

/// The senders so far, numbered from 0 in the order of their first packets. Uses neither time nor
/// model, and only the parts of packets that distinguish senders.
#[derive(Debug, Default)]
pub struct DiscoveredSensors {
    filters: Vec<SensorFilter>,
    senders: Vec<Sender>,
    /// At most one for each address and [`MAX_SENSORS`] in all, the least recent first.
    kept: Vec<KeptPosition>,
    positions: u64,
    refusals: RefusalCounts,
}

/// The latest position packet of an address.
#[derive(Debug)]
struct KeptPosition {
    source: SocketAddr,
    destination_port: u16,
    packet: Packet<'static>,
}

impl DiscoveredSensors {
    /// No sensors yet. Only those that match one of `filters` are admitted; all, if there are no
    /// filters.
    pub fn new(filters: Vec<SensorFilter>) -> Self {
        Self {
            filters,
            ..Self::default()
        }
    }

    /// Reads a datagram and determines its sensor. A new sensor gets the next number; call
    /// [`DiscoveredSensors::position`] then. A position packet may be of several sensors. If it is
    /// of none yet, it is kept for the first.
    ///
    /// # Errors
    /// [`Refused`]: it is not a packet, or not of a selected sensor. With [`Refusal::TooMany`] it
    /// is a valid packet.
    pub fn admit<'a>(&mut self, datagram: &Datagram<'a>) -> Admitted<'a> {
        self.admit_from(datagram, None)
    }

    /// As [`DiscoveredSensors::admit`], of a datagram that may come from a topic of a bag.
    ///
    /// # Errors
    /// As there.
    pub fn admit_from<'a>(&mut self, datagram: &Datagram<'a>, topic: Option<&str>) -> Admitted<'a> {
        let admitted = self.find(datagram, topic);
        match &admitted {
            Ok((Route::Data(index), _)) => self.senders[*index].packets += 1,
            Ok((Route::Position(_), _)) => self.positions += 1,
            Err(refused) => {
                self.refusals.add(refused.reason);
                if let Some(index) = refused.sensor {
                    self.senders[index].malformed += 1;
                }
            }
        }
        admitted
    }

    /// Reads a datagram, counts it, and says whether a recording of these sensors contains it.
    /// Packets of sensors beyond [`MAX_SENSORS`] are recorded too.
    pub fn is_recorded(&mut self, datagram: &Datagram<'_>) -> bool {
        match self.admit(datagram) {
            Ok(_) => true,
            Err(refused) => refused.reason == Refusal::TooMany,
        }
    }

    /// All senders, by number.
    pub fn senders(&self) -> &[Sender] {
        &self.senders
    }

    /// The latest position packet from the sensor's address, without the text of its sentence; it may have come
    /// before the first data packet. `None` if it is another sensor's.
    ///
    /// # Panics
    /// If there is no sender of this number.
    pub fn position(&self, index: usize) -> Option<&Packet<'static>> {
        let ip = self.senders[index].source.ip();
        let kept = self.kept.iter().find(|kept| kept.source.ip() == ip)?;
        self.may_have_sent(kept.source, kept.destination_port)
            .find(|&own| own == index)?;
        Some(&kept.packet)
    }

    /// Position packets of all senders.
    pub fn positions(&self) -> u64 {
        self.positions
    }

    /// How many datagrams were refused, by reason.
    pub fn refusals(&self) -> RefusalCounts {
        self.refusals
    }

    /// How many datagrams belonged to no sensor.
    pub fn others(&self) -> u64 {
        let malformed: u64 = self.senders.iter().map(|sender| sender.malformed).sum();
        self.refusals.total() - malformed
    }

    fn find<'a>(&mut self, datagram: &Datagram<'a>, topic: Option<&str>) -> Admitted<'a> {
        let source = canonical(datagram.source);
        let known = self.known(source, datagram.destination_port);
        let packet = datagram.parse().map_err(|error| {
            let reason = Refusal::from(error);
            Refused {
                reason,
                sensor: known.filter(|_| reason != Refusal::Length),
            }
        })?;
        let route = match &packet.content {
            Content::Data(data) => match known {
                Some(index) => Route::Data(index),
                None => {
                    let port = datagram.destination_port;
                    Route::Data(self.discover(source, port, topic, data)?)
                }
            },
            Content::Position(..) => {
                self.keep(source, datagram.destination_port, &packet)?;
                Route::Position(self.may_have_sent(source, datagram.destination_port))
            }
        };
        Ok((route, packet))
    }

    fn known(&self, source: SocketAddr, destination_port: u16) -> Option<usize> {
        self.senders.iter().position(|sender| {
            sender.source == source && sender.destination_port == destination_port
        })
    }

    fn discover(
        &mut self,
        source: SocketAddr,
        destination_port: u16,
        topic: Option<&str>,
        packet: &DataPacket,
    ) -> Result<usize, Refused> {
        // Packets of all models begin with one of these; a damaged packet must not create a sensor.
        if !matches!(packet.blocks[0].flag.get(), FLAG_BANK_0 | FLAG_BANK_1) {
            return Err(Refusal::Marker.into());
        }
        let is_selected = self.filters.iter().any(|filter| match topic {
            Some(topic) => filter.matches_topic(topic),
            None => filter.matches(source, destination_port),
        });
        if !is_selected && !self.filters.is_empty() {
            return Err(Refusal::Source.into());
        }
        if self.senders.len() == MAX_SENSORS {
            return Err(Refusal::TooMany.into());
        }
        let shares_source = self.senders.iter().any(|sender| sender.source == source);
        let name = match topic {
            Some(topic) => topic.to_owned(),
            None if shares_source => format!("{source}>{destination_port}"),
            None => source.to_string(),
        };
        self.senders.push(Sender {
            source,
            destination_port,
            name,
            packets: 0,
            malformed: 0,
        });
        Ok(self.senders.len() - 1)
    }

    /// Keeps a position packet for sensors without data packets so far.
    fn keep(
        &mut self,
        source: SocketAddr,
        destination_port: u16,
        packet: &Packet<'_>,
    ) -> Result<(), Refused> {
        let ip = source.ip();
        if !self.filters.is_empty() && !self.filters.iter().any(|filter| filter.matches_ip(ip)) {
            return Err(Refusal::Source.into());
        }
        let Some(packet) = packet.without_text() else {
            return Ok(());
        };
        if let Some(at) = self.kept.iter().position(|kept| kept.source.ip() == ip) {
            self.kept.remove(at);
        } else if self.kept.len() == MAX_SENSORS {
            self.kept.remove(0);
        }
        self.kept.push(KeptPosition {
            source,
            destination_port,
            packet,
        });
        Ok(())
    }

    /// The sensors that a position packet may be of: all at its address, unless its ports are those
    /// of the data of one of them. There are several on one computer, or behind a router.
    fn may_have_sent(&self, source: SocketAddr, destination_port: u16) -> SensorSet {
        let mut all = SensorSet::default();
        let mut by_source = SensorSet::default();
        let mut by_destination = SensorSet::default();
        for (index, sender) in self.senders.iter().enumerate() {
            if sender.source.ip() != source.ip() {
                continue;
            }
            all.insert(index);
            if sender.source == source {
                by_source.insert(index);
            }
            if sender.destination_port == destination_port {
                by_destination.insert(index);
            }
        }
        [by_source, by_destination]
            .into_iter()
            .find(|set| set.len() == 1)
            .unwrap_or(all)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use sweepd_core::wire::data::DATA_PACKET_LEN;
    use sweepd_core::wire::position::POSITION_PACKET_LEN;

    fn position(stamp_us: u32) -> [u8; POSITION_PACKET_LEN] {
        let mut bytes = [0; POSITION_PACKET_LEN];
        bytes[0xC6..0xCA].copy_from_slice(&stamp_us.to_le_bytes());
        bytes
    }

    fn packet() -> DataPacket {
        DataPacket::new(0, 0x37, 0x22)
    }

    fn datagram<'a>(source: &str, destination_port: u16, payload: &'a [u8]) -> Datagram<'a> {
        Datagram {
            arrival_ns: 5,
            source: source.parse().unwrap(),
            destination_port,
            payload,
        }
    }

    fn indices(admitted: Admitted<'_>) -> Vec<usize> {
        match admitted.unwrap().0 {
            Route::Data(index) => vec![index],
            Route::Position(set) => set.collect(),
        }
    }

    fn reason(admitted: Admitted<'_>) -> Refusal {
        admitted.unwrap_err().reason
    }

    #[test]
    fn sensors_are_distinguished_by_source_and_destination_and_named() {
        let packet = packet();
        let mut sensors = DiscoveredSensors::default();
        let mut heard =
            |source: &str, port| indices(sensors.admit(&datagram(source, port, packet.emit())))[0];
        assert_eq!(heard("192.168.1.201:2368", 2368), 0);
        assert_eq!(heard("192.168.1.202:2368", 2368), 1);
        assert_eq!(heard("192.168.1.201:2368", 2369), 2);
        assert_eq!(heard("192.168.1.201:443", 2368), 3);
        assert_eq!(heard("[fe80::1]:2368", 2368), 4);
        assert_eq!(heard("[::ffff:192.168.1.202]:2368", 2368), 1);
        let names: Vec<&str> = sensors
            .senders()
            .iter()
            .map(|sensor| &sensor.name[..])
            .collect();
        let expected = [
            "192.168.1.201:2368",
            "192.168.1.202:2368",
            "192.168.1.201:2368>2369",
            "192.168.1.201:443",
            "[fe80::1]:2368",
        ];
        assert_eq!(names, expected);
    }

    #[test]
    fn length_decides_for_any_port() {
        let (packet, position) = (packet(), [7; POSITION_PACKET_LEN]);
        let mut sensors = DiscoveredSensors::default();
        assert_eq!(
            indices(sensors.admit(&datagram("10.0.0.1:8308", 8308, packet.emit()))),
            [0]
        );
        assert_eq!(
            indices(sensors.admit(&datagram("10.0.0.1:2368", 2368, &position))),
            [0]
        );
        assert_eq!(
            reason(sensors.admit(&datagram("10.0.0.1:2368", 2368, &[0; 1248]))),
            Refusal::Length
        );
        assert_eq!((sensors.refusals().total(), sensors.others()), (1, 1));
    }

    #[test]
    fn position_packets_reach_all_at_their_address_and_wait_for_the_first() {
        let packet = packet();
        let mut sensors = DiscoveredSensors::default();
        for stamp_us in [1, 2] {
            let position = position(stamp_us);
            assert_eq!(
                indices(sensors.admit(&datagram("10.0.0.1:8308", 8308, &position))),
                [] as [usize; 0]
            );
        }
        assert_eq!(
            indices(sensors.admit(&datagram("10.0.0.1:2368", 2368, packet.emit()))),
            [0]
        );
        let Some(Content::Position(kept, _)) = sensors.position(0).map(|kept| kept.content) else {
            panic!("the newest is kept")
        };
        assert_eq!(kept.stamp_us, 2);
        for (source, port) in [("10.0.0.2:2368", 2368), ("10.0.0.1:2368", 2370)] {
            assert!(
                sensors
                    .admit(&datagram(source, port, packet.emit()))
                    .is_ok()
            );
        }
        let position = [3; POSITION_PACKET_LEN];
        assert_eq!(
            indices(sensors.admit(&datagram("10.0.0.1:9999", 8308, &position))),
            [0, 2]
        );
        assert_eq!(sensors.position(1), None);
    }

    #[test]
    fn position_packets_with_the_ports_of_one_sensor_are_its_own() {
        let (packet, position) = (packet(), [0; POSITION_PACKET_LEN]);
        let mut sensors = DiscoveredSensors::default();
        for (source, port) in [
            ("10.0.0.1:4001", 2001),
            ("10.0.0.1:4002", 2002),
            ("10.0.0.1:4003", 2002),
        ] {
            assert!(
                sensors
                    .admit(&datagram(source, port, packet.emit()))
                    .is_ok()
            );
        }
        for (source, port, expected) in [
            ("10.0.0.1:4002", 2002, &[1][..]),
            ("10.0.0.1:4003", 2001, &[2]),
            ("10.0.0.1:8308", 2001, &[0]),
            ("10.0.0.1:8308", 2002, &[0, 1, 2]),
            ("10.0.0.1:8308", 8308, &[0, 1, 2]),
        ] {
            assert_eq!(
                indices(sensors.admit(&datagram(source, port, &position))),
                expected,
                "{source} to {port}"
            );
            let kept = (0..3).filter(|&index| sensors.position(index).is_some());
            assert_eq!(kept.collect::<Vec<_>>(), expected);
        }
    }

    #[test]
    fn only_a_true_packet_makes_a_sensor_but_a_known_one_may_send_garbage() {
        let (packet, garbage) = (packet(), [0; DATA_PACKET_LEN]);
        let mut third_bank = packet.emit().to_vec();
        third_bank[..2].copy_from_slice(&[0xFF, 0xCC]);
        let mut sensors = DiscoveredSensors::default();
        for payload in [&garbage[..], &third_bank] {
            assert_eq!(
                sensors.admit(&datagram("10.0.0.1:2368", 2368, payload)),
                Err(Refusal::Marker.into())
            );
        }
        assert_eq!(
            indices(sensors.admit(&datagram("10.0.0.1:2368", 2368, packet.emit()))),
            [0]
        );
        assert_eq!(
            sensors.admit(&datagram("10.0.0.1:2368", 2368, &garbage)),
            Err(Refused {
                reason: Refusal::Marker,
                sensor: Some(0)
            })
        );
        // The packet of the known sensor is not counted among the others.
        assert_eq!((sensors.refusals().total(), sensors.others()), (3, 2));
        assert_eq!(sensors.senders()[0].malformed, 1);
    }

    proptest! {
        #[test]
        fn random_datagrams_change_nothing_but_a_counter(
            len in prop_oneof![Just(DATA_PACKET_LEN), 0..1300_usize],
            seed: u64,
            port: u16,
        ) {
            let mut sensors = DiscoveredSensors::default();
            let packet = packet();
            let known = datagram("192.168.1.201:2368", 2368, packet.emit());
            prop_assert!(sensors.admit(&known).is_ok());
            let mut rng = fastrand::Rng::with_seed(seed);
            let payload: Vec<u8> = (0..len).map(|_| rng.u8(..)).collect();
            let source = format!("192.168.1.77:{port}");
            let admitted = sensors.admit(&datagram(&source, 2368, &payload));
            prop_assert_eq!(admitted.is_ok(), len == POSITION_PACKET_LEN);
            let refused = u64::from(len != POSITION_PACKET_LEN);
            prop_assert_eq!(sensors.refusals().total(), refused);
            prop_assert_eq!(sensors.senders().len(), 1);
            prop_assert_eq!(sensors.senders()[0].packets, 1);
        }
    }

    #[test]
    fn sensors_and_kept_packets_are_bounded() {
        let (packet, position) = (packet(), [0; POSITION_PACKET_LEN]);
        let mut sensors = DiscoveredSensors::default();
        for port in 1..=100 {
            let address = format!("10.0.0.{port}:2368");
            assert!(sensors.admit(&datagram(&address, 8308, &position)).is_ok());
            let admitted = sensors.admit(&datagram(&address, 2368, packet.emit()));
            assert_eq!(admitted.is_ok(), port <= MAX_SENSORS);
        }
        let refused = sensors.refusals().get(Refusal::TooMany);
        assert_eq!((sensors.senders().len(), refused), (MAX_SENSORS, 36));
        assert_eq!(sensors.kept.len(), MAX_SENSORS);
        assert!(sensors.position(0).is_none() && sensors.position(63).is_some());
        assert_eq!(SensorSet(u64::MAX).count(), 64);
    }

    #[test]
    fn filters_select() {
        let (packet, position) = (packet(), [0; POSITION_PACKET_LEN]);
        let select = |filter: &str, source: &str, port| {
            let mut sensors =
                DiscoveredSensors::new(vec!["9.9.9.9".parse().unwrap(), filter.parse().unwrap()]);
            sensors
                .admit(&datagram(source, port, packet.emit()))
                .is_ok()
        };
        assert!(
            select("10.0.0.1", "10.0.0.1:2368", 2368) && !select("10.0.0.1", "10.0.0.2:2368", 2368)
        );
        assert!(
            select("10.0.0.1:5", "10.0.0.1:5", 2368) && !select("10.0.0.1:5", "10.0.0.1:6", 2368)
        );
        assert!(
            select("10.0.0.1:5>6", "10.0.0.1:5", 6) && !select("10.0.0.1:5>6", "10.0.0.1:5", 7)
        );
        assert!(select("[fe80::1]:5", "[fe80::1]:5", 6) && select("fe80::1", "[fe80::1]:5", 6));
        let mut sensors = DiscoveredSensors::new(vec!["10.0.0.1:2368".parse().unwrap()]);
        assert_eq!(
            indices(sensors.admit(&datagram("10.0.0.1:8308", 8308, &position))),
            [] as [usize; 0]
        );
        assert_eq!(
            reason(sensors.admit(&datagram("10.0.0.2:8308", 8308, &position))),
            Refusal::Source
        );
        assert_eq!(sensors.refusals().get(Refusal::Source), 1);
    }
}
