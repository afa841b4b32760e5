//! The flags of `coaxis simulate scan` that make a scene harder than an even part seen from above: how the sensor looks, what
//! noise shares, what stands on and beside the part.

use crate::scan::synthetic::{Bead, ClampShape, Interference, Part, Sampling, Surroundings};

/// Whatever is not said is not there.
#[derive(Debug, clap::Args)]
pub(super) struct SceneArguments {
    /// Direction of the middle of the arc, from +Z towards +Y
    #[arg(long, value_name = "DEG", default_value_t = 0.0, allow_hyphen_values = true)]
    view_deg: f64,
    /// Sample by equal steps of y, as a sensor above does, and not by equal angles
    #[arg(long)]
    even_across: bool,
    /// How far profiles may lie from their even places, as a share of half the spacing
    #[arg(long, value_name = "SHARE", default_value_t = 0.0, allow_hyphen_values = true)]
    spacing_spread: f64,
    /// Correlation of a point's noise with its neighbour's along the profile
    #[arg(long, value_name = "SHARE", default_value_t = 0.0, allow_hyphen_values = true)]
    noise_correlation: f64,
    /// Standard deviation by which whole profiles are off, in y and in z
    #[arg(long, value_name = "MM", default_value_t = 0.0, allow_hyphen_values = true)]
    jitter_mm: f64,
    /// Face of the clamps: concentric, flat, or the radius of a round clamp in mm
    #[arg(long, value_name = "SHAPE", default_value = "concentric", value_parser = clamp_shape)]
    clamp_shape: ClampShape,
    /// How far from the middle of the arc holes and clamps stand, as a share of it
    #[arg(long, value_name = "SHARE", default_value_t = 0.0, allow_hyphen_values = true)]
    shift: f64,
    /// Height of a weld bead along the part
    #[arg(long, value_name = "MM", default_value_t = 0.0, allow_hyphen_values = true)]
    bead_height_mm: f64,
    /// Share of the arc that the bead covers
    #[arg(long, value_name = "SHARE", default_value_t = 0.05, allow_hyphen_values = true)]
    bead_arc: f64,
    /// Where its middle lies along the arc, 0 to 1
    #[arg(long, value_name = "SHARE", default_value_t = 0.4, allow_hyphen_values = true)]
    bead_place: f64,
    /// Points on a floor beside the part, as a share of those on it
    #[arg(long, value_name = "SHARE", default_value_t = 0.0, allow_hyphen_values = true)]
    floor: f64,
    /// How far below the axis the floor lies
    #[arg(long, value_name = "MM", default_value_t = 100.0, allow_hyphen_values = true)]
    floor_depth_mm: f64,
    /// Points of a support beside the part, as a share of those on it
    #[arg(long, value_name = "SHARE", default_value_t = 0.0, allow_hyphen_values = true)]
    support: f64,
    /// Share of the profiles that show the support
    #[arg(long, value_name = "SHARE", default_value_t = 1.0, allow_hyphen_values = true)]
    supports: f64,
    /// Radius of a round support; 0 for a level one
    #[arg(long, value_name = "MM", default_value_t = 0.0, allow_hyphen_values = true)]
    support_radius_mm: f64,
}

fn clamp_shape(text: &str) -> Result<ClampShape, String> {
    match (text, text.parse::<f64>()) {
        ("concentric", _) => Ok(ClampShape::Concentric),
        ("flat", _) => Ok(ClampShape::Flat),
        (_, Ok(radius_mm)) if (1e-3..=1e5).contains(&radius_mm) => Ok(ClampShape::Round { radius_mm }),
        _ => Err("say concentric, flat, or a radius in mm between 0.001 and 100000".to_owned()),
    }
}

impl SceneArguments {
    /// The part in this scene.
    pub(super) fn around(&self, part: &Part) -> Part {
        let sampling = if self.even_across { Sampling::EvenAcross } else { Sampling::EvenAngle };
        let bead = Bead { height_mm: self.bead_height_mm, arc: self.bead_arc, place: self.bead_place };
        Part {
            view_deg: self.view_deg,
            sampling,
            spacing_spread: self.spacing_spread,
            noise_correlation: self.noise_correlation,
            jitter_sigma_mm: self.jitter_mm,
            interference: Interference { clamp_shape: self.clamp_shape, shift: self.shift, bead, ..part.interference },
            surroundings: Surroundings {
                floor: self.floor,
                floor_depth_mm: self.floor_depth_mm,
                support: self.support,
                supports: self.supports,
                support_radius_mm: self.support_radius_mm,
            },
            ..part.clone()
        }
    }

    /// Names, values and bounds, in the order of the flags.
    pub(super) fn ranges(&self) -> [(&'static str, f64, f64, f64); 14] {
        [
            ("view-deg", self.view_deg, -180.0, 180.0),
            ("spacing-spread", self.spacing_spread, 0.0, 1.0),
            ("noise-correlation", self.noise_correlation, 0.0, 1.0),
            ("jitter-mm", self.jitter_mm, 0.0, 1e4),
            ("shift", self.shift, -1.0, 1.0),
            ("bead-height-mm", self.bead_height_mm, -1e4, 1e4),
            ("bead-arc", self.bead_arc, 0.0, 1.0),
            ("bead-place", self.bead_place, 0.0, 1.0),
            ("floor", self.floor, 0.0, 10.0),
            ("floor-depth-mm", self.floor_depth_mm, -1e5, 1e5),
            ("support", self.support, 0.0, 10.0),
            ("supports", self.supports, 0.0, 1.0),
            ("support-radius-mm", self.support_radius_mm, 0.0, 1e5),
            ("bead-arc of a bead", if self.bead_height_mm == 0.0 { 1.0 } else { self.bead_arc }, 1e-6, 1.0),
        ]
    }
}
