//! Averages of a scan's points near a cylinder over patches of neighbours: blocks of profiles along x, sectors of the arc. An
//! average scatters far less than a point, so it shows layers that are lower than the noise of single points. A scan and a cylinder
//! give a sample with one point a patch, and the patch to which any point belongs.

use super::model::{Cylinder, Slice};
use super::sample::{Sample, spread};
use crate::scan::{Scan, Station};
use rayon::prelude::*;
use std::f64::consts::TAU;

/// Blocks along x and sectors of the arc, at most.
const BLOCKS_MAX: usize = 64;
const SECTORS_MAX: usize = 24;
/// With fewer sectors than this the edge of a layer cannot be distinguished from its middle.
const SECTORS_MIN: usize = 8;
/// A patch with fewer points than this share of the median patch, or than three, is left out.
const POINTS_SHARE: f64 = 0.25;
/// Points that are examined, at most: some fifteen a patch.
const POINTS_MAX: usize = 24_000;
/// Profiles that are examined, at most.
const PROFILES_MAX: usize = 512;
/// Profiles, and points of each, that determine the viewing direction.
const SEEN: usize = 32;
/// Stations in one piece of work.
const CHUNK: usize = 64;

/// How fine the patches are.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Cut {
    /// This many points a patch.
    Points(usize),
    /// This many sectors and blocks, or as many blocks as there are profiles.
    Cells { sectors: usize, blocks: usize },
}

/// A point near the cylinder.
#[derive(Debug, Clone, Copy)]
pub(super) struct Near {
    /// Index of its station.
    pub(super) index: usize,
    pub(super) x: f64,
    pub(super) y: f64,
    pub(super) z: f64,
    /// About the axis, from the middle direction, radians.
    pub(super) angle: f64,
    /// Signed distance from the cylinder, mm.
    pub(super) d: f64,
}

/// The points of a scan near a cylinder, thinned out if there are many.
#[derive(Debug, Clone)]
pub(super) struct Surface {
    cylinder: Cylinder,
    /// Direction from the axis to the middle of the observed part, of length 1.
    mean: [f64; 2],
    pub(super) near: Vec<Near>,
    stations_count: usize,
    /// One in this many profiles was examined,
    pub(super) every: usize,
    /// and one in this many of its points.
    stride: usize,
}

/// A range of directions about an axis.
#[derive(Debug, Clone, Copy)]
pub(super) struct Directions {
    mean: [f64; 2],
    /// Angle of the first direction, and length of the range, radians.
    first: f64,
    length: f64,
}

impl Directions {
    /// Whether the point (y, z) lies in one of them.
    pub(super) fn contain(&self, slice: &Slice, y: f64, z: f64) -> bool {
        (angle(self.mean, slice, y, z) - self.first).rem_euclid(TAU) <= self.length
    }
}

/// How the surface is cut into patches.
#[derive(Debug, Clone)]
pub(super) struct Grid {
    cylinder: Cylinder,
    mean: [f64; 2],
    /// Stations in a block.
    block: usize,
    sectors: usize,
    /// Angles of the first and the last point, radians.
    low: f64,
    high: f64,
}

/// The average of one patch.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct Patch {
    pub(super) count: f64,
    /// Sums at first, means in the end: position and distance from the cylinder.
    pub(super) x: f64,
    pub(super) angle: f64,
    pub(super) d: f64,
    /// Its points as a share of the usual number, at most 1: an average of few points scatters more.
    pub(super) share: f64,
}

/// The averages, one block after the other; `None` for a patch with too few points.
pub(super) struct Averages {
    pub(super) grid: Grid,
    pub(super) patches: Vec<Option<Patch>>,
}

/// The points within `reach` of the cylinder; `None` if there are none.
pub(super) fn look(scan: &Scan, used: &[bool], cylinder: &Cylinder, reach: f64) -> Option<Surface> {
    let (points, every) = (scan.points(), scan.stations().len().div_ceil(PROFILES_MAX).max(1));
    let stride = (points.end - points.start).div_ceil(POINTS_MAX * every).max(1);
    let mean = direction(scan, cylinder, reach);
    let looked_at: Vec<(usize, &Station)> = scan
        .stations()
        .iter()
        .zip(used)
        .enumerate()
        .step_by(every)
        .filter(|(_, (_, used))| **used)
        .map(|(i, (s, _))| (i, s))
        .collect();
    let chunk = |stations: &[(usize, &Station)]| {
        let mut near = Vec::new();
        for (index, station) in stations {
            let (index, slice) = (*index, cylinder.slice(station.x));
            // The first point differs between profiles, so that no sector is left out.
            let places = (station.start + index / every % stride..station.end).step_by(stride);
            for [x, y, z] in places.filter_map(|place| scan.point(station, place)) {
                let slice = slice.at(x);
                let d = slice.distance(y, z);
                if d.abs() < reach {
                    let [cos, sin] = turned(mean, &slice, y, z);
                    near.push(Near { index, x, y, z, angle: sin.atan2(cos), d });
                }
            }
        }
        near
    };
    let near: Vec<Near> = looked_at.par_chunks(CHUNK).flat_map_iter(chunk).collect();
    let stations_count = scan.stations().len();
    (!near.is_empty()).then_some(Surface { cylinder: *cylinder, mean, near, stations_count, every, stride })
}

/// The direction from the axis to the middle of some points near the cylinder; points next to the part are ignored.
fn direction(scan: &Scan, cylinder: &Cylinder, reach: f64) -> [f64; 2] {
    let mut sum = [0.0; 2];
    let stations = scan.stations();
    for station in spread(stations.len(), SEEN).filter_map(|index| stations.get(index)) {
        let slice = cylinder.slice(station.x);
        let places = spread(station.end - station.start, SEEN).map(|place| station.start + place);
        for [x, y, z] in places.filter_map(|place| scan.point(station, place)) {
            let slice = slice.at(x);
            if slice.distance(y, z).abs() >= reach {
                continue;
            }
            sum = [sum[0] + y - slice.y, sum[1] + z - slice.z];
        }
    }
    let length = sum[0].hypot(sum[1]).max(f64::MIN_POSITIVE);
    sum.map(|v| v / length)
}

fn angle(mean: [f64; 2], slice: &Slice, y: f64, z: f64) -> f64 {
    let [along, aside] = turned(mean, slice, y, z);
    aside.atan2(along)
}

/// The point relative to the axis, along the middle direction and perpendicular to it.
fn turned([mean_u, mean_w]: [f64; 2], slice: &Slice, y: f64, z: f64) -> [f64; 2] {
    let [u, w] = [y - slice.y, z - slice.z];
    [u * mean_u + w * mean_w, w * mean_u - u * mean_w]
}

impl Surface {
    /// The range of directions from an angle about the middle direction onwards.
    pub(super) fn directions(&self, first: f64, length: f64) -> Directions {
        Directions { mean: self.mean, first, length }
    }

    pub(super) fn stations_count(&self) -> usize {
        self.stations_count
    }

    /// One in this many points was examined.
    pub(super) fn thinned(&self) -> usize {
        self.every * self.stride
    }

    /// Averages over patches; `None` if there are too few points.
    pub(super) fn average(&self, cut: Cut) -> Option<Averages> {
        let grid = self.grid(cut)?;
        let mut patches = vec![Patch::default(); self.stations_count.div_ceil(grid.block) * grid.sectors];
        for point in &self.near {
            if let Some(patch) = patches.get_mut(grid.patch(point.index, point.angle)) {
                patch.count += 1.0;
                patch.x += point.x;
                patch.angle += point.angle;
                patch.d += point.d;
            }
        }
        let filled_count = patches.iter().filter(|patch| patch.count > 0.0).count();
        let usual = self.near.len() as f64 / filled_count.max(1) as f64;
        let least = (POINTS_SHARE * usual).max(3.0);
        let mean = |patch: Patch| {
            let Patch { count, x, angle, d, .. } = patch;
            let share = (count / usual).min(1.0);
            (count >= least).then(|| Patch { count, x: x / count, angle: angle / count, d: d / count, share })
        };
        Some(Averages { grid, patches: patches.into_iter().map(mean).collect() })
    }

    /// The grid of patches; `None` if there are too few points.
    pub(super) fn grid(&self, cut: Cut) -> Option<Grid> {
        let stations_count = self.stations_count;
        let (sectors, blocks) = match cut {
            Cut::Cells { sectors, blocks } => (sectors, blocks),
            Cut::Points(points) => {
                let wanted = self.near.len() * self.thinned() / points;
                let sectors = ((wanted as f64).sqrt() as usize).min(SECTORS_MAX);
                (sectors, (wanted / sectors.max(1)).clamp(1, BLOCKS_MAX.min(stations_count)))
            }
        };
        let block = stations_count.div_ceil(blocks.max(1)).max(1);
        if sectors < SECTORS_MIN || stations_count.div_ceil(block) < 3 {
            return None;
        }
        let [low, high] = self.ends();
        Some(Grid { cylinder: self.cylinder, mean: self.mean, block, sectors, low, high })
    }

    /// Angles of the first and the last point, radians.
    pub(super) fn ends(&self) -> [f64; 2] {
        let ends = |[low, high]: [f64; 2], point: &Near| [low.min(point.angle), high.max(point.angle)];
        self.near.iter().fold([f64::INFINITY, f64::NEG_INFINITY], ends)
    }
}

impl Grid {
    /// The patch of a point at this angle in the plane of the station `index`.
    pub(super) fn patch(&self, index: usize, angle: f64) -> usize {
        index / self.block * self.sectors + self.sector(angle)
    }

    /// The sector of a point at this angle.
    pub(super) fn sector(&self, angle: f64) -> usize {
        sector(angle, [self.low, self.high], self.sectors)
    }

    /// The patch of the point (y, z) in the plane of the station `index`.
    pub(super) fn place(&self, index: usize, slice: &Slice, y: f64, z: f64) -> usize {
        self.patch(index, angle(self.mean, slice, y, z))
    }

    pub(super) fn sectors(&self) -> usize {
        self.sectors
    }

    /// Stations in a block.
    pub(super) fn block(&self) -> usize {
        self.block
    }
}

/// Index of the sector that contains an angle, of a number of equal sectors between two angles.
pub(super) fn sector(angle: f64, [low, high]: [f64; 2], sectors: usize) -> usize {
    let share = (angle - low) / (high - low).max(f64::MIN_POSITIVE);
    (share * sectors as f64).clamp(0.0, sectors as f64 - 1.0) as usize
}

impl Averages {
    /// The averages as a sample of a scan: each block is a profile.
    pub(super) fn sample(&self) -> Sample {
        let mut sample = Sample::default();
        for block in self.patches.chunks(self.grid.sectors) {
            let count = block.iter().flatten().count();
            if count == 0 {
                continue;
            }
            // All points of a block get one plane: a point moves along the surface into it and keeps its distance.
            let x = block.iter().flatten().map(|patch| patch.x).sum::<f64>() / count as f64;
            let place = |patch: &Patch| {
                let [y, z] = self.grid.point(x, patch);
                [x, y, z]
            };
            sample.push(x, block.iter().flatten().map(place));
        }
        sample
    }

    /// Squared second differences of neighbours along the arc: the scatter of the averages themselves.
    pub(super) fn squared_differences_along_arc(&self) -> Vec<f64> {
        let difference = |three: &[Option<Patch>]| match three {
            [Some(a), Some(b), Some(c)] => Some((b.d - 0.5 * (a.d + c.d)).powi(2) / 1.5),
            _ => None,
        };
        self.patches.chunks(self.grid.sectors).flat_map(|block| block.windows(3).filter_map(difference)).collect()
    }

    /// Squared differences of neighbours along x: the same, plus the displacement of whole profiles.
    pub(super) fn squared_differences_along_x(&self) -> Vec<f64> {
        let next = self.patches.iter().skip(self.grid.sectors);
        let both = self.patches.iter().zip(next).filter_map(|(a, b)| a.as_ref().zip(b.as_ref()));
        both.map(|(a, b)| (b.d - a.d).powi(2) / 2.0).collect()
    }
}

impl Grid {
    /// Position of the average of a patch in the plane at `x`.
    pub(super) fn point(&self, x: f64, patch: &Patch) -> [f64; 2] {
        let slice = self.cylinder.slice(x);
        let [mean_u, mean_w] = self.mean;
        let (sin, cos) = patch.angle.sin_cos();
        let (u, w) = (mean_u * cos - mean_w * sin, mean_w * cos + mean_u * sin);
        // The section extends 1/√(1 − (p·u + q·w)²/n²) radii in the unit direction (u, w), and the distance scales equally.
        let along = (slice.p * u + slice.q * w).powi(2) * slice.per_n2;
        let reach = (slice.radius + patch.d) / (1.0 - along).sqrt();
        [slice.y + reach * u, slice.z + reach * w]
    }
}
