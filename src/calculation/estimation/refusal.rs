//! Why a scan has no pose, or a profile is not valid: each reason is a message with the numbers that decided and the action to
//! take.

use serde::{Deserialize, Serialize};

/// Why a scan has no pose, with the numbers that decided it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, thiserror::Error)]
#[serde(rename_all = "snake_case", tag = "code")]
pub enum Refusal {
    /// Not enough profiles in the scan to define an axis.
    #[error(
        "the scan has {profiles_count} profile(s), an axis needs at least {profiles_min}; scan more of the part, or \
         declare how points belong to profiles (profile_by)"
    )]
    TooFewProfiles {
        /// Profiles in the scan.
        profiles_count: usize,
        /// Least number.
        profiles_min: u32,
    },
    /// All points have the same y and z.
    #[error("all {points_count} points have the same y and z; check the export and its columns")]
    PointsIdentical {
        /// Points in the scan.
        points_count: usize,
    },
    /// Every profile has the same x.
    #[error(
        "all {profiles_count} profiles have the same x, so there is no travel between them; connect the encoder, export the travel of \
         the stage (for a Gocator the Y of each frame), or check which column is x"
    )]
    TravelMissing {
        /// Profiles in the scan.
        profiles_count: usize,
    },
    /// Every profile is a straight line.
    #[error(
        "the points of every profile lie on a straight line, so there is no curvature to find an axis from; check which \
         column is the height, and that the part is in view"
    )]
    PointsCollinear {
        /// Profiles in the scan.
        profiles_count: usize,
    },
    /// Too few profiles passed.
    #[error(
        "only {valid_count} of {profiles_count} profiles are valid, {profiles_min} are needed; most were rejected as {}: {}",
        .most_common.name(), .most_common.advice(*.sigma_mm, *.epsilon_mm)
    )]
    TooFewValidProfiles {
        /// Profiles that passed.
        valid_count: usize,
        /// Profiles in the scan.
        profiles_count: usize,
        /// Least number.
        profiles_min: u32,
        /// The most frequent reason for which the others were rejected.
        most_common: Reason,
        /// Median spread of the points about their sections, mm; `None` without a section.
        sigma_mm: Option<f64>,
        /// Largest distance of an inlier, mm.
        epsilon_mm: f64,
    },
    /// The valid profiles lie too close together to give a direction.
    #[error(
        "the valid profiles span {axial_length_mm:.3} mm along x, at least {axial_length_min_mm} mm are needed; scan a \
         longer piece of the part, or check the unit"
    )]
    AxialLengthTooShort {
        /// Span of the valid profiles.
        axial_length_mm: f64,
        /// Least span.
        axial_length_min_mm: f64,
    },
    /// The sections are not those of one cylinder.
    #[error(
        "the radii of the valid sections scatter by {radius_spread_mm:.3} mm about {radius_mm:.3} mm: they are not sections \
         of one cylinder; check the frame and the region, and that the rail is X"
    )]
    SectionsDisagree {
        /// Median radius.
        radius_mm: f64,
        /// Robust spread of the radii.
        radius_spread_mm: f64,
    },
    /// The sections are ellipses whose shape does not match the tilt of their axis.
    #[error(
        "the sections are {axis_ratio:.3} times as long as wide where their axis explains {expected_ratio:.3}: the part is not \
         round, or its arc too short for its noise; scan a wider arc, or use the method cylinder"
    )]
    SectionsNotRound {
        /// Median ratio of the longer to the shorter axis.
        axis_ratio: f64,
        /// The same ratio for a cylinder about the fitted axis.
        expected_ratio: f64,
    },
    /// The points of the profiles cannot be moved into planes.
    #[error(
        "the points of a profile lie up to {thickness_mm:.3} mm from its plane, and moving them there along the axis does not \
         converge: the profiles are too thick for sections; separate the profiles by another rule (profile_by), or use the method cylinder"
    )]
    ProfilesNotPlanar {
        /// Distance of nine in ten points from the plane of their profile, in the median profile.
        thickness_mm: f64,
    },
    /// No cylinder has enough points on it.
    #[error(
        "no cylinder{} was found that enough of the points lie on; check the unit, the frame and the region{}",
        .nominal_radius_mm.map_or_else(String::new, |radius| format!(" of about {radius} mm radius")),
        .nominal_radius_mm.map_or("", |_| ", and the nominal radius: only parts within 2 % of it are searched")
    )]
    NoCylinder {
        /// From the recipe.
        nominal_radius_mm: Option<f64>,
    },
    /// Two surfaces that could both be the part.
    #[error(
        "the scan could be a part of {radius_a_mm:.3} mm radius (on {:.0} % of the profiles) or one of {radius_b_mm:.3} mm \
         (on {:.0} %); choose one by nominal_radius_mm, or exclude the other by region", 100.0 * .coverage_a, 100.0 * .coverage_b
    )]
    TwoCylinders {
        /// Radius of the one.
        radius_a_mm: f64,
        /// Share of the profiles that show it.
        coverage_a: f64,
        /// Radius of the other.
        radius_b_mm: f64,
        /// Share of the profiles that show it.
        coverage_b: f64,
    },
    /// The points determine no cylinder of least squares.
    #[error("{detail}")]
    PointsUndetermined {
        /// Points of the scan.
        points_count: usize,
        /// The deficiency and the action to take.
        detail: String,
    },
    /// Several cylinders of a cloud could be the part.
    #[error(
        "the points show {} cylinders: {}; choose one by nominal_radius_mm, or by a region about its axis",
        .cylinders.len(), listed(.cylinders)
    )]
    SeveralCylinders {
        /// The one with most points first.
        cylinders: Vec<FoundCylinder>,
    },
    /// The axis does not lie along the rail.
    #[error(
        "the axis lies {angle_deg:.1}° from the rail (X), at most {tilt_max_deg}° are allowed (tilt_max_deg); declare the frame, \
         check the order of the columns, or look in any direction (orientation: any)"
    )]
    AxisNotAlongRail {
        /// Between the axis and X.
        angle_deg: f64,
        /// The limit.
        tilt_max_deg: f64,
    },
    /// The part cannot be distinguished from layers close to the surface.
    #[error(
        "{:.0} % of the surface is covered by layers, searched within {reach_mm:.3} mm of it, so that the part cannot be \
         distinguished from them; remove tape, clamp or dirt, choose a region without it, or give nominal_radius_mm", 100.0 * .layer_ratio
    )]
    LayersUndecided {
        /// Share of the observed surface that lies in layers.
        layer_ratio: f64,
        /// Distance from the surface within which layers were searched.
        reach_mm: f64,
    },
    /// The data do not determine the pose.
    #[error(
        "the data do not determine the pose: standard uncertainties of {angle_deg:.4}° and {position_mm:.3} mm where {angle_max_deg}° \
         and {position_max_mm} mm are allowed; scan a longer or wider piece, or give the radius (radius: fixed or prior)"
    )]
    PoseUndetermined {
        /// The larger standard uncertainty of the two angles.
        angle_deg: f64,
        /// The limit.
        angle_max_deg: f64,
        /// The larger standard uncertainty of y_ref and z_ref.
        position_mm: f64,
        /// The limit.
        position_max_mm: f64,
    },
    /// The number of parts differs from the required one.
    #[error(
        "{parts_count} part(s) were found by gaps of at least {gap_min_mm} mm, but {} are required; a profile shows a part if a \
         fifth of its points lie on one arc of 15° or more. Change gap_min_mm, exclude other objects with region, or declare windows",
        range_in_words(*.parts_min_count, *.parts_max_count)
    )]
    PartsCountDiffers {
        /// Parts found.
        parts_count: usize,
        /// Least number.
        parts_min_count: usize,
        /// Largest number.
        parts_max_count: usize,
        /// The gap that separates two parts.
        gap_min_mm: f64,
    },
    /// The window of a part contains no profile.
    #[error(
        "no profile lies between x = {x_min_mm} mm and {x_max_mm} mm; check the window of the part, the unit and the frame, and \
         that the scan reaches there"
    )]
    WindowEmpty {
        /// Least x of the window.
        x_min_mm: f64,
        /// Largest x of the window.
        x_max_mm: f64,
    },
}

/// A cylinder among several of a cloud, in the coordinates of the scan.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct FoundCylinder {
    /// The middle of its axis, mm.
    pub point_mm: [f64; 3],
    /// Unit direction of its axis.
    pub direction: [f64; 3],
    /// Its radius.
    pub radius_mm: f64,
    /// How long its axis is.
    pub length_mm: f64,
    /// Its share of all points.
    pub share: f64,
}

fn listed(cylinders: &[FoundCylinder]) -> String {
    let one = |found: &FoundCylinder| {
        let ([x, y, z], [dx, dy, dz]) = (found.point_mm, found.direction);
        let (radius, length, share) = (found.radius_mm, found.length_mm, 100.0 * found.share);
        format!(
            "radius {radius:.3} mm, length {length:.1} mm, about ({x:.1}, {y:.1}, {z:.1}) mm along ({dx:.3}, {dy:.3}, {dz:.3}), \
             {share:.0} % of the points"
        )
    };
    cylinders.iter().map(one).collect::<Vec<_>>().join("; ")
}

fn range_in_words(least: usize, most: usize) -> String {
    if least == most { least.to_string() } else { format!("{least} to {most}") }
}

impl Refusal {
    /// The stable name of the reason.
    #[must_use]
    pub const fn code(&self) -> &'static str {
        match self {
            Self::TooFewProfiles { .. } => "too_few_profiles",
            Self::PointsIdentical { .. } => "points_identical",
            Self::TravelMissing { .. } => "travel_missing",
            Self::PointsCollinear { .. } => "points_collinear",
            Self::TooFewValidProfiles { .. } => "too_few_valid_profiles",
            Self::AxialLengthTooShort { .. } => "axial_length_too_short",
            Self::SectionsDisagree { .. } => "sections_disagree",
            Self::SectionsNotRound { .. } => "sections_not_round",
            Self::ProfilesNotPlanar { .. } => "profiles_not_planar",
            Self::NoCylinder { .. } => "no_cylinder",
            Self::TwoCylinders { .. } => "two_cylinders",
            Self::PointsUndetermined { .. } => "points_undetermined",
            Self::SeveralCylinders { .. } => "several_cylinders",
            Self::AxisNotAlongRail { .. } => "axis_not_along_rail",
            Self::LayersUndecided { .. } => "layers_undecided",
            Self::PoseUndetermined { .. } => "pose_undetermined",
            Self::PartsCountDiffers { .. } => "parts_count_differs",
            Self::WindowEmpty { .. } => "window_empty",
        }
    }
}

/// Why a profile is not valid by itself: the first reason that applies, in this order. The methods by sections leave such a profile
/// out; `cylinder` still uses those of its points that lie on the part.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Reason {
    /// It lies outside every part of the scan that was requested or found.
    OutsideParts,
    /// Fewer points than `points_min`, or fewer than six different points.
    TooFewPoints,
    /// No ellipse could be fitted.
    NotConverged,
    /// Too small a share of inliers.
    LowInlierRatio,
    /// The inliers span too small an arc, or lie on a straight line.
    ArcTooShort,
    /// Its centre lies too far from the axis of the other profiles.
    OffAxis,
}

impl Reason {
    /// All reasons, in the order in which they are checked.
    pub const ALL: [Self; 6] = [
        Self::OutsideParts,
        Self::TooFewPoints,
        Self::NotConverged,
        Self::LowInlierRatio,
        Self::ArcTooShort,
        Self::OffAxis,
    ];

    /// The name used in results.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::OutsideParts => "outside_parts",
            Self::TooFewPoints => "too_few_points",
            Self::NotConverged => "not_converged",
            Self::LowInlierRatio => "low_inlier_ratio",
            Self::ArcTooShort => "arc_too_short",
            Self::OffAxis => "off_axis",
        }
    }

    /// The advice if most profiles are rejected for this reason.
    pub(super) fn advice(self, sigma_mm: Option<f64>, epsilon_mm: f64) -> String {
        match (self, sigma_mm) {
            (Self::OutsideParts, _) => "widen the windows of the parts".to_owned(),
            (Self::TooFewPoints, _) => {
                "lower points_min, or declare which points make a profile (profile_by)".to_owned()
            }
            (Self::NotConverged, _) => {
                "no section of a cylinder fits them; check unit, frame, region and which column is the height"
                    .to_owned()
            }
            (Self::LowInlierRatio, Some(sigma_mm)) => format!(
                "their points scatter by {sigma_mm:.3} mm about their sections where epsilon_mm is {epsilon_mm}; if that is the \
                 sensor's noise raise epsilon_mm, if it is interference use the method cylinder"
            ),
            (Self::LowInlierRatio, None) => "see the profiles".to_owned(),
            (Self::ArcTooShort, _) => {
                "show more of the section to the sensor, lower arc_min_deg, or use the method cylinder".to_owned()
            }
            (Self::OffAxis, _) => {
                "their centres lie on no common line; check the order of the profiles and x".to_owned()
            }
        }
    }
}
