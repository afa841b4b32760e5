//! The end of the part. The end plane is perpendicular to the axis, so one number is sought, its position along the axis. The
//! result is the point where the axis meets the plane, or a warning that the scan does not show it.
//!
//! With a tilted axis the columns of points reach the plane at different phases of the spacing of the profiles, so the
//! plane is far more accurate than the spacing. The calculation runs twice, coarsely over the whole scan and with every
//! point about the end, in the order of the modules:
//!
//! ```text
//! points --unroll--> (angle, position, height) --occupancy--> observations of presence --chamfer--> extent of the part
//!        --likelihood--> of a plane --marginalise--> over the poses --posterior--> position and uncertainty
//! ```

mod chamfer;
mod likelihood;
mod marginalise;
mod occupancy;
mod posterior;
mod unroll;

use super::estimate::{EndFace, EndFaces, Estimate, Outcome, Pose};
use super::settings::{End, Settings, TypeB};
use super::type_b;
use super::warning::Warning;
use crate::scan::{Grouping, Scan};
use chamfer::Beneath;
use likelihood::Likelihood;
use marginalise::Motions;
use nalgebra::Matrix5;
use occupancy::{Cells, Observation, Slant};
use posterior::Posterior;
use unroll::{Columns, Plane, Unrolled, View};

/// Points of a plane, columns and planes of the coarse search. Four points a column tolerate a quarter of drop-outs.
const COARSE_POINTS_MAX: usize = 64;
const COARSE_COLUMNS: usize = 16;
const COARSE_PLANES_MAX: usize = 4096;
/// A point lies on the surface within ε or this many standard deviations of its height, whichever is larger: in the coarse search
/// of its noise, in the fine search of its noise and of the uncertainty of the height from the pose.
const COARSE_SIGMAS: f64 = 5.0;
const FINE_SIGMAS: f64 = 3.0;
/// Largest uncertainty of the height as a share of the coarse tolerance: beyond it the surface may leave its tolerance without an
/// end.
const HEIGHT_SHARE_MAX: f64 = 0.75;
/// Planes of the fine search; a longer region is thinned by a stride.
const PLANES_MAX: usize = 256;
/// Points of a column in each plane, so that the raster leaves no column empty, and least and most columns.
const POINTS_PER_COLUMN: f64 = 2.0;
const COLUMNS_MIN: usize = 8;
const COLUMNS_MAX: usize = 1024;
/// Spacings that are examined before the end, those next to the end that are reserved for a ragged edge, and those examined beyond
/// the end and beyond its continuation below: a gap takes four.
const BEFORE: f64 = 10.0;
const UNSETTLED: f64 = 2.0;
const BEYOND: f64 = 4.0;

/// Adds the end faces that the settings request to an accepted estimate, and a warning for each one that is not observed.
pub(super) fn complete(scan: &Scan, settings: &Settings, estimate: &mut Estimate) {
    let asked = settings.end_face;
    let Outcome::Accepted(pose) = &mut estimate.outcome else { return };
    // Sections that were cut from a cloud end where points were cut off, and their points form no columns.
    if scan.grouping() == Grouping::Chosen {
        let unseen = [End::Near, End::Far].into_iter().filter(|end| asked.asks_for(*end));
        estimate.conditioning.warnings.extend(unseen.map(|end| Warning::EndFaceNotSeen { end }));
        return;
    }
    let search = Search {
        scan,
        pose,
        covariance: relative_to_scan(pose, &settings.type_b),
        sigma: estimate.residuals.map_or(0.0, |residuals| residuals.sigma),
        epsilon: settings.epsilon_mm,
        type_b: &settings.type_b,
    };
    let face = |end| asked.asks_for(end).then(|| search.find(end));
    let (near, far) = rayon::join(|| face(End::Near), || face(End::Far));
    let unseen = [(End::Near, near), (End::Far, far)].into_iter().filter(|(_, face)| matches!(face, Some(None)));
    estimate.conditioning.warnings.extend(unseen.map(|(end, _)| Warning::EndFaceNotSeen { end }));
    pose.end_faces = EndFaces { asked, near: near.flatten(), far: far.flatten() };
}

/// The covariance of the pose relative to the scan: an error that moves the whole scan moves the edge together with the axis.
fn relative_to_scan(pose: &Pose, type_b: &TypeB) -> Matrix5<f64> {
    let whole = type_b.of_whole_scan(&type_b::Found {
        axis: pose.axis,
        x_ref: pose.x_ref,
        radius: pose.radius,
        origin: [0.0; 3],
    });
    pose.uncertainty.without(&whole)
}

/// The inputs of the search for an end.
struct Search<'a> {
    scan: &'a Scan,
    pose: &'a Pose,
    covariance: Matrix5<f64>,
    /// Noise of a point, mm.
    sigma: f64,
    epsilon: f64,
    type_b: &'a TypeB,
}

/// The result of the coarse search. Lengths in mm along the axis.
struct About {
    /// End of the last spacing that shows the surface.
    last: f64,
    /// Extent of the continuation below the surface.
    beneath_to: f64,
    /// Position at which another object begins.
    next: f64,
    /// Uncertainty of the end relative to `last` because planes were left out.
    slack: f64,
    /// Largest distance of a point on the surface from it.
    tolerance: f64,
    /// Least and largest lead of the columns.
    leads: [f64; 2],
}

impl Search<'_> {
    /// `None` if the scan does not show the end.
    fn find(&self, end: End) -> Option<EndFace> {
        let view = View::new(self.pose, end);
        let planes = view.planes_outward(self.scan);
        let spacing = unroll::spacing(&planes)?;
        let about = self.about(&view, &planes, spacing)?;
        self.fine(&view, &planes, spacing, &about)
    }

    fn about(&self, view: &View, planes: &[Plane], spacing: f64) -> Option<About> {
        let coarse = unroll::thin(planes, COARSE_PLANES_MAX);
        let coarse_spacing = unroll::spacing(&coarse)?;
        let points = view.unroll(self.scan, &coarse, COARSE_POINTS_MAX);
        let tolerance = self.tolerance(COARSE_SIGMAS, 0.0);
        let columns = columns(&points, view, tolerance, |_| COARSE_COLUMNS, |_| true)?;
        let leads = columns.leads();
        let cells = Cells::of(&points, &coarse, columns, tolerance);
        let extent = occupancy::extent(&cells.observations(None, 0.0), 0.0, coarse_spacing)?;
        let height = view.height_uncertainty(&self.covariance, &cells.columns, extent.last);
        if height > HEIGHT_SHARE_MAX * tolerance {
            return None;
        }
        // The surface ends within the last spacing that shows it.
        let beneath = chamfer::beneath(&cells, extent.last - coarse_spacing, coarse_spacing, tolerance);
        // A long shaft would force the fine search to thin out the planes.
        let ledge_max = extent.last + 0.5 * PLANES_MAX as f64 * spacing;
        Some(About {
            last: extent.last,
            beneath_to: beneath.to(extent.last, ledge_max).max(extent.last),
            next: extent.next,
            slack: 2.0 * (coarse_spacing - spacing).max(0.0),
            tolerance: self.tolerance(FINE_SIGMAS, height),
            leads,
        })
    }

    fn fine(&self, view: &View, planes: &[Plane], spacing: f64, about: &About) -> Option<EndFace> {
        let settled = about.last - about.slack - UNSETTLED * spacing;
        let examined = BEFORE * spacing;
        let from = settled - examined;
        let to = about.next.min(about.beneath_to + about.slack + BEYOND * spacing);
        let [least, most] = about.leads;
        let within = planes.iter().filter(|plane| plane.t + most >= from && plane.t + least <= to);
        let planes = unroll::thin(&within.cloned().collect::<Vec<_>>(), PLANES_MAX);
        let spacing = unroll::spacing(&planes)?.max(spacing);
        let points = view.unroll(self.scan, &planes, usize::MAX);
        let of_count = |count: usize| (count as f64 * spacing / examined / POINTS_PER_COLUMN).round() as usize;
        let columns_count = |count: usize| of_count(count).clamp(COLUMNS_MIN, COLUMNS_MAX);
        let columns = columns(&points, view, about.tolerance, columns_count, |t| t >= from && t <= settled)?;
        let covariance = self.covariance.fixed_view::<4, 4>(0, 0).into_owned();
        let motions = Motions::about(about.last, view, &columns, covariance)?;
        let cells = Cells::of(&points, &planes, columns, about.tolerance);
        let region = Region { cells: &cells, from, to, spacing, sigma: self.sigma };
        let end = region.end(about.tolerance)?;
        let posterior = Posterior::of(&marginalise::planes(&end.likelihood.steps, &motions, end.to)?)?;
        let shortfall = posterior.flank_shortfall(&end.observations, &cells.columns, &motions);
        let centre = view.axis_at(posterior.mean);
        let standard = |variance_of_x: f64| {
            let normal = motions.common + variance_of_x / view.x_by_t().powi(2);
            (posterior.half_of_expanded(normal.sqrt()) + shortfall) * view.x_by_t()
        };
        // With a more uncertain axis the surface can leave its tolerance, which looks like an end.
        let known = 2.0 * standard(0.0) <= examined;
        known.then(|| EndFace { centre, x_standard: standard(self.type_b.along_x(centre)) })
    }

    /// Largest distance of a point on the surface from it, mm, if its height has this standard deviation in addition to its noise.
    fn tolerance(&self, sigmas: f64, height: f64) -> f64 {
        self.epsilon.max(sigmas * self.sigma.hypot(height))
    }
}

/// Columns of the points on the surface at the selected positions, as many as `columns_count` returns for these points.
fn columns(
    points: &[Unrolled],
    view: &View,
    tolerance: f64,
    columns_count: impl Fn(usize) -> usize,
    wanted: impl Fn(f64) -> bool,
) -> Option<Columns> {
    let on_surface = points.iter().filter(|point| point.height.abs() <= tolerance && wanted(point.t));
    let angles: Vec<f64> = on_surface.map(|point| point.angle).collect();
    let columns_count = columns_count(angles.len());
    Columns::of(angles, columns_count, view)
}

/// The cells about the end, within an interval of positions.
struct Region<'a> {
    cells: &'a Cells,
    from: f64,
    to: f64,
    spacing: f64,
    /// Noise of a point, mm.
    sigma: f64,
}

/// An end with the data from which it was found.
struct FoundEnd {
    observations: Vec<Observation>,
    likelihood: Likelihood,
    to: f64,
}

impl Region<'_> {
    /// The end of the surface or of the chamfer that follows it.
    fn end(&self, tolerance: f64) -> Option<FoundEnd> {
        let surface = self.end_with(None)?;
        match chamfer::beneath(self.cells, surface.likelihood.last, self.spacing, tolerance) {
            Beneath::Nothing | Beneath::Ledge(_) => Some(surface),
            Beneath::Chamfer(slant) => self.end_with(Some(&slant)),
            Beneath::Endless(_) => None,
        }
    }

    fn end_with(&self, slant: Option<&Slant>) -> Option<FoundEnd> {
        let mut observations = self.cells.observations(slant, self.sigma);
        let to = self.to.min(occupancy::extent(&observations, self.from, self.spacing)?.next);
        observations.retain(|observation| observation.t >= self.from && observation.t <= to);
        let likelihood = Likelihood::of(&observations, self.spacing, self.cells.columns.len())?;
        Some(FoundEnd { observations, likelihood, to })
    }
}
