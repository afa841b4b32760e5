//! A layer that nobody can take out, because it is too low or covers too much, leaves a trace: deviations that go together over
//! neighbouring patches and change at edges. In: points near the fit. Out: how far the fit is from the surface that the lower
//! patches make, since what lies on a part lies above it. Must not move the fit.
//!
//! Deviations are averaged over neighbours, in windows of two shapes. Where they scatter, beside shifts of whole
//! profiles, by more than chance makes them, patches below the middle of high and low make the other reading.

use super::layers;
use super::model::{Cylinder, Response};
use super::patches::{Averages, Cut, Near, Patch, Surface};
use super::step::{self, Hold};
use super::sums::Sums;
use nalgebra::Vector5;

/// Cells along the arc and along x: many where there are points for them.
const CELLS: [usize; 2] = [24, 12];
/// Points a cell where there are many,
const POINTS: usize = 10;
/// and where there are few, which makes blocks longer,
const POINTS_FEW: usize = 6;
/// down to so many blocks.
const BLOCKS_MIN: usize = 3;
/// Windows as cells to either side along the arc and along x.
const WINDOWS: [[usize; 2]; 3] = [[1, 1], [0, usize::MAX], [1, usize::MAX]];
/// Chance makes averages over windows scatter by so many times what is expected.
const CHANCE: f64 = 2.0;
const ROUNDS: usize = 8;
/// A block of fewer patches has little left beside its shift.
const BLOCK_MIN: f64 = 6.0;
/// How often the lower patches are chosen.
const READINGS: usize = 4;
/// Pieces of the arc between which a layer may end.
const SPLITS: usize = 6;
/// Where y_ref and, behind it, z_ref stand among the parameters.
const Y_REF: usize = 2;

/// How far (p, q, y_ref, z_ref, R) are from the lower reading, by each window; none where no layer shows.
pub(super) fn lower(surface: &Surface, cylinder: &Cylinder, hold: Hold, sigma: f64) -> Vec<Vector5<f64>> {
    let points_count = surface.near.len();
    let [many, few] = CELLS;
    let cells = if points_count >= POINTS * many * many { many } else { few };
    let blocks = (points_count / (POINTS_FEW * cells)).clamp(BLOCKS_MIN, cells);
    let Some(averages) = surface.average(Cut::Cells { sectors: cells, blocks }) else { return Vec::new() };
    let level = levelled(&averages);
    let shown = WINDOWS.into_iter().filter(|window| shows(&level, *window));
    shown.filter_map(|window| reading(&averages, window, cylinder, hold, sigma)).collect()
}

/// Whether averages over the window scatter by more than chance makes them. What chance does is seen from one block to the
/// next: neighbours along the arc may share their noise, profiles do not.
fn shows(level: &Averages, [along_arc, along_x]: [usize; 2]) -> bool {
    let along = with(level, &smoothed(level, [along_arc, 0]));
    let own = layers::lower_sigma(along.squared_differences_along_x());
    let means = smoothed(&along, [0, along_x]);
    let one =
        |(sum, expected): (f64, f64), (mean, count): &(f64, f64)| (sum + mean * mean, expected + own * own / count);
    let (sum, expected) = means.iter().flatten().fold((0.0, 0.0), one);
    sum > CHANCE * CHANCE * expected
}

/// The averages with other deviations.
fn with(averages: &Averages, deviations: &[Option<(f64, f64)>]) -> Averages {
    let patches = averages.patches.iter().zip(deviations);
    let patches = patches.map(|(patch, to)| Some(Patch { d: to.as_ref()?.0, ..*patch.as_ref()? })).collect();
    Averages { grid: averages.grid.clone(), patches }
}

/// Without what whole blocks of profiles are off by: a mean and a slope along the arc each.
fn levelled(averages: &Averages) -> Averages {
    let mut patches = averages.patches.clone();
    for block in patches.chunks_mut(averages.grid.sectors()) {
        let count = block.iter().flatten().count() as f64;
        if count < BLOCK_MIN {
            block.fill(None);
            continue;
        }
        let mean = |of: &dyn Fn(&Patch) -> f64| block.iter().flatten().map(of).sum::<f64>() / count.max(1.0);
        let (angle, d) = (mean(&|patch| patch.angle), mean(&|patch| patch.d));
        let spread = mean(&|patch| (patch.angle - angle).powi(2));
        let slope = if spread > 0.0 { mean(&|patch| (patch.angle - angle) * (patch.d - d)) / spread } else { 0.0 };
        block.iter_mut().flatten().for_each(|patch| patch.d -= d + slope * (patch.angle - angle));
    }
    Averages { grid: averages.grid.clone(), patches }
}

/// Averages over the window about each patch, and over how many.
fn smoothed(averages: &Averages, [along_arc, along_x]: [usize; 2]) -> Vec<Option<(f64, f64)>> {
    let sectors = averages.grid.sectors();
    let blocks = averages.patches.len() / sectors.max(1);
    let around = |place: usize, reach: usize, count: usize| {
        place.saturating_sub(reach)..place.saturating_add(reach).saturating_add(1).min(count)
    };
    let one = |(index, patch): (usize, &Option<Patch>)| {
        patch.as_ref()?;
        let (mut sum, mut count) = (0.0, 0.0);
        for block in around(index / sectors, along_x, blocks) {
            for sector in around(index % sectors, along_arc, sectors) {
                if let Some(Some(patch)) = averages.patches.get(block * sectors + sector) {
                    (sum, count) = (sum + patch.d * patch.share, count + patch.share);
                }
            }
        }
        Some((sum / count, count))
    };
    averages.patches.iter().enumerate().map(one).collect()
}

/// What the patches below the middle of high and low move the fit by; which those are is looked at again from there.
fn reading(
    averages: &Averages,
    window: [usize; 2],
    cylinder: &Cylinder,
    hold: Hold,
    sigma: f64,
) -> Option<Vector5<f64>> {
    let row = |patch: &Patch| {
        let [y, z] = averages.grid.point(patch.x, patch);
        let Response { a, b, t, .. } = cylinder.slice(patch.x).response(y, z);
        Vector5::new(a * t, b * t, a, b, -1.0)
    };
    let rows: Vec<Option<Vector5<f64>>> = averages.patches.iter().map(|patch| patch.as_ref().map(row)).collect();
    let mut shift = Vector5::zeros();
    for _ in 0..READINGS {
        let moved = averages.patches.iter().zip(&rows);
        let moved = moved.map(|(patch, row)| Some((patch.as_ref()?.d + row.as_ref()?.dot(&shift), 1.0)));
        let means = smoothed(&with(averages, &moved.collect::<Vec<_>>()), window);
        let middle = middle(&means);
        let mut sums = Sums::zero();
        for ((patch, row), mean) in averages.patches.iter().zip(&rows).zip(&means) {
            if let (Some(patch), Some(row), Some((mean, _))) = (patch, row, mean)
                && *mean < middle
            {
                sums.gradient += row * (patch.d * patch.share);
                sums.normal += row * row.transpose() * patch.share;
            }
        }
        let (normal, gradient) = step::system(&sums, hold, sigma, cylinder.radius);
        shift = step::solve(&normal, &gradient)?;
    }
    Some(shift)
}

/// What a layer of this height beside the part does that goes up to one of some places along the arc: the worst of them. A
/// fit that was bent into both surfaces shows no edge.
pub(super) fn beside(
    surface: &Surface,
    cylinder: &Cylinder,
    hold: Hold,
    sigma: f64,
    height: f64,
) -> Option<Vector5<f64>> {
    let mut angles: Vec<f64> = surface.near.iter().map(|point| point.angle).collect();
    angles.sort_unstable_by(f64::total_cmp);
    let row = |point: &Near| {
        let Response { a, b, t, .. } = cylinder.slice(point.x).response(point.y, point.z);
        Vector5::new(a * t, b * t, a, b, -1.0)
    };
    let rows: Vec<Vector5<f64>> = surface.near.iter().map(row).collect();
    let mut whole = Sums::zero();
    rows.iter().for_each(|row| whole.normal += row * row.transpose());
    let (normal, _) = step::system(&whole, hold, sigma, cylinder.radius);
    let shift = |place: usize| {
        let edge = *angles.get(angles.len() * place / SPLITS)?;
        let above = surface.near.iter().zip(&rows).filter(|(point, _)| point.angle >= edge);
        let pull = above.map(|(_, row)| row * height).sum::<Vector5<f64>>();
        let pull = if matches!(hold, Hold::Fixed { .. }) { pull.component_mul(&step::OTHERS) } else { pull };
        step::solve(&normal, &pull)
    };
    let aside = |shift: &Vector5<f64>| shift.fixed_rows::<2>(Y_REF).norm();
    (1..SPLITS).filter_map(shift).max_by(|one, other| aside(one).total_cmp(&aside(other)))
}

/// Half way between the mean of what is above it and the mean of what is below.
fn middle(smoothed: &[Option<(f64, f64)>]) -> f64 {
    let mean = |above: Option<bool>, middle: f64| {
        let chosen = smoothed.iter().flatten().filter(|(mean, _)| above.is_none_or(|above| (*mean >= middle) == above));
        let (sum, count) = chosen.fold((0.0, 0.0), |(sum, count), (mean, _)| (sum + mean, count + 1.0));
        if count > 0.0 { sum / count } else { middle }
    };
    let mut middle = mean(None, 0.0);
    for _ in 0..ROUNDS {
        middle = 0.5 * (mean(Some(true), middle) + mean(Some(false), middle));
    }
    middle
}
