//! Drives the sensor: asks how it is between scans; in a scan, hands its profiles over as they come, and checks that none is
//! missing. It moves nothing; a halt ends its scan. Must not know what the profiles are for.

use super::backoff::Backoff;
use super::call::{Patience, call, raised};
use super::{Gone, News, Order, Outcome, Post, Seen, Taking};
use crate::cell::{Failure, now};
use crate::device::{DeviceError, Profile, ProfileSensor, ScanFault};
use tokio::sync::mpsc;
use tokio::time::{Instant, sleep_until, timeout};

/// The driver.
pub(in crate::cell) struct SensorDriver {
    device: Box<dyn ProfileSensor>,
    post: Post,
    orders: mpsc::Receiver<Order<Taking>>,
    next_read: Instant,
    was_up: bool,
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
        Self { device, post, orders, next_read: now(), was_up: false }
    }

    /// Drives until the cell has ended.
    pub(in crate::cell) async fn run(mut self) {
        let mut backoff = Backoff::new(self.post.timing.backoff_first, self.post.timing.backoff_last);
        let mut told = false;
        loop {
            let gone = match self.connect().await {
                Ok(()) => {
                    (told, self.was_up) = (false, true);
                    backoff.relax();
                    self.attend().await
                }
                Err(gone) => gone,
            };
            match gone {
                Gone::Closed => return,
                // Nothing is under way that a halt could still reach: connect anew.
                Gone::Cut => continue,
                Gone::Lost(error) if !told => {
                    self.post.tell(News::Lost { error, was_up: self.was_up }).await;
                    told = true;
                }
                Gone::Lost(_) => {}
            }
            if !self.wait(now() + backoff.wait()).await {
                return;
            }
        }
    }

    async fn wait(&mut self, until: Instant) -> bool {
        loop {
            tokio::select! {
                order = self.orders.recv() => match order {
                    Some(order) => self.decline(order.number).await,
                    None => return false,
                },
                () = sleep_until(until) => return true,
            }
        }
    }

    async fn decline(&mut self, order: u64) {
        let error = DeviceError::LinkLost { device: self.name(), cause: "not connected".to_owned() };
        self.told(order, Outcome::Refused(error)).await;
    }

    async fn connect(&mut self) -> Result<(), Gone> {
        let asked_at = now();
        let deadline = self.post.timing.connect;
        let patience = Patience { deadline, grace: deadline, handled: u64::MAX };
        let name = self.name();
        let reading = call(&name, self.device.connect(), &self.post.halts, patience).await?.map_err(Gone::Lost)?;
        while let Ok(order) = self.orders.try_recv() {
            self.decline(order.number).await;
        }
        self.post.tell(News::Up { asked_at, seen: Seen::Sensor(reading) }).await;
        self.next_read = now() + self.post.timing.poll;
        Ok(())
    }

    async fn attend(&mut self) -> Gone {
        loop {
            let step = if self.post.halt_is_due() {
                self.end_scan(self.post.halts().number).await
            } else {
                let handled = self.post.handled;
                tokio::select! {
                    biased;
                    raised = raised(&mut self.post.halts, handled) => if raised { Ok(()) } else { Err(Gone::Closed) },
                    order = self.orders.recv() => match order {
                        Some(order) => self.obey(order).await,
                        None => Err(Gone::Closed),
                    },
                    () = sleep_until(self.next_read) => self.read().await,
                }
            };
            if let Err(gone) = step {
                return gone;
            }
        }
    }

    /// A halt ends whatever the sensor takes; harmless where it takes nothing.
    async fn end_scan(&mut self, number: u64) -> Result<(), Gone> {
        let answer = self.stop().await?;
        self.post.handed(number, true);
        self.post.rested(number).await;
        answer.or_else(|error| if error.leaves_unknown() { Err(Gone::Lost(error)) } else { Ok(()) })
    }

    async fn stop(&mut self) -> Result<Result<(), DeviceError>, Gone> {
        let (name, patience) = (self.name(), self.patience());
        call(&name, self.device.stop(), &self.post.halts, patience).await
    }

    async fn obey(&mut self, order: Order<Taking>) -> Result<(), Gone> {
        let Order { number, halts, errand, .. } = order;
        if halts < self.post.halts().number {
            self.told(number, Outcome::Overtaken).await;
            return Ok(());
        }
        let (name, patience) = (self.name(), self.patience());
        match call(&name, self.device.start(errand.profiles_count), &self.post.halts, patience).await? {
            Ok(()) => self.told(number, Outcome::Taken { sequence: 0 }).await,
            Err(error) if error.leaves_unknown() => return Err(Gone::Lost(error)),
            Err(error) => {
                self.told(number, Outcome::Refused(error)).await;
                return Ok(());
            }
        }
        let ending = self.take(errand).await;
        self.next_read = now() + self.post.timing.poll;
        match ending {
            Ending::Halted => Ok(()),
            Ending::Gone(gone) => Err(gone),
            Ending::Scan(result) => self.conclude(result).await,
        }
    }

    /// The sensor has the last word on whether it lost anything.
    async fn conclude(&mut self, result: Result<(), Failure>) -> Result<(), Gone> {
        let stopped = self.stop().await?;
        let lost = stopped.clone().err().filter(DeviceError::leaves_unknown);
        let result = result.and_then(|()| stopped.map_err(Failure::Device));
        self.post.tell(News::ScanEnded { result }).await;
        lost.map_or(Ok(()), |error| Err(Gone::Lost(error)))
    }

    /// Hands over what comes until all have come.
    async fn take(&mut self, taking: Taking) -> Ending {
        let mut received_count = 0;
        while received_count < taking.profiles_count {
            let handled = self.post.handled;
            let received = tokio::select! {
                biased;
                raised = raised(&mut self.post.halts, handled) => {
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
            received_count = match self.whole(received_count, &profiles) {
                Ok(count) => count,
                Err(failure) => return Ending::Scan(Err(failure)),
            };
            if !matches!(timeout(taking.patience, taking.sink.send(profiles)).await, Ok(Ok(()))) {
                return Ending::Scan(Err(Failure::ProfilesNotTaken));
            }
            self.post.tell(News::Profiles { received_count }).await;
        }
        Ending::Scan(Ok(()))
    }

    /// Whether these are the ones that were due; says how many there are then.
    fn whole(&self, received_count: u64, profiles: &[Profile]) -> Result<u64, Failure> {
        let mut expected = received_count;
        for profile in profiles {
            if profile.index != expected {
                let fault = ScanFault::FrameGap { expected, found: profile.index };
                return Err(Failure::Device(DeviceError::ScanFault { device: self.name(), fault }));
            }
            expected += 1;
        }
        Ok(expected)
    }

    async fn read(&mut self) -> Result<(), Gone> {
        let asked_at = now();
        let (name, patience) = (self.name(), self.patience());
        let reading = call(&name, self.device.read(), &self.post.halts, patience).await?.map_err(Gone::Lost)?;
        self.next_read = now() + self.post.timing.poll;
        self.post.tell(News::Read { asked_at, seen: Seen::Sensor(reading) }).await;
        Ok(())
    }

    async fn told(&mut self, order: u64, outcome: Outcome) {
        self.post.tell(News::Told { order, outcome }).await;
    }

    fn name(&self) -> String {
        self.device.name().to_owned()
    }

    const fn patience(&self) -> Patience {
        Patience { deadline: self.post.timing.reply, grace: self.post.timing.reply, handled: self.post.handled }
    }
}
