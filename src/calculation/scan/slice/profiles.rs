//! The rule that separates the profiles of a cloud, the key that it gives each stripe, and the grouping of the stripes by that key
//! into profiles in order of x. Columns that are already in order are passed on unchanged, because copying those of a large scan
//! would cost more than all other steps.
//!
//! In an unordered cloud every point is a stripe. Reading the stripes in the order of the file and writing each to the end of its
//! profile accesses as many memory positions as there are profiles; reading them in the order of the profiles accesses as many as
//! there are points, most of which are not in the cache.

use super::error::SliceError;
use crate::scan::cloud::{Cloud, Labels, Stripe};
use crate::scan::columns::Columns;
use crate::scan::decode::Limits;
use crate::scan::rule::ProfileRule;
use crate::scan::{Grouping, Scan, Station};
use std::ops::Range;

/// Largest spread of x along a row, in steps between rows, for a row to be a profile.
const ROW_SPREAD_MAX: f64 = 0.1;
/// Least mean number of points of one x for x to be discrete.
const POINTS_PER_VALUE_MIN: usize = 8;
/// Mean number of points of a slab of automatically chosen thickness: enough for a section, few enough to keep the slab thin.
const POINTS_PER_SLAB: f64 = 100.0;
/// With fewer points slabs would be too few or too thick: moving a tracker's eight points to common planes would falsify them,
/// while each is exact as a profile of its own.
const SLAB_POINTS_MIN: usize = 1000;

/// The property that stripes of one profile share.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Key {
    /// The label.
    Label,
    /// The x.
    X,
    /// The slab of this thickness, mm; slab k extends from (k − ½) to (k + ½) times it, so that values that jitter about its
    /// multiples stay together.
    Slab(f64),
}

impl Key {
    /// The key of a stripe.
    pub(super) fn of(self, stripe: &Stripe) -> f64 {
        // Adding zero turns −0 into 0.
        match self {
            Self::Label => stripe.label + 0.0,
            Self::X => stripe.x + 0.0,
            Self::Slab(pitch) => (stripe.x / pitch + 0.5).floor() + 0.0,
        }
    }
}

/// The key, and the rule in words.
pub(super) fn choose_key(
    cloud: &Cloud,
    asked: Option<&ProfileRule>,
    limits: &Limits,
) -> Result<(Key, String), SliceError> {
    match asked {
        Some(ProfileRule::Column(wanted)) => by_column(cloud, wanted.as_deref()),
        Some(ProfileRule::Row) if cloud.labels == Labels::Row => Ok(by_row()),
        Some(ProfileRule::Row) => Err(SliceError::NoRows),
        Some(ProfileRule::XValue) => Ok(by_value()),
        Some(ProfileRule::XPitch(Some(pitch))) => by_pitch(cloud, *pitch, limits),
        Some(ProfileRule::XPitch(None)) => Ok(by_chosen_pitch(cloud, limits)),
        None => match &cloud.labels {
            Labels::Column(_) if labels_are_profiles(cloud) => by_column(cloud, None),
            Labels::Column(name) => {
                let (key, rule) = by_x(cloud, limits);
                let reason = format!("the column {name} does not separate profiles");
                let rule = match rule.strip_suffix(')') {
                    Some(rule) => format!("{rule}; {reason})"),
                    None => format!("{rule} ({reason})"),
                };
                Ok((key, rule))
            }
            Labels::Row if rows_are_profiles(&cloud.stripes) => Ok(by_row()),
            _ => Ok(by_x(cloud, limits)),
        },
    }
}

/// The origin of the grouping of a cloud if no rule was requested.
pub(super) fn grouping(cloud: &Cloud) -> Grouping {
    match &cloud.labels {
        Labels::Column(_) if labels_are_profiles(cloud) => Grouping::Given,
        Labels::Row if rows_are_profiles(&cloud.stripes) => Grouping::Given,
        _ if x_is_discrete(cloud) => Grouping::SharedX,
        _ => Grouping::Chosen,
    }
}

fn by_x(cloud: &Cloud, limits: &Limits) -> (Key, String) {
    if x_is_discrete(cloud) {
        return by_value();
    }
    match cloud.columns.len() < SLAB_POINTS_MIN {
        true => (Key::X, format!("{} (chosen)", ProfileRule::XValue)),
        false => by_chosen_pitch(cloud, limits),
    }
}

fn by_row() -> (Key, String) {
    (Key::Label, ProfileRule::Row.to_string())
}

fn by_value() -> (Key, String) {
    (Key::X, ProfileRule::XValue.to_string())
}

fn by_column(cloud: &Cloud, wanted: Option<&str>) -> Result<(Key, String), SliceError> {
    match &cloud.labels {
        Labels::Column(name) if wanted.is_none_or(|wanted| wanted.trim().eq_ignore_ascii_case(name)) => {
            Ok((Key::Label, ProfileRule::Column(Some(name.clone())).to_string()))
        }
        labels => {
            let found = if let Labels::Column(name) = labels { name.clone() } else { "none".to_owned() };
            Err(SliceError::NoColumn { wanted: ProfileRule::Column(wanted.map(str::to_owned)).to_string(), found })
        }
    }
}

/// Smallest and largest x of a cloud.
fn extent(cloud: &Cloud) -> (f64, f64) {
    let bounds = (f64::INFINITY, f64::NEG_INFINITY);
    cloud.stripes.iter().fold(bounds, |(least, most), stripe| (least.min(stripe.x), most.max(stripe.x)))
}

fn by_pitch(cloud: &Cloud, pitch: f64, limits: &Limits) -> Result<(Key, String), SliceError> {
    if !(pitch.is_finite() && pitch > 0.0) {
        return Err(SliceError::PitchInvalid);
    }
    let (least, most) = extent(cloud);
    let slabs = ((most - least) / pitch).floor() + 1.0;
    if slabs > limits.profiles_max as f64 {
        let least = round_up((most - least) / limits.profiles_max as f64);
        return Err(SliceError::PitchTooSmall { pitch, slabs, limit: limits.profiles_max, least });
    }
    Ok((Key::Slab(pitch), ProfileRule::XPitch(Some(pitch)).to_string()))
}

/// Slabs of about [`POINTS_PER_SLAB`] points, at most the allowed number of slabs.
fn by_chosen_pitch(cloud: &Cloud, limits: &Limits) -> (Key, String) {
    let (least, most) = extent(cloud);
    let length = most - least;
    let wanted = round_down(length * POINTS_PER_SLAB / cloud.columns.len() as f64);
    let allowed = round_up(length / limits.profiles_max as f64);
    // A single plane has no thickness; any pitch will do.
    let pitch = if length > 0.0 { wanted.max(allowed) } else { 1.0 };
    (Key::Slab(pitch), format!("{} (chosen)", ProfileRule::XPitch(Some(pitch))))
}

/// The largest of 1, 2, 2.5, 5·10ⁿ that is not above `value`.
fn round_down(value: f64) -> f64 {
    round(value, |step, value| step <= value * (1.0 + 1e-9), f64::max)
}

/// The smallest of 1, 2, 2.5, 5·10ⁿ that is not below `value`.
fn round_up(value: f64) -> f64 {
    round(value, |step, value| step >= value * (1.0 - 1e-9), f64::min)
}

fn round(value: f64, fits: impl Fn(f64, f64) -> bool, better: impl Fn(f64, f64) -> f64) -> f64 {
    // Below any length of a scan; keeps the powers within the range that f64 divides exactly.
    let value = value.max(1e-9);
    let decade = value.log10().floor() as i32;
    let power = |exponent: i32, step: f64| {
        // Dividing by an exact power gives the number nearest to the decimal: 0.1 and not 0.1 + 1e-17.
        if exponent < 0 { step / 10f64.powi(-exponent) } else { step * 10f64.powi(exponent) }
    };
    let steps = (decade - 1..=decade + 1).flat_map(|exponent| [1.0, 2.0, 2.5, 5.0].map(|step| power(exponent, step)));
    steps.filter(|step| fits(*step, value)).reduce(better).unwrap_or(value)
}

/// Whether the labels of a column separate profiles: half of a label's points are closer to the label's x than half of the labels
/// are to each other, and a label does not have several planes of many points.
///
/// Medians, because single points of a profile may have any x. A laser plane that is not perpendicular to the rail spreads the x of
/// a profile, but gives every point an individual one.
fn labels_are_profiles(cloud: &Cloud) -> bool {
    let labels_count = cloud.stripes.chunk_by(|a, b| a.label == b.label).count();
    if labels_count == cloud.stripes.len() && labels_count > 1 {
        // Usually each label has one x.
        let is_sorted = cloud.stripes.is_sorted_by(|a, b| a.label < b.label);
        if is_sorted {
            return true;
        }
    }
    let mut pieces = some_pieces(&cloud.stripes);
    pieces.sort_unstable_by(|a, b| a.label.total_cmp(&b.label).then(a.x.total_cmp(&b.x)));
    let (mut within, mut middles, mut most_shares) = (Vec::new(), Vec::new(), Vec::new());
    for label in pieces.chunk_by(|a, b| a.label == b.label) {
        let middle = median(label.iter().map(|piece| (piece.x, piece.points)).collect());
        let most = label.chunk_by(|a, b| a.x == b.x).map(points_of).fold(0.0, f64::max);
        within.extend(label.iter().map(|piece| ((piece.x - middle).abs(), piece.points)));
        middles.push((middle, 1.0));
        most_shares.push((most / points_of(label), 1.0));
    }
    let within = median(within);
    let middle = median(middles.clone());
    let between = median(middles.iter().map(|(x, weight)| ((x - middle).abs(), *weight)).collect());
    let is_together = within == 0.0 || within < between;
    is_together && !(median(most_shares) <= 0.5 && x_is_discrete(cloud))
}

/// Points of one label and x.
#[derive(Debug, Clone, Copy)]
struct Piece {
    label: f64,
    x: f64,
    points: f64,
}

fn points_of(pieces: &[Piece]) -> f64 {
    pieces.iter().map(|piece| piece.points).sum()
}

/// The stripes, or an even selection of very many, which is enough for medians.
fn some_pieces(stripes: &[Stripe]) -> Vec<Piece> {
    const PIECES_MAX: usize = 1 << 18;
    // An odd step, so that it does not coincide with profiles of an even number of points.
    let step = (stripes.len() / PIECES_MAX + 1) | 1;
    let piece = |index: usize| {
        let stripe = stripes.get(index)?;
        let start = index.checked_sub(1).and_then(|before| stripes.get(before)).map_or(0, |before| before.end);
        Some(Piece { label: stripe.label + 0.0, x: stripe.x, points: stripe.end.saturating_sub(start) as f64 })
    };
    (0..stripes.len()).step_by(step).filter_map(piece).collect()
}

/// The weighted median; 0 without weight.
fn median(mut weighted: Vec<(f64, f64)>) -> f64 {
    weighted.sort_unstable_by(|(a, _), (b, _)| a.total_cmp(b));
    let half = 0.5 * weighted.iter().map(|(_, weight)| weight).sum::<f64>();
    let mut sum = 0.0;
    let middle = weighted.iter().find(|(_, weight)| {
        sum += weight;
        sum >= half
    });
    middle.map_or(0.0, |(value, _)| *value)
}

/// Whether x varies little along every row relative to the usual step between rows.
fn rows_are_profiles(stripes: &[Stripe]) -> bool {
    let rows: Vec<(f64, f64)> = stripes
        .chunk_by(|a, b| a.label == b.label)
        .map(|row| row.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), s| (a.min(s.x), b.max(s.x))))
        .collect();
    let spread = rows.iter().fold(0.0, |spread: f64, (least, most)| spread.max(most - least));
    let middle = |(least, most): &(f64, f64)| f64::midpoint(*least, *most);
    let mut steps: Vec<f64> =
        rows.windows(2).filter_map(|pair| Some((middle(pair.first()?) - middle(pair.last()?)).abs())).collect();
    steps.sort_unstable_by(f64::total_cmp);
    let step = steps.get(steps.len() / 2).copied().unwrap_or(0.0);
    spread <= ROW_SPREAD_MAX * step
}

fn x_is_discrete(cloud: &Cloud) -> bool {
    let values_max = cloud.columns.len() / POINTS_PER_VALUE_MIN;
    if cloud.stripes.len() <= values_max {
        return true;
    }
    let mut values: Vec<f64> = cloud.stripes.iter().map(|stripe| Key::X.of(stripe)).collect();
    values.sort_unstable_by(f64::total_cmp);
    values.dedup();
    values.len() <= values_max
}

/// The scan of a cloud whose profiles share a key.
pub(super) fn group(cloud: Cloud, key: Key, rule: String, limits: &Limits) -> Result<Scan, SliceError> {
    let Cloud { stripes, columns, blanks, .. } = cloud;
    let groups = Groups::of(&stripes, key, limits)?;
    let own_x = |order: &[usize]| groups.gather(order, |stripe, _, x: &mut [f64]| x.fill(stripe.x));
    let in_key_order: Vec<usize> = (0..groups.sizes.len()).collect();
    let x_by_key = (!groups.are_planar()).then(|| own_x(&in_key_order));
    let x = match &x_by_key {
        Some(own_x) => groups.ranges(&in_key_order).into_iter().map(|range| median_within(own_x, range)).collect(),
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

    /// A value for every point, profile by profile in `order`; points of a profile keep the order of the file. `write` gets a
    /// stripe, its points in the cloud, and the destination of their values.
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

/// The median over the points, because one far point, such as a missing value, moves a mean by any length.
fn median_within(x: &[f64], range: Range<usize>) -> f64 {
    let mut values = x.get(range).unwrap_or_default().to_vec();
    let half = values.len() / 2;
    if half >= values.len() {
        return 0.0;
    }
    *values.select_nth_unstable_by(half, f64::total_cmp).1
}

/// The indices of `x` in ascending order of its values; equal ones keep their order.
fn ascending(x: &[f64]) -> Vec<usize> {
    let mut order: Vec<(usize, f64)> = (0..).zip(x.iter().copied()).collect();
    order.sort_by(|(_, a), (_, b)| a.total_cmp(b));
    order.into_iter().map(|(index, _)| index).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pitches_round_to_a_short_decimal() {
        for (value, down, up) in
            [(0.3, 0.25, 0.5), (0.1, 0.1, 0.1), (7.0, 5.0, 10.0), (2.4, 2.0, 2.5), (0.0099, 0.005, 0.01)]
        {
            assert_eq!((round_down(value), round_up(value)), (down, up), "{value}");
        }
        assert!(round_down(0.0) > 0.0);
    }

    #[test]
    fn values_that_jitter_about_a_multiple_share_a_slab() {
        let key = |x| Key::Slab(0.5).of(&Stripe { label: 0.0, x, end: 1 });
        assert_eq!((key(0.99), key(1.01), key(-0.01), key(0.01)), (2.0, 2.0, 0.0, 0.0));
    }
}
