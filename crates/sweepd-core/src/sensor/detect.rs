//! Which model sends these packets.
//!
//! The factory bytes alone mislead: they are blank on old firmware, and early VLP-16 firmware sends
//! the product byte of an HDL-32E. The packet period by the sensor clock is reliable: it follows
//! from the firing order and is exact to the microsecond resolution of the stamps. So the first few
//! packets of a stream decide, and the caller keeps them until then. An HDL-64E has no product byte
//! (a status byte in its place may have any value), but its blocks alternate between two heads,
//! which is checked first.
//!
//! ```
//! use sweepd_core::sensor::Model;
//! use sweepd_core::sensor::detect::{Basis, Detector};
//! use sweepd_core::wire::data::DataPacket;
//! let mut detector = Detector::new(None);
//! // A VLP-16 that calls itself an HDL-32E.
//! assert!(detector.observe(&DataPacket::new(1_000_000, 0x37, 0x21)).is_none());
//! assert!(detector.observe(&DataPacket::new(1_001_327, 0x37, 0x21)).is_none());
//! let detection = detector.observe(&DataPacket::new(1_002_654, 0x37, 0x21)).unwrap().unwrap();
//! assert_eq!((detection.model, detection.basis), (Model::Vlp16, Basis::Period));
//! ```

mod detection;
mod error;
mod timing;

pub use detection::{Basis, Detection};
pub use error::DetectError;
pub(crate) use timing::is_next;

use std::cmp::Ordering;

use timing::{fits, fits_once, since, timing_of, timings};

use super::Model;
use super::model::Spec;
use crate::wire::data::{BLOCKS, Banks, DataPacket, ReturnMode};

/// Packets after which [`Detector::observe`] has always decided.
pub const MAX_PACKETS: usize = 12;

/// Intervals that must agree before the last packet.
const ENOUGH: usize = 2;
/// Product bytes of sensors that use this protocol and are not supported.
const UNSUPPORTED: [(u8, &str); 5] = [
    (0x23, "VLP-32A or VLP-32B"),
    (0x28, "VLP-32C"),
    (0x31, "Velarray"),
    (0x63, "VLS-128"), // by the manual; real ones send 0xA1
    (0xA1, "VLS-128"),
];

/// Evidence of the azimuths for the return mode, for packets without a return mode byte: in how
/// many packets of a turning head they are equal in pairs, and in how many all differ. Counted,
/// since one packet may be corrupt.
#[derive(Clone, Copy, Debug, Default)]
struct Azimuths {
    paired: usize,
    single: usize,
}

/// What each packet says itself.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct FactoryBytes {
    /// How the blocks are laid out.
    banks: Banks,
    /// Return mode and product byte: 0 on an HDL-64E, which has none.
    return_mode: u8,
    product: u8,
}

impl FactoryBytes {
    fn of(packet: &DataPacket) -> Self {
        match packet.banks() {
            Banks::Alternating => Self {
                banks: Banks::Alternating,
                return_mode: 0,
                product: 0,
            },
            banks => Self {
                banks,
                return_mode: packet.return_mode,
                product: packet.product,
            },
        }
    }
}

/// Detects the model from the first packets of one sensor. It keeps no packets and does not allocate.
#[derive(Clone, Debug)]
pub struct Detector {
    forced: Option<Model>,
    bytes: FactoryBytes,
    azimuths: Azimuths,
    /// Packets observed, also those whose stamps were dropped when the bytes changed.
    observed: usize,
    /// Stamps since the bytes last changed, microseconds after the first, before or after the hour.
    stamps: [i64; MAX_PACKETS],
    first_stamp: u32,
    len: usize,
}

/// The intervals between the packets so far and how many of them each timing explains.
struct Intervals {
    us: [u32; MAX_PACKETS],
    len: usize,
}

/// A timing that explains some of the intervals.
#[derive(Clone, Copy)]
struct Vote {
    timing: Model,
    spec: &'static Spec,
    return_mode: ReturnMode,
    /// Intervals that fit.
    fits: usize,
    /// The shortest of them, microseconds.
    interval_us: u32,
}

impl Detector {
    /// A detector for one sensor; `forced` is the model that the user gave.
    pub fn new(forced: Option<Model>) -> Self {
        Self {
            forced,
            bytes: FactoryBytes {
                banks: Banks::One,
                return_mode: 0,
                product: 0,
            },
            azimuths: Azimuths::default(),
            observed: 0,
            stamps: [0; MAX_PACKETS],
            first_stamp: 0,
            len: 0,
        }
    }

    /// Takes the next packet of the sensor, in the order of arrival. It decides as soon as that is
    /// safe: from the third packet on, at the latest with packet [`MAX_PACKETS`], and with the
    /// first one for an unsupported sensor.
    ///
    /// # Errors
    /// [`DetectError`], final like a detection.
    pub fn observe(&mut self, packet: &DataPacket) -> Option<Result<Detection, DetectError>> {
        // The bank markers come first: the factory bytes of an HDL-64E are status bytes and may
        // equal any product.
        match packet.banks() {
            Banks::Alternating => {}
            Banks::UpperHeavy => {
                return Some(Err(DetectError::Unsupported {
                    sensor: "HDL-64E S1",
                }));
            }
            Banks::Other => {
                return Some(Err(DetectError::Unsupported {
                    sensor: many_banks(packet.product),
                }));
            }
            Banks::One => match model_of_product(packet.product) {
                // The user may give the model for a product byte that sweepd does not know, but not
                // for that of an unsupported sensor.
                Err(DetectError::UnknownProduct { .. }) if self.forced.is_some() => {}
                Err(error) => return Some(Err(error)),
                Ok(_) => {}
            },
        }
        if self.observed >= MAX_PACKETS {
            return Some(self.conclude());
        }
        self.record(packet);
        if self.observed == MAX_PACKETS {
            Some(self.conclude())
        } else {
            self.decide_early()
        }
    }

    /// Decides now, for a stream that ended before [`Detector::observe`] decided.
    ///
    /// # Errors
    /// [`DetectError`].
    pub fn conclude(&self) -> Result<Detection, DetectError> {
        self.check_layout()?;
        let intervals = self.intervals();
        if intervals.len < ENOUGH {
            return self.without_period();
        }
        let [best, next] = self.votes(&intervals);
        // A limited field of view makes one odd interval a turn, heavy loss makes many; by chance
        // one interval in a hundred fits.
        if best.fits > next.fits && best.fits * 4 >= intervals.len {
            return self.detection(best);
        }
        match unsupported(self.bytes.product) {
            Some(sensor) => Err(DetectError::Unsupported { sensor }),
            None => Err(DetectError::UnknownPeriod {
                median_us: intervals.median(),
                mode: best.return_mode,
                heads: self.has_heads(),
            }),
        }
    }

    fn has_heads(&self) -> bool {
        self.bytes.banks == Banks::Alternating
    }

    /// Checks that the blocks have the layout of the model that the user gave.
    fn check_layout(&self) -> Result<(), DetectError> {
        let heads = self.has_heads();
        match self.forced {
            Some(said) if self.len > 0 && said.is_hdl64e() != heads => {
                Err(DetectError::Layout { said, heads })
            }
            _ => Ok(()),
        }
    }

    fn record(&mut self, packet: &DataPacket) {
        let bytes = FactoryBytes::of(packet);
        if self.len == 0 || bytes != self.bytes {
            // The return mode was changed: periods before and after differ.
            self.bytes = bytes;
            self.azimuths = Azimuths::default();
            self.first_stamp = packet.stamp_us();
            self.len = 0;
        }
        let is_paired = if self.has_heads() {
            detection::says_two_returns(packet)
        } else {
            let turns = packet.blocks[0].azimuth_cdeg() != packet.blocks[BLOCKS - 1].azimuth_cdeg();
            turns.then(|| packet.azimuths_in_groups(2, BLOCKS / 2))
        };
        match is_paired {
            Some(true) => self.azimuths.paired += 1,
            Some(false) => self.azimuths.single += 1,
            None => {}
        }
        self.stamps[self.len] = since(self.first_stamp, packet.stamp_us());
        self.len += 1;
        self.observed += 1;
    }

    fn decide_early(&self) -> Option<Result<Detection, DetectError>> {
        let intervals = self.intervals();
        let [best, next] = self.votes(&intervals);
        let clear = best.fits >= ENOUGH && best.fits > next.fits && best.fits * 2 > intervals.len;
        clear.then(|| self.check_layout().and_then(|()| self.detection(best)))
    }

    /// The intervals between sorted stamps, without those of duplicates.
    fn intervals(&self) -> Intervals {
        let mut stamps = self.stamps;
        let stamps = &mut stamps[..self.len];
        stamps.sort_unstable();
        let mut intervals = Intervals {
            us: [0; MAX_PACKETS],
            len: 0,
        };
        for pair in stamps.windows(2) {
            let interval = u32::try_from(pair[1] - pair[0]).unwrap_or(u32::MAX);
            if interval > 0 {
                intervals.us[intervals.len] = interval;
                intervals.len += 1;
            }
        }
        intervals
    }

    /// The two best timings, the better one first.
    fn votes(&self, intervals: &Intervals) -> [Vote; 2] {
        let [(model, spec), (other, other_spec)] = timings(self.bytes.banks);
        let mut best = self.vote(model, spec, intervals);
        let mut next = self.vote(other, other_spec, intervals);
        if next.return_mode == ReturnMode::Dual
            && best.return_mode == next.return_mode
            && self.has_heads()
        {
            // With two returns there is only one timing.
            next.fits = 0;
        }
        if next.fits > best.fits {
            std::mem::swap(&mut best, &mut next);
        }
        [best, next]
    }

    /// How well a timing explains the intervals, in the return mode that explains them best.
    fn vote(&self, timing: Model, spec: &'static Spec, intervals: &Intervals) -> Vote {
        // Strongest first: intervals that both explain are of consecutive packets in single mode,
        // not of every second packet in dual mode.
        let Azimuths { paired, single } = self.azimuths;
        let modes: &[ReturnMode] = match (
            ReturnMode::from_byte(self.bytes.return_mode),
            paired.cmp(&single),
        ) {
            (Some(ReturnMode::Strongest), _) | (None, Ordering::Less) => &[ReturnMode::Strongest],
            (Some(ReturnMode::Last), _) => &[ReturnMode::Last],
            (Some(ReturnMode::Dual), _) | (None, Ordering::Greater) => &[ReturnMode::Dual],
            (None, Ordering::Equal) => &[ReturnMode::Strongest, ReturnMode::Dual],
        };
        let mut best = Vote {
            timing,
            spec,
            return_mode: modes[0],
            fits: 0,
            interval_us: 0,
        };
        for &return_mode in modes {
            let period_ns = spec.packet_period_ns(return_mode);
            let count = intervals.fitting(period_ns).count();
            // The mode with the shorter period also fits the intervals of the other, so that one of
            // its own length must be seen.
            let is_seen = modes.len() == 1
                || intervals
                    .fitting(period_ns)
                    .any(|us| fits_once(us, period_ns));
            if count > best.fits && is_seen {
                best = Vote {
                    timing,
                    spec,
                    return_mode,
                    fits: count,
                    interval_us: intervals.fitting(period_ns).min().unwrap_or_default(),
                };
            }
        }
        best
    }

    /// The detection of a stream whose period is known.
    fn detection(&self, vote: Vote) -> Result<Detection, DetectError> {
        let timing = if self.has_heads() && vote.return_mode == ReturnMode::Dual {
            Model::Hdl64eS3
        } else {
            vote.timing
        };
        let (model, basis) = if let Some(model) = self.forced {
            (model, self.basis_of_given(model))
        } else if self.has_heads() {
            (timing, Basis::HeadsAndPeriod)
        } else {
            match model_of_product(self.bytes.product)? {
                // Early VLP-16 firmware sends the product byte of an HDL-32E.
                Some(Model::Hdl32e) if timing != Model::Hdl32e => (timing, Basis::Period),
                Some(model) => (model, Basis::BytesAndPeriod),
                None => (timing, Basis::Period),
            }
        };
        // An S3 that reports one return may have the timing of an S2.
        let may_have_any = self.forced.is_some() && model == Model::Hdl64eS3;
        if timing_of(model) != timing && !may_have_any {
            return Err(DetectError::Contradiction {
                said: model,
                given: self.forced.is_some(),
                timing,
                interval_us: vote.interval_us,
            });
        }
        let period_ns = vote.spec.packet_period_ns(vote.return_mode);
        let measured = model
            .specs()
            .iter()
            .find(|own| own.packet_period_ns(vote.return_mode) == period_ns);
        Ok(Detection {
            model,
            return_mode: vote.return_mode,
            basis,
            spec: measured.copied().unwrap_or(model.spec()),
        })
    }

    fn basis_of_given(&self, model: Model) -> Basis {
        let product = self.bytes.product;
        if product == 0 || Some(product) == model.spec().product {
            Basis::Given
        } else {
            Basis::GivenAgainstBytes
        }
    }

    /// The detection of a stream too short to measure its period.
    fn without_period(&self) -> Result<Detection, DetectError> {
        let (model, basis) = match self.forced {
            Some(model) => (model, self.basis_of_given(model)),
            None if self.len == 0 => return Err(DetectError::TooFewPackets { packets: 0 }),
            None if self.has_heads() => (Model::Hdl64eS2, Basis::HeadsAlone),
            None => match model_of_product(self.bytes.product)? {
                Some(model) => (model, Basis::BytesAlone),
                None => {
                    return Err(DetectError::TooFewPackets {
                        packets: self.observed,
                    });
                }
            },
        };
        let return_mode =
            ReturnMode::from_byte(self.bytes.return_mode).unwrap_or(match self.azimuths {
                Azimuths { paired, single } if paired > single => ReturnMode::Dual,
                _ => ReturnMode::Strongest,
            });
        let model = match (model, return_mode) {
            (Model::Hdl64eS2, ReturnMode::Dual) if self.forced.is_none() => Model::Hdl64eS3,
            _ => model,
        };
        Ok(Detection {
            model,
            return_mode,
            basis,
            spec: model.spec(),
        })
    }
}

impl Intervals {
    fn us(&self) -> &[u32] {
        &self.us[..self.len]
    }

    /// Those that this period explains, microseconds.
    fn fitting(&self, period_ns: u32) -> impl Iterator<Item = u32> {
        self.us()
            .iter()
            .copied()
            .filter(move |&us| fits(us, period_ns))
    }

    fn median(&self) -> u32 {
        let mut sorted = self.us;
        let sorted = &mut sorted[..self.len];
        sorted.sort_unstable();
        sorted[self.len / 2]
    }
}

/// The model of a product byte; `None` if it is blank. A Puck LITE reports that of a VLP-16.
fn model_of_product(product: u8) -> Result<Option<Model>, DetectError> {
    if product == 0 {
        return Ok(None);
    }
    if let Some(sensor) = unsupported(product) {
        return Err(DetectError::Unsupported { sensor });
    }
    match Model::ALL
        .into_iter()
        .find(|model| model.spec().product == Some(product))
    {
        Some(model) => Ok(Some(model)),
        None => Err(DetectError::UnknownProduct { product }),
    }
}

fn unsupported(product: u8) -> Option<&'static str> {
    UNSUPPORTED
        .into_iter()
        .find(|&(byte, _)| byte == product)
        .map(|(_, sensor)| sensor)
}

/// The name of an unsupported sensor with another mixture of banks of lasers.
fn many_banks(product: u8) -> &'static str {
    match unsupported(product) {
        Some(sensor @ "VLS-128") => sensor,
        _ => "one with more than 64 lasers (VLS-128)",
    }
}

#[cfg(test)]
mod tests;
