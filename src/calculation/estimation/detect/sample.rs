//! The points that the search works on: a random sample of bounded size, moved to the middle of the cloud and divided by the size
//! of the cloud, so that the result depends neither on the unit nor on the position; and a k-d tree over them for nearest
//! neighbours.
//!
//! The tree is our own rather than a crate: the search needs the points themselves and no indices, and scanner data lie on lattices
//! with many equal coordinates, on which bucketed trees of fixed capacity fail. This tree handles equal coordinates without special
//! treatment, because a node splits its points by count.

use nalgebra::Vector3;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Points that the search works on. A part with 2 % of the cloud still has 160 of them.
const POINTS_MAX: usize = 8192;
/// Share of the sampled points that defines the size; the others are far outliers or a distant background.
const WITHIN_SIZE: f64 = 0.9;
/// Points farther than this, in sizes of the cloud, are sentinel values.
const FARTHEST: f64 = 1e6;
const SEED: u64 = 0x5eed;

/// Points in random order, so that every prefix is a random sample of the cloud.
pub(super) struct Sample {
    pub(super) points: Vec<Vector3<f64>>,
    /// The origin of the sample in the coordinates of the cloud.
    pub(super) origin: Vector3<f64>,
    /// The unit length of the sample in the unit of the cloud.
    pub(super) size: f64,
    /// Number of points that were drawn, including those left out as sentinel values.
    pub(super) drawn_count: usize,
}

impl Sample {
    /// Samples a cloud of `count` points, given by their positions; `None` if it has no extent.
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

/// One point at a random position of each of equal stretches of the file: a fixed stride would resonate with the rows of an
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

/// A range with fewer points is compared point by point.
const LEAF_POINTS_MAX: usize = 8;

/// Points in tree order: the middle one splits the range on the axis of the range's depth.
pub(super) struct Tree {
    points: Vec<Vector3<f64>>,
}

impl Tree {
    pub(super) fn new(mut points: Vec<Vector3<f64>>) -> Self {
        arrange(&mut points, 0);
        Self { points }
    }

    /// The `count` points nearest to `query`, nearest first.
    pub(super) fn nearest(&self, query: &Vector3<f64>, count: usize) -> Vec<Vector3<f64>> {
        let mut found = Nearest { query: *query, count, sorted: Vec::with_capacity(count + 1) };
        visit(&self.points, 0, &mut found);
        found.sorted.into_iter().map(|(_, point)| point).collect()
    }
}

struct Nearest {
    query: Vector3<f64>,
    count: usize,
    sorted: Vec<(f64, Vector3<f64>)>,
}

impl Nearest {
    fn offer(&mut self, point: &Vector3<f64>) {
        let gap = (point - self.query).norm_squared();
        if gap >= self.reach() {
            return;
        }
        let place = self.sorted.partition_point(|(other, _)| *other <= gap);
        self.sorted.insert(place, (gap, *point));
        self.sorted.truncate(self.count);
    }

    /// Squared distance beyond which points are ignored.
    fn reach(&self) -> f64 {
        match self.sorted.last() {
            Some((farthest, _)) if self.sorted.len() >= self.count => *farthest,
            _ => f64::INFINITY,
        }
    }
}

fn along(point: &Vector3<f64>, depth: usize) -> f64 {
    match depth % 3 {
        0 => point.x,
        1 => point.y,
        _ => point.z,
    }
}

fn arrange(points: &mut [Vector3<f64>], depth: usize) {
    if points.len() <= LEAF_POINTS_MAX {
        return;
    }
    let middle = points.len() / 2;
    let (below, _, above) = points.select_nth_unstable_by(middle, |a, b| along(a, depth).total_cmp(&along(b, depth)));
    arrange(below, depth + 1);
    arrange(above, depth + 1);
}

fn visit(points: &[Vector3<f64>], depth: usize, found: &mut Nearest) {
    let (below, rest) = points.split_at(points.len() / 2);
    let Some((middle, above)) = rest.split_first().filter(|_| points.len() > LEAF_POINTS_MAX) else {
        points.iter().for_each(|point| found.offer(point));
        return;
    };
    let gap = along(&found.query, depth) - along(middle, depth);
    let (near, far) = if gap < 0.0 { (below, above) } else { (above, below) };
    visit(near, depth + 1, found);
    found.offer(middle);
    if gap * gap < found.reach() {
        visit(far, depth + 1, found);
    }
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

#[cfg(test)]
mod tree_tests {
    use super::*;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    #[test]
    fn finds_the_same_nearest_points_as_a_comparison_with_all_points() {
        let mut chance = ChaCha8Rng::seed_from_u64(1);
        // On a lattice many coordinates are equal.
        let mut coordinate = || f64::from(chance.random_range(0..12_i32));
        let points: Vec<Vector3<f64>> = (0..900).map(|_| Vector3::from_fn(|_, _| coordinate())).collect();
        let tree = Tree::new(points.clone());
        for query in points.iter().step_by(37) {
            let gaps = |found: &[Vector3<f64>]| found.iter().map(|p| (p - query).norm_squared()).collect::<Vec<_>>();
            let mut all = gaps(&points);
            all.sort_by(f64::total_cmp);
            assert_eq!(gaps(&tree.nearest(query, 20)), all[..20]);
        }
    }

    #[test]
    fn returns_all_points_if_fewer_are_available() {
        assert_eq!(Tree::new(vec![Vector3::zeros(); 50]).nearest(&Vector3::x(), 60).len(), 50);
        assert!(Tree::new(Vec::new()).nearest(&Vector3::x(), 6).is_empty());
    }
}
