//! Finds and removes points and profiles that were not measured: values that mark "no return", and profiles that repeat an earlier
//! one bit for bit.
//!
//! Files write "no return" as a number (0, 9999, −99999, 65.535) in z alone or in all coordinates. The number is declared, or is
//! found because it occurs far more often than noise allows. A value of less than about 1/500 of the points is not searched: the
//! robust fits reject that many outliers.

mod find;
mod remove;

pub use remove::{MissingKind, MissingValue};

use super::cloud::Cloud;
use find::Pattern;

/// The points and profiles that [`clean`] removed from a cloud.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Removed {
    /// The values that marked missing points.
    pub missing: Vec<MissingValue>,
    /// Profiles that repeated an earlier one bit for bit.
    pub repeated_profiles: u64,
    /// Number of points of the cloud before the removal.
    pub points: u64,
    /// Number of profiles of the cloud before the repeated ones were removed, as far as the file separates them.
    pub profiles: u64,
}

impl Removed {
    /// Number of points removed as missing.
    #[must_use]
    pub fn missing_count(&self) -> u64 {
        self.missing.iter().map(|value| value.count).sum()
    }
}

/// Rounds of the search: the removal of one value can reveal another one.
const ROUNDS_MAX: usize = 4;

/// Removes missing points and repeated profiles. `declared` are the values, in the unit of the file, that mark a point as missing
/// if x, y or z has one of them; without a declaration such values are searched. Missing points add to [`Cloud::missing_count`]; a
/// profile that loses all its points becomes a blank, a repeated profile does not.
///
/// The resulting cloud may have no points if the declared values cover all of them.
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
    (cloud, removed.repeated_profiles, removed.profiles) = remove::remove_repeats(cloud);
    (cloud, removed)
}

#[cfg(test)]
mod tests;
