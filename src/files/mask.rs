//! Masks as PNG pictures.

use std::io::{self, Cursor};
use std::path::Path;

use super::read;
use crate::text::visible;
use sweepd_core::segment::{Mask, MaskError};

/// Longest file that is read as a picture, bytes: the size of the largest picture without
/// compression.
const MAX_FILE_LEN: u64 = 64 << 20;

/// Why a picture is no mask.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum MaskFileError {
    /// The file cannot be read at all.
    #[error("cannot read {name}: {source}")]
    Io {
        /// The file.
        name: String,
        /// What the system says.
        source: io::Error,
    },
    /// The file is not a PNG picture.
    #[error("mask {name}: {source}; expected a PNG picture with one row of pixels for each beam")]
    Png {
        /// The file.
        name: String,
        /// What the decoder says.
        source: Sentence,
    },
    /// The picture is no mask.
    #[error("mask {name} is {source}")]
    Mask {
        /// The file.
        name: String,
        /// Why not.
        source: MaskError,
    },
}

/// The message of the PNG decoder, without the full stop at the end of some.
#[derive(Debug, thiserror::Error)]
#[error("{}", .0.to_string().trim_end_matches('.'))]
pub struct Sentence(#[from] png::DecodingError);

/// The mask in a PNG file; see [`decode_mask`].
///
/// # Errors
/// [`MaskFileError`].
pub fn mask(path: &Path) -> Result<Mask, MaskFileError> {
    let name = visible(path.display());
    match read(path, MAX_FILE_LEN) {
        Ok(bytes) => decode_mask(&bytes, &name),
        Err(source) => Err(MaskFileError::Io { name, source }),
    }
}

/// A mask from the bytes of a PNG picture of any colour type, as high as its sensor has rows. Dark
/// pixels (luma under 128) are hidden, unless they are transparent (alpha under 128). `name` is its
/// name in errors.
///
/// # Errors
/// [`MaskFileError`].
pub fn decode_mask(bytes: &[u8], name: &str) -> Result<Mask, MaskFileError> {
    let broken = |error| MaskFileError::Png {
        name: name.to_owned(),
        source: Sentence(error),
    };
    let no_mask = |source| MaskFileError::Mask {
        name: name.to_owned(),
        source,
    };
    let mut decoder = png::Decoder::new(Cursor::new(bytes));
    decoder.set_transformations(png::Transformations::EXPAND | png::Transformations::STRIP_16);
    let mut reader = decoder.read_info().map_err(broken)?;
    let width = reader.info().width as usize;
    let height = reader.info().height as usize;
    Mask::check_size(width, height).map_err(no_mask)?;
    let mut pixels = vec![0; reader.output_buffer_size().unwrap_or_default()];
    let frame = reader.next_frame(&mut pixels).map_err(broken)?;
    let samples = frame.color_type.samples();
    let lines = pixels.chunks_exact(frame.line_size).take(height);
    let hidden: Vec<bool> = lines
        .flat_map(|line| line.chunks_exact(samples).take(width))
        .map(is_dark)
        .collect();
    Mask::new(width, height, &hidden).map_err(no_mask)
}

/// Whether the luma (ITU-R BT.601) of a grey or RGB pixel is under 128, and the pixel is visible:
/// drawing programs store transparent pixels as black.
fn is_dark(pixel: &[u8]) -> bool {
    let (luma, alpha) = match *pixel {
        [red, green, blue] => (luma(red, green, blue), 255),
        [red, green, blue, alpha] => (luma(red, green, blue), alpha),
        [grey, alpha] => (u32::from(grey), alpha),
        [grey] => (u32::from(grey), 255),
        _ => (255, 255),
    };
    luma < 128 && alpha >= 128
}

/// The bytes of a PNG picture that [`decode_mask`] reads: `hidden` has `width` pixels for each row,
/// from the highest down.
///
/// # Errors
/// The picture is empty, or too large for a PNG.
pub fn encode_mask(width: usize, hidden: &[bool]) -> Result<Vec<u8>, png::EncodingError> {
    let pixels: Vec<u8> = hidden
        .iter()
        .map(|&dark| if dark { 0 } else { 255 })
        .collect();
    let mut bytes = Vec::new();
    let height = pixels.len() / width.max(1);
    let mut encoder = png::Encoder::new(&mut bytes, width as u32, height as u32);
    encoder.set_color(png::ColorType::Grayscale);
    let mut writer = encoder.write_header()?;
    writer.write_image_data(&pixels)?;
    writer.finish()?;
    Ok(bytes)
}

fn luma(red: u8, green: u8, blue: u8) -> u32 {
    (299 * u32::from(red) + 587 * u32::from(green) + 114 * u32::from(blue)) / 1000
}

#[cfg(test)]
mod tests {
    use super::*;
    use png::{BitDepth, ColorType};

    fn picture(color: ColorType, depth: BitDepth, width: u32, height: u32, data: &[u8]) -> Vec<u8> {
        let mut bytes = Vec::new();
        let mut encoder = png::Encoder::new(&mut bytes, width, height);
        encoder.set_color(color);
        encoder.set_depth(depth);
        if color == ColorType::Indexed {
            encoder.set_palette(vec![0, 0, 0, 255, 255, 255]);
        }
        encoder
            .write_header()
            .unwrap()
            .write_image_data(data)
            .unwrap();
        bytes
    }

    /// Two rows of four quarters; the upper one hides the second quarter, the lower one the last.
    #[test]
    fn every_kind_of_picture_is_the_same_mask() {
        let dark = [false, true, false, false, false, false, false, true];
        let spread = |light: &[u8], black: &[u8]| -> Vec<u8> {
            dark.iter()
                .flat_map(|&dark| if dark { black.to_vec() } else { light.to_vec() })
                .collect()
        };
        use {BitDepth::*, ColorType::*};
        for (color, depth, data) in [
            (Grayscale, Eight, spread(&[128], &[127])),
            (Grayscale, Sixteen, spread(&[128, 0], &[127, 255])),
            (Grayscale, One, vec![0b1011_0000, 0b1110_0000]),
            (GrayscaleAlpha, Eight, spread(&[255, 0], &[0, 255])),
            (Rgb, Eight, spread(&[0, 255, 0], &[255, 0, 255])),
            (
                Rgba,
                Sixteen,
                spread(&[255; 8], &[0, 0, 0, 0, 0, 0, 255, 255]),
            ),
            (Indexed, Eight, spread(&[1], &[0])),
        ] {
            let mask = decode_mask(&picture(color, depth, 4, 2, &data), "test").unwrap();
            let hidden = |row| {
                [45_f64, 135.0, 225.0, 315.0].map(|azimuth| mask.hides(row, azimuth.to_radians()))
            };
            assert_eq!(
                hidden(0),
                [false, true, false, false],
                "{color:?} {depth:?}"
            );
            assert_eq!(
                hidden(1),
                [false, false, false, true],
                "{color:?} {depth:?}"
            );
        }
    }

    #[test]
    fn errors_name_the_file() {
        let tall = picture(ColorType::Grayscale, BitDepth::Eight, 1, 129, &[0; 129]);
        let error = decode_mask(&tall, "body.png").unwrap_err().to_string();
        assert!(
            error.starts_with("mask body.png is 1 x 129 pixels, expected 1 to 36000 in width"),
            "{error}"
        );
        assert!(
            decode_mask(b"GIF89a", "body.png")
                .unwrap_err()
                .to_string()
                .starts_with("mask body.png: ")
        );
        let cut = &tall[..tall.len() / 2];
        assert!(matches!(
            decode_mask(cut, "cut.png"),
            Err(MaskFileError::Png { .. })
        ));
    }
}
