//! What is no layer: a part that is not quite round or straight, whose deviation is smooth while a layer has edges, and a stage
//! that wanders, which shifts whole profiles. In: averages over patches. Out: the same without that.
//!
//! A polynomial, to the fourth degree along the arc and the second along x, follows an oval, a taper and a bow to a few
//! hundredths of their height, and no step: one in the middle leaves a fifth of its height.

use super::patches::{Averages, Patch};
use nalgebra::{Matrix2, SMatrix, SVector, Vector2};

const ALONG_ARC: usize = 5;
const ALONG_X: usize = 3;
const TERMS: usize = ALONG_ARC * ALONG_X;
/// Fewer patches than this for each term are followed by chance.
const PATCHES_A_TERM: usize = 4;

/// The averages without the form that a polynomial finds in them; `None` where they are too few.
pub(super) fn without_form(averages: &Averages) -> Option<Averages> {
    let patches = || averages.patches.iter().flatten();
    if patches().count() < PATCHES_A_TERM * TERMS {
        return None;
    }
    let [x, angle] = [range(patches().map(|patch| patch.x))?, range(patches().map(|patch| patch.angle))?];
    let terms = |patch: &Patch| terms(unit(patch.x, x), unit(patch.angle, angle));
    let (mut normal, mut right) = (SMatrix::<f64, TERMS, TERMS>::zeros(), SVector::<f64, TERMS>::zeros());
    for patch in patches() {
        let row = terms(patch);
        normal += row * row.transpose() * patch.share;
        right += row * (patch.d * patch.share);
    }
    let form = normal.cholesky()?.solve(&right);
    let left = |patch: &Patch| Patch { d: patch.d - terms(patch).dot(&form), ..*patch };
    let patches = averages.patches.iter().map(|patch| patch.as_ref().map(left)).collect();
    Some(Averages { grid: averages.grid.clone(), patches })
}

/// The averages without the shift, in y and in z, that each block of profiles shows by itself.
pub(super) fn without_shifts(averages: &Averages) -> Averages {
    let direction = |patch: &Patch| Vector2::new(patch.angle.cos(), patch.angle.sin());
    let mut patches = Vec::with_capacity(averages.patches.len());
    for block in averages.patches.chunks(averages.grid.sectors().max(1)) {
        let (mut normal, mut right) = (Matrix2::zeros(), Vector2::zeros());
        for patch in block.iter().flatten() {
            let row = direction(patch);
            normal += row * row.transpose() * patch.share;
            right += row * (patch.d * patch.share);
        }
        // A block with too little on it keeps what it has.
        let shift = normal.cholesky().map_or_else(Vector2::zeros, |normal| normal.solve(&right));
        let left = |patch: &Patch| Patch { d: patch.d - direction(patch).dot(&shift), ..*patch };
        patches.extend(block.iter().map(|patch| patch.as_ref().map(left)));
    }
    Averages { grid: averages.grid.clone(), patches }
}

fn range(values: impl Iterator<Item = f64>) -> Option<[f64; 2]> {
    let ends = |[low, high]: [f64; 2], v: f64| [low.min(v), high.max(v)];
    let [low, high] = values.fold([f64::INFINITY, f64::NEG_INFINITY], ends);
    (high > low).then_some([low, high])
}

/// From −1 to 1.
fn unit(value: f64, [low, high]: [f64; 2]) -> f64 {
    (2.0 * value - low - high) / (high - low)
}

/// Products of Chebyshev's polynomials, T_k = cos(k arccos t).
fn terms(x: f64, angle: f64) -> SVector<f64, TERMS> {
    let chebyshev = |degree: usize, t: f64| (degree as f64 * t.clamp(-1.0, 1.0).acos()).cos();
    SVector::from_fn(|index, _| chebyshev(index % ALONG_ARC, angle) * chebyshev(index / ALONG_ARC, x))
}
