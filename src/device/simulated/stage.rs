//! The adaptor of the made stage.

use super::link::Link;
use crate::device::Pending;
use crate::device::error::DeviceError;
use crate::device::fence::FenceGate;
use crate::device::stage::{Stage, StageReading};

/// The made stage behind its link.
#[derive(Debug)]
pub struct SimulatedStage {
    link: Link,
    gate: FenceGate,
}

impl SimulatedStage {
    pub(super) fn new(link: Link) -> Self {
        Self { link, gate: FenceGate::default() }
    }
}

impl Stage for SimulatedStage {
    fn name(&self) -> &str {
        self.link.name()
    }

    fn connect(&mut self) -> Pending<'_, Result<StageReading, DeviceError>> {
        Box::pin(async move {
            self.link.open().await?;
            self.link.ask(|cell, _| cell.carriage.reading()).await
        })
    }

    fn read(&mut self) -> Pending<'_, Result<StageReading, DeviceError>> {
        Box::pin(self.link.ask(|cell, now| {
            cell.carriage.beat(now);
            cell.carriage.reading()
        }))
    }

    fn move_to(&mut self, fence: u64, target_mm: f64, speed_mm_s: f64) -> Pending<'_, Result<(), DeviceError>> {
        Box::pin(async move {
            self.gate.admit(self.link.name(), fence)?;
            let refused = self.link.ask(move |cell, now| {
                cell.carriage.beat(now);
                cell.carriage.go(target_mm, speed_mm_s)
            });
            let refused = refused.await?;
            refused.map_err(|code| DeviceError::Rejected { device: self.link.name().to_owned(), code })
        })
    }

    fn halt(&mut self) -> Pending<'_, Result<(), DeviceError>> {
        Box::pin(self.link.ask(|cell, now| {
            cell.carriage.beat(now);
            cell.carriage.halt();
        }))
    }
}
