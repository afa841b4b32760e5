//! What sits on a synthetic part: holes, clamps, a weld bead. In: a place along the arc. Out: how far the feature moves a point
//! there away from the surface. Holes and clamps cover whole profiles: where the laser plane is tilted, so are their ends.

/// Shares of the profiles that carry each kind of feature; the rest is smooth. They stand in blocks along x.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Interference {
    /// Profiles with two screw holes: two groups of 2 % of the points sunk by 10 and 20 mm.
    pub screw_holes: f64,
    /// Profiles through a straight hole: 15 % of the points sunk by 30 mm.
    pub straight_holes: f64,
    /// Profiles under a clamp.
    pub clamps: f64,
    /// Share of the arc that a clamp covers.
    pub clamp_arc: f64,
    /// Height of a clamp above the surface, at its middle.
    pub clamp_height_mm: f64,
    /// What a clamp looks like from the sensor.
    pub clamp_shape: ClampShape,
    /// How far from the middle of the arc holes and clamps stand, as a share of it.
    pub shift: f64,
    /// A weld bead along the whole part.
    pub bead: Bead,
}

/// The face of a clamp.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub enum ClampShape {
    /// Follows the part: a band of even thickness.
    #[default]
    Concentric,
    /// A flat clamp, square to the direction of its middle.
    Flat,
    /// A round clamp of this radius, whose axis is not the part's.
    Round {
        /// Its own radius, mm.
        radius_mm: f64,
    },
}

/// A bead along the part, highest in its middle and fading softly into the surface.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Bead {
    /// Its height; 0 for none.
    pub height_mm: f64,
    /// Share of the arc that it covers.
    pub arc: f64,
    /// Where its middle lies along the arc, 0 to 1.
    pub place: f64,
}

impl Bead {
    /// h·cos²(π t/2), with t from −1 to 1 across the bead.
    fn offset_mm(self, place: f64) -> f64 {
        let t = (place - self.place) / (0.5 * self.arc);
        if t.abs() < 1.0 { self.height_mm * (t * std::f64::consts::FRAC_PI_2).cos().powi(2) } else { 0.0 }
    }
}

/// What one profile carries.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Feature {
    /// Nothing.
    Smooth,
    /// Two groups of 2 % of the points, sunk by 10 and 20 mm.
    ScrewHoles,
    /// 15 % of the points, sunk by 30 mm.
    StraightHole,
    /// A part of the arc is hidden behind a face above it.
    Clamp {
        /// Share of the arc.
        arc: f64,
        /// Above the surface, at its middle.
        height_mm: f64,
        /// Its face.
        shape: ClampShape,
    },
}

impl Interference {
    /// A smooth part.
    pub const NONE: Self = Self {
        screw_holes: 0.0,
        straight_holes: 0.0,
        clamps: 0.0,
        clamp_arc: 0.0,
        clamp_height_mm: 0.0,
        clamp_shape: ClampShape::Concentric,
        shift: 0.0,
        bead: Bead { height_mm: 0.0, arc: 0.0, place: 0.0 },
    };

    /// What the profile at `phase` (0 to 1 along a block) carries.
    pub(super) fn feature(&self, phase: f64) -> Feature {
        let smooth = 1.0 - self.screw_holes - self.straight_holes - self.clamps;
        match phase {
            phase if phase < smooth => Feature::Smooth,
            phase if phase < smooth + self.screw_holes => Feature::ScrewHoles,
            phase if phase < smooth + self.screw_holes + self.straight_holes => Feature::StraightHole,
            _ => Feature::Clamp { arc: self.clamp_arc, height_mm: self.clamp_height_mm, shape: self.clamp_shape },
        }
    }

    /// How far the point at `place` (0 to 1 along the arc) is moved away from the axis by what `feature` and the bead put
    /// there, mm. `angle` is how far it lies from the middle of a clamp, radians about the axis.
    pub(super) fn offset_mm(&self, feature: Feature, place: f64, angle: f64, radius_mm: f64) -> f64 {
        let raised = feature.offset_mm(place - self.shift, angle, radius_mm);
        // Nobody sees a bead through a clamp.
        if raised == 0.0 { self.bead.offset_mm(place) } else { raised }
    }
}

impl Feature {
    fn offset_mm(self, place: f64, angle: f64, radius_mm: f64) -> f64 {
        let within = |start: f64, width: f64| place >= start && place < start + width;
        match self {
            Self::ScrewHoles if within(0.41, 0.02) => -10.0,
            Self::ScrewHoles if within(0.61, 0.02) => -20.0,
            Self::StraightHole if within(0.55, 0.15) => -30.0,
            Self::Clamp { arc, height_mm, shape } if within(0.5 - arc / 2.0, arc) => {
                shape.offset_mm(angle, height_mm, radius_mm)
            }
            _ => 0.0,
        }
    }
}

impl ClampShape {
    /// Height above the surface in the direction `angle` from the middle of the clamp, seen from the axis.
    fn offset_mm(self, angle: f64, height_mm: f64, radius_mm: f64) -> f64 {
        let (sin, cos) = angle.sin_cos();
        let top = radius_mm + height_mm;
        let face = match self {
            Self::Concentric => return height_mm,
            // Beyond 80° nobody looks onto a flat face any more.
            Self::Flat => top / cos.max(0.17) - radius_mm,
            Self::Round { radius_mm: own } => {
                let centre = top - own;
                centre * cos + (own * own - (centre * sin).powi(2)).max(0.0).sqrt() - radius_mm
            }
        };
        // Where a clamp would dip into the part, the part is seen.
        face.max(0.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The point in the direction `angle`, about the part's axis.
    fn face(shape: ClampShape, angle: f64) -> [f64; 2] {
        let reach = 200.0 + shape.offset_mm(angle, 25.0, 200.0);
        [reach * angle.sin(), reach * angle.cos()]
    }

    #[test]
    fn a_flat_clamp_is_flat_and_a_round_one_round() {
        for angle in [-0.6, -0.1, 0.0, 0.3, 0.5] {
            assert!((face(ClampShape::Flat, angle)[1] - 225.0).abs() < 1e-9);
            for own in [60.0, 150.0, 400.0] {
                let [y, z] = face(ClampShape::Round { radius_mm: own }, 0.3 * angle);
                assert!((y.hypot(z - (225.0 - own)) - own).abs() < 1e-9);
            }
        }
    }

    #[test]
    fn a_bead_fades_to_nothing_at_its_edges() {
        let bead = Bead { height_mm: 0.3, arc: 0.1, place: 0.4 };
        assert!((bead.offset_mm(0.4) - 0.3).abs() < 1e-12 && (bead.offset_mm(0.425) - 0.15).abs() < 1e-12);
        assert!(bead.offset_mm(0.3501) < 1e-5 && bead.offset_mm(0.46) == 0.0);
        assert_eq!(Bead::default().offset_mm(0.0), 0.0);
    }
}
