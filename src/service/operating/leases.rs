//! The lease: taken, used, given back. Whoever names another than the one that is held is told so.

use std::sync::{Arc, PoisonError};
use std::time::Duration;

use jiff::Timestamp;

use super::cell_handle::CellHandle;
use super::job::Commander;
use super::state::Operating;
use crate::cell::{Lease, LeaseRequest, Refusal};
use crate::service::error::ServiceError;
use crate::store::RequestKey;

/// Longest name of a holder.
pub const HOLDER_CHARACTERS_MAX: usize = 64;

/// A lease as its holder is told.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct HeldLease {
    /// Names it in every command; a secret.
    pub id: String,
    /// Who holds it.
    pub holder: String,
    /// Goes to the devices with every command.
    pub fence: u64,
    /// How long it lasts after each use.
    pub time_to_live: Duration,
    /// When it ends unless it is used.
    pub until_at: Timestamp,
}

/// A lease was named, and it is not the one that is held.
fn of_another(refusal: Refusal) -> ServiceError {
    match refusal {
        Refusal::LeaseHeld { holder, remaining } => ServiceError::LeaseOfAnother { holder, remaining },
        refusal => refusal.into(),
    }
}

impl Operating {
    /// Gives the lease to `holder`, unless somebody else holds it. Its fence is remembered before anybody can command by it.
    ///
    /// # Errors
    /// [`ServiceError::Value`], [`ServiceError::Cell`] where somebody else holds it.
    pub async fn take_lease(
        self: &Arc<Self>,
        holder: String,
        time_to_live: Option<Duration>,
    ) -> Result<HeldLease, ServiceError> {
        let handle = self.cell_handle()?;
        let time_to_live = self.time_to_live(handle, time_to_live)?;
        let plain = !holder.is_empty()
            && holder.chars().count() <= HOLDER_CHARACTERS_MAX
            && !holder.chars().any(char::is_control);
        if !plain {
            let (field, allowed) = ("holder", "1 to 64 characters that can be seen");
            return Err(ServiceError::Value { field, allowed: allowed.to_owned() });
        }
        let request = LeaseRequest { id: self.shared.clock.new_id("l-"), holder, time_to_live };
        let service = Arc::clone(self);
        // Whoever hangs up here has a lease that he knows nothing of; it runs out.
        let taking = async move {
            let handle = service.cell_handle()?;
            let mut newest = handle.fence.lock().await;
            // Whoever asks while somebody else holds it costs no write; the id is new, so nothing is renewed by this.
            if let Err(refusal @ (Refusal::LeaseHeld { .. } | Refusal::Closing)) =
                handle.cell.renew_lease(&request.id).await
            {
                return Err(refusal.into());
            }
            // Stored first: a fence that could be forgotten is never given out.
            service.shared.store.raise_fence(newest.saturating_add(1)).await?;
            let lease = handle.cell.take_lease(request).await?;
            *handle.newest_lease.lock().unwrap_or_else(PoisonError::into_inner) = Some((lease.id.clone(), lease.fence));
            *newest = lease.fence;
            Ok(service.held(lease))
        };
        self.shared.background.run_detached(taking).await
    }

    /// Refuses a time to live beyond the bounds of the configuration.
    ///
    /// # Errors
    /// [`ServiceError::Value`], [`ServiceError::CellAbsent`].
    pub fn check_time_to_live(&self, asked: Duration) -> Result<(), ServiceError> {
        self.time_to_live(self.cell_handle()?, Some(asked)).map(drop)
    }

    /// Uses the lease, which renews it.
    ///
    /// # Errors
    /// [`ServiceError::Cell`] where it is over or somebody else's.
    pub async fn renew_lease(&self, id: &str) -> Result<HeldLease, ServiceError> {
        Ok(self.held(self.use_lease(id).await?))
    }

    /// Whether this is the id of the lease that is held. Nothing is waited for, and the lease is not renewed by it.
    #[must_use]
    pub fn holds_lease(&self, id: &str) -> bool {
        let Some(handle) = &self.cell else { return false };
        let Some(held) = handle.cell.snapshot().lease.clone() else { return false };
        let newest = handle.newest_lease.lock().unwrap_or_else(PoisonError::into_inner);
        newest.as_ref().is_some_and(|(newest, fence)| newest == id && *fence == held.fence)
            && self.shared.clock.instant() < held.until
    }

    /// Gives the lease back; what moves by it stops.
    ///
    /// # Errors
    /// [`ServiceError::Cell`] where it is over or somebody else's.
    pub async fn release_lease(&self, id: &str) -> Result<(), ServiceError> {
        let handle = self.cell_handle()?;
        handle.cell.release_lease(id).await.map_err(of_another)?;
        // The cell publishes its state a moment after its answer.
        handle.newest_lease.lock().unwrap_or_else(PoisonError::into_inner).take_if(|(newest, _)| newest == id);
        Ok(())
    }

    /// The lease of this id, renewed.
    pub(in crate::service) async fn use_lease(&self, id: &str) -> Result<Lease, ServiceError> {
        self.cell_handle()?.cell.renew_lease(id).await.map_err(of_another)
    }

    /// Who commands by the lease of this id, for the record. Refuses a client that does not hold it, before anything is written
    /// or planned for it; the lease is renewed by that. A request that was answered before is answered again without a lease,
    /// and nothing is recorded for it.
    pub(in crate::service) async fn authorise(
        &self,
        id: &str,
        request: Option<&RequestKey>,
    ) -> Result<Commander, ServiceError> {
        if let Some(request) = request
            && self.shared.store.job_by_request(&request.id).await?.is_some()
        {
            return Ok(Commander::NOBODY);
        }
        // The cell's answer, not its newest snapshot: the lease may change hands before the command is recorded.
        Ok(Commander::by(&self.use_lease(id).await?))
    }

    fn held(&self, lease: Lease) -> HeldLease {
        let until_at = self.shared.clock.wall(lease.until);
        let Lease { id, holder, fence, time_to_live, .. } = lease;
        HeldLease { id, holder, fence, time_to_live, until_at }
    }

    fn time_to_live(&self, handle: &CellHandle, asked: Option<Duration>) -> Result<Duration, ServiceError> {
        let lease = &handle.config.lease;
        let Some(asked) = asked else { return Ok(Duration::from_millis(lease.ttl_ms)) };
        let (least, most) = (Duration::from_millis(lease.ttl_min_ms), Duration::from_millis(lease.ttl_max_ms));
        if !(least..=most).contains(&asked) {
            let allowed = format!("between {} and {}", least.as_secs_f64(), most.as_secs_f64());
            return Err(ServiceError::Value { field: "ttl_s", allowed });
        }
        Ok(asked)
    }
}
