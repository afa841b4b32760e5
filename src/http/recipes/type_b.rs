//! What calibration says, as clients write and read it in a recipe.

use crate::estimation::TypeB;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

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
