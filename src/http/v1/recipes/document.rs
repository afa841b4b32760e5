//! The document of a recipe as clients write and read it; every field is optional. It includes the rule for the parts of a scan and
//! the data of the calibration.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::estimation::{ByGap, PartRule, TypeB, Window};
use crate::geometry::Frame;
use crate::http::wire::names::{DecimalName, EndFaceName, MethodName, OrientationName, RadiusName, UnitName};
use crate::scan::slice::Region;
use crate::service::Recipe;

/// How a kind of part is measured. A missing field keeps its default.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields, default)]
#[schema(as = Recipe, example = json!({"description": "shaft, 200 mm", "nominal_radius_mm": 200.0, "points_min": 50}))]
pub struct RecipeDocument {
    /// For people.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(max_length = 1000)]
    pub description: Option<String>,
    /// How the pose is found.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(in crate::http) method: Option<MethodName>,
    /// A point nearer than this to its ellipse is an inlier. Not together with `epsilon_noise_multiple`.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(exclusive_minimum = 0.0, maximum = 100000.0)]
    pub epsilon_mm: Option<f64>,
    /// The same as a multiple of `noise_sigma_mm`.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(exclusive_minimum = 0.0, maximum = 100000.0)]
    pub epsilon_noise_multiple: Option<f64>,
    /// The sensor's noise, one standard deviation.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(exclusive_minimum = 0.0, maximum = 100000.0)]
    pub noise_sigma_mm: Option<f64>,
    /// A profile with a smaller share of inliers is rejected.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(minimum = 0.0, maximum = 1.0)]
    pub inlier_ratio_min: Option<f64>,
    /// Re-weighted ellipse fits of one profile.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(minimum = 1, maximum = 50)]
    pub iterations_max: Option<u32>,
    /// A profile with fewer points is rejected.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(minimum = 6, maximum = 10000)]
    pub points_min: Option<u32>,
    /// A profile whose inliers span a smaller arc is rejected.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(minimum = 0.0, maximum = 360.0)]
    pub arc_min_deg: Option<f64>,
    /// Fewer valid profiles than this refuse the scan.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(minimum = 2, maximum = 100000)]
    pub profiles_min: Option<u32>,
    /// Valid profiles closer together than this along x refuse the scan; no limit by default.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(exclusive_minimum = 0.0, maximum = 100000.0)]
    pub axial_length_min_mm: Option<f64>,
    /// The radius that the drawing gives; a fitted radius far from it is warned of.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(exclusive_minimum = 0.0, maximum = 100000.0)]
    pub nominal_radius_mm: Option<f64>,
    /// How `cylinder` treats the radius: free, fixed or prior.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(in crate::http) radius: Option<RadiusName>,
    /// Standard uncertainty of the nominal radius.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(exclusive_minimum = 0.0, maximum = 100000.0)]
    pub radius_sigma_mm: Option<f64>,
    /// Angles known worse than this refuse the scan; standard uncertainty, complete.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(exclusive_minimum = 0.0, maximum = 90.0)]
    pub angle_uncertainty_max_deg: Option<f64>,
    /// Positions at x_ref known worse than this refuse the scan; standard uncertainty, complete. A hundredth of the radius by default.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(exclusive_minimum = 0.0, maximum = 100000.0)]
    pub position_uncertainty_max_mm: Option<f64>,
    /// The calibration of stage, sensor and temperature, for the uncertainty budget; given as a whole.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub type_b: Option<TypeBDocument>,
    /// In which directions the axis is looked for: along X (`rail`), in `any` direction, or along X if it lies there and else in any
    /// (`auto`).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(in crate::http) orientation: Option<OrientationName>,
    /// An axis farther from X than this is not along the rail: refused with `rail`, a warning with `auto`.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(exclusive_minimum = 0.0, maximum = 45.0)]
    pub tilt_max_deg: Option<f64>,
    /// Values of x, y or z, in the unit of the file, that mark points as missing. They are looked for where none are given; an
    /// empty list says that there are none.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(max_items = 16)]
    pub missing_values: Option<Vec<f64>>,
    /// Which end faces are measured: none, near (the smaller x), far or both.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(in crate::http) end_face: Option<EndFaceName>,
    /// Unit of the file's coordinates.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(in crate::http) unit: Option<UnitName>,
    /// Sign before the decimals of a text file's numbers, where its cells do not show it: `point` or `comma`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(in crate::http) decimal: Option<DecimalName>,
    /// Distance between the profiles of a file that is a matrix of heights; its first column is y where `y_pitch_mm` is left out.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(exclusive_minimum = 0.0, maximum = 100000.0)]
    pub x_pitch_mm: Option<f64>,
    /// Distance between the points of a profile in such a file; its first column is x where `x_pitch_mm` is left out. With both, a
    /// profile is a row, or with `profile_by` `column` a column.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(exclusive_minimum = 0.0, maximum = 100000.0)]
    pub y_pitch_mm: Option<f64>,
    /// Which points belong to one profile: `column`, `column=NAME`, `row`, `x_pitch_mm`, `x_pitch_mm=NUMBER`, `x_value`.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(example = "x_value")]
    pub profile_by: Option<String>,
    /// The rail frame in the coordinates of the scan, where they differ.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub frame: Option<FrameDocument>,
    /// The part of the scan that is used, in the rail frame.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub region: Option<RegionDocument>,
    /// Which profiles belong to one part, where a scan shows several one behind the other.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub parts: Option<PartsDocument>,
}

/// The rail frame as seen from the coordinates of a scan.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(as = Frame)]
pub struct FrameDocument {
    /// Its origin.
    pub origin_mm: [f64; 3],
    /// Direction of the rail; any length but zero.
    pub x_axis: [f64; 3],
    /// Direction towards the sensor; its part along the rail is removed.
    pub z_axis: [f64; 3],
}

/// Windows `[lower, upper]`, bounds included; one left out keeps all.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields, default)]
#[schema(as = Region)]
pub struct RegionDocument {
    /// Along the rail.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub x_mm: Option<[f64; 2]>,
    /// Across.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub y_mm: Option<[f64; 2]>,
    /// Up.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub z_mm: Option<[f64; 2]>,
}

impl From<RecipeDocument> for Recipe {
    fn from(document: RecipeDocument) -> Self {
        Self {
            description: document.description,
            method: document.method.map(Into::into),
            epsilon_mm: document.epsilon_mm,
            epsilon_noise_multiple: document.epsilon_noise_multiple,
            noise_sigma_mm: document.noise_sigma_mm,
            inlier_ratio_min: document.inlier_ratio_min,
            iterations_max: document.iterations_max,
            points_min: document.points_min,
            arc_min_deg: document.arc_min_deg,
            profiles_min: document.profiles_min,
            axial_length_min_mm: document.axial_length_min_mm,
            nominal_radius_mm: document.nominal_radius_mm,
            radius: document.radius.map(Into::into),
            radius_sigma_mm: document.radius_sigma_mm,
            angle_uncertainty_max_deg: document.angle_uncertainty_max_deg,
            position_uncertainty_max_mm: document.position_uncertainty_max_mm,
            type_b: document.type_b.map(Into::into),
            orientation: document.orientation.map(Into::into),
            tilt_max_deg: document.tilt_max_deg,
            missing_values: document.missing_values,
            end_face: document.end_face.map(Into::into),
            unit: document.unit.map(Into::into),
            decimal: document.decimal.map(Into::into),
            x_pitch_mm: document.x_pitch_mm,
            y_pitch_mm: document.y_pitch_mm,
            profile_by: document.profile_by,
            frame: document.frame.map(|frame| Frame {
                origin_mm: frame.origin_mm,
                x_axis: frame.x_axis,
                z_axis: frame.z_axis,
            }),
            region: document.region.map(|region| Region { x_mm: region.x_mm, y_mm: region.y_mm, z_mm: region.z_mm }),
            parts: document.parts.map(Into::into),
        }
    }
}

impl From<Recipe> for RecipeDocument {
    fn from(recipe: Recipe) -> Self {
        Self {
            description: recipe.description,
            method: recipe.method.map(Into::into),
            epsilon_mm: recipe.epsilon_mm,
            epsilon_noise_multiple: recipe.epsilon_noise_multiple,
            noise_sigma_mm: recipe.noise_sigma_mm,
            inlier_ratio_min: recipe.inlier_ratio_min,
            iterations_max: recipe.iterations_max,
            points_min: recipe.points_min,
            arc_min_deg: recipe.arc_min_deg,
            profiles_min: recipe.profiles_min,
            axial_length_min_mm: recipe.axial_length_min_mm,
            nominal_radius_mm: recipe.nominal_radius_mm,
            radius: recipe.radius.map(Into::into),
            radius_sigma_mm: recipe.radius_sigma_mm,
            angle_uncertainty_max_deg: recipe.angle_uncertainty_max_deg,
            position_uncertainty_max_mm: recipe.position_uncertainty_max_mm,
            type_b: recipe.type_b.map(Into::into),
            orientation: recipe.orientation.map(Into::into),
            tilt_max_deg: recipe.tilt_max_deg,
            missing_values: recipe.missing_values,
            end_face: recipe.end_face.map(Into::into),
            unit: recipe.unit.map(Into::into),
            decimal: recipe.decimal.map(Into::into),
            x_pitch_mm: recipe.x_pitch_mm,
            y_pitch_mm: recipe.y_pitch_mm,
            profile_by: recipe.profile_by,
            frame: recipe.frame.map(|frame| FrameDocument {
                origin_mm: frame.origin_mm,
                x_axis: frame.x_axis,
                z_axis: frame.z_axis,
            }),
            region: recipe.region.map(|region| RegionDocument {
                x_mm: region.x_mm,
                y_mm: region.y_mm,
                z_mm: region.z_mm,
            }),
            parts: recipe.parts.map(Into::into),
        }
    }
}

/// Which profiles belong to one part: all of them (`"one"`), those between gaps, or those in windows along x.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
#[schema(as = PartRule, example = json!({"windows": [
    {"name": "moving", "x_min_mm": 0.0, "x_max_mm": 380.0, "nominal_radius_mm": 200.0},
    {"name": "fixed", "x_min_mm": 420.0, "x_max_mm": 800.0}
]}))]
pub enum PartsDocument {
    /// All of them.
    One,
    /// Those between two gaps; the parts are called `part_1`, `part_2`, … in order of x.
    ByGap(ByGapDocument),
    /// Those in a window, up to 16 of them in any order; they must not overlap.
    Windows(Vec<WindowDocument>),
}

/// Parts that are found by what lies between them.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields, default)]
#[schema(as = PartsByGap)]
pub struct ByGapDocument {
    /// A stretch of the rail at least this long without a profile that shows a part divides two parts; 20 mm, and in any
    /// case 2.5 times the usual distance between profiles.
    #[schema(exclusive_minimum = 0.0, maximum = 100000.0)]
    pub gap_min_mm: f64,
    /// How many parts there must be; another number is refused.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(minimum = 1, maximum = 16)]
    pub count: Option<u32>,
}

/// A part that is looked for in one place.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(as = PartWindow)]
pub struct WindowDocument {
    /// The name of the part; unique.
    #[schema(pattern = "^[A-Za-z][A-Za-z0-9_-]{0,31}$")]
    pub name: String,
    /// Least x in the rail frame, included.
    #[schema(minimum = -1_000_000.0, maximum = 1_000_000.0)]
    pub x_min_mm: f64,
    /// Largest x, included.
    #[schema(minimum = -1_000_000.0, maximum = 1_000_000.0)]
    pub x_max_mm: f64,
    /// The radius that the drawing of this part gives; that of the recipe or the request by default.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(exclusive_minimum = 0.0, maximum = 100000.0)]
    pub nominal_radius_mm: Option<f64>,
}

impl Default for ByGapDocument {
    fn default() -> Self {
        let ByGap { gap_min_mm, count } = ByGap::default();
        Self { gap_min_mm, count }
    }
}

impl From<PartsDocument> for PartRule {
    fn from(document: PartsDocument) -> Self {
        match document {
            PartsDocument::One => Self::One,
            PartsDocument::ByGap(ByGapDocument { gap_min_mm, count }) => Self::ByGap(ByGap { gap_min_mm, count }),
            PartsDocument::Windows(windows) => Self::Windows(windows.into_iter().map(Window::from).collect()),
        }
    }
}

impl From<PartRule> for PartsDocument {
    fn from(rule: PartRule) -> Self {
        match rule {
            PartRule::One => Self::One,
            PartRule::ByGap(ByGap { gap_min_mm, count }) => Self::ByGap(ByGapDocument { gap_min_mm, count }),
            PartRule::Windows(windows) => Self::Windows(windows.into_iter().map(WindowDocument::from).collect()),
        }
    }
}

impl From<WindowDocument> for Window {
    fn from(WindowDocument { name, x_min_mm, x_max_mm, nominal_radius_mm }: WindowDocument) -> Self {
        Self { name, x_min_mm, x_max_mm, nominal_radius_mm }
    }
}

impl From<Window> for WindowDocument {
    fn from(Window { name, x_min_mm, x_max_mm, nominal_radius_mm }: Window) -> Self {
        Self { name, x_min_mm, x_max_mm, nominal_radius_mm }
    }
}

/// Standard uncertainties from calibration (GUM type B): each one that is not zero is a line of the budget.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields, default)]
#[schema(as = TypeB)]
pub struct TypeBDocument {
    /// How far the stage carries the sensor off a straight line, in y and in z, at any place of the rail.
    #[schema(minimum = 0.0, maximum = 1000.0)]
    pub stage_straightness_mm: f64,
    /// Distance along the rail over which its deviation stays alike, as exp(−distance²/(2·this²)).
    #[schema(minimum = 1.0, maximum = 100000.0)]
    pub stage_straightness_length_mm: f64,
    /// Deviation of the sensor's distance from the true one at any place of the laser line, alike in every profile.
    #[schema(minimum = 0.0, maximum = 1000.0)]
    pub sensor_linearity_mm: f64,
    /// Distance along the laser line over which that deviation stays alike, as exp(−distance²/(2·this²)); null takes a fifth of the
    /// width that is seen of the part, for which the effect is about the largest.
    #[schema(minimum = 1.0, maximum = 100000.0)]
    pub sensor_linearity_length_mm: Option<f64>,
    /// Rotation of the coordinates of the scan against the rail frame, about each axis.
    #[schema(minimum = 0.0, maximum = 10.0)]
    pub extrinsics_rotation_deg: f64,
    /// Place of the coordinates of the scan in the rail frame, along each axis.
    #[schema(minimum = 0.0, maximum = 1000.0)]
    pub extrinsics_position_mm: f64,
    /// Temperature of the part against the one that lengths are stated for.
    #[schema(minimum = 0.0, maximum = 100.0)]
    pub temperature_sigma_k: f64,
    /// How much of its length the part grows by in one kelvin.
    #[schema(minimum = 0.0, maximum = 0.001)]
    pub expansion_per_k: f64,
}

impl Default for TypeBDocument {
    fn default() -> Self {
        TypeB::default().into()
    }
}

impl From<TypeBDocument> for TypeB {
    fn from(document: TypeBDocument) -> Self {
        Self {
            stage_straightness_mm: document.stage_straightness_mm,
            stage_straightness_length_mm: document.stage_straightness_length_mm,
            sensor_linearity_mm: document.sensor_linearity_mm,
            sensor_linearity_length_mm: document.sensor_linearity_length_mm,
            extrinsics_rotation_deg: document.extrinsics_rotation_deg,
            extrinsics_position_mm: document.extrinsics_position_mm,
            temperature_sigma_k: document.temperature_sigma_k,
            expansion_per_k: document.expansion_per_k,
        }
    }
}

impl From<TypeB> for TypeBDocument {
    fn from(type_b: TypeB) -> Self {
        Self {
            stage_straightness_mm: type_b.stage_straightness_mm,
            stage_straightness_length_mm: type_b.stage_straightness_length_mm,
            sensor_linearity_mm: type_b.sensor_linearity_mm,
            sensor_linearity_length_mm: type_b.sensor_linearity_length_mm,
            extrinsics_rotation_deg: type_b.extrinsics_rotation_deg,
            extrinsics_position_mm: type_b.extrinsics_position_mm,
            temperature_sigma_k: type_b.temperature_sigma_k,
            expansion_per_k: type_b.expansion_per_k,
        }
    }
}
