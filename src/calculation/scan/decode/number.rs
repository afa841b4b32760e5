//! Numbers in text: the value of a cell, and which of `.` and `,` is the decimal sign.
//!
//! `1,000` is one in Berlin and a thousand in Boston, `1.000` the reverse. If the decimal sign is not declared, the cells of
//! the file together determine it:
//!
//! | cell | decimal sign |
//! |---|---|
//! | `0.5`, `1234.567`, `1,234.5`, `1,234,567` | point |
//! | `0,5`, `1234,567`, `1.234,5`, `1.234.567` | comma |
//! | `1.234` | undetermined: point, unless another cell shows a decimal comma |
//! | `1,234` | undetermined: comma only if another cell shows a decimal comma, and none a decimal point |
//!
//! A file with a cell that is still ambiguous is refused with both values.

use super::error::DecodeError;
use super::hints::{NumberHint, shorten};
use serde::{Deserialize, Serialize};

/// Largest number of bytes of a number; the longest in practice have about 25.
const NUMBER_BYTES_MAX: usize = 48;

/// The decimal sign of a text file's numbers. The other one separates thousands.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Decimal {
    /// `1.5`
    Point,
    /// `1,5`
    Comma,
}

impl Decimal {
    /// Every sign, in the order in which messages list them.
    pub const ALL: [Self; 2] = [Self::Point, Self::Comma];

    /// The name used in requests and results.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Point => "point",
            Self::Comma => "comma",
        }
    }

    /// The sign of a name, irrespective of case.
    #[must_use]
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|sign| sign.name().eq_ignore_ascii_case(name.trim()))
    }

    const fn byte(self) -> u8 {
        match self {
            Self::Point => b'.',
            Self::Comma => b',',
        }
    }

    const fn other(self) -> Self {
        match self {
            Self::Point => Self::Comma,
            Self::Comma => Self::Point,
        }
    }
}

/// A cell with two possible values.
#[derive(Debug)]
struct Doubtful {
    line: u64,
    column: usize,
    text: String,
}

/// The evidence of a file's cells about one sign.
#[derive(Debug, Default)]
struct Shown {
    /// Whether it occurs before decimals.
    is_decimal: bool,
    /// The first cell in which it may also separate thousands.
    doubtful: Option<Doubtful>,
}

impl Shown {
    fn doubt(&mut self, cell: &[u8], line: u64, column: usize) {
        self.doubtful.get_or_insert_with(|| Doubtful { line, column: column + 1, text: shorten(cell) });
    }
}

/// Reads the numbers of one file.
#[derive(Debug)]
pub(super) struct Numbers {
    declared: Option<Decimal>,
    point: Shown,
    comma: Shown,
}

impl Numbers {
    pub(super) fn new(declared: Option<Decimal>) -> Self {
        Self { declared, point: Shown::default(), comma: Shown::default() }
    }

    /// The value of a cell; NaN if it is marked as missing. `column` counts from 0.
    ///
    /// # Errors
    /// [`DecodeError::BadNumber`] with the position and the text.
    #[inline]
    pub(super) fn read(&mut self, cell: &[u8], line: u64, column: usize) -> Result<f64, DecodeError> {
        let Some(value) = parse_plain(cell) else { return self.read_with_care(cell, line, column) };
        match self.declared {
            Some(Decimal::Point) => Ok(value),
            Some(Decimal::Comma) => self.read_with_care(cell, line, column),
            None if looks_grouped(cell) => {
                self.point.doubt(cell, line, column);
                Ok(value)
            }
            None => {
                self.point.is_decimal = self.point.is_decimal || cell.contains(&b'.');
                Ok(value)
            }
        }
    }

    /// To be called after the last number.
    ///
    /// # Errors
    /// [`DecodeError::AmbiguousNumber`] if a cell still has two possible values.
    pub(super) fn finish(self) -> Result<(), DecodeError> {
        let Self { point, comma, .. } = self;
        let of_point = point.doubtful.filter(|_| comma.is_decimal);
        let of_comma = comma.doubtful.filter(|_| point.is_decimal || !comma.is_decimal);
        let Some(Doubtful { line, column, text }) = of_comma.or(of_point) else { return Ok(()) };
        let reading = |sign| parse_as(text.as_bytes(), sign).unwrap_or(f64::NAN);
        let (as_point, as_comma) = (reading(Decimal::Point), reading(Decimal::Comma));
        Err(DecodeError::AmbiguousNumber { line, column, text, as_point, as_comma })
    }

    #[cold]
    fn read_with_care(&mut self, cell: &[u8], line: u64, column: usize) -> Result<f64, DecodeError> {
        if is_missing(cell) {
            return Ok(f64::NAN);
        }
        let value = match self.declared {
            Some(sign) => parse_as(cell, sign),
            None if looks_grouped(cell) => {
                self.comma.doubt(cell, line, column);
                parse_as(cell, Decimal::Comma)
            }
            None => self.read_certain(cell),
        };
        value.ok_or_else(|| {
            let text = shorten(cell);
            DecodeError::BadNumber { line, column: column + 1, hint: NumberHint::of(&text), text }
        })
    }

    /// The value of a cell that is unambiguous.
    fn read_certain(&mut self, cell: &[u8]) -> Option<f64> {
        for (sign, shown) in [(Decimal::Point, &mut self.point), (Decimal::Comma, &mut self.comma)] {
            if let Some(value) = parse_as(cell, sign) {
                shown.is_decimal |= cell.iter().any(|byte| matches!(byte, b'.' | b','));
                return Some(value);
            }
        }
        None
    }
}

/// Whether a cell is a number or a word for "no value", with either decimal sign; it distinguishes rows from other lines.
pub(super) fn parse_number(cell: &[u8]) -> Option<f64> {
    let missing = || is_missing(cell).then_some(f64::NAN);
    let with_care = || Decimal::ALL.into_iter().rev().find_map(|sign| parse_as(cell, sign));
    parse_plain(cell).or_else(missing).or_else(with_care)
}

fn parse_plain(cell: &[u8]) -> Option<f64> {
    str::from_utf8(cell).ok()?.parse().ok()
}

fn is_missing(cell: &[u8]) -> bool {
    const WORDS: [&[u8]; 9] = [b"-", b"--", b"na", b"n/a", b"#n/a", b"null", b"none", b"-nan(ind)", b"nan(ind)"];
    cell.is_empty() || WORDS.iter().any(|word| word.eq_ignore_ascii_case(cell))
}

/// Whether a cell is one to three digits, a point or comma, and three digits: 1.234 or 1234. A leading zero separates nothing.
fn looks_grouped(cell: &[u8]) -> bool {
    let digits = cell.strip_prefix(b"-").or_else(|| cell.strip_prefix(b"+")).unwrap_or(cell);
    let [b'1'..=b'9', middle @ .., b'.' | b',', a, b, c] = digits else { return false };
    middle.len() <= 2 && middle.iter().chain([a, b, c]).all(u8::is_ascii_digit)
}

/// The value of a cell with `sign` before its decimals and the other one, if any, between groups of three digits. `D` may precede
/// the exponent, as in Fortran.
fn parse_as(cell: &[u8], sign: Decimal) -> Option<f64> {
    let other = sign.other().byte();
    if cell.contains(&other) && !is_grouped(cell, sign) {
        return None;
    }
    let mut copy = [0; NUMBER_BYTES_MAX];
    let mut length = 0;
    for &byte in cell.iter().filter(|byte| **byte != other) {
        *copy.get_mut(length)? = match byte {
            b'd' | b'D' => b'e',
            byte if byte == sign.byte() => b'.',
            byte => byte,
        };
        length += 1;
    }
    copy.get(..length).and_then(parse_plain)
}

/// Whether the digits before the decimals are in groups of three.
fn is_grouped(cell: &[u8], sign: Decimal) -> bool {
    let digits = cell.strip_prefix(b"-").or_else(|| cell.strip_prefix(b"+")).unwrap_or(cell);
    let is_end = |byte: &u8| *byte == sign.byte() || byte.is_ascii_alphabetic();
    let end = digits.iter().position(is_end).unwrap_or(digits.len());
    let (whole, rest) = digits.split_at(end);
    let mut groups = whole.split(|byte| *byte == sign.other().byte());
    let first = groups.next().unwrap_or_default();
    let all_digits = |group: &[u8]| group.iter().all(u8::is_ascii_digit);
    (1..=3).contains(&first.len())
        && all_digits(first)
        && first != b"0"
        && groups.all(|group| group.len() == 3 && all_digits(group))
        && !rest.contains(&sign.other().byte())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The values of the cells of a file, and the error for which it is refused.
    fn read(cells: &[&str], declared: Option<Decimal>) -> Result<Vec<f64>, DecodeError> {
        let mut numbers = Numbers::new(declared);
        let values: Result<Vec<f64>, _> = cells.iter().map(|cell| numbers.read(cell.as_bytes(), 1, 0)).collect();
        let values = values?;
        numbers.finish().map(|()| values)
    }

    #[test]
    fn points_commas_and_words_for_missing_values_are_understood() {
        for (cell, value) in [
            ("1.5", 1.5),
            ("-1,5", -1.5),
            ("+2", 2.0),
            ("1,5e-3", 0.0015),
            ("7", 7.0),
            ("0,125", 0.125),
            ("1234,567", 1234.567),
            ("1.234,5", 1234.5),
            ("1,234.5", 1234.5),
            ("1.234.567", 1_234_567.0),
            ("-4.029858D+01", -40.29858),
            ("1,5d2", 150.0),
        ] {
            assert_eq!(read(&[cell], None).expect(cell), [value], "{cell}");
            assert_eq!(parse_number(cell.as_bytes()), Some(value), "{cell}");
        }
        for cell in ["", "nan", "NaN", "-", "null", "N/A", "-nan"] {
            assert!(parse_number(cell.as_bytes()).is_some_and(f64::is_nan), "{cell}");
            assert!(read(&[cell], Some(Decimal::Comma)).is_ok_and(|values| values[0].is_nan()), "{cell}");
        }
        for cell in ["1,2,3", "x", "0x10", "1 2", "--1", "\u{b5}", "1.2.3", "12,34.5", "0.123.456", "1,234.5,6"] {
            assert_eq!(parse_number(cell.as_bytes()), None, "{cell}");
            assert_eq!(read(&[cell], None).expect_err("no number").code(), "number_invalid", "{cell}");
        }
    }

    #[test]
    fn a_thousands_separator_is_never_read_as_a_decimal_sign() {
        for cells in [
            // No cell shows the meaning of the comma.
            &["195,000", "0", "-40,299"][..],
            // One sign is decimal, so the other is not, in both directions.
            &["1.950", "353,22"],
            &["353,22", "1.950"],
            &["1,950", "353.22"],
            &["1,950", "1,950,000"],
            &["1.950", "1.950.000"],
        ] {
            let error = read(cells, None).expect_err("two readings");
            assert_eq!(error.code(), "number_ambiguous", "{cells:?}");
        }
        let error = read(&["0,5", "1.950"], None).expect_err("two readings").to_string();
        assert!(error.contains("\"1.950\"") && error.contains("1.95 ") && error.contains("1950 "), "{error}");
    }

    #[test]
    fn one_unambiguous_cell_determines_the_others() {
        assert_eq!(read(&["1,950", "0,532"], None).expect("commas"), [1.95, 0.532]);
        assert_eq!(read(&["1.950", "17.219"], None).expect("points"), [1.95, 17.219]);
    }

    #[test]
    fn a_declared_sign_determines_all_cells() {
        let cells = ["1.950", "353,22", "7"];
        assert_eq!(read(&cells, Some(Decimal::Comma)).expect("commas"), [1950.0, 353.22, 7.0]);
        assert_eq!(read(&["195,000", "0"], Some(Decimal::Point)).expect("points"), [195_000.0, 0.0]);
        assert_eq!(read(&["1.5"], Some(Decimal::Comma)).expect_err("a decimal point").code(), "number_invalid");
        assert_eq!(read(&["1,5"], Some(Decimal::Point)).expect_err("a decimal comma").code(), "number_invalid");
    }
}
