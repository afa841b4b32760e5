//! The end plane from every point about where the part ends. Must not know how that place was found.

use super::cells::{self, Cell};
use super::chamfer::{self, Chamfer};
use super::evidence::{self, Evidence};
use super::lattice::Lattice;
use super::offset::{self, Grid, Offset};
use super::reach::{self, Reach};
use super::sway::Sway;
use super::view::{self, Glimpse, Plane, View};
use crate::scan::Scan;
use nalgebra::Matrix5;

/// Planes about the end that are read in full. More are taken at a stride.
const PLANES_MAX: usize = 256;
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

/// What is known before every point about the end is read.
pub(super) struct Stage<'a> {
    pub(super) view: &'a View,
    /// Of the pose against what the scan shows.
    pub(super) covariance: &'a Matrix5<f64>,
    /// Noise of a point, mm.
    pub(super) sigma: f64,
    pub(super) about: Reach,
    /// How far the end may be from there, mm.
    pub(super) slack: f64,
    /// How far from the surface a point on it may lie, mm.
    pub(super) tolerance: f64,
    /// Least and most that the columns lie ahead of their plane, mm.
    pub(super) span: [f64; 2],
}

/// What is looked at along the axis, mm.
#[derive(Clone, Copy)]
struct Region {
    from: f64,
    /// Up to here no edge is ragged.
    settled: f64,
    to: f64,
}

impl Stage<'_> {
    /// Where the end plane is, and how much was looked at before it, mm; `None` where the scan does not show it.
    pub(super) fn offset(&self, scan: &Scan, planes: &[Plane]) -> Option<(Offset, f64)> {
        let spacing = view::spacing(planes)?;
        let region = self.region(spacing);
        let planes = self.planes_within(planes, region);
        // Those that are read may be fewer.
        let spacing = view::spacing(&planes)?.max(spacing);
        let glimpses = self.view.look(scan, &planes, usize::MAX);
        let lattice = self.lattice(&glimpses, region, spacing)?;
        let cells = cells::cells(&glimpses, &planes, &lattice, self.tolerance);
        let sway = self.view.sway(self.covariance, lattice.angles(), self.about.last)?;
        let Self { sigma, tolerance, .. } = *self;
        let search = Search { cells: &cells, lattice: &lattice, sway: &sway, sigma, tolerance, region, spacing };
        Some((search.end()?, region.settled - region.from))
    }

    fn region(&self, spacing: f64) -> Region {
        let length = |[mm, spacings]: [f64; 2]| f64::max(mm, spacings * spacing);
        let settled = self.about.last - self.slack - length(UNSETTLED);
        let to = self.about.next.min(self.about.last + self.slack + length(BEYOND));
        Region { from: settled - length(BEFORE), settled, to }
    }

    fn planes_within(&self, planes: &[Plane], Region { from, to, .. }: Region) -> Vec<Plane> {
        let [least, most] = self.span;
        let within = planes.iter().filter(|plane| plane.ahead + most >= from && plane.ahead + least <= to);
        view::thin(&within.cloned().collect::<Vec<_>>(), PLANES_MAX)
    }

    fn lattice(&self, glimpses: &[Glimpse], Region { from, settled, .. }: Region, spacing: f64) -> Option<Lattice> {
        let on_part = |g: &&Glimpse| g.height.abs() <= self.tolerance && g.t >= from && g.t <= settled;
        let angles: Vec<f64> = glimpses.iter().filter(on_part).map(|glimpse| glimpse.angle).collect();
        let columns_count = (angles.len() as f64 * spacing / (settled - from) / POINTS_PER_COLUMN).round() as usize;
        let [least, most] = COLUMNS;
        Lattice::of(angles, columns_count.clamp(least, most), self.view)
    }
}

/// The cells about the end, and what they are searched for.
struct Search<'a> {
    cells: &'a [Cell],
    lattice: &'a Lattice,
    sway: &'a Sway,
    /// Noise of a point, mm.
    sigma: f64,
    /// How far from the surface a point on it may lie, mm.
    tolerance: f64,
    region: Region,
    spacing: f64,
}

impl Search<'_> {
    /// The end of the surface, or where a chamfer follows on it, the end of that.
    fn end(&self) -> Option<Offset> {
        let surface = self.of(None)?;
        let (from, longest) = (surface.last - self.spacing - 1.0, surface.last + CHAMFER_LENGTH_MAX_MM);
        let Some(chamfer) = Chamfer::seen(self.cells, from, longest + self.spacing) else {
            return self.told(surface, None);
        };
        // Where no end is seen of it the scan may stop before it does.
        let with = self.of(Some(chamfer))?;
        // What goes on below the surface for longer is no chamfer, and the part ends where its surface does.
        if with.last < longest { self.told(with, Some(chamfer)) } else { self.told(surface, None) }
    }

    fn told(&self, offset: Offset, chamfer: Option<Chamfer>) -> Option<Offset> {
        let goes_on = chamfer::goes_on(self.cells, self.lattice.len(), chamfer, offset.last, self.tolerance);
        (!goes_on).then_some(offset)
    }

    fn of(&self, chamfer: Option<Chamfer>) -> Option<Offset> {
        let Region { from, to, .. } = self.region;
        let mut evidence: Vec<Evidence> = evidence::evidence(self.cells, self.lattice, chamfer, self.sigma);
        let next = reach::reach(&evidence, from, self.spacing)?.next;
        let to = to.min(next);
        evidence.retain(|evidence| evidence.t >= from && evidence.t <= to);
        let (step, columns_count) = (self.lattice.mean_step(), self.lattice.len());
        offset::find(&evidence, to, Grid { spacing: self.spacing, step, columns_count }, self.sway)
    }
}
