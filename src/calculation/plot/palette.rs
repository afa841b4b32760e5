//! The colours, all from palettes that colour-blind readers can distinguish: Okabe and Ito's for kinds, ColorBrewer's RdYlBu for
//! signed values, viridis for heights. Each kind has a shape as well as a colour.

use crate::estimation::Reason;

/// Text and frames.
pub(super) const INK: &str = "#222222";
/// Secondary text.
pub(super) const FAINT_INK: &str = "#5a5a5a";
/// Grid lines.
pub(super) const GRID: &str = "#e3e3e3";
/// Valid profiles and inliers.
pub(super) const VALID: &str = "#0072b2";
/// Points of rejected profiles.
pub(super) const REJECTED: &str = "#e69f00";
/// Points of profiles without a verdict.
pub(super) const UNJUDGED: &str = "#56789a";
/// The fitted shapes.
pub(super) const FITTED: &str = "#000000";
/// The end faces.
pub(super) const END_FACE: &str = "#009e73";
/// Inliers by weight: below 0.25, up to 0.75, above.
pub(super) const INLIER: [&str; 3] = ["#9cc9ea", "#4a9bd1", VALID];
/// Outliers that still have a weight.
pub(super) const OUTLIER: &str = "#e69f00";
/// Outliers without any weight, and refusals.
pub(super) const EXCLUDED: &str = "#d55e00";
/// The band of the inliers.
pub(super) const BAND: &str = "#e9f3fa";

/// The colour of a reason.
pub(super) const fn reason_colour(reason: Reason) -> &'static str {
    match reason {
        Reason::OutsideParts => FAINT_INK,
        Reason::TooFewPoints => "#009e73",
        Reason::NotConverged => "#000000",
        Reason::LowInlierRatio => "#d55e00",
        Reason::ArcTooShort => "#e69f00",
        Reason::OffAxis => "#cc79a7",
    }
}

/// Steps of a colour scale on either side of the middle.
pub(super) const LEVELS: i32 = 10;

/// From far inside to far outside.
const SIGNED: [[f64; 3]; 9] = [
    [49.0, 54.0, 149.0],
    [69.0, 117.0, 180.0],
    [145.0, 191.0, 219.0],
    [216.0, 238.0, 246.0],
    [255.0, 250.0, 205.0],
    [254.0, 224.0, 144.0],
    [252.0, 141.0, 89.0],
    [215.0, 48.0, 39.0],
    [165.0, 0.0, 38.0],
];

/// viridis, from low to high.
const HEIGHT: [[f64; 3]; 9] = [
    [68.0, 1.0, 84.0],
    [71.0, 45.0, 123.0],
    [59.0, 82.0, 139.0],
    [44.0, 114.0, 142.0],
    [33.0, 145.0, 140.0],
    [39.0, 173.0, 129.0],
    [92.0, 200.0, 99.0],
    [170.0, 220.0, 50.0],
    [253.0, 231.0, 37.0],
];

/// The step of a value whose scale saturates at ±`limit`: −[`LEVELS`] to [`LEVELS`], 0 in the middle.
pub(super) fn level(value: f64, limit: f64) -> i32 {
    let steps = f64::from(LEVELS);
    (value / limit * steps).round().clamp(-steps, steps) as i32
}

/// The colour of a step of a signed value.
pub(super) fn signed_colour(level: i32) -> String {
    colour(&SIGNED, level)
}

/// The colour of a step of a height.
pub(super) fn height_colour(level: i32) -> String {
    colour(&HEIGHT, level)
}

fn colour(anchors: &[[f64; 3]; 9], level: i32) -> String {
    let place = f64::from(level + LEVELS) / f64::from(2 * LEVELS) * 8.0;
    let below = place.floor().clamp(0.0, 7.0);
    let anchor = |index: usize| anchors.get(index).copied().unwrap_or([0.0; 3]);
    let (from, to) = (anchor(below as usize), anchor(below as usize + 1));
    let [r, g, b] = [0, 1, 2].map(|i| {
        let part = |anchor: &[f64; 3]| anchor.get(i).copied().unwrap_or(0.0);
        (part(&from) + (part(&to) - part(&from)) * (place - below)).round() as u8
    });
    format!("#{r:02x}{g:02x}{b:02x}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_signed_scale_is_centred_and_saturates() {
        assert_eq!([-9.0, -1.0, 0.0, 0.04, 1.0, 9.0].map(|v| level(v, 1.0)), [-10, -10, 0, 0, 10, 10]);
        assert_eq!([-LEVELS, 0, LEVELS].map(signed_colour), ["#313695", "#fffacd", "#a50026"]);
        assert_eq!([-LEVELS, LEVELS].map(height_colour), ["#440154", "#fde725"]);
    }
}
