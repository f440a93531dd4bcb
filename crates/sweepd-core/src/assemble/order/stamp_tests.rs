//! Stamps that are wrong, alone or from one packet on, for every model, return mode and speed.

use super::*;
use crate::sensor::{Model, ModelExt};
use crate::wire::HOUR_US;

/// Packets of a stream, and the one from which on something is wrong.
const PACKETS: usize = 60;
const STRUCK: usize = 40;
/// The encoder's noise, hundredths of a degree either way.
const NOISE_CDEG: f64 = 3.0;
/// A stamp that is off by at most this is within what the sensor's clock may be off.
const CORRECTION_US: i64 = 100;

/// A sensor whose head turns evenly, except for encoder noise.
#[derive(Clone, Copy, Debug)]
struct Stream {
    spec: &'static Spec,
    mode: ReturnMode,
    rpm: f64,
}

/// Every one that there may be.
fn streams() -> impl Iterator<Item = Stream> {
    let specs = Model::ALL.into_iter().flat_map(|model| model.specs());
    let modes =
        specs.flat_map(|&spec| [ReturnMode::Strongest, ReturnMode::Dual].map(|mode| (spec, mode)));
    modes.flat_map(|(spec, mode)| {
        [300.0, 600.0, -600.0, 1200.0].map(|rpm| Stream { spec, mode, rpm })
    })
}

impl Stream {
    /// The period of its packets, microseconds.
    fn period_us(&self) -> f64 {
        f64::from(self.spec.packet_period_ns(self.mode)) / 1e3
    }

    /// The largest correction of the clock that cannot be a lost packet.
    fn most_us(&self) -> i64 {
        match self.period_us() {
            short if short < 170.0 => (short / 2.0) as i64 - 1,
            _ => CORRECTION_US,
        }
    }

    /// Packets that come often say little of where they belong: if the stamp of one is wrong by one
    /// or two short periods, its neighbours look lost.
    fn may_be_loss(&self, off_us: i64) -> bool {
        let periods = off_us.abs() as f64 / self.period_us();
        self.period_us() < 170.0 && (0.7..2.3).contains(&periods)
    }

    /// Its packets; `off_us` is the error of each stamp, microseconds.
    fn packets(&self, off_us: impl Fn(usize) -> i64) -> Vec<DataPacket> {
        self.many(PACKETS, off_us)
    }

    /// This many of them.
    fn many(&self, count: usize, mut off_us: impl FnMut(usize) -> i64) -> Vec<DataPacket> {
        let mut noise = fastrand::Rng::with_seed(3);
        let rate_cdeg_us = self.rpm / 60e6 * 36_000.0;
        let azimuth_us = f64::from(self.spec.azimuth_period_ns(self.mode)) / 1e3;
        let each = |number: usize| {
            let begun_us = number as f64 * self.period_us();
            let stamp_us =
                (1_000_000 + begun_us as i64 + off_us(number)).rem_euclid(i64::from(HOUR_US));
            let mut packet = DataPacket::new(stamp_us as u32, 0x37, 0x22);
            for (index, blocks) in packet
                .blocks
                .chunks_mut(self.spec.places(self.mode).blocks)
                .enumerate()
            {
                let turned = rate_cdeg_us * (begun_us + azimuth_us * index as f64)
                    + NOISE_CDEG * (2.0 * noise.f64() - 1.0);
                blocks
                    .iter_mut()
                    .for_each(|block| block.set_azimuth_cdeg(turned.rem_euclid(36_000.0) as u16));
            }
            packet
        };
        (0..count).map(each).collect()
    }

    /// Whether a missing packet is ambiguous if the clock is corrected this far at the same moment:
    /// nearly half a packet period, or whole blocks, which also occur with a sector that is left
    /// out.
    fn is_ambiguous(&self, off_us: i64) -> bool {
        let block_us = f64::from(self.spec.azimuth_period_ns(self.mode)) / 1e3;
        let off_us = off_us.abs() as f64;
        let blocks = (off_us / block_us).round();
        off_us > 0.4 * self.period_us() || blocks != 0.0 && (off_us - blocks * block_us).abs() < 5.0
    }

    /// What comes out of these packets, in the order in which they arrive.
    fn run(&self, packets: &[DataPacket], arrive: impl IntoIterator<Item = usize>) -> Outcome {
        let mut order = PacketOrder::new(self.spec);
        let mut outcome = Outcome::default();
        for (place, number) in arrive.into_iter().enumerate() {
            let arrival_ns = (place as f64 * self.period_us() * 1e3) as i64;
            let pushed = order.push(&packets[number], self.mode, number as u64, arrival_ns);
            outcome.refused += u64::from(pushed.is_err());
            outcome.take(&mut order);
            let waiting = place + 1 - outcome.out.len() - outcome.refused as usize;
            outcome.waited = outcome.waited.max(waiting);
        }
        order.flush();
        outcome.take(&mut order);
        outcome.refused += order.counts().unconfirmed;
        outcome.reordered = order.counts().reordered;
        outcome
    }
}

/// What came out, and what did not.
#[derive(Debug, Default)]
struct Outcome {
    /// The numbers of the packets, and what lies before each.
    out: Vec<(usize, PacketGap)>,
    refused: u64,
    reordered: u64,
    /// Most packets that waited for another.
    waited: usize,
}

impl Outcome {
    fn take(&mut self, order: &mut PacketOrder) {
        while let Some((index, before)) = order.pop() {
            self.out.push((order.packet(index).number as usize, before));
        }
    }

    /// Whether all packets but these came out, only missing ones were refused, and no other was
    /// lost.
    fn is_all_but(&self, missing: &[usize], refused: u64) -> bool {
        let numbers = (0..PACKETS).filter(|number| !missing.contains(number));
        let lost_before =
            |number: usize| missing.iter().filter(|&&lost| lost + 1 == number).count() as u32;
        let fits = |&(number, before): &(usize, PacketGap)| match before {
            PacketGap::Start => number == 0,
            PacketGap::None => number > 0 && lost_before(number) == 0,
            PacketGap::Lost { packets, .. } => packets == lost_before(number),
            PacketGap::Blanked => false,
        };
        self.out.iter().map(|&(number, _)| number).eq(numbers)
            && self.out.iter().all(fits)
            && self.refused == refused
            && self.reordered == 0
    }

    /// The part around the wrong stamp, for messages.
    fn around(&self) -> String {
        let around = self
            .out
            .iter()
            .filter(|(number, _)| (STRUCK - 3..STRUCK + 6).contains(number));
        format!(
            "{:?}, {} refused, {} waited",
            around.collect::<Vec<_>>(),
            self.refused,
            self.waited
        )
    }
}

/// The packet comes out with a time that the sensor's clock could have, or is refused as if it had
/// been lost; nothing else changes.
#[test]
fn one_wrong_stamp_harms_no_other_packet() {
    let near = (-800..=800).step_by(5);
    let flipped = (0..32).flat_map(|bit| [1 << bit, -(1_i64 << bit)]);
    let offs: Vec<i64> = near.chain(flipped).filter(|&off_us| off_us != 0).collect();
    let mut wrong = Vec::new();
    for stream in streams() {
        for &off_us in &offs {
            let packets = stream.packets(|number| if number == STRUCK { off_us } else { 0 });
            let outcome = stream.run(&packets, 0..PACKETS);
            let is_slight = off_us.abs() <= CORRECTION_US.min(stream.period_us() as i64 / 4) + 1;
            let holds = is_slight && outcome.is_all_but(&[], 0) || outcome.is_all_but(&[STRUCK], 1);
            if !holds && !stream.may_be_loss(off_us) {
                wrong.push(format!(
                    "{off_us} us, {} {} {} rpm: {}",
                    stream.spec.model.name(),
                    stream.mode,
                    stream.rpm,
                    outcome.around()
                ));
            }
        }
    }
    assert!(
        wrong.is_empty(),
        "{} wrong, such as\n{}",
        wrong.len(),
        wrong[..wrong.len().min(20)].join("\n")
    );
}

/// The pulse per second corrects a drifting clock. No packet is lost by that, whichever packet is
/// missing or out of order at that moment, and at most one packet waits for the next.
#[test]
fn a_stamp_that_is_set_right_costs_nothing() {
    let all: Vec<usize> = (0..PACKETS).collect();
    let mut swapped = all.clone();
    swapped.swap(STRUCK, STRUCK + 1);
    let mut wrong = Vec::new();
    for stream in streams() {
        let Stream { spec, mode, rpm } = stream;
        let at_once_us = CORRECTION_US.min(stream.period_us() as i64 / 4) - 1;
        let most_us = stream.most_us();
        for off_us in (-most_us..=most_us).step_by(5) {
            let packets = stream.packets(|number| if number >= STRUCK { off_us } else { 0 });
            let mut expect = |what: &str, holds: bool, outcome: &Outcome| {
                if !holds {
                    wrong.push(format!(
                        "{what}, {off_us} us, {} {mode} {rpm} rpm: {}",
                        spec.model.name(),
                        outcome.around()
                    ));
                }
            };
            let outcome = stream.run(&packets, all.iter().copied());
            let patience = usize::from(off_us.abs() > at_once_us);
            expect(
                "in order",
                outcome.is_all_but(&[], 0) && outcome.waited <= patience,
                &outcome,
            );
            if stream.is_ambiguous(off_us) {
                continue;
            }
            for gone in [STRUCK - 1, STRUCK, STRUCK + 1] {
                let outcome = stream.run(
                    &packets,
                    all.iter().copied().filter(|&number| number != gone),
                );
                expect("one lost", outcome.is_all_but(&[gone], 0), &outcome);
            }
            let mut outcome = stream.run(&packets, swapped.iter().copied());
            let reordered = std::mem::take(&mut outcome.reordered);
            expect(
                "swapped",
                reordered == 1 && outcome.is_all_but(&[], 0),
                &outcome,
            );
        }
    }
    assert!(
        wrong.is_empty(),
        "{} wrong, such as\n{}",
        wrong.len(),
        wrong[..wrong.len().min(20)].join("\n")
    );
}

/// A sensor whose stamps are off the period by 40 us either way at every packet, or by a fifth of a
/// shorter period, loses some at first, then none.
#[test]
fn stamps_that_are_always_off_the_period_are_accepted() {
    const LONG: usize = 400;
    for stream in streams().filter(|stream| stream.rpm.abs() <= 600.0) {
        let mut noise = fastrand::Rng::with_seed(5);
        let most_us = 40.min(stream.period_us() as i64 / 5);
        let packets = stream.many(LONG, |_| noise.i64(-most_us..=most_us));
        let outcome = stream.run(&packets, 0..LONG);
        let late: Vec<_> = outcome
            .out
            .iter()
            .filter(|(number, _)| *number >= LONG / 2)
            .collect();
        let Stream {
            spec: Spec { model, .. },
            mode,
            rpm,
        } = stream;
        assert!(
            outcome.refused <= 24,
            "{model}, {mode:?}, {rpm} rpm: {} refused",
            outcome.refused
        );
        assert_eq!(late.len(), LONG / 2, "{model}, {mode:?}, {rpm} rpm");
        let follow = late
            .iter()
            .skip(1)
            .all(|(_, before)| *before == PacketGap::None);
        assert!(follow, "{model}, {mode:?}, {rpm} rpm");
    }
}
