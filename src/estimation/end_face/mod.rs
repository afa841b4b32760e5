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
mod lattice;
mod marginal;
mod offset;
mod posterior;
mod reach;
mod sway;
mod view;

use super::{End, EndFace, EndFaces, Estimate, Outcome, Pose, Settings, TypeB, Warning, type_b};
use crate::scan::Scan;
use cells::{Cell, Chamfer, Evidence};
use lattice::Lattice;
use nalgebra::Matrix5;
use offset::{Grid, Offset};
use sway::Sway;
use view::{Glimpse, Plane, View};

/// Read of a plane to find about where the part ends, and the columns that these points are put in.
const COARSE_POINTS_MAX: usize = 64;
const COARSE_COLUMNS: usize = 16;
/// Planes that are looked at for that, and those that are read in full about the end. More are taken at a stride.
const COARSE_PLANES_MAX: usize = 4096;
const FINE_PLANES_MAX: usize = 256;
/// Columns about the end hold so many points of a profile, that one is not empty because the raster does not meet it; and
/// least and most of them.
const POINTS_PER_COLUMN: f64 = 2.0;
const COLUMNS: [usize; 2] = [8, 1024];
/// What is looked at before the end, and what of it is left to a ragged edge or a chamfer, as [mm, spacings].
const BEFORE: [f64; 2] = [10.0, 10.0];
const UNSETTLED: [f64; 2] = [4.0, 2.0];
/// What is looked at beyond the end of the surface, and the longest chamfer.
const BEYOND: [f64; 2] = [8.0, 4.0];
const CHAMFER_LENGTH_MAX_MM: f64 = 6.0;
/// A point counts as on the surface within this many sigma or within ε, whichever is more; and the share of that which the
/// pose may leave open, as a standard deviation.
const SURFACE_SIGMAS: f64 = 5.0;
const OPEN_MAX: f64 = 0.75;

/// Adds the end faces that the settings ask for to an accepted estimate, and a warning for each that is not seen.
pub(super) fn complete(scan: &Scan, settings: &Settings, estimate: &mut Estimate) {
    let asked = settings.end_face;
    let Outcome::Accepted(pose) = &mut estimate.outcome else { return };
    let sigma = estimate.residuals.map_or(0.0, |residuals| residuals.sigma);
    let tolerance = settings.epsilon_mm.max(SURFACE_SIGMAS * sigma);
    let known = Known { scan, pose, covariance: against_scan(pose, &settings.type_b), sigma, tolerance };
    let seen = |end| known.find(end).and_then(|found| found.face(&settings.type_b));
    let face = |end| asked.asks_for(end).then(|| seen(end));
    let (near, far) = rayon::join(|| face(End::Near), || face(End::Far));
    let unseen = [(End::Near, near), (End::Far, far)].into_iter().filter(|(_, face)| matches!(face, Some(None)));
    estimate.conditioning.warnings.extend(unseen.map(|(end, _)| Warning::EndFaceNotSeen { end }));
    pose.end_faces = EndFaces { asked, near: near.flatten(), far: far.flatten() };
}

/// The covariance of the pose against what the scan shows: what moves the whole scan moves the edge with the axis.
fn against_scan(pose: &Pose, type_b: &TypeB) -> Matrix5<f64> {
    let whole = type_b.of_whole_scan(&type_b::Found { axis: pose.axis, x_ref: pose.x_ref, radius: pose.radius });
    pose.uncertainty.without(&whole)
}

/// What is known before an end is looked for.
struct Known<'a> {
    scan: &'a Scan,
    pose: &'a Pose,
    covariance: Matrix5<f64>,
    /// Noise of a point, mm.
    sigma: f64,
    tolerance: f64,
}

impl Known<'_> {
    /// `None` where the scan does not show the end.
    fn find(&self, end: End) -> Option<Found> {
        let view = View::new(self.pose, end);
        let planes = view.planes_outward(self.scan);
        let coarse = view::thin(&planes, COARSE_PLANES_MAX);
        let coarse_spacing = view.spacing(&coarse)?;
        let glimpses = view.look(self.scan, &coarse, COARSE_POINTS_MAX);
        let on_surface = |glimpse: &&Glimpse| glimpse.height.abs() <= self.tolerance;
        let angles = glimpses.iter().filter(on_surface).map(|glimpse| glimpse.angle).collect();
        let lattice = Lattice::of(angles, COARSE_COLUMNS, &view)?;
        let seen = cells::cells(&glimpses, &coarse, &lattice, self.tolerance);
        let about = reach::reach(&cells::evidence(&seen, &lattice, None, 0.0), 0.0, coarse_spacing)?;
        // On an axis that may be off by that much the surface leaves its tolerance, and that is no end.
        let open = view.height_open(&self.covariance, lattice.angles(), about.last);
        let stage = Stage { known: self, view: &view, about, coarse_spacing, span: lattice.span() };
        (open <= OPEN_MAX * self.tolerance).then(|| stage.refine(&planes))?
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

/// What is known before every point about the end is read.
struct Stage<'a> {
    known: &'a Known<'a>,
    view: &'a View,
    about: reach::Reach,
    coarse_spacing: f64,
    /// Least and most that the columns lie ahead of their plane.
    span: [f64; 2],
}

impl Stage<'_> {
    fn refine(&self, planes: &[Plane]) -> Option<Found> {
        let Known { scan, ref covariance, sigma, tolerance, .. } = *self.known;
        let (view, spacing) = (self.view, self.view.spacing(planes)?);
        let slack = 2.0 * (self.coarse_spacing - spacing).max(0.0);
        let length = |[mm, spacings]: [f64; 2]| f64::max(mm, spacings * spacing) + slack;
        let from = self.about.last - length(BEFORE) - length(UNSETTLED);
        let to = self.about.next.min(self.about.last + length(BEYOND));
        let [least, most] = self.span;
        let within: Vec<Plane> =
            planes.iter().filter(|p| p.ahead + most >= from && p.ahead + least <= to).cloned().collect();
        let planes = view::thin(&within, FINE_PLANES_MAX);
        let spacing = view.spacing(&planes)?.max(spacing);
        let glimpses = view.look(scan, &planes, usize::MAX);
        let settled = self.about.last - length(UNSETTLED);
        let on_part = |g: &&Glimpse| g.height.abs() <= tolerance && g.t >= from && g.t <= settled;
        let angles: Vec<f64> = glimpses.iter().filter(on_part).map(|glimpse| glimpse.angle).collect();
        let columns = (angles.len() as f64 * spacing / (settled - from) / POINTS_PER_COLUMN).round() as usize;
        let [least, most] = COLUMNS;
        let lattice = Lattice::of(angles, columns.clamp(least, most), view)?;
        let cells = cells::cells(&glimpses, &planes, &lattice, tolerance);
        let sway = view.sway(covariance, lattice.angles(), self.about.last)?;
        let range = [from, to];
        let offset = Search { cells: &cells, lattice: &lattice, sway: &sway, sigma, range, spacing }.end()?;
        Some(Found { view: *view, offset, looked_at: length(BEFORE) })
    }
}

/// The cells about the end, and what they are searched for.
struct Search<'a> {
    cells: &'a [Cell],
    lattice: &'a Lattice,
    sway: &'a Sway,
    /// Noise of a point, mm.
    sigma: f64,
    range: [f64; 2],
    spacing: f64,
}

impl Search<'_> {
    /// The end of the surface, or where a chamfer follows on it, the end of that.
    fn end(&self) -> Option<Offset> {
        let surface = self.of(None)?;
        let (from, longest) = (surface.last - self.spacing - 1.0, surface.last + CHAMFER_LENGTH_MAX_MM);
        let chamfer = Chamfer { from, to: longest + self.spacing, depth: 0.0 };
        let Some(depth) = chamfer.depth_of(self.cells) else { return Some(surface) };
        let with = self.of(Some(Chamfer { depth, ..chamfer }));
        match with.filter(|with| with.last < longest) {
            // Its end lies deeper than what is told from a support.
            Some(_) if depth > cells::DEPTH_MAX_MM => None,
            // What goes on below the surface for longer is no chamfer, and the part ends where its surface does.
            None => Some(surface),
            with => with,
        }
    }

    fn of(&self, chamfer: Option<Chamfer>) -> Option<Offset> {
        let [from, to] = self.range;
        let mut evidence: Vec<Evidence> = cells::evidence(self.cells, self.lattice, chamfer, self.sigma);
        let next = reach::reach(&evidence, from, self.spacing)?.next;
        let to = to.min(next);
        evidence.retain(|evidence| evidence.t >= from && evidence.t <= to);
        let (step, columns_count) = (self.lattice.mean_step(), self.lattice.len());
        offset::find(&evidence, to, Grid { spacing: self.spacing, step, columns_count }, self.sway)
    }
}
