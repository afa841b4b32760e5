//! Units of length that a scan may be declared in; all become millimetres while points are gathered.

use serde::{Deserialize, Serialize};
use std::fmt;

/// The unit of a file's coordinates.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum Unit {
    /// `mm`
    #[serde(rename = "mm")]
    Millimetre,
    /// `m`
    #[serde(rename = "m")]
    Metre,
    /// `um`
    #[serde(rename = "um")]
    Micrometre,
    /// `inch`
    #[serde(rename = "inch")]
    Inch,
}

impl Unit {
    /// Every unit, in the order in which messages list them.
    pub const ALL: [Self; 4] = [Self::Millimetre, Self::Metre, Self::Micrometre, Self::Inch];

    /// The name used in requests and records.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Millimetre => "mm",
            Self::Metre => "m",
            Self::Micrometre => "um",
            Self::Inch => "inch",
        }
    }

    /// The unit of a name, whatever its case; `µm`, `in` and the written-out names too.
    #[must_use]
    pub fn from_name(name: &str) -> Option<Self> {
        match name.trim().to_lowercase().as_str() {
            "mm" | "millimetre" | "millimetres" | "millimeter" | "millimeters" => Some(Self::Millimetre),
            "m" | "metre" | "metres" | "meter" | "meters" => Some(Self::Metre),
            // The micro sign and the Greek letter look alike.
            "um" | "\u{b5}m" | "\u{3bc}m" | "micrometre" | "micrometres" | "micrometer" | "micrometers" | "micron"
            | "microns" => Some(Self::Micrometre),
            "in" | "in." | "inch" | "inches" | "zoll" | "\"" | "''" | "\u{2033}" | "\u{201d}" => Some(Self::Inch),
            _ => None,
        }
    }

    /// Millimetres in one of this unit.
    #[must_use]
    pub fn in_mm(self) -> f64 {
        match self {
            Self::Millimetre => 1.0,
            Self::Metre => 1000.0,
            Self::Micrometre => 0.001,
            Self::Inch => 25.4,
        }
    }
}

impl fmt::Display for Unit {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_unit_is_found_by_its_name_and_stored_by_it() {
        for unit in Unit::ALL {
            assert_eq!(Unit::from_name(unit.name()), Some(unit));
            assert_eq!(serde_json::to_value(unit).expect("writes"), unit.name());
        }
        assert_eq!(Unit::from_name(" \u{b5}m"), Some(Unit::Micrometre));
        assert_eq!(Unit::from_name("furlong"), None);
    }
}
