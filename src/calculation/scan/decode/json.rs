//! JSON profiles, `{"profiles": [{"x_mm": 0.0, "points": [[y, z], …]}]}`, read as a stream.
//!
//! A profile may have `"y_mm": […], "z_mm": […]` in place of `points`. `null` marks a missing point or coordinate. Other fields are
//! refused, so the nesting is limited to this structure; one profile is in memory at a time.

use super::error::DecodeError;
use super::gather::{Gather, Precision};
use super::hints::shorten;
use super::request::{Request, settle_unit};
use crate::scan::cloud::{Cloud, Labels, Unit};
use serde::Deserialize;
use serde::de::{DeserializeSeed, Deserializer, Error, MapAccess, SeqAccess, Visitor};
use serde_json::error::Category;
use std::fmt;
use std::io::{BufRead, Read};

/// Reads profiles. Their order in the file is their row.
pub(super) fn decode(reader: &mut dyn BufRead, request: &Request<'_>) -> Result<Cloud, DecodeError> {
    let unit = settle_unit(request.unit, Some(Unit::Millimetre))?;
    let gather = Gather::new(unit, Precision::Double, request.limits);
    let mut sink = Sink { gather, row: 0.0, refusal: None };
    let mut recent = Recent::new(reader)?;
    let mut source = serde_json::Deserializer::from_reader(&mut recent);
    let outcome = source.deserialize_map(Document(&mut sink)).and_then(|()| source.end());
    match (sink.refusal, outcome) {
        (Some(refusal), _) => Err(refusal),
        (None, Ok(())) => sink.gather.finish(Labels::Row),
        (None, Err(error)) => Err(refuse(error, recent)),
    }
}

/// The position and the kind of an error in the document.
fn refuse(error: serde_json::Error, recent: Recent<'_>) -> DecodeError {
    let (line, column) = (error.line(), error.column());
    match error.classify() {
        Category::Io => std::io::Error::from(error).into(),
        Category::Data => DecodeError::JsonShape { line, column, found: recent.word(line, column) },
        Category::Syntax | Category::Eof => DecodeError::JsonSyntax { line, column, found: recent.word(line, column) },
    }
}

/// Number of bytes that are remembered.
const RECENT_BYTES: usize = 64;

/// A reader that stores its last bytes, for a message about them.
struct Recent<'a> {
    inner: &'a mut dyn BufRead,
    last: [u8; RECENT_BYTES],
    count: usize,
    line: usize,
    /// Bytes before the current line, and before the previous one.
    line_starts: [usize; 2],
}

impl<'a> Recent<'a> {
    /// Starts after the byte order mark, if there is one.
    fn new(inner: &'a mut dyn BufRead) -> std::io::Result<Self> {
        if inner.fill_buf()?.starts_with(b"\xef\xbb\xbf") {
            inner.consume(3);
        }
        Ok(Self { inner, last: [0; RECENT_BYTES], count: 0, line: 1, line_starts: [0; 2] })
    }

    /// The word or text at a position, which may lie a few bytes back; empty if it lies farther back or at the end.
    fn word(self, line: usize, column: usize) -> String {
        let [current, above] = self.line_starts;
        let start = if line == self.line { current } else { above };
        let at = start.saturating_add(column).saturating_sub(1);
        let first = self.count.saturating_sub(RECENT_BYTES);
        let recent: Vec<u8> = (first..self.count).filter_map(|at| self.last.get(at % RECENT_BYTES).copied()).collect();
        let behind = self.inner.fill_buf().unwrap_or_default();
        let bytes: Vec<u8> = recent.iter().chain(behind.iter().take(RECENT_BYTES)).copied().collect();
        let Some(at) = at.checked_sub(first).filter(|at| *at < bytes.len()) else { return String::new() };
        let (before, from) = bytes.split_at(at);
        let is_part = |byte: &u8| !byte.is_ascii_whitespace() && !b",:[]{}\"".contains(byte);
        let is_text = from.first() == Some(&b'"');
        let start = before.iter().rposition(|byte| if is_text { *byte == b'"' } else { !is_part(byte) });
        let start = start.map_or(0, |start| start + 1);
        // A text ends before its quote; a single character that is not part of a word is shown itself.
        let length = match from.first() {
            Some(first) if is_part(first) => from.iter().position(|byte| !is_part(byte)).unwrap_or(from.len()),
            Some(b'"') if start < at => 0,
            _ => 1,
        };
        shorten(bytes.get(start..at + length).unwrap_or_default())
    }
}

impl Read for Recent<'_> {
    fn read(&mut self, into: &mut [u8]) -> std::io::Result<usize> {
        let count = self.inner.read(into)?;
        for byte in into.get(..count).unwrap_or_default() {
            if let Some(place) = self.last.get_mut(self.count % RECENT_BYTES) {
                *place = *byte;
            }
            self.count += 1;
            if *byte == b'\n' {
                let [current, _] = self.line_starts;
                (self.line, self.line_starts) = (self.line + 1, [self.count, current]);
            }
        }
        Ok(count)
    }
}

/// The target of the points while the document is visited. serde errors carry only text, so ours is stored here.
struct Sink<'a> {
    gather: Gather<'a>,
    row: f64,
    refusal: Option<DecodeError>,
}

/// Visits `{"profiles": […]}`.
struct Document<'s, 'a>(&'s mut Sink<'a>);
/// Visits `[{…}, …]`.
struct Profiles<'s, 'a>(&'s mut Sink<'a>);

impl<'de> Visitor<'de> for Document<'_, '_> {
    type Value = ();

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("an object with profiles")
    }

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<(), A::Error> {
        #[derive(Deserialize)]
        #[serde(rename_all = "snake_case")]
        enum Key {
            Profiles,
        }
        let Some(Key::Profiles) = map.next_key()? else { return Err(A::Error::missing_field("profiles")) };
        map.next_value_seed(Profiles(self.0))?;
        match map.next_key::<Key>()? {
            None => Ok(()),
            Some(Key::Profiles) => Err(A::Error::duplicate_field("profiles")),
        }
    }
}

impl<'de> DeserializeSeed<'de> for Profiles<'_, '_> {
    type Value = ();

    fn deserialize<D: Deserializer<'de>>(self, deserializer: D) -> Result<(), D::Error> {
        deserializer.deserialize_seq(self)
    }
}

impl<'de> Visitor<'de> for Profiles<'_, '_> {
    type Value = ();

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("an array of profiles")
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut seq: A) -> Result<(), A::Error> {
        let sink = self.0;
        while let Some(profile) = seq.next_element::<Profile>()? {
            let Some((y, z)) = profile.columns() else { return Err(A::Error::custom("points, or y_mm and z_mm")) };
            if y.is_empty() {
                sink.gather.push_blank(sink.row, profile.x_mm);
            }
            for (y, z) in y.iter().zip(z) {
                if let Err(refusal) = sink.gather.push(sink.row, [profile.x_mm, *y, *z]) {
                    sink.refusal = Some(refusal);
                    return Err(A::Error::custom("refused"));
                }
            }
            sink.row += 1.0;
        }
        Ok(())
    }
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Profile {
    x_mm: f64,
    points: Option<Points>,
    y_mm: Option<Numbers>,
    z_mm: Option<Numbers>,
}

impl Profile {
    /// y and z, given together or separately, of equal length.
    fn columns(&self) -> Option<(&[f64], &[f64])> {
        let (y, z) = match (&self.points, &self.y_mm, &self.z_mm) {
            (Some(Points { y, z }), None, None) => (y, z),
            (None, Some(Numbers(y)), Some(Numbers(z))) => (y, z),
            _ => return None,
        };
        (y.len() == z.len()).then_some((y, z))
    }
}

/// `[1.0, null, …]`; NaN for null.
#[derive(Default)]
struct Numbers(Vec<f64>);

/// `[[y, z], null, …]`; NaN for null.
#[derive(Default)]
struct Points {
    y: Vec<f64>,
    z: Vec<f64>,
}

// Written by hand, because the derived implementation would take five times the memory while a profile is read.
impl<'de> Deserialize<'de> for Numbers {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_seq(NumbersVisitor)
    }
}

struct NumbersVisitor;

impl<'de> Visitor<'de> for NumbersVisitor {
    type Value = Numbers;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("an array of numbers")
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut seq: A) -> Result<Numbers, A::Error> {
        let mut numbers = Numbers::default();
        while let Some(number) = seq.next_element::<Option<f64>>()? {
            numbers.0.push(number.unwrap_or(f64::NAN));
        }
        Ok(numbers)
    }
}

impl<'de> Deserialize<'de> for Points {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_seq(PointsVisitor)
    }
}

struct PointsVisitor;

impl<'de> Visitor<'de> for PointsVisitor {
    type Value = Points;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("an array of [y, z]")
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut seq: A) -> Result<Points, A::Error> {
        let mut points = Points::default();
        while let Some(point) = seq.next_element::<Option<Pair>>()? {
            let Pair(y, z) = point.unwrap_or(Pair(f64::NAN, f64::NAN));
            points.y.push(y);
            points.z.push(z);
        }
        Ok(points)
    }
}

/// `[y, z]`; NaN for null. It is not an array of two, because serde_json then reports three elements as a "syntax" error.
struct Pair(f64, f64);

impl<'de> Deserialize<'de> for Pair {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_seq(PairVisitor)
    }
}

struct PairVisitor;

impl<'de> Visitor<'de> for PairVisitor {
    type Value = Pair;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("[y, z]")
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut seq: A) -> Result<Pair, A::Error> {
        let mut next = || seq.next_element::<Option<f64>>();
        let (Some(y), Some(z), None) = (next()?, next()?, next()?) else {
            return Err(A::Error::custom("two numbers"));
        };
        Ok(Pair(y.unwrap_or(f64::NAN), z.unwrap_or(f64::NAN)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scan::decode::Limits;
    use crate::scan::{Columns, Stripe};

    fn read_in(text: &str, unit: Option<Unit>) -> Result<Cloud, DecodeError> {
        decode(&mut text.as_bytes(), &Request { unit, ..Request::new(&Limits::default()) })
    }

    #[test]
    fn points_and_columns_in_any_order_are_read_and_null_is_missing() {
        for text in [
            r#"{"profiles":[{"x_mm":1.5,"points":[[1,2],null,[3,4],[5,null]]},{"x_mm":2,"points":[[5,6]]}]}"#,
            r#"{"profiles":[{"points":[[1,2],null,[3,4],null],"x_mm":1.5},{"x_mm":2,"points":[[5,6]]}]}"#,
            r#"{"profiles":[{"z_mm":[2,0,4,null],"y_mm":[1,null,3,5],"x_mm":1.5},{"x_mm":2,"points":[[5,6]]}]}"#,
        ] {
            let cloud = read_in(text, None).unwrap_or_else(|error| panic!("{text}: {error}"));
            let stripes = [Stripe { label: 0.0, x: 1.5, end: 2 }, Stripe { label: 1.0, x: 2.0, end: 3 }];
            assert_eq!((cloud.missing_count, cloud.labels, &*cloud.stripes), (2, Labels::Row, &stripes[..]));
            assert_eq!(cloud.columns, Columns::F64 { y: vec![1.0, 3.0, 5.0], z: vec![2.0, 4.0, 6.0] });
        }
    }

    #[test]
    fn each_wrong_document_has_its_own_reason() {
        let deep = format!("{{\"profiles\":{}", "[".repeat(100_000));
        for (text, code) in [
            (r#"{"profiles":[{"x_mm":0,"points":[],"unit":"m"}]}"#, "json_shape"),
            (r#"{"profiles":[],"unit":"m"}"#, "json_shape"),
            (r#"{"profiles":[{"x_mm":0,"points":[[1,2]],"y_mm":[1]}]}"#, "json_shape"),
            (r#"{"profiles":[{"x_mm":0,"y_mm":[1],"z_mm":[]}]}"#, "json_shape"),
            (r#"{"profiles":[{"points":[[1,2]]}]}"#, "json_shape"),
            (r#"{"profiles":[{"x_mm":0,"points":[[1,2,3]]}]}"#, "json_shape"),
            (r#"{"profiles":[{"x_mm":0,"points":[[1,2"#, "json_syntax"),
            (r#"{"profiles":[]} more"#, "json_syntax"),
            (r#"{"profiles":[]}"#, "no_points"),
            (r#"{"profiles":[{"x_mm":0,"points":[[1,1e308]]}]}"#, "coordinate_out_of_range"),
            (deep.as_str(), "json_shape"),
        ] {
            assert_eq!(read_in(text, None).expect_err("wrong").code(), code, "{text:.80}");
        }
        let error = read_in(r#"{"profiles":[]}"#, Some(Unit::Metre)).expect_err("fixed unit");
        assert_eq!(error.code(), "unit_conflict");
    }

    #[test]
    fn a_byte_order_mark_is_skipped() {
        let text = "\u{feff}{\"profiles\":[{\"x_mm\":1,\"points\":[[2,3]]}]}";
        assert_eq!(read_in(text, None).expect("reads").points().collect::<Vec<_>>(), [[1.0, 2.0, 3.0]]);
    }

    #[test]
    fn the_error_of_an_invalid_document_shows_the_position() {
        for (value, hint) in
            [("NaN", "write null"), ("-Infinity", "write null"), ("nan", "write null"), ("1.5.2", "JSON")]
        {
            let text = format!("{{\"profiles\":[{{\"x_mm\":0,\"points\":[[1,{value}], [2,3]]}}]}}");
            let error = read_in(&text, None).expect_err("no JSON").to_string();
            assert!(error.contains(&format!("{value:?}")) && error.contains(hint), "{error}");
        }
        let error = read_in(r#"{"profiles":[{"x_mm":"0,5","points":[[1,2]]}]}"#, None).expect_err("a text").to_string();
        assert!(error.contains("column 26") && error.contains("0,5"), "{error}");
    }
}
