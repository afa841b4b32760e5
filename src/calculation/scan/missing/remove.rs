//! Removes the points that match a pattern.

use super::find::Pattern;
use super::{MissingKind, MissingValue, retain};
use crate::scan::cloud::{Cloud, Labels, Stripe};
use crate::scan::columns::Columns;
use std::collections::{HashMap, HashSet};
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

    /// The x that all of them have.
    fn common(&self) -> Option<f64> {
        (self.count > 0 && self.least == self.most).then_some(self.least)
    }
}

/// The cloud without the points that match one of the patterns, and the count of each pattern that removed any.
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
    // A plane in which every removed point of a pattern lies is part of the pattern, not a place.
    let codes: Vec<f64> = tests.iter().zip(&extents).flat_map(|(test, extent)| test.codes(extent)).collect();
    let mut cloud = without(cloud, &keep, &codes);
    cloud.missing_count += values.iter().map(|value| value.count).sum::<u64>();
    (cloud, values)
}

/// The cloud without the points whose flag is false. Emptied profiles become blanks at their mean x; stripes at one of the
/// `codes` have no place.
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
    // As while decoding: without labels the file does not say which points make a profile.
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
    /// The values of a declared number: as it is, and as a file of single precision holds it.
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

    /// Values of x that are no places.
    fn codes(&self, extent: &Extent) -> Vec<f64> {
        match self.pattern {
            Pattern::Any(_) => self.either.to_vec(),
            Pattern::Point { .. } => extent.common().into_iter().collect(),
            Pattern::Z(_) => Vec::new(),
        }
    }

    /// Clears the flags of the stripe's points that match and were not cleared before, each told to `taken` with its x.
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
