//! What the names of columns, properties and fields mean: a coordinate (perhaps with its unit) or the profile.
//! Must not know which format they come from.

use super::{DecodeError, Request, Unit, settle_unit};

/// Names, without case, under which a column counts the profiles.
const PROFILE_NAMES: [&str; 18] = [
    "profile",
    "profile_index",
    "profile_id",
    "profile_no",
    "profile_number",
    "frame",
    "frame_index",
    "frame_id",
    "line",
    "line_index",
    "line_id",
    "line_no",
    "scan",
    "scan_line",
    "scanline",
    "scan_index",
    "row",
    "station",
];

/// Where the columns that matter stand, by position.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct ColumnMap {
    /// x, y and z.
    pub(super) point: [usize; 3],
    /// The profile's label and its name.
    pub(super) label: Option<(usize, String)>,
    /// The unit that the names state.
    pub(super) unit: Option<Unit>,
}

impl ColumnMap {
    /// One past the last column that matters.
    pub(super) fn end(&self) -> usize {
        let label = self.label.as_ref().map_or(0, |(position, _)| *position);
        self.point.iter().fold(label, |end, &position| end.max(position)) + 1
    }
}

/// Finds the coordinates and the profile's label among names.
///
/// # Errors
/// [`DecodeError::UnknownColumn`] without x, y or z or the profile column asked for, [`DecodeError::DoubleColumn`] with
/// two of a kind, [`DecodeError::UnitConflict`] where names state different units.
pub(super) fn map_columns(names: &[String], request: &Request<'_>) -> Result<ColumnMap, DecodeError> {
    let mut point = [None; 3];
    let mut unit = None;
    for (position, name) in names.iter().enumerate() {
        let Some((axis, stated)) = read_axis(name) else { continue };
        let Some(slot) = point.get_mut(axis.index()) else { continue };
        if let Some(first) = slot.replace(position) {
            let first = names.get(first).cloned().unwrap_or_default();
            return Err(DecodeError::DoubleColumn { wanted: axis.name(), first, second: name.clone() });
        }
        if let (Some(declared), Some(found)) = (unit, stated)
            && declared != found
        {
            return Err(DecodeError::UnitConflict { declared, found });
        }
        unit = unit.or(stated);
    }
    let missing = |axis: Axis| unknown_column(axis.name(), names);
    let [x, y, z] = point;
    let point =
        [x.ok_or_else(|| missing(Axis::X))?, y.ok_or_else(|| missing(Axis::Y))?, z.ok_or_else(|| missing(Axis::Z))?];
    Ok(ColumnMap { point, label: find_label(names, request)?, unit })
}

/// Whether a name is one of a coordinate.
pub(super) fn is_axis(name: &str) -> bool {
    read_axis(name).is_some()
}

/// The unit that a comment such as `unit: mm` or `Units = metres` states.
pub(super) fn unit_of_comment(comment: &[u8]) -> Option<Unit> {
    let comment = str::from_utf8(comment).ok()?.trim().to_lowercase();
    let rest = comment.strip_prefix("units").or_else(|| comment.strip_prefix("unit"))?;
    Unit::from_name(rest.trim_start().strip_prefix([':', '='])?)
}

/// The unit that a file states in two places.
pub(super) fn settle_stated(names: Option<Unit>, comment: Option<Unit>) -> Result<Option<Unit>, DecodeError> {
    match names {
        Some(unit) => settle_unit(Some(unit), comment).map(Some),
        None => Ok(comment),
    }
}

fn find_label(names: &[String], request: &Request<'_>) -> Result<Option<(usize, String)>, DecodeError> {
    let named = |wanted: &str| names.iter().position(|name| name.trim().eq_ignore_ascii_case(wanted.trim()));
    let position = match request.profile_column {
        Some(wanted) => Some(named(wanted).ok_or_else(|| unknown_column(wanted, names))?),
        None => PROFILE_NAMES.into_iter().find_map(|known| {
            names.iter().position(|name| name.trim().replace([' ', '-'], "_").eq_ignore_ascii_case(known))
        }),
    };
    Ok(position.and_then(|position| Some((position, names.get(position)?.trim().to_owned()))))
}

/// The error that lists the columns there are: not more than fit a message, none longer than a name should be.
pub(super) fn unknown_column(wanted: &str, names: &[String]) -> DecodeError {
    let short = |name: &str| name.chars().filter(|c| !c.is_control()).take(40).collect::<String>();
    let found = names.iter().take(32).map(|name| short(name.trim())).collect();
    DecodeError::UnknownColumn { wanted: short(wanted), found }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Axis {
    X,
    Y,
    Z,
}

impl Axis {
    fn index(self) -> usize {
        match self {
            Self::X => 0,
            Self::Y => 1,
            Self::Z => 2,
        }
    }

    fn name(self) -> &'static str {
        match self {
            Self::X => "x",
            Self::Y => "y",
            Self::Z => "z",
        }
    }
}

/// Reads `x`, `X_mm`, `x[mm]`, `X (mm)`, `x mm`, `x/mm`, `x.mm`: an axis, and the unit behind it.
fn read_axis(name: &str) -> Option<(Axis, Option<Unit>)> {
    let name = name.trim();
    let mut letters = name.chars();
    let axis = match letters.next()? {
        'x' | 'X' => Axis::X,
        'y' | 'Y' => Axis::Y,
        'z' | 'Z' => Axis::Z,
        _ => return None,
    };
    let rest = letters.as_str();
    if rest.is_empty() {
        return Some((axis, None));
    }
    let unit = rest.strip_prefix(|c: char| matches!(c, '_' | '[' | '(' | ' ' | '/' | '.'))?;
    let unit = unit.trim_matches(|c: char| matches!(c, '[' | ']' | '(' | ')' | ' ' | '_'));
    Unit::from_name(unit).map(|unit| (axis, Some(unit)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scan::decode::Limits;

    fn map(names: &[&str], profile_column: Option<&str>) -> Result<ColumnMap, DecodeError> {
        let names: Vec<String> = names.iter().map(ToString::to_string).collect();
        map_columns(&names, &Request { unit: None, profile_column, limits: &Limits::default() })
    }

    #[test]
    fn axes_are_found_under_their_usual_names() {
        for (names, unit) in [
            (["x", "y", "z"], None),
            (["X_mm", "Y_mm", "Z_mm"], Some(Unit::Millimetre)),
            (["X (mm)", "Y [mm]", "z mm"], Some(Unit::Millimetre)),
            (["x[um]", "y[\u{b5}m]", "z_um"], Some(Unit::Micrometre)),
            ([" X_m", "Y_m ", "Z"], Some(Unit::Metre)),
        ] {
            let found = map(&names, None).expect("axes");
            assert_eq!((found.point, found.unit), ([0, 1, 2], unit), "{names:?}");
        }
    }

    #[test]
    fn the_profile_column_is_recognised_or_taken_as_asked() {
        let names = ["t", "Profile Index", "z", "y", "x"];
        assert_eq!(map(&names, None).expect("axes").label, Some((1, "Profile Index".to_owned())));
        assert_eq!(map(&names, Some("T")).expect("axes").label, Some((0, "t".to_owned())));
        assert_eq!(map(&names, Some("sweep")).expect_err("none").code(), "column_unknown");
    }

    #[test]
    fn missing_double_and_contradicting_columns_are_refused() {
        let missing = map(&["a", "y", "z"], None).expect_err("no x").to_string();
        assert!(missing.contains("no column x") && missing.contains("a, y, z"), "{missing}");
        assert_eq!(map(&["x", "X_mm", "y", "z"], None).expect_err("two x").code(), "column_ambiguous");
        assert_eq!(map(&["x_m", "y_mm", "z"], None).expect_err("units").code(), "unit_conflict");
    }
}
