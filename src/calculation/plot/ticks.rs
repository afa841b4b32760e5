//! Ranges of values and the round numbers that are written beside them.

/// Values from `lo` to `hi`, always finite and `lo` < `hi`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Range {
    pub(super) lo: f64,
    pub(super) hi: f64,
}

/// Beyond this nothing is drawn to scale: sums and products stay finite below it.
const LARGEST: f64 = 1e100;

impl Range {
    /// From one value to another. Where they are too near to one another for their size, as far as needed around them.
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

    /// The smallest range that holds all values; about 0 where there is none.
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
        // Rounding down turns this into 0.6 to 1.5 times `count`.
        let step = round_step(self.width() / (0.6 * count.max(1.5)));
        let (first, last) = ((self.lo / step).ceil(), (self.hi / step).floor());
        let values: Vec<f64> =
            (0..40).map(|i| first + f64::from(i)).take_while(|&n| n <= last).map(|n| n * step).collect();
        Ticks::new(values, step)
    }
}

/// 1, 2 or 5 times a power of ten, not above `most` by more than rounding.
fn round_step(most: f64) -> f64 {
    let decade = 10f64.powf((most * 1.001).log10().floor());
    [5.0, 2.0, 1.0].map(|n| n * decade).into_iter().find(|&step| step <= most * 1.001).unwrap_or(decade)
}

/// Round numbers on an axis and how they are written.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Ticks {
    pub(super) values: Vec<f64>,
    /// What has to be added to every label: not 0 where the numbers would be too long to be told apart.
    base: f64,
    decimals: usize,
    scientific: bool,
}

impl Ticks {
    fn new(values: Vec<f64>, step: f64) -> Self {
        let decimals = (-step.log10() - 1e-9).ceil().max(0.0) as usize;
        let largest = values.iter().fold(0.0, |size: f64, v| size.max(v.abs()));
        let digits = largest.max(1.0).log10().floor() as usize + 1;
        // What fits beside an axis: seven characters with sign and point.
        let long = largest > 20.0 * step && digits + decimals > 5;
        let base = if long { values.get(values.len() / 2).copied().unwrap_or(0.0) } else { 0.0 };
        Self { values, base, decimals, scientific: decimals > 6 || step >= 1e5 }
    }

    /// The axis label, with the base that is subtracted where there is one: `y − 1200 (mm)`.
    pub(super) fn with_base(&self, label: &str) -> String {
        if self.base == 0.0 {
            return label.to_owned();
        }
        let (quantity, unit) = label.split_at(label.rfind(" (").unwrap_or(label.len()));
        let sign = if self.base < 0.0 { '+' } else { '\u{2212}' };
        format!("{quantity} {sign} {}{unit}", fixed(self.base.abs(), self.decimals))
    }

    /// What is written at `value`.
    pub(super) fn label(&self, value: f64) -> String {
        let shown = value - self.base;
        if self.scientific { typographic(&format!("{shown:.1e}")) } else { fixed(shown, self.decimals) }
    }
}

/// A number with so many decimals, a true minus sign and never a negative zero.
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

#[cfg(test)]
mod tests {
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
