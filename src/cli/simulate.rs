//! `coaxis simulate`: generates synthetic scans with their true values for testing a client or a method; also simulated devices.

use super::output::{Outcome, print};
use super::reading::format;
use super::simulate_devices::{GocatorArguments, PlcArguments, run_gocator, run_plc};
use super::simulate_scene::ExportArguments;
use super::simulate_scene::SceneArguments;
use super::simulate_scene::SensorArguments;
use crate::geometry::{AxisLine, Frame};
use crate::scan::Scan;
use crate::scan::decode::Format;
use crate::scan::encode::encode;
use crate::scan::synthetic::{Edge, Edges, Export, Interference, Part, PlacedTruth, make_several, placed};
use serde::Serialize;
use std::error::Error;
use std::fs::{self, File};
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};
use std::process::ExitCode;

/// Make data with known truth
#[derive(Debug, clap::Subcommand)]
pub(super) enum Subject {
    Scan(Box<ScanArguments>),
    Plc(PlcArguments),
    Gocator(GocatorArguments),
}

/// Write the scan of a synthetic part, and its truth beside it (NAME.truth.json)
#[derive(Debug, clap::Args)]
pub(super) struct ScanArguments {
    /// Where to; the ending decides the format: ply, pcd, npy, npz, csv, json
    #[arg(value_name = "FILE")]
    file: PathBuf,
    /// Format, where the ending is not to decide: csv, gocator_csv, ply, pcd, npy, npz, json
    #[arg(long, value_parser = format)]
    format: Option<Format>,
    /// Radius of the part
    #[arg(long, value_name = "MM", default_value_t = 200.0, allow_hyphen_values = true)]
    radius_mm: f64,
    /// From the first profile to the last
    #[arg(long, value_name = "MM", default_value_t = 800.0, allow_hyphen_values = true)]
    length_mm: f64,
    /// Plane of the first profile
    #[arg(long, value_name = "MM", default_value_t = 0.0, allow_hyphen_values = true)]
    x_start_mm: f64,
    /// Number of profiles
    #[arg(long, value_name = "COUNT", default_value_t = 400)]
    profiles: usize,
    /// Points a profile
    #[arg(long, value_name = "COUNT", default_value_t = 640)]
    points: usize,
    /// Arc seen of each section
    #[arg(long, value_name = "DEG", default_value_t = 140.0, allow_hyphen_values = true)]
    arc_deg: f64,
    /// Tilt of the axis towards +Y
    #[arg(long, value_name = "DEG", default_value_t = 0.3575, allow_hyphen_values = true)]
    deflection_deg: f64,
    /// Tilt of the axis towards +Z
    #[arg(long, value_name = "DEG", default_value_t = 1.1127, allow_hyphen_values = true)]
    pitch_deg: f64,
    /// Where the axis meets the plane x = 0
    #[arg(long, value_name = "MM", default_value_t = -8.272, allow_hyphen_values = true)]
    y_c0_mm: f64,
    /// Where the axis meets the plane x = 0
    #[arg(long, value_name = "MM", default_value_t = 6.514, allow_hyphen_values = true)]
    z_c0_mm: f64,
    /// Noise in y and in z, one standard deviation
    #[arg(long, value_name = "MM", default_value_t = 0.05, allow_hyphen_values = true)]
    noise_mm: f64,
    /// Share of the profiles with screw holes: two groups of 2 % of the points sunk by 10 and 20 mm
    #[arg(long, value_name = "SHARE", default_value_t = 0.0, allow_hyphen_values = true)]
    screw_holes: f64,
    /// Share of the profiles through a straight hole: 15 % of the points sunk by 30 mm
    #[arg(long, value_name = "SHARE", default_value_t = 0.0, allow_hyphen_values = true)]
    straight_holes: f64,
    /// Share of the profiles under a clamp
    #[arg(long, value_name = "SHARE", default_value_t = 0.0, allow_hyphen_values = true)]
    clamps: f64,
    /// Share of the arc that a clamp covers
    #[arg(long, value_name = "SHARE", default_value_t = 0.5, allow_hyphen_values = true)]
    clamp_arc: f64,
    /// Height of a clamp above the surface
    #[arg(long, value_name = "MM", default_value_t = 25.0, allow_hyphen_values = true)]
    clamp_height_mm: f64,
    /// Share of the points that are missing
    #[arg(long, value_name = "SHARE", default_value_t = 0.0, allow_hyphen_values = true)]
    drop_outs: f64,
    /// Share of the points that are thrown off by up to 10 mm
    #[arg(long, value_name = "SHARE", default_value_t = 0.0, allow_hyphen_values = true)]
    spikes: f64,
    /// The part ends here, where its axis meets its near end plane; profiles beyond see nothing, which csv, gocator_csv and
    /// json keep
    #[arg(long, value_name = "MM", allow_hyphen_values = true)]
    near_end_mm: Option<f64>,
    /// The same of the far end
    #[arg(long, value_name = "MM", allow_hyphen_values = true)]
    far_end_mm: Option<f64>,
    /// Chamfer of 45° at these ends
    #[arg(long, value_name = "MM", default_value_t = 0.0, allow_hyphen_values = true)]
    chamfer_mm: f64,
    #[command(flatten)]
    scene: SceneArguments,
    #[command(flatten)]
    sensor: SensorArguments,
    #[command(flatten)]
    export: ExportArguments,
    /// The same seed makes the same scan
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// A second part of the same kind behind the first, this far from its last profile
    #[arg(long, value_name = "MM", allow_hyphen_values = true)]
    second_gap_mm: Option<f64>,
    /// Radius of the second part; that of the first by default
    #[arg(long, value_name = "MM", allow_hyphen_values = true, requires = "second_gap_mm")]
    second_radius_mm: Option<f64>,
    /// Tilt of the second part's axis towards +Y; that of the first by default
    #[arg(long, value_name = "DEG", allow_hyphen_values = true, requires = "second_gap_mm")]
    second_deflection_deg: Option<f64>,
    /// Tilt of the second part's axis towards +Z; that of the first by default
    #[arg(long, value_name = "DEG", allow_hyphen_values = true, requires = "second_gap_mm")]
    second_pitch_deg: Option<f64>,
}

pub(super) fn run(subject: &Subject) -> Outcome {
    match subject {
        Subject::Scan(arguments) => write_scan(arguments),
        Subject::Plc(arguments) => run_plc(arguments),
        Subject::Gocator(arguments) => run_gocator(arguments),
    }
}

fn write_scan(arguments: &ScanArguments) -> Outcome {
    let parts = arguments.parts()?;
    let format = arguments.format()?;
    let truth_file = match arguments.export.frame() {
        None => write_made(&parts, format, &arguments.file)?,
        Some(frame) => write_moved(&parts, &frame, arguments)?,
    };
    print(&format!("{}\n{}\n", arguments.file.display(), truth_file.display()))?;
    Ok(ExitCode::SUCCESS)
}

/// Generates a scan, and writes it to `file` and its true values beside it (a list if there are several parts); returns the path of
/// the true values.
pub(super) fn write_made(parts: &[Part], format: Format, file: &Path) -> Result<PathBuf, Box<dyn Error>> {
    let (scan, truths) =
        make_several(parts).map_err(|error| format!("no scan can be generated with these values: {error}"))?;
    write(&scan, &truths, format, file)
}

/// The same for a scan that is moved as a whole before it is rounded and its sentinels are written.
fn write_moved(parts: &[Part], frame: &Frame, arguments: &ScanArguments) -> Result<PathBuf, Box<dyn Error>> {
    let parts: Vec<Part> = parts.iter().map(|part| Part { export: Export::default(), ..part.clone() }).collect();
    let (scan, truths) =
        make_several(&parts).map_err(|error| format!("no scan can be generated with these values: {error}"))?;
    let cloud = placed(&scan, frame, arguments.export.shuffle_seed(arguments.seed))?;
    let cloud = arguments.export.export().apply(cloud, arguments.seed)?;
    let truths: Vec<PlacedTruth> = truths.iter().map(|truth| truth.placed(frame)).collect::<Result<_, _>>()?;
    write(&cloud, &truths, arguments.format()?, &arguments.file)
}

/// Writes a scan to `file` and the true values beside it; returns the path of the true values.
fn write(scan: &Scan, truths: &[impl Serialize], format: Format, file: &Path) -> Result<PathBuf, Box<dyn Error>> {
    let open = |path: &Path| File::create(path).map_err(|error| format!("{}: {error}", path.display()));
    let mut out = BufWriter::new(open(file)?);
    encode(scan, format, &mut out)
        .and_then(|()| out.flush())
        .map_err(|error| format!("{}: {error}", file.display()))?;
    let truth_file = file.with_extension("truth.json");
    let text = match truths {
        [truth] => text(truth)?,
        truths => text(&truths)?,
    };
    fs::write(&truth_file, text).map_err(|error| format!("{}: {error}", truth_file.display()))?;
    Ok(truth_file)
}

fn text(truth: &impl Serialize) -> Result<String, serde_json::Error> {
    serde_json::to_string_pretty(truth).map(|text| text + "\n")
}

impl ScanArguments {
    fn format(&self) -> Result<Format, String> {
        let ending = self.file.extension().and_then(|ending| ending.to_str()).unwrap_or_default();
        let unknown = || format!("{}: no format has this extension; give --format", self.file.display());
        self.format.or_else(|| Format::from_name(&ending.to_ascii_lowercase())).ok_or_else(unknown)
    }

    /// The parts, or an error if their values are not valid.
    fn parts(&self) -> Result<Vec<Part>, String> {
        self.check()?;
        let first = self.part();
        let Some(gap_mm) = self.second_gap_mm else { return Ok(vec![first]) };
        let degrees = |said: Option<f64>, first: f64| said.map_or(first, |degrees| degrees.to_radians().tan());
        let (p, q) = (degrees(self.second_deflection_deg, first.axis.p), degrees(self.second_pitch_deg, first.axis.q));
        let second = Part {
            radius_mm: self.second_radius_mm.unwrap_or(first.radius_mm),
            axis: AxisLine { p, q, ..first.axis },
            x_start_mm: first.x_start_mm + first.length_mm + gap_mm,
            seed: first.seed.wrapping_add(1),
            ..first
        };
        Ok(vec![first, second])
    }

    fn part(&self) -> Part {
        let slope = |degrees: f64| degrees.to_radians().tan();
        let part = self.scene.around(&Part {
            radius_mm: self.radius_mm,
            axis: AxisLine {
                p: slope(self.deflection_deg),
                q: slope(self.pitch_deg),
                y0: self.y_c0_mm,
                z0: self.z_c0_mm,
            },
            x_start_mm: self.x_start_mm,
            length_mm: self.length_mm,
            profiles_count: self.profiles,
            points_count: self.points,
            arc_deg: self.arc_deg,
            noise_sigma_mm: self.noise_mm,
            interference: Interference {
                screw_holes: self.screw_holes,
                straight_holes: self.straight_holes,
                clamps: self.clamps,
                clamp_arc: self.clamp_arc,
                clamp_height_mm: self.clamp_height_mm,
                ..Interference::default()
            },
            drop_out_ratio: self.drop_outs,
            spike_ratio: self.spikes,
            edges: Edges { near: self.edge(self.near_end_mm), far: self.edge(self.far_end_mm) },
            export: self.export.export(),
            seed: self.seed,
            ..Part::smooth(self.seed)
        });
        self.sensor.scanning(&part)
    }

    fn edge(&self, x_mm: Option<f64>) -> Option<Edge> {
        x_mm.map(|x_mm| Edge { x_mm, chamfer_mm: self.chamfer_mm, ..Edge::default() })
    }

    fn check(&self) -> Result<(), String> {
        let shares = [
            ("screw-holes", self.screw_holes),
            ("straight-holes", self.straight_holes),
            ("clamps", self.clamps),
            ("screw-holes, straight-holes and clamps together", self.screw_holes + self.straight_holes + self.clamps),
            ("clamp-arc", self.clamp_arc),
            ("drop-outs", self.drop_outs),
            ("spikes", self.spikes),
        ];
        // Slightly more than 1, because the sum of fractions may be rounded up.
        if let Some((name, value)) = shares.into_iter().find(|(_, share)| !(0.0..=1.0 + 1e-9).contains(share)) {
            return Err(format!("{name} must be between 0 and 1, got {value}"));
        }
        let ranges = [
            ("radius-mm", self.radius_mm, 1e-3, 1e5),
            ("length-mm", self.length_mm, 0.0, 1e6),
            ("x-start-mm", self.x_start_mm, -1e6, 1e6),
            ("profiles", self.profiles as f64, 1.0, 1e5),
            ("points", self.points as f64, 1.0, 1e4),
            ("arc-deg", self.arc_deg, 0.0, 360.0),
            ("deflection-deg", self.deflection_deg, -80.0, 80.0),
            ("pitch-deg", self.pitch_deg, -80.0, 80.0),
            ("y-c0-mm", self.y_c0_mm, -1e5, 1e5),
            ("z-c0-mm", self.z_c0_mm, -1e5, 1e5),
            ("noise-mm", self.noise_mm, 0.0, 1e4),
            ("near-end-mm", self.near_end_mm.unwrap_or(0.0), -1e6, 1e6),
            ("far-end-mm", self.far_end_mm.unwrap_or(0.0), -1e6, 1e6),
            ("chamfer-mm", self.chamfer_mm, 0.0, self.radius_mm),
            ("clamp-height-mm", self.clamp_height_mm, -1e4, 1e4),
            ("second-gap-mm", self.second_gap_mm.unwrap_or(0.0), 0.0, 1e6),
            ("second-radius-mm", self.second_radius_mm.unwrap_or(1.0), 1e-3, 1e5),
            ("second-deflection-deg", self.second_deflection_deg.unwrap_or(0.0), -80.0, 80.0),
            ("second-pitch-deg", self.second_pitch_deg.unwrap_or(0.0), -80.0, 80.0),
        ];
        match ranges
            .into_iter()
            .chain(self.scene.ranges())
            .chain(self.sensor.ranges())
            .chain(self.export.ranges())
            .find(|(_, value, least, most)| !(least..=most).contains(&value))
        {
            Some((name, value, least, most)) => Err(format!("{name} must be between {least} and {most}, got {value}")),
            None => Ok(()),
        }
    }
}
