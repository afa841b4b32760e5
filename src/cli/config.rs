//! `coaxis config`: prints the configuration of the service. Also the flags by which every command finds its configuration.

use super::output::{Outcome, print_text};
use crate::config::Layers;
use crate::config::{Config, ConfigError};
use std::path::PathBuf;

/// Print the configuration that a service started so would have, as TOML
#[derive(Debug, clap::Args)]
pub(super) struct Arguments {
    #[command(flatten)]
    sources: Sources,
    /// Print the defaults instead
    #[arg(long, conflicts_with = "check")]
    default: bool,
    /// Only say whether this file can be used
    #[arg(long, value_name = "FILE")]
    check: Option<PathBuf>,
}

/// Where settings come from, the later over the earlier: file, environment, flags.
#[derive(Debug, clap::Args)]
pub(super) struct Sources {
    /// Configuration file, TOML
    #[arg(long, value_name = "FILE", env = "COAXIS_CONFIG")]
    config: Option<PathBuf>,
    /// Address and port to listen on [default: 127.0.0.1:8080]
    #[arg(long, value_name = "ADDRESS:PORT")]
    listen: Option<String>,
    /// Folder for records and scans [default: data]
    #[arg(long, value_name = "FOLDER")]
    data: Option<String>,
    /// Listen beyond this machine although there are neither tokens nor encryption
    #[arg(long)]
    insecure_lan: bool,
    /// Any other setting, e.g. --set limits.queue_max=4
    #[arg(long, value_name = "KEY=VALUE", value_parser = key_and_value)]
    set: Vec<(String, String)>,
}

pub(super) fn run(arguments: &Arguments) -> Outcome {
    if let Some(file) = &arguments.check {
        Layers::default().file(file)?.build()?;
        return print_text(&format!("{} can be used\n", file.display()));
    }
    let config = if arguments.default { Config::default() } else { arguments.sources.config()? };
    print_text(&toml::to_string(&config)?)
}

impl Sources {
    /// A file, if any, and the environment, without flags.
    pub(super) fn of_file(config: Option<PathBuf>) -> Self {
        Self { config, listen: None, data: None, insecure_lan: false, set: Vec::new() }
    }

    /// The resulting configuration, checked.
    pub(super) fn config(&self) -> Result<Config, ConfigError> {
        Ok(self.config_and_ignored()?.0)
    }

    /// The resulting configuration, and the environment variables that have the prefix but name no setting.
    pub(super) fn config_and_ignored(&self) -> Result<(Config, Vec<String>), ConfigError> {
        let mut layers = Layers::default();
        if let Some(file) = &self.config {
            layers = layers.file(file)?;
        }
        layers = layers.environment(std::env::vars_os())?;
        let flags = [("--listen", "listen", &self.listen), ("--data", "data", &self.data)];
        for (flag, key, value) in flags {
            if let Some(value) = value {
                layers = layers.key(flag, key, value)?;
            }
        }
        if self.insecure_lan {
            layers = layers.key("--insecure-lan", "insecure_lan", "true")?;
        }
        for (key, value) in &self.set {
            layers = layers.key("--set", key, value)?;
        }
        let ignored = layers.ignored().to_vec();
        Ok((layers.build()?, ignored))
    }
}

fn key_and_value(text: &str) -> Result<(String, String), String> {
    let (key, value) = text.split_once('=').ok_or("must be KEY=VALUE")?;
    Ok((key.trim().to_owned(), value.trim().to_owned()))
}
