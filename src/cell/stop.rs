//! The stop: the halt flag, and the handle that raises it without waiting for the task of the cell or its queue, and reports what
//! the drivers have done.
//!
//! The halt flag is a number that increases with every halt. Every driver checks it before anything else. Raising it waits for
//! nothing and takes only a lock that is never held for long.

use std::sync::Arc;
use std::time::Duration;

use tokio::sync::watch;
use tokio::time::{Instant, timeout_at};

use crate::motion::{Axis, Carrier};

use super::input::Member;
use crate::device::clock::now;

/// Longest time that the answer waits for the devices.
const ANSWER_WITHIN: Duration = Duration::from_millis(30);

/// The result of a stop at the time of the answer. The stop continues afterwards.
#[derive(Debug, Clone, PartialEq)]
pub struct StopReport {
    /// Time until the halt was sent to the last device, or until the answer if it could not be sent to every device.
    pub sent_within: Duration,
    /// The state of every device; a halt of the sensor switches its laser off.
    pub devices: Vec<DeviceStop>,
    /// All axes of each manipulator that was not yet read at rest after the halt. An operator must assume that they move.
    pub unconfirmed: Vec<(Carrier, Axis)>,
}

/// The stop of one device.
#[derive(Debug, Clone, PartialEq)]
pub struct DeviceStop {
    /// Its name in the configuration.
    pub name: String,
    /// The halt was sent to it.
    pub sent: bool,
    /// It was read at rest after the halt.
    pub confirmed: bool,
}

/// The handle for stops.
#[derive(Debug)]
pub(super) struct StopEntry {
    flag: Arc<HaltFlag>,
    watched: Vec<(Member, String, watch::Receiver<Halted>)>,
}

impl StopEntry {
    pub(super) const fn new(flag: Arc<HaltFlag>, watched: Vec<(Member, String, watch::Receiver<Halted>)>) -> Self {
        Self { flag, watched }
    }

    pub(super) async fn stop(&self) -> StopReport {
        let asked_at = now();
        let number = self.flag.request();
        let until = asked_at + ANSWER_WITHIN;
        let all_sent = self.all(until, |halted| halted.sent >= number).await;
        let sent_within = now().saturating_duration_since(asked_at);
        if all_sent {
            self.all(until, |halted| halted.rested >= number).await;
        }
        self.report(number, sent_within)
    }

    /// Waits until the condition holds for all devices, or the deadline has passed.
    async fn all(&self, until: Instant, so: impl Fn(&Halted) -> bool) -> bool {
        for (_, _, halted) in &self.watched {
            let mut halted = halted.clone();
            if !matches!(timeout_at(until, halted.wait_for(&so)).await, Ok(Ok(_))) {
                return false;
            }
        }
        true
    }

    fn report(&self, number: u64, sent_within: Duration) -> StopReport {
        let mut report = StopReport { sent_within, devices: Vec::new(), unconfirmed: Vec::new() };
        for (member, name, halted) in &self.watched {
            let halted = *halted.borrow();
            let confirmed = halted.rested >= number;
            if let Member::Manipulator(carrier) = member
                && !confirmed
            {
                report.unconfirmed.extend(Axis::ALL.map(|axis| (*carrier, axis)));
            }
            report.devices.push(DeviceStop { name: name.clone(), sent: halted.sent >= number, confirmed });
        }
        report
    }
}

/// The value of the halt flag.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(super) struct Halts {
    /// Increases with every halt.
    pub(super) number: u64,
    /// Increases with every stop that a client requests.
    pub(super) requested: u64,
    /// The newest fencing token, which halts carry.
    pub(super) fence: u64,
}

/// The newest halts that a driver has executed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(super) struct Halted {
    /// The newest halt that was sent to the device.
    pub(super) sent: u64,
    /// The newest halt after which the device was read at rest.
    pub(super) rested: u64,
}

/// Raises the halt flag if it is dropped before it was disarmed, so that no device moves on when the task of the cell fails.
#[derive(Debug)]
pub(super) struct HaltAtEnd {
    flag: Arc<HaltFlag>,
    armed: bool,
}

impl HaltAtEnd {
    pub(super) const fn new(flag: Arc<HaltFlag>) -> Self {
        Self { flag, armed: true }
    }

    /// Disarms it, because the task ends as intended.
    pub(super) fn disarm(mut self) {
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

/// The halt flag.
#[derive(Debug)]
pub(super) struct HaltFlag {
    shown: watch::Sender<Halts>,
}

impl HaltFlag {
    pub(super) fn new(fence: u64) -> Self {
        Self { shown: watch::Sender::new(Halts { fence, ..Halts::default() }) }
    }

    /// Raises it for the cell itself; returns the number of the halt.
    pub(super) fn raise(&self) -> u64 {
        self.shown.send_modify(|halts| halts.number += 1);
        self.shown.borrow().number
    }

    /// Raises it for a client that requests a stop; returns the number of the halt.
    pub(super) fn request(&self) -> u64 {
        self.shown.send_modify(|halts| {
            halts.number += 1;
            halts.requested += 1;
        });
        self.shown.borrow().number
    }

    /// Sets the fencing token of all following halts.
    pub(super) fn set_fence(&self, fence: u64) {
        self.shown.send_if_modified(|halts| {
            halts.fence = fence;
            false
        });
    }

    pub(super) fn watch(&self) -> watch::Receiver<Halts> {
        self.shown.subscribe()
    }
}
