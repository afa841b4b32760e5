//! A manipulator over an OPC UA session. Every call has a deadline; a call that fails or is dropped half-way closes the session,
//! and only [`Manipulator::connect`] opens a new one. Nothing is ever sent twice.

use super::codec::{self, NotEncodable};
use super::layout::Node;
use super::nodes;
use super::nodes::UnexpectedValue;
use super::session::{Failure, Open, Values, client, open};
use super::settings::{SettingRefusal, Settings};
use crate::device::clock::now;
use crate::device::error::{DeviceError, Pending};
use crate::device::manipulator::{Command, Manipulator, Reading};
use crate::device::sequence::FenceGate;
use opcua::types::{AttributeId, StatusCode, Variant};
use std::fmt::Display;
use std::time::Duration;
use tokio::time::{Instant, sleep, timeout};

/// Greatest number of attempts at a reading that is torn.
const READINGS_MAX: u32 = 4;
/// Pause before the next attempt, so that the device can complete its change.
const TORN_WAIT: Duration = Duration::from_millis(2);
/// Longest wait for closing a session with a server that still answers.
const FAREWELL: Duration = Duration::from_millis(200);

/// A manipulator behind an OPC UA server.
pub struct OpcuaManipulator {
    name: String,
    settings: Settings,
    gate: FenceGate,
    open: Option<Open>,
    /// The heartbeat of coaxis, a counter.
    pulse: u16,
    /// The device's heartbeat, and since when it has had that value.
    heartbeat: Option<(u16, Instant)>,
}

impl OpcuaManipulator {
    /// An adaptor that is not connected yet.
    ///
    /// # Errors
    /// [`SettingRefusal`] names the setting that cannot be used.
    pub fn new(name: &str, settings: &Settings) -> Result<Self, SettingRefusal> {
        settings.check()?;
        Ok(Self {
            name: name.to_owned(),
            settings: settings.clone(),
            gate: FenceGate::default(),
            open: None,
            pulse: 0,
            heartbeat: None,
        })
    }

    fn lost(&self, cause: &dyn Display) -> DeviceError {
        DeviceError::LinkLost { device: self.name.clone(), cause: cause.to_string() }
    }

    fn silent(&self, within: Duration) -> DeviceError {
        DeviceError::Silent { device: self.name.clone(), within }
    }

    fn implausible(&self, what: &dyn Display) -> DeviceError {
        DeviceError::Implausible { device: self.name.clone(), what: what.to_string() }
    }

    /// Converts a failure into an error of the contract.
    fn error(&self, failure: &Failure, within: Duration) -> DeviceError {
        match failure {
            Failure::Said { status, .. } if *status == StatusCode::BadTimeout => self.silent(within),
            Failure::NoNode { .. } | Failure::Namespace(_) | Failure::Length { .. } => self.implausible(failure),
            Failure::Said { .. } | Failure::Security(_) | Failure::Keys { .. } | Failure::Stranger => {
                self.lost(failure)
            }
        }
    }

    /// Takes the session out of the adaptor, so that it is dropped if the caller stops waiting.
    fn take(&mut self) -> Result<Open, DeviceError> {
        self.open.take().ok_or_else(|| self.lost(&"not connected"))
    }

    async fn establish(&mut self) -> Result<Reading, DeviceError> {
        self.heartbeat = None;
        if let Some(old) = self.open.take() {
            let _ = timeout(FAREWELL, old.close()).await;
        }
        let within = self.settings.connect_within();
        let settings = self.settings.clone();
        // Creating a key takes seconds, happens once, and is not a fault of the device, so it is not part of its deadline.
        let made = tokio::task::spawn_blocking(move || client(&settings)).await;
        let mut client = made.map_err(|error| self.lost(&error))?.map_err(|failure| self.error(&failure, within))?;
        let opened = timeout(within, async {
            let open = open(&mut client, &self.settings).await?;
            let units = open.read(&nodes::asked_of_units()).await?;
            let commands = open.read(&nodes::asked_of_commands()).await?;
            Ok::<_, Failure>((open, units, commands))
        });
        let (open, units, commands) =
            opened.await.map_err(|_| self.silent(within))?.map_err(|failure| self.error(&failure, within))?;
        nodes::units(&units.values).map_err(|odd| self.implausible(&odd))?;
        nodes::writable(&commands.values).map_err(|odd| self.implausible(&odd))?;
        self.open = Some(open);
        self.look().await
    }

    async fn look(&mut self) -> Result<Reading, DeviceError> {
        let open = self.take()?;
        let within = self.settings.read_within();
        self.pulse = self.pulse.wrapping_add(1);
        let answered = timeout(within, exchange(&open, self.pulse)).await;
        let answer = answered.map_err(|_| self.silent(within))?.map_err(|failure| self.error(&failure, within))?;
        self.open = Some(open);
        let values = answer.map_err(|odd| self.implausible(&odd))?;
        let age = codec::age(&values.values, &values.answered).map_err(|odd| self.implausible(&odd))?;
        let reading =
            codec::reading(&values.values, self.settings.states.codes()).map_err(|odd| self.implausible(&odd))?;
        self.hear(age, reading.heartbeat)?;
        Ok(reading)
    }

    /// Checks that the device is running: its heartbeat is recent and changes.
    fn hear(&mut self, age: Duration, heartbeat: u16) -> Result<(), DeviceError> {
        let stale = self.settings.stale_after();
        let now = now();
        let since = match self.heartbeat {
            Some((last, since)) if last == heartbeat => since,
            _ => now,
        };
        self.heartbeat = Some((heartbeat, since));
        if age > stale || now.duration_since(since) > stale { Err(self.silent(stale)) } else { Ok(()) }
    }

    async fn hand_over(&mut self, command: &Command) -> Result<(), DeviceError> {
        self.gate.admit(&self.name, command.fence)?;
        let unspeakable =
            |NotEncodable(what)| DeviceError::Unsupported { device: self.name.clone(), what: what.to_owned() };
        let values = codec::command(command).map_err(unspeakable)?;
        let open = self.take()?;
        let within = self.settings.send_within();
        let answered = timeout(within, open.write(&values)).await;
        let results = answered.map_err(|_| self.silent(within))?.map_err(|failure| self.error(&failure, within))?;
        self.open = Some(open);
        self.judge(&results)
    }

    /// Evaluates the results of writing a command. If the server refused a part of it, the device must not be commanded any
    /// further.
    fn judge(&self, results: &[StatusCode]) -> Result<(), DeviceError> {
        let refused = Node::COMMAND.into_iter().zip(results).find(|(_, status)| **status != StatusCode::Good);
        match (refused, results.last()) {
            (None, _) => Ok(()),
            // Without the sequence number the device does not execute the command.
            (Some(_), Some(number)) if number.is_bad() => {
                Err(DeviceError::Rejected { device: self.name.clone(), code: number.bits() })
            }
            (Some((node, status)), _) => Err(self.implausible(&format_args!(
                "the command was accepted without {}, for which the server answered {status}",
                node.key()
            ))),
        }
    }
}

/// Writes the heartbeat, then reads every value in one call, and reads again if the device changed them meanwhile.
async fn exchange(open: &Open, pulse: u16) -> Result<Result<Values, UnexpectedValue>, Failure> {
    let wanted: Vec<_> = Node::reading().map(|node| (node, AttributeId::Value)).collect();
    let heard = open.write(&[(Node::Pulse, Variant::UInt16(pulse))]).await?;
    if let Some(quality) = heard.into_iter().find(|status| *status != StatusCode::Good) {
        return Ok(Err(UnexpectedValue::Quality { node: Node::Pulse, quality }));
    }
    for _ in 0..READINGS_MAX {
        let values = open.read(&wanted).await?;
        match codec::whole(&values.values) {
            Ok(Ok(())) => return Ok(Ok(values)),
            Ok(Err(codec::Torn)) => sleep(TORN_WAIT).await,
            Err(odd) => return Ok(Err(odd)),
        }
    }
    let why = "changed during every reading";
    Ok(Err(UnexpectedValue::Value { node: Node::Snapshot, value: "a counter".to_owned(), why }))
}

impl Manipulator for OpcuaManipulator {
    fn name(&self) -> &str {
        &self.name
    }

    fn connect(&mut self) -> Pending<'_, Result<Reading, DeviceError>> {
        Box::pin(self.establish())
    }

    fn read(&mut self) -> Pending<'_, Result<Reading, DeviceError>> {
        Box::pin(self.look())
    }

    fn send(&mut self, command: &Command) -> Pending<'_, Result<(), DeviceError>> {
        let command = command.clone();
        Box::pin(async move { self.hand_over(&command).await })
    }
}
