//! A snapshot of the cell at one moment, for all clients: published as a whole, never changed.

use super::failure::Fault;
use super::lease::LeaseView;
use super::refusal::Refusal;
use super::state::State;
use crate::device::{Reading, SensorReading, StageReading};
use crate::motion::Pair;
use std::time::Duration;
use tokio::time::Instant;

/// The whole cell at one moment.
#[derive(Debug, Clone, PartialEq)]
pub struct Snapshot {
    /// Grows with every snapshot.
    pub sequence: u64,
    /// When it was made.
    pub at: Instant,
    /// The state of the cell.
    pub state: State,
    /// Since when it has this state.
    pub since: Instant,
    /// Grows with everything that may have moved the part: when a move or a homing begins, and with each change of state from then
    /// until the cell is idle again.
    pub motions_count: u64,
    /// The current move or scan; in `stopping`, the one that comes to rest.
    pub job: Option<JobView>,
    /// The lease, if a client holds it.
    pub lease: Option<LeaseView>,
    /// Latched until a reset, oldest first.
    pub faults: Vec<Fault>,
    /// A reset was accepted, and the devices are being read.
    pub resetting: bool,
    /// Both manipulators.
    pub manipulators: Pair<Live<Reading>>,
    /// The stage, if there is one.
    pub stage: Option<Live<StageReading>>,
    /// The sensor, if there is one.
    pub sensor: Option<Live<SensorReading>>,
    /// Whether a move of the holder of the lease would be started.
    pub commands_allowed: bool,
    /// The reasons why not, the most urgent first.
    pub reasons: Vec<Refusal>,
}

/// The id and the progress of a job.
#[derive(Debug, Clone, PartialEq)]
pub struct JobView {
    /// The id that the client gave it.
    pub id: String,
    /// 0 to 1.
    pub progress: f64,
}

/// The last reading of a device, and how far it may be trusted.
#[derive(Debug, Clone, PartialEq)]
pub struct Live<R> {
    /// Its name in the configuration.
    pub name: String,
    /// The state of its link.
    pub link: Link,
    /// The last reading; kept when the link is lost.
    pub reading: Option<R>,
    /// When it was requested.
    pub read_at: Option<Instant>,
    /// A reading older than this is stale: three polls.
    pub stale_after: Duration,
}

/// The state of the link to a device.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Link {
    /// The device was not reached yet.
    Connecting,
    /// The device answers.
    Up,
    /// The device does not answer any more; coaxis tries to connect again.
    Lost,
}

/// The quality of a reading.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Quality {
    /// The device answers.
    Good,
    /// No answer for more than three polls.
    Stale,
    /// The link is lost, or was never up.
    Lost,
}

impl Link {
    /// The name in documents.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Connecting => "connecting",
            Self::Up => "up",
            Self::Lost => "lost",
        }
    }
}

impl Quality {
    /// The name in documents.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Good => "good",
            Self::Stale => "stale",
            Self::Lost => "lost",
        }
    }
}

impl<R> Live<R> {
    /// A device that was not reached yet.
    pub(super) const fn unknown(name: String, stale_after: Duration) -> Self {
        Self { name, link: Link::Connecting, reading: None, read_at: None, stale_after }
    }

    /// The age of the reading at `now`; `None` if there is no reading.
    #[must_use]
    pub fn age(&self, now: Instant) -> Option<Duration> {
        self.read_at.map(|at| now.saturating_duration_since(at))
    }

    /// The quality of the reading at `now`.
    #[must_use]
    pub fn quality(&self, now: Instant) -> Quality {
        match (self.link, self.age(now)) {
            (Link::Up, Some(age)) if age <= self.stale_after => Quality::Good,
            (Link::Up, Some(_)) => Quality::Stale,
            (Link::Up, None) | (Link::Connecting | Link::Lost, _) => Quality::Lost,
        }
    }

    /// The reading, if its quality is good at `now`.
    pub(super) fn good(&self, now: Instant) -> Option<&R> {
        self.reading.as_ref().filter(|_| self.quality(now) == Quality::Good)
    }
}
