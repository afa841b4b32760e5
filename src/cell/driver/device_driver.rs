//! The loop that all drivers share: it stays silent, connects, serves the device, and starts again after a loss. The differences
//! between the kinds of devices are implemented as a [`DeviceDriver`].
//!
//! ```text
//! silence, connect, read --ok--> serve: halt due? -> send the halt, read
//!   ^                                  command?  -> execute it once
//!   | back-off; at least               else      -> read periodically, which also serves as heartbeat
//!   | the longest watchdog               |
//!   +----------------- report ------ link lost
//! ```
//!
//! Before the first call, and after a loss, the driver is silent for the longest watchdog time, because a reading is a heartbeat
//! that would keep the device moving. A command that arrives while there is no link is refused, and never sent later. If the cell
//! ends while there is no link, the driver ends without sending anything: the watchdog stops the device.

use tokio::sync::mpsc;
use tokio::time::{Instant, sleep_until};

use crate::device::clock::now;
use crate::device::{DeviceError, Pending};

use super::context::{Answer, Backoff, DriverContext, raised};
use super::messages::{DeviceReading, DriverEvent, DriverOrder, Outcome, SessionEnd};

/// The first reading of a device, and what it shows about a command whose answer was lost.
pub(in crate::cell) type FirstReading = (DeviceReading, Option<DriverEvent>);

/// The part of a driver that differs between the kinds of devices. It calls the device only through [`DriverContext::ask`].
pub(in crate::cell) trait DeviceDriver: Send {
    /// The commands of the device.
    type Command: Send;

    /// Connects, or connects again, and reads. Moves nothing.
    fn connect(&mut self) -> Pending<'_, Answer<FirstReading>>;

    /// Executes what must be done as soon as there is a link, before halts, commands and readings.
    fn settle(&mut self, _post: &mut DriverContext) -> impl Future<Output = Result<(), SessionEnd>> + Send {
        async { Ok(()) }
    }

    /// Reads the device, and reports the reading.
    fn read(&mut self, context: &mut DriverContext) -> impl Future<Output = Result<(), SessionEnd>> + Send;

    /// Sends the halt that is due, and reads the device.
    fn halt(&mut self, context: &mut DriverContext) -> impl Future<Output = Result<(), SessionEnd>> + Send;

    /// Executes a command once, and reports its outcome.
    fn obey(
        &mut self,
        context: &mut DriverContext,
        order: DriverOrder<Self::Command>,
    ) -> impl Future<Output = Result<(), SessionEnd>> + Send;

    /// Whether the next command may be executed before the outcome of the last one is known.
    fn is_free(&self) -> bool {
        true
    }

    /// Called after the connection was lost by this error, or dropped so that a halt could be sent: reports the commands whose
    /// outcome is unknown.
    fn leave(&mut self, _post: &mut DriverContext, _error: Option<&DeviceError>) -> impl Future<Output = ()> + Send {
        async {}
    }
}

/// The task of a driver.
pub(in crate::cell) struct DriverTask<D: DeviceDriver> {
    driver: D,
    context: DriverContext,
    orders: mpsc::Receiver<DriverOrder<D::Command>>,
    backoff: Backoff,
    /// Whether the loss of the link was reported.
    loss_reported: bool,
    was_up: bool,
}

impl<D: DeviceDriver> DriverTask<D> {
    pub(super) const fn new(
        driver: D,
        context: DriverContext,
        orders: mpsc::Receiver<DriverOrder<D::Command>>,
    ) -> Self {
        let backoff = Backoff::new(context.timing.backoff_first, context.timing.backoff_last);
        Self { driver, context, orders, backoff, loss_reported: false, was_up: false }
    }

    /// Runs until the cell has ended.
    pub(in crate::cell) async fn run(mut self) {
        // An earlier process may have ended during a motion, and a reading would keep that motion alive.
        let mut until = self.context.silent_until();
        while self.wait(until).await {
            let mut gone = self.session().await;
            while matches!(gone, SessionEnd::Cut) {
                // One attempt is made at once, to send the halt; if it fails, it is handled like any other loss.
                self.driver.leave(&mut self.context, None).await;
                let handled = self.context.handled;
                gone = self.session().await;
                if self.context.handled == handled {
                    break;
                }
            }
            match gone {
                SessionEnd::Closed => return,
                SessionEnd::Cut => self.lose(self.context.silent()).await,
                SessionEnd::Lost(error) => self.lose(error).await,
            }
            until = self.context.silent_until().max(now() + self.backoff.wait());
        }
    }

    /// Waits without a link, and refuses commands meanwhile. Returns false when the cell has ended.
    async fn wait(&mut self, until: Instant) -> bool {
        loop {
            tokio::select! {
                order = self.orders.recv() => match order {
                    Some(order) => self.context.decline(order.number).await,
                    None => return false,
                },
                () = sleep_until(until) => return true,
            }
        }
    }

    /// One connection, from its beginning to its end.
    async fn session(&mut self) -> SessionEnd {
        if let Err(gone) = self.connect().await {
            return gone;
        }
        (self.loss_reported, self.was_up) = (false, true);
        self.backoff.relax();
        match self.driver.settle(&mut self.context).await {
            Ok(()) => self.serve().await,
            Err(gone) => gone,
        }
    }

    async fn connect(&mut self) -> Result<(), SessionEnd> {
        let (seen, resolved) = self.context.meet(self.driver.connect()).await?.map_err(SessionEnd::Lost)?;
        while let Ok(order) = self.orders.try_recv() {
            self.context.decline(order.number).await;
        }
        self.context.report(DriverEvent::Up { asked_at: self.context.spoke_at, seen }).await;
        if let Some(resolved) = resolved {
            self.context.report(resolved).await;
        }
        self.context.pace(false);
        Ok(())
    }

    /// Serves the device while there is a link: the halt flag first, then commands, then periodic readings.
    async fn serve(&mut self) -> SessionEnd {
        loop {
            let step = if self.context.halt_is_due() {
                self.driver.halt(&mut self.context).await
            } else {
                let (handled, next_read, free) = (self.context.handled, self.context.next_read, self.driver.is_free());
                tokio::select! {
                    biased;
                    raised = raised(&mut self.context.halts, handled) => if raised { Ok(()) } else { Err(SessionEnd::Closed) },
                    order = self.orders.recv(), if free => match order {
                        Some(order) => self.obey(order).await,
                        None => Err(SessionEnd::Closed),
                    },
                    () = sleep_until(next_read) => self.driver.read(&mut self.context).await,
                }
            };
            if let Err(gone) = step {
                return gone;
            }
        }
    }

    async fn obey(&mut self, order: DriverOrder<D::Command>) -> Result<(), SessionEnd> {
        if order.halts < self.context.halts().number {
            self.context.report_outcome(order.number, Outcome::Overtaken).await;
            return Ok(());
        }
        self.driver.obey(&mut self.context, order).await
    }

    /// Reports a loss once, and the commands whose outcome is unknown.
    async fn lose(&mut self, error: DeviceError) {
        if !self.loss_reported {
            self.context.report(DriverEvent::Lost { error: error.clone(), was_up: self.was_up }).await;
            self.loss_reported = true;
        }
        self.driver.leave(&mut self.context, Some(&error)).await;
    }
}
