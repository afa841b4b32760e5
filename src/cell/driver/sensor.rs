//! The driver of the sensor. It reads the sensor between scans; during a scan it forwards the profiles and checks that none is
//! missing. The sensor moves nothing, but its laser is a hazard like a motion: a halt switches it off, and ends when a reading
//! shows that the sensor no longer runs. A sensor that is found running when the link comes up is stopped before anything else.

use super::context::{Answer, DriverContext, raised};
use super::device_driver::{DeviceDriver, DriverTask, FirstReading};
use super::messages::{Acquisition, DeviceReading, DriverEvent, DriverOrder, Outcome, SessionEnd};
use crate::cell::failure::Failure;
use crate::device::Pending;
use crate::device::{DeviceError, Profile, ProfileSensor, ScanFault, SensorDeadlines};
use tokio::sync::mpsc;
use tokio::time::timeout;

/// The driver of the sensor.
pub(in crate::cell) struct SensorDriver {
    device: Box<dyn ProfileSensor>,
    deadlines: SensorDeadlines,
    /// A halt after which the sensor has not been read stopped yet.
    halting: Option<u64>,
    /// The sensor was running when the link came up, without a scan of this cell.
    found_running: bool,
}

/// How an acquisition ended.
enum AcquisitionEnd {
    /// All profiles were received, or the scan is incomplete.
    Scan(Result<(), Failure>),
    /// A halt came first.
    Halted,
    /// The link failed, or the cell has ended.
    SessionEnd(SessionEnd),
}

impl SensorDriver {
    /// The task of the driver.
    pub(in crate::cell) fn task(
        device: Box<dyn ProfileSensor>,
        context: DriverContext,
        orders: mpsc::Receiver<DriverOrder<Acquisition>>,
    ) -> DriverTask<Self> {
        let deadlines = device.deadlines();
        DriverTask::new(Self { device, deadlines, halting: None, found_running: false }, context, orders)
    }
}

impl DeviceDriver for SensorDriver {
    type Command = Acquisition;

    fn connect(&mut self) -> Pending<'_, Answer<FirstReading>> {
        Box::pin(async move {
            let reading = self.device.connect().await?;
            self.found_running = reading.running;
            Ok((DeviceReading::Sensor(reading), None))
        })
    }

    async fn settle(&mut self, context: &mut DriverContext) -> Result<(), SessionEnd> {
        // A halt that is due stops the sensor as well.
        if self.found_running && !context.halt_is_due() { self.read(context).await } else { Ok(()) }
    }

    /// First stops a sensor that was found running; every reading repeats this until it has stopped.
    async fn read(&mut self, context: &mut DriverContext) -> Result<(), SessionEnd> {
        if self.found_running {
            tracing::warn!(device = %context.name, "the sensor was found running without a scan; it is stopped");
            match self.switch_off(context).await? {
                Err(error) if error.leaves_unknown() => return Err(SessionEnd::Lost(error)),
                Err(error) => context.report(DriverEvent::HaltRefused { error }).await,
                Ok(()) => {}
            }
        }
        self.look(context).await
    }

    /// If the answer is lost, the driver connects again at once and repeats the halt, because nothing else switches the laser off.
    async fn halt(&mut self, context: &mut DriverContext) -> Result<(), SessionEnd> {
        let number = context.halts().number;
        let answer = self.switch_off(context).await?;
        if answer.as_ref().is_err_and(DeviceError::leaves_unknown) {
            return Err(SessionEnd::Cut);
        }
        self.halting = context.halted(number, answer).await?.then_some(number);
        self.look(context).await
    }

    async fn obey(&mut self, context: &mut DriverContext, order: DriverOrder<Acquisition>) -> Result<(), SessionEnd> {
        let DriverOrder { number, command, .. } = order;
        match context.ask_within(self.device.start(command.profiles_count), self.deadlines.start).await? {
            Ok(()) => context.report_outcome(number, Outcome::Taken { sequence: 0 }).await,
            Err(error) if error.leaves_unknown() => return Err(SessionEnd::Lost(error)),
            Err(error) => {
                context.report_outcome(number, Outcome::Refused(error)).await;
                return Ok(());
            }
        }
        let ending = self.take(context, command).await;
        context.pace(false);
        match ending {
            AcquisitionEnd::Halted => Ok(()),
            AcquisitionEnd::SessionEnd(gone) => Err(gone),
            AcquisitionEnd::Scan(result) => {
                self.conclude(context, result).await?;
                // The sensor was not read during the scan, and the next scan may be requested at once.
                self.look(context).await
            }
        }
    }
}

impl SensorDriver {
    /// Reads the sensor, and reports whether it has stopped after a halt.
    async fn look(&mut self, context: &mut DriverContext) -> Result<(), SessionEnd> {
        let reading = context.ask(self.device.read()).await?.map_err(SessionEnd::Lost)?;
        self.found_running &= reading.running;
        let stopped = self.halting.take_if(|_| !reading.running);
        context.report_reading(DeviceReading::Sensor(reading), self.halting.is_some()).await;
        if let Some(number) = stopped {
            context.rested(number).await;
        }
        Ok(())
    }

    /// Stops the sensor. A fault of the scan is not a failure of the stop.
    async fn switch_off(&mut self, context: &mut DriverContext) -> Result<Answer<()>, SessionEnd> {
        let answer = context.ask_for_halt_within(self.device.stop(), self.deadlines.stop).await?;
        Ok(answer.or_else(|error| if matches!(error, DeviceError::ScanFault { .. }) { Ok(()) } else { Err(error) }))
    }

    /// Ends the scan by asking the sensor whether it lost anything.
    async fn conclude(&mut self, context: &mut DriverContext, result: Result<(), Failure>) -> Result<(), SessionEnd> {
        let stopped = context.ask_within(self.device.stop(), self.deadlines.stop).await?;
        let lost = stopped.clone().err().filter(DeviceError::leaves_unknown);
        let result = result.and_then(|()| stopped.map_err(Failure::Device));
        context.report(DriverEvent::ScanEnded { result }).await;
        lost.map_or(Ok(()), |error| Err(SessionEnd::Lost(error)))
    }

    /// Forwards the profiles until all have been received.
    async fn take(&mut self, context: &mut DriverContext, taking: Acquisition) -> AcquisitionEnd {
        let mut received_count = 0;
        while received_count < taking.profiles_count {
            let handled = context.handled;
            let received = tokio::select! {
                biased;
                raised = raised(&mut context.halts, handled) => {
                    return if raised { AcquisitionEnd::Halted } else { AcquisitionEnd::SessionEnd(SessionEnd::Closed) };
                }
                received = self.device.receive() => received,
            };
            let mut profiles = match received {
                Ok(profiles) => profiles,
                Err(error) if error.leaves_unknown() => return AcquisitionEnd::SessionEnd(SessionEnd::Lost(error)),
                Err(error) => return AcquisitionEnd::Scan(Err(Failure::Device(error))),
            };
            let due = usize::try_from(taking.profiles_count - received_count).unwrap_or(usize::MAX);
            profiles.truncate(due);
            received_count = match whole(&context.name, received_count, &profiles) {
                Ok(count) => count,
                Err(failure) => return AcquisitionEnd::Scan(Err(failure)),
            };
            if !matches!(timeout(taking.patience, taking.sink.send(profiles)).await, Ok(Ok(()))) {
                return AcquisitionEnd::Scan(Err(Failure::ProfilesNotTaken));
            }
            context.report(DriverEvent::Profiles { received_count }).await;
        }
        AcquisitionEnd::Scan(Ok(()))
    }
}

/// Checks that these profiles follow the previous ones, and returns the total number received so far.
fn whole(sensor: &str, received_count: u64, profiles: &[Profile]) -> Result<u64, Failure> {
    let mut expected = received_count;
    for profile in profiles {
        if profile.index != expected {
            let fault = ScanFault::FrameGap { expected, found: profile.index };
            return Err(Failure::Device(DeviceError::ScanFault { device: sensor.to_owned(), fault }));
        }
        expected += 1;
    }
    Ok(expected)
}
