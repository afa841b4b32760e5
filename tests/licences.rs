//! The licence texts in the container image.

#![expect(clippy::expect_used, reason = "a test may fail")]

use std::fs::File;
use std::io::Read;
use std::path::PathBuf;
use std::process::Command;

const ROOT: &str = env!("CARGO_MANIFEST_DIR");

/// The output of the command, run in the folder of the project.
fn printed(command: &mut Command) -> String {
    let printed = command.current_dir(ROOT).output().expect("runs");
    assert!(printed.status.success(), "{}", String::from_utf8_lossy(&printed.stderr));
    String::from_utf8(printed.stdout).expect("text")
}

fn target() -> String {
    format!("{}-unknown-linux-gnu", std::env::consts::ARCH)
}

fn licences() -> String {
    printed(Command::new("sh").args(["docker/licences.sh", &target()]))
}

#[test]
fn the_licences_of_the_image_name_every_crate_and_the_source_of_those_under_mpl() {
    let text = licences();
    for part in [
        "async-opcua-client 0.19.0    https://crates.io/crates/async-opcua-client/0.19.0",
        "Mozilla Public License Version 2.0",
        "Apache License",
        "Permission is hereby granted, free of charge",
        "GNU LESSER GENERAL PUBLIC LICENSE",
        "glibc, linked statically",
        "SQLite, compiled by libsqlite3-sys, is in the public domain",
        // With tables that regex-syntax contains, and in the COPYRIGHT of rand.
        "UNICODE, INC. LICENSE AGREEMENT",
        "Copyrights in the Rand project",
    ] {
        assert!(text.contains(part), "{part}");
    }
    let manifest = include_str!("../Cargo.toml");
    let dependencies = manifest.split("\n[dependencies]\n").nth(1).and_then(|rest| rest.split("\n\n[").next());
    let others = |line: &&str| !line.starts_with('#') && !line.starts_with("coaxis-");
    for line in dependencies.expect("a section").lines().filter(others) {
        let name = line.split([' ', '.']).next().expect("a name");
        assert!(text.contains(&format!("{name} ")), "{name}");
    }
    let dockerfile = include_str!("../Dockerfile");
    assert!(dockerfile.contains("docker/licences.sh") && dockerfile.contains("/licences"), "the image has them");
}

#[test]
fn the_licences_of_the_image_carry_the_notice_of_the_swagger_ui_that_is_embedded() {
    let metadata = ["metadata", "--locked", "--offline", "--format-version=1", "--filter-platform", &target()];
    let metadata = printed(Command::new("cargo").args(metadata));
    let metadata: serde_json::Value = serde_json::from_str(&metadata).expect("JSON");
    let mut packages = metadata["packages"].as_array().expect("packages").iter();
    let vendored = packages.find(|package| package["name"] == "utoipa-swagger-ui-vendored").expect("a dependency");
    let folder = PathBuf::from(vendored["manifest_path"].as_str().expect("a path")).with_file_name("res");
    let file = folder.read_dir().expect("a folder").next().expect("an archive").expect("readable").path();
    let mut archive = zip::ZipArchive::new(File::open(file).expect("opens")).expect("an archive");
    let mut names = archive.file_names().map(|name| name.expect("text").into_owned());
    let name = names.find(|name| name.ends_with("/NOTICE")).expect("a notice");
    drop(names);
    let mut notice = String::new();
    archive.by_name(&name).expect("there").read_to_string(&mut notice).expect("text");
    assert!(licences().contains(notice.trim()), "{notice}");
}
