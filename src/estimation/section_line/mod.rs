//! The published method: an ellipse a profile by Tukey M-estimation, valid when enough of its points are inner points, then
//! a robust line through the valid centres; and its non-robust comparison.
//!
//! ```text
//! Scan --section, conic--> Section or Reason, a profile --axis--> line through the valid centres --verdict--> Outcome
//! ```

mod axis;
mod bias;
mod conic;
mod linearity;
mod section;
mod verdict;

use super::{Found, Method, Outcome, Profile, Progress, Section, Settings};
use crate::scan::{Scan, Station};
use axis::{Centre, Reweighting};
use bias::Bias;
use rayon::prelude::*;

/// The pose or why there is none, and what became of every profile.
pub(super) fn find(scan: &Scan, settings: &Settings, progress: &Progress) -> Found {
    let mut profiles = fit_sections(scan, settings, progress);
    let outcome = match verdict::before_fitting(scan, &profiles, settings) {
        Some(refusal) => Outcome::Refused(refusal),
        None => fit_axis(scan, &mut profiles, settings),
    };
    Found { outcome, profiles, warnings: Vec::new() }
}

fn fit_sections(scan: &Scan, settings: &Settings, progress: &Progress) -> Vec<Profile> {
    let fit = |bench: &mut section::Bench, station: &Station| {
        scan.load(*station, &mut bench.y, &mut bench.z);
        let section = bench.fit(settings);
        progress.advance();
        verdict::profile(station, section, settings)
    };
    scan.stations().par_iter().map_init(section::Bench::default, fit).collect()
}

/// Draws the axis through the valid centres; marks those that lie off it.
fn fit_axis(scan: &Scan, profiles: &mut [Profile], settings: &Settings) -> Outcome {
    let reweighting = match settings.method {
        Method::SectionLinePlain => Reweighting::None,
        Method::SectionLine | Method::Cylinder => Reweighting::Tukey,
    };
    let centres: Vec<Centre> = profiles.iter().filter_map(verdict::centre).collect();
    let Some(fit) = axis::fit(&centres, reweighting) else {
        return Outcome::Refused(verdict::no_axis(profiles, settings));
    };
    verdict::mark_off_axis(profiles, &fit);
    let bias = typical_bias(scan, profiles, settings);
    match verdict::after_fitting(profiles, &fit.axis, bias, settings) {
        Some(refusal) => Outcome::Refused(refusal),
        None => {
            let patches = match settings.type_b.sensor_linearity_mm > 0.0 {
                true => linearity::influences(scan, profiles, &fit, settings),
                false => Vec::new(),
            };
            Outcome::Accepted(Box::new(verdict::pose(&fit, bias, &patches, settings)))
        }
    }
}

/// The bias of the valid profile whose arc is the median one.
fn typical_bias(scan: &Scan, profiles: &[Profile], settings: &Settings) -> Bias {
    let valid = profiles.iter().zip(scan.stations()).filter(|(profile, _)| profile.rejected.is_none());
    let mut sections: Vec<(Section, Station)> = valid.filter_map(|(p, station)| Some((p.section?, *station))).collect();
    sections.sort_by(|(a, _), (b, _)| a.arc.radians().total_cmp(&b.arc.radians()));
    let Some((section, station)) = sections.get(sections.len() / 2) else { return Bias::default() };
    let (mut y, mut z) = (Vec::new(), Vec::new());
    scan.load(*station, &mut y, &mut z);
    bias::bias(section, &y, &z, settings)
}
