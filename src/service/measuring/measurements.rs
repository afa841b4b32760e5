//! Looks up recorded measurements: a single one, a page of them, their profiles, and the newest one.

use super::record::Last;
use std::sync::{Arc, PoisonError};

use super::state::Measuring;
use crate::estimation::Profile;
use crate::service::background::run_blocking;
use crate::service::document;
use crate::service::document::Entry;
use crate::service::error::{ServiceError, Unreadable};
use crate::store::{Filter, Listing, MeasurementRow, NewestMeasurement, Page};

use super::record::{Measurement, Verdict};

/// The record of a row.
pub(in crate::service) fn read_back(row: &MeasurementRow) -> Result<Measurement, ServiceError> {
    document::read("measurement", &row.id, &row.document)
}

impl Measuring {
    /// The measurement of an id, if it was recorded.
    pub(in crate::service) async fn recorded(&self, id: &str) -> Result<Option<Measurement>, ServiceError> {
        let row = self.shared.store.measurement(id).await?.or_else(|| self.shared.unwritten.measurement(id));
        row.map(|row| read_back(&row)).transpose()
    }

    /// A page of the measurements that pass the filter, newest first.
    ///
    /// # Errors
    /// Errors of the store.
    pub async fn measurements(
        &self,
        filter: &Filter,
        page: &Page,
    ) -> Result<Listing<Entry<Measurement>>, ServiceError> {
        let Listing { rows, next } = self.shared.store.measurements(filter, page).await?;
        // The measurements that are not written yet are the newest.
        let unwritten = if page.before.is_none() { self.shared.unwritten.measurements(filter) } else { Vec::new() };
        let read = move || {
            let rows = unwritten.iter().chain(&rows);
            rows.map(|row| Entry::of(read_back(row), row.created_at)).collect()
        };
        Ok(Listing { rows: run_blocking(read).await?, next })
    }

    /// The verdict on every profile of a measurement, in station order.
    ///
    /// # Errors
    /// [`ServiceError::MeasurementUnknown`].
    pub async fn profiles(&self, id: &str) -> Result<Vec<Profile>, ServiceError> {
        let bytes = self.shared.store.profiles(id).await?.or_else(|| self.shared.unwritten.profiles(id));
        let id = id.to_owned();
        let bytes = bytes.ok_or_else(|| ServiceError::MeasurementUnknown { id: id.clone() })?;
        run_blocking(move || {
            let unreadable = |source| Unreadable::Damaged(Arc::new(source));
            serde_json::from_slice(&bytes).map_err(unreadable).map_err(|cause| ServiceError::RecordUnreadable {
                what: "list of profiles",
                id,
                cause,
            })
        })
        .await
    }

    /// The newest measurement; `None` if there is none.
    #[must_use]
    pub fn last(&self) -> Option<Last> {
        self.last.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// Remembers the newest measurement of the store. Two may be recorded at the same time; the later one is kept in any order of
    /// the calls.
    pub(in crate::service) async fn recall_last(&self) -> Result<(), ServiceError> {
        if let Some(NewestMeasurement { sequence, id, created_at, verdict }) =
            self.shared.store.newest_measurement().await?
        {
            let mut last = self.last.lock().unwrap_or_else(PoisonError::into_inner);
            if last.as_ref().is_none_or(|last| last.sequence < sequence) {
                *last = Some(Last { sequence, id, verdict: Verdict::from_name(&verdict), created_at });
            }
        }
        Ok(())
    }

    /// Updates the newest measurement after one was recorded.
    pub(in crate::service) async fn remember_last(&self) {
        if let Err(error) = self.recall_last().await {
            tracing::warn!(%error, "the newest measurement cannot be looked up; the status shows the one before");
        }
        self.shared.advance();
    }
}
