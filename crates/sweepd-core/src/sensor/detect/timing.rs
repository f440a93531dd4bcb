//! The timings of the models, and which of them an interval between packets fits.

use crate::sensor::Model;
use crate::sensor::model::Spec;
use crate::wire::HOUR_US;
use crate::wire::data::Banks;

/// Longest gap, in packets, that still counts as lost packets. At 5 a VLP-16 looks like an HDL-32E:
/// 5 x 1327.104 us is 12 x 552.960.
const MAX_MULTIPLE: u32 = 4;
/// How far an interval may be from a multiple of the period: the stamps are cut to microseconds,
/// and crystals drift.
const TOLERANCE_NS: u64 = 3_000;

/// A timing: the model that it is called by, and its table.
pub(super) type ModelTiming = (Model, &'static Spec);

/// The timings of sensors with one bank; other models share one of them.
pub(super) const OF_ONE_BANK: [ModelTiming; 3] = [
    (Model::Vlp16, Spec::of(Model::Vlp16)),
    (Model::Hdl32e, Spec::of(Model::Hdl32e)),
    (Model::Vlp32c, Spec::of(Model::Vlp32c)),
];
/// The timings of an HDL-64E. One with one return every 288 us may be an S2 or an S3; one with two
/// is an S3.
const OF_TWO_BANKS: [ModelTiming; 2] = [
    (Model::Hdl64eS2, Spec::of(Model::Hdl64eS2)),
    (Model::Hdl64eS3, Spec::all_of(Model::Hdl64eS3)[1]),
];

/// The timings that packets of this layout may have.
pub(super) fn timings(banks: Banks) -> &'static [ModelTiming] {
    match banks.count() {
        Some(1) => &OF_ONE_BANK,
        Some(2) => &OF_TWO_BANKS,
        _ => &[],
    }
}

/// Microseconds from one stamp of a sensor to another, the short way round the hour.
pub fn since(from: u32, to: u32) -> i64 {
    let hour = i64::from(HOUR_US);
    match i64::from(to) - i64::from(from) {
        ahead if ahead > hour / 2 => ahead - hour,
        behind if behind < -hour / 2 => behind + hour,
        difference => difference,
    }
}

/// Whether an interval is a small multiple of a period.
pub(super) fn fits(interval_us: u32, period_ns: u32) -> bool {
    let interval_ns = u64::from(interval_us) * 1_000;
    (1..=MAX_MULTIPLE)
        .any(|multiple| interval_ns.abs_diff(u64::from(period_ns * multiple)) <= TOLERANCE_NS)
}

/// Whether a stamp is one period after another, microseconds after the top of the hour.
pub(crate) fn is_next(before_us: u32, stamp_us: u32, period_ns: u32) -> bool {
    u32::try_from(since(before_us, stamp_us))
        .is_ok_and(|interval_us| fits_once(interval_us, period_ns))
}

/// Whether an interval is one period.
pub(super) fn fits_once(interval_us: u32, period_ns: u32) -> bool {
    (u64::from(interval_us) * 1_000).abs_diff(u64::from(period_ns)) <= TOLERANCE_NS
}

/// The model of [`timings`] whose timing a model has.
pub(super) fn timing_of(model: Model) -> Model {
    match model {
        Model::Vlp16 | Model::PuckLite | Model::PuckHiRes => Model::Vlp16,
        Model::Hdl32e => Model::Hdl32e,
        Model::Hdl64eS2 => Model::Hdl64eS2,
        Model::Hdl64eS3 => Model::Hdl64eS3,
        Model::Vlp32c => Model::Vlp32c,
        Model::Vls128 => Model::Vls128,
    }
}
