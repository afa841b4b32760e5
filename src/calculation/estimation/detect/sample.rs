//! The points that the search works on: a random sample of bounded size, moved to the middle of the cloud and divided by
//! the cloud's size, so that no unit and no position matters.

use nalgebra::Vector3;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Points that the search works on. A part that holds 2 % of the cloud still has 160 of them.
const POINTS_MAX: usize = 8192;
/// Share of the sampled points within the size; the others are far outliers or a distant background.
const WITHIN_SIZE: f64 = 0.9;
/// Farther points, in sizes of the cloud, are sentinel values.
const FARTHEST: f64 = 1e6;
const SEED: u64 = 0x5eed;

/// Points in random order, so that every prefix is a random sample of the cloud.
pub(super) struct Sample {
    pub(super) points: Vec<Vector3<f64>>,
    /// Position of the origin of the points in the cloud.
    pub(super) origin: Vector3<f64>,
    /// Length in the cloud that is 1 here.
    pub(super) size: f64,
    /// Points that were drawn, those left out as sentinel values too.
    pub(super) drawn_count: usize,
}

impl Sample {
    /// Of a cloud of `count` points, given by their positions; `None` where it has no extent.
    pub(super) fn take(count: usize, point: impl Fn(usize) -> Option<[f64; 3]>) -> Option<Self> {
        let finite = |point: &[f64; 3]| point.iter().all(|v| v.is_finite());
        let mut chance = ChaCha8Rng::seed_from_u64(SEED);
        let mut drawn = draw(count, &point, &mut chance);
        if !drawn.iter().all(finite) {
            let cloud: Vec<[f64; 3]> = (0..count).filter_map(&point).filter(finite).collect();
            drawn = draw(cloud.len(), |place| cloud.get(place).copied(), &mut chance);
        }
        for last in (1..drawn.len()).rev() {
            drawn.swap(last, chance.random_range(0..=last));
        }
        let drawn: Vec<Vector3<f64>> = drawn.into_iter().map(Vector3::from).collect();
        let origin = Vector3::new(
            quantile(drawn.iter().map(|p| p.x), 0.5)?,
            quantile(drawn.iter().map(|p| p.y), 0.5)?,
            quantile(drawn.iter().map(|p| p.z), 0.5)?,
        );
        let radii = || drawn.iter().map(|p| (p - origin).norm());
        let usual = quantile(radii(), WITHIN_SIZE).filter(|usual| *usual > 0.0);
        let size = 2.0 * usual.or_else(|| quantile(radii(), 1.0))?;
        let points: Vec<Vector3<f64>> =
            drawn.iter().map(|p| (p - origin) / size).filter(|p| p.norm() < FARTHEST).collect();
        (size > 0.0 && size.is_finite()).then_some(Self { points, origin, size, drawn_count: drawn.len() })
    }
}

/// One point of each of equal stretches of the file, at a random place: a fixed stride would resonate with the rows of an
/// organised cloud.
fn draw(count: usize, point: impl Fn(usize) -> Option<[f64; 3]>, chance: &mut ChaCha8Rng) -> Vec<[f64; 3]> {
    let taken = count.min(POINTS_MAX);
    let place = |i: usize| i * count / taken.max(1);
    (0..taken).filter_map(|i| point(chance.random_range(place(i)..place(i + 1)))).collect()
}

/// The value below which this share of the values lies.
pub(super) fn quantile(values: impl Iterator<Item = f64>, share: f64) -> Option<f64> {
    let mut values: Vec<f64> = values.collect();
    let place = (share * values.len().checked_sub(1)? as f64).round() as usize;
    let (_, value, _) = values.select_nth_unstable_by(place, f64::total_cmp);
    Some(*value)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sample_of(cloud: &[[f64; 3]]) -> Option<Sample> {
        Sample::take(cloud.len(), |place| cloud.get(place).copied())
    }

    #[test]
    fn a_cloud_without_extent_has_no_sample() {
        assert!(sample_of(&[]).is_none());
        assert!(sample_of(&[[1.0, 2.0, 3.0]; 100]).is_none());
        assert!(sample_of(&[[f64::NAN; 3]; 100]).is_none());
    }

    #[test]
    fn points_that_are_not_finite_and_sentinels_are_left_out() {
        let mut cloud: Vec<[f64; 3]> = (0..100).map(|i| [f64::from(i), 0.0, 0.0]).collect();
        cloud.extend([[f64::NAN, 0.0, 0.0], [f64::INFINITY, 0.0, 0.0], [1e30, 0.0, 0.0]]);
        let sample = sample_of(&cloud).expect("a sample");
        assert_eq!((sample.points.len(), sample.drawn_count), (100, 101));
    }
}
