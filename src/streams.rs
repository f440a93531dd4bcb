//! Datagrams to the sensors that sent them, wherever no configuration names these: in captures, and
//! for the doctor.
//!
//! A program says what it keeps of a sensor ([`Stream`]): most have a pipeline, and give its sweeps.
//! [`Streams`] does what is the same for all of them: whose a datagram is, what a sensor that comes
//! late must know, and how far the time has come.

use std::collections::VecDeque;

use crate::admission::{
    Admitted, DiscoveredSensors, Refused, Route, Sender, SensorFilter, SensorSet,
};
use crate::input::Placed;
use sweepd_core::wire::Packet;

/// What a program keeps of a sensor.
pub trait Stream {
    /// What comes out of it.
    type Sweep;

    /// Takes a packet of data or position; `None` is a data packet that is damaged.
    fn take(&mut self, packet: Option<&Packet<'_>>, placed: &Placed<'_>);

    /// All packets so far are taken, and the time has come to the arrival of a datagram of any
    /// sensor: a sweep may be closed because this one is silent. Returns whether there may be a sweep.
    fn idle(&mut self, _time: SteadyTime) -> bool {
        false
    }

    /// Nothing more comes.
    fn end(&mut self) {}

    /// The next sweep that is whole.
    fn next_sweep(&mut self) -> Option<Self::Sweep> {
        None
    }
}

/// The sensors so far, each with its stream.
pub struct Streams<S: Stream> {
    /// What is known of the sensors, and what was refused.
    pub sensors: DiscoveredSensors,
    /// The streams, by number of the sensor.
    pub all: Vec<S>,
    /// Sweeps of sensors that fell silent.
    silent: VecDeque<S::Sweep>,
    time: SteadyTime,
}

impl<S: Stream> Streams<S> {
    /// No sensors yet. Only those that match one of `filters` are admitted; all, if there are no
    /// filters.
    pub fn new(filters: Vec<SensorFilter>) -> Self {
        Self {
            sensors: DiscoveredSensors::new(filters),
            all: Vec::new(),
            silent: VecDeque::new(),
            time: SteadyTime::default(),
        }
    }

    /// Gives a datagram to the streams of its sensors, and says what it is. `begin` makes the
    /// stream of a new sensor, of this number. Then fetch all [sweeps](Self::next_sweep).
    ///
    /// # Errors
    /// That of `begin`.
    pub fn take<'p, E>(
        &mut self,
        placed: &Placed<'p>,
        begin: impl FnOnce(usize, &Sender) -> Result<S, E>,
    ) -> Result<Admitted<'p>, E> {
        self.time.pass(placed.datagram.arrival_ns);
        self.idle();
        let admitted = self.sensors.admit_from(&placed.datagram, placed.topic);
        let number = self.all.len();
        if let Some(sensor) = self.sensors.senders().get(number) {
            let mut stream = begin(number, sensor)?;
            // It may have come before the first data packet.
            if let Some(position) = self.sensors.position(number) {
                stream.take(Some(position), placed);
            }
            self.all.push(stream);
        }
        let (sensors, packet) = match &admitted {
            Ok((Route::Data(index), packet)) => (SensorSet::from(Some(*index)), Some(packet)),
            Ok((Route::Position(sensors), packet)) => (*sensors, Some(packet)),
            Err(Refused { sensor, .. }) => (SensorSet::from(*sensor), None),
        };
        for index in sensors {
            if let Some(stream) = self.all.get_mut(index) {
                stream.take(packet, placed);
            }
        }
        Ok(admitted)
    }

    /// Nothing more is there at the moment: the streams may work ahead, and close what is silent.
    pub fn idle(&mut self) {
        for stream in &mut self.all {
            if stream.idle(self.time) {
                while let Some(sweep) = stream.next_sweep() {
                    self.silent.push_back(sweep);
                }
            }
        }
    }

    /// Nothing more comes: the last sweeps are closed.
    pub fn end(&mut self) {
        self.all.iter_mut().for_each(S::end);
    }

    /// The next sweep of any sensor that is whole.
    pub fn next_sweep(&mut self) -> Option<S::Sweep> {
        let silent = self.silent.pop_front();
        silent.or_else(|| self.all.iter_mut().find_map(S::next_sweep))
    }
}

/// How far the time has come, by times that follow each other. A single late one may be corrupt: of
/// two neighbours the earlier one counts.
#[derive(Clone, Copy, Debug, Default)]
pub struct SteadyTime {
    /// The one that counts.
    pub now_ns: i64,
    /// The last one, late or not.
    pub newest_ns: i64,
}

impl SteadyTime {
    /// Takes the next time, and says which one counts.
    pub fn pass(&mut self, next_ns: i64) -> i64 {
        self.now_ns = next_ns.min(self.newest_ns);
        self.newest_ns = next_ns;
        self.now_ns
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::convert::Infallible;
    use sweepd_core::wire::position::POSITION_PACKET_LEN;
    use sweepd_core::wire::{Content, DataPacket, Datagram};

    /// Writes down what it gets.
    #[derive(Default)]
    struct Log {
        taken: String,
        times_ns: Vec<i64>,
        sweeps: usize,
    }

    impl Stream for Log {
        type Sweep = String;

        fn take(&mut self, packet: Option<&Packet<'_>>, _: &Placed<'_>) {
            self.taken += match packet.map(|packet| packet.content) {
                Some(Content::Data(_)) => "d",
                Some(Content::Position(..)) => "p",
                None => "x",
            };
        }

        fn idle(&mut self, time: SteadyTime) -> bool {
            self.times_ns.push(time.now_ns);
            self.sweeps > 0
        }

        fn end(&mut self) {
            self.taken += ".";
        }

        fn next_sweep(&mut self) -> Option<String> {
            self.sweeps = self.sweeps.checked_sub(1)?;
            Some(self.taken.clone())
        }
    }

    fn begin(_: usize, _: &Sender) -> Result<Log, Infallible> {
        Ok(Log::default())
    }

    fn take(streams: &mut Streams<Log>, arrival_ns: i64, source: &str, payload: &[u8]) -> bool {
        let datagram = Datagram {
            arrival_ns,
            source: source.parse().unwrap(),
            destination_port: 2368,
            payload,
        };
        let Ok(admitted) = streams.take(&datagram.into(), begin);
        admitted.is_ok()
    }

    #[test]
    fn each_sensor_gets_its_packets_and_the_position_from_before_its_first() {
        let (packet, position) = (DataPacket::new(0, 0x37, 0x22), [0; POSITION_PACKET_LEN]);
        let mut broken = packet;
        broken.blocks[7].flag.set(0x1234);
        let mut streams = Streams::new(Vec::new());
        for (source, payload, is_admitted) in [
            ("10.0.0.1:8308", &position[..], true),
            ("10.0.0.1:2368", packet.emit(), true),
            ("10.0.0.2:2368", packet.emit(), true),
            ("10.0.0.1:2368", broken.emit(), false),
            ("10.0.0.3:2368", broken.emit(), false),
            ("10.0.0.2:8308", &position, true),
            ("10.0.0.1:2368", b"other", false),
        ] {
            let admitted = take(&mut streams, 0, source, payload);
            assert_eq!(admitted, is_admitted, "{source}");
        }
        streams.end();
        let taken: Vec<&str> = streams.all.iter().map(|log| &log.taken[..]).collect();
        assert_eq!(taken, ["pdx.", "dp."]);
        assert_eq!(streams.sensors.refusals().total(), 3);
    }

    #[test]
    fn a_single_late_time_does_not_count() {
        let packet = DataPacket::new(0, 0x37, 0x22);
        let mut streams = Streams::new(Vec::new());
        for arrival_ns in [5, 6, 99, 7, 98, 99] {
            take(&mut streams, arrival_ns, "10.0.0.1:2368", packet.emit());
        }
        assert_eq!(streams.all[0].times_ns, [5, 6, 7, 7, 98]);
    }

    #[test]
    fn sweeps_that_silence_closed_come_first_and_without_the_next_packet() {
        let packet = DataPacket::new(0, 0x37, 0x22);
        let mut streams = Streams::new(Vec::new());
        for source in ["10.0.0.1:2368", "10.0.0.2:2368"] {
            take(&mut streams, 0, source, packet.emit());
        }
        streams.all[1].sweeps = 2;
        take(&mut streams, 1, "10.0.0.2:2368", packet.emit());
        streams.all[0].sweeps = 1;
        streams.all[1].sweeps = 1;
        let sweeps: Vec<String> = std::iter::from_fn(|| streams.next_sweep()).collect();
        assert_eq!(sweeps, ["d", "d", "d", "dd"]);
    }
}
