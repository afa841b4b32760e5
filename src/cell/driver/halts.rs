//! The halt flag: a number that grows with every halt, raised by whoever must stop the devices and looked at first by every
//! driver. Raising it takes no lock that anybody holds for long, and waits for nobody.

use std::sync::Arc;
use tokio::sync::watch;

/// What the flag shows.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(in crate::cell) struct Halts {
    /// Grows with every halt.
    pub(in crate::cell) number: u64,
    /// Grows with every stop that was requested from outside.
    pub(in crate::cell) requested: u64,
    /// The newest fence; halts carry it.
    pub(in crate::cell) fence: u64,
}

/// What a driver has done about it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(in crate::cell) struct Halted {
    /// The newest halt that was handed to the device.
    pub(in crate::cell) sent: u64,
    /// The newest halt after which the device was seen at rest.
    pub(in crate::cell) rested: u64,
}

/// Raises the flag when it is dropped before it was disarmed: a task that ends in the middle leaves nothing moving.
#[derive(Debug)]
pub(in crate::cell) struct HaltAtEnd {
    flag: Arc<HaltFlag>,
    armed: bool,
}

impl HaltAtEnd {
    pub(in crate::cell) const fn new(flag: Arc<HaltFlag>) -> Self {
        Self { flag, armed: true }
    }

    /// The end is a good one.
    pub(in crate::cell) fn disarm(mut self) {
        self.armed = false;
    }
}

impl Drop for HaltAtEnd {
    fn drop(&mut self) {
        if self.armed {
            self.flag.raise();
        }
    }
}

/// The flag.
#[derive(Debug)]
pub(in crate::cell) struct HaltFlag {
    shown: watch::Sender<Halts>,
}

impl HaltFlag {
    pub(in crate::cell) fn new(fence: u64) -> Self {
        Self { shown: watch::Sender::new(Halts { fence, ..Halts::default() }) }
    }

    /// Raises it for the cell's own reasons; says the number.
    pub(in crate::cell) fn raise(&self) -> u64 {
        self.shown.send_modify(|halts| halts.number += 1);
        self.shown.borrow().number
    }

    /// Raises it for somebody who asks for a stop; says the number.
    pub(in crate::cell) fn request(&self) -> u64 {
        self.shown.send_modify(|halts| {
            halts.number += 1;
            halts.requested += 1;
        });
        self.shown.borrow().number
    }

    /// From here on halts carry this fence.
    pub(in crate::cell) fn set_fence(&self, fence: u64) {
        self.shown.send_if_modified(|halts| {
            halts.fence = fence;
            false
        });
    }

    pub(in crate::cell) fn watch(&self) -> watch::Receiver<Halts> {
        self.shown.subscribe()
    }
}
