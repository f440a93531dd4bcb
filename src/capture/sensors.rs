//! Who sent a datagram: sensors told apart, numbered and named.
//!
//! A sensor is a sender of data packets: its address and port, and the port that it sends to. What
//! a datagram is follows from its length, 1206 bytes of data or 512 of position, since bridges and
//! port forwards mix the ports.

use std::net::{IpAddr, SocketAddr};
use std::str::FromStr;

use sweepd_core::wire::data::{DATA_PACKET_LEN, FLAG_BANK_0, FLAG_BANK_1};
use sweepd_core::wire::position::POSITION_PACKET_LEN;
use sweepd_core::wire::{DataPacket, Datagram};

/// Most sensors that are told apart: more are a mistake or an attack.
pub const MAX_SENSORS: usize = 64;

/// Number of a sensor, in the order in which they were first heard, from 0.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct SensorIndex(u8);

impl SensorIndex {
    /// The number, below [`MAX_SENSORS`].
    pub fn get(self) -> usize {
        usize::from(self.0)
    }
}

/// A set of sensors, as an iterator.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SensorSet(u64);

const _: () = assert!(MAX_SENSORS <= u64::BITS as usize);

impl Iterator for SensorSet {
    type Item = SensorIndex;

    fn next(&mut self) -> Option<SensorIndex> {
        if self.0 == 0 {
            return None;
        }
        let lowest = self.0.trailing_zeros() as u8;
        self.0 &= self.0 - 1;
        Some(SensorIndex(lowest))
    }

    fn size_hint(&self) -> (usize, Option<usize>) {
        let len = self.0.count_ones() as usize;
        (len, Some(len))
    }
}

impl ExactSizeIterator for SensorSet {}

/// Where a datagram belongs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Route {
    /// A data packet of this sensor. One that is not known yet has the next number; ask
    /// [`Sensors::position`] then.
    Data(SensorIndex),
    /// A position packet for the sensors that it may be of; for none if it is the first sign of
    /// one, and kept for it.
    Position(SensorSet),
    /// For nobody.
    Other(Other),
}

/// Why a datagram belongs to no sensor.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Other {
    /// Neither 1206 nor 512 bytes.
    #[error("neither the length of a data packet nor of a position packet")]
    Length,
    /// 1206 bytes from an unknown sender that are no Velodyne data packet.
    #[error("as long as a data packet, but not one")]
    NotVelodyne,
    /// From a sensor that the filters leave out.
    #[error("from a sensor that was not selected")]
    NotSelected,
    /// From one sensor more than [`MAX_SENSORS`].
    #[error("from one sensor too many")]
    TooMany,
}

/// How many datagrams belonged to no sensor.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct OtherCounts {
    /// [`Other::Length`].
    pub length: u64,
    /// [`Other::NotVelodyne`].
    pub not_velodyne: u64,
    /// [`Other::NotSelected`].
    pub not_selected: u64,
    /// [`Other::TooMany`].
    pub too_many: u64,
}

impl OtherCounts {
    /// All of them.
    pub fn total(&self) -> u64 {
        self.length + self.not_velodyne + self.not_selected + self.too_many
    }
}

/// A sender of data packets.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Sensor {
    /// Where it sends from; an IPv4 address in IPv6 clothes is undressed.
    pub source: SocketAddr,
    /// The port that it sends data to.
    pub destination_port: u16,
    /// Its name in output: `192.168.1.201:2368`, and `192.168.1.201:2368>2369` for a later one from
    /// the same port.
    pub name: String,
}

impl Sensor {
    /// Whether a filter selects it.
    pub fn is_selected_by(&self, filter: &SensorFilter) -> bool {
        filter.matches(self.source, self.destination_port)
    }
}

/// The sensors heard so far. Knows no time and no model; of the packets it reads only what tells
/// them apart.
#[derive(Debug, Default)]
pub struct Sensors {
    filters: Vec<SensorFilter>,
    sensors: Vec<Sensor>,
    /// At most one an address and [`MAX_SENSORS`] in all, the least recent first.
    positions: Vec<KeptPosition>,
    others: OtherCounts,
}

#[derive(Debug)]
struct KeptPosition {
    arrival_ns: i64,
    source: SocketAddr,
    destination_port: u16,
    payload: [u8; POSITION_PACKET_LEN],
}

impl Sensors {
    /// No sensors yet. Only those that match one of `filters` will be told apart; all, if there are
    /// none.
    pub fn new(filters: Vec<SensorFilter>) -> Self {
        Self {
            filters,
            ..Self::default()
        }
    }

    /// Where a datagram belongs.
    pub fn route(&mut self, datagram: &Datagram<'_>) -> Route {
        let source = canonical(datagram.source);
        let route = match datagram.payload.len() {
            DATA_PACKET_LEN => self.data(source, datagram),
            POSITION_PACKET_LEN => self.position_packet(source, datagram),
            _ => Err(Other::Length),
        };
        route.unwrap_or_else(|other| {
            *match other {
                Other::Length => &mut self.others.length,
                Other::NotVelodyne => &mut self.others.not_velodyne,
                Other::NotSelected => &mut self.others.not_selected,
                Other::TooMany => &mut self.others.too_many,
            } += 1;
            Route::Other(other)
        })
    }

    /// All sensors, by number.
    pub fn sensors(&self) -> &[Sensor] {
        &self.sensors
    }

    /// A sensor by its number.
    ///
    /// # Panics
    /// If the number is from another `Sensors`.
    pub fn sensor(&self, index: SensorIndex) -> &Sensor {
        &self.sensors[index.get()]
    }

    /// The latest position packet from the sensor's address, which may have come before its first
    /// data packet; `None` where it is another sensor's.
    pub fn position(&self, index: SensorIndex) -> Option<Datagram<'_>> {
        let ip = self.sensors.get(index.get())?.source.ip();
        let kept = self.positions.iter().find(|kept| kept.source.ip() == ip)?;
        self.may_have_sent(kept.source, kept.destination_port)
            .find(|&own| own == index)?;
        Some(Datagram {
            arrival_ns: kept.arrival_ns,
            source: kept.source,
            destination_port: kept.destination_port,
            payload: &kept.payload,
        })
    }

    /// How many datagrams belonged to no sensor, by reason.
    pub fn others(&self) -> OtherCounts {
        self.others
    }

    fn data(&mut self, source: SocketAddr, datagram: &Datagram<'_>) -> Result<Route, Other> {
        let destination_port = datagram.destination_port;
        let same = |sensor: &Sensor| {
            sensor.source == source && sensor.destination_port == destination_port
        };
        if let Some(index) = self.sensors.iter().position(same) {
            return Ok(Route::Data(SensorIndex(index as u8)));
        }
        if !begins_like_a_sensor(datagram.payload) {
            return Err(Other::NotVelodyne);
        }
        if !self.filters.is_empty()
            && !self
                .filters
                .iter()
                .any(|filter| filter.matches(source, destination_port))
        {
            return Err(Other::NotSelected);
        }
        if self.sensors.len() == MAX_SENSORS {
            return Err(Other::TooMany);
        }
        let index = SensorIndex(self.sensors.len() as u8);
        let shares_source = self.sensors.iter().any(|sensor| sensor.source == source);
        let name = if shares_source {
            format!("{source}>{destination_port}")
        } else {
            source.to_string()
        };
        self.sensors.push(Sensor {
            source,
            destination_port,
            name,
        });
        Ok(Route::Data(index))
    }

    fn position_packet(
        &mut self,
        source: SocketAddr,
        datagram: &Datagram<'_>,
    ) -> Result<Route, Other> {
        let ip = source.ip();
        if !self.filters.is_empty() && !self.filters.iter().any(|filter| filter.matches_ip(ip)) {
            return Err(Other::NotSelected);
        }
        let payload = datagram.payload.try_into().map_err(|_| Other::Length)?;
        if let Some(at) = self
            .positions
            .iter()
            .position(|kept| kept.source.ip() == ip)
        {
            self.positions.remove(at);
        } else if self.positions.len() == MAX_SENSORS {
            self.positions.remove(0);
        }
        let (arrival_ns, destination_port) = (datagram.arrival_ns, datagram.destination_port);
        self.positions.push(KeptPosition {
            arrival_ns,
            source,
            destination_port,
            payload,
        });
        Ok(Route::Position(
            self.may_have_sent(source, destination_port),
        ))
    }

    /// The sensors that a position packet may be of. All at its address, unless its ports are those
    /// of the data of one of them: of several on one computer, or behind a router.
    fn may_have_sent(&self, source: SocketAddr, destination_port: u16) -> SensorSet {
        let (mut all, mut by_source, mut by_destination) = (0, 0, 0);
        for (index, sensor) in self
            .sensors
            .iter()
            .enumerate()
            .filter(|(_, one)| one.source.ip() == source.ip())
        {
            all |= 1 << index;
            by_source |= u64::from(sensor.source == source) << index;
            by_destination |= u64::from(sensor.destination_port == destination_port) << index;
        }
        let told = [by_source, by_destination]
            .into_iter()
            .find(|set| set.count_ones() == 1);
        SensorSet(told.unwrap_or(all))
    }
}

/// A 1206-byte payload makes a sensor only if it parses and begins with a bank that all models
/// begin with.
fn begins_like_a_sensor(payload: &[u8]) -> bool {
    DataPacket::parse(payload)
        .is_ok_and(|packet| matches!(packet.blocks[0].flag.get(), FLAG_BANK_0 | FLAG_BANK_1))
}

/// A socket that listens on IPv6 gives IPv4 senders as `::ffff:192.168.1.201`.
fn canonical(source: SocketAddr) -> SocketAddr {
    SocketAddr::new(source.ip().to_canonical(), source.port())
}

/// Which sensors to take: all at an address, those that send from one port, or also to one port.
///
/// ```
/// use sweepd::capture::sensors::SensorFilter;
/// let filter: SensorFilter = "192.168.1.201".parse().unwrap();
/// assert!(filter.matches("192.168.1.201:2368".parse().unwrap(), 2368));
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SensorFilter {
    ip: IpAddr,
    source_port: Option<u16>,
    destination_port: Option<u16>,
}

impl SensorFilter {
    /// Whether a sensor with this source that sends data to this port is selected.
    pub fn matches(&self, source: SocketAddr, destination_port: u16) -> bool {
        self.matches_ip(source.ip())
            && self.source_port.is_none_or(|port| port == source.port())
            && self
                .destination_port
                .is_none_or(|port| port == destination_port)
    }

    /// Whether a sensor at this address may be selected; position packets come from a port of their
    /// own.
    pub fn matches_ip(&self, ip: IpAddr) -> bool {
        self.ip == ip.to_canonical()
    }
}

impl std::fmt::Display for SensorFilter {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self.source_port {
            Some(port) => write!(f, "{}", SocketAddr::new(self.ip, port))?,
            None => write!(f, "{}", self.ip)?,
        }
        self.destination_port
            .map_or(Ok(()), |port| write!(f, ">{port}"))
    }
}

/// A text that names no sensor.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "`{0}` names no sensor; expected IP, IP:PORT or IP:PORT>PORT as in the output, such as 192.168.1.201 or \
     192.168.1.201:2368, with an IPv6 address in brackets before a port"
)]
pub struct SensorFilterError(String);

impl FromStr for SensorFilter {
    type Err = SensorFilterError;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let wrong = || SensorFilterError(text.to_owned());
        if let Ok(ip) = text.parse::<IpAddr>() {
            return Ok(Self {
                ip: ip.to_canonical(),
                source_port: None,
                destination_port: None,
            });
        }
        let (source, destination_port) = match text.split_once('>') {
            Some((source, port)) => (source, Some(port.parse().map_err(|_| wrong())?)),
            None => (text, None),
        };
        let source: SocketAddr = source.parse().map_err(|_| wrong())?;
        Ok(Self {
            ip: source.ip().to_canonical(),
            source_port: Some(source.port()),
            destination_port,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

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

    fn indices(route: Route) -> Vec<usize> {
        match route {
            Route::Data(index) => vec![index.get()],
            Route::Position(set) => set.map(SensorIndex::get).collect(),
            Route::Other(other) => panic!("{other}"),
        }
    }

    #[test]
    fn sensors_are_told_apart_by_both_ends_and_named() {
        let packet = packet();
        let mut sensors = Sensors::default();
        let mut heard =
            |source: &str, port| indices(sensors.route(&datagram(source, port, packet.emit())))[0];
        assert_eq!(heard("192.168.1.201:2368", 2368), 0);
        assert_eq!(heard("192.168.1.202:2368", 2368), 1);
        assert_eq!(heard("192.168.1.201:2368", 2369), 2);
        assert_eq!(heard("192.168.1.201:443", 2368), 3);
        assert_eq!(heard("[fe80::1]:2368", 2368), 4);
        assert_eq!(heard("[::ffff:192.168.1.202]:2368", 2368), 1);
        let names: Vec<&str> = sensors
            .sensors()
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
    fn length_decides_whatever_the_port() {
        let (packet, position) = (packet(), [7; POSITION_PACKET_LEN]);
        let mut sensors = Sensors::default();
        assert_eq!(
            indices(sensors.route(&datagram("10.0.0.1:8308", 8308, packet.emit()))),
            [0]
        );
        assert_eq!(
            indices(sensors.route(&datagram("10.0.0.1:2368", 2368, &position))),
            [0]
        );
        assert_eq!(
            sensors.route(&datagram("10.0.0.1:2368", 2368, &[0; 1248])),
            Route::Other(Other::Length)
        );
        assert_eq!(
            sensors.others(),
            OtherCounts {
                length: 1,
                ..Default::default()
            }
        );
    }

    #[test]
    fn position_packets_reach_all_at_their_address_and_wait_for_the_first() {
        let packet = packet();
        let mut sensors = Sensors::default();
        for fill in [1, 2] {
            let position = [fill; POSITION_PACKET_LEN];
            assert_eq!(
                sensors.route(&datagram("10.0.0.1:8308", 8308, &position)),
                Route::Position(SensorSet(0))
            );
        }
        let Route::Data(index) = sensors.route(&datagram("10.0.0.1:2368", 2368, packet.emit()))
        else {
            panic!()
        };
        let kept = sensors.position(index).unwrap();
        assert_eq!(
            kept,
            datagram("10.0.0.1:8308", 8308, &[2; POSITION_PACKET_LEN])
        );
        sensors.route(&datagram("10.0.0.2:2368", 2368, packet.emit()));
        sensors.route(&datagram("10.0.0.1:2368", 2370, packet.emit()));
        let position = [3; POSITION_PACKET_LEN];
        assert_eq!(
            indices(sensors.route(&datagram("10.0.0.1:9999", 8308, &position))),
            [0, 2]
        );
        assert_eq!(sensors.position(SensorIndex(1)), None);
    }

    #[test]
    fn position_packets_with_the_ports_of_one_sensor_are_its_own() {
        let (packet, position) = (packet(), [0; POSITION_PACKET_LEN]);
        let mut sensors = Sensors::default();
        for (source, port) in [
            ("10.0.0.1:4001", 2001),
            ("10.0.0.1:4002", 2002),
            ("10.0.0.1:4003", 2002),
        ] {
            sensors.route(&datagram(source, port, packet.emit()));
        }
        for (source, port, expected) in [
            ("10.0.0.1:4002", 2002, &[1][..]),
            ("10.0.0.1:4003", 2001, &[2]),
            ("10.0.0.1:8308", 2001, &[0]),
            ("10.0.0.1:8308", 2002, &[0, 1, 2]),
            ("10.0.0.1:8308", 8308, &[0, 1, 2]),
        ] {
            assert_eq!(
                indices(sensors.route(&datagram(source, port, &position))),
                expected,
                "{source} to {port}"
            );
            let kept = (0..3).filter(|&index| sensors.position(SensorIndex(index)).is_some());
            assert_eq!(kept.map(usize::from).collect::<Vec<_>>(), expected);
        }
    }

    #[test]
    fn only_a_true_packet_makes_a_sensor_but_a_known_one_may_send_garbage() {
        let (packet, garbage) = (packet(), [0; DATA_PACKET_LEN]);
        let mut third_bank = packet.emit().to_vec();
        third_bank[..2].copy_from_slice(&[0xFF, 0xCC]);
        let mut sensors = Sensors::default();
        for payload in [&garbage[..], &third_bank] {
            assert_eq!(
                sensors.route(&datagram("10.0.0.1:2368", 2368, payload)),
                Route::Other(Other::NotVelodyne)
            );
        }
        assert_eq!(
            indices(sensors.route(&datagram("10.0.0.1:2368", 2368, packet.emit()))),
            [0]
        );
        assert_eq!(
            indices(sensors.route(&datagram("10.0.0.1:2368", 2368, &garbage))),
            [0]
        );
        assert_eq!(sensors.others().not_velodyne, 2);
    }

    #[test]
    fn sensors_and_kept_packets_are_bounded() {
        let (packet, position) = (packet(), [0; POSITION_PACKET_LEN]);
        let mut sensors = Sensors::default();
        for port in 1..=100 {
            let address = format!("10.0.0.{port}:2368");
            sensors.route(&datagram(&address, 8308, &position));
            sensors.route(&datagram(&address, 2368, packet.emit()));
        }
        assert_eq!(
            (sensors.sensors().len(), sensors.others().too_many),
            (MAX_SENSORS, 36)
        );
        assert_eq!(sensors.positions.len(), MAX_SENSORS);
        assert!(
            sensors.position(SensorIndex(0)).is_none()
                && sensors.position(SensorIndex(63)).is_some()
        );
        assert_eq!(SensorSet(u64::MAX).count(), 64);
    }

    #[test]
    fn filters_select() {
        let (packet, position) = (packet(), [0; POSITION_PACKET_LEN]);
        let select = |filter: &str, source: &str, port| {
            let mut sensors =
                Sensors::new(vec!["9.9.9.9".parse().unwrap(), filter.parse().unwrap()]);
            sensors.route(&datagram(source, port, packet.emit()))
                != Route::Other(Other::NotSelected)
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
        let mut sensors = Sensors::new(vec!["10.0.0.1:2368".parse().unwrap()]);
        assert_eq!(
            sensors.route(&datagram("10.0.0.1:8308", 8308, &position)),
            Route::Position(SensorSet(0))
        );
        assert_eq!(
            sensors.route(&datagram("10.0.0.2:8308", 8308, &position)),
            Route::Other(Other::NotSelected)
        );
        assert_eq!(sensors.others().not_selected, 1);
    }

    #[test]
    fn filters_are_written_as_they_are_read() {
        for text in [
            "10.0.0.1",
            "10.0.0.1:5",
            "10.0.0.1:5>6",
            "fe80::1",
            "[fe80::1]:5",
        ] {
            assert_eq!(text.parse::<SensorFilter>().unwrap().to_string(), text);
        }
    }

    #[test]
    fn a_wrong_filter_says_what_was_expected() {
        for text in [
            "",
            "lidar",
            "10.0.0",
            "10.0.0.1:",
            "10.0.0.1:99999",
            "10.0.0.1>5",
            "10.0.0.1:5>x",
            "fe80::1:5>6",
        ] {
            let error = text.parse::<SensorFilter>().unwrap_err().to_string();
            assert!(
                error.starts_with(&format!("`{text}` names no sensor; expected IP")),
                "{error}"
            );
        }
    }
}
