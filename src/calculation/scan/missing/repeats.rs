//! Removes profiles that are bit for bit an earlier one: delivered twice, or old content under a new x.
//!
//! Noise never gives the same profile again, a simulated scan without noise does. So a profile counts as a repeat only where
//! the scan shows that two profiles agree by chance in few of their points.

use super::find::most_of_one_value;
use super::retain;
use crate::scan::cloud::{Cloud, Labels, Stripe};
use crate::scan::columns::{Columns, Stretch};
use std::collections::HashMap;
use std::hash::{DefaultHasher, Hash, Hasher};
use std::ops::Range;

/// Chance that a scan without repeats is told that it has some.
const CHANCE_MAX: f64 = 1e-9;
/// Successive points that a profile's hash takes from each of two places.
const HASHED: usize = 4;
/// Different profiles of one hash that are kept for comparison: bounds the time where all begin alike.
const ALIKE_MAX: usize = 8;
/// Fewer points are never beyond chance; also keeps clouds whose points have an x each out of the search.
const POINTS_MIN: usize = 8;

/// The cloud without repeated profiles, how many they were, and of how many.
pub(super) fn remove_repeats(cloud: Cloud) -> (Cloud, u64, u64) {
    let (profiles, count) = profiles(&cloud);
    let repeats = find_repeats(&cloud, &profiles);
    if repeats.is_empty() {
        return (cloud, 0, count);
    }
    let mut keep = vec![true; cloud.columns.len()];
    for range in &repeats {
        keep.get_mut(range.clone()).unwrap_or_default().fill(false);
    }
    let mut cloud = cloud;
    retain(&mut cloud.columns, &keep);
    let (mut start, mut end) = (0, 0);
    let mut kept: Vec<Stripe> = Vec::with_capacity(cloud.stripes.len());
    for stripe in &cloud.stripes {
        let range = std::mem::replace(&mut start, stripe.end)..stripe.end;
        let count = keep.get(range).unwrap_or_default().iter().filter(|keep| **keep).count();
        end += count;
        if count > 0 {
            kept.push(Stripe { end, ..*stripe });
        }
    }
    cloud.stripes = kept;
    (cloud, repeats.len() as u64, count)
}

/// The profiles of [`POINTS_MIN`] points and more, as far as the file separates them, and the number of all: successive
/// stripes of one label, or single stripes where there are none. A stripe whose halves are equal is two.
fn profiles(cloud: &Cloud) -> (Vec<Range<usize>>, u64) {
    let mut profiles = Vec::new();
    let (mut start, mut count) = (0, 0);
    let labelled = cloud.labels != Labels::None;
    for pieces in cloud.stripes.chunk_by(|a, b| labelled && a.label == b.label) {
        let end = pieces.last().map_or(start, |stripe| stripe.end);
        let range = std::mem::replace(&mut start, end)..end;
        count += 1;
        if range.len() < POINTS_MIN {
            continue;
        }
        let middle = range.start + range.len() / 2;
        let halves = [range.start..middle, middle..range.end];
        let [first, second] = &halves;
        if range.len() % 2 == 0 && is_equal(&cloud.columns, first, second) {
            count += 1;
            profiles.extend(halves);
        } else {
            profiles.push(range);
        }
    }
    (profiles, count)
}

fn find_repeats(cloud: &Cloud, profiles: &[Range<usize>]) -> Vec<Range<usize>> {
    let columns = &cloud.columns;
    let mut firsts: HashMap<u64, Vec<Range<usize>>> = HashMap::with_capacity(profiles.len());
    let mut repeats = Vec::new();
    for profile in profiles {
        let same_hash = firsts.entry(hash(columns, profile)).or_default();
        if same_hash.iter().any(|first| is_equal(columns, first, profile)) {
            repeats.push(profile.clone());
        } else if same_hash.len() < ALIKE_MAX {
            same_hash.push(profile.clone());
        }
    }
    if repeats.is_empty() {
        return repeats;
    }
    let Some(agreeing) = agreeing_by_chance(columns, profiles) else { return Vec::new() };
    let chance = agreeing.max(most_of_one_value(cloud));
    let needed = (profiles.len() as f64 / CHANCE_MAX).ln();
    repeats.retain(|profile| -(profile.len() as f64) * chance.ln() > needed);
    repeats
}

/// The share of points that agree in y and z with the point of the same position in the profile before, over successive
/// profiles that are not equal; `None` where all are equal.
fn agreeing_by_chance(columns: &Columns, profiles: &[Range<usize>]) -> Option<f64> {
    let (mut agreeing, mut count, mut pairs) = (0_u64, 0_u64, 0_u64);
    for pair in profiles.windows(2) {
        let [before, after] = pair else { continue };
        if is_equal(columns, before, after) {
            continue;
        }
        pairs += 1;
        let both = before.clone().zip(after.clone());
        agreeing += both.filter(|(a, b)| columns.get(*a) == columns.get(*b)).count() as u64;
        count += before.len().min(after.len()) as u64;
    }
    // One of two more points agrees: a rate is not 0 because few points were seen (Laplace).
    (pairs > 0).then(|| (agreeing + 1) as f64 / (count + 2) as f64)
}

/// A hash of a profile's first points and of those in its middle: places that the search for equal halves reads anyway, as
/// every other place costs an access to memory of its own.
fn hash(columns: &Columns, range: &Range<usize>) -> u64 {
    let mut hasher = DefaultHasher::new();
    let middle = range.start + range.len() / 2;
    range.len().hash(&mut hasher);
    for index in (range.start..middle).take(HASHED).chain((middle..range.end).take(HASHED)) {
        let [y, z] = columns.get(index).unwrap_or_default();
        [y + 0.0, z + 0.0].map(f64::to_bits).hash(&mut hasher);
    }
    hasher.finish()
}

fn is_equal(columns: &Columns, a: &Range<usize>, b: &Range<usize>) -> bool {
    match (columns.stretch(a.clone()), columns.stretch(b.clone())) {
        (Stretch::F32 { y, z }, Stretch::F32 { y: other_y, z: other_z }) => y == other_y && z == other_z,
        (Stretch::F64 { y, z }, Stretch::F64 { y: other_y, z: other_z }) => y == other_y && z == other_z,
        _ => false,
    }
}
