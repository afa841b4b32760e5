//! The fields of one line of a table, without copying: by separator or by blanks, quoted or not.
//!
//! Also tables without a header whose first column names the points, as surveyors export them: `a4,32.715,25.084,9.112,`. A first
//! line of this form could also be a header of numbers (a matrix whose columns are positions) or belong to a preamble, and its name
//! could be a keyword (`v 1 2 3` in an OBJ file). The lines below it decide.

use super::number::parse_number;
use std::collections::HashSet;

/// The separator of two fields.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Separator {
    /// One byte; two in a row enclose an empty field.
    Byte(u8),
    /// Blanks and tabs; a run of them is one.
    Blanks,
}

impl Separator {
    /// The separator of a row of numbers. A comma between blanks counts as separator only if it cannot stand before decimals.
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

    /// The separator of a row of numbers after a name, which does not show whether commas stand before decimals.
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

/// The remaining fields of a line.
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

/// The bytes before and after the first byte that is an `end`.
#[inline]
fn split_once(bytes: &[u8], end: impl Fn(&u8) -> bool) -> (&[u8], Option<&[u8]>) {
    match bytes.iter().position(end) {
        Some(at) => (bytes.get(..at).unwrap_or_default(), bytes.get(at + 1..)),
        None => (bytes, None),
    }
}

/// Coordinates after the name.
const AXES: usize = 3;

/// The layout of the rows of a table with named points.
#[derive(Debug, PartialEq)]
pub(super) struct NamedRows {
    pub(super) separator: Separator,
    /// Columns, the name included.
    pub(super) columns: usize,
}

impl NamedRows {
    /// The layout of the rows if the first is a name with three finite coordinates and the rows below it confirm it.
    ///
    /// - At least one more row has a name that is not a number: below a header of numbers there is none.
    /// - At least half of the rows have this layout and a name that no row above them has: a keyword or a profile number repeats,
    ///   while a name repeats only if a point was measured twice. The other rows are read with the same columns, so that a damaged
    ///   one is reported with its line.
    /// - No name is a number with a fraction: that would be a coordinate.
    /// - If more than three numbers follow, the first of them has a fraction in at least one row: otherwise it could be the second
    ///   half of a name (`point 17 1.5 2.5 3.5`) or of a number with a decimal comma (`a1,1,5,2,5,3,5`).
    pub(super) fn find(rows: &[&[u8]]) -> Option<Self> {
        let first = rows.first()?;
        let separator = Separator::of_named_row(first);
        let shape = Row::read(first, separator)?;
        if shape.number.is_some() || shape.coordinates.iter().any(|value| !value.is_finite()) {
            return None;
        }
        let mut names = HashSet::new();
        let (mut words, mut fractional) = (0, false);
        for row in rows.iter().filter_map(|row| Row::read(row, separator)).filter(|row| row.columns == shape.columns) {
            if row.number.is_some_and(has_fraction) {
                return None;
            }
            let new = names.insert(row.name);
            words += usize::from(new && row.number.is_none());
            let [x, ..] = row.coordinates;
            fractional |= has_fraction(x);
        }
        let certain = words >= 2 && 2 * names.len() >= rows.len() && (shape.columns == 1 + AXES || fractional);
        certain.then_some(Self { separator, columns: shape.columns })
    }
}

/// A row of a name and three numbers or more.
struct Row<'a> {
    name: &'a [u8],
    /// The value of a name that is a number.
    number: Option<f64>,
    coordinates: [f64; AXES],
    /// Columns without the empty ones at the end.
    columns: usize,
}

impl<'a> Row<'a> {
    fn read(line: &'a [u8], separator: Separator) -> Option<Self> {
        let mut cells = separator.split(line);
        let name = cells.next()?;
        let mut coordinates = [f64::NAN; AXES];
        let mut columns = 1;
        for (index, cell) in cells.enumerate() {
            let value = parse_number(cell)?;
            if let Some(coordinate) = coordinates.get_mut(index) {
                *coordinate = value;
            }
            if !cell.is_empty() {
                columns = index + 2;
            }
        }
        (columns > AXES).then_some(Self { name, number: parse_number(name), coordinates, columns })
    }
}

fn has_fraction(value: f64) -> bool {
    value.is_finite() && value.fract() != 0.0
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

#[cfg(test)]
mod named_tests {
    use super::*;

    fn find(text: &str) -> Option<(Separator, usize)> {
        let rows: Vec<&[u8]> = text.lines().map(str::as_bytes).collect();
        NamedRows::find(&rows).map(|rows| (rows.separator, rows.columns))
    }

    #[test]
    fn names_before_numbers_are_recognised_with_every_separator() {
        let comma = Separator::Byte(b',');
        for (text, expected) in [
            ("a4,1.5,2.5,3,\nb12,1,2,3,\n", (comma, 4)),
            ("a4, 1.5, 2.5, 3\nb12, 1, 2, 3\n", (comma, 4)),
            ("\"a 4\",\"1,5\",\"2,5\",\"3\"\n\"b\",1,2,3\n", (comma, 4)),
            ("st 4,1.5,2.5,3\nst 5,1,2,3\n", (comma, 4)),
            ("a4;1,5;2,5;3;;\nb12;1;2;3\n", (Separator::Byte(b';'), 4)),
            ("a4\t1,5\t2,5\t3\nb12\t1\t\t3\n", (Separator::Byte(b'\t'), 4)),
            ("a4 1.5 2.5 3\nb12 1 2 3\n", (Separator::Blanks, 4)),
            ("a4   1,5 2,5 3,5\nb12  1 2 3\n", (Separator::Blanks, 4)),
            ("\"a 4\" 1,5 2,5 3,5\nb12 1 2 3\n", (Separator::Blanks, 4)),
            // Point numbers among names, a point without a name, a point without coordinates, a row of other length.
            ("a4,1,2,3\n17,1,2,4\n18,1,2,5\nb,1,2,6\n,1,2,7\n", (comma, 4)),
            ("a4,1,2,3\nb,nan,-,3\n", (comma, 4)),
            ("a4,1,2,3\nb,1,2,4\nc,1,2\nd,1,2,x\n", (comma, 4)),
            // Each point measured twice.
            ("a,1,2,3\na,1,2,3\nb,1,2,4\nb,1,2,4\n", (comma, 4)),
            ("a4,1.5,2.5,3,120,7\nb12,1,2,3,119,7\n", (comma, 6)),
        ] {
            assert_eq!(find(text), Some(expected), "{text}");
        }
    }

    #[test]
    fn ambiguous_words_are_not_taken_for_names() {
        for text in [
            "",
            "a4,1,2,3\n",
            "a,1,2\nb,1,2\n",
            "1,1,2,3\na,1,2,3\nb,1,2,3\n",
            ",1,2,3\na,1,2,3\nb,1,2,3\n",
            "a,1,2,\nb,1,2,3\n",
            "a,nan,2,3\nb,1,2,3\n",
            "a,1,2,3,code\nb,1,2,3,code\n",
            // A matrix: positions in its first line and in its first column.
            "y,0,5,10\n-38,1,2,3\n-37,1,2,3\n",
            "y,0,5,10\nmm,5,5,5\n-38,1,2,3\n-37.5,1,2,3\n",
            // Keywords.
            "v 1.5 2.5 3.5\nv 1 2 3\nv 1 2 4\n",
            "v 1.5 2.5 3.5\nvn 0 0 1\nv 1 2 4\nvn 0 0 1\nv 1 2 5\n",
            // A preamble before rows of a profile number and coordinates.
            "Origin,0,0,0\nRange,9,9,9\n0,1,2,3\n0,1,3,3\n0,1,4,3\n0,1,5,3\n0,1,6,3\n",
            // A second id, or decimal commas that also separate.
            "point 1 1.5 2.5 3.5\nedge 2 1.5 2.5 3.5\n",
            "a1,1,5,2,5,3,5\nb1,1,5,2,5,3,5\n",
            "Sensor,A7,1,2\nb,1,2,3\nc,1,2,3\n",
        ] {
            assert_eq!(find(text), None, "{text}");
        }
    }
}
