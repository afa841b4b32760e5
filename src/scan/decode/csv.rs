//! Tables of points in text: CSV, TXT, XYZ, ASC, TSV, PTS, DS. From lines to a cloud; must not know about sections or frames.
//!
//! | taken as it comes | how |
//! |---|---|
//! | separator | `;`, tab, `,` or blanks, from the first row of numbers |
//! | decimals | point, or comma where the comma does not separate |
//! | header | names with x, y, z; lines before it are passed over; also in the last comment before the rows |
//! | no header | three columns are x y z; four are profile x y z where the first counts runs that share the second |
//! | names of points | without a header, in the first of four columns or more; passed over, as are columns behind x y z |
//! | number of points | a whole number alone in the first line; then columns behind x y z (intensity, r, g, b) are passed over |
//! | comments | lines that begin with `#` or `//`; `unit: mm` in one declares the unit |
//! | line ends | LF, CR LF, or CR alone |
//! | no point | a coordinate that is empty, `nan`, `-`, `null`, `n/a` |

use super::fields::Separator;
use super::gather::Gather;
use super::lines::Lines;
use super::named::NamedRows;
use super::names::{self, ColumnMap};
use super::number::parse_number;
use super::{DecodeError, Format, Limits, Precision, Request, Unit, settle_unit};
use crate::scan::{Cloud, Labels};

/// Lines that are looked at before it is decided how the table is built.
const SAMPLE_LINES: usize = 64;

/// Reads a table.
pub(super) fn decode(reader: &mut dyn std::io::BufRead, request: &Request<'_>) -> Result<Cloud, DecodeError> {
    let mut lines = Lines::of_text(reader, request.limits)?;
    let mut sample = Sample::read(&mut lines)?;
    let mut announced = sample.take_announcement();
    let table = sample.understand(request)?;
    let unit = settle_unit(request.unit, names::settle_stated(table.map.unit, sample.unit)?)?;
    let mut gather = Gather::new(unit, Precision::Double, request.limits);
    for line in sample.lines.get(table.first_row..).unwrap_or_default() {
        table.read(&line.bytes, line.number, &mut gather, &mut announced)?;
    }
    loop {
        let number = lines.number() + 1;
        let Some(line) = lines.next_line()? else { break };
        if !is_comment(line) && !line.trim_ascii().is_empty() {
            table.read(line, number, &mut gather, &mut announced)?;
        }
    }
    check_announced(announced, gather.seen() as u64)?;
    gather.finish(match table.map.label {
        Some((_, name)) => Labels::Column(name),
        None => Labels::None,
    })
}

fn is_comment(line: &[u8]) -> bool {
    let line = line.trim_ascii_start();
    line.starts_with(b"#") || line.starts_with(b"//")
}

/// The number of a line that holds a whole number and nothing else.
fn lone_count(line: &[u8]) -> Option<u64> {
    let digits = line.trim_ascii();
    digits.iter().all(u8::is_ascii_digit).then(|| str::from_utf8(digits).ok()?.parse().ok()).flatten()
}

/// Compares the number of points that the file announces with its rows, missing points included.
fn check_announced(announced: Option<u64>, found: u64) -> Result<(), DecodeError> {
    match announced {
        Some(expected) if found < expected => Err(DecodeError::Truncated { expected, found }),
        Some(stated) if found > stated => Err(DecodeError::SizeMismatch {
            format: Format::Csv,
            field: "the number of points in its first line",
            stated,
            expected: found,
        }),
        _ => Ok(()),
    }
}

/// What a comment says behind its sign.
fn comment_text(line: &[u8]) -> &[u8] {
    let start = line.iter().position(|byte| !matches!(byte, b'#' | b'/' | b' ')).unwrap_or(line.len());
    line.get(start..).unwrap_or_default().trim_ascii()
}

struct Line {
    number: u64,
    bytes: Vec<u8>,
}

/// The first lines of a file, comments set apart.
struct Sample {
    lines: Vec<Line>,
    /// The text of the last comment before them.
    comment: Option<Vec<u8>>,
    unit: Option<Unit>,
    /// Whether a number of points stood before the rows.
    counted: bool,
}

impl Sample {
    fn read(source: &mut Lines<'_>) -> Result<Self, DecodeError> {
        let mut sample = Self { lines: Vec::new(), comment: None, unit: None, counted: false };
        while sample.lines.len() < SAMPLE_LINES {
            let number = source.number() + 1;
            let Some(line) = source.next_line()? else { break };
            if line.contains(&0) || line.starts_with(b"\xff\xfe") || line.starts_with(b"\xfe\xff") {
                return Err(DecodeError::NotText { line: number });
            }
            if is_comment(line) {
                let text = comment_text(line);
                sample.unit = sample.unit.or(names::unit_of_comment(text));
                if sample.lines.is_empty() {
                    sample.comment = Some(text.to_vec());
                }
            } else if !line.trim_ascii().is_empty() {
                sample.lines.push(Line { number, bytes: line.to_vec() });
            }
        }
        Ok(sample)
    }

    /// Takes the first line away where it is the number of points: a whole number alone, before a row of three or more.
    fn take_announcement(&mut self) -> Option<u64> {
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

    /// Finds the header, or does without where the columns speak for themselves.
    fn understand(&self, request: &Request<'_>) -> Result<Table, DecodeError> {
        let Some(first) = self.lines.first() else { return Err(DecodeError::NoPoints { missing_count: 0 }) };
        let begins_a_row = |line: &&Line| {
            let first = line.bytes.trim_ascii_start().first();
            first.is_some_and(|byte| byte.is_ascii_digit() || b"+-.,;\"".contains(byte))
        };
        let separator = Separator::of_row(&self.lines.iter().find(begins_a_row).unwrap_or(first).bytes);
        let header = self.lines.iter().position(|line| has_axes(&split_names(&line.bytes, separator)));
        let first_row = self.lines.iter().position(|line| is_row(&line.bytes, separator));
        if header.is_none() && first_row != Some(0) {
            let rows: Vec<&[u8]> = self.lines.iter().map(|line| line.bytes.as_slice()).collect();
            if let Some(rows) = NamedRows::find(&rows) {
                return self.understand_named_rows(&rows, request);
            }
        }
        match (header, first_row) {
            (Some(header), row) if row.is_none_or(|row| header < row) => {
                let names = self.lines.get(header).map(|line| split_names(&line.bytes, separator)).unwrap_or_default();
                Table::with_header(separator, &names, header + 1, request)
            }
            (_, Some(0)) => self.understand_rows(separator, request),
            (_, Some(row)) => {
                let names = self.lines.get(row - 1).map(|line| split_names(&line.bytes, separator)).unwrap_or_default();
                Table::with_header(separator, &names, row, request)
            }
            (_, None) => Err(DecodeError::NotATable { line: first.number }),
        }
    }

    /// A table that begins with a row: with the names of the comment above it, or by position.
    fn understand_rows(&self, separator: Separator, request: &Request<'_>) -> Result<Table, DecodeError> {
        let rows = || self.lines.iter().map(|line| line.bytes.as_slice());
        let columns = rows().next().map_or(0, |row| count_columns(row, separator));
        if let Some(names) = self.names_in_comment(separator, columns) {
            return Table::with_header(separator, &names, 0, request);
        }
        let labelled = columns == 4 && first_counts_runs(rows(), separator);
        // Files that begin with the number of points have x y z first in every convention known.
        if request.profile_column.is_some() || !(columns == 3 || labelled || self.counted) {
            return Err(DecodeError::HeaderNeeded { columns });
        }
        check_columns(columns, request.limits)?;
        let shift = usize::from(labelled);
        let label = labelled.then(|| (0, "profile".to_owned()));
        let map = ColumnMap { point: [shift, shift + 1, shift + 2], label, unit: None };
        Ok(Table { separator, columns, map, first_row: 0 })
    }

    /// A table that begins with a named point. The comment above it may leave out the name's column.
    fn understand_named_rows(&self, rows: &NamedRows, request: &Request<'_>) -> Result<Table, DecodeError> {
        let &NamedRows { separator, columns } = rows;
        let names = self.names_in_comment(separator, columns).or_else(|| {
            let names = self.names_in_comment(separator, columns - 1)?;
            Some([vec![String::new()], names].concat())
        });
        if let Some(names) = names {
            return Table::with_header(separator, &names, 0, request);
        }
        if request.profile_column.is_some() {
            return Err(DecodeError::HeaderNeeded { columns });
        }
        check_columns(columns, request.limits)?;
        let map = ColumnMap { point: [1, 2, 3], label: None, unit: None };
        Ok(Table { separator, columns, map, first_row: 0 })
    }

    /// The names of the columns in the last comment before the rows, where it names so many and x, y, z are among them.
    fn names_in_comment(&self, separator: Separator, columns: usize) -> Option<Vec<String>> {
        let comment = self.comment.as_ref()?;
        let separators = [separator, Separator::Byte(b','), Separator::Byte(b';'), Separator::Blanks];
        let names = separators.iter().map(|separator| split_names(comment, *separator));
        names.into_iter().find(|names| names.len() == columns && has_axes(names))
    }
}

/// How the rows of a file are built.
struct Table {
    separator: Separator,
    columns: usize,
    map: ColumnMap,
    /// Position in the sample.
    first_row: usize,
}

impl Table {
    fn with_header(
        separator: Separator,
        names: &[String],
        first_row: usize,
        request: &Request<'_>,
    ) -> Result<Self, DecodeError> {
        check_columns(names.len(), request.limits)?;
        Ok(Self { separator, columns: names.len(), map: names::map_columns(names, request)?, first_row })
    }

    /// Reads a row, or the number of points of another block: scans are exported one behind the other.
    fn read(
        &self,
        line: &[u8],
        number: u64,
        gather: &mut Gather<'_>,
        announced: &mut Option<u64>,
    ) -> Result<(), DecodeError> {
        if let Some(points) = announced
            && *points == gather.seen() as u64
            && let Some(more) = lone_count(line)
        {
            *points = points.saturating_add(more);
            return Ok(());
        }
        self.read_row(line, number, gather)
    }

    fn read_row(&self, line: &[u8], number: u64, gather: &mut Gather<'_>) -> Result<(), DecodeError> {
        let [x, y, z] = self.map.point;
        let label_at = self.map.label.as_ref().map(|(position, _)| *position);
        let (mut point, mut label) = ([0.0; 3], 0.0);
        let mut found = 0;
        for (column, field) in self.separator.split(line).enumerate() {
            let number_of =
                |field| parse_number(field).ok_or(DecodeError::BadNumber { line: number, column: column + 1 });
            let [point_x, point_y, point_z] = &mut point;
            // A column may be a coordinate and the label at once.
            if label_at == Some(column) {
                label = number_of(field)?;
            }
            if column == x {
                *point_x = number_of(field)?;
            } else if column == y {
                *point_y = number_of(field)?;
            } else if column == z {
                *point_z = number_of(field)?;
            }
            // Empty cells behind the last column are what a spreadsheet leaves.
            if column < self.columns || !field.is_empty() {
                found = column + 1;
            }
        }
        if found != self.columns {
            return Err(DecodeError::RaggedRow { line: number, expected: self.columns, found });
        }
        gather.push(label, point)
    }
}

fn check_columns(columns: usize, limits: &Limits) -> Result<(), DecodeError> {
    let limit = limits.columns_max;
    if columns > limit { Err(DecodeError::TooManyColumns { limit }) } else { Ok(()) }
}

/// The names of a header line, without the empty ones at its end. A unit in brackets belongs to the word before it.
fn split_names(line: &[u8], separator: Separator) -> Vec<String> {
    let mut names: Vec<String> = Vec::new();
    for field in separator.split(line) {
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

/// Whether three columns bear names of coordinates.
fn has_axes(names: &[String]) -> bool {
    names.iter().filter(|name| names::is_axis(name)).count() >= 3
}

/// Whether a line is two numbers or more, and not all of them missing.
fn is_row(line: &[u8], separator: Separator) -> bool {
    let numbers: Option<Vec<f64>> = separator.split(line).map(parse_number).collect();
    numbers.is_some_and(|numbers| numbers.len() >= 2 && numbers.iter().any(|number| number.is_finite()))
}

fn count_columns(row: &[u8], separator: Separator) -> usize {
    let end = separator.split(row).enumerate().filter(|(_, field)| !field.is_empty()).last();
    end.map_or(0, |(column, _)| column + 1)
}

/// Whether the first of four columns counts profiles: whole numbers that never fall, the second column one value for
/// each, and some value more than once. x y z with an intensity behind them fails it, for y varies along a profile.
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scan::{Columns, Stripe};

    fn read_in(text: &str, unit: Option<Unit>) -> Result<Cloud, DecodeError> {
        decode(&mut text.as_bytes(), &Request { unit, profile_column: None, limits: &Limits::default() })
    }

    fn read(text: &str) -> Result<Cloud, DecodeError> {
        read_in(text, None)
    }

    /// What every well-formed spelling below holds.
    fn expected() -> (Vec<Stripe>, Columns) {
        let stripes = vec![Stripe { label: 0.0, x: 1.5, end: 2 }, Stripe { label: 0.0, x: -2.0, end: 3 }];
        (stripes, Columns::F64 { y: vec![2.5, 0.25, 7.0], z: vec![3.0, 4.0, 8.0] })
    }

    #[test]
    fn every_spelling_of_a_table_gives_the_same_points() {
        for text in [
            "1.5,2.5,3\n1.5,0.25,4\n-2,7,8\n",
            "x,y,z\r\n1.5,2.5,3\r\n1.5,0.25,4\r\n-2,7,8",
            "\u{feff}X (mm);Y (mm);Z (mm)\n1,5;2,5;3\n1,5;0,25;4\n-2;7;8\n",
            "# comment\n// another\nz\ty\tx\n3\t2,5\t1,5\n\n4\t0,25\t1,5\n# within\n8\t7\t-2\n",
            "1,5 2,5 3,0\n1,5 0,25 4,0\n-2,0 7,0 8,0",
            "  1.5   2.5   3\n1.5 0.25 4\n-2 7 8\n",
            "//X Y Z\n1.5 2.5 3\n1.5 0.25 4\n-2 7 8\n",
            "#z,y,x\n3,2.5,1.5\n4,0.25,1.5\n8,7,-2\n",
            "Sensor A7\nDate 3 May\nx_mm y_mm z_mm\n1.5 2.5 3\n1.5 0.25 4\n-2 7 8\n",
            "\"x\",\"y\",\"z\"\n\"1.5\",\"2.5\",\"3\"\n1.5,0.25,4,,\n-2, 7, 8\n",
            "t,x,y,z,i\n0,1.5,2.5,3,a\n1,1.5,0.25,4,b\n2,-2,7,8,\n".replace(",\n", ",c\n").as_str(),
        ] {
            let cloud = read(text).unwrap_or_else(|error| panic!("{text}: {error}"));
            assert_eq!((cloud.stripes, cloud.columns), expected(), "{text}");
            assert_eq!((cloud.labels, cloud.missing_count), (Labels::None, 0), "{text}");
        }
    }

    #[test]
    fn a_profile_column_is_found_by_name_or_by_position() {
        for text in ["profile,x,y,z\n4,1,2,3\n4,1,3,3\n9,2,2,3\n", "4 1 2 3\n4 1 3 3\n9 2 2 3\n"] {
            let cloud = read(text).expect("a table");
            assert_eq!(cloud.labels, Labels::Column("profile".to_owned()));
            assert_eq!(cloud.stripes.iter().map(|s| (s.label, s.end)).collect::<Vec<_>>(), [(4.0, 2), (9.0, 3)]);
        }
    }

    #[test]
    fn columns_that_could_mean_two_things_need_a_header() {
        for text in ["0 1.5 2 100\n0 1.6 2 90\n1 1.5 2 90\n", "1 2\n3 4\n", "1 2 3 4 5\n"] {
            assert_eq!(read(text).expect_err("ambiguous").code(), "header_needed", "{text}");
        }
    }

    #[test]
    fn names_of_points_before_the_coordinates_are_passed_over() {
        for text in [
            "a4,1.5,2.5,3,\nb12,1.5,0.25,4,\n17,-2,7,8,\n",
            "\u{feff}a4;1,5;2,5;3\r\nb12;1,5;0,25;4\r\n17;-2;7;8",
            "# unit: mm\na4\t1.5\t2.5\t3\n\n17\t1.5\t0.25\t4\nb 12\t-2\t7\t8\n",
            "a4 1,5 2,5 3,0\n17 1,5 0,25 4,0\nb12 -2,0 7,0 8,0",
            "\"a,4\",\"1.5\",\"2.5\",\"3\"\n\"b\",1.5,0.25,4,,\n17, -2, 7, 8\n",
            "a4,1.5,2.5,3,120,9\nb12,1.5,0.25,4,121,-\n17,-2,7,8,,9\n",
            "S\u{fc}d1,1.5,2.5,3\nS\u{fc}d2,1.5,0.25,4\nS\u{fc}d3,-2,7,8\n",
            "# point;z;y;x\na4;3;2,5;1,5\nb12;4;0,25;1,5\nc;8;7;-2\n",
            "# z y x\na4,3,2.5,1.5\nb12,4,0.25,1.5\nc,8,7,-2\n",
        ] {
            let cloud = read(text).unwrap_or_else(|error| panic!("{text}: {error}"));
            assert_eq!((cloud.stripes, cloud.columns), expected(), "{text}");
            assert_eq!((cloud.labels, cloud.missing_count), (Labels::None, 0), "{text}");
        }
        let metres = read_in("a4,1,2,3,\nb12,nan,2,3,\n", Some(Unit::Metre)).expect("a table");
        assert_eq!((metres.columns.get(0), metres.missing_count), (Some([2000.0, 3000.0]), 1));
    }

    #[test]
    fn a_damaged_row_among_named_points_is_refused_with_its_line() {
        let rows = "a,1,2,3\nb,1,2,4\nc,1,2,5\n";
        assert!(matches!(read(&format!("{rows}d,1,x,6\n")), Err(DecodeError::BadNumber { line: 4, column: 3 })));
        let error = read(&format!("{rows}d,1,2\n")).expect_err("too short");
        assert!(matches!(error, DecodeError::RaggedRow { line: 4, expected: 4, found: 3 }), "{error}");
        let request = Request { unit: None, profile_column: Some("frame"), limits: &Limits::default() };
        assert_eq!(decode(&mut rows.as_bytes(), &request).expect_err("no names").code(), "header_needed");
        let limits = Limits { columns_max: 3, ..Limits::default() };
        let request = Request { unit: None, profile_column: None, limits: &limits };
        assert_eq!(decode(&mut rows.as_bytes(), &request).expect_err("too many").code(), "too_many_columns");
        // A header of positions is none of names.
        assert_eq!(read("y,0,5,10\n-38,1,2,3\n-37,1,2,3\n").expect_err("a matrix").code(), "column_unknown");
    }

    #[test]
    fn the_number_of_points_in_the_first_line_is_no_row() {
        for text in [
            "3\n1.5 2.5 3\n1.5 0.25 4\n-2 7 8\n",
            "3\r\n1.5\t2.5\t3\r\n1.5\t0.25\t4\r\n-2\t7\t8\r\n",
            "\u{feff}# exported\n 3 \n1.5,2.5,3\n1.5,0.25,4\n-2,7,8",
            "3\n1.5 2.5 3 -1200\n1.5 0.25 4 -1200\n-2 7 8 -1199\n",
            "3\n1.5 2.5 3 10 20 30\n1.5 0.25 4 10 20 30\n-2 7 8 10 20 30\n",
            "3\n1.5 2.5 3 -1200 10 20 30\n1.5 0.25 4 -1200 10 20 30\n-2 7 8 -1200 10 20 30\n",
            "2\n1.5 2.5 3\n1.5 0.25 4\n1\n-2 7 8\n",
        ] {
            let cloud = read(text).unwrap_or_else(|error| panic!("{text}: {error}"));
            assert_eq!((cloud.stripes, cloud.columns), expected(), "{text}");
        }
        let labelled = read("3\n4 1 2 3\n4 1 3 3\n9 2 2 3\n").expect("a table");
        assert_eq!(labelled.labels, Labels::Column("profile".to_owned()));
        assert_eq!(read("2\n1 2 3\n1 nan 3\n").expect("a missing point counts").missing_count, 1);
    }

    #[test]
    fn a_number_of_points_that_is_not_that_of_the_rows_is_refused_with_both() {
        let short = read("4\n1 2 3\n1 2 4\n").expect_err("ends early");
        assert!(matches!(short, DecodeError::Truncated { expected: 4, found: 2 }), "{short}");
        let long = read("1\n1 2 3\n1 2 4\n").expect_err("too many");
        assert_eq!(long.code(), "size_mismatch");
        assert!(long.to_string().contains("number of points in its first line = 1, which should be 2"), "{long}");
        let huge = read("18446744073709551615\n1 2 3\n").expect_err("ends early");
        assert_eq!(huge.code(), "file_truncated");
        // Two blocks, the second of which ends early.
        assert_eq!(read("1\n1 2 3\n2\n1 2 4\n").expect_err("ends early").code(), "file_truncated");
        // A number alone that no row of three follows is none of points.
        assert_eq!(read("7\n1 2\n3 4\n").expect_err("two columns").code(), "column_unknown");
        assert_eq!(read("1600\nx y z\n1 2 3\n").expect("a title").columns.len(), 1);
    }

    #[test]
    fn cells_without_a_number_are_missing_points() {
        let cloud = read("x,y,z\n1,2,3\n1,,3\n1,2,NaN\n1,-,3\n1,null,inf\n").expect("a table");
        assert_eq!((cloud.columns.len(), cloud.missing_count), (1, 4));
    }

    #[test]
    fn the_unit_may_come_from_the_header_but_not_contradict_the_request() {
        let cloud = read("x_m,y_m,z_m\n1,2,3\n").expect("metres");
        assert_eq!(cloud.columns.get(0), Some([2000.0, 3000.0]));
        assert_eq!(read("# unit: inch\n1,2,3\n").expect("inches").columns.get(0), Some([50.8, 3.0 * 25.4]));
        let error = read_in("x [um],y [um],z [um]\n1,2,3\n", Some(Unit::Millimetre)).expect_err("conflict");
        assert!(matches!(error, DecodeError::UnitConflict { declared: Unit::Millimetre, found: Unit::Micrometre }));
    }

    #[test]
    fn each_wrong_table_has_its_own_reason() {
        for (text, code) in [
            ("Dear colleague,\nplease find the scan attached.\n", "not_a_table"),
            ("a,b,c\n1,2,3\n", "column_unknown"),
            ("x,y,z\n1,2,3\n1,2\n", "row_ragged"),
            ("x,y,z\n1,2,3,4\n", "row_ragged"),
            ("x,y,z\n1,2,3\n1,b,3\n", "number_invalid"),
            ("x,y,z\n", "no_points"),
            ("\n\n", "no_points"),
            ("x,y,z\nnan,nan,nan\n", "no_points"),
            ("x,y,z\n1,2,1e308\n", "coordinate_out_of_range"),
            ("\u{0}x\u{0},\u{0}y", "not_text"),
        ] {
            assert_eq!(read(text).expect_err("wrong").code(), code, "{text}");
        }
        assert!(matches!(read("x,y,z\n1,2,3\n1,b,3\n"), Err(DecodeError::BadNumber { line: 3, column: 2 })));
    }
}
