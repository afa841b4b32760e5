//! The link from an adaptor to a made device: latency, an answer within a time or none, and the faults of links. In: a request.
//! Out: its answer or what went wrong.

use super::faults::{Device, Fault, Step};
use super::world::{MadeCell, World};
use crate::device::error::DeviceError;
use std::time::Duration;
use tokio::time::sleep;

/// A link to one device.
#[derive(Debug)]
pub(super) struct Link {
    pub(super) world: World,
    device: Device,
    up: bool,
}

/// How an exchange goes.
struct Course {
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

    /// Connects, or connects anew.
    pub(super) async fn open(&mut self) -> Result<(), DeviceError> {
        self.up = false;
        self.exchange(Step::Open, |_, _| ()).await
    }

    /// Asks something; `deliver` is what the device does with it, where it arrives.
    pub(super) async fn ask<T>(
        &mut self,
        deliver: impl FnOnce(&mut MadeCell, Duration) -> T,
    ) -> Result<T, DeviceError> {
        if !self.up {
            return Err(self.lost("not connected"));
        }
        self.exchange(Step::Ask, deliver).await
    }

    /// Whoever drops this half-way has lost the connection: an answer may still be on its way.
    async fn exchange<T>(
        &mut self,
        step: Step,
        deliver: impl FnOnce(&mut MadeCell, Duration) -> T,
    ) -> Result<T, DeviceError> {
        self.up = false;
        let settings = self.world.settings();
        let (latency, within) = (ms(settings.latency_ms), ms(settings.reply_within_ms));
        let fault = self.world.at_now(|cell, now| {
            let fault = cell.faults.strike(self.device, step);
            fault.inspect(|fault| cell.suffer(self.device, fault, now))
        });
        let course = course(fault.as_ref());
        sleep(latency / 2).await;
        let answer = course.arrives.then(|| self.world.at_now(deliver));
        match course.answer {
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

fn course(fault: Option<&Fault>) -> Course {
    let goes = |arrives, answer| Course { arrives, answer };
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
