//! Removes the points that match a pattern, and profiles that equal an earlier one bit for bit: delivered twice, or old content
//! under a new x.
//!
//! Noise never repeats a profile, but a simulated scan without noise does. So a profile counts as a repeat only if the scan shows
//! that two profiles agree by chance in few of their points.

use super::find::{Pattern, most_of_one_value};
use crate::scan::cloud::{Cloud, Labels, Stripe};
use crate::scan::columns::{Columns, Stretch};
use crate::scan::decode::Unit;
use std::collections::{HashMap, HashSet};
use std::fmt;
use std::hash::{DefaultHasher, Hash, Hasher};
use std::ops::Range;

/// x of the points that a pattern removed.
#[derive(Clone, Copy)]
struct Extent {
    least: f64,
    most: f64,
    count: u64,
}

impl Extent {
    const NONE: Self = Self { least: f64::INFINITY, most: f64::NEG_INFINITY, count: 0 };

    fn take(&mut self, x: f64) {
        *self = Self { least: self.least.min(x), most: self.most.max(x), count: self.count + 1 };
    }

    /// The x that all of them share.
    fn common(&self) -> Option<f64> {
        (self.count > 0 && self.least == self.most).then_some(self.least)
    }
}

/// The cloud without the points that match one of the patterns, and the number of points of each pattern that removed any.
pub(super) fn remove(cloud: Cloud, patterns: &[Pattern]) -> (Cloud, Vec<MissingValue>) {
    let tests: Vec<Test> = patterns.iter().map(|pattern| Test::new(*pattern, &cloud)).collect();
    let mut extents = vec![Extent::NONE; tests.len()];
    let mut keep = vec![true; cloud.columns.len()];
    let mut start = 0;
    for stripe in &cloud.stripes {
        let range = std::mem::replace(&mut start, stripe.end)..stripe.end;
        let Some(flags) = keep.get_mut(range.clone()) else { continue };
        for (test, extent) in tests.iter().zip(&mut extents) {
            test.mark(&cloud.columns, stripe, range.clone(), flags, |x| extent.take(x));
        }
    }
    let unit = cloud.unit;
    let values = patterns.iter().zip(&extents).filter(|(_, extent)| extent.count > 0).map(|(pattern, extent)| {
        let kind = match *pattern {
            Pattern::Any(value) => MissingKind::Declared(value * unit.in_mm()),
            Pattern::Point { y, z } => MissingKind::Point { x: extent.common(), y, z },
            Pattern::Z(z) => MissingKind::Z(z),
        };
        MissingValue { kind, count: extent.count, unit }
    });
    let values: Vec<MissingValue> = values.collect();
    if values.is_empty() {
        return (cloud, values);
    }
    // A plane in which every removed point of a pattern lies is part of the pattern, not a position.
    let codes: Vec<f64> = tests.iter().zip(&extents).flat_map(|(test, extent)| test.codes(extent)).collect();
    let mut cloud = without(cloud, &keep, &codes);
    cloud.missing_count += values.iter().map(|value| value.count).sum::<u64>();
    (cloud, values)
}

/// The cloud without the points whose flag is false. Emptied profiles become blanks at their mean x; stripes at one of the `codes`
/// have no position.
fn without(mut cloud: Cloud, keep: &[bool], codes: &[f64]) -> Cloud {
    retain(&mut cloud.columns, keep);
    let mut kept: Vec<Stripe> = Vec::with_capacity(cloud.stripes.len());
    let mut emptied: Vec<(f64, f64)> = Vec::new();
    let (mut start, mut end) = (0, 0);
    for stripe in &cloud.stripes {
        let range = std::mem::replace(&mut start, stripe.end)..stripe.end;
        let count = keep.get(range).unwrap_or_default().iter().filter(|keep| **keep).count();
        if count == 0 {
            emptied.push((stripe.label, stripe.x));
            continue;
        }
        end += count;
        match kept.last_mut() {
            Some(last) if last.label == stripe.label && last.x == stripe.x => last.end = end,
            _ => kept.push(Stripe { end, ..*stripe }),
        }
    }
    // As in decoding: without labels the file does not state which points form a profile.
    if cloud.labels != Labels::None && !emptied.is_empty() {
        let profiles = kept.chunk_by(|a, b| a.label == b.label).filter_map(|stripes| stripes.first());
        let full: HashSet<u64> = profiles.map(|stripe| stripe.label.to_bits()).collect();
        let mut planes: HashMap<u64, (f64, f64)> = HashMap::new();
        for (label, x) in emptied {
            if !full.contains(&label.to_bits()) && !codes.contains(&x) {
                let (sum, count) = planes.entry(label.to_bits()).or_default();
                *sum += x;
                *count += 1.0;
            }
        }
        let mut blanks: Vec<f64> = planes.values().map(|(sum, count)| sum / count).collect();
        blanks.sort_unstable_by(f64::total_cmp);
        cloud.blanks.extend(blanks);
    }
    cloud.stripes = kept;
    cloud
}

/// A pattern as the bits of this cloud's columns.
struct Test {
    pattern: Pattern,
    /// The values of a declared number: as given, and rounded to single precision.
    either: [f64; 2],
}

impl Test {
    fn new(pattern: Pattern, cloud: &Cloud) -> Self {
        let either = match pattern {
            Pattern::Any(value) => [value, f64::from(value as f32)].map(|value| value * cloud.unit.in_mm()),
            Pattern::Point { .. } | Pattern::Z(_) => [f64::NAN; 2],
        };
        Self { pattern, either }
    }

    fn is_declared(&self, value: f64) -> bool {
        self.either.contains(&value)
    }

    /// Values of x that are not positions.
    fn codes(&self, extent: &Extent) -> Vec<f64> {
        match self.pattern {
            Pattern::Any(_) => self.either.to_vec(),
            Pattern::Point { .. } => extent.common().into_iter().collect(),
            Pattern::Z(_) => Vec::new(),
        }
    }

    /// Clears the flags of the stripe's points that match and are still set, and calls `taken` with the x of each.
    fn mark(
        &self,
        columns: &Columns,
        stripe: &Stripe,
        range: Range<usize>,
        flags: &mut [bool],
        mut taken: impl FnMut(f64),
    ) {
        let declared_x = self.is_declared(stripe.x);
        let mut mark = |matches: &dyn Fn(usize) -> bool| {
            for (flag, index) in flags.iter_mut().zip(range.clone()) {
                if *flag && matches(index) {
                    *flag = false;
                    taken(stripe.x);
                }
            }
        };
        let at = |index: usize| columns.get(index).unwrap_or([f64::NAN; 2]);
        match self.pattern {
            Pattern::Any(_) => mark(&|index| {
                let [y, z] = at(index);
                declared_x || self.is_declared(y) || self.is_declared(z)
            }),
            Pattern::Point { y, z } => mark(&|index| at(index) == [y, z]),
            Pattern::Z(z) => mark(&|index| at(index)[1] == z),
        }
    }
}

/// A value that marks missing points, mm.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum MissingKind {
    /// A declared value in x, y or z.
    Declared(f64),
    /// The same y and z, and the same `x` if it was equal everywhere.
    Point {
        /// x of all the points that were removed; `None` if they differ.
        x: Option<f64>,
        /// y.
        y: f64,
        /// z.
        z: f64,
    },
    /// The same z under different y.
    Z(f64),
}

/// A value that was taken as missing data, and the number of points that it removed.
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
        // Single precision has seven digits; the conversion to mm and back must not add more.
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

/// Removes the points whose flag in `keep` is false from both columns.
pub(super) fn retain(columns: &mut Columns, keep: &[bool]) {
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

/// Probability that repeats are reported for a scan without any.
const CHANCE_MAX: f64 = 1e-9;
/// Number of successive points for a profile's hash from each of two positions.
const HASHED: usize = 4;
/// Largest number of different profiles with one hash that are kept for comparison: bounds the time if all begin equally.
const ALIKE_MAX: usize = 8;
/// Fewer points may agree by chance; this also excludes clouds whose points have individual x.
const POINTS_MIN: usize = 8;

/// The cloud without repeated profiles, the number of these, and the number of all.
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

/// The profiles of at least [`POINTS_MIN`] points, as far as the file separates them, and the number of all: successive stripes of
/// one label, or single stripes without labels. A stripe with equal halves counts as two.
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

/// The share of points that agree in y and z with the point of the same index in the previous profile, over successive profiles
/// that are not equal; `None` if all are equal.
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
    // Two points are added, of which one agrees, so that few points do not give a rate of 0 (Laplace).
    (pairs > 0).then(|| (agreeing + 1) as f64 / (count + 2) as f64)
}

/// A hash of a profile's first points and of those in its middle: positions that the search for equal halves reads anyway, while
/// any other position would cost a further memory access.
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
