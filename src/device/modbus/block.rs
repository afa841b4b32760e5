//! One device's registers over a link: its status read whole, our heartbeat, and commands written once.

use super::command::encode;
use super::error::MapError;
use super::layout::Layout;
use super::link::{Link, now};
use super::pulse::Pulse;
use super::status::StatusRegisters;
use crate::device::error::DeviceError;
use crate::device::manipulator::Command;
use std::time::Duration;
use tokio::time::{Instant, sleep};

/// Before a torn status is read again: at once it would be as torn, because a PLC writes it in a cycle of some ms.
const TORN_PAUSE: Duration = Duration::from_millis(5);

/// A device's block of registers.
pub(super) struct Block {
    link: Link,
    layout: Layout,
    base: u16,
    pulse: Pulse,
    torn_reads_max: u8,
    heartbeat: u16,
}

impl Block {
    pub(super) const fn new(link: Link, layout: Layout, base: u16, pulse: Pulse, torn_reads_max: u8) -> Self {
        Self { link, layout, base, pulse, torn_reads_max, heartbeat: 0 }
    }

    pub(super) fn name(&self) -> &str {
        self.link.name()
    }

    /// Connects and reads. Writes nothing.
    pub(super) async fn connect<T>(&mut self, understand: Understand<T>) -> Result<T, DeviceError> {
        self.link.connect().await?;
        let deadline = self.link.deadline();
        self.status(understand, deadline).await
    }

    /// Beats, and reads.
    pub(super) async fn read<T>(&mut self, understand: Understand<T>) -> Result<T, DeviceError> {
        let deadline = self.link.deadline();
        self.heartbeat = self.heartbeat.wrapping_add(1);
        let at = self.layout.command.base + self.base + self.layout.command.heartbeat;
        self.link.write_one(at, self.heartbeat, deadline).await?;
        self.status(understand, deadline).await
    }

    /// Writes a command, once.
    pub(super) async fn command(&mut self, command: &Command) -> Result<(), DeviceError> {
        let heartbeat = self.heartbeat.wrapping_add(1);
        let registers = encode(&self.layout, command, heartbeat).map_err(|error| DeviceError::Unsupported {
            device: self.name().to_owned(),
            what: format!("be told this: {error}"),
        })?;
        self.heartbeat = heartbeat;
        let deadline = self.link.deadline();
        self.link.write(self.layout.command.base + self.base, &registers, deadline).await
    }

    /// Reads the status until it is whole, a few times.
    async fn status<T>(&mut self, understand: Understand<T>, deadline: Instant) -> Result<T, DeviceError> {
        let map = self.layout.status;
        let mut torn_count = 0;
        loop {
            let registers = self.link.read(map.function, map.base + self.base, map.count, deadline).await?;
            let status = StatusRegisters { layout: &self.layout, registers: &registers };
            match status.head().and_then(|head| Ok((head.heartbeat, understand(status)?))) {
                Ok((heartbeat, state)) => {
                    self.alive(heartbeat)?;
                    return Ok(state);
                }
                Err(MapError::Torn { .. }) if torn_count < self.torn_reads_max => {
                    torn_count += 1;
                    sleep(TORN_PAUSE).await;
                }
                Err(error) => return Err(self.link.implausible(error.to_string())),
            }
        }
    }

    fn alive(&mut self, heartbeat: u16) -> Result<(), DeviceError> {
        self.pulse.stands(heartbeat, now()).map_or(Ok(()), |age| {
            let what = format!(
                "its heartbeat has stood at {heartbeat} for {} ms; does the device's program run?",
                age.as_millis()
            );
            Err(self.link.implausible(what))
        })
    }
}

/// What is made of a status block.
pub(super) type Understand<T> = fn(StatusRegisters<'_>) -> Result<T, MapError>;
