//! The cell of a table: a number, a date, a missing value, a unit, or text.

use csv::ByteRecord;
use jiff::Timestamp;
use jiff::civil::{DateTime, Time};
use jiff::tz::TimeZone;

/// Words for a missing value, in lower case.
const MISSING: [&[u8]; 10] = [b"", b"nan", b"na", b"n/a", b"#n/a", b"null", b"none", b"nil", b"-", b"--"];
/// Words of units, in lower case, beside those of mapping files.
const UNIT_WORDS: &str =
    "s ms us ns sec m cm mm m/s cm/s mm/s rad deg ° rad/s deg/s °/s m/s2 m/s^2 m/s² g mg v mv pwm % hz rpm 1";

pub(super) fn shown(cell: &[u8]) -> String {
    String::from_utf8_lossy(cell).into_owned()
}

pub(super) fn is_missing(cell: &[u8]) -> bool {
    MISSING.iter().any(|word| word.eq_ignore_ascii_case(cell))
}

/// A unit, in brackets or not; an empty cell beside units.
pub(super) fn is_unit(cell: &[u8]) -> bool {
    let inner = cell.trim_ascii();
    let inner = inner.strip_prefix(b"[").and_then(|i| i.strip_suffix(b"]")).unwrap_or(inner);
    let inner = inner.strip_prefix(b"(").and_then(|i| i.strip_suffix(b")")).unwrap_or(inner);
    inner.is_empty()
        || inner == b"-"
        || UNIT_WORDS.split(' ').any(|word| word.as_bytes().eq_ignore_ascii_case(inner))
}

/// The number in a cell: a truth value is 1 or 0, and a decimal comma is a point.
pub(super) fn number(cell: &[u8]) -> Option<f64> {
    let parse = |text: &[u8]| std::str::from_utf8(text).ok().and_then(|text| text.parse::<f64>().ok());
    match cell {
        word if word.eq_ignore_ascii_case(b"true") => Some(1.0),
        word if word.eq_ignore_ascii_case(b"false") => Some(0.0),
        _ => parse(cell).or_else(|| decimal_point(cell).and_then(|cell| parse(&cell))),
    }
}

/// A number with one decimal comma, with a point instead.
pub(super) fn decimal_point(cell: &[u8]) -> Option<Vec<u8>> {
    let comma = cell.iter().position(|b| *b == b',')?;
    let is_digit = |b: &u8| b.is_ascii_digit() || matches!(b, b'+' | b'-' | b'e' | b'E');
    let plain = cell.len() > 1 && cell[..comma].iter().chain(&cell[comma + 1..]).all(is_digit);
    plain.then(|| [&cell[..comma], b".", &cell[comma + 1..]].concat())
}

/// Returns the seconds of a date with a time (UTC unless it names a zone), or of a time of day.
pub(super) fn date_s(cell: &[u8]) -> Option<f64> {
    let is_dated = cell.iter().filter(|b| matches!(b, b':' | b'/' | b'-')).count() >= 2;
    let text = std::str::from_utf8(cell).ok().filter(|_| is_dated && cell.contains(&b':'))?;
    let text = text.replace('/', "-");
    let nanoseconds = |stamp: Timestamp| stamp.as_nanosecond() as f64 * 1e-9;
    if let Ok(stamp) = text.parse::<Timestamp>() {
        return Some(nanoseconds(stamp));
    }
    if let Ok(civil) = text.parse::<DateTime>() {
        return civil.to_zoned(TimeZone::UTC).ok().map(|zoned| nanoseconds(zoned.timestamp()));
    }
    text.parse::<Time>().ok().map(|time| time.duration_since(Time::midnight()).as_secs_f64())
}

/// Returns whether a row contains data: at least one number or date, and no more words than those.
pub(super) fn is_data(cells: &ByteRecord) -> bool {
    let (mut numbers, mut words) = (0, 0);
    for cell in cells.iter().filter(|cell| !is_missing(cell)) {
        if number(cell).is_some() || date_s(cell).is_some() { numbers += 1 } else { words += 1 }
    }
    numbers > 0 && numbers >= words
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn dates_of_many_hands_are_seconds() {
        for text in [
            "2024-03-05 14:22:59.637",
            "2024-03-05T14:22:59.637Z",
            "2024/03/05 14:22:59.637",
            "2024-03-05T15:22:59.637+01:00",
        ] {
            assert!((date_s(text.as_bytes()).unwrap() - 1_709_648_579.637).abs() < 1e-6, "{text}");
        }
        assert!((date_s(b"14:22:59.637").unwrap() - 51_779.637).abs() < 1e-9);
        assert_eq!([date_s(b"0.5"), date_s(b"-1e-3-2"), date_s(b"a:b:c")], [None; 3]);
    }

    #[test]
    fn numbers_words_and_units_are_told_apart() {
        assert_eq!(
            [number(b"1,5"), number(b"-2e-3"), number(b"True"), number(b"x")],
            [Some(1.5), Some(-2e-3), Some(1.0), None]
        );
        assert!([&b"NaN"[..], b"N/A", b"None", b"", b"-"].iter().all(|cell| is_missing(cell)));
        assert!([&b"[ms]"[..], b"deg/s", b"(V)", "\u{b0}".as_bytes()].iter().all(|cell| is_unit(cell)));
        assert!(!is_unit(b"x") && !is_missing(b"0"));
    }
}
