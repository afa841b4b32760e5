//! How a driver waits: the settings' deadlines, and the silence that outlasts every watchdog. Must not know devices.

use crate::cell::Settings;
use std::time::Duration;

/// The longest watchdog that a device here may have. Ours are shorter, but it need not be ours that it keeps: a process before us
/// may have set another, a stage and a map without a register for it have their own. What holds within 500 ms has no longer one.
const LONGEST_WATCHDOG: Duration = Duration::from_millis(500);
/// Silence on top of the longest watchdog before a device is spoken to.
const MARGIN: Duration = Duration::from_millis(50);

/// How a driver waits.
#[derive(Debug, Clone, Copy)]
pub(in crate::cell) struct Timing {
    pub(super) poll: Duration,
    pub(super) poll_moving: Duration,
    pub(super) reply: Duration,
    pub(super) connect: Duration,
    pub(super) acknowledge: Duration,
    pub(super) grace: Duration,
    /// What the devices are asked to keep.
    pub(super) watchdog: Duration,
    /// How long nothing is said at the start and after a loss, so that whatever moves stops by its watchdog.
    pub(super) silence: Duration,
    pub(super) backoff_first: Duration,
    pub(super) backoff_last: Duration,
}

impl Timing {
    pub(in crate::cell) fn of(settings: &Settings) -> Self {
        Self {
            poll: settings.poll,
            poll_moving: settings.poll_moving,
            reply: settings.reply,
            connect: settings.connect,
            acknowledge: settings.acknowledge,
            grace: settings.halt_grace,
            watchdog: settings.watchdog,
            silence: settings.watchdog.max(LONGEST_WATCHDOG) + MARGIN,
            backoff_first: settings.backoff_first,
            backoff_last: settings.backoff_last,
        }
    }

    /// For the sensor, which moves nothing: slower, with more patience, and no silence.
    pub(in crate::cell) fn of_sensor(settings: &Settings) -> Self {
        let reply = settings.sensor_reply;
        let poll = settings.sensor_poll;
        Self {
            poll,
            poll_moving: poll,
            reply,
            connect: reply,
            grace: reply,
            silence: Duration::ZERO,
            ..Self::of(settings)
        }
    }
}
