//! A number in text: a point or a comma before the decimals, or one of the words for "no value".

/// The value of a cell; NaN where it says that there is none, `None` where it is no number.
pub(super) fn parse_number(cell: &[u8]) -> Option<f64> {
    let text = str::from_utf8(cell).ok()?;
    if let Ok(value) = text.parse() {
        return Some(value);
    }
    if is_missing(text) {
        return Some(f64::NAN);
    }
    // A comma that has survived the splitting into cells can only stand before decimals.
    let mut copy = [0; 48];
    let copy = copy.get_mut(..cell.len())?;
    copy.copy_from_slice(cell);
    let comma = copy.iter_mut().find(|byte| **byte == b',')?;
    *comma = b'.';
    str::from_utf8(copy).ok()?.parse().ok()
}

fn is_missing(text: &str) -> bool {
    const WORDS: [&str; 7] = ["-", "na", "n/a", "#n/a", "null", "none", "-nan(ind)"];
    text.is_empty() || WORDS.iter().any(|word| word.eq_ignore_ascii_case(text))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_commas_and_words_for_nothing_are_understood() {
        for (cell, value) in [("1.5", 1.5), ("-1,5", -1.5), ("+2", 2.0), ("1,5e-3", 0.0015), ("7", 7.0)] {
            assert_eq!(parse_number(cell.as_bytes()), Some(value), "{cell}");
        }
        for cell in ["", "nan", "NaN", "-", "null", "N/A", "-nan"] {
            assert!(parse_number(cell.as_bytes()).is_some_and(f64::is_nan), "{cell}");
        }
        for cell in ["1.234,5", "1,2,3", "x", "0x10", "1 2", "--1", "\u{b5}"] {
            assert_eq!(parse_number(cell.as_bytes()), None, "{cell}");
        }
    }
}
