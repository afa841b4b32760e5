//! Properties of complete synthetic scans.

use super::*;
use crate::scan::Scan;

/// Hashes of the scans that these seeds gave before sensor errors, travel and export could be simulated.
const HASHES: [u64; 3] = [8_034_955_822_089_633_681, 11_329_538_513_555_370_381, 2_558_637_094_083_899_494];

fn points(scan: &Scan) -> impl Iterator<Item = [f64; 3]> + '_ {
    scan.stations().iter().flat_map(|station| scan.points_of(station))
}

/// FNV-1a of the coordinates in nanometres.
fn hash(scan: &Scan) -> u64 {
    let planes = scan.stations().iter().map(|station| station.x).chain(scan.blanks().iter().copied());
    let coordinates = points(scan).flatten().chain(planes);
    let bytes = coordinates.flat_map(|mm| ((mm * 1e6).round() as i64).to_le_bytes());
    bytes.fold(0xcbf2_9ce4_8422_2325, |hash, byte| (hash ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3))
}

/// All effects except sensor errors, travel and export.
fn crowded() -> Part {
    let bead = Bead { height_mm: 0.5, arc: 0.08, place: 0.3 };
    let base = Part::with_interference(7);
    let end = |x_mm| {
        let beyond = Some(Neighbour { gap_mm: 6.0, height_mm: -5.0 });
        Some(Edge { x_mm, chamfer_mm: 2.0, ragged_ratio: 0.2, ragged_mm: 3.0, beyond })
    };
    let clamp_shape = ClampShape::Round { radius_mm: 120.0 };
    let floor = Surroundings { floor: 0.3, floor_depth_mm: 150.0, ..Surroundings::default() };
    Part {
        profiles_count: 60,
        points_count: 80,
        view_deg: 12.0,
        sampling: Sampling::EvenAcross,
        spacing_spread: 0.6,
        noise_correlation: 0.7,
        jitter_sigma_mm: 0.03,
        interference: Interference { bead, shift: 0.1, clamp_shape, ..base.interference },
        surroundings: Surroundings { support: 0.2, supports: 0.5, support_radius_mm: 40.0, ..floor },
        drop_out_ratio: 0.1,
        spike_ratio: 0.03,
        edges: Edges { near: end(30.0), far: end(770.0) },
        ..base
    }
}

#[test]
fn a_seed_always_gives_the_same_scan() {
    let scans = [Part::smooth(1), Part::with_interference(3), crowded()].map(|part| make(&part).expect("a scan").0);
    assert_eq!(scans.map(|scan| hash(&scan)), HASHES);
}

#[test]
fn points_of_a_tilted_plane_lie_in_it_and_on_the_cylinder() {
    for (about_y_deg, about_z_deg) in [(3.0, 0.0), (0.0, -5.0), (10.0, 7.0)] {
        let laser_plane = LaserPlane { about_y_deg, about_z_deg };
        let [by_y, by_z] = [-about_z_deg.to_radians().tan(), about_y_deg.to_radians().tan()];
        let base = Part { laser_plane, profiles_count: 50, points_count: 100, ..Part::smooth(4) };
        for noise_sigma_mm in [0.0, 0.05] {
            let part = Part { noise_sigma_mm, ..base.clone() };
            let (scan, _) = make(&part).expect("a scan");
            let mut squares = 0.0;
            for station in scan.stations() {
                for [x, y, z] in scan.points_of(station) {
                    assert!((x - station.x - by_y * y - by_z * z).abs() < 1e-9);
                    squares += (part.axis.distance([x, y, z]) - part.radius_mm).powi(2);
                }
            }
            let rms = (squares / 5000.0).sqrt();
            // 5000 points determine the rms to 1 %; noise within the plane is up to 1/cos longer, below 3 % here.
            assert!((rms - noise_sigma_mm).abs() < 0.07 * noise_sigma_mm + 1e-9, "{rms}");
        }
    }
}

#[test]
fn clamps_and_ends_have_their_true_shape_in_a_tilted_plane() {
    let far = Edge { x_mm: 700.0, chamfer_mm: 3.0, ..Edge::default() };
    let laser_plane = LaserPlane { about_y_deg: 12.0, about_z_deg: -9.0 };
    let edges = Edges { near: None, far: Some(far) };
    let part = Part { noise_sigma_mm: 0.0, laser_plane, edges, ..Part::with_interference(2) };
    let part = Part { profiles_count: 200, points_count: 100, ..part };
    let (scan, _) = make(&part).expect("a scan");
    let direction = part.axis.direction();
    let [end_x, end_y, end_z] = far.centre(&part.axis);
    let mut on_chamfer = 0;
    for point in points(&scan) {
        let beyond =
            direction[0] * (point[0] - end_x) + direction[1] * (point[1] - end_y) + direction[2] * (point[2] - end_z);
        let off = part.axis.distance(point) - part.radius_mm;
        assert!(beyond < 1e-9);
        let is_on_chamfer = (off + beyond + 3.0).abs() < 1e-9 && off < 0.0;
        on_chamfer += usize::from(is_on_chamfer);
        // The line of sight deviates by up to 20° from perpendicular to the axis: a height of 25 mm along it is at least 23.4 mm
        // perpendicular to it.
        let is_known = |height: f64| (off / height) > 0.93 && (off / height) < 1.0 + 1e-9;
        assert!(is_on_chamfer || off.abs() < 1e-9 || [25.0, -10.0, -20.0, -30.0].into_iter().any(is_known), "{off}");
    }
    assert!(on_chamfer > 50, "{on_chamfer}");
}

#[test]
fn the_inside_of_a_pipe_opens_towards_the_sensor() {
    let outside = Part { noise_sigma_mm: 0.0, profiles_count: 30, ..Part::with_interference(2) };
    for sampling in [Sampling::EvenAngle, Sampling::EvenAcross] {
        let part = Part { side: Side::Inside, sampling, view_deg: 10.0, ..outside.clone() };
        let (scan, truth) = make(&part).expect("a scan");
        for [x, y, z] in points(&scan) {
            let [axis_y, axis_z] = part.axis.at(x);
            // The direction towards the sensor is 10° from +Z towards +Y: the surface lies opposite to it, within 70°.
            let facing = -((y - axis_y) * 10f64.to_radians().sin() + (z - axis_z) * 10f64.to_radians().cos());
            assert!(facing > 0.34 * 150.0);
            let off = part.axis.distance([x, y, z]) - part.radius_mm;
            let is_known = |height: f64| (off - height).abs() < 0.01;
            assert!([0.0, -25.0, 10.0, 20.0, 30.0].into_iter().any(is_known), "{off}");
        }
        assert!(truth.inner_ratio_per_profile.contains(&1.0));
    }
}

#[test]
fn a_full_circle_is_covered_completely() {
    let part = Part { arc_deg: 360.0, points_count: 360, profiles_count: 10, noise_sigma_mm: 0.0, ..Part::smooth(1) };
    let (scan, _) = make(&part).expect("a scan");
    for station in scan.stations() {
        let [axis_y, axis_z] = part.axis.at(station.x);
        let mut angles: Vec<f64> =
            scan.points_of(station).map(|[_, y, z]| (y - axis_y).atan2(z - axis_z).to_degrees()).collect();
        angles.sort_by(f64::total_cmp);
        assert!(angles.windows(2).all(|pair| (pair[1] - pair[0] - 1.0).abs() < 1e-9));
    }
}

#[test]
fn enabling_an_effect_does_not_change_the_noise_of_the_points() {
    let plain = make(&Part { profiles_count: 20, ..Part::smooth(1) }).expect("a scan").0;
    let reflections = Reflections { ratio: 0.1, offset_mm: 5.0 };
    let sensor = SensorErrors { reflections, ..SensorErrors::default() };
    let part = Part { profiles_count: 20, sensor, ..Part::smooth(1) };
    let reflected = make(&part).expect("a scan").0;
    let same_count = points(&plain).zip(points(&reflected)).filter(|(a, b)| a == b).count();
    // 12 800 draws of 0.9 scatter by 34.
    assert!((11_384..11_656).contains(&same_count), "{same_count}");
}

#[test]
fn parts_in_a_row_keep_the_x_of_their_points() {
    let travel = Travel { encoder_sigma_mm: 0.01, ..Travel::default() };
    let first = Part { profiles_count: 10, points_count: 20, ..Part::smooth(1) };
    let second = Part { travel, x_start_mm: 900.0, ..first };
    let (both, _) = make_several(&[first.clone(), second.clone()]).expect("a scan");
    let alone: Vec<_> =
        [first, second].iter().flat_map(|part| points(&make(part).expect("a scan").0).collect::<Vec<_>>()).collect();
    assert_eq!(points(&both).collect::<Vec<_>>(), alone);
}
