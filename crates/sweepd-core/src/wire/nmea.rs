//! The NMEA 0183 sentence RMC, the only one with both date and time.
//!
//! ```text
//! $GPRMC,081802.00,A,3649.7478558,N,00224.4542928,W,0.004,,210116,,,A*61
//!        hhmmss.ss  A = valid, V = not                     ddmmyy
//! ```

/// Recommended minimum data of a GPS receiver: time, position, and whether they are valid.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rmc {
    /// UTC of the fix, nanoseconds since 1970.
    pub utc_ns: i64,
    /// The status is `A` (valid), not `V` (warning).
    pub valid: bool,
    /// Latitude and longitude in degrees, north and east positive, if the sentence has both.
    pub position_deg: Option<(f64, f64)>,
}

/// Why a sentence is not a usable RMC.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum NmeaError {
    /// Another sentence (GGA, ...), or not a sentence.
    #[error("not an RMC sentence")]
    NotRmc,
    /// No `*hh` at the end.
    #[error("no checksum")]
    NoChecksum,
    /// The `*hh` does not match.
    #[error("checksum is {found:02X}, the text gives {computed:02X}")]
    Checksum {
        /// What stands in the sentence.
        found: u8,
        /// Exclusive or of the characters between `$` and `*`.
        computed: u8,
    },
    /// No time, or none that is possible.
    #[error("no readable time")]
    Time,
    /// No date, or none that is possible.
    #[error("no readable date")]
    Date,
}

impl NmeaError {
    /// It as a number, not 0 and below 2^19: threads share it with what else a packet says.
    pub fn code(self) -> u32 {
        match self {
            Self::NotRmc => 1,
            Self::NoChecksum => 2,
            Self::Checksum { found, computed } => {
                3 | u32::from(found) << 3 | u32::from(computed) << 11
            }
            Self::Time => 4,
            Self::Date => 5,
        }
    }

    /// The error of a number; `None` for 0, and for one that is none's.
    pub fn from_code(code: u32) -> Option<Self> {
        match code & 7 {
            1 => Some(Self::NotRmc),
            2 => Some(Self::NoChecksum),
            3 => Some(Self::Checksum {
                found: (code >> 3) as u8,
                computed: (code >> 11) as u8,
            }),
            4 => Some(Self::Time),
            5 => Some(Self::Date),
            _ => None,
        }
    }
}

impl Rmc {
    /// Reads `$xxRMC,...*hh`, from any talker; fields may be padded with blanks (old HDL-32E
    /// firmware does that).
    ///
    /// # Errors
    /// [`NmeaError`]: checksum, time and date must be present and valid.
    pub fn parse(text: &str) -> Result<Self, NmeaError> {
        let text = text.trim_end_matches(['\0', '\r', '\n', ' ']);
        let body = text.strip_prefix('$').ok_or(NmeaError::NotRmc)?;
        let (body, checksum) = body
            .rsplit_once('*')
            .map_or((body, None), |(b, c)| (b, Some(c)));
        let mut fields = body.split(',').map(str::trim);
        let name = fields.next().unwrap_or_default();
        if name.len() != 5 || !name.ends_with("RMC") {
            return Err(NmeaError::NotRmc);
        }
        let checksum = checksum.ok_or(NmeaError::NoChecksum)?;
        let found = u8::from_str_radix(checksum.trim(), 16).map_err(|_| NmeaError::NoChecksum)?;
        let computed = xor(body);
        if found != computed {
            return Err(NmeaError::Checksum { found, computed });
        }
        let [
            time,
            status,
            latitude,
            north,
            longitude,
            east,
            _speed,
            _course,
            date,
        ] = std::array::from_fn(|_| fields.next().unwrap_or_default());
        let day_ns = parse_time(time).ok_or(NmeaError::Time)?;
        let days = parse_date(date).ok_or(NmeaError::Date)?;
        let position_deg =
            parse_angle(latitude, north, "NS").zip(parse_angle(longitude, east, "EW"));
        Ok(Self {
            utc_ns: days * DAY_NS + day_ns,
            valid: status == "A",
            position_deg,
        })
    }

    /// Writes the sentence with checksum and line end; time to hundredths of a second, angles to
    /// 1e-7 minutes.
    pub fn emit(&self) -> String {
        let days = self.utc_ns.div_euclid(DAY_NS);
        let ns = self.utc_ns.rem_euclid(DAY_NS);
        let (year, month, day) = civil_from_days(days);
        let centiseconds = ns / 10_000_000;
        let hour = centiseconds / 360_000;
        let minute = centiseconds / 6_000 % 60;
        let second = centiseconds / 100 % 60;
        let place = match self.position_deg {
            Some((lat, lon)) => format!(
                "{},{}",
                emit_angle(lat, 2, "N", "S"),
                emit_angle(lon, 3, "E", "W")
            ),
            None => ",,,".to_owned(),
        };
        let body = format!(
            "GPRMC,{hour:02}{minute:02}{second:02}.{:02},{},{place},0.0,0.0,{day:02}{month:02}{:02},,,A",
            centiseconds % 100,
            if self.valid { 'A' } else { 'V' },
            year.rem_euclid(100),
        );
        format!("${body}*{:02X}\r\n", xor(&body))
    }
}

/// The same sentence some seconds later, from midnight to midnight with its date. Everything else
/// stays, and what cannot be read stays as it is.
pub(super) fn later(text: &str, by_s: i64) -> String {
    let is_read = Rmc::parse(text).is_ok();
    let Some((body, _)) = text
        .trim_start_matches('$')
        .rsplit_once('*')
        .filter(|_| is_read)
    else {
        return text.to_owned();
    };
    let mut fields: Vec<String> = body.split(',').map(str::to_owned).collect();
    let (time, date) = (fields[1].trim().to_owned(), fields[9].trim().to_owned());
    let (whole, fraction) = time.split_at(6);
    let day_s = parse_time(whole).unwrap_or_default() / 1_000_000_000 + by_s;
    let days = parse_date(&date).unwrap_or_default() + day_s.div_euclid(DAY_S);
    let day_s = day_s.rem_euclid(DAY_S);
    let (year, month, day) = civil_from_days(days);
    let [hour, minute, second] = [day_s / 3600, day_s / 60 % 60, day_s % 60];
    let later = format!("{hour:02}{minute:02}{second:02}{fraction}");
    fields[1] = fields[1].replacen(&time, &later, 1);
    let later = format!("{day:02}{month:02}{:02}", year.rem_euclid(100));
    fields[9] = fields[9].replacen(&date, &later, 1);
    let body = fields.join(",");
    format!("${body}*{:02X}", xor(&body))
}

const DAY_S: i64 = 86_400;
const DAY_NS: i64 = 86_400_000_000_000;

fn xor(body: &str) -> u8 {
    body.bytes().fold(0, |sum, byte| sum ^ byte)
}

/// `hhmmss[.sss]` as nanoseconds of the day. A leap second (60) counts as the second after 59.
fn parse_time(text: &str) -> Option<i64> {
    let (whole, fraction) = text.split_once('.').unwrap_or((text, ""));
    let [hour, minute, second] = two_digits(whole)?;
    if hour > 23 || minute > 59 || second > 60 || fraction.len() > 9 {
        return None;
    }
    let mut fraction_ns: i64 = if fraction.is_empty() {
        0
    } else {
        digits(fraction)?
    };
    for _ in fraction.len()..9 {
        fraction_ns *= 10;
    }
    Some(((hour * 60 + minute) * 60 + second) * 1_000_000_000 + fraction_ns)
}

/// `ddmmyy` as days since 1970; years 80-99 are 19xx, as NMEA receivers mean them.
fn parse_date(text: &str) -> Option<i64> {
    let [day, month, year] = two_digits(text)?;
    let year = if year >= 80 { 1900 + year } else { 2000 + year };
    let days = days_from_civil(year, month, day);
    (civil_from_days(days) == (year, month, day)).then_some(days)
}

/// Six digits as three numbers.
fn two_digits(text: &str) -> Option<[i64; 3]> {
    if text.len() != 6 || !text.is_ascii() {
        return None;
    }
    Some([
        digits(&text[..2])?,
        digits(&text[2..4])?,
        digits(&text[4..])?,
    ])
}

fn digits(text: &str) -> Option<i64> {
    if text.is_empty() || !text.bytes().all(|b| b.is_ascii_digit()) {
        return None;
    }
    text.parse().ok()
}

/// `dddmm.mmmm` and a hemisphere letter as degrees.
fn parse_angle(text: &str, hemisphere: &str, letters: &str) -> Option<f64> {
    let value: f64 = text
        .parse()
        .ok()
        .filter(|v: &f64| (0.0..18_100.0).contains(v))?;
    let degrees = (value / 100.0).trunc();
    let angle = degrees + (value - degrees * 100.0) / 60.0;
    match letters.find(hemisphere).filter(|_| hemisphere.len() == 1)? {
        0 => Some(angle),
        _ => Some(-angle),
    }
}

fn emit_angle(angle: f64, degree_digits: usize, positive: &str, negative: &str) -> String {
    let degrees = angle.abs().trunc();
    let minutes = (angle.abs() - degrees) * 60.0;
    let letter = if angle < 0.0 { negative } else { positive };
    format!("{degrees:0degree_digits$}{minutes:010.7},{letter}")
}

/// Days since 1970-01-01 of a Gregorian date (years from 1 March, 400-year eras).
pub fn days_from_civil(year: i64, month: i64, day: i64) -> i64 {
    let year = if month <= 2 { year - 1 } else { year };
    let era = year.div_euclid(400);
    let year_of_era = year.rem_euclid(400);
    let day_of_year = (153 * ((month + 9) % 12) + 2) / 5 + day - 1;
    era * 146_097 + year_of_era * 365 + year_of_era / 4 - year_of_era / 100 + day_of_year - 719_468
}

/// Gregorian year, month and day of a number of days since 1970-01-01.
pub fn civil_from_days(days: i64) -> (i64, i64, i64) {
    let days = days + 719_468;
    let era = days.div_euclid(146_097);
    let day_of_era = days.rem_euclid(146_097);
    let year_of_era =
        (day_of_era - day_of_era / 1460 + day_of_era / 36_524 - day_of_era / 146_096) / 365;
    let day_of_year = day_of_era - (365 * year_of_era + year_of_era / 4 - year_of_era / 100);
    let shifted_month = (5 * day_of_year + 2) / 153;
    let month = (shifted_month + 2) % 12 + 1;
    let year = era * 400 + year_of_era + i64::from(month <= 2);
    (year, month, day_of_year - (153 * shifted_month + 2) / 5 + 1)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// The NMEA 0183 standard's own example; 1994-03-23 12:35:19 UTC is 764426119 s since 1970
    /// (`date -u`).
    const EXAMPLE: &str = "$GPRMC,123519,A,4807.038,N,01131.000,E,022.4,084.4,230394,003.1,W*6A";

    #[test]
    fn reads_the_standards_example() {
        let rmc = Rmc::parse(EXAMPLE).unwrap();
        assert_eq!(rmc.utc_ns, 764_426_119_000_000_000);
        assert!(rmc.valid);
        let (lat, lon) = rmc.position_deg.unwrap();
        assert!((lat - 48.1173).abs() < 1e-6 && (lon - 11.516_666_7).abs() < 1e-6);
    }

    #[test]
    fn blanks_around_fields_and_a_trailer_of_zeros_are_forgiven() {
        let body = "GPRMC, 123519, V, , , , , , , 230394, , ";
        let rmc = Rmc::parse(&format!("${body}*{:02x}\r\n\0\0", xor(body))).unwrap();
        assert_eq!(
            (rmc.utc_ns, rmc.valid, rmc.position_deg),
            (764_426_119_000_000_000, false, None)
        );
    }

    #[test]
    fn a_later_sentence_has_later_time_and_date_alone() {
        let late = "$GPRMC,235959.25,A,4807.038,N,01131.000,E,022.4,084.4,281224,003.1,W*";
        let late = format!("{late}{:02X}", xor(late.trim_matches(['$', '*'])));
        let next = later(&late, 4 * DAY_S + 2);
        assert!(
            next.starts_with(
                "$GPRMC,000001.25,A,4807.038,N,01131.000,E,022.4,084.4,020125,003.1,W*"
            ),
            "{next}"
        );
        assert_eq!(
            Rmc::parse(&next).unwrap().utc_ns,
            Rmc::parse(&late).unwrap().utc_ns + (4 * DAY_S + 2) * 1_000_000_000
        );
        for other in ["", "$GPGGA,123519*00", "$GPRMC,123518*6A"] {
            assert_eq!(later(other, 5), other);
        }
    }

    #[test]
    fn refuses_what_cannot_be_trusted() {
        assert_eq!(Rmc::parse(""), Err(NmeaError::NotRmc));
        assert_eq!(Rmc::parse("$GPGGA,123519*00"), Err(NmeaError::NotRmc));
        assert_eq!(
            Rmc::parse(EXAMPLE.trim_end_matches("*6A")),
            Err(NmeaError::NoChecksum)
        );
        assert_eq!(
            Rmc::parse(&EXAMPLE.replace("123519", "123518")),
            Err(NmeaError::Checksum {
                found: 0x6A,
                computed: 0x6B
            })
        );
        for (time, date, error) in [
            ("", "230394", NmeaError::Time),
            ("250000", "230394", NmeaError::Time),
            ("123519", "310294", NmeaError::Date),
        ] {
            let body = format!("GPRMC,{time},A,,,,,,,{date},,");
            assert_eq!(
                Rmc::parse(&format!("${body}*{:02X}", xor(&body))),
                Err(error)
            );
        }
    }

    #[test]
    fn an_error_is_that_of_its_number() {
        let (found, computed) = (0xFF, 0x6B);
        for error in [
            NmeaError::NotRmc,
            NmeaError::NoChecksum,
            NmeaError::Checksum { found, computed },
            NmeaError::Time,
            NmeaError::Date,
        ] {
            assert!((1..1 << 19).contains(&error.code()), "{error:?}");
            assert_eq!(NmeaError::from_code(error.code()), Some(error));
        }
        assert_eq!(NmeaError::from_code(0), None);
    }

    proptest! {
        #[test]
        fn any_text_is_read_or_refused(text in "\\PC{0,140}") {
            let _ = Rmc::parse(&text);
        }

        #[test]
        fn parse_gives_back_what_emit_wrote(
            centiseconds in 31_553_280_000_i64..340_000_000_000, valid in any::<bool>(),
            place in proptest::option::of((-89.0..89.0, -179.0..179.0)),
        ) {
            let rmc = Rmc { utc_ns: centiseconds * 10_000_000, valid, position_deg: place };
            let back = Rmc::parse(&rmc.emit()).unwrap();
            prop_assert_eq!((back.utc_ns, back.valid), (rmc.utc_ns, valid));
            match (place, back.position_deg) {
                (Some(a), Some(b)) => prop_assert!((a.0 - b.0).abs() < 1e-8 && (a.1 - b.1).abs() < 1e-8),
                (a, b) => prop_assert_eq!(a, b),
            }
        }
    }
}
