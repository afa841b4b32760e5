//! The settings of the service with their defaults and ranges. The host names may be a list, or a single text with commas, as in an
//! environment variable.

use std::net::{Ipv4Addr, SocketAddr};
use std::path::PathBuf;

use serde::de::Error;
use serde::{Deserialize, Deserializer, Serialize};

use super::cell::CellError;
use super::cell::settings::{Cell, over_default};
use crate::estimation::{SettingError, Settings};
use crate::scan::decode::Limits as ScanLimits;

/// The settings of the service.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Config {
    /// Address and port to listen on, or localhost and a port; port 0 selects a free one.
    #[serde(deserialize_with = "address")]
    pub listen: SocketAddr,
    /// Folder for records and scans; created if it is missing.
    pub data: PathBuf,
    /// Listen on an address that other machines can reach, although there are neither tokens nor encryption: everybody on the
    /// network may measure, read, and store recipes.
    pub insecure_lan: bool,
    /// Names under which the service is reached, besides its addresses and localhost. Requests for another host are refused,
    /// because its name may belong to an attacker and resolve to this machine.
    #[serde(deserialize_with = "host_names")]
    pub hosts: Vec<String>,
    /// Format and filter of the log.
    pub log: Log,
    /// Limits of sizes and numbers.
    pub limits: Limits,
    /// Limits of a scan file.
    pub scan: ScanLimits,
    /// Limits of times.
    pub timeouts: Timeouts,
    /// The default settings of a measurement; a request or its recipe may override them.
    pub estimation: Settings,
    /// The devices that scan and move the part.
    #[serde(deserialize_with = "over_default")]
    pub cell: Cell,
}

/// Parses an address with a port. Names are not resolved, except localhost.
fn address<'de, D: Deserializer<'de>>(text: D) -> Result<SocketAddr, D::Error> {
    let text = String::deserialize(text)?;
    let on_this_machine = || {
        let (host, port) = text.rsplit_once(':')?;
        host.eq_ignore_ascii_case("localhost").then(|| port.parse().ok().map(|port| (Ipv4Addr::LOCALHOST, port)))?
    };
    text.parse().ok().or_else(|| on_this_machine().map(SocketAddr::from)).ok_or_else(|| {
        Error::custom(
            "must be an address and a port such as 127.0.0.1:8080, [::1]:8080 or localhost:8080; other names are not looked up",
        )
    })
}

/// Settings of the log on standard error.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Log {
    /// Format for people or for machines.
    pub format: LogFormat,
    /// Filter: error, warn, info, debug, trace, or e.g. `info,coaxis::http=debug`.
    pub filter: String,
}

/// The format of log lines.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum LogFormat {
    /// Plain text.
    #[default]
    Text,
    /// One JSON document per line.
    Json,
}

/// Limits of sizes and numbers.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Limits {
    /// Greatest size of an upload as sent, bytes.
    pub body_bytes_max: u64,
    /// Greatest size of a JSON request, bytes; a scan in JSON counts as an upload.
    pub json_bytes_max: u64,
    /// Greatest length of the URL after the host, bytes.
    pub url_bytes_max: u64,
    /// Greatest size of all header lines, bytes.
    pub header_bytes_max: u64,
    /// Greatest number of connections. On `connections_reserved` further ones only urgent requests are answered.
    pub connections_max: u64,
    /// Additional connections for stop, health checks and the holder of the lease.
    pub connections_reserved: u64,
    /// Greatest share of the connections, uploads and waits for one client address, per cent. Behind a proxy all clients have the
    /// same address.
    pub peer_share_percent: u64,
    /// Least speed of sending a body and of receiving an answer, bytes per second; slower transfers are ended.
    pub bytes_per_s_min: u64,
    /// Greatest number of event streams and waits for an end, never more than half of the connections; a further one is answered
    /// 503.
    pub listeners_max: u64,
    /// Number of measurements calculated at the same time, and of large uploads parsed while they are received.
    pub measurements_running_max: u64,
    /// Number of measurements that may wait for a calculation; a further one is answered 503.
    pub queue_max: u64,
    /// Number of uploads from their first byte until the scan is kept or refused; a further one is answered 503.
    pub uploads_max: u64,
    /// Number of plots drawn at the same time, besides the measurements.
    pub pictures_running_max: u64,
    /// Number of plots that may wait; a further one is answered 503.
    pub pictures_queue_max: u64,
    /// Number of threads for calculations; 0 means one per core.
    pub threads: u64,
    /// Memory for the points of all requests together, MiB. The memory that a request may need is reserved before its scan is read,
    /// and the request waits until enough is free. If a scan of `scan.points_max` may need more than five eighths of it, fewer
    /// points are read.
    pub memory_max_mb: u64,
}

/// Limits of times.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Timeouts {
    /// From the first byte of a request, or the end of the previous one, to the end of its header lines.
    pub header_ms: u64,
    /// Between two parts of a body.
    pub body_idle_ms: u64,
    /// For the complete body.
    pub body_total_ms: u64,
    /// For a client that receives nothing of an answer.
    pub response_idle_ms: u64,
    /// For one calculation, from its start.
    pub calculation_ms: u64,
    /// For the complete shutdown after the signal: stopping motion, answering the requests under way, recording events.
    pub shutdown_ms: u64,
}

impl Default for Config {
    fn default() -> Self {
        Self {
            listen: SocketAddr::from(([127, 0, 0, 1], 8080)),
            data: PathBuf::from("data"),
            insecure_lan: false,
            hosts: Vec::new(),
            log: Log::default(),
            limits: Limits::default(),
            scan: ScanLimits::default(),
            timeouts: Timeouts::default(),
            estimation: Settings::default(),
            cell: Cell::default(),
        }
    }
}

impl Default for Log {
    fn default() -> Self {
        Self { format: LogFormat::Text, filter: "info".to_owned() }
    }
}

impl Default for Limits {
    fn default() -> Self {
        Self {
            body_bytes_max: 256 << 20,
            json_bytes_max: 64 << 10,
            url_bytes_max: 4 << 10,
            header_bytes_max: 16 << 10,
            connections_max: 512,
            connections_reserved: 128,
            peer_share_percent: 50,
            bytes_per_s_min: 1024,
            listeners_max: 200,
            measurements_running_max: 2,
            queue_max: 16,
            uploads_max: 128,
            pictures_running_max: 1,
            pictures_queue_max: 64,
            threads: 0,
            memory_max_mb: 4096,
        }
    }
}

impl Default for Timeouts {
    fn default() -> Self {
        Self {
            header_ms: 10_000,
            body_idle_ms: 10_000,
            body_total_ms: 120_000,
            response_idle_ms: 10_000,
            calculation_ms: 60_000,
            shutdown_ms: 12_000,
        }
    }
}

/// Why the service does not start with these settings.
#[derive(Debug, thiserror::Error)]
pub enum ConfigError {
    /// The file cannot be read.
    #[error("cannot read the configuration file {path}")]
    Unreadable {
        /// The path of the file.
        path: PathBuf,
        /// The error of the operating system.
        source: std::io::Error,
    },
    /// The text is not TOML, has an unknown key, or has a value of the wrong type.
    #[error("{origin}: {reason}")]
    Invalid {
        /// File, environment variable or flag.
        origin: String,
        /// The fault, with its key.
        reason: String,
    },
    /// A number is out of its range.
    #[error("{key} must be between {min} and {max}, got {value}")]
    OutOfRange {
        /// Dotted key.
        key: &'static str,
        /// The given value.
        value: u64,
        /// Least allowed value.
        min: u64,
        /// Greatest allowed value.
        max: u64,
    },
    /// The limit of the coordinates is too small.
    #[error("scan.coordinate_max_mm must be a finite length of at least 1 mm, got {value}")]
    Coordinate {
        /// The given value.
        value: f64,
    },
    /// A value is empty.
    #[error("{key} must not be empty")]
    Empty {
        /// Dotted key.
        key: &'static str,
    },
    /// A setting of the estimation is out of its range.
    #[error("estimation.{0}")]
    Estimation(#[from] SettingError),
    /// A setting of the cell cannot be used.
    #[error(transparent)]
    Cell(#[from] CellError),
    /// The service would be reachable from the network without protection.
    #[error(
        "listen = \"{listen}\" is reachable from other machines, and the service asks nobody for a token: everybody on \
         the network could use it. Listen on 127.0.0.1, or say --insecure-lan (insecure_lan = true) where the network \
         itself keeps strangers out"
    )]
    OpenToTheNetwork {
        /// The requested address.
        listen: SocketAddr,
    },
}

impl Config {
    /// Checks every value against its range.
    ///
    /// # Errors
    /// [`ConfigError`] names the first invalid key, its value and the allowed values.
    pub fn check(&self) -> Result<(), ConfigError> {
        if let Some(&(key, value, min, max)) =
            self.ranges().iter().find(|(_, value, min, max)| !(min..=max).contains(&value))
        {
            return Err(ConfigError::OutOfRange { key, value, min, max });
        }
        let coordinate = self.scan.coordinate_max_mm;
        if !(coordinate.is_finite() && coordinate >= 1.0) {
            return Err(ConfigError::Coordinate { value: coordinate });
        }
        if self.data.as_os_str().is_empty() {
            return Err(ConfigError::Empty { key: "data" });
        }
        if self.log.filter.trim().is_empty() {
            return Err(ConfigError::Empty { key: "log.filter" });
        }
        self.estimation.check()?;
        self.cell.check()?;
        if !self.listen.ip().is_loopback() && !self.insecure_lan {
            return Err(ConfigError::OpenToTheNetwork { listen: self.listen });
        }
        Ok(())
    }

    /// Every number of the configuration with its least and greatest value.
    fn ranges(&self) -> [(&'static str, u64, u64, u64); 31] {
        let (limits, scan, timeouts) = (&self.limits, &self.scan, &self.timeouts);
        let wide = |count: usize| u64::try_from(count).unwrap_or(u64::MAX);
        let hour = 3_600_000;
        [
            ("limits.body_bytes_max", limits.body_bytes_max, 1 << 10, 64 << 30),
            ("limits.json_bytes_max", limits.json_bytes_max, 1 << 10, 16 << 20),
            ("limits.url_bytes_max", limits.url_bytes_max, 256, 64_000),
            ("limits.header_bytes_max", limits.header_bytes_max, 1 << 10, 256 << 10),
            ("limits.connections_max", limits.connections_max, 1, 100_000),
            ("limits.connections_reserved", limits.connections_reserved, 1, 1024),
            ("limits.peer_share_percent", limits.peer_share_percent, 1, 100),
            ("limits.bytes_per_s_min", limits.bytes_per_s_min, 0, 1 << 30),
            ("limits.listeners_max", limits.listeners_max, 1, 100_000),
            ("scan.points_max", wide(scan.points_max), 6, 1 << 32),
            ("scan.profiles_max", wide(scan.profiles_max), 2, 10_000_000),
            ("scan.points_per_profile_max", wide(scan.points_per_profile_max), 6, 10_000_000),
            ("scan.columns_max", wide(scan.columns_max), 3, 100_000),
            ("scan.header_lines_max", wide(scan.header_lines_max), 16, 1_000_000),
            ("scan.line_bytes_max", wide(scan.line_bytes_max), 256, 1 << 30),
            ("scan.npz_entries_max", wide(scan.npz_entries_max), 1, 100_000),
            ("scan.inflated_bytes_max", scan.inflated_bytes_max, 1 << 10, 64 << 30),
            ("scan.inflate_ratio_max", scan.inflate_ratio_max, 1, 10_000),
            ("limits.measurements_running_max", limits.measurements_running_max, 1, 1024),
            ("limits.queue_max", limits.queue_max, 0, 100_000),
            ("limits.uploads_max", limits.uploads_max, 1, 100_000),
            ("limits.pictures_running_max", limits.pictures_running_max, 1, 1024),
            ("limits.pictures_queue_max", limits.pictures_queue_max, 0, 100_000),
            ("limits.threads", limits.threads, 0, 1024),
            ("limits.memory_max_mb", limits.memory_max_mb, 1024, 1 << 20),
            ("timeouts.header_ms", timeouts.header_ms, 10, hour),
            ("timeouts.body_idle_ms", timeouts.body_idle_ms, 10, hour),
            ("timeouts.body_total_ms", timeouts.body_total_ms, 10, 24 * hour),
            ("timeouts.response_idle_ms", timeouts.response_idle_ms, 10, hour),
            ("timeouts.calculation_ms", timeouts.calculation_ms, 10, hour),
            ("timeouts.shutdown_ms", timeouts.shutdown_ms, 1, hour),
        ]
    }
}

#[derive(Deserialize)]
#[serde(untagged)]
enum Given {
    List(Vec<String>),
    Text(String),
}

fn host_names<'de, D: Deserializer<'de>>(given: D) -> Result<Vec<String>, D::Error> {
    let names = match Given::deserialize(given) {
        Ok(Given::List(names)) => names,
        Ok(Given::Text(text)) => {
            text.split(',').map(|name| name.trim().to_owned()).filter(|name| !name.is_empty()).collect()
        }
        Err(_) => return Err(D::Error::custom("must be a list of names of hosts such as [\"line3.example\"]")),
    };
    match names.iter().find(|name| !is_name(name)) {
        None => Ok(names),
        Some(other) => Err(D::Error::custom(format!(
            "must be names of hosts without scheme, port and path such as line3.example, got \"{other}\""
        ))),
    }
}

fn is_name(name: &str) -> bool {
    let plain = |b: u8| b.is_ascii_alphanumeric() || matches!(b, b'-' | b'_' | b'.');
    !name.is_empty() && name.len() <= 253 && !name.ends_with('.') && name.bytes().all(plain)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::layers::Layers;
    use std::collections::BTreeMap;

    #[test]
    fn the_defaults_are_valid() {
        Config::default().check().expect("the defaults are in range");
    }

    #[test]
    fn every_number_of_the_configuration_has_a_range() {
        let table = toml::Table::try_from(Config::default()).expect("serializable");
        let numbers: usize =
            ["limits", "scan", "timeouts"].iter().map(|s| table[*s].as_table().expect("section").len()).sum();
        // The only number that is not an integer has a check of its own.
        assert_eq!(numbers, Config::default().ranges().len() + 1);
    }

    #[test]
    fn localhost_is_an_address_to_listen_on_and_other_names_are_not_looked_up() {
        let listen = |text: &str| {
            Layers::default()
                .key("--listen", "listen", text)
                .and_then(Layers::build)
                .map(|config| config.listen.to_string())
        };
        assert_eq!(listen("localhost:8080").ok().as_deref(), Some("127.0.0.1:8080"));
        assert_eq!(listen("LOCALHOST:0").ok().as_deref(), Some("127.0.0.1:0"));
        assert_eq!(listen("[::1]:8080").ok().as_deref(), Some("[::1]:8080"));
        for wrong in ["localhost", "localhost:", "localhost:99999", "line3.example:8080", ":8080"] {
            let error = listen(wrong).expect_err(wrong).to_string();
            assert!(error.contains("localhost:8080") && error.contains(wrong), "{error}");
        }
    }

    #[test]
    fn the_shutdown_fits_into_the_grace_period_of_the_compose_file() {
        let compose = include_str!("../../docker/compose.yaml");
        let grace = compose.lines().find_map(|line| line.trim().strip_prefix("stop_grace_period: ")?.strip_suffix('s'));
        let grace_ms = grace.and_then(|seconds| seconds.parse::<u64>().ok()).expect("a grace period in seconds") * 1000;
        // The end of the process's threads and the container itself need additional time.
        assert!(Config::default().timeouts.shutdown_ms + 2_000 <= grace_ms, "{grace_ms} ms");
    }

    #[test]
    fn an_invalid_value_is_refused_with_key_value_and_allowed_range() {
        let mut config = Config::default();
        config.limits.measurements_running_max = 0;
        let text = config.check().expect_err("refused").to_string();
        assert_eq!(text, "limits.measurements_running_max must be between 1 and 1024, got 0");
    }

    #[test]
    fn an_address_beyond_this_machine_needs_an_additional_setting() {
        let mut config = Config { listen: SocketAddr::from(([0, 0, 0, 0], 8080)), ..Config::default() };
        assert!(matches!(config.check(), Err(ConfigError::OpenToTheNetwork { .. })));
        config.insecure_lan = true;
        config.check().expect("allowed by the setting");
    }

    /// Collects dotted key and value of every entry that is not a section.
    fn leaves(table: &toml::Table, prefix: &str, out: &mut BTreeMap<String, toml::Value>) {
        for (key, value) in table {
            let key = if prefix.is_empty() { key.clone() } else { format!("{prefix}.{key}") };
            match value {
                toml::Value::Table(table) => leaves(table, &key, out),
                value => drop(out.insert(key, value.clone())),
            }
        }
    }

    #[test]
    fn the_example_for_a_container_shows_every_key_with_its_default() {
        let example = include_str!("../../docker/coaxis.toml");
        Layers::default().text("docker/coaxis.toml", example).and_then(Layers::build).expect("a valid configuration");
        let (mut shown, mut due) = (BTreeMap::new(), BTreeMap::new());
        leaves(&example.parse().expect("TOML"), "", &mut shown);
        leaves(&toml::Table::try_from(Config::default()).expect("serializable"), "", &mut due);
        // The image sets the first three; the adaptors have their own documentation pages.
        let elsewhere = |key: &str| {
            ["listen", "data", "insecure_lan"].contains(&key)
                || [".modbus.", ".opcua.", ".gocator."].iter().any(|part| key.contains(part))
        };
        due.retain(|key, _| !elsewhere(key));
        due.insert("log.format".to_owned(), "json".into());
        for (key, value) in &due {
            assert_eq!(shown.get(key), Some(value), "{key}");
        }
        let more: Vec<_> = shown.keys().filter(|key| !due.contains_key(*key)).collect();
        assert!(more.is_empty(), "{more:?} has no default");
    }
}

#[cfg(test)]
mod host_tests {
    use crate::config::Layers;

    fn hosts(value: &str) -> Result<Vec<String>, String> {
        let layers = Layers::default().environment([("COAXIS_HOSTS".into(), value.into())]);
        layers.and_then(Layers::build).map(|config| config.hosts).map_err(|error| error.to_string())
    }

    #[test]
    fn host_names_are_a_list_or_a_text_with_commas() {
        assert_eq!(hosts("line3.example").as_deref(), Ok(&["line3.example".to_owned()][..]));
        assert_eq!(hosts("line3, line4").as_deref(), Ok(&["line3".to_owned(), "line4".to_owned()][..]));
        assert_eq!(hosts("[\"line3\"]").as_deref(), Ok(&["line3".to_owned()][..]));
        assert_eq!(hosts("").as_deref(), Ok(&[][..]));
        for wrong in ["http://line3", "line3:8080", "line3/", "*", "line 3"] {
            assert!(hosts(wrong).is_err_and(|error| error.contains("names of hosts")), "{wrong}");
        }
    }
}
