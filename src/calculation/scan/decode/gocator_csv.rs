//! The text that Gocator sensors export, version 2: named sections, each closed by `End`. From lines to a cloud.
//!
//! | section | points |
//! |---|---|
//! | Profile, Ranges | a row per frame: X from the header row, Z in the cells |
//! | RawProfile | two rows per frame, X and Z, distinguished by the column Axis |
//! | Part, Surface | a grid: X from the row that begins with `Y\X`, Y in the first column, Z in the cells |
//! | SurfacePointCloud | rows of X, Y, Z |
//!
//! From sensor to rail coordinates: the sensor's X (across the laser line) becomes y, its Z (height) z, its Y (travel) x; that is a
//! left-handed swap, which the sensor-to-rail calibration takes up. Each frame, or row of a grid, is a row. Lengths are
//! millimetres. The first section that has points counts.

use super::error::DecodeError;
use super::fields::{Fields, Separator};
use super::format::Format;
use super::gather::{Gather, Precision};
use super::hints::shorten;
use super::lines::Lines;
use super::number::{Numbers, parse_number};
use super::request::{Request, settle_unit};
use crate::scan::cloud::{Cloud, Labels, Unit};
use std::io::BufRead;

const COMMA: Separator = Separator::Byte(b',');

/// Reads the first section with points.
pub(super) fn decode(reader: &mut dyn BufRead, request: &Request<'_>) -> Result<Cloud, DecodeError> {
    let unit = settle_unit(request.unit, Some(Unit::Millimetre))?;
    let mut gather = Gather::new(unit, Precision::Double, request.limits);
    let mut lines = Lines::new(reader, request.limits);
    let mut begun = false;
    let mut version_at = None;
    let mut numbers = Numbers::new(request.decimal);
    loop {
        let number = lines.number() + 1;
        let Some(line) = lines.next_line()? else { break };
        let mut cells = COMMA.split(line);
        let first = cells.next().unwrap_or_default();
        let alone = cells.all(<[u8]>::is_empty);
        if !begun && !first.is_empty() {
            if first != b"Info" {
                return Err(DecodeError::NotThisFormat { format: Format::GocatorCsv });
            }
            begun = true;
        }
        check_version(line, &mut version_at)?;
        let labels = match first {
            b"Profile" | b"Ranges" | b"RawProfile" if alone => {
                read_frames(&mut lines, number, &mut numbers, &mut gather)?
            }
            b"Part" | b"Surface" if alone => read_grid(&mut lines, number, &mut numbers, &mut gather)?,
            b"SurfacePointCloud" if alone => read_triples(&mut lines, number, &mut numbers, &mut gather)?,
            _ => continue,
        };
        if gather.seen() > 0 {
            numbers.finish()?;
            return gather.finish(labels);
        }
    }
    Err(if begun { DecodeError::SectionMissing } else { DecodeError::NoPoints { missing_count: 0 } })
}

/// Reads the version from the cell beside its name or below it.
fn check_version(line: &[u8], at: &mut Option<usize>) -> Result<(), DecodeError> {
    let cell = |position| COMMA.split(line).nth(position).and_then(parse_number);
    let stated = match at.take() {
        Some(position) => cell(position),
        None => {
            *at = COMMA.split(line).position(|name| name == b"CSV Version");
            let beside = at.and_then(|position| cell(position + 1)).filter(|value| value.is_finite());
            if beside.is_some() {
                *at = None;
            }
            beside
        }
    };
    if stated.is_some_and(|version| version != 2.0) {
        let what = "only version 2 of the Gocator export is read; export with a newer firmware";
        return Err(DecodeError::Unsupported { format: Format::GocatorCsv, what });
    }
    Ok(())
}

/// The lines of a section up to `End`.
struct Section<'s, 'a> {
    lines: &'s mut Lines<'a>,
    start: u64,
    /// Whether its `End` was read; otherwise the file ended first.
    closed: bool,
    announced: Announced,
}

/// The number of rows that a section states, in the cell below this name.
#[derive(Debug)]
struct Announced {
    name: &'static [u8],
    at: Option<usize>,
    count: Option<u64>,
}

impl Announced {
    const fn below(name: &'static [u8]) -> Self {
        Self { name, at: None, count: None }
    }

    fn look(&mut self, line: &[u8]) {
        if let Some(at) = self.at.take() {
            let count = COMMA.split(line).nth(at).and_then(|cell| std::str::from_utf8(cell).ok()?.parse().ok());
            self.count = self.count.or(count);
        } else if self.count.is_none() {
            self.at = COMMA.split(line).position(|cell| cell == self.name);
        }
    }
}

impl<'s, 'a> Section<'s, 'a> {
    fn new(lines: &'s mut Lines<'a>, start: u64, announced: Announced) -> Self {
        Self { lines, start, closed: false, announced }
    }

    /// Refuses a section if the file ends before all of its rows; `is_cut` is set if its last row is incomplete.
    fn check_whole(&self, found: u64, is_cut: bool) -> Result<(), DecodeError> {
        let Some(expected) = self.announced.count.filter(|_| !self.closed) else { return Ok(()) };
        if found < expected || is_cut {
            let found = found.min(expected).saturating_sub(u64::from(is_cut));
            return Err(DecodeError::FramesMissing { line: self.start, expected, found });
        }
        Ok(())
    }

    /// The next line that is not blank.
    fn next_line(&mut self) -> Result<Option<(u64, &[u8])>, DecodeError> {
        // The loop examines a line twice, because the borrow checker does not allow returning the line that was examined.
        loop {
            let number = self.lines.number() + 1;
            let Some(is_blank) = self.lines.next_line()?.map(is_blank) else { return Ok(None) };
            if !is_blank {
                let line = self.lines.last_line();
                self.closed = first_cell(line) == b"End";
                return Ok(Some((number, line)).filter(|_| !self.closed));
            }
        }
    }

    fn incomplete(&self, field: &'static str) -> DecodeError {
        DecodeError::SectionIncomplete { line: self.start, field }
    }
}

fn is_blank(line: &[u8]) -> bool {
    COMMA.split(line).all(<[u8]>::is_empty)
}

fn first_cell(line: &[u8]) -> &[u8] {
    COMMA.split(line).next().unwrap_or_default()
}

/// Appends the numbers of the remaining cells; NaN for a cell without one.
fn read_cells(
    cells: Fields<'_>,
    before: usize,
    line: u64,
    numbers: &mut Numbers,
    values: &mut Vec<f64>,
) -> Result<(), DecodeError> {
    for (position, cell) in cells.enumerate().skip(before) {
        values.push(numbers.read(cell, line, position)?);
    }
    Ok(())
}

/// The frames of Profile, Ranges and RawProfile.
fn read_frames(
    lines: &mut Lines<'_>,
    start: u64,
    numbers: &mut Numbers,
    gather: &mut Gather<'_>,
) -> Result<Labels, DecodeError> {
    let mut section = Section::new(lines, start, Announced::below(b"Frame Count"));
    let mut across = Vec::new();
    let (travel_at, axis_at) = loop {
        let Some((number, line)) = section.next_line()? else { return Err(section.incomplete("the header with Axis")) };
        let line = line.to_vec();
        let line = line.as_slice();
        section.announced.look(line);
        let position = |name: &[u8]| COMMA.split(line).position(|cell| cell == name);
        if let (b"Frame", Some(axis)) = (first_cell(line), position(b"Axis")) {
            let travel = position(b"Y").filter(|travel| *travel < axis);
            read_cells(COMMA.split(line), axis + 1, number, numbers, &mut across)?;
            break (travel, axis);
        }
    };
    let (mut row, mut heights, mut frame_of_x) = (0.0, Vec::new(), None);
    let (mut frames_count, mut newest_frame) = (0, None);
    while let Some((number, line)) = section.next_line()? {
        let cell = |position| COMMA.split(line).nth(position).unwrap_or_default();
        let frame = parse_number(cell(0)).filter(|frame| frame.is_finite());
        match cell(axis_at) {
            b"X" => {
                across.clear();
                read_cells(COMMA.split(line), axis_at + 1, number, numbers, &mut across)?;
                frame_of_x = Some(frame);
            }
            b"Z" => {
                if frame_of_x.is_some_and(|of_x| of_x != frame) {
                    return Err(section.incomplete("the X row of a frame"));
                }
                let travel = travel_at.and_then(|at| numbers.read(cell(at), number, at).ok());
                let travel = travel.filter(|travel| travel.is_finite());
                let travel = travel.ok_or(DecodeError::TravelMissing { line: number })?;
                heights.clear();
                read_cells(COMMA.split(line), axis_at + 1, number, numbers, &mut heights)?;
                push_row(gather, row, travel, &across, &heights)?;
                row += 1.0;
                // Several sensors give several rows of one frame.
                if frame.is_none() || newest_frame != frame {
                    frames_count += 1;
                    newest_frame = frame;
                }
            }
            // Intensity.
            _ => {}
        }
    }
    section.check_whole(frames_count, heights.len() < across.len())?;
    Ok(Labels::Row)
}

/// The grid of Part and Surface.
fn read_grid(
    lines: &mut Lines<'_>,
    start: u64,
    numbers: &mut Numbers,
    gather: &mut Gather<'_>,
) -> Result<Labels, DecodeError> {
    let mut section = Section::new(lines, start, Announced::below(b"Row Count"));
    let (mut across, mut heights, mut row, mut rows_count) = (Vec::new(), Vec::new(), 0.0, 0);
    loop {
        let Some((number, line)) = section.next_line()? else { return Err(section.incomplete("the row Y\\X")) };
        let line = line.to_vec();
        let line = line.as_slice();
        section.announced.look(line);
        if matches!(first_cell(line), b"Y\\X" | b"Y/X") {
            read_cells(COMMA.split(line), 1, number, numbers, &mut across)?;
            break;
        }
    }
    while let Some((number, line)) = section.next_line()? {
        let travel = numbers.read(first_cell(line), number, 0)?;
        if !travel.is_finite() {
            return Err(DecodeError::TravelMissing { line: number });
        }
        heights.clear();
        read_cells(COMMA.split(line), 1, number, numbers, &mut heights)?;
        push_row(gather, row, travel, &across, &heights)?;
        row += 1.0;
        rows_count += 1;
    }
    section.check_whole(rows_count, heights.len() < across.len())?;
    Ok(Labels::Row)
}

/// The rows of SurfacePointCloud.
fn read_triples(
    lines: &mut Lines<'_>,
    start: u64,
    numbers: &mut Numbers,
    gather: &mut Gather<'_>,
) -> Result<Labels, DecodeError> {
    let mut section = Section::new(lines, start, Announced::below(b"Point Count"));
    loop {
        let Some((_, line)) = section.next_line()? else { return Err(section.incomplete("the header X,Y,Z")) };
        let line = line.to_vec();
        let line = line.as_slice();
        section.announced.look(line);
        if COMMA.split(line).take(3).eq([&b"X"[..], b"Y", b"Z"]) {
            break;
        }
    }
    let mut points_count = 0;
    while let Some((number, line)) = section.next_line()? {
        let mut cells = COMMA.split(line).enumerate().map(|(position, cell)| numbers.read(cell, number, position));
        let ragged = || DecodeError::RaggedRow { line: number, expected: 3, found: 2, text: shorten(line) };
        let mut next = || cells.next().unwrap_or_else(|| Err(ragged()));
        let (across, travel, height) = (next()?, next()?, next()?);
        gather.push(0.0, [travel, across, height])?;
        points_count += 1;
    }
    section.check_whole(points_count, false)?;
    Ok(Labels::None)
}

fn push_row(
    gather: &mut Gather<'_>,
    row: f64,
    travel: f64,
    across: &[f64],
    heights: &[f64],
) -> Result<(), DecodeError> {
    across.iter().zip(heights).try_for_each(|(y, z)| gather.push(row, [travel, *y, *z]))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scan::decode::Limits;
    use crate::scan::{Columns, Stripe};

    const INFO: &str =
        "Info\nCSV Version,Sensor Count,XResolution\n2,1,0.1\nEnd\n\nDeviceInfo\nID,Model\n7,2350\nEnd\n";

    fn read(body: &str) -> Result<Cloud, DecodeError> {
        let text = format!("{INFO}{body}");
        let limits = Limits::default();
        decode(&mut text.as_bytes(), &Request::new(&limits))
    }

    #[test]
    fn every_section_gives_travel_as_x_and_height_as_z() {
        let head = "Frame,Source,Time,Encoder,Z Encoder,Inputs,Exposure,Y,Axis";
        let profile = format!(
            "Profile\nFrame Count,Column Count\n2,3\n\n{head},-1.0,0.0,1.0\n\
             1,Top,0,0,0,0,80,10.5,Z,5,,7\n1,Top,0,0,0,0,80,10.5,I,9,9,9\n2,Top,0,0,0,0,80,11,Z,,6,\nEnd\n"
        );
        let raw = format!(
            "RawProfile\nFrame Count,Column Count\n2,3\n{head},0,1,2\n\
             1,Top,0,0,0,0,80,10.5,X,-1,,1\n1,Top,0,0,0,0,80,10.5,Z,5,,7\n\
             2,Top,0,0,0,0,80,11,X,,0,\n2,Top,0,0,0,0,80,11,Z,,6,\nEnd\n"
        );
        let part = "Part\nFrame,Source,Row Count\n1,Top,2\nY\\X,-1,0,1\n10.5,5,,7\n11,,6,\nEnd\n".to_owned();
        for body in [profile, raw, part] {
            let cloud = read(&body).unwrap_or_else(|error| panic!("{body}: {error}"));
            let stripes = [Stripe { label: 0.0, x: 10.5, end: 2 }, Stripe { label: 1.0, x: 11.0, end: 3 }];
            assert_eq!((cloud.labels, cloud.missing_count, &*cloud.stripes), (Labels::Row, 3, &stripes[..]), "{body}");
            assert_eq!(cloud.columns, Columns::F64 { y: vec![-1.0, 1.0, 0.0], z: vec![5.0, 7.0, 6.0] });
        }
        let cloud = read("SurfacePointCloud\nFrame\n1\nX,Y,Z\n-1,10.5,5\n1,10.5,7\nEnd\n").expect("points");
        assert_eq!((cloud.stripes[0].x, cloud.columns.get(1)), (10.5, Some([1.0, 7.0])));
    }

    #[test]
    fn a_file_that_ends_before_its_announced_frames_is_truncated() {
        let head = "Frame,Time,Y,Axis,0,1";
        let profile =
            format!("Profile\nFrame Count,Column Count\n3,2\n\n{head}\n1,0,1,Z,5,6\n2,0,2,Z,5,6\n3,0,3,Z,5,6\nEnd\n");
        let raw =
            format!("RawProfile\nFrame Count\n2\n{head}\n1,0,1,X,0,1\n1,0,1,Z,5,6\n2,0,2,X,0,1\n2,0,2,Z,5,6\nEnd\n");
        let part = "Part\nFrame,Row Count\n1,3\nY\\X,0,1\n1,5,6\n2,5,6\n3,5,6\nEnd\n".to_owned();
        let points = "SurfacePointCloud\nPoint Count\n3\nX,Y,Z\n0,1,5\n0,2,5\n0,3,5\nEnd\n".to_owned();
        for whole in [profile, raw, part, points] {
            read(&whole).unwrap_or_else(|error| panic!("{whole}: {error}"));
            let without_end = whole.trim_end_matches("End\n");
            read(without_end).unwrap_or_else(|error| panic!("all announced frames are there: {error}"));
            let rows: Vec<_> = without_end.trim_end().split_inclusive('\n').collect();
            let (_, but_the_last) = rows.split_last().expect("rows");
            let cut = read(&but_the_last.concat()).expect_err("a row less");
            assert_eq!(cut.code(), "file_truncated", "{cut}");
            if !whole.starts_with("Surface") {
                let in_the_row = without_end.trim_end().trim_end_matches(",6");
                assert_eq!(read(in_the_row).expect_err("cut within a row").code(), "file_truncated", "{in_the_row}");
            }
        }
    }

    #[test]
    fn each_wrong_export_has_its_own_reason() {
        let head = "Frame,Time,Y,Axis";
        for (body, code) in [
            ("", "section_missing"),
            ("Profile\nFrame Count\n1\nEnd\n", "section_missing"),
            (&format!("Profile\n{head},0,1\n1,0,,Z,5,6\nEnd\n"), "travel_missing"),
            ("Profile\nFrame,Axis,0,1\n1,Z,5,6\nEnd\n", "travel_missing"),
            (&format!("Profile\n{head},0,1\n1,0,3,Z,5,b\nEnd\n"), "number_invalid"),
            (&format!("Profile\n{head},0,1\n1,0,3,Z,,\nEnd\n"), "no_points"),
            (&format!("RawProfile\n{head},0,1\n1,0,3,X,1,2\n2,0,3,Z,1,2\nEnd\n"), "section_missing"),
        ] {
            assert_eq!(read(body).expect_err("wrong").code(), code, "{body}");
        }
        let limits = Limits::default();
        let mut request = Request { unit: Some(Unit::Metre), ..Request::new(&limits) };
        assert_eq!(decode(&mut &b"Info\n"[..], &request).expect_err("unit").code(), "unit_conflict");
        request.unit = None;
        let old = decode(&mut &b"Info\nCSV Version,1\nEnd\n"[..], &request);
        assert_eq!(old.expect_err("version").code(), "format_unsupported");
        assert_eq!(decode(&mut &b"x,y\n"[..], &request).expect_err("other").code(), "format_mismatch");
    }
}
