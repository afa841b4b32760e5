//! The settings of a Gocator, which are checked before connecting. Lengths in mm, times in ms.

use super::extrinsic::{Extrinsic, ExtrinsicError, Placement};
use super::travel::{Travel, TravelError};
use serde::{Deserialize, Serialize};
use std::time::Duration;

/// Largest frame size that can be configured; a frame is kept in memory.
const FRAME_MB_MAX: u32 = 256;
const DEADLINE_MS_MAX: u32 = 3_600_000;

/// The address, the mounting and the deadlines of the sensor.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Settings {
    /// Host name or address; the manufacturer's default is 192.168.1.10.
    pub host: String,
    /// Port of the control channel.
    pub control_port: u16,
    /// Port of the data channel.
    pub data_port: u16,
    /// Port of the health channel.
    pub health_port: u16,
    /// Serial number; another sensor is refused. If it is missing, any sensor is accepted.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub serial: Option<u32>,
    /// The determination of x for each profile; required.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub travel: Option<Travel>,
    /// The mounting of the sensor; required.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub extrinsic: Option<Extrinsic>,
    /// The deadlines.
    pub deadlines: Deadlines,
    /// Largest frame; a surface of 3389 × 4033 points has 27 MB.
    pub frame_mb_max: u32,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            host: "192.168.1.10".to_owned(),
            control_port: 3190,
            data_port: 3196,
            health_port: 3194,
            serial: None,
            travel: None,
            extrinsic: None,
            deadlines: Deadlines::default(),
            frame_mb_max: 64,
        }
    }
}

/// The deadlines, ms.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Deadlines {
    /// Time for connecting.
    pub connect_ms: u32,
    /// Time for a reply.
    pub reply_ms: u32,
    /// Time for the reply to start and stop: the sensor may take seconds.
    pub start_stop_ms: u32,
    /// Time until the first profile after the start: the stage has to accelerate, and a surface is sent at the end of the scan.
    pub first_profile_ms: u32,
    /// Time between two profiles.
    pub next_profile_ms: u32,
    /// Time between two health messages, of which the sensor sends one about every second.
    pub health_ms: u32,
}

impl Default for Deadlines {
    fn default() -> Self {
        Self {
            connect_ms: 3_000,
            reply_ms: 3_000,
            start_stop_ms: 15_000,
            first_profile_ms: 30_000,
            next_profile_ms: 2_000,
            health_ms: 5_000,
        }
    }
}

pub(super) fn duration(ms: u32) -> Duration {
    Duration::from_millis(ms.into())
}

/// Why settings cannot be used.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum SettingsError {
    /// The host is empty.
    #[error("host must name the sensor, e.g. 192.168.1.10")]
    NoHost,
    /// A port is 0.
    #[error("{field} must be between 1 and 65535")]
    Port {
        /// Name of the setting.
        field: &'static str,
    },
    /// The rule for the travel is missing.
    #[error(
        "travel must be stated, e.g. travel = {{ by = \"encoder\", mm_per_tick = 0.01 }} or travel = {{ by = \"time\", speed_mm_s = 50.0 }}"
    )]
    NoTravel,
    /// The rule for the travel is not valid.
    #[error(transparent)]
    Travel(#[from] TravelError),
    /// The extrinsic is missing.
    #[error(
        "extrinsic must be stated: sensor_x, sensor_y and sensor_z in the rail frame, mirrored, and translation_mm; no mounting is assumed"
    )]
    NoExtrinsic,
    /// The extrinsic is not valid.
    #[error("extrinsic: {0}")]
    Extrinsic(#[from] ExtrinsicError),
    /// A number is out of its range.
    #[error("{field} must be between 1 and {most}, got {value}")]
    OutOfRange {
        /// Name of the setting.
        field: &'static str,
        /// Its value.
        value: u32,
        /// Greatest allowed value.
        most: u32,
    },
}

/// Settings that were checked.
#[derive(Debug, Clone)]
pub(super) struct Checked {
    pub(super) settings: Settings,
    pub(super) travel: Travel,
    pub(super) placement: Placement,
}

impl Settings {
    /// Checks the settings.
    ///
    /// # Errors
    /// [`SettingsError`] names the first invalid setting.
    pub fn check(&self) -> Result<(), SettingsError> {
        self.checked().map(|_| ())
    }

    pub(super) fn checked(&self) -> Result<Checked, SettingsError> {
        if self.host.trim().is_empty() {
            return Err(SettingsError::NoHost);
        }
        let ports =
            [("control_port", self.control_port), ("data_port", self.data_port), ("health_port", self.health_port)];
        if let Some((field, _)) = ports.into_iter().find(|(_, port)| *port == 0) {
            return Err(SettingsError::Port { field });
        }
        if let Some((field, value, most)) = self.ranges().into_iter().find(|(_, v, most)| !(1..=*most).contains(v)) {
            return Err(SettingsError::OutOfRange { field, value, most });
        }
        let travel = self.travel.ok_or(SettingsError::NoTravel)?;
        travel.check()?;
        let placement = self.extrinsic.ok_or(SettingsError::NoExtrinsic)?.place()?;
        Ok(Checked { settings: self.clone(), travel, placement })
    }

    fn ranges(&self) -> [(&'static str, u32, u32); 7] {
        let Deadlines { connect_ms, reply_ms, start_stop_ms, first_profile_ms, next_profile_ms, health_ms } =
            self.deadlines;
        [
            ("frame_mb_max", self.frame_mb_max, FRAME_MB_MAX),
            ("deadlines.connect_ms", connect_ms, DEADLINE_MS_MAX),
            ("deadlines.reply_ms", reply_ms, DEADLINE_MS_MAX),
            ("deadlines.start_stop_ms", start_stop_ms, DEADLINE_MS_MAX),
            ("deadlines.first_profile_ms", first_profile_ms, DEADLINE_MS_MAX),
            ("deadlines.next_profile_ms", next_profile_ms, DEADLINE_MS_MAX),
            ("deadlines.health_ms", health_ms, DEADLINE_MS_MAX),
        ]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const DOCUMENT: &str = r#"
        host = "10.0.0.5"
        serial = 40959
        travel = { by = "encoder", mm_per_tick = -0.0125, start_mm = 100.0 }

        [extrinsic]
        sensor_x = [0.0, 1.0, 0.0]
        sensor_y = [1.0, 0.0, 0.0]
        sensor_z = [0.0, 0.0, 1.0]
        mirrored = true
        translation_mm = [0.0, 0.0, 150.0]

        [deadlines]
        next_profile_ms = 500
    "#;

    fn read(document: &str) -> Result<Settings, toml::de::Error> {
        toml::from_str(document)
    }

    #[test]
    fn the_documented_settings_are_parsed_and_missing_ones_have_defaults() {
        let settings = read(DOCUMENT).expect("valid");
        assert_eq!(settings.check(), Ok(()));
        assert_eq!((settings.control_port, settings.data_port, settings.health_port), (3190, 3196, 3194));
        assert_eq!(settings.deadlines, Deadlines { next_profile_ms: 500, ..Deadlines::default() });
    }

    #[test]
    fn an_unknown_key_or_word_is_refused_everywhere() {
        for (found, replaced) in [
            ("host =", "hosts ="),
            ("mm_per_tick", "mm_per_ticks"),
            ("mm_per_tick = -0.0125,", "mm_per_tick = -0.0125, speed_mm_s = 1.0,"),
            ("mirrored = true", "mirrored = true\nmirror = true"),
            ("next_profile_ms", "next_ms"),
        ] {
            assert!(read(&DOCUMENT.replace(found, replaced)).is_err(), "{replaced}");
        }
    }

    #[test]
    fn mounting_and_travel_are_required() {
        assert_eq!(Settings::default().check(), Err(SettingsError::NoTravel));
        let travel = Some(Travel::Time { speed_mm_s: 1.0, start_mm: 0.0 });
        assert_eq!(Settings { travel, ..Settings::default() }.check(), Err(SettingsError::NoExtrinsic));
    }

    #[test]
    fn numbers_out_of_range_are_refused_by_name() {
        let settings = read(DOCUMENT).expect("valid");
        let silent = Settings { deadlines: Deadlines { reply_ms: 0, ..settings.deadlines }, ..settings.clone() };
        assert_eq!(
            silent.check().expect_err("no deadline").to_string(),
            "deadlines.reply_ms must be between 1 and 3600000, got 0"
        );
        assert!(Settings { frame_mb_max: 4_000, ..settings.clone() }.check().is_err());
        assert_eq!(Settings { data_port: 0, ..settings }.check(), Err(SettingsError::Port { field: "data_port" }));
    }
}
