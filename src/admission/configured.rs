//! The configured sensors of a port of the daemon. This has no state: a sensor whose source port
//! changes, even a hundred times in months, stays the same sensor.

use std::net::{IpAddr, SocketAddr};

use super::{Refusal, Refused, Route, SensorSet, canonical};
use sweepd_core::wire::{Content, Datagram, Packet};

/// The sensors whose packets are let in.
#[derive(Clone, Debug)]
pub struct ConfiguredSensors {
    /// Those of the port, then the others whose position packets may come through it.
    known: Vec<ConfiguredSensor>,
    /// Number of them that are of the port.
    here: usize,
}

/// Properties that distinguish a sensor from others.
#[derive(Clone, Copy, Debug)]
pub struct ConfiguredSensor {
    /// Its address.
    pub ip: IpAddr,
    /// The port that it sends from, where it is configured.
    pub source_port: Option<u16>,
    /// An HDL-64E sends no position packets.
    pub sends_positions: bool,
    /// How likely it sends its position packets to this port.
    pub positions_here: Likelihood,
}

/// How likely a sensor sends its position packets to a port.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Likelihood {
    /// By its configuration, neither these nor its data go to this port.
    Unexpected,
    /// Its data come through this port: some senders have one port for everything.
    BesideData,
    /// This is its position port.
    Configured,
}

impl ConfiguredSensor {
    /// Whether the port of this source is the one that is configured.
    fn names_port_of(&self, source: SocketAddr) -> bool {
        self.source_port == Some(source.port())
    }
}

impl ConfiguredSensors {
    /// The sensors of a port, and after them others whose position packets may come through it: the
    /// numbers of a [`Route`] count through both.
    pub fn new(here: Vec<ConfiguredSensor>, others: Vec<ConfiguredSensor>) -> Self {
        Self {
            here: here.len(),
            known: [here, others].concat(),
        }
    }

    /// Reads a datagram and determines its sensor. The route of a position packet is empty if it
    /// may be of several sensors and nothing distinguishes them.
    ///
    /// # Errors
    /// [`Refused`]: the reason to refuse it.
    pub fn admit<'a>(&self, datagram: &Datagram<'a>) -> Result<(Route, Packet<'a>), Refused> {
        let source = canonical(datagram.source);
        let packet = datagram.parse().map_err(|error| Refused {
            reason: error.into(),
            sensor: self.owner(source),
        })?;
        let route = match packet.content {
            Content::Data(_) => Route::Data(self.data(source)?),
            Content::Position(..) => Route::Position(self.position(source)?),
        };
        Ok((route, packet))
    }

    /// The sensor of this port that sends from this source.
    fn owner(&self, source: SocketAddr) -> Option<usize> {
        self.known[..self.here].iter().position(|known| {
            known.ip == source.ip() && known.source_port.is_none_or(|own| own == source.port())
        })
    }

    fn data(&self, source: SocketAddr) -> Result<usize, Refusal> {
        if let Some(index) = self.owner(source) {
            return Ok(index);
        }
        // Sensors of this port come first: none of this address is here if the first is not.
        match self.at(source.ip()).next() {
            Some((first, _)) if first >= self.here => Err(Refusal::Port),
            _ => Err(Refusal::Source),
        }
    }

    /// A single sensor at an address gets all position packets from it: many come from another
    /// source port than the data. Of several sensors, the one that fits best gets it, unless
    /// another fits as well.
    fn position(&self, source: SocketAddr) -> Result<SensorSet, Refusal> {
        let mut at = self.at(source.ip());
        let Some((first, _)) = at.next() else {
            return Err(Refusal::Source);
        };
        if at.next().is_none() {
            return Ok(Some(first).into());
        }
        let is_named = self
            .at(source.ip())
            .any(|(_, known)| known.names_port_of(source));
        let mut best = None;
        let mut is_alone = false;
        for (place, known) in self
            .at(source.ip())
            .filter(|(_, known)| known.sends_positions)
        {
            let is_source = known.names_port_of(source);
            let is_another = is_named && known.source_port.is_some() && !is_source;
            let fit = (!is_another, known.positions_here, is_source);
            if best.is_none_or(|(best_fit, _)| fit >= best_fit) {
                is_alone = best.is_none_or(|(best_fit, _)| fit > best_fit);
                best = Some((fit, place));
            }
        }
        let best = best.filter(|_| is_alone);
        Ok(best.map(|(_, place)| place).into())
    }

    /// The sensors at an address, with their places.
    fn at(&self, ip: IpAddr) -> impl Iterator<Item = (usize, &ConfiguredSensor)> {
        self.known
            .iter()
            .enumerate()
            .filter(move |(_, known)| known.ip == ip)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::daemon::config::SensorConfig;
    use crate::daemon::plan;
    use crate::daemon::testing::{config_of, sensor};
    use proptest::prelude::*;
    use sweepd_core::sensor::Model;
    use sweepd_core::wire::DataPacket;
    use sweepd_core::wire::data::DATA_PACKET_LEN;
    use sweepd_core::wire::position::POSITION_PACKET_LEN;

    /// A route in a compact form.
    #[derive(Debug, PartialEq)]
    enum Admitted {
        Data(usize),
        Position(usize),
        Ambiguous,
    }

    fn admit(
        sensors: &ConfiguredSensors,
        source: &str,
        payload: &[u8],
    ) -> Result<Admitted, Refusal> {
        let admitted = sensors.admit(&Datagram {
            arrival_ns: 5,
            source: source.parse().unwrap(),
            destination_port: 2368,
            payload,
        });
        match admitted {
            Ok((Route::Data(index), _)) => Ok(Admitted::Data(index)),
            Ok((Route::Position(mut set), _)) => {
                let first = set.next().map_or(Admitted::Ambiguous, Admitted::Position);
                assert_eq!(set.len(), 0);
                Ok(first)
            }
            Err(refused) => Err(refused.reason),
        }
    }

    /// The admission of the port whose data these sensors send, or whose position packets alone.
    fn admission_of(sensors: &[SensorConfig], port: u16) -> ConfiguredSensors {
        let config = config_of(sensors.to_vec());
        let plans = plan::ports(&config);
        let plan = plans.iter().find(|plan| plan.config.port == port);
        plan.unwrap().admission(&config)
    }

    fn four_sensors() -> ConfiguredSensors {
        let [mut left, mut right] = ["left", "right"].map(|name| sensor(name, "10.0.0.1", 2368));
        (left.source_port, right.source_port) = (Some(4000), Some(4001));
        let (roof, rear) = (
            sensor("roof", "10.0.0.2", 2368),
            sensor("rear", "10.0.0.3", 2369),
        );
        admission_of(&[left, right, roof, rear], 2368)
    }

    #[test]
    fn only_packets_of_configured_sensors_get_in_and_the_others_have_a_reason() {
        let (sensors, packet) = (four_sensors(), DataPacket::new(0, 0x37, 0x22));
        let mut broken = packet;
        broken.blocks[7].flag.set(0x1234);
        let mut beyond = packet;
        beyond.blocks[2].set_azimuth_cdeg(36_001);
        let (data, position) = (packet.emit(), &[0; POSITION_PACKET_LEN]);
        let cases = [
            ("10.0.0.1:4000", data, Ok(Admitted::Data(0))),
            ("10.0.0.1:4001", data, Ok(Admitted::Data(1))),
            ("10.0.0.1:4002", data, Err(Refusal::Source)),
            ("10.0.0.2:9", data, Ok(Admitted::Data(2))),
            ("[::ffff:10.0.0.2]:9", data, Ok(Admitted::Data(2))),
            ("10.0.0.3:9", data, Err(Refusal::Port)),
            ("10.0.0.4:9", data, Err(Refusal::Source)),
            ("10.0.0.2:9", broken.emit(), Err(Refusal::Marker)),
            ("10.0.0.4:9", broken.emit(), Err(Refusal::Marker)),
            ("10.0.0.2:9", beyond.emit(), Err(Refusal::Azimuth)),
            ("10.0.0.2:9", &data[1..], Err(Refusal::Length)),
            ("10.0.0.2:9", b"", Err(Refusal::Length)),
            ("10.0.0.1:4000", position, Ok(Admitted::Position(0))),
            ("10.0.0.1:4001", position, Ok(Admitted::Position(1))),
            ("10.0.0.1:8308", position, Ok(Admitted::Ambiguous)),
            (
                "[::ffff:10.0.0.2]:8308",
                position,
                Ok(Admitted::Position(2)),
            ),
            ("10.0.0.3:8308", position, Ok(Admitted::Position(3))),
            ("10.0.0.4:8308", position, Err(Refusal::Source)),
        ];
        for (source, payload, expected) in cases {
            assert_eq!(
                admit(&sensors, source, payload),
                expected,
                "{source}, {} bytes",
                payload.len()
            );
        }
    }

    /// Sensors at 10.0.0.1, by source port, data port and position port.
    fn at_one_address<const N: usize>(ports: [(Option<u16>, u16, u16); N]) -> [SensorConfig; N] {
        ports.map(|(source_port, port, position_port)| {
            let mut sensor = sensor("x", "10.0.0.1", port);
            (sensor.source_port, sensor.position_port) = (source_port, position_port);
            sensor
        })
    }

    /// The index of the sensor that gets a position packet from one port to another.
    fn recipient(sensors: &[SensorConfig], from: u16, to: u16) -> Option<usize> {
        let config = config_of(sensors.to_vec());
        let plan = plan::ports(&config)
            .into_iter()
            .find(|plan| plan.config.port == to)
            .unwrap();
        match admit(
            &plan.admission(&config),
            &format!("10.0.0.1:{from}"),
            &[0; POSITION_PACKET_LEN],
        )
        .unwrap()
        {
            Admitted::Position(place) => plan
                .sensors
                .iter()
                .copied()
                .chain(plan.others(&config))
                .nth(place),
            Admitted::Ambiguous => None,
            Admitted::Data(_) => panic!("no data packet"),
        }
    }

    #[test]
    fn a_position_packet_is_of_the_sensor_whose_port_it_names() {
        let own_ports = at_one_address([(None, 2001, 3001), (None, 2002, 3002)]);
        // From any source port; also to its data port, if only that distinguishes it.
        for (to, whose) in [(3001, 0), (3002, 1), (2001, 0), (2002, 1)] {
            assert_eq!(recipient(&own_ports, 8308, to), Some(whose), "to {to}");
        }
        let own_sources = at_one_address([(Some(4001), 2001, 8308), (Some(4002), 2002, 8308)]);
        for (from, to, whose) in [
            (4001, 8308, Some(0)),
            (4002, 8308, Some(1)),
            (4002, 2001, Some(1)),
            (5000, 8308, None),
            (5000, 2001, Some(0)),
        ] {
            assert_eq!(recipient(&own_sources, from, to), whose, "{from} to {to}");
        }
        let one_source = at_one_address([(Some(4001), 2001, 8308), (None, 2002, 8308)]);
        assert_eq!(
            [4001, 5000].map(|from| recipient(&one_source, from, 8308)),
            [Some(0), None]
        );
        // The first sends to the second's data port, by its configuration.
        let chained = at_one_address([(None, 2001, 2002), (None, 2002, 2003)]);
        assert_eq!(
            [2001, 2002, 2003].map(|to| recipient(&chained, 8308, to)),
            [Some(0), Some(0), Some(1)]
        );
    }

    #[test]
    fn a_position_packet_that_may_be_of_several_sensors_goes_to_none() {
        let nothing_tells = at_one_address([(None, 2001, 8308), (None, 2002, 8308)]);
        assert_eq!(recipient(&nothing_tells, 8308, 8308), None);
        // To a data port that only one has.
        assert_eq!(recipient(&nothing_tells, 8308, 2002), Some(1));
        let both_here = at_one_address([(None, 2001, 2001), (None, 2002, 2001)]);
        assert_eq!(
            [2001, 2002].map(|to| recipient(&both_here, 8308, to)),
            [None, Some(1)]
        );
    }

    #[test]
    fn a_sensor_that_is_alone_at_its_address_gets_its_position_packets_on_any_port() {
        let [mut one, other] = at_one_address([(Some(4001), 2001, 8308), (None, 2002, 8309)]);
        let mut elsewhere = other.clone();
        elsewhere.address = [10, 0, 0, 2].into();
        let alone = [one.clone(), elsewhere];
        for (from, to) in [
            (4001, 2001),
            (5000, 2001),
            (5000, 2002),
            (5000, 8308),
            (5000, 8309),
        ] {
            assert_eq!(recipient(&alone, from, to), Some(0), "{from} to {to}");
        }
        // An HDL-64E beside it sends none.
        one.pipeline.model = Some(Model::Hdl64eS3);
        assert_eq!(
            recipient(&[one.clone(), other.clone()], 5000, 2001),
            Some(1)
        );
        assert_eq!(recipient(&[one], 5000, 2001), Some(0));
    }

    #[test]
    fn the_same_address_on_another_interface_is_another_sensor() {
        let [mut one, mut other] = at_one_address([(None, 2001, 8308), (None, 2001, 8308)]);
        (one.port.interface, other.port.interface) =
            (Some("eth1".to_owned()), Some("eth2".to_owned()));
        let config = config_of(vec![one, other]);
        let plans = plan::ports(&config);
        assert_eq!(plans.len(), 4);
        for plan in &plans {
            let admitted = admit(
                &plan.admission(&config),
                "10.0.0.1:8308",
                &[0; POSITION_PACKET_LEN],
            );
            assert_eq!(admitted, Ok(Admitted::Position(0)));
            let whose = plan
                .sensors
                .iter()
                .copied()
                .chain(plan.others(&config))
                .next();
            assert_eq!(
                whose,
                Some(usize::from(
                    plan.config.interface.as_deref() == Some("eth2")
                ))
            );
            assert_eq!(plan.sharing_an_address(&config).count(), 0);
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
            prop_assert!(admit(&four_sensors(), &source, &payload).is_err());
        }
    }
}
