//! The colours of labels: the same in pictures and in viewers.

use std::sync::LazyLock;

use sweepd_sweep::layout::{LABEL_FIRST_SEGMENT, LABEL_GROUND, LABEL_NONE};

/// Red, green and blue in the encoding of sRGB.
pub type Rgb = [u8; 3];

/// A return without label.
pub const UNLABELLED: Rgb = [62, 78, 118];
/// Ground.
pub const GROUND: Rgb = [112, 112, 112];

/// Colour of a label. A number has the same colour everywhere.
pub fn label(label: u32) -> Rgb {
    match label {
        LABEL_NONE => UNLABELLED,
        LABEL_GROUND => GROUND,
        _ => SEGMENTS[(label - LABEL_FIRST_SEGMENT) as usize % SEGMENTS.len()],
    }
}

/// Labels follow the order in which segments appear, so that consecutive numbers are often
/// neighbours in space: successive hues are a golden section of the circle apart, and lightness
/// alternates.
static SEGMENTS: LazyLock<[Rgb; 1000]> = LazyLock::new(|| {
    std::array::from_fn(|index| {
        let hue_turns = (index as f64 * 0.618_034 + 0.35).fract();
        vivid(
            [0.78, 0.62, 0.89, 0.70][index % 4],
            hue_turns * std::f64::consts::TAU,
        )
    })
});

/// The most saturated colour of this lightness and hue that a screen shows, limited so that it does
/// not glare.
fn vivid(lightness: f64, hue_rad: f64) -> Rgb {
    let shown = (4..=19)
        .rev()
        .map(|chroma| oklch(lightness, f64::from(chroma) * 0.01, hue_rad));
    let [r, g, b] = shown
        .clone()
        .find(|rgb| rgb.iter().all(|c| (0.0..=1.0).contains(c)))
        .unwrap_or([lightness; 3]);
    [srgb(r), srgb(g), srgb(b)]
}

/// A linear channel, 0 to 1, in the encoding of sRGB.
fn srgb(linear: f64) -> u8 {
    let encoded = if linear <= 0.003_130_8 {
        12.92 * linear
    } else {
        1.055 * linear.powf(1.0 / 2.4) - 0.055
    };
    (encoded * 255.0).round() as u8
}

/// OKLCH to linear sRGB (B. Ottosson, "A perceptual color space for image processing", 2020):
/// colours of equal lightness look equally light, which those of HSL do not.
fn oklch(lightness: f64, chroma: f64, hue_rad: f64) -> [f64; 3] {
    let a = chroma * hue_rad.cos();
    let b = chroma * hue_rad.sin();
    let l = (lightness + 0.396_337_777_4 * a + 0.215_803_757_3 * b).powi(3);
    let m = (lightness - 0.105_561_345_8 * a - 0.063_854_172_8 * b).powi(3);
    let s = (lightness - 0.089_484_177_5 * a - 1.291_485_548_0 * b).powi(3);
    [
        4.076_741_662_1 * l - 3.307_711_591_3 * m + 0.230_969_929_2 * s,
        -1.268_438_004_6 * l + 2.609_757_401_1 * m - 0.341_319_396_5 * s,
        -0.004_196_086_3 * l - 0.703_418_614_7 * m + 1.707_614_701_0 * s,
    ]
}
