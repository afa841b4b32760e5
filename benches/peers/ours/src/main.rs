//! coaxis as a program with the protocol of `protocol.py`.
//!
//! ```text
//! coaxis_peer cylinder|section_line|section_line_plain SCAN.npy HINTS.json [REPEATS]
//! ```
//!
//! `cylinder` gets no hints. The methods by sections need a threshold: ε is 2.22 times the noise hint, the ratio of the default
//! of 0.111 mm to 0.05 mm. Prints the pose as one line of JSON.

use coaxis::estimation::{Method, Outcome, Progress, Settings, estimate};
use coaxis::geometry::AxisLine;
use coaxis::scan::decode::{Format, Limits, Request, decode};
use coaxis::scan::slice::{SliceRequest, slice};
use serde_json::{Value, json};
use std::error::Error;
use std::fs::{self, File};
use std::io::BufReader;
use std::time::Instant;

/// ε of the methods by sections, as a multiple of the noise.
const EPSILON_MULTIPLE: f64 = 2.22;

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().collect();
    let [_, method, scan, hints, ..] = arguments.as_slice() else { return Err("METHOD SCAN HINTS [REPEATS]".into()) };
    let repeats = arguments.get(4).map_or(Ok(1), |text| text.parse())?;
    let method = Method::from_name(method).ok_or("no such method")?;
    let hints: Value = serde_json::from_slice(&fs::read(hints)?)?;
    let settings = settings(method, hints["noise"].as_f64().ok_or("no noise among the hints")?);

    let limits = Limits::default();
    let request = Request::new(&limits);
    let cloud = decode(Format::Npy, &mut BufReader::new(File::open(scan)?), &request)?;
    let scan = slice(cloud, &SliceRequest::default(), &limits)?;

    let (mut seconds, mut answer) = (Vec::new(), json!({}));
    for _ in 0..repeats {
        let start = Instant::now();
        let found = estimate(&scan, &settings, &Progress::default());
        seconds.push(start.elapsed().as_secs_f64());
        answer = shown(&found.outcome);
    }
    answer["seconds"] = json!(seconds);
    println!("{answer}");
    Ok(())
}

fn settings(method: Method, noise_mm: f64) -> Settings {
    let told = Settings { method, ..Settings::default() };
    match method {
        Method::Cylinder | Method::LeastSquares => told,
        Method::SectionLine | Method::SectionLinePlain => Settings { epsilon_mm: EPSILON_MULTIPLE * noise_mm, ..told },
    }
}

fn shown(outcome: &Outcome) -> Value {
    match outcome {
        Outcome::Accepted(pose) => {
            let placed = pose.axis_in_scan();
            let mut shown =
                json!({ "radius": pose.radius, "point": placed.point_mm, "direction": placed.direction });
            if let Some(AxisLine { p, q, y0, z0 }) = placed.line() {
                shown["p"] = json!(p);
                shown["q"] = json!(q);
                shown["y0"] = json!(y0);
                shown["z0"] = json!(z0);
            }
            shown
        }
        Outcome::Refused(refusal) => json!({ "refused": format!("{refusal:?}") }),
    }
}
