//! What the sensor says it lost, and how warm it is, from its health messages. Counters run on from scan to scan and begin anew
//! when the sensor does.

use super::codec::{Health, indicator};
use crate::device::error::ScanFault;

/// What the state is where the sensor runs.
const RUNNING: i64 = 1;

/// One counter.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
struct Counter {
    last: Option<i64>,
    /// Since the scan began.
    lost_count: u64,
}

impl Counter {
    /// A counter that was never heard of stood at 0; one that went back began anew from there.
    fn take(&mut self, value: i64, scanning: bool) {
        let value = value.max(0);
        let before = self.last.unwrap_or(0);
        let rise = if value >= before { value - before } else { value };
        if scanning {
            self.lost_count = self.lost_count.saturating_add(rise.unsigned_abs());
        }
        self.last = Some(value);
    }
}

/// The sensor's health as last heard.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(super) struct Wellness {
    triggers: Counter,
    network: Counter,
    processing: Counter,
    temperature_c: Option<f64>,
    /// By the newest message; `None` where it says nothing.
    state: Option<i64>,
    scanning: bool,
}

impl Wellness {
    /// What is lost from now on counts.
    pub(super) fn begin_scan(&mut self) {
        for counter in [&mut self.triggers, &mut self.network, &mut self.processing] {
            counter.lost_count = 0;
        }
        self.scanning = true;
    }

    /// What is lost from now on does not count.
    pub(super) fn end_scan(&mut self) {
        self.scanning = false;
    }

    pub(super) fn temperature_c(&self) -> Option<f64> {
        self.temperature_c
    }

    /// The newest message does not say that the sensor runs.
    pub(super) fn is_stopped(&self) -> bool {
        self.state != Some(RUNNING)
    }

    /// Takes a message.
    pub(super) fn take(&mut self, health: &Health<'_>) {
        self.state = None;
        for found in health.iter() {
            match found.id {
                indicator::TRIGGER_DROPS => self.triggers.take(found.value, self.scanning),
                indicator::NETWORK_DROPS => self.network.take(found.value, self.scanning),
                indicator::PROCESSING_DROPS => self.processing.take(found.value, self.scanning),
                indicator::STATE => self.state = Some(found.value),
                indicator::TEMPERATURE => self.temperature_c = Some(found.value as f64 / 100.0),
                _ => {}
            }
        }
    }

    /// What was lost since the scan began, the first in the order of the way that a profile goes.
    pub(super) fn fault(&self) -> Option<ScanFault> {
        match (self.triggers.lost_count, self.processing.lost_count, self.network.lost_count) {
            (0, 0, 0) => None,
            (0, 0, count) => Some(ScanFault::NetworkDrops { count }),
            (0, count, _) => Some(ScanFault::ProcessingDrops { count }),
            (count, _, _) => Some(ScanFault::TriggerDrops { count }),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::device::gocator::codec::{Indicator, Message, decode};

    fn heard(wellness: &mut Wellness, id: u32, value: i64) {
        let mut bytes = Vec::new();
        Health::encode(0, &[Indicator { id, instance: 0, value }], &mut bytes);
        match decode(&bytes).expect("whole").message {
            Message::Health(health) => wellness.take(&health),
            other => panic!("{other:?}"),
        }
    }

    #[test]
    fn only_what_is_lost_during_the_scan_counts() {
        let mut wellness = Wellness::default();
        heard(&mut wellness, indicator::NETWORK_DROPS, 7);
        wellness.begin_scan();
        heard(&mut wellness, indicator::NETWORK_DROPS, 7);
        assert_eq!(wellness.fault(), None);
        heard(&mut wellness, indicator::NETWORK_DROPS, 9);
        assert_eq!(wellness.fault(), Some(ScanFault::NetworkDrops { count: 2 }));
        wellness.end_scan();
        heard(&mut wellness, indicator::NETWORK_DROPS, 20);
        wellness.begin_scan();
        assert_eq!(wellness.fault(), None);
    }

    #[test]
    fn a_counter_that_begins_anew_at_the_start_hides_nothing() {
        let mut wellness = Wellness::default();
        heard(&mut wellness, indicator::TRIGGER_DROPS, 7);
        wellness.begin_scan();
        heard(&mut wellness, indicator::TRIGGER_DROPS, 3);
        assert_eq!(wellness.fault(), Some(ScanFault::TriggerDrops { count: 3 }));
    }

    #[test]
    fn the_temperature_is_in_hundredths() {
        let mut wellness = Wellness::default();
        heard(&mut wellness, indicator::TEMPERATURE, 4_125);
        assert_eq!(wellness.temperature_c(), Some(41.25));
    }
}
