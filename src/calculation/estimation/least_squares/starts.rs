//! The cylinders from which the fit starts, chosen so that the least of all minima is found. For a given direction the best circle
//! by Kåsa's criterion follows from moments of the points to the fourth order (Eberly), without another pass over the points.

use super::cylinder::{Cylinder, basis_of, circle};
use super::points::Points;
use nalgebra::{Matrix2, Matrix3, Matrix3x6, Matrix6, Vector2, Vector3, Vector6};

/// Points of the search: their sum of squares is accurate to √(2/1024) = 4 %.
pub(super) const SAMPLE_MAX: usize = 1024;
/// Directions on the half sphere, 4.5° from one to the next.
const DIRECTIONS: usize = 1024;
/// The number of starts is chosen so that their rounds process about this many points together.
const WORK: usize = 1 << 13;
const SWEEPS_MAX: usize = 64;

/// All points if there are few, else one of each of [`SAMPLE_MAX`] stretches of equal length at a pseudo-random position: a regular
/// stride could select one column of every profile.
pub(super) fn sample(points: &Points<'_>) -> Vec<[f64; 3]> {
    let count = points.count();
    if count <= SAMPLE_MAX {
        return points.iter().map(Into::into).collect();
    }
    let mut state = 0_u64;
    let place = |stretch: usize| {
        state = state.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let fraction = (scrambled(state) >> 11) as f64 / (1_u64 << 53) as f64;
        ((stretch as f64 + fraction) / SAMPLE_MAX as f64 * count as f64) as usize
    };
    (0..SAMPLE_MAX).map(place).filter_map(|index| points.get(index)).map(Into::into).collect()
}

/// The output function of the generator SplitMix64.
fn scrambled(state: u64) -> u64 {
    let first = (state ^ (state >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    let second = (first ^ (first >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    second ^ (second >> 31)
}

/// Cylinders to start from, the most promising first.
pub(super) fn starts(points: &Points<'_>) -> Vec<Cylinder> {
    let moments = Moments::of(points);
    let starts_max = WORK.div_ceil(points.count().max(1));
    // Evenly spread directions find every wide minimum. The minimum of a long thin part, or of a flat patch, is narrow; directions
    // that are spread evenly in coordinates in which the points have the same extent in every direction are correspondingly dense.
    let even = moments.best(&Matrix3::identity(), starts_max);
    let stretched = moments.stretch().map(|stretch| moments.best(&stretch, starts_max)).unwrap_or_default();
    let mut all: Vec<(Cylinder, f64)> = even.into_iter().chain(stretched).collect();
    all.sort_by(|one, other| one.1.total_cmp(&other.1));
    all.into_iter().map(|(cylinder, _)| cylinder).collect()
}

/// Sums of products of the coordinates about the mean of the points.
struct Moments {
    count: f64,
    mean: Vector3<f64>,
    /// Σ q qᵀ.
    second: Matrix3<f64>,
    /// Σ q mᵀ, with m the six products of two coordinates minus their means.
    third: Matrix3x6<f64>,
    /// Σ m mᵀ.
    fourth: Matrix6<f64>,
    /// The means of the six products.
    products: Vector6<f64>,
}

impl Moments {
    fn of(points: &Points<'_>) -> Self {
        let count = points.count().max(1) as f64;
        let mean = points.iter().sum::<Vector3<f64>>() / count;
        let centred = || points.iter().map(|point| point - mean);
        let products = centred().map(|q| products_of(&q)).sum::<Vector6<f64>>() / count;
        let mut moments = Self {
            count,
            mean,
            second: Matrix3::zeros(),
            third: Matrix3x6::zeros(),
            fourth: Matrix6::zeros(),
            products,
        };
        for q in centred() {
            let product = products_of(&q) - products;
            moments.second += q * q.transpose();
            moments.third += q * product.transpose();
            moments.fourth += product * product.transpose();
        }
        moments
    }

    /// The square root of the covariance: it maps a sphere to the shape of the points.
    fn stretch(&self) -> Option<Matrix3<f64>> {
        let eigen = (self.second / self.count).try_symmetric_eigen(f64::EPSILON, SWEEPS_MAX)?;
        Some(eigen.eigenvectors * Matrix3::from_diagonal(&eigen.eigenvalues.map(|value| value.max(0.0).sqrt())))
    }

    /// The best cylinders among directions that are evenly spread and then stretched, best first, none within twice the spacing of
    /// a better one: a start descends into the same minimum as its neighbours.
    fn best(&self, stretch: &Matrix3<f64>, starts_max: usize) -> Vec<(Cylinder, f64)> {
        let rated = half_sphere().filter_map(|even| {
            let (cylinder, score) = self.cylinder(&(stretch * even).try_normalize(0.0)?)?;
            Some((even, cylinder, score))
        });
        let mut rated: Vec<(Vector3<f64>, Cylinder, f64)> = rated.collect();
        rated.sort_by(|one, other| one.2.total_cmp(&other.2));
        let near = (std::f64::consts::TAU / DIRECTIONS as f64).sqrt() * 2.0;
        let mut apart: Vec<(Vector3<f64>, Cylinder, f64)> = Vec::new();
        for start in rated {
            if apart.len() < starts_max && apart.iter().all(|known| known.0.cross(&start.0).norm() > near) {
                apart.push(start);
            }
        }
        apart.into_iter().map(|(_, cylinder, score)| (cylinder, score)).collect()
    }

    /// The best cylinder of a direction, and an estimate of the sum of its squared distances: (ρ² − R²)/(2R) is nearly ρ − R.
    fn cylinder(&self, direction: &Vector3<f64>) -> Option<(Cylinder, f64)> {
        let [first, second] = basis_of(direction);
        // |u|² of the projection is the product of these with the six products.
        let square = Vector3::from_element(1.0) - direction.component_mul(direction);
        let (x, y, z) = (direction.x, direction.y, direction.z);
        let form = Vector6::new(square.x, square.y, square.z, -2.0 * x * y, -2.0 * x * z, -2.0 * y * z);
        let along = |one: &Vector3<f64>, other: &Vector3<f64>| one.dot(&(self.second * other));
        let cross = along(&first, &second);
        let uu = Matrix2::new(along(&first, &first), cross, cross, along(&second, &second));
        let wq = self.third * form;
        let wu = Vector2::new(wq.dot(&first), wq.dot(&second));
        let (centre, rest) = circle(&uu, &wu, form.dot(&(self.fourth * form)))?;
        let radius_squared = self.products.dot(&form) + centre.norm_squared();
        let on_axis = self.mean + first * centre.x + second * centre.y;
        let cylinder = Cylinder::new(on_axis, *direction, radius_squared.max(0.0).sqrt())?;
        Some((cylinder, rest / (4.0 * radius_squared)))
    }
}

fn products_of(q: &Vector3<f64>) -> Vector6<f64> {
    Vector6::new(q.x * q.x, q.y * q.y, q.z * q.z, q.x * q.y, q.x * q.z, q.y * q.z)
}

/// Directions spread evenly over the half sphere along Fibonacci's spiral.
fn half_sphere() -> impl Iterator<Item = Vector3<f64>> {
    let golden = std::f64::consts::PI * (3.0 - 5.0_f64.sqrt());
    (0..DIRECTIONS).map(move |index| {
        let z = (index as f64 + 0.5) / DIRECTIONS as f64;
        let (sin, cos) = (index as f64 * golden).sin_cos();
        let across = (1.0 - z * z).sqrt();
        Vector3::new(across * cos, across * sin, z)
    })
}
