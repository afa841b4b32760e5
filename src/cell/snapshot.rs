//! The cell as everybody may see it, at one moment: published as a whole, never changed.

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
    /// What the cell does.
    pub state: State,
    /// Since when.
    pub since: Instant,
    /// Grows with everything that may have moved the part: with the begin of a move or a homing, and with each change of state
    /// from then until the cell is idle again.
    pub motions_count: u64,
    /// The move or scan under way; in `stopping`, the one that comes to rest.
    pub job: Option<JobView>,
    /// Who may move.
    pub lease: Option<LeaseView>,
    /// Latched until a reset, oldest first.
    pub faults: Vec<Fault>,
    /// A reset was accepted, and the devices are being read.
    pub resetting: bool,
    /// Both manipulators.
    pub manipulators: Pair<Live<Reading>>,
    /// The stage, where there is one.
    pub stage: Option<Live<StageReading>>,
    /// The sensor, where there is one.
    pub sensor: Option<Live<SensorReading>>,
    /// A move by the holder of the lease would be begun.
    pub commands_allowed: bool,
    /// Why not; all reasons, the most urgent first.
    pub reasons: Vec<Refusal>,
}

/// A job in short.
#[derive(Debug, Clone, PartialEq)]
pub struct JobView {
    /// As its caller named it.
    pub id: String,
    /// 0 to 1.
    pub progress: f64,
}

/// What a device last said, and how well we know that it still holds.
#[derive(Debug, Clone, PartialEq)]
pub struct Live<R> {
    /// Its name in the configuration.
    pub name: String,
    /// How its link is.
    pub link: Link,
    /// What it said last; kept when the link is lost, as what was last known.
    pub reading: Option<R>,
    /// When that was asked.
    pub read_at: Option<Instant>,
    /// Older than this is stale: three polls.
    pub stale_after: Duration,
}

/// How a device's link is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Link {
    /// Not reached yet.
    Connecting,
    /// It answers.
    Up,
    /// It answered once, and does not now; being tried again.
    Lost,
}

/// How far a live value may be trusted.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Quality {
    /// The device answers.
    Good,
    /// No answer for more than three polls.
    Stale,
    /// The link is lost, or never was.
    Lost,
}

impl Link {
    /// The word used in documents.
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
    /// The word used in documents.
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
    /// Not reached yet.
    pub(super) const fn unknown(name: String, stale_after: Duration) -> Self {
        Self { name, link: Link::Connecting, reading: None, read_at: None, stale_after }
    }

    /// How old the reading is at `now`; `None` where there is none.
    #[must_use]
    pub fn age(&self, now: Instant) -> Option<Duration> {
        self.read_at.map(|at| now.saturating_duration_since(at))
    }

    /// How far the reading may be trusted at `now`.
    #[must_use]
    pub fn quality(&self, now: Instant) -> Quality {
        match (self.link, self.age(now)) {
            (Link::Up, Some(age)) if age <= self.stale_after => Quality::Good,
            (Link::Up, Some(_)) => Quality::Stale,
            (Link::Up, None) | (Link::Connecting | Link::Lost, _) => Quality::Lost,
        }
    }

    /// The reading, where it may be trusted at `now`.
    pub(super) fn good(&self, now: Instant) -> Option<&R> {
        self.reading.as_ref().filter(|_| self.quality(now) == Quality::Good)
    }
}
