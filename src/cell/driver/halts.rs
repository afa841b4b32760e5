//! The halt flag: a number that grows with every halt, raised by whoever must stop the devices and looked at first by every
//! driver. Raising it takes no lock that anybody holds for long, and waits for nobody.

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
    /// Which axes moved when it was read last after a halt; those of a manipulator in their order.
    pub(in crate::cell) moves: [bool; 4],
    /// It was read after the newest halt that was sent.
    pub(in crate::cell) read_after: u64,
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
