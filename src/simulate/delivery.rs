//! What happens to datagrams between the sensor and the host: some are lost, some come twice, some change places.

use std::collections::VecDeque;
use std::ops::RangeInclusive;

use super::truth::SimulatedDatagram;

/// What goes wrong, by number of data packet; each list in ascending order.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Faults {
    /// Never arrive.
    pub lost: Vec<RangeInclusive<u64>>,
    /// Arrive twice, as through a switch that mirrors a port.
    pub duplicated: Vec<u64>,
    /// Arrive after the packet that follows them.
    pub swapped: Vec<u64>,
    /// Arrive with one bit flipped, counted from the lowest of the first byte. A Velodyne's datagrams have no checksum:
    /// nobody on the way would notice.
    pub corrupted: Vec<(u64, u16)>,
}

impl Faults {
    fn lose(&self, ordinal: u64) -> bool {
        let next = self.lost.partition_point(|range| *range.end() < ordinal);
        self.lost.get(next).is_some_and(|range| range.contains(&ordinal))
    }

    fn corrupt(&self, ordinal: u64, payload: &mut [u8]) {
        if let Ok(index) = self.corrupted.binary_search_by_key(&ordinal, |&(number, _)| number) {
            let bit = self.corrupted[index].1;
            if let Some(byte) = payload.get_mut(usize::from(bit / 8)) {
                *byte ^= 1 << (bit % 8);
            }
        }
    }

    /// Data packets that never arrive.
    pub fn lost_packets(&self) -> u64 {
        self.lost.iter().map(|range| range.end() - range.start() + 1).sum()
    }
}

impl std::fmt::Display for Faults {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let range = |range: &RangeInclusive<u64>| match (range.start(), range.end()) {
            (start, end) if start == end => start.to_string(),
            (start, end) => format!("{start}-{end}"),
        };
        let list = |numbers: Vec<String>| if numbers.is_empty() { "none".to_owned() } else { numbers.join(", ") };
        let singles = |numbers: &[u64]| list(numbers.iter().map(u64::to_string).collect());
        let lost = list(self.lost.iter().map(range).collect());
        let (twice, late) = (singles(&self.duplicated), singles(&self.swapped));
        write!(f, "lost: {lost}; twice: {twice}; after the next: {late}")
    }
}

/// The datagrams as they arrive. Position packets are left alone.
pub fn deliver<I: Iterator<Item = SimulatedDatagram>>(sent: I, faults: Faults) -> Delivery<I> {
    Delivery { sent, faults, ready: VecDeque::new() }
}

/// See [`deliver`].
pub struct Delivery<I> {
    sent: I,
    faults: Faults,
    ready: VecDeque<SimulatedDatagram>,
}

/// A second copy arrives this much later.
const COPY_DELAY_NS: i64 = 4_000;

impl<I: Iterator<Item = SimulatedDatagram>> Delivery<I> {
    /// Takes the datagrams up to and with the next data packet, and puts `held` behind it: the two exchange their
    /// places and their arrival times.
    fn swap(&mut self, mut held: SimulatedDatagram) {
        let start = self.ready.len();
        for mut next in self.sent.by_ref() {
            if next.truth.is_some() {
                std::mem::swap(&mut held.arrival_ns, &mut next.arrival_ns);
                self.ready.insert(start, next);
                break;
            }
            self.ready.push_back(next);
        }
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
            let Some(ordinal) = next.truth.as_ref().map(|truth| truth.ordinal) else { return Some(next) };
            if self.faults.lose(ordinal) {
                continue;
            }
            if self.faults.swapped.binary_search(&ordinal).is_ok() {
                self.swap(next);
                continue;
            }
            self.faults.corrupt(ordinal, &mut next.payload);
            if self.faults.duplicated.binary_search(&ordinal).is_ok() {
                self.ready.push_back(SimulatedDatagram { arrival_ns: next.arrival_ns + COPY_DELAY_NS, ..next.clone() });
            }
            return Some(next);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sensor::Model;
    use crate::simulate::{Emitter, EmitterConfig, Scene};
    use crate::wire::data::ReturnMode;

    #[test]
    fn faults_strike_where_they_are_told_to() {
        let scene = Scene::new([0.0; 2], 20);
        let mut config = EmitterConfig::new(Model::Vlp16, ReturnMode::Strongest);
        (config.packets, config.data_per_position) = (12, 5);
        let faults =
            Faults { lost: vec![1..=1, 6..=8], duplicated: vec![3], swapped: vec![4, 10], corrupted: vec![(9, 17)] };
        assert_eq!(faults.lost_packets(), 4);
        assert_eq!(faults.to_string(), "lost: 1, 6-8; twice: 3; after the next: 4, 10");
        let clean: Vec<_> = Emitter::new(config.clone(), &scene).collect();
        let came: Vec<_> = deliver(Emitter::new(config, &scene), faults).collect();
        let order: Vec<Option<u64>> = came.iter().map(|one| one.truth.as_ref().map(|truth| truth.ordinal)).collect();
        // A position packet follows data packets 4 and 9.
        let expected = [Some(0), Some(2), Some(3), Some(3), Some(5), None, Some(4), Some(9), None, Some(11), Some(10)];
        assert_eq!(order, expected);
        assert!(came.windows(2).all(|two| two[0].arrival_ns < two[1].arrival_ns));
        for one in came {
            let Some(truth) = &one.truth else { continue };
            let mut payload = clean.iter().find(|other| other.truth == one.truth).unwrap().payload.clone();
            // Bit 17 is the second of the third byte.
            payload[2] ^= if truth.ordinal == 9 { 2 } else { 0 };
            assert_eq!(one.payload, payload);
        }
    }
}
