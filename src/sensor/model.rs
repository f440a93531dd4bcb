//! The models as const tables: what differs between them stands here and nowhere else.

use std::sync::OnceLock;

use super::Calibration;
use crate::wire::data::{BLOCKS, RECORDS, ReturnMode};

/// A supported sensor model.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Model {
    /// VLP-16 "Puck": 16 beams, 2 degrees apart.
    Vlp16,
    /// Puck LITE: a lighter VLP-16 with the same beams, timing and product byte.
    PuckLite,
    /// Puck Hi-Res: 16 beams, 1.33 degrees apart.
    PuckHiRes,
    /// HDL-32E: 32 beams, 1.33 degrees apart.
    Hdl32e,
}

/// What a model is: names, factory byte, firing order and timing.
#[derive(Debug)]
pub struct Spec {
    /// Name in output, as the maker writes it.
    pub name: &'static str,
    /// Name as the value of `--model`.
    pub flag: &'static str,
    /// Factory byte 1205.
    pub product: u8,
    /// Beams, and so records of a firing and rows of the image.
    pub channels: usize,
    /// From one beam's shot to the next, nanoseconds.
    pub channel_period_ns: u32,
    /// From one firing to the next, nanoseconds.
    pub firing_period_ns: u32,
    /// Metres of one unit of distance.
    pub distance_unit_m: f64,
    /// Distance of the beams' common focal point from the axis, metres; where the vertical origin offsets come from.
    pub focal_radius_m: f64,
    /// This project's beam table, ROS YAML.
    calibration: &'static str,
    /// The same, for messages.
    calibration_file: &'static str,
}

/// VLP-16 User Manual 63-9243, sections 6 and 9.4 (timing), p. 54 (vertical offsets).
const VLP16: Spec = Spec {
    name: "VLP-16",
    flag: "vlp16",
    product: 0x22,
    channels: 16,
    channel_period_ns: 2_304,
    firing_period_ns: 55_296,
    distance_unit_m: 0.002,
    focal_radius_m: 0.041_91,
    calibration: include_str!("../../calib/vlp16.yaml"),
    calibration_file: "calib/vlp16.yaml",
};

const PUCK_LITE: Spec = Spec { name: "Puck LITE", flag: "puck-lite", ..VLP16 };

const PUCK_HIRES: Spec = Spec {
    name: "Puck Hi-Res",
    flag: "puck-hires",
    product: 0x24,
    calibration: include_str!("../../calib/puck-hires.yaml"),
    calibration_file: "calib/puck-hires.yaml",
    ..VLP16
};

/// HDL-32E User's Manual, pp. 12-13 and Appendix E; application note 63-9277 (the stamp is that of the first shot).
const HDL32E: Spec = Spec {
    name: "HDL-32E",
    flag: "hdl32e",
    product: 0x21,
    channels: 32,
    channel_period_ns: 1_152,
    firing_period_ns: 46_080,
    focal_radius_m: 0.028_83,
    calibration: include_str!("../../calib/hdl32e.yaml"),
    calibration_file: "calib/hdl32e.yaml",
    ..VLP16
};

impl Model {
    /// All supported models.
    pub const ALL: [Self; 4] = [Self::Vlp16, Self::PuckLite, Self::PuckHiRes, Self::Hdl32e];

    /// The table of this model.
    pub const fn spec(self) -> &'static Spec {
        match self {
            Self::Vlp16 => &VLP16,
            Self::PuckLite => &PUCK_LITE,
            Self::PuckHiRes => &PUCK_HIRES,
            Self::Hdl32e => &HDL32E,
        }
    }

    /// The number that stands for this model in the header of a sweep, from 1; it never changes its meaning.
    pub const fn code(self) -> u32 {
        self as u32 + 1
    }

    /// The model of a code.
    pub fn from_code(code: u32) -> Option<Self> {
        Self::ALL.into_iter().find(|model| model.code() == code)
    }

    /// The nominal beams of this model: the table in `calib/` that the binary embeds.
    pub fn calibration(self) -> &'static Calibration {
        static TABLES: [OnceLock<Calibration>; Model::ALL.len()] = [const { OnceLock::new() }; Model::ALL.len()];
        TABLES[self as usize].get_or_init(|| {
            let spec = self.spec();
            super::ros_yaml::parse(spec.calibration, spec.calibration_file)
                .expect("the tables in calib/ are part of the program and tested")
        })
    }
}

impl Spec {
    /// Firings that one block holds: two on a 16-beam model, one on a 32-beam model.
    pub const fn firings_per_block(&self) -> usize {
        RECORDS / self.channels
    }

    /// Firings of a data packet; in dual mode each takes two places.
    pub fn firings_per_packet(&self, mode: ReturnMode) -> usize {
        BLOCKS / mode.blocks_per_azimuth() * self.firings_per_block()
    }

    /// From one block azimuth to the next, nanoseconds.
    pub fn block_period_ns(&self) -> u32 {
        self.firing_period_ns * self.firings_per_block() as u32
    }

    /// From one data packet to the next by the sensor clock, nanoseconds.
    pub fn packet_period_ns(&self, mode: ReturnMode) -> u32 {
        self.firing_period_ns * self.firings_per_packet(mode) as u32
    }

    /// Shot of a channel after the first shot of its firing, nanoseconds.
    pub fn channel_offset_ns(&self, channel: usize) -> u32 {
        self.channel_period_ns * channel as u32
    }
}

impl std::fmt::Display for Model {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.spec().name)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn packet_periods_are_the_published_ones() {
        let period = |model: Model, mode| model.spec().packet_period_ns(mode);
        assert_eq!(period(Model::Vlp16, ReturnMode::Strongest), 1_327_104);
        assert_eq!(period(Model::Vlp16, ReturnMode::Dual), 663_552);
        assert_eq!(period(Model::Hdl32e, ReturnMode::Last), 552_960);
        assert_eq!(period(Model::Hdl32e, ReturnMode::Dual), 276_480);
    }

    #[test]
    fn elevations_are_the_published_ones() {
        let degrees = |model: Model| -> Vec<f64> {
            model.calibration().beams().iter().map(|b| b.elevation_rad.to_degrees()).collect()
        };
        let near = |a: &[f64], b: &[f64]| a.len() == b.len() && a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-9);
        let vlp16 = [-15., 1., -13., 3., -11., 5., -9., 7., -7., 9., -5., 11., -3., 13., -1., 15.];
        assert!(near(&degrees(Model::Vlp16), &vlp16));
        assert!(near(&degrees(Model::PuckLite), &vlp16));
        let hires =
            [-10.0, 0.67, -8.67, 2.0, -7.33, 3.33, -6.0, 4.67, -4.67, 6.0, -3.33, 7.33, -2.0, 8.67, -0.67, 10.0];
        assert!(near(&degrees(Model::PuckHiRes), &hires));
        // HDL-32E manual, Appendix B: even channels from -30.67, odd ones from -9.33, 4/3 degree apart, two decimals.
        let hdl32e: Vec<f64> = (0..32)
            .map(|k| {
                let exact = if k % 2 == 0 { -92.0 / 3.0 } else { -28.0 / 3.0 } + f64::from(k / 2) * 4.0 / 3.0;
                (exact * 100.0).round() / 100.0
            })
            .collect();
        assert!(near(&degrees(Model::Hdl32e), &hdl32e));
    }

    #[test]
    fn vertical_offsets_follow_from_the_focal_point() {
        for model in Model::ALL {
            for beam in model.calibration().beams() {
                let expected = -model.spec().focal_radius_m * beam.elevation_rad.tan();
                let found = beam.vertical_offset_m;
                assert!((found - expected).abs() < 0.000_5, "{model} channel {}: {found} {expected}", beam.channel);
            }
        }
    }
}
