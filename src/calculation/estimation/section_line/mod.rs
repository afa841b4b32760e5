//! The published method: an ellipse for each profile by Tukey M-estimation, valid when enough of its points are inliers, then
//! a robust line through the valid centres; and its non-robust comparison.
//!
//! ```text
//! Scan --section, conic--> Section or Reason, a profile --axis--> line through the valid centres --verdict--> Outcome
//! ```

mod axis;
mod bias;
mod section;
mod verdict;

use super::conclude::Found;
use super::estimate::{Outcome, Profile, Section};
use super::progress::Progress;
use super::refusal::Refusal;
use super::settings::{Method, Settings};
use super::statistics::median;
use crate::geometry::AxisLine;
use crate::scan::{Scan, Station};
use axis::{Centre, Reweighting};
use bias::Bias;
use rayon::prelude::*;

/// How often the points of non-planar profiles are moved along the current axis.
const ROUNDS_MAX: usize = 12;
/// The axis has settled when its last change moves no point by more than this share of ε.
const SETTLED: f64 = 1e-3;

/// The pose or the reason why there is none, and the verdict on every profile.
///
/// A section is planar. If the points of a profile have individual x, each is moved along the current axis into the plane at the x
/// of its profile, and the axis is calculated again. An axis that is off by δ displaces a point by δ times its distance from that
/// plane, far less than the displacement that turns the axis by δ, so the rounds converge unless profiles are as long as the part.
pub(super) fn find(scan: &Scan, settings: &Settings, progress: &Progress) -> Found {
    let thickness_mm = thickness(scan);
    let mut along = Slopes { p: 0.0, q: 0.0 };
    for _ in 0..ROUNDS_MAX {
        let mut profiles = fit_sections(scan, along, settings, progress);
        if let Some(refusal) = verdict::before_fitting(scan, &profiles, settings) {
            return Found { outcome: Outcome::Refused(refusal), profiles, warnings: Vec::new() };
        }
        let (outcome, axis) = fit_axis(scan, along, &mut profiles, settings);
        let change = axis.map_or(0.0, |axis| (axis.p - along.p).hypot(axis.q - along.q));
        if change * thickness_mm <= SETTLED * settings.epsilon_mm {
            return Found { outcome, profiles, warnings: Vec::new() };
        }
        along = axis.map_or(along, |axis| Slopes { p: axis.p, q: axis.q });
    }
    let profiles = fit_sections(scan, along, settings, &progress.uncounted());
    Found { outcome: Outcome::Refused(Refusal::ProfilesNotPlanar { thickness_mm }), profiles, warnings: Vec::new() }
}

/// The direction along which points are moved into the planes of their profiles.
#[derive(Debug, Clone, Copy)]
struct Slopes {
    p: f64,
    q: f64,
}

/// Median over the profiles of the distance of nine in ten points from their plane, mm; 0 for planar profiles.
fn thickness(scan: &Scan) -> f64 {
    let of_profile = |station: &Station| {
        let own_x = scan.own_x(station)?;
        let mut distances: Vec<f64> = own_x.iter().map(|x| (x - station.x).abs()).collect();
        let place = distances.len() - 1 - distances.len() / 10;
        Some(*distances.select_nth_unstable_by(place, f64::total_cmp).1)
    };
    median(scan.stations().iter().filter_map(of_profile)).unwrap_or(0.0)
}

/// Copies the points of a profile into `y` and `z`, moved along the axis into its plane.
fn load(scan: &Scan, station: &Station, along: Slopes, y: &mut Vec<f64>, z: &mut Vec<f64>) {
    scan.load(*station, y, z);
    let Some(own_x) = scan.own_x(station) else { return };
    for ((y, z), x) in y.iter_mut().zip(z).zip(own_x) {
        *y -= along.p * (x - station.x);
        *z -= along.q * (x - station.x);
    }
}

fn fit_sections(scan: &Scan, along: Slopes, settings: &Settings, progress: &Progress) -> Vec<Profile> {
    let fit = |workspace: &mut section::Workspace, station: &Station| {
        if progress.is_stopped() {
            workspace.y.clear();
            workspace.z.clear();
        } else {
            load(scan, station, along, &mut workspace.y, &mut workspace.z);
        }
        let section = workspace.fit(settings);
        progress.advance();
        verdict::profile(station, section, settings)
    };
    scan.stations().par_iter().map_init(section::Workspace::default, fit).collect()
}

/// Fits the axis through the valid centres and marks those off it. The axis is returned even if the scan is refused.
fn fit_axis(scan: &Scan, along: Slopes, profiles: &mut [Profile], settings: &Settings) -> (Outcome, Option<AxisLine>) {
    let reweighting = match settings.method {
        Method::SectionLinePlain => Reweighting::None,
        Method::SectionLine | Method::Cylinder | Method::LeastSquares => Reweighting::Tukey,
    };
    let centres: Vec<Centre> = profiles.iter().filter_map(verdict::centre).collect();
    let Some(fit) = axis::fit(&centres, reweighting) else {
        return (Outcome::Refused(verdict::no_axis(profiles, settings)), None);
    };
    verdict::mark_off_axis(profiles, &fit);
    let bias = typical_bias(scan, along, profiles, settings);
    let outcome = match verdict::after_fitting(profiles, &fit.axis, bias, settings) {
        Some(refusal) => Outcome::Refused(refusal),
        None => {
            let patches = match settings.type_b.sensor_linearity_mm > 0.0 {
                true => axis::influences(scan, profiles, &fit, settings),
                false => Vec::new(),
            };
            Outcome::Accepted(Box::new(verdict::pose(&fit, bias, &patches, scan.origin(), settings)))
        }
    };
    (outcome, Some(fit.axis))
}

/// The bias of the valid profile whose arc is the median one.
fn typical_bias(scan: &Scan, along: Slopes, profiles: &[Profile], settings: &Settings) -> Bias {
    let valid = profiles.iter().zip(scan.stations()).filter(|(profile, _)| profile.rejected.is_none());
    let mut sections: Vec<(Section, Station)> = valid.filter_map(|(p, station)| Some((p.section?, *station))).collect();
    sections.sort_by(|(a, _), (b, _)| a.arc.radians().total_cmp(&b.arc.radians()));
    let Some((section, station)) = sections.get(sections.len() / 2) else { return Bias::default() };
    let (mut y, mut z) = (Vec::new(), Vec::new());
    load(scan, station, along, &mut y, &mut z);
    bias::bias(section, &y, &z, settings)
}
