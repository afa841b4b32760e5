//! Who may move: one lease at a time, with a time to live, renewed by use, and a fence number that grows with every lease and
//! goes to the devices with every command. Pure: the time comes in as an argument.

use super::refusal::Refusal;
use std::time::Duration;
use tokio::time::Instant;

/// What a client asks for.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct LeaseRequest {
    /// Names the lease in every command; a secret between the client and us.
    pub id: String,
    /// Who asks, for others to read.
    pub holder: String,
    /// How long it lasts unless it is used or renewed; brought within the bounds of the settings.
    pub time_to_live: Duration,
}

/// The right to command, as its holder knows it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Lease {
    /// Names it in every command; told to nobody but its holder.
    pub id: String,
    /// Who holds it.
    pub holder: String,
    /// Greater than that of every lease before.
    pub fence: u64,
    /// How long it lasts after each use.
    pub time_to_live: Duration,
    /// When it ends unless it is used.
    pub until: Instant,
}

/// The lease as everybody may see it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct LeaseView {
    /// Who holds it.
    pub holder: String,
    /// Its fence.
    pub fence: u64,
    /// When it ends unless it is used.
    pub until: Instant,
}

/// Bounds of a lease's time to live.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Bounds {
    pub(super) least: Duration,
    pub(super) most: Duration,
}

/// The one lease of the cell, and the newest fence.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Tenancy {
    bounds: Bounds,
    fence: u64,
    lease: Option<Lease>,
    /// Of the lease before, so that its holder is told that it is over.
    last_id: Option<String>,
}

impl Tenancy {
    /// Nobody holds it; every fence to come is above `floor`.
    pub(super) const fn new(bounds: Bounds, floor: u64) -> Self {
        Self { bounds, fence: floor, lease: None, last_id: None }
    }

    /// The newest fence that was given out; halts carry it.
    pub(super) const fn fence(&self) -> u64 {
        self.fence
    }

    /// The lease, where somebody holds it at `now`.
    pub(super) fn held(&self, now: Instant) -> Option<&Lease> {
        self.lease.as_ref().filter(|lease| now < lease.until)
    }

    /// As everybody may see it.
    pub(super) fn view(&self, now: Instant) -> Option<LeaseView> {
        let lease = self.held(now)?;
        Some(LeaseView { holder: lease.holder.clone(), fence: lease.fence, until: lease.until })
    }

    /// When it ends unless it is used.
    pub(super) fn until(&self) -> Option<Instant> {
        self.lease.as_ref().map(|lease| lease.until)
    }

    /// Gives the lease to the one that asks, unless somebody else holds it. Asking again with the same id renews.
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

    /// Uses the lease, which renews it.
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

    /// Gives it back.
    pub(super) fn release(&mut self, now: Instant, id: &str) -> Result<(), Refusal> {
        self.check(now, id)?;
        self.end();
        Ok(())
    }

    /// Ends a lease whose time has run out; says whose.
    pub(super) fn expire(&mut self, now: Instant) -> Option<Lease> {
        if self.lease.as_ref().is_none_or(|lease| now < lease.until) {
            return None;
        }
        let over = self.lease.clone();
        self.end();
        over
    }

    /// Whether `id` names the lease that is held at `now`.
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
