//! The settings of a manipulator behind OPC UA: its server, security, nodes and deadlines. Input: the text of the configuration.
//! Output: checked values.

use super::layout::{Node, steps};
use super::security::{Security, SecurityError};
use crate::device::states::{SameCode, States};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

use std::time::Duration;

/// A manipulator behind an OPC UA server.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Settings {
    /// Address of the server: `opc.tcp://host:port`, followed by a path if it has one.
    pub endpoint: String,
    /// Browse path of the manipulator's node, from Objects: `alias:Name/alias:Name/…`.
    pub device: String,
    /// Namespaces by the aliases that the paths use.
    pub namespaces: BTreeMap<String, String>,
    /// Nodes at other places than docs/opcua.md gives: name of the node, path below the manipulator's node.
    pub nodes: BTreeMap<String, String>,
    /// The numbers of the states: the table of a manufacturer by name, or a custom one.
    pub states: States,
    /// Encryption, and the identity of the client.
    pub security: Security,
    /// Longest time for connecting, checking and the first reading.
    pub connect_ms: u64,
    /// Longest time of a reading.
    pub read_ms: u64,
    /// Longest time until a command has been received.
    pub send_ms: u64,
    /// Age from which the device's heartbeat is stale, by its time stamp and by the time without a change.
    pub stale_ms: u64,
    /// How long the server keeps a session without requests.
    pub session_ms: u64,
}

/// A setting is invalid.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum SettingRefusal {
    /// The endpoint is not the address of an OPC UA server.
    #[error("endpoint must be an address such as opc.tcp://192.168.0.10:4840, got {0:?}")]
    Endpoint(String),
    /// The text is not a path of nodes.
    #[error("{name} must be a path such as di:DeviceSet/own:Cell, got {path:?}")]
    Path {
        /// Name of the setting.
        name: String,
        /// The given path.
        path: String,
    },
    /// A path uses an alias without a namespace.
    #[error("{name} uses the alias {alias:?}, which is missing in namespaces")]
    Alias {
        /// Name of the setting.
        name: String,
        /// The alias.
        alias: String,
    },
    /// There is no node of this name.
    #[error("nodes has no {0:?}; docs/opcua.md lists the names")]
    Node(String),
    /// Two states have the same number.
    #[error("states: {0}")]
    States(#[from] SameCode),
    /// A time is out of its range.
    #[error("{name} must be between {least} and {most}, got {value}")]
    Time {
        /// Name of the setting.
        name: &'static str,
        /// Least allowed value, ms.
        least: u64,
        /// Greatest allowed value, ms.
        most: u64,
        /// Given value, ms.
        value: u64,
    },
    /// The security settings are invalid.
    #[error(transparent)]
    Security(#[from] SecurityError),
}

impl Settings {
    /// The defaults for a manipulator with this id; its device has the id in capitals as its name, e.g. `M1`.
    #[must_use]
    pub fn of(id: &str) -> Self {
        let namespaces = [
            ("di", "http://opcfoundation.org/UA/DI/"),
            ("robotics", "http://opcfoundation.org/UA/Robotics/"),
            ("own", "urn:coaxis:manipulators"),
        ];
        Self {
            endpoint: "opc.tcp://127.0.0.1:4840".to_owned(),
            device: format!("di:DeviceSet/own:Cell/robotics:MotionDevices/own:{}", id.to_uppercase()),
            namespaces: namespaces.map(|(alias, uri)| (alias.to_owned(), uri.to_owned())).into(),
            nodes: BTreeMap::new(),
            states: States::default(),
            security: Security::default(),
            connect_ms: 5_000,
            read_ms: 300,
            send_ms: 300,
            stale_ms: 500,
            session_ms: 5_000,
        }
    }
}

impl Default for Settings {
    fn default() -> Self {
        Self::of("m1")
    }
}

impl Settings {
    /// Checks every value.
    ///
    /// # Errors
    /// [`SettingRefusal`] names the first setting that cannot be used.
    pub fn check(&self) -> Result<(), SettingRefusal> {
        let host = self.endpoint.strip_prefix("opc.tcp://").unwrap_or_default();
        if host.is_empty() || host.starts_with(['/', ':']) || self.endpoint.len() > 1024 {
            return Err(SettingRefusal::Endpoint(self.endpoint.clone()));
        }
        self.check_path("device", &self.device)?;
        for (key, path) in &self.nodes {
            if !Node::all().any(|node| node.key() == *key) {
                return Err(SettingRefusal::Node(key.clone()));
            }
            self.check_path(&format!("nodes.{key:?}"), path)?;
        }
        for node in Node::all() {
            self.check_path(&node.key(), &self.path(node))?;
        }
        self.states.check()?;
        self.check_times()?;
        self.security.check()?;
        Ok(())
    }

    fn check_path(&self, name: &str, path: &str) -> Result<(), SettingRefusal> {
        let wrong = || SettingRefusal::Path { name: name.to_owned(), path: path.to_owned() };
        let unknown = |alias: &str| SettingRefusal::Alias { name: name.to_owned(), alias: alias.to_owned() };
        let aliases = steps(path).ok_or_else(wrong)?;
        match aliases.iter().filter_map(|step| step.alias).find(|alias| !self.namespaces.contains_key(*alias)) {
            Some(alias) => Err(unknown(alias)),
            None => Ok(()),
        }
    }

    fn check_times(&self) -> Result<(), SettingRefusal> {
        let times = [
            ("connect_ms", self.connect_ms, 100, 60_000),
            ("read_ms", self.read_ms, 10, 300),
            ("send_ms", self.send_ms, 10, 300),
            ("stale_ms", self.stale_ms, 50, 5_000),
            ("session_ms", self.session_ms, 1_000, 600_000),
        ];
        match times.into_iter().find(|(_, value, least, most)| !(least..=most).contains(&value)) {
            Some((name, value, least, most)) => Err(SettingRefusal::Time { name, least, most, value }),
            None => Ok(()),
        }
    }

    /// The path of a node from Objects.
    pub(super) fn path(&self, node: Node) -> String {
        let below = self.nodes.get(&node.key()).cloned().unwrap_or_else(|| node.path());
        format!("{}/{below}", self.device)
    }

    pub(super) const fn connect_within(&self) -> Duration {
        Duration::from_millis(self.connect_ms)
    }

    pub(super) const fn read_within(&self) -> Duration {
        Duration::from_millis(self.read_ms)
    }

    pub(super) const fn send_within(&self) -> Duration {
        Duration::from_millis(self.send_ms)
    }

    pub(super) const fn stale_after(&self) -> Duration {
        Duration::from_millis(self.stale_ms)
    }
}

#[cfg(test)]
mod tests {
    use super::super::security::Policy;
    use super::*;
    use crate::device::StateCodes;

    fn refused(change: impl Fn(&mut Settings)) -> String {
        let mut settings = Settings::default();
        change(&mut settings);
        settings.check().expect_err("refused").to_string()
    }

    #[test]
    fn the_defaults_are_valid_and_within_the_deadlines_of_the_cell() {
        let settings = Settings::default();
        assert_eq!(settings.check(), Ok(()));
        assert!(settings.read_ms <= 300 && settings.send_ms <= 300);
    }

    #[test]
    fn an_invalid_value_is_refused_by_name() {
        assert!(refused(|s| s.endpoint = "http://plc".into()).starts_with("endpoint must be"));
        assert!(refused(|s| s.endpoint = "opc.tcp://".into()).starts_with("endpoint must be"));
        assert!(refused(|s| s.device = "di:Set//x".into()).starts_with("device must be a path"));
        assert!(refused(|s| s.device = "siemens:Set".into()).contains("the alias \"siemens\""));
        assert!(refused(|s| drop(s.namespaces.remove("di"))).contains("the alias \"di\""));
        assert!(refused(|s| drop(s.nodes.insert("status.nothing".into(), "own:A".into()))).contains("status.nothing"));
        assert!(refused(|s| drop(s.nodes.insert("status.state".into(), "x:A".into()))).contains("alias"));
        let twice = States::Table(StateCodes { homing: 1, ..States::default().codes() });
        assert_eq!(refused(|s| s.states = twice), "states: disabled and homing are both 1");
        assert!(refused(|s| s.read_ms = 301).contains("read_ms must be between 10 and 300, got 301"));
    }

    #[test]
    fn a_node_may_be_given_another_path() {
        let mut settings = Settings { device: "own:Plc".into(), ..Settings::default() };
        settings.nodes.insert("status.state".into(), "own:Db7/own:AxisState".into());
        assert_eq!(settings.check(), Ok(()));
        assert_eq!(settings.path(Node::State), "own:Plc/own:Db7/own:AxisState");
        assert_eq!(settings.path(Node::Mode), "own:Plc/own:Status/own:Mode");
    }

    #[test]
    fn an_unknown_key_is_refused() {
        let wrong: Result<Settings, _> = toml::from_str("endpont = \"opc.tcp://plc\"");
        assert!(wrong.expect_err("refused").to_string().contains("endpont"));
        let right: Settings = toml::from_str("[security]\npolicy = \"basic256_sha256\"").expect("settings");
        assert_eq!(right.security.policy, Policy::Basic256Sha256);
    }
}
