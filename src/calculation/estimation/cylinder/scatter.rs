//! Scores of many cylinders over a few points of the whole scan, each with an x of its own.

use super::block::{BLOCK, LANES};
use super::projection::View;
use pulp::{Arch, Simd, WithSimd};

/// Points (x, y, z), mm.
#[derive(Debug, Clone, Default)]
pub(super) struct Scatter {
    x: Vec<f64>,
    y: Vec<f64>,
    z: Vec<f64>,
}

impl FromIterator<[f64; 3]> for Scatter {
    fn from_iter<I: IntoIterator<Item = [f64; 3]>>(points: I) -> Self {
        let mut scatter = Self::default();
        for [x, y, z] in points {
            scatter.x.push(x);
            scatter.y.push(y);
            scatter.z.push(z);
        }
        scatter
    }
}

impl Scatter {
    /// Mean of min(d²/`tolerance`², 1) over the points; 0 (best) to 1.
    pub(super) fn truncated_squares(&self, view: &View, tolerance: f64) -> f64 {
        let sum = Arch::new().dispatch(Truncate { scatter: self, view, per_tolerance2: 1.0 / (tolerance * tolerance) });
        sum / self.x.len().max(1) as f64
    }
}

struct Truncate<'a> {
    scatter: &'a Scatter,
    view: &'a View,
    per_tolerance2: f64,
}

impl WithSimd for Truncate<'_> {
    type Output = f64;

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) -> f64 {
        let (mut sums, mut shares) = ([0.0; LANES], [0.0; BLOCK]);
        let Scatter { x, y, z } = self.scatter;
        for ((x, y), z) in x.chunks(BLOCK).zip(y.chunks(BLOCK)).zip(z.chunks(BLOCK)) {
            for (share, ((&x, &y), &z)) in shares.iter_mut().zip(x.iter().zip(y).zip(z)) {
                let d = self.view.distance([x, y, z]);
                let squared = d * d * self.per_tolerance2;
                *share = if squared < 1.0 { squared } else { 1.0 };
            }
            // What an earlier block left beyond the last point does not count.
            shares.iter_mut().skip(x.len()).for_each(|share| *share = 0.0);
            for row in shares.as_chunks::<LANES>().0 {
                for (sum, share) in sums.iter_mut().zip(row) {
                    *sum += share;
                }
            }
        }
        sums.iter().sum()
    }
}

#[cfg(test)]
mod tests {
    use super::super::model::Cylinder;
    use super::*;
    use pulp::Scalar;

    #[test]
    fn the_score_is_that_of_the_points_one_by_one_with_the_same_bits_on_every_processor() {
        let cylinder = Cylinder { x_ref: 10.0, p: 0.1, q: 0.05, y_ref: 3.0, z_ref: -5.0, radius: 50.0 };
        let place = |i: i32| {
            let (x, angle) = (f64::from(i), 0.1 * f64::from(i % 31));
            let [y, z] = cylinder.axis().section(50.0 + 0.3 * (f64::from(i) * 1.7).sin(), x).point(angle);
            [x, y, z]
        };
        let points: Vec<[f64; 3]> = (0..173).map(place).collect();
        let scatter: Scatter = points.iter().copied().collect();
        let view = cylinder.facing([0.0, 1.0]);
        let one = |[x, y, z]: &[f64; 3]| (cylinder.slice(*x).distance(*y, *z) / 0.2).powi(2).min(1.0);
        let expected = points.iter().map(one).sum::<f64>() / 173.0;
        let found = scatter.truncated_squares(&view, 0.2);
        assert!(expected > 0.2 && (found - expected).abs() < 1e-9);
        let plain = Truncate { scatter: &scatter, view: &view, per_tolerance2: 1.0 / (0.2 * 0.2) }.with_simd(Scalar);
        assert_eq!(found.to_bits(), (plain / 173.0).to_bits());
    }
}
