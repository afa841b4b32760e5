//! The adaptor of the made profile sensor.

use super::link::Link;
use super::scanning::PROFILES_MAX;
use crate::device::Pending;
use crate::device::error::DeviceError;
use crate::device::sensor::{Profile, ProfileSensor, SensorReading};
use std::time::Duration;
use tokio::time::sleep;

/// Profiles at most in one answer.
const BATCH_MAX: usize = 64;
/// Between two looks for new profiles.
const LOOK: Duration = Duration::from_millis(5);

/// The made profile sensor behind its link.
#[derive(Debug)]
pub struct SimulatedSensor {
    link: Link,
}

impl SimulatedSensor {
    pub(super) const fn new(link: Link) -> Self {
        Self { link }
    }

    async fn ask_reading(&mut self) -> Result<SensorReading, DeviceError> {
        let seed = self.link.world.settings().seed;
        let running = self.link.ask(|cell, _| cell.scanning.is_armed()).await?;
        Ok(SensorReading {
            model: "simulated profiler".to_owned(),
            serial: seed.to_string(),
            firmware: env!("CARGO_PKG_VERSION").to_owned(),
            running,
            temperature_c: None,
        })
    }

    async fn ask_profiles(&mut self) -> Result<Vec<Profile>, DeviceError> {
        loop {
            let triggers = self.link.ask(|cell, _| cell.scanning.fetch(BATCH_MAX)).await?;
            if !triggers.is_empty() {
                let eye = self.link.world.eye();
                return Ok(triggers.iter().map(|trigger| eye.see(trigger)).collect());
            }
            sleep(LOOK).await;
        }
    }
}

impl ProfileSensor for SimulatedSensor {
    fn name(&self) -> &str {
        self.link.name()
    }

    fn connect(&mut self) -> Pending<'_, Result<SensorReading, DeviceError>> {
        Box::pin(async move {
            self.link.open().await?;
            self.ask_reading().await
        })
    }

    fn read(&mut self) -> Pending<'_, Result<SensorReading, DeviceError>> {
        Box::pin(self.ask_reading())
    }

    fn start(&mut self, profiles_count: u64) -> Pending<'_, Result<(), DeviceError>> {
        Box::pin(async move {
            if !(1..=PROFILES_MAX).contains(&profiles_count) {
                let what = format!("take {profiles_count} profiles; 1 to {PROFILES_MAX} can be taken in one scan");
                return Err(DeviceError::Unsupported { device: self.link.name().to_owned(), what });
            }
            let pitch_mm = self.link.world.settings().sensor.profile_pitch_mm;
            let arm = self.link.ask(move |cell, _| {
                let from_mm = cell.carriage.position();
                cell.scanning.arm(from_mm, pitch_mm, profiles_count);
            });
            arm.await
        })
    }

    fn receive(&mut self) -> Pending<'_, Result<Vec<Profile>, DeviceError>> {
        Box::pin(self.ask_profiles())
    }

    fn stop(&mut self) -> Pending<'_, Result<(), DeviceError>> {
        Box::pin(self.link.ask(|cell, _| cell.scanning.disarm()))
    }
}
