//! Tables in text: CSV, TXT, XYZ, ASC, TSV, PTS, DS; rows of points, or a matrix of heights with declared pitches.
//!
//! | property | how it is recognised |
//! |---|---|
//! | separator | `;`, tab, `,` or blanks, from the first row of numbers |
//! | decimals | point, or comma where the comma does not separate; thousands separators as in [`number`](super::number) |
//! | header | names with x, y, z; up to 1000 lines before it are skipped; also in the last comment before the rows |
//! | units | in the names, in a row below them, or in a comment (`unit: mm`) |
//! | no header | three columns are x y z; four are profile x y z where the first counts runs that share the second |
//! | names of points | without a header, in the first of four columns or more: words, or numbers that count up; skipped, as are columns after x y z |
//! | number of points | a whole number alone in the first line; then columns after x y z (intensity, r, g, b) are skipped |
//! | comments | lines that begin with `#` or `//` |
//! | line ends | LF, CR LF, or CR alone |
//! | missing point | a coordinate that is empty, `nan`, `-`, `null`, `n/a` |
//! | after the rows | a line that states their number, `END`, and NUL |
//! | repeated header | skipped |

use super::error::DecodeError;
use super::fields::Separator;
use super::format::Format;
use super::gather::{Gather, Precision};
use super::hints::{NumberHint, shorten};
use super::lines::{Lines, is_fill};
use super::matrix::Matrix;
use super::names;
use super::number::Numbers;
use super::request::{Request, settle_unit};
use super::table::{Line, Sample, Table, check_columns, is_comment, lone_count};
use crate::scan::cloud::{Cloud, Labels};

/// Reads a table.
pub(super) fn decode(reader: &mut dyn std::io::BufRead, request: &Request<'_>) -> Result<Cloud, DecodeError> {
    let mut lines = Lines::of_text(reader, request.limits)?;
    let mut sample = Sample::read(&mut lines, request.limits)?;
    if request.grid.is_declared() {
        return read_matrix(&sample, &mut lines, request);
    }
    let announced = sample.take_announcement();
    let table = sample.understand(request)?;
    let unit = settle_unit(request.unit, names::settle_stated(table.map.unit, sample.unit)?)?;
    let mut rows = Rows {
        gather: Gather::new(unit, Precision::Double, request.limits),
        numbers: Numbers::new(request.decimal),
        header: table.header.and_then(|at| sample.lines.get(at)).map(|line| line.bytes.clone()),
        table,
        announced,
        end: None,
    };
    for line in sample.lines.get(rows.table.first_row..).unwrap_or_default() {
        rows.take(&line.bytes, line.number)?;
    }
    each_line(&mut lines, |line, number| rows.take(line, number))?;
    check_announced(rows.announced, rows.gather.seen() as u64)?;
    rows.numbers.finish()?;
    rows.gather.finish(match rows.table.map.label {
        Some((_, name)) => Labels::Column(name),
        None => Labels::None,
    })
}

/// Passes on the remaining lines that are neither blank nor comments.
fn each_line(
    lines: &mut Lines<'_>,
    mut take: impl FnMut(&[u8], u64) -> Result<(), DecodeError>,
) -> Result<(), DecodeError> {
    while !lines.is_padding()? {
        let number = lines.number() + 1;
        let Some(line) = lines.next_line()? else { break };
        if !is_comment(line) && !line.trim_ascii().is_empty() {
            take(line, number)?;
        }
    }
    Ok(())
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

/// Reads the rows of a table.
struct Rows<'a> {
    table: Table,
    /// The line of the header.
    header: Option<Vec<u8>>,
    numbers: Numbers,
    gather: Gather<'a>,
    announced: Option<u64>,
    /// The line that ends the rows.
    end: Option<Line>,
}

impl Rows<'_> {
    fn take(&mut self, line: &[u8], number: u64) -> Result<(), DecodeError> {
        if let Some(end) = &self.end
            && !ends_table(line, self.gather.seen() as u64)
        {
            // The line did not end the rows after all.
            return Err(no_number(&end.bytes, end.number));
        }
        // Several scans may be exported in a row, each with its number of points.
        if let Some(points) = &mut self.announced
            && *points == self.gather.seen() as u64
            && let Some(more) = lone_count(line)
        {
            *points = points.saturating_add(more);
            return Ok(());
        }
        match self.read_row(strip_fill(line), number) {
            Err(DecodeError::BadNumber { .. } | DecodeError::RaggedRow { .. })
                if self.header.as_deref() == Some(line) =>
            {
                Ok(())
            }
            Err(DecodeError::BadNumber { .. } | DecodeError::RaggedRow { .. })
                if ends_table(line, self.gather.seen() as u64) =>
            {
                self.end.get_or_insert_with(|| Line { number, bytes: line.to_vec() });
                Ok(())
            }
            outcome => outcome,
        }
    }

    fn read_row(&mut self, line: &[u8], number: u64) -> Result<(), DecodeError> {
        let Table { separator, columns, .. } = self.table;
        let [x, y, z] = self.table.map.point;
        let label_at = self.table.map.label.as_ref().map(|(position, _)| *position);
        let (mut point, mut label) = ([0.0; 3], 0.0);
        let mut found = 0;
        for (column, field) in separator.split(line).enumerate() {
            let [point_x, point_y, point_z] = &mut point;
            // A column may be both a coordinate and the label.
            if label_at == Some(column) {
                label = self.numbers.read(field, number, column)?;
            }
            if column == x {
                *point_x = self.numbers.read(field, number, column)?;
            } else if column == y {
                *point_y = self.numbers.read(field, number, column)?;
            } else if column == z {
                *point_z = self.numbers.read(field, number, column)?;
            }
            // Spreadsheets leave empty cells after the last column.
            if column < columns || !field.is_empty() {
                found = column + 1;
            }
        }
        if found != columns {
            return Err(DecodeError::RaggedRow { line: number, expected: columns, found, text: shorten(line) });
        }
        self.gather.push(label, point)
    }
}

/// A line without the NULs at its end, which some programs append to the last line of a file.
fn strip_fill(line: &[u8]) -> &[u8] {
    let kept = line.iter().rposition(|byte| !is_fill(*byte)).map_or(0, |last| last + 1);
    line.get(..kept).unwrap_or_default()
}

/// Whether a line states, in words, the number of rows above it, or marks the end.
fn ends_table(line: &[u8], rows_count: u64) -> bool {
    const COUNT_WORDS: [&str; 14] = [
        "total", "count", "point", "punkt", "anzahl", "row", "line", "zeile", "summe", "sample", "record", "number",
        "nombre", "end",
    ];
    const END_WORDS: [&str; 6] = ["end", "eof", "end of file", "end of data", "ende", "fin"];
    let text = names::text_of(strip_fill(line)).to_lowercase();
    let text = text.trim_matches(|c: char| !c.is_alphanumeric());
    if END_WORDS.contains(&text) {
        return true;
    }
    let mut counts = text.split(|c: char| !c.is_ascii_digit()).filter(|digits| !digits.is_empty());
    let is_count = counts.next().and_then(|digits| digits.parse().ok()) == Some(rows_count) && counts.next().is_none();
    is_count && COUNT_WORDS.iter().any(|word| text.contains(word))
}

fn no_number(line: &[u8], number: u64) -> DecodeError {
    let text = shorten(line);
    DecodeError::BadNumber { line: number, column: 1, hint: NumberHint::of(&text), text }
}

/// Reads a matrix of heights.
fn read_matrix(sample: &Sample, lines: &mut Lines<'_>, request: &Request<'_>) -> Result<Cloud, DecodeError> {
    let Some((first, separator, columns)) = sample.find_matrix() else {
        return Err(DecodeError::PitchUnused { format: Format::Csv });
    };
    check_columns(columns, request.grid.columns_max(request))?;
    let mut numbers = Numbers::new(request.decimal);
    let mut cells = Vec::new();
    let mut take = |line: &[u8], number: u64| {
        read_cells(strip_fill(line), number, (separator, columns), &mut numbers, &mut cells)?;
        let limit = request.limits.points_max;
        if cells.len() > limit { Err(DecodeError::TooManyPoints { limit }) } else { Ok(()) }
    };
    for line in sample.lines.get(first..).unwrap_or_default() {
        take(&line.bytes, line.number)?;
    }
    each_line(lines, take)?;
    numbers.finish()?;
    Matrix { format: Format::Csv, columns, cells, unit: sample.unit }.into_cloud(request)
}

fn read_cells(
    line: &[u8],
    number: u64,
    (separator, columns): (Separator, usize),
    numbers: &mut Numbers,
    cells: &mut Vec<f64>,
) -> Result<(), DecodeError> {
    let mut found = 0;
    for (column, field) in separator.split(line).enumerate() {
        if column < columns {
            cells.push(numbers.read(field, number, column)?);
        }
        if column < columns || !field.is_empty() {
            found = column + 1;
        }
    }
    if found != columns {
        return Err(DecodeError::RaggedRow { line: number, expected: columns, found, text: shorten(line) });
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scan::decode::{Decimal, Grid, Limits, Unit};
    use crate::scan::{Columns, Stripe};

    fn read_in(text: &str, unit: Option<Unit>) -> Result<Cloud, DecodeError> {
        decode(&mut text.as_bytes(), &Request { unit, ..Request::new(&Limits::default()) })
    }

    fn read(text: &str) -> Result<Cloud, DecodeError> {
        read_in(text, None)
    }

    /// The points of every valid spelling below.
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
    fn ambiguous_columns_require_a_header() {
        for text in ["0 1.5 2 100\n0 1.6 2 90\n1 1.5 2 90\n", "1 2\n3 4\n", "1 2 3 4 5\n"] {
            assert_eq!(read(text).expect_err("ambiguous").code(), "header_needed", "{text}");
        }
    }

    #[test]
    fn names_of_points_before_the_coordinates_are_skipped() {
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
        assert!(matches!(read(&format!("{rows}d,1,x,6\n")), Err(DecodeError::BadNumber { line: 4, column: 3, .. })));
        let error = read(&format!("{rows}d,1,2\n")).expect_err("too short");
        assert!(matches!(error, DecodeError::RaggedRow { line: 4, expected: 4, found: 3, .. }), "{error}");
        let limits = Limits::default();
        let request = Request { profile_column: Some("frame"), ..Request::new(&limits) };
        assert_eq!(decode(&mut rows.as_bytes(), &request).expect_err("no names").code(), "header_needed");
        let limits = Limits { columns_max: 3, ..Limits::default() };
        let request = Request::new(&limits);
        assert_eq!(decode(&mut rows.as_bytes(), &request).expect_err("too many").code(), "too_many_columns");
        // A header of positions does not contain names.
        assert_eq!(read("y,0,5,10\n-38,1,2,3\n-37,1,2,3\n").expect_err("a matrix").code(), "column_unknown");
    }

    #[test]
    fn the_number_of_points_in_the_first_line_is_not_a_row() {
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
        // An integer alone that no row of three follows is not a number of points.
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
        assert!(matches!(read("x,y,z\n1,2,3\n1,b,3\n"), Err(DecodeError::BadNumber { line: 3, column: 2, .. })));
    }

    fn points(text: &str) -> Vec<[f64; 3]> {
        read(text).unwrap_or_else(|error| panic!("{text:.60}: {error}")).points().collect()
    }

    const TWO: [[f64; 3]; 2] = [[1.0, 2.0, 3.0], [1.0, 4.0, 5.0]];

    #[test]
    fn a_header_is_found_after_a_long_preamble_and_after_numbers_in_it() {
        let long: String = (0..300).map(|i| format!("Key{i};value {i}\n")).collect();
        for preamble in [long.as_str(), "Resolution,0.1,0.2\n1280,0.05\n", "0.1 0.2\n", "10;20;30;40\nRange;7\n"] {
            for rows in ["x_mm,y_mm,z_mm\n1,2,3\n1,4,5\n", "x;y;z\n1,0;2,0;3,0\n1;4;5\n"] {
                assert_eq!(points(&format!("{preamble}{rows}")), TWO, "{preamble:.20} {rows}");
            }
        }
        // A line with as many numbers as the header has names could be points.
        assert_eq!(read("9,9,9\nx,y,z\n1,2,3\n").expect_err("points above").code(), "number_invalid");
    }

    #[test]
    fn a_row_of_units_below_the_header_states_the_unit() {
        for units in ["um,um,um", "[um],[\u{b5}m],(micron)", "\"um\",\"um\",\"um\""] {
            let cloud = read(&format!("x,y,z\n{units}\n1000,2000,3000\n")).expect("a table");
            assert_eq!((cloud.unit, cloud.points().collect::<Vec<_>>()), (Unit::Micrometre, vec![[1.0, 2.0, 3.0]]));
        }
        let cloud = read("t,x,i,y,z\ns,m,counts,m,m\n0,1,7,2,3\n").expect("a table");
        assert_eq!(cloud.unit, Unit::Metre);
        assert_eq!(read("x,y,z\nmm,mm,m\n1,2,3\n").expect_err("two units").code(), "unit_conflict");
        assert_eq!(read("x_mm,y_mm,z_mm\num,um,um\n1,2,3\n").expect_err("two units").code(), "unit_conflict");
    }

    #[test]
    fn inches_are_read_in_every_spelling_of_a_header() {
        for header in
            ["x [\"],y [\"],z [\"]", "\"x [\"\"]\",\"y [\"\"]\",\"z [\"\"]\"", "Länge X [in],Breite Y [in],Höhe Z [in]"]
        {
            assert_eq!(read(&format!("{header}\n1,2,3\n")).expect(header).unit, Unit::Inch, "{header}");
        }
    }

    #[test]
    fn numbers_of_points_in_the_first_column_are_skipped() {
        let rows = |first: usize, more: &str| -> String {
            (0..10).map(|i| format!("{},1.5,{}.25,3.5{more}\n", first + i, i)).collect()
        };
        for text in [rows(1, ""), rows(0, ""), rows(17, ",120")] {
            let points = points(&text);
            assert_eq!((points.len(), points[3]), (10, [1.5, 3.25, 3.5]), "{text:.40}");
        }
        // A coordinate that increases by one has as many decimals as the others, and a table of integers does not show the
        // difference.
        let steps: String = (0..10).map(|i| format!("{i}.0,1.5,{i}.25,3.5\n")).collect();
        let whole: String = (0..10).map(|i| format!("{i},1,2,3\n")).collect();
        for text in [steps, whole] {
            assert_eq!(read(&text).expect_err("no name").code(), "header_needed", "{text:.40}");
        }
    }

    #[test]
    fn lines_after_the_rows_are_skipped_if_they_are_unambiguous() {
        for tail in [
            "Total points: 2\n",
            "# 2\n",
            "END\n",
            "2 points\nEOF\n",
            "\0\0\0\n\0\0",
            "\u{1a}",
            "x,y,z\n",
            "\n\nTotal;2\n",
        ] {
            assert_eq!(points(&format!("x,y,z\n1,2,3\n1,4,5\n{tail}")), TWO, "{tail:?}");
        }
        assert_eq!(points("x,y,z\n1,2,3\nx,y,z\n1,4,5\n"), TWO);
        assert_eq!(points("x,y,z\n1,2,3\n1,4,5\0\0\0"), TWO);
        for (tail, code) in [
            ("Total points: 3\n", "number_invalid"),
            ("Mean,3,4\n", "number_invalid"),
            ("END\n1,6,7\n", "number_invalid"),
            ("\0\0\n1,6,7\n", "not_text"),
        ] {
            assert_eq!(read(&format!("x,y,z\n1,2,3\n1,4,5\n{tail}")).expect_err("uncertain").code(), code, "{tail:?}");
        }
    }

    #[test]
    fn a_message_about_a_cell_shows_its_position_its_text_and_the_remedy() {
        for (cell, hint) in [
            ("\u{2212}5.2", "of the keyboard"),
            ("1'950", "thousands"),
            ("1,2.5", "thousands"),
            ("12 mm", "unit"),
            ("12\"", "unit"),
            ("no echo", "not a point"),
            ("?", "empty"),
        ] {
            let error = read(&format!("x;y;z\n1;2;3\n1;{cell};3\n")).expect_err("no number").to_string();
            assert!(error.starts_with("line 3, column 2: \"") && error.contains(hint), "{error}");
            assert!(error.contains(cell.trim_end_matches('"')), "{error}");
        }
        let ragged = read("x,y,z\n1,2,3\n1,2\n").expect_err("ragged").to_string();
        assert!(ragged.contains("line 3") && ragged.contains("\"1,2\""), "{ragged}");
    }

    #[test]
    fn a_table_whose_line_ends_were_removed_is_recognised() {
        for text in
            ["x,y,z0.0,-40.2,18.00.0,-38.8,20.2", "0.0 -40.2 18.00.0 -38.8 20.20.0 -37.3 22.5", "# a1,2,34,5,67,8,9"]
        {
            let error = read(text).expect_err("one line");
            assert_eq!(error.code(), "line_ends_missing", "{text}");
            assert!(error.to_string().contains("--data-binary"), "{error}");
        }
        let limits = Limits { line_bytes_max: 50, ..Limits::default() };
        let error = decode(&mut "x,y,z".repeat(20).as_bytes(), &Request::new(&limits)).expect_err("a long line");
        assert_eq!(error.code(), "line_ends_missing");
        assert_eq!(points("1,2,3"), [[1.0, 2.0, 3.0]]);
    }

    #[test]
    fn thousands_separators_are_refused_unless_the_decimal_sign_is_declared() {
        let text = "x;y;z\n950;-343,43;192,99\n1.950;353,22;266,55\n";
        let error = read(text).expect_err("two readings");
        assert_eq!(error.code(), "number_ambiguous");
        assert!(
            error.to_string().contains("line 3, column 1") && error.to_string().contains("decimal=comma"),
            "{error}"
        );
        let limits = Limits::default();
        let request = Request { decimal: Some(Decimal::Comma), ..Request::new(&limits) };
        let cloud = decode(&mut text.as_bytes(), &request).expect("settled");
        assert_eq!(cloud.points().map(|[x, ..]| x).collect::<Vec<_>>(), [950.0, 1950.0]);
    }

    fn matrix(text: &str, x_pitch_mm: Option<f64>, y_pitch_mm: Option<f64>) -> Result<Cloud, DecodeError> {
        let limits = Limits::default();
        let grid = Grid { x_pitch_mm, y_pitch_mm, columns_are_profiles: false };
        decode(&mut text.as_bytes(), &Request { grid, ..Request::new(&limits) })
    }

    #[test]
    fn a_matrix_is_read_with_its_pitches_and_otherwise_asks_for_them() {
        let rows: String = (0..5).map(|i| format!("{}.5{}\n", i, ",7.25".repeat(9))).collect();
        let with_title = format!("Sensor,A7\nP0,P1,P2\n{rows}");
        for text in [rows.as_str(), with_title.as_str()] {
            let error = read(text).expect_err("no pitch");
            assert!(matches!(error, DecodeError::PitchNeeded { columns: 10, .. }), "{error}");
            assert!(error.to_string().contains("x_pitch_mm") && !error.to_string().contains("y_pitch_mm"), "{error}");
            let cloud = matrix(text, Some(5.0), None).expect("a first column of y");
            assert_eq!(cloud.points().nth(6), Some([5.0, 1.5, 7.25]));
            let cloud = matrix(text, Some(5.0), Some(0.5)).expect("both pitches");
            assert_eq!(cloud.points().nth(11), Some([5.0, 0.5, 7.25]));
        }
        let shuffled: String = [3, 1, 2].iter().map(|i| format!("{}.5{}\n", i * i, ",7.25".repeat(9))).collect();
        assert!(read(&shuffled).expect_err("no pitch").to_string().contains("y_pitch_mm"));
        for (text, code) in [
            ("x,y,z\n1,2,3\n", "pitch_unused"),
            ("1,2,3\n1,2,4\n", "pitch_unused"),
            ("1,2,3,4\n1,2,3\n", "row_ragged"),
            ("1,2,3,4\n1,b,3,4\n", "number_invalid"),
            ("1,2,3,4\n,2,3,4\n", "position_missing"),
        ] {
            assert_eq!(matrix(text, Some(1.0), None).expect_err("wrong").code(), code, "{text}");
        }
    }
}
