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
//! `parts` cuts a scan of several parts along x and has each of them go this way. `least_squares` is apart from it: the
//! cylinder of least squares of all points as they are, for comparison with reference software.
//!
//! The formulas stand in docs/estimation.md.

mod budget;
mod concave;
mod conclude;
mod cylinder;
mod detect;
mod end_face;
mod estimate;
mod least_squares;
mod limits;
mod linearity;
mod orientation;
mod parts;
mod placed;
mod progress;
mod refusal;
mod robust;
mod section_cut;
mod section_line;
mod settings;
mod student;
mod type_b;
mod unusable;
mod warning;

pub use budget::COVERAGE_FACTOR;
#[doc(hidden)]
pub use detect::{Detected, Request as DetectRequest, detect};
pub use estimate::{
    Component, Conditioning, EndFace, EndFaces, Estimate, Outcome, Pose, Profile, RadiusSource, Reason, Residuals,
    Section, Uncertainty,
};
pub use least_squares::{GaussianCylinder, LeastSquaresError, basis, least_squares_cylinder};
pub use parts::{ByGap, PARTS_MAX, PartEstimate, PartRule, Parts, PartsError, ScanEstimate, Window, estimate_parts};
pub use placed::OnRail;
pub use progress::{Progress, Stop};
pub use refusal::{FoundCylinder, Refusal};
pub use robust::TUKEY_C;
pub use section_cut::SectionCut;
pub use settings::{End, EndFaceRule, Method, Orientation, RadiusRule, SettingError, Settings};
pub use type_b::TypeB;
pub use warning::Warning;

use crate::scan::Scan;

/// The whole measurement. The result does not depend on the number of threads.
#[must_use]
pub fn estimate(scan: &Scan, settings: &Settings, progress: &Progress) -> Estimate {
    orientation::measure(scan, settings, progress)
}

/// A measurement in a frame whose X lies near the axis. `expected_radius` is what was detected before, mm.
fn in_frame(scan: &Scan, settings: &Settings, expected_radius: Option<f64>, progress: &Progress) -> Estimate {
    let found = match settings.method {
        Method::Cylinder | Method::LeastSquares => cylinder::find(scan, settings, expected_radius, progress),
        Method::SectionLine | Method::SectionLinePlain => section_line::find(scan, settings, progress),
    };
    let mut estimate = conclude::conclude(settings, found);
    if !progress.is_stopped() {
        end_face::complete(scan, settings, &mut estimate);
    }
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
