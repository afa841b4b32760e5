//! How a driver waits: the settings' deadlines, and the silence that outlasts every watchdog.

use crate::cell::settings::Settings;
use crate::device::SensorDeadlines;
use std::time::Duration;

/// Longer than the longest watchdog that a device here may have, which is 500 ms. Ours are shorter, but it need not be ours
/// that it keeps: a process before us may have set another, a stage and a map without a register for it have their own.
/// Nothing is said to a device for so long at the start and after a loss, so that whatever moves stops by its watchdog.
pub const SILENCE: Duration = Duration::from_millis(550);

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
    /// How long nothing is said at the start and after a loss.
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
            silence: SILENCE,
            backoff_first: settings.backoff_first,
            backoff_last: settings.backoff_last,
        }
    }

    /// For the sensor, which moves nothing: slower, no less patient than its adaptor, and without silence, since a laser has no
    /// watchdog that the silence would let run out.
    pub(in crate::cell) fn of_sensor(settings: &Settings, own: &SensorDeadlines) -> Self {
        Self {
            poll: settings.sensor_poll,
            reply: settings.sensor_reply.max(own.reply),
            connect: settings.sensor_reply.max(own.connect),
            silence: Duration::ZERO,
            ..Self::of(settings)
        }
    }
}
