//! Drives the stage, by the rules of a manipulator's driver: sent once, halt first, silent after a loss. The stage acknowledges
//! nothing, so that an answer that is lost is a link that is lost.

use super::backoff::Backoff;
use super::call::{Patience, call, raised};
use super::{Gone, News, Order, Outcome, Post, Seen, Travel, WATCHDOG_MARGIN};
use crate::cell::{Failure, now};
use crate::device::{DeviceError, Stage};
use tokio::sync::mpsc;
use tokio::time::{Instant, sleep_until};

/// The driver.
pub(in crate::cell) struct StageDriver {
    device: Box<dyn Stage>,
    post: Post,
    orders: mpsc::Receiver<Order<Travel>>,
    /// A halt after which it was not seen at rest yet.
    halting: Option<u64>,
    next_read: Instant,
    spoke_at: Instant,
    was_up: bool,
}

impl StageDriver {
    pub(in crate::cell) fn new(device: Box<dyn Stage>, post: Post, orders: mpsc::Receiver<Order<Travel>>) -> Self {
        let now = now();
        Self { device, post, orders, halting: None, next_read: now, spoke_at: now, was_up: false }
    }

    /// Drives until the cell has ended.
    pub(in crate::cell) async fn run(mut self) {
        let mut backoff = Backoff::new(self.post.timing.backoff_first, self.post.timing.backoff_last);
        let mut told = false;
        // Whoever commanded it before us may have died in a motion: our reading would keep that alive.
        if !self.wait(now() + self.post.timing.first_silence()).await {
            return;
        }
        loop {
            let mut gone = self.session(&mut backoff, &mut told).await;
            if matches!(gone, Gone::Cut) {
                // One attempt at once, for the halt's sake.
                gone = self.session(&mut backoff, &mut told).await;
            }
            let error = match gone {
                Gone::Closed => return,
                Gone::Cut => DeviceError::Silent { device: self.name(), within: self.post.timing.grace },
                Gone::Lost(error) => error,
            };
            if !told {
                self.post.tell(News::Lost { error, was_up: self.was_up }).await;
                told = true;
            }
            let silence = self.spoke_at + self.post.timing.watchdog + WATCHDOG_MARGIN;
            if !self.wait(silence.max(now() + backoff.wait())).await {
                return;
            }
        }
    }

    /// One connection, from its beginning to its end.
    async fn session(&mut self, backoff: &mut Backoff, told: &mut bool) -> Gone {
        if let Err(gone) = self.connect().await {
            return gone;
        }
        (*told, self.was_up) = (false, true);
        backoff.relax();
        self.attend().await
    }

    async fn wait(&mut self, until: Instant) -> bool {
        loop {
            tokio::select! {
                order = self.orders.recv() => match order {
                    Some(order) => self.decline(&order).await,
                    None => return false,
                },
                () = sleep_until(until) => return true,
            }
        }
    }

    async fn decline(&mut self, order: &Order<Travel>) {
        let error = DeviceError::LinkLost { device: self.name(), cause: "not connected".to_owned() };
        self.told(order.number, Outcome::Refused(error)).await;
    }

    async fn connect(&mut self) -> Result<(), Gone> {
        let asked_at = self.speak();
        let deadline = self.post.timing.connect;
        let patience = Patience { deadline, grace: deadline, handled: u64::MAX };
        let name = self.name();
        let reading = call(&name, self.device.connect(), &self.post.halts, patience).await?.map_err(Gone::Lost)?;
        while let Ok(order) = self.orders.try_recv() {
            self.decline(&order).await;
        }
        self.post.tell(News::Up { asked_at, seen: Seen::Stage(reading) }).await;
        self.next_read = now() + self.post.timing.poll;
        Ok(())
    }

    async fn attend(&mut self) -> Gone {
        loop {
            let step = if self.post.halt_is_due() {
                self.halt().await
            } else {
                let handled = self.post.handled;
                tokio::select! {
                    biased;
                    raised = raised(&mut self.post.halts, handled) => if raised { Ok(()) } else { Err(Gone::Closed) },
                    order = self.orders.recv() => match order {
                        Some(order) => self.obey(&order).await,
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

    async fn halt(&mut self) -> Result<(), Gone> {
        let number = self.post.halts().number;
        self.speak();
        let (name, patience) = (self.name(), self.patience(number));
        let answer = call(&name, self.device.halt(), &self.post.halts, patience).await?;
        let taken = answer.is_ok();
        match answer {
            Ok(()) => self.halting = Some(number),
            Err(error) if error.leaves_unknown() => return Err(Gone::Lost(error)),
            Err(error) => self.post.tell(News::WillNotHalt { error }).await,
        }
        self.post.handed(number, taken);
        self.read().await
    }

    async fn obey(&mut self, order: &Order<Travel>) -> Result<(), Gone> {
        if order.halts < self.post.halts().number {
            self.told(order.number, Outcome::Overtaken).await;
            return Ok(());
        }
        let Travel::To { target_mm, speed_mm_s } = order.errand else { return self.read().await };
        self.speak();
        let (name, patience) = (self.name(), self.patience(self.post.handled));
        let sent = self.device.move_to(order.fence, target_mm, speed_mm_s);
        let outcome = match call(&name, sent, &self.post.halts, patience).await {
            Ok(Ok(())) => Outcome::Taken { sequence: 0 },
            Ok(Err(error)) if !error.leaves_unknown() => Outcome::Refused(error),
            Ok(Err(error)) | Err(Gone::Lost(error)) => {
                self.told(order.number, Outcome::Unknown(Failure::Device(error.clone()))).await;
                return Err(Gone::Lost(error));
            }
            Err(gone) => {
                // Its bytes may have gone.
                let error = DeviceError::Silent { device: self.name(), within: self.post.timing.grace };
                self.told(order.number, Outcome::Unknown(Failure::Device(error))).await;
                return Err(gone);
            }
        };
        self.told(order.number, outcome).await;
        self.read().await
    }

    async fn read(&mut self) -> Result<(), Gone> {
        let asked_at = self.speak();
        let (name, patience) = (self.name(), self.patience(self.post.handled));
        let reading = call(&name, self.device.read(), &self.post.halts, patience).await?.map_err(Gone::Lost)?;
        if let Some(number) = self.halting
            && !reading.moves
        {
            self.halting = None;
            self.post.rested(number).await;
        }
        let busy = reading.moves || self.halting.is_some();
        self.next_read = now() + if busy { self.post.timing.poll_moving } else { self.post.timing.poll };
        self.post.tell(News::Read { asked_at, seen: Seen::Stage(reading) }).await;
        Ok(())
    }

    async fn told(&mut self, order: u64, outcome: Outcome) {
        self.post.tell(News::Told { order, outcome }).await;
    }

    fn name(&self) -> String {
        self.device.name().to_owned()
    }

    fn speak(&mut self) -> Instant {
        self.spoke_at = now();
        self.spoke_at
    }

    const fn patience(&self, handled: u64) -> Patience {
        Patience { deadline: self.post.timing.reply, grace: self.post.timing.grace, handled }
    }
}
