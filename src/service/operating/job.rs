//! The record of a job of the cell: what was commanded, by whom, and how it ended.

use crate::cell::{JobEnd, Lease, Refusal, StopCause};
use crate::store::JobRow;
use jiff::Timestamp;
use serde::{Deserialize, Serialize};

/// Kind of a job.
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
    /// The name in the store.
    pub(in crate::service) const fn name(self) -> &'static str {
        match self {
            Self::Move => "move",
            Self::Scan => "scan",
            Self::Act => "act",
        }
    }
}

/// Status of a job.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum JobStatus {
    /// Under way.
    Running,
    /// Every set-point was reached and confirmed by the devices.
    Done,
    /// It was stopped before its end, and the standstill of every device was confirmed.
    Stopped,
    /// It could not continue.
    Failed,
    /// It could not continue, and the state of the devices is unknown.
    Unknown,
    /// The service ended while it was under way; nothing was resumed.
    Interrupted,
    /// The cell refused it; nothing was sent.
    Refused,
}

impl JobStatus {
    const ENDS: [Self; 6] = [Self::Done, Self::Stopped, Self::Failed, Self::Unknown, Self::Interrupted, Self::Refused];

    /// The name in documents, for jobs that are over.
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

    /// The status of a row; an unknown status of a later version counts as not successful.
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
    /// A short code.
    pub code: String,
    /// What happened, as text for an operator.
    pub text: String,
}

/// A recorded job with its order.
#[derive(Debug, Clone, PartialEq)]
pub struct JobRecord<T> {
    /// Its id.
    pub id: String,
    /// When it was requested.
    pub created_at: Timestamp,
    /// When it ended.
    pub ended_at: Option<Timestamp>,
    /// Its status.
    pub standing: JobStatus,
    /// The plan that it executes.
    pub plan_id: Option<String>,
    /// What was commanded.
    pub order: T,
    /// Why it ended, unless it is done.
    pub ending: Option<EndReason>,
}

/// A job, and whether it was started by an earlier request of the same id or plan.
#[derive(Debug, Clone, PartialEq)]
pub struct StartedJob<T> {
    /// The job.
    pub job: JobRecord<T>,
    /// Whether an earlier answer is repeated, without starting a job.
    pub replayed: bool,
}

/// Who commanded a job.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Commander {
    /// Holder of the lease; none if the command needs none.
    pub holder: Option<String>,
    /// Its fencing token.
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
    /// The status and reason of an end reported by the cell.
    pub(in crate::service) fn of(end: &JobEnd) -> (JobStatus, Option<Self>) {
        let say = |code: &str| Some(Self { code: code.to_owned(), text: end.to_string() });
        match end {
            JobEnd::Done => (JobStatus::Done, None),
            JobEnd::Stopped(cause) => (JobStatus::Stopped, say(stop_code(*cause))),
            JobEnd::Failed(failure) => (JobStatus::Failed, say(failure.code())),
            JobEnd::Unknown(failure) => (JobStatus::Unknown, say(failure.code())),
        }
    }

    /// The status of a job whose start the cell did not confirm.
    pub(in crate::service) fn of_refusal(refusal: &Refusal) -> (JobStatus, Self) {
        let (standing, code) = match refusal {
            Refusal::Unanswered => (JobStatus::Unknown, "cell_failed"),
            Refusal::Closing => (JobStatus::Refused, "service_stopping"),
            _ => (JobStatus::Refused, "refused"),
        };
        (standing, Self { code: code.to_owned(), text: refusal.to_string() })
    }
}

/// A stable short code for the cause of a stop.
#[must_use]
pub const fn stop_code(cause: StopCause) -> &'static str {
    match cause {
        StopCause::Requested => "stop_requested",
        StopCause::LeaseOver => "lease_over",
        StopCause::LeaseReleased => "lease_released",
        StopCause::Closing => "service_stopping",
    }
}
