//! Finds and removes points and profiles that were not measured: values that stand for "no return", and profiles that
//! repeat an earlier one bit for bit.
//!
//! Files write "no return" as a number (0, 9999, −99999, 65.535) in z alone or in the whole point. The number is declared,
//! or is found because it occurs far more often than noise allows. A value of less than about 1/500 of the points is not
//! looked for: the robust fits reject that many outliers.

mod find;
mod remove;
mod repeats;

use super::cloud::Cloud;
use super::columns::Columns;
use crate::scan::decode::Unit;
use find::Pattern;
use std::fmt;

/// A value that stands for missing points, mm.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum MissingKind {
    /// A declared value in x, y or z.
    Declared(f64),
    /// The same whole point. `x` where it was the same everywhere, too.
    Point {
        /// x of all the points that were removed; `None` where they differ.
        x: Option<f64>,
        /// y.
        y: f64,
        /// z.
        z: f64,
    },
    /// The same z under different y.
    Z(f64),
}

/// A value that was taken as missing data, and how many points it removed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MissingValue {
    /// The value, mm.
    pub kind: MissingKind,
    /// The points removed.
    pub count: u64,
    /// The unit of the file.
    pub unit: Unit,
}

impl fmt::Display for MissingValue {
    /// The value in the unit of the file, e.g. `z = -9999`.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        // Seven digits are what single precision holds; the scaling to mm and back must not add more.
        let text = |value: f64| {
            let rounded: f64 = format!("{:.6e}", value / self.unit.in_mm()).parse().unwrap_or(value);
            rounded.to_string()
        };
        match self.kind {
            MissingKind::Declared(value) => write!(f, "x, y or z = {}", text(value)),
            MissingKind::Point { x: Some(x), y, z } => write!(f, "(x, y, z) = ({}, {}, {})", text(x), text(y), text(z)),
            MissingKind::Point { x: None, y, z } => write!(f, "(y, z) = ({}, {})", text(y), text(z)),
            MissingKind::Z(z) => write!(f, "z = {}", text(z)),
        }
    }
}

/// What [`clean`] removed from a cloud.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Removed {
    /// The values that stood for missing points.
    pub missing: Vec<MissingValue>,
    /// Profiles that were bit for bit an earlier one.
    pub repeated_profiles: u64,
    /// Points of the cloud before anything was removed.
    pub points: u64,
    /// Profiles of the cloud before the repeated ones were removed, as far as the file separates them.
    pub profiles: u64,
}

impl Removed {
    /// Points removed as missing.
    #[must_use]
    pub fn missing_count(&self) -> u64 {
        self.missing.iter().map(|value| value.count).sum()
    }
}

/// Rounds of the search: removing one value can reveal another one.
const ROUNDS_MAX: usize = 4;

/// Removes missing points and repeated profiles. `declared` are the values, in the unit of the file, that mark a point as
/// missing wherever x, y or z has one of them; where nothing is declared, such values are searched for. Missing points add to
/// [`Cloud::missing_count`]; a profile that loses all its points becomes a blank, a repeated profile does not.
///
/// The cloud may come back without a point where the declared values cover all of them.
#[must_use]
pub fn clean(cloud: Cloud, declared: Option<&[f64]>) -> (Cloud, Removed) {
    let mut cloud = cloud;
    let mut removed = Removed { points: cloud.columns.len() as u64, ..Removed::default() };
    if let Some(declared) = declared {
        let declared: Vec<Pattern> = declared.iter().filter(|v| v.is_finite()).map(|v| Pattern::Any(*v)).collect();
        (cloud, removed.missing) = remove::remove(cloud, &declared);
    }
    let rounds = if declared.is_some() { 0 } else { ROUNDS_MAX };
    for _ in 0..rounds {
        let found = find::find(&cloud);
        if found.is_empty() {
            break;
        }
        let (rest, values) = remove::remove(cloud, &found);
        cloud = rest;
        removed.missing.extend(values);
    }
    (cloud, removed.repeated_profiles, removed.profiles) = repeats::remove_repeats(cloud);
    (cloud, removed)
}

/// Removes the points of `keep` that are false, from both columns.
fn retain(columns: &mut Columns, keep: &[bool]) {
    fn compact<T: Copy>(values: &mut Vec<T>, keep: &[bool]) {
        let mut flags = keep.iter();
        values.retain(|_| flags.next().copied().unwrap_or(true));
    }
    match columns {
        Columns::F32 { y, z } => {
            compact(y, keep);
            compact(z, keep);
        }
        Columns::F64 { y, z } => {
            compact(y, keep);
            compact(z, keep);
        }
    }
}

#[cfg(test)]
mod tests;
