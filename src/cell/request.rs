//! What is asked of the cell's task. A request is a message: whoever sent it may hang up, and nothing about it changes.

use super::input::{Manual, Taken};
use super::job::Job;
use super::lease::{Lease, LeaseRequest};
use super::refusal::Refusal;
use super::settings::ScanOrder;
use crate::device::Profile;
use crate::motion::{Carrier, Path};
use tokio::sync::{mpsc, oneshot};

/// Where the answer goes.
pub(super) type Reply<T> = oneshot::Sender<Result<T, Refusal>>;

/// A scan that has begun, and its profiles as they come.
pub(super) type ScanBegun = (Job, mpsc::Receiver<Vec<Profile>>);

/// What is asked.
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
    /// Answers a request that nobody will see to: the cell has ended.
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

/// Answers; where nobody waits for it any more, that is all right.
pub(super) fn answer<T>(reply: Reply<T>, result: Result<T, Refusal>) {
    let _nobody_waits = reply.send(result);
}
