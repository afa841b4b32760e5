//! Measurements that were made: one, a page of them, their profiles, and the last one. Must not know how they were made.

use super::{Measurement, Service, ServiceError, Verdict};
use crate::estimation::Profile;
use crate::store::{Filter, Listing, MeasurementRow, Page};
use jiff::Timestamp;
use std::sync::atomic::Ordering;
use std::sync::{Arc, PoisonError};

/// The newest measurement, for those who poll.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Last {
    /// Its id.
    pub id: String,
    /// Whether it has a pose.
    pub verdict: Verdict,
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
        self.store.measurement(id).await?.map(|row| read_back(&row)).transpose()
    }

    /// A page of the measurements that pass the filter, newest first.
    ///
    /// # Errors
    /// What the store says.
    pub async fn measurements(&self, filter: &Filter, page: &Page) -> Result<Listing<Measurement>, ServiceError> {
        let Listing { rows, next } = self.store.measurements(filter, page).await?;
        Ok(Listing { rows: rows.iter().map(read_back).collect::<Result<_, _>>()?, next })
    }

    /// What became of every profile of a measurement, in station order.
    ///
    /// # Errors
    /// [`ServiceError::MeasurementUnknown`].
    pub async fn profiles(&self, id: &str) -> Result<Vec<Profile>, ServiceError> {
        let bytes = self.store.profiles(id).await?;
        let bytes = bytes.ok_or_else(|| ServiceError::MeasurementUnknown { id: id.to_owned() })?;
        serde_json::from_slice(&bytes).map_err(|source| ServiceError::RecordUnreadable {
            what: "profiles",
            id: id.to_owned(),
            source: Arc::new(source),
        })
    }

    /// The newest measurement; `None` where there is none.
    #[must_use]
    pub fn last(&self) -> Option<Last> {
        self.last.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// Remembers a measurement that was just recorded.
    pub(super) fn note(&self, measurement: &Measurement) {
        let (id, verdict, created_at) = (measurement.id.clone(), measurement.verdict(), measurement.created_at);
        let mut last = self.last.lock().unwrap_or_else(PoisonError::into_inner);
        // Two may finish at the same time; the later one stays, whoever comes here first.
        if last.as_ref().is_none_or(|last| last.id < id) {
            *last = Some(Last { id, verdict, created_at });
        }
        drop(last);
        self.advance();
    }

    /// Something was recorded.
    pub(super) fn advance(&self) {
        self.sequence.fetch_add(1, Ordering::Relaxed);
    }

    /// Finds the newest measurement of earlier runs.
    pub(super) async fn recall_last(&self) -> Result<(), ServiceError> {
        let page = Page { limit: 1, before: None };
        if let Some(row) = self.store.measurements(&Filter::default(), &page).await?.rows.first() {
            self.note(&read_back(row)?);
        }
        Ok(())
    }
}

/// The record from its row.
pub(super) fn read_back(row: &MeasurementRow) -> Result<Measurement, ServiceError> {
    serde_json::from_str(&row.document).map_err(|source| ServiceError::RecordUnreadable {
        what: "measurement",
        id: row.id.clone(),
        source: Arc::new(source),
    })
}
