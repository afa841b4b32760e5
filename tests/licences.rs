//! The licence texts that the image carries.

use std::process::Command;

#[test]
fn the_licences_of_the_image_name_every_crate_and_the_source_of_those_under_mpl() {
    let root = env!("CARGO_MANIFEST_DIR");
    let target = format!("{}-unknown-linux-gnu", std::env::consts::ARCH);
    let printed = Command::new("sh").args(["docker/licences.sh", &target]).current_dir(root).output().expect("runs");
    assert!(printed.status.success(), "{}", String::from_utf8_lossy(&printed.stderr));
    let text = String::from_utf8(printed.stdout).expect("text");
    for part in [
        "async-opcua-client 0.19.0    https://crates.io/crates/async-opcua-client/0.19.0",
        "Mozilla Public License Version 2.0",
        "Apache License",
        "Permission is hereby granted, free of charge",
        "GNU LESSER GENERAL PUBLIC LICENSE",
        "glibc, linked statically",
    ] {
        assert!(text.contains(part), "{part}");
    }
    let manifest = include_str!("../Cargo.toml");
    let dependencies = manifest.split("\n[dependencies]\n").nth(1).and_then(|rest| rest.split("\n\n[").next());
    for line in dependencies.expect("a section").lines().filter(|line| !line.starts_with('#')) {
        let name = line.split(' ').next().expect("a name");
        assert!(text.contains(&format!("{name} ")), "{name}");
    }
    let dockerfile = include_str!("../Dockerfile");
    assert!(dockerfile.contains("docker/licences.sh") && dockerfile.contains("/licences"), "the image has them");
}
