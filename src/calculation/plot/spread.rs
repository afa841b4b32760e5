//! Robust statistics of a few thousand numbers, to choose the scale of a picture.

/// The value below which the share `part` (0 to 1) of the values lies; reorders them. `None` where there are none.
pub(super) fn quantile(values: &mut [f64], part: f64) -> Option<f64> {
    let last = values.len().checked_sub(1)?;
    let index = (part * last as f64).round().clamp(0.0, last as f64) as usize;
    Some(*values.select_nth_unstable_by(index, f64::total_cmp).1)
}

/// The middle value, or the mean of the two middle ones: taking one of them would shift signed values to one side.
pub(super) fn median(values: &mut [f64]) -> Option<f64> {
    let is_even = values.len().is_multiple_of(2);
    let (below, middle, _) =
        values.select_nth_unstable_by(values.len().checked_sub(1)? / 2 + usize::from(is_even), f64::total_cmp);
    let other = if is_even { below.iter().copied().max_by(f64::total_cmp)? } else { *middle };
    Some(other + (*middle - other) / 2.0)
}

/// The half-width that shows the values about 0 as large as it can: the largest of them, or, where a few lie far out,
/// six times the robust spread 1.4826·median|v|. At least `least`.
pub(super) fn half_width(values: impl Iterator<Item = f64>, least: f64) -> f64 {
    let mut sizes: Vec<f64> = values.map(f64::abs).filter(|v| v.is_finite()).collect();
    let largest = sizes.iter().copied().fold(0.0, f64::max);
    let spread = 1.4826 * quantile(&mut sizes, 0.5).unwrap_or(0.0);
    // Without the second term two or three exact values would send all others off the scale.
    let shown = largest.min((6.0 * spread).max(quantile(&mut sizes, 0.9).unwrap_or(0.0)));
    (1.15 * shown).max(least)
}

/// The next of 1, 1.5, 2, 3, 5, 7.5 times a power of ten that is not below `value` (> 0).
pub(super) fn round_up(value: f64) -> f64 {
    let decade = 10f64.powf(value.log10().floor());
    let steps = [1.0, 1.5, 2.0, 3.0, 5.0, 7.5, 10.0];
    steps.map(|step| step * decade).into_iter().find(|&step| step >= value * (1.0 - 1e-9)).unwrap_or(value)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_few_far_values_do_not_set_the_scale() {
        let near = (0..100).map(|i| 0.01 * f64::from(i % 10));
        let width = half_width(near.chain([40.0, -55.0]), 0.0);
        assert!((0.09..1.0).contains(&width), "{width}");
        assert_eq!(half_width([0.0, 1e-15].into_iter(), 1e-3), 1e-3);
        assert_eq!(half_width(std::iter::empty(), 1e-3), 1e-3);
    }

    #[test]
    fn the_median_of_symmetric_values_is_their_middle() {
        let medians = [vec![3.0, -1.0, 1.0], vec![1.0, -1.0], vec![2.0, 9.0, 0.0, -7.0]].map(|mut v| median(&mut v));
        assert_eq!(medians, [Some(1.0), Some(0.0), Some(1.0)]);
        assert_eq!(median(&mut []), None);
    }

    #[test]
    fn rounding_up_gives_a_readable_number() {
        assert_eq!([0.011, 0.2, 3.2, 76.0].map(round_up), [0.015, 0.2, 5.0, 100.0]);
    }
}
