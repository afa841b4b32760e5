//! The scale of a picture: ranges of values, the round numbers beside them, and robust statistics by which a range is chosen.

/// Values from `lo` to `hi`, always finite and `lo` < `hi`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Range {
    pub(super) lo: f64,
    pub(super) hi: f64,
}

/// Largest value that is drawn to scale: sums and products stay finite below it.
const LARGEST: f64 = 1e100;

impl Range {
    /// From one value to another, widened if they are too near to each other for their size.
    pub(super) fn new(lo: f64, hi: f64) -> Self {
        let sane = |v: f64| if v.is_nan() { 0.0 } else { v.clamp(-LARGEST, LARGEST) };
        let (lo, hi) = (sane(lo.min(hi)), sane(lo.max(hi)));
        let least = (lo.abs().max(hi.abs()) * 1e-11).max(1e-9);
        if hi - lo >= least {
            return Self { lo, hi };
        }
        let half = if lo == hi { (lo.abs() * 1e-9).max(1.0) } else { least };
        Self { lo: lo - half, hi: hi + half }
    }

    /// The smallest range that contains all values; about 0 if there are none.
    pub(super) fn around(values: impl Iterator<Item = f64>) -> Self {
        let (lo, hi) = values
            .filter(|v| v.is_finite())
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(lo, hi), v| (v.min(lo), v.max(hi)));
        if lo <= hi { Self::new(lo, hi) } else { Self::new(0.0, 0.0) }
    }

    /// From −`half` to `half`.
    pub(super) fn about_zero(half: f64) -> Self {
        Self::new(-half, half)
    }

    /// Wider by the share `part` of its width on either side.
    pub(super) fn padded(self, part: f64) -> Self {
        let more = self.width() * part;
        Self::new(self.lo - more, self.hi + more)
    }

    pub(super) fn width(&self) -> f64 {
        self.hi - self.lo
    }

    pub(super) fn middle(&self) -> f64 {
        self.lo + self.width() / 2.0
    }

    pub(super) fn contains(&self, value: f64) -> bool {
        (self.lo..=self.hi).contains(&value)
    }

    /// About `count` round numbers inside.
    pub(super) fn ticks(&self, count: f64) -> Ticks {
        // Rounding down gives 0.6 to 1.5 times `count`.
        let step = round_step(self.width() / (0.6 * count.max(1.5)));
        let (first, last) = ((self.lo / step).ceil(), (self.hi / step).floor());
        let values: Vec<f64> =
            (0..40).map(|i| first + f64::from(i)).take_while(|&n| n <= last).map(|n| n * step).collect();
        Ticks::new(values, step)
    }
}

/// 1, 2 or 5 times a power of ten, at most `most` within rounding.
fn round_step(most: f64) -> f64 {
    let decade = 10f64.powf((most * 1.001).log10().floor());
    [5.0, 2.0, 1.0].map(|n| n * decade).into_iter().find(|&step| step <= most * 1.001).unwrap_or(decade)
}

/// Round numbers on an axis and how they are written.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Ticks {
    pub(super) values: Vec<f64>,
    /// The offset that has to be added to every label: not 0 if the numbers would otherwise be too long to be distinguished.
    base: f64,
    decimals: usize,
    scientific: bool,
}

impl Ticks {
    fn new(values: Vec<f64>, step: f64) -> Self {
        let decimals = (-step.log10() - 1e-9).ceil().max(0.0) as usize;
        let largest = values.iter().fold(0.0, |size: f64, v| size.max(v.abs()));
        let digits = largest.max(1.0).log10().floor() as usize + 1;
        // The space beside an axis: seven characters with sign and point.
        let long = largest > 20.0 * step && digits + decimals > 5;
        let base = if long { values.get(values.len() / 2).copied().unwrap_or(0.0) } else { 0.0 };
        Self { values, base, decimals, scientific: decimals > 6 || step >= 1e5 }
    }

    /// The axis label with the base that is subtracted, if there is one: `y − 1200 (mm)`.
    pub(super) fn with_base(&self, label: &str) -> String {
        if self.base == 0.0 {
            return label.to_owned();
        }
        let (quantity, unit) = label.split_at(label.rfind(" (").unwrap_or(label.len()));
        let sign = if self.base < 0.0 { '+' } else { '\u{2212}' };
        format!("{quantity} {sign} {}{unit}", fixed(self.base.abs(), self.decimals))
    }

    /// The label at `value`.
    pub(super) fn label(&self, value: f64) -> String {
        let shown = value - self.base;
        if self.scientific { typographic(&format!("{shown:.1e}")) } else { fixed(shown, self.decimals) }
    }
}

/// A number with this many decimals, a true minus sign and never a negative zero.
pub(super) fn fixed(value: f64, decimals: usize) -> String {
    if !value.is_finite() {
        return "?".to_owned();
    }
    if value.abs() >= 1e12 {
        return typographic(&format!("{value:.4e}"));
    }
    let text = format!("{value:.decimals$}");
    let zero = text.trim_start_matches('-').chars().all(|c| matches!(c, '0' | '.'));
    typographic(if zero { text.trim_start_matches('-') } else { &text })
}

fn typographic(text: &str) -> String {
    text.replace('-', "\u{2212}")
}

/// The quantile of the values at the share `part` (0 to 1); reorders them. `None` without values.
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

/// The half-width that shows the values about 0 as large as possible: the largest of them or, if a few lie far out, six times the
/// robust spread 1.4826·median|v|. At least `least`.
pub(super) fn half_width(values: impl Iterator<Item = f64>, least: f64) -> f64 {
    let mut sizes: Vec<f64> = values.map(f64::abs).filter(|v| v.is_finite()).collect();
    let largest = sizes.iter().copied().fold(0.0, f64::max);
    let spread = 1.4826 * quantile(&mut sizes, 0.5).unwrap_or(0.0);
    // Without the second term two or three exact values would put all others off the scale.
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
mod ticks_tests {
    use super::*;

    fn labels(lo: f64, hi: f64) -> Vec<String> {
        let ticks = Range::new(lo, hi).ticks(5.0);
        ticks.values.iter().map(|&v| ticks.label(v)).collect()
    }

    #[test]
    fn ticks_are_round_numbers_inside_the_range() {
        assert_eq!(labels(-3.0, 412.0), ["0", "100", "200", "300", "400"]);
        assert_eq!(labels(-0.05, 0.05), ["−0.04", "−0.02", "0.00", "0.02", "0.04"]);
    }

    #[test]
    fn long_numbers_are_written_from_a_base() {
        let ticks = Range::new(12_345_678.0, 12_345_678.5).ticks(5.0);
        assert!(ticks.base > 12_345_677.0);
        assert!(ticks.values.iter().all(|&v| ticks.label(v).chars().count() <= 5));
    }

    #[test]
    fn a_label_states_what_is_subtracted() {
        let label = |middle: f64| Range::new(middle - 0.25, middle + 0.25).ticks(5.0).with_base("y (mm)");
        assert_eq!([7.0, 12_345.0, -12_345.0].map(label), ["y (mm)", "y − 12345.0 (mm)", "y + 12345.0 (mm)"]);
    }

    #[test]
    fn a_range_is_never_empty_or_infinite() {
        for (lo, hi) in [(0.0, 0.0), (1e9, 1e9), (5.0, 5.0 + 1e-15), (f64::NAN, 1.0), (-f64::MAX, f64::MAX)] {
            let range = Range::new(lo, hi);
            assert!(range.lo < range.hi && range.width().is_finite(), "{range:?}");
            let ticks = range.ticks(5.0);
            assert!((1..40).contains(&ticks.values.len()), "{range:?} {ticks:?}");
            assert!(ticks.values.iter().all(|&v| range.padded(1e-9).contains(v)), "{range:?} {ticks:?}");
        }
        assert!(Range::around(std::iter::empty()).width() > 0.0);
    }

    #[test]
    fn numbers_have_no_negative_zero() {
        assert_eq!([-0.0004, -1.5, f64::NAN].map(|v| fixed(v, 2)), ["0.00", "−1.50", "?"]);
    }
}

#[cfg(test)]
mod spread_tests {
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
