//! Which of the forms that an answer can have the client likes best.

use super::problem::{Code, Problem};
use axum::http::{HeaderMap, header};

/// The offered media type that the client likes best; the first of equals, and the first where it says nothing.
///
/// # Errors
/// [`Code::NotAcceptable`] where it likes none.
pub(super) fn choose<T: Copy>(headers: &HeaderMap, offered: &[(&'static str, T)]) -> Result<T, Problem> {
    let accept: Vec<&str> = headers.get_all(header::ACCEPT).iter().filter_map(|value| value.to_str().ok()).collect();
    let ranges: Vec<Range<'_>> = accept.iter().flat_map(|line| line.split(',')).filter_map(Range::parse).collect();
    let mut best: Option<(f32, T)> = None;
    for &(media_type, value) in offered {
        let quality = if ranges.is_empty() { 1.0 } else { quality(&ranges, media_type) };
        if quality > best.map_or(0.0, |(quality, _)| quality) {
            best = Some((quality, value));
        }
    }
    best.map(|(_, value)| value).ok_or_else(|| {
        let names: Vec<_> = offered.iter().map(|(name, _)| *name).collect();
        Problem::new(Code::NotAcceptable, format!("the answer can be had as {}; accept one of them", names.join(", ")))
            .with("offered", names)
    })
}

struct Range<'a> {
    kind: &'a str,
    subtype: &'a str,
    quality: f32,
}

impl<'a> Range<'a> {
    fn parse(text: &'a str) -> Option<Self> {
        let mut parts = text.split(';');
        let (kind, subtype) = parts.next()?.trim().split_once('/')?;
        let quality = parts.find_map(|part| part.trim().strip_prefix("q=")?.parse().ok()).unwrap_or(1.0);
        Some(Self { kind, subtype, quality })
    }

    /// How closely it names a media type; `None` where it does not.
    fn closeness(&self, media_type: &str) -> Option<u8> {
        let (kind, subtype) = media_type.split_once('/')?;
        match (self.kind, self.subtype) {
            ("*", "*") => Some(0),
            (k, "*") if k.eq_ignore_ascii_case(kind) => Some(1),
            (k, s) if k.eq_ignore_ascii_case(kind) && s.eq_ignore_ascii_case(subtype) => Some(2),
            _ => None,
        }
    }
}

/// The quality of the range that names the type most closely; 0 where none does.
fn quality(ranges: &[Range<'_>], media_type: &str) -> f32 {
    let named = ranges.iter().filter_map(|range| Some((range.closeness(media_type)?, range.quality)));
    named.max_by_key(|(closeness, _)| *closeness).map_or(0.0, |(_, quality)| quality)
}

#[cfg(test)]
mod tests {
    use super::*;
    use axum::http::HeaderValue;

    fn chosen(accept: Option<&'static str>) -> Result<u8, Code> {
        let mut headers = HeaderMap::new();
        headers.extend(accept.map(|text| (header::ACCEPT, HeaderValue::from_static(text))));
        choose(&headers, &[("application/json", 1), ("text/csv", 2)]).map_err(|problem| problem.code())
    }

    #[test]
    fn the_closest_range_decides_and_its_quality_ranks() {
        assert_eq!(chosen(None), Ok(1));
        assert_eq!(chosen(Some("*/*")), Ok(1));
        assert_eq!(chosen(Some("text/csv")), Ok(2));
        assert_eq!(chosen(Some("text/*;q=0.9, application/json;q=0.1")), Ok(2));
        assert_eq!(chosen(Some("*/*, application/json;q=0")), Ok(2));
        assert_eq!(chosen(Some("image/png")), Err(Code::NotAcceptable));
    }
}
