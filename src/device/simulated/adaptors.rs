//! The adaptors of the simulated manipulators, sensor and stage, and the link of each to its device with its latency, time-outs and
//! faults.

use std::time::Duration;

use tokio::time::sleep;

use crate::device::error::{DeviceError, Pending};
use crate::device::manipulator::{Command, Manipulator, Reading};
use crate::device::sensor::{Profile, ProfileSensor, SensorReading};
use crate::device::sensor::{Stage, StageReading};
use crate::device::sequence::FenceGate;
use crate::motion::Carrier;

use super::faults::{Device, Fault, Step};
use super::scanning::PROFILES_MAX;
use super::world::{SimulatedCell, World};

impl World {
    /// A new link to a manipulator, not connected.
    #[must_use]
    pub fn manipulator(&self, carrier: Carrier) -> SimulatedManipulator {
        SimulatedManipulator::new(carrier, Link::new(self.clone(), Device::Manipulator(carrier)))
    }

    /// A new link to the sensor, not connected.
    #[must_use]
    pub fn sensor(&self) -> SimulatedSensor {
        SimulatedSensor::new(Link::new(self.clone(), Device::Sensor))
    }

    /// A new link to the stage, not connected.
    #[must_use]
    pub fn stage(&self) -> SimulatedStage {
        SimulatedStage::new(Link::new(self.clone(), Device::Stage))
    }
}

/// A link to one device.
#[derive(Debug)]
pub(super) struct Link {
    pub(super) world: World,
    device: Device,
    up: bool,
}

/// The course of an exchange.
struct Exchange {
    arrives: bool,
    answer: Answer,
}

enum Answer {
    Comes { later: Duration },
    Never,
    Breaks,
    Garbled,
    Refusal(u32),
}

impl Link {
    pub(super) const fn new(world: World, device: Device) -> Self {
        Self { world, device, up: false }
    }

    /// The device's name.
    pub(super) const fn name(&self) -> &'static str {
        match self.device {
            Device::Manipulator(carrier) => carrier.name(),
            Device::Sensor => "sensor",
            Device::Stage => "stage",
        }
    }

    /// Connects or reconnects.
    pub(super) async fn open(&mut self) -> Result<(), DeviceError> {
        self.up = false;
        self.exchange(Step::Open, |_, _| ()).await
    }

    /// Sends a request; `deliver` is the action of the device if the request arrives.
    pub(super) async fn ask<T>(
        &mut self,
        deliver: impl FnOnce(&mut SimulatedCell, Duration) -> T,
    ) -> Result<T, DeviceError> {
        if !self.up {
            return Err(self.lost("not connected"));
        }
        self.exchange(Step::Ask, deliver).await
    }

    /// If this is dropped before the answer, the connection is closed, because the answer may still arrive.
    async fn exchange<T>(
        &mut self,
        step: Step,
        deliver: impl FnOnce(&mut SimulatedCell, Duration) -> T,
    ) -> Result<T, DeviceError> {
        self.up = false;
        let settings = self.world.settings();
        let (latency, within) = (ms(settings.latency_ms), ms(settings.reply_within_ms));
        let fault = self.world.at_now(|cell, now| {
            let fault = cell.faults.strike(self.device, step);
            fault.inspect(|fault| cell.apply_fault(self.device, fault, now))
        });
        let exchange = exchange_under(fault.as_ref());
        sleep(latency / 2).await;
        let answer = exchange.arrives.then(|| self.world.at_now(deliver));
        match exchange.answer {
            Answer::Comes { later } if latency + later <= within => sleep(latency / 2 + later).await,
            Answer::Comes { .. } | Answer::Never => {
                sleep(within.saturating_sub(latency / 2)).await;
                return Err(DeviceError::Silent { device: self.name().to_owned(), within });
            }
            Answer::Breaks => return Err(self.lost("the connection was reset")),
            Answer::Garbled => {
                sleep(latency / 2).await;
                let what = "the answer is 3 bytes long, 12 are due".to_owned();
                return Err(DeviceError::Implausible { device: self.name().to_owned(), what });
            }
            Answer::Refusal(code) => {
                sleep(latency / 2).await;
                self.up = step == Step::Ask;
                return Err(DeviceError::Rejected { device: self.name().to_owned(), code });
            }
        }
        let answer = answer.ok_or_else(|| self.lost("nothing arrived"))?;
        self.up = true;
        if let Some(Fault::Scan(fault)) = fault {
            return Err(DeviceError::ScanFault { device: self.name().to_owned(), fault });
        }
        Ok(answer)
    }

    fn lost(&self, cause: &str) -> DeviceError {
        DeviceError::LinkLost { device: self.name().to_owned(), cause: cause.to_owned() }
    }
}

fn exchange_under(fault: Option<&Fault>) -> Exchange {
    let goes = |arrives, answer| Exchange { arrives, answer };
    match fault {
        None | Some(Fault::LimitHit { .. } | Fault::Stall | Fault::Scan(_)) => {
            goes(true, Answer::Comes { later: Duration::ZERO })
        }
        Some(Fault::LinkLost { arrives }) => goes(*arrives, Answer::Breaks),
        Some(Fault::Silence { arrives }) => goes(*arrives, Answer::Never),
        Some(Fault::Late { by }) => goes(true, Answer::Comes { later: *by }),
        Some(Fault::Corrupt) => goes(true, Answer::Garbled),
        Some(Fault::Rejected { code }) => goes(false, Answer::Refusal(*code)),
        Some(Fault::HalfOpen) => goes(false, Answer::Never),
    }
}

pub(super) fn ms(ms: f64) -> Duration {
    Duration::from_secs_f64(ms / 1000.0)
}

/// The adaptor of a simulated manipulator.
#[derive(Debug)]
pub struct SimulatedManipulator {
    carrier: Carrier,
    link: Link,
    gate: FenceGate,
}

impl SimulatedManipulator {
    pub(super) fn new(carrier: Carrier, link: Link) -> Self {
        Self { carrier, link, gate: FenceGate::default() }
    }

    /// The device in the simulated cell.
    #[must_use]
    pub const fn device(&self) -> Device {
        Device::Manipulator(self.carrier)
    }
}

impl Manipulator for SimulatedManipulator {
    fn name(&self) -> &str {
        self.link.name()
    }

    fn connect(&mut self) -> Pending<'_, Result<Reading, DeviceError>> {
        Box::pin(async move {
            self.link.open().await?;
            let carrier = self.carrier;
            // This is not a heartbeat: a device that still moves is stopped by its watchdog, unless it is commanded again.
            self.link.ask(move |cell, now| cell.controllers.get_mut(carrier).reading(now)).await
        })
    }

    fn read(&mut self) -> Pending<'_, Result<Reading, DeviceError>> {
        let carrier = self.carrier;
        Box::pin(self.link.ask(move |cell, now| {
            let controller = cell.controllers.get_mut(carrier);
            controller.beat(now);
            controller.reading(now)
        }))
    }

    fn send(&mut self, command: &Command) -> Pending<'_, Result<(), DeviceError>> {
        let (carrier, command) = (self.carrier, command.clone());
        Box::pin(async move {
            self.gate.admit(self.link.name(), command.fence)?;
            self.link.ask(move |cell, now| cell.controllers.get_mut(carrier).take(&command, now)).await?;
            Ok(())
        })
    }
}

/// Greatest number of profiles in one answer.
const BATCH_MAX: usize = 64;
/// Interval between two requests for new profiles.
const LOOK: Duration = Duration::from_millis(5);

/// The adaptor of the simulated profile sensor.
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
                let profile_maker = self.link.world.profile_maker();
                return Ok(triggers.iter().map(|trigger| profile_maker.profile(trigger)).collect());
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

/// The adaptor of the simulated stage.
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
