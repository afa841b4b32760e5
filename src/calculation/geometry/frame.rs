//! A right-handed frame declared in the coordinates of a file, and the rigid motion into it.

use super::axis::Axis;
use nalgebra::{Matrix3, Vector3};
use serde::{Deserialize, Serialize};

/// The rail frame in the coordinates of a scan: its origin and two of its axes.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Frame {
    /// Origin of the rail frame, mm in the scan's coordinates.
    pub origin_mm: [f64; 3],
    /// Direction of the rail (X) in the scan's coordinates; any length except zero.
    pub x_axis: [f64; 3],
    /// Direction towards the sensor (Z); its component along `x_axis` is removed.
    pub z_axis: [f64; 3],
}

/// Why a frame cannot be used.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum FrameError {
    /// A component is NaN or infinite.
    #[error("the frame has a component that is not a finite number")]
    NotFinite,
    /// An axis has no length, or the axes are parallel.
    #[error("x_axis and z_axis of the frame must have a length and must not be parallel")]
    Degenerate,
}

impl Frame {
    /// The rotation (rows are the rail axes) that transforms scan coordinates, minus the origin, into the rail frame.
    ///
    /// # Errors
    /// [`FrameError`] if the two axes do not span a plane.
    pub fn rotation(&self) -> Result<Matrix3<f64>, FrameError> {
        if !self.origin_mm.iter().chain(&self.x_axis).chain(&self.z_axis).all(|v| v.is_finite()) {
            return Err(FrameError::NotFinite);
        }
        let (x, z) = (direction(self.x_axis)?, direction(self.z_axis)?);
        let z = (z - x * x.dot(&z)).try_normalize(1e-6).ok_or(FrameError::Degenerate)?;
        let y = z.cross(&x);
        Ok(Matrix3::from_rows(&[x.transpose(), y.transpose(), z.transpose()]))
    }

    /// The steps of a lattice of the coordinates of the scan along the axes of the frame, 0 if there is none: along an axis that
    /// combines several of the lattice, values come as near to each other as along the finest of them.
    #[must_use]
    pub fn steps(&self, lattice: [f64; 3]) -> [f64; 3] {
        let Ok(rotation) = self.rotation() else { return [0.0; 3] };
        let along = |row: usize| {
            let takes_part = |(column, _): &(usize, f64)| rotation.get((row, *column)).is_some_and(|v| v.abs() > 0.05);
            let steps = lattice.into_iter().enumerate().filter(takes_part).map(|(_, step)| step);
            steps.fold(f64::INFINITY, f64::min)
        };
        [along(0), along(1), along(2)]
    }

    /// The frame at a point of an axis whose X lies along it. Its Z is the first of the axes Z, X and Y of the scan's coordinates
    /// that is not nearly parallel to the axis, so that for an axis along the rail the two frames nearly agree.
    ///
    /// # Errors
    /// [`FrameError`] if the direction has no length.
    pub fn along(axis: &Axis) -> Result<Self, FrameError> {
        let x_axis = direction(axis.direction)?;
        // Within 53° of an axis, its component perpendicular to the direction gets short.
        let is_apart = |candidate: &&Vector3<f64>| candidate.dot(&x_axis).abs() < 0.8;
        let candidates = [Vector3::z(), Vector3::x(), Vector3::y()];
        let z_axis = candidates.iter().find(is_apart).ok_or(FrameError::Degenerate)?;
        let frame = Self { origin_mm: axis.point_mm, x_axis: x_axis.into(), z_axis: (*z_axis).into() };
        frame.rotation().map(|_| frame)
    }
}

/// An axis of length one. It is scaled by its largest component first, because the square of a large one would be infinite.
fn direction(axis: [f64; 3]) -> Result<Vector3<f64>, FrameError> {
    let axis = Vector3::from(axis);
    let largest = axis.amax();
    if largest == 0.0 {
        return Err(FrameError::Degenerate);
    }
    axis.map(|component| component / largest).try_normalize(0.0).ok_or(FrameError::Degenerate)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_frame_is_right_handed_and_maps_its_own_axes_to_unit_vectors() {
        let frame = Frame { origin_mm: [0.0; 3], x_axis: [0.0, 2.0, 0.0], z_axis: [0.0, 1.0, -3.0] };
        let rotation = frame.rotation().expect("valid");
        assert!((rotation.determinant() - 1.0).abs() < 1e-12);
        assert!((rotation * Vector3::new(0.0, 1.0, 0.0) - Vector3::x()).norm() < 1e-12);
        assert!((rotation * Vector3::new(0.0, 0.0, -1.0) - Vector3::z()).norm() < 1e-12);
    }

    #[test]
    fn parallel_axes_are_refused() {
        let frame = Frame { origin_mm: [0.0; 3], x_axis: [1.0, 0.0, 0.0], z_axis: [-2.0, 0.0, 0.0] };
        assert_eq!(frame.rotation(), Err(FrameError::Degenerate));
    }

    #[test]
    fn an_axis_may_have_any_length_except_zero() {
        for length in [f64::MAX, 1e200, 1e-200, f64::MIN_POSITIVE] {
            let frame = Frame { origin_mm: [0.0; 3], x_axis: [length, 0.0, 0.0], z_axis: [length, 0.0, -length] };
            let rotation = frame.rotation().expect("valid");
            assert!((rotation * Vector3::x() - Vector3::x()).norm() < 1e-12, "{length}");
            assert!((rotation * -Vector3::z() - Vector3::z()).norm() < 1e-12, "{length}");
        }
        let frame = Frame { origin_mm: [0.0; 3], x_axis: [0.0; 3], z_axis: [0.0, 0.0, 1.0] };
        assert_eq!(frame.rotation(), Err(FrameError::Degenerate));
    }
}
