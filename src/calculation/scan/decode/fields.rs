//! The fields of one line of a table, without copying: by separator or by blanks, quoted or not.

use super::number::parse_number;

/// What stands between two fields.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Separator {
    /// One byte; two in a row enclose an empty field.
    Byte(u8),
    /// Blanks and tabs; a run of them is one.
    Blanks,
}

impl Separator {
    /// The separator of a row of numbers. A comma between blanks that could stand before decimals does.
    pub(super) fn of_row(row: &[u8]) -> Self {
        let mut quoted = false;
        let outside: Vec<u8> = row
            .iter()
            .map(|&byte| {
                quoted ^= byte == b'"';
                if quoted || byte == b'"' { b'0' } else { byte }
            })
            .collect();
        let has = |separator: u8| outside.contains(&separator);
        if has(b';') {
            Self::Byte(b';')
        } else if has(b'\t') {
            Self::Byte(b'\t')
        } else if has(b',') && !has_decimal_commas(&outside) {
            Self::Byte(b',')
        } else {
            Self::Blanks
        }
    }

    /// The separator of a row of numbers behind a name, which does not tell whether commas stand before decimals.
    pub(super) fn of_named_row(row: &[u8]) -> Self {
        let mut words = Self::Blanks.split(row);
        words.next();
        match Self::of_row(row) {
            Self::Byte(b',') if words.rest.is_some_and(has_decimal_commas) => Self::Blanks,
            separator => separator,
        }
    }

    /// The fields of a line, trimmed and without their quotes.
    pub(super) fn split(self, line: &[u8]) -> Fields<'_> {
        let rest = match self {
            Self::Byte(_) => Some(line),
            Self::Blanks => Some(line.trim_ascii()).filter(|line| !line.is_empty()),
        };
        Fields { separator: self, rest }
    }
}

/// Whether every word is a number that could be written with a decimal comma, so that no comma separates.
fn has_decimal_commas(row: &[u8]) -> bool {
    let mut words = 0;
    let all = row.split(u8::is_ascii_whitespace).filter(|word| !word.is_empty()).all(|word| {
        words += 1;
        !word.starts_with(b",") && !word.ends_with(b",") && parse_number(word).is_some()
    });
    all && words >= 3
}

/// The fields that are left of a line.
pub(super) struct Fields<'a> {
    separator: Separator,
    rest: Option<&'a [u8]>,
}

impl<'a> Iterator for Fields<'a> {
    type Item = &'a [u8];

    #[inline]
    fn next(&mut self) -> Option<&'a [u8]> {
        let rest = self.rest?;
        let is_end = |byte: &u8| match self.separator {
            Separator::Byte(separator) => *byte == separator,
            Separator::Blanks => byte.is_ascii_whitespace(),
        };
        let opened = rest.trim_ascii_start().strip_prefix(b"\"");
        let (field, rest) = match opened {
            Some(inside) => {
                let (field, behind) = split_once(inside, |byte| *byte == b'"');
                (field, behind.and_then(|behind| split_once(behind, is_end).1))
            }
            None => split_once(rest, is_end),
        };
        self.rest = match self.separator {
            Separator::Byte(_) => rest,
            Separator::Blanks => rest.map(<[u8]>::trim_ascii_start).filter(|rest| !rest.is_empty()),
        };
        Some(field.trim_ascii())
    }
}

/// What stands before and behind the first byte that is an `end`.
#[inline]
fn split_once(bytes: &[u8], end: impl Fn(&u8) -> bool) -> (&[u8], Option<&[u8]>) {
    match bytes.iter().position(end) {
        Some(at) => (bytes.get(..at).unwrap_or_default(), bytes.get(at + 1..)),
        None => (bytes, None),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn fields(line: &str) -> Vec<&str> {
        Separator::of_row(line.as_bytes()).split(line.as_bytes()).map(|f| str::from_utf8(f).expect("text")).collect()
    }

    #[test]
    fn the_separator_is_recognised_from_a_row() {
        for (line, expected) in [
            ("1,2,3", ["1", "2", "3"]),
            ("1, 2, 3", ["1", "2", "3"]),
            ("1;2,5;3", ["1", "2,5", "3"]),
            ("1\t2,5\t3", ["1", "2,5", "3"]),
            ("  1  2.5 3 ", ["1", "2.5", "3"]),
            ("1,5 2,5 3,5", ["1,5", "2,5", "3,5"]),
            ("\"1,5\",\"2,5\",\"3,5\"", ["1,5", "2,5", "3,5"]),
            ("1,,3", ["1", "", "3"]),
            (";;", ["", "", ""]),
        ] {
            assert_eq!(fields(line), expected, "{line}");
        }
    }
}
