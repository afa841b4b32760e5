//! The store: records in an embedded database, and raw scans as files named by their content.
//!
//! ```text
//! rows in ───> writer (one task, one transaction for all that wait) ───> coaxis.db ───> readers ───> rows out
//! bytes in ──> scan_files (hash) ──> placing (with its row) ──> scans/ab/abcd… ──> a file to read from
//!                   └──> ScanFollower: reads them while they are received
//! ```
//!
//! A write is acknowledged only when it is durable. Times and ids are arguments; documents are stored as unchanged text.

mod checkup;
mod commits;
mod database;
mod error;
mod folder;
mod jobs;
mod measurements;
mod page;
mod placing;
mod plans;
mod recipes;
mod repository;
mod rows;
mod scan_files;
mod scans;
mod statements;
mod writer;

pub use checkup::{Checkup, ScanCheck};
pub use database::StoreLimits;
pub use error::{Loss, StoreError};
pub use folder::FolderLock;
pub use jobs::{EndedJob, InsertedJob, JobRow, NewJob};
pub use page::{Cursor, Listing, PAGE_ROWS_MAX, Page};
pub use plans::{InsertedPlan, ListedPlan, PlanRow};
pub use repository::{Store, Usage};
pub use rows::{
    AnsweredRequest, Counts, Filter, Inserted, MeasurementRow, NewMeasurement, NewestMeasurement, Precondition,
    PutRecipe, RecipeRow, RecordedScan, RequestKey, ScanRow, hex,
};
pub use scan_files::{CompleteScan, ScanFollower, ScanPart, ScanTrail, ScanWriter};

#[cfg(test)]
mod tests;
