//! Paths of the measured files and of the published reference sets. They belong to third parties and are not part of the project;
//! `tests/data/README.md` lists them.

use std::path::{Path, PathBuf};

/// The file or folder `name` below the folder that `COAXIS_REAL_DATA` names, or below `../shared/data`. If it does not
/// exist, prints that the test is skipped and returns `None`.
#[expect(clippy::print_stderr, reason = "a skipped test must say so")]
pub(crate) fn outside(name: &str) -> Option<PathBuf> {
    let beside = || Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/data");
    let path = std::env::var_os("COAXIS_REAL_DATA").map_or_else(beside, PathBuf::from).join(name);
    let found = path.exists().then_some(path);
    if found.is_none() {
        eprintln!("skipped: there is no {name} (COAXIS_REAL_DATA names the folder)");
    }
    found
}
