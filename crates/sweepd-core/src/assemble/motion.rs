//! The head's motion during one packet: its azimuth at each firing, its speed, and a sector that
//! was left out.

use std::ops::Add;

use super::lanes::Records;
use crate::sensor::model::{Places, Spec};
use crate::wire::data::{BLOCKS, ReturnMode, TURN_CDEG};
use crate::wire::{DataPacket, HOUR_US};

/// A whole turn, hundredths of a degree.
pub const TURN: f64 = TURN_CDEG as f64;
/// How far the encoder's noise can carry the first azimuth of a packet from the last one,
/// hundredths of a degree.
const STEP_NOISE_CDEG: f64 = 8.0;
/// Greatest difference of a packet's turning rate from that of the packets before, as a share.
const STEADY_SHARE: f64 = 0.02;
/// The fastest head turns half around in this time, nanoseconds.
const HALF_TURN_NS: i64 = 20_000_000;
/// A step between block azimuths that differs this much from the others is not motion of the head.
const BREAK_CDEG: f64 = 200.0;
/// With little encoder noise no step differs this much from the others; steps that do are checked
/// closely.
const BEND_CDEG: f64 = 16.0;
/// The same where there are only two steps, too few to estimate the noise.
const BEND_OF_TWO_CDEG: f64 = 40.0;
/// A step whose deviation is this many times the third largest does not come from encoder noise.
const BEND_NOISE: f64 = 4.0;
/// A head that turns at least this far from block to block turns: this is more than encoder noise,
/// hundredths of a degree.
const TURNING_CDEG: f64 = 5.0;
/// A head that turns less than this from block to block does not leave a sector out: it would take
/// seconds.
const LEAST_STEP_CDEG: f64 = 1.0;

/// A sector that the sensor is set to leave out, inside a packet or between two.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sector {
    /// Where the head was when it fell silent, hundredths of a degree.
    pub from_cdeg: f64,
    /// How far it turned in silence, in the sense of rotation, hundredths of a degree.
    pub width_cdeg: f64,
}

impl Sector {
    /// Travel from an azimuth to the sector, hundredths of a degree; slightly negative when encoder
    /// noise puts the azimuth past the edge.
    pub fn ahead_of(&self, from_cdeg: f64, sense: f64) -> f64 {
        let way = ahead(from_cdeg, self.from_cdeg, sense);
        if way > TURN - BREAK_CDEG {
            way - TURN
        } else {
            way
        }
    }

    /// Nanoseconds of silence when the head crosses the sector at a rate. The lasers keep their
    /// period during the silence (measured on a VLP-32C), so that it is a whole number of blocks;
    /// not where they rest for a random time after each firing.
    pub fn silent_ns(&self, rate_cdeg_ns: f64, spec: &Spec, mode: ReturnMode) -> i64 {
        let block_ns = spec.azimuth_period_ns(mode);
        let blocks =
            self.width_cdeg / (rate_cdeg_ns.abs() * f64::from(block_ns)).max(f64::MIN_POSITIVE);
        let blocks = blocks.min(1e6);
        if spec.firing_deviation_ns(mode) > 0.0 {
            return (blocks * f64::from(block_ns)) as i64;
        }
        blocks.round() as i64 * i64::from(block_ns)
    }
}

/// Times of the firings in a packet, computed from model and return mode once per packet.
#[derive(Clone, Copy, Debug)]
pub struct FiringTiming {
    /// Firings of a packet.
    pub firings: usize,
    /// Where the returns of each azimuth are.
    pub places: Places,
    /// From one firing to the next, nanoseconds.
    pub period_ns: i64,
    channels: usize,
    /// Firings that share an azimuth, as a power of two.
    sharing: u32,
    /// What each of them has of the way to the next azimuth.
    share: f64,
}

impl FiringTiming {
    /// Of a model's packets with this return mode.
    pub fn new(spec: &Spec, mode: ReturnMode) -> Self {
        Self {
            firings: spec.firings_per_packet(mode),
            places: spec.places(mode),
            period_ns: i64::from(spec.firing_period_ns(mode)),
            channels: spec.channels,
            sharing: spec.firings_per_azimuth().ilog2(),
            share: 1.0 / spec.firings_per_azimuth() as f64,
        }
    }

    /// The first block of a firing.
    pub fn block(&self, firing: usize) -> usize {
        self.azimuth(firing) * self.places.blocks
    }

    /// The records of a firing.
    pub fn records<'a>(&self, packet: &'a DataPacket, firing: usize) -> Records<'a> {
        Records {
            blocks: &packet.blocks[self.block(firing)..][..self.places.blocks],
            bank_step: self.places.bank_step,
            first: self.behind(firing) * self.channels,
        }
    }

    /// Index of the azimuth of a firing.
    fn azimuth(&self, firing: usize) -> usize {
        firing >> self.sharing
    }

    /// Number of firings before it at the same azimuth.
    fn behind(&self, firing: usize) -> usize {
        firing & ((1 << self.sharing) - 1)
    }
}

/// The motion of the head during one packet.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Motion {
    mode: ReturnMode,
    /// Azimuths that the packet gives: one for all blocks of a firing.
    azimuths: [u16; BLOCKS],
    count: usize,
    /// From one azimuth to the next, hundredths of a degree, negative when the head turns the other
    /// way; 0 for a packet with one azimuth until [`Motion::steady`] is called.
    pub step_cdeg: f64,
    /// The step by the packets before, without encoder noise; see [`Motion::steady`].
    steady_step_cdeg: Option<f64>,
    /// The index of the first azimuth behind a sector that was left out, and the sector.
    pub left_out: Option<(usize, Sector)>,
    /// Nanoseconds of silence inside the packet. The packet alone gives it to a few percent; a
    /// caller that knows the speed better may set it.
    pub silent_ns: i64,
}

/// Why a packet cannot come from a turning head.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum Implausible {
    /// Blocks of one firing that do not share its azimuth.
    #[error("the blocks of one firing have one azimuth, these do not")]
    Unpaired,
    /// Azimuths that jump more than once.
    #[error("the azimuths jump to and fro")]
    Jumps,
    /// One azimuth that lies beside the line of the others.
    #[error("one azimuth lies beside the line of the others")]
    Bent,
}

impl Motion {
    /// Reads the azimuths of a packet.
    ///
    /// # Errors
    /// [`Implausible`] if no head turns like that, not even with a limited field of view.
    pub fn of(packet: &DataPacket, mode: ReturnMode, spec: &Spec) -> Result<Self, Implausible> {
        let Places {
            blocks,
            azimuths: count,
            ..
        } = spec.places(mode);
        if !packet.azimuths_in_groups(blocks, count) {
            return Err(Implausible::Unpaired);
        }
        let mut azimuths = [0; BLOCKS];
        let first_blocks = packet.blocks.iter().step_by(blocks);
        for (azimuth, block) in azimuths[..count].iter_mut().zip(first_blocks) {
            *azimuth = block.azimuth_cdeg();
        }
        let mut steps = [0.0; BLOCKS - 1];
        let steps = &mut steps[..count - 1];
        for (step, pair) in steps.iter_mut().zip(azimuths.windows(2)) {
            *step = shortest(f64::from(pair[1]) - f64::from(pair[0]));
        }
        let Steps {
            step_cdeg,
            break_at,
        } = Steps::of(steps)?;
        let left_out = break_at.map(|index| {
            let from_cdeg = (f64::from(azimuths[index - 1]) + step_cdeg).rem_euclid(TURN);
            let width_cdeg = ahead(from_cdeg, f64::from(azimuths[index]), step_cdeg);
            let sector = Sector {
                from_cdeg,
                width_cdeg,
            };
            (index, sector)
        });
        let rate = step_cdeg / f64::from(spec.azimuth_period_ns(mode));
        let silent_ns = left_out.map_or(0, |(_, sector)| sector.silent_ns(rate, spec, mode));
        Ok(Self {
            mode,
            azimuths,
            count,
            step_cdeg,
            steady_step_cdeg: None,
            left_out,
            silent_ns,
        })
    }

    /// Sets the turning rate of the packets before, hundredths of a degree a nanosecond. It is used
    /// unless the azimuths of this packet contradict it: they carry encoder noise, and there may be
    /// only three, or one, which says nothing.
    pub fn steady(&mut self, rate_cdeg_ns: f64, spec: &Spec) {
        let step_cdeg = rate_cdeg_ns * f64::from(spec.azimuth_period_ns(self.mode));
        if self.count == 1 {
            self.step_cdeg = step_cdeg;
            return;
        }
        let noise_cdeg = STEP_NOISE_CDEG / (self.count - 1) as f64;
        let agrees =
            (step_cdeg - self.step_cdeg).abs() < noise_cdeg + STEADY_SHARE * step_cdeg.abs();
        self.steady_step_cdeg = agrees.then_some(step_cdeg);
    }

    /// Whether the packet gives one azimuth, which does not tell how fast the head turns.
    pub fn is_single(&self) -> bool {
        self.count == 1
    }

    fn best_step_cdeg(&self) -> f64 {
        self.steady_step_cdeg.unwrap_or(self.step_cdeg)
    }

    /// Azimuth of the first firing, hundredths of a degree.
    pub fn first_cdeg(&self) -> f64 {
        f64::from(self.azimuths[0])
    }

    /// Azimuth where the packet after this one should begin, hundredths of a degree.
    pub fn next_cdeg(&self) -> f64 {
        within_turn(f64::from(self.azimuths[self.count - 1]) + self.step_cdeg)
    }

    /// Nanoseconds that the head needs to cross `width_cdeg` at this packet's speed; 0 when it
    /// stands still.
    pub fn crossing_ns(&self, width_cdeg: f64, spec: &Spec) -> i64 {
        if self.step_cdeg.abs() < 0.1 {
            return 0;
        }
        (width_cdeg / self.step_cdeg.abs() * f64::from(spec.azimuth_period_ns(self.mode))) as i64
    }

    /// Turning rate, hundredths of a degree a nanosecond.
    pub fn rate_cdeg_ns(&self, spec: &Spec) -> f64 {
        self.best_step_cdeg() / f64::from(spec.azimuth_period_ns(self.mode))
    }

    /// Azimuth at the first shot of a firing, hundredths of a degree, 0..36000. A firing that has
    /// no azimuth of its own (the second of a VLP-16 block) gets it from the turning rate: single
    /// steps carry the encoder's noise.
    pub fn azimuth_cdeg(&self, firing: usize, timing: &FiringTiming) -> f64 {
        let within = timing.behind(firing) as f64 * timing.share;
        within_turn(
            f64::from(self.azimuths[timing.azimuth(firing)]) + self.best_step_cdeg() * within,
        )
    }

    /// First shot of a firing after that of the packet, nanoseconds.
    pub fn offset_ns(&self, firing: usize, timing: &FiringTiming) -> i64 {
        let fired = timing.period_ns * firing as i64;
        match self.left_out {
            Some((index, _)) if timing.azimuth(firing) >= index => fired + self.silent_ns,
            _ => fired,
        }
    }

    /// Whether a sector was left out between the firing before and this one.
    pub fn skips_sector_before(&self, firing: usize, timing: &FiringTiming) -> bool {
        self.left_out
            .is_some_and(|(index, _)| firing == index << timing.sharing)
    }
}

/// Turning rate from the first azimuth of one packet to the last of another of the same mode,
/// hundredths of a degree a nanosecond; `None` if the time between is too short, or long enough for
/// half a turn.
pub fn rate_between(
    first: &DataPacket,
    last: &DataPacket,
    mode: ReturnMode,
    spec: &Spec,
) -> Option<f64> {
    let us = i64::from(last.stamp_us()) - i64::from(first.stamp_us());
    let places = spec.places(mode);
    let steps = places.azimuths - 1;
    let lasted_ns = us.rem_euclid(i64::from(HOUR_US)) * 1000
        + steps as i64 * i64::from(spec.azimuth_period_ns(mode));
    let turned = f64::from(last.blocks[steps * places.blocks].azimuth_cdeg())
        - f64::from(first.blocks[0].azimuth_cdeg());
    (0..HALF_TURN_NS)
        .contains(&lasted_ns)
        .then(|| shortest(turned) / lasted_ns.max(1) as f64)
}

/// The same angle within 0..36000 hundredths of a degree. For angles within a turn of that it
/// avoids the division of `rem_euclid`.
pub(super) fn within_turn(cdeg: f64) -> f64 {
    match cdeg {
        _ if (0.0..TURN).contains(&cdeg) => cdeg,
        _ if (TURN..2.0 * TURN).contains(&cdeg) => cdeg - TURN,
        _ if cdeg < 0.0 && cdeg > -TURN => cdeg + TURN,
        _ => cdeg.rem_euclid(TURN),
    }
}

/// The same angle within -18000..18000 hundredths of a degree.
pub(super) fn shortest(cdeg: f64) -> f64 {
    within_turn(cdeg + TURN / 2.0) - TURN / 2.0
}

/// From one azimuth ahead to another in the sense of rotation, 0..36000 hundredths of a degree.
pub(super) fn ahead(from_cdeg: f64, to_cdeg: f64, sense: f64) -> f64 {
    let sign = if sense < 0.0 { -1.0 } else { 1.0 };
    within_turn((to_cdeg - from_cdeg) * sign)
}

/// The steps from azimuth to azimuth of a packet, checked.
struct Steps {
    /// The mean of all but the break, hundredths of a degree.
    step_cdeg: f64,
    /// Index of the azimuth behind the one step that is not motion of the head.
    break_at: Option<usize>,
}

impl Steps {
    fn of(steps: &[f64]) -> Result<Self, Implausible> {
        let least = steps.iter().copied().fold(f64::MAX, f64::min);
        let most = steps.iter().copied().fold(f64::MIN, f64::max);
        if steps.len() < 2 || most - least <= BEND_CDEG {
            // All are alike: none is a break. `sum` would begin at -0, which is a sense of rotation.
            let sum = steps.iter().copied().fold(0.0, Add::add);
            return Ok(Self {
                step_cdeg: sum / steps.len().max(1) as f64,
                break_at: None,
            });
        }
        let median = median(steps);
        let mut sum = 0.0;
        let mut kept = 0;
        let mut break_at = None;
        for (index, &step) in steps.iter().enumerate() {
            if !is_break(step, median) {
                sum += step;
                kept += 1;
            } else if break_at.replace(index + 1).is_some() {
                return Err(Implausible::Jumps);
            }
        }
        if is_bent(steps, median) {
            return Err(Implausible::Bent);
        }
        let step_cdeg = sum / f64::from(kept.max(1));
        if break_at.is_some() && step_cdeg.abs() < LEAST_STEP_CDEG {
            return Err(Implausible::Jumps);
        }
        Ok(Self {
            step_cdeg,
            break_at,
        })
    }
}

/// Whether a step cannot be motion of a head whose steps have this median.
fn is_break(step: f64, median: f64) -> bool {
    (step - median).abs() > BREAK_CDEG.max(5.0 * median.abs())
}

/// How far a step is from the median; 0 for a break, which is judged elsewhere.
fn deviation(step: f64, median: f64) -> f64 {
    if is_break(step, median) {
        0.0
    } else {
        step - median
    }
}

/// Whether one azimuth is so far off the line of the others that a bit of it must be flipped. Then
/// the step to it and the step from it are off in opposite directions. Since a flipped bit spoils
/// two steps, the third largest deviation measures the noise.
fn is_bent(steps: &[f64], median: f64) -> bool {
    let mut sorted = [0.0; BLOCKS];
    let sorted = &mut sorted[..steps.len()];
    for (sorted, &step) in sorted.iter_mut().zip(steps) {
        *sorted = deviation(step, median).abs();
    }
    sorted.sort_by(f64::total_cmp);
    let limit = match sorted.len() {
        ..3 => BEND_OF_TWO_CDEG,
        count => BEND_CDEG + BEND_NOISE * sorted[count - 3],
    };
    // The first and last azimuths have one step only; it may be shorter because the head was
    // stopped or started.
    let slowed = -BEND_CDEG..=median.abs();
    let is_end_bent = [steps[0], steps[steps.len() - 1]].into_iter().any(|step| {
        deviation(step, median).abs() > limit
            && !slowed.contains(&(step * median.signum()))
            && median.abs() >= TURNING_CDEG
    });
    is_end_bent
        || steps.windows(2).any(|pair| {
            let before = deviation(pair[0], median);
            let behind = deviation(pair[1], median);
            before.abs() > limit && behind.abs() > limit && before * behind < 0.0
        })
}

/// The median of the steps by length; of two steps the shorter, since the other may be a skip.
fn median(values: &[f64]) -> f64 {
    let mut sorted = [0.0; BLOCKS];
    let sorted = &mut sorted[..values.len()];
    sorted.copy_from_slice(values);
    sorted.sort_by(|a, b| a.abs().total_cmp(&b.abs()));
    sorted[(sorted.len() - 1) / 2]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sensor::{Model, ModelExt};

    const SPEC: &Spec = Spec::of(Model::Vlp16);

    fn packet(azimuths: [u16; 12]) -> DataPacket {
        let mut packet = DataPacket::new(0, 0x37, 0x22);
        for (block, azimuth) in packet.blocks.iter_mut().zip(azimuths) {
            block.set_azimuth_cdeg(azimuth);
        }
        packet
    }

    /// A public VLP-16 packet: the turn ends between blocks 7 and 8.
    const WRAPS: [u16; 12] = [
        35_695, 35_733, 35_773, 35_813, 35_853, 35_891, 35_931, 35_971, 11, 51, 91, 131,
    ];

    #[test]
    fn the_second_firing_of_a_block_is_interpolated_and_may_wrap_alone() {
        let timing = &FiringTiming::new(SPEC, ReturnMode::Strongest);
        let motion = Motion::of(&packet(WRAPS), ReturnMode::Strongest, SPEC).unwrap();
        // 436 hundredths in eleven steps.
        assert!((motion.step_cdeg - 436.0 / 11.0).abs() < 1e-9);
        assert_eq!(motion.azimuth_cdeg(14, timing), 35_971.0);
        assert!((motion.azimuth_cdeg(15, timing) - (35_971.0 + 218.0 / 11.0)).abs() < 1e-9);
        let mut late = WRAPS;
        late[7] = 35_985;
        let motion = Motion::of(&packet(late), ReturnMode::Strongest, SPEC).unwrap();
        assert!(motion.azimuth_cdeg(15, timing) < 10.0);
    }

    #[test]
    fn a_limited_field_of_view_is_one_jump_ahead_and_takes_time() {
        let mut azimuths = [0; 12];
        for (index, azimuth) in azimuths.iter_mut().enumerate() {
            *azimuth = if index < 5 { 9_000 } else { 26_800 } + 40 * index as u16;
        }
        let timing = &FiringTiming::new(SPEC, ReturnMode::Strongest);
        let motion = Motion::of(&packet(azimuths), ReturnMode::Strongest, SPEC).unwrap();
        let (index, sector) = motion.left_out.unwrap();
        assert_eq!(
            (index, sector.from_cdeg, sector.width_cdeg),
            (5, 9_200.0, 17_800.0)
        );
        // 178 degrees at 40 hundredths a block of 110.592 us: 445 blocks.
        assert_eq!(motion.silent_ns, 445 * 110_592);
        assert_eq!(motion.offset_ns(9, timing), 9 * 55_296);
        assert_eq!(motion.offset_ns(10, timing), (10 + 890) * 55_296);
        assert!(motion.skips_sector_before(10, timing) && !motion.skips_sector_before(11, timing));
    }

    #[test]
    fn a_corrupt_azimuth_is_no_field_of_view() {
        let mut azimuths = WRAPS;
        azimuths[4] = 20_000;
        assert_eq!(
            Motion::of(&packet(azimuths), ReturnMode::Strongest, SPEC),
            Err(Implausible::Jumps)
        );
        assert_eq!(
            Motion::of(&packet(WRAPS), ReturnMode::Dual, SPEC),
            Err(Implausible::Unpaired)
        );
    }

    #[test]
    fn an_angle_comes_within_a_turn_as_by_division() {
        let row_offsets = [-2.0, -1.0, 0.0, 1.0, 2.0].map(|row_offsets| row_offsets * TURN);
        let near = |cdeg: f64| {
            [
                cdeg,
                cdeg.next_down(),
                cdeg.next_up(),
                cdeg - 0.25,
                cdeg + 12_345.678,
            ]
        };
        for cdeg in row_offsets.into_iter().flat_map(near) {
            assert_eq!(
                within_turn(cdeg).to_bits(),
                cdeg.rem_euclid(TURN).to_bits(),
                "{cdeg}"
            );
        }
    }

    #[test]
    fn a_head_may_turn_backwards_or_not_at_all() {
        let mut azimuths = WRAPS;
        azimuths.reverse();
        let backwards = Motion::of(&packet(azimuths), ReturnMode::Strongest, SPEC).unwrap();
        assert!((backwards.step_cdeg + 436.0 / 11.0).abs() < 1e-9);
        let still = Motion::of(&packet([123; 12]), ReturnMode::Dual, SPEC).unwrap();
        assert_eq!(
            (
                still.step_cdeg,
                still.crossing_ns(1000.0, Model::Vlp16.spec())
            ),
            (0.0, 0)
        );
    }

    #[test]
    fn one_azimuth_beside_the_line_is_noticed() {
        let line = |step: f64| {
            std::array::from_fn::<u16, 12, _>(|n| (20_000.0 + n as f64 * step).round() as u16)
        };
        for step in [40.0, 20.0, 80.0, -40.0] {
            for (at, bit) in (0..12).flat_map(|at| (5..14).map(move |bit| (at, bit))) {
                let mut azimuths = line(step);
                azimuths[at] ^= 1 << bit;
                let off = f64::from(azimuths[at]) - f64::from(line(step)[at]);
                let motion = Motion::of(&packet(azimuths), ReturnMode::Strongest, SPEC);
                // A jump at either end may be a sector that is left out, and a short step a head
                // that stops.
                let may_pass = (at == 0 || at == 11)
                    && (off.abs() > BREAK_CDEG || off.abs() <= step.abs() + BEND_CDEG);
                assert!(motion.is_err() || may_pass, "{step} {at} {bit}");
            }
        }
    }

    #[test]
    fn noise_and_a_head_that_stops_are_no_bend() {
        let mut rng = fastrand::Rng::with_seed(1);
        for round in 0..20_000 {
            // Noise of up to 0.2 degrees while it turns on, of 0.02 when it is stopped somewhere in
            // the packet.
            let (noise, until) = if round % 2 == 0 {
                (rng.f64() * 20.0, 12)
            } else {
                (2.0, rng.usize(..12))
            };
            let azimuths = std::array::from_fn(|n| {
                (20_000.0 + n.min(until) as f64 * 40.0 + noise * (2.0 * rng.f64() - 1.0)).round()
                    as u16
            });
            let motion = Motion::of(&packet(azimuths), ReturnMode::Strongest, SPEC);
            assert!(motion.is_ok(), "{round}: {azimuths:?} {motion:?}");
        }
    }
}
