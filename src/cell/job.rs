//! A move or a scan as the one who started it sees it, and how it ended. Dropping a [`Job`] changes nothing about the job.

use super::failure::{Failure, StopCause};
use std::fmt;
use tokio::sync::watch;

/// A move or a scan that was started.
#[derive(Debug, Clone)]
pub struct Job {
    /// As the caller named it.
    pub id: String,
    state: watch::Receiver<JobState>,
}

/// How a job stands.
#[derive(Debug, Clone, PartialEq)]
pub enum JobState {
    /// Under way, or coming to rest.
    Running {
        /// 0 to 1: of the path's waypoints, or of the profiles.
        progress: f64,
    },
    /// Over; final.
    Ended(JobEnd),
}

/// How a job ended.
#[derive(Debug, Clone, PartialEq)]
pub enum JobEnd {
    /// Everything was reached and read back.
    Done,
    /// It was stopped, and every device was seen at rest.
    Stopped(StopCause),
    /// It could not go on; the devices were told to stop.
    Failed(Failure),
    /// It could not go on, and where the devices are, or whether they did the last command, is not known.
    Unknown(Failure),
}

impl fmt::Display for JobEnd {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Done => f.write_str("done"),
            Self::Stopped(cause) => write!(f, "stopped: {}", cause.text()),
            Self::Failed(failure) => write!(f, "failed: {failure}"),
            Self::Unknown(failure) => write!(f, "unknown where the devices are: {failure}"),
        }
    }
}

impl Job {
    /// A job and the end by which the cell tells of it.
    pub(super) fn new(id: String) -> (Self, watch::Sender<JobState>) {
        let (told, state) = watch::channel(JobState::Running { progress: 0.0 });
        (Self { id, state }, told)
    }

    /// How it stands now.
    #[must_use]
    pub fn state(&self) -> JobState {
        self.state.borrow().clone()
    }

    /// Changes whenever the state does.
    #[must_use]
    pub fn watch(&self) -> watch::Receiver<JobState> {
        self.state.clone()
    }

    /// Waits for the end. May be dropped at any time.
    pub async fn ended(&self) -> JobEnd {
        let mut state = self.state.clone();
        let ended = state.wait_for(|state| matches!(state, JobState::Ended(_))).await;
        match ended.as_deref() {
            Ok(JobState::Ended(end)) => end.clone(),
            // The cell's task is gone without a word; nothing is known then.
            Ok(JobState::Running { .. }) | Err(_) => JobEnd::Unknown(Failure::CellGone),
        }
    }
}
