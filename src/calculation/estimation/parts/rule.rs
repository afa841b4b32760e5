//! The rule by which a scan is divided into several parts, and its checks.
//!
//! In a recipe: `"one"`, `{"by_gap": {"gap_min_mm": 20, "count": 2}}` or `{"windows": [{"name": …, "x_min_mm": …, …}]}`.

use crate::estimation::settings::{SettingError, Settings};
use serde::{Deserialize, Serialize};

/// Most parts of one scan.
pub const PARTS_MAX: usize = 16;
/// Longest name of a part.
const NAME_CHARACTERS_MAX: usize = 32;
/// Largest x of any rail, mm.
const X_MAX_MM: f64 = 1e6;

/// Which profiles belong to one part.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum PartRule {
    /// All profiles.
    #[default]
    One,
    /// Those between two gaps; the parts are named `part_1`, `part_2`, … in order of x.
    ByGap(ByGap),
    /// Those in a window, in any order.
    Windows(Vec<Window>),
}

/// Parts that are separated by gaps.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ByGap {
    /// A stretch of the rail at least this long without a profile that shows a part separates two parts.
    pub gap_min_mm: f64,
    /// Required number of parts; 1 to [`PARTS_MAX`] by default.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub count: Option<u32>,
}

/// A part within a window of x.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Window {
    /// The name of the part.
    pub name: String,
    /// Least x, included.
    pub x_min_mm: f64,
    /// Largest x, included; if the next window begins there, a profile at the bound belongs to this one.
    pub x_max_mm: f64,
    /// The nominal radius of this part from the drawing; that of the settings by default.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub nominal_radius_mm: Option<f64>,
}

/// Why a rule cannot be used.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum PartsError {
    /// A gap that is not a valid length.
    #[error("by_gap.gap_min_mm must be a length above 0 and at most 100000 mm, got {value}")]
    Gap {
        /// The given value.
        value: f64,
    },
    /// A number of parts outside the allowed range.
    #[error("by_gap.count must be between 1 and {PARTS_MAX}, got {value}")]
    Count {
        /// The given value.
        value: u32,
    },
    /// No window, or more than the allowed number of parts.
    #[error("windows must be a list of 1 to {PARTS_MAX}, got {windows_count}")]
    WindowsCount {
        /// The given value.
        windows_count: usize,
    },
    /// An invalid name.
    #[error(
        "windows[{index}].name must be a letter and then letters, digits, - or _, at most {NAME_CHARACTERS_MAX} together, \
         got {name:?}"
    )]
    Name {
        /// Position in the list, from 0.
        index: usize,
        /// The given value.
        name: String,
    },
    /// The name of an earlier window.
    #[error("windows[{index}].name: another window is called {name}, too; every part needs a name of its own")]
    NameTwice {
        /// Position of the later one.
        index: usize,
        /// The name.
        name: String,
    },
    /// Bounds that contain no x.
    #[error(
        "windows[{index}] ({name}): x_min_mm must be below x_max_mm and both within ±1000000, got {x_min_mm} and {x_max_mm}"
    )]
    Bounds {
        /// Position in the list, from 0.
        index: usize,
        /// The window's name.
        name: String,
        /// The given value.
        x_min_mm: f64,
        /// The given value.
        x_max_mm: f64,
    },
    /// Two windows with common profiles.
    #[error(
        "windows[{index}] ({name}): it begins at {x_min_mm} mm, before {other} ends at {x_max_mm} mm; windows must not overlap"
    )]
    Overlap {
        /// Position of the one that begins later along x.
        index: usize,
        /// Its name.
        name: String,
        /// Where it begins.
        x_min_mm: f64,
        /// The one that it overlaps.
        other: String,
        /// Where that ends.
        x_max_mm: f64,
    },
    /// The settings are incompatible with the window's nominal radius, or with its absence.
    #[error("windows[{index}] ({name}): {source}")]
    Setting {
        /// Position in the list, from 0.
        index: usize,
        /// The window's name.
        name: String,
        /// The setting.
        source: SettingError,
    },
}

impl PartsError {
    /// The field of the rule that is to be changed, e.g. `windows[1].name`.
    #[must_use]
    pub fn field(&self) -> String {
        match self {
            Self::Gap { .. } => "by_gap.gap_min_mm".to_owned(),
            Self::Count { .. } => "by_gap.count".to_owned(),
            Self::WindowsCount { .. } => "windows".to_owned(),
            Self::Name { index, .. } | Self::NameTwice { index, .. } => format!("windows[{index}].name"),
            Self::Bounds { index, .. } | Self::Overlap { index, .. } => format!("windows[{index}].x_min_mm"),
            Self::Setting { index, source, .. } => format!("windows[{index}].{}", source.name),
        }
    }
}

impl Default for ByGap {
    fn default() -> Self {
        Self { gap_min_mm: 20.0, count: None }
    }
}

impl Window {
    /// The settings for its part.
    #[must_use]
    pub fn settings(&self, settings: &Settings) -> Settings {
        Settings { nominal_radius_mm: self.nominal_radius_mm.or(settings.nominal_radius_mm), ..*settings }
    }
}

impl PartRule {
    /// The settings to check together with the rule: those of the first part, since the nominal radius may be declared only there.
    #[must_use]
    pub fn settings(&self, settings: &Settings) -> Settings {
        match self {
            Self::Windows(windows) => windows.first().map_or(*settings, |window| window.settings(settings)),
            Self::One | Self::ByGap(_) => *settings,
        }
    }

    /// Checks that the rule can be used with these settings.
    ///
    /// # Errors
    /// [`PartsError`] names the first invalid field.
    pub fn check(&self, settings: &Settings) -> Result<(), PartsError> {
        match self {
            Self::One => Ok(()),
            Self::ByGap(by_gap) => by_gap.check(),
            Self::Windows(windows) => check_windows(windows, settings),
        }
    }
}

impl ByGap {
    fn check(&self) -> Result<(), PartsError> {
        let Self { gap_min_mm, count } = *self;
        if !(gap_min_mm > 0.0 && gap_min_mm <= 1e5) {
            return Err(PartsError::Gap { value: gap_min_mm });
        }
        match count {
            Some(value) if !(1..=PARTS_MAX).contains(&(value as usize)) => Err(PartsError::Count { value }),
            _ => Ok(()),
        }
    }
}

fn check_windows(windows: &[Window], settings: &Settings) -> Result<(), PartsError> {
    let windows_count = windows.len();
    if !(1..=PARTS_MAX).contains(&windows_count) {
        return Err(PartsError::WindowsCount { windows_count });
    }
    for (index, window) in windows.iter().enumerate() {
        let name = || window.name.clone();
        if !is_name(&window.name) {
            return Err(PartsError::Name { index, name: name() });
        }
        if windows.iter().take(index).any(|earlier| earlier.name == window.name) {
            return Err(PartsError::NameTwice { index, name: name() });
        }
        let (x_min_mm, x_max_mm) = (window.x_min_mm, window.x_max_mm);
        if !(x_min_mm < x_max_mm && x_min_mm >= -X_MAX_MM && x_max_mm <= X_MAX_MM) {
            return Err(PartsError::Bounds { index, name: name(), x_min_mm, x_max_mm });
        }
        window.settings(settings).check().map_err(|source| PartsError::Setting { index, name: name(), source })?;
    }
    check_apart(windows)
}

fn check_apart(windows: &[Window]) -> Result<(), PartsError> {
    let mut in_order: Vec<(usize, &Window)> = windows.iter().enumerate().collect();
    in_order.sort_by(|(_, a), (_, b)| a.x_min_mm.total_cmp(&b.x_min_mm));
    for ((_, earlier), (index, later)) in in_order.iter().zip(in_order.iter().skip(1)) {
        if later.x_min_mm < earlier.x_max_mm {
            return Err(PartsError::Overlap {
                index: *index,
                name: later.name.clone(),
                x_min_mm: later.x_min_mm,
                other: earlier.name.clone(),
                x_max_mm: earlier.x_max_mm,
            });
        }
    }
    Ok(())
}

/// A name begins with a letter, so that it is not mistaken for a number.
fn is_name(text: &str) -> bool {
    text.bytes().next().is_some_and(|first| first.is_ascii_alphabetic())
        && text.bytes().all(|byte| byte.is_ascii_alphanumeric() || matches!(byte, b'-' | b'_'))
        && text.len() <= NAME_CHARACTERS_MAX
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::estimation::RadiusRule;

    fn window(name: &str, x_min_mm: f64, x_max_mm: f64) -> Window {
        Window { name: name.to_owned(), x_min_mm, x_max_mm, nominal_radius_mm: None }
    }

    fn field(rule: &PartRule) -> String {
        rule.check(&Settings::default()).expect_err("refused").field()
    }

    #[test]
    fn a_rule_of_a_recipe_is_parsed_and_unknown_fields_are_named() {
        let read = serde_json::from_str::<PartRule>;
        assert_eq!(read("\"one\"").expect("a rule"), PartRule::One);
        assert_eq!(read(r#"{"by_gap": {}}"#).expect("a rule"), PartRule::ByGap(ByGap::default()));
        let windows = PartRule::Windows(vec![window("a", 0.0, 1.0)]);
        assert_eq!(read(r#"{"windows": [{"name": "a", "x_min_mm": 0, "x_max_mm": 1}]}"#).expect("a rule"), windows);
        for (text, named) in [
            (r#"{"by_gap": {"gap_mm": 3}}"#, "gap_mm"),
            (r#"{"windows": [{"name": "a", "x_min_mm": 0}]}"#, "x_max_mm"),
            (r#"{"gaps": {}}"#, "by_gap"),
        ] {
            let refused = read(text).expect_err("refused").to_string();
            assert!(refused.contains(named), "{refused}");
        }
    }

    #[test]
    fn an_invalid_rule_is_refused_with_its_field() {
        let windows = |list: &[Window]| PartRule::Windows(list.to_vec());
        assert_eq!(field(&PartRule::ByGap(ByGap { gap_min_mm: f64::NAN, count: None })), "by_gap.gap_min_mm");
        assert_eq!(field(&PartRule::ByGap(ByGap { count: Some(17), ..ByGap::default() })), "by_gap.count");
        assert_eq!(field(&windows(&[])), "windows");
        assert_eq!(field(&windows(&vec![window("a", 0.0, 1.0); 17])), "windows");
        for name in ["", "1", "ä", "a b", &"a".repeat(33)] {
            assert_eq!(field(&windows(&[window(name, 0.0, 1.0)])), "windows[0].name");
        }
        assert_eq!(field(&windows(&[window("a", 0.0, 1.0), window("a", 2.0, 3.0)])), "windows[1].name");
        assert_eq!(field(&windows(&[window("a", 1.0, 1.0)])), "windows[0].x_min_mm");
        assert_eq!(field(&windows(&[window("b", 2.0, 4.0), window("a", 0.0, 2.5)])), "windows[0].x_min_mm");
        let touching = windows(&[window("b", 2.0, 4.0), window("a", 0.0, 2.0)]);
        assert_eq!(touching.check(&Settings::default()), Ok(()));
    }

    #[test]
    fn a_fixed_radius_may_be_declared_by_the_windows_if_all_of_them_do() {
        let settings = Settings { radius: RadiusRule::Fixed, ..Settings::default() };
        let with_radius = Window { nominal_radius_mm: Some(200.0), ..window("a", 0.0, 1.0) };
        let both = PartRule::Windows(vec![with_radius.clone(), window("b", 2.0, 3.0)]);
        let error = both.check(&settings).expect_err("b has none");
        assert_eq!(error.field(), "windows[1].nominal_radius_mm");
        assert_eq!(PartRule::Windows(vec![with_radius]).check(&settings), Ok(()));
    }
}
