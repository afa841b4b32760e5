//! The steps of the coordinates of a cloud whose values lie on a lattice.

use super::cloud::Cloud;

/// Points that are looked at.
const POINTS_MAX: usize = 4096;
/// A value is on the lattice where it is no farther from it than this share of a step: the decimals of a file round to less.
const OFF_MAX: f64 = 1e-2;
/// Shares of the gaps between neighbouring values that are whole multiples of the least one. Of gaps of any length one in fifty
/// is, by [`OFF_MAX`] on either side.
const ON_LATTICE: f64 = 0.9;

/// The step of x, y and z, mm; 0 where the values of a coordinate lie on no lattice.
pub(super) fn steps(cloud: &Cloud) -> [f64; 3] {
    let count = cloud.columns.len();
    let stride = count.div_ceil(POINTS_MAX).max(1);
    let (mut xs, mut ys, mut zs) = (Vec::new(), Vec::new(), Vec::new());
    let mut stripes = cloud.stripes.iter().peekable();
    for index in (0..count).step_by(stride) {
        while stripes.next_if(|stripe| stripe.end <= index).is_some() {}
        if let (Some(stripe), Some([y, z])) = (stripes.peek(), cloud.columns.get(index)) {
            xs.push(stripe.x);
            ys.push(y);
            zs.push(z);
        }
    }
    [xs, ys, zs].map(step)
}

fn step(mut values: Vec<f64>) -> f64 {
    values.sort_unstable_by(f64::total_cmp);
    values.dedup();
    let largest = values.iter().fold(0.0, |most: f64, v| most.max(v.abs()));
    // Differences of values in single precision are known to its rounding.
    let rounding = largest * f64::from(f32::EPSILON);
    let gaps: Vec<f64> = values.windows(2).filter_map(|pair| Some(pair.last()? - pair.first()?)).collect();
    let gaps: Vec<f64> = gaps.into_iter().filter(|gap| *gap > rounding).collect();
    let least = gaps.iter().copied().fold(f64::INFINITY, f64::min);
    let on_lattice = |gap: &&f64| {
        let steps = **gap / least;
        (steps - steps.round()).abs() <= OFF_MAX + rounding / least
    };
    let share = gaps.iter().filter(on_lattice).count() as f64 / gaps.len().max(1) as f64;
    if gaps.len() >= 2 && OFF_MAX * least > rounding && share >= ON_LATTICE { least } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_lattice_has_its_step_and_other_values_have_none() {
        let noisy = |i: i32| 50.0 * (f64::from(i) * 0.7).sin();
        let rounded = |to: f64| (0..500).map(|i| (noisy(i) / to).round() * to).collect::<Vec<f64>>();
        assert_eq!(step((0..500).map(noisy).collect()), 0.0);
        for to in [0.001, 0.25, 15.625] {
            let found = step(rounded(to));
            assert!((found - to).abs() < 1e-9, "{to} {found}");
        }
        assert_eq!(step(vec![3.0; 10]), 0.0);
    }
}
