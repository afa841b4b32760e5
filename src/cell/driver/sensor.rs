//! Drives the sensor: asks how it is between scans; in a scan, hands its profiles over as they come, and checks that none is
//! missing. It moves nothing, but its laser is a hazard like a motion: a halt switches it off and is over when the sensor was
//! read not to run any more, and a sensor that is found running on connecting is switched off before anything else.

use super::attend::{Attendant, Driver, Met};
use super::call::{Answer, raised};
use super::post::Post;
use super::{Gone, News, Order, Outcome, Seen, Taking};
use crate::cell::failure::Failure;
use crate::device::{DeviceError, Pending, Profile, ProfileSensor, ScanFault, SensorDeadlines};
use tokio::sync::mpsc;
use tokio::time::timeout;

/// The driver of the sensor.
pub(in crate::cell) type SensorDriver = Driver<SensorAttendant>;

/// What is particular to it.
pub(in crate::cell) struct SensorAttendant {
    device: Box<dyn ProfileSensor>,
    deadlines: SensorDeadlines,
    /// A halt after which the sensor was not read to have stopped yet.
    halting: Option<u64>,
    /// The sensor was running when the link came up, so that no scan of ours needs its laser.
    found_running: bool,
}

/// How the taking of profiles ended.
enum Ending {
    /// All came, or the scan cannot be whole.
    Scan(Result<(), Failure>),
    /// A halt came first.
    Halted,
    /// The link, or the cell, is gone.
    Gone(Gone),
}

impl SensorDriver {
    pub(in crate::cell) fn new(
        device: Box<dyn ProfileSensor>,
        post: Post,
        orders: mpsc::Receiver<Order<Taking>>,
    ) -> Self {
        let deadlines = device.deadlines();
        Self::of(SensorAttendant { device, deadlines, halting: None, found_running: false }, post, orders)
    }
}

impl Attendant for SensorAttendant {
    type Errand = Taking;

    fn connect(&mut self) -> Pending<'_, Answer<Met>> {
        Box::pin(async move {
            let reading = self.device.connect().await?;
            self.found_running = reading.running;
            Ok((Seen::Sensor(reading), None))
        })
    }

    async fn settle(&mut self, post: &mut Post) -> Result<(), Gone> {
        // A halt that is due switches it off as well.
        if self.found_running && !post.halt_is_due() { self.read(post).await } else { Ok(()) }
    }

    /// Where the sensor was found running, it is switched off first, again with every reading until it has stopped.
    async fn read(&mut self, post: &mut Post) -> Result<(), Gone> {
        if self.found_running {
            tracing::warn!(device = %post.name, "the sensor was found running without a scan; it is stopped");
            match self.switch_off(post).await? {
                Err(error) if error.leaves_unknown() => return Err(Gone::Lost(error)),
                Err(error) => post.tell(News::WillNotHalt { error }).await,
                Ok(()) => {}
            }
        }
        self.look(post).await
    }

    /// Where the answer is lost, the connection is made anew at once and the halt sent again: nothing but we switches the laser
    /// off.
    async fn halt(&mut self, post: &mut Post) -> Result<(), Gone> {
        let number = post.halts().number;
        let answer = self.switch_off(post).await?;
        if answer.as_ref().is_err_and(DeviceError::leaves_unknown) {
            return Err(Gone::Cut);
        }
        self.halting = post.halted(number, answer).await?.then_some(number);
        self.look(post).await
    }

    async fn obey(&mut self, post: &mut Post, order: Order<Taking>) -> Result<(), Gone> {
        let Order { number, errand, .. } = order;
        match post.ask_within(self.device.start(errand.profiles_count), self.deadlines.start).await? {
            Ok(()) => post.told(number, Outcome::Taken { sequence: 0 }).await,
            Err(error) if error.leaves_unknown() => return Err(Gone::Lost(error)),
            Err(error) => {
                post.told(number, Outcome::Refused(error)).await;
                return Ok(());
            }
        }
        let ending = self.take(post, errand).await;
        post.pace(false);
        match ending {
            Ending::Halted => Ok(()),
            Ending::Gone(gone) => Err(gone),
            Ending::Scan(result) => {
                self.conclude(post, result).await?;
                // It was not asked during the scan; the next one may be ordered at once.
                self.look(post).await
            }
        }
    }
}

impl SensorAttendant {
    /// Reads, and says whether the sensor has stopped after a halt.
    async fn look(&mut self, post: &mut Post) -> Result<(), Gone> {
        let reading = post.ask(self.device.read()).await?.map_err(Gone::Lost)?;
        self.found_running &= reading.running;
        let stopped = self.halting.take_if(|_| !reading.running);
        post.seen(Seen::Sensor(reading), self.halting.is_some()).await;
        if let Some(number) = stopped {
            post.rested(number).await;
        }
        Ok(())
    }

    /// What a scan has lost is no reason against its stop.
    async fn switch_off(&mut self, post: &mut Post) -> Result<Answer<()>, Gone> {
        let answer = post.ask_for_halt_within(self.device.stop(), self.deadlines.stop).await?;
        Ok(answer.or_else(|error| if matches!(error, DeviceError::ScanFault { .. }) { Ok(()) } else { Err(error) }))
    }

    /// The sensor has the last word on whether it lost anything.
    async fn conclude(&mut self, post: &mut Post, result: Result<(), Failure>) -> Result<(), Gone> {
        let stopped = post.ask_within(self.device.stop(), self.deadlines.stop).await?;
        let lost = stopped.clone().err().filter(DeviceError::leaves_unknown);
        let result = result.and_then(|()| stopped.map_err(Failure::Device));
        post.tell(News::ScanEnded { result }).await;
        lost.map_or(Ok(()), |error| Err(Gone::Lost(error)))
    }

    /// Hands over what comes until all have come.
    async fn take(&mut self, post: &mut Post, taking: Taking) -> Ending {
        let mut received_count = 0;
        while received_count < taking.profiles_count {
            let handled = post.handled;
            let received = tokio::select! {
                biased;
                raised = raised(&mut post.halts, handled) => {
                    return if raised { Ending::Halted } else { Ending::Gone(Gone::Closed) };
                }
                received = self.device.receive() => received,
            };
            let mut profiles = match received {
                Ok(profiles) => profiles,
                Err(error) if error.leaves_unknown() => return Ending::Gone(Gone::Lost(error)),
                Err(error) => return Ending::Scan(Err(Failure::Device(error))),
            };
            let due = usize::try_from(taking.profiles_count - received_count).unwrap_or(usize::MAX);
            profiles.truncate(due);
            received_count = match whole(&post.name, received_count, &profiles) {
                Ok(count) => count,
                Err(failure) => return Ending::Scan(Err(failure)),
            };
            if !matches!(timeout(taking.patience, taking.sink.send(profiles)).await, Ok(Ok(()))) {
                return Ending::Scan(Err(Failure::ProfilesNotTaken));
            }
            post.tell(News::Profiles { received_count }).await;
        }
        Ending::Scan(Ok(()))
    }
}

/// Whether these are the ones that were due; says how many there are then.
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
