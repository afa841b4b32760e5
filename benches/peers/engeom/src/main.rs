//! engeom's robust cylinder (MAGSAC++) as a program with the protocol of `protocol.py`.
//!
//! ```text
//! engeom_peer sample|again SCAN.npy HINTS.json [REPEATS]
//! ```
//!
//! `sample` searches every n-th point; `again` then fits all points near the result. Prints the pose as one line of
//! JSON.

use engeom::common::consensus::Magsac;
use engeom::geom3::Cylinder3;
use engeom::{Point3, PointCloud3, SurfacePoint3, UnitVec3, Vector3};
use serde::{Deserialize, Serialize};
use std::error::Error;
use std::time::Instant;

/// Points for the search and for the final fit.
const SAMPLE_COUNT: usize = 20_000;
const REFINE_COUNT: usize = 250_000;
/// Neighbourhood of a normal, as a fraction of the radius.
const NEIGHBOUR_SHARE: f64 = 12.0 / 200.0;

/// Known values besides the scan, mm.
#[derive(Deserialize)]
struct Hints {
    radius: f64,
    radius_min: f64,
    radius_max: f64,
    noise: f64,
    pitch: f64,
    towards_sensor: [f64; 3],
}

/// The axis y = y0 + p x, z = z0 + q x, the same as point and direction, and the radius, mm; or why there is none.
#[derive(Serialize)]
#[serde(untagged)]
enum Answer {
    Pose { p: f64, q: f64, y0: f64, z0: f64, radius: f64, point: [f64; 3], direction: [f64; 3] },
    None { refused: String },
}

#[derive(Serialize)]
struct Line {
    #[serde(flatten)]
    answer: Answer,
    seconds: Vec<f64>,
}

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().collect();
    let [_, variant, scan, hints, ..] = arguments.as_slice() else { return Err("VARIANT SCAN HINTS [REPEATS]".into()) };
    let repeats = arguments.get(4).map_or(Ok(1), |text| text.parse())?;
    let hints: Hints = serde_json::from_slice(&std::fs::read(hints)?)?;
    let points = points_of_npy(&std::fs::read(scan)?)?;
    let (mut seconds, mut answer) = (Vec::new(), Answer::None { refused: String::new() });
    for _ in 0..repeats {
        let start = Instant::now();
        answer = match fit(&points, &hints, variant == "again") {
            Ok(cylinder) => pose(&cylinder),
            Err(error) => Answer::None { refused: error.to_string() },
        };
        seconds.push(start.elapsed().as_secs_f64());
    }
    println!("{}", serde_json::to_string(&Line { answer, seconds })?);
    Ok(())
}

/// The points of a single-precision array (profiles, points, 3) or (points, 3), without the missing ones.
fn points_of_npy(bytes: &[u8]) -> Result<Vec<Point3>, Box<dyn Error>> {
    let header_length = usize::from(u16::from_le_bytes([bytes[8], bytes[9]]));
    let numbers = bytes.get(10 + header_length..).ok_or("the array is cut off")?;
    let number = |four: &[u8]| f64::from(f32::from_le_bytes([four[0], four[1], four[2], four[3]]));
    let point = |bytes: &[u8]| Point3::new(number(&bytes[0..4]), number(&bytes[4..8]), number(&bytes[8..12]));
    Ok(numbers.chunks_exact(12).map(point).filter(|point| point.z.is_finite()).collect())
}

fn fit(points: &[Point3], hints: &Hints, again: bool) -> engeom::Result<Cylinder3> {
    let oriented = with_normals(every_nth(points, SAMPLE_COUNT), hints)?;
    let sigma_max = 3.0 * hints.noise;
    let options = Magsac { seed: Some(0), ..Magsac::new(sigma_max) };
    let (least, most) = (Some(hints.radius_min), Some(hints.radius_max));
    let found = Cylinder3::from_consensus(&oriented, sigma_max, least, most, Some(options))?;
    if again { refit(&every_nth(points, REFINE_COUNT), found, sigma_max) } else { Ok(found) }
}

/// Every n-th point with a prime n, so that the selection does not alias with the points of a profile.
fn every_nth(points: &[Point3], count: usize) -> Vec<Point3> {
    let prime = |n: &usize| (2..).take_while(|i| i * i <= *n).all(|i| n % i != 0);
    let step = ((points.len() / count).max(1)..).find(prime).unwrap_or(1);
    points.iter().step_by(step).copied().collect()
}

/// The consensus needs oriented points; their normals are estimated by the method of the crate.
fn with_normals(points: Vec<Point3>, hints: &Hints) -> engeom::Result<Vec<SurfacePoint3>> {
    let up = vec![Vector3::from(hints.towards_sensor); points.len()];
    let cloud = PointCloud3::new(points);
    // A neighbourhood must contain more than one profile.
    let neighbourhood = (NEIGHBOUR_SHARE * hints.radius).max(1.6 * hints.pitch);
    let estimates = cloud.compute_index()?.estimate_normals(&up, neighbourhood)?;
    let oriented = |(point, normal): (&Point3, &UnitVec3)| SurfacePoint3::new(*point, *normal);
    Ok(cloud.points().iter().zip(&estimates.normals).map(oriented).collect())
}

/// Least squares on all points nearer than `reach`, selected again three times.
fn refit(points: &[Point3], mut cylinder: Cylinder3, reach: f64) -> engeom::Result<Cylinder3> {
    for _ in 0..3 {
        let axis = cylinder.axis();
        let near = |point: &&Point3| (axis.distance_to(*point) - cylinder.radius).abs() < reach;
        let chosen: Vec<Point3> = points.iter().filter(near).copied().collect();
        cylinder = Cylinder3::from_fit(&chosen, &cylinder, None)?;
    }
    Ok(cylinder)
}

fn pose(cylinder: &Cylinder3) -> Answer {
    let (at, along) = (cylinder.center, cylinder.direction);
    let (p, q) = (along.y / along.x, along.z / along.x);
    let (point, direction) = ([at.x, at.y, at.z], [along.x, along.y, along.z]);
    Answer::Pose { p, q, y0: at.y - p * at.x, z0: at.z - q * at.x, radius: cylinder.radius, point, direction }
}
