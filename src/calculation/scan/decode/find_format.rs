//! Finds the format of a file: the declaration of the client has the highest priority, then the first bytes, then the file name.

use super::error::DecodeError;
use super::format::Format;
use super::lines::{ascii_of, has_mark, is_fill};

impl Format {
    /// The format that the first bytes (a few hundred are enough) show; other text is taken for [`Format::Csv`].
    #[must_use]
    pub fn sniff(head: &[u8]) -> Option<Self> {
        Self::from_magic(head).or_else(|| is_text(head).then_some(Self::Csv))
    }

    /// The format of first bytes that no other format has.
    fn from_magic(head: &[u8]) -> Option<Self> {
        let utf16 = has_mark(head).then(|| ascii_of(head));
        let head = utf16.as_deref().unwrap_or(head);
        let text = head.strip_prefix(b"\xef\xbb\xbf").unwrap_or(head).trim_ascii_start();
        let starts = |magic: &[u8]| head.starts_with(magic);
        if starts(b"ply\n") || starts(b"ply\r") {
            Some(Self::Ply)
        } else if starts(b"# .PCD") || (starts(b"VERSION") && contains(head, b"FIELDS")) {
            Some(Self::Pcd)
        } else if starts(b"\x93NUMPY") {
            Some(Self::Npy)
        } else if starts(b"PK\x03\x04") {
            Some(Self::Npz)
        } else if text.first() == Some(&b'{') {
            Some(Self::Json)
        } else if text.starts_with(b"Info") && contains(text, b"CSV Version") {
            Some(Self::GocatorCsv)
        } else {
            // Among these formats only tables are also written in UTF-16.
            utf16.is_some().then_some(Self::Csv)
        }
    }

    /// Whether a declaration of `self` is compatible with the format `found` in the bytes: Gocator's tables are CSV as well.
    fn admits(self, found: Self) -> bool {
        self == found || (self == Self::Csv && found == Self::GocatorCsv)
    }
}

/// Number of bytes at the start of a text file within which a line ends.
pub(super) const LINE_BYTES: usize = 256;

/// Whether the line ends of a file were removed, as `curl -d @file` does (together with all NULs), before the file could be read.
pub(super) fn has_lost_line_ends(head: &[u8]) -> bool {
    let has_line_end = head.iter().any(|byte| matches!(byte, b'\r' | b'\n'));
    let is_text_header = |start: &[u8]| head.starts_with(start) && head.len() >= LINE_BYTES && !has_line_end;
    head.starts_with(b"plyformat ")
        || is_text_header(b"# .PCD")
        || is_text_header(b"VERSION")
        || (head.starts_with(b"\x93NUMPY") && head.get(7).is_some_and(|minor| *minor != 0))
}

pub(super) fn contains(bytes: &[u8], part: &[u8]) -> bool {
    bytes.windows(part.len()).any(|window| window == part)
}

/// Whether bytes could be text of an ASCII-compatible encoding.
pub(super) fn is_text(head: &[u8]) -> bool {
    // Some programs pad the file after the text.
    let end = head.iter().rposition(|byte| !is_fill(*byte)).map_or(0, |last| last + 1);
    let head = head.get(..end).unwrap_or_default();
    !head.is_empty() && head.iter().all(|&byte| byte >= 0x20 || matches!(byte, b'\t' | b'\n' | b'\r' | 0x0c))
}

/// The declarations about a file besides its bytes.
#[derive(Debug, Clone, Copy, Default)]
pub struct FormatClaims<'a> {
    /// Explicitly named by the caller.
    pub parameter: Option<Format>,
    /// The Content-Type of the request.
    pub media_type: Option<&'a str>,
    /// The name of the file, for its extension.
    pub file_name: Option<&'a str>,
}

/// Determines the format of a file from the declarations and from its first bytes.
///
/// A media type that means "some bytes" or "some text" is ignored, and so is an unknown one.
///
/// # Errors
/// [`DecodeError::Empty`] without a byte, [`DecodeError::FormatConflict`] if a declaration contradicts the other or the bytes,
/// [`DecodeError::UnknownFormat`] if nothing shows the format.
pub fn find_format(claims: &FormatClaims<'_>, head: &[u8]) -> Result<Format, DecodeError> {
    if head.is_empty() {
        return Err(DecodeError::Empty);
    }
    if has_lost_line_ends(head) {
        return Err(DecodeError::LinesStripped);
    }
    let sent_as = claims.media_type.and_then(Format::from_media_type);
    let declared = match (claims.parameter, sent_as) {
        (Some(named), Some(sent)) if !named.admits(sent) && !sent.admits(named) => {
            return Err(DecodeError::FormatConflict { declared: named, found: sent });
        }
        (named, sent) => named.or(sent),
    };
    match (declared, Format::from_magic(head)) {
        (Some(declared), Some(found)) if declared.admits(found) => Ok(found),
        (Some(declared), Some(found)) => Err(DecodeError::FormatConflict { declared, found }),
        (Some(declared), None) => Ok(declared),
        (None, Some(found)) => Ok(found),
        (None, None) => claims
            .file_name
            .and_then(|name| name.rsplit_once('.'))
            .and_then(|(_, extension)| Format::from_name(extension))
            .or_else(|| Format::sniff(head))
            .ok_or(DecodeError::UnknownFormat),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sent_as(media_type: &str) -> FormatClaims<'_> {
        FormatClaims { media_type: Some(media_type), ..FormatClaims::default() }
    }

    #[test]
    fn every_format_is_found_by_name_and_media_type() {
        for format in Format::ALL {
            assert_eq!(Format::from_name(format.name()), Some(format));
            assert_eq!(Format::from_media_type(format.media_type()), Some(format));
            assert_eq!(serde_json::to_value(format).expect("writes"), format.name());
        }
    }

    #[test]
    fn the_bytes_decide_if_the_media_type_is_unspecific() {
        for silent in ["application/octet-stream", "text/plain; charset=utf-8", "application/x-www-form-urlencoded"] {
            assert_eq!(find_format(&sent_as(silent), b"ply\nformat").ok(), Some(Format::Ply));
            assert_eq!(find_format(&sent_as(silent), b"1,2,3\n").ok(), Some(Format::Csv));
            assert_eq!(find_format(&sent_as(silent), b"Info\nCSV Version\n2").ok(), Some(Format::GocatorCsv));
        }
        assert_eq!(find_format(&sent_as("text/csv"), b"Info\nCSV Version\n2").ok(), Some(Format::GocatorCsv));
    }

    #[test]
    fn a_contradiction_is_refused_with_both_names() {
        let error = find_format(&sent_as("application/x-ply"), b"\x93NUMPY\x01\x00").expect_err("conflict");
        assert!(error.to_string().contains("ply") && error.to_string().contains("npy"), "{error}");
        let both = FormatClaims { parameter: Some(Format::Pcd), ..sent_as("application/json") };
        assert_eq!(find_format(&both, b"# .PCD v0.7").expect_err("conflict").code(), "format_conflict");
    }

    #[test]
    fn the_extension_has_the_lowest_priority() {
        let named = |file_name| FormatClaims { file_name: Some(file_name), ..FormatClaims::default() };
        assert_eq!(find_format(&named("a.ply"), b"\x93NUMPY\x01\x00").ok(), Some(Format::Npy));
        for table in ["a.b.XYZ", "a.ds", "a.pts", "a.asc", "a.txt", "a.tsv"] {
            assert_eq!(find_format(&named(table), b"\x80\x81").ok(), Some(Format::Csv), "{table}");
        }
        let unknown = find_format(&named("a.stl"), b"\x00\x01").expect_err("unknown").to_string();
        assert!(Format::ALL.iter().all(|format| unknown.contains(format.name())), "{unknown}");
    }

    #[test]
    fn files_whose_line_ends_were_removed_are_recognised() {
        let claims = sent_as("application/x-www-form-urlencoded");
        let pcd = format!("# .PCD v0.7VERSION 0.7FIELDS x y z{}", " 1 2 3".repeat(60));
        for head in [&b"plyformat ascii 1.0element vertex 3"[..], pcd.as_bytes(), b"\x93NUMPY\x01v{'descr': '<f8'"] {
            assert_eq!(find_format(&claims, head).expect_err("stripped").code(), "line_ends_missing");
        }
        assert_eq!(find_format(&claims, b"\x93NUMPY\x01\x00v\x00{'descr'").ok(), Some(Format::Npy));
    }

    #[test]
    fn a_text_padded_with_nul_is_a_text() {
        assert_eq!(Format::sniff(b"1,2,3\n\0\0\0"), Some(Format::Csv));
        assert_eq!(Format::sniff(b"1,2\0,3\n"), None);
        assert_eq!(Format::sniff(b"\0\0"), None);
    }

    #[test]
    fn utf_16_is_recognised_by_its_mark() {
        let utf16 = |text: &str| {
            [&b"\xff\xfe"[..], &text.encode_utf16().flat_map(u16::to_le_bytes).collect::<Vec<_>>()].concat()
        };
        let none = FormatClaims::default();
        for (text, format) in [
            ("x,y,z\n1,2,3\n", Format::Csv),
            ("{\"profiles\"", Format::Json),
            ("Info\nCSV Version\n2", Format::GocatorCsv),
        ] {
            assert_eq!(find_format(&none, &utf16(text)).ok(), Some(format), "{text}");
        }
    }
}
