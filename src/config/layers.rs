//! Puts a file, the environment and flags on top of each other. In: texts with their origin; out: a [`Config`].
//! Must not know what a key means.

use super::{Config, ConfigError};
use serde::Deserialize;
use std::path::Path;
use toml::{Table, Value};

/// What a variable of the environment starts with: `COAXIS_LISTEN`, `COAXIS_LIMITS__BODY_BYTES_MAX`.
pub const ENVIRONMENT_PREFIX: &str = "COAXIS_";

/// Names the configuration file; the one variable that is not a key.
const FILE_VARIABLE: &str = "COAXIS_CONFIG";

/// Settings collected so far, later ones over earlier ones.
#[derive(Debug, Default)]
pub struct Layers {
    table: Table,
}

impl Layers {
    /// The content of a file.
    ///
    /// # Errors
    /// [`ConfigError`] where it cannot be read, is not TOML, or has a key or value that is not known.
    pub fn file(self, path: &Path) -> Result<Self, ConfigError> {
        let text = std::fs::read_to_string(path)
            .map_err(|source| ConfigError::Unreadable { path: path.to_owned(), source })?;
        self.text(&path.display().to_string(), &text)
    }

    /// TOML from anywhere, `origin` in words.
    ///
    /// # Errors
    /// [`ConfigError`] where it is not TOML, or has a key or value that is not known.
    pub fn text(mut self, origin: &str, text: &str) -> Result<Self, ConfigError> {
        let invalid = |error: toml::de::Error| invalid(origin, &error);
        // Read as a whole configuration first: the message then points into the text.
        toml::from_str::<Config>(text).map_err(invalid)?;
        merge(&mut self.table, text.parse().map_err(invalid)?);
        Ok(self)
    }

    /// The variables that start with [`ENVIRONMENT_PREFIX`]; two underscores go down a level.
    ///
    /// # Errors
    /// [`ConfigError`] for a variable that names no key, or whose value the key cannot take.
    pub fn environment(mut self, variables: impl IntoIterator<Item = (String, String)>) -> Result<Self, ConfigError> {
        for (name, value) in variables {
            if let Some(rest) = name.strip_prefix(ENVIRONMENT_PREFIX).filter(|_| name != FILE_VARIABLE) {
                let key = rest.to_ascii_lowercase().replace("__", ".");
                self = self.key(&format!("environment variable {name}"), &key, &value)?;
            }
        }
        Ok(self)
    }

    /// One value under its dotted key.
    ///
    /// # Errors
    /// [`ConfigError`] where there is no such key, or it cannot take the value.
    pub fn key(mut self, origin: &str, key: &str, value: &str) -> Result<Self, ConfigError> {
        // The same text may be a number or a word; the key decides, so the likelier reading is tried first.
        let readings = [format!("v = {value}").parse::<Table>().ok().and_then(|mut t| t.remove("v")), {
            Some(Value::String(value.to_owned()))
        }];
        let mut refusal = None;
        for reading in readings.into_iter().flatten() {
            let layer = nested(key, reading);
            match Config::deserialize(layer.clone()) {
                Ok(_) => {
                    merge(&mut self.table, layer);
                    return Ok(self);
                }
                Err(error) => refusal = refusal.or(Some(error)),
            }
        }
        Err(refusal.map_or_else(
            || ConfigError::Invalid { origin: origin.to_owned(), reason: format!("{key} cannot be {value}") },
            |error| ConfigError::Invalid {
                origin: origin.to_owned(),
                reason: format!("{key} = {value}: {}", error.message()),
            },
        ))
    }

    /// The configuration that results, checked.
    ///
    /// # Errors
    /// [`ConfigError`] names the first key that cannot be used.
    pub fn build(self) -> Result<Config, ConfigError> {
        let mut config = Config::deserialize(self.table).map_err(|error| invalid("configuration", &error))?;
        config.check()?;
        config.cell.keep_below(&config.data);
        Ok(config)
    }
}

fn invalid(origin: &str, error: &toml::de::Error) -> ConfigError {
    ConfigError::Invalid { origin: origin.to_owned(), reason: error.to_string().trim_end().to_owned() }
}

/// `a.b` and a value make `{a = {b = value}}`.
fn nested(key: &str, value: Value) -> Table {
    let (head, value) = match key.split_once('.') {
        Some((head, rest)) => (head, Value::Table(nested(rest, value))),
        None => (key, value),
    };
    Table::from_iter([(head.to_owned(), value)])
}

fn merge(under: &mut Table, over: Table) {
    for (key, value) in over {
        match (under.get_mut(&key), value) {
            (Some(Value::Table(under)), Value::Table(over)) => merge(under, over),
            (_, value) => {
                under.insert(key, value);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn variables(pairs: &[(&str, &str)]) -> Vec<(String, String)> {
        pairs.iter().map(|(name, value)| ((*name).to_owned(), (*value).to_owned())).collect()
    }

    #[test]
    fn the_environment_overrides_the_file_and_a_flag_overrides_both() {
        let config = Layers::default()
            .text("file", "data = 'a'\n[limits]\nqueue_max = 3\nthreads = 7")
            .and_then(|l| {
                l.environment(variables(&[("COAXIS_LIMITS__QUEUE_MAX", "4"), ("COAXIS_DATA", "7"), ("X", "")]))
            })
            .and_then(|l| l.key("flag", "listen", "127.0.0.1:0"))
            .and_then(Layers::build)
            .expect("valid");
        assert_eq!((config.limits.queue_max, config.limits.threads), (4, 7));
        assert_eq!(config.data, Path::new("7"), "a folder may look like a number");
        assert_eq!(config.listen.port(), 0);
    }

    #[test]
    fn a_mistyped_key_is_refused_wherever_it_stands() {
        let file = Layers::default().text("coaxis.toml", "[limits]\nqueue_mx = 3").expect_err("unknown").to_string();
        assert!(file.contains("coaxis.toml") && file.contains("queue_mx"), "{file}");
        let variable = Layers::default().environment(variables(&[("COAXIS_LIMITS__QUEUE_MX", "3")]));
        let variable = variable.expect_err("unknown").to_string();
        assert!(variable.contains("COAXIS_LIMITS__QUEUE_MX") && variable.contains("queue_mx"), "{variable}");
    }

    #[test]
    fn a_value_of_the_wrong_kind_is_refused_with_key_and_value() {
        let error = Layers::default().key("--set", "limits.queue_max", "many").expect_err("no number").to_string();
        assert!(error.contains("limits.queue_max = many"), "{error}");
    }
}
