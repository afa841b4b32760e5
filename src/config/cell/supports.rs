//! How far the axes of a manipulator may go, and how exactly.

use serde::{Deserialize, Serialize};

/// How far the four axes of a manipulator may go.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SupportLimits {
    /// Along the rail.
    pub x: LinearLimits,
    /// Across.
    pub y: LinearLimits,
    /// Up.
    pub z: LinearLimits,
    /// The turn.
    pub c: TurnLimits,
}

/// What a linear axis may do.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LinearLimits {
    /// Least value.
    pub lower_mm: f64,
    /// Greatest value.
    pub upper_mm: f64,
    /// Longest way of one request.
    pub step_mm: f64,
    /// Greatest speed.
    pub speed_mm_s: f64,
    /// Greatest acceleration.
    pub acceleration_mm_s2: f64,
    /// Greatest jerk.
    pub jerk_mm_s3: f64,
}

/// What a turning axis may do.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TurnLimits {
    /// Least value.
    pub lower_deg: f64,
    /// Greatest value.
    pub upper_deg: f64,
    /// Longest way of one request.
    pub step_deg: f64,
    /// Greatest speed.
    pub speed_deg_s: f64,
    /// Greatest acceleration.
    pub acceleration_deg_s2: f64,
    /// Greatest jerk.
    pub jerk_deg_s3: f64,
}

/// How close to its target an axis counts as there.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Tolerances {
    /// Along the rail.
    pub x_mm: f64,
    /// Across.
    pub y_mm: f64,
    /// Up.
    pub z_mm: f64,
    /// The turn.
    pub c_deg: f64,
}

impl Default for Tolerances {
    fn default() -> Self {
        Self { x_mm: 0.1, y_mm: 0.1, z_mm: 0.1, c_deg: 0.05 }
    }
}

impl Default for SupportLimits {
    fn default() -> Self {
        let linear = |reach: f64| LinearLimits {
            lower_mm: -reach,
            upper_mm: reach,
            step_mm: reach,
            speed_mm_s: 20.0,
            acceleration_mm_s2: 100.0,
            jerk_mm_s3: 1_000.0,
        };
        let c = TurnLimits {
            lower_deg: -30.0,
            upper_deg: 30.0,
            step_deg: 15.0,
            speed_deg_s: 5.0,
            acceleration_deg_s2: 25.0,
            jerk_deg_s3: 250.0,
        };
        Self { x: linear(50.0), y: linear(25.0), z: linear(25.0), c }
    }
}
