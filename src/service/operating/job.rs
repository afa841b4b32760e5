//! A job of the cell as it is kept: what was commanded by whom, and how it ended.

use crate::cell::{JobEnd, Lease, Refusal, StopCause};
use crate::store::JobRow;
use jiff::Timestamp;
use serde::{Deserialize, Serialize};

/// What kind of job.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(in crate::service) enum Kind {
    /// The manipulators move.
    Move,
    /// The sensor scans.
    Scan,
    /// A single command to one device, or to all.
    Act,
}

impl Kind {
    /// The word in the store.
    pub(in crate::service) const fn name(self) -> &'static str {
        match self {
            Self::Move => "move",
            Self::Scan => "scan",
            Self::Act => "act",
        }
    }
}

/// How a job stands.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum JobStatus {
    /// Under way.
    Running,
    /// Everything was reached and read back.
    Done,
    /// It was stopped before its end, and every device was seen at rest.
    Stopped,
    /// It could not go on.
    Failed,
    /// It could not go on, and what the devices did is not known.
    Unknown,
    /// The service ended while it was under way; nothing was resumed.
    Interrupted,
    /// The cell refused to begin it; nothing was sent.
    Refused,
}

impl JobStatus {
    const ENDS: [Self; 6] = [Self::Done, Self::Stopped, Self::Failed, Self::Unknown, Self::Interrupted, Self::Refused];

    /// The word in documents, for jobs that are over.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Running => "running",
            Self::Done => "done",
            Self::Stopped => "stopped",
            Self::Failed => "failed",
            Self::Unknown => "unknown",
            Self::Interrupted => "interrupted",
            Self::Refused => "refused",
        }
    }

    /// What a row says; what it says in a word of a later version was no success.
    pub(in crate::service) fn of(row: &JobRow) -> Self {
        match row.ended_at {
            None => Self::Running,
            Some(_) => Self::ENDS.into_iter().find(|end| end.name() == row.state).unwrap_or(Self::Unknown),
        }
    }
}

/// Why a job ended as it did.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct EndReason {
    /// A short word.
    pub code: String,
    /// What happened, as an operator would say it.
    pub text: String,
}

/// A job that was written down, with what it says.
#[derive(Debug, Clone, PartialEq)]
pub struct JobRecord<T> {
    /// Its id.
    pub id: String,
    /// When it was asked for.
    pub created_at: Timestamp,
    /// When it was over.
    pub ended_at: Option<Timestamp>,
    /// How it stands.
    pub standing: JobStatus,
    /// The plan that it executes.
    pub plan_id: Option<String>,
    /// What was commanded.
    pub order: T,
    /// Why it ended, where there is more to say than that it is done.
    pub ending: Option<EndReason>,
}

/// A job, and whether it was begun by an earlier request of the same id, or of the same plan.
#[derive(Debug, Clone, PartialEq)]
pub struct StartedJob<T> {
    /// The job.
    pub job: JobRecord<T>,
    /// Whether nothing was begun for this answer.
    pub replayed: bool,
}

/// Who commands.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Commander {
    /// Who holds the lease; none where the command needs none.
    pub holder: Option<String>,
    /// Its fence.
    pub fence: Option<u64>,
}

impl Commander {
    /// A command that needs no lease, such as a stop.
    pub(in crate::service) const NOBODY: Self = Self { holder: None, fence: None };

    /// The holder of a lease.
    pub(in crate::service) fn by(lease: &Lease) -> Self {
        Self { holder: Some(lease.holder.clone()), fence: Some(lease.fence) }
    }
}

impl EndReason {
    /// How the cell says that a job ended.
    pub(in crate::service) fn of(end: &JobEnd) -> (JobStatus, Option<Self>) {
        let say = |code: &str| Some(Self { code: code.to_owned(), text: end.to_string() });
        match end {
            JobEnd::Done => (JobStatus::Done, None),
            JobEnd::Stopped(cause) => (JobStatus::Stopped, say(stop_code(*cause))),
            JobEnd::Failed(failure) => (JobStatus::Failed, say(failure.code())),
            JobEnd::Unknown(failure) => (JobStatus::Unknown, say(failure.code())),
        }
    }

    /// How a job stands that the cell did not say it had begun.
    pub(in crate::service) fn of_refusal(refusal: &Refusal) -> (JobStatus, Self) {
        let (standing, code) = match refusal {
            Refusal::Unanswered => (JobStatus::Unknown, "cell_failed"),
            Refusal::Closing => (JobStatus::Refused, "service_stopping"),
            _ => (JobStatus::Refused, "refused"),
        };
        (standing, Self { code: code.to_owned(), text: refusal.to_string() })
    }
}

/// A stable short word for what stopped a job.
#[must_use]
pub const fn stop_code(cause: StopCause) -> &'static str {
    match cause {
        StopCause::Requested => "stop_requested",
        StopCause::LeaseOver => "lease_over",
        StopCause::LeaseReleased => "lease_released",
        StopCause::Closing => "service_stopping",
    }
}
