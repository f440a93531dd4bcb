//! Faults between the sensor and the host: datagrams that are lost, duplicated, reordered,
//! corrupted, or not sent by a sensor.

use std::collections::VecDeque;
use std::ops::RangeInclusive;

use super::damage::Damage;
use super::truth::SimulatedDatagram;

/// Faults by number of data packet; each list in ascending order.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Faults {
    /// Never arrive.
    pub lost: Vec<RangeInclusive<u64>>,
    /// Arrive twice, as through a switch that mirrors a port.
    pub duplicated: Vec<u64>,
    /// Arrive after the packets that follow them.
    pub swapped: Vec<u64>,
    /// How many packets overtake them: 0 and 1 mean one.
    pub places: u64,
    /// Arrive damaged.
    pub corrupted: Vec<(u64, Damage)>,
    /// Before these arrives a datagram of this many bytes that no sensor sent, from its address and
    /// to its port.
    pub strays: Vec<(u64, u16)>,
}

impl Faults {
    fn lose(&self, ordinal: u64) -> bool {
        let next = self.lost.partition_point(|range| *range.end() < ordinal);
        self.lost
            .get(next)
            .is_some_and(|range| range.contains(&ordinal))
    }

    fn corrupt(&self, ordinal: u64, payload: &mut Vec<u8>) {
        if let Ok(index) = self
            .corrupted
            .binary_search_by_key(&ordinal, |&(number, _)| number)
        {
            self.corrupted[index].1.apply(payload);
        }
    }

    /// What arrives before a packet.
    fn stray(&self, next: &SimulatedDatagram, ordinal: u64) -> Option<SimulatedDatagram> {
        let index = self
            .strays
            .binary_search_by_key(&ordinal, |&(number, _)| number)
            .ok()?;
        let mut payload = next.payload.clone();
        Damage::Length(self.strays[index].1).apply(&mut payload);
        Some(SimulatedDatagram {
            payload,
            truth: None,
            arrival_ns: next.arrival_ns - STRAY_AHEAD_NS,
            ..*next
        })
    }

    /// How many there are of each kind, in words.
    pub fn summary(&self) -> String {
        format!(
            "lost {}, duplicated {}, reordered {}, corrupted {}, strays {}",
            self.lost_packets(),
            self.duplicated.len(),
            self.swapped.len(),
            self.corrupted.len(),
            self.strays.len()
        )
    }

    /// Data packets that never arrive.
    pub fn lost_packets(&self) -> u64 {
        self.lost
            .iter()
            .map(|range| range.end() - range.start() + 1)
            .sum()
    }
}

impl std::fmt::Display for Faults {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let lost = self.lost.iter().map(|range| match range.start() {
            start if start == range.end() => start.to_string(),
            start => format!("{start}-{}", range.end()),
        });
        let lost = list(lost);
        let twice = list(self.duplicated.iter().map(u64::to_string));
        let late = list(self.swapped.iter().map(u64::to_string));
        write!(f, "lost: {lost}; twice: {twice}; after the next: {late}")
    }
}

fn list(numbers: impl Iterator<Item = String>) -> String {
    let numbers: Vec<String> = numbers.collect();
    if numbers.is_empty() {
        "none".to_owned()
    } else {
        numbers.join(", ")
    }
}

/// The datagrams as they arrive. Position packets are left alone.
pub fn deliver<I: Iterator<Item = SimulatedDatagram>>(sent: I, faults: Faults) -> Delivery<I> {
    Delivery {
        sent,
        faults,
        ready: VecDeque::new(),
    }
}

/// See [`deliver`].
pub struct Delivery<I> {
    sent: I,
    faults: Faults,
    ready: VecDeque<SimulatedDatagram>,
}

/// A second copy arrives this much later.
const COPY_DELAY_NS: i64 = 4_000;
/// A stray datagram arrives this much before the packet behind it.
const STRAY_AHEAD_NS: i64 = 3_000;

impl<I: Iterator<Item = SimulatedDatagram>> Delivery<I> {
    /// Takes the datagrams up to and including the next data packets, and puts `held` behind them;
    /// each takes the arrival time of the one before.
    fn swap(&mut self, mut held: SimulatedDatagram) {
        let mut behind = VecDeque::new();
        for _ in 0..self.faults.places.max(1) {
            for mut next in self.sent.by_ref() {
                if next.truth.is_some() {
                    std::mem::swap(&mut held.arrival_ns, &mut next.arrival_ns);
                    self.ready.push_back(next);
                    break;
                }
                behind.push_back(next);
            }
        }
        self.ready.append(&mut behind);
        self.ready.push_back(held);
    }
}

impl<I: Iterator<Item = SimulatedDatagram>> Iterator for Delivery<I> {
    type Item = SimulatedDatagram;

    fn next(&mut self) -> Option<SimulatedDatagram> {
        loop {
            if let Some(ready) = self.ready.pop_front() {
                return Some(ready);
            }
            let mut next = self.sent.next()?;
            let Some(ordinal) = next.truth.as_ref().map(|truth| truth.ordinal) else {
                return Some(next);
            };
            if self.faults.lose(ordinal) {
                continue;
            }
            if let Some(stray) = self.faults.stray(&next, ordinal) {
                self.ready.push_back(stray);
            }
            if self.faults.swapped.binary_search(&ordinal).is_ok() {
                self.swap(next);
                continue;
            }
            self.faults.corrupt(ordinal, &mut next.payload);
            if self.faults.duplicated.binary_search(&ordinal).is_ok() {
                let copy = SimulatedDatagram {
                    arrival_ns: next.arrival_ns + COPY_DELAY_NS,
                    ..next.clone()
                };
                self.ready.extend([next, copy]);
            } else {
                self.ready.push_back(next);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::simulate::{Emitter, EmitterConfig, Scene};
    use sweepd_core::sensor::Model;
    use sweepd_core::wire::data::ReturnMode;

    #[test]
    fn faults_affect_the_planned_packets() {
        let scene = Scene::new([0.0; 2], 20);
        let mut config = EmitterConfig::new(Model::Vlp16, ReturnMode::Strongest);
        (config.packets, config.data_per_position) = (12, 5);
        let faults = Faults {
            lost: vec![1..=1, 6..=8],
            duplicated: vec![3],
            swapped: vec![4, 10],
            corrupted: vec![(9, Damage::Bit(17))],
            ..Faults::default()
        };
        assert_eq!(faults.lost_packets(), 4);
        assert_eq!(
            faults.to_string(),
            "lost: 1, 6-8; twice: 3; after the next: 4, 10"
        );
        let clean: Vec<_> = Emitter::new(config.clone(), &scene).collect();
        let came: Vec<_> = deliver(Emitter::new(config, &scene), faults).collect();
        let order: Vec<Option<u64>> = came
            .iter()
            .map(|one| one.truth.as_ref().map(|truth| truth.ordinal))
            .collect();
        // A position packet follows data packets 4 and 9.
        let expected = [
            Some(0),
            Some(2),
            Some(3),
            Some(3),
            Some(5),
            None,
            Some(4),
            Some(9),
            None,
            Some(11),
            Some(10),
        ];
        assert_eq!(order, expected);
        assert!(
            came.windows(2)
                .all(|two| two[0].arrival_ns < two[1].arrival_ns)
        );
        for one in came {
            let Some(truth) = &one.truth else { continue };
            let mut payload = clean
                .iter()
                .find(|other| other.truth == one.truth)
                .unwrap()
                .payload
                .clone();
            // Bit 17 is the second of the third byte.
            payload[2] ^= if truth.ordinal == 9 { 2 } else { 0 };
            assert_eq!(one.payload, payload);
        }
    }
    #[test]
    fn a_packet_may_be_late_by_places_and_strays_come_between() {
        let scene = Scene::new([0.0; 2], 20);
        let mut config = EmitterConfig::new(Model::Vlp16, ReturnMode::Strongest);
        (config.packets, config.data_per_position) = (8, 100);
        let swapped = vec![1];
        let strays = vec![(0, 3), (6, 9_000)];
        let faults = Faults {
            swapped,
            places: 3,
            strays,
            ..Faults::default()
        };
        let came: Vec<_> = deliver(Emitter::new(config, &scene), faults).collect();
        let order: Vec<Option<u64>> = came
            .iter()
            .map(|one| one.truth.as_ref().map(|truth| truth.ordinal))
            .collect();
        let [a, b, c, d, e, f, g, h] = std::array::from_fn(|n| Some(n as u64));
        assert_eq!(order, [None, a, c, d, e, b, f, None, g, h]);
        assert_eq!((came[0].payload.len(), came[7].payload.len()), (3, 9_000));
        assert!(
            came.windows(2)
                .all(|two| two[0].arrival_ns < two[1].arrival_ns)
        );
    }
}
