//! From a scan to the pose of the part's axis. Knows geometry and scan; must not know files, clocks, logs or JSON.

mod estimate;
mod progress;
mod settings;

pub use estimate::{
    Component, Conditioning, Estimate, Outcome, Pose, Profile, RadiusSource, Reason, Refusal, Residuals, Section,
    Uncertainty, Warning,
};
pub use progress::Progress;
pub use settings::{Method, SettingError, Settings};

use crate::scan::Scan;

/// The whole measurement.
#[must_use]
pub fn estimate(scan: &Scan, settings: &Settings, progress: &Progress) -> Estimate {
    let _ = (scan, progress);
    Estimate {
        method: settings.method,
        outcome: Outcome::Refused(Refusal::TooFewProfiles { profiles_count: 0, profiles_min: settings.profiles_min }),
        profiles: Vec::new(),
        conditioning: Conditioning::default(),
        residuals: None,
    }
}
