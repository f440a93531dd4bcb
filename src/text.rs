//! Numbers, times and tables as people read them.

use std::fmt::{Display, Write as _};

use sweepd_core::wire::nmea::civil_from_days;

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
    let seconds = last_ns.saturating_sub(first_ns) as f64 * 1e-9;
    if count < 2 || seconds <= 0.0 {
        return String::new();
    }
    format!(" ({:.1} a second)", (count - 1) as f64 / seconds)
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
}
