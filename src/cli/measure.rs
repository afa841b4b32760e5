//! `coaxis measure`: scan files to poses, without a service. The same document as over HTTP, or a table for people.

use super::config::Sources;
use super::{FAILED, Outcome, REFUSED, bar, complain, print, table};
use crate::estimation::Method;
use crate::http::{MeasurementDocument, profiles_csv};
use crate::plot::{Picture, Subject, draw};
use crate::scan::decode::{Format, Limits, Unit};
use crate::service::{Offline, Origin, Recipe, Resolved, Verdict, measure_offline};
use std::error::Error;
use std::fs::{self, File};
use std::io::{BufReader, IsTerminal};
use std::path::{Path, PathBuf};
use std::process::ExitCode;

/// Measure scan files offline; exit code 0 accepted, 2 refused, 1 anything else
#[derive(Debug, clap::Args)]
pub(super) struct Arguments {
    /// Scan files; gzip and zstd are undone
    #[arg(required = true, value_name = "FILE")]
    files: Vec<PathBuf>,
    /// Print one JSON document a line, also on a terminal
    #[arg(long)]
    json: bool,
    /// How the pose is found
    #[arg(long, value_parser = method)]
    method: Option<Method>,
    /// Recipe, JSON
    #[arg(long, value_name = "FILE")]
    recipe: Option<PathBuf>,
    /// Radius that the drawing gives
    #[arg(long, value_name = "MM")]
    nominal_radius_mm: Option<f64>,
    /// Format of the files, where name and content do not say
    #[arg(long, value_parser = format)]
    format: Option<Format>,
    /// Unit of the files' coordinates: mm, m, um or inch
    #[arg(long, value_parser = unit)]
    unit: Option<Unit>,
    /// Which points belong to one profile: column, column=NAME, row, x_value or x_pitch_mm=PITCH
    #[arg(long, value_name = "RULE")]
    profile_by: Option<String>,
    /// Write what became of every profile to this file, CSV (with several scans: into this folder)
    #[arg(long, value_name = "FILE")]
    profiles: Option<PathBuf>,
    /// Write the pictures into this folder (with several scans: a folder each in it)
    #[arg(long, value_name = "FOLDER")]
    plots: Option<PathBuf>,
    /// Configuration file, TOML, for limits and defaults
    #[arg(long, value_name = "FILE", env = "COAXIS_CONFIG")]
    config: Option<PathBuf>,
}

pub(super) fn run(arguments: &Arguments) -> Outcome {
    let config = Sources::of_file(arguments.config.clone()).config()?;
    let resolved = arguments.recipe()?.resolve(&config.estimation)?;
    let json = arguments.json || !std::io::stdout().is_terminal();
    let mut code = 0;
    for file in &arguments.files {
        match arguments.measure(file, &resolved, &config.scan, json) {
            Ok(Verdict::Accepted) => {}
            Ok(Verdict::Refused) => code = if code == FAILED { FAILED } else { REFUSED },
            Err(error) => {
                complain(error.as_ref());
                code = FAILED;
            }
        }
    }
    Ok(ExitCode::from(code))
}

impl Arguments {
    fn recipe(&self) -> Result<Recipe, Box<dyn Error>> {
        let flags = Recipe {
            method: self.method,
            nominal_radius_mm: self.nominal_radius_mm,
            unit: self.unit,
            profile_by: self.profile_by.clone(),
            ..Recipe::default()
        };
        let Some(path) = &self.recipe else { return Ok(flags) };
        let text = fs::read(path).map_err(|error| format!("{}: {error}", path.display()))?;
        let recipe: Recipe = serde_json::from_slice(&text)
            .map_err(|error| format!("{}: {error}; a recipe is a JSON object", path.display()))?;
        Ok(flags.over(&recipe))
    }

    fn measure(
        &self,
        path: &Path,
        resolved: &Resolved,
        limits: &Limits,
        json: bool,
    ) -> Result<Verdict, Box<dyn Error>> {
        let name = path.display().to_string();
        let file = File::open(path).map_err(|error| format!("{name}: {error}"))?;
        let reader = Box::new(BufReader::with_capacity(READ_BLOCK_BYTES, file));
        let origin = Origin { parameter: self.format, media_type: None, file_name: Some(name.clone()) };
        let measured = bar::with_bar(&name, |progress| measure_offline(reader, &origin, resolved, limits, progress));
        let Offline { measurement, estimate, scan } = measured.map_err(|error| format!("{name}: {error}"))?;
        if let Some(place) = &self.profiles {
            let place = if self.files.len() > 1 { place.join(stem(path)).with_extension("csv") } else { place.clone() };
            write(&place, &profiles_csv(&estimate.profiles))?;
        }
        if let Some(folder) = &self.plots {
            let folder = if self.files.len() > 1 { folder.join(stem(path)) } else { folder.clone() };
            let subject = Subject { title: &name, epsilon_mm: resolved.settings.epsilon_mm, profile: None };
            for picture in Picture::ALL {
                let place = folder.join(picture.name()).with_extension("svg");
                write(&place, &draw(picture, &scan, &estimate, &subject))?;
            }
        }
        let document = MeasurementDocument::from(&measurement);
        if json {
            print(&format!("{}\n", serde_json::to_string(&document)?));
        } else {
            print(&table::table(&name, &document));
        }
        Ok(measurement.verdict())
    }
}

/// Reading a file in large blocks costs fewer calls; a scan has megabytes.
const READ_BLOCK_BYTES: usize = 256 << 10;

fn stem(path: &Path) -> &Path {
    path.file_stem().map_or(Path::new("scan"), Path::new)
}

/// Writes a file, and the folder that it is to lie in.
fn write(path: &Path, text: &str) -> Result<(), Box<dyn Error>> {
    if let Some(folder) = path.parent() {
        fs::create_dir_all(folder).map_err(|error| format!("{}: {error}", folder.display()))?;
    }
    fs::write(path, text).map_err(|error| format!("{}: {error}", path.display()).into())
}

fn method(name: &str) -> Result<Method, String> {
    let names = || Method::ALL.map(Method::name).join(", ");
    Method::from_name(name).ok_or_else(|| format!("there is {}", names()))
}

pub(super) fn format(name: &str) -> Result<Format, String> {
    let names = || Format::ALL.map(Format::name).join(", ");
    Format::from_name(name).ok_or_else(|| format!("there is {}", names()))
}

fn unit(name: &str) -> Result<Unit, String> {
    let names = || Unit::ALL.map(Unit::name).join(", ");
    Unit::from_name(name).ok_or_else(|| format!("there is {}", names()))
}
