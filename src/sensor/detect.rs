//! Which model sends these packets.
//!
//! The factory bytes alone mislead: they are blank on old firmware, and early VLP-16 firmware sends the product byte of
//! an HDL-32E. The time from packet to packet by the sensor clock does not: it follows from the firing order and is
//! exact to the microsecond that the stamps are cut to. So the first few packets of a stream decide, and the caller
//! keeps them until then. An HDL-64E has no product byte at all (bytes of its status are there, and may equal any): its
//! blocks alternate between two heads, which is asked first.
//!
//! ```
//! use sweepd::sensor::Model;
//! use sweepd::sensor::detect::{Basis, Detector};
//! use sweepd::wire::data::DataPacket;
//! let mut detector = Detector::new(None);
//! // A VLP-16 that calls itself an HDL-32E.
//! assert!(detector.observe(&DataPacket::new(1_000_000, 0x37, 0x21)).is_none());
//! assert!(detector.observe(&DataPacket::new(1_001_327, 0x37, 0x21)).is_none());
//! let detection = detector.observe(&DataPacket::new(1_002_654, 0x37, 0x21)).unwrap().unwrap();
//! assert_eq!((detection.model, detection.basis), (Model::Vlp16, Basis::Period));
//! ```

use std::cmp::Ordering;

use super::Model;
use super::model::Spec;
use crate::wire::HOUR_US;
use crate::wire::data::{BLOCKS, Banks, DataPacket, ReturnMode};

/// Packets after which [`Detector::observe`] has decided, one way or the other.
pub const MAX_PACKETS: usize = 12;

/// Intervals that must agree before the last packet.
const ENOUGH: usize = 2;
/// Longest gap, in packets, that still counts as lost packets. At 5 a VLP-16 looks like an HDL-32E: 5 x 1327.104 us is
/// 12 x 552.960.
const MAX_MULTIPLE: u32 = 4;
/// How far an interval may be from a multiple of the period: the stamps are cut to microseconds, and crystals drift.
const TOLERANCE_NS: u64 = 3_000;

/// Models that differ in timing, by how their blocks are laid out; the others share the timing of one of them.
fn timings(banks: Banks) -> [(Model, &'static Spec); 2] {
    match banks {
        // What reports one return every 288 us may be an S2 or an S3; what reports two is an S3.
        Banks::Alternating => {
            [(Model::Hdl64eS2, Model::Hdl64eS2.spec()), (Model::Hdl64eS3, Model::Hdl64eS3.specs()[1])]
        }
        _ => [Model::Vlp16, Model::Hdl32e].map(|model| (model, model.spec())),
    }
}

/// Product bytes of sensors that speak this protocol and are not supported.
const UNSUPPORTED: [(u8, &str); 5] = [
    (0x23, "VLP-32A or VLP-32B"),
    (0x28, "VLP-32C"),
    (0x31, "Velarray"),
    (0x63, "VLS-128"), // by the manual; real ones send 0xA1
    (0xA1, "VLS-128"),
];

/// The model of a stream, how it was told, and what its packets hold.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Detection {
    /// The model.
    pub model: Model,
    /// Returns in a packet. A sensor that does not say is taken as strongest, its default, or dual.
    pub return_mode: ReturnMode,
    /// What told the model.
    pub basis: Basis,
    /// The table of the model that has the measured packet period.
    pub spec: &'static Spec,
}

/// A packet of an HDL-64E says two returns by its azimuths alone; they must be so far apart for that, hundredths of a
/// degree, lest a head that hardly turns seem to.
const TELLING_STEP_CDEG: i32 = 4;

impl Detection {
    /// The return mode of a packet, the one before having that of `last`: an HDL-64E says it by its azimuths, and a head
    /// that stands still does not say it; others have a byte, and where it is blank the detection's mode holds.
    pub fn mode_of(&self, packet: &DataPacket, last: ReturnMode) -> ReturnMode {
        if !self.model.is_hdl64e() {
            return ReturnMode::from_byte(packet.return_mode).unwrap_or(self.return_mode);
        }
        let group = self.spec.blocks_per_azimuth(ReturnMode::Dual);
        if !packet.azimuths_in_groups(group) {
            return if last == ReturnMode::Dual { ReturnMode::Strongest } else { last };
        }
        let [first, second] = [0, group].map(|block| i32::from(packet.blocks[block].azimuth_cdeg()));
        if (first - second).abs() >= TELLING_STEP_CDEG { ReturnMode::Dual } else { last }
    }

    /// Whether a packet is laid out as those of this sensor, whatever it holds.
    pub fn has_layout(&self, packet: &DataPacket) -> bool {
        packet.banks() == banks_of(self.model)
    }
}

/// What told the model.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Basis {
    /// The user; neither product byte nor packet period speaks against it.
    Given,
    /// The user, against the product byte; the packet period does not speak against it.
    GivenAgainstBytes,
    /// The product byte, and the packet period agrees.
    BytesAndPeriod,
    /// The packet period: the product byte is blank, or it is the wrong one that early VLP-16 firmware sends.
    Period,
    /// The product byte: there were too few packets to measure their period.
    BytesAlone,
    /// The two heads, whose blocks alternate, and the packet period.
    HeadsAndPeriod,
    /// The two heads: there were too few packets to measure their period.
    HeadsAlone,
}

impl Basis {
    /// The words for it in output.
    pub fn words(self) -> &'static str {
        match self {
            Self::Given => "as given by --model",
            Self::GivenAgainstBytes => "as given by --model, although its factory bytes say otherwise",
            Self::BytesAndPeriod => "by its factory bytes and packet period",
            Self::Period => "by its packet period, since its factory bytes are blank or those of early firmware",
            Self::BytesAlone => "by its factory bytes alone, too few packets to check their period",
            Self::HeadsAndPeriod => "by its two heads and packet period",
            Self::HeadsAlone => "by its two heads alone, too few packets to check their period",
        }
    }
}

impl std::fmt::Display for Basis {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.words())
    }
}

/// Why there is no model.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum DetectError {
    /// A sensor that is known and not supported.
    #[error("this is the stream of another sensor, {sensor}; supported are {}", supported())]
    Unsupported {
        /// The sensor.
        sensor: &'static str,
    },
    /// A product byte that no known sensor sends.
    #[error(
        "product byte {product:#04x} belongs to no known sensor; supported are {}: if it is one of these, say --model",
        supported()
    )]
    UnknownProduct {
        /// The byte.
        product: u8,
    },
    /// The user or the product byte says one model, the packet period another.
    #[error(
        "{} says {said}, but packets come {interval_us} us apart, as those of the {timing} do; {}",
        if *.given { "--model" } else { "the product byte" },
        cure(.given, .timing)
    )]
    Contradiction {
        /// The model that was said.
        said: Model,
        /// Whether the user said it.
        given: bool,
        /// A model with the timing that was measured.
        timing: Model,
        /// A measured interval, microseconds.
        interval_us: u32,
    },
    /// The user says one model, and the blocks are laid out as those of another.
    #[error("--model says {said}, but {layout}; {}", cure_layout(.heads))]
    Layout {
        /// The model that was said.
        said: Model,
        /// How the blocks are laid out.
        layout: &'static str,
        /// Whether they are those of two heads.
        heads: bool,
    },
    /// The packet period is that of no supported model.
    #[error(
        "packets come {median_us} us apart by the sensor clock, expected in {mode} mode: {}; --model cannot help: \
         is this another sensor, two sensors behind one address, or a capture with most packets lost?",
        expected(.mode, .heads)
    )]
    UnknownPeriod {
        /// The median interval, microseconds.
        median_us: u32,
        /// The return mode that the packets seem to have.
        mode: ReturnMode,
        /// Whether the blocks are those of two heads.
        heads: bool,
    },
    /// Blank factory bytes, and too few packets to measure their period.
    #[error(
        "{packets} packets and blank factory bytes do not tell the sensor; supported are {}: say --model",
        supported()
    )]
    TooFewPackets {
        /// Packets that there were.
        packets: usize,
    },
}

/// The supported models, for a sentence.
fn supported() -> String {
    Model::ALL.map(|model| format!("{model} ({})", model.spec().flag)).join(", ")
}

/// What to do about a contradiction. By reference, as thiserror hands out the fields.
fn cure(given: &bool, timing: &Model) -> String {
    let flag = timing.spec().flag;
    if *given {
        format!("leave --model away, or give --model {flag}")
    } else {
        format!("if it is one, give --model {flag}")
    }
}

fn cure_layout(heads: &bool) -> &'static str {
    if *heads { "leave --model away, or give hdl64e-s2 or hdl64e-s3" } else { "leave --model away" }
}

/// What a packet period should have been.
fn expected(mode: &ReturnMode, heads: &bool) -> String {
    timings(if *heads { Banks::Alternating } else { Banks::One })
        .map(|(model, spec)| format!("{:.1} us on the {model}", f64::from(spec.packet_period_ns(*mode)) / 1e3))
        .join(", ")
}

/// What the azimuths say about the return mode of packets that do not say it themselves: in how many packets of a turning
/// head they come in equal pairs, and in how many each is its own. One packet may be corrupt.
#[derive(Clone, Copy, Debug, Default)]
struct Azimuths {
    paired: usize,
    single: usize,
}

/// Tells the model from the first packets of one sensor. It keeps no packets and does not allocate.
#[derive(Clone, Debug)]
pub struct Detector {
    forced: Option<Model>,
    /// How the blocks of the last packet are laid out, and its return mode and product byte: 0 on an HDL-64E, which has
    /// none.
    bytes: (Banks, u8, u8),
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
    /// A detector for one sensor; `forced` is what the user says it is.
    pub fn new(forced: Option<Model>) -> Self {
        Self {
            forced,
            bytes: (Banks::One, 0, 0),
            azimuths: Azimuths::default(),
            observed: 0,
            stamps: [0; MAX_PACKETS],
            first_stamp: 0,
            len: 0,
        }
    }

    /// Takes the next packet of the sensor, in the order of arrival, and decides as soon as that is safe: from the
    /// third packet on, at the latest with packet [`MAX_PACKETS`], and with the first one for a sensor that is not
    /// supported.
    ///
    /// # Errors
    /// [`DetectError`], final like a detection.
    pub fn observe(&mut self, packet: &DataPacket) -> Option<Result<Detection, DetectError>> {
        // The bank markers come first: the factory bytes of an HDL-64E are status bytes and may equal any product.
        match packet.banks() {
            Banks::Alternating => {}
            Banks::UpperHeavy => return Some(Err(DetectError::Unsupported { sensor: "HDL-64E S1" })),
            Banks::Other => return Some(Err(DetectError::Unsupported { sensor: many_banks(packet.product) })),
            Banks::One => match said_by(packet.product) {
                // The user may know a product byte that nobody else does, but not turn one sensor into another.
                Err(DetectError::UnknownProduct { .. }) if self.forced.is_some() => {}
                Err(error) => return Some(Err(error)),
                Ok(_) => {}
            },
        }
        if self.observed >= MAX_PACKETS {
            return Some(self.conclude());
        }
        self.record(packet);
        if self.observed == MAX_PACKETS { Some(self.conclude()) } else { self.decide_early() }
    }

    /// Decides now: for a stream that ended before [`Detector::observe`] did.
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
        // A field of view leaves one odd interval a turn, heavy loss leaves many; chance fits one in a hundred.
        if best.fits > next.fits && best.fits * 4 >= intervals.len {
            return self.detection(best);
        }
        match unsupported(self.bytes.2) {
            Some(sensor) => Err(DetectError::Unsupported { sensor }),
            None => {
                let (median_us, mode, heads) = (intervals.median(), best.return_mode, self.has_heads());
                Err(DetectError::UnknownPeriod { median_us, mode, heads })
            }
        }
    }

    fn has_heads(&self) -> bool {
        self.bytes.0 == Banks::Alternating
    }

    /// Whether the blocks can be those of the model that the user says it is.
    fn check_layout(&self) -> Result<(), DetectError> {
        let heads = self.has_heads();
        let layout = match heads {
            true => "the blocks of its packets alternate between two heads, as those of the HDL-64E do",
            false => "the blocks of its packets are all of one head, and those of the HDL-64E alternate between two",
        };
        match self.forced {
            Some(said) if self.len > 0 && said.is_hdl64e() != heads => Err(DetectError::Layout { said, layout, heads }),
            _ => Ok(()),
        }
    }

    fn record(&mut self, packet: &DataPacket) {
        let bytes = match packet.banks() {
            Banks::Alternating => (Banks::Alternating, 0, 0),
            banks => (banks, packet.return_mode, packet.product),
        };
        if self.len == 0 || bytes != self.bytes {
            // Somebody changed the return mode: the periods on the two sides have nothing in common.
            self.bytes = bytes;
            self.azimuths = Azimuths::default();
            self.first_stamp = packet.stamp_us();
            self.len = 0;
        }
        if packet.blocks[0].azimuth_cdeg() != packet.blocks[BLOCKS - 1].azimuth_cdeg() {
            let paired = packet.azimuths_in_groups(if self.has_heads() { 4 } else { 2 });
            *if paired { &mut self.azimuths.paired } else { &mut self.azimuths.single } += 1;
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

    /// The intervals between stamps in order; those of duplicates are none.
    fn intervals(&self) -> Intervals {
        let mut stamps = self.stamps;
        let stamps = &mut stamps[..self.len];
        stamps.sort_unstable();
        let mut intervals = Intervals { us: [0; MAX_PACKETS], len: 0 };
        for pair in stamps.windows(2) {
            let interval = u32::try_from(pair[1] - pair[0]).unwrap_or(u32::MAX);
            if interval > 0 {
                intervals.us[intervals.len] = interval;
                intervals.len += 1;
            }
        }
        intervals
    }

    /// The two timings, the better one first.
    fn votes(&self, intervals: &Intervals) -> [Vote; 2] {
        let [mut best, mut next] = timings(self.bytes.0).map(|timing| self.vote(timing, intervals));
        if next.return_mode == ReturnMode::Dual && best.return_mode == next.return_mode && self.has_heads() {
            // With two returns there is but one timing.
            next.fits = 0;
        }
        if next.fits > best.fits {
            std::mem::swap(&mut best, &mut next);
        }
        [best, next]
    }

    /// How well a timing explains the intervals, in the return mode that explains them best.
    fn vote(&self, (timing, spec): (Model, &'static Spec), intervals: &Intervals) -> Vote {
        // Strongest first: what both explain is one packet after the other in single mode, not every second one in
        // dual.
        let Azimuths { paired, single } = self.azimuths;
        let modes: &[ReturnMode] = match (ReturnMode::from_byte(self.bytes.1), paired.cmp(&single)) {
            (Some(ReturnMode::Strongest), _) | (None, Ordering::Less) => &[ReturnMode::Strongest],
            (Some(ReturnMode::Last), _) => &[ReturnMode::Last],
            (Some(ReturnMode::Dual), _) | (None, Ordering::Greater) => &[ReturnMode::Dual],
            (None, Ordering::Equal) => &[ReturnMode::Strongest, ReturnMode::Dual],
        };
        let mut best = Vote { timing, spec, return_mode: modes[0], fits: 0, interval_us: 0 };
        for &return_mode in modes {
            let period_ns = spec.packet_period_ns(return_mode);
            let fitting = || intervals.us().iter().copied().filter(|&us| fits(us, period_ns));
            let count = fitting().count();
            if count > best.fits {
                best =
                    Vote { timing, spec, return_mode, fits: count, interval_us: fitting().min().unwrap_or_default() };
            }
        }
        best
    }

    /// The detection of a stream whose period is known.
    fn detection(&self, vote: Vote) -> Result<Detection, DetectError> {
        let Vote { mut timing, spec, return_mode, interval_us, .. } = vote;
        if self.has_heads() && return_mode == ReturnMode::Dual {
            timing = Model::Hdl64eS3;
        }
        let found = |model: Model, basis| {
            let period_ns = spec.packet_period_ns(return_mode);
            let measured = model.specs().iter().find(|own| own.packet_period_ns(return_mode) == period_ns);
            Ok(Detection { model, return_mode, basis, spec: measured.copied().unwrap_or(model.spec()) })
        };
        let contradiction = |said, given| Err(DetectError::Contradiction { said, given, timing, interval_us });
        if let Some(model) = self.forced {
            let basis = self.basis_of_given(model);
            // An S3 that reports one return may have the timing of an S2.
            let fits = timing_of(model) == timing || model == Model::Hdl64eS3;
            return if fits { found(model, basis) } else { contradiction(model, true) };
        }
        if self.has_heads() {
            return found(timing, Basis::HeadsAndPeriod);
        }
        match said_by(self.bytes.2)? {
            None => found(timing, Basis::Period),
            Some(model) if timing_of(model) == timing => found(model, Basis::BytesAndPeriod),
            // Early VLP-16 firmware sends the product byte of an HDL-32E.
            Some(Model::Hdl32e) => found(timing, Basis::Period),
            Some(model) => contradiction(model, false),
        }
    }

    fn basis_of_given(&self, model: Model) -> Basis {
        let product = self.bytes.2;
        if product == 0 || Some(product) == model.spec().product { Basis::Given } else { Basis::GivenAgainstBytes }
    }

    /// The detection of a stream too short to measure its period.
    fn without_period(&self) -> Result<Detection, DetectError> {
        let (model, basis) = match self.forced {
            Some(model) => (model, self.basis_of_given(model)),
            None if self.len == 0 => return Err(DetectError::TooFewPackets { packets: 0 }),
            None if self.has_heads() => (Model::Hdl64eS2, Basis::HeadsAlone),
            None => match said_by(self.bytes.2)? {
                Some(model) => (model, Basis::BytesAlone),
                None => return Err(DetectError::TooFewPackets { packets: self.observed }),
            },
        };
        let return_mode = ReturnMode::from_byte(self.bytes.1).unwrap_or(match self.azimuths {
            Azimuths { paired, single } if paired > single => ReturnMode::Dual,
            _ => ReturnMode::Strongest,
        });
        let model = match (model, return_mode) {
            (Model::Hdl64eS2, ReturnMode::Dual) if self.forced.is_none() => Model::Hdl64eS3,
            _ => model,
        };
        Ok(Detection { model, return_mode, basis, spec: model.spec() })
    }
}

impl Intervals {
    fn us(&self) -> &[u32] {
        &self.us[..self.len]
    }

    fn median(&self) -> u32 {
        let mut sorted = self.us;
        let sorted = &mut sorted[..self.len];
        sorted.sort_unstable();
        sorted[self.len / 2]
    }
}

/// Microseconds from one stamp to another, the short way round the hour.
fn since(from: u32, to: u32) -> i64 {
    let hour = i64::from(HOUR_US);
    match i64::from(to) - i64::from(from) {
        ahead if ahead > hour / 2 => ahead - hour,
        behind if behind < -hour / 2 => behind + hour,
        difference => difference,
    }
}

/// Whether an interval is a small multiple of a period.
fn fits(interval_us: u32, period_ns: u32) -> bool {
    let interval_ns = u64::from(interval_us) * 1_000;
    (1..=MAX_MULTIPLE).any(|multiple| interval_ns.abs_diff(u64::from(period_ns * multiple)) <= TOLERANCE_NS)
}

/// The model of [`TIMINGS`] whose timing a model has.
fn timing_of(model: Model) -> Model {
    match model {
        Model::Vlp16 | Model::PuckLite | Model::PuckHiRes => Model::Vlp16,
        Model::Hdl32e => Model::Hdl32e,
        Model::Hdl64eS2 => Model::Hdl64eS2,
        Model::Hdl64eS3 => Model::Hdl64eS3,
    }
}

/// How the blocks of a model are laid out.
fn banks_of(model: Model) -> Banks {
    if model.is_hdl64e() { Banks::Alternating } else { Banks::One }
}

/// The model that a product byte names, none if it is blank. A Puck LITE calls itself a VLP-16.
fn said_by(product: u8) -> Result<Option<Model>, DetectError> {
    if product == 0 {
        return Ok(None);
    }
    if let Some(sensor) = unsupported(product) {
        return Err(DetectError::Unsupported { sensor });
    }
    match Model::ALL.into_iter().find(|model| model.spec().product == Some(product)) {
        Some(model) => Ok(Some(model)),
        None => Err(DetectError::UnknownProduct { product }),
    }
}

fn unsupported(product: u8) -> Option<&'static str> {
    UNSUPPORTED.into_iter().find(|&(byte, _)| byte == product).map(|(_, sensor)| sensor)
}

/// The name of a sensor that mixes banks of lasers in a way of its own.
fn many_banks(product: u8) -> &'static str {
    match unsupported(product) {
        Some(sensor @ "VLS-128") => sensor,
        _ => "one with more than 64 lasers (VLS-128)",
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::wire::data::FLAG_BANK_1;
    use proptest::prelude::*;

    const SINGLE: u8 = 0x37;
    const DUAL: u8 = 0x39;
    const VLP16_NS: u64 = 1_327_104;
    const HDL32E_NS: u64 = 552_960;

    /// A packet of a turning head, its azimuths in pairs or not.
    fn packet(stamp_us: u32, bytes: (u8, u8), paired: bool) -> DataPacket {
        let mut packet = DataPacket::new(stamp_us, bytes.0, bytes.1);
        for (index, block) in packet.blocks.iter_mut().enumerate() {
            let step = if paired { index / 2 } else { index };
            block.set_azimuth_cdeg(100 + 20 * step as u16);
        }
        packet
    }

    /// Stamps as a sensor makes them: packets of so many periods after the first, cut to microseconds.
    fn stamps(period_ns: u64, packets: &[u64]) -> Vec<u32> {
        packets.iter().map(|packet| ((777_000_400 + packet * period_ns) / 1_000) as u32).collect()
    }

    /// The verdict and the number of packets it took, 0 for one at the end of the stream.
    fn run(
        forced: Option<Model>,
        bytes: (u8, u8),
        paired: bool,
        stamps: &[u32],
    ) -> (usize, Result<Detection, DetectError>) {
        let mut detector = Detector::new(forced);
        for (index, &stamp) in stamps.iter().enumerate() {
            if let Some(verdict) = detector.observe(&packet(stamp, bytes, paired)) {
                return (index + 1, verdict);
            }
        }
        (0, detector.conclude())
    }

    fn found(model: Model, return_mode: ReturnMode, basis: Basis) -> Result<Detection, DetectError> {
        Ok(Detection { model, return_mode, basis, spec: model.spec() })
    }

    #[test]
    fn three_packets_in_order_are_enough() {
        use ReturnMode::{Dual, Strongest};
        let cases = [
            ((SINGLE, 0x22), VLP16_NS, Model::Vlp16, Strongest, Basis::BytesAndPeriod),
            ((SINGLE, 0x24), VLP16_NS, Model::PuckHiRes, Strongest, Basis::BytesAndPeriod),
            ((SINGLE, 0x21), HDL32E_NS, Model::Hdl32e, Strongest, Basis::BytesAndPeriod),
            ((0x38, 0x21), HDL32E_NS, Model::Hdl32e, ReturnMode::Last, Basis::BytesAndPeriod),
            ((DUAL, 0x22), VLP16_NS / 2, Model::Vlp16, Dual, Basis::BytesAndPeriod),
            ((DUAL, 0x21), HDL32E_NS / 2, Model::Hdl32e, Dual, Basis::BytesAndPeriod),
            // Early VLP-16 firmware.
            ((SINGLE, 0x21), VLP16_NS, Model::Vlp16, Strongest, Basis::Period),
            ((DUAL, 0x21), VLP16_NS / 2, Model::Vlp16, Dual, Basis::Period),
            // Blank bytes.
            ((0, 0), VLP16_NS, Model::Vlp16, Strongest, Basis::Period),
            ((0, 0), HDL32E_NS, Model::Hdl32e, Strongest, Basis::Period),
            ((0, 0), VLP16_NS / 2, Model::Vlp16, Dual, Basis::Period),
            ((0, 0), HDL32E_NS / 2, Model::Hdl32e, Dual, Basis::Period),
        ];
        for (bytes, period_ns, model, mode, basis) in cases {
            let verdict = run(None, bytes, mode == Dual, &stamps(period_ns, &[0, 1, 2, 3]));
            assert_eq!(verdict, (3, found(model, mode, basis)), "{bytes:x?} {period_ns}");
        }
    }

    #[test]
    fn loss_duplicates_and_reordering_do_not_mislead() {
        let vlp16 = found(Model::Vlp16, ReturnMode::Strongest, Basis::BytesAndPeriod);
        let hdl32e = found(Model::Hdl32e, ReturnMode::Strongest, Basis::BytesAndPeriod);
        let orders: [(&[u64], usize); 5] = [
            (&[0, 2, 5], 3),
            (&[0, 0, 1, 1, 2], 5),
            (&[0, 2, 1], 3),
            (&[3, 4, 0, 1], 3),
            // Five packets later a VLP-16 stands where an HDL-32E does after twelve: such a gap says nothing.
            (&[0, 5, 10, 11, 12, 13], 6),
        ];
        for (order, needed) in orders {
            assert_eq!(run(None, (SINGLE, 0x22), false, &stamps(VLP16_NS, order)), (needed, vlp16), "{order:?}");
        }
        assert_eq!(run(None, (SINGLE, 0x21), false, &stamps(HDL32E_NS, &[0, 12, 24, 25, 26, 27])), (6, hdl32e));
    }

    #[test]
    fn the_hour_may_end_within_the_stream() {
        let stamps = [3_599_998_900, 227, 1_554];
        let verdict = run(None, (SINGLE, 0x22), false, &stamps);
        assert_eq!(verdict, (3, found(Model::Vlp16, ReturnMode::Strongest, Basis::BytesAndPeriod)));
    }

    #[test]
    fn the_odd_interval_of_a_field_of_view_is_outvoted() {
        let mut times = stamps(VLP16_NS, &[0, 1]);
        let gap = times[1] + 50_311;
        times.extend([gap, gap + 1_327, gap + 2_654]);
        let verdict = run(None, (0, 0), false, &times);
        assert_eq!(verdict, (4, found(Model::Vlp16, ReturnMode::Strongest, Basis::Period)));
    }

    #[test]
    fn a_head_that_stands_still_tells_its_mode_by_the_period() {
        for (period_ns, mode) in [(HDL32E_NS, ReturnMode::Strongest), (HDL32E_NS / 2, ReturnMode::Dual)] {
            let mut detector = Detector::new(None);
            let verdict =
                stamps(period_ns, &[0, 1, 2]).into_iter().find_map(|s| detector.observe(&DataPacket::new(s, 0, 0)));
            assert_eq!(verdict, Some(found(Model::Hdl32e, mode, Basis::Period)));
        }
    }

    #[test]
    fn unsupported_sensors_are_named_at_once() {
        let cases = [(0x28, "VLP-32C"), (0xA1, "VLS-128"), (0x63, "VLS-128"), (0x31, "Velarray")];
        for (product, sensor) in cases {
            let verdict = run(None, (SINGLE, product), false, &[0]);
            assert_eq!(verdict, (1, Err(DetectError::Unsupported { sensor })));
        }
        let message = run(None, (SINGLE, 0x23), false, &[0]).1.unwrap_err().to_string();
        assert_eq!(
            message,
            "this is the stream of another sensor, VLP-32A or VLP-32B; supported are VLP-16 (vlp16), \
             Puck LITE (puck-lite), Puck Hi-Res (puck-hires), HDL-32E (hdl32e), HDL-64E S2 (hdl64e-s2), \
             HDL-64E S3 (hdl64e-s3)"
        );
        let mut s1 = DataPacket::new(0, SINGLE, 0x22);
        s1.blocks.iter_mut().skip(2).step_by(4).for_each(|block| block.flag.set(FLAG_BANK_1));
        for forced in [None, Some(Model::Vlp16)] {
            let verdict = Detector::new(forced).observe(&s1);
            assert_eq!(verdict, Some(Err(DetectError::Unsupported { sensor: "HDL-64E S1" })));
        }
        let mut vls128 = DataPacket::new(0, SINGLE, 0xA1);
        vls128.blocks[1].flag.set(FLAG_BANK_1);
        let verdict = Detector::new(Some(Model::Vlp16)).observe(&vls128);
        assert_eq!(verdict, Some(Err(DetectError::Unsupported { sensor: "VLS-128" })));
    }

    #[test]
    fn unknown_product_bytes_need_the_user() {
        let times = stamps(VLP16_NS, &[0, 1, 2]);
        assert_eq!(run(None, (SINGLE, 0x77), false, &times), (1, Err(DetectError::UnknownProduct { product: 0x77 })));
        let verdict = run(Some(Model::PuckLite), (SINGLE, 0x77), false, &times);
        assert_eq!(verdict, (3, found(Model::PuckLite, ReturnMode::Strongest, Basis::GivenAgainstBytes)));
    }

    #[test]
    fn the_user_beats_the_bytes_but_not_the_period() {
        let vlp16 = stamps(VLP16_NS, &[0, 1, 2]);
        let given = |model| found(model, ReturnMode::Strongest, Basis::GivenAgainstBytes);
        assert_eq!(run(Some(Model::PuckHiRes), (SINGLE, 0x22), false, &vlp16), (3, given(Model::PuckHiRes)));
        let hdl32e = stamps(HDL32E_NS, &[0, 1, 2]);
        assert_eq!(run(Some(Model::Hdl32e), (SINGLE, 0x22), false, &hdl32e), (3, given(Model::Hdl32e)));
        let (packets, verdict) = run(Some(Model::Hdl32e), (SINGLE, 0x21), false, &vlp16);
        assert_eq!(packets, 3);
        assert_eq!(
            verdict.unwrap_err().to_string(),
            "--model says HDL-32E, but packets come 1327 us apart, as those of the VLP-16 do; \
             leave --model away, or give --model vlp16"
        );
    }

    #[test]
    fn the_user_does_not_turn_another_sensor_into_a_vlp16() {
        // A VLP-32C: its period is half that of a VLP-16.
        let times = stamps(VLP16_NS / 2, &(0..12).collect::<Vec<_>>());
        let verdict = run(Some(Model::Vlp16), (SINGLE, 0x28), false, &times);
        assert_eq!(verdict, (1, Err(DetectError::Unsupported { sensor: "VLP-32C" })));
    }

    #[test]
    fn a_byte_that_contradicts_the_period_is_an_error() {
        for product in [0x22, 0x24] {
            let (packets, verdict) = run(None, (SINGLE, product), false, &stamps(HDL32E_NS, &[0, 1, 2]));
            let message = verdict.unwrap_err().to_string();
            assert_eq!(packets, 3);
            assert!(message.starts_with("the product byte says "), "{message}");
            assert!(
                message.ends_with("553 us apart, as those of the HDL-32E do; if it is one, give --model hdl32e"),
                "{message}"
            );
        }
    }

    #[test]
    fn a_period_of_no_model_is_an_error_after_the_last_packet() {
        let times = stamps(800_000, &(0..20).collect::<Vec<_>>());
        for forced in [None, Some(Model::Vlp16)] {
            let (packets, verdict) = run(forced, (SINGLE, 0x22), false, &times);
            assert_eq!(packets, MAX_PACKETS);
            let mode = ReturnMode::Strongest;
            assert_eq!(verdict, Err(DetectError::UnknownPeriod { median_us: 800, mode, heads: false }));
            let message = verdict.unwrap_err().to_string();
            assert!(
                message.contains("800 us apart")
                    && message
                        .contains("strongest mode: 1327.1 us on the VLP-16, 553.0 us on the HDL-32E; --model cannot"),
                "{message}"
            );
        }
    }

    #[test]
    fn streams_too_short_for_a_period_go_by_what_was_said() {
        let strongest = ReturnMode::Strongest;
        for packets in [&[0][..], &[0, 1], &[0, 0, 0, 1]] {
            let times = stamps(VLP16_NS, packets);
            let bytes = found(Model::PuckHiRes, strongest, Basis::BytesAlone);
            assert_eq!(run(None, (SINGLE, 0x24), false, &times), (0, bytes));
            let given = found(Model::Hdl32e, strongest, Basis::GivenAgainstBytes);
            assert_eq!(run(Some(Model::Hdl32e), (SINGLE, 0x22), false, &times), (0, given));
            let blank = Err(DetectError::TooFewPackets { packets: times.len() });
            assert_eq!(run(None, (0, 0), false, &times), (0, blank));
        }
        assert_eq!(Detector::new(None).conclude(), Err(DetectError::TooFewPackets { packets: 0 }));
        let dual = found(Model::Vlp16, ReturnMode::Dual, Basis::Given);
        assert_eq!(run(Some(Model::Vlp16), (0, 0), true, &[0]), (0, dual));
        // Nothing but copies of one packet: there is no period, and it ends all the same.
        let bytes = found(Model::Vlp16, strongest, Basis::BytesAlone);
        assert_eq!(run(None, (SINGLE, 0x22), false, &[5; 40]), (MAX_PACKETS, bytes));
    }

    #[test]
    fn a_change_of_return_mode_starts_the_measurement_again() {
        let mut detector = Detector::new(None);
        let times = stamps(VLP16_NS, &[0, 1]);
        assert_eq!(detector.observe(&packet(times[0], (SINGLE, 0x22), false)), None);
        assert_eq!(detector.observe(&packet(times[1], (SINGLE, 0x22), false)), None);
        let dual = stamps(VLP16_NS / 2, &[40, 41, 42]);
        let verdict = dual.into_iter().find_map(|stamp| detector.observe(&packet(stamp, (DUAL, 0x22), true)));
        assert_eq!(verdict, Some(found(Model::Vlp16, ReturnMode::Dual, Basis::BytesAndPeriod)));
    }

    #[test]
    fn no_interval_fits_two_timings() {
        for mode in [ReturnMode::Strongest, ReturnMode::Dual] {
            let [vlp16, hdl32e] = timings(Banks::One).map(|(_, spec)| spec.packet_period_ns(mode));
            assert!((0..10_000).all(|us| !(fits(us, vlp16) && fits(us, hdl32e))));
        }
        let [fast, slow] = timings(Banks::Alternating).map(|(_, spec)| spec.packet_period_ns(ReturnMode::Strongest));
        assert!((0..10_000).all(|us| !(fits(us, fast) && fits(us, slow))));
    }

    /// A packet of two heads that turn, with status bytes that would name a VLP-16 in dual mode.
    fn two_heads(stamp_us: u32, blocks_per_azimuth: usize) -> DataPacket {
        let mut packet = DataPacket::new(stamp_us, DUAL, 0x22);
        for (index, block) in packet.blocks.iter_mut().enumerate() {
            block.flag.set(if index % 2 == 1 { FLAG_BANK_1 } else { crate::wire::data::FLAG_BANK_0 });
            block.set_azimuth_cdeg(100 + 17 * (index / blocks_per_azimuth) as u16);
        }
        packet
    }

    #[test]
    fn an_hdl64e_is_told_by_its_heads_and_its_timing_by_the_period() {
        use ReturnMode::{Dual, Strongest};
        let run = |forced, period_ns, group, packets: &[u64]| {
            let mut detector = Detector::new(forced);
            let packets = stamps(period_ns, packets).into_iter().map(|stamp| two_heads(stamp, group));
            packets.into_iter().find_map(|p| detector.observe(&p)).unwrap_or_else(|| detector.conclude())
        };
        let slow = Model::Hdl64eS3.specs()[1];
        for (period_ns, group, mode, model, spec) in [
            (288_000, 2, Strongest, Model::Hdl64eS2, Model::Hdl64eS2.spec()),
            (345_600, 2, Strongest, Model::Hdl64eS3, slow),
            (172_800, 4, Dual, Model::Hdl64eS3, Model::Hdl64eS2.spec()),
        ] {
            for order in [&[0, 1, 2][..], &[0, 2, 5], &[1, 0, 2], &[0, 0, 3, 4]] {
                let found = run(None, period_ns, group, order).unwrap();
                assert_eq!((found.model, found.return_mode, found.basis), (model, mode, Basis::HeadsAndPeriod));
                assert_eq!(found.spec.packet_period_ns(mode), spec.packet_period_ns(mode), "{period_ns} {order:?}");
            }
            let s3 = run(Some(Model::Hdl64eS3), period_ns, group, &[0, 1, 2]).unwrap();
            assert_eq!((s3.model, s3.return_mode, s3.basis), (Model::Hdl64eS3, mode, Basis::Given));
        }
        assert_eq!(run(None, 288_000, 2, &[0]).unwrap().basis, Basis::HeadsAlone);
        let message =
            |forced, period_ns, group| run(Some(forced), period_ns, group, &[0, 1, 2]).unwrap_err().to_string();
        assert_eq!(
            message(Model::Hdl64eS2, 172_800, 4),
            "--model says HDL-64E S2, but packets come 173 us apart, as those of the HDL-64E S3 do; leave --model away, \
             or give --model hdl64e-s3"
        );
        assert_eq!(
            message(Model::Vlp16, 288_000, 2),
            "--model says VLP-16, but the blocks of its packets alternate between two heads, as those of the HDL-64E do; \
             leave --model away, or give hdl64e-s2 or hdl64e-s3"
        );
        let (_, one_head) = self::run(Some(Model::Hdl64eS2), (SINGLE, 0x22), false, &stamps(VLP16_NS, &[0, 1, 2]));
        assert!(matches!(one_head, Err(DetectError::Layout { heads: false, .. })), "{one_head:?}");
    }

    #[test]
    fn an_hdl64e_says_its_return_mode_by_azimuths_that_differ() {
        use ReturnMode::{Dual, Strongest};
        let detection = found(Model::Hdl64eS3, Strongest, Basis::HeadsAndPeriod).unwrap();
        for last in [Strongest, Dual] {
            assert_eq!(detection.mode_of(&two_heads(0, 2), last), Strongest);
            assert_eq!(detection.mode_of(&two_heads(0, 4), last), Dual);
            assert_eq!(detection.mode_of(&two_heads(0, 12), last), last);
        }
    }

    proptest! {
        #[test]
        fn any_stream_ends_in_a_verdict(
            packets in proptest::collection::vec((any::<u32>(), any::<u8>(), any::<u8>(), any::<bool>()), MAX_PACKETS),
            forced in 0..=Model::ALL.len(),
        ) {
            let mut detector = Detector::new(Model::ALL.get(forced).copied());
            let _ = detector.conclude();
            let verdict = packets.into_iter().find_map(|(stamp, mode, product, paired)| {
                let _ = detector.conclude();
                detector.observe(&packet(stamp, (mode, product), paired))
            });
            prop_assert!(verdict.is_some());
        }
    }
}
