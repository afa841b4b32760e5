//! The requests to the task of the cell, and the [`Job`] with which a client follows a move or a scan. A request is executed even
//! if its client has disconnected, and a job continues when its handle is dropped.

use tokio::sync::{mpsc, oneshot, watch};

use crate::device::Profile;
use crate::motion::{Carrier, Path};

use super::failure::{Failure, JobEnd};
use super::input::{Manual, Taken};
use super::lease::{Lease, LeaseRequest};
use super::refusal::Refusal;
use super::settings::ScanOrder;

/// The channel for the answer.
pub(super) type Reply<T> = oneshot::Sender<Result<T, Refusal>>;

/// A scan that has begun, and the channel of its profiles.
pub(super) type ScanBegun = (Job, mpsc::Receiver<Vec<Profile>>);

/// A request.
#[derive(Debug)]
pub(super) enum Request {
    TakeLease(LeaseRequest, Reply<Lease>),
    RenewLease(String, Reply<Lease>),
    ReleaseLease(String, Reply<()>),
    Act { lease: String, carrier: Carrier, manual: Manual, reply: Reply<Taken> },
    Move { lease: String, job: String, path: Path, reply: Reply<Job> },
    Scan { lease: String, job: String, order: ScanOrder, reply: Reply<ScanBegun> },
    Reset { lease: String, reply: Reply<Taken> },
    Close(oneshot::Sender<()>),
}

impl Request {
    /// Refuses the request, because the cell has ended.
    pub(super) fn refuse(self) {
        match self {
            Self::TakeLease(_, reply) | Self::RenewLease(_, reply) => answer(reply, Err(Refusal::Closing)),
            Self::ReleaseLease(_, reply) => answer(reply, Err(Refusal::Closing)),
            Self::Act { reply, .. } | Self::Reset { reply, .. } => answer(reply, Err(Refusal::Closing)),
            Self::Move { reply, .. } => answer(reply, Err(Refusal::Closing)),
            Self::Scan { reply, .. } => answer(reply, Err(Refusal::Closing)),
            Self::Close(closed) => {
                let _nobody_waits = closed.send(());
            }
        }
    }
}

/// Sends an answer. It is dropped if the client no longer waits for it.
pub(super) fn answer<T>(reply: Reply<T>, result: Result<T, Refusal>) {
    let _nobody_waits = reply.send(result);
}

/// A move or a scan that was started.
#[derive(Debug, Clone)]
pub struct Job {
    /// The id that the client gave it.
    pub id: String,
    state: watch::Receiver<JobState>,
}

/// The state of a job.
#[derive(Debug, Clone, PartialEq)]
pub enum JobState {
    /// The job is under way, or comes to rest.
    Running {
        /// The fraction of the waypoints or of the profiles, 0 to 1.
        progress: f64,
    },
    /// The job has ended; this state is final.
    Ended(JobEnd),
}

impl Job {
    /// Creates a job, and the channel by which the cell reports its state.
    pub(super) fn new(id: String) -> (Self, watch::Sender<JobState>) {
        let (reporter, state) = watch::channel(JobState::Running { progress: 0.0 });
        (Self { id, state }, reporter)
    }

    /// The current state.
    #[must_use]
    pub fn state(&self) -> JobState {
        self.state.borrow().clone()
    }

    /// A channel that changes with the state.
    #[must_use]
    pub fn watch(&self) -> watch::Receiver<JobState> {
        self.state.clone()
    }

    /// Waits for the end. The future may be dropped at any time.
    pub async fn ended(&self) -> JobEnd {
        let mut state = self.state.clone();
        let ended = state.wait_for(|state| matches!(state, JobState::Ended(_))).await;
        match ended.as_deref() {
            Ok(JobState::Ended(end)) => end.clone(),
            // The task of the cell has ended without a report.
            Ok(JobState::Running { .. }) | Err(_) => JobEnd::Unknown(Failure::CellGone),
        }
    }
}
