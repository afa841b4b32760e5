//! The colours, all from palettes that the colour-blind can tell apart: Okabe and Ito's for kinds, ColorBrewer's RdYlBu
//! for signed values. Where a colour means a kind, a shape means it too. Must not know pictures.

use crate::estimation::Reason;

/// Text and frames.
pub(super) const INK: &str = "#222222";
/// Text that may be overlooked.
pub(super) const FAINT_INK: &str = "#5a5a5a";
/// Grid lines.
pub(super) const GRID: &str = "#e3e3e3";
/// Valid profiles and inner points.
pub(super) const VALID: &str = "#0072b2";
/// Points of rejected profiles.
pub(super) const REJECTED: &str = "#e69f00";
/// What was fitted.
pub(super) const FITTED: &str = "#000000";
/// Inner points by weight: below 0.25, up to 0.75, above.
pub(super) const INNER: [&str; 3] = ["#9cc9ea", "#4a9bd1", VALID];
/// Outer points that still have a weight.
pub(super) const OUTER: &str = "#e69f00";
/// Outer points without any weight.
pub(super) const EXCLUDED: &str = "#d55e00";
/// The band of the inner points.
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

/// Steps of the signed scale on either side of the middle one.
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

/// The step of a value whose scale saturates at ±`limit`: −[`LEVELS`] to [`LEVELS`], 0 in the middle.
pub(super) fn level(value: f64, limit: f64) -> i32 {
    let steps = f64::from(LEVELS);
    (value / limit * steps).round().clamp(-steps, steps) as i32
}

/// The colour of a step.
pub(super) fn level_colour(level: i32) -> String {
    let place = f64::from(level + LEVELS) / f64::from(2 * LEVELS) * 8.0;
    let below = place.floor().clamp(0.0, 7.0);
    let anchor = |index: usize| SIGNED.get(index).copied().unwrap_or([0.0; 3]);
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
        assert_eq!([-LEVELS, 0, LEVELS].map(level_colour), ["#313695", "#fffacd", "#a50026"]);
    }
}
