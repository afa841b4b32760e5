//! Numbers as a sentence carries them: six decimals at most, and never hundreds of digits, whatever a client or a device has
//! sent.

/// From here on a number is written with an exponent.
const LARGE: f64 = 1e7;
/// Below this, too.
const SMALL: f64 = 1e-5;

/// The number as it is said.
pub(super) fn said(number: f64) -> String {
    if number.is_nan() {
        "no number".to_owned()
    } else if number.is_infinite() {
        if number > 0.0 { "infinity" } else { "-infinity" }.to_owned()
    } else if number != 0.0 && !(SMALL..LARGE).contains(&number.abs()) {
        format!("{number:.3e}")
    } else {
        let text = format!("{number:.6}");
        text.trim_end_matches('0').trim_end_matches('.').to_owned()
    }
}

#[cfg(test)]
mod tests {
    use super::said;

    #[test]
    fn a_number_is_said_in_a_few_digits_whatever_it_is() {
        for (number, text) in [
            (0.0, "0"),
            (40.0, "40"),
            (-3.25, "-3.25"),
            (40.000_001, "40.000001"),
            (0.1 + 0.2, "0.3"),
            (f64::MIN_POSITIVE, "2.225e-308"),
            (-f64::MAX, "-1.798e308"),
            (f64::NAN, "no number"),
            (f64::NEG_INFINITY, "-infinity"),
            (100.0, "100"),
        ] {
            assert_eq!(said(number), text);
        }
    }
}
