//! Groups the stripes of a cloud by key and puts the profiles in order of x. Columns that are in order already are handed over
//! as they are: copying those of a large scan would cost more than everything else.
//!
//! In a cloud in no order every point is a stripe. Reading the stripes in the order of the file and writing each to the end of
//! its profile touches as many places as there are profiles; visiting them in the order of the profiles touches as many as
//! there are points, and most of those are not in the cache.

use super::SliceError;
use super::choose::Key;
use crate::scan::cloud::{Cloud, Stripe};
use crate::scan::columns::Columns;
use crate::scan::decode::Limits;
use crate::scan::{Scan, Station};
use std::ops::Range;

/// The scan of a cloud whose profiles share a key.
pub(super) fn group(cloud: Cloud, key: Key, rule: String, limits: &Limits) -> Result<Scan, SliceError> {
    let Cloud { stripes, columns, blanks, .. } = cloud;
    let groups = Groups::of(&stripes, key, limits)?;
    let own_x = |order: &[usize]| groups.gather(order, |stripe, _, x: &mut [f64]| x.fill(stripe.x));
    let in_key_order: Vec<usize> = (0..groups.sizes.len()).collect();
    let x_by_key = (!groups.are_planar()).then(|| own_x(&in_key_order));
    let x = match &x_by_key {
        Some(own_x) => groups.ranges(&in_key_order).into_iter().map(|range| median(own_x, range)).collect(),
        None => groups.first_x.clone(),
    };
    groups.check_sizes(&x, limits)?;
    let order = ascending(&x);
    let is_key_order = order == in_key_order;
    let columns = match columns {
        columns if is_key_order && groups.are_in_file_order() => columns,
        Columns::F32 { y, z } => {
            Columns::F32 { y: groups.gather_values(&order, &y), z: groups.gather_values(&order, &z) }
        }
        Columns::F64 { y, z } => {
            Columns::F64 { y: groups.gather_values(&order, &y), z: groups.gather_values(&order, &z) }
        }
    };
    let ranges = groups.ranges(&order).into_iter();
    let x_of = |group: &usize| x.get(*group).copied().unwrap_or(0.0);
    let station = |(range, group): (Range<usize>, _)| Station { x: x_of(group), start: range.start, end: range.end };
    let stations = ranges.zip(&order).map(station).collect();
    let scan = Scan::new(stations, columns, rule)?.with_blanks(blanks);
    Ok(match x_by_key {
        Some(own_x) if is_key_order => scan.with_own_x(own_x)?,
        Some(_) => scan.with_own_x(own_x(&order))?,
        None => scan,
    })
}

/// The profiles of a cloud in the order of their keys.
struct Groups<'a> {
    stripes: &'a [Stripe],
    /// The profile of each stripe.
    of_stripes: Vec<usize>,
    /// Points of each profile, and the x of its first stripe, mm.
    sizes: Vec<usize>,
    first_x: Vec<f64>,
}

impl<'a> Groups<'a> {
    fn of(stripes: &'a [Stripe], key: Key, limits: &Limits) -> Result<Self, SliceError> {
        let keys: Vec<f64> = stripes.iter().map(|stripe| key.of(stripe)).collect();
        let mut distinct = keys.clone();
        distinct.dedup();
        distinct.sort_unstable_by(f64::total_cmp);
        distinct.dedup();
        if distinct.len() > limits.profiles_max {
            return Err(SliceError::TooManyProfiles { limit: limits.profiles_max });
        }
        let of_key = |key: &f64| distinct.partition_point(|other| other.total_cmp(key).is_lt());
        let of_stripes: Vec<usize> = keys.iter().map(of_key).collect();
        let mut groups =
            Self { stripes, of_stripes, sizes: vec![0; distinct.len()], first_x: vec![f64::NAN; distinct.len()] };
        let mut start = 0;
        for (stripe, group) in stripes.iter().zip(&groups.of_stripes) {
            let length = stripe.end.saturating_sub(std::mem::replace(&mut start, stripe.end));
            if let (Some(size), Some(x)) = (groups.sizes.get_mut(*group), groups.first_x.get_mut(*group)) {
                *size += length;
                *x = if x.is_nan() { stripe.x } else { *x };
            }
        }
        Ok(groups)
    }

    /// Whether the points of every profile share their x.
    fn are_planar(&self) -> bool {
        self.stripes.iter().zip(&self.of_stripes).all(|(stripe, group)| self.first_x.get(*group) == Some(&stripe.x))
    }

    fn are_in_file_order(&self) -> bool {
        self.of_stripes.is_sorted()
    }

    fn check_sizes(&self, x: &[f64], limits: &Limits) -> Result<(), SliceError> {
        let limit = limits.points_per_profile_max;
        match self.sizes.iter().zip(x).find(|(found, _)| **found > limit) {
            Some((found, x)) => Err(SliceError::ProfileTooLong { x: *x, found: *found, limit }),
            None => Ok(()),
        }
    }

    /// The points of the profiles that follow each other in `order`.
    fn ranges(&self, order: &[usize]) -> Vec<Range<usize>> {
        let sizes = order.iter().map(|group| self.sizes.get(*group).copied().unwrap_or(0));
        let mut end = 0;
        let range = |size| {
            let start = end;
            end += size;
            start..end
        };
        sizes.map(range).collect()
    }

    /// A value for every point, profile after profile in `order`; points of a profile keep the order of the file. `write`
    /// gets a stripe, its points in the cloud, and the place for their values.
    fn gather<T: Copy + Default>(&self, order: &[usize], write: impl Fn(&Stripe, Range<usize>, &mut [T])) -> Vec<T> {
        let mut ends = vec![0; self.sizes.len()];
        for (range, group) in self.ranges(order).into_iter().zip(order) {
            if let Some(end) = ends.get_mut(*group) {
                *end = range.start;
            }
        }
        let mut start = 0;
        let mut values = vec![T::default(); self.sizes.iter().sum()];
        for (stripe, group) in self.stripes.iter().zip(&self.of_stripes) {
            let points = std::mem::replace(&mut start, stripe.end)..stripe.end;
            let Some(end) = ends.get_mut(*group) else { continue };
            let place = std::mem::replace(end, *end + points.len());
            if let Some(place) = values.get_mut(place..*end) {
                write(stripe, points, place);
            }
        }
        values
    }

    fn gather_values<T: Copy + Default>(&self, order: &[usize], values: &[T]) -> Vec<T> {
        self.gather(order, |_, points, place| {
            if let Some(values) = values.get(points) {
                place.copy_from_slice(values);
            }
        })
    }
}

/// The median over the points: one point far away, such as a missing value, moves a mean by any length.
fn median(x: &[f64], range: Range<usize>) -> f64 {
    let mut values = x.get(range).unwrap_or_default().to_vec();
    let half = values.len() / 2;
    if half >= values.len() {
        return 0.0;
    }
    *values.select_nth_unstable_by(half, f64::total_cmp).1
}

/// The indices of `x` in the order of its values; equal ones keep their order.
fn ascending(x: &[f64]) -> Vec<usize> {
    let mut order: Vec<(usize, f64)> = (0..).zip(x.iter().copied()).collect();
    order.sort_by(|(_, a), (_, b)| a.total_cmp(b));
    order.into_iter().map(|(index, _)| index).collect()
}
