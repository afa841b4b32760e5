//! The lease: acquired, used, released. A wrong lease id gets its own error.

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

/// A lease as its holder receives it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct HeldLease {
    /// Sent with every command; a secret.
    pub id: String,
    /// Name of the holder.
    pub holder: String,
    /// The fencing token, sent to the devices with every command.
    pub fence: u64,
    /// Time to live after each use.
    pub time_to_live: Duration,
    /// When it expires unless it is used.
    pub until_at: Timestamp,
}

/// The error for a lease id that is not that of the current lease.
fn of_another(refusal: Refusal) -> ServiceError {
    match refusal {
        Refusal::LeaseHeld { holder, remaining } => ServiceError::LeaseOfAnother { holder, remaining },
        refusal => refusal.into(),
    }
}

impl Operating {
    /// Grants the lease to `holder`, unless another client has it. Its fencing token is stored before any command can use it.
    ///
    /// # Errors
    /// [`ServiceError::Value`], [`ServiceError::Cell`] if another client has the lease.
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
        // If the client disconnects here, the lease expires by itself.
        let taking = async move {
            let handle = service.cell_handle()?;
            let mut newest = handle.fence.lock().await;
            // A refused request must cost no write to the store; the id is new, so this does not renew a lease.
            if let Err(refusal @ (Refusal::LeaseHeld { .. } | Refusal::Closing)) =
                handle.cell.renew_lease(&request.id).await
            {
                return Err(refusal.into());
            }
            // The token is stored first, so that no token is issued that a crash could forget.
            service.shared.store.raise_fence(newest.saturating_add(1)).await?;
            let lease = handle.cell.take_lease(request).await?;
            *handle.newest_lease.lock().unwrap_or_else(PoisonError::into_inner) = Some((lease.id.clone(), lease.fence));
            *newest = lease.fence;
            Ok(service.held(lease))
        };
        self.shared.background.run_detached(taking).await
    }

    /// Refuses a time to live outside the configured range.
    ///
    /// # Errors
    /// [`ServiceError::Value`], [`ServiceError::CellAbsent`].
    pub fn check_time_to_live(&self, asked: Duration) -> Result<(), ServiceError> {
        self.time_to_live(self.cell_handle()?, Some(asked)).map(drop)
    }

    /// Renews the lease by using it.
    ///
    /// # Errors
    /// [`ServiceError::Cell`] if it has expired or belongs to another client.
    pub async fn renew_lease(&self, id: &str) -> Result<HeldLease, ServiceError> {
        Ok(self.held(self.use_lease(id).await?))
    }

    /// Whether this is the id of the current lease. Does not wait, and does not renew the lease.
    #[must_use]
    pub fn holds_lease(&self, id: &str) -> bool {
        let Some(handle) = &self.cell else { return false };
        let Some(held) = handle.cell.snapshot().lease.clone() else { return false };
        let newest = handle.newest_lease.lock().unwrap_or_else(PoisonError::into_inner);
        newest.as_ref().is_some_and(|(newest, fence)| newest == id && *fence == held.fence)
            && self.shared.clock.instant() < held.until
    }

    /// Releases the lease; motion commanded with it stops.
    ///
    /// # Errors
    /// [`ServiceError::Cell`] if it has expired or belongs to another client.
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

    /// The commander for the record, from the lease of this id. Refuses a client without the lease before anything is written
    /// or planned for it, and renews the lease. A request that was answered before is answered again without a lease,
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
        // The cell is asked, not its newest snapshot: the lease may change hands before the command is recorded.
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
