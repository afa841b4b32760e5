//! Measures a scan file with the library and prints the axis with its uncertainty: `cargo run --example measure -- scan.ply`.

#![expect(clippy::print_stdout, reason = "an example speaks to a person")]

use coaxis::estimation::{Progress, Settings};
use coaxis::http::MeasurementDocument;
use coaxis::scan::decode::Limits;
use coaxis::service::{Origin, Recipe, measure_offline};
use std::error::Error;
use std::fs::File;

fn main() -> Result<(), Box<dyn Error>> {
    let path = std::env::args().nth(1).ok_or("name a scan file")?;
    let origin = Origin { file_name: Some(path.clone()), ..Origin::default() };
    let recipe = Recipe::default().resolve(&Settings::default())?;
    let source = Box::new(File::open(&path)?);
    let measured = measure_offline(source, &origin, &recipe, &Limits::default(), &Progress::default())?;
    let document = MeasurementDocument::from(&measured.measurement);
    match (document.pose, document.uncertainty) {
        (Some(pose), Some(uncertainty)) => {
            let expanded = uncertainty.expanded;
            println!("point      {:.4?} mm ± {:.4} mm", pose.axis.point_mm, expanded.axis_position_mm);
            println!("direction  {:.6?} ± {:.4}°", pose.axis.direction, expanded.axis_direction_deg);
            println!("radius     {:.4} mm ± {:.4} mm", pose.radius_mm, expanded.radius_mm);
        }
        _ => println!("refused: {}", document.refusal.map_or_else(String::new, |refusal| refusal.detail)),
    }
    Ok(())
}
