//! The way in for stops: raises the halt flag itself, past the cell's task and its queue, and says what the drivers have made
//! of it.

use super::driver::{HaltFlag, Halted};
use super::input::Member;
use super::now;
use crate::motion::{Axis, Carrier};
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::watch;
use tokio::time::{Instant, timeout_at};

/// How long the answer waits for what the devices make of it.
const ANSWER_WITHIN: Duration = Duration::from_millis(30);

/// What a stop has brought about by the time of the answer. The stop goes on after it.
#[derive(Debug, Clone, PartialEq)]
pub struct StopReport {
    /// Until the halt was handed to the last device that was reached; until the answer where one was not.
    pub sent_within: Duration,
    /// Every device; of the sensor, its laser is switched off.
    pub devices: Vec<DeviceStop>,
    /// All axes of each manipulator that was not seen at rest after the halt, yet; an operator must take them for moving.
    pub unconfirmed: Vec<(Carrier, Axis)>,
}

/// One device's part of it.
#[derive(Debug, Clone, PartialEq)]
pub struct DeviceStop {
    /// Its name in the configuration.
    pub name: String,
    /// The halt was handed to it.
    pub sent: bool,
    /// It was seen at rest after the halt.
    pub confirmed: bool,
}

/// The way in.
#[derive(Debug)]
pub(super) struct StopDoor {
    flag: Arc<HaltFlag>,
    watched: Vec<(Member, String, watch::Receiver<Halted>)>,
}

impl StopDoor {
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

    /// Waits until all are so, or the time is over.
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
