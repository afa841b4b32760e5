//! A robust straight line through the centres of the sections, its covariance, and its response to errors of the sensor.
//!
//! y = y_ref + p·(x − x_ref) and z likewise, each by weighted least squares, re-weighted by Tukey on the distance of the centre
//! from the line, |P_i P_0 × T| / |T|, until the weights settle. The covariance is the sandwich B (Σ G_i G_iᵀ) Bᵀ with the profile
//! as the cluster: errors common to the points of a profile are in its centre, so no assumption about them is needed.
//!
//! The response to a shift in z of the points at each position of the laser line, in all profiles together, is calculated by
//! fitting some sections again with the points of a patch shifted; each of them represents its neighbours.

use super::section::Workspace;
use crate::estimation::estimate::Profile;
use crate::estimation::settings::Settings;
use crate::estimation::statistics::{self, TWO_SIGMA, coverage_ratio};
use crate::estimation::type_b::{Influence, PatchInfluence, Patches};
use crate::geometry::{AxisLine, SectionEllipse};
use crate::scan::{Scan, Station};
use nalgebra::{Matrix2, Matrix5, Matrix5x2, Vector2, Vector5};
use rayon::prelude::*;

/// The centre and radius of one profile, mm.
#[derive(Debug, Clone, Copy)]
pub(super) struct Centre {
    pub(super) x: f64,
    pub(super) y: f64,
    pub(super) z: f64,
    pub(super) radius: f64,
}

/// The line and its properties.
#[derive(Debug, Clone)]
pub(super) struct Fit {
    pub(super) axis: AxisLine,
    pub(super) x_ref: f64,
    pub(super) radius: f64,
    /// Covariance of (p, q, y_ref, z_ref, radius), widened for its degrees of freedom.
    pub(super) covariance: Matrix5<f64>,
    pub(super) freedom: f64,
    /// One a centre; 0 for a centre off the axis.
    pub(super) weights: Vec<f64>,
    /// The response of the line to a shift of a centre; one for each centre with a weight.
    pub(super) influences: Vec<Influence>,
}

/// Whether outlying centres lose their weight.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Reweighting {
    Tukey,
    None,
}

/// Largest leverage of a centre; with a larger one its error cannot be estimated.
const LEVERAGE_MAX: f64 = 0.95;
const ROUNDS_MAX: usize = 100;
/// Index of y_ref among the parameters; z_ref follows it.
const Y_REF: usize = 2;
/// The weights have settled when no change is larger.
const SETTLED: f64 = 1e-9;
/// Distances below this share of the lengths involved are rounding.
const SPREAD_FLOOR: f64 = 1e-10;

/// Fits the line; `None` if fewer than two distinct x remain.
pub(super) fn fit(centres: &[Centre], reweighting: Reweighting) -> Option<Fit> {
    let middle = centres.iter().map(|c| c.x).sum::<f64>() / centres.len() as f64;
    let mut weights = vec![1.0; centres.len()];
    let mut axis = line(centres, &weights, middle)?;
    let mut cut_off = f64::INFINITY;
    if reweighting == Reweighting::Tukey {
        for _ in 0..ROUNDS_MAX {
            let squared: Vec<f64> = centres.iter().map(|c| axis.distance([c.x, c.y, c.z]).powi(2)).collect();
            let size = centres.iter().fold(0.0_f64, |size, c| size.max(c.y.abs()).max(c.z.abs()).max(c.radius));
            let sigma =
                statistics::sigma(&squared, &mut Vec::new()).max(SPREAD_FLOOR * size).max(f64::MIN_POSITIVE.sqrt());
            cut_off = statistics::cut_off_squared(sigma);
            let before = weights;
            weights = squared.iter().map(|&r2| statistics::weight(r2, cut_off)).collect();
            axis = line(centres, &weights, middle)?;
            if weights.iter().zip(&before).all(|(now, before)| (now - before).abs() < SETTLED) {
                break;
            }
        }
    }
    let (x_sum, used_count) = centres
        .iter()
        .zip(&weights)
        .filter(|(_, w)| **w > 0.0)
        .fold((0.0, 0.0), |(sum, count), (c, _)| (sum + c.x, count + 1.0));
    let x_ref = x_sum / used_count;
    let sum: f64 = weights.iter().sum();
    let radius = centres.iter().zip(&weights).map(|(c, w)| w * c.radius).sum::<f64>() / sum;
    // The fit takes two parameters a coordinate from the remaining centres.
    let freedom = (used_count - 2.0).max(1.0);
    let (covariance, influences) = sensitivity(centres, &weights, &axis, x_ref, radius, cut_off)?;
    let covariance = covariance * coverage_ratio(freedom, TWO_SIGMA).powi(2);
    Some(Fit { axis, x_ref, radius, covariance, freedom, weights, influences })
}

/// Weighted least squares of y and z on x.
fn line(centres: &[Centre], weights: &[f64], middle: f64) -> Option<AxisLine> {
    let mut normal = Matrix2::zeros();
    let (mut right_y, mut right_z) = (Vector2::zeros(), Vector2::zeros());
    for (c, &w) in centres.iter().zip(weights) {
        let row = Vector2::new(1.0, c.x - middle);
        normal += row * row.transpose() * w;
        right_y += row * (w * c.y);
        right_z += row * (w * c.z);
    }
    let inverse = normal.cholesky()?;
    let (y, z) = (inverse.solve(&right_y), inverse.solve(&right_z));
    let axis = AxisLine::through([middle, y.x, z.x], y.y, z.y);
    [axis.p, axis.q, axis.y0, axis.z0].iter().all(|v| v.is_finite()).then_some(axis)
}

/// The covariance of the line by the scatter of the centres, and its response to a shift of each.
fn sensitivity(
    centres: &[Centre],
    weights: &[f64],
    axis: &AxisLine,
    x_ref: f64,
    radius: f64,
    cut_off: f64,
) -> Option<(Matrix5<f64>, Vec<Influence>)> {
    // Internal order: p, q, y_ref, z_ref, radius.
    let (mut hessian, mut scatter) = (Matrix5::<f64>::zeros(), Matrix5::<f64>::zeros());
    let mut blocks = Vec::with_capacity(centres.len());
    let (weight, spread) = centres
        .iter()
        .zip(weights)
        .fold((0.0, 0.0), |(weight, spread), (c, &w)| (weight + w, spread + w * (c.x - x_ref).powi(2)));
    for (c, &w) in centres.iter().zip(weights).filter(|(_, w)| **w > 0.0) {
        let dx = c.x - x_ref;
        let [line_y, line_z] = axis.at(c.x);
        let (ry, rz) = (c.y - line_y, c.z - line_z);
        // A centre attracts the line; its residual is corrected for this (MacKinnon and White, HC3).
        let leverage = (w / weight + w * dx * dx / spread).min(LEVERAGE_MAX);
        let gradient = Vector5::new(dx * ry, dx * rz, ry, rz, c.radius - radius) * (w / (1.0 - leverage));
        scatter += gradient * gradient.transpose();
        // d(w r)/dr = w·1 − 4·√w/cut² · r rᵀ for Tukey's weight.
        let bend = 4.0 * w.sqrt() / cut_off;
        let (kyy, kyz, kzz) = (w - bend * ry * ry, -bend * ry * rz, w - bend * rz * rz);
        #[rustfmt::skip]
        let block = Matrix5::new(
            dx * dx * kyy, dx * dx * kyz, dx * kyy, dx * kyz, 0.0,
            dx * dx * kyz, dx * dx * kzz, dx * kyz, dx * kzz, 0.0,
            dx * kyy, dx * kyz, kyy, kyz, 0.0,
            dx * kyz, dx * kzz, kyz, kzz, 0.0,
            0.0, 0.0, 0.0, 0.0, w,
        );
        hessian += block;
        blocks.push((c.x, block));
    }
    let bread = hessian.try_inverse()?;
    let matrix = bread * scatter * bread.transpose();
    let matrix = (matrix + matrix.transpose()) * 0.5;
    let influence = |(x, block): (f64, Matrix5<f64>)| Influence { x, effect: bread * block.fixed_columns::<2>(Y_REF) };
    let influences = blocks.into_iter().map(influence).collect();
    matrix.iter().all(|v| v.is_finite()).then_some((matrix, influences))
}

/// Number of sections that are fitted again. The response of a section to a patch changes slowly along the part, as its arc does.
const SECTIONS: usize = 16;
const RADIUS: usize = 4;

/// Neighbouring sections, of which the middle one represents the others.
struct Group {
    ellipse: SectionEllipse,
    y: Vec<f64>,
    z: Vec<f64>,
    /// Response of the axis to a shift of all their centres,
    by_centre: Matrix5x2<f64>,
    /// and of the radius to a change of all their radii.
    by_radius: f64,
}

/// A section, its profile, the response of the axis to a shift of its centre, and that of the radius to a change of its own radius.
type Section<'a> = (SectionEllipse, &'a Station, Matrix5x2<f64>, f64);

/// The response to each patch; empty if there are none.
pub(super) fn influences(scan: &Scan, profiles: &[Profile], fit: &Fit, settings: &Settings) -> Vec<PatchInfluence> {
    let groups = groups(scan, profiles, fit);
    // Points next to the part have no influence.
    let on_part = |group: &Group, y: f64| (y - group.ellipse.centre_y).abs() <= group.ellipse.semi_major;
    let places = groups.iter().flat_map(|group| group.y.iter().copied().filter(|y| on_part(group, *y)));
    let Some(patches) = Patches::over(places) else {
        return Vec::new();
    };
    let heights: Vec<f64> = groups.iter().map(|group| group.ellipse.centre_z).collect();
    let middle = heights.iter().sum::<f64>() / heights.len() as f64;
    let responses: Vec<Vec<Vector5<f64>>> =
        groups.into_par_iter().map(|group| response(group, patches, settings)).collect();
    let mut effects = vec![[Vector5::zeros(); 2]; Patches::count()];
    for (response, height) in responses.into_iter().zip(heights) {
        for ([effect, slope], by) in effects.iter_mut().zip(response) {
            *effect += by;
            *slope += by * (height - middle);
        }
    }
    patches.influences(effects)
}

fn groups(scan: &Scan, profiles: &[Profile], fit: &Fit) -> Vec<Group> {
    // The fit has an influence for each centre with a weight; profiles whose centre has none have been rejected meanwhile.
    let valid = profiles.iter().zip(scan.stations()).filter(|(profile, _)| profile.rejected.is_none());
    let fitted = valid.filter_map(|(profile, station)| Some((profile.section?.ellipse, station)));
    let weights: Vec<f64> = fit.weights.iter().copied().filter(|weight| *weight > 0.0).collect();
    let weight: f64 = weights.iter().sum();
    let sections: Vec<Section<'_>> = fitted
        .zip(fit.influences.iter().zip(&weights))
        .map(|((ellipse, station), (influence, own))| (ellipse, station, influence.effect, own / weight))
        .collect();
    let group = |sections: &[Section<'_>]| {
        let (ellipse, station, ..) = sections.get(sections.len() / 2)?;
        let (mut y, mut z) = (Vec::new(), Vec::new());
        scan.load(**station, &mut y, &mut z);
        let by_centre = sections.iter().map(|(.., effect, _)| effect).sum();
        Some(Group { ellipse: *ellipse, y, z, by_centre, by_radius: sections.iter().map(|(.., share)| share).sum() })
    };
    sections.chunks(sections.len().div_ceil(SECTIONS).max(1)).filter_map(group).collect()
}

/// The change of (p, q, y_ref, z_ref, radius) by a shift of each patch in the sections of a group.
fn response(group: Group, patches: Patches, settings: &Settings) -> Vec<Vector5<f64>> {
    let Group { y, z, by_centre, by_radius, .. } = group;
    let mut workspace = Workspace::default();
    (workspace.y, workspace.z) = (y, z);
    let effect = |[y, z, radius]: [f64; 3]| by_centre * Vector2::new(y, z) + Vector5::ith(RADIUS, by_radius * radius);
    workspace.responses(settings, &patches).into_iter().map(effect).collect()
}
