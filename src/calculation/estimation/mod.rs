//! From a scan to the pose of the part's axis.
//!
//! ```text
//! Scan --checks--> method --conclude--> Estimate --end_face--> Estimate: pose or refusal, a verdict on every profile
//!                       |
//!        cylinder: every point of every profile serves one joint robust fit
//!        section_line: an ellipse for each profile, then a robust line through the centres (the published method)
//!        section_line_plain: the same without re-weighting and without the inlier rule; non-robust, for comparison
//! ```
//!
//! `orientation` chooses the frame in which the method works. `parts` cuts a scan of several parts along x and estimates each of
//! them. `least_squares` is the Gaussian associated cylinder of all points, for comparison with reference software.
//!
//! The formulas are in docs/estimation.md.

mod budget;
mod checks;
mod conclude;
mod cylinder;
mod detect;
mod end_face;
mod estimate;
mod least_squares;
mod orientation;
mod parts;
mod progress;
mod refusal;
mod section_cut;
mod section_line;
mod settings;
mod statistics;
mod type_b;
mod warning;

pub use budget::COVERAGE_FACTOR;
#[doc(hidden)]
pub use detect::{Detected, Request as DetectRequest, detect};
pub use estimate::{
    Component, Conditioning, EndFace, EndFaces, Estimate, OnRail, Outcome, Pose, Profile, RadiusSource, Residuals,
    Section, Uncertainty,
};
pub use least_squares::{GaussianCylinder, LeastSquaresError, basis, least_squares_cylinder};
pub use parts::{ByGap, PARTS_MAX, PartEstimate, PartRule, Parts, PartsError, ScanEstimate, Window, estimate_parts};
pub use progress::{Progress, Stop};
pub use refusal::{FoundCylinder, Reason, Refusal};
pub use section_cut::SectionCut;
pub use settings::{End, EndFaceRule, Method, Orientation, RadiusRule, SettingError, Settings, TypeB};
pub use statistics::TUKEY_C;
pub use warning::Warning;

use crate::scan::Scan;

/// The complete measurement. The result does not depend on the number of threads.
#[must_use]
pub fn estimate(scan: &Scan, settings: &Settings, progress: &Progress) -> Estimate {
    orientation::measure(scan, settings, progress)
}
