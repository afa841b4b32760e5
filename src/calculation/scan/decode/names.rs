//! The meaning of the names of columns, properties and fields: a coordinate (optionally with its unit) or the profile.

use super::error::DecodeError;
use super::request::{Request, settle_unit};
use crate::scan::cloud::Unit;

/// Names, irrespective of case, of a column that counts the profiles.
const PROFILE_NAMES: [&str; 25] = [
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
    "profil",
    "profil_nr",
    "profil_index",
    "profilnummer",
    "zeile",
    "zeile_nr",
    "zeilennummer",
];

/// Words that the name of a coordinate may contain besides its axis and its unit.
const POSITION_WORDS: [&str; 40] = [
    "pos",
    "position",
    "coord",
    "coordinate",
    "koord",
    "koordinate",
    "wert",
    "value",
    "val",
    "axis",
    "achse",
    "axe",
    "eje",
    "asse",
    "länge",
    "laenge",
    "length",
    "longueur",
    "lunghezza",
    "breite",
    "width",
    "largeur",
    "höhe",
    "hoehe",
    "height",
    "hauteur",
    "altezza",
    "altura",
    "tiefe",
    "depth",
    "profondeur",
    "weg",
    "travel",
    "abstand",
    "distance",
    "istwert",
    "messwert",
    "actual",
    "punkt",
    "point",
];

/// Indices of the relevant columns.
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
    /// Index after the last relevant column.
    pub(super) fn end(&self) -> usize {
        let label = self.label.as_ref().map_or(0, |(position, _)| *position);
        self.point.iter().fold(label, |end, &position| end.max(position)) + 1
    }
}

/// Finds the coordinates and the profile's label among the names.
///
/// # Errors
/// [`DecodeError::UnknownColumn`] without x, y or z or the requested profile column, [`DecodeError::DoubleColumn`] with two of a
/// kind, [`DecodeError::UnitConflict`] if names state different units.
pub(super) fn map_columns(names: &[String], request: &Request<'_>) -> Result<ColumnMap, DecodeError> {
    let mut point = [None; 3];
    let mut unit = None;
    // An x has priority over an x_position.
    let plain = [Axis::X, Axis::Y, Axis::Z]
        .iter()
        .all(|axis| names.iter().filter_map(|name| read_plain_axis(name)).any(|(found, _)| found == *axis));
    let read = if plain { read_plain_axis } else { read_axis };
    for (position, name) in names.iter().enumerate() {
        let Some((axis, stated)) = read(name) else { continue };
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

/// The unit of a cell that contains nothing else: `mm`, `[mm]`, `(inch)`.
pub(super) fn unit_of_cell(cell: &[u8]) -> Option<Unit> {
    Unit::from_name(text_of(cell).trim().trim_matches(['[', ']', '(', ')', '<', '>', '{', '}']))
}

/// The unit that a comment such as `unit: mm` or `Units = metres` states.
pub(super) fn unit_of_comment(comment: &[u8]) -> Option<Unit> {
    let comment = text_of(comment).trim().to_lowercase();
    let rest = comment.strip_prefix("units").or_else(|| comment.strip_prefix("unit"))?;
    Unit::from_name(rest.trim_start().strip_prefix([':', '='])?)
}

/// Text of a name or comment: UTF-8, otherwise the Latin-1 of spreadsheets, so that a micrometre is recognised.
pub(super) fn text_of(bytes: &[u8]) -> String {
    str::from_utf8(bytes).map_or_else(|_| bytes.iter().copied().map(char::from).collect(), str::to_owned)
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
            let plain = |name: &str| name.trim().trim_end_matches('.').replace("-", "_").replace(' ', "_");
            names.iter().position(|name| plain(name).eq_ignore_ascii_case(known))
        }),
    };
    Ok(position.and_then(|position| Some((position, names.get(position)?.trim().to_owned()))))
}

/// The error that lists the columns of the file, limited in their number and in the length of each.
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

    /// `x`, or `x` joined to a word for a position: `xpos`, `posx`.
    fn of_word(word: &str) -> Option<Self> {
        let letter = POSITION_WORDS
            .iter()
            .find_map(|known| {
                word.strip_prefix(known).or_else(|| word.strip_suffix(known)).filter(|rest| rest.len() == 1)
            })
            .unwrap_or(word);
        [Self::X, Self::Y, Self::Z].into_iter().find(|axis| axis.name() == letter)
    }

    fn name(self) -> &'static str {
        match self {
            Self::X => "x",
            Self::Y => "y",
            Self::Z => "z",
        }
    }
}

/// Accepts the names of [`read_plain_axis`], and `X-Position`, `Pos_X`, `XPos`, `pos x (mm)`.
fn read_axis(name: &str) -> Option<(Axis, Option<Unit>)> {
    read_plain_axis(name).or_else(|| read_long_axis(name))
}

/// Accepts an axis next to a word for a position: in any order, joined or separate, optionally with a unit.
fn read_long_axis(name: &str) -> Option<(Axis, Option<Unit>)> {
    let name = name.to_lowercase();
    let (mut axis, mut unit) = (None, None);
    let words = name.split(['_', '-', '[', ']', '(', ')', '<', '>', '{', '}', ' ', '\u{a0}', '/', '.', ':', ',', '=']);
    for word in words.filter(|word| !word.is_empty() && !POSITION_WORDS.contains(word)) {
        if let Some(found) = Axis::of_word(word) {
            axis.replace(found).is_none().then_some(())?;
        } else {
            unit.replace(Unit::from_name(word)?).is_none().then_some(())?;
        }
    }
    Some((axis?, unit))
}

/// Accepts `x`, `X_mm`, `x[mm]`, `X (mm)`, `x mm`, `x/mm`, `x.mm`: an axis, and the unit after it.
fn read_plain_axis(name: &str) -> Option<(Axis, Option<Unit>)> {
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
    let unit = rest.strip_prefix(['_', '[', '(', '<', '{', ' ', '\u{a0}', '/', '.', ',', ':'])?;
    let unit = unit.trim_matches(['[', ']', '(', ')', '<', '>', '{', '}', ' ', '\u{a0}', '_', '/']);
    Unit::from_name(unit).map(|unit| (axis, Some(unit)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scan::decode::Limits;

    fn map(names: &[&str], profile_column: Option<&str>) -> Result<ColumnMap, DecodeError> {
        let names: Vec<String> = names.iter().map(ToString::to_string).collect();
        map_columns(&names, &Request { profile_column, ..Request::new(&Limits::default()) })
    }

    #[test]
    fn axes_are_found_under_their_usual_names() {
        for (names, unit) in [
            (["x", "y", "z"], None),
            (["X_mm", "Y_mm", "Z_mm"], Some(Unit::Millimetre)),
            (["X (mm)", "Y [mm]", "z mm"], Some(Unit::Millimetre)),
            (["x[um]", "y[\u{b5}m]", "z_um"], Some(Unit::Micrometre)),
            ([" X_m", "Y_m ", "Z"], Some(Unit::Metre)),
            (["X-Position", "Y-Position", "Z-Position"], None),
            (["Pos_X", "Pos_Y", "Pos_Z"], None),
            (["XPos", "YPos", "ZPos"], None),
            (["pos x (mm)", "pos y (mm)", "pos z (mm)"], Some(Unit::Millimetre)),
            (["X-Koordinate [m]", "Y-Koordinate [m]", "Z-Koordinate [m]"], Some(Unit::Metre)),
            (["Länge X [mm]", "Breite Y [mm]", "Höhe Z [mm]"], Some(Unit::Millimetre)),
            (["x [\"]", "y [\"]", "z (in)"], Some(Unit::Inch)),
            (["x\u{a0}[mm]", "y, mm", "z <mm>"], Some(Unit::Millimetre)),
            (["X axis value", "Y axis value", "height Z"], None),
        ] {
            let found = map(&names, None).expect("axes");
            assert_eq!((found.point, found.unit), ([0, 1, 2], unit), "{names:?}");
        }
    }

    #[test]
    fn the_profile_column_is_recognised_or_taken_as_requested() {
        let names = ["t", "Profile Index", "z", "y", "x"];
        assert_eq!(map(&names, None).expect("axes").label, Some((1, "Profile Index".to_owned())));
        assert_eq!(map(&names, Some("T")).expect("axes").label, Some((0, "t".to_owned())));
        assert_eq!(map(&names, Some("sweep")).expect_err("none").code(), "column_unknown");
    }

    #[test]
    fn german_names_of_the_profile_are_recognised() {
        for name in ["Profil", "Profil-Nr", "Profil-Nr.", "Zeile"] {
            assert_eq!(map(&["x", "y", "z", name], None).expect("axes").label, Some((3, name.to_owned())));
        }
    }

    #[test]
    fn a_short_name_has_priority_and_other_words_are_not_positions() {
        assert_eq!(map(&["x_pos", "x", "y", "z"], None).expect("axes").point, [1, 2, 3]);
        for name in ["nx", "x normal", "xy_pos", "pos", "x_x_pos", "x mm mm"] {
            assert!(!is_axis(name), "{name}");
        }
    }

    #[test]
    fn a_micro_sign_in_latin_1_is_read() {
        assert_eq!(unit_of_comment(b"unit: \xb5m"), Some(Unit::Micrometre));
        assert_eq!(map(&["x", "y", &text_of(b"z [\xb5m]")], None).expect("axes").unit, Some(Unit::Micrometre));
    }

    #[test]
    fn missing_double_and_contradicting_columns_are_refused() {
        let missing = map(&["a", "y", "z"], None).expect_err("no x").to_string();
        assert!(missing.contains("no column x") && missing.contains("a, y, z; rename"), "{missing}");
        assert_eq!(map(&["x", "X_mm", "y", "z"], None).expect_err("two x").code(), "column_ambiguous");
        assert_eq!(map(&["x_m", "y_mm", "z"], None).expect_err("units").code(), "unit_conflict");
    }
}
