//! Effects of a sensor's software on the points that it writes: rounding, and numbers that mark "no return".

use super::noise::Stream;
use crate::scan::columns::Columns;
use crate::scan::{Scan, ScanError, Station};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

/// The format in which points are written; unchanged by default.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Export {
    /// The lattice of the coordinates.
    pub steps: Steps,
    /// The number for "no return", if points without a return are written.
    pub sentinel: Option<Sentinel>,
}

/// Coordinates are rounded to multiples of these; 0 keeps them.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Steps {
    /// Step of x.
    pub x_mm: f64,
    /// Step of y.
    pub y_mm: f64,
    /// Step of z.
    pub z_mm: f64,
}

/// A number that marks points without a return.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sentinel {
    /// The number.
    pub value_mm: f64,
    /// Share of the points that are replaced by it.
    pub ratio: f64,
    /// The points that are replaced.
    pub place: SentinelPlace,
    /// The coordinates in which it is written.
    pub coordinates: Coordinates,
}

/// Which points of a profile have no return.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum SentinelPlace {
    /// Any point, independently of each other.
    #[default]
    Random,
    /// The first and the last points of every profile, half of them at either end.
    Edges,
}

/// The coordinates in which a sentinel is written.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Coordinates {
    /// z; x and y remain.
    #[default]
    Z,
    /// y and z.
    YZ,
    /// All three.
    XYZ,
}

impl Steps {
    fn round(&self, [x, y, z]: [f64; 3]) -> [f64; 3] {
        [multiple(x, self.x_mm), multiple(y, self.y_mm), multiple(z, self.z_mm)]
    }

    fn round_x(&self, x: f64) -> f64 {
        let [x, ..] = self.round([x, 0.0, 0.0]);
        x
    }
}

/// The nearest multiple of a step, equal to the number parsed from text with that many decimals: 17·0.01 is 0.17 and not
/// 0.17000000000000001.
fn multiple(value: f64, step: f64) -> f64 {
    if step <= 0.0 {
        return value;
    }
    let (steps, per_mm) = ((value / step).round(), (1.0 / step).round());
    if (per_mm * step - 1.0).abs() < 1e-12 { steps / per_mm } else { steps * step }
}

impl Sentinel {
    /// Whether the point at `index` of a profile of `count` points has no return.
    fn replaces(&self, index: usize, count: usize, chance: &mut ChaCha8Rng) -> bool {
        let ratio = self.ratio.clamp(0.0, 1.0);
        match self.place {
            SentinelPlace::Random => chance.random_bool(ratio),
            SentinelPlace::Edges => {
                let all = (ratio * count as f64).round() as usize;
                index < all / 2 || index >= count.saturating_sub(all - all / 2)
            }
        }
    }

    fn written(&self, [x, y, _]: [f64; 3]) -> [f64; 3] {
        let value = self.value_mm;
        match self.coordinates {
            Coordinates::Z => [x, y, value],
            Coordinates::YZ => [x, value, value],
            Coordinates::XYZ => [value; 3],
        }
    }
}

impl Export {
    /// The scan as it is written. The x of the profiles is rounded as well, but never replaced by a sentinel.
    ///
    /// # Errors
    /// [`ScanError::NotFinite`] if the sentinel is not finite.
    pub fn apply(&self, scan: Scan, seed: u64) -> Result<Scan, ScanError> {
        if *self == Self::default() {
            return Ok(scan);
        }
        let mut chance = Stream::Export.of(seed);
        let writes_x = self.sentinel.is_some_and(|sentinel| sentinel.coordinates == Coordinates::XYZ);
        let has_own_x = writes_x || !scan.is_planar();
        let (mut stations, mut own_x, mut ys, mut zs) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
        for station in scan.stations() {
            let (start, count) = (ys.len(), station.end - station.start);
            for (index, point) in scan.points_of(station).enumerate() {
                let rounded = self.steps.round(point);
                let sentinel = self.sentinel.filter(|sentinel| sentinel.replaces(index, count, &mut chance));
                let [x, y, z] = sentinel.map_or(rounded, |sentinel| sentinel.written(rounded));
                if has_own_x {
                    own_x.push(x);
                }
                ys.push(y);
                zs.push(z);
            }
            stations.push(Station { x: self.steps.round_x(station.x), start, end: ys.len() });
        }
        let blanks = scan.blanks().iter().map(|x| self.steps.round_x(*x)).collect();
        let written = Scan::new(stations, Columns::F64 { y: ys, z: zs }, scan.rule().to_owned())?;
        let written = written.with_blanks(blanks).with_grouping(scan.grouping());
        if has_own_x { written.with_own_x(own_x) } else { Ok(written) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scan::synthetic::{LaserPlane, Part, make};

    fn scanned(export: Export, laser_plane: LaserPlane) -> Vec<Vec<[f64; 3]>> {
        let part = Part { profiles_count: 100, points_count: 200, export, laser_plane, ..Part::smooth(1) };
        let (scan, _) = make(&part).expect("a scan");
        scan.stations().iter().map(|station| scan.points_of(station).collect()).collect()
    }

    #[test]
    fn rounded_coordinates_are_multiples_of_their_steps() {
        let steps = Steps { x_mm: 0.3, y_mm: 0.01, z_mm: 0.004 };
        for tilt in [0.0, 4.0] {
            let plane = LaserPlane { about_y_deg: tilt, about_z_deg: 0.0 };
            let plain = scanned(Export::default(), plane);
            let rounded = scanned(Export { steps, sentinel: None }, plane);
            for (plain, rounded) in plain.iter().flatten().zip(rounded.iter().flatten()) {
                for (i, step) in [0.3, 0.01, 0.004].into_iter().enumerate() {
                    let steps = rounded[i] / step;
                    assert!((steps - steps.round()).abs() < 1e-9, "{steps}");
                    assert!((rounded[i] - plain[i]).abs() <= 0.5 * step + 1e-9);
                }
            }
        }
    }

    #[test]
    fn decimal_steps_give_decimals() {
        let texts = [(-191.671, 0.01), (12.3, 0.25), (7.0, 0.3), (0.123_45, 0.001)]
            .map(|(v, step)| multiple(v, step).to_string());
        assert_eq!(texts, ["-191.67", "12.25", "6.8999999999999995", "0.123"]);
    }

    #[test]
    fn sentinels_replace_their_share_in_the_selected_points_and_coordinates() {
        let plain = scanned(Export::default(), LaserPlane::default());
        for place in [SentinelPlace::Random, SentinelPlace::Edges] {
            for coordinates in [Coordinates::Z, Coordinates::YZ, Coordinates::XYZ] {
                let sentinel = Sentinel { value_mm: -9999.0, ratio: 0.15, place, coordinates };
                let written = scanned(Export { sentinel: Some(sentinel), ..Export::default() }, LaserPlane::default());
                let kept = [[true, true], [true, false], [false, false]][coordinates as usize];
                let mut count = 0;
                for (plain, written) in plain.iter().zip(&written) {
                    for (index, (plain, written)) in plain.iter().zip(written).enumerate() {
                        if written[2] != -9999.0 {
                            assert_eq!(plain, written);
                            continue;
                        }
                        count += 1;
                        for (i, kept) in kept.into_iter().enumerate() {
                            assert_eq!(written[i], if kept { plain[i] } else { -9999.0 });
                        }
                        assert!(place == SentinelPlace::Random || !(15..185).contains(&index), "{index}");
                    }
                }
                // 20 000 draws of 0.15 scatter by 50.5; at the edges it is 30 of every 200.
                let reach = if place == SentinelPlace::Edges { 0.0 } else { 4.0 * 50.5 };
                assert!((f64::from(count) - 3000.0).abs() <= reach, "{count}");
            }
        }
    }
}
