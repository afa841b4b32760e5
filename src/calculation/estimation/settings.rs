//! The settings of an estimation, and their ranges.

use serde::{Deserialize, Serialize};

/// Largest deviation of a radius from the nominal one, relative to it, in the search for a cylinder with a nominal radius.
pub(super) const NOMINAL_REACH: f64 = 0.02;

/// The method of finding the pose.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Method {
    /// One robust fit of one cylinder to every point of every profile.
    #[default]
    Cylinder,
    /// The Gaussian associated cylinder: unweighted least squares of the distances of all points (ISO 22432).
    LeastSquares,
    /// Published robust method: an ellipse for each profile by Tukey M-estimation, inlier rule, robust line.
    SectionLine,
    /// The same without re-weighting and without the inlier rule; for comparison only.
    SectionLinePlain,
}

impl Method {
    /// All methods, the best first.
    pub const ALL: [Self; 4] = [Self::Cylinder, Self::LeastSquares, Self::SectionLine, Self::SectionLinePlain];

    /// The name used in requests, results and flags.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Cylinder => "cylinder",
            Self::LeastSquares => "least_squares",
            Self::SectionLine => "section_line",
            Self::SectionLinePlain => "section_line_plain",
        }
    }

    /// The method of this name.
    #[must_use]
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|method| method.name() == name)
    }
}

/// How the radius is treated.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum RadiusRule {
    /// Fitted to the data alone.
    #[default]
    Free,
    /// Fixed at the nominal radius.
    Fixed,
    /// The nominal radius with its uncertainty as a prior.
    Prior,
}

/// The directions in which the axis is searched.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Orientation {
    /// Along X, the rail, if there is an axis, otherwise in any direction, with a warning.
    #[default]
    Auto,
    /// Along X within `tilt_max_deg`.
    Rail,
    /// In any direction.
    Any,
}

impl Orientation {
    /// All of them.
    pub const ALL: [Self; 3] = [Self::Auto, Self::Rail, Self::Any];

    /// The name used in recipes and flags.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Auto => "auto",
            Self::Rail => "rail",
            Self::Any => "any",
        }
    }

    /// The orientation of this name.
    #[must_use]
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|orientation| orientation.name() == name)
    }
}

/// Which end faces of the part are measured.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum EndFaceRule {
    /// Neither.
    #[default]
    None,
    /// That at the smaller x.
    Near,
    /// That at the larger x.
    Far,
    /// Both.
    Both,
}

impl EndFaceRule {
    /// All rules.
    pub const ALL: [Self; 4] = [Self::None, Self::Near, Self::Far, Self::Both];

    /// The name used in recipes and flags.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::None => "none",
            Self::Near => "near",
            Self::Far => "far",
            Self::Both => "both",
        }
    }

    /// The rule of this name.
    #[must_use]
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|rule| rule.name() == name)
    }

    /// Whether this end is requested.
    #[must_use]
    pub fn asks_for(self, end: End) -> bool {
        matches!((self, end), (Self::Both, _) | (Self::Near, End::Near) | (Self::Far, End::Far))
    }
}

/// One end of the part.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum End {
    /// At the smaller x.
    Near,
    /// At the larger x.
    Far,
}

impl End {
    /// The name used in results.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Near => "near",
            Self::Far => "far",
        }
    }
}

/// All inputs of an estimate besides the scan. Lengths in mm.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Settings {
    /// How the pose is found.
    pub method: Method,
    /// A point nearer than this to its ellipse is an inlier. A radius below four of these is not resolved.
    ///
    /// 0.111 mm reproduces the published inlier ratio of 97.4 % on a smooth profile with a noise of 0.05 mm in y and z.
    pub epsilon_mm: f64,
    /// A profile with a smaller share of inliers is rejected.
    pub inlier_ratio_min: f64,
    /// Re-weighted ellipse fits of one profile, 1 to 50 (3 to 5 in the publication).
    pub iterations_max: u32,
    /// A profile with fewer points is rejected.
    pub points_min: u32,
    /// A profile whose inliers span a smaller arc is rejected.
    pub arc_min_deg: f64,
    /// A scan with fewer valid profiles is refused.
    pub profiles_min: u32,
    /// A scan whose valid profiles span less than this along x is refused.
    ///
    /// By default only the uncertainty of the direction decides.
    pub axial_length_min_mm: Option<f64>,
    /// The nominal radius from the drawing. `cylinder` searches only for it; the other methods warn of a radius far from it.
    pub nominal_radius_mm: Option<f64>,
    /// How `cylinder` treats the radius; fixed and prior need the nominal radius.
    pub radius: RadiusRule,
    /// Standard uncertainty of the nominal radius; required for a prior, and a line of the budget for a fixed radius.
    pub radius_sigma_mm: Option<f64>,
    /// `cylinder` refuses a scan whose angles have a larger standard uncertainty.
    pub angle_uncertainty_max_deg: f64,
    /// `cylinder` refuses a scan whose position at x_ref has a larger standard uncertainty.
    ///
    /// A hundredth of the radius by default.
    pub position_uncertainty_max_mm: Option<f64>,
    /// The directions in which the axis is searched.
    pub orientation: Orientation,
    /// An axis that lies farther from X is not along the rail.
    pub tilt_max_deg: f64,
    /// Which end faces are measured.
    pub end_face: EndFaceRule,
    /// Calibration of stage, sensor and temperature, for the uncertainty budget.
    pub type_b: TypeB,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            method: Method::default(),
            epsilon_mm: 0.111,
            inlier_ratio_min: 0.85,
            iterations_max: 5,
            points_min: 20,
            arc_min_deg: 60.0,
            profiles_min: 3,
            axial_length_min_mm: None,
            nominal_radius_mm: None,
            radius: RadiusRule::default(),
            radius_sigma_mm: None,
            angle_uncertainty_max_deg: 0.5,
            position_uncertainty_max_mm: None,
            orientation: Orientation::default(),
            tilt_max_deg: 20.0,
            end_face: EndFaceRule::default(),
            type_b: TypeB::default(),
        }
    }
}

/// A setting outside its range.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
#[error("{name} must be {allowed}, got {value}")]
pub struct SettingError {
    /// Name of the setting.
    pub name: &'static str,
    /// The accepted values, in words.
    pub allowed: &'static str,
    /// The given value.
    pub value: f64,
}

/// A radius below this many ε is not resolved, because every point is an inlier of it.
const RESOLVED: f64 = 4.0;

impl Settings {
    /// The least radius that ε can distinguish from a point, mm.
    pub(super) fn radius_resolved_mm(&self) -> f64 {
        RESOLVED * self.epsilon_mm
    }

    /// Checks every value against its range.
    ///
    /// # Errors
    /// [`SettingError`] names the first setting that is out of range.
    pub fn check(&self) -> Result<(), SettingError> {
        let positive = "a length above 0 and at most 100000 mm";
        let length = |v: f64| v > 0.0 && v <= 1e5;
        let checks = [
            ("epsilon_mm", positive, self.epsilon_mm, length(self.epsilon_mm)),
            (
                "inlier_ratio_min",
                "between 0 and 1",
                self.inlier_ratio_min,
                (0.0..=1.0).contains(&self.inlier_ratio_min),
            ),
            ("iterations_max", "between 1 and 50", self.iterations_max.into(), (1..=50).contains(&self.iterations_max)),
            ("points_min", "between 6 and 10000", self.points_min.into(), (6..=10_000).contains(&self.points_min)),
            ("arc_min_deg", "between 0 and 360", self.arc_min_deg, (0.0..=360.0).contains(&self.arc_min_deg)),
            (
                "profiles_min",
                "between 2 and 100000",
                self.profiles_min.into(),
                (2..=100_000).contains(&self.profiles_min),
            ),
            (
                "axial_length_min_mm",
                positive,
                self.axial_length_min_mm.unwrap_or(1.0),
                self.axial_length_min_mm.is_none_or(length),
            ),
            (
                "nominal_radius_mm",
                positive,
                self.nominal_radius_mm.unwrap_or(1.0),
                self.nominal_radius_mm.is_none_or(length),
            ),
            (
                "nominal_radius_mm",
                "given where radius is fixed or prior",
                0.0,
                self.radius == RadiusRule::Free || self.nominal_radius_mm.is_some(),
            ),
            (
                "radius_sigma_mm",
                positive,
                self.radius_sigma_mm.unwrap_or(0.0),
                self.radius_sigma_mm.map_or(self.radius != RadiusRule::Prior, length),
            ),
            (
                "angle_uncertainty_max_deg",
                "above 0 and at most 90",
                self.angle_uncertainty_max_deg,
                self.angle_uncertainty_max_deg > 0.0 && self.angle_uncertainty_max_deg <= 90.0,
            ),
            (
                "position_uncertainty_max_mm",
                positive,
                self.position_uncertainty_max_mm.unwrap_or(1.0),
                self.position_uncertainty_max_mm.is_none_or(length),
            ),
            (
                "tilt_max_deg",
                "above 0 and at most 45",
                self.tilt_max_deg,
                self.tilt_max_deg > 0.0 && self.tilt_max_deg <= 45.0,
            ),
        ];
        match checks.into_iter().find(|(_, _, _, holds)| !holds) {
            Some((name, allowed, value, _)) => Err(SettingError { name, allowed, value }),
            None => self.type_b.check(),
        }
    }
}

/// Standard uncertainties from calibration; zero if unknown or negligible.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct TypeB {
    /// Deviation of the stage's travel from a straight line, in y and in z, at any position of the rail, mm.
    pub stage_straightness_mm: f64,
    /// Distance between positions of the rail whose deviations have the correlation exp(−1/2), of exp(−distance²/(2·this²)), since
    /// a guide bends smoothly, mm.
    pub stage_straightness_length_mm: f64,
    /// Deviation of the sensor's distance from the true one at any position of the laser line, equal in every profile, mm.
    pub sensor_linearity_mm: f64,
    /// Distance between positions of the laser line whose deviations have the correlation exp(−1/2), of exp(−distance²/2·this²),
    /// mm. `None` takes a fifth of the observed width of the part, for which the effect on its position is about the largest.
    pub sensor_linearity_length_mm: Option<f64>,
    /// Rotation of the coordinates of the scan relative to the rail frame, about each axis, degrees.
    pub extrinsics_rotation_deg: f64,
    /// Position of the coordinates of the scan in the rail frame, along each axis, mm.
    pub extrinsics_position_mm: f64,
    /// Difference between the temperature of the part and the reference temperature, K.
    pub temperature_sigma_k: f64,
    /// Relative expansion of the part per kelvin; 11.5e-6 is steel.
    pub expansion_per_k: f64,
}

impl Default for TypeB {
    fn default() -> Self {
        Self {
            stage_straightness_mm: 0.0,
            stage_straightness_length_mm: 100.0,
            sensor_linearity_mm: 0.0,
            sensor_linearity_length_mm: None,
            extrinsics_rotation_deg: 0.0,
            extrinsics_position_mm: 0.0,
            temperature_sigma_k: 0.0,
            expansion_per_k: 11.5e-6,
        }
    }
}

impl TypeB {
    /// Checks every value against its range.
    ///
    /// # Errors
    /// [`SettingError`] names the first value that is out of range.
    pub(super) fn check(&self) -> Result<(), SettingError> {
        let length = ("between 0 and 1000 mm", 0.0..=1000.0);
        let correlation = ("between 1 and 100000 mm", 1.0..=1e5);
        let checks = [
            ("type_b.stage_straightness_mm", length.clone(), self.stage_straightness_mm),
            ("type_b.stage_straightness_length_mm", correlation.clone(), self.stage_straightness_length_mm),
            ("type_b.sensor_linearity_mm", length.clone(), self.sensor_linearity_mm),
            ("type_b.sensor_linearity_length_mm", correlation, self.sensor_linearity_length_mm.unwrap_or(1.0)),
            ("type_b.extrinsics_rotation_deg", ("between 0 and 10", 0.0..=10.0), self.extrinsics_rotation_deg),
            ("type_b.extrinsics_position_mm", length, self.extrinsics_position_mm),
            ("type_b.temperature_sigma_k", ("between 0 and 100", 0.0..=100.0), self.temperature_sigma_k),
            ("type_b.expansion_per_k", ("between 0 and 0.001", 0.0..=1e-3), self.expansion_per_k),
        ];
        match checks.into_iter().find(|(_, (_, range), value)| !range.contains(value)) {
            Some((name, (allowed, _), value)) => Err(SettingError { name, allowed, value }),
            None => Ok(()),
        }
    }

    /// Whether any standard uncertainty is stated.
    #[must_use]
    pub fn is_stated(&self) -> bool {
        let growth = self.temperature_sigma_k * self.expansion_per_k;
        let stated = [
            self.stage_straightness_mm,
            self.sensor_linearity_mm,
            self.extrinsics_rotation_deg,
            self.extrinsics_position_mm,
            growth,
        ];
        stated.iter().any(|standard| *standard > 0.0)
    }
}
