//! Where the part ends: the end plane is square to the axis, so one number is sought, its offset along the axis. In: a scan
//! and its accepted pose; out: the point where the axis meets the plane, or a warning that the scan does not show it. Must
//! not know how the pose was found.
//!
//! A place on the cylinder lies at t = T·(P − P_ref), outward. Places that show a point lie before the plane, those that
//! show none beyond it, in every column of every profile: with a tilted axis the columns reach t in other phases of the
//! spacing, and the plane is known far better than the spacing.
//!
//! ```text
//! planes --64 points each--> cells --reach--> about where --every point, at most 256 planes--> cells
//!                --reach--> up to the first gap --offset--> likelihood of t --marginal, over poses--> t --view--> EndFace
//! ```

mod cells;
mod chamfer;
mod evidence;
mod fine;
mod lattice;
mod marginal;
mod offset;
mod posterior;
mod reach;
mod sway;
mod view;

use super::{End, EndFace, EndFaces, Estimate, Outcome, Pose, Settings, TypeB, Warning, type_b};
use crate::scan::{Grouping, Scan};
use fine::Stage;
use lattice::Lattice;
use nalgebra::Matrix5;
use offset::Offset;
use view::{Glimpse, View};

/// Read of a plane to find about where the part ends, and the columns that these points are put in.
const COARSE_POINTS_MAX: usize = 64;
const COARSE_COLUMNS: usize = 16;
/// Planes that are looked at for that. More are taken at a stride.
const COARSE_PLANES_MAX: usize = 4096;
/// A point counts as on the surface within so many standard deviations of its height or within ε, whichever is more: at
/// first of its noise alone, about the end of what the pose leaves open as well. And the share of the first tolerance that
/// this may be.
const COARSE_SIGMAS: f64 = 5.0;
const FINE_SIGMAS: f64 = 3.0;
const OPEN_MAX: f64 = 0.75;

/// Adds the end faces that the settings ask for to an accepted estimate, and a warning for each that is not seen.
pub(super) fn complete(scan: &Scan, settings: &Settings, estimate: &mut Estimate) {
    let asked = settings.end_face;
    let Outcome::Accepted(pose) = &mut estimate.outcome else { return };
    // Sections that were cut from a cloud end where points were cut off, and show no column of a raster.
    if scan.grouping() == Grouping::Chosen {
        let unseen = [End::Near, End::Far].into_iter().filter(|end| asked.asks_for(*end));
        estimate.conditioning.warnings.extend(unseen.map(|end| Warning::EndFaceNotSeen { end }));
        return;
    }
    let sigma = estimate.residuals.map_or(0.0, |residuals| residuals.sigma);
    let covariance = against_scan(pose, &settings.type_b);
    let known = Known { scan, pose, covariance, sigma, epsilon: settings.epsilon_mm };
    let seen = |end| known.find(end).and_then(|found| found.face(&settings.type_b));
    let face = |end| asked.asks_for(end).then(|| seen(end));
    let (near, far) = rayon::join(|| face(End::Near), || face(End::Far));
    let unseen = [(End::Near, near), (End::Far, far)].into_iter().filter(|(_, face)| matches!(face, Some(None)));
    estimate.conditioning.warnings.extend(unseen.map(|(end, _)| Warning::EndFaceNotSeen { end }));
    pose.end_faces = EndFaces { asked, near: near.flatten(), far: far.flatten() };
}

/// The covariance of the pose against what the scan shows: what moves the whole scan moves the edge with the axis.
fn against_scan(pose: &Pose, type_b: &TypeB) -> Matrix5<f64> {
    let whole = type_b.of_whole_scan(&type_b::Found {
        axis: pose.axis,
        x_ref: pose.x_ref,
        radius: pose.radius,
        origin: [0.0; 3],
    });
    pose.uncertainty.without(&whole)
}

/// What is known before an end is looked for.
struct Known<'a> {
    scan: &'a Scan,
    pose: &'a Pose,
    covariance: Matrix5<f64>,
    /// Noise of a point, mm.
    sigma: f64,
    /// ε, mm.
    epsilon: f64,
}

impl Known<'_> {
    /// `None` where the scan does not show the end.
    fn find(&self, end: End) -> Option<Found> {
        let view = View::new(self.pose, end);
        let planes = view.planes_outward(self.scan);
        let coarse = view::thin(&planes, COARSE_PLANES_MAX);
        let coarse_spacing = view::spacing(&coarse)?;
        let glimpses = view.look(self.scan, &coarse, COARSE_POINTS_MAX);
        let tolerance = self.tolerance(COARSE_SIGMAS, 0.0);
        let on_surface = |glimpse: &&Glimpse| glimpse.height.abs() <= tolerance;
        let angles = glimpses.iter().filter(on_surface).map(|glimpse| glimpse.angle).collect();
        let lattice = Lattice::of(angles, COARSE_COLUMNS, &view)?;
        let seen = cells::cells(&glimpses, &coarse, &lattice, tolerance);
        let about = reach::reach(&evidence::evidence(&seen, &lattice, None, 0.0), 0.0, coarse_spacing)?;
        // On an axis that may be off by that much the surface leaves its tolerance, and that is no end.
        let open = view.height_open(&self.covariance, lattice.angles(), about.last);
        if open > OPEN_MAX * tolerance {
            return None;
        }
        let slack = 2.0 * (coarse_spacing - view::spacing(&planes)?).max(0.0);
        let (tolerance, span) = (self.tolerance(FINE_SIGMAS, open), lattice.span());
        let stage =
            Stage { view: &view, covariance: &self.covariance, sigma: self.sigma, about, slack, tolerance, span };
        let (offset, looked_at) = stage.offset(self.scan, &planes)?;
        Some(Found { view, offset, looked_at })
    }

    /// How far from the surface a point may lie on it, where the pose leaves its height open to that standard deviation, mm.
    fn tolerance(&self, sigmas: f64, open: f64) -> f64 {
        self.epsilon.max(sigmas * self.sigma.hypot(open))
    }
}

/// An end as it was seen.
struct Found {
    view: View,
    offset: Offset,
    /// How much was looked at before the end, mm.
    looked_at: f64,
}

impl Found {
    /// `None` where the pose leaves more open than was looked at: an axis that is off lets the surface leave its tolerance,
    /// and that is no end.
    fn face(&self, type_b: &TypeB) -> Option<EndFace> {
        let centre = self.view.point(&self.offset);
        let standard = |variance: f64| self.view.half_of_expanded(&self.offset, variance);
        let x_standard = standard(type_b.along_x(centre));
        (2.0 * standard(0.0) <= self.looked_at).then_some(EndFace { centre, x_standard })
    }
}
