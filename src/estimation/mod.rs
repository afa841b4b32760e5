//! From a scan to the pose of the part's axis. Knows geometry and scan; must not know files, clocks, logs or JSON.
//!
//! ```text
//! Scan --sections--> Section or Reason, a profile --axis--> line through the valid centres --judge--> Estimate
//!         (section, conic)                         (axis)                                   (verdict)
//! ```
//!
//! `section_line` is the published method: an ellipse a profile by Tukey M-estimation, valid when enough of its points are
//! inner points, then a robust line through the centres. `section_line_plain` does without re-weighting and without the
//! rule. The formulas stand in docs/estimation.md.

mod axis;
mod conic;
mod estimate;
mod progress;
mod robust;
mod section;
mod settings;
mod verdict;

pub use estimate::{
    Component, Conditioning, Estimate, Outcome, Pose, Profile, RadiusSource, Reason, Refusal, Residuals, Section,
    Uncertainty, Warning,
};
pub use progress::Progress;
pub use settings::{Method, SettingError, Settings};

use crate::scan::{Scan, Station};
use axis::{Centre, Reweighting};
use rayon::prelude::*;

/// The whole measurement. The result does not depend on the number of threads.
#[must_use]
pub fn estimate(scan: &Scan, settings: &Settings, progress: &Progress) -> Estimate {
    let mut profiles = fit_sections(scan, settings, progress);
    let outcome = match verdict::before_fitting(scan, &profiles, settings) {
        Some(refusal) => Outcome::Refused(refusal),
        None => fit_axis(&mut profiles, settings),
    };
    verdict::conclude(settings, outcome, profiles)
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
fn fit_axis(profiles: &mut [Profile], settings: &Settings) -> Outcome {
    let reweighting = match settings.method {
        Method::SectionLine => Reweighting::Tukey,
        Method::SectionLinePlain => Reweighting::None,
    };
    let centres: Vec<Centre> = profiles.iter().filter_map(verdict::centre).collect();
    let Some(fit) = axis::fit(&centres, reweighting) else {
        return Outcome::Refused(verdict::no_axis(profiles, settings));
    };
    verdict::mark_off_axis(profiles, &fit);
    match verdict::after_fitting(profiles, settings) {
        Some(refusal) => Outcome::Refused(refusal),
        None => Outcome::Accepted(Box::new(verdict::pose(&fit))),
    }
}
