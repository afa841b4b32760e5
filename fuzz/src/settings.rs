//! What operators and clients write: recipes in JSON, configurations in TOML, variables of the environment.

use coaxis::config::{Config, Layers};
use coaxis::service::{Equipment, Recipe};

/// A recipe as the offline command reads it.
pub fn recipe(bytes: &[u8]) {
    let Ok(recipe) = serde_json::from_slice::<Recipe>(bytes) else { return };
    let text = serde_json::to_string(&recipe).expect("a recipe can be written");
    assert_eq!(
        serde_json::from_str::<Recipe>(&text).ok().as_ref(),
        Some(&recipe),
        "a recipe is read as it is written: {text}"
    );
    let checked = recipe.check().is_ok();
    let resolved = recipe.resolve(&Config::default().estimation);
    assert!(checked || resolved.is_err(), "what the check refuses cannot be resolved");
    let _ = recipe.clone().over(&Recipe::default());
}

/// A configuration file, then lines `NAME=value` behind a line `[environment]` as variables.
pub fn config(bytes: &[u8]) {
    let Ok(text) = std::str::from_utf8(bytes) else { return };
    let (file, variables) = text.split_once("\n[environment]\n").unwrap_or((text, ""));
    let Ok(layers) = Layers::default().text("file", file) else { return };
    let variables = variables.lines().filter_map(|line| line.split_once('='));
    let variables = variables.map(|(name, value)| (format!("COAXIS_{name}").into(), value.into()));
    let Ok(layers) = layers.environment(variables) else { return };
    let Ok(config) = layers.build() else { return };
    assert!(config.check().is_ok(), "what was built passes the check");
    let _ = Equipment::of(&config.cell);
}
