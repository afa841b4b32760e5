//! Finds the parts of a scan by the gaps between them: stretches of the rail without a profile that shows a part.
//!
//! A profile that shows an arc while none of its neighbours does is ignored. A stretch of profiles that is too short to be measured
//! (fewer than `profiles_min`, or shorter than `axial_length_min_mm`) is not a part.
//!
//! A profile shows a part if enough of its points lie on one circular arc. A support, a step or the two planes of a V-block do not.
//! Random consensus: circles through three points of a thinned profile until one has [`SHARE_MIN`] of the points within the
//! tolerance t and these span [`ARC_MIN_DEG`]. A straight line stays within ±t of an arc of φ along a chord of at most 16 t/φ (its
//! sagitta is chord · φ/8), which with t of at most a thousandth of the profile's size is 6 % of it; two planes touch a circle
//! along twice 9 %.

use super::rule::ByGap;
use crate::estimation::cylinder::sample;
use crate::estimation::settings::Settings;
use crate::estimation::statistics::median;
use crate::scan::{Scan, Station};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use std::ops::Range;

/// Least length of a gap in usual distances between profiles, so that a coarse scan has no gap after every profile.
const GAP_SPACINGS: f64 = 2.5;
/// Number of profiles on either side among which another one must show a part.
const NEIGHBOURS: usize = 2;

/// The stations of each part, in order of x, from the first profile that shows it to the last.
pub(super) fn parts(scan: &Scan, settings: &Settings, rule: &ByGap) -> Vec<Range<usize>> {
    let stations = scan.stations();
    let gap = rule.gap_min_mm.max(GAP_SPACINGS * spacing(stations));
    let mut found: Vec<Stretch> = Vec::new();
    for (index, station) in confirmed(&shows(scan, settings)).filter_map(|index| Some((index, stations.get(index)?))) {
        match found.last_mut() {
            Some(last) if station.x - last.x_max < gap => last.extend(index, station.x),
            _ => found.push(Stretch { range: index..index + 1, x_min: station.x, x_max: station.x, count: 1 }),
        }
    }
    found.retain(|stretch| stretch.is_long(settings));
    found.into_iter().map(|stretch| stretch.range).collect()
}

/// Consecutive profiles that show a part, with no gap between them.
struct Stretch {
    range: Range<usize>,
    x_min: f64,
    x_max: f64,
    /// Number of profiles that show a part.
    count: usize,
}

impl Stretch {
    fn extend(&mut self, index: usize, x: f64) {
        (self.range.end, self.x_max, self.count) = (index + 1, x, self.count + 1);
    }

    fn is_long(&self, settings: &Settings) -> bool {
        self.count >= settings.profiles_min as usize
            && self.x_max - self.x_min >= settings.axial_length_min_mm.unwrap_or(0.0)
    }
}

/// Median distance between neighbouring profiles; 0 for a single one.
fn spacing(stations: &[Station]) -> f64 {
    median(stations.iter().zip(stations.iter().skip(1)).map(|(a, b)| b.x - a.x)).unwrap_or(0.0)
}

/// The profiles that show a part and have a neighbour that does.
fn confirmed(shown: &[bool]) -> impl Iterator<Item = usize> {
    (0..shown.len()).filter(|&index| {
        let near = shown.iter().take(index + NEIGHBOURS + 1).skip(index.saturating_sub(NEIGHBOURS));
        shown.get(index) == Some(&true) && near.filter(|shown| **shown).count() > 1
    })
}

/// Share of the points that must lie on the arc; it is below that of a profile that is half covered by a clamp.
const SHARE_MIN: f64 = 0.2;
/// The arc that the points must span; a shorter one does not distinguish a part from a support.
const ARC_MIN_DEG: f64 = 15.0;
/// Points of a profile that are examined.
const POINTS_MAX: usize = 96;
/// Number of triples that are tested: 95 % of the profiles with the least share on the arc are recognised, with a share of 30 % all
/// but one in 30 000.
const DRAWS: u64 = 384;
/// Tolerance about the arc, in spreads of the points about their neighbours,
const TOLERANCE_ROUGHNESS: f64 = 3.0;
/// but at most this share of the size of the profile.
const TOLERANCE_SIZE: f64 = 1e-3;
/// Largest radius, in sizes of the profile: ½ / sin(½ · 15°), for a profile that spans just the least arc. Three points of a plane
/// support are nearly always on a larger circle, so a support takes little time.
const RADIUS_SIZE: f64 = 3.84;

/// For every profile in station order whether it shows a part.
pub(super) fn shows(scan: &Scan, settings: &Settings) -> Vec<bool> {
    let tolerance = settings.epsilon_mm.max(TOLERANCE_ROUGHNESS * sample::roughness(scan));
    let points_min = settings.points_min as usize;
    let work = |station: &Station| {
        let enough = station.end - station.start >= points_min;
        enough && has_arc(&thinned(scan, station), tolerance, station.x.to_bits())
    };
    scan.stations().par_iter().map(work).collect()
}

fn thinned(scan: &Scan, station: &Station) -> Vec<[f64; 2]> {
    let stride = (station.end - station.start).div_ceil(POINTS_MAX).max(1);
    (station.start..station.end).step_by(stride).filter_map(|index| scan.columns().get(index)).collect()
}

/// Whether enough of the points lie on one arc. The seed depends only on the profile, so that a profile is judged equally in every
/// scan, and draws that fail on one profile differ on the next.
fn has_arc(points: &[[f64; 2]], tolerance: f64, seed: u64) -> bool {
    let size = size(points);
    let (tolerance, radius_max) = (tolerance.min(TOLERANCE_SIZE * size), RADIUS_SIZE * size);
    let mut chance = ChaCha8Rng::seed_from_u64(seed);
    (0..DRAWS).any(|_| {
        let mut draw = || points.get(chance.random_range(0..points.len())).copied();
        let (Some(a), Some(b), Some(c)) = (draw(), draw(), draw()) else { return false };
        circle(a, b, c).is_some_and(|circle| circle.radius < radius_max && holds(points, circle, tolerance))
    })
}

/// Diagonal of the bounding box.
fn size(points: &[[f64; 2]]) -> f64 {
    let span = |values: &mut dyn Iterator<Item = f64>| {
        let (low, high) = values.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| (low.min(v), high.max(v)));
        (high - low).max(0.0)
    };
    span(&mut points.iter().map(|[y, _]| *y)).hypot(span(&mut points.iter().map(|[_, z]| *z)))
}

#[derive(Clone, Copy)]
struct Circle {
    centre: [f64; 2],
    radius: f64,
}

/// The circle through three points; `None` if they lie on a line.
fn circle([ay, az]: [f64; 2], [by, bz]: [f64; 2], [cy, cz]: [f64; 2]) -> Option<Circle> {
    let ([by, bz], [cy, cz]) = ([by - ay, bz - az], [cy - ay, cz - az]);
    let (b2, c2, twice_area) = (by * by + bz * bz, cy * cy + cz * cz, by * cz - bz * cy);
    let [y, z] = [(cz * b2 - bz * c2) / (2.0 * twice_area), (by * c2 - cy * b2) / (2.0 * twice_area)];
    let radius = y.hypot(z);
    (radius.is_finite() && radius > 0.0).then_some(Circle { centre: [ay + y, az + z], radius })
}

/// Whether enough of the points lie on the circle and span enough of it.
fn holds(points: &[[f64; 2]], Circle { centre: [cy, cz], radius }: Circle, tolerance: f64) -> bool {
    let (least2, most2) = ((radius - tolerance).max(0.0).powi(2), (radius + tolerance).powi(2));
    let on = || {
        let seen = points.iter().map(|[y, z]| [y - cy, z - cz]);
        seen.filter(|[u, w]| (least2..most2).contains(&(u * u + w * w)))
    };
    let (count, sum_u, sum_w) = on().fold((0.0, 0.0, 0.0), |(n, u, w), [du, dw]| (n + 1.0, u + du, w + dw));
    if count < SHARE_MIN * points.len() as f64 {
        return false;
    }
    // Angles count from the mean direction, so that the arc may extend across ±180°.
    let angles = on().map(|[u, w]| (w * sum_u - u * sum_w).atan2(u * sum_u + w * sum_w));
    let (low, high) = angles.fold((0.0_f64, 0.0_f64), |(low, high), angle| (low.min(angle), high.max(angle)));
    high - low >= ARC_MIN_DEG.to_radians()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scan::Columns;
    use crate::scan::synthetic::Part;
    use crate::scan::synthetic::{Interference, make};
    use rand_distr::{Distribution, StandardNormal};

    /// Profiles of 320 points over 400 mm whose height is a function of y, with noise.
    fn surface(sigma: f64, z: impl Fn(f64) -> f64) -> Scan {
        let mut chance = ChaCha8Rng::seed_from_u64(5);
        let mut noise = || sigma * <StandardNormal as Distribution<f64>>::sample(&StandardNormal, &mut chance);
        let points: Vec<[f64; 2]> = (0..50 * 320)
            .map(|index| f64::from(index % 320) * 1.25 - 200.0)
            .map(|y| [y + noise(), z(y) + noise()])
            .collect();
        let stations =
            (0..50).map(|i| Station { x: f64::from(i) * 2.0, start: i as usize * 320, end: (i as usize + 1) * 320 });
        let columns =
            Columns::F64 { y: points.iter().map(|p| p[0]).collect(), z: points.iter().map(|p| p[1]).collect() };
        Scan::new(stations.collect(), columns, String::new()).expect("a scan")
    }

    fn count(scan: &Scan) -> usize {
        shows(scan, &Settings::default()).iter().filter(|shown| **shown).count()
    }

    #[test]
    fn planes_steps_and_v_blocks_show_no_part() {
        for sigma in [0.01, 0.05, 0.2] {
            assert_eq!(count(&surface(sigma, |y| 0.1 * y - 150.0)), 0, "a floor, {sigma} mm");
            assert_eq!(
                count(&surface(sigma, |y| if y.abs() < 60.0 { -80.0 } else { -150.0 })),
                0,
                "a step, {sigma} mm"
            );
            assert_eq!(count(&surface(sigma, |y| y.abs() - 150.0)), 0, "a V-block, {sigma} mm");
        }
    }

    #[test]
    fn a_part_is_recognised_on_short_arcs_with_noise_and_under_clamps() {
        let part = |arc_deg| Part { profiles_count: 60, points_count: 320, arc_deg, ..Part::smooth(3) };
        let clamped = Interference { clamps: 0.5, clamp_arc: 0.5, clamp_height_mm: 25.0, ..Interference::default() };
        for part in [
            part(140.0),
            part(30.0),
            Part { noise_sigma_mm: 0.2, ..part(100.0) },
            Part { radius_mm: 20.0, ..part(120.0) },
            Part { interference: clamped, drop_out_ratio: 0.3, spike_ratio: 0.05, ..part(120.0) },
        ] {
            assert_eq!(count(&make(&part).expect("a scan").0), 60, "{part:?}");
        }
    }

    #[test]
    fn the_arc_beside_a_flat_clamp_is_enough() {
        let under_clamp = |half_width: f64| {
            surface(0.05, move |y| if y.abs() < half_width { 260.0 } else { (250.0_f64.powi(2) - y * y).sqrt() })
        };
        assert_eq!(count(&under_clamp(100.0)), 50, "half of the points are left");
        assert!(count(&under_clamp(150.0)) >= 45, "a quarter of them");
    }

    #[test]
    fn too_few_points_show_no_part() {
        let few = Part { points_count: 19, profiles_count: 5, ..Part::smooth(1) };
        assert_eq!(count(&make(&few).expect("a scan").0), 0);
    }
}
