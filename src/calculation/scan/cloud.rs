//! The content of a scan file before its points are grouped into profiles, the unit of length of the file, and the steps of the
//! lattice of its coordinates. All coordinates become millimetres while the points are collected.

use super::columns::Columns;
use serde::{Deserialize, Serialize};
use std::fmt;

/// Successive points of a file that share a label and an x: a laser line, or a piece of it.
///
/// Run-length coding removes the repeated x of organised files, and costs nothing if there are no runs.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Stripe {
    /// Value of the profile column, or number of the row; 0 without either.
    pub label: f64,
    /// Common x, mm.
    pub x: f64,
    /// Index after the stripe's last point; the stripe starts at the end of the previous one.
    pub end: usize,
}

/// The kind of the labels of the stripes.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Labels {
    /// The file has no labels of profiles.
    None,
    /// The number of a row of organised data.
    Row,
    /// The value of the column of this name.
    Column(String),
}

/// The points of a file, in the order of the file, finite and in millimetres.
#[derive(Debug, Clone, PartialEq)]
pub struct Cloud {
    /// Runs of points that share a label and an x.
    pub stripes: Vec<Stripe>,
    /// y and z of every point.
    pub columns: Columns,
    /// The kind of the labels.
    pub labels: Labels,
    /// The unit of the file's coordinates.
    pub unit: Unit,
    /// Planes of rows or profiles without a valid point, as far as the file states their x, mm.
    pub blanks: Vec<f64>,
    /// Points that the file marks as missing (NaN, infinite, empty cell); no column contains them.
    pub missing_count: u64,
}

impl Cloud {
    /// The points in the order of the file, mm.
    pub fn points(&self) -> impl Iterator<Item = [f64; 3]> + '_ {
        let mut start = 0;
        self.stripes.iter().flat_map(move |stripe| {
            let range = std::mem::replace(&mut start, stripe.end)..stripe.end;
            range.filter_map(move |index| self.columns.get(index).map(|[y, z]| [stripe.x, y, z]))
        })
    }
}

/// The unit of a file's coordinates.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum Unit {
    /// `mm`
    #[serde(rename = "mm")]
    Millimetre,
    /// `m`
    #[serde(rename = "m")]
    Metre,
    /// `um`
    #[serde(rename = "um")]
    Micrometre,
    /// `inch`
    #[serde(rename = "inch")]
    Inch,
}

impl Unit {
    /// Every unit, in the order in which messages list them.
    pub const ALL: [Self; 4] = [Self::Millimetre, Self::Metre, Self::Micrometre, Self::Inch];

    /// The name used in requests and results.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Millimetre => "mm",
            Self::Metre => "m",
            Self::Micrometre => "um",
            Self::Inch => "inch",
        }
    }

    /// The unit of a name, irrespective of case; also `µm`, `in` and the full names.
    #[must_use]
    pub fn from_name(name: &str) -> Option<Self> {
        match name.trim().to_lowercase().as_str() {
            "mm" | "millimetre" | "millimetres" | "millimeter" | "millimeters" => Some(Self::Millimetre),
            "m" | "metre" | "metres" | "meter" | "meters" => Some(Self::Metre),
            // The micro sign and the Greek letter look alike.
            "um" | "\u{b5}m" | "\u{3bc}m" | "micrometre" | "micrometres" | "micrometer" | "micrometers" | "micron"
            | "microns" => Some(Self::Micrometre),
            "in" | "in." | "inch" | "inches" | "zoll" | "\"" | "''" | "\u{2033}" | "\u{201d}" => Some(Self::Inch),
            _ => None,
        }
    }

    /// Millimetres in one of this unit.
    #[must_use]
    pub fn in_mm(self) -> f64 {
        match self {
            Self::Millimetre => 1.0,
            Self::Metre => 1000.0,
            Self::Micrometre => 0.001,
            Self::Inch => 25.4,
        }
    }
}

impl fmt::Display for Unit {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// Points that are examined.
const POINTS_MAX: usize = 4096;
/// A value is on the lattice if its distance from it is at most this share of a step: the rounding to the decimals of a file is
/// smaller.
const OFF_MAX: f64 = 1e-2;
/// Least share of the gaps between neighbouring values that are multiples of the smallest one. Of random gaps one in fifty is, by
/// [`OFF_MAX`] on either side.
const ON_LATTICE: f64 = 0.9;

/// The step of x, y and z, mm; 0 for a coordinate whose values lie on no lattice.
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
    // Differences of values in single precision are accurate to its rounding.
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
    fn every_unit_is_found_by_its_name_and_stored_by_it() {
        for unit in Unit::ALL {
            assert_eq!(Unit::from_name(unit.name()), Some(unit));
            assert_eq!(serde_json::to_value(unit).expect("writes"), unit.name());
        }
        assert_eq!(Unit::from_name(" \u{b5}m"), Some(Unit::Micrometre));
        assert_eq!(Unit::from_name("furlong"), None);
    }
}

#[cfg(test)]
mod lattice_tests {
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
