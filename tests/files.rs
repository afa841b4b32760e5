//! Every Rust file below `tests` is a module of the single test binary. A file that no module declares would never run, and cargo
//! does not report it.

#![expect(clippy::expect_used, reason = "a test may fail")]

use std::fs;
use std::path::{Path, PathBuf};

fn rust_files(folder: &Path, found: &mut Vec<PathBuf>) {
    for entry in fs::read_dir(folder).expect("readable folder") {
        let path = entry.expect("readable entry").path();
        // For example, the Python environment.
        let is_hidden = path.file_name().is_some_and(|name| name.to_string_lossy().starts_with('.'));
        if path.is_dir() && !is_hidden {
            rust_files(&path, found);
        } else if path.extension().is_some_and(|ending| ending == "rs") {
            found.push(path);
        }
    }
}

/// Whether the text declares this module, and its file is where the compiler looks for it.
fn declares(parent: &Path, name: &str) -> bool {
    let text = fs::read_to_string(parent).unwrap_or_default();
    let declaration = format!("mod {name};");
    text.lines().any(|line| line.trim().trim_start_matches("pub(crate) ") == declaration)
}

#[test]
fn every_test_file_is_declared_as_a_module() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests");
    let mut files = Vec::new();
    rust_files(&root, &mut files);
    assert!(files.len() > 50, "{} files", files.len());
    for file in files.iter().filter(|file| **file != root.join("main.rs")) {
        // a/mod.rs is the module a of the folder above it.
        let module = if file.ends_with("mod.rs") {
            file.parent().expect("a folder").to_owned()
        } else {
            file.with_extension("")
        };
        let name = module.file_name().expect("a name").to_string_lossy();
        let above = module.parent().expect("a folder");
        let parents = [root.join("main.rs"), above.join("mod.rs"), above.with_extension("rs")];
        let declared = parents.iter().any(|parent| declares(parent, &name));
        assert!(declared, "{} is in no module: declare it in tests/main.rs", file.display());
    }
}
