//! Combines a file, the environment and flags, each overriding the previous ones. Input: texts with their origin. Output: a
//! [`Config`].

use super::settings::{Config, ConfigError};
use serde::Deserialize;

use std::ffi::OsString;
use std::path::Path;
use toml::{Table, Value};

/// Prefix of the environment variables: `COAXIS_LISTEN`, `COAXIS_LIMITS__BODY_BYTES_MAX`.
pub const ENVIRONMENT_PREFIX: &str = "COAXIS_";

/// The variable that names the configuration file; it is not a setting.
const FILE_VARIABLE: &str = "COAXIS_CONFIG";

/// The settings collected so far; later ones override earlier ones.
#[derive(Debug, Default)]
pub struct Layers {
    table: Table,
    ignored: Vec<String>,
}

impl Layers {
    /// Adds the content of a file.
    ///
    /// # Errors
    /// [`ConfigError`] if it cannot be read, is not TOML, or has an unknown key or value.
    pub fn file(self, path: &Path) -> Result<Self, ConfigError> {
        let text = std::fs::read_to_string(path)
            .map_err(|source| ConfigError::Unreadable { path: path.to_owned(), source })?;
        self.text(&path.display().to_string(), &text)
    }

    /// Adds a TOML text from `origin`, which error messages name.
    ///
    /// # Errors
    /// [`ConfigError`] if it is not TOML, or has an unknown key or value.
    pub fn text(mut self, origin: &str, text: &str) -> Result<Self, ConfigError> {
        let invalid = |error: toml::de::Error| invalid(origin, &error);
        // It is first parsed as a complete configuration, because the error message then points into the text.
        toml::from_str::<Config>(text).map_err(invalid)?;
        merge(&mut self.table, text.parse().map_err(invalid)?);
        Ok(self)
    }

    /// Adds the environment variables that start with [`ENVIRONMENT_PREFIX`] followed by a key or a section of the configuration;
    /// two underscores separate the levels. Other variables belong to other programs: Kubernetes sets `COAXIS_PORT=tcp://…` for a
    /// service of the name coaxis. [`Layers::ignored`] returns their names.
    ///
    /// # Errors
    /// [`ConfigError`] for a variable with a known section but an unknown key, or with a value that the key does not accept.
    pub fn environment(
        mut self,
        variables: impl IntoIterator<Item = (OsString, OsString)>,
    ) -> Result<Self, ConfigError> {
        let known = Table::try_from(Config::default()).unwrap_or_default();
        for (name, value) in variables {
            // A name that is not UTF-8 cannot be a key.
            let Some(name) = name.to_str() else { continue };
            let Some(rest) = name.strip_prefix(ENVIRONMENT_PREFIX).filter(|_| name != FILE_VARIABLE) else { continue };
            let key = rest.to_ascii_lowercase().replace("__", ".");
            if !key.split('.').next().is_some_and(|first| known.contains_key(first)) {
                self.ignored.push(name.to_owned());
                continue;
            }
            let origin = format!("environment variable {name}");
            let Some(value) = value.to_str() else {
                let reason = format!("the value of {key} is not UTF-8");
                return Err(ConfigError::Invalid { origin, reason });
            };
            self = self.key(&origin, &key, value)?;
        }
        Ok(self)
    }

    /// Variables that start with [`ENVIRONMENT_PREFIX`] but name no key.
    #[must_use]
    pub fn ignored(&self) -> &[String] {
        &self.ignored
    }

    /// Adds one value under its dotted key.
    ///
    /// # Errors
    /// [`ConfigError`] if the key does not exist, or does not accept the value.
    pub fn key(mut self, origin: &str, key: &str, value: &str) -> Result<Self, ConfigError> {
        // The text may be a TOML value or a string, depending on the key; the TOML value is tried first.
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

    /// Combines and checks the configuration.
    ///
    /// # Errors
    /// [`ConfigError`] names the first invalid key.
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

/// Converts `a.b` and a value into `{a = {b = value}}`.
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
    use crate::config::settings::Limits;
    use std::os::unix::ffi::OsStringExt;

    fn variables(pairs: &[(&str, &str)]) -> Vec<(OsString, OsString)> {
        pairs.iter().map(|(name, value)| (OsString::from(name), OsString::from(value))).collect()
    }

    #[test]
    fn variables_that_kubernetes_sets_for_a_service_named_coaxis_are_ignored() {
        let set = variables(&[
            ("COAXIS_PORT", "tcp://10.0.0.1:8080"),
            ("COAXIS_SERVICE_HOST", "10.0.0.1"),
            ("COAXIS_SERVICE_PORT_HTTP", "8080"),
            ("COAXIS_PORT_8080_TCP", "tcp://10.0.0.1:8080"),
            ("COAXIS_CELL_PORT", "tcp://10.0.0.1:8080"),
            ("COAXIS_DATA_SERVICE_HOST", "10.0.0.2"),
            ("COAXIS_LIMITS__QUEUE_MAX", "4"),
        ]);
        let layers = Layers::default().environment(set).expect("other variables are ignored");
        assert_eq!(layers.ignored().len(), 6);
        let config = layers.build().expect("valid");
        let default = Layers::default().build().expect("valid");
        assert!(config == Config { limits: Limits { queue_max: 4, ..Limits::default() }, ..default });
    }

    #[test]
    fn variables_that_are_not_utf_8_are_ignored_unless_they_name_a_setting() {
        let broken = OsString::from_vec(vec![0xff, 0xfe]);
        let name = OsString::from_vec(b"COAXIS_\xff".to_vec());
        let others =
            vec![("LS_COLORS".into(), broken.clone()), (name, "1".into()), ("COAXIS_PORT".into(), broken.clone())];
        let config = Layers::default().environment(others).and_then(Layers::build).expect("valid");
        assert!(config == Layers::default().build().expect("valid"));
        let ours =
            Layers::default().environment([("COAXIS_DATA".into(), broken)]).expect_err("not a value").to_string();
        assert!(ours.contains("COAXIS_DATA") && ours.contains("UTF-8"), "{ours}");
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
    fn a_mistyped_key_is_refused_in_every_source() {
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
