//! The structure of the rows of a text table, from the first lines: separator, header, columns.

use super::error::DecodeError;
use super::fields::{NamedRows, Separator};
use super::format::Format;
use super::hints::shorten;
use super::limits::Limits;
use super::lines::{Lines, is_fill};
use super::matrix;
use super::names::{self, ColumnMap};
use super::number::parse_number;
use super::request::{Request, settle_unit};
use crate::scan::cloud::Unit;

/// Number of lines that are examined, from the first that could belong to the table.
const SAMPLE_LINES: usize = 64;
/// Bytes of the sampled lines, and of those before them, after which sampling ends.
const SAMPLE_BYTES_MAX: usize = 4 << 20;
/// Least number of rows from which ascending numbers are taken for names of points.
const COUNTED_ROWS_MIN: usize = 8;
/// Least number of columns of a file that lost its line ends.
const GLUED_COLUMNS_MIN: usize = 5;

pub(super) fn is_comment(line: &[u8]) -> bool {
    let line = line.trim_ascii_start();
    line.starts_with(b"#") || line.starts_with(b"//")
}

/// The number in a line that contains only one integer.
pub(super) fn lone_count(line: &[u8]) -> Option<u64> {
    let digits = line.trim_ascii();
    digits.iter().all(u8::is_ascii_digit).then(|| str::from_utf8(digits).ok()?.parse().ok()).flatten()
}

/// The text of a comment after its sign.
fn comment_text(line: &[u8]) -> &[u8] {
    let start = line.iter().position(|byte| !matches!(byte, b'#' | b'/' | b' ')).unwrap_or(line.len());
    line.get(start..).unwrap_or_default().trim_ascii()
}

/// A line that is neither blank nor a comment.
pub(super) struct Line {
    pub(super) number: u64,
    pub(super) bytes: Vec<u8>,
}

/// The first lines of a file, with comments separated.
pub(super) struct Sample {
    pub(super) lines: Vec<Line>,
    /// The text of the last comment before them.
    comment: Option<Vec<u8>>,
    /// The unit that a comment states.
    pub(super) unit: Option<Unit>,
    /// Whether a number of points preceded the rows.
    counted: bool,
}

/// The structure of the rows of a file.
pub(super) struct Table {
    pub(super) separator: Separator,
    pub(super) columns: usize,
    pub(super) map: ColumnMap,
    /// Position of the header in the sample.
    pub(super) header: Option<usize>,
    /// Position in the sample.
    pub(super) first_row: usize,
}

/// A line that names x, y and z.
struct Header {
    at: usize,
    names: Vec<String>,
    /// The separator of the rows below it.
    separator: Separator,
}

impl Sample {
    /// Reads lines up to the first that could be a header or a row of points, and some after it.
    pub(super) fn read(source: &mut Lines<'_>, limits: &Limits) -> Result<Self, DecodeError> {
        let mut sample = Self { lines: Vec::new(), comment: None, unit: None, counted: false };
        let (mut bytes_count, mut begins_at) = (0, None);
        while !source.is_padding()? {
            let number = source.number() + 1;
            match source.next_line() {
                Ok(Some(_)) => {}
                Ok(None) => break,
                Err(error) => return Err(name_too_long(error, source)),
            }
            let line = source.last_line();
            if number == 1 && !source.has_end() && is_glued(line) {
                return Err(DecodeError::LinesStripped);
            }
            let filled_from = line.iter().rposition(|byte| !is_fill(*byte)).map_or(0, |last| last + 1);
            if line.iter().take(filled_from).any(|byte| *byte == 0) {
                return Err(DecodeError::NotText { line: number });
            }
            bytes_count += line.len();
            if is_comment(line) {
                let text = comment_text(line);
                sample.unit = sample.unit.or(names::unit_of_comment(text));
                if sample.lines.is_empty() {
                    sample.comment = Some(text.to_vec());
                }
            } else if !line.trim_ascii().is_empty() {
                begins_at = begins_at.or_else(|| may_begin(line).then_some(sample.lines.len()));
                sample.lines.push(Line { number, bytes: line.to_vec() });
            }
            let wanted = begins_at.map_or(limits.header_lines_max, |at| at + SAMPLE_LINES);
            if sample.lines.len() >= wanted || bytes_count > SAMPLE_BYTES_MAX {
                return Ok(sample);
            }
        }
        Ok(sample)
    }

    /// Removes the first line if it is the number of points: an integer alone, before a row of three or more.
    pub(super) fn take_announcement(&mut self) -> Option<u64> {
        let [first, second, ..] = self.lines.as_slice() else { return None };
        let count = lone_count(&first.bytes)?;
        let separator = Separator::of_row(&second.bytes);
        if !is_row(&second.bytes, separator) || count_columns(&second.bytes, separator) < 3 {
            return None;
        }
        self.lines.remove(0);
        self.counted = true;
        Some(count)
    }

    /// Finds the header, or determines the columns without one if they are unambiguous.
    pub(super) fn understand(&self, request: &Request<'_>) -> Result<Table, DecodeError> {
        let Some(first) = self.lines.first() else { return Err(DecodeError::NoPoints { missing_count: 0 }) };
        if let Some(header) = self.find_header().filter(|header| !self.has_rows_before(header)) {
            return self.with_header(header.separator, &header.names, Some(header.at), header.at + 1, request);
        }
        let separator = self.separator_from(0).unwrap_or_else(|| Separator::of_row(&first.bytes));
        let rows = || {
            self.lines.iter().map(|line| is_row(&line.bytes, separator).then(|| count_columns(&line.bytes, separator)))
        };
        let first_row =
            rows().position(|columns| columns >= Some(3)).or_else(|| rows().position(|columns| columns.is_some()));
        if first_row != Some(0) {
            let rows: Vec<&[u8]> = self.lines.iter().map(|line| line.bytes.as_slice()).collect();
            if let Some(rows) = NamedRows::find(&rows) {
                return self.understand_named_rows(&rows, request);
            }
        }
        match first_row {
            Some(0) => self.understand_rows(separator, request),
            Some(row) => {
                let names = self.lines.get(row - 1).map(|line| split_names(&line.bytes, separator)).unwrap_or_default();
                let columns = self.lines.get(row).map_or(0, |line| count_columns(&line.bytes, separator));
                if columns >= matrix::COLUMNS_MIN && !names.iter().any(|name| names::is_axis(name)) {
                    return Err(self.refuse_matrix(row, separator, columns));
                }
                self.with_header(separator, &names, Some(row - 1), row, request)
            }
            None => Err(DecodeError::NotATable { line: first.number, text: shorten(&first.bytes) }),
        }
    }

    /// Index, separator and columns of the first row of a matrix: the first of the widest rows. `None` for rows of points.
    pub(super) fn find_matrix(&self) -> Option<(usize, Separator, usize)> {
        if self.find_header().is_some() {
            return None;
        }
        let separator = self.separator_from(0)?;
        let columns = |line: &Line| is_row(&line.bytes, separator).then(|| count_columns(&line.bytes, separator));
        let most = self.lines.iter().filter_map(columns).max().filter(|most| *most > 3)?;
        let first = self.lines.iter().position(|line| columns(line) == Some(most))?;
        Some((first, separator, most))
    }

    /// The separator of the first row after a line.
    fn separator_from(&self, at: usize) -> Option<Separator> {
        let rows = self.lines.get(at..).unwrap_or_default();
        rows.iter().find(|line| begins_a_row(&line.bytes)).map(|line| Separator::of_row(&line.bytes))
    }

    /// The first line that names x, y and z, split by the separator of the rows below it, or by its own.
    fn find_header(&self) -> Option<Header> {
        let at_line = |(at, line): (usize, &Line)| {
            // Most lines are rows, while a header begins with a word.
            if begins_a_number(&line.bytes) {
                return None;
            }
            let of_rows = self.separator_from(at + 1);
            let separators = of_rows.into_iter().chain(HEADER_SEPARATORS);
            let names = separators.map(|separator| split_names(&line.bytes, separator));
            let names = names.into_iter().find(|names| has_axes(names))?;
            let separator = of_rows.unwrap_or_else(|| Separator::of_row(&line.bytes));
            Some(Header { at, names, separator })
        };
        self.lines.iter().enumerate().find_map(at_line)
    }

    /// Whether rows with the same number of columns precede a header: then they are not a preamble.
    fn has_rows_before(&self, header: &Header) -> bool {
        let before = self.lines.get(..header.at).unwrap_or_default();
        before.iter().any(|line| {
            is_row(&line.bytes, header.separator) && count_columns(&line.bytes, header.separator) == header.names.len()
        })
    }

    /// A table with names of its columns, and optionally a row of units below them.
    fn with_header(
        &self,
        separator: Separator,
        names: &[String],
        header: Option<usize>,
        first_row: usize,
        request: &Request<'_>,
    ) -> Result<Table, DecodeError> {
        check_columns(names.len(), request.limits.columns_max)?;
        let mut table =
            Table { separator, columns: names.len(), map: names::map_columns(names, request)?, header, first_row };
        if let Some(units) = self.lines.get(first_row).and_then(|line| units_of_row(&line.bytes, &table)) {
            let [x, y, z] = units;
            let unit = settle_unit(Some(x), Some(y)).and_then(|unit| settle_unit(Some(unit), Some(z)))?;
            table.map.unit = names::settle_stated(table.map.unit, Some(unit))?;
            table.first_row += 1;
        }
        Ok(table)
    }

    /// A table that begins with a row: its columns are named in the comment above it, or determined by position.
    fn understand_rows(&self, separator: Separator, request: &Request<'_>) -> Result<Table, DecodeError> {
        let rows = || self.lines.iter().map(|line| line.bytes.as_slice());
        let columns = rows().next().map_or(0, |row| count_columns(row, separator));
        if let Some(names) = self.names_in_comment(separator, columns) {
            return self.with_header(separator, &names, None, 0, request);
        }
        let labelled = columns == 4 && first_counts_runs(rows(), separator);
        let is_named = !labelled && (4..matrix::COLUMNS_MIN).contains(&columns) && first_counts_rows(rows(), separator);
        // Files that begin with the number of points have x y z first in every known convention.
        if request.profile_column.is_some() || !(columns == 3 || labelled || is_named || self.counted) {
            if columns >= matrix::COLUMNS_MIN && request.profile_column.is_none() {
                return Err(self.refuse_matrix(0, separator, columns));
            }
            return Err(DecodeError::HeaderNeeded { columns });
        }
        check_columns(columns, request.limits.columns_max)?;
        let shift = usize::from(labelled || (is_named && !self.counted));
        let label = labelled.then(|| (0, "profile".to_owned()));
        let map = ColumnMap { point: [shift, shift + 1, shift + 2], label, unit: None };
        Ok(Table { separator, columns, map, header: None, first_row: 0 })
    }

    /// A table that begins with a named point. The comment above it may omit the name's column.
    fn understand_named_rows(&self, rows: &NamedRows, request: &Request<'_>) -> Result<Table, DecodeError> {
        let &NamedRows { separator, columns } = rows;
        let names = self.names_in_comment(separator, columns).or_else(|| {
            let names = self.names_in_comment(separator, columns - 1)?;
            Some([vec![String::new()], names].concat())
        });
        if let Some(names) = names {
            return self.with_header(separator, &names, None, 0, request);
        }
        if request.profile_column.is_some() {
            return Err(DecodeError::HeaderNeeded { columns });
        }
        check_columns(columns, request.limits.columns_max)?;
        let map = ColumnMap { point: [1, 2, 3], label: None, unit: None };
        Ok(Table { separator, columns, map, header: None, first_row: 0 })
    }

    fn refuse_matrix(&self, row: usize, separator: Separator, columns: usize) -> DecodeError {
        let rows = self.lines.get(row..).unwrap_or_default();
        let first_of = |line: &Line| separator.split(&line.bytes).next().and_then(parse_number);
        let first_column: Vec<f64> = rows.iter().map_while(first_of).collect();
        DecodeError::PitchNeeded { format: Format::Csv, columns, wanted: matrix::pitches_wanted(&first_column) }
    }

    /// The names of the columns in the last comment before the rows, if it has that many names, including x, y and z.
    fn names_in_comment(&self, separator: Separator, columns: usize) -> Option<Vec<String>> {
        let comment = self.comment.as_ref()?;
        let separators = [separator, Separator::Byte(b','), Separator::Byte(b';'), Separator::Blanks];
        let names = separators.iter().map(|separator| split_names(comment, *separator));
        names.into_iter().find(|names| names.len() == columns && has_axes(names))
    }
}

/// The separators of the names of a header.
const HEADER_SEPARATORS: [Separator; 4] =
    [Separator::Byte(b';'), Separator::Byte(b'\t'), Separator::Byte(b','), Separator::Blanks];

/// Whether a file of one line contains more than one point.
fn is_glued(line: &[u8]) -> bool {
    let separators = [Separator::of_row(line), Separator::Byte(b','), Separator::Byte(b';'), Separator::Blanks];
    let has_columns = |separator: &Separator| count_columns(line, *separator) >= GLUED_COLUMNS_MIN;
    separators.iter().any(has_columns) && line.iter().filter(|byte| byte.is_ascii_digit()).count() >= GLUED_COLUMNS_MIN
}

/// The error for a first line that is too long: its line ends were removed, if it is text.
fn name_too_long(error: DecodeError, source: &Lines<'_>) -> DecodeError {
    let is_text = source.last_line().iter().all(|byte| *byte >= 0x20 || *byte == b'\t');
    match error {
        DecodeError::LineTooLong { line: 1, .. } if is_text => DecodeError::LinesStripped,
        error => error,
    }
}

pub(super) fn check_columns(columns: usize, limit: usize) -> Result<(), DecodeError> {
    if columns > limit { Err(DecodeError::TooManyColumns { limit }) } else { Ok(()) }
}

fn begins_a_number(line: &[u8]) -> bool {
    let first = line.trim_ascii_start().first();
    first.is_some_and(|byte| byte.is_ascii_digit() || b"+-.".contains(byte))
}

fn begins_a_row(line: &[u8]) -> bool {
    begins_a_number(line) || line.trim_ascii_start().first().is_some_and(|byte| b",;\"".contains(byte))
}

/// Whether a line could be a header or a row of points.
fn may_begin(line: &[u8]) -> bool {
    if begins_a_row(line) {
        let separator = Separator::of_row(line);
        if is_row(line, separator) && count_columns(line, separator) >= 3 {
            return true;
        }
    }
    HEADER_SEPARATORS.iter().any(|separator| has_axes(&split_names(line, *separator)))
        || separator_of_named(line).is_some()
}

/// The separator of a line that could be a point after its name.
fn separator_of_named(line: &[u8]) -> Option<Separator> {
    let separator = Separator::of_named_row(line);
    let is_number = |cell| parse_number(cell).is_some();
    (count_columns(line, separator) >= 4 && separator.split(line).skip(1).all(is_number)).then_some(separator)
}

/// The units of x, y and z in a row that has a unit in each of their cells.
fn units_of_row(line: &[u8], table: &Table) -> Option<[Unit; 3]> {
    let unit = |column: usize| names::unit_of_cell(table.separator.split(line).nth(column)?);
    let [x, y, z] = table.map.point.map(unit);
    Some([x?, y?, z?])
}

/// The names of a header line, without the empty ones at its end. A unit in brackets belongs to the preceding word.
fn split_names(line: &[u8], separator: Separator) -> Vec<String> {
    // A cell in quotes doubles those within it: "x [""]".
    let inches = [(&b"[\"\"]"[..], &b"[in]"[..]), (b"(\"\")", b"(in)")];
    let line = inches.iter().fold(line.to_vec(), |line, (from, to)| replace(&line, from, to));
    let mut names: Vec<String> = Vec::new();
    for field in separator.split(&line) {
        let field = names::text_of(field);
        match names.last_mut() {
            Some(last) if separator == Separator::Blanks && field.starts_with(['[', '(']) => last.push_str(&field),
            _ => names.push(field),
        }
    }
    while names.last().is_some_and(String::is_empty) {
        names.pop();
    }
    names
}

fn replace(line: &[u8], from: &[u8], to: &[u8]) -> Vec<u8> {
    let (mut replaced, mut rest) = (Vec::with_capacity(line.len()), line);
    while let Some(at) = rest.windows(from.len()).position(|window| window == from) {
        replaced.extend_from_slice(rest.get(..at).unwrap_or_default());
        replaced.extend_from_slice(to);
        rest = rest.get(at + from.len()..).unwrap_or_default();
    }
    replaced.extend_from_slice(rest);
    replaced
}

/// Whether three columns have names of coordinates.
fn has_axes(names: &[String]) -> bool {
    names.iter().filter(|name| names::is_axis(name)).count() >= 3
}

/// Whether a line has two numbers or more, not all of them missing.
fn is_row(line: &[u8], separator: Separator) -> bool {
    let (mut count, mut any) = (0, false);
    for cell in separator.split(line) {
        let Some(number) = parse_number(cell) else { return false };
        count += 1;
        any |= number.is_finite();
    }
    count >= 2 && any
}

fn count_columns(row: &[u8], separator: Separator) -> usize {
    let end = separator.split(row).enumerate().filter(|(_, field)| !field.is_empty()).last();
    end.map_or(0, |(column, _)| column + 1)
}

/// Whether the first of four columns counts profiles: integers that never decrease, with one value of the second column for each,
/// and some value more than once. x y z with an intensity does not match, because y varies along a profile.
fn first_counts_runs<'a>(rows: impl Iterator<Item = &'a [u8]>, separator: Separator) -> bool {
    let mut last: Option<(f64, f64)> = None;
    let mut repeated = false;
    for row in rows {
        let mut numbers = separator.split(row).map(parse_number);
        let (Some(Some(label)), Some(Some(x))) = (numbers.next(), numbers.next()) else { return false };
        if let Some((last_label, last_x)) = last {
            if label < last_label || (label == last_label && x != last_x) {
                return false;
            }
            repeated |= label == last_label;
        }
        if label.fract() != 0.0 || label < 0.0 {
            return false;
        }
        last = Some((label, x));
    }
    repeated
}

/// Whether the first column counts the rows one by one, as survey tables number their points, without decimals while each of the
/// three columns after it has some. A coordinate that increases by one from point to point would have decimals like the others.
fn first_counts_rows<'a>(rows: impl Iterator<Item = &'a [u8]>, separator: Separator) -> bool {
    let has_decimals = |cell: &[u8]| cell.iter().any(|byte| matches!(byte, b'.' | b','));
    let (mut last, mut count, mut with_decimals) = (None, 0, [false; 3]);
    for row in rows {
        let mut cells = separator.split(row);
        let Some(number) = cells.next().and_then(lone_count) else { return false };
        if last.is_some_and(|last: u64| last.checked_add(1) != Some(number)) {
            return false;
        }
        (last, count) = (Some(number), count + 1);
        with_decimals.iter_mut().zip(cells).for_each(|(seen, cell)| *seen |= has_decimals(cell));
    }
    count >= COUNTED_ROWS_MIN && with_decimals.iter().all(|seen| *seen)
}
