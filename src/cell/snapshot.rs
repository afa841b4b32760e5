//! A snapshot of the cell at one moment, for all clients. It is published in one step and never changed.

use super::failure::Fault;
use super::lease::LeaseView;
use super::refusal::Refusal;
use super::state::State;
use crate::device::{Reading, SensorReading, StageReading};
use crate::motion::Pair;
use std::time::Duration;
use tokio::time::Instant;

/// The state of the cell and of all its devices at one moment.
#[derive(Debug, Clone, PartialEq)]
pub struct Snapshot {
    /// Sequence number; it increases with every snapshot.
    pub sequence: u64,
    /// When the snapshot was taken.
    pub at: Instant,
    /// The state of the cell.
    pub state: State,
    /// When the cell entered this state.
    pub since: Instant,
    /// A counter that increases with everything that may have moved the part: at the start of a move or a homing, and with each
    /// change of state from then until the cell is idle again.
    pub motions_count: u64,
    /// The current move or scan; in `stopping`, the one that is coming to rest.
    pub job: Option<JobView>,
    /// The lease, if a client holds it.
    pub lease: Option<LeaseView>,
    /// Faults that are latched until a reset, oldest first.
    pub faults: Vec<Fault>,
    /// True while the devices are read after an accepted reset.
    pub resetting: bool,
    /// Both manipulators.
    pub manipulators: Pair<Live<Reading>>,
    /// The stage, if there is one.
    pub stage: Option<Live<StageReading>>,
    /// The sensor, if there is one.
    pub sensor: Option<Live<SensorReading>>,
    /// Whether a move requested with the lease would be started.
    pub commands_allowed: bool,
    /// The reasons why a move would be refused, the most urgent first.
    pub reasons: Vec<Refusal>,
}

/// The id and the progress of a job.
#[derive(Debug, Clone, PartialEq)]
pub struct JobView {
    /// The id that the client gave it.
    pub id: String,
    /// Progress, 0 to 1.
    pub progress: f64,
}

/// The last reading of a device, with its age and the state of the link.
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
    /// A reading older than this, which is three polling periods, is stale.
    pub stale_after: Duration,
}

/// The state of the link to a device.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Link {
    /// The device has not been reached yet.
    Connecting,
    /// The device answers.
    Up,
    /// The device no longer answers; coaxis tries to reconnect.
    Lost,
}

/// The quality of a reading.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Quality {
    /// The device answers.
    Good,
    /// No answer for more than three polling periods.
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
    /// A device that has not been reached yet.
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
