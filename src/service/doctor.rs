//! Examines a data folder: the database, its records and the files of the scans. It changes nothing and may run while a service
//! uses the folder.

use super::document;
use super::error::ServiceError;
use super::measuring::{measurements, recipes};
use super::operating::job::Kind;
use super::operating::moves::MoveOrder;
use super::operating::scan_order::SensorOrder;
use super::operating::{jobs, plans};
use crate::store::{Checkup, Cursor, JobRow, Listing, Page, ScanCheck, ScanRow, Store, StoreError};
use std::path::Path;

/// Records that are examined at a time.
const PAGE_ROWS: u32 = 200;

/// How much was examined, and how many problems were found.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Examined {
    /// Records of every kind, scans included.
    pub records_count: u64,
    /// Files of scans.
    pub scans_count: u64,
    /// Problems found.
    pub findings_count: u64,
}

/// An examination under way.
struct Doctor<'a> {
    checkup: Checkup,
    examined: Examined,
    tell: &'a mut dyn FnMut(&str),
}

/// Examines the folder and reports each problem as text; `scrub` reads every byte of every scan.
///
/// # Errors
/// [`ServiceError::Store`] if the database cannot be opened or read.
pub async fn examine(folder: &Path, scrub: bool, tell: &mut dyn FnMut(&str)) -> Result<Examined, ServiceError> {
    let checkup = Checkup::open(folder).await?;
    let mut doctor = Doctor { checkup, examined: Examined::default(), tell };
    doctor.database(scrub).await?;
    doctor.scans(scrub).await?;
    doctor.records().await?;
    Ok(doctor.examined)
}

/// Accepts the database in its present state although acknowledged records were lost.
///
/// # Errors
/// [`ServiceError::Store`], e.g. if a service is running on the folder.
pub async fn accept_loss(folder: &Path) -> Result<(), ServiceError> {
    Ok(Store::accept_loss(folder).await?)
}

impl Doctor<'_> {
    fn find(&mut self, finding: &str) {
        self.examined.findings_count += 1;
        (self.tell)(finding);
    }

    async fn database(&mut self, thorough: bool) -> Result<(), ServiceError> {
        for fault in self.checkup.database_faults(thorough).await? {
            self.find(&format!("database: {fault}"));
        }
        if let Some(loss) = self.checkup.loss().await? {
            self.find(&loss.to_string());
        }
        Ok(())
    }

    async fn scans(&mut self, scrub: bool) -> Result<(), ServiceError> {
        let mut page = Some(first_page());
        while let Some(at) = page {
            let Listing { rows, next } = self.checkup.scans(&at).await?;
            for row in rows {
                self.examined.scans_count += 1;
                self.examined.records_count += 1;
                if let Some(finding) = self.scan(&row, scrub).await {
                    self.find(&finding);
                }
            }
            page = next.map(behind);
        }
        Ok(())
    }

    async fn scan(&self, row: &ScanRow, scrub: bool) -> Option<String> {
        let what = match self.checkup.check_scan(row, scrub).await {
            Ok(ScanCheck::Intact) => return None,
            Ok(ScanCheck::Missing) => "is missing".to_owned(),
            Ok(ScanCheck::Length { found }) => format!("has {found} bytes, {} were recorded", row.bytes_count),
            Ok(ScanCheck::Damaged { found_sha256 }) => format!("is damaged: its SHA-256 is {found_sha256}"),
            Err(StoreError::FileUnavailable { source, .. }) => format!("cannot be read: {source}"),
            Err(error) => format!("cannot be read: {error}"),
        };
        Some(format!("the file of scan {} {what}; sending the original file again repairs it", row.id))
    }

    async fn records(&mut self) -> Result<(), ServiceError> {
        let mut page = Some(first_page());
        while let Some(at) = page {
            let Listing { rows, next } = self.checkup.measurements(&at).await?;
            rows.iter().for_each(|row| self.record(measurements::read_back(row)));
            page = next.map(behind);
        }
        let mut page = Some(first_page());
        while let Some(at) = page {
            let Listing { rows, next } = self.checkup.recipes(&at).await?;
            rows.into_iter().for_each(|row| self.record(recipes::read_back(row)));
            page = next.map(behind);
        }
        let mut page = Some(first_page());
        while let Some(at) = page {
            let Listing { rows, next } = self.checkup.plans(&at).await?;
            rows.iter().for_each(|row| self.record(plans::read_back(&row.plan)));
            page = next.map(behind);
        }
        let mut page = Some(first_page());
        while let Some(at) = page {
            let Listing { rows, next } = self.checkup.jobs(&at).await?;
            rows.iter().for_each(|row| self.record(read_job(row)));
            page = next.map(behind);
        }
        Ok(())
    }

    fn record<T>(&mut self, read: Result<T, ServiceError>) {
        self.examined.records_count += 1;
        if let Err(error) = read {
            self.find(&error.to_string());
        }
    }
}

const fn first_page() -> Page {
    Page { limit: PAGE_ROWS, before: None }
}

const fn behind(cursor: Cursor) -> Page {
    Page { limit: PAGE_ROWS, before: Some(cursor) }
}

fn read_job(row: &JobRow) -> Result<(), ServiceError> {
    if row.kind == Kind::Move.name() {
        return jobs::read_back::<MoveOrder>(row).map(drop);
    }
    if row.kind == Kind::Scan.name() {
        return jobs::read_back::<SensorOrder>(row).map(drop);
    }
    document::read::<serde_json::Value>("job", &row.id, &row.document).map(drop)
}
