//! The models as const tables: everything that differs between them is here.

use super::Calibration;
use super::fit::nominal;
pub use crate::sweep::sensor::{Model, Places, UnknownModel};
use crate::wire::data::{DataPacket, FLAG_UNUSED, FLAGS, RECORDS, ReturnMode};

/// Properties of a model: factory byte, firing order and timing.
#[derive(Debug, PartialEq)]
pub struct Spec {
    /// The model.
    pub model: Model,
    /// Factory byte 1205; `None` where that byte is something else.
    pub product: Option<u8>,
    /// Number of beams, of records in a firing and of rows in the image.
    pub channels: usize,
    /// Heads that fire together, each with its share of the channels.
    heads: usize,
    /// Firing times with one return, and with two.
    timing: [Timing; 2],
    /// What the time stamp of a packet is the time of.
    pub stamp: Stamp,
    /// Whether the rows of the image are shifted by whole columns, because the beams point far
    /// apart in azimuth.
    pub shifted: bool,
    /// Metres of one unit of distance.
    pub distance_unit_m: f64,
    /// A unit that calibration files of this model have by mistake, metres.
    pub(super) mistaken_unit_m: Option<f64>,
    /// The beams, where all units have the same.
    pub(super) nominal: Option<Nominal>,
}

/// Times of the shots of a firing, and of the next firing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Timing {
    /// From one firing to the next; the mean, if the lasers rest for a random time between them.
    firing_period_ns: u32,
    /// Standard deviation of that rest.
    rest_deviation_ns: u32,
    /// Shots of a head come in bursts: the period of bursts, and the time of each shot after the
    /// first of its burst.
    burst_period_ns: u32,
    burst_ns: &'static [u32],
    /// Bursts after which the lasers pause, each time, and for how long.
    pause: Option<(usize, u32)>,
}

/// What the time stamp of a packet is the time of.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stamp {
    /// Its first shot.
    FirstShot,
    /// The fourth burst of its first firing.
    FourthBurst,
    /// Its output: the end of its last firing, so that all shots are before it.
    Output,
}

/// The beams that all units of a model have.
#[derive(Debug, PartialEq)]
pub(super) struct Nominal {
    /// Distance of the beams' common focal point from the axis, metres; gives the vertical origin
    /// offsets.
    focal_radius_m: f64,
    /// This project's beam table, ROS YAML.
    pub(super) text: &'static str,
    /// The same, for messages.
    pub(super) file: &'static str,
}

/// Shots one by one, without a rest or a pause.
const SINGLE_SHOTS: Timing = Timing {
    firing_period_ns: 0,
    rest_deviation_ns: 0,
    burst_period_ns: 0,
    burst_ns: &[0],
    pause: None,
};

/// VLP-16 User Manual 63-9243, sections 6 and 9.4 (timing), p. 54 (vertical offsets).
const VLP16: Spec = Spec {
    model: Model::Vlp16,
    product: Some(0x22),
    channels: Model::Vlp16.channels(),
    heads: 1,
    timing: [Timing {
        firing_period_ns: 55_296,
        burst_period_ns: 2_304,
        ..SINGLE_SHOTS
    }; 2],
    stamp: Stamp::FirstShot,
    shifted: false,
    distance_unit_m: 0.002,
    mistaken_unit_m: None,
    nominal: Some(Nominal {
        focal_radius_m: 0.041_91,
        text: include_str!("../../calib/vlp16.yaml"),
        file: "calib/vlp16.yaml",
    }),
};

const PUCK_LITE: Spec = Spec {
    model: Model::PuckLite,
    ..VLP16
};

const PUCK_HIRES: Spec = Spec {
    model: Model::PuckHiRes,
    product: Some(0x24),
    nominal: Some(Nominal {
        focal_radius_m: 0.041_91,
        text: include_str!("../../calib/puck-hires.yaml"),
        file: "calib/puck-hires.yaml",
    }),
    ..VLP16
};

/// HDL-32E User's Manual, pp. 12-13 and Appendix E; application note 63-9277 (the stamp is that of
/// the first shot).
const HDL32E: Spec = Spec {
    model: Model::Hdl32e,
    product: Some(0x21),
    channels: Model::Hdl32e.channels(),
    timing: [Timing {
        firing_period_ns: 46_080,
        burst_period_ns: 1_152,
        ..SINGLE_SHOTS
    }; 2],
    nominal: Some(Nominal {
        focal_radius_m: 0.028_83,
        text: include_str!("../../calib/hdl32e.yaml"),
        file: "calib/hdl32e.yaml",
    }),
    ..VLP16
};

/// Laser firing time table of the HDL-64E S2 manual, Rev D, p. 38: bursts of four lasers of each
/// head. The first laser of a packet fires a packet's period before the stamp, the last one 2.34 us
/// before it.
const EVERY_48_US: Timing = Timing {
    firing_period_ns: 48_000,
    burst_period_ns: 6_000,
    burst_ns: &[0, 1_260, 2_460, 3_660],
    ..SINGLE_SHOTS
};

/// Laser firing time table of the HDL-64E S3 manual, 63-HDL64ES3, p. 48.
const EVERY_57_6_US: Timing = Timing {
    firing_period_ns: 57_600,
    burst_period_ns: 7_200,
    burst_ns: &[0, 1_300, 2_500, 3_700],
    ..SINGLE_SHOTS
};

/// HDL-64E S2 manual, Appendix D; S3 manual pp. 20 and 47. An S2 reports one return only: a sensor
/// with two is an S3.
const HDL64E_S2: Spec = Spec {
    model: Model::Hdl64eS2,
    product: None,
    channels: Model::Hdl64eS2.channels(),
    heads: 2,
    timing: [EVERY_48_US, EVERY_57_6_US],
    stamp: Stamp::Output,
    shifted: true,
    nominal: None,
    ..VLP16
};

/// With one return, packets of an S3 come 288 us apart in most sources.
const HDL64E_S3: Spec = Spec {
    model: Model::Hdl64eS3,
    ..HDL64E_S2
};

/// With one return, packets of an S3 come 345.6 us apart in some sources.
const HDL64E_S3_SLOW: Spec = Spec {
    timing: [EVERY_57_6_US; 2],
    ..HDL64E_S3
};

/// VLP-32C User Manual 63-9325, pp. 53-69: two beams fire at once.
const VLP32C: Spec = Spec {
    model: Model::Vlp32c,
    product: Some(0x28),
    channels: Model::Vlp32c.channels(),
    timing: [Timing {
        firing_period_ns: 55_296,
        burst_period_ns: 2_304,
        burst_ns: &[0; 2],
        ..SINGLE_SHOTS
    }; 2],
    shifted: true,
    distance_unit_m: 0.004,
    nominal: Some(Nominal {
        focal_radius_m: 0.042_4,
        text: include_str!("../../calib/vlp32c.yaml"),
        file: "calib/vlp32c.yaml",
    }),
    ..VLP16
};

/// VLS-128 User Manual 63-9483, pp. 53-64: eight beams fire at once, sixteen times, with a pause of
/// two slots in the middle, and two slots at the end. Newer firmware then rests for a random time,
/// 1.94 us on average (measured).
const EVERY_55_3_US: Timing = Timing {
    firing_period_ns: 55_273,
    rest_deviation_ns: 370,
    burst_period_ns: 2_667,
    burst_ns: &[0; 8],
    pause: Some((8, 2 * 2_667)),
};

/// The same without the rest, as older firmware has it.
const EVERY_53_3_US: Timing = Timing {
    firing_period_ns: 53_333,
    rest_deviation_ns: 0,
    ..EVERY_55_3_US
};

/// Slower shots, which velodyne_decoder gives for firmware from 5.2.3 on.
const EVERY_57_8_US: Timing = Timing {
    firing_period_ns: 57_800,
    burst_period_ns: 2_890,
    pause: Some((8, 2 * 2_890)),
    ..EVERY_53_3_US
};

const VLS128: Spec = Spec {
    model: Model::Vls128,
    product: Some(0xA1),
    channels: Model::Vls128.channels(),
    timing: [EVERY_55_3_US; 2],
    stamp: Stamp::FourthBurst,
    shifted: true,
    distance_unit_m: 0.004,
    mistaken_unit_m: Some(0.007),
    nominal: Some(Nominal {
        focal_radius_m: 0.058_63,
        text: include_str!("../../calib/vls128.yaml"),
        file: "calib/vls128.yaml",
    }),
    ..VLP16
};

const VLS128_STEADY: Spec = Spec {
    timing: [EVERY_53_3_US; 2],
    ..VLS128
};

const VLS128_SLOW: Spec = Spec {
    timing: [EVERY_57_8_US; 2],
    ..VLS128
};

/// What the driver knows of a [`Model`].
pub trait ModelExt {
    /// The table of this model.
    fn spec(self) -> &'static Spec;

    /// All tables of this model, [`ModelExt::spec`] first; the packet period decides. An HDL-64E S3
    /// has one more, in which a firing takes 57.6 us with one return as well: sources contradict
    /// each other. Firmware of the VLS-128 has three timings.
    fn specs(self) -> &'static [&'static Spec];

    /// The nominal beams of this model, the table in `calib/` that the binary embeds; `None` where
    /// each unit has its own.
    fn calibration(self) -> Option<&'static Calibration>;
}

impl ModelExt for Model {
    fn spec(self) -> &'static Spec {
        Spec::of(self)
    }

    fn specs(self) -> &'static [&'static Spec] {
        Spec::all_of(self)
    }

    fn calibration(self) -> Option<&'static Calibration> {
        nominal(self)
    }
}

impl Spec {
    /// The table of a model: [`ModelExt::spec`] in constants.
    pub(crate) const fn of(model: Model) -> &'static Self {
        match model {
            Model::Vlp16 => &VLP16,
            Model::PuckLite => &PUCK_LITE,
            Model::PuckHiRes => &PUCK_HIRES,
            Model::Hdl32e => &HDL32E,
            Model::Hdl64eS2 => &HDL64E_S2,
            Model::Hdl64eS3 => &HDL64E_S3,
            Model::Vlp32c => &VLP32C,
            Model::Vls128 => &VLS128,
        }
    }

    /// All tables of a model: [`ModelExt::specs`] in constants.
    pub(super) const fn all_of(model: Model) -> &'static [&'static Self] {
        match model {
            Model::Vlp16 => &[&VLP16],
            Model::PuckLite => &[&PUCK_LITE],
            Model::PuckHiRes => &[&PUCK_HIRES],
            Model::Hdl32e => &[&HDL32E],
            Model::Hdl64eS2 => &[&HDL64E_S2],
            Model::Hdl64eS3 => &[&HDL64E_S3, &HDL64E_S3_SLOW],
            Model::Vlp32c => &[&VLP32C],
            Model::Vls128 => &[&VLS128, &VLS128_STEADY, &VLS128_SLOW],
        }
    }

    /// Lasers of a block; a firing of more beams takes several blocks.
    pub const fn channels_per_block(&self) -> usize {
        if self.channels < RECORDS {
            self.channels
        } else {
            RECORDS
        }
    }

    /// Banks of 32 channels; one return of a firing takes a block of each.
    pub const fn banks(&self) -> usize {
        self.channels.div_ceil(RECORDS)
    }

    /// Where the returns of an azimuth are.
    pub const fn places(&self, mode: ReturnMode) -> Places {
        self.model.places(mode)
    }

    /// Writes the bank marker of each block, as a packet of this model has it.
    pub fn mark_banks(&self, packet: &mut DataPacket, mode: ReturnMode) {
        let places = self.places(mode);
        for (index, block) in packet.blocks.iter_mut().enumerate() {
            let bank = index % places.blocks / places.bank_step % self.banks();
            let is_used = index < places.blocks * places.azimuths;
            block
                .flag
                .set(if is_used { FLAGS[bank] } else { FLAG_UNUSED[1] });
        }
    }

    /// Firings that share one azimuth: two on a 16-beam model, else one.
    pub const fn firings_per_azimuth(&self) -> usize {
        RECORDS / self.channels_per_block()
    }

    /// Firings of a data packet.
    pub fn firings_per_packet(&self, mode: ReturnMode) -> usize {
        self.places(mode).azimuths * self.firings_per_azimuth()
    }

    fn timing(&self, mode: ReturnMode) -> &Timing {
        &self.timing[mode.returns() - 1]
    }

    /// From one firing to the next, nanoseconds.
    pub fn firing_period_ns(&self, mode: ReturnMode) -> u32 {
        self.timing(mode).firing_period_ns
    }

    /// From one azimuth to the next, nanoseconds.
    pub fn azimuth_period_ns(&self, mode: ReturnMode) -> u32 {
        self.firing_period_ns(mode) * self.firings_per_azimuth() as u32
    }

    /// From one data packet to the next by the sensor clock, nanoseconds.
    pub fn packet_period_ns(&self, mode: ReturnMode) -> u32 {
        self.firing_period_ns(mode) * self.firings_per_packet(mode) as u32
    }

    /// Shot of a channel after the first shot of its firing, nanoseconds. The two heads of an
    /// HDL-64E fire together.
    pub fn channel_offset_ns(&self, channel: usize, mode: ReturnMode) -> u32 {
        let Timing {
            burst_period_ns,
            burst_ns,
            pause,
            ..
        } = self.timing(mode);
        let shot = channel % (self.channels / self.heads);
        let burst = shot / burst_ns.len();
        let paused_ns = pause.map_or(0, |(bursts, pause_ns)| (burst / bursts) as u32 * pause_ns);
        burst_period_ns * burst as u32 + paused_ns + burst_ns[shot % burst_ns.len()]
    }

    /// Standard deviation of the time from one firing to the next, nanoseconds: 0 where the lasers
    /// do not rest for a random time.
    pub fn firing_deviation_ns(&self, mode: ReturnMode) -> f64 {
        f64::from(self.timing(mode).rest_deviation_ns)
    }

    /// First shot of a packet after its stamp, nanoseconds: 0 or less. `silent_ns` is the time in
    /// the packet during which the sensor left a sector out.
    pub fn first_shot_ns(&self, mode: ReturnMode, silent_ns: i64) -> i64 {
        match self.stamp {
            Stamp::FirstShot => 0,
            Stamp::FourthBurst => -3 * i64::from(self.timing(mode).burst_period_ns),
            Stamp::Output => -i64::from(self.packet_period_ns(mode)) - silent_ns,
        }
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
        assert_eq!(period(Model::Hdl64eS2, ReturnMode::Strongest), 288_000);
        assert_eq!(period(Model::Hdl64eS3, ReturnMode::Dual), 172_800);
        assert_eq!(period(Model::Vlp32c, ReturnMode::Last), 663_552);
        assert_eq!(period(Model::Vlp32c, ReturnMode::Dual), 331_776);
        // 160.0, 165.82 and 173.4 us, to a few nanoseconds; a third of that with two returns.
        let vls128 = |mode| {
            Model::Vls128
                .specs()
                .iter()
                .map(move |spec| spec.packet_period_ns(mode))
        };
        assert!(vls128(ReturnMode::Last).eq([165_819, 159_999, 173_400]));
        assert!(vls128(ReturnMode::Dual).eq([55_273, 53_333, 57_800]));
        assert_eq!(
            Model::Hdl64eS3.specs()[1].packet_period_ns(ReturnMode::Strongest),
            345_600
        );
    }

    /// HDL-64E manuals: the last four lasers fire 6.0, 4.74, 3.54 and 2.34 us before the output of
    /// the packet (S2), and 7.2, 5.9, 4.7 and 3.5 us (S3, two returns).
    #[test]
    fn the_lasers_of_an_hdl64e_fire_in_bursts_before_the_stamp() {
        for (mode, expected) in [
            (ReturnMode::Strongest, [6_000, 4_740, 3_540, 2_340]),
            (ReturnMode::Dual, [7_200, 5_900, 4_700, 3_500]),
        ] {
            let spec = Model::Hdl64eS3.spec();
            let last = spec.firing_period_ns(mode) as usize * (spec.firings_per_packet(mode) - 1);
            let before = |channel| {
                -(spec.first_shot_ns(mode, 0)
                    + last as i64
                    + i64::from(spec.channel_offset_ns(channel, mode)))
            };
            assert_eq!([28, 29, 30, 31].map(before), expected);
            assert_eq!([60, 61, 62, 63].map(before), expected);
        }
    }

    #[test]
    fn elevations_are_the_published_ones() {
        let degrees = |model: Model| -> Vec<f64> {
            model
                .calibration()
                .unwrap()
                .beams()
                .iter()
                .map(|b| b.elevation_rad.to_degrees())
                .collect()
        };
        let near = |a: &[f64], b: &[f64]| {
            a.len() == b.len() && a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-9)
        };
        let vlp16 = [
            -15., 1., -13., 3., -11., 5., -9., 7., -7., 9., -5., 11., -3., 13., -1., 15.,
        ];
        assert!(near(&degrees(Model::Vlp16), &vlp16));
        assert!(near(&degrees(Model::PuckLite), &vlp16));
        let hires = [
            -10.0, 0.67, -8.67, 2.0, -7.33, 3.33, -6.0, 4.67, -4.67, 6.0, -3.33, 7.33, -2.0, 8.67,
            -0.67, 10.0,
        ];
        assert!(near(&degrees(Model::PuckHiRes), &hires));
        // HDL-32E manual, Appendix B: even channels from -30.67, odd ones from -9.33, 4/3 degree
        // apart, two decimals.
        let hdl32e: Vec<f64> = (0..32)
            .map(|k| {
                let exact = if k % 2 == 0 { -92.0 / 3.0 } else { -28.0 / 3.0 }
                    + f64::from(k / 2) * 4.0 / 3.0;
                (exact * 100.0).round() / 100.0
            })
            .collect();
        assert!(near(&degrees(Model::Hdl32e), &hdl32e));
    }

    #[test]
    fn vertical_offsets_follow_from_the_focal_point() {
        for model in Model::ALL {
            let Some(nominal) = &model.spec().nominal else {
                continue;
            };
            for beam in model.calibration().unwrap().beams() {
                let expected = -nominal.focal_radius_m * beam.elevation_rad.tan();
                let found = beam.vertical_offset_m;
                assert!(
                    (found - expected).abs() < 0.000_5,
                    "{model} channel {}: {found} {expected}",
                    beam.channel
                );
            }
        }
    }
}
