//! What every driver does, whatever its device is: keeps silent, connects, attends, and after a loss begins again. What is
//! particular to a kind of device comes in as an [`Attendant`].
//!
//! ```text
//!  silence, connect, read --ok--> attend: halt due? -> send the halt, read
//!     ^                                   order?    -> do it once
//!     | back-off; at least                else      -> read at the pace; that is our heartbeat too
//!     | the longest watchdog                |
//!     +----------------- report ------- link lost
//! ```
//!
//! Before the first word, and after a loss, it stays silent for the longest watchdog: to read is to tell the device that we
//! live, and it would move on. An order that comes while there is no link is refused, and never sent later. Where the cell ends
//! while there is no link, the driver ends in silence: the device stops by its watchdog, and nothing is sent any more.

use super::backoff::Backoff;
use super::call::{Answer, raised};
use super::post::Post;
use super::{Gone, News, Order, Outcome, Seen};
use crate::cell::now;
use crate::device::{DeviceError, Pending};
use tokio::sync::mpsc;
use tokio::time::{Instant, sleep_until};

/// What a device said first, and what that tells about a command whose answer was lost.
pub(in crate::cell) type Met = (Seen, Option<News>);

/// What is particular to one kind of device. It speaks through [`Post::ask`] only.
pub(in crate::cell) trait Attendant: Send {
    /// What the device can be asked to do.
    type Errand: Send;

    /// Connects, or connects anew, and reads. Moves nothing.
    fn connect(&mut self) -> Pending<'_, Answer<Met>>;

    /// What must be done as soon as there is a link, before halts, orders and readings.
    fn settle(&mut self, _post: &mut Post) -> impl Future<Output = Result<(), Gone>> + Send {
        async { Ok(()) }
    }

    /// Reads, and tells what was read.
    fn read(&mut self, post: &mut Post) -> impl Future<Output = Result<(), Gone>> + Send;

    /// Sends the halt that is due, and reads what came of it.
    fn halt(&mut self, post: &mut Post) -> impl Future<Output = Result<(), Gone>> + Send;

    /// Does what no halt has overtaken, once, and tells what became of it.
    fn obey(&mut self, post: &mut Post, order: Order<Self::Errand>) -> impl Future<Output = Result<(), Gone>> + Send;

    /// Whether another order may come before the word on the last.
    fn is_free(&self) -> bool {
        true
    }

    /// The connection is gone, by this error, or for a halt's sake: says what that leaves open.
    fn leave(&mut self, _post: &mut Post, _error: Option<&DeviceError>) -> impl Future<Output = ()> + Send {
        async {}
    }
}

/// A driver.
pub(in crate::cell) struct Driver<A: Attendant> {
    attendant: A,
    post: Post,
    orders: mpsc::Receiver<Order<A::Errand>>,
    backoff: Backoff,
    /// The loss was reported.
    told: bool,
    was_up: bool,
}

impl<A: Attendant> Driver<A> {
    pub(super) const fn of(attendant: A, post: Post, orders: mpsc::Receiver<Order<A::Errand>>) -> Self {
        let backoff = Backoff::new(post.timing.backoff_first, post.timing.backoff_last);
        Self { attendant, post, orders, backoff, told: false, was_up: false }
    }

    /// Drives until the cell has ended.
    pub(in crate::cell) async fn run(mut self) {
        // Whoever commanded it before us may have died in a motion: our reading would keep that alive.
        let mut until = self.post.silent_until();
        while self.wait(until).await {
            let mut gone = self.session().await;
            while matches!(gone, Gone::Cut) {
                // One attempt at once, for the halt's sake; where it does not get the halt out, it is a loss like any other.
                self.attendant.leave(&mut self.post, None).await;
                let handled = self.post.handled;
                gone = self.session().await;
                if self.post.handled == handled {
                    break;
                }
            }
            match gone {
                Gone::Closed => return,
                Gone::Cut => self.lose(self.post.silent()).await,
                Gone::Lost(error) => self.lose(error).await,
            }
            until = self.post.silent_until().max(now() + self.backoff.wait());
        }
    }

    /// Waits without a link, and answers orders with that. False when the cell has ended.
    async fn wait(&mut self, until: Instant) -> bool {
        loop {
            tokio::select! {
                order = self.orders.recv() => match order {
                    Some(order) => self.post.decline(order.number).await,
                    None => return false,
                },
                () = sleep_until(until) => return true,
            }
        }
    }

    /// One connection, from its beginning to its end.
    async fn session(&mut self) -> Gone {
        if let Err(gone) = self.connect().await {
            return gone;
        }
        (self.told, self.was_up) = (false, true);
        self.backoff.relax();
        match self.attendant.settle(&mut self.post).await {
            Ok(()) => self.attend().await,
            Err(gone) => gone,
        }
    }

    async fn connect(&mut self) -> Result<(), Gone> {
        let (seen, resolved) = self.post.meet(self.attendant.connect()).await?.map_err(Gone::Lost)?;
        while let Ok(order) = self.orders.try_recv() {
            self.post.decline(order.number).await;
        }
        self.post.tell(News::Up { asked_at: self.post.spoke_at, seen }).await;
        if let Some(resolved) = resolved {
            self.post.tell(resolved).await;
        }
        self.post.pace(false);
        Ok(())
    }

    /// With a link: the halt flag first, then orders, then the pace.
    async fn attend(&mut self) -> Gone {
        loop {
            let step = if self.post.halt_is_due() {
                self.attendant.halt(&mut self.post).await
            } else {
                let (handled, next_read, free) = (self.post.handled, self.post.next_read, self.attendant.is_free());
                tokio::select! {
                    biased;
                    raised = raised(&mut self.post.halts, handled) => if raised { Ok(()) } else { Err(Gone::Closed) },
                    order = self.orders.recv(), if free => match order {
                        Some(order) => self.obey(order).await,
                        None => Err(Gone::Closed),
                    },
                    () = sleep_until(next_read) => self.attendant.read(&mut self.post).await,
                }
            };
            if let Err(gone) = step {
                return gone;
            }
        }
    }

    async fn obey(&mut self, order: Order<A::Errand>) -> Result<(), Gone> {
        if order.halts < self.post.halts().number {
            self.post.told(order.number, Outcome::Overtaken).await;
            return Ok(());
        }
        self.attendant.obey(&mut self.post, order).await
    }

    /// Reports a loss, once, and what it leaves open.
    async fn lose(&mut self, error: DeviceError) {
        if !self.told {
            self.post.tell(News::Lost { error: error.clone(), was_up: self.was_up }).await;
            self.told = true;
        }
        self.attendant.leave(&mut self.post, Some(&error)).await;
    }
}
