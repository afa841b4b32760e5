//! Numbers in messages: short, whatever was sent.

/// A number for people to read: seven digits, and an exponent where there would be a row of zeros.
#[must_use]
pub fn plain(value: f64) -> String {
    let short = format!("{value:.6e}").parse().unwrap_or(value);
    match value.abs() {
        0.0 => "0".to_owned(),
        size if (1e-4..1e7).contains(&size) => format!("{short}"),
        _ => format!("{short:e}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_number_in_a_message_is_short_whatever_it_is() {
        for (value, text) in [
            (0.0, "0"),
            (-0.5, "-0.5"),
            (30.000000000000004, "30"),
            (123_456.0, "123456"),
            (1e300, "1e300"),
            (f64::MIN_POSITIVE, "2.225074e-308"),
            (-1.0 / 3.0, "-0.3333333"),
        ] {
            assert_eq!(plain(value), text);
        }
    }
}
