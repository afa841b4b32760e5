//! `coaxis measure`: measures scan files without a service. The output is the same document as over HTTP, or a table.

use super::config::Sources;
use super::output::{FAILED, Outcome, OutputClosed, REFUSED, complain, print, table, with_bar};
use super::reading::{ReadingArguments, named};
use crate::estimation::{EndFaceRule, Method, Orientation};
use crate::http::{MeasurementDocument, profiles_csv};
use crate::plot::Picture;
use crate::scan::decode::Limits;
use crate::service::in_words;
use crate::service::{
    Measurement, Offline, Origin, PictureRequest, Recipe, Resolved, Verdict, View, measure_offline, without_mark,
};
use std::collections::HashSet;
use std::error::Error;
use std::ffi::OsStr;
use std::fs::{self, File};
use std::io::{IsTerminal, Read};
use std::path::{Path, PathBuf};
use std::process::ExitCode;

/// Measure scan files offline; exit code 0 accepted, 2 refused, 1 anything else
#[derive(Debug, clap::Args)]
pub(super) struct Arguments {
    /// Scan files, - for standard input; gzip and zstd are decompressed
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
    #[arg(long, value_name = "MM", allow_hyphen_values = true)]
    nominal_radius_mm: Option<f64>,
    /// In which directions the axis is looked for: auto (along X if it lies there, else in any), rail (along X) or any
    #[arg(long, value_name = "WHERE", value_parser = orientation)]
    orientation: Option<Orientation>,
    /// Which end faces are measured: none, near, far or both
    #[arg(long, value_name = "WHICH", value_parser = end_face)]
    end_face: Option<EndFaceRule>,
    /// A point nearer than this to its section is an inlier
    #[arg(long, value_name = "MM", allow_hyphen_values = true)]
    epsilon_mm: Option<f64>,
    #[command(flatten)]
    reading: ReadingArguments,
    /// Which points belong to one profile: column, column=NAME, row, x_value or x_pitch_mm=PITCH
    #[arg(long, value_name = "RULE")]
    profile_by: Option<String>,
    /// Write what became of every profile to this file, CSV (with several scans: into this folder, as
    /// SCAN.csv)
    #[arg(long, value_name = "FILE")]
    profiles: Option<PathBuf>,
    /// Write the pictures into this folder (with several scans: into the folder SCAN in it; of several parts: into a folder
    /// PART in that)
    #[arg(long, value_name = "FOLDER")]
    plots: Option<PathBuf>,
    /// Configuration file, TOML, for limits and defaults
    #[arg(long, value_name = "FILE", env = "COAXIS_CONFIG")]
    config: Option<PathBuf>,
}

pub(super) fn run(arguments: &Arguments) -> Outcome {
    let config = Sources::of_file(arguments.config.clone()).config()?;
    let resolved = arguments.recipe()?.resolve(&config.estimation)?;
    arguments.check_names()?;
    let json = arguments.json || !std::io::stdout().is_terminal();
    let mut code = 0;
    for file in &arguments.files {
        match arguments.measure(file, &resolved, &config.scan, json) {
            Ok(Verdict::Accepted) => {}
            Ok(Verdict::Refused) => code = if code == FAILED { FAILED } else { REFUSED },
            Err(error) if error.is::<OutputClosed>() => return Err(error),
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
            epsilon_mm: self.epsilon_mm,
            orientation: self.orientation,
            end_face: self.end_face,
            profile_by: self.profile_by.clone(),
            ..self.reading.recipe()
        };
        let Some(path) = &self.recipe else { return Ok(flags) };
        let text = fs::read(path).map_err(|error| format!("{}: {error}", path.display()))?;
        let text = without_mark(&text);
        // A list would be parsed as the fields in their order.
        if text.trim_ascii_start().first() != Some(&b'{') {
            return Err(format!("{}: a recipe is a JSON object", path.display()).into());
        }
        let recipe: Recipe = serde_json::from_slice(text)
            .map_err(|error| format!("{}: {}", path.display(), in_words(&error.to_string())))?;
        Ok(flags.over(&recipe))
    }

    /// Refuses scans whose output files would overwrite each other.
    fn check_names(&self) -> Result<(), String> {
        let mut seen = HashSet::new();
        let writes = self.plots.is_some() || self.profiles.is_some();
        match self.files.iter().find(|file| !seen.insert(own_name(file))) {
            Some(file) if writes => Err(format!(
                "two scans are named {}, and the output of the one would overwrite the other's; rename one or measure them \
                 one by one",
                own_name(file).display()
            )),
            _ => Ok(()),
        }
    }

    fn measure(
        &self,
        path: &Path,
        resolved: &Resolved,
        limits: &Limits,
        json: bool,
    ) -> Result<Verdict, Box<dyn Error>> {
        let (source, file_name) = open(path)?;
        let name = file_name.clone().unwrap_or_else(|| "standard input".to_owned());
        let origin = Origin { parameter: self.reading.format, media_type: None, file_name };
        let measured = with_bar(&name, |progress| measure_offline(source, &origin, resolved, limits, progress));
        let Offline { measurement, profiles, scan } = measured.map_err(|error| format!("{name}: {error}"))?;
        if let Some(place) = &self.profiles {
            let place = if self.files.len() > 1 { place.join(with_csv(own_name(path))) } else { place.clone() };
            write(&place, &profiles_csv(&profiles, &measurement.result))?;
        }
        if let Some(folder) = &self.plots {
            let folder = if self.files.len() > 1 { folder.join(own_name(path)) } else { folder.clone() };
            for view in measurement.views(&scan, &profiles) {
                self.draw_all(&folder, &name, &measurement, &view, resolved.settings.epsilon_mm)?;
            }
        }
        let document = MeasurementDocument::from(&measurement);
        if json {
            print(&format!("{}\n", serde_json::to_string(&document)?))?;
        } else {
            print(&table(&name, &document))?;
        }
        Ok(measurement.verdict())
    }

    /// Draws every plot of a part, in a folder of its own if there are several parts.
    fn draw_all(
        &self,
        folder: &Path,
        name: &str,
        measurement: &Measurement,
        view: &View,
        epsilon_mm: f64,
    ) -> Result<(), Box<dyn Error>> {
        let folder = view.part.as_ref().map_or_else(|| folder.to_owned(), |part| folder.join(part));
        let recipe = self.recipe.as_deref().and_then(Path::file_name).map(OsStr::to_string_lossy);
        for picture in Picture::ALL {
            let request = PictureRequest { picture, name, recipe: recipe.as_deref(), epsilon_mm, profile: None };
            let place = folder.join(picture.name()).with_extension("svg");
            write(&place, &measurement.draw(view, request))?;
        }
        Ok(())
    }
}

/// The file name that stands for standard input.
const STANDARD_INPUT: &str = "-";

/// The bytes of a scan and the name of its file; standard input has no name.
pub(super) fn open(path: &Path) -> Result<(Box<dyn Read>, Option<String>), String> {
    if path == Path::new(STANDARD_INPUT) {
        return Ok((Box::new(std::io::stdin()), None));
    }
    let name = path.display().to_string();
    let file = File::open(path).map_err(|error| format!("{name}: {error}"))?;
    Ok((Box::new(file), Some(name)))
}

/// The name of a scan's output: the complete file name, so that `s.ply` and `s.pcd` have different outputs.
fn own_name(path: &Path) -> &OsStr {
    match path.file_name() {
        Some(name) if name != STANDARD_INPUT => name,
        _ => OsStr::new("stdin"),
    }
}

fn with_csv(name: &OsStr) -> PathBuf {
    let mut name = name.to_owned();
    name.push(".csv");
    name.into()
}

/// Writes a file, and creates its folder.
fn write(path: &Path, text: &str) -> Result<(), Box<dyn Error>> {
    if let Some(folder) = path.parent() {
        fs::create_dir_all(folder).map_err(|error| format!("{}: {error}", folder.display()))?;
    }
    fs::write(path, text).map_err(|error| format!("{}: {error}", path.display()).into())
}

fn method(name: &str) -> Result<Method, String> {
    named(Method::from_name(name), Method::ALL, Method::name)
}

fn orientation(name: &str) -> Result<Orientation, String> {
    named(Orientation::from_name(name), Orientation::ALL, Orientation::name)
}

fn end_face(name: &str) -> Result<EndFaceRule, String> {
    named(EndFaceRule::from_name(name), EndFaceRule::ALL, EndFaceRule::name)
}
