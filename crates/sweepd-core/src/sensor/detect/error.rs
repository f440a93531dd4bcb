//! Why the model of a stream cannot be detected.

use super::timing::timings;
use crate::sensor::Model;
use crate::wire::data::{Banks, ReturnMode};

/// Why there is no model.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum DetectError {
    /// A known sensor that is not supported.
    #[error("this is the stream of another sensor, {sensor}")]
    Unsupported {
        /// The sensor.
        sensor: &'static str,
    },
    /// A product byte that no known sensor sends.
    #[error("product byte {product:#04x} belongs to no known sensor")]
    UnknownProduct {
        /// The byte.
        product: u8,
    },
    /// The user or the product byte says one model, the packet period another.
    #[error(
        "{} is {said}, but packets come {interval_us} us apart, as those of the {timing} do",
        if *.given { "the given model" } else { "the model by the product byte" }
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
    /// The user gives one model, but the blocks have the layout of another.
    #[error("the given model is {said}, but the blocks of its packets {}", layout(*.banks))]
    Layout {
        /// The model that was said.
        said: Model,
        /// How they are laid out.
        banks: Banks,
    },
    /// The packet period is that of no supported model.
    #[error(
        "packets come {median_us} us apart by the sensor clock, expected in {mode} mode: {}",
        expected(*.mode, *.banks)
    )]
    UnknownPeriod {
        /// The median interval, microseconds.
        median_us: u32,
        /// The return mode that the packets seem to have.
        mode: ReturnMode,
        /// How the blocks are laid out.
        banks: Banks,
    },
    /// The clock of the sensor stands still, or its ticks are longer than a packet takes.
    #[error("the stamps of its packets {}, so they are in no order", clock(*.tick_us))]
    Clock {
        /// A tick, microseconds; 0 if it stands still.
        tick_us: u32,
    },
    /// Blank factory bytes, and too few packets to measure their period.
    #[error("the factory bytes are blank, and {packets} packets are too few to detect the model")]
    TooFewPackets {
        /// Packets that there were.
        packets: usize,
    },
}

/// What such a clock does.
fn clock(tick_us: u32) -> String {
    match tick_us {
        0 => "stand still".to_owned(),
        us => format!("go on in steps of {us} us"),
    }
}

/// Packet periods of the supported models with these returns and banks.
fn expected(mode: ReturnMode, banks: Banks) -> String {
    let periods = timings(banks).iter().map(|(model, spec)| {
        let us = f64::from(spec.packet_period_ns(mode)) / 1e3;
        format!("{us:.1} us on the {model}")
    });
    periods.collect::<Vec<_>>().join(", ")
}

/// How the blocks of packets are laid out.
fn layout(banks: Banks) -> &'static str {
    match banks.count() {
        Some(1) => "have one bank of lasers, as those of the VLP-16, HDL-32E and VLP-32C do",
        Some(2) => "alternate between two heads, as those of the HDL-64E do",
        _ => "have four banks of lasers, as those of the VLS-128 do",
    }
}
