//! How the axis through the centres answers to a shift in z of the points at each place of the laser line, in all profiles at
//! once: some sections are fitted again with the points of a patch shifted, and each of them represents its neighbours.

use super::axis::Fit;
use super::section::Bench;
use crate::estimation::estimate::Profile;
use crate::estimation::linearity::{PatchInfluence, Patches};
use crate::estimation::settings::Settings;
use crate::geometry::SectionEllipse;
use crate::scan::{Scan, Station};
use nalgebra::{Matrix5x2, Vector2, Vector5};
use rayon::prelude::*;

/// Sections that are fitted again. The answer of a section to a patch changes slowly along the part, as its arc does.
const SECTIONS: usize = 16;
const RADIUS: usize = 4;

/// Neighbouring sections, of which the middle one represents the others.
struct Group {
    ellipse: SectionEllipse,
    y: Vec<f64>,
    z: Vec<f64>,
    /// How the axis answers to a shift of all their centres,
    by_centre: Matrix5x2<f64>,
    /// and the radius to that of all their radii.
    by_radius: f64,
}

/// A section, its profile, and the answers of the axis to a shift of its centre and of the radius to that of its own.
type Section<'a> = (SectionEllipse, &'a Station, Matrix5x2<f64>, f64);

/// The answer to each patch; empty where there is none.
pub(super) fn influences(scan: &Scan, profiles: &[Profile], fit: &Fit, settings: &Settings) -> Vec<PatchInfluence> {
    let groups = groups(scan, profiles, fit);
    // Points beside the part have no influence.
    let on_part = |group: &Group, y: f64| (y - group.ellipse.centre_y).abs() <= group.ellipse.semi_major;
    let places = groups.iter().flat_map(|group| group.y.iter().copied().filter(|y| on_part(group, *y)));
    let Some(patches) = Patches::over(places) else {
        return Vec::new();
    };
    let heights: Vec<f64> = groups.iter().map(|group| group.ellipse.centre_z).collect();
    let middle = heights.iter().sum::<f64>() / heights.len() as f64;
    let answers: Vec<Vec<Vector5<f64>>> =
        groups.into_par_iter().map(|group| answer(group, patches, settings)).collect();
    let mut effects = vec![[Vector5::zeros(); 2]; Patches::count()];
    for (answer, height) in answers.into_iter().zip(heights) {
        for ([effect, slope], by) in effects.iter_mut().zip(answer) {
            *effect += by;
            *slope += by * (height - middle);
        }
    }
    patches.influences(effects)
}

fn groups(scan: &Scan, profiles: &[Profile], fit: &Fit) -> Vec<Group> {
    // The fit has an influence for each centre with a weight, and profiles without one have been rejected since.
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

/// What a shift of each patch in the sections of a group does to (p, q, y_ref, z_ref, radius).
fn answer(group: Group, patches: Patches, settings: &Settings) -> Vec<Vector5<f64>> {
    let Group { y, z, by_centre, by_radius, .. } = group;
    let mut bench = Bench::default();
    (bench.y, bench.z) = (y, z);
    let effect = |[y, z, radius]: [f64; 3]| by_centre * Vector2::new(y, z) + Vector5::ith(RADIUS, by_radius * radius);
    bench.answers(settings, &patches).into_iter().map(effect).collect()
}
