//! A recipe as clients write and read it. Every field may be left out.

use super::super::names::{DecimalName, EndFaceName, MethodName, OrientationName, RadiusName, UnitName};
use super::parts::PartsDocument;
use super::type_b::TypeBDocument;
use crate::geometry::Frame;
use crate::scan::slice::Region;
use crate::service::Recipe;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// How a kind of part is measured. What is left out keeps its default.
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
    pub(in super::super) method: Option<MethodName>,
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
    /// Valid profiles closer together than this along x refuse the scan; no limit where nobody says.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(exclusive_minimum = 0.0, maximum = 100000.0)]
    pub axial_length_min_mm: Option<f64>,
    /// The radius that the drawing gives; a fitted radius far from it is warned of.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(exclusive_minimum = 0.0, maximum = 100000.0)]
    pub nominal_radius_mm: Option<f64>,
    /// How `cylinder` treats the radius: free, fixed or prior.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(in super::super) radius: Option<RadiusName>,
    /// Standard uncertainty of the nominal radius.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(exclusive_minimum = 0.0, maximum = 100000.0)]
    pub radius_sigma_mm: Option<f64>,
    /// Angles known worse than this refuse the scan; standard uncertainty, complete.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(exclusive_minimum = 0.0, maximum = 90.0)]
    pub angle_uncertainty_max_deg: Option<f64>,
    /// Positions at x_ref known worse than this refuse the scan; standard uncertainty, complete. A hundredth of the radius where
    /// nobody says.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(exclusive_minimum = 0.0, maximum = 100000.0)]
    pub position_uncertainty_max_mm: Option<f64>,
    /// What is known of stage, sensor and temperature, for the uncertainty budget; given as a whole.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub type_b: Option<TypeBDocument>,
    /// In which directions the axis is looked for: along X (`rail`), in `any` direction, or along X if it lies there and else in any
    /// (`auto`).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(in super::super) orientation: Option<OrientationName>,
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
    pub(in super::super) end_face: Option<EndFaceName>,
    /// Unit of the file's coordinates.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(in super::super) unit: Option<UnitName>,
    /// Sign before the decimals of a text file's numbers, where its cells do not show it: `point` or `comma`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(in super::super) decimal: Option<DecimalName>,
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
    /// What of the scan is looked at, in the rail frame.
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
