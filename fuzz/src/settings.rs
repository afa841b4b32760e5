//! Input of operators and clients: recipes in JSON, configurations in TOML, environment variables.

use coaxis::config::{Config, Layers};
use coaxis::service::{Equipment, Recipe};

/// A recipe as the offline command reads it.
pub fn recipe(bytes: &[u8]) {
    let Ok(recipe) = serde_json::from_slice::<Recipe>(bytes) else { return };
    let text = serde_json::to_string(&recipe).expect("a recipe can be written");
    assert_eq!(
        serde_json::from_str::<Recipe>(&text).ok().as_ref(),
        Some(&recipe),
        "a recipe reads back as written: {text}"
    );
    let checked = recipe.check().is_ok();
    let resolved = recipe.resolve(&Config::default().estimation);
    assert!(checked || resolved.is_err(), "a recipe that the check refuses cannot be resolved");
    let _ = recipe.clone().over(&Recipe::default());
}

/// A configuration file, followed by lines `NAME=value` after a line `[environment]` as variables.
pub fn config(bytes: &[u8]) {
    let Ok(text) = std::str::from_utf8(bytes) else { return };
    let (file, variables) = text.split_once("\n[environment]\n").unwrap_or((text, ""));
    let Ok(layers) = Layers::default().text("file", file) else { return };
    let variables = variables.lines().filter_map(|line| line.split_once('='));
    let variables = variables.map(|(name, value)| (format!("COAXIS_{name}").into(), value.into()));
    let Ok(layers) = layers.environment(variables) else { return };
    let Ok(config) = layers.build() else { return };
    assert!(config.check().is_ok(), "a built configuration passes the check");
    let _ = Equipment::of(&config.cell);
}
