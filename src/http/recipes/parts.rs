//! Which profiles belong to one part, as clients write and read it in a recipe.

use crate::estimation::{ByGap, PartRule, Window};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// Which profiles belong to one part: all of them (`"one"`), those between gaps, or those in windows along x.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
#[schema(as = PartRule, example = json!({"windows": [
    {"name": "moving", "x_min_mm": 0.0, "x_max_mm": 380.0, "nominal_radius_mm": 200.0},
    {"name": "fixed", "x_min_mm": 420.0, "x_max_mm": 800.0}
]}))]
pub enum PartsDocument {
    /// All of them.
    One,
    /// Those between two gaps; the parts are called `part_1`, `part_2`, … in order of x.
    ByGap(ByGapDocument),
    /// Those in a window, up to 16 of them in any order; they must not overlap.
    Windows(Vec<WindowDocument>),
}

/// Parts that are found by what lies between them.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields, default)]
#[schema(as = PartsByGap)]
pub struct ByGapDocument {
    /// A stretch of the rail at least this long without a profile that shows a part divides two parts; 20 mm, and in any
    /// case 2.5 times the usual distance between profiles.
    #[schema(exclusive_minimum = 0.0, maximum = 100000.0)]
    pub gap_min_mm: f64,
    /// How many parts there must be; another number is refused.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(minimum = 1, maximum = 16)]
    pub count: Option<u32>,
}

/// A part that is looked for in one place.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(as = PartWindow)]
pub struct WindowDocument {
    /// What the part is called; unique.
    #[schema(pattern = "^[A-Za-z][A-Za-z0-9_-]{0,31}$")]
    pub name: String,
    /// Least x in the rail frame, included.
    #[schema(minimum = -1_000_000.0, maximum = 1_000_000.0)]
    pub x_min_mm: f64,
    /// Largest x, included.
    #[schema(minimum = -1_000_000.0, maximum = 1_000_000.0)]
    pub x_max_mm: f64,
    /// The radius that the drawing of this part gives; that of the recipe or the request where nothing is said.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(exclusive_minimum = 0.0, maximum = 100000.0)]
    pub nominal_radius_mm: Option<f64>,
}

impl Default for ByGapDocument {
    fn default() -> Self {
        let ByGap { gap_min_mm, count } = ByGap::default();
        Self { gap_min_mm, count }
    }
}

impl From<PartsDocument> for PartRule {
    fn from(document: PartsDocument) -> Self {
        match document {
            PartsDocument::One => Self::One,
            PartsDocument::ByGap(ByGapDocument { gap_min_mm, count }) => Self::ByGap(ByGap { gap_min_mm, count }),
            PartsDocument::Windows(windows) => Self::Windows(windows.into_iter().map(Window::from).collect()),
        }
    }
}

impl From<PartRule> for PartsDocument {
    fn from(rule: PartRule) -> Self {
        match rule {
            PartRule::One => Self::One,
            PartRule::ByGap(ByGap { gap_min_mm, count }) => Self::ByGap(ByGapDocument { gap_min_mm, count }),
            PartRule::Windows(windows) => Self::Windows(windows.into_iter().map(WindowDocument::from).collect()),
        }
    }
}

impl From<WindowDocument> for Window {
    fn from(WindowDocument { name, x_min_mm, x_max_mm, nominal_radius_mm }: WindowDocument) -> Self {
        Self { name, x_min_mm, x_max_mm, nominal_radius_mm }
    }
}

impl From<Window> for WindowDocument {
    fn from(Window { name, x_min_mm, x_max_mm, nominal_radius_mm }: Window) -> Self {
        Self { name, x_min_mm, x_max_mm, nominal_radius_mm }
    }
}
