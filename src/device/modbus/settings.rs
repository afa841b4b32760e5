//! The settings of a device behind Modbus TCP in the configuration: its address, its deadlines and its register map.

use super::adaptor::{ModbusManipulator, ModbusStage};
use super::error::LayoutError;
use super::layout::Layout;
use super::link::{Block, Pulse};
use super::link::{Deadlines, Dial, Link, Transport};
use crate::device::manipulator::Manipulator;
use crate::device::sensor::Stage;
use serde::{Deserialize, Serialize};
use std::io;
use std::time::Duration;
use tokio::net::TcpStream;

/// The `modbus` section of a device.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Settings {
    /// Host and port.
    pub address: String,
    /// Unit id; PLCs that are not gateways accept any.
    pub unit_id: u8,
    /// Moves both blocks of the layout: 0 for the first device of a PLC, 256 for the second.
    pub base: u16,
    /// Longest time for connecting.
    pub connect_timeout_ms: u32,
    /// Longest time for one reading or one command.
    pub reply_timeout_ms: u32,
    /// Longest time for which the device's heartbeat may stay the same.
    pub heartbeat_stale_ms: u32,
    /// Number of times that a torn status is read again.
    pub torn_reads_max: u8,
    /// How long a stage continues to move without a heartbeat of coaxis. Manipulators get this time with each command.
    pub stage_watchdog_ms: u32,
    /// The register map.
    pub layout: Layout,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            address: "127.0.0.1:1502".to_owned(),
            unit_id: 1,
            base: 0,
            connect_timeout_ms: 1000,
            reply_timeout_ms: 200,
            // A device counts at least twice per second.
            heartbeat_stale_ms: 600,
            torn_reads_max: 5,
            stage_watchdog_ms: 300,
            layout: Layout::default(),
        }
    }
}

/// Why the settings are refused.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum SettingsError {
    /// The address is not a host with a port.
    #[error("modbus.address = {address:?}; it must be HOST:PORT, for example 192.168.0.10:502")]
    Address {
        /// The given address.
        address: String,
    },
    /// A number is out of its range.
    #[error("modbus.{name} = {value}; it must be {least} to {most}")]
    Range {
        /// Name of the setting.
        name: &'static str,
        /// The given value.
        value: u32,
        /// Least allowed value.
        least: u32,
        /// Greatest allowed value.
        most: u32,
    },
    /// The register map cannot be used.
    #[error("modbus.layout: {0}")]
    Layout(#[from] LayoutError),
}

impl Settings {
    /// # Errors
    /// The first [`SettingsError`] that is found.
    pub fn check(&self) -> Result<(), SettingsError> {
        let port = self.address.rsplit_once(':').filter(|(host, _)| !host.is_empty()).map(|(_, port)| port);
        if !port.is_some_and(|port| port.parse::<u16>().is_ok_and(|port| port > 0)) {
            return Err(SettingsError::Address { address: self.address.clone() });
        }
        let ranges = [
            ("connect_timeout_ms", self.connect_timeout_ms, 10, 60_000),
            // With a longer time, a lost link would be detected too late to stop the device.
            ("reply_timeout_ms", self.reply_timeout_ms, 5, 300),
            ("heartbeat_stale_ms", self.heartbeat_stale_ms, 20, 5_000),
            ("torn_reads_max", self.torn_reads_max.into(), 0, 20),
            // As for the manipulators, so that a moving device stops within half a second.
            ("stage_watchdog_ms", self.stage_watchdog_ms, 1, 400),
        ];
        if let Some((name, value, least, most)) =
            ranges.into_iter().find(|(_, value, least, most)| !(least..=most).contains(&value))
        {
            return Err(SettingsError::Range { name, value, least, most });
        }
        Ok(self.layout.check(self.base)?)
    }

    fn block(&self, name: &str, dial: Dial) -> Result<Block, SettingsError> {
        self.check()?;
        let deadlines = Deadlines { connect: ms(self.connect_timeout_ms), reply: ms(self.reply_timeout_ms) };
        let link = Link::new(name, dial, self.unit_id, deadlines);
        Ok(Block::new(link, self.layout, self.base, Pulse::new(ms(self.heartbeat_stale_ms)), self.torn_reads_max))
    }

    /// A manipulator over any transport.
    ///
    /// # Errors
    /// [`SettingsError`] if the settings do not pass [`Settings::check`].
    pub fn manipulator(&self, name: &str, dial: Dial) -> Result<ModbusManipulator, SettingsError> {
        Ok(ModbusManipulator::new(self.block(name, dial)?))
    }

    /// A stage over any transport.
    ///
    /// # Errors
    /// [`SettingsError`] if the settings do not pass [`Settings::check`].
    pub fn stage(&self, name: &str, dial: Dial) -> Result<ModbusStage, SettingsError> {
        Ok(ModbusStage::new(self.block(name, dial)?, ms(self.stage_watchdog_ms), ms(self.reply_timeout_ms)))
    }
}

/// A manipulator over TCP that is not connected yet.
///
/// # Errors
/// [`SettingsError`] if the settings cannot be used.
pub fn open(name: &str, settings: &Settings) -> Result<Box<dyn Manipulator>, SettingsError> {
    Ok(Box::new(settings.manipulator(name, dial_tcp(&settings.address))?))
}

/// A stage over TCP that is not connected yet.
///
/// # Errors
/// [`SettingsError`] if the settings cannot be used.
pub fn open_stage(name: &str, settings: &Settings) -> Result<Box<dyn Stage>, SettingsError> {
    Ok(Box::new(settings.stage(name, dial_tcp(&settings.address))?))
}

fn dial_tcp(address: &str) -> Dial {
    let address = address.to_owned();
    Box::new(move || {
        let address = address.clone();
        Box::pin(async move {
            let said = |error: io::Error| io::Error::new(error.kind(), format!("no connection to {address}: {error}"));
            let stream = TcpStream::connect(&address).await.map_err(said)?;
            // A set-point must not wait until a packet is full.
            stream.set_nodelay(true)?;
            Ok(Box::new(stream) as Box<dyn Transport>)
        })
    })
}

const fn ms(ms: u32) -> Duration {
    Duration::from_millis(ms as u64)
}
