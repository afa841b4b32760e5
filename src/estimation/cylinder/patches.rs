//! A scan's points near a cylinder, averaged over patches of neighbours: blocks of profiles along x, sectors of the arc.
//! An average scatters far less than a point, so layers show that hide in the noise of single points. In: a scan and a
//! cylinder. Out: a sample with one point a patch, and which patch any point belongs to. Must not judge patches.

use super::model::{Cylinder, Slice};
use super::sample::Sample;
use crate::scan::{Scan, Station};

/// Blocks along x and sectors of the arc, at most.
const BLOCKS_MAX: usize = 64;
const SECTORS_MAX: usize = 24;
/// Fewer sectors than this do not tell a layer's edge from its middle.
const SECTORS_MIN: usize = 8;
/// A patch with fewer points than this share of the middle one, or than three, is left out.
const POINTS_SHARE: f64 = 0.25;
/// Points that are looked at, at most.
const POINTS_MAX: usize = 60_000;

/// How fine the patches are.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Cut {
    /// Each profile in few sectors.
    Profiles,
    /// So many points a patch.
    Points(usize),
    /// As many of both, or as there are profiles.
    Cells { sectors: usize, blocks: usize },
}

/// How the surface is cut into patches.
#[derive(Debug, Clone)]
pub(super) struct Grid {
    cylinder: Cylinder,
    /// Stations in a block.
    block: usize,
    sectors: usize,
    /// Mean direction of the points from the axis.
    mean: [f64; 2],
    /// Angles of the first and the last point from there, radians.
    low: f64,
    high: f64,
}

/// The average of one patch.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct Patch {
    pub(super) count: f64,
    /// Sums first, means in the end: place and distance from the cylinder.
    pub(super) x: f64,
    pub(super) angle: f64,
    pub(super) d: f64,
}

/// The averages, blocks one after the other; `None` where too few points are.
pub(super) struct Averages {
    pub(super) grid: Grid,
    pub(super) patches: Vec<Option<Patch>>,
}

impl Grid {
    fn angle(&self, slice: &Slice, y: f64, z: f64) -> f64 {
        let ([u, w], [mean_u, mean_w]) = ([y - slice.y, z - slice.z], self.mean);
        (w * mean_u - u * mean_w).atan2(u * mean_u + w * mean_w)
    }

    /// The patch of the point (y, z) in the plane of the station `index`.
    pub(super) fn place(&self, index: usize, slice: &Slice, y: f64, z: f64) -> usize {
        let share = (self.angle(slice, y, z) - self.low) / (self.high - self.low).max(f64::MIN_POSITIVE);
        let sector = (share * self.sectors as f64).clamp(0.0, self.sectors as f64 - 1.0) as usize;
        index / self.block * self.sectors + sector
    }

    /// Profiles in a block.
    pub(super) fn block(&self) -> usize {
        self.block
    }

    pub(super) fn sectors(&self) -> usize {
        self.sectors
    }
}

/// Averages the points within `reach` of the cylinder; `None` where there are too few of them.
pub(super) fn average(scan: &Scan, used: &[bool], cylinder: &Cylinder, reach: f64, cut: Cut) -> Option<Averages> {
    let (grid, near) = self::cut(scan, used, cylinder, reach, cut)?;
    let mut patches = vec![Patch::default(); scan.stations().len().div_ceil(grid.block) * grid.sectors];
    for point in &near {
        let slice = cylinder.slice(point.x);
        if let Some(patch) = patches.get_mut(grid.place(point.index, &slice, point.y, point.z)) {
            patch.count += 1.0;
            patch.x += point.x;
            patch.angle += grid.angle(&slice, point.y, point.z);
            patch.d += slice.distance(point.y, point.z);
        }
    }
    let least = (POINTS_SHARE * near.len() as f64 / patches.len() as f64).max(3.0);
    let mean = |patch: Patch| {
        let Patch { count, x, angle, d } = patch;
        (count >= least).then(|| Patch { count, x: x / count, angle: angle / count, d: d / count })
    };
    Some(Averages { grid, patches: patches.into_iter().map(mean).collect() })
}

/// A point near the cylinder, and the index of its station.
pub(super) struct Near {
    pub(super) index: usize,
    pub(super) x: f64,
    pub(super) y: f64,
    pub(super) z: f64,
}

/// The points within `reach` of the cylinder, thinned out where there are many, and how they are cut into patches.
pub(super) fn cut(scan: &Scan, used: &[bool], cylinder: &Cylinder, reach: f64, cut: Cut) -> Option<(Grid, Vec<Near>)> {
    let stride = scan.columns().len().div_ceil(POINTS_MAX).max(1);
    let near = near(scan, used, cylinder, reach, stride);
    let grid = grid(scan, cylinder, &near, stride, cut)?;
    Some((grid, near))
}

fn near(scan: &Scan, used: &[bool], cylinder: &Cylinder, reach: f64, stride: usize) -> Vec<Near> {
    let mut near = Vec::new();
    let stations = scan.stations().iter().enumerate().zip(used).filter(|(_, used)| **used).map(|(s, _)| s);
    for (index, Station { x, start, end }) in stations {
        let slice = cylinder.slice(*x);
        // Another first point in each profile, so that no sector is left out.
        for [y, z] in (start + index % stride..*end).step_by(stride).filter_map(|place| scan.columns().get(place)) {
            if slice.distance(y, z).abs() < reach {
                near.push(Near { index, x: *x, y, z });
            }
        }
    }
    near
}

fn grid(scan: &Scan, cylinder: &Cylinder, near: &[Near], stride: usize, cut: Cut) -> Option<Grid> {
    let stations_count = scan.stations().len();
    let (sectors, blocks) = match cut {
        Cut::Profiles => (SECTORS_MIN, stations_count),
        Cut::Cells { sectors, blocks } => (sectors, blocks),
        Cut::Points(points) => {
            let wanted = near.len() * stride / points;
            let sectors = ((wanted as f64).sqrt() as usize).min(SECTORS_MAX);
            (sectors, (wanted / sectors.max(1)).clamp(1, BLOCKS_MAX.min(stations_count)))
        }
    };
    if sectors < SECTORS_MIN || near.is_empty() {
        return None;
    }
    let mut mean = [0.0; 2];
    for point in near {
        let slice = cylinder.slice(point.x);
        mean = [mean[0] + point.y - slice.y, mean[1] + point.z - slice.z];
    }
    let block = stations_count.div_ceil(blocks);
    let mut grid = Grid { cylinder: *cylinder, block, sectors, mean, low: f64::INFINITY, high: f64::NEG_INFINITY };
    for point in near {
        let angle = grid.angle(&cylinder.slice(point.x), point.y, point.z);
        (grid.low, grid.high) = (grid.low.min(angle), grid.high.max(angle));
    }
    (stations_count.div_ceil(block) >= 3).then_some(grid)
}

impl Averages {
    /// The averages as a scan's sample: each block a profile.
    pub(super) fn sample(&self) -> Sample {
        let mut sample = Sample { stations: Vec::new(), y: Vec::new(), z: Vec::new() };
        for block in self.patches.chunks(self.grid.sectors) {
            let count = block.iter().flatten().count();
            if count == 0 {
                continue;
            }
            let start = sample.y.len();
            // One plane for all: a point moves along the surface to it, and keeps its distance.
            let x = block.iter().flatten().map(|patch| patch.x).sum::<f64>() / count as f64;
            for patch in block.iter().flatten() {
                let [y, z] = self.grid.point(x, patch);
                sample.y.push(y);
                sample.z.push(z);
            }
            sample.stations.push(Station { x, start, end: sample.y.len() });
        }
        sample
    }

    /// Squared second differences of neighbours along the arc: what an average scatters by for itself.
    pub(super) fn squared_differences_along_arc(&self) -> Vec<f64> {
        let difference = |three: &[Option<Patch>]| match three {
            [Some(a), Some(b), Some(c)] => Some((b.d - 0.5 * (a.d + c.d)).powi(2) / 1.5),
            _ => None,
        };
        self.patches.chunks(self.grid.sectors).flat_map(|block| block.windows(3).filter_map(difference)).collect()
    }

    /// Squared differences of neighbours along x: the same, and how far whole profiles are off.
    pub(super) fn squared_differences_along_x(&self) -> Vec<f64> {
        let next = self.patches.iter().skip(self.grid.sectors);
        let both = self.patches.iter().zip(next).filter_map(|(a, b)| a.as_ref().zip(b.as_ref()));
        both.map(|(a, b)| (b.d - a.d).powi(2) / 2.0).collect()
    }
}

impl Grid {
    /// Where the average of a patch lies in the plane at `x`.
    pub(super) fn point(&self, x: f64, patch: &Patch) -> [f64; 2] {
        let slice = self.cylinder.slice(x);
        let length = self.mean[0].hypot(self.mean[1]).max(f64::MIN_POSITIVE);
        let [mean_u, mean_w] = self.mean.map(|v| v / length);
        let (sin, cos) = patch.angle.sin_cos();
        let (u, w) = (mean_u * cos - mean_w * sin, mean_w * cos + mean_u * sin);
        // The section reaches 1/√(1 − (p·u + q·w)²/n²) radii in the unit direction (u, w), and so does the distance.
        let along = (slice.p * u + slice.q * w).powi(2) * slice.per_n2;
        let reach = (slice.radius + patch.d) / (1.0 - along).sqrt();
        [slice.y + reach * u, slice.z + reach * w]
    }
}
