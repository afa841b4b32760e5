//! The part of a file that a message shows, and the remedy that it states.

use std::fmt;

/// Characters of the file that a message shows.
const SHOWN_MAX: usize = 40;

/// Text of a file for a message: readable and shortened.
pub(super) fn shorten(bytes: &[u8]) -> String {
    let start = bytes.get(..bytes.len().min(4 * SHOWN_MAX)).unwrap_or_default();
    let text = String::from_utf8_lossy(start);
    text.chars().filter(|c| !c.is_control()).take(SHOWN_MAX).collect()
}

/// The remedy for a cell that is not a number.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum NumberHint {
    /// It has a character that looks like a minus.
    Minus,
    /// It has a separator between groups of digits.
    Thousands,
    /// A unit follows the number.
    Unit,
    /// It is a word.
    Word,
    /// None of these.
    Other,
}

impl NumberHint {
    /// The hint for a text.
    pub(super) fn of(text: &str) -> Self {
        let mut characters = text.trim_start_matches(['+', '-']).chars();
        let first = characters.next().unwrap_or(' ');
        if text.contains(['\u{2212}', '\u{2010}', '\u{2011}', '\u{2013}', '\u{2014}']) {
            Self::Minus
        } else if !first.is_ascii_digit() && first != '.' && first != ',' {
            if first.is_alphabetic() { Self::Word } else { Self::Other }
        } else if text.chars().all(|c| c.is_ascii_digit() || "+-.,'_ \u{a0}\u{2019}\u{202f}".contains(c)) {
            Self::Thousands
        } else if text.ends_with(|c: char| c.is_alphabetic() || c == '"' || c == ']') {
            Self::Unit
        } else {
            Self::Other
        }
    }
}

impl fmt::Display for NumberHint {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Minus => "write a minus as the - of the keyboard (not as \u{2212} or a dash)",
            Self::Thousands => {
                "write numbers without thousands separators, or declare the sign before decimals: decimal=point or \
                 decimal=comma"
            }
            Self::Unit => "write the number alone and its unit in the header, e.g. x_mm",
            Self::Word => "remove a line that is not a point; leave the cell empty if the point is missing",
            Self::Other => "leave the cell empty if the point is missing",
        })
    }
}

/// The pitches that determine the positions of the cells of a matrix.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Pitches {
    /// The first column increases evenly and is y, so only the positions of the profiles are missing.
    OfProfiles,
    /// The positions of rows and columns are missing.
    Both,
}

impl Pitches {
    pub(super) const fn text(self) -> &'static str {
        match self {
            Self::OfProfiles => {
                "x_pitch_mm, the distance between its profiles: its first column is taken as y, each other column as a profile"
            }
            Self::Both => {
                "x_pitch_mm, the distance between its profiles, and y_pitch_mm, that between the points of one; a row is a \
                 profile, or with profile_by=column a column; a first column of y needs x_pitch_mm alone, one of x \
                 y_pitch_mm alone"
            }
        }
    }

    /// Names of the parameters.
    #[must_use]
    pub const fn names(self) -> &'static [&'static str] {
        match self {
            Self::OfProfiles => &["x_pitch_mm"],
            Self::Both => &["x_pitch_mm", "y_pitch_mm"],
        }
    }
}

/// The remedy for text that is not JSON.
pub(super) fn json_hint(found: &str) -> &'static str {
    let word = found.trim_start_matches(['+', '-']).to_ascii_lowercase();
    match word.as_str() {
        "nan" | "inf" | "infinity" => "write null for a missing point",
        "" => "send the whole document",
        _ => "send a JSON document",
    }
}
