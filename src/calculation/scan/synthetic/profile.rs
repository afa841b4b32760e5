//! One profile of a synthetic part by itself, for a sensor that passes along it.

use super::acquire::{Seen, thrown};
use super::laser_plane::LaserPlane;
use super::noise::Noise;
use super::{BLOCKS_COUNT, Part};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

/// The points (y, z) of the section of `part` by the plane at `x`, mm; those that dropped out, or that meet nothing, are
/// left out. `along` is how far the plane is along the part, 0 at its near end to 1, and decides what sits there; the
/// part's own number of profiles, their planes, its surroundings, the tilt of the laser plane, the travel and the export do not
/// matter.
#[must_use]
pub fn make_profile(part: &Part, x: f64, along: f64, chance: &mut ChaCha8Rng) -> Vec<[f64; 2]> {
    let edges = part.edges.prepare(part);
    let feature = part.interference.feature((along * BLOCKS_COUNT as f64).rem_euclid(1.0));
    let mut noise = Noise::begin(part, chance);
    let mut points = Vec::with_capacity(part.points_count);
    for column in 0..part.points_count {
        if chance.random_bool(part.drop_out_ratio.clamp(0.0, 1.0)) {
            continue;
        }
        let seen = Seen::OnPart(column);
        let thrown = thrown(part, chance) + seen.reflected(part, chance);
        let Some(place) = seen.place(part, &edges, (x, LaserPlane::default()), feature, thrown) else { continue };
        points.push(place.measured(part, noise.next(chance)));
    }
    points
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scan::synthetic::make;
    use rand::SeedableRng;

    #[test]
    fn without_noise_it_is_the_profile_of_the_whole_scan() {
        let part = Part { noise_sigma_mm: 0.0, ..Part::with_interference(3) };
        let (scan, _) = make(&part).expect("a scan");
        let (mut y, mut z) = (Vec::new(), Vec::new());
        for index in [0, 60, 100, 133, 250, 399] {
            let station = scan.stations()[index];
            scan.load(station, &mut y, &mut z);
            let along = index as f64 / part.profiles_count as f64;
            let points = make_profile(&part, station.x, along, &mut ChaCha8Rng::seed_from_u64(1));
            assert_eq!(points, y.iter().zip(&z).map(|(y, z)| [*y, *z]).collect::<Vec<_>>(), "{index}");
        }
    }

    #[test]
    fn beyond_the_end_nothing_is_seen() {
        let far = Some(crate::scan::synthetic::Edge { x_mm: 800.0, ..Default::default() });
        let mut part = Part::smooth(3);
        part.edges.far = far;
        let seen = |x: f64| make_profile(&part, x, 0.99, &mut ChaCha8Rng::seed_from_u64(1)).len();
        // Tilted by about a degree, the end plane spreads over 800 ± 4 mm.
        assert_eq!((seen(795.0), seen(805.0)), (640, 0));
    }
}
