//! `coaxis propose`: finds the cylinders in a scan file, and prints a recipe for each of them for `coaxis measure --recipe`.

use super::config::Sources;
use super::measure::open;
use super::output::{Outcome, REFUSED, complain, print};
use super::reading::ReadingArguments;
use crate::service::{Origin, Proposal, Recipe, cylinder_decimals, propose, read_cloud};
use std::error::Error;
use std::io::IsTerminal;

use std::path::PathBuf;
use std::process::ExitCode;

/// Find the cylinders of a scan file in any direction and print a recipe for each; exit code 0 found, 2 none found, 1
/// anything else
#[derive(Debug, clap::Args)]
pub(super) struct Arguments {
    /// Scan file, - for standard input; gzip and zstd are decompressed
    #[arg(value_name = "FILE")]
    file: PathBuf,
    /// Print the recipes alone, one JSON object a line, also on a terminal
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    reading: ReadingArguments,
    /// Radius that the drawing gives: only cylinders within 2 % of it are proposed
    #[arg(long, value_name = "MM", allow_hyphen_values = true)]
    nominal_radius_mm: Option<f64>,
    /// Configuration file, TOML, for limits and defaults
    #[arg(long, value_name = "FILE", env = "COAXIS_CONFIG")]
    config: Option<PathBuf>,
}

pub(super) fn run(arguments: &Arguments) -> Outcome {
    let config = Sources::of_file(arguments.config.clone()).config()?;
    let asked = Recipe { nominal_radius_mm: arguments.nominal_radius_mm, ..arguments.reading.recipe() };
    let resolved = asked.resolve(&config.estimation)?;
    let (source, file_name) = open(&arguments.file)?;
    let name = file_name.clone().unwrap_or_else(|| "standard input".to_owned());
    let origin = Origin { parameter: arguments.reading.format, media_type: None, file_name };
    let cloud = read_cloud(source, &origin, &resolved, &config.scan).map_err(|error| format!("{name}: {error}"))?;
    // A default of the configuration also applies to the measurement.
    let nominal_radius_mm = resolved.settings.nominal_radius_mm;
    let proposals = propose(&cloud, &asked, nominal_radius_mm);
    if proposals.is_empty() {
        let message: Box<dyn Error> = not_found(&name, cloud.columns.len(), nominal_radius_mm).into();
        complain(message.as_ref());
        return Ok(ExitCode::from(REFUSED));
    }
    let json = arguments.json || !std::io::stdout().is_terminal();
    let mut text = if json { String::new() } else { heading(&name, &proposals) };
    for (index, proposal) in proposals.iter().enumerate() {
        if !json {
            text += &row(index + 1, proposal);
        }
        text += &serde_json::to_string(&proposal.recipe)?;
        text += "\n";
    }
    print(&text)?;
    Ok(ExitCode::SUCCESS)
}

fn not_found(name: &str, points_count: usize, nominal_radius_mm: Option<f64>) -> String {
    let (of_radius, check) = match nominal_radius_mm {
        Some(radius) => (format!(" within 2 % of {radius} mm radius"), ", the nominal radius and the unit"),
        None => (String::new(), ""),
    };
    format!(
        "{name}: no cylinder{of_radius} was found in the {points_count} points; check that the part is in view{check}, or cut its \
         surroundings off"
    )
}

fn heading(name: &str, proposals: &[Proposal]) -> String {
    let count = match proposals.len() {
        1 => "1 cylinder".to_owned(),
        count => format!("{count} cylinders"),
    };
    format!("{name}: {count}\n{:>3} {:>12} {:>12} {:>7}  axis\n", "", "radius", "length", "points")
}

fn row(number: usize, proposal: &Proposal) -> String {
    let cylinder = &proposal.cylinder;
    let decimals = cylinder_decimals(cylinder.radius_mm);
    let [px, py, pz] = cylinder.point_mm;
    let [dx, dy, dz] = cylinder.direction;
    format!(
        "{number:>3} {:>9.decimals$} mm {:>9.decimals$} mm {:>5.0} %  ({px:.decimals$}, {py:.decimals$}, {pz:.decimals$}) mm, \
         direction ({dx:.6}, {dy:.6}, {dz:.6})\n",
        cylinder.radius_mm,
        cylinder.length_mm,
        100.0 * cylinder.share
    )
}
