//! Attends the stage, by the rules of a manipulator. The stage acknowledges nothing, so that an answer that is lost is a link
//! that is lost.

use super::attend::{Attendant, Driver, Met};
use super::call::Answer;
use super::post::Post;
use super::{Gone, Order, Outcome, Seen, Travel};
use crate::cell::failure::Failure;
use crate::device::{Pending, Stage};
use tokio::sync::mpsc;

/// The driver of the stage.
pub(in crate::cell) type StageDriver = Driver<StageAttendant>;

/// What is particular to it.
pub(in crate::cell) struct StageAttendant {
    device: Box<dyn Stage>,
    /// A halt after which it was not seen at rest yet.
    halting: Option<u64>,
    /// As it was read last.
    moves: bool,
}

impl StageDriver {
    pub(in crate::cell) const fn new(
        device: Box<dyn Stage>,
        post: Post,
        orders: mpsc::Receiver<Order<Travel>>,
    ) -> Self {
        Self::of(StageAttendant { device, halting: None, moves: false }, post, orders)
    }
}

impl Attendant for StageAttendant {
    type Errand = Travel;

    fn connect(&mut self) -> Pending<'_, Answer<Met>> {
        Box::pin(async move { Ok((Seen::Stage(self.device.connect().await?), None)) })
    }

    async fn read(&mut self, post: &mut Post) -> Result<(), Gone> {
        let reading = post.ask(self.device.read()).await?.map_err(Gone::Lost)?;
        let rested = self.halting.take_if(|_| !reading.moves);
        self.moves = reading.moves;
        post.seen(Seen::Stage(reading), reading.moves).await;
        if let Some(number) = rested {
            post.rested(number).await;
        }
        Ok(())
    }

    async fn halt(&mut self, post: &mut Post) -> Result<(), Gone> {
        let number = post.halts().number;
        let answer = post.ask_for_halt(self.device.halt()).await?;
        let refusal = answer.clone().err();
        if post.halted(number, answer).await? {
            self.halting = Some(number);
        }
        self.read(post).await?;
        match refusal.filter(|_| self.moves) {
            // To go on reading is to keep it alive: left alone, it stops by its watchdog.
            Some(refusal) => Err(Gone::Lost(refusal)),
            None => Ok(()),
        }
    }

    async fn obey(&mut self, post: &mut Post, order: Order<Travel>) -> Result<(), Gone> {
        let Order { number, fence, errand, .. } = order;
        let Travel::To { target_mm, speed_mm_s } = errand else { return self.read(post).await };
        let answer = post.ask(self.device.move_to(fence, target_mm, speed_mm_s)).await;
        let (outcome, gone) = match answer {
            Ok(Ok(())) => (Outcome::Taken { sequence: 0 }, None),
            Ok(Err(error)) if !error.leaves_unknown() => (Outcome::Refused(error), None),
            Ok(Err(error)) | Err(Gone::Lost(error)) => {
                (Outcome::Unknown(Failure::Device(error.clone())), Some(Gone::Lost(error)))
            }
            // Its bytes may have gone.
            Err(gone @ (Gone::Cut | Gone::Closed)) => (Outcome::Cut, Some(gone)),
        };
        post.told(number, outcome).await;
        match gone {
            Some(gone) => Err(gone),
            None if post.halt_is_due() => Ok(()),
            None => self.read(post).await,
        }
    }
}
