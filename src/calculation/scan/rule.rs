//! The rule by which profiles are separated, as a caller writes it: `column=frame`, `row`, `x_pitch_mm=0.5`, `x_value`.

use serde::{Deserialize, Serialize};
use std::fmt;

/// The requested rule for the points of one profile.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ProfileRule {
    /// Points that share a value of the profile column: the named one, or the one that the reader recognised.
    Column(Option<String>),
    /// Rows of organised data (PCD with HEIGHT > 1, NPY of three dimensions, JSON profiles, Gocator frames).
    Row,
    /// Slabs of this thickness along x, mm; `None` chooses one from the cloud.
    XPitch(Option<f64>),
    /// Points that share the same x.
    XValue,
}

/// Why a text is not a rule.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum RuleError {
    /// Its first word is not one of the rules.
    #[error("{text:?} is no profile rule; use column, column=NAME, row, x_pitch_mm, x_pitch_mm=NUMBER or x_value")]
    Unknown {
        /// The text, shortened.
        text: String,
    },
    /// The thickness of the slabs is not a positive number.
    #[error("x_pitch_mm must be a number above 0, e.g. x_pitch_mm=0.5")]
    Pitch,
}

impl RuleError {
    /// A stable name of the reason, at most 32 characters.
    #[must_use]
    pub fn code(&self) -> &'static str {
        match self {
            Self::Unknown { .. } => "profile_rule_unknown",
            Self::Pitch => "pitch_invalid",
        }
    }
}

impl ProfileRule {
    /// Parses the output of [`fmt::Display`]; `:` may replace `=`.
    ///
    /// # Errors
    /// [`RuleError`] if the text is not a rule.
    pub fn parse(text: &str) -> Result<Self, RuleError> {
        let text = text.trim();
        let (word, value) = match text.split_once(['=', ':']) {
            Some((word, value)) => (word.trim(), Some(value.trim()).filter(|value| !value.is_empty())),
            None => (text, None),
        };
        match (word, value) {
            ("column", name) => Ok(Self::Column(name.map(str::to_owned))),
            ("row", None) => Ok(Self::Row),
            ("x_value", None) => Ok(Self::XValue),
            ("x_pitch_mm", None) => Ok(Self::XPitch(None)),
            ("x_pitch_mm", Some(pitch)) => {
                let pitch = pitch.parse().ok().filter(|pitch: &f64| pitch.is_finite() && *pitch > 0.0);
                pitch.map(|pitch| Self::XPitch(Some(pitch))).ok_or(RuleError::Pitch)
            }
            _ => Err(RuleError::Unknown { text: text.chars().take(40).collect() }),
        }
    }
}

impl std::str::FromStr for ProfileRule {
    type Err = RuleError;

    fn from_str(text: &str) -> Result<Self, RuleError> {
        Self::parse(text)
    }
}

impl fmt::Display for ProfileRule {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Column(Some(name)) => write!(f, "column={name}"),
            Self::Column(None) => f.write_str("column"),
            Self::Row => f.write_str("row"),
            Self::XPitch(Some(pitch)) => write!(f, "x_pitch_mm={pitch}"),
            Self::XPitch(None) => f.write_str("x_pitch_mm"),
            Self::XValue => f.write_str("x_value"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_formatted_rule_is_parsed_unchanged() {
        for rule in [
            ProfileRule::Column(None),
            ProfileRule::Column(Some("frame no".to_owned())),
            ProfileRule::Row,
            ProfileRule::XPitch(None),
            ProfileRule::XPitch(Some(0.25)),
            ProfileRule::XValue,
        ] {
            assert_eq!(ProfileRule::parse(&rule.to_string()), Ok(rule.clone()));
        }
        assert_eq!(ProfileRule::parse(" x_pitch_mm : 0.5 "), Ok(ProfileRule::XPitch(Some(0.5))));
    }

    #[test]
    fn an_invalid_rule_is_refused() {
        for text in ["", "gap", "row=3", "x_value=1", "Row"] {
            assert_eq!(ProfileRule::parse(text).expect_err("no rule").code(), "profile_rule_unknown", "{text}");
        }
        for text in ["x_pitch_mm=0", "x_pitch_mm=-1", "x_pitch_mm=nan", "x_pitch_mm=wide"] {
            assert_eq!(ProfileRule::parse(text), Err(RuleError::Pitch), "{text}");
        }
    }
}
