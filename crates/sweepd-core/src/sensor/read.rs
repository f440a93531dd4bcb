//! Reads calibration files in either of the two formats: text in, calibration out.

use super::{Calibration, CalibrationError, db_xml, ros_yaml};

/// Longest file that is read as a calibration, bytes; real files have up to 50 000, and hostile XML
/// can take quadratic time.
pub const MAX_FILE_LEN: usize = 256 << 10;

impl Calibration {
    /// Reads the text of a db.xml or a ROS YAML, at most [`MAX_FILE_LEN`] bytes of UTF-8. `file` is
    /// its name in errors.
    ///
    /// # Errors
    /// [`CalibrationError`] with file, line and key.
    pub fn decode(bytes: &[u8], file: &str) -> Result<Self, CalibrationError> {
        let file = file.to_owned();
        if bytes.len() > MAX_FILE_LEN {
            let message = format!(
                "more than {} KiB, too long for a calibration",
                MAX_FILE_LEN >> 10
            );
            return Err(CalibrationError::Whole { file, message });
        }
        let text = match str::from_utf8(bytes) {
            Ok(text) => text.trim_start_matches('\u{feff}'),
            Err(error) => {
                let line = 1 + bytes[..error.valid_up_to()]
                    .iter()
                    .filter(|&&byte| byte == b'\n')
                    .count();
                let message = "not text in UTF-8; expected a db.xml or a ROS YAML".to_owned();
                return Err(CalibrationError::At {
                    file,
                    line,
                    message,
                });
            }
        };
        let is_xml = text.trim_start().starts_with('<');
        if !is_xml && !text.contains("lasers") {
            let message =
                "no calibration; expected a db.xml, or a ROS YAML with a list of `lasers`"
                    .to_owned();
            return Err(CalibrationError::Whole { file, message });
        }
        if is_xml {
            db_xml::parse(text, &file)
        } else {
            ros_yaml::parse(text, &file)
        }
    }
}
