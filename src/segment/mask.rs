//! The robot's own body: pixels that are never labelled.

use std::f64::consts::TAU;
use std::io;
use std::path::Path;

use super::MAX_ROWS;
use crate::file;

/// Widest picture: finer than the encoder of any sensor.
const MAX_WIDTH: u32 = 36_000;
/// Longest file that is read as a picture, bytes: as many as its pixels could have uncompressed.
const MAX_FILE_LEN: u64 = 64 << 20;

/// An image of what the robot itself hides, one row a beam (the highest on top), any number of columns.
///
/// The columns span the azimuth from 0 to 360 degrees, from the sensor's +y axis clockwise. Dark pixels (luma under 128)
/// are masked, unless they are transparent (alpha under 128).
#[derive(Clone, Debug, PartialEq)]
pub struct Mask {
    rows: usize,
    /// Masked rows by azimuth.
    bins: Vec<u128>,
}

/// Why a picture is no mask.
#[derive(Debug, thiserror::Error)]
pub enum MaskError {
    /// The file cannot be read at all.
    #[error("cannot read {name}: {source}")]
    Io {
        /// The file.
        name: String,
        /// What the system says.
        source: io::Error,
    },
    /// The file is no picture in the PNG format.
    #[error("mask {name}: {source}; expected a PNG picture with one row of pixels for each beam")]
    Png {
        /// The file.
        name: String,
        /// What the decoder says.
        source: Told,
    },
    /// Its height is that of no sensor, or it is absurdly wide.
    #[error(
        "mask {name} is {width} x {height} pixels, expected 1 to {MAX_WIDTH} in width, for 360 degrees, and 1 to \
         {MAX_ROWS} in height, one row for each beam of the sensor"
    )]
    Size {
        /// The file.
        name: String,
        /// Its width.
        width: u32,
        /// Its height.
        height: u32,
    },
    /// It hides everything.
    #[error("mask {name} is all black: nothing would be labelled; white keeps")]
    AllBlack {
        /// The file.
        name: String,
    },
}

/// What the PNG decoder says, without the full stop that it ends some sentences with.
#[derive(Debug, thiserror::Error)]
#[error("{}", .0.to_string().trim_end_matches('.'))]
pub struct Told(#[from] png::DecodingError);

impl Mask {
    /// Reads a PNG picture that hides a part of what the sensor sees; see [`Mask::decode`].
    ///
    /// # Errors
    /// [`MaskError`]; also for a picture that hides all, which nobody can mean.
    pub fn read(path: &Path) -> Result<Self, MaskError> {
        let name = path.display().to_string();
        let bytes = match file::read(path, MAX_FILE_LEN) {
            Ok(bytes) => bytes,
            Err(source) => return Err(MaskError::Io { name, source }),
        };
        let mask = Self::decode(&bytes, &name)?;
        if mask.hides_all() {
            return Err(MaskError::AllBlack { name });
        }
        Ok(mask)
    }

    /// Decodes the bytes of a PNG picture of any colour type, as high as its sensor has rows; `name` is what errors call it.
    ///
    /// # Errors
    /// [`MaskError`].
    pub fn decode(bytes: &[u8], name: &str) -> Result<Self, MaskError> {
        let broken = |error| MaskError::Png { name: name.to_owned(), source: Told(error) };
        let mut decoder = png::Decoder::new(std::io::Cursor::new(bytes));
        decoder.set_transformations(png::Transformations::EXPAND | png::Transformations::STRIP_16);
        let mut reader = decoder.read_info().map_err(broken)?;
        let (width, height) = reader.info().size();
        let rows = height as usize;
        if !(1..=MAX_ROWS).contains(&rows) || !(1..=MAX_WIDTH).contains(&width) {
            return Err(MaskError::Size { name: name.to_owned(), width, height });
        }
        let mut bins = vec![0_u128; width as usize];
        let mut pixels = vec![0; reader.output_buffer_size().unwrap_or_default()];
        let frame = reader.next_frame(&mut pixels).map_err(broken)?;
        let samples = frame.color_type.samples();
        for (row, line) in pixels.chunks_exact(frame.line_size).take(rows).enumerate() {
            for (bin, pixel) in bins.iter_mut().zip(line.chunks_exact(samples)) {
                *bin |= u128::from(is_dark(pixel)) << row;
            }
        }
        Ok(Self { rows, bins })
    }

    /// Rows of the sensor that the mask is for.
    pub fn rows(&self) -> usize {
        self.rows
    }

    /// Whether it hides every beam at every azimuth, which nobody can mean.
    pub fn hides_all(&self) -> bool {
        let all = u128::MAX >> (u128::BITS as usize - self.rows);
        self.bins.iter().all(|&bin| bin == all)
    }

    /// Whether the robot itself hides a beam at an azimuth in radians.
    #[inline]
    pub fn hides(&self, row: usize, azimuth_rad: f64) -> bool {
        let bin = (azimuth_rad / TAU).rem_euclid(1.0) * self.bins.len() as f64;
        self.bins[(bin as usize).min(self.bins.len() - 1)] >> row & 1 == 1
    }
}

/// Whether the luma (ITU-R BT.601) of a grey or RGB pixel is under 128, and the pixel is there to be seen: drawing
/// programs leave black where nothing was drawn on a transparent ground.
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
        encoder.write_header().unwrap().write_image_data(data).unwrap();
        bytes
    }

    /// Two rows of four quarters; the upper one hides the second quarter, the lower one the last.
    #[test]
    fn every_kind_of_picture_is_the_same_mask() {
        let dark = [false, true, false, false, false, false, false, true];
        let spread = |light: &[u8], black: &[u8]| -> Vec<u8> {
            dark.iter().flat_map(|&dark| if dark { black.to_vec() } else { light.to_vec() }).collect()
        };
        use {BitDepth::*, ColorType::*};
        for (color, depth, data) in [
            (Grayscale, Eight, spread(&[128], &[127])),
            (Grayscale, Sixteen, spread(&[128, 0], &[127, 255])),
            (Grayscale, One, vec![0b1011_0000, 0b1110_0000]),
            (GrayscaleAlpha, Eight, spread(&[255, 0], &[0, 255])),
            (Rgb, Eight, spread(&[0, 255, 0], &[255, 0, 255])),
            (Rgba, Sixteen, spread(&[255; 8], &[0, 0, 0, 0, 0, 0, 255, 255])),
            (Indexed, Eight, spread(&[1], &[0])),
        ] {
            let mask = Mask::decode(&picture(color, depth, 4, 2, &data), "test").unwrap();
            let hidden = |row| [45_f64, 135.0, 225.0, 315.0].map(|azimuth| mask.hides(row, azimuth.to_radians()));
            assert_eq!(hidden(0), [false, true, false, false], "{color:?} {depth:?}");
            assert_eq!(hidden(1), [false, false, false, true], "{color:?} {depth:?}");
            assert!(mask.hides(1, -0.001) && !mask.hides(1, TAU));
        }
    }

    #[test]
    fn errors_name_the_file() {
        let tall = picture(ColorType::Grayscale, BitDepth::Eight, 1, 129, &[0; 129]);
        let error = Mask::decode(&tall, "body.png").unwrap_err().to_string();
        assert!(error.starts_with("mask body.png is 1 x 129 pixels, expected 1 to 36000 in width"), "{error}");
        assert!(Mask::decode(b"GIF89a", "body.png").unwrap_err().to_string().starts_with("mask body.png: "));
        let cut = &tall[..tall.len() / 2];
        assert!(matches!(Mask::decode(cut, "cut.png"), Err(MaskError::Png { .. })));
    }
}
