//! Faults at random rates; the affected packets are chosen before the first one is sent.

use fastrand::Rng;

use super::damage::{PacketPart, other_length};
use super::delivery::Faults;

/// Rates of faults, each as a share of the data packets, 0 to 1.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rates {
    /// Packets lost one by one.
    pub loss: f64,
    /// Packets with which a burst of losses begins.
    pub burst_loss: f64,
    /// Packets lost in each burst.
    pub burst_len: u64,
    /// Packets that arrive twice.
    pub duplicate: f64,
    /// Packets that arrive after those behind them.
    pub reorder: f64,
    /// How many packets overtake them, at least 1.
    pub places: u64,
    /// Packets that are damaged.
    pub corrupt: f64,
    /// Where they are.
    pub part: PacketPart,
    /// Packets before which a datagram arrives that no sensor sent, tiny or jumbo.
    pub stray: f64,
}

impl Default for Rates {
    fn default() -> Self {
        let [loss, burst_loss, duplicate, reorder, corrupt, stray] = [0.0; 6];
        Self {
            loss,
            burst_loss,
            burst_len: 0,
            duplicate,
            reorder,
            places: 1,
            corrupt,
            part: PacketPart::Any,
            stray,
        }
    }
}

/// A random generator for each kind of fault, so that one rate does not change the packets of other
/// faults.
struct Dice {
    loss: Rng,
    burst: Rng,
    duplicate: Rng,
    reorder: Rng,
    corrupt: Rng,
    stray: Rng,
}

impl Dice {
    fn new(seed: u64) -> Self {
        Self {
            loss: dice(seed, 1),
            burst: dice(seed, 2),
            duplicate: dice(seed, 3),
            reorder: dice(seed, 4),
            corrupt: dice(seed, 5),
            stray: dice(seed, 6),
        }
    }
}

fn dice(seed: u64, kind: u64) -> Rng {
    Rng::with_seed(seed ^ kind.wrapping_mul(0xD1B5_4A32_D192_ED03))
}

impl Rates {
    /// The faults of a stream of this many data packets.
    ///
    /// The first and the last packet have no faults: without them a receiver could not know what is
    /// missing. A packet has at most one fault, and packets that overtake another have none, so
    /// that the receiver can count each fault.
    pub fn plan(&self, seed: u64, packets: u64) -> Faults {
        let places = self.places.max(1);
        let mut faults = Faults {
            places,
            ..Faults::default()
        };
        if [
            self.loss,
            self.burst_loss,
            self.duplicate,
            self.reorder,
            self.corrupt,
            self.stray,
        ] == [0.0; 6]
        {
            return faults;
        }
        let mut dice = Dice::new(seed);
        let mut burst_end = 0;
        // The packet that this one and others overtake, if possible.
        let mut waits: Option<u64> = None;
        for ordinal in 1..packets {
            let last = ordinal + 1 == packets;
            if dice.burst.f64() < self.burst_loss && ordinal >= burst_end {
                burst_end = ordinal + self.burst_len;
            }
            let lost = (dice.loss.f64() < self.loss || ordinal < burst_end) && !last;
            let twice = dice.duplicate.f64() < self.duplicate && !lost && !last;
            let late = dice.reorder.f64() < self.reorder && !lost && !twice && !last;
            let damage =
                (dice.corrupt.f64() < self.corrupt).then(|| self.part.damage(&mut dice.corrupt));
            let corrupt = damage.filter(|_| !lost && !twice && !last);
            let stray = (dice.stray.f64() < self.stray).then(|| other_length(&mut dice.stray));
            waits = waits.filter(|_| !lost && !twice && corrupt.is_none());
            let overtakes = waits.is_some();
            faults.strays.extend(
                stray
                    .filter(|_| !lost && !overtakes)
                    .map(|bytes| (ordinal, bytes)),
            );
            faults
                .swapped
                .extend(waits.take_if(|first| ordinal - *first == places));
            if lost {
                lose(&mut faults, ordinal);
            } else if twice {
                faults.duplicated.push(ordinal);
            } else if let Some(damage) = corrupt {
                faults.corrupted.push((ordinal, damage));
            }
            if late && corrupt.is_none() && !overtakes {
                waits = Some(ordinal);
            }
        }
        faults
    }
}

fn lose(faults: &mut Faults, ordinal: u64) {
    match faults.lost.last_mut() {
        Some(range) if range.end() + 1 == ordinal => *range = *range.start()..=ordinal,
        _ => faults.lost.push(ordinal..=ordinal),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const ALL: Rates = Rates {
        loss: 0.05,
        burst_loss: 0.002,
        burst_len: 7,
        duplicate: 0.04,
        reorder: 0.03,
        places: 1,
        corrupt: 0.02,
        part: PacketPart::Any,
        stray: 0.01,
    };

    #[test]
    fn no_rate_is_no_fault_and_a_rate_is_met() {
        let none = Rates {
            burst_len: 5,
            ..Rates::default()
        }
        .plan(1, 1000);
        assert_eq!(
            none,
            Faults {
                places: 1,
                ..Faults::default()
            }
        );
        let near = |count: u64, share: f64| (count as f64 / 1e5 - share).abs() < 0.1 * share;
        assert!(near(
            Rates {
                loss: 0.05,
                ..Rates::default()
            }
            .plan(1, 100_000)
            .lost_packets(),
            0.05
        ));
        let bursts = Rates {
            burst_loss: 0.002,
            burst_len: 10,
            ..Rates::default()
        }
        .plan(1, 100_000);
        assert!(
            bursts
                .lost
                .iter()
                .all(|range| (range.end() - range.start() + 1).is_multiple_of(10))
        );
        assert!(
            near(bursts.lost_packets(), 0.02),
            "{}",
            bursts.lost_packets()
        );
        let faults = ALL.plan(1, 100_000);
        assert!(
            near(faults.duplicated.len() as u64, 0.04 * 0.93),
            "{}",
            faults.duplicated.len()
        );
        assert!(
            near(faults.corrupted.len() as u64, 0.02 * 0.9),
            "{}",
            faults.corrupted.len()
        );
        assert!(
            near(faults.strays.len() as u64, 0.01 * 0.9),
            "{}",
            faults.strays.len()
        );
        assert!(
            near(faults.swapped.len() as u64, 0.03 * 0.88 * 0.88),
            "{}",
            faults.swapped.len()
        );
    }

    #[test]
    fn a_packet_suffers_one_fault_and_the_ends_none() {
        let overtakes = |faults: &Faults, one: u64| {
            faults
                .swapped
                .iter()
                .any(|&first| (first + 1..=first + faults.places).contains(&one))
        };
        for (seed, rates) in [
            (1, ALL),
            (2, Rates { loss: 1.0, ..ALL }),
            (
                3,
                Rates {
                    reorder: 1.0,
                    places: 3,
                    ..ALL
                },
            ),
        ] {
            let faults = rates.plan(seed, 5_000);
            let mut struck: Vec<u64> = faults.lost.iter().cloned().flatten().collect();
            struck.extend(&faults.duplicated);
            struck.extend(
                faults
                    .swapped
                    .iter()
                    .flat_map(|&one| one..=one + rates.places),
            );
            struck.extend(faults.corrupted.iter().map(|&(one, _)| one));
            assert!(
                faults
                    .strays
                    .iter()
                    .all(|&(one, _)| !overtakes(&faults, one))
            );
            let count = struck.len();
            struck.sort();
            struck.dedup();
            assert_eq!(struck.len(), count, "none twice");
            assert!(!struck.contains(&0) && struck.iter().all(|&one| one < 5_000));
            assert!(faults.lost_packets() < 4_999);
            assert_eq!(faults, rates.plan(seed, 5_000));
            assert_ne!(faults.duplicated, ALL.plan(seed + 9, 5_000).duplicated);
        }
        for packets in 0..4 {
            ALL.plan(1, packets);
        }
    }

    #[test]
    fn one_rate_does_not_move_the_others() {
        let alone = Rates {
            loss: 0.05,
            ..Rates::default()
        }
        .plan(4, 10_000);
        let beside = Rates {
            loss: 0.05,
            duplicate: 0.2,
            corrupt: 0.1,
            ..Rates::default()
        }
        .plan(4, 10_000);
        assert_eq!(alone.lost, beside.lost);
    }
}
