//! The `coaxis` command from outside: what it writes where, and what it says. Must not know how it works.

#![expect(clippy::expect_used, reason = "a test may fail")]

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

/// A new folder of this name for one test.
fn folder(name: &str) -> PathBuf {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("command").join(name);
    let _ = fs::remove_dir_all(&folder);
    fs::create_dir_all(&folder).expect("a folder");
    folder
}

/// A small made scan; the ending of the name decides its format.
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
fn profiles_beyond_the_end_of_a_made_part_are_kept_where_the_format_can() {
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
    assert!(output(&["measure", a, b]).status.success(), "without output they do not meet");
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
fn a_reader_that_goes_away_ends_the_command_quietly() {
    let mut child = coaxis(&["openapi"]).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().expect("runs");
    drop(child.stdout.take());
    let output = child.wait_with_output().expect("ends");
    assert_eq!((output.status.code(), output.stderr.as_slice()), (Some(1), &b""[..]));
}

#[test]
fn a_wrong_value_is_answered_with_what_is_allowed() {
    let scan = made(&folder("values").join("s.ply"));
    for flag in ["--nominal-radius-mm", "--epsilon-mm"] {
        let said = complaint(&["measure", &scan, flag, "-3"]);
        assert!(said.contains("must be a length above 0") && said.contains("-3"), "{said}");
    }
    let said = complaint(&["simulate", "scan", &scan, "--radius-mm", "-3"]);
    assert!(said.contains("radius-mm must be between"), "{said}");
    let said = complaint(&["serve", "--listen", "localhost:8080"]);
    assert!(said.contains("127.0.0.1:8080"), "{said}");
}

#[test]
fn a_data_folder_that_cannot_be_used_is_answered_with_what_to_do() {
    let file = folder("data").join("file");
    fs::write(&file, "").expect("written");
    let said = complaint(&["serve", "--listen", "127.0.0.1:0", "--data", &file.join("data").display().to_string()]);
    assert!(said.contains("--data FOLDER"), "{said}");
}
