//! Colours as people see them who do not tell red from green.

use embedded_graphics::pixelcolor::RgbColor;
use sweepd::export::png::palette::RangeScale;
use sweepd_messages::palette::{self, GROUND, Rgb, UNLABELLED};

use crate::browser::Tab;
use crate::captures::fixture;
use crate::page::View;

type Matrix = [[f64; 3]; 3];

/// What eyes make of linear red, green and blue: all three cones, then none for red, none for green
/// (Machado, Oliveira and Fernandes, "A physiologically-based model for simulation of color vision
/// deficiency", 2009, severity 1).
const EYES: [Matrix; 3] = [
    [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
    [
        [0.152_286, 1.052_583, -0.204_868],
        [0.114_503, 0.786_281, 0.099_216],
        [-0.003_882, -0.048_116, 1.051_998],
    ],
    [
        [0.367_322, 0.860_646, -0.227_968],
        [0.280_085, 0.672_501, 0.047_413],
        [-0.011_820, 0.042_940, 0.968_881],
    ],
];
/// From linear red, green and blue to cones, and from their cube roots to OKLab (B. Ottosson, "A
/// perceptual color space for image processing", 2020).
const TO_CONES: Matrix = [
    [0.412_221_470_8, 0.536_332_536_3, 0.051_445_992_9],
    [0.211_903_498_2, 0.680_699_545_1, 0.107_396_956_6],
    [0.088_302_461_9, 0.281_718_837_6, 0.629_978_700_5],
];
const TO_OKLAB: Matrix = [
    [0.210_454_255_3, 0.793_617_785_0, -0.004_072_046_8],
    [1.977_998_495_1, -2.428_592_205_0, 0.450_593_709_9],
    [0.025_904_037_1, 0.782_771_766_2, -0.808_675_766_0],
];
const NO_RETURN: Rgb = [6, 7, 10];
/// The page, and its panels.
const GROUNDS: [Rgb; 3] = [NO_RETURN, [20, 22, 28], [34, 38, 47]];

fn times(matrix: &Matrix, vector: [f64; 3]) -> [f64; 3] {
    matrix.map(|row| row[0] * vector[0] + row[1] * vector[1] + row[2] * vector[2])
}

fn linear(colour: Rgb) -> [f64; 3] {
    colour.map(|channel| {
        let part = f64::from(channel) / 255.0;
        if part <= 0.040_45 {
            part / 12.92
        } else {
            ((part + 0.055) / 1.055).powf(2.4)
        }
    })
}

/// What one sees of a colour: lightness 0 to 1, greenness to redness, blueness to yellowness.
fn seen(colour: Rgb, eye: &Matrix) -> [f64; 3] {
    let seen = times(eye, linear(colour)).map(|part| part.clamp(0.0, 1.0));
    times(&TO_OKLAB, times(&TO_CONES, seen).map(f64::cbrt))
}

/// How different two colours look: 0.02 is just seen side by side.
fn apart(one: Rgb, other: Rgb, eye: &Matrix) -> f64 {
    let [one, other] = [one, other].map(|colour| seen(colour, eye));
    let squares = one.iter().zip(other).map(|(a, b)| (a - b).powi(2));
    squares.sum::<f64>().sqrt()
}

/// The contrast of WCAG 2, 1 to 21.
fn contrast(one: Rgb, other: Rgb) -> f64 {
    let luminance = |colour| {
        let [r, g, b] = linear(colour);
        0.2126 * r + 0.7152 * g + 0.0722 * b + 0.05
    };
    let (one, other) = (luminance(one), luminance(other));
    one.max(other) / one.min(other)
}

/// Near numbers are often neighbours in space. Numbers are written in their colours.
#[test]
fn near_labels_look_different_to_everybody() {
    for label in 2..1000 {
        let colour = palette::label(label);
        for eye in &EYES {
            for next in label + 1..=label + 5 {
                let apart = apart(colour, palette::label(next), eye);
                assert!(apart > 0.11, "{label} and {next}: {apart}");
            }
            for meaning in [NO_RETURN, UNLABELLED, GROUND] {
                assert!(apart(colour, meaning, eye) > 0.1, "{label}, {meaning:?}");
            }
        }
        assert!(contrast(colour, NO_RETURN) > 4.5, "{label}");
    }
}

/// Each eighth of a scale is lighter than the next, or darker than it, all the way.
fn assert_ordered(scale: &[Rgb], name: &str) {
    for eye in &EYES {
        let steps = scale.windows(2).map(|pair| {
            let [one, other] = [pair[0], pair[1]].map(|colour| seen(colour, eye)[0]);
            (apart(pair[0], pair[1], eye), other > one)
        });
        let steps: Vec<_> = steps.collect();
        assert!(steps.iter().all(|step| step.0 > 0.035), "{name}: {steps:?}");
        assert!(
            steps.iter().all(|step| step.1 == steps[0].1),
            "{name}: {steps:?}"
        );
    }
}

fn eighths() -> impl Iterator<Item = f64> {
    (0..=8).map(|eighth| f64::from(eighth) / 8.0)
}

/// The colours that an expression of the page's palette makes, as lists of channels.
fn of_page(tab: &mut Tab, expression: &str) -> Vec<Rgb> {
    let text = tab.text(&format!(
        "import('/page/palette.js').then((palette) => ({expression}).map((colour) => \
         [colour & 255, (colour >> 8) & 255, (colour >> 16) & 255].join(' ')).join())"
    ));
    let colours = text.split(',').map(|colour| {
        let channels: Vec<u8> = colour
            .split(' ')
            .map(|part| part.parse().unwrap())
            .collect();
        channels.try_into().unwrap()
    });
    colours.collect()
}

fn scale_of_page(tab: &mut Tab, name: &str) -> Vec<Rgb> {
    let places = "[...Array(9).keys()].map((eighth) => eighth / 8)";
    of_page(
        tab,
        &format!("{places}.map((place) => palette.at(palette.{name}, place))"),
    )
}

#[test]
#[cfg_attr(without_chromium, ignore = "no chromium")]
fn the_page_has_the_colours_of_pictures_and_texts_that_can_be_read() {
    let view = View::start(&[&fixture("street_vlp16.pcap.gz")]);
    let mut tab = Tab::open(&format!("http://{}/", view.host));
    let labels = of_page(
        &mut tab,
        "Array.from({ length: 100 }, (_, label) => palette.label(label))",
    );
    assert_eq!(labels, (0..100).map(palette::label).collect::<Vec<_>>());
    let ranges = scale_of_page(&mut tab, "RANGE");
    for (place, colour) in eighths().zip(&ranges) {
        let picture = RangeScale::color_at(place);
        let picture = [picture.r(), picture.g(), picture.b()];
        // The page has 512 steps.
        assert!(apart(picture, *colour, &EYES[0]) < 0.005, "{place}");
    }
    assert_ordered(&ranges, "ranges");
    assert_ordered(&scale_of_page(&mut tab, "LOW_TO_HIGH"), "heights");
    let texts = of_page(
        &mut tab,
        "[palette.TEXT, palette.DIM, palette.WARNING, palette.ACCENT].map((text) => \
         text.slice(1).match(/../g).reduce((sum, channel, index) => sum | (parseInt(channel, 16) << (8 * index)), 0))",
    );
    for (text, ground) in texts
        .iter()
        .flat_map(|text| GROUNDS.map(|ground| (*text, ground)))
    {
        assert!(contrast(text, ground) > 4.5, "{text:?} on {ground:?}");
    }
    tab.close();
}
