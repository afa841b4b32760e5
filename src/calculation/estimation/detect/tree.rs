//! A k-d tree over points that answers k-nearest-neighbour queries.
//!
//! It is an array of our own rather than a crate: the search needs the points themselves and no indices, and scanner data
//! lie on lattices with many equal coordinates, on which bucketed trees of fixed capacity fail. Equal coordinates are no
//! special case here, because a node splits its points by count.

use nalgebra::Vector3;

/// Fewer points than this are compared one by one.
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

    /// Squared distance beyond which no point is of interest.
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
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    #[test]
    fn finds_the_nearest_points_as_a_comparison_with_all_does() {
        let mut chance = ChaCha8Rng::seed_from_u64(1);
        // On a lattice most coordinates are equal.
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
    fn answers_with_all_points_where_there_are_fewer() {
        assert_eq!(Tree::new(vec![Vector3::zeros(); 50]).nearest(&Vector3::x(), 60).len(), 50);
        assert!(Tree::new(Vec::new()).nearest(&Vector3::x(), 6).is_empty());
    }
}
