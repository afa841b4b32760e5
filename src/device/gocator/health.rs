//! The health channel: about every second the sensor reports its losses and its temperature without a request. Its counters
//! continue from scan to scan and are reset to 0 when the sensor restarts.

use std::time::Duration;

use tokio::time::timeout;

use crate::device::error::{DeviceError, ScanFault};

use super::channel::{Channel, Peer};
use super::codec::{Health, Message, decode, indicator};
use super::settings::{Settings, duration};

const FRAME_BYTES_MAX: usize = 1024 * 1024;

/// The health channel and its newest values.
#[derive(Debug)]
pub(super) struct HealthLink {
    channel: Channel,
    pub(super) status: HealthStatus,
    pub(super) within: Duration,
    heard: bool,
}

impl HealthLink {
    /// Connects, and waits for the first message if `hears` is true.
    pub(super) async fn open(peer: &Peer, settings: &Settings, hears: bool) -> Result<Self, DeviceError> {
        let connect_within = duration(settings.deadlines.connect_ms);
        let mut link = Self {
            channel: Channel::open(peer, settings.health_port, connect_within, FRAME_BYTES_MAX).await?,
            status: HealthStatus::default(),
            within: duration(settings.deadlines.health_ms),
            heard: false,
        };
        if hears {
            link.hear_first().await?;
        }
        Ok(link)
    }

    /// Waits for the first message, unless it has already been received.
    pub(super) async fn hear_first(&mut self) -> Result<(), DeviceError> {
        if self.heard { Ok(()) } else { self.hear_until(|_| true).await }
    }

    /// Waits for bytes, and handles them; returns the number of messages. It can be dropped at any time without losing data.
    pub(super) async fn hear(&mut self) -> Result<u32, DeviceError> {
        self.channel.fill().await?;
        self.take_all()
    }

    /// Waits for a message after which the condition is true, at most for the longest interval between two messages.
    pub(super) async fn hear_until(&mut self, is_so: impl Fn(&HealthStatus) -> bool) -> Result<(), DeviceError> {
        let within = self.within;
        let hearing = async {
            while self.hear().await? == 0 || !is_so(&self.status) {}
            Ok(())
        };
        let heard = timeout(within, hearing).await;
        heard.unwrap_or_else(|_| Err(self.channel.peer.silent(within)))
    }

    /// Handles the bytes that have already been received.
    pub(super) fn catch_up(&mut self) -> Result<(), DeviceError> {
        while self.channel.fill_at_once()? {
            self.take_all()?;
        }
        Ok(())
    }

    fn take_all(&mut self) -> Result<u32, DeviceError> {
        let Self { channel, status, heard, .. } = self;
        let peer = channel.peer.clone();
        let mut heard_count = 0;
        while let Some(frame) = channel.frame().map_err(|error| peer.implausible(&error))? {
            if let Message::Health(health) = decode(frame).map_err(|error| peer.implausible(&error))?.message {
                status.take(&health);
                (*heard, heard_count) = (true, heard_count + 1);
            }
        }
        Ok(heard_count)
    }
}

/// Value of the state while the sensor is running.
const RUNNING: i64 = 1;

/// One counter.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
struct Counter {
    last: Option<i64>,
    /// Increase since the scan began.
    lost_count: u64,
}

impl Counter {
    /// A counter without an earlier value started at 0; one that decreased was restarted at 0.
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

/// The health of the sensor according to its newest message.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(super) struct HealthStatus {
    triggers: Counter,
    network: Counter,
    processing: Counter,
    temperature_c: Option<f64>,
    /// The state in the newest message; `None` if the message does not contain it.
    state: Option<i64>,
    scanning: bool,
}

impl HealthStatus {
    /// Counts losses from now on.
    pub(super) fn begin_scan(&mut self) {
        for counter in [&mut self.triggers, &mut self.network, &mut self.processing] {
            counter.lost_count = 0;
        }
        self.scanning = true;
    }

    /// Stops counting losses.
    pub(super) fn end_scan(&mut self) {
        self.scanning = false;
    }

    pub(super) fn temperature_c(&self) -> Option<f64> {
        self.temperature_c
    }

    /// Whether the sensor is not running, by the newest message.
    pub(super) fn is_stopped(&self) -> bool {
        self.state != Some(RUNNING)
    }

    /// Handles a message.
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

    /// The loss since the scan began, if any; the earliest stage in the path of a profile first.
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

    fn heard(status: &mut HealthStatus, id: u32, value: i64) {
        let mut bytes = Vec::new();
        Health::encode(0, &[Indicator { id, instance: 0, value }], &mut bytes);
        match decode(&bytes).expect("complete").message {
            Message::Health(health) => status.take(&health),
            other => panic!("{other:?}"),
        }
    }

    #[test]
    fn only_losses_during_the_scan_count() {
        let mut status = HealthStatus::default();
        heard(&mut status, indicator::NETWORK_DROPS, 7);
        status.begin_scan();
        heard(&mut status, indicator::NETWORK_DROPS, 7);
        assert_eq!(status.fault(), None);
        heard(&mut status, indicator::NETWORK_DROPS, 9);
        assert_eq!(status.fault(), Some(ScanFault::NetworkDrops { count: 2 }));
        status.end_scan();
        heard(&mut status, indicator::NETWORK_DROPS, 20);
        status.begin_scan();
        assert_eq!(status.fault(), None);
    }

    #[test]
    fn a_counter_that_is_reset_at_the_start_hides_no_loss() {
        let mut status = HealthStatus::default();
        heard(&mut status, indicator::TRIGGER_DROPS, 7);
        status.begin_scan();
        heard(&mut status, indicator::TRIGGER_DROPS, 3);
        assert_eq!(status.fault(), Some(ScanFault::TriggerDrops { count: 3 }));
    }

    #[test]
    fn the_temperature_is_in_hundredths() {
        let mut status = HealthStatus::default();
        heard(&mut status, indicator::TEMPERATURE, 4_125);
        assert_eq!(status.temperature_c(), Some(41.25));
    }
}
