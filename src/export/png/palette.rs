//! The colours of a picture: one meaning each, the same in every panel.

use embedded_graphics::pixelcolor::{Rgb888, RgbColor};

use sweepd_messages::palette as label_palette;

/// The page.
pub const BACKGROUND: Rgb888 = Rgb888::new(20, 22, 28);
/// Where nothing was measured.
pub const NO_RETURN: Rgb888 = Rgb888::new(6, 7, 10);
/// Text.
pub const TEXT: Rgb888 = Rgb888::new(228, 231, 238);
/// Text of the second order.
pub const DIM: Rgb888 = Rgb888::new(146, 153, 170);
/// Frames, rings and axes.
pub const GRID: Rgb888 = Rgb888::new(52, 57, 70);
/// What a reader should not overlook.
pub const WARNING: Rgb888 = Rgb888::new(255, 176, 64);
/// A return without label.
pub const UNLABELLED: Rgb888 = shown(label_palette::UNLABELLED);
/// Ground.
pub const GROUND: Rgb888 = shown(label_palette::GROUND);
/// Ground seen from above, where it is only the background of what stands on it.
pub const GROUND_FAINT: Rgb888 = Rgb888::new(66, 66, 68);
/// The rim of a text that is drawn over a panel.
pub const RIM: Rgb888 = Rgb888::new(0, 0, 0);
/// A lost column, in stripes with [`MISSING_STRIPE`].
pub const MISSING: Rgb888 = Rgb888::new(84, 12, 20);
/// The other stripe of a lost column.
pub const MISSING_STRIPE: Rgb888 = Rgb888::new(40, 8, 12);

/// Colour of a pixel of a lost column: diagonal stripes.
pub fn missing(x: i32, y: i32) -> Rgb888 {
    if (x + y).rem_euclid(8) < 4 {
        MISSING
    } else {
        MISSING_STRIPE
    }
}

/// Colour of a label. A number has the same colour in every picture, and in viewers of the messages.
pub fn label(label: u32) -> Rgb888 {
    shown(label_palette::label(label))
}

const fn shown([r, g, b]: label_palette::Rgb) -> Rgb888 {
    Rgb888::new(r, g, b)
}

/// Ranges as colours, warm near and cold far, on a logarithmic scale, since near ranges matter
/// most.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RangeScale {
    near_m: f64,
    far_m: f64,
}

impl RangeScale {
    /// Each darker than the one before, so that people who do not tell red from green see the order too.
    const COLORS: [Rgb888; 6] = [
        Rgb888::new(255, 244, 150),
        Rgb888::new(255, 190, 70),
        Rgb888::new(246, 126, 76),
        Rgb888::new(200, 90, 140),
        Rgb888::new(116, 86, 190),
        Rgb888::new(40, 76, 160),
    ];

    /// A scale that spreads over nearly all of these ranges, between round numbers, so that sweeps
    /// of one place share it.
    pub fn of(ranges_m: &mut [f64]) -> Self {
        if ranges_m.is_empty() {
            return Self {
                near_m: 1.0,
                far_m: 100.0,
            };
        }
        let near_m = round_down(percentile(ranges_m, 1)).max(0.1);
        let far_m = round_up(percentile(ranges_m, 99)).max(2.0 * near_m);
        Self { near_m, far_m }
    }

    /// Place of a range on the scale, 0 near to 1 far.
    pub fn position(&self, range_m: f64) -> f64 {
        ((range_m / self.near_m).ln() / (self.far_m / self.near_m).ln()).clamp(0.0, 1.0)
    }

    /// Colour of a place on the scale.
    pub fn color_at(position: f64) -> Rgb888 {
        let place = position * (Self::COLORS.len() - 1) as f64;
        let first = (place as usize).min(Self::COLORS.len() - 2);
        mixed(
            Self::COLORS[first],
            Self::COLORS[first + 1],
            place - first as f64,
        )
    }

    /// Colour of a range.
    pub fn color(&self, range_m: f64) -> Rgb888 {
        Self::color_at(self.position(range_m))
    }

    /// Round numbers on the scale, metres.
    pub fn ticks_m(&self) -> impl Iterator<Item = f64> + use<> {
        let far_m = self.far_m * 1.000_1;
        std::iter::successors(Some(self.near_m), |&tick| Some(round_up(tick * 1.01)))
            .take_while(move |&tick| tick <= far_m)
    }
}

/// Reflectivities as colours: diffuse surfaces as shades of grey, the darker ones spread;
/// retro-reflectors warm.
pub struct ReflectivityScale;

impl ReflectivityScale {
    /// The most reflective diffuse surface.
    const DIFFUSE: u8 = 100;
    /// Part of the scale that diffuse surfaces take.
    const DIFFUSE_PART: f64 = 0.7;
    /// Where the scale has numbers.
    pub const TICKS: [u8; 7] = [0, 10, 25, 50, 100, 175, 255];

    /// Place of a reflectivity on the scale, 0 to 1.
    pub fn position(reflectivity: u8) -> f64 {
        match reflectivity.checked_sub(Self::DIFFUSE) {
            Some(above) => {
                Self::DIFFUSE_PART + (1.0 - Self::DIFFUSE_PART) * f64::from(above) / 155.0
            }
            None => {
                Self::DIFFUSE_PART * (f64::from(reflectivity) / f64::from(Self::DIFFUSE)).sqrt()
            }
        }
    }

    /// Colour of a place on the scale.
    pub fn color_at(position: f64) -> Rgb888 {
        if position <= Self::DIFFUSE_PART {
            mixed(
                Rgb888::new(34, 36, 42),
                Rgb888::new(250, 250, 250),
                position / Self::DIFFUSE_PART,
            )
        } else {
            let part = (position - Self::DIFFUSE_PART) / (1.0 - Self::DIFFUSE_PART);
            mixed(Rgb888::new(190, 48, 24), Rgb888::new(255, 236, 96), part)
        }
    }

    /// Colour of a reflectivity.
    pub fn color(reflectivity: u8) -> Rgb888 {
        Self::color_at(Self::position(reflectivity))
    }
}

/// A colour between two, 0 the first to 1 the second.
fn mixed(from: Rgb888, to: Rgb888, part: f64) -> Rgb888 {
    Rgb888::new(
        between(from.r(), to.r(), part),
        between(from.g(), to.g(), part),
        between(from.b(), to.b(), part),
    )
}

fn between(from: u8, to: u8, part: f64) -> u8 {
    let from = f64::from(from);
    (from + (f64::from(to) - from) * part).round() as u8
}

/// The percentile of the values. Reorders them; there must be at least one.
fn percentile(values: &mut [f64], percent: usize) -> f64 {
    let index = (values.len() - 1) * percent / 100;
    *values.select_nth_unstable_by(index, f64::total_cmp).1
}

/// The next of 1, 2, 5, 10, 20, 50... from a positive value up.
pub fn round_up(value: f64) -> f64 {
    let decade = 10_f64.powf(value.log10().floor());
    let steps = [1.0, 2.0, 5.0].map(|step| step * decade);
    steps
        .into_iter()
        .find(|&step| step >= value * 0.999_999)
        .unwrap_or(10.0 * decade)
}

fn round_down(value: f64) -> f64 {
    let decade = 10_f64.powf(value.log10().floor());
    let steps = [5.0, 2.0].map(|step| step * decade);
    steps
        .into_iter()
        .find(|&step| step <= value * 1.000_001)
        .unwrap_or(decade)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn apart(a: Rgb888, b: Rgb888) -> i32 {
        let squared = |a: u8, b: u8| (i32::from(a) - i32::from(b)).pow(2);
        (squared(a.r(), b.r()) + squared(a.g(), b.g()) + squared(a.b(), b.b())).isqrt()
    }

    #[test]
    fn labels_of_near_numbers_and_other_meanings_look_different() {
        let meanings = [
            NO_RETURN,
            UNLABELLED,
            GROUND,
            MISSING,
            MISSING_STRIPE,
            BACKGROUND,
        ];
        for number in 2..2500 {
            for step in 1..=4 {
                let apart = apart(label(number), label(number + step));
                assert!(
                    apart > 50,
                    "labels {number} and {} are {apart} apart",
                    number + step
                );
            }
            assert!(
                apart(label(number), label(number + 1)) > 90,
                "labels {number} and the next"
            );
            assert!(
                meanings
                    .iter()
                    .all(|&meaning| apart(label(number), meaning) > 55),
                "label {number}"
            );
        }
        for (index, &a) in meanings.iter().enumerate() {
            assert!(meanings[..index].iter().all(|&b| apart(a, b) > 20), "{a:?}");
        }
        assert!(label(u32::MAX) != GROUND);
    }

    #[test]
    fn a_scale_spans_its_ranges_with_round_ticks() {
        let mut ranges: Vec<f64> = (0..1000).map(|i| 2.3 + f64::from(i) * 0.04).collect();
        let scale = RangeScale::of(&mut ranges);
        assert_eq!(
            scale,
            RangeScale {
                near_m: 2.0,
                far_m: 50.0
            }
        );
        assert_eq!(
            scale.ticks_m().collect::<Vec<_>>(),
            [2.0, 5.0, 10.0, 20.0, 50.0]
        );
        assert_eq!(
            (
                scale.position(2.0),
                scale.position(10_f64),
                scale.position(900.0)
            ),
            (0.0, 0.5, 1.0)
        );
        assert_eq!(
            RangeScale::of(&mut [7.0]),
            RangeScale {
                near_m: 5.0,
                far_m: 10.0
            }
        );
        let [near, far] = [2.0, 50.0].map(|range_m| scale.color(range_m));
        assert!(near.r() > near.b() && far.r() < far.b());
    }

    #[test]
    fn rounding_by_hand() {
        assert_eq!(
            [0.3, 1.0, 1.1, 20.0, 21.0, 60.0].map(round_up),
            [0.5, 1.0, 2.0, 20.0, 50.0, 100.0]
        );
        assert_eq!(
            [0.3, 1.0, 1.9, 20.0, 49.0, 60.0].map(round_down),
            [0.2, 1.0, 1.0, 20.0, 20.0, 50.0]
        );
    }
}
