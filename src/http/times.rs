//! Times in documents: UTC, always with six digits behind the second, which is what the store keeps.

use jiff::Timestamp;
use serde::Serializer;

/// A time.
pub(super) fn time<S: Serializer>(time: &Timestamp, serializer: S) -> Result<S::Ok, S::Error> {
    serializer.collect_str(&format_args!("{time:.6}"))
}

/// A time that may be absent.
#[expect(clippy::ref_option, reason = "serde hands it over so")]
pub(super) fn optional<S: Serializer>(time: &Option<Timestamp>, serializer: S) -> Result<S::Ok, S::Error> {
    match time {
        Some(time) => self::time(time, serializer),
        None => serializer.serialize_none(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_time_has_six_digits_behind_the_second_whatever_they_are() {
        for (text, expected) in [
            ("2026-01-02T03:04:05Z", "\"2026-01-02T03:04:05.000000Z\""),
            ("2026-01-02T03:04:05.12Z", "\"2026-01-02T03:04:05.120000Z\""),
            ("2026-01-02T03:04:05.123456Z", "\"2026-01-02T03:04:05.123456Z\""),
        ] {
            let mut written = Vec::new();
            let mut serializer = serde_json::Serializer::new(&mut written);
            time(&text.parse().expect("a time"), &mut serializer).expect("written");
            assert_eq!(String::from_utf8(written).expect("text"), expected);
        }
    }
}
