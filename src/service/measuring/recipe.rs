//! Measurement parameters for a kind of part: validates the operator's values, combines recipes by priority, and resolves them to
//! the settings of scan and estimation.

use crate::estimation::{
    EndFaceRule, Method, Orientation, PartRule, PartsError, RadiusRule, SettingError, Settings, TypeB,
};
use crate::geometry::{Frame, FrameError};
use crate::scan::decode::{Decimal, Grid, Unit};
use crate::scan::slice::{Region, RegionError, SliceRequest};
use crate::scan::{ProfileRule, RuleError};
use crate::service::wording::plain;
use serde::{Deserialize, Serialize};
/// Parameters of a measurement; an omitted value is taken from the next source. Lengths in mm.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Recipe {
    /// Description for people.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub description: Option<String>,
    /// Estimation method.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub method: Option<Method>,
    /// A point nearer than this to its ellipse is an inlier. Excludes `epsilon_noise_multiple`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub epsilon_mm: Option<f64>,
    /// The same as a multiple of `noise_sigma_mm`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub epsilon_noise_multiple: Option<f64>,
    /// Standard deviation of the sensor's noise.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub noise_sigma_mm: Option<f64>,
    /// A profile with a smaller share of inliers is rejected.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub inlier_ratio_min: Option<f64>,
    /// Maximum number of re-weighted ellipse fits of one profile.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub iterations_max: Option<u32>,
    /// A profile with fewer points is rejected.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub points_min: Option<u32>,
    /// A profile whose inliers span a smaller arc is rejected.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub arc_min_deg: Option<f64>,
    /// A scan with fewer valid profiles is refused.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub profiles_min: Option<u32>,
    /// A scan whose valid profiles span less than this along x is refused.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub axial_length_min_mm: Option<f64>,
    /// The nominal radius of the drawing.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub nominal_radius_mm: Option<f64>,
    /// How `cylinder` treats the radius: free, fixed or prior.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub radius: Option<RadiusRule>,
    /// Standard uncertainty of the nominal radius.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub radius_sigma_mm: Option<f64>,
    /// A scan is refused if the standard uncertainty of an angle of `cylinder` is greater.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub angle_uncertainty_max_deg: Option<f64>,
    /// A scan is refused if the standard uncertainty of a position of `cylinder` at x_ref is greater.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub position_uncertainty_max_mm: Option<f64>,
    /// Type B uncertainties of stage, sensor and temperature; given together.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub type_b: Option<TypeB>,
    /// Directions in which the axis is searched: auto, rail or any.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub orientation: Option<Orientation>,
    /// An axis at a larger angle to X is not along the rail.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub tilt_max_deg: Option<f64>,
    /// Which end faces are measured: none, near, far or both.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub end_face: Option<EndFaceRule>,
    /// Values of x, y or z, in the unit of the file, that mark points as missing; if given, no others are searched for.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub missing_values: Option<Vec<f64>>,
    /// Unit of the file's coordinates; millimetres by default.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub unit: Option<Unit>,
    /// Decimal separator of the numbers of a text file; detected by default.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub decimal: Option<Decimal>,
    /// Distance between the profiles of a file that is a matrix of heights.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub x_pitch_mm: Option<f64>,
    /// Distance between the points of a profile of such a file.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub y_pitch_mm: Option<f64>,
    /// Rule that assigns points to profiles, e.g. `column=frame`, `row`, `x_pitch_mm=0.5`, `x_value`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub profile_by: Option<String>,
    /// The rail frame in the coordinates of the scan; identical by default.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub frame: Option<Frame>,
    /// The region of the scan that is used, in the rail frame; all of it by default.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub region: Option<Region>,
    /// Rule that assigns profiles to parts; all of them to one part by default.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub parts: Option<PartRule>,
}

/// A recipe with all values filled in, ready for a measurement.
#[derive(Debug, Clone, PartialEq)]
pub struct Resolved {
    /// For the estimation.
    pub settings: Settings,
    /// For the decoder; `None` uses the unit that the file declares, or millimetres.
    pub unit: Option<Unit>,
    /// For the decoder; `None` detects it in the file.
    pub decimal: Option<Decimal>,
    /// For the decoder of a matrix.
    pub grid: Grid,
    /// Values that mark missing points, in the unit of the file; `None` searches for them.
    pub missing_values: Option<Vec<f64>>,
    /// For the division into profiles.
    pub slicing: SliceRequest,
    /// For the division into parts.
    pub parts: PartRule,
    /// The complete recipe with defaults filled in, for the record.
    pub recipe: Recipe,
}

/// Why a recipe cannot be used.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum RecipeError {
    /// A value is out of range.
    #[error("{name} must be {allowed}, got {}", plain(*value))]
    OutOfRange {
        /// Name of the field.
        name: &'static str,
        /// The accepted values, as text.
        allowed: &'static str,
        /// The given value.
        value: f64,
    },
    /// ε is given twice, as a length and as a multiple of the noise.
    #[error("epsilon_mm and epsilon_noise_multiple set the same value in two ways; give one of them")]
    EpsilonTwice,
    /// A multiple of the noise is given without the noise.
    #[error("epsilon_noise_multiple needs noise_sigma_mm, the sensor's noise")]
    NoiseUnknown,
    /// `profile_by` is not a valid rule.
    #[error("profile_by: {0}")]
    ProfileRule(#[from] RuleError),
    /// The frame's axes do not span a space.
    #[error("frame: {0}")]
    Frame(#[from] FrameError),
    /// A bound of the region is not a valid range.
    #[error("region: {0}")]
    Region(#[from] RegionError),
    /// The rule for parts is invalid.
    #[error("parts: {0}")]
    Parts(#[from] PartsError),
    /// The description is too long.
    #[error("the description has {characters_count} characters, at most {characters_max} are kept")]
    DescriptionTooLong {
        /// Given length.
        characters_count: usize,
        /// Maximum length.
        characters_max: usize,
    },
}

/// Maximum number of values that mark missing points.
const MISSING_VALUES_MAX: usize = 16;

/// Maximum length of a description.
pub const DESCRIPTION_CHARACTERS_MAX: usize = 1000;

impl From<SettingError> for RecipeError {
    fn from(SettingError { name, allowed, value }: SettingError) -> Self {
        Self::OutOfRange { name, allowed, value }
    }
}

impl Resolved {
    /// Searches the axis along the rail unless another orientation was requested: the sensor of the cell travels along it.
    pub fn look_along_rail(&mut self) {
        if self.settings.orientation == Orientation::Auto {
            self.settings.orientation = Orientation::Rail;
            self.recipe.orientation = Some(Orientation::Rail);
        }
    }

    /// The column that distinguishes the profiles, if one is named.
    #[must_use]
    pub fn profile_column(&self) -> Option<&str> {
        match &self.slicing.rule {
            Some(ProfileRule::Column(name)) => name.as_deref(),
            _ => None,
        }
    }
}

impl Recipe {
    /// The values of this recipe, and those of `under` for values that are omitted here.
    #[must_use]
    pub fn over(self, under: &Self) -> Self {
        // ε can be given in two ways; a value given here excludes the other form from below.
        let epsilon_said = self.epsilon_mm.is_some() || self.epsilon_noise_multiple.is_some();
        let unless_said = |value: Option<f64>| value.filter(|_| !epsilon_said);
        Self {
            description: self.description.or_else(|| under.description.clone()),
            method: self.method.or(under.method),
            epsilon_mm: self.epsilon_mm.or(unless_said(under.epsilon_mm)),
            epsilon_noise_multiple: self.epsilon_noise_multiple.or(unless_said(under.epsilon_noise_multiple)),
            noise_sigma_mm: self.noise_sigma_mm.or(under.noise_sigma_mm),
            inlier_ratio_min: self.inlier_ratio_min.or(under.inlier_ratio_min),
            iterations_max: self.iterations_max.or(under.iterations_max),
            points_min: self.points_min.or(under.points_min),
            arc_min_deg: self.arc_min_deg.or(under.arc_min_deg),
            profiles_min: self.profiles_min.or(under.profiles_min),
            axial_length_min_mm: self.axial_length_min_mm.or(under.axial_length_min_mm),
            nominal_radius_mm: self.nominal_radius_mm.or(under.nominal_radius_mm),
            radius: self.radius.or(under.radius),
            radius_sigma_mm: self.radius_sigma_mm.or(under.radius_sigma_mm),
            angle_uncertainty_max_deg: self.angle_uncertainty_max_deg.or(under.angle_uncertainty_max_deg),
            position_uncertainty_max_mm: self.position_uncertainty_max_mm.or(under.position_uncertainty_max_mm),
            type_b: self.type_b.or(under.type_b),
            orientation: self.orientation.or(under.orientation),
            tilt_max_deg: self.tilt_max_deg.or(under.tilt_max_deg),
            end_face: self.end_face.or(under.end_face),
            missing_values: self.missing_values.or_else(|| under.missing_values.clone()),
            unit: self.unit.or(under.unit),
            decimal: self.decimal.or(under.decimal),
            x_pitch_mm: self.x_pitch_mm.or(under.x_pitch_mm),
            y_pitch_mm: self.y_pitch_mm.or(under.y_pitch_mm),
            profile_by: self.profile_by.or_else(|| under.profile_by.clone()),
            frame: self.frame.or(under.frame),
            region: self.region.or(under.region),
            parts: self.parts.or_else(|| under.parts.clone()),
        }
    }

    /// Whether the recipe is valid by itself.
    ///
    /// # Errors
    /// [`RecipeError`] names the first invalid value.
    pub fn check(&self) -> Result<(), RecipeError> {
        self.resolve(&Settings::default()).map(|_| ())
    }

    /// Fills in omitted values from `defaults` and validates all values.
    ///
    /// # Errors
    /// [`RecipeError`] names the first invalid value.
    pub fn resolve(&self, defaults: &Settings) -> Result<Resolved, RecipeError> {
        self.check_description()?;
        self.check_missing_values()?;
        let settings = self.settings(defaults)?;
        let parts = self.parts.clone().unwrap_or_default();
        parts.settings(&settings).check()?;
        parts.check(&settings)?;
        if let Some(frame) = &self.frame {
            frame.rotation()?;
        }
        if let Some(region) = &self.region {
            region.check()?;
        }
        let rule = self.profile_by.as_deref().map(ProfileRule::parse).transpose()?;
        check_positive("x_pitch_mm", self.x_pitch_mm)?;
        check_positive("y_pitch_mm", self.y_pitch_mm)?;
        let columns_are_profiles = matches!(rule, Some(ProfileRule::Column(None)));
        let grid = Grid { x_pitch_mm: self.x_pitch_mm, y_pitch_mm: self.y_pitch_mm, columns_are_profiles };
        let slicing = SliceRequest { rule, frame: self.frame, region: self.region };
        let missing_values = self.missing_values.clone();
        let (unit, decimal, recipe) = (self.unit, self.decimal, self.filled(&settings));
        Ok(Resolved { settings, unit, decimal, grid, missing_values, slicing, parts, recipe })
    }

    fn settings(&self, default: &Settings) -> Result<Settings, RecipeError> {
        Ok(Settings {
            method: self.method.unwrap_or(default.method),
            epsilon_mm: self.epsilon()?.unwrap_or(default.epsilon_mm),
            inlier_ratio_min: self.inlier_ratio_min.unwrap_or(default.inlier_ratio_min),
            iterations_max: self.iterations_max.unwrap_or(default.iterations_max),
            points_min: self.points_min.unwrap_or(default.points_min),
            arc_min_deg: self.arc_min_deg.unwrap_or(default.arc_min_deg),
            profiles_min: self.profiles_min.unwrap_or(default.profiles_min),
            axial_length_min_mm: self.axial_length_min_mm.or(default.axial_length_min_mm),
            nominal_radius_mm: self.nominal_radius_mm.or(default.nominal_radius_mm),
            radius: self.radius.unwrap_or(default.radius),
            radius_sigma_mm: self.radius_sigma_mm.or(default.radius_sigma_mm),
            angle_uncertainty_max_deg: self.angle_uncertainty_max_deg.unwrap_or(default.angle_uncertainty_max_deg),
            position_uncertainty_max_mm: self.position_uncertainty_max_mm.or(default.position_uncertainty_max_mm),
            type_b: self.type_b.unwrap_or(default.type_b),
            orientation: self.orientation.unwrap_or(default.orientation),
            tilt_max_deg: self.tilt_max_deg.unwrap_or(default.tilt_max_deg),
            end_face: self.end_face.unwrap_or(default.end_face),
        })
    }

    fn epsilon(&self) -> Result<Option<f64>, RecipeError> {
        check_positive("noise_sigma_mm", self.noise_sigma_mm)?;
        check_positive("epsilon_noise_multiple", self.epsilon_noise_multiple)?;
        match (self.epsilon_mm, self.epsilon_noise_multiple, self.noise_sigma_mm) {
            (Some(_), Some(_), _) => Err(RecipeError::EpsilonTwice),
            (None, Some(_), None) => Err(RecipeError::NoiseUnknown),
            (None, Some(multiple), Some(sigma)) => Ok(Some(multiple * sigma)),
            (epsilon, None, _) => Ok(epsilon),
        }
    }

    fn filled(&self, settings: &Settings) -> Self {
        Self {
            method: Some(settings.method),
            epsilon_mm: Some(settings.epsilon_mm),
            // The multiple was converted to the length above.
            epsilon_noise_multiple: None,
            inlier_ratio_min: Some(settings.inlier_ratio_min),
            iterations_max: Some(settings.iterations_max),
            points_min: Some(settings.points_min),
            arc_min_deg: Some(settings.arc_min_deg),
            profiles_min: Some(settings.profiles_min),
            axial_length_min_mm: settings.axial_length_min_mm,
            nominal_radius_mm: settings.nominal_radius_mm,
            radius: Some(settings.radius),
            radius_sigma_mm: settings.radius_sigma_mm,
            angle_uncertainty_max_deg: Some(settings.angle_uncertainty_max_deg),
            position_uncertainty_max_mm: settings.position_uncertainty_max_mm,
            type_b: Some(settings.type_b),
            orientation: Some(settings.orientation),
            tilt_max_deg: Some(settings.tilt_max_deg),
            end_face: Some(settings.end_face),
            ..self.clone()
        }
    }

    fn check_missing_values(&self) -> Result<(), RecipeError> {
        let values = self.missing_values.as_deref().unwrap_or_default();
        let count = values.len();
        if count > MISSING_VALUES_MAX {
            let allowed = "a list of at most 16 values";
            return Err(RecipeError::OutOfRange { name: "missing_values", allowed, value: count as f64 });
        }
        match values.iter().find(|value| !value.is_finite()) {
            Some(value) => Err(RecipeError::OutOfRange {
                name: "missing_values",
                allowed: "a list of finite numbers",
                value: *value,
            }),
            None => Ok(()),
        }
    }

    fn check_description(&self) -> Result<(), RecipeError> {
        let characters_count = self.description.as_ref().map_or(0, |text| text.chars().count());
        let characters_max = DESCRIPTION_CHARACTERS_MAX;
        if characters_count > characters_max {
            return Err(RecipeError::DescriptionTooLong { characters_count, characters_max });
        }
        Ok(())
    }
}

fn check_positive(name: &'static str, value: Option<f64>) -> Result<(), RecipeError> {
    match value {
        Some(value) if !(value > 0.0 && value <= 1e5) => {
            Err(RecipeError::OutOfRange { name, allowed: "above 0 and at most 100000", value })
        }
        _ => Ok(()),
    }
}

/// Lower-case letters, digits, `-` and `_`, at most 64 characters; the first one is a letter or digit.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
#[serde(transparent)]
pub struct RecipeName(String);

impl RecipeName {
    /// Maximum length of a name.
    pub const CHARACTERS_MAX: usize = 64;

    /// The name, if it is valid.
    #[must_use]
    pub fn parse(text: &str) -> Option<Self> {
        let plain = |byte: u8| byte.is_ascii_lowercase() || byte.is_ascii_digit();
        let well_formed = text.bytes().all(|byte| plain(byte) || matches!(byte, b'-' | b'_'))
            && text.bytes().next().is_some_and(plain)
            && text.len() <= Self::CHARACTERS_MAX;
        well_formed.then(|| Self(text.to_owned()))
    }

    /// As text.
    #[must_use]
    pub fn as_str(&self) -> &str {
        &self.0
    }

    /// As text.
    #[must_use]
    pub fn into_string(self) -> String {
        self.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_defaults_are_those_of_the_estimation() {
        assert_eq!(Recipe::default().resolve(&Settings::default()).expect("valid").settings, Settings::default());
    }

    #[test]
    fn values_of_the_upper_recipe_override_and_the_others_are_kept() {
        let under = Recipe { points_min: Some(30), epsilon_mm: Some(0.2), ..Recipe::default() };
        let over = Recipe { epsilon_noise_multiple: Some(3.0), noise_sigma_mm: Some(0.05), ..Recipe::default() };
        let settings = over.over(&under).resolve(&Settings::default()).expect("valid").settings;
        assert_eq!(settings.points_min, 30);
        assert!((settings.epsilon_mm - 0.15).abs() < 1e-12, "a length below does not meet a multiple above");
    }

    #[test]
    fn the_resolved_recipe_resolves_to_itself() {
        let recipe = Recipe {
            epsilon_noise_multiple: Some(3.0),
            noise_sigma_mm: Some(0.05),
            profile_by: Some("x_pitch_mm=0.5".to_owned()),
            ..Recipe::default()
        };
        let elsewhere = Settings { points_min: 99, ..Settings::default() };
        let resolved = recipe.resolve(&elsewhere).expect("valid");
        assert_eq!(resolved.recipe.resolve(&Settings::default()), Ok(resolved), "independent of later defaults");
    }

    #[test]
    fn an_invalid_value_is_refused_by_name() {
        let refused = |recipe: Recipe| recipe.check().expect_err("refused").to_string();
        assert!(refused(Recipe { iterations_max: Some(0), ..Recipe::default() }).starts_with("iterations_max"));
        assert!(refused(Recipe { noise_sigma_mm: Some(-1.0), ..Recipe::default() }).starts_with("noise_sigma_mm"));
        assert!(refused(Recipe { y_pitch_mm: Some(0.0), ..Recipe::default() }).starts_with("y_pitch_mm"));
        assert!(refused(Recipe { profile_by: Some("gap".into()), ..Recipe::default() }).starts_with("profile_by"));
        let region = Some(Region { y_mm: Some([1.0, 0.0]), ..Region::default() });
        assert!(refused(Recipe { region, ..Recipe::default() }).contains("y_mm"));
        let twice = Recipe { epsilon_mm: Some(0.1), epsilon_noise_multiple: Some(2.0), ..Recipe::default() };
        assert_eq!(Recipe { noise_sigma_mm: Some(0.1), ..twice }.check(), Err(RecipeError::EpsilonTwice));
    }
}
