//! The mounting of the sensor: the transformation from its coordinates to the rail frame.
//!
//! The sensor has X along its laser line, Z towards itself and Y along the travel, increasing with the encoder. Depending on the
//! mounting these three are left-handed, while the rail frame is right-handed. Therefore each axis is configured separately, and it
//! must be declared whether the transformation contains a reflection: a wrong sign would change only the sign of an angle and
//! remain unnoticed.
//!
//! ```text
//! rail = [sensor_x sensor_y sensor_z] · (x, 0, z) + translation + (travel, 0, 0)
//! ```

use super::codec::{INVALID, Scale};
use crate::device::sensor::Profile;
use nalgebra::{Matrix3, Vector3};
use serde::{Deserialize, Serialize};

/// Tolerance of the lengths and of the right angles of the axes: rounding to four decimals in a document.
const SQUARE_TOLERANCE: f64 = 1e-4;
/// Below this value a profile is in a plane x = const: 0.4 nm on 400 mm.
const PLANE_TOLERANCE: f64 = 1e-9;
/// Least component of sensor Y along the rail: an angle of 60°.
const ALONG_RAIL_MIN: f64 = 0.5;

/// The axes of the sensor in the rail frame, and the position of its origin at zero travel.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Extrinsic {
    /// Direction of the sensor's X, along the laser line.
    pub sensor_x: [f64; 3],
    /// Direction of the sensor's Y, along the travel.
    pub sensor_y: [f64; 3],
    /// Direction of the sensor's Z, towards the sensor.
    pub sensor_z: [f64; 3],
    /// Whether the three axes are left-handed.
    pub mirrored: bool,
    /// The sensor's origin, which is in the middle of its range and not in its housing; mm.
    pub translation_mm: [f64; 3],
}

/// Why an extrinsic is not valid.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum ExtrinsicError {
    /// A number is NaN or infinite.
    #[error("the extrinsic has a component that is not a finite number")]
    NotFinite,
    /// The axes do not have length one, or are not perpendicular to each other.
    #[error(
        "sensor_x, sensor_y and sensor_z must have length 1 and be perpendicular to each other; the deviation is {off}"
    )]
    NotSquare {
        /// Largest deviation of their products from the identity.
        off: f64,
    },
    /// The axes do not have the stated handedness.
    #[error(
        "sensor_x, sensor_y and sensor_z are {}-handed, which contradicts mirrored = {mirrored}; check every sign against a known part",
        if *.determinant < 0.0 { "left" } else { "right" }
    )]
    Handedness {
        /// The configured value.
        mirrored: bool,
        /// Determinant of the axes; 1 or -1 except for rounding.
        determinant: f64,
    },
    /// Sensor Y is not along the rail.
    #[error("sensor_y must point along the rail (x), forwards or backwards; its x component is {along}")]
    AcrossRail {
        /// Its component along x.
        along: f64,
    },
}

impl Extrinsic {
    /// Checks it and returns it in a form for calculations.
    ///
    /// # Errors
    /// [`ExtrinsicError`] if it is not rigid, or does not have the declared handedness.
    pub fn place(&self) -> Result<Placement, ExtrinsicError> {
        let axes = [self.sensor_x, self.sensor_y, self.sensor_z];
        if !axes.iter().flatten().chain(&self.translation_mm).all(|v| v.is_finite()) {
            return Err(ExtrinsicError::NotFinite);
        }
        let columns = Matrix3::from_columns(&axes.map(Vector3::from));
        let off = (columns.transpose() * columns - Matrix3::identity()).amax();
        // Large numbers overflow to NaN.
        if off.is_nan() || off > SQUARE_TOLERANCE {
            return Err(ExtrinsicError::NotSquare { off });
        }
        let determinant = columns.determinant();
        if (determinant < 0.0) != self.mirrored {
            return Err(ExtrinsicError::Handedness { mirrored: self.mirrored, determinant });
        }
        let [along, ..] = self.sensor_y;
        if along.abs() < ALONG_RAIL_MIN {
            return Err(ExtrinsicError::AcrossRail { along });
        }
        Ok(self.placement(along))
    }

    fn placement(&self, along: f64) -> Placement {
        let unit = |axis: [f64; 3]| Vector3::from(axis).normalize().into();
        let (sensor_x, sensor_z): ([f64; 3], [f64; 3]) = (unit(self.sensor_x), unit(self.sensor_z));
        let ([x_in_x, ..], [z_in_x, ..]) = (sensor_x, sensor_z);
        let planar = x_in_x.abs() <= PLANE_TOLERANCE && z_in_x.abs() <= PLANE_TOLERANCE;
        Placement { sensor_x, sensor_z, translation_mm: self.translation_mm, planar, forwards: along.signum() }
    }
}

/// An extrinsic that was checked.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Placement {
    sensor_x: [f64; 3],
    sensor_z: [f64; 3],
    translation_mm: [f64; 3],
    planar: bool,
    forwards: f64,
}

/// A rail coordinate as a function of the two coordinates of a point: `by_x` · x + `by_z` · z + `constant`.
#[derive(Debug, Clone, Copy)]
struct Row {
    by_x: f64,
    by_z: f64,
    constant: f64,
}

impl Row {
    fn at(self, x: f64, z: f64) -> f32 {
        (self.by_x * x + self.by_z * z + self.constant) as f32
    }
}

impl Placement {
    /// 1 if the sensor's Y increases along the rail, -1 if it decreases.
    #[must_use]
    pub fn forwards(&self) -> f64 {
        self.forwards
    }

    /// The inverse for a point of a plane x = const: (x, z) in sensor coordinates, mm; `None` if profiles are not in such planes.
    #[must_use]
    pub fn to_sensor(&self, [y, z]: [f64; 2]) -> Option<[f64; 2]> {
        let ([_, x_y, x_z], [_, z_y, z_z], [_, t_y, t_z]) = (self.sensor_x, self.sensor_z, self.translation_mm);
        let (y, z) = (y - t_y, z - t_z);
        self.planar.then_some([x_y * y + x_z * z, z_y * y + z_z * z])
    }

    /// The profile of these numbers, taken when the stage was at `travel_mm`. A point with [`INVALID`] in either number is missing.
    pub fn profile(
        &self,
        index: u64,
        travel_mm: f64,
        [x_scale, z_scale]: [Scale; 2],
        points: impl ExactSizeIterator<Item = (Option<f64>, i16)>,
    ) -> Profile {
        let [x_row, y_row, z_row] = self.rows(x_scale, z_scale);
        let [origin_x, ..] = self.translation_mm;
        let points_count = points.len();
        let room = || Vec::with_capacity(points_count);
        let mut profile = Profile {
            index,
            travel_mm: travel_mm + origin_x,
            x: if self.planar { Vec::new() } else { room() },
            y: room(),
            z: room(),
            missing_count: 0,
        };
        for (x, z) in points {
            let (Some(x), true) = (x, z != INVALID) else { continue };
            let z = f64::from(z);
            profile.y.push(y_row.at(x, z));
            profile.z.push(z_row.at(x, z));
            if !self.planar {
                // The constant of x already includes the translation.
                profile.x.push(Row { constant: x_row.constant + travel_mm, ..x_row }.at(x, z));
            }
        }
        profile.missing_count = (points_count - profile.y.len()) as u64;
        profile
    }

    fn rows(&self, x_scale: Scale, z_scale: Scale) -> [Row; 3] {
        let mut parts = self.sensor_x.iter().zip(self.sensor_z).zip(self.translation_mm);
        [(); 3].map(|()| {
            let ((by_x, by_z), translation) = parts.next().unwrap_or(((&0.0, 0.0), 0.0));
            Row {
                by_x: by_x * x_scale.step_mm(),
                by_z: by_z * z_scale.step_mm(),
                constant: by_x * x_scale.offset_mm() + by_z * z_scale.offset_mm() + translation,
            }
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MILLI: Scale = Scale { scale_nm: 1_000_000, offset_um: 0 };

    /// The mounting of docs/gocator.md: X to rail Y, Y along the rail, Z up.
    fn above() -> Extrinsic {
        Extrinsic {
            sensor_x: [0.0, 1.0, 0.0],
            sensor_y: [1.0, 0.0, 0.0],
            sensor_z: [0.0, 0.0, 1.0],
            mirrored: true,
            translation_mm: [10.0, 20.0, 30.0],
        }
    }

    fn placed(extrinsic: &Extrinsic, travel_mm: f64) -> Profile {
        let points = vec![(Some(1.0), 2), (None, 2), (Some(3.0), INVALID)];
        extrinsic.place().expect("rigid").profile(0, travel_mm, [MILLI, MILLI], points.into_iter())
    }

    #[test]
    fn a_sensor_perpendicular_to_the_rail_keeps_its_profiles_in_planes() {
        let profile = placed(&above(), 100.0);
        let wanted = Profile { index: 0, travel_mm: 110.0, x: vec![], y: vec![21.0], z: vec![32.0], missing_count: 2 };
        assert_eq!(profile, wanted);
    }

    #[test]
    fn a_rotated_sensor_gives_every_point_an_x_of_its_own() {
        // Rotated by 0.1 rad about the rail's Z, so that sensor X is inclined against the travel.
        let (s, c) = 0.1_f64.sin_cos();
        let extrinsic = Extrinsic { sensor_x: [-s, c, 0.0], sensor_y: [c, s, 0.0], ..above() };
        let profile = placed(&extrinsic, 100.0);
        // f32 represents 110 mm with a resolution of 8 nm.
        assert!((f64::from(profile.x[0]) - (110.0 - s)).abs() < 1e-5);
        assert!((f64::from(profile.y[0]) - (20.0 + c)).abs() < 1e-5);
    }

    #[test]
    fn an_undeclared_handedness_is_refused() {
        let slipped = Extrinsic { mirrored: false, ..above() };
        assert!(matches!(slipped.place(), Err(ExtrinsicError::Handedness { mirrored: false, .. })));
        let flipped = Extrinsic { sensor_x: [0.0, -1.0, 0.0], ..above() };
        assert!(matches!(flipped.place(), Err(ExtrinsicError::Handedness { mirrored: true, .. })));
        assert!(Extrinsic { mirrored: false, ..flipped }.place().is_ok());
    }

    #[test]
    fn an_extrinsic_that_is_not_rigid_or_not_along_the_rail_is_refused() {
        for sensor_x in [[0.0, 1.01, 0.0], [0.0, 0.0, 0.0], [0.1, 1.0, 0.0], [0.0, 1e200, 0.0]] {
            let bent = Extrinsic { sensor_x, ..above() };
            assert!(matches!(bent.place(), Err(ExtrinsicError::NotSquare { .. })), "{sensor_x:?}");
        }
        let nan = Extrinsic { translation_mm: [f64::NAN, 0.0, 0.0], ..above() };
        assert_eq!(nan.place(), Err(ExtrinsicError::NotFinite));
        let across = Extrinsic { sensor_x: [1.0, 0.0, 0.0], sensor_y: [0.0, 1.0, 0.0], mirrored: false, ..above() };
        assert_eq!(across.place(), Err(ExtrinsicError::AcrossRail { along: 0.0 }));
    }
}
