//! What gets in: packets of sensors, and of nobody else.

use super::sensors::{Other, OtherCounts, Route, Sensor, SensorFilter, SensorIndex, Sensors};
use crate::wire::data::DATA_PACKET_LEN;
use crate::wire::{DataPacket, Datagram, PacketError};

/// Stands between a socket and the pipelines: only packets of the right length, markers and source get through, the
/// others change nothing but a counter.
///
/// Stricter than [`Sensors`] alone, which hands on whatever a known sensor sends: on a network that others share, an
/// address proves nothing.
#[derive(Debug, Default)]
pub struct Gate {
    sensors: Sensors,
    wrong_marker: u64,
    positions: u64,
    data: Vec<u64>,
}

impl Gate {
    /// A gate for the sensors that match one of `filters`; for all, if there are none.
    pub fn new(filters: Vec<SensorFilter>) -> Self {
        Self { sensors: Sensors::new(filters), ..Self::default() }
    }

    /// Whose packet a datagram is; [`Route::Other`] is not let in.
    pub fn admit(&mut self, datagram: &Datagram<'_>) -> Route {
        if has_wrong_marker(datagram.payload) {
            self.wrong_marker += 1;
            return Route::Other(Other::NotVelodyne);
        }
        let route = self.sensors.route(datagram);
        match route {
            Route::Data(index) => {
                self.data.resize(self.sensors.sensors().len(), 0);
                self.data[index.get()] += 1;
            }
            Route::Position(_) => self.positions += 1,
            Route::Other(_) => {}
        }
        route
    }

    /// The sensors heard so far.
    pub fn sensors(&self) -> &[Sensor] {
        self.sensors.sensors()
    }

    /// Data packets of a sensor that were let in.
    pub fn data(&self, index: SensorIndex) -> u64 {
        self.data.get(index.get()).copied().unwrap_or(0)
    }

    /// Sensors and how many data packets of each were let in.
    pub fn by_sensor(&self) -> impl Iterator<Item = (&Sensor, u64)> {
        self.sensors().iter().zip(self.data.iter().copied())
    }

    /// Position packets that were let in.
    pub fn positions(&self) -> u64 {
        self.positions
    }

    /// Datagrams that were not let in, by reason.
    pub fn refused(&self) -> OtherCounts {
        let others = self.sensors.others();
        OtherCounts { not_velodyne: others.not_velodyne + self.wrong_marker, ..others }
    }
}

/// As long as a data packet, and a block begins with no marker. An azimuth beyond the turn is the pipeline's business.
fn has_wrong_marker(payload: &[u8]) -> bool {
    payload.len() == DATA_PACKET_LEN && matches!(DataPacket::parse(payload), Err(PacketError::Flag { .. }))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::wire::position::POSITION_PACKET_LEN;
    use proptest::prelude::*;

    const OWN: &str = "192.168.1.201:2368";

    fn admit(gate: &mut Gate, source: &str, payload: &[u8]) -> bool {
        let datagram = Datagram { arrival_ns: 5, source: source.parse().unwrap(), destination_port: 2368, payload };
        !matches!(gate.admit(&datagram), Route::Other(_))
    }

    #[test]
    fn only_packets_of_the_sensor_get_in_and_the_others_are_counted_by_reason() {
        let mut gate = Gate::new(vec!["192.168.1.201".parse().unwrap()]);
        let packet = DataPacket::new(0, 0x37, 0x22);
        let mut broken = packet;
        broken.blocks[7].flag.set(0x1234);
        assert!(admit(&mut gate, OWN, packet.emit()));
        assert!(admit(&mut gate, "192.168.1.201:8308", &[0; POSITION_PACKET_LEN]));
        assert!(!admit(&mut gate, OWN, broken.emit()), "also of a sensor that is known");
        assert!(!admit(&mut gate, OWN, &packet.emit()[1..]));
        assert!(!admit(&mut gate, OWN, b""));
        assert!(!admit(&mut gate, "192.168.1.202:2368", packet.emit()));
        assert!(!admit(&mut gate, "192.168.1.202:8308", &[0; POSITION_PACKET_LEN]));
        assert!(!admit(&mut gate, "192.168.1.202:2368", broken.emit()));
        assert_eq!(gate.refused(), OtherCounts { length: 2, not_velodyne: 2, not_selected: 2, too_many: 0 });
        assert_eq!(gate.positions(), 1);
        let by_sensor: Vec<_> = gate.by_sensor().map(|(sensor, data)| (&sensor.name[..], data)).collect();
        assert_eq!(by_sensor, [(OWN, 1)]);
    }

    proptest! {
        #[test]
        fn random_datagrams_change_nothing_but_a_counter(
            len in prop_oneof![Just(DATA_PACKET_LEN), 0..1300_usize], seed in any::<u64>(), port in any::<u16>(),
        ) {
            let mut gate = Gate::new(vec!["192.168.1.201".parse().unwrap()]);
            prop_assert!(admit(&mut gate, OWN, DataPacket::new(0, 0x37, 0x22).emit()));
            let mut rng = fastrand::Rng::with_seed(seed);
            let payload: Vec<u8> = (0..len).map(|_| rng.u8(..)).collect();
            let source = format!("192.168.1.77:{port}");
            prop_assert!(!admit(&mut gate, &source, &payload));
            prop_assert_eq!(gate.refused().total(), 1);
            prop_assert_eq!((gate.sensors().len(), gate.by_sensor().next().unwrap().1), (1, 1));
        }
    }
}
