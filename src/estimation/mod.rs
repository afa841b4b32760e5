//! From a scan to the pose of the part's axis. Knows geometry and scan; must not know files, clocks, logs or JSON.
//!
//! ```text
//! Scan --unusable?--> method --conclude--> Estimate --end_face--> Estimate: pose or refusal, a verdict on every profile
//!                       |
//!        cylinder: every point of every profile serves one joint robust fit
//!        section_line: an ellipse a profile, then a robust line through the centres (the published method)
//!        section_line_plain: the same without re-weighting and without the inner-point rule
//! ```
//!
//! `parts` cuts a scan of several parts along x and has each of them go this way.
//!
//! The formulas stand in docs/estimation.md.

mod budget;
mod conclude;
mod cylinder;
mod end_face;
mod estimate;
mod linearity;
mod parts;
mod progress;
mod refusal;
mod robust;
mod section_line;
mod settings;
mod student;
mod type_b;
mod unusable;
mod warning;

pub use estimate::{
    Component, Conditioning, EndFace, EndFaces, Estimate, Outcome, Pose, Profile, RadiusSource, Reason, Residuals,
    Section, Uncertainty,
};
pub use parts::{ByGap, PARTS_MAX, PartEstimate, PartRule, Parts, PartsError, ScanEstimate, Window, estimate_parts};
pub use progress::Progress;
pub use refusal::Refusal;
pub use settings::{End, EndFaceRule, Method, RadiusRule, SettingError, Settings};
pub use type_b::TypeB;
pub use warning::Warning;

use crate::scan::Scan;

/// The whole measurement. The result does not depend on the number of threads.
#[must_use]
pub fn estimate(scan: &Scan, settings: &Settings, progress: &Progress) -> Estimate {
    let found = match settings.method {
        Method::Cylinder => cylinder::find(scan, settings, progress),
        Method::SectionLine | Method::SectionLinePlain => section_line::find(scan, settings, progress),
    };
    let mut estimate = conclude::conclude(settings, found);
    end_face::complete(scan, settings, &mut estimate);
    estimate
}

/// What a method comes back with.
struct Found {
    outcome: Outcome,
    /// One entry a profile, in station order.
    profiles: Vec<Profile>,
    /// What only the method could see.
    warnings: Vec<Warning>,
}
