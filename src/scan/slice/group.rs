//! Groups the stripes of a cloud by key and puts the profiles in order of x. Columns that are in order already are handed over
//! as they are: copying those of a large scan would cost more than everything else.

use super::SliceError;
use super::choose::Key;
use crate::scan::decode::Limits;
use crate::scan::{Cloud, Columns, Scan, Station, Stripe};
use std::ops::Range;

/// The scan of a cloud whose profiles share a key.
pub(super) fn group(cloud: Cloud, key: Key, rule: String, limits: &Limits) -> Result<Scan, SliceError> {
    let pieces = pieces(&cloud.stripes, key);
    let in_file_order = pieces.is_sorted_by(|a, b| a.key <= b.key);
    let mut profiles = profiles(pieces, limits)?;
    let in_order = in_file_order && profiles.is_sorted_by(|a, b| a.x <= b.x);
    profiles.sort_by(|a, b| a.x.total_cmp(&b.x));
    let is_planar = profiles.iter().all(Profile::is_planar);
    let own_x = (!is_planar).then(|| profiles.iter().flat_map(Profile::own_x).collect::<Vec<f64>>());
    let mut start = 0;
    let station = |profile: &Profile| {
        let end = start + profile.points_count();
        Station { x: profile.x, start: std::mem::replace(&mut start, end), end }
    };
    let stations = profiles.iter().map(station).collect();
    let ranges = || profiles.iter().flat_map(|profile| profile.pieces.iter().map(|piece| piece.range.clone()));
    let columns = match cloud.columns {
        columns if in_order => columns,
        Columns::F32 { y, z } => Columns::F32 { y: reorder(&y, ranges()), z: reorder(&z, ranges()) },
        Columns::F64 { y, z } => Columns::F64 { y: reorder(&y, ranges()), z: reorder(&z, ranges()) },
    };
    let scan = Scan::new(stations, columns, rule)?.with_blanks(cloud.blanks);
    Ok(match own_x {
        Some(own_x) => scan.with_own_x(own_x)?,
        None => scan,
    })
}

/// A stripe of a profile.
struct Piece {
    key: f64,
    x: f64,
    /// Its points.
    range: Range<usize>,
}

fn pieces(stripes: &[Stripe], key: Key) -> Vec<Piece> {
    let mut start = 0;
    let piece = |stripe: &Stripe| Piece {
        key: key.of(stripe),
        x: stripe.x,
        range: std::mem::replace(&mut start, stripe.end)..stripe.end,
    };
    stripes.iter().map(piece).collect()
}

/// The stripes of one profile in the order of the file, and the median x of its points, mm.
struct Profile {
    x: f64,
    pieces: Vec<Piece>,
}

/// The stripes brought together by their key, in the order of the keys.
fn profiles(mut pieces: Vec<Piece>, limits: &Limits) -> Result<Vec<Profile>, SliceError> {
    // Stable, so that the points of a profile keep their order.
    pieces.sort_by(|a, b| a.key.total_cmp(&b.key));
    let mut profiles: Vec<Profile> = Vec::new();
    let mut pieces = pieces.into_iter().peekable();
    while let Some(first) = pieces.next() {
        let key = first.key;
        let mut of_profile = vec![first];
        while let Some(piece) = pieces.next_if(|piece| piece.key == key) {
            of_profile.push(piece);
        }
        let profile = Profile { x: median_x(&of_profile), pieces: of_profile };
        let (found, limit) = (profile.points_count(), limits.points_per_profile_max);
        if found > limit {
            return Err(SliceError::ProfileTooLong { x: profile.x, found, limit });
        }
        profiles.push(profile);
        if profiles.len() > limits.profiles_max {
            return Err(SliceError::TooManyProfiles { limit: limits.profiles_max });
        }
    }
    Ok(profiles)
}

impl Profile {
    fn points_count(&self) -> usize {
        self.pieces.iter().map(|piece| piece.range.len()).sum()
    }

    fn is_planar(&self) -> bool {
        self.pieces.iter().all(|piece| piece.x == self.x)
    }

    /// The x of its points.
    fn own_x(&self) -> impl Iterator<Item = f64> + '_ {
        self.pieces.iter().flat_map(|piece| std::iter::repeat_n(piece.x, piece.range.len()))
    }
}

/// The median over the points: one point far away, such as a missing value, moves a mean by any length.
fn median_x(pieces: &[Piece]) -> f64 {
    let mut places: Vec<(f64, usize)> = pieces.iter().map(|piece| (piece.x, piece.range.len())).collect();
    places.sort_unstable_by(|(a, _), (b, _)| a.total_cmp(b));
    let half = places.iter().map(|(_, count)| count).sum::<usize>() / 2;
    let mut before = 0;
    let holds_middle = |(_, count): &&(f64, usize)| {
        before += count;
        before > half
    };
    places.iter().find(holds_middle).map_or(0.0, |(x, _)| *x)
}

fn reorder<T: Copy>(values: &[T], order: impl Iterator<Item = Range<usize>>) -> Vec<T> {
    let mut moved = Vec::with_capacity(values.len());
    order.for_each(|range| moved.extend_from_slice(values.get(range).unwrap_or_default()));
    moved
}
