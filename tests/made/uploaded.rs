//! A synthetic scan on the path of an uploaded file: missing values and repeated profiles are removed, points are grouped into
//! profiles, and the pose is compared with the truth of the generator in the coordinates in which it is stated.

#![expect(clippy::expect_used, reason = "a test may fail")]

use super::any_direction::{Compared, compared, in_frame};
use coaxis::estimation::{Outcome, Progress, Settings, estimate};
use coaxis::geometry::{Axis, AxisLine, Frame};
use coaxis::scan::decode::{Limits, Unit};
use coaxis::scan::missing::clean;
use coaxis::scan::slice::{SliceRequest, slice};
use coaxis::scan::synthetic::{Export, Part, make, placed};
use coaxis::scan::{Cloud, Columns, Labels, Scan, Stripe};

/// The form in which a scan reaches the service.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(crate) struct Upload {
    /// The rail frame in the coordinates of the file; `None` for profiles along the rail.
    pub(crate) placed_at: Option<Frame>,
    /// Whether the points of a placed scan are in random order.
    pub(crate) is_shuffled: bool,
    /// How the points are written.
    pub(crate) export: Export,
    /// The frame that the recipe declares.
    pub(crate) declared: Option<Frame>,
}

impl Upload {
    /// Measures the part.
    ///
    /// # Errors
    /// The code of the refusal.
    pub(crate) fn measured(&self, part: &Part, settings: &Settings) -> Result<Compared, &'static str> {
        // Every profile can be lost.
        let Ok((scan, truth)) = make(part) else { return Err("nothing_scanned") };
        let (scan, axis) = match &self.placed_at {
            None => (scan, truth_axis(&truth.axis(), truth.x_ref_mm)),
            Some(frame) => {
                let shuffle_seed = self.is_shuffled.then_some(part.seed);
                let placed_truth = truth.placed(frame).expect("a frame");
                (placed(&scan, frame, shuffle_seed).expect("a frame"), placed_truth.axis)
            }
        };
        let axis = self.declared.map_or(axis, |frame| in_frame(&frame, &axis));
        let written = self.export.apply(scan, part.seed).expect("finite");
        let (cloud, _) = clean(cloud(&written, self.placed_at.is_none()), None);
        let limits = Limits { points_per_profile_max: usize::MAX, ..Limits::default() };
        let request = SliceRequest { frame: self.declared, ..SliceRequest::default() };
        let Ok(scan) = slice(cloud, &request, &limits) else { return Err("not_sliced") };
        match estimate(&scan, settings, &Progress::default()).outcome {
            Outcome::Refused(refusal) => Err(refusal.code()),
            Outcome::Accepted(pose) => Ok(compared(&pose, &axis, part.radius_mm)),
        }
    }
}

fn truth_axis(line: &AxisLine, x_ref: f64) -> Axis {
    let [y, z] = line.at(x_ref);
    Axis { point_mm: [x_ref, y, z], direction: line.direction() }
}

/// The scan as a decoded file: with a profile column, or without any grouping.
fn cloud(scan: &Scan, has_profiles: bool) -> Cloud {
    let (mut stripes, mut y, mut z): (Vec<Stripe>, _, _) = (Vec::new(), Vec::new(), Vec::new());
    for (index, station) in scan.stations().iter().enumerate() {
        let label = if has_profiles { index as f64 } else { 0.0 };
        for [own_x, own_y, own_z] in scan.points_of(station) {
            y.push(own_y);
            z.push(own_z);
            match stripes.last_mut() {
                Some(last) if last.label == label && last.x == own_x => last.end = y.len(),
                _ => stripes.push(Stripe { label, x: own_x, end: y.len() }),
            }
        }
    }
    let labels = if has_profiles { Labels::Column("profile".to_owned()) } else { Labels::None };
    let blanks = scan.blanks().to_vec();
    Cloud { stripes, columns: Columns::F64 { y, z }, labels, unit: Unit::Millimetre, blanks, missing_count: 0 }
}
