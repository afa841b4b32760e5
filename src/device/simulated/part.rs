//! The true place of the part on its two clamps. Input: the initial and present positions of the clamps. Output: its axis, ends and
//! roll.

use super::settings::PartSettings;
use crate::geometry::AxisLine;
use crate::motion::{Pair, Position};
use nalgebra::{Rotation3, Vector3};

/// The part at its initial place on the clamps.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct HeldPart {
    /// Initial intersections of its axis with its two end planes.
    ends: [Vector3<f64>; 2],
    mounts: Pair<[f64; 3]>,
    start: Pair<Position>,
}

/// The place of the part.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Place {
    /// Intersection of its axis with its near end plane, rail frame, mm.
    pub(super) near: Vector3<f64>,
    /// Intersection of its axis with its far end plane, rail frame, mm.
    pub(super) far: Vector3<f64>,
    /// Rotation about its axis since the start, rad, from +Y towards +Z.
    pub(super) roll: f64,
}

impl HeldPart {
    /// Places the part on clamps at `start`.
    pub(super) fn put(part: &PartSettings, mounts: Pair<[f64; 3]>, start: Pair<Position>) -> Self {
        let axis = AxisLine {
            p: part.deflection_deg.to_radians().tan(),
            q: part.pitch_deg.to_radians().tan(),
            y0: part.y_c0_mm,
            z0: part.z_c0_mm,
        };
        let [y, z] = axis.at(part.near_end_mm);
        let near = Vector3::new(part.near_end_mm, y, z);
        let far = near + Vector3::from(axis.direction()) * part.length_mm;
        Self { ends: [near, far], mounts, start }
    }

    /// Its place when the clamps are at `now`: a rigid body that moves with the midpoint of the clamps and the line through them,
    /// and rotates about that line by the mean of their rotations. If it is clamped off its axis, the axis moves around that line.
    pub(super) fn at(&self, now: &Pair<Position>) -> Place {
        let ([from_1, from_2], [to_1, to_2]) = (self.clamps(&self.start), self.clamps(now));
        let rotation = attitude(to_2 - to_1, turn(now)) * attitude(from_2 - from_1, turn(&self.start)).inverse();
        let (from, to) = ((from_1 + from_2) * 0.5, (to_1 + to_2) * 0.5);
        let [near, far] = self.ends.map(|end| to + rotation * (end - from));
        Place { near, far, roll: turn(now) - turn(&self.start) }
    }

    fn clamps(&self, at: &Pair<Position>) -> [Vector3<f64>; 2] {
        let clamp = |mount: [f64; 3], at: Position| Vector3::from(mount) + Vector3::new(at.x, at.y, at.z);
        [clamp(self.mounts.m1, at.m1), clamp(self.mounts.m2, at.m2)]
    }
}

/// The orientation of the part in the rail frame: rotated about the rail, then tilted by the smallest rotation that takes the rail
/// to the line of the clamps.
fn attitude(line: Vector3<f64>, turn: f64) -> Rotation3<f64> {
    let lean = Rotation3::rotation_between(&Vector3::x(), &line).unwrap_or_default();
    lean * Rotation3::from_axis_angle(&Vector3::x_axis(), turn)
}

fn turn(at: &Pair<Position>) -> f64 {
    0.5 * (at.m1.c + at.m2.c)
}

impl Place {
    /// The axis.
    pub(super) fn axis(&self) -> AxisLine {
        let along = self.far - self.near;
        AxisLine::through(self.near.into(), along.y / along.x, along.z / along.x)
    }

    /// Position of the plane at `x` along the part: 0 at the near end of the axis, 1 at the far end.
    pub(super) fn along(&self, x: f64) -> f64 {
        (x - self.near.x) / (self.far.x - self.near.x)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motion::Axes;

    fn held(part: &PartSettings) -> HeldPart {
        HeldPart::put(part, Pair { m1: [100.0, 0.0, -250.0], m2: [700.0, 0.0, -250.0] }, Pair::default())
    }

    #[test]
    fn raising_both_clamps_lifts_the_part_and_raising_one_tilts_it() {
        let straight =
            PartSettings { deflection_deg: 0.0, pitch_deg: 0.0, y_c0_mm: 0.0, z_c0_mm: 0.0, ..Default::default() };
        // The clamps are on the axis itself.
        let held = HeldPart::put(&straight, Pair { m1: [100.0, 0.0, 0.0], m2: [700.0, 0.0, 0.0] }, Pair::default());
        let up = Axes { z: 6.0, ..Axes::default() };
        let lifted = held.at(&Pair { m1: up, m2: up }).axis();
        assert!((lifted.z0 - 6.0).abs() < 1e-12 && lifted.q.abs() < 1e-12);
        let tilted = held.at(&Pair { m1: Axes::default(), m2: up }).axis();
        // The line through (100, 0) and (700, 6) rises by 6/600 per millimetre, and is at 3 mm in its middle.
        assert!((tilted.q - 0.01).abs() < 1e-12 && (tilted.at(400.0)[1] - 3.0).abs() < 1e-9, "{tilted:?}");
    }

    #[test]
    fn a_part_clamped_off_its_axis_rotates_about_the_line_of_the_clamps() {
        let above =
            PartSettings { deflection_deg: 0.0, pitch_deg: 0.0, y_c0_mm: 0.0, z_c0_mm: 10.0, ..Default::default() };
        let held = HeldPart::put(&above, Pair { m1: [100.0, 0.0, 0.0], m2: [700.0, 0.0, 0.0] }, Pair::default());
        let quarter = Axes { c: std::f64::consts::FRAC_PI_2, ..Axes::default() };
        // From +Y towards +Z, so that the top moves to the side of -Y.
        let axis = held.at(&Pair { m1: quarter, m2: quarter }).axis();
        assert!(
            (axis.y0 + 10.0).abs() < 1e-9 && axis.z0.abs() < 1e-9 && axis.p.abs() + axis.q.abs() < 1e-12,
            "{axis:?}"
        );
    }

    #[test]
    fn the_part_keeps_its_length_and_rotates_by_the_mean_of_both_clamps() {
        let part = PartSettings::default();
        let now = Pair { m1: Axes { x: 1.0, y: 3.0, z: -2.0, c: 0.02 }, m2: Axes { x: 1.0, y: -4.0, z: 5.0, c: 0.04 } };
        let place = held(&part).at(&now);
        assert!(((place.far - place.near).norm() - part.length_mm).abs() < 1e-9);
        assert!((place.roll - 0.03).abs() < 1e-12);
        assert!((place.along(place.near.x), place.along(place.far.x)) == (0.0, 1.0));
    }
}
