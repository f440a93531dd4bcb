//! Numbers, times and tables as people read them.

use std::fmt::{Display, Write as _};

use sweepd_core::wire::nmea::{civil_from_days, days_from_civil};

/// A number with its thousands apart: `402,866`.
pub fn grouped(number: u64) -> String {
    let digits = number.to_string();
    let mut text = String::with_capacity(digits.len() + digits.len() / 3);
    for (index, digit) in digits.chars().enumerate() {
        if index > 0 && (digits.len() - index).is_multiple_of(3) {
            text.push(',');
        }
        text.push(digit);
    }
    text
}

/// A number of things: `1 packet`, `1,192 packets`.
pub fn count_of(number: u64, thing: &str) -> String {
    format!(
        "{} {thing}{}",
        grouped(number),
        if number == 1 { "" } else { "s" }
    )
}

/// Nanoseconds since 1970 as date and time, to the millisecond: `2016-01-21 08:18:02.340 UTC`.
pub fn utc_text(time_ns: i64) -> String {
    const DAY_MS: i64 = 86_400_000;
    let ms = time_ns.div_euclid(1_000_000);
    let (year, month, day) = civil_from_days(ms.div_euclid(DAY_MS));
    let ms = ms.rem_euclid(DAY_MS);
    let hour = ms / 3_600_000;
    let minute = ms / 60_000 % 60;
    let second = ms / 1000 % 60;
    format!(
        "{year:04}-{month:02}-{day:02} {hour:02}:{minute:02}:{second:02}.{:03} UTC",
        ms % 1000
    )
}

/// Date and time as nanoseconds since 1970: RFC 3339 with `Z` or an offset, as
/// `2016-01-21T08:18:02.34+01:00`, or what [`utc_text`] writes. A leap second counts as the one after
/// 59.
pub fn time_of_text(text: &str) -> Option<i64> {
    let text = text.to_ascii_uppercase();
    let (date, rest) = text.split_at_checked(10)?;
    let rest = rest.strip_prefix(['T', ' '])?;
    let (time, offset_s) = match rest.strip_suffix('Z').or(rest.strip_suffix(" UTC")) {
        Some(time) => (time, 0),
        None => {
            let (time, offset) = rest.split_at_checked(rest.len().checked_sub(6)?)?;
            let sign = match offset.as_bytes()[0] {
                b'+' => 1,
                b'-' => -1,
                _ => return None,
            };
            let [hours, minutes] = numbers(&offset[1..], ':')?;
            (time, sign * (hours * 60 + minutes) * 60)
        }
    };
    let (whole, fraction) = time.split_once('.').unwrap_or((time, "0"));
    let [year, month, day] = numbers(date, '-')?;
    let [hour, minute, second] = numbers(whole, ':')?;
    let days = days_from_civil(year, month, day);
    let is_date = civil_from_days(days) == (year, month, day) && date.len() == 10;
    if !is_date || hour > 23 || minute > 59 || second > 60 {
        return None;
    }
    let seconds = ((days * 24 + hour) * 60 + minute) * 60 + second - offset_s;
    seconds
        .checked_mul(1_000_000_000)?
        .checked_add(nanoseconds(fraction)?)
}

/// A number of seconds as nanoseconds, to the last digit.
pub fn nanoseconds_of_text(text: &str) -> Option<i64> {
    let (whole, fraction) = text.split_once('.').unwrap_or((text, "0"));
    let [seconds] = numbers(whole, '.')?;
    seconds
        .checked_mul(1_000_000_000)?
        .checked_add(nanoseconds(fraction)?)
}

/// Numbers of digits alone, with this between them.
fn numbers<const COUNT: usize>(text: &str, between: char) -> Option<[i64; COUNT]> {
    let mut numbers = [0; COUNT];
    let mut parts = text.split(between);
    for number in &mut numbers {
        let part = parts.next()?;
        let is_number = part.bytes().all(|digit| digit.is_ascii_digit());
        *number = part.parse().ok().filter(|_| is_number)?;
    }
    parts.next().is_none().then_some(numbers)
}

/// The digits of a fraction of a second; those beyond a nanosecond are cut off.
fn nanoseconds(digits: &str) -> Option<i64> {
    let [_] = numbers(digits.get(..9).unwrap_or(digits), '.')?;
    let is_number = digits.bytes().all(|digit| digit.is_ascii_digit());
    format!("{digits:0<9.9}").parse().ok().filter(|_| is_number)
}

/// A text in one line that shows all that is in it: a character that would break the line, control the
/// terminal or turn the direction of writing is escaped, as `\u{202e}`. For names from outside.
pub fn visible(text: impl Display) -> String {
    let mut shown = String::new();
    for one in text.to_string().chars() {
        let is_hidden = one.is_control()
            || matches!(one, '\u{61c}' | '\u{200b}'..='\u{200f}' | '\u{2028}'..='\u{202e}' | '\u{2060}'..='\u{206f}' | '\u{feff}');
        match is_hidden {
            true => shown.extend(one.escape_default()),
            false => shown.push(one),
        }
    }
    shown
}

/// The rate of things that came between two times: ` (753.5 a second)`, where there is more than
/// one.
pub fn rate(count: u64, first_ns: i64, last_ns: i64) -> String {
    let rate = rate_per_s(count, first_ns, last_ns);
    rate.map_or(String::new(), |rate| format!(" ({rate:.1} a second)"))
}

/// The same as a number.
pub fn rate_per_s(count: u64, first_ns: i64, last_ns: i64) -> Option<f64> {
    let seconds = last_ns.saturating_sub(first_ns) as f64 * 1e-9;
    (count > 1 && seconds > 0.0).then(|| (count - 1) as f64 / seconds)
}

/// Adds a row to a text: a name, and the value beside it.
pub fn row(text: &mut String, name: &str, value: impl Display) {
    let _ = writeln!(text, "  {name:<13}{value}");
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn by_hand() {
        assert_eq!(
            ["0", "999", "1,000", "1,234,567"],
            [0, 999, 1000, 1_234_567].map(grouped)[..]
        );
        assert_eq!(
            utc_text(1_453_364_282_340_595_000),
            "2016-01-21 08:18:02.340 UTC"
        );
        assert_eq!(
            [1, 1192].map(|number| count_of(number, "packet")),
            ["1 packet", "1,192 packets"]
        );
        assert_eq!(utc_text(-1), "1969-12-31 23:59:59.999 UTC");
    }

    /// The first by `date -u -d`, the others from RFC 3339, section 5.8.
    #[test]
    fn times_are_read() {
        for (text, expected_ns) in [
            ("2026-05-04T10:16:40Z", 1_777_889_800_000_000_000),
            ("1985-04-12T23:20:50.52Z", 482_196_050_520_000_000),
            ("1996-12-19t16:39:57-08:00", 851_042_397_000_000_000),
            ("1990-12-31T23:59:60z", 662_688_000_000_000_000),
            ("1937-01-01T12:00:27.87+00:20", -1_041_337_172_130_000_000),
            ("2016-01-21 08:18:02.340 UTC", 1_453_364_282_340_000_000),
        ] {
            assert_eq!(time_of_text(text), Some(expected_ns), "{text}");
        }
        for text in [
            "",
            "2026-05-04",
            "2026-05-04T10:16:40",
            "2026-02-30T10:16:40Z",
            "2026-05-04T24:16:40Z",
            "2026-05-04T10:16:40.Z",
            "2026-05-04T10:16:40.1e3Z",
            "2026-05-04T10:16:40+1:00",
            "+026-05-04T10:16:40Z",
            "\u{fc}026-05-04T10:16:40Z",
            "9999-05-04T10:16:40Z",
        ] {
            assert_eq!(time_of_text(text), None, "{text}");
        }
        let read = nanoseconds_of_text("1777889800.1234567899");
        assert_eq!(read, Some(1_777_889_800_123_456_789));
    }
}
