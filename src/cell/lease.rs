//! The lease, without which no client may command the cell. There is one at a time, with a time to live that every use renews, and
//! with a fencing token that increases with every lease and goes to the devices with every command. Pure: the time is an argument.

use super::refusal::Refusal;
use std::time::Duration;
use tokio::time::Instant;

/// A request for the lease.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct LeaseRequest {
    /// Identifies the lease in every command; a secret of the client.
    pub id: String,
    /// The name of the client, for others to read.
    pub holder: String,
    /// How long it lasts unless it is used or renewed; the settings limit it.
    pub time_to_live: Duration,
}

/// The lease, as its holder sees it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Lease {
    /// Identifies it in every command; only its holder gets it.
    pub id: String,
    /// The name of its holder.
    pub holder: String,
    /// Its fencing token, greater than that of every previous lease.
    pub fence: u64,
    /// How long it lasts after each use.
    pub time_to_live: Duration,
    /// When it ends unless it is used.
    pub until: Instant,
}

/// The lease, as other clients see it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct LeaseView {
    /// The name of its holder.
    pub holder: String,
    /// Its fencing token.
    pub fence: u64,
    /// When it ends unless it is used.
    pub until: Instant,
}

/// Limits of the time to live of a lease.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct TimeToLiveBounds {
    pub(super) least: Duration,
    pub(super) most: Duration,
}

/// The only lease of the cell, and the newest fencing token.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct LeaseKeeper {
    bounds: TimeToLiveBounds,
    fence: u64,
    lease: Option<Lease>,
    /// Id of the previous lease. Its holder gets an error of its own.
    last_id: Option<String>,
}

impl LeaseKeeper {
    /// Without a lease. Every new fencing token is greater than `floor`.
    pub(super) const fn new(bounds: TimeToLiveBounds, floor: u64) -> Self {
        Self { bounds, fence: floor, lease: None, last_id: None }
    }

    /// The newest fencing token, which halts carry.
    pub(super) const fn fence(&self) -> u64 {
        self.fence
    }

    /// The lease, if it is valid at `now`.
    pub(super) fn held(&self, now: Instant) -> Option<&Lease> {
        self.lease.as_ref().filter(|lease| now < lease.until)
    }

    /// The lease, as other clients see it.
    pub(super) fn view(&self, now: Instant) -> Option<LeaseView> {
        let lease = self.held(now)?;
        Some(LeaseView { holder: lease.holder.clone(), fence: lease.fence, until: lease.until })
    }

    /// When it ends unless it is used.
    pub(super) fn until(&self) -> Option<Instant> {
        self.lease.as_ref().map(|lease| lease.until)
    }

    /// Gives the lease to the client, unless another client holds it. A request with the same id renews it.
    pub(super) fn take(&mut self, now: Instant, request: &LeaseRequest) -> Result<Lease, Refusal> {
        match self.held(now) {
            Some(lease) if lease.id == request.id => return self.renew(now, &request.id),
            Some(lease) => return Err(held_by(lease, now)),
            None => self.end(),
        }
        self.fence = self.fence.saturating_add(1);
        let time_to_live = request.time_to_live.clamp(self.bounds.least, self.bounds.most);
        let lease = Lease {
            id: request.id.clone(),
            holder: request.holder.clone(),
            fence: self.fence,
            time_to_live,
            until: now + time_to_live,
        };
        self.lease = Some(lease.clone());
        Ok(lease)
    }

    /// Renews the lease.
    pub(super) fn renew(&mut self, now: Instant, id: &str) -> Result<Lease, Refusal> {
        self.check(now, id)?;
        match &mut self.lease {
            Some(lease) => {
                lease.until = now + lease.time_to_live;
                Ok(lease.clone())
            }
            None => Err(Refusal::LeaseRequired),
        }
    }

    /// Releases the lease.
    pub(super) fn release(&mut self, now: Instant, id: &str) -> Result<(), Refusal> {
        self.check(now, id)?;
        self.end();
        Ok(())
    }

    /// Ends a lease that has expired, and returns it.
    pub(super) fn expire(&mut self, now: Instant) -> Option<Lease> {
        if self.lease.as_ref().is_none_or(|lease| now < lease.until) {
            return None;
        }
        let over = self.lease.clone();
        self.end();
        over
    }

    /// Checks that `id` is the id of the lease that is valid at `now`.
    pub(super) fn check(&self, now: Instant, id: &str) -> Result<(), Refusal> {
        match self.held(now) {
            Some(lease) if lease.id == id => Ok(()),
            Some(lease) => Err(held_by(lease, now)),
            None if self.was(id) => Err(Refusal::LeaseOver),
            None => Err(Refusal::LeaseRequired),
        }
    }

    fn was(&self, id: &str) -> bool {
        self.last_id.as_deref() == Some(id) || self.lease.as_ref().is_some_and(|lease| lease.id == id)
    }

    fn end(&mut self) {
        if let Some(lease) = self.lease.take() {
            self.last_id = Some(lease.id);
        }
    }
}

fn held_by(lease: &Lease, now: Instant) -> Refusal {
    Refusal::LeaseHeld { holder: lease.holder.clone(), remaining: lease.until.saturating_duration_since(now) }
}
