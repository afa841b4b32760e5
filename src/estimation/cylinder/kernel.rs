//! The hot loops of the method: sums over the points of one profile, read as they are stored, eight at a time.
//! Must not know what the sums are for.
//!
//! Which instructions run is decided when the program runs: AVX-512, AVX2 or what every processor has. The bits of the
//! result are the same on all of them: eight partial sums in a fixed order, and no fused multiply-add. A block of points is
//! projected into a few arrays that stay in the first-level cache; each sum then runs over those, so that no loop needs
//! more running sums than a processor has registers.

use super::projection::Projection;
use pulp::{Arch, NullaryFnOnce};

const LANES: usize = 8;
const BLOCK: usize = 128;
/// Where a lane without a point lies, mm: beyond every cut-off.
const FAR: f64 = 1e12;
/// No angle on the scale of [`Inner::low`] and [`Inner::high`] lies beyond it.
const BEYOND: f64 = 4.0;

/// How a point bends the cost.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Curvature {
    /// By its weight w: never negative, so the step leads downhill from far away (iteratively re-weighted least squares).
    Weight,
    /// By the slope ψ′ of w·d: Newton's step, quadratic near the solution; also the bread of the sandwich covariance.
    Slope,
}

/// Sums over points with the direction (C, S) from the axis, the distance d from the surface, the axial offset s, Tukey's
/// weight w and the curvature k.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct Moments {
    /// Σ w,
    pub(super) weight: f64,
    /// Σ w·d, w·d·C, w·d·S, w·d·C·s and w·d·S·s,
    pub(super) pull: [f64; 5],
    /// Σ k, k·C, k·S, k·C², k·CS, k·C³, k·C²S, k·C⁴ and k·C³S: with C² + S² = 1 they are all moments to the fourth order.
    pub(super) bend: [f64; 9],
}

/// The points within ε of the surface.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Inner {
    pub(super) count: f64,
    /// Σ d², mm².
    pub(super) squared: f64,
    /// Least and largest angle from the facing direction on a scale that needs no arc tangent: sin θ on the near side,
    /// ±2 − sin θ beyond a right angle.
    pub(super) low: f64,
    pub(super) high: f64,
}

impl Inner {
    /// No point.
    pub(super) fn none() -> Self {
        Self { count: 0.0, squared: 0.0, low: BEYOND, high: -BEYOND }
    }
}

/// The moments of the points (y, z); `per_cut2` is the inverse square of Tukey's cut-off, mm⁻².
pub(super) fn moments<T: Copy + Into<f64>>(
    projection: &Projection,
    y: &[T],
    z: &[T],
    per_cut2: f64,
    curvature: Curvature,
) -> Moments {
    let sweep = Sweep { projection, y, z };
    match curvature {
        Curvature::Weight => Arch::new().dispatch(Weigh { sweep, per_cut2 }),
        Curvature::Slope => Arch::new().dispatch(Bend { sweep, per_cut2 }),
    }
}

/// The same by the slope, with what lies within ε, whose square is `epsilon2`.
pub(super) fn moments_and_inner<T: Copy + Into<f64>>(
    projection: &Projection,
    y: &[T],
    z: &[T],
    per_cut2: f64,
    epsilon2: f64,
) -> (Moments, Inner) {
    Arch::new().dispatch(BendAndCount { bend: Bend { sweep: Sweep { projection, y, z }, per_cut2 }, epsilon2 })
}

/// Calls `found` with the squared distances from the surface, mm², a block of points at a time.
pub(super) fn squared_distances<T: Copy + Into<f64>>(
    projection: &Projection,
    y: &[T],
    z: &[T],
    found: impl FnMut(&[f64]),
) {
    Arch::new().dispatch(Measure { sweep: Sweep { projection, y, z }, found });
}

/// Σ min(d²·`per_tolerance2`, 1).
pub(super) fn truncated_squares<T: Copy + Into<f64>>(
    projection: &Projection,
    y: &[T],
    z: &[T],
    per_tolerance2: f64,
) -> f64 {
    Arch::new().dispatch(Truncate { sweep: Sweep { projection, y, z }, per_tolerance2 })
}

/// The points of one profile and how they are looked at.
#[derive(Clone, Copy)]
struct Sweep<'a, T> {
    projection: &'a Projection,
    y: &'a [T],
    z: &'a [T],
}

/// A few projected points; lanes beyond the last lie far away.
struct Block {
    cos: [f64; BLOCK],
    sin: [f64; BLOCK],
    distance: [f64; BLOCK],
    lever: [f64; BLOCK],
    rows_count: usize,
}

struct Weigh<'a, T> {
    sweep: Sweep<'a, T>,
    per_cut2: f64,
}

struct Bend<'a, T> {
    sweep: Sweep<'a, T>,
    per_cut2: f64,
}

struct BendAndCount<'a, T> {
    bend: Bend<'a, T>,
    epsilon2: f64,
}

struct Measure<'a, T, F> {
    sweep: Sweep<'a, T>,
    found: F,
}

struct Truncate<'a, T> {
    sweep: Sweep<'a, T>,
    per_tolerance2: f64,
}

impl<T: Copy + Into<f64>> NullaryFnOnce for Weigh<'_, T> {
    type Output = Moments;

    #[inline(always)]
    fn call(self) -> Moments {
        let mut running = Running::new();
        self.sweep.each(|block| {
            running.pull(block, self.per_cut2);
            running.bend(block, |d2| {
                let rest = 1.0 - share(d2, self.per_cut2);
                rest * rest
            });
        });
        running.moments()
    }
}

impl<T: Copy + Into<f64>> NullaryFnOnce for Bend<'_, T> {
    type Output = Moments;

    #[inline(always)]
    fn call(self) -> Moments {
        let mut running = Running::new();
        self.sweep.each(|block| running.newton(block, self.per_cut2));
        running.moments()
    }
}

impl<T: Copy + Into<f64>> NullaryFnOnce for BendAndCount<'_, T> {
    type Output = (Moments, Inner);

    #[inline(always)]
    fn call(self) -> (Moments, Inner) {
        let (mut running, mut extremes) = (Running::new(), Extremes::new());
        let mut tallies = [[0.0; LANES]; 2];
        self.bend.sweep.each(|block| {
            running.newton(block, self.bend.per_cut2);
            block.accumulate(&mut tallies, |d, _, _, _| {
                let d2 = d * d;
                let inner = d2 < self.epsilon2;
                [if inner { 1.0 } else { 0.0 }, if inner { d2 } else { 0.0 }]
            });
            extremes.widen(block, self.epsilon2);
        });
        let [count, squared] = tallies.map(total);
        let (low, high) = extremes.ends();
        (running.moments(), Inner { count, squared, low, high })
    }
}

impl<T: Copy + Into<f64>, F: FnMut(&[f64])> NullaryFnOnce for Measure<'_, T, F> {
    type Output = ();

    #[inline(always)]
    fn call(mut self) {
        let mut squared = [0.0; BLOCK];
        self.sweep.each_distance(|distances| {
            for (squared, d) in squared.iter_mut().zip(distances) {
                *squared = d * d;
            }
            (self.found)(squared.get(..distances.len()).unwrap_or_default());
        });
    }
}

impl<T: Copy + Into<f64>> NullaryFnOnce for Truncate<'_, T> {
    type Output = f64;

    #[inline(always)]
    fn call(self) -> f64 {
        let mut sums = [0.0; LANES];
        self.sweep.each_distance(|distances| {
            let (rows, rest) = distances.as_chunks::<LANES>();
            for row in rows {
                for (sum, d) in sums.iter_mut().zip(row) {
                    *sum += share(d * d, self.per_tolerance2);
                }
            }
            for (sum, d) in sums.iter_mut().zip(rest) {
                *sum += share(d * d, self.per_tolerance2);
            }
        });
        total(sums)
    }
}

impl<T: Copy + Into<f64>> Sweep<'_, T> {
    /// Projects the points block by block.
    #[inline(always)]
    fn each(self, mut work: impl FnMut(&Block)) {
        let mut block = Block {
            cos: [0.0; BLOCK],
            sin: [0.0; BLOCK],
            distance: [FAR; BLOCK],
            lever: [0.0; BLOCK],
            rows_count: 0,
        };
        for (y, z) in self.y.chunks(BLOCK).zip(self.z.chunks(BLOCK)) {
            block.fill(self.projection, y, z);
            work(&block);
        }
    }

    /// Only the distances, block by block.
    #[inline(always)]
    fn each_distance(self, mut work: impl FnMut(&[f64])) {
        let mut distances = [0.0; BLOCK];
        for (y, z) in self.y.chunks(BLOCK).zip(self.z.chunks(BLOCK)) {
            for (d, (&y, &z)) in distances.iter_mut().zip(y.iter().zip(z)) {
                let [across, up] = self.projection.place(y.into(), z.into());
                *d = (across * across + up * up).sqrt() - self.projection.radius;
            }
            work(distances.get(..y.len().min(z.len())).unwrap_or_default());
        }
    }
}

impl Block {
    #[inline(always)]
    fn fill<T: Copy + Into<f64>>(&mut self, projection: &Projection, y: &[T], z: &[T]) {
        let count = y.len().min(z.len());
        let directions = self.cos.iter_mut().zip(&mut self.sin);
        let offsets = self.distance.iter_mut().zip(&mut self.lever);
        for (((cos, sin), (d, lever)), (&y, &z)) in directions.zip(offsets).zip(y.iter().zip(z)) {
            let [across, up] = projection.place(y.into(), z.into());
            let rho2 = across * across + up * up;
            let rho = if rho2 > f64::MIN_POSITIVE { rho2 } else { f64::MIN_POSITIVE }.sqrt();
            let per_rho = 1.0 / rho;
            (*cos, *sin, *d) = (across * per_rho, up * per_rho, rho - projection.radius);
            *lever = projection.axial(across, up);
        }
        self.distance.iter_mut().skip(count).for_each(|d| *d = FAR);
        self.rows_count = count.div_ceil(LANES);
    }

    /// Adds `terms` of every point (distance, cos, sin, lever) to its lane.
    #[inline(always)]
    fn accumulate<const N: usize>(
        &self,
        totals: &mut [[f64; LANES]; N],
        terms: impl Fn(f64, f64, f64, f64) -> [f64; N],
    ) {
        // In a local, so that the compiler keeps the sums in registers.
        let mut sums = *totals;
        let directions = self.cos.as_chunks::<LANES>().0.iter().zip(self.sin.as_chunks::<LANES>().0);
        let offsets = self.distance.as_chunks::<LANES>().0.iter().zip(self.lever.as_chunks::<LANES>().0);
        for ((cos, sin), (d, lever)) in directions.zip(offsets).take(self.rows_count) {
            for i in 0..LANES {
                #[expect(clippy::indexing_slicing, reason = "i runs over the constant length of the arrays")]
                let terms = terms(d[i], cos[i], sin[i], lever[i]);
                for (sum, term) in sums.iter_mut().zip(terms) {
                    #[expect(clippy::indexing_slicing, reason = "i runs over the constant length of the arrays")]
                    {
                        sum[i] += term;
                    }
                }
            }
        }
        *totals = sums;
    }
}

/// The lanes of [`Moments`].
struct Running {
    pull: [[f64; LANES]; 6],
    bend: [[f64; LANES]; 9],
}

impl Running {
    #[inline(always)]
    fn new() -> Self {
        Self { pull: [[0.0; LANES]; 6], bend: [[0.0; LANES]; 9] }
    }

    #[inline(always)]
    fn pull(&mut self, block: &Block, per_cut2: f64) {
        block.accumulate(&mut self.pull, |d, cos, sin, lever| {
            let rest = 1.0 - share(d * d, per_cut2);
            let w = rest * rest;
            let wd = w * d;
            let (wdc, wds) = (wd * cos, wd * sin);
            [w, wd, wdc, wds, wdc * lever, wds * lever]
        });
    }

    #[inline(always)]
    fn bend(&mut self, block: &Block, curvature: impl Fn(f64) -> f64) {
        block.accumulate(&mut self.bend, |d, cos, sin, _| {
            let k = curvature(d * d);
            let (kc, ks) = (k * cos, k * sin);
            let (kcc, kcs) = (kc * cos, ks * cos);
            let (kccc, kccs) = (kcc * cos, kcs * cos);
            [k, kc, ks, kcc, kcs, kccc, kccs, kccc * cos, kccs * cos]
        });
    }

    #[inline(always)]
    fn newton(&mut self, block: &Block, per_cut2: f64) {
        self.pull(block, per_cut2);
        self.bend(block, |d2| {
            let share = share(d2, per_cut2);
            (1.0 - share) * (1.0 - 5.0 * share)
        });
    }

    #[inline(always)]
    fn moments(&self) -> Moments {
        let [weight, pull @ ..] = self.pull.map(total);
        Moments { weight, pull, bend: self.bend.map(total) }
    }
}

/// The lanes of [`Inner::low`] and [`Inner::high`].
struct Extremes {
    low: [f64; LANES],
    high: [f64; LANES],
}

impl Extremes {
    #[inline(always)]
    fn new() -> Self {
        Self { low: [BEYOND; LANES], high: [-BEYOND; LANES] }
    }

    #[inline(always)]
    fn widen(&mut self, block: &Block, epsilon2: f64) {
        let Self { mut low, mut high } = *self;
        let directions = block.cos.as_chunks::<LANES>().0.iter().zip(block.sin.as_chunks::<LANES>().0);
        let distances = block.distance.as_chunks::<LANES>().0;
        for ((cos, sin), d) in directions.zip(distances).take(block.rows_count) {
            let ends = low.iter_mut().zip(&mut high);
            for (((&cos, &sin), &d), (low, high)) in cos.iter().zip(sin).zip(d).zip(ends) {
                let behind = if sin < 0.0 { -2.0 } else { 2.0 } - sin;
                let angle = if cos < 0.0 { behind } else { sin };
                let inner = d * d < epsilon2;
                let (lower, higher) = (if inner { angle } else { BEYOND }, if inner { angle } else { -BEYOND });
                *low = if lower < *low { lower } else { *low };
                *high = if higher > *high { higher } else { *high };
            }
        }
        *self = Self { low, high };
    }

    #[inline(always)]
    fn ends(&self) -> (f64, f64) {
        (self.low.into_iter().fold(BEYOND, f64::min), self.high.into_iter().fold(-BEYOND, f64::max))
    }
}

/// The squared distance in units of the squared cut-off, at most 1.
#[inline(always)]
fn share(d2: f64, per_cut2: f64) -> f64 {
    let share = d2 * per_cut2;
    if share < 1.0 { share } else { 1.0 }
}

#[inline(always)]
fn total(lanes: [f64; LANES]) -> f64 {
    lanes.iter().sum()
}

#[cfg(test)]
mod tests {
    use super::super::model::Cylinder;
    use super::*;

    /// A noisy arc with a clamp on its end; 333 points leave a part of a block and of a row over.
    fn points() -> (Vec<f32>, Vec<f32>) {
        let place = |i: usize| {
            let angle = 0.004 * i as f64 - 0.3;
            let radius = 50.0 + 0.05 * (i as f64 * 1.7).sin() + if i > 250 { 7.0 } else { 0.0 };
            ((3.0 + radius * angle.sin()) as f32, (radius * angle.cos() - 5.0) as f32)
        };
        (0..333).map(place).unzip()
    }

    fn projection() -> Projection {
        let cylinder = Cylinder { x_ref: 10.0, p: 0.1, q: 0.05, y_ref: 3.0, z_ref: -5.0, radius: 50.0 };
        cylinder.facing([0.2, 1.0]).at(12.0)
    }

    #[test]
    fn every_set_of_instructions_gives_the_same_bits() {
        let ((y, z), projection) = (points(), projection());
        let sweep = Sweep { projection: &projection, y: &y, z: &z };
        let per_cut2 = 1.0 / 0.04;
        let plain = BendAndCount { bend: Bend { sweep, per_cut2 }, epsilon2: 0.002 }.call();
        assert_eq!(moments_and_inner(&projection, &y, &z, per_cut2, 0.002), plain);
        assert_eq!(moments(&projection, &y, &z, per_cut2, Curvature::Slope), plain.0);
        let plain = Weigh { sweep, per_cut2 }.call();
        assert_eq!(moments(&projection, &y, &z, per_cut2, Curvature::Weight), plain);
        let plain = Truncate { sweep, per_tolerance2: 3.0 }.call();
        assert_eq!(truncated_squares(&projection, &y, &z, 3.0).to_bits(), plain.to_bits());
    }

    #[test]
    fn single_and_double_precision_columns_of_the_same_values_give_the_same_bits() {
        let ((y, z), projection) = (points(), projection());
        let wide = |values: &[f32]| values.iter().map(|&v| f64::from(v)).collect::<Vec<f64>>();
        let double = moments_and_inner(&projection, &wide(&y), &wide(&z), 25.0, 0.002);
        assert_eq!(moments_and_inner(&projection, &y, &z, 25.0, 0.002), double);
    }

    #[test]
    fn squared_distances_and_inner_points_are_those_of_the_points_one_by_one() {
        let ((y, z), projection) = (points(), projection());
        let mut squared = Vec::new();
        squared_distances(&projection, &y, &z, |found| squared.extend_from_slice(found));
        let cylinder = Cylinder { x_ref: 10.0, p: 0.1, q: 0.05, y_ref: 3.0, z_ref: -5.0, radius: 50.0 };
        let slice = cylinder.slice(12.0);
        let expected: Vec<f64> =
            y.iter().zip(&z).map(|(&y, &z)| slice.distance(y.into(), z.into()).powi(2)).collect();
        assert_eq!(squared.len(), expected.len());
        assert!(squared.iter().zip(&expected).all(|(a, b)| (a - b).abs() < 1e-12 * (1.0 + b)));
        let (_, inner) = moments_and_inner(&projection, &y, &z, 25.0, 0.002);
        let within: Vec<f64> = expected.iter().copied().filter(|d2| *d2 < 0.002).collect();
        assert_eq!(inner.count, within.len() as f64);
        assert!((inner.squared - within.iter().sum::<f64>()).abs() < 1e-9);
        let truncated: f64 = expected.iter().map(|d2| (3.0 * d2).min(1.0)).sum();
        assert!((truncated_squares(&projection, &y, &z, 3.0) - truncated).abs() < 1e-9);
    }
}
