//! The inner loops of the method: sums over the points of one profile, read in the precision in which they are stored.
//!
//! The instructions are selected at run time (AVX-512, AVX2 or the baseline of the architecture) and give the same bits. A block of
//! points is projected into a few arrays that stay in the first-level cache; each group of sums then runs over these arrays, so
//! that no group needs more running sums than a processor has registers.

use super::block::{BLOCK, Block, Fold, LANES, Moments, OwnMoments, Place, Points};
use super::normal_equations::Sums;
use pulp::{Arch, Simd, WithSimd};

/// A value beyond every angle on the scale of [`Inner::low`] and [`Inner::high`].
const BEYOND: f64 = 4.0;

/// The factor of a point in the normal matrix.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Curvature {
    /// Its weight w: never negative, so the step descends from far away (iteratively re-weighted least squares).
    Weight,
    /// The slope ψ′ of w·d: Newton's step, which converges quadratically near the solution; also the bread of the sandwich
    /// covariance.
    Slope,
}

/// The points within ε of the surface.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Inner {
    pub(super) count: f64,
    /// Σ d², mm².
    pub(super) squared: f64,
    /// Least and largest angle from the viewing direction on a scale that needs no arc tangent: sin θ on the near side, ±2 − sin θ
    /// beyond a right angle.
    pub(super) low: f64,
    pub(super) high: f64,
}

impl Inner {
    /// The value for no points.
    pub(super) fn none() -> Self {
        Self { count: 0.0, squared: 0.0, low: BEYOND, high: -BEYOND }
    }
}

/// The points of one profile, single or double precision, and how they are examined.
#[derive(Debug, Clone, Copy)]
pub(super) struct Sweep<'a, T> {
    pub(super) place: Place<'a>,
    pub(super) y: &'a [T],
    pub(super) z: &'a [T],
}

impl<T: Copy + Into<f64>> Sweep<'_, T> {
    /// The sums in the parameters of the view; `per_cut2` is the inverse square of Tukey's cut-off, mm⁻².
    pub(super) fn sums(self, per_cut2: f64, curvature: Curvature) -> Sums {
        Arch::new().dispatch(Sum { sweep: self, per_cut2, curvature })
    }

    /// The same with the slope, and the points within ε, whose square is `epsilon2`.
    pub(super) fn sums_and_inner(self, per_cut2: f64, epsilon2: f64) -> (Sums, Inner) {
        Arch::new().dispatch(SumAndCount { sweep: self, per_cut2, epsilon2 })
    }

    /// Calls `found` with the squared distances from the surface, mm², a block of points at a time.
    pub(super) fn squared_distances(self, found: impl FnMut(&[f64])) {
        Arch::new().dispatch(Measure { sweep: self, found });
    }

    /// Σ min(d²·`per_tolerance2`, 1).
    pub(super) fn truncated_squares(self, per_tolerance2: f64) -> f64 {
        Arch::new().dispatch(Truncate { sweep: self, per_tolerance2 })
    }
}

struct Sum<'a, T> {
    sweep: Sweep<'a, T>,
    per_cut2: f64,
    curvature: Curvature,
}

struct SumAndCount<'a, T> {
    sweep: Sweep<'a, T>,
    per_cut2: f64,
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

impl<T: Copy + Into<f64>> WithSimd for Sum<'_, T> {
    type Output = Sums;

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> Sums {
        let Self { sweep, per_cut2, curvature } = self;
        let mut block = Block::empty();
        match sweep.place {
            Place::Plane(projection) => {
                let mut running = Running::new();
                for (place, y, z) in sweep.blocks() {
                    block.fill(place, y, z);
                    running.add(simd, &block, per_cut2, curvature);
                }
                running.moments().sums(projection)
            }
            Place::Own(..) => {
                let mut running = OwnRunning::new();
                for (place, y, z) in sweep.blocks() {
                    block.fill(place, y, z);
                    running.add(simd, &block, per_cut2, curvature);
                }
                running.moments().sums()
            }
        }
    }
}

impl<T: Copy + Into<f64>> WithSimd for SumAndCount<'_, T> {
    type Output = (Sums, Inner);

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> (Sums, Inner) {
        let Self { sweep, per_cut2, epsilon2 } = self;
        let mut block = Block::empty();
        let mut inner = [[0.0; LANES], [0.0; LANES], [BEYOND; LANES], [-BEYOND; LANES]];
        let sums = match sweep.place {
            Place::Plane(projection) => {
                let mut running = Running::new();
                for (place, y, z) in sweep.blocks() {
                    block.fill(place, y, z);
                    running.add(simd, &block, per_cut2, Curvature::Slope);
                    block.fold(simd, &mut inner, &Count { epsilon2 });
                }
                running.moments().sums(projection)
            }
            Place::Own(..) => {
                let mut running = OwnRunning::new();
                for (place, y, z) in sweep.blocks() {
                    block.fill(place, y, z);
                    running.add(simd, &block, per_cut2, Curvature::Slope);
                    block.fold(simd, &mut inner, &Count { epsilon2 });
                }
                running.moments().sums()
            }
        };
        let [count, squared, low, high] = inner;
        let inner = Inner {
            count: total(count),
            squared: total(squared),
            low: low.into_iter().fold(BEYOND, f64::min),
            high: high.into_iter().fold(-BEYOND, f64::max),
        };
        (sums, inner)
    }
}

impl<T: Copy + Into<f64>, F: FnMut(&[f64])> WithSimd for Measure<'_, T, F> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(mut self, _: S) {
        let mut squared = [0.0; BLOCK];
        for (place, y, z) in self.sweep.blocks() {
            let count = squared_distances(place, y, z, &mut squared);
            (self.found)(squared.get(..count).unwrap_or_default());
        }
    }
}

impl<T: Copy + Into<f64>> WithSimd for Truncate<'_, T> {
    type Output = f64;

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) -> f64 {
        let (mut sums, mut squared) = ([0.0; LANES], [0.0; BLOCK]);
        for (place, y, z) in self.sweep.blocks() {
            let count = squared_distances(place, y, z, &mut squared);
            // Values of an earlier block beyond the last point are ignored.
            squared.iter_mut().skip(count).for_each(|d2| *d2 = 0.0);
            for row in squared.as_chunks::<LANES>().0.iter().take(count.div_ceil(LANES)) {
                for (sum, d2) in sums.iter_mut().zip(row) {
                    let share = d2 * self.per_tolerance2;
                    *sum += if share < 1.0 { share } else { 1.0 };
                }
            }
        }
        total(sums)
    }
}

impl<'a, T: Copy + Into<f64>> Sweep<'a, T> {
    #[inline(always)]
    fn blocks(self) -> impl Iterator<Item = (Place<'a>, &'a [T], &'a [T])> {
        let Self { place, y, z } = self;
        let blocks = y.chunks(BLOCK).zip(z.chunks(BLOCK)).enumerate();
        blocks.map(move |(index, (y, z))| match place {
            Place::Plane(_) => (place, y, z),
            Place::Own(oblique, x) => {
                let start = index * BLOCK;
                let x = x.get(start..start + y.len().min(z.len())).unwrap_or_default();
                (Place::Own(oblique, x), y, z)
            }
        })
    }
}

/// The squared distances of at most one block of points, mm², and their number.
#[inline(always)]
fn squared_distances<T: Copy + Into<f64>>(place: Place<'_>, y: &[T], z: &[T], squared: &mut [f64; BLOCK]) -> usize {
    match place {
        Place::Plane(projection) => {
            for (squared, (&y, &z)) in squared.iter_mut().zip(y.iter().zip(z)) {
                let [across, up] = projection.place(y.into(), z.into());
                let d = (across * across + up * up).sqrt() - projection.radius;
                *squared = d * d;
            }
            y.len().min(z.len())
        }
        Place::Own(oblique, x) => {
            for (squared, (&x, (&y, &z))) in squared.iter_mut().zip(x.iter().zip(y.iter().zip(z))) {
                let [across, up, _] = oblique.place([x, y.into(), z.into()]);
                let d = (across * across + up * up).sqrt() - oblique.radius;
                *squared = d * d;
            }
            x.len().min(y.len()).min(z.len())
        }
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
    fn add<S: Simd>(&mut self, simd: S, block: &Block, per_cut2: f64, curvature: Curvature) {
        block.fold(simd, &mut self.pull, &Pull { per_cut2 });
        match curvature {
            Curvature::Weight => block.fold(simd, &mut self.bend, &Bend::<false> { per_cut2 }),
            Curvature::Slope => block.fold(simd, &mut self.bend, &Bend::<true> { per_cut2 }),
        }
    }

    #[inline(always)]
    fn moments(&self) -> Moments {
        let [weight, pull @ ..] = self.pull.map(total);
        Moments { weight, pull, bend: self.bend.map(total) }
    }
}

/// The lanes of [`OwnMoments`].
struct OwnRunning {
    pull: [[f64; LANES]; 6],
    bend: [[f64; LANES]; 5],
    lever: [[f64; LANES]; 8],
}

impl OwnRunning {
    #[inline(always)]
    fn new() -> Self {
        Self { pull: [[0.0; LANES]; 6], bend: [[0.0; LANES]; 5], lever: [[0.0; LANES]; 8] }
    }

    #[inline(always)]
    fn add<S: Simd>(&mut self, simd: S, block: &Block, per_cut2: f64, curvature: Curvature) {
        block.fold(simd, &mut self.pull, &Pull { per_cut2 });
        match curvature {
            Curvature::Weight => {
                block.fold(simd, &mut self.bend, &OwnBend::<false> { per_cut2 });
                block.fold(simd, &mut self.lever, &Lever::<false> { per_cut2 });
            }
            Curvature::Slope => {
                block.fold(simd, &mut self.bend, &OwnBend::<true> { per_cut2 });
                block.fold(simd, &mut self.lever, &Lever::<true> { per_cut2 });
            }
        }
    }

    #[inline(always)]
    fn moments(&self) -> OwnMoments {
        let [weight, pull @ ..] = self.pull.map(total);
        OwnMoments { weight, pull, bend: self.bend.map(total), lever: self.lever.map(total) }
    }
}

/// Adds to weight and pull.
struct Pull {
    per_cut2: f64,
}

/// Adds to bend, with the slope or with the weight.
struct Bend<const SLOPE: bool> {
    per_cut2: f64,
}

/// Adds to bend and lever of points with individual x, with the slope or with the weight.
struct OwnBend<const SLOPE: bool> {
    per_cut2: f64,
}

struct Lever<const SLOPE: bool> {
    per_cut2: f64,
}

/// Adds to count and squared and widens low and high.
struct Count {
    epsilon2: f64,
}

impl Fold<6> for Pull {
    #[inline(always)]
    fn fold<S: Simd>(&self, simd: S, values: [S::f64s; 6], points: Points<S::f64s>) -> [S::f64s; 6] {
        let Points { cos, sin, distance, axial } = points;
        let [w, wd, wdc, wds, wdcs, wdss] = values;
        let (_, rest) = share(simd, distance, self.per_cut2);
        let weight = simd.mul_f64s(rest, rest);
        let pull = simd.mul_f64s(weight, distance);
        let (across, up) = (simd.mul_f64s(pull, cos), simd.mul_f64s(pull, sin));
        [
            simd.add_f64s(w, weight),
            simd.add_f64s(wd, pull),
            simd.add_f64s(wdc, across),
            simd.add_f64s(wds, up),
            simd.add_f64s(wdcs, simd.mul_f64s(across, axial)),
            simd.add_f64s(wdss, simd.mul_f64s(up, axial)),
        ]
    }
}

impl<const SLOPE: bool> Fold<9> for Bend<SLOPE> {
    #[inline(always)]
    fn fold<S: Simd>(&self, simd: S, values: [S::f64s; 9], points: Points<S::f64s>) -> [S::f64s; 9] {
        let Points { cos, sin, distance, .. } = points;
        let [k, kc, ks, kcc, kcs, kccc, kccs, kcccc, kcccs] = values;
        let bend = curvature::<S, SLOPE>(simd, distance, self.per_cut2);
        let (c, s) = (simd.mul_f64s(bend, cos), simd.mul_f64s(bend, sin));
        let (cc, cs) = (simd.mul_f64s(c, cos), simd.mul_f64s(s, cos));
        let (ccc, ccs) = (simd.mul_f64s(cc, cos), simd.mul_f64s(cs, cos));
        [
            simd.add_f64s(k, bend),
            simd.add_f64s(kc, c),
            simd.add_f64s(ks, s),
            simd.add_f64s(kcc, cc),
            simd.add_f64s(kcs, cs),
            simd.add_f64s(kccc, ccc),
            simd.add_f64s(kccs, ccs),
            simd.add_f64s(kcccc, simd.mul_f64s(ccc, cos)),
            simd.add_f64s(kcccs, simd.mul_f64s(ccs, cos)),
        ]
    }
}

impl<const SLOPE: bool> Fold<5> for OwnBend<SLOPE> {
    #[inline(always)]
    fn fold<S: Simd>(&self, simd: S, values: [S::f64s; 5], points: Points<S::f64s>) -> [S::f64s; 5] {
        let Points { cos, sin, distance, .. } = points;
        let [k, kc, ks, kcc, kcs] = values;
        let bend = curvature::<S, SLOPE>(simd, distance, self.per_cut2);
        let (c, s) = (simd.mul_f64s(bend, cos), simd.mul_f64s(bend, sin));
        [
            simd.add_f64s(k, bend),
            simd.add_f64s(kc, c),
            simd.add_f64s(ks, s),
            simd.add_f64s(kcc, simd.mul_f64s(c, cos)),
            simd.add_f64s(kcs, simd.mul_f64s(s, cos)),
        ]
    }
}

impl<const SLOPE: bool> Fold<8> for Lever<SLOPE> {
    #[inline(always)]
    fn fold<S: Simd>(&self, simd: S, values: [S::f64s; 8], points: Points<S::f64s>) -> [S::f64s; 8] {
        let Points { cos, sin, distance, axial } = points;
        let [t, tc, ts, tcc, tcs, tt, ttcc, ttcs] = values;
        let once = simd.mul_f64s(curvature::<S, SLOPE>(simd, distance, self.per_cut2), axial);
        let (c, s) = (simd.mul_f64s(once, cos), simd.mul_f64s(once, sin));
        let (cc, cs) = (simd.mul_f64s(c, cos), simd.mul_f64s(s, cos));
        [
            simd.add_f64s(t, once),
            simd.add_f64s(tc, c),
            simd.add_f64s(ts, s),
            simd.add_f64s(tcc, cc),
            simd.add_f64s(tcs, cs),
            simd.add_f64s(tt, simd.mul_f64s(once, axial)),
            simd.add_f64s(ttcc, simd.mul_f64s(cc, axial)),
            simd.add_f64s(ttcs, simd.mul_f64s(cs, axial)),
        ]
    }
}

impl Fold<4> for Count {
    #[inline(always)]
    fn fold<S: Simd>(&self, simd: S, values: [S::f64s; 4], points: Points<S::f64s>) -> [S::f64s; 4] {
        let Points { cos, sin, distance, .. } = points;
        let [count, squared, low, high] = values;
        let [zero, one, two, beyond] = [0.0, 1.0, 2.0, BEYOND].map(|value| simd.splat_f64s(value));
        let d2 = simd.mul_f64s(distance, distance);
        let inner = simd.less_than_f64s(d2, simd.splat_f64s(self.epsilon2));
        let turned = simd.select_f64s(simd.less_than_f64s(sin, zero), simd.sub_f64s(zero, two), two);
        let angle = simd.select_f64s(simd.less_than_f64s(cos, zero), simd.sub_f64s(turned, sin), sin);
        let lower = simd.select_f64s(inner, angle, beyond);
        let higher = simd.select_f64s(inner, angle, simd.sub_f64s(zero, beyond));
        [
            simd.add_f64s(count, simd.select_f64s(inner, one, zero)),
            simd.add_f64s(squared, simd.select_f64s(inner, d2, zero)),
            simd.select_f64s(simd.less_than_f64s(lower, low), lower, low),
            simd.select_f64s(simd.less_than_f64s(high, higher), higher, high),
        ]
    }
}

/// k: the slope ψ′ = (1 − v)(1 − 5v) or the weight w = (1 − v)², with v = d²/c².
#[inline(always)]
fn curvature<S: Simd, const SLOPE: bool>(simd: S, distance: S::f64s, per_cut2: f64) -> S::f64s {
    let (share, rest) = share(simd, distance, per_cut2);
    let factor =
        if SLOPE { simd.sub_f64s(simd.splat_f64s(1.0), simd.mul_f64s(simd.splat_f64s(5.0), share)) } else { rest };
    simd.mul_f64s(rest, factor)
}

/// v = d²/c², at most 1, and 1 − v.
#[inline(always)]
fn share<S: Simd>(simd: S, distance: S::f64s, per_cut2: f64) -> (S::f64s, S::f64s) {
    let one = simd.splat_f64s(1.0);
    let share = simd.mul_f64s(simd.mul_f64s(distance, distance), simd.splat_f64s(per_cut2));
    let share = simd.select_f64s(simd.less_than_f64s(share, one), share, one);
    (share, simd.sub_f64s(one, share))
}

#[inline(always)]
fn total(lanes: [f64; LANES]) -> f64 {
    lanes.iter().sum()
}

#[cfg(test)]
mod tests {
    use super::super::model::Cylinder;
    use super::*;
    use pulp::Scalar;

    /// A noisy arc with a clamp at its end; 333 points fill the last block and the last row only partly.
    fn points() -> (Vec<f32>, Vec<f32>) {
        let place = |i: usize| {
            let angle = 0.004 * i as f64 - 0.3;
            let radius = 50.0 + 0.05 * (i as f64 * 1.7).sin() + if i > 250 { 7.0 } else { 0.0 };
            ((3.0 + radius * angle.sin()) as f32, (radius * angle.cos() - 5.0) as f32)
        };
        (0..333).map(place).unzip()
    }

    /// The points in one plane, and the same with individual x.
    fn places(test: impl Fn(Place<'_>)) {
        let view = cylinder().facing([0.2, 1.0]);
        test(Place::Plane(&view.at(12.0)));
        test(Place::Own(&view.oblique(), &[12.0; 333]));
    }

    fn cylinder() -> Cylinder {
        Cylinder { x_ref: 10.0, p: 0.1, q: 0.05, y_ref: 3.0, z_ref: -5.0, radius: 50.0 }
    }

    #[test]
    fn every_set_of_instructions_gives_the_same_bits() {
        places(|place| {
            let (y, z) = points();
            let sweep = Sweep { place, y: &y, z: &z };
            let (per_cut2, epsilon2) = (1.0, 0.04);
            // One point at a time, with the baseline instructions.
            let plain = SumAndCount { sweep, per_cut2, epsilon2 }.with_simd(Scalar);
            assert!(plain.0.weight > 50.0 && plain.1.count > 20.0, "{plain:?}");
            assert_eq!(sweep.sums_and_inner(per_cut2, epsilon2), plain);
            assert_eq!(sweep.sums(per_cut2, Curvature::Slope), plain.0);
            let plain = Sum { sweep, per_cut2, curvature: Curvature::Weight }.with_simd(Scalar);
            assert_eq!(sweep.sums(per_cut2, Curvature::Weight), plain);
            let plain = Truncate { sweep, per_tolerance2: 3.0 }.with_simd(Scalar);
            assert_eq!(sweep.truncated_squares(3.0).to_bits(), plain.to_bits());
            // Half as wide as the widest vectors, if the processor has both.
            #[cfg(target_arch = "x86_64")]
            if let Some(narrower) = pulp::x86::V3::try_new() {
                let plain = SumAndCount { sweep, per_cut2, epsilon2 }.with_simd(Scalar);
                assert_eq!(Simd::vectorize(narrower, SumAndCount { sweep, per_cut2, epsilon2 }), plain);
            }
        });
    }

    #[test]
    fn single_and_double_precision_columns_of_the_same_values_give_the_same_bits() {
        places(|place| {
            let (y, z) = points();
            let wide = |values: &[f32]| values.iter().map(|&v| f64::from(v)).collect::<Vec<f64>>();
            let double = Sweep { place, y: &wide(&y), z: &wide(&z) }.sums_and_inner(25.0, 0.002);
            assert_eq!(Sweep { place, y: &y, z: &z }.sums_and_inner(25.0, 0.002), double);
        });
    }

    #[test]
    fn squared_distances_and_inliers_equal_those_of_single_points() {
        places(|place| {
            let (y, z) = points();
            let sweep = Sweep { place, y: &y, z: &z };
            let mut squared = Vec::new();
            sweep.squared_distances(|found| squared.extend_from_slice(found));
            let slice = cylinder().slice(12.0);
            let place = |(&y, &z): (&f32, &f32)| (f64::from(y), f64::from(z));
            let expected: Vec<f64> = y.iter().zip(&z).map(place).map(|(y, z)| slice.distance(y, z).powi(2)).collect();
            assert_eq!(squared.len(), expected.len());
            assert!(squared.iter().zip(&expected).all(|(a, b)| (a - b).abs() < 1e-12 * (1.0 + b)));
            let (_, inner) = sweep.sums_and_inner(25.0, 0.002);
            let within: Vec<f64> = expected.iter().copied().filter(|d2| *d2 < 0.002).collect();
            assert_eq!(inner.count, within.len() as f64);
            assert!((inner.squared - within.iter().sum::<f64>()).abs() < 1e-9);
            let truncated: f64 = expected.iter().map(|d2| (3.0 * d2).min(1.0)).sum();
            assert!((sweep.truncated_squares(3.0) - truncated).abs() < 1e-9);
        });
    }
}
