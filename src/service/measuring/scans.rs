//! Raw scans: stored under the hash of their content, looked up, and returned byte for byte.

use std::fs::File;
use std::sync::Arc;

use super::state::Measuring;
use crate::scan::decode::Format;
use crate::service::error::ServiceError;
use crate::store::{Listing, Page, RecordedScan, ScanRow};

use super::pipeline::{Decoded, MeasureError};
use super::points::{PointFile, Points};
use super::upload::ReceivedScan;

/// The content of a stored scan.
#[derive(Debug)]
pub struct Content {
    /// Its record.
    pub row: ScanRow,
    /// Its bytes, to be read from the beginning.
    pub file: File,
}

/// Result of storing a scan.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Kept {
    /// These bytes were not stored before.
    New(ScanRow),
    /// These bytes were stored already.
    Known(ScanRow),
}

fn count_points(decoded: &Decoded) -> (Format, u64) {
    (decoded.format, u64::try_from(decoded.cloud.columns.len()).unwrap_or(u64::MAX))
}

impl Measuring {
    /// Stores a scan after reading it once; a scan that cannot be read is deleted. The same bytes are stored once.
    ///
    /// # Errors
    /// [`ServiceError`]; nothing is recorded then.
    pub async fn store_scan(self: &Arc<Self>, arrived: ReceivedScan) -> Result<Kept, ServiceError> {
        let ReceivedScan { scan, read, sent, origin, accepted, place } = arrived;
        let arrival = accepted.arrival()?;
        let file_name = origin.file_name.clone();
        let (format, points_count) = match read {
            Some(read) => read.decoded.map(|decoded| count_points(&decoded)).map_err(MeasureError::from)?,
            None => {
                let queued = self.compute.take_place()?;
                let points = Points::InFile(Box::new(PointFile {
                    file: scan.open().await?,
                    bytes_count: scan.bytes_count(),
                    points_count: None,
                    sent,
                    origin,
                    resolved: accepted.resolved,
                }));
                self.with_points((&self.compute, queued), points, |decoded, _| Ok(count_points(&decoded))).await?
            }
        };
        let created_at = self.shared.clock.now();
        let row = ScanRow {
            id: scan.id(),
            created_at,
            bytes_count: scan.bytes_count(),
            format: format.name().to_owned(),
            points_count: Some(points_count),
            description: file_name,
            arrival: Some(arrival),
        };
        let service = Arc::clone(self);
        let keeping = async move {
            // The scan keeps its place among the uploads until it is stored.
            let _place = place;
            match service.shared.store.keep_scan(row.clone(), scan).await? {
                RecordedScan::New => {
                    service.shared.advance();
                    Ok(Kept::New(row))
                }
                RecordedScan::Known(row) => Ok(Kept::Known(row)),
            }
        };
        self.shared.background.run_detached(keeping).await
    }

    /// The record of a scan.
    ///
    /// # Errors
    /// [`ServiceError::ScanUnknown`].
    pub async fn scan(&self, id: &str) -> Result<ScanRow, ServiceError> {
        self.shared.store.scan(id).await?.ok_or_else(|| ServiceError::ScanUnknown { id: id.to_owned() })
    }

    /// A page of the scans, newest first.
    ///
    /// # Errors
    /// Errors of the store.
    pub async fn scans(&self, page: &Page) -> Result<Listing<ScanRow>, ServiceError> {
        Ok(self.shared.store.scans(page).await?)
    }

    /// The bytes of a scan.
    ///
    /// # Errors
    /// [`ServiceError::ScanUnknown`], [`ServiceError::ScanFileMissing`], [`ServiceError::Store`] if it cannot be read.
    pub async fn scan_content(&self, id: &str) -> Result<Content, ServiceError> {
        let row = self.scan(id).await?;
        Ok(Content { file: self.scan_file(id).await?, row })
    }

    /// The file of a recorded scan, after its bytes were compared with their record.
    ///
    /// # Errors
    /// [`ServiceError::ScanFileMissing`], [`ServiceError::Store`] if it is damaged.
    pub(in crate::service) async fn scan_file(&self, id: &str) -> Result<File, ServiceError> {
        self.shared.store.open_scan(id).await?.ok_or_else(|| ServiceError::ScanFileMissing { id: id.to_owned() })
    }
}
