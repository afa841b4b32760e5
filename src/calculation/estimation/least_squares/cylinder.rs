//! A cylinder in any direction, small changes of it, and the descent from a start to the minimum of the sum of squared distances,
//! down to the rounding of the numbers. Rotations and shifts are expressed in a basis perpendicular to the current direction, which
//! is rebuilt after every step, so that no direction is singular.

use super::points::{Lanes, Points, Terms};
use crate::estimation::progress::Progress;
use nalgebra::{Matrix2, Matrix5, Vector2, Vector3, Vector5};

/// Beyond this radius, in units of the extent of the points, their sagitta 1/(2R) is smaller than the rounding 2⁻⁵² R of
/// the distances from the axis: the cylinder cannot be distinguished from a plane.
const RADIUS_MAX: f64 = (1_u64 << 26) as f64;

/// A cylinder in the coordinates of [`Points`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Cylinder {
    /// The point of the axis that is nearest to the origin.
    pub(super) foot: Vector3<f64>,
    /// Of length one; its component of largest magnitude is positive.
    pub(super) direction: Vector3<f64>,
    pub(super) radius: f64,
}

/// Sums over the points at one cylinder, for the parameters (tilt 1, tilt 2, shift 1, shift 2, radius).
#[derive(Debug, Clone, Copy)]
pub(super) struct Sums {
    /// Σ d², with d the signed orthogonal distances.
    pub(super) squares: f64,
    /// Jᵀd.
    gradient: Vector5<f64>,
    /// JᵀJ.
    pub(super) normal: Matrix5<f64>,
    /// Σ d ∇²d: with JᵀJ the whole matrix of second derivatives of ½ Σ d².
    curvature: Matrix5<f64>,
}

/// Two unit vectors perpendicular to a direction and to each other.
pub(super) fn basis_of(direction: &Vector3<f64>) -> [Vector3<f64>; 2] {
    let smallest = direction.iamin();
    let helper = Vector3::from_fn(|index, _| if index == smallest { 1.0 } else { 0.0 });
    let first = (helper - direction * direction.dot(&helper)).normalize();
    [first, direction.cross(&first)]
}

impl Cylinder {
    /// A cylinder through any point of its axis; `None` if the radius is invalid.
    pub(super) fn new(on_axis: Vector3<f64>, direction: Vector3<f64>, radius: f64) -> Option<Self> {
        let foot = on_axis - direction * direction.dot(&on_axis);
        let reversed = direction.get(direction.iamax()).is_some_and(|largest| *largest < 0.0);
        let direction = if reversed { -direction } else { direction };
        let finite = foot.iter().chain(&direction).all(|value| value.is_finite());
        (finite && radius > 0.0 && radius < RADIUS_MAX).then_some(Self { foot, direction, radius })
    }

    /// The cylinder after a step of the parameters.
    pub(super) fn moved(&self, step: &Vector5<f64>) -> Option<Self> {
        let [first, second] = basis_of(&self.direction);
        let direction = (self.direction + first * step.x + second * step.y).try_normalize(0.0)?;
        Self::new(self.foot + first * step.z + second * step.w, direction, self.radius + step.a)
    }

    /// The size of a step: its rotation, and its shift and change of radius relative to the larger of the radius and the extent of
    /// the points.
    pub(super) fn size_of(&self, step: &Vector5<f64>) -> f64 {
        let size = self.radius.max(1.0);
        [step.x, step.y, step.z / size, step.w / size, step.a / size]
            .iter()
            .fold(0.0, |most, part| part.abs().max(most))
    }

    /// The difference of another cylinder in the same measure, irrespective of the signs of the directions.
    pub(super) fn distance(&self, other: &Self) -> f64 {
        let size = self.radius.max(other.radius).max(1.0);
        let tilt = self.direction.cross(&other.direction).norm();
        tilt.max((self.foot - other.foot).norm() / size).max((self.radius - other.radius).abs() / size)
    }

    /// The sums over the points.
    ///
    /// A point at the distance ρ from the axis, in the direction n = (C, S) from it and at z along it, has d = ρ − R,
    /// J = −(z C, z S, C, S, 1), and with t = (−S, C) perpendicular to n the second derivatives (z, 1)ᵀ(z, 1) ⊗ ttᵀ/ρ of tilts and
    /// shifts, less ρ nnᵀ of the tilts.
    pub(super) fn sums(&self, points: &Points<'_>) -> Sums {
        let [first, second] = basis_of(&self.direction);
        Sums::of(points.sum(&Seen { cylinder: self, first, second }), points.count() as f64)
    }
}

/// A cylinder with the basis of its tilts and shifts.
struct Seen<'a> {
    cylinder: &'a Cylinder,
    first: Vector3<f64>,
    second: Vector3<f64>,
}

impl Terms<31> for Seen<'_> {
    #[inline(always)]
    #[rustfmt::skip]
    fn of(&self, x: Lanes, y: Lanes, z: Lanes) -> [Lanes; 31] {
        let all = Lanes::all;
        let foot = self.cylinder.foot;
        let (x, y, z) = (x - all(foot.x), y - all(foot.y), z - all(foot.z));
        let along = |vector: &Vector3<f64>| x * all(vector.x) + y * all(vector.y) + z * all(vector.z);
        let (z, u, v) = (along(&self.cylinder.direction), along(&self.first), along(&self.second));
        let rho = (u * u + v * v).map(f64::sqrt);
        // A point on the axis has no direction from it.
        let per_rho = rho.map(|rho| if rho > 0.0 { rho.recip() } else { 0.0 });
        let (c, s, d) = (u * per_rho, v * per_rho, rho - all(self.cylinder.radius));
        let (cc, cs, ss) = (c * c, c * s, s * s);
        let (kappa, zz, lever) = (d * per_rho, z * z, d * rho);
        let (tcc, tcs, tss) = (kappa * ss, all(0.0) - kappa * cs, kappa * cc);
        [
            d * d, d * z * c, d * z * s, d * c, d * s, d,
            z * c, z * s, c, s,
            zz * cc, zz * cs, zz * ss, z * cc, z * cs, z * ss, cc, cs, ss,
            zz * tcc, zz * tcs, zz * tss, z * tcc, z * tcs, z * tss, tcc, tcs, tss,
            lever * cc, lever * cs, lever * ss,
        ]
    }
}

impl Sums {
    #[rustfmt::skip]
    fn of(total: [f64; 31], count: f64) -> Self {
        let [
            squares, dzc, dzs, dc, ds, d,
            zc, zs, c, s,
            zzcc, zzcs, zzss, zcc, zcs, zss, cc, cs, ss,
            zztcc, zztcs, zztss, ztcc, ztcs, ztss, tcc, tcs, tss,
            lcc, lcs, lss,
        ] = total;
        let normal = Matrix5::new(
            zzcc, zzcs, zcc, zcs, zc,
            zzcs, zzss, zcs, zss, zs,
            zcc,  zcs,  cc,  cs,  c,
            zcs,  zss,  cs,  ss,  s,
            zc,   zs,   c,   s,   count,
        );
        let curvature = Matrix5::new(
            zztcc - lcc, zztcs - lcs, ztcc, ztcs, 0.0,
            zztcs - lcs, zztss - lss, ztcs, ztss, 0.0,
            ztcc,        ztcs,        tcc,  tcs,  0.0,
            ztcs,        ztss,        tcs,  tss,  0.0,
            0.0,         0.0,         0.0,  0.0,  0.0,
        );
        Self { squares, gradient: -Vector5::new(dzc, dzs, dc, ds, d), normal, curvature }
    }

    /// Newton's step, or the Gauss-Newton step if the second derivatives are not positive definite; `damping` is the share of the
    /// diagonal of JᵀJ that is added to it (Levenberg and Marquardt).
    pub(super) fn step(&self, damping: f64) -> Option<Vector5<f64>> {
        let damped = self.normal + Matrix5::from_diagonal(&(self.normal.diagonal() * damping));
        let factors = (damped + self.curvature).cholesky().or_else(|| damped.cholesky())?;
        let step = -factors.solve(&self.gradient);
        step.iter().all(|value| value.is_finite()).then_some(step)
    }
}

/// The circle of points in a plane with the least Kåsa criterion Σ (ρ² − R²)², from moments about their mean: Σ u uᵀ, Σ w u and Σ
/// w² with w = |u|² minus its mean. Returns its centre and the remaining sum.
pub(super) fn circle(uu: &Matrix2<f64>, wu: &Vector2<f64>, ww: f64) -> Option<(Vector2<f64>, f64)> {
    let twice = uu.cholesky()?.solve(wu);
    Some((twice * 0.5, (ww - twice.dot(wu)).max(0.0)))
}

/// Rounds of a descent; one that needs more creeps along a valley that another start leaves sooner.
const ROUNDS_MAX: usize = 100;
/// Final rounds of Newton's method; each doubles the number of correct digits.
const NEWTON_MAX: usize = 12;
/// A step of this size has three correct digits, so that Newton's method needs no more damping.
const NEAR: f64 = 1e-3;
const DAMPING_START: f64 = 1e-3;
const DAMPING_MAX: f64 = 1e12;

/// A minimum and the sums there.
#[derive(Debug, Clone, Copy)]
pub(super) struct Minimum {
    pub(super) cylinder: Cylinder,
    pub(super) sums: Sums,
    /// The size of the next step, which was not taken: of the order of rounding at a well-determined minimum.
    pub(super) step: f64,
}

impl Minimum {
    fn new(cylinder: Cylinder, points: &Points<'_>) -> Self {
        let sums = cylinder.sums(points);
        let step = sums.step(0.0).map_or(f64::INFINITY, |step| cylinder.size_of(&step));
        Self { cylinder, sums, step }
    }

    fn after(&self, damping: f64, points: &Points<'_>) -> Option<Self> {
        let step = self.sums.step(damping)?;
        Some(Self::new(self.cylinder.moved(&step)?, points))
    }
}

/// Descends by Newton's method, damped as by Levenberg and Marquardt.
pub(super) fn descend(points: &Points<'_>, start: &Cylinder, progress: &Progress) -> Option<Minimum> {
    let mut at = Minimum::new(*start, points);
    let mut damping = DAMPING_START;
    for _ in 0..ROUNDS_MAX {
        if progress.is_stopped() {
            return None;
        }
        if damping <= DAMPING_START && at.step < NEAR {
            break;
        }
        match at.after(damping, points).filter(|trial| trial.sums.squares < at.sums.squares) {
            Some(better) => {
                at = better;
                damping *= 0.1;
            }
            None if damping > DAMPING_MAX => break,
            None => damping *= 10.0,
        }
    }
    let at = polish(points, at);
    at.sums.squares.is_finite().then_some(at)
}

/// Newton's steps until they get no smaller: the remaining step is the rounding of the gradient. The sum of squares is flat there,
/// and its rounding would end the iteration at half the digits.
fn polish(points: &Points<'_>, mut at: Minimum) -> Minimum {
    let mut last = 2.0 * NEAR;
    for _ in 0..NEWTON_MAX {
        if at.step >= 0.5 * last || at.step < f64::EPSILON {
            break;
        }
        last = at.step;
        let Some(next) = at.after(0.0, points) else { break };
        at = next;
    }
    at
}
