//! Measurements that were made: one, a page of them, their profiles, and the last one.

use super::document::{Entry, Unreadable};
use super::error::ServiceError;
use super::followers::aside;
use super::measurement::{Measurement, Verdict};
use super::{Service, document};
use crate::estimation::Profile;
use crate::store::{Filter, Listing, MeasurementRow, NewestMeasurement, Page};
use jiff::Timestamp;
use std::sync::atomic::Ordering;
use std::sync::{Arc, PoisonError};

/// The newest measurement, for those who poll.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Last {
    /// Which measurement it is in the order in which they were recorded.
    sequence: u64,
    /// Its id.
    pub id: String,
    /// Whether it has a pose; none where the record does not say so in a word that is known.
    pub verdict: Option<Verdict>,
    /// When it was made.
    pub created_at: Timestamp,
}

impl Service {
    /// The measurement of an id that ran.
    ///
    /// # Errors
    /// [`ServiceError::MeasurementRunning`], [`ServiceError::MeasurementFailed`], [`ServiceError::MeasurementUnknown`].
    pub async fn measurement(&self, id: &str) -> Result<Measurement, ServiceError> {
        match self.recorded(id).await? {
            Some(measurement) => Ok(measurement),
            None => Err(self.why_not_measured(id).await),
        }
    }

    /// The measurement of an id, where one ran.
    pub(super) async fn recorded(&self, id: &str) -> Result<Option<Measurement>, ServiceError> {
        let row = self.store.measurement(id).await?.or_else(|| self.unwritten.measurement(id));
        row.map(|row| read_back(&row)).transpose()
    }

    /// A page of the measurements that pass the filter, newest first.
    ///
    /// # Errors
    /// What the store says.
    pub async fn measurements(
        &self,
        filter: &Filter,
        page: &Page,
    ) -> Result<Listing<Entry<Measurement>>, ServiceError> {
        let Listing { rows, next } = self.store.measurements(filter, page).await?;
        // Those that are not written yet are the newest.
        let unwritten = if page.before.is_none() { self.unwritten.measurements(filter) } else { Vec::new() };
        let read = move || {
            let rows = unwritten.iter().chain(&rows);
            rows.map(|row| Entry::of(read_back(row), row.created_at)).collect()
        };
        Ok(Listing { rows: aside(read).await?, next })
    }

    /// What became of every profile of a measurement, in station order.
    ///
    /// # Errors
    /// [`ServiceError::MeasurementUnknown`].
    pub async fn profiles(&self, id: &str) -> Result<Vec<Profile>, ServiceError> {
        let bytes = self.store.profiles(id).await?.or_else(|| self.unwritten.profiles(id));
        let id = id.to_owned();
        let bytes = bytes.ok_or_else(|| ServiceError::MeasurementUnknown { id: id.clone() })?;
        aside(move || {
            let unreadable = |source| Unreadable::Damaged(Arc::new(source));
            serde_json::from_slice(&bytes).map_err(unreadable).map_err(|cause| ServiceError::RecordUnreadable {
                what: "list of profiles",
                id,
                cause,
            })
        })
        .await
    }

    /// The newest measurement; `None` where there is none.
    #[must_use]
    pub fn last(&self) -> Option<Last> {
        self.last.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// Something was recorded.
    pub(super) fn advance(&self) {
        self.sequence.fetch_add(1, Ordering::Relaxed);
    }

    /// Remembers the newest measurement of the store. Two may be recorded at the same time; the later one stays, whoever comes here
    /// first.
    pub(super) async fn recall_last(&self) -> Result<(), ServiceError> {
        if let Some(NewestMeasurement { sequence, id, created_at, verdict }) = self.store.newest_measurement().await? {
            let mut last = self.last.lock().unwrap_or_else(PoisonError::into_inner);
            if last.as_ref().is_none_or(|last| last.sequence < sequence) {
                *last = Some(Last { sequence, id, verdict: Verdict::from_name(&verdict), created_at });
            }
        }
        Ok(())
    }

    /// A measurement was just recorded.
    pub(super) async fn remember_last(&self) {
        if let Err(error) = self.recall_last().await {
            tracing::warn!(%error, "the newest measurement cannot be looked up; the status shows the one before");
        }
        self.advance();
    }
}

/// The record from its row.
pub(super) fn read_back(row: &MeasurementRow) -> Result<Measurement, ServiceError> {
    document::read("measurement", &row.id, &row.document)
}
