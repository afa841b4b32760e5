//! Checks the sources against the architecture: which module may import which, where waiting, HTTP, clocks and random numbers are
//! allowed, and the maximum length of a file. The sources are read as text.

#![expect(clippy::expect_used, reason = "a test may fail")]

use std::fs;
use std::path::{Path, PathBuf};

/// Each module with the modules that it may import from.
const MODULES: [(&str, &[&str]); 12] = [
    ("geometry", &[]),
    ("scan", &["geometry"]),
    ("estimation", &["geometry", "scan"]),
    ("plot", &["geometry", "scan", "estimation"]),
    ("motion", &["geometry"]),
    ("device", &["geometry", "scan", "motion"]),
    ("cell", &["geometry", "motion", "device"]),
    ("store", &[]),
    ("config", &["geometry", "scan", "estimation", "motion", "device", "cell"]),
    ("service", &["geometry", "scan", "estimation", "plot", "motion", "device", "cell", "store", "config"]),
    ("http", &["geometry", "scan", "estimation", "plot", "motion", "device", "cell", "store", "config", "service"]),
    (
        "cli",
        &["geometry", "scan", "estimation", "plot", "motion", "device", "cell", "store", "config", "service", "http"],
    ),
];

/// Crates and calls with the modules that may use them.
const RESERVED: [(&str, &[&str]); 12] = [
    ("tokio::", &["device", "cell", "store", "service", "http", "cli"]),
    ("tokio_modbus::", &["device"]),
    ("use opcua::", &["device"]),
    ("axum::", &["http"]),
    ("axum_server::", &["http"]),
    ("utoipa", &["http"]),
    ("sqlx::", &["store"]),
    ("clap::", &["cli"]),
    ("tracing::", &["device", "cell", "store", "service", "http", "cli"]),
    ("Instant::now", &["device", "cell", "service", "cli"]),
    ("Timestamp::now", &["service"]),
    ("now_v7", &["service"]),
];

const LINES_BEFORE_TESTS_MAX: usize = 500;

struct Source {
    module: String,
    path: PathBuf,
    /// The text before the file's tests.
    text: String,
}

fn sources(folder: &Path, found: &mut Vec<PathBuf>) {
    for entry in fs::read_dir(folder).expect("readable folder") {
        let path = entry.expect("readable entry").path();
        if path.is_dir() {
            sources(&path, found);
        } else if path.extension().is_some_and(|e| e == "rs") {
            found.push(path);
        }
    }
}

/// Every source file that is not a test, with its module.
fn modules() -> Vec<Source> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    let mut paths = Vec::new();
    sources(&root, &mut paths);
    paths
        .into_iter()
        .filter_map(|path| {
            let inside = path.strip_prefix(&root).expect("below src");
            let inside = inside.strip_prefix("calculation").unwrap_or(inside).to_path_buf();
            let tests = inside.components().any(|part| part.as_os_str() == "tests" || part.as_os_str() == "tests.rs");
            let module = inside.components().next()?.as_os_str().to_string_lossy().trim_end_matches(".rs").to_owned();
            let whole = fs::read_to_string(&path).expect("readable source");
            let text = whole.split("\n#[cfg(test)]").next().unwrap_or_default().to_owned();
            (!tests).then_some(Source { module, path: inside, text })
        })
        .collect()
}

/// The modules that a line of code imports from.
fn imported(line: &str) -> impl Iterator<Item = &str> {
    let code = line.split("//").next().unwrap_or_default();
    code.match_indices("crate::").map(move |(at, found)| {
        let rest = code.get(at + found.len()..).unwrap_or_default();
        rest.split(|c: char| !(c.is_alphanumeric() || c == '_')).next().unwrap_or_default()
    })
}

#[test]
fn no_module_imports_more_than_it_may() {
    for Source { module, path, text } in modules() {
        let Some((_, allowed)) = MODULES.iter().find(|(name, _)| *name == module) else {
            assert!(
                ["lib", "main"].contains(&module.as_str()),
                "{} is in no module of the architecture",
                path.display()
            );
            continue;
        };
        for (number, line) in text.lines().enumerate() {
            for other in imported(line).filter(|other| *other != module) {
                let place = format!("{}:{}", path.display(), number + 1);
                assert!(
                    !other.is_empty(),
                    "{place}: import modules by name, one a line, so that this test can read them"
                );
                assert!(allowed.contains(&other), "{place}: {module} must not import {other}");
            }
        }
    }
}

#[test]
fn waiting_http_clocks_and_random_numbers_are_confined_to_their_modules() {
    for Source { module, path, text } in modules().iter().filter(|source| source.module != "main") {
        for (reserved, modules) in RESERVED {
            let used = text.lines().any(|line| line.split("//").next().is_some_and(|code| code.contains(reserved)));
            assert!(
                !used || modules.contains(&module.as_str()),
                "{}: {reserved} is not allowed in {module}",
                path.display()
            );
        }
    }
}

#[test]
fn every_file_has_a_header_and_is_short() {
    for Source { path, text, .. } in modules() {
        assert!(text.starts_with("//!"), "{} must begin with a comment about its purpose", path.display());
        let lines_count = text.lines().count();
        assert!(lines_count <= LINES_BEFORE_TESTS_MAX, "{} has {lines_count} lines before its tests", path.display());
    }
}

/// The table of constants in docs/estimation.md names the files that define them.
#[test]
fn every_documented_constant_stands_in_the_file_that_the_table_names() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let page = fs::read_to_string(root.join("docs/estimation.md")).expect("the page");
    let mut code = String::new();
    let mut named_count = 0;
    for row in page.lines() {
        let Some(cell) = row.strip_prefix("| ").and_then(|row| row.split(" | ").next()) else { continue };
        let names = || cell.split('`').skip(1).step_by(2);
        if cell.starts_with("**`") {
            let folder = names().next().and_then(|file| file.rsplit_once('/')).map_or("", |(folder, _)| folder);
            let place = |file: &str| match file.contains('/') {
                true => root.join("src/calculation/estimation").join(file),
                false => root.join("src/calculation/estimation").join(folder).join(file),
            };
            let text = |file| fs::read_to_string(place(file)).unwrap_or_else(|error| panic!("{cell}: {file}: {error}"));
            code = names().map(text).collect();
        } else if !code.is_empty() {
            let constants =
                names().filter(|name| name.bytes().all(|c| c.is_ascii_uppercase() || c.is_ascii_digit() || c == b'_'));
            for name in constants.filter(|name| name.len() > 1) {
                named_count += 1;
                assert!(code.contains(&format!("const {name}: ")), "{name} is not in the file that stands above {row}");
            }
        }
    }
    assert!(named_count > 100, "only {named_count} constants were found in the table");
}
