//! Groups the stripes of a cloud by key and puts the profiles in order of x. Columns that are in order already are
//! handed over as they are: copying those of a large scan would cost more than all the rest. Must not know the rules.

use super::SliceError;
use super::choose::Key;
use crate::scan::decode::Limits;
use crate::scan::{Cloud, Columns, Scan, Station, Stripe};
use std::ops::Range;

/// The scan of a cloud whose profiles share a key.
pub(super) fn group(cloud: Cloud, key: Key, rule: String, limits: &Limits) -> Result<Scan, SliceError> {
    if let Some(stations) = in_file_order(&cloud.stripes, key, limits)? {
        return Ok(Scan::new(stations, cloud.columns, rule)?.with_blanks(cloud.blanks));
    }
    let (stations, columns) = in_x_order(&cloud, key, limits)?;
    Ok(Scan::new(stations, columns, rule)?.with_blanks(cloud.blanks))
}

/// A profile in the making: the mean of x as an offset from its first x, so that equal values give themselves.
struct Profile {
    key: f64,
    first_x: f64,
    offsets: f64,
    points: usize,
}

impl Profile {
    fn new(key: f64, first_x: f64) -> Self {
        Self { key, first_x, offsets: 0.0, points: 0 }
    }

    fn take(&mut self, x: f64, points: usize) {
        self.offsets += (x - self.first_x) * points as f64;
        self.points += points;
    }

    /// Its plane and its size, where that is allowed.
    fn close(&self, limits: &Limits) -> Result<f64, SliceError> {
        let x = self.first_x + self.offsets / self.points as f64;
        let limit = limits.points_per_profile_max;
        if self.points > limit { Err(SliceError::ProfileTooLong { x, found: self.points, limit }) } else { Ok(x) }
    }
}

/// The stripes, each with the range of its points.
fn with_ranges(stripes: &[Stripe]) -> impl Iterator<Item = (&Stripe, Range<usize>)> {
    let mut start = 0;
    stripes.iter().map(move |stripe| (stripe, std::mem::replace(&mut start, stripe.end)..stripe.end))
}

/// The profiles as they lie in the file; `None` where a key comes back or x falls, so that points have to move.
fn in_file_order(stripes: &[Stripe], key: Key, limits: &Limits) -> Result<Option<Vec<Station>>, SliceError> {
    let mut stations: Vec<Station> = Vec::new();
    let mut open: Option<Profile> = None;
    let mut end = 0;
    // Closes a profile; false where it lies behind its predecessor.
    let mut close = |profile: &Profile, end: usize| {
        let x = profile.close(limits)?;
        let in_order = stations.last().is_none_or(|last| last.x <= x);
        stations.push(Station { x, start: end - profile.points, end });
        if stations.len() > limits.profiles_max {
            return Err(SliceError::TooManyProfiles { limit: limits.profiles_max });
        }
        Ok(in_order)
    };
    for (stripe, range) in with_ranges(stripes) {
        let of_stripe = key.of(stripe);
        if let Some(profile) = open.take_if(|profile| profile.key != of_stripe) {
            // Keys that rise do not come back.
            if of_stripe < profile.key || !close(&profile, end)? {
                return Ok(None);
            }
        }
        end = range.end;
        open.get_or_insert_with(|| Profile::new(of_stripe, stripe.x)).take(stripe.x, range.len());
    }
    match open {
        Some(profile) if !close(&profile, end)? => Ok(None),
        _ => Ok(Some(stations)),
    }
}

/// The profiles in order of x, their points brought together.
fn in_x_order(cloud: &Cloud, key: Key, limits: &Limits) -> Result<(Vec<Station>, Columns), SliceError> {
    let mut pieces: Vec<(f64, f64, Range<usize>)> =
        with_ranges(&cloud.stripes).map(|(stripe, range)| (key.of(stripe), stripe.x, range)).collect();
    // Stable, so that the points of a profile keep their order.
    pieces.sort_by(|(a, ..), (b, ..)| a.total_cmp(b));
    let mut profiles = Vec::new();
    for pieces in pieces.chunk_by(|(a, ..), (b, ..)| a == b) {
        let Some((key, first_x, _)) = pieces.first() else { continue };
        let mut profile = Profile::new(*key, *first_x);
        pieces.iter().for_each(|(_, x, range)| profile.take(*x, range.len()));
        profiles.push((profile.close(limits)?, pieces));
        if profiles.len() > limits.profiles_max {
            return Err(SliceError::TooManyProfiles { limit: limits.profiles_max });
        }
    }
    profiles.sort_by(|(a, _), (b, _)| a.total_cmp(b));

    let mut stations = Vec::with_capacity(profiles.len());
    let mut start = 0;
    for (x, pieces) in &profiles {
        let end = start + pieces.iter().map(|(_, _, range)| range.len()).sum::<usize>();
        stations.push(Station { x: *x, start: std::mem::replace(&mut start, end), end });
    }
    let order = || profiles.iter().flat_map(|(_, pieces)| pieces.iter().map(|(_, _, range)| range.clone()));
    let columns = match &cloud.columns {
        Columns::F32 { y, z } => Columns::F32 { y: reorder(y, order()), z: reorder(z, order()) },
        Columns::F64 { y, z } => Columns::F64 { y: reorder(y, order()), z: reorder(z, order()) },
    };
    Ok((stations, columns))
}

fn reorder<T: Copy>(values: &[T], order: impl Iterator<Item = Range<usize>>) -> Vec<T> {
    let mut moved = Vec::with_capacity(values.len());
    order.for_each(|range| moved.extend_from_slice(values.get(range).unwrap_or_default()));
    moved
}
