//! The `coaxis` command as a user runs it: its output files and messages.

#![expect(clippy::expect_used, clippy::panic, clippy::indexing_slicing, reason = "a test may fail")]

use coaxis::geometry::Frame;
use nalgebra::Vector3;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use serde_json::Value;
use std::fmt::Write;
use std::fs::{self, File};
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};

fn coaxis(arguments: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_coaxis"));
    command.args(arguments).env_remove("COAXIS_CONFIG").stdin(Stdio::null());
    command
}

fn output(arguments: &[&str]) -> Output {
    coaxis(arguments).output().expect("runs")
}

fn complaint(arguments: &[&str]) -> String {
    let output = output(arguments);
    assert_eq!(output.status.code(), Some(1), "{arguments:?}");
    String::from_utf8(output.stderr).expect("text")
}

/// A new folder of this name for a test.
fn folder(name: &str) -> PathBuf {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("command").join(name);
    let _ = fs::remove_dir_all(&folder);
    fs::create_dir_all(&folder).expect("a folder");
    folder
}

/// A small synthetic scan; the extension of the name determines its format.
fn made(file: &Path) -> String {
    fs::create_dir_all(file.parent().expect("a folder")).expect("a folder");
    let name = file.display().to_string();
    let output = output(&["simulate", "scan", &name, "--profiles", "20", "--points", "100"]);
    assert!(output.status.success());
    name
}

#[test]
fn scans_that_share_a_stem_keep_their_own_output() {
    let folder = folder("stems");
    let scans = ["s.ply", "s.pcd"].map(|name| made(&folder.join(name)));
    let places = ["plots", "profiles"].map(|name| folder.join(name).display().to_string());
    let [plots, profiles] = &places;
    let [ply, pcd] = &scans;
    assert!(output(&["measure", ply, pcd, "--plots", plots, "--profiles", profiles]).status.success());
    for name in ["s.ply", "s.pcd"] {
        assert!(Path::new(plots).join(name).join("section.svg").exists(), "plots of {name}");
        assert!(Path::new(profiles).join(format!("{name}.csv")).exists(), "profiles of {name}");
    }
}

#[test]
fn a_moved_scan_has_its_axis_in_the_moved_coordinates() {
    let scan = folder("moved").join("s.ply").display().to_string();
    let made =
        ["simulate", "scan", &scan, "--profiles", "20", "--points", "50", "--deflection-deg", "0", "--pitch-deg", "0"];
    let upright = ["--frame-x-axis", "0,0,1", "--frame-z-axis", "1,0,0", "--frame-origin-mm", "5,6,7", "--shuffle"];
    assert!(output(&[&made[..], &upright].concat()).status.success());
    let truth = fs::read(Path::new(&scan).with_extension("truth.json")).expect("a truth");
    let truth: serde_json::Value = serde_json::from_slice(&truth).expect("JSON");
    let numbers = |value: &serde_json::Value| -> Vec<f64> {
        value.as_array().expect("a list").iter().map(|number| number.as_f64().expect("a number")).collect()
    };
    // The rail frame's X is the new Z, its Z the new X, and so its Y the new −Y: (400, −8.272, 6.514) moves to these.
    let expected = [5.0 + 6.514, 6.0 + 8.272, 7.0 + 400.0];
    let point = numbers(&truth["axis"]["point_mm"]);
    assert!(point.iter().zip(expected).all(|(found, expected)| (found - expected).abs() < 1e-9), "{point:?}");
    assert_eq!(numbers(&truth["axis"]["direction"]), [0.0, 0.0, 1.0]);
}

#[test]
fn profiles_beyond_the_end_of_a_synthetic_part_are_kept_if_the_format_can_contain_them() {
    let scan = folder("blanks").join("s.csv").display().to_string();
    let beyond =
        ["--profiles", "20", "--points", "50", "--length-mm", "190", "--near-end-mm", "31", "--far-end-mm", "160"];
    let level = ["--deflection-deg", "0", "--pitch-deg", "0"];
    assert!(output(&[&["simulate", "scan", &scan][..], &beyond, &level].concat()).status.success());
    let text = fs::read_to_string(&scan).expect("a scan");
    // At 0, 10, 20, 30 mm and at 170, 180, 190.
    assert_eq!(text.lines().filter(|line| line.ends_with(",,")).count(), 7);
}

#[test]
fn scans_of_one_name_are_refused_where_output_would_be_overwritten() {
    let folder = folder("names");
    let scans = ["a/s.ply", "b/s.ply"].map(|name| made(&folder.join(name)));
    let [a, b] = &scans;
    let plots = folder.join("plots").display().to_string();
    assert!(complaint(&["measure", a, b, "--plots", &plots]).contains("two scans are named s.ply"));
    assert!(!Path::new(&plots).exists(), "nothing is written");
    assert!(output(&["measure", a, b]).status.success(), "without output there is no conflict");
}

#[test]
fn standard_input_is_a_scan_like_any_other() {
    let scan = made(&folder("input").join("s.ply"));
    let input = File::open(&scan).expect("the scan");
    let output = coaxis(&["measure", "-"]).stdin(input).output().expect("runs");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    assert!(String::from_utf8_lossy(&output.stdout).contains("\"verdict\":\"accepted\""));
}

#[test]
fn a_closed_output_ends_the_command_without_a_message() {
    let mut child = coaxis(&["openapi"]).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().expect("runs");
    drop(child.stdout.take());
    let output = child.wait_with_output().expect("ends");
    assert_eq!((output.status.code(), output.stderr.as_slice()), (Some(0), &b""[..]));
}

/// The commands that the help of a command lists.
fn commands_of(path: &[&str]) -> Vec<String> {
    let help = output(&[&["help"], path].concat());
    assert!(help.status.success(), "{path:?}: {}", String::from_utf8_lossy(&help.stderr));
    let help = String::from_utf8(help.stdout).expect("text");
    let lines = help.lines().skip_while(|line| *line != "Commands:").skip(1).take_while(|line| !line.is_empty());
    // Continuation lines are indented further.
    let names = lines.filter_map(|line| line.strip_prefix("  ").filter(|line| !line.starts_with(' ')));
    names.filter_map(|line| line.split_whitespace().next().map(str::to_owned)).collect()
}

#[test]
fn every_command_in_the_help_exists_with_help_and_a_manual_page() {
    let commands = commands_of(&[]);
    assert!(commands.len() > 10 && commands.contains(&"completions".to_owned()), "{commands:?}");
    for command in commands.iter().map(String::as_str).filter(|command| *command != "help") {
        for nested in commands_of(&[command]).iter().map(String::as_str).filter(|nested| *nested != "help") {
            assert!(output(&[command, nested, "--help"]).status.success(), "{command} {nested}");
            let page = output(&["man", command, nested]);
            let title = format!(".TH coaxis-{command}-{nested} 1");
            assert!(String::from_utf8_lossy(&page.stdout).contains(&title), "{title}");
        }
        assert!(output(&["man", command]).status.success(), "{command}");
    }
    assert!(complaint(&["man", "fly"]).contains("coaxis has no command fly"));
}

#[test]
fn the_completions_of_every_shell_contain_the_commands() {
    for shell in ["bash", "zsh", "fish", "elvish", "powershell"] {
        let script = output(&["completions", shell]);
        let text = String::from_utf8(script.stdout).expect("text");
        assert!(script.status.success() && text.contains("simulate") && text.contains("nominal-radius-mm"), "{shell}");
    }
}

#[test]
fn the_error_for_an_invalid_value_states_the_allowed_values() {
    let scan = made(&folder("values").join("s.ply"));
    for flag in ["--nominal-radius-mm", "--epsilon-mm"] {
        let said = complaint(&["measure", &scan, flag, "-3"]);
        assert!(said.contains("must be a length above 0") && said.contains("-3"), "{said}");
    }
    let said = complaint(&["simulate", "scan", &scan, "--radius-mm", "-3"]);
    assert!(said.contains("radius-mm must be between"), "{said}");
    let said = complaint(&["serve", "--listen", "line3.example:8080"]);
    assert!(said.contains("localhost:8080"), "{said}");
}

#[test]
fn the_error_for_an_unusable_data_folder_states_the_remedy() {
    let file = folder("data").join("file");
    fs::write(&file, "").expect("written");
    let said = complaint(&["serve", "--listen", "127.0.0.1:0", "--data", &file.join("data").display().to_string()]);
    assert!(said.contains("--data FOLDER"), "{said}");
}

/// A cylinder of a synthetic scan, mm.
#[derive(Debug, Clone, Copy)]
struct Cylinder {
    middle: Vector3<f64>,
    direction: Vector3<f64>,
    radius: f64,
    length: f64,
}

/// Standard deviation of the noise of synthetic points along the normal, mm.
const NOISE_MM: f64 = 0.02;

impl Cylinder {
    /// Distance of a point from the axis.
    fn distance(&self, point: &Vector3<f64>) -> f64 {
        (point - self.middle).cross(&self.direction).norm()
    }

    fn holds(&self, point: &Vector3<f64>) -> bool {
        let along = (point - self.middle).dot(&self.direction).abs();
        along < 0.5 * self.length && self.distance(point) < self.radius
    }

    fn random_point(&self, chance: &mut ChaCha8Rng) -> Vector3<f64> {
        let across = Vector3::new(0.3, -0.5, 0.8).cross(&self.direction).normalize();
        let (sin, cos) = chance.random_range(0.0..std::f64::consts::TAU).sin_cos();
        let normal = across * cos + self.direction.cross(&across) * sin;
        let noise: f64 = StandardNormal.sample(chance);
        let along = self.length * chance.random_range(-0.5..0.5);
        self.middle + self.direction * along + normal * (self.radius + NOISE_MM * noise)
    }
}

/// Two cylinders whose axes are 5 mm apart at an angle of 69°, so that the cylinders intersect.
fn crossing() -> [Cylinder; 2] {
    let direction = Vector3::new(0.36, 0.48, 0.8);
    let first = Cylinder { middle: Vector3::new(110.0, 40.0, 800.0), direction, radius: 30.0, length: 300.0 };
    let direction = Vector3::new(0.8, -0.6, 0.36).normalize();
    let beside = first.direction.cross(&direction).normalize() * 5.0;
    [first, Cylinder { middle: first.middle + beside + direction * 20.0, direction, radius: 18.0, length: 200.0 }]
}

/// The surface of the union of both, as a table of points in metres.
fn crossing_scan(file: &Path) -> String {
    let mut chance = ChaCha8Rng::seed_from_u64(11);
    let [first, second] = crossing();
    let mut text = "x,y,z\n".to_owned();
    for (cylinder, other) in [(first, second), (second, first)] {
        for point in (0..6000).map(|_| cylinder.random_point(&mut chance)).filter(|point| !other.holds(point)) {
            let [x, y, z]: [f64; 3] = (point / 1000.0).into();
            writeln!(text, "{x:.7},{y:.7},{z:.7}").expect("a string");
        }
    }
    fs::write(file, text).expect("written");
    file.display().to_string()
}

/// The recipes that `propose` prints, each written to a file, with their content.
fn proposed(folder: &Path, arguments: &[&str]) -> Vec<(String, Value)> {
    let output = output(&[&["propose"], arguments].concat());
    assert!(output.status.success(), "{arguments:?}: {}", String::from_utf8_lossy(&output.stderr));
    let text = String::from_utf8(output.stdout).expect("text");
    let written = text.lines().enumerate().map(|(index, line)| {
        let file = folder.join(format!("recipe-{index}.json"));
        fs::write(&file, line).expect("written");
        (file.display().to_string(), serde_json::from_str(line).expect("JSON"))
    });
    written.collect()
}

fn number(value: &Value, pointer: &str) -> f64 {
    value.pointer(pointer).and_then(Value::as_f64).unwrap_or_else(|| panic!("{pointer} of {value}"))
}

fn vector(value: &Value, pointer: &str) -> Vector3<f64> {
    Vector3::from_fn(|row, _| number(value, &format!("{pointer}/{row}")))
}

/// Measures with a proposed recipe and compares the result with the true cylinder, within 2.5 expanded uncertainties: a correct
/// result exceeds 5 standard uncertainties once in two million times.
fn check_measured(scan: &str, file: &str, recipe: &Value, truth: &Cylinder) {
    let output = output(&["measure", scan, "--recipe", file]);
    let answer: Value = serde_json::from_slice(&output.stdout).expect("JSON");
    assert_eq!(answer["verdict"], "accepted", "{answer}");
    // The result is in the frame of the recipe.
    let frame: Frame = serde_json::from_value(recipe["frame"].clone()).expect("a frame");
    let rotation = frame.rotation().expect("a frame").transpose();
    let point = rotation * vector(&answer, "/pose/axis/point_mm") + Vector3::from(frame.origin_mm);
    let direction = rotation * vector(&answer, "/pose/axis/direction");
    let errors = [
        ("/uncertainty/radius_mm", number(&answer, "/pose/radius_mm") - truth.radius),
        ("/uncertainty/axis_position_mm", truth.distance(&point)),
        ("/uncertainty/axis_direction_deg", direction.cross(&truth.direction).norm().asin().to_degrees()),
    ];
    for (expanded, error) in errors {
        let limit = 2.5 * number(&answer, expanded);
        assert!(error.abs() <= limit, "{expanded}: {error}, at most {limit}; {recipe}");
    }
}

#[test]
fn a_proposed_recipe_measures_its_cylinder_and_no_other() {
    let folder = folder("crossing");
    let scan = crossing_scan(&folder.join("crossing.csv"));
    let recipes = proposed(&folder, &[&scan, "--unit", "m", "--format", "csv"]);
    assert_eq!(recipes.len(), 2, "{recipes:?}");
    for (truth, (file, recipe)) in crossing().iter().zip(&recipes) {
        check_measured(&scan, file, recipe, truth);
        assert_eq!(recipe["unit"], "m");
        assert!(recipe.get("nominal_radius_mm").is_none(), "{recipe}");
    }
    assert!(recipes[1].1["description"].as_str().is_some_and(|text| text.starts_with("cylinder 2 of 2: radius 18 mm")));

    let recipes = proposed(&folder, &[&scan, "--unit", "m", "--nominal-radius-mm", "18.1"]);
    let [(file, recipe)] = recipes.as_slice() else { panic!("{recipes:?}") };
    assert_eq!(recipe["nominal_radius_mm"], 18.1);
    check_measured(&scan, file, recipe, &crossing()[1]);
}

#[test]
fn a_proposed_recipe_measures_a_part_across_the_scan_direction() {
    let folder = folder("pitch45");
    let scan = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/field/axis_pitch45.npy").display().to_string();
    let recipes = proposed(&folder, &[&scan]);
    let [(file, recipe)] = recipes.as_slice() else { panic!("{recipes:?}") };
    // The file was generated with its axis through the origin at 45° between X and Z.
    let direction = Vector3::new(1.0, 0.0, 1.0).normalize();
    let truth = Cylinder { middle: Vector3::zeros(), direction, radius: 20.0, length: 100.0 };
    check_measured(&scan, file, recipe, &truth);
}

#[test]
fn a_scan_without_a_cylinder_gives_exit_code_2() {
    let scan = folder("plane").join("plane.csv");
    let mut chance = ChaCha8Rng::seed_from_u64(3);
    let mut text = String::new();
    for _ in 0..2000 {
        let [x, y] = [0, 1].map(|_| chance.random_range(-50.0..50.0));
        let noise: f64 = StandardNormal.sample(&mut chance);
        writeln!(text, "{x:.4},{y:.4},{:.4}", 0.2 * x + NOISE_MM * noise).expect("a string");
    }
    fs::write(&scan, text).expect("written");
    let output = output(&["propose", &scan.display().to_string()]);
    assert_eq!((output.status.code(), output.stdout.as_slice()), (Some(2), &b""[..]));
    assert!(String::from_utf8_lossy(&output.stderr).contains("no cylinder was found in the 2000 points"));
}
