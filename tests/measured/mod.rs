//! Measures files like the service: decodes, removes missing values, groups points into profiles and estimates.

#![expect(clippy::expect_used, reason = "a test may fail")]

use coaxis::estimation::{Estimate, Outcome, Pose, Progress, Settings, Warning, estimate};
use coaxis::geometry::Axis;
use coaxis::scan::decode::{FormatClaims, Limits, Request, Unit, decode, find_format};
use coaxis::scan::missing::clean;
use coaxis::scan::slice::{SliceRequest, slice};
use coaxis::scan::{Cloud, Scan};
use nalgebra::Vector3;
use std::fs;
use std::path::Path;

/// How a file is measured.
#[derive(Debug, Clone, Default)]
pub(crate) struct Ask {
    pub(crate) settings: Settings,
    pub(crate) unit: Option<Unit>,
    pub(crate) slicing: SliceRequest,
}

/// The points of a file.
pub(crate) fn cloud(path: &Path, unit: Option<Unit>) -> Cloud {
    let bytes = fs::read(path).expect("the file is there");
    let name = path.display().to_string();
    let claims = FormatClaims { parameter: None, media_type: None, file_name: Some(&name) };
    let format = find_format(&claims, &bytes).expect("a known format");
    decode(format, &mut &*bytes, &Request { unit, ..Request::new(&Limits::default()) }).expect("reads")
}

/// The scan of these points, the number of missing values and the number of repeated profiles.
pub(crate) fn scan(cloud: Cloud, slicing: &SliceRequest) -> (Scan, usize, u64) {
    let (cloud, removed) = clean(cloud, None);
    let scan = slice(cloud, slicing, &Limits::default()).expect("profiles");
    (scan, removed.missing.len(), removed.repeated_profiles)
}

/// The measurement of a file.
pub(crate) fn measure(path: &Path, ask: &Ask) -> Estimate {
    let (scan, ..) = scan(cloud(path, ask.unit), &ask.slicing);
    estimate(&scan, &ask.settings, &Progress::default())
}

/// The pose, if there is one.
pub(crate) fn pose(estimate: &Estimate) -> Option<&Pose> {
    match &estimate.outcome {
        Outcome::Accepted(pose) => Some(pose),
        Outcome::Refused(_) => None,
    }
}

/// The codes of the warnings, in their order.
pub(crate) fn codes(estimate: &Estimate) -> Vec<&'static str> {
    estimate.conditioning.warnings.iter().map(Warning::code).collect()
}

/// Angle between two axes, rad, and distance of `here` from the other axis at its own point, mm.
pub(crate) fn apart(here: &Axis, other: &Axis) -> [f64; 2] {
    let (a, b) = (Vector3::from(here.direction), Vector3::from(other.direction));
    [a.cross(&b).norm().atan2(a.dot(&b).abs()), other.distance(here.point_mm)]
}
