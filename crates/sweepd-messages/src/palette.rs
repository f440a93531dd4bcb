//! The colours of labels: the same in pictures and in viewers.

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

/// Labels follow the order in which segments appear, so that near numbers are often neighbours in
/// space: any six in a row, around the end too, look different to people who do not tell red from green
/// as well, and each is bright enough for a text on black.
const SEGMENTS: [Rgb; 24] = [
    [69, 124, 253],
    [249, 216, 252],
    [228, 73, 25],
    [12, 164, 160],
    [144, 179, 251],
    [184, 216, 33],
    [133, 106, 245],
    [254, 223, 185],
    [182, 119, 11],
    [254, 119, 166],
    [2, 197, 255],
    [252, 170, 43],
    [174, 89, 219],
    [126, 255, 232],
    [115, 136, 0],
    [242, 237, 43],
    [200, 174, 250],
    [121, 195, 22],
    [20, 134, 194],
    [184, 239, 254],
    [4, 152, 31],
    [180, 254, 111],
    [245, 146, 254],
    [209, 179, 36],
];
